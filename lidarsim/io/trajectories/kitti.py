"""KITTI poses: the upper three rows of a 4×4 matrix per line, without times.

Format: https://www.cvlibs.net/datasets/kitti/eval_odometry.php.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from typing import BinaryIO

import numpy as np

from lidarsim._base.lines import numbers
from lidarsim._base.validation import Floats
from lidarsim.motion.formats import register_trajectory_format

COLUMNS = 12
ROUNDED = 0.02
"""Greatest deviation of the dot product of two rows of a rotation from 0 or 1. Rounded to two decimals, each number is
off by at most 0.005, each row by √3 · 0.005 = r, and the product by 2r + r² < 0.0175."""


def recognise(line: str) -> bool:
    """Return whether `line` is the first line of KITTI poses."""
    return len(line.split()) == COLUMNS


def read(lines: Iterator[str]) -> tuple[None, Floats]:
    """Return poses whose rotations are the nearest to the matrices in the file."""
    from scipy.spatial.transform import Rotation

    values = array("d")
    for line in lines:
        row = numbers(line.split(), COLUMNS)
        _check_rotation(row[0:3], row[4:7], row[8:11])
        values.extend(row)
        values.extend((0.0, 0.0, 0.0, 1.0))
    poses = np.frombuffer(values).reshape(-1, 4, 4).copy()
    poses[:, :3, :3] = Rotation.from_matrix(poses[:, :3, :3]).as_matrix()
    return None, poses


def _check_rotation(x: Sequence[float], y: Sequence[float], z: Sequence[float]) -> None:
    """Raise an error unless three rows form a rotation, up to rounding to two decimals."""
    products = [(_dot(a, b), float(a is b)) for a, b in ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))]
    error = max(abs(got - wanted) for got, wanted in products)
    normal = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    if not (error <= ROUNDED and _dot(normal, z) > 0.0):
        raise ValueError(
            f"expected a rigid transform (orthonormal rotation), got one {error:.3g} away from it,"
            f" determinant {_dot(normal, z):.6g}"
        )


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def write(times: Floats, poses: Floats, file: BinaryIO) -> None:
    """Write poses; the format has no place for their times."""
    del times
    file.writelines(
        (" ".join(map(repr, row)) + "\n").encode("ascii") for row in poses[:, :3].reshape(-1, COLUMNS).tolist()
    )


register_trajectory_format(
    "KITTI", "the 12 numbers of a 3×4 matrix in each line", recognise, read, suffixes=(".kitti",), write=write
)
