//! Disk.

use std::cmp::Ordering;

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, positive, roots};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    pub center: Point,
    pub normal: Point,
    pub radius: f64,
}

/// With f = o − c and s = n·d, the line meets the plane at t = −n·f/s, and n × (f × d) = s·f − (n·f)·d is s
/// times the vector from the centre to that point.
#[inline(always)]
pub fn roots_of<N: Number>(
    center: &Vector<N>,
    normal: &Vector<N>,
    radius: &N,
    ray: &Ray<N>,
) -> Result<Roots<N>, Uncertain> {
    let slope = vector::dot(normal, &ray.direction);
    let f = ray.origin_from(center.clone());
    let height = vector::dot(normal, &f);
    let across = vector::cross(normal, &vector::cross(&f, &ray.direction));
    let reach = ray.weighted(radius.clone()).times(&slope);
    if vector::norm2(&across).minus(&reach.squared()).sign()? == Ordering::Greater {
        return Ok(roots([None, None]));
    }
    Ok(roots([Root::ratio(height.negated(), slope, 0)?, None]))
}

#[inline(always)]
pub fn implicit_of<N: Number>(center: &Vector<N>, normal: &Vector<N>, ray: &Ray<N>) -> N {
    vector::dot(normal, &ray.origin_from(center.clone())).doubled()
}

impl Shape for Disk {
    const MOST_ROOTS: usize = 1;

    const FORMS: &'static [Form] = &[&[("center", 3), ("normal", 3), ("radius", 1)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [x, y, z, i, j, k, radius] = parameters(numbers)?;
        if [i, j, k] == [0.0; 3] {
            return Err(IllegalArgument::new("normal", "non-zero vectors", "normal = (0, 0, 0)"));
        }
        positive("radius", radius)?;
        Ok(Disk { center: [x, y, z], normal: [i, j, k], radius })
    }
}

impl Surface for Disk {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        roots_of(&vector::exact(self.center), &vector::exact(self.normal), &N::exact(self.radius), ray)
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, _: u8) -> N {
        implicit_of(&vector::exact(self.center), &vector::exact(self.normal), ray)
    }

    #[inline(always)]
    fn normal<N: Number>(&self, _: &Ray<N>, _: u8) -> Vector<N> {
        vector::exact(self.normal)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        let reach = vector::reach_of_circle(self.normal, self.radius);
        Some(std::array::from_fn(|i| Interval {
            low: (self.center[i] - reach[i]).next_down(),
            high: (self.center[i] + reach[i]).next_up(),
        }))
    }
}
