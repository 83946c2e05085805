//! The primitive intersector: tests rays of a packet against the shapes in the leaves of an object that holds
//! many. One test of a ray against eight shapes rules out most, and bounds the roots on most others.

use std::marker::PhantomData;

use crate::arith::number::Interval;
use crate::arith::simd::{Floats, Isa};
use crate::bvh::{LANES, MAX_LEAF_SIZE, Mask, RayPacket, Stack, Visitor, take};
use crate::cast::closest_hit::ClosestHits;
use crate::scene::{PrimitiveLeaf, RootId};
use crate::shapes::{Each, EachCrossings, EachRay};

/// Intersects rays of one octant, in the local coordinates of an object, with the leaves of its hierarchy.
pub struct PrimitiveIntersector<'a, 's, S, const K: usize> {
    pub id: u32,
    pub rays: &'a RayPacket,
    /// The same rays in world coordinates.
    pub world: &'a RayPacket,
    pub closest: &'a mut ClosestHits<'s>,
    pub kind: PhantomData<S>,
}

impl<S: Each<K>, const K: usize> PrimitiveIntersector<'_, '_, S, K> {
    /// Intersects these rays with a leaf, and returns the mask of those whose limits may have decreased.
    #[inline(always)]
    pub fn intersect<I: Isa>(&mut self, leaf: &PrimitiveLeaf<K>, mask: Mask) -> Mask {
        let (mut nearer, mut others) = (0, mask);
        while others != 0 {
            let first = others.trailing_zeros() as usize;
            let mut left = others & self.rays.run_from(first);
            others &= !left;
            let seen = S::seen_from::<I>(self.rays.origin(first), &leaf.numbers);
            // All rays are tested before any result is used, so no branch depends on a single test.
            let (mut lanes, mut candidates, mut count) = ([0; LANES], [0; LANES], 0);
            while let Some(lane) = take(&mut left) {
                let met = S::candidates(&seen, &self.ray(lane)) & leaf.all();
                (lanes[count], candidates[count]) = (lane as u8, met as u8);
                count += usize::from(met != 0);
            }
            for k in 0..count {
                nearer |= self.accept::<I>(&seen, leaf, lanes[k].into(), candidates[k].into());
            }
        }
        nearer
    }

    #[inline(always)]
    fn ray(&self, lane: usize) -> EachRay {
        let RayPacket { length, origin_error, direction_error, .. } = self.rays;
        EachRay::new(self.rays.direction(lane), length[lane], origin_error[lane], direction_error[lane])
    }

    /// Updates the closest hit of a ray from the shapes of a leaf that it may meet. Returns whether its limit
    /// may have decreased, as a mask.
    #[inline(always)]
    fn accept<I: Isa>(
        &mut self,
        seen: &S::Seen<I>,
        leaf: &PrimitiveLeaf<K>,
        lane: usize,
        mut candidates: Mask,
    ) -> Mask {
        let EachCrossings { certain, t } = S::crossings(seen, &self.ray(lane));
        let mut bounds = [[[0.0; MAX_LEAF_SIZE]; 2]; 2];
        for k in 0..S::ROOTS {
            bounds[k] = [t[k].low.store(), t[k].high.store()];
        }
        let mut nearer = 0;
        while let Some(i) = take(&mut candidates) {
            let primitive = leaf.id(i);
            let mut is_sure = certain & 1 << i != 0;
            for k in 0..S::ROOTS {
                let t = self.rays.t_of_ray(lane, Interval { low: bounds[k][0][i], high: bounds[k][1][i] });
                if !is_sure || t.high < self.closest.t_min() {
                    continue;
                }
                // If the root may be too early, the exact test also decides whether the next one counts.
                is_sure = self.closest.t_min() <= t.low;
                if is_sure {
                    let root = RootId { object: self.id, primitive, index: k as u8, feature: 0 };
                    nearer |= Mask::from(self.closest.accept_only(self.world, lane, root, t)) << lane;
                    break;
                }
            }
            if !is_sure {
                self.closest.intersect(self.world, lane, self.id, primitive);
                nearer |= 1 << lane;
            }
        }
        nearer
    }
}

impl<S: Each<K>, const K: usize> Visitor<PrimitiveLeaf<K>> for PrimitiveIntersector<'_, '_, S, K> {
    #[inline(always)]
    fn visit<I: Isa>(&mut self, _: &mut Stack, lanes: &[usize], leaves: &[&PrimitiveLeaf<K>]) -> Mask {
        let mut nearer = 0;
        for (&lane, leaf) in lanes.iter().zip(leaves) {
            let seen = S::seen_from::<I>(self.rays.origin(lane), &leaf.numbers);
            let met = S::candidates(&seen, &self.ray(lane)) & leaf.all();
            if met != 0 {
                nearer |= self.accept::<I>(&seen, leaf, lane, met.into());
            }
        }
        nearer
    }

    #[inline(always)]
    fn limits(&self) -> &[f64; LANES] {
        self.closest.limits()
    }
}
