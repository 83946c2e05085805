"""Files for Rerun, read by Rerun's own reader: points, colours, poses, boxes and surfaces."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun import RecordingStream
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

import lidarsim as ls
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


def test_an_address_where_a_viewer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    connected: list[str] = []

    def connect(log: RecordingStream, to: str) -> None:
        connected.append(to)
        log.memory_recording()

    monkeypatch.setattr(RecordingStream, "connect_grpc", connect)
    with socket.socket() as viewer:
        viewer.bind(("127.0.0.1", 0))
        viewer.listen()
        to = f"rerun+http://127.0.0.1:{viewer.getsockname()[1]}/proxy"
        assert ls.stream(rig().frames(street(), None, 1), to) == 1
    assert connected == [to]
