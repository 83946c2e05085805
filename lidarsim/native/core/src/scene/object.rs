//! Objects: geometries placed by affine maps.

use std::borrow::Cow;
use std::ops::Deref;
use std::sync::Arc;

use super::{Disks, RootId, Spheres, TimedRay, TriangleMesh};
use crate::arith::number::{self, Interval, Number, Predicate, Uncertain};
use crate::arith::root::Root;
use crate::arith::simd::Isa;
use crate::geometry::affine::{Affine, ComposedPlacement, Inverse, Placement};
use crate::geometry::dop::Dop;
use crate::geometry::pose::Path;
use crate::geometry::ray::{Bounds, Ray};
use crate::geometry::vector::Point;
use crate::shapes::{AnySurface, Roots, Surface, Triangle};

/// The geometry of an object in its local coordinates.
#[derive(Clone, Debug)]
pub enum Geometry {
    Surface(AnySurface),
    Mesh(Arc<TriangleMesh>),
    Spheres(Arc<Spheres>),
    Disks(Arc<Disks>),
}

/// Evaluates an expression with a primitive of a geometry, a shape of any type.
macro_rules! with_shape {
    ($geometry:expr, $primitive:expr, $shape:ident => $value:expr) => {
        match $geometry {
            Geometry::Surface($shape) => $value,
            Geometry::Mesh(mesh) => {
                let $shape = &mesh.triangle($primitive);
                $value
            }
            Geometry::Spheres(spheres) => {
                let $shape = &spheres.shape($primitive);
                $value
            }
            Geometry::Disks(disks) => {
                let $shape = &disks.shape($primitive);
                $value
            }
        }
    };
}

pub(super) use with_shape;

/// A geometry, the maps that take it into the world, in order of application, and its motion after them.
#[derive(Clone, Debug)]
pub struct Object {
    pub geometry: Geometry,
    maps: Vec<Affine>,
    /// The inverse of all maps together; `None` if there are no maps.
    inverse: Option<Arc<Inverse>>,
    motion: Option<Arc<Path>>,
    /// Whether the triangles of a mesh are parts of one primitive, as those of a polygon are.
    whole: bool,
}

impl Object {
    pub fn new(geometry: Geometry, whole: bool) -> Self {
        Object { geometry, maps: Vec::new(), inverse: None, motion: None, whole }
    }

    /// The object under one more map; `None` if that cannot be inverted.
    pub fn transformed(&self, map: Affine) -> Option<Self> {
        let mut object = self.clone();
        if !map.is_identity() {
            object.inverse = Some(Arc::new(Inverse::of(&map, object.inverse)?));
            object.maps.push(map);
        }
        Some(object)
    }

    /// The object with a motion after its maps.
    #[must_use]
    pub fn moving(&self, motion: Arc<Path>) -> Self {
        Object { motion: Some(motion), ..self.clone() }
    }

    #[inline(always)]
    pub fn motion(&self) -> Option<&Path> {
        self.motion.as_deref()
    }

    /// The object at its place at a time.
    #[inline(always)]
    pub fn at(&self, time: f64) -> ObjectAt<'_> {
        ObjectAt { object: self, then: self.motion().map(|motion| motion.at(time).into()) }
    }

    #[inline(always)]
    pub fn is_untransformed(&self) -> bool {
        self.maps.is_empty() && self.motion.is_none()
    }

    /// Whether both have the same placement in the world at any time.
    pub fn is_placed_as(&self, other: &Self) -> bool {
        let alike = match (&self.motion, &other.motion) {
            (None, None) => true,
            (Some(motion), Some(other)) => Arc::ptr_eq(motion, other),
            _ => false,
        };
        alike && self.maps == other.maps
    }

    pub fn maps(&self) -> &[Affine] {
        &self.maps
    }

    /// Whether hits are on triangles.
    #[inline(always)]
    pub fn is_triangle(&self) -> bool {
        matches!(&self.geometry, Geometry::Mesh(_) | Geometry::Surface(AnySurface::Triangle(_)))
    }

    /// Whether hits are on triangles in world coordinates.
    #[inline(always)]
    pub fn is_untransformed_triangle(&self) -> bool {
        self.is_untransformed() && self.is_triangle()
    }

    /// Whether hits are on transformed triangles that do not move, under maps that are not extreme.
    #[inline(always)]
    pub fn is_placed_triangle(&self) -> bool {
        let is_placed = self.motion.is_none()
            && self.inverse.as_ref().is_some_and(|inverse| inverse.expanded().is_some());
        is_placed && self.is_triangle()
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

    /// The corners of `triangle`, by reference.
    #[inline(always)]
    pub fn corners(&self, primitive: u32) -> [&Point; 3] {
        const NONE: &Point = &[0.0; 3];
        match &self.geometry {
            Geometry::Mesh(mesh) => mesh.corners(primitive),
            Geometry::Surface(AnySurface::Triangle(Triangle(a, b, c))) => [a, b, c],
            _ => [NONE; 3],
        }
    }

    /// Prefetches the vertex indices of a triangle.
    #[inline(always)]
    pub fn prefetch_face<I: Isa>(&self, primitive: u32) {
        if let Geometry::Mesh(mesh) = &self.geometry {
            mesh.prefetch_face::<I>(primitive);
        }
    }

    /// Whether all triangles are parts of one primitive.
    pub fn is_whole(&self) -> bool {
        self.whole
    }

    /// The primitive id that hits report.
    #[inline(always)]
    pub fn primitive_id(&self, primitive: u32) -> i32 {
        if self.whole { 0 } else { primitive as i32 }
    }

    /// The inverse of the maps; `None` if there are no maps.
    #[inline(always)]
    pub fn inverse(&self) -> Option<&Inverse> {
        self.inverse.as_deref()
    }

    /// A box around all places of the object between two times.
    pub(super) fn bounds_during(&self, span: [f64; 2]) -> Option<[Interval; 3]> {
        match self.motion() {
            Some(motion) => Some(unless_nan(motion.sweep(&*self.dop_after(&self.maps)?, span))),
            None => self.bounds(),
        }
    }

    /// A box around the object without its motion; `None` if the object is empty or unbounded.
    pub fn bounds(&self) -> Option<[Interval; 3]> {
        match (self.maps.split_last(), &self.geometry) {
            (Some((last, others)), _) => Some(unless_nan(self.dop_after(others)?.image(last))),
            (None, Geometry::Surface(shape)) => shape.bounds(),
            (None, Geometry::Mesh(mesh)) => mesh.bounds(),
            (None, Geometry::Spheres(spheres)) => spheres.bounds(),
            (None, Geometry::Disks(disks)) => disks.bounds(),
        }
    }

    /// The extent of the object under the given first maps.
    fn dop_after(&self, maps: &[Affine]) -> Option<Cow<'_, Dop>> {
        let local = match &self.geometry {
            Geometry::Surface(shape) => Cow::Owned(Dop::of_box(shape.bounds()?)),
            Geometry::Mesh(mesh) => Cow::Borrowed(mesh.dop()?),
            Geometry::Spheres(spheres) => Cow::Owned(Dop::of_box(spheres.bounds()?)),
            Geometry::Disks(disks) => Cow::Owned(Dop::of_box(disks.bounds()?)),
        };
        Some(maps.iter().fold(local, |dop, map| Cow::Owned(Dop::of_box(dop.image(map)))))
    }

    /// Whether it has no primitives.
    pub fn is_empty(&self) -> bool {
        match &self.geometry {
            Geometry::Surface(_) => false,
            Geometry::Mesh(mesh) => mesh.is_empty(),
            Geometry::Spheres(spheres) => spheres.is_empty(),
            Geometry::Disks(disks) => disks.is_empty(),
        }
    }

    pub(super) fn roots<N: Number>(&self, primitive: u32, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        with_shape!(&self.geometry, primitive, shape => shape.roots(ray))
    }

    pub(super) fn root<N: Number>(&self, at: &RootId, ray: &Ray<N>) -> Result<Root<N>, Uncertain> {
        with_shape!(&self.geometry, at.primitive, shape => shape.root(ray, at.index))
    }
}

/// Replaces NaN bounds by infinite ones.
fn unless_nan(bounds: [Interval; 3]) -> [Interval; 3] {
    bounds.map(|b| Interval {
        low: if b.low.is_nan() { f64::NEG_INFINITY } else { b.low },
        high: if b.high.is_nan() { f64::INFINITY } else { b.high },
    })
}

/// An object at its place at a time. The affine map of a moving object follows exactly from the float64 pose
/// of its motion at that time.
#[derive(Clone, Copy)]
pub struct ObjectAt<'a> {
    object: &'a Object,
    then: Option<Affine>,
}

impl<'a> Deref for ObjectAt<'a> {
    type Target = &'a Object;

    #[inline(always)]
    fn deref(&self) -> &&'a Object {
        &self.object
    }
}

impl ObjectAt<'_> {
    /// The map to local coordinates.
    #[inline(always)]
    pub fn placement(&self) -> ComposedPlacement<'_> {
        ComposedPlacement { first: self.object.inverse(), then: self.then.as_ref() }
    }

    /// A world ray in the coordinates of the object.
    #[inline(always)]
    pub fn local<N: Number>(&self, ray: Ray<N>) -> Ray<N> {
        self.placement().local(ray)
    }

    /// As `local`, of a ray as given.
    #[inline(always)]
    pub fn local_ray<N: Number>(&self, ray: &TimedRay) -> Ray<N> {
        self.local(Ray::new(ray.origin, ray.direction))
    }

    /// Bounds of the ray in the coordinates of the object.
    pub fn enclose(&self, origin: Point, direction: Point) -> [Bounds<f64>; 2] {
        if self.is_untransformed() {
            return [origin.map(Interval::point), direction.map(Interval::point)];
        }
        number::decide(&EnclosedRay { object: self, origin, direction })
    }
}

/// Bounds of the ray in the coordinates of an object.
struct EnclosedRay<'a> {
    object: &'a ObjectAt<'a>,
    origin: Point,
    direction: Point,
}

impl Predicate for EnclosedRay<'_> {
    type Answer = [Bounds<f64>; 2];

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        self.object.local::<N>(Ray::new(self.origin, self.direction)).enclose()
    }
}
