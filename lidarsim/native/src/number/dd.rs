//! Double-double with a running error bound.
//!
//! Algorithms and bounds: M. Joldes, J.-M. Muller, V. Popescu, Tight and rigorous error bounds for basic building
//! blocks of double-word arithmetic, ACM TOMS 44 (2017): AccurateDWPlusDW (Algorithm 6, 3u² + 13u³), DWTimesDW3
//! (Algorithm 12, 4u²), DWDivDW2 (Algorithm 17, 15u² + 56u³); the square root by V. Lefèvre, N. Louvet, J.-M. Muller, J. Picot,
//! L. Rideau, Accurate calculation of Euclidean norms using double-word arithmetic, ACM TOMS 49 (2023), 25/8·u². The constants
//! below round these up. They hold where nothing overflows (then the bound is infinite or NaN) or underflows (covered by
//! `UNDERFLOW`, or refused below `SMALL`).

use std::cmp::Ordering;

use super::{Interval, Number, PAD, UNDERFLOW, UNIT, Uncertain, sign_of};
use crate::affine::{Adjugate, Inverse};
use crate::root::Root;
use crate::vector::{Point, Vector};

const PLUS: f64 = 4.0 * UNIT * UNIT;
const TIMES: f64 = 5.0 * UNIT * UNIT;
const OVER: f64 = 16.0 * UNIT * UNIT;
const SQRT: f64 = 4.0 * UNIT * UNIT;

/// Quotients and square roots below 2⁻⁸⁰⁰ are left to exact arithmetic: their residuals could underflow.
const SMALL: f64 = f64::from_bits((1023 - 800) << 52);

/// A real number within `error` of `high + low`, with |low| ≤ ½ ulp(high).
#[derive(Clone, Copy, Debug)]
pub struct DdBall {
    high: f64,
    low: f64,
    error: f64,
}

/// Knuth's exact sum: a + b = s + e.
#[inline(always)]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let z = s - a;
    (s, (a - (s - z)) + (b - z))
}

/// Dekker's exact sum, for |a| ≥ |b| or a = 0.
#[inline(always)]
fn fast_two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    (s, b - (s - a))
}

/// Exact product: a·b = p + e, but for underflow of e.
#[inline(always)]
fn two_prod(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    (p, a.mul_add(b, -p))
}

impl DdBall {
    fn is_exact_zero(self) -> bool {
        self.high == 0.0 && self.error == 0.0
    }

    /// The error of the operands is propagated as in `Ball::over`.
    fn over(self, b: DdBall) -> Result<DdBall, Uncertain> {
        let room = b.high.abs() * (1.0 - 2.0 * UNIT) - b.error * PAD;
        if !(room > SMALL) || (self.high.abs() < SMALL && self.high != 0.0) {
            return Err(Uncertain);
        }
        let th = self.high / b.high;
        let (ph, pl) = two_prod(b.high, th);
        let rl = b.low.mul_add(th, pl);
        let (rh, rl) = fast_two_sum(ph, rl);
        let delta = (self.high - rh) + (self.low - rl);
        let (high, low) = fast_two_sum(th, delta / b.high);
        let error = (self.error + high.abs() * b.error * PAD) / room * PAD + high.abs() * OVER;
        Ok(DdBall { high, low, error: error * PAD + UNDERFLOW })
    }

    /// For a true x ≥ 0.
    fn sqrt(self) -> Result<DdBall, Uncertain> {
        if self.high > self.error * PAD && self.high > SMALL {
            let s = self.high.sqrt();
            let rho = (-s).mul_add(s, self.high);
            let (high, low) = fast_two_sum(s, (rho + self.low) / (2.0 * s));
            Ok(DdBall { high, low, error: (self.error / high * PAD + high * SQRT) * PAD })
        } else if self.is_exact_zero() {
            Ok(self)
        } else {
            Err(Uncertain)
        }
    }

    /// Stable forms of (b ± √disc)/a, as for `Ball`.
    fn of_root(root: &Root<DdBall>) -> Result<DdBall, Uncertain> {
        if root.branch == 0 {
            return root.b.over(root.a);
        }
        let s = root.disc.sqrt()?;
        let s = if root.branch < 0 { s.negated() } else { s };
        if (root.b.high >= 0.0) == (root.branch > 0) {
            root.b.plus(&s).over(root.a)
        } else {
            root.c.over(root.b.minus(&s))
        }
    }
}

impl Number for DdBall {
    #[inline(always)]
    fn exact(x: f64) -> Self {
        DdBall { high: x, low: 0.0, error: 0.0 }
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        let (sh, sl) = two_sum(self.high, other.high);
        let (th, tl) = two_sum(self.low, other.low);
        let (vh, vl) = fast_two_sum(sh, sl + th);
        let (high, low) = fast_two_sum(vh, tl + vl);
        DdBall { high, low, error: (self.error + other.error + high.abs() * PLUS) * PAD }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        self.plus(&other.negated())
    }

    #[inline(always)]
    fn times(&self, other: &Self) -> Self {
        let (ph, pl) = two_prod(self.high, other.high);
        let cross = self.low.mul_add(other.high, self.high.mul_add(other.low, self.low * other.low));
        let (high, low) = fast_two_sum(ph, pl + cross);
        let error = (self.high.abs() * other.error + other.high.abs() * self.error) * PAD
            + self.error * other.error
            + high.abs() * TIMES;
        let underflow = if self.is_exact_zero() | other.is_exact_zero() { 0.0 } else { UNDERFLOW };
        DdBall { high, low, error: error * PAD + underflow }
    }

    #[inline(always)]
    fn negated(&self) -> Self {
        DdBall { high: -self.high, low: -self.low, error: self.error }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        // |high + low| ≥ |high|·(1 − u).
        if self.high.abs() * (1.0 - 2.0 * UNIT) > self.error || self.is_exact_zero() {
            Ok(sign_of(self.high))
        } else {
            Err(Uncertain)
        }
    }

    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        p.plus(&q.times(&d.sqrt()?)).sign()
    }

    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        DdBall::of_root(a)?.minus(&DdBall::of_root(b)?).sign()
    }

    fn round(root: &Root<Self>) -> Result<f64, Uncertain> {
        // Rounding is monotone: if both ends of the ball round to `high`, so does the truth.
        let t = DdBall::of_root(root)?;
        let error = t.error * PAD + t.low.abs() * 2.0 * UNIT + UNDERFLOW;
        let certain = t.high + (t.low + error) == t.high && t.high + (t.low - error) == t.high;
        // A subnormal result would be rounded twice.
        if certain && t.high.is_normal() { Ok(t.high) } else { Err(Uncertain) }
    }

    fn of_inverse(inverse: &Inverse) -> &Adjugate<Self> {
        &inverse.dd
    }

    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        DdBall::of_root(root)
    }

    fn proportions(v: &Vector<Self>) -> Result<Point, Uncertain> {
        let largest = v.iter().fold(0.0_f64, |m, x| m.max(x.high.abs()));
        let error = v.iter().fold(0.0_f64, |m, x| m.max(x.error));
        let small = largest * (UNIT / 128.0);
        // Squares of what passes neither overflow nor underflow.
        if error <= small && largest > SMALL.sqrt() && largest < 1.0 / SMALL.sqrt() {
            Ok(v.map(|x| x.high))
        } else {
            Err(Uncertain)
        }
    }

    fn enclose(root: &Root<Self>) -> Result<Interval, Uncertain> {
        let t = DdBall::of_root(root)?;
        let error = t.low.abs() + t.error;
        let interval = Interval { low: (t.high - error).next_down(), high: (t.high + error).next_up() };
        if interval.low.is_finite() && interval.high.is_finite() { Ok(interval) } else { Err(Uncertain) }
    }
}
