"""Oriented boxes around the things that a scan shows: their annotation, as a detector is trained with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._pickling import Pickled
from lidarsim._validation import Floats, array
from lidarsim.scene import SceneObject, Snapshot

if TYPE_CHECKING:
    from lidarsim.patterns import Pulses

__all__ = ["Boxes", "boxes_of"]

UNIT = 2.0**-53
"""Unit roundoff of float64."""

ROUNDINGS = 64
"""More than the roundings on the way of a coordinate from a hit to a point, and from a shape to its box: a few rigid
transforms of some ten roundings each."""


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(Pickled):
    """Oriented boxes of things, one entry per thing.

    A thing is an instance: all objects of the scene with one `instance` number. ``boxes[mask]`` selects some.

    Attributes
    ----------
    center : ndarray of float64, shape (m, 3)
        Centre of the box, m.
    size : ndarray of float64, shape (m, 3)
        Length, width and height along its axes x, y and z, m. It is that of the shapes, not of the points, and larger
        by the rounding errors of points alone.
    rotation : ndarray of float64, shape (m, 3, 3)
        Axes of the box, in columns. They are those of the first object of the thing, turned in right angles so that z
        points up when the thing is at its reference pose: a vehicle modelled along x heads along x.
    velocity : ndarray of float64, shape (m, 3)
        Velocity of the centre relative to the world, in the axes of the frame, m/s.
    label : ndarray of uint32, shape (m,)
        Label of the first object, or of most of its faces.
    instance : ndarray of uint32, shape (m,)
        Instance number.
    points : ndarray of int64, shape (m,)
        Number of points on the thing.
    visibility : ndarray of float64, shape (m,)
        Share, 0 to 1, of the pulses that would hit the thing if it stood alone, within the maximum range, that reach
        it in the scene.
    time : ndarray of float64, shape (m,)
        Moment of the box, s.
    class_names : mapping of int to str
        Names of labels, from the scene.
    """

    center: Floats
    size: Floats
    rotation: Floats
    velocity: Floats
    label: npt.NDArray[np.uint32]
    instance: npt.NDArray[np.uint32]
    points: npt.NDArray[np.int64]
    visibility: Floats
    time: Floats
    class_names: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of boxes."""
        return len(self.center)

    def __repr__(self) -> str:
        """Return the number of boxes and of points on them."""
        return f"Boxes({len(self)} boxes, {int(self.points.sum()):,} points)"

    def __getitem__(self, index: slice | npt.ArrayLike) -> Self:
        """Return the boxes that a slice, a mask or an array of indices selects."""
        which = index if isinstance(index, slice) else np.atleast_1d(np.asarray(index))
        own = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return type(self)(**{name: value if name == "class_names" else value[which] for name, value in own.items()})

    @property
    def yaw(self) -> Floats:
        """Heading of the boxes' x axes about z, -π to π rad: ndarray of float64, shape (m,)."""
        yaw: Floats = np.arctan2(self.rotation[:, 1, 0], self.rotation[:, 0, 0])
        return yaw

    @property
    def corners(self) -> Floats:
        """Corners, m: ndarray of float64, shape (m, 8, 3), in the order of ``numpy.ndindex(2, 2, 2)``."""
        unit = np.array(list(np.ndindex(2, 2, 2))) - 0.5
        local = unit[None] * self.size[:, None]
        corners: Floats = self.center[:, None] + np.einsum("mij,mcj->mci", self.rotation, local)
        return corners

    def contain(self, xyz: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which points lie in which boxes.

        Parameters
        ----------
        xyz : array_like, shape (n, 3)
            Points in the frame of the boxes, m.

        Returns
        -------
        ndarray of bool, shape (m, n)
            Whether each box, with its surface, holds each point.

        Raises
        ------
        ValueError
            If the shape is wrong.
        """
        points = array("xyz", xyz, ("n", 3))
        found = np.empty((len(self), len(points)), bool)
        for row, center, size, rotation in zip(found, self.center, self.size, self.rotation, strict=True):
            row[:] = (np.abs((points - center) @ rotation) <= size / 2).all(axis=1)
        return found


class Gate(Protocol):
    """The attribute of a sensor that decides what it could see."""

    @property
    def max_range(self) -> float: ...


class Annotated(Protocol):
    """The attributes of `lidarsim.Scan`, which is in a higher layer, that boxes are made from."""

    @property
    def range(self) -> Floats: ...
    @property
    def object_id(self) -> npt.NDArray[np.int32]: ...
    @property
    def instance(self) -> npt.NDArray[np.uint32]: ...
    @property
    def return_count(self) -> npt.NDArray[np.uint8]: ...
    @property
    def mirrored_point(self) -> Floats | None: ...
    @property
    def pulses(self) -> Pulses: ...
    @property
    def lidar(self) -> Gate: ...
    @property
    def time(self) -> float: ...
    @property
    def class_names(self) -> Mapping[int, str]: ...


@dataclass(frozen=True)
class _Thing:
    """All objects of an instance, which are bounded.

    Attributes
    ----------
    objects : sequence of SceneObject
        The objects, in ascending order of their ids.
    axes : ndarray of float64, shape (3, 3)
        Axes of the box before any motion, in columns.
    """

    objects: Sequence[SceneObject]
    axes: Floats

    @property
    def instance(self) -> int:
        """The instance number."""
        return self.objects[0].instance

    @property
    def label(self) -> int:
        """Label of the first object, or of most of its faces."""
        label = self.objects[0].label
        return label if isinstance(label, int) else int(np.bincount(label).argmax())

    def box(self, moment: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return centre, size, rotation and velocity of the box in the world at a moment, s."""
        first = self.objects[0].motion
        body = np.eye(4) if first is None else first._native.at(np.array([moment]))[0]
        rotation: Floats = body[:3, :3] @ self.axes
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for item in self.objects:
            place = np.eye(4) if item.transform is None else item.transform
            if item.motion is not None:
                then = body if item.motion is first else item.motion._native.at(np.array([moment]))[0]
                place = then @ place
            extent = item.shape._extent(rotation.T @ place[:3])
            low, high = np.minimum(low, extent[0]), np.maximum(high, extent[1])
        center: Floats = rotation @ ((low + high) / 2)
        velocity = np.zeros(3)
        if first is not None:
            linear, angular = first._native.velocity(np.array([moment]))[0]
            velocity = linear + body[:3, :3] @ np.cross(angular, body[:3, :3].T @ (center - body[:3, 3]))
        return center, high - low, rotation, velocity


def _things(objects: Iterator[SceneObject] | Sequence[SceneObject]) -> list[_Thing]:
    """Return the things that can have a box, in ascending order of instance: those without unbounded or empty parts."""
    groups: dict[int, list[SceneObject]] = {}
    for item in objects:
        groups.setdefault(item.instance, []).append(item)
    return [
        _Thing(parts, _axes(parts[0]))
        for _, parts in sorted(groups.items())
        if all(np.isfinite(part.shape.bounds).all() for part in parts)
    ]


def _axes(item: SceneObject) -> Floats:
    """Return the axes of an object as placed, turned in right angles so that z points up, as a rotation.

    x stays the object's x unless this points up or down; then it is its y.
    """
    if item.transform is None:
        return np.eye(3)
    u, _, vh = np.linalg.svd(item.transform[:3, :3])  # of the polar decomposition, the nearest orthogonal matrix is U·V
    nearest: Floats = u @ vh
    up = int(np.abs(nearest[2]).argmax())
    z = nearest[:, up] * np.copysign(1.0, nearest[2, up])
    x = nearest[:, 1 if up == 0 else 0]
    return np.stack([x, np.cross(z, x), z], axis=1)


def _rounded_up(size: Floats, center: Floats, farthest: float) -> Floats:
    """Return sizes that hold all points on the shapes, whose coordinates were rounded on their way.

    Every number on the way is at most the sum of the farthest coordinate and the distance of the box, and each of at
    most `ROUNDINGS` roundings moves a face or a point by at most `UNIT` of that.
    """
    reach = np.linalg.norm(center, axis=1) + np.linalg.norm(size, axis=1) + farthest
    rounded: Floats = size + 2.0 * ROUNDINGS * UNIT * reach[:, None]
    return rounded


def boxes_of(
    scan: Annotated, world: Snapshot, path: _native.Path, moment: float | None, *, in_world: bool, min_points: int
) -> Boxes:
    """Return the boxes of the things in a scan; see `lidarsim.Scan.boxes`.

    Parameters
    ----------
    scan : Scan
        The scan.
    world : Snapshot
        The scene that was scanned.
    path : lidarsim._native.Path
        Path of the sensor, sensor to world.
    moment : float or None
        Moment of all boxes, s; None: that of each thing's own points.
    in_world : bool
        Whether the boxes are in world coordinates, or in the sensor frame at their moment.
    min_points : int
        Least number of points on a thing.
    """
    is_point = (scan.object_id >= 0) & (np.arange(scan.range.shape[1]) < scan.return_count[:, None])
    if scan.mirrored_point is not None:  # ghosts are elsewhere
        is_point &= np.isnan(scan.mirrored_point[..., 0])
    instances = scan.instance[is_point]
    times = np.broadcast_to(scan.time + scan.pulses.time[:, None], is_point.shape)[is_point]
    things = _things(world.items)
    numbers = np.array([thing.instance for thing in things], np.int64)
    place = np.searchsorted(numbers, instances)
    place[place == len(numbers)] = 0
    on_thing = numbers[place] == instances if len(numbers) else np.zeros(len(instances), bool)
    points = np.bincount(place[on_thing], minlength=len(things))
    fired = np.bincount(place[on_thing], times[on_thing], minlength=len(things))
    wanted = np.flatnonzero(points >= min_points)
    covered, reached, mean_time = _coverage(scan, world, path, [things[i] for i in wanted])
    kept = (covered > 0) | (points[wanted] > 0)
    wanted, covered, reached, mean_time = wanted[kept], covered[kept], reached[kept], mean_time[kept]
    shown, count = [things[i] for i in wanted], points[wanted]
    own = np.divide(fired[wanted], count, out=mean_time, where=count > 0)
    time = own if moment is None else np.full(len(shown), moment)
    placed = [thing.box(when) for thing, when in zip(shown, time.tolist(), strict=True)]
    center, size, velocity = (np.array([row[k] for row in placed]).reshape(-1, 3) for k in (0, 1, 3))
    rotation = np.array([row[2] for row in placed]).reshape(-1, 3, 3)
    if not in_world:
        sensor = path.at(time)
        back = sensor[:, :3, :3].transpose(0, 2, 1)
        rotation = back @ rotation
        center, velocity = ((back @ v[:, :, None])[:, :, 0] for v in (center - sensor[:, :3, 3], velocity))
    farthest = float(np.nanmax(scan.range, initial=0.0) + np.abs(path.at(np.array([scan.time]))[0, :3, 3]).max())
    return Boxes(
        center=center,
        size=_rounded_up(size, center, farthest),
        rotation=rotation,
        velocity=velocity,
        label=np.array([thing.label for thing in shown], np.uint32),
        instance=numbers[wanted].astype(np.uint32),
        points=count,
        visibility=np.divide(reached, covered, out=np.full(len(shown), np.nan), where=covered > 0),
        time=time,
        class_names=dict(scan.class_names),
    )


def _coverage(
    scan: Annotated, world: Snapshot, path: _native.Path, things: Sequence[_Thing]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Floats]:
    """Return per thing: how many pulses would hit it if it stood alone, how many of these reach it, their mean time."""
    count = len(things)
    none = np.zeros(count, np.int64), np.zeros(count, np.int64), np.full(count, scan.time)
    items: list[_native.SceneObject] = [item for thing in things for item in thing.objects]
    thing_of = np.array([i for i, thing in enumerate(things) for _ in thing.objects], np.int64)
    if not items or not len(scan.pulses):
        return none
    alone = _native.Scene(items)
    pulses = scan.pulses
    now = scan.time + pulses.time
    changes = np.append(True, now[1:] != now[:-1])  # pulses that are fired at once share a pose
    poses = path.at(now[changes])[np.cumsum(changes) - 1]
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], pulses.directions)
    origins = np.einsum("nij,nj->ni", poses[:, :3, :3], pulses.origins) + poses[:, :3, 3]
    limit = 0.0, float(scan.lidar.max_range)
    moves = any(item.motion is not None for thing in things for item in thing.objects)
    hit = np.flatnonzero(alone.occluded(origins, directions, *limit, now if moves else None))
    o, d, then = origins[hit], directions[hit], now[hit]
    ray, item = alone.objects_met(o, d, *limit, then if moves else None)
    met = np.unique(ray * np.int64(count) + thing_of[item])  # a pulse that meets two parts of a thing meets it once
    ray, thing = met // count, met % count
    first = world.native.cast(o, d, *limit, then if world.movers else None)[1]
    owner = np.array([item.instance for item in world.items] + [-1], np.int64)[first]
    numbers = np.array([part.instance for part in things], np.int64)
    reaches = owner[ray] == numbers[thing]
    covered = np.bincount(thing, minlength=count)
    total = np.bincount(thing, then[ray], minlength=count)
    mean = np.divide(total, covered, out=np.full(count, scan.time), where=covered > 0)
    return covered, np.bincount(thing[reaches], minlength=count), mean
