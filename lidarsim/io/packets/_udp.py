"""Packets sent by UDP at the times at which the sensor sends them."""

from __future__ import annotations

import errno
import ipaddress
import math
import socket
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeAlias, TypeVar

from lidarsim._base import validation
from lidarsim._base.files import PathLike, atomic_writer, check_folder
from lidarsim._base.validation import short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.io.packets._encoders import companions, encoders, lidars
from lidarsim.io.packets._format import Packet
from lidarsim.io.packets._merged import Merged
from lidarsim.lidar import Lidar
from lidarsim.motion.georeference import START
from lidarsim.rig import Rig
from lidarsim.scan.scan import Scan

Scans: TypeAlias = Iterable[Scan | Mapping[str, Scan]]

Item = TypeVar("Item")

AHEAD = 2
"""Frames whose packets wait to be sent; a further one is being scanned."""
_REFUSED = {errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOBUFS}


@dataclass
class Sent:
    """What a `Sender` has sent.

    Attributes
    ----------
    packets : int
        Packets that the system took.
    size : int
        Their payload, bytes.
    dropped : int
        Packets that the system refused, since its buffer was full.
    lag : float
        Longest time by which a packet was late, s.
    seconds : float
        From the first packet to the last, s.
    span : float
        The same by the times of the packets, s.
    ports : set of int
        Ports that they were sent to.
    """

    packets: int = 0
    size: int = 0
    dropped: int = 0
    lag: float = 0.0
    seconds: float = 0.0
    span: float = 0.0
    ports: set[int] = field(default_factory=set)

    @property
    def rate(self) -> float:
        """Packets per second; 0 if there is no time between the first and the last."""
        return self.packets / self.seconds if self.seconds else 0.0


class Sender:
    """Send scans as packets by UDP, as the sensors would.

    A context manager, which closes the socket. A thread scans and encodes a few frames ahead, while each packet waits
    for its time; a packet that is ready too late is sent at once. A packet that the system refuses is dropped, as by a
    sensor. Nothing tells whether a packet is received.

    Parameters
    ----------
    sensors : mapping of str to Lidar, Rig or Lidar
        The sensors.
    to : str
        Host, and optionally the port of the first sensor: a name, an IPv4 address, or an IPv6 address, such as
        ``"127.0.0.1"``, ``"localhost:7502"`` or ``"[::1]:7502"``. Each further sensor sends to the next two ports.
        Default: this machine, and the vendor's port.
    start : float or datetime
        Moment at time 0 of the scans, before 2106: s since 1970, or a datetime with its time zone. Default: the start
        of 2020.
    variant : str, optional
        Layout of the packets, as in `encoders`.
    fast : bool
        Send the packets as fast as possible, and wait where the system would refuse one.

    Attributes
    ----------
    sent : Sent
        What has been sent so far.

    Raises
    ------
    FileFormatError
        If a sensor has no packet format, or its pattern or returns do not fit in the packets.
    OSError
        If the host is unknown or cannot be reached, or is a broadcast address.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.
    """

    def __init__(
        self,
        sensors: Mapping[str, Lidar] | Rig | Lidar,
        to: str = "127.0.0.1",
        *,
        start: float | datetime = START,
        variant: str | None = None,
        fast: bool = False,
    ) -> None:
        host, port = _parse(to)
        self._encoders = encoders(lidars(sensors), start=start, variant=variant, port=port)
        self._fast = fast
        self._clock: Callable[[], float] = time.monotonic
        self._sleep: Callable[[float], object] = time.sleep
        self.sent = Sent()
        family, self._address = _reachable(to, host)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(fast)
        self._to = to

    def __enter__(self) -> Self:
        """Return the sender itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the socket."""
        self._socket.close()

    def save_metadata(self, path: PathLike) -> list[Path]:
        """Write the files that decoders need besides the packets.

        Parameters
        ----------
        path : path-like
            Path of the file; its suffix becomes that of its kind, such as ``.json``. With several sensors, the name of
            each is part of the name of its file.

        Returns
        -------
        list of Path
            The files; none if the decoders need none.

        Raises
        ------
        OSError
            If a file cannot be written.
        """
        check_folder(path)
        files = companions(Path(path), self._encoders)
        for place, content in files.items():
            with atomic_writer(place) as file:
                file.write(content)
        return list(files)

    def send(self, scans: Scans | Callable[[], Scans], *, repeat: float = 1, period: float = 0.0) -> Sent:
        """Send the packets of scans, each at its time after the first one.

        Parameters
        ----------
        scans : iterable of Scan or of mappings of str to Scan, or a callable that returns one
            Scans of the only sensor, or by sensor name, in order; they are taken as they are needed. A callable if they
            are repeated.
        repeat : int or inf
            How often to send them. The numbers of the frames and the times go on.
        period : float
            Time from one repetition to the next, s.

        Returns
        -------
        Sent
            What has been sent so far, which `sent` also is.

        Raises
        ------
        FileFormatError
            If a range, a ring or a time does not fit in the packets.
        OSError
            If the system cannot send a packet.
        TypeError, ValueError
            If an argument is of the wrong type or out of its range.
        """
        if not callable(scans) and not isinstance(scans, Iterable):
            raise ArgumentTypeError("scans", "an iterable of scans, or a callable", type(scans).__name__)
        if repeat != math.inf:
            repeat = validation.integer("repeat", repeat, at_least=1)
        if repeat > 1:
            period = validation.real("period", period, above=0.0)
            if not callable(scans):
                raise ArgumentTypeError("scans", "a callable that returns scans to repeat", type(scans).__name__)
        with closing(_ahead(self._batches(scans, repeat, period), AHEAD)) as batches:
            self._transmit(batches)
        return self.sent

    def _batches(self, scans: Scans | Callable[[], Scans], repeat: float, period: float) -> Iterator[list[Packet]]:
        """Yield the packets of each frame, and at the end the incomplete ones."""
        merged = Merged(self._encoders)
        number = 0
        shift: dict[str, int] = {}
        while number < repeat:
            ends: dict[str, tuple[int, int]] = {}
            for given in scans() if callable(scans) else scans:
                named = merged.by_name(given)
                for name, scan in named.items():
                    ends[name] = ends.get(name, (scan.frame, 0))[0], scan.frame + 1
                later = {
                    name: replace(scan, time=scan.time + number * period, frame=scan.frame + shift.get(name, 0))
                    for name, scan in named.items()
                }
                yield [packet for _, packet in merged.add(later if number else named)]
            for name, (first, end) in ends.items():
                shift[name] = shift.get(name, 0) + end - first
            number += 1
        yield [packet for _, packet in merged.rest()]

    def _transmit(self, batches: Iterator[list[Packet]]) -> None:
        """Send the packets of each batch, each at its time after the first one."""
        sent = self.sent
        clock, sleep = self._clock, self._sleep
        begin = first = None
        for batch in batches:
            for packet in batch:
                now = clock()
                if begin is None or first is None:
                    begin, first = now, packet.time
                sent.span = (packet.time - first) / 1e9
                if not self._fast:
                    due = begin + sent.span
                    if now < due:
                        sleep(due - now)
                        now = clock()
                    sent.lag = max(sent.lag, now - due)
                self._send(packet)
                sent.seconds = now - begin

    def _send(self, packet: Packet) -> None:
        try:
            self._socket.sendto(packet.payload, (self._address[0], packet.port, *self._address[2:]))
        except OSError as error:
            if error.errno not in _REFUSED:
                raise OSError(f"to: {self._to}: cannot be sent to: {error.strerror}") from error
            self.sent.dropped += 1
        else:
            self.sent.packets += 1
            self.sent.ports.add(packet.port)
            self.sent.size += len(packet.payload)


def _parse(to: str) -> tuple[str, int | None]:
    """Return host and port."""
    if not isinstance(to, str):
        raise ArgumentTypeError("to", "an address such as 127.0.0.1:7502", type(to).__name__)
    host, port = to, ""
    if to.startswith("["):
        host, bracket, port = to[1:].partition("]")
        valid = bool(bracket) and (not port or port.startswith(":")) and port != ":"
        port = port[1:]
    elif to.count(":") == 1:
        host, _, port = to.partition(":")
        valid = bool(port)
    else:
        valid = ":" not in to or _is_ipv6(to)
    if port and not (port.isascii() and port.isdecimal() and len(port) <= 5 and 1 <= int(port) <= 0xFFFF):
        raise ArgumentValueError("to", "a port from 1 to 65535", short_repr(to))
    if not valid or not host.strip():
        raise ArgumentValueError("to", "HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502", short_repr(to))
    return host, int(port) if port else None


def _is_ipv6(text: str) -> bool:
    try:
        return ipaddress.ip_address(text.partition("%")[0]).version == 6
    except ValueError:
        return False


def _reachable(to: str, host: str) -> tuple[socket.AddressFamily, tuple[Any, ...]]:
    """Return the family and the first address of a host to which there is a way; nothing is sent."""
    try:
        found = socket.getaddrinfo(host, 9, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OSError(f"to: expected a host that is known, got {short_repr(to)} ({reason})") from error
    failure: OSError | None = None
    for family, _, _, _, address in found:
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as probe:
                probe.connect(address)
        except OSError as error:
            failure = error
        else:
            return family, address
    reason = failure.strerror if failure else "no address"
    if failure and failure.errno == errno.EACCES:
        reason = "no permission; is it a broadcast address?"
    raise OSError(f"to: expected an address that can be reached, got {short_repr(to)} ({reason})") from failure


def _ahead(items: Iterator[Item], most: int) -> Generator[Item]:
    """Yield items, none of them None, that a thread takes from an iterator, with at most so many of them waiting."""
    pool = ThreadPoolExecutor(1, "lidarsim-scan-ahead")
    try:
        waiting = deque(pool.submit(next, items, None) for _ in range(most + 1))
        while (item := waiting.popleft().result()) is not None:
            waiting.append(pool.submit(next, items, None))
            yield item
    finally:
        pool.shutdown(cancel_futures=True)
