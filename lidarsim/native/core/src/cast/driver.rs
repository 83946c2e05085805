//! The driver of casts: it sorts rays into coherent packets, which traverse the hierarchies, and refines
//! their closest hits.
//!
//! Results depend neither on the grouping of rays nor on the instruction set: float32 tests and float64
//! bounds only cull what is certainly not the closest hit, and the rest is decided exactly.

use std::cell::Cell;

use crate::arith::simd::{Isa, Task};
use crate::bvh::{LANES, RayPacket, all, take};
use crate::cast::closest_hit::{ClosestHit, timed_ray};
use crate::cast::hit_batches::{BATCH_SIZE, BoundedHit, HitBatches};
use crate::cast::ray_query::RayQuery;
use crate::cast::ray_sort::RaySort;
use crate::cast::surface_intersector::SurfaceIntersector;
use crate::cast::traversal::{Advance, PacketState, TRAVERSALS, Traversal, TraversalScratch};
use crate::cast::triangle_hits::TriangleHits;
use crate::scene::{Hit, Rays, Sink, TRange, World};
use crate::stop;

/// Packets between two polls for a stop of the cast.
pub const POLL: usize = 16;

/// The closest hit of each ray with t_min ≤ t ≤ t_max, at the time of the ray; times may be missing if
/// nothing moves. The result is false if any ray has a number that is not finite or a zero direction; such a
/// ray is a miss.
pub struct Cast<'a, S: Sink + ?Sized> {
    pub world: &'a World<'a>,
    pub rays: Rays<'a>,
    pub range: TRange,
    pub hits: &'a mut S,
}

impl<S: Sink + ?Sized> Task for Cast<'_, S> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self) -> bool {
        let Cast { world, rays, range, hits } = self;
        let scene = world.scene;
        let mut scratch = SCRATCH.take().unwrap_or_default();
        let CastScratch { traversals, previous, batches, surfaces, ray_sort } = &mut *scratch;
        let mut source = PacketSource::new(world, rays, ray_sort);
        let mut traversals =
            traversals.each_mut().map(|scratch| Traversal::new(world, range, S::ANY, scratch));
        // Hits of one packet are refined after the traversal of the next, so that their vertices can be
        // prefetched.
        let (mut triangle_hits, mut previous) = (TriangleHits::new(), previous);
        let mut router = HitRouter { world, batches, hits };
        let mut legal = true;
        for turn in 0_usize.. {
            for traversal in &mut traversals {
                while traversal.is_idle() && source.next_packet::<I>(traversal.state.rays, router.hits) {
                    if traversal.state.rays.count > 0 {
                        traversal.make_ready();
                    } else {
                        legal &= router.trace_single(traversal, range);
                    }
                }
            }
            // Reading the clock takes as long as a ray or two.
            if turn.is_multiple_of(POLL) {
                stop::poll();
            }
            if !S::ANY {
                triangle_hits.prefetch::<I>(scene);
            }
            let finished = I::call(Advance { traversals: &mut traversals, surfaces });
            if !S::ANY {
                triangle_hits.refine::<I>(scene, previous, router.hits);
            }
            let Some(k) = finished else { break };
            let state = &mut traversals[k].state;
            router.route::<I>(state, &mut triangle_hits);
            std::mem::swap(&mut previous, &mut state.rays);
        }
        if !S::ANY {
            router.batches.flush::<I>(scene, router.hits);
        }
        SCRATCH.set(Some(scratch));
        legal
    }
}

thread_local! {
    /// Reused from cast to cast, as it is large.
    pub static SCRATCH: Cell<Option<Box<CastScratch>>> = const { Cell::new(None) };
}

/// Scratch memory of a cast; its contents carry no meaning to the next.
pub struct CastScratch {
    /// Boxed separately, so that a thread's stack need not hold all of them during construction.
    pub traversals: [Box<TraversalScratch>; TRAVERSALS],
    /// The rays of the packet whose hits are being refined.
    previous: RayPacket,
    batches: HitBatches,
    pub surfaces: SurfaceIntersector,
    pub ray_sort: RaySort,
}

impl Default for CastScratch {
    fn default() -> Self {
        CastScratch {
            traversals: std::array::from_fn(|_| Box::new(TraversalScratch::new())),
            previous: RayPacket::empty(),
            batches: HitBatches::new(),
            surfaces: SurfaceIntersector::new(),
            ray_sort: RaySort::default(),
        }
    }
}

/// The source of packets: rays yet to be traced, in the order of the ray sort.
pub struct PacketSource<'a> {
    rays: Rays<'a>,
    ray_sort: &'a mut RaySort,
    /// How many rays of the last sort are already in packets, and where these rays begin.
    start: usize,
    done: usize,
}

impl<'a> PacketSource<'a> {
    pub fn new(world: &World, rays: Rays<'a>, ray_sort: &'a mut RaySort) -> Self {
        ray_sort.restart(&rays, (world.number, world.size));
        PacketSource { rays, ray_sort, start: 0, done: 0 }
    }

    /// Gathers the next packet, or a single ray that does not fit into packets (`count` is 0); false if no
    /// rays remain. Clears the hits of the rays that it sorts.
    #[inline(always)]
    pub fn next_packet<I: Isa>(&mut self, packet: &mut RayPacket, hits: &mut (impl Sink + ?Sized)) -> bool {
        let end = self.ray_sort.indices().len();
        if self.start == end {
            if !self.ray_sort.advance::<I>(self.rays.origins, self.rays.directions) {
                return false;
            }
            (self.start, self.done) = (0, self.done + end);
            hits.clear(self.done..self.done + self.ray_sort.indices().len());
        }
        let order = &self.ray_sort.indices()[self.start..];
        packet.gather::<I>(self.rays.origins, self.rays.directions, order, self.ray_sort.has_one_origin());
        let taken = packet.count.max(1);
        self.start += taken;
        if !self.rays.times.is_empty() {
            for lane in 0..taken {
                packet.time[lane] = self.rays.times[packet.at[lane] as usize];
            }
        }
        true
    }
}

/// Routes closest hits to their refinement: `TriangleHits` for still triangles, batches for all others.
struct HitRouter<'a, S: ?Sized> {
    world: &'a World<'a>,
    batches: &'a mut HitBatches,
    hits: &'a mut S,
}

impl<'a, S: Sink + ?Sized> HitRouter<'a, S> {
    #[inline(always)]
    fn route<I: Isa>(&mut self, state: &PacketState, triangle_hits: &mut TriangleHits<'a>) {
        let PacketState { rays, closest, .. } = state;
        let (mut given, mut placed, mut left) = (0, 0, closest.hits::<I>());
        let object = |lane| &self.world.scene.objects()[closest.object(lane) as usize];
        if !S::ANY && left != 0 {
            // Most packets hit a single object.
            let first = left.trailing_zeros() as usize;
            let lanes = left & closest.lanes_on(closest.object(first));
            if object(first).is_untransformed_triangle() {
                given = lanes;
            } else if object(first).is_placed_triangle() {
                placed = lanes;
            }
            left &= !(given | placed);
        }
        if !S::ANY && left != 0 {
            for start in (0..LANES).step_by(BATCH_SIZE) {
                let lanes = left & all(BATCH_SIZE) << start;
                if lanes == 0 {
                    continue;
                }
                let first = object(lanes.trailing_zeros() as usize);
                if !first.is_untransformed_triangle() && !first.is_placed_triangle() {
                    left &= !self.batches.refine_neighbors::<I>(rays, closest, start, lanes, self.hits);
                }
            }
        }
        while let Some(lane) = take(&mut left) {
            if S::ANY {
                self.hits.write(rays.at[lane] as usize, Hit::UNREFINED);
            } else if object(lane).is_untransformed_triangle() {
                given |= 1 << lane;
            } else if object(lane).is_placed_triangle() {
                placed |= 1 << lane;
            } else {
                let (root, bounds) = (closest.root(lane), closest.bounds(lane));
                let bounded = BoundedHit { at: rays.at[lane], root, bounds, ray: timed_ray(rays, lane) };
                self.batches.push::<I>(self.world.scene, &bounded, self.hits);
            }
        }
        triangle_hits.gather(closest, given, placed);
    }

    /// Traces a ray that does not fit into packets; false if it is illegal.
    fn trace_single(&mut self, traversal: &mut Traversal, range: TRange) -> bool {
        let rays = &traversal.state.rays;
        let (at, ray) = (rays.at[0] as usize, timed_ray(rays, 0));
        let legal =
            ray.origin.iter().chain(&ray.direction).all(|x| x.is_finite()) && ray.direction != [0.0; 3];
        if legal {
            let scene = self.world.scene;
            let mut closest = ClosestHit::new(scene, ray, range, S::ANY);
            closest.run(self.world, traversal.stack());
            if let Some((root, bounds)) = closest.hit() {
                let hit = if S::ANY { Hit::UNREFINED } else { scene.hit_within(&root, bounds, &ray) };
                self.hits.write(at, hit);
            }
        }
        legal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, dispatch};
    use crate::cast::columns::HitArrays;
    use crate::geometry::vector::Point;
    use crate::scene::tests::{FLAT, object, tipped};
    use crate::scene::{RootId, Scene};
    use crate::testing::with_large_frames;

    impl World<'_> {
        /// As [`Cast`], compiled for `level`.
        pub fn cast(&self, level: Level, rays: Rays, range: TRange, hits: &mut impl Sink) -> bool {
            dispatch(level, Cast { world: self, rays, range, hits })
        }
    }

    /// Straight down on the points of a grid, some on the edges: the weight of the last vertex there is y/8,
    /// exactly.
    fn rays() -> (Vec<Point>, Vec<Point>) {
        let points = (0..81).map(|k| [k % 9, k / 9].map(f64::from)).filter(|[x, y]| x + y <= 8.0);
        let origins: Vec<Point> = points.map(|[x, y]| [x, y, 3.0]).collect();
        let directions = vec![[0.0, 0.0, -1.0]; origins.len()];
        (origins, directions)
    }

    #[test]
    fn of_two_triangles_in_nearly_one_plane_the_upper_is_hit_and_else_the_lowest() {
        with_large_frames(cast_at_two_triangles);
    }

    fn cast_at_two_triangles() {
        let (origins, directions) = rays();
        let (mut ties, mut upper) = (0, 0);
        for z in [1.0, 1.0_f64.next_up(), 1.0_f64.next_down(), 1.5, 0.5] {
            for others in [[0, 0], [0, 9], [9, 0], [20, 3]] {
                let objects = vec![object(FLAT, others[0]), object(tipped(z), others[1])];
                for swapped in [false, true] {
                    let mut objects = objects.clone();
                    if swapped {
                        objects.reverse();
                    }
                    let scene = Scene::new(objects);
                    let at = [0, 1].map(|i: usize| {
                        RootId::of_triangle(i as u32, others[i ^ usize::from(swapped)] as u32)
                    });
                    for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                        let mut hits = HitArrays::of(origins.len());
                        let (world, rays) = (scene.during([0.0; 2]), Rays::new(&origins, &directions, &[]));
                        assert!(world.cast(level, rays, TRange::RAY, &mut hits.columns()));
                        for (hit, o) in hits.iter().zip(&origins) {
                            // The surfaces differ where the last vertex has a weight.
                            let tie = z == 1.0 || o[1] == 0.0;
                            let first = if tie { 0 } else { i32::from((z > 1.0) != swapped) };
                            let RootId { object, primitive, .. } = at[first as usize];
                            assert_eq!(
                                (hit.object, hit.primitive),
                                (object as i32, primitive as i32),
                                "{level:?} {z} {o:?}"
                            );
                            ties += usize::from(tie);
                            upper += usize::from(!tie && first == 1);
                        }
                    }
                }
            }
        }
        assert!(ties > 500 && upper > 500, "{ties}, {upper}");
    }

    #[test]
    fn rays_that_hit_nothing_are_misses_whatever_was_there_before() {
        with_large_frames(|| {
            let scene = Scene::new(vec![object(FLAT, 9)]);
            let (mut origins, mut directions) = rays();
            let hitting = origins.len();
            // Rays next to the triangle and away from it, one that does not fit into packets, and an illegal
            // one.
            for (origin, direction) in
                [([-1.0, 2.0, 3.0], [0.0, 0.0, -1.0]), ([1.0, 2.0, 3.0], [0.0, 0.0, 1.0])]
            {
                origins.extend(vec![origin; 700]);
                directions.extend(vec![direction; 700]);
            }
            origins.extend([[1e40; 3], [f64::NAN; 3]]);
            directions.extend([[1.0; 3]; 2]);
            for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                let before = Hit { t: 7.0, normal: [7.0; 3], object: 7, primitive: 7 };
                let mut hits = HitArrays::of(origins.len());
                (0..origins.len()).for_each(|i| hits.columns().write(i, before));
                let (world, rays) = (scene.during([0.0; 2]), Rays::new(&origins, &directions, &[]));
                assert!(!world.cast(level, rays, TRange::RAY, &mut hits.columns()));
                for (i, hit) in hits.iter().enumerate() {
                    let Hit { t, normal, object, primitive } = hit;
                    let is_miss = (t, normal, object, primitive) == (f64::INFINITY, [0.0; 3], -1, 0);
                    assert!(is_miss != (i < hitting) && hit.t != before.t, "{level:?}, {i}: {hit:?}");
                }
            }
        });
    }
}
