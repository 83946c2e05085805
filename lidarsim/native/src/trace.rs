//! Casting many rays: sorted into packets that point the same way, traced through the hierarchies, and refined at the end.
//!
//! What is found does not depend on how the rays are grouped, nor on the instruction set: all float32 and most float64 work here
//! only rules out what is certainly not the nearest hit, and the rest is decided exactly.

use std::cell::Cell;
use std::ops::Range;

use crate::bvh::{LANES, Mask, Packet, Rays, Stack, Visitor, all, take};
use crate::number::Interval;
use crate::order::{NEAR, Order};
use crate::refine::Batch;
use crate::scene::{Geometry, Hit, Object, Place, Scene, Search};
use crate::shapes::{Block, TriangleMesh};
use crate::simd::{self, Isa, Task};
use crate::simple::{self, Met, Pending};
use crate::vector::Point;

/// Where hits go: the hit of ray i, once for each ray, in any order.
pub trait Sink {
    fn put(&mut self, i: usize, hit: Hit);
    /// Brings the places of some hits into the cache.
    fn prefetch<I: Isa>(&self, hits: Range<usize>);
}

impl Sink for [Hit] {
    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self[i] = hit;
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, hits: Range<usize>) {
        simd::prefetch::<I, _>(&self[hits]);
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
        let size = scene.size();
        let stack = STACK.take().unwrap_or_default();
        let (batch, pending, met) = (Batch::new(), Pending::new(), Met::new());
        let mut tracer = Tracer { scene, size, stack, batch, pending, met, hits };
        let mut searches: [Search; LANES] =
            std::array::from_fn(|_| Search::new(scene, [0.0; 3], [1.0; 3], t_min, t_max));
        let mut order = Order::new(origins, directions, size);
        let mut done = 0;
        while let Some(order) = order.next() {
            // The rays that come next are taken up while others are traced: what was just written is slow to read.
            let (mut rays, mut later) = (Rays::empty(), Rays::empty());
            later.take_up(origins, directions, order);
            let mut start = 0;
            while start < order.len() {
                std::mem::swap(&mut rays, &mut later);
                let count = rays.look::<I>();
                let next = start + count.max(1);
                later.take_up(origins, directions, &order[next..]);
                if order.len() == NEAR {
                    // Of the next rays that are sorted together, as many as are traced now.
                    let end = origins.len();
                    let ahead = end.min(done + NEAR + start)..end.min(done + NEAR + next);
                    simd::prefetch::<I, _>(&origins[ahead.clone()]);
                    tracer.hits.prefetch::<I>(ahead);
                }
                for lane in 0..count.max(1) {
                    searches[lane].restart(rays.origin(lane), rays.direction(lane));
                }
                if count > 0 {
                    tracer.trace::<I>(&rays, &mut searches, &order[start..]);
                } else if is_legal(&searches[0]) {
                    searches[0].run(&mut tracer.stack);
                    tracer.finish::<I>(order[start], &searches[0]);
                } else {
                    legal = false;
                    tracer.hits.put(order[start] as usize, Hit::MISS);
                }
                start = next;
            }
            done += order.len();
        }
        tracer.batch.flush::<I>(scene, tracer.hits);
        tracer.pending.flush::<I>(scene, tracer.hits);
        STACK.set(Some(tracer.stack));
        legal
    }
}

thread_local! {
    /// What one cast leaves to the next, as it is large.
    static STACK: Cell<Option<Box<Stack>>> = const { Cell::new(None) };
}

fn is_legal(search: &Search) -> bool {
    search.origin.iter().chain(&search.direction).all(|x| x.is_finite()) && search.direction != [0.0; 3]
}

struct Tracer<'a, S: ?Sized> {
    scene: &'a Scene,
    size: f64,
    stack: Box<Stack>,
    batch: Batch,
    pending: Pending,
    met: Met,
    hits: &'a mut S,
}

impl<'a, S: Sink + ?Sized> Tracer<'a, S> {
    /// Traces the rays, and writes their hits to places `at`.
    #[inline(always)]
    fn trace<I: Isa>(&mut self, rays: &Rays, searches: &mut [Search<'a>; LANES], at: &[u32]) {
        let scene = self.scene;
        let active = all(rays.count);
        let index = scene.index();
        for &object in &index.unbounded {
            simple::meet::<I>(scene, object, rays, searches, active, &mut self.met);
        }
        let coherent = rays.are_coherent::<I>(self.size);
        let mut visitor = Objects { scene, rays, coherent, searches, met: &mut self.met };
        match index.bounded.only_leaf() {
            // The hierarchy of the mesh begins with what that above it would ask.
            Some(&id) if matches!(scene.objects()[id as usize].geometry, Geometry::Mesh(_)) => {
                visitor.meet::<I>(&mut self.stack, id, active);
            }
            _ => {
                let (t_min, limits) = (visitor.searches[0].t_min, limits(visitor.searches, rays.count));
                let mut packet = Packet::empty();
                packet.enter::<I>(rays, index.bounded.center(), t_min, &limits);
                let stack = &mut self.stack;
                index.bounded.traverse_packet::<I>(&mut packet, active, coherent, stack, &mut visitor);
            }
        }
        for lane in 0..rays.count {
            self.finish::<I>(at[lane], &searches[lane]);
        }
    }

    #[inline(always)]
    fn finish<I: Isa>(&mut self, at: u32, search: &Search) {
        match search.best() {
            None => self.hits.put(at as usize, Hit::MISS),
            Some(place) if self.scene.objects()[place.object as usize].is_plain_triangle() => {
                self.batch.push::<I>(self.scene, at, place, search, self.hits);
            }
            Some(_) => self.pending.push::<I>(self.scene, at, search, self.hits),
        }
    }
}

#[inline(always)]
fn limits(searches: &[Search; LANES], count: usize) -> [f64; LANES] {
    let mut limits = [0.0; LANES];
    for lane in 0..count {
        limits[lane] = searches[lane].limit();
    }
    limits
}

/// Rays of one octant among the objects of the scene.
struct Objects<'a, 's> {
    scene: &'s Scene,
    rays: &'a Rays,
    coherent: bool,
    searches: &'a mut [Search<'s>; LANES],
    met: &'a mut Met,
}

impl Objects<'_, '_> {
    #[inline(always)]
    fn meet<I: Isa>(&mut self, stack: &mut Stack, id: u32, mask: Mask) {
        let object = &self.scene.objects()[id as usize];
        match &object.geometry {
            Geometry::Mesh(mesh) if object.is_placed_as_made() => {
                Blocks { mesh, id, rays: self.rays, searches: self.searches }.trace::<I>(self.coherent, mask, stack);
            }
            Geometry::Mesh(mesh) => enter_moved::<I>(self.coherent, mask, id, object, mesh, self.searches, stack),
            Geometry::Simple(_) => simple::meet::<I>(self.scene, id, self.rays, self.searches, mask, self.met),
        }
    }
}

impl Visitor<u32> for Objects<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, stack: &mut Stack, leaf: &u32, mask: Mask) -> Mask {
        self.meet::<I>(stack, *leaf, mask);
        mask
    }

    #[inline(always)]
    fn limit(&self, lane: usize) -> f64 {
        self.searches[lane].limit()
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
    fn trace<I: Isa>(&mut self, coherent: bool, mask: Mask, stack: &mut Stack) {
        let hierarchy = self.mesh.hierarchy();
        let limits = limits(self.searches, self.rays.count);
        let mut packet = Packet::empty();
        packet.enter::<I>(self.rays, hierarchy.center(), self.searches[0].t_min, &limits);
        hierarchy.traverse_packet::<I>(&mut packet, mask, coherent, stack, self);
    }

    /// Meets the block with rays of one origin, and says which of them want less than before.
    #[inline(always)]
    fn look<I: Isa>(&mut self, block: &Block, mask: Mask) -> Mask {
        let first = mask.trailing_zeros() as usize;
        let edges = block.edges::<I>(self.rays.origin(first), self.rays.origin_error[first]);
        // All rays look before one acts on what it saw, so that no branch hangs on a single look. The lane, its candidates and the sure ones of
        // them have a byte each: the array is written anew at each leaf.
        let mut seen = [[0_u8; 4]; LANES];
        let mut count = 0;
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            let (direction, direction_error) = (self.rays.direction(lane), self.rays.direction_error[lane]);
            let (candidates, sure) = block.candidates::<I>(&edges, direction, direction_error);
            seen[count] = [lane as u8, candidates as u8, sure as u8, 0];
            count += usize::from(candidates != 0);
        }
        if count == 0 {
            return 0;
        }
        let planes = block.planes::<I>(&edges);
        let mut nearer = 0;
        for &[lane, candidates, sure, _] in &seen[..count] {
            let (lane, mut candidates) = (usize::from(lane), Mask::from(candidates));
            let (direction, direction_error) = (self.rays.direction(lane), self.rays.direction_error[lane]);
            while let Some(i) = take(&mut candidates) {
                let (search, primitive) = (&mut self.searches[lane], block.ids()[i]);
                let known = if sure & 1 << i != 0 {
                    Block::meet::<I>(i, &edges, &planes, direction, direction_error)
                } else {
                    None
                };
                match known {
                    Some(t) if t.low > search.limit() => continue,
                    Some(t) => search.offer(Place::of_triangle(self.id, primitive), t),
                    None => search.consider(self.id, primitive),
                }
                self.mesh.prefetch_face::<I>(primitive);
                nearer |= 1 << lane;
            }
        }
        nearer
    }
}

impl Visitor<Block> for Blocks<'_, '_> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, block: &Block, mask: Mask) -> Mask {
        if self.rays.one_origin || mask & (mask - 1) == 0 {
            return self.look::<I>(block, mask);
        }
        let (mut nearer, mut left) = (0, mask);
        while left != 0 {
            let same = left & self.rays.at_origin_of(left.trailing_zeros() as usize);
            nearer |= self.look::<I>(block, same);
            left &= !same;
        }
        nearer
    }

    #[inline(always)]
    fn limit(&self, lane: usize) -> f64 {
        self.searches[lane].limit()
    }
}

/// Takes the rays into the coordinates of a mesh that was moved, where they may point into several octants.
#[inline(always)]
fn enter_moved<I: Isa>(
    coherent: bool,
    mask: Mask,
    id: u32,
    object: &Object,
    mesh: &TriangleMesh,
    searches: &mut [Search; LANES],
    stack: &mut Stack,
) {
    let mut local = Rays::empty();
    let mut octants = [0_u32; LANES];
    let mut ordinary: Mask = 0;
    let mut left = mask;
    while let Some(lane) = take(&mut left) {
        let (o, d) = object.enclose(searches[lane].origin, searches[lane].direction);
        let (origin, origin_error) = middle(o);
        let (direction, direction_error) = middle(d);
        if Rays::holds(origin, direction) && origin_error < 1e30 && direction_error < 1e30 {
            local.set(lane, origin, direction);
            local.origin_error[lane] = origin_error;
            local.direction_error[lane] = direction_error;
            octants[lane] = Rays::octant_of(direction);
            ordinary |= 1 << lane;
        } else {
            searches[lane].enter(id, mesh, stack);
        }
    }
    while ordinary != 0 {
        let octant = octants[ordinary.trailing_zeros() as usize];
        let mut same = 0;
        for lane in 0..LANES {
            if ordinary & 1 << lane != 0 && octants[lane] == octant {
                same |= 1 << lane;
            }
        }
        let rays = local.only(same, octant);
        Blocks { mesh, id, rays: &rays, searches }.trace::<I>(coherent, same, stack);
        ordinary &= !same;
    }
}

/// The middle of a box, and how far any coordinate of a point of the box is from it.
fn middle(v: [Interval; 3]) -> (Point, f64) {
    let m = v.map(|x| 0.5 * x.low + 0.5 * x.high);
    let error = (0..3).fold(0.0_f64, |e, i| e.max((m[i] - v[i].low).max(v[i].high - m[i]).next_up()));
    (m, error)
}
