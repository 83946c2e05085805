"""OpenPCDet's and MMDetection3D's custom data sets, held to what the code of these packages asks of files."""

from __future__ import annotations

import io
import pickle
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

import lidarsim as ls

NAMES = {1: "road", 2: "Car", 3: "Pedestrian", 4: "city-bus"}
LAYOUTS = "openpcdet", "mmdetection3d"


def around(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, ls.Trajectory]:
    """Boxes ahead, behind and tilted; the second sequence has none."""
    scene = ls.Scene(class_names=NAMES)
    scene.add(ls.Plane((0, 0, 1), 0.0), label=1)
    if sequence != 1:
        turn = Rotation.from_euler("zy", [rng.uniform(-180, 180), 10], degrees=True)
        scene.add(ls.Box((4, 2, 1.5), (0, 0, 0.9)), label=2, transform=RigidTransform.from_components((9, 3, 0), turn))
        scene.add(ls.Box((0.6, 0.6, 1.8), (-7, rng.uniform(-3, 3), 0.91)), label=3)
        scene.add(ls.Box((10, 2.5, 3), (2, -8, 1.6)), label=4)
    pose = RigidTransform.from_translation((0, 0, 1.9))
    return scene, ls.Lidar.preset("velodyne-vlp16"), ls.Trajectory.from_twist(pose, (3, 0, 0), (0, 0, 0.2))


def generate(folder: Path, layout: Any, **more: Any) -> Path:
    options: dict[str, Any] = {"sequences": 3, "frames": 2, "pictures": 0, "seed": 5, **more}
    ls.generate(around, folder, layout=layout, **options)
    return folder


@pytest.fixture(scope="module", params=LAYOUTS)
def layout(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    boxes = {"classes": ["Pedestrian", "Car", "city-bus"]}
    return {
        kind: generate(
            tmp_path_factory.mktemp(kind), {"type": kind, "boxes": boxes}, splits={"train": [0, 1], "val": [2]}
        )
        for kind in LAYOUTS
    }


def points_of(folder: Path, number: int) -> np.ndarray:
    npy = folder / f"points/{number:06}.npy"
    return np.load(npy) if npy.exists() else np.fromfile(npy.with_suffix(".bin"), np.float32).reshape(-1, 4)


def labels_of(folder: Path, number: int) -> tuple[np.ndarray, list[str]]:
    """Boxes and names as CustomDataset.get_label of OpenPCDet splits lines."""
    rows = [line.strip().split(" ") for line in (folder / f"labels/{number:06}.txt").read_text().splitlines()]
    return np.array([row[:-1] for row in rows], np.float32), [row[-1] for row in rows]


def inside(points: np.ndarray, box: np.ndarray, height: float) -> np.ndarray:
    """Which points are in a box whose origin is at a share of its height: turned by the heading about z."""
    local = points[:, :3].astype(float) - box[:3] - [0, 0, (0.5 - height) * box[5]]
    local = Rotation.from_euler("z", -float(box[6])).apply(local)
    return np.asarray((np.abs(local) <= np.asarray(box[3:6], float) / 2).all(axis=1))


def test_points_and_boxes_all_around(made: dict[str, Path], layout: str) -> None:
    height = {"openpcdet": 0.5, "mmdetection3d": 0.0}[layout]
    sides, frames = set(), ls.datasets.load(made[layout])
    for number in (0, 1, 4, 5):
        points, (boxes, names) = points_of(made[layout], number), labels_of(made[layout], number)
        assert points.dtype == np.float32
        assert points.shape[1] == 4
        assert len(points) > 10_000
        assert set(names) == {"Car", "Pedestrian", "city-bus"}
        assert boxes.shape == (3, 7)
        above = points[:, 2] > -1.85  # off the road
        assert above.sum() > 100
        held = np.array([inside(points, box, height) for box in boxes])
        assert held[:, above].any(axis=0).all()
        assert (held[:, above].sum(axis=1) >= 5).all()
        sides |= set(np.sign(boxes[:, 0]).tolist())
        walker = boxes[names.index("Pedestrian")]
        np.testing.assert_allclose(walker[3:6], [0.6, 0.6, 1.8], atol=1e-5)  # float32 and its allowance
        np.testing.assert_allclose(walker[2] + (0.5 - height) * 1.8, 0.91 - 1.9, atol=1e-5)
        told = frames[number].boxes
        assert told is not None
        for box in boxes:  # the front is where that of the box is, not its back
            (same,) = np.flatnonzero(np.abs(told.center[:, :2] - box[:2]).max(axis=1) < 1e-3)
            front = told.rotation[same, :2, 0] / np.linalg.norm(told.rotation[same, :2, 0])
            np.testing.assert_allclose([np.cos(box[6]), np.sin(box[6])], front, atol=1e-6)  # of float32
    assert sides == {-1.0, 1.0}  # behind, too


def test_the_sets_of_frames(made: dict[str, Path], layout: str) -> None:
    sets = {path.stem: path.read_text().split() for path in (made[layout] / "ImageSets").iterdir()}
    every = [f"{number:06}" for number in range(6)]
    assert sets == {"train": every[:4], "val": every[4:], "test": [], "trainval": every}
    suffix = {"openpcdet": "npy", "mmdetection3d": "bin"}[layout]
    assert sorted(path.name for path in (made[layout] / "points").iterdir()) == [f"{name}.{suffix}" for name in every]
    assert sorted(path.name for path in (made[layout] / "labels").iterdir()) == [f"{name}.txt" for name in every]


def test_openpcdet_reads_frames_without_boxes(made: dict[str, Path]) -> None:
    """Its get_infos takes columns of the array of boxes, which an empty file would make one-dimensional."""
    for number in (2, 3):
        boxes, names = labels_of(made["openpcdet"], number)
        assert boxes[:, :7].shape == (1, 7)
        assert names == ["DontCare"]  # which drop_info_with_name removes
        assert not boxes.any()


def test_openpcdet_configuration(made: dict[str, Path]) -> None:
    told = yaml.safe_load((made["openpcdet"] / "custom_dataset.yaml").read_text())
    names = ["Pedestrian", "Car", "city-bus"]
    assert told["DATASET"] == "CustomDataset"
    assert told["CLASS_NAMES"] == names  # in the order of the filter
    assert told["DATA_SPLIT"] == {"train": "train", "test": "val"}
    assert told["POINT_FEATURE_ENCODING"]["src_feature_list"] == ["x", "y", "z", "intensity"]
    assert told["MAP_CLASS_TO_KITTI"] == {
        "Pedestrian": "Pedestrian", "Car": "Car", "city-bus": "Truck", "DontCare": "DontCare",
    }  # fmt: skip
    low, high = np.reshape(told["POINT_CLOUD_RANGE"], (2, 3))
    voxel = np.array(next(step["VOXEL_SIZE"] for step in told["DATA_PROCESSOR"] if "VOXEL_SIZE" in step))
    cells = (high - low) / voxel
    # The guide: multiples of 16 in x and y, and 40 in z. Quotients of decimal numbers, to a few roundings.
    np.testing.assert_allclose(cells[:2] / 16, np.round(cells[:2] / 16), atol=1e-9)
    assert cells[2] == pytest.approx(40, abs=1e-9)
    for number in (0, 1, 4, 5):
        boxes, _ = labels_of(made["openpcdet"], number)
        assert (boxes[:, :3] - boxes[:, 3:6] / 2 >= low).all()
        assert (boxes[:, :3] + boxes[:, 3:6] / 2 <= high).all()
    (sampling,) = (step for step in told["DATA_AUGMENTOR"]["AUG_CONFIG_LIST"] if step["NAME"] == "gt_sampling")
    for line in (*sampling["SAMPLE_GROUPS"], *sampling["PREPARE"]["filter_by_min_points"]):
        name, count = line.split(":")  # as its sampler splits them
        assert name in names
        assert int(count) > 0


class Plain(pickle.Unpickler):
    """Reads plain values alone."""

    def find_class(self, module: str, name: str) -> Any:
        raise AssertionError(f"{module}.{name}")


def infos(folder: Path, split: str) -> Any:
    return Plain(io.BytesIO((folder / f"custom_infos_{split}.pkl").read_bytes())).load()


def test_without_splits_all_frames_are_to_train_with(tmp_path: Path, layout: str) -> None:
    generate(tmp_path, layout)
    sets = {path.stem: len(path.read_text().split()) for path in (tmp_path / "ImageSets").iterdir()}
    assert sets["train"] == sets["trainval"] > 1
    assert sets["val"] == sets["test"] == 0
    if layout == "mmdetection3d":
        assert [len(infos(tmp_path, split)["data_list"]) for split in ("train", "val", "test")] == [sets["train"], 0, 0]


def test_mmdetection3d_infos(made: dict[str, Path]) -> None:
    """What Det3DDataset.parse_data_info and parse_ann_info take from them."""
    folder, count = made["mmdetection3d"], 0
    names = ["Pedestrian", "Car", "city-bus"]
    for split, numbers in {"train": [0, 1, 2, 3], "val": [4, 5], "test": []}.items():
        found = infos(folder, split)
        assert set(found) == {"metainfo", "data_list"}
        assert found["metainfo"]["info_version"] == "1.1"
        assert found["metainfo"]["categories"] == {name: index for index, name in enumerate(names)}
        assert [info["sample_idx"] for info in found["data_list"]] == numbers
        for info in found["data_list"]:
            number = info["sample_idx"]
            points = np.fromfile(folder / "points" / info["lidar_points"]["lidar_path"], np.float32)
            points = points.reshape(-1, info["lidar_points"]["num_pts_feats"])
            np.testing.assert_array_equal(points, points_of(folder, number))
            boxes, kinds = labels_of(folder, number)
            assert len(info["instances"]) == len(boxes) == (0 if number in {2, 3} else 3)
            for instance, box, kind in zip(info["instances"], boxes, kinds, strict=True):
                assert set(instance) == {"bbox_3d", "bbox_label_3d", "num_lidar_pts"}
                np.testing.assert_array_equal(np.float32(instance["bbox_3d"]), box)
                assert names[instance["bbox_label_3d"]] == kind
                assert 0 < instance["num_lidar_pts"] <= inside(points, box, 0.0).sum()
                count += 1
    assert count == 12
    lines = runpy.run_path(str(folder / "custom.py"))
    assert lines["class_names"] == names
    assert lines["metainfo"] == {"classes": names}
    assert len(lines["point_cloud_range"]) == 6


def test_both_have_the_boxes_of_the_scan(made: dict[str, Path]) -> None:
    for number in (0, 5):
        (pcdet, names), (mmdet, same) = (labels_of(made[layout], number) for layout in LAYOUTS)
        assert names == same
        np.testing.assert_allclose(mmdet[:, 2], pcdet[:, 2] - pcdet[:, 5] / 2, rtol=0, atol=1e-6)  # float32 of 8 m
        np.testing.assert_array_equal(np.delete(mmdet, 2, axis=1), np.delete(pcdet, 2, axis=1))


def test_rigs_have_a_folder_per_sensor(tmp_path: Path, layout: str) -> None:
    def scene_rig_and_path(rng: np.random.Generator, sequence: int) -> Any:
        scene, lidar, path = around(rng, sequence)
        return scene, ls.Rig({"top": (lidar, np.eye(4)), "left": (lidar, np.eye(4))}), path

    ls.generate(scene_rig_and_path, tmp_path, layout=layout, frames=2, pictures=0)
    for sensor in ("top", "left"):
        assert (tmp_path / sensor / "ImageSets/train.txt").read_text().split() == ["000000", "000001"]
        assert len(labels_of(tmp_path / sensor, 1)[1]) == 3


def test_infos_are_the_same_bytes_each_time(tmp_path: Path, tree: Any, layout: str) -> None:
    first = tree(generate(tmp_path / "first", layout, sequences=2))
    for part in (1, 0):
        generate(tmp_path / "second", layout, sequences=2, part=(part, 2), shard_frames=1)
    second = tree(tmp_path / "second")
    own = {name for name in first if not name.startswith(("manifest", "recipe", "README"))}
    assert len(own) > 8
    assert {name: first[name] for name in own} == {name: second[name] for name in own}


def test_lost_tables_are_made_again(tmp_path: Path, tree: Any, layout: str) -> None:
    before = tree(generate(tmp_path, layout, sequences=1))
    lost = {"openpcdet": "custom_dataset.yaml", "mmdetection3d": "custom_infos_train.pkl"}[layout]
    (tmp_path / lost).unlink()
    generate(tmp_path, layout, sequences=1)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", ["a b", "DontCare", "", "a\nb", "a:b", "a/b"])
def test_class_names_that_labels_cannot_hold(tmp_path: Path, layout: str, name: str) -> None:
    if layout == "mmdetection3d" and name in {"a:b", "a/b"}:
        generate(tmp_path, layout, sequences=1, class_names={2: name})
        return
    with pytest.raises(ValueError, match=rf"class_names\[2\]: expected printable text without .* in {layout}, got"):
        generate(tmp_path, layout, sequences=1, class_names={2: name})
    generate(tmp_path, {"type": layout, "boxes": ["Pedestrian"]}, sequences=1, class_names={2: name})


def test_splits_of_other_names(tmp_path: Path, layout: str) -> None:
    generate(tmp_path, layout, splits={"train": [0], "dev": [1, 2]})
    assert (tmp_path / "ImageSets/dev.txt").read_text().split() == ["000002", "000003", "000004", "000005"]
    if layout == "mmdetection3d":
        assert [len(infos(tmp_path, split)["data_list"]) for split in ("train", "val", "test")] == [2, 0, 0]


def test_without_any_box(tmp_path: Path, layout: str) -> None:
    def bare(rng: np.random.Generator, sequence: int) -> Any:
        del sequence
        return around(rng, 1)

    ls.generate(bare, tmp_path, layout=layout, pictures=0)
    if layout == "openpcdet":
        told = yaml.safe_load((tmp_path / "custom_dataset.yaml").read_text())
        assert told["CLASS_NAMES"] == []
        assert told["POINT_CLOUD_RANGE"] == [-75.2, -75.2, -2.0, 75.2, 75.2, 4.0]
    else:
        assert infos(tmp_path, "train")["metainfo"]["categories"] == {}
