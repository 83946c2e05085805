"""Division of a spinning sensor's frames into the messages that its driver publishes.

A driver begins a message when the head passes a fixed azimuth, the cut. A frame of `Spinning` begins at its start
azimuth, so that a message consists of the end of one frame and the beginning of the next. The head turns steadily: it
passes the cut at the same time in each frame. A pulse belongs to the message in which it is fired, whatever the azimuth
offset of its channel.

========================================  ============================================================================
driver                                    a message begins
========================================  ============================================================================
velodyne                                  at azimuth 0 (``cut_angle``), rounded to whole packets
hesai, robosense                          at azimuth 0 (``frame_start_azimuth``, ``split_angle``)
autoware (nebula)                         at azimuth 0 (``cut_angle``, ``scan_phase``)
ouster                                    with column 0: at 180°, since x points away from the connector
livox_ros_driver2                         at a fixed time
========================================  ============================================================================
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np

from lidarsim._base.validation import angle, short_repr
from lidarsim.errors import ArgumentTypeError, ArgumentValueError
from lidarsim.patterns import Spinning
from lidarsim.scan.pointcloud import PointCloud
from lidarsim.sensor.sensor import Sensor

Cut: TypeAlias = Literal["pattern", "driver"] | float
"""Where messages begin: with each frame of the pattern, where the layout's driver cuts, or at an azimuth, rad."""

DRIVERS = {"velodyne": 0.0, "ouster": math.pi, "hesai": 0.0, "autoware": 0.0}
"""Azimuth at which the driver of a layout cuts, rad; the other drivers do not cut at an azimuth."""

TURN = 2.0 * math.pi


def check_cut(cut: object) -> Cut:
    """Return `cut` after checking it."""
    expected = "'pattern', 'driver' or an azimuth in rad"
    match cut:
        case "pattern" | "driver":
            return cut
        case str():
            raise ArgumentValueError("cut", expected, short_repr(cut))
    try:
        return angle("cut", cut, at_least=-TURN, at_most=TURN)
    except TypeError:
        raise ArgumentTypeError("cut", expected, short_repr(cut)) from None


def time_of(cut: Cut, layout: str, lidar: Sensor | None) -> int | None:
    """Return when the head passes the cut, whole ns since the start of a frame, or None if frames stay whole.

    The fraction of a nanosecond is dropped. A pulse at the cut, whose time has another rounding error, is therefore not
    earlier when rounded to whole nanoseconds: in turns, angles and times err by less than 2**-48 together, which is
    less than 0.5 ns at any rate above 1e-5 Hz. For the same reason, a cut within 2 ns of the start or the end of a
    frame is taken as that.
    """
    azimuth = None if cut == "pattern" else DRIVERS.get(layout) if cut == "driver" else cut
    pattern = None if azimuth is None or lidar is None else lidar.pattern
    if azimuth is None or not isinstance(pattern, Spinning) or pattern.field_of_view < TURN:
        return None
    ahead = pattern.start_azimuth - azimuth if pattern.clockwise else azimuth - pattern.start_azimuth
    period = 1e9 / pattern.rate
    time = math.floor(ahead % TURN / TURN * period)
    return time if 2 <= time <= period - 2 else None


def divide(cloud: PointCloud, time: int, start: int) -> tuple[PointCloud, PointCloud]:
    """Return the points fired before a time, and the others, in firing order with times of whole nanoseconds.

    `time` is when to cut, ns since the start of the frame, from which the times of the cloud count. Those of the first
    part then count from `start`, ns since the start of the frame, and those of the others from the cut.
    """
    if "time" not in cloud.fields:
        raise ArgumentValueError("cloud", "the time of each point, by which to cut", "no field time")
    if not (np.diff(cloud.time) >= 0.0).all():
        cloud = cloud[np.argsort(cloud.time, kind="stable")]
    fired = np.rint(cloud.time * 1e9)
    first = int(np.searchsorted(fired, time))
    before, since = cloud[:first], cloud[first:]
    before.time = (fired[:first] - start) / 1e9
    since.time = (fired[first:] - time) / 1e9
    return before, since
