//! Ellipsoid: the image of the unit sphere under u ↦ center + R·diag(radii)·u.
//!
//! The ray is taken into the space of the unit sphere, which leaves t as it is. The common denominator of the
//! inverse map is kept as the radius of the sphere there, so that nothing is divided.

use std::sync::Arc;

use super::sphere;
use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, all_positive, parameters};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::affine::{Affine, Inverse};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Debug)]
pub struct Ellipsoid {
    /// u ↦ center + R·u, with the entries of R as they were given.
    placement: Affine,
    radii: Point,
    /// Of both maps, the stretching and the placement.
    inverse: Arc<Inverse>,
}

impl PartialEq for Ellipsoid {
    fn eq(&self, other: &Self) -> bool {
        (self.placement, self.radii) == (other.placement, other.radii)
    }
}

impl Ellipsoid {
    /// None if the rotation is singular or a radius zero.
    pub fn new(center: Point, radii: Point, rotation: [[f64; 3]; 3]) -> Option<Self> {
        let [x, y, z] = radii;
        let stretched = Affine::new([[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]], [0.0; 3]);
        let placement = Affine::new(rotation, center);
        let inverse = Inverse::of(&placement, Some(Arc::new(Inverse::of(&stretched, None)?)))?;
        Some(Ellipsoid { placement, radii, inverse: Arc::new(inverse) })
    }

    /// The ray in the space of the sphere, and the radius of the sphere there.
    #[inline(always)]
    fn unit_space<N: Number>(&self, ray: &Ray<N>) -> (Vector<N>, Vector<N>, N) {
        let local = N::of_kinds(&*self.inverse).apply(ray);
        let radius = local.weighted(N::exact(1.0));
        (local.origin, local.direction, radius)
    }
}

impl Shape for Ellipsoid {
    const MOST_ROOTS: usize = 2;

    /// x, y, z: the rows of the rotation.
    const FORMS: &'static [Form] = &[&[("center", 3), ("radii", 3), ("x", 3), ("y", 3), ("z", 3)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [x, y, z, a, b, c, rotation @ ..] = parameters::<15>(numbers)?;
        all_positive("radii", &[a, b, c])?;
        let [r0, r1, r2, r3, r4, r5, r6, r7, r8] = rotation;
        Ellipsoid::new([x, y, z], [a, b, c], [[r0, r1, r2], [r3, r4, r5], [r6, r7, r8]])
            .ok_or_else(|| IllegalArgument::new("rotation", "an invertible matrix", "determinant 0"))
    }
}

impl Surface for Ellipsoid {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let (f, d, r) = self.unit_space(ray);
        sphere::roots_of_ball(&f, &d, &r)
    }

    #[inline(always)]
    fn touching<N: Number>(&self, ray: &Ray<N>) -> Option<Root<N>> {
        let (f, d, _) = self.unit_space(ray);
        Some(sphere::touching_ball(&f, &d))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, _: u8) -> N {
        let (u, _, r) = self.unit_space(ray);
        vector::norm2(&u).minus(&r.squared())
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, _: u8) -> Vector<N> {
        let (u, _, _) = self.unit_space(ray);
        N::of_kinds(&*self.inverse).normal(&u)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        // As far along an axis as that row of R·diag(radii) is long.
        let [x, y, z] = self.radii;
        Some(self.placement.around(|row| [vector::length_above([row[0] * x, row[1] * y, row[2] * z]); 2]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_touches_a_turned_ellipsoid() {
        // Turned by the angle of the 3-4-5 triangle: (0.6·2)² + (0.8·1)² = 2.08 and (0.8·2)² + (0.6·1)² =
        // 2.92.
        let turn = [[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]];
        let ellipsoid = Ellipsoid::new([1.0, 0.0, 0.0], [2.0, 1.0, 3.0], turn);
        let found = ellipsoid.and_then(|ellipsoid| ellipsoid.bounds());
        let (center, reach) = ([1.0, 0.0, 0.0], [2.08_f64.sqrt(), 2.92_f64.sqrt(), 3.0]);
        assert!(found.is_some());
        // Lengths up to 3, 16 ε too long at most, and fewer than 16 roundings of numbers up to 4.
        let close = 64.0 * f64::EPSILON;
        for (i, side) in found.into_iter().flatten().enumerate() {
            let (low, high) = (center[i] - reach[i], center[i] + reach[i]);
            assert!((low - side.low).abs() < close && (high - side.high).abs() < close);
        }
    }
}
