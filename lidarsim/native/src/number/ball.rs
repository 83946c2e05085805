//! Float64 with a running error bound (N. J. Higham, Accuracy and Stability of Numerical Algorithms, §3.3).

use std::cmp::Ordering;

use super::{Interval, Number, PAD, UNDERFLOW, UNIT, Uncertain, sign_of};
use crate::affine::{Adjugate, Inverse};
use crate::root::Root;
use crate::vector::{Point, Vector};

/// A real number within `error` of `value`. An infinite or NaN bound means: unknown.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    value: f64,
    error: f64,
}

impl Ball {
    fn is_exact_zero(self) -> bool {
        self.value == 0.0 && self.error == 0.0
    }

    /// |a/b − v| ≤ (ε_a + |v|·ε_b)/(|b| − ε_b) + u·|v|.
    fn over(self, b: Ball) -> Result<Ball, Uncertain> {
        let room = b.value.abs() - b.error * PAD;
        // Also false where the bound is NaN.
        if !(room > 0.0) {
            return Err(Uncertain);
        }
        let value = self.value / b.value;
        let error = (self.error + value.abs() * b.error + UNDERFLOW) / room * PAD + value.abs() * UNIT;
        Ok(Ball { value, error: error * PAD + UNDERFLOW })
    }

    /// For a true x ≥ 0. |√x − √v| = |x − v|/(√x + √v) ≤ ε/√v; where the ball reaches zero, 0 ≤ √x ≤ √(v + ε).
    fn sqrt(self) -> Ball {
        if self.value > self.error {
            let value = self.value.sqrt();
            Ball { value, error: (self.error / value + value * UNIT) * PAD + UNDERFLOW }
        } else {
            Ball { value: 0.0, error: ((self.value.max(0.0) + self.error) * PAD).sqrt() * PAD }
        }
    }

    /// Stable forms of (b ± √disc)/a: where b and ±√disc cancel, c/(b ∓ √disc) is the same root.
    fn of_root(root: &Root<Ball>) -> Result<Ball, Uncertain> {
        if root.branch == 0 {
            return root.b.over(root.a);
        }
        let s = root.disc.sqrt();
        let s = if root.branch < 0 { s.negated() } else { s };
        if (root.b.value >= 0.0) == (root.branch > 0) {
            root.b.plus(&s).over(root.a)
        } else {
            root.c.over(root.b.minus(&s))
        }
    }

    fn interval(self) -> Result<Interval, Uncertain> {
        let interval =
            Interval { low: (self.value - self.error).next_down(), high: (self.value + self.error).next_up() };
        if interval.low.is_finite() && interval.high.is_finite() { Ok(interval) } else { Err(Uncertain) }
    }
}

impl Number for Ball {
    #[inline(always)]
    fn exact(x: f64) -> Self {
        Ball { value: x, error: 0.0 }
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        // A sum of float64 numbers that is subnormal is exact, so that nothing is lost to underflow.
        let value = self.value + other.value;
        Ball { value, error: (self.error + other.error + value.abs() * UNIT) * PAD }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        self.plus(&other.negated())
    }

    #[inline(always)]
    fn times(&self, other: &Self) -> Self {
        let value = self.value * other.value;
        let error = self.value.abs() * other.error
            + other.value.abs() * self.error
            + self.error * other.error
            + value.abs() * UNIT;
        let underflow = if self.is_exact_zero() | other.is_exact_zero() { 0.0 } else { UNDERFLOW };
        Ball { value, error: error * PAD + underflow }
    }

    #[inline(always)]
    fn negated(&self) -> Self {
        Ball { value: -self.value, error: self.error }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        if self.value.abs() > self.error || self.is_exact_zero() { Ok(sign_of(self.value)) } else { Err(Uncertain) }
    }

    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        p.plus(&q.times(&d.sqrt())).sign()
    }

    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        Ball::of_root(a)?.minus(&Ball::of_root(b)?).sign()
    }

    fn round(_: &Root<Self>) -> Result<f64, Uncertain> {
        Err(Uncertain)
    }

    fn of_inverse(inverse: &Inverse) -> &Adjugate<Self> {
        &inverse.ball
    }

    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        Ball::of_root(root)
    }

    fn proportions(_: &Vector<Self>) -> Result<Point, Uncertain> {
        Err(Uncertain)
    }

    fn enclose(root: &Root<Self>) -> Result<Interval, Uncertain> {
        Ball::of_root(root)?.interval()
    }
}
