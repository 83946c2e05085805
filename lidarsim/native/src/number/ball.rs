//! Float64 with a running error bound (N. J. Higham, Accuracy and Stability of Numerical Algorithms, §3.3).

use std::cmp::Ordering;

use super::lanes::{Lanes, OfRays, One};
use super::{Interval, Number, PAD, UNDERFLOW, UNIT, Uncertain};
use crate::affine::{Adjugate, Inverse};
use crate::root::Root;
use crate::simd::Floats;
use crate::vector::Vector;

/// Real numbers, a lane each, within `error` of `value`. An infinite or NaN bound means: unknown.
#[derive(Clone, Copy, Debug)]
pub struct Balls<L: Lanes<N>, const N: usize> {
    value: L::Floats,
    /// None: exact in every lane.
    error: Option<L::Floats>,
    lanes: L,
}

pub type Ball = Balls<One, 1>;

impl<L: Lanes<N>, const N: usize> OfRays<L, N> for Balls<L, N> {
    #[inline(always)]
    fn of_rays(value: L::Floats, lanes: L) -> Self {
        Balls { value, error: None, lanes }
    }
}

impl<L: Lanes<N>, const N: usize> Balls<L, N> {
    #[inline(always)]
    pub fn within(value: L::Floats, error: L::Floats, lanes: L) -> Self {
        Balls { value, error: Some(error), lanes }
    }

    /// The number and how far it may be off.
    #[inline(always)]
    pub fn parts(self) -> (L::Floats, L::Floats) {
        (self.value, self.error())
    }

    #[inline(always)]
    fn error(self) -> L::Floats {
        self.error.unwrap_or(splat::<L, N>(0.0))
    }

    /// At least the absolute value; zero where the number is exactly zero, and only there.
    #[inline(always)]
    fn size(self) -> L::Floats {
        match self.error {
            None => self.value.abs(),
            Some(error) => self.value.abs().add(error),
        }
    }

    /// `a` where 0 ≤ `by`, else `b`.
    #[inline(always)]
    fn pick(by: L::Floats, a: Self, b: Self) -> Self {
        let zero = splat::<L, N>(0.0);
        let error = match (a.error, b.error) {
            (None, None) => None,
            _ => Some(zero.le_pick(by, a.error(), b.error())),
        };
        Balls { value: zero.le_pick(by, a.value, b.value), error, lanes: a.lanes.or(b.lanes) }
    }

    /// With ρ = 1/b rounded and q ≥ ε_b/|b|, q ≤ ½: |a/b − v| ≤ (ε_a + |a/b|·ε_b)/(|b| − ε_b) + 3u·|v| for v = a·ρ, rounded, and
    /// 1/(|b| − ε_b) ≤ |1/b|·(1 + 2q). A ρ so small that it might have lost bits is refused.
    #[inline(always)]
    fn over(self, b: Self) -> Result<Self, Uncertain> {
        let (pad, underflow) = (splat::<L, N>(PAD), splat::<L, N>(UNDERFLOW));
        let inverse = splat::<L, N>(1.0).div(b.value);
        let slope = inverse.abs();
        let value = self.value.mul(inverse);
        let rounding = value.abs().mul(splat::<L, N>(3.0 * UNIT));
        let lanes = self.lanes.or(b.lanes);
        let ordinary = splat::<L, N>(f64::MIN_POSITIVE).lt(slope);
        let error = match b.error {
            None => {
                lanes.keep(ordinary)?;
                match self.error {
                    None => rounding,
                    Some(e) => e.mul(slope).fused(pad, rounding),
                }
            }
            Some(f) => {
                let q = f.mul(slope).mul(pad);
                lanes.keep(ordinary & q.le(splat::<L, N>(0.5)))?;
                let operands = value.abs().fused(f, self.error().add(underflow));
                let wider = q.fused(splat::<L, N>(2.0), splat::<L, N>(1.0));
                operands.mul(slope).mul(wider).fused(pad, rounding)
            }
        };
        Ok(Balls { value, error: Some(error.fused(pad, underflow)), lanes })
    }

    /// For a true x ≥ 0. |√x − √v| = |x − v|/(√x + √v) ≤ ε/√v; where the ball reaches zero, 0 ≤ √x ≤ √(v + ε).
    #[inline(always)]
    fn sqrt(self) -> Self {
        let (pad, underflow) = (splat::<L, N>(PAD), splat::<L, N>(UNDERFLOW));
        let error = self.error();
        let value = self.value.sqrt();
        let bound = value.fused(splat::<L, N>(UNIT), error.div(value)).fused(pad, underflow);
        let away = error.lt(self.value);
        if away & self.lanes.asked() == self.lanes.asked() {
            return Balls { value, error: Some(bound), lanes: self.lanes };
        }
        let zero = splat::<L, N>(0.0);
        let reach = self.value.max(zero).add(error).mul(pad).sqrt().mul(pad);
        Balls {
            value: self.value.le_pick(error, zero, value),
            error: Some(self.value.le_pick(error, reach, bound)),
            lanes: self.lanes,
        }
    }

    /// Stable forms of (b ± √disc)/a: where b and ±√disc cancel, c/(b ∓ √disc) is the same root.
    #[inline(always)]
    fn of_root(root: &Root<Self>) -> Result<Self, Uncertain> {
        if let Some(t) = root.t {
            return Ok(t);
        }
        if root.branch == 0 {
            return root.b.over(root.a);
        }
        let s = root.disc.sqrt();
        let by = root.b.value;
        if root.branch > 0 {
            Self::pick(by, root.b.plus(&s), root.c).over(Self::pick(by, root.a, root.b.minus(&s)))
        } else {
            Self::pick(by, root.c, root.b.minus(&s)).over(Self::pick(by, root.b.plus(&s), root.a))
        }
    }
}

/// One number for every lane.
#[inline(always)]
pub(super) fn splat<L: Lanes<N>, const N: usize>(x: f64) -> L::Floats {
    L::Floats::splat(x)
}

/// [value − error, value + error], rounded outward: with m = (ε + 4u·|v|)·PAD the rounding of v ± m, at most u·(|v| + m), is within m − ε.
#[inline(always)]
pub(super) fn interval<L: Lanes<N>, const N: usize>(
    value: L::Floats,
    error: L::Floats,
    lanes: L,
) -> Result<Interval<L::Floats>, Uncertain> {
    let margin = error.add(value.abs().mul(splat::<L, N>(4.0 * UNIT)));
    let margin = margin.mul(splat::<L, N>(PAD)).add(splat::<L, N>(UNDERFLOW));
    lanes.keep(value.abs().add(margin).lt(splat::<L, N>(f64::INFINITY)))?;
    Ok(Interval { low: value.sub(margin), high: value.add(margin) })
}

/// With a bound in any case, so that the compiler knows that there is one.
impl<L: Lanes<N>, const N: usize> From<&Ball> for Balls<L, N> {
    #[inline(always)]
    fn from(ball: &Ball) -> Self {
        let error = Some(splat::<L, N>(ball.error()));
        Balls { value: splat::<L, N>(ball.value), error, lanes: L::OF_NO_RAY }
    }
}

impl<L: Lanes<N>, const N: usize> Number for Balls<L, N> {
    type Floats = L::Floats;

    #[inline(always)]
    fn exact(x: f64) -> Self {
        Balls { value: splat::<L, N>(x), error: None, lanes: L::OF_NO_RAY }
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        // A sum of float64 numbers that is subnormal is exact, so that nothing is lost to underflow.
        let value = self.value.add(other.value);
        let unit = splat::<L, N>(UNIT);
        let error = match (self.error, other.error) {
            (None, None) => value.abs().mul(unit),
            (Some(e), None) | (None, Some(e)) => value.abs().fused(unit, e),
            (Some(e), Some(f)) => value.abs().fused(unit, e.add(f)),
        };
        Balls { value, error: Some(error.mul(splat::<L, N>(PAD))), lanes: self.lanes.or(other.lanes) }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        self.plus(&other.negated())
    }

    #[inline(always)]
    fn times(&self, other: &Self) -> Self {
        let value = self.value.mul(other.value);
        let rounding = value.abs().mul(splat::<L, N>(UNIT));
        let (a, b) = (self.value.abs(), other.value.abs());
        let error = match (self.error, other.error) {
            (None, None) => rounding,
            (Some(e), None) => b.fused(e, rounding),
            (None, Some(f)) => a.fused(f, rounding),
            (Some(e), Some(f)) => self.size().fused(f, b.fused(e, rounding)),
        };
        // What is exactly zero stays so.
        let zero = splat::<L, N>(0.0);
        let underflow = self.size().min(other.size()).le_pick(zero, zero, splat::<L, N>(UNDERFLOW));
        let error = error.fused(splat::<L, N>(PAD), underflow);
        Balls { value, error: Some(error), lanes: self.lanes.or(other.lanes) }
    }

    #[inline(always)]
    fn negated(&self) -> Self {
        Balls { value: self.value.negated(), ..*self }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        let error = self.error();
        let equal = self.size().le(splat::<L, N>(0.0));
        self.lanes.agree(self.value.lt(error.negated()), equal, error.lt(self.value))
    }

    #[inline(always)]
    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        p.plus(&q.times(&d.sqrt())).sign()
    }

    #[inline(always)]
    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        Balls::of_root(a)?.minus(&Balls::of_root(b)?).sign()
    }

    #[inline(always)]
    fn locate(root: &Root<Self>) -> Result<Option<Self>, Uncertain> {
        Ok(Some(Balls::of_root(root)?))
    }

    #[inline(always)]
    fn round(_: &Root<Self>) -> Result<L::Floats, Uncertain> {
        Err(Uncertain)
    }

    #[inline(always)]
    fn of_inverse(inverse: &Inverse) -> Adjugate<Self> {
        inverse.ball.of_kind()
    }

    #[inline(always)]
    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        Balls::of_root(root)
    }

    #[inline(always)]
    fn proportions(_: &Vector<Self>) -> Result<[L::Floats; 3], Uncertain> {
        Err(Uncertain)
    }

    #[inline(always)]
    fn enclose(root: &Root<Self>) -> Result<Interval<L::Floats>, Uncertain> {
        let t = Balls::of_root(root)?;
        interval::<L, N>(t.value, t.error(), t.lanes)
    }
}

#[cfg(test)]
impl<L: Lanes<N>, const N: usize> super::tests::Rounded<N> for Balls<L, N> {
    fn holds(&self, lane: usize, x: &super::Dyadic) -> bool {
        super::tests::within(x, self.value.store()[lane], 0.0, self.error().store()[lane])
    }

    fn is_certain(&self, lane: usize) -> bool {
        self.value.abs().store()[lane] > self.error().store()[lane]
    }
}
