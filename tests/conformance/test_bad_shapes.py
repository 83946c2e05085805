"""Arguments that make no shape: one clear error each."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import lidarsim as ls

ORIGIN, X, Y, Z = (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
COLLINEAR = ((0, 0, 0), (1, 2, 3), (-3, -6, -9))
ON_A_LINE = "a, b, c: expected three points that are not on one line, got "

BAD = [
    (lambda: ls.Plane(ORIGIN, 1.0), ValueError, "normal: expected non-zero vectors, got normal = (0, 0, 0)"),
    (lambda: ls.Plane((0, math.nan, 1), 1.0), ValueError, "normal: expected finite numbers, got normal[1] = nan"),
    (lambda: ls.Plane((0, 1), 1.0), ValueError, "normal: expected shape (3,), got (2,)"),
    (lambda: ls.Plane("up", 1.0), TypeError, "normal: expected real numbers of shape (3,), got 'up'"),
    (lambda: ls.Plane(Z, math.inf), ValueError, "distance: expected a finite number, got inf"),
    (lambda: ls.Plane(Z, "1"), TypeError, "distance: expected a finite number, got '1'"),
    (lambda: ls.Plane(Z, None), TypeError, "distance: expected a finite number, got None"),
    (
        lambda: ls.Plane.from_point((0, 0, math.inf), Z),
        ValueError,
        "point: expected finite numbers, got point[2] = inf",
    ),
    (
        lambda: ls.Plane.from_point(ORIGIN, (0.0, -0.0, 0.0)),
        ValueError,
        "normal: expected non-zero vectors, got normal = (0, 0, 0)",
    ),
    (
        lambda: ls.Plane.from_points(*COLLINEAR),
        ValueError,
        ON_A_LINE + "[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [-3.0, -6.0, -9.0]",
    ),
    (
        lambda: ls.Plane.from_points(X, X, Y),
        ValueError,
        ON_A_LINE + "[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]",
    ),
    (lambda: ls.Plane.from_points(X, Y, (0, 0)), ValueError, "c: expected shape (3,), got (2,)"),
    (lambda: ls.Sphere(ORIGIN, 0.0), ValueError, "radius: expected a finite number > 0, got 0.0"),
    (lambda: ls.Sphere(ORIGIN, -1.0), ValueError, "radius: expected a finite number > 0, got -1.0"),
    (lambda: ls.Sphere(ORIGIN, math.nan), ValueError, "radius: expected a finite number > 0, got nan"),
    (lambda: ls.Sphere(ORIGIN, math.inf), ValueError, "radius: expected a finite number > 0, got inf"),
    (lambda: ls.Sphere(ORIGIN, [1.0, 2.0]), TypeError, "radius: expected a finite number > 0, got [1.0, 2.0]"),
    (lambda: ls.Sphere(ORIGIN, True), TypeError, "radius: expected a finite number > 0, got True"),
    (lambda: ls.Sphere((0, 0, math.nan), 1.0), ValueError, "center: expected finite numbers, got center[2] = nan"),
    (lambda: ls.Sphere(1.0, 1.0), ValueError, "center: expected shape (3,), got ()"),
    (lambda: ls.Ellipsoid(ORIGIN, (1, 0, 1)), ValueError, "radii: expected numbers > 0, got radii[1] = 0.0"),
    (lambda: ls.Ellipsoid(ORIGIN, (1, 2, -1e-300)), ValueError, "radii: expected numbers > 0, got radii[2] = -1e-300"),
    (lambda: ls.Ellipsoid(ORIGIN, 1.0), ValueError, "radii: expected shape (3,), got ()"),
    (lambda: ls.Ellipsoid(ORIGIN, (1, 1, 1), np.eye(4)), ValueError, "rotation: expected shape (3, 3), got (4, 4)"),
    (
        lambda: ls.Ellipsoid(ORIGIN, (1, 1, 1), np.ones((3, 3))),
        ValueError,
        "rotation: expected an invertible matrix, got determinant 0",
    ),
    (lambda: ls.Box((1, 1, 0)), ValueError, "size: expected numbers > 0, got size[2] = 0.0"),
    (lambda: ls.Box((1, -1, 1)), ValueError, "size: expected numbers > 0, got size[1] = -1.0"),
    (lambda: ls.Box((1, math.inf, 1)), ValueError, "size: expected finite numbers, got size[1] = inf"),
    (lambda: ls.Box((1, 1, 1), (0, 0)), ValueError, "center: expected shape (3,), got (2,)"),
    (
        lambda: ls.Cylinder(X, X, 1.0),
        ValueError,
        "end: expected a point other than start, got (1.0, 0.0, 0.0) for both",
    ),
    (lambda: ls.Cylinder(ORIGIN, Z, 0), ValueError, "radius: expected a finite number > 0, got 0.0"),
    (lambda: ls.Cylinder(ORIGIN, Z, 1.0, "yes"), TypeError, "capped: expected a bool, got 'yes'"),
    (lambda: ls.Cylinder(ORIGIN, (0, 0, math.nan), 1.0), ValueError, "end: expected finite numbers, got end[2] = nan"),
    (
        lambda: ls.Capsule(X, X, 1.0),
        ValueError,
        "end: expected a point other than start, got (1.0, 0.0, 0.0) for both",
    ),
    (lambda: ls.Capsule(ORIGIN, Z, -1), ValueError, "radius: expected a finite number > 0, got -1.0"),
    (lambda: ls.Capsule((0, math.inf, 0), Z, 1.0), ValueError, "start: expected finite numbers, got start[1] = inf"),
    (lambda: ls.Spheres([ORIGIN, X], [1.0, 0.0]), ValueError, "radii: expected numbers > 0, got radii[1] = 0.0"),
    (lambda: ls.Spheres([ORIGIN, X], -1), ValueError, "radii: expected numbers > 0, got radii = -1.0"),
    (lambda: ls.Spheres([ORIGIN, X], [1.0] * 3), ValueError, "radii: expected shape (2,), got (3,)"),
    (lambda: ls.Spheres(ORIGIN, 1.0), ValueError, "centers: expected shape (n, 3), got (3,); of one, [[x, y, z]]"),
    (
        lambda: ls.Disks([ORIGIN, X], [Z, ORIGIN], 1.0),
        ValueError,
        "normals: expected non-zero vectors, got normals[1] = (0, 0, 0)",
    ),
    (lambda: ls.Disks([ORIGIN, X], [Z], 1.0), ValueError, "normals: expected shape (2, 3), got (1, 3)"),
    (
        lambda: ls.Disks([ORIGIN, (0, math.nan, 0)], [Z, Z], 1.0),
        ValueError,
        "centers: expected finite numbers, got centers[1][1] = nan",
    ),
    (
        lambda: ls.Disks.from_points([ORIGIN, X, Z]),
        ValueError,
        "points: expected more than 16 different points, got 3",
    ),
    (
        lambda: ls.Disks.from_points([ORIGIN, X, Z], neighbours=2),
        ValueError,
        "neighbours: expected an integer >= 3, got 2",
    ),
    (lambda: ls.Disk(ORIGIN, ORIGIN, 1.0), ValueError, "normal: expected a non-zero vector, got [0.0, 0.0, 0.0]"),
    (lambda: ls.Disk(ORIGIN, Z, 0.0), ValueError, "radius: expected a finite number > 0, got 0.0"),
    (
        lambda: ls.Disk(ORIGIN, (0, math.nan, 1), 1.0),
        ValueError,
        "normal: expected finite numbers, got normal[1] = nan",
    ),
    (
        lambda: ls.Triangle(*COLLINEAR),
        ValueError,
        ON_A_LINE + "[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [-3.0, -6.0, -9.0]",
    ),
    (
        lambda: ls.Triangle(X, Y, X),
        ValueError,
        ON_A_LINE + "[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]",
    ),
    # 0.1, 0.3 and 0.7 times (1, 1, 1): on one line for the numbers as they are
    (
        lambda: ls.Triangle((0.1,) * 3, (0.3,) * 3, (0.7,) * 3),
        ValueError,
        ON_A_LINE + "[0.1, 0.1, 0.1], [0.3, 0.3, 0.3], [0.7, 0.7, 0.7]",
    ),
    (lambda: ls.Polygon(SQUARE[:2]), ValueError, "vertices: expected at least 3, got 2"),
    (lambda: ls.Polygon(np.empty((0, 3))), ValueError, "vertices: expected at least 3, got 0"),
    (
        lambda: ls.Polygon([(0, 0), (1, 0), (1, 1)]),
        ValueError,
        "vertices: expected shape (n, 3), got (3, 2); transposed?",
    ),
    (
        lambda: ls.Polygon([ORIGIN, X, (0, math.nan, 0)]),
        ValueError,
        "vertices: expected finite numbers, got vertices[2][1] = nan",
    ),
    (
        lambda: ls.Polygon([ORIGIN, X, X, Y]),
        ValueError,
        "vertices: expected neighbours to differ, got (1.0, 0.0, 0.0) for vertices 1 and 2",
    ),
    (
        lambda: ls.Polygon([ORIGIN, X, Y, ORIGIN]),
        ValueError,
        "vertices: expected neighbours to differ, got (0.0, 0.0, 0.0) for vertices 3 and 0",
    ),
    (
        lambda: ls.Polygon([(-1, -2, 0), ORIGIN, (1, 2, 0)]),
        ValueError,
        "vertices: expected a polygon with an area, got area 0",
    ),
    (
        lambda: ls.Polygon(COLLINEAR),
        ValueError,
        "vertices: expected an outline that does not touch itself, got edges 0 and 1 that do",
    ),
    (
        lambda: ls.Polygon([SQUARE[0], SQUARE[2], SQUARE[1], (0, 2, 0)]),
        ValueError,
        "vertices: expected an outline that does not touch itself, got edges 0 and 2 that do",
    ),
    (
        lambda: ls.Polygon([(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0, 0), (0, 2, 0)]),
        ValueError,
        "vertices: expected an outline that does not touch itself, got edges 0 and 2 that do",
    ),
    (
        lambda: ls.Polygon([(0, 0, 0.25), (1, 0, -0.25), (1, 1, 0.25), (0, 1, -0.25)]),
        ValueError,
        "vertices: expected points of one plane to within rounding (5.33e-15 m), got a deviation of 0.25 m",
    ),
]


@pytest.mark.parametrize(
    ("make", "error", "message"), BAD, ids=[f"{i}-{message}" for i, (_, _, message) in enumerate(BAD)]
)
def test_bad_shape(make, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        make()


def test_planarity_is_judged_by_rounding():
    # a plane outline turned in float64 is off its plane by roundings, near the origin and far from it
    rng = np.random.default_rng(0)
    outline = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)], dtype=float)
    from scipy.spatial.transform import Rotation

    for shift in (0.0, 1.0, 5e6, 1e9):
        for turn in Rotation.random(20, rng=rng):
            vertices = turn.apply(outline) + shift
            polygon = ls.Polygon(vertices)
            inside = vertices[0] * 0.7 + vertices[3] * 0.3
            origins = inside + turn.apply([[0, 0, 5.0]])
            assert polygon.cast(origins, turn.apply([[0, 0, -1.0]])).hit.all()
            bent = vertices.copy()
            bent[2] += turn.apply([0, 0, 1e-6 * max(1.0, shift)])
            with pytest.raises(
                ValueError,
                match=r"^vertices: expected points of one plane to within rounding \(.* m\), got a deviation of .* m$",
            ):
                ls.Polygon(bent)


@pytest.mark.parametrize("power", [-330, -100, 100, 330])
def test_small_and_large_shapes_are_legal(power):
    size = 2.0**power
    for shape in (
        ls.Sphere(ORIGIN, size),
        ls.Box((2 * size,) * 3),
        ls.Cylinder((0, 0, -size), (0, 0, size), size),
        ls.Capsule((0, 0, -size), (0, 0, size), size),
        ls.Ellipsoid(ORIGIN, (size, size, size)),
    ):
        np.testing.assert_array_equal(shape.roots([(-3 * size, 0, 0)], [(size, 0, 0)]), [[2.0, 4.0]])
        np.testing.assert_array_equal(shape.roots([(-3 * size, 0, 0)], [(1.0, 0, 0)]), [[2.0 * size, 4.0 * size]])
    square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * size
    mesh = ls.TriangleMesh(square, [(0, 1, 2), (0, 2, 3)])
    for shape in (ls.Polygon(square), mesh, ls.Triangle(*square[:3]), ls.Disk(ORIGIN, (0, 0, size), size)):
        hits = shape.cast([(0.5 * size, 0.25 * size, 3 * size)], [(0, 0, -size)])
        assert hits.t[0] == 3.0
        np.testing.assert_array_equal(hits.normal, [Z])
