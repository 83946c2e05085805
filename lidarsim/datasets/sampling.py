"""The samples of a data set, from the scans of its runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from lidarsim._base.validation import Floats, short_repr
from lidarsim._base.vectors import inverse, product
from lidarsim.datasets.draws import Stream
from lidarsim.datasets.frames import boxes_at
from lidarsim.datasets.samples import Annotation, Record, Sample
from lidarsim.errors import ArgumentValueError
from lidarsim.scan.scan import moment_and_pose, moment_of

if TYPE_CHECKING:
    from lidarsim.datasets.recipe import Recipe
    from lidarsim.run import Deskew, Run
    from lidarsim.scan.boxes import Boxes
    from lidarsim.scan.pointcloud import PointCloud
    from lidarsim.scan.scan import Scan

UNIT32 = 2.0**-24
"""Unit roundoff of float32."""


def samples(recipe: Recipe, run: Run, sequence: int, frame: int, scans: Mapping[str, Scan]) -> Iterator[Sample]:
    """Yield the sample of each sensor in frame number `frame` of a sequence.

    In a layout with boxes, the points of moving instances are moved along when a cloud is deskewed. If all sensors of
    the frame share its stamp in the layout, all clouds are deskewed to that of the first sensor. `after_scan` gets all
    columns; the boxes then count the points that it leaves.
    """
    layout, split, change = recipe.layout, recipe.splits.of(sequence), recipe.after_scan
    frame_of, given = run.cloud["frame"], run.cloud["deskew"]
    held = {*(layout.columns or ()), "range", "label"}
    fields = None if layout.columns is None or change else held
    stamp = None
    for name, scan in scans.items():
        deskew: Deskew = given if stamp is None else stamp - scan.time
        moment, pose = moment_and_pose(scan, deskew=deskew)
        if layout.shares_stamp(frame) and moment_of(given, 1.0) is not None:
            stamp = moment
        found: Boxes | None = None
        body = run.body_pose(moment)
        if layout.box_filter is None:
            cloud = scan.point_cloud(frame_of, deskew=deskew, fields=fields)
        else:
            moves = moment_of(deskew, 1.0) is not None
            cloud = scan.point_cloud(frame_of, deskew=deskew, deskew_movers=moves, fields=fields)
            labels = layout.box_filter.labels(recipe.class_names)
            found = scan.boxes(frame=frame_of, deskew=deskew, min_points=layout.least_points, labels=labels)
            here = body[:3, 3] if frame_of == "world" else product(inverse(pose), body)[:3, 3]
            found = found[layout.box_filter.of(found, here)]
        if change:
            needed = (held & {*cloud.fields}) | ({"instance"} if layout.box_filter else set())
            if found is not None and scan.mirrored_point is not None:
                cloud.mirrored = ~np.isnan(scan.mirrored_point[scan._returned][:, 0])
                needed |= {"mirrored"}
            stream = Stream(recipe.seed, f"after_scan.{name}", sequence, frame)
            cloud = change.apply(cloud, np.random.Generator(stream.bits), sorted(needed))
            if missing := [field for field in layout.columns or () if field not in cloud.fields]:
                raise ArgumentValueError("fields", f"some of {', '.join(cloud.fields)}", short_repr(missing[0]))
            if found is not None:
                counts = _counts(cloud, found)
                found = dataclasses.replace(found, points=counts)[counts >= layout.least_points]
        if found is not None and frame_of == "sensor":  # world coordinates are written in float64
            found = _round_up(found)
        boxes = () if found is None else _annotations(found)
        record = Record(sequence, frame, name, moment, len(cloud), _rows(pose), _rows(body), split, boxes)
        yield Sample(record, run, scan, cloud, sequence * recipe.frames + frame, recipe.class_names)


def _counts(cloud: PointCloud, boxes: Boxes) -> npt.NDArray[np.int64]:
    """Return the number of points on the instance of each box, without ghosts in mirrors."""
    on = cloud.instance[~cloud.mirrored.astype(bool)] if "mirrored" in cloud.fields else cloud.instance
    instances, counts = np.unique(on, return_counts=True)
    index = np.minimum(np.searchsorted(instances, boxes.instance), len(instances) - 1)
    if not len(instances):
        return np.zeros(len(boxes), np.int64)
    return np.where(instances[index] == boxes.instance, counts[index], 0).astype(np.int64)


def _rows(matrix: Floats) -> tuple[float, ...]:
    return tuple(matrix[:3].ravel().tolist())


def boxes_of(annotations: Sequence[Annotation], names: Mapping[int, str]) -> Boxes:
    """Return the boxes that annotations describe, in the same coordinates."""
    more = {name: [getattr(box, name) for box in annotations] for name in ("instance", "points", "truncation", "time")}
    return boxes_at(
        np.array([box.center for box in annotations]),
        np.array([box.size for box in annotations]),
        np.array([box.rotation for box in annotations]),
        [box.label for box in annotations],
        names,
        velocity=np.reshape([box.velocity for box in annotations], (-1, 3)),
        visibility=[np.nan if box.visibility is None else box.visibility for box in annotations],
        **more,
    )


def _round_up(boxes: Boxes) -> Boxes:
    """Return the boxes with room for points in float32.

    Points and centre have coordinates of at most `reach`, and each of these is rounded by at most `UNIT32` of it. In
    the axes of the box, the difference of two then moves by less than √3 times both, and a box grows at both ends.
    """
    reach = np.abs(boxes.center).max(axis=1, initial=0.0) + np.linalg.norm(boxes.size, axis=1)
    return dataclasses.replace(boxes, size=boxes.size + 2.0 * np.sqrt(3.0) * 2.0 * UNIT32 * reach[:, None])


def _annotations(boxes: Boxes) -> tuple[Annotation, ...]:
    seen = [None if np.isnan(share) else share for share in boxes.visibility.tolist()]
    three = zip(boxes.center.tolist(), boxes.size.tolist(), boxes.velocity.tolist(), strict=True)
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
