//! Every kind of number contains the exact result, in every lane and on every instruction set.

use std::cell::Cell;
use std::cmp::Ordering;

use super::*;
use crate::arith::simd::{Floats, Isa, LaneTask, Level, Task, dispatch};
use crate::testing::words;

/// A kind of number whose error bounds the tests can read.
pub(super) trait Enclosure<const N: usize>: Number {
    /// Whether the bounds of a lane contain x; true if they are infinite or NaN.
    fn holds(&self, lane: usize, x: &Dyadic) -> bool;
    /// Whether the bounds of a lane are finite and exclude zero.
    fn is_certain(&self, lane: usize) -> bool;
}

/// Whether |x − (high + low)| ≤ error; true if the error is infinite or NaN.
pub(super) fn within(x: &Dyadic, high: f64, low: f64, error: f64) -> bool {
    if !(high.is_finite() && low.is_finite() && error.is_finite()) {
        return !(error < f64::INFINITY) || !high.is_finite();
    }
    let off = x.minus(&Dyadic::exact(high)).minus(&Dyadic::exact(low));
    let bound = Dyadic::exact(error);
    off.minus(&bound).sign() != Ok(Ordering::Greater) && off.plus(&bound).sign() != Ok(Ordering::Less)
}

/// The greater root of t² = x.
pub fn square_root(x: Dyadic) -> Option<Root<Dyadic>> {
    let (one, zero) = (Dyadic::exact(1.0), Dyadic::exact(0.0));
    let [_, root] = Root::quadratic(one, zero, x.negated(), x, Ordering::Greater, 0);
    root
}

/// Numbers of every size, and neighbours with a small difference.
fn numbers() -> impl FnMut() -> f64 {
    let mut next = words();
    move || {
        let (kind, bits) = (next() % 16, next());
        let ordinary = f64::from_bits(bits & !(0x7ff << 52) | (1015 + bits % 16) << 52);
        match kind {
            0 => 0.0,
            1 => -0.0,
            2 => f64::from_bits(bits % 64),                         // subnormal
            3 => f64::from_bits(bits & !(0x7ff << 52) | 3 << 52),   // all but subnormal
            4 => f64::from_bits(bits & !(0x7ff << 52) | 511 << 52), // whose square is subnormal
            5 => f64::from_bits(bits & !(0x7ff << 52) | 1530 << 52), // whose square is huge
            6 => (bits % 5) as f64 - 2.0,
            7 | 8 => 1.0 + (bits % 8) as f64 * f64::EPSILON,
            _ => ordinary,
        }
    }
}

/// Sums, differences and products of each other.
fn formulas<N: Number>(x: &[N; 4]) -> [N; 12] {
    let [a, b, c, d] = x;
    let (ab, cd) = (a.times(b), c.times(d));
    let (difference, cross) = (a.minus(b), ab.minus(&cd));
    let square = difference.squared();
    let deep = cross.times(&difference).plus(&ab.negated().times(&square));
    let mixed = [c.plus(&cd), deep.times(d), deep.times(&cross), cross.doubled()];
    let [p, q, r, s] = mixed;
    let sum = a.plus(b);
    [ab, cd, difference, cross, square, deep, p, q, r, s, sum.minus(c), sum.times(c)]
}

/// Roots of rounded numbers: a quotient, both roots of a quadratic equation, and the root of a square that is
/// mostly rounding error.
fn root<N: Number>(which: usize, x: &[N; 4]) -> Result<Root<N>, Uncertain> {
    let [a, b, c, d] = x;
    let positive = a.squared().plus(&d.squared()).plus(&N::exact(1e-30));
    if which == 0 {
        return Ok(Root::linear(b.times(c), positive, 0));
    }
    // t² − 2bt + (b² − disc) = 0
    let (middle, disc) = match which {
        1 | 2 => (b.clone(), positive),
        _ => (N::exact(0.0), a.times(b).minus(&c.times(d)).squared()),
    };
    let rest = middle.squared().minus(&disc);
    let order = disc.sign()?;
    let [first, second] = Root::quadratic(N::exact(1.0), middle, rest, disc, order, 0);
    (if which == 1 { first } else { second }).ok_or(Uncertain)
}

struct RunningErrorLanes;
struct DoubleDoubled;

impl LaneTask for RunningErrorLanes {
    type Output = [usize; 2];

    fn run<F: Floats<f64, N>, const N: usize>(self) -> [usize; 2] {
        let active = Cell::new(0);
        let lanes = Many::<F>::new(&active);
        let others = |x: &RunningErrors<_, N>, lane: usize, exact: &Dyadic| {
            RunningErrors::load(&store(x), 1, lanes).holds(lane, exact)
        };
        check::<RunningErrors<_, N>, N>(&active, |v| RunningErrors::of_rays(F::load(v), lanes), others)
    }
}

impl LaneTask for DoubleDoubled {
    type Output = [usize; 2];

    fn run<F: Floats<f64, N>, const N: usize>(self) -> [usize; 2] {
        let active = Cell::new(0);
        let lanes = Many::<F>::new(&active);
        let others = |x: &DoubleDoubles<_, N>, lane: usize, exact: &Dyadic| {
            let loaded = DoubleDoubles::load(&store(x), 1, lanes);
            loaded.holds(lane, exact) && RunningErrors::from(x).holds(lane, exact)
        };
        check::<DoubleDoubles<_, N>, N>(&active, |v| DoubleDoubles::of_rays(F::load(v), lanes), others)
    }
}

/// Stores a number as the second part.
fn store<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(x: &K) -> Stored<16> {
    let mut stored = Stored::UNSET;
    x.store(1, &mut stored);
    stored
}

/// Returns how many certain numbers and how many roots it has checked. `others` tells whether other forms of
/// a number contain its exact value.
fn check<K: Enclosure<N>, const N: usize>(
    active: &Cell<u32>,
    of_rays: impl Fn(&[f64; N]) -> K,
    others: impl Fn(&K, usize, &Dyadic) -> bool,
) -> [usize; 2] {
    let (mut certain, mut known) = (0, 0);
    let mut number = numbers();
    for _ in 0..300 {
        let values: [[f64; N]; 4] = std::array::from_fn(|_| std::array::from_fn(|_| number()));
        let x = values.each_ref().map(&of_rays);
        let exactly = |lane: usize| values.map(|v| Dyadic::exact(v[lane]));
        let found = formulas(&x);
        for lane in 0..N {
            for (k, (found, exact)) in found.iter().zip(&formulas(&exactly(lane))).enumerate() {
                let holds = found.holds(lane, exact) && others(found, lane, exact);
                assert!(holds, "formula {k} of {:?}", values.map(|v| v[lane]));
                certain += usize::from(found.is_certain(lane));
            }
        }
        for k in 0..4 {
            active.set((1 << N) - 1);
            let Ok(found) = root(k, &x).and_then(|root| K::value(&root)) else { continue };
            for lane in (0..N).filter(|lane| active.get() & 1 << lane != 0) {
                let exact = root(k, &exactly(lane)).and_then(|root| Dyadic::value(&root));
                assert!(
                    exact.is_ok_and(|t| found.holds(lane, &t)),
                    "root {k} of {:?}",
                    values.map(|v| v[lane])
                );
                known += 1;
            }
        }
    }
    [certain, known]
}

struct Each<T>(fn() -> T);

impl<T: LaneTask> Task for Each<T> {
    type Output = Option<T::Output>;

    fn run<I: Isa>(self) -> Self::Output {
        I::call_widest(self.0())
    }
}

#[test]
fn lanes_hold_the_exact_numbers() {
    for level in Level::available() {
        for [certain, known] in
            [dispatch(level, Each(|| RunningErrorLanes)), dispatch(level, Each(|| DoubleDoubled))]
                .into_iter()
                .flatten()
        {
            assert!(certain > 2000 && known > 500, "{level:?}: {certain}, {known}");
        }
    }
}

#[test]
fn one_lane_holds_the_exact_numbers() {
    let active = Cell::new(0);
    for [certain, known] in [
        check::<RunningError, 1>(&active, |v| RunningError::exact(v[0]), |_, _, _| true),
        check::<DoubleDouble, 1>(&active, |v| DoubleDouble::exact(v[0]), |_, _, _| true),
    ] {
        assert!(certain > 500 && known > 200, "{certain}, {known}");
    }
}

#[test]
fn exact_zeros_are_certain() {
    let zero = [-0.0, 5.0, 0.0, 1e-320].map(RunningError::exact);
    assert_eq!(zero[0].times(&zero[1]).sign(), Ok(Ordering::Equal));
    assert_eq!(zero[3].squared().sign(), Err(Uncertain));
    assert_eq!(zero[0].times(&zero[1]).plus(&zero[3].squared()).sign(), Err(Uncertain));
    let zero = [-0.0, 5.0, 0.0, 1e-320].map(DoubleDouble::exact);
    assert_eq!(zero[0].times(&zero[1]).sign(), Ok(Ordering::Equal));
    assert_eq!(zero[3].squared().sign(), Err(Uncertain));
    assert_eq!(zero[0].times(&zero[1]).plus(&zero[3].squared()).sign(), Err(Uncertain));
}

#[test]
fn exact_zeros_stay_so_when_they_are_stored() {
    let values = [0.0, 1.0, -0.0, 1e-320, f64::MAX, 0.0, -3.0, 0.0];
    let factors = [7.0, 0.0, 2.0, 1e-320, f64::MAX, 1e-320, 5.0, f64::MAX];
    for lane in 0..8 {
        let active = Cell::new(1 << lane);
        let lanes = Many::<[f64; 8]>::new(&active);
        let of = |x| RunningErrors::<_, 8>::of_rays(x, lanes);
        let product = of(values).times(&of(factors));
        let loaded = RunningErrors::<_, 8>::load(&store(&product), 1, lanes);
        let expected = match lane {
            3 | 4 => Err(Uncertain), // too small, and too large
            6 => Ok(Ordering::Less),
            _ => Ok(Ordering::Equal),
        };
        assert_eq!(loaded.sign(), expected, "{lane}");
    }
}

/// With a bound at least as wide as that of a running error.
#[test]
fn a_lower_part_counts_beside_a_bound() {
    let x = DoubleDouble::within(1.0, 8.0 * UNIT, One).plus(&DoubleDouble::exact(UNIT));
    let farthest = Dyadic::exact(1.0).plus(&Dyadic::exact(9.0 * UNIT));
    assert!(x.holds(0, &farthest) && RunningError::from(&x).holds(0, &farthest));
}

/// Differing signs are settled lane by lane; unknown signs remain.
#[test]
fn lanes_that_disagree_are_asked_in_turn() {
    let values = [[3.0, -1.0, 0.0, 2.0, 1e-200, -4.0, 0.0, -0.0]];
    let mut left = 0b0111_1111;
    let mut answers = [None; 8];
    while left != 0 {
        let active = Cell::new(left);
        let lanes = Many::<[f64; 8]>::new(&active);
        let x = RunningErrors::<_, 8>::of_rays(values[0], lanes);
        // The square of a tiny number underflows.
        let answer = x.times(&x).times(&x).sign();
        for lane in (0..8).filter(|lane| active.get() & 1 << lane != 0) {
            answers[lane] = Some(answer);
        }
        assert_ne!(left & active.get(), 0);
        left &= !active.get();
    }
    let (less, equal, greater) = (Ok(Ordering::Less), Ok(Ordering::Equal), Ok(Ordering::Greater));
    let expected = [greater, less, equal, greater, Err(Uncertain), less, equal].map(Some);
    assert_eq!(answers[..7], expected);
    assert_eq!(answers[7], None);
}
