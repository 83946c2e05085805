"""Polygon."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.validation import Floats, Transform, Vector, array
from lidarsim._base.vectors import product
from lidarsim.errors import ArgumentValueError
from lidarsim.world.shapes._polygons import flattened
from lidarsim.world.shapes._shape import Shape
from lidarsim.world.shapes._tessellation import Triangles

# One rigid map in float64 moves each coordinate of a vertex by at most 4 roundings of numbers up to three times the
# largest coordinate M: 12·u·M, or 12·√3·u·M in all directions. The reference plane, through the mean of the vertices,
# is off by as much: 2·12·√3 < 48.
_ROUNDINGS = 48


class Polygon(Shape):
    """A plane n-gon, convex or not, whose outline does not touch itself.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Outline in order, without repeating the first vertex, m, n >= 3. The normal points to the side from which the
        outline is counter-clockwise.
    transform : array_like, shape (4, 4), or RigidTransform, optional
        Affine map applied to the polygon.

    Raises
    ------
    ValueError
        If there are fewer than three vertices, two neighbours coincide, the vertices do not lie in a plane to within
        rounding (the message states by how much), the outline touches itself, or the transform cannot be inverted.

    Notes
    -----
    The polygon is triangulated, and rays meet each triangle as they meet a :class:`Triangle`. The triangles share their
    edges exactly, so there are no gaps. ``primitive_id`` is 0 for all of them.

    Examples
    --------
    >>> import lidarsim as ls
    >>> arrow = ls.Polygon([(2, 0, 0), (2, 2, -1), (2, 1, 0), (2, 2, 1)])
    >>> arrow.cast([(0, 0.5, 0), (0, 1.5, 0)], [(1, 0, 0), (1, 0, 0)]).hit
    array([ True, False])
    """

    __slots__ = ()
    __match_args__ = ("vertices",)

    configuration: ClassVar = {"vertices_m": list[Vector]}

    def __init__(self, vertices: npt.ArrayLike, *, transform: Transform | None = None) -> None:
        points = array("vertices", vertices, ("n", 3))
        if len(points) < 3:
            raise ArgumentValueError("vertices", "at least 3", len(points))
        faces = _triangulate(points)
        super().__init__(_native.Shape.triangle_mesh(points, faces, True), transform)

    @property
    def vertices(self) -> Floats:
        """The outline before any transform, m: read-only ndarray of float64, shape (n, 3)."""
        return self._native.vertices()

    def _reach(self, directions: Floats, /) -> Floats:
        reach: Floats = product(directions, self.vertices.T).max(axis=1)
        return reach

    def _tessellate(self, _chord_error: float | None, _box: Floats, /) -> Triangles:
        return self.vertices, self._native.faces()


def _triangulate(points: Floats) -> npt.NDArray[np.uint32]:
    """Check the outline and triangulate it with the same orientation."""
    import mapbox_earcut

    following = np.roll(points, -1, axis=0)
    equal = (points == following).all(axis=1)
    if equal.any():
        i = int(np.argmax(equal))
        raise ArgumentValueError(
            "vertices",
            "neighbours to differ",
            f"{tuple(points[i].tolist())} for vertices {i} and {(i + 1) % len(points)}",
        )
    # The unit of length is a power of two, so that no product overflows or underflows.
    exponent = int(np.frexp(np.abs(points).max())[1])
    points = np.ldexp(points, -exponent)
    local = points - points.mean(axis=0)
    # Newell's normal: the sum of the cross products along the outline, twice the area.
    normal = np.cross(local, np.roll(local, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        raise ArgumentValueError("vertices", "a polygon with an area", "area 0")
    deviation = float(np.abs(local @ (normal / length)).max())
    allowed = _ROUNDINGS * (np.finfo(np.float64).eps / 2) * float(np.abs(points).max())
    if deviation > allowed:
        raise ArgumentValueError(
            "vertices",
            f"points of one plane to within rounding ({np.ldexp(allowed, exponent):.3g} m)",
            f"a deviation of {np.ldexp(deviation, exponent):.3g} m",
        )
    outline = flattened(points, normal)
    crossing = _native.self_crossing(outline)
    if crossing is not None:
        i, j = crossing
        raise ArgumentValueError("vertices", "an outline that does not touch itself", f"edges {i} and {j} that do")
    faces = mapbox_earcut.triangulate_float64(outline, np.array([len(outline)], dtype=np.uint32)).reshape(-1, 3)
    a, b, c = outline[faces[:, 0]], outline[faces[:, 1]], outline[faces[:, 2]]
    left = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]) > 0
    return np.ascontiguousarray(np.where(left[:, None], faces, faces[:, ::-1]), dtype=np.uint32)
