//! Closest-hit queries: of one ray, and of the rays of a packet, one per lane.

use std::cmp::Ordering;

use crate::arith::number::{self, Interval};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::bvh::{LANES, Mask, RayPacket, Stack, take};
use crate::cast::ray_query::RayQuery;
use crate::scene::{BoundedRoot, RootId, Scene, TRange, TimedRay};
use crate::shapes::MOST_ROOTS;

/// The closest-hit query of one ray.
pub struct ClosestHit<'a> {
    scene: &'a Scene,
    ray: TimedRay,
    range: TRange,
    cap: f64,
    /// The closest hit so far, if `low` is finite; its t lies between `low` and `limit`.
    root: RootId,
    low: f64,
    limit: f64,
}

/// Excludes t beyond float64, which is a miss.
fn finite(range: TRange) -> TRange {
    TRange { max: range.max.min(f64::MAX), ..range }
}

/// The largest limit of t after a hit; −∞ for any-hit queries, which then stop.
fn cap(any: bool) -> f64 {
    if any { f64::NEG_INFINITY } else { f64::INFINITY }
}

impl<'a> ClosestHit<'a> {
    /// `any` makes it an any-hit query, which only tells whether there is a hit.
    pub fn new(scene: &'a Scene, ray: TimedRay, range: TRange, any: bool) -> Self {
        let (range, root) = (finite(range), RootId::of_triangle(0, 0));
        ClosestHit { scene, ray, range, cap: cap(any), root, low: f64::INFINITY, limit: range.max }
    }

    /// The closest hit, with bounds of t.
    pub fn hit(&self) -> Option<BoundedRoot> {
        if self.low < f64::INFINITY { Some((self.root, bounds(self.low, self.limit))) } else { None }
    }

    /// Keeps the primitive's first hit in range if it is the closest so far.
    fn intersect(&mut self, id: u32, primitive: u32) {
        self.accept_first(number::decide(&self.scene.root_intervals(id, primitive, &self.ray)));
    }

    /// As `intersect`, without the float64 stage.
    fn intersect_exactly(&mut self, id: u32, primitive: u32) {
        self.accept_first(number::decide_exactly(&self.scene.root_intervals(id, primitive, &self.ray)));
    }

    fn accept_first(&mut self, found: [Option<BoundedRoot>; MOST_ROOTS]) {
        for &(at, t) in found.iter().flatten() {
            if self.accept(at, t) {
                return;
            }
        }
    }

    /// Keeps a hit, with bounds of t, if it is in range and the closest so far. Returns whether t ≥ t_min,
    /// which makes later hits of the same primitive irrelevant.
    fn accept(&mut self, at: RootId, t: Interval) -> bool {
        // The range applies to the rounded t. Rounding is monotone, so bounds of t decide except within the
        // last ulps.
        if t.high < self.range.min || (t.low < self.range.min && self.is_early(at)) {
            return false;
        }
        if t.low > self.limit || (t.high > self.range.max && self.rounded_t(at) > self.range.max) {
            return true;
        }
        if t.high < self.low || self.hit().is_none() || self.is_before(at) {
            let high = if t.high < self.range.max { t.high } else { self.range.max };
            (self.root, self.low, self.limit) = (at, t.low, if high < self.cap { high } else { self.cap });
        }
        true
    }

    fn rounded_t(&self, at: RootId) -> f64 {
        self.scene.t(&at, &self.ray)
    }

    /// Whether the rounded t is below t_min. A negative t is, even if it rounds to zero.
    fn is_early(&self, at: RootId) -> bool {
        let t = self.rounded_t(at);
        t < self.range.min || t == 0.0 && self.range.min == 0.0 && self.scene.is_negative(&at, &self.ray)
    }

    fn is_before(&self, at: RootId) -> bool {
        let best = &self.root;
        match self.scene.compare(&at, best, &self.ray) {
            Ordering::Less => true,
            Ordering::Equal => (at.object, at.primitive) < (best.object, best.primitive),
            Ordering::Greater => false,
        }
    }
}

impl<'a> RayQuery<'a> for ClosestHit<'a> {
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
        self.limit
    }

    fn visit(&mut self, object: u32, primitive: u32) {
        self.intersect(object, primitive);
    }
}

/// A ray of a packet.
#[inline(always)]
pub fn timed_ray(rays: &RayPacket, lane: usize) -> TimedRay {
    TimedRay { origin: rays.origin(lane), direction: rays.direction(lane), time: rays.time[lane] }
}

/// The rounded t is in range, so t itself may exceed the limit by less than an ulp.
#[inline(always)]
fn bounds(low: f64, limit: f64) -> Interval {
    Interval { low, high: limit.next_up() }
}

/// The effect of a root on eight rays: the lanes whose limits may have decreased, and those with t < t_min,
/// where later hits of the same primitive may be in range.
pub struct Accepted {
    pub nearer: u32,
    pub early: u32,
}

/// The index of the root on its primitive, and the feature.
#[inline(always)]
fn part(root: &RootId) -> u32 {
    u32::from_le_bytes([root.index, root.feature, 0, 0])
}

/// The closest-hit queries of the rays of a packet, one per lane, with the results of single `ClosestHit`s.
#[repr(C, align(64))]
pub struct ClosestHits<'a> {
    low: [f64; LANES],
    limit: [f64; LANES],
    object: [u32; LANES],
    primitive: [u32; LANES],
    /// The index of the root, and 2⁸ times the feature.
    part: [u32; LANES],
    scene: &'a Scene,
    range: TRange,
    cap: f64,
}

impl<'a> ClosestHits<'a> {
    pub fn new(scene: &'a Scene, range: TRange, any: bool) -> Self {
        ClosestHits {
            low: [f64::INFINITY; LANES],
            limit: [0.0; LANES],
            object: [0; LANES],
            primitive: [0; LANES],
            part: [0; LANES],
            scene,
            range: finite(range),
            cap: cap(any),
        }
    }

    /// Restarts for other rays.
    #[inline(always)]
    pub fn restart<I: Isa>(&mut self) {
        for eight in 0..LANES / 8 {
            self.low.as_chunks_mut().0[eight] = I::F64x8::splat(f64::INFINITY).store();
            self.limit.as_chunks_mut().0[eight] = I::F64x8::splat(self.range.max).store();
        }
    }

    #[inline(always)]
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    #[inline(always)]
    pub fn t_min(&self) -> f64 {
        self.range.min
    }

    /// Upper bounds of the closest t: the limits of traversal.
    #[inline(always)]
    pub fn limits(&self) -> &[f64; LANES] {
        &self.limit
    }

    /// Objects and primitives of the closest hits.
    #[inline(always)]
    pub fn objects_and_primitives(&self) -> ([u32; LANES], [u32; LANES]) {
        (self.object, self.primitive)
    }

    /// Primitives of the closest hits.
    #[inline(always)]
    pub fn primitives(&self) -> &[u32; LANES] {
        &self.primitive
    }

    /// The lanes with a hit.
    #[inline(always)]
    pub fn hits<I: Isa>(&self) -> Mask {
        let mut found = 0;
        for (eight, low) in self.low.as_chunks().0.iter().enumerate() {
            found |= Mask::from(I::F64x8::load(low).lt(I::F64x8::splat(f64::INFINITY))) << (8 * eight);
        }
        found
    }

    /// The object of the closest hit of a lane.
    #[inline(always)]
    pub fn object(&self, lane: usize) -> u32 {
        self.object[lane]
    }

    /// The lanes whose closest hit, if any, is on this object.
    #[inline(always)]
    pub fn lanes_on(&self, object: u32) -> Mask {
        let mut lanes = 0;
        for (eight, objects) in self.object.as_chunks::<8>().0.iter().enumerate() {
            let mut on = 0;
            for (k, other) in objects.iter().enumerate() {
                on |= u32::from(*other == object) << k;
            }
            lanes |= Mask::from(on) << (8 * eight);
        }
        lanes
    }

    /// The lanes, of N from `N·i` on, whose closest hit, if any, is on the same feature of the same object
    /// as that of lane `first`.
    #[inline(always)]
    pub fn lanes_like<const N: usize>(&self, first: usize, i: usize) -> Mask {
        let (object, part) = (self.object[first], self.part[first]);
        let (objects, parts) = (&self.object.as_chunks::<N>().0[i], &self.part.as_chunks::<N>().0[i]);
        let mut lanes = 0;
        for k in 0..N {
            lanes |= Mask::from((objects[k] == object) & (parts[k] == part)) << k;
        }
        lanes << (N * i)
    }

    /// Bounds of t of the closest hit of a lane.
    #[inline(always)]
    pub fn bounds(&self, lane: usize) -> Interval {
        bounds(self.low[lane], self.limit[lane])
    }

    /// As `bounds`, for eight lanes. The upper bound is at least the next number above the limit, which is at
    /// most 2⁻⁵² of the limit away, or the smallest subnormal.
    #[inline(always)]
    pub fn bounds_of_eight<I: Isa>(&self, eight: usize) -> Interval<I::F64x8> {
        let limit: I::F64x8 = lanes::load(&self.limit, eight);
        let beyond = limit.abs().mul(I::F64x8::splat(f64::EPSILON)).add(I::F64x8::splat(f64::MIN_POSITIVE));
        Interval { low: lanes::load(&self.low, eight), high: limit.add(beyond) }
    }

    #[inline(always)]
    pub fn root(&self, lane: usize) -> RootId {
        let (object, primitive) = (self.object[lane], self.primitive[lane]);
        let [index, feature, ..] = self.part[lane].to_le_bytes();
        RootId { object, primitive, index, feature }
    }

    #[inline(always)]
    pub fn set_root(&mut self, lane: usize, root: RootId) {
        (self.object[lane], self.primitive[lane]) = (root.object, root.primitive);
        self.part[lane] = part(&root);
    }

    /// Whether a root with these bounds is certainly out of range or farther than the closest hit.
    #[inline(always)]
    pub fn excludes(&self, lane: usize, t: Interval) -> bool {
        self.limit[lane] < t.low || t.high < self.range.min
    }

    /// As `ClosestHit::accept`, for the only root of a primitive. Returns whether the limit may have
    /// decreased.
    #[inline(always)]
    pub fn accept_only(&mut self, rays: &RayPacket, lane: usize, at: RootId, t: Interval) -> bool {
        if self.excludes(lane, t) {
            return false;
        }
        if self.range.min <= t.low && t.high <= self.range.max && t.high < self.low[lane] {
            self.set_root(lane, at);
            (self.low[lane], self.limit[lane]) = (t.low, if t.high < self.cap { t.high } else { self.cap });
        } else {
            self.accept_exactly(rays, lane, at, t);
        }
        true
    }

    /// As `ClosestHit::accept`, for one root in these lanes of the eight.
    #[inline(always)]
    pub fn accept_eight<I: Isa>(
        &mut self,
        rays: &RayPacket,
        eight: usize,
        lanes: u32,
        at: RootId,
        t: Interval<I::F64x8>,
    ) -> Accepted {
        let (lows, limits) =
            (&mut self.low.as_chunks_mut().0[eight], &mut self.limit.as_chunks_mut().0[eight]);
        let (low, limit, t_min) =
            (I::F64x8::load(lows), I::F64x8::load(limits), I::F64x8::splat(self.range.min));
        let mut early = lanes & t.high.lt(t_min);
        let in_range = lanes & t_min.le(t.low);
        let farther = in_range & limit.lt(t.low);
        let nearer = in_range & !farther & t.high.le(I::F64x8::splat(self.range.max)) & t.high.lt(low);
        if nearer != 0 {
            *lows = I::pick(nearer, t.low, low).store();
            *limits = I::pick(nearer, Floats::min(t.high, I::F64x8::splat(self.cap)), limit).store();
            I::put(nearer, at.object, &mut self.object.as_chunks_mut().0[eight]);
            I::put(nearer, at.primitive, &mut self.primitive.as_chunks_mut().0[eight]);
            I::put(nearer, part(&at), &mut self.part.as_chunks_mut().0[eight]);
        }
        let near = lanes & !(early | farther);
        let mut left = Mask::from(near & !nearer);
        if left != 0 {
            let (low, high) = (t.low.store(), t.high.store());
            while let Some(k) = take(&mut left) {
                let accepted =
                    self.accept_exactly(rays, 8 * eight + k, at, Interval { low: low[k], high: high[k] });
                early |= u32::from(!accepted) << k;
            }
        }
        Accepted { nearer: near, early }
    }

    #[cold]
    #[inline(never)]
    fn accept_exactly(&mut self, rays: &RayPacket, lane: usize, at: RootId, t: Interval) -> bool {
        let mut closest = self.of_lane(rays, lane);
        let accepted = closest.accept(at, t);
        self.set_lane(lane, &closest);
        accepted
    }

    /// Keeps the primitive's first hit in range if it is the closest so far.
    #[inline(never)]
    pub fn intersect(&mut self, rays: &RayPacket, lane: usize, id: u32, primitive: u32) {
        let mut closest = self.of_lane(rays, lane);
        closest.intersect(id, primitive);
        self.set_lane(lane, &closest);
    }

    /// As `intersect`, for a primitive that float64 arithmetic could not decide.
    #[inline(never)]
    pub fn intersect_exactly(&mut self, rays: &RayPacket, lane: usize, id: u32, primitive: u32) {
        let mut closest = self.of_lane(rays, lane);
        closest.intersect_exactly(id, primitive);
        self.set_lane(lane, &closest);
    }

    /// As `RayQuery::enter`.
    pub fn enter(&mut self, rays: &RayPacket, lane: usize, id: u32, stack: &mut Stack) {
        let mut closest = self.of_lane(rays, lane);
        closest.enter(id, stack);
        self.set_lane(lane, &closest);
    }

    fn of_lane(&self, rays: &RayPacket, lane: usize) -> ClosestHit<'a> {
        let ClosestHits { scene, range, cap, .. } = *self;
        let (low, limit) = (self.low[lane], self.limit[lane]);
        ClosestHit { scene, ray: timed_ray(rays, lane), range, cap, root: self.root(lane), low, limit }
    }

    fn set_lane(&mut self, lane: usize, closest: &ClosestHit) {
        self.set_root(lane, closest.root);
        (self.low[lane], self.limit[lane]) = (closest.low, closest.limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, Portable, Task, dispatch};
    use crate::scene::{Geometry, Object, Scene};
    use crate::shapes::{AnySurface, Plane};
    use crate::testing::{numbers, with_large_frames};

    struct TakeEight<'a, 'b> {
        closest: &'b mut ClosestHits<'a>,
        rays: &'b RayPacket,
        eight: usize,
        lanes: u32,
        at: RootId,
        t: [Interval; 8],
    }

    impl Task for TakeEight<'_, '_> {
        type Output = Accepted;

        #[inline(always)]
        fn run<I: Isa>(self) -> Accepted {
            let TakeEight { closest, rays, eight, lanes, at, t } = self;
            let t =
                Interval { low: I::F64x8::load(&t.map(|t| t.low)), high: I::F64x8::load(&t.map(|t| t.high)) };
            closest.accept_eight::<I>(rays, eight, lanes, at, t)
        }
    }

    #[test]
    fn eight_rays_take_what_each_does() {
        with_large_frames(take_roots);
    }

    /// Roots on planes at whole t and next to them, with exact, close or wide bounds, so that some are
    /// clearly in range and closest, and others narrowly.
    fn take_roots() {
        let heights: Vec<f64> =
            [1.0, 2.0, 3.0, 4.0, 5.0].iter().flat_map(|t: &f64| [*t, t.next_up(), t + 0.5]).collect();
        let plane =
            |z: &f64| AnySurface::from(Plane::PointNormal { point: [0.0, 0.0, *z], normal: [0.0, 0.0, 1.0] });
        let scene =
            Scene::new(heights.iter().map(|z| Object::new(Geometry::Surface(plane(z)), false)).collect());
        let mut rays = RayPacket::empty();
        rays.count = LANES;
        (0..LANES).for_each(|lane| rays.set(lane, [0.0; 3], [0.0, 0.0, 1.0]));
        let (mut next, mut nearer, mut early, mut kept) = (numbers(), 0, 0, 0);
        for any in [false, true] {
            for level in Level::available() {
                for _ in 0..60 {
                    let new = || ClosestHits::new(&scene, TRange { min: 2.0, max: 4.0 }, any);
                    let (mut one_by_one, mut together) = (new(), new());
                    one_by_one.restart::<Portable>();
                    together.restart::<Portable>();
                    for _ in 0..20 {
                        let object = (heights.len() as f64 * next()) as usize;
                        let at = RootId {
                            object: object as u32,
                            primitive: 0,
                            index: 0,
                            feature: (3.0 * next()) as u8,
                        };
                        let (eight, lanes) = ((8.0 * next()) as usize, (256.0 * next()) as u32);
                        let t = [0; 8].map(|_: u8| {
                            let off = [0.0, f64::EPSILON * heights[object], 0.3][(3.0 * next()) as usize];
                            Interval { low: heights[object] - off, high: heights[object] + off }
                        });
                        let mut expected = 0;
                        for k in (0..8).filter(|k| lanes & 1 << k != 0) {
                            expected |=
                                u32::from(!one_by_one.accept_exactly(&rays, 8 * eight + k, at, t[k])) << k;
                        }
                        let before = together.limit;
                        let (closest, rays) = (&mut together, &rays);
                        let taken = dispatch(level, TakeEight { closest, rays, eight, lanes, at, t });
                        assert_eq!(taken.early, expected, "{level:?}");
                        for lane in 0..LANES {
                            let shorter = together.limit[lane] < before[lane];
                            assert!(!shorter || lane / 8 == eight && taken.nearer & 1 << (lane % 8) != 0);
                            nearer += usize::from(shorter);
                            let of =
                                |hits: &ClosestHits| (hits.low[lane].to_bits(), hits.limit[lane].to_bits());
                            assert_eq!(of(&together), of(&one_by_one), "{level:?}");
                            let of = |hits: &ClosestHits| {
                                (hits.object[lane], hits.primitive[lane], hits.part[lane])
                            };
                            assert_eq!(of(&together), of(&one_by_one), "{level:?}");
                        }
                        early += expected.count_ones();
                        kept += (lanes & !expected & !taken.nearer).count_ones();
                    }
                }
            }
        }
        assert!(nearer > 500 && early > 500 && kept > 500, "{nearer}, {early}, {kept}");
    }

    struct BoundsOfEight<'a, 'b>(&'b ClosestHits<'a>);

    impl Task for BoundsOfEight<'_, '_> {
        type Output = Interval<[f64; 8]>;

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            let Interval { low, high } = self.0.bounds_of_eight::<I>(1);
            Interval { low: low.store(), high: high.store() }
        }
    }

    #[test]
    fn bounds_of_eight_hold_those_of_each() {
        let scene = Scene::new(Vec::new());
        let mut closest = ClosestHits::new(&scene, TRange::RAY, false);
        let limits = [0.0, 5e-324, 1e-310, 1.0, 1.0_f64.next_down(), 1e300, f64::MAX, -1.5];
        closest.limit[8..16].copy_from_slice(&limits);
        closest.low[8..16].copy_from_slice(&limits.map(|limit| limit - limit.abs() / 8.0));
        for level in Level::available() {
            let found = dispatch(level, BoundsOfEight(&closest));
            for k in 0..8 {
                let Interval { low, high } = closest.bounds(8 + k);
                assert!(
                    found.low[k] == low && found.high[k] >= high,
                    "{level:?}: {} for {high}",
                    found.high[k]
                );
                let wide = limits[k] + 4.0 * f64::EPSILON * limits[k].abs() + 2.0 * f64::MIN_POSITIVE;
                assert!(found.high[k] <= wide, "{level:?}: {} for {high}", found.high[k]);
            }
        }
    }
}
