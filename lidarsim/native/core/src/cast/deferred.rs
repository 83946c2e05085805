//! Deferred candidates: pairs of a ray and a triangle that the quantized test in a leaf left uncertain.
//! Expansions test eight at a time with the vertices as given. Sides that remain open are decided exactly,
//! and where t remains uncertain, the filtered predicates decide.

use crate::arith::number::Interval;
use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::bvh::RayPacket;
use crate::cast::closest_hit::ClosestHits;
use crate::geometry::ray::Ray;
use crate::scene::{RootId, Scene};
use crate::shapes::triangle::{Corners, Crossing, NOWHERE, TrianglePlane, corners_of, sides};

/// A queue of pairs of a ray and a triangle of an untransformed mesh. Their vertices are prefetched while
/// they wait.
pub struct DeferredCandidates {
    count: usize,
    lane: [u8; CAPACITY],
    root: [RootId; CAPACITY],
}

const CAPACITY: usize = 32;

impl DeferredCandidates {
    pub fn new() -> Self {
        DeferredCandidates { count: 0, lane: [0; CAPACITY], root: [RootId::of_triangle(0, 0); CAPACITY] }
    }

    /// Whether the queue is full.
    #[inline(always)]
    pub fn is_full(&self) -> bool {
        self.count == CAPACITY
    }

    #[inline(always)]
    pub fn push<I: Isa>(&mut self, scene: &Scene, lane: usize, root: RootId) {
        scene.objects()[root.object as usize].prefetch_face::<I>(root.primitive);
        (self.lane[self.count], self.root[self.count]) = (lane as u8, root);
        self.count += 1;
    }

    /// Tests the pairs, updates the closest hits of their rays, and empties the queue.
    #[inline(always)]
    pub fn resolve<I: Isa>(&mut self, scene: &Scene, rays: &RayPacket, closest: &mut ClosestHits) {
        if self.count > 0 {
            I::call(Resolve { deferred: self, scene, rays, closest });
        }
    }
}

struct Resolve<'t, 'a> {
    deferred: &'t mut DeferredCandidates,
    scene: &'t Scene,
    rays: &'t RayPacket,
    closest: &'t mut ClosestHits<'a>,
}

impl Task for Resolve<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let Resolve { deferred: DeferredCandidates { count, lane, root }, scene, rays, closest } = self;
        let mut corners: Corners<CAPACITY> = [[NOWHERE; 3]; CAPACITY];
        let (mut origin, mut direction) = ([[0.0; CAPACITY]; 3], [[0.0; CAPACITY]; 3]);
        for k in 0..*count {
            let (lane, root) = (usize::from(lane[k]), &root[k]);
            corners[k] = scene.objects()[root.object as usize].corners(root.primitive);
            for corner in corners[k] {
                I::prefetch(corner);
            }
            for axis in 0..3 {
                origin[axis][k] = rays.origin[axis][lane];
                direction[axis][k] = rays.direction[axis][lane];
            }
        }
        for eight in 0..count.div_ceil(8) {
            let triangles = corners_of::<I>(&corners.as_chunks().0[eight]);
            let (o, d) = (lanes::part(&origin, eight), lanes::part(&direction, eight));
            let mut sides = sides::<I>(triangles, o, d);
            let mut unsure = sides.unsure() & ((1 << (*count - 8 * eight).min(8)) - 1);
            while unsure != 0 {
                let k = unsure.trailing_zeros() as usize;
                unsure &= unsure - 1;
                let lane = usize::from(lane[8 * eight + k]);
                sides.decide(k, corners[8 * eight + k], &Ray::new(rays.origin(lane), rays.direction(lane)));
            }
            let (hit, missed) = sides.hit_and_missed();
            let (t, known) = Crossing::<I>::new(&TrianglePlane::new(triangles, o), d).bounds();
            let (low, high) = (t.low.store(), t.high.store());
            for k in 8 * eight..(*count).min(8 * eight + 8) {
                let (lane, root, bit) = (usize::from(lane[k]), root[k], 1 << (k % 8));
                if hit & known & bit != 0 {
                    closest.accept_only(rays, lane, root, Interval { low: low[k % 8], high: high[k % 8] });
                } else if missed & bit == 0 {
                    closest.intersect_exactly(rays, lane, root.object, root.primitive);
                }
            }
        }
        *count = 0;
    }
}
