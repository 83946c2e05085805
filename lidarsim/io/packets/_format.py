"""Packets, and what a vendor's packet format provides."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import NamedTuple, Protocol

from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError
from lidarsim.lidar import Lidar
from lidarsim.scan.scan import Scan
from lidarsim.sensor.measurement import Measurement, ReturnMode


class Packet(NamedTuple):
    """The payload of one UDP datagram.

    Parameters
    ----------
    time : int
        When the sensor sends it: the firing of its last pulse, ns since 1970.
    port : int
        UDP port that it is sent to.
    payload : bytes
        Its content.
    """

    time: int
    port: int
    payload: bytes


class Encoder(Protocol):
    """Makes the packets of one sensor from its scans, which are given in order."""

    def packets(self, scan: Scan) -> Iterator[Packet]:
        """Yield the packets that a scan completes; pulses that fill none are kept for the next scan.

        Parameters
        ----------
        scan : Scan
            The next scan.

        Yields
        ------
        Packet
            The packets, in order of their times.

        Raises
        ------
        FileFormatError
            If a range, a ring or a time does not fit in the packets.
        """
        ...

    def rest(self) -> Iterator[Packet]:
        """Yield the last, incomplete packet, padded as the sensor pads it.

        Yields
        ------
        Packet
            The packets that remain.
        """
        ...

    def companions(self) -> Mapping[str, bytes]:
        """Return the files that a decoder needs besides the packets.

        Returns
        -------
        mapping of str to bytes
            The content of each file by its suffix, such as ``.json``.
        """
        ...


def mode_of(measurement: Measurement) -> ReturnMode | int:
    """Return the `returns` for packets: the strongest for "dual" of a sensor whose pulses have one echo."""
    return "strongest" if measurement.returns == "dual" and measurement.max_returns == 1 else measurement.returns


class PacketFormat(NamedTuple):
    """A packet format of one or more models of a vendor.

    Parameters
    ----------
    name : str
        Such as "velodyne".
    models : mapping of str to str
        Models, as in `Lidar.model`, or patterns of them such as "ouster-os*", with what a user reads about the packets
        of each.
    variants : tuple of str
        Names of the packet layouts; the default is the first that holds the sensor's returns. Which are possible may
        depend on the model and on `Measurement.returns`.
    port : int
        First of its UDP ports.
    encoder : callable
        ``encoder(lidar, start=start, port=port, variant=variant)`` returns the `Encoder` of a sensor: `start` is the
        moment of time 0 of the scans, ns since 1970; `variant` is one of `variants`, or None for the default. It
        raises FileFormatError if the sensor's pattern or returns do not fit in the packets.
    """

    name: str
    models: Mapping[str, str]
    variants: tuple[str, ...]
    port: int
    encoder: Callable[..., Encoder]


_formats: dict[str, PacketFormat] = {}


def register(packet_format: PacketFormat) -> None:
    """Let `Writer` and `lidarsim stream` write the packets of the models of a format.

    Parameters
    ----------
    packet_format : PacketFormat
        The format.
    """
    _formats.update(dict.fromkeys(packet_format.models, packet_format))


def names() -> list[str]:
    """Return the models that have a packet format, or patterns of them.

    Returns
    -------
    list of str
        Models and patterns such as "ouster-os*", in alphabetical order.
    """
    return sorted(_formats)


def variants() -> list[str]:
    """Return the variants of all formats.

    Returns
    -------
    list of str
        The variants, those of one format after the other.
    """
    return list(dict.fromkeys(variant for found in _formats.values() for variant in found.variants))


def format_of(lidar: Lidar, variant: str | None = None) -> PacketFormat:
    """Return the packet format of a sensor, after checking that it has the variant.

    Parameters
    ----------
    lidar : Lidar
        The sensor.
    variant : str, optional
        A variant that the format must have.

    Returns
    -------
    PacketFormat
        The format of the sensor's model.

    Raises
    ------
    FileFormatError
        If the sensor's model has no packet format.
    TypeError
        If `lidar` is no Lidar.
    ValueError
        If the format has no such variant.
    """
    if not isinstance(getattr(lidar, "model", None), str):
        raise ArgumentTypeError("sensors", "a Lidar, a Rig, or Lidars by name", type(lidar).__name__)
    model = lidar.model.lower()
    found = next((item for pattern, item in _formats.items() if fnmatchcase(model, pattern)), None)
    if found is None:
        raise FileFormatError(f"model: expected one with a packet format ({', '.join(names())}), got {lidar.model!r}")
    if variant is not None and variant not in found.variants:
        raise ArgumentValueError("variant", f"one of {', '.join(found.variants)} for {lidar.model}", repr(variant))
    return found
