"""What a scan pattern gives, and what the patterns share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from lidarsim._validation import Floats, array, integer

TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class Pulses:
    """The pulses of one frame, in the sensor frame (x forward, y left, z up) and in firing order.

    The arrays are read-only: a pattern whose frames are all alike gives the same ones for each.

    Attributes
    ----------
    directions : ndarray of float64, shape (n, 3)
        Unit direction of each beam.
    origins : ndarray of float64, shape (n, 3)
        Where each beam leaves the sensor, m.
    time : ndarray of float64, shape (n,)
        Firing time since the start of the frame, s.
    ring : ndarray of uint16, shape (n,)
        Channel that fired.
    column : ndarray of uint32, shape (n,)
        Column (firing cycle) of the frame.
    """

    directions: npt.NDArray[np.float64]
    origins: npt.NDArray[np.float64]
    time: npt.NDArray[np.float64]
    ring: npt.NDArray[np.uint16]
    column: npt.NDArray[np.uint32]

    def __post_init__(self) -> None:
        for values in (self.directions, self.origins, self.time, self.ring, self.column):
            values.setflags(write=False)

    def __len__(self) -> int:
        return len(self.directions)


@runtime_checkable
class Pattern(Protocol):
    """A scan pattern: anything that says which pulses a frame fires.

    Attributes
    ----------
    rate : float
        Frames per second, Hz. Frame k starts k/rate after frame 0.
    shape : tuple of int
        Rings and columns of a frame, the shape of its range image.
    """

    @property
    def rate(self) -> float:
        """Frames per second, Hz."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and columns of a frame."""
        ...

    def pulses(self, frame: int = 0) -> Pulses:
        """Return the pulses of frame number `frame` (>= 0)."""
        ...


def per_channel(name: str, value: Any, channels: int, *, width: int | None = None) -> Floats:
    """Return `value` as a read-only array with a row for each channel, given as that or as one row for all."""
    tail = () if width is None else (width,)
    try:
        one_for_all = np.ndim(value) == len(tail)
    except ValueError:
        one_for_all = False
    values = array(name, value, tail if one_for_all else (channels, *tail))
    return frozen(np.broadcast_to(values, (channels, *tail)))


def frozen(values: Floats) -> Floats:
    """Return a read-only copy of `values`."""
    copy = np.array(values, order="C")
    copy.setflags(write=False)
    return copy


def unit(vectors: Floats) -> Floats:
    """Return `vectors`, of shape (..., 3), divided by their lengths."""
    return vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]


def directions_of(azimuth: Floats, elevation: Floats) -> Floats:
    """Return the unit vectors, of shape (..., 3), at an azimuth from x towards y and an elevation above the x-y plane."""
    across = np.cos(elevation)
    return np.stack(np.broadcast_arrays(across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)), axis=-1)


def ticks_of(frame: int, per_frame: Fraction) -> tuple[int, int]:
    """Return the first and the number of the ticks ``m`` with ``frame <= m / per_frame < frame + 1``.

    In whole numbers, so that pulses neither get lost nor come twice between frames, however late.
    """
    frame = integer("frame", frame, at_least=0)
    first = math.ceil(frame * per_frame)
    return first, math.ceil((frame + 1) * per_frame) - first


def turns_of(first: int, count: int, per_tick: Fraction) -> Floats:
    """Return the phases, in turns, of ticks ``first`` to ``first + count - 1``, less the whole turns before the first.

    The phase of the first is reduced exactly, so that the error does not grow with the frame number.
    """
    return float(first * per_tick % 1) + np.arange(count) * float(per_tick)
