"""Scenes: the nearest of many objects and the lowest of equals, decided exactly, the same on any number of threads."""

from __future__ import annotations

import itertools
import math
import os
import re
import threading
import time

import numpy as np
import pytest
from conformance.samples import SAMPLES, Move
from exact import cases, oracle

import lidarsim as ls


def check(specs, origins, directions, t_min=0.0, t_max=math.inf):
    """Assert that a scene of (spec, transform) agrees with brute force over exact roots, and return the hits."""
    scene, judge = ls.Scene(), oracle.Scene()
    for number, (spec, transform) in enumerate(specs):
        assert scene.add(spec.build(), transform=transform) == number
        judge.add(spec.judge(), transform)
    hits = scene.cast(origins, directions, t_min=t_min, t_max=t_max)
    for i, (o, d) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        want = judge.nearest(oracle.Ray.of(o, d), t_min, t_max)
        got = (int(hits.object_id[i]), int(hits.primitive_id[i]), float(hits.t[i]))
        if want is None:
            assert got[0] == -1
            assert math.isinf(got[2])
            continue
        number, crossing = want
        primitive = min(crossing.faces) if judge.shapes[number].primitives else 0
        assert got == (number, primitive, float(crossing.t)), (i, o, d)
    return hits


def random_specs(rng, count, spread=8.0):
    """Shapes of every kind, overlapping, some of them moved."""
    basic = list(cases.basic_specs().values())[1:]
    for _ in range(count):
        matrix = np.eye(4)
        matrix[:3, :3] = cases.rotations(1, int(rng.integers(1 << 30)))[0] * rng.uniform(0.2, 2, 3)
        matrix[:3, 3] = rng.uniform(-spread, spread, 3)
        yield basic[rng.integers(len(basic))], matrix


def random_rays(rng, n, spread=8.0):
    origins = rng.uniform(-spread, spread, (n, 3))
    directions = rng.uniform(-spread, spread, (n, 3)) - origins
    directions[: n // 5] = np.eye(3)[rng.integers(0, 3, n // 5)] * rng.choice([-1, 1], (n // 5, 1))
    return origins, directions


@pytest.mark.parametrize("count", [1, 2, 9, 70])
def test_nearest_of_many(count):
    rng = np.random.default_rng(count)
    specs = list(random_specs(rng, count, spread=2.0 * count ** (1 / 3)))
    specs.append((cases.Spec("Plane", ((0.1, 0.0, 1.0), -3.0)), None))
    origins, directions = random_rays(rng, 150, spread=2.5 * count ** (1 / 3))
    hits = check(specs, origins, directions)
    assert hits.hit.sum() > 50
    assert len(set(hits.object_id.tolist())) > min(count, 10) / 2
    check(specs, origins, directions, t_min=0.2, t_max=0.5)


@pytest.mark.parametrize("shift", [5e6, 1e9])
def test_nearest_of_many_far_away(shift):
    rng = np.random.default_rng(11)
    specs = []
    for spec, matrix in random_specs(rng, 30, spread=3.0):
        moved = matrix.copy()
        moved[:3, 3] += shift
        specs.append((spec, moved))
    origins, directions = random_rays(rng, 100, spread=3.0)
    assert check(specs, origins + shift, directions).hit.sum() > 50


@pytest.mark.parametrize("distance", [5e5, 1e8, 1e12, 1e20])
def test_nearest_of_many_from_far_away(distance):
    """Bounds are worked out from points near the scene there; the hits are those of the rays as given."""
    rng = np.random.default_rng(12)
    specs = list(random_specs(rng, 30, spread=3.0))
    specs.append((cases.Spec("TriangleMesh", cases.closed_meshes()["torus"][:2]), None))
    targets, ways = rng.uniform(-3, 3, (120, 3)), rng.normal(size=(120, 3))
    targets[: len(targets) // 2], ways[:40] = rng.uniform(-1, 1, (60, 3)), ways[0]
    ways[40:60] = np.eye(3)[rng.integers(0, 3, 20)]
    origins = targets + distance * ways
    directions = (targets - origins) * 2.0 ** rng.integers(-40, 40, (120, 1))
    hits = check(specs, origins, directions)
    # From very far, float64 origins and directions say no better where the rays go.
    assert hits.hit.sum() > (50 if distance < 1e15 else 0)
    check(specs, origins, directions, t_min=float(np.nanmin(hits.t)), t_max=float(np.median(hits.t[hits.hit])))


def coincident():
    """Different shapes that meet the ray along −z at (x, y) at exactly the same t, 5 − z = 4, in the centre."""
    triangle = cases.Spec("Triangle", ((-4, -4, 1), (4, -4, 1), (0, 8, 1)))
    return {
        "triangle": triangle,
        "triangle-again": triangle,
        "polygon": cases.Spec("Polygon", (np.array([(-4, -4, 1), (4, -4, 1), (4, 4, 1), (-4, 4, 1.0)]),)),
        "plane": cases.Spec("Plane", ((0, 0, 1), 1.0)),
        "box": cases.Spec("Box", ((2, 2, 2),)),
        "cylinder": cases.Spec("Cylinder", ((0, 0, -1), (0, 0, 1), 3.0)),
        "sphere": cases.Spec("Sphere", ((0, 0, 0), 1.0)),
        "ellipsoid": cases.Spec("Ellipsoid", ((0, 0, -1), (1, 1, 2))),
        "mesh": cases.Spec(
            "TriangleMesh", (np.array([(-4, -4, 1), (4, -4, 1), (0, 8, 1.0)]), np.array([(2, 1, 1), (0, 1, 2)]))
        ),
    }


@pytest.mark.parametrize("first", coincident())
def test_tie_goes_to_the_lowest_object(first):
    shapes = coincident()
    order = [first, *(name for name in shapes if name != first)]
    specs = [(shapes[name], None) for name in order]
    quarter = np.arange(-8, 9) / 4
    origins = np.array([(0.0, 0.0, 5.0), *((x, y, 5.0) for x in quarter for y in quarter)])
    directions = np.tile((0.0, 0.0, -1.0), (len(origins), 1))
    hits = check(specs, origins, directions)
    assert hits.object_id[0] == 0
    assert hits.t[0] == 4
    hits = check(specs[::-1], origins, directions)
    assert hits.object_id[0] == 0


def test_tie_of_irrational_roots_goes_to_the_lowest_object():
    # the same ball four times over, by other arithmetic each time, and one that is larger by an ulp
    doubled = np.diag([2.0, 2.0, 2.0, 1.0])
    specs = [
        (cases.Spec("Ellipsoid", ((0.5, 0.25, 0), (1.5, 1.5, 1.5), cases.rotations(1, 0)[0])), None),
        (cases.Spec("Sphere", ((0.25, 0.125, 0), 0.75)), doubled),
        (cases.Spec("Sphere", ((0.5, 0.25, 0), 1.5)), None),
        (cases.Spec("Ellipsoid", ((0.5, 0.25, 0), (1.5, 1.5, 1.5))), None),
        (cases.Spec("Sphere", ((0.5, 0.25, 0), 1.5)), None),
    ]
    rng = np.random.default_rng(12)
    origins, directions = random_rays(rng, 200, 3.0)
    assert check(specs[1:], origins, directions).hit.sum() > 40
    hits = check(specs[1:], origins, directions)
    assert set(hits.object_id[hits.hit].tolist()) == {0}
    hits = check(specs, origins, directions)  # a rounded rotation makes another surface: either may be nearer
    assert len(set(hits.object_id[hits.hit].tolist())) == 2
    larger = (cases.Spec("Sphere", ((0.5, 0.25, 0), math.nextafter(1.5, 2))), None)
    hits = check([*specs[1:], larger], origins, directions)
    assert len(set(hits.object_id[hits.hit].tolist())) == 2  # seen from outside the larger, from inside the smaller


def test_roots_closer_than_an_ulp_are_told_apart():
    # spheres within one another that touch at (0, 0, 1): the largest lies highest all around that point
    specs = [(cases.Spec("Sphere", ((0, 0, -k), 1.0 + k)), None) for k in (8.0, 4.0, 2.0, 1.0)]
    rng = np.random.default_rng(13)
    aside = rng.choice([-1, 1], (80, 2)) * 10.0 ** rng.uniform(-12, 0, (80, 2))
    origins = np.concatenate([aside, np.full((80, 1), 3.0)], axis=1)
    down, through = np.tile((0.0, 0.0, -1.0), (80, 1)), np.array((0.0, 0.0, 1.0)) - origins
    for order in (1, -1):
        hits = check(specs[::order], origins, down)
        assert set(hits.object_id.tolist()) == {0 if order == 1 else 3}
        assert (hits.t == 2.0).sum() > 5  # all four round to the same
        hits = check(specs[::order], origins, through)
        assert set(hits.object_id.tolist()) == {0}  # a tie, exactly
        assert set(hits.t.tolist()) == {1.0}


def test_instances_share_a_mesh():
    vertices, faces, _ = cases.closed_meshes()["torus"]
    mesh = cases.Spec("TriangleMesh", (vertices, faces))
    rng = np.random.default_rng(14)
    shape, scene, judge = mesh.build(), ls.Scene(), oracle.Scene()
    for _, matrix in random_specs(rng, 12, spread=4.0):
        scene.add(shape, transform=matrix)
        judge.add(mesh.judge(), matrix)
    origins, directions = random_rays(rng, 100, 4.0)
    hits = scene.cast(origins, directions)
    assert hits.hit.sum() > 30
    for i, ray in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        want = judge.nearest(oracle.Ray.of(*ray))
        assert hits.object_id[i] == (-1 if want is None else want[0])
        if want is not None:
            assert (hits.primitive_id[i], hits.t[i]) == (min(want[1].faces), float(want[1].t))


def test_empty_scene_and_no_rays_are_legal():
    scene = ls.Scene()
    hits = scene.cast([[0, 0, 0]], [[1, 0, 0]])
    np.testing.assert_array_equal(hits.t, [math.inf])
    np.testing.assert_array_equal(hits.object_id, [-1])
    scene.add(ls.Sphere((0, 0, 0), 1.0))
    assert len(scene.cast(np.empty((0, 3)), np.empty((0, 3)))) == 0


def test_whole_scene_moved_and_scaled_by_powers_of_two_keeps_every_bit():
    rng = np.random.default_rng(16)
    places = [Move(shift=np.array(shift)) for shift in itertools.product((-2.0, 0.0, 2.0), repeat=3)]
    origins = rng.integers(-40, 41, (400, 3)) / 8
    directions = rng.integers(-24, 25, (400, 3)) / 8 - origins
    directions[~directions.any(axis=1)] = (1, 0, 0)

    def cast(move):
        scene = ls.Scene()
        for number, place in enumerate(places):
            sample = SAMPLES[number % len(SAMPLES)]
            scene.add(sample.build(Move(scale=move.scale, shift=move.point(place.shift))))
        return scene.cast(move.point(origins), move.vector(directions))

    still = cast(Move())
    assert still.hit.sum() > 200
    assert len(set(still.object_id.tolist())) > 15
    for move in (
        Move(shift=np.array((2.0**20, 2.0**21, -(2.0**22)))),
        Move(shift=np.full(3, 2.0**33)),
        Move(scale=2.0**-30),
        Move(scale=2.0**12, shift=np.full(3, 2.0**40)),
    ):
        moved = cast(move)
        for name in ("t", "object_id", "primitive_id"):
            np.testing.assert_array_equal(getattr(moved, name), getattr(still, name))
        np.testing.assert_allclose(moved.normal, still.normal, rtol=0, atol=2.0**-50)


def test_scene_grows_between_casts():
    scene = ls.Scene()
    ray = ([[0, 0, 0]], [[1, 0, 0]])
    for distance in (9, 5, 7, 3):
        scene.add(ls.Plane((1, 0, 0), distance))
        assert scene.cast(*ray).t[0] == min(d for d in (9, 5, 7, 3)[: len(scene.objects)])


BAD_OBJECTS = [
    (
        {"shape": "a ball"},
        TypeError,
        "shape: expected a lidarsim shape, got str; TriangleMesh.from_file(path) reads a mesh",
    ),
    ({"name": 3}, TypeError, "name: expected a string, got 3"),
    ({"label": -1}, ValueError, "label: expected an integer from 0 to 4294967295, got -1"),
    ({"label": 2**32}, ValueError, "label: expected an integer from 0 to 4294967295, got 4294967296"),
    (
        {"label": np.arange(12)},
        TypeError,
        "label: expected one integer, or a TriangleMesh, Spheres or Disks for one each, got Sphere",
    ),
    ({"label": 1.5}, TypeError, "label: expected an integer from 0 to 4294967295, got 1.5"),
    ({"material": 0.5}, TypeError, "material: expected a Material, got float"),
]


@pytest.mark.parametrize(("keywords", "error", "message"), BAD_OBJECTS)
def test_bad_objects(keywords, error, message):
    scene = ls.Scene()
    shape = keywords.pop("shape", ls.Sphere((0, 0, 0), 1.0))
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        scene.add(shape, **keywords)
    assert len(scene.objects) == 0


def many_bits():
    """Of hits and roots in a scene that is built for them, with one object that is badly conditioned."""
    rng = np.random.default_rng(0)
    scene, specs = ls.Scene(), cases.basic_specs().values()
    vertices, faces, _ = cases.closed_meshes()["torus"]
    mesh = ls.TriangleMesh(vertices, faces)
    for spec in specs:
        scene.add(spec.build())
    for matrix in cases.transforms().values():
        scene.add(mesh, transform=matrix)
    origins = rng.normal(size=(3000, 3)) * 4
    directions = rng.normal(size=(3000, 3))
    directions[:1000] = np.round(directions[:1000])
    directions[~directions.any(axis=1)] = 1.0
    hits = scene.cast(origins, directions)
    assert hits.hit.sum() > 1000
    roots = [spec.build().roots(origins, directions) for spec in specs]
    return b"".join(array.tobytes() for array in (hits.t, hits.object_id, hits.primitive_id, hits.normal, *roots))


def test_same_bits_on_any_number_of_threads_and_instruction_set(instruction_sets, monkeypatch):
    assert "scalar" in instruction_sets
    found = set()
    for threads, isa in [*((2, isa) for isa in instruction_sets), (1, instruction_sets[-1]), (7, instruction_sets[-1])]:
        monkeypatch.setenv("LIDARSIM_THREADS", str(threads))
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        assert (ls._native.threads(), ls._native.isa()) == (threads, isa)
        found.add(many_bits())
    assert len(found) == 1


def test_unknown_instruction_set(monkeypatch):
    monkeypatch.setenv("LIDARSIM_ISA", "mmx")
    message = 'LIDARSIM_ISA: expected scalar, avx2 or avx512, got "mmx"'
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Sphere((0, 0, 0), 1.0).cast([[0, 0, 0]], [[1, 0, 0]])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_casts_go_on_after_fork():
    shape = ls.Sphere((0, 0, 0), 1.0)
    rng = np.random.default_rng(15)
    origins, directions = rng.normal(size=(20000, 3)) * 2, rng.normal(size=(20000, 3))
    want = shape.cast(origins, directions)  # the pool of threads stands before the fork
    child = os.fork()
    if child == 0:
        same = False
        try:
            same = np.array_equal(shape.cast(origins, directions).t, want.t)
        finally:
            os._exit(0 if same else 1)
    _, status = os.waitpid(child, 0)
    assert status == 0
    np.testing.assert_array_equal(shape.cast(origins, directions).t, want.t)


def test_threads_that_cast_first_at_once():
    """The first cast builds, with threads that also take up other work meanwhile: none may wait for itself."""
    n = 200
    x, y = np.meshgrid(np.arange(float(n)), np.arange(float(n)))
    vertices = np.stack([x, y, np.sin(x) * np.cos(y)], axis=-1).reshape(-1, 3)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    for _ in range(5):
        mesh = ls.TriangleMesh(vertices, faces)
        scenes = [ls.Scene(), ls.Scene()]
        for scene in scenes:
            scene.add(mesh)
        found = cast_at_once(scenes * 4, (100.25, 100.5, 9.0), (0.0, 0.0, -1.0))
        assert len(found) == 8, "threads wait for each other"
        assert len(set(found)) == 1
        assert 8.0 < found[0] < 10.0


def cast_at_once(scenes, origin, direction):
    """Return the t of those casts, a thread each, that ended within half a minute."""
    found = []
    start = threading.Barrier(len(scenes))

    def cast(scene):
        start.wait()
        found.append(scene.cast([origin], [direction]).t[0])

    threads = [threading.Thread(target=cast, args=(scene,), daemon=True) for scene in scenes]
    for thread in threads:
        thread.start()
    end = time.monotonic() + 30.0
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    return found
