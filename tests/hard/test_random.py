"""Hypothesis on every shape: whatever finite numbers it thinks of, the answer is the exact one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact import cases, oracle
from exact.accuracy import judge_cast, judge_roots
from hypothesis import assume, given
from hypothesis import strategies as st

# Small integers make exact tangents, edges and ties likely; the others are of any mantissa, over 24 decades.
lattice = st.integers(-8, 8).map(float)
wide = st.tuples(st.floats(-1, 1), st.integers(-40, 40)).map(lambda pair: math.ldexp(*pair))
number = st.one_of(lattice, wide, st.sampled_from([0.1, 1 / 3, 5e-324, -0.0, 1e-12, 1e9]))
length = st.one_of(
    st.integers(1, 9).map(float), st.tuples(st.floats(0.5, 1), st.integers(-40, 40)).map(lambda p: math.ldexp(*p))
)
vector = st.tuples(number, number, number)
direction = vector.filter(any)
rays = st.lists(st.tuples(vector, direction), min_size=1, max_size=6)
matrices = st.one_of(st.none(), st.lists(number, min_size=12, max_size=12))


def turn(quaternion):
    """A rotation to within rounding; the shape takes the matrix as it is."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


turns = st.tuples(*[st.integers(-4, 4).map(float)] * 4).filter(any).map(turn)
shapes = {
    "Plane": st.tuples(direction, number),
    "Plane.from_point": st.tuples(vector, direction),
    "Plane.from_points": st.tuples(vector, vector, vector),
    "Sphere": st.tuples(vector, length),
    "Ellipsoid": st.tuples(vector, st.tuples(length, length, length), turns),
    "Box": st.tuples(st.tuples(length, length, length), vector),
    "Cylinder": st.tuples(vector, vector, length, st.booleans()),
    "Capsule": st.tuples(vector, vector, length),
    "Disk": st.tuples(vector, direction, length),
    "Spheres": st.tuples(*(st.lists(kind, min_size=3, max_size=3) for kind in (vector, length))),
    "Disks": st.tuples(*(st.lists(kind, min_size=3, max_size=3) for kind in (vector, direction, length))),
    "Triangle": st.tuples(vector, vector, vector),
    "TriangleMesh": st.tuples(
        st.lists(vector, min_size=5, max_size=5), st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=6)
    ),
}


def area(a, b, c):
    return any(oracle.Plane.from_points(a, b, c).n)


@pytest.mark.parametrize("kind", shapes)
def test_any_shape_any_ray(kind):
    tally = {"rays": 0, "hits": 0}

    @given(shapes[kind], matrices, rays)
    def check(arguments, matrix, lines):
        if kind in {"Plane.from_points", "Triangle"}:
            assume(area(*arguments))
        if kind in {"Cylinder", "Capsule"}:
            assume(arguments[0] != arguments[1])
        if matrix is not None:
            matrix = np.array([*matrix, 0, 0, 0, 1.0]).reshape(4, 4)
            assume(determinant(matrix))
        spec = cases.Spec(kind, arguments, matrix)
        if kind == "Ellipsoid":
            assume(np.linalg.det(arguments[2]) != 0)
        if kind in {"Triangle", "TriangleMesh"}:  # one ray that is aimed: of the others few hit
            corners = arguments if kind == "Triangle" else [arguments[0][i] for i in arguments[1][0]]
            middle = np.mean(corners, axis=0)
            middle = middle if matrix is None else matrix[:3, :3] @ middle + matrix[:3, 3]
            aim = tuple((middle - lines[0][0]).tolist())
            lines = [*lines, (lines[0][0], aim)] if any(aim) else lines
        origins, directions = np.array([o for o, _ in lines]), np.array([d for _, d in lines])
        shape = spec.build()
        hits = shape.cast(origins, directions)
        for verdict in (
            judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id),
            judge_roots(spec, origins, directions, shape.roots(origins, directions)),
        ):
            assert verdict.wrong == 0, verdict.first
            assert verdict.rounded == verdict.values, "not the exact value correctly rounded"
            tally["rays"] += verdict.rays
            tally["hits"] += verdict.hits

    check()
    assert tally["hits"] >= 10


def determinant(matrix):
    try:
        oracle.Transformed(oracle.Sphere((0, 0, 0), 1.0), matrix)
    except ValueError:
        return False
    return True


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(1, 3)), min_size=1, max_size=8), rays)
def test_any_scene_of_spheres(spheres, lines):
    import lidarsim as ls

    scene, judge = ls.Scene(), oracle.Scene()
    for x, y, r in spheres:
        scene.add(ls.Sphere((x, y, 0), r))
        judge.add(oracle.Sphere((x, y, 0), r))
    hits = scene.cast([o for o, _ in lines], [d for _, d in lines])
    for i, (o, d) in enumerate(lines):
        want = judge.nearest(oracle.Ray.of(o, d))
        assert (hits.object_id[i], hits.t[i]) == ((-1, math.inf) if want is None else (want[0], float(want[1].t)))


@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_any_star_shaped_polygon(points, seed):
    rng = np.random.default_rng(seed)
    vertices = cases.star(points + 1, rng)
    assume(len(np.unique(vertices, axis=0)) == len(vertices))
    spec = cases.Spec("Polygon", (vertices,))
    targets = np.concatenate([vertices, np.rint(rng.uniform(-900, 900, (10, 3)))])
    targets[:, 2] = 2 * targets[:, 0] - 3 * targets[:, 1]
    origins = np.rint(rng.uniform(-5000, 5000, targets.shape))
    directions = targets - origins
    assume(directions.any(axis=1).all())
    hits = spec.build().cast(origins, directions)
    verdict = judge_cast(spec, origins, directions, hits.t, primitives=hits.primitive_id)
    assert (verdict.wrong, verdict.rounded) == (0, verdict.values), verdict.first
