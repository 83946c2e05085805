"""Boxes of instances: they hold what was seen of them, wherever and whenever it is looked at."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from conformance.samples import SAMPLES, TURN
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.patterns import Pulses
from lidarsim.scan.scan import scan as fire

PARTS = 5


def car(scene: ls.Scene, instance: int, motion: ls.Trajectory | None, pose: np.ndarray | None = None) -> None:
    """Add a car of `PARTS` parts, ahead along x: 4.4 m by 1.8 m by 1.6 m above the ground."""
    parts: list[ls.Shape] = [
        ls.Box((4.4, 1.7, 0.8), center=(0, 0, 0.8)),
        ls.Ellipsoid((-0.2, 0, 1.2), (1.2, 0.75, 0.4)),
        ls.Cylinder((-1.3, -0.9, 0.35), (-1.3, 0.9, 0.35), 0.35),
        ls.Cylinder((1.3, -0.9, 0.35), (1.3, 0.9, 0.35), 0.35),
        ls.TriangleMesh([(2.2, -0.2, 1.2), (2.2, 0.2, 1.2), (1.2, 0, 1.5), (1.2, 0, 1.2)], [(0, 1, 2), (1, 3, 2)]),
    ]
    assert len(parts) == PARTS
    for part in parts:
        scene.add(part, instance=instance, label=10, motion=motion, transform=pose)


def at(x: float, y: float, yaw: float, z: float = 0.0) -> np.ndarray:
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("z", yaw)).as_matrix()


def traffic(speed: float | None) -> ls.Scene:
    """A road with cars that stand, drive and turn; None: they all stand."""
    scene = ls.Scene(class_names={10: "car", 40: "road"})
    scene.add(ls.Plane((0, 0, 1), 0.0), label=40, instance=1)
    rng = np.random.default_rng(3)
    for number in range(24):
        pose = at(*(rng.uniform(8, 40) * np.array([math.cos(number), math.sin(number)])), rng.uniform(-3, 3))
        turn = (0.0, 0.0, rng.uniform(-1, 1))
        if number % 4 and speed is not None:
            car(scene, 1000 + number, ls.Trajectory.from_twist(pose, (speed, 0, 0), turn))
        else:
            car(scene, 1000 + number, None, pose)
    return scene


EGO = ls.Trajectory.from_twist(at(0, 0, 0.5, 1.8), (20.0, 0, 0), (0.02, 0.01, 0.6))


def sensor() -> ls.Lidar:
    return ls.Lidar.preset("ouster-os1-64", noise="none")


@pytest.mark.parametrize("speed", [0.0, 8.0, 30.0])
@pytest.mark.parametrize("deskew", ["start", "middle", "end", 0.07])
def test_boxes_hold_the_points_of_what_moves_and_turns(speed: float, deskew: Any) -> None:
    scan = sensor().scan(traffic(speed), EGO, time=0.5)
    for frame in ("sensor", "world"):
        boxes = scan.boxes(frame=frame, deskew=deskew, min_points=1)
        cloud = scan.point_cloud(frame, deskew=deskew, deskew_movers=True)
        own = boxes.instance[:, None] == cloud.instance
        assert own.sum() > 4000
        assert len(boxes) > 12
        assert boxes.contain(cloud.xyz)[own].all()
        assert boxes.points.tolist() == own.sum(axis=1).tolist()
        assert set(boxes.label) == {10}
        # The faces are where the shapes end: what was seen of the cars reaches them.
        local = np.abs(np.einsum("mnj,mji->mni", cloud.xyz - boxes.center[:, None], boxes.rotation))
        reach = np.where(own[:, :, None], local, 0.0).max(axis=1) / (boxes.size / 2)
        assert (reach[boxes.points > 300].max(axis=1) > 0.999).all()


def test_points_of_movers_are_smeared_unless_they_are_moved_along() -> None:
    """The points of a raw and of a deskewed cloud; the latter with the instances where they are at that moment."""
    scan = sensor().scan(traffic(30.0), EGO)
    for deskew in (False, "end"):
        boxes, cloud = scan.boxes(deskew=deskew, min_points=1), scan.point_cloud(deskew=deskew)
        own = boxes.instance[:, None] == cloud.instance
        assert boxes.contain(cloud.xyz)[own].mean() < 0.9


def test_points_move_along_from_the_time_of_their_pulse() -> None:
    """Beside the poses of `Trajectory`, point by point: neighbouring pulses, on different instances, differ in time."""
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    motions = {}
    for k in range(12):
        motion = ls.Trajectory.from_twist(at(9, -3 + 0.5 * k, 0.1 * k), (20.0, 0.5 * k, 0), (0.1, 0, 2.0 - k))
        number = scene.add(ls.Box((0.5, 0.25, 2.5)), motion=motion, instance=k + 1)
        motions[number] = motion
    scan = ls.Lidar.preset("velodyne-hdl64e-s3", noise="none").scan(scene, EGO, time=0.2)
    raw, moved = (scan.point_cloud("world", deskew="end", deskew_movers=along) for along in (False, True))
    expected, end, steps = raw.xyz.copy(), scan.time + 0.1, 0
    for number, motion in motions.items():
        own = raw.object_id == number
        assert own.sum() > 50
        expected[own] = (motion.at(end) * motion.at(scan.time + raw.time[own]).inv()).apply(raw.xyz[own])
    for first in range(0, len(raw) - 8, 8):
        steps += len(set(raw.object_id[first : first + 8].tolist()) & set(motions)) > 1
    assert steps > 20
    assert np.abs(expected).max() < 127
    assert np.abs(expected - raw.xyz).max() > 0.5
    np.testing.assert_allclose(moved.xyz, expected, rtol=0, atol=64 * 2.0**-46)  # some 60 roundings below 128 m


def test_normals_move_along_with_points() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((1, 1, 1)), motion=ls.Trajectory.from_twist(at(5, 0, 0), angular=(0, 0, 9.0)))
    scan = sensor().scan(scene)
    cloud = scan.point_cloud("world", deskew="start", deskew_movers=True)
    assert len(cloud) > 500
    # At the start, the faces are axis-aligned; the normals are float32.
    assert np.abs(np.abs(cloud.normal).max(axis=1) - 1.0).max() <= 4 * np.finfo(np.float32).eps


@pytest.mark.parametrize("pose", [at(3, 1, 0.5, 1.8), EGO], ids=["still", "moving"])
def test_boxes_of_instances_at_rest_hold_their_points_as_they_are(pose: Any) -> None:
    scan = sensor().scan(traffic(None), pose, time=0.5)
    clouds = [("world", False), ("sensor", "end")]
    for frame, deskew in [*clouds, ("sensor", False)] if isinstance(pose, np.ndarray) else clouds:
        boxes, cloud = scan.boxes(frame=frame, deskew=deskew), scan.point_cloud(frame, deskew=deskew)
        own = boxes.instance[:, None] == cloud.instance
        assert own.sum() > 4000
        assert boxes.contain(cloud.xyz)[own].all()


def test_pulses_that_meet_the_ground_far_beyond_the_range_widen_no_boxes() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0))
    scene.add(ls.Box((4, 2, 2), center=(10, 3, 1)))
    mast = np.eye(4)
    mast[2, 3] = 1.9
    mast[:3, :3] = Rotation.from_euler("y", 1, degrees=True).as_matrix()  # 90° aside, its pulses are nearly level
    scan = ls.Lidar(ls.patterns.Spinning([0.0], columns=900), max_range=80.0).scan(scene, mast)
    assert np.nanmax(scan.true_range) > 1e9
    # 64 roundings, each at both ends, of the sum of centre, size and the farthest point on the box: below 32 m.
    np.testing.assert_allclose(scan.boxes().size, [[4, 2, 2]], rtol=0, atol=2 * 64 * 2.0**-53 * 32)


def test_boxes_of_a_rig_hold_the_points_of_all_its_sensors() -> None:
    """At the moment of one key frame, in the world: of a sensor above and of one ahead, half a frame later."""
    lidar = sensor()
    rig = ls.Rig({"top": (lidar, at(0, 0, 0.3, 0.4)), "front": (lidar, at(2, 0, -1.0, -0.5), 0.05)})
    scans = next(iter(rig.frames(traffic(30.0), EGO, 1)))
    key = 0.08
    seen = {}
    for scan in scans.values():
        boxes = scan.boxes(frame="world", deskew=key - scan.time, min_points=1)
        cloud = scan.point_cloud("world", deskew=key - scan.time, deskew_movers=True)
        own = boxes.instance[:, None] == cloud.instance
        assert own.sum() > 2000
        assert boxes.contain(cloud.xyz)[own].all()
        for instance, center in zip(boxes.instance.tolist(), boxes.center, strict=True):
            # One instance has one place, whoever sees it: up to the roundings of numbers below 2⁷ m.
            assert np.abs(seen.setdefault(instance, center) - center).max() <= 64 * math.ulp(100.0)
    assert len(seen) > 12


def alone(scene: ls.Scene, instance: int) -> ls.Scene:
    only = ls.Scene()
    for item in scene:
        if item.instance == instance:
            only.add(item.shape, transform=item.transform, motion=item.motion)
    return only


def crowd(seed: int) -> ls.Scene:
    """Instances of one to three parts of all bounded shapes, at rest and in motion, and planes behind them."""
    scene, rng = ls.Scene(), np.random.default_rng(seed)
    scene.add(ls.Plane((0, 0, 1), -1.5), instance=9000)
    scene.add(ls.Plane((1, 0, 0), 30.0), instance=9001)
    ico = [(0, 0, 1), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)]
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1), (5, 2, 1), (5, 3, 2), (5, 4, 3), (5, 1, 4)]
    scene.add(ls.Box((0.5, 12, 6), center=(4, 0, 0)), instance=0)  # hides what is behind it
    for instance in (8001, 8002):  # meshes in the world
        soup = rng.uniform(-4, 4, 3) + 3 * rng.normal(size=(200, 1, 3)) + 0.3 * rng.normal(size=(200, 3, 3))
        scene.add(ls.TriangleMesh(soup.reshape(-1, 3), np.arange(600).reshape(-1, 3)), instance=instance)
    for instance in range(100, 170):
        place = at(*rng.uniform(-25, 25, 2), rng.uniform(-3, 3), rng.uniform(-1, 2))
        motion = ls.Trajectory.from_twist(place, rng.uniform(-30, 30, 3), rng.uniform(-2, 2, 3))
        for _ in range(rng.integers(1, 4)):
            aside = rng.uniform(-1, 1, 3)
            shape, label = (
                (ls.Box(rng.uniform(0.3, 3, 3), center=aside), 1),
                (ls.Sphere(aside, rng.uniform(0.2, 1.5)), 2),
                (ls.Cylinder(aside, aside + rng.uniform(0.5, 2, 3), 0.4), 3),
                (ls.Disk(aside, rng.normal(size=3), 0.9), 4),
                (ls.Spheres(rng.uniform(-1, 1, (30, 3)), rng.uniform(0.05, 0.3, 30)), np.arange(30) % 3),
                (ls.Disks(rng.uniform(-1, 1, (30, 3)), rng.normal(size=(30, 3)), rng.uniform(0.1, 0.4, 30)), 6),
                (ls.TriangleMesh(np.array(ico) + aside, faces), np.array([7, 7, 7, 8, 8, 7, 7, 7])),
            )[rng.integers(7)]
            if instance % 2:
                scene.add(shape, instance=instance, label=label, motion=motion)
            else:
                scene.add(shape, instance=instance, label=label, transform=place)
    for item in list(scene)[5:40:7]:
        scene.remove(item.id)  # so that ids are not places
    return scene


def plainly(**measurement: Any) -> ls.Lidar:
    """A lidar whose maximum range cuts through the crowd."""
    lidar = ls.Lidar.preset("ouster-os1-64", noise="none")
    return replace(lidar, max_range=22.0, min_range=0.0, measurement=ls.Measurement(**measurement))


class Scattered:
    """Pulses of random origins and directions, each at a time of its own: their rays share no packets."""

    rate, shape = 10.0, (1, 4000)

    def pulses(self, _: int = 0) -> Pulses:
        rng, count = np.random.default_rng(8), self.shape[1]
        directions = Rotation.random(count, rng=rng).apply([1, 0, 0])
        times = np.sort(rng.uniform(0, 0.1, count))
        return Pulses(directions, rng.uniform(-2, 2, (count, 3)), times, np.zeros(count, int), np.arange(count))


SENSORS = {
    "one ray": plainly(),
    "jitter": plainly(azimuth_sigma=1e-3, elevation_sigma=1e-3),
    "beam": plainly(beam=ls.Beam(3e-3, rays=7), returns=2),
    "false returns": plainly(false_returns=0.3, dropout=0.5, returns="first"),
    "dropout": plainly(dropout=0.5),
    "receiver aside": plainly(receiver_offset=0.5),
    "scattered": ls.Lidar(Scattered(), max_range=22.0),
}


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("seed", range(3))
def test_visibility_is_that_of_brute_force(name: str, seed: int) -> None:
    lidar, scene, mount = SENSORS[name], crowd(seed), at(1, 0.5, 0.4, 0.3)
    around = seed < 2  # else all instances are aside, and most pulses can meet none
    for item in () if around else list(scene):
        place = item.transform if item.motion is None else item.motion.at(0.0).as_matrix()
        if item.shape.bounded and (place is None or place[1, 3] < 12.0):
            scene.remove(item.id)
    scan = next(iter(ls.Rig({"top": (lidar, mount)}).frames(scene, EGO, 1)))["top"]
    if seed == 1:
        some = np.random.default_rng(3).permutation(len(scan))[: len(scan) // 2]
        scan = fire(lidar, scene, EGO @ mount, indices=some)
    boxes = scan.boxes()
    now, poses = scan.time + scan.pulses.time, scan.poses
    origins = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.pulses.origins) + poses[:, :3, 3]
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.pulses.directions)
    whole = scene.cast(origins, directions, t_max=lidar.max_range, time=now)
    owner = np.full(max(item.id for item in scene) + 2, -1)
    owner[[item.id for item in scene]] = [item.instance for item in scene]
    owner = owner[whole.object_id]  # -1, a miss, picks the last
    shares = {}
    for instance in {item.instance for item in scene if item.shape.bounded}:
        # A ray that grazes an instance may round to either side, as poses are composed in another order here.
        covered = alone(scene, instance).cast(origins, directions, t_max=lidar.max_range, time=now).hit
        if covered.any():
            shares[instance] = (owner == instance)[covered].mean(), covered.sum(), now[covered].mean()
    seen = boxes.visibility == boxes.visibility
    assert sorted(shares) == boxes.instance[seen].tolist()
    assert (boxes.points[~seen] > 0).all()  # off the nominal rays
    assert (0 in shares) == around
    expected, pulses, mean_time = np.array([shares[instance] for instance in boxes.instance[seen]]).T
    assert (np.abs(boxes.visibility[seen] - expected) <= 1.0 / pulses).all()
    assert ((boxes.visibility > 0.02) & (boxes.visibility < 0.98)).sum() >= (12 if around else 2)
    hidden = boxes.points[seen] == 0
    # Times are rounded to 2⁻⁴⁰ s; one pulse more or less of n moves their mean by at most a period of 0.1 s over n.
    assert (np.abs(boxes.time[seen] - mean_time)[hidden] <= 2.0**-40 + 0.1 / pulses[hidden]).all()
    if name == "one ray" and around:
        assert (boxes.visibility == 0.0).sum() == (boxes.points == 0).sum() > 0


def test_instances_are_as_visible_from_afar() -> None:
    """Rays from beyond 10³⁰ m, which fit into no packet; a power of two scales without rounding."""
    shares = []
    for scale in (1.0, 2.0**104):
        scene, pose = ls.Scene(), at(-scale, 0, 0)
        scene.add(ls.Sphere((3 * scale, 0, 0), scale), instance=1)
        scene.add(ls.Sphere((6 * scale, 0, 0), 2 * scale), instance=2)
        scene.add(ls.Sphere((6 * scale, 1.5 * scale, 0), scale), instance=2)
        lidar = ls.Lidar(looker().pattern, max_range=64 * scale)
        shares.append(lidar.scan(scene, pose).boxes().visibility)
    assert np.array_equal(*shares)
    assert 0.0 < shares[0][1] < shares[0][0] == 1.0


@pytest.mark.parametrize("other", ["jitter", "false returns", "dropout", "beam", "receiver aside"])
def test_visibility_is_that_of_nominal_rays_whatever_the_noise(other: str) -> None:
    scene = crowd(5)
    plain, noisy = (SENSORS[name].scan(scene, EGO).boxes() for name in ("one ray", other))
    _, one, two = np.intersect1d(plain.instance, noisy.instance, return_indices=True)
    assert len(one) == len(plain) > 15
    assert np.array_equal(plain.visibility[one], noisy.visibility[two])
    assert not np.array_equal(plain.points[one], noisy.points[two])


@pytest.mark.parametrize("name", SENSORS)
def test_boxes_that_are_asked_for_are_those_among_all(name: str) -> None:
    scan = SENSORS[name].scan(crowd(1), EGO)
    every = scan.boxes(deskew="end")
    for least, labels in ((3, None), (0, [2, 7]), (3, (1, 3, 4))):
        among = every.points >= least
        among &= True if labels is None else np.isin(every.label, labels)
        assert 3 < among.sum() < len(every)
        some, expected = scan.boxes(deskew="end", min_points=least, labels=labels), every[among]
        for entry in (field.name for field in fields(some)):
            assert entry == "class_names" or np.array_equal(
                getattr(some, entry), getattr(expected, entry), equal_nan=True
            )


def test_labels_of_boxes_may_be_class_names() -> None:
    scan = sensor().scan(traffic(8.0))
    assert scan.boxes(labels=["car"]).instance.tolist() == scan.boxes(labels={10}).instance.tolist()
    assert len(scan.boxes(labels=["car", 40])) == len(scan.boxes()) > len(scan.boxes(labels=[])) == 0


def test_boxes_depend_neither_on_threads_nor_on_instructions(
    instruction_sets: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = SENSORS["jitter"].scan(crowd(2), EGO)
    expected = scan.boxes()
    assert (expected.points == 0).any()  # whose times are sums over pulses on all threads
    for isa in instruction_sets:
        for threads in ("1", "3"):
            monkeypatch.setenv("LIDARSIM_ISA", isa)
            monkeypatch.setenv("LIDARSIM_THREADS", threads)
            again = scan.boxes()
            for name in ("visibility", "points", "time", "center", "truncation"):
                assert np.array_equal(getattr(expected, name), getattr(again, name)), (isa, threads, name)


@pytest.mark.parametrize("length", [1.0, 1.0 - 2.0**-22, 1.0 + 2.0**-22])
@pytest.mark.parametrize("limit", [22.0, math.nextafter(22.0, 0.0), math.nextafter(22.0, 30.0), 22.0 + 2.0**-19])
def test_what_begins_near_the_maximum_range_is_decided_as_by_a_cast(length: float, limit: float) -> None:
    """A wall whose face is there, for a direction that is of unit length only to float32: its t is not the range."""

    class Ahead:
        rate, shape = 10.0, (1, 1)

        def pulses(self, _: int = 0) -> Pulses:
            return Pulses([[length, 0, 0]], [[0, 0, 0]], time=[0.0], ring=[0], column=[0])

    scene = ls.Scene()
    scene.add(ls.Box((1, 4, 4), center=(22.5, 0, 0)), instance=5)
    scene.add(ls.Box((1, 9, 9), center=(24.5, 0, 0)), instance=6)
    boxes = ls.Lidar(Ahead(), max_range=limit).scan(scene).boxes()
    met = scene.cast([[0, 0, 0]], [[length, 0, 0]], t_max=limit).hit[0]
    assert boxes.instance[boxes.visibility > 0].tolist() == ([5] if met else [])


# --- Truncation ------------------------------------------------------------------------------------------------------


def looker(azimuth: float = 60.0, low: float = -15.0, high: float = 15.0, *, max_range: float = 100.0) -> ls.Lidar:
    """A lidar with a field of view of twice this azimuth, and between these elevations, degrees."""
    grid = ls.patterns.Grid(
        np.radians(np.linspace(azimuth, -azimuth, 241)), np.radians(np.linspace(high, low, 31)), rate=10.0
    )
    return ls.Lidar(grid, max_range=max_range)


def truncation(lidar: ls.Lidar, size: Any, pose: np.ndarray, **options: Any) -> float:
    scene = ls.Scene()
    scene.add(ls.Box(size), transform=pose)
    boxes = lidar.scan(scene).boxes(**options)
    assert len(boxes) == 1
    return boxes.truncation[0].item()


EXACT = 64 * math.ulp(math.pi)
"""More than the roundings of the angles and distances of a corner, which are a dozen numbers below 4."""


def test_a_car_half_out_of_view_is_half_truncated() -> None:
    aside = math.radians(60.0)
    car = at(20 * math.cos(aside), 20 * math.sin(aside), aside + math.pi / 2)
    # Half of its azimuths are left of the last column: a car of 4.4 m at 20 m spans more than 0.2 rad.
    assert abs(truncation(looker(), (4.4, 1.8, 1.6), car) - 0.5) <= EXACT / 0.2
    assert truncation(looker(), (4.4, 1.8, 1.6), at(20, 0, 1.0)) == 0.0
    assert truncation(looker(), (4.4, 1.8, 1.6), at(20, 0, 1.0), frame="world", deskew="end") == 0.0


def test_nothing_around_is_truncated_by_a_full_turn() -> None:
    scene = ls.Scene()
    for azimuth in np.linspace(0, 2 * np.pi, 60, endpoint=False):  # a closed ring, as a car spans more than 0.2 rad
        scene.add(ls.Box((1.8, 4.4, 1.6)), transform=at(20 * math.cos(azimuth), 20 * math.sin(azimuth), azimuth))
    boxes = sensor().scan(scene).boxes()
    assert len(boxes) == 60
    assert (boxes.truncation == 0.0).all()


def test_a_pedestrian_nearby_is_cut_by_the_lowest_beam() -> None:
    feet, head = -1.5, 0.3
    near, far = 2.75, math.hypot(3.25, 0.25)
    lowest, highest = math.atan2(feet, near), math.atan2(head, near)
    expected = (math.radians(-15) - lowest) / (highest - lowest)
    found = truncation(looker(), (0.5, 0.5, head - feet), at(3, 0, 0, (feet + head) / 2))
    assert far > near
    assert 0.3 < expected < 0.7
    # The lowest corners are those of the near face, which are 0.25 m aside.
    corner = math.hypot(near, 0.25)
    lowest, highest = math.atan2(feet, corner), math.atan2(head, corner)
    assert abs(found - (math.radians(-15) - lowest) / (highest - lowest)) <= EXACT / 0.4


def overlap(low: float, high: float, first: float, last: float) -> float:
    return max(0.0, min(high, last) - max(low, first)) / (high - low)


def test_truncation_is_the_share_of_azimuth_elevation_and_range() -> None:
    """Against a plain reckoning, corner by corner, for boxes ahead that reach out of view on any side."""
    lidar, rng = looker(max_range=30.0), np.random.default_rng(1)
    shares = []
    for _ in range(60):
        size = rng.uniform(0.5, 12, 3)
        where = rng.uniform(8, 30), rng.uniform(-1.2, 1.2), rng.uniform(-0.3, 0.3)
        pose = at(where[0] * math.cos(where[1]), where[0] * math.sin(where[1]), rng.uniform(-3, 3), where[0] * where[2])
        corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * size @ pose[:3, :3].T + pose[:3, 3]
        if corners[:, 0].min() <= 0.0:
            continue  # this reckoning is of azimuths within a quarter turn of straight ahead
        scene = ls.Scene()
        scene.add(ls.Box(size), transform=pose)
        found = lidar.scan(scene).boxes()
        if not len(found):
            continue
        azimuths = [math.atan2(y, x) for x, y, _ in corners]
        elevations = [math.atan2(z, math.hypot(x, y)) for x, y, z in corners]
        ranges = [math.hypot(*corner) for corner in corners]
        inside = overlap(min(azimuths), max(azimuths), -math.radians(60), math.radians(60))
        inside *= overlap(min(elevations), max(elevations), -math.radians(15), math.radians(15))
        inside *= overlap(min(ranges), max(ranges), 0.0, 30.0)
        # The least box spans 0.5 m at less than 40 m.
        assert abs(found.truncation[0] - (1.0 - inside)) <= 3 * EXACT / (0.5 / 40)
        shares.append(1.0 - inside)
    assert len(shares) > 25
    assert sum(0.05 < share < 0.95 for share in shares) > 12
    assert 0.0 in shares


def test_truncation_where_the_view_is_odd() -> None:
    room = at(1, 0, 0)
    assert abs(truncation(looker(90.0, -89.0, 89.0), (8, 8, 8), room) - 0.5) < 0.02  # around the sensor: half a turn
    flat = ls.Lidar(ls.patterns.Grid(np.radians(np.linspace(-60, 60, 121)), [0.0], rate=10.0))
    assert truncation(flat, (2, 2, 2), at(10, 0, 0)) == 0.0  # one elevation does not limit it
    upright = ls.Lidar(ls.patterns.Grid([0.0], np.radians(np.linspace(-20, 20, 121)), rate=10.0))
    assert truncation(upright, (2, 2, 2), at(10, 0, 0)) == 0.0
    single = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
    assert truncation(single, (2, 2, 2), at(10, 0, 0)) == 0.0
    rear = ls.Lidar(ls.patterns.Grid(np.radians(np.linspace(120, 240, 121)), np.radians([-9, 0, 9]), rate=10.0))
    assert truncation(rear, (2, 2, 2), at(-20, 0, 0.3)) == 0.0  # a view across ±π
    aside = math.radians(120.0)
    pose = at(20 * math.cos(aside), 20 * math.sin(aside), aside)
    assert abs(truncation(rear, (2, 2, 2), pose) - 0.5) <= EXACT / 0.1


def test_a_gap_behind_limits_the_view_unless_it_is_narrow() -> None:
    span = 2 * math.atan2(1, 19)
    for gap in (0.5, 2.0, 4.0):
        pattern = ls.patterns.Spinning(
            np.radians([-9, 0, 9]), columns=7200, rate=10.0, field_of_view=math.radians(360 - gap)
        )
        azimuths = np.sort(pattern.pulses().azimuth)
        widest = np.diff(azimuths, append=azimuths[0] + math.tau).max()
        assert math.radians(gap) <= widest <= math.radians(gap + 0.06)
        found = truncation(ls.Lidar(pattern), (2, 2, 2), at(-20, 0, 0))
        assert abs(found - (widest / span if gap > 1.0 else 0.0)) <= EXACT / span


def test_velocity_is_the_derivative_of_the_centre() -> None:
    scan = sensor().scan(traffic(12.0), EGO)
    step = 2.0**-10
    world = {key: scan.boxes(frame="world", deskew=0.05 + key * step) for key in (-1, 0, 1)}
    differences = (world[1].center - world[-1].center) / (2 * step)
    assert np.linalg.norm(world[0].velocity, axis=1).max() > 10.0
    # The third derivative is at most v·ω² < 20 m/s³, times step²/6.
    np.testing.assert_allclose(world[0].velocity, differences, rtol=0, atol=20 * step**2)
    sensor_frame = scan.boxes(deskew=0.05)
    back = EGO.at(0.05).rotation.as_matrix().T
    np.testing.assert_allclose(sensor_frame.velocity, world[0].velocity @ back.T, rtol=0, atol=64 * math.ulp(16.0))


def test_parts_move_together_in_one_box() -> None:
    """A walker whose arm swings: the box grows with the arm."""
    scene = ls.Scene()
    scene.add(ls.Box((0.4, 0.5, 1.8), center=(6, 0, 0)), instance=7)
    arm = ls.Trajectory.from_twist(at(6, 0.3, 0), angular=(0, 2 * np.pi, 0))
    scene.add(ls.Box((0.1, 0.1, 0.8), center=(0, 0, -0.4)), instance=7, motion=arm)
    scan = sensor().scan(scene, time=0.0)
    hanging, swung = scan.boxes(deskew="start"), scan.boxes(deskew=0.25)
    assert len(hanging) == len(swung) == 1
    # Sizes are rounded up by 2 · 64 · 2⁻⁵³ of less than 20 m.
    slack = 2 * 64 * 2.0**-53 * 20.0
    np.testing.assert_allclose(hanging.size, [[0.4, 0.6, 1.8]], rtol=0, atol=slack)
    np.testing.assert_allclose(swung.size, [[1.0, 0.6, 1.8]], rtol=0, atol=slack)


@pytest.mark.parametrize(
    ("turn", "axes"),
    [
        (np.eye(3), np.eye(3)),
        (Rotation.from_euler("z", 2.5).as_matrix() * 3.0, Rotation.from_euler("z", 2.5).as_matrix()),
        ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.eye(3)),  # y up
        ([[0, 0, 1], [1, 0, 0], [0, 1, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # y up, and x to the left
        ([[0, 1, 0], [0, 0, 1], [1, 0, 0]], np.eye(3)),  # x up: y takes its place
        (np.diag([1, -1, -1]), np.eye(3)),  # upside down
        (np.diag([1, -1, 1]), np.eye(3)),  # mirrored
    ],
)
def test_axes_are_those_of_the_first_object_with_z_up(turn: Any, axes: Any) -> None:
    scene, pose = ls.Scene(), at(5, 0, 0)
    pose[:3, :3] = turn
    scene.add(ls.Box((1, 1, 1)), transform=pose)
    boxes = sensor().scan(scene).boxes()
    np.testing.assert_allclose(boxes.rotation, [axes], rtol=0, atol=8 * math.ulp(1.0))


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)
@pytest.mark.parametrize("placed", [False, True])
def test_extents_are_those_of_the_surface(sample: Any, placed: bool) -> None:
    matrix = np.eye(4)
    if placed:
        matrix[:3] = np.column_stack([TURN @ np.diag([2.0, 0.5, -1.0]), (0.25, 1.0, -0.5)])
    shape = sample.build(transform=matrix if placed else None)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    low, high = shape._extent(np.column_stack([turn, np.zeros(3)]))
    if not shape.bounded:
        assert (low == -np.inf).all()
        assert (high == np.inf).all()
        return
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200_000, 3))
    origins = rng.uniform(-2, 2, (200_000, 3))
    roots = shape.roots(origins, directions)
    line, _ = np.nonzero(np.isfinite(roots))
    points = (origins[line] + roots[np.isfinite(roots)][:, None] * directions[line]) @ turn.T
    assert len(points) > 10_000
    # t times a direction, its sum with the origin and the turn are rounded, each number by far less than 2⁻⁴⁰.
    assert (points >= low - 2.0**-40).all()
    assert (points <= high + 2.0**-40).all()
    assert (points.min(axis=0) - low < 0.2 * (high - low)).all()  # few lines meet a corner of a triangle
    assert (high - points.max(axis=0) < 0.2 * (high - low)).all()


def test_what_has_no_box() -> None:
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), -2.0))
    scene.add(ls.Sphere((0, 0, 500.0), 1.0))  # above what the sensor sees
    scene.add(ls.Plane((1, 0, 0), 50.0), instance=9)
    scene.add(ls.Sphere((5, 0, 0), 1.0), instance=9)  # a part of it is unbounded
    scan = sensor().scan(scene)
    for frame in ("sensor", "world"):
        boxes = scan.boxes(frame=frame)
        assert len(boxes) == 0
        assert boxes.corners.shape == (0, 8, 3)
        assert boxes.contain(np.zeros((3, 3))).shape == (0, 3)
    assert len(sensor().scan(ls.Scene()).boxes()) == 0


def test_empty_parts_do_not_count() -> None:
    found = []
    for parts in (1, 2):
        scene = ls.Scene()
        scene.add(ls.Disks(np.zeros((0, 3)), np.zeros((0, 3)), 1.0), instance=9)
        scene.add(ls.Sphere((5, 0, 0), 1.0), instance=9 if parts == 2 else 8)
        found.append(sensor().scan(scene).boxes(frame="world"))
    assert len(found[0]) == len(found[1]) == 1
    np.testing.assert_array_equal(found[1].corners, found[0].corners)


def test_selections_corners_and_copies() -> None:
    scan = sensor().scan(traffic(0.0))
    boxes = scan.boxes()
    assert repr(boxes) == (
        f"Boxes of 24 instances with {boxes.points.sum():,} points\n  car  24 instances  {boxes.points.sum():,} points"
    )
    assert repr(boxes[:0]) == "Boxes of 0 instances with 0 points"
    assert "<td>car</td>" in boxes._repr_html_()
    rows = np.asarray(boxes)
    assert np.array_equal(rows, np.column_stack([boxes.center, boxes.size, boxes.yaw]))
    assert np.asarray(boxes, np.float32).dtype == np.float32
    assert [len(box) for box in boxes] == [1] * 24
    seen = boxes[boxes.points >= 200]
    assert len(boxes[[]]) == 0
    assert len(boxes[-1]) == 1
    with pytest.raises(TypeError, match=r"^index: expected indices, a mask or a slice, got 'car'; boxes\[boxes\.label"):
        _ = boxes["car"]
    with pytest.raises(
        IndexError, match=r"^index: expected a mask of shape \(24,\), one entry for each of the boxes, got"
    ):
        _ = boxes[boxes.points[1:] > 0]
    assert len(seen) == len(scan.boxes(min_points=200)) < len(boxes)
    corners = boxes[:1].corners[0]
    for k, ahead in enumerate(np.ndindex(2, 2, 2)):  # back before front, right before left, bottom before top
        assert ((((corners[k] - boxes.center[0]) @ boxes.rotation[0]) > 0) == ahead).all()
    assert boxes[:1].contain(boxes.center[0] + 0.999 * (corners - boxes.center[0])).all()
    assert not boxes[:1].contain(boxes.center[0] + 1.001 * (corners - boxes.center[0])).any()
    yaw = Rotation.from_matrix(boxes.rotation).as_euler("zyx")[:, 0]
    np.testing.assert_allclose(yaw, boxes.yaw, rtol=0, atol=4 * math.ulp(math.pi))  # by a quaternion of four roundings
    again = pickle.loads(pickle.dumps(boxes))  # noqa: S301
    assert np.array_equal(again.corners, boxes.corners)
    assert again.class_names == {10: "car", 40: "road"}
    assert len(copy.copy(scan).boxes()) == len(copy.deepcopy(scan).boxes()) == len(boxes)


def test_the_label_of_most_faces_is_that_of_the_box() -> None:
    """However large; of labels with as many faces, the smallest."""
    largest, corners = 2**32 - 1, [[5, 0, 0], [5, 1, 0], [5, 0, 1], [5, 1, 1]]
    for faces, expected in {(7, largest, largest): largest, (largest, 7): 7, (0, 9, 3, 9, 3): 3}.items():
        scene = ls.Scene()
        scene.add(ls.TriangleMesh(corners, [[0, 1, 2 + k % 2] for k in range(len(faces))]), label=faces)
        assert sensor().scan(scene).boxes().label.tolist() == [expected]


def test_boxes_are_those_of_the_scene_as_it_was_scanned() -> None:
    scene = ls.Scene()
    ball = scene.add(ls.Sphere((5, 0, 0), 1.0))
    before = sensor().scan(scene)
    scene.update(ball, shape=ls.Sphere((0, 7, 0), 2.0))
    after = sensor().scan(scene)
    for scan, center, size in ((before, (5, 0, 0), 2.0), (after, (0, 7, 0), 4.0), (before, (5, 0, 0), 2.0)):
        boxes = scan.boxes()
        np.testing.assert_allclose(boxes.center, [center], rtol=0, atol=math.ulp(8.0))
        np.testing.assert_allclose(boxes.size, [[size] * 3], rtol=0, atol=2 * 64 * 2.0**-53 * 32.0)


def test_a_motion_that_ends_with_the_frame_holds_its_end() -> None:
    """The end of a frame, a sum of rounded times, may be an ulp or two after the end of the motion."""
    lidar, late = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0)), 0
    for frame in range(100):
        scene, end = ls.Scene(), (frame + 1) / 10
        motion = ls.Trajectory([0.0, end], np.stack([at(5, 0, 0), at(5 + end, 0, 0)]))
        scene.add(ls.Sphere((0, 0, 0), 1.0), motion=motion)
        scan = lidar.scan(scene, time=frame / 10, frame=frame)
        late += scan.time + 0.1 > end
        near = 8 * math.ulp(16.0)  # a few roundings of coordinates up to 16 m
        np.testing.assert_allclose(scan.boxes(deskew="end").center, [[5 + end, 0, 0]], rtol=0, atol=near)
        cloud = scan.point_cloud(deskew="end", deskew_movers=True)
        np.testing.assert_allclose(cloud.xyz, [[4 + end, 0, 0]], rtol=0, atol=near)
    assert late


def test_no_pulses_no_boxes() -> None:
    class Silent:
        rate, shape = 10.0, (1, 1)

        def pulses(self, _: int = 0) -> Pulses:
            return Pulses(np.empty((0, 3)), np.empty((0, 3)), [], [], [])

    assert len(ls.Lidar(Silent()).scan(traffic(0.0)).boxes(deskew="end")) == 0


def test_mistakes() -> None:
    scan = sensor().scan(traffic(0.0))
    with pytest.raises(ValueError, match="frame: expected 'sensor' or 'world', got 'body'"):
        scan.boxes(frame="body")
    with pytest.raises(ValueError, match="deskew: expected True, False"):
        scan.boxes(deskew="begin")
    with pytest.raises(ValueError, match="min_points: expected an integer >= 0, got -1"):
        scan.boxes(min_points=-1)
    with pytest.raises(TypeError, match=r"min_points: expected an integer >= 0, got 1\.5"):
        scan.boxes(min_points=1.5)
    with pytest.raises(
        ValueError, match=r"labels: expected labels, or names among class_names \('car', 'road'\), got 'ca'"
    ):
        scan.boxes(labels=["car", "ca"])
    with pytest.raises(TypeError, match=r"labels: expected labels, or names among .*, got 'car'"):
        scan.boxes(labels="car")
    with pytest.raises(ValueError, match="labels: expected an integer from 0 to 4294967295, got -1"):
        scan.boxes(labels=[-1])
    with pytest.raises(ValueError, match="deskew_movers: expected a deskewed cloud, got deskew=False"):
        scan.point_cloud(deskew_movers=True)
    pickled = pickle.loads(pickle.dumps(scan))  # noqa: S301
    with pytest.raises(ValueError, match="scan: expected one with its scene, got one from a pickle"):
        pickled.boxes()
    scene = ls.Scene()
    short = ls.Trajectory([0.0, 0.11], np.stack([at(5, 0, 0), at(6, 0, 0)]))
    scene.add(ls.Sphere((0, 0, 0), 1.0), motion=short)
    scan = sensor().scan(scene)
    assert scan.boxes(deskew="end").points[0] > 100
    for ask in (scan.boxes, lambda deskew: scan.point_cloud(deskew=deskew, deskew_movers=True)):
        with pytest.raises(ValueError, match=r"^deskew: expected times within the motion of object 0, 0\.0 to 0\.11 s"):
            ask(deskew=0.2)
