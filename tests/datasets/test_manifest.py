"""Notes of data sets: those of others are judged before they are believed, and nothing foreign is touched."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import lidarsim as ls
from lidarsim.datasets import manifest
from lidarsim.datasets.store import open_store
from lidarsim.errors import FileFormatError, LidarsimError

Tree = Callable[[Path], dict[str, str]]

LAYOUTS = ("semantickitti", "nuscenes", "shards", "bags")

make = functools.partial(ls.generate, pictures=0)


def manifest_of(head: str, *lines: str) -> list[str]:
    """A manifest of other lines, whose head fits them."""
    text = "".join(f"{line}\n" for line in lines)
    told = json.loads(head) | {"files": len(lines), "lines": hashlib.sha256(text.encode()).hexdigest()}
    return [json.dumps(told), *lines]


def lines_of(out: Path) -> list[str]:
    return (out / "manifest.jsonl").read_text().splitlines()


def write(out: Path, lines: list[str]) -> None:
    (out / "manifest.jsonl").write_text("".join(f"{line}\n" for line in lines))


@pytest.fixture(scope="module")
def originals(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data sets that `out` and `half` copy."""
    place = tmp_path_factory.mktemp("originals")
    assert make(shared, place / "out").frames == 12
    assert make(shared, place / "half", part=(0, 3)).frames == 5
    return place


@pytest.fixture
def out(originals: Path, tmp_path: Path) -> Path:
    """A complete data set."""
    return shutil.copytree(originals / "out", tmp_path / "out")


@pytest.fixture
def half(originals: Path, tmp_path: Path) -> Path:
    """A data set whose first of three shards is made."""
    return shutil.copytree(originals / "half", tmp_path / "half")


def test_a_cut_manifest_is_noticed(out: Path) -> None:
    head, *lines = lines_of(out)
    for kept in (lines[:-1], lines[1:], lines[:1], lines * 2, [*lines[1:], lines[0]], [*lines[:-1], lines[-1] + " "]):
        write(out, [head, *kept])
        what = (
            "they changed" if len(kept) == len(lines) else f"expected {len(lines)} files, got {len(kept)}: it was cut"
        )
        with pytest.raises(FileFormatError, match=rf"manifest\.jsonl: .*{what}"):
            ls.datasets.verify(out)
    whole = "".join(f"{line}\n" for line in [head, *lines])
    for size in (0, 1, len(head) - 1, len(head), len(head) + 1, len(head) + 20, len(whole) // 2, len(whole) - 1):
        (out / "manifest.jsonl").write_text(whole[:size])
        with pytest.raises(FileFormatError, match=r"manifest\.jsonl"):
            ls.datasets.verify(out)
    write(out, [head, *lines])
    assert ls.datasets.verify(out) == []


def test_a_changed_recipe_is_noticed(out: Path) -> None:
    (out / "recipe.yaml").write_text((out / "recipe.yaml").read_text().replace("seed: 7", "seed: 8"))
    (problem,) = ls.datasets.verify(out)
    assert problem.startswith("recipe.yaml: expected SHA-256 ")
    (out / "recipe.yaml").unlink()
    (problem,) = ls.datasets.verify(out)
    assert problem.endswith("got no file")


def test_an_older_manifest_without_a_count_is_read(out: Path, shared: Path) -> None:
    head, *lines = lines_of(out)
    older = {key: value for key, value in json.loads(head).items() if key not in {"files", "lines"}}
    write(out, [json.dumps(older), *lines])
    assert ls.datasets.verify(out) == []
    assert make(shared, out).shards_left == 0
    write(out, [json.dumps(older)])
    with pytest.raises(FileFormatError, match="expected 1 file, got 0"):
        ls.datasets.verify(out)


@pytest.mark.parametrize(
    "name",
    ["/dev/zero", "../secret", "a/../../secret", ".", "", "a//b", "a/", "a\0b", "x" * 5000, "x" * 300, "\x1b[2Jx",
     "C:x", "a\\b", 5, None, ["a"]],
)  # fmt: skip
def test_names_that_lead_elsewhere(out: Path, name: Any) -> None:
    head, *lines = lines_of(out)
    write(out, manifest_of(head, *lines, json.dumps({"file": name, "sha256": "0" * 64, "bytes": 1})))
    with pytest.raises(FileFormatError, match=rf"manifest\.jsonl: line {len(lines) + 2}: ") as caught:
        ls.datasets.verify(out)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("line", ["[" * 100_000, "{", "[]", "null", "1" * 100_000, '{"file": "\\ud800"}', "\xff", ""])
def test_lines_that_are_none(out: Path, line: str) -> None:
    head, *lines = lines_of(out)
    write(out, manifest_of(head, *lines, line))
    with pytest.raises(FileFormatError, match=rf"manifest\.jsonl: line {len(lines) + 2}: damaged"):
        ls.datasets.verify(out)


def test_a_line_without_an_end(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest, "LINE", 1000)
    write(out, [*lines_of(out)[:3], '{"file": "' + "x" * 2000])
    with pytest.raises(FileFormatError, match="expected lines of at most 1,000 bytes"):
        ls.datasets.verify(out)


def test_what_is_no_regular_file_is_not_read(out: Path, tmp_path: Path) -> None:
    """None of these hangs, and none is taken for the file."""
    secret = tmp_path / "secret"
    secret.write_bytes(b"1")
    file = out / "sequences/00/velodyne/000000.bin"
    shutil.copy(file, tmp_path / "copy")

    def bind() -> None:
        with socket.socket(socket.AF_UNIX) as server:
            os.chdir(file.parent)
            server.bind(file.name)

    here = Path.cwd()
    try:
        for place in (
            lambda: os.mkfifo(file),
            file.mkdir,
            lambda: file.symlink_to("/dev/zero"),
            lambda: file.symlink_to(tmp_path / "copy"),  # the right content, outside
            lambda: file.symlink_to(file.name),
            lambda: file.symlink_to("nowhere"),
            bind,
        ):
            file.unlink(missing_ok=True)
            place()
            (problem,) = ls.datasets.verify(out)
            assert problem.startswith("sequences/00/velodyne/000000.bin: expected SHA-256 ")
            assert "\n" not in problem
            if file.is_dir():
                file.rmdir()
    finally:
        os.chdir(here)
    file.unlink()
    file.symlink_to("../velodyne/000000.copy")  # a link that stays inside
    shutil.copy(tmp_path / "copy", file.with_suffix(".copy"))
    assert ls.datasets.verify(out) == []
    shutil.move(out / "sequences", tmp_path / "sequences")
    (out / "sequences").symlink_to(tmp_path / "sequences")
    assert "got a file that cannot be read" in ls.datasets.verify(out)[0]


@pytest.mark.slow("damaged or endless notes of a data set end in documented errors")
def test_a_file_that_grows_without_end_is_not_read_to_it(out: Path) -> None:
    file = out / "sequences/00/velodyne/000000.bin"
    os.truncate(file, 1 << 42)  # a hole that takes no place
    os.truncate(out / "recipe.yaml", 1 << 42)
    for name, problem in zip(("recipe.yaml", "sequences/00/velodyne/000000.bin"), ls.datasets.verify(out), strict=True):
        assert problem.startswith(f"{name}: expected")


def test_notes_that_grow_without_end_are_not_read(half: Path, shared: Path) -> None:
    os.truncate(half / "manifest/000000.json", 1 << 42)
    assert make(shared, half).frames == 12
    os.truncate(half / "manifest.jsonl", 1 << 42)
    with pytest.raises(FileFormatError, match="expected lines of at most"):
        ls.datasets.verify(half)


@pytest.mark.parametrize("name", ["start.json", "000000.json"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "link"])
def test_notes_that_are_no_files(half: Path, shared: Path, tmp_path: Path, name: str, kind: str) -> None:
    note = half / "manifest" / name
    content = note.read_bytes()
    note.unlink()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(content)
    {"pipe": os.mkfifo, "folder": Path.mkdir, "link": lambda path: path.symlink_to(elsewhere)}[kind](note)
    if name == "000000.json" and kind != "folder":
        assert make(shared, half).frames == 12  # it was not believed
        assert ls.datasets.verify(half) == []
        assert elsewhere.read_bytes() == content
    else:
        with pytest.raises(LidarsimError, match=f"{name}: "):
            make(shared, half)
        assert os.path.lexists(note)


@pytest.mark.slow("parts of another data set are refused")
def test_a_part_of_another_shard_recipe_or_size(
    originals: Path, half: Path, shared: Path, whole: dict[str, str], tree: Tree
) -> None:
    part = json.loads((half / "manifest/000000.json").read_text())
    record = part["records"][0]
    turned = record | {"pose": [0.0] * 12}
    for other in (
        part | {"shard": 1},
        part | {"recipe": "0" * 64},
        part | {"records": part["records"][1:]},
        part | {"records": []},
        part | {"records": [record, *part["records"]][:-1]},
        part | {"records": [record | {"sensor": "../x"}, *part["records"][1:]]},
        part | {"records": [turned, *part["records"][1:]]},
        part | {"records": [record | {"extra": {}}, *part["records"][1:]]},
        part | {"records": [record | {"seconds": 1e300}, *part["records"][1:]]},
        part | {"labels": {"4294967295": 1}},
        part | {"labels": {"-1": 1}},
        part | {"ranges": [1]},
        part | {"files": [part["files"][0] | {"file": "../x"}]},
        part | {"files": [part["files"][0] | {"bytes": -1}]},
        part | {"more": 1},
    ):
        shutil.rmtree(half)
        shutil.copytree(originals / "half", half)
        (half / "manifest/000000.json").write_text(json.dumps(other))
        assert make(shared, half).frames == 12, other
        assert tree(half) == whole


def test_a_foreign_part_is_left_alone(half: Path, shared: Path) -> None:
    foreign = [half / "manifest" / name for name in ("999999.json", "²².json", "0000001.json", "notes.txt")]
    for file in foreign:
        file.write_text("{}")
    assert make(shared, half, part=(1, 3)).shards_left == 1
    assert make(shared, half).shards_left == 0
    own = [half / "manifest" / f"{name}.json" for name in ("start", "000000", "000001", "000002")]
    assert sorted((half / "manifest").iterdir()) == sorted(foreign + own)
    assert ls.datasets.verify(half) == []


@pytest.mark.parametrize("data", [b"", b'{"rec', b'{"recipe": "00', b"[]", b"\xff", b"[" * 100_000])
def test_a_damaged_start(
    shared: Path, tmp_path: Path, whole: dict[str, str], tree: Tree, half: Path, data: bytes
) -> None:
    """One that a kill cut before anything else was made is made anew; any other is told."""
    out = tmp_path / "out"
    (out / "manifest").mkdir(parents=True)
    (out / "manifest/start.json").write_bytes(data)
    if b'{"recipe"'.startswith(data[:9]):
        make(shared, out)
        assert tree(out) == whole
    else:
        with pytest.raises(FileFormatError, match=r"start\.json: damaged: .*; choose another place"):
            make(shared, out)
    (half / "manifest/start.json").write_bytes(data)
    before = tree(half)
    with pytest.raises(FileFormatError, match=r"start\.json: damaged: .*; choose another place"):
        make(shared, half)
    assert tree(half) == before


def test_a_changed_recipe_is_not_resumed(half: Path, shared: Path) -> None:
    (half / "recipe.yaml").write_text("mine")
    with pytest.raises(LidarsimError, match=r"recipe\.yaml: expected the recipe of the data set"):
        make(shared, half)
    assert (half / "recipe.yaml").read_text() == "mine"
    (half / "recipe.yaml").unlink()
    assert make(shared, half).shards_left == 0
    assert ls.datasets.verify(half) == []


OWN = {
    "semantickitti": ("sequences", "semantic-kitti.yaml"),
    "nuscenes": ("v1.0-lidarsim", "samples", "lidarseg", "maps", "colormap.json"),
    "shards": ("shards", "index.parquet"),
    "bags": ("sequence_0000", "sequence_0002"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_no_data_set_wrote_is_neither_replaced_nor_removed(
    shared: Path, tmp_path: Path, tree: Tree, layout: str
) -> None:
    out = tmp_path / "out"
    foreign = {"notes.txt", "data", "sequence_0003", ".hidden"}
    for name in foreign:
        (out / name).mkdir(parents=True)
        (out / name / "mine").write_text("mine")
    (out / "empty").mkdir()
    for name in ("manifest", "manifest.jsonl", "recipe.yaml", "README.md", "readme.MD", "pictures", *OWN[layout]):
        for content in ("mine", None):
            path = out / name
            if content:
                path.mkdir()
                (path / "thesis.txt").write_text(content)
            else:
                path.symlink_to("/nowhere")
            before = tree(out)
            with pytest.raises(
                LidarsimError, match=f"expected an empty place .* got '{name}'|{name}.* got a (link|folder)"
            ):
                make(shared, out, layout=layout)
            assert tree(out) == before
            assert not list(out.glob(".lidarsim*"))
            shutil.rmtree(path) if content else path.unlink()
    (out / "manifest").mkdir()
    make(shared, out, layout=layout)
    assert ls.datasets.verify(out) == []
    assert {path.name for path in out.iterdir()} >= foreign


def test_a_link_as_folder_of_notes(shared: Path, tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    for _ in range(2):
        (out / "manifest").symlink_to(elsewhere)
        with pytest.raises(LidarsimError, match="manifest"):
            make(shared, out)
        (out / "manifest").unlink()
        assert not any(elsewhere.iterdir())
    make(shared, out, part=(0, 3))
    shutil.move(out / "manifest", elsewhere / "manifest")
    (out / "manifest").symlink_to(elsewhere / "manifest")
    with pytest.raises(LidarsimError, match=r"start\.json: expected it inside of the data set, got a link"):
        make(shared, out)
    assert len(list((elsewhere / "manifest").iterdir())) == 2


def test_a_link_as_folder_of_a_layout(half: Path, shared: Path, tmp_path: Path) -> None:
    shutil.move(half / "sequences", tmp_path / "elsewhere")
    (half / "sequences").symlink_to(tmp_path / "elsewhere")
    before = sorted((tmp_path / "elsewhere").rglob("*"))
    with pytest.raises(LidarsimError, match="expected it inside of the data set, got a link"):
        make(shared, half)
    assert sorted((tmp_path / "elsewhere").rglob("*")) == before


def test_a_link_in_place_of_a_file_is_replaced_not_followed(half: Path, shared: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for name in ("sequences/02/velodyne/000003.bin", "manifest/000002.json", "README.md", "semantic-kitti.yaml"):
        (half / name).parent.mkdir(parents=True, exist_ok=True)
        (half / name).symlink_to(mine)
    make(shared, half)
    assert mine.read_text() == "mine"
    assert ls.datasets.verify(half) == []
    assert not [path for path in half.rglob("*") if path.is_symlink()]


@functools.cache
def notes(layout: str, folder: Path) -> tuple[Path, dict[str, bytes]]:
    """A small recipe, and the files of its data set when half of it is made; the manifest is that of all."""
    recipe = folder / "recipe.yaml"
    rig = "{top: {sensor: *s}, low: {sensor: *s, position_m: [0, 0, 1]}}"
    recipe.write_text(
        f"""
layout: {layout}
frames: 2
shard_frames: 1
run:
  rig: {rig.replace("*s", "{pattern: {type: grid, azimuths_deg: [0, 5], elevations_deg: [-9, -4], rate_hz: 5}}")}
  pose: {{position_m: [0, 0, 1]}}
  scene: [{{shape: sphere, center_m: [5, 0, 1], radius_m: 2, label: 1}}]
"""
    )
    files = {}
    for name, part in (("whole", (0, 1)), ("half", (0, 2))):
        out = folder / name
        make(recipe, out, part=part)
        files |= {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()}
    return recipe, files


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.just(2**63) | st.just("../x"),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(max_size=8), children, max_size=3),
    max_leaves=4,
)


def mutate(data: st.DataObject, value: Any) -> Any:
    """A document that differs in one place."""
    if isinstance(value, dict | list) and value and data.draw(st.integers(0, 9)):
        key = data.draw(st.sampled_from(sorted(value) if isinstance(value, dict) else range(len(value))))
        copy = value.copy()
        if data.draw(st.integers(0, 9)):
            copy[key] = mutate(data, value[key])
        else:
            del copy[key]
        return copy
    return data.draw(json_values)


@pytest.mark.slow("damaged or endless notes of a data set end in documented errors")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_damaged_notes_end_in_nothing_but_documented_errors(
    layout: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("notes")
    recipe, files = notes(layout, folder)
    seen = {"resumed": 0, "refused": 0, "verified": 0, "found": 0}

    @given(st.data())
    def damage(data: st.DataObject) -> None:
        name = data.draw(
            st.sampled_from(["manifest/start.json", "manifest/000000.json", "manifest.jsonl", "recipe.yaml"])
        )
        content = files[name]
        how = data.draw(st.sampled_from(["nothing", "bytes", "cut", "flipped", "json"]))
        if how == "bytes":
            content = data.draw(st.binary(max_size=20))
        elif how == "cut":
            content = content[: data.draw(st.integers(0, len(content)))]
        elif how == "flipped":
            place = data.draw(st.integers(0, len(content) - 1))
            content = content[:place] + bytes([content[place] ^ data.draw(st.integers(1, 255))]) + content[place + 1 :]
        elif how == "json" and name != "recipe.yaml":
            lines = content.splitlines()
            number = data.draw(st.integers(0, len(lines) - 1))
            lines[number] = json.dumps(mutate(data, json.loads(lines[number]))).encode()
            content = b"\n".join(lines) + b"\n"
        complete = name == "manifest.jsonl" or data.draw(st.booleans())
        out = folder / "damaged"
        shutil.rmtree(out, ignore_errors=True)
        for path, whole in files.items():
            if path != "manifest.jsonl" or complete:
                (out / path).parent.mkdir(parents=True, exist_ok=True)
                (out / path).write_bytes(content if path == name else whole)
        try:
            seen["found" if ls.datasets.verify(out) else "verified"] += 1
        except LidarsimError as error:
            assert str(error).isprintable()  # noqa: PT017
        try:
            made = make(recipe, out)
        except LidarsimError as error:
            seen["refused"] += 1
            assert str(error).isprintable()  # noqa: PT017
        else:
            seen["resumed"] += 1
            assert made.shards_left == 0
        assert {path.name for path in folder.iterdir()} <= {"damaged", "half", "whole", "recipe.yaml"}

    damage()
    assert min(seen.values()) > 0, seen


def test_done_counts_parts_by_their_exact_names(half: Path) -> None:
    for name in ("1.json", "0000000001.json", "000001.JSON", "000002.json.tmp"):
        (half / "manifest" / name).write_text("{}")
    assert manifest.finished_shards(open_store(half)) == {0}
