//! Triangle: the signs of d·(c × b), d·(a × c), d·(b × a), with a, b, c relative to the ray's origin.
//!
//! Each is six times the volume of the tetrahedron of the ray and an edge. A shared edge gives two triangles
//! the same number with opposite signs, and the signs are exact, so no ray slips through between them (S.
//! Woop, C. Benthin, I. Wald, Watertight Ray/Triangle Intersection, JCGT 2013, use the same signs, U, V, W,
//! after a shear).

mod crossing;
mod each;
mod leaf;
mod sides;

use std::cmp::Ordering;

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, roots};
use crate::arith::number::{Interval, Number, UNDERFLOW, UNIT, Uncertain};
use crate::arith::root::Root;
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::point::{cross, dot, sub};
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

pub use crossing::{Corners, Crossing, NOWHERE, TrianglePlane, corners_of};
pub use each::Triangles;
pub use leaf::{Edges, LEAF_SIZE, Leaf, LeafRay, LeafRays, Planes, RayBounds, TriangleTest};
pub use sides::{placed_sides, sides};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle(pub Point, pub Point, pub Point);

impl Triangle {
    /// Whether the three vertices lie on one line, exactly.
    pub fn is_degenerate(&self) -> bool {
        struct Degenerate<'a>(&'a Triangle);
        impl crate::arith::number::Predicate for Degenerate<'_> {
            type Answer = bool;
            fn evaluate<N: Number<Floats = f64>>(&self) -> Result<bool, Uncertain> {
                let Triangle(a, b, c) = *self.0;
                // A certain non-zero decides; otherwise all three must be certain zeros.
                let signs = triangle_normal::<N>(a, b, c).map(|x| x.is_zero());
                if signs.contains(&Ok(false)) { Ok(false) } else { Ok(signs[0]? && signs[1]? && signs[2]?) }
            }
        }
        crate::arith::number::decide(&Degenerate(self))
    }

    /// The bounds; `None` if the triangle has no area, exactly, so that no ray hits it.
    #[inline]
    pub fn bounds_of_area(&self) -> Option<[Interval; 3]> {
        let Triangle(a, b, c) = *self;
        let (p, q) = (sub(b, a), sub(c, a));
        let (normal, size) = (cross(p, q), |i: usize| p[i].abs().max(q[i].abs()));
        // A difference is rounded once, and so are two products and their difference: less than 8u of the
        // largest products of coordinates. A number that underflows is left to exact arithmetic.
        let is_surely_one = (0..3).any(|i| {
            let largest = size((i + 1) % 3) * size((i + 2) % 3);
            normal[i].abs() > 16.0 * UNIT * largest && largest > UNDERFLOW
        });
        if is_surely_one || !self.is_degenerate() { self.bounds() } else { None }
    }

    /// Whether both triangles have the same corners, in any order.
    pub fn has_corners_of(&self, other: &Triangle) -> bool {
        let Triangle(a, b, c) = other;
        [a, b, c].into_iter().all(|corner| self.has_corner(corner))
    }

    pub fn has_corner(&self, corner: &Point) -> bool {
        [self.0, self.1, self.2].contains(corner)
    }
}

/// Barycentric coordinates of the origin in the plane of the triangle abc, clamped to ≥ 0, as rounding may
/// put points of the rim outside.
#[inline(always)]
pub fn barycentric(corners: [Point; 3]) -> [f64; 3] {
    let (areas, all) = areas(corners);
    // What underflowed is at most an ulp of a normal number.
    if all.is_normal() { areas.map(|area| area / all) } else { extreme_barycentric(corners) }
}

/// Twice the areas of the origin with the edges opposite to the corners, times the length of the normal; and
/// their sum.
#[inline(always)]
fn areas([a, b, c]: [Point; 3]) -> ([f64; 3], f64) {
    let normal = cross(sub(b, a), sub(c, a));
    let areas = [cross(b, c), cross(c, a), cross(a, b)].map(|n| dot(n, normal).max(0.0));
    (areas, areas[0] + areas[1] + areas[2])
}

/// Barycentric coordinates in a triangle so large or small that products overflow or underflow.
#[cold]
fn extreme_barycentric(corners: [Point; 3]) -> [f64; 3] {
    let (areas, all) = areas(scaled(corners));
    // Rounding may leave no area of a sliver.
    if all > 0.0 { areas.map(|area| area / all) } else { [1.0 / 3.0; 3] }
}

/// The points times the power of two that takes the largest coordinate to [1, 2), so that products of
/// coordinates neither overflow nor underflow. Their digits stay the same.
fn scaled(points: [Point; 3]) -> [Point; 3] {
    let largest = points.as_flattened().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let exponent = largest.to_bits() & f64::INFINITY.to_bits();
    let factor = 1.0 / f64::from_bits(exponent).max(f64::MIN_POSITIVE);
    points.map(|point| point.map(|x| x * factor))
}

/// d·(p × q), of corners relative to the origin of a ray: six times the volume of the ray and an edge.
#[inline(always)]
pub fn volume<N: Number>(d: &Vector<N>, p: &Vector<N>, q: &Vector<N>) -> N {
    vector::dot(d, &vector::cross(p, q))
}

/// (b − a) × (c − a).
#[inline(always)]
pub fn normal_through<N: Number>(a: &Vector<N>, b: &Vector<N>, c: &Vector<N>) -> Vector<N> {
    vector::cross(&vector::sub(b, a), &vector::sub(c, a))
}

#[inline(always)]
pub fn triangle_normal<N: Number>(a: Point, b: Point, c: Point) -> Vector<N> {
    normal_through(&vector::exact(a), &vector::exact(b), &vector::exact(c))
}

impl Triangle {
    /// The root where the ray meets the plane, with a relative to its origin; `None` if they are parallel.
    #[inline(always)]
    fn crossing<N: Number>(&self, a: Vector<N>, d: &Vector<N>) -> Result<Option<Root<N>>, Uncertain> {
        let normal: Vector<N> = triangle_normal(self.0, self.1, self.2);
        Root::ratio(vector::dot(&normal, &a), vector::dot(&normal, d), 0)
    }
}

impl Shape for Triangle {
    const MOST_ROOTS: usize = 1;

    const FORMS: &'static [Form] = &[&[("a", 3), ("b", 3), ("c", 3)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [x0, y0, z0, x1, y1, z1, x2, y2, z2] = parameters(numbers)?;
        let triangle = Triangle([x0, y0, z0], [x1, y1, z1], [x2, y2, z2]);
        if triangle.is_degenerate() {
            let Triangle(a, b, c) = triangle;
            let got = format!("{a:?}, {b:?}, {c:?}");
            return Err(IllegalArgument::new("a, b, c", "three points that are not on one line", got));
        }
        Ok(triangle)
    }
}

impl Surface for Triangle {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let a = vector::negated(&ray.origin_from(vector::exact(self.0)));
        let b = vector::negated(&ray.origin_from(vector::exact(self.1)));
        let c = vector::negated(&ray.origin_from(vector::exact(self.2)));
        let d = &ray.direction;
        // The ray misses as soon as two signs differ, whatever the third.
        let mut positive = false;
        let mut negative = false;
        let mut unsure = false;
        for (p, q) in [(&c, &b), (&a, &c), (&b, &a)] {
            match volume(d, p, q).sign() {
                Ok(sign) => {
                    positive |= sign == Ordering::Greater;
                    negative |= sign == Ordering::Less;
                }
                Err(Uncertain) => unsure = true,
            }
        }
        if positive && negative {
            return Ok(roots([None, None]));
        }
        if unsure {
            return Err(Uncertain);
        }
        Ok(roots([self.crossing(a, d)?, None]))
    }

    /// Skips the signs, as the root is known to exist.
    #[inline(always)]
    fn only_root<N: Number>(&self, ray: &Ray<N>) -> Option<Result<Root<N>, Uncertain>> {
        let a = vector::negated(&ray.origin_from(vector::exact(self.0)));
        Some(self.crossing(a, &ray.direction).and_then(|root| root.ok_or(Uncertain)))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        vector::dot(&self.normal(ray, feature), &ray.origin_from(vector::exact(self.0))).doubled()
    }

    #[inline(always)]
    fn normal<N: Number>(&self, _: &Ray<N>, _: u8) -> Vector<N> {
        triangle_normal(self.0, self.1, self.2)
    }

    fn axis_plane(&self, _: u8) -> Option<AxisPlane> {
        let Triangle(a, b, c) = self;
        let axis = (0..3).find(|&axis| a[axis] == b[axis] && a[axis] == c[axis])?;
        AxisPlane::at(axis, a[axis], 0.0)
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(std::array::from_fn(|i| Interval {
            low: self.0[i].min(self.1[i]).min(self.2[i]),
            high: self.0[i].max(self.1[i]).max(self.2[i]),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn barycentric_coordinates_do_not_depend_on_the_size_of_the_triangle() {
        let corners = [[-1.0, -0.75, 0.0], [3.0, -0.25, 0.5], [-0.5, 2.0, -0.25]];
        let expected = barycentric(corners);
        assert!(expected.iter().all(|x| *x > 0.0));
        for exponent in [-1000, -500, -100, -1, 1, 100, 500, 1000] {
            let sized = corners.map(|point| point.map(|x| x * 2.0_f64.powi(exponent)));
            assert_eq!(barycentric(sized), expected, "2^{exponent}");
        }
    }

    /// Whole numbers, often on a line, of all sizes.
    #[test]
    fn triangles_without_an_area_have_no_bounds() {
        let mut next = crate::testing::numbers();
        let mut count = [0; 2];
        for k in 0..20_000 {
            let size = 2.0_f64.powi([0, 30, -300, -1060, 500, 1000][k % 6]);
            let mut point = || [0; 3].map(|_: u8| (6.0 * next()).floor() * size);
            let (a, b, c) = (point(), point(), point());
            let c = if k % 3 == 0 { [0, 1, 2].map(|i| b[i] + (b[i] - a[i])) } else { c };
            let triangle = Triangle(a, b, c);
            assert_eq!(triangle.bounds_of_area().is_none(), triangle.is_degenerate(), "{triangle:?}");
            count[usize::from(triangle.is_degenerate())] += 1;
        }
        assert!(count[0] > 5_000 && count[1] > 5_000, "{count:?}");
    }

    #[test]
    fn barycentric_coordinates_of_a_sliver_are_numbers() {
        let sliver = |height: f64| [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, height, 0.0]];
        assert_eq!(barycentric(sliver(2.0_f64.powi(-500))), [0.5, 0.5, 0.0]);
        assert_eq!(barycentric(sliver(0.0)), [1.0 / 3.0; 3]);
    }
}
