"""Scans: what each pulse gives, the truth beside it, points in their frames, motion, and the same bits every time."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import _native
from lidarsim.patterns import Pulses
from lidarsim.scan import scan as scan_pulses

Floats = npt.NDArray[np.float64]

ARRAYS = (
    "range", "true_range", "range_error", "intensity", "object_id", "label", "normal", "incidence", "status",
    "return_count",
)  # fmt: skip

EVERYTHING = ls.Measurement(
    range_sigma=0.02,
    range_sigma_slope=1e-3,
    range_bias=0.01,
    range_resolution=1e-3,
    azimuth_sigma=1e-3,
    elevation_sigma=1e-3,
    dropout=0.1,
    detection=ls.Detection(0.1, 30.0),
    extinction=1e-3,
    beam=ls.Beam(5e-3, 3e-3, rays=7),
    returns=2,
)


def room() -> ls.Scene:
    """Ground, a ball, a tilted box, and walls on two sides; open on the others."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -1.5), name="ground", label=40, material=ls.Material(reflectivity=0.3))
    scene.add(ls.Sphere((8, 2, 0), 1.5), name="ball", label=7, material=ls.Material(reflectivity=0.9))
    turned = RigidTransform.from_components([6, -4, 0], Rotation.from_euler("zyx", [0.4, 0.2, 0.1]))
    scene.add(ls.Box((2, 3, 2)), name="box", label=4_000_000_000, transform=turned)
    scene.add(ls.Plane((1, 0.01, 0), 25.0), name="wall", label=50)
    scene.add(ls.Plane((0.01, 1, 0), 18.0), name="side", label=51)
    return scene


def lidar(measurement: ls.Measurement | None = None, *, columns: int = 180, name: str = "top") -> ls.Lidar:
    pattern = ls.patterns.Spinning(
        np.radians(np.linspace(-25, 15, 16)), columns=columns, rate=10.0, beam_origins=[[0.05, 0.0, 0.04]] * 16
    )
    return ls.Lidar(pattern, measurement=measurement or ls.Measurement(), name=name)


TURNED = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_euler("zyx", [0.7, -0.1, 0.2]))


def assert_same(a: ls.Scan, b: ls.Scan, index: Any = slice(None)) -> None:
    for name in ARRAYS:
        assert np.array_equal(getattr(a, name), getattr(b, name)[index], equal_nan=name != "status"), name


# The truth


def test_hits_are_those_of_the_scene() -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene, TURNED)
    pulses = sensor.pattern.pulses(0)
    rotation, translation = TURNED.rotation.as_matrix(), TURNED.translation
    hits = scene.cast(pulses.origins @ rotation.T + translation, pulses.directions @ rotation.T)
    assert 1000 < hits.hit.sum() < len(scan)
    assert np.array_equal(scan.status, np.where(hits.hit, ls.Status.hit, ls.Status.miss))
    assert np.array_equal(scan.return_count, hits.hit)
    assert np.array_equal(scan.object_id[:, 0], hits.object_id)
    labels = np.array([thing.label for thing in scene.objects])
    assert np.array_equal(scan.label[hits.hit, 0], labels[hits.object_id[hits.hit]])
    assert not scan.label[~hits.hit].any()
    # The rays above were turned by another multiplication of matrices. Its roundings, some 2⁻⁵³ of direction and
    # position, move a hit by their ratio to the cosine of the incidence.
    bound = 1e-15 * (hits.t + 10.0)[hits.hit] / np.cos(scan.incidence[hits.hit, 0])
    assert (np.abs(scan.true_range[hits.hit, 0] - hits.t[hits.hit]) < bound).all()
    assert np.allclose(scan.normal[hits.hit, 0], hits.normal[hits.hit], atol=1e-6)
    cosines = np.abs(np.einsum("ij,ij->i", pulses.directions @ rotation.T, hits.normal))[hits.hit]
    assert np.allclose(np.cos(scan.incidence[hits.hit, 0]), cosines, atol=2e-7)


def test_the_true_range_is_the_length_of_the_way_to_1_ulp() -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene)
    pulses = sensor.pattern.pulses(0)
    t = scene.cast(pulses.origins, pulses.directions).t
    hit = np.flatnonzero(np.isfinite(t))[::7]
    assert len(hit) > 200
    longer = 0
    with mpmath.workdps(50):
        for i in hit.tolist():
            square = sum(Fraction(float(x)) ** 2 for x in pulses.directions[i])
            exact = mpmath.mpf(t[i]) * mpmath.sqrt(mpmath.mpf(square.numerator) / square.denominator)
            assert abs(exact - scan.true_range[i, 0]) <= np.spacing(scan.true_range[i, 0]) * 0.51
            longer += scan.true_range[i, 0] != t[i]
    assert longer > 10


def test_arrays_have_their_shapes_and_types() -> None:
    for returns, k in ((1, 1), ("dual", 2), (4, 4)):
        measurement = ls.Measurement(beam=ls.Beam(1e-3, rays=7), returns=returns)  # type: ignore[arg-type]
        scan = lidar(measurement, columns=10).scan(room())
        assert len(scan) == 160
        for name, dtype in (
            ("range", np.float64), ("true_range", np.float64), ("range_error", np.float64), ("intensity", np.float32),
            ("object_id", np.int32), ("label", np.uint32), ("incidence", np.float32),
        ):  # fmt: skip
            array = getattr(scan, name)
            assert (array.shape, array.dtype) == ((160, k), dtype), name
        assert scan.normal.shape == (160, k, 3)
        assert (scan.status.shape, scan.status.dtype) == ((160,), np.uint8)
        assert (scan.return_count.shape, scan.return_count.dtype) == ((160,), np.uint8)


def test_what_is_lost_keeps_its_truth() -> None:
    clean = lidar().scan(room())
    lost = lidar(ls.Measurement(dropout=1.0)).scan(room())
    was_hit = clean.status == ls.Status.hit
    assert (lost.status[was_hit] == ls.Status.dropped).all()
    assert (lost.status[~was_hit] == ls.Status.miss).all()
    assert np.isnan(lost.range).all()
    for name in ("true_range", "object_id", "label", "normal", "incidence"):
        assert np.array_equal(getattr(lost, name), getattr(clean, name), equal_nan=True), name


def test_summary_counts_and_prints() -> None:
    sensor = dataclasses.replace(lidar(EVERYTHING), min_range=5.0, max_range=28.0)
    scan = sensor.scan(room())
    summary = scan.summary()
    assert list(summary) == [status.name for status in ls.Status]
    assert sum(summary.values()) == len(scan) == 2880
    for status in ls.Status:
        assert summary[status.name] == (scan.status == status).sum() > 0, status
    still = lidar(columns=10).scan(ls.Scene())
    assert str(still.summary()) == repr(still.summary())
    assert str(still.summary()).splitlines() == [
        "hit                       0    0.0%",
        "miss                    160  100.0%",
        "below_min_range           0    0.0%",
        "beyond_max_range          0    0.0%",
        "below_threshold           0    0.0%",
        "dropped                   0    0.0%",
        "pulses                  160",
    ]


def test_range_image() -> None:
    scan = lidar(EVERYTHING).scan(room())
    image = scan.range_image()
    assert image.shape == (16, 180)
    assert np.array_equal(image[scan.pulses.ring, scan.pulses.column], scan.range[:, 0], equal_nan=True)
    assert 500 < np.isfinite(image).sum() < image.size
    # A pulse that is not fired is nan.
    few = scan_pulses(lidar(), room(), indices=[5, 900])
    assert np.isfinite(few.range_image()).sum() == np.isfinite(few.range).sum() <= 2


def test_an_empty_scene_is_all_misses() -> None:
    scan = lidar().scan(ls.Scene())
    assert (scan.status == ls.Status.miss).all()
    cloud = scan.point_cloud()
    assert len(cloud) == 0
    assert cloud.xyz.shape == (0, 3)


# Reflectivity of meshes


def square() -> ls.TriangleMesh:
    """A unit square at x = 10, of two triangles."""
    vertices = [[10, 0, 0], [10, 1, 0], [10, 1, 1], [10, 0, 1]]
    return ls.TriangleMesh(vertices, [[0, 1, 2], [0, 2, 3]])


def towards(points: npt.ArrayLike) -> ls.patterns.Table:
    points = np.asarray(points, dtype=float)
    return ls.patterns.Table(points, rate=10.0)


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_reflectivity_per_vertex_is_linear_over_a_face(offset: float) -> None:
    values = [0.1, 0.5, 2.0, 0.3]
    generator = np.random.default_rng(5)
    v, w = generator.uniform(0.0, 1.0, (2, 500))
    shear = np.array([[1, 0, 0, offset], [0, 2.0, 0.5, offset], [0, 0, 0.7, 0], [0, 0, 0, 1.0]])
    scene = ls.Scene()
    scene.add(square(), material=ls.Material(reflectivity=values, per="vertex"), transform=shear)
    local = np.column_stack([np.full(500, 10.0), v, w, np.ones(500)])
    pose = np.eye(4)
    pose[:2, 3] = offset
    scan = ls.Lidar(towards((local @ shear.T)[:, :3] - pose[:3, 3])).scan(scene, pose)
    assert (scan.status == ls.Status.hit).all()
    got = scan.intensity[:, 0] / np.cos(scan.incidence[:, 0].astype(float))
    lower = 0.1 + v * (0.5 - 0.1) + w * (2.0 - 0.5)
    upper = 0.1 + v * (2.0 - 0.3) + w * (0.3 - 0.1)
    # Intensity and incidence are float32; the ray meets the face within an ulp of 5e6 m.
    assert np.allclose(got, np.where(v > w, lower, upper), rtol=1e-6, atol=10 * np.spacing(offset))


def test_reflectivity_per_face() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 20.0), material=ls.Material(reflectivity=0.05))
    scene.add(square(), material=ls.Material(reflectivity=[0.25, 300.0], per="face"))
    scan = ls.Lidar(towards([[10, 0.8, 0.2], [10, 0.2, 0.8], [10, -0.5, 0.5]])).scan(scene)
    got = scan.intensity[:, 0] / np.cos(scan.incidence[:, 0])
    assert np.allclose(got, [0.25, 300.0, 0.05], rtol=1e-6)


def test_reflectivities_follow_the_scene_as_it_grows() -> None:
    scene, sensor = ls.Scene(), ls.Lidar(towards([[1, 0, 0]]))
    scene.add(ls.Plane((1, 0, 0), 20.0), material=ls.Material(reflectivity=0.5), label=1)
    assert sensor.scan(scene).intensity.tolist() == [[0.5]]
    scene.add(ls.Plane((1, 0, 0), 10.0), material=ls.Material(reflectivity=0.25), label=2)
    scan = sensor.scan(scene)
    assert (scan.intensity.tolist(), scan.label.tolist()) == ([[0.25]], [[2]])


@pytest.mark.parametrize(
    ("shape", "material", "message"),
    [
        (
            ls.Sphere((0, 0, 0), 1.0),
            ls.Material(reflectivity=[0.1], per="face"),
            "object 0 ('thing'): expected a TriangleMesh for a reflectivity per face, got Sphere",
        ),
        (
            square(),
            ls.Material(reflectivity=[0.1, 0.2, 0.3], per="face"),
            "object 0 ('thing'): expected 2 reflectivities, one a face, got 3",
        ),
        (
            square(),
            ls.Material(reflectivity=[0.1, 0.2, 0.3], per="vertex"),
            "object 0 ('thing'): expected 4 reflectivities, one a vertex, got 3",
        ),
    ],
)
def test_reflectivities_that_do_not_fit_are_refused(shape: ls.Shape, material: ls.Material, message: str) -> None:
    scene = ls.Scene()
    scene.add(shape, name="thing", material=material)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        lidar().scan(scene)


# Points


def rounding(cloud: ls.PointCloud) -> Floats:
    """Bound of the roundings between a surface and a point of the world: some 2⁻⁵³ of the range and the position."""
    return 1e-15 * (cloud.range + 10.0)


def test_points_are_the_returns() -> None:
    scan = lidar(EVERYTHING).scan(room(), TURNED, time=5.0)
    cloud = scan.point_cloud()
    has_return = np.arange(2) < scan.return_count[:, None]
    assert 500 < has_return.sum() == len(cloud)
    assert np.array_equal(has_return, np.isfinite(scan.range))
    assert has_return[:, 1].any()
    pulse, number = np.nonzero(has_return)
    for name in ("range", "true_range", "range_error", "intensity", "object_id", "label", "incidence"):
        assert np.array_equal(getattr(cloud, name), getattr(scan, name)[has_return]), name
    for name in ("time", "ring", "column"):
        assert np.array_equal(getattr(cloud, name), getattr(scan.pulses, name)[pulse]), name
    assert np.array_equal(cloud.return_number, number + 1)
    assert np.array_equal(cloud.return_count, scan.return_count[pulse])
    expected = scan.pulses.origins[pulse] + scan.pulses.directions[pulse] * cloud.range[:, None]
    assert np.array_equal(cloud.xyz, expected)
    assert np.array_equal(cloud.range_error, cloud.range - cloud.true_range)
    back = TURNED.rotation.inv().apply(scan.normal[has_return].astype(float))
    assert np.allclose(cloud.normal, back, atol=1e-7)


def test_world_points_lie_on_the_surfaces() -> None:
    scan = lidar().scan(room(), TURNED)
    cloud = scan.point_cloud("world")
    assert (np.abs(cloud.xyz[:, 2] + 1.5)[cloud.label == 40] < rounding(cloud)[cloud.label == 40]).all()
    ball = cloud.xyz[cloud.label == 7] - (8, 2, 0)
    assert len(ball) > 20
    assert np.allclose(np.linalg.norm(ball, axis=1), 1.5, rtol=0, atol=1e-13)
    assert np.allclose(cloud.normal[cloud.label == 7], ball / 1.5, atol=1e-6)
    assert (np.linalg.norm(TURNED.apply(scan.point_cloud().xyz) - cloud.xyz, axis=1) < rounding(cloud)).all()


def test_a_still_sensor_has_nothing_to_deskew() -> None:
    scan = lidar().scan(room(), TURNED)
    raw, deskewed = scan.point_cloud(), scan.point_cloud(deskew=True)
    assert raw.fields == deskewed.fields
    for name in raw.fields:
        assert np.array_equal(getattr(raw, name), getattr(deskewed, name)), name


def test_poses_may_be_given_in_three_ways() -> None:
    by_transform = lidar().scan(room(), TURNED)
    by_matrix = lidar().scan(room(), TURNED.as_matrix())
    by_list = lidar().scan(room(), TURNED.as_matrix().tolist())
    assert_same(by_transform, by_matrix)
    assert_same(by_transform, by_list)
    assert_same(lidar().scan(room()), lidar().scan(room(), np.eye(4)))


def test_a_pose_kept_in_float32_is_a_rotation_all_the_same() -> None:
    exact, rounded = (lidar().scan(room(), pose) for pose in (TURNED, TURNED.as_matrix().astype(np.float32)))
    ground = rounded.point_cloud("world")
    ground = ground[ground.label == 40]
    assert len(ground) > 500
    assert (np.abs(ground.xyz[:, 2] + 1.5) < rounding(ground)).all()
    both = (exact.object_id == 0) & (rounded.object_id == 0)
    bound = 1e-6 * (exact.true_range + 10.0)[both] / np.cos(exact.incidence[both])
    assert (np.abs(exact.true_range - rounded.true_range)[both] < bound).all()


# Motion


def turn(angle: float) -> Rotation:
    return Rotation.from_euler("z", angle)


def drive() -> ls.Trajectory:
    poses = RigidTransform.concatenate(
        [
            RigidTransform.from_components([0.0, 0.0, 0.0], turn(0.0)),
            RigidTransform.from_components([0.5, 0.1, 0.0], turn(0.1) * Rotation.from_euler("x", 0.05)),
            RigidTransform.from_components([1.5, 0.0, 0.2], turn(-0.1)),
        ]
    )
    return ls.Trajectory([2.0, 2.05, 2.2], poses)


@pytest.mark.parametrize(
    "trajectory",
    [
        drive(),
        ls.Trajectory.from_twist(TURNED, linear=(10, 0, 1), angular=(0, 0.2, 1.0)),
        ls.Trajectory(drive().times, drive().poses, interpolation="spline"),
        drive() @ TURNED,
    ],
    ids=["knots", "twist", "spline", "mounted"],
)
def test_each_pulse_is_fired_from_its_own_pose(trajectory: ls.Trajectory) -> None:
    scene, sensor = room(), lidar()
    scan = sensor.scan(scene, trajectory, time=2.0)
    times, origins, directions = (np.array(getattr(scan.pulses, name)) for name in ("time", "origins", "directions"))
    assert len(np.unique(times)) > 100
    poses = trajectory.at(2.0 + times)
    origins, directions = poses.apply(origins), poses.rotation.apply(directions)
    hits = scene.cast(origins, directions)
    assert hits.hit.sum() > 1000
    assert np.array_equal(scan.object_id[:, 0], hits.object_id)
    bound = 2e-15 * (hits.t + 10.0)[hits.hit] / np.cos(scan.incidence[hits.hit, 0])
    assert (np.abs(scan.true_range[hits.hit, 0] - hits.t[hits.hit]) < bound).all()

    world = scan.point_cloud("world")
    at = (origins + directions * hits.t[:, None])[hits.hit]
    assert (np.linalg.norm(world.xyz - at, axis=1) < 2 * bound).all()
    assert (np.abs(world.xyz[:, 2] + 1.5)[world.label == 40] < rounding(world)[world.label == 40]).all()

    raw, straight = scan.point_cloud(), scan.point_cloud(deskew=True)
    start = trajectory.at(2.0)
    assert (np.linalg.norm(straight.xyz - start.inv().apply(world.xyz), axis=1) < 2 * rounding(world)).all()
    assert np.allclose(straight.normal, start.rotation.inv().apply(world.normal), atol=1e-6)
    expected = (poses.inv().rotation.apply(scan.normal[:, 0].astype(float)))[hits.hit]
    assert np.allclose(raw.normal, expected, atol=1e-6)
    assert np.array_equal(raw.range, straight.range)
    moved = np.linalg.norm(raw.xyz - straight.xyz, axis=1)
    assert moved[0] == pytest.approx(0.0, abs=1e-12)
    assert moved.max() > 0.3


def test_a_trajectory_of_one_pose_is_that_pose() -> None:
    still = lidar().scan(room(), TURNED)
    for trajectory in (
        ls.Trajectory([-1.0, 9.0], RigidTransform.concatenate([TURNED, TURNED])),
        ls.Trajectory.from_twist(TURNED),
    ):
        moving = lidar().scan(room(), trajectory)
        assert_same(still, moving)
        assert np.array_equal(still.point_cloud("world").xyz, moving.point_cloud("world").xyz)


def test_a_trajectory_must_cover_all_pulses() -> None:
    sensor = ls.Lidar(ls.patterns.Table(np.tile([1, 0, 0], (5, 1)), times=[0, 0.01, 0.02, 0.03, 0.04], rate=10.0))
    short = ls.Trajectory([0.0, 0.025], np.array([np.eye(4)] * 2))
    message = "pose: expected a trajectory over all pulses, got one from 0 to 0.025 s and pulse 3 at 0.03 s"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        sensor.scan(room(), short)
    message = "pose: expected a trajectory over all pulses, got one from 0 to 0.025 s and pulse 0 at -0.5 s"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        sensor.scan(room(), short, time=-0.5)


# The same bits


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    return lambda n: monkeypatch.setenv("LIDARSIM_THREADS", str(n))


def test_threads_change_nothing(threads: Callable[[int], None]) -> None:
    sensor, path = lidar(EVERYTHING, columns=1024), ls.Trajectory.from_twist(TURNED, (3, 0, 0), (0, 0, 1))
    threads(1)
    one = sensor.scan(room(), path)
    assert (one.status == ls.Status.hit).sum() > 5000
    clouds = [one.point_cloud(deskew=True)]
    for n in (2, 7):
        threads(n)
        again = sensor.scan(room(), path)
        assert_same(one, again)
        clouds.append(again.point_cloud(deskew=True))
    for name in clouds[0].fields:
        for other in clouds[1:]:
            assert np.array_equal(getattr(clouds[0], name), getattr(other, name)), name


def test_instruction_sets_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor, names = lidar(EVERYTHING), ("scalar", "avx2", "avx512")
    best = _native.isa()
    expected = sensor.scan(room(), TURNED)
    for name in names[: names.index(best) + 1]:
        monkeypatch.setenv("LIDARSIM_ISA", name)
        assert _native.isa() == name
        assert_same(expected, sensor.scan(room(), TURNED))


@pytest.mark.parametrize("measurement", [EVERYTHING, dataclasses.replace(EVERYTHING, beam=None, returns=1)])
def test_a_pulse_is_the_same_in_any_company(measurement: ls.Measurement) -> None:
    sensor = lidar(measurement)
    whole = sensor.scan(room(), seed=5, frame=2)
    generator = np.random.default_rng(3)
    for indices in (
        np.arange(len(whole)),
        generator.permutation(len(whole)),
        np.arange(len(whole))[::-1],
        np.array([17]),
        generator.choice(len(whole), 700, replace=False),
        np.array([3, 3, 3]),
    ):
        part = scan_pulses(sensor, room(), seed=5, frame=2, indices=indices)
        assert_same(part, whole, indices)
        assert np.array_equal(part.pulses.ring, whole.pulses.ring[indices])
    assert len(scan_pulses(sensor, room(), indices=[]).status) == 0


def test_seed_frame_and_name_each_give_other_noise() -> None:
    def ranges(*, name: str = "top", **keywords: int) -> Floats:
        sensor = lidar(ls.Measurement(range_sigma=0.01), name=name)
        return sensor.scan(room(), **keywords).range[:, 0]

    first = ranges()
    assert np.array_equal(first, ranges(), equal_nan=True)
    for other in (ranges(seed=1), ranges(seed=2**64 - 1), ranges(frame=1), ranges(name="rear")):
        hit = np.isfinite(first)
        assert np.array_equal(hit, np.isfinite(other))
        assert (first[hit] != other[hit]).mean() > 0.999


def test_scans_in_many_python_threads_at_once() -> None:
    sensor, scene = lidar(EVERYTHING), room()
    expected = [lidar(EVERYTHING).scan(room(), seed=seed) for seed in range(8)]
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        for one, other in zip(expected, pool.map(lambda seed: sensor.scan(scene, seed=seed), range(8)), strict=True):
            assert_same(one, other)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this platform does not fork")
def test_a_forked_child_scans() -> None:
    sensor = lidar(EVERYTHING)
    expected = np.nansum(sensor.scan(room()).range)
    child = os.fork()
    if not child:
        os._exit(0 if np.nansum(sensor.scan(room()).range) == expected else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


# Bad input


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"seed": -1}, ValueError, "seed: expected an integer >= 0 <= 18446744073709551615, got -1"),
        ({"seed": 2**64}, ValueError, f"seed: expected an integer >= 0 <= {2**64 - 1}, got {2**64}"),
        ({"seed": 1.5}, TypeError, "seed: expected an integer >= 0 <= 18446744073709551615, got 1.5"),
        ({"frame": -1}, ValueError, "frame: expected an integer >= 0 <= 4294967295, got -1"),
        ({"frame": 2**32}, ValueError, "frame: expected an integer >= 0 <= 4294967295, got 4294967296"),
        ({"time": math.nan}, ValueError, "time: expected a finite number, got nan"),
        ({"pose": np.eye(3)}, ValueError, "pose: expected shape (4, 4), got (3, 3)"),
        ({"scene": "street"}, TypeError, "scene: expected a Scene, got 'street'"),
    ],
)
def test_arguments_that_cannot_be_are_refused(keywords: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        lidar().scan(**{"scene": room(), **keywords})


def test_a_pose_that_is_not_rigid_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^pose: expected a rigid transform"):
        lidar().scan(room(), np.diag([2.0, 2.0, 2.0, 1.0]))
    with pytest.raises(ValueError, match=r"^pose: expected a rigid transform"):
        lidar().scan(room(), np.diag([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    ("indices", "message"),
    [
        ([2880], "indices: expected 0 to 2879, got indices[0] = 2880"),
        ([0, -1], "indices: expected 0 to 2879, got indices[1] = -1"),
        ([0.5], "indices: expected integers of shape (m,), got float64 of shape (1,)"),
        ([[1]], "indices: expected integers of shape (m,), got int64 of shape (1, 1)"),
    ],
)
def test_indices_that_cannot_be_are_refused(indices: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        scan_pulses(lidar(), room(), indices=indices)


def test_an_unknown_frame_of_points_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^frame: expected 'sensor' or 'world', got 'map'$"):
        lidar().scan(room()).point_cloud("map")  # type: ignore[arg-type]


@dataclass
class Given:
    """A pattern of a user's own, whatever it holds."""

    directions: Floats
    origins: Floats
    time: Floats
    rate: float = 10.0
    shape: tuple[int, int] = (1, 3)

    def pulses(self, frame: int = 0) -> Pulses:
        del frame
        n = len(self.directions)
        return Pulses(self.directions, self.origins, self.time, np.zeros(n, np.uint16), np.arange(n, dtype=np.uint32))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"directions": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]},
            "pulses.directions: expected unit vectors, got pulses.directions[1] = (0, 2, 0)",
        ),
        (
            {"directions": [[1, 0, 0], [0, 1, 0], [0, 0, math.nan]]},
            "pulses.directions: expected unit vectors, got pulses.directions[2] = (0, 0, NaN)",
        ),
        (
            {"origins": [[math.inf, 0, 0], [0, 0, 0], [0, 0, 0]]},
            "pulses.origins: expected finite numbers, got pulses.origins[0] = (inf, 0, 0)",
        ),
        (
            {"time": [0.0, 0.0]},
            "pulses: expected directions, origins and time of equal length, got 3, 3 and 2",
        ),
        (
            {"time": [0.0, math.nan, 0.0]},
            "pose: expected a trajectory over all pulses, got one from -inf to inf s and pulse 1 at NaN s",
        ),
    ],
)
@pytest.mark.parametrize(
    "measurement",
    [
        ls.Measurement(),
        ls.Measurement(azimuth_sigma=1e-3),
        ls.Measurement(beam=ls.Beam(1e-3, rays=7)),
        ls.Measurement(elevation_sigma=1e-3, beam=ls.Beam(1e-3, rays=7)),
    ],
    ids=["plain", "jitter", "beam", "both"],
)
def test_pulses_that_cannot_be_fired_are_refused(
    wrong: dict[str, Any], message: str, measurement: ls.Measurement
) -> None:
    parts = {"directions": np.eye(3), "origins": np.zeros((3, 3)), "time": np.zeros(3)}
    parts.update({name: np.array(values, dtype=float) for name, values in wrong.items()})
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Lidar(Given(**parts), measurement=measurement).scan(room())


def test_directions_kept_in_float32_will_do() -> None:
    direction = np.array([[0.6, 0.48, 0.64]], dtype=np.float32).astype(float)
    scan = ls.Lidar(Given(direction, np.zeros((1, 3)), np.zeros(1))).scan(room())
    t = room().cast(np.zeros((1, 3)), direction).t
    length = math.sqrt(math.fsum(x * x for x in direction[0]))
    assert length != 1.0
    assert scan.true_range[0, 0] == pytest.approx(t[0] * length, rel=1e-15)
