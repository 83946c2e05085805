"""Helpers of the scan patterns: channels, unit vectors, firing clocks."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from lidarsim._validation import Floats, array, frozen, integer
from lidarsim.errors import ArgumentValueError
from lidarsim.patterns._pulses import Pulses

TURN = 2.0 * math.pi

PULSE_BYTES = 256
"""Memory that it takes to make a pulse: 62 bytes to keep it, and up to eight vectors of float64 on the way."""


def per_channel(name: str, value: npt.ArrayLike, channels: int, *, width: int | None = None) -> Floats:
    """Return `value`, one row per channel or one row for all, as a read-only array with one row per channel."""
    tail = () if width is None else (width,)
    try:
        one_for_all = np.ndim(value) == len(tail)
    except ValueError:
        one_for_all = False
    values = array(name, value, tail if one_for_all else (channels, *tail))
    return frozen(np.broadcast_to(values, (channels, *tail)))


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
    largest = np.abs(vectors).max(axis=-1, keepdims=True, initial=0.0)
    return joined(*(vectors / largest).T)


def joined(x: Floats, y: Floats, z: Floats, *, unit: bool = True) -> Floats:
    """Return the vectors, of shape (..., 3), with the given components, divided by their lengths if `unit` is set."""
    length = np.sqrt(x * x + y * y + z * z) if unit else 1.0
    vectors = np.empty((*np.broadcast_shapes(x.shape, y.shape, z.shape), 3))
    for axis, component in enumerate((x, y, z)):
        np.divide(component, length, out=vectors[..., axis])
    return vectors


def turned(vectors: Floats, azimuth: Floats, *, unit: bool = True) -> Floats:
    """Return `vectors`, of shape (..., 3), turned about z, and divided by their lengths if `unit` is set."""
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return joined(cosine * x - sine * y, sine * x + cosine * y, z, unit=unit)


def directions_of(azimuth: Floats, elevation: Floats) -> Floats:
    """Return the unit vectors, of shape (..., 3), at an azimuth (from x to y) and an elevation above the x-y plane."""
    across = np.cos(elevation)
    return joined(across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation))


@dataclass(frozen=True)
class Ticks:
    """The ticks of a steady clock in one frame: `first` to ``first + count - 1``, tick m at ``m / rate`` s.

    The ticks are divided among the frames in exact arithmetic, so each tick belongs to exactly one frame, however late.
    """

    rate: Fraction
    first: int
    count: int
    wait: float
    """Time from the start of the frame to its first tick, in ticks."""

    @classmethod
    def of(cls, frame: int, rate: float | Fraction, frame_rate: float, *, beams: int = 0) -> Ticks:
        """Return the ticks m of a clock of `rate`, Hz, with ``frame <= m frame_rate / rate < frame + 1``.

        If so many `beams` are to fire at each, there must be memory for that.
        """
        frame = integer("frame", frame, at_least=0)
        per_frame = Fraction(rate) / Fraction(frame_rate)
        first = math.ceil(frame * per_frame)
        count = math.ceil((frame + 1) * per_frame) - first
        expect_room(count * beams)
        return cls(Fraction(rate), first, count, float(first - frame * per_frame))

    @property
    def time(self) -> Floats:
        """Time of each tick since the start of the frame, s."""
        return (np.arange(self.count, dtype=np.float64) + self.wait) / float(self.rate)

    def turns(self, rotation_rate: float | Fraction) -> Floats:
        """Return the phase at each tick, in turns, of a rotation whose phase is 0 at time 0.

        The phase of the first tick is reduced to [0, 1) exactly. The error is therefore below 2**-52 per turn within
        the frame and does not grow from frame to frame.
        """
        per_tick = Fraction(rotation_rate) / self.rate
        return float(self.first * per_tick % 1) + np.arange(self.count, dtype=np.float64) * float(per_tick)


def fired_together(directions: Floats, time: Floats) -> Pulses:
    """Return the pulses of beams, of shape (n, beams, 3), that fire together at each of n times."""
    count, beams = directions.shape[:2]
    return Pulses(
        directions=directions.reshape(-1, 3),
        origins=np.zeros((count * beams, 3)),
        time=np.repeat(time, beams),
        ring=np.tile(np.arange(beams, dtype=np.uint16), count),
        column=np.repeat(np.arange(count, dtype=np.uint32), beams),
    )


def fired_in_cycles(
    elevations: Floats,
    azimuth_offsets: Floats,
    firing_times: Floats,
    origins: Floats,
    *,
    azimuth: Floats,
    time: Floats,
    speed: float,
) -> Pulses:
    """Return the pulses of channels, one row each, whose cycles start at `azimuth` and `time`, both of shape (n,).

    Between the start of a cycle and the firing of a channel, the azimuth and the origins turn at `speed`, rad/s.
    """
    order = np.argsort(firing_times, kind="stable")
    moved = speed * firing_times[order]
    beams = directions_of(azimuth_offsets[order] + moved, elevations[order])
    return Pulses(
        directions=turned(beams, azimuth[:, None]).reshape(-1, 3),
        origins=turned(turned(origins[order], moved, unit=False), azimuth[:, None], unit=False).reshape(-1, 3),
        time=np.add.outer(time, firing_times[order]).reshape(-1),
        ring=np.tile(order.astype(np.uint16), len(time)),
        column=np.repeat(np.arange(len(time), dtype=np.uint32), len(order)),
    )


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


def used_cycles(cycles: float, part: float, wait: float) -> int:
    """Return how many of the `cycles` of a turn lie in its used `part`; the first starts `wait` of a cycle late.

    The bound is lowered by 4 ulp: a part given as an angle in degrees gains at most that (two roundings in the
    conversion to radians, one in the division and one in the product). A whole number of cycles therefore stays whole.
    """
    return math.ceil(cycles * part * (1.0 if part == 1.0 else 1.0 - 4.0 * 2.0**-52) - wait)
