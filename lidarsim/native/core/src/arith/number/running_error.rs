//! Float64 with a running error bound (N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2002).
//!
//! The bound is weight·size. Sizes are summed and multiplied along with the values, as Higham's running
//! error μ is; weights, small multiples of u, depend on the formula alone and are compile-time constants.

use std::borrow::Cow;
use std::cmp::Ordering;

use super::lanes::{Lanes, OfRays, One};
use super::{Interval, Kinds, Number, PAD, Root, Stored, UNDERFLOW, UNIT, Uncertain};
use crate::arith::simd::{Floats, operations};

/// The weight of a quotient; see `over`.
const QUOTIENT: f64 = 3.0 * UNIT;

operations! {
    /// The lanes of a size above zero, or unknown.
    fn nonzero_lanes(size: F) -> u32 {
        !size.le(F::splat(0.0))
    }

    fn scaled(x: F, factor: f64) -> F {
        x.mul(F::splat(factor))
    }

    /// The size of a number within `error` of `value`. This order propagates a NaN error.
    fn size_of_given(value: F, error: F) -> F {
        value.abs().max(error.mul(F::splat(1.0 / GIVEN)))
    }

    /// The sum of two numbers, and its size.
    fn sum(a: [F; 2], b: [F; 2]) -> [F; 2] {
        [a[0].add(b[0]), a[1].add(b[1])]
    }

    /// The product of two numbers, and its size; see `times`.
    fn product(a: [F; 2], b: [F; 2]) -> [F; 2] {
        [a[0].mul(b[0]), a[1].fused(b[1], F::splat(UNDERFLOW))]
    }

    /// A quotient with its size, and the lanes in which that is a bound; see `over`.
    fn quotient(a: [F; 2], weight_of_a: f64, b: [F; 2], weight_of_b: f64) -> ([F; 2], u32) {
        let (pad, underflow) = (F::splat(PAD), F::splat(UNDERFLOW));
        let inverse = F::splat(1.0).div(b[0]);
        let slope = inverse.abs();
        let value = a[0].mul(inverse);
        let ordinary = F::splat(f64::MIN_POSITIVE).lt(slope);
        let mut operands = underflow;
        if weight_of_a != 0.0 {
            operands = a[1].fused(F::splat(weight_of_a / QUOTIENT * PAD), operands);
        }
        let (size, known) = if weight_of_b == 0.0 {
            (operands.mul(slope), ordinary)
        } else {
            let q = b[1].mul(F::splat(weight_of_b * PAD)).mul(slope).mul(pad);
            operands = value.abs().fused(b[1].mul(F::splat(weight_of_b / QUOTIENT * PAD)), operands);
            let size = operands.mul(slope).mul(q.fused(F::splat(2.0), F::splat(1.0)));
            (size, ordinary & q.le(F::splat(0.5)))
        };
        ([value, size.fused(pad, value.abs()).fused(pad, underflow)], known)
    }

    /// The square root of a number within `error` of `value` with its size, and the lanes in which the number
    /// is above zero and the size a bound; see `sqrt`.
    fn square_root(value: F, error: F) -> ([F; 2], u32) {
        let root = value.sqrt();
        let size = root.add(error.mul(F::splat(1.0 / UNIT)).div(root));
        ([root, size.fused(F::splat(PAD), F::splat(UNDERFLOW))], error.lt(value))
    }

    /// The same with a bound in the other lanes, too.
    fn square_root_near_zero(value: F, error: F, root: [F; 2]) -> [F; 2] {
        let zero = F::splat(0.0);
        let reach = value.max(zero).add(error).mul(F::splat(PAD)).sqrt().mul(F::splat(PAD / UNIT));
        [value.le_pick(error, zero, root[0]), value.le_pick(error, reach, root[1])]
    }

    /// The lanes of numbers below and above zero.
    fn signs(value: F, error: F) -> [u32; 2] {
        [value.lt(error.negated()), error.lt(value)]
    }

    /// `a` where 0 ≤ `by`, `b` elsewhere.
    fn pick(by: F, a: [F; 2], b: [F; 2]) -> [F; 2] {
        let zero = F::splat(0.0);
        [zero.le_pick(by, a[0], b[0]), zero.le_pick(by, a[1], b[1])]
    }

    /// The ends of an interval, and the lanes in which they are finite; see `interval`.
    fn ends(value: F, error: F) -> ([F; 2], u32) {
        let margin = error.add(value.abs().mul(F::splat(4.0 * UNIT)));
        let margin = margin.mul(F::splat(PAD)).add(F::splat(UNDERFLOW));
        ([value.sub(margin), value.add(margin)], value.abs().add(margin).lt(F::splat(f64::INFINITY)))
    }
}

/// One real number per lane, within `weight`·`size` of `value`. An infinite or NaN bound means unknown.
#[derive(Clone, Copy, Debug)]
pub struct RunningErrors<L: Lanes<N>, const N: usize> {
    value: L::Floats,
    /// At least |value|.
    size: L::Floats,
    /// 0 if the numbers are exact, else at least the unit roundoff.
    weight: f64,
    /// Bits of the lanes whose number is not known to be exactly zero.
    nonzero: u32,
    lanes: L,
}

pub type RunningError = RunningErrors<One, 1>;

/// The weight for given bounds: a power of two close to that of ordinary formulas, so that the size stays
/// close to the value. With larger sizes, products would be larger by as many factors.
const GIVEN: f64 = 8.0 * UNIT;

impl<L: Lanes<N>, const N: usize> OfRays<L, N> for RunningErrors<L, N> {
    #[inline(always)]
    fn of_rays(value: L::Floats, lanes: L) -> Self {
        Self::rounded(value, 0.0, lanes)
    }

    #[inline(always)]
    fn load<const M: usize>(stored: &Stored<M>, i: usize, lanes: L) -> Self {
        let of = |x: &[f64; M]| L::Floats::load(&x.as_chunks().0[i]);
        Self::within(of(&stored.high), of(&stored.error), lanes)
    }

    #[inline(always)]
    fn store<const M: usize>(&self, i: usize, stored: &mut Stored<M>) {
        stored.high.as_chunks_mut().0[i] = self.value.store();
        stored.error.as_chunks_mut().0[i] = self.error().store();
        let mut zeros = !self.nonzero & ((1 << N) - 1);
        while zeros != 0 {
            let lane = i * N + zeros.trailing_zeros() as usize;
            (stored.high[lane], stored.error[lane]) = (0.0, 0.0);
            zeros &= zeros - 1;
        }
    }
}

impl<L: Lanes<N>, const N: usize> RunningErrors<L, N> {
    /// Numbers within `error` of `value`; exactly zero where both are.
    #[inline(always)]
    pub fn within(value: L::Floats, error: L::Floats, lanes: L) -> Self {
        let size = size_of_given(value, error);
        RunningErrors { value, size, weight: GIVEN, nonzero: nonzero_lanes(size), lanes }
    }

    /// Numbers that are exact or rounded once, and zero only where the true value is.
    #[inline(always)]
    fn rounded(value: L::Floats, weight: f64, lanes: L) -> Self {
        let size = value.abs();
        RunningErrors { value, size, weight, nonzero: nonzero_lanes(size), lanes }
    }

    /// The lanes whose number is known to be exactly zero.
    #[inline(always)]
    pub fn zeros(self) -> u32 {
        !self.nonzero
    }

    /// The number and a bound of its error.
    #[inline(always)]
    pub fn parts(self) -> (L::Floats, L::Floats) {
        (self.value, self.error())
    }

    #[inline(always)]
    fn error(self) -> L::Floats {
        if self.weight == 0.0 { splat::<L, N>(0.0) } else { scaled(self.size, self.weight * PAD) }
    }

    /// `a` where 0 ≤ `by`, `b` elsewhere.
    #[inline(always)]
    fn pick(by: L::Floats, a: Self, b: Self) -> Self {
        let [value, size] = pick(by, [a.value, a.size], [b.value, b.size]);
        RunningErrors {
            value,
            size,
            weight: larger(a.weight, b.weight),
            nonzero: a.nonzero | b.nonzero,
            lanes: a.lanes.or(b.lanes),
        }
    }

    /// With ρ = 1/b rounded and q ≥ ε_b/|b|, q ≤ ½: |a/b − v| ≤ (ε_a + |a/b|·ε_b)/(|b| −
    /// ε_b) + 3u·|v| for v = a·ρ, rounded, and 1/(|b| − ε_b) ≤ |1/b|·(1 + 2q). A ρ so small that
    /// it might have lost bits is refused. The size is that sum in units of 3u.
    #[inline(always)]
    fn over(self, b: Self) -> Result<Self, Uncertain> {
        let lanes = self.lanes.or(b.lanes);
        let ([value, size], known) =
            quotient([self.value, self.size], self.weight, [b.value, b.size], b.weight);
        lanes.keep(known)?;
        Ok(RunningErrors { value, size, weight: QUOTIENT, nonzero: self.nonzero, lanes })
    }

    /// The true x must be ≥ 0. |√x − √v| = |x − v|/(√x + √v) ≤ ε/√v; where v ≤ ε, 0 ≤
    /// √x ≤ √(v + ε).
    #[inline(always)]
    fn sqrt(self) -> Self {
        let error = self.error();
        let ([mut value, mut size], away) = square_root(self.value, error);
        if away & self.lanes.active() != self.lanes.active() {
            [value, size] = square_root_near_zero(self.value, error, [value, size]);
        }
        RunningErrors { value, size, weight: UNIT, ..self }
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

/// As `f64::max`, for numbers that are not NaN.
#[inline(always)]
const fn larger(x: f64, y: f64) -> f64 {
    if x > y { x } else { y }
}

/// One number for all lanes.
#[inline(always)]
pub(super) fn splat<L: Lanes<N>, const N: usize>(x: f64) -> L::Floats {
    L::Floats::splat(x)
}

/// [value − error, value + error], rounded outward: with m = (ε + 4u·|v|)·PAD, the rounding of v ± m,
/// at most u·(|v| + m), is within m − ε.
#[inline(always)]
pub(super) fn interval<L: Lanes<N>, const N: usize>(
    value: L::Floats,
    error: L::Floats,
    lanes: L,
) -> Result<Interval<L::Floats>, Uncertain> {
    let ([low, high], finite) = ends(value, error);
    lanes.keep(finite)?;
    Ok(Interval { low, high })
}

/// Always with the same weight, so that the compiler knows it.
impl<L: Lanes<N>, const N: usize> From<&RunningError> for RunningErrors<L, N> {
    #[inline(always)]
    fn from(x: &RunningError) -> Self {
        let RunningErrors { value, size, weight, nonzero, .. } = *x;
        let size = larger(size, size * (weight * PAD / GIVEN));
        let nonzero = if nonzero & 1 == 0 { 0 } else { u32::MAX };
        let (value, size) = (splat::<L, N>(value), splat::<L, N>(size));
        RunningErrors { value, size, weight: GIVEN, nonzero, lanes: L::UNIFORM }
    }
}

impl<L: Lanes<N>, const N: usize> Number for RunningErrors<L, N> {
    type Floats = L::Floats;

    #[inline(always)]
    fn exact(x: f64) -> Self {
        Self::rounded(splat::<L, N>(x), 0.0, L::UNIFORM)
    }

    /// |(x + y) − z| ≤ max(w_x, w_y)·(s_x + s_y) + u·|z| for z = x + y, rounded, and |z| ≤ s = s_x +
    /// s_y, rounded, as rounding is monotone. A subnormal sum of float64 numbers is exact, so nothing
    /// underflows.
    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        let lanes = self.lanes.or(other.lanes);
        if self.weight == 0.0 && other.weight == 0.0 {
            return Self::rounded(self.value.add(other.value), UNIT, lanes);
        }
        let weight = (larger(self.weight, other.weight) + UNIT) * PAD;
        let [value, size] = sum([self.value, self.size], [other.value, other.size]);
        RunningErrors { value, size, weight, nonzero: self.nonzero | other.nonzero, lanes }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        self.plus(&other.negated())
    }

    /// |x·y − z| ≤ (w_x + w_y + w_x·w_y)·s_x·s_y + u·|z| for z = x·y, rounded, and |z| ≤ s =
    /// s_x·s_y, rounded. z may lose half the smallest subnormal to underflow: less than half of what `PAD`
    /// adds, as w·s ≥ u·`UNDERFLOW`.
    #[inline(always)]
    fn times(&self, other: &Self) -> Self {
        let (v, w) = (self.weight, other.weight);
        let [value, size] = product([self.value, self.size], [other.value, other.size]);
        RunningErrors {
            value,
            size,
            weight: (v + w + v * w + UNIT) * PAD,
            nonzero: self.nonzero & other.nonzero,
            lanes: self.lanes.or(other.lanes),
        }
    }

    #[inline(always)]
    fn negated(&self) -> Self {
        RunningErrors { value: self.value.negated(), ..*self }
    }

    /// The size overflows if the value does.
    #[inline(always)]
    fn doubled(&self) -> Self {
        let terms = [self.value, self.size];
        let [value, size] = sum(terms, terms);
        RunningErrors { value, size, ..*self }
    }

    #[inline(always)]
    fn sign(&self) -> Result<Ordering, Uncertain> {
        let [less, greater] = signs(self.value, self.error());
        self.lanes.agree(less, !self.nonzero, greater)
    }

    #[inline(always)]
    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain> {
        p.plus(&q.times(&d.sqrt())).sign()
    }

    #[inline(always)]
    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain> {
        RunningErrors::of_root(a)?.minus(&RunningErrors::of_root(b)?).sign()
    }

    #[inline(always)]
    fn locate(root: &Root<Self>) -> Result<Option<Self>, Uncertain> {
        Ok(Some(RunningErrors::of_root(root)?))
    }

    #[inline(always)]
    fn round(_: &Root<Self>) -> Result<L::Floats, Uncertain> {
        Err(Uncertain)
    }

    fn split(&self) -> (L::Floats, Self) {
        (self.value, Self::within(splat::<L, N>(0.0), self.error(), self.lanes))
    }

    #[inline(always)]
    fn of_kinds<K: Kinds>(kinds: &K) -> Cow<'_, K::In<Self>> {
        Cow::Owned(K::convert(kinds.running_error()))
    }

    #[inline(always)]
    fn value(root: &Root<Self>) -> Result<Self, Uncertain> {
        RunningErrors::of_root(root)
    }

    #[inline(always)]
    fn proportions(_: &[Self; 3]) -> Result<[L::Floats; 3], Uncertain> {
        Err(Uncertain)
    }

    #[inline(always)]
    fn enclose(root: &Root<Self>) -> Result<Interval<L::Floats>, Uncertain> {
        let t = RunningErrors::of_root(root)?;
        interval::<L, N>(t.value, t.error(), t.lanes)
    }
}

#[cfg(test)]
impl<L: Lanes<N>, const N: usize> super::tests::Enclosure<N> for RunningErrors<L, N> {
    fn holds(&self, lane: usize, x: &super::Dyadic) -> bool {
        super::tests::within(x, self.value.store()[lane], 0.0, self.error().store()[lane])
    }

    fn is_certain(&self, lane: usize) -> bool {
        self.value.abs().store()[lane] > self.error().store()[lane]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::Dyadic;
    use crate::arith::number::tests::square_root;
    use crate::testing::{assert_slack, worst};

    fn share(found: RunningError, x: &Dyadic) -> f64 {
        x.minus(&Dyadic::exact(found.value)).split().0.abs() / found.error()
    }

    fn draw(_: usize, next: &mut dyn FnMut() -> f64) -> f64 {
        1.0 + next()
    }

    /// Off by its whole bound, eight roundings.
    fn at_bound(x: f64, up: bool) -> (RunningError, Dyadic) {
        let error = GIVEN * x;
        let truth = Dyadic::exact(x).plus(&Dyadic::exact(if up { error } else { -error }));
        (RunningError::within(x, error, One), truth)
    }

    fn exact(x: f64, _: bool) -> (RunningError, Dyadic) {
        (RunningError::exact(x), Dyadic::exact(x))
    }

    type Given = fn(f64, bool) -> (RunningError, Dyadic);

    fn of_quotient([x, y]: &[f64; 2], of: Given) -> f64 {
        let mut largest: f64 = 0.0;
        for up in [false, true] {
            let ((a, p), (b, q)) = (of(*x, up), of(*y, !up));
            if let (Ok(found), Ok(x)) = (a.over(b), Dyadic::value(&Root::linear(p, q, 0))) {
                largest = largest.max(share(found, &x));
            }
        }
        largest
    }

    fn of_square_root([x]: &[f64; 1], of: Given) -> f64 {
        let mut largest: f64 = 0.0;
        for up in [false, true] {
            let (a, p) = of(*x, up);
            let Some(root) = square_root(p) else { return 0.0 };
            largest = largest.max(Dyadic::value(&root).map_or(0.0, |x| share(a.sqrt(), &x)));
        }
        largest
    }

    /// Exact operands show the roundings of the operation itself; others show how it propagates their errors.
    #[test]
    fn operations_are_as_near_as_their_bounds_say() {
        let kinds: [(Given, [f64; 4]); 2] =
            [(exact, [1.0, 0.976, 0.632, 0.99]), (at_bound, [1.0, 0.997, 0.942, 0.554])];
        for (of, known) in kinds {
            let sum = |x: &[f64; 2]| {
                let ((a, p), (b, q)) = (of(x[0], true), of(x[1], true));
                share(a.plus(&b), &p.plus(&q))
            };
            let product = |x: &[f64; 2]| {
                let ((a, p), (b, q)) = (of(x[0], true), of(x[1], true));
                share(a.times(&b), &p.times(&q))
            };
            let found = [
                worst(4, 1000, draw, sum).0,
                worst(4, 1000, draw, product).0,
                worst(4, 1000, draw, |x| of_quotient(x, of)).0,
                worst(4, 1000, draw, |x| of_square_root(x, of)).0,
            ];
            for (k, what) in ["sum", "product", "quotient", "square root"].into_iter().enumerate() {
                assert_slack(what, found[k], known[k]);
            }
        }
    }

    /// Operands with large relative errors: up to half of the divisor in quotients, where the bound is
    /// reached, and up to all of the operand in roots.
    #[test]
    fn large_errors_of_operands_are_passed_on() {
        let vague = |x: f64, share: f64, sign: f64| {
            let error = x * share.clamp(0.0, 1.0);
            let truth = Dyadic::exact(x).plus(&Dyadic::exact(sign * error));
            (RunningError::within(x, error, One), truth)
        };
        let draw = |i: usize, next: &mut dyn FnMut() -> f64| if i == 0 { 1.0 + next() } else { next() };
        let quotient = worst(4, 1000, draw, |&[x, y]: &[f64; 2]| {
            let ((a, p), (b, q)) = (vague(x, y, 1.0), vague(2.0 - 0.5 * x, y, -1.0));
            match (a.over(b), Dyadic::value(&Root::linear(p, q, 0))) {
                (Ok(found), Ok(x)) => share(found, &x),
                _ => 0.0,
            }
        });
        // Down to zero, where the root of the upper end is the bound.
        let root = worst(4, 1000, draw, |&[x, y]: &[f64; 2]| {
            let error = x * (1.0 + y.abs());
            let p = Dyadic::exact(x).plus(&Dyadic::exact(error));
            let Some(root) = square_root(p) else { return 0.0 };
            Dyadic::value(&root).map_or(0.0, |p| share(RunningError::within(x, error, One).sqrt(), &p))
        });
        assert_slack("quotient", quotient.0, 1.0);
        assert_slack("root", root.0, 1.0);
    }

    /// Reciprocals of divisors from 2¹⁰²² on are subnormal and hold fewer bits.
    #[test]
    fn quotients_by_huge_numbers_are_as_near_or_refused() {
        let (mut known, mut refused) = (0, 0);
        let mut next = crate::testing::numbers();
        for k in 1010..1024 {
            for _ in 0..400 {
                let [x, y] = [0; 2].map(|_: u8| (1.0 + next()) * 2.0_f64.powi(k));
                let truth = Dyadic::value(&Root::linear(Dyadic::exact(x), Dyadic::exact(y), 0));
                let found = RunningError::exact(x).over(RunningError::exact(y));
                (known, refused) =
                    (known + usize::from(found.is_ok()), refused + usize::from(found.is_err()));
                if let (Ok(found), Ok(truth)) = (found, truth) {
                    assert!(share(found, &truth) <= 1.0, "{x} / {y}");
                }
            }
        }
        assert!(known > 4000 && refused > 400, "{known}, {refused}");
    }

    /// A uniform number keeps its bound.
    #[test]
    fn a_number_for_all_lanes_is_within_the_same_bound() {
        for weight in [UNIT, GIVEN, 1000.0 * UNIT] {
            let x = RunningError { weight, ..RunningError::exact(3.0) };
            let all = RunningErrors::<One, 1>::from(&x);
            assert!(all.error() >= x.error() && all.error() <= GIVEN.max(weight) * 3.0 * (1.0 + 64.0 * UNIT));
        }
    }

    /// The rounding of v ± m is covered four times: the ends are at least three roundings outside v ± m,
    /// and may lose one.
    #[test]
    fn an_interval_reaches_beyond_its_ball() {
        let (least, _) = worst(2, 1000, draw, |x: &[f64; 2]| {
            let error = (x[1] - 1.0) * 1e-10 * x[0];
            let ends = interval::<One, 1>(x[0], error, One);
            let ends = ends.unwrap_or(Interval { low: x[0], high: x[0] });
            let beyond = |end: f64, sign: f64| {
                let bound = Dyadic::exact(x[0]).plus(&Dyadic::exact(sign * error));
                sign * Dyadic::exact(end).minus(&bound).split().0 / (UNIT * x[0])
            };
            -beyond(ends.low, -1.0).min(beyond(ends.high, 1.0))
        });
        assert!((3.0..4.0).contains(&-least), "{least}");
    }

    /// `PAD` covers eight roundings downward and one of its own product. `UNDERFLOW` is far above the loss of
    /// 32 operations, which keeps subnormal numbers out of products.
    #[test]
    fn pads_cover_what_they_should() {
        let eight = (0..9).fold(Dyadic::exact(PAD), |x, _| x.times(&Dyadic::exact(1.0 - UNIT)));
        assert_eq!(eight.minus(&Dyadic::exact(1.0)).sign(), Ok(Ordering::Greater));
        assert!(UNDERFLOW >= 32.0 * f64::from_bits(1) && UNDERFLOW * 2.0_f64.powi(-100) >= f64::MIN_POSITIVE);
    }
}
