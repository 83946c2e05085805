"""A reader of PCAP files of its own, by struct and the specifications alone: draft-ietf-opsawg-pcap, RFC 791, 768."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from ipaddress import IPv4Address
from pathlib import Path
from typing import NamedTuple


class Frame(NamedTuple):
    """An Ethernet frame with a fragment of an IPv4 packet, or all of it."""

    microseconds: int
    source: IPv4Address
    target: IPv4Address
    number: int
    offset: int
    more: bool
    content: bytes


class Datagram(NamedTuple):
    """A reassembled UDP datagram."""

    microseconds: int
    source: IPv4Address
    ports: tuple[int, int]
    payload: bytes


def frames(path: Path | str) -> Iterator[Frame]:
    """Yield the frames of a file, after checking headers, lengths and checksums."""
    data = Path(path).read_bytes()
    magic, major, minor, zone, accuracy, most, link = struct.unpack_from("<IHHiIII", data)
    assert (magic, major, minor, zone, accuracy, link) == (0xA1B2C3D4, 2, 4, 0, 0, 1)
    place = 24
    while place < len(data):
        seconds, microseconds, captured, original = struct.unpack_from("<IIII", data, place)
        frame = data[place + 16 : place + 16 + captured]
        assert len(frame) == captured == original <= min(most, 14 + 1500)
        assert microseconds < 1_000_000
        place += 16 + captured
        assert frame[:6] == b"\xff" * 6
        assert frame[6] & 3 == 2  # a locally administered address of one station
        assert frame[12:14] == b"\x08\x00"
        header, content = frame[14:34], frame[34:]
        # RFC 1071: the one's complement sum of all words of the header, with its checksum, is all ones.
        words = sum(struct.unpack("!10H", header))
        assert (words & 0xFFFF) + (words >> 16) == 0xFFFF
        version, service, total, number, flags, lifetime, protocol = struct.unpack_from("!BBHHHBB", header)
        assert (version, service, protocol) == (0x45, 0, 17)
        assert total == len(header) + len(content)
        assert lifetime > 0
        addresses = IPv4Address(header[12:16]), IPv4Address(header[16:20])
        more = bool(flags & 0x2000)
        assert not more or len(content) % 8 == 0
        yield Frame(seconds * 10**6 + microseconds, *addresses, number, 8 * (flags & 0x1FFF), more, content)
    assert place == len(data)


def datagrams(path: Path | str) -> Iterator[Datagram]:
    """Yield the UDP datagrams of a file, put together from their fragments, which follow one another."""
    parts = b""
    first: Frame | None = None
    for frame in frames(path):
        first = first or frame
        assert (frame.number, frame.source, frame.microseconds) == (first.number, first.source, first.microseconds)
        assert frame.offset == len(parts)
        parts += frame.content
        if not frame.more:
            source, target, length, checksum = struct.unpack_from("!HHHH", parts)
            assert length == len(parts)
            assert checksum == 0  # none
            yield Datagram(first.microseconds, first.source, (source, target), parts[8:])
            parts, first = b"", None
    assert first is None
