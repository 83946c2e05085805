"""Oriented boxes around the instances that a scan shows: their annotation, as a detector is trained with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, Self
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base.labels import Labels
from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import html_table, plain, quantity, text_table
from lidarsim._base.validation import Floats, array, as_index
from lidarsim._base.vectors import CUBE, inverse, matvec, nearest_orthogonal, product
from lidarsim.errors import ArgumentTypeError
from lidarsim.patterns import Pulses
from lidarsim.patterns.raster import FIXED
from lidarsim.scan.columns import ScanColumns
from lidarsim.sensor.sensor import Sensor
from lidarsim.world.scene import SceneObject, Snapshot

UNIT = 2.0**-53
"""Unit roundoff of float64."""

ROUNDINGS = 64
"""More than the roundings on the way of a coordinate from a hit to a point, and from a shape to its box: a few rigid
transforms of some ten roundings each."""


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(Pickled):
    """Oriented boxes of instances, one entry per instance.

    An instance is all objects of the scene with one `instance` number. ``boxes[mask]`` selects some, and
    ``numpy.asarray(boxes)`` has rows of centre, size and yaw, (m, 7), as detectors take them.

    Attributes
    ----------
    center : ndarray of float64, shape (m, 3)
        Centre of the box, m.
    size : ndarray of float64, shape (m, 3)
        Length, width and height along its axes x, y and z, m. It is that of the shapes, not of the points, enlarged
        only by the rounding errors of points.
    rotation : ndarray of float64, shape (m, 3, 3)
        Axes of the box, in columns. They are those of the first object of the instance, turned in right angles so that
        z points up when the instance is at its reference pose: a vehicle modelled along x heads along x. If the
        instance has a motion, they are turned so that x is nearest to the x axis of the moving frame. A transform of
        the shape itself does not turn them.
    velocity : ndarray of float64, shape (m, 3)
        Velocity of the centre, as a point of the first object, relative to the world, in the axes of the frame, m/s.
    label : ndarray of uint32, shape (m,)
        Label of the first object, or of most of its faces. The array compares with class names, too: ``boxes.label ==
        "car"``.
    instance : ndarray of uint32, shape (m,)
        Instance number.
    points : ndarray of int64, shape (m,)
        Number of points on the instance.
    visibility : ndarray of float64, shape (m,)
        Share, 0 to 1, of the pulses that would hit the instance if it stood alone, within the maximum range, that reach
        it in the scene; nan if none would.
    truncation : ndarray of float64, shape (m,)
        Share, 0 to 1, of the box outside the sensor's view at that moment, as KITTI's "truncated" is the share outside
        the image. Box and view are ranges of azimuth, elevation and distance from the sensor: the box spans those of
        its corners, the view those of the scan's pulses, up to the maximum range. The share inside is the product
        of the shares of the three. A pattern with a single elevation, or a single azimuth, does not limit that angle.
    time : ndarray of float64, shape (m,)
        Moment of the box, s.
    class_names : mapping of int to str
        Names of labels, from the scene.
    in_sensor_frame : bool
        Whether the boxes are in a sensor frame that is not the world; `lidarsim.show` compares it with that of points.
    """

    center: Floats
    size: Floats
    rotation: Floats
    velocity: Floats
    label: npt.NDArray[np.uint32]
    instance: npt.NDArray[np.uint32]
    points: npt.NDArray[np.int64]
    visibility: Floats
    truncation: Floats
    time: Floats
    class_names: Mapping[int, str] = field(default_factory=dict)
    in_sensor_frame: bool = False

    def __post_init__(self) -> None:
        """Let labels compare with class names."""
        object.__setattr__(self, "label", Labels(self.label, self.class_names))

    def __len__(self) -> int:
        """Return the number of boxes."""
        return len(self.center)

    def __repr__(self) -> str:
        """Return the number of boxes and of points on them, for each class."""
        return text_table(*self._facts())

    def _repr_html_(self) -> str:
        """Return a small HTML table for notebooks."""
        return html_table(*self._facts())

    def _facts(self) -> tuple[str, list[tuple[str, str, str]]]:
        rows = []
        for label in np.unique(self.label).tolist():
            points = self.points[self.label == label]
            name = plain(self.class_names.get(label, f"label {label}"))
            rows.append((name, quantity(len(points), "instance"), quantity(int(points.sum()), "point")))
        return f"Boxes of {quantity(len(self), 'instance')} with {quantity(int(self.points.sum()), 'point')}", rows

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[np.float64]:
        """Return centre, size and yaw, (m, 7)."""
        return np.array(np.column_stack([self.center, self.size, self.yaw]), dtype, copy=copy)

    def __getitem__(self, index: int | slice | npt.ArrayLike) -> Self:
        """Return the boxes that a slice, a mask, an array of indices or one index selects."""
        if isinstance(index, str):
            hint = "boxes[boxes.label == name] are those of a class"
            raise ArgumentTypeError("index", "indices, a mask or a slice", repr(index), hint)
        which = as_index(index, len(self), "boxes")
        own: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        chosen: dict[str, Any] = {name: value[which] for name, value in own.items() if isinstance(value, np.ndarray)}
        return replace(self, **chosen)

    @property
    def yaw(self) -> Floats:
        """Heading of the boxes' x axes about z, -π to π rad: ndarray of float64, shape (m,)."""
        yaw: Floats = np.arctan2(self.rotation[:, 1, 0], self.rotation[:, 0, 0])
        return yaw

    @property
    def corners(self) -> Floats:
        """Corners, m: ndarray of float64, shape (m, 8, 3), in the order of ``numpy.ndindex(2, 2, 2)``."""
        return _corners(self.center, self.size, self.rotation)

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


class _Scanned(Protocol):
    """The attributes of `lidarsim.Scan`, which is in a higher layer, that boxes are made from."""

    @property
    def true_range(self) -> Floats: ...
    @property
    def object_id(self) -> npt.NDArray[np.int32]: ...
    @property
    def return_count(self) -> npt.NDArray[np.uint8]: ...
    @property
    def source(self) -> npt.NDArray[np.uint8] | None: ...
    @property
    def true_direction(self) -> Floats | None: ...
    @property
    def path(self) -> npt.NDArray[np.uint8] | None: ...
    @property
    def pulses(self) -> Pulses: ...
    @property
    def lidar(self) -> Sensor: ...
    @property
    def time(self) -> float: ...
    @property
    def class_names(self) -> Mapping[int, str]: ...


def boxes_of(
    scan: _Scanned,
    world: Snapshot,
    places: npt.NDArray[np.int32],
    path: _native.Path,
    moment: float | None,
    *,
    in_world: bool,
    min_points: int,
    labels: frozenset[int] | None,
) -> Boxes:
    """Return the boxes of the instances in a scan; see `lidarsim.Scan.boxes`.

    Parameters
    ----------
    scan : Scan
        The scan.
    world : Snapshot
        The scene that was scanned.
    places : ndarray of int32, shape (n, k)
        Place in the scene of the object that each return is on, or -1.
    path : lidarsim._native.Path
        Path of the sensor, sensor to world.
    moment : float or None
        Moment of all boxes, s; None: that of each instance's own points.
    in_world : bool
        Whether the boxes are in world coordinates, or in the sensor frame at their moment.
    min_points : int
        Least number of points on an instance.
    labels : frozenset of int, or None
        Labels of the instances; None for all.
    """
    instances = _instances_in(world)
    covered, reached, points, mean_time = _coverage(scan, world, places, path, instances, min_points, labels)
    listed = np.flatnonzero((points >= min_points) & ((covered > 0) | (points > 0)))
    time = scan.time + mean_time[listed] if moment is None else np.full(len(listed), moment)
    center, size, rotation, velocity = instances.boxes(listed, time)
    sensor = path.at(time)
    on_instance = np.append(instances.of_object, NO_INSTANCE)[places] != NO_INSTANCE
    distance = scan.true_range.max(initial=0.0, where=on_instance)  # a level pulse may meet the ground anywhere
    farthest = distance + np.abs(sensor[:, :3, 3]).max(initial=0.0)
    size = _round_up(size, center, farthest)
    back = sensor[:, :3, :3].transpose(0, 2, 1)
    seen_center, seen_rotation = matvec(back, center - sensor[:, :3, 3]), product(back, rotation)
    truncation = _truncation(_corners(seen_center, size, seen_rotation), scan.pulses, scan.lidar.max_range)
    if not in_world:
        center, rotation, velocity = seen_center, seen_rotation, matvec(back, velocity)
    return Boxes(
        center=center,
        size=size,
        rotation=rotation,
        velocity=velocity,
        label=instances.label[listed],
        instance=instances.instance[listed],
        points=points[listed].astype(np.int64),
        visibility=np.divide(reached, covered, out=np.full(len(instances), np.nan), where=covered > 0)[listed],
        truncation=truncation,
        time=time,
        class_names=dict(scan.class_names),
        in_sensor_frame=not in_world,
    )


def _corners(center: Floats, size: Floats, rotation: Floats) -> Floats:
    corners: Floats = center[:, None] + product(CUBE * size[:, None], rotation.transpose(0, 2, 1))
    return corners


def _round_up(size: Floats, center: Floats, farthest: float) -> Floats:
    """Return sizes that hold all points on the shapes, whose coordinates were rounded on their way.

    Every number on the way is at most the sum of the farthest coordinate and the distance of the box, and each of at
    most `ROUNDINGS` roundings moves a face or a point by at most `UNIT` of that.
    """
    reach = np.linalg.norm(center, axis=1) + np.linalg.norm(size, axis=1) + farthest
    rounded: Floats = size + 2.0 * ROUNDINGS * UNIT * reach[:, None]
    return rounded


# --- Instances -------------------------------------------------------------------------------------------------------


NO_INSTANCE = 2**32 - 1
"""Index of the instance of an object that belongs to none."""


@dataclass(frozen=True)
class _Instances:
    """The instances of a scene that can have a box, in ascending order of instance.

    Attributes
    ----------
    of_object : ndarray of uint32, shape (objects,)
        Index of the instance of each object, or `NO_INSTANCE`.
    parts : sequence of sequence of SceneObject
        The m instances: the objects of each, in ascending order of their ids.
    instance, label : ndarray of uint32, shape (m,)
        As in `Boxes`.
    axes : ndarray of float64, shape (m, 3, 3)
        Axes of each box before any motion, in columns; nan until `measure` has been called.
    extent : ndarray of float64, shape (m, 2, 3)
        Lowest and highest coordinates along the axes, before any motion, of the parts that move as the first does.
    apart : sequence of sequence of SceneObject
        Of each instance, the parts that do not.
    moves : ndarray of bool, shape (m,)
        Whether any part moves.
    scenes : dict
        By labels, a scene of the objects of the instances that have these, and the instance of each of its objects.
    """

    of_object: npt.NDArray[np.uint32]
    parts: Sequence[Sequence[SceneObject]]
    instance: npt.NDArray[np.uint32]
    label: npt.NDArray[np.uint32]
    axes: Floats
    extent: Floats
    apart: Sequence[Sequence[SceneObject]]
    moves: npt.NDArray[np.bool_]
    scenes: dict[frozenset[int], tuple[_native.Scene, npt.NDArray[np.uint32]]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.parts)

    def scene_of(self, labels: frozenset[int]) -> tuple[_native.Scene, npt.NDArray[np.uint32]]:
        """Return a scene of the instances of some labels alone, and the instance of each of its objects."""
        if labels not in self.scenes:
            which = np.flatnonzero(np.isin(self.label, sorted(labels))).tolist()
            parts = [self.parts[instance] for instance in which]
            of_object = np.repeat(np.array(which, np.uint32), [len(items) for items in parts])
            self.scenes[labels] = _native.Scene([item for items in parts for item in items]), of_object
        return self.scenes[labels]

    def measure(self, which: npt.NDArray[np.intp]) -> None:
        """Find the axes and extents of some instances, once."""
        for instance in which[np.isnan(self.axes[which, 0, 0])].tolist():
            parts, axes = self.parts[instance], _axes(self.parts[instance][0])
            together = [item for item in parts if item.motion is parts[0].motion]
            self.extent[instance] = _extent(together, np.hstack([axes.T, np.zeros((3, 1))]), None)
            self.axes[instance] = axes  # last: it says that the rest is there

    def boxes(self, which: npt.NDArray[np.intp], time: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return centre, size, rotation and velocity of some boxes in the world, each at its time, s."""
        self.measure(which)
        axes, extent = self.axes[which], self.extent[which]
        body = np.tile(np.eye(4), (len(which), 1, 1))
        linear, angular = np.zeros((2, len(which), 3))
        for k in np.flatnonzero(self.moves[which]).tolist():
            parts, moment = self.parts[which[k]], time[k : k + 1]
            motion = parts[0].motion
            if motion is not None:
                body[k] = motion._native.at(moment)[0]
                linear[k], angular[k] = motion._native.velocity(moment)[0]
            if apart := self.apart[which[k]]:
                low, high = _extent(apart, product(axes[k].T, inverse(body[k])[:3]), moment)
                extent[k] = np.minimum(extent[k, 0], low), np.maximum(extent[k, 1], high)
        turn = body[:, :3, :3]
        middle = matvec(axes, extent.mean(axis=1))
        center = matvec(turn, middle) + body[:, :3, 3]
        velocity = linear + matvec(turn, np.cross(angular, middle))
        return center, extent[:, 1] - extent[:, 0], product(turn, axes), velocity


_KNOWN: WeakKeyDictionary[Snapshot, _Instances] = WeakKeyDictionary()
"""The instances of scenes: successive scans see one snapshot until the scene changes."""


def _instances_in(world: Snapshot) -> _Instances:
    """Return the instances of a scene, without those that have unbounded parts; empty parts are left out."""
    known = _KNOWN.get(world)
    if known is not None:
        return known
    bounds = np.array([item.shape.bounds for item in world.items]).reshape(-1, 6)
    bounded, empty = np.isfinite(bounds).all(axis=1), np.isnan(bounds).any(axis=1)
    groups: dict[int, list[int]] = {}
    for place, item in enumerate(world.items):
        if not empty[place]:
            groups.setdefault(item.instance, []).append(place)
    instances = [places for _, places in sorted(groups.items()) if all(bounded[place] for place in places)]
    of_object = np.full(len(world.items), NO_INSTANCE, np.uint32)
    for instance, places in enumerate(instances):
        of_object[places] = instance
    parts = [[world.items[place] for place in places] for places in instances]
    made = _KNOWN[world] = _Instances(
        of_object=of_object,
        parts=parts,
        instance=np.array([own[0].instance for own in parts], np.uint32),
        label=np.array([_label(own[0]) for own in parts], np.uint32),
        axes=np.full((len(instances), 3, 3), np.nan),
        extent=np.full((len(instances), 2, 3), np.nan),
        apart=[[item for item in own if item.motion is not own[0].motion] for own in parts],
        moves=np.array([any(item.motion is not None for item in own) for own in parts], bool),
    )
    return made


def _label(item: SceneObject) -> int:
    """Return the label of an object, or of most of its faces: the smallest, if as many have another."""
    if isinstance(item.label, int):
        return item.label
    labels, faces = np.unique(item.label, return_counts=True)
    return int(labels[faces.argmax()])


def _axes(item: SceneObject) -> Floats:
    """Return the axes of an object as placed, turned in right angles so that z points up, as a rotation.

    x stays the object's x unless this points up or down; then it is its y. Of an object with a motion, it is the side
    nearest to the x axis of the moving frame.
    """
    if item.transform is None:
        return np.eye(3)
    nearest = nearest_orthogonal(item.transform[:3, :3])
    up = int(np.abs(nearest[2]).argmax())
    z = nearest[:, up] * np.copysign(1.0, nearest[2, up])
    x = nearest[:, 1 if up == 0 else 0]
    if item.motion is not None:
        x = max((x, -x, np.cross(z, x), np.cross(x, z)), key=lambda side: side[0])
    return np.stack([x, np.cross(z, x), z], axis=1)


def _extent(parts: Sequence[SceneObject], view: Floats, moment: Floats | None) -> Floats:
    """Return the lowest and highest coordinates of some objects, (2, 3), under an affine map (3, 4).

    They are where they are at a moment, s, shape (1,); None: before their motion.
    """
    still = np.eye(4)
    motions = [still if moment is None or item.motion is None else item.motion._native.at(moment)[0] for item in parts]
    transforms = [still if item.transform is None else item.transform for item in parts]
    places = product(product(view, np.array(motions)), np.array(transforms))
    ends = [item.shape._extent(place) for item, place in zip(parts, places, strict=True)]
    low, high = np.array(ends).transpose(1, 0, 2)
    return np.stack([low.min(axis=0), high.max(axis=0)])


# --- What the sensor sees of them ------------------------------------------------------------------------------------

UNIT_LENGTH = 2.0**-20
"""More than the error of the length of a pulse's direction: its square is checked to be 1 to within 1e-6."""

UNUSED_SOURCE = ScanColumns._columns["source"].unused
MISS, UNKNOWN = np.int32(-1), np.int32(-2)
"""What the core knows of a pulse in place of the object that it hits first."""


def _coverage(  # noqa: PLR0917 - what is known of a scan
    scan: _Scanned,
    world: Snapshot,
    places: npt.NDArray[np.int32],
    path: _native.Path,
    instances: _Instances,
    min_points: int,
    labels: frozenset[int] | None,
) -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.uint64], npt.NDArray[np.uint64], Floats]:
    """Return per instance: how many pulses would hit it if it stood alone, and how many do; its points; a time.

    That is the mean firing time of its points, or else of the pulses that would hit it, since the start of the scan.
    Instances with other labels or fewer points have no pulses.
    """
    objects, asked = (world.native, instances.of_object), np.ones(len(instances), bool)
    if labels is not None:
        objects, asked = instances.scene_of(labels), np.isin(instances.label, sorted(labels))
    if min_points:
        on = np.bincount(places.ravel() + 1, minlength=len(world.items) + 1)[1:]
        asked &= np.bincount(np.minimum(instances.of_object, len(instances)), on, len(instances) + 1)[:-1] >= min_points
    instance = np.append(np.where(asked, np.arange(len(instances)), NO_INSTANCE), NO_INSTANCE).astype(np.uint32)
    known, alone = (instance[np.minimum(own, len(instances))] for own in (instances.of_object, objects[1]))
    limit = float(scan.lidar.max_range)
    first = _first_hits(scan, places[:, 0], limit)
    returns = places, scan.return_count
    return _native.coverage(
        world.native, path, scan.pulses, scan.time, (known, len(instances)), (objects[0], alone), limit, returns, first
    )


def _first_hits(scan: _Scanned, hit: npt.NDArray[np.int32], limit: float) -> npt.NDArray[np.int32] | None:
    """Return the place of the object that each nominal pulse hits first within a range, `MISS` or `UNKNOWN`.

    None if the scan does not tell, as its rays were not the nominal pulses, or its returns not those of the first
    surface. `hit` are the places of the objects that
    the first entries of the scan are on.
    """
    if scan.true_direction is not None or scan.path is not None:
        return None
    # The limit is one of t, the distance in units of the length of the direction.
    distance, nearly, beyond = scan.true_range[:, 0], limit * (1.0 - UNIT_LENGTH), limit * (1.0 + UNIT_LENGTH)
    first = np.where(distance > beyond, MISS, hit)
    first[(nearly <= distance) & (distance <= beyond)] = UNKNOWN
    if scan.source is not None:  # a return that is not from a surface may hide one
        first[(hit < 0) & (scan.source[:, 0] != UNUSED_SOURCE)] = UNKNOWN
    if scan.lidar.measurement.receiver_offset:  # the receiver may not see the first surface
        first[hit < 0] = UNKNOWN
    return first


def _truncation(corners: Floats, pulses: Pulses, max_range: float) -> Floats:
    """Return the share of each box outside the view, from its corners in the sensor frame, (m, 8, 3)."""
    x, y, z = np.moveaxis(corners, -1, 0)
    level = np.hypot(x, y)
    (start, width), elevations = _view(pulses)
    inside = _share(np.arctan2(z, level), *elevations) * _share(np.hypot(level, z), 0.0, max_range)
    middle = np.arctan2(y.mean(axis=1), x.mean(axis=1))[:, None]
    aside = (np.arctan2(y, x) - middle + math.pi) % math.tau - math.pi
    # The corners of a box around the sensor's axis span half a turn or more of azimuth, those of any other box less.
    around = np.ptp(aside, axis=1) >= math.pi
    aside[around] = np.linspace(-math.pi, math.pi, aside.shape[1])
    first = (middle[:, 0] + aside.min(axis=1) - start) % math.tau
    span = np.ptp(aside, axis=1)
    last = first + span  # less than two turns after the start of the view, which ends at its width and begins anew
    outside = np.clip(np.minimum(last, math.tau) - np.maximum(first, width), 0.0, None)
    outside += np.clip(last - (math.tau + width), 0.0, None)
    truncation: Floats = 1.0 - inside * (1.0 - _divide(outside, span))
    return truncation


def _share(values: Floats, low: float, high: float) -> Floats:
    """Return the share of the range of each row of values, (m, 8), between two limits."""
    least, most = values.min(axis=1), values.max(axis=1)
    span = most - least
    return 1.0 - _divide(np.clip(low - least, 0.0, span) + np.clip(most - high, 0.0, span), span)


def _divide(outside: Floats, span: Floats) -> Floats:
    """Return the share that is outside; none of a range without extent, which some pulse meets."""
    share: Floats = np.divide(outside, span, out=np.zeros_like(span), where=span > 0.0)
    return share


_VIEWS: WeakKeyDictionary[Pulses, tuple[tuple[float, float], tuple[float, float]]] = WeakKeyDictionary()
"""The views of pulses: most patterns have the same pulses in every frame."""


NARROW = math.radians(1.0)
"""Widest gap between the azimuths of pulses, rad, that limits no view."""

SAMPLE = 2**12
"""Number of pulses, about, whose azimuths are looked at first: where they leave no gap, all pulses leave none."""


def _view(pulses: Pulses) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the view of a sensor: first azimuth and width, lowest and highest elevation, rad.

    An angle that is the same for all pulses is not limited.
    """
    known = _VIEWS.get(pulses)
    if known is not None:
        return known
    azimuths, elevations = (-math.pi, math.tau), (-0.5 * math.pi, 0.5 * math.pi)
    if len(pulses):
        z = pulses.directions[:, 2]
        lowest, highest = np.arcsin(np.clip([z.min(), z.max()], -1.0, 1.0)).tolist()
        if highest - lowest > FIXED:
            elevations = lowest, highest
        x, y, _ = pulses.directions[:: 1 + len(pulses) // SAMPLE].T
        if _gaps(np.sort(np.arctan2(y, x))).max() > NARROW:
            ordered = np.sort(pulses.azimuth)
            gaps = _gaps(ordered)
            last = int(gaps.argmax())
            widest, gaps[last] = float(gaps[last]), 0.0
            # Around a full turn, the widest gap is one of many between two columns. Else the view leaves it out.
            if max(NARROW, 2.0 * gaps.max()) < widest < math.tau - FIXED:
                azimuths = float(ordered[(last + 1) % len(ordered)]), math.tau - widest
    made = _VIEWS[pulses] = azimuths, elevations
    return made


def _gaps(azimuths: Floats) -> Floats:
    """Return the gap after each of n ascending azimuths, shape (n,), rad."""
    gaps: Floats = np.diff(azimuths, append=azimuths[0] + math.tau)
    return gaps
