"""Command line: files, output, exit codes and one-line errors."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from rich.cells import cell_len

import lidarsim as ls
from lidarsim._base.shown import plain
from lidarsim.cli import main
from lidarsim.run._output import OUTPUTS
from lidarsim.scan.columns import PointColumns
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.formats import FORMATS as CLOUDS
from tests.io.packets.captures import datagrams

ROOT = Path(__file__).parents[1]
LONG = "x" * 300
ALWAYS = [name for name in CANONICAL if not PointColumns._columns[name].condition and name != "xyz"]
NUMBERS = ", ".join(name for name in ALWAYS if not PointColumns._columns[name].shape)
"""Fields of every cloud with a number per point."""
FORMATS = " or ".join(
    ", ".join(sorted({*CLOUDS, *(name for kind in OUTPUTS for name in kind.suffixes)})).rsplit(", ", 1)
)
CONFIG = """\
seed: 3
sensor: {preset: velodyne-vlp16, noise: datasheet}
pose: {position_m: [0, 0, 2]}
scene:
  - {shape: plane, normal: [0, 0, 1], label: 40}
  - {shape: sphere, center_m: [5, 0, 2], radius_m: 1, label: 7}
"""
SMALL = ("--size", "320x200")
TAKEN = "expected a file of its own, got that of {}, which the run reads"
MOVING = """\
frames: 2
sensor: {preset: velodyne-vlp16}
pose:
  - {time_s: 0, position_m: [0, 0, 2]}
  - {time_s: 0.2, position_m: [2, 0, 2]}
scene:
  - {shape: plane, normal: [0, 0, 1]}
"""


@pytest.fixture(autouse=True)
def _in_a_folder_with_a_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.yaml").write_text(CONFIG, encoding="utf-8")


def lidarsim(*arguments: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    return int(left.value.code or 0)


def test_scan_writes_what_python_scans(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("scan", "run.yaml", "-o", "scan.npz") == 0
    run = ls.config.load("run.yaml")
    expected = run.scan().point_cloud()
    cloud = ls.PointCloud.load("scan.npz")
    assert len(cloud) > 10_000
    assert cloud.fields == expected.fields
    assert all(np.array_equal(getattr(cloud, field), getattr(expected, field)) for field in cloud.fields)
    printed = capsys.readouterr()
    assert f"{len(cloud):,} points in " in printed.out
    assert printed.out.endswith(" s: scan.npz\n")
    assert printed.err == ""  # no progress bar in a pipe


def test_a_sensor_inside_of_an_object_is_noted_once(capsys: pytest.CaptureFixture[str]) -> None:
    pod = "{shape: sphere, center_m: [0, 0, 2], radius_m: 0.1, name: pod}"
    Path("pod.yaml").write_text(CONFIG.replace("scene:\n", f"scene:\n  - {pod}\n"), encoding="utf-8")
    note = "all hits are on object 0, nearer than min_range: is the sensor inside its own body? ignore=[1] hides it\n"
    assert lidarsim("scan", "pod.yaml", "-o", "scan.npz", "--frames", "2") == 0
    assert capsys.readouterr().out.count(note) == 1
    assert lidarsim("scan", "run.yaml", "-o", "scan.npz") == 0
    assert "inside" not in capsys.readouterr().out


@pytest.mark.parametrize("suffix", ["pcd", "ply", "npz"])
def test_every_format(suffix: str) -> None:
    assert lidarsim("scan", "run.yaml", "--output", f"scan.{suffix}") == 0
    assert set(ls.PointCloud.load(f"scan.{suffix}").label) == {7, 40}


def test_several_frames_are_numbered() -> None:
    assert lidarsim("scan", "run.yaml", "-o", "scan.npz", "--frames", "2", "--frame", "9") == 0
    assert sorted(path.name for path in Path().glob("*.npz")) == ["scan_0009.npz", "scan_0010.npz"]
    first, second = (ls.PointCloud.load(f"scan_{number:04}.npz") for number in (9, 10))
    expected = ls.config.load("run.yaml").scan(10).point_cloud()
    assert np.array_equal(second.range, expected.range)
    assert not np.array_equal(first.range_error[:100], second.range_error[:100])


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_a_bag_holds_all_frames(suffix: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(f"drive{suffix}")
    assert lidarsim("scan", "run.yaml", "-o", str(path), "--frames", "3", "--frame", "5") == 0
    names = [path.name, "drive_poses.tum", "drive_times.txt", "run.yaml"]
    assert sorted(file.name for file in Path().iterdir()) == sorted(names)
    assert capsys.readouterr().out.endswith(f" s: {path}\n")
    run = ls.config.load("run.yaml", ["first_frame=5", "frames=3"])
    messages = list(ls.io.rosbag.read(path))
    assert [message.stamp - messages[0].stamp for message in messages] == [0, 100_000_000, 200_000_000]
    for times in (
        ls.Trajectory.load("drive_poses.tum").times,
        np.loadtxt("drive_times.txt"),
    ):  # Unix times, as in the bag
        assert np.abs(times - [message.stamp * 1e-9 for message in messages]).max() < 1e-6
    for message, frame in zip(messages, run.frames, strict=True):
        cloud = run.scan(frame).point_cloud()
        assert message.frame_id == "lidar"
        np.testing.assert_array_equal(message.cloud.xyz, cloud.xyz.astype(np.float32))
        np.testing.assert_array_equal(message.cloud.ring, cloud.ring)
    assert lidarsim("scan", "run.yaml", "-o", str(path), "--frame", "7", "--set", "cloud.frame=world") == 0
    np.testing.assert_array_equal(ls.PointCloud.load(path).xyz, messages[2].cloud.xyz)


DRIVE = "pose={position_m: [0, 0, 2], linear_m_per_s: [8, 0, 0], angular_deg_per_s: [0, 0, 20]}"


def viewpoint(path: str) -> list[float]:
    (line,) = (line for line in Path(path).read_bytes()[:2000].splitlines() if line.startswith(b"VIEWPOINT"))
    return list(map(float, line.split()[1:]))


@pytest.mark.parametrize("pose", [DRIVE, "pose.position_m=[0, 0, 2]"], ids=["moving", "still"])
def test_several_frames_come_with_their_poses_and_times(pose: str) -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.pcd", "--frames", "3", "--frame", "2", "--set", pose) == 0
    names = [f"a_{k:04}.pcd" for k in (2, 3, 4)]
    assert sorted(path.name for path in Path().iterdir()) == [*names, "a_poses.tum", "a_times.txt", "run.yaml"]
    times = [0.2, 3 / 10.0, 0.4]
    assert [float(line) for line in Path("a_times.txt").read_text(encoding="ascii").splitlines()] == times
    poses, run = ls.Trajectory.load("a_poses.tum"), ls.config.load("run.yaml", [pose])
    assert poses.times.tolist() == times
    still = isinstance(run.pose, np.ndarray)
    for name, time_, found in zip(names, times, poses.poses, strict=True):
        expected = run.pose if still else run.pose.at(time_).as_matrix()
        near = 8 * 2.0**-53  # of a quaternion and its matrix
        assert np.abs(found.as_matrix() - expected).max() <= near
        x, y, z, qw, qx, qy, qz = viewpoint(name)
        assert [x, y, z] == expected[:3, 3].tolist()
        assert np.abs(found.rotation.as_quat(canonical=True) - [qx, qy, qz, qw]).max() <= near
    assert still or poses.at(0.4).rotation.magnitude() == pytest.approx(np.radians(8))


@pytest.mark.parametrize(
    ("deskew", "moment"), [("deskew=start", 0.0), ("deskew=middle", 0.05), ("deskew=end", 0.1), ("deskew_s=0.03", 0.03)]
)
def test_the_poses_are_those_of_the_moment_that_points_are_deskewed_to(deskew: str, moment: float) -> None:
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    assert lidarsim("scan", "moving.yaml", "-o", "a.pcd", "--set", f"cloud.{deskew}") == 0
    assert lidarsim("scan", "moving.yaml", "-o", "b.npz", "--set", "cloud.frame=world") == 0
    tum = np.loadtxt("a_poses.tum")
    assert np.array_equal(tum[:, 0], [0.0 + moment, 0.1 + moment])
    assert np.abs(tum[:, 1] - 10 * tum[:, 0]).max() <= 2 * np.spacing(2.0)
    assert np.loadtxt("a_times.txt").tolist() == [0.0, 0.1]
    assert np.loadtxt("b_poses.tum")[:, 0].tolist() == [0.0, 0.1]
    for k, pose in enumerate(tum):
        cloud, world = ls.PointCloud.load(f"a_{k:04}.pcd"), ls.PointCloud.load(f"b_{k:04}.npz")
        assert viewpoint(f"a_{k:04}.pcd")[:3] == pose[1:4].tolist()
        assert len(cloud) > 5000
        # Straight ahead: no rotation. Float32 in the file rounds numbers below 128 by at most 2**-18, float64 three
        # times by 2**-47.
        assert np.abs(world.xyz).max() < 127
        assert np.abs(cloud.xyz + pose[1:4] - world.xyz).max() < 2.0**-18 + 3 * 2.0**-47


def test_one_point_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    sensor = "{pattern: {type: grid, azimuths_deg: [0], elevations_deg: [-90], rate_hz: 10}}"
    Path("one.yaml").write_text(
        f"sensor: {sensor}\nscene: [{{shape: plane, normal: [0, 0, 1], distance_m: -2}}]\n", encoding="utf-8"
    )
    assert lidarsim("scan", "one.yaml", "-o", "one.pcd") == 0
    assert re.search(r"^1 pulse: 1 hit\n1 point in .* s: one.pcd$", capsys.readouterr().out, re.MULTILINE)
    assert lidarsim("compare", "one.pcd", "one.pcd") == 0
    assert "1 frame, 1 point, 1 ring\n" in capsys.readouterr().out


def test_a_single_frame_has_its_pose_in_the_pcd_file_alone() -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.pcd", "--set", DRIVE, "--frame", "1") == 0
    assert sorted(path.name for path in Path().iterdir()) == ["a.pcd", "run.yaml"]
    assert viewpoint("a.pcd")[0] == ls.config.load("run.yaml", [DRIVE]).pose.at(0.1).translation[0] > 0.7
    assert lidarsim("scan", "run.yaml", "-o", "b.pcd", "--set", DRIVE, "--set", "cloud.frame=world") == 0
    assert viewpoint("b.pcd") == [0, 0, 0, 1, 0, 0, 0]  # these points are in the world


RIG = """\
rig:
  top: {sensor: {preset: velodyne-vlp16, noise: datasheet}, position_m: [1, 0, 2]}
  left: {sensor: {preset: velodyne-vlp16, noise: datasheet}, position_m: [0, 1, 1], offset_s: 0.05}
pose: {file: drive.csv}
frames: 2
scene: [{shape: plane, normal: [0, 0, 1], label: 40}, {shape: sphere, center_m: [9, 0, 2], radius_m: 1, label: 7}]
"""


def rig() -> Path:
    poses = np.array([np.eye(4)] * 2)
    poses[1, 0, 3] = 5.0
    ls.Trajectory([0.0, 1.0], poses).save("drive.csv")
    path = Path("rig.yaml")
    path.write_text(RIG, encoding="utf-8")
    return path


def test_a_rig_writes_each_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    run = ls.config.load(rig())
    assert lidarsim("scan", "rig.yaml", "-o", "a.pcd") == 0
    written = {path.name for path in Path().glob("a_*")}
    assert written == {
        f"a_{name}_{rest}" for name in run.sensor for rest in ("0000.pcd", "0001.pcd", "poses.tum", "times.txt")
    }
    assert capsys.readouterr().out.endswith(" s: a_*_*.pcd\n")
    for k, scans in enumerate(run.scans()):
        for name, scan in scans.items():
            cloud = ls.PointCloud.load(f"a_{name}_{k:04}.pcd")
            assert len(cloud) > 5000
            assert np.array_equal(cloud.range, scan.point_cloud().range)
            assert viewpoint(f"a_{name}_{k:04}.pcd")[:3] == scan.pose.at(scan.time).translation.tolist()
            assert Path(f"a_{name}_times.txt").read_text().splitlines()[k] == repr(scan.time)
    left = ls.Trajectory.load("a_left_poses.tum")
    assert np.abs(left.poses.translation - [[0.25, 1, 1], [0.75, 1, 1]]).max() <= 4 * 2.0**-53
    assert lidarsim("scan", "rig.yaml", "-o", "b.npz", "--frames", "1") == 0
    assert {path.name for path in Path().glob("b*")} == {"b_top.npz", "b_left.npz"}


def test_a_rig_is_checked_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    rig()
    assert lidarsim("check", "rig.yaml") == 0
    printed = capsys.readouterr().out
    assert [line.split()[1] for line in printed.splitlines() if line.startswith(" sensor ")] == ["top", "left"]
    assert printed.endswith("defined: pose 0 … 1 s, frames 0 … 0.25 s\nrig.yaml: ok, 2 objects, 2 frames, seed 0\n")
    assert lidarsim("view", "rig.yaml", "--screenshot", "rig.png", *SMALL) == 0
    assert film("rig.png") == ((320, 200), 1)


OTHERS = """\
  imu:
    position_m: [0.1, 0, 0.5]
    imu:
      rate_hz: 200
      latitude_deg: 48
      gyroscope: {noise_density_deg_per_s_per_sqrt_hz: 0.005, bias_instability_deg_per_h: 2, range_deg_per_s: 450}
  gnss: {gnss: {rate_hz: 5, position_sigma_m: [0.5, 0.5, 1], drift_sigma_m: 2}}
"""
MOVING_ON_EARTH = """\
georeference: {origin: {latitude_deg: 48.1, longitude_deg: 11.6, altitude_m: 520}}
pose: {position_m: [0, 0, 1], linear_m_per_s: [5, 0, 0]}
"""


def test_the_other_sensors_of_a_rig_are_told_and_written(capsys: pytest.CaptureFixture[str]) -> None:
    document = rig().read_text(encoding="utf-8")
    kept = [line for line in document.splitlines(keepends=True) if not line.startswith("pose:")]
    at = kept.index("rig:\n") + 1
    Path("rig.yaml").write_text("".join([*kept[:at], OTHERS, *kept[at:], MOVING_ON_EARTH]), encoding="utf-8")
    assert lidarsim("check", "rig.yaml") == 0
    printed = capsys.readouterr().out
    for line in (
        "imu: IMU, 200 Hz, at 0.1, 0, 0.5 m, gravity 9.80665 m/s², Earth rotation at latitude 48°",
        "  gyroscope: noise density 8.727e-05 rad/s/√Hz, bias instability 9.696e-06 rad/s, range ±7.854 rad/s",
        "  accelerometer: no errors",
        "gnss: GNSS receiver, 5 Hz, at 0, 0, 0 m, noise 0.5, 0.5, 1 m, drift 2 m",
    ):
        assert f"{line}\n" in printed
    assert lidarsim("check", "rig.yaml", "--set", "pose.position_m=[2.0e+6, 0, 1]") == 2
    assert "positions: expected coordinates within 1,000,000 m of the origin" in capsys.readouterr().err
    assert lidarsim("scan", "rig.yaml", "-o", "drive/", "--max-bag-duration", "0.1") == 0
    assert capsys.readouterr().out.endswith(" s: drive\n")
    assert {path.name for path in Path("drive").iterdir()} >= {"metadata.yaml", "drive_0.mcap", "drive_1.mcap"}
    assert lidarsim("scan", "rig.yaml", "-o", "drive/") == 0  # it takes the place of the first
    assert {path.name for path in Path("drive").iterdir()} == {"metadata.yaml", "drive_0.mcap"}
    assert lidarsim("scan", "rig.yaml", "-o", "a.pcd") == 0
    assert {"a_imu.csv", "a_gnss.csv"} <= {path.name for path in Path().glob("a_*")}
    ousters = [f"rig.{name}.sensor={{preset: ouster-os1-64}}" for name in ("top", "left")]
    assert lidarsim("scan", "rig.yaml", "-o", "b.pcap", *(part for text in ousters for part in ("--set", text))) == 0
    start = ls.config.load("rig.yaml").clock
    for name, kind in (("imu", ls.ImuSamples), ("gnss", ls.GnssFixes)):  # beside packets, in Unix time as these are
        of_run, since_start = kind.load(f"a_{name}.csv").time, kind.load(f"b_{name}.csv", start=start).time
        np.testing.assert_array_equal(since_start, of_run[: len(since_start)])
        texts = [line.split(",")[0] for line in Path(f"b_{name}.csv").read_text(encoding="ascii").splitlines()[1:]]
        assert texts == [f"{1_577_836_800 + time:.9f}".replace(".", "") for time in map(Decimal, map(str, since_start))]


def test_a_rig_is_checked_for_its_moments(capsys: pytest.CaptureFixture[str]) -> None:
    rig()
    for command in ("check rig.yaml", "scan rig.yaml -o a.pcd"):
        assert lidarsim(*command.split(), "--set", "cloud.deskew_s=0.95") == 2
        assert "deskew: expected a moment within the trajectory, 0.0 to 1.0 s, got 0.95, at " in capsys.readouterr().err
    assert lidarsim("check", "rig.yaml", "--set", "cloud.deskew=end") == 0


def test_a_trajectory_that_ends_too_soon_is_told_before_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    rig()
    before = set(Path().iterdir())
    assert lidarsim("scan", "rig.yaml", "-o", "a.pcd", "--frames", "20") == 2
    error = capsys.readouterr().err
    assert error.startswith(
        "lidarsim: pose: expected a trajectory over all pulses, got one from 0.0 to 1.0 s and pulse "
    )
    assert error.count("\n") == 1
    assert set(Path().iterdir()) == before


def test_the_layout_of_a_bag(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.mcap", "--layout", "livox", "--frames", "1") == 0
    (message,) = ls.io.rosbag.read("a.mcap")
    assert "tag" in message.cloud.fields
    capsys.readouterr()
    assert lidarsim("scan", "run.yaml", "-o", "b.mcap", "--layout", "pandar") == 2
    assert capsys.readouterr().err.startswith(
        "lidarsim: --layout: expected one of velodyne, ouster, hesai, autoware, livox, livox_cloud, laserscan"
    )
    assert lidarsim("scan", "run.yaml", "-o", "b.pcd", "--layout", "livox") == 2
    assert capsys.readouterr().err == "lidarsim: --layout: expected a bag (.mcap, .db3) as output, got b.pcd\n"


OUSTER = ("--set", "sensor={preset: ouster-os1-64, mode: 512x20}")


def test_scan_writes_packets(capsys: pytest.CaptureFixture[str]) -> None:
    Path("run.yaml").write_text(MOVING, encoding="utf-8")
    for folder, more in {"raw": (), "end": ("--set", "cloud.deskew=end")}.items():
        Path(folder).mkdir()
        assert lidarsim("scan", "run.yaml", "-o", f"{folder}/a.pcap", *OUSTER, *more) == 0
        assert capsys.readouterr().out.endswith(f" s: {Path(folder, 'a.pcap')}, {Path(folder, 'a.json')}\n")
    names = ["a.json", "a.pcap", "a_poses.tum", "a_times.txt"]
    assert sorted(path.name for path in Path("raw").iterdir()) == names
    for name in names:  # packets hold what the sensor measures, and the poses are those of its scans
        assert Path("raw", name).read_bytes() == Path("end", name).read_bytes()
    run = ls.config.load("run.yaml", [OUSTER[1]])
    encoder = ls.io.packets.encoders(run.lidars)[""]
    expected = [packet.payload for scans in run.scans() for packet in encoder.packets(scans[""])]
    assert len(expected) == 2 * 32
    assert [datagram.payload for datagram in datagrams("raw/a.pcap")] == expected
    assert ls.Lidar.from_file("raw/a.json").pattern.shape == run.lidar.pattern.shape
    starts = [run.clock.timestamp() + scans[""].time for scans in run.scans()]
    assert np.loadtxt("raw/a_times.txt").tolist() == starts
    assert ls.Trajectory.load("raw/a_poses.tum").times.tolist() == starts
    assert starts[0] <= next(datagrams("raw/a.pcap")).microseconds / 1e6 < starts[1]
    assert lidarsim("scan", "run.yaml", "-o", "b.pcap", "--frames", "1", "--variant", "legacy", *OUSTER) == 0
    assert sorted(path.name for path in Path().glob("b*")) == ["b.json", "b.pcap"]
    assert {len(datagram.payload) for datagram in datagrams("b.pcap")} == {16 * (20 + 64 * 12)}


def test_scan_writes_the_packets_of_a_rig(capsys: pytest.CaptureFixture[str]) -> None:
    sensors = ("rig.top.sensor={preset: ouster-os1-64}", "rig.left.sensor={preset: ouster-os1-64, mode: 512x20}")
    run = ls.config.load(rig(), sensors)
    assert lidarsim("scan", "rig.yaml", "-o", "a.pcap", *(part for text in sensors for part in ("--set", text))) == 0
    assert capsys.readouterr().out.endswith(" s: a.pcap, a_top.json, a_left.json\n")
    found = list(datagrams("a.pcap"))
    times = [datagram.microseconds for datagram in found]
    assert times == sorted(times)
    ports = {datagram.ports[1]: str(datagram.source) for datagram in found}
    assert ports == {7502: "192.168.1.201", 7504: "192.168.1.202"}
    for name, port in (("top", 7502), ("left", 7504)):
        metadata = json.loads(Path(f"a_{name}.json").read_bytes())
        assert metadata["config_params"]["udp_port_lidar"] == port
        columns = run.sensor[name].lidar.pattern.shape[1]
        frames = sum(name in scans for scans in run.scans())
        assert sum(datagram.ports[1] == port for datagram in found) == frames * columns // 16 > 0


def test_each_station_has_its_packets(capsys: pytest.CaptureFixture[str]) -> None:
    stations = "pose={stations: [{position_m: [0, 0, 2]}, {position_m: [3, 0, 2]}]}"
    assert lidarsim("scan", "run.yaml", "-o", "a.pcap", *OUSTER, "--set", stations) == 0
    assert capsys.readouterr().out.endswith(" s: a_*.pcap, a_*.json\n")
    names = ["a_1.json", "a_1.pcap", "a_2.json", "a_2.pcap", "a_poses.tum", "a_times.txt"]
    assert sorted(path.name for path in Path().glob("a*")) == names
    written = ls.config.load("run.yaml", [OUSTER[1], stations]).write("a.pcap")
    assert sorted(path.name for path in written) == names


def test_packets_that_cannot_be_are_refused_before_the_scan(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def scan(*_: object, **__: object) -> None:
        pytest.fail("nothing is scanned")

    monkeypatch.setattr(ls.Lidar, "scan", scan)
    grid = ("--set", "sensor={pattern: {type: grid, azimuths_deg: [0], elevations_deg: [0], rate_hz: 10}}")
    top, left = "rig.top.sensor={preset: ouster-os1-64}", "rig.left.sensor={preset: sick-lms111}"
    rig()
    Path("a.json").mkdir()
    before = set(Path().iterdir())
    for message, (config, output, *options) in {
        "model: expected one with a packet format (": ("run", "b.pcap", *grid),
        "left: model: expected one with a packet format (": ("rig", "b.pcap", "--set", top, "--set", left),
        "--variant: expected one of single, dual, low-data-rate, ": ("run", "b.pcap", "--variant", "quad", *OUSTER),
        "--layout: expected a bag (.mcap, .db3) as output, got the packets b": ("run", "b.pcap", "--layout", "ouster"),
        "--cut: expected a bag (.mcap, .db3) as output, got the packets b": ("run", "b.pcap", "--cut", "driver"),
        "--fields: expected a point cloud file as output, got the packets b": ("run", "b.pcap", "--fields", "ring"),
        "--float32: expected a point cloud file as output, got the packets b": ("run", "b.pcap", "--float32"),
        "--variant: expected packets (.pcap) as output, got the bag b.mcap": ("run", "b.mcap", "--variant", "dual"),
        "--variant: expected packets (.pcap) as output, got b.pcd": ("run", "b.pcd", "--variant", "dual"),
        "a.json: expected a file to write, got a folder": ("run", "a.pcap", *OUSTER),
    }.items():
        both = options if config == "rig" or "sensor" in str(options) else [*options, *OUSTER]
        assert lidarsim("scan", f"{config}.yaml", "-o", output, *both) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"lidarsim: {message}")
        assert error.count("\n") == 1
    Path("b.json").write_text(CONFIG, encoding="utf-8")
    assert lidarsim("scan", "b.json", "-o", "b.pcap", *OUSTER) == 2
    assert capsys.readouterr().err == f"lidarsim: b.json: {TAKEN.format(Path('b.json').resolve())}\n"
    assert set(Path().iterdir()) == before | {Path("b.json")}


def test_where_the_messages_of_a_bag_begin(capsys: pytest.CaptureFixture[str]) -> None:
    stamps = {}
    for cut in ("pattern", "driver", "0", "-90", "180"):
        assert lidarsim("scan", "run.yaml", "-o", "a.mcap", "--cut", cut, "--frames", "2") == 0
        stamps[cut] = [message.stamp // 10**6 % 1000 for message in ls.io.rosbag.read("a.mcap")]
    assert stamps == {
        "pattern": [0, 100],
        "driver": [0, 50, 150],
        "0": [0, 50, 150],
        "-90": [0, 75, 175],
        "180": [0, 100],
    }
    capsys.readouterr()
    for cut in ("front", "361", "nan", ""):
        assert lidarsim("scan", "run.yaml", "-o", "b.mcap", "--cut", cut) == 2
        wanted = f"--cut: expected pattern, driver or -360 to 360 degrees, got {cut!r}"
        assert capsys.readouterr().err == f"lidarsim: {wanted}\n"
    assert lidarsim("scan", "run.yaml", "-o", "b.pcd", "--cut", "driver") == 2
    assert capsys.readouterr().err == "lidarsim: --cut: expected a bag (.mcap, .db3) as output, got b.pcd\n"


def test_many_frames_give_ten_rows_and_their_totals(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.mcap", "--frames", "15") == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert [line[0] for line in lines[2:-2]] == ["0", "1", "2", "3", "4", "…", "11", "12", "13", "14"]
    scans = [ls.config.load("run.yaml", ["frames=15"]).scan(frame) for frame in range(15)]
    hits = sum(scan.summary()["hit"] for scan in scans)
    assert lines[-2][:4] == [f"{sum(map(len, scans)):,}", "pulses:", f"{hits:,}", "hit,"]
    assert lines[-1][:4] == ["15", "frames,", f"{hits:,}", "points"]
    assert max(map(len, lines)) < 80


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("--version") == 0
    assert capsys.readouterr().out.startswith(f"lidarsim {ls.__version__}, core with ")


def test_overrides_and_seed() -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.npz", "--set", "scene.1.label=9", "--set", "sensor.noise=none") == 0
    exact = ls.PointCloud.load("a.npz")
    assert set(exact.label) == {9, 40}
    assert not exact.range_error.any()
    assert lidarsim("scan", "run.yaml", "-o", "b.npz", "--seed", "4") == 0
    other = ls.PointCloud.load("b.npz")
    assert np.array_equal(other.range, ls.config.load("run.yaml", ["seed=4"]).scan().point_cloud().range)
    assert not np.array_equal(other.range, ls.config.load("run.yaml").scan().point_cloud().range)


@pytest.mark.slow("data sets, terrain, frames and the repository's configurations are viewed")
def test_pictures() -> None:
    assert (
        lidarsim("scan", "run.yaml", "-o", "scan.pcd", "--screenshot", "scan.png", "--color-by", "label", *SMALL) == 0
    )
    assert lidarsim("view", "scan.pcd", "--screenshot", "view.png", *SMALL) == 0
    assert lidarsim("view", "run.yaml", "--screenshot", "config.png", "--set", "cloud.frame=world", *SMALL) == 0
    assert lidarsim("sensors", "livox-mid40", "--screenshot", "sensor.png") == 0
    for name in ("scan", "view", "config", "sensor"):
        with Image.open(f"{name}.png") as drawn:
            assert (drawn.format, drawn.size == (320, 200)) == ("PNG", name != "sensor")
            assert len(drawn.convert("RGB").getcolors(2**24) or []) > 1000


def test_pictures_of_scene_files(capsys: pytest.CaptureFixture[str]) -> None:
    Path("robot.xml").write_text(
        '<mujoco><worldbody><geom size="1"/><geom name="ball" pos="3 0 0" size="1"/></worldbody></mujoco>',
        encoding="utf-8",
    )
    assert lidarsim("view", "robot.xml", "--screenshot", "a.png", "--color-by", "object_id", *SMALL) == 0
    assert len(Image.open("a.png").convert("RGB").getcolors(2**24) or []) > 1000
    assert lidarsim("view", "robot.xml", "--html", "a.html") == 0
    assert "ball" in Path("a.html").read_text(encoding="utf-8")
    assert capsys.readouterr().err == ""
    assert lidarsim("view", "robot.xml", "--screenshot", "b.png", "--seed", "1") == 2
    assert "expected only with a configuration or recipe, got robot.xml" in capsys.readouterr().err
    Path("robot.xml").write_text('<mujoco><worldbody>\n<geom file="x"/></worldbody></mujoco>', encoding="utf-8")
    assert lidarsim("view", "robot.xml", "--screenshot", "b.png") == 2
    assert capsys.readouterr().err.endswith("robot.xml:2: geom names a file, which is not read\n")


@pytest.mark.slow("data sets, terrain, frames and the repository's configurations are viewed")
@pytest.mark.parametrize("layout", ["semantickitti", "nuscenes", "shards", "bags"])
def test_data_sets_are_viewed(layout: str, capsys: pytest.CaptureFixture[str]) -> None:
    run = "".join(f"  {line}\n" for line in MOVING.replace("frames: 2\n", "").splitlines())
    recipe = f"layout: {layout}\nframes: 2\nsequences: 2\nclass_names: {{'0': ground}}\nrun:\n{run}"
    recipe = recipe.replace("normal: [0, 0, 1]}", "normal: [0, 0, 1], label: 0}")
    Path("recipe.yaml").write_text(recipe, encoding="utf-8")
    assert lidarsim("generate", "recipe.yaml", "-o", "set", "--pictures", "0") == 0
    capsys.readouterr()
    assert lidarsim("view", "set", "--screenshot", "a.png", "--html", "a.html", *SMALL, "--frame", "1") == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    page = Path("a.html").read_text(encoding="utf-8")
    assert film("a.png") == ((320, 200), 1)
    assert f'"label":"frame 3{"" if layout == "bags" else " (4 of 4)"}' in page
    assert '"label":"frame 0' not in page
    if layout != "bags":
        assert "frames 1 to 3 of 4 frames" in printed.out
        assert '"name":"ground"' in page
    assert lidarsim("view", "set", "--screenshot", "b.png", *SMALL, "--frame", "9") == 2
    expected = "frame: expected 0 to 3, got 9" if layout == "bags" else "--frame: expected the number of a frame"
    assert f"set: {expected}" in capsys.readouterr().err


def film(path: str) -> tuple[tuple[int, int], int]:
    with Image.open(path) as opened:
        return opened.size, getattr(opened, "n_frames", 1)


@pytest.mark.slow("data sets, terrain, frames and the repository's configurations are viewed")
def test_views_of_frames_are_of_all_or_of_the_first(capsys: pytest.CaptureFixture[str]) -> None:
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    everything = ("--screenshot", "a.png", "--gif", "a.gif", "--html", "a.html")
    assert lidarsim("view", "moving.yaml", *everything, *SMALL, "--camera", "birds-eye") == 0
    assert film("a.png") == ((320, 200), 1)
    assert film("a.gif") == ((320, 200), 2)
    assert '"label":"frame 1 (2 of 2), 0.10 s"' in Path("a.html").read_text(encoding="utf-8")  # a step of the slider
    assert lidarsim("view", "moving.yaml", "--screenshot", "b.png", *SMALL, "--no-surfaces") == 0
    assert lidarsim("view", "moving.yaml", "--screenshot", "c.png", *SMALL) == 0
    assert Path("b.png").read_bytes() != Path("c.png").read_bytes()
    Path("frames").mkdir()
    assert lidarsim("scan", "moving.yaml", "-o", "frames/drive.pcd") == 0
    assert lidarsim("view", "frames", "--gif", "d.gif", *SMALL) == 0
    assert film("d.gif") == ((320, 200), 2)
    assert capsys.readouterr().err == ""


@pytest.mark.slow("data sets, terrain, frames and the repository's configurations are viewed")
def test_terrain_is_viewed_from_all_around_and_by_height(capsys: pytest.CaptureFixture[str]) -> None:
    valley = str(ROOT / "configs" / "scenes" / "valley.tif")
    assert lidarsim("view", valley, "--screenshot", "a.png", "--html", "a.html", *SMALL) == 0
    assert film("a.png") == ((320, 200), 1)
    assert "height" in Path("a.html").read_text(encoding="utf-8")
    looks = {"b": ("orbit", "height"), "c": ("birds-eye", "height"), "d": ("orbit", "label")}
    for name, (camera, color) in looks.items():
        options = ("--camera", camera, "--color-by", color, *SMALL)
        assert lidarsim("view", valley, "--screenshot", f"{name}.png", *options) == 0
    first, same, *others = (Path(f"{name}.png").read_bytes() for name in "abcd")
    assert first == same
    assert first not in others
    assert capsys.readouterr().err == ""
    assert lidarsim("view", valley, "--screenshot", "a.png", "--seed", "1") == 2
    assert "--seed: expected only with a configuration or recipe" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["view", "scan"])
def test_pictures_of_a_frame_have_movers_where_they_then_are(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("moving.yaml").write_text(
        MOVING
        + """  - shape: box
    size_m: [2, 2, 2]
    position_m: [9, 0, 1]
    motion: [{time_s: 0}, {time_s: 0.1, position_m: [3, 0, 0]}, {time_s: 0.2, position_m: [3, 4, 0]}]
""",
        encoding="utf-8",
    )
    seen: list[Any] = []
    monkeypatch.setattr(ls.viewers.pyvista, "draw", lambda picture, *_, **__: seen.append(picture))
    what = ["view"] if command == "view" else ["scan", "-o", "a.npz"]
    assert lidarsim(what[0], "moving.yaml", *what[1:], "--frame", "1", "--frames", "1", "--screenshot", "a.png") == 0
    (picture,) = seen
    ((mover,),) = (frame.movers for frame in picture.frames)
    # Frame 1 begins at 0.1 s.
    assert mover.matrix[:3, 3] == pytest.approx([12, 0, 1], rel=4 * 2.0**-52)  # ulps


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
@pytest.mark.parametrize("viewer", ["pyvista", "open3d"])
def test_a_window_without_a_display_gets_one_line(
    viewer: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert lidarsim("view", "run.yaml", "--with", viewer) == 2
    expected = (
        "lidarsim: no display to open a window on (DISPLAY is not set): write a file instead (save=, --screenshot)\n"
    )
    assert capsys.readouterr().err == expected


def test_check_tells_whether_the_sensor_sees_anything(capsys: pytest.CaptureFixture[str]) -> None:
    run = ls.config.load("run.yaml", ["frames=4"])
    assert lidarsim("check", "run.yaml", "--set", "frames=4") == 0
    pulses = sum(len(run.scan(frame)) for frame in (0, 3))
    hits = sum(int((run.scan(frame).status == "hit").sum()) for frame in (0, 3))
    assert f"\nframes 0 and 3: {pulses:,} pulses: {hits:,} hit, " in capsys.readouterr().out
    assert lidarsim("check", "run.yaml", "--set", "scene=[]", "--set", "first_frame=2") == 0
    pulses = len(run.scan(2))
    assert f"\nframe 2: {pulses:,} pulses: {pulses:,} miss\n" in capsys.readouterr().out


def test_check_describes(capsys: pytest.CaptureFixture[str]) -> None:
    Path("flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n", encoding="utf-8")
    assert lidarsim("check", "run.yaml", "--set", "scene.1={shape: mesh, file: flat.obj, name: flat}") == 0
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines()]
    assert ["1", "TriangleMesh", "flat", "0", "1", "2", *["2", "×", "1", "×", "0"], "1"] in rows
    assert ["sensor", "velodyne-vlp16"] in rows
    assert printed.endswith("run.yaml: ok, 2 objects, 1 frame, seed 3\n")


def test_check_counts_objects_beyond_the_first_hundred_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    names = ["wall"] * 100 + ["pine/trunk", "pine/leaves", "oak/trunk", ""]
    scene = [{"shape": "sphere", "center_m": [k, 0, 0], "radius_m": 1, "name": n} for k, n in enumerate(names)]
    assert lidarsim("check", "run.yaml", "--set", f"scene={json.dumps(scene)}") == 0
    printed = capsys.readouterr().out
    assert sum(" Sphere " in line for line in printed.splitlines()) == 100
    assert "and 4 more objects: pine (2), oak (1), without a name (1)\n" in printed


def test_check_says_the_sizes_of_scattered_models(capsys: pytest.CaptureFixture[str]) -> None:
    Path("ramp.obj").write_text("v 0 0 0\nv 4 0 0\nv 0 2 1\nf 1 2 3\n", encoding="utf-8")
    Path("recipe.yaml").write_text(
        """
layout: semantickitti
scatter:
  ramps: {objects: [{shape: mesh, file: ramp.obj, scale: 0.5}], on: [road], count: 2, area_m: [[-9, -9], [9, 9]]}
run:
  sensor: {preset: velodyne-vlp16}
  scene: [{shape: plane, normal: [0, 0, 1], distance_m: 0, name: road}]
  pose: {position_m: [0, 0, 1.8]}
""",
        encoding="utf-8",
    )
    assert lidarsim("check", "recipe.yaml") == 0
    assert "models: ramp.obj (2 × 1 × 0.5 m)\n" in capsys.readouterr().out


VARIED = """
layout: {type: shards}
vary: {scene.0.radius_m: {uniform: [0, 1]}, scene.0.center_m.0: {choice: [4, 5, 6]}}
run: {sensor: {preset: velodyne-vlp16}, scene: [{shape: sphere, center_m: [5, 0, 0], radius_m: 1}]}
"""


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("vary.scene.0.radius_m={uniform: [-1e-9, 1]}", "scene.0.radius_m: expected a finite number > 0, got -9.9"),
        ("vary.scene.0.radius_m={uniform: [1, .inf]}", "expected [least, greatest], got [1.0, inf]"),
        ("vary.scene.0.radius_m={integer: [0, 9]}", "expected a finite number > 0, got 0"),
        ("vary.scene.0.center_m.0={choice: [4, 5, far]}", "expected a number, got 'far'"),
        ("layout.fields=[foo]", "fields: expected fields of this point cloud ("),
    ],
)
def test_check_finds_what_later_sequences_refuse(
    assignment: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("recipe.yaml").write_text(VARIED, encoding="utf-8")
    assert lidarsim("check", "recipe.yaml") == 0
    assert lidarsim("check", "recipe.yaml", "--set", assignment) == 2
    assert message in capsys.readouterr().err


def test_check_calls_after_scan(capsys: pytest.CaptureFixture[str]) -> None:
    Path("thin.py").write_text("def thin(cloud, rng):\n    return cloud[::2]\n", encoding="utf-8")
    Path("recipe.yaml").write_text("after_scan: thin:thin" + VARIED, encoding="utf-8")
    assert lidarsim("check", "recipe.yaml") == 0
    assert lidarsim("check", "recipe.yaml", "--set", "layout.fields=[foo]") == 2
    assert "fields: expected some of xyz, range, " in capsys.readouterr().err
    Path("thin.py").write_text("def thin(cloud, rng):\n    return cloud[0 / 0]\n", encoding="utf-8")
    assert lidarsim("check", "recipe.yaml") == 2
    expected = "after_scan: expected thin:thin to return a PointCloud, got ZeroDivisionError: division by zero"
    assert expected in capsys.readouterr().err


def test_check_says_whether_the_sensor_meets_an_object_or_comes_near_it(capsys: pytest.CaptureFixture[str]) -> None:
    Path("recipe.yaml").write_text(
        """
layout: semantickitti
scatter:
  ramps: {objects: [{shape: sphere, center_m: [0, 0, 1], radius_m: 1}], on: [road], count: 0, area_m: [[0, 0], [9, 9]]}
run:
  sensor: {preset: velodyne-vlp16}
  scene:
    - {shape: plane, normal: [0, 0, 1], name: road}
    - {shape: box, size_m: [1, 8, 3], center_m: [0.5, 0, 1.5], name: wall}
  pose: {position_m: [-0.2, 0, 1.8], linear_m_per_s: [5, 0, 0]}
""",
        encoding="utf-8",
    )
    assert lidarsim("check", "recipe.yaml") == 0
    assert "in sequence 0, the sensor meets wall of the scene at " in capsys.readouterr().out
    near = ["--set", "run.pose.position_m.0=-2", "--set", "scatter.ramps.clear_m=3"]
    assert lidarsim("check", "recipe.yaml", *near) == 0
    line = "in sequence 0, the sensor comes nearer than clear_m to wall of the scene at 0.0 s"
    assert line in capsys.readouterr().out


def test_check_says_what_light_a_sensor_does_not_follow(capsys: pytest.CaptureFixture[str]) -> None:
    glass = ["--set", "scene.1.material=glass"]
    assert lidarsim("check", "run.yaml") == 0
    assert "depth" not in capsys.readouterr().out
    assert lidarsim("check", "run.yaml", *glass) == 0
    line = "1 material transmits and 1 material mirrors, but depth is 1: give the measurement a depth of 2 or more"
    assert line in capsys.readouterr().out
    assert lidarsim("check", "run.yaml", "--set", "scene.1.material=net", "--set", "scene.0.transmission=0.1") == 0
    assert "\n2 materials transmit, but depth is 1: " in capsys.readouterr().out
    assert lidarsim("check", "run.yaml", *glass, "--set", "sensor.measurement.depth=2") == 0
    assert "depth is 1" not in capsys.readouterr().out


def test_check_describes_terrain(capsys: pytest.CaptureFixture[str]) -> None:
    text = "ncols 4\nnrows 3\nxllcorner 10.5\nyllcorner -2\ncellsize 2\n1 2 3 4\n5 -9999 7 8\n9 10 11 -9999\n"
    Path("dem.asc").write_text(text, encoding="ascii")
    assert lidarsim("check", "run.yaml", "--set", "scene.1={shape: raster, file: dem.asc}") == 0
    line = "object 1: heights in 3 rows and 4 columns, 2 holes; x 11.5 … 17.5 m, y -1 … 3 m, z 1 … 11 m\n"
    assert line in capsys.readouterr().out
    assert lidarsim("check", str(ROOT / "configs" / "survey.yaml")) == 0
    (line,) = re.findall("object 0: .*\n", capsys.readouterr().out)
    assert line.startswith("object 0: heights in 140 rows and 240 columns, 1,505 holes; x 612002.5 … 613197.5 m, ")
    assert line.endswith(" m, EPSG:32632\n")


def test_check_and_scan_agree_on_a_trajectory_as_long_as_the_frames() -> None:
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    for deskew in ("deskew=end", "deskew=middle", "deskew_s=0.05"):
        assert lidarsim("check", "moving.yaml", "--set", f"cloud.{deskew}") == 0
        assert lidarsim("scan", "moving.yaml", "-o", "scan.npz", "--set", f"cloud.{deskew}") == 0
        run = ls.config.load("moving.yaml", [f"cloud.{deskew}"])
        moment = {"deskew=end": 0.1}.get(deskew, 0.05)
        assert np.array_equal(ls.PointCloud.load("scan_0001.npz").xyz, run.scan(1).point_cloud(deskew=moment).xyz)


@pytest.mark.slow("data sets, terrain, frames and the repository's configurations are viewed")
def test_the_configurations_in_the_repository_are_right() -> None:
    runs = sorted((ROOT / "configs").glob("*.yaml"))
    assert len(runs) >= 3
    for path in runs:
        assert lidarsim("check", str(path)) == 0, path


def test_sensors_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("sensors") == 0
    first = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert [name for name in first if name in ls.Lidar.presets()] == ls.Lidar.presets()


def test_measured_sensors_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("sensors") == 0
    said = " ".join(capsys.readouterr().out.split()).partition("Presets with measured noise: ")[2]
    assert said.startswith("hesai-pandar40p, hesai-pandar64,")
    for name in ls.Lidar.presets():
        if f"{name}," in said or f"{name}." in said:
            ls.Lidar.preset(name, noise="measured")
        else:
            with pytest.raises(ValueError, match=r"^noise: expected none or datasheet, got 'measured'"):
                ls.Lidar.preset(name, noise="measured")


def test_measured_values_are_printed_with_their_source(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("sensors", "hesai-xt32") == 0
    (line,) = [line.split() for line in capsys.readouterr().out.splitlines() if " measurement.range_sigma_m " in line]
    assert line[:3] == ["measurement.range_sigma_m", "0.0028", "measured:"]
    assert lidarsim("sensors", "livox-avia") == 0
    assert "measured" not in capsys.readouterr().out


@pytest.mark.slow("what each command prints fits the columns of the terminal")
@pytest.mark.parametrize(
    "command",
    [
        ("sensors",),
        *(("sensors", name) for name in ls.Lidar.presets()),
        *(("check", str(ROOT / "configs" / f"{name}.yaml")) for name in ("rig", "junction", "courtyard", "airborne")),
        ("scan", "run.yaml", "--frames", "12", "-o", "scan.pcd"),
        ("view", "run.yaml", "--frames", "2", "--screenshot", "a.png", "--size", "64x40"),
        ("compare", "one.pcd", "two.pcd"),
    ],
    ids=lambda command: "-".join(Path(word).name for word in command[:2]),
)
def test_everything_fits_the_columns_that_there_are(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if command[0] == "compare":
        for seed, name in enumerate(command[1:]):
            lidarsim("scan", "run.yaml", "-o", name, "--seed", str(seed))
        capsys.readouterr()
    for columns in (80, 60):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert lidarsim(*command) == 0
        printed = capsys.readouterr().out.splitlines()
        assert printed
        for line in printed:
            assert len(line) <= columns or len(line.split()) == 1, line  # a path stays whole
            assert columns < 80 or not re.search(r"\w…( |$)", line)  # cut off


def test_the_lines_of_the_benchmark_fit(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.bench import report

    Path("speed.json").write_text("{}", encoding="utf-8")
    monkeypatch.setattr(report, "write", lambda *_: None)
    monkeypatch.setattr(report, "summary", lambda _: "- one: 2 × three\n- robots, " + "scan_many, " * 12 + "1.1 ×")
    monkeypatch.setenv("COLUMNS", "60")
    assert lidarsim("bench", "--from", "speed.json", "-o", "out") == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 6
    assert max(map(len, printed)) <= 60
    assert [line[:2] for line in printed] == ["- ", "- ", "  ", "  ", "", "Th"]


def test_a_sensor_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("sensors", "ouster-os1-64") == 0
    printed = capsys.readouterr().out
    assert "655,360 pulses/s at 10 Hz" in printed
    assert "modes: 512x10, 512x20, 1024x10, 1024x20, 2048x10" in printed
    assert "pattern.elevations_deg" in printed


def test_a_sensor_of_ones_own_is_described_and_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    file = str(ROOT / "configs" / "sensors" / "city-lidar.yaml")
    assert lidarsim("sensors", file, "--screenshot", "pattern.png") == 0
    printed = capsys.readouterr().out
    assert re.search(r"^ sensor +city-lidar$.*^ rings, columns +128, 1,024$", printed, re.MULTILINE | re.DOTALL)
    assert Path("pattern.png").stat().st_size > 1000
    assert "source" not in printed  # it cites none


@pytest.mark.parametrize("key", ["preset: ouster-os1-64", "pattern: {type: spinning}", "name: mine"])
def test_the_file_of_a_sensor_is_no_configuration(key: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.yaml").write_text(key, encoding="utf-8")
    assert lidarsim("check", "mine.yaml") == 2
    name = key.partition(":")[0]
    assert capsys.readouterr().err == f"lidarsim: mine.yaml:1: {name}: unknown key; did you mean sensor.{name}?\n"


def test_a_sensor_is_printed_to_start_from(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("sensors", "ouster-os1-64", "--yaml") == 0
    Path("mine.yaml").write_text(capsys.readouterr().out, encoding="utf-8")
    mine, preset = ls.Lidar.from_file("mine.yaml"), ls.Lidar.preset("ouster-os1-64")
    assert np.array_equal(mine.pattern.pulses().directions, preset.pattern.pulses().directions)


def test_without_a_command_it_says_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim() == 0
    printed = capsys.readouterr().out
    assert all(f"\n  {command} " in printed for command in ("scan", "view", "check", "sensors", "bench"))


def test_bench_has_its_own_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["bench", "--help"])
    assert not left.value.code
    assert "--quick" in capsys.readouterr().out


MISTAKES = {
    # configurations
    "scan gone.yaml -o a.pcd": "gone.yaml: cannot read the file: No such file or directory",
    "scan . -o a.pcd": ".: cannot read the file: Is a directory",
    "scan run.yaml -o a.pcd --set scene.1.radius_m=-1": (
        "--set scene.1.radius_m=-1: expected a finite number > 0, got -1.0"
    ),
    "scan run.yaml -o a.pcd --frames 0": "--set frames=0: expected a value >= 1, got 0",
    'scan run.yaml -o a.pcd --set pose={"file":"gone.tum"}': (
        '--set pose={"file":"gone.tum"}: pose.file: cannot read gone.tum: No such file or directory'
    ),
    "check run.yaml --set sensor.noise=true": "--set sensor.noise=true: expected none, datasheet or measured, got true",
    "check run.yaml --set sensor.mode=1": "--set sensor.mode=1: expected the name of a mode, got 1",
    "check run.yaml --set cloud.deskew=mid": (
        "--set cloud.deskew=mid: expected true, false, start, middle, end, or seconds as deskew_s, got 'mid'"
    ),
    "check run.yaml --set cloud.deskew_s=1 --set cloud.deskew=end": (
        "--set cloud.deskew_s=1: expected either deskew or deskew_s, got both"
    ),
    # what check builds, and scan refuses
    "check moving.yaml --set frames=3": (
        "pose: expected a trajectory over all pulses, got one from 0.0 to 0.2 s and pulse 0 at 0.20000563200000002 s"
    ),
    "check moving.yaml --set cloud.deskew_s=0.15": (
        "deskew: expected a moment within the trajectory, 0.0 to 0.2 s, got 0.15, at 0.25 s"
    ),
    "check run.yaml --set first_frame=4294967296": (
        "--set first_frame=4294967296: expected a value < 4294967296, got 4294967296"
    ),
    "check run.yaml --set first_frame=4294967295 --set frames=2": (
        "--set frames=2: expected at most 4294967296 with first_frame, got 2"
    ),
    "check run.yaml --set scene.0.reflectivity_per=face --set scene.0.reflectivity=[1]": (
        "run.yaml:5: scene.0: material: expected a TriangleMesh, Spheres or Disks for a reflectivity per face, "
        "got Plane"
    ),
    "check broken.yaml": "broken.yaml:2: scene.0.radius: unknown key; did you mean radius_m?",
    # outputs
    "scan run.yaml -o a.fls": f"a.fls: unknown extension '.fls', expected {FORMATS}",
    "scan run.yaml -o a": f"a: no extension, expected {FORMATS}",
    "scan run.yaml -o a.b/": "a.b/: expected the name of a folder for a bag, without a dot",
    "scan run.yaml -o gone/a/": "gone/a/: the folder gone does not exist",
    "scan run.yaml -o kept/": (
        "kept/: expected a new folder, or one with a bag that lidarsim wrote, got one with 'notes.txt'; "
        "remove it or choose another name"
    ),
    "scan run.yaml -o a.mcap --max-bag-size 1000": (
        "--max-bag-size: expected the folder of a bag, which ends in /, as output, got the bag a.mcap"
    ),
    "scan run.yaml -o a/ --max-bag-duration 0": "--max-bag-duration: expected a finite number > 0, got 0.0",
    "scan run.yaml -o a/ --fields label": "--fields: expected a point cloud file as output, got the bag a",
    "scan run.yaml -o a.pcd --fields ,": ("--fields: expected names such as intensity,ring, or xyz alone, got ','"),
    "scan run.yaml -o a.pcd --fields smell": (
        f"--fields: expected fields of this point cloud (xyz, {', '.join(ALWAYS)}), got 'smell'"
    ),
    "scan run.yaml -o a.pcd --seed 1.5": "Invalid value for '--seed': expected an integer, got '1.5'",
    "scan run.yaml -o a/ --max-bag-duration x": "Invalid value for '--max-bag-duration': expected a number, got 'x'",
    "scan run.yaml -o a.pcd --size 0x0": "--size: expected an integer from 16 to 16384, got 0",
    "generate detection -o made --pictures -1": "--pictures: expected an integer >= 0, got -1",
    "scan run.yaml -o gone/a.pcd": "gone/a.pcd: the folder gone does not exist",
    "scan run.yaml -o run.yaml/a.pcd": "run.yaml/a.pcd: run.yaml is not a folder",
    "scan run.yaml -o folder.pcd": "folder.pcd: expected a file to write, got a folder",
    f"scan run.yaml -o {LONG}.pcd": f"{LONG}.pcd: File name too long",
    "scan run.yaml -o a.pcd --screenshot a.bmp": "a.bmp: unknown extension '.bmp', expected .jpg or .png",
    "scan run.yaml -o a.pcd --screenshot gone/a.png": "gone/a.png: the folder gone does not exist",
    # views
    "view gone.pcd --screenshot a.png": "gone.pcd: no such file",
    "view run.yaml --screenshot a.png --color-by smell": f"--color-by: expected one of height, {NUMBERS}, got 'smell'",
    "view run.yaml --with open3d --screenshot a.png": (
        "--with open3d: Open3D only opens windows; leave it out with --screenshot, --html, --gif or --mp4"
    ),
    "view run.yaml --html a.htm": "a.htm: unknown extension '.htm', expected .html",
    "view run.yaml --gif a.png": "a.png: unknown extension '.png', expected .gif",
    "view run.yaml --screenshot a.png --size 100": (
        "--size: expected WIDTHxHEIGHT in pixels, such as 1600x1000, got '100'"
    ),
    "view cloud.xyz --screenshot a.png --set seed=1 --frame 2": (
        "--set: expected only with a configuration or recipe, got cloud.xyz"
    ),
    "view cloud.xyz --screenshot a.png --frames 0": "--frames: expected an integer >= 1, got 0",
    "stream run.yaml --metadata kept": "kept: expected a file to write, got a folder",
    "view folder.pcd --screenshot a.png": "folder.pcd: expected a data set or a folder of point clouds, got neither",
    # sensors
    "sensors velodyne-vlp17": (
        "preset: expected the name of a sensor, got 'velodyne-vlp17'; "
        "did you mean velodyne-vlp16 or velodyne-vls128 or velodyne-vlp32c?"
    ),
    "sensors mine.yaml": "mine.yaml: cannot read the file: No such file or directory",
    "sensors --yaml": "--yaml, --screenshot: expected the NAME of a sensor with them, got none",
}


@pytest.mark.parametrize(("arguments", "message"), MISTAKES.items(), ids=[text[:50] for text in MISTAKES])
def test_a_mistake_gets_one_line(arguments: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("folder.pcd").mkdir()
    Path("kept").mkdir()
    Path("kept/notes.txt").touch()
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    Path("broken.yaml").write_text("sensor: {preset: velodyne-vlp16}\nscene: [{shape: sphere, radius: 1}]")
    Path("cloud.xyz").write_text("1 2 3\n")
    before = set(Path().iterdir())
    assert lidarsim(*arguments.split()) == 2
    assert capsys.readouterr().err == f"lidarsim: {message}\n"
    assert set(Path().iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "begin"),
    [
        ("scan", "Missing argument 'CONFIG'"),
        ("scan run.yaml", "Missing option '--output'"),
        ("scan run.yaml -o a.pcd --seed x", "Invalid value for '--seed': "),
        ("scan run.yaml -o a.pcd --sed 1", "No such option: --sed"),
        ("view run.yaml --with paraview", "Invalid value for '--with': "),
        ("scun", "No such command 'scun'"),
    ],
)
def test_arguments_that_typer_refuses(arguments: str, begin: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim(*arguments.split()) == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"lidarsim: {begin}")
    assert printed.count("\n") == 1


def test_a_folder_that_lets_nobody_write(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda _path, mode: not mode & os.W_OK)  # root may write wherever it likes
    assert lidarsim("scan", "run.yaml", "-o", "a.pcd") == 2
    assert capsys.readouterr().err == "lidarsim: a.pcd: no permission to write in the folder .\n"


def test_several_lines_of_error_become_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("check", "run.yaml", "--set", "scene.0.name=[\n1]") == 2
    assert capsys.readouterr().err.count("\n") == 1


def start(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-c", "from lidarsim.cli import main; main()", *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": path}, **streams, **options)


def test_interrupting_a_scan_leaves_no_half_written_file() -> None:
    scan = start("scan", "run.yaml", "-o", "scan.npz", "--frames", "100000")
    while not Path("scan_0000.npz").exists() and scan.poll() is None:
        time.sleep(0.05)
    scan.send_signal(signal.SIGINT)
    assert scan.communicate(timeout=60) == ("", "")
    assert scan.returncode == 130
    for path in Path().iterdir():
        assert path.name == "run.yaml" or len(ls.PointCloud.load(path))


def test_a_pipe_that_closes_early_gets_no_complaint() -> None:
    with start("sensors", "velodyne-vls128", "--yaml") as printing:
        assert printing.stdout
        assert printing.stderr
        printing.stdout.close()
        assert printing.stderr.read() == ""


# terminals, streams and names of every kind

HOSTILE = (
    "\x1b]0;owned\a\x1b[2J", "\x9b31m", "[red]x[/]", "[/]", "[bold", ":car:", "a\nb\r\tc", "\u202eevil\u2066",
    "道路", "e\u0301" * 9, "scan nan", "x" * 10_000,
)  # fmt: skip


def python(*arguments: str, script: str | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``python -m lidarsim``, or a line of a shell in which it is $lidarsim; never with a traceback."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "lidarsim", *arguments]
    if script:
        command = ["bash", "-c", script.replace("$lidarsim", f"{sys.executable} -m lidarsim")]
    streams: Any = {"capture_output": True, "encoding": "utf-8", "errors": "backslashreplace"}
    buffered = {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "", **environment}
    done = subprocess.run(command, env=buffered, **streams, check=False)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done


def test_python_runs_the_package() -> None:
    done = python("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"lidarsim {ls.__version__}, core with ")


def test_no_name_controls_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    objects = "".join(
        f"  - {{shape: sphere, center_m: [5, 0, {3 * i}], radius_m: 1, label: {i}, name: {json.dumps(name)}}}\n"
        for i, name in enumerate(HOSTILE)
    )
    for sensor in HOSTILE:
        Path("odd.yaml").write_text(
            f"sensor: {{preset: velodyne-vlp16, name: {json.dumps(sensor)}}}\nscene:\n{objects}", encoding="utf-8"
        )
        assert lidarsim("check", "odd.yaml") == 0
        printed = capsys.readouterr().out
        assert printed.replace("\n", "").isprintable()
        (told,) = (line for line in printed.splitlines() if line.startswith(" sensor "))
        assert plain(sensor)[:50] in told
    rows = [line for line in printed.splitlines() if " Sphere " in line]
    assert len(rows) == len(HOSTILE)
    assert len(set(map(cell_len, rows))) == 1
    for name, row in zip(HOSTILE, rows, strict=True):
        assert plain(name)[:50] in row
    assert lidarsim("scan", "odd.yaml", "-o", "a.pcd") == 0
    assert capsys.readouterr().out.replace("\n", "").isprintable()


ESCAPE = r'"\e]0;owned\a\e[31m"'


@pytest.mark.parametrize(
    "text",
    [
        f"{ESCAPE}: 1\n",
        f"frames: {ESCAPE}\n",
        f"scene: [{{shape: {ESCAPE}}}]\n",
        f"sensor: {{preset: {ESCAPE}}}\nscene: []\n",
        f"sensor: {{preset: velodyne-vlp16, mode: {ESCAPE}}}\nscene: []\n",
        f"scene: {{file: {ESCAPE}}}\nsensor: {{preset: velodyne-vlp16}}\n",
        f"scene: []\nrig: {{{ESCAPE}: {{sensor: {{preset: velodyne-vlp16}}}}}}\n",
        "seed: !<tag:x%1B[31m> 1\n",
        "seed: \x1b[31m\n",
    ],
)
def test_no_error_controls_the_terminal(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = "odd\x1b[31m\u202e.yaml"
    Path(name).write_text(text, encoding="utf-8")
    assert lidarsim("check", name) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(r"lidarsim: odd\x1b[31m\u202e.yaml:")
    assert printed.err.count("\n") == 1
    assert printed.err[:-1].isprintable()


@pytest.mark.slow("a process whose streams close, fill up or know few characters ends in one line")
@pytest.mark.skipif(sys.platform == "win32", reason="no shell of this kind")
@pytest.mark.parametrize("command", ["--help", "check run.yaml", "check gone.yaml"])
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_closed_streams(command: str, closed: str) -> None:
    done = python(script=f"$lidarsim {command} {closed}")
    assert done.returncode == (2 if "gone" in command else 0)
    heard = "gone" in command and "2>" not in closed
    assert done.stderr == ("lidarsim: gone.yaml: cannot read the file: No such file or directory\n" if heard else "")


@pytest.mark.slow("a process whose streams close, fill up or know few characters ends in one line")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
@pytest.mark.parametrize("command", ["--help", "check run.yaml", "bench --help"])
def test_a_full_disk_behind_stdout(command: str) -> None:
    done = python(script=f"$lidarsim {command} >/dev/full")
    assert done.returncode == 2
    assert done.stderr.startswith("lidarsim: ")
    assert done.stderr.endswith("No space left on device\n")
    assert done.stderr.count("\n") == 1
    assert python(script="$lidarsim check gone.yaml 2>/dev/full").returncode == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
@pytest.mark.parametrize("name", ["x.xyz", "x.mcap"])
def test_a_full_disk_behind_the_output(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path(name).symlink_to("/dev/full")
    assert lidarsim("scan", "run.yaml", "-o", name) == 2
    assert capsys.readouterr().err == f"lidarsim: {name}: cannot be written: No space left on device\n"
    assert Path(name).is_symlink()


@pytest.mark.slow("a process whose streams close, fill up or know few characters ends in one line")
@pytest.mark.skipif(sys.platform == "win32", reason="no shell of this kind")
@pytest.mark.parametrize("command", ["--help", "sensors"])
def test_a_pipe_that_nobody_reads(command: str) -> None:
    done = python(script=f"set -o pipefail; $lidarsim {command} | true")
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.slow("a process whose streams close, fill up or know few characters ends in one line")
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_terminals_without_unicode(encoding: str) -> None:
    Path("ö.yaml").write_text(CONFIG.replace("label: 7", "label: 7, name: 道路ö"), encoding="utf-8")
    for arguments in (["sensors", "ouster-os1-64"], ["check", "ö.yaml"], ["check", "道.yaml"]):
        done = python(*arguments, PYTHONIOENCODING=encoding)
        assert done.returncode == (2 if arguments[-1] == "道.yaml" else 0)
        if encoding == "ascii":
            assert (done.stdout + done.stderr).isascii()
    assert done.stderr.startswith(r"lidarsim: \u9053.yaml: ")


def test_no_home_and_no_terminal_to_speak_of() -> None:
    environment = {name: os.environ[name] for name in ("SYSTEMROOT",) if name in os.environ}
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-m", "lidarsim", "check", "run.yaml"],
        env={**environment, "PYTHONPATH": path, "TERM": "dumb", "COLUMNS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert " ".join(done.stdout.split()).endswith("run.yaml: ok, 2 objects, 1 frame, seed 3")


def test_optimised_python_has_the_same_commands() -> None:
    done = python("--help", PYTHONOPTIMIZE="2")  # without asserts and docstrings
    assert done.returncode == 0
    assert all(f"\n  {command}" in done.stdout for command in ("scan", "view", "check", "sensors", "bench"))


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MemoryError(), "out of memory: MemoryError"),
        (MemoryError("out of memory: 9 bytes"), "out of memory: 9 bytes"),
        (RecursionError("too deep"), "internal error, please report it: RecursionError: too deep"),
        (KeyError("x\x1b"), "internal error, please report it: KeyError: 'x\\x1b'"),
        (TypeError("label: expected\n an integer"), "label: expected an integer"),
        (ValueError(), "ValueError"),
        (OSError(13, "Permission denied", "a\x1b"), "a\\x1b: Permission denied"),
        (BaseException("panicked"), "internal error, please report it: BaseException: panicked"),
    ],
)
def test_whatever_goes_wrong_is_one_line(
    error: BaseException, line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(ls.config, "load", fail)
    assert lidarsim("check", "run.yaml") == 2
    assert capsys.readouterr() == ("", f"lidarsim: {line}\n")
    monkeypatch.setattr(ls.config, "load", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    assert lidarsim("check", "run.yaml") == 130
    assert capsys.readouterr() == ("", "")


DIGITS = "1" + "0" * 5000


@pytest.mark.parametrize(
    "arguments",
    [
        *(["check", "run.yaml", "--set", f"seed={number}"] for number in ("1e401", "1.0e401", "9" * 401, DIGITS)),
        *(["check", "run.yaml", "--set", f"{key}={DIGITS[:402]}"] for key in ("frames", "first_frame")),
        ["check", "run.yaml", "--set", f"scene.{DIGITS}.radius_m=1"],
        ["check", "run.yaml", "--set", f"scene.1.radius_m={DIGITS}"],
        ["check", "run.yaml", "--set", f"seed={'[' * 20_000}"],
        *(["scan", "run.yaml", "-o", "a.pcd", option, DIGITS] for option in ("--seed", "--frame", "--frames")),
        *(["scan", "run.yaml", "-o", "a.pcd", option, DIGITS[:402]] for option in ("--seed", "--frame", "--frames")),
        ["view", "run.yaml", "--screenshot", "a.png", "--size", f"{DIGITS}x10"],
        ["view", "run.yaml", "--screenshot", "a.png", "--size", "0x10"],
        ["generate", "run.yaml", "-o", "out", "--shard", f"{DIGITS}/{DIGITS}"],
        ["generate", "run.yaml", "-o", "out", "--workers", DIGITS],
        ["generate", "run.yaml", "-o", "out", "--workers", "1", "--scheduler", ""],
        ["check", ""],
        ["check", "\udcff.yaml"],
        ["check", "a\0b.yaml"],
        ["scan", "run.yaml", "-o", ""],
        ["scan", "run.yaml", "-o", "a\0b.pcd"],
        ["scan", "", "-o", "a.pcd"],
        ["view", "", "--screenshot", "a.png"],
        ["view", "a\0b.pcd", "--screenshot", "a.png"],
        ["view", "run.yaml", "--screenshot", ""],
        ["view", "run.yaml", "--screenshot", "a.png", "--color-by", "\udcff"],
        ["generate", "", "-o", "out"],
        ["generate", "run.yaml", "-o", ""],
        ["generate", "--verify", "-o", ""],
        ["sensors", ""],
        ["sensors", "\udcff"],
        ["sensors", "a\0b"],
        ["check", "run.yaml", "--set", ""],
        ["check", "run.yaml", "--set", "scene.0.name=\udcff"],
        ["\x1b[31m"],
        ["check", "run.yaml", "--\x1b[31m"],
    ],
    ids=lambda arguments: ascii(" ".join(arguments))[:60],
)
def test_odd_arguments_get_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    before = set(Path().iterdir())
    assert lidarsim(*arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("lidarsim: ")
    assert printed.err.count("\n") == 1
    assert printed.err[:-1].isprintable()
    assert len(printed.err) < 2100
    assert "internal error" not in printed.err
    assert set(Path().iterdir()) == before


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_file_names_that_are_not_unicode(capsys: pytest.CaptureFixture[str]) -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a\udcff.pcd") == 0
    assert capsys.readouterr().out.endswith(" s: a\\udcff.pcd\n")
    assert len(ls.PointCloud.load("a\udcff.pcd")) > 10_000


def test_no_output_takes_the_place_of_another(capsys: pytest.CaptureFixture[str]) -> None:
    Path("rig.yaml").write_text(RIG.replace("left:", "Top:").replace("pose: {file: drive.csv}\n", ""), encoding="utf-8")
    Path("run.pcd").write_text(CONFIG, encoding="utf-8")
    Path("b_poses.tum").mkdir()
    Path("link.png").symlink_to("a.pcd")
    before = {path: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    for arguments, message in (
        (
            "rig.yaml -o a.pcd",
            "rig.yaml:1: rig: sensors: expected names that differ in more than case, got 'top' and 'Top'",
        ),
        ("run.pcd -o run.pcd", f"run.pcd: {TAKEN.format(Path('run.pcd').resolve())}"),
        ("run.yaml -o a.pcd --screenshot link.png", "link.png: expected a file of its own, got the place of a.pcd"),
        ("run.yaml -o b.pcd --frames 2", "b_poses.tum: expected a file to write, got a folder"),
    ):
        assert lidarsim("scan", *arguments.split()) == 2
        assert capsys.readouterr().err == f"lidarsim: {message}\n"
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before


def test_no_picture_and_no_metadata_replaces_what_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    given = Path(__file__).parent / "data" / "sensors" / "ouster" / "2_1_2_os1-991913000010-64.json"
    Path("os.json").write_bytes(given.read_bytes())
    Path("run.yaml").write_text("sensor: {file: os.json}\nscene: {file: a.png}\n", encoding="utf-8")
    Path("a.png").write_text("[{shape: sphere, center_m: [5, 0, 0], radius_m: 1}]", encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    for arguments, name in (
        ("stream run.yaml --metadata os.json", "os.json"),
        ("view run.yaml --screenshot a.png", "a.png"),
    ):
        assert lidarsim(*arguments.split()) == 2
        assert capsys.readouterr().err == f"lidarsim: {name}: {TAKEN.format(Path(name).resolve())}\n"
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


def test_labelled_points_can_have_other_colours() -> None:
    assert lidarsim("scan", "run.yaml", "-o", "a.las") == 0
    for color in ("label", "range"):
        assert lidarsim("view", "a.las", "--screenshot", f"{color}.png", "--color-by", color, *SMALL) == 0
    assert Path("label.png").read_bytes() != Path("range.png").read_bytes()


def test_the_looks_of_a_view(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Each option reaches `lidarsim.show`, and a picture can be a JPG."""
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    given: list[dict[str, Any]] = []
    draw = ls.show
    monkeypatch.setattr(
        ls, "show", lambda what, **looks: (given.append({"count": len(what), **looks}), draw(what, **looks))
    )
    looks = ("--limits", "0,50", "--color-map", "viridis", "--background", "white", "--color-by", "range")
    assert lidarsim("view", "moving.yaml", "--screenshot", "a.jpg", *SMALL, *looks, "--title", "A drive") == 0
    assert lidarsim("view", "moving.yaml", "--screenshot", "b.png", *SMALL, "--accumulate") == 0
    assert capsys.readouterr().out == "a.jpg: the first of 2 frames; --html, --gif and --mp4 show all\n"
    one, all_ = given
    assert {name: one[name] for name in ("limits", "color_map", "background", "color_by", "title", "count")} == {
        "limits": (0.0, 50.0), "color_map": "viridis", "background": "white", "color_by": "range",
        "title": "A drive", "count": 1,
    }  # fmt: skip
    assert (all_["count"], all_["accumulate"], all_["title"]) == (2, True, "2 frames, 0.00 to 0.10 s")
    with Image.open("a.jpg") as picture:
        assert picture.format == "JPEG"
        assert np.asarray(picture.convert("L")).mean() > 150  # white
    for wrong in ("5", "a,b", "1,2,3", ""):
        assert lidarsim("view", "moving.yaml", "--screenshot", "c.png", "--limits", wrong) == 2
        assert f"--limits: expected LOW,HIGH, such as 0,50, got {wrong!r}" in capsys.readouterr().err
    assert lidarsim("view", "moving.yaml", "--screenshot", "c.png", "--limits", "5,1") == 2
    assert "--limits: expected two numbers, the second greater, got 5 and 1" in capsys.readouterr().err
    assert not Path("c.png").exists()


def test_a_screenshot_of_frames_says_that_it_is_of_the_first(capsys: pytest.CaptureFixture[str]) -> None:
    Path("moving.yaml").write_text(MOVING, encoding="utf-8")
    assert lidarsim("view", "moving.yaml", "--screenshot", "a.png", *SMALL) == 0
    assert capsys.readouterr().out == "a.png: the first of 2 frames; --html, --gif and --mp4 show all\n"
    assert lidarsim("view", "moving.yaml", "--screenshot", "b.png", "--frames", "1", *SMALL) == 0
    assert capsys.readouterr().out == ""
    first, only = (np.asarray(Image.open(name).convert("RGB")) for name in ("a.png", "b.png"))
    assert first.shape == only.shape
    assert (first != only).any()  # the one says which frame of how many it shows, in a view that has room for all


@pytest.mark.parametrize("command", [("check", "run.yaml"), ("scan", "run.yaml", "-o", "scan.pcd")])
def test_a_frame_beyond_memory_is_one_line(
    command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lidarsim.patterns._parts.PULSE_BYTES", 1 << 40)  # more than any machine has
    pattern = "{type: palmer, half_angle_deg: 20, scan_rate_hz: 50, pulse_rate_khz: 2.0e+6, rate_hz: 10}"
    Path("run.yaml").write_text(f"sensor: {{pattern: {pattern}}}\nscene: []\n", encoding="utf-8")
    assert lidarsim(*command) == 2
    assert f"{200_000_000 << 40} bytes for the 200000000 pulses of a frame" in (error := capsys.readouterr().err)
    assert error.startswith("lidarsim: ")
    assert error.count("\n") == 1
    assert not Path("scan.pcd").exists()


def stl(path: Path, *size: float) -> None:
    """Write a box of this size that stands on the ground."""
    made = trimesh.creation.box(size)
    made.apply_translation((0.0, 0.0, size[2] / 2))
    made.export(path)


@pytest.mark.parametrize(
    ("size", "scale", "question"),
    [
        ((4200, 1800, 1500), 1.0, "car.stl: 4,200 × 1,800 × 1,500 m; mm?"),
        ((0.042, 0.018, 0.015), 1.0, "car.stl: 0.042 × 0.018 × 0.015 m; is it in m?"),
        ((4200, 1800, 1500), 0.001, ""),
        ((4.2, 1.8, 1.5), 1.0, ""),
        ((2000, 3000, 150), 1.0, ""),  # a town
        ((30e3, 30e3, 900), 1.0, "car.stl: 30,000 × 30,000 × 900 m; mm?"),
    ],
)
@pytest.mark.parametrize("placed", ["mesh", "scene_file", "scattered"])
@pytest.mark.filterwarnings("default")
def test_a_model_of_an_unlikely_size_is_asked_about(
    placed: str, size: tuple[float, float, float], scale: float, question: str, capsys: pytest.CaptureFixture[str]
) -> None:
    stl(Path("car.stl"), *size)
    shape = f"{{shape: {'scene_file' if placed == 'scene_file' else 'mesh'}, file: car.stl"
    ground = "{shape: plane, normal: [0, 0, 1], distance_m: -1, name: ground}"
    sensor = "sensor: {pattern: {type: grid, azimuths_deg: [0], elevations_deg: [-5], rate_hz: 10}}\n"
    if placed == "scattered":
        group = f"cars: {{count: 1, on: [ground], area_m: [[9, -1], [11, 1]], scale: {scale}, objects: [{shape}}}]}}"
        text = f"run: {{scene: [{ground}], {sensor.strip()}}}\nlayout: shards\nsequences: 1\nframes: 1\n"
        Path("run.yaml").write_text(f"{text}scatter: {{{group}}}\n", encoding="utf-8")
    else:
        Path("run.yaml").write_text(f"scene: [{ground}, {shape}, scale: {scale}}}]\n{sensor}", encoding="utf-8")
    assert lidarsim("check", "run.yaml") == 0
    printed, asked = capsys.readouterr()
    assert asked == (f"lidarsim: warning: {question}\n" if question else "")
    if placed != "scattered":
        assert " × ".join(f"{length * scale:,.6g}" for length in size) in printed
