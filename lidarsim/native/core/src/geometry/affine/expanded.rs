//! The inverse of affine maps as expansions.

use super::{Adjugate, Affine};
use crate::arith::expansion::{Constant, Expansion, TINY, V};
use crate::arith::number::{DoubleDouble, Number, UNIT};
use crate::arith::root::Root;
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::vector::Point;

/// The inverse of affine maps, x ↦ linear·(x − offset − rest), for formulas that bound their own
/// errors; and its parts before the division.
#[derive(Clone, Debug)]
pub struct ExpandedInverse {
    /// The rows of the adjugate; `linear` is the adjugate over the determinant.
    pub rows: [[Constant; 3]; 3],
    pub determinant: Constant,
    linear: [[Constant; 3]; 3],
    offset: Point,
    rest: [Constant; 3],
    /// The map, if it is only one.
    pub map: Option<Affine>,
}

/// Within 2^±200, products with the inverse lose far less to underflow than the bounds of numbers from
/// 2⁻⁴⁰⁰ on, which `Crossing` requires.
const ORDINARY_MIN: f64 = f64::from_bits((1023 - 200) << 52);
const ORDINARY_MAX: f64 = f64::from_bits((1023 + 200) << 52);

impl ExpandedInverse {
    pub(super) fn of(inverse: &Adjugate<DoubleDouble>, map: Option<Affine>) -> Option<Self> {
        let determinant = inverse.linear.determinant;
        let mut linear = [[Constant::ZERO; 3]; 3];
        for (quotients, row) in linear.iter_mut().zip(&inverse.linear.rows) {
            for (quotient, x) in quotients.iter_mut().zip(row) {
                *quotient = Constant::from(&DoubleDouble::value(&Root::linear(*x, determinant, 0)).ok()?);
            }
        }
        let rows = inverse.linear.rows.each_ref().map(|row| row.each_ref().map(Constant::from));
        let determinant = Constant::from(&determinant);
        let rest =
            inverse.rest.as_ref().map_or([Constant::ZERO; 3], |rest| rest.each_ref().map(Constant::from));
        let is_ordinary =
            |x: &Constant| x.size < ORDINARY_MAX && (x.high == 0.0 || x.high.abs() > ORDINARY_MIN);
        let are_ordinary = rows.iter().chain(&linear).flatten().chain([&determinant]).all(is_ordinary);
        are_ordinary.then_some(ExpandedInverse {
            rows,
            determinant,
            linear,
            offset: inverse.offset,
            rest,
            map,
        })
    }

    /// The images of points, and their sizes: each coordinate is off by at most 180u² of its size, and its
    /// low part is at most 6u of its size.
    ///
    /// The difference of x and the offset is exact. The size F of its sum with the rest includes the rest
    /// times 1/u and its error times 1/(64u²). So the low part is at most u·F; its error, with its rounding
    /// and the omitted low part of the rest, is at most 64u²·F. In a product with a row, S =
    /// Σ|linear_ij|F_j, the low part is at most 5u·S; the roundings of its partial results come to less
    /// than eight of the whole; and it omits u²·S. With the errors of the row and of the difference, that
    /// is less than 170u²·S.
    #[inline(always)]
    pub fn points<I: Isa>(&self, x: V<I>) -> ([Expansion<I>; 3], V<I>) {
        let (from_x, size_x) = self.past_offset::<I>(0, x[0]);
        let (from_y, size_y) = self.past_offset::<I>(1, x[1]);
        let (from_z, size_z) = self.past_offset::<I>(2, x[2]);
        self.products([from_x, from_y, from_z], [size_x, size_y, size_z])
    }

    /// The images of vectors, and their sizes, as near as those of points.
    #[inline(always)]
    pub fn vectors<I: Isa>(&self, x: V<I>) -> ([Expansion<I>; 3], V<I>) {
        self.products(Expansion::plain(x), lanes::abs(x))
    }

    /// The products with the linear part, and their sizes.
    #[inline(always)]
    fn products<I: Isa>(&self, from: [Expansion<I>; 3], sizes: V<I>) -> ([Expansion<I>; 3], V<I>) {
        let [(x, x_size), (y, y_size), (z, z_size)] = [
            Self::product(from, sizes, self.linear[0]),
            Self::product(from, sizes, self.linear[1]),
            Self::product(from, sizes, self.linear[2]),
        ];
        ([x, y, z], [x_size, y_size, z_size])
    }

    /// A coordinate less that of the offset and of the rest, and its size.
    #[inline(always)]
    fn past_offset<I: Isa>(&self, axis: usize, x: I::F64x8) -> (Expansion<I>, I::F64x8) {
        let Expansion { high, low } = Expansion::<I>::diff(x, I::F64x8::splat(self.offset[axis]));
        let rest = self.rest[axis];
        let size = high.abs().add(I::F64x8::splat(rest.high.abs() / UNIT + rest.size));
        (Expansion { high, low: low.sub(I::F64x8::splat(rest.high)) }, size)
    }

    /// A product with a vector of constants, and the sum of the sizes of its terms.
    #[inline(always)]
    pub fn product<I: Isa>(
        v: [Expansion<I>; 3],
        sizes: V<I>,
        [x, y, z]: [Constant; 3],
    ) -> (Expansion<I>, I::F64x8) {
        let sum = Expansion::dot(v, [Expansion::splat(x), Expansion::splat(y), Expansion::splat(z)]);
        let size = lanes::dot(sizes, lanes::splat([x.size, y.size, z.size]));
        (sum, size.add(I::F64x8::splat(TINY)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::arith::number::Dyadic;
    use crate::arith::simd::Portable;
    use crate::geometry::affine::{Affine, Inverse, Placement};
    use crate::geometry::ray::Ray;
    use crate::testing::{assert_slack, worst};

    /// The largest share of its bound that the image of a point is off by, under the inverse of one map or of
    /// two.
    fn share(x: &[f64; 27], twice: bool, far: f64) -> f64 {
        let vector = |k: usize| -> Point { [x[k], x[k + 1], x[k + 2]] };
        let map =
            |k: usize| Affine::new([vector(k), vector(k + 3), vector(k + 6)], vector(k + 9).map(|x| far * x));
        let Some(mut inverse) = Inverse::of(&map(0), None) else { return 0.0 };
        if twice {
            let Some(both) = Inverse::of(&map(12), Some(Arc::new(inverse))) else { return 0.0 };
            inverse = both;
        }
        let Some(expanded) = inverse.expanded() else { return 0.0 };
        let point = vector(24);
        let Ray { origin, weight, .. } = inverse.local(Ray::<Dyadic>::new(point, [1.0; 3]));
        let weight = weight.unwrap_or(Dyadic::exact(1.0));
        let (image, size) = expanded.points::<Portable>(point.map(|x| [x; 8]));
        let shares = (0..3).map(|i| {
            let (high, low, size) = (image[i].high[0], image[i].low[0], size[i][0]);
            assert!(low.abs() <= 6.0 * UNIT * size, "{x:?}");
            let sum = Dyadic::exact(high).plus(&Dyadic::exact(low));
            let off = origin[i].minus(&weight.times(&sum)).split().0.abs();
            off / (weight.split().0 * 180.0 * UNIT * UNIT * size)
        });
        shares.fold(0.0, f64::max)
    }

    /// The bound counts roundings that never all add up, and 64u² for the inverse, which is more accurate.
    #[test]
    fn points_are_off_by_the_share_of_their_bounds_that_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        for (twice, far, known) in [(false, 1.0, 0.048), (true, 1.0, 0.0277), (true, 1e6, 0.0293)] {
            assert_slack("image", worst(8, 1500, draw, |x| share(x, twice, far)).0, known);
        }
    }

    #[test]
    fn maps_of_huge_or_tiny_numbers_are_left_out() {
        let known = |a: f64, b: f64| {
            let map = Affine::new([[a, b, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0; 3]);
            Inverse::of(&map, None).is_some_and(|inverse| inverse.expanded().is_some())
        };
        assert_eq!([1.0, 1e-59, 1e-61, 1e59, 1e61].map(|a| known(a, 0.0)), [true, true, false, true, false]);
        assert_eq!([0.0, 1e-59, 1e-61, 1e59, 1e61].map(|b| known(1.0, b)), [true, true, false, true, false]);
    }
}
