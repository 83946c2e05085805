"""Data sets, read back frame by frame."""

from __future__ import annotations

import functools
import json
import multiprocessing
import pickle
import shutil
import sys
import tracemalloc
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.datasets import recipe as recipes
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.sampling import samples
from lidarsim.errors import FileFormatError

RECIPE = """\
sequences: 3
frames: 2
seed: 4
shard_frames: 4
layout: {layout}
class_names: {{"10": Car, "40": road}}
splits: {{train: [0, 2], val: [1]}}
vary:
  scene.1.center_m.0: {{uniform: [6, 12]}}
run:
  sensor: {{preset: velodyne-vlp16}}
  pose: {{position_m: [100, 50, 1.5], linear_m_per_s: [3, 0, 0], angular_deg_per_s: [0, 0, 20]}}
  cloud: {{deskew: {deskew}}}
  scene:
    - {{shape: plane, normal: [0, 0, 1], label: 40}}
    - {{shape: box, center_m: [8, 0, 1], size_m: [4, 2, 1.5], label: 10, position_m: [100, 50, 0]}}
"""
GRID = "{type: grid, azimuths_deg: [-5, 0, 5], elevations_deg: [-20, -15, -10, -5], rate_hz: 5}"
SIDE = f"{{sensor: {{pattern: {GRID}}}}}"
RIG = f"rig: {{top: {{sensor: {{preset: velodyne-vlp16}}, position_m: [1, 0, 1]}}, side: {SIDE}}}"
FIELDS = ["label", "instance", "ring", "intensity"]
OPTIONS: dict[str, Any] = {"shards": {"type": "shards", "boxes": True, "fields": FIELDS}}


def write(folder: Path, layout: str) -> Path:
    path = folder / f"{layout}.yaml"
    deskew = "false" if layout in {"bags", "semantickitti"} else "start"
    path.write_text(RECIPE.format(layout=json.dumps(OPTIONS.get(layout, layout)), deskew=deskew))
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A data set of each layout."""

    @functools.cache
    def make(layout: str) -> tuple[Path, Path]:
        folder = tmp_path_factory.mktemp(layout)
        path = write(folder, layout)
        ls.generate(path, folder / "out", pictures=0)
        return path, folder / "out"

    return make


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_read_back(made: Any, layout: str) -> None:
    path, out = made(layout)
    recipe = recipes.load(path)
    frames = ls.datasets.load(out)
    assert isinstance(frames, Sequence)
    assert len(frames) == 6
    assert frames.layout == recipe.layout
    boxed = 0
    for number, frame in enumerate(frames):
        sequence, k = divmod(number, 2)
        assert (frame.sequence, frame.frame, frame.sensor) == (sequence, k, "")
        assert frame.split == ("val" if sequence == 1 else "train")
        run = recipe.source.run(sequence, k)
        scans = list(run.scans())[k]
        (sample,) = samples(recipe, run, sequence, k, scans)
        assert len(frame.cloud) == len(sample.cloud) > 1000
        # Layouts hold float32 coordinates, bags steps of at most 2⁻⁹ m (a vendor's unit of 2 mm).
        tolerance = 2**-9 if layout == "bags" else 2.0**-24 * np.abs(sample.cloud.xyz).max()
        np.testing.assert_allclose(frame.cloud.xyz, sample.cloud.xyz, rtol=0, atol=tolerance)
        np.testing.assert_array_equal(frame.pose, sample.record.matrix)
        np.testing.assert_array_equal(frame.body, sample.record.body_matrix)
        assert frame.time == sample.record.seconds
        if layout in {"semantickitti", "nuscenes", "shards"}:
            np.testing.assert_array_equal(frame.cloud.label, sample.cloud.label)
            assert frame.cloud.class_names == {10: "Car", 40: "road"}
        assert (frame.boxes is None) == (recipe.layout.box_filter is None)
        if frame.boxes is not None:
            truth = scans[""].boxes(deskew="start", min_points=1)
            assert frame.boxes.in_sensor_frame
            np.testing.assert_array_equal(frame.boxes.center, truth.center)
            np.testing.assert_array_equal(frame.boxes.velocity, truth.velocity)
            np.testing.assert_array_equal(frame.boxes.instance, truth.instance)
            assert frame.boxes.label.tolist() == [10]
            assert frame.boxes.contain(frame.cloud.xyz).sum() >= truth.points[0] > 0
            boxed += 1
    assert boxed == (6 if recipe.layout.box_filter is not None else 0)


def test_splits(made: Any) -> None:
    _, out = made("kitti")
    numbers = {
        split: [frame.sequence for frame in ls.datasets.load(out, split=split)] for split in ("train", "val", None)
    }
    assert numbers == {"train": [0, 0, 2, 2], "val": [1, 1], None: [0, 0, 1, 1, 2, 2]}
    for split in ("test", 3, ""):
        with pytest.raises(ValueError, match="split: expected None or one of 'train', 'val', got"):
            ls.datasets.load(out, split=split)  # type: ignore[arg-type]


def test_items_and_slices(made: Any) -> None:
    frames = ls.datasets.load(made("semantickitti")[1])
    assert frames[-1].sequence == frames[np.int64(5)].sequence == 2
    assert [frame.sequence for frame in frames[1::2]] == [0, 1, 2]
    assert len(frames[2:4]) == 2
    assert "array" not in repr(frames)
    for index in (6, -7):
        with pytest.raises(IndexError, match="expected less than 6 frames"):
            frames[index]
    with pytest.raises(TypeError, match="index: expected an integer or a slice, got 'a'"):
        frames["a"]  # type: ignore[call-overload]


def total(frames: Any, index: int) -> tuple[int, float]:
    cloud = frames[index].cloud
    return len(cloud), float(cloud.xyz.sum())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_it_can_be_pickled_and_forked(made: Any, layout: str) -> None:
    frames = ls.datasets.load(made(layout)[1])
    data = pickle.dumps(frames)
    assert len(data) < 5_000  # no points
    here = [total(frames, index) for index in range(6)]
    assert [total(pickle.loads(data), index) for index in range(6)] == here  # noqa: S301
    if "fork" in multiprocessing.get_all_start_methods():
        with ProcessPoolExecutor(2, multiprocessing.get_context("fork")) as pool:
            assert list(pool.map(functools.partial(total, frames), range(6))) == here


def test_nothing_is_read_before_it_is_asked_for(made: Any, tmp_path: Path) -> None:
    shutil.copytree(made("kitti")[1], tmp_path / "out")
    shutil.rmtree(tmp_path / "out/training/velodyne")
    frames = ls.datasets.load(tmp_path / "out")
    assert len(frames) == 6
    with pytest.raises(FileFormatError, match=r"000000\.bin: No such file"):
        frames[0]
    assert not [name for name in sys.modules if name.partition(".")[0] == "torch"]


def test_range_images(made: Any) -> None:
    frame = ls.datasets.load(made("shards")[1])[0]
    ranges, labels = frame.image(size=(16, 1800)), frame.image("label", size=(16, 1800))
    assert ranges.shape == labels.shape == (16, 1800)
    seen = np.isfinite(ranges)
    assert seen.sum() > 5_000
    assert (labels[~seen] == 0).all()
    distance = np.linalg.norm(frame.cloud.xyz.astype(float), axis=1)
    assert ranges[seen].min() == distance.min()
    assert set(ranges[seen]) <= set(distance)
    # The box is ahead: x forward is in the middle of the image, and y, to the left, on the left.
    columns = np.nonzero(labels == 10)[1]
    car = frame.cloud.xyz[frame.cloud.label == 10]
    azimuth = np.arctan2(car[:, 1], car[:, 0])
    np.testing.assert_allclose(
        [columns.min(), columns.max()], 900 - np.array([azimuth.max(), azimuth.min()]) * 900 / np.pi, atol=1.5
    )
    # The highest points are in the first row, and the lowest in the last.
    rows = np.nonzero(seen)[0]
    assert (rows.min(), rows.max()) == (0, 15)
    # Each pixel shows the nearest of its points.
    coarse = frame.image(size=(1, 1))
    assert coarse[0, 0] == distance.min()
    low, high = np.radians([-5.0, 2.0])
    limited = frame.image(size=(16, 1800), elevations=(low, high))
    elevation = np.arcsin(frame.cloud.xyz[:, 2] / distance)
    inside = (elevation >= low) & (elevation <= high)
    assert 0 < np.isfinite(limited).sum() <= inside.sum() < len(distance)
    assert set(limited[np.isfinite(limited)]) <= set(distance[inside])
    bad: dict[str, dict[str, Any]] = {
        "field: expected one of .*, got 'colour'": {"field": "colour"},
        r"size\[0\]: expected": {"size": (0, 4)},
        r"size: expected \(rows, columns\)": {"size": 5},
        r"elevations: expected \(least, greatest\)": {"elevations": (0.1, 0.0)},
    }
    for problem, options in bad.items():
        with pytest.raises((TypeError, ValueError), match=problem):
            frame.image(**options)


def test_world_coordinates(made: Any, tmp_path: Path) -> None:
    path = write(tmp_path, "shards")
    ls.generate(path, tmp_path / "out", pictures=0, overrides=["run.cloud.frame=world"])
    for world, local in zip(ls.datasets.load(tmp_path / "out"), ls.datasets.load(made("shards")[1]), strict=True):
        assert world.boxes is not None
        assert not world.boxes.in_sensor_frame
        # 100 m in float32 have steps of 2⁻¹⁷ m; a turn adds a few roundings of that size.
        np.testing.assert_allclose(world.cloud.xyz, local.cloud.transformed(local.pose).xyz, atol=2**-15)
        np.testing.assert_allclose(world.image(), local.image(), atol=2**-10)
        break


def test_rigs(tmp_path: Path) -> None:
    path = write(tmp_path, "shards")
    text = path.read_text()
    path.write_text(text.replace("sensor: {preset: velodyne-vlp16}", RIG))
    for layout in LAYOUTS:
        out = tmp_path / layout
        ls.generate(path, out, layout=layout, pictures=0)
        frames = ls.datasets.load(out)
        assert len(frames) == 3 * (2 + 1)  # the second sensor has half the rate
        assert [frame.sensor for frame in frames] == ["top", "side", "top"] * 3
        sizes = {frame.sensor: len(frame.cloud) for frame in frames}
        assert sizes["side"] <= 12 < sizes["top"]


def test_points_in_bags_are_raw(tmp_path: Path) -> None:
    """Whatever a recipe says of deskewing: points, notes, card and the resolved recipe agree."""
    path = write(tmp_path, "kitti")
    path.write_text(path.read_text().replace("deskew: start", "deskew: middle"))
    overrides = ["layout=bags", "sequences=1", "splits={}"]
    ls.generate(path, tmp_path / "out", overrides=overrides, pictures=0)
    loaded = recipes.load(tmp_path / "out/recipe.yaml")
    assert "deskew" not in loaded.text()
    assert "not deskewed" in (tmp_path / "out/README.md").read_text()
    run = recipes.load(path, overrides).source.run(0)
    assert run.cloud["deskew"] is False
    for frame, scans in zip(ls.datasets.load(tmp_path / "out"), run.scans(), strict=True):
        (scan,) = scans.values()
        assert frame.time == scan.time
        assert isinstance(scan.pose, ls.Trajectory)
        np.testing.assert_array_equal(frame.pose, scan.pose.at(scan.time).as_matrix())
        np.testing.assert_array_equal(frame.cloud.xyz, scan.point_cloud().xyz.astype(np.float32))


def test_bags_with_a_cut_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "bags")
    ls.generate(path, tmp_path / "out", layout={"type": "bags", "cut": "driver"}, pictures=0)
    with pytest.raises(FileFormatError, match="expected bags whose messages are frames, got bags with a cut"):
        ls.datasets.load(tmp_path / "out")


def test_object_stores(made: Any) -> None:
    fsspec = pytest.importorskip("fsspec")
    path, out = made("semantickitti")
    url = "memory://loading-test"
    try:
        ls.generate(path, url, pictures=0)
        for near, far in zip(ls.datasets.load(out), ls.datasets.load(url), strict=True):
            np.testing.assert_array_equal(near.cloud.xyz, far.cloud.xyz)
            np.testing.assert_array_equal(near.cloud.label, far.cloud.label)
    finally:
        fsspec.filesystem("memory").rm("/loading-test", recursive=True)


def test_a_function_makes_it(tmp_path: Path) -> None:
    def scenes(rng: np.random.Generator, number: int) -> Any:
        del number
        scene = ls.Scene()
        scene.add(ls.Sphere((rng.uniform(5, 10), 0, 0), 1.0), label=1)
        return scene, ls.Lidar.preset("velodyne-vlp16"), None

    ls.generate(scenes, tmp_path / "out", layout="shards", frame="world", pictures=0)
    frames = ls.datasets.load(tmp_path / "out")
    assert not frames[0].cloud._in_sensor_frame
    with pytest.raises(ValueError, match="split: expected None without splits, got 'train'"):
        ls.datasets.load(tmp_path / "out", split="train")


def test_large_sets_are_held_in_little_memory(made: Any) -> None:
    out = made("shards")[1]
    ls.datasets.load(out)
    tracemalloc.start()
    frames = ls.datasets.load(out)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert frames._places.nbytes == len(frames) * 24
    assert held < 200_000


def copy_to_damage(made: Any, tmp_path: Path, layout: str = "kitti") -> Path:
    shutil.copytree(made(layout)[1], tmp_path / "out")
    return tmp_path / "out"


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("manifest.jsonl", None, "expected a complete data set of lidarsim.generate, got no manifest.jsonl"),
        ("recipe.yaml", None, "recipe.yaml: expected the recipe of the data set, got none"),
        ("recipe.yaml", b"layout: kitti", "recipe.yaml: expected the recipe of the data set, got another"),
        ("manifest/000000.json", None, "000000.json: expected the notes of the shard, got another file or none"),
        ("manifest/000001.json", b"{}", "000001.json: expected the notes of the shard, got another file or none"),
    ],
)
def test_damaged_notes(made: Any, tmp_path: Path, name: str, change: bytes | None, said: str) -> None:
    out = copy_to_damage(made, tmp_path)
    (out / name).unlink()
    if change is not None:
        (out / name).write_bytes(change)
    with pytest.raises(FileFormatError, match=said) as caught:
        ls.datasets.load(out)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("layout", sorted(LAYOUTS.keys()))
def test_damaged_points(made: Any, tmp_path: Path, layout: str) -> None:
    out = copy_to_damage(made, tmp_path, layout)
    suffixes = {".bin", ".npy", ".tar", ".mcap"}
    files = [path for path in out.rglob("*") if path.suffix in suffixes]
    assert files
    for path in files:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    frames = ls.datasets.load(out)
    with pytest.raises(FileFormatError, match="sequence 2, frame 1") as caught:
        frames[-1]
    assert "\n" not in str(caught.value)


def test_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="expected a complete data set"):
        ls.datasets.load(tmp_path / "none")
    with pytest.raises(TypeError):
        ls.datasets.load(3)  # type: ignore[arg-type]


def test_it_is_a_data_set_of_pytorch(made: Any) -> None:
    data = pytest.importorskip("torch.utils.data")
    frames = ls.datasets.load(made("shards")[1])
    loader = data.DataLoader(frames, batch_size=None, num_workers=2, shuffle=True)
    assert sorted(frame.sequence for frame in loader) == [0, 0, 1, 1, 2, 2]
