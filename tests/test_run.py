"""A configured run in Python writes the same files as the command line."""

from __future__ import annotations

import dataclasses
import re
import tracemalloc
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.errors import ConfigError, FileFormatError, LidarsimError
from lidarsim.run import RunFrame
from tests.io.packets.captures import datagrams

RUN = """\
seed: 3
frames: 3
sensor: {pattern: {type: grid, azimuths_deg: [-2, 0, 2], elevations_deg: [-1, 1], rate_hz: 10}}
pose: {position_m: [0, 0, 1], linear_m_per_s: [5, 0, 0]}
scene: [{shape: sphere, center_m: [20, 0, 1], radius_m: 5}]
"""
RIG = RUN.replace("sensor:", "rig: {top: {sensor:").replace(
    "}}\npose", "}}}, low: {sensor: {preset: sick-lms111}}}\npose"
)


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.yaml").write_text(RUN, encoding="utf-8")
    Path("rig.yaml").write_text(RIG, encoding="utf-8")


@pytest.mark.parametrize("config", ["run.yaml", "rig.yaml"])
@pytest.mark.parametrize("suffix", ["pcd", "npz", "mcap"])
def test_python_writes_what_the_command_line_writes(config: str, suffix: str) -> None:
    for folder in ("python", "cli"):
        Path(folder).mkdir()
    written = ls.config.load(config).write(f"python/a.{suffix}")
    with pytest.raises(SystemExit) as end:
        main(["scan", config, "-o", f"cli/a.{suffix}"])
    assert end.value.code == 0
    assert sorted(written) == sorted(Path("python").iterdir())
    names = [path.name for path in written]
    assert names == [path.name for path in written if Path("cli", path.name).is_file()]
    several = {"run.yaml": 5, "rig.yaml": 3 + 2 * 2}  # three clouds, poses and times; of the rig for each sensor
    least = 1 if suffix == "mcap" else several[config]
    assert len(names) >= least
    for path in written:
        if suffix != "mcap":  # a bag holds the time at which it was written
            assert path.read_bytes() == Path("cli", path.name).read_bytes()


def test_frames_are_repeated_once_the_slowest_sensor_has_had_its_own() -> None:
    assert ls.config.load("run.yaml").period == 0.3
    run = ls.config.load("rig.yaml")
    assert isinstance(run.sensor, ls.Rig)
    counts = {"top": 1, "low": 3}  # frames of 0.1 s and of 0.02 s
    assert run.sensor["low"].lidar.pattern.rate == 50.0
    for name, count in counts.items():
        assert sum(name in scans for scans in run.scans()) == count
    assert run.period == 0.1


TRIANGLE = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
5 -5 -5
5 5 -5
5 0 5
3 0 1 2
"""
MESH = RUN.replace("scene: [", "scene: [{shape: mesh, file: a_0002.ply}, ")
FROM_FILE = RUN.replace("{position_m: [0, 0, 1], linear_m_per_s: [5, 0, 0]}", "{file: drive_poses.tum}")
INCLUDED = "frames: 3\nsensor: {file: lidar.yaml}\nscene: {file: things_0001.pcd}\npose: {position_m: [0, 0, 1]}\n"


@pytest.mark.parametrize(
    ("config", "output", "at_risk"),
    [
        (FROM_FILE, "drive.pcd", "drive_poses.tum"),
        (FROM_FILE, "DRIVE.pcd", "DRIVE_poses.tum"),  # the same place on some systems
        (FROM_FILE, "linked.pcd", "linked_poses.tum"),
        (MESH, "a.ply", "a_0002.ply"),
        (MESH, "b.ply", "b_0001.ply"),  # a link
        (INCLUDED, "things.pcd", "things_0001.pcd"),
        (RUN.replace("scene: [", "scene: [{shape: surfels, file: bag/bag_0.mcap, neighbours: 3}, "), "bag/", "bag"),
    ],
)
def test_nothing_that_a_run_reads_is_replaced(
    config: str, output: str, at_risk: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Poses, meshes and documents: by way of files that the user did not name, and of links, too."""
    ls.Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1))).save("drive_poses.tum")
    ls.config.load("run.yaml", ["frames=1"]).write("bag/")
    Path("a_0002.ply").write_text(TRIANGLE, encoding="ascii")
    pattern, scene = (RUN.split(f"{key}: ", 1)[1].splitlines()[0] for key in ("pattern", "scene"))
    Path("lidar.yaml").write_text(f"pattern: {pattern[:-1]}\n", encoding="utf-8")
    Path("things_0001.pcd").write_text(scene, encoding="utf-8")
    Path("linked_poses.tum").symlink_to("drive_poses.tum")
    Path("b_0001.ply").symlink_to("a_0002.ply")
    Path("run.yaml").write_text(config, encoding="utf-8")
    run = ls.config.load("run.yaml")
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    with pytest.raises(LidarsimError, match=f"^{at_risk}: expected a file of its own, got that of .*, which the run "):
        run.write(output)
    with pytest.raises(SystemExit):
        main(["scan", "run.yaml", "-o", output])
    assert capsys.readouterr().err.startswith(f"lidarsim: {at_risk}: expected a file of its own, got that of /")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    run.write("new.npz")


def test_a_run_knows_all_that_it_read() -> None:
    Path("tri.obj").write_text("mtllib tri.mtl\nv 5 -5 -5\nv 5 5 -5\nv 5 0 5\nusemtl a\nf 1 2 3\n", encoding="ascii")
    Path("tri.mtl").write_text("newmtl a\nKd 1 1 1\n", encoding="ascii")
    item = "{shape: scene_file, file: tri.obj, reflectivity: color}"
    Path("run.yaml").write_text(RUN.replace("scene: [", f"scene: [{item}, "), encoding="utf-8")
    assert ls.config.load("run.yaml").sources == {Path(name).resolve() for name in ("run.yaml", "tri.obj", "tri.mtl")}


def test_no_cloud_replaces_the_samples_of_an_imu() -> None:
    """The third cloud of `low` has the name of the samples of the IMU `low_0002`."""
    imu = RIG.replace("rig: {", "rig: {low_0002: {imu: {rate_hz: 100}}, ", 1)
    Path("imu.yaml").write_text(imu, encoding="utf-8")
    before = {*Path().iterdir()}
    run = ls.config.load("imu.yaml")
    with pytest.raises(
        LidarsimError, match=r"^a_low_0002\.csv: expected a file of its own, got the place of a_low_0002"
    ):
        run.write("a.csv")
    assert {*Path().iterdir()} == before
    assert {*run.write("a.pcd")} <= {*run.files(Path("a.pcd"))}
    assert len(ls.ImuSamples.load("a_low_0002.csv").time) == 11


def test_samples_of_an_imu_are_written_beside_the_clouds_or_into_the_bag() -> None:
    Path("imu.yaml").write_text(RIG.replace("rig: {", "rig: {box: {imu: {rate_hz: 100}}, ", 1), encoding="utf-8")
    run = ls.config.load("imu.yaml")
    names = [path.name for path in run.write("a.pcd")]
    assert names == [path.name for path in run.files(Path("a.pcd"))][:1] + names[1:]
    samples = ls.ImuSamples.load("a_box.csv")
    assert names[0] == "a_box.csv"
    assert run.span == (0.0, 0.1)  # the first frame of one sensor, and three of the other, at 50 Hz
    np.testing.assert_array_equal(samples.time, np.arange(11) / 100)
    np.testing.assert_array_equal(samples.specific_force, np.tile([0, 0, 9.80665], (11, 1)))
    run.write("a.mcap")
    with Reader(Path("a.mcap")) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
    assert counts["/box/data_raw"] == 11
    assert counts["/low/points"] == 3


WITH_GNSS = "rig: {gnss: {gnss: {rate_hz: 20, position_sigma_m: 0.5}, position_m: [1, 0, 0.5]}, "
ORIGIN = "georeference={origin: {latitude_deg: 48, longitude_deg: 11, altitude_m: 500}}"


def test_fixes_of_a_receiver_are_written_beside_the_clouds_or_into_a_bag() -> None:
    Path("gnss.yaml").write_text(RIG.replace("rig: {", WITH_GNSS, 1), encoding="utf-8")
    run = ls.config.load("gnss.yaml", [ORIGIN])
    assert run.origin == (np.radians(48.0), np.radians(11.0), 500.0)
    assert list(run.sensor) == ["top", "low"]
    written = run.write("a.pcd")
    assert run.files(Path("a.pcd"))[0] == written[0] == Path("a_gnss.csv")
    fixes = ls.GnssFixes.load("a_gnss.csv")
    np.testing.assert_array_equal(fixes.time, [0.0, 0.05, 0.1])  # 0.1 s are three frames of the faster lidar
    (again,) = run.fixes().values()
    np.testing.assert_allclose(fixes.latitude, again.latitude, rtol=2 * 2.0**-52)
    assert run.write("drive/", max_duration=0.05)[0] == Path("drive")
    with Reader(Path("drive")) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert len(bag.storage.files) == 3  # the last has what is at 0.1 s
    assert counts["/gnss/fix"] == 3
    assert counts["/low/points"] == 3


def test_a_receiver_needs_a_georeference() -> None:
    Path("gnss.yaml").write_text(RIG.replace("rig: {", WITH_GNSS, 1), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"rig\.gnss\.gnss: expected a georeference with the origin or the crs of the"
    ):
        ls.config.load("gnss.yaml")
    run = dataclasses.replace(ls.config.load("gnss.yaml", [ORIGIN]), origin=None)
    expected = r"^georeference: expected the origin or crs of the world, for the receiver gnss, got none"
    with pytest.raises(ValueError, match=expected):
        run.write("a.pcd")
    assert not list(Path().glob("a*"))


@pytest.mark.parametrize(("config", "name"), [("run.yaml", "a_0000"), ("rig.yaml", "a_top_0000")])
def test_a_suffix_of_two_parts_is_kept(config: str, name: str) -> None:
    written = [path.name for path in ls.config.load(config).write("a.pcd.bin")]
    assert f"{name}.pcd.bin" in written
    assert {path.split(".", 1)[1] for path in written} == {"pcd.bin", "tum", "txt"}
    assert np.unique(ls.PointCloud.load(f"{name}.pcd.bin").ring).tolist() == [0, 1]


def test_each_frame_is_told_after_it_was_written() -> None:
    told: list[int] = []

    def tell(frame: RunFrame) -> None:
        assert Path(f"a_{frame.number:04}.npz").is_file()
        assert not Path(f"a_{frame.number + 1:04}.npz").exists()
        np.testing.assert_array_equal(ls.PointCloud.load(f"a_{frame.number:04}.npz").xyz, frame.clouds[""].xyz)
        told.append(frame.number)

    ls.config.load("run.yaml").write("a.npz", each=tell)
    assert told == [0, 1, 2]


def test_coverage_is_checked_by_name_and_before_work() -> None:
    short = ls.Trajectory([0.0, 0.1], [np.eye(4)] * 2)
    run = dataclasses.replace(ls.config.load("run.yaml"), pose=short)
    with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses, got one from 0\.0 to 0\.1 s"):
        run.check_coverage()
    with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses"):
        run.write("a.npz")
    assert not list(Path().glob("a*"))
    ls.config.load("run.yaml").check_coverage()


GEOREFERENCE = "georeference={crs: EPSG:25832, start: 2026-05-01T10:00:00+02:00}"


def test_las_files_of_a_run_are_on_one_clock_and_in_one_system(tmp_path: Path) -> None:
    run = ls.config.load("run.yaml", ["cloud.frame=world", GEOREFERENCE])
    written = [path for path in run.write(tmp_path / "a.laz") if path.suffix == ".laz"]
    files = [laspy.read(path) for path in written]
    # GPS time is ahead of UTC by 18 s since 2017.
    zero = (datetime(2026, 5, 1, 8, tzinfo=UTC) - datetime(1980, 1, 6, tzinfo=UTC)).total_seconds() + 18 - 1e9
    for k, (file, scan) in enumerate(zip(files, run.scans(), strict=True)):
        assert file.header.parse_crs().to_epsg() == 25832
        np.testing.assert_array_equal(file.gps_time, zero + (scan[""].point_cloud().time + k / 10))
        assert len(file.gps_time) >= 4
    assert all(a.gps_time.max() < b.gps_time.min() for a, b in pairwise(files))
    run.write(tmp_path / "a.npz")
    assert ls.PointCloud.load(tmp_path / "a_0002.npz").time.max() < 1 / 10  # since the start of the scan, as ever


def test_las_files_in_the_sensor_frame_have_no_system_though_a_receiver_needs_one() -> None:
    Path("gnss.yaml").write_text(RIG.replace("rig: {", WITH_GNSS, 1), encoding="utf-8")
    run = ls.config.load("gnss.yaml", [GEOREFERENCE, "pose={position_m: [691000, 5334000, 520]}"])
    written = [path for path in run.write("a.las") if path.suffix == ".las"]
    assert len(written) == 4
    assert all(laspy.read(path).header.parse_crs() is None for path in written)


def test_an_imu_drives_along_a_way_on_a_spline() -> None:
    Path("way.yaml").write_text(
        "rig: {top: {sensor: {preset: velodyne-vlp16}}, imu: {imu: {rate_hz: 100}}}\n"
        "scene: {street: {kind: rural, length_m: 100}}\npose: {way: lanes, speed_m_per_s: 8}\nframes: 5\n",
        encoding="utf-8",
    )
    linear, spline = (ls.config.load("way.yaml", [f"pose.interpolation={name}"]) for name in ("linear", "spline"))
    with pytest.raises(ValueError, match="expected one of continuous velocity"):
        linear.samples()
    assert len(spline.samples()["imu"].time) > 50
    times = np.linspace(0, 0.5, 51)
    a, b = (run.pose.at(times).translation for run in (linear, spline) if isinstance(run.pose, ls.Trajectory))
    assert np.abs(a - b).max() < 0.05


@pytest.mark.parametrize("number", [0, 1])
def test_a_sensor_on_a_way_looks_ahead(number: int) -> None:
    """And the other way in the lane of the other direction."""
    Path("way.yaml").write_text(
        "sensor: {preset: velodyne-vlp16}\nscene: {street: {kind: rural, length_m: 100}}\n"
        f"pose: {{way: lanes, number: {number}, start_m: 3.5, speed_m_per_s: 8}}\nframes: 5\n",
        encoding="utf-8",
    )
    pose = ls.config.load("way.yaml").pose
    assert isinstance(pose, ls.Trajectory)
    poses = pose.at(np.linspace(*pose.span, 40)).as_matrix()
    steps = np.diff(poses[:, :3, 3], axis=0)
    assert (np.sign(steps[:, 0]) == (-1.0) ** number).all()
    ahead = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    # Within a step of 2.5 m the course turns by less than 3°.
    assert ((poses[:-1, :3, 0] * ahead).sum(axis=1) > np.cos(np.radians(3.0))).all()
    # Without roll, but for the product of turn and pitch between two points, each below 0.05 rad · m⁻¹, over eight.
    np.testing.assert_allclose(poses[:, 2, 1], 0.0, atol=0.05**2 / 8)


def test_bags_and_packets_of_a_run_are_on_its_clock(tmp_path: Path) -> None:
    """Unix time, unlike GPS time, does not count the 18 leap seconds since 1980."""
    zero = 1_777_622_400 * 10**9 + 1000  # `date -u -d 2026-05-01T08:00:00 +%s`, and 1 µs
    start = "georeference.start=2026-05-01T10:00:00.000001+02:00"
    Path("gnss.yaml").write_text(RIG.replace("rig: {", WITH_GNSS, 1), encoding="utf-8")
    ls.config.load("gnss.yaml", [ORIGIN, start]).write(tmp_path / "a.mcap")
    ros, stamps, recorded = get_typestore(Stores.ROS2_JAZZY), dict[str, list[int]](), set[int]()
    with Reader(tmp_path / "a.mcap") as bag:
        for connection, time, data in bag.messages():
            recorded.add(time - zero)
            if connection.topic in {"/low/points", "/gnss/fix", "/clock"}:
                message: Any = ros.deserialize_cdr(data, connection.msgtype)
                stamp = message.clock if connection.topic == "/clock" else message.header.stamp
                stamps.setdefault(connection.topic, []).append(stamp.sec * 10**9 + stamp.nanosec - zero)
    assert stamps["/low/points"] == [0, 20_000_000, 40_000_000]
    track = ls.Trajectory.load(tmp_path / "a_low_poses.tum")
    assert np.abs(track.times - zero * 1e-9 - [0, 0.02, 0.04]).max() < 1e-6
    assert stamps["/gnss/fix"] == [0, 50_000_000, 100_000_000]
    assert stamps["/clock"] == list(range(0, 100_000_001, 10_000_000))
    assert min(recorded) == 0
    assert max(recorded) == 100_000_000

    run = ls.config.load("run.yaml", ["sensor={preset: ouster-os1-64}", "frames=1", start])
    run.write(tmp_path / "a.pcap")
    first = next(datagrams(tmp_path / "a.pcap")).payload
    assert int.from_bytes(first[32:40], "little") == zero  # time stamp of the first column
    undated = dataclasses.replace(run, start=12.5)  # seconds on a clock of one's own
    assert undated.clock == datetime(2020, 1, 1, tzinfo=UTC)


def test_options_of_the_files(tmp_path: Path) -> None:
    run = ls.config.load("run.yaml", ["frames=1"])
    run.write(tmp_path / "a.ply", fields=["label"], float32=True)
    assert ls.PointCloud.load(tmp_path / "a.ply").fields == ("xyz", "label")
    assert b"property float32 x" in (tmp_path / "a.ply").read_bytes()[:2000]
    with pytest.raises(ValueError, match=r"^float32: expected a point cloud file as output, got the bag .*a\.mcap$"):
        run.write(tmp_path / "a.mcap", float32=True)
    assert not (tmp_path / "a.mcap").exists()


STRIPS = """\
sensor:
  pattern: {type: oscillating_mirror, field_of_view_deg: 40, scan_rate_hz: 20, pulse_rate_khz: 1, rate_hz: 2, turn: 0.2}
pose:
  strips:
    {area_m: [611000, 5264000, 611400, 5264500], height_m: 400, speed_m_per_s: 60, overlap: 0.3, field_of_view_deg: 40,
     turn_s: 29.9, heading_deg: 90}
  rotation_deg: {pitch: 90}
cloud: {frame: world}
georeference: {crs: "EPSG:25832", start: "2026-05-01T10:00:00+02:00"}
scene: [{shape: plane, normal: [0, 0, 1], label: 2}]
"""


@pytest.fixture
def strips() -> Path:
    path = Path("strips.yaml")
    path.write_text(STRIPS, encoding="utf-8")
    return path


def test_each_strip_is_one_las_file(strips: Path) -> None:
    run = ls.config.load(strips)
    written = run.write("flight.laz")
    assert [path.name for path in written] == [
        *("flight_1.laz", "flight_2.laz"),
        *("flight_poses.tum", "flight_times.txt"),
    ]
    plan = ls.Trajectory.strips(
        (611_000, 5_264_000, 611_400, 5_264_500),
        height=400,
        speed=60,
        overlap=0.3,
        field_of_view=np.radians(40),
        turn=29.9,
        heading=np.pi / 2,
        margin=30,
    )
    # GPS time is ahead of UTC by 18 s since 2017.
    zero = (datetime(2026, 5, 1, 8, tzinfo=UTC) - datetime(1980, 1, 6, tzinfo=UTC)).total_seconds() + 18 - 1e9
    seen = []
    for number, (path, strip) in enumerate(zip(written, plan, strict=False), 1):
        file = laspy.read(path)
        assert file.header.parse_crs().to_epsg() == 25832
        assert (file.point_source_id == number).all()
        time = file.gps_time - zero
        assert strip.span[0] <= time.min() < strip.span[0] + 0.5
        assert strip.span[1] - 0.5 - 1e-3 < time.max() <= strip.span[1]
        # The oracle: the place of the aircraft and of the point, which lies in the plane z = 0 below it.
        ahead = 1 if number % 2 else -1
        offset = (file.x - strip.at(time).translation[:, 0]) * ahead  # to the right of the flight
        angle = np.degrees(np.arctan2(offset, 400))
        assert np.abs(file.scan_angle * 0.006 - angle).max() < 0.0031  # half a step, and 0.1 mm at 400 m
        assert np.abs(angle).max() > 19
        # A line takes 25 pulses; the flag of its direction is that of the swing, and its last pulse is at an end.
        ends = np.flatnonzero(file.edge_of_flight_line)
        assert len(ends) > len(time) / 25 * 0.9
        assert np.abs(angle[ends]).min() > 19
        same = np.diff(time) < 1.5e-3
        grows = np.diff(angle) > 0
        flag = np.asarray(file.scan_direction_flag).astype(bool)
        inner = same & (np.asarray(file.edge_of_flight_line)[:-1] == 0)
        assert (flag[:-1] == grows)[inner].all()
        assert 0.45 < flag.mean() < 0.55
        seen.append(file)
    assert len(seen) == 2
    assert seen[0].gps_time.max() + 29 < seen[1].gps_time.min()
    every = np.concatenate([np.asarray(file.xyz) for file in seen])
    assert every[:, 1].min() <= 5_264_000
    assert every[:, 1].max() >= 5_264_500


def test_frames_of_strips_take_no_memory(strips: Path) -> None:
    """One digit too many in an area makes hundreds of millions of them."""
    speed = ["pose.strips.speed_m_per_s=0.00001"]
    tracemalloc.start()
    run = ls.config.load(strips, speed)
    assert len(run.numbers) > 100_000_000
    assert run.numbers[-1] == run.frames[-1]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 25


def test_frames_of_strips_go_on_and_their_noise_differs(strips: Path) -> None:
    run = ls.config.load(strips, ["sensor.measurement={range_sigma_m: 0.02}"])
    first, second = (leg.frames for leg in run.legs)
    assert first.stop < second.start
    assert list(run.numbers) == [*first, *second]
    assert run.numbers[-1] == second[-1]
    assert [run.numbers[k] for k in range(-len(run.numbers), len(run.numbers))] == 2 * [*run.numbers]
    assert run.numbers[1:-1] == list(run.numbers)[1:-1]
    with pytest.raises(IndexError):
        run.numbers[len(run.numbers)]
    assert run.frames == range(first.start, second.stop)
    found = [frame.scans[""] for frame in run.measured()]
    assert [scan.frame for scan in found] == list(run.numbers)
    assert [scan.time for scan in found] == [number / 2 for number in run.numbers]
    errors = [scan.range_error[:, 0] for scan in found]
    assert all(abs(np.corrcoef(errors[0], other)[0, 1]) < 0.2 for other in errors[1:])
    again = run.only(second[1]).scan()
    assert again.range.tolist() == found[len(first) + 1].range.tolist()
    with pytest.raises(ConfigError, match=f"^frame: expected one of a strip or a station, got {first.stop}"):
        run.only(first.stop)


BOX = "  box: {imu: {rate_hz: 10, gyroscope: {noise_density_deg_per_s_per_sqrt_hz: 0.1}}}"
ROOF = "  roof: {gnss: {rate_hz: 1, drift_sigma_m: 1}}"


def test_errors_of_an_imu_and_a_receiver_differ_between_strips(strips: Path) -> None:
    _, pattern, *others = strips.read_text(encoding="utf-8").splitlines()
    strips.write_text("\n".join(["rig:", f"  top: {{sensor: {{{pattern}}}}}", BOX, ROOF, *others]), encoding="utf-8")
    found = [part.samples() for part in ls.config.load(strips).parts]
    for name, field in (("box", "angular_rate"), ("roof", "altitude")):
        one, two = (getattr(samples[name], field) for samples in found)
        assert len(one) == len(two) >= 10
        assert abs(one - two).min() > 1e-7  # exact altitudes differ by rounding only


def test_a_trajectory_in_unix_time_is_named_as_the_mistake_of_a_rig_with_an_imu(tmp_path: Path) -> None:
    ls.Trajectory(1.75e9 + np.arange(10.0), np.tile(np.eye(4), (10, 1, 1)), interpolation="spline").save("unix.tum")
    path = "pose={file: unix.tum, interpolation: spline}"
    Path("gnss.yaml").write_text(RIG.replace("rig: {", f"rig: {{{BOX}, {ROOF}, ", 1), encoding="utf-8")
    run = ls.config.load("gnss.yaml", [ORIGIN, path])
    for work in (lambda: run.write(tmp_path / "a.mcap"), run.inertial, run.fixes):
        with pytest.raises(ValueError, match=r"^pose: expected a trajectory over all pulses.*start_s: 0"):
            work()


def test_errors_of_an_imu_and_a_receiver_differ_between_first_frames() -> None:
    Path("gnss.yaml").write_text(RIG.replace("rig: {", f"rig: {{{BOX}, {ROOF}, ", 1), encoding="utf-8")
    begin, again, later = (
        ls.config.load("gnss.yaml", [ORIGIN, "frames=2", f"first_frame={first}"]).samples() for first in (0, 0, 2)
    )
    for name, field in (("box", "angular_rate"), ("roof", "altitude")):
        one, same, other = (getattr(samples[name], field) for samples in (begin, again, later))
        np.testing.assert_array_equal(one, same)
        assert abs(one[0] - other[0]).min() > 1e-6  # exact altitudes differ by 0.1 µm, as the Earth is round


def test_other_formats_hold_a_frame_of_a_strip_each(strips: Path) -> None:
    run = ls.config.load(strips)
    written = [path.name for path in run.write("a.npz")]
    assert written[0] == "a_1_0000.npz"
    assert len(written) == len(run.numbers) + 2
    assert f"a_2_{run.legs[1].frames.start:04}.npz" in written
    assert [path.name for path in run.write("b.mcap")] == ["b_1.mcap", "b_2.mcap", "b_poses.tum", "b_times.txt"]


def test_the_command_line_counts_strips(strips: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["check"], ["scan", "-o", "c.las"]):
        with pytest.raises(SystemExit) as end:
            main([command[0], str(strips), *command[1:]])
        assert end.value.code == 0
    shown = capsys.readouterr().out
    assert "ok, 1 object, 2 strips, 36 frames" in shown
    assert "c_*.las" in shown
    assert sorted(path.name for path in Path().glob("c_*")) == ["c_1.las", "c_2.las", "c_poses.tum", "c_times.txt"]


STATIONS = RUN.replace(
    "pose: {position_m: [0, 0, 1], linear_m_per_s: [5, 0, 0]}",
    "pose: {position_m: [0, 0, 1.5], stations: [{position_m: [0, 1, 0]}, "
    "{position_m: [2, 0, 0], rotation_deg: {yaw: 5}}]}",
)


def test_each_station_is_a_cloud_at_its_pose() -> None:
    Path("stations.yaml").write_text(STATIONS, encoding="utf-8")
    run = ls.config.load("stations.yaml", ["frames=1", "first_frame=4"])
    assert [(leg.number, leg.frames) for leg in run.legs] == [(1, range(4, 5)), (2, range(5, 6))]
    assert np.asarray(run.legs[0].pose)[:3, 3].tolist() == [0, 1, 1.5]
    written = [path.name for path in run.write("s.pcd")]
    assert written == ["s_1.pcd", "s_2.pcd", "s_poses.tum", "s_times.txt"]
    truth = ls.Trajectory.load("s_poses.tum").poses.as_matrix()
    expected = np.eye(4)
    expected[:2, :2] = [[np.cos(np.radians(5)), -np.sin(np.radians(5))], [np.sin(np.radians(5)), np.cos(np.radians(5))]]
    expected[:3, 3] = 2, 0, 1.5
    assert np.abs(truth[1] - expected).max() < 1e-12
    clouds = [ls.PointCloud.load(f"s_{number}.pcd") for number in (1, 2)]
    assert all(len(cloud) == 6 for cloud in clouds)
    for cloud, pose in zip(clouds, truth, strict=True):
        distance = np.linalg.norm(cloud.transformed(pose).xyz - (20, 0, 1), axis=1)
        assert np.abs(distance - 5).max() < 1e-5  # float32
    assert len(run.write("t.pcd")) == 4
    several = ls.config.load("stations.yaml")
    assert [path.name for path in several.write("u.pcd")][2:5] == ["u_1_0002.pcd", "u_2_0003.pcd", "u_2_0004.pcd"]


def test_each_sensor_of_a_rig_scans_at_each_station() -> None:
    """One of 10 Hz begins no frame during most of those of one of 50 Hz."""
    rig = re.sub(r"pose: .*", "pose: {stations: [{}, {}, {}]}", RIG)
    Path("stations.yaml").write_text(rig, encoding="utf-8")
    for part in ls.config.load("stations.yaml", ["frames=5"]).parts:
        assert {name for scans in part.scans() for name in scans} == {"top", "low"}
    with pytest.raises(ConfigError, match=r"^--set frames=1: expected at least 5 frames at each station, so that top "):
        ls.config.load("stations.yaml", ["frames=1"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["frames=3"], "--set frames=3: expected none, since the strips are as long as their area"),
        (["pose.strips.overlap=1"], "expected a share from 0 to less than 1, got 1"),
        (["pose.strips.area_m=[[0, 0], [1, 1]]"], "at least 3 corners, got 2"),
        (["pose.strips.speed_m_per_s=-5"], "speed_m_per_s=-5: expected a finite number > 0, got -5"),
        (["sensor.pattern.rate_hz=0.01", "pose.strips.margin_m=0"], "expected strips of a frame, 100 s, got one of 8."),
        (["pose.strips.speed_m_per_s=1.0e-200"], "pose.strips: expected at most 4294967296 frames, got 1"),
        (["pose.strips.turn_s=1.0e+300"], "expected strips whose times differ"),
        (["pose.stations=[]"], "pose.*"),
    ],
)
def test_flights_that_cannot_be(strips: Path, changes: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message).replace(r"\.\*", ".*")):
        ls.config.load(strips, changes)


def test_sensors_of_a_rig_have_a_file_a_strip_each(strips: Path) -> None:
    text = STRIPS.replace(
        "sensor:\n  pattern:", "rig:\n  a: {rotation_deg: {pitch: 5}, offset_s: 0.2, sensor: {pattern:", 1
    )
    text = text.replace("turn: 0.2}\n", "turn: 0.2}}}\n", 1)
    strips.write_text(text, encoding="utf-8")
    run = ls.config.load(strips)
    run.check_coverage()
    assert [path.name for path in run.write("r.laz")][:2] == ["r_1_a.laz", "r_2_a.laz"]
    assert (laspy.read("r_2_a.laz").point_source_id == 2).all()


def test_each_sensor_of_a_rig_sees_the_area_from_end_to_end(strips: Path) -> None:
    """Whatever the rates and offsets: whole frames of each sensor begin before the area and end behind it."""
    _, pattern, *others = strips.read_text(encoding="utf-8").splitlines()
    slow = pattern.replace("rate_hz: 2,", "rate_hz: 0.3,")
    rig = [
        "rig:",
        f"  a: {{sensor: {{{pattern}}}, offset_s: -0.3}}",
        f"  b: {{sensor: {{{slow}}}}}",
        f"  c: {{sensor: {{{pattern.replace('rate_hz: 2,', 'rate_hz: 0.7,')}}}, offset_s: 0.4}}",
    ]
    strips.write_text("\n".join([*rig, *others]), encoding="utf-8")
    run = ls.config.load(strips)
    assert len(run.parts) == 2
    for part in run.parts:
        assert isinstance(part.pose, ls.Trajectory)
        seen: dict[str, list[float]] = {}
        for scans in part.scans():
            for name, scan in scans.items():
                seen.setdefault(name, []).extend((scan.time, scan.time + 1 / scan.lidar.pattern.rate))
        assert set(seen) == {"a", "b", "c"}
        for times in seen.values():
            y = part.pose.at([min(times), max(times)]).translation[:, 1]
            assert y.min() <= 5_264_000
            assert y.max() >= 5_264_500
    with pytest.raises(ConfigError, match=r"expected strips of a frame, 10 s, got one of 8\.33333"):
        ls.config.load(strips, ["rig.b.sensor.pattern.rate_hz=0.1", "rig.a.offset_s=0", "pose.strips.margin_m=0"])


def test_a_strip_in_las_is_in_the_world(strips: Path) -> None:
    run = ls.config.load(strips, ["cloud.frame=sensor", "georeference={}"])
    with pytest.raises(FileFormatError, match=r"^d_1.las: expected points in the world, with cloud.frame: world"):
        run.write("d.las")
    with pytest.raises(ValueError, match=r"^float32: expected a format with float32 coordinates"):
        ls.config.load(strips).write("d.las", float32=True)
    assert not list(Path().glob("d*"))
    ls.config.load(strips).write("e.las", fields=["intensity", "scan_angle"])
    assert np.asarray(laspy.read("e_1.las").scan_angle).any()
    assert "range" not in laspy.read("e_1.las").point_format.extra_dimension_names


CONFIGS = Path(__file__).parents[1] / "configs"


def test_the_strips_over_the_valley_leave_no_gap() -> None:
    run = ls.config.load(CONFIGS / "airborne.yaml", ["sensor.pattern.pulse_rate_khz=5"])
    assert len(run.legs) == 3
    box = (612_000, 5_264_000, 613_200, 5_264_700)
    strips = []
    for part in run.parts:
        clouds = [frame.clouds[""] for frame in part.measured()]
        cells = ls.PointCloud.concatenate([cloud for cloud in clouds if len(cloud)]).raster(
            cell=50, statistic="count", bounds=box
        )
        strips.append(np.nan_to_num(np.asarray(cells.values)) > 0)
    covered = np.sum(strips, axis=0)
    # The lake is the only hole: of its cells of 50 m, few lie in it as a whole.
    assert (covered == 0).sum() <= 12
    assert (covered >= 2).mean() > 0.25


def test_the_stations_in_the_courtyard_stand_in_the_open() -> None:
    run = ls.config.load(CONFIGS / "terrestrial.yaml", ["sensor.pattern.columns=72", "sensor.pattern.rate_hz=1"])
    assert len(run.legs) == 3
    for frame in run.measured():
        scan = frame.scans[""]
        assert not (scan.status == ls.Status.below_min_range).any()
        assert (scan.status == ls.Status.hit).mean() > 0.25


def test_strips_do_not_fit_by_the_boresight_error_put_in(strips: Path) -> None:
    """Strips flown to and fro tilt against each other, by twice an error of the roll."""
    roll, plan = 2e-3, {"height": 400, "speed": 60, "overlap": 0.3, "field_of_view": np.radians(40)}
    bodies = ls.Trajectory.strips((611_000, 5_264_000, 611_400, 5_264_500), **plan, turn=29.9, margin=30)
    run = ls.config.load(strips, ["pose.strips.heading_deg=0", "sensor.pattern.pulse_rate_khz=10"])
    down = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    points = []
    for part, body in zip(run.parts[:2], bodies[:2], strict=True):
        believed = body.perturbed(boresight=(roll, 0, 0)) @ down
        clouds = [frame.scans[""].point_cloud("world", pose=believed) for frame in part.measured()]
        points.append(np.concatenate([cloud.xyz for cloud in clouds]))
    # Of each, height over y in the overlap. On flat ground the true difference is 0.
    low = max(xyz[:, 1].min() for xyz in points)
    high = min(xyz[:, 1].max() for xyz in points)
    assert high - low > 50
    slopes = []
    for xyz in points:
        within = (xyz[:, 1] > low) & (xyz[:, 1] < high)
        slopes.append(np.polyfit(xyz[within, 1] - low, xyz[within, 2], 1)[0])
    assert slopes[0] - slopes[1] == pytest.approx(2 * roll, rel=1e-3)
