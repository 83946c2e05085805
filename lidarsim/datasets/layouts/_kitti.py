"""What layouts take from KITTI: the axes of its camera, its calibrations, and its files of points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from lidarsim.io import kitti

if TYPE_CHECKING:
    from lidarsim._base.validation import Floats
    from lidarsim.datasets.store import Store
    from lidarsim.scan.fields import Fields

TO_CAMERA = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Sensor to camera, whose x points right, y down and z forward."""


def calibration(matrices: Mapping[str, Floats]) -> bytes:
    """Return a file of matrices, one per line, in the order of their rows."""
    rows = (f"{name}: {' '.join(f'{value:.12e}' for value in matrix.flat)}\n" for name, matrix in matrices.items())
    return "".join(rows).encode()


def read_points(store: Store, name: str) -> Fields:
    """Return the fields of a file of float32 x, y, z and intensity."""
    with store.reading(name) as path, path.open("rb") as file:
        return kitti.load(file, columns=list(kitti.NAMES))
