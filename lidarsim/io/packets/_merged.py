"""The packets of several sensors in order of their times."""

from __future__ import annotations

import math
import statistics
from bisect import bisect_right
from collections.abc import Mapping

from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.io.packets._format import Encoder, Packet
from lidarsim.scan.scan import Scan

MOST = 1 << 28
"""Most bytes that wait for a silent sensor: more than a hundred frames of an Ouster."""


class Merged:
    """Encode the scans of several sensors, and put their packets in order.

    A packet is held back until each sensor has one that is not earlier, since an earlier one may come before then. If
    so much waits for a silent sensor that memory would suffer (`MOST`), the earlier half no longer waits.
    """

    def __init__(self, encoders: Mapping[str, Encoder]) -> None:
        self._encoders = encoders
        self._waiting: dict[str, list[Packet]] = {name: [] for name in encoders}

    def add(self, scans: Scan | Mapping[str, Scan]) -> list[tuple[str, Packet]]:
        """Return the packets, by sensor, that follow from a scan of the only sensor, or from scans by sensor name."""
        for name, scan in self.by_name(scans).items():
            if name not in self._encoders:
                known = (
                    f"one of {', '.join(self._encoders)}"
                    if any(self._encoders)
                    else "no name, as the only one has none"
                )
                raise ArgumentValueError("sensor", known, repr(name))
            self._waiting[name].extend(self._encoders[name].packets(scan))
        ready = self._until(min(packets[-1].time if packets else -math.inf for packets in self._waiting.values()))
        waiting = [packet for packets in self._waiting.values() for packet in packets]
        if sum(len(packet.payload) for packet in waiting) > MOST:
            ready += self._until(statistics.median_low(packet.time for packet in waiting))
        return ready

    def rest(self) -> list[tuple[str, Packet]]:
        """Return all remaining packets, including the incomplete ones."""
        for name, encoder in self._encoders.items():
            self._waiting[name].extend(encoder.rest())
        return self._until(math.inf)

    def by_name(self, scans: Scan | Mapping[str, Scan]) -> Mapping[str, Scan]:
        """Return scans by sensor name, after checking that a single scan is of the only sensor."""
        if isinstance(scans, Mapping):
            return scans
        if not hasattr(scans, "pulses"):
            raise ArgumentTypeError("scans", "scans, or mappings of names to scans", type(scans).__name__)
        if len(self._encoders) > 1:
            raise ArgumentValueError("scans", f"scans by name ({', '.join(self._encoders)})", "a Scan")
        return {next(iter(self._encoders)): scans}

    def _until(self, time: float) -> list[tuple[str, Packet]]:
        ready: list[tuple[str, Packet]] = []
        for name, packets in self._waiting.items():
            count = bisect_right(packets, time, key=lambda packet: packet.time)
            ready += [(name, packet) for packet in packets[:count]]
            del packets[:count]
        return sorted(ready, key=lambda named: named[1].time)
