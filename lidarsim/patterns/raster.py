"""Rows and columns of the pulses of a pattern in an image."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, integer, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.patterns._parts import TURN
from lidarsim.patterns._pulses import Pulses

Indices = npt.NDArray[np.intp]

FIXED = 2.0**-22
"""Greatest variation of a ring's elevation by rounding, rad: between two directions in float32, each of which is off by
at most 2**-24 in each component and thus by less than 2**-23 in all."""


def rows_and_columns(frame: Pulses, pulses: Pulses) -> tuple[Indices, Indices, tuple[int, int]]:
    """Return the row and the column of each pulse in the image of its rings, and the image's shape.

    Parameters
    ----------
    frame : Pulses
        All pulses of the frame, which define the layout of the image.
    pulses : Pulses
        The pulses to locate: all or some of those of the frame.

    Raises
    ------
    ValueError
        If the rings do not keep to one elevation each, or to separate bands of elevation, or do not turn one way and
        at most once around.
    """
    if not len(frame):
        return pulses.ring.astype(np.intp), pulses.column.astype(np.intp), (0, 0)
    order = np.lexsort((frame.column, frame.ring))
    rings, starts = np.unique(frame.ring[order], return_index=True)
    column = frame.column[order].astype(np.int64)
    azimuth, elevation = _angles(frame.directions[order])
    within = np.diff(frame.ring[order]) == 0
    turns = np.where(within, _wrap(np.diff(azimuth)), 0.0)
    around = np.abs(np.add.reduceat(np.append(turns, 0.0), starts))
    rising = bool((turns[within] > 0.0).all())
    highest, lowest = np.maximum.reduceat(elevation, starts), np.minimum.reduceat(elevation, starts)
    downwards = np.argsort(-highest, kind="stable")
    level = (highest - lowest <= FIXED).all()
    banded = len(rings) > 1 and (lowest[downwards[:-1]] > highest[downwards[1:]]).all()
    if (
        not (level or banded)
        or not (rising or (turns[within] < 0.0).all())
        or (np.diff(column)[within] == 0).any()
        or (around >= TURN).any()
    ):
        raise ArgumentValueError("size", "(rows, columns) of the image, since the pattern has none of its own", "None")
    row_of = np.empty(len(rings), np.intp)
    row_of[downwards] = np.arange(len(rings))

    # Along a ring the azimuth falls by one step per column, from left to right. The step is the slope of a fitted line,
    # because columns may fire their channels at alternating times. Each ring is shifted by a whole number of columns
    # relative to the first, so no pixel is hit twice and none is skipped.
    first, last = column.min(), column.max()
    counts = np.diff(np.append(starts, len(column)))
    centered = column - np.repeat(np.add.reduceat(column, starts) / counts, counts)
    spread = np.add.reduceat(centered**2, starts)
    covered = np.add.reduceat(centered * np.cumsum(np.append(0.0, turns)), starts)
    several = spread > 0.0
    step = float(np.median(np.abs(covered[several] / spread[several]))) if several.any() else TURN
    place = last - column[starts] if rising else column[starts] - first
    aside = _wrap(azimuth[starts[0]] - azimuth[starts] - step * (place - place[0])) / step
    all_around = last - first + 2 > TURN / step
    if all_around:
        aside += (0.5 * TURN - azimuth[starts[0]]) / step - place[0]
    # Shifts of half a column are rounded the same way in all rings: angles in float32, off by up to 2**-23, change a
    # shift by less than a thousandth of a column where a turn has fewer than some 20,000 columns.
    shift = np.floor(np.round(aside, 3) + 0.5).astype(np.int64)
    # Times that alternate by d columns change the fitted number n of columns per turn by at most 3 d/n (the slope of
    # ±d/2 over n columns). For d = 1/2, rounding to 0.01 removes the change where n is 300 or more.
    columns = int(last - first + 1)
    width = max(columns, math.ceil(round(TURN / step, 2))) if all_around else columns + int(np.ptp(shift))

    ring = np.searchsorted(rings, pulses.ring)
    there = pulses.column.astype(np.int64)
    there = (last - there if rising else there - first) + shift[ring] - (0 if all_around else shift.min())
    return row_of[ring], (there % width).astype(np.intp), (len(rings), width)


def projection(frame: Pulses, pulses: Pulses, size: tuple[int, int]) -> tuple[Indices, Indices, tuple[int, int]]:
    """Return the row and the column of each pulse in equal steps of elevation and azimuth, and the image's shape.

    Parameters
    ----------
    frame : Pulses
        All pulses of the frame. Their outermost angles bound the image.
    pulses : Pulses
        The pulses to locate: all or some of those of the frame.
    size : tuple of int
        Rows and columns.

    Raises
    ------
    TypeError, ValueError
        If `size` is not two integers >= 1.
    """
    if not isinstance(size, tuple | list) or len(size) != 2:
        raise ArgumentTypeError("size", "(rows, columns)", short_repr(size))
    rows, columns = (integer("size", count, at_least=1) for count in size)
    azimuths, elevations = _angles(frame.directions)
    azimuth, elevation = _angles(pulses.directions)
    if len(frame) and np.ptp(azimuths) > math.pi > np.ptp(azimuths % TURN):  # a field of view across the seam at ±π
        azimuths, azimuth = azimuths % TURN, azimuth % TURN
    return _cell(elevation, elevations, rows), _cell(azimuth, azimuths, columns), (rows, columns)


def _cell(angle: Floats, angles: Floats, count: int) -> Indices:
    """Return the index of each `angle` among `count` equal steps from the greatest of `angles` down to the least."""
    high, low = angles.max(initial=-math.inf), angles.min(initial=math.inf)
    part = (high - angle) / (high - low) if high > low else np.zeros(len(angle))
    return np.minimum(part * count, count - 1).astype(np.intp)


def _angles(directions: Floats) -> tuple[Floats, Floats]:
    """Return azimuth and elevation of some directions, rad."""
    x, y, z = directions.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _wrap(angle: Floats) -> Floats:
    """Return angles between -pi and pi, whole turns taken off."""
    wrapped: Floats = (angle + 0.5 * TURN) % TURN - 0.5 * TURN
    return wrapped
