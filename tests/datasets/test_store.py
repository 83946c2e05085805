"""A data set in an object store is the same as in a folder; the store is moto's, a server of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

import lidarsim as ls
from lidarsim.datasets.store import open_store


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
    assert store.names("a") == set()
    store.write("a/b.bin", b"1")
    assert store.names("a") == {"b.bin"}
    store.remove("a", ["b.bin", "none.bin"])
    assert store.names("a") == set()
