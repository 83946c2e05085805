"""Triangle."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, Transform, Vector, freeze
from lidarsim._base.vectors import product
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles


class Triangle(Shape):
    """The triangle with vertices a, b, c; its edges and vertices belong to it.

    Parameters
    ----------
    a, b, c : array_like, shape (3,)
        Vertices, m, not on one line. The normal is along (b − a) × (c − a).
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the triangle.

    Raises
    ------
    ValueError
        If a number is not finite, the vertices are on one line, or the transform cannot be inverted.

    Notes
    -----
    A line meets the triangle if the volumes d·(c × b), d·(a × c), d·(b × a), with vertices relative to its origin, have
    no two opposite signs; the signs are exact. Then t = n·(a − o)/(n·d). A line within the plane of the triangle misses
    it. (Some texts solve for the point as a combination of the three vertices; that fails where the plane of the
    triangle passes through the origin of coordinates.)

    Examples
    --------
    >>> import lidarsim as ls
    >>> ls.Triangle((3, -1, -1), (3, 1, -1), (3, 0, 2)).cast([[0, 0, 0]], [[1, 0, 0]]).t
    array([3.])
    """

    __slots__ = ()
    __match_args__ = ("a", "b", "c")

    configuration: ClassVar = {"a_m": Vector, "b_m": Vector, "c_m": Vector}

    def __init__(
        self, a: npt.ArrayLike, b: npt.ArrayLike, c: npt.ArrayLike, *, transform: Transform | None = None
    ) -> None:
        self._set("Triangle", {"a": a, "b": b, "c": c}, {}, transform)

    @property
    def a(self) -> Floats:
        """The first vertex before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["a"])

    @property
    def b(self) -> Floats:
        """The second vertex before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["b"])

    @property
    def c(self) -> Floats:
        """The third vertex before any transform, m: read-only ndarray of float64, shape (3,)."""
        return freeze(self._arguments["c"])

    def _reach(self, directions: Floats, /) -> Floats:
        reach: Floats = product(directions, np.stack([self.a, self.b, self.c]).T).max(axis=1)
        return reach

    def _tessellate(self, _chord_error: float | None, _box: Floats, /) -> Triangles:
        return np.stack([self.a, self.b, self.c]), np.array([[0, 1, 2]], np.uint32)
