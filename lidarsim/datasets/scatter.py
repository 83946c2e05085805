"""Objects at random places on the ground, clear of each other and of the sensor, some of them moving."""

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
"""Number of places tried for an object."""

FULL = 50
"""Number of consecutive objects without room after which the rest of their group is left out."""

STEP = 0.1
"""Time between overlap checks of moving objects, s."""

FAR = 1e9
"""Greatest coordinate, length, angle (degrees) and speed, so that sums and products stay in float64's range."""

MOST_OBJECTS = 10_000
"""Greatest number of objects in a group: each is compared with all others up to `TRIES` times."""

MOST_STEPS = 1_000_000
"""Greatest number of steps of a sequence in which anything moves."""

RANGES = {
    "count": (0.0, MOST_OBJECTS),
    "offset_m": (-FAR, FAR),
    "yaw_deg": (-FAR, FAR),
    "scale": (1 / FAR, FAR),
    "speed_m_per_s": (-FAR, FAR),
}
"""Least and greatest value of each drawable number."""

TOP = 1e5
"""Height above all ground, m, from which rays are cast down."""


Point = Annotated[list[Annotated[float, Field(ge=-FAR, le=FAR)]], Field(min_length=2, max_length=2)]


class Scatter(Model):
    """A group of objects; each is one of `objects`."""

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
        """Raise an error if keys contradict each other, or if an object cannot be built and placed."""
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
        """Return the value of a number, drawn if necessary, after checking its range."""
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
    """An object of a group, with its pose or trajectory."""

    group: str
    index: int
    scale: float
    motion: Floats | Trajectory


@dataclass(frozen=True)
class _Outline:
    """Outline of an object in the xy plane in each step of a sequence, and its heights.

    Attributes
    ----------
    corners : ndarray of float64, shape (k, 4 or 8, 2)
        Corners of its rectangle at both ends of each step, m; once (k = 1) for a static object.
    low, high : float
        Least and greatest height, m.
    bulge : float
        Greatest distance beyond the hull of the corners during a step, m.
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
        """Return whether two outlines keep the gap at all times: whether a line separates them in each step."""
        steps = max(len(self.corners), len(other.corners))
        both = [np.broadcast_to(corners, (steps, *corners.shape[1:])) for corners in (self.corners, other.corners)]
        axes = np.concatenate([np.diff(corners[:, :3], axis=1) for corners in both], axis=1)
        # Far away, corners may coincide and give a zero axis; on overflow, no axis separates the outlines.
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.linalg.norm(axes, axis=2, keepdims=True)
            axes = axes / np.where(lengths > 0, lengths, 1.0)
            mine, its = (np.einsum("kai,kci->kac", axes, corners) for corners in both)
            free = np.maximum(mine.min(2) - its.max(2), its.min(2) - mine.max(2))
        free = np.where(lengths[:, :, 0] > 0, free, -np.inf).max(1)
        return bool((free >= gap + self.bulge + other.bulge).all())


def _steps(corners: Floats) -> Floats:
    """Return the corners at both ends of each step, given those at each moment."""
    return corners if len(corners) == 1 else np.concatenate([corners[:-1], corners[1:]], axis=1)


class _Obstacles:
    """Outlines from which objects keep their distance."""

    def __init__(self, outlines: Sequence[_Outline]) -> None:
        self.outlines = list(outlines)
        self.boxes = np.array([outline.box for outline in outlines]).reshape(-1, 2, 3)

    def add(self, outline: _Outline) -> None:
        """Add an outline."""
        self.outlines.append(outline)
        self.boxes = np.concatenate([self.boxes, outline.box[None]])

    def apart(self, outline: _Outline, gap: float) -> bool:
        """Return whether an outline keeps the gap from all obstacles."""
        room = np.array([gap, gap, 0.0])
        free = (self.boxes[:, 0] >= outline.box[1] + room) | (outline.box[0] >= self.boxes[:, 1] + room)
        return all(self.outlines[index].apart(outline, gap) for index in np.flatnonzero(~free.any(axis=1)))


def scatter(groups: dict[str, Scatter], place: Place, run: Run, seed: int, sequence: int) -> list[Placed]:
    """Place the objects of all groups in a sequence, group by group.

    Parameters
    ----------
    groups : dict of str to Scatter
        The groups to place.
    place : Place
        Place of the groups in the recipe.
    run : Run
        The run of the sequence, whose scene has the ground and obstacles, and whose pose is kept clear.
    seed : int
        Seed of the data set.
    sequence : int
        Number of the sequence.

    Returns
    -------
    list of Placed
        The placed objects; those without room are left out.

    Raises
    ------
    ConfigError
        If an object to stand on does not exist, a path is too short for the speed, a drawn number is out of range, or a
        sequence is too long.
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
    """Return the times of the overlap checks; only the first and last if nothing moves."""
    moving = isinstance(run.pose, Trajectory) and any(group.clear_m for group in groups)
    if not moving and not any(group.speed_m_per_s != 0 for group in groups):
        return np.array([start, stop])
    if not (stop - start) / STEP <= MOST_STEPS:
        most = MOST_STEPS * STEP
        raise place.error(f"expected sequences of at most {most:,.0f} s if anything moves, got {stop - start:,.4g} s")
    return np.append(np.arange(start, stop, STEP), stop)


class _Way:
    """Possible starts of an object, and its motion from there."""

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
        """Draw a start, and return the poses at all times, (k, 4, 4), at height 0; k = 1 for a static object."""
        if self.group.along_m is None:
            (x0, y0), (x1, y1) = np.asarray(self.group.area_m)
            start = np.array([stream.uniform(x0, x1), stream.uniform(y0, y1)])
            ahead = np.array([np.cos(self.yaw), np.sin(self.yaw)])
            return _upright(start + self.speed * self.run[:, None] * ahead, np.full(len(self.run), self.yaw))
        at = stream.uniform(0.0, self.room) + abs(self.speed) * self.run
        if self.speed < 0:  # in reverse
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
    """Put poses on the ground, and return the outline of the object; None if part of it is off the ground.

    The object stands at the greatest height of the ground under its middle and corners.
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
    # A corner at distance r rotates about the origin, which moves straight; an arc of radius r over an angle deviates
    # from its chord by at most r (1 − cos(angle / 2)).
    turns = np.abs(np.diff(np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])))).max(initial=0.0)
    bulge = float(np.linalg.norm(corners, axis=1).max() * (1.0 - np.cos(turns / 2.0)))
    heights = float(poses[:, 2, 3].min()) + low, float(poses[:, 2, 3].max()) + high
    return _Outline(_steps(plan), *heights, bulge)


def _divided(scene: Scene, on: Sequence[str], place: Place) -> tuple[Scene, _Obstacles]:
    """Return the ground for objects as a scene, and the obstacles."""
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
    """Return a square around the sensor, or the body of the rig, at all times; empty if `clear` is 0."""
    if not clear:
        return _Obstacles([])
    if isinstance(run.pose, Trajectory):
        first, last = run.pose.span
        position = run.pose.at(np.clip(times, first, last)).translation[:, :2]
    else:
        position = np.asarray(run.pose)[None, :2, 3]
    square = clear * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _Obstacles([_Outline(_steps(position[:, None] + square), -np.inf, np.inf)])
