"""Conversion shared by the formats that store orientations as quaternions."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from typing import BinaryIO

import numpy as np

from lidarsim._base.validation import Floats
from lidarsim._base.vectors import transforms

ROUNDED = 0.01
"""Greatest deviation of a quaternion's length from 1, reached by rounding its four numbers to two decimals."""


def poses_of(rows: Iterable[Sequence[float]]) -> tuple[Floats, Floats]:
    """Return times, (n,), and poses, (n, 4, 4), of rows t, x, y, z, qx, qy, qz, qw, at least one."""
    from scipy.spatial.transform import Rotation

    values = array("d")
    for row in rows:
        length = math.hypot(*row[4:])
        if not abs(length - 1.0) <= ROUNDED:
            raise ValueError(f"expected a quaternion (x, y, z, w) of length 1, got one of {length:.6g}")
        values.extend(row)
    if not values:
        raise ValueError("expected poses, got none")
    table = np.frombuffer(values).reshape(-1, 8)
    return table[:, 0].copy(), transforms(Rotation.from_quat(table[:, 4:]).as_matrix(), table[:, 1:4])


def write_poses(times: Floats, poses: Floats, file: BinaryIO, between: str) -> None:
    """Write rows t, x, y, z, qx, qy, qz, qw of times, (n,), and poses, (n, 4, 4)."""
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    table = np.hstack([times[:, None], poses[:, :3, 3], quaternions])
    file.writelines((between.join(map(repr, row)) + "\n").encode("ascii") for row in table.tolist())
