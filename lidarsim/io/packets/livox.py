"""Livox's point cloud packets.

======  ====================  ===========  =======  =================================================
model   variant               type (dual)  points   of a point
======  ====================  ===========  =======  =================================================
Mid-360 cartesian             1            96       x, y, z in mm, 32 bits; reflectivity, tag
Mid-360 cartesian-16-bit      2            96       x, y, z in cm, 16 bits; reflectivity, tag
Mid-360 spherical             3            96       depth in mm, two angles; reflectivity, tag
Avia,   cartesian             2 (4)        96 (48)  x, y, z in mm, 32 bits; reflectivity, tag
Mid-70  spherical             3 (5)        96 (48)  depth in mm, two angles; reflectivity, tag
Mid-40  cartesian, spherical  0, 1         100      the same without the tag
======  ====================  ===========  =======  =================================================

Angles are in steps of 0.01 degrees: the zenith angle, and the azimuth from x to y. A pulse without a return is a point
of zeros. Of dual returns, the nearer is return 0 and the other, which may be zeros, return 1, as bits 4 and 5 of the
tag tell. Points are in the order in which the pulses are fired, so that the line of point i is i modulo the number of
lines. The time stamp is that of the first point, ns since 1970 (PTP). Decoders space the points evenly: those of the
Mid-360 over `time_interval`, those of the others by the rate of the sensor. There are no packets of the IMU.

Format: Livox LiDAR Communication Protocol Mid-360, section 2; Livox SDK Communication Protocol, section 3;
Livox-SDK/Livox-SDK, sdk_core/include/livox_def.h; Livox-SDK/livox_ros_driver, lds.h.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.errors import FileFormatError
from lidarsim.io._units import reflectivity
from lidarsim.io.packets._cycles import CycleEncoder, Cycles, moments, payloads
from lidarsim.io.packets._format import Packet, PacketFormat, register
from lidarsim.lidar import Lidar
from lidarsim.patterns import Pulses
from lidarsim.patterns._pulses import pulses_of
from lidarsim.scan.scan import Scan

PTP = 1
"""Kind of the time stamps."""
SYNCHRONISED = 1 << 13 | 1 << 14
"""Status code of a sensor that gets the time by PTP."""
DRIFT = 500.0
"""Greatest deviation of the time from one cycle to the next, ns."""
SECOND = 1 << 4
"""Tag of the second return."""
DIFFUSE = 150
"""Reflectivity of a white diffuser."""
FULL_TURN = 36000

_NEW = np.dtype(
    [
        *(("version", "u1"), ("length", "<u2"), ("interval", "<u2"), ("points", "<u2"), ("count", "<u2")),
        *(("frame", "u1"), ("type", "u1"), ("clock", "u1"), ("reserved", "u1", (12,)), ("crc", "<u4"), ("time", "<u8")),
    ]
)
_OLD = np.dtype(
    [
        *(("version", "u1"), ("slot", "u1"), ("id", "u1"), ("reserved", "u1"), ("status", "<u4")),
        *(("clock", "u1"), ("type", "u1"), ("time", "<u8")),
    ]
)
_Fields = list[tuple[str, str]]


def _end(number: int, tagged: bool) -> _Fields:
    return [(f"reflectivity{number}", "u1"), *([(f"tag{number}", "u1")] if tagged else [])]


def _cartesian(returns: int = 1, *, kind: str = "<i4", tagged: bool = True) -> np.dtype[np.void]:
    """Return the type of a point; the names of its fields end in the number of the return."""
    each = ([*((f"{axis}{number}", kind) for axis in "xyz"), *_end(number, tagged)] for number in range(returns))
    return np.dtype([field for fields in each for field in fields])


def _spherical(returns: int = 1, *, tagged: bool = True) -> np.dtype[np.void]:
    """Return the type of a point; the angles are of all returns."""
    depth, angles = ("depth0", "<u4"), [("theta", "<u2"), ("phi", "<u2")]
    if returns == 1:
        return np.dtype([depth, *angles, *_end(0, tagged)])
    return np.dtype([*angles, depth, *_end(0, tagged), ("depth1", "<u4"), *_end(1, tagged)])


class _Layout(NamedTuple):
    """The points of a packet."""

    type: int
    points: int
    point: np.dtype[np.void]
    step: float = 1e-3
    """Unit of lengths, m."""


class _Model(NamedTuple):
    lines: int
    """Pulses that are fired together."""
    period: float
    """From one such firing to the next, ns."""
    layouts: Mapping[str, tuple[_Layout, ...]]
    """By variant, for one return and for two."""
    header: np.dtype[np.void] = _OLD


_TAGGED = {
    "cartesian": (_Layout(2, 96, _cartesian()), _Layout(4, 48, _cartesian(2))),
    "spherical": (_Layout(3, 96, _spherical()), _Layout(5, 48, _spherical(2))),
}
_UNTAGGED = {
    "cartesian": (_Layout(0, 100, _cartesian(tagged=False)),),
    "spherical": (_Layout(1, 100, _spherical(tagged=False)),),
}
_SINGLE = {
    "cartesian": (_Layout(1, 96, _cartesian()),),
    "cartesian-16-bit": (_Layout(2, 96, _cartesian(kind="<i2"), 1e-2),),
    "spherical": (_Layout(3, 96, _spherical()),),
}
MODELS = {
    "livox-mid360": _Model(4, 20_000.0, _SINGLE, _NEW),
    "livox-avia": _Model(6, 25_000.0, _TAGGED),
    "livox-mid70": _Model(1, 10_000.0, _TAGGED),
    "livox-mid40": _Model(1, 10_000.0, _UNTAGGED),
}


class _Encoder(CycleEncoder):
    """The packets of one sensor; see `lidarsim.io.packets.Encoder`."""

    def __init__(self, lidar: Lidar, *, start: int, port: int, variant: str | None = None) -> None:
        self._lidar, self._start, self._port = lidar, start, port
        self._model = model = MODELS[lidar.model]
        layouts = model.layouts[variant or "cartesian"]
        self._returns = lidar.measurement.max_returns
        if self._returns > len(layouts):
            most = "one return" if len(layouts) == 1 else "up to two returns"
            raise FileFormatError(
                f"returns: expected {most} for packets of {lidar.model}, got {lidar.measurement.returns!r}"
            )
        self._layout = layout = layouts[self._returns - 1]
        self._check(pulses_of(lidar.pattern, 0))
        self._type = np.dtype([("header", model.header), ("points", layout.point, (layout.points,))])
        self._template = self._blank()
        self._count = 0
        self._cycles = Cycles(layout.points // model.lines, model.period, self._empty)

    def packets(self, scan: Scan) -> Iterator[Packet]:
        """Yield the packets that a scan completes."""
        if scan.lidar.pattern != self._lidar.pattern or scan.range.shape[1] != self._returns:
            raise FileFormatError("scan: expected one of the sensor that the packets are of, got one of another")
        lines = self._model.lines
        starts = moments(scan, self._start, scan.pulses.time[::lines])
        self._count = 0
        yield from self._encode(*self._cycles.add(self._points(scan).reshape(-1, lines), starts))

    def _check(self, pulses: Pulses) -> None:
        """Check that the pulses of a frame come as the packets have them."""
        lines, period = self._model.lines, self._model.period
        cycles = np.arange(len(pulses)) // lines
        steady = pulses.time[:1] + cycles * (period / 1e9)
        if not (
            len(pulses) % lines == 0
            and np.array_equal(pulses.ring, np.arange(len(pulses)) % lines)
            and (np.abs(pulses.time - steady) <= DRIFT / 1e9).all()
        ):
            raise FileFormatError(
                f"pattern: expected {lines} rings that fire together every {period / 1e3:g} us for packets of "
                f"{self._lidar.model}, got another order or other times"
            )

    def _blank(self) -> npt.NDArray[np.void]:
        """Return a packet of points of zeros without times, in an array of shape (1,)."""
        packet = np.zeros(1, self._type)
        header = packet["header"]
        header["type"], header["clock"] = self._layout.type, PTP
        if self._model.header is _NEW:
            header["length"], header["points"] = self._type.itemsize, self._layout.points
        else:
            header["version"], header["slot"], header["id"], header["status"] = 5, 1, 1, SYNCHRONISED
        for number in range(1, self._returns):
            packet["points"][f"tag{number}"] = number * SECOND
        return packet

    def _empty(self, _last: Any, number: int) -> npt.NDArray[np.void]:
        point: npt.NDArray[np.void] = self._template["points"][0, :1]
        return np.repeat(point, number * self._model.lines).reshape(number, -1)

    def _points(self, scan: Scan) -> npt.NDArray[np.void]:
        """Return the points of a scan, shape (n,)."""
        order = np.argsort(scan.range, axis=1)  # nearest first, missing ones last
        ranges = np.take_along_axis(scan.range, order, axis=1)
        brightness = np.take_along_axis(reflectivity(scan.intensity, DIFFUSE), order, axis=1)
        points = np.repeat(self._template["points"][0, :1], len(scan))
        names = points.dtype.names or ()
        for number in range(self._returns):
            found = ~np.isnan(ranges[:, number])
            xyz = scan.pulses.origins[found] + ranges[found, number, None] * scan.pulses.directions[found]
            points[f"reflectivity{number}"][found] = brightness[found, number]
            if "theta" in names:
                length = np.sqrt((xyz * xyz).sum(axis=1))
                points[f"depth{number}"][found] = self._steps(length[:, None], "<u4", found)[:, 0]
                if number == 0:
                    zenith, azimuth = np.arccos(xyz[:, 2] / length), np.arctan2(xyz[:, 1], xyz[:, 0])
                    points["theta"][found] = np.rint(np.degrees(zenith) * 100.0)
                    points["phi"][found] = np.rint(np.degrees(azimuth) * 100.0).astype(np.int64) % FULL_TURN
            else:
                steps = self._steps(xyz, points.dtype[f"x{number}"], found)
                for axis, values in zip("xyz", steps.T, strict=True):
                    points[f"{axis}{number}"][found] = values
        return points

    def _steps(self, lengths: Floats, kind: npt.DTypeLike, found: npt.NDArray[np.bool_]) -> Floats:
        """Return lengths in steps, shape (n, axes), after checking that they fit; zeros would be no return."""
        steps = np.rint(lengths / self._layout.step)
        limits = np.iinfo(kind)
        wrong = ((steps < limits.min) | (steps > limits.max)).any(axis=1) | ~steps.any(axis=1)
        if wrong.any():
            most, first = limits.max * self._layout.step, np.flatnonzero(wrong)[0]
            raise FileFormatError(
                f"range: expected points at least {self._layout.step:g} m away and within {most:g} m for packets of "
                f"{self._lidar.model}, got pulse {np.flatnonzero(found)[first]} at {lengths[first].tolist()} m"
            )
        return steps

    def _encode(self, cycles: npt.NDArray[np.void], starts: npt.NDArray[np.int64], /) -> Iterator[Packet]:
        """Yield packets of points of shape (packets, cycles, lines) that are fired at `starts`, ns."""
        packets = np.repeat(self._template, len(cycles))
        packets["points"] = cycles.reshape(len(cycles), self._layout.points)
        header = packets["header"]
        header["time"] = starts[:, 0]
        if self._model.header is _NEW:
            header["interval"] = np.rint((starts[:, -1] - starts[:, 0]) / 100.0)
            header["count"] = (self._count + np.arange(len(packets))) & 0xFFFF
            self._count += len(packets)
            checked = _NEW.fields["time"][1] if _NEW.fields else 0
            header["crc"] = [zlib.crc32(payload[checked:]) for payload in payloads(packets)]  # of time stamp and points
        yield from map(Packet, starts[:, -1].tolist(), repeat(self._port), payloads(packets))


for _name, _model in MODELS.items():
    _port = 56300 if _model.header is _NEW else 56001
    register(PacketFormat("livox", {_name: "Livox point cloud packets"}, tuple(_model.layouts), _port, _Encoder))
