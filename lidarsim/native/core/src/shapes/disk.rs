//! Disk: the points of a plane at most `radius` away from `center`.
//!
//! With f = o − center, the line meets the plane at t = b/a, where it is p = f + t·d from the centre:
//! |a·f + b·d|² ≤ (r·a)² there, without a division.

use std::cmp::Ordering;

use super::plane::Plane;
use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, positive, roots};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    pub center: Point,
    pub normal: Point,
    pub radius: f64,
}

impl Disk {
    #[inline(always)]
    fn plane(&self) -> Plane {
        Plane::PointNormal { point: self.center, normal: self.normal }
    }
}

impl Shape for Disk {
    const MOST_ROOTS: usize = 1;

    const FORMS: &'static [Form] = &[&[("center", 3), ("normal", 3), ("radius", 1)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [a, b, c, x, y, z, radius] = parameters(numbers)?;
        let (center, normal) = ([a, b, c], [x, y, z]);
        if normal == [0.0; 3] {
            return Err(IllegalArgument::new("normal", "a non-zero vector", format!("{normal:?}")));
        }
        positive("radius", radius)?;
        Ok(Disk { center, normal, radius })
    }
}

impl Surface for Disk {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let [Some(root), _] = self.plane().roots(ray)? else { return Ok(roots([None, None])) };
        let f = ray.origin_from(vector::exact(self.center));
        let from_center = vector::add(&vector::scaled(&f, &root.a), &vector::scaled(&ray.direction, &root.b));
        let reach = ray.weighted(N::exact(self.radius)).times(&root.a);
        let is_outside = vector::norm2(&from_center).minus(&reach.squared()).sign()? == Ordering::Greater;
        Ok(roots([if is_outside { None } else { Some(root) }, None]))
    }

    /// Skips the distance from the centre, as the root is known to exist.
    #[inline(always)]
    fn only_root<N: Number>(&self, ray: &Ray<N>) -> Option<Result<Root<N>, Uncertain>> {
        Some(match self.plane().roots(ray) {
            Ok([root, _]) => root.ok_or(Uncertain),
            Err(Uncertain) => Err(Uncertain),
        })
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        self.plane().implicit(ray, feature)
    }

    #[inline(always)]
    fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N> {
        self.plane().normal(ray, feature)
    }

    fn axis_plane(&self, feature: u8) -> Option<AxisPlane> {
        self.plane().axis_plane(feature)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        let reach = vector::reach_of_circle(self.normal, self.radius);
        Some(std::array::from_fn(|i| Interval {
            low: (self.center[i] - reach[i]).next_down(),
            high: (self.center[i] + reach[i]).next_up(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::Dyadic;

    fn root(disk: &Disk, target: Point) -> Option<Root<Dyadic>> {
        let direction = [0.5, 1.0, 0.25];
        let origin = [0, 1, 2].map(|i| target[i] - 2.0 * direction[i]);
        let [root, _] = disk.roots(&Ray::new(origin, direction)).ok()?;
        root
    }

    #[test]
    fn the_rim_belongs_to_the_disk() {
        let disk = Disk { center: [1.0, 2.0, 3.0], normal: [0.0, 4.0, -3.0], radius: 5.0 };
        // (0, 3, 4) is across the normal and as long as the radius.
        for rim in [[6.0, 2.0, 3.0], [-4.0, 2.0, 3.0], [1.0, 5.0, 7.0], [1.0, -1.0, -1.0]] {
            assert!(root(&disk, rim).is_some_and(|root| Dyadic::round(&root) == Ok(2.0)), "{rim:?}");
        }
        assert!(root(&disk, [6.0_f64.next_down(), 2.0, 3.0]).is_some());
        assert!(root(&disk, [6.0_f64.next_up(), 2.0, 3.0]).is_none());
        assert!(root(&disk, [1.0_f64.next_up(), 5.0, 7.0]).is_none());
    }
}
