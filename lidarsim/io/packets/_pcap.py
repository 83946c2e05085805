"""PCAP files: UDP datagrams in IPv4 in Ethernet frames.

Format: https://datatracker.ietf.org/doc/draft-ietf-opsawg-pcap/ (PCAP), RFC 791 (IPv4), RFC 768 (UDP).
"""

from __future__ import annotations

import struct
from ipaddress import IPv4Address
from typing import BinaryIO

from lidarsim.io.packets._format import Packet

_MAGIC, _VERSION, _ETHERNET = 0xA1B2C3D4, (2, 4), 1  # microseconds
_MOST = 1 << 18
_HEADER = struct.Struct("<IHHiIII")
_RECORD = struct.Struct("<IIII")
_ADDRESSES = struct.Struct("!6s6sH")
_IP = struct.Struct("!BBHHHBBH4s4s")
_UDP = struct.Struct("!HHHH")
_BROADCAST = IPv4Address("255.255.255.255")
_DONT_FRAGMENT, _LIFETIME, _OF_UDP = 0x4000, 64, 17

LARGEST = 0xFFFF - _IP.size - _UDP.size
"""Bytes of the largest payload: the length of an IPv4 packet is 16 bits."""


def header() -> bytes:
    """Return the header of a file with time stamps in microseconds."""
    return _HEADER.pack(_MAGIC, *_VERSION, 0, 0, _MOST, _ETHERNET)


def write(file: BinaryIO, packet: Packet, source: IPv4Address) -> None:
    """Append a packet that the sensor at the address `source` broadcasts from the port that it is sent to.

    A payload larger than the payload of an Ethernet frame is one frame, not fragments, as captures of the loopback
    interface have it. The UDP checksum is 0, which means none.
    """
    length = _UDP.size + len(packet.payload)
    datagram = _UDP.pack(packet.port, packet.port, length, 0) + packet.payload
    total = _IP.size + length
    fields = (0x45, 0, total, 0, _DONT_FRAGMENT, _LIFETIME, _OF_UDP)
    checksum = _checksum(_IP.pack(*fields, 0, source.packed, _BROADCAST.packed))
    frame = _ADDRESSES.pack(b"\xff" * 6, b"\x02\x00" + source.packed, 0x0800)  # locally administered
    frame += _IP.pack(*fields, checksum, source.packed, _BROADCAST.packed) + datagram
    seconds, nanoseconds = divmod(packet.time, 10**9)
    file.write(_RECORD.pack(seconds, nanoseconds // 1000, len(frame), len(frame)) + frame)


def _checksum(words: bytes) -> int:
    """Return the checksum of an IPv4 header: the one's complement of the one's complement sum of its words."""
    total: int = sum(struct.unpack(f"!{len(words) // 2}H", words))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
