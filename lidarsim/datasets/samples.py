"""Input of layouts: the measured frame of one sensor, and the record kept for their tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from lidarsim._base.files import check_name
from lidarsim._base.validation import UINT32, Floats
from lidarsim.scan.scan import moment_and_pose, moment_of

if TYPE_CHECKING:
    from lidarsim.datasets.recipe import Recipe
    from lidarsim.run import Deskew, Run
    from lidarsim.scan.boxes import Boxes
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan

__all__ = ["RANGES", "Annotation", "Record", "Sample", "samples"]

RANGES = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, np.inf)
"""Edges of the histogram of ranges, m."""

UNIT32 = 2.0**-24
"""Unit roundoff of float32."""

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
    """The box of a thing in a sample, as in `lidarsim.Boxes`, in the frame of the sample's cloud.

    Attributes
    ----------
    instance, label, points : int
        Instance number of the thing, its label, and the number of points on it.
    center, size, velocity : tuple of 3 floats
        Centre and size of the box, m, and velocity, m/s. The size allows for the rounding of points to float32.
    rotation : tuple of 9 floats
        Rows of the matrix with the axes of the box in its columns.
    visibility : float or None
        Share of the thing's pulses that reach it; None if no pulse would hit it.
    truncation : float
        Share of the thing outside of the sensor's field of view.
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
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = np.reshape(self.rotation, (3, 3)), self.center
        return matrix


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
        Boxes of the things, if the layout has boxes.
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


def samples(recipe: Recipe, run: Run, sequence: int, frame: int, scans: Mapping[str, Scan]) -> Iterator[Sample]:
    """Yield the sample of each sensor in frame number `frame` of a sequence.

    In a layout with boxes, the points of moving things are moved along when a cloud is deskewed. If all sensors of the
    frame share its stamp in the layout, all clouds are deskewed to that of the first sensor.
    """
    layout, split = recipe.layout, recipe.splits.of(sequence)
    frame_of, given = run.cloud["frame"], run.cloud["deskew"]
    fields = None if layout.held is None else {*layout.held, "range", "label"}
    stamp = None
    for name, scan in scans.items():
        deskew: Deskew = given if stamp is None else stamp - scan.time
        moment, pose = moment_and_pose(scan, deskew=deskew)
        if layout.shares_stamp(frame) and moment_of(given, 1.0) is not None:
            stamp = moment
        boxes: tuple[Annotation, ...] = ()
        body = run.body_pose(moment)
        if layout.kept is None:
            cloud = scan.point_cloud(frame_of, deskew=deskew, fields=fields)
        else:
            moves = moment_of(deskew, 1.0) is not None
            cloud = scan.point_cloud(frame_of, deskew=deskew, deskew_movers=moves, fields=fields)
            found = scan.boxes(frame=frame_of, deskew=deskew, min_points=layout.least_points)
            here = body[:3, 3] if frame_of == "world" else (np.linalg.inv(pose) @ body)[:3, 3]
            boxes = _annotations(found[layout.kept.of(found, here, recipe.class_names)])
        record = Record(sequence, frame, name, moment, len(cloud), _rows(pose), _rows(body), split, boxes)
        yield Sample(record, run, scan, cloud, sequence * recipe.frames + frame, recipe.class_names)


def _rows(matrix: Floats) -> tuple[float, ...]:
    return tuple(matrix[:3].ravel().tolist())


def _annotations(boxes: Boxes) -> tuple[Annotation, ...]:
    """Return the boxes, with room for points in float32.

    Points and centre have coordinates of at most `reach`, and each of these is rounded by at most `UNIT32` of it. In
    the axes of the box, the difference of two then moves by less than √3 times both, and a box grows at both ends.
    """
    reach = np.abs(boxes.center).max(axis=1, initial=0.0) + np.linalg.norm(boxes.size, axis=1)
    size = boxes.size + 2.0 * np.sqrt(3.0) * 2.0 * UNIT32 * reach[:, None]
    seen = [None if np.isnan(share) else share for share in boxes.visibility.tolist()]
    three = zip(boxes.center.tolist(), size.tolist(), boxes.velocity.tolist(), strict=True)
    return tuple(
        Annotation(
            instance=instance,
            label=label,
            points=points,
            center=tuple(center),
            size=tuple(extent),
            velocity=tuple(velocity),
            rotation=tuple(rotation),
            visibility=visibility,
            truncation=outside,
            time=time,
        )
        for instance, label, points, (center, extent, velocity), rotation, visibility, outside, time in zip(
            boxes.instance.tolist(),
            boxes.label.tolist(),
            boxes.points.tolist(),
            three,
            boxes.rotation.reshape(-1, 9).tolist(),
            seen,
            boxes.truncation.tolist(),
            boxes.time.tolist(),
            strict=True,
        )
    )
