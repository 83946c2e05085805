"""Packets of Velodyne's spinning sensors.

A data packet has twelve blocks of 32 data points, then the time stamp, the return mode and the product. A block has a
flag, which names the bank of 32 lasers, and the azimuth of the head at its first firing: in 0.01°, clockwise from the
y axis of Velodyne, which is the x axis here. Decoders add the offsets of the lasers, and the turn until each firing.

The points of a firing cycle are in the order of the lasers, which fire in this order. A block of the VLP-16 holds two
cycles; a cycle of the VLS-128 takes four blocks, one for each bank. With dual returns, each block is there twice: first
with the last returns, then with the strongest or, where the last is the strongest, the second strongest; if there is
one return, both blocks have it. The VLS-128 then fills eight blocks of a packet, and the last four are empty.

The time stamp, µs since the start of the hour (UTC), is that of the first firing of the packet, for the VLS-128 that of
the fourth group of eight. A position packet follows each 14 data packets. Its GPRMC sentence has the time of the last
full second but, as no receiver is simulated, no valid position.

Elevations, azimuth offsets and beam origins are not in the packets: decoders have the calibration of the model, or read
that of a unit.

Sources: user manuals VLP-16 63-9243 Rev D (9.3), VLP-32C 63-9325 Rev C (9.3), VLS-128 63-9483 Rev A (9.3, 9.4), HDL-32E
(appendix B); for the products and the empty blocks also ros-drivers/velodyne, velodyne_pointcloud/src/lib/rawdata.cc,
and valgur/velodyne_decoder, src/packet_decoder.cpp and types.h.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache, lru_cache, reduce
from operator import xor
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.io._units import reflectivity
from lidarsim.io.packets._cycles import CycleEncoder, Cycles, payloads
from lidarsim.io.packets._format import Packet, PacketFormat, mode_of, register
from lidarsim.lidar import Lidar
from lidarsim.patterns import Spinning
from lidarsim.patterns._parts import TURN, directions_of
from lidarsim.scan.scan import Scan

_Time = TypeVar("_Time", int, npt.NDArray[np.int64])

DATA_PORT, POSITION_PORT = 2368, 8308
BLOCKS, POINTS = 12, 32
DATA_PER_POSITION = 14
HOUR_US = 3_600_000_000

POINT = np.dtype([("distance", "<u2"), ("reflectivity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("points", POINT, POINTS)])
DATA = np.dtype([("blocks", BLOCK, BLOCKS), ("stamp", "<u4"), ("mode", "u1"), ("product", "u1")])
POSITION = struct.Struct("<198xIB3x306s")
FLAGS = np.array([0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF], "<u2")
MODES = {"strongest": 0x37, "last": 0x38, "dual": 0x39}
LOCKED = 2
"""The time stamps are synchronised with pulses of a receiver, one per second."""


class Model(NamedTuple):
    """The facts of the packets of a model."""

    name: str
    product: int
    step_m: float
    """Unit of distances."""
    banks: int = 1
    """Blocks that the points of one firing cycle take."""
    stamped: int = 0
    """Laser to whose firing the time stamp belongs, in the first cycle of a packet."""


MODELS = {
    "velodyne-vlp16": Model("VLP-16", 0x22, 0.002),
    "velodyne-vlp32c": Model("VLP-32C", 0x28, 0.004),
    "velodyne-hdl32e": Model("HDL-32E", 0x21, 0.002),
    "velodyne-vls128": Model("VLS-128", 0xA1, 0.004, banks=4, stamped=24),
}


class _Encoder(CycleEncoder):
    """Packs whole firing cycles, here columns, and keeps those that fill no packet."""

    def __init__(self, lidar: Lidar, *, start: int, port: int, variant: str | None = None) -> None:
        self._lidar = lidar
        self._model = MODELS[lidar.model]
        returns = mode_of(lidar.measurement)
        if returns not in MODES:
            raise FileFormatError(f"returns: expected {', '.join(MODES)} for {lidar.model} packets, got {returns!r}")
        self._mode = MODES[cast("str", returns)]
        self._returns = lidar.measurement.max_returns
        lasers = len(_pattern(lidar.model).elevations)
        # A block holds the points of so many columns, and a packet so many groups of blocks with other columns.
        self._columns_per_block = POINTS * self._model.banks // lasers
        self._groups = BLOCKS // (self._model.banks * self._returns)
        self._columns = self._groups * self._columns_per_block

        self._pattern = _check_pattern(lidar, self._columns)
        laser_rings = _laser_rings(lidar)
        fired = np.argsort(self._pattern.firing_times, kind="stable")  # the order of the pulses of a column
        self._order = np.argsort(fired)[laser_rings]
        self._offset = np.broadcast_to(np.asarray(lidar.range_offset), lasers)[fired]
        self._cycle = 1.0 / (self._pattern.columns_per_turn * self._pattern.rate)
        self._stamped = round(self._pattern.firing_times[laser_rings[self._model.stamped]] * 1e9)
        self._last_firing = round(self._pattern.firing_times.max() * 1e9)

        self._start = start
        self._port = port
        self._position_port = POSITION_PORT if port == DATA_PORT else port + 1
        self._sent = 0
        self._end = -1  # start of the last column, ns
        values = (self._returns, lasers)
        self._type = np.dtype([("azimuth", "f8"), ("distance", "u2", values), ("reflectivity", "u1", values)])
        self._cycles = Cycles(self._columns, self._cycle * 1e9, self._empty)

    def packets(self, scan: Scan) -> Iterator[Packet]:
        columns, starts = self._columns_of(scan)
        if not len(columns):
            return
        if starts[0] <= self._end:
            raise FileFormatError(
                f"time: expected a scan after {(self._end - self._start) / 1e9} s, got one at {scan.time} s"
            )
        self._end = int(starts[-1])
        yield from self._encode(*self._cycles.add(columns, starts))

    def _empty(self, last: Any, number: int) -> npt.NDArray[np.void]:
        columns, after = np.zeros(number, self._type), np.arange(1, number + 1) * self._cycle
        columns["azimuth"] = last["azimuth"] + 36000 * self._pattern.rate * after
        return columns

    def _columns_of(self, scan: Scan) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64]]:
        """Return the columns of a scan and when they start, ns since 1970."""
        returns = self._lidar.measurement.returns
        if scan.lidar.pattern != self._pattern or scan.lidar.measurement.returns != returns:
            raise FileFormatError(f"scan: expected pattern and returns of {self._lidar.name!r}, got those of another")
        lasers = len(self._order)
        columns = np.empty(len(scan) // lasers, self._type)
        first = scan.pulses.time[::lasers] - self._pattern.firing_times.min()
        starts = self._start + np.rint((scan.time + first) * 1e9).astype(np.int64)
        columns["azimuth"] = 36000 * (self._pattern.rate * first - self._pattern.start_azimuth / TURN)

        by_return = (len(columns), lasers, self._returns)
        reported = np.add(np.moveaxis(scan.range.reshape(by_return), 2, 0), self._offset, order="C")
        steps = np.rint(reported / self._model.step_m)
        wrong = (steps < 1) | (steps > 0xFFFF)
        if wrong.any():
            self._refuse(reported[wrong][0])
        distance = np.fmax(steps, 0).astype(np.uint16)  # nan, no return, is 0
        brightness = np.moveaxis(reflectivity(scan.intensity).reshape(by_return), 2, 0)
        if self._returns == 2:
            # The strongest and the last or, if these are one, the second strongest, which is nearer.
            is_last = distance[0] >= distance[1]
            is_only = distance[1] == 0
            distance, brightness = (
                np.stack([np.where(is_last, strongest, other), np.where(is_last & ~is_only, other, strongest)])
                for strongest, other in (distance, brightness)
            )
        columns["distance"] = np.take(distance, self._order, axis=2).swapaxes(0, 1)
        columns["reflectivity"] = np.take(brightness, self._order, axis=2).swapaxes(0, 1)
        return columns, starts

    def _refuse(self, metres: float) -> None:
        nearest, farthest = self._model.step_m, 0xFFFF * self._model.step_m
        limit = f"max_range of at most {farthest:.2f}" if metres > nearest else f"min_range of at least {nearest}"
        expected = f"{nearest} to {farthest:.2f} m for {self._lidar.model} packets"
        raise FileFormatError(f"range: expected {expected}, got {metres} m; give the sensor a {limit} m")

    def _encode(self, columns: npt.NDArray[np.void], starts: npt.NDArray[np.int64], /) -> Iterator[Packet]:
        """Yield data packets of columns of shape (packets, columns) that start at `starts`, and position packets."""
        banks, returns = self._model.banks, self._returns
        packets = np.zeros(len(columns), DATA)
        used = self._groups * banks * returns
        grouped = (len(columns), self._groups, self._columns_per_block, returns, banks, len(self._order) // banks)
        for name in ("distance", "reflectivity"):
            blocks = columns[name].reshape(grouped).transpose(0, 1, 4, 3, 2, 5)
            packets["blocks"]["points"][name][:, :used] = blocks.reshape(len(columns), used, POINTS)
        packets["blocks"]["flag"][:, :used] = np.tile(np.repeat(FLAGS[:banks], returns), self._groups)
        # Drivers take the azimuth of the last block for that of the packet, so empty blocks have one too.
        azimuth = np.rint(columns["azimuth"][:, :: self._columns_per_block]).astype(np.int64) % 36000
        packets["blocks"]["azimuth"] = azimuth[:, -1:]
        packets["blocks"]["azimuth"][:, :used] = np.repeat(azimuth, banks * returns, axis=1)
        packets["stamp"] = _stamp(starts[:, 0] + self._stamped)
        packets["mode"], packets["product"] = self._mode, self._model.product

        for payload, time in zip(payloads(packets), (starts[:, -1] + self._last_firing).tolist(), strict=True):
            yield Packet(time, self._port, payload)
            self._sent += 1
            if self._sent % DATA_PER_POSITION == 0:
                yield Packet(time, self._position_port, POSITION.pack(_stamp(time), LOCKED, _sentence(time // 10**9)))


def _stamp(time: _Time) -> _Time:
    """Return moments, ns since 1970, as time stamps, µs since the start of the hour."""
    return (time + 500) // 1000 % HOUR_US


@lru_cache(1)
def _sentence(second: int) -> bytes:
    """Return the GPRMC sentence of a second since 1970. Status V and mode N: the position is not valid."""
    moment = datetime.fromtimestamp(second, UTC)
    body = f"GPRMC,{moment:%H%M%S},V,0000.0000,N,00000.0000,E,000.0,000.0,{moment:%d%m%y},000.0,E,N".encode()
    return b"$%b*%02X\r\n" % (body, reduce(xor, body))


@cache
def _pattern(model: str) -> Spinning:
    """Return the design pattern of a model."""
    return cast("Spinning", Lidar.preset(model).pattern)


def _laser_rings(lidar: Lidar) -> npt.NDArray[np.intp]:
    """Return the ring of each laser.

    Lasers fire in the order of their numbers; those that fire together are in the order of their azimuths. The
    calibration of a unit differs from the design: a ring is the laser whose direction by design is the nearest.
    """
    design, pattern = _pattern(lidar.model), cast("Spinning", lidar.pattern)
    lasers = np.lexsort((design.azimuth_offsets, design.firing_times))
    by_design = directions_of(design.azimuth_offsets, design.elevations)[lasers]
    cosines = by_design @ directions_of(pattern.azimuth_offsets, pattern.elevations).T
    nearest = np.argmax(cosines, axis=0)
    taken = np.bincount(nearest, minlength=len(lasers))
    if (taken != 1).any():
        ring = int(np.flatnonzero(taken[nearest] > 1)[0])
        angles = (math.degrees(values[ring]) for values in (pattern.elevations, pattern.azimuth_offsets))
        raise FileFormatError(
            f"elevations, azimuth_offsets: expected those of a unit of {lidar.model}, each nearest to another of its"
            " lasers, got {:g}° and {:g}° in ring {}".format(*angles, ring)
        )
    return np.argsort(nearest)


def _check_pattern(lidar: Lidar, columns: int) -> Spinning:
    """Return the pattern, after checking that its times are those by which decoders read packets of `columns`."""
    design, pattern = _pattern(lidar.model), lidar.pattern
    what = f"for {lidar.model} packets"
    if not isinstance(pattern, Spinning):
        raise FileFormatError(f"pattern: expected Spinning {what}, got {type(pattern).__name__}")
    if len(pattern.elevations) != len(design.elevations):
        wanted = len(design.elevations)
        raise FileFormatError(f"elevations: expected {wanted} rings {what}, got {len(pattern.elevations)}")
    if not pattern.clockwise:
        raise FileFormatError(f"clockwise: expected True {what}, got False")
    # Up to the end of a packet, both errors together are at most half a unit of its time stamp.
    period, cycle = (1.0 / (each.columns_per_turn * each.rate) for each in (design, pattern))
    late = abs(cycle - period) * columns
    if late > 0.5e-6:
        raise FileFormatError(f"column_period: expected {period * 1e6:g} µs {what}, got {cycle * 1e6:g} µs")
    rings = _laser_rings(lidar)
    expected, got = np.sort(design.firing_times), pattern.firing_times[rings]
    wrong = np.abs(got - expected) + late > 0.5e-6
    if wrong.any():
        laser = int(np.argmax(wrong))
        raise FileFormatError(
            f"firing_times: expected {expected[laser] * 1e6:g} µs for ring {rings[laser]} of {lidar.model},"
            f" got {got[laser] * 1e6:g} µs"
        )
    return pattern


register(
    PacketFormat(
        "velodyne",
        {
            model: f"{facts.name}: data packets with the strongest, last or dual returns, and position packets"
            for model, facts in MODELS.items()
        },
        ("standard",),
        DATA_PORT,
        _Encoder,
    )
)
