"""The oracle itself, against mpmath at 2000 bits, rational arithmetic, and hand-made answers."""

from __future__ import annotations

import ast
import math
import random
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
from exact import adversarial, cases, oracle
from exact.oracle import Ray, Surd


def mp(surd, bits=2000):
    with mpmath.workprec(bits):
        return (surd.p + surd.s * mpmath.sqrt(surd.d)) / surd.q


def some_surds(n=300, seed=0):
    rng = random.Random(seed)
    for _ in range(n):
        size = rng.choice((4, 60, 300))
        p, q, s, d = (rng.getrandbits(rng.randrange(1, size)) for _ in range(4))
        yield Surd(rng.choice((-1, 1)) * p, q + 1, rng.choice((-1, 0, 1)) * s, d)
    for k in (10, 100, 300):  # cancels to 2^-k of its parts
        yield Surd(-(1 << k), 1, 1, (1 << 2 * k) + 1)
        yield Surd((1 << k) + 1, 3, -1, 1 << 2 * k)


def test_imports_nothing_of_what_it_judges():
    tree = ast.parse(Path(oracle.__file__).read_text(encoding="utf-8"))
    modules = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    modules |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert modules == {
        "__future__",
        "collections.abc",
        "dataclasses",
        "fractions",
        "math",
        "numpy",
        "numpy.typing",
        "typing",
    }


def test_surds_round_correctly():
    irrational = 0
    for surd in some_surds():
        if surd.s == 0:
            assert float(surd) == float(Fraction(surd.p, surd.q))
            continue
        irrational += 1
        with mpmath.workprec(53):
            assert float(surd) == float(+mp(surd))
    assert irrational > 100


def test_surds_overflow_and_underflow():
    assert float(Surd(1, 1 << 2000)) == 0.0
    assert float(Surd(-1 << 2000, 1)) == -math.inf
    assert float(Surd(3, 1 << 1076)) == 5e-324
    assert float(Surd(0, 1 << 1080, 1, 10)) == 0.0
    assert Surd(1 << 2000, 1).ulps(math.inf) == 0


def test_surds_compare_exactly():
    surds = list(some_surds(60, 1))
    equal = 0
    for a in surds:
        for b in surds:
            difference = mp(a, 4000) - mp(b, 4000)
            sign = 0 if abs(difference) < mpmath.mpf(2) ** -3000 else int(mpmath.sign(difference))
            assert a.compare(b) == sign
            equal += sign == 0 and a is not b
    assert Surd(0, 1, 2, 2) == Surd(0, 1, 1, 8)
    assert Surd(1, 1, 1, 2) == Surd(3, 3, 1, 18)
    assert Surd(0, 1, 1, 2) < Surd(1, 1, 1, 3)
    assert not Surd(1, 2) < Surd(2, 4)


def test_ulps_are_of_the_exact_value():
    half = Surd((1 << 54) + 1, 1 << 54)  # 1 + 2^-54, a quarter of an ulp above 1
    assert half.ulps(1.0) == 0.25
    assert half.ulps(1 + 2.0**-52) == 0.75
    root = Surd(0, 1, 1, 2)
    assert root.ulps(math.sqrt(2)) < 0.5
    assert 1 < root.ulps(math.nextafter(math.nextafter(math.sqrt(2), 2), 2)) < 3


def mp_quadratic(matrix, center, origin, direction):
    """Roots for the affine image of the unit sphere, in plain mpmath, the way of the textbook."""
    with mpmath.workprec(2000):
        inverse = mpmath.matrix(matrix) ** -1
        f = inverse * (mpmath.matrix([mpmath.mpf(float(x)) for x in origin]) - mpmath.matrix(center))
        d = inverse * mpmath.matrix([mpmath.mpf(float(x)) for x in direction])
        a, b, c = (sum(x * y for x, y in zip(p, q, strict=True)) for p, q in ((d, d), (f, d), (f, f)))
        discriminant = b * b - a * (c - 1)
        if discriminant < 0:
            return []
        root = mpmath.sqrt(discriminant)
        found = [(-b - root) / a, (-b + root) / a]
        with mpmath.workprec(53):
            return [float(+t) for t in found]


@pytest.mark.parametrize("kind", ["Sphere", "Ellipsoid"])
def test_quadrics_against_mpmath(kind):
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(12):
        case = adversarial.random_case(rng, kind, 25)
        if case.spec.transform is not None:
            continue
        center, radii, *turn = case.spec.args
        axes = np.asarray(turn[0]) if turn else np.eye(3)
        with mpmath.workprec(2000):
            matrix = [
                [mpmath.mpf(float(axes[i, j])) * float(np.broadcast_to(radii, 3)[j]) for j in range(3)]
                for i in range(3)
            ]
        got = oracle.roots(case.spec.judge(), case.origins, case.directions)
        for o, d, surds in zip(case.origins, case.directions, got, strict=True):
            want = mp_quadratic(matrix, list(map(float, center)), o, d)
            if len(surds) != 1:  # no precision tells mpmath that a line is exactly tangent
                assert [float(t) for t in surds] == want
                checked += len(want)
    assert checked > 100


def fraction_triangle(a, b, c, o, d):
    """Möller–Trumbore in rationals."""
    a, b, c, o, d = ([Fraction(float(x)) for x in v] for v in (a, b, c, o, d))

    def minus(u, v):
        return [x - y for x, y in zip(u, v, strict=True)]

    def cross(u, v):
        return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]

    def dot(u, v):
        return sum(x * y for x, y in zip(u, v, strict=True))

    e, g, s = minus(b, a), minus(c, a), minus(o, a)
    p = cross(d, g)
    determinant = dot(e, p)
    if determinant == 0:
        return []
    q = cross(s, e)
    u, v = dot(s, p) / determinant, dot(d, q) / determinant
    return [dot(g, q) / determinant] if u >= 0 and v >= 0 and u + v <= 1 else []


def test_triangles_against_rationals():
    rng = np.random.default_rng(4)
    hits = misses = 0
    for _ in range(20):
        case = adversarial.random_case(rng, "Triangle", 40)
        if case.spec.transform is None:
            got = oracle.roots(case.spec.judge(), case.origins, case.directions)
            for o, d, surds in zip(case.origins, case.directions, got, strict=True):
                want = fraction_triangle(*case.spec.args, o, d)
                assert [Fraction(t.p, t.q) for t in surds] == want
                hits += len(want)
                misses += not want
    assert min(hits, misses) > 100


def test_mesh_filter_loses_nothing():
    vertices, faces, inside = cases.closed_meshes()["icosphere"]
    vertices = vertices * (1, 1e-3, 1) + 5e6
    origins, directions = cases.leak_rays(vertices, faces, inside + 5e6, np.random.default_rng(5))
    mesh = oracle.TriangleMesh(vertices, faces)
    alone = [oracle.TriangleMesh(vertices[face], [[0, 1, 2]]) for face in faces]
    for i in range(0, len(origins), 60):
        ray = Ray.of(origins[i].tolist(), directions[i].tolist())
        candidates = set(mesh._candidates(ray))
        assert len(candidates) < len(faces)
        hit = {f for f, triangle in enumerate(alone) if triangle.crossings(ray)}
        assert hit
        assert hit <= candidates


def test_polygon_is_the_union_of_its_triangles():
    import mapbox_earcut

    rng = np.random.default_rng(6)
    hits = misses = 0
    for _ in range(5):
        vertices = cases.star(9, rng)
        triangles = mapbox_earcut.triangulate_float64(vertices[:, :2], np.array([9], dtype=np.uint32)).reshape(-1, 3)
        targets = np.concatenate([np.rint(rng.uniform(-900, 900, (60, 2))), vertices[:, :2]])
        rays = [((*xy, 9e4), (0.0, 0.0, -1.0)) for xy in targets.tolist()]
        a = oracle.roots(oracle.Polygon(vertices), *zip(*rays, strict=True))
        b = oracle.roots(oracle.TriangleMesh(vertices, triangles), *zip(*rays, strict=True))
        assert a == b
        hits += sum(map(bool, a))
        misses += sum(not t for t in a)
    assert min(hits, misses) > 50


@pytest.mark.parametrize("capped", [True, False])
def test_cylinder_against_its_definition(capped):
    # every root lies on the surface and between two roots the line is inside: checked in 60-digit arithmetic
    rng = np.random.default_rng(7)
    checked = 0
    for _ in range(10):
        case = adversarial.random_case(rng, "Cylinder", 30)
        start, end, radius, _ = case.spec.args
        shape = oracle.Cylinder(start, end, radius, capped)
        for o, d in zip(case.origins.tolist(), case.directions.tolist(), strict=True):
            ray = Ray.of(o, d)
            crossings = shape.crossings(ray)
            for crossing in crossings:
                p = [x - Fraction(float(s)) for x, s in zip(ray.at(crossing.t), start, strict=True)]
                axis = [Fraction(float(e)) - Fraction(float(s)) for s, e in zip(start, end, strict=True)]
                square = sum(a * a for a in axis)
                along = sum(a * x for a, x in zip(axis, p, strict=True)) / square
                across = sum((x - along * a) ** 2 for x, a in zip(p, axis, strict=True)) / Fraction(float(radius)) ** 2
                tiny = Fraction(1, 10**40)
                assert -tiny <= along <= 1 + tiny
                assert across <= 1 + tiny
                on_side, on_cap = abs(across - 1) <= tiny, min(abs(along), abs(along - 1)) <= tiny
                assert on_side or (capped and on_cap)
                assert (0 in crossing.faces) <= on_side
                assert any(crossing.faces) <= on_cap
                checked += 1
    assert checked > 100


def distance_from_segment(point, start, end):
    """The squared distance, in rationals."""
    start, end = ([Fraction(x) for x in v.tolist()] for v in (start, end))
    axis, p = ([x - s for x, s in zip(v, start, strict=True)] for v in (end, point))
    along = sum(a * x for a, x in zip(axis, p, strict=True)) / sum(a * a for a in axis)
    along = min(max(along, Fraction(0)), Fraction(1))
    return sum((x - along * a) ** 2 for x, a in zip(p, axis, strict=True))


def test_capsule_against_its_definition():
    # A root is at the radius from the segment; a line is nearer between two roots and farther away elsewhere.
    rng = np.random.default_rng(8)
    counts = [0, 0, 0]
    for _ in range(20):
        case = adversarial.random_case(rng, "Capsule", 20)
        start, end, radius = case.spec.args
        square, tiny = Fraction(float(radius)) ** 2, Fraction(1, 10**40)
        for o, d in zip(case.origins.tolist(), case.directions.tolist(), strict=True):
            ray = Ray.of(o, d)
            crossings = oracle.Capsule(start, end, radius).crossings(ray)
            counts[len(crossings)] += 1
            ts = [crossing.t.fraction() for crossing in crossings]
            if len(ts) == 2:
                step = ts[1] - ts[0]
                inside, outside = [ts[0] + step / 2], [ts[0] - step, ts[1] + step]
            else:  # where the line is nearest to an end
                a = [
                    sum((Fraction(s) - Fraction(x)) * Fraction(y) for s, x, y in zip(e.tolist(), o, d, strict=True))
                    for e in (start, end)
                ]
                inside, outside = [], [x / sum(Fraction(y) ** 2 for y in d) for x in a] if not ts else []
            shares = [
                [distance_from_segment(ray.at(Surd(*t.as_integer_ratio())), start, end) / square for t in places]
                for places in (inside, outside)
            ]
            assert all(share <= 1 + tiny for share in shares[0])
            assert all(share > 1 for share in shares[1])
            for crossing in crossings:
                assert abs(distance_from_segment(ray.at(crossing.t), start, end) / square - 1) <= tiny
    assert min(counts[0], counts[2]) > 50


def test_disk_against_its_definition():
    rng = np.random.default_rng(9)
    crossed = [0, 0]
    for _ in range(20):
        case = adversarial.random_case(rng, "Disk", 30)
        center, normal, radius = ([Fraction(x) for x in np.ravel(v).tolist()] for v in case.spec.args)
        for o, d in zip(case.origins.tolist(), case.directions.tolist(), strict=True):
            crossings = oracle.Disk(*case.spec.args).crossings(Ray.of(o, d))
            crossed[len(crossings)] += 1
            f = [Fraction(x) - c for x, c in zip(o, center, strict=True)]
            slope = sum(n * Fraction(x) for n, x in zip(normal, d, strict=True))
            height = sum(n * x for n, x in zip(normal, f, strict=True))
            place = [x - height / slope * Fraction(y) for x, y in zip(f, d, strict=True)] if slope else None
            is_met = place is not None and sum(x * x for x in place) <= radius[0] ** 2
            assert [crossing.t.fraction() for crossing in crossings] == ([-height / slope] if is_met else [])
    assert min(crossed) > 50


def test_box_names_every_face_that_holds_the_point():
    box = oracle.Box((2, 2, 2))
    entry, leave = box.crossings(Ray.of((-3.0, -3.0, 0.0), (1.0, 1.0, 0.0)))
    assert (entry.faces, leave.faces) == ((0, 2), (1, 3))
    (corner,) = box.crossings(Ray.of((2.0, 0.0, 1.0), (-1.0, 1.0, 0.0)))
    assert corner.faces == (1, 3, 5)


def test_normals_under_reflection_stay_outward():
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    sphere = oracle.Transformed(oracle.Sphere((2, 0, 0), 1.0), mirror)
    ray = Ray.of((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    near, far = sphere.crossings(ray)
    np.testing.assert_array_equal(sphere.normals(ray, near), [[1, 0, 0]])
    np.testing.assert_array_equal(sphere.normals(ray, far), [[-1, 0, 0]])
