"""Places of data sets: one in an object store is the same as in a folder; the store is moto's, a server of its own."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim._base import files
from lidarsim.datasets.store import Folder, Store, open_store
from lidarsim.errors import LidarsimError


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    s3fs = pytest.importorskip("s3fs")
    server.start()
    try:
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name, value in {
            "ACCESS_KEY_ID": "test",
            "SECRET_ACCESS_KEY": "test",
            "DEFAULT_REGION": "us-east-1",
        }.items():
            monkeypatch.setenv(f"AWS_{name}", value)
        s3fs.S3FileSystem.clear_instance_cache()
        name = tmp_path.name.replace("_", "-")  # moto keeps its buckets from one server to the next
        s3fs.S3FileSystem().mkdir(name)
        yield f"s3://{name}"
        s3fs.S3FileSystem.clear_instance_cache()
    finally:
        server.stop()


def test_s3(recipe: Path, tmp_path: Path, bucket: str, tree: Callable[[Path], dict[str, str]]) -> None:
    s3fs = pytest.importorskip("s3fs")
    for layout in ("semantickitti", "shards"):
        make = partial(ls.generate, recipe, layout=layout, frames=2, shard_frames=2, pictures=0)
        make(tmp_path / layout)
        url = f"{bucket}/{layout}/one"
        assert [make(url, part=(part, 2)).shards_left for part in (1, 0)] == [2, 0]
        assert make(url).frames == 0
        files = s3fs.S3FileSystem()
        files.invalidate_cache()
        there = {
            f"s3://{name}".removeprefix(f"{url}/"): hashlib.sha256(files.cat_file(name)).hexdigest()
            for name in files.find(url)
        }
        assert there == tree(tmp_path / layout)
        assert ls.datasets.verify(url) == []
        name = next(name for name in there if name.endswith((".bin", ".tar")))
        files.pipe_file(f"{url}/{name}", b"other")
        assert [problem.partition(":")[0] for problem in ls.datasets.verify(url)] == [name]


def test_a_failed_put_leaves_nothing(bucket: str) -> None:
    store = open_store(f"{bucket}/x")
    with pytest.raises(RuntimeError, match="half"), store.writing("a/b.bin") as path:  # noqa: PT012 - while it is written
        path.write_bytes(b"0")
        raise RuntimeError("half written")
    assert store.sizes("a") == {}
    store.write("a/b.bin", b"1")
    assert store.sizes("a") == {"b.bin": 1}
    store.remove("a/none.bin")
    store.remove("a/b.bin")
    assert store.sizes("a") == {}


def test_files_of_a_batch_are_on_disk_before_one_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"a/{number}" for number in range(20)]
    flushed: list[bytes] = []

    def sync(path: Path, real: Callable[[Path], None] = files.sync) -> None:
        assert not any((tmp_path / name).exists() for name in names)
        real(path)
        flushed.append(path.read_bytes())

    monkeypatch.setattr(files, "sync", sync)
    with open_store(tmp_path).batch() as store:
        for name in names[1:]:
            store.write(name, name.encode())
        with store.writing(names[0]) as path:
            path.write_bytes(names[0].encode())
        assert not flushed
    assert sorted(flushed) == sorted(name.encode() for name in names)
    assert {name: (tmp_path / name).read_bytes() for name in names} == {name: name.encode() for name in names}
    assert {path.name for path in tmp_path.iterdir()} == {"a"}


@pytest.mark.parametrize("fails", ["write", "sync"])
def test_a_batch_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str) -> None:
    def refuse(path: Path) -> None:
        if path.read_bytes() == b"3":
            raise OSError(28, "No space left on device")

    def write(store: Store) -> None:
        for number in range(5):
            store.write(f"a/{number}", str(number).encode())
            if fails == "write" and number == 3:
                raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "sync", refuse)
    (tmp_path / "a").mkdir()
    (tmp_path / "a/0").write_bytes(b"before")
    with pytest.raises(OSError, match="a/3: .*No space left" if fails == "sync" else "No space left"):  # noqa: SIM117
        with open_store(tmp_path).batch() as store:
            write(store)
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")} == {"a", "a/0"}
    assert (tmp_path / "a/0").read_bytes() == b"before"


AT_THE_END = """
import atexit, sys
from concurrent.futures import thread  # its exit handler runs before that of atexit
from lidarsim.datasets.store import open_store

def write():
    with open_store(sys.argv[1]).batch() as store:
        store.write("a", b"last")

atexit.register(write)
"""


def test_a_batch_is_written_while_the_interpreter_ends(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", AT_THE_END, str(tmp_path)], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert (tmp_path / "a").read_bytes() == b"last"


def test_a_batch_stays_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a").symlink_to(tmp_path)
    with open_store(tmp_path / "out").batch() as store, pytest.raises(LidarsimError, match="inside of the data set"):
        store.write("a/b", b"")
    assert not (tmp_path / "b").exists()


def test_files_of_several_pieces(tmp_path: Path) -> None:
    store, data = Folder(tmp_path / "out"), np.random.default_rng(0).bytes(2 * files.PIECE + 5)
    store.write("a", data)
    assert store.create("b", data)
    with store.batch() as batch:
        batch.write("c", data)
        batch.write("d", data[: files.PIECE])
        batch.write("e", b"")
    assert [(tmp_path / "out" / name).read_bytes() for name in "abcde"] == [data] * 3 + [data[: files.PIECE], b""]


def test_one_of_many_creates_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = open_store(tmp_path)
    assert store.create("a/b", b"1")
    assert not open_store(tmp_path).create("a/b", b"2")
    assert (tmp_path / "a/b").read_bytes() == b"1"

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")  # as file systems without links do

    monkeypatch.setattr(os, "link", refuse)
    assert store.create("a/c", b"1")
    assert not store.create("a/c", b"2")
    assert (tmp_path / "a/c").read_bytes() == b"1"
    assert {path.name for path in tmp_path.rglob("*")} == {"a", "b", "c"}


def test_one_of_many_creates_an_object(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    s3fs = pytest.importorskip("s3fs")
    store = open_store(f"{bucket}/x")
    assert store.create("a/b", b"1")
    assert not store.create("a/b", b"2")
    monkeypatch.setattr(s3fs.S3FileSystem, "exists", lambda *_: False)  # both have looked before
    assert not store.create("a/b", b"2")
    real = s3fs.S3FileSystem.pipe_file

    def unconditional(self: Any, path: str, data: bytes, mode: str = "overwrite") -> None:
        if mode == "create":
            raise NotImplementedError("conditional puts")
        real(self, path, data)

    monkeypatch.setattr(s3fs.S3FileSystem, "pipe_file", unconditional)
    assert store.create("a/c", b"1")
    with store.open("a/b") as file:
        assert file.read() == b"1"


def test_two_recipes_in_one_bucket(recipe: Path, bucket: str) -> None:
    url = f"{bucket}/x"
    ls.generate(recipe, url, part=(0, 3), pictures=0)
    with pytest.raises(LidarsimError, match=r"another recipe\.yaml"):
        ls.generate(recipe, url, seed=8, pictures=0)
    other = f"{bucket}/y"
    open_store(other).write("README.md", b"mine")
    with pytest.raises(LidarsimError, match=r"expected an empty place .* got 'README\.md'"):
        ls.generate(recipe, other, pictures=0)
    assert open_store(other).sizes("manifest") == {}


@pytest.mark.parametrize(
    "name",
    ["../x", "/x", "a/../../x", "a/./b", "a//b", "", ".", "..", "a\0b", "a\nb", "C:x", "a\\b", "\ud800", "x" * 300,
     "x/" * 600 + "x"],
)  # fmt: skip
def test_no_file_is_outside(tmp_path: Path, name: str) -> None:
    for store in (open_store(tmp_path / "out"), open_store("memory://x")):
        calls: tuple[Callable[[Store], object], ...] = (
            lambda store: store.write(name, b""),
            lambda store: store.create(name, b""),
            lambda store: store.writing(name).__enter__(),
            lambda store: store.open(name),
        )
        for call in calls:
            with pytest.raises(ValueError, match="expected the relative path of a file of the data set"):
                call(store)
    assert not any(tmp_path.iterdir())


def test_a_link_leads_nowhere_else(tmp_path: Path) -> None:
    store, outside = open_store(tmp_path / "out"), tmp_path / "outside"
    outside.mkdir()
    (outside / "x").write_bytes(b"mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a").symlink_to(outside)
    (tmp_path / "out/x").symlink_to(outside / "x")
    calls: tuple[Callable[[], object], ...] = (
        lambda: store.write("a/x", b""),
        lambda: store.create("a/y", b""),
        lambda: store.open("a/x"),
        lambda: store.open("x"),
        lambda: store.sizes("a"),
        lambda: store.remove("a/x"),
    )
    for call in calls:
        with pytest.raises(LidarsimError, match="expected it inside of the data set, got a link to"):
            call()
    store.write("x", b"1")
    assert (tmp_path / "out/x").read_bytes() == b"1"
    assert [path.read_bytes() for path in outside.iterdir()] == [b"mine"]


def test_a_place_may_be_a_link_itself(recipe: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    ls.generate(recipe, tmp_path / "out", pictures=0)
    assert ls.datasets.verify(tmp_path / "disk") == []


@pytest.mark.parametrize(
    ("output", "error"),
    [(None, TypeError), (b"x", TypeError), (5, TypeError), (["x"], TypeError), ("", ValueError), ("a\0b", ValueError),
     (Path("s3://bucket/x"), ValueError), ("s3:/bucket/x", ValueError), (Path("file:///x"), ValueError),
     ("file://", ValueError), ("file://x", ValueError)],
)  # fmt: skip
def test_outputs_that_are_none(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, output: Any, error: type[Exception]
) -> None:
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    for call in (partial(ls.generate, recipe, pictures=0), ls.datasets.verify):
        with pytest.raises(error, match=r"^output: expected "):
            call(output)  # type: ignore[operator]
    assert sorted(tmp_path.iterdir()) == before


def test_a_url_that_nobody_knows(recipe: Path) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises((OSError, LidarsimError), match=r"^nowhere://x: "):
        ls.generate(recipe, "nowhere://x", pictures=0)


def test_urls_of_folders(tmp_path: Path) -> None:
    assert open_store(f"file://{tmp_path}/x") == open_store(f"{tmp_path}/x") == Folder(tmp_path / "x")
