//! The instances that rays meet, each as if it stood alone.

use std::ops::Range;

use crate::arith::simd::{Isa, Task};
use crate::bvh::Stack;
use crate::cast::all_hits::roots_in_range;
use crate::cast::closest_hit::timed_ray;
use crate::cast::driver::{POLL, PacketSource, SCRATCH};
use crate::cast::instances_met::{InstancesMet, NO_INSTANCE};
use crate::cast::ray_query::RayQuery;
use crate::cast::traversal::{Advance, Traversal};
use crate::memory;
use crate::scene::{Hit, Rays, Scene, Sink, TRange, TimedRay, World};
use crate::stop;

/// Appends the instances that each ray meets with t_min ≤ t ≤ t_max, at the time of the ray: pairs of the
/// indices of ray and instance, each pair once, in any order. An instance is any number of objects. A ray
/// with a number that is not finite or a zero direction meets none.
pub struct MeetInstances<'a> {
    pub world: &'a World<'a>,
    pub rays: Rays<'a>,
    pub range: TRange,
    /// The instance of each object of the scene, or `NO_INSTANCE`.
    pub instances: &'a [u32],
    /// How many instances there are.
    pub count: usize,
    /// Per ray, an instance that it is not tested for, or `NO_INSTANCE`.
    pub known: &'a [u32],
    pub pairs: &'a mut Vec<(u32, u32)>,
}

impl Task for MeetInstances<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let MeetInstances { world, rays, range, instances, count, known, pairs } = self;
        let mut scratch = SCRATCH.take().unwrap_or_default();
        let scratch_parts = &mut *scratch;
        let (traversals, surfaces) = (&mut scratch_parts.traversals, &mut scratch_parts.surfaces);
        let mut source = PacketSource::new(world, rays, &mut scratch_parts.ray_sort);
        let mut traversals = traversals.each_mut().map(|scratch| {
            let mut traversal = Traversal::new(world, range, true, scratch);
            traversal.state.instances = Some(InstancesMet::new(instances, count));
            traversal
        });
        for turn in 0_usize.. {
            for traversal in &mut traversals {
                while traversal.is_idle() && source.next_packet::<I>(traversal.state.rays, &mut NoHits) {
                    let rays = &traversal.state.rays;
                    if rays.count == 0 {
                        let (at, ray) = (rays.at[0], timed_ray(rays, 0));
                        let query = OfOneRay { scene: world.scene, ray, range, instances, found: Vec::new() };
                        query.append(world, traversal.stack(), (at, known[at as usize]), pairs);
                        continue;
                    }
                    let (at, count) = (rays.at, rays.count);
                    if let Some(met) = &mut traversal.state.instances {
                        met.restart(at[..count].iter().map(|ray| known[*ray as usize]));
                    }
                    traversal.make_ready();
                }
            }
            if turn.is_multiple_of(POLL) {
                stop::poll();
            }
            let Some(k) = I::call(Advance { traversals: &mut traversals, surfaces }) else { break };
            let state = &mut traversals[k].state;
            if let Some(met) = &state.instances {
                met.append(&state.rays.at, pairs);
            }
        }
        SCRATCH.set(Some(scratch));
    }
}

/// Receives nothing.
struct NoHits;

impl Sink for NoHits {
    fn clear(&mut self, _: Range<usize>) {}
    fn write(&mut self, _: usize, _: Hit) {}
}

/// The instances that one ray meets.
struct OfOneRay<'a> {
    scene: &'a Scene,
    ray: TimedRay,
    range: TRange,
    instances: &'a [u32],
    found: Vec<u32>,
}

impl OfOneRay<'_> {
    /// Appends (ray, instance) pairs, except the known instance.
    fn append(
        mut self,
        world: &World,
        stack: &mut Stack,
        (at, known): (u32, u32),
        pairs: &mut Vec<(u32, u32)>,
    ) {
        let TimedRay { origin, direction, .. } = self.ray;
        if origin.iter().chain(&direction).all(|x| x.is_finite()) && direction != [0.0; 3] {
            self.range.max = self.range.max.min(f64::MAX);
            self.run(world, stack);
        }
        for instance in self.found {
            if instance != known {
                memory::push(pairs, (at, instance));
            }
        }
    }
}

impl<'a> RayQuery<'a> for OfOneRay<'a> {
    fn scene(&self) -> &'a Scene {
        self.scene
    }

    fn ray(&self) -> &TimedRay {
        &self.ray
    }

    fn t_min(&self) -> f64 {
        self.range.min
    }

    fn limit(&self) -> f64 {
        self.range.max
    }

    fn visit(&mut self, object: u32, primitive: u32) {
        let instance = self.instances[object as usize];
        if instance != NO_INSTANCE
            && !self.found.contains(&instance)
            && roots_in_range(self.scene, &self.ray, self.range, object, primitive).next().is_some()
        {
            memory::push(&mut self.found, instance);
        }
    }
}
