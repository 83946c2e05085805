"""Hesai's point cloud packets, and the correction files that decoders need beside them.

==================  ====  =======  ======  ====================  ============================
model               UDP   columns  step    greatest range        returns
==================  ====  =======  ======  ====================  ============================
Pandar40P           -     10       4 mm    262.14 m              strongest, last, dual
Pandar64            -     6        4 mm    262.14 m              strongest, last, dual
PandarQT (64)       3.1   4        4 mm    262.14 m              strongest, last, dual
PandarXT-32         6.1   8        4 mm    262.14 m              strongest, last, first, dual
XT32M2X             6.1   6        5 mm    327.675 m             strongest, last, first, dual
Pandar128E3X        1.4   2        4 mm    262.14 m              strongest, last, first, dual
OT128               1.4   2        4 mm    262.14 m              strongest, last, first, dual
==================  ====  =======  ======  ====================  ============================

A column is a block, and all channels are in it, those without a point with distance 0. With dual returns, a column is
two blocks: the last and the strongest return or, if they are one, it and the second strongest; a single return is in
both. The packets of the first two models may be sent without sequence number (variant "plain").

A decoder knows when each block is fired relative to the time stamp of its packet, and reads in the firetime correction
file when each channel is fired relative to its block. From that and the speed of the motor it turns the azimuth of the
block into that of the channel::

    time    = stamp + offset - period * (columns of the packet after its own) + firetime
    azimuth = azimuth of the block + speed * firetime + azimuth of the channel

The stamp of a PandarQT tells the first column instead: ``+ period * (columns before its own)``. So the azimuth of a
block is that of the head `first` before the first channel of the column fires, where `first` is the vendor's firetime
of that channel.

Ranges count from Hesai's zero (`Lidar.range_offset`). Time stamps are UTC, rounded to microseconds, and azimuths are
rounded to 0.01 degrees. An OT128 and a Pandar128E3X are in operation mode 2 (standard): their columns are in the states
0 and 1 in turn, each with its own firetimes, if the sensor was read with Hesai's firetime correction file; those of the
presets are all in state 0. The measurements of their IMU are 0, and their packets are not signed.

Format: user manuals of the sensors, section 3; HesaiTechnology/HesaiLidar_SDK_2.0, libhesai/UdpProtocol and
libhesai/UdpParser. Checked with packets of real sensors in tier4/nebula: see tests/io/packets/test_hesai.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from itertools import count, repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._units import reflectivity
from lidarsim.io.packets._cycles import CycleEncoder, Cycles, moments, payloads
from lidarsim.io.packets._format import Packet, PacketFormat, mode_of, register
from lidarsim.lidar import Lidar
from lidarsim.patterns import Spinning, Table
from lidarsim.scan.scan import Scan

PORT = 2368
FACTORY = 0x42
STRONGEST, LAST, FIRST, DUAL = 0x37, 0x38, 0x33, 0x39
STANDARD = 2
"""Operation mode of an OT128 and a Pandar128E3X."""
SEQUENCE, IMU, SAFETY = 1, 2, 4
"""Flags of what a packet contains."""
NORMAL = 1 << 5
"""State of a sensor without faults."""
STAMP_ERROR = 0.5
"""Greatest error of a rounded time stamp, us; the columns of a packet may drift from the decoder's by as much."""
STEP = 0.01
"""Unit of azimuths, degrees."""
SAFETY_CYCLE = 5_000_000
"""Time after which the message on functional safety is new, ns; its counter has 3 bits."""

_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

_Field = tuple[str, str] | tuple[str, str, tuple[int, ...]]

_DATE: _Field = ("date", "u1", (6,))


def _tail(status: int) -> list[_Field]:
    """Return the fields after the blocks in packets of the older models."""
    return [
        *(("status", "u1", (status,)), ("speed", "<u2"), ("microseconds", "<u4"), ("mode", "u1"), ("factory", "u1")),
        *(_DATE, ("sequence", "<u4")),
    ]


def _new_tail(*status: _Field) -> list[_Field]:
    """Return the fields after the blocks in packets of the newer models."""
    return [
        *(*status, ("mode", "u1"), ("speed", "<u2"), _DATE, ("microseconds", "<u4"), ("factory", "u1")),
        ("sequence", "<u4"),
    ]


_LONG_TAIL: list[_Field] = [
    *(("body_crc", "<u4"), ("safety", "u1", (13,)), ("safety_crc", "<u4")),
    *_new_tail(("status", "u1", (9,)), ("states", "<u2"), ("operation", "u1")),
    *(("imu", "u1", (22,)), ("crc", "<u4")),
]


class _Layout(NamedTuple):
    """The packets of a model. Times are in microseconds."""

    head: str
    """Bytes before the first block, with the kind of the first block's return as K and the number of returns as N."""
    channels: int
    blocks: int
    period: float
    """From one column to the next."""
    first: float
    """Firetime of the channel that fires first."""
    tail: list[_Field]
    offset: float = 0.0
    """As in the formula above."""
    mark: bytes = b""
    """Bytes before each azimuth."""
    confidence: int | None = None
    """Byte after each reflectivity, if there is one."""
    step: int = 4
    """Unit of distances, mm."""
    modes: Mapping[str | int, int] = {"strongest": STRONGEST, "last": LAST, "dual": DUAL}
    stamped: int = -1
    """Column of the packet whose start the time stamp tells: the last, or the first."""
    epoch: int = 1900
    """Year 0 of the date."""
    safety: tuple[int, int] = (0, 0)
    """Version of the message on functional safety, and how many bytes of it the checksum covers."""
    firetimes: tuple[str, str] = ("Channel,fire time(us)", "{channel},{us[0]}")
    """Head and row of the firetime correction file, with the firetimes of a channel in each state."""

    @property
    def states(self) -> int:
        """Number of states that columns may be in."""
        return 2 if self.tail is _LONG_TAIL else 1

    def packet(self, *, sequence: bool) -> np.dtype[np.void]:
        """Return the type of a packet."""
        unit: list[Any] = [("distance", "<u2"), ("reflectivity", "u1")]
        if self.confidence is not None:
            unit.append(("confidence", "u1"))
        block = [("mark", "u1", (len(self.mark),)), ("azimuth", "<u2"), ("channels", unit, (self.channels,))]
        tail = self.tail if sequence else [field for field in self.tail if field[0] != "sequence"]
        return np.dtype([("head", "u1", (len(self.head.split()),)), ("blocks", block, (self.blocks,)), *tail])


_WITH_FIRST: Mapping[str | int, int] = {"strongest": STRONGEST, "last": LAST, "first": FIRST, 1: FIRST, "dual": DUAL}
_XT32 = _Layout(
    "ee ff 06 01 00 00 20 08 K 04 N 01",
    channels=32,
    blocks=8,
    period=50.0,
    first=6.0,
    tail=_new_tail(("status", "u1", (10,))),
    confidence=0xFF,
    modes=_WITH_FIRST,
)
_OT128 = _Layout(
    f"ee ff 01 04 80 00 80 02 K 04 N {SEQUENCE | IMU | SAFETY:02x}",
    channels=128,
    blocks=2,
    period=55.556,
    first=0.0,
    tail=_LONG_TAIL,
    modes=_WITH_FIRST,
    safety=(1, 12),
    firetimes=("Operational State,0,0,0,0,2,2\nAzimuth State,0,1,2,3,0,1", "{channel},-,-,-,-,{us[0]},{us[1]}"),
)
LAYOUTS = {
    "hesai-pandar40p": _Layout(
        "",
        channels=40,
        blocks=10,
        period=55.56,
        offset=-28.58,
        first=-54.67,
        tail=_tail(8),
        mark=b"\xff\xee",
        epoch=2000,
    ),
    "hesai-pandar64": _Layout(
        "ee ff 40 06 00 04 00 00",
        channels=64,
        blocks=6,
        period=55.56,
        offset=-42.58,
        first=-54.668,
        tail=_tail(8),
    ),
    "hesai-qt64": _Layout(
        "ee ff 03 01 00 00 40 04 K 04 N 01",
        channels=64,
        blocks=4,
        period=500.0 / 3.0,
        offset=25.71,
        first=2.31,
        tail=_tail(10),
        confidence=0,
        stamped=0,
    ),
    "hesai-xt32": _XT32,
    "hesai-xt32m2x": _XT32._replace(head="ee ff 06 01 00 00 20 06 K 05 N 01", blocks=6, step=5),
    "hesai-ot128": _OT128,
    "hesai-pandar128": _OT128._replace(
        head=_OT128.head.replace("04 80", "04 00"),  # the status byte tells the two apart
        offset=3.148,
        first=0.776,
        safety=(0, 4),
        firetimes=(
            "0" + ",distance>=A1,distance<A1" * 8 + "\n"
            "operation mode,0,0,0,0,0,0,0,0,2,2,2,2,3,3,3,3\n"
            "angle state,0,0,1,1,2,2,3,3,0,0,1,1,0,0,1,1",
            "{channel}" + ",0" * 8 + ",{ns[0]}" * 2 + ",{ns[1]}" * 2 + ",0" * 4,
        ),
    ),
}


class _Rotor(NamedTuple):
    """A pattern in the words of the packets; angles in rad."""

    elevations: Floats
    azimuth_offsets: Floats
    firing_times: Floats
    """Shape (states, channels), s since the start of the column. Column k is in state k modulo their number."""
    columns: float
    """Columns of a turn."""
    rate: float
    start_azimuth: float


class _Encoder(CycleEncoder):
    """The packets of one sensor; see `lidarsim.io.packets.Encoder`."""

    def __init__(self, lidar: Lidar, *, start: int, port: int, variant: str | None = None) -> None:
        self._lidar, self._start, self._port = lidar, start, port
        self._layout = layout = LAYOUTS[lidar.model]
        self._rotor = _rotor(lidar, layout)
        returns = mode_of(lidar.measurement)
        if returns not in layout.modes:
            modes = ", ".join(map(repr, dict.fromkeys(layout.modes)))
            raise FileFormatError(f"returns: expected one of {modes} for packets of {lidar.model}, got {returns!r}")
        self._returns = lidar.measurement.max_returns
        self._type = layout.packet(sequence=variant != "plain")
        self._cycle = np.dtype([("state", "<u2"), ("blocks", self._type["blocks"].base, (self._returns,))])
        self._speed = 360.0 * self._rotor.rate / 1e9  # degrees per ns
        self._sequence = 0
        self._cycles = Cycles(layout.blocks // self._returns, self._period, self._empty)
        self._template = self._blank(layout.modes[returns])

    @property
    def _period(self) -> float:
        """Time from one column to the next, ns."""
        return 1e9 / (self._rotor.columns * self._rotor.rate)

    def packets(self, scan: Scan) -> Iterator[Packet]:
        """Yield the packets that a scan completes."""
        if scan.lidar.pattern != self._lidar.pattern or scan.range.shape[1] != self._returns:
            raise FileFormatError("scan: expected one of the sensor that the packets are of, got one of another")
        pulses, rotor = scan.pulses, self._rotor
        first = np.flatnonzero(pulses.ring == 0)
        state = pulses.column[first] % len(rotor.firing_times)
        since = pulses.time[first] - rotor.firing_times[state, 0]
        starts = moments(scan, self._start, since)
        cycles = self._columns(len(since))
        cycles["state"] = state
        place = pulses.column.astype(np.intp) * self._layout.channels + pulses.ring
        distances, brightness = self._measurements(scan)
        values: npt.NDArray[np.uint16] | npt.NDArray[np.uint8]
        for name, values in (("distance", distances), ("reflectivity", brightness)):
            image = np.empty(len(place), values.dtype)
            for order, of_return in enumerate(values):
                image[place] = of_return
                cycles["blocks"]["channels"][name][:, order] = image.reshape(len(cycles), -1)
        head = -np.degrees(rotor.start_azimuth) + self._speed * (since * 1e9 - self._layout.first * 1e3)
        cycles["blocks"]["azimuth"] = _hundredths(head)[:, None]
        yield from self._encode(*self._cycles.add(cycles, starts))

    def companions(self) -> Mapping[str, bytes]:
        """Return the angle correction file and the firetime correction file."""
        rotor = self._rotor
        elevations, azimuths = np.degrees(rotor.elevations), -np.degrees(rotor.azimuth_offsets)
        angles = [f"{i},{_short(up)},{_short(right)}" for i, up, right in zip(count(1), elevations, azimuths)]
        head, row = self._layout.firetimes
        times = np.resize(rotor.firing_times * 1e6 + self._layout.first, (2, self._layout.channels))
        firetimes = [
            row.format(channel=i, us=[*map(_short, t)], ns=[round(us * 1e3) for us in t])
            for i, t in enumerate(times.T.tolist(), 1)
        ]
        return {
            ".angles.csv": _lines("Channel,Elevation,Azimuth", *angles),
            ".firetimes.csv": _lines(head, *firetimes),
        }

    def _blank(self, mode: int) -> npt.NDArray[np.void]:
        """Return a packet without points, times and azimuths, in an array of shape (1,)."""
        layout, packet = self._layout, np.zeros(1, self._type)
        head = layout.head.replace("K", f"{self._returns - 1:02x}").replace("N", f"{self._returns:02x}")
        packet["head"] = np.frombuffer(bytes.fromhex(head), np.uint8)
        packet["blocks"]["mark"] = np.frombuffer(layout.mark, np.uint8)
        if layout.confidence is not None:
            packet["blocks"]["channels"]["confidence"] = layout.confidence
        packet["speed"] = round(60.0 * self._rotor.rate)
        packet["mode"], packet["factory"] = mode, FACTORY
        if "operation" in (self._type.names or ()):
            packet["operation"] = STANDARD
        return packet

    def _empty(self, last: Any, number: int) -> npt.NDArray[np.void]:
        """Return columns without returns that follow the column `last`."""
        cycles, later = self._columns(number), np.arange(1, number + 1)
        cycles["state"] = (last["state"] + later) % len(self._rotor.firing_times)
        azimuth = last["blocks"]["azimuth"][0] / 100.0 + self._speed * self._period * later
        cycles["blocks"]["azimuth"] = _hundredths(azimuth)[:, None]
        return cycles

    def _columns(self, number: int) -> npt.NDArray[np.void]:
        """Return columns without returns and azimuths, shape (number,)."""
        column = np.zeros(1, self._cycle)
        column["blocks"] = self._template["blocks"][0, 0]
        return np.repeat(column, number)

    def _measurements(self, scan: Scan) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]]:
        """Return distances in steps, 0 for none, and reflectivities, shape (returns, n), in the order of the blocks."""
        offset = np.asarray(self._lidar.range_offset)
        reported = np.ascontiguousarray(scan.range.T) + (offset[scan.pulses.ring] if offset.ndim else offset)
        steps = np.rint(reported / (self._layout.step / 1e3))
        wrong = (steps < 1) | (steps > 0xFFFF)
        if wrong.any():
            pulse, number = np.argwhere(wrong.T)[0]
            low, high = self._layout.step / 1e3, self._layout.step * 0xFFFF / 1e3
            raise FileFormatError(
                f"range: expected {low:g} to {high:g} m for packets of {self._lidar.model}, "
                f"got range[{pulse}, {number}] = {reported[number, pulse]:g}"
            )
        distances = np.fmax(steps, 0.0).astype(np.uint16)  # nan becomes 0
        brightness = reflectivity(np.ascontiguousarray(scan.intensity.T))
        if self._returns == 2:
            # The last return is the farther one; a single return is in both blocks. The bits in which two returns
            # differ turn one into the other.
            first, second = distances
            swapped = second > first
            both = swapped | (second == 0)
            for values in (distances, brightness):
                differ = values[0] ^ values[1]
                values[0] ^= differ * swapped
                values[1] ^= differ * both
        return distances, brightness

    def _encode(self, cycles: npt.NDArray[np.void], starts: npt.NDArray[np.int64], /) -> Iterator[Packet]:
        """Yield packets of columns of shape (packets, columns) that start at `starts`, ns."""
        layout = self._layout
        packets = np.repeat(self._template, len(cycles))
        block = f"V{packets['blocks'].dtype.itemsize}"  # NumPy copies bytes faster than fields
        packets["blocks"].view(block)[:] = cycles["blocks"].view(block).reshape(len(cycles), layout.blocks)
        stamp = starts[:, layout.stamped] - round(1e3 * (layout.first + layout.offset))
        seconds, packets["microseconds"] = np.divmod((stamp + 500) // 1000, 10**6)
        packets["date"] = _dates(seconds, layout)
        number = self._sequence + np.arange(1, len(packets) + 1)
        self._sequence += len(packets)
        if "sequence" in (self._type.names or ()):
            packets["sequence"] = number & 0xFFFFFFFF
        if layout.states > 1:
            # Two bits for each of up to eight blocks, the first block's on top.
            of_block = np.repeat(cycles["state"], self._returns, axis=1)
            packets["states"] = (of_block << np.arange(14, 14 - 2 * layout.blocks, -2, dtype=np.uint16)).sum(axis=1)
            self._check(packets, stamp)
        latest = np.rint(1e9 * self._rotor.firing_times.max(axis=1)).astype(np.int64)
        last = (starts[:, -1] + latest[cycles["state"][:, -1]]).tolist()
        yield from map(Packet, last, repeat(self._port), payloads(packets))

    def _check(self, packets: npt.NDArray[np.void], stamp: npt.NDArray[np.int64]) -> None:
        """Fill in the state of the sensor and the checksums of the body, of the state and of the tail."""
        version, covered = self._layout.safety
        states = np.zeros((8, 13), np.uint8)
        states[:, 0], states[:, 1] = version, NORMAL | np.arange(8)
        counter = stamp // SAFETY_CYCLE % 8
        packets["safety"], packets["safety_crc"] = states[counter], crc32_mpeg2(states[:, 1 : 1 + covered])[counter]
        rows = packets.view(np.uint8).reshape(len(packets), -1)
        places = {name: place[1] for name, place in (self._type.fields or {}).items()}
        for name, start in (("body_crc", "blocks"), ("crc", "status")):
            packets[name] = crc32_mpeg2(rows[:, places[start] : places[name]])


def crc32_mpeg2(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint32]:
    """Return the CRC-32/MPEG-2 of each row.

    It is the CRC-32 of zlib with all bits of bytes and result in the opposite order, and without the final inversion.
    """
    content, size = rows.tobytes().translate(_MIRRORED), rows.shape[1]
    sums = [zlib.crc32(content[i : i + size]) ^ 0xFFFFFFFF for i in range(0, len(content), size)]
    mirrored = np.array(sums, ">u4").tobytes().translate(_MIRRORED)
    return np.frombuffer(mirrored, "<u4").astype(np.uint32)


def _rotor(lidar: Lidar, layout: _Layout) -> _Rotor:
    """Return what a sensor's channels do, after checking that it fits in the packets."""
    pattern = lidar.pattern
    rotor = None
    if isinstance(pattern, Spinning) and pattern.clockwise:
        rotor = _Rotor(
            pattern.elevations,
            pattern.azimuth_offsets,
            pattern.firing_times[None],
            pattern.columns_per_turn,
            pattern.rate,
            pattern.start_azimuth,
        )
    elif isinstance(pattern, Table) and layout.states > 1:
        rotor = _in_turn(pattern, layout)
    if rotor is None or len(rotor.elevations) != layout.channels:
        of_states = f" or the firetimes of {layout.states} states in turn" if layout.states > 1 else ""
        raise FileFormatError(
            f"pattern: expected {layout.channels} channels that spin clockwise{of_states} for packets of "
            f"{lidar.model}, got {type(pattern).__name__} of {pattern.shape[0]}"
        )
    period = 1e6 / (rotor.columns * rotor.rate)
    columns = layout.blocks // lidar.measurement.max_returns
    if abs(period - layout.period) * (columns - 1) > STAMP_ERROR:
        raise FileFormatError(
            f"pattern: expected a column_period of {layout.period:g} us for packets of {lidar.model}, got {period:g} us"
        )
    if round(60.0 * rotor.rate) > 0xFFFF:
        raise FileFormatError(
            f"pattern: expected a rate of at most {0xFFFF // 60} Hz for packets of {lidar.model}, got {rotor.rate:g}"
        )
    return rotor


def _in_turn(table: Table, layout: _Layout) -> _Rotor | None:
    """Return the rotor whose columns are in the states of the layout in turn, as far as packets tell; else None.

    Each channel fires once in each column, and every beam is within half a step of azimuths, and fires within
    `STAMP_ERROR`, of the rotor's.
    """
    channels, states = table.shape[0], layout.states
    columns = len(table.directions) // channels
    if table.columns is None or columns < states:
        return None
    order = np.lexsort((table.rings, table.columns))
    places = table.columns[order].astype(np.intp) * channels + table.rings[order]
    if not np.array_equal(places, np.arange(columns * channels)):
        return None
    direction = table.directions[order].reshape(columns, channels, 3)
    time = table.times[order].reshape(columns, channels)
    firing = time - np.arange(columns)[:, None] / (columns * table.rate)
    # Azimuths of the beams before the rotor has turned, counted from its start at pi.
    turn = 2.0 * np.pi
    azimuth = np.arctan2(direction[..., 1], direction[..., 0]) + turn * table.rate * time - np.pi
    azimuth = (azimuth + np.pi) % turn - np.pi
    elevation = np.arcsin(np.clip(direction[..., 2], -1.0, 1.0))
    rotor = _Rotor(elevation[0], azimuth[0], firing[:states], columns, table.rate, np.pi)
    late = np.abs(firing - rotor.firing_times[np.arange(columns) % states])
    aside = np.abs((azimuth - azimuth[0] + np.pi) % turn - np.pi)
    apart = max(aside.max(), np.abs(elevation - elevation[0]).max())
    return rotor if apart <= np.radians(STEP / 2.0) and late.max() <= STAMP_ERROR * 1e-6 else None


def _dates(seconds: npt.NDArray[np.int64], layout: _Layout) -> npt.NDArray[np.uint8]:
    """Return year since the epoch of the layout, month, day, hour, minute and second, shape (n, 6)."""
    moment = seconds.astype("M8[s]")
    year, month, day = (moment.astype(f"M8[{unit}]") for unit in "YMD")
    since = year.astype(np.int64) + 1970 - layout.epoch
    if layout.epoch == 2000 and len(since) and not 0 <= since.min() <= since.max() < 70:  # later ones mean 1970 to 1999
        raise FileFormatError(f"time: expected the years 2000 to 2069, got {moment.min()} to {moment.max()}")
    parts = [since, (month - year).astype(np.int64) + 1, (day - month).astype(np.int64) + 1]
    return np.stack([*parts, seconds // 3600 % 24, seconds // 60 % 60, seconds % 60], axis=-1).astype(np.uint8)


def _hundredths(degrees: npt.NDArray[np.float64]) -> npt.NDArray[np.uint16]:
    return (np.rint(degrees * 100.0).astype(np.int64) % 36000).astype(np.uint16)


def _short(number: float) -> str:
    return np.format_float_positional(number, 6, trim="-")


def _lines(*lines: str) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()


_NAME = "hesai"
_OLD = ("hesai-pandar40p", "hesai-pandar64")
_WORDS = "Hesai point cloud packets, and angle and firetime correction files"
for _models, _variants in ((_OLD, ("sequence", "plain")), (LAYOUTS.keys() - set(_OLD), ("sequence",))):
    register(PacketFormat(_NAME, dict.fromkeys(_models, _WORDS), _variants, PORT, _Encoder))
