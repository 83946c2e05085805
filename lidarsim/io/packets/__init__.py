"""Packets of real sensors (``.pcap``): what a sensor sends by UDP, for drivers, decoders and recorders.

One module per vendor, which registers its format.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from datetime import datetime
from ipaddress import IPv4Address
from pathlib import Path

from lidarsim._base.files import FileWriter, PathLike, atomic_writer, check_names, check_suffix
from lidarsim.errors import ArgumentValueError
from lidarsim.io.packets import _pcap, hesai, livox, ouster, velodyne  # noqa: F401 - each vendor registers itself
from lidarsim.io.packets._encoders import companions, encoders, lidars
from lidarsim.io.packets._format import Encoder, Packet, PacketFormat, format_of, names, register, variants
from lidarsim.io.packets._merged import Merged
from lidarsim.io.packets._udp import Sender, Sent
from lidarsim.lidar import Lidar
from lidarsim.motion.georeference import START
from lidarsim.rig import Rig
from lidarsim.scan.scan import Scan

__all__ = ["SUFFIXES", "Encoder", "Packet", "PacketFormat", "Sender", "Sent", "Writer", "encoders", "format_of",
    "names", "register", "variants"]  # fmt: skip

SUFFIXES = (".pcap",)

_FIRST_ADDRESS = IPv4Address("192.168.1.201")


class Writer(FileWriter):
    """Write scans as packets into a PCAP file, one by one.

    A context manager: the file, and beside it the files that decoders need (such as Ouster's metadata, ``.json``),
    appear under their names when the block ends without an error.

    Parameters
    ----------
    path : path-like
        The file, ``.pcap``.
    sensors : mapping of str to Lidar, Rig or Lidar
        The sensors, by names of letters, digits, _ and -. The first sends from 192.168.1.201, each further one from the
        next address and to ports of its own.
    start : float or datetime
        Moment at time 0 of the scans, before 2106: s since 1970, or a datetime with its time zone. Default: the start
        of 2020.
    variant : str, optional
        Variant of the packets, one of each sensor's format. Default: the first that holds the sensor's returns.
    port : int, optional
        First UDP port; each further sensor takes the next two. Default: the vendor's.

    Raises
    ------
    FileFormatError
        If the suffix is another, a sensor has no packet format, or its pattern or returns do not fit in the packets.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.

    Examples
    --------
    >>> import tempfile
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> _ = scene.add(ls.Plane((0, 0, 1), -1.8))
    >>> lidar = ls.Lidar.preset("ouster-os1-64")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Writer(f"{folder}/drive.pcap", lidar) as packets:
    ...         for scan in lidar.frames(scene, None, 3):
    ...             packets.write(scan)
    ...     [file.name for file in packets.files]
    ['drive.pcap', 'drive.json']
    """

    def __init__(
        self,
        path: PathLike,
        sensors: Mapping[str, Lidar] | Rig | Lidar,
        *,
        start: float | datetime = START,
        variant: str | None = None,
        port: int | None = None,
    ) -> None:
        check_suffix(path, SUFFIXES)
        super().__init__(path)
        if isinstance(sensors, Mapping):
            check_names("sensors", sensors)
        self._sensors = lidars(sensors)
        self._encoders = encoders(self._sensors, start=start, variant=variant, port=port)
        self._addresses = {name: _FIRST_ADDRESS + number for number, name in enumerate(self._sensors)}
        self._merged = Merged(self._encoders)

    def _open(self, stack: ExitStack) -> None:
        for path, content in companions(self._place.path, self._encoders).items():
            stack.enter_context(atomic_writer(path)).write(content)
        self._capture = _pcap.Capture(stack.enter_context(atomic_writer(self._place.path)))
        stack.push(self._complete)

    def _complete(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._write(self._merged.rest())

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
            If no sensor has that name, a scan is of another sensor, or the file is not open.
        """
        self._check_open()
        by_name = self._merged.by_name(scans)
        for name, scan in by_name.items():
            if name in self._sensors and getattr(scan, "lidar", None) != self._sensors[name]:
                raise ArgumentValueError("scans", f"scans of the sensor {self._sensors[name].name!r}", "others")
        self._write(self._merged.add(by_name))

    @property
    def files(self) -> list[Path]:
        """The file, and the files beside it that decoders need: list of Path."""
        path = self._place.as_given(self._place.path)
        return [path, *companions(path, self._encoders)]

    def _write(self, packets: list[tuple[str, Packet]]) -> None:
        for name, packet in packets:
            self._capture.write(packet, self._addresses[name])
