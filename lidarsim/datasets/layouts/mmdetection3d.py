"""MMDetection3D's custom data set of lidar alone: boxes all around, without a camera.

``points/000000.bin`` holds the points of a frame, float32 x, y, z and intensity; ``labels/000000.txt`` its boxes, one
per line: x, y, z of the middle of the bottom, length, width, height, yaw (from x towards y, rad) and class, in the
frame of the sensor; ``ImageSets/train.txt`` the frames of a split; ``custom_infos_train.pkl`` the information that its
data sets read instead of the labels: the place of the points, and boxes with the numbers of their classes.
``custom.py`` has the classes, in the order of these numbers, and a range for the configuration. Frames are numbered
through all sequences; without splits, all are in ``train``. Splits of other names than train, val and test are in
``ImageSets`` alone. With a rig, each sensor has a folder with all of these.

A tilted box is replaced by the upright box of the same heading around it.

Format: https://github.com/open-mmlab/mmdetection3d/blob/main/docs/en/advanced_guides/customize_dataset.md.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from lidarsim.datasets.layouts._detection import (
    SETS,
    SPLITS,
    Detection,
    classes,
    label_lines,
    point_range,
    upright,
    write_sets,
)
from lidarsim.datasets.layouts._kitti import read_points
from lidarsim.datasets.layouts._layout import Files, Summary, class_name, encode, number_name, root
from lidarsim.datasets.samples import Record, Sample
from lidarsim.io import kitti

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.scan.fields import Fields

POINTS, LABELS, CONFIGURATION = "points", "labels", "custom.py"
BOTTOM = 0.0
"""Where in its height a box of MMDetection3D has its origin."""


class MMDetection3D(Detection):
    """Points and boxes for MMDetection3D's custom data sets of lidar alone."""

    top: ClassVar[tuple[str, ...]] = (SETS, POINTS, LABELS, CONFIGURATION, *map("custom_infos_{}.pkl".format, SPLITS))
    reading: ClassVar[str] = f"""
MMDetection3D reads `custom_infos_train.pkl` and the like as `ann_file`; `{CONFIGURATION}` has the classes and the
range for its configuration. `METAINFO` of the data set's class needs the same classes.
"""

    type: Literal["mmdetection3d"]

    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return points and labels."""
        return {
            f"{root(record.sensor)}{POINTS}/{number_name(record)}.bin": encode(kitti.save, sample.cloud._arrays()),
            f"{root(record.sensor)}{LABELS}/{number_name(record)}.txt": label_lines(
                record.boxes, sample.class_names, BOTTOM
            ).encode(),
        }

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates and intensity."""
        return read_points(store, f"{root(record.sensor)}{POINTS}/{number_name(record)}.bin")

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the frames of each split, their information, and the lines for a configuration."""
        write_sets(files, summary)
        for sensor, names in classes(summary, self).items():
            records = [record for record in summary.records() if record.sensor == sensor]
            for split in SPLITS:
                part = [record for record in records if (record.split or SPLITS[0]) == split]
                infos = {
                    "metainfo": {
                        "dataset": "custom",
                        "info_version": "1.1",
                        "categories": {name: index for index, name in enumerate(names)},
                    },
                    "data_list": [_info(record, names, summary) for record in part],
                }
                files.write(f"{root(sensor)}custom_infos_{split}.pkl", _pickle(infos))
            limits = point_range(box for record in records for box in record.boxes)
            text = f"class_names = {names!r}\nmetainfo = dict(classes=class_names)\npoint_cloud_range = {limits!r}\n"
            files.write(f"{root(sensor)}{CONFIGURATION}", text.encode())


def _info(record: Record, names: Sequence[str], summary: Summary) -> dict[str, Any]:
    """Return the information on a frame, of version 1.1; a class that is not in training has the number -1."""
    kinds = [class_name(box.label, summary.class_names) for box in record.boxes]
    return {
        "sample_idx": record.extra["number"],
        "lidar_points": {"num_pts_feats": 4, "lidar_path": f"{number_name(record)}.bin"},
        "instances": [
            {
                "bbox_3d": upright(box).values(BOTTOM),
                "bbox_label_3d": names.index(kind) if kind in names else -1,
                "num_lidar_pts": box.points,
            }
            for box, kind in zip(record.boxes, kinds, strict=True)
        ],
    }


def _pickle(value: object) -> bytes:
    """Return a pickle that depends on values alone: with memoisation, it would depend on which are the same object."""
    buffer = BytesIO()
    pickler = pickle.Pickler(buffer, protocol=4)
    pickler.fast = True
    pickler.dump(value)
    return buffer.getvalue()
