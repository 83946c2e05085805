"""Many disks, such as the surfels of a point cloud."""

from __future__ import annotations

import logging
from typing import ClassVar, Literal, Self, overload

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.validation import Floats, Transform, Vector, array, flag, freeze, integer
from lidarsim._base.vectors import product
from lidarsim.world.shapes._primitives import Primitives, repeat, rows
from lidarsim.world.shapes._surfels import surfels
from lidarsim.world.shapes._tessellation import COARSE, Triangles, circle, frames


class Disks(Primitives):
    """Many flat disks in one shape, such as the surfels that `from_points` makes of a scan.

    Parameters
    ----------
    centers : array_like, shape (n, 3)
        Centres, m.
    normals : array_like, shape (n, 3)
        Normals of the planes, of any length but zero; they are kept as given.
    radii : float or array_like, shape (n,)
        Radii, m, > 0: one for all, or one each.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to all disks.

    Raises
    ------
    ValueError
        If a number is not finite, the numbers of disks differ, a normal is zero, a radius is not positive, or the
        transform cannot be inverted.

    Notes
    -----
    Rays meet each disk as they meet a :class:`Disk`, from both sides. The ``primitive_id`` of a hit is the index of the
    disk; of equal t the lowest wins. Labels and reflectivities can be given one per disk (``per="face"``), as those of
    a :class:`TriangleMesh` one per face. The hierarchy is built at once; with it, a disk takes about 80 bytes.

    Examples
    --------
    >>> import lidarsim as ls
    >>> disks = ls.Disks([(0, 0, 0), (0, 0, 1)], [(0, 0, 1)] * 2, [2.0, 1.0])
    >>> disks.cast([(0.5, 0, 3), (1.5, 0, 3)], [(0, 0, -1)] * 2).primitive_id
    array([1, 0], dtype=int32)
    """

    __slots__ = ()
    __match_args__ = ("centers", "normals", "radii")

    _width: ClassVar = 7
    configuration: ClassVar = {
        "centers_m": list[Vector],
        "normals": list[Vector],
        "radii_m": float | list[float],
    }

    def __init__(
        self,
        centers: npt.ArrayLike,
        normals: npt.ArrayLike,
        radii: npt.ArrayLike,
        *,
        transform: Transform | None = None,
    ) -> None:
        super().__init__(_native.Shape.disks(rows(centers, radii, normals)), transform)

    @overload
    @classmethod
    def from_points(
        cls,
        points: npt.ArrayLike,
        *,
        normals: npt.ArrayLike | None = None,
        radii: npt.ArrayLike | None = None,
        neighbours: int = 16,
        return_index: Literal[False] = False,
        transform: Transform | None = None,
    ) -> Self: ...

    @overload
    @classmethod
    def from_points(
        cls,
        points: npt.ArrayLike,
        *,
        normals: npt.ArrayLike | None = None,
        radii: npt.ArrayLike | None = None,
        neighbours: int = 16,
        return_index: Literal[True],
        transform: Transform | None = None,
    ) -> tuple[Self, npt.NDArray[np.int64]]: ...

    @classmethod
    def from_points(
        cls,
        points: npt.ArrayLike,
        *,
        normals: npt.ArrayLike | None = None,
        radii: npt.ArrayLike | None = None,
        neighbours: int = 16,
        return_index: bool = False,
        transform: Transform | None = None,
    ) -> Self | tuple[Self, npt.NDArray[np.int64]]:
        """Make surfels: a disk at each point of a scan, so that another sensor can scan the surface.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            Points on surfaces, m.
        normals : array_like, shape (n, 3), optional
            Normals of the surfaces, of any length but zero; by default those of the planes that fit the neighbours of
            each point best (least squares), whose sign is arbitrary.
        radii : float or array_like, shape (n,), optional
            Radii, m, > 0; by default, each disk covers the Voronoi cell of its point among its neighbours within the
            plane of the disk, so that the disks of a flat surface leave no hole between points with neighbours on
            all sides.
        neighbours : int
            Number of nearest points, the point itself not counted, from which normals and radii follow; at least 3.
        return_index : bool
            Whether to also return which points have a disk.
        transform : array_like, shape (4, 4), or RigidTransform, optional
            Affine map applied to all disks.

        Returns
        -------
        disks : Disks
            In the order of the points, without outliers, whose number is reported to the logger ``lidarsim``.
        index : ndarray of int64, shape (len(disks),)
            The index of the point of each disk, as for labels; only with `return_index`.

        Raises
        ------
        ValueError
            If a number is not finite, numbers of points differ, a normal is zero, a radius is not positive, or no
            point is left.

        Notes
        -----
        These points get no disk:

        - one at the place of an earlier point;
        - unless normals are given, one whose neighbours do not lie near a plane: their standard deviation across the
          best plane exceeds half of their second largest one, as on a line, on a wire or in foliage;
        - unless radii are given, one that is isolated: its farthest neighbour is three times as far as the median of
          those of its neighbours. At the edge of a surface that is evenly sampled it is up to √2 times as far, in a
          corner up to twice.

        The Voronoi cell reaches ``min |q| / (2 cos ∠(q, u))`` from the point in a direction u, over neighbours q at
        less than 90° to it. Directions are taken together in twelve sectors, with the largest angle in the sector. In
        sectors without a neighbour within 60° the surface is taken to end.

        At places with disks of several normals, and where the scan was coarser than the surface curves, ranges are
        those of the disks, not of the surface. The error grows with the spacing of the points and with incidence.

        Examples
        --------
        >>> import lidarsim as ls
        >>> x, y = np.mgrid[:20, :20] / 10
        >>> floor = ls.Disks.from_points(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3))
        >>> floor.cast([(0.93, 0.21, 2.0)], [(0, 0, -1)]).t
        array([2.])
        """
        places = array("points", points, ("n", 3))
        count = integer("neighbours", neighbours, at_least=3)
        wants_index = flag("return_index", return_index)
        made = surfels(places, normals, radii, count)
        left_out = len(places) - len(made.points)
        if left_out:
            logging.getLogger("lidarsim").warning(
                "points: %d of %d have no disk: %d repeated, %d with neighbours that form no plane, %d isolated",
                left_out, len(places), made.repeated, made.not_flat, made.isolated,
            )  # fmt: skip
        disks = cls(places[made.points], made.normals, made.radii, transform=transform)
        return (disks, made.points) if wants_index else disks

    @property
    def normals(self) -> Floats:
        """The normals before any transform, as given: read-only ndarray of float64, shape (n, 3), a copy."""
        return freeze(self._rows[:, 4:])

    def _reach(self, directions: Floats, /) -> Floats:
        rows = self._rows
        axes = rows[:, 4:] / np.abs(rows[:, 4:]).max(axis=1, initial=0.0, keepdims=True)  # squares do not overflow
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        across = np.linalg.norm(np.cross(directions[:, None], axes), axis=2)
        reach: Floats = (product(directions, rows[:, :3].T) + rows[:, 3] * across).max(axis=1, initial=-np.inf)
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        all_rows = self._rows
        if not len(all_rows):
            return np.empty((0, 3)), np.empty((0, 3), np.uint32)
        centers, radii, normals = all_rows[:, None, :3], all_rows[:, None, 3:4], all_rows[:, 4:]
        rim = circle(1.0, COARSE if chord_error is None else chord_error / float(radii.max()))
        points = centers + radii * (rim @ frames(normals))
        last = np.arange(2, len(rim), dtype=np.uint32)
        faces = np.stack([np.zeros_like(last), last - np.uint32(1), last], axis=-1)  # a fan from the first vertex
        return points.reshape(-1, 3), repeat(rim, faces, len(all_rows))
