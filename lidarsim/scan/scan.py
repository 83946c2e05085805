"""Scans: fire the pulses of a frame at a scene, and keep the measurements with the ground truth."""

from __future__ import annotations

import copy
import enum
import math
import sys
import zlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base import validation
from lidarsim._base.labels import Labels, labels_of
from lidarsim._base.names import explain_arguments
from lidarsim._base.pickling import Pickled
from lidarsim._base.shown import extent, html_table, quantity, text_table
from lidarsim._base.validation import (
    Floats,
    Instances,
    Transform,
    as_array,
    flag,
    instances,
    integer,
    one_of,
    real,
    short_repr,
)
from lidarsim._base.views import Plotted
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.patterns import Pulses
from lidarsim.patterns._pulses import pulses_of
from lidarsim.patterns.raster import projection, rows_and_columns
from lidarsim.scan.boxes import Boxes, boxes_of
from lidarsim.scan.columns import ScanColumns, with_columns
from lidarsim.scan.fields import CANONICAL
from lidarsim.scan.laser_scan import LaserScan, laser_scan_of
from lidarsim.scan.pointcloud import PointCloud, choose
from lidarsim.scan.waveforms import Waveforms
from lidarsim.sensor.measurement import PULSE_LENGTH
from lidarsim.sensor.sensor import Sensor
from lidarsim.world.atmosphere import check_sensor
from lidarsim.world.scene import Scene, Snapshot


class Status(enum.IntEnum):
    """Outcome of a pulse: a point, or the reason why there is none.

    ``below_threshold`` is an echo weaker than the detection limit (`lidarsim.Detection`), and ``dropped`` one that
    random drop-out removed. `Lidar.min_range` and `Lidar.max_range` are the limits of the range gate.
    """

    hit = 0
    miss = 1
    below_min_range = 2
    beyond_max_range = 3
    below_threshold = 4
    dropped = 5


class Source(enum.IntEnum):
    """What a return comes from."""

    surface = 0
    atmosphere = 1
    false_return = 2


class Summary(dict[str, int]):
    """Number of pulses for each `Status`, by its name; prints as a table."""

    note: str = ""
    """A warning if all hits are on one instance that is nearer than the sensor's minimum range, or than `BODY`, or if
    most points are echoes of the air."""

    def __str__(self) -> str:
        """Return one line for each status, with its share of all pulses."""
        total = sum(self.values())
        lines = [f"{name:16} {count:10,} {count / max(total, 1):7.1%}" for name, count in self.items()]
        return "\n".join([*lines, f"{'pulses':16} {total:10,}", *filter(None, [self.note])])

    __repr__ = __str__


BODY = 0.5
"""Distance, m, below which an instance that hides everything else may be what carries the sensor."""

_MOMENTS = {"start": 0.0, "middle": 0.5, "end": 1.0}
"""Named values of `deskew`, in periods of the pattern since the start of the scan."""

_IDENTITY: list[list[float]] = np.eye(4).tolist()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
@with_columns("n", lacking="None")
class Returns(ScanColumns[None]):
    """The arrays of a `Scan` with one return per pulse, as views without the axis of returns; see `Scan.single`."""


class _Shot(NamedTuple):
    """How the pulses of a scan were fired."""

    path: _native.Path
    """Path of the sensor, sensor to world."""
    indices: npt.NDArray[np.uint64] | None
    """Indices of the pulses in the whole frame; None for all of them, in order."""
    draws: tuple[int, int, int]
    """Seed, sensor and frame, which select the noise."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
@with_columns("n, k", lacking="None")
class Scan(ScanColumns[None], Pickled, Plotted):
    """One frame of a sensor: up to k returns for each of n pulses, in firing order.

    k is `Measurement.max_returns`, 1 by default. Unused entries of floating-point arrays are nan. If a pulse hit
    something but gave no point, its first entry holds the ground truth of its strongest echo.

    Attributes
    ----------
    pulses : Pulses
        The nominal pulses of the pattern, in the sensor frame.
    lidar : Lidar
        The sensor.
    pose : ndarray of float64, shape (4, 4), or Trajectory
        Pose of the sensor, sensor to world.
    time : float
        Start of the scan, s.
    frame : int
        Number of the frame.
    class_names : mapping of int to str
        Names of labels, from the scene.
    ignore : tuple of int
        Instances that the sensor did not see.

    Notes
    -----
    With a diverging beam, the ground truth of an echo is taken from the object that returns most of its power, at the
    sub-ray nearest to the axis that hits this object.

    Of light that went on from other surfaces (`Measurement.depth`), `object_id`, `instance`, `label`, `normal` and
    `incidence` are those of the surface that it came to at last, and `true_range` is the length of the whole way.
    `radial_velocity` is the rate of change of that length, to which sensor, surface and moving mirrors add.
    """

    pulses: Pulses
    lidar: Sensor
    pose: Floats | Trajectory
    time: float
    frame: int
    class_names: Mapping[int, str] = field(default_factory=dict)
    ignore: tuple[int, ...] = ()
    _world: Snapshot | None = field(default=None, repr=False)
    """The scene as it was scanned."""
    _shot: _Shot | None = field(default=None, repr=False)
    """How its pulses were fired."""

    def __post_init__(self) -> None:
        """Let labels and statuses compare with names."""
        object.__setattr__(self, "label", Labels(self.label, self.class_names))
        object.__setattr__(self, "status", Labels(self.status, {status: status.name for status in Status}, "status"))

    def _contents(self) -> dict[str, Any]:
        contents = Pickled._contents(self)  # `super()` fails in a dataclass with slots
        del contents["_world"], contents["_shot"]  # may be far larger than the scan
        return contents

    @classmethod
    def _from_contents(cls, contents: dict[str, Any]) -> Self:
        made: Self = super(Scan, cls)._from_contents({"_world": None, "_shot": None, **contents})
        return made

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        contents = copy.deepcopy(self._contents(), memo)
        return self._from_contents({**contents, "_world": self._world, "_shot": self._shot})

    def __len__(self) -> int:
        """Return the number of pulses."""
        return len(self.status)

    def __repr__(self) -> str:
        """Return the sensor, frame and time, and the number of pulses by status."""
        return text_table(*self._facts())

    def _repr_html_(self) -> str:
        """Return a small HTML table for notebooks."""
        return html_table(*self._facts())

    def _facts(self) -> tuple[str, list[tuple[str, str]]]:
        summary = self.summary()
        rows = [(name, f"{count:,} ({count / len(self):.1%})") for name, count in summary.items() if count]
        rows += [("note", summary.note)] if summary.note else []
        rows += [("range", f"{found} m") for found in [extent(self.range)] if found]
        name = getattr(self.lidar, "name", "") or type(self.lidar.pattern).__name__
        return f"Scan of {name}, frame {self.frame} at {self.time:.12g} s: {quantity(len(self), 'pulse')}", rows

    @property
    def single(self) -> Returns:
        """The arrays of a sensor with one return per pulse, in shape (n,) instead of (n, 1): Returns.

        Raises
        ------
        ValueError
            If the sensor has more returns; ``scan.range[:, 0]`` are then those reported first.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> ball = scene.add(ls.Sphere((10, 0, 0), 2.0))
        >>> scan = ls.Lidar(ls.patterns.Grid([0.0, 1.0], [0.0], rate=10.0)).scan(scene)
        >>> scan.range.shape, scan.single.range
        ((2, 1), array([ 8., nan]))
        """
        if self.range.shape[1] != 1:
            got = f"up to {self.range.shape[1]}"
            raise ArgumentValueError(
                "single", "a sensor with one return per pulse", got, "scan.range[:, 0] has the first"
            )
        values: dict[str, Any] = {name: getattr(self, name) for name in Scan._columns}
        of_returns = [name for name, value in values.items() if value is not None and Scan._columns[name].of_returns]
        return Returns(**values | {name: values[name][:, 0] for name in of_returns})

    @property
    def poses(self) -> Floats:
        """Pose of the sensor at the time of each pulse, sensor to world: ndarray of float64, shape (n, 4, 4)."""
        if isinstance(self.pose, Trajectory):
            return self.pose._native.at(self.time + self.pulses.time)
        still = _native.Path.still(self.pose.tolist()).at(np.zeros(1))  # orthonormalised, as for the cast
        return np.broadcast_to(still[0], (len(self), 4, 4))

    @explain_arguments
    def point_cloud(
        self,
        frame: Literal["sensor", "world"] = "sensor",
        *,
        deskew: bool | Literal["start", "middle", "end"] | float = False,
        deskew_movers: bool = False,
        pose: Transform | Trajectory | None = None,
        fields: Collection[str] | None = None,
    ) -> PointCloud:
        """Return the points of all returns.

        Parameters
        ----------
        frame : {"sensor", "world"}
            Coordinates of points and normals. "sensor": as a driver outputs them, each point in the sensor frame at the
            time of its pulse, so that the cloud of a moving sensor is skewed. "world": each point is transformed by the
            pose at the time of its pulse, so that the cloud is not skewed.
        deskew : bool, {"start", "middle", "end"} or float
            Deskew the points of frame "sensor": transform them, by the true poses, to the sensor frame at one moment.
            "start" or True: the start of the scan. "middle": half a period of the pattern, 1/rate, later. "end": a
            whole period later, whenever the last pulse was fired. A number: that many seconds after the start. This has
            no effect on frame "world" or on a static sensor.
        deskew_movers : bool
            Also move the points of moving objects, in either frame, to where they are on the objects at the moment of
            `deskew`. Tracking would have to find these motions; here, they are the true ones. Ghosts in mirrors stay.
        pose : RigidTransform, array_like of shape (4, 4) or Trajectory, optional
            The estimated pose, sensor to world: the points are placed and deskewed with it, and normals turn with them.
            ``trajectory.perturbed(…)`` makes one. Default: the true pose.
        fields : collection of str, optional
            Names of the fields besides `xyz`; a cloud with fewer takes less time and memory. Default: all.

        Returns
        -------
        PointCloud
            The points in firing order; the returns of a pulse are consecutive. A point lies at the measured range from
            the beam's origin, in the nominal direction of the pulse, without angular jitter.

        Raises
        ------
        TypeError, ValueError
            If `frame` or `deskew` is none of these, the trajectory or a motion does not cover that moment, `pose` is
            not rigid or does not cover all pulses, `deskew_movers` is given without `deskew`, with `pose`, or for a
            scan from a pickle, which does not contain the scene, or the scan has no such field.
        """
        one_of("frame", frame, ("sensor", "world"))
        deskew_movers = flag("deskew_movers", deskew_movers)
        if pose is not None:
            if deskew_movers:
                raise ArgumentValueError(
                    "deskew_movers", "none with another pose, as motions are the true ones", "True"
                )
            return self._with_pose(pose).point_cloud(frame, deskew=deskew, fields=fields)
        if frame == "world" and not deskew_movers:
            moment_of(deskew, 1.0)  # only checks it
            moment = None
        else:
            moment = self._find_deskew_moment(deskew)
        if deskew_movers and moment is None:
            raise ArgumentValueError("deskew_movers", "a deskewed cloud", "deskew=False")
        names = None if fields is None else choose(fields, self._cloud_fields())
        movers = None
        if deskew_movers and moment is not None:
            world = self._require_world()
            world.check_motions(moment, moment, _round_on, argument="deskew")
            movers = world.native, self._places(world), moment
        if isinstance(self.pose, Trajectory):
            path, moment = self.pose._native, None if frame == "world" else moment
        else:
            path, moment = _native.Path.still(self.pose.tolist()), None
        made = _native.points_of(self, path, frame, moment, names, movers)
        return PointCloud._of(made, self.class_names, in_sensor_frame=self._is_elsewhere(frame))

    def _cloud_fields(self) -> list[str]:
        """Return the names of all fields that its clouds can have."""
        return [name for name in CANONICAL if name not in Scan._columns or getattr(self, name) is not None]

    def _with_pose(self, pose: Transform | Trajectory) -> Scan:
        """Return the scan with another pose; the normals, which the sensor sees in its own frame, turn with it."""
        where = _where(pose)
        if isinstance(where, Trajectory) and len(self):
            _check_span(where, self.pulses, self.time, 1.0 / self.lidar.pattern.rate)
        estimated = replace(self, pose=where)
        turned = np.einsum("nij,nkj->nik", estimated.poses[:, :3, :3], self.poses[:, :3, :3])
        changed: dict[str, Any] = {"normal": np.einsum("nij,nrj->nri", turned, self.normal).astype(np.float32)}
        return replace(estimated, **changed)

    def _find_deskew_moment(self, deskew: object) -> float | None:
        """Return the moment of `deskew`, s, after checking that the trajectory covers it; None for raw points."""
        offset = moment_of(deskew, self.lidar.pattern.rate)
        if offset is None:
            return None
        moment = self.time + offset
        if isinstance(self.pose, Trajectory):
            first, last = self.pose._native.span()
            if not first <= moment <= _round_on(last):
                expected = f"a moment within the trajectory, {first} to {last} s"
                raise ArgumentValueError("deskew", expected, f"{deskew!r}, at {moment} s")
        return moment

    def _is_elsewhere(self, frame: str) -> bool:
        """Return whether a frame is not the world."""
        return frame == "sensor" and (isinstance(self.pose, Trajectory) or self.pose.tolist() != _IDENTITY)

    def _places(self, world: Snapshot) -> npt.NDArray[np.int32]:
        """Return the place in a scene of the object that each return is on; -1 for none and for ghosts in mirrors."""
        places = world.places_of(self.object_id)
        if self.mirrored_point is None:
            return places
        return np.where(np.isnan(self.mirrored_point[..., 0]), places, np.int32(-1))

    def _require_world(self) -> Snapshot:
        if self._world is None:
            raise ArgumentValueError("scan", "one with its scene", "one from a pickle", "call this before pickling")
        return self._world

    def boxes(
        self,
        *,
        frame: Literal["sensor", "world"] = "sensor",
        deskew: bool | Literal["start", "middle", "end"] | float = False,
        min_points: int = 0,
        labels: Collection[int | str] | None = None,
    ) -> Boxes:
        """Return oriented boxes of the instances that the sensor could see, with their visibility and truncation.

        An instance is all objects of the scene with one `instance` number. It has a box if at least one pulse would hit
        it if it stood alone, or it has a point. Instances of which a part is unbounded, such as a `Plane`, have none.

        Parameters
        ----------
        frame : {"sensor", "world"}
            Coordinates of the boxes, as in `point_cloud`.
        deskew : bool, {"start", "middle", "end"} or float
            As in `point_cloud`: the boxes are where the instances are at that moment, in its sensor frame.
            False: each box is where its instance is at the mean firing time of its points, or of the pulses that would
            hit it if it has none.
        min_points : int
            Least number of points on the instance.
        labels : collection of int or str, optional
            Labels of the instances, or their class names. Boxes of fewer instances take less time. Default: all.

        Returns
        -------
        Boxes
            In ascending order of the instance.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong type or out of range, the trajectory or the motion of an instance does not
            cover the moment, or the scan was pickled: pickles do not contain the scene.

        Notes
        -----
        `point_cloud(deskew=…)` undoes the motion of the sensor, not that of the instances: one that moves at v is
        smeared by v times the time that the sensor takes to pass it, and points near its ends may lie outside its box.
        With ``deskew_movers=True``, they do not.

        Visibility is that of the nominal pulses, without jitter and divergence of the beam, and exact: it is what
        casting the pulses at each instance alone, and at all of them together, would find.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Box((1, 4, 3), center=(5, 2, 0)))
        >>> ball = scene.add(ls.Sphere((8, 0, 0), 0.5), label=7)
        >>> boxes = ls.Lidar.preset("velodyne-vlp16").scan(scene).boxes()
        >>> boxes.instance, boxes.size.round(6).tolist()
        (array([1, 2], dtype=uint32), [[1.0, 4.0, 3.0], [1.0, 1.0, 1.0]])
        >>> boxes.visibility.round(1)
        array([1. , 0.5])
        """
        one_of("frame", frame, ("sensor", "world"))
        moment, least = self._find_deskew_moment(deskew), integer("min_points", min_points, at_least=0)
        world = self._require_world()
        if moment is not None:
            world.check_motions(moment, moment, _round_on, argument="deskew")
        world = world.without(self.ignore)
        return boxes_of(
            self,
            world,
            self._places(world),
            path_of(self.pose, self.pulses, self.time, 1.0 / self.lidar.pattern.rate),
            moment,
            in_world=not self._is_elsewhere(frame),
            min_points=least,
            labels=None if labels is None else labels_of("labels", labels, self.class_names),
        )

    def waveforms(self, sample_period: float = 1e-9, *, pulses: npt.ArrayLike | None = None) -> Waveforms:
        """Return the received power of pulses over time, from which the scan took its echoes.

        The pulses are fired again, with the same jitter, drops and flakes.

        Parameters
        ----------
        sample_period : float
            Time between two samples, s, > 0 and at most 1e-6. At 1 ns, samples are 0.15 m of range apart.
        pulses : array_like of int, shape (m,), or of bool, shape (n,), optional
            The pulses to record: their indices in this scan, or a mask. Default: all.

        Returns
        -------
        Waveforms
            One waveform per pulse, in the order of `pulses`. It ends at `Lidar.max_range`.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong type or out of its range, or the scan was pickled: pickles do not contain the
            scene.
        MemoryError
            If there is no memory for the samples; raised before any is computed, with their size.

        Notes
        -----
        It takes about the time of two scans of these pulses, in fog up to some ms per pulse, and 4 bytes for each
        sample. A sensor without a `Beam` has the pulse of a beam's default length at each surface.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> ground = scene.add(ls.Plane((0, 0, 1), -100.0))
        >>> scan = ls.Lidar.preset("riegl-vq780i").scan(scene)
        >>> waveforms = scan.waveforms(pulses=scan.return_count > 0)
        """
        period = real("sample_period", sample_period, above=0.0, at_most=1e-6)
        world, shot = self._require_world(), self._shot
        if shot is None:
            raise ArgumentValueError("scan", "one that a lidar made", "another")
        whole, numbers = self.pulses, shot.indices
        chosen = np.arange(len(self), dtype=np.uint64)
        if pulses is not None:
            chosen = _choose(pulses, len(self))
            whole = _some(whole, chosen)
            numbers = chosen if numbers is None else numbers[chosen]
        first, offsets, samples = _native.waveforms(
            world.native,
            shot.path,
            whole,
            numbers,
            self.lidar,
            self.time,
            shot.draws,
            period,
            self.lidar.max_range,
            world.atmosphere,
            instances("ignore", self.ignore),
        )
        beam = self.lidar.measurement.beam
        return Waveforms(
            pulse=chosen.astype(np.int64),
            first=first,
            offsets=offsets,
            samples=samples,
            sample_period=period,
            pulse_length=PULSE_LENGTH if beam is None else beam.pulse_length,
        )

    def laser_scan(self) -> LaserScan:
        """Return the scan of a 2D lidar as ROS's ``sensor_msgs/LaserScan`` has it.

        Returns
        -------
        LaserScan
            The first return of each pulse, in the order of increasing angle, whichever way the sensor turns.

        Raises
        ------
        ValueError
            If this is no scan of a 2D lidar: its pulses are of one ring, from the middle of the sensor, in its plane
            z = 0 and in equal steps of azimuth.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> wall = scene.add(ls.Plane((1, 0, 0), 5.0))
        >>> found = ls.Lidar.preset("sick-lms111").scan(scene).laser_scan()
        >>> len(found), round(found.angle_min, 4), round(found.angle_increment, 6), found.range_max
        (541, -2.3562, 0.008727, 20.0)
        >>> found.ranges[[0, 270]].round(2)
        array([inf,  5.], dtype=float32)
        """
        return laser_scan_of(
            self.lidar,
            self.pulses,
            self.time,
            ranges=self.range[:, 0],
            intensities=self.intensity[:, 0],
            too_near=self.status == Status.below_min_range,
        )

    def image(
        self, field: str = "range", *, return_number: int = 1, size: tuple[int, int] | None = None
    ) -> npt.NDArray[Any]:
        """Return a field as an image from the sensor's point of view, upright and destaggered.

        Rows are rings, the highest first. Columns are steps of azimuth, which decreases from left to right; rings with
        azimuth offsets are shifted by whole columns so that all pixels of a column have the same azimuth. The columns
        of a 360° sensor span a full turn, with azimuth 0 in the middle and the seam behind the sensor. This requires a
        pattern in which each ring has one elevation, or a band of elevations that no other ring enters, and turns in
        one direction, once around at most.

        Other patterns, and all patterns if `size` is given, are projected: rows and columns are equal steps of
        elevation and azimuth between the outermost pulses of the frame. A pixel shows the nearest return that falls
        into it.

        Parameters
        ----------
        field : str
            An array of this scan or of its pulses: "range", "label", "normal", "status", "time" (firing time since the
            start of the scan), …. Normals are in world coordinates, directions and origins in the sensor frame.
        return_number : int
            Which return of each pulse, counted from 1. A projection chooses the nearest among these.
        size : tuple of int, optional
            Rows and columns of a projection.

        Returns
        -------
        ndarray, shape (rows, columns) or (rows, columns, 3)
            The image, in the dtype of the field. Unused entries of the scan keep their values. Pixels without a pulse
            are nan in floating-point fields, 0 in "label", "instance" and "return_count", -1 in "object_id", and the
            largest value of the dtype in any other integer field.

        Raises
        ------
        TypeError, ValueError
            If there is no such field or return, `size` is not two integers >= 1, or `size` is missing and the pattern
            has no rows and columns.

        Examples
        --------
        >>> import lidarsim as ls
        >>> scene = ls.Scene()
        >>> ball = scene.add(ls.Sphere((10, 0, 2), 2.5), label=7)
        >>> scan = ls.Lidar.preset("ouster-os1-64").scan(scene)
        >>> image = scan.image("label")
        >>> image.shape, image[20, 512].item(), image[20, 0].item()
        ((64, 1024), 7, 0)
        """
        own, of_pulses = _arrays(self), _arrays(self.pulses)
        if not (isinstance(field, str) and field in own | of_pulses):
            raise ArgumentValueError("field", f"one of {', '.join(own | of_pulses)}", short_repr(field))
        entry = integer("return_number", return_number, at_least=1, at_most=self.range.shape[1]) - 1
        values = of_pulses[field] if field in of_pulses else own[field]
        if field in own and values.ndim > 1:
            values = values[:, entry]
        frame = pulses_of(self.lidar.pattern, self.frame)
        if size is None:
            row, column, shape = rows_and_columns(frame, self.pulses)
        else:
            row, column, shape = projection(frame, self.pulses, size)
        image = np.full((*shape, *values.shape[1:]), fill_value(field, values.dtype), values.dtype)
        if size is None:  # one pixel per pulse
            image[row, column] = values
        else:  # the last write wins: pulses without a return come first, the nearest return comes last
            order = np.argsort(self.range[:, entry], kind="stable")[::-1]
            image[row[order], column[order]] = values[order]
        return image

    @property
    def _returned(self) -> npt.NDArray[np.bool_]:
        """Which entries are returns: ndarray of bool, shape (n, k)."""
        returned: npt.NDArray[np.bool_] = np.arange(self.range.shape[1]) < self.return_count[:, None]
        return returned

    def true_points(self, frame: Literal["sensor", "world"] = "sensor") -> Floats:
        """Return the true points of the returns, as opposed to the measured points of `point_cloud`.

        Parameters
        ----------
        frame : {"sensor", "world"}
            Coordinates, as in `point_cloud`: the sensor frame at the time of the pulse, or the world.

        Returns
        -------
        ndarray of float64, shape (m, 3)
            One point for each point of `point_cloud`, in the same order, m. It lies on the surface of the object
            `object_id`, at `true_range` along the actual direction of the pulse; with a beam, along the sub-ray that
            the ground truth is taken from (see `Scan`). Of mirrored light it is `mirrored_point`, where the light
            really came from, not the ghost behind the mirror. For echoes of the air, it is where the drop or flake is,
            or the peak of the fog's echo. For false returns, it is nan.

        Raises
        ------
        ValueError
            If `frame` is neither.
        """
        one_of("frame", frame, ("sensor", "world"))
        returned = self._returned
        pulse = np.nonzero(returned)[0]
        took = self.pulses.directions[pulse] if self.true_direction is None else self.true_direction[returned]
        # The length of a direction may be 1 only to float32 precision, but the range is a distance.
        reach = self.true_range[returned] / np.linalg.norm(took, axis=1)
        with np.errstate(over="ignore", invalid="ignore"):  # points near the limit of float64
            points: Floats = self.pulses.origins[pulse] + reach[:, None] * took
            if self.mirrored_point is not None:
                mirrored = self.mirrored_point[returned]
                points = np.where(np.isnan(mirrored), points, mirrored)
            if frame == "sensor":
                return points
            poses = self.poses[pulse]
            turned: Floats = (poses[:, :3, :3] @ points[:, :, None])[:, :, 0]
            return turned + poses[:, :3, 3]

    def summary(self) -> Summary:
        """Return the number of pulses for each status; it prints as a table.

        Returns
        -------
        Summary
            A mapping from the name of each `Status` to the number of pulses. Its `note` warns if the sensor may be
            inside an object, or inside the body that carries it: all first hits are on one instance, nearer than
            `min_range` or 0.5 m. It also says if more than half of the points are echoes of the air.
        """
        counts = np.bincount(self.status, minlength=len(Status))
        summary = Summary({status.name: int(counts[status]) for status in Status})
        seen = self.object_id[:, 0] >= 0
        instances, objects = (np.unique(ids[seen, 0]) for ids in (self.instance, self.object_id))
        if len(instances) == 1:
            farthest = self.true_range[seen, 0].max()
            below_gate = farthest < self.lidar.min_range and not summary["hit"]
            if below_gate or farthest < BODY:
                which = f"object {objects[0]}" if len(objects) == 1 else f"the objects of instance {instances[0]}"
                summary.note = (
                    f"all hits are on {which}, nearer than {'min_range' if below_gate else f'{BODY} m'}:"
                    f" is the sensor inside its own body? ignore=[{instances[0]}] hides it"
                )
        aerial = 0
        if self.source is not None:
            aerial = int(np.count_nonzero((self.source == Source.atmosphere) & ~np.isnan(self.range)))
        points = int(self.return_count.sum())
        if 2 * aerial > points:
            hint = (
                "" if self.lidar.measurement.near_threshold else ": is near_threshold=0.01 missing in the measurement?"
            )
            summary.note = f"{aerial:,} of {points:,} points are echoes of the air{hint}"
        return summary


def scan(
    lidar: Sensor,
    scene: Scene,
    pose: Transform | Trajectory | None = None,
    *,
    time: float = 0.0,
    frame: int = 0,
    seed: int = 0,
    indices: npt.ArrayLike | None = None,
    ignore: Instances = (),
) -> Scan:
    """Fire the pulses of a frame at a scene and measure the returns; see `lidarsim.Lidar.scan`.

    `indices` fires only these pulses of the frame, in this order. Their noise is the same as in the whole frame.
    """
    if not isinstance(scene, Scene):
        raise ArgumentTypeError(
            "scene", "a Scene", short_repr(scene), "scan(scene, pose)" if isinstance(pose, Scene) else ""
        )
    time = real("time", time)
    frame = integer("frame", frame, at_least=0, at_most=2**32 - 1)
    seed = integer("seed", seed, at_least=0, at_most=2**64 - 1)
    where = _where(pose)
    check_sensor(scene.atmosphere, lidar)
    unseen = instances("ignore", ignore)
    if indices is None:
        count = math.prod(lidar.pattern.shape)
        _native.expect_room(min(count, sys.maxsize), lidar, scene.atmosphere)  # fail before the pattern makes pulses
    pulses = pulses_of(lidar.pattern, frame)
    period = 1.0 / lidar.pattern.rate
    path = path_of(where, pulses, time, period)
    whole = pulses
    chosen = None if indices is None else _indices("indices", indices, len(pulses))
    if chosen is not None:
        pulses = _some(pulses, chosen)
    world = scene._snapshot()
    if world.movers and len(pulses):
        fired = time + pulses.time.min(), time + pulses.time.max()
        world.check_motions(*fired, until_of(whole, time, period))
    shot = _Shot(path, chosen, (seed, sensor_id(lidar.name), frame))
    try:
        arrays = _native.scan(
            world.native,
            shot.path,
            pulses,
            shot.indices,
            lidar,
            time,
            shot.draws,
            world.atmosphere,
            unseen,
        )
    except ArgumentValueError as error:
        if error.argument == "pose" and isinstance(where, Trajectory):
            error.hint = _shift_hint(where, time + pulses.time.max())
        raise
    arrays["object_id"] = world.ids_of(arrays["object_id"])
    return Scan(
        **arrays,
        pulses=pulses,
        lidar=lidar,
        pose=where,
        time=time,
        frame=frame,
        class_names=dict(scene.class_names),
        ignore=() if unseen is None else tuple(unseen.tolist()),
        _world=world,
        _shot=shot,
    )


def check_coverage(
    lidar: Sensor,
    scene: Scene,
    pose: Transform | Trajectory | None,
    frames: range,
    *,
    offset: float = 0.0,
    ignore: Instances = (),
) -> Floats | Trajectory:
    """Check that trajectory and motions cover all pulses of the first and last frame, and return the pose.

    Parameters
    ----------
    lidar, scene, pose
        As in `scan`.
    frames : range
        Numbers of the frames; frame k starts at ``k / rate + offset``.
    offset : float
        Time of frame 0, s.
    ignore : collection of int
        Instances that the sensor does not see.

    Returns
    -------
    ndarray of float64, shape (4, 4), or Trajectory
        The pose; an array is copied, so that it stays the same for all frames.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong type, the sensor or an object has no pose at the time of a pulse, or no object
        is of an instance to ignore.
    """
    if not isinstance(scene, Scene):
        raise ArgumentTypeError("scene", "a Scene", short_repr(scene))
    where = _where(pose)
    check_sensor(scene.atmosphere, lidar)
    world, period = scene._snapshot(), 1.0 / lidar.pattern.rate
    unseen = instances("ignore", ignore)
    if unseen is not None:
        world.native.expect_instances(unseen)
    for frame in sorted({frames[0], frames[-1]}) if frames else ():
        integer("frame", frame, at_least=0, at_most=2**32 - 1)
        pulses, start = pulses_of(lidar.pattern, frame), real("time", frame / lidar.pattern.rate + offset)
        if not len(pulses):
            continue
        if isinstance(where, Trajectory):
            _check_span(where, pulses, start, period)
        if world.movers:
            fired = start + pulses.time
            world.check_motions(fired.min(), fired.max(), until_of(pulses, start, period))
    return where.copy() if isinstance(where, np.ndarray) else where


def _check_span(path: Trajectory, pulses: Pulses, start: float, period: float) -> None:
    """Check that a trajectory covers all pulses of a frame, of which there is at least one."""
    fired = start + pulses.time
    (first, last), until = path.span, _carry_on(path.span[1], pulses, start, period)
    for i in (int(fired.argmin()), int(fired.argmax())):
        if not first <= fired[i] <= max(last, until):
            got = f"one from {first} to {last} s and pulse {i} at {fired[i]} s"
            raise ArgumentValueError("pose", "a trajectory over all pulses", got, _shift_hint(path, fired.max()))


def _shift_hint(path: Trajectory, latest: float) -> str:
    """Return the remedy if a trajectory begins after the latest pulse, as one in Unix time does; else ""."""
    later = path.span[0] > latest
    return "Trajectory.load(…, start=0), or start_s: 0 in a configuration, shifts its times" if later else ""


def _round_on(end: float) -> float:
    """Return the latest time that counts as the end of a trajectory, s.

    The start of a frame, its period, their sum and the end are each rounded by at most half an ulp of the largest.
    """
    return end + 2.0 * math.ulp(end)


def moment_of(deskew: object, rate: float) -> float | None:
    """Return the moment of `deskew`, as in `Scan.point_cloud`: s after the start of the scan, or None for raw points.

    Raises
    ------
    TypeError, ValueError
        If it names no moment.
    """
    if isinstance(deskew, bool | np.bool_):
        return 0.0 if deskew else None
    if isinstance(deskew, str) and deskew in _MOMENTS:
        return _MOMENTS[deskew] / rate
    try:
        return real("deskew", deskew)
    except TypeError:
        expected = "True, False, 'start', 'middle', 'end' or seconds from the start of the scan"
        wrong = ArgumentValueError if isinstance(deskew, str) else ArgumentTypeError
        raise wrong("deskew", expected, short_repr(deskew)) from None


def moment_and_pose(
    scan: Scan,
    frame: Literal["sensor", "world"] = "sensor",
    *,
    deskew: bool | Literal["start", "middle", "end"] | float = False,
) -> tuple[float, Floats]:
    """Return the reference time of a point cloud, and the sensor's pose at that time.

    Parameters
    ----------
    scan : Scan
        The scan.
    frame, deskew
        As given to `Scan.point_cloud`.

    Returns
    -------
    moment : float
        The time to which the points are deskewed, s; the start of the scan if they are raw or in world coordinates.
    pose : ndarray of float64, shape (4, 4)
        Sensor to world at that moment.
    """
    offset = None if frame == "world" else moment_of(deskew, scan.lidar.pattern.rate)
    moment = scan.time + (offset or 0.0)
    if not isinstance(scan.pose, Trajectory):
        return moment, scan.pose
    pose: Floats = scan.pose._native.at(np.array([moment]))[0]
    return moment, pose


def sensor_id(name: str) -> int:
    """Return the id that selects a sensor's noise: the CRC-32 of its name in UTF-8."""
    return zlib.crc32(name.encode())


def _where(pose: Transform | Trajectory | None) -> Floats | Trajectory:
    return pose if isinstance(pose, Trajectory) else validation.optional_pose("pose", pose)


def path_of(pose: Floats | Trajectory, pulses: Pulses, start: float, period: float) -> _native.Path:
    """Return the path of the sensor while it fires a frame."""
    if not isinstance(pose, Trajectory):
        return _native.Path.still(pose)
    end = pose.span[1]
    until = _carry_on(end, pulses, start, period)
    return pose._native.hold(until) if until > end else pose._native


def until_of(pulses: Pulses, start: float, period: float) -> Callable[[float], float]:
    """Return the function from the end of a motion to the time up to which it may be extrapolated for a frame."""
    return partial(_carry_on, pulses=pulses, start=start, period=period)


def _carry_on(last: float, pulses: Pulses, start: float, period: float) -> float:
    """Return the time up to which a trajectory that ends at `last` may be extrapolated for a frame.

    The trajectory need only cover the frame's period. For the rest of a firing cycle that begins within the period, it
    is extrapolated at its final velocities.
    """
    end: float = start + pulses.time.max(initial=-math.inf)
    if end > last:
        late, over = start + pulses.time > last, pulses.time >= period
        if not (late & ~over).any() and np.isin(pulses.column[late], pulses.column[~over]).all():
            return end
    return last


def _arrays(what: Scan | Pulses) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays that have one entry per pulse, by name."""
    values = {field.name: getattr(what, field.name) for field in fields(what) if field.name != "pose"}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def _some(pulses: Pulses, which: npt.NDArray[np.uint64]) -> Pulses:
    """Return some of the pulses."""
    names = ("directions", "origins", "time", "ring", "column")
    return replace(pulses, **{name: getattr(pulses, name)[which] for name in names})


def _indices(name: str, value: npt.ArrayLike, pulses: int) -> npt.NDArray[np.uint64]:
    given = as_array(name, value, "integers of shape (m,)")
    if given.ndim != 1 or (given.dtype.kind not in "iu" and given.size):
        raise ArgumentValueError(name, "integers of shape (m,)", f"{given.dtype} of shape {given.shape}")
    outside = (given < 0) | (given >= pulses)
    if outside.any():
        i = int(np.argmax(outside))
        raise ArgumentValueError(name, f"0 to {pulses - 1}", f"{name}[{i}] = {given[i]}")
    return given.astype(np.uint64)


def _choose(pulses: npt.ArrayLike, count: int) -> npt.NDArray[np.uint64]:
    """Return the indices of some of `count` pulses, given as indices or as a mask."""
    given = as_array("pulses", pulses, "integers of shape (m,)")
    if given.dtype.kind != "b":
        return _indices("pulses", given, count)
    if given.shape != (count,):
        raise ArgumentValueError("pulses", f"a mask of shape ({count},)", f"shape {given.shape}")
    return np.flatnonzero(given).astype(np.uint64)


def fill_value(field: str, dtype: np.dtype[Any]) -> float:
    """Return the value of a field in pixels without a point; see `Scan.image`."""
    if field in Scan._columns:
        return Scan._columns[field].unused
    return np.iinfo(dtype).max if dtype.kind in "iu" else np.nan
