"""Odometry on simulated drives: KISS-ICP, if installed, recovers the trajectory from points with firing times.

I. Vizzo et al., KISS-ICP: In Defense of Point-to-Point ICP, IEEE Robotics and Automation Letters 8, 2023.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls

Floats = npt.NDArray[np.float64]

FRAMES, PERIOD, SPEED = 100, 0.1, 11.0


def drive() -> ls.Trajectory:
    """A car that goes along a street and turns a little to and fro."""
    times = np.arange(0.0, (FRAMES + 1) * PERIOD + 0.01, 0.05)
    yaw = 0.35 * np.sin(0.8 * times)
    steps = np.diff(times, prepend=times[0])
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(yaw, (0, 0, 1))).as_matrix()
    poses[:, 0, 3], poses[:, 1, 3] = np.cumsum(SPEED * np.cos(yaw) * steps), np.cumsum(SPEED * np.sin(yaw) * steps)
    poses[:, 2, 3] = 1.8
    return ls.Trajectory(times, poses, interpolation="spline")


def street(path: ls.Trajectory) -> ls.Scene:
    """Houses, posts and trees beside the path, and eight cars that go with and against it."""
    draw, scene = np.random.default_rng(4), ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), label=1)
    turn = np.eye(4)
    for side in (-1, 1):
        along = -30.0
        while along < 150.0:
            width, deep, high = draw.uniform(6, 18), draw.uniform(6, 12), draw.uniform(4, 15)
            turn[:3, :3] = Rotation.from_euler("z", draw.uniform(-0.2, 0.2)).as_matrix()
            turn[:3, 3] = along + width / 2, side * (draw.uniform(13, 19) + deep / 2), high / 2
            scene.add(ls.Box((width, deep, high)), transform=turn, label=2)
            along += width + draw.uniform(0.5, 8)
        for _ in range(20):
            x, y = draw.uniform(-30, 150), side * draw.uniform(9, 12)
            scene.add(ls.Cylinder((x, y, 0), (x, y, draw.uniform(3, 7)), draw.uniform(0.05, 0.3)), label=3)
    for number in range(8):
        way = 1 if number % 2 else -1
        place = np.eye(4)
        place[:3, :3] = Rotation.from_euler("z", 0.0 if way > 0 else np.pi).as_matrix()
        place[:3, 3] = 55.0 + draw.uniform(-60, 60), -4.0 * way, 0.0
        motion = ls.Trajectory.from_twist(place, (draw.uniform(5, 13), 0, 0), (0, 0, 0))
        scene.add(ls.Box((4.3, 1.8, 1.5), (0, 0, 0.8)), motion=motion, label=4)
    assert path.span[1] >= FRAMES * PERIOD
    return scene


def drift(found: Floats, true: Floats) -> float:
    """KITTI's translation error, %: over all stretches of 20, 40, 60 and 80 m, the mean of the error of their ends."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1))])
    errors = []
    for length in (20.0, 40.0, 60.0, 80.0):
        for first in range(len(true)):
            last = int(np.searchsorted(travelled, travelled[first] + length))
            if last < len(true):
                off = np.linalg.inv(np.linalg.inv(found[first]) @ found[last]) @ np.linalg.inv(true[first]) @ true[last]
                errors.append(np.linalg.norm(off[:3, 3]) / length)
    assert len(errors) > 100
    return 100.0 * float(np.mean(errors))


def odometry(frames: list[tuple[Floats, Floats]], *, deskew: bool) -> Floats:
    """The poses that KISS-ICP finds."""
    kiss_icp: Any = pytest.importorskip("kiss_icp.kiss_icp")
    config = pytest.importorskip("kiss_icp.config").KISSConfig()
    config.data.deskew, config.mapping.voxel_size = deskew, 1.0
    # As many threads give sums in as many orders.
    config.registration.max_num_threads = 1
    pipeline, poses = kiss_icp.KissICP(config), []
    for points, times in frames:
        pipeline.register_frame(points, times)
        poses.append(pipeline.last_pose)
    return np.array(poses)


def test_odometry_drifts_little_when_it_knows_the_times_of_points_and_more_when_not() -> None:
    pytest.importorskip("kiss_icp")
    path = drive()
    scene, lidar = street(path), ls.Lidar.preset("ouster-os1-64", noise="datasheet")
    skewed, ours, movers = [], [], 0
    for scan in lidar.frames(scene, path, count=FRAMES):
        cloud, straight = scan.point_cloud(), scan.point_cloud(deskew="end")
        moment = (cloud.time - scan.time) / PERIOD
        skewed.append((cloud.xyz.astype(np.float64), moment.astype(np.float64)))
        ours.append((straight.xyz.astype(np.float64), moment.astype(np.float64)))
        movers += int((cloud.label == 4).sum())
    assert movers > 10_000
    # Both ways of deskewing bring points to the end of a frame; left as they are they stand for its middle.
    ends, middles = (path.at((np.arange(FRAMES) + part) * PERIOD).as_matrix() for part in (1.0, 0.5))
    own, none = drift(odometry(skewed, deskew=True), ends), drift(odometry(skewed, deskew=False), middles)
    known = drift(odometry(ours, deskew=False), ends)
    figures = f"{own:.3f} % with its own deskewing, {none:.3f} % without, {known:.3f} % with ours"
    assert max(own, known) < 0.5, figures
    assert none > max(own, known), figures
