"""Hesai's calibration files: the channel angles as CSV (DAT for the AT128), and the firing times as CSV.

Hesai's x axis points right and y forward, and azimuths grow clockwise from y. When channel i fires at rotor azimuth a,
its beam leaves the optical centre, which turns with the rotor, at azimuth a + Azimuth[i] and elevation Elevation[i].
In lidarsim x points forward and azimuths grow counter-clockwise, so the files' azimuths change sign.

Hesai measures ranges from the axis of the rotor: a point at distance r along a beam u from the optical centre o has
the range |o + r u|. To first order in |o|/r that is r + o.u; the remainder, at most (|o|^2 - (o.u)^2) / 2r, is less
than 1 mm beyond 0.5 m.

The AT128 has a rotating mirror instead, and its front is at azimuth 90 degrees. At encoder angle e, between the start
and the end of a facet, the beam of channel i in the DAT file points at::

    azimuth   = 2 (e - start) - azimuth[i] + azimuth_adjust[i](e)
    elevation = elevation[i] + elevation_adjust[i](e)

with adjustments tabulated every 2 degrees of e and interpolated linearly. So its azimuth[i] has the opposite sign of
the one in the CSV, and the same sign as lidarsim's azimuth offset.

Source: HesaiTechnology/HesaiLidar_SDK_2.0, libhesai/UdpParser: src/general_parser.cc, udp1_4_parser.cc,
udp3_2_parser.cc and udp4_3_parser.cc, include/general_parser.h (the zero of ranges) and udp4_3_parser.h.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, array, real
from lidarsim.errors import ArgumentValueError, FileFormatError
from lidarsim.io.vendors._reading import refusals
from lidarsim.lidar import Lidar, register_lidar_reader
from lidarsim.patterns import PolygonMirror, Spinning, Table
from lidarsim.patterns._parts import directions_of
from lidarsim.patterns.table import columns_of

ANGLES = "Hesai angle correction CSV"
MIRROR_ANGLES = "Hesai angle correction DAT"
FIRING_TIMES = "Hesai firetime correction CSV"


class Model(NamedTuple):
    """Channel angles that identify a model, degrees."""

    name: str
    channels: int
    top: float
    bottom: float
    widest: float
    """Greatest absolute azimuth of a channel."""
    preset: str | None


MODELS = (
    Model("Pandar40P", 40, 15.0, -25.0, 5.2, "hesai-pandar40p"),
    Model("Pandar64", 64, 15.0, -25.0, 5.2, "hesai-pandar64"),
    Model("PandarQT64", 64, 52.1, -52.1, 8.7, "hesai-qt64"),
    Model("PandarXT32", 32, 15.0, -16.0, 0.0, "hesai-xt32"),
    Model("XT32M2X", 32, 19.5, -20.8, 0.0, "hesai-xt32m2x"),
    Model("QT128C2X", 128, 52.6, -52.6, 10.1, None),
    Model("Pandar128E3X", 128, 14.4, -25.0, 7.8, "hesai-pandar128"),
    Model("OT128", 128, 15.0, -24.8, 4.6, "hesai-ot128"),
    Model("AT128", 128, 12.9, -12.5, 2.4, "hesai-at128"),
)
MARGIN = 1.5
"""Tolerance for the outermost channels of a unit, degrees; units of a model differ by less than half a degree."""

Firings = list[tuple[npt.NDArray[np.intp], Floats]]
"""Channels that fire in a column, and their firing times since its start, s; one entry per kind of column, in the order
in which the kinds alternate."""


def recognise_angles(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of an angle correction CSV."""
    return re.match(r"(EEFF.*\n)?(Channel|Laser id)\s*,\s*Elevation\s*,\s*Azimuth\s", text, re.IGNORECASE) is not None


def recognise_mirror_angles(path: Path, text: str) -> bool:
    """Return whether the file `path`, whose head is `text`, is an angle correction DAT."""
    if not text.startswith("\ufffd\ufffd"):  # neither byte of its mark is UTF-8
        return False
    with path.open("rb") as file:
        return file.read(2) == b"\xee\xff"


def recognise_firing_times(_path: Path, text: str) -> bool:
    """Return whether `text` is the head of a firetime correction CSV."""
    heads = (
        r"Channel\s*,\s*fire ?time",
        r"([\d.]+,distance.*\n)?operation(al state| mode)\s*,",
        r"EEFF.*\n.*LoopNum",
    )
    return re.match("|".join(heads), text, re.IGNORECASE) is not None


def read(
    path: Path, *, firing_times: str | Path | None = None, rate: float | None = None, noise: str | None = None
) -> Lidar:
    """Return the sensor that a Hesai angle correction CSV describes.

    The number and the angles of the channels identify the model; its preset gives everything else.

    Parameters
    ----------
    path : path-like
        The file.
    firing_times : path-like, optional
        The firetime correction CSV of the sensor. For the Pandar128E3X and OT128, the standard mode at far ranges is
        used, in which two sets of firing times alternate between columns. The QT128C2X requires this file, since only
        96 of its channels fire in each column. Default: the preset's firing times.
    rate : float, optional
        Turns, and thus frames, per second, Hz. Default: the preset's.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor.

    Raises
    ------
    FileFormatError
        If a file is incomplete or the model of the sensor is not supported.
    """
    with refusals(path, ANGLES):
        elevations, azimuths = _by_channel(path, "elevation", "azimuth")
        model = _model(elevations, azimuths)
        if model.preset is None and firing_times is None:
            raise ValueError(
                f"recognised a {model.name}, whose channels do not all fire in each column: give the {FIRING_TIMES} as "
                "its firing_times"
            )
    lidar = _qt128(noise) if model.preset is None else Lidar.preset(model.preset, noise=noise)
    changes: dict[str, Any] = {"elevations": np.radians(elevations), "azimuth_offsets": np.radians(-azimuths)}
    if rate is not None:
        changes["rate"] = real("rate", rate, above=0.0)
    firings = [] if firing_times is None else _firings(Path(firing_times), model)
    if len(firings) == 1:
        changes["firing_times"] = firings[0][1]
    with refusals(*((path, ANGLES) if firing_times is None else (Path(firing_times), FIRING_TIMES))):
        pattern = dataclasses.replace(cast("PolygonMirror | Spinning", lidar.pattern), **changes)
        if isinstance(pattern, PolygonMirror):
            return dataclasses.replace(lidar, pattern=pattern)
        beams = directions_of(pattern.azimuth_offsets, pattern.elevations)
        return dataclasses.replace(
            lidar,
            pattern=_taking_turns(pattern, firings) if len(firings) > 1 else pattern,
            range_offset=(pattern.beam_origins * beams).sum(axis=-1).tolist(),
        )


def read_mirror(
    path: Path, *, firing_times: str | Path | None = None, rate: float | None = None, noise: str | None = None
) -> Lidar:
    """Return the AT128 that a Hesai angle correction DAT describes.

    A frame is one sweep of one mirror facet. The file gives the start and the deflection of each facet. Hesai's decoder
    rounds the adjustments to 0.01 degrees; here they are not rounded.

    Parameters
    ----------
    path : path-like
        The file, of version 1.5.
    firing_times : path-like, optional
        The firetime correction CSV of the sensor. Default: the preset's firing times.
    rate : float, optional
        Frames per second, Hz. Default: the preset's.
    noise : {"datasheet", "measured"}, optional
        As in `Lidar.preset`.

    Returns
    -------
    Lidar
        The sensor: a `Table` of one turn of the mirror, otherwise like the preset.

    Raises
    ------
    FileFormatError
        If a file is incomplete, or not for an AT128.
    """
    lidar = Lidar.preset("hesai-at128", noise=noise)
    preset = cast("PolygonMirror", lidar.pattern)
    model = MODELS[-1]
    with refusals(path, MIRROR_ANGLES):
        mirror = _Mirror.from_bytes(path.read_bytes(), model)
    times = preset.firing_times
    if firing_times is not None:
        firings = _firings(Path(firing_times), model)
        if len(firings) != 1:
            raise FileFormatError(
                f"{firing_times}: {FIRING_TIMES}: expected one time of each channel, got {len(firings)}"
            )
        times = firings[0][1]
    rate = preset.rate if rate is None else real("rate", rate, above=0.0)
    with refusals(path, MIRROR_ANGLES):
        return dataclasses.replace(lidar, pattern=mirror.turn(preset, times, rate))


def refuse_firing_times(path: Path) -> Lidar:
    """Raise an error that explains how to use a firetime correction CSV, which alone does not describe a sensor."""
    raise FileFormatError(
        f"{path}: {FIRING_TIMES}: the angles of the channels are missing: "
        f"give the {ANGLES} as the file and this one as its firing_times"
    )


class _Mirror(NamedTuple):
    """Contents of a DAT file, in degrees."""

    starts: Floats
    """Encoder angle at which each facet begins, shape (facets,)."""
    azimuth: Floats
    elevation: Floats
    azimuth_adjust: Floats
    """One row per channel, one number per 2 degrees of the encoder, shape (channels, 180)."""
    elevation_adjust: Floats

    @classmethod
    def from_bytes(cls, data: bytes, model: Model) -> _Mirror:
        """Parse the bytes of a file, after checking their length and hash.

        The layout: a header (mark, version, numbers of channels, mirrors and frames, eight bytes for the order of the
        frames, and a resolution: angles are in units of resolution/25600 degrees, adjustments of resolution/100
        degrees); then, little-endian, starts and ends of the frames (uint32), azimuths and elevations (int32), azimuth
        and elevation adjustments (int8); last, the SHA-256 of all preceding bytes.
        """
        header = struct.Struct("<2x5B8xB")
        if len(data) < header.size:
            raise ValueError(f"expected a header of {header.size} bytes, got {len(data)}")
        major, minor, channels, _, frames, resolution = header.unpack_from(data)
        if (major, minor) != (1, 5):
            raise ValueError(f"expected version 1.5, got {major}.{minor}")
        if channels != model.channels:
            raise ValueError(f"expected the {model.channels} channels of an {model.name}, got {channels}")
        angles, adjusts, digest = 4 * (2 * frames + 2 * channels), 2 * channels * 180, hashlib.sha256().digest_size
        size = header.size + angles + adjusts + digest
        if len(data) != size:
            raise ValueError(f"expected {size} bytes, got {len(data)}")
        if hashlib.sha256(data[:-digest]).digest() != data[-digest:]:
            raise ValueError("expected the last 32 bytes to be the SHA-256 of all before them, got others")
        whole = np.frombuffer(data, "<i4", 2 * frames + 2 * channels, header.size) * (resolution / 25600.0)
        small = np.frombuffer(data, "i1", adjusts, header.size + angles) * (resolution / 100.0)
        azimuth, elevation = whole[2 * frames :].reshape(2, channels)
        return cls(whole[:frames], azimuth, elevation, *small.reshape(2, channels, 180))

    def turn(self, preset: PolygonMirror, firing_times: Floats, rate: float) -> Table:
        """Return one turn of the mirror, one frame per facet, with the field of view and pulse rate of `preset`."""
        used = math.degrees(preset.field_of_view) / 2.0  # encoder degrees: beams turn twice as fast as the mirror
        before = (90.0 - used) / 2.0  # centres the used part on the front
        speed = rate * 360.0 / len(self.starts)
        past = (self.starts - self.starts[0]) % 360.0
        even = np.arange(len(past)) * 360.0 / len(past)
        past += max(0.0, (even - past).max())  # no line begins before its frame
        channels = np.arange(len(firing_times))
        tables = []
        for start, since in zip(self.starts, past, strict=True):
            first, end = (math.ceil(angle / speed * preset.pulse_rate) for angle in (since, since + used))
            cycle = np.arange(first, end)[:, None]
            time = cycle / preset.pulse_rate + firing_times
            turned = before + speed * time - since  # from the start of the facet
            azimuth = 90.0 - 2.0 * turned + self.azimuth - self._adjustments(self.azimuth_adjust, start + turned)
            elevation = self.elevation + self._adjustments(self.elevation_adjust, start + turned)
            directions = directions_of(np.radians(azimuth), np.radians(elevation))
            rings, columns = np.broadcast_arrays(channels, cycle - first)
            tables.append((directions.reshape(-1, 3), time.ravel(), rings.ravel(), columns.ravel()))
        directions, times, rings, columns = (np.concatenate(parts) for parts in zip(*tables, strict=True))
        return Table(directions, times=times, rings=rings, columns=columns, rate=rate)

    @staticmethod
    def _adjustments(table: Floats, encoder: Floats) -> Floats:
        """Return the adjustments of the channels, one row of `table` each, at encoder angles of shape (n, channels)."""
        place = encoder % 360.0 / 2.0
        before = np.floor(place).astype(np.intp)
        part = place - before
        channel = np.arange(len(table))
        low, high = table[channel, before % 180], table[channel, (before + 1) % 180]
        result: Floats = (1.0 - part) * low + part * high
        return result


def _qt128(noise: str | None) -> Lidar:
    """Return a QT128C2X without the angles of its channels."""
    if noise is not None:
        raise ArgumentValueError("noise", "None, since no datasheet noise is known for the QT128C2X", repr(noise))
    # Source: tier4/nebula nebula_hesai_decoders, pandar_qt128.hpp: ranges, and 0.4 degrees per column at 10 Hz;
    # HesaiLidar_SDK_2.0, udp3_2_parser.cc: optical centre.
    pattern = Spinning(np.zeros(128), column_period=1.0 / 9000.0, beam_origins=(0.0354, -0.0072, 0.0))
    return Lidar(pattern, min_range=0.05, max_range=50.0, name="hesai-qt128")


def _taking_turns(rotor: Spinning, firings: Firings) -> Table:
    """Return one turn of a rotor whose columns cycle through `firings`, with equally many columns of each."""
    kinds = len(firings)
    columns = round(rotor.columns_per_turn / kinds)
    channel = np.concatenate([channels for channels, _ in firings])
    kind = np.repeat(np.arange(kinds), [len(channels) for channels, _ in firings])
    period = 1.0 / (columns * kinds * rotor.rate)
    pulses = Spinning(
        rotor.elevations[channel],
        azimuth_offsets=rotor.azimuth_offsets[channel],
        columns=columns,
        rate=rotor.rate,
        firing_times=np.concatenate([times for _, times in firings]) + kind * period,
        beam_origins=rotor.beam_origins[channel],
    ).pulses()
    return Table(
        pulses.directions,
        times=pulses.time,
        rings=channel[pulses.ring],
        columns=pulses.column * kinds + kind[pulses.ring],
        origins=pulses.origins,
        rate=rotor.rate,
    )


def _firings(path: Path, model: Model) -> Firings:
    """Return the firings in a firetime correction CSV, with times since the earliest."""
    with refusals(path, FIRING_TIMES):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        cells = [[cell.strip() for cell in line.split(",")] for line in lines if line.strip()]
        if cells and cells[0][0].upper() == "EEFF":
            firings = _loops(cells)
        elif any(row[0].lower().startswith("operation") for row in cells[:2]):
            firings = _states(cells)
        else:
            (times,) = _by_channel(path, "fire")
            firings = [(np.arange(len(times)), times / 1e6)]
        fired = np.unique(np.concatenate([channels for channels, _ in firings]))
        if not np.array_equal(fired, np.arange(model.channels)):
            raise ValueError(f"expected the {model.channels} channels of a {model.name}, got {len(fired)}")
        earliest = min(times.min() for _, times in firings)
        return [(channels, times - earliest) for channels, times in firings]


def _states(cells: list[list[str]]) -> Firings:
    """Return the firings of the standard mode: the columns of operation mode 2 at far ranges, one per state.

    Times are in microseconds, or in nanoseconds if the first line distinguishes far from near.
    """
    near_and_far = "distance" in "".join(cells[0])
    (modes, states, *rows), unit = (cells[1:], 1e-9) if near_and_far else (cells, 1e-6)
    columns: dict[str, int] = {}
    for column, (mode, state) in enumerate(zip(modes, states, strict=True)):
        if mode == "2":
            columns.setdefault(state, column)  # the first column of each state is for far ranges
    if not columns or any(len(row) != len(modes) for row in rows):
        raise ValueError(f"expected rows of {len(modes)} cells, and some of them in operation mode 2")
    channel = _channels(np.array(_numbers(row[0] for row in rows)))
    return [
        (channel, array("fire times", _numbers(row[column] for row in rows), (len(rows),)) * unit)
        for column in columns.values()
    ]


def _loops(cells: list[list[str]]) -> Firings:
    """Return the firings of loops with two columns each: the channel, 0 in unused rows, and its time in µs."""
    rows = array("rows", [_numbers(row) for row in cells[3:]], ("n", len(cells[2])))
    loops = np.split(rows, rows.shape[1] // 2, axis=1)
    numbers = rows[:, ::2]
    if not np.array_equal(numbers, np.clip(np.floor(numbers), 0, 65_535)):
        raise ValueError("expected numbers of channels, got some that are negative, broken or too great")
    fired = [loop[loop[:, 0] > 0.0] for loop in loops]
    return [(loop[:, 0].astype(np.intp) - 1, loop[:, 1] / 1e6) for loop in fired]


def _channels(numbers: Floats) -> npt.NDArray[np.intp]:
    """Return the indices, from 0, of channels that are numbered from 1."""
    if not np.array_equal(np.sort(numbers), np.arange(1, len(numbers) + 1)):
        raise ValueError(f"expected each of the channels 1 to {len(numbers)} once")
    return numbers.astype(np.intp) - 1


def _numbers(cells: Iterable[str]) -> list[float]:
    """Return the numbers in cells; errors do not show their content, since it may be of any file."""
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        raise ValueError("expected numbers, got something else") from None


def _by_channel(path: Path, *names: str) -> list[Floats]:
    """Return the columns whose names start with `names`, ordered by the channel numbers in the first column."""
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    if lines and lines[0].upper().startswith("EEFF"):
        del lines[0]
    if lines and re.fullmatch(r"[0-9a-fA-F]{64}", lines[-1].strip()):  # the SHA-256 of the file
        del lines[-1]
    (_, numbers), *others = columns_of(lines).items()
    order = np.argsort(_channels(numbers))
    named = {start: values for start in names for name, values in others if name.startswith(start)}
    missing = [name for name in names if name not in named]
    if missing:
        raise ValueError(f"expected a column that starts with {missing[0]}")
    return [array(name, named[name], (len(order),))[order] for name in names]


def _model(elevations: Floats, azimuths: Floats) -> Model:
    top, bottom, widest = elevations.max(), elevations.min(), np.abs(azimuths).max()
    for model in MODELS:
        apart = max(abs(model.top - top), abs(model.bottom - bottom), abs(model.widest - widest))
        if model.channels == len(elevations) and apart <= MARGIN:
            return model
    known = ", ".join(
        f"{model.name} ({model.channels}, {model.top} to {model.bottom}, +-{model.widest})" for model in MODELS
    )
    raise ValueError(
        f"expected channels, elevations and azimuths of one of {known}, got {len(elevations)} channels, "
        f"{top:g} to {bottom:g}, +-{widest:g} degrees"
    )


register_lidar_reader(ANGLES, recognise_angles, read)
register_lidar_reader(MIRROR_ANGLES, recognise_mirror_angles, read_mirror)
register_lidar_reader(FIRING_TIMES, recognise_firing_times, refuse_firing_times)
