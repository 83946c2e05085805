"""Paths in the xy plane, straight or curved from point to point."""

from __future__ import annotations

import numpy as np

from lidarsim._base.validation import Floats

__all__ = ["Path", "path_of"]

PIECES = 256
"""Straight pieces between two points of a spline: a quarter of a circle turns by 0.35° from one to the next."""


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
