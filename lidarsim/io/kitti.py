"""Scans of KITTI, SemanticKITTI and KITTI-360 (``.bin``): float32 x, y, z and remission per point, no header.

Remission is `intensity`, or 0 without one, and at most 1: brighter points, such as retro-reflectors, are written as 1,
and `PointCloud.save` warns of them. All other fields are lost, and float32 keeps 0.1 mm only up to 1 km: save the cloud
in the sensor's frame, as KITTI does. Labels have their own file: `lidarsim.io.semantickitti`.

Other programs write other columns under the same suffix:
``PointCloud.load("a.bin", columns=("x", "y", "z", "intensity", "ring", "time"))`` reads six. Without `columns`, numbers
that cannot be these four are refused: their distribution is that of other columns, a coordinate is the bits of an
integer, or an intensity is not within 0 to 65,535. Eight columns can pass for twice as many points of four.

Format: the KITTI raw data development kit, readme.txt; https://github.com/PRBonn/semantic-kitti-api.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from lidarsim.io._records import headerless, write_headerless
from lidarsim.io._units import warn_above, warn_moved
from lidarsim.scan.fields import Fields
from lidarsim.scan.formats import register_format

NAMES = ("x", "y", "z", "intensity")
RECORD = np.dtype([(name, "<f4") for name in NAMES])
MOST = 65_535
"""Greatest intensity of other programs, which write uint16; KITTI's is 1."""


def save(fields: Fields, file: BinaryIO) -> None:
    """Write the points one after the other."""
    kept = {"xyz": fields["xyz"]}
    if "intensity" in fields:
        kept["intensity"] = np.minimum(fields["intensity"], np.float32(1))
    write_headerless(kept, file, RECORD, MOST)


def _save(fields: Fields, file: BinaryIO) -> None:
    warn_above(1.0, fields.get("intensity"), "KITTI's remission")
    save(fields, file)
    warn_moved(fields["xyz"])


def load(file: BinaryIO, *, columns: list[str] | None = None) -> Fields:
    """Read all points."""
    return headerless(file, columns, NAMES, MOST)


register_format(".bin", save=_save, load=load)
