"""Scans of nuScenes (``.pcd.bin``): float32 x, y, z, intensity and ring per point, no header.

Intensity is Velodyne's byte, 0 to 100 for the reflectivity of a diffuse target in percent, up to 255 for
retro-reflectors, and is not converted back when the file is read. `intensity` and `ring` are 0 where the cloud has
none; all other fields are lost. The axes are lidarsim's, x forward: nuScenes' own sensor has y forward, as its
``calibrated_sensor`` says.

Format: https://github.com/nutonomy/nuscenes-devkit, `LidarPointCloud.from_file`.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from lidarsim.io._records import blocks, from_records, joined, to_columns, to_fields, to_records
from lidarsim.io._units import reflectivity
from lidarsim.pointcloud import Fields, register_format

RECORD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity", "ring")])


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the points one after the other."""
    kept = {name: array for name, array in fields.items() if name in {"xyz", "intensity", "ring"}}
    for block in blocks(kept):
        if "intensity" in block:
            block["intensity"] = reflectivity(block["intensity"])
        columns = to_columns(block, (), {"f4", "f8", "u1", "u2"})
        file.writelines(records.data for records in to_records(columns, RECORD))


def load(file: BinaryIO) -> Fields:
    """Read all points."""
    return joined(to_fields(block, (), xyz=np.float32) for block in from_records(file, RECORD))


register_format(".pcd.bin", save=save, load=load)
