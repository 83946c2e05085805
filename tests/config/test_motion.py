"""Objects that move, in YAML: the same bits as of the same in Python, and what each mistake is answered with."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.errors import ConfigError

GUIDE = (Path(__file__).parents[2] / "configs" / "README.md").read_text(encoding="utf-8")

SENSOR = """\
seed: 9
frames: 3
first_frame: 1
sensor:
  pattern: {type: spinning, elevations_deg: [-12, -8, -4, 0, 4], columns: 256, firing_times_us: 55.296}
  measurement: {range_sigma_m: 0.01}
pose: {position_m: [0, 0, 1.5], linear_m_per_s: [2, 0, 0]}
scene:
  - {shape: plane, normal: [0, 0, 1], label: 40}
"""

SIZE = "shape: box, name: van, label: 10, size_m: [4, 2, 2]"

TUM = "".join(
    f"{t} {8 - 3 * t} {t * t} 1 0 0 {math.sin(0.2 * t)!r} {math.cos(0.2 * t)!r}\n" for t in (0, 0.15, 0.3, 0.5)
)

Pose = npt.NDArray[np.float64]


def place(position: Any, yaw: float = 0.0, scale: Any = 1.0) -> Pose:
    """Return R diag(scale) and the position, as configs/README.md says of a placement."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, 0, 0], degrees=True).as_matrix() * scale
    pose[:3, 3] = position
    return pose


def waypoints() -> ls.Trajectory:
    return ls.Trajectory([0.0, 0.25, 0.5], [place((0, -2, 0)), place((1, 0, 0), 10.0), place((1, 3, 0), 40.0)])


def save_and_load(name: str, **options: Any) -> ls.Trajectory:
    """Write poses in the format that the suffix says, with their times beside them, and load them."""
    Path("drive.tum").write_text(TUM, encoding="ascii")
    drive = ls.Trajectory.load("drive.tum")
    drive.save(name)
    Path("times.txt").write_text("".join(f"{t!r}\n" for t in drive.times.tolist()), encoding="ascii")
    return ls.Trajectory.load(name, **options)


MOTIONS: dict[str, tuple[str, Callable[[], dict[str, Any]]]] = {
    "velocity": (
        "position_m: [8, 1, 1], rotation_deg: {yaw: 30}, motion: {linear_m_per_s: [9, 0, 0]}",
        lambda: {"motion": ls.Trajectory.from_twist(place((8, 1, 1), 30.0), (9, 0, 0))},
    ),
    "twist of what is scaled": (
        (
            "position_m: [8, 1, 1], scale: [1, 1.5, 0.5], "
            "motion: {linear_m_per_s: [3, -1, 0], angular_deg_per_s: [0, 0, -90]}"
        ),
        lambda: {
            "transform": np.diag([1, 1.5, 0.5, 1]),
            "motion": ls.Trajectory.from_twist(place((8, 1, 1)), (3, -1, 0), np.radians([0, 0, -90])),
        },
    ),
    "twist from a matrix": (
        "matrix: [[0, -1, 0, 7], [1, 0, 0, 1], [0, 0, 1, 1], [0, 0, 0, 1]], motion: {angular_deg_per_s: [0, 0, 200]}",
        lambda: {
            "motion": ls.Trajectory.from_twist(
                [[0, -1, 0, 7], [1, 0, 0, 1], [0, 0, 1, 1], [0, 0, 0, 1]], angular=np.radians([0, 0, 200])
            )
        },
    ),
    "waypoints": (
        (
            "position_m: [8, 0, 1], rotation_deg: {yaw: 20}, scale: 1.25, "
            "motion: [{time_s: 0, position_m: [0, -2, 0]}, "
            "{time_s: 0.25, position_m: [1, 0, 0], rotation_deg: {yaw: 10}}, "
            "{time_s: 0.5, position_m: [1, 3, 0], rotation_deg: {yaw: 40}}]"
        ),
        lambda: {"transform": place((8, 0, 1), 20.0, 1.25), "motion": waypoints()},
    ),
    "file": ("motion: {file: drive.tum}", lambda: {"motion": save_and_load("drive.tum")}),
    "file, spline": (
        "motion: {file: drive.csv, interpolation: spline}",
        lambda: {"motion": save_and_load("drive.csv", interpolation="spline")},
    ),
    "file in another world": (
        "position_m: [1, 0, 0], motion: {file: drive.tum, position_m: [0, -1, 0], rotation_deg: {yaw: 5}}",
        lambda: {"transform": place((1, 0, 0)), "motion": place((0, -1, 0), 5.0) @ save_and_load("drive.tum")},
    ),
    "file without times": (
        "position_m: [1, 0, 0], motion: {file: drive.kitti, times: times.txt}",
        lambda: {"transform": place((1, 0, 0)), "motion": save_and_load("drive.kitti", times="times.txt")},
    ),
}


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(item: str) -> None:
    Path("run.yaml").write_text(f"{SENSOR}  - {{{SIZE}, {item}}}\n", encoding="utf-8")


def command(*arguments: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    return int(left.value.code or 0)


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_motion_in_yaml_is_the_same_in_python(kind: str) -> None:
    text, arguments = MOTIONS[kind]
    item = arguments()
    write(text)
    scene = ls.Scene()
    scene.add(ls.Plane((0, 0, 1), 0.0), label=40)
    still = copy.copy(scene)
    scene.add(ls.Box((4, 2, 2)), name="van", label=10, **item)
    # The same where it stands in the middle of the frames: else a motion that is left out would not show.
    still.add(ls.Box((4, 2, 2)), transform=item["motion"].at(0.25).as_matrix() @ item.get("transform", np.eye(4)))
    run = ls.config.load("run.yaml")
    assert (run.scene[1].name, run.scene[1].label) == ("van", 10)
    pose = ls.Trajectory.from_twist(place((0, 0, 1.5)), (2, 0, 0))
    expected = list(run.lidar.frames(scene, pose, 3, first=1, seed=9))
    assert command("scan", "run.yaml", "-o", "a.npz") == 0
    for k, (scan, of_run, of_scene, other) in enumerate(
        zip(
            expected,
            (scans[""] for scans in run.scans()),
            run.lidar.frames(ls.Scene.from_file("run.yaml"), pose, 3, first=1, seed=9),
            run.lidar.frames(still, pose, 3, first=1, seed=9),
            strict=True,
        ),
        start=1,
    ):
        cloud, written = scan.point_cloud(), ls.PointCloud.load(f"a_{k:04}.npz")
        assert np.count_nonzero(cloud.object_id == 1) > 20
        assert scan.range.tobytes() != other.range.tobytes()
        assert "radial_velocity" in cloud.fields
        for name in cloud.fields:
            bits = getattr(cloud, name).tobytes()
            for same in (of_run.point_cloud(), of_scene.point_cloud(), written):
                assert getattr(same, name).tobytes() == bits, name


def test_the_placement_beside_a_file_of_poses_is_that_of_its_world() -> None:
    drive = save_and_load("drive.tum")
    write("")
    run = ls.config.load("run.yaml", ["pose={file: drive.tum, position_m: [3, 2, 1], rotation_deg: {yaw: 30}}"])
    expected = (place((3, 2, 1), 30.0) @ drive).at(drive.times).as_matrix()
    assert np.array_equal(run.pose.at(drive.times).as_matrix(), expected)
    assert "The placement beside a file places the world of the file" in " ".join(GUIDE.split())


def test_velocities_of_nothing_leave_an_object_where_it_is() -> None:
    write("position_m: [8, 1, 1], scale: 2, motion: {linear_m_per_s: [0, 0, 0]}")
    item = ls.config.load("run.yaml").scene[1]
    assert item.motion is None
    assert np.array_equal(item.transform, place((8, 1, 1), scale=2.0))


MISTAKES = {
    "motion: 5": "scene.1.motion: expected a mapping with keys linear_m_per_s, angular_deg_per_s, got 5",
    "motion: {velocity: 5}": (
        "scene.1.motion.velocity: unknown key; expected one of linear_m_per_s, angular_deg_per_s"
    ),
    "motion: {linear_m_per_s: 5}": "scene.1.motion.linear_m_per_s: expected a list, got 5",
    "motion: {linear_m_per_s: [.nan, 0, 0]}": "scene.1.motion.linear_m_per_s.0: expected a finite number, got nan",
    "motion: {angular_deg_per_s: [0, .inf, 0]}": (
        "scene.1.motion.angular_deg_per_s.1: expected a finite number, got inf"
    ),
    "matrix: [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], motion: {linear_m_per_s: [1, 0, 0]}": (
        "scene.1.matrix: expected a rigid transform (orthonormal rotation), got one 3 away from it, determinant 2"
    ),
    "scale: 2, matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], motion: {linear_m_per_s: [1, 0, 0]}": (
        "scene.1.matrix: expected the matrix alone, got scale beside it"
    ),
    "motion: []": "scene.1.motion: times: expected at least one, got none",
    "motion: [{position_m: [0, 0, 0]}]": "scene.1.motion.0: missing key 'time_s'",
    "motion: [{time_s: 1}, {time_s: 1}]": (
        "scene.1.motion: times: expected rising times, got times[1] = 1.0 after 1.0"
    ),
    "motion: [{time_s: 0}, {time_s: .nan}]": (
        "scene.1.motion: times: expected finite numbers, got times[1] = nan"
    ),
    "motion: [{time_s: 0, scale: 2}]": (
        "scene.1.motion.0.scale: unknown key; expected one of position_m, rotation_deg, matrix, time_s"
    ),
    "motion: {file: gone.tum}": "scene.1.motion.file: cannot read gone.tum: No such file or directory",
    "motion: {file: bad.tum}": "scene.1.motion: bad.tum:2: expected 8 numbers, got 2",
    "motion: {file: drive.tum, interpolation: cubic}": (
        "scene.1.motion.interpolation: expected 'linear' or 'spline', got 'cubic'"
    ),
    "motion: {file: drive.tum, times: drive.tum}": (
        "scene.1.motion: times: expected none for drive.tum, which is TUM and has its own, got some"
    ),
    "motion: {file: drive.tum, scene: scene-0001}": (
        "scene.1.motion.scene: expected none for drive.tum, which is TUM, got 'scene-0001'"
    ),
    "motion: {file: drive.tum, start_s: .inf}": "scene.1.motion.start_s: expected a finite number, got inf",
    "motion: {file: drive.tum, position_m: [1.0e+300, 0, 0]}": (
        "scene.1.motion.position_m: expected numbers up to 1.02e+295 of what moves, got 1e+300"
    ),
    "motion: {file: drive.tum, linear_m_per_s: [1, 0, 0]}": (
        "scene.1.motion.linear_m_per_s: unknown key; expected one of position_m, rotation_deg, matrix, file,"
        " times, scene, start_s, interpolation, axes"
    ),
}  # fmt: skip


@pytest.mark.parametrize("item", MISTAKES)
def test_bad_motions(item: str) -> None:
    Path("drive.tum").write_text(TUM, encoding="ascii")
    Path("bad.tum").write_text("0 0 0 0 0 0 0 1\n1 2\n", encoding="ascii")
    write(item)
    with pytest.raises(ConfigError) as caught:
        ls.config.load("run.yaml")
    assert str(caught.value) == f"run.yaml:10: {MISTAKES[item]}"


MOVERS = """\
frames: 2
rig:
  roof: {sensor: {preset: velodyne-vlp16}}
  slow: {sensor: {pattern: {type: grid, azimuths_deg: [0], elevations_deg: [0], rate_hz: 4}}, offset_s: 0.01}
pose: [{time_s: 0, position_m: [0, 0, 2]}, {time_s: 2, position_m: [9, 0, 2]}]
scene:
  - {shape: plane, normal: [0, 0, 1]}
  - {shape: box, size_m: [4, 2, 2], name: van, position_m: [9, 3, 1], motion: {linear_m_per_s: [5, 0, 0]}}
  - {shape: box, size_m: [4, 2, 2], motion: [{time_s: -1.5}, {time_s: 0.3, position_m: [6, 0, 0]}]}
  - {shape: sphere, center_m: [9, -3, 1], radius_m: 1, name: ball, motion: [{time_s: -0.5}, {time_s: 4}]}
"""


def test_check_says_over_which_time_all_is_defined(capsys: pytest.CaptureFixture[str]) -> None:
    Path("run.yaml").write_text(MOVERS, encoding="utf-8")
    assert command("check", "run.yaml") == 0
    lines = capsys.readouterr().out.splitlines()
    moves = {words[0]: " ".join(words[1:]) for words in map(str.split, lines) if words[:1] and words[0].isdecimal()}
    assert moves == {
        "0": "Plane 0 1",
        "1": "Box van 0 1 always",
        "2": "Box 0 1 -1.5 … 0.3 s",
        "3": "Sphere ball 0 1 -0.5 … 4 s",
    }
    # Frames 0 and 1 of the roof, until 0.2 s, and frame 0 of the slow one, from 0.01 to 0.26 s.
    assert lines[-2:] == [
        "defined: pose 0 … 2 s, objects -0.5 … 0.3 s, all 0 … 0.3 s, frames 0 … 0.26 s",
        "run.yaml: ok, 4 objects, 2 frames, seed 0",
    ]
    # Frame 1 of the slow one, from 0.25 s on, begins in frame 2 of the rig.
    still = ("--set", "pose={position_m: [0, 0, 2]}", "--set", "scene.2.motion={linear_m_per_s: [1, 0, 0]}")
    assert command("check", "run.yaml", *still, "--set", "first_frame=1") == 0
    assert "\ndefined: objects -0.5 … 4 s, frames 0.1 … 0.51 s\n" in capsys.readouterr().out


@pytest.mark.parametrize("verb", [("check", "run.yaml"), ("scan", "run.yaml", "-o", "a.npz")], ids=["check", "scan"])
def test_motions_that_do_not_cover_the_frames_are_refused(
    verb: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("run.yaml").write_text(MOVERS, encoding="utf-8")
    fired = 3 / 10.0 + ls.Lidar.preset("velodyne-vlp16").pattern.pulses(3).time
    refused = {
        "frames=4": f"object 2, -1.5 to 0.3 s, got {fired.min()} to {fired.max()} s",
        "scene.3.motion.0.time_s=0.1": "object 3 ('ball'), 0.1 to 4.0 s, got 0.0 to ",
    }
    for change, message in refused.items():
        assert command(*verb, "--set", change) == 2
        out, error = capsys.readouterr()
        assert error.startswith(f"lidarsim: time: expected times within the motion of {message}")
        assert error.count("\n") == 1
        assert not out
    assert [path.name for path in Path().iterdir()] == ["run.yaml"]
