"""Models of poses and motions, and what is built of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from lidarsim import worlds
from lidarsim._base.validation import pose as rigid
from lidarsim._base.vectors import transforms
from lidarsim.config.factories import Area, Finite, Matrix, Model, Vector, construct, either, has, is_list
from lidarsim.lidar import Lidar
from lidarsim.motion.trajectory import Trajectory, sensor_pose
from lidarsim.rig import Rig
from lidarsim.run import Leg

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.config.document import Place


class Turn(Model):
    """Rotations about the fixed axes, x first: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    roll: Finite = 0.0
    pitch: Finite = 0.0
    yaw: Finite = 0.0


def _rotations(axes: str, angles: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler(axes, angles).as_matrix()


class Placement(Model):
    """A pose: position and rotation, or the 4x4 matrix into the world."""

    position_m: Vector = [0.0, 0.0, 0.0]
    """Position."""
    rotation_deg: Turn = Turn()
    """Rotations about the fixed axes x, y and z, in this order."""
    matrix: Matrix | None = None
    """The 4 × 4 matrix instead of both."""

    def to_matrix(self, place: Place, scale: float | Vector = 1.0) -> Floats:
        """Return the 4x4 matrix into the world."""
        if self.matrix is not None:
            others = [key for key in ("position_m", "rotation_deg", "scale") if key in self.model_fields_set]
            if others:
                raise (place / "matrix").error(f"expected the matrix alone, got {others[0]} beside it")
            return np.array(self.matrix)
        turn = self.rotation_deg
        turned = np.eye(3) if turn == Turn() else _rotations("ZYX", np.radians([turn.yaw, turn.pitch, turn.roll]))
        return transforms(turned * scale, self.position_m)  # R diag(scale)


PLACING = frozenset(Placement.model_fields)


class Waypoint(Placement):
    """A placement at a time."""

    time_s: float
    """When it is there; linear in between."""


class Pose(Placement):
    """A placement that may move with a constant twist from time 0."""

    linear_m_per_s: Vector = [0.0, 0.0, 0.0]
    """Velocity in its own axes, from time 0 on."""
    angular_deg_per_s: Vector = [0.0, 0.0, 0.0]
    """Angular velocity in its own axes."""


class TrajectoryFile(Placement):
    """Poses over time from a file; its placement is that of the world of the file."""

    file: str
    """TUM, CSV (header `time_s,x_m,y_m,z_m,qx,qy,qz,qw`), KITTI, or `ego_pose.json` of nuScenes."""
    times: str | None = None
    """For KITTI: a file with one time per line, s."""
    scene: str | None = None
    """For nuScenes: name of the scene, whose first pose is at time 0."""
    start_s: Finite | None = None
    """Shift all times so that the first pose is at this one."""
    interpolation: Literal["linear", "spline"] = "linear"
    """Between poses."""
    axes: Literal["body", "camera"] = "body"
    """`camera`: the poses are those of a camera, with x to the right, y down and z ahead."""


class Plan(Model):
    """A flight in parallel strips: `strips` of a pose, whose placement is that of the sensor on the aircraft."""

    area_m: Area
    height_m: float
    speed_m_per_s: float
    overlap: float
    field_of_view_deg: float
    heading_deg: float = 0.0
    turn_s: float = 60.0
    ground_m: float = 0.0
    margin_m: float | None = None
    """Distance for which each strip is flown beyond the area at both ends. Default: that of a frame. For a rig: that of
    a frame of each rate, and between the offsets. Only whole frames are scanned, so a lesser one leaves up to as much
    of the area unseen at either end."""


class Strips(Placement):
    """A flight in strips; its placement is that of the sensor on the aircraft."""

    strips: Plan

    def build(self, place: Place, sensor: Lidar | Rig) -> tuple[Leg, ...]:
        """Return the strips, each with the frames that it holds."""
        plan, there = self.strips, place / "strips"
        rate = sensor.rate if isinstance(sensor, Rig) else sensor.pattern.rate
        periods, offsets = [1.0 / rate], [0.0]
        if isinstance(sensor, Rig):
            periods = sorted({1.0 / part.lidar.pattern.rate for part in sensor.values()})
            offsets += [part.offset for part in sensor.values()]
        # Frames start at multiples of their period, so a strip has up to one of each period, and the time between the
        # offsets, without a frame of some sensor at either end.
        unseen = sum(periods) + max(offsets) - min(offsets)
        margin = {} if plan.margin_m is not None else {"margin": plan.speed_m_per_s * unseen}
        keys = [key for key in Plan.model_fields if getattr(plan, key) is not None]
        legs, mount = [], build_rigid(self, place)
        for number, body in enumerate(construct(Trajectory.strips, plan, keys, there, **margin), 1):
            (start, end), pose = body.span, sensor_pose(body, mount)
            if not end * rate < 2**32:
                raise there.error(f"expected at most 4294967296 frames, got {end * rate:.3g}")
            first, stop = math.ceil(start * rate), math.floor(end * rate)
            while first < stop and _span(sensor, first, stop)[0] < start:  # also by rounding
                first += 1
            while first < stop and _span(sensor, first, stop)[1] > end:
                stop -= 1
            if stop <= first:
                raise there.error(f"expected strips of a frame, {periods[-1]:g} s, got one of {end - start:g} s")
            legs.append(Leg(number, pose, range(first, stop)))
        return tuple(legs)


def _span(sensor: Lidar | Rig, first: int, stop: int) -> tuple[float, float]:
    """Return the start of the first frame of any sensor and the end of the last, s."""
    if isinstance(sensor, Rig):
        return sensor.span(stop - first, first=first)
    return first / sensor.pattern.rate, stop / sensor.pattern.rate


class Stations(Placement):
    """Places of a tripod; the placement is that of the sensor on it."""

    stations: Annotated[list[Placement], Field(min_length=1)]
    """Placements of the tripod."""

    def build(self, place: Place, frames: range) -> tuple[Leg, ...]:
        """Return the stations; the first has the given frames, and the others as many after them."""
        mount, legs = build_rigid(self, place), []
        for index, station in enumerate(self.stations):
            first = frames.start + index * len(frames)
            pose = sensor_pose(build_rigid(station, place / "stations" / index), mount)
            legs.append(Leg(index + 1, pose, range(first, first + len(frames))))
        return tuple(legs)


class Drive(Placement):
    """A way of a street, along which the sensor moves; the placement is that of the sensor on the vehicle."""

    way: Literal["lanes", "turns", "pavements", "crossings"]
    """Which ways of the street."""
    number: Annotated[int, Field(ge=0)] = 0
    """Which of them."""
    start_m: Annotated[float, Field(ge=0)] = 0.0
    """Where on the way the sensor is at time 0."""
    speed_m_per_s: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    """Speed."""
    interpolation: Literal["linear", "spline"] = "linear"
    """Between the points of the way; an IMU needs `spline`."""

    def build(self, place: Place, ways: worlds.Ways | None) -> Trajectory:
        """Return the trajectory from time 0 to the end of the way."""
        if ways is None:
            raise (place / "way").error("expected a pose, since the scene is not a street")
        lines = getattr(ways, self.way)
        if self.number >= len(lines):
            raise (place / "number").error(f"expected the number of one of {len(lines)} {self.way}, got {self.number}")
        points = lines[self.number]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        if not self.start_m < along[-1]:
            raise (place / "start_m").error(f"expected less than the length of the way, {along[-1]:.4g}")
        ahead = np.gradient(points, along, axis=0)
        at = np.concatenate([[self.start_m], along[along > self.start_m]])
        points, ahead = (np.stack([np.interp(at, along, row) for row in rows.T], axis=1) for rows in (points, ahead))
        turns = [np.arctan2(ahead[:, 1], ahead[:, 0]), -np.arctan2(ahead[:, 2], np.hypot(ahead[:, 0], ahead[:, 1]))]
        poses = transforms(_rotations("ZY", np.stack(turns, axis=1)), points)
        drive = Trajectory((at - self.start_m) / self.speed_m_per_s, poses, interpolation=self.interpolation)
        return drive @ build_rigid(self, place)


def build_pose(value: Pose | list[Waypoint] | TrajectoryFile, place: Place) -> Floats | Trajectory:
    """Return the pose, or the trajectory of a moving one."""
    if isinstance(value, TrajectoryFile):
        files = {"path": (place / "file").file(value.file)}
        if value.times is not None:
            files["times"] = (place / "times").file(value.times)
        trajectory = construct(Trajectory.load, value, ["interpolation", "axes", "scene", "start_s"], place, **files)
        with place.refusals({"world": ("position_m", "")}):
            return trajectory if value.model_fields_set.isdisjoint(PLACING) else build_rigid(value, place) @ trajectory
    if isinstance(value, list):
        poses = [build_rigid(waypoint, place / index) for index, waypoint in enumerate(value)]
        with place.refusals():
            return Trajectory([waypoint.time_s for waypoint in value], poses)
    return build_motion(build_rigid(value, place), value, place)


def build_rigid(placement: Placement, place: Place) -> Floats:
    """Return the checked 4x4 matrix into the world."""
    with place.refusals({"matrix": ("matrix", "")}):
        return rigid("matrix", placement.to_matrix(place))


class Twist(Model):
    """A constant velocity, of an object in its own axes."""

    linear_m_per_s: Vector = [0.0, 0.0, 0.0]
    """Velocity."""
    angular_deg_per_s: Vector = [0.0, 0.0, 0.0]
    """Angular velocity."""


def build_motion(start: Floats, twist: Pose | Twist, place: Place) -> Floats | Trajectory:
    """Return the pose, or the trajectory from it if there are velocities."""
    if any(twist.linear_m_per_s) or any(twist.angular_deg_per_s):
        keys = {"pose": ("", ""), "linear": ("linear_m_per_s", ""), "angular": ("angular_deg_per_s", " (in rad/s)")}
        with place.refusals(keys):
            return Trajectory.from_twist(start, twist.linear_m_per_s, np.radians(twist.angular_deg_per_s))
    return start


if TYPE_CHECKING:
    PoseOverTime = Pose | list[Waypoint] | TrajectoryFile
    Motion = Twist | list[Waypoint] | TrajectoryFile
    PoseOfRun = PoseOverTime | Strips | Stations | Drive
else:
    PoseOverTime = either(either(Pose, TrajectoryFile, has("file")), list[Waypoint], is_list)
    Motion = either(either(Twist, TrajectoryFile, has("file")), list[Waypoint], is_list)
    PoseOfRun = either(
        either(either(PoseOverTime, Strips, has("strips")), Stations, has("stations")), Drive, has("way")
    )
