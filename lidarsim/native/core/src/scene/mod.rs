//! The scene: objects, and the exact predicates and refined hits of rays on them.

mod coincidence;
mod hit;
mod object;
mod predicates;
mod primitives;
mod rays;
mod root_id;
mod triangle_mesh;
mod world;

use std::cmp::Ordering;

use arc_swap::ArcSwapOption;

use crate::arith::number::{self, Dyadic, Interval, Number, One, Uncertain};
use crate::bvh::{Bvh, Stack, TraversalRay};
use crate::geometry::affine::Placement;
use crate::geometry::vector::{self, Point};
use crate::once::Once;
use crate::shapes::newton;
use crate::shapes::triangle::Leaf;
use crate::{memory, parallel};

use object::with_shape;
use predicates::{NegativeRoot, RefinedHit, RootOn, RootOrder, RoundedRoot, meets_what_they_share};

pub use hit::{EightHits, Hit, HitRun, Sink};
pub use object::{Geometry, Object, ObjectAt};
pub use predicates::{BoundedRoot, RootIntervals};
pub use primitives::{Disks, PrimitiveLeaf, Primitives, Spheres};
pub use rays::{Rays, TRange, TimedRay};
pub use root_id::RootId;
pub use triangle_mesh::TriangleMesh;
use world::Movers;
pub use world::{World, span};

#[derive(Debug)]
pub struct Scene {
    objects: Vec<Object>,
    /// The moving objects, in ascending order.
    movers: Vec<u32>,
    index: Once<Index>,
    /// The hierarchy of moving objects of the last cast.
    last_movers: ArcSwapOption<Movers>,
}

#[derive(Clone, Debug)]
pub struct Index {
    /// Unbounded objects, which are tested with every ray.
    pub unbounded: Vec<u32>,
    /// The hierarchy of the objects that stand still.
    pub bounded: Bvh<u32>,
    size: f64,
    /// The surface area of `bounded` when it was built.
    surface: f32,
}

impl Index {
    /// `still`: per object its box, if it has one, stands still and is of this index.
    fn new(unbounded: Vec<u32>, still: &[Option<[Interval; 3]>]) -> Self {
        let bounded = Bvh::new(still.len(), |id| still[id as usize], 1, |ids| ids[0]);
        Index { unbounded, size: size(still), surface: bounded.surface(), bounded }
    }
}

/// A refitted hierarchy is discarded if its surface area exceeds that of its build by this factor.
const WORN: f32 = 1.5;

impl Scene {
    pub fn new(objects: Vec<Object>) -> Self {
        let moves = |id: &u32| objects[*id as usize].motion().is_some();
        let movers = (0..objects.len() as u32).filter(moves).collect();
        Scene { objects, movers, index: Once::new(), last_movers: ArcSwapOption::empty() }
    }

    /// As `new`. If the objects differ only in their places, the hierarchy of the other scene is refitted to
    /// them while it stays about as good, which is much faster than a build.
    pub fn like(other: &Scene, objects: Vec<Object>) -> Self {
        let scene = Scene::new(objects);
        scene.last_movers.store(other.last_movers.load_full());
        if let Some(index) = other.index.get()
            && let Some(index) = scene.refitted(index)
        {
            scene.index.get_or_make(|| index);
        }
        scene
    }

    /// Whether any object moves, so that rays need times.
    pub fn moves(&self) -> bool {
        !self.movers.is_empty()
    }

    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Builds the hierarchies that do not exist yet.
    pub fn prepare(&self) {
        for object in &self.objects {
            if let Geometry::Mesh(mesh) = &object.geometry {
                mesh.hierarchy();
            }
        }
        self.index();
    }

    fn index(&self) -> &Index {
        self.index.get_or_make(|| {
            let (unbounded, still) = self.partition();
            Index::new(unbounded, &still)
        })
    }

    /// An index of some of the objects: those that `is_in` tells.
    pub fn index_of(&self, is_in: &dyn Fn(u32) -> bool) -> Index {
        let (mut unbounded, mut still) = self.partition();
        unbounded.retain(|&id| is_in(id));
        for (id, bounds) in (0..).zip(&mut still) {
            *bounds = bounds.filter(|_| is_in(id));
        }
        Index::new(unbounded, &still)
    }

    /// The unbounded objects; and per object its box, if it has one and stands still.
    fn partition(&self) -> (Vec<u32>, Vec<Option<[Interval; 3]>>) {
        let mut still = memory::collect(self.objects.iter().map(Object::bounds));
        let endless = |&i: &usize| still[i].is_none() && !self.objects[i].is_empty();
        let mut unbounded = Vec::new();
        for i in (0..still.len()).filter(endless) {
            memory::push(&mut unbounded, i as u32);
        }
        for &id in &self.movers {
            still[id as usize] = None;
        }
        (unbounded, still)
    }

    /// An index of another scene, refitted to these objects. `None` if the objects differ or it is worn out.
    fn refitted(&self, index: &Index) -> Option<Index> {
        let (unbounded, still) = self.partition();
        let boxes = still.iter().flatten().count();
        let bounded = index.bounded.refitted(boxes, |&id| still.get(id as usize).copied().flatten())?;
        let is_good = bounded.surface() <= WORN * index.surface;
        is_good.then(|| Index { unbounded, bounded, size: size(&still), surface: index.surface })
    }

    /// An object at its place at a time.
    #[inline(always)]
    pub fn at(&self, object: u32, time: f64) -> ObjectAt<'_> {
        self.objects[object as usize].at(time)
    }

    /// Every t, ascending and distinct, at which the line intersects the object, which must not move.
    pub fn roots(&self, object: u32, origin: Point, direction: Point) -> Vec<f64> {
        let ray = TimedRay { origin, direction, time: 0.0 };
        let primitives = self.primitives_on_line(object, origin, direction);
        let mut roots: Vec<RootId> = Vec::new();
        for primitive in primitives {
            let found = number::decide(&self.root_intervals(object, primitive, &ray));
            roots.extend(found.into_iter().flatten().map(|(at, _)| at));
        }
        let order = |a: &RootId, b: &RootId| self.compare(a, b, &ray);
        roots.sort_by(order);
        roots.dedup_by(|a, b| order(a, b) == Ordering::Equal);
        roots.iter().map(|at| self.t(at, &ray)).collect()
    }

    /// The `roots` of each of several lines.
    pub fn roots_of_lines(&self, object: u32, origins: &[Point], directions: &[Point]) -> Vec<Vec<f64>> {
        const PIECE: usize = 64;
        let mut roots = memory::with_capacity(origins.len());
        roots.resize_with(origins.len(), Vec::new);
        let lines = origins.chunks(PIECE).zip(directions.chunks(PIECE));
        parallel::share(roots.chunks_mut(PIECE).zip(lines), |(roots, (origins, directions))| {
            for (roots, (o, d)) in roots.iter_mut().zip(origins.iter().zip(directions)) {
                *roots = self.roots(object, *o, *d);
            }
        });
        roots
    }

    fn primitives_on_line(&self, object: u32, origin: Point, direction: Point) -> Vec<u32> {
        let object = self.at(object, 0.0);
        let mut found = match &object.geometry {
            Geometry::Surface(_) => return vec![0],
            Geometry::Mesh(mesh) => on_line(&object, mesh.hierarchy(), Leaf::ids, origin, direction),
            Geometry::Spheres(spheres) => {
                on_line(&object, spheres.hierarchy(), PrimitiveLeaf::ids, origin, direction)
            }
            Geometry::Disks(disks) => {
                on_line(&object, disks.hierarchy(), PrimitiveLeaf::ids, origin, direction)
            }
        };
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The predicate of the roots of a ray on a primitive of an object.
    pub fn root_intervals(&self, object: u32, primitive: u32, ray: &TimedRay) -> RootIntervals<'_> {
        RootIntervals { object: self.at(object, ray.time), id: object, primitive, ray: *ray }
    }

    fn root_on<'a>(&'a self, at: &'a RootId, ray: &'a TimedRay) -> RootOn<'a> {
        RootOn { object: self.at(at.object, ray.time), at, ray }
    }

    /// The order of two roots on a line, at a time.
    pub fn compare(&self, a: &RootId, b: &RootId, ray: &TimedRay) -> Ordering {
        let object = |at: &RootId| &self.objects[at.object as usize];
        if let Some(order) = coincidence::order(object(a), a, object(b), b) {
            return order;
        }
        let roots = [self.root_on(a, ray), self.root_on(b, ray)];
        let [x, y] = roots.map(|root| root.object);
        if x.is_triangle() && y.is_triangle() && x.is_placed_as(&y) {
            let local = x.local_ray::<Dyadic>(ray);
            if meets_what_they_share(&local, &x.triangle(a.primitive), &y.triangle(b.primitive)) == Ok(true) {
                return Ordering::Equal;
            }
        }
        number::decide(&RootOrder(roots))
    }

    /// t, correctly rounded.
    pub fn t(&self, at: &RootId, ray: &TimedRay) -> f64 {
        number::decide_exactly(&RoundedRoot(self.root_on(at, ray)))
    }

    /// Whether t is below zero, even by less than float64 resolves.
    pub fn is_negative(&self, at: &RootId, ray: &TimedRay) -> bool {
        number::decide(&NegativeRoot(self.root_on(at, ray)))
    }

    pub fn hit(&self, at: &RootId, ray: &TimedRay) -> Hit {
        self.hit_of(at, number::decide_exactly(&RefinedHit(self.root_on(at, ray))))
    }

    /// As `hit`, with bounds of t.
    pub fn hit_within(&self, at: &RootId, bounds: Interval, timed: &TimedRay) -> Hit {
        let object = self.at(at.object, timed.time);
        let (placement, ray) = (object.placement(), object.local_ray(timed));
        let step = with_shape!(
            &object.geometry,
            at.primitive,
            shape => newton::newton_step(&ray, shape, at.feature, bounds, One)
        );
        let found = step.and_then(|(t, normal)| Ok((t, Number::proportions(&placement.normal(normal))?)));
        match found {
            Ok(found) => self.hit_of(at, found),
            Err(Uncertain) => self.hit(at, timed),
        }
    }

    fn hit_of(&self, at: &RootId, (t, normal): (f64, Point)) -> Hit {
        let primitive = self.objects[at.object as usize].primitive_id(at.primitive);
        Hit { t, normal: vector::unit(normal), object: at.object as i32, primitive }
    }
}

/// The longest side of the union of the boxes.
fn size(bounds: &[Option<[Interval; 3]>]) -> f64 {
    let side = |i: usize| {
        let all = bounds.iter().flatten().map(|b| b[i]);
        all.clone().fold(f64::NEG_INFINITY, |m, b| m.max(b.high))
            - all.fold(f64::INFINITY, |m, b| m.min(b.low))
    };
    side(0).max(side(1)).max(side(2))
}

/// The primitives of a hierarchy whose boxes a line may enter, in any order and some of them twice.
fn on_line<L>(
    object: &ObjectAt,
    hierarchy: &Bvh<L>,
    ids: impl Fn(&L) -> &[u32],
    origin: Point,
    direction: Point,
) -> Vec<u32> {
    let (mut found, mut stack) = (Vec::new(), Stack::new());
    for direction in [direction, direction.map(|x| -x)] {
        let [o, d] = object.enclose(origin, direction);
        let mut ray = TraversalRay::new(o, d, hierarchy.center(), 0.0, f64::INFINITY);
        hierarchy.traverse(&mut ray, &mut stack, |_, leaf| {
            found.extend_from_slice(ids(leaf));
            f64::INFINITY
        });
    }
    found
}

#[cfg(test)]
pub mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::shapes::{Plane, Sphere, Triangle};

    pub const FLAT: Triangle = Triangle([0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]);

    /// The same triangle, with another last vertex.
    pub fn tipped(z: f64) -> Triangle {
        Triangle(FLAT.0, FLAT.1, [0.0, 8.0, z])
    }

    /// A triangle alone, or as the last primitive after others that no ray hits.
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

    /// Spheres of one `size` on a grid, with one of them at `place`.
    fn balls(size: f64, place: Point) -> Vec<Object> {
        let ball = |center| Object::new(Geometry::Surface(Sphere { center, radius: size }.into()), false);
        let grid = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(f64::from));
        grid.enumerate().map(|(i, center)| ball(if i == 555 { place } else { center })).collect()
    }

    #[test]
    fn a_hierarchy_is_refitted_while_that_serves() {
        let scene = Scene::new(balls(0.25, [5.0; 3]));
        scene.prepare();
        let near = Scene::like(&scene, balls(0.25, [5.5, 5.0, 4.75]));
        let far = Scene::like(&scene, balls(0.25, [50.0, 50.0, 50.0]));
        let mut fewer = balls(0.25, [5.0; 3]);
        fewer.pop();
        let mut endless = balls(0.25, [5.0; 3]);
        endless[0] = Object::new(
            Geometry::Surface(Plane::Distance { normal: [0.0, 0.0, 1.0], distance: 0.0 }.into()),
            false,
        );
        let (fewer, endless) = (Scene::like(&scene, fewer), Scene::like(&scene, endless));
        let refitted = [&near, &far, &fewer, &endless].map(|scene| scene.index.get().is_some());
        assert_eq!(refitted, [true, false, false, false]);
    }
}
