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

FEW = 512
"""Number of terms up to which `product` is quicker if it makes all of them at once."""


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

    The terms are rounded, then summed in order; `@` leaves that to the BLAS, whose kernels differ between processors.
    """
    if left.size * right.shape[-1] <= FEW:
        small: Floats = (left[..., None] * right[..., None, :, :]).sum(axis=-2)
        return small
    total: Floats = left[..., :1] * right[..., :1, :]
    for k in range(1, left.shape[-1]):
        total = total + left[..., k : k + 1] * right[..., k : k + 1, :]
    return total


def matvec(matrices: Floats, vectors: Floats) -> Floats:
    """Return the products of matrices, of shape (…, n, m), and vectors, of shape (…, m), as `product` does."""
    total: Floats = (matrices * vectors[..., None, :]).sum(axis=-1)
    return total


def inverse(affine: Floats) -> Floats:
    """Return the inverse of an affine map, of shape (4, 4), with the same bits on every processor."""
    cofactors, determinant = _cofactors(affine[:3, :3])
    back = cofactors.T / determinant
    return transforms(back, -matvec(back, affine[:3, 3]))


def nearest_orthogonal(matrix: Floats) -> Floats:
    """Return the orthogonal matrix nearest to an invertible one, (3, 3), with the same bits on every processor.

    That is the orthogonal factor of its polar decomposition, by Newton's iteration X → (X + X⁻ᵀ)/2 (N. J. Higham 1986,
    Computing the polar decomposition, SIAM J. Sci. Stat. Comput. 7). Singular values σ become (σ + 1/σ)/2 ≥ 1, so that
    each step, whose singular values are |σ − 1/σ|/2, is shorter than the last until only rounding errors are left.
    """
    found: Floats = matrix / np.abs(matrix).max()  # so that no cofactor underflows
    before = math.inf
    while True:
        cofactors, determinant = _cofactors(found)
        step = (cofactors / determinant - found) / 2
        length = math.hypot(*step.flat)
        if not length < before:
            return found
        found, before = found + step, length


def _cofactors(matrix: Floats) -> tuple[Floats, float]:
    """Return the cofactors of a matrix, (3, 3), and its determinant."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    of_a, of_b, of_c = e * i - f * h, f * g - d * i, d * h - e * g
    others = (c * h - b * i, a * i - c * g, b * g - a * h), (b * f - c * e, c * d - a * f, a * e - b * d)
    return np.array([(of_a, of_b, of_c), *others]), a * of_a + b * of_b + c * of_c


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
