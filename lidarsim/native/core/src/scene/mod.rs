//! The scene: objects, and the exact predicates and refined hits of rays on them.

mod hit;
mod root_id;
mod triangle_mesh;

use std::cmp::Ordering;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use crate::arith::number::{self, Interval, Number, One, Predicate, Uncertain};
use crate::arith::root::{Root, Roots};
use crate::arith::simd::Isa;
use crate::bvh::{Bvh, Stack, TraversalRay};
use crate::geometry::affine::{Affine, Inverse, Placement};
use crate::geometry::ray::{Bounds, Ray};
use crate::geometry::vector::{self, Point};
use crate::parallel;
use crate::shapes::newton::{self, RootBracket};
use crate::shapes::{AnySurface, Surface, Triangle};

pub use hit::{Hit, Sink};
pub use root_id::RootId;
pub use triangle_mesh::TriangleMesh;

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

    /// The object moved by one more map; none if that cannot be inverted.
    pub fn moved(&self, map: Affine) -> Option<Self> {
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

    /// Whether hits are on triangles in the coordinates of the world.
    #[inline(always)]
    pub fn is_untransformed_triangle(&self) -> bool {
        self.maps.is_empty() && matches!(&self.geometry, Geometry::Mesh(_) | Geometry::Surface(AnySurface::Triangle(_)))
    }

    #[inline(always)]
    pub fn is_surface(&self) -> bool {
        matches!(self.geometry, Geometry::Surface(_))
    }

    /// A triangle of an object that is one or has some.
    #[inline(always)]
    pub fn triangle(&self, primitive: u32) -> Triangle {
        let [a, b, c] = self.corners(primitive);
        Triangle(*a, *b, *c)
    }

    /// As `triangle`, where the corners are kept.
    #[inline(always)]
    pub fn corners(&self, primitive: u32) -> [&Point; 3] {
        const NONE: &Point = &[0.0; 3];
        match &self.geometry {
            Geometry::Mesh(mesh) => mesh.corners(primitive),
            Geometry::Surface(AnySurface::Triangle(Triangle(a, b, c))) => [a, b, c],
            Geometry::Surface(_) => [NONE; 3],
        }
    }

    /// Brings what names the corners of a triangle into the cache.
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
    fn local<N: Number>(&self, ray: Ray<N>) -> Ray<N> {
        self.placement().local(ray)
    }

    /// Where the object stands; none if it was not moved.
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

    fn bounds(&self) -> Option<[Interval; 3]> {
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

    fn is_empty(&self) -> bool {
        matches!(&self.geometry, Geometry::Mesh(mesh) if mesh.is_empty())
    }

    #[inline]
    fn roots<N: Number>(&self, primitive: u32, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        match &self.geometry {
            Geometry::Surface(shape) => shape.roots(ray),
            Geometry::Mesh(mesh) => mesh.triangle(primitive).roots(ray),
        }
    }

    fn root<N: Number>(&self, at: &RootId, ray: &Ray<N>) -> Result<Root<N>, Uncertain> {
        let [first, second] = self.roots(at.primitive, ray)?;
        (if at.index == 0 { first } else { second }).ok_or(Uncertain)
    }
}

#[derive(Clone, Debug, Default)]
pub struct Scene {
    objects: Vec<Object>,
    index: OnceLock<Index>,
}

#[derive(Clone, Debug)]
pub struct Index {
    /// Unbounded objects, which are tested with every ray.
    pub unbounded: Vec<u32>,
    pub bounded: Bvh<u32>,
    size: f64,
}

impl Scene {
    pub fn new(objects: Vec<Object>) -> Self {
        Scene { objects, index: OnceLock::new() }
    }

    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Builds the hierarchies that are not there yet.
    pub fn prepare(&self) {
        for object in &self.objects {
            if let Geometry::Mesh(mesh) = &object.geometry {
                mesh.hierarchy();
            }
        }
        self.index();
    }

    /// The longest side of the box around all bounded objects.
    pub fn size(&self) -> f64 {
        self.index().size
    }

    pub fn index(&self) -> &Index {
        self.index.get_or_init(|| {
            let bounds: Vec<_> = self.objects.iter().map(Object::bounds).collect();
            let endless = |&i: &usize| bounds[i].is_none() && !self.objects[i].is_empty();
            let unbounded = (0..bounds.len()).filter(endless).map(|i| i as u32).collect();
            let side = |i: usize| {
                let all = bounds.iter().flatten().map(|b| b[i]);
                all.clone().fold(f64::NEG_INFINITY, |m, b| m.max(b.high)) - all.fold(f64::INFINITY, |m, b| m.min(b.low))
            };
            let size = side(0).max(side(1)).max(side(2));
            let bounded = parallel::run(|| Bvh::new(bounds.len(), |id| bounds[id as usize], 1, |ids| ids[0]));
            Index { unbounded, bounded, size }
        })
    }

    /// Every t, ascending and distinct, at which the line intersects the object.
    pub fn roots(&self, object: u32, origin: Point, direction: Point) -> Vec<f64> {
        let primitives = self.primitives_on_line(object, origin, direction);
        let mut places: Vec<RootId> = Vec::new();
        for primitive in primitives {
            let found =
                number::decide(&RootIntervals { object: &self.objects[object as usize], primitive, origin, direction });
            for (index, &(_, feature)) in (0..).zip(found.iter().flatten()) {
                places.push(RootId { object, primitive, index, feature });
            }
        }
        let order = |a: &RootId, b: &RootId| self.compare(a, b, origin, direction);
        places.sort_by(order);
        places.dedup_by(|a, b| order(a, b) == Ordering::Equal);
        places.iter().map(|at| self.t(at, origin, direction)).collect()
    }

    /// As `roots`, of each of some lines.
    pub fn roots_of_lines(&self, object: u32, origins: &[Point], directions: &[Point]) -> Vec<Vec<f64>> {
        let lines = origins.par_iter().zip(directions);
        parallel::run(|| lines.map(|(o, d)| self.roots(object, *o, *d)).collect())
    }

    fn primitives_on_line(&self, object: u32, origin: Point, direction: Point) -> Vec<u32> {
        let object = &self.objects[object as usize];
        let Geometry::Mesh(mesh) = &object.geometry else { return vec![0] };
        let mut found = Vec::new();
        let mut stack = Stack::new();
        for direction in [direction, direction.map(|x| -x)] {
            let [o, d] = object.enclose(origin, direction);
            let hierarchy = mesh.hierarchy();
            let mut ray = TraversalRay::new(o, d, hierarchy.center(), 0.0, f64::INFINITY);
            hierarchy.traverse(&mut ray, &mut stack, |_, block| {
                found.extend_from_slice(block.ids());
                f64::INFINITY
            });
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Which of two roots on a line comes first.
    pub fn compare(&self, a: &RootId, b: &RootId, origin: Point, direction: Point) -> Ordering {
        // Objects stand on floors, so coplanar triangles are common, and their ties would all go to exact arithmetic.
        if self.share_axis_plane(a, b) {
            return Ordering::Equal;
        }
        number::decide(&RootOrder { scene: self, a, b, origin, direction })
    }

    /// Whether both are triangles in one plane perpendicular to an axis.
    fn share_axis_plane(&self, a: &RootId, b: &RootId) -> bool {
        let object = |at: &RootId| &self.objects[at.object as usize];
        let are_triangles = object(a).is_untransformed_triangle() && object(b).is_untransformed_triangle();
        are_triangles && object(a).triangle(a.primitive).shares_axis_plane(&object(b).triangle(b.primitive))
    }

    /// t, correctly rounded.
    pub fn t(&self, at: &RootId, origin: Point, direction: Point) -> f64 {
        number::decide_exactly(&RoundedRoot { object: &self.objects[at.object as usize], at, origin, direction })
    }

    pub fn hit(&self, at: &RootId, origin: Point, direction: Point) -> Hit {
        let object = &self.objects[at.object as usize];
        let found = number::decide_exactly(&RefinedHit { object, at, origin, direction });
        self.hit_of(at, found)
    }

    /// As `hit`, with bounds of t.
    pub fn hit_within(&self, at: &RootId, bounds: Interval, origin: Point, direction: Point) -> Hit {
        let object = &self.objects[at.object as usize];
        let bracket = RootBracket { feature: at.feature, origin, direction, bounds };
        let found = match &object.geometry {
            Geometry::Surface(shape) => newton::newton_step(object.placement(), shape, &bracket, One),
            Geometry::Mesh(mesh) => {
                newton::newton_step(object.placement(), &mesh.triangle(at.primitive), &bracket, One)
            }
        };
        match found {
            Ok(found) => self.hit_of(at, found),
            Err(Uncertain) => self.hit(at, origin, direction),
        }
    }

    fn hit_of(&self, at: &RootId, (t, normal): (f64, Point)) -> Hit {
        let primitive = self.objects[at.object as usize].reported(at.primitive);
        Hit { t, normal: vector::unit(normal), object: at.object as i32, primitive }
    }
}

/// Bounds of the roots of a primitive.
pub struct RootIntervals<'a> {
    pub object: &'a Object,
    pub primitive: u32,
    pub origin: Point,
    pub direction: Point,
}

impl Predicate for RootIntervals<'_> {
    /// Bounds of t, and the part of the surface.
    type Answer = [Option<(Interval, u8)>; 2];

    #[inline]
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

struct RootOrder<'a> {
    scene: &'a Scene,
    a: &'a RootId,
    b: &'a RootId,
    origin: Point,
    direction: Point,
}

impl Predicate for RootOrder<'_> {
    type Answer = Ordering;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Ordering, Uncertain> {
        let root = |at: &RootId| {
            let object = &self.scene.objects[at.object as usize];
            object.root::<N>(at, &object.local(Ray::new(self.origin, self.direction)))
        };
        N::compare(&root(self.a)?, &root(self.b)?)
    }
}

struct RoundedRoot<'a> {
    object: &'a Object,
    at: &'a RootId,
    origin: Point,
    direction: Point,
}

impl Predicate for RoundedRoot<'_> {
    type Answer = f64;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<f64, Uncertain> {
        N::round(&self.object.root::<N>(self.at, &self.object.local(Ray::new(self.origin, self.direction)))?)
    }
}

/// A hit: t, correctly rounded, and a normal of ordinary length.
struct RefinedHit<'a> {
    object: &'a Object,
    at: &'a RootId,
    origin: Point,
    direction: Point,
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

#[cfg(test)]
pub mod tests {
    use super::*;

    pub const LEVEL: Triangle = Triangle([0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]);

    /// The same triangle, but for its last vertex.
    pub fn tipped(z: f64) -> Triangle {
        Triangle(LEVEL.0, LEVEL.1, [0.0, 8.0, z])
    }

    /// A triangle of its own, or among others that no ray meets; the primitive is the last.
    pub fn object(triangle: Triangle, others: usize) -> Object {
        if others == 0 {
            return Object::new(Geometry::Surface(triangle.into()), false);
        }
        let Triangle(a, b, c) = triangle;
        let far = |i: usize| [[100.0 + i as f64, 0.0, 1.0], [101.0 + i as f64, 0.0, 1.0], [100.0, 1.0, 1.0]];
        let vertices: Vec<Point> = (0..others).flat_map(far).chain([a, b, c]).collect();
        let faces = (0..=others as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = TriangleMesh::new(vertices, faces).map(Arc::new);
        Object::new(mesh.map_or(Geometry::Surface(triangle.into()), Geometry::Mesh), false)
    }

    #[test]
    fn triangles_share_a_level_as_they_are_in_the_world() {
        for (z, others) in [(1.0, [0, 0]), (1.0, [0, 9]), (1.0_f64.next_up(), [0, 0]), (1.0_f64.next_down(), [20, 3])] {
            let scene = Scene::new(vec![object(LEVEL, others[0]), object(tipped(z), others[1])]);
            let [a, b] = [0, 1].map(|i: usize| RootId::of_triangle(i as u32, others[i] as u32));
            assert_eq!([scene.share_axis_plane(&a, &b), scene.share_axis_plane(&b, &a)], [z == 1.0; 2]);
        }
        // Where an object was moved, its vertices are not those of the world.
        let level = object(LEVEL, 0);
        let moved = level.moved(Affine::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 1.0]));
        let scene = Scene::new(moved.into_iter().chain([level]).collect());
        assert_eq!(scene.objects().len(), 2);
        assert!(!scene.share_axis_plane(&RootId::of_triangle(0, 0), &RootId::of_triangle(1, 0)));
    }
}
