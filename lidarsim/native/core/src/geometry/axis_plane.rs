//! Planes perpendicular to an axis, as floors, roofs and walls are, exactly.

use crate::arith::error_free::{two_product, two_sum};

/// The points whose coordinate `axis` is high + low. The pair is what 2Sum gives, so that it is the same for equal sums.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPlane {
    pub axis: usize,
    high: f64,
    low: f64,
}

/// Products above this, and quotients of numbers above it, leave residuals that are float64 numbers: these are at least 2⁻¹⁰⁶ of them.
const ORDINARY: f64 = f64::from_bits((1023 - 900) << 52);

impl AxisPlane {
    /// At a + b; none if that is too large.
    #[inline]
    pub fn at(axis: usize, a: f64, b: f64) -> Option<Self> {
        let (high, low) = two_sum(a, b);
        (high.is_finite() && low.is_finite()).then_some(AxisPlane { axis, high, low })
    }

    /// At a/b, if that is a float64.
    #[inline]
    pub fn at_ratio(axis: usize, a: f64, b: f64) -> Option<Self> {
        let quotient = a / b;
        let is_exact = a == 0.0 || (a.abs() > ORDINARY && quotient.mul_add(b, -a) == 0.0);
        if is_exact { AxisPlane::at(axis, quotient, 0.0) } else { None }
    }

    /// The image under x ↦ factor·x + offset of its coordinate, which becomes that of `axis`; none if it has no such pair.
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
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::testing::numbers;

    fn coordinate(plane: &AxisPlane) -> Dyadic {
        Dyadic::exact(plane.high).plus(&Dyadic::exact(plane.low))
    }

    fn are_equal(a: &Dyadic, b: &Dyadic) -> bool {
        a.minus(b).sign() == Ok(Ordering::Equal)
    }

    /// Small multiples of powers of two, often with a sum or a product beyond 53 bits, and some numbers that are tiny or huge.
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
            let truth =
                |plane: &AxisPlane| Dyadic::exact(factor).times(&coordinate(plane)).plus(&Dyadic::exact(offset));
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
                assert!(are_equal(&coordinate(&plane), &Dyadic::exact(a).plus(&Dyadic::exact(b))), "{a} + {b}");
            }
            if b != 0.0
                && let Some(plane) = AxisPlane::at_ratio(1, a, b)
            {
                assert!(are_equal(&coordinate(&plane).times(&Dyadic::exact(b)), &Dyadic::exact(a)), "{a} / {b}");
                exact += 1;
            }
        }
        assert!(exact > 10_000, "{exact}");
        assert_eq!(AxisPlane::at(0, f64::MAX, f64::MAX), None);
        // A third is no float64, and tiny numbers may seem to have quotients that they have not.
        assert_eq!(AxisPlane::at_ratio(0, 1.0, 3.0), None);
        assert_eq!(AxisPlane::at_ratio(0, 1e-310, 0.3), None);
        assert_ne!(AxisPlane::at(0, 1.0, 0.0), AxisPlane::at(1, 1.0, 0.0));
    }
}
