"""Packets of real sensors (``.pcap``): what a sensor sends by UDP, for drivers, decoders and recorders.

One module per vendor, which registers its format.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from ipaddress import IPv4Address
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

from lidarsim._files import PathLike, atomic_writer, check_suffix
from lidarsim.io.packets import _pcap
from lidarsim.io.packets._encoders import START, companions, encoders
from lidarsim.io.packets._format import Encoder, Packet, PacketFormat, format_of, names, register
from lidarsim.io.packets._merged import Merged
from lidarsim.io.packets._udp import Sender, Sent

if TYPE_CHECKING:
    from lidarsim.scan import Scan
    from lidarsim.sensor import Lidar

__all__ = [
    "SUFFIXES",
    "Encoder",
    "Packet",
    "PacketFormat",
    "Sender",
    "Sent",
    "Writer",
    "encoders",
    "format_of",
    "names",
    "register",
]

SUFFIXES = (".pcap",)

_FIRST_ADDRESS = IPv4Address("192.168.1.201")


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
        start: float = START,
        variant: str | None = None,
        port: int | None = None,
    ) -> None:
        check_suffix(path, SUFFIXES)
        self._path = Path(path)
        named = sensors if isinstance(sensors, Mapping) else {"": sensors}
        self._encoders = encoders(named, start=start, variant=variant, port=port)
        self._addresses = {name: _FIRST_ADDRESS + number for number, name in enumerate(named)}
        self._merged = Merged(self._encoders)
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
                self._put(self._file, self._merged.rest())
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
        self._put(self._file, self._merged.add(scans))

    @property
    def files(self) -> list[Path]:
        """The file, and the files beside it that decoders need."""
        return [self._path, *self._companions()]

    def _put(self, file: BinaryIO, packets: list[tuple[str, Packet]]) -> None:
        for name, packet in packets:
            _pcap.write(file, packet, self._addresses[name])

    def _companions(self) -> dict[Path, bytes]:
        """Return the content of the files beside the file, by path."""
        return companions(self._path, self._encoders)
