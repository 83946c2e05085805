//! The next hit of light that goes on: behind a surface that it passes, or from a mirror.

use std::cmp::Ordering;

use crate::arith::number::{self, Dyadic, Number};
use crate::bvh::Stack;
use crate::cast::all_hits::{order, order_of_t, roots_in_range};
use crate::cast::ray_query::RayQuery;
use crate::geometry::vector;
use crate::scene::{BoundedRoot, Geometry, Hit, ObjectAt, RootId, Scene, TRange, TimedRay, World};
use crate::shapes::Triangle;
use crate::shapes::triangle::volume;

/// All t that a hit may have.
const ALL: TRange = TRange { min: 0.0, max: f64::MAX };

/// A surface from which light goes on.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceHit {
    pub hit: Hit,
    /// The root of the hit, if it is known. Most decisions need only bounds of t.
    root: Option<BoundedRoot>,
}

impl From<Hit> for SurfaceHit {
    fn from(hit: Hit) -> Self {
        SurfaceHit { hit, root: None }
    }
}

impl SurfaceHit {
    fn is_on(&self, object: u32) -> bool {
        self.hit.object as u32 == object
    }

    /// The order of the exact t of this and of another root of its ray.
    fn order_of_t(&self, scene: &Scene, ray: &TimedRay, at: &BoundedRoot) -> Ordering {
        // The exact t rounds to that of the hit.
        let (low, high) = (self.hit.t.next_down(), self.hit.t.next_up());
        if high < at.1.low {
            Ordering::Less
        } else if at.1.high < low {
            Ordering::Greater
        } else {
            let root = self.root.or_else(|| root_of(scene, &self.hit, ray));
            root.map_or(Ordering::Equal, |root| order_of_t(scene, ray, &root, at))
        }
    }
}

/// Where the light of a ray comes from.
#[derive(Clone, Copy, Debug)]
pub enum Departure {
    /// From a surface that the same ray met, straight on.
    Passed(SurfaceHit),
    /// From a mirror, which the ray before met where this one starts.
    Mirrored(TimedRay, SurfaceHit),
}

impl Departure {
    fn met(&self) -> &SurfaceHit {
        match self {
            Departure::Passed(met) | Departure::Mirrored(_, met) => met,
        }
    }

    /// Whether a root of `ray` with t ≥ 0 is further on.
    ///
    /// Behind a surface that is the order of the exact t, and of coincident surfaces that of their objects.
    /// An object that the ray meets at a common edge of several primitives is met once there, and a polygon
    /// is met once.
    ///
    /// From a mirror it is every root but those of the surfaces that the ray before met at the same exact t:
    /// the mirror itself, and whatever coincides with it there. The origin is that point, rounded, so the ray
    /// may meet them once more. Of each, the root nearest to the origin is left out; of flat ones, the whole
    /// surface: that is the mirror's polygon, or the triangles of its mesh in the same plane.
    fn is_before(&self, scene: &Scene, ray: &TimedRay, at: &BoundedRoot) -> bool {
        match self {
            Departure::Passed(met) => {
                let object = met.hit.object as u32;
                met.order_of_t(scene, ray, at).then_with(|| object.cmp(&at.0.object)) == Ordering::Less
            }
            Departure::Mirrored(before, mirror) => !is_left_out(scene, before, mirror, ray, &at.0),
        }
    }
}

/// Whether a root of a ray from a mirror is that of the mirror, or of a surface that coincides with it.
fn is_left_out(scene: &Scene, before: &TimedRay, mirror: &SurfaceHit, ray: &TimedRay, at: &RootId) -> bool {
    let mut is_mirror = false;
    if mirror.is_on(at.object) {
        let (object, primitive) = (scene.at(at.object, ray.time), mirror.hit.primitive as u32);
        is_mirror = at.primitive == primitive;
        if object.is_whole() || !is_mirror && are_coplanar(&object, at.primitive, primitive) {
            return true;
        }
    }
    (is_mirror || is_met(scene, before, mirror, at.object, at.primitive))
        && nearest_to_origin(scene, ray, at.object, at.primitive) == Some(at.index)
}

/// Whether a ray meets a primitive at the exact t at which it met a mirror.
fn is_met(scene: &Scene, ray: &TimedRay, mirror: &SurfaceHit, object: u32, primitive: u32) -> bool {
    let mut others = roots_of(scene, ray, object, primitive);
    others.any(|other| mirror.order_of_t(scene, ray, &other) == Ordering::Equal)
}

fn roots_of(
    scene: &Scene,
    ray: &TimedRay,
    object: u32,
    primitive: u32,
) -> impl Iterator<Item = BoundedRoot> + use<> {
    number::decide(&scene.root_intervals(object, primitive, ray)).into_iter().flatten()
}

/// The index of the root of a primitive whose rounded t is nearest to zero; of equal ones, the first.
fn nearest_to_origin(scene: &Scene, ray: &TimedRay, object: u32, primitive: u32) -> Option<u8> {
    let is_farther = |a: &BoundedRoot, b: &BoundedRoot| {
        let [a_is, b_is] = [a, b].map(|(_, t)| (t.low.max(-t.high), t.low.abs().max(t.high.abs())));
        if a_is.0 > b_is.1 || b_is.0 > a_is.1 {
            return a_is.0 > b_is.1;
        }
        scene.t(&a.0, ray).abs() > scene.t(&b.0, ray).abs()
    };
    let roots = roots_of(scene, ray, object, primitive);
    roots.reduce(|a, b| if is_farther(&a, &b) { b } else { a }).map(|root| root.0.index)
}

/// Whether two triangles of a mesh are in exactly one plane.
fn are_coplanar(object: &ObjectAt, one: u32, other: u32) -> bool {
    let Geometry::Mesh(_) = &object.geometry else { return false };
    let Triangle(a, b, c) = object.triangle(one);
    let [a, b, c] = [a, b, c].map(vector::exact::<Dyadic>);
    let Triangle(d, e, f) = object.triangle(other);
    [d, e, f].iter().all(|corner| {
        let d = vector::exact::<Dyadic>(*corner);
        let [p, q, r] = [&a, &b, &c].map(|corner| vector::sub(corner, &d));
        volume(&p, &q, &r).is_zero() == Ok(true)
    })
}

/// The nearest hit further on.
struct NextHit<'a> {
    scene: &'a Scene,
    ray: TimedRay,
    from: &'a Departure,
    limit: f64,
    found: Option<BoundedRoot>,
}

impl<'a> RayQuery<'a> for NextHit<'a> {
    fn scene(&self) -> &'a Scene {
        self.scene
    }

    fn ray(&self) -> &TimedRay {
        &self.ray
    }

    fn t_min(&self) -> f64 {
        match self.from {
            Departure::Passed(met) => met.hit.t.next_down().max(0.0),
            Departure::Mirrored(..) => 0.0,
        }
    }

    fn limit(&self) -> f64 {
        self.limit
    }

    fn skips(&self, object: u32) -> bool {
        self.from.met().is_on(object) && self.scene.objects()[object as usize].is_whole()
    }

    fn visit(&mut self, object: u32, primitive: u32) {
        let (scene, ray, met) = (self.scene, self.ray, self.from.met());
        // A line meets a triangle once.
        let is_same = met.is_on(object) && met.hit.primitive as u32 == primitive;
        if is_same && scene.objects()[object as usize].is_triangle() {
            return;
        }
        for root in roots_in_range(scene, &ray, ALL, object, primitive) {
            let is_nearer = root.1.low <= self.limit
                && self.found.is_none_or(|best| order(scene, &ray, &root, &best) == Ordering::Less);
            if is_nearer && self.from.is_before(scene, &ray, &root) {
                self.limit = self.limit.min(root.1.high);
                self.found = Some(root);
            }
        }
    }
}

/// The root of a hit of a ray: of those whose t may round to that of the hit, the first that does.
fn root_of(scene: &Scene, hit: &Hit, ray: &TimedRay) -> Option<BoundedRoot> {
    let (low, high) = (hit.t.next_down(), hit.t.next_up());
    let on = |primitive| roots_of(scene, ray, hit.object as u32, primitive);
    let is_near = |root: &BoundedRoot| root.1.low <= high && low <= root.1.high;
    let mut found: Vec<BoundedRoot> = match &scene.objects()[hit.object as usize] {
        object if !object.is_whole() => on(hit.primitive as u32).filter(is_near).collect(),
        object => match &object.geometry {
            Geometry::Mesh(mesh) => (0..mesh.len() as u32).flat_map(on).filter(is_near).collect(),
            _ => Vec::new(),
        },
    };
    if found.len() > 1 {
        found.retain(|root| {
            scene.t(&root.0, ray) == hit.t && !(hit.t == 0.0 && scene.is_negative(&root.0, ray))
        });
    }
    found.into_iter().min_by(|a, b| order(scene, ray, a, b))
}

/// The next hit of a ray.
///
/// `passing` has the objects that light goes on from, and `solid` is the closest hit, of t ≥ 0, on all
/// others. In most scenes the former are few, and packets of rays find the latter.
pub fn next_hit(
    world: &World,
    passing: &World,
    solid: &Hit,
    ray: &TimedRay,
    from: &Departure,
    stack: &mut Stack,
) -> Option<SurfaceHit> {
    let nearest = |world: &World, limit: f64, stack: &mut Stack| {
        let mut query = NextHit { scene: world.scene, ray: *ray, from, limit, found: None };
        query.run(world, stack);
        query.found
    };
    let refined = |root: BoundedRoot| {
        let hit = world.scene.hit_within(&root.0, root.1, ray);
        SurfaceHit { hit, root: Some(root) }
    };
    if solid.object < 0 {
        return nearest(passing, ALL.max, stack).map(refined);
    }
    // The exact t of the solid hit is within an ulp of the rounded one.
    let (low, high) = (solid.t.next_down(), solid.t.next_up());
    let found = nearest(passing, high, stack);
    if let Some(root) = found
        && root.1.high < low
    {
        return Some(refined(root));
    }
    // All surfaces that the ray passed are nearer than the solid one, or as near and before it in order.
    let is_further = match from {
        Departure::Passed(_) => true,
        Departure::Mirrored(before, mirror) => {
            let (object, primitive) = (solid.object as u32, solid.primitive as u32);
            let is_whole = world.scene.objects()[object as usize].is_whole();
            (!is_whole && !is_met(world.scene, before, mirror, object, primitive))
                || root_of(world.scene, solid, ray)
                    .is_some_and(|root| from.is_before(world.scene, ray, &root))
        }
    };
    if is_further && found.is_none_or(|found| found.1.low > high) {
        return Some(SurfaceHit::from(*solid));
    }
    // Surfaces that coincide with others or with a mirror are rare, and decided with all surfaces at once.
    nearest(world, ALL.max, stack).map(refined)
}
