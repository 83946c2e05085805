//! Objects: a geometry, placed by affine maps.

use std::sync::Arc;

use super::{RootId, TriangleMesh};
use crate::arith::number::{self, Interval, Number, Predicate, Uncertain};
use crate::arith::root::{Root, Roots};
use crate::arith::simd::Isa;
use crate::geometry::affine::{Affine, Inverse, Placement};
use crate::geometry::ray::{Bounds, Ray};
use crate::geometry::vector::Point;
use crate::shapes::{AnySurface, Surface, Triangle};

/// The geometry of an object in its local coordinates.
#[derive(Clone, Debug)]
pub enum Geometry {
    Surface(AnySurface),
    Mesh(Arc<TriangleMesh>),
}

/// A geometry and the maps that take it into the world, the first one first.
#[derive(Clone, Debug)]
pub struct Object {
    pub geometry: Geometry,
    maps: Vec<Affine>,
    /// Of all maps together; none if there are none.
    inverse: Option<Arc<Inverse>>,
    /// A mesh whose triangles are parts of one primitive, as those of a polygon are.
    whole: bool,
}

impl Object {
    pub fn new(geometry: Geometry, whole: bool) -> Self {
        Object { geometry, maps: Vec::new(), inverse: None, whole }
    }

    /// The object under one more map; none if that cannot be inverted.
    pub fn transformed(&self, map: Affine) -> Option<Self> {
        let mut object = self.clone();
        if !map.is_identity() {
            let inverse = Inverse::of(&map)?;
            object.maps.push(map);
            object.inverse = Some(Arc::new(match &self.inverse {
                None => inverse,
                Some(first) => inverse.after(first, &map),
            }));
        }
        Some(object)
    }

    #[inline(always)]
    pub fn is_untransformed(&self) -> bool {
        self.maps.is_empty()
    }

    /// Whether both are placed in the world alike.
    pub fn is_placed_as(&self, other: &Self) -> bool {
        self.maps == other.maps
    }

    pub fn maps(&self) -> &[Affine] {
        &self.maps
    }

    /// Whether hits are on triangles.
    #[inline(always)]
    pub fn is_triangle(&self) -> bool {
        matches!(&self.geometry, Geometry::Mesh(_) | Geometry::Surface(AnySurface::Triangle(_)))
    }

    /// Whether hits are on triangles in the coordinates of the world.
    #[inline(always)]
    pub fn is_untransformed_triangle(&self) -> bool {
        self.maps.is_empty() && self.is_triangle()
    }

    #[inline(always)]
    pub fn is_surface(&self) -> bool {
        matches!(self.geometry, Geometry::Surface(_))
    }

    /// A triangle of an object that is a triangle or a mesh.
    #[inline(always)]
    pub fn triangle(&self, primitive: u32) -> Triangle {
        let [a, b, c] = self.corners(primitive);
        Triangle(*a, *b, *c)
    }

    /// As `triangle`, by reference.
    #[inline(always)]
    pub fn corners(&self, primitive: u32) -> [&Point; 3] {
        const NONE: &Point = &[0.0; 3];
        match &self.geometry {
            Geometry::Mesh(mesh) => mesh.corners(primitive),
            Geometry::Surface(AnySurface::Triangle(Triangle(a, b, c))) => [a, b, c],
            Geometry::Surface(_) => [NONE; 3],
        }
    }

    /// Prefetches the vertex indices of a triangle.
    #[inline(always)]
    pub fn prefetch_face<I: Isa>(&self, primitive: u32) {
        if let Geometry::Mesh(mesh) = &self.geometry {
            mesh.prefetch_face::<I>(primitive);
        }
    }

    /// The primitive id that hits report.
    #[inline(always)]
    pub fn reported(&self, primitive: u32) -> i32 {
        if self.whole { 0 } else { primitive as i32 }
    }

    /// A ray of the world in the coordinates of the object.
    #[inline(always)]
    pub(super) fn local<N: Number>(&self, ray: Ray<N>) -> Ray<N> {
        self.placement().local(ray)
    }

    /// The map to local coordinates; none if the object is untransformed.
    #[inline(always)]
    pub fn placement(&self) -> Option<&Inverse> {
        self.inverse.as_deref()
    }

    /// Bounds of the ray in the coordinates of the object.
    pub fn enclose(&self, origin: Point, direction: Point) -> [Bounds<f64>; 2] {
        if self.maps.is_empty() {
            return [origin.map(Interval::point), direction.map(Interval::point)];
        }
        number::decide(&EnclosedRay { object: self, origin, direction })
    }

    pub(super) fn bounds(&self) -> Option<[Interval; 3]> {
        let local = match &self.geometry {
            Geometry::Surface(shape) => shape.bounds()?,
            Geometry::Mesh(mesh) => mesh.bounds()?,
        };
        let bounds = self.maps.iter().fold(local, |bounds, map| map.image(bounds));
        Some(bounds.map(|b| Interval {
            low: if b.low.is_nan() { f64::NEG_INFINITY } else { b.low },
            high: if b.high.is_nan() { f64::INFINITY } else { b.high },
        }))
    }

    pub(super) fn is_empty(&self) -> bool {
        matches!(&self.geometry, Geometry::Mesh(mesh) if mesh.is_empty())
    }

    #[inline]
    pub(super) fn roots<N: Number>(&self, primitive: u32, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        match &self.geometry {
            Geometry::Surface(shape) => shape.roots(ray),
            Geometry::Mesh(mesh) => mesh.triangle(primitive).roots(ray),
        }
    }

    pub(super) fn root<N: Number>(&self, at: &RootId, ray: &Ray<N>) -> Result<Root<N>, Uncertain> {
        let [first, second] = self.roots(at.primitive, ray)?;
        (if at.index == 0 { first } else { second }).ok_or(Uncertain)
    }
}

/// Bounds of the ray in the coordinates of an object.
struct EnclosedRay<'a> {
    object: &'a Object,
    origin: Point,
    direction: Point,
}

impl Predicate for EnclosedRay<'_> {
    type Answer = [Bounds<f64>; 2];

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        self.object.local::<N>(Ray::new(self.origin, self.direction)).enclose()
    }
}
