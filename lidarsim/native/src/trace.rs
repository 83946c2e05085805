//! Casting many rays: sorted into packets that point the same way, traced through the hierarchies, and refined at the end.
//!
//! What is found does not depend on how the rays are grouped, nor on the instruction set: all float32 and most float64 work here
//! only rules out what is certainly not the nearest hit, and the rest is decided exactly.

use crate::bvh::{LANES, Packet, Rays, Stack, Visitor};
use crate::number::Interval;
use crate::order::coherent_order;
use crate::refine::Batch;
use crate::scene::{Geometry, Hit, Object, Place, Scene, Search};
use crate::shapes::{Block, TriangleMesh};
use crate::simd::{Isa, Task};
use crate::vector::Point;

/// Where hits go: the hit of ray i, once for each ray, in any order.
pub trait Sink {
    fn put(&mut self, i: usize, hit: Hit);
}

impl Sink for [Hit] {
    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self[i] = hit;
    }
}

/// The nearest hit of each ray with t_min ≤ t ≤ t_max. The outcome is false if there was a ray with a number that is not finite, or with a
/// zero direction; such a ray is a miss.
pub struct Cast<'a, S: Sink + ?Sized> {
    pub scene: &'a Scene,
    pub origins: &'a [Point],
    pub directions: &'a [Point],
    pub t_min: f64,
    pub t_max: f64,
    pub hits: &'a mut S,
}

impl<S: Sink + ?Sized> Task for Cast<'_, S> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        let mut legal = true;
        let Cast { scene, origins, directions, t_min, t_max, hits } = self;
        let mut tracer = Tracer { scene, stack: Stack::new(), batch: Batch::new(), hits };
        let order = coherent_order(scene, origins, directions);
        let mut rays = Rays::empty();
        let mut searches: [Search; LANES] =
            std::array::from_fn(|_| Search::new(scene, [0.0; 3], [1.0; 3], t_min, t_max));
        let mut at = [0_u32; LANES];
        let mut octant = 0;
        for (k, &i) in order.iter().enumerate() {
            // The rays of the packet after next.
            let later = order[(k + 2 * LANES).min(order.len() - 1)] as usize;
            I::prefetch(&origins[later]);
            I::prefetch(&directions[later]);
            let (o, d) = (origins[i as usize], directions[i as usize]);
            if !Rays::holds(o, d) {
                let mut search = Search::new(scene, o, d, t_min, t_max);
                if o.iter().chain(&d).all(|x| x.is_finite()) && d != [0.0; 3] {
                    search.run(&mut tracer.stack);
                } else {
                    legal = false;
                }
                tracer.finish::<I>(i, &search);
                continue;
            }
            let new = Rays::octant(d);
            if rays.count == LANES || (rays.count > 0 && new != octant) {
                tracer.trace::<I>(&mut rays, octant, &mut searches, &at);
            }
            octant = new;
            let lane = rays.count;
            rays.set(lane, o, d);
            searches[lane] = Search::new(scene, o, d, t_min, t_max);
            at[lane] = i;
            rays.count += 1;
        }
        if rays.count > 0 {
            tracer.trace::<I>(&mut rays, octant, &mut searches, &at);
        }
        tracer.batch.flush::<I>(scene, tracer.hits);
        legal
    }
}

struct Tracer<'a, S: ?Sized> {
    scene: &'a Scene,
    stack: Stack,
    batch: Batch,
    hits: &'a mut S,
}

impl<'a, S: Sink + ?Sized> Tracer<'a, S> {
    /// Traces the rays, writes their hits to places `at`, and empties the packet.
    #[inline(always)]
    fn trace<I: Isa>(&mut self, rays: &mut Rays, octant: u32, searches: &mut [Search<'a>; LANES], at: &[u32; LANES]) {
        let scene = self.scene;
        let count = rays.count;
        let active = (1_u32 << count) - 1;
        for lane in count..LANES {
            rays.set(lane, rays.origin(0), rays.direction(0));
        }
        let index = scene.index();
        for search in &mut searches[..count] {
            for &object in &index.unbounded {
                search.consider(object, 0);
            }
        }
        let (t_min, limits) = (searches[0].t_min, limits(searches));
        let mut visitor = Objects { scene, rays, octant, searches };
        match index.bounded.only_leaf() {
            // The hierarchy of the mesh begins with what that above it would ask.
            Some(&id) if matches!(scene.objects()[id as usize].geometry, Geometry::Mesh(_)) => {
                visitor.meet::<I>(&mut self.stack, id, active);
            }
            _ => {
                let mut packet = Packet::new(rays, octant, index.bounded.center(), t_min, &limits);
                index.bounded.traverse_packet::<I>(&mut packet, active, &mut self.stack, &mut visitor);
            }
        }
        for lane in 0..count {
            self.finish::<I>(at[lane], &searches[lane]);
        }
        rays.count = 0;
    }

    #[inline(always)]
    fn finish<I: Isa>(&mut self, at: u32, search: &Search) {
        match search.best() {
            None => self.hits.put(at as usize, Hit::MISS),
            Some(place) if self.scene.objects()[place.object as usize].is_plain_triangle() => {
                self.batch.push::<I>(self.scene, at, place, search, self.hits);
            }
            Some(place) => self.hits.put(at as usize, self.scene.hit(&place, search.origin, search.direction)),
        }
    }
}

#[inline(always)]
fn limits(searches: &[Search; LANES]) -> [f64; LANES] {
    let mut limits = [0.0; LANES];
    for lane in 0..LANES {
        limits[lane] = searches[lane].limit();
    }
    limits
}

/// Takes the lowest lane out of a mask.
#[inline(always)]
fn take(mask: &mut u32) -> Option<usize> {
    if *mask == 0 {
        return None;
    }
    let lane = mask.trailing_zeros() as usize;
    *mask &= *mask - 1;
    Some(lane)
}

/// Rays of one octant among the objects of the scene.
struct Objects<'a, 's> {
    scene: &'s Scene,
    rays: &'a Rays,
    octant: u32,
    searches: &'a mut [Search<'s>; LANES],
}

impl Objects<'_, '_> {
    #[inline(always)]
    fn meet<I: Isa>(&mut self, stack: &mut Stack, id: u32, mask: u32) {
        let object = &self.scene.objects()[id as usize];
        match &object.geometry {
            Geometry::Mesh(mesh) if object.is_placed_as_made() => {
                Blocks { mesh, id, rays: self.rays, searches: self.searches }.trace::<I>(self.octant, mask, stack);
            }
            Geometry::Mesh(mesh) => enter_moved::<I>(mask, id, object, mesh, self.searches, stack),
            Geometry::Simple(_) => {
                let mut left = mask;
                while let Some(lane) = take(&mut left) {
                    self.searches[lane].consider(id, 0);
                }
            }
        }
    }
}

impl Visitor<u32> for Objects<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, stack: &mut Stack, packet: &mut Packet, leaf: &u32, mask: u32) {
        self.meet::<I>(stack, *leaf, mask);
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            packet.set_limit(lane, self.searches[lane].limit());
        }
    }
}

/// Rays of one octant, in the coordinates of a mesh, among its triangles.
struct Blocks<'a, 's> {
    mesh: &'a TriangleMesh,
    id: u32,
    rays: &'a Rays,
    searches: &'a mut [Search<'s>; LANES],
}

impl Blocks<'_, '_> {
    #[inline(always)]
    fn trace<I: Isa>(&mut self, octant: u32, mask: u32, stack: &mut Stack) {
        let hierarchy = self.mesh.hierarchy();
        let limits = limits(self.searches);
        let mut packet = Packet::new(self.rays, octant, hierarchy.center(), self.searches[0].t_min, &limits);
        hierarchy.traverse_packet::<I>(&mut packet, mask, stack, self);
    }
}

impl Visitor<Block> for Blocks<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, packet: &mut Packet, block: &Block, mask: u32) {
        let mut seen_by = mask.trailing_zeros() as usize;
        let mut edges = block.edges::<I>(self.rays.origin(seen_by), self.rays.origin_error[seen_by]);
        let mut planes = None;
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            if !self.rays.same_origin(lane, seen_by) {
                seen_by = lane;
                edges = block.edges::<I>(self.rays.origin(lane), self.rays.origin_error[lane]);
                planes = None;
            }
            let (direction, direction_error) = (self.rays.direction(lane), self.rays.direction_error[lane]);
            let candidates = block.candidates::<I>(&edges, direction, direction_error);
            if candidates.0 == 0 {
                continue;
            }
            if planes.is_none() {
                planes = Some(block.planes::<I>(&edges));
            }
            let Some(planes) = &planes else { continue };
            let search = &mut self.searches[lane];
            let mut met = block.meet::<I>(&edges, planes, candidates, direction, direction_error, search.limit());
            while let Some(i) = take(&mut met.hit) {
                block.prefetch::<I>(i, self.mesh);
                search.offer(
                    Place::of_triangle(self.id, block.ids()[i]),
                    Interval { low: met.low[i], high: met.high[i] },
                );
            }
            while let Some(i) = take(&mut met.unsure) {
                search.consider(self.id, block.ids()[i]);
            }
            packet.set_limit(lane, search.limit());
        }
    }
}

/// Takes the rays into the coordinates of a mesh that was moved, where they may point into several octants.
#[inline(always)]
fn enter_moved<I: Isa>(
    mask: u32,
    id: u32,
    object: &Object,
    mesh: &TriangleMesh,
    searches: &mut [Search; LANES],
    stack: &mut Stack,
) {
    let mut local = Rays::empty();
    let mut ordinary = 0_u32;
    let mut left = mask;
    while let Some(lane) = take(&mut left) {
        let (o, d) = object.enclose(searches[lane].origin, searches[lane].direction);
        let (origin, origin_error) = middle(o);
        let (direction, direction_error) = middle(d);
        if Rays::holds(origin, direction) && origin_error < 1e30 && direction_error < 1e30 {
            local.set(lane, origin, direction);
            local.origin_error[lane] = origin_error;
            local.direction_error[lane] = direction_error;
            ordinary |= 1 << lane;
        } else {
            searches[lane].enter(id, mesh, stack);
        }
    }
    while ordinary != 0 {
        let first = ordinary.trailing_zeros() as usize;
        let octant = Rays::octant(local.direction(first));
        let mut rays = local.clone();
        let mut same = 0;
        for lane in 0..LANES {
            if ordinary & (1 << lane) != 0 && Rays::octant(local.direction(lane)) == octant {
                same |= 1 << lane;
            } else {
                rays.set(lane, local.origin(first), local.direction(first));
                rays.origin_error[lane] = local.origin_error[first];
                rays.direction_error[lane] = local.direction_error[first];
            }
        }
        Blocks { mesh, id, rays: &rays, searches }.trace::<I>(octant, same, stack);
        ordinary &= !same;
    }
}

/// The middle of a box, and how far any coordinate of a point of the box is from it.
fn middle(v: [Interval; 3]) -> (Point, f64) {
    let m = v.map(|x| 0.5 * x.low + 0.5 * x.high);
    let error = (0..3).fold(0.0_f64, |e, i| e.max((m[i] - v[i].low).max(v[i].high - m[i]).next_up()));
    (m, error)
}
