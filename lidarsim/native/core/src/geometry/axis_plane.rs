//! Exact planes perpendicular to an axis, such as floors, roofs and walls.

use crate::arith::error_free::{two_product, two_sum};
use crate::arith::number::{DoubleDoubles, Lanes, UNIT, Uncertain};
use crate::arith::simd::Floats;

/// The points whose coordinate `axis` is high + low. 2Sum yields the pair, so it is the same for equal sums.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPlane {
    pub axis: usize,
    high: f64,
    low: f64,
}

/// Products and numerators above this leave float64 residuals: at least 2⁻¹⁰⁶ of them.
const ORDINARY: f64 = f64::from_bits((1023 - 900) << 52);

impl AxisPlane {
    /// The plane at a + b; `None` if that is too large.
    #[inline]
    pub fn at(axis: usize, a: f64, b: f64) -> Option<Self> {
        let (high, low) = two_sum(a, b);
        (high.is_finite() && low.is_finite()).then_some(AxisPlane { axis, high, low })
    }

    /// The plane at a/b, if that is a float64.
    #[inline]
    pub fn at_ratio(axis: usize, a: f64, b: f64) -> Option<Self> {
        let quotient = a / b;
        let is_exact = a == 0.0 || (a.abs() > ORDINARY && quotient.mul_add(b, -a) == 0.0);
        if is_exact { AxisPlane::at(axis, quotient, 0.0) } else { None }
    }

    /// The image under x ↦ factor·x + offset of its coordinate, which becomes that of `axis`; `None` if no
    /// pair represents it.
    #[inline]
    pub fn image(&self, axis: usize, factor: f64, offset: f64) -> Option<Self> {
        let (high, low) = if factor.abs() == 1.0 {
            (factor * self.high, factor * self.low)
        } else {
            let (product, rest) = two_product(factor, self.high);
            if self.low != 0.0 || !(product.abs() > ORDINARY || self.high == 0.0) {
                return None;
            }
            (product, rest)
        };
        let (sum, rest) = two_sum(high, offset);
        let (rest, beyond) = two_sum(rest, low);
        if beyond == 0.0 { AxisPlane::at(axis, sum, rest) } else { None }
    }

    /// The correctly rounded t at which rays meet the plane. They start at `origin` along the axis and have
    /// the component `direction`, which is not zero.
    #[inline(always)]
    pub fn t<L: Lanes<N>, const N: usize>(
        &self,
        origin: L::Floats,
        direction: L::Floats,
        lanes: L,
    ) -> Result<L::Floats, Uncertain> {
        let (height, rest) = two_sum(L::Floats::splat(self.high), origin.negated());
        let rest = rest.add(L::Floats::splat(self.low));
        let quotient = height.div(direction);
        let size = quotient.abs();
        let ordinary =
            L::Floats::splat(f64::MIN_POSITIVE).le(size) & size.lt(L::Floats::splat(f64::INFINITY));
        lanes.keep(ordinary & L::Floats::splat(ORDINARY).lt(height.abs()))?;
        if lanes.active() & !rest.abs().le(L::Floats::splat(0.0)) == 0 {
            return Ok(quotient);
        }
        quotient_of_sum(height, rest, direction, quotient, lanes).rounded()
    }
}

/// (s + v)/d, with v within u·|rest| of `rest`, and q = s/d, rounded, which is not subnormal, and |s| above
/// `ORDINARY`.
///
/// r = s − q·d is a float64 number, and |r/d| ≤ u·|q|. The quotient is q + (r + v)/d. With w = r + rest
/// rounded, |rest| ≤ |w|(1 + 2u) + |r|. So the errors of v and w are less than u·(2|w| + |r|)(1 + 4u);
/// divided by d, with the rounding of that, less than u·(3·|w/d| + u·|q|)(1 + 8u).
#[inline(always)]
fn quotient_of_sum<L: Lanes<N>, const N: usize>(
    s: L::Floats,
    rest: L::Floats,
    d: L::Floats,
    q: L::Floats,
    lanes: L,
) -> DoubleDoubles<L, N> {
    let remainder = q.negated().mul_add(d, s);
    let low = remainder.add(rest).div(d);
    let error =
        low.abs().mul(L::Floats::splat(4.0 * UNIT)).add(q.abs().mul(L::Floats::splat(2.0 * UNIT * UNIT)));
    DoubleDoubles::of_sum(q, low, error, lanes)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{DoubleDouble, Dyadic, Many, Number, One};
    use crate::arith::root::Root;
    use crate::testing::{assert_slack, numbers, worst};

    fn coordinate(plane: &AxisPlane) -> Dyadic {
        Dyadic::exact(plane.high).plus(&Dyadic::exact(plane.low))
    }

    fn are_equal(a: &Dyadic, b: &Dyadic) -> bool {
        a.minus(b).sign() == Ok(Ordering::Equal)
    }

    /// Small multiples of powers of two, often with a sum or a product beyond 53 bits, and some tiny or huge
    /// numbers.
    fn draw(next: &mut impl FnMut() -> f64) -> f64 {
        let power = [-1070, -520, -30, 0, 0, 0, 0, 0, 0, 60, 1000][(11.0 * next()) as usize];
        let few = (8.0 * next()).floor() - 4.0;
        let many = 2.0 * next() - 1.0;
        (if next() < 0.7 { few } else { many }) * 2.0_f64.powi(power / 2) * 2.0_f64.powi(power - power / 2)
    }

    #[test]
    fn pairs_are_equal_where_the_numbers_are() {
        let mut next = numbers();
        let (mut known, mut equal) = (0, 0);
        let mut others = [AxisPlane { axis: 2, high: 0.0, low: 0.0 }; 8];
        for _ in 0..100_000 {
            let [a, b, factor, offset] = [0; 4].map(|_: u8| draw(&mut next));
            let plane = if next() < 0.5 { AxisPlane::at(0, a, b) } else { AxisPlane::at_ratio(0, a, b) };
            let Some(image) = plane.and_then(|plane| plane.image(2, factor, offset)) else { continue };
            let truth = |plane: &AxisPlane| {
                Dyadic::exact(factor).times(&coordinate(plane)).plus(&Dyadic::exact(offset))
            };
            assert!(
                plane.is_some_and(|plane| are_equal(&truth(&plane), &coordinate(&image))),
                "{a} {b} {factor} {offset}"
            );
            for other in &others {
                assert_eq!(*other == image, are_equal(&coordinate(other), &coordinate(&image)));
                equal += usize::from(*other == image);
            }
            others[known % 8] = image;
            known += 1;
        }
        assert!(known > 25_000 && equal > 200, "{known}, {equal}");
    }

    #[test]
    fn sums_and_ratios_are_what_they_say() {
        let mut next = numbers();
        let mut exact = 0;
        for _ in 0..100_000 {
            let [a, b] = [0; 2].map(|_: u8| draw(&mut next));
            if let Some(plane) = AxisPlane::at(1, a, b) {
                assert!(
                    are_equal(&coordinate(&plane), &Dyadic::exact(a).plus(&Dyadic::exact(b))),
                    "{a} + {b}"
                );
            }
            if b != 0.0
                && let Some(plane) = AxisPlane::at_ratio(1, a, b)
            {
                assert!(
                    are_equal(&coordinate(&plane).times(&Dyadic::exact(b)), &Dyadic::exact(a)),
                    "{a} / {b}"
                );
                exact += 1;
            }
        }
        assert!(exact > 10_000, "{exact}");
        assert_eq!(AxisPlane::at(0, f64::MAX, f64::MAX), None);
        // A third is no float64, and the quotients of tiny numbers may only seem exact.
        assert_eq!(AxisPlane::at_ratio(0, 1.0, 3.0), None);
        assert_eq!(AxisPlane::at_ratio(0, 1e-310, 0.3), None);
        assert_ne!(AxisPlane::at(0, 1.0, 0.0), AxisPlane::at(1, 1.0, 0.0));
    }

    /// (s + e + l)/d, as a quotient of exact numbers.
    fn exact_quotient(s: f64, e: f64, l: f64, d: f64) -> Root<Dyadic> {
        let num = Dyadic::exact(s).plus(&Dyadic::exact(e)).plus(&Dyadic::exact(l));
        let sign = if d < 0.0 { -1.0 } else { 1.0 };
        Root::linear(num.times(&Dyadic::exact(sign)), Dyadic::exact(d.abs()), 0)
    }

    /// The rest, a rounded sum, is nearly as large as s or as the remainder of the quotient, or cancels the
    /// remainder.
    #[test]
    fn quotients_of_sums_are_as_near_as_their_bound_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 0.5 + 0.5 * next();
        for (size, cancels, known) in [(0.25, false, 0.709), (UNIT, false, 0.464), (UNIT, true, 0.456)] {
            let share = |&[s, e, l, d]: &[f64; 4]| {
                let q = s / d;
                let e = if cancels { q.mul_add(d, -s) * (1.0 + UNIT * e) } else { e * size };
                let l = l * size * UNIT;
                let found = quotient_of_sum::<One, 1>(s, e + l, d, q, One);
                let Ok(t) = Dyadic::value(&exact_quotient(s, e, l, d)) else { return 0.0 };
                let [high, low, error] = found.terms();
                t.minus(&Dyadic::exact(high)).minus(&Dyadic::exact(low)).split().0.abs() / error
            };
            assert_slack("quotient of a sum", worst(6, 2000, draw, share).0, known);
        }
    }

    /// From near and far, and planes whose coordinate is no float64.
    #[test]
    fn rays_meet_the_plane_at_t_rounded() {
        let mut next = numbers();
        let (mut known, mut single) = (0, 0);
        for round in 0..4000 {
            let shift = [0.0, 5e6, 1e-3][round % 3];
            let Some(plane) =
                AxisPlane::at(2, shift + 50.0 * next(), if round % 2 == 0 { next() } else { 0.0 })
            else {
                continue;
            };
            let near = if round % 5 == 0 { plane.high } else { shift };
            let origin: [f64; 8] = std::array::from_fn(|_| near + (next() - 0.5) * [60.0, 1e-9][round % 2]);
            let direction: [f64; 8] = std::array::from_fn(|_| next() - 0.5);
            let active = Cell::new(0xff);
            let found = plane.t(origin, direction, Many::<[f64; 8]>::new(&active));
            for k in 0..8 {
                let (s, e) = two_sum(plane.high, -origin[k]);
                let exact = exact_quotient(s, e, plane.low, direction[k]);
                let (Ok(t), 1) = (found, active.get() >> k & 1) else { continue };
                assert_eq!(
                    Dyadic::round(&exact),
                    Ok(t[k]),
                    "{plane:?} from {} along {}",
                    origin[k],
                    direction[k]
                );
                known += 1;
                single += usize::from(e == 0.0 && plane.low == 0.0);
            }
        }
        assert!(known > 31_000 && single > 5000, "{known}, {single}");
        // At the plane, and beyond the range of float64, the result is uncertain.
        let plane = AxisPlane { axis: 0, high: 1.0, low: 0.0 };
        assert!(plane.t::<One, 1>(1.0, 1.0, One).is_err());
        assert!(AxisPlane { high: 1e300, ..plane }.t::<One, 1>(-1e300, 1e-300, One).is_err());
        assert!(AxisPlane { high: 1e-200, ..plane }.t::<One, 1>(0.0, 1e200, One).is_err());
        assert!(plane.t::<One, 1>(1.0 - DoubleDouble::exact(1.0).terms()[0], 1.0, One).is_ok());
    }
}
