"""Products, inverses and rotations that no BLAS computes."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from lidarsim._base.vectors import FEW, inverse, matvec, nearest_orthogonal, product

UNIT = 2.0**-53


@pytest.mark.parametrize("rows", [1, 4, 1 + FEW // 12])
def test_terms_are_rounded_and_summed_in_order(rows: int) -> None:
    draw = np.random.default_rng(rows)
    left, right = draw.normal(size=(rows, 4)), draw.normal(size=(4, 3))
    expected = np.empty((rows, 3))
    for i, j in np.ndindex(rows, 3):
        total = float(left[i, 0]) * float(right[0, j])
        for k in range(1, 4):
            total += float(left[i, k]) * float(right[k, j])
        expected[i, j] = total
    assert np.array_equal(product(left, right), expected)
    assert np.array_equal(product(np.stack([left, -left]), right), np.stack([expected, -expected]))
    assert np.array_equal(matvec(left[None], right[:, 0]), expected[None, :, 0])


def test_the_inverse_of_rotations_and_scales() -> None:
    draw = np.random.default_rng(1)
    for turn in Rotation.random(200, rng=draw).as_matrix():
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = turn * draw.uniform(1.0, 2.0), draw.uniform(-10, 10, 3)
        exact = [[Fraction(x) for x in row] for row in affine.tolist()]
        found = [[Fraction(x) for x in row] for row in inverse(affine).tolist()]
        for i, j in np.ndindex(4, 4):
            off = sum(found[i][k] * exact[k][j] for k in range(4)) - (i == j)
            # Fewer than 64 roundings are on the way, of sums of three products of numbers up to 10 and 2.
            assert abs(off) < 64 * 60 * UNIT


def test_the_nearest_orthogonal_matrix_is_the_factor_of_the_polar_decomposition() -> None:
    draw = np.random.default_rng(2)
    for scale in (2.0**-400, 1e-3, 1.0, 1e3):
        for _ in range(100):
            matrix = scale * draw.normal(size=(3, 3))
            found, (expected, _) = nearest_orthogonal(matrix), polar(matrix)
            assert np.abs(found @ found.T - np.eye(3)).max() < 16 * UNIT  # sums of three products of numbers up to 1
            # A change of the matrix changes the factor by at most 2/(σ₂ + σ₃) of it (N. J. Higham 2008, Functions of
            # Matrices, theorem 8.9); fewer than 64 roundings are on the way, of numbers up to σ₁.
            largest, middle, least = np.linalg.svd(matrix, compute_uv=False)
            assert np.abs(found - expected).max() < 64 * UNIT * 2 * largest / (middle + least)
