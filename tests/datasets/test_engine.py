"""Making data sets: the same bytes for any order, workers, kills and resumes, and nothing made twice."""

from __future__ import annotations

import json
import logging
import os
import platform
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import psutil
import pytest
import trimesh

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.cli.cluster import QUIET, cluster
from lidarsim.datasets import engine, manifest
from lidarsim.datasets.recipe import load
from lidarsim.datasets.store import open_store
from lidarsim.errors import FileFormatError, LidarsimError

Tree = Callable[[Path], dict[str, str]]

samples = engine.samples

ON_A_PROCESSOR = """
import hashlib, sys
import numpy as np
import lidarsim as ls
draw = np.random.default_rng(0)
print(hashlib.sha256(draw.random((100, 3, 3)) @ draw.random((100, 3, 3))).hexdigest())
for layout in ("kitti", "nuscenes", "openpcdet", "shards"):
    choice = [f"layout.type={layout}", "splits={train: 1.0}"]
    ls.generate("detection", f"{sys.argv[1]}/{layout}", sequences=1, frames=2, overrides=choice, pictures=0)
ls.generate("segmentation", f"{sys.argv[1]}/labels", sequences=1, frames=2, overrides=choice[1:], pictures=0)
"""
"""Prints a hash of products of the BLAS, then makes data sets."""

DRIVE = [
    "run.sensor={preset: velodyne-vlp16}",
    "vary={scene.1.radius_m: {uniform: [1, 2]}}",
    "frames=10",
    "shard_frames=2",
]
"""Fifteen shards of a sensor that takes some time."""

CLI = "from lidarsim.cli import main; main()"


@pytest.fixture(scope="module")
def drive(shared: Path, tmp_path_factory: pytest.TempPathFactory, tree: Tree) -> dict[str, str]:
    """What one process makes of it."""
    out = tmp_path_factory.mktemp("drive")
    ls.generate(shared, out, overrides=DRIVE, pictures=0)
    return tree(out)


def of(settings: Sequence[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    until = time.monotonic() + 60
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.01)


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    children = psutil.Process(process.pid).children()
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    assert len(workers) == 2
    return workers


def exit_code(*arguments: object) -> object:
    """The exit code of ``lidarsim generate`` in this process."""
    with pytest.raises(SystemExit) as caught:
        main(["generate", *map(str, arguments), "--pictures", "0"])
    return caught.value.code


def test_the_manifest_holds_every_file_with_its_hash(recipe: Path, tmp_path: Path, tree: Tree) -> None:
    made = ls.generate(recipe, tmp_path / "out", pictures=0)
    files = tree(tmp_path / "out")
    head, *entries = map(json.loads, (tmp_path / "out" / "manifest.jsonl").read_text().splitlines())
    assert {entry["file"]: entry["sha256"] for entry in entries} == {
        name: digest for name, digest in files.items() if name not in {"manifest.jsonl", "recipe.yaml"}
    }
    clouds = [entry for entry in entries if entry["file"].endswith(".bin")]
    assert len(clouds) == made.frames == 12
    assert sum(entry["points"] for entry in clouds) == made.points > 0
    assert [entry["seconds"] for entry in clouds[:5]] == pytest.approx([0, 0.1, 0.2, 0.3, 0])
    assert len({entry["seed"] for entry in clouds}) == 3
    assert head["seed"] == 7
    assert head["versions"]["lidarsim"] == ls.__version__
    assert head["recipe"] == files["recipe.yaml"]


def test_the_same_bytes_in_parts_of_any_order(recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str]) -> None:
    out = tmp_path / "parts"
    left = [ls.generate(recipe, out, part=(part, 3), pictures=0).shards_left for part in (2, 0, 1)]
    assert left == [2, 1, 0]
    assert tree(out) == whole


def test_what_is_done_is_not_cast_again(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, cast = tmp_path / "out", []
    ls.generate(recipe, out, part=(1, 3), pictures=0)
    monkeypatch.setattr(engine, "samples", lambda *key: cast.append(key[2:4]) or samples(*key))
    assert ls.generate(recipe, out, pictures=0).frames == 7
    assert cast == [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (2, 2), (2, 3)]
    assert tree(out) == whole
    assert ls.generate(recipe, out, pictures=0) == ls.datasets.Generated(0, 0, 0.0, 0)
    assert len(cast) == 7


def test_a_shard_that_fails_is_told_and_the_rest_is_made(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def failing(recipe: object, run: object, sequence: int, frame: int, scans: object) -> object:
        if (sequence, frame) == (1, 2):
            tried.append(frame)
            raise RuntimeError("no such frame")
        return samples(recipe, run, sequence, frame, scans)  # type: ignore[arg-type]

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(engine, "samples", failing)
        with pytest.raises(
            LidarsimError, match=r"1 shard failed; sequence 1, frame 2 \(seed \d+\): RuntimeError: no such"
        ):
            ls.generate(recipe, out, pictures=0)
    assert len(tried) == 3
    assert manifest.finished_shards(open_store(out)) == {0, 2}
    with pytest.raises(FileFormatError, match="is incomplete"):
        ls.datasets.verify(out)
    assert ls.generate(recipe, out, pictures=0).frames == 5
    assert tree(out) == whole


def test_a_shard_that_fails_once_is_made_again(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def failing(recipe: object, run: object, sequence: int, frame: int, scans: object) -> object:
        tried.append((sequence, frame))
        if len(tried) == 7:
            raise RuntimeError("once")
        return samples(recipe, run, sequence, frame, scans)  # type: ignore[arg-type]

    monkeypatch.setattr(engine, "samples", failing)
    made = ls.generate(recipe, tmp_path / "out", pictures=0)
    assert (made.frames, len(tried)) == (12, 14)
    assert tree(tmp_path / "out") == whole


def test_verify_finds_what_was_changed(recipe: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ls.generate(recipe, out, pictures=0)
    assert ls.datasets.verify(out) == []
    label, cloud = (out / "sequences/01" / name for name in ("labels/000002.label", "velodyne/000001.bin"))
    data = bytearray(label.read_bytes())
    data[0] ^= 1
    label.write_bytes(data)
    cloud.unlink()
    problems = ls.datasets.verify(out)
    assert [problem.partition(":")[0] for problem in problems] == [
        "sequences/01/velodyne/000001.bin", "sequences/01/labels/000002.label"
    ]  # fmt: skip
    assert "got no file" in problems[0]


def test_a_place_with_another_data_set_is_refused(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    ls.generate(recipe, out, part=(0, 3), pictures=0)
    with pytest.raises(LidarsimError, match=r"another recipe\.yaml"):
        ls.generate(recipe, out, seed=8, pictures=0)
    monkeypatch.setattr(manifest, "versions", lambda: {"lidarsim": "0.0"})
    with pytest.raises(LidarsimError, match=r"same versions \(\{'lidarsim': '0\.0'\}\)"):
        ls.generate(recipe, out, pictures=0)


def test_a_file_that_changed_is_another_data_set(recipe: Path, tmp_path: Path) -> None:
    recipe.write_text(recipe.read_text() + "    - {shape: mesh, file: ball.ply}\n")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.ply")
    out = tmp_path / "out"
    ls.generate(recipe, out, part=(0, 3), pictures=0)
    trimesh.creation.icosphere(1, 1.01).export(tmp_path / "ball.ply")
    with pytest.raises(LidarsimError, match="same sources"):
        ls.generate(recipe, out, pictures=0)


def test_a_function_is_a_recipe(tmp_path: Path, tree: Tree) -> None:
    def scenes(rng: np.random.Generator, sequence: int) -> tuple[ls.Scene, ls.Rig, ls.Trajectory]:
        scene = ls.Scene()
        scene.add(ls.Sphere((rng.uniform(4, 8), 0, 0), 1.0 + sequence), label=3)
        lidar = ls.Lidar(ls.patterns.Grid([-0.1, 0.0, 0.1], [0.0, 0.1], rate=10.0))
        rig = ls.Rig({"left": (lidar, None), "right": (lidar, None)})
        return scene, rig, ls.Trajectory.from_twist(np.eye(4), linear=(1, 0, 0))

    settings = {"sequences": 2, "frames": 3, "seed": 3, "layout": "semantickitti", "pictures": 0}
    made = ls.generate(scenes, tmp_path / "a", **settings)
    ls.generate(scenes, tmp_path / "b", shard_frames=1, **settings)
    assert made.frames == 6
    first, second = tree(tmp_path / "a"), tree(tmp_path / "b")
    clouds = {name for name in first if name.endswith(".bin")}
    assert len(clouds) == 12
    assert {name: first[name] for name in clouds} == {name: second[name] for name in clouds}


@pytest.mark.slow("a cluster whose parts die leaves a data set that can be finished")
def test_a_worker_that_is_killed(recipe: Path, tmp_path: Path, tree: Tree, drive: dict[str, str]) -> None:
    out = tmp_path / "out"
    arguments = ["generate", recipe, "-o", out, "--workers", "2", *of(DRIVE), "--pictures", "0"]
    with subprocess.Popen(
        [sys.executable, "-c", CLI, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_for(lambda: len(list(out.glob("manifest/0*.json"))) >= 2, process)
        workers_of(process)[0].kill()
        left = 15 - len(list(out.glob("manifest/0*.json")))
        printed, complaints = process.communicate(timeout=60)
    assert left > 0
    assert process.returncode == 0, complaints
    assert "30 frames" in printed
    assert "dashboard: http://" in printed
    assert tree(out) == drive


@pytest.mark.slow("a cluster listens to its machine alone")
def test_a_cluster_of_this_machine_listens_to_it_alone() -> None:
    distributed = pytest.importorskip("distributed")  # it sets levels when it is imported
    levels = {name: logging.getLogger(name).level for name in QUIET}
    with cluster(1, None) as client:
        assert {logging.getLogger(name).level for name in QUIET} == {logging.CRITICAL}
        assert client is not None
        client.wait_for_workers(1)
        (worker,) = client.scheduler_info()["workers"].values()
        assert worker["memory_limit"] == distributed.system.MEMORY_LIMIT
        ours = psutil.Process()
        processes = [ours, *ours.children(recursive=True)]
        listening = [
            connection.laddr.ip
            for process in processes
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
        assert client.dashboard_link.startswith("http://127.0.0.1:")
    assert len(processes) > 1
    assert len(listening) > 3
    assert set(listening) <= {"127.0.0.1", "::1"}
    assert {name: logging.getLogger(name).level for name in QUIET} == levels


@pytest.mark.slow("workers that cannot start are not waited for forever")
def test_workers_that_cannot_start_are_not_waited_for_forever(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidarsim.cli.cluster.PRELOAD", "raise SystemExit")
    monkeypatch.setattr(engine, "START", 1)
    with cluster(1, None) as client, pytest.raises(LidarsimError, match=r"expected all .* 1 s, but .*0/1"):
        ls.generate(recipe, tmp_path / "out", overrides=DRIVE, pictures=0, client=client)


@pytest.mark.slow("a cluster whose parts die leaves a data set that can be finished")
def test_a_scheduler_that_is_lost(recipe: Path, tmp_path: Path, tree: Tree, drive: dict[str, str]) -> None:
    out = tmp_path / "out"

    def start(*command: object) -> subprocess.Popen[str]:
        arguments = [sys.executable, *map(str, command)]
        return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    file = tmp_path / "scheduler.json"
    address = ("--scheduler-file", file, "--dashboard-address", ":0")
    with (
        start("-m", "dask", "scheduler", "--port", 0, *address) as scheduler,
        start("-m", "dask", "worker", "--nthreads", 1, "--no-nanny", *address) as worker,
    ):
        try:
            # The scheduler creates the file before it writes it.
            wait_for(lambda: file.exists() and file.read_text().rstrip().endswith("}"), scheduler)
            arguments = ["generate", recipe, "-o", out, "--scheduler", json.loads(file.read_text())["address"]]
            with start("-c", CLI, *arguments, *of(DRIVE), "--pictures", 0) as process:
                wait_for(lambda: len(list(out.glob("manifest/0*.json"))) >= 2, process)
                scheduler.kill()
                complaints = process.communicate(timeout=60)[1]
        finally:
            scheduler.kill()
            worker.kill()
    assert process.returncode == 2
    assert complaints == "lidarsim: lost the connection to the scheduler: run the same command again to resume\n"
    assert not (out / "manifest.jsonl").exists()
    assert exit_code(recipe, "-o", out, *of(DRIVE)) == 0
    assert tree(out) == drive


def test_more_shards_than_a_scheduler_is_given_at_once(
    recipe: Path, tmp_path: Path, tree: Tree, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    ls.generate(recipe, tmp_path / "one", shard_frames=1, pictures=0)
    monkeypatch.setattr(engine, "LOOKAHEAD", 3)
    settings = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as cluster, distributed.Client(cluster) as client:
        made = ls.generate(recipe, tmp_path / "two", shard_frames=1, pictures=0, client=client)
    assert (made.frames, made.shards_left) == (12, 0)
    assert tree(tmp_path / "two") == tree(tmp_path / "one")


def test_workers_continue_their_sequences(recipe: Path) -> None:
    """Sequences have four frames each."""
    for shard_frames, order, expected in (
        (2, "abababab", {"a": [0, 1, 4, 5], "b": [2, 3, 6, 7]}),
        (2, "abaaaabb", {"a": [0, 1, 4, 5, 6], "b": [2, 3, 7]}),  # b is slow
        (4, "abab", {"a": [0, 2], "b": [1, 3]}),
        (3, "abcabc", {"a": [0, 1], "b": [2, 3], "c": [4, 5]}),  # 1 is in the first two sequences, 2 in the next two
        (16, "ab", {"a": [0], "b": []}),
    ):
        made = load(recipe, given={"sequences": 4, "shard_frames": shard_frames})
        choice = engine.Choice(made, range(made.shards))
        found: dict[str, list[int]] = {worker: [] for worker in expected}
        for worker in order:
            others = [shards[-1] for other, shards in found.items() if other != worker and shards]
            shard = choice.next(worker, others)
            found[worker] += [] if shard is None else [shard]
        assert found == expected, (shard_frames, order)
        assert choice.next("a", []) is None
    choice.add(0)
    assert choice.next(None, []) == 0


@pytest.mark.slow("a cluster whose parts die leaves a data set that can be finished")
def test_ctrl_c_ends_the_workers(recipe: Path, tmp_path: Path, tree: Tree, drive: dict[str, str]) -> None:
    """On a terminal it goes to all processes of the group."""
    out = tmp_path / "out"
    arguments = ["generate", recipe, "-o", out, "--workers", "2", *of(DRIVE), "--pictures", "0"]
    with subprocess.Popen(
        [sys.executable, "-c", CLI, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        wait_for(lambda: len(list(out.glob("manifest/0*.json"))) >= 2, process)
        workers = workers_of(process)
        os.killpg(process.pid, signal.SIGINT)
        complaints = process.communicate(timeout=60)[1]
    assert (process.returncode, complaints) == (130, "")
    assert not psutil.wait_procs(workers, timeout=60)[1]
    ls.generate(recipe, out, overrides=DRIVE, pictures=0)
    assert tree(out) == drive


def test_interrupted_and_gone_on(
    recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupting(recipe: object, run: object, sequence: int, frame: int, scans: object) -> object:
        if (sequence, frame) == (1, 2):
            signal.raise_signal(signal.SIGINT)
        return samples(recipe, run, sequence, frame, scans)  # type: ignore[arg-type]

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(engine, "samples", interrupting)
        assert exit_code(recipe, "-o", out) == 130
    assert manifest.finished_shards(open_store(out)) == {0}
    assert not (out / "manifest.jsonl").exists()
    assert ls.generate(recipe, out, pictures=0).frames == 7
    assert tree(out) == whole


def test_a_process_that_is_killed(recipe: Path, tmp_path: Path, tree: Tree, whole: dict[str, str]) -> None:
    code = f"""
import os, signal, lidarsim as ls
from lidarsim._base import files
real, count = os.fsync, 0
def fsync(descriptor):
    global count
    count += 1
    if count == 13:  # in the middle of writing a file
        os.kill(os.getpid(), signal.SIGKILL)
    real(descriptor)
os.fsync = fsync
ls.generate({str(recipe)!r}, {str(tmp_path / "out")!r}, pictures=0)
"""
    killed = subprocess.run([sys.executable, "-c", code], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert list((tmp_path / "out").rglob(".*.tmp"))
    ls.generate(recipe, tmp_path / "out", pictures=0)
    assert tree(tmp_path / "out") == whole


@pytest.mark.parametrize("layout", ["semantickitti", "shards"])
def test_a_full_disk(recipe: Path, tmp_path: Path, tree: Tree, layout: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A limit on the size of files is what a quota looks like to a program: its writes fail."""
    settings = ["layout=" + layout, "vary={}", "frames=20", "shard_frames=30"]
    ls.generate(recipe, tmp_path / "one", overrides=settings, pictures=0)
    largest = max(path.stat().st_size for path in (tmp_path / "one").rglob("*") if path.is_file())
    out = tmp_path / "two"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest - 1, hard))
    try:
        assert exit_code(recipe, "-o", out, *of(settings)) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "File too large" in complaint
    assert not (out / "manifest.jsonl").exists()
    ls.generate(recipe, out, overrides=settings, pictures=0)
    assert tree(out) == tree(tmp_path / "one")


def test_ranges_are_counted_as_numpy_does() -> None:
    edges = np.array(engine.RANGES)
    near = np.concatenate([edges, np.nextafter(edges, -np.inf), np.nextafter(edges, np.inf), [-3.0]])
    for ranges in (near, near[:0], np.random.default_rng(1).exponential(20.0, 10_000)):
        expected, given = np.histogram(ranges, edges)
        assert (given == edges).all()
        assert engine._histogram(ranges).tolist() == expected.tolist()


def test_the_command_line(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run(*arguments: object) -> tuple[object, str]:
        with pytest.raises(SystemExit) as ended:
            main(["generate", *map(str, arguments)])
        printed = capsys.readouterr()
        return ended.value.code, printed.out + printed.err

    out = tmp_path / "out"
    for arguments, code, text in (
        ((recipe, "-o", out, "--shard", "0/2"), 0, "still missing: 1 shard of other parts"),
        (("--verify", "-o", out), 2, "is incomplete"),
        ((recipe, "-o", out, "--shard", "1/2", "--pictures", 0), 0, "5 frames, "),
        (("--verify", "-o", out), 0, "all files match the manifest"),
        (("-o", out), 2, "expected a recipe, or --verify"),
        ((recipe, "-o", out, "--shard", "2/2"), 2, "--shard: expected I/N"),
        ((recipe, "-o", out, "--workers", "2", "--scheduler", "tcp://x"), 2, "got both"),
        ((recipe, "-o", out, "--workers", "0"), 2, "--workers: expected an integer >= 1, got 0"),
        ((recipe, "-o", out, "--pictures", "-1"), 2, "pictures: expected an integer >= 0, got -1"),
        ((tmp_path / "none.yaml", "-o", out), 2, "cannot read the file"),
    ):
        ended, printed = run(*arguments)
        assert (ended, text in printed) == (code, True), printed
    (out / "sequences/00/velodyne/000000.bin").write_bytes(b"")
    ended, printed = run("--verify", "-o", out)
    assert ended == 2
    assert "1 file not as in the manifest: sequences/00/velodyne/000000.bin" in printed


@pytest.mark.slow("data sets have the same bytes on any processor")
@pytest.mark.skipif(platform.machine() not in {"x86_64", "AMD64"}, reason="names of kernels of x86 processors")
def test_the_same_bytes_with_the_blas_of_any_processor(tmp_path: Path, tree: Tree) -> None:
    """OpenBLAS takes kernels for the processor: that of a Haswell fuses products and sums, that of a Nehalem cannot."""
    made, products = [], set()
    for kernel in ("Haswell", "Nehalem"):
        environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
        command = [sys.executable, "-c", ON_A_PROCESSOR, str(tmp_path / kernel)]
        products.add(subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout)
        made.append(tree(tmp_path / kernel))
    if len(products) == 1:
        pytest.skip("no OpenBLAS")
    assert len(made[0]) > 50
    assert made[0] == made[1]
