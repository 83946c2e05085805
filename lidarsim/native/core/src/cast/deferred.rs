//! Triangles of which a leaf could not tell whether a ray meets them: it sees them on a grid. Eight such pairs are looked at side by side, in the
//! numbers that were given and with twice the digits of float64; what they cannot tell is decided exactly.

use crate::arith::number::Interval;
use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::bvh::RayPacket;
use crate::cast::closest_hit::ClosestHits;
use crate::scene::{RootId, Scene};
use crate::shapes::triangle::{Corners, Crossing, NOWHERE, corners_of, sides};

/// Pairs of a ray and a triangle, in which the triangle is not moved. They wait until there are many, while their vertices come.
pub struct DeferredCandidates {
    count: usize,
    lane: [u8; WAITING],
    place: [RootId; WAITING],
}

const WAITING: usize = 32;

impl DeferredCandidates {
    pub fn new() -> Self {
        DeferredCandidates { count: 0, lane: [0; WAITING], place: [RootId::of_triangle(0, 0); WAITING] }
    }

    /// Whether there is room for no more.
    #[inline(always)]
    pub fn are_full(&self) -> bool {
        self.count == WAITING
    }

    #[inline(always)]
    pub fn push<I: Isa>(&mut self, scene: &Scene, lane: usize, place: RootId) {
        scene.objects()[place.object as usize].prefetch_face::<I>(place.primitive);
        (self.lane[self.count], self.place[self.count]) = (lane as u8, place);
        self.count += 1;
    }

    /// Offers those triangles that their rays meet to the searches of these.
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
        let Resolve { deferred: DeferredCandidates { count, lane, place }, scene, rays, closest } = self;
        let mut corners: Corners<WAITING> = [[NOWHERE; 3]; WAITING];
        let (mut origin, mut direction) = ([[0.0; WAITING]; 3], [[0.0; WAITING]; 3]);
        for k in 0..*count {
            let (lane, place) = (usize::from(lane[k]), &place[k]);
            corners[k] = scene.objects()[place.object as usize].corners(place.primitive);
            for corner in corners[k] {
                I::prefetch(corner);
            }
            for axis in 0..3 {
                origin[axis][k] = rays.origin[axis][lane];
                direction[axis][k] = rays.direction[axis][lane];
            }
        }
        for eight in 0..count.div_ceil(8) {
            let corners = corners_of::<I>(&corners.as_chunks().0[eight]);
            let (o, d) = (lanes::part(&origin, eight), lanes::part(&direction, eight));
            let (met, missed) = sides::<I>(corners, o, d);
            let (t, known) = Crossing::<I>::new(corners, o, d).bounds();
            let (low, high) = (t.low.store(), t.high.store());
            for k in 8 * eight..(*count).min(8 * eight + 8) {
                let (lane, place, bit) = (usize::from(lane[k]), place[k], 1 << (k % 8));
                if met & known & bit != 0 {
                    closest.offer(rays, lane, place, Interval { low: low[k % 8], high: high[k % 8] });
                } else if missed & bit == 0 {
                    closest.consider(rays, lane, place.object, place.primitive);
                }
            }
        }
        *count = 0;
    }
}
