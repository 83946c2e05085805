"""PCAP files: frames, fragments and checksums by an independent reader, order, memory, and what a failure leaves."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from ipaddress import IPv4Address
from pathlib import Path

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.errors import FileFormatError
from lidarsim.io import packets
from lidarsim.io.packets import Packet, _merged
from lidarsim.io.packets._pcap import Capture
from tests.io.packets.captures import datagrams, frames

SENSOR = IPv4Address("10.1.2.3")


@pytest.fixture(scope="module")
def scene() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Sphere((0, 0, 0), 5.0))
    return scene


@pytest.fixture(scope="module")
def rig() -> ls.Rig:
    """Sensors of 20 and 10 Hz."""
    fast, slow = (ls.Lidar.preset("ouster-os1-64", mode=mode) for mode in ("512x20", "512x10"))
    return ls.Rig({"fast": (replace(fast, name="fast"), np.eye(4)), "slow": (replace(slow, name="slow"), np.eye(4))})


@pytest.mark.parametrize("size", [0, 1, 1206, 1472, 1473, 2952, 2953, 24832, 65507])
def test_a_packet_is_fragmented_as_on_its_way(size: int, tmp_path: Path) -> None:
    payload = np.random.default_rng(size).bytes(size)
    time = 1_600_000_000_123_456_789
    with (tmp_path / "a.pcap").open("wb") as file:
        capture = Capture(file)
        for _ in range(2):
            capture.write(Packet(time, 7502, payload), SENSOR)
    found = list(frames(tmp_path / "a.pcap"))
    # An Ethernet frame has at most 1500 bytes, of which the header of IPv4 takes 20; that of UDP is in the datagram.
    assert len(found) == 2 * -(-(8 + size) // 1480)
    assert len({frame.number for frame in found}) == 2  # of the two packets, so that fragments cannot be mixed up
    assert {frame.target for frame in found} == {IPv4Address("255.255.255.255")}
    expected = (time // 1000, SENSOR, (7502, 7502), payload)
    assert [tuple(datagram) for datagram in datagrams(tmp_path / "a.pcap")] == [expected, expected]


def test_packets_are_numbered_modulo_16_bits(tmp_path: Path) -> None:
    with (tmp_path / "a.pcap").open("wb") as file:
        capture = Capture(file)
        capture._number = 0xFFFF
        for _ in range(2):
            capture.write(Packet(0, 1, b""), SENSOR)
    assert [frame.number for frame in frames(tmp_path / "a.pcap")] == [0xFFFF, 0]


@pytest.mark.parametrize("time", [-1, 2**32 * 10**9])
def test_times_that_do_not_fit_are_refused(time: int) -> None:
    with pytest.raises(FileFormatError, match=r"^time: expected 0 to 4294967295 s since 1970 in PCAP files, got "):
        Capture(io.BytesIO()).write(Packet(time, 1, b""), SENSOR)
    Capture(io.BytesIO()).write(Packet(max(0, time - 1), 1, b""), SENSOR)  # the last that fits


def test_the_packets_of_a_rig_are_in_order(rig: ls.Rig, scene: ls.Scene, tmp_path: Path) -> None:
    path = tmp_path / "drive.pcap"
    scans = list(rig.frames(scene, None, 5))
    assert [sorted(of) for of in scans] == [["fast", "slow"], ["fast"]] * 2 + [["fast", "slow"]]
    with packets.Writer(path, rig) as writer:
        for of in scans:
            writer.write(of)
    assert writer.files == [path, tmp_path / "drive_fast.json", tmp_path / "drive_slow.json"]
    assert sorted(tmp_path.iterdir()) == sorted(writer.files)
    found = list(datagrams(path))
    times = [datagram.microseconds for datagram in found]
    assert times == sorted(times)
    for number, (name, encoder) in enumerate(packets.encoders(rig).items()):
        address, port = IPv4Address("192.168.1.201") + number, 7502 + 2 * number
        own = [packet for of in scans if name in of for packet in encoder.packets(of[name])]
        assert len(own) == 32 * {"fast": 5, "slow": 3}[name]
        expected = [(packet.time // 1000, address, (port, port), packet.payload) for packet in own]
        assert [tuple(datagram) for datagram in found if datagram.source == address] == expected


def test_packets_do_not_wait_forever_for_a_silent_sensor(
    rig: ls.Rig, scene: ls.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = 64 + 16 * (12 + 64 * 12)  # bytes of a packet, of which a frame has 32
    monkeypatch.setattr(_merged, "MOST", 3 * 32 * size)
    merged = _merged.Merged(packets.encoders(rig))
    fast, waiting, given = rig["fast"].lidar, 0, 0
    for scan in fast.frames(scene, None, 12):
        ready = merged.add({"fast": scan})
        assert all(len(packet.payload) == size for _, packet in ready)
        waiting += 32 - len(ready)
        given += len(ready)
        assert waiting * size <= _merged.MOST
    assert given > 0
    assert len(merged.rest()) == waiting


class _StopError(Exception):
    pass


@pytest.mark.parametrize(
    ("preset", "returns"),
    [
        *[(preset, "strongest") for preset in ("livox-mid360", "livox-mid40")],
        *[
            (preset, returns)
            for preset in ("hesai-pandar64", "livox-avia", "ouster-os1-64", "velodyne-vlp16")
            for returns in ("strongest", "dual")
        ],
    ],
)
def test_the_default_variant_is_the_first_that_holds_the_returns(preset: str, returns: str, scene: ls.Scene) -> None:
    lidar = ls.Lidar.preset(preset)
    lidar = replace(lidar, measurement=ls.Measurement(beam=ls.Beam(0.002, rays=5), returns=returns))
    scan = lidar.scan(scene)

    def sent(variant: str | None) -> list[Packet] | None:
        try:
            encoder = packets.encoders({"": lidar}, variant=variant)[""]
        except FileFormatError:
            return None
        return [*encoder.packets(scan), *encoder.rest()]

    possible = [found for variant in packets.format_of(lidar).variants if (found := sent(variant)) is not None]
    assert possible[0]
    assert sent(None) == possible[0]


def _write_and_stop(writer: packets.Writer, scan: ls.Scan) -> None:
    writer.write(scan)
    raise _StopError


def test_a_failure_leaves_nothing(
    rig: ls.Rig, scene: ls.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drive.pcap"
    fast = rig["fast"].lidar
    finished = []
    monkeypatch.setattr("lidarsim.io.packets.ouster._Encoder.rest", lambda self: iter(finished.append(self) or ()))
    (tmp_path / "drive.json").write_text("old", encoding="ascii")
    writer = packets.Writer(path, fast)
    with pytest.raises(_StopError), writer:
        _write_and_stop(writer, fast.scan(scene))
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [("drive.json", b"old")]
    assert finished == []
    with pytest.raises(ValueError, match=r"drive\.pcap: expected to be written in a with block$"):
        writer.write(fast.scan(scene))
    with packets.Writer(path, fast) as writer:
        writer.write(fast.scan(scene))
    assert len(finished) == 1
    assert (tmp_path / "drive.json").read_bytes().startswith(b"{")


def test_the_last_packets_may_fail(
    rig: ls.Rig, scene: ls.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_: object) -> Iterator[Packet]:
        raise _StopError

    fast = rig["fast"].lidar
    monkeypatch.setattr("lidarsim.io.packets.ouster._Encoder.rest", failing)
    with pytest.raises(_StopError), packets.Writer(tmp_path / "drive.pcap", fast) as writer:
        writer.write(fast.scan(scene))
    assert list(tmp_path.iterdir()) == []


def test_a_companion_that_cannot_be_written_is_told_before_the_scan(rig: ls.Rig, tmp_path: Path) -> None:
    (tmp_path / "drive.json").mkdir()
    with (
        pytest.raises(IsADirectoryError, match=r"drive\.json: expected a file to write, got a folder"),
        packets.Writer(tmp_path / "drive.pcap", rig["fast"].lidar),
    ):
        pytest.fail("the block must not begin")
    assert [file.name for file in tmp_path.iterdir()] == ["drive.json"]


def test_a_full_disk_is_said_of_the_file_that_is_full(rig: ls.Rig, scene: ls.Scene, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of a file")
    path, fast = tmp_path / "drive.pcap", rig["fast"].lidar
    scans = list(fast.frames(scene, None, 3))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))  # the metadata has 5 kB
    try:
        with pytest.raises(OSError, match="cannot be written") as caught, packets.Writer(path, fast) as writer:  # noqa: PT012
            for scan in scans:
                writer.write(scan)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(caught.value) == f"{path}: cannot be written: File too large"
    assert list(tmp_path.iterdir()) == []


def test_bad_arguments(rig: ls.Rig, scene: ls.Scene, tmp_path: Path) -> None:
    path, fast, slow = tmp_path / "a.pcap", rig["fast"].lidar, rig["slow"].lidar
    with pytest.raises(FileFormatError, match=r"a\.pcd: unknown extension '\.pcd', expected \.pcap$"):
        packets.Writer(tmp_path / "a.pcd", fast)
    other = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0), model="other")
    assert "ouster-os*" in packets.names()
    with pytest.raises(
        FileFormatError, match=r"^model: expected one with a packet format \(.*ouster-os\*.*\), got 'other'"
    ):
        packets.Writer(path, other)
    with pytest.raises(FileFormatError, match=r"^second: model: expected one with a packet format "):
        packets.Writer(path, {"fast": fast, "second": other})
    with pytest.raises(ValueError, match=r"^variant: expected one of single, dual, low-data-rate, legacy for ouster-"):
        packets.Writer(path, fast, variant="quad")
    for name in ("../up", "a b", ""):
        with pytest.raises(ValueError, match=r"^sensors: expected a name of letters, digits, _ and -, got "):
            packets.Writer(path, {name: fast})
    with pytest.raises(ValueError, match=r"^sensors: expected one or more, got none$"):
        packets.Writer(path, {})
    with pytest.raises(TypeError, match=r"^sensors: expected a Lidar, a Rig, or Lidars by name, got NoneType$"):
        packets.Writer(path, {"fast": fast, "none": None})  # type: ignore[dict-item]
    late = datetime(2106, 2, 7, 6, 28, 16, tzinfo=UTC)  # 2³² s since 1970
    for start in (-1.0, 2.0**32, 1e300, late, late.replace(tzinfo=None)):
        with pytest.raises(ValueError, match=r"^start: expected "):
            packets.Writer(path, fast, start=start)
    assert packets.encoders({"a": fast}, port=0xFFFE)
    with pytest.raises(ValueError, match=r"^port: expected at most 65532 for 2 sensors, got 65534$"):
        packets.Writer(path, rig, port=0xFFFE)
    with packets.Writer(path, fast) as writer, pytest.raises(ValueError, match=r"^scans: expected scans of the sensor"):
        writer.write(slow.scan(scene))
    with packets.Writer(path, rig) as writer:
        with pytest.raises(ValueError, match=r"^sensor: expected one of fast, slow, got 'third'$"):
            writer.write({"third": fast.scan(scene)})
        with pytest.raises(ValueError, match=r"^scans: expected scans by name \(fast, slow\), got a Scan$"):
            writer.write(fast.scan(scene))
