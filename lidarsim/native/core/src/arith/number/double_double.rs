//! Double-double with a running error bound.
//!
//! Algorithms and proven bounds: M. Joldes, J.-M. Muller, V. Popescu, Tight and rigorous error bounds for
//! basic building blocks of double-word arithmetic, ACM TOMS 44 (2017); the square root by V. Lefèvre, N.
//! Louvet, J.-M. Muller, J. Picot, L. Rideau, Accurate calculation of Euclidean norms using double-word
//! arithmetic, ACM TOMS 49 (2023).
//!
//! | operation | algorithm | bound |
//! |---|---|---|
//! | sum of two float64 numbers | 2Sum (Knuth) | exact |
//! | sum with a float64 number | DWPlusFP (4) | 2u² |
//! | sum | AccurateDWPlusDW (6) | 3u² + 13u³ |
//! | product of two float64 numbers | 2Prod by FMA | exact |
//! | product with a float64 number | DWTimesFP3 (9) | 2u² |
//! | product | DWTimesDW3 (12) | 4u² (J.-M. Muller, L. Rideau, ACM TOMS 48, 2022, who correct its proof) |
//! | quotient | DWDivDW2 (17), with 9 in the place of 7 | 16u² |
//! | square root | SQRTDWtoDW | 25/8·u² |
//!
//! The quotient's own bound is 15u² + 56u³; the inner product used here is off by 2u² instead of 1.5u²,
//! which adds as much to the quotient. The constants below round these up. They hold unless an operation
//! overflows (the bound is then infinite or NaN) or underflows (covered by `UNDERFLOW`, or refused below
//! `SMALL`).

use std::borrow::Cow;
use std::cmp::Ordering;

use super::lanes::{Lanes, OfRays, One};
use super::running_error::{RunningErrors, interval, splat};
use super::{Interval, Kinds, Number, PAD, Root, Stored, UNDERFLOW, UNIT, Uncertain};
use crate::arith::error_free::{fast_two_sum, two_product, two_sum};
use crate::arith::simd::{Floats, operations};

const PLUS: f64 = 4.0 * UNIT * UNIT;
const TIMES: f64 = 5.0 * UNIT * UNIT;
const OVER: f64 = 16.0 * UNIT * UNIT;
const SQRT: f64 = 4.0 * UNIT * UNIT;

/// Exact arithmetic takes over for quotients and square roots of numbers below 2⁻⁸⁰⁰. The residuals
/// high − q·b.high and high − s² are multiples of a power of two above u²·|high|/4, so they are exact
/// down to 2⁻⁹⁶⁰; the rest of a correction loses far less than u²·2⁻⁸⁰⁰ to underflow.
const SMALL: f64 = f64::from_bits((1023 - 800) << 52);

/// Squares of numbers between 2⁻⁴⁰⁰ and 2⁴⁰⁰ neither overflow nor underflow.
const SHORT: f64 = f64::from_bits((1023 - 400) << 52);
const LONG: f64 = f64::from_bits((1023 + 400) << 52);

operations! {
    /// DWPlusFP of two high parts and one low part.
    fn dw_plus_fp(a: F, b: F, low: F) -> (F, F) {
        let (sh, sl) = two_sum(a, b);
        fast_two_sum(sh, sl.add(low))
    }

    /// AccurateDWPlusDW.
    fn dw_plus_dw(a: [F; 2], b: [F; 2]) -> (F, F) {
        let ([ah, al], [bh, bl]) = (a, b);
        let ((sh, sl), (th, tl)) = (two_sum(ah, bh), two_sum(al, bl));
        let (vh, vl) = fast_two_sum(sh, sl.add(th));
        fast_two_sum(vh, tl.add(vl))
    }

    /// The bound of a sum, with the errors of its operands.
    fn error_of_sum(high: F, operands: F) -> F {
        operands.add(high.abs().mul(F::splat(PLUS))).mul(F::splat(PAD))
    }

    /// DWTimesFP3.
    fn dw_times_fp(a: [F; 2], b: F) -> (F, F) {
        let (ph, pl) = two_product(a[0], b);
        fast_two_sum(ph, a[1].mul_add(b, pl))
    }

    /// DWTimesDW3.
    fn dw_times_dw(a: [F; 2], b: [F; 2]) -> (F, F) {
        let ([ah, al], [bh, bl]) = (a, b);
        let (ph, pl) = two_product(ah, bh);
        fast_two_sum(ph, pl.add(al.mul_add(bh, ah.mul_add(bl, al.mul(bl)))))
    }

    /// Bound of what a product of numbers of these sizes loses to underflow; 0 if one is exactly zero.
    fn underflow_of_product(a: F, b: F) -> F {
        let zero = F::splat(0.0);
        a.min(b).le_pick(zero, zero, F::splat(UNDERFLOW))
    }

    /// The bound of a product with an exact number, `a`; `error`: of the other.
    fn error_of_exact_product(high: F, a: F, error: F, underflow: F) -> F {
        let (pad, rounding) = (F::splat(PAD), high.abs().mul(F::splat(TIMES)));
        a.abs().mul(error).mul(pad).add(rounding).mul(pad).add(underflow)
    }

    /// The bound of a product of two numbers, each with its error.
    fn error_of_product(high: F, a: [F; 2], b: [F; 2], underflow: F) -> F {
        let ([a, e], [b, f]) = (a, b);
        let (pad, rounding) = (F::splat(PAD), high.abs().mul(F::splat(TIMES)));
        a.abs().add(e).mul(f).add(b.abs().mul(e)).mul(pad).add(rounding).mul(pad).add(underflow)
    }
}

/// One real number per lane, within `error` of `high + low`, with |low| ≤ ½ ulp(high).
#[derive(Clone, Copy, Debug)]
pub struct DoubleDoubles<L: Lanes<N>, const N: usize> {
    high: L::Floats,
    /// `None`: zero in every lane, and so is the error.
    low: Option<L::Floats>,
    /// `None`: exact in every lane.
    error: Option<L::Floats>,
    lanes: L,
}

pub type DoubleDouble = DoubleDoubles<One, 1>;

impl<L: Lanes<N>, const N: usize> OfRays<L, N> for DoubleDoubles<L, N> {
    #[inline(always)]
    fn of_rays(value: L::Floats, lanes: L) -> Self {
        DoubleDoubles { high: value, low: None, error: None, lanes }
    }

    #[inline(always)]
    fn load<const M: usize>(stored: &Stored<M>, i: usize, lanes: L) -> Self {
        let of = |x: &[f64; M]| L::Floats::load(&x.as_chunks().0[i]);
        DoubleDoubles {
            high: of(&stored.high),
            low: Some(of(&stored.low)),
            error: Some(of(&stored.error)),
            lanes,
        }
    }

    #[inline(always)]
    fn store<const M: usize>(&self, i: usize, stored: &mut Stored<M>) {
        stored.high.as_chunks_mut().0[i] = self.high.store();
        stored.low.as_chunks_mut().0[i] = self.low().store();
        stored.error.as_chunks_mut().0[i] = self.error().store();
    }
}

impl<L: Lanes<N>, const N: usize> DoubleDoubles<L, N> {
    #[inline(always)]
    pub fn within(value: L::Floats, error: L::Floats, lanes: L) -> Self {
        DoubleDoubles { high: value, low: Some(splat::<L, N>(0.0)), error: Some(error), lanes }
    }

    /// Within `error` of high + low, |low| ≤ |high|.
    #[inline(always)]
    pub fn of_sum(high: L::Floats, low: L::Floats, error: L::Floats, lanes: L) -> Self {
        let (high, low) = fast_two_sum(high, low);
        DoubleDoubles { high, low: Some(low), error: Some(error), lanes }
    }

    /// The number rounded to float64, and a bound of its whole error.
    #[inline(always)]
    pub fn parts(self) -> (L::Floats, L::Floats) {
        (self.high, self.error())
    }

    #[inline(always)]
    fn low(self) -> L::Floats {
        self.low.unwrap_or(splat::<L, N>(0.0))
    }

    #[inline(always)]
    fn error(self) -> L::Floats {
        self.error.unwrap_or(splat::<L, N>(0.0))
    }

    /// Zero only where the number is exactly zero.
    #[inline(always)]
    fn size(self) -> L::Floats {
        match self.error {
            None => self.high.abs(),
            Some(error) => self.high.abs().add(error),
        }
    }

    /// `a` where 0 ≤ `by`, `b` elsewhere.
    #[inline(always)]
    fn pick(by: L::Floats, a: Self, b: Self) -> Self {
        let zero = splat::<L, N>(0.0);
        DoubleDoubles {
            high: zero.le_pick(by, a.high, b.high),
            low: Some(zero.le_pick(by, a.low(), b.low())),
            error: Some(zero.le_pick(by, a.error(), b.error())),
            lanes: a.lanes.or(b.lanes),
        }
    }

    /// Rounded to the nearest float64.
    #[inline(always)]
    pub fn rounded(self) -> Result<L::Floats, Uncertain> {
        // Rounding is monotone: if both ends of the interval round to `high`, so does the true value.
        let error = self.error().mul(splat::<L, N>(PAD)).add(self.low().abs().mul(splat::<L, N>(2.0 * UNIT)));
        let error = error.add(splat::<L, N>(UNDERFLOW));
        let (high, low) = (self.high, self.low());
        let certain = high.add(low.add(error)).le(high) & high.le(high.add(low.sub(error)));
        // A subnormal result would be rounded twice.
        let size = high.abs();
        let normal = splat::<L, N>(f64::MIN_POSITIVE).le(size) & size.lt(splat::<L, N>(f64::INFINITY));
        self.lanes.keep(certain & normal)?;
        Ok(high)
    }

    /// 2Sum, DWPlusFP or AccurateDWPlusDW, depending on which operands have low parts.
    #[inline(always)]
    fn sum(self, other: Self) -> Self {
        let lanes = self.lanes.or(other.lanes);
        let (high, low) = match (self.low, other.low) {
            (None, None) => {
                let (high, low) = two_sum(self.high, other.high);
                return DoubleDoubles { high, low: Some(low), error: None, lanes };
            }
            (Some(low), None) | (None, Some(low)) => dw_plus_fp(self.high, other.high, low),
            (Some(a), Some(b)) => dw_plus_dw([self.high, a], [other.high, b]),
        };
        let error = match (self.error, other.error) {
            (None, None) => high.abs().mul(splat::<L, N>(PLUS)).mul(splat::<L, N>(PAD)),
            (Some(e), None) | (None, Some(e)) => error_of_sum(high, e),
            (Some(e), Some(f)) => error_of_sum(high, e.add(f)),
        };
        DoubleDoubles { high, low: Some(low), error: Some(error), lanes }
    }

    /// 2Prod, DWTimesFP3 or DWTimesDW3, depending on which operands have low parts.
    #[inline(always)]
    fn product(self, other: Self) -> Self {
        let lanes = self.lanes.or(other.lanes);
        let underflow = underflow_of_product(self.size(), other.size());
        let (high, low) = match (self.low, other.low) {
            (None, None) => {
                let (high, low) = two_product(self.high, other.high);
                return DoubleDoubles { high, low: Some(low), error: Some(underflow), lanes };
            }
            (Some(low), None) => dw_times_fp([self.high, low], other.high),
            (None, Some(low)) => dw_times_fp([other.high, low], self.high),
            (Some(a), Some(b)) => dw_times_dw([self.high, a], [other.high, b]),
        };
        let error = match (self.error, other.error) {
            (None, None) => high.abs().mul(splat::<L, N>(TIMES)).mul(splat::<L, N>(PAD)).add(underflow),
            (Some(e), None) => error_of_exact_product(high, other.high, e, underflow),
            (None, Some(f)) => error_of_exact_product(high, self.high, f, underflow),
            (Some(e), Some(f)) => error_of_product(high, [self.high, e], [other.high, f], underflow),
        };
        DoubleDoubles { high, low: Some(low), error: Some(error), lanes }
    }

    /// Out of line for a single ray, the rare case, to keep the code small.
    #[inline(never)]
    fn sum_out_of_line(self, other: Self) -> Self {
        self.sum(other)
    }

    #[inline(never)]
    fn product_out_of_line(self, other: Self) -> Self {
        self.product(other)
    }

    /// DWDivDW2. The errors of the operands propagate as in `RunningErrors::over`.
    #[inline(always)]
    fn over(self, b: Self) -> Result<Self, Uncertain> {
        let pad = splat::<L, N>(PAD);
        let small = splat::<L, N>(SMALL);
        let margin = b.high.abs().mul(splat::<L, N>(1.0 - 2.0 * UNIT)).sub(b.error().mul(pad));
        let size = self.high.abs();
        let lanes = self.lanes.or(b.lanes);
        lanes.keep(small.lt(margin) & (small.le(size) | size.le(splat::<L, N>(0.0))))?;
        let th = self.high.div(b.high);
        let (ph, pl) = two_product(b.high, th);
        let (rh, rl) = fast_two_sum(ph, b.low().mul_add(th, pl));
        let delta = self.high.sub(rh).add(self.low().sub(rl));
        let (high, low) = fast_two_sum(th, delta.div(b.high));
        let operands = self.error().add(high.abs().mul(b.error()).mul(pad));
        let error = operands.div(margin).mul(pad).add(high.abs().mul(splat::<L, N>(OVER)));
        let error = error.mul(pad).add(splat::<L, N>(UNDERFLOW));
        Ok(DoubleDoubles { high, low: Some(low), error: Some(error), lanes })
    }

    /// SQRTDWtoDW. The true x must be ≥ 0.
    #[inline(always)]
    fn sqrt(self) -> Result<Self, Uncertain> {
        let pad = splat::<L, N>(PAD);
        let zero = splat::<L, N>(0.0);
        let away = self.error().mul(pad).lt(self.high) & splat::<L, N>(SMALL).lt(self.high);
        let size = self.size();
        self.lanes.keep(away | size.le(zero))?;
        let s = self.high.sqrt();
        let rho = s.negated().mul_add(s, self.high);
        let (high, low) = fast_two_sum(s, rho.add(self.low()).div(s.add(s)));
        let error = self.error().div(high).mul(pad).add(high.mul(splat::<L, N>(SQRT))).mul(pad);
        Ok(DoubleDoubles {
            high: size.le_pick(zero, zero, high),
            low: Some(size.le_pick(zero, zero, low)),
            error: Some(size.le_pick(zero, zero, error)),
            lanes: self.lanes,
        })
    }

    /// Stable forms of (b ± √disc)/a, as for `RunningErrors`.
    #[inline(always)]
    fn of_root(root: &Root<Self>) -> Result<Self, Uncertain> {
        if let Some(t) = root.t {
            return Ok(t);
        }
        if root.branch == 0 {
            return root.b.over(root.a);
        }
        let s = root.disc.sqrt()?;
        let by = root.b.high;
        if root.branch > 0 {
            Self::pick(by, root.b.plus(&s), root.c).over(Self::pick(by, root.a, root.b.minus(&s)))
        } else {
            Self::pick(by, root.c, root.b.minus(&s)).over(Self::pick(by, root.b.plus(&s), root.a))
        }
    }
}

/// A low part is at most u·|high|, and its sum with a bound is rounded once.
impl<L: Lanes<N>, const N: usize> From<&DoubleDoubles<L, N>> for RunningErrors<L, N> {
    #[inline(always)]
    fn from(x: &DoubleDoubles<L, N>) -> Self {
        let DoubleDoubles { high, low, error, lanes } = *x;
        if low.is_none() && error.is_none() {
            return RunningErrors::of_rays(high, lanes);
        }
        let error = high.abs().fused(splat::<L, N>(UNIT), x.error());
        RunningErrors::within(high, error.mul(splat::<L, N>(PAD)), lanes)
    }
}

impl DoubleDouble {
    /// The high and the low part, and a bound of the error of their sum.
    pub fn terms(&self) -> (f64, f64, f64) {
        (self.high, self.low(), self.error())
    }
}

/// Always with a low part and a bound, so that the compiler knows that both are there.
impl<L: Lanes<N>, const N: usize> From<&DoubleDouble> for DoubleDoubles<L, N> {
    #[inline(always)]
    fn from(x: &DoubleDouble) -> Self {
        let low = Some(splat::<L, N>(x.low()));
        let error = Some(splat::<L, N>(x.error()));
        DoubleDoubles { high: splat::<L, N>(x.high), low, error, lanes: L::UNIFORM }
    }
}

impl<L: Lanes<N>, const N: usize> Number for DoubleDoubles<L, N> {
    type Floats = L::Floats;

    #[inline(always)]
    fn exact(x: f64) -> Self {
        DoubleDoubles { high: splat::<L, N>(x), low: None, error: None, lanes: L::UNIFORM }
    }

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        if N == 1 { self.sum_out_of_line(*other) } else { self.sum(*other) }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        self.plus(&other.negated())
    }

    #[inline(always)]
    fn times(&self, other: &Self) -> Self {
        if N == 1 { self.product_out_of_line(*other) } else { self.product(*other) }
    }

    #[inline(always)]
    fn negated(&self) -> Self {
        let high = self.high.negated();
        let Some(low) = self.low else { return DoubleDoubles { high, ..*self } };
        DoubleDoubles { high, low: Some(low.negated()), ..*self }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        // |high + low| ≥ |high|·(1 − u).
        let least = self.high.mul(splat::<L, N>(1.0 - 2.0 * UNIT));
        let error = self.error();
        let equal = self.size().le(splat::<L, N>(0.0));
        self.lanes.agree(least.lt(error.negated()), equal, error.lt(least))
    }

    #[inline(always)]
    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        p.plus(&q.times(&d.sqrt()?)).sign()
    }

    #[inline(always)]
    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        DoubleDoubles::of_root(a)?.minus(&DoubleDoubles::of_root(b)?).sign()
    }

    #[inline(always)]
    fn locate(root: &Root<Self>) -> Result<Option<Self>, Uncertain> {
        Ok(Some(DoubleDoubles::of_root(root)?))
    }

    #[inline(always)]
    fn round(root: &Root<Self>) -> Result<L::Floats, Uncertain> {
        DoubleDoubles::of_root(root)?.rounded()
    }

    fn split(&self) -> (L::Floats, Self) {
        let rest = DoubleDoubles { high: self.low(), low: Some(splat::<L, N>(0.0)), ..*self };
        (self.high, rest)
    }

    #[inline(always)]
    fn of_kinds<K: Kinds>(kinds: &K) -> Cow<'_, K::In<Self>> {
        Cow::Owned(K::convert(kinds.double_double()))
    }

    #[inline(always)]
    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        DoubleDoubles::of_root(root)
    }

    #[inline(always)]
    fn proportions(v: &[Self; 3]) -> Result<[L::Floats; 3], Uncertain> {
        let [x, y, z] = v;
        let largest = x.high.abs().max(y.high.abs()).max(z.high.abs());
        let small = largest.mul(splat::<L, N>(UNIT / 128.0));
        let known = x.error().le(small) & y.error().le(small) & z.error().le(small);
        let ordinary = splat::<L, N>(SHORT).lt(largest) & largest.lt(splat::<L, N>(LONG));
        x.lanes.or(y.lanes).or(z.lanes).keep(known & ordinary)?;
        Ok([x.high, y.high, z.high])
    }

    #[inline(always)]
    fn enclose(root: &Root<Self>) -> Result<Interval<L::Floats>, Uncertain> {
        let t = DoubleDoubles::of_root(root)?;
        interval::<L, N>(t.high, t.low().abs().add(t.error()), t.lanes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::tests::{Enclosure, within};
    use crate::arith::number::{Dyadic, nearly};
    use crate::testing::{assert_slack, worst};

    impl<L: Lanes<N>, const N: usize> Enclosure<N> for DoubleDoubles<L, N> {
        fn holds(&self, lane: usize, x: &Dyadic) -> bool {
            within(x, self.high.store()[lane], self.low().store()[lane], self.error().store()[lane])
        }

        fn is_certain(&self, lane: usize) -> bool {
            self.high.abs().store()[lane] > self.error().store()[lane]
        }
    }

    /// high + fraction·ulp(high), without an error of its own.
    fn number(high: f64, fraction: f64) -> (DoubleDouble, Dyadic) {
        let low = fraction * (high.abs().next_up() - high.abs());
        let sum = DoubleDouble::exact(high).plus(&DoubleDouble::exact(low));
        assert!(sum.error.is_none());
        (sum, Dyadic::exact(high).plus(&Dyadic::exact(low)))
    }

    /// High parts from ½ to 4 of either sign, and fractions of their last place.
    fn draw(i: usize, next: &mut dyn FnMut() -> f64) -> f64 {
        if i % 2 == 1 {
            next() - 0.5
        } else {
            (0.5 + 0.5 * next()) * [1.0, 2.0, -1.0, 4.0][(4.0 * next()) as usize]
        }
    }

    /// The error |x − found| as a share of its bound.
    fn share(found: DoubleDouble, x: &Dyadic) -> f64 {
        let off = x.minus(&Dyadic::exact(found.high)).minus(&Dyadic::exact(found.low()));
        off.split().0.abs() / found.error()
    }

    fn share_of(found: Result<DoubleDouble, Uncertain>, root: &Root<Dyadic>) -> f64 {
        match (found, Dyadic::value(root)) {
            (Ok(found), Ok(x)) => share(found, &x),
            _ => 0.0,
        }
    }

    #[test]
    fn exact_numbers_are_as_near_as_their_bound_says() {
        let score = |x: &[f64; 3]| {
            let [a, b, c] = x.map(Dyadic::exact);
            let exact = a.times(&b).times(&c);
            share(nearly(&exact), &exact)
        };
        assert_slack("exact number", worst(8, 2000, |_, next| 1.0 + next(), score).0, 0.499);
    }

    #[test]
    fn exact_numbers_of_all_sizes_are_held_or_refused() {
        // 157 bits, more than the two parts hold.
        let [a, b, c] = [1.2345678912345677, -1.3578246813579247, 1.0192837465564738].map(Dyadic::exact);
        let long = a.times(&b).times(&c);
        let (mut held, mut refused) = (0, 0);
        for k in -1200..1200 {
            let power = |k: i32| Dyadic::exact(2.0_f64.powi(k));
            let exact = long.times(&power(k / 2)).times(&power(k - k / 2));
            let found = nearly(&exact);
            if found.error() < f64::INFINITY {
                // Scaled so that no bound underflows.
                let scaled = |x: f64| Dyadic::exact(x).times(&power(400));
                let off = exact.times(&power(400)).minus(&scaled(found.high)).minus(&scaled(found.low()));
                let bound = scaled(found.high.abs()).times(&power(-106));
                let off = if off.sign() == Ok(Ordering::Less) { off.negated() } else { off };
                assert_eq!(off.minus(&bound).sign(), Ok(Ordering::Less), "{k}");
                held += 1;
            } else {
                assert_eq!(found.sign(), Err(Uncertain));
                refused += 1;
            }
        }
        assert!(held > 1600 && refused > 400, "{held}, {refused}");
        assert_eq!(nearly(&Dyadic::exact(-0.0)).sign(), Ok(Ordering::Equal));
    }

    /// The constants are the proven bounds, rounded up to whole numbers. The search reaches 2.4u² of 3u²
    /// for a sum, 3.2u² of 4u² for a product, 6.1u² of 15.5u² for a quotient and 2.9u² of 3.125u² for a
    /// square root.
    #[test]
    fn operations_are_as_near_as_their_bounds_say() {
        let worst_sum =
            [9007199254740991.0, (-0.5_f64).next_up(), -4503599627370493.5, (-0.25_f64).next_up()];
        let sum = |x: &[f64; 4]| {
            let ((a, p), (b, q)) = (number(x[0], x[1]), number(x[2], x[3]));
            share(a.plus(&b), &p.plus(&q))
        };
        let (found, _) = worst(10, 3000, draw, sum);
        let product = |x: &[f64; 4]| {
            let ((a, p), (b, q)) = (number(x[0], x[1]), number(x[2], x[3]));
            share(a.times(&b), &p.times(&q))
        };
        let (product, _) = worst(10, 3000, draw, product);
        let quotient = |x: &[f64; 4]| {
            let ((a, p), (b, q)) = (number(x[0], x[1]), number(x[2].abs(), x[3]));
            share_of(a.over(b), &Root::linear(p, q, 0))
        };
        let (quotient, _) = worst(10, 2000, draw, quotient);
        let root = |x: &[f64; 2]| {
            let (a, p) = number(x[0].abs(), x[1]);
            let zero = Dyadic::exact(0.0);
            let [_, Some(root)] =
                Root::quadratic(Dyadic::exact(1.0), zero, p.negated(), p, Ordering::Greater, 0)
            else {
                return 0.0;
            };
            share_of(a.sqrt(), &root)
        };
        let (root, _) = worst(10, 2000, draw, root);
        assert!(sum(&worst_sum) > 0.562, "the example of the article");
        assert_slack("PLUS", found, 0.604);
        assert_slack("TIMES", product, 0.639);
        assert_slack("OVER", quotient, 0.384);
        assert_slack("SQRT", root, 0.733);
    }

    /// Operands that are off by a tenth of themselves, or nearly all for a square root: a single error counts
    /// in full, and so do two together.
    #[test]
    fn errors_of_operands_are_passed_on() {
        let given = |x: f64, off: f64| {
            let truth = Dyadic::exact(x).plus(&Dyadic::exact(off));
            (DoubleDouble::within(x, off.abs(), One), truth)
        };
        let mut next = crate::testing::numbers();
        let mut largest: [f64; 4] = [0.0; 4];
        for _ in 0..100 {
            let (x, y) = (1.0 + next(), 1.0 + next());
            let ((a, p), (b, q), (c, r)) = (given(x, 0.1 * x), given(y, 0.1 * y), given(y, -0.1 * y));
            let (d, s) = given(x, -0.99 * x);
            let [_, Some(root)] = Root::quadratic(
                Dyadic::exact(1.0),
                Dyadic::exact(0.0),
                s.negated(),
                s.clone(),
                Ordering::Greater,
                0,
            ) else {
                unreachable!("a positive number has a root")
            };
            let shares = [
                share(a.plus(&b), &p.plus(&q)),
                share(a.times(&b), &p.times(&q)),
                share_of(a.over(c), &Root::linear(p, r, 0)),
                share_of(d.sqrt(), &root),
            ];
            (0..4).for_each(|k| largest[k] = largest[k].max(shares[k]));
        }
        // √x − √(x/100) = 0.9·√x is 0.91 of 0.99·x/√x.
        for (what, found, known) in [
            ("sum", largest[0], 1.0),
            ("product", largest[1], 1.0),
            ("quotient", largest[2], 1.0),
            ("root", largest[3], 0.91),
        ] {
            assert_slack(what, found, known);
        }
    }

    /// Quotients and square roots keep their accuracy down to the size at which they are refused.
    #[test]
    fn small_operands_are_as_near_or_refused() {
        let (mut known, mut refused) = (0, 0);
        let mut next = crate::testing::numbers();
        for exponent in (-1010..-700).step_by(2) {
            // The divisor is as small, or just large enough for an ordinary quotient.
            for beside in [exponent, exponent, -790, -720] {
                let mut operand = |exponent: i32| {
                    let (x, fraction, scale) = (1.0 + next(), next() - 0.5, 2.0_f64.powi(exponent / 2));
                    let low = fraction * f64::EPSILON;
                    let sum = DoubleDouble {
                        high: x * scale * scale,
                        low: Some(low * scale * scale),
                        ..DoubleDouble::exact(0.0)
                    };
                    (sum, Dyadic::exact(sum.high).plus(&Dyadic::exact(sum.low())))
                };
                let ((a, p), (b, q)) = (operand(exponent), operand(beside));
                let zero = Dyadic::exact(0.0);
                let [_, Some(root)] =
                    Root::quadratic(Dyadic::exact(1.0), zero, p.negated(), p.clone(), Ordering::Greater, 0)
                else {
                    unreachable!("a positive number has a root")
                };
                for (found, root) in [(a.sqrt(), &root), (a.over(b), &Root::linear(p, q, 0))] {
                    (known, refused) =
                        (known + usize::from(found.is_ok()), refused + usize::from(found.is_err()));
                    assert!(share_of(found, root) <= 1.0, "2^{exponent}");
                }
            }
        }
        assert!(known > 300 && refused > 300, "{known}, {refused}");
    }

    /// The 2u·|low| in `rounded` is twice the rounding error of low ± error. In `sign`, low may take one of
    /// the 2u from high, and the other is for the product.
    #[test]
    fn what_a_rounding_could_hide_is_uncertain() {
        let number = |low: f64, error: f64| DoubleDouble {
            low: Some(low),
            error: Some(error),
            ..DoubleDouble::exact(1.0)
        };
        // The midpoint of 1 and its successor, or within less than half an ulp of `low` of it.
        assert_eq!(number(UNIT, UNIT * UNIT / 2.0).rounded(), Err(Uncertain));
        assert_eq!(number(UNIT, 0.0).rounded(), Err(Uncertain));
        assert_eq!(number(UNIT * (1.0 - 4.0 * UNIT), 0.0).rounded(), Ok(1.0));
        // The error counts in full.
        assert_eq!(number(0.75 * UNIT, 0.25 * UNIT).rounded(), Err(Uncertain));
        assert_eq!(number(0.75 * UNIT, 0.24 * UNIT).rounded(), Ok(1.0));
        // The interval reaches down to zero.
        assert_eq!(number(-UNIT, 1.0 - UNIT).sign(), Err(Uncertain));
        assert_eq!(number(-UNIT, 1.0 - 4.0 * UNIT).sign(), Ok(Ordering::Greater));
    }

    #[test]
    fn proportions_are_known_to_what_is_promised() {
        let promised = 2.0_f64.powi(-60);
        for (error, known) in [(promised, true), (1.1 * promised, false)] {
            let near = DoubleDouble::within(0.5, error, One);
            let found = DoubleDouble::proportions(&[DoubleDouble::exact(1.0), near, near]);
            assert_eq!(found, if known { Ok([1.0, 0.5, 0.5]) } else { Err(Uncertain) });
        }
    }

    /// Proportions of vectors whose lengths range from 2⁻⁴⁰⁰ to 2⁴⁰⁰.
    #[test]
    fn proportions_can_be_squared() {
        let mut known = Vec::new();
        for k in -1000..1000 {
            let v = [0.5, -0.75, 0.25].map(|x| DoubleDouble::exact(x * 2.0_f64.powi(k)));
            let Ok(v) = DoubleDouble::proportions(&v) else { continue };
            let [x, y, z] = v.map(|x| x / (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt());
            // A square root, three quotients and their squares are off by less than 8 roundings.
            assert!((x * x + y * y + z * z - 1.0).abs() < 16.0 * UNIT, "2^{k}");
            known.push(k);
        }
        assert_eq!(known, (-399..=400).collect::<Vec<_>>());
    }
}
