"""Foxglove: its server, and the messages, which its own recorder writes and a parser of the wire format reads."""

from __future__ import annotations

import struct
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

import lidarsim as ls
from lidarsim.errors import LidarsimError
from lidarsim.viewers import live as viewers
from lidarsim.viewers.live._foxglove import Foxglove
from tests.test_live import FAR, drive, rig, street


def fields(data: bytes) -> dict[int, list[Any]]:
    """The fields of a message in the wire format of Protocol Buffers, by number; messages in it stay bytes."""
    found: dict[int, list[Any]] = defaultdict(list)
    place = 0

    def varint() -> int:
        nonlocal place
        value, shift = 0, 0
        while True:
            byte = data[place]
            place += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while place < len(data):
        tag = varint()
        if tag & 7 == 0:
            found[tag >> 3].append(varint())
        elif tag & 7 == 2:
            length = varint()
            found[tag >> 3].append(data[place : place + length])
            place += length
        else:
            size = {1: 8, 5: 4}[tag & 7]
            found[tag >> 3].append(struct.unpack("<d" if size == 8 else "<I", data[place : place + size])[0])
            place += size
    return found


def vector(data: bytes, size: int = 3) -> list[float]:
    """x, y, z (and w) of a message; a field that is 0 is not written."""
    found = fields(data)
    return [found[number][0] if number in found else 0.0 for number in range(1, size + 1)]


@pytest.fixture
def messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, list[Any]], list[Any]]:
    """The messages of a stream by topic, and its scans; the coordinates are those of a map."""
    scans = list(rig().frames(street(FAR), drive(FAR), 3))
    made = Foxglove(port=0)
    made.paced = False
    monkeypatch.setattr("lidarsim.live.viewer", lambda _: made)
    begin = made.begin

    def recorded(world: Any) -> None:
        monkeypatch.setattr(made, "recorder", foxglove.open_mcap(tmp_path / "a.mcap", context=made._context), False)
        made._wanted.set()  # as if the app had come
        begin(world)

    monkeypatch.setattr(made, "begin", recorded)
    assert ls.stream(scans, "foxglove", scene=street(FAR)) == 3
    made.recorder.close()  # type: ignore[attr-defined]
    found: dict[str, list[Any]] = defaultdict(list)
    with (tmp_path / "a.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found[channel.topic].append((message.log_time, fields(message.data)))
    return found, scans


def test_topics(messages: tuple[dict[str, list[Any]], list[Any]]) -> None:
    found, _ = messages
    counts = {topic: len(of) for topic, of in found.items()}
    assert counts == {"/surfaces": 1, "/tf": 3, "/top/points": 3, "/left/points": 3, "/boxes": 3, "/moving": 3}
    assert [time for time, _ in found["/tf"]] == [0, 100_000_000, 200_000_000]


def test_points(messages: tuple[dict[str, list[Any]], list[Any]]) -> None:
    found, scans = messages
    for k, scan in enumerate(scans):
        transforms = {fields(data)[3][0]: fields(data) for data in found["/tf"][k][1][1]}
        for name in ("top", "left"):
            cloud = found[f"/{name}/points"][k][1]
            stride, data = cloud[4][0], cloud[6][0]
            packed = [fields(field) for field in cloud[5]]
            columns = {field[1][0].decode(): (field[2] or [0])[0] for field in packed}
            raw = np.frombuffer(data, np.uint8).reshape(-1, stride)
            xyz = np.stack([raw[:, columns[a] : columns[a] + 4].copy().view("<f4")[:, 0] for a in "xyz"], axis=-1)
            transform = transforms[name.encode()]
            turned = Rotation.from_quat(vector(transform[5][0], 4)).apply(xyz)
            placed = turned + vector(transform[4][0]) + np.array([432_000.0, 5_412_000.0, 0.0])
            # Half an ulp of 2^7 m in float32; the transform is in float64.
            expected = scan[name].point_cloud("world")
            np.testing.assert_allclose(placed, expected.xyz, rtol=0, atol=2.0**-17)
            labels = raw[:, columns["label"] : columns["label"] + 4].copy().view("<u4")[:, 0]
            np.testing.assert_array_equal(labels, expected.label)
            colors = {bytes(rgb).hex() for rgb in raw[:, columns["red"] : columns["red"] + 4]}
            assert colors == {"6496f5ff", "ff00ffff"}


def test_surfaces_and_boxes(messages: tuple[dict[str, list[Any]], list[Any]]) -> None:
    found, _ = messages
    names = [fields(entity)[3][0].decode() for entity in found["/surfaces"][0][1][2]]
    assert names == ["0 road", "1 car"]
    (entity,) = found["/boxes"][0][1][2]
    assert len(fields(entity)[11]) == 2  # lines
    (mover,) = found["/moving"][2][1][2]
    assert fields(mover)[3] == [b"0 taxi 0"]


def test_a_viewer_that_comes_later_gets_the_surfaces() -> None:
    with Foxglove(port=0) as made:
        sent: list[str] = []
        made._send = lambda topic, *_: sent.append(topic)  # type: ignore[method-assign]
        painter = viewers.Painter(street())
        moment = painter.moment(0, rig().scan(street(), drive()))
        made._wanted.set()
        made.begin(painter.world(moment))
        made.show(moment)
        made.show(moment)
        assert sent.count("/surfaces") == 1
        made._wanted.set()
        made.show(moment)
        assert sent.count("/surfaces") == 2


def test_the_first_frame_waits_for_a_viewer() -> None:
    with Foxglove(port=0) as made:
        painter = viewers.Painter(street())
        world = painter.world(painter.moment(0, rig().scan(street(), drive())))
        thread = threading.Thread(target=made.begin, args=(world,), daemon=True)
        thread.start()
        thread.join(0.3)
        assert thread.is_alive()
        made._wanted.set()
        thread.join()


def test_a_port_in_use() -> None:
    with Foxglove(port=0) as first:
        port = int(first.where.rpartition(":")[2])
        with pytest.raises(LidarsimError, match=rf"ws://127\.0\.0\.1:{port}: no server can be started"), Foxglove(port):
            pass
