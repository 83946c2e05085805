"""Ouster's lidar packets, and the metadata that decoders need beside them (``.json``).

A packet holds 16 columns of all channels, as firmware 3.1 sends them with the standard header. The column of a pulse is
the one in which it was fired: images of packets are staggered, and `pixel_shift_by_row` of the metadata destaggers
them. Its layout follows the lidar profile, here called the variant:

=============  ==============================  ====================  ==================
variant        udp_profile_lidar               returns               step, greatest range
=============  ==============================  ====================  ==================
single         RNG19_RFL8_SIG16_NIR16          one                   1 mm, 524.287 m
dual           RNG19_RFL8_SIG16_NIR16_DUAL     up to two             1 mm, 524.287 m
low-data-rate  RNG15_RFL8_NIR8                 one                   8 mm, 262.136 m
legacy         LEGACY                          one                   1 mm, 1048.575 m
=============  ==============================  ====================  ==================

The default is dual for a sensor of two returns, and single for all others.

Ranges count from Ouster's zero (`Lidar.range_offset`) and are rounded to the nearest step; a pulse without a point has
range 0. All columns that the sensor fires are valid; with a field of view of less than a turn, the other columns of the
first and last packet are not. Times are in ns since 1970 (TIME_FROM_PTP_1588). The frame number counts the scans, from
the number of the first. Photons and ambient light are not modelled: the signal is the reflectivity, as in bags, and the
near infrared is 0. The initialisation id is 1, and the serial number is that by which the sensor draws its noise, so
that sensors of different names differ. There are no packets of the IMU.

Format: Ouster Firmware User Manual, Lidar Data, Lidar Data (LEGACY) and Sensor Metadata,
https://ouster.com/sensor-docs/fw-user-manual; ouster-sdk 1.0.1, ouster_core/src/parsing.cpp and metadata.cpp.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim.errors import FileFormatError
from lidarsim.io._units import integers, reflectivity
from lidarsim.io.packets._format import Packet, PacketFormat, register
from lidarsim.io.vendors.ouster import MODES
from lidarsim.lidar import Lidar
from lidarsim.patterns import Spinning
from lidarsim.scan.scan import Scan, sensor_id

COLUMNS = 16
"""Columns of a packet."""
CHANNELS = (16, 32, 64, 128)
TICKS = 90112
"""Ticks of the encoder in a turn, in packets of the legacy profile."""
VALID = {"legacy": 0xFFFFFFFF}
"""Status of a valid column, 1 by default."""
PORT = 7502
LIDAR, INITIALISATION = 1, 1
IMU_TO_SENSOR = [1, 0, 0, 6.253, 0, 1, 0, -11.775, 0, 0, 1, 7.645, 0, 0, 0, 1]


class _Profile(NamedTuple):
    udp: str
    pixel: np.dtype[np.void]
    step: int  # of the ranges, mm
    most: int  # greatest range, in steps
    echoes: int = 1


def _pixel(size: int, fields: dict[str, tuple[str, int]]) -> np.dtype[np.void]:
    """Return the type of a pixel of `size` bytes, with the type and offset of each field; later ones are on top."""
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype({"names": [*fields], "formats": [*formats], "offsets": [*offsets], "itemsize": size})


_WORDS = _pixel(12, {"range": ("<u4", 0), "reflectivity": ("u1", 4), "signal": ("<u2", 6)})
_PAIR = _pixel(
    16,
    {
        "range": ("<u4", 0),
        "reflectivity": ("u1", 3),
        "range2": ("<u4", 4),
        "reflectivity2": ("u1", 7),
        "signal": ("<u2", 8),
        "signal2": ("<u2", 10),
    },
)
_SHORT = _pixel(4, {"range": ("<u2", 0), "reflectivity": ("u1", 2)})

_PROFILES = {
    "single": _Profile("RNG19_RFL8_SIG16_NIR16", _WORDS, 1, (1 << 19) - 1),
    "dual": _Profile("RNG19_RFL8_SIG16_NIR16_DUAL", _PAIR, 1, (1 << 19) - 1, echoes=2),
    "low-data-rate": _Profile("RNG15_RFL8_NIR8", _SHORT, 8, (1 << 15) - 1),
    "legacy": _Profile("LEGACY", _WORDS, 1, (1 << 20) - 1),
}

_ORDERS = {"first": "NEAREST_TO_FARTHEST", "last": "FARTHEST_TO_NEAREST"}
"""Order of the returns by `Measurement.returns`: a number counts them from the nearest; else the strongest is first."""


class _Geometry(NamedTuple):
    """The pattern in the words of the metadata; angles in degrees, lengths in mm."""

    altitudes: list[float]
    azimuths: list[float]
    columns: int
    rate: int
    first: int  # column in which a frame of the pattern begins
    used: int  # columns of a frame
    beam_to_lidar: list[float]
    lidar_to_sensor: list[float]


class _Encoder:
    """The packets of one sensor; see `lidarsim.io.packets.Encoder`."""

    def __init__(self, lidar: Lidar, *, start: int, port: int, variant: str | None = None) -> None:
        returns = lidar.measurement.returns
        self._variant = variant or ("dual" if lidar.measurement.max_returns == 2 else "single")
        self._profile = _PROFILES[self._variant]
        if lidar.measurement.max_returns > self._profile.echoes:
            most = "up to two returns" if self._profile.echoes == 2 else "one return"
            raise FileFormatError(f"returns: expected {most} for {self._variant} packets, got {returns!r}")
        self._start, self._port = start, port
        self._order = (
            "NEAREST_TO_FARTHEST" if isinstance(returns, int) else _ORDERS.get(returns, "STRONGEST_TO_WEAKEST")
        )
        self._geometry = _geometry(lidar)
        self._product = _product(lidar.model, len(self._geometry.altitudes))
        self._offset = float(np.asarray(lidar.range_offset).flat[0])
        self._type = _packet(self._variant, len(self._geometry.altitudes))
        self._serial = sensor_id(lidar.name)
        self._next = 0

    def packets(self, scan: Scan) -> Iterator[Packet]:
        """Yield the packets of a scan."""
        shape = self._geometry
        turn = max(scan.frame, self._next)  # decoders take packets of the same number as parts of one frame
        self._next = turn + 1
        begin = turn * shape.columns + shape.first  # columns are numbered from the start of frame 0
        end = begin + shape.used
        number = np.arange(begin // COLUMNS * COLUMNS, -(-end // COLUMNS) * COLUMNS)
        columns = self._columns(number)
        fired = slice(begin - int(number[0]), end - int(number[0]))
        columns["timestamp"][fired] = times = self._times(scan)
        columns["status"][fired] = VALID.get(self._variant, 1)
        self._fill(columns["pixels"][fired], scan)
        packets = self._pack(columns, number)
        last = np.minimum(number[COLUMNS - 1 :: COLUMNS], end - 1) - begin
        for packet, time in zip(packets, times[last].tolist(), strict=True):
            yield Packet(time, self._port, packet.tobytes())

    def rest(self) -> Iterator[Packet]:
        """Yield nothing: the packets of a scan are whole."""
        return iter(())

    def companions(self) -> Mapping[str, bytes]:
        """Return the metadata."""
        return {".json": (json.dumps(self._metadata(), indent=2) + "\n").encode("ascii")}

    def _columns(self, number: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
        """Return columns that are not valid."""
        columns, per_turn = np.zeros(len(number), self._type["columns"].base), self._geometry.columns
        columns["measurement"] = number % per_turn
        if self._variant == "legacy":
            columns["frame"] = number // per_turn & 0xFFFF
            columns["encoder"] = number % per_turn * (TICKS // per_turn)
        return columns

    def _pack(self, columns: npt.NDArray[np.void], number: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
        """Return the columns in packets."""
        packets = np.zeros(len(columns) // COLUMNS, self._type)
        column = f"V{columns.itemsize}"  # NumPy copies bytes faster than fields
        packets["columns"].view(column)[:] = columns.view(column).reshape(-1, COLUMNS)
        if self._variant != "legacy":
            packets["type"] = LIDAR
            packets["frame"] = number[::COLUMNS] // self._geometry.columns & 0xFFFF
            packets["identity"] = INITIALISATION | self._serial << 24
            words = packets.view("<u8").reshape(len(packets), -1)
            words[:, -1] = crc64(words[:, :-1])
        return packets

    def _times(self, scan: Scan) -> npt.NDArray[np.int64]:
        """Return the time of each column, ns since 1970."""
        with np.errstate(over="ignore"):
            since = np.rint((scan.time + scan.pulses.time.reshape(self._geometry.used, -1)[:, 0]) * 1e9)
        # A start fits in 62 bits, and so does the sum in 63.
        return self._start + integers("time in ns", since, np.int64, "packets", at_least=-self._start, at_most=1 << 62)

    def _fill(self, pixels: npt.NDArray[np.void], scan: Scan) -> None:
        """Write the returns of a scan into its pixels, shape (columns, channels)."""
        name, _, step, most, _ = self._profile
        for k, number in zip(range(scan.range.shape[1]), ("", "2"), strict=False):
            found = np.isfinite(scan.range[:, k])
            steps = np.where(found, np.rint((scan.range[:, k] + self._offset) * 1e3 / step), 1.0)
            steps = integers(f"range in {step} mm", steps, np.uint32, f"a return in {name}", at_least=1, at_most=most)
            bright = np.where(found, reflectivity(scan.intensity[:, k]), 0)
            pixels[f"range{number}"] = np.where(found, steps, 0).reshape(pixels.shape)
            pixels[f"reflectivity{number}"] = bright.reshape(pixels.shape)
            if "signal" in (pixels.dtype.names or ()):
                pixels[f"signal{number}"] = bright.reshape(pixels.shape)

    def _metadata(self) -> dict[str, Any]:
        shape, profile = self._geometry, self._profile
        channels = len(shape.altitudes)
        udp = {"udp_profile_imu": "LEGACY", "udp_profile_lidar": profile.udp}
        window = [shape.first, (shape.first + shape.used - 1) % shape.columns]
        shift = [round(azimuth * shape.columns / 360.0) for azimuth in shape.azimuths]
        return {
            "beam_intrinsics": {
                "beam_altitude_angles": shape.altitudes,
                "beam_azimuth_angles": shape.azimuths,
                "beam_to_lidar_transform": shape.beam_to_lidar,
                "lidar_origin_to_beam_origin_mm": math.hypot(shape.beam_to_lidar[3], shape.beam_to_lidar[11]),
            },
            "calibration_status": {"reflectivity": {"timestamp": "2020-01-01T00:00:00", "valid": True}},
            "config_params": {
                "accel_fsr": "NORMAL",
                "azimuth_window": _azimuth_window(shape),
                "columns_per_packet": COLUMNS,
                "gyro_fsr": "NORMAL",
                "lidar_mode": f"{shape.columns}x{shape.rate}",
                "multipurpose_io_mode": "OFF",
                "nmea_baud_rate": "BAUD_9600",
                "nmea_ignore_valid_char": 0,
                "nmea_in_polarity": "ACTIVE_HIGH",
                "nmea_leap_seconds": 0,
                "operating_mode": "NORMAL",
                "phase_lock_enable": False,
                "phase_lock_offset": 0,
                "return_order": self._order,
                "signal_multiplier": 1,
                "sync_pulse_in_polarity": "ACTIVE_HIGH",
                "sync_pulse_out_angle": 360,
                "sync_pulse_out_frequency": 1,
                "sync_pulse_out_polarity": "ACTIVE_HIGH",
                "sync_pulse_out_pulse_width": 10,
                "timestamp_mode": "TIME_FROM_PTP_1588",
                "udp_dest": "255.255.255.255",
                "udp_port_imu": self._port + 1,
                "udp_port_lidar": self._port,
                **udp,
            },
            "imu_intrinsics": {"imu_to_sensor_transform": IMU_TO_SENSOR},
            "lidar_data_format": {
                "column_window": window,
                "columns_per_frame": shape.columns,
                "columns_per_packet": COLUMNS,
                "fps": shape.rate,
                "pixel_shift_by_row": shift,
                "pixels_per_column": channels,
                **udp,
            },
            "lidar_intrinsics": {"lidar_to_sensor_transform": shape.lidar_to_sensor},
            "sensor_info": {
                "build_date": "2023-11-01T00:00:00Z",
                "build_rev": "v3.1.0",
                "image_rev": "ousteros-image-prod-bootes-v3.1.0+lidarsim",
                "initialization_id": INITIALISATION,
                "prod_line": self._product,
                "prod_pn": "lidarsim",
                "prod_sn": str(self._serial),
                "status": "RUNNING",
            },
        }


def _packet(variant: str, channels: int) -> np.dtype[np.void]:
    """Return the type of a packet."""
    head: list[Any] = [("timestamp", "<u8"), ("measurement", "<u2")]
    pixels: Any = ("pixels", _PROFILES[variant].pixel, (channels,))
    if variant == "legacy":
        column = np.dtype([*head, ("frame", "<u2"), ("encoder", "<u4"), pixels, ("status", "<u4")])
        return np.dtype([("columns", column, (COLUMNS,))])
    column = np.dtype([*head, ("status", "<u2"), pixels])
    # Of the identity, 24 bits are the initialisation id and 40 the serial number. The rest of the header, 0, says that
    # there are no alerts, that the sensor is neither hot nor limits its shots.
    header: list[Any] = [("type", "<u2"), ("frame", "<u2"), ("identity", "<u8"), ("state", "u1", (20,))]
    return np.dtype([*header, ("columns", column, (COLUMNS,)), ("reserved", "u1", (24,)), ("crc", "<u8")])


def _geometry(lidar: Lidar) -> _Geometry:
    """Return the geometry of a sensor's pattern, after checking that Ouster's metadata can describe it."""
    pattern = lidar.pattern
    if not isinstance(pattern, Spinning):
        raise FileFormatError(f"pattern: expected Spinning for Ouster's packets, got {type(pattern).__name__}")
    columns, rate, (channels, count) = pattern.columns_per_turn, pattern.rate, pattern.shape
    known = [tuple(map(float, mode.split("x"))) for mode in MODES]
    what = f"those of one of the modes {', '.join(MODES)}"
    _expect((columns, rate) in known, "columns and rate", what, f"{columns:.15g}x{rate:.15g}")
    _expect(channels in CHANNELS, "channels", f"one of {', '.join(map(str, CHANNELS))}", channels)
    _expect(pattern.clockwise, "clockwise", "True", pattern.clockwise)
    _expect(not pattern.firing_times.any(), "firing_times", "0: all channels of a column fire together", "others")
    (x, y, z), others = pattern.beam_origins[0], pattern.beam_origins[1:]
    _expect(bool((others == (x, y, z)).all()), "beam_origins", "the same for all channels", "several")
    _expect(y == 0.0, "beam_origins", "y = 0", f"{y:g} m")
    # The metadata has numbers in mm and degrees. Rounded to 1e-9 mm and 1e-10 degrees, far below the steps of a range,
    # decimal numbers of files are what they were before they were converted to m and rad.
    offsets = np.unique(np.asarray(lidar.range_offset))
    zero, out = (round(float(value) * 1e3, 9) for value in (offsets[0], x))
    expected = f"one number, at least {out / 1e3:g} m, the distance of the beams' origin from the axis"
    _expect(len(offsets) == 1 and zero >= abs(out), "range_offset", expected, lidar.range_offset)
    # A range is counted from n = hypot(out, up) before the beam's origin, which is (out, 0, up) in the lidar frame;
    # how much of the origin's height is that of the lidar frame above the sensor frame therefore follows from n.
    up = math.sqrt(zero**2 - out**2)
    turn = 2.0 * math.pi
    first = 0 if count == columns else round((math.pi - pattern.start_azimuth) / turn * columns) % round(columns)
    start = pattern.start_azimuth + turn * (first / columns)
    cosine, sine = (-1.0, 0.0) if start == math.pi else (math.cos(start), math.sin(start))
    height = round(float(z) * 1e3 - up, 9)
    return _Geometry(
        altitudes=np.degrees(pattern.elevations).round(10).tolist(),
        azimuths=(0.0 - np.degrees(pattern.azimuth_offsets)).round(10).tolist(),
        columns=round(columns),
        rate=round(rate),
        first=first,
        used=count,
        beam_to_lidar=[1.0, 0.0, 0.0, out, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, up, 0.0, 0.0, 0.0, 1.0],
        lidar_to_sensor=[cosine, -sine, 0, 0, sine, cosine, 0, 0, 0, 0, 1, height, 0, 0, 0, 1],
    )


def _expect(holds: bool, argument: str, expected: str, got: object) -> None:
    if not holds:
        raise FileFormatError(f"{argument}: expected {expected} for Ouster's packets, got {got}")


def _azimuth_window(shape: _Geometry) -> list[int]:
    """Return the directions between which the sensor fires, in millidegrees of the encoder, counter-clockwise."""
    if shape.used == shape.columns:
        return [0, 360_000]
    ends = (1.0 - (shape.first + shape.used - 1) / shape.columns, 1.0 - shape.first / shape.columns)
    return [round(360_000 * end) % 360_000 for end in ends]


def _product(model: str, channels: int) -> str:
    """Return the product line, such as "OS-1-128", of a preset or of metadata that `Lidar.from_file` has read."""
    found = re.match(r"ouster-os-?([012])-", model, re.IGNORECASE)
    if found is None:
        raise FileFormatError(f"model: expected ouster-os0-*, ouster-os1-* or ouster-os2-*, got {model!r}")
    return f"OS-{found[1]}-{channels}"


_POLYNOMIAL = np.uint64(0xC96C5795D7870F42)


def crc64(words: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return the CRC-64 of each row of words: that of ECMA-182, bits reversed, begun and ended with ones, as in XZ.

    The words are little-endian. With A the step of the checksum by eight bytes of zeros, which is linear in bits, that
    of words w0, w1, …, wn is A(…A(A(w0 + 1…1) + w1)… + wn) + 1…1, where + is exclusive or. Neighbours are combined in
    pairs, with the steps A, A², A⁴, … .
    """
    ones = np.uint64(0xFFFFFFFFFFFFFFFF)
    left = words.copy()
    left[:, 0] ^= ones
    doublings = 0
    while left.shape[1] > 1:
        if left.shape[1] % 2:
            left = np.pad(left, ((0, 0), (1, 0)))  # leading zeros change nothing, since the ones are added
        left = _apply(_step(doublings), left[:, ::2]) ^ left[:, 1::2]
        doublings += 1
    return _apply(_step(0), left)[:, 0] ^ ones


@cache
def _step(doublings: int) -> npt.NDArray[np.uint64]:
    """Return A of each value of each byte of a word, or A^(2^doublings), shape (8, 256)."""
    if doublings:
        half = _step(doublings - 1)
        return _apply(half, half)
    values = np.arange(256, dtype=np.uint64) << (8 * np.arange(8, dtype=np.uint64)[:, None])
    for _ in range(64):
        values = (values >> np.uint64(1)) ^ np.where(values & np.uint64(1), _POLYNOMIAL, np.uint64(0))
    return values


def _apply(step: npt.NDArray[np.uint64], words: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return a step of each word, which is that of its bytes, added."""
    values = np.ascontiguousarray(words, dtype="<u8").view(np.uint8).reshape(*words.shape, 8)
    result, part = np.zeros(words.shape, np.uint64), np.empty(words.shape, np.uint64)
    for table, value in zip(step, np.moveaxis(values, -1, 0), strict=True):
        result ^= table.take(value, out=part, mode="clip")  # without a buffer; a byte is never clipped
    return result


register(
    PacketFormat(
        name="ouster",
        models={
            "ouster-os*": "OS0, OS1 and OS2 of 16 to 128 channels: presets, and metadata JSON by `Lidar.from_file`"
        },
        variants=tuple(_PROFILES),
        port=PORT,
        encoder=_Encoder,
    )
)
