"""Parallel strips over an area, of which an airborne survey consists."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, angle, array, as_array, real
from lidarsim.errors import ArgumentValueError

MOST = 10_000
"""Most strips of a survey."""


def legs(
    area: npt.ArrayLike,
    *,
    height: float,
    speed: float,
    overlap: float,
    field_of_view: float,
    heading: float,
    turn: float,
    ground: float,
    margin: float,
) -> Iterator[tuple[Floats, Floats]]:
    """Yield the two times and the two poses of each strip; see `Trajectory.strips`."""
    corners = _corners(area)
    height, speed = real("height", height, above=0.0), real("speed", speed, above=0.0)
    ground, margin = real("ground", ground), real("margin", margin, at_least=0.0)
    overlap = real("overlap", overlap, at_least=0.0)
    if not overlap < 1.0:
        raise ArgumentValueError("overlap", "a share from 0 to less than 1", f"{overlap:g}", "20 % is 0.2")
    field_of_view = angle("field_of_view", field_of_view, above=0.0)
    heading = angle("heading", heading, at_least=-2.0 * math.pi, at_most=2.0 * math.pi)
    if not field_of_view < math.pi:
        raise ArgumentValueError("field_of_view", "an angle less than π", f"{field_of_view:g}", "degrees?")
    turn = real("turn", turn, at_least=0.0)

    ahead = np.array((math.cos(heading), math.sin(heading)))
    left = np.array((-ahead[1], ahead[0]))
    # The coordinates along and across the line of flight are relative to a corner, so that those of UTM lose no digits.
    along, across = (corners - corners[0]) @ ahead, (corners - corners[0]) @ left
    swath = 2.0 * height * math.tan(0.5 * field_of_view)
    spacing, width = swath * (1.0 - overlap), float(np.ptp(across))
    if not swath < math.inf:
        raise ArgumentValueError("height", "a height whose swath is within the range of float64", f"{height:g}")
    more = (width - swath) / spacing if spacing > 0.0 else math.inf
    if not more < MOST:
        raise ArgumentValueError("area", f"one that {MOST:,} strips cover", f"{more:.3g}", "degrees, or a low height?")
    # A rest below a millimetre takes no strip: by rounding, a swath of 90 degrees is just below twice the height.
    count = 1 + max(math.ceil(more - 1e-3 / spacing), 0)
    middle = 0.5 * (across.min() + across.max())
    start = 0.0
    for number in range(count):
        line = middle + (number - 0.5 * (count - 1)) * spacing
        begin, end = _reach(along, across, line - 0.5 * swath, line + 0.5 * swath)
        if not end > begin:
            raise ArgumentValueError("area", "a length above 0 along the line of flight", f"{end - begin:g} m")
        ends, sign = np.array((begin - margin, end + margin)), 1.0
        if number % 2:
            ends, sign = ends[::-1], -1.0
        poses = np.tile(np.eye(4), (2, 1, 1))
        poses[:, :2, 0], poses[:, :2, 1] = sign * ahead, sign * left
        poses[:, :2, 3] = corners[0] + ends[:, None] * ahead + line * left
        poses[:, 2, 3] = ground + height
        stop = start + (end - begin + 2.0 * margin) / speed
        if not start < stop < math.inf:
            expected = "strips whose times differ, and within the range of float64"
            raise ArgumentValueError("turn, speed", expected, f"one from {start:g} to {stop:g} s")
        yield np.array((start, stop)), poses
        start = stop + turn


def _corners(area: npt.ArrayLike) -> Floats:
    """Return the corners of an area, given as a rectangle or as a polygon, after checking them: shape (n, 2)."""
    if as_array("area", area, "x_min, y_min, x_max, y_max, or corners of shape (n, 2)").ndim == 1:
        x_min, y_min, x_max, y_max = array("area", area, (4,))
        if not (x_min < x_max and y_min < y_max):
            got = f"[{x_min:g}, {y_min:g}, {x_max:g}, {y_max:g}]"
            raise ArgumentValueError("area", "x_min < x_max and y_min < y_max", got)
        return np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    corners = array("area", area, ("n", 2))
    if len(corners) < 3:
        raise ArgumentValueError("area", "x_min, y_min, x_max, y_max, or at least 3 corners", f"{len(corners)} corners")
    return corners


def _reach(along: Floats, across: Floats, low: float, high: float) -> tuple[float, float]:
    """Return the least and the greatest coordinate along the flight of the part of a polygon from `low` to `high`."""
    inside = (across >= low) & (across <= high)
    found = [along[inside]]
    then_along, then_across = np.roll(along, -1), np.roll(across, -1)
    for border in (low, high):
        crossing = (across < border) != (then_across < border)
        share = (border - across[crossing]) / (then_across - across)[crossing]
        found.append(along[crossing] + share * (then_along - along)[crossing])
    reached = np.concatenate(found)
    return float(reached.min()), float(reached.max())
