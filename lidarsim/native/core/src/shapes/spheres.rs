//! Many spheres, each defined by its centre and radius.

use super::each::{Each, vector};
use super::sphere::{Sphere, implicit_of, roots_of};
use super::surface::Roots;
use crate::arith::number::{Number, Uncertain};
use crate::geometry::ray::Ray;
use crate::geometry::vector::Vector;

impl Each<4> for Sphere {
    fn of([x, y, z, radius]: [f64; 4]) -> Self {
        Sphere { center: [x, y, z], radius }
    }

    #[inline(always)]
    fn roots_of<N: Number>([x, y, z, radius]: &[N; 4], ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        roots_of(&vector([x, y, z]), radius, ray)
    }

    #[inline(always)]
    fn implicit_of<N: Number>([x, y, z, radius]: &[N; 4], ray: &Ray<N>) -> N {
        implicit_of(&vector([x, y, z]), radius, ray)
    }

    #[inline(always)]
    fn normal_of<N: Number>([x, y, z, _]: &[N; 4], ray: &Ray<N>) -> Vector<N> {
        ray.origin_from(vector([x, y, z]))
    }
}
