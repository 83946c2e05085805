"""A scan pattern in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidarsim.errors import ArgumentValueError
from lidarsim.patterns._pulses import Pattern, Pulses, check_pattern, pulses_of

FRAMES = 10
"""Number of frames over which rates are averaged: frames differ where a cycle does not divide them evenly."""

FIXED = 1e-12
"""Greatest variation of a ring's elevation by rounding, rad.

Directions are accurate to 2 ulp, so two elevations of a ring differ by at most 8u/cos(elevation). That is below this
bound except within 0.06° of the poles.
"""


@dataclass(frozen=True)
class Description:
    """A scan pattern in numbers.

    Attributes
    ----------
    rings : int
        Channels.
    columns : int
        Most columns of a frame.
    pulses_per_second : float
        Mean over ten frames, Hz.
    azimuth, elevation : tuple of float
        Lowest and highest of the first frame, rad.
    elevation_gap : tuple of float
        Smallest and largest step between neighbouring rings, rad; nan for one ring, or for rings of no fixed elevation.
    pulse_gap : tuple of float
        Smallest and largest angle between one pulse of a ring and the next, rad; nan if no ring has two.
    time : tuple of float
        When the first and the last pulse of the first frame fire, s since its start.
    pause : float
        Longest time without a pulse in the first frame, its end included, s.
    repeats : bool
        Whether the second frame is the same as the first.
    """

    rings: int
    columns: int
    pulses_per_second: float
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    elevation_gap: tuple[float, float]
    pulse_gap: tuple[float, float]
    time: tuple[float, float]
    pause: float
    repeats: bool


def describe(pattern: Pattern) -> Description:
    """Return a scan pattern in numbers.

    Parameters
    ----------
    pattern : Pattern
        The pattern.

    Returns
    -------
    Description
        Its rate, spans and gaps.

    Raises
    ------
    TypeError, ValueError
        If it is not a scan pattern, or its first frame has no pulses.

    Examples
    --------
    >>> from lidarsim.patterns import Spinning, describe
    >>> describe(Spinning([0.0, 0.1], columns=500, rate=20.0)).pulses_per_second
    20000.0
    """
    check_pattern(pattern)
    first, second = pulses_of(pattern, 0), pulses_of(pattern, 1)
    if not len(first):
        raise ArgumentValueError("pattern", "one whose first frame has pulses", "none")
    count = len(first) + len(second) + sum(len(pulses_of(pattern, frame)) for frame in range(2, FRAMES))
    azimuth, elevation = first.azimuth, first.elevation

    present, ring = np.unique(first.ring, return_inverse=True)
    by_ring = np.argsort(ring, kind="stable")
    starts = np.searchsorted(ring[by_ring], np.arange(len(present)))
    lowest, highest = (pick.reduceat(elevation[by_ring], starts) for pick in (np.minimum, np.maximum))
    fixed = (highest - lowest).max() < FIXED
    next_, same = first.directions[by_ring[1:]], ring[by_ring[1:]] == ring[by_ring[:-1]]
    chord = np.linalg.norm(next_ - first.directions[by_ring[:-1]], axis=-1)[same]
    return Description(
        rings=len(present),
        columns=pattern.shape[1],
        pulses_per_second=count / FRAMES * pattern.rate,
        azimuth=_span(azimuth),
        elevation=_span(elevation),
        elevation_gap=_span(np.diff(np.sort(lowest)) if fixed else lowest[:0]),
        pulse_gap=_span(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))),
        time=(float(first.time[0]), float(first.time[-1])),
        pause=float(np.diff(np.append(first.time, max(1.0 / pattern.rate, first.time[-1]))).max()),
        repeats=len(first) == len(second) and np.array_equal(first.directions, second.directions),
    )


def field_of_view(pulses: Pulses) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the lowest and the highest azimuth, and elevation, rad; nan if there are no pulses."""
    return _span(pulses.azimuth), _span(pulses.elevation)


def _span(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if values.size else (np.nan, np.nan)
