"""Vectors, matrices and random numbers with the same bits on every machine."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from lidarsim import _native
from lidarsim._base import validation
from lidarsim._base.validation import Floats
from lidarsim.errors import ArgumentValueError

CUBE = np.array(list(np.ndindex(2, 2, 2))) - 0.5
"""Corners of the cube of edge 1 around the origin."""


def sigmas_of_axes(name: str, value: npt.ArrayLike) -> Floats:
    """Return the standard deviations of three axes, given as one or three."""
    given = np.broadcast_to(validation.one_or_each(name, value, 3), 3)
    if (given < 0.0).any():
        raise ArgumentValueError(name, "numbers >= 0", f"{given.min():g}")
    return given


def gauss_markov(times: Floats, scale: float, seed: int) -> Floats:
    """Return six stationary Gauss-Markov processes of unit variance at some times, shape (n, 6)."""
    normal = normals(np.random.Philox(key=seed), (len(times), 6))
    kept = np.exp(-np.diff(times) / scale)
    fresh = np.sqrt(-np.expm1(-2.0 * np.diff(times) / scale))
    errors = normal.copy()
    for k, (old, new) in enumerate(zip(kept.tolist(), fresh.tolist(), strict=True), 1):
        errors[k] = old * errors[k - 1] + new * normal[k]
    return errors


def normals(bits: np.random.Philox, shape: tuple[int, ...]) -> Floats:
    """Return standard normal numbers of a shape: the quantiles of the next numbers of `bits`, in order.

    The bits are the same on every machine and in every version of NumPy.
    """
    cells = bits.random_raw(math.prod(shape)) >> np.uint64(12)
    return _native.normal_quantile((cells.astype(np.float64) + 0.5) * 2.0**-52).reshape(shape)


def product(left: Floats, right: Floats) -> Floats:
    """Return the products of matrices, of shape (…, n, m) and (…, m, k), with the same bits on every processor.

    The terms are summed in order.
    """
    terms = left[..., None] * right[..., None, :, :]
    total: Floats = terms[..., 0, :]
    for k in range(1, terms.shape[-2]):
        total = total + terms[..., k, :]
    return total


def turned_about_y(point: npt.ArrayLike, angle: Floats) -> Floats:
    """Return poses at a point, turned about the y axis: a positive angle turns what hangs down to the back."""
    poses = np.tile(np.eye(4), (len(angle), 1, 1))
    poses[:, :3, 3] = point
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angle)
    poses[:, 0, 2] = np.sin(angle)
    poses[:, 2, 0] = -poses[:, 0, 2]
    return poses


def transforms(linear: npt.ArrayLike, shift: npt.ArrayLike) -> Floats:
    """Return the transforms of a linear part, of shape (…, 3, 3), and a shift, of shape (…, 3): shape (…, 4, 4)."""
    linear = np.asarray(linear)
    matrices = np.zeros((*linear.shape[:-2], 4, 4))
    matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = linear, shift, 1.0
    return matrices
