"""Files of trajectories: what is written is read, files of other programs, and what each mistake is answered with."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim._base import lines
from lidarsim.errors import FileFormatError
from lidarsim.io.trajectories import tum
from lidarsim.motion import formats

EPS = np.finfo(float).eps
LOOKS = (
    "CSV: time_s,x_m,y_m,z_m,qx,qy,qz,qw in the first line; KITTI: the 12 numbers of a 3×4 matrix in each line; "
    "TUM: t x y z qx qy qz qw in each line"
)
HEADER = "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n"
POSE = "1 2 3 0 0 0 1\n"
ROW = "1 0 0 4 0 1 0 5 0 0 1 6\n"


def drive(n: int = 50) -> ls.Trajectory:
    generator = np.random.default_rng(8)
    times = 1.7e9 + np.cumsum(generator.uniform(0.01, 1.0, n))  # of the Unix clock, as logs have them
    rotations = Rotation.from_rotvec(generator.normal(0.0, 2.0, (n, 3)))
    return ls.Trajectory(times, RigidTransform.from_components(generator.normal(5e5, 1e5, (n, 3)), rotations))


@pytest.mark.parametrize("suffix", [".tum", ".txt", ".TUM", ".csv", ".kitti"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    path, written = tmp_path / f"drive{suffix}", drive()
    written.save(path)
    read = ls.Trajectory.load(path, times=written.times if suffix == ".kitti" else None)
    assert np.array_equal(read.times, written.times)
    assert np.array_equal(read.poses.translation, written.poses.translation)
    # A quaternion is rounded on its way there and back, and each entry of a matrix is a sum of a few products of it.
    assert np.abs(read.poses.rotation.as_matrix() - written.poses.rotation.as_matrix()).max() < 16 * EPS


def test_names_do_not_tell_the_format(tmp_path: Path) -> None:
    for suffix in (".tum", ".csv"):
        path = tmp_path / f"drive{suffix}"
        drive().save(path)
        renamed = path.rename(tmp_path / "drive.log")
        assert np.array_equal(ls.Trajectory.load(str(renamed)).times, drive().times)


def test_a_spline_and_a_mount_save_their_poses(tmp_path: Path) -> None:
    sensor = ls.Trajectory(drive().times, drive().poses, interpolation="spline") @ np.diag([-1.0, -1.0, 1.0, 1.0])
    sensor.save(tmp_path / "sensor.tum")
    read = ls.Trajectory.load(tmp_path / "sensor.tum", interpolation="spline")
    assert np.array_equal(read.poses.translation, sensor.poses.translation)
    between = (sensor.times[1:] + sensor.times[:-1]) / 2
    # The spline of the positions read back, which are the same; only rounding is between them. See test_trajectory.py.
    assert np.allclose(read.at(between).translation, sensor.at(between).translation, rtol=64 * EPS)


def test_a_tum_file_of_the_benchmark(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    # As its tools write them: a header of comments, four decimals. The quaternions' lengths are 1 to within 1e-4.
    path.write_text(
        "# ground truth trajectory\r\n# timestamp tx ty tz qx qy qz qw\r\n"
        "1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\r\n\r\n"
        "1305031098.6758\t1.3543 0.6306 1.6360 0.6129 0.5966 -0.3316 -0.3980",
        encoding="utf-8-sig",
    )
    read = ls.Trajectory.load(path)
    assert read.times.tolist() == [1305031098.6659, 1305031098.6758]
    assert read.poses.translation[1].tolist() == [1.3543, 0.6306, 1.6360]
    expected = Rotation.from_quat([0.6132, 0.5962, -0.3311, -0.3986])
    assert (read.poses.rotation[0] * expected.inv()).magnitude() < 4 * EPS


def test_kitti_poses_with_a_file_of_times(tmp_path: Path) -> None:
    # As the odometry benchmark has them: seven digits.
    (tmp_path / "00.txt").write_text(
        "1.000000e+00 9.043680e-12 2.326809e-11 5.551115e-17 9.043683e-12 1.000000e+00 2.392370e-10 3.330669e-16 "
        "2.326810e-11 2.392370e-10 9.999999e-01 -4.440892e-16\n"
        "9.999978e-01 5.272628e-04 -2.066935e-03 -4.690294e-02 -5.296506e-04 9.999992e-01 -1.154865e-03 "
        "-2.839928e-02 2.066324e-03 1.155958e-03 9.999971e-01 8.586941e-01\n"
    )
    (tmp_path / "times.txt").write_text("0.000000e+00\n1.036224e-01\n")
    read = ls.Trajectory.load(tmp_path / "00.txt", times=tmp_path / "times.txt")
    assert read.times.tolist() == [0.0, 0.1036224]
    assert read.poses.translation[1].tolist() == [-0.04690294, -0.02839928, 0.8586941]
    rotation = read.poses.rotation[1].as_matrix()
    assert np.abs(rotation[0] - [9.999978e-01, 5.272628e-04, -2.066935e-03]).max() < 1e-7
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 8 * EPS
    again = ls.Trajectory.load(tmp_path / "00.txt", times=[0.0, 0.1036224])
    assert np.array_equal(read.at(0.05).as_matrix(), again.at(0.05).as_matrix())


@pytest.mark.parametrize("decimals", [2, 3, 6])
def test_rounded_matrices_become_rotations(tmp_path: Path, decimals: int) -> None:
    path, written = tmp_path / "poses.kitti", drive()
    rows = written.poses.as_matrix()[:, :3].reshape(-1, 12)
    np.savetxt(path, rows, fmt=f"%.{decimals}f")
    read = ls.Trajectory.load(path, times=written.times).poses.rotation
    # Nine numbers are each off by half of the last decimal at most, all together by three halves. The nearest rotation
    # is no farther from them than the one that was rounded, and from that one no farther than twice so much.
    bound = 2 * 3 * 0.5 * 10.0**-decimals
    assert np.linalg.norm(read.as_matrix() - written.poses.rotation.as_matrix(), axis=(1, 2)).max() < bound


def test_csv_columns_may_stand_in_any_order_among_others(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("speed, qw,qx,qy,qz,z_m,y_m,x_m,time_s\n9,1,0,0,0,3,2,1,0.5\nfast,0,1,0,0,6,5,4,1.5\n")
    read = ls.Trajectory.load(path)
    assert read.times.tolist() == [0.5, 1.5]
    assert read.poses.translation.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read.poses.rotation[1].as_quat().tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        # no format
        ("", f": expected poses ({LOOKS}), got nothing"),
        ("# nothing\n\n", f":2: expected poses ({LOOKS}), got nothing"),
        ("1 2 3\n", f":1: expected poses ({LOOKS}), got something else"),
        (b"\x89PNG\r\n\x1a\n", f":1: expected poses ({LOOKS}), got something else"),
        # TUM
        (f"0 {POSE}1 2 3\n", ":2: expected 8 numbers, got 3"),
        (f"0 {POSE}1 {POSE}".replace("3 0", "3.5.0 0", 1), ":1: expected finite numbers, got something else"),
        (f"# t\n\n0 {POSE}nan {POSE}", ":4: expected finite numbers, got something else"),
        (f"0 {POSE}1e999 {POSE}", ":2: expected finite numbers, got something else"),
        (f"0 {POSE}1_0 {POSE}", ":2: expected finite numbers, got something else"),
        (f"0 {POSE}1 {POSE}# more\n1 {POSE}", ":4: expected rising times, got 1.0 after 1.0"),
        (f"0 {POSE}1 1 2 3 0 0 0 0\n", ":2: expected a quaternion (x, y, z, w) of length 1, got one of 0"),
        (f"0 {POSE}1 1 2 3 90 0 0 1\n", ":2: expected a quaternion (x, y, z, w) of length 1, got one of 90.0056"),
        # CSV
        (HEADER, ":1: expected poses, got none"),
        ("0,1,2,3,0,0,0,1\n", f":1: expected each of the columns {HEADER.strip()} once, got others"),
        (f"{HEADER}0,1,2,3,0,0,0\n", ":2: expected 8 values, as the first line has names, got 7"),
        (f"{HEADER}0,1,2,3,0,0,,1\n", ":2: expected finite numbers, got something else"),
        (f"{HEADER}0,1,2,3,0,0,0,1\n-1,1,2,3,0,0,0,1\n", ":3: expected rising times, got -1.0 after 0.0"),
        # KITTI
        (f"{ROW}1 2\n", ":2: expected 12 numbers, got 2"),
        (
            f"{ROW}{ROW.replace('1 6', '-1 6')}",
            ":2: expected a rigid transform (orthonormal rotation), got one 0 away from it, determinant -1",
        ),
        (
            ROW.replace("1 6", "2 6"),
            ":1: expected a rigid transform (orthonormal rotation), got one 3 away from it, determinant 2",
        ),
        # more than is read
        ("1" * 70_000, ":1: expected at most 10,000,000 lines of 65,536 bytes, got more"),
    ],
)
def test_bad_files(tmp_path: Path, content: str | bytes, message: str) -> None:
    path = tmp_path / "poses"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(FileFormatError, match=f"^{re.escape(f'{path}{message}')}$"):
        ls.Trajectory.load(path)


@pytest.mark.parametrize("place", ["1e308 0 0", "-1e308 0 0"])
def test_places_beyond_all_numbers(place: str, tmp_path: Path) -> None:
    path = tmp_path / "poses"
    path.write_text(f"0 {POSE}1 {place} 0 0 0 1\n")
    expected = f"{path}: expected times, positions and velocities within the range of float64, got others"
    with pytest.raises(FileFormatError, match=f"^{re.escape(expected)}$"):
        ls.Trajectory.load(path)
    with pytest.raises(ValueError, match=r"^interpolation: expected 'linear' or 'spline', got 'x'"):
        ls.Trajectory.load(path, interpolation="x")  # type: ignore[arg-type]


def test_long_files_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lines, "MOST_LINES", 3)
    path = tmp_path / "poses"
    path.write_text("".join(f"{i} {POSE}" for i in range(3)))
    assert len(ls.Trajectory.load(path).times) == 3
    path.write_text("".join(f"{i} {POSE}" for i in range(4)))
    with pytest.raises(FileFormatError, match=f"^{re.escape(str(path))}:4: expected at most 3 lines"):
        ls.Trajectory.load(path)


@pytest.mark.parametrize(
    ("times", "error", "message"),
    [
        (None, ValueError, "times: expected those of {path}, since KITTI has none of its own, got none"),
        ([0.0], ValueError, "times: expected 2 times, one for each pose of {path}, got 1"),
        ([1.0, 0.0], ValueError, "times: expected rising times, got times[1] = 0.0 after 1.0"),
        ("0\n", ValueError, "{times}: expected 2 times, one for each pose of {path}, got 1"),
        ("0\n\n1 2\n", FileFormatError, "{times}:3: expected 1 number, got 2"),
        ("1\n0\n", FileFormatError, "{times}:2: expected rising times, got 0.0 after 1.0"),
        ("", ValueError, "{times}: expected 2 times, one for each pose of {path}, got 0"),
    ],
)
def test_bad_times(tmp_path: Path, times: object, error: type[Exception], message: str) -> None:
    path, stamps = tmp_path / "poses", tmp_path / "times"
    path.write_text(ROW * 2)
    if isinstance(times, str):
        stamps.write_text(times)
        times = stamps
    with pytest.raises(error, match=f"^{re.escape(message.format(path=path, times=stamps))}$"):
        ls.Trajectory.load(path, times=times)


def test_times_beside_times(tmp_path: Path) -> None:
    path = tmp_path / "poses"
    path.write_text(f"0 {POSE}")
    message = f"times: expected none for {path}, which is TUM and has its own, got some"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Trajectory.load(path, times=[0.0])


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "gone", "No such file or directory"), (tmp_path, "Is a directory")):
        with pytest.raises(FileFormatError, match=f"^{re.escape(str(path))}: cannot read the file: {reason}$"):
            ls.Trajectory.load(path)
    path = tmp_path / "drive.bin"
    message = f"{path}: unknown extension '.bin', expected .csv, .kitti, .tum or .txt"
    with pytest.raises(FileFormatError, match=f"^{re.escape(message)}$"):
        drive().save(path)
    with pytest.raises(OSError, match=f"^{re.escape(str(tmp_path / 'gone' / 'a.tum'))}: the folder "):
        drive().save(tmp_path / "gone" / "a.tum")
    message = "trajectory: expected one of given poses, got a constant twist; sample it before it is saved"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ls.Trajectory.from_twist(np.eye(4), (1, 0, 0)).save(tmp_path / "twist.tum")
    assert list(tmp_path.iterdir()) == []


def nuscenes(folder: Path, **changes: Any) -> Path:
    """Tables of two scenes, one of which has two sensors, in the style of nuScenes; a table may be other text."""
    turn = {"a0": (1.0, 0.0), "a1": (0.8, 0.6), "a2": (0.0, 1.0), "b0": (1.0, 0.0)}
    tables: dict[str, Any] = {
        "scene": [{"token": "A", "name": "scene-0061"}, {"token": "B", "name": "scene-0103"}],
        "sample": [{"token": "s0", "scene_token": "A"}, {"token": "s1", "scene_token": "A"},
                   {"token": "t0", "scene_token": "B"}],
        "sample_data": [{"sample_token": s, "ego_pose_token": p} for s, p in
                        (("s1", "a2"), ("t0", "b0"), ("s0", "a0"), ("s0", "a1"), ("s1", "again"))],
        "ego_pose": [
            {"token": token, "timestamp": 1_532_402_927_000_000 + 50_000 * int(token[1]),
             "translation": [411.3, 1180.9 + int(token[1]), 0.0], "rotation": [w, 0.0, 0.0, z]}
            for token, (w, z) in turn.items()
        ],
    }  # fmt: skip
    tables["ego_pose"].append({**tables["ego_pose"][2], "token": "again"})
    for name, rows in (tables | changes).items():
        if rows is not None:
            (folder / f"{name}.json").write_text(rows if isinstance(rows, str) else json.dumps(rows, indent=0))
    return folder / "ego_pose.json"


def test_poses_of_a_scene_of_nuscenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = nuscenes(tmp_path)
    for chunk in (1 << 20, 150):  # rows that lie in two chunks
        monkeypatch.setattr("lidarsim.io.trajectories.nuscenes.CHUNK", chunk)
        read = ls.Trajectory.load(path, scene="scene-0061", start=3.0)
        assert read.times.tolist() == [3.0, 3.05, 3.1]
        assert read.poses.translation.tolist() == [[411.3, 1180.9, 0], [411.3, 1181.9, 0], [411.3, 1182.9, 0]]
        ahead = read.poses.rotation.apply([1, 0, 0])  # (w, z) turns by 2 atan2(z, w)
        np.testing.assert_allclose(ahead, [[1, 0, 0], [0.28, 0.96, 0], [-1, 0, 0]], rtol=0, atol=4 * EPS)
    assert ls.Trajectory.load(path, scene="scene-0103").times.tolist() == [0.0]
    nuscenes(tmp_path, scene=[{"token": "A", "name": "the only one"}])
    assert len(ls.Trajectory.load(path).times) == 3


DEEP = "[" * 100_000
BAD_TABLES: list[tuple[dict[str, Any], str, str]] = [
    ({"scene": None}, "scene-0061", r"scene\.json: cannot read the file: No such file"),
    ({}, "scene-9999", r"scene\.json: expected the name of a scene, of 'scene-0061', 'scene-0103', got 'scene-9999'"),
    ({"scene": []}, "scene-0061", r"scene\.json: expected the name of a scene, of none, got 'scene-0061'"),
    ({"sample": []}, "scene-0061", r"sample_data\.json: expected data of the scene 'scene-0061', got none"),
    ({"ego_pose": []}, "scene-0061", r"ego_pose\.json: .* got none of token 'a0' and 3 more"),
    ({"scene": DEEP}, "scene-0061", r"scene\.json: row 1: expected an object in JSON, got something else"),
    ({"scene": f'[{{"a": {DEEP}'}, "scene-0061", r"scene\.json: row 1: expected .*"),
    ({"sample": '[{"token": 3}]'}, "scene-0061", r"sample\.json: row 1: token: expected a string, got something else"),
    ({"sample": "{}"}, "scene-0061", r"sample\.json: row 1: expected \[ in JSON, got '{'"),
    ({"sample": "[{}"}, "scene-0061", r"sample\.json: row 1: token: expected a string, got none"),
    ({"sample": '[{"token": "s0", "scene_token": "A"}'}, "scene-0061", r"row 1: expected , or \] in JSON, got the end"),
    ({"sample": '[{"token": "' + "x" * (3 << 20) + '"}]'}, "scene-0061", r"object in JSON of at most 1,048,576 char"),
    ({"ego_pose": '[{"timestamp": ' + "9" * 5000 + "}]"}, "scene-0061", r"ego_pose\.json: row 1: "),
    (
        {"ego_pose": [{"token": "a0", "timestamp": 10**30, "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]}]},
        "scene-0061", r"row 1: expected a timestamp of 64 bits, got 1000000",
    ),
    (
        {"ego_pose": [{"token": "a0", "timestamp": 1, "translation": [0, 0], "rotation": [1, 0, 0, 0]}]},
        "scene-0061", r"ego_pose\.json: row 'a0': translation: expected 3 finite numbers, got others",
    ),
    (
        {"ego_pose": [{"token": "b0", "timestamp": 1, "translation": [0, 0, 0], "rotation": [2, 0, 0, 0]}]},
        "scene-0103", r"ego_pose\.json: expected a quaternion \(x, y, z, w\) of length 1, got one of 2",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "scene", "message"), BAD_TABLES)
def test_bad_tables_of_nuscenes(tmp_path: Path, changes: dict[str, Any], scene: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        ls.Trajectory.load(nuscenes(tmp_path, **changes), scene=scene)


def test_a_scene_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="expected the name of a scene, of 'scene-0061', 'scene-0103', got none"):
        ls.Trajectory.load(nuscenes(tmp_path))
    with pytest.raises(ValueError, match=r"times: expected none for .*, which is nuScenes and has its own"):
        ls.Trajectory.load(nuscenes(tmp_path), scene="scene-0061", times=[1.0])
    drive().save(tmp_path / "drive.tum")
    with pytest.raises(ValueError, match=r"scene: expected none for .*drive\.tum, which is TUM, got 'scene-0061'"):
        ls.Trajectory.load(tmp_path / "drive.tum", scene="scene-0061")
    with pytest.raises(TypeError, match="scene: expected the name of a scene, got 61"):
        ls.Trajectory.load(tmp_path / "drive.tum", scene=61)  # type: ignore[arg-type]


def test_times_are_shifted_to_a_start(tmp_path: Path) -> None:
    drive().save(tmp_path / "drive.tum")
    read = ls.Trajectory.load(tmp_path / "drive.tum", start=-2.0)
    assert np.array_equal(read.times, drive().times - drive().times[0] - 2.0)
    with pytest.raises(ValueError, match="start: expected a finite number, got nan"):
        ls.Trajectory.load(tmp_path / "drive.tum", start=float("nan"))


def test_quoted_names_and_numbers(tmp_path: Path) -> None:
    path = tmp_path / "quoted.csv"
    names = ",".join(f'"{name}"' for name in ("", *HEADER.strip().split(",")))
    path.write_text(f'{names}\n"row 1",0,1,2,3,0,0,0,1\n"row 2","1","4", "5","6","0","0","0","1"\n')
    drive = ls.Trajectory.load(path)
    assert drive.times.tolist() == [0, 1]
    assert drive.poses.as_matrix()[:, :3, 3].tolist() == [[1, 2, 3], [4, 5, 6]]
    table = tmp_path / "pulses.csv"
    table.write_text('"x","y","z","time_s"\n1,0,0,0\n"0","1","0","0.01"\n')
    assert ls.patterns.Table.from_file(table, rate=10.0).directions.tolist() == [[1, 0, 0], [0, 1, 0]]


def test_a_format_of_ones_own_may_return_lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formats, "_FORMATS", formats._FORMATS.copy())
    ls.register_trajectory_format(
        "mine",
        "a line",
        lambda line: line == "mine",
        lambda lines: ([float(len(line)) for line in lines], [np.eye(4).tolist()] * 2),
        suffixes=(".mine",),
        write=tum.write,
    )
    path = tmp_path / "drive.mine"
    path.write_text("mine\nof it\n")
    assert ls.Trajectory.load(path).times.tolist() == [4.0, 5.0]
    path.write_text("mine\nown\n")
    with pytest.raises(FileFormatError, match=r"drive\.mine:2: expected rising times, got 3\.0 after 4\.0"):
        ls.Trajectory.load(path)
