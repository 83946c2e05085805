"""The textbook's formulas for triangles, beside those of `lidarsim.bench.textbook` for solids.

The inside test is made at a rounded point. Some notes call a point inside a triangle if its coefficients i, j, k in
p = i·a + j·b + k·c lie in [0, 1]. That fails when the plane of a, b, c passes through the origin: the three are then
linearly dependent and the system is singular. (Elsewhere the coefficients of a point of the plane sum to 1 and the test
is right.) Barycentric coordinates from areas, taken relative to a vertex, have no such case.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.bench import textbook
from lidarsim.bench.textbook import dot

Floats = npt.NDArray[np.float64]


def plane_of_three(origins: Floats, directions: Floats, a: Any, b: Any, c: Any) -> Floats:
    """Return t for the plane through three points."""
    return textbook.plane_through(origins, directions, a, np.cross(np.subtract(b, a), np.subtract(c, a)))


def triangle(origins: Floats, directions: Floats, a: Any, b: Any, c: Any) -> Floats:
    """Return t of the triangle's plane if the barycentric coordinates of that point are in [0, 1]."""
    return triangle_mesh(origins, directions, [a, b, c], [[0, 1, 2]])


def triangle_mesh(origins: Floats, directions: Floats, vertices: Any, faces: Any) -> Floats:
    """Return t for every triangle, (n, triangles), nan-padded."""
    a, b, c = np.moveaxis(np.asarray(vertices, dtype=np.float64)[np.asarray(faces)], 1, 0)
    n = np.cross(b - a, c - a)
    with np.errstate(all="ignore"):
        t = (dot(n, a) - origins @ n.T) / (directions @ n.T)
        point = origins[:, None] + t[:, :, None] * directions[:, None]
        area = dot(n, n)
        i = dot(np.cross(c - b, point - b), n) / area
        j = dot(np.cross(a - c, point - c), n) / area
        k = dot(np.cross(b - a, point - a), n) / area
        inside = (np.minimum(np.minimum(i, j), k) >= 0) & np.isfinite(t)
    return np.sort(np.where(inside, t, np.nan), axis=1)


#: The formula of each shape that the textbook has, by the name of its class or constructor.
FORMULAS: dict[str, Callable[..., Floats]] = textbook.FORMULAS | {
    "Plane.from_points": plane_of_three,
    "Triangle": triangle,
    "TriangleMesh": triangle_mesh,
}
