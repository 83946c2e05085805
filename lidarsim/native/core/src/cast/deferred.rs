//! Deferred candidates: pairs of a ray and a triangle that the quantized test in a leaf left uncertain.
//! Expansions test eight at a time with the vertices as given: first t, which rules out most triangles that
//! a ray in their plane passes over, then the sides. Sides that remain open are decided exactly, and where t
//! remains uncertain, the filtered predicates decide.

use crate::arith::expansion::Expansion;
use crate::arith::number::Interval;
use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::bvh::{Mask, RayPacket};
use crate::cast::closest_hit::ClosestHits;
use crate::geometry::affine::Inverse;
use crate::geometry::ray::Ray;
use crate::scene::{RootId, Scene};
use crate::shapes::triangle::{Corners, Crossing, NOWHERE, TrianglePlane, corners_of, placed_sides, sides};

/// A queue of pairs of a ray and a triangle, of untransformed meshes or of one mesh under a map that is not
/// extreme. Their vertices are prefetched while they wait.
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

    /// Whether the queue has to be resolved before it takes a triangle of this object.
    #[inline(always)]
    pub fn is_full(&self, scene: &Scene, object: u32) -> bool {
        let is_given = |id: u32| scene.objects()[id as usize].is_untransformed();
        let first = self.root[0].object;
        self.count == CAPACITY || self.count > 0 && object != first && !(is_given(object) && is_given(first))
    }

    #[inline(always)]
    pub fn push<I: Isa>(&mut self, scene: &Scene, lane: usize, root: RootId) {
        scene.objects()[root.object as usize].prefetch_face::<I>(root.primitive);
        (self.lane[self.count], self.root[self.count]) = (lane as u8, root);
        self.count += 1;
    }

    /// Tests the pairs, updates the closest hits of their rays, and empties the queue. Returns the rays whose
    /// limits may have decreased.
    #[inline(always)]
    pub fn resolve<I: Isa>(&mut self, scene: &Scene, rays: &RayPacket, closest: &mut ClosestHits) -> Mask {
        if self.count > 0 { I::call(Resolve { deferred: self, scene, rays, closest }) } else { 0 }
    }
}

struct Resolve<'t, 'a> {
    deferred: &'t mut DeferredCandidates,
    scene: &'t Scene,
    rays: &'t RayPacket,
    closest: &'t mut ClosestHits<'a>,
}

impl Task for Resolve<'_, '_> {
    type Output = Mask;

    #[inline(always)]
    fn run<I: Isa>(self) -> Mask {
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
        let object = &scene.objects()[root[0].object as usize];
        let inverse = object.inverse().and_then(Inverse::expanded);
        let (mut bounds, mut known, mut kept) = ([Interval::point(0.0); CAPACITY], 0_u32, 0);
        for eight in 0..count.div_ceil(8) {
            let triangles = corners_of::<I>(&corners.as_chunks().0[eight]);
            let (o, d) = (lanes::part(&origin, eight), lanes::part(&direction, eight));
            let (plane, seen_o, seen_d) = match inverse {
                Some(inverse) => {
                    let (from, to) = (inverse.points::<I>(o), inverse.vectors::<I>(d));
                    let plane = TrianglePlane::of_placed(triangles, inverse, from);
                    (plane, (Expansion::highs(from.0), from.1), (Expansion::highs(to.0), to.1))
                }
                None => {
                    let plane = TrianglePlane::<I>::new(triangles, o);
                    (plane, (o, lanes::splat([0.0; 3])), (d, lanes::abs(d)))
                }
            };
            let crossing = Crossing::<I>::grazing(&plane, d);
            let outside = crossing.outside(triangles, seen_o, seen_d);
            let (t, sure) = crossing.bounds();
            let (low, high) = (t.low.store(), t.high.store());
            for k in 8 * eight..(*count).min(8 * eight + 8) {
                let (t, bit) = (Interval { low: low[k % 8], high: high[k % 8] }, 1 << (k % 8));
                if outside & bit != 0 || sure & bit != 0 && closest.excludes(usize::from(lane[k]), t) {
                    continue;
                }
                (lane[kept], root[kept], corners[kept], bounds[kept]) = (lane[k], root[k], corners[k], t);
                for axis in 0..3 {
                    (origin[axis][kept], direction[axis][kept]) = (origin[axis][k], direction[axis][k]);
                }
                known |= u32::from(sure & bit != 0) << kept;
                kept += 1;
            }
        }
        let mut nearer = 0;
        for eight in 0..kept.div_ceil(8) {
            let triangles = corners_of::<I>(&corners.as_chunks().0[eight]);
            let (o, d) = (lanes::part(&origin, eight), lanes::part(&direction, eight));
            let mut sides = match inverse {
                Some(inverse) => {
                    placed_sides::<I>(triangles, inverse.points::<I>(o), inverse.vectors::<I>(d))
                }
                None => sides::<I>(triangles, o, d),
            };
            let mut unsure = sides.unsure() & ((1 << (kept - 8 * eight).min(8)) - 1);
            while unsure != 0 {
                let k = unsure.trailing_zeros() as usize;
                unsure &= unsure - 1;
                let lane = usize::from(lane[8 * eight + k]);
                let ray = Ray::new(rays.origin(lane), rays.direction(lane));
                sides.decide(k, corners[8 * eight + k], &object.at(rays.time[lane]).local(ray));
            }
            let (hit, missed) = sides.hit_and_missed();
            for k in 8 * eight..kept.min(8 * eight + 8) {
                let (lane, root, bit) = (usize::from(lane[k]), root[k], 1 << (k % 8));
                if hit & bit != 0 && known >> k & 1 != 0 {
                    nearer |= Mask::from(closest.accept_only(rays, lane, root, bounds[k])) << lane;
                } else if missed & bit == 0 {
                    closest.intersect_exactly(rays, lane, root.object, root.primitive);
                    nearer |= 1 << lane;
                }
            }
        }
        *count = 0;
        nearer
    }
}
