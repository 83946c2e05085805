"""Files for Rerun, read by Rerun's own reader: points, colours, poses, boxes and surfaces."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rerun import RecordingStream
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.viewers import rerun
from lidarsim.viewers._surfaces import surfaces
from tests.test_live import FAR, drive, rig, street


class Recording:
    """The values of a file by entity and component: one list per row, and the times of the rows."""

    def __init__(self, path: Path) -> None:
        self.values: dict[tuple[str, str], list[Any]] = {}
        self.times: dict[tuple[str, str], list[float]] = {}
        for chunk in RrdReader(path).stream().to_chunks():
            batch = chunk.to_record_batch()
            columns = dict(zip(batch.schema.names, batch.columns, strict=True))
            for name, column in columns.items():
                key = chunk.entity_path, name
                self.values.setdefault(key, []).extend(column.to_pylist())
                if "time" in columns:
                    seconds = [value.total_seconds() for value in columns["time"].to_pylist()]
                    self.times.setdefault(key, []).extend(seconds)

    def __getitem__(self, key: tuple[str, str]) -> list[Any]:
        return self.values[key]


@pytest.fixture(params=[(0.0, 0.0, 0.0), FAR], ids=["near", "far"])
def written(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Recording, list[Any], ls.Scene]:
    scene = street(request.param)
    scans = list(rig().frames(scene, drive(request.param), 3))
    assert ls.stream(scans, tmp_path / "drive.rrd", scene=scene) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["drive.rrd"]
    return Recording(tmp_path / "drive.rrd"), scans, scene


def test_points_and_colours(written: tuple[Recording, list[Any], ls.Scene]) -> None:
    recording, scans, _ = written
    (origin,) = recording["/world", "origin"]
    for name in ("top", "left"):
        positions = recording[f"/world/{name}/points", "Points3D:positions"]
        colors = recording[f"/world/{name}/points", "Points3D:colors"]
        classes = recording[f"/world/{name}/points", "Points3D:class_ids"]
        places = recording[f"/world/{name}", "Transform3D:translation"]
        turns = recording[f"/world/{name}", "Transform3D:quaternion"]
        assert len(positions) == 3
        assert recording.times[f"/world/{name}/points", "Points3D:positions"] == [0.0, 0.1, 0.2]
        for k, scan in enumerate(scans):
            cloud = scan[name].point_cloud("world")
            found = Rotation.from_quat(turns[k][0]).apply(positions[k]) + places[k][0] + np.array(origin)
            # Positions and translations are float32: half an ulp of 2^7 and 2^9 m each, and the rotation's 2^-23.
            np.testing.assert_allclose(found, cloud.xyz, rtol=0, atol=2.0**-17 + 2.0**-15 + 2**7 * 2.0**-23)
            assert classes[k] == cloud.label.tolist()
            by_class = dict(zip(classes[k], colors[k], strict=True))
            assert by_class == {10: 0x6496F5FF, 40: 0xFF00FFFF}  # SemanticKITTI's car and road


def test_boxes(written: tuple[Recording, list[Any], ls.Scene]) -> None:
    recording, scans, _ = written
    (origin,) = recording["/world", "origin"]
    for k, scan in enumerate(scans):
        expected = scan["top"].boxes(frame="world", deskew="start", min_points=1)
        centers = np.array(recording["/world/boxes", "Boxes3D:centers"][k]) + np.array(origin)
        np.testing.assert_allclose(centers, expected.center, rtol=0, atol=2.0**-15)  # half an ulp of 2^9 m in float32
        halves = np.array(recording["/world/boxes", "Boxes3D:half_sizes"][k])
        np.testing.assert_array_equal(halves, (expected.size / 2).astype(np.float32))
        assert recording["/world/boxes", "Boxes3D:labels"][k] == ["car 1", "car 3"]


def test_surfaces(written: tuple[Recording, list[Any], ls.Scene]) -> None:
    recording, _, scene = written
    (origin,) = recording["/world", "origin"]
    ball = surfaces(scene)[2]
    vertices = np.array(recording["/world/surfaces/car", "Mesh3D:vertex_positions"][0]) + np.array(origin)
    np.testing.assert_allclose(vertices, ball.points(), rtol=0, atol=2.0**-15)
    assert recording["/world/surfaces/car", "Mesh3D:triangle_indices"][0] == ball.outward().tolist()
    path = "/world/moving/0\\ taxi/6496f5"
    steps = np.diff([place[0] for place in recording[path, "Transform3D:translation"]], axis=0)
    np.testing.assert_allclose(steps, [(0.5, 0, 0)] * 2, rtol=0, atol=2.0**-14)  # two float32 below 2^9 m
    assert len(recording[path, "Mesh3D:vertex_positions"]) == 1  # not again in each frame


def test_paths(written: tuple[Recording, list[Any], ls.Scene]) -> None:
    recording, _, _ = written
    strips = recording["/paths", "LineStrips3D:strips"]
    assert [len(of) for of in strips] == [0, 2, 2]
    step = np.diff(strips[1][0], axis=0)[0]
    np.testing.assert_allclose(step, (0.2, 0, 0), rtol=0, atol=2.0**-14)


def test_a_run_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def scans() -> Any:
        yield from rig().frames(street(), None, 1)
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        ls.stream(scans(), tmp_path / "drive.rrd")
    assert list(tmp_path.iterdir()) == []


def test_an_address_where_nothing_answers() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # and does not listen
        to = f"rerun+http://127.0.0.1:{free.getsockname()[1]}/proxy"
        with pytest.raises(OSError, match=r"to: expected a Rerun viewer that runs, got .*: no answer \("):
            ls.stream(rig().frames(street(), None, 1), to)


@pytest.mark.parametrize(
    "to", ["rerun+http://host", "rerun://:9876/proxy", "rerun+http://a:b/proxy", "rerun+http://[/"]
)
def test_bad_addresses(to: str) -> None:
    with pytest.raises(ValueError, match=r"to: expected rerun\+http://HOST:PORT/proxy, got "):
        ls.stream(rig().frames(street(), None, 1), to)


@contextmanager
def listening(answer: bytes) -> Iterator[int]:
    """Yield the port of a server that answers each connection so, until the block ends."""
    with socket.socket() as server, ThreadPoolExecutor(1) as pool:
        server.bind(("127.0.0.1", 0))
        server.listen()

        def serve() -> None:
            while True:
                line = server.accept()[0]
                with line:
                    if line.recv(1 << 10) == b"":
                        return
                    line.sendall(answer)

        done = pool.submit(serve)
        yield server.getsockname()[1]
        socket.create_connection(server.getsockname()).close()
        done.result()


VIEWER = bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
"""The empty SETTINGS frame with which a server of HTTP/2 begins."""


def in_memory(log: RecordingStream, _: str) -> None:
    log.memory_recording()


def test_an_address_where_a_viewer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    connected: list[str] = []

    def connect(log: RecordingStream, to: str) -> None:
        connected.append(to)
        in_memory(log, to)

    monkeypatch.setattr(RecordingStream, "connect_grpc", connect)
    with listening(VIEWER) as port:
        to = f"rerun+http://127.0.0.1:{port}/proxy"
        assert ls.stream(rig().frames(street(), None, 1), to) == 1
    assert connected == [to]


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_an_address_where_something_else_answers(answer: bytes) -> None:
    with (
        listening(answer) as port,
        pytest.raises(OSError, match=r"expected a Rerun viewer that runs, .* where something else answers$"),
    ):
        ls.stream(rig().frames(street(), None, 1), f"rerun+http://127.0.0.1:{port}/proxy")


def test_a_viewer_that_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    def flush(*_: object, **__: object) -> None:
        raise RuntimeError("gRPC connection severed")

    monkeypatch.setattr(RecordingStream, "connect_grpc", in_memory)
    monkeypatch.setattr(RecordingStream, "flush", flush)
    with listening(VIEWER) as port, pytest.raises(OSError, match=r"takes no more frames: gRPC connection severed$"):
        ls.stream(rig().frames(street(), None, 1), f"rerun+http://127.0.0.1:{port}/proxy")


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """Let a server stand for the viewer that is started; the commands that start it."""
    commands: list[list[str]] = []
    with listening(VIEWER) as port, socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # and does not listen
        monkeypatch.setattr(rerun, "PORT", free.getsockname()[1])

        def start(command: list[str], **_: object) -> Any:
            commands.append(command)
            monkeypatch.setattr(rerun, "PORT", port)
            return SimpleNamespace(poll=lambda: None)

        monkeypatch.setattr(subprocess, "Popen", start)
        monkeypatch.setattr(rerun, "require_display", lambda: None)
        monkeypatch.setattr(RecordingStream, "connect_grpc", in_memory)
        yield commands


@pytest.mark.parametrize(("expose", "address"), [(False, "127.0.0.1"), (True, "0.0.0.0")])  # noqa: S104
def test_a_window_listens_on_this_machine_unless_exposed(
    expose: bool, address: str, window: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    port = rerun.PORT
    assert ls.stream(rig().frames(street(), None, 1), expose=expose) == 1
    (command,) = window
    assert command[:4] == [sys.executable, "-P", "-m", "rerun_cli"]
    assert command[4:8] == ["--port", str(port), "--bind", address]


def test_a_window_that_runs_is_used_and_not_exposed(window: list[list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    with listening(VIEWER) as port:
        monkeypatch.setattr(rerun, "PORT", port)
        assert ls.stream(rig().frames(street(), None, 1)) == 1
        with pytest.raises(OSError, match="a viewer runs already at port"):
            ls.stream(rig().frames(street(), None, 1), expose=True)
    with listening(b"220 mail\r\n") as port:
        monkeypatch.setattr(rerun, "PORT", port)
        with pytest.raises(OSError, match=r"port \d+ of this machine is taken by something other than a viewer"):
            ls.stream(rig().frames(street(), None, 1))
    assert window == []


def test_a_window_that_ends_at_once(window: list[list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    assert window == []
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: SimpleNamespace(poll=lambda: 1))
    with pytest.raises(OSError, match=r"rerun: the viewer that was started has ended; `rerun` in a terminal says why"):
        ls.stream(rig().frames(street(), None, 1))


def test_a_file_is_not_exposed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expose: expected False unless `to` is 'rerun', got True"):
        ls.stream(rig().frames(street(), None, 1), tmp_path / "a.rrd", expose=True)


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_no_thread_stays(tmp_path: Path) -> None:
    def threads() -> int:
        return len(list(Path("/proc/self/task").iterdir()))

    ls.stream(rig().frames(street(), None, 1), tmp_path / "first.rrd")  # the core's and Rerun's own threads begin
    before = threads()
    for k in range(3):
        ls.stream(rig().frames(street(), None, 1), tmp_path / f"{k}.rrd")
    assert threads() == before


@pytest.mark.skipif(sys.platform == "win32", reason="limits the size of files")
def test_a_full_disk(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"a\.rrd: cannot be written: File too large$"):
            ls.stream(rig().frames(street(), drive(), 50), tmp_path / "a.rrd")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_a_frame_may_change_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)

    def frames() -> Iterator[Any]:
        os.chdir("other")
        yield from rig().frames(street(), None, 2)

    assert ls.stream(frames(), "a.rrd") == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rrd", "other"]
