"""PCAP files: UDP datagrams in IPv4 in Ethernet frames.

Format: https://datatracker.ietf.org/doc/draft-ietf-opsawg-pcap/ (PCAP), RFC 791 (IPv4), RFC 768 (UDP).
"""

from __future__ import annotations

import struct
from ipaddress import IPv4Address
from typing import BinaryIO

from lidarsim.errors import FileFormatError
from lidarsim.io.packets._format import Packet

_MAGIC, _VERSION, _ETHERNET = 0xA1B2C3D4, (2, 4), 1  # microseconds
_MOST = 0xFFFF  # bytes of a frame
_HEADER = struct.Struct("<IHHiIII")
_RECORD = struct.Struct("<IIII")
_ADDRESSES = struct.Struct("!6s6sH")
_IP = struct.Struct("!BBHHHBBH4s4s")
_UDP = struct.Struct("!HHHH")
_BROADCAST = IPv4Address("255.255.255.255")
_MORE_FRAGMENTS, _LIFETIME, _OF_UDP = 0x2000, 64, 17
_PART = 1500 - _IP.size
"""Bytes of a datagram in one frame: Ethernet's payload less the header. It is a multiple of 8, as fragments need."""


class Capture:
    """Append packets to an empty file, with time stamps in microseconds.

    A packet that is larger than the payload of an Ethernet frame is fragmented, as it is on its way from a sensor.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._number = 0
        file.write(_HEADER.pack(_MAGIC, *_VERSION, 0, 0, _MOST, _ETHERNET))

    def write(self, packet: Packet, source: IPv4Address) -> None:
        """Append a packet that the sensor at the address `source` broadcasts from the port that it is sent to."""
        seconds, nanoseconds = divmod(packet.time, 10**9)
        if not 0 <= seconds < 1 << 32:
            raise FileFormatError(f"time: expected 0 to {(1 << 32) - 1} s since 1970 in PCAP files, got {seconds}")
        # The UDP checksum is 0, which means none.
        datagram = _UDP.pack(packet.port, packet.port, _UDP.size + len(packet.payload), 0) + packet.payload
        addresses = source.packed, _BROADCAST.packed
        ethernet = _ADDRESSES.pack(b"\xff" * 6, b"\x02\x00" + source.packed, 0x0800)  # locally administered
        for offset in range(0, len(datagram), _PART):
            part = datagram[offset : offset + _PART]
            place = offset // 8 | (_MORE_FRAGMENTS if offset + _PART < len(datagram) else 0)
            fields = 0x45, 0, _IP.size + len(part), self._number & 0xFFFF, place, _LIFETIME, _OF_UDP
            header = _IP.pack(*fields, _checksum(_IP.pack(*fields, 0, *addresses)), *addresses)
            size = len(ethernet) + len(header) + len(part)
            self._file.write(_RECORD.pack(seconds, nanoseconds // 1000, size, size) + ethernet + header + part)
        self._number += 1


def _checksum(words: bytes) -> int:
    """Return the checksum of an IPv4 header: the one's complement of the one's complement sum of its words."""
    total: int = sum(struct.unpack(f"!{len(words) // 2}H", words))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
