"""Bags of several sensors: frames of all of them, each placed by its mount."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.datasets.reading import Frame, open_frames
from lidarsim.errors import FileFormatError
from lidarsim.io import rosbag

LEFT = RigidTransform.from_components([0.5, 1.0, 0.25], Rotation.from_euler("zy", [0.7, 0.2])).as_matrix()
RIGHT = RigidTransform.from_components([-0.5, -1.0, 0.5], Rotation.from_euler("zx", [-1.3, 0.1])).as_matrix()


def rig(*, slow: float = 10.0, offset: float = 0.0) -> ls.Rig:
    quick, late = (ls.patterns.Spinning([-0.2, 0.0], columns=60, rate=rate) for rate in (10.0, slow))
    models = ls.Lidar(quick, model="ouster-os1-64"), ls.Lidar(late, model="velodyne-vlp16")
    return ls.Rig({"left": (models[0], LEFT), "right": (models[1], RIGHT, offset)})


def room() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 7.0))
    return scene


def bag(path: Path, sensors: ls.Rig, count: int = 3) -> list[dict[str, ls.Scan]]:
    scans = list(sensors.frames(room(), None, count))
    with rosbag.Writer(path, sensors=sensors) as writer:
        for frame in scans:
            writer.write(frame)
    return scans


def read(path: Path, first: int = 0) -> list[Frame]:
    return list(open_frames(path).read(first))


@pytest.mark.parametrize("suffix", rosbag.SUFFIXES)
def test_clouds_fit_together(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive{suffix}"
    scans = bag(path, rig())
    found = open_frames(path)
    assert found.note == "2 topics (/left/points, /right/points) in base_link"
    frames = list(found.read(0))
    assert len(frames) == 3
    for frame, given in zip(frames, scans, strict=True):
        assert isinstance(frame.cloud, dict)
        assert list(frame.cloud) == ["/left/points", "/right/points"]
        for name in ("left", "right"):
            placed = frame.cloud[f"/{name}/points"].xyz
            # On the sphere around the body; float32 of coordinates below 2^3 m is within 2^-21 m of each of them.
            assert len(placed) == 120
            np.testing.assert_allclose(np.linalg.norm(placed, axis=1), 7.0, rtol=0, atol=np.sqrt(3) * 2.0**-21)
            expected = given[name].point_cloud("world").xyz
            np.testing.assert_allclose(placed, expected, rtol=0, atol=3 * 2.0**-21)


def test_one_topic_stays_in_its_own_frame(tmp_path: Path) -> None:
    sensors = ls.Rig({"left": (rig()["left"].lidar, LEFT)})
    scans = bag(tmp_path / "a.mcap", sensors)
    found = open_frames(tmp_path / "a.mcap")
    assert found.note == ""
    (first, *_) = found.read(0)
    assert isinstance(first.cloud, ls.PointCloud)
    np.testing.assert_array_equal(first.cloud.xyz, scans[0]["left"].point_cloud().xyz.astype(np.float32))


def test_a_slower_sensor_is_in_the_frames_that_it_has(tmp_path: Path) -> None:
    bag(tmp_path / "a.mcap", rig(slow=5.0), 6)
    topics = [[*frame.cloud] for frame in read(tmp_path / "a.mcap") if isinstance(frame.cloud, dict)]
    assert len(topics) == 6
    assert sum("/right/points" in frame for frame in topics) == 3
    assert all("/left/points" in frame for frame in topics)


def test_frames_from_a_number_on_and_beyond_the_end(tmp_path: Path) -> None:
    bag(tmp_path / "a.mcap", rig())
    assert len(read(tmp_path / "a.mcap", 2)) == 1
    with pytest.raises(ls.errors.LidarsimError, match=r"a\.mcap: frame: expected 0 to 2, got 3"):
        read(tmp_path / "a.mcap", 3)


def test_unconnected_frames_are_told(tmp_path: Path) -> None:
    with rosbag.Writer(tmp_path / "a.mcap", sensors=rig()) as writer:
        writer._next = 1 << 62  # no clock and no transforms
        writer.write(rig().scan(room()))
    found = open_frames(tmp_path / "a.mcap")
    assert found.note == ("2 topics (/left/points, /right/points), not placed: /tf_static does not connect left, right")
    (frame,) = found.read(0)
    assert isinstance(frame.cloud, dict)
    own = rig().scan(room())["left"].point_cloud().xyz.astype(np.float32)
    np.testing.assert_array_equal(frame.cloud["/left/points"].xyz, own)


def with_transforms(path: Path, *links: tuple[str, str, np.ndarray]) -> None:
    with rosbag.Writer(path, sensors=rig()) as writer:
        writer._next = 1 << 62
        transforms = [writer._transform(0, parent, child, np.eye(4)) for parent, child, _ in links]
        for transform, (*_, numbers) in zip(transforms, links, strict=True):
            place, turn = transform.transform.translation, transform.transform.rotation
            place.x, place.y, place.z = numbers[:3]
            turn.x, turn.y, turn.z, turn.w = numbers[3:]
        writer._send_new("/tf_static", "tf2_msgs/msg/TFMessage", 0, transforms=transforms)
        writer.write(rig().scan(room()))


def test_mounts_on_mounts(tmp_path: Path) -> None:
    turned = np.array([1, 2, 3, 0, 0, 1, 0])  # by half a turn about z
    moved = np.array([1, 0, 1, 0, 0, 0, 2])  # its quaternion is of length 2
    with_transforms(tmp_path / "a.mcap", ("kit", "left", moved), ("base_link", "kit", turned), ("kit", "right", turned))
    mounts = rosbag.static_mounts(tmp_path / "a.mcap")
    assert {name: root for name, (root, _) in mounts.items()} == dict.fromkeys(("left", "right", "kit"), "base_link")
    half = np.diag([-1.0, -1.0, 1.0])
    # Products of numbers that are whole, but for the rotation's sine and cosine of half a turn.
    np.testing.assert_allclose(mounts["left"][1][:3], np.column_stack([half, (0, 2, 4)]), rtol=0, atol=2.0**-50)
    np.testing.assert_allclose(mounts["right"][1][:3], np.column_stack([np.eye(3), (0, 0, 6)]), rtol=0, atol=2.0**-50)


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ([("left", "right", [0, 0, 0, 0, 0, 0, 1]), ("right", "left", [0, 0, 0, 0, 0, 0, 1])], "are a circle"),
        ([("base_link", "left", [0, 0, 0, 0, 0, 0, 0])], "its transform of 'left' is not rigid and finite"),
        ([("base_link", "left", [np.inf, 0, 0, 0, 0, 0, 1])], "its transform of 'left' is not rigid and finite"),
        ([("base_link", "left", [0, np.nan, 0, 0, 0, 0, 1])], "its transform of 'left' is not rigid and finite"),
    ],
)
def test_bad_transforms(links: list[tuple[str, str, list[float]]], message: str, tmp_path: Path) -> None:
    given = [(parent, child, np.array(numbers, np.float64)) for parent, child, numbers in links]
    with_transforms(tmp_path / "a.mcap", *given)
    with pytest.raises(FileFormatError, match=message):
        rosbag.static_mounts(tmp_path / "a.mcap")


def test_view_colours_by_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag(tmp_path / "a.mcap", rig())
    with pytest.raises(SystemExit) as left:
        main(["view", str(tmp_path / "a.mcap"), "--html", str(tmp_path / "a.html")])
    assert left.value.code == 0
    assert "2 topics (/left/points, /right/points) in base_link" in capsys.readouterr().out
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    names = [name.replace("\\u002f", "/") for name in re.findall(r'"name":"([^"]+)"', page)]
    assert {"/left/points", "/right/points"} <= set(names)


def test_a_rig_is_coloured_by_sensor(tmp_path: Path) -> None:
    scans = rig().scan(room())
    ls.show(scans, color_by="sensor", save=tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert {"left", "right"} <= set(re.findall(r'"name":"([^"]+)"', page))
    clouds = {name: scan.point_cloud("world") for name, scan in scans.items()}
    clouds["right"] = ls.PointCloud(xyz=clouds["right"].xyz)  # without the other's fields
    ls.show(clouds, color_by="sensor", save=tmp_path / "b.html")
    with pytest.raises(ValueError, match="color_by: expected one of height, sensor, got 'intensity'"):
        ls.show(clouds, color_by="intensity", save=tmp_path / "c.html")
