"""Moving objects: each ray meets each object at its pose at the time of the ray."""

from __future__ import annotations

import copy
import dataclasses
import math
import re
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim import _native
from lidarsim.scan.scan import scan as scan_pulses

ROUNDING = 2.0**-53
"""Largest relative error of a float64 that is rounded once."""

FLOAT32 = 2.0**-24
"""Likewise of a float32."""

Floats = npt.NDArray[np.float64]


def pose(position: Any = (0, 0, 0), turn: Any = (0, 0, 0)) -> Floats:
    """A rigid matrix, of a rotation vector."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    matrix[:3, 3] = position
    return matrix


def drive(seed: int = 0, place: float = 0.0, **more: Any) -> ls.Trajectory:
    """A motion through a few random poses from 0 to 2 s."""
    draw = np.random.default_rng(seed)
    poses = [pose(place + draw.uniform(-3, 3, 3), draw.uniform(-1, 1, 3)) for _ in range(5)]
    return ls.Trajectory([0.0, 0.3, 1.0, 1.5, 2.0], poses, **more)


def matrix_at(motion: ls.Trajectory, time: float) -> Floats:
    """The pose as its numbers are: `Trajectory.at` makes them orthonormal once more."""
    return motion._native.at(np.array([time]))[0]


def motions(place: float = 0.0) -> list[ls.Trajectory]:
    """One of each kind."""
    body = drive(3, place, interpolation="spline")
    return [
        drive(1, place),
        drive(2, place, interpolation="spline"),
        ls.Trajectory.from_twist(pose((place + 1, place - 1, place), (0.2, 0.1, -0.4)), (2, 1, 0.5), (0.4, -0.8, 1.2)),
        body @ pose((0.5, 1.0, -0.3), (0.1, 0.9, 0.2)),
        drive(5, place) @ pose((-1.0, 0.3, 0.2)),
    ]


SHEAR = np.array([[1.0, 0.25, 0, 0.5], [0, 2.0, 0.5, -0.25], [0, 0, -1.5, 0.125], [0, 0, 0, 1]])


def blob(transform: Floats | None = None) -> ls.TriangleMesh:
    """A closed mesh of 80 triangles."""
    import trimesh

    return ls.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=1, radius=1.5), transform=transform)


def shapes(transform: Floats | None = None) -> list[ls.Shape]:
    """One of each kind, some of which have edges and corners for rays to hit."""
    corners = [(-1, -1, 0.5), (1.5, -1, 0.5), (1, 1, 0.5), (0, 0.2, 0.5), (-1, 1.25, 0.5)]
    own: Any = {"transform": transform}
    return [
        ls.Sphere((0.5, 0, 0), 1.0, **own),
        ls.Box((1.0, 2.0, 1.5), (0.25, 0, 0), **own),
        blob(**own),
        ls.Cylinder((0, 0, -1), (0.5, 0, 1), 0.75, **own),
        ls.Ellipsoid((0, 0.5, 0), (0.5, 1.0, 1.5), **own),
        ls.Triangle((0, 0, 0), (2, 0, 0), (0, 2, 1), **own),
        ls.Polygon(corners, **own),
        blob(**own),
        ls.Plane((0.1, 0.2, 1.0), -8.0, **own),
        ls.Capsule((0, -0.5, -0.5), (0.25, 0, 0.75), 0.5, **own),
        ls.Disk((0.25, 0, 0.5), (0.5, -1, 2), 1.25, **own),
        ls.Spheres([(0.25, 0, 0.5), (-0.5, 0.25, 0), (0, -0.75, 0)], [0.5, 0.75, 0.25], **own),
        ls.Disks([(0.25, 0, 0.5), (-0.5, 0.25, 0)], [(0.5, -1, 2), (1, 1, 0)], [1.25, 0.75], **own),
    ]


@cache
def parts(*, sheared: bool) -> list[ls.Shape]:
    """The shapes, made once."""
    return shapes(SHEAR if sheared else None)


SHEARED = 3
"""Of so many movers one is transformed, and then moved."""


def moving_scene(place: float = 0.0) -> ls.Scene:
    """All shapes, transformed or not, on all kinds of motion, above a floor that stands still and others that do."""
    scene, paths = ls.Scene(), motions(place)
    scene.add(ls.Plane.from_point((place, place, place - 4), (0, 0, 1)), name="floor", label=1)
    for i, shape in enumerate(parts(sheared=False)):
        transform = SHEAR if i % SHEARED == 1 else None
        scene.add(shape, name=str(i), label=10 + i, transform=transform, motion=paths[i % 5])
    scene.add(parts(sheared=False)[1], name="box", label=2, transform=pose((place + 3, place, place)))
    scene.add(parts(sheared=False)[2], name="mesh", label=3, transform=pose((place - 3, place, place)))
    return scene


def freeze(scene: ls.Scene, time: float) -> ls.Scene:
    """The scene as it is at a time, of objects that do not move."""
    still = ls.Scene()
    for item in scene.objects:
        shape, transform = item.shape, item.transform
        if item.motion is not None:
            # A transform before the motion becomes the shape's own.
            shape = parts(sheared=transform is not None)[int(item.name)]
            transform = matrix_at(item.motion, time)
        still.add(shape, name=item.name, label=item.label, material=item.material, transform=transform)
    return still


def hard_rays(scene: ls.Scene, count: int, place: float = 0.0, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Rays at random, half of them at corners, edges and middles of what then moves there; some of the times recur."""
    draw = np.random.default_rng(seed)
    shared = draw.uniform(0, 2, max(count // 8, 1))
    times = np.where(draw.random(count) < 0.5, draw.choice(shared, count), draw.uniform(0, 2, count))
    times[:3] = 0.0, 2.0, 0.3
    origins = place + draw.uniform(-9, 9, (count, 3))
    targets = place + draw.uniform(-3, 3, (count, 3))
    mesh = blob()
    corners = mesh.vertices[mesh.faces]
    weights = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.25, 0.5], [0.5, 0, 0.5]])
    meshes = [item for item in scene.objects if isinstance(item.shape, ls.TriangleMesh) and item.motion]
    for i in range(0, count, 2):
        item = meshes[i // 2 % len(meshes)]
        point = weights[i // 2 % 4] @ corners[draw.integers(len(corners))]
        for matrix in (item.transform, matrix_at(item.motion, times[i])):
            point = point if matrix is None else matrix[:3, :3] @ point + matrix[:3, 3]
        targets[i] = point
    return origins, targets - origins, times


HITS = ("t", "object_id", "primitive_id", "normal")


def same(a: Any, b: Any) -> bool:
    """Whether two arrays have the same bits."""
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


@pytest.mark.parametrize("place", [0.0, 5e6])
def test_each_ray_sees_the_scene_as_it_is_at_its_time(
    place: float, instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch, slow: bool
) -> None:
    scene = moving_scene(place)
    origins, directions, times = hard_rays(scene, 4000 if slow else 600, place)
    known = [freeze(scene, t).cast(o, d) for o, d, t in zip(origins[:, None], directions[:, None], times, strict=True)]
    found = np.concatenate([hits.object_id for hits in known])
    assert len(np.unique(found)) > 9
    assert np.mean(found > 0) > 0.5
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        hits = scene.cast(origins, directions, time=times)
        for name in HITS:
            expected = np.concatenate([getattr(one, name) for one in known])
            wrong = np.flatnonzero((getattr(hits, name) != expected).reshape(len(times), -1).any(axis=1))
            assert not len(wrong), (isa, name, wrong)


def test_a_single_time_is_the_same_as_an_array_of_it() -> None:
    scene = moving_scene()
    origins, directions, times = hard_rays(scene, 3000)
    one = scene.cast(origins, directions, time=0.75)
    each = scene.cast(origins, directions, time=np.full(len(times), 0.75))
    still = freeze(scene, 0.75).cast(origins, directions)
    for name in HITS:
        assert same(getattr(one, name), getattr(each, name))
        assert same(getattr(one, name), getattr(still, name))
    assert not same(one.t, scene.cast(origins, directions, time=times).t)


def test_bits_hang_on_neither_threads_nor_instructions_nor_company(
    instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cast and a scan of what moves, whole, in parts and in other orders."""
    scene = moving_scene()
    origins, directions, times = hard_rays(scene, 3000)
    lidar, drives = dataclasses.replace(SENSOR, measurement=EVERYTHING), drive(9)
    draw = np.random.default_rng(0)
    # In turn, so that threads and packets have other rays beside them: all of them, others, and few.
    orders = [np.arange(3000), draw.permutation(3000)[:1777], np.arange(3000)[::-3]]
    hits, scan = scene.cast(origins, directions, time=times), lidar.scan(scene, drives, time=0.5, frame=3, seed=5)
    near = float(np.median(hits.t[hits.hit]))
    assert hits.hit.sum() > 2000
    assert np.count_nonzero(scan.object_id > 0) > 300
    ways = [(isa, threads) for isa in instruction_sets for threads in (1, 2, 3)]
    for i, (isa, threads) in enumerate(ways):
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        monkeypatch.setenv("LIDARSIM_THREADS", str(threads))
        assert (_native.isa(), _native.threads()) == (isa, threads)
        order = orders[i % 3]
        rays: Any = {"origins": origins[order], "directions": directions[order], "time": times[order]}
        part = scene.cast(**rays)
        for name in HITS:
            assert same(getattr(hits, name)[order], getattr(part, name)), (isa, threads, name)
        assert same(scene.occluded(**rays), hits.hit[order])
        assert same(scene.occluded(**rays, t_max=near), hits.t[order] <= near)
        pulses = orders[i % 3][orders[i % 3] < len(scan)]
        again = scan_pulses(lidar, scene, drives, time=0.5, frame=3, seed=5, indices=pulses)
        for name in (*ARRAYS, "radial_velocity"):
            assert same(getattr(scan, name)[pulses], getattr(again, name)), (isa, threads, name)


def rational(matrix: Floats) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in row] for row in matrix[:3]]


def to_body(matrix: Floats, point: list[Fraction]) -> list[Fraction]:
    """The point that an affine map takes there, by Cramer's rule."""
    m = rational(matrix)
    b = [point[i] - m[i][3] for i in range(3)]

    def determinant(columns: list[list[Fraction]]) -> Fraction:
        (a, d, g), (b, e, h), (c, f, i) = columns
        return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)

    columns = [[m[i][j] for i in range(3)] for j in range(3)]
    whole = determinant(columns)
    return [determinant([*columns[:j], b, *columns[j + 1 :]]) / whole for j in range(3)]


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("place", [0.0, 5e6])
def test_hits_on_a_moving_sphere_satisfy_its_equation_at_their_time(kind: int, place: float) -> None:
    motion = motions(place)[kind]
    center, radius = (0.25, -0.5, 1.0), 1.25
    scene = ls.Scene()
    scene.add(ls.Sphere(center, radius), motion=motion)
    draw = np.random.default_rng(kind)
    times = draw.uniform(0, 2, 60)
    middles = np.array([(matrix_at(motion, t) @ (*center, 1.0))[:3] for t in times])
    origins = place + draw.uniform(-9, 9, (60, 3))
    # A few graze it.
    aside = draw.normal(size=(60, 3))
    aside *= radius * np.where(np.arange(60) % 3, 0.5, 0.9999)[:, None] / np.linalg.norm(aside, axis=1)[:, None]
    directions = middles + aside - origins
    hits = scene.cast(origins, directions, time=times)
    assert hits.hit.sum() > 40

    def off(i: int, t: Fraction) -> Fraction:
        point = [Fraction(float(o)) + t * Fraction(float(d)) for o, d in zip(origins[i], directions[i], strict=True)]
        body = to_body(matrix_at(motion, times[i]), point)
        return sum(((x - Fraction(c)) ** 2 for x, c in zip(body, center, strict=True)), -(Fraction(radius) ** 2))

    for i in np.flatnonzero(hits.hit):
        t = float(hits.t[i])
        low, high = ((Fraction(t) + Fraction(float(np.nextafter(t, end)))) / 2 for end in (-math.inf, math.inf))
        # The surface is crossed, inwards, within half an ulp of t.
        assert off(i, low) >= 0 >= off(i, high) or off(i, low) <= 0 <= off(i, high)


def test_spans_of_time_do_not_change_one_another() -> None:
    # What moves is in the same hierarchy from cast to cast, around its places of each span, until that has worn out.
    scene, draw = ls.Scene(), np.random.default_rng(11)
    for k in range(300):
        place, heading = draw.uniform(-40, 40, 3), draw.uniform(-math.pi, math.pi)
        speed = (15.0, 0, 0) if k % 3 else (0.5, 0, 0)
        motion = ls.Trajectory.from_twist(pose(place, (0, 0, heading)), speed, (0, 0, 0.2))
        scene.add(ls.Sphere((0, 0, 0), 2.0), motion=motion)
    targets = draw.uniform(-40, 40, (3000, 3))
    origins = draw.uniform(-40, 40, (3000, 3))
    hits = 0
    for span in [(0.0, 0.1), (0.1, 0.2), (0.2, 0.3), (5.0, 5.1), (-3.0, 8.0), (0.0, 0.0), (60.0, 60.1), (0.1, 0.2)]:
        times = draw.uniform(*span, 3000)
        found = scene.cast(origins, targets - origins, time=times)
        anew = copy.deepcopy(scene).cast(origins, targets - origins, time=times)
        assert same(found.t, anew.t)
        assert same(found.object_id, anew.object_id)
        assert same(found.normal, anew.normal)
        hits += int(found.hit.sum())
        scene.update(7, shape=ls.Sphere((0, 0, 0), 1.0 + span[0] % 1))
        scene.update(8, motion=scene[9].motion)
    assert hits > 2000


def test_what_stands_still_is_not_changed_by_what_moves() -> None:
    scene = moving_scene()
    without = ls.Scene()
    for item in scene.objects:
        if item.motion is None:
            without.add(item.shape, transform=item.transform)
    origins, directions, times = hard_rays(scene, 2000)
    hits, known = scene.cast(origins, directions, time=times), without.cast(origins, directions)
    still = np.array([item.motion is None for item in scene.objects])
    on_still = hits.hit & still[hits.object_id]
    assert on_still.sum() > 200
    assert same(hits.t[on_still], known.t[on_still])
    assert same(hits.normal[on_still], known.normal[on_still])
    assert (hits.t <= known.t).all()


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_boxes_hold_what_moves_all_the_time(far: float) -> None:
    """Rays at single moments over a long time, so that boxes of the whole of it are large, and must still hold all."""
    turns = [pose((far + 30 * math.cos(k), 30 * math.sin(k), k), (0, 0, 2.5 * (k % 2))) for k in range(40)]
    movers = [
        ls.Trajectory(np.arange(40.0), turns),
        ls.Trajectory(np.arange(40.0), turns, interpolation="spline"),
        ls.Trajectory.from_twist(pose((far, 0, 0)), (9.0, 0, 0.5), (0, 0.1, 1.7)),
        ls.Trajectory(np.arange(40.0), turns) @ pose((12.0, 0, 3)),
    ]
    scene = ls.Scene()
    for motion in movers:
        scene.add(ls.Sphere((0, 0, 0), 0.25), motion=motion)
    times = np.repeat(np.linspace(0, 39, 300), 4)
    which = np.tile(np.arange(4), 300)
    targets = np.array([matrix_at(movers[k], t)[:3, 3] for k, t in zip(which, times, strict=True)])
    origins = np.tile((far + 5.0, -200.0, 80.0), (len(times), 1))
    hits = scene.cast(origins, targets - origins, time=times)
    # Each is aimed at the middle of its sphere, and hits that, or another one before it.
    assert hits.hit.all()
    assert (hits.t < 1).all()
    assert np.mean(hits.object_id == which) > 0.95


SENSOR = ls.Lidar(
    ls.patterns.Spinning(
        np.radians(np.linspace(-20, 15, 12)), columns=90, rate=10.0, firing_times=np.arange(12) * 2e-5
    ),
    measurement=ls.Measurement(),
)

EVERYTHING = ls.Measurement(
    range_sigma=0.01,
    range_bias=0.02,
    azimuth_sigma=1e-3,
    elevation_sigma=1e-3,
    dropout=0.1,
    extinction=1e-3,
    detection=ls.Detection(reflectivity=0.1, range=60.0),
    beam=ls.Beam(divergence_azimuth=3e-3, divergence_elevation=3e-3, pulse_length=3e-9, rays=7),
    returns=2,
)

ARRAYS = ("range", "true_range", "range_error", "intensity", "object_id", "label", "normal", "incidence", "status")


@pytest.mark.parametrize("measurement", [ls.Measurement(), EVERYTHING], ids=["exact", "everything"])
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_each_pulse_of_a_scan_sees_the_scene_as_it_then_is(measurement: ls.Measurement, moving: bool) -> None:
    lidar = dataclasses.replace(SENSOR, measurement=measurement)
    scene = moving_scene()
    where = drive(9) if moving else pose((1.0, 0.5, 2.5))
    scan = lidar.scan(scene, where, time=1.25, frame=3, seed=5)
    movers = np.array([item.motion is not None for item in scene.objects])
    assert movers[scan.object_id[scan.object_id >= 0]].sum() > 100
    for i in range(0, len(scan), 7 if measurement is EVERYTHING else 3):
        time = 1.25 + scan.pulses.time[i]
        one = scan_pulses(lidar, freeze(scene, time), where, time=1.25, frame=3, seed=5, indices=[i])
        for name in ARRAYS:
            assert same(getattr(scan, name)[i], getattr(one, name)[0]), (i, name)


def test_a_mover_seen_by_a_still_sensor_is_a_still_object_seen_by_one_that_moves_the_other_way() -> None:
    """By binary fractions along an axis the relative poses are the same numbers, and so all ranges."""
    columns = 64
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.3, 0.3, 9), rate=8.0))
    times = np.repeat(np.arange(columns) / 1024, 9)
    pulses = lidar.pattern.pulses()
    order = np.argsort(pulses.column, kind="stable")
    table = ls.patterns.Table(pulses.directions[order], times=times, rate=8.0)
    lidar = ls.Lidar(table)
    there, back = (ls.Trajectory.from_twist(np.eye(4), (v, 0, 0)) for v in (16.0, -16.0))
    for shape in (ls.Sphere((12, 0, 0), 3.0), ls.Box((4, 8, 3), (14, 1, 0)), blob(pose((9, 0, 0)))):
        moving, still = ls.Scene(), ls.Scene()
        moving.add(shape, motion=there)
        still.add(shape)
        a, b = lidar.scan(moving), lidar.scan(still, back)
        assert np.isfinite(a.range).sum() > 50
        for name in (*ARRAYS, "radial_velocity"):
            assert same(getattr(a, name), getattr(b, name)), name
        assert same(a.point_cloud().xyz, b.point_cloud().xyz)


def inverse(pose: Floats) -> Floats:
    """Of a rigid matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = pose[:3, :3].T
    matrix[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return matrix


def there_and_back(kind: str) -> tuple[ls.Trajectory, ls.Trajectory]:
    """A motion, and the one whose pose is the inverse at any time."""
    if kind == "screw":
        # (P exp(tξ))⁻¹ = P⁻¹ exp(−tP^ξ), where P^ turns a twist (v, ω) into (Rv + p × Rω, Rω).
        start, linear, angular = (
            pose((6.0, 2.0, -1.0), (0.3, -0.2, 0.9)),
            np.array([4.0, -2, 1]),
            np.array([0.5, 1, -2]),
        )
        turn, position = start[:3, :3], start[:3, 3]
        velocities = turn @ linear + np.cross(position, turn @ angular), turn @ angular
        return (
            ls.Trajectory.from_twist(start, linear, angular),
            ls.Trajectory.from_twist(inverse(start), -velocities[0], -velocities[1]),
        )
    # Lines are lines from either side where nothing turns, and of Slerp the inverse is Slerp where nothing shifts.
    draw = np.random.default_rng(4)
    if kind == "straight":
        poses = [pose(draw.uniform(3.0, 4.0, 3), (0.4, 0.2, -0.7)) for _ in range(4)]
    else:
        poses = [pose(turn=draw.uniform(-0.1, 0.1, 3)) for _ in range(4)]
    times = [0.0, 0.04, 0.07, 0.1]
    return ls.Trajectory(times, np.array(poses)), ls.Trajectory(times, np.array([inverse(one) for one in poses]))


@pytest.mark.parametrize("kind", ["screw", "straight", "turning"])
def test_a_mover_is_seen_as_what_stands_still_from_a_sensor_that_moves_the_other_way(kind: str) -> None:
    there, back = there_and_back(kind)
    place = pose((-7.0, 1.0, 0.5), (0.1, -0.1, 0.2))
    moving, still = ls.Scene(), ls.Scene()
    for i, shape in enumerate(shapes()):
        where = pose((3.0 * i - 9.0, 4.0 * (-1) ** i, 0.0), (0.2 * i, 0, 0))
        moving.add(shape, transform=where, motion=there)
        still.add(shape, transform=where)
    lidar = ls.Lidar(
        ls.patterns.Spinning(np.radians(np.linspace(-25, 25, 24)), columns=180, rate=10.0, firing_times=2e-5)
    )
    a, b = lidar.scan(moving, place), lidar.scan(still, back @ place)
    assert same(a.object_id, b.object_id)
    assert len(np.unique(a.object_id)) > 6
    hit = a.object_id >= 0
    assert np.ptp(a.radial_velocity[hit]) > 5
    # Both take a pulse from the sensor to the object by poses that are equal but for their roundings, of 2⁻⁵³ each. A
    # pose moves a point by 4 in each coordinate at most, three products and the sum with the translation, of numbers
    # below |x| + |p|: so by 4√3 over the lever arm L, all that lies between sensor, origin and point together. An
    # exponential adds 8 to each entry of its rotation, from its polynomials and the rotation vector. A pulse goes
    # through the mount, the motion and its start, and the inverse of the start was rounded before: 4 poses a side. The
    # range grows by what the point moves, over the cosine of its incidence.
    lever = 10.0 + a.range[hit] + np.linalg.norm(there.at(np.linspace(0, 0.1, 9)).translation, axis=1).max()
    bound = 2.0**-53 * 2 * 4 * (4 * math.sqrt(3) + 8 * math.sqrt(3)) * lever
    assert (np.abs(a.range - b.range)[hit] <= bound / np.cos(a.incidence[hit])).all()
    points = a.point_cloud().xyz - b.point_cloud().xyz
    # Of one direction in the sensor frame, so points are off by as much, and by their own three roundings.
    assert (np.linalg.norm(points, axis=1) <= bound / np.cos(a.incidence[hit]) + 6 * 2.0**-53 * lever).all()
    # Rounded to float32 at last; before, they turn with the point, at |ω| < 20 rad/s.
    velocities = a.radial_velocity[hit], b.radial_velocity[hit]
    off = np.abs(np.subtract(*velocities, dtype=np.float64))
    assert (off <= np.spacing(np.abs(velocities[0])) + 20 * bound / np.cos(a.incidence[hit])).all()


def test_radial_velocities_are_how_fast_ranges_grow() -> None:
    """Central differences of the distance from the beam's origin to the point that was hit, both carried along."""
    scene = moving_scene()
    sensor = drive(9, interpolation="spline")
    lidar = dataclasses.replace(SENSOR, measurement=ls.Measurement(azimuth_sigma=2e-3))
    for where in (sensor, sensor @ pose((0.3, -0.2, 0.5), (0.1, 0.2, 0.3)), pose((1.0, 0.5, 2.5))):
        scan = lidar.scan(scene, where, time=1.6, seed=3)
        cloud = scan.point_cloud("world")
        assert cloud.radial_velocity.dtype == np.float32
        assert "radial_velocity" in cloud.fields
        assert same(cloud.radial_velocity, scan.radial_velocity[scan.status == ls.Status.hit])
        assert np.isnan(scan.radial_velocity[scan.object_id < 0]).all()
        points, kept = scan.true_points("world"), np.flatnonzero(scan.return_count)
        h, checked = 1e-4, 0
        for k in range(0, len(kept), 5):
            i = int(kept[k])
            time = 1.6 + float(scan.pulses.time[i])
            motion = scene.objects[int(scan.object_id[i, 0])].motion

            def distance(t: float) -> float:
                point, own = (*points[k], 1.0), (*scan.pulses.origins[i], 1.0)  # noqa: B023
                if motion is not None:  # noqa: B023
                    point = matrix_at(motion, t) @ np.linalg.inv(matrix_at(motion, time)) @ point  # noqa: B023
                own = (matrix_at(where, t) if isinstance(where, ls.Trajectory) else where) @ own  # noqa: B023
                return float(np.linalg.norm(np.subtract(point, own)[:3]))

            if any(abs(time - knot) < 2 * h for knot in (1.5, 2.0)):
                continue
            slope = (distance(time + h) - distance(time - h)) / (2 * h)
            # Third derivatives are below 1e3 m/s³ there; both distances, below 20 m, round some 16 times.
            near = 1e3 * h * h / 6 + 16 * ROUNDING * 20 / h + FLOAT32 * abs(slope)
            assert float(scan.radial_velocity[i, 0]) == pytest.approx(slope, rel=0, abs=near)
            checked += abs(slope) > 0.1
        assert checked > 20


def test_radial_velocities_are_absent_where_nothing_moves() -> None:
    still = ls.Scene()
    still.add(ls.Plane((0, 0, 1), -2.0))
    scan = SENSOR.scan(still)
    assert scan.radial_velocity is None
    assert "radial_velocity" not in scan.point_cloud().fields
    drives = ls.Trajectory.from_twist(np.eye(4), (5, 0, 0))
    assert SENSOR.scan(still, drives).radial_velocity is not None
    ahead = ls.Scene()
    ahead.add(ls.Plane((1, 0, 0), 10.0), motion=drives)
    wall = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
    assert wall.scan(ahead).radial_velocity.tolist() == [[5.0]]
    assert wall.scan(ahead, drives).radial_velocity.tolist() == [[0.0]]
    assert wall.scan(ahead, ls.Trajectory.from_twist(np.eye(4), (7, 0, 0))).radial_velocity.tolist() == [[-2.0]]


def test_materials_move_along() -> None:
    """Reflectivities of vertices are those of the point that was hit, wherever the mesh then is."""
    mesh = ls.TriangleMesh([(5, -2, -2), (5, 2, -2), (5, 0, 2)], [(0, 1, 2)])
    still, moving = ls.Scene(), ls.Scene()
    material = ls.Material(reflectivity=[0.0, 0.5, 1.0], per="vertex")
    still.add(mesh, material=material)
    moving.add(mesh, material=material, motion=ls.Trajectory.from_twist(np.eye(4), (0, 4, 0)))
    lidar = ls.Lidar(ls.patterns.Grid(np.linspace(-0.2, 0.2, 5), np.linspace(-0.1, 0.1, 5), rate=10.0))
    moved = lidar.scan(moving, pose((0, 4, 0)), time=1.0)
    known = lidar.scan(still)
    assert np.ptp(known.intensity[np.isfinite(known.intensity)]) > 0.2
    assert np.allclose(moved.intensity, known.intensity, rtol=2 * FLOAT32, atol=0, equal_nan=True)


def test_motions_have_to_cover_casts_and_scans() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    scene.add(ls.Sphere((8, 0, 0), 2.0), name="ball", motion=drive())
    inside = scene.cast(np.zeros((2, 3)), np.ones((2, 3)), time=[0.0, 2.0])
    assert len(inside) == 2
    message = "time: expected times within the motion of object 1 ('ball'), 0.0 to 2.0 s, got -0.5 to 1.0 s"
    with pytest.raises(ValueError, match=re.escape(message)):
        scene.cast(np.zeros((2, 3)), np.ones((2, 3)), time=[1.0, -0.5])
    with pytest.raises(ValueError, match=r"object 1 \('ball'\), 0\.0 to 2\.0 s, got 3\.0 to 3\.0 s"):
        scene.cast(np.zeros((2, 3)), np.ones((2, 3)), time=3.0)
    with pytest.raises(ValueError, match=r"object 1 \('ball'\), 0\.0 to 2\.0 s, got 1\.95 to 2\.0"):
        SENSOR.scan(scene, time=1.95)
    with pytest.raises(ValueError, match=r"object 1 \('ball'\)"):
        SENSOR.frames(scene, None, 21)
    with pytest.raises(ValueError, match=r"object 1 \('ball'\)"):
        ls.Rig({"a": (SENSOR, np.eye(4))}).frames(scene, None, 21)


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
@pytest.mark.parametrize("mounted", [False, True], ids=["body", "mounted"])
def test_a_motion_to_the_end_of_the_frame_is_enough(interpolation: Any, mounted: bool) -> None:
    """The firing cycle that is then under way sees what moves go on at the velocities of its end."""
    lidar = ls.Lidar.preset("velodyne-hdl64e-s3")
    end = 1 / lidar.pattern.rate
    times = np.linspace(0.0, end, 5)
    poses = [pose((9 * t - 20 * t * t, t, 0.0), (9 * t * t, 0, 2 * t)) for t in times]
    body = ls.Trajectory(times, poses, interpolation=interpolation)
    mount = pose((1.0, -2.0, 0.5), (0.2, 0.1, 0.4)) if mounted else np.eye(4)
    scene = ls.Scene()
    scene.add(ls.Box((24, 20, 12)), name="room", motion=body @ mount)  # which moves, around a sensor that does not
    scan = lidar.scan(scene)
    late = scan.pulses.time > end
    assert late.sum() >= 20
    assert np.isfinite(scan.range).all()
    linear, angular = body.velocity(end)
    assert np.linalg.norm(linear) > 3
    assert np.linalg.norm(angular) > 2
    last = body.at(end).as_matrix()
    for i in np.flatnonzero(late):
        after = scan.pulses.time[i] - end
        now = pose(last[:3, 3] + after * linear)
        now[:3, :3] = last[:3, :3] @ Rotation.from_rotvec(after * angular).as_matrix()
        known = ls.Scene()
        known.add(ls.Box((24, 20, 12)), transform=now @ mount)
        hits = known.cast(scan.pulses.origins[i : i + 1], scan.pulses.directions[i : i + 1])
        # Two poses of numbers below 4, each of fewer than 40 roundings, and so points 16 m from there, and a range
        # that grows by as much over the cosine of the incidence.
        bound = 2 * 40 * 2.0**-53 * (4 + 16) / math.cos(scan.incidence[i, 0])
        assert scan.range[i, 0] == pytest.approx(hits.t[0], rel=0, abs=bound)
        point = scan.range[i, 0] * scan.pulses.directions[i] + scan.pulses.origins[i]
        moves = linear + np.cross(now[:3, :3] @ angular, point - now[:3, 3])
        rate = float(moves @ scan.pulses.directions[i])
        near = FLOAT32 * abs(rate) + np.linalg.norm(angular) * bound + 8 * ROUNDING * np.linalg.norm(moves)
        assert float(scan.radial_velocity[i, 0]) == pytest.approx(rate, rel=0, abs=near)
        assert same(scan_pulses(lidar, scene, indices=[i]).range[0], scan.range[i])
    # What is before the end, it sees as it would without an end.
    longer = ls.Scene()
    longer.add(ls.Box((24, 20, 12)), motion=ls.Trajectory([*times, 2 * end], [*poses, poses[0]]) @ mount)
    assert interpolation == "spline" or same(lidar.scan(longer).range[~late], scan.range[~late])
    # It goes on for the pulses after the end of the frame alone.
    short = np.nextafter(scan.pulses.time[scan.pulses.time < end].max(), 0.0)
    scene.update(0, motion=ls.Trajectory([*times[:-1], short], poses, interpolation=interpolation) @ mount)
    with pytest.raises(ValueError, match=rf"^time: .* of object 0 \('room'\), 0\.0 to {short} s, got 0\.0 to "):
        lidar.scan(scene)


class ThreeAhead:
    """A pattern of a user's own, whose frames last 0.1 s, but whose third pulse is fired at 0.11 s."""

    rate, shape = 10.0, (1, 3)

    def __init__(self, columns: list[int]) -> None:
        self.columns = columns

    def pulses(self, frame: int = 0) -> ls.patterns.Pulses:
        return ls.patterns.Pulses(
            directions=np.tile([1.0, 0.0, 0.0], (3, 1)),
            origins=np.zeros((3, 3)),
            time=np.array([0.0, 0.09, 0.11]),
            ring=np.zeros(3, np.uint16),
            column=np.array(self.columns, np.uint32),
        )


def test_a_motion_does_not_go_on_for_another_cycle() -> None:
    """The last pulse is of a cycle of its own, or of one that began before the end of the frame."""
    scene = ls.Scene()
    scene.add(ls.Sphere((8, 0, 0), 2.0), motion=ls.Trajectory([0.0, 0.1], [pose(), pose((1, 0, 0))]))

    def fire(columns: list[int]) -> ls.Scan:
        return ls.Lidar(ThreeAhead(columns)).scan(scene)

    assert fire([0, 1, 1]).range[:, 0] == pytest.approx([6.0, 6.9, 7.1], rel=4 * 2.0**-52)  # ulps
    with pytest.raises(ValueError, match=r"^time: .* of object 0, 0\.0 to 0\.1 s, got 0\.0 to 0\.11 s$"):
        fire([0, 1, 2])
    # Rays are cast at their times, of which each needs a pose.
    with pytest.raises(ValueError, match=r"^time: .* of object 0, 0\.0 to 0\.1 s, got 0\.11 to 0\.11 s$"):
        scene.cast([[0, 0, 0]], [[1, 0, 0]], time=0.11)


def test_bad_motions_and_times() -> None:
    scene, ball = ls.Scene(), ls.Sphere((8, 0, 0), 2.0)
    with pytest.raises(TypeError, match="motion: expected a Trajectory, got ndarray"):
        scene.add(ball, motion=np.eye(4))  # type: ignore[arg-type]
    assert len(scene) == 0
    ray = np.zeros((2, 3)), np.ones((2, 3))
    for moves in (None, ls.Trajectory.from_twist(np.eye(4), (1, 0, 0))):
        scene.add(ball, motion=moves)
        with pytest.raises(ValueError, match="time: expected one number or one for each of 2 rays, got 3"):
            scene.cast(*ray, time=[0, 1, 2])
        with pytest.raises(ValueError, match="time: expected finite numbers, got"):
            scene.cast(*ray, time=[0, np.nan])
        with pytest.raises(TypeError, match="time: expected real numbers"):
            scene.cast(*ray, time="now")  # type: ignore[arg-type]
    assert len(scene.cast(np.zeros((0, 3)), np.zeros((0, 3)), time=[])) == 0
