"""Outlines of instances on the ground over time, and whether they keep their distance at all times.

Time is divided into steps, the same for all instances. Within a step, an instance's origin moves straight and its
orientation turns at a constant rate about a fixed axis, as a linear `Trajectory` does. A corner at distance r from the
origin that turns by the angle 2a from start to end is at ``r exp(i s a)``, s from -1 to 1, in the plane of its circle,
and linear interpolation between both ends is at ``r (cos a + i s sin a)``. These differ by at most ``r (1 - cos a)``,
at s = 0. So in a step a corner stays within ``bulge = r (1 - cos a)`` of the segment between its two positions, and the
plan of the instance within the hull of the plans at both ends, widened by the bulge. Two instances keep a gap if in
each step a line separates their hulls by the gap and both bulges: this holds at every moment, not only at the ends of
steps.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats

__all__ = ["Obstacles", "Outline", "bulge_of", "steps", "turns_of"]


@dataclass(frozen=True)
class Outline:
    """Outline of an object in the xy plane in each step of a sequence, and its heights.

    All attributes may have a further axis in front, for an object at each of m places, and so have the results.

    Attributes
    ----------
    corners : ndarray of float64, shape (k, n, 2)
        Corners of its plan at both ends of each step, m, of which the first three span its sides; once (k = 1) for a
        static object.
    low, high : float or ndarray of float64
        Least and greatest height, m.
    bulge : float or ndarray of float64
        Greatest distance beyond the hull of the corners during a step, m.
    """

    corners: Floats
    low: float | Floats
    high: float | Floats
    bulge: float | Floats = 0.0

    @cached_property
    def box(self) -> Floats:
        """Least and greatest coordinates at any time, shape (2, 3)."""
        box = np.empty((*self.corners.shape[:-3], 2, 3))
        for axis in range(2):  # NumPy takes many times as long for both at once
            along = self.corners[..., axis]
            box[..., 0, axis] = along.min(axis=(-2, -1)) - self.bulge
            box[..., 1, axis] = along.max(axis=(-2, -1)) + self.bulge
        box[..., 0, 2], box[..., 1, 2] = self.low, self.high
        return box

    def at(self, places: int | npt.NDArray[np.intp]) -> Outline:
        """Return the outline at one or some of several places."""
        parts = (np.asarray(part)[places] for part in (self.corners, self.low, self.high, self.bulge))
        return Outline(*parts)

    def apart(self, other: Outline, gap: float) -> npt.NDArray[np.bool_] | np.bool_:
        """Return whether two outlines keep the gap at all times."""
        result: npt.NDArray[np.bool_] | np.bool_ = self.apart_each_step(other, gap).all(axis=-1)
        return result

    def apart_each_step(self, other: Outline, gap: float) -> npt.NDArray[np.bool_]:
        """Return whether a line separates two outlines by the gap, in each step: shape (…, k)."""
        shape = np.broadcast_shapes(self.corners.shape[:-2], other.corners.shape[:-2])
        whole = [np.broadcast_to(one.corners, (*shape, *one.corners.shape[-2:])) for one in (self, other)]
        # Corners and coordinates come first: NumPy takes twice as long if the innermost axis is short.
        both = [np.moveaxis(corners, (-2, -1), (0, 1)).copy() for corners in whole]
        axes = np.concatenate([corners[1:3] - corners[:2] for corners in both])
        # Far away, corners may coincide and give a zero axis; on overflow, no axis separates the outlines.
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.sqrt((axes * axes).sum(axis=1))
            x, y = np.moveaxis(axes / np.where(lengths > 0, lengths, 1.0)[:, None], 1, 0)
            mine, its = (x * corners[:, None, 0] + y * corners[:, None, 1] for corners in both)
            free = np.maximum(mine.min(axis=0) - its.max(axis=0), its.min(axis=0) - mine.max(axis=0))
        free = np.where(lengths > 0, free, -np.inf).max(axis=0)
        room = gap + np.asarray(self.bulge) + np.asarray(other.bulge)
        result: npt.NDArray[np.bool_] = free >= room[..., None]
        return result


def steps(corners: Floats) -> Floats:
    """Return the corners at both ends of each step, given those at each moment, in an array of shape (…, k, n, 2)."""
    if corners.shape[-3] == 1:
        return corners
    return np.concatenate([corners[..., :-1, :, :], corners[..., 1:, :, :]], axis=-2)


def bulge_of(radius: float | Floats, turns: Floats) -> Floats:
    """Return how far a point at `radius` from the origin is beyond the hull if the steps turn by `turns`, rad."""
    bulge: Floats = radius * (1.0 - np.cos(np.max(np.abs(turns), axis=-1, initial=0.0) / 2.0))
    return bulge


def turns_of(poses: Floats) -> Floats:
    """Return the angle from each pose to the next, rad: 2 asin(|R₁ - R₀| / √8) with Frobenius' norm."""
    change = np.linalg.norm(np.diff(poses[..., :3, :3], axis=-3), axis=(-2, -1)) / np.sqrt(8.0)
    turns: Floats = 2.0 * np.arcsin(np.minimum(change, 1.0))
    return turns


class Obstacles:
    """Named outlines from which objects keep their distance."""

    def __init__(self, named: Iterable[tuple[str, Outline]] = ()) -> None:
        pairs = list(named)
        self.names = [name for name, _ in pairs]
        self.outlines = [outline for _, outline in pairs]
        self.boxes = np.empty((len(pairs), 2, 3))
        alike: dict[tuple[int, ...], list[int]] = {}
        for index, outline in enumerate(self.outlines):
            alike.setdefault(outline.corners.shape, []).append(index)
        for places in alike.values():
            several = [self.outlines[place] for place in places]
            self.boxes[places] = Outline(
                *(np.array([getattr(one, part.name) for one in several]) for part in fields(Outline))
            ).box

    def add(self, name: str, outline: Outline) -> None:
        """Add an outline."""
        self.names.append(name)
        self.outlines.append(outline)
        self.boxes = np.concatenate([self.boxes, outline.box[None]])

    def near(self, outline: Outline, gap: float) -> npt.NDArray[np.bool_]:
        """Return whose boxes are nearer than the gap to that of an object at m places, shape (m, len(names))."""
        apart = np.zeros((len(outline.box), len(self.names)), bool)
        for axis, room in enumerate((gap, gap, 0.0)):
            (low, high), (its_low, its_high) = outline.box[..., axis].T[..., None], self.boxes[..., axis].T
            apart |= (its_low >= high + room) | (low >= its_high + room)
        return ~apart

    def first_refusal(self, outline: Outline, gap: float, asked: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
        """Return the first obstacle that an object at each of m places is too near to, shape (m,); -1 for none.

        Places that are not `asked`, shape (m,), have -1, too.
        """
        near = self.near(outline, gap) & asked[:, None]
        refusing = np.full(len(near), -1)
        for index in np.flatnonzero(near.any(axis=0)):
            places = np.flatnonzero(near[:, index] & (refusing < 0))
            if len(places):
                refusing[places[~self.outlines[index].apart(outline.at(places), gap)]] = index
        return refusing
