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

/// The high part, the low part and the bound of the error, each in one register.
type Terms<F> = [F; 3];

operations! {
    /// 2Sum.
    fn fp_plus_fp(a: F, b: F) -> Terms<F> {
        let (high, low) = two_sum(a, b);
        [high, low, F::splat(0.0)]
    }

    /// DWPlusFP.
    fn dw_plus_fp(a: Terms<F>, b: F) -> Terms<F> {
        let [ah, al, error] = a;
        let (sh, sl) = two_sum(ah, b);
        let (high, low) = fast_two_sum(sh, sl.add(al));
        [high, low, error_of_sum(high, error)]
    }

    /// AccurateDWPlusDW.
    fn dw_plus_dw(a: Terms<F>, b: Terms<F>) -> Terms<F> {
        let ([ah, al, e], [bh, bl, f]) = (a, b);
        let ((sh, sl), (th, tl)) = (two_sum(ah, bh), two_sum(al, bl));
        let (vh, vl) = fast_two_sum(sh, sl.add(th));
        let (high, low) = fast_two_sum(vh, tl.add(vl));
        [high, low, error_of_sum(high, e.add(f))]
    }

    /// The bound of a sum, with the errors of its operands.
    fn error_of_sum(high: F, operands: F) -> F {
        operands.add(high.abs().mul(F::splat(PLUS))).mul(F::splat(PAD))
    }

    /// 2Prod.
    fn fp_times_fp(a: F, b: F) -> Terms<F> {
        let (high, low) = two_product(a, b);
        [high, low, underflow_of_product(a.abs(), b.abs())]
    }

    /// DWTimesFP3.
    fn dw_times_fp(a: Terms<F>, b: F) -> Terms<F> {
        let ([ah, al, error], size) = (a, b.abs());
        let (ph, pl) = two_product(ah, b);
        let (high, low) = fast_two_sum(ph, al.mul_add(b, pl));
        let underflow = underflow_of_product(ah.abs().add(error), size);
        [high, low, error_of_product(high, size.mul(error), underflow)]
    }

    /// DWTimesDW3.
    fn dw_times_dw(a: Terms<F>, b: Terms<F>) -> Terms<F> {
        let ([ah, al, e], [bh, bl, f]) = (a, b);
        let (ph, pl) = two_product(ah, bh);
        let (high, low) = fast_two_sum(ph, pl.add(al.mul_add(bh, ah.mul_add(bl, al.mul(bl)))));
        let (larger, size) = (ah.abs().add(e), bh.abs());
        let underflow = underflow_of_product(larger, size.add(f));
        [high, low, error_of_product(high, larger.mul(f).add(size.mul(e)), underflow)]
    }

    /// Bound of what a product of numbers of these sizes loses to underflow; 0 if one is exactly zero.
    fn underflow_of_product(a: F, b: F) -> F {
        let zero = F::splat(0.0);
        a.min(b).le_pick(zero, zero, F::splat(UNDERFLOW))
    }

    /// The bound of a product; `operands`: its part that comes from their errors.
    fn error_of_product(high: F, operands: F, underflow: F) -> F {
        let (pad, rounding) = (F::splat(PAD), high.abs().mul(F::splat(TIMES)));
        operands.mul(pad).add(rounding).mul(pad).add(underflow)
    }

    /// DWDivDW2, and the lanes in which its bound holds. The errors of the operands propagate as in
    /// `RunningErrors::over`.
    fn dw_over_dw(a: Terms<F>, b: Terms<F>) -> (Terms<F>, u32) {
        let ([ah, al, e], [bh, bl, f]) = (a, b);
        let (pad, small, size) = (F::splat(PAD), F::splat(SMALL), ah.abs());
        let margin = bh.abs().mul(F::splat(1.0 - 2.0 * UNIT)).sub(f.mul(pad));
        let known = small.lt(margin) & (small.le(size) | size.le(F::splat(0.0)));
        let th = ah.div(bh);
        let (ph, pl) = two_product(bh, th);
        let (rh, rl) = fast_two_sum(ph, bl.mul_add(th, pl));
        let delta = ah.sub(rh).add(al.sub(rl));
        let (high, low) = fast_two_sum(th, delta.div(bh));
        let operands = e.add(high.abs().mul(f).mul(pad));
        let error = operands.div(margin).mul(pad).add(high.abs().mul(F::splat(OVER)));
        ([high, low, error.mul(pad).add(F::splat(UNDERFLOW))], known)
    }

    /// SQRTDWtoDW, and the lanes in which its bound holds.
    fn sqrt_dw(x: Terms<F>) -> (Terms<F>, u32) {
        let [xh, xl, error] = x;
        let (pad, zero, size) = (F::splat(PAD), F::splat(0.0), xh.abs().add(error));
        let away = error.mul(pad).lt(xh) & F::splat(SMALL).lt(xh);
        let s = xh.sqrt();
        let rho = s.negated().mul_add(s, xh);
        let (high, low) = fast_two_sum(s, rho.add(xl).div(s.add(s)));
        let error = error.div(high).mul(pad).add(high.mul(F::splat(SQRT))).mul(pad);
        let terms = [
            size.le_pick(zero, zero, high),
            size.le_pick(zero, zero, low),
            size.le_pick(zero, zero, error),
        ];
        (terms, away | size.le(zero))
    }

    /// The lanes in which the number is below, equal to and above zero.
    fn signs(high: F, error: F) -> [u32; 3] {
        // |high + low| ≥ |high|·(1 − u).
        let least = high.mul(F::splat(1.0 - 2.0 * UNIT));
        let zero = high.abs().add(error).le(F::splat(0.0));
        [least.lt(error.negated()), zero, error.lt(least)]
    }

    /// The lanes in which `high` is the number rounded to the nearest float64.
    fn rounded_lanes(x: Terms<F>) -> u32 {
        // Rounding is monotone: if both ends of the interval round to `high`, so does the true value.
        let [high, low, error] = x;
        let error = error.mul(F::splat(PAD)).add(low.abs().mul(F::splat(2.0 * UNIT)));
        let error = error.add(F::splat(UNDERFLOW));
        let certain = high.add(low.add(error)).le(high) & high.le(high.add(low.sub(error)));
        // A subnormal result would be rounded twice.
        let size = high.abs();
        certain & F::splat(f64::MIN_POSITIVE).le(size) & size.lt(F::splat(f64::INFINITY))
    }

    /// `a` where 0 ≤ `by`, `b` elsewhere.
    fn pick(by: F, a: Terms<F>, b: Terms<F>) -> Terms<F> {
        let (zero, [ah, al, e], [bh, bl, f]) = (F::splat(0.0), a, b);
        [zero.le_pick(by, ah, bh), zero.le_pick(by, al, bl), zero.le_pick(by, e, f)]
    }
}

/// One real number per lane, within `error` of `high + low`, with |low| ≤ ½ ulp(high).
#[derive(Clone, Copy, Debug)]
pub struct DoubleDoubles<L: Lanes<N>, const N: usize> {
    high: L::Floats,
    /// `None`: zero in every lane.
    low_and_error: Option<[L::Floats; 2]>,
    lanes: L,
}

pub type DoubleDouble = DoubleDoubles<One, 1>;

impl<L: Lanes<N>, const N: usize> OfRays<L, N> for DoubleDoubles<L, N> {
    #[inline(always)]
    fn of_rays(value: L::Floats, lanes: L) -> Self {
        DoubleDoubles { high: value, low_and_error: None, lanes }
    }

    #[inline(always)]
    fn load<const M: usize>(stored: &Stored<M>, i: usize, lanes: L) -> Self {
        let of = |x: &[f64; M]| L::Floats::load(&x.as_chunks().0[i]);
        Self::new([of(&stored.high), of(&stored.low), of(&stored.error)], lanes)
    }

    #[inline(always)]
    fn store<const M: usize>(&self, i: usize, stored: &mut Stored<M>) {
        let [high, low, error] = self.terms();
        stored.high.as_chunks_mut().0[i] = high.store();
        stored.low.as_chunks_mut().0[i] = low.store();
        stored.error.as_chunks_mut().0[i] = error.store();
    }
}

impl<L: Lanes<N>, const N: usize> DoubleDoubles<L, N> {
    #[inline(always)]
    fn new([high, low, error]: Terms<L::Floats>, lanes: L) -> Self {
        DoubleDoubles { high, low_and_error: Some([low, error]), lanes }
    }

    #[inline(always)]
    pub fn within(value: L::Floats, error: L::Floats, lanes: L) -> Self {
        Self::new([value, splat::<L, N>(0.0), error], lanes)
    }

    /// Within `error` of high + low, |low| ≤ |high|.
    #[inline(always)]
    pub fn of_sum(high: L::Floats, low: L::Floats, error: L::Floats, lanes: L) -> Self {
        let (high, low) = fast_two_sum(high, low);
        Self::new([high, low, error], lanes)
    }

    /// The number rounded to float64, and a bound of its whole error.
    #[inline(always)]
    pub fn parts(self) -> (L::Floats, L::Floats) {
        (self.high, self.error())
    }

    /// The high and the low part, and a bound of the error of their sum.
    #[inline(always)]
    pub fn terms(self) -> Terms<L::Floats> {
        let [low, error] = self.low_and_error.unwrap_or([splat::<L, N>(0.0); 2]);
        [self.high, low, error]
    }

    #[inline(always)]
    fn error(self) -> L::Floats {
        self.terms()[2]
    }

    /// `a` where 0 ≤ `by`, `b` elsewhere.
    #[inline(always)]
    fn pick(by: L::Floats, a: Self, b: Self) -> Self {
        Self::new(pick(by, a.terms(), b.terms()), a.lanes.or(b.lanes))
    }

    /// Rounded to the nearest float64.
    #[inline(always)]
    pub fn rounded(self) -> Result<L::Floats, Uncertain> {
        self.lanes.keep(rounded_lanes(self.terms()))?;
        Ok(self.high)
    }

    #[inline(always)]
    fn sum(self, other: Self) -> Self {
        let terms = match (self.low_and_error, other.low_and_error) {
            (None, None) => fp_plus_fp(self.high, other.high),
            (Some([low, error]), None) => dw_plus_fp([self.high, low, error], other.high),
            (None, Some([low, error])) => dw_plus_fp([other.high, low, error], self.high),
            (Some([al, e]), Some([bl, f])) => dw_plus_dw([self.high, al, e], [other.high, bl, f]),
        };
        Self::new(terms, self.lanes.or(other.lanes))
    }

    #[inline(always)]
    fn product(self, other: Self) -> Self {
        let terms = match (self.low_and_error, other.low_and_error) {
            (None, None) => fp_times_fp(self.high, other.high),
            (Some([low, error]), None) => dw_times_fp([self.high, low, error], other.high),
            (None, Some([low, error])) => dw_times_fp([other.high, low, error], self.high),
            (Some([al, e]), Some([bl, f])) => dw_times_dw([self.high, al, e], [other.high, bl, f]),
        };
        Self::new(terms, self.lanes.or(other.lanes))
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

    #[inline(always)]
    fn over(self, b: Self) -> Result<Self, Uncertain> {
        let ((terms, known), lanes) = (dw_over_dw(self.terms(), b.terms()), self.lanes.or(b.lanes));
        lanes.keep(known)?;
        Ok(Self::new(terms, lanes))
    }

    /// The true x must be ≥ 0.
    #[inline(always)]
    fn sqrt(self) -> Result<Self, Uncertain> {
        let (terms, known) = sqrt_dw(self.terms());
        self.lanes.keep(known)?;
        Ok(Self::new(terms, self.lanes))
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
        let DoubleDoubles { high, low_and_error, lanes } = *x;
        let Some([_, error]) = low_and_error else {
            return RunningErrors::of_rays(high, lanes);
        };
        let error = high.abs().fused(splat::<L, N>(UNIT), error);
        RunningErrors::within(high, error.mul(splat::<L, N>(PAD)), lanes)
    }
}

/// Always with a low part and a bound, so that the compiler knows that both are there.
impl<L: Lanes<N>, const N: usize> From<&DoubleDouble> for DoubleDoubles<L, N> {
    #[inline(always)]
    fn from(x: &DoubleDouble) -> Self {
        let [high, low, error] = x.terms();
        Self::new([splat::<L, N>(high), splat::<L, N>(low), splat::<L, N>(error)], L::UNIFORM)
    }
}

impl<L: Lanes<N>, const N: usize> Number for DoubleDoubles<L, N> {
    type Floats = L::Floats;

    #[inline(always)]
    fn exact(x: f64) -> Self {
        Self::of_rays(splat::<L, N>(x), L::UNIFORM)
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
        match self.low_and_error {
            None => DoubleDoubles { high, ..*self },
            Some([low, error]) => Self::new([high, low.negated(), error], self.lanes),
        }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        let [less, equal, greater] = signs(self.high, self.error());
        self.lanes.agree(less, equal, greater)
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
        let [high, low, error] = self.terms();
        (high, Self::within(low, error, self.lanes))
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
        let [high, low, error] = t.terms();
        interval::<L, N>(high, low.abs().add(error), t.lanes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::tests::{Enclosure, square_root, within};
    use crate::arith::number::{Dyadic, nearly};
    use crate::testing::{assert_slack, worst};

    impl<L: Lanes<N>, const N: usize> Enclosure<N> for DoubleDoubles<L, N> {
        fn holds(&self, lane: usize, x: &Dyadic) -> bool {
            let [high, low, error] = self.terms().map(Floats::store);
            within(x, high[lane], low[lane], error[lane])
        }

        fn is_certain(&self, lane: usize) -> bool {
            self.high.abs().store()[lane] > self.error().store()[lane]
        }
    }

    /// high + fraction·ulp(high), without an error of its own.
    fn number(high: f64, fraction: f64) -> (DoubleDouble, Dyadic) {
        let low = fraction * (high.abs().next_up() - high.abs());
        let sum = DoubleDouble::exact(high).plus(&DoubleDouble::exact(low));
        assert_eq!(sum.error(), 0.0);
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
        let [high, low, error] = found.terms();
        let off = x.minus(&Dyadic::exact(high)).minus(&Dyadic::exact(low));
        off.split().0.abs() / error
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
            let [high, low, error] = found.terms();
            if error < f64::INFINITY {
                // Scaled so that no bound underflows.
                let scaled = |x: f64| Dyadic::exact(x).times(&power(400));
                let off = exact.times(&power(400)).minus(&scaled(high)).minus(&scaled(low));
                let bound = scaled(high.abs()).times(&power(-106));
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
            let Some(root) = square_root(p) else { return 0.0 };
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
        let mut largest: [f64; 5] = [0.0; 5];
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
                share(a.times(&DoubleDouble::exact(y)), &p.times(&Dyadic::exact(y))),
                share_of(a.over(c), &Root::linear(p, r, 0)),
                share_of(d.sqrt(), &root),
            ];
            (0..5).for_each(|k| largest[k] = largest[k].max(shares[k]));
        }
        // √x − √(x/100) = 0.9·√x is 0.91 of 0.99·x/√x.
        for (what, found, known) in [
            ("sum", largest[0], 1.0),
            ("product", largest[1], 1.0),
            ("product with an exact number", largest[2], 1.0),
            ("quotient", largest[3], 1.0),
            ("root", largest[4], 0.91),
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
                    let [high, low] = [x, low].map(|x| x * scale * scale);
                    let sum = DoubleDouble::new([high, low, 0.0], One);
                    (sum, Dyadic::exact(high).plus(&Dyadic::exact(low)))
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
        let number = |low: f64, error: f64| DoubleDouble::new([1.0, low, error], One);
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
