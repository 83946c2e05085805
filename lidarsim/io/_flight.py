"""Fields of LAS points that describe the flight and the scanner."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, integer, short_repr
from lidarsim.errors import ArgumentTypeError
from lidarsim.motion.trajectory import Trajectory
from lidarsim.patterns import OscillatingMirror, PolygonMirror
from lidarsim.scan.scan import Scan


def flight_fields(scan: Scan, *, point_source_id: int = 0) -> dict[str, npt.NDArray[Any]]:
    """Return what LAS stores of the flight for each point of a scan from a moving sensor.

    The scan angle is that of LAS 1.4: the rotation of the pulse from straight down about the line of flight, in the
    world, atan2(r, d) of its components to the right of the line of flight, r, and downwards, d. It is positive to the
    right, and includes the roll of the aircraft. The line of flight is the horizontal direction of the sensor's
    velocity; where it has none, the angle is 0 below the horizon.

    Mirrors that oscillate or are polygons scan lines, which go on from frame to frame. Their direction flag is 1 while
    the angle grows, from left to right, and the edge flag is 1 for the last pulse of a line. Other patterns have no
    lines: both flags are 0.

    Parameters
    ----------
    scan : Scan
        The scan; its pose must be a trajectory.
    point_source_id : int
        Number of the strip, 0 to 65535.

    Returns
    -------
    dict of str to ndarray, shape (points,)
        `scan_angle` (float64, rad), `scan_direction_flag` and `edge_of_flight_line` (uint8) and `point_source_id`
        (uint16), in the order of ``scan.point_cloud()``: set them as fields of that cloud to have them written.

    Raises
    ------
    TypeError, ValueError
        If the sensor does not move, or `point_source_id` is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import lidarsim as ls
    >>> scene = ls.Scene()
    >>> ground = scene.add(ls.Plane((0, 0, 1), -100.0))
    >>> flight = ls.Trajectory.from_twist(np.eye(4), linear=(50, 0, 0))
    >>> down = [[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    >>> grid = ls.patterns.Grid(np.radians([10.0, -10.0]), [0.0], rate=10.0)
    >>> scan = ls.Lidar(grid).scan(scene, flight @ down)
    >>> np.degrees(flight_fields(scan)["scan_angle"]).round(6)
    array([-10.,  10.])
    """
    source = integer("point_source_id", point_source_id, at_least=0, at_most=65_535)
    if not isinstance(scan, Scan):
        raise ArgumentTypeError("scan", "a Scan", short_repr(scan))
    if not isinstance(scan.pose, Trajectory):
        raise ArgumentTypeError("scan", "one of a sensor that moves along a trajectory", "one of a sensor at rest")
    first, last = scan.pose.span
    velocity = scan.pose.velocity(np.clip(scan.time + scan.pulses.time, first, last))[0]
    angle = _angles(scan.poses, scan.pulses.directions, velocity)
    grows, ends = np.zeros((2, len(scan)), bool)
    if isinstance(scan.lidar.pattern, OscillatingMirror | PolygonMirror) and len(scan):
        pattern, frame = scan.lidar.pattern, scan.frame
        # Two pulses on either side tell the place of the first and the last pulse of the frame in their lines.
        before, after = pattern.pulses(frame - 1) if frame else None, pattern.pulses(frame + 1)
        for ring in np.unique(scan.pulses.ring):
            own = scan.pulses.ring == ring
            earlier = before.directions[before.ring == ring][-2:] if before else np.empty((0, 3))
            around = [earlier, scan.pulses.directions[own], after.directions[after.ring == ring][:2]]
            # Within a line the sign must be that of the mirror, so the attitude is that of the first pulse for all.
            swept = _lines(_angles(scan.poses[:1], np.concatenate(around), velocity[:1]))
            grows[own], ends[own] = (flags[len(earlier) :][: own.sum()] for flags in swept)
    of_pulse = np.repeat(np.arange(len(scan)), scan.return_count)
    return {
        "scan_angle": angle[of_pulse],
        "scan_direction_flag": grows[of_pulse].astype(np.uint8),
        "edge_of_flight_line": ends[of_pulse].astype(np.uint8),
        "point_source_id": np.full(len(of_pulse), source, np.uint16),
    }


def _angles(poses: Floats, directions: Floats, velocity: Floats) -> Floats:
    """Return the rotation of each pulse from straight down about the line of flight, rad."""
    pulses = np.einsum("nij,nj->ni", np.broadcast_to(poses, (len(directions), 4, 4))[:, :3, :3], directions)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    right = np.stack([velocity[:, 1], -velocity[:, 0]], axis=-1) / np.where(speed > 0.0, speed, 1.0)[:, None]
    angles: Floats = np.arctan2((pulses[:, :2] * right).sum(axis=-1), -pulses[:, 2])
    return angles


def _lines(angle: Floats) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return whether the angle grows at each pulse of a scanner of lines, and whether the pulse is the last of a line.

    Step k leads from pulse k to the next. A single step against those before and after it is a change of facet, from
    the end of a line to the start of the next. Otherwise, the mirror turns back where the sign of the steps changes.
    """
    grows, ends = np.zeros((2, len(angle)), bool)
    rises = np.diff(angle) > 0.0
    if not len(rises):
        return grows, ends
    flies_back = np.zeros(len(rises), bool)
    flies_back[1:-1] = (rises[1:-1] != rises[:-2]) & (rises[1:-1] != rises[2:])
    turns_back = np.zeros(len(rises), bool)
    turns_back[1:] = (rises[1:] != rises[:-1]) & ~flies_back[1:] & ~flies_back[:-1]
    ends[:-1] = flies_back | turns_back
    before, after = np.append(rises[0], rises), np.append(rises, rises[-1])
    grows[:] = np.where(ends, before, after)
    return grows, ends
