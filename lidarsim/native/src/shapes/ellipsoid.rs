//! Ellipsoid: the image of the unit sphere under u ↦ center + R·diag(radii)·u.
//!
//! The ray is taken into the space of the unit sphere, which leaves t as it is. The common denominator of the inverse map
//! is kept as the radius of the sphere there, so that nothing is divided.

use super::{Surface, sphere};
use crate::affine::{Affine, Inverse};
use crate::number::{Interval, Number, Uncertain};
use crate::ray::Ray;
use crate::root::Roots;
use crate::vector::{self, Point, Vector};

#[derive(Clone, Debug)]
pub struct Ellipsoid {
    /// u ↦ center + R·u, with the entries of R as they were given.
    placement: Affine,
    inverse: std::boxed::Box<Inverse>,
    radii: Point,
}

impl Ellipsoid {
    /// None if the rotation is singular.
    pub fn new(center: Point, radii: Point, rotation: [[f64; 3]; 3]) -> Option<Self> {
        let placement = Affine::new(rotation, center);
        Some(Ellipsoid { placement, inverse: std::boxed::Box::new(Inverse::of(&placement)?), radii })
    }

    /// The ray in the space of the sphere, and the radius of the sphere there.
    #[inline(always)]
    fn unit_space<N: Number>(&self, ray: &Ray<N>) -> (Vector<N>, Vector<N>, N) {
        let local = N::of_inverse(&self.inverse).apply(ray);
        let factors: Vector<N> = self.factors();
        let radius = local.weighted(factors[2].times(&N::exact(self.radii[2])));
        (vector::times(&local.origin, &factors), vector::times(&local.direction, &factors), radius)
    }

    /// diag(1/radii) times the product of the radii.
    #[inline(always)]
    fn factors<N: Number>(&self) -> Vector<N> {
        let [x, y, z]: Vector<N> = vector::exact(self.radii);
        [y.times(&z), z.times(&x), x.times(&y)]
    }
}

impl Surface for Ellipsoid {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let (f, d, r) = self.unit_space(ray);
        sphere::roots_of_ball(&f, &d, &r)
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, t: &N, _: u8) -> Vector<N> {
        // The gradient R⁻ᵀ·diag(1/radii)·u, times positive numbers.
        let (f, d, _) = self.unit_space(ray);
        let u = vector::add(&f, &vector::scaled(&d, t));
        N::of_inverse(&self.inverse).normal(&vector::times(&u, &self.factors()))
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(self.placement.image(self.radii.map(|r| Interval { low: -r, high: r })))
    }
}
