//! Numbers with error bounds, and filtered predicates over them.
//!
//! Every formula of the core is written once, over [`Number`], and evaluated in up to three kinds of
//! arithmetic: [`RunningError`] (float64 with a running error bound), [`DoubleDouble`] (double-double with a
//! running error bound) and [`Dyadic`] (exact). If one kind cannot certify a predicate, it is [`Uncertain`],
//! and [`decide`] evaluates it in the next kind; the last is always certain. This is a floating-point filter,
//! as in J. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates,
//! 1997. No formula needs an epsilon, and every decision is exact for the float64 input.
//!
//! The first two kinds exist for a single ray and for the lanes of a register ([`RunningErrors`],
//! [`DoubleDoubles`]).

mod double_double;
mod dyadic;
mod integer;
mod lanes;
mod running_error;
mod stored;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::cmp::Ordering;

pub use double_double::{DoubleDouble, DoubleDoubles};
pub use dyadic::Dyadic;
pub use lanes::{Lanes, Many, OfRays, One};
pub use running_error::{RunningError, RunningErrors};
pub use stored::Stored;

use crate::stop;

/// The error bound of this kind of arithmetic is too wide for a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uncertain;

/// A real number, known exactly or to within a bound that it carries.
pub trait Number: Clone {
    /// Float64 numbers, one per lane.
    type Floats: Copy;

    fn exact(x: f64) -> Self;
    fn plus(&self, other: &Self) -> Self;
    fn minus(&self, other: &Self) -> Self;
    fn times(&self, other: &Self) -> Self;
    fn negated(&self) -> Self;
    fn sign(&self) -> Result<Ordering, Uncertain>;
    /// Sign of `p + q·√d`, for d ≥ 0.
    fn sign_of_surd(p: &Self, q: &Self, d: &Self) -> Result<Ordering, Uncertain>;
    fn compare(a: &Root<Self>, b: &Root<Self>) -> Result<Ordering, Uncertain>;
    /// The root as a number of this kind; `None` if this kind compares roots by other means.
    fn locate(root: &Root<Self>) -> Result<Option<Self>, Uncertain>;
    /// The root rounded to the nearest float64.
    fn round(root: &Root<Self>) -> Result<Self::Floats, Uncertain>;
    /// The root as a number of this kind. The exact kind truncates it far enough that `proportions` of a
    /// normal there keep their bound.
    fn value(root: &Root<Self>) -> Result<Self, Uncertain>;
    /// Float64 numbers in the proportions of `v`, to within 2⁻⁶⁰ of the largest and one rounding. The
    /// largest is neither huge nor tiny.
    fn proportions(v: &[Self; 3]) -> Result<[Self::Floats; 3], Uncertain>;
    /// Float64 numbers that enclose the root.
    fn enclose(root: &Root<Self>) -> Result<Interval<Self::Floats>, Uncertain>;

    /// Nearby float64 numbers, and the remainders.
    fn split(&self) -> (Self::Floats, Self);

    /// The value precomputed in this kind of number.
    fn of_kinds<K: Kinds>(kinds: &K) -> Cow<'_, K::In<Self>>;

    #[inline(always)]
    fn doubled(&self) -> Self {
        self.plus(self)
    }

    #[inline(always)]
    fn squared(&self) -> Self {
        self.times(self)
    }

    #[inline(always)]
    fn is_zero(&self) -> Result<bool, Uncertain> {
        Ok(self.sign()? == Ordering::Equal)
    }
}

/// The root t = (b + branch·√disc)/a of a·t² − 2b·t + c = 0, with a > 0 and disc = b² − a·c; with
/// branch 0, t = b/a.
///
/// Separate formulas keep each coefficient accurate: `disc` is not evaluated as b² − a·c, and c avoids
/// the cancellation between b and √disc.
#[derive(Clone, Debug)]
pub struct Root<N> {
    pub a: N,
    pub b: N,
    pub c: N,
    pub disc: N,
    pub branch: i8,
    /// t, if already computed.
    pub t: Option<N>,
    /// Whether the line touches the surface there: a quadratic equation has this double root.
    pub touches: bool,
    /// The part of the surface: a face of a box, the side or a cap of a cylinder.
    pub feature: u8,
}

/// A quantity precomputed in each kind of number with one lane.
pub trait Kinds {
    type In<N: Clone>: Clone;

    fn running_error(&self) -> &Self::In<RunningError>;
    fn double_double(&self) -> &Self::In<DoubleDouble>;
    fn dyadic(&self) -> &Self::In<Dyadic>;
    /// The same in a kind of number that includes this one.
    fn convert<N: Clone, M: Clone + for<'a> From<&'a N>>(kept: &Self::In<N>) -> Self::In<M>;
}

/// A closed interval of float64 numbers, or one per lane.
#[derive(Clone, Copy, Debug)]
pub struct Interval<F = f64> {
    pub low: F,
    pub high: F,
}

impl Interval {
    pub fn point(x: f64) -> Self {
        Interval { low: x, high: x }
    }

    /// Halving first keeps it finite.
    pub fn middle(self) -> f64 {
        0.5 * self.low + 0.5 * self.high
    }
}

/// A decision or value that any kind of one-lane [`Number`] can evaluate.
pub trait Predicate {
    type Answer;
    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain>;
}

/// Evaluates a predicate in the cheapest arithmetic that certifies it.
pub fn decide<Q: Predicate>(predicate: &Q) -> Q::Answer {
    predicate.evaluate::<RunningError>().unwrap_or_else(|Uncertain| decide_exactly(predicate))
}

/// As [`decide`], without the float64 stage, for predicates that it can hardly ever certify.
#[cold]
#[inline(never)]
pub fn decide_exactly<Q: Predicate>(predicate: &Q) -> Q::Answer {
    stop::poll();
    predicate
        .evaluate::<DoubleDouble>()
        .or_else(|Uncertain| predicate.evaluate::<Dyadic>())
        .unwrap_or_else(|Uncertain| unreachable!("exact arithmetic is never uncertain"))
}

/// An exact number in double-double: its leading 128 bits in two parts. Truncation and the rounding of the
/// low part come to less than u²/2 of the number.
fn nearly(x: &Dyadic) -> DoubleDouble {
    match x.leading_parts() {
        _ if x.is_zero() == Ok(true) => DoubleDouble::exact(0.0),
        None => DoubleDouble::of_sum(0.0, 0.0, f64::INFINITY, One),
        Some((high, low)) => DoubleDouble::of_sum(high, low, UNIT * UNIT * high.abs(), One),
    }
}

/// A root with its exact coefficients in double-double, which mostly decides as much as exact arithmetic.
fn approximate(root: &Root<Dyadic>) -> Root<DoubleDouble> {
    let [a, b, c, disc] = [&root.a, &root.b, &root.c, &root.disc].map(nearly);
    Root { a, b, c, disc, branch: root.branch, t: None, touches: root.touches, feature: root.feature }
}

/// Unit roundoff of float64, 2⁻⁵³.
pub const UNIT: f64 = f64::EPSILON / 2.0;

/// Covers the roundings in the computation of an error bound itself: fewer than 8 of relative size `UNIT`
/// each.
pub(crate) const PAD: f64 = 1.0 + 8.0 * f64::EPSILON;

/// Covers the underflow of up to 32 operations: half the smallest subnormal, 2⁻¹⁰⁷⁵, each. It is as
/// large as 2⁻⁹⁰⁰ to keep subnormal numbers, which processors multiply slowly, out of its products
/// with ordinary numbers.
pub(crate) const UNDERFLOW: f64 = f64::from_bits((1023 - 900) << 52);
