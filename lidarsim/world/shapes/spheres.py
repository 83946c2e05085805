"""Many spheres."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.validation import Floats, Transform, Vector
from lidarsim._base.vectors import product
from lidarsim.world.shapes._primitives import Primitives, repeat, rows
from lidarsim.world.shapes._tessellation import COARSE, Triangles, unit_sphere


class Spheres(Primitives):
    """Many spheres in one shape, such as the foliage of a tree or a model of particles.

    Parameters
    ----------
    centers : array_like, shape (n, 3)
        Centres, m.
    radii : float or array_like, shape (n,)
        Radii, m, > 0: one for all, or one each.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to all spheres.

    Raises
    ------
    ValueError
        If a number is not finite, the numbers of spheres differ, a radius is not positive, or the transform cannot be
        inverted.

    Notes
    -----
    Rays meet each sphere as they meet a :class:`Sphere`. The ``primitive_id`` of a hit is the index of the sphere; of
    equal t the lowest wins. Labels and reflectivities can be given one per sphere (``per="face"``), as those of a
    :class:`TriangleMesh` one per face. The hierarchy is built at once; with it, a sphere takes about 55 bytes.

    Examples
    --------
    >>> import lidarsim as ls
    >>> spheres = ls.Spheres([(3, 0, 0), (9, 0, 0)], 1.0)
    >>> spheres.cast([(0, 0, 0), (5, 0, 0)], [(1, 0, 0)] * 2).primitive_id
    array([0, 1], dtype=int32)
    """

    __slots__ = ()
    __match_args__ = ("centers", "radii")

    _width: ClassVar = 4
    configuration: ClassVar = {"centers_m": list[Vector], "radii_m": float | list[float]}

    def __init__(self, centers: npt.ArrayLike, radii: npt.ArrayLike, *, transform: Transform | None = None) -> None:
        super().__init__(_native.Shape.spheres(rows(centers, radii)), transform)

    def _reach(self, directions: Floats, /) -> Floats:
        rows = self._rows
        lengths = np.linalg.norm(directions, axis=1)
        ends = product(directions, rows[:, :3].T) + lengths[:, None] * rows[:, 3]
        reach: Floats = ends.max(axis=1, initial=-np.inf)
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        all_rows = self._rows
        if not len(all_rows):
            return np.empty((0, 3)), np.empty((0, 3), np.uint32)
        vertices, faces = unit_sphere(COARSE if chord_error is None else chord_error / float(all_rows[:, 3].max()))
        points = all_rows[:, None, :3] + all_rows[:, None, 3:] * vertices
        return points.reshape(-1, 3), repeat(vertices, faces, len(all_rows))
