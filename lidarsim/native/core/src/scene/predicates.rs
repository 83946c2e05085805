//! The predicates of roots on objects: bounds of roots, their order, roots correctly rounded, and refined hits.

use std::cmp::Ordering;

use super::{Geometry, ObjectAt, RootId};
use crate::arith::number::{Interval, Number, Predicate, Uncertain};
use crate::geometry::affine::Placement;
use crate::geometry::ray::Ray;
use crate::geometry::vector::Point;
use crate::shapes::Surface;

/// Bounds of the roots of a primitive.
pub struct RootIntervals<'a> {
    pub object: ObjectAt<'a>,
    pub primitive: u32,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for RootIntervals<'_> {
    /// Bounds of t, and the part of the surface.
    type Answer = [Option<(Interval, u8)>; 2];

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        let roots =
            self.object.roots::<N>(self.primitive, &self.object.local(Ray::new(self.origin, self.direction)))?;
        let mut found = [None; 2];
        for (found, root) in found.iter_mut().zip(roots.iter().flatten()) {
            *found = Some((N::enclose(root)?, root.feature));
        }
        Ok(found)
    }
}

pub struct RootOrder<'a> {
    pub objects: [ObjectAt<'a>; 2],
    pub a: &'a RootId,
    pub b: &'a RootId,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for RootOrder<'_> {
    type Answer = Ordering;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Ordering, Uncertain> {
        let root =
            |object: &ObjectAt, at: &RootId| object.root::<N>(at, &object.local(Ray::new(self.origin, self.direction)));
        let [a, b] = &self.objects;
        N::compare(&root(a, self.a)?, &root(b, self.b)?)
    }
}

pub struct RoundedRoot<'a> {
    pub object: ObjectAt<'a>,
    pub at: &'a RootId,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for RoundedRoot<'_> {
    type Answer = f64;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<f64, Uncertain> {
        N::round(&self.object.root::<N>(self.at, &self.object.local(Ray::new(self.origin, self.direction)))?)
    }
}

/// Whether t < 0.
pub struct NegativeRoot<'a> {
    pub object: ObjectAt<'a>,
    pub at: &'a RootId,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for NegativeRoot<'_> {
    type Answer = bool;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<bool, Uncertain> {
        let ray = self.object.local(Ray::new(self.origin, self.direction));
        Ok(self.object.root::<N>(self.at, &ray)?.sign()? == Ordering::Less)
    }
}

/// A hit: t, correctly rounded, and a normal of ordinary length.
pub struct RefinedHit<'a> {
    pub object: ObjectAt<'a>,
    pub at: &'a RootId,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for RefinedHit<'_> {
    type Answer = (f64, Point);

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<(f64, Point), Uncertain> {
        let ray = self.object.local::<N>(Ray::new(self.origin, self.direction));
        let placement = self.object.placement();
        match &self.object.geometry {
            Geometry::Surface(shape) => refined_hit(placement, shape, &ray, self.at.index),
            Geometry::Mesh(mesh) => refined_hit(placement, &mesh.triangle(self.at.primitive), &ray, self.at.index),
        }
    }
}

/// t, rounded, and a normal in the world, of a root of a surface; the ray is in its coordinates.
#[inline(always)]
pub fn refined_hit<N: Number>(
    placement: impl Placement,
    surface: &impl Surface,
    ray: &Ray<N>,
    index: u8,
) -> Result<(N::Floats, [N::Floats; 3]), Uncertain> {
    let [first, second] = surface.roots(ray)?;
    let root = match if index == 0 { first } else { second } {
        Some(root) => root,
        None => return Err(Uncertain),
    };
    let t = N::value(&root)?;
    let normal = placement.normal(surface.normal(&ray.at(&t), root.feature));
    Ok((N::round(&root)?, N::proportions(&normal)?))
}
