"""Data sets that are killed at any moment, or made by several calls at once: the same bytes, and nothing left over."""

from __future__ import annotations

import itertools
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import lidarsim as ls
from lidarsim.datasets.store import open_store
from lidarsim.errors import LidarsimError

LAYOUTS = ("semantickitti", "nuscenes", "shards", "bags")
"""Those with files of a sample, of a sequence, of a shard, and with tables over all of them."""

pytestmark = pytest.mark.slow("processes that write one data set at the same time lose and damage nothing")

WORKER = """
import json, sys
import lidarsim as ls

print("ready", flush=True)
for line in sys.stdin:
    recipe, out, options = json.loads(line)
    try:
        answer = ["made", ls.generate(recipe, out, pictures=0, **options).shards_left]
    except Exception as error:
        answer = [type(error).__name__, str(error)]
    print(json.dumps(answer), flush=True)
"""


class Worker:
    """A process that makes data sets when it is told to."""

    def __init__(self) -> None:
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
        self.process = subprocess.Popen([sys.executable, "-c", WORKER], **pipes)
        self.read_line()

    def tell(self, recipe: Path, out: Path, **options: Any) -> None:
        assert self.process.stdin
        self.process.stdin.write(json.dumps([str(recipe), str(out), options]) + "\n")

    def read_line(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline()

    def answer(self) -> list[Any]:
        line = self.read_line()
        assert line, "the process has ended"
        answer: list[Any] = json.loads(line)
        return answer

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="module")
def two() -> Iterator[list[Worker]]:
    workers = [Worker(), Worker()]
    yield workers
    for worker in workers:
        worker.kill()


def files(folder: Path) -> dict[str, bytes | None]:
    """All that is in a folder; None for the content of a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_killed_at_random_moments(shared: Path, tmp_path: Path, slow: bool, layout: str) -> None:
    options: dict[str, Any] = {"layout": layout, "shard_frames": 1}
    moments = random.Random(layout)
    worker = Worker()
    worker.tell(shared, tmp_path / "whole", **options)
    assert worker.answer() == ["made", 0]
    whole = files(tmp_path / "whole")
    kills = interrupted = 0
    while kills < (40 if slow else 4):
        out = tmp_path / f"out{kills}"
        for _ in range(moments.choice((1, 1, 2))):
            worker.tell(shared, out, **options)
            wait_for(out, moments.randint(0, len(whole)))
            time.sleep(moments.uniform(0, 0.01))
            worker.kill()
            kills += 1
            interrupted += out.exists() and not (out / "manifest.jsonl").exists()
            worker = Worker()
        worker.tell(shared, out, **options)
        assert worker.answer() == ["made", 0]
        assert files(out) == whole
        assert ls.datasets.verify(out) == []
    worker.kill()
    assert interrupted > 0


def wait_for(out: Path, count: int) -> None:
    """Wait until a data set has so many files and folders, or is complete."""
    until = time.monotonic() + 60
    while sum(len(folders) + len(names) for _, folders, names in os.walk(out)) < count:
        if (out / "manifest.jsonl").exists():
            return
        assert time.monotonic() < until


@pytest.mark.parametrize("layout", LAYOUTS)
def test_two_recipes_at_once(shared: Path, tmp_path: Path, slow: bool, two: list[Worker], layout: str) -> None:
    """One of them is refused, before it has written anything."""
    whole = {}
    for seed in (7, 8):
        ls.generate(shared, tmp_path / f"whole{seed}", layout=layout, seed=seed, pictures=0)
        whole[seed] = files(tmp_path / f"whole{seed}")
    for number in range(100 if slow else 3):
        out = tmp_path / f"out{number}"
        for worker, seed in zip(two, (7, 8), strict=True):
            worker.tell(shared, out, layout=layout, seed=seed)
        answers = dict(zip((7, 8), [worker.answer() for worker in two], strict=True))
        (winner,) = [seed for seed, answer in answers.items() if answer == ["made", 0]]
        (refused,) = [answer for seed, answer in answers.items() if seed != winner]
        assert refused[0] == "LidarsimError"
        assert "expected an empty place or one with the same recipe, got another recipe.yaml there" in refused[1]
        assert files(out) == whole[winner]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("parts", [1, 2], ids=["the same", "parts"])
def test_one_recipe_at_once(
    shared: Path, tmp_path: Path, slow: bool, two: list[Worker], layout: str, parts: int
) -> None:
    """All of it twice, or parts that end together: each ends well, and whoever ends last leaves nothing over."""
    ls.generate(shared, tmp_path / "whole", layout=layout, shard_frames=6, pictures=0)
    whole = files(tmp_path / "whole")
    for number in range(100 if slow else 3):
        out = tmp_path / f"out{number}"
        for part, worker in enumerate(two):
            worker.tell(shared, out, layout=layout, shard_frames=6, part=(part % parts, parts))
        answers = [worker.answer() for worker in two]
        assert {what for what, _ in answers} == {"made"}, answers
        assert 0 in [left for _, left in answers]
        assert files(out) == whole


@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_of_two_is_killed(shared: Path, tmp_path: Path, slow: bool, layout: str) -> None:
    """The other is not held up by it, and removes what it left."""
    moments = random.Random(layout)
    ls.generate(shared, tmp_path / "whole", layout=layout, shard_frames=1, pictures=0)
    whole = files(tmp_path / "whole")
    for number in range(20 if slow else 1):
        out = tmp_path / f"out{number}"
        killed, other = Worker(), Worker()
        for worker in (killed, other):
            worker.tell(shared, out, layout=layout, shard_frames=1)
        wait_for(out, moments.randint(0, len(whole) // 2))
        killed.kill()
        complete = (out / "manifest.jsonl").exists()
        assert other.answer() == ["made", 0]
        if complete:  # perhaps the other had tidied up before the kill; then the next call does
            other.tell(shared, out, layout=layout, shard_frames=1)
            assert other.answer() == ["made", 0]
        other.kill()
        assert files(out) == whole


def test_late_writers(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another call completes the data set and tidies up between any two steps of this one."""
    from lidarsim.datasets import engine, manifest, run

    ls.generate(shared, tmp_path / "whole", shard_frames=6, pictures=0)
    whole = files(tmp_path / "whole")
    places = ((run, "make"), (engine, "make_shard"), (manifest, "write_part"), (run, "_finish"), (manifest, "finish"),
              (manifest, "missing_shards"), (manifest, "finished_shards"))  # fmt: skip
    for module, name in places:
        for moment in ("before", "after"):
            out = tmp_path / f"{name}-{moment}"
            real = getattr(module, name)
            left = [moment]

            def late(*arguments: Any, real: Any = real, left: list[str] = left, out: Path = out, **more: Any) -> Any:
                now = left.pop() if left else ""
                if now == "before":
                    ls.generate(shared, out, shard_frames=6, pictures=0)
                result = real(*arguments, **more)
                if now == "after":
                    ls.generate(shared, out, shard_frames=6, pictures=0)
                return result

            with monkeypatch.context() as patch:
                patch.setattr(module, name, late)
                made = ls.generate(shared, out, shard_frames=6, pictures=0)
            assert (made.shards_left, left) == (0, []), (name, moment)
            assert files(out) == whole, (name, moment)


def test_a_foreign_manifest_that_comes_meanwhile(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lidarsim.datasets import manifest

    out = tmp_path / "out"
    ls.generate(shared, tmp_path / "other", seed=8, pictures=0)
    real = manifest.write_part
    for content in (b"mine", (tmp_path / "other/manifest.jsonl").read_bytes()):

        def late(*arguments: Any, content: bytes = content) -> None:
            real(*arguments)
            (out / "manifest.jsonl").write_bytes(content)

        with monkeypatch.context() as patch:
            patch.setattr(manifest, "write_part", late)
            with pytest.raises(LidarsimError, match=r"manifest\.jsonl: |another data set was made here"):
                ls.generate(shared, out, pictures=0)
        assert (out / "manifest.jsonl").read_bytes() == content
        (out / "manifest.jsonl").unlink()
        assert (out / "manifest/start.json").exists()
    assert ls.generate(shared, out, pictures=0).shards_left == 0
    assert ls.datasets.verify(out) == []


KILLED = """
import os, sys
from lidarsim.datasets.store import open_store

left = int(sys.argv[2])

def mortal(remove):
    def removing(*arguments, **options):
        global left
        if left == 0:
            os._exit(9)
        left -= 1
        remove(*arguments, **options)
    return removing

os.unlink, os.rmdir = mortal(os.unlink), mortal(os.rmdir)
open_store(sys.argv[1]).create("a.bin", b"1")
"""


def test_killed_between_any_two_removals(tmp_path: Path) -> None:
    for removals in itertools.count():
        out = tmp_path / f"out{removals}"
        code = subprocess.run([sys.executable, "-c", KILLED, str(out), str(removals)], check=False).returncode
        open_store(out).tidy()
        assert files(out) == {"a.bin": b"1"}
        if code == 0:
            break
        assert code == 9
    assert removals == 3  # the file, the lock and their folder


def test_tidying_leaves_writers_at_work_and_what_is_foreign(tmp_path: Path) -> None:
    store, other = open_store(tmp_path / "out"), open_store(tmp_path / "out")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "lock").write_text("mine")
    mark = ".lidarsim-set-0123456789abcde{}.tmp"
    foreign = [".lidarsim-0123456789abcdef.tmp", mark.format("x"), "sub/" + mark.format("f"), mark.format("0")]
    with store.writing("a/b.bin") as path:
        path.write_bytes(b"1")
        for name in foreign:
            (tmp_path / "out" / name).mkdir(parents=True)
            (tmp_path / "out" / name / "mine").write_text("mine")
        (tmp_path / "out" / mark.format("1")).symlink_to(elsewhere)
        (tmp_path / "out" / mark.format("2")).mkdir()  # a writer was killed as soon as it had made this
        (tmp_path / "out" / mark.format("3")).mkdir()
        (tmp_path / "out" / mark.format("3") / "lock").touch()
        (tmp_path / "out" / mark.format("3") / "written").write_text("half")
        other.tidy()
        assert path.read_bytes() == b"1"
    assert (tmp_path / "out/a/b.bin").read_bytes() == b"1"
    assert [(tmp_path / "out" / name / "mine").read_text() for name in foreign] == ["mine"] * 4
    assert (elsewhere / "lock").read_text() == "mine"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "a", "sub", foreign[0], foreign[1], mark.format("0"), mark.format("1")
    }  # fmt: skip
