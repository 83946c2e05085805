"""Capsule."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, Transform, Vector, freeze
from lidarsim._base.vectors import product
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles, frames, unit_capsule


class Capsule(Shape):
    """The surface of all points at a distance of `radius` from the segment from `start` to `end`.

    It is the side of a cylinder, closed by half of a sphere at each end.

    Parameters
    ----------
    start, end : array_like, shape (3,)
        Ends of the segment, m; two different points. The capsule reaches `radius` beyond each.
    radius : float
        Radius of the side and of both ends, m, > 0.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the capsule.

    Raises
    ------
    ValueError
        If a number is not finite, the radius is not positive, the ends coincide (use a `Sphere`), or the transform
        cannot be inverted.

    Notes
    -----
    A line crosses the side, extended without end, as that of a :class:`Cylinder`. Where it crosses between both ends,
    it meets the capsule; where it crosses beyond an end, it meets that end's sphere in its place, or misses. A line
    that meets the seam of the side and an end has one root there, and a line within the side has two, where it meets
    the seams.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Capsule((4, 0, -1), (4, 0, 1), 0.5).roots([[0, 0, 0], [4, 0, 0]], [[1, 0, 0], [0, 0, 1]])
    array([[ 3.5,  4.5],
           [-1.5,  1.5]])
    """

    __slots__ = ()
    __match_args__ = ("start", "end", "radius")

    _positive: ClassVar = frozenset({"radius"})
    configuration: ClassVar = {"start_m": Vector, "end_m": Vector, "radius_m": float}

    def __init__(
        self, start: npt.ArrayLike, end: npt.ArrayLike, radius: float, *, transform: Transform | None = None
    ) -> None:
        self._set("Capsule", {"start": start, "end": end}, {"radius": radius}, transform)

    @property
    def start(self) -> Floats:
        """Where the segment starts before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["start"])

    @property
    def end(self) -> Floats:
        """Where the segment ends before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["end"])

    @property
    def radius(self) -> float:
        """The radius before any transform, m: float."""
        return self._arguments["radius"][0]

    def _reach(self, directions: Floats, /) -> Floats:
        arguments = self._arguments
        ends = product(directions, np.array([arguments["start"], arguments["end"]]).T).max(axis=1)
        reach: Floats = ends + arguments["radius"] * np.sqrt((directions * directions).sum(axis=1))
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        start, radius, axis = self.start, self.radius, self.end - self.start
        vertices, faces, is_end = unit_capsule(None if chord_error is None else chord_error / radius)
        return start + radius * vertices @ frames(axis[None])[0] + is_end[:, None] * axis, faces
