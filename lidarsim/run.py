"""A configured run: scan all frames and write them to files."""

from __future__ import annotations

import copy
import os
import re
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np

from lidarsim._base.files import atomic_writer, check_folder
from lidarsim._base.validation import affine
from lidarsim.errors import ArgumentValueError, ConfigError, FileFormatError, LidarsimError
from lidarsim.io import las, packets, rosbag
from lidarsim.io._storage import check_folder as check_bag_folder
from lidarsim.io._storage import is_folder
from lidarsim.motion.georeference import START, Georeference
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.scan.pointcloud import check_output
from lidarsim.scan.scan import check_coverage, moment_and_pose
from lidarsim.sensor.gnss import GnssFixes

if TYPE_CHECKING:
    from lidarsim._base.files import PathLike
    from lidarsim._base.validation import Floats
    from lidarsim.io._cuts import Cut
    from lidarsim.io.scenes import Imported
    from lidarsim.lidar import Lidar
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan
    from lidarsim.sensor.gnss import Gnss
    from lidarsim.sensor.imu import Imu, ImuSamples
    from lidarsim.world.scene import Scene

__all__ = ["CloudArguments", "Deskew", "Leg", "Run", "RunFrame", "checked_output"]


Deskew = bool | Literal["start", "middle", "end"] | float
"""The moment to which points are deskewed, as in `Scan.point_cloud`."""


class CloudArguments(TypedDict):
    """Arguments of `Scan.point_cloud`."""

    frame: Literal["sensor", "world"]
    deskew: Deskew


@dataclass(frozen=True)
class RunFrame:
    """The measurements of one frame of a run by sensor name; without a rig, the sensor is named "".

    Attributes
    ----------
    number : int
        Number of the frame.
    scans : dict of str to Scan
        The scans.
    clouds : dict of str to PointCloud
        The points of the scans, in the coordinates `frame`.
    moments : dict of str to float
        The time to which the points are deskewed, or the start of the scan if they are not, s.
    poses : dict of str to ndarray of float64, shape (4, 4)
        Pose of each sensor at its moment, sensor to world.
    frame : {"sensor", "world"}
        Coordinates of the points.
    seconds : float
        Computing time of the scans, s.
    """

    number: int
    scans: dict[str, Scan]
    clouds: dict[str, PointCloud]
    moments: dict[str, float]
    poses: dict[str, Floats]
    frame: Literal["sensor", "world"]
    seconds: float

    def in_world(self) -> dict[str, PointCloud]:
        """Return the points of each sensor in world coordinates."""
        if self.frame == "world":
            return self.clouds
        return {name: cloud.transformed(self.poses[name]) for name, cloud in self.clouds.items()}


@dataclass(frozen=True)
class Leg:
    """A strip of a flight or a station of a survey.

    Attributes
    ----------
    number : int
        Number of the strip or station, from 1.
    pose : ndarray of float64, shape (4, 4), or Trajectory
        Pose of the sensor or of the rig's body, to world: a trajectory for a strip.
    frames : range
        Numbers of its frames.
    """

    number: int
    pose: Floats | Trajectory
    frames: range


@dataclass(frozen=True)
class Run:
    """A configuration, built and ready to scan.

    Attributes
    ----------
    scene : Scene
        The scene to scan.
    sensor : Lidar or Rig
        The sensor or the rig.
    pose : ndarray of float64, shape (4, 4), or Trajectory
        Pose of the sensor or of the rig's body, to world; with `legs`, that of the first.
    seed : int
        Seed of all random numbers.
    frames : range
        Numbers of the frames to scan; with `legs`, from the first of the first leg to the last of the last, of which
        those between the legs are not scanned: `numbers` has the others.
    cloud : dict
        Arguments of `Scan.point_cloud`, which set the coordinates of the points.
    imports : tuple
        What each scene file brought in, for `lidarsim check`.
    crs : int or str, optional
        Coordinate reference system of the world, for LAS and LAZ files in world coordinates; see `PointCloud.save`.
    start : float or datetime
        Moment at which the clock of the run is 0, for the gps_time of LAS and LAZ files; if it is a datetime, also for
        the times of bags and packets.
    origin : tuple of 3 floats, optional
        Geodetic latitude and longitude, rad, and height, m, of the world's origin, for GNSS receivers; see
        `Georeference`.
    legs : tuple of Leg
        The strips of a flight or the stations of a survey, in order of their frames. Default: none; `pose` is that of
        all frames.
    sources : frozenset of Path
        Real paths of the files that the configuration was read from, and of all that these name: `write` replaces none
        of them.
    """

    scene: Scene
    sensor: Lidar | Rig
    pose: Floats | Trajectory
    seed: int
    frames: range
    cloud: CloudArguments
    imports: tuple[Imported, ...] = ()
    crs: int | str | None = None
    start: float | datetime = 0.0
    origin: tuple[float, float, float] | None = None
    legs: tuple[Leg, ...] = ()
    sources: frozenset[Path] = frozenset()

    @property
    def parts(self) -> list[Run]:
        """One run for each leg, or this run if it has none."""
        if not self.legs:
            return [self]
        return [replace(self, pose=leg.pose, frames=leg.frames, legs=()) for leg in self.legs]

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the frames that are scanned, in order."""
        return [number for leg in self.legs for number in leg.frames] if self.legs else self.frames

    def only(self, frame: int) -> Run:
        """Return the run of one frame.

        Parameters
        ----------
        frame : int
            Its number; with `legs`, one of theirs.

        Returns
        -------
        Run
            A run without legs, at the pose of the frame.

        Raises
        ------
        ConfigError
            If the frame is between the legs.
        """
        pose = self.pose
        if self.legs:
            of = next((leg.pose for leg in self.legs if frame in leg.frames), None)
            if of is None:
                raise ConfigError(f"frame: expected one of a strip or a station, got {frame}")
            pose = of
        return replace(self, pose=pose, frames=range(frame, frame + 1), legs=())

    @property
    def lidar(self) -> Lidar:
        """The sensor of a run without a rig.

        Raises
        ------
        ConfigError
            If the run has a rig.
        """
        if isinstance(self.sensor, Rig):
            raise ConfigError(f"rig: expected a run with one sensor, got {self.sensor}")
        return self.sensor

    @property
    def lidars(self) -> dict[str, Lidar]:
        """The sensors by name; without a rig, the one sensor is named ""."""
        if isinstance(self.sensor, Rig):
            return {name: part.lidar for name, part in self.sensor.items()}
        return {"": self.sensor}

    @property
    def imus(self) -> Mapping[str, Imu]:
        """The IMUs of the rig by name."""
        return self.sensor.imus if isinstance(self.sensor, Rig) else {}

    @property
    def receivers(self) -> Mapping[str, Gnss]:
        """The GNSS receivers of the rig by name."""
        return self.sensor.receivers if isinstance(self.sensor, Rig) else {}

    @property
    def georeference(self) -> Georeference | None:
        """Where the world is on the Earth, if that is known."""
        if self.origin is None and self.crs is None:
            return None
        return Georeference(origin=self.origin, crs=self.crs)

    @property
    def clock(self) -> datetime:
        """The moment of time 0 on the clock of bags and packets: `start` if it is a datetime, else that of 2020."""
        return self.start if isinstance(self.start, datetime) else START

    @property
    def rate(self) -> float:
        """Frame rate, Hz."""
        return self.sensor.rate if isinstance(self.sensor, Rig) else self.sensor.pattern.rate

    @property
    def span(self) -> tuple[float, float]:
        """Start of the first frame of any sensor and end of the last, s."""
        if isinstance(self.sensor, Rig):
            return self.sensor.span(len(self.frames), first=self.frames.start)
        return self.time(self.frames.start), self.time(self.frames.stop)

    def time(self, frame: int) -> float:
        """Return the time at which a frame starts.

        Parameters
        ----------
        frame : int
            Number of the frame.

        Returns
        -------
        float
            Time since the start of frame 0, s.
        """
        return frame / self.rate

    def inertial(self) -> dict[str, ImuSamples]:
        """Return the samples of the IMUs from the start of the first frame to the end of the last.

        Returns
        -------
        dict of str to ImuSamples
            The samples by name of the IMU.

        Raises
        ------
        ValueError
            If the trajectory does not cover the frames, or its velocity jumps, as with linear interpolation.
        """
        if not isinstance(self.sensor, Rig) or not self.imus:
            return {}
        body, between = self._moving
        return self.sensor.inertial(body, **between)

    def fixes(self) -> dict[str, GnssFixes]:
        """Return the fixes of the GNSS receivers from the start of the first frame to the end of the last.

        Returns
        -------
        dict of str to GnssFixes
            The fixes by name of the receiver.

        Raises
        ------
        ValueError
            If the run has no georeference, or the trajectory does not cover the frames.
        """
        if not isinstance(self.sensor, Rig) or not self.receivers:
            return {}
        if self.georeference is None:
            name = next(iter(self.receivers))
            raise ArgumentValueError("georeference", f"the origin or crs of the world, for the receiver {name}", "none")
        body, between = self._moving
        return self.sensor.fixes(body, self.georeference, **between)

    def samples(self) -> dict[str, ImuSamples | GnssFixes]:
        """Return the samples of the IMUs and the fixes of the GNSS receivers by name."""
        return {**self.inertial(), **self.fixes()}

    @property
    def _moving(self) -> tuple[Trajectory, dict[str, Any]]:
        """The trajectory of the body, and the arguments of a measurement along it during the frames."""
        body = self.pose if isinstance(self.pose, Trajectory) else Trajectory.from_twist(self.pose)
        (start, end), (first, last) = self.span, body.span
        return body, {"start": max(start, first), "end": min(end, last), "seed": self.seed}

    def body_pose(self, moment: float) -> Floats:
        """Return the pose of the rig's body, or of the sensor without a rig.

        Parameters
        ----------
        moment : float
            Time within the span of the trajectory, s.

        Returns
        -------
        ndarray of float64, shape (4, 4)
            Body to world.
        """
        return affine("pose", self.pose.at(moment) if isinstance(self.pose, Trajectory) else self.pose)

    def check_coverage(self) -> None:
        """Check that trajectory and motions cover the first and last frame of each sensor.

        Raises
        ------
        ValueError
            If they do not; the message states the times.
        """
        for part in self.parts:
            if isinstance(self.sensor, Rig):
                self.sensor.check_coverage(self.scene, part.pose, len(part.frames), first=part.frames.start)
            else:
                check_coverage(self.sensor, self.scene, part.pose, part.frames)

    def scan(self, frame: int | None = None) -> Scan:
        """Scan one frame with the only sensor, at the frame's start time.

        Parameters
        ----------
        frame : int, optional
            Number of the frame. Default: the first of `frames`.

        Returns
        -------
        Scan
            The scan; ``scan.point_cloud(**run.cloud)`` returns its points in the configured coordinates.

        Raises
        ------
        ConfigError
            If the run has a rig.
        """
        frame = self.frames.start if frame is None else frame
        pose = self.only(frame).pose
        return self.lidar.scan(self.scene, pose, time=self.time(frame), frame=frame, seed=self.seed)

    def scans(self) -> Iterator[dict[str, Scan]]:
        """Scan all frames in order, with all sensors.

        Returns
        -------
        iterator of dict of str to Scan
            For each frame, its scans by sensor name, as from `Rig.frames`; without a rig, the sensor is named "".

        Raises
        ------
        ValueError
            At once, if the trajectory does not cover the frames.
        """
        if self.legs:
            self.check_coverage()
            return chain.from_iterable(part.scans() for part in self.parts)
        what, first = (self.scene, self.pose, len(self.frames)), self.frames.start
        if isinstance(self.sensor, Rig):
            return self.sensor.frames(*what, first=first, seed=self.seed)
        return ({"": scan} for scan in self.sensor.frames(*what, first=first, seed=self.seed))

    def measured(self) -> Iterator[RunFrame]:
        """Scan all frames in order, and compute the points in the configured coordinates.

        Returns
        -------
        iterator of RunFrame
            The frames in order.

        Raises
        ------
        ValueError
            At once, if the trajectory does not cover the frames.
        """
        scans = self.scans()
        return (self._measured(number, scans) for number in self.numbers)

    def _measured(self, number: int, scans: Iterator[dict[str, Scan]]) -> RunFrame:
        begin = time.perf_counter()
        found = next(scans)
        clouds = {name: scan.point_cloud(**self.cloud) for name, scan in found.items()}
        seconds = time.perf_counter() - begin
        placed = {name: moment_and_pose(scan, **self.cloud) for name, scan in found.items()}
        moments = {name: moment for name, (moment, _) in placed.items()}
        poses = {name: pose for name, (_, pose) in placed.items()}
        return RunFrame(number, found, clouds, moments, poses, self.cloud["frame"], seconds)

    def bag(
        self, output: PathLike, *, layout: str | None = None, cut: Cut = "pattern", **limits: float | None
    ) -> rosbag.Writer:
        """Return a writer of a ROS 2 bag for scans of this run, with its sensors, its trajectory and its `clock`.

        Parameters
        ----------
        output : path-like
            The file, ``.mcap`` or ``.db3``, or a folder, whose name has no dot.
        layout : str, optional
            Layout of the points, one of `lidarsim.io.rosbag.NAMES`. Default: the layout of each sensor's vendor.
        cut : {"pattern", "driver"} or float
            Where messages begin: with each frame of the pattern, where the driver of the layout cuts, or at an azimuth,
            rad; see `lidarsim.io.rosbag.Writer`.
        **limits : int or float, optional
            `max_size` and `max_duration` of the files in a folder, as in `lidarsim.io.rosbag.Writer`.

        Returns
        -------
        rosbag.Writer
            A context manager.

        Raises
        ------
        FileFormatError, MissingExtraError, TypeError, ValueError
            As in `lidarsim.io.rosbag.Writer`.
        """
        options: dict[str, Any] = {"layout": layout, "cut": cut, **limits}
        sensors = self.sensor if isinstance(self.sensor, Rig) else None
        return rosbag.Writer(output, sensors=sensors, trajectory=self.pose, start=self.clock, **options)

    def pcap(self, output: PathLike, *, variant: str | None = None) -> packets.Writer:
        """Return a writer of the packets that the sensors of this run send, with its `clock`.

        Parameters
        ----------
        output : path-like
            The file, ``.pcap``.
        variant : str, optional
            Variant of the packets, as in `lidarsim.io.packets.Writer`.

        Returns
        -------
        packets.Writer
            A context manager.

        Raises
        ------
        FileFormatError, TypeError, ValueError
            As in `lidarsim.io.packets.Writer`.
        """
        sensors = self.lidars if isinstance(self.sensor, Rig) else self.sensor
        return packets.Writer(output, sensors, start=self.clock, variant=variant)

    def write(
        self,
        output: PathLike,
        *,
        layout: str | None = None,
        cut: Cut = "pattern",
        variant: str | None = None,
        fields: Sequence[str] | None = None,
        float32: bool | None = None,
        max_size: int | None = None,
        max_duration: float | None = None,
        each: Callable[[RunFrame], object] | None = None,
    ) -> list[Path]:
        """Scan all frames, and write point clouds, a ROS 2 bag or packets.

        A bag holds all frames, in one file or in a folder, and so do packets (``.pcap``), next to which are the files
        that decoders need. Both hold what the sensors measure, whatever `cloud` is. Otherwise each point cloud gets its
        own file, numbered if there are several frames, and with the sensor's name if there is a rig. With several
        frames, the poses of each sensor at its moments (OUTPUT_poses.tum) and the start times of its scans
        (OUTPUT_times.txt) are written next to all but bags. The samples of an IMU and the fixes of a GNSS receiver are
        messages of the bag, or a file of their own (OUTPUT_NAME.csv, as `ImuSamples.save` and `GnssFixes.save`).

        With `legs`, the number of the strip or station precedes these in the names, and each gets a bag, or a file
        of packets, of its own. A
        strip is one file in LAS and LAZ, in which its number is the point_source_id. LAS and LAZ files of points in
        world coordinates have the fields of `lidarsim.io.las.flight_fields` if the sensor moves.

        Parameters
        ----------
        output : path-like
            The file; its suffix determines the format. A text that ends in / is the folder of a bag.
        layout : str, optional
            Layout of the points in a bag, as in `bag`.
        cut : {"pattern", "driver"} or float
            Where the messages of a bag begin, as in `bag`.
        variant : str, optional
            Variant of packets, as in `pcap`.
        fields : sequence of str, optional
            Fields of the points to write besides `xyz`, as in `PointCloud.save`.
        float32 : bool, optional
            Write `xyz` as float32, as in `PointCloud.save`.
        max_size, max_duration : int and float, optional
            Bytes, and time in s, after which a new file begins in the folder of a bag, as in
            `lidarsim.io.rosbag.Writer`.
        each : callable, optional
            Called with each `RunFrame` after it has been written.

        Returns
        -------
        list of Path
            The files, in the order in which they were written.

        Raises
        ------
        FileFormatError
            If the suffix is unknown, the format cannot hold a cloud, or a sensor has no packets.
        OSError
            If a file cannot be written.
        LidarsimError
            As in `check_places`.
        ValueError
            If the trajectory does not cover the frames, the points are in the sensor frame and the run has a coordinate
            reference system, or an option is not one of the format: `layout` and `cut` of bags, `variant` of packets,
            `fields` and `float32` of neither.
        """
        output = checked_output(output)
        is_bag = _is_bag(output)
        options: dict[str, Any] = {"layout": layout, "cut": cut, "variant": variant, "fields": fields}
        options |= {"float32": float32, "max_size": max_size, "max_duration": max_duration}
        _check_options(output, **options)
        if _is_packets(output) and self.cloud != _RAW:
            return replace(self, cloud=_RAW).write(output, variant=variant, each=each)
        self.check_places(output)
        if self.legs:
            self.check_coverage()
        written: dict[Path, None] = {}
        tracks: dict[str, list[tuple[float, float, Floats]]] = {}
        parts = [(number, part, place, part.samples()) for number, part, place in self._placed(output)]
        for number, part, place, samples in parts:
            with ExitStack() as stack:
                save = part._saver(place, stack, number, samples, **options)
                if not is_bag:
                    written.update(dict.fromkeys(_save_samples(samples, place)))
                for frame in part.measured():
                    written.update(dict.fromkeys(save(frame)))
                    if not is_bag:
                        for name, scan in frame.scans.items():
                            track = scan.time, frame.moments[name], frame.poses[name]
                            tracks.setdefault(name, []).append(track)
                    if each:
                        each(frame)
        if len(self.frames) > 1:
            for name, track_of_it in tracks.items():
                written.update(dict.fromkeys(_save_track(output, name, track_of_it)))
        return list(written)

    def check_places(self, output: Path, pictures: Path | None = None) -> None:
        """Check, before any work, that each file of the run can be written, in a place of its own.

        Paths that differ only in case are equal on some systems.

        Parameters
        ----------
        output : Path
            Output of `write`, as from `checked_output`.
        pictures : Path, optional
            Pictures of the frames, which the caller writes as `path_of` names them.

        Raises
        ------
        LidarsimError
            If a file would replace another one of the run or one of `sources`, also by way of links.
        OSError
            If the folder of a file does not exist or is not writable.
        """
        taken = self._read
        names = [path.name for path in (*self.sources, *self.files(output, ()))]
        names += [name for path in (output, pictures) if path for name in _links_beside(path)]
        # Frames differ only in their numbers: those that are not in any of these names cannot meet them.
        frames = {int(digits) for name in names for digits in re.findall("[0-9]+", name)}
        frames |= {part.frames.start for part in self.parts}
        written = self.files(output, frames)
        if pictures:
            written += [self.path_of(pictures, *of) for part in self.parts for of in part._clouds(frames)]
        for path in written:
            if is_folder(path):
                check_bag_folder(path)
                taken |= {_place(path): taken[_place(of)] for of in self.sources if _place(path) in _place(of).parents}
            else:
                check_folder(path)
            if got := taken.get(_place(path)):
                raise LidarsimError(f"{path}: expected a file of its own, got {got}")
            taken[_place(path)] = f"the place of {path}"

    def check_unread(self, *paths: Path) -> None:
        """Check that no file that the caller writes is one of `sources`, also by way of links.

        Parameters
        ----------
        *paths : Path
            The files to write.

        Raises
        ------
        LidarsimError
            If a file is.
        """
        for path in paths:
            if got := self._read.get(_place(path)):
                raise LidarsimError(f"{path}: expected a file of its own, got {got}")

    @property
    def _read(self) -> dict[Path, str]:
        """How errors call each of `sources`, by its place."""
        return {_place(path): f"that of {path}, which the run reads" for path in self.sources}

    def files(self, output: Path, frames: Collection[int] | None = None) -> list[Path]:
        """Return the files that `write` makes; in a rig, a sensor may lack a scan in some frames.

        Parameters
        ----------
        output : Path
            As in `write`.
        frames : collection of int, optional
            Numbers of the frames whose point clouds are listed, if each has a file of its own. Default: all.

        Returns
        -------
        list of Path
            The files.
        """
        found: list[Path] = []
        for number, part, place in self._placed(output):
            if _is_bag(output):
                found.append(place)
                continue
            found += [_samples_path(place, name) for name in [*self.imus, *self.receivers]]
            if _is_packets(output):
                found += part.pcap(place).files
            elif number and part._fits_strip(output):
                found += [part._strip_path(place, name) for name in self.lidars]
            else:
                found += [part.path_of(place, *of) for of in part._clouds(frames)]
        if len(self.frames) > 1 and not _is_bag(output):
            found += [path for name in self.lidars for path in _track_paths(output, name)]
        return found

    def _clouds(self, frames: Collection[int] | None) -> Iterator[tuple[str, int]]:
        """Yield the sensor and the number of each cloud of a run without legs, of all frames or of some."""
        numbers = self.frames if frames is None else sorted(number for number in frames if number in self.frames)
        return ((name, number) for number in numbers for name in self.lidars)

    def _placed(self, output: Path) -> Iterator[tuple[int, Run, Path]]:
        """Yield the number of each leg, its run and its output; 0, this run and `output` if there are no legs."""
        for number, part in zip([leg.number for leg in self.legs] or [0], self.parts, strict=True):
            yield number, part, _named(output, str(number)) if number else output

    def path_of(self, output: Path, name: str, number: int | str) -> Path:
        """Return the path of the output of one sensor and frame.

        Parameters
        ----------
        output : Path
            The path given by the user.
        name : str
            Name of the sensor; part of the path if there is a rig.
        number : int or str
            Number of the frame; part of the path if there are several frames or legs.

        Returns
        -------
        Path
            ``scan.pcd`` becomes ``scan_top_0003.pcd``.
        """
        numbered = f"{number:04}" if isinstance(number, int) else number
        return _named(
            output, name if isinstance(self.sensor, Rig) else "", numbered if len(self.frames) > 1 or self.legs else ""
        )

    def _saver(
        self,
        output: Path,
        stack: ExitStack,
        number: int,
        samples: Mapping[str, ImuSamples | GnssFixes],
        *,
        layout: str | None,
        cut: Cut,
        variant: str | None,
        fields: Sequence[str] | None,
        float32: bool | None,
        max_size: int | None,
        max_duration: float | None,
    ) -> Callable[[RunFrame], Iterable[Path]]:
        """Return a function that writes a frame and returns the files; `number` is that of a leg, or 0."""
        if _is_bag(output):
            bag = self.bag(output, layout=layout, cut=cut, max_size=max_size, max_duration=max_duration)
            return self._into_bag(output, stack, samples, bag)
        if _is_packets(output):
            return self._into_packets(output, stack, variant)
        if number and self._fits_strip(output):
            return self._into_strips(output, stack, number, fields, float32)
        return partial(self._save, output, {"fields": fields, "float32": float32})

    def _into_bag(
        self,
        output: Path,
        stack: ExitStack,
        samples: Mapping[str, ImuSamples | GnssFixes],
        writer: rosbag.Writer,
    ) -> Callable[[RunFrame], Iterable[Path]]:
        """Return a function that writes a frame into a bag, raw, as drivers publish scans, whatever `cloud` is."""
        bag = stack.enter_context(writer)
        for values in samples.values():
            if isinstance(values, GnssFixes):
                bag.write_gnss(values)
            else:
                bag.write_imu(values)

        def save(frame: RunFrame) -> Iterable[Path]:
            bag.write(frame.scans if isinstance(self.sensor, Rig) else frame.scans[""])
            return [output]

        return save

    def _into_packets(
        self, output: Path, stack: ExitStack, variant: str | None
    ) -> Callable[[RunFrame], Iterable[Path]]:
        """Return a function that writes the packets of a frame."""
        writer = stack.enter_context(self.pcap(output, variant=variant))

        def save(frame: RunFrame) -> Iterable[Path]:
            writer.write(frame.scans)
            return writer.files

        return save

    def _into_strips(
        self, output: Path, stack: ExitStack, number: int, fields: Sequence[str] | None, float32: bool | None
    ) -> Callable[[RunFrame], Iterable[Path]]:
        """Return a function that appends a frame to the LAS files of a strip, one for each sensor."""
        if self.cloud["frame"] != "world":
            raise FileFormatError(f"{output}: expected points in the world, with cloud.frame: world, for a strip")
        if float32:
            raise ArgumentValueError("float32", "a format with float32 coordinates", f"the strip {output}")
        paths = {name: self._strip_path(output, name) for name in self.lidars}
        writers = {
            name: stack.enter_context(las.Writer(path, crs=self.crs, fields=fields)) for name, path in paths.items()
        }

        def save(frame: RunFrame) -> Iterable[Path]:
            for name, cloud in frame.clouds.items():
                writers[name].write(self._of_run(frame.scans[name], cloud, number), start=self.start)
            return paths.values()

        return save

    def _fits_strip(self, output: Path) -> bool:
        """Return whether a leg with this pose is one file of this format."""
        return output.suffix.lower() in las.SUFFIXES and isinstance(self.pose, Trajectory)

    def _strip_path(self, output: Path, name: str) -> Path:
        return _named(output, name if isinstance(self.sensor, Rig) else "")

    def _of_run(self, scan: Scan, cloud: PointCloud, number: int = 0) -> PointCloud:
        """Return a cloud for LAS: times since the start of the run, and in the world the fields of the flight."""
        of_run = copy.copy(cloud)
        of_run.time = cloud.time + scan.time
        if self.cloud["frame"] == "world" and isinstance(scan.pose, Trajectory):
            for name, values in las.flight_fields(scan, point_source_id=number).items():
                setattr(of_run, name, values)
        return of_run

    def _save(self, output: Path, options: Mapping[str, Any], frame: RunFrame) -> Iterator[Path]:
        in_world = self.cloud["frame"] == "world"
        for name, cloud in frame.clouds.items():
            path = self.path_of(output, name, frame.number)
            pose = None if in_world else frame.poses[name]
            if output.suffix.lower() in las.SUFFIXES:
                of_run = self._of_run(frame.scans[name], cloud)
                of_run.save(path, pose=pose, crs=self.crs, start=self.start, **options)
            else:
                cloud.save(path, pose=pose, **options)
            yield path


_RAW: CloudArguments = {"frame": "sensor", "deskew": False}


def checked_output(output: PathLike) -> Path:
    """Return the path of the output of a run, after checking, before any work, that it can be written.

    Parameters
    ----------
    output : path-like
        A file of a known suffix, or, as a text that ends in /, the folder of a bag.

    Returns
    -------
    Path
        The path; that of a folder has no suffix.

    Raises
    ------
    FileFormatError
        If the suffix is unknown, or the name of a folder has one.
    OSError
        If the folder does not exist or is not writable, or has files that lidarsim did not write.
    """
    if os.fspath(output).endswith(("/", os.sep)):
        check_bag_folder(output)
    else:
        check_output(output, packets.SUFFIXES)
    return Path(output)


def _is_bag(output: Path) -> bool:
    """Return whether an output is a bag: a file or a folder."""
    return output.suffix.lower() in rosbag.SUFFIXES or is_folder(output)


def _is_packets(output: Path) -> bool:
    return output.suffix.lower() in packets.SUFFIXES


def _check_options(
    output: Path,
    *,
    layout: str | None,
    cut: Cut,
    variant: str | None,
    fields: Sequence[str] | None,
    float32: bool | None,
    max_size: int | None,
    max_duration: float | None,
) -> None:
    """Check that the format of `output` has the given options."""
    bag = f"a bag ({', '.join(rosbag.SUFFIXES)})"
    pcap = f"packets ({', '.join(packets.SUFFIXES)})"
    is_bag, is_packets = _is_bag(output), _is_packets(output)
    got = f"the bag {output}" if is_bag else f"the packets {output}" if is_packets else str(output)
    cloud, folder = "a point cloud file", "the folder of a bag, which ends in /,"
    for argument, given, expected, fits in (
        ("layout", layout is not None, bag, is_bag),
        ("cut", cut != "pattern", bag, is_bag),
        ("max_size", max_size is not None, folder, is_folder(output)),
        ("max_duration", max_duration is not None, folder, is_folder(output)),
        ("variant", variant is not None, pcap, is_packets),
        ("fields", fields is not None, cloud, not (is_bag or is_packets)),
        ("float32", float32 is not None, cloud, not (is_bag or is_packets)),
    ):
        if given and not fits:
            raise ArgumentValueError(argument, f"{expected} as output", got)


def _place(path: Path) -> Path:
    """Return what is equal for paths of the same file, also where case does not matter."""
    return Path(os.path.realpath(path).casefold())


def _links_beside(path: Path) -> list[str]:
    """Return the names of the links in the folder of a path; none if there is no such folder."""
    with suppress(OSError), os.scandir(path.parent) as entries:
        return [entry.name for entry in entries if entry.is_symlink()]
    return []


def _save_track(output: Path, name: str, track: list[tuple[float, float, Floats]]) -> Iterator[Path]:
    """Write the poses of a sensor and the start times of its scans; yield the paths."""
    starts, moments, matrices = zip(*track, strict=True)
    poses, times = _track_paths(output, name)
    Trajectory(moments, np.array(matrices)).save(poses)
    yield poses
    with atomic_writer(times) as file:
        file.writelines(f"{start!r}\n".encode("ascii") for start in starts)
    yield times


def _save_samples(samples: Mapping[str, ImuSamples | GnssFixes], output: Path) -> Iterator[Path]:
    """Write the samples of IMUs and receivers into files next to `output`; yield the paths."""
    for name, values in samples.items():
        values.save(_samples_path(output, name))
        yield _samples_path(output, name)


def _samples_path(output: Path, name: str) -> Path:
    """Return the path of the samples of an IMU or a receiver."""
    return _named(output, name).with_suffix(".csv")


def _track_paths(output: Path, name: str) -> tuple[Path, Path]:
    """Return the paths of the poses and times of a sensor."""
    return _named(output, name, "poses").with_suffix(".tum"), _named(output, name, "times").with_suffix(".txt")


def _named(path: Path, *parts: str) -> Path:
    """Return `path` with the non-empty `parts` inserted before its suffix."""
    return path.with_stem("_".join([path.stem, *filter(None, parts)]))
