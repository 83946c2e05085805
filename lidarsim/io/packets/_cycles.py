"""Groups of firing cycles, in each of which all channels of a sensor fire once, for packets that hold several."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.io.packets._format import Packet
from lidarsim.scan.scan import Scan

Records = npt.NDArray[Any]
Times = npt.NDArray[np.int64]
Part = tuple[Records, Times]

ROUNDING = 2.0
"""Greatest error of the time between two cycles, ns: each is the sum of two rounded times."""
LAST = 1 << 32
"""First second that a PCAP file cannot hold."""


class Cycles:
    """Cuts a stream of cycles into packets of `size` cycles; those that fill none wait for the next.

    The cycles of a packet follow each other; where frames are repeated, one may come early or late by less than the
    time from one cycle to the next, `period`, ns. Before a gap, such as the part of a turn outside the field of view,
    the packet is filled with cycles without returns: ``empty(last, count)`` returns `count` of them that follow the
    cycle `last`.
    """

    def __init__(self, size: int, period: float, empty: Callable[[Any, int], Records]) -> None:
        self._size, self._period, self._empty = size, period, empty
        self._cycles: Records = np.zeros(0)
        self._starts: Times = np.zeros(0, np.int64)

    def add(self, cycles: Records, starts: Times) -> Part:
        """Return the packets that further cycles complete.

        The cycles, of shape (n, ...), start at `starts`, ns, shape (n,). Returned are the cycles of the packets, shape
        (packets, size, ...), and when they start, shape (packets, size).
        """
        if len(self._starts):
            cycles, starts = _join([(self._cycles, self._starts), (cycles, starts)])
        steps = np.diff(starts)
        gaps = np.flatnonzero((steps <= 0) | (steps > 2.0 * self._period - ROUNDING)) + 1
        *before, (cycles, starts) = zip(np.split(cycles, gaps), np.split(starts, gaps), strict=True)
        whole = len(cycles) // self._size * self._size
        self._cycles, self._starts = cycles[whole:].copy(), starts[whole:].copy()
        return self._group([*(self._fill(*part) for part in before), (cycles[:whole], starts[:whole])])

    def rest(self) -> Part | None:
        """Return the last packet, filled with cycles without returns, as `add` does; None if no cycles wait."""
        if not len(self._starts):
            return None
        filled = self._fill(self._cycles, self._starts)
        self._starts = self._starts[:0]
        return self._group([filled])

    def _fill(self, cycles: Records, starts: Times) -> Part:
        """Return consecutive cycles, followed by as many empty ones as fill the last packet."""
        missing = -len(cycles) % self._size
        later = starts[-1] + np.rint(self._period * np.arange(1, missing + 1)).astype(np.int64)
        return _join([(cycles, starts), (self._empty(cycles[-1], missing), later)])

    def _group(self, parts: list[Part]) -> Part:
        cycles, starts = _join(parts)
        return cycles.reshape(-1, self._size, *cycles.shape[1:]), starts.reshape(-1, self._size)


class CycleEncoder(ABC):
    """Base of the encoders whose packets hold cycles, which `_cycles` cuts and `_encode` turns into packets."""

    _cycles: Cycles

    def rest(self) -> Iterator[Packet]:
        """Yield the last packet, filled with cycles without returns."""
        last = self._cycles.rest()
        if last is not None:
            yield from self._encode(*last)

    def companions(self) -> Mapping[str, bytes]:
        """Return no files: the packets, and the calibration of the model, hold all that decoders need."""
        return {}

    @abstractmethod
    def _encode(self, cycles: Records, starts: Times, /) -> Iterator[Packet]:
        """Yield packets of cycles, shape (packets, size, ...), that start at `starts`, ns, shape (packets, size)."""


def _join(parts: list[Part]) -> Part:
    """Return the cycles of all parts and when they start."""
    if len(parts) == 1:
        return parts[0]
    kind = parts[0][0].dtype
    plain = [cycles.view(f"V{kind.itemsize}") for cycles, _ in parts]  # NumPy joins bytes faster than fields
    return np.concatenate(plain).view(kind), np.concatenate([starts for _, starts in parts])


def payloads(packets: Records) -> list[bytes]:
    """Return the bytes of each packet, faster than NumPy does of each record."""
    content, size = packets.tobytes(), packets.itemsize
    return [content[i : i + size] for i in range(0, len(content), size)]


def moments(scan: Scan, start: int, times: npt.NDArray[np.float64]) -> Times:
    """Return times since the start of a scan as ns since 1970, where `start` is time 0 of the scans."""
    began = start + round(scan.time * 1e9)
    if not 0 <= began < LAST * 10**9:
        last = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=LAST - 1)
        raise FileFormatError(
            f"time: expected a scan from 1970 to {last:%Y-%m-%d}, got one at {began / 1e9:g} s since 1970"
        )
    return began + np.rint(times * 1e9).astype(np.int64)
