//! Sphere: |f + t·d|² = r², with f = o − c.

use std::cmp::Ordering;

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, positive, roots};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    pub center: Point,
    pub radius: f64,
}

/// The roots of |f + t·d|² = r².
///
/// disc = b² − a·c = r²·|d|² − |f × d|²: by Lagrange's identity the same number without the
/// cancellation between two squares of the distance (E. Haines et al., Precision Improvements for Ray/Sphere
/// Intersection, Ray Tracing Gems, 2019).
#[inline(always)]
pub fn roots_of_ball<N: Number>(f: &Vector<N>, d: &Vector<N>, r: &N) -> Result<Roots<N>, Uncertain> {
    let a = vector::norm2(d);
    let r2 = r.squared();
    let disc = r2.times(&a).minus(&vector::norm2(&vector::cross(f, d)));
    let order = disc.sign()?;
    if order == Ordering::Less {
        return Ok(roots([None, None]));
    }
    if order == Ordering::Equal {
        return Ok(roots([Some(touching_ball(f, d)), None]));
    }
    let b = vector::dot(f, d).negated();
    let c = vector::norm2(f).minus(&r2);
    Ok(roots(Root::quadratic(a, b, c, disc, order, 0)))
}

/// The root of a line that touches the ball.
#[inline(always)]
pub fn touching_ball<N: Number>(f: &Vector<N>, d: &Vector<N>) -> Root<N> {
    Root::touching(vector::norm2(d), vector::dot(f, d).negated(), 0)
}

impl Shape for Sphere {
    const MOST_ROOTS: usize = 2;

    const FORMS: &'static [Form] = &[&[("center", 3), ("radius", 1)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [x, y, z, radius] = parameters(numbers)?;
        positive("radius", radius)?;
        Ok(Sphere { center: [x, y, z], radius })
    }
}

impl Surface for Sphere {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let f = ray.origin_from(vector::exact(self.center));
        roots_of_ball(&f, &ray.direction, &ray.weighted(N::exact(self.radius)))
    }

    #[inline(always)]
    fn touching<N: Number>(&self, ray: &Ray<N>) -> Option<Root<N>> {
        Some(touching_ball(&ray.origin_from(vector::exact(self.center)), &ray.direction))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, _: u8) -> N {
        let f = ray.origin_from(vector::exact(self.center));
        vector::norm2(&f).minus(&ray.weighted(N::exact(self.radius)).squared())
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, _: u8) -> Vector<N> {
        ray.origin_from(vector::exact(self.center))
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(
            self.center
                .map(|c| Interval { low: (c - self.radius).next_down(), high: (c + self.radius).next_up() }),
        )
    }
}
