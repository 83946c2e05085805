"""Input of layouts: the measured frame of one sensor, and the record kept for their tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from lidarsim._base.files import check_name
from lidarsim._base.validation import UINT32, Floats
from lidarsim._base.vectors import transforms

if TYPE_CHECKING:
    from lidarsim.run import Run
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan

RANGES = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, np.inf)
"""Edges of the histogram of ranges, m."""

Number = Annotated[int, Field(ge=0, lt=2**63)]
Seconds = Annotated[float, Field(gt=-1e12, lt=1e12)]
"""A time within 30,000 years, whose microseconds fit in tables."""

Length = Annotated[float, Field(gt=-1e100, lt=1e100)]
"""A number of which products of two stay finite."""

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Three = Annotated[tuple[Length, ...], Field(min_length=3, max_length=3)]
Nine = Annotated[tuple[Length, ...], Field(min_length=9, max_length=9)]

Rows = Annotated[tuple[Length, ...], Field(min_length=12, max_length=12)]
"""The upper three rows of a pose."""

Named = Annotated[str, AfterValidator(lambda name: name and check_name("name", name))]
"""Empty, or a name that files can have."""


@dataclass(frozen=True)
class Annotation:
    """The box of an instance in a sample, as in `lidarsim.Boxes`, in the frame of the sample's cloud.

    Attributes
    ----------
    instance, label, points : int
        Instance number, label, and number of points.
    center, size, velocity : tuple of 3 floats
        Centre and size of the box, m, and velocity, m/s. The size allows for the rounding of points.
    rotation : tuple of 9 floats
        Rows of the matrix with the axes of the box in its columns.
    visibility : float or None
        Share of the instance's pulses that reach it; None if no pulse would hit it.
    truncation : float
        Share of the instance outside of the sensor's field of view.
    time : float
        Moment of the box, s.
    """

    instance: Number
    label: Annotated[int, Field(ge=0, le=UINT32)]
    points: Number
    center: Three
    size: Three
    rotation: Nine
    velocity: Three
    visibility: Share | None
    truncation: Share
    time: Seconds

    @property
    def matrix(self) -> Floats:
        """Pose of the box, shape (4, 4)."""
        return transforms(np.reshape(self.rotation, (3, 3)), self.center)


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
    split : str
        Split of the sequence; empty without splits.
    boxes : tuple of Annotation
        Boxes of the instances, if the layout has boxes.
    extra : dict
        Notes of the layout for its tables.
    """

    sequence: Number
    frame: Number
    sensor: Named
    seconds: Seconds
    points: Number
    pose: Rows
    body: Rows
    split: Named = ""
    boxes: tuple[Annotation, ...] = ()
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
    """A measured frame of a sensor.

    Attributes
    ----------
    record : Record
        What the tables need to know of it.
    run : Run
        Its run.
    scan : Scan
        The scan.
    cloud : PointCloud
        The points in the coordinates of the run, with the fields that the layout holds, `range` and `label`.
    number : int
        Number of the frame among those of all sequences.
    class_names : mapping of int to str
        Class names of the recipe by label.
    """

    record: Record
    run: Run
    scan: Scan
    cloud: PointCloud
    number: int
    class_names: Mapping[int, str]
