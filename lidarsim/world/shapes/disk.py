"""Disk."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, Transform, Vector, freeze
from lidarsim._base.vectors import matvec
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles, circle, frames


class Disk(Shape):
    """The flat disk of all points of a plane at most `radius` away from `center`; its rim belongs to it.

    Rays meet it from both sides.

    Parameters
    ----------
    center : array_like, shape (3,)
        Centre, m.
    normal : array_like, shape (3,)
        Normal of the plane, of any length but zero; it is kept as given.
    radius : float
        Radius, m, > 0.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the disk.

    Raises
    ------
    ValueError
        If a number is not finite, the normal is zero, the radius is not positive, or the transform cannot be inverted.

    Notes
    -----
    With f = o − center, the line meets the plane at t = b / a with a = n·d and b = −n·f, and the disk if
    ``|a f + b d|² <= r² a²``. The normal is not made a unit vector, so nothing is rounded. A ray within the plane,
    where n·d is exactly 0, misses.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Disk((0, 0, 2), (0, 0, 1), 1.0).roots([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0, 1]] * 3)
    array([[ 2.],
           [ 2.],
           [nan]])
    """

    __slots__ = ()
    __match_args__ = ("center", "normal", "radius")

    _positive: ClassVar = frozenset({"radius"})
    configuration: ClassVar = {"center_m": Vector, "normal": Vector, "radius_m": float}

    def __init__(
        self, center: npt.ArrayLike, normal: npt.ArrayLike, radius: float, *, transform: Transform | None = None
    ) -> None:
        self._set("Disk", {"center": center, "normal": normal}, {"radius": radius}, transform)

    @property
    def center(self) -> Floats:
        """The centre before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["center"])

    @property
    def normal(self) -> Floats:
        """The normal before any transform, as given: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["normal"])

    @property
    def radius(self) -> float:
        """The radius before any transform, m: float."""
        return self._arguments["radius"][0]

    def _reach(self, directions: Floats, /) -> Floats:
        axis = self.normal / np.abs(self.normal).max()  # whose square does not overflow
        axis /= math.hypot(*axis)
        across = np.linalg.norm(np.cross(directions, axis), axis=1)
        reach: Floats = matvec(directions, self.center) + self.radius * across
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        rim = self.center + circle(self.radius, chord_error) @ frames(self.normal[None])[0]
        index = np.arange(len(rim))
        faces = np.stack([np.full_like(index, len(rim)), index, np.roll(index, -1)], axis=-1)
        return np.concatenate([rim, [self.center]]), faces.astype(np.uint32)
