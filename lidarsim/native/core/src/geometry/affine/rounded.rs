//! The inverse of affine maps in float64.

use super::Adjugate;
use crate::arith::number::{DoubleDouble, Number, RunningError, UNIT};
use crate::arith::simd::{Floats, lanes};
use crate::geometry::ray::Ray;
use crate::geometry::vector::Point;

/// The inverse of affine maps in float64, x ↦ linear·(x − pivot) + image, and bounds of its errors.
#[derive(Clone, Copy, Debug)]
pub struct RoundedInverse {
    linear: [Point; 3],
    pivot: Point,
    image: Point,
    /// The error of a product per unit of Σ|wᵢ| of the vector, and the error of the image.
    linear_error: f64,
    image_error: f64,
    /// The entries of `linear` that are exactly zero, by row, one bit per column.
    zeros: [u8; 3],
}

impl RoundedInverse {
    /// `None` if the bounds are uncertain.
    ///
    /// Let B be the largest entry and E the width of the widest interval that encloses one. In units of
    /// Σ|wᵢ|, the errors of the entries add E to the error of a product, and three products and their sums
    /// add 3uB; a difference w adds uB, and the sum with the image T another uB, and u·T. The bounds have
    /// 8uB and 4u·T, which also covers their own roundings.
    pub(super) fn of(inverse: &Adjugate<DoubleDouble>, rows: &Adjugate<RunningError>) -> Option<Self> {
        let pivot = inverse.offset;
        let (mut linear, mut image) = ([[0.0; 3]; 3], [0.0; 3]);
        let (mut largest, mut linear_error, mut image_error): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for j in 0..3 {
            let axis = std::array::from_fn(|i| f64::from(u8::from(i == j)));
            let [origin, direction] = inverse.apply(&Ray::new(pivot, axis)).enclose().ok()?;
            for i in 0..3 {
                (linear[i][j], image[i]) = (direction[i].middle(), origin[i].middle());
                largest = largest.max(linear[i][j].abs());
                linear_error = linear_error.max(direction[i].high - direction[i].low);
                image_error = image_error.max(origin[i].high - origin[i].low + 4.0 * UNIT * image[i].abs());
            }
        }
        linear_error += 8.0 * UNIT * largest;
        let known = linear_error.is_finite() && image_error.is_finite();
        let zeros = rows
            .linear
            .rows
            .each_ref()
            .map(|row| (0..3).fold(0, |bits, j| bits | u8::from(row[j].is_zero() == Ok(true)) << j));
        known.then_some(RoundedInverse { linear, pivot, image, linear_error, image_error, zeros })
    }

    /// By axis, the vectors whose image is exactly zero along it, from those that are exactly zero along each
    /// axis, one bit each.
    pub fn parallel(&self, zero: [u64; 3]) -> [u64; 3] {
        self.zeros.map(|row| {
            let along = |j: usize| if row >> j & 1 != 0 { u64::MAX } else { zero[j] };
            along(0) & along(1) & along(2)
        })
    }

    /// Images of points, and bounds of the error of any coordinate.
    #[inline(always)]
    pub fn points<F: Floats<f64, N>, const N: usize>(&self, [x, y, z]: [F; 3]) -> ([F; 3], F) {
        let ([p, q, r], [s, t, u]) = (lanes::splat(self.pivot), lanes::splat(self.image));
        let ([x, y, z], error) = self.vectors([x.sub(p), y.sub(q), z.sub(r)]);
        ([x.add(s), y.add(t), z.add(u)], error.add(F::splat(self.image_error)))
    }

    /// As `points`, for vectors.
    #[inline(always)]
    pub fn vectors<F: Floats<f64, N>, const N: usize>(&self, v: [F; 3]) -> ([F; 3], F) {
        let [r0, r1, r2] = self.linear;
        let size = v[0].abs().add(v[1].abs()).add(v[2].abs());
        // Products may underflow.
        let error = size.fused(F::splat(self.linear_error), F::splat(f64::MIN_POSITIVE));
        let image = [
            lanes::fused_dot(lanes::splat(r0), v),
            lanes::fused_dot(lanes::splat(r1), v),
            lanes::fused_dot(lanes::splat(r2), v),
        ];
        (image, error)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::geometry::affine::{Affine, Inverse, Placement};
    use crate::geometry::vector::Vector;
    use crate::testing::{assert_slack, worst};

    /// The largest shares of their bounds that the images of a point and of a vector are off by, under the
    /// inverse of one map or of two.
    fn shares(x: &[f64; 30], twice: bool, far: f64) -> [f64; 2] {
        let vector = |k: usize| -> Point { [x[k], x[k + 1], x[k + 2]] };
        let map =
            |k: usize| Affine::new([vector(k), vector(k + 3), vector(k + 6)], vector(k + 9).map(|x| far * x));
        let Some(mut inverse) = Inverse::of(&map(0), None) else { return [0.0; 2] };
        if twice {
            let Some(both) = Inverse::of(&map(12), Some(Arc::new(inverse))) else { return [0.0; 2] };
            inverse = both;
        }
        let Some(rounded) = inverse.rounded() else { return [0.0; 2] };
        let (point, direction) = (vector(24), vector(27));
        let truth: Ray<Dyadic> = inverse.local(Ray::new(point, direction));
        let weight = truth.weight.unwrap_or(Dyadic::exact(1.0));
        let share = |truth: Vector<Dyadic>, (seen, error): (Point, f64)| {
            let off = |i: usize| truth[i].minus(&weight.times(&Dyadic::exact(seen[i]))).split().0.abs();
            off(0).max(off(1)).max(off(2)) / (weight.split().0 * error)
        };
        [
            share(truth.origin, rounded.points::<f64, 1>(point)),
            share(truth.direction, rounded.vectors::<f64, 1>(direction)),
        ]
    }

    /// A point and a vector, under one map or two, near and far. Roundings reach 5u of the 8u, or 3u, only in
    /// a row of equal entries that all round the same way; and entries of equal size are rarely the largest.
    #[test]
    fn images_are_off_by_the_share_of_their_bounds_that_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        for (twice, far, known) in
            [(false, 1.0, [0.189, 0.163]), (true, 1.0, [0.287, 0.187]), (true, 1e6, [0.225, 0.187])]
        {
            for (kind, known) in known.into_iter().enumerate() {
                assert_slack("image", worst(8, 1500, draw, |x| shares(x, twice, far)[kind]).0, known);
            }
        }
    }
}
