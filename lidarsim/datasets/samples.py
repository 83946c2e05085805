"""Input of layouts: the measured frame of one sensor, and the record kept for their tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from lidarsim._files import check_name
from lidarsim._validation import Floats

if TYPE_CHECKING:
    from lidarsim.pointcloud import PointCloud
    from lidarsim.run import Run, RunFrame
    from lidarsim.scan import Scan

__all__ = ["RANGES", "Record", "Sample", "samples"]

RANGES = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, np.inf)
"""Edges of the histogram of ranges, m."""

Number = Annotated[int, Field(ge=0, lt=2**63)]
Seconds = Annotated[float, Field(gt=-1e12, lt=1e12)]
"""A time within 30,000 years, whose microseconds fit in tables."""

Rows = Annotated[tuple[Annotated[float, Field(gt=-1e100, lt=1e100)], ...], Field(min_length=12, max_length=12)]
"""The upper three rows of a pose; products of two of them stay finite."""

SensorName = Annotated[str, AfterValidator(lambda name: name and check_name("sensor", name))]


@dataclass(frozen=True)
class Record:
    """A frame of a sensor without its points.

    Attributes
    ----------
    sequence, frame : int
        Numbers, counted from 0.
    sensor : str
        Name in the rig; empty for a single sensor.
    seconds : float
        Time of the cloud: the start of the frame, or the moment to which the points are deskewed, s.
    points : int
        Number of points.
    pose, body : tuple of 12 floats
        Poses of the sensor and of its body at that time, to world: the upper three rows of the matrices.
    extra : dict
        Notes of the layout for its tables.
    """

    sequence: Number
    frame: Number
    sensor: SensorName
    seconds: Seconds
    points: Number
    pose: Rows
    body: Rows
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def matrix(self) -> Floats:
        """Pose of the sensor, shape (4, 4)."""
        return np.array([*self.pose, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)

    @property
    def body_matrix(self) -> Floats:
        """Pose of the body, shape (4, 4)."""
        return np.array([*self.body, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)


@dataclass(frozen=True)
class Sample:
    """A measured frame of a sensor; `cloud` is in the sensor's frame."""

    record: Record
    run: Run
    scan: Scan
    cloud: PointCloud


def samples(run: Run, sequence: int, frame: int, measured: RunFrame) -> Iterator[Sample]:
    """Yield the sample of each sensor in frame number `frame` of a sequence."""
    for name, scan in measured.scans.items():
        cloud, moment, pose = measured.clouds[name], measured.moments[name], measured.poses[name]
        record = Record(sequence, frame, name, moment, len(cloud), _rows(pose), _rows(run.body_pose(moment)))
        yield Sample(record, run, scan, cloud)


def _rows(matrix: Floats) -> tuple[float, ...]:
    return tuple(matrix[:3].ravel().tolist())
