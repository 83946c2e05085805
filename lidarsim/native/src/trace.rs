//! Casting many rays: sorted into packets that point the same way, traced through the hierarchies, and refined at the end.
//!
//! What is found does not depend on how the rays are grouped, nor on the instruction set: all float32 and most float64 work here
//! only rules out what is certainly not the nearest hit, and the rest is decided exactly.

use std::cell::Cell;
use std::ops::Range;

use crate::bvh::{LANES, Mask, Packet, Rays, Stack, Visitor, all, take};
use crate::doubt::Doubts;
use crate::number::Interval;
use crate::order::{NEAR, Order};
use crate::refine::Plain;
use crate::scene::{Geometry, Hit, Object, Place, Scene};
use crate::search::{Search, Searches};
use crate::shapes::{Bearing, Block, TriangleMesh};
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
        let Cast { scene, origins, directions, t_min, t_max, hits } = self;
        let (size, stack) = (scene.size(), STACK.take().unwrap_or_default());
        let searches = Searches::new(scene, (t_min, t_max));
        let (doubts, met, pending) = (Doubts::new(), Met::new(), Pending::new());
        let mut tracer = Tracer { scene, size, stack, searches, doubts, met, pending, hits };
        let mut supply =
            Supply { origins, directions, order: Order::new(origins, directions, size), start: 0, done: 0 };
        // Hits of one packet are refined after the next was traced: meanwhile their vertices come.
        let (mut rays, mut others) = (Rays::empty(), Rays::empty());
        let (mut plain, mut other_plain) = (Plain::new(), Plain::new());
        let (mut now, mut found) = (&mut rays, &mut plain);
        let (mut before, mut found_before) = (&mut others, &mut other_plain);
        let mut legal = true;
        let mut more = supply.take_up::<I>(now);
        while more {
            supply.prefetch::<I>(now.count, tracer.hits);
            if now.count > 0 {
                tracer.trace::<I>(now);
                tracer.sort_out::<I>(now, found);
            } else {
                legal &= tracer.trace_alone(now, (t_min, t_max));
            }
            found_before.refine::<I>(scene, before, tracer.hits);
            more = supply.take_up::<I>(before);
            found.prefetch::<I>(scene);
            std::mem::swap(&mut now, &mut before);
            std::mem::swap(&mut found, &mut found_before);
        }
        found_before.refine::<I>(scene, before, tracer.hits);
        tracer.pending.flush::<I>(scene, tracer.hits);
        STACK.set(Some(tracer.stack));
        legal
    }
}

thread_local! {
    /// What one cast leaves to the next, as it is large.
    static STACK: Cell<Option<Box<Stack>>> = const { Cell::new(None) };
}

/// The rays that are still to be traced.
struct Supply<'a> {
    origins: &'a [Point],
    directions: &'a [Point],
    order: Order<'a>,
    /// How many of those sorted last have been taken up, and where these begin.
    start: usize,
    done: usize,
}

impl Supply<'_> {
    /// Takes up the next packet, or a single ray that no packet holds; false if there are no more.
    #[inline(always)]
    fn take_up<I: Isa>(&mut self, rays: &mut Rays) -> bool {
        if self.start == self.order.sorted().len() {
            (self.start, self.done) = (0, self.done + self.start);
            if !self.order.advance::<I>() {
                return false;
            }
        }
        rays.take_up::<I>(self.origins, self.directions, &self.order.sorted()[self.start..]);
        self.start += rays.count.max(1);
        true
    }

    /// Brings the rays of a coming packet into the cache, and the places of their hits.
    #[inline(always)]
    fn prefetch<I: Isa>(&self, count: usize, hits: &(impl Sink + ?Sized)) {
        let sorted = self.order.sorted();
        if sorted.len() == NEAR {
            // Of the rays that will be sorted next, as many as were taken up last.
            let (end, next) = (self.origins.len(), self.done + NEAR + self.start);
            let ahead = end.min(next - count)..end.min(next);
            simd::prefetch::<I, _>(&self.origins[ahead.clone()]);
            hits.prefetch::<I>(ahead);
        } else {
            for &i in &sorted[self.start..sorted.len().min(self.start + LANES)] {
                let i = i as usize;
                I::prefetch(&self.origins[i]);
                I::prefetch(&self.directions[i]);
                hits.prefetch::<I>(i..i + 1);
            }
        }
    }
}

struct Tracer<'a, S: ?Sized> {
    scene: &'a Scene,
    size: f64,
    stack: Box<Stack>,
    searches: Searches<'a>,
    doubts: Doubts,
    met: Met,
    pending: Pending,
    hits: &'a mut S,
}

impl<'a, S: Sink + ?Sized> Tracer<'a, S> {
    /// Searches for the nearest hits of the rays.
    #[inline(always)]
    fn trace<I: Isa>(&mut self, rays: &Rays) {
        let (scene, searches) = (self.scene, &mut self.searches);
        searches.restart::<I>();
        let active = all(rays.count);
        let index = scene.index();
        for &object in &index.unbounded {
            simple::meet::<I>(scene, object, rays, searches, active, &mut self.met);
        }
        let coherent = rays.are_coherent::<I>(self.size);
        let (doubts, met) = (&mut self.doubts, &mut self.met);
        let mut visitor = Objects { scene, rays, coherent, searches, doubts, met };
        match index.bounded.only_leaf() {
            // The hierarchy of the mesh begins with what that above it would ask.
            Some(&id) if matches!(scene.objects()[id as usize].geometry, Geometry::Mesh(_)) => {
                visitor.meet::<I>(&mut self.stack, id, active);
            }
            _ => {
                let mut packet = Packet::empty();
                packet.enter::<I>(rays, index.bounded.center(), visitor.searches.t_min(), visitor.searches.limits());
                let stack = &mut self.stack;
                index.bounded.traverse_packet::<I>(&mut packet, active, coherent, stack, &mut visitor);
            }
        }
        self.doubts.settle::<I>(scene, rays, &mut self.searches);
    }

    /// Passes the nearest hits on, each to what finishes its kind.
    #[inline(always)]
    fn sort_out<I: Isa>(&mut self, rays: &Rays, plain: &mut Plain<'a>) {
        let mut lanes = 0;
        for lane in 0..rays.count {
            if !self.searches.has_found(lane) {
                self.hits.put(rays.at[lane] as usize, Hit::MISS);
            } else if self.scene.objects()[self.searches.object(lane) as usize].is_plain_triangle() {
                lanes |= 1 << lane;
            } else {
                let (place, bounds) = (self.searches.place(lane), self.searches.bounds(lane));
                let meeting = (rays.origin(lane), rays.direction(lane), bounds);
                self.pending.push::<I>(self.scene, rays.at[lane], place, meeting, self.hits);
            }
        }
        plain.take_up(&self.searches, lanes);
    }

    /// Traces a ray that packets do not hold; false if it is illegal.
    fn trace_alone(&mut self, rays: &Rays, range: (f64, f64)) -> bool {
        let (at, origin, direction) = (rays.at[0] as usize, rays.origin(0), rays.direction(0));
        let legal = origin.iter().chain(&direction).all(|x| x.is_finite()) && direction != [0.0; 3];
        let mut hit = Hit::MISS;
        if legal {
            let mut search = Search::new(self.scene, origin, direction, range);
            search.run(&mut self.stack);
            if let Some((place, bounds)) = search.found() {
                hit = self.scene.hit_within(&place, bounds, origin, direction);
            }
        }
        self.hits.put(at, hit);
        legal
    }
}

/// Rays of one octant among the objects of the scene.
struct Objects<'a, 's> {
    scene: &'s Scene,
    rays: &'a Rays,
    coherent: bool,
    searches: &'a mut Searches<'s>,
    doubts: &'a mut Doubts,
    met: &'a mut Met,
}

impl Objects<'_, '_> {
    #[inline(always)]
    fn meet<I: Isa>(&mut self, stack: &mut Stack, id: u32, mask: Mask) {
        let object = &self.scene.objects()[id as usize];
        match &object.geometry {
            Geometry::Mesh(mesh) if object.is_placed_as_made() => {
                let (scene, rays, searches, doubts) =
                    (self.scene, self.rays, &mut *self.searches, Some(&mut *self.doubts));
                let mut blocks = Blocks { scene, mesh, id, rays, world: rays, searches, doubts };
                blocks.trace::<I>(self.coherent, mask, stack);
            }
            Geometry::Mesh(mesh) => self.enter_moved::<I>(stack, id, object, mesh, mask),
            Geometry::Simple(_) => simple::meet::<I>(self.scene, id, self.rays, self.searches, mask, self.met),
        }
    }

    /// Takes the rays into the coordinates of a mesh that was moved, where they may point into several octants.
    #[inline(always)]
    fn enter_moved<I: Isa>(&mut self, stack: &mut Stack, id: u32, object: &Object, mesh: &TriangleMesh, mask: Mask) {
        let mut local = Rays::empty();
        let mut octants = [0_u32; LANES];
        let mut ordinary: Mask = 0;
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            let (o, d) = object.enclose(self.rays.origin(lane), self.rays.direction(lane));
            let (origin, origin_error) = middle(o);
            let (direction, direction_error) = middle(d);
            if Rays::holds(origin, direction) && origin_error < 1e30 && direction_error < 1e30 {
                local.set(lane, origin, direction);
                local.origin_error[lane] = origin_error;
                local.direction_error[lane] = direction_error;
                octants[lane] = Rays::octant_of(direction);
                ordinary |= 1 << lane;
            } else {
                self.searches.enter(self.rays, lane, id, mesh, stack);
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
            let rays = &local.only(same, octant);
            let (scene, world, searches) = (self.scene, self.rays, &mut *self.searches);
            let mut blocks = Blocks { scene, mesh, id, rays, world, searches, doubts: None };
            blocks.trace::<I>(self.coherent, same, stack);
            ordinary &= !same;
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
    fn limits(&self) -> &[f64; LANES] {
        self.searches.limits()
    }
}

/// Rays of one octant, in the coordinates of a mesh, among its triangles.
struct Blocks<'a, 's> {
    scene: &'s Scene,
    mesh: &'a TriangleMesh,
    id: u32,
    rays: &'a Rays,
    /// The same, as they are in the world.
    world: &'a Rays,
    searches: &'a mut Searches<'s>,
    /// None if the mesh was moved.
    doubts: Option<&'a mut Doubts>,
}

impl Blocks<'_, '_> {
    #[inline(always)]
    fn trace<I: Isa>(&mut self, coherent: bool, mask: Mask, stack: &mut Stack) {
        let hierarchy = self.mesh.hierarchy();
        let mut packet = Packet::empty();
        packet.enter::<I>(self.rays, hierarchy.center(), self.searches.t_min(), self.searches.limits());
        hierarchy.traverse_packet::<I>(&mut packet, mask, coherent, stack, self);
    }

    #[inline(always)]
    fn bearing(&self, lane: usize) -> Bearing {
        let Rays { length, direction_error, .. } = self.rays;
        Bearing { direction: self.rays.direction(lane), length: length[lane], error: direction_error[lane] }
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
            let (candidates, sure) = block.candidates::<I>(&edges, &self.bearing(lane));
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
            let bearing = self.bearing(lane);
            while let Some(i) = take(&mut candidates) {
                let primitive = block.ids()[i];
                let known = if sure & 1 << i != 0 { Block::meet::<I>(i, &planes, &bearing) } else { None };
                match known {
                    Some(t) if t.low > self.searches.limits()[lane] => continue,
                    Some(t) => self.searches.offer(self.world, lane, Place::of_triangle(self.id, primitive), t),
                    None => {
                        self.doubt::<I>(lane, primitive);
                        continue;
                    }
                }
                self.mesh.prefetch_face::<I>(primitive);
                nearer |= 1 << lane;
            }
        }
        nearer
    }
}

impl Blocks<'_, '_> {
    /// Keeps for later what a look could not tell.
    #[inline(always)]
    fn doubt<I: Isa>(&mut self, lane: usize, primitive: u32) {
        let Some(doubts) = &mut self.doubts else {
            self.searches.consider(self.world, lane, self.id, primitive);
            return;
        };
        if doubts.are_full() {
            doubts.settle::<I>(self.scene, self.world, self.searches);
        }
        doubts.push::<I>(self.scene, lane, Place::of_triangle(self.id, primitive));
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
    fn limits(&self) -> &[f64; LANES] {
        self.searches.limits()
    }
}

/// The middle of a box, and how far any coordinate of a point of the box is from it.
fn middle(v: [Interval; 3]) -> (Point, f64) {
    let m = v.map(|x| 0.5 * x.low + 0.5 * x.high);
    let error = (0..3).fold(0.0_f64, |e, i| e.max((m[i] - v[i].low).max(v[i].high - m[i]).next_up()));
    (m, error)
}
