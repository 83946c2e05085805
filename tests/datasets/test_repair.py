"""Lost, truncated and altered files of data sets come back byte for byte by the same command."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.datasets import engine
from lidarsim.datasets.layouts import LAYOUTS
from lidarsim.datasets.sampling import samples
from lidarsim.errors import LidarsimError

Tree = Callable[[Path], dict[str, str]]

SPLITS = {"train": [0, 1], "val": [2]}


def one_of_each_kind(out: Path) -> list[Path]:
    """Return a file of each folder and suffix, the last of those that sort first by name."""
    files = sorted(path for path in out.rglob("*") if path.is_file())
    return [*{(path.parent, path.suffix, path.parent == out and path.name): path for path in files}.values()]


def alter(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.slow("every kind of file that is lost or damaged is made again")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_kind_of_file_comes_back(recipe: Path, tmp_path: Path, tree: Tree, layout: str) -> None:
    out = tmp_path / "out"
    make: dict[str, Any] = {"layout": layout, "splits": SPLITS, "pictures": 0}
    ls.generate(recipe, out, **make)
    whole = tree(out)
    kinds = one_of_each_kind(out)
    assert len(kinds) >= 6
    damages: list[tuple[Callable[[Path], object], bool]] = [
        (Path.unlink, False),
        (lambda path: path.write_bytes(path.read_bytes()[:-1]), False),
        (alter, True),
    ]
    for damage, verify in damages:
        for path in kinds:
            damage(path)
            assert tree(out) != whole
            made = ls.generate(recipe, out, **make, verify=verify)
            assert tree(out) == whole, path
            assert made.shards_left == 0
            name = path.relative_to(out).as_posix()
            assert name in made.made_again or (name, damage) == ("manifest.jsonl", Path.unlink)
    assert ls.datasets.verify(out) == []
    assert ls.generate(recipe, out, **make, verify=True) == ls.datasets.Generated(0, 0, 0.0, 0)


def test_only_the_shard_of_a_lost_file_is_measured_again(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, cast = tmp_path / "out", []
    ls.generate(recipe, out, pictures=0)
    monkeypatch.setattr(engine, "samples", lambda *key: cast.append(key[2:4]) or samples(*key))
    (out / "sequences/02/velodyne/000003.bin").unlink()
    made = ls.generate(recipe, out, pictures=0)
    assert (cast, made.frames) == ([(2, 2), (2, 3)], 2)
    (out / "README.md").unlink()  # tables are made from the notes
    (out / "semantic-kitti.yaml").unlink()
    made = ls.generate(recipe, out, pictures=0)
    assert (len(cast), made.frames, made.made_again) == (2, 0, ("semantic-kitti.yaml", "README.md"))
    assert tree(out) == whole


def test_what_many_parts_share_comes_back_at_once(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str]
) -> None:
    out = tmp_path / "out"
    ls.generate(recipe, out, pictures=0)
    for folder in ("sequences", "manifest"):
        shutil.rmtree(out / folder)
        assert ls.generate(recipe, out, pictures=0).frames == 12
        assert tree(out) == whole
    shutil.rmtree(out / "sequences/01")
    (out / "manifest.jsonl").unlink()
    ls.generate(recipe, out, pictures=0)
    assert tree(out) == whole


def test_files_of_an_incomplete_data_set_come_back(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str]
) -> None:
    """A note alone is no proof: the part may be done and a file of it lost."""
    out = tmp_path / "out"
    for damage, verify in ((Path.unlink, False), (alter, True)):
        shutil.rmtree(out, ignore_errors=True)
        ls.generate(recipe, out, part=(0, 3), pictures=0)
        damage(out / "sequences/00/labels/000001.label")
        made = ls.generate(recipe, out, pictures=0, verify=verify)
        assert made.made_again == ("sequences/00/labels/000001.label",)
        assert tree(out) == whole


def test_parts_make_their_own_lost_files(recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str]) -> None:
    out = tmp_path / "out"
    ls.generate(recipe, out, pictures=0)
    for sequence in (0, 2):
        (out / f"sequences/{sequence:02}/velodyne/000003.bin").unlink()
    (out / "README.md").unlink()
    left = [ls.generate(recipe, out, part=(part, 3), pictures=0).shards_left for part in (0, 1, 2)]
    assert left == [1, 1, 0]
    assert tree(out) == whole


@pytest.mark.slow("pictures that are lost are drawn again")
def test_pictures_come_back(recipe: Path, tmp_path: Path, tree: Tree) -> None:
    out = tmp_path / "out"
    ls.generate(recipe, out, layout="shards", pictures=1)
    whole = tree(out)
    picture = min((out / "pictures").iterdir())  # one of two, from two cameras
    picture.unlink()
    made = ls.generate(recipe, out, layout="shards", pictures=3)  # a complete data set keeps its number
    assert made.made_again == (picture.relative_to(out).as_posix(),)
    assert tree(out) == whole


def test_files_of_an_object_store_come_back(recipe: Path) -> None:
    files, url = fsspec.filesystem("memory"), "memory://repaired"
    ls.generate(recipe, url, layout="shards", pictures=0)
    whole = {name: files.cat(name) for name in files.find(url)}
    names = [name for name in whole if not name.endswith("/manifest.jsonl")]
    assert len(names) >= 8
    for name in names:
        for content in (None, whole[name][:-1]):
            files.rm(name) if content is None else files.pipe_file(name, content)
            ls.generate(recipe, url, layout="shards", pictures=0)
            assert {name: files.cat(name) for name in files.find(url)} == whole
    files.rm(url, recursive=True)


def test_a_function_that_changed_its_data_is_told(tmp_path: Path) -> None:
    """What is made again must have the hash in the manifest."""
    radius = tmp_path / "radius"  # files that a function reads are not compared
    radius.write_text("1")

    def scenes(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Lidar, None]:  # noqa: ARG001
        scene = ls.Scene()
        scene.add(ls.Sphere((5, 0, 0), float(radius.read_text())))
        return scene, ls.Lidar.preset("velodyne-vlp16"), None

    ls.generate(scenes, tmp_path / "out", sequences=2, pictures=0)
    (tmp_path / "out/shards/000001.tar").unlink()
    radius.write_text("2")
    with pytest.raises(LidarsimError, match=r"1 file made again, but not as in the manifest: shards/000001\.tar: exp"):
        ls.generate(scenes, tmp_path / "out", sequences=2, pictures=0)


def test_the_command_line_says_what_was_made_again(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*arguments: object) -> str:
        with pytest.raises(SystemExit) as end:
            main(["generate", *map(str, arguments), "-o", str(tmp_path / "out")])
        printed = capsys.readouterr()
        return f"{end.value.code} {printed.out}{printed.err}"

    run(recipe, "--pictures", "0")
    (tmp_path / "out/sequences/01/poses.txt").unlink()
    assert "made again: sequences/01/poses.txt" in run(recipe)
    alter(tmp_path / "out/sequences/01/velodyne/000002.bin")
    assert "made again" not in run(recipe)
    told = run("--verify")
    assert told.startswith("2 ")
    assert "--verify` makes them again" in told
    assert "made again: sequences/01/velodyne/000002.bin" in run(recipe, "--verify")
    assert "all files match the manifest" in run(recipe, "--verify")
    assert "all files match the manifest" in run("--verify")
