"""Ways of instances: where an instance may start, the path that it follows, and its poses from there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim.datasets.draws import Stream
from lidarsim.datasets.scatter._group import Scatter
from lidarsim.datasets.scatter._paths import Path
from lidarsim.datasets.scatter._travel import Constant, Profile, Travel

if TYPE_CHECKING:
    from lidarsim.config.document import Place

__all__ = ["Way"]


class Way:
    """Possible starts of an object of a group, and its travel from there."""

    def __init__(self, group: Scatter, stream: Stream, times: Floats, place: Place) -> None:
        self.group = group
        self.yaw = np.radians(group.draw("yaw_deg", stream, place))
        speed: Constant | Profile
        if isinstance(group.speed_m_per_s, list):
            speed = Profile(np.array(group.speed_m_per_s))
        else:
            speed = Constant(group.draw("speed_m_per_s", stream, place))
        self.travel = Travel(speed, times, along=bool(group.paths))
        offset = group.draw("offset_m", stream, place)
        self.path: Path | None = None
        if self.travel.along:
            number = stream.integer(0, len(group.paths) - 1) if len(group.paths) > 1 else 0
            path, length = group.paths[number], float(self.travel.distance[-1])
            if path.length < length and group.along_m is not None:  # a street draws its ways, and may have longer ones
                raise (place / "along_m").error(
                    f"expected a path as long as the way in a sequence, {length:.4g} m, got {path.length:.4g} m"
                )
            self.path = path.beside(offset)
            self.room = -math.inf if self.path is None else self.path.length - length

    def poses(self, stream: Stream) -> Floats | None:
        """Draw a start, and return the poses at all times, (k, 4, 4), at height 0; None if that has no room."""
        distance, back = self.travel.distance, self.travel.back
        if not self.travel.along:
            (x0, y0), (x1, y1) = np.asarray(self.group.area_m)
            start = np.array([stream.uniform(x0, x1), stream.uniform(y0, y1)])
            ahead = np.array([np.cos(self.yaw), np.sin(self.yaw)])
            signed = -distance if back else distance
            return _upright(start + signed[:, None] * ahead, np.full(len(signed), self.yaw))
        if self.path is None or self.room < 0:
            return None
        at = stream.uniform(0.0, self.room) + distance
        if back != (np.cos(self.yaw) < 0):  # they go where they head
            at = self.path.length - at
        position, tangent = self.path.at(at)
        return _upright(position, np.arctan2(tangent[:, 1], tangent[:, 0]) + self.yaw + np.pi * back)


def _upright(position: Floats, yaw: Floats) -> Floats:
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :2, 3] = position
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(yaw)
    poses[:, 1, 0] = np.sin(yaw)
    poses[:, 0, 1] = -poses[:, 1, 0]
    return poses
