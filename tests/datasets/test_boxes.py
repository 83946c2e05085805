"""Boxes in data sets: their choice, their points, and what is told of them."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.datasets.layouts.nuscenes import _attribute

NAMES = {1: "human.pedestrian.adult", 2: "vehicle.car", 3: "vehicle.truck", 9: "barrier", 40: "flat.road"}
RATE = 20.0
LATE = 0.02
"""Offset of the second sensor, s."""


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_euler("z", yaw).as_matrix(), (x, y, z)
    return matrix


def drive(*_: object) -> Any:
    """A turn at 30 m/s past a walker, a car that turns at 12 m/s, a parked truck of three parts and a post."""
    span = np.linspace(-1.0, 3.0, 81)
    scene = ls.Scene(class_names=NAMES)
    scene.add(ls.Plane((0, 0, 1), 0.0), label=40)
    walk = ls.Trajectory(span, [pose(14, 4 - 1.4 * t, 0, -1.6) for t in span])
    scene.add(ls.Ellipsoid((0, 0, 0.88), (0.2, 0.28, 0.88)), label=1, motion=walk)
    turn = ls.Trajectory(span, [pose(12 * t, -4, 0, 0.6 * t) for t in span])
    scene.add(ls.Box((4.5, 1.9, 1.5), center=(0, 0, 0.8)), label=2, motion=turn)
    for center, size in (((0, 0, 1), (3, 2, 1.6)), ((2, 0, 0.7), (1, 1.9, 1)), ((-2, 0, 1.1), (1, 2, 1.8))):
        scene.add(ls.Box(size, center=center), label=3, instance=99, transform=pose(25, 7, 0, 0.5))
    scene.add(ls.Cylinder((31, -9, 0), (31, -9, 3), 0.3), label=9)
    ego = ls.Trajectory(span, [pose(30 * t, 0, 0, 0.1 * t) for t in span])
    top = ls.Lidar(ls.patterns.Spinning(np.radians(np.linspace(-25, 10, 36)), columns=720, rate=RATE))
    side = ls.Lidar(ls.patterns.Spinning(np.radians(np.linspace(-15, 15, 16)), columns=720, rate=RATE / 2))
    return scene, ls.Rig({"top": (top, pose(1, 0, 1.8)), "lidar_side": (side, pose(3, 1, 0.9, 0.5), LATE)}), ego


FRAMES, EVERY = 14, 5


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sweeps")
    layout = {"type": "nuscenes", "key_every": EVERY}
    ls.generate(drive, out, frames=FRAMES, layout=layout, shard_frames=4, pictures=0)
    return out


def tables(folder: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Rows by table and token."""
    files = (path for path in (folder / "v1.0-lidarsim").glob("*.json") if path.stem != "splits")
    return {path.stem: {row["token"]: row for row in json.loads(path.read_text())} for path in files}


def place(row: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Points in the frame in which a row of a table places them."""
    return Rotation.from_quat(row["rotation"], scalar_first=True).apply(points) + row["translation"]


def within(box: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Which points in the world are in a box, without its last micrometre: float64 at the distance of the origin."""
    local = Rotation.from_quat(box["rotation"], scalar_first=True).inv().apply(points - box["translation"])
    width, length, height = box["size"]
    inside: np.ndarray = (np.abs(local) <= np.array([length, width, height]) / 2).all(axis=1)
    return inside


def in_world(folder: Path, index: dict[str, dict[str, dict[str, Any]]], data: dict[str, Any]) -> np.ndarray:
    points = np.fromfile(folder / data["filename"], np.float32).reshape(-1, 5)[:, :3].astype(float)
    sensor = index["calibrated_sensor"][data["calibrated_sensor_token"]]
    return place(index["ego_pose"][data["ego_pose_token"]], place(sensor, points))


def test_sweeps_and_key_frames(sweeps: Path) -> None:
    index = tables(sweeps)
    keys = [*range(0, FRAMES, EVERY)]
    assert len(index["sample"]) == len(keys)
    for channel, every, late in (("LIDAR_TOP", 1, 0.0), ("LIDAR_SIDE", 2, LATE)):
        own = [
            row for row in index["sample_data"].values()
            if index["sensor"][index["calibrated_sensor"][row["calibrated_sensor_token"]]["sensor_token"]]["channel"]
            == channel
        ]  # fmt: skip
        (first,) = (row for row in own if not row["prev"])
        chain = [first]
        while chain[-1]["next"]:
            chain.append(index["sample_data"][chain[-1]["next"]])
            assert chain[-1]["prev"] == chain[-2]["token"]
        assert len(chain) == len(own) == len(range(0, FRAMES, every))
        starts = [frame / RATE + (0.0 if frame in keys else late) for frame in range(0, FRAMES, every)]
        assert [row["timestamp"] - chain[0]["timestamp"] for row in chain] == [round(1e6 * start) for start in starts]
        samples = [*index["sample"].values()]
        for frame, row in zip(range(0, FRAMES, every), chain, strict=True):
            assert row["is_key_frame"] == (frame in keys)
            assert row["filename"].split("/")[0] == ("samples" if frame in keys else "sweeps")
            following = next((k for k, key in enumerate(keys) if key >= frame), len(keys) - 1)
            assert row["sample_token"] == samples[following]["token"]
            if frame in keys:
                assert row["timestamp"] == samples[following]["timestamp"]
    labelled = {row["sample_data_token"] for row in index["lidarseg"].values()}
    assert labelled == {token for token, row in index["sample_data"].items() if row["is_key_frame"]}
    assert len([*(sweeps / "lidarseg").rglob("*.bin")]) == len(labelled)
    assert ls.datasets.verify(sweeps) == []


def test_sweeps_are_read_back_without_boxes_rather_than_with_none_in_them(sweeps: Path) -> None:
    """A detector would learn that the objects of a sweep are background."""
    frames = ls.datasets.load(sweeps)
    assert [frame.boxes is None for frame in frames] == [bool(frame.frame % EVERY) for frame in frames]
    assert any(frame.boxes for frame in frames)


def test_a_key_frame_has_a_box_per_instance_that_holds_its_points(sweeps: Path) -> None:
    index = tables(sweeps)
    for sample in index["sample"].values():
        boxes = [row for row in index["sample_annotation"].values() if row["sample_token"] == sample["token"]]
        names = {
            index["category"][index["instance"][row["instance_token"]]["category_token"]]["name"]: row for row in boxes
        }
        assert len(names) == len(boxes) == 4
        counts = dict.fromkeys(names, 0)
        for data in index["sample_data"].values():
            if data["sample_token"] != sample["token"] or not data["is_key_frame"]:
                continue
            (labels,) = (row for row in index["lidarseg"].values() if row["sample_data_token"] == data["token"])
            label = np.fromfile(sweeps / labels["filename"], np.uint8)
            points = in_world(sweeps, index, data)
            for name, box in names.items():
                (own,) = (label == row["index"] for row in index["category"].values() if row["name"] == name)
                assert within(box, points[own]).all()
                counts[name] += np.count_nonzero(own)
        assert counts == {name: box["num_lidar_pts"] for name, box in names.items()}
        assert min(counts.values()) > 0
        told = {name: index["attribute"][box["attribute_tokens"][0]]["name"] for name, box in names.items()}
        assert told == {
            "human.pedestrian.adult": "pedestrian.moving", "vehicle.car": "vehicle.moving",
            "vehicle.truck": "vehicle.parked", "barrier": "still",
        }  # fmt: skip


@pytest.mark.parametrize("category", ["vehicle.bicycle", "vehicle.motorcycle"])
def test_cycles_have_the_attributes_of_cycles(category: str) -> None:
    attributes = [_attribute(category, moves=moves) for moves in (True, False)]
    assert attributes == ["cycle.with_rider", "cycle.without_rider"]


def test_sweeps_agree_with_interpolated_boxes(sweeps: Path) -> None:
    """As the kit interpolates them; of the instances here, only the car turns, so the walker's are exact."""
    index = tables(sweeps)
    chain = [*index["sample"].values()][:2]
    times = [sample["timestamp"] for sample in chain]
    boxes = [
        [row for row in index["sample_annotation"].values() if row["sample_token"] == sample["token"]]
        for sample in chain
    ]
    (walker,) = {row["instance_token"] for row in boxes[0] if row["size"][2] > 1.7 and row["size"][0] < 0.58}
    before, after = (next(row for row in part if row["instance_token"] == walker) for part in boxes)
    seen = 0
    for data in index["sample_data"].values():
        if not data["is_key_frame"] and data["timestamp"] < times[1]:
            share = (data["timestamp"] - times[0]) / (times[1] - times[0])
            there = (1 - share) * np.array(before["translation"]) + share * np.array(after["translation"])
            points = in_world(sweeps, index, data)
            near = points[(np.abs(points[:, :2] - there[:2]) < 0.6).all(axis=1) & (points[:, 2] > 0.02)]
            # Timestamps are in whole microseconds, in which the walker moves by less than 1.5 µm.
            box = before | {"translation": there.tolist(), "size": (np.array(before["size"]) + 3e-6).tolist()}
            assert within(box, near).all()
            seen += len(near)
    assert seen > 100


def test_raw_points_if_a_run_says_so(tmp_path: Path) -> None:
    ls.generate(drive, tmp_path / "raw", layout="nuscenes", deskew=False, pictures=0)
    scene, rig, ego = drive()
    scans = next(rig.frames(scene, ego, count=1))
    (path,) = (tmp_path / "raw").rglob("samples/LIDAR_TOP/*.bin")
    points = np.fromfile(path, np.float32).reshape(-1, 5)
    np.testing.assert_array_equal(points[:, :3], scans["top"].point_cloud().xyz.astype(np.float32))
    assert "not deskewed" in (tmp_path / "raw/README.md").read_text()


RUN = """\
layout: {layout}
class_names: {{"1": Car}}
run:
  sensor: {{pattern: {{type: spinning, elevations_deg: [-8, -4, 0], columns: 360, rate_hz: 10}}}}
  pose: {{position_m: [0, 0, 1], linear_m_per_s: [9, 0, 0]}}
  scene:
    - {{shape: box, size_m: [4, 2, 2], center_m: [9, 3, 1], label: 1}}
{cloud}
"""


@pytest.mark.parametrize(
    ("layout", "cloud", "deskew"),
    [
        ("kitti", "", "start"),
        ("kitti", "  cloud: {frame: sensor}", "start"),
        ("kitti", "  cloud: {deskew: middle}", "middle"),
        ("kitti", "  cloud: {deskew_s: 0.02}", 0.02),
        ("kitti", "  cloud: {deskew: false}", False),
        ("{type: shards, boxes: true}", "", "start"),
        ("{type: shards, boxes: false}", "", False),
        ("shards", "", False),
        ("semantickitti", "", False),
    ],
)
def test_layouts_with_boxes_deskew(layout: str, cloud: str, deskew: Any, tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RUN.format(layout=layout, cloud=cloud))
    ls.generate(recipe, tmp_path / "out", pictures=0)
    run = ls.datasets.recipe.load(recipe).source.run(0, 0)  # type: ignore[attr-defined]
    (scan,) = next(run.scans()).values()
    expected = scan.point_cloud(deskew=deskew).xyz.astype(np.float32)
    if "shards" in layout:
        with tarfile.open(tmp_path / "out/shards/000000.tar") as tar:
            member = tar.extractfile("000000_000000.npz")
            assert member is not None
            with np.load(io.BytesIO(member.read())) as arrays:
                found = arrays["xyz"]
    else:
        (path,) = (tmp_path / "out").rglob("velodyne/*.bin")
        found = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(found, expected)
    told = "not deskewed" if deskew is False else f"at the {deskew if isinstance(deskew, str) else '0.02 s after'}"
    assert told in (tmp_path / "out/README.md").read_text()


def test_boxes_in_parquet(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    layout = {"type": "shards", "boxes": {}, "fields": ["label", "instance", "time"]}
    ls.generate(drive, tmp_path, frames=3, layout=layout, pictures=0, splits={"val": 1.0})
    rows = parquet.read_table(tmp_path / "boxes.parquet").to_pylist()
    index = parquet.read_table(tmp_path / "index.parquet").to_pylist()
    assert len(index) == 3 + 2
    for sample in index:
        own = [row for row in rows if (row["key"], row["sensor"]) == (sample["key"], sample["sensor"])]
        assert {row["name"] for row in own} >= {"human.pedestrian.adult", "vehicle.car", "vehicle.truck"}
        data = (tmp_path / sample["shard"]).read_bytes()[sample["offset"] :][: sample["size"]]
        with np.load(io.BytesIO(data)) as arrays:
            points, instance = arrays["xyz"].astype(float), arrays["instance"]
        with tarfile.open(tmp_path / sample["shard"]) as tar:
            member = tar.extractfile(f"{sample['key']}.{sample['sensor']}.json")
            assert member is not None
            noted = json.load(member)["boxes"]
        assert len(noted) == len(own)
        for row, note in zip(own, noted, strict=True):
            assert note == {key: row[key] for key in note}
            local = (points[instance == row["instance"]] - row["center"]) @ np.reshape(row["rotation"], (3, 3))
            assert len(local) == row["points"] > 0
            assert (np.abs(local) <= np.array(row["size"]) / 2).all()
            assert (row["time"], row["split"]) == (sample["seconds"], "val")
            assert 0 <= row["visibility"] <= 1
    (car,) = (row for row in rows if row["name"] == "vehicle.car" and (row["frame"], row["sensor"]) == (0, "top"))
    # At time 0 the rig heads along x, so that the axes of its sensor are the world's.
    # A matrix and its product with a vector round four times each.
    np.testing.assert_allclose(car["velocity"], [12, 0, 0], rtol=0, atol=8 * 12 * 2.0**-53)


def test_points_in_the_world(tmp_path: Path) -> None:
    layout = {"type": "shards", "boxes": {}, "fields": ["instance"]}
    ls.generate(drive, tmp_path, frames=2, layout=layout, frame="world", pictures=0)
    scene, rig, ego = drive()
    with tarfile.open(tmp_path / "shards/000001.tar") as tar:
        member, noted = tar.extractfile("000000_000001.top.npz"), tar.extractfile("000000_000001.top.json")
        assert member is not None
        assert noted is not None
        with np.load(io.BytesIO(member.read())) as arrays:
            points, instance = arrays["xyz"], arrays["instance"]
        boxes = json.load(noted)["boxes"]
    (_, scans) = rig.frames(scene, ego, count=2)
    cloud = scans["top"].point_cloud(frame="world", deskew="start", deskew_movers=True)
    np.testing.assert_array_equal(points, cloud.xyz)
    (truck,) = (box for box in boxes if box["instance"] == 99)
    # A matrix and its product with a vector round four times each.
    np.testing.assert_allclose(truck["center"][:2], [25, 7], rtol=0, atol=8 * 25 * 2.0**-53)
    assert (instance == 99).sum() == truck["points"] > 0
    card = (tmp_path / "README.md").read_text()
    assert (
        "in world coordinates, and points of moving instances are moved along to the start of the scan, which is"
        in card
    )


def test_boxes_are_no_larger_far_from_the_origin_of_the_world(tmp_path: Path) -> None:
    def survey(*_: object) -> Any:
        scene = ls.Scene()
        scene.add(ls.Box((9, 2.5, 3)), transform=pose(612_012, 5_263_990, 500))
        return scene, ls.Lidar.preset("velodyne-vlp16"), pose(612_000, 5_264_000, 500)

    ls.generate(survey, tmp_path, layout={"type": "shards", "boxes": True}, frame="world", pictures=0)
    (frame,) = ls.datasets.load(tmp_path)
    assert frame.boxes is not None
    np.testing.assert_allclose(frame.boxes.size, [[9, 2.5, 3]], atol=1e-6)
    assert frame.boxes.contain(frame.cloud.xyz).all()


def count(folder: Path) -> dict[str, int]:
    index = tables(folder)
    names = [
        index["category"][index["instance"][row["instance_token"]]["category_token"]]["name"]
        for row in index["sample_annotation"].values()
    ]
    return {name: names.count(name) for name in sorted({*names})}


def test_filters(tmp_path: Path) -> None:
    def count_with(**boxes: Any) -> dict[str, int]:
        folder = tmp_path / str(len([*tmp_path.iterdir()]))
        ls.generate(drive, folder, layout={"type": "nuscenes", "boxes": boxes}, pictures=0)
        return count(folder)

    every = {"barrier": 1, "human.pedestrian.adult": 1, "vehicle.car": 1, "vehicle.truck": 1}
    assert count_with() == every
    assert count_with(classes=["barrier", 2]) == {"barrier": 1, "vehicle.car": 1}
    assert count_with(max_range_m=20.0) == {"human.pedestrian.adult": 1, "vehicle.car": 1}  # 14 m and 4 m from the body
    assert count_with(max_range_m=30.0) == {name: 1 for name in every if name != "barrier"}
    rows = tables(tmp_path / "0")["sample_annotation"].values()
    least = sorted(row["num_lidar_pts"] for row in rows)
    assert sum(count_with(min_points=least[2]).values()) == 2
    assert sum(count_with(min_points=least[2] + 1).values()) == 1
    # Tables count the points of all sensors, frames those of their own.
    own = [points for frame in ls.datasets.load(tmp_path / "0") for points in frame.boxes.points]
    assert sum(own) == sum(least)
    assert len(own) > len(least)
    assert max(own) < least[3]
    assert sum(count_with(min_points=least[3]).values()) == 1
    assert all(len(frame.boxes) == 0 for frame in ls.datasets.load(max(tmp_path.iterdir())))


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        ("{type: kitti, boxes: {classes: [Cat]}}", r"layout: boxes\.classes: expected labels, or names .*'Car'.*'Cat'"),
        ("{type: kitti, boxes: [Cat]}", r"layout: boxes\.classes: expected labels, or names"),
        ("{type: kitti, boxes: {min_points: -1}}", r"layout.*boxes.min_points: expected a value >= 0"),
        ("{type: kitti, boxes: {max_range_m: 0}}", r"layout.*boxes.max_range_m: expected a value > 0"),
        ("{type: kitti, boxes: {range: 3}}", r"boxes.range: unknown key"),
        ("{type: kitti, camera: {width: 0}}", r"camera.width: expected a value >= 1"),
        ("{type: nuscenes, key_every: 0}", r"key_every: expected a value >= 1"),
    ],
)
def test_mistakes_are_named(layout: str, message: str, tmp_path: Path) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RUN.format(layout=layout, cloud=""))
    with pytest.raises(ls.errors.ConfigError, match=rf"recipe\.yaml:1: .*{message}"):
        ls.generate(recipe, tmp_path / "out", pictures=0)
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.yaml"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({1: "car", 2: "car"}, r"class_names\[2\]: expected another name than label 1 has, got 'car'"),
        ({2: "noise"}, r"class_names\[2\]: expected another name than label 0 has, got 'noise'"),
        ({2: "class_7"}, r"class_names\[2\]: expected printable text in nuscenes, and no other label's class_…"),
        ({2: ""}, r"class_names\[2\]: expected printable text in nuscenes"),
        ({2: "a\nb"}, r"class_names\[2\]: expected printable text in nuscenes"),
    ],
)
def test_names_that_categories_cannot_have(names: dict[int, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        ls.generate(drive, tmp_path / "out", layout="nuscenes", class_names=names, pictures=0)
    assert not any(tmp_path.iterdir())


def test_channels_that_are_the_same(tmp_path: Path) -> None:
    def scenes(*_: object) -> Any:
        scene, rig, ego = drive()
        part = rig["top"]
        return scene, ls.Rig({"top": (part.lidar, None), "LIDAR_TOP": (part.lidar, None)}), ego

    with pytest.raises(ValueError, match=r"^sensors: expected names that differ in more than case and LIDAR_"):
        ls.generate(scenes, tmp_path / "out", layout="nuscenes", pictures=0)
    assert not any(tmp_path.iterdir())


def test_the_card_tells_of_boxes(sweeps: Path, tmp_path: Path) -> None:
    """Every number of the first table, from the tables of the data set."""
    layout = {"type": "nuscenes", "boxes": {"classes": ["vehicle.truck"], "max_range_m": 40.0}, "key_every": EVERY}
    ls.generate(drive, tmp_path, frames=FRAMES, layout=layout, pictures=0, splits={"val": [0]})
    text = (tmp_path / "README.md").read_text()
    assert "at the start of the scan (in key frames, of that of the first sensor), and points of moving" in text
    rows = [*tables(tmp_path)["sample_annotation"].values()]
    points = np.mean([row["num_lidar_pts"] for row in rows])
    assert f"{len(rows)} boxes, of instances with at least 1 point, within 40 m, of the classes vehicle.truck." in text
    (line,) = (line for line in text.splitlines() if line.startswith("| vehicle.truck | val | 3 | 100.00% |"))
    *_, length, width, height, distance, mean = map(float, line.strip("| ").split(" | ")[4:])
    assert [length, width, height, mean] == [5.0, 2.0, 1.8, round(float(points), 1)]
    assert 0 < distance < 40
    everything = (sweeps / "README.md").read_text()
    assert "| class | boxes |" in everything
    assert "| barrier | 3 |" in everything
