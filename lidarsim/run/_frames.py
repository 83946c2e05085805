"""The frames of a run: what is scanned, by what, from where and when."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import accumulate, chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypedDict, overload

import numpy as np

from lidarsim._base.validation import affine
from lidarsim.errors import ArgumentValueError, ConfigError
from lidarsim.motion.georeference import START, Georeference
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig
from lidarsim.scan.formats import FORMATS
from lidarsim.scan.scan import check_coverage, moment_and_pose
from lidarsim.sensor.gnss import GnssFixes

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.io.scenes import Imported
    from lidarsim.lidar import Lidar
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan
    from lidarsim.sensor.gnss import Gnss
    from lidarsim.sensor.imu import Imu, ImuSamples
    from lidarsim.world.scene import Scene
    from lidarsim.worlds import Ways

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


class _Numbers(Sequence[int]):
    """Numbers of the frames of all legs, of which there may be billions."""

    def __init__(self, frames: Sequence[range]) -> None:
        self._frames = frames
        self._ends = list(accumulate(map(len, frames)))

    def __len__(self) -> int:
        return self._ends[-1]

    @overload
    def __getitem__(self, place: int) -> int: ...

    @overload
    def __getitem__(self, place: slice) -> list[int]: ...

    def __getitem__(self, place: int | slice) -> int | list[int]:
        chosen = range(len(self))[place]
        if isinstance(chosen, range):
            return [self[i] for i in chosen]
        leg = bisect_right(self._ends, chosen)
        return self._frames[leg][chosen - self._ends[leg]]  # counted from the end of the leg

    def __iter__(self) -> Iterator[int]:
        return chain.from_iterable(self._frames)


@dataclass(frozen=True)
class Frames:
    """What a configuration scans; `Run` adds the files that its frames go to.

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
    ways : Ways, optional
        The ways of the street that the scene is.
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
    ways: Ways | None = None

    @property
    def parts(self) -> list[Self]:
        """One run for each leg, or this run if it has none."""
        if not self.legs:
            return [self]
        return [replace(self, pose=leg.pose, frames=leg.frames, legs=()) for leg in self.legs]

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the frames that are scanned, in order."""
        return _Numbers([leg.frames for leg in self.legs]) if self.legs else self.frames

    def only(self, frame: int) -> Self:
        """Return the run of one frame, without legs, at the pose of the frame.

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

    @property
    def period(self) -> float:
        """Time between repetitions of the frames, s: the longest time that any sensor takes for them.

        Offsets of sensors do not count, since they shift all repetitions alike.
        """
        if isinstance(self.sensor, Rig):
            return self.sensor._period(self.frames)
        return len(self.frames) / self.rate

    def time(self, frame: int) -> float:
        """Return the time at which a frame starts, s since the start of frame 0."""
        return frame / self.rate

    def inertial(self) -> dict[str, ImuSamples]:
        """Return the samples of the IMUs, by name, from the start of the first frame to the end of the last.

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
        """Return the fixes of the GNSS receivers, by name, from the start of the first frame to the end of the last.

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
        self.check_coverage()
        body = self.pose if isinstance(self.pose, Trajectory) else Trajectory.from_twist(self.pose)
        (start, end), (first, last) = self.span, body.span
        return body, {"start": max(start, first), "end": min(end, last), "seed": self.seed}

    def body_pose(self, moment: float) -> Floats:
        """Return the pose of the rig's body, or of the sensor without a rig, at a time within the trajectory, s."""
        if not isinstance(self.pose, Trajectory):
            return affine("pose", self.pose)
        pose: Floats = self.pose._native.at(np.array([moment]))[0]
        return pose

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

        Raises
        ------
        ValueError
            At once, if the trajectory does not cover the frames.
        """
        scans = self.scans()
        return (self._measure(number, scans) for number in self.numbers)

    def _measure(self, number: int, scans: Iterator[dict[str, Scan]]) -> RunFrame:
        begin = time.perf_counter()
        found = next(scans)
        clouds = {name: scan.point_cloud(**self.cloud) for name, scan in found.items()}
        seconds = time.perf_counter() - begin
        placed = {name: moment_and_pose(scan, **self.cloud) for name, scan in found.items()}
        moments = {name: moment for name, (moment, _) in placed.items()}
        poses = {name: pose for name, (_, pose) in placed.items()}
        return RunFrame(number, found, clouds, moments, poses, self.cloud["frame"], seconds)

    def clouds(self, frames: Collection[int] | None) -> Iterator[tuple[str, int]]:
        """Yield the sensor and the number of each cloud of a run without legs, of all frames or of some."""
        numbers = self.frames if frames is None else sorted(number for number in frames if number in self.frames)
        return ((name, number) for number in numbers for name in self.lidars)

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
        return insert(
            output, name if isinstance(self.sensor, Rig) else "", numbered if len(self.frames) > 1 or self.legs else ""
        )


def insert(path: Path, *parts: str, suffix: str | None = None) -> Path:
    """Return `path` with the non-empty `parts` inserted before its suffix, which `suffix` replaces, if given."""
    known = (each for each in FORMATS if path.name.lower().endswith(each))  # such as .pcd.bin
    end = len(path.name) - len(max(known, key=len, default=path.suffix))
    stem, own = path.name[:end], path.name[end:]
    return path.with_name("_".join([stem, *filter(None, parts)]) + (own if suffix is None else suffix))
