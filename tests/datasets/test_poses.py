"""Poses of data sets, of lidarsim or in the same formats, as the trajectory of another recipe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.datasets.recipe import load

FRAMES = 6
RUN: dict[str, Any] = {
    "sensor": {"pattern": {"type": "grid", "azimuths_deg": [0, 5], "elevations_deg": [-20], "rate_hz": 10}},
    "pose": {"position_m": [7, -2, 1.5], "rotation_deg": {"yaw": 40, "pitch": 3}, "linear_m_per_s": [8, 0, 0],
             "angular_deg_per_s": [0, 0, 20]},
    "scene": [{"shape": "plane", "normal": [0, 0, 1], "name": "floor"}],
}  # fmt: skip


def write(path: Path, layout: str, frames: int, pose: Any) -> Path:
    recipe = {"sequences": 2, "frames": frames, "layout": layout, "run": RUN | {"pose": pose}}
    path.write_text(yaml.safe_dump(recipe))
    return path


def poses(path: Path, times: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The poses at which the sensor of a recipe's first sequence is."""
    pose = load(path).source.run(0).pose
    assert isinstance(pose, ls.Trajectory)
    matrices: np.ndarray[Any, Any] = pose.at(times).as_matrix()
    return matrices


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("poses") / "first.yaml", "nuscenes", FRAMES, RUN["pose"])


def test_poses_of_nuscenes_come_back(first: Path, tmp_path: Path) -> None:
    ls.generate(first, tmp_path / "set", pictures=0)
    pose = {"file": "set/v1.0-lidarsim/ego_pose.json", "scene": "scene-0001"}
    again = write(tmp_path / "again.yaml", "nuscenes", FRAMES - 1, pose)
    times = np.arange(FRAMES) / 10
    # A stamp is rounded to 1 µs, in which the car moves by 8 µm; matrices become quaternions and back.
    np.testing.assert_allclose(poses(again, times), poses(first, times), rtol=0, atol=8e-6)
    ls.generate(again, tmp_path / "set again", pictures=0)
    made = ls.Trajectory.load(tmp_path / "set again/v1.0-lidarsim/ego_pose.json", scene="scene-0000")
    np.testing.assert_allclose(made.poses.as_matrix(), poses(first, times[:-1]), rtol=0, atol=16e-6)


def test_poses_of_semantickitti_come_back(first: Path, tmp_path: Path) -> None:
    kitti = write(tmp_path / "kitti.yaml", "semantickitti", FRAMES, RUN["pose"])
    ls.generate(kitti, tmp_path / "set", pictures=0)
    folder = "set/sequences/01"
    pose = {"file": f"{folder}/poses.txt", "times": f"{folder}/times.txt", "axes": "camera"}
    start = {key: RUN["pose"][key] for key in ("position_m", "rotation_deg")}
    again = write(tmp_path / "again.yaml", "semantickitti", FRAMES - 1, pose | start)
    times = np.arange(FRAMES) / 10
    # Poses are products of float64 numbers up to 32, and times have ten digits.
    np.testing.assert_allclose(poses(again, times), poses(first, times), rtol=0, atol=64 * 2.0**-48)
    alone = write(tmp_path / "alone.yaml", "semantickitti", FRAMES - 1, pose)
    np.testing.assert_array_equal(poses(alone, times)[0], np.eye(4))  # relative to the first


def test_poses_of_a_camera_are_turned(tmp_path: Path) -> None:
    """A camera that drives 5 m ahead, its z, and turns to the right, about its y, as KITTI writes it."""
    right = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    rows = np.stack([np.eye(4)[:3], np.column_stack([right, (0, 0, 5)])])
    (tmp_path / "poses.txt").write_text("\n".join(" ".join(f"{value:e}" for value in row.flat) for row in rows))
    (tmp_path / "times.txt").write_text("0.000000e+00\n1.000000e+00\n")
    pose = {"file": "poses.txt", "times": "times.txt", "axes": "camera", "position_m": [0, 0, 1.65]}
    end = poses(write(tmp_path / "recipe.yaml", "shards", 1, pose), np.array([1.0]))[0]
    np.testing.assert_allclose(end[:3, 3], [5, 0, 1.65], rtol=0, atol=2.0**-50)
    np.testing.assert_allclose(end[:3, 0], [0, -1, 0], rtol=0, atol=2.0**-50)  # ahead is now to the right


def test_poses_of_tum_start_when_told(tmp_path: Path) -> None:
    lines = [f"{1305031102.175304 + k / 10:.6f} {k} 0 1 0 0 0 1" for k in range(5)]
    (tmp_path / "groundtruth.txt").write_text("# ground truth\n" + "\n".join(lines))
    recipe = write(tmp_path / "recipe.yaml", "shards", 3, {"file": "groundtruth.txt", "start_s": 0})
    # Unix times have steps of 2⁻²² s, in which this moves by 2.4 µm.
    np.testing.assert_allclose(poses(recipe, np.array([0.25]))[0, :3, 3], [2.5, 0, 1], rtol=0, atol=2.4e-6)
