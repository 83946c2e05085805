"""Batches are the scans of a loop, bit for bit, in arrays that others take without a copy."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.scan.batch import _COLUMNS

ALL = tuple(_COLUMNS)

NOISE = ls.Measurement(range_sigma=0.01, dropout=0.1, azimuth_sigma=1e-3, channel_bias_sigma=0.01)
BEAM = ls.Measurement(range_sigma=0.01, beam=ls.Beam(0.02, rays=7), returns="dual", false_returns=0.2)

GRID = ls.patterns.Grid(np.linspace(-3.0, 3.0, 37), [-0.3, 0.0, 0.2], rate=20.0, column_period=1e-4)
CLEAR = ls.Lidar(GRID, max_range=60.0)


def room(*, moving: bool = False) -> ls.Scene:
    scene, draw = ls.Scene(class_names={3: "thing"}), np.random.default_rng(5)
    scene.add(ls.Plane((0, 0, 1), 0.0), label=1)
    for i, (x, y) in enumerate(draw.uniform(-9, 9, (12, 2))):
        shape = (
            ls.Sphere((x, y, 1), 0.7),
            ls.Box((1, 2, 1.5), center=(x, y, 0.7)),
            ls.Capsule((x, y, 0), (x, y, 2), 0.3),
        )
        motion = ls.Trajectory.from_twist(np.eye(4), (1.0, 0.5, 0.0), (0, 0, 0.2)) if moving and i % 3 == 0 else None
        scene.add(shape[i % 3], label=3, motion=motion)
    peak = np.array([[-9.0, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1], [0, 0, 0.4]])
    scene.add(ls.TriangleMesh(peak, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]), label=[5, 6, 7, 8])
    return scene


def poses(count: int, seed: int = 0) -> npt.NDArray[np.float64]:
    draw = np.random.default_rng(seed)
    places = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    places[:, :3, :3] = Rotation.from_euler("zyx", draw.uniform(-0.3, 0.3, (count, 3))).as_matrix()
    places[:, :3, 3] = draw.uniform((-5, -5, 0.8), (5, 5, 2.0), (count, 3))
    return places


def same_bits(row: npt.NDArray[Any], array: npt.NDArray[Any]) -> bool:
    return row.dtype == array.dtype and row.shape == array.shape and row.tobytes() == array.tobytes()


def check_row(batch: ls.ScanBatch, i: int, scan: ls.Scan) -> int:
    """Compare a row of a batch of all arrays with a scan; return the number of arrays that were there."""
    n, compared = len(scan), 0
    for name in ALL:
        row = getattr(batch, name)[i]
        if name == "xyz":
            returned = np.arange(scan.range.shape[1]) < scan.return_count[:, None]
            points = row[:n].reshape(*scan.range.shape, 3)
            assert same_bits(points[returned], scan.point_cloud().xyz)
            assert np.isnan(points[~returned]).all()
            continue
        expected = getattr(scan, name)
        if expected is None:
            continue
        if expected.ndim > 1 and scan.range.shape[1] == 1:
            expected = expected[:, 0]
        assert same_bits(row[:n], expected), name
        compared += 1
    assert (batch.status[i, n:] == 255).all()
    assert np.isnan(batch.range[i, n:]).all()
    return compared


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("measurement", [ls.Measurement(), NOISE, BEAM], ids=["clear", "noise", "beam"])
@pytest.mark.parametrize("moving", [False, True])
def test_a_row_is_the_scan_of_its_pose(
    measurement: ls.Measurement,
    moving: bool,
    threads: str,
    instruction_sets: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, lidar = room(moving=moving), dataclasses.replace(CLEAR, measurement=measurement, name="top")
    places, times = poses(7), np.linspace(0.0, 1.0, 7)
    monkeypatch.setenv("LIDARSIM_THREADS", threads)
    for isa in instruction_sets:
        monkeypatch.setenv("LIDARSIM_ISA", isa)
        batch = lidar.scan_many(scene, places, fields=ALL, time=times, frame=range(3, 10), seed=11)
        for i, pose in enumerate(places):
            scan = lidar.scan(scene, pose, time=times[i], frame=3 + i, seed=int(batch.seed[i]))
            assert check_row(batch, i, scan) >= 11
            assert (scan.status == ls.Status.hit).any()
    assert len({row.tobytes() for row in batch.range}) == 7


@pytest.mark.parametrize("air", [None, ls.Atmosphere.fog(visibility=80.0), ls.Atmosphere.snow(2.0)])
@pytest.mark.parametrize("beam", [None, ls.Beam(0.003)])
def test_rows_with_glass_mirrors_and_weather(air: ls.Atmosphere | None, beam: ls.Beam | None) -> None:
    """Of two worlds, one of which has air, where one row does not see the pane."""
    clear = room(moving=True)
    pane = clear.add(ls.Box((0.02, 6, 3), center=(4, 0, 1)), material=ls.materials.GLASS)
    clear.add(ls.Box((6, 0.02, 3), center=(0, 5, 1)), material=ls.materials.MIRROR)
    world = copy.copy(clear)
    world.atmosphere = air
    far = ls.Detection(reflectivity=0.1, range=60.0)
    measurement = ls.Measurement(range_sigma=0.01, beam=beam, returns="dual", depth=3, detection=far, crossover=(1, 5))
    sensor = dataclasses.replace(CLEAR, measurement=measurement)
    where, ignored = poses(4), [(), (clear[pane].instance,), (), ()]
    scenes = [clear, world, world, world]
    batch = sensor.scan_many(scenes, where, seed=3, ignore=ignored, fields=ALL)
    passed = aerial = 0
    for i in range(4):
        alone = sensor.scan(
            scenes[i], where[i], time=batch.time[i], frame=batch.frame[i], seed=batch.seed[i], ignore=ignored[i]
        )
        check_row(batch, i, alone)
        assert alone.path is not None
        passed += int(((alone.path > 0) & (alone.path < 255)).sum())
        aerial += 0 if alone.source is None else int((alone.source == ls.Source.atmosphere).sum())
    assert passed > 20
    assert (aerial > 20) == (air is not None)


def test_rows_of_one_seed_draw_different_noise_that_can_be_repeated() -> None:
    lidar = dataclasses.replace(CLEAR, measurement=NOISE)
    same = np.broadcast_to(poses(1), (4, 4, 4))
    batch = lidar.scan_many(room(), same, seed=7)
    assert same_bits(batch.seed, np.random.SeedSequence(7).generate_state(4, np.uint64))
    assert len({row.tobytes() for row in batch.range}) == 4
    again = lidar.scan_many(room(), same, seed=batch.seed)
    assert same_bits(again.range, batch.range)
    alike = lidar.scan_many(room(), same, seed=[5, 5, 5, 5])
    assert len({row.tobytes() for row in alike.range}) == 1
    # a longer batch begins with the same rows
    longer = lidar.scan_many(room(), np.broadcast_to(poses(1), (9, 4, 4)), seed=7)
    assert same_bits(longer.range[:4], batch.range)


def test_seeds_of_all_sizes_keep_all_their_bits() -> None:
    """NumPy has no type for integers on both sides of 2⁶³: it makes floats of them, or objects beyond 2⁶⁴."""
    seeds = [0, 2**53 + 1, 2**63 + 1, 2**64 - 1]
    assert CLEAR.scan_many(room(), poses(4), seed=seeds).seed.tolist() == seeds
    assert CLEAR.scan_many(room(), poses(2), seed=np.array(seeds[1:3], object)).seed.tolist() == seeds[1:3]
    derived = np.random.SeedSequence(2**64 - 1).generate_state(2, np.uint64)
    assert CLEAR.scan_many(room(), poses(2), seed=2**64 - 1).seed.tolist() == derived.tolist()


def test_rows_may_have_their_own_trajectories() -> None:
    scene, lidar = room(moving=True), dataclasses.replace(CLEAR, measurement=NOISE)
    drives = [ls.Trajectory.from_twist(pose, (3.0, 0, 0), (0, 0, 0.5)) for pose in poses(3)]
    batch = lidar.scan_many(scene, drives, fields=ALL, time=[0.0, 0.5, 0.25])
    for i, drive in enumerate(drives):
        scan = lidar.scan(scene, drive, time=float(batch.time[i]), seed=int(batch.seed[i]))
        assert scan.radial_velocity is not None
        check_row(batch, i, scan)


def test_rows_may_have_their_own_worlds_and_sensors() -> None:
    base, places = room(), poses(6)
    base.remove(2)  # so that ids are not places
    worlds = []
    for i in range(6):
        world = copy.copy(base)
        where = np.eye(4)
        where[0, 3] = 0.5 * i
        world.update(1, transform=where)
        worlds.append(world)
    worlds[4] = worlds[1]
    worlds[5].remove(0)
    few = ls.Lidar(ls.patterns.Grid([-0.5, 0.0, 0.5], [-0.2], rate=10.0), name="few")
    many = dataclasses.replace(CLEAR, measurement=NOISE, name="many")
    kinds = [few, many, many, few, many, many]
    batch = ls.scan_many([few, many], worlds, places, sensor=[0, 1, 1, 0, 1, 1], fields=ALL)
    assert batch.range.shape == (6, 111)
    for i, (kind, world) in enumerate(zip(kinds, worlds, strict=True)):
        check_row(batch, i, kind.scan(world, places[i], seed=int(batch.seed[i])))
    assert len({row.tobytes() for row in batch.true_range}) == 6


def test_frames_of_a_pattern_that_changes() -> None:
    lidar = ls.Lidar(ls.patterns.Mid360(rate=1000.0), measurement=NOISE)
    scene, places = room(), poses(5)
    scene.add(ls.Sphere((0, 0, 0), 30.0))  # all around, as the sensor looks up
    batch = lidar.scan_many(scene, places, fields=ALL, frame=[0, 4, 4, 9, 0])
    assert (batch.status == ls.Status.hit).mean(axis=1).min() > 0.8
    for i in range(5):
        check_row(batch, i, lidar.scan(scene, places[i], frame=int(batch.frame[i]), seed=int(batch.seed[i])))


def test_only_the_arrays_that_are_asked_for_are_there() -> None:
    scene, places = room(), poses(3)
    whole = CLEAR.scan_many(scene, places, fields=ALL)
    assert CLEAR.scan_many(scene, places).fields == ("range", "xyz", "intensity", "status", "label", "object_id")
    beam = dataclasses.replace(CLEAR, measurement=BEAM)
    whole_beam = beam.scan_many(scene, places, fields=ALL)
    for name in ALL:
        for lidar, every in ((CLEAR, whole), (beam, whole_beam)):
            one = lidar.scan_many(scene, places, fields=[name])
            assert one.fields == (name,)
            assert same_bits(getattr(one, name), getattr(every, name)), name
    with pytest.raises(AttributeError, match="true_range: not in this batch, which has label; ask for it in `fields`"):
        _ = CLEAR.scan_many(scene, places, fields=["label"]).true_range
    assert not hasattr(whole, "colour")
    assert whole_beam.range.shape == (3, 111, 2)
    assert whole_beam.xyz.shape == (3, 111, 2, 3)
    assert whole_beam.status.shape == (3, 111)


def test_memory_is_reused_and_shared_without_copies() -> None:
    scene, fields = room(), ("range", "xyz", "status")
    batch = CLEAR.scan_many(scene, poses(5), fields=fields)
    kept = batch.range
    again = CLEAR.scan_many(scene, poses(5, seed=1), out=batch)
    assert again is batch
    assert batch.range is kept
    fresh = CLEAR.scan_many(scene, poses(5, seed=1), fields=fields)
    for name in (*fields, "seed", "frame", "time"):
        assert same_bits(getattr(batch, name), getattr(fresh, name))
    for name in fields:
        array = getattr(batch, name)
        assert array.flags.c_contiguous
        assert array.flags.writeable
        assert array.flags.owndata
        taken = np.from_dlpack(array)
        assert np.shares_memory(taken, array)
        assert np.shares_memory(np.asarray(memoryview(array)), array)
    # surplus entries of a reused batch are unused again
    few = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=20.0))
    mixed = ls.scan_many([CLEAR, few], scene, poses(2), sensor=[1, 0], fields=fields)
    ls.scan_many([CLEAR, few], scene, poses(2), sensor=[0, 1], out=mixed)
    assert (mixed.status[0] != 255).all()
    assert (mixed.status[1, 1:] == 255).all()
    assert np.isnan(mixed.xyz[1, 1:]).all()


def test_a_batch_serves_frames_of_fewer_pulses() -> None:
    vlp, scene, fields = ls.Lidar.preset("velodyne-vlp16"), room(), ("range", "xyz", "status", "label")
    batch = vlp.scan_many(scene, poses(2), fields=fields)
    vlp.scan_many(scene, poses(2), frame=1, seed=4, out=batch)
    fresh = vlp.scan_many(scene, poses(2), frame=1, seed=4, fields=fields)
    few = fresh.status.shape[1]
    assert few < batch.status.shape[1]
    for name in fields:
        assert same_bits(np.ascontiguousarray(getattr(batch, name)[:, :few]), getattr(fresh, name))
    assert (batch.status[:, few:] == 255).all()
    assert np.isnan(batch.xyz[:, few:]).all()
    with pytest.raises(ArgumentValueError, match=r"^out: expected a batch whose range has shape \(2, 28944\), got "):
        vlp.scan_many(scene, poses(2), out=fresh)


def test_arrays_can_be_written_but_not_replaced() -> None:
    batch = CLEAR.scan_many(room(), poses(2))
    status = batch.status
    batch.status += 1
    assert batch.status is status
    for name, value in (("status", status.copy()), ("incidence", None), ("other", None)):
        with pytest.raises(AttributeError, match=f"^{name}: a batch keeps its arrays; write into them$"):
            setattr(batch, name, value)


def test_all_arrays_are_described() -> None:
    described = ls.ScanBatch.__doc__
    assert described
    attributes = described.split("Attributes")[1].split("Notes")[0]
    named = re.findall(r"[a-z_]+", " ".join(re.findall(r"^(\S.*) : ", attributes, re.MULTILINE)))
    assert {*named} == {*ls.ScanBatch.__annotations__}
    fields = {*ls.ScanBatch.__annotations__} - {"seed", "frame", "time"}
    batch = CLEAR.scan_many(room(), poses(1), fields=fields)
    assert {*batch.fields} == fields
    assert {*batch.path[batch.return_count > 0].tolist()} == {0}
    assert np.isnan(batch.mirrored_point).all()
    with pytest.raises(ArgumentValueError) as refused:
        CLEAR.scan_many(room(), poses(1), fields=["other"])
    assert {*refused.value.expected.removeprefix("names among ").split(", ")} == fields


def test_copies_pickles_and_text() -> None:
    batch = CLEAR.scan_many(room(), poses(2))
    for other in (copy.copy(batch), pickle.loads(pickle.dumps(batch))):  # noqa: S301 - our own
        assert other.fields == batch.fields
        assert all(same_bits(getattr(other, name), getattr(batch, name)) for name in batch.fields)
        assert not np.shares_memory(other.range, batch.range)
    assert len(batch) == 2
    assert repr(batch).startswith("ScanBatch of 2 rows")
    assert "float64 (2, 111)" in repr(batch)
    with pytest.raises(AttributeError, match="range: a batch keeps its arrays; write into them"):
        batch.range = np.zeros(3)
    with pytest.raises(TypeError, match="scan_many makes batches"):
        ls.ScanBatch()


def test_no_rows_and_no_pulses() -> None:
    none = CLEAR.scan_many(room(), np.empty((0, 4, 4)), fields=ALL)
    assert (len(none), none.range.shape, none.xyz.shape) == (0, (0, 111), (0, 111, 3))
    assert len(CLEAR.scan_many(room(), [])) == len(CLEAR.scan_many(room(moving=True), (), seed=[])) == 0
    assert ls.scan_many([CLEAR], [], np.empty((0, 4, 4)), sensor=[]).range.shape == (0, 111)
    blind = ls.Lidar(ls.patterns.Grid([], [], rate=10.0))
    assert blind.scan_many(room(), poses(3)).range.shape == (3, 0)
    assert (CLEAR.scan_many(ls.Scene(), poses(3)).status == ls.Status.miss).all()


def test_poses_of_scipy() -> None:
    places = poses(3)
    expected = CLEAR.scan_many(room(), places)
    many = RigidTransform.from_matrix(places)
    for given in (many, [RigidTransform.from_matrix(place) for place in places], list(places), places.tolist()):
        assert np.allclose(CLEAR.scan_many(room(), given).range, expected.range, equal_nan=True)


ROTTEN = poses(3)
ROTTEN[1, :3, :3] *= 1.0004

BAD: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "one pose": (lambda: CLEAR.scan_many(room(), np.eye(4)), ArgumentValueError, r"poses: expected shape \(N, 4, 4\)"),
    "not rigid": (
        lambda: CLEAR.scan_many(room(), ROTTEN),
        ArgumentValueError,
        r"poses\[1\]: expected a rigid transform .* 0.0008 away .*; orthonormalise it: Rotation.from_matrix",
    ),
    "last row": (
        lambda: CLEAR.scan_many(room(), poses(2).transpose(0, 2, 1)),
        ArgumentValueError,
        r"poses\[0\]: expected a last row of \(0, 0, 0, 1\).*transposed",
    ),
    "not finite": (lambda: CLEAR.scan_many(room(), np.full((2, 4, 4), np.nan)), ArgumentValueError, r"poses\[0\]\[0\]"),
    "a trajectory": (
        lambda: CLEAR.scan_many(room(), ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0))),
        ArgumentTypeError,
        "poses: .* N trajectories, got one trajectory",
    ),
    "a late trajectory": (
        lambda: CLEAR.scan_many(room(), [ls.Trajectory([0.0, 9.0], poses(2)), ls.Trajectory([5.0, 9.0], poses(2))]),
        ArgumentValueError,
        r"poses\[1\]: expected a trajectory over all pulses, got one from 5 to 9 s and pulse 0 at 0 s",
    ),
    "a motion that ends": (
        lambda: CLEAR.scan_many(moving_until(1.0), poses(2), time=[0.0, 1.5]),
        ArgumentValueError,
        r"time\[1\]: expected times within the motion of object 0, 0.0 to 1.0 s, got 1.5",
    ),
    "a scene with fog": (
        lambda: CLEAR.scan_many([room(), room(), foggy()], poses(3)),
        ArgumentValueError,
        r"near_threshold in scene\[2\]: expected a number > 0 in fog, got 0.0",
    ),
    "a sensor in fog": (
        lambda: ls.scan_many([IN_FOG, CLEAR], [room(), foggy()], poses(2), sensor=[0, 1]),
        ArgumentValueError,
        r"near_threshold of lidar\[1\] in scene\[1\]: expected a number > 0 in fog",
    ),
    "times": (lambda: CLEAR.scan_many(room(), poses(3), time=[0.0, 1.0]), ArgumentValueError, r"time: .*shape \(3,\)"),
    "frames": (lambda: CLEAR.scan_many(room(), poses(3), frame=[1, 2]), ArgumentValueError, r"frame: .*3 rows"),
    "a frame below 0": (
        lambda: CLEAR.scan_many(room(), poses(2), frame=[1, -2]),
        ArgumentValueError,
        r"frame\[1\] = -2",
    ),
    "a seed": (
        lambda: CLEAR.scan_many(room(), poses(2), seed=1.5),
        ArgumentTypeError,
        "seed: expected integers, got 1.5",
    ),
    "seeds that are not integers": (
        lambda: CLEAR.scan_many(room(), poses(2), seed=[1.5, 2**63]),
        ArgumentTypeError,
        "seed: expected integers, got dtype float64",
    ),
    "truth values": (
        lambda: CLEAR.scan_many(room(), poses(2), seed=[True, 2**64]),
        ArgumentTypeError,
        "seed: expected integers, got dtype object",
    ),
    "a seed beyond all": (
        lambda: CLEAR.scan_many(room(), poses(2), seed=2**64),
        ArgumentValueError,
        "seed: expected integers from 0 to 18446744073709551615, got 18446744073709551616",
    ),
    "one of the seeds": (
        lambda: CLEAR.scan_many(room(), poses(3), seed=[1, 10**400, 2**63]),
        ArgumentValueError,
        r"seed: expected integers from 0 to 18446744073709551615, got seed\[1\] = an integer of 1,329 bits",
    ),
    "a seed below 0": (
        lambda: CLEAR.scan_many(room(), poses(2), seed=[2**63, -1]),
        ArgumentValueError,
        r"seed: expected integers from 0 to 18446744073709551615, got seed\[1\] = -1",
    ),
    "scenes": (lambda: CLEAR.scan_many([room()], poses(2)), ArgumentValueError, "scene: .* 2 rows, got 1 scenes"),
    "scene": (lambda: CLEAR.scan_many(None, poses(2)), ArgumentTypeError, "scene: expected a Scene, or one for each"),  # type: ignore[arg-type]
    "no scene": (lambda: CLEAR.scan_many([room(), 1], poses(2)), ArgumentTypeError, r"scene\[1\]: expected a Scene"),
    "a sensor": (
        lambda: ls.scan_many([CLEAR, 1], room(), poses(1), sensor=[0]),
        ArgumentTypeError,
        r"lidar\[1\]: expected",
    ),
    "sensors": (lambda: ls.scan_many([CLEAR], room(), poses(2), sensor=[0, 1]), ArgumentValueError, r"sensor\[1\] = 1"),
    "no index": (lambda: ls.scan_many([CLEAR], room(), poses(2)), ArgumentTypeError, "sensor: expected an index"),
    "an index": (
        lambda: ls.scan_many(CLEAR, room(), poses(2), sensor=[0, 0]),
        ArgumentTypeError,
        "sensor: expected none",
    ),
    "no sensors": (
        lambda: ls.scan_many([], room(), poses(2), sensor=[]),
        ArgumentValueError,
        "lidar: expected at least",
    ),
    "returns": (
        lambda: ls.scan_many([CLEAR, dataclasses.replace(CLEAR, measurement=BEAM)], room(), poses(1), sensor=[0]),
        ArgumentValueError,
        r"lidar: expected sensors with one number of returns, got 1 and, of lidar\[1\], 2",
    ),
    "fields": (
        lambda: CLEAR.scan_many(room(), poses(1), fields=["rang"]),
        ArgumentValueError,
        "fields: expected names",
    ),
    "out": (lambda: CLEAR.scan_many(room(), poses(1), out=np.zeros(3)), ArgumentTypeError, "out: expected a ScanBatch"),
    "rows of out": (
        lambda: CLEAR.scan_many(room(), poses(2), out=CLEAR.scan_many(room(), poses(3))),
        ArgumentValueError,
        r"out: expected a batch whose range has shape \(2, 111\), got \(3, 111\)",
    ),
    "fields of out": (
        lambda: CLEAR.scan_many(
            room(), poses(2), fields=["range"], out=CLEAR.scan_many(room(), poses(2), fields=["xyz"])
        ),
        ArgumentValueError,
        "out: expected a batch of range, got one of xyz",
    ),
    "an instance": (lambda: CLEAR.scan_many(room(), poses(2), ignore=[99]), ArgumentValueError, "ignore: .* got 99"),
    "an instance of a row": (
        lambda: CLEAR.scan_many(room(), poses(2), ignore=[[1], [2, 98, 99]]),
        ArgumentValueError,
        r"ignore\[1\]: expected instances of objects in the scene .*, got 98, 99",
    ),
    "too few sets": (
        lambda: CLEAR.scan_many(room(), poses(3), ignore=[[1], [2]]),
        ArgumentValueError,
        "ignore: .*3 rows",
    ),
}


IN_FOG = dataclasses.replace(
    CLEAR, min_range=0.5, measurement=dataclasses.replace(CLEAR.measurement, near_threshold=0.01, near_range=20.0)
)


def foggy() -> ls.Scene:
    scene = room()
    scene.atmosphere = ls.Atmosphere.fog(80.0)
    return scene


def moving_until(end: float) -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Sphere((5, 0, 0), 1.0), motion=ls.Trajectory([0.0, end], [np.eye(4)] * 2))
    return scene


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_named(what: str) -> None:
    work, kind, message = BAD[what]
    with pytest.raises(kind, match=message):
        work()


def test_a_failed_call_keeps_its_sensor_and_scene_usable() -> None:
    scene = room()
    before = CLEAR.scan_many(scene, poses(2)).range
    with pytest.raises(ValueError, match="ignore"):
        CLEAR.scan_many(scene, poses(2), ignore=[77])
    assert same_bits(CLEAR.scan_many(scene, poses(2)).range, before)
