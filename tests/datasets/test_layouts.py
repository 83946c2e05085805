"""Layouts, read back by the readers of others, or by code that shares nothing with what wrote them."""

from __future__ import annotations

import dataclasses
import functools
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.recipe import load
from lidarsim.viewers._colors import QUALITATIVE

POSE = "{position_m: [500000, 5000000, 1.5], linear_m_per_s: [3, 0, 0], angular_deg_per_s: [0, 0, 20]}"
TURN = f"run.pose={POSE}"
BALL = "{shape: sphere, center_m: [500009, 5000000, 1], radius_m: 2, label: 10}"
SCENE = f"[{{shape: plane, normal: [0, 0, 1], label: 40}}, {BALL}]"
SIDE = "{type: grid, azimuths_deg: [0, 5], elevations_deg: [-9, -4], rate_hz: 5}"
TOP = "sensor: {preset: velodyne-vlp16}, position_m: [1, 0, 2], rotation_deg: {yaw: 30}"
RIG = (
    "vary={}",
    f"run={{pose: {POSE}, scene: {SCENE}, rig: {{top: {{{TOP}}}, side: {{sensor: {{pattern: {SIDE}}}}}}}}}",
)
"""A rig of two whose second sensor has half as many frames, far from the origin."""


def make(recipe: Path, out: Path, layout: str, *overrides: str) -> None:
    ls.generate(recipe, out, layout=layout, overrides=overrides, pictures=0)


@pytest.fixture
def recipe(shared: Path) -> Path:
    return shared


@functools.cache
def clouds(recipe: Path, sequence: int, frame: int, *overrides: str) -> dict[str, tuple[ls.Scan, ls.PointCloud]]:
    """What the sensors measure, by way of the public scans."""
    run = load(recipe, overrides).source.run(sequence, frame)
    (scans,) = dataclasses.replace(run, frames=range(frame, frame + 1)).scans()
    return {name: (scan, scan.point_cloud()) for name, scan in scans.items()}


def run_of(recipe: Path, sequence: int, frame: int, *overrides: str) -> Any:
    """The scans of a frame of a sequence, counted as the run counts them."""
    run = load(recipe, overrides).source.run(sequence, 0)
    return dataclasses.replace(run, frames=range(frame, frame + 1)).scans()


def rows(path: Path) -> np.ndarray:
    """Poses of a file: 4×4 matrices."""
    return np.array([np.vstack([row.reshape(3, 4), [0, 0, 0, 1]]) for row in np.loadtxt(path, ndmin=2)])


def test_semantickitti(recipe: Path, tmp_path: Path) -> None:
    far = (TURN, f"run.scene={SCENE}")
    make(recipe, tmp_path / "out", "semantickitti", *far)
    classes = yaml.safe_load((tmp_path / "out/semantic-kitti.yaml").read_text())
    assert classes["labels"] == {0: "unlabeled", 30: "class_30", 40: "road"}
    assert classes["split"]["train"] == [0, 1, 2]
    assert {classes["learning_map_inv"][index] for index in classes["learning_map"].values()} == set(classes["labels"])
    assert set(classes["color_map"]) == set(classes["labels"])
    unlabeled = classes["learning_map"][0]
    assert classes["learning_ignore"] == {index: index == unlabeled for index in classes["learning_map_inv"]}
    found = np.concatenate([np.fromfile(path, np.uint32) & 0xFFFF for path in (tmp_path / "out").rglob("*.label")])
    assert classes["content"] == {label: np.mean(found == label) for label in (0, 30, 40)}
    for sequence in range(3):
        folder = tmp_path / f"out/sequences/{sequence:02}"
        calibration = dict(line.split(":") for line in (folder / "calib.txt").read_text().splitlines())
        to_camera = np.vstack([np.array(calibration["Tr"].split(), float).reshape(3, 4), [0, 0, 0, 1]])
        poses = np.linalg.inv(to_camera) @ rows(folder / "poses.txt") @ to_camera  # as the kit has it
        times = np.loadtxt(folder / "times.txt")
        np.testing.assert_allclose(times, np.arange(4) / 10, atol=5e-10)  # nine decimals
        assert np.array_equal(poses[0], np.eye(4))
        first = None
        for frame in range(4):
            ((scan, cloud),) = clouds(recipe, sequence, frame, *far).values()
            points = np.fromfile(folder / f"velodyne/{frame:06}.bin", np.float32).reshape(-1, 4)
            labels = np.fromfile(folder / f"labels/{frame:06}.label", np.uint32)
            assert len(points) == len(labels) == len(cloud) > 0
            np.testing.assert_array_equal(points[:, :3], cloud.xyz.astype(np.float32))
            np.testing.assert_array_equal(points[:, 3], cloud.intensity)
            np.testing.assert_array_equal(labels & 0xFFFF, cloud.label)
            np.testing.assert_array_equal(labels >> 16, cloud.object_id + 1)
            pose = scan.pose.at(scan.time).as_matrix()
            first = pose if first is None else first
            # Coordinates of 5e6 m have steps of 2**-30 m, and the difference of two a few of them.
            np.testing.assert_allclose(poses[frame], np.linalg.inv(first) @ pose, rtol=0, atol=8 * 2.0**-30)


def test_semantickitti_of_a_rig(recipe: Path, tmp_path: Path) -> None:
    """File k of a sensor belongs to line k of its poses and times; the second sensor has half the rate of the first."""
    first = (
        "run.first_frame=1",
        "shard_frames=1",
    )  # where the slower sensor has no frame, so that its first comes later
    make(recipe, tmp_path / "out", "semantickitti", *RIG, *first)
    own: dict[str, list[tuple[ls.Scan, ls.PointCloud]]] = {"top": [], "side": []}
    for frame in range(4):
        (scans,) = run_of(recipe, 1, frame + 1, *RIG, *first)
        for name, scan in scans.items():
            own[name].append((scan, scan.point_cloud()))
    assert [len(frames) for frames in own.values()] == [4, 2]
    for name, frames in own.items():
        folder = tmp_path / f"out/{name}/sequences/01"
        for kind, suffix in (("velodyne", "bin"), ("labels", "label")):
            assert sorted(file.name for file in (folder / kind).iterdir()) == [
                f"{number:06}.{suffix}" for number in range(len(frames))
            ]
        poses, times = rows(folder / "poses.txt"), np.loadtxt(folder / "times.txt")
        assert len(poses) == len(times) == len(frames)
        to_camera = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
        start = frames[0][0].pose.at(frames[0][0].time).as_matrix()
        for number, (scan, cloud) in enumerate(frames):
            points = np.fromfile(folder / f"velodyne/{number:06}.bin", np.float32).reshape(-1, 4)
            np.testing.assert_array_equal(points[:, :3], cloud.xyz.astype(np.float32))
            assert times[number] == pytest.approx(scan.time - frames[0][0].time, abs=5e-10)  # nine decimals
            pose = np.linalg.inv(to_camera) @ poses[number] @ to_camera
            moved = np.linalg.inv(start) @ scan.pose.at(scan.time).as_matrix()
            # Coordinates of 5e6 m have steps of 2**-30 m, and the difference of two a few of them.
            np.testing.assert_allclose(pose, moved, rtol=0, atol=8 * 2.0**-30)


def test_nuscenes_tables_fit_together(recipe: Path, tmp_path: Path) -> None:
    make(recipe, tmp_path / "out", "nuscenes", *RIG)
    tables = {path.stem: json.loads(path.read_text()) for path in (tmp_path / "out/v1.0-lidarsim").glob("*.json")}
    index = {name: {row["token"]: row for row in table} for name, table in tables.items()}
    assert all(len(index[name]) == len(tables[name]) for name in tables)  # tokens are unique
    for table in tables.values():
        for row in table:
            for key, value in row.items():
                if key.endswith("_token"):
                    name = key.removesuffix("_token").removeprefix("first_").removeprefix("last_")
                    name = {"annotation": "sample_annotation"}.get(name, name)
                    assert value in index[name], (key, value)
    assert len(tables["scene"]) == 3
    assert len(tables["sample"]) == 12
    assert len(tables["sample_data"]) == len(tables["lidarseg"]) == 12 + 6
    for scene in tables["scene"]:
        chain, token = [], scene["first_sample_token"]
        while token:
            chain.append(token)
            token = index["sample"][token]["next"]
        assert chain[-1] == scene["last_sample_token"]
        assert len(chain) == scene["nbr_samples"] == 4
    start = min(row["timestamp"] for row in tables["sample"])
    for data in tables["sample_data"]:
        sensor = index["calibrated_sensor"][data["calibrated_sensor_token"]]
        channel = index["sensor"][sensor["sensor_token"]]["channel"]
        sequence = int(
            index["scene"][index["sample"][data["sample_token"]]["scene_token"]]["name"].removeprefix("scene-")
        )
        frame = round((data["timestamp"] - start - 3600e6 * sequence) / 1e5)
        scan, cloud = clouds(recipe, sequence, frame, *RIG)[channel.removeprefix("LIDAR_").lower()]
        points = np.fromfile(tmp_path / "out" / data["filename"], np.float32).reshape(-1, 5)
        labels = np.fromfile(tmp_path / "out" / index["lidarseg"][data["token"]]["filename"], np.uint8)
        np.testing.assert_array_equal(labels, cloud.label)
        np.testing.assert_array_equal(points[:, 4], cloud.ring)
        placed = points[:, :3].astype(float)
        for place in (sensor, index["ego_pose"][data["ego_pose_token"]]):
            placed = Rotation.from_quat(place["rotation"], scalar_first=True).apply(placed) + place["translation"]
        # float32 rounds coordinates of up to 128 m by 2**-18 m each, and a rotation turns three of them together.
        np.testing.assert_allclose(placed, scan.point_cloud(frame="world").xyz, rtol=0, atol=4 * 2.0**-18)


MOVER = "{shape: box, size_m: [4, 2, 1.5], center_m: [0.5, 0, 0.75], label: 20, "
MOVER += "position_m: [500008, 5000006, 0], rotation_deg: {yaw: 30}, motion: {linear_m_per_s: [5, 0, 0]}}"
BOXES = (*RIG, "sequences=1", f"run.scene=[{{shape: plane, normal: [0, 0, 1], label: 40}}, {BALL}, {MOVER}]")


def test_nuscenes_boxes(recipe: Path, tmp_path: Path) -> None:
    make(recipe, tmp_path / "out", "nuscenes", *BOXES)
    tables = {path.stem: json.loads(path.read_text()) for path in (tmp_path / "out/v1.0-lidarsim").glob("*.json")}
    index = {name: {row["token"]: row for row in table} for name, table in tables.items()}
    names = [
        index["category"][index["instance"][row["instance_token"]]["category_token"]]["name"]
        for row in tables["sample_annotation"]
    ]
    assert sorted(names) == ["class_10"] * 4 + ["class_20"] * 4
    for row, name in zip(tables["sample_annotation"], names, strict=True):
        frame = round((index["sample"][row["sample_token"]]["timestamp"] - tables["sample"][0]["timestamp"]) / 1e5)
        turn = Rotation.from_quat(row["rotation"], scalar_first=True)
        heading = [np.cos(np.pi / 6), 0.5, 0.0] if name == "class_20" else [1.0, 0.0, 0.0]
        # To the sensor and back, with a quaternion on the way: fewer than 64 roundings of numbers up to 1.
        np.testing.assert_allclose(turn.as_matrix()[:, 0], heading, rtol=0, atol=64 * 2.0**-53)
        # Room for the rounding of points and centre to float32, within 32 m, at both ends; no less than the shape.
        larger = np.array(row["size"]) - ([2, 4, 1.5] if name == "class_20" else [4, 4, 4])
        assert ((larger >= 0) & (larger <= 4 * np.sqrt(3) * 2.0**-24 * 32)).all()
        seen = 0
        for scan, cloud in clouds(recipe, 0, frame, *BOXES).values():
            own = cloud.label == int(name.removeprefix("class_"))
            world = scan.point_cloud(frame="world").xyz[own]
            if name == "class_20":  # back to where it was at the time of the sample
                world -= np.outer(5 * cloud.time[own], heading)
            inside = np.abs(turn.inv().apply(world - row["translation"])) <= np.array(row["size"])[[1, 0, 2]] / 2 + 1e-8
            assert inside.all()
            seen += np.count_nonzero(own)
        assert seen == row["num_lidar_pts"] > 0
        assert index["visibility"][row["visibility_token"]]["level"] == "v80-100"  # nothing hides either
        (attribute,) = row["attribute_tokens"]
        assert index["attribute"][attribute]["name"] == ("moving" if name == "class_20" else "still")
    for instance in tables["instance"]:
        chain, token = [], instance["first_annotation_token"]
        while token:
            chain.append(index["sample_annotation"][token])
            token = chain[-1]["next"]
        assert [row["prev"] for row in chain] == ["", *(row["token"] for row in chain[:-1])]
        assert chain[-1]["token"] == instance["last_annotation_token"]
        assert len(chain) == instance["nbr_annotations"] == 4


def test_nuscenes_boxes_of_some_labels(recipe: Path, tmp_path: Path) -> None:
    layout = {"type": "nuscenes", "boxes": [20]}
    ls.generate(recipe, tmp_path / "out", layout=layout, overrides=BOXES, frames=1, pictures=0)
    assert len(json.loads((tmp_path / "out/v1.0-lidarsim/sample_annotation.json").read_text())) == 1


def test_nuscenes_in_its_own_kit(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its own kit has to be installed by hand, ``pip install --no-deps nuscenes-devkit``: it wants a NumPy before 2."""
    kit = pytest.importorskip("nuscenes.nuscenes", exc_type=ImportError)
    make(recipe, tmp_path / "out", "nuscenes")
    with pytest.raises(KeyError, match="class_1"):  # it knows no other classes than its own
        kit.NuScenes("v1.0-lidarsim", str(tmp_path / "out"))
    _, code, _ = (tmp_path / "out/README.md").read_text().split("```")
    told: dict[str, Any] = {"FOLDER": str(tmp_path / "out")}
    exec(code.removeprefix("python"), told)  # noqa: S102 - what the data card says
    data = told["data"]
    assert list(data.colormap)[40] == "road"
    assert list(data.colormap["road"]) == list(bytes.fromhex(QUALITATIVE[40 % len(QUALITATIVE)][1:]))
    picture = tmp_path / "lidarseg.png"
    data.explorer.render_sample_data(
        data.sample[0]["data"]["LIDAR_TOP"],
        show_lidarseg=True,
        underlay_map=False,
        out_path=str(picture),
        verbose=False,
    )
    assert picture.stat().st_size > 0
    sample = data.get("sample", data.scene[1]["first_sample_token"])
    cloud = clouds(recipe, 1, 0)[""][1]
    data.list_scenes()
    assert [line.split(",")[0] for line in capsys.readouterr().out.splitlines() if "scene-" in line] == [
        f"scene-{sequence:04}" for sequence in range(3)
    ]
    data.get_sample_lidarseg_stats(sample["token"])
    printed = capsys.readouterr().out
    for label, name in ((30, "class_30"), (40, "road")):
        assert f"{np.count_nonzero(cloud.label == label)}" in next(
            line for line in printed.splitlines() if name in line
        )
    path, _, _ = data.get_sample_data(sample["data"]["LIDAR_TOP"])
    assert len(kit.LidarPointCloud.from_file(path).points.T) == len(cloud)


def test_nuscenes_boxes_in_its_own_kit(recipe: Path, tmp_path: Path) -> None:
    kit = pytest.importorskip("nuscenes.nuscenes", exc_type=ImportError)
    from nuscenes.utils.geometry_utils import points_in_box

    make(recipe, tmp_path / "out", "nuscenes", *BOXES)
    colors = json.loads((tmp_path / "out/colormap.json").read_text())
    data = kit.NuScenes("v1.0-lidarsim", str(tmp_path / "out"), colormap=colors)
    levels = [data.get("visibility", token)["level"] for token in ("1", "2", "3", "4")]
    assert levels == ["v0-40", "v40-60", "v60-80", "v80-100"]
    assert {row["visibility_token"] for row in data.sample_annotation} == {"4"}
    for frame, sample in enumerate(data.sample):
        path, boxes, _ = data.get_sample_data(sample["data"]["LIDAR_TOP"])
        cloud = clouds(recipe, 0, frame, *BOXES)["top"][1]
        points = kit.LidarPointCloud.from_file(path).points[:3]
        ball, mover = sorted(boxes, key=lambda box: box.name)
        assert (ball.name, mover.name) == ("class_10", "class_20")
        for box, label in ((ball, 10), (mover, 20)):
            assert np.array_equal(points_in_box(box, points), cloud.label == label)
        # The kit divides by the difference, 0.1 s at least, of two times since 1970, which have steps of 2**-22 s.
        velocity = [5 * np.cos(np.pi / 6), 2.5, 0]
        np.testing.assert_allclose(data.box_velocity(mover.token), velocity, rtol=2.0**-22 / 0.1, atol=1e-7)


def test_shards(recipe: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    make(recipe, tmp_path / "out", "shards", *RIG)
    index = parquet.read_table(tmp_path / "out/index.parquet").to_pylist()
    assert [(row["sequence"], row["frame"]) for row in index if row["sensor"] == "top"] == [
        (sequence, frame) for sequence in range(3) for frame in range(4)
    ]
    assert len(index) == 18
    seen = 0
    for row in index:
        data = (tmp_path / "out" / row["shard"]).read_bytes()[row["offset"] :][: row["size"]]
        scan, cloud = clouds(recipe, row["sequence"], row["frame"], *RIG)[row["sensor"]]
        with np.load(io.BytesIO(data)) as arrays:
            assert set(arrays) == {"xyz", "intensity", "time", "ring", "label", "instance"}
            assert len(arrays["xyz"]) == row["points"]
            np.testing.assert_array_equal(arrays["xyz"], cloud.xyz.astype(np.float32))
            for name in set(arrays) - {"xyz"}:
                np.testing.assert_array_equal(arrays[name], getattr(cloud, name))
        pose = scan.pose.at(scan.time).as_matrix()
        ulps = 8 * np.finfo(float).eps  # SciPy's product of two rotations is rounded in another way than the core's
        np.testing.assert_allclose(np.reshape(row["pose"], (3, 4)), pose[:3], rtol=ulps, atol=ulps)
        with tarfile.open(tmp_path / "out" / row["shard"]) as tar:
            member = tar.extractfile(f"{row['key']}.{row['sensor']}.json")
            assert member is not None
            said = json.load(member)
        assert said == {key: row[key] for key in said}
        seen += 1
    assert seen == 18


def test_shards_with_other_fields(recipe: Path, tmp_path: Path) -> None:
    ls.generate(recipe, tmp_path / "out", layout={"type": "shards", "fields": ["normal", "label"]}, pictures=0)
    with tarfile.open(tmp_path / "out/shards/000000.tar") as tar:
        names = tar.getnames()
        member = tar.extractfile(names[0])
        assert member is not None
        with np.load(io.BytesIO(member.read())) as arrays:
            assert set(arrays) == {"xyz", "normal", "label"}
    assert names[:4] == ["000000_000000.npz", "000000_000000.json", "000000_000001.npz", "000000_000001.json"]


def test_shards_without_such_a_field(recipe: Path, tmp_path: Path) -> None:
    with pytest.raises(ls.errors.LidarsimError, match=r"sequence 0, frame 0 .* got 'colour'"):
        ls.generate(recipe, tmp_path / "out", layout={"type": "shards", "fields": ["colour"]})


def test_bags(recipe: Path, tmp_path: Path) -> None:
    make(recipe, tmp_path / "out", "bags", *RIG)
    names = sorted(path.relative_to(tmp_path / "out").as_posix() for path in tmp_path.rglob("*.mcap"))
    assert names == [
        "sequence_0000/000000.mcap", "sequence_0001/000000.mcap", "sequence_0001/000001.mcap",
        "sequence_0002/000000.mcap", "sequence_0002/000002.mcap",
    ]  # fmt: skip
    seen = 0
    for name in names:
        mounts, bodies, messages = {}, {}, []
        with (tmp_path / "out" / name).open("rb") as file:
            for _, channel, _, message in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages():
                if channel.topic == "/tf_static":
                    mounts = {part.child_frame_id: rigid_transform(part.transform) for part in message.transforms}
                elif channel.topic == "/tf":
                    (part,) = message.transforms
                    bodies[part.header.stamp.sec, part.header.stamp.nanosec] = rigid_transform(part.transform)
                elif channel.topic.endswith("/points"):
                    assert channel.topic == f"/{message.header.frame_id}/points"
                    messages.append(message)
        for message in messages:
            stamp = message.header.stamp
            seconds = stamp.sec - 1_577_836_800 + stamp.nanosec / 1e9  # since the start of 2020
            scan, cloud = clouds(recipe, int(name[9:13]), round(10 * seconds), *RIG)[message.header.frame_id]
            fields = [(field.name, "u2" if field.datatype == 4 else "f4") for field in message.fields]
            points = np.frombuffer(message.data, fields)
            np.testing.assert_array_equal(np.stack([points[axis] for axis in "xyz"], 1), cloud.xyz.astype(np.float32))
            np.testing.assert_array_equal(points["ring"], cloud.ring)
            # The message counts from its stamp, in whole nanoseconds, and float32 has 24 bits.
            np.testing.assert_allclose(points["time"], cloud.time, rtol=2.0**-24, atol=1e-9)
            pose = bodies[stamp.sec, stamp.nanosec] * mounts[message.header.frame_id]
            wanted = scan.pose.at(scan.time).as_matrix()
            # Coordinates of 5e6 m have steps of 2**-30 m.
            np.testing.assert_allclose(pose.as_matrix(), wanted, rtol=0, atol=8 * 2.0**-30)
            seen += 1
    assert seen == 18


@pytest.mark.slow("bags are cut where drivers cut")
@pytest.mark.parametrize("options", [{"cut": "driver"}, {"cut_deg": 90}])
def test_bags_cut_where_drivers_cut(recipe: Path, options: dict[str, Any], tmp_path: Path) -> None:
    points: dict[str, dict[str, list[Any]]] = {}
    stamps: dict[str, dict[str, list[int]]] = {}
    for name, more in (("whole", {}), ("cut", options)):
        ls.generate(recipe, tmp_path / name, layout={"type": "bags", **more}, overrides=RIG, pictures=0)
        assert not ls.datasets.verify(tmp_path / name)
        points[name], stamps[name] = {}, {}
        for path in sorted((tmp_path / name).rglob("*.mcap")):
            parts = list(ls.io.rosbag.read(path, topic="/top/points"))
            stamps[name][path.relative_to(tmp_path / name).as_posix()] = [part.stamp // 10**6 % 1000 for part in parts]
            for part in parts:
                times = part.stamp + np.rint(1e9 * part.cloud.time).astype(int)
                points[name].setdefault(path.parent.name, []).append((times, part.cloud.ring, part.cloud.xyz))
    assert points["cut"].keys() == points["whole"].keys() == {f"sequence_{number:04}" for number in range(3)}
    for sequence, parts in points["cut"].items():
        pairs = zip(zip(*parts, strict=True), zip(*points["whole"][sequence], strict=True), strict=True)
        (times, before), *others = [tuple(np.concatenate(part) for part in pair) for pair in pairs]
        assert np.abs(times - before).max() <= 8  # float32 is good to 2**-28 s below 0.125 s
        assert all(np.array_equal(*pair) for pair in others)
    part = 50 if "cut" in options else 25
    assert stamps["whole"]["sequence_0001/000001.mcap"] == [100, 200, 300]
    assert stamps["cut"]["sequence_0001/000000.mcap"] == [0, part]
    assert stamps["cut"]["sequence_0001/000001.mcap"] == [100, 100 + part, 200 + part, 300 + part]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("cut: front", r"recipe\.yaml:\d+: layout\.cut: expected 'pattern' or 'driver', got 'front'"),
        ("cut_deg: 400", r"recipe\.yaml:\d+: layout\.cut_deg: expected a value <= 360\.0, got 400"),
        ("cut_deg: .nan", r"recipe\.yaml:\d+: layout\.cut_deg: expected a value <= 360\.0, got nan"),
        ("cut: driver, cut_deg: 0", r"recipe\.yaml:\d+: layout: expected either cut or cut_deg, got both"),
    ],
)
def test_bad_cuts_of_bags(recipe: Path, options: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(recipe.read_text().replace("layout: semantickitti", f"layout: {{type: bags, {options}}}"))
    with pytest.raises(ls.errors.ConfigError, match=message):
        load(path)


def rigid_transform(transform: Any) -> RigidTransform:
    """A transform of ROS."""
    position, turn = transform.translation, transform.rotation
    return RigidTransform.from_components(
        [position.x, position.y, position.z], Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    )


GRID = ls.Lidar(ls.patterns.Grid([0.0, 0.1], [0.0, 0.1], rate=10.0))


def of_sensors(*names: str, pose: Any = None) -> Any:
    """A recipe of a rig that has sensors of these names."""

    def scenes(*_: object) -> tuple[ls.Scene, ls.Rig, Any]:
        scene = ls.Scene()
        scene.add(ls.Sphere((5, 0, 0), 1.0), label=1)
        return scene, ls.Rig(dict.fromkeys(names, (GRID, None))), pose

    return scenes


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "names",
    [("../x",), ("/x/y",), ("a/b",), ("a\0b",), ("a\nb",), ("e" * 65,), ("é",), (" ",), (".",), ("..",), ("a.b",),
     ("a\\b",), ("C:",), ("~",), ("con",), ("LPT1",), ("top", "TOP"), ("a", "b", "B")],
)  # fmt: skip
def test_names_of_sensors_that_files_cannot_have(tmp_path: Path, layout: str, names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"^sensors: expected ") as caught:
        ls.generate(of_sensors(*names), tmp_path / "data/out", layout=layout, pictures=0)
    assert str(caught.value).isprintable()
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("layout", sorted(set(LAYOUTS) - {"bags"}))
def test_imus_are_refused(tmp_path: Path, layout: str) -> None:
    (tmp_path / "recipe.yaml").write_text(
        "run:\n  scene: [{shape: plane, normal: [0, 0, 1], distance_m: -1}]\n"
        "  rig: {top: {sensor: {preset: sick-lms111}}, box: {imu: {rate_hz: 100}}}\n"
        f"frames: 1\nsequences: 1\nlayout: {layout}\n"
    )
    with pytest.raises(ls.errors.LidarsimError, match=r"rig\.box: expected a sensor, as data sets of"):
        ls.generate(tmp_path / "recipe.yaml", tmp_path / "out", pictures=0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_later_rig_with_such_a_name(tmp_path: Path, layout: str) -> None:
    def scenes(rng: np.random.Generator, sequence: int) -> Any:
        return of_sensors("../x" if sequence else "top")(rng, sequence)

    with pytest.raises(ls.errors.LidarsimError, match=r"1 shard failed; sequence 1, .*sensors: expected a name"):
        ls.generate(scenes, tmp_path / "out", sequences=2, shard_frames=1, layout=layout, pictures=0)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert not list((tmp_path / "out").rglob("x*"))


@pytest.mark.slow("sensors may have the names of notes of a data set")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_names_of_sensors_that_notes_have(tmp_path: Path, layout: str) -> None:
    """No name is reserved: notes are told from files of sensors by their exact names."""
    names = ["manifest", "pictures", "sequences", "samples", "shards", "start", "x" * 64]
    for _ in range(2):
        made = ls.generate(of_sensors(*names), tmp_path / "out", frames=2, layout=layout, pictures=1)
        assert made.shards_left == 0
        assert ls.datasets.verify(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("names", "message"), [(("a-b",), "letters, digits and _"), (("map", "a"), "other than those")]
)
def test_names_that_topics_cannot_have(tmp_path: Path, names: tuple[str, ...], message: str) -> None:
    with pytest.raises(ValueError, match=f"^sensors: expected .*{message}"):
        ls.generate(of_sensors(*names), tmp_path / "out", layout="bags", pictures=0)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", ["transform", "matrix", "list"])
def test_a_rig_that_stands_still(tmp_path: Path, layout: str, kind: str) -> None:
    pose = RigidTransform.from_translation([1.0, 2.0, 3.0])
    given = {"transform": pose, "matrix": pose.as_matrix(), "list": pose.as_matrix().tolist()}[kind]
    ls.generate(of_sensors("top", pose=given), tmp_path / "out", layout=layout, frames=2, pictures=0)
    assert ls.datasets.verify(tmp_path / "out") == []
    if layout == "nuscenes":
        (first, second) = json.loads((tmp_path / "out/v1.0-lidarsim/ego_pose.json").read_text())
        assert first["translation"] == second["translation"] == [1.0, 2.0, 3.0]
        assert first["rotation"] == [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("layout", "most"), [("nuscenes", 255), ("semantickitti", 65_535)])
def test_labels_that_a_layout_cannot_hold(tmp_path: Path, layout: str, most: int) -> None:
    def scenes(label: Any) -> Any:
        def make_scene(*_: object) -> Any:
            scene = ls.Scene()
            scene.add(ls.Sphere((5, 0, 0), 1.0), label=label)
            return scene, GRID, None

        return make_scene

    for beyond in (most + 1, 2**32 - 1):
        with pytest.raises(
            ValueError, match=f"^class_names: expected labels from 0 to {most} in {layout}, got {beyond}"
        ):
            ls.generate(scenes(1), tmp_path / "out", layout=layout, class_names={beyond: "sky"}, pictures=0)
        with pytest.raises(ValueError, match=f"^scene: expected labels from 0 to {most} in {layout}, got {beyond}"):
            ls.generate(scenes(beyond), tmp_path / "out", layout=layout, pictures=0)
    assert not any(tmp_path.iterdir())
    ls.generate(scenes(most), tmp_path / "out", layout=layout, class_names={most: "sky"}, pictures=0)
    if layout == "nuscenes":
        assert len(json.loads((tmp_path / "out/v1.0-lidarsim/category.json").read_text())) == 256


def test_colours_of_classes(recipe: Path, tmp_path: Path) -> None:
    """Each category has its colour, in the order of their indices, as the kit wants it."""
    make(recipe, tmp_path / "out", "nuscenes")
    colors = json.loads((tmp_path / "out/colormap.json").read_text())
    categories = json.loads((tmp_path / "out/v1.0-lidarsim/category.json").read_text())
    assert list(colors) == [row["name"] for row in sorted(categories, key=lambda row: row["index"])]
    assert all(len(color) == 3 and set(color) <= set(range(256)) for color in colors.values())
    assert "colormap=colors" in (tmp_path / "out/README.md").read_text()


def test_bags_have_the_samples_of_all_sensors_and_metadata(tmp_path: Path) -> None:
    (tmp_path / "recipe.yaml").write_text(
        "run:\n  scene: [{shape: plane, normal: [0, 0, 1], distance_m: -1}]\n"
        "  pose: {linear_m_per_s: [3, 0, 0]}\n"
        "  georeference: {origin: {latitude_deg: 48, longitude_deg: 11}}\n"
        "  rig: {top: {sensor: {pattern: {type: grid, azimuths_deg: [0, 5], elevations_deg: [-9, -4], rate_hz: 10}}},\n"
        "    box: {imu: {rate_hz: 100, gyroscope: {bias_deg_per_s: 1, noise_density_deg_per_s_per_sqrt_hz: 0.1}}},\n"
        "    roof: {gnss: {rate_hz: 5, position_sigma_m: 1}}}\n"
        "frames: 5\nshard_frames: 2\nsequences: 2\nlayout: bags\n"
    )
    ls.generate(tmp_path / "recipe.yaml", tmp_path / "out", pictures=0)
    assert ls.datasets.verify(tmp_path / "out") == []
    store = get_typestore(Stores.ROS2_HUMBLE)
    for sequence in range(2):
        folder = tmp_path / f"out/sequence_{sequence:04}"
        run = load(tmp_path / "recipe.yaml").source.run(sequence, 0)
        (samples,), (fixes,) = run.inertial().values(), run.fixes().values()
        assert len(samples) == 51
        about = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        files = sorted(path.name for path in folder.glob("*.mcap"))
        assert about["relative_file_paths"] == files
        assert len(files) == 3
        rates, latitudes, clouds = [], [], 0
        with Reader(folder) as bag:
            assert bag.message_count == sum(1 for _ in bag.messages([*bag.connections]))
            for connection, _, data in bag.messages([*bag.connections]):
                message: Any = store.deserialize_cdr(data, connection.msgtype)
                if connection.topic == "/box/data_raw":
                    rate = message.angular_velocity
                    rates.append([rate.x, rate.y, rate.z])
                elif connection.topic == "/roof/fix":
                    latitudes.append(message.latitude)
                clouds += connection.topic == "/top/points"
        np.testing.assert_array_equal(rates, samples.angular_rate)
        np.testing.assert_array_equal(latitudes, np.degrees(fixes.latitude))
        assert clouds == 5
        assert len(list(ls.io.rosbag.read(folder))) == 5
