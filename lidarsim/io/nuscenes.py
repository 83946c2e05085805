"""Scans of nuScenes (``.pcd.bin``): float32 x, y, z, intensity and ring per point, no header.

Intensity is Velodyne's byte: 0 to 100 for the reflectivity of a diffuse target in percent, up to 255 for
retro-reflectors; brighter points are written as 255, and `PointCloud.save` warns of them. Reading does not convert it
back. `intensity` and `ring` are 0 where the cloud has none; all other fields are lost. The axes are lidarsim's, x
forward; nuScenes' own sensor has y forward, according to its ``calibrated_sensor``.

Files of other columns are read with `columns`, and refused without, as in `lidarsim.io.kitti`; intensities end at 255.

Format: https://github.com/nutonomy/nuscenes-devkit, `LidarPointCloud.from_file`.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from lidarsim.io._records import check_plausible, headerless, write_headerless
from lidarsim.io._units import reflectivity, warn_above, warn_moved
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

NAMES = ("x", "y", "z", "intensity", "ring")
RECORD = np.dtype([(name, "<f4") for name in NAMES])
MOST = 255
"""Greatest intensity."""


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the points one after the other."""
    kept = {name: array for name, array in fields.items() if name in {"xyz", "intensity", "ring"}}
    if "intensity" in kept:
        check_plausible({"intensity": kept["intensity"]}, np.inf, 0)
        kept["intensity"] = reflectivity(kept["intensity"])
    write_headerless(kept, file, RECORD, MOST)


def _save(fields: Fields, file: BinaryIO) -> None:
    warn_above(2.55, fields.get("intensity"), "nuScenes' byte")
    save(fields, file)
    warn_moved(fields["xyz"])


def load(file: BinaryIO, *, columns: list[str] | None = None) -> Fields:
    """Read all points."""
    return headerless(file, columns, NAMES, MOST)


register_format(".pcd.bin", save=_save, load=load)
