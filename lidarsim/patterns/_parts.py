"""Helpers of the scan patterns: channels, unit vectors, firing clocks."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.validation import Floats, array, ask, dimensions, freeze
from lidarsim.errors import ArgumentValueError
from lidarsim.patterns._pulses import Pulses, ScanPattern, make_pulses

TURN = 2.0 * math.pi

INTERLEAVED = 8
"""Fewest channels of which half may be of a second series."""

LAST_STEP = math.radians(10.0)
"""Largest step, rad, that may be five times all others at the end of a list."""

PULSE_BYTES = 100
"""Memory that a pulse takes: 62 bytes in its frame, and 38 that the frames of its pattern share."""


def per_channel(name: str, value: npt.ArrayLike, channels: int, *, width: int | None = None) -> Floats:
    """Return `value`, one row per channel or one row for all, as a read-only array with one row per channel."""
    tail = () if width is None else (width,)
    values = array(name, value, tail if dimensions(value) == len(tail) else (channels, *tail))
    return freeze(np.broadcast_to(values, (channels, *tail)))


def ask_order(name: str, values: Floats, offsets: Floats | None = None, times: Floats | None = None) -> None:
    """Ask if angles, of channels with these azimuth offsets, occur twice or are neither rising nor falling evenly.

    Angles that are all equal are deliberate, and so are two interleaved series, such as lasers in firing order. No
    question about channels with firing times of their own: a decimal comma would make more channels than times.
    """
    if times is not None and len(times) and np.ptp(times) > 0.0:
        return
    offsets = np.zeros(len(values)) if offsets is None else offsets
    known, first, counts = np.unique(np.column_stack([offsets, values]), axis=0, return_index=True, return_counts=True)
    if len(known) > 1 and (twice := np.flatnonzero(counts > 1)).size:
        i = first[twice].min()
        ask(name, f"{math.degrees(values[i]):g} degrees twice or more, first at {name}[{i}]", "one too many?")
    for offset in np.unique(offsets):
        (rows,) = np.nonzero(offsets == offset)
        steps = np.diff(values[rows])
        rising, falling = int((steps > 0).sum()), int((steps < 0).sum())
        if rising and falling and not (len(rows) >= INTERLEAVED and _is_interleaved(values[rows])):
            i, what = np.flatnonzero(steps > 0 if rising <= falling else steps < 0)[0], "out of order"
        elif len(steps) > 1 and steps[-1] > max(LAST_STEP, 5.0 * np.abs(steps[:-1]).max()):
            i, what = len(steps) - 1, "far from the others"  # "3,33" at the end of a rising list
        else:
            continue
        told = ", ".join(f"{angle:g}" for angle in np.degrees(values[rows[i : i + 2]]))
        ask(name, f"{what} at {name}[{rows[i]}] ({told} degrees)", "a decimal comma?")


def _is_interleaved(values: Floats) -> bool:
    """Return whether every other value is of one of two series that both rise or both fall."""
    directions = {tuple(np.unique(np.sign(np.diff(values[start::2])))) for start in (0, 1)}
    return directions in ({(1.0,)}, {(-1.0,)})


def rings(name: str, count: int, *, at_least: int = 1) -> int:
    """Return the number of rings given by the argument `name`, after checking that their indices fit uint16."""
    if not at_least <= count <= 1 << 16:
        raise ArgumentValueError(name, f"{at_least} to 65536 of them", count)
    return count


def cycles(name: str, rate: float, frame_rate: float) -> int:
    """Return the most firing cycles of a frame, after checking that each can have a uint32, its column."""
    count = math.ceil(Fraction(rate) / Fraction(frame_rate))
    if count > 1 << 32:
        raise ArgumentValueError(name, f"at most {1 << 32} firing cycles a frame", count)
    return count


def expect_room(pulses: int) -> None:
    """Raise MemoryError, before any work, if the system would not give the memory to make so many pulses."""
    count = pulses * PULSE_BYTES
    try:
        np.empty(min(count, sys.maxsize), np.uint8)
    except (MemoryError, ValueError):
        raise MemoryError(f"out of memory: {count} bytes for the {pulses} pulses of a frame") from None


def unit(vectors: Floats) -> Floats:
    """Return non-zero vectors, shape (n, 3), divided by their lengths, without overflow or underflow of squares."""
    scaled = vectors / np.abs(vectors).max(axis=-1, keepdims=True, initial=0.0)
    x, y, z = scaled.T
    return np.asarray(scaled / np.sqrt(x * x + y * y + z * z)[:, None])


def rotate(vectors: Floats, azimuth: Floats) -> Floats:
    """Return `vectors`, of shape (..., 3), turned about z."""
    cosine, sine, _ = np.moveaxis(directions_of(azimuth, np.zeros(1)), -1, 0)
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack(np.broadcast_arrays(cosine * x - sine * y, sine * x + cosine * y, z), axis=-1)


def directions_of(azimuth: Floats, elevation: Floats) -> Floats:
    """Return the unit vectors, of shape (..., 3), at an azimuth (from x to y) and an elevation above the x-y plane."""
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    directions = np.empty((*azimuth.shape, 3))
    _native.fire_polar(azimuth.ravel(), elevation.ravel(), directions.reshape(-1, 3))
    return directions


@lru_cache(maxsize=256)
def ratio(rate: float | Fraction, other: float | Fraction) -> tuple[int, int]:
    """Return numerator and denominator of a quotient of two rates, exactly."""
    return (Fraction(rate) / Fraction(other)).as_integer_ratio()


def wait(frame: int, rate: float | Fraction, frame_rate: float | Fraction) -> float:
    """Return the time from the start of a frame to the first tick of a clock of `rate`, Hz, in ticks."""
    ticks, frames = ratio(rate, frame_rate)
    return -frame * ticks % frames / frames


@dataclass(frozen=True)
class Ticks:
    """The ticks of a steady clock in one frame: `first` to ``first + count - 1``, tick m at ``m / rate`` s.

    The ticks are divided among the frames in exact arithmetic, so each tick belongs to exactly one frame, however late.
    """

    rate: float
    first: int
    count: int
    wait: float
    """Time from the start of the frame to its first tick, in ticks."""

    @classmethod
    def of(cls, frame: int, rate: float, frame_rate: float) -> Ticks:
        """Return the ticks m of a clock of `rate`, Hz, with ``frame <= m frame_rate / rate < frame + 1``."""
        ticks, frames = ratio(rate, frame_rate)
        first = -(-frame * ticks // frames)
        count = -(-(frame + 1) * ticks // frames) - first
        return cls(rate, first, count, wait(frame, rate, frame_rate))

    @property
    def time(self) -> Floats:
        """Time of each tick since the start of the frame, s."""
        return (np.arange(self.count, dtype=np.float64) + self.wait) / float(self.rate)

    def turns(self, rotation_rate: float | Fraction) -> tuple[int, int]:
        """Return the phase at the first tick, and what each tick adds, of a rotation of phase 0 at time 0.

        Both are in units of 2**-128 of a turn, without whole turns, and rounded down, so the phase of any tick is off
        by less than 2**-95 turns.
        """
        turns, ticks = ratio(rotation_rate, self.rate)
        first, step = self.first * turns % ticks, turns % ticks
        return (first << 128) // ticks, (step << 128) // ticks


class Frames:
    """What the frames of a pattern have in common: the rings and columns of their pulses, and often times and origins.

    Parameters
    ----------
    rings : ndarray of uint16, shape (beams,)
        Those of a column, in firing order.
    columns : int
        Most columns of a frame.
    origins : ndarray of float64, shape (beams, 3), optional
        Where the pulses of each column leave the sensor. None if that differs between columns.
    """

    def __init__(self, rings: npt.NDArray[np.uint16], columns: int, origins: Floats | None) -> None:
        self._beams = len(rings)
        expect_room(columns * self._beams)
        self._ring = np.tile(rings, columns)
        self._column = np.repeat(np.arange(columns, dtype=np.uint32), self._beams)
        self._origin: tuple[float, ...] | None = None
        self._origins = np.empty((0, 3))
        if origins is not None:
            same = bool((origins == origins[0]).all())
            self._origin = tuple(origins[0].tolist()) if same else None
            # Zeros that are not written take no memory.
            shape = (columns * self._beams, 3)
            self._origins = np.tile(origins, (columns, 1)) if origins.any() else np.zeros(shape)
        for values in (self._ring, self._column, self._origins):
            values.setflags(write=False)
        self._cut = self._origins, self._ring, self._column
        self._last: tuple[tuple[float, int], Floats] | None = None

    def fire_together(self, ticks: Ticks, fire: Callable[[Ticks, Floats], object]) -> Pulses:
        """Return the pulses of beams that fire together at each tick; `fire` writes their directions."""
        directions = np.empty((ticks.count * self._beams, 3))
        fire(ticks, directions)
        last = self._last
        if last is None or last[0] != (ticks.wait, ticks.count):
            last = self._last = ((ticks.wait, ticks.count), freeze(np.repeat(ticks.time, self._beams)))
        return self.pulses(directions, last[1])

    def pulses(self, directions: Floats, time: Floats, origins: Floats | None = None) -> Pulses:
        """Return the pulses of a frame, with their `origins` unless these are the same in all columns."""
        count, cut = len(directions), self._cut
        if len(cut[1]) != count:
            cut = self._cut = self._origins[:count], self._ring[:count], self._column[:count]
        common, ring, column = cut
        origin = self._origin if count else None
        return make_pulses(directions, common if origins is None else origins, time, ring, column, origin=origin)


class SteadyPattern(ScanPattern):
    """Base of the patterns whose beams fire together at the ticks of a steady clock, on from frame to frame."""

    __slots__ = ()

    rate: float
    pulse_rate: float

    @property
    def _beams(self) -> int:
        return 1

    @property
    def _tick_rate(self) -> float:
        return self.pulse_rate

    @property
    def shape(self) -> tuple[int, int]:
        """Beams, and most pulses of a beam in a frame."""
        return self._beams, cycles("pulse_rate", self._tick_rate, self.rate)

    def _fire_frame(self, frame: int, /) -> Pulses:
        return self._frames.fire_together(Ticks.of(frame, self._tick_rate, self.rate), self._fire)

    def _fire(self, ticks: Ticks, directions: Floats) -> None:
        """Write the directions of all beams at each tick."""
        raise NotImplementedError

    @cached_property
    def _frames(self) -> Frames:
        beams, columns = self.shape
        return Frames(np.arange(beams, dtype=np.uint16), columns, np.zeros((beams, 3)))


class Cycles:
    """Channels that fire in cycles, in an order of their own, while a head or a mirror turns about z.

    Parameters
    ----------
    elevations, azimuth_offsets, firing_times : ndarray of float64, shape (channels,)
        Of each channel: its direction at the azimuth 0, rad, and the time since the start of a cycle, s.
    origins : ndarray of float64, shape (channels, 3)
        Where each channel leaves the sensor at the azimuth 0, m. They turn with the head.
    speed : float
        Speed of the turn, rad/s.
    columns : int
        Most cycles of a frame.
    """

    def __init__(
        self,
        elevations: Floats,
        azimuth_offsets: Floats,
        firing_times: Floats,
        origins: Floats,
        *,
        speed: float,
        columns: int,
    ) -> None:
        order = np.argsort(firing_times, kind="stable")
        moved = speed * firing_times[order]
        turn = bool(origins[:, :2].any())
        self._frames = Frames(order.astype(np.uint16), columns, None if turn else origins[order])
        beams = directions_of(azimuth_offsets[order] + moved, elevations[order])
        self._channels = _native.Channels(beams, firing_times[order], rotate(origins[order], moved) if turn else None)
        self._count, self._turn, self._speed = len(order), turn, speed

    def fire(self, runs: Sequence[tuple[int, int, int, float]], *, rate: float, wait: float, azimuth: float) -> Pulses:
        """Return the pulses of a frame whose cycle c starts at ``(c + wait) / rate``, s.

        Each run of cycles, those of a turn or of a facet, is given by the number of its cycles in the frame; the first
        of them; how many cycles it had before the frame; and the part of a cycle by which its first one is late. Its
        head is at `azimuth` when it starts.
        """
        count = sum([run[0] for run in runs]) * self._count
        directions, times = np.empty((count, 3)), np.empty(count)
        origins = np.empty((count, 3)) if self._turn else None
        self._channels.fire(runs, (rate, wait), (azimuth, self._speed), directions, times, origins)
        return self._frames.pulses(directions, times, origins)


def firing_times_within(cycle: float, firing_times: npt.ArrayLike, channels: int) -> Floats:
    """Return the firing times of the channels, s, after checking that they lie within a cycle."""
    times = per_channel("firing_times", firing_times, channels)
    outside = (times < 0.0) | (times >= cycle)
    if outside.any():
        first = int(np.argmax(outside))
        raise ArgumentValueError(
            "firing_times",
            f"times >= 0 and < {cycle:g} s, that of a cycle",
            f"firing_times[{first}] = {times[first]:g}",
        )
    return times


def count_used_cycles(cycles: float, part: float, wait: float) -> int:
    """Return how many of the `cycles` of a turn lie in its used `part`; the first starts `wait` of a cycle late.

    The bound is lowered by 4 ulp: a part given as an angle in degrees gains at most that (two roundings in the
    conversion to radians, one in the division and one in the product). A whole number of cycles therefore stays whole.
    """
    return math.ceil(cycles * part * (1.0 if part == 1.0 else 1.0 - 4.0 * 2.0**-52) - wait)
