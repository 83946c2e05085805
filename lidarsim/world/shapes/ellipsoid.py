"""Ellipsoid."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, Transform, Vector, freeze, matrix
from lidarsim._base.vectors import matvec, product
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles, unit_sphere

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_ALONG_XYZ = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Ellipsoid(Shape):
    """The ellipsoid ``center + R · diag(radii) · u`` for all unit vectors u.

    Parameters
    ----------
    center : array_like, shape (3,)
        Centre, m.
    radii : array_like, shape (3,)
        Half axes, m, each > 0.
    rotation : Rotation or array_like, shape (3, 3), optional
        R, whose columns are the directions of the axes; the entries are taken as exact. None: along x, y, z.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the ellipsoid.

    Raises
    ------
    ValueError
        If a number is not finite, a radius is not positive, or the rotation or the transform cannot be inverted.

    Notes
    -----
    The ray is transformed to the space where the ellipsoid is the unit sphere. The map is affine, so t is unchanged.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Ellipsoid((5, 0, 0), (2, 1, 1)).roots([[0, 0, 0]], [[1, 0, 0]])
    array([[3., 7.]])
    """

    __slots__ = ()
    __match_args__ = ("center", "radii", "rotation")

    configuration: ClassVar = {"center_m": Vector, "radii_m": Vector}

    def __init__(
        self,
        center: npt.ArrayLike,
        radii: npt.ArrayLike,
        rotation: Rotation | npt.ArrayLike | None = None,
        *,
        transform: Transform | None = None,
    ) -> None:
        if rotation is not None and hasattr(rotation, "as_matrix"):
            rotation = rotation.as_matrix()
        x, y, z = _ALONG_XYZ if rotation is None else matrix("rotation", rotation)
        vectors = {"center": center, "radii": radii, "x": x, "y": y, "z": z}
        self._set("Ellipsoid", vectors, {}, transform)

    @property
    def center(self) -> Floats:
        """The centre before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["center"])

    @property
    def radii(self) -> Floats:
        """Half axes before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["radii"])

    @property
    def rotation(self) -> Floats:
        """Directions of the axes before any transform, in columns: read-only ndarray of float64, shape (3, 3)."""
        arguments = self._arguments
        return freeze([arguments[row] for row in "xyz"])

    def _reach(self, directions: Floats, /) -> Floats:
        axes = self.rotation * self.radii
        reach: Floats = matvec(directions, self.center) + np.linalg.norm(product(directions, axes), axis=1)
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        axes = self.rotation * self.radii
        # The map lengthens no distance by more than this factor.
        longest = float(np.linalg.norm(axes, ord=2))
        vertices, faces = unit_sphere(None if chord_error is None else chord_error / longest)
        mirrored = np.linalg.det(axes) < 0
        return self.center + vertices @ axes.T, faces[:, ::-1] if mirrored else faces
