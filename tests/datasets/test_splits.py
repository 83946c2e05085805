"""Splits: which sequence is in which, and how layouts and notes tell."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import lidarsim as ls
from lidarsim.datasets.recipe import load
from lidarsim.datasets.splits import Splits, check_splits

SHARES = {"train": 0.7, "val": 0.2, "test": 0.1}


@given(st.integers(1, 2000), st.integers(1, 500))
def test_more_sequences_do_not_move_the_others(count: int, more: int) -> None:
    splits = Splits(SHARES)
    few, many = splits.sequences(count), splits.sequences(count + more)
    assert all(many[name][: len(few[name])] == few[name] for name in SHARES)
    assert sorted(number for numbers in many.values() for number in numbers) == [*range(count + more)]


@given(st.integers(0, 10**6), st.integers(1, 5000), st.floats(0.01, 0.99))
def test_every_run_of_sequences_is_divided_by_the_shares(first: int, count: int, share: float) -> None:
    """Kuipers and Niederreiter, Uniform Distribution of Sequences, 2.3.4, whose K is 1 for the golden ratio."""
    splits = Splits({"train": share, "val": 1.0 - share})
    found = sum(splits.of(sequence) == "train" for sequence in range(first, first + count))
    golden = (1 + math.sqrt(5)) / 2
    assert abs(found - share * count) <= 3 + (1 / math.log(golden) + 1 / math.log(2)) * math.log(count)


def test_the_documented_example() -> None:
    """By hand: frac(n 0.618034) is 0, 0.618, 0.236, 0.854, 0.472, 0.090, 0.708, 0.326, 0.944, 0.562."""
    assert Splits({"train": 0.8, "val": 0.2}).sequences(10) == {"train": [0, 1, 2, 4, 5, 6, 7, 9], "val": [3, 8]}
    assert Splits({"a": 0.5, "b": 0.25, "c": 0.25}).sequences(10) == {"a": [0, 2, 4, 5, 7], "b": [1, 6, 9], "c": [3, 8]}


def test_shares_that_floats_cannot_hold() -> None:
    for shares in ([0.7, 0.2, 0.1], [0.1] * 10, [1 / 3] * 3, [1 / 49] * 49):
        given = {f"s{index}": share for index, share in enumerate(shares)}
        assert check_splits(given, 5) == given


def test_splits_without_sequences_are_named(caplog: pytest.LogCaptureFixture) -> None:
    check_splits({"train": 0.8, "val": 0.2}, 4)
    assert not caplog.messages
    check_splits({"train": 0.8, "val": 0.2}, 3)
    assert caplog.messages == ["splits: none of 3 sequences is in val; more sequences, or lists of them, give it some"]


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ("{train: 0.8, val: 0.3}", r"splits: expected shares that sum to 1, got 1\.1"),
        ("{train: 0.8}", r"splits: expected shares that sum to 1, got 0\.8"),
        ("{train: 0.5, val: 0.4999999999999}", r"splits: expected shares that sum to 1"),
        ("{train: 1.5, val: -0.5}", r"splits\.train: expected a share, 0 to 1, or a list .*got 1\.5"),
        ("{train: true}", r"splits\.train: expected a share, 0 to 1, or a list .*got True"),
        ("{train: .nan, val: 1}", r"splits\.train: expected a share"),
        ("{train: [0, 1], val: 0.5}", r"splits: expected either shares or lists of sequences, got both"),
        ("{train: [0, 1], val: [2, 3]}", r"splits\.val: expected numbers of sequences, 0 to 2, got 3"),
        ("{train: [0, 1], val: [-1]}", r"splits\.val: expected numbers of sequences, 0 to 2, got -1"),
        ("{train: [0, 1, 1], val: [2]}", r"splits\.train: expected each sequence once, got 1 twice"),
        ("{train: [0, 1], val: [1, 2]}", r"splits\.val: expected each sequence once, got 1 in train too"),
        ("{train: [0], val: [2]}", r"splits: expected each of the 3 sequences in a split, got none for 1"),
        ("{train: [0, 1, x]}", r"splits\.train: expected a share, 0 to 1, or a list"),
        ("{../train: 1.0}", r"splits: expected a name of letters"),
        ("{train: 0.5, Train: 0.5}", r"splits: expected names that differ in more than case"),
        ("{train: 0.5, train: 0.5}", r"train: this key is already on line"),
        ("[train, val]", r"splits: expected a mapping"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_their_line(recipe: Path, splits: str, message: str) -> None:
    recipe.write_text(recipe.read_text() + f"splits: {splits}\n")
    line = len(recipe.read_text().splitlines())
    with pytest.raises(ls.errors.ConfigError, match=message) as caught:
        load(recipe)
    assert str(caught.value).startswith(f"{recipe}:{line}: ")
    assert "\n" not in str(caught.value)


def test_mistakes_of_a_call(tmp_path: Path) -> None:
    for splits, message in (
        ({"train": 0.5}, r"^splits: expected shares that sum to 1, got 0\.5$"),
        ({"train": [1]}, r"^splits\.train: expected numbers of sequences, 0 to 0, got 1$"),
    ):
        with pytest.raises(ValueError, match=message):
            ls.generate(balls, tmp_path, splits=splits, pictures=0)
    with pytest.raises(TypeError, match=r"^splits: expected a mapping from names to shares or lists"):
        ls.generate(balls, tmp_path, splits=[0.5, 0.5], pictures=0)  # type: ignore[arg-type]
    assert not any(tmp_path.iterdir())


def balls(*_: object) -> Any:
    scene = ls.Scene(class_names={1: "Ball"})
    scene.add(ls.Sphere((5, 0, 0), 1.0), label=1)
    return scene, ls.Lidar(ls.patterns.Grid([0.0, 0.1], [0.0, 0.1], rate=10.0)), None


LISTS = {"train": [0, 3], "val": [1], "test": [2]}


def test_layouts_write_them_as_their_tools_read_them(tmp_path: Path) -> None:
    for layout in ("semantickitti", "nuscenes", "kitti", "shards"):
        ls.generate(
            balls, tmp_path / layout, sequences=4, frames=2, layout=layout, splits=LISTS, shard_frames=3, pictures=0
        )
        assert ls.datasets.verify(tmp_path / layout) == []
    kit = yaml.safe_load((tmp_path / "semantickitti/semantic-kitti.yaml").read_text())
    assert kit["split"] == {"train": [0, 3], "valid": [1], "test": [2]}
    scenes = json.loads((tmp_path / "nuscenes/v1.0-lidarsim/splits.json").read_text())
    assert scenes == {
        "lidarsim_train": ["scene-0000", "scene-0003"], "lidarsim_val": ["scene-0001"], "lidarsim_test": ["scene-0002"]
    }  # fmt: skip
    sets = {path.name: path.read_text().split() for path in (tmp_path / "kitti/ImageSets").iterdir()}
    assert sets == {
        "train.txt": ["000000", "000001", "000006", "000007"], "val.txt": ["000002", "000003"],
        "test.txt": ["000004", "000005"],
        "trainval.txt": ["000000", "000001", "000002", "000003", "000006", "000007"],
    }  # fmt: skip
    for folder, names in (("training", sets["trainval.txt"]), ("testing", sets["test.txt"])):
        for kind in ("velodyne", "label_2", "calib", "image_2"):
            assert sorted(path.stem for path in (tmp_path / "kitti" / folder / kind).iterdir()) == names
    parquet = pytest.importorskip("pyarrow.parquet")
    index = parquet.read_table(tmp_path / "shards/index.parquet").to_pylist()
    assert [row["split"] for row in index] == ["train"] * 2 + ["val"] * 2 + ["test"] * 2 + ["train"] * 2
    card = (tmp_path / "shards/README.md").read_text()
    assert "| train | 2 | 4 | 0, 3 |\n| val | 1 | 2 | 1 |\n| test | 1 | 2 | 2 |\n" in card


def test_without_splits_all_is_for_training(tmp_path: Path) -> None:
    ls.generate(balls, tmp_path, sequences=2, layout="kitti", pictures=0)
    sets = {path.stem: path.read_text().split() for path in (tmp_path / "ImageSets").iterdir()}
    assert sets == {"train": ["000000", "000001"], "val": [], "test": [], "trainval": ["000000", "000001"]}
    assert "Splits" not in (tmp_path / "README.md").read_text()


def test_a_recipe_keeps_its_splits(recipe: Path, tmp_path: Path) -> None:
    recipe.write_text(recipe.read_text() + "splits: {train: 0.5, val: 0.5}\n")
    made = load(recipe)
    assert made.splits.sequences(3) == {"train": [0, 2], "val": [1]}
    again = tmp_path / "again.yaml"
    again.write_text(made.text())
    assert load(again).splits == made.splits
