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
    fn unit_space<N: Number>(&self, ray: &Ray<N>) -> (Vector<N>, Vector<N>, N) {
        let local = N::of_inverse(&self.inverse).apply(ray);
        let [x, y, z]: Vector<N> = vector::exact(self.radii);
        // diag(1/radii) times the product of the radii.
        let factors = [y.times(&z), z.times(&x), x.times(&y)];
        let scale = |v: &Vector<N>| std::array::from_fn(|i| v[i].times(&factors[i]));
        let radius = local.weighted(x.times(&y).times(&z));
        (scale(&local.origin), scale(&local.direction), radius)
    }
}

impl Surface for Ellipsoid {
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let (f, d, r) = self.unit_space(ray);
        sphere::roots_of_ball(&f, &d, &r)
    }

    fn normal<N: Number>(&self, ray: &Ray<N>, t: &N, _: u8) -> Vector<N> {
        // The gradient R⁻ᵀ·diag(1/radii)·u, times positive numbers.
        let (f, d, _) = self.unit_space(ray);
        let u = vector::add(&f, &vector::scaled(&d, t));
        let [x, y, z]: Vector<N> = vector::exact(self.radii);
        let factors = [y.times(&z), z.times(&x), x.times(&y)];
        let gradient = std::array::from_fn(|i| u[i].times(&factors[i]));
        N::of_inverse(&self.inverse).normal(&gradient)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(self.placement.image(self.radii.map(|r| Interval { low: -r, high: r })))
    }
}
