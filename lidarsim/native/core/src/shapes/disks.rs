//! Many disks, each defined by its centre, radius and normal.

use super::disk::{Disk, is_outside};
use super::each::{Each, vector};
use super::surface::{Roots, roots};
use crate::arith::number::{Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Vector};

impl Each<7> for Disk {
    fn of([x, y, z, radius, i, j, k]: [f64; 7]) -> Self {
        Disk { center: [x, y, z], normal: [i, j, k], radius }
    }

    /// The root t = b/a, as a·b/a²: disks are seen from either side, so the sign of a would part the lanes.
    #[inline(always)]
    fn roots_of<N: Number>([x, y, z, r, i, j, k]: &[N; 7], ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let (normal, f) = (vector([i, j, k]), ray.origin_from(vector([x, y, z])));
        let (a, b) = (vector::dot(&normal, &ray.direction), vector::dot(&normal, &f).negated());
        let from_center = vector::add(&vector::scaled(&f, &a), &vector::scaled(&ray.direction, &b));
        if is_outside(&from_center, &ray.weighted(r.clone()), &a)? || a.squared().is_zero()? {
            return Ok(roots([None, None]));
        }
        Ok(roots([Some(Root::linear(a.times(&b), a.squared(), 0)), None]))
    }

    #[inline(always)]
    fn implicit_of<N: Number>([x, y, z, _, i, j, k]: &[N; 7], ray: &Ray<N>) -> N {
        vector::dot(&vector([i, j, k]), &ray.origin_from(vector([x, y, z]))).doubled()
    }

    #[inline(always)]
    fn normal_of<N: Number>([_, _, _, _, i, j, k]: &[N; 7], _: &Ray<N>) -> Vector<N> {
        vector([i, j, k])
    }
}
