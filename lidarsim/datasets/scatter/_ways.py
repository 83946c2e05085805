"""Ways of instances: where an instance may start, the path that it follows, and how far it has come at each time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim.datasets.draws import Stream

if TYPE_CHECKING:
    from lidarsim.config.document import Place
    from lidarsim.datasets.scatter import Scatter

__all__ = ["Path", "Way", "path_of"]

STEP = 0.1
"""Time between the poses of moving objects, s."""

PIECES = 256
"""Straight pieces between two points of a spline: a quarter of a circle turns by 0.35° from one to the next."""


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


class Path:
    """A line of straight pieces.

    Attributes
    ----------
    length : float
        Length, m.
    tangents : ndarray of float64, shape (k - 1, 2)
        Direction of each piece, of unit length.
    """

    def __init__(self, points: Floats) -> None:
        self.points = points
        sides = np.diff(points, axis=0)
        self.lengths = np.linalg.norm(sides, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):  # a spline through points too near to each other
            self.tangents = sides / self.lengths[:, None]
        self.ends = np.concatenate([[0.0], np.cumsum(self.lengths)])
        self.length = float(self.lengths.sum())

    def at(self, way: Floats) -> tuple[Floats, Floats]:
        """Return positions and tangents, each of shape (k, 2), at distances from the start."""
        piece = np.minimum(np.maximum(np.searchsorted(self.ends, way, side="right") - 1, 0), len(self.lengths) - 1)
        tangent = self.tangents[piece]
        return self.points[piece] + (way - self.ends[piece])[:, None] * tangent, tangent

    def beside(self, offset: float) -> Path | None:
        """Return the path at a distance to its left, mitred at its corners; None if a bend is too tight for that."""
        if not offset:
            return self
        tangents = self.tangents
        before, after = np.concatenate([tangents[:1], tangents]), np.concatenate([tangents, tangents[-1:]])
        # The corner of two parallels at distance d, with the unit tangents t and u: d (t + u)⊥ / (1 + t·u).
        cosine = (before * after).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = (before + after) / (1.0 + cosine)[:, None]
            moved = self.points + offset * np.stack([-across[:, 1], across[:, 0]], axis=1)
            forward = (np.diff(moved, axis=0) * tangents).sum(axis=1)
        return Path(moved) if (forward > 0).all() else None


def path_of(points: Floats, interpolation: str) -> Path:
    """Return the path through points, of shape (k, 2), straight or curved between them.

    A spline is cubic with continuous curvature, over the distance from point to point (`scipy.interpolate.CubicSpline`
    with its default end conditions, or periodic if the last point is the first).
    """
    if interpolation == "linear" or len(points) == 2:
        return Path(points)
    from scipy.interpolate import CubicSpline

    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    closed = bool((points[0] == points[-1]).all())
    spline = CubicSpline(knots, points, bc_type="periodic" if closed and len(points) > 3 else "not-a-knot")
    share = np.arange(PIECES) / PIECES
    between = (knots[:-1, None] + np.diff(knots)[:, None] * share).reshape(-1)
    return Path(spline(np.append(between, knots[-1])))


class Way:
    """Possible starts of an object, and its motion from there.

    Attributes
    ----------
    moves : bool
        Whether it moves at all.
    times : ndarray of float64, shape (k,)
        Times of its poses since the start of the sequence, s; only 0 if it does not move.
    step : float
        Greatest time between them, s.
    speeds : ndarray of float64
        Its speeds, m/s, among which are the least and the greatest.
    """

    step = STEP

    def __init__(self, group: Scatter, stream: Stream, times: Floats, place: Place) -> None:
        self.group = group
        self.yaw = np.radians(group.draw("yaw_deg", stream, place))
        self.speed: Constant | Profile
        if isinstance(group.speed_m_per_s, list):
            self.speed = Profile(np.array(group.speed_m_per_s))
        else:
            self.speed = Constant(group.draw("speed_m_per_s", stream, place))
        self.speeds = self.speed.speeds
        self.moves = bool(self.speeds.any())
        self.back = bool(self.speeds[0] < 0)
        self.times = (times if self.moves else times[:1]) - times[0]
        self.way = self.speed.way(self.times)
        offset = group.draw("offset_m", stream, place)
        self.path: Path | None = None
        self.along = bool(group.paths)
        if self.along:
            number = stream.integer(0, len(group.paths) - 1) if len(group.paths) > 1 else 0
            path = group.paths[number]
            if path.length < self.way[-1]:
                raise (place / "along_m").error(
                    f"expected a path as long as the way in a sequence, {self.way[-1]:.4g} m, got {path.length:.4g} m"
                )
            self.path = path.beside(offset)
            self.room = -math.inf if self.path is None else self.path.length - float(self.way[-1])

    def ahead(self, times: Floats) -> Floats:
        """Return how far the object has come along its x axis at times since the start, m."""
        way = self.speed.way(times)
        return -way if self.back and not self.along else way

    def speed_ahead(self, times: Floats) -> Floats:
        """Return its speed along its x axis at times since the start, m/s."""
        speed = self.speed.at(times)
        return np.abs(speed) if self.along else speed

    def poses(self, stream: Stream) -> Floats | None:
        """Draw a start, and return the poses at all times, (k, 4, 4), at height 0; None if that has no room."""
        if not self.along:
            (x0, y0), (x1, y1) = np.asarray(self.group.area_m)
            start = np.array([stream.uniform(x0, x1), stream.uniform(y0, y1)])
            ahead = np.array([np.cos(self.yaw), np.sin(self.yaw)])
            way = -self.way if self.back else self.way
            return _upright(start + way[:, None] * ahead, np.full(len(way), self.yaw))
        if self.path is None or self.room < 0:
            return None
        at = stream.uniform(0.0, self.room) + self.way
        if self.back:
            at = self.path.length - at
        position, tangent = self.path.at(at)
        return _upright(position, np.arctan2(tangent[:, 1], tangent[:, 0]) + self.yaw + np.pi * self.back)


def _upright(position: Floats, yaw: Floats) -> Floats:
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :2, 3] = position
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(yaw)
    poses[:, 1, 0] = np.sin(yaw)
    poses[:, 0, 1] = -poses[:, 1, 0]
    return poses
