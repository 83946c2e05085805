"""Bags in folders, as ROS's recorder makes them, read by rosbags through their metadata."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io import rosbag

DRIVE = ls.Trajectory.from_twist(np.eye(4), (5, 0, 0), (0, 0, 0.1))
LIDAR = ls.Lidar(ls.patterns.Grid(np.linspace(-1, 1, 20), np.linspace(-0.3, 0.0, 10), rate=10.0))
MUNICH = ls.Georeference(origin=(0.84, 0.2, 500.0))


def scene() -> ls.Scene:
    made = ls.Scene()
    made.add(ls.Plane((0, 0, 1), -1.0))
    return made


def rig() -> ls.Rig:
    noisy = ls.Imu(200.0, accelerometer=ls.ImuErrors(noise_density=0.01))
    return ls.Rig({"top": (LIDAR, None), "imu": (noisy, None), "gnss": (ls.Gnss(10.0, position_sigma=1.0), None)})


def write(path: Path | str, frames: int = 20, **options: Any) -> None:
    sensors, end = rig(), frames / 10
    with rosbag.Writer(path, sensors=sensors, trajectory=DRIVE, **options) as bag:
        bag.write_imu(sensors.inertial(DRIVE, end=end)["imu"])
        bag.write_gnss(sensors.fixes(DRIVE, MUNICH, end=end)["gnss"])
        for scans in sensors.frames(scene(), DRIVE, frames):
            bag.write(scans)


def information(folder: Path) -> dict[str, Any]:
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def test_a_folder_is_what_the_recorder_makes(tmp_path: Path) -> None:
    write(tmp_path / "drive")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["drive", "drive_0.mcap", "metadata.yaml"]
    about = information(tmp_path / "drive")
    # Keys of rosbag2_storage's metadata, version 8.
    assert set(about) == {
        "version", "storage_identifier", "relative_file_paths", "duration", "starting_time", "message_count",
        "topics_with_message_count", "compression_format", "compression_mode", "files", "custom_data", "ros_distro",
    }  # fmt: skip
    assert (about["version"], about["storage_identifier"]) == (8, "mcap")
    counts = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in about["topics_with_message_count"]}
    # Clock and poses come at 100 Hz from 0 to 2 s, with the last sample of the IMU.
    often = {"/clock": 201, "/tf": 201, "/odom": 201, "/imu/data_raw": 401}
    assert counts == {"/tf_static": 1, **often, "/gnss/fix": 21, "/top/points": 20}
    assert about["message_count"] == sum(counts.values())
    with Reader(tmp_path / "drive") as bag:
        assert bag.message_count == about["message_count"]
        assert sum(1 for _ in bag.messages(bag.connections)) == about["message_count"]
        assert bag.duration == 2 * 10**9 + 1


@pytest.mark.parametrize("limits", [{"max_duration": 0.5}, {"max_size": 100_000}])
def test_split_files_follow_one_another_and_hold_the_same_messages(limits: dict[str, Any], tmp_path: Path) -> None:
    write(tmp_path / "whole")
    write(f"{tmp_path}/parts/", **limits)
    about = information(tmp_path / "parts")
    names = [f"parts_{number}.mcap" for number in range(len(about["files"]))]
    assert about["relative_file_paths"] == names == [file["path"] for file in about["files"]]
    assert sorted(os.listdir(tmp_path / "parts")) == sorted(["metadata.yaml", *names])  # noqa: PTH208
    assert len(names) >= 4
    end = -1
    for file in about["files"]:
        with Reader(tmp_path / "parts" / file["path"]) as bag:
            read = [(connection.topic, stamp, len(data)) for connection, stamp, data in bag.messages(bag.connections)]
        start = file["starting_time"]["nanoseconds_since_epoch"]
        assert end <= start == read[0][1]
        end = start + file["duration"]["nanoseconds"]
        assert end == read[-1][1]
        assert len(read) == file["message_count"]
        assert read[0][0] == "/tf_static"  # latched: each file has it
        if "max_duration" in limits:
            assert end - start < 5 * 10**8
        else:
            assert sum(size for *_, size in read[:-1]) < 100_000
    contents: dict[str, list[tuple[str, int, bytes]]] = {}
    for name in ("whole", "parts"):
        with Reader(tmp_path / name) as bag:
            messages = [
                (connection.topic, stamp, bytes(data)) for connection, stamp, data in bag.messages([*bag.connections])
            ]
        contents[name] = sorted(message for message in messages if message[0] != "/tf_static")
        stamps = [stamp for _, stamp, _ in messages]
        assert stamps == sorted(stamps)
    assert contents["whole"] == contents["parts"]
    ours = [(message.stamp, len(message.cloud)) for message in rosbag.read(tmp_path / "parts")]
    assert ours == [(message.stamp, len(message.cloud)) for message in rosbag.read(tmp_path / "whole")]
    assert len(ours) == 20


def test_the_high_level_reader_opens_a_folder(tmp_path: Path) -> None:
    write(tmp_path / "drive", 5, max_duration=0.2)
    with AnyReader([tmp_path / "drive"], default_typestore=get_typestore(Stores.LATEST)) as bag:
        kinds = {connection.topic: connection.msgtype for connection in bag.connections}
        assert kinds["/gnss/fix"] == "sensor_msgs/msg/NavSatFix"
        assert kinds["/imu/data_raw"] == "sensor_msgs/msg/Imu"
        (first, *_) = [
            bag.deserialize(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic == "/gnss/fix"
        ]
    fixes = rig().fixes(DRIVE, MUNICH, end=0.5)["gnss"]
    assert (first.latitude, first.longitude) == (np.degrees(fixes.latitude[0]), np.degrees(fixes.longitude[0]))
    assert first.altitude == fixes.altitude[0]
    assert first.position_covariance.tolist() == np.eye(3).ravel().tolist()
    assert (first.position_covariance_type, first.status.status, first.status.service) == (2, 0, 1)
    assert first.header.frame_id == "gnss"


def test_a_folder_of_ours_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    write(tmp_path / "drive", 6, max_duration=0.2)
    assert len(information(tmp_path / "drive")["files"]) >= 3
    write(tmp_path / "drive", 2)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["drive", "drive_0.mcap", "metadata.yaml"]


def foreign(folder: Path, case: str) -> None:
    if case == "recorded":
        with BagWriter(folder, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
            store = get_typestore(Stores.ROS2_HUMBLE)
            topic = bag.add_connection("/a", "std_msgs/msg/String", typestore=store)
            string = store.types["std_msgs/msg/String"]("hello")
            bag.write(topic, 1, store.serialize_cdr(string, "std_msgs/msg/String"))
        return
    write(folder, 2)
    if case == "a note":
        (folder / "notes.txt").write_text("mine")
    elif case == "a folder":
        (folder / "mine").mkdir()
    elif case == "a link":
        (folder / "drive_0.mcap").rename(folder.parent / "elsewhere.mcap")
        (folder / "drive_0.mcap").symlink_to(folder.parent / "elsewhere.mcap")
    else:
        (folder / "metadata.yaml").write_text("[" * 5000)


@pytest.mark.parametrize("case", ["recorded", "a note", "a folder", "a link", "damaged"])
def test_nothing_foreign_is_removed(case: str, tmp_path: Path) -> None:
    foreign(tmp_path / "drive", case)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(
        OSError, match=r"drive: expected a new folder, or one with a bag that lidarsim wrote, got one with '"
    ):
        write(tmp_path / "drive", 2)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_what_appears_in_the_folder_meanwhile_stays(tmp_path: Path) -> None:
    write(tmp_path / "drive", 2)

    def write_beside_another_file() -> None:
        with rosbag.Writer(tmp_path / "drive") as bag:
            bag.write(LIDAR.scan(scene()))
            (tmp_path / "drive/late.txt").write_text("mine")

    with pytest.raises(OSError, match=r"got one with 'late\.txt'"):
        write_beside_another_file()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["drive", "drive_0.mcap", "late.txt", "metadata.yaml"]


def test_an_error_leaves_no_folder(tmp_path: Path) -> None:
    def failing() -> None:
        with rosbag.Writer(tmp_path / "drive", max_duration=0.01) as bag:
            bag.write(LIDAR.scan(scene()))
            bag.write(LIDAR.scan(scene(), time=0.1, frame=1))
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        failing()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("path", "options", "problem"),
    [
        ("drive.mcap", {"max_size": 10}, "max_size: expected a folder as the path, with a name that has no dot"),
        ("drive.mcap", {"max_duration": 1.0}, "max_duration: expected a folder as the path"),
        ("drive", {"max_size": 0}, "max_size: expected an integer >= 1, got 0"),
        ("drive", {"max_size": 1.5}, "max_size: expected an integer >= 1, got 1.5"),
        ("drive", {"max_duration": 0.0}, "max_duration: expected a finite number > 0, got 0.0"),
        ("a.b/", {}, "a.b/: expected the name of a folder for a bag, without a dot"),
        ("/", {}, "/: expected the name of a folder for a bag, without a dot"),
        ("gone/drive", {}, "gone/drive: the folder gone does not exist"),
        ("file", {}, "file: expected the name of a folder for a bag, got a file"),
    ],
)
def test_bad_folders(
    path: str, options: dict[str, Any], problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    with pytest.raises((ValueError, TypeError, OSError)) as caught:
        rosbag.Writer(path, **options)
    assert str(caught.value).startswith(problem)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("- 1", "its metadata.yaml has no rosbag2_bagfile_information"),
        ("a: &a [*a]", "its metadata.yaml has no rosbag2_bagfile_information"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "its metadata.yaml lists no files"),
        ("rosbag2_bagfile_information: {relative_file_paths: [3]}", "its metadata.yaml lists 3, expected the name of"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [../x]}",
            "its metadata.yaml lists '../x', expected the name",
        ),
        ("rosbag2_bagfile_information: {relative_file_paths: [/etc/passwd]}", "lists '/etc/passwd', expected the name"),
        ("rosbag2_bagfile_information: {relative_file_paths: ['..']}", "lists '..', which is no file in it"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [link.mcap]}",
            "lists 'link.mcap', which is no file in it",
        ),
        ("rosbag2_bagfile_information: {relative_file_paths: [b.mcap]}", "lists 'b.mcap', which is no file in it"),
        ("#" * (1 << 20) + "\n", "its metadata.yaml is longer than 1,048,576 bytes"),
    ],
)
def test_hostile_metadata(text: str, problem: str, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    (tmp_path / "secret.mcap").touch()
    (folder / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(FileFormatError) as caught:
        next(rosbag.read(folder))
    assert problem in str(caught.value)
    assert str(folder) in str(caught.value)


def test_a_folder_without_metadata(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"metadata\.yaml"):
        next(rosbag.read(tmp_path))
