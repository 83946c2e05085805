"""Sphere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, Transform, Vector, freeze
from lidarsim._base.vectors import matvec
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles, unit_sphere


class Sphere(Shape):
    """The sphere of all points at a distance of `radius` from `center`.

    Parameters
    ----------
    center : array_like, shape (3,)
        Centre, m.
    radius : float
        Radius, m, > 0.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the sphere.

    Raises
    ------
    ValueError
        If a number is not finite, the radius is not positive, or the transform cannot be inverted.

    Notes
    -----
    With f = o − c, the roots of ``|d|² t² + 2 (f·d) t + (|f|² − r²) = 0``. The discriminant (f·d)² − |d|² (|f|² − r²)
    is evaluated as ``r² |d|² − |f × d|²``, which is the same number (Lagrange's identity) without the cancellation. A
    line that touches the sphere at exactly one point hits it. (Some texts print the constant term as 2(w − S) − r²; it
    is (w − S)·(w − S) − r².)

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Sphere((3, 0, 0), 1.0).roots([[0, 0, 0]], [[1, 0, 0]])
    array([[2., 4.]])
    """

    __slots__ = ()
    __match_args__ = ("center", "radius")

    _positive: ClassVar = frozenset({"radius"})
    configuration: ClassVar = {"center_m": Vector, "radius_m": float}

    @explain_arguments
    def __init__(self, center: npt.ArrayLike, radius: float, *, transform: Transform | None = None) -> None:
        self._set("Sphere", {"center": center}, {"radius": radius}, transform)

    @property
    def center(self) -> Floats:
        """The centre before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["center"])

    @property
    def radius(self) -> float:
        """The radius before any transform, m: float."""
        return self._arguments["radius"][0]

    def _reach(self, directions: Floats, /) -> Floats:
        reach: Floats = matvec(directions, self.center) + self.radius * np.linalg.norm(directions, axis=1)
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        vertices, faces = unit_sphere(None if chord_error is None else chord_error / self.radius)
        return self.center + self.radius * vertices, faces
