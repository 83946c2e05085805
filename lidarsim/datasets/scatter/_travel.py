"""How far an object has come, and how fast it is, at each time."""

from __future__ import annotations

import numpy as np

from lidarsim._base.validation import Floats

__all__ = ["STEP", "Constant", "Profile", "Travel"]

STEP = 0.1
"""Time between the poses of moving objects, s."""


class Constant:
    """The same speed at all times, m/s; negative to go back."""

    def __init__(self, value: float) -> None:
        self.speeds = np.array([value])

    def at(self, times: Floats) -> Floats:
        """Return the speed at times since the start."""
        return np.full(len(times), self.speeds[0])

    def way(self, times: Floats) -> Floats:
        """Return the distance travelled since the start."""
        return abs(float(self.speeds[0])) * times


class Profile:
    """Speed that changes linearly from one row to the next, and stays as it is before the first and after the last."""

    def __init__(self, rows: Floats) -> None:
        self.times, self.speeds = rows.T

    def at(self, times: Floats) -> Floats:
        """Return the speed at times since the start."""
        speeds: Floats = np.interp(times, self.times, self.speeds)
        return speeds

    def way(self, times: Floats) -> Floats:
        """Return the distance travelled since the start."""
        until = np.maximum(times, 0.0)
        moments = np.unique(np.concatenate([[0.0], until, self.times[self.times > 0]]))
        speeds = self.at(moments)
        parts = (speeds[:-1] + speeds[1:]) / 2 * np.diff(moments)  # exact where the speed is linear
        way: Floats = np.interp(until, moments, np.concatenate([[0.0], np.cumsum(parts)]))
        return way


class Travel:
    """The motion of an object from its start.

    Attributes
    ----------
    moves : bool
        Whether it moves at all.
    back : bool
        Whether it starts backwards.
    along : bool
        Whether it follows a path, and so heads where it goes even if it starts backwards.
    times : ndarray of float64, shape (k,)
        Times of its poses since the start of the sequence, s; only 0 if it does not move.
    step : float
        Greatest time between them, s.
    speeds : ndarray of float64
        Its speeds, m/s, among which are the least and the greatest.
    distance : ndarray of float64, shape (k,)
        Distance travelled at `times`, m.
    """

    step = STEP

    def __init__(self, speed: Constant | Profile, times: Floats, *, along: bool) -> None:
        self.speed = speed
        self.along = along
        self.speeds = speed.speeds
        self.moves = bool(self.speeds.any())
        self.back = bool(self.speeds[0] < 0)
        self.times = (times if self.moves else times[:1]) - times[0]
        self.distance = speed.way(self.times)

    def ahead(self, times: Floats) -> Floats:
        """Return how far the object has come along its x axis at times since the start, m."""
        distance = self.speed.way(times)
        return -distance if self.back and not self.along else distance

    def speed_ahead(self, times: Floats) -> Floats:
        """Return its speed along its x axis at times since the start, m/s."""
        speed = self.speed.at(times)
        return np.abs(speed) if self.along else speed
