"""A packet format for tests: ten pulses a packet, with their frame, first pulse and ranges."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import lidarsim as ls
from lidarsim.io.packets import Packet, PacketFormat

MODEL = "toy"
PULSES = 10
PORT = 7502
_HEAD = struct.Struct("<QIHH")


class Content(NamedTuple):
    """What a packet holds."""

    time: int
    frame: int
    first: int
    port: int
    range: list[float]


class Encoder:
    """An encoder whose packets span frames, as the number of pulses is no multiple of `PULSES`."""

    def __init__(self, start: int, port: int) -> None:
        self.start, self.port = start, port
        self.waiting: list[tuple[int, int, int, float]] = []

    def packets(self, scan: ls.Scan) -> Iterator[Packet]:
        times = self.start + np.rint((scan.time + scan.pulses.time) * 1e9).astype(np.int64)
        ranges = np.nan_to_num(scan.range[:, 0]).tolist()
        self.waiting += [(t, scan.frame, k, r) for k, (t, r) in enumerate(zip(times.tolist(), ranges, strict=True))]
        while len(self.waiting) >= PULSES:
            yield self._packet()

    def rest(self) -> Iterator[Packet]:
        if self.waiting:
            yield self._packet()

    def companions(self) -> dict[str, bytes]:
        return {".json": b"{}"}

    def _packet(self) -> Packet:
        taken, self.waiting = self.waiting[:PULSES], self.waiting[PULSES:]
        _, frame, first, _ = taken[0]
        ranges = [value for *_, value in taken]
        head = _HEAD.pack(taken[-1][0], frame, first, self.port)
        return Packet(taken[-1][0], self.port, head + struct.pack(f"<{len(ranges)}f", *ranges))


def _encoder(lidar: ls.Lidar, *, start: int, port: int, variant: str | None) -> Encoder:
    assert lidar.model == MODEL
    assert variant in {None, "single", "dual"}
    return Encoder(start, port)


TOY = PacketFormat("toy", {MODEL: "ten pulses a packet"}, ("single", "dual"), PORT, _encoder)


def lidar(columns: int = 25, rate: float = 100.0) -> ls.Lidar:
    return ls.Lidar(ls.patterns.Spinning([0.0], columns=columns, rate=rate), model=MODEL)


def content(payload: bytes) -> Content:
    head = _HEAD.unpack_from(payload)
    return Content(*head, list(struct.unpack_from(f"<{(len(payload) - _HEAD.size) // 4}f", payload, _HEAD.size)))
