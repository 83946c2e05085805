"""KITTI's scans (``.bin``), also SemanticKITTI's and KITTI-360's: float32 x, y, z and remission per point, no header.

Remission is `intensity` unchanged, or 0 without one; KITTI's own ends at 1, which a retro-reflector exceeds.
All other fields are lost, and float32 keeps 0.1 mm up to 1 km only: save the cloud in the sensor's frame, as KITTI
does. The labels are another file: `lidarsim.io.semantickitti`.

Format: the KITTI raw data development kit, readme.txt; https://github.com/PRBonn/semantic-kitti-api.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from lidarsim.io._records import from_records, joined, to_columns, to_fields, to_records
from lidarsim.pointcloud import Fields, register_format

RECORD = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the points one after the other."""
    kept = {name: array for name, array in fields.items() if name in {"xyz", "intensity"}}
    file.writelines(records.data for records in to_records(to_columns(kept, (), {"f4", "f8"}), RECORD))


def load(file: BinaryIO) -> Fields:
    """Read all points."""
    return joined(to_fields(block, (), xyz=np.float32) for block in from_records(file, RECORD))


register_format(".bin", save=save, load=load)
