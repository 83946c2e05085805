"""Packets of real sensors (``.pcap``): what a sensor sends by UDP, for drivers, decoders and recorders.

One module per vendor, which registers its format.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from contextlib import ExitStack
from ipaddress import IPv4Address
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

from lidarsim import _validation
from lidarsim._files import PathLike, atomic_writer, check_suffix
from lidarsim.errors import ArgumentValueError
from lidarsim.io.packets import (
    _pcap,
    hesai,  # noqa: F401 - registers itself
    livox,  # noqa: F401 - registers itself
)
from lidarsim.io.packets._format import Encoder, Packet, PacketFormat, format_of, names, register

if TYPE_CHECKING:
    from lidarsim.scan import Scan
    from lidarsim.sensor import Lidar

__all__ = ["SUFFIXES", "Encoder", "Packet", "PacketFormat", "Writer", "encoders", "format_of", "names", "register"]

SUFFIXES = (".pcap",)

_START = 1_577_836_800.0  # 2020-01-01T00:00:00Z, as in `lidarsim.io.rosbag`
_FIRST_ADDRESS = IPv4Address("192.168.1.201")


def encoders(
    sensors: Mapping[str, Lidar], *, start: float = _START, variant: str | None = None, port: int | None = None
) -> dict[str, Encoder]:
    """Return an encoder for each sensor, each with UDP ports of its own.

    Parameters
    ----------
    sensors : mapping of str to Lidar
        The sensors by name.
    start : float
        Moment at time 0 of the scans, s since 1970.
    variant : str, optional
        Layout of the packets, one of those of the sensors' format. Default: the first.
    port : int, optional
        First UDP port; each further sensor takes the next two. Default: the vendor's.

    Returns
    -------
    dict of str to Encoder
        The encoders by name of the sensor.

    Raises
    ------
    FileFormatError
        If a sensor has no packet format, or its pattern or returns do not fit in the packets.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.
    """
    moment = round(_validation.real("start", start, at_least=0.0) * 1e9)
    if port is not None:
        port = _validation.integer("port", port, at_least=1)
    found: dict[str, Encoder] = {}
    for number, (name, lidar) in enumerate(sensors.items()):
        layout = format_of(lidar, variant)
        of_it = (layout.port if port is None else port) + 2 * number
        if of_it > 0xFFFE:
            raise ArgumentValueError("port", f"at most {0xFFFE - 2 * number} for {number + 1} sensors", str(port))
        found[name] = layout.encoder(lidar, start=moment, port=of_it, variant=variant)
    return found


class Writer:
    """Write scans as packets into a PCAP file, one by one.

    A context manager: the file, and beside it the files that decoders need (such as Ouster's metadata, ``.json``),
    appear under their names when the block ends without an error.

    Parameters
    ----------
    path : path-like
        The file, ``.pcap``.
    sensors : mapping of str to Lidar, or Lidar
        The sensors. The first sends from 192.168.1.201, each further one from the next address and to ports of its own.
    start, variant, port
        As in `encoders`.

    Raises
    ------
    FileFormatError
        If the suffix is another, a sensor has no packet format, or its pattern or returns do not fit in the packets.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.
    """

    def __init__(
        self,
        path: PathLike,
        sensors: Mapping[str, Lidar] | Lidar,
        *,
        start: float = _START,
        variant: str | None = None,
        port: int | None = None,
    ) -> None:
        check_suffix(path, SUFFIXES)
        self._path = Path(path)
        named = sensors if isinstance(sensors, Mapping) else {"": sensors}
        self._encoders = encoders(named, start=start, variant=variant, port=port)
        self._addresses = {name: _FIRST_ADDRESS + number for number, name in enumerate(named)}
        self._waiting: dict[str, list[Packet]] = {name: [] for name in named}
        self._stack = ExitStack()
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        """Open a temporary file beside the final one."""
        self._file = self._stack.enter_context(atomic_writer(self._path))
        self._file.write(_pcap.header())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the last packets, and give the files their names, unless there was an error."""
        try:
            if error is None and self._file is not None:
                for name, encoder in self._encoders.items():
                    self._waiting[name].extend(encoder.rest())
                self._write_until(self._file, math.inf)
        except BaseException as failure:
            if not self._stack.__exit__(type(failure), failure, failure.__traceback__):
                raise
        else:
            self._stack.__exit__(kind, error, trace)
        finally:
            self._file = None
        if error is None:
            for path, content in self._companions().items():
                with atomic_writer(path) as file:
                    file.write(content)

    def write(self, scans: Scan | Mapping[str, Scan]) -> None:
        """Write the packets of a scan, or of the scans of several sensors, in order of their times.

        Parameters
        ----------
        scans : Scan, or mapping of str to Scan
            A scan of the only sensor, or scans by sensor name; those of one sensor in order of their times.

        Raises
        ------
        FileFormatError
            If a range, a ring or a time does not fit in the packets.
        ValueError
            If no sensor has that name, or the file is not open.
        """
        if self._file is None:
            raise ValueError(f"{self._path}: expected to be written in a with block")
        for name, scan in (scans if isinstance(scans, Mapping) else {self._only(): scans}).items():
            if name not in self._encoders:
                raise ArgumentValueError("sensor", f"one of {', '.join(self._encoders)}", repr(name))
            self._waiting[name].extend(self._encoders[name].packets(scan))
        self._write_until(
            self._file, min(packets[-1].time if packets else -math.inf for packets in self._waiting.values())
        )

    @property
    def files(self) -> list[Path]:
        """The file, and the files beside it that decoders need."""
        return [self._path, *self._companions()]

    def _only(self) -> str:
        if len(self._encoders) > 1:
            raise ArgumentValueError("scans", f"scans by name ({', '.join(self._encoders)})", "a Scan")
        return next(iter(self._encoders))

    def _write_until(self, file: BinaryIO, time: float) -> None:
        """Write the packets up to a time, those of all sensors in order."""
        ready: list[tuple[Packet, IPv4Address]] = []
        for name, packets in self._waiting.items():
            count = bisect_right(packets, time, key=lambda packet: packet.time)
            ready += [(packet, self._addresses[name]) for packet in packets[:count]]
            del packets[:count]
        for packet, address in sorted(ready, key=lambda found: found[0].time):
            _pcap.write(file, packet, address)

    def _companions(self) -> dict[Path, bytes]:
        """Return the content of the files beside the file, by path."""
        return {
            self._path.with_stem(f"{self._path.stem}_{name}" if name else self._path.stem).with_suffix(suffix): content
            for name, encoder in self._encoders.items()
            for suffix, content in encoder.companions().items()
        }
