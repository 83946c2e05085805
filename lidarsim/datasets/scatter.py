"""Objects at random places: standing on the ground, apart from all others and from the sensor, some moving."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from lidarsim._validation import Floats
from lidarsim.config.schema import AnyObject, Model, SceneFile
from lidarsim.datasets.draws import Draw, DrawOr, Stream, drawn
from lidarsim.rig import Rig
from lidarsim.scene import Scene, SceneObject
from lidarsim.trajectory import Trajectory

if TYPE_CHECKING:
    from lidarsim.config.document import Place
    from lidarsim.run import Run

__all__ = ["Placed", "Scatter", "scatter"]

TRIES = 200
"""How many places are tried for an object."""

FULL = 50
"""After how many objects in a row that find no room there is taken to be none for the rest of their group."""

STEP = 0.1
"""Time between the moments at which objects are checked for overlap, s."""

FAR = 1e9
"""Greatest coordinate, length, angle (degrees) and speed, so that no sum or product leaves float64's range."""

MOST_OBJECTS = 10_000
"""Most objects of a group: each is compared with all others, and `TRIES` times."""

MOST_STEPS = 1_000_000
"""Most moments of a sequence in which anything moves."""

RANGES = {
    "count": (0.0, MOST_OBJECTS),
    "offset_m": (-FAR, FAR),
    "yaw_deg": (-FAR, FAR),
    "scale": (1 / FAR, FAR),
    "speed_m_per_s": (-FAR, FAR),
}
"""Least and greatest value of each number that may be drawn."""

TOP = 1e5
"""A height above all ground, m, from which rays look for it."""


Point = Annotated[list[Annotated[float, Field(ge=-FAR, le=FAR)]], Field(min_length=2, max_length=2)]


class Scatter(Model):
    """A group of objects, of which each is one of `objects`."""

    objects: Annotated[list[AnyObject], Field(min_length=1)]
    on: Annotated[list[str], Field(min_length=1)]
    count: DrawOr
    area_m: Annotated[list[Point], Field(min_length=2, max_length=2)] | None = None
    along_m: Annotated[list[Point], Field(min_length=2)] | None = None
    offset_m: DrawOr = 0.0
    yaw_deg: DrawOr = 0.0
    scale: DrawOr = 1.0
    speed_m_per_s: DrawOr = 0.0
    gap_m: Annotated[float, Field(ge=0, le=FAR)] = 0.0
    clear_m: Annotated[float, Field(ge=0, le=FAR)] = 0.0

    def check(self, place: Place) -> None:
        """Raise an error if the keys do not fit together, or if an object cannot be built and placed."""
        if (self.area_m is None) == (self.along_m is None):
            raise place.error("expected one of area_m and along_m, got " + ("none" if self.area_m is None else "both"))
        for index, (point, after) in enumerate(pairwise(self.along_m or ())):
            if not math.dist(point, after) >= 1 / FAR:
                error = "expected points that differ from one to the next"
                raise (place / "along_m" / (index + 1)).error(f"{error}, by {1 / FAR:g} m at least")
        for key in RANGES:
            self._check_number(key, place / key)
        for index, item in enumerate(self.objects):
            self._check_object(item, place / "objects" / index)

    def _check_number(self, key: str, place: Place) -> None:
        value = getattr(self, key)
        if not isinstance(value, Draw):
            _expect(key, value, place)
            if key == "count" and value != int(value):
                raise place.error(f"expected an integer, got {value}")
            return
        value.check(place, numbers=True)
        for end in value.ends or (value.normal or ())[:1]:
            _expect(key, end, place)

    @staticmethod
    def _check_object(item: AnyObject, place: Place) -> None:
        given = item.model_fields_set & {"position_m", "rotation_deg", "matrix", "motion"}
        if given or isinstance(item, SceneFile):
            what = f"no {min(given)}, since the place is drawn" if given else "one object, got a scene_file"
            raise place.error(f"expected {what}")
        scene = Scene()
        item.add_at(np.eye(4), 1.0, scene, place)
        (built,) = scene.objects
        if not built.shape.bounded:
            raise place.error("expected a bounded object, got an unbounded one")
        size = np.abs(built.bounds).max()
        if not size <= FAR:
            raise place.error(f"expected an object within {FAR:g} m of its origin, got one of {size:g} m")

    def drawn(self, key: str, stream: Stream, place: Place) -> float:
        """Return a number that may be drawn, after checking that it is in its range."""
        value = drawn(getattr(self, key), stream)
        if key == "count":  # normal numbers may be negative
            value = max(value, 0.0)
        _expect(key, value, place / key)
        return value


def _expect(key: str, value: float, place: Place) -> None:
    least, greatest = RANGES[key]
    if not least <= value <= greatest:
        raise place.error(f"expected a number from {least:g} to {greatest:g}, got {value:g}")


@dataclass(frozen=True)
class Placed:
    """An object of a group, and where it stands or how it moves."""

    group: str
    index: int
    scale: float
    motion: Floats | Trajectory


@dataclass(frozen=True)
class _Outline:
    """Where an object is in the plan, step by step of a sequence, and between which heights.

    Attributes
    ----------
    corners : ndarray of float64, shape (k, 4 or 8, 2)
        Corners of its rectangle, m: at both ends of each step, or, if it stands still, once (k = 1).
    low, high : float
        Its heights, m.
    bulge : float
        How far it may reach beyond the hull of its corners between the ends of a step, m.
    """

    corners: Floats
    low: float
    high: float
    bulge: float = 0.0

    @cached_property
    def box(self) -> Floats:
        """Least and greatest coordinates at any time, shape (2, 3)."""
        low, high = self.corners.min(axis=(0, 1)) - self.bulge, self.corners.max(axis=(0, 1)) + self.bulge
        return np.array([[*low, self.low], [*high, self.high]])

    def apart(self, other: _Outline, gap: float) -> bool:
        """Return whether two outlines keep the gap at all times: in each step, whether some line separates them."""
        steps = max(len(self.corners), len(other.corners))
        both = [np.broadcast_to(corners, (steps, *corners.shape[1:])) for corners in (self.corners, other.corners)]
        axes = np.concatenate([np.diff(corners[:, :3], axis=1) for corners in both], axis=1)
        # Far off, corners may fall together, and leave an axis of no length; beyond float64, none separates anything.
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.linalg.norm(axes, axis=2, keepdims=True)
            axes = axes / np.where(lengths > 0, lengths, 1.0)
            mine, its = (np.einsum("kai,kci->kac", axes, corners) for corners in both)
            free = np.maximum(mine.min(2) - its.max(2), its.min(2) - mine.max(2))
        free = np.where(lengths[:, :, 0] > 0, free, -np.inf).max(1)
        return bool((free >= gap + self.bulge + other.bulge).all())


def _steps(corners: Floats) -> Floats:
    """Return corners at both ends of each step from those at each moment."""
    return corners if len(corners) == 1 else np.concatenate([corners[:-1], corners[1:]], axis=1)


class _Obstacles:
    """Outlines that others keep apart from."""

    def __init__(self, outlines: Sequence[_Outline]) -> None:
        self.outlines = list(outlines)
        self.boxes = np.array([outline.box for outline in outlines]).reshape(-1, 2, 3)

    def add(self, outline: _Outline) -> None:
        """Add an outline."""
        self.outlines.append(outline)
        self.boxes = np.concatenate([self.boxes, outline.box[None]])

    def apart(self, outline: _Outline, gap: float) -> bool:
        """Return whether an outline is apart from all of these."""
        room = np.array([gap, gap, 0.0])
        free = (self.boxes[:, 0] >= outline.box[1] + room) | (outline.box[0] >= self.boxes[:, 1] + room)
        return all(self.outlines[index].apart(outline, gap) for index in np.flatnonzero(~free.any(axis=1)))


def scatter(groups: dict[str, Scatter], place: Place, run: Run, seed: int, sequence: int) -> list[Placed]:
    """Return places for the objects of all groups in a sequence, group by group.

    Parameters
    ----------
    groups : dict of str to Scatter
        The groups to place.
    place : Place
        Where the groups stand in the recipe.
    run : Run
        The run of the sequence: its scene has the ground and the obstacles, its pose is kept clear.
    seed : int
        Seed of the data set.
    sequence : int
        Number of the sequence.

    Returns
    -------
    list of Placed
        Without the objects that found no room.

    Raises
    ------
    ConfigError
        If an object to stand on does not exist, a path is too short for the speed, a drawn number is out of its range,
        or a sequence is too long.
    """
    start, stop = run.time(run.frames.start), run.time(run.frames.stop + 1)
    stop += max((part.offset for part in run.sensor.values()), default=0.0) if isinstance(run.sensor, Rig) else 0.0
    times = _moments(start, stop, run, groups.values(), place)
    placed: list[Placed] = []
    others = _Obstacles([])
    for name, group in groups.items():
        there = place / name
        ground, obstacles = _divided(run.scene, group.on, there)
        sensor = _sensor(run, times, group.clear_m)
        missed = 0
        for number in range(int(group.drawn("count", Stream(seed, f"scatter.{name}", sequence), there))):
            stream = Stream(seed, f"scatter.{name}.{number}", sequence)
            index = stream.integer(0, len(group.objects) - 1)
            item = group.objects[index]
            shape = item.build(there / "objects" / index)
            scale = group.drawn("scale", stream, there)
            size = np.diag([*np.ones(3) * scale * np.asarray(item.scale), 1.0])
            bounds = shape._image(size).bounds()
            way = _Way(group, stream, times, there)
            for _ in range(TRIES):
                poses = way.poses(stream)
                outline = _stand(poses, bounds, ground)
                if outline is None:
                    continue
                if sensor.apart(outline, 0) and obstacles.apart(outline, 0) and others.apart(outline, group.gap_m):
                    placed.append(Placed(name, index, scale, Trajectory(times, poses) if way.speed else poses[0]))
                    others.add(outline)
                    missed = 0
                    break
            else:
                missed += 1
                if missed == FULL:
                    break
    return placed


def _moments(start: float, stop: float, run: Run, groups: Iterable[Scatter], place: Place) -> Floats:
    """Return the moments at which objects are checked for overlap; the first and last alone if nothing moves."""
    moving = isinstance(run.pose, Trajectory) and any(group.clear_m for group in groups)
    if not moving and not any(group.speed_m_per_s != 0 for group in groups):
        return np.array([start, stop])
    if not (stop - start) / STEP <= MOST_STEPS:
        most = MOST_STEPS * STEP
        raise place.error(f"expected sequences of at most {most:,.0f} s if anything moves, got {stop - start:,.4g} s")
    return np.append(np.arange(start, stop, STEP), stop)


class _Way:
    """Where an object may start, and how it moves on from there."""

    def __init__(self, group: Scatter, stream: Stream, times: Floats, place: Place) -> None:
        self.group = group
        self.yaw = np.radians(group.drawn("yaw_deg", stream, place))
        self.speed = group.drawn("speed_m_per_s", stream, place)
        self.offset = group.drawn("offset_m", stream, place)
        self.run = (times if self.speed else times[:1]) - times[0]
        if group.along_m is not None:
            self.path = np.asarray(group.along_m)
            self.lengths = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
            self.room = float(self.lengths.sum() - abs(self.speed) * self.run[-1])
            if self.room < 0:
                raise (place / "along_m").error(
                    f"expected a path as long as the way in a sequence, {abs(self.speed) * self.run[-1]:.4g} m,"
                    f" got {self.lengths.sum():.4g} m"
                )

    def poses(self, stream: Stream) -> Floats:
        """Return poses at the moments, (k, 4, 4), at height 0; for an object that stands still, one."""
        if self.group.along_m is None:
            (x0, y0), (x1, y1) = np.asarray(self.group.area_m)
            start = np.array([stream.uniform(x0, x1), stream.uniform(y0, y1)])
            ahead = np.array([np.cos(self.yaw), np.sin(self.yaw)])
            return _upright(start + self.speed * self.run[:, None] * ahead, np.full(len(self.run), self.yaw))
        at = stream.uniform(0.0, self.room) + abs(self.speed) * self.run
        if self.speed < 0:  # the other way
            at = self.lengths.sum() - at
        ends = np.concatenate([[0.0], np.cumsum(self.lengths)])
        piece = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(self.lengths) - 1)
        tangent = (np.diff(self.path, axis=0) / self.lengths[:, None])[piece]
        position = self.path[piece] + (at - ends[piece])[:, None] * tangent
        position += self.offset * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        yaw = np.arctan2(tangent[:, 1], tangent[:, 0]) + self.yaw + np.pi * (self.speed < 0)
        return _upright(position, yaw)


def _upright(position: Floats, yaw: Floats) -> Floats:
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :2, 3] = position
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(yaw)
    poses[:, 1, 0] = np.sin(yaw)
    poses[:, 0, 1] = -poses[:, 1, 0]
    return poses


def _stand(poses: Floats, bounds: Floats, ground: Scene) -> _Outline | None:
    """Put poses on the ground, and return the outline of an object there; None if part of it is off the ground.

    An object stands at the greatest height of the ground under its middle and its corners.
    """
    (x0, y0, low), (x1, y1, high) = bounds
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    plan = np.einsum("kij,cj->kci", poses[:, :2, :2], corners) + poses[:, None, :2, 3]
    under = np.concatenate([plan, plan.mean(axis=1, keepdims=True)], axis=1)
    origins = np.concatenate([under, np.full((*under.shape[:2], 1), TOP)], axis=2).reshape(-1, 3)
    height = TOP - ground.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)).t.reshape(under.shape[:2])
    if not np.isfinite(height).all():
        return None
    poses[:, 2, 3] = height.max(axis=1) - low
    # A corner moves by its distance r from the origin, which goes straight, times a turn, whose arc over an angle is
    # r (1 − cos(angle / 2)) away from its chord at most.
    turns = np.abs(np.diff(np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])))).max(initial=0.0)
    bulge = float(np.linalg.norm(corners, axis=1).max() * (1.0 - np.cos(turns / 2.0)))
    heights = float(poses[:, 2, 3].min()) + low, float(poses[:, 2, 3].max()) + high
    return _Outline(_steps(plan), *heights, bulge)


def _divided(scene: Scene, on: Sequence[str], place: Place) -> tuple[Scene, _Obstacles]:
    """Return what objects may stand on, as a scene, and what they must not overlap."""
    missing = set(on) - {item.name for item in scene.objects}
    if missing:
        raise (place / "on").error(f"expected names of objects in the scene, got {min(missing)!r}")
    ground = Scene()
    for item in scene.objects:
        if item.name in on:
            ground.add(item.shape, transform=item.transform)
    others = [item for item in scene.objects if item.name not in on and item.shape.bounded]
    return ground, _Obstacles([_still(item) for item in others])


def _still(item: SceneObject) -> _Outline:
    """Return the outline of an object in the scene."""
    (x0, y0, low), (x1, y1, high) = item.bounds
    return _Outline(np.array([[[x0, y0], [x1, y0], [x1, y1], [x0, y1]]]), low, high)


def _sensor(run: Run, times: Floats, clear: float) -> _Obstacles:
    """Return a square around the sensor, or the body of the rig, at all moments; nothing if none is kept clear."""
    if not clear:
        return _Obstacles([])
    if isinstance(run.pose, Trajectory):
        first, last = run.pose.span
        position = run.pose.at(np.clip(times, first, last)).translation[:, :2]
    else:
        position = np.asarray(run.pose)[None, :2, 3]
    square = clear * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _Obstacles([_Outline(_steps(position[:, None] + square), -np.inf, np.inf)])
