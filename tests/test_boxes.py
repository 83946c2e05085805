"""Boxes of things: they hold what was seen of them, wherever and whenever it is looked at."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import numpy as np
import pytest
from conformance.samples import SAMPLES, TURN
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

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


def traffic(speed: float) -> ls.Scene:
    """A road with cars that stand, drive and turn."""
    scene = ls.Scene(class_names={10: "car", 40: "road"})
    scene.add(ls.Plane((0, 0, 1), 0.0), label=40, instance=1)
    rng = np.random.default_rng(3)
    for number in range(24):
        pose = at(*(rng.uniform(8, 40) * np.array([math.cos(number), math.sin(number)])), rng.uniform(-3, 3))
        turn = (0.0, 0.0, rng.uniform(-1, 1))
        if number % 4:
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
    """The points of a raw and of a deskewed cloud; the latter with the things where they are at that moment."""
    scan = sensor().scan(traffic(30.0), EGO)
    for deskew in (False, "end"):
        boxes, cloud = scan.boxes(deskew=deskew, min_points=1), scan.point_cloud(deskew=deskew)
        own = boxes.instance[:, None] == cloud.instance
        assert boxes.contain(cloud.xyz)[own].mean() < 0.9


def test_normals_move_along_with_points() -> None:
    scene = ls.Scene()
    scene.add(ls.Box((1, 1, 1)), motion=ls.Trajectory.from_twist(at(5, 0, 0), angular=(0, 0, 9.0)))
    scan = sensor().scan(scene)
    cloud = scan.point_cloud("world", deskew="start", deskew_movers=True)
    assert len(cloud) > 500
    # At the start, the faces are axis-aligned; the normals are float32.
    assert np.abs(np.abs(cloud.normal).max(axis=1) - 1.0).max() <= 4 * np.finfo(np.float32).eps


def alone(scene: ls.Scene, instance: int) -> ls.Scene:
    only = ls.Scene()
    for item in scene:
        if item.instance == instance:
            only.add(item.shape, transform=item.transform, motion=item.motion)
    return only


def test_visibility_is_that_of_brute_force() -> None:
    lidar = sensor()
    scene = traffic(10.0)
    for number in range(6):  # walls, behind which cars are hidden in part or whole
        turn = Rotation.from_euler("z", number)
        wall = RigidTransform.from_components(turn.apply([9.0, 0, 0]), turn).as_matrix()
        scene.add(ls.Box((0.5, 5.0, 2.0), center=(0, 0, 0.5)), transform=wall, instance=number + 10, label=50)
    scan = lidar.scan(scene, EGO)
    boxes = scan.boxes()
    now = scan.time + scan.pulses.time
    poses = EGO.at(now).as_matrix()
    origins = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.pulses.origins) + poses[:, :3, 3]
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.pulses.directions)
    whole = scene.cast(origins, directions, t_max=lidar.max_range, time=now)
    owner = np.array([item.instance for item in scene])[whole.object_id]
    shares = {}
    for instance in {item.instance for item in scene if item.shape.bounded}:
        # A ray that grazes a thing may round to either side, as poses are composed in another order here.
        covered = alone(scene, instance).cast(origins, directions, t_max=lidar.max_range, time=now).hit
        if covered.any():
            shares[instance] = (whole.hit & (owner == instance))[covered].mean(), covered.sum()
    assert sorted(shares) == boxes.instance.tolist()
    expected, pulses = np.array([shares[instance] for instance in boxes.instance]).T
    assert (np.abs(boxes.visibility - expected) <= 1.0 / pulses).all()
    assert ((boxes.visibility > 0.02) & (boxes.visibility < 0.98)).sum() >= 5
    assert (boxes.visibility == 0.0).sum() == (boxes.points == 0).sum()


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


def test_selections_corners_and_copies() -> None:
    scan = sensor().scan(traffic(0.0))
    boxes = scan.boxes()
    assert repr(boxes).startswith(f"Boxes({len(boxes)} boxes, ")
    seen = boxes[boxes.points >= 200]
    assert len(seen) == len(scan.boxes(min_points=200)) < len(boxes)
    corners = boxes[:1].corners[0]
    assert boxes[:1].contain(boxes.center[0] + 0.999 * (corners - boxes.center[0])).all()
    assert not boxes[:1].contain(boxes.center[0] + 1.001 * (corners - boxes.center[0])).any()
    yaw = Rotation.from_matrix(boxes.rotation).as_euler("zyx")[:, 0]
    np.testing.assert_allclose(yaw, boxes.yaw, rtol=0, atol=4 * math.ulp(math.pi))  # by a quaternion of four roundings
    again = pickle.loads(pickle.dumps(boxes))  # noqa: S301
    assert np.array_equal(again.corners, boxes.corners)
    assert again.class_names == {10: "car", 40: "road"}
    assert len(copy.copy(scan).boxes()) == len(copy.deepcopy(scan).boxes()) == len(boxes)


def test_mistakes() -> None:
    scan = sensor().scan(traffic(0.0))
    with pytest.raises(ValueError, match="frame: expected 'sensor' or 'world', got 'body'"):
        scan.boxes(frame="body")
    with pytest.raises(ValueError, match="deskew: expected True, False"):
        scan.boxes(deskew="begin")
    with pytest.raises(ValueError, match="min_points: expected an integer >= 0, got -1"):
        scan.boxes(min_points=-1)
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
        with pytest.raises(ValueError, match=r"time: expected times within the motion of object 0, 0\.0 to 0\.11 s"):
            ask(deskew=0.2)
