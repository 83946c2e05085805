"""Rigs and sequences: equality with single scans, poses and times of each sensor, and invalid arguments."""

from __future__ import annotations

import copy
import dataclasses
import gc
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import psutil
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim import _native

ARRAYS = ("range", "true_range", "intensity", "object_id", "label", "normal", "incidence", "status")
NOISE = ls.Measurement(range_sigma=0.02, dropout=0.05, azimuth_sigma=1e-3)


def street() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), label=1)
    scene.add(ls.Box((200, 1, 8), (50, 8, 4)), label=2)
    for x in range(0, 60, 7):
        scene.add(ls.Cylinder((x, -4, 0), (x, -4, 5), 0.2), label=3)
    return scene


def sensor(rate: float = 10.0, *, name: str = "spinner") -> ls.Lidar:
    pattern = ls.patterns.Spinning(np.radians(np.linspace(-20, 10, 8)), columns=90, rate=rate)
    return ls.Lidar(pattern, measurement=NOISE, max_range=80.0, name=name)


def pose(x: float, y: float, z: float, yaw: float) -> RigidTransform:
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("z", yaw))


def drive() -> ls.Trajectory:
    poses = RigidTransform.concatenate([pose(3.0 * t, 0.5 * t * t, 0.0, 0.4 * t) for t in range(4)])
    return ls.Trajectory(range(4), poses, interpolation="spline")


TOP, LEFT = pose(1.2, 0.0, 1.9, 0.0), pose(0.5, 0.9, 1.0, 1.5)


def assert_same(a: ls.Scan, b: ls.Scan) -> None:
    assert (a.time, a.frame, len(a)) == (b.time, b.frame, len(b))
    assert (a.status == ls.Status.hit).sum() > 300
    for name in ARRAYS:
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=name != "status"), name


# Sequences of one sensor


@pytest.mark.parametrize("where", [None, TOP, TOP.as_matrix(), drive() @ TOP], ids=["none", "still", "matrix", "drive"])
def test_frames_are_scans_in_step(where: Any) -> None:
    lidar, scene = sensor(), street()
    if where is None:
        scene.add(ls.Plane((0, 0, 1), -1.5))
    frames = list(lidar.frames(scene, where, 3, first=4, seed=7))
    for k, scan in zip(range(4, 7), frames, strict=True):
        assert_same(scan, lidar.scan(scene, where, time=k / 10.0, frame=k, seed=7))
    noise = [scan.range_error[:, 0] for scan in frames]
    both = np.isfinite(noise[0]) & np.isfinite(noise[1])
    # Independent draws: of n pairs the correlation has a standard deviation of 1/sqrt(n).
    assert abs(np.corrcoef(noise[0][both], noise[1][both])[0, 1]) < 5 / np.sqrt(both.sum())


def test_frames_come_when_they_are_asked_for() -> None:
    scene = ls.Scene()
    frames = sensor().frames(scene, None, 10**9)
    assert iter(frames) is frames
    assert not np.isfinite(next(frames).range).any()
    scene.add(ls.Sphere((0, 0, 0), 5.0))
    assert np.isfinite(next(frames).range).any()
    assert list(sensor().frames(scene, None, 0)) == []


def test_a_pose_that_changes_meanwhile_is_that_of_the_call() -> None:
    where = TOP.as_matrix()
    frames = sensor().frames(street(), where, 2)
    where[2, 3] = 50.0
    assert_same(next(frames), sensor().scan(street(), TOP))


def test_frames_of_an_irregular_pattern() -> None:
    # Pulses that stand in any order of their times, and a frame without any.
    pattern = ls.patterns.Table([[1, 0, 0]] * 3, times=[0.29, 0.05, 0.21], rate=10.0)
    lidar = ls.Lidar(pattern)
    path = ls.Trajectory([0.05, 0.29], [np.eye(4)] * 2)
    assert [len(scan) for scan in lidar.frames(street(), path, 3)] == [1, 0, 2]
    assert [len(scan) for scan in lidar.frames(street(), path, 2)] == [1, 0]
    with pytest.raises(ValueError, match=r"^pose: expected .* got one from 0.05 to 0.28 s and pulse 1 at 0.29 s$"):
        lidar.frames(street(), ls.Trajectory([0.05, 0.28], [np.eye(4)] * 2), 3)


SHORT = "pose: expected a trajectory over all pulses, got one from 0.0 to 3.0 s and pulse"
BAD: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"scene": None}, TypeError, "scene: expected a Scene, got None"),
    ({"pose": np.eye(3)}, ValueError, "pose: expected shape (4, 4), got (3, 3)"),
    ({"pose": np.full((4, 4), np.nan)}, ValueError, "pose: expected finite numbers, got pose[0][0] = nan"),
    ({"pose": 2 * np.eye(4)}, ValueError, "pose: expected a last row of (0, 0, 0, 1), got (0.0, 0.0, 0.0, 2.0)"),
    ({"count": -1}, ValueError, "count: expected an integer >= 0, got -1"),
    ({"count": 1.5}, TypeError, "count: expected an integer >= 0, got 1.5"),
    ({"first": -1}, ValueError, "first: expected an integer from 0 to 4294967295, got -1"),
    ({"first": 2**32}, ValueError, "first: expected an integer from 0 to 4294967295, got 4294967296"),
    ({"first": 2**32 - 1, "pose": None}, ValueError, "frame: expected an integer from 0 to 4294967295, got 4294967296"),
    ({"seed": -1}, ValueError, "seed: expected an integer from 0 to 18446744073709551615, got -1"),
    ({"count": 31}, ValueError, f"{SHORT} 712 at 3.09"),
    ({"first": 30}, ValueError, f"{SHORT} 712 at 3.09"),
]  # fmt: skip


@pytest.mark.parametrize(("changed", "error", "message"), BAD)
@pytest.mark.parametrize("of", [sensor(), ls.Rig({"top": (sensor(), None)})], ids=["lidar", "rig"])
def test_bad_arguments_are_refused_at_the_call(
    of: Any, changed: dict[str, Any], error: type[Exception], message: str
) -> None:
    arguments = {"scene": street(), "pose": drive(), "count": 2, "first": 0, "seed": 0, **changed}
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        of.frames(**arguments)


# Rigs


def test_a_rig_scans_as_its_sensors_do() -> None:
    rig, scene = ls.Rig({"top": (sensor(), TOP), "left": (sensor(), LEFT.as_matrix(), 0.04)}), street()
    frames = list(rig.frames(scene, drive(), 3, first=2, seed=5))
    assert [list(scans) for scans in frames] == [["top", "left"]] * 3
    for k, scans in enumerate(frames, start=2):
        for name, mount, offset in (("top", TOP, 0.0), ("left", LEFT, 0.04)):
            lidar = dataclasses.replace(sensor(), name=name)
            expected = lidar.scan(scene, drive() @ mount, time=k / 10.0 + offset, frame=k, seed=5)
            assert_same(scans[name], expected)


def test_a_rig_that_stands_still() -> None:
    rig, body = ls.Rig({"top": (sensor(), TOP), "left": (sensor(), LEFT)}), pose(3.0, 1.0, 0.2, 0.3)
    (scans,) = rig.frames(street(), body, 1)
    for name, mount in (("top", TOP), ("left", LEFT)):
        # A product of matrices, of numbers below 8.
        assert np.abs(scans[name].pose - (body * mount).as_matrix()).max() <= 8 * 8 * 2.0**-53
        assert_same(scans[name], rig[name].lidar.scan(street(), scans[name].pose))
    walls = [scan.point_cloud("world") for scan in scans.values()]
    for cloud in walls:
        assert (cloud.label == 2).sum() > 30
        # On the wall, y = 7.5, but for noise: 6 σ of range, and the jitter of 1 mrad at no more than 80 m.
        assert np.abs(cloud.xyz[cloud.label == 2, 1] - 7.5).max() < 6 * (0.02 + 0.08)


def test_sensors_of_one_kind_draw_different_noise() -> None:
    same = sensor(name="of one name")
    rig = ls.Rig({"top": (same, None), "twin": (same, None)})
    (scans,) = rig.frames(street(), TOP, 1)
    noise = [scan.range_error[:, 0] for scan in scans.values()]
    both = np.isfinite(noise).all(axis=0)
    assert both.sum() > 300
    assert abs(np.corrcoef(*(part[both] for part in noise))[0, 1]) < 5 / np.sqrt(both.sum())
    assert same.name == "of one name"
    assert [part.lidar.name for part in rig.values()] == ["top", "twin"]


@pytest.mark.parametrize(
    ("slow", "fast", "expected"),
    [
        (10.0, 20.0, [0, None, 1, None, 2, None]),
        (10.0, 15.0, [0, 1, None, 2, 3, None]),
        (7.5, 10.0, [0, 1, 2, None, 3, 4]),
        (10.0, 10.0, [0, 1, 2, 3, 4, 5]),
        (0.1 + 0.2, 0.3, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_a_slower_sensor_comes_once_a_frame_of_its_own(slow: float, fast: float, expected: list[int | None]) -> None:
    rig = ls.Rig({"slow": (sensor(slow), None), "fast": (sensor(fast), None)})
    scans = list(rig.frames(street(), TOP, 6))
    assert rig.rate == max(slow, fast)
    quick, other = ("fast", "slow") if fast >= slow else ("slow", "fast")
    assert [part[quick].frame for part in scans] == list(range(6))
    assert [part[other].frame if other in part else None for part in scans][: len(expected)] == expected
    for j, part in enumerate(scans):
        for name, scan in part.items():
            assert scan.time == scan.frame / rig[name].lidar.pattern.rate
            assert j / rig.rate <= scan.time < (j + 1) / rig.rate
    later = list(rig.frames(street(), TOP, 3, first=3))
    for part, again in zip(scans[3:], later, strict=True):
        assert {name: scan.frame for name, scan in part.items()} == {name: scan.frame for name, scan in again.items()}


def test_the_span_is_from_the_first_sensor_to_the_last() -> None:
    slow, fast = ls.RigSensor(sensor(10.0), None, offset=0.07), ls.RigSensor(sensor(20.0), None, offset=0.01)
    rig = ls.Rig({"slow": slow, "fast": fast})
    for first, count, numbers in [
        (0, 2, {"slow": range(1), "fast": range(2)}),
        (4, 3, {"slow": [2, 3], "fast": [4, 5, 6]}),
    ]:
        scans = [scan for part in rig.frames(street(), TOP, count, first=first) for scan in part.values()]
        assert {(scan.frame, scan.time) for scan in scans} == {
            (k, k / rig[name].lidar.pattern.rate + rig[name].offset) for name in numbers for k in numbers[name]
        }
        start = min(scan.time for scan in scans)
        end = max(
            k / rig[name].lidar.pattern.rate + rig[name].offset for name in numbers for k in [numbers[name][-1] + 1]
        )
        assert rig.span(count, first=first) == (start, end)
        assert start == 0.01 + first / 20.0


def test_a_rig_is_a_mapping() -> None:
    rig = ls.Rig({"top": (sensor(), TOP), "left": (sensor(20.0), None, 0.01)})
    assert isinstance(rig, Mapping)
    assert (list(rig), len(rig), "top" in rig, "right" in rig) == (["top", "left"], 2, True, False)
    lidar, mount, offset = rig["left"]
    assert (lidar.pattern.rate, mount.tolist(), offset) == (20.0, np.eye(4).tolist(), 0.01)
    assert rig["top"].offset == 0.0
    with pytest.raises(KeyError):
        rig["right"]
    with pytest.raises(ValueError, match="read-only"):
        rig["top"].mount[0, 3] = 1.0
    assert repr(rig) == "Rig(top, left at 20 Hz)"
    assert rig == rig  # noqa: PLR0124 - matrices do not compare to one truth
    assert rig != ls.Rig(rig)
    wider = ls.Rig({**rig, "right": (sensor(), LEFT)})
    assert [part.offset for part in wider.values()] == [0.0, 0.01, 0.0]


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda rig: pickle.loads(pickle.dumps(rig))])  # noqa: S301
def test_copies_of_rigs_scan_alike(again: Callable[[ls.Rig], ls.Rig]) -> None:
    rig = ls.Rig({"top": (sensor(), TOP), "left": (sensor(), LEFT, 0.03)})
    (scans,), (other,) = (part.frames(street(), drive(), 1) for part in (rig, again(rig)))
    for name in rig:
        assert_same(scans[name], other[name])


@pytest.mark.parametrize(
    ("sensors", "error", "message"),
    [
        ([], TypeError, "sensors: expected a mapping from names to sensors, got list"),
        ({}, ValueError, "sensors: expected at least one, got none"),
        ({3: (sensor(), None)}, TypeError, "sensors: expected strings as names, got 3"),
        ({"": (sensor(), None)}, ValueError, "sensors: expected names, got an empty one"),
        ({"a": sensor()}, TypeError, "sensors['a']: expected (lidar, mount) or (lidar, mount, offset), got Lidar"),
        ({"a": (sensor(),)}, TypeError, "sensors['a']: expected (lidar, mount) or (lidar, mount, offset), got a tuple"),
        (
            {"a": (TOP, sensor())},
            TypeError,
            "sensors['a']: expected a Lidar, an Imu or a Gnss first, got RigidTransform",
        ),
        ({"a": (sensor(), np.eye(3))}, ValueError, "sensors['a'], mount: expected shape (4, 4), got (3, 3)"),
        (
            {"a": (sensor(), np.diag([1, 1, 2, 1]))},
            ValueError,
            "sensors['a'], mount: expected a rigid transform (orthonormal rotation), got one 3 away from it",
        ),
        (
            {"a": (sensor(), None, np.inf)},
            ValueError,
            "sensors['a'], offset: expected a finite number, got inf",
        ),
        (  # two names of the same CRC-32
            {"plumless": (sensor(), None), "top": (sensor(), TOP), "buckeroo": (sensor(), LEFT)},
            ValueError,
            "sensors: expected names that do not collide (CRC-32), got 'plumless' and 'buckeroo'; rename one",
        ),
        ({"a": (sensor(), None, "1 s")}, TypeError, "sensors['a'], offset: expected a finite number, got '1 s'"),
    ],
)
def test_bad_rigs(sensors: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        ls.Rig(sensors)


def test_every_sensor_has_to_be_covered() -> None:
    rig = ls.Rig({"top": (sensor(), None), "left": (sensor(), None, 0.5)})
    assert len(list(rig.frames(street(), drive(), 25))) == 25
    with pytest.raises(ValueError, match=f"^{SHORT} 712 at 3.09"):
        rig.frames(street(), drive(), 26)


def test_threads_and_instruction_sets_change_nothing(
    monkeypatch: pytest.MonkeyPatch, instruction_sets: list[str]
) -> None:
    rig = ls.Rig({"top": (sensor(), TOP), "left": (sensor(), LEFT, 0.05)})
    (expected,) = rig.frames(street(), drive(), 1, first=3)
    assert instruction_sets
    for isa in instruction_sets:
        for threads in (1, 5):
            monkeypatch.setenv("LIDARSIM_ISA", isa)
            monkeypatch.setenv("LIDARSIM_THREADS", str(threads))
            assert _native.isa() == isa
            (scans,) = rig.frames(street(), drive(), 1, first=3)
            for name in rig:
                assert_same(scans[name], expected[name])


def test_the_model_of_a_sensor_stays() -> None:
    own = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
    rig = ls.Rig({"top": (ls.Lidar.preset("ouster-os1-64"), None), "own": (own, None)})
    assert (rig["top"].lidar.name, rig["top"].lidar.model) == ("top", "ouster-os1-64")
    assert rig["own"].lidar.model == "own"


def test_one_frame_is_the_scan_of_each_sensor() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((1, 0, 0), 10.0), motion=ls.Trajectory.from_twist(np.eye(4), (1, 0, 0)))
    body = scene.add(ls.Sphere((0, 0, 0), 0.5))
    lidar = ls.Lidar(ls.patterns.Grid([0.0, 0.1], [0.0], rate=10.0), measurement=ls.Measurement(range_sigma=0.01))
    slow = dataclasses.replace(lidar, pattern=ls.patterns.Grid([0.0], [0.0], rate=2.0))
    mount = np.eye(4)
    mount[1, 3] = 0.7
    rig = ls.Rig({"left": (lidar, mount), "slow": (slow, None, 0.25)})
    drive = ls.Trajectory.from_twist(np.eye(4), (2.0, 0, 0), (0, 0, 0.1))
    scans = rig.scan(scene, drive, time=0.5, frame=3, seed=4, ignore=[body + 1])
    assert list(scans) == ["left", "slow"]
    for name, offset in (("left", 0.0), ("slow", 0.25)):
        sensor = rig[name]
        expected = sensor.lidar.scan(scene, drive @ sensor.mount, time=0.5 + offset, frame=3, seed=4, ignore=[body + 1])
        assert (scans[name].time, scans[name].frame) == (0.5 + offset, 3)
        assert scans[name].range.tobytes() == expected.range.tobytes()
        assert (scans[name].object_id == 0).all()
    assert (rig.scan(scene)["slow"].object_id == body).all()
    assert np.array_equal(rig.scan(scene, np.eye(4))["left"].range, rig.scan(scene)["left"].range)
    with pytest.raises(ValueError, match="pose: expected shape"):
        rig.scan(scene, np.eye(3))
    with pytest.raises(ValueError, match=r"ignore: .* got 99"):
        rig.scan(scene, ignore=[99])


def test_imus_and_receivers_are_members() -> None:
    imu = ls.Imu(100.0, gyroscope=ls.ImuErrors(bias=0.1))
    gnss = ls.Gnss(5.0, mount=TOP, position_sigma=1.0)
    rig = ls.Rig({"imu": (imu, LEFT), "top": (sensor(), TOP), "roof": (gnss, None)})
    assert list(rig) == ["top"]
    assert repr(rig) == "Rig(top, imu, roof at 10 Hz)"
    assert rig.imus == {"imu": dataclasses.replace(imu, mount=LEFT, name="imu")}
    assert rig.receivers == {"roof": dataclasses.replace(gnss, name="roof")}
    drive = ls.Trajectory.from_twist(np.eye(4), (5, 0, 0), (0, 0, 0.1))
    assert [list(scans) for scans in rig.frames(ls.Scene(), drive, 2)] == [["top"], ["top"]]
    (samples,) = rig.inertial(drive, end=0.5, seed=3).values()
    same = rig.imus["imu"].measure(drive, end=0.5, seed=3)
    np.testing.assert_array_equal(samples.angular_rate, same.angular_rate)
    other = ls.Rig({"imu": (imu, LEFT), "second": (imu, LEFT), "top": (sensor(), TOP)}).inertial(drive, end=0.5, seed=3)
    np.testing.assert_array_equal(other["imu"].angular_rate, samples.angular_rate)
    assert (other["second"].angular_rate != samples.angular_rate).all()
    world = ls.Georeference(origin=(0.8, 0.2, 500.0))
    (fixes,) = rig.fixes(drive, world, end=0.5, seed=3).values()
    np.testing.assert_array_equal(fixes.altitude, rig.receivers["roof"].measure(drive, world, end=0.5, seed=3).altitude)


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ({"a": (ls.Imu(100.0), None)}, "sensors: expected at least one Lidar, got Imu"),
        ({"a": (ls.Imu(100.0), None, 0.1)}, "sensors['a'], offset: expected none beside Imu, got 0.1"),
        (
            {"a": (ls.Gnss(5.0, mount=TOP), LEFT)},
            "sensors['a'], mount: expected None, as the Gnss has a mount, got another",
        ),
        ({"a": (ls.Imu(100.0), np.zeros((4, 4)))}, "sensors['a'], mount: expected a last row of"),
        (
            {"plumless": (sensor(), None), "buckeroo": (ls.Imu(100.0), None)},
            "sensors: expected names that do not collide (CRC-32), got 'plumless' and 'buckeroo'; rename one",
        ),
    ],
)
def test_bad_members(sensors: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        ls.Rig(sensors)


def resident() -> int:
    """Resident set of this process, bytes."""
    gc.collect()
    return psutil.Process().memory_info().rss


@pytest.mark.slow("memory does not grow with frames")
@pytest.mark.parametrize("together", [False, True])
def test_frames_take_the_memory_of_one(together: bool) -> None:
    """However many frames are scanned: a sequence of any length takes the memory of a frame."""
    lidar = ls.Lidar(ls.patterns.Spinning(np.radians(np.linspace(-20, 10, 64)), columns=1000, rate=10.0))
    drive, frames = ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0)), 40
    each: Iterator[Any]
    if together:
        each = (scans["top"] for scans in ls.Rig({"top": (lidar, None)}).frames(street(), drive, frames))
    else:
        each = lidar.frames(street(), drive, frames)
    there = {}
    for number, scan in enumerate(each):
        assert len(scan) == 64 * 1000
        scan.point_cloud(deskew=True)
        if number in (9, frames - 1):
            there[number] = resident()
    arrays = [getattr(of, f.name) for of in (scan, scan.pulses) for f in dataclasses.fields(of)]
    one = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
    assert one >= 100 * 64 * 1000
    # Of 30 frames more, not as much is kept as one has, which would be 4 bytes of each pulse.
    assert there[frames - 1] - there[9] < one
