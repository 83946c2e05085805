"""ROS 2 bags (``.mcap``, ``.db3``): point clouds as the drivers of real sensors publish them; ROS is not needed.

One file is a complete bag. A path that ends in / becomes a folder with one or several files and ``metadata.yaml``, as
ROS's recorder makes it. Besides the clouds, a bag holds ``/clock``, the extrinsics of the sensors (``/tf_static``) and,
if the body's trajectory is known, its true pose and velocity (``/tf``, ``/odom``). Samples of IMUs are
``sensor_msgs/msg/Imu`` and fixes of GNSS receivers ``sensor_msgs/msg/NavSatFix``.

Each cloud is written in one of these layouts, chosen by the sensor's model or by the caller:

===========  ========================================================================================================
layout       fields with their NumPy types
===========  ========================================================================================================
velodyne     x y z intensity f4, ring u2, time f4 (s since the stamp); also for all other vendors
ouster       x y z intensity f4, t u4 (ns since the stamp), reflectivity ring ambient u2, range u4 (mm)
hesai        x y z intensity f4, ring u2, timestamp f8 (s, absolute); RoboSense's driver uses the same
autoware     x y z f4, intensity return_type u1, channel u2, azimuth elevation distance f4, time_stamp u4 (ns)
livox        offset_time u4 (ns), x y z f4, reflectivity tag line u1: ``livox_ros_driver2/msg/CustomMsg``
livox_cloud  x y z intensity f4, tag line u1, timestamp f8 (ns, absolute): the driver's PointCloud2 (xfer_format 0)
laserscan    ranges intensities f4 of a 2D lidar: ``sensor_msgs/msg/LaserScan``, as `Scan.laser_scan` has it
===========  ========================================================================================================

Clouds are dense, without NaN, in firing order; each point is in the frame of the sensor at its own firing. The stamp is
the start of the message, and the recording time is that of its last point. A message is a frame of the pattern, or what
a driver publishes: see `cut` of `Writer`. Intensity and reflectivity are the vendor's
byte: 0 to 100 (Livox: 150) for the reflectivity of a diffuse target, in percent, and up to 255 for retro-reflectors.
Range counts from the vendor's zero. Photon counts and ambient light are not modelled: Ouster's intensity equals its
reflectivity, and ambient is 0. Fields that a layout lacks are lost; fields that the cloud lacks are 0.

A LaserScan keeps lidarsim's intensity. Its stamp is the time of its first beam, which a sensor that turns clockwise
fires last: its ``time_increment`` is negative. When it is read, only its beams with a return become points.

Bags are read as the recorder makes them, also with each file (``.mcap.zstd``, ``.db3.zstd``) or each message compressed
by Zstandard. A cloud that cannot be used, such as one without x, y and z, is left out with a warning.

When a bag is read, `time` is in s since the stamp, `ring` is the layout's ring, channel or line, and a `range` in mm
is converted to m; all else stays as in the message, including intensity in the vendor's units. Drivers disagree on the
unit and the zero of point times: lidarsim infers them from the type and size of the numbers and from the stamp, and
refuses a cloud whose times fit none; see `lidarsim.io._times`.

Layouts: https://github.com/ros-drivers/velodyne, https://github.com/ouster-lidar/ouster-ros,
https://github.com/HesaiTechnology/HesaiLidar_ROS_2.0, https://github.com/autowarefoundation/autoware_core
(autoware_point_types), https://github.com/Livox-SDK/livox_ros_driver2.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import re
import shutil
import struct
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from datetime import datetime
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from lidarsim._base import validation
from lidarsim._base.extras import import_extra
from lidarsim._base.files import (
    FileWriter,
    PathLike,
    Place,
    check_name,
    check_regular,
    check_suffix,
    link,
    parse_each,
    parsing,
    redact,
)
from lidarsim._base.shown import plain
from lidarsim._base.validation import Floats, Transform
from lidarsim._base.vectors import transforms
from lidarsim.errors import ArgumentTypeError, ArgumentValueError, FileFormatError, MissingExtraError
from lidarsim.io import _cuts, _mcap, _storage
from lidarsim.io._cuts import Cut
from lidarsim.io._drivers import LAYOUTS, layout_of, to_cloud, to_layout
from lidarsim.io._storage import check_folder, is_folder, lost_writes
from lidarsim.motion.georeference import START, unix_time
from lidarsim.motion.trajectory import Trajectory
from lidarsim.rig import Rig, RigSensor
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.scan.scan import Scan
from lidarsim.sensor.gnss import Gnss, GnssFixes
from lidarsim.sensor.imu import Imu, ImuSamples
from lidarsim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

__all__ = ["LAYOUTS", "NAMES", "SUFFIXES", "Message", "PointCloud2", "Writer", "is_bag", "point_cloud2", "read",
    "static_mounts"]  # fmt: skip

SIGNATURES = {".mcap": _mcap.MAGIC, ".db3": b"SQLite format 3\0"}
SUFFIXES = (*SIGNATURES,)
ROS_1 = b"#ROS"
ROS_1_HINT = "bags of ROS 1 are not read; convert it: rosbags-convert --src FILE.bag --dst FOLDER"
NAME = 100
"""Most characters of the name of a topic in a message."""
OLDEST = 0, 11
"""Oldest supported version of rosbags."""

_LIMIT = 2**31  # of seconds in builtin_interfaces/msg/Time
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}  # in sensor_msgs/msg/PointField
_CLOUD, _CUSTOM = "sensor_msgs/msg/PointCloud2", "livox_ros_driver2/msg/CustomMsg"
_LASER, _IMU, _FIX = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
_STATUS_FIX, _SERVICE_GPS = 0, 1  # in sensor_msgs/msg/NavSatStatus
_COVARIANCE_UNKNOWN, _COVARIANCE_DIAGONAL_KNOWN = 0, 2  # in sensor_msgs/msg/NavSatFix
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_LASER_LAYOUT = "laserscan"
NAMES = *LAYOUTS, _LASER_LAYOUT
"""Names of all layouts; `LAYOUTS` are those of point clouds."""
_CUSTOM_DEFINITIONS = {
    "livox_ros_driver2/msg/CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
    "uint8 reflectivity\nuint8 tag\nuint8 line\n",
    _CUSTOM: "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "CustomPoint[] points\n",
}


class Writer(FileWriter):
    """Write scans into a ROS 2 bag, one by one.

    A context manager: the file or folder appears under its name when the block ends without an error.

    Parameters
    ----------
    path : path-like
        The file: ``.mcap``, or ``.db3`` for the older storage, SQLite. Or a folder, with a name that has no dot:
        ``drive`` gets ``drive_0.mcap`` and ``metadata.yaml``. It may exist only if it is empty, or if it is a bag that
        lidarsim wrote, which is replaced.
    sensors : mapping of str to pose, or to an object with a pose as `mount`, optional
        Name and mount of each sensor; a `Rig` with all of its sensors. The name is also the frame_id, and the topic is
        ``/<name>/points``, ``/<name>/scan`` for a LaserScan, ``/<name>/data_raw`` for an `Imu` or ``/<name>/fix`` for a
        `Gnss`; the mount maps sensor to body, as a RigidTransform or (4, 4) array_like. Default: one "lidar" at the
        body's origin.
    trajectory : Trajectory, RigidTransform or array_like of shape (4, 4), optional
        The body's pose, body to world. Without it there is no ``/tf`` and no ``/odom``.
    layout : str or mapping of str to str, optional
        One of `NAMES` for all sensors, or by the sensor's name; "laserscan" for 2D lidars. Default: by the
        vendor in the model of the `Lidar` (ouster, hesai, robosense or livox, as in the presets), and velodyne for all
        others.
    start : float or datetime
        Moment at time 0 of the scans, before 2038: s since 1970, as ROS counts them, or a datetime with its time zone.
        Default: the start of 2020.
    rate : float
        Rate of ``/tf``, ``/odom`` and ``/clock``, Hz.
    cut : {"pattern", "driver"} or float
        Where the messages of a sensor that spins all around begin. "pattern": each frame of its pattern is a message.
        "driver": a message begins where the driver of the layout begins it, when the head passes azimuth 0 (ouster: pi,
        behind the sensor; livox: frames stay whole). A number: when the head passes this azimuth, rad, in the sensor
        frame. The first and the last message of consecutive frames are then parts of a turn. Frames of other patterns,
        and of less than a full turn, stay whole.
    world, body : str
        frame_id of the world and of the body.
    max_size : int, optional
        Begin a new file in the folder once the messages of a file have this many bytes. Default: never.
    max_duration : float, optional
        Begin a new file in the folder this long after the first message of a file, s. Default: never.

    Attributes
    ----------
    metadata : dict
        What ``metadata.yaml`` says of the first file, once the bag is complete.

    Raises
    ------
    FileFormatError
        If the suffix is not one of these.
    MissingExtraError
        If rosbags is not installed.
    TypeError, ValueError
        If an argument is of the wrong type or out of its range.

    Examples
    --------
    >>> import tempfile
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> _ = scene.add(ls.Plane((0, 0, 1), -1.8))
    >>> lidar = ls.Lidar.preset("velodyne-vlp16")
    >>> drive = ls.Trajectory.from_twist(np.eye(4), linear=(10, 0, 0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Writer(f"{folder}/drive.mcap", trajectory=drive) as bag:
    ...         for frame in range(3):
    ...             bag.write(lidar.scan(scene, drive, time=frame / 10, frame=frame))
    ...     for message in read(f"{folder}/drive.mcap"):
    ...         print(message.topic, message.stamp, *message.cloud.fields)
    /lidar/points 1577836800000000000 xyz intensity time ring
    /lidar/points 1577836800100000000 xyz intensity time ring
    /lidar/points 1577836800200000000 xyz intensity time ring
    """

    def __init__(
        self,
        path: PathLike,
        *,
        sensors: Mapping[str, Transform | RigSensor | Imu | Gnss] | None = None,
        trajectory: Trajectory | Transform | None = None,
        layout: str | Mapping[str, str] | None = None,
        start: float | datetime = START,
        rate: float = 100.0,
        cut: Cut = "pattern",
        world: str = "map",
        body: str = "base_link",
        max_size: int | None = None,
        max_duration: float | None = None,
    ) -> None:
        self._limits = _limits(path, max_size, max_duration)
        super().__init__(path)
        self._suffix = "" if is_folder(path) else check_suffix(path, SUFFIXES)
        given: Mapping[str, Any] = {"lidar": np.eye(4)} if sensors is None else sensors
        if isinstance(given, Rig):
            given = {**given, **given.imus, **given.receivers}
        _check_type("sensors", given, Mapping, "mounts by name, or a Rig")
        self._mounts = {
            _name("sensors", name): validation.pose(f"sensors[{name!r}]", getattr(mount, "mount", mount))
            for name, mount in given.items()
        }
        self._layouts = _layouts(layout, self._mounts)
        if trajectory is None or isinstance(trajectory, Trajectory):
            self._trajectory = trajectory
        else:
            self._trajectory = Trajectory.from_twist(validation.pose("trajectory", trajectory))
        self._start = unix_time(start, limit=_LIMIT)
        self._rate = validation.real("rate", rate, above=0.0)
        self._cut = _cuts.check_cut(cut)
        self._world, self._body = _name("world", world), _name("body", body)
        for name in self._mounts.keys() & {self._world, self._body}:
            raise ArgumentValueError("sensors", "names of frames other than those of world and body", repr(name))
        self._ros = _typestore()
        self.metadata: dict[str, Any] = {}
        self._files: Any = None
        self._begun: dict[str, _Open] = {}
        self._starts: dict[str, int] = {}
        self._ticks: Iterator[int] = iter(())
        self._next = -1
        self._pending: list[tuple[int, int, Callable[[], None], Iterator[tuple[int, Callable[[], None]]]]] = []
        self._numbers = itertools.count()

    def _open(self, stack: ExitStack) -> None:
        stack.push(self._note_metadata)
        if self._suffix:
            files = _storage.new_file(self._place.path, self._suffix, self._ros)
        else:
            files = _storage.new_folder(self._place.path, self._ros, **self._limits)
        self._files = stack.enter_context(files)
        stack.push(self._complete)

    def _note_metadata(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.metadata = self._files.metadata[0]

    def write(self, scans: Scan | Mapping[str, Scan]) -> None:
        """Write a scan, or the scans of several sensors.

        With a cut, the end of each scan is written with the next one, or when the bag is closed.

        Parameters
        ----------
        scans : Scan, or mapping of str to Scan
            A scan of the only sensor, or scans by sensor name.

        Raises
        ------
        FileFormatError
            If a ring or a time does not fit in the layout.
        TypeError, ValueError
            If these are no scans, no sensor has that name, the bag is not open, a LaserScan is asked of a sensor that
            is no 2D lidar, or a scan does not start after the last one of its sensor.
        """
        for name, scan in (scans if isinstance(scans, Mapping) else {self._only(): scans}).items():
            _check_type("scans", scan, Scan, "a Scan, or Scans by name")
            if self._layouts.get(name) == _LASER_LAYOUT:
                self._write_laser(name, scan)
            else:
                self.write_cloud(scan.point_cloud(), scan.time, sensor=name, lidar=scan.lidar)

    def _write_laser(self, name: str, scan: Scan) -> None:
        """Publish a scan of a 2D lidar, at the time of its last pulse."""
        self._check_open()
        found = scan.laser_scan()
        stamp = self._stamp(found.time)
        parts = {field.name: getattr(found, field.name) for field in dataclasses.fields(found) if field.name != "time"}
        message = self._ros.types[_LASER](header=self._header(stamp, name), **parts)
        self._start_frame(name, scan.time)
        first = self._stamp(scan.time + float(scan.pulses.time[0]))
        last = self._stamp(scan.time + float(scan.pulses.time[-1]))
        with lost_writes():
            self._advance(first, last)
            data = self._ros.serialize_cdr(message, _LASER, little_endian=True)
            self._send(f"/{name}/scan", _LASER, last, data)

    def write_cloud(
        self,
        cloud: PointCloud,
        time: float = 0.0,
        *,
        sensor: str | None = None,
        lidar: Sensor | None = None,
    ) -> None:
        """Write a point cloud.

        Parameters
        ----------
        cloud : PointCloud
            The points in the frame of the sensor. Points that are not finite are dropped, and the rest sorted by time.
            With a cut, a message has points of two clouds, so they must not be deskewed.
        time : float
            Start of the frame, s.
        sensor : str, optional
            Name of the sensor; not needed if there is only one.
        lidar : Lidar
            The sensor, which determines the default layout, the vendor's zero of range, the types of returns and, with
            a cut, when to cut.

        Raises
        ------
        FileFormatError
            If a ring or a time does not fit in the layout.
        TypeError, ValueError
            If this is no cloud, no sensor has that name, the bag is not open, a cloud to be cut has no times, or the
            frame does not start after the last one of its sensor.
        """
        _check_type("cloud", cloud, PointCloud, "a PointCloud")
        name = self._sensor(sensor)
        stamp = self._start_frame(name, time)
        layout = self._layouts.get(name) or layout_of(lidar)
        if layout == _LASER_LAYOUT:
            hint = "a cloud lacks the beams without a return"
            raise ArgumentValueError("layout", "one of point clouds, or scans by `write`", repr(layout), hint)
        time_of_cut = _cuts.time_of(self._cut, layout, lidar)
        if lidar is not None and time_of_cut is not None:
            self._write_cut(name, cloud, lidar, layout=layout, frame=stamp, cut=time_of_cut)
            return
        records, last = to_layout(cloud, layout, lidar, stamp)
        message = self._message(name, layout, stamp, records)
        del records  # rosbags copies the message several times
        self._publish_open(name)
        self._publish(name, layout, stamp, last, message)

    def write_imu(self, samples: ImuSamples, *, sensor: str | None = None) -> None:
        """Write the samples of an IMU.

        The messages are those of drivers that do not estimate an orientation (REP 145): ``orientation_covariance[0]``
        is -1, and the other covariances are those of the white noise; 0 stands for unknown. Samples are written in
        order of time with the clouds: keep on writing those, or close the bag.

        Parameters
        ----------
        samples : ImuSamples
            The samples, in the axes of the IMU.
        sensor : str, optional
            Name of the sensor. Default: the name of the IMU.

        Raises
        ------
        TypeError, ValueError
            If these are no samples, no sensor has that name, the bag is not open, or a time is not on the clock of the
            bag.
        """
        _check_type("samples", samples, ImuSamples, "ImuSamples")
        imu = samples.imu
        name = self._sensor(sensor, imu)
        unknown = np.zeros(9)
        unknown[0] = -1.0
        densities = (0.0, 0.0) if imu is None else (imu.gyroscope.noise_density, imu.accelerometer.noise_density)
        of_rate, of_force = (np.eye(3).ravel() * density**2 * (imu.rate if imu else 0.0) for density in densities)
        rows = zip(samples.angular_rate.tolist(), samples.specific_force.tolist(), strict=True)
        messages = (
            {
                "orientation": self._geometry("Quaternion", 0.0, 0.0, 0.0, 1.0),
                "orientation_covariance": unknown,
                "angular_velocity": self._geometry("Vector3", *rate),
                "angular_velocity_covariance": of_rate,
                "linear_acceleration": self._geometry("Vector3", *force),
                "linear_acceleration_covariance": of_force,
            }
            for rate, force in rows
        )
        self._await(name, f"/{name}/data_raw", _IMU, samples.time, messages)

    def write_gnss(self, fixes: GnssFixes, *, sensor: str | None = None) -> None:
        """Write the fixes of a GNSS receiver.

        The covariance is that of the receiver's errors, and unknown if it has none. Fixes are written in order of time
        with the clouds: keep on writing those, or close the bag.

        Parameters
        ----------
        fixes : GnssFixes
            The fixes.
        sensor : str, optional
            Name of the sensor. Default: the name of the receiver.

        Raises
        ------
        TypeError, ValueError
            If these are no fixes, no sensor has that name, the bag is not open, or a time is not on the clock of the
            bag.
        """
        _check_type("fixes", fixes, GnssFixes, "GnssFixes")
        gnss = fixes.gnss
        name = self._sensor(sensor, gnss)
        variance = np.zeros(3)
        if gnss is not None:
            variance = np.square(gnss.position_sigma) + np.square(gnss.drift_sigma)
        covariance = np.diag(variance).ravel()
        status = self._ros.types["sensor_msgs/msg/NavSatStatus"](_STATUS_FIX, _SERVICE_GPS)

        places = np.degrees(fixes.latitude), np.degrees(fixes.longitude), fixes.altitude
        messages = (
            {
                "status": status,
                **dict(zip(("latitude", "longitude", "altitude"), place, strict=True)),
                "position_covariance": covariance,
                "position_covariance_type": _COVARIANCE_DIAGONAL_KNOWN if variance.any() else _COVARIANCE_UNKNOWN,
            }
            for place in np.stack(places, axis=1).tolist()
        )
        self._await(name, f"/{name}/fix", _FIX, fixes.time, messages)

    def _sensor(self, name: str | None, sensor: Imu | Gnss | None = None) -> str:
        """Return the name of the sensor: as given, else that of the sensor itself, else the only one."""
        self._check_open()
        found = name if name is not None else self._only() if sensor is None else sensor.name
        if found not in self._mounts:
            raise ArgumentValueError("sensor", f"one of {', '.join(self._mounts)}", repr(found))
        return found

    def _await(self, name: str, topic: str, kind: str, times: Floats, messages: Iterator[dict[str, Any]]) -> None:
        """Write messages but their headers at their times, among those that come in the meantime."""
        stamps = [self._stamp(time) for time in times.tolist()]
        sends = (
            partial(self._send_new, topic, kind, stamp, header=self._header(stamp, name), **parts)
            for stamp, parts in zip(stamps, messages, strict=True)
        )
        self._push(next(self._numbers), zip(stamps, sends, strict=True))

    def _push(self, number: int, samples: Iterator[tuple[int, Callable[[], None]]]) -> None:
        """Let the next of some samples wait for its time; of equal times, those of the lowest number come first."""
        if (sample := next(samples, None)) is not None:
            stamp, send = sample
            heapq.heappush(self._pending, (stamp, number, send, samples))

    def _write_cut(self, name: str, cloud: PointCloud, lidar: Sensor, *, layout: str, frame: int, cut: int) -> None:
        """Publish the message that ends at the cut of a frame, and keep the one that begins there.

        `frame` is the stamp of the start of the frame, and `cut` the time from there to the cut, ns.
        """
        begun = self._begun.get(name)
        if begun and not begun.goes_on(layout, lidar, frame):
            self._publish_open(name)
            begun = None
        stamp = begun.stamp if begun else frame
        before, since = _cuts.divide(cloud, cut, stamp - frame)
        records, last = to_layout(before, layout, lidar, stamp)
        self._begun[name] = _Open(layout, frame, frame + cut, *to_layout(since, layout, lidar, frame + cut))
        if begun:
            records, last = _concatenate(begun.records, records), max(begun.last, last)
        message = self._message(name, layout, stamp, records)
        del before, since, begun, records
        self._publish(name, layout, stamp, last, message)

    def _complete(self, kind: type[BaseException] | None, *_: object) -> None:
        """Publish the messages that no frame has ended and the samples that are left, unless there was an error."""
        if kind:
            return
        for name in sorted(self._begun, key=lambda name: self._begun[name].recorded):
            self._publish_open(name)
        with lost_writes():
            while self._pending:
                self._advance(self._pending[0][0], self._pending[0][0])

    def _publish_open(self, name: str) -> None:
        if begun := self._begun.pop(name, None):
            message = self._message(name, begun.layout, begun.stamp, begun.records)
            self._publish(name, begun.layout, begun.stamp, begun.last, message)

    def _message(self, name: str, layout: str, stamp: int, records: npt.NDArray[np.void]) -> bytes | memoryview:
        header = self._header(stamp, name)
        return self._custom(header, records) if layout == "livox" else self._cloud(header, records)

    def _publish(self, name: str, layout: str, stamp: int, last: int, message: bytes | memoryview) -> None:
        """Write a message whose last point is `last` ns after its stamp, and everything that comes before."""
        with lost_writes():
            self._advance(stamp, stamp + last)
            self._send(f"/{name}/points", _CUSTOM if layout == "livox" else _CLOUD, stamp + last, message)

    def _only(self) -> str:
        if len(self._mounts) != 1:
            raise ArgumentValueError("sensor", f"the name of one of {', '.join(self._mounts)}", "none")
        return next(iter(self._mounts))

    def _stamp(self, time: float) -> int:
        stamp = self._start + round(validation.real("time", time) * 1e9)
        if not 0 <= stamp < _LIMIT * 10**9:
            raise ArgumentValueError("time", "a time from 1970 to 2038 on the clock of the bag", f"{stamp / 1e9:g} s")
        return stamp

    def _start_frame(self, name: str, time: float) -> int:
        """Return the stamp of the start of a frame, after checking that the sensor's last one started before."""
        stamp = self._stamp(time)
        if stamp <= (last := self._starts.get(name, -1)):
            expected, hint = f"a frame of {name!r} after {(last - self._start) / 1e9} s", "Lidar.scan(…, time=) sets it"
            raise ArgumentValueError("time", expected, f"one at {time} s", hint)
        self._starts[name] = stamp
        return stamp

    def _advance(self, since: int, until: int) -> None:
        """Write clock, poses and samples up to a time; before the first of them, the extrinsics of the sensors."""
        if self._next < 0:
            since = min([since, *(stamp for stamp, *_ in self._pending)])
            self._ticks = (since + round(tick / self._rate * 1e9) for tick in itertools.count())
            self._next = next(self._ticks)
            transforms = [self._transform(since, self._body, name, mount) for name, mount in self._mounts.items()]
            self._send_new("/tf_static", _TRANSFORMS, since, transforms=transforms)
        while True:
            sample = self._pending[0][0] if self._pending else until + 1
            if self._next <= min(sample, until):
                self._send_new("/clock", "rosgraph_msgs/msg/Clock", self._next, clock=self._time(self._next))
                if self._trajectory is not None:
                    self._move(self._next, self._trajectory)
                self._next = next(self._ticks)
            elif sample <= until:
                _, number, send, samples = heapq.heappop(self._pending)
                send()
                self._push(number, samples)
            else:
                return

    def _move(self, stamp: int, trajectory: Trajectory) -> None:
        """Write the body's pose and velocity if the trajectory covers the stamp."""
        time = (stamp - self._start) * 1e-9
        first, last = trajectory.span
        if not first <= time <= last:
            return
        pose = trajectory.at(time).as_matrix()
        self._send_new("/tf", _TRANSFORMS, stamp, transforms=[self._transform(stamp, self._world, self._body, pose)])
        linear, angular = trajectory.velocity(time)
        linear = trajectory.at(time).rotation.inv().apply(linear)  # in the body's frame, as the angular one is
        vectors = (self._geometry("Vector3", *velocity.tolist()) for velocity in (linear, angular))
        position, orientation = _parts(pose)
        place = self._geometry("Point", *position), self._geometry("Quaternion", *orientation)
        exact = np.zeros(36)
        self._send_new(
            "/odom",
            "nav_msgs/msg/Odometry",
            stamp,
            header=self._header(stamp, self._world),
            child_frame_id=self._body,
            pose=self._geometry("PoseWithCovariance", self._geometry("Pose", *place), exact),
            twist=self._geometry("TwistWithCovariance", self._geometry("Twist", *vectors), exact),
        )

    def _transform(self, stamp: int, parent: str, child: str, pose: npt.NDArray[np.float64]) -> Any:
        position, orientation = _parts(pose)
        parts = self._geometry("Vector3", *position), self._geometry("Quaternion", *orientation)
        return self._geometry(
            "TransformStamped", self._header(stamp, parent), child, self._geometry("Transform", *parts)
        )

    def _geometry(self, name: str, *parts: Any) -> Any:
        return self._ros.types[f"geometry_msgs/msg/{name}"](*parts)

    def _time(self, stamp: int) -> Any:
        return self._ros.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))

    def _header(self, stamp: int, frame: str) -> Any:
        return self._ros.types["std_msgs/msg/Header"](self._time(stamp), frame)

    def _cloud(self, header: Any, records: npt.NDArray[np.void]) -> memoryview:
        """Return a PointCloud2 as CDR."""
        new, packed = self._ros.types, _pack(records)
        fields = [new["sensor_msgs/msg/PointField"](name, offset, code, 1) for name, offset, code in packed.fields]
        message = new[_CLOUD](
            header=header,
            height=1,
            width=len(records),
            fields=fields,
            is_bigendian=False,
            point_step=packed.point_step,
            row_step=records.nbytes,
            data=records.view(np.uint8),
            is_dense=True,
        )
        data: memoryview = self._ros.serialize_cdr(message, _CLOUD, little_endian=True)
        return data

    def _custom(self, header: Any, records: npt.NDArray[np.void]) -> bytes:
        """Return a CustomMsg as CDR: rosbags serialises it without points, and the points are appended as one block."""
        new = self._ros.types
        stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
        message = new[_CUSTOM](header, stamp, len(records), 0, np.zeros(3, np.uint8), [])
        head = bytes(self._ros.serialize_cdr(message, _CUSTOM, little_endian=True))
        return head[:-4] + struct.pack("<I", len(records)) + records.tobytes()[:-1]

    def _send_new(self, topic: str, kind: str, stamp: int, **parts: Any) -> None:
        message = self._ros.types[kind](**parts)
        self._send(topic, kind, stamp, self._ros.serialize_cdr(message, kind, little_endian=True))

    def _send(self, topic: str, kind: str, stamp: int, data: bytes | memoryview) -> None:
        self._files.write(topic, kind, stamp, data, latched=topic == "/tf_static")


class _Open(NamedTuple):
    """A message that lasts until the next frame is cut."""

    layout: str
    frame: int  # stamp of the start of the frame in which it begins, ns
    stamp: int  # ns
    records: npt.NDArray[np.void]
    last: int  # time of the last point since the stamp, ns

    @property
    def recorded(self) -> int:
        return self.stamp + self.last

    def goes_on(self, layout: str, lidar: Sensor, frame: int) -> bool:
        """Return whether the frame with this stamp continues it: the frame that follows, in the same layout.

        Both stamps are rounded, from times in s that are also rounded: by 1 ns each, at most, up to 2**21 s (24 days).
        """
        return self.layout == layout and abs(frame - self.frame - 1e9 / lidar.pattern.rate) <= 2.0


class PointCloud2(NamedTuple):
    """The points of a ``sensor_msgs/msg/PointCloud2``: one row of points, dense and little-endian.

    Parameters
    ----------
    width : int
        Number of points.
    fields : list of tuple of (str, int, int)
        Name, offset in bytes, and ``datatype`` of each field, one value each.
    point_step : int
        Size of a point, bytes.
    data : memoryview
        The points, bytes.
    """

    width: int
    fields: list[tuple[str, int, int]]
    point_step: int
    data: memoryview


def point_cloud2(
    cloud: PointCloud, *, layout: str | None = None, lidar: Sensor | None = None, stamp: int = 0
) -> PointCloud2:
    """Return points as the driver of the sensor publishes them, for a node of ROS.

    Parameters
    ----------
    cloud : PointCloud
        The points in the frame of the sensor, with times since the stamp of the message. Points that are not finite are
        dropped, and the rest sorted by time.
    layout : str, optional
        One of `LAYOUTS`, but livox, which is no PointCloud2. Default: by the vendor in the model of the sensor, with
        livox_cloud for Livox, and velodyne for all others.
    lidar : Lidar, optional
        The sensor, which determines the default layout, the vendor's zero of range and the types of returns.
    stamp : int
        Time in the header of the message, ns, from which the absolute times of the layout hesai count.

    Returns
    -------
    PointCloud2
        The content of the message but its header.

    Raises
    ------
    FileFormatError
        If a ring or a time does not fit in the layout.
    ValueError
        If there is no such layout of a PointCloud2.

    Examples
    --------
    >>> import lidarsim as ls
    >>> found = point_cloud2(ls.PointCloud(xyz=[[1, 2, 3]], ring=[7]))
    >>> found.width, found.point_step, [name for name, _, _ in found.fields]
    (1, 22, ['x', 'y', 'z', 'intensity', 'ring', 'time'])
    """
    chosen = layout_of(lidar) if layout is None else layout
    if layout is None and chosen == "livox":
        chosen = "livox_cloud"
    if chosen not in LAYOUTS or chosen == "livox":
        known = ", ".join(name for name in LAYOUTS if name != "livox")
        raise ArgumentValueError("layout", f"one of {known}", validation.short_repr(layout))
    records, _ = to_layout(cloud, chosen, lidar, validation.integer("stamp", stamp, at_least=0))
    return _pack(records)


def _pack(records: npt.NDArray[np.void]) -> PointCloud2:
    places = (records.dtype.fields or {}).items()
    fields = [(name, place[1], _CODES[place[0].str[1:]]) for name, place in places]
    return PointCloud2(len(records), fields, records.dtype.itemsize, records.view(np.uint8).data)


class Message(NamedTuple):
    """A point cloud in a bag.

    Parameters
    ----------
    topic : str
        Topic of the message.
    frame_id : str
        Coordinate frame of the points.
    stamp : int
        Time in the header, ns.
    cloud : PointCloud
        The points.
    """

    topic: str
    frame_id: str
    stamp: int
    cloud: PointCloud


def is_bag(path: PathLike) -> bool:
    """Return whether the name of a file is that of a bag that `read` reads.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    bool
        Whether it ends in ``.mcap`` or ``.db3``, or in one of these and ``.zstd``.
    """
    return Path(path).name.lower().removesuffix(_storage.ZSTD).endswith(SUFFIXES)


def read(path: PathLike, *, topic: str | None = None) -> Iterator[Message]:
    """Read the point clouds of a ROS 2 bag, one by one.

    Parameters
    ----------
    path : path-like
        A ``.mcap`` or ``.db3`` file, which may be compressed (``.mcap.zstd``), or the folder of a bag, whose files are
        read in the order of its metadata.yaml.
    topic : str, optional
        Only clouds of this topic.

    Returns
    -------
    iterator of Message
        The point clouds in file order. For each topic with clouds that cannot be used, a warning says why
        the first of them is left out, and a last one how many are.

    Raises
    ------
    FileFormatError
        If the bag is damaged or has no point clouds that can be used, or none under that topic.
    MissingExtraError
        If rosbags is not installed.
    OSError
        If it cannot be read.
    """
    place = Place(path)
    with place.errors_as_given():
        paths = _storage.list_files(place.path) if place.path.is_dir() else [place.path]
        for each in paths:
            check_regular(each)
    return place.each(parse_each(place.path, "ROS 2 bag", _read(paths, topic)))


def static_mounts(path: PathLike) -> dict[str, tuple[str, npt.NDArray[np.float64]]]:
    """Read where frames are mounted, from ``/tf_static``.

    Parameters
    ----------
    path : path-like
        A ``.mcap`` or ``.db3`` file.

    Returns
    -------
    dict of str to (str, ndarray of float64, shape (4, 4))
        For each frame with a parent, the topmost frame above it, such as ``base_link``, and its pose there. The bag is
        read until a topic of point clouds repeats after the first transforms.

    Raises
    ------
    FileFormatError
        If the bag is damaged, a transform is not rigid and finite, or the parents of a frame are a circle.
    MissingExtraError
        If rosbags is not installed.
    OSError
        If it cannot be read.
    """
    check_regular(path)
    with parsing(path, "ROS 2 bag"):
        return _mounts(_static_transforms(Path(path)))


def _static_transforms(path: Path) -> dict[str, tuple[str, npt.NDArray[np.float64]]]:
    """Return parent, and pose in it, of each frame in ``/tf_static``."""
    from scipy.spatial.transform import Rotation

    ros, found, seen = _typestore(), {}, set()
    for name, kind, _, data in _messages(path):
        if kind == _TRANSFORMS and name == "/tf_static":
            message: Any = ros.deserialize_cdr(_storage.decompress(data), kind)
            for stamped in message.transforms:
                place, turn = stamped.transform.translation, stamped.transform.rotation
                numbers = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
                if not np.isfinite(numbers).all() or not numbers[3:].any():
                    raise FileFormatError(f"its transform of {stamped.child_frame_id!r} is not rigid and finite")
                pose = transforms(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])
                found[stamped.child_frame_id] = stamped.header.frame_id, pose
        elif kind in _PARSERS:
            if found and name in seen:
                break
            seen.add(name)
    return found


def _mounts(
    parents: Mapping[str, tuple[str, npt.NDArray[np.float64]]],
) -> dict[str, tuple[str, npt.NDArray[np.float64]]]:
    """Return the topmost frame above each frame, and the pose there."""
    found = {}
    for name in parents:
        above, pose, passed = name, np.eye(4), set[str]()
        while above in parents:
            if above in passed:
                raise FileFormatError(f"the parents of its frame {name!r} are a circle")
            passed.add(above)
            above, step = parents[above]
            pose = step @ pose
        found[name] = above, pose
    return found


def save(fields: Fields, file: BinaryIO, *, suffix: str) -> None:
    """Write a bag with one cloud."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"cloud{suffix}"
        with Writer(path) as bag:
            bag.write_cloud(PointCloud(fields))
        with path.open("rb") as written:
            shutil.copyfileobj(written, file)


def load(file: BinaryIO) -> Fields:
    """Read the only cloud of a bag."""
    messages = _read([Path(file.name)], None)
    first = next(messages, None)
    if first is None or next(messages, None) is not None:
        raise FileFormatError("it holds several clouds: read them one by one with lidarsim.io.rosbag.read")
    return {name: getattr(first.cloud, name) for name in first.cloud.fields}


def _read(paths: list[Path], topic: str | None) -> Iterator[Message]:
    """Yield the clouds of the files of a bag, and warn of those that cannot be used."""
    ros = _typestore()
    topics: dict[str, str] = {}
    read, odd, errors = Counter[str](), Counter[str](), dict[str, Exception]()
    for name, kind, recorded, data in itertools.chain.from_iterable(map(_messages, paths)):
        topics[name] = kind
        if kind not in _PARSERS or topic not in {None, name}:
            continue
        message = None
        try:
            message = Message(name, *_PARSERS[kind](ros, _storage.decompress(data), recorded))
            read[name] += 1
        except Exception as error:
            if isinstance(error, ImportError | OSError | MemoryError):  # no fault of this message
                raise
            odd[name] += 1
            if odd[name] == 1:
                errors[name] = error
        while read and errors:  # once it is known that the bag has clouds
            of, reason = errors.popitem()
            _warn(paths, f"a cloud of {plain(of, most=NAME)} is left out: {redact(reason)}")
        if message is not None:
            yield message
            del message  # free it before the next is read
    if errors:
        raise next(iter(errors.values()))
    for name, count in odd.items():
        if count > 1:
            _warn(paths, f"{count:,} of {count + read[name]:,} clouds of {plain(name, most=NAME)} are left out")
    if not any(kind in _PARSERS and topic in {None, name} for name, kind in topics.items()):
        there = ", ".join(f"{plain(name, most=NAME)} ({plain(kind, most=NAME)})" for name, kind in topics.items())
        raise FileFormatError(
            f"it has no point clouds{f' under {topic}' if topic else ''}; its topics are {there or 'none'}"
        )


def _warn(paths: list[Path], problem: str) -> None:
    """Warn, at the call that reads the next cloud of a bag."""
    name = paths[0] if len(paths) == 1 else paths[0].parent
    warnings.warn(f"{name}: {problem}", stacklevel=5)


def _messages(path: Path) -> Iterator[tuple[str, str, int, memoryview]]:
    """Yield topic, type, recording time (ns) and data of each message of a file, by its signature."""
    with _storage.plain_file(path) as file:
        with file.open("rb") as opened:
            head = opened.read(max(map(len, SIGNATURES.values())))
        if head.startswith(ROS_1):
            raise FileFormatError(ROS_1_HINT)
        if not head.startswith(tuple(SIGNATURES.values())):
            raise FileFormatError("it begins neither as an MCAP file nor as an SQLite database does")
        yield from _mcap.messages(file) if head.startswith(_mcap.MAGIC) else _rows(file)


def _rows(path: Path) -> Iterator[tuple[str, str, int, memoryview]]:
    """Yield topic, type, recording time (ns) and data of each message of a bag in SQLite storage."""
    rosbag2 = import_extra("rosbags.rosbag2", "formats", "reading ROS bags")
    _storage.check_tables(path)
    with _plain_path(path) as place, rosbag2.Reader(place) as bag:
        for connection, recorded, data in bag.messages(bag.connections):
            yield connection.topic, connection.msgtype, recorded, memoryview(data)


def _plain_path(path: Path) -> AbstractContextManager[Path]:
    """Return a path of the file that ends in .db3 and means itself in a URI, as which rosbags gives it to SQLite."""
    text = str(path)
    plain = path.suffix == ".db3" and text.isprintable() and not text.startswith("//") and not set("%?#") & set(text)
    return nullcontext(path) if plain else link(path, "bag.db3")


def _parse_cloud(ros: Typestore, data: memoryview, recorded: int) -> tuple[str, int, PointCloud]:
    message: Any = ros.deserialize_cdr(data, _CLOUD)
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    step = _row_step(message)
    types = {code: f"{'><'[not message.is_bigendian]}{name}" for name, code in _CODES.items()}
    layout: dict[str, list[Any]] = {"names": [], "formats": [], "offsets": []}
    for field in message.fields:
        if field.datatype not in types:
            raise FileFormatError(f"its field {field.name} has the unknown type {field.datatype}")
        count = field.count or 1  # PCL also reads 0 as 1
        if field.offset + np.dtype(types[field.datatype]).itemsize * count > message.point_step:
            raise FileFormatError(f"its field {field.name} ends outside a point of {message.point_step} bytes")
        if field.name in layout["names"]:
            raise FileFormatError(f"it has two fields named {field.name!r}")
        layout["names"].append(field.name)
        layout["formats"].append((types[field.datatype], (count,)) if count > 1 else types[field.datatype])
        layout["offsets"].append(field.offset)
    dtype = np.dtype({**layout, "itemsize": message.point_step})  # type: ignore[call-overload]
    shape = message.height, message.width
    strides = step, message.point_step
    records = np.ndarray(shape, dtype, message.data, strides=strides).ravel() if 0 not in shape else np.empty(0, dtype)
    columns = {name: records[name] for name in layout["names"]}
    return message.header.frame_id, stamp, to_cloud(columns, stamp, recorded)


def _concatenate(first: npt.NDArray[np.void], second: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return the records of both in their common layout, whose padding np.concatenate would drop."""
    whole = np.zeros(len(first) + len(second), first.dtype)
    return np.concatenate([first, second], out=whole)


def _row_step(message: Any) -> int:
    """Return the row step of a PointCloud2 in bytes, after checking that its data hold all rows.

    Rows may be padded, including the last. If the data are exactly as long as all points, there is no padding, and the
    claimed step is ignored.
    """
    packed: int = message.width * message.point_step
    step: int = message.row_step
    size = len(message.data)
    if size == message.height * packed:
        return packed
    if step < packed or not (message.height - 1) * step + packed <= size <= message.height * step:
        raise FileFormatError(
            f"{message.width} × {message.height} points of {message.point_step} bytes have {size} together"
        )
    return step


def _parse_custom(_: Typestore, data: memoryview, recorded: int) -> tuple[str, int, PointCloud]:
    """Parse a CustomMsg; rosbags would create one object per point."""
    if bytes(data[:2]) != b"\x00\x01":
        raise FileFormatError("its CustomMsg is not in little-endian CDR")
    body = data[4:]
    seconds, nanoseconds, length = struct.unpack_from("<iII", body)
    start = -(-(12 + length) // 8) * 8  # timebase is aligned to 8 bytes
    base, _, _, _, points = struct.unpack_from("<QIB3sI", body, start)
    point = LAYOUTS["livox"]
    if points * point.itemsize > len(body) - start - 19:
        raise FileFormatError(f"it is truncated: {(len(body) - start - 19) // point.itemsize} of {points} points")
    columns = {
        name: np.ndarray(points, place[0], body, start + 20 + place[1], point.itemsize) if points else np.empty(0)
        for name, place in (point.fields or {}).items()
    }
    frame = bytes(body[12 : 11 + length]).decode()
    cloud = to_cloud(columns, base, recorded)
    return frame, seconds * 10**9 + nanoseconds, cloud


def _parse_laser(ros: Typestore, data: memoryview, _: int) -> tuple[str, int, PointCloud]:
    message: Any = ros.deserialize_cdr(data, _LASER)
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    ranges = message.ranges.astype(np.float64)
    if len(message.intensities) not in {0, len(ranges)}:
        raise FileFormatError(f"it has {len(message.intensities)} intensities for {len(ranges)} ranges")
    numbers = np.arange(len(ranges))
    # An angle is what the message says: the sum of two float32 numbers.
    angles = message.angle_min + message.angle_increment * numbers
    found = np.isfinite(ranges) & (ranges >= message.range_min) & (ranges <= message.range_max)
    there = ranges[found]
    fields: Fields = {
        "xyz": np.column_stack((there * np.cos(angles[found]), there * np.sin(angles[found]), np.zeros(len(there)))),
        "range": there,
        "time": message.time_increment * numbers[found],
    }
    if len(message.intensities):
        fields["intensity"] = message.intensities[found].astype(np.float32)
    if not np.isfinite(fields["xyz"]).all() or not np.isfinite(fields["time"]).all():
        raise FileFormatError("it has an angle or a time that is not finite")
    return message.header.frame_id, stamp, PointCloud(fields)


_PARSERS = {_CLOUD: _parse_cloud, _CUSTOM: _parse_custom, _LASER: _parse_laser}
"""Parsers of messages with point clouds, by type."""


@cache
def _typestore() -> Typestore:
    import importlib.metadata

    typesys = import_extra("rosbags.typesys", "formats", "ROS bags")
    there = importlib.metadata.version("rosbags")
    if tuple(map(int, re.findall(r"\d+", there)[:2])) < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise MissingExtraError(
            f'ROS bags need rosbags {oldest} or newer, got {there}: pip install "rosbags>={oldest}"; if another package'
            " needs the older one, install lidarsim in an environment of its own"
        )
    store: Typestore = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, definition in _CUSTOM_DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(definition, name))
    return store


def _limits(path: PathLike, size: int | None, duration: float | None) -> dict[str, int | None]:
    """Validate and return the limits of the files of a bag, which only a folder has."""
    if is_folder(path):
        check_folder(path)
    for name, value in {"max_size": size, "max_duration": duration}.items():
        if value is not None and not is_folder(path):
            raise ArgumentValueError(name, "a folder as the path, with a name that has no dot", f"the file {path}")
    most = None if duration is None else max(round(validation.real("max_duration", duration, above=0.0) * 1e9), 1)
    return {
        "max_size": None if size is None else validation.integer("max_size", size, at_least=1),
        "max_duration": most,
    }


def _name(argument: str, name: str) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        expected = "a name of ASCII letters, digits and _ that begins with a letter"
        raise ArgumentValueError(argument, expected, validation.short(ascii(name)))
    return check_name(argument, name)


def _check_type(argument: str, value: object, kind: type, expected: str) -> None:
    if not isinstance(value, kind):
        raise ArgumentTypeError(argument, expected, validation.short_repr(value))


def _layouts(layout: str | Mapping[str, str] | None, names: Mapping[str, object]) -> dict[str, str]:
    given = layout if isinstance(layout, Mapping) else dict.fromkeys(names, layout) if layout is not None else {}
    for name, value in given.items():
        if name not in names:
            raise ArgumentValueError("layout", f"names of the sensors {', '.join(names)}", repr(name))
        if value not in NAMES:
            raise ArgumentValueError("layout", f"one of {', '.join(NAMES)}", repr(value))
    return dict(given)


def _parts(pose: npt.NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return the position and the quaternion x, y, z, w of a pose."""
    from scipy.spatial.transform import Rotation

    return pose[:3, 3].tolist(), Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True).tolist()


for _suffix, _signature in SIGNATURES.items():
    register_format(_suffix, save=partial(save, suffix=_suffix), load=load, signature=_signature)
