//! The predicates of roots on objects: bounds of roots, their order, correctly rounded roots, and refined
//! hits.

use std::cmp::Ordering;

use super::object::with_shape;
use super::{Geometry, ObjectAt, RootId, TimedRay};
use crate::arith::number::{Interval, Number, Predicate, Uncertain};
use crate::arith::root::{Root, TOUCHING};
use crate::geometry::affine::Placement;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point};
use crate::shapes::{MOST_ROOTS, Surface, Triangle, triangle};

/// A root, with bounds of t.
pub type BoundedRoot = (RootId, Interval);

/// The roots of a ray on a primitive of an object, which has this id, with their bounds.
pub struct RootIntervals<'a> {
    pub object: ObjectAt<'a>,
    pub id: u32,
    pub primitive: u32,
    pub ray: TimedRay,
}

impl Predicate for RootIntervals<'_> {
    type Answer = [Option<BoundedRoot>; MOST_ROOTS];

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        let RootIntervals { object, id, primitive, ray } = self;
        let roots = object.roots::<N>(*primitive, &object.local_ray(ray))?;
        let mut found = [None; MOST_ROOTS];
        for (index, (found, root)) in (0..).zip(found.iter_mut().zip(roots.iter().flatten())) {
            let index = if root.touches { TOUCHING } else { index };
            let at = RootId { object: *id, primitive: *primitive, index, feature: root.feature };
            *found = Some((at, N::enclose(root)?));
        }
        Ok(found)
    }
}

/// A root of a ray on an object.
#[derive(Clone, Copy)]
pub struct RootOn<'a> {
    pub object: ObjectAt<'a>,
    pub at: &'a RootId,
    pub ray: &'a TimedRay,
}

impl RootOn<'_> {
    fn root<N: Number>(&self) -> Result<Root<N>, Uncertain> {
        self.object.root(self.at, &self.object.local_ray(self.ray))
    }
}

pub struct RootOrder<'a>(pub [RootOn<'a>; 2]);

impl Predicate for RootOrder<'_> {
    type Answer = Ordering;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Ordering, Uncertain> {
        let [a, b] = &self.0;
        N::compare(&a.root::<N>()?, &b.root::<N>()?)
    }
}

/// Whether the line meets an edge or a corner that two triangles in the same coordinates share. It then meets
/// their planes at the same t.
pub fn meets_what_they_share<N: Number>(
    ray: &Ray<N>,
    one: &Triangle,
    other: &Triangle,
) -> Result<bool, Uncertain> {
    let Triangle(a, b, c) = one;
    let d = &ray.direction;
    let from = |point: &Point| ray.origin_from(vector::exact(*point));
    match [a, b, c].map(|corner| other.has_corner(corner)) {
        [false, false, false] => Ok(false),
        [true, false, false] => vector::is_zero(&vector::cross(&from(a), d)),
        [false, true, false] => vector::is_zero(&vector::cross(&from(b), d)),
        [false, false, true] => vector::is_zero(&vector::cross(&from(c), d)),
        [_, true, true] => triangle::volume(d, &from(b), &from(c)).is_zero(),
        [true, _, true] => triangle::volume(d, &from(a), &from(c)).is_zero(),
        [true, true, false] => triangle::volume(d, &from(a), &from(b)).is_zero(),
    }
}

/// t, correctly rounded.
pub struct RoundedRoot<'a>(pub RootOn<'a>);

impl Predicate for RoundedRoot<'_> {
    type Answer = f64;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<f64, Uncertain> {
        N::round(&self.0.root::<N>()?)
    }
}

/// Whether t < 0.
pub struct NegativeRoot<'a>(pub RootOn<'a>);

impl Predicate for NegativeRoot<'_> {
    type Answer = bool;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<bool, Uncertain> {
        Ok(self.0.root::<N>()?.sign()? == Ordering::Less)
    }
}

/// A hit: t, correctly rounded, and a normal of moderate length.
pub struct RefinedHit<'a>(pub RootOn<'a>);

impl Predicate for RefinedHit<'_> {
    type Answer = (f64, Point);

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<(f64, Point), Uncertain> {
        let RootOn { object, at, ray } = &self.0;
        let (ray, placement) = (object.local_ray::<N>(ray), object.placement());
        with_shape!(&object.geometry, at.primitive, shape => refined_hit(placement, shape, &ray, at.index))
    }
}

/// t, rounded, and a world normal at a root of a surface; the ray is in the coordinates of the surface.
#[inline(always)]
pub fn refined_hit<N: Number>(
    placement: impl Placement,
    surface: &impl Surface,
    ray: &Ray<N>,
    index: u8,
) -> Result<(N::Floats, [N::Floats; 3]), Uncertain> {
    let root = surface.root(ray, index)?;
    let t = N::value(&root)?;
    let normal = placement.normal(surface.normal(&ray.at(&t), root.feature));
    Ok((N::round(&root)?, N::proportions(&normal)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::{self, Dyadic};
    use crate::geometry::affine::Affine;
    use crate::scene::Object;
    use crate::shapes::{AnySurface, Cylinder, Ellipsoid, Sphere};
    use crate::testing::numbers;

    fn of(surface: impl Into<AnySurface>) -> Object {
        Object::new(Geometry::Surface(surface.into()), false)
    }

    /// Rays to points of an edge or a corner that two triangles share, and to points of only one of them.
    /// Rays that meet the shared part have the same exact t on both; most others do not.
    #[test]
    fn rays_meet_neighbours_at_once_where_they_meet_what_these_share() {
        let mut next = numbers();
        let (mut met, mut passed, mut apart) = (0, 0, 0);
        for round in 0..2000 {
            let mut point = || [0; 3].map(|_: u8| (32.0 * next()).round() / 4.0);
            let (a, b, c, d, e, origin) = (point(), point(), point(), point(), point(), point());
            let neighbours = [
                Triangle(d, a, b),
                Triangle(b, d, c),
                Triangle(a, c, d),
                Triangle(e, c, d),
                Triangle(d, e, a),
            ];
            let (one, other) = (Triangle(a, b, c), neighbours[round % 5]);
            let w = [0.0, 0.25, 0.5, 1.0][round / 5 % 4];
            let [from, to] = [[a, b], [b, c], [c, a]][round / 20 % 3];
            let target = [0, 1, 2].map(|i| from[i] * w + to[i] * (1.0 - w));
            let direction = [0, 1, 2].map(|i| target[i] - origin[i]);
            let ray = Ray::<Dyadic>::new(origin, direction);
            let (Ok(x), Ok(y)) = (one.root(&ray, 0), other.root(&ray, 0)) else { continue };
            let is_tie = Dyadic::compare(&x, &y) == Ok(Ordering::Equal);
            match meets_what_they_share(&ray, &one, &other) {
                Ok(true) => {
                    assert!(is_tie, "{one:?} {other:?} {ray:?}");
                    met += 1;
                }
                _ if is_tie => passed += 1,
                _ => apart += 1,
            }
        }
        assert!(met > 400 && apart > 400 && passed < met / 8, "{met}, {passed}, {apart}");
    }

    /// Tangent lines of circles and ellipses, within their planes: o = p − k·d, so that t = k at the point
    /// p with the tangent d.
    #[test]
    fn a_line_that_touches_has_one_root_that_is_known_to() {
        let ellipsoid =
            Ellipsoid::new([0.0; 3], [5.0, 5.0, 7.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let cylinder =
            |capped| Cylinder { start: [0.0, 0.0, -9.0], end: [0.0, 0.0, 9.0], radius: 5.0, capped };
        let sphere = of(Sphere { center: [0.0; 3], radius: 5.0 });
        let shapes = [sphere, of(cylinder(false)), of(cylinder(true))].into_iter().chain(ellipsoid.map(of));
        let map = Affine::new([[0.0, -2.0, 0.0], [1.0, 0.0, 0.5], [0.0, 0.0, -1.0]], [0.0, 0.25, 3.0]);
        let mut found = 0;
        for (index, object) in shapes.enumerate() {
            for (object, is_moved) in [(object.transformed(map), true), (Some(object), false)] {
                let Some(object) = object else { unreachable!("the map can be inverted") };
                for k in 1..40 {
                    let (k, rise) =
                        (f64::from(k) / 4.0, if index == 3 { 0.0 } else { f64::from(k % 5) / 8.0 });
                    let (origin, direction) = ([3.0 + 4.0 * k, 4.0 - 3.0 * k, -rise * k], [-4.0, 3.0, rise]);
                    let (origin, direction) = if is_moved {
                        let [[x, y, z], [u, v, w]] = [origin, direction];
                        ([-2.0 * y, x + 0.5 * z + 0.25, 3.0 - z], [-2.0 * v, u + 0.5 * w, -w])
                    } else {
                        (origin, direction)
                    };
                    let (object, ray) = (object.at(0.0), TimedRay { origin, direction, time: 0.0 });
                    let roots = number::decide(&RootIntervals { object, id: 0, primitive: 0, ray });
                    let [Some((root, t)), None] = roots else { panic!("{ray:?} {k}") };
                    assert!(root.index == TOUCHING && t.low <= k && k <= t.high);
                    let root = RootOn { object, at: &root, ray: &ray };
                    let rounded = number::decide(&RoundedRoot(root));
                    let (refined, _) = number::decide_exactly(&RefinedHit(root));
                    assert_eq!((rounded, refined), (k, k));
                    found += 1;
                }
            }
        }
        assert_eq!(found, 4 * 2 * 39);
    }
}
