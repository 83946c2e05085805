"""Splines of rotations: orientations with continuous angular velocity and angular acceleration.

Between two rotations, with u = (t − tᵢ)/(tᵢ₊₁ − tᵢ) from 0 to 1, the orientation is Rᵢ exp(φ(u)), where φ is a cubic
from 0 to the rotation vector of RᵢᵀRᵢ₊₁. With ω the angular velocity in the rotating frame and A = J⁻¹,

    ω = J(φ)φ̇,   J(φ) = I − b[φ] + c[φ]²,   b = (1 − cos θ)/θ²,   c = (θ − sin θ)/θ³,   θ = |φ|,

and the angular acceleration is J(φ)φ̈ + N(φ, φ̇), N = J̇φ̇. A step with rotation vector r and duration h has φ̇ = ω at its
start and φ̇ = A(r)ω at its end. As J(r)r = r, the angular acceleration is continuous at knot i, between the steps (r, h)
and (r′, h′), if

    ½α J(r)ωᵢ₋₁ + ωᵢ + ½β A(r′)ωᵢ₊₁ + g N(r, A(r)ωᵢ) = 3/2 (α r/h + β r′/h′),
    α = h′/(h + h′),   β = h/(h + h′),   g = hh′/(4(h + h′)).

The first and the last angular velocity are the mean velocities r/h of the first and the last step.

These are the splines of `scipy.spatial.transform.RotationSpline` (N. Mayorov, Smooth Attitude Interpolation, 2019:
https://github.com/scipy/scipy/files/2932755/attitude_interpolation.pdf), which takes ten steps of a fixed-point
iteration and does not report whether they converged. Here Newton's method solves the equations to rounding. They are
linear except for N, which is quadratic in ω. If the method does not converge from the solution without N, N is
introduced gradually (numerical continuation: J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed., §11.3).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial

from lidarsim._base.validation import Floats

EPS = float(np.finfo(float).eps)

SMALLEST_STEP = 2.0**-10
"""Smallest step of the continuation; it limits the work, not the accuracy."""

MOST_ITERATIONS = 50
"""Maximum number of Newton iterations, another limit of work; once converging, each doubles the correct digits."""


class NoSplineError(Exception):
    """No solution of the equations was found; `knot` is the one with the largest residual."""

    def __init__(self, knot: int) -> None:
        super().__init__(knot)
        self.knot = knot


def rotation_steps(lengths: Floats, turns: Floats) -> Floats:
    """Return the cubics of the rotation vectors.

    Parameters
    ----------
    lengths : ndarray of float64, shape (n,)
        Time from each knot to the next, s; n >= 2.
    turns : ndarray of float64, shape (n, 3)
        Rotation vector from each knot to the next, of length at most π.

    Returns
    -------
    ndarray of float64, shape (n, 3, 3)
        Coefficients of u, u² and u³ for each step.

    Raises
    ------
    NoSplineError
        If no solution of the equations was found.
    """
    h = (lengths / lengths.max())[:, None]
    with np.errstate(all="ignore"):  # infinity and NaN never pass as a solution
        equations = _Equations(h, turns)
        rates = equations.solution()
        start, end = h * rates[:-1], h * _times(equations.inverses, rates[1:])
        return np.stack([start, 3 * turns - 2 * start - end, start + end - 2 * turns], axis=1)


def angular_accelerations(turns: Floats, rates: Floats, bends: Floats) -> Floats:
    """Return the angular accelerations J(φ)φ̈ + N(φ, φ̇) in the rotating frame.

    The arguments are φ and its first and second derivatives, all of shape (n, 3).
    """
    b, c, _, _ = _factors(turns)
    once = np.cross(turns, bends)
    accelerations: Floats = bends - b * once + c * np.cross(turns, once) + _quadratic(turns, rates)
    return accelerations


class _Equations:
    """The equations at the inner knots for the angular velocities at all knots, shape (n + 1, 3)."""

    def __init__(self, h: Floats, turns: Floats) -> None:
        self.means = turns / h
        self.alpha, self.beta = h[1:] / (h[:-1] + h[1:]), h[:-1] / (h[:-1] + h[1:])
        self.g = h[:-1] * self.alpha / 4
        matrices = _rate_matrices(turns)
        self.inverses = np.linalg.inv(matrices).astype(np.float64, copy=False)
        self.before = self.alpha[:, :, None] / 2 * matrices[:-1]
        self.after = self.beta[:, :, None] / 2 * self.inverses[1:]
        self.turns = turns
        self.right = 1.5 * (self.alpha * self.means[:-1] + self.beta * self.means[1:])

    def solution(self) -> Floats:
        """Return the angular velocities."""
        rates = np.concatenate([self.means[:1], self.means])
        solved = self.improve(rates, 0.0)
        share, step = 0.0, 1.0
        while solved is not None:
            rates, solved = solved, None
            if share == 1.0:
                return rates
            while solved is None and step >= SMALLEST_STEP:
                solved = self.improve(rates, share + step)
                step = step if solved is not None else step / 2
            share, step = share + step, min(2 * step, 1.0 - share - step)
        raise NoSplineError(1 + int(np.argmax(self.excess(rates, 1.0))))

    def improve(self, rates: Floats, share: float) -> Floats | None:
        """Return the solution for this share of N by Newton's method, or None if it does not converge."""
        from scipy.linalg import solve_banded

        shrunk = math.inf
        for _ in range(MOST_ITERATIONS):
            residual = self.residual(rates, share)
            is_solved = bool(np.all(self.excess(rates, share) <= 1.0))
            try:
                change = solve_banded((5, 5), self.jacobian(rates, share), residual.ravel()).reshape(-1, 3)
            except (ValueError, np.linalg.LinAlgError):  # not finite; singular
                return None
            rates = rates.copy()
            rates[1:-1] -= change
            if is_solved:
                return rates
            # Below √ε of the largest velocity, changes need not halve: they are rounding, or in smaller velocities.
            size = float(np.abs(change).max())
            if not size <= max(shrunk / 2, math.sqrt(EPS) * float(np.abs(rates).max())):
                return None
            shrunk = size
        return None

    def residual(self, rates: Floats, share: float) -> Floats:
        """Return the left sides, with this share of N, minus the right sides: shape (n - 1, 3)."""
        linear = _times(self.before, rates[:-2]) + rates[1:-1] + _times(self.after, rates[2:]) - self.right
        return linear + share * self.g * _quadratic(self.turns[:-1], _times(self.inverses[:-1], rates[1:-1]))

    def excess(self, rates: Floats, share: float) -> Floats:
        """Return the residual at each inner knot in units of its rounding: shape (n - 1,).

        With u = ε/2, the error of a matrix is 8u of its norm; its product with a vector adds 3u, and the sum of the
        terms, right side included, 5u; N takes five such products. So the error of each term is less than 32u of its
        bound, which follows from |J| <= 1, |A| = (θ/2)/sin(θ/2) <= π/2 and |N| <= (θ/12 + θ²/60 + 1/6)θ|φ̇|² < θ|φ̇|².
        """
        size = np.linalg.norm(rates, axis=1, keepdims=True)
        curved = (math.pi / 2 * size[1:-1]) ** 2 * np.linalg.norm(self.turns[:-1], axis=1, keepdims=True)
        terms = self.alpha / 2 * size[:-2] + size[1:-1] + math.pi / 4 * self.beta * size[2:]
        terms = terms + np.linalg.norm(self.right, axis=1, keepdims=True) + share * self.g * curved
        off = np.linalg.norm(self.residual(rates, share), axis=1)
        bound = 16 * EPS * terms[:, 0]
        return np.where(off <= bound, 0.0, off / bound)

    def jacobian(self, rates: Floats, share: float) -> Floats:
        """Return the Jacobian of the residual for the inner angular velocities, in the band form of `solve_banded`."""
        count = len(self.g)
        inverses = self.inverses[:-1]
        bent = _quadratic_derivative(self.turns[:-1], _times(inverses, rates[1:-1])) @ inverses
        blocks = np.stack([np.zeros_like(bent), np.eye(3) + share * self.g[:, :, None] * bent, np.zeros_like(bent)])
        blocks[0, 1:], blocks[2, :-1] = self.before[1:], self.after[:-1]
        banded = np.zeros((11, count, 3))
        for k, side in enumerate((-1, 0, 1)):
            for i in range(3):
                for j in range(3):
                    # The element in row 3m + i and column 3(m + side) + j is stored in band 5 + row - column.
                    places = slice(max(side, 0), count + min(side, 0))
                    values = slice(max(-side, 0), count + min(-side, 0))
                    banded[5 + i - j - 3 * side, places, j] = blocks[k, values, i, j]
        return banded.reshape(11, -1)


def _factors(turns: Floats) -> Floats:
    """Return b, c, (db/dθ)/θ and (dc/dθ)/θ of rotation vectors of shape (n, 3): (4, n, 1).

    Up to θ = 1, where the quotients would cancel, power series are used; their first omitted term is below 1/22! < ε/2:
    b = Σ (−θ²)ᵏ/(2k + 2)!, c = Σ (−θ²)ᵏ/(2k + 3)!.
    """
    square = np.sum(turns**2, axis=1, keepdims=True)
    angle = np.sqrt(np.maximum(square, 1.0))
    sine, cosine = np.sin(angle), np.cos(angle)
    quotients = [
        (1 - cosine) / angle**2,
        (angle - sine) / angle**3,
        (angle * sine - 2 * (1 - cosine)) / angle**4,
        (3 * sine - angle * cosine - 2 * angle) / angle**5,
    ]
    b, c = (Polynomial([(-1) ** k / math.factorial(2 * k + first) for k in range(10)]) for first in (2, 3))
    return np.where(square <= 1.0, [b(square), c(square), 2 * b.deriv()(square), 2 * c.deriv()(square)], quotients)


def _rate_matrices(turns: Floats) -> Floats:
    """Return J of each rotation vector, shape (n, 3, 3)."""
    b, c, _, _ = _factors(turns)[..., None]
    cross = _cross_matrices(turns)
    matrices: Floats = np.eye(3) - b * cross + c * (cross @ cross)
    return matrices


def _quadratic(turns: Floats, rates: Floats) -> Floats:
    """Return N = J̇φ̇ for rotation vectors and their derivatives, of shape (n, 3) each."""
    _, c, b_by_angle, c_by_angle = _factors(turns)
    once = np.cross(turns, rates)
    along = np.sum(turns * rates, axis=1, keepdims=True)
    bent: Floats = along * (c_by_angle * np.cross(turns, once) - b_by_angle * once) + c * np.cross(rates, once)
    return bent


def _quadratic_derivative(turns: Floats, rates: Floats) -> Floats:
    """Return the derivatives of N with respect to φ̇, shape (n, 3, 3)."""
    _, c, b_by_angle, c_by_angle = _factors(turns)[..., None]
    cross, rate_cross = _cross_matrices(turns), _cross_matrices(rates)
    along = np.sum(turns * rates, axis=1)[:, None, None]
    linear = c_by_angle * (cross @ cross) - b_by_angle * cross
    both = rate_cross @ cross - _cross_matrices(np.cross(turns, rates))
    derivatives: Floats = along * linear + _times(linear, rates)[:, :, None] * turns[:, None, :] + c * both
    return derivatives


def _cross_matrices(vectors: Floats) -> Floats:
    """Return the matrices [v] with [v]w = v × w, shape (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)


def _times(matrices: Floats, vectors: Floats) -> Floats:
    product: Floats = np.einsum("nij,nj->ni", matrices, vectors)
    return product
