"""Cylinder."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.names import explain_arguments
from lidarsim._base.validation import Floats, Transform, Vector, freeze, short_repr
from lidarsim._base.vectors import product
from lidarsim.errors import ArgumentTypeError
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles, circle, frames


class Cylinder(Shape):
    """The surface of a cylinder around the axis from `start` to `end`.

    Parameters
    ----------
    start, end : array_like, shape (3,)
        Ends of the axis, m; two different points.
    radius : float
        Radius, m, > 0.
    capped : bool
        Whether the ends are closed by discs; if not, the cylinder is a hollow tube.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the cylinder.

    Raises
    ------
    ValueError
        If a number is not finite, the radius is not positive, the ends coincide, or the transform cannot be inverted.

    Notes
    -----
    With A = end − start, f = o − start, n = d × A and m = f × A, the side is ``|m + t n|² = r² |A|²``, bounded by 0 <=
    A·(f + t d) <= |A|². The discriminant is evaluated as ``|A|² (r² |n|² − (f·n)²)``. The cylinder is not moved to a
    canonical position and the axis is not normalised, so nothing is rounded. (Some texts print the equation of the side
    with 0 on the right instead of r².) A line along the axis meets only the caps. A line that touches the rim of a
    capped cylinder meets it once.

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Cylinder((4, 0, -1), (4, 0, 1), 0.5).roots([[0, 0, 0]], [[1, 0, 0]])
    array([[3.5, 4.5]])
    """

    __slots__ = ()
    __match_args__ = ("start", "end", "radius", "capped")

    _positive: ClassVar = frozenset({"radius"})
    configuration: ClassVar = {"start_m": Vector, "end_m": Vector, "radius_m": float, "capped": bool}

    @explain_arguments
    def __init__(
        self,
        start: npt.ArrayLike,
        end: npt.ArrayLike,
        radius: float,
        capped: bool = True,
        *,
        transform: Transform | None = None,
    ) -> None:
        if not isinstance(capped, (bool, np.bool_)):
            raise ArgumentTypeError("capped", "a bool", short_repr(capped))
        self._set("Cylinder", {"start": start, "end": end}, {"radius": radius, "capped": float(capped)}, transform)

    @property
    def start(self) -> Floats:
        """Where the axis starts before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["start"])

    @property
    def end(self) -> Floats:
        """Where the axis ends before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["end"])

    @property
    def radius(self) -> float:
        """The radius before any transform, m: float."""
        return self._arguments["radius"][0]

    @property
    def capped(self) -> bool:
        """Whether the ends are closed: bool."""
        return bool(self._arguments["capped"][0])

    def _reach(self, directions: Floats, /) -> Floats:
        axis = (self.end - self.start) / math.hypot(*(self.end - self.start))
        across = np.linalg.norm(np.cross(directions, axis), axis=1)
        ends = product(directions, np.stack([self.start, self.end], axis=1)).max(axis=1)
        reach: Floats = ends + self.radius * across
        return reach

    def _tessellate(self, chord_error: float | None, _box: Floats, /) -> Triangles:
        start, end = self.start, self.end
        rim = circle(self.radius, chord_error) @ frames((end - start)[None])[0]
        count = len(rim)
        low, high = np.arange(count), np.arange(count) + count
        after = np.roll(low, -1)
        faces = [np.stack([low, after, after + count], axis=-1), np.stack([low, after + count, high], axis=-1)]
        vertices = [start + rim, end + rim]
        if self.capped:
            middles = np.full((2, count), [[2 * count], [2 * count + 1]])
            vertices.append(np.stack([start, end]))
            faces += [np.stack([middles[0], after, low], -1), np.stack([middles[1], high, after + count], -1)]
        return np.concatenate(vertices), np.concatenate(faces).astype(np.uint32)
