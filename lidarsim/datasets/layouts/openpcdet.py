"""OpenPCDet's custom data set: boxes all around, without a camera.

``points/000000.npy`` holds the points of a frame, float32 x, y, z and intensity; ``labels/000000.txt`` its boxes, one
per line: x, y, z of the centre, length, width, height, heading (from x towards y, rad) and class, in the frame of the
sensor; ``ImageSets/train.txt`` the frames of a split. Frames are numbered through all sequences. Without splits, all
frames are in ``train``; ``val``, which the package needs, is then empty. ``custom_dataset.yaml`` is the configuration
of the data set: its classes, its range, and how training changes it. With a rig, each sensor has a folder with all of
these.

A tilted box is replaced by the upright box of the same heading around it. The package cannot read a file without a
label, so a frame without boxes has one of size 0 of the class DontCare, which it drops.

Format: https://github.com/open-mmlab/OpenPCDet/blob/master/docs/CUSTOM_DATASET_TUTORIAL.md.
"""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import yaml

from lidarsim._base.files import read_array
from lidarsim.datasets.layouts._detection import (
    IGNORED,
    SETS,
    SPLITS,
    Detection,
    classes,
    label_lines,
    point_range,
    write_sets,
)
from lidarsim.datasets.layouts._layout import Files, Summary, encode, number_name, root
from lidarsim.datasets.samples import Record, Sample
from lidarsim.errors import FileFormatError
from lidarsim.io import kitti

if TYPE_CHECKING:
    from lidarsim.datasets.store import Store
    from lidarsim.scan.fields import Fields

POINTS, LABELS, CONFIGURATION = "points", "labels", "custom_dataset.yaml"
COLUMNS = ["x", "y", "z", "intensity"]
NOTHING = f"0 0 0 0 0 0 0 {IGNORED}\n"

EVALUATED = {
    "Pedestrian": ("pedestrian", "person", "walker"),
    "Cyclist": ("cycl", "bike", "rider"),
    "Truck": ("truck", "lorry", "bus"),
}
"""Classes of KITTI's evaluation by words in the names of ours; all others are evaluated as a Car."""


class OpenPCDet(Detection):
    """Points and boxes for OpenPCDet's custom data set."""

    top: ClassVar[tuple[str, ...]] = (SETS, POINTS, LABELS, CONFIGURATION)
    unfit: ClassVar[str] = ":/\\"
    reading: ClassVar[str] = f"""
`{CONFIGURATION}` has the classes and the range for OpenPCDet. With this folder as `data/custom` of a checkout:
`python -m pcdet.datasets.custom.custom_dataset create_custom_infos data/custom/{CONFIGURATION}`.
"""

    type: Literal["openpcdet"]

    def contents(self, record: Record, sample: Sample) -> dict[str, bytes]:
        """Return points and labels."""
        buffer, place, name = BytesIO(), root(record.sensor), number_name(record)
        points = np.frombuffer(encode(kitti.save, sample.cloud._arrays()), "<f4").reshape(-1, len(COLUMNS))
        np.lib.format.write_array(buffer, points, version=(1, 0), allow_pickle=False)
        labels = label_lines(record.boxes, sample.class_names, 0.5) or NOTHING
        return {
            f"{place}{POINTS}/{name}.npy": buffer.getvalue(),
            f"{place}{LABELS}/{name}.txt": labels.encode(),
        }

    def read(self, store: Store, record: Record) -> Fields:
        """Return coordinates and intensity."""
        with store.open(f"{root(record.sensor)}{POINTS}/{number_name(record)}.npy") as file:
            data = file.read()
        points = read_array(BytesIO(data), len(data))
        if points.ndim != 2 or points.shape[1] != len(COLUMNS):
            raise FileFormatError(f"expected rows of {', '.join(COLUMNS)}, got shape {points.shape}")
        return {"xyz": points[:, :3], "intensity": points[:, 3]}

    def finish(self, files: Files, summary: Summary) -> None:
        """Write the frames of each split, and the configuration."""
        write_sets(files, summary)
        for sensor, names in classes(summary, self).items():
            boxes = (box for record in summary.records() if record.sensor == sensor for box in record.boxes)
            text = yaml.safe_dump(_configuration(names, point_range(boxes)), sort_keys=False, default_flow_style=None)
            files.write(f"{root(sensor)}{CONFIGURATION}", text.encode())


def _configuration(names: list[str], limits: list[float]) -> dict[str, Any]:
    """Return the configuration of a data set of some classes and a range."""
    train, val, _ = SPLITS
    augmentations = [
        {
            "NAME": "gt_sampling",
            "USE_ROAD_PLANE": False,
            "DB_INFO_PATH": [f"custom_dbinfos_{train}.pkl"],
            "PREPARE": {"filter_by_min_points": [f"{name}:5" for name in names]},
            "SAMPLE_GROUPS": [f"{name}:15" for name in names],
            "NUM_POINT_FEATURES": len(COLUMNS),
            "DATABASE_WITH_FAKELIDAR": False,
            "REMOVE_EXTRA_WIDTH": [0.0, 0.0, 0.0],
            "LIMIT_WHOLE_SCENE": True,
        },
        {"NAME": "random_world_flip", "ALONG_AXIS_LIST": ["x", "y"]},
        {"NAME": "random_world_rotation", "WORLD_ROT_ANGLE": [-0.78539816, 0.78539816]},
        {"NAME": "random_world_scaling", "WORLD_SCALE_RANGE": [0.95, 1.05]},
    ]
    voxel = [0.1, 0.1, round((limits[5] - limits[2]) / 40, 4)]
    both = {"train": 150_000, "test": 150_000}
    return {
        "DATASET": "CustomDataset",
        "DATA_PATH": "../data/custom",
        "CLASS_NAMES": names,  # for the configuration of the model
        "POINT_CLOUD_RANGE": limits,
        "MAP_CLASS_TO_KITTI": {name: _kitti_class(name) for name in names} | {IGNORED: IGNORED},
        "DATA_SPLIT": {"train": train, "test": val},
        "INFO_PATH": {"train": [f"custom_infos_{train}.pkl"], "test": [f"custom_infos_{val}.pkl"]},
        "POINT_FEATURE_ENCODING": {
            "encoding_type": "absolute_coordinates_encoding",
            "used_feature_list": list(COLUMNS),
            "src_feature_list": list(COLUMNS),
        },
        "DATA_AUGMENTOR": {"DISABLE_AUG_LIST": ["placeholder"], "AUG_CONFIG_LIST": augmentations},
        "DATA_PROCESSOR": [
            {"NAME": "mask_points_and_boxes_outside_range", "REMOVE_OUTSIDE_BOXES": True},
            {"NAME": "shuffle_points", "SHUFFLE_ENABLED": {"train": True, "test": False}},
            {
                "NAME": "transform_points_to_voxels",
                "VOXEL_SIZE": voxel,
                "MAX_POINTS_PER_VOXEL": 5,
                "MAX_NUMBER_OF_VOXELS": both,
            },
        ],
    }


def _kitti_class(name: str) -> str:
    """Return the class of KITTI as which a class is evaluated."""
    return next((kind for kind, words in EVALUATED.items() if any(word in name.lower() for word in words)), "Car")
