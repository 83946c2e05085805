"""Several sensors on one body."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterator, Mapping
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from lidarsim._base import validation
from lidarsim._base.names import AnsweringABC, explain_arguments
from lidarsim._base.pickling import Pickled
from lidarsim._base.validation import Floats, Instances, Transform, frames, integer, items, real, short
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.lidar import Lidar
from lidarsim.motion.trajectory import Trajectory, sensor_pose
from lidarsim.scan.scan import check_coverage, sensor_id
from lidarsim.sensor.gnss import Gnss, GnssFixes
from lidarsim.sensor.imu import Imu, ImuSamples

if TYPE_CHECKING:
    from lidarsim.motion.georeference import Georeference
    from lidarsim.scan.scan import Scan
    from lidarsim.world.scene import Scene

    Part: TypeAlias = tuple[Lidar | Imu | Gnss, Transform | None] | tuple[Lidar, Transform | None, float]


class RigSensor(NamedTuple):
    """A sensor of a rig.

    Parameters
    ----------
    lidar : Lidar
        The sensor, renamed to its name in the rig.
    mount : ndarray of float64, shape (4, 4)
        Its pose on the body (extrinsics), sensor to body.
    offset : float
        Start of its frame k minus ``k / pattern.rate``, s.
    """

    lidar: Lidar
    mount: Floats
    offset: float = 0.0


class Rig(Pickled, Mapping[str, RigSensor], metaclass=AnsweringABC):
    """Named sensors on one body: a mapping from the names of the lidars to `RigSensor`.

    IMUs and GNSS receivers of the rig are in `imus` and `receivers`. The name in the rig replaces that of the sensor,
    from which the noise derives: two sensors of one model draw different noise, and ``rig["top"].lidar`` on its own
    draws the same noise as in the rig.

    Parameters
    ----------
    sensors : mapping of str to tuple
        For each name, a tuple of a `Lidar`, an `Imu` or a `Gnss`, its mount and, optionally for a `Lidar`, its offset.
        The mount is the sensor's pose on the body (sensor to body): a RigidTransform, an array of shape (4, 4), or None
        for the identity; for an IMU or a receiver, None keeps its own mount. The offset shifts the start of the frames
        of a lidar, s.

    Raises
    ------
    TypeError, ValueError
        If there are no lidars, a name is empty or cannot be encoded in UTF-8, two names have the same CRC-32 and so
        the same noise, or a sensor, mount or offset is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> left, right = np.eye(4), np.eye(4)
    >>> left[1, 3], right[1, 3] = 0.5, -0.5
    >>> lidar = ls.Lidar(ls.patterns.Grid([0.0], [0.0], rate=10.0))
    >>> rig = ls.Rig({"left": (lidar, left), "right": (lidar, right, 0.05)})
    >>> rig
    Rig(left, right at 10 Hz)
    >>> scene = ls.Scene()
    >>> wall = scene.add(ls.Plane((1, 0, 0), 10.0))
    >>> drive = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0))
    >>> for scans in rig.frames(scene, drive, 2):
    ...     print({name: float(scan.range[0, 0]) for name, scan in scans.items()})
    {'left': 10.0, 'right': 9.5}
    {'left': 9.0, 'right': 8.5}

    With an IMU:

    >>> rig = ls.Rig({"left": (lidar, left), "imu": (ls.Imu(200.0), right)})
    >>> rig.inertial(drive, end=0.1)["imu"].specific_force[0]
    array([0.     , 0.     , 9.80665])
    """

    @explain_arguments
    def __init__(self, sensors: Mapping[str, Part]) -> None:
        if not isinstance(sensors, Mapping):
            raise ArgumentTypeError("sensors", "a mapping from names to sensors", type(sensors).__name__)
        if not sensors:
            raise ArgumentValueError("sensors", "at least one", "none")
        members = {name: _member(name, parts) for name, parts in sensors.items()}
        self._sensors = {name: member for name, member in members.items() if isinstance(member, RigSensor)}
        self._imus = {name: member for name, member in members.items() if isinstance(member, Imu)}
        self._receivers = {name: member for name, member in members.items() if isinstance(member, Gnss)}
        if not self._sensors:
            raise ArgumentValueError(
                "sensors", "at least one Lidar", ", ".join(type(m).__name__ for m in members.values())
            )
        names: dict[int, str] = {}
        for name in members:
            other = names.setdefault(sensor_id(name), name)
            if other != name:
                raise ArgumentValueError(
                    "sensors", "names that do not collide (CRC-32)", f"{other!r} and {name!r}", "rename one"
                )

    @property
    def imus(self) -> Mapping[str, Imu]:
        """The IMUs by name, with their mounts."""
        return MappingProxyType(self._imus)

    @property
    def receivers(self) -> Mapping[str, Gnss]:
        """The GNSS receivers by name, with their mounts."""
        return MappingProxyType(self._receivers)

    @property
    def rate(self) -> float:
        """Frame rate of the rig, Hz: the rate of its fastest lidar."""
        return max(sensor.lidar.pattern.rate for sensor in self._sensors.values())

    def scan(
        self,
        scene: Scene,
        pose: Transform | Trajectory | None = None,
        *,
        time: float = 0.0,
        frame: int = 0,
        seed: int = 0,
        ignore: Instances = (),
    ) -> dict[str, Scan]:
        """Scan a scene for one frame with each sensor.

        The scan of a sensor equals ``lidar.scan(scene, pose @ mount, time=time + offset, frame=frame)``. `frames`
        scans a sequence of frames, in which slower sensors take part less often.

        Parameters
        ----------
        scene : Scene
            The scene to scan.
        pose : RigidTransform, array_like of shape (4, 4) or Trajectory, optional
            Body to world. Default: the identity.
        time : float
            Start of the frame, s, without the offsets of the sensors.
        frame : int
            Number of the frame, 0 to 2³² − 1.
        seed : int
            Seed of the noise, 0 to 2⁶⁴ − 1.
        ignore : collection of int
            Instances that no sensor sees, such as the body of the rig.

        Returns
        -------
        dict of str to Scan
            The scans by sensor name, in the order of the rig.

        Raises
        ------
        TypeError, ValueError
            As for `Lidar.scan`.
        """
        body = pose if isinstance(pose, Trajectory) else validation.optional_pose("pose", pose)
        start, unseen = real("time", time), items("ignore", ignore, "instance numbers")
        return {
            name: lidar.scan(
                scene, sensor_pose(body, mount), time=start + offset, frame=frame, seed=seed, ignore=unseen
            )
            for name, (lidar, mount, offset) in self.items()
        }

    def frames(
        self,
        scene: Scene,
        pose: Transform | Trajectory | None,
        count: int,
        *,
        first: int = 0,
        seed: int = 0,
        ignore: Instances = (),
    ) -> Iterator[dict[str, Scan]]:
        """Scan a scene frame by frame with all sensors.

        Frame j of the rig lasts from ``j / rate`` to ``(j + 1) / rate``. It contains frame k of a sensor if that frame,
        without its offset, begins in this interval: ``j / rate <= k / pattern.rate < (j + 1) / rate``. If all sensors
        have the same rate, each frame contains all of them, with k = j. A slower sensor is missing from some frames,
        but each of its frames occurs exactly once. A sensor's frame k starts at ``k / pattern.rate + offset``, s, and
        equals ``lidar.scan(scene, pose @ mount, time=…, frame=k)``.

        Frames are scanned lazily: each sees the scene as it is when the frame is requested.

        Parameters
        ----------
        scene : Scene
            The scene to scan.
        pose : RigidTransform, array_like of shape (4, 4), Trajectory or None
            Body to world; None is the identity. With a trajectory, each pulse is fired from its sensor's pose at that
            time.
        count : int
            Number of frames of the rig, >= 0.
        first : int
            Number of the first frame, >= 0.
        seed : int
            Seed of the noise.
        ignore : collection of int
            Instances that no sensor sees, such as the body of the rig.

        Returns
        -------
        iterator of dict of str to Scan
            For each frame, its scans by sensor name, in the order of the rig.

        Raises
        ------
        TypeError, ValueError
            At once, if an argument has the wrong type or shape or is out of its range, if the trajectory does not cover
            the first and the last frame of each sensor, or if no object is of an instance to ignore.
        """
        wanted = frames(first, count)
        seed = integer("seed", seed, at_least=0, at_most=2**64 - 1)
        unseen = items("ignore", ignore, "instance numbers")
        poses = self.check_coverage(scene, pose, count, first=first, ignore=unseen)

        def scans(frame: int) -> Iterator[tuple[str, Scan]]:
            for name, (lidar, _, offset) in self.items():
                for k in self._numbers(self[name], frame, frame + 1):
                    time = k / lidar.pattern.rate + offset
                    yield name, lidar.scan(scene, poses[name], time=time, frame=k, seed=seed, ignore=unseen)

        return (dict(scans(frame)) for frame in wanted)

    def check_coverage(
        self,
        scene: Scene,
        pose: Transform | Trajectory | None,
        count: int,
        *,
        first: int = 0,
        ignore: Instances = (),
    ) -> dict[str, Floats | Trajectory]:
        """Check that trajectory and motions cover the first and last frame of each sensor; return the sensors' poses.

        Parameters
        ----------
        scene : Scene
            The scene to scan.
        pose : RigidTransform, array_like of shape (4, 4), Trajectory or None
            Body to world; None is the identity.
        count : int
            Number of frames of the rig, >= 0.
        first : int
            Number of the first frame, >= 0.
        ignore : collection of int
            Instances that no sensor sees.

        Returns
        -------
        dict of str to ndarray of float64, shape (4, 4), or Trajectory
            Pose of each sensor, sensor to world.

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong type or shape or is out of its range, if the body or an object has no pose at
            the time of a pulse, or if no object is of an instance to ignore.
        """
        wanted = frames(first, count)
        body = pose if isinstance(pose, Trajectory) else validation.optional_pose("pose", pose)
        return {
            name: check_coverage(
                sensor.lidar,
                scene,
                sensor_pose(body, sensor.mount),
                self._numbers(sensor, wanted.start, wanted.stop),
                offset=sensor.offset,
                ignore=ignore,
            )
            for name, sensor in self.items()
        }

    def inertial(
        self, trajectory: Trajectory, *, start: float | None = None, end: float | None = None, seed: int = 0
    ) -> dict[str, ImuSamples]:
        """Return the samples of all IMUs along a trajectory.

        Parameters
        ----------
        trajectory : Trajectory
            The body's pose, body to world, as a spline or a constant twist.
        start, end : float, optional
            Time of the first sample and of the last sample at the latest, s; see `Imu.measure`.
        seed : int
            Seed of the errors.

        Returns
        -------
        dict of str to ImuSamples
            The samples by name of the IMU.

        Raises
        ------
        TypeError, ValueError
            As for `Imu.measure`.
        """
        return {name: imu.measure(trajectory, start=start, end=end, seed=seed) for name, imu in self._imus.items()}

    def fixes(
        self,
        trajectory: Trajectory,
        georeference: Georeference,
        *,
        start: float | None = None,
        end: float | None = None,
        seed: int = 0,
    ) -> dict[str, GnssFixes]:
        """Return the fixes of all GNSS receivers along a trajectory.

        Parameters
        ----------
        trajectory : Trajectory
            The body's pose, body to world.
        georeference : Georeference
            Where the world is on the Earth.
        start, end : float, optional
            Time of the first fix and of the last fix at the latest, s; see `Gnss.measure`.
        seed : int
            Seed of the errors.

        Returns
        -------
        dict of str to GnssFixes
            The fixes by name of the receiver.

        Raises
        ------
        TypeError, ValueError
            As for `Gnss.measure`.
        """
        between: dict[str, Any] = {"start": start, "end": end, "seed": seed}
        return {name: gnss.measure(trajectory, georeference, **between) for name, gnss in self._receivers.items()}

    def span(self, count: int, *, first: int = 0) -> tuple[float, float]:
        """Return the time interval that `frames` covers.

        Parameters
        ----------
        count : int
            Number of frames of the rig, >= 1.
        first : int
            Number of the first frame, >= 0.

        Returns
        -------
        start, end : float
            Start of the first frame of any sensor and end of the last, s.

        Raises
        ------
        TypeError, ValueError
            If `count` is not an integer >= 1, or `first` is not an integer >= 0.
        """
        wanted = frames(first, count, at_least=1)
        numbers = [(s.offset, s.lidar.pattern.rate, self._numbers(s, wanted.start, wanted.stop)) for s in self.values()]
        ends = [(k.start / rate + offset, k.stop / rate + offset) for offset, rate, k in numbers if k]
        return min(start for start, _ in ends), max(end for _, end in ends)

    def _period(self, frames: range) -> float:
        """Return the longest time that any sensor takes for frames, s; offsets do not count."""
        return max(len(self._numbers(s, frames.start, frames.stop)) / s.lidar.pattern.rate for s in self.values())

    def _numbers(self, sensor: RigSensor, start: int, stop: int) -> range:
        """Return the exact numbers k of a sensor's frames that begin in frames start to stop - 1 of the rig."""
        rate = Fraction(sensor.lidar.pattern.rate) / Fraction(self.rate)
        return range(*(-(-frame * rate.numerator // rate.denominator) for frame in (start, stop)))

    def __getitem__(self, name: str) -> RigSensor:
        """Return the lidar with this name."""
        return self._sensors[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the lidars."""
        return iter(self._sensors)

    def __len__(self) -> int:
        """Return the number of lidars."""
        return len(self._sensors)

    def _contents(self) -> dict[str, Any]:
        return {"_sensors": self._sensors, "_imus": self._imus, "_receivers": self._receivers}

    @classmethod
    def _upgrade(cls, contents: dict[str, Any]) -> dict[str, Any]:
        return {"_imus": {}, "_receivers": {}, **contents}

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __repr__(self) -> str:
        """Return the names and the rate."""
        names = ", ".join([*self, *self._imus, *self._receivers])
        return f"Rig({textwrap.shorten(names, 200, placeholder=' …')} at {self.rate:g} Hz)"


def _member(name: str, parts: Part) -> RigSensor | Imu | Gnss:
    if not isinstance(name, str):
        raise ArgumentTypeError("sensors", "strings as names", repr(name))
    if not name:
        raise ArgumentValueError("sensors", "names", "an empty one")
    if not name.isascii() and any("\ud800" <= character <= "\udfff" for character in name):
        raise ArgumentValueError("sensors", "names that UTF-8 can hold", short(ascii(name)))
    what = f"sensors[{name!r}]"
    if not isinstance(parts, tuple) or len(parts) not in (2, 3):
        got = f"a tuple of {len(parts)}" if isinstance(parts, tuple) else type(parts).__name__
        raise ArgumentTypeError(what, "(lidar, mount) or (lidar, mount, offset)", got)
    lidar, mount, offset = (*parts, 0.0)[:3]
    if isinstance(lidar, Imu | Gnss):
        kind = type(lidar).__name__
        if len(parts) == 3:
            raise ArgumentValueError(f"{what}, offset", f"none beside {kind}", repr(offset))
        own = lidar.mount if mount is None else validation.optional_pose(f"{what}, mount", mount)
        if mount is not None and (lidar.mount != np.eye(4)).any():
            raise ArgumentValueError(f"{what}, mount", f"None, as the {kind} has a mount", "another mount")
        return dataclasses.replace(lidar, name=name, mount=own)
    if not isinstance(lidar, Lidar):
        raise ArgumentTypeError(what, "a Lidar, an Imu or a Gnss first", type(lidar).__name__)
    matrix = validation.optional_pose(f"{what}, mount", mount)
    matrix.setflags(write=False)
    return RigSensor(dataclasses.replace(lidar, name=name), matrix, real(f"{what}, offset", offset))
