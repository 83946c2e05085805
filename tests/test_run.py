"""A configured run in Python writes the same files as the command line."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import laspy
import numpy as np
import pytest
from rosbags.rosbag2 import Reader

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.errors import FileFormatError
from lidarsim.run import RunFrame

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


def test_samples_of_an_imu_are_written_beside_the_clouds_or_into_the_bag() -> None:
    Path("imu.yaml").write_text(RIG.replace("rig: {", "rig: {box: {imu: {rate_hz: 100}}, ", 1), encoding="utf-8")
    run = ls.config.load("imu.yaml")
    names = [path.name for path in run.write("a.pcd")]
    assert names == [path.name for path in run.files_of_a_frame(Path("a.pcd"))][:1] + names[1:]
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


def test_options_of_the_files(tmp_path: Path) -> None:
    run = ls.config.load("run.yaml", ["frames=1"])
    run.write(tmp_path / "a.ply", fields=["label"], float32=True)
    assert ls.PointCloud.load(tmp_path / "a.ply").fields == ("xyz", "label")
    assert b"property float32 x" in (tmp_path / "a.ply").read_bytes()[:2000]
    with pytest.raises(
        FileFormatError, match=r"^float32: expected a point cloud file as output, got the bag .*a\.mcap$"
    ):
        run.write(tmp_path / "a.mcap", float32=True)
    assert not (tmp_path / "a.mcap").exists()
