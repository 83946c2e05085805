"""Rings and columns of points that have none: where the beams of a sensor say that they come from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats
from lidarsim.comparison._statistics import Indices
from lidarsim.patterns._pulses import pulses_of
from lidarsim.sensor.sensor import Sensor

TURN = 2.0 * math.pi
ORDER, ELEVATIONS = "the order of the points", "the elevations of the points"
"""What rings are inferred from."""
RIGHT = 0.995
"""Share of the points whose rings are right, at least."""
BETWEEN = 0.4
"""Distance of a point from its beam, in units of the gap between the nearest two, from which it is between them."""
MOST_BETWEEN = 2.0 * (0.5 + 0.5 * RIGHT - NormalDist().cdf(2.0 * BETWEEN * NormalDist().inv_cdf(0.5 + 0.5 * RIGHT)))
"""Greatest share of points between beams, 2 %: of normal deviations a share `RIGHT` is then below half a gap."""
BACKWARDS = 0.05
"""Most steps of azimuth against the sense of rotation in a cloud whose rings follow one another: KITTI's have 0.004,
points in the order of firing about a half, or none if all lasers fire in one direction."""
SAME = 0.25
"""Columns up to which points are returns of one pulse."""
PROBED = 100
"""Points of a turn, about, that tell its ring."""


class NoRingsError(Exception):
    """Points tell no rings; the message says what the clouds have instead."""


def rings_of(sensor: Sensor | None, xyz: Floats) -> tuple[Indices, str]:
    """Return the rings of points that have none.

    Points in the order of KITTI, ring by ring, are in the ring of their turn; its place among the rings of the sensor
    follows from its elevation. So neither another calibration nor the sensor's own motion puts a point into another
    ring. All other points are in the ring whose beam passes nearest.

    Parameters
    ----------
    sensor : Lidar or None
        The sensor, if it is known.
    xyz : ndarray of float64, shape (n, 3)
        Points in the sensor frame, m.

    Returns
    -------
    ring : ndarray of int, shape (n,)
        Ring of each point.
    source : str
        What it is inferred from: `ORDER` or `ELEVATIONS`.

    Raises
    ------
    NoRingsError
        If there is no sensor, or the points have no such order and lie between its beams.
    """
    if sensor is None:
        raise NoRingsError("have no rings; the argument sensor tells them")
    beams = Beams.of(sensor)
    turn = _turns(xyz, len(beams.ring))
    if turn is not None:
        return beams.ring[beams.of_turns(xyz, turn)][turn], ORDER
    place, gaps = beams.nearest(xyz)
    if len(xyz) and not np.mean(~(gaps <= BETWEEN)) <= MOST_BETWEEN:
        raise NoRingsError("have no rings that follow from their elevations, or their order, and the sensor")
    return beams.ring[place], ELEVATIONS


@dataclass(frozen=True)
class Beams:
    """The beams of a sensor that turns about z: a line for each ring, which turns with the head.

    Attributes
    ----------
    ring : ndarray of int, shape (R,)
        Rings.
    elevation : ndarray of float64, shape (R,)
        Elevation of each beam, rad.
    ahead, aside, height : ndarray of float64, shape (R,)
        Where it starts: along its horizontal direction, across it, and along z, m.
    """

    ring: Indices
    elevation: Floats
    ahead: Floats
    aside: Floats
    height: Floats

    @classmethod
    def of(cls, sensor: Sensor) -> Beams:
        pulses = pulses_of(sensor.pattern, 0)
        x, y, z = pulses.directions.T
        level = np.hypot(x, y)
        azimuth = np.arctan2(y, x)
        cos, sin = np.cos(azimuth), np.sin(azimuth)
        ahead = pulses.origins[:, 0] * cos + pulses.origins[:, 1] * sin
        aside = pulses.origins[:, 0] * sin - pulses.origins[:, 1] * cos
        ring, place = np.unique(pulses.ring, return_inverse=True)
        columns = np.arctan2(z, level), ahead, aside, pulses.origins[:, 2]
        each = np.array([[np.median(values[place == i]) for i in range(len(ring))] for values in columns])
        return cls(ring.astype(np.intp), *each)

    def away(self, beam: int, xyz: Floats) -> Floats:
        """Return the distance of each point above a beam, m, negative below; inf behind it."""
        cos, sin = math.cos(self.elevation[beam]), math.sin(self.elevation[beam])
        x, y, z = xyz.T
        along = np.sqrt(np.maximum(x * x + y * y - self.aside[beam] ** 2, 0.0)) - self.ahead[beam]
        up = z - self.height[beam]
        return np.where(along * cos + up * sin > 0.0, up * cos - along * sin, np.inf)

    def range(self, beam: int, xyz: Floats) -> Floats:
        """Return the distance of each point from the origin of a beam, m."""
        x, y, z = xyz.T
        along = np.sqrt(np.maximum(x * x + y * y - self.aside[beam] ** 2, 0.0)) - self.ahead[beam]
        reach: Floats = np.hypot(along, z - self.height[beam])
        return reach

    def nearest(self, xyz: Floats) -> tuple[Indices, Floats]:
        """Return the nearest beam of each point, and its distance in units of that between the nearest two."""
        place = np.zeros(len(xyz), np.intp)
        first, second = np.full(len(xyz), np.inf), np.full(len(xyz), np.inf)
        for beam in range(len(self.ring)):
            away = np.abs(self.away(beam, xyz))
            nearer = away < first
            second = np.where(nearer, first, np.minimum(second, away))
            place[nearer], first[nearer] = beam, away[nearer]
        with np.errstate(invalid="ignore"):
            return place, first / (first + second)

    def of_turns(self, xyz: Floats, turn: Indices) -> Indices:
        """Return the beam of each turn, one for each, in the order of the rings or of their elevations.

        Of the assignments in such an order it has the least sum of squared angles between beams and points.
        """
        count = int(turn[-1]) + 1
        probes = [mine[:: max(len(mine) // PROBED, 1)] for mine in (np.flatnonzero(turn == k) for k in range(count))]
        owner, points = np.repeat(np.arange(count), [len(probe) for probe in probes]), xyz[np.concatenate(probes)]
        reach = np.sqrt((points * points).sum(axis=1))
        cost = np.empty((count, len(self.ring)))
        for beam in range(len(self.ring)):
            angle = np.clip(self.away(beam, points) / reach, -1.0, 1.0)
            cost[:, beam] = [np.median(angle[owner == k]) ** 2 for k in range(count)]
        upwards = np.arange(len(self.ring)), np.argsort(self.elevation, kind="stable")
        orders = [order[::sense] for order in upwards for sense in (1, -1)]
        found = [order[_rising(cost[:, order])] for order in orders]
        return min(found, key=lambda beams: float(cost[np.arange(count), beams].sum()))


def _rising(cost: Floats) -> Indices:
    """Return a column for each row, each behind the one before, with the least sum of costs."""
    total = [cost[0]]
    for row in cost[1:]:
        before = np.minimum.accumulate(total[-1])
        total.append(row + np.concatenate([[np.inf], before[:-1]]))
    column = np.zeros(len(cost), np.intp)
    end = cost.shape[1]
    for k in range(len(cost) - 1, -1, -1):
        column[k] = end = int(np.argmin(total[k][:end]))
    return column


def _turns(xyz: Floats, most: int) -> Indices | None:
    """Return the number of the turn of each point in a cloud whose rings follow one another; None of any other.

    In such a cloud the azimuth rises, or falls, from one end to the other again and again. The ends are at azimuth 0,
    as KITTI's are, or at π, where the values of the arc tangent end.
    """
    if len(xyz) < 2:
        return None
    azimuth, rise = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))
    found: list[tuple[float, Indices]] = []
    for sense, end in ((1.0, 0.0), (1.0, math.pi), (-1.0, 0.0), (-1.0, math.pi)):
        step = np.diff(np.mod(sense * azimuth - end, TURN))
        if ((step < 0.0) & (step >= -math.pi)).mean() > BACKWARDS:
            continue
        turn = np.concatenate([[0], np.cumsum(step < -math.pi)])
        count = int(turn[-1]) + 1
        if not 0.5 * most < count <= most or count < 2:
            continue
        starts = np.searchsorted(turn, np.arange(count + 1))
        level = np.array([np.median(rise[a:b]) for a, b in pairwise(starts)])
        onwards = np.mean(np.diff(level) > 0.0)
        if max(onwards, 1.0 - onwards) > 0.9:  # from ring to ring the elevation goes one way
            found.append((float(((rise - level[turn]) ** 2).sum()), turn))
    return min(found, key=lambda pair: pair[0])[1] if found else None


def columns_of(sensor: Sensor, ring: npt.NDArray[np.integer], xyz: Floats) -> Indices | None:
    """Return the column of each point, of known ring, by its azimuth; None if the rings do not turn one way.

    The head may turn at another rate than that of the sensor. Points are in the sensor frame, m.
    """
    pulses = pulses_of(sensor.pattern, 0)
    column = np.zeros(len(ring), np.intp)
    if len(ring) and ring.max() > pulses.ring.max():
        return None
    places = np.zeros(len(ring))
    for name in np.unique(ring):
        own, mine = np.flatnonzero(pulses.ring == name), np.flatnonzero(ring == name)
        if len(own) < 2:
            return None
        own = own[np.argsort(pulses.column[own], kind="stable")]
        x, y = pulses.directions[own, :2].T
        turn = np.unwrap(np.arctan2(y, x))
        number = pulses.column[own].astype(np.float64)
        if turn[-1] < turn[0]:
            turn, number, own = turn[::-1], number[::-1], own[::-1]
        if (np.diff(turn) <= 0.0).any():
            return None
        origin = np.zeros((len(mine), 3))
        for _ in range(2):  # the beam's origin shifts what is near; that of the column found first is near enough
            p = xyz[mine] - origin
            azimuth = np.arctan2(p[:, 1], p[:, 0])
            lowest = 0.5 * (turn[0] + turn[-1] - TURN)  # the middle of what lies between the last and the first
            azimuth += TURN * np.ceil((lowest - azimuth) / TURN)
            place = np.interp(azimuth, turn, number)
            nearest = np.clip(np.searchsorted(turn, azimuth), 0, len(own) - 1)
            origin = pulses.origins[own[nearest]]
        places[mine] = place
    groups = [np.flatnonzero(ring == name) for name in np.unique(ring)]
    places /= _step([places[mine] for mine in groups])
    for mine in groups:
        along = mine[np.argsort(places[mine], kind="stable")]
        column[along] = _assign_columns(places[along])
    return column


def _assign_columns(places: Floats) -> Indices:
    """Assign a column to each pulse of a ring, sorted by azimuth.

    Real heads turn unevenly, and clouds may be corrected for the motion of the sensor. So neighbours are in columns one
    after another, however far apart they are, and only gaps of two pulses or more are filled as the places say.
    """
    # The head of a real sensor, and that of each frame if a turn is no whole number of columns, starts anywhere.
    nominal = np.rint(places - circular_mean(TURN * places) / TURN).astype(np.intp)
    ahead = np.diff(places)
    count = np.where(ahead > SAME, np.maximum(np.rint(ahead), 1.0), 0.0).astype(np.intp)
    starts = np.concatenate([[0], np.flatnonzero(count > 2) + 1, [len(places)]])
    column = np.concatenate([[0], np.cumsum(count)])
    last = -1
    for start, end in pairwise(starts):
        column[start:end] += max(nominal[start], last + 1) - column[start]
        last = column[end - 1]
    return column


def _step(rings: list[Floats]) -> float:
    """Return the distance of neighbours in columns of the sensor: not 1 if its head turns at another rate.

    The mean is that of steps near the median, without those over pulses that did not return.
    """
    steps = np.concatenate([np.zeros(0), *(np.diff(np.sort(places)) for places in rings)])
    steps = steps[steps > SAME]
    if not len(steps):
        return 1.0
    near = np.abs(steps / np.median(steps) - 1.0) < 0.5
    return float(steps[near].mean())


def circular_mean(angle: Floats) -> float:
    """Return the mean direction of angles, rad; nan if there are none."""
    return math.atan2(float(np.sin(angle).mean()), float(np.cos(angle).mean())) if angle.size else math.nan
