//! Closest-hit queries: of one ray, and of the rays of a packet, a lane each.

use std::cmp::Ordering;

use crate::arith::number::{self, Interval};
use crate::arith::simd::{Floats, Isa};
use crate::bvh::{Bvh, LANES, Mask, RayPacket, Stack, TraversalRay, take};
use crate::geometry::vector::Point;
use crate::scene::TriangleMesh;
use crate::scene::{Geometry, RootId, RootIntervals, Scene, World};

/// The closest-hit query of one ray.
pub struct ClosestHit<'a> {
    scene: &'a Scene,
    origin: Point,
    direction: Point,
    time: f64,
    t_min: f64,
    t_max: f64,
    cap: f64,
    /// The closest hit so far, if `low` is finite; its t is between `low` and `limit`.
    root: RootId,
    low: f64,
    limit: f64,
}

/// What the limit of t is at most once there is a hit. Below any t if any hit will do: then no other is looked for.
fn cap(any: bool) -> f64 {
    if any { f64::NEG_INFINITY } else { f64::INFINITY }
}

impl<'a> ClosestHit<'a> {
    /// A t beyond what float64 holds is a miss. `any`: whether any hit will do, of which no more is known than that there is one.
    pub fn new(
        scene: &'a Scene,
        (origin, direction, time): (Point, Point, f64),
        (t_min, t_max): (f64, f64),
        any: bool,
    ) -> Self {
        let (t_max, root) = (t_max.min(f64::MAX), RootId::of_triangle(0, 0));
        let (cap, low) = (cap(any), f64::INFINITY);
        ClosestHit { scene, origin, direction, time, t_min, t_max, cap, root, low, limit: t_max }
    }

    /// The nearest hit, with bounds of t.
    pub fn found(&self) -> Option<(RootId, Interval)> {
        if self.low < f64::INFINITY { Some((self.root, bounds(self.low, self.limit))) } else { None }
    }

    /// Traverses the whole scene.
    pub fn run(&mut self, world: &World, stack: &mut Stack) {
        for &object in &world.index.unbounded {
            self.consider(object, 0);
        }
        self.traverse(&world.index.bounded, stack);
        if let Some(movers) = world.movers() {
            self.traverse(movers, stack);
        }
    }

    fn traverse(&mut self, hierarchy: &Bvh<u32>, stack: &mut Stack) {
        let (o, d) = (self.origin.map(Interval::point), self.direction.map(Interval::point));
        let mut ray = TraversalRay::new(o, d, hierarchy.center(), self.t_min, self.limit);
        hierarchy.traverse(&mut ray, stack, |stack, leaf| {
            match &self.scene.objects()[*leaf as usize].geometry {
                Geometry::Surface(_) => self.consider(*leaf, 0),
                Geometry::Mesh(mesh) => self.enter(*leaf, mesh, stack),
            }
            self.limit
        });
    }

    /// Traverses one mesh.
    pub fn enter(&mut self, id: u32, mesh: &TriangleMesh, stack: &mut Stack) {
        let [o, d] = self.scene.at(id, self.time).enclose(self.origin, self.direction);
        let hierarchy = mesh.hierarchy();
        let mut ray = TraversalRay::new(o, d, hierarchy.center(), self.t_min, self.limit);
        hierarchy.traverse(&mut ray, stack, |_, leaf| {
            for &primitive in leaf.ids() {
                self.consider(id, primitive);
            }
            self.limit
        });
    }

    /// Keeps the primitive's first hit in range if it is the nearest so far.
    fn consider(&mut self, id: u32, primitive: u32) {
        let found = number::decide(&self.root_intervals(id, primitive));
        self.take_first(id, primitive, found);
    }

    /// As `consider`, without the float64 stage.
    fn consider_exactly(&mut self, id: u32, primitive: u32) {
        let found = number::decide_exactly(&self.root_intervals(id, primitive));
        self.take_first(id, primitive, found);
    }

    fn root_intervals(&self, id: u32, primitive: u32) -> RootIntervals<'a> {
        let (origin, direction) = (self.origin, self.direction);
        RootIntervals { object: self.scene.at(id, self.time), primitive, origin, direction }
    }

    fn take_first(&mut self, id: u32, primitive: u32, found: [Option<(Interval, u8, u8)>; 2]) {
        for &(t, index, feature) in found.iter().flatten() {
            if self.takes(RootId { object: id, primitive, index, feature }, t) {
                return;
            }
        }
    }

    /// Keeps a hit, within bounds of t, if it is in range and the nearest so far; tells whether t ≥ t_min, so that later hits of the same
    /// primitive are of no interest.
    fn takes(&mut self, at: RootId, t: Interval) -> bool {
        // The range is that of the rounded t: rounding is monotone, so bounds of t settle it but for the last ulps.
        if t.high < self.t_min || (t.low < self.t_min && self.is_early(at)) {
            return false;
        }
        if t.low > self.limit || (t.high > self.t_max && self.rounded(at) > self.t_max) {
            return true;
        }
        if t.high < self.low || self.found().is_none() || self.is_before(at) {
            let high = if t.high < self.t_max { t.high } else { self.t_max };
            (self.root, self.low, self.limit) = (at, t.low, if high < self.cap { high } else { self.cap });
        }
        true
    }

    fn rounded(&self, at: RootId) -> f64 {
        self.scene.t(&at, self.origin, self.direction, self.time)
    }

    /// Whether t, rounded, is below t_min; below zero it is even where rounding leaves zero.
    fn is_early(&self, at: RootId) -> bool {
        let t = self.rounded(at);
        t < self.t_min
            || t == 0.0 && self.t_min == 0.0 && self.scene.is_negative(&at, self.origin, self.direction, self.time)
    }

    fn is_before(&self, at: RootId) -> bool {
        let best = &self.root;
        match self.scene.compare(&at, best, self.origin, self.direction, self.time) {
            Ordering::Less => true,
            Ordering::Equal => (at.object, at.primitive) < (best.object, best.primitive),
            Ordering::Greater => false,
        }
    }
}

/// The rounded t is in range, so that t itself may be beyond the limit by less than an ulp.
#[inline(always)]
fn bounds(low: f64, limit: f64) -> Interval {
    Interval { low, high: limit.next_up() }
}

/// The closest-hit queries of the rays of a packet, a lane each, with the results of a `ClosestHit` each.
#[repr(C, align(64))]
pub struct ClosestHits<'a> {
    low: [f64; LANES],
    limit: [f64; LANES],
    object: [u32; LANES],
    primitive: [u32; LANES],
    index: [u8; LANES],
    feature: [u8; LANES],
    scene: &'a Scene,
    t_min: f64,
    t_max: f64,
    cap: f64,
}

impl<'a> ClosestHits<'a> {
    pub fn new(scene: &'a Scene, (t_min, t_max): (f64, f64), any: bool) -> Self {
        ClosestHits {
            low: [f64::INFINITY; LANES],
            limit: [0.0; LANES],
            object: [0; LANES],
            primitive: [0; LANES],
            index: [0; LANES],
            feature: [0; LANES],
            scene,
            t_min,
            t_max: t_max.min(f64::MAX),
            cap: cap(any),
        }
    }

    /// Begins anew with other rays.
    #[inline(always)]
    pub fn restart<I: Isa>(&mut self) {
        for eight in 0..LANES / 8 {
            self.low.as_chunks_mut().0[eight] = I::F64x8::splat(f64::INFINITY).store();
            self.limit.as_chunks_mut().0[eight] = I::F64x8::splat(self.t_max).store();
        }
    }

    #[inline(always)]
    pub fn t_min(&self) -> f64 {
        self.t_min
    }

    /// Upper bounds of the closest t: the limits of traversal.
    #[inline(always)]
    pub fn limits(&self) -> &[f64; LANES] {
        &self.limit
    }

    /// Objects and primitives of the nearest hits.
    #[inline(always)]
    pub fn triangles(&self) -> ([u32; LANES], [u32; LANES]) {
        (self.object, self.primitive)
    }

    /// The lanes with a hit.
    #[inline(always)]
    pub fn found<I: Isa>(&self) -> Mask {
        let mut found = 0;
        for (eight, low) in self.low.as_chunks().0.iter().enumerate() {
            found |= Mask::from(I::F64x8::load(low).lt(I::F64x8::splat(f64::INFINITY))) << (8 * eight);
        }
        found
    }

    /// The object that the nearest hit of a lane is on.
    #[inline(always)]
    pub fn object(&self, lane: usize) -> u32 {
        self.object[lane]
    }

    /// The lanes whose nearest hit, if any, is on this object.
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

    /// Bounds of t of the nearest hit of a lane.
    #[inline(always)]
    pub fn bounds(&self, lane: usize) -> Interval {
        bounds(self.low[lane], self.limit[lane])
    }

    #[inline(always)]
    pub fn root(&self, lane: usize) -> RootId {
        let (object, primitive) = (self.object[lane], self.primitive[lane]);
        RootId { object, primitive, index: self.index[lane], feature: self.feature[lane] }
    }

    #[inline(always)]
    pub fn put(&mut self, lane: usize, root: RootId) {
        (self.object[lane], self.primitive[lane]) = (root.object, root.primitive);
        (self.index[lane], self.feature[lane]) = (root.index, root.feature);
    }

    /// As `ClosestHit::takes`.
    #[inline(always)]
    pub fn takes(&mut self, rays: &RayPacket, lane: usize, at: RootId, t: Interval) -> bool {
        if t.high < self.t_min {
            return false;
        }
        if self.t_min <= t.low {
            if self.limit[lane] < t.low {
                return true;
            }
            if t.high <= self.t_max && t.high < self.low[lane] {
                self.put(lane, at);
                (self.low[lane], self.limit[lane]) = (t.low, if t.high < self.cap { t.high } else { self.cap });
                return true;
            }
        }
        self.takes_narrowly(rays, lane, at, t)
    }

    /// As `takes`, where there is no other hit of the primitive.
    #[inline(always)]
    pub fn offer(&mut self, rays: &RayPacket, lane: usize, at: RootId, t: Interval) {
        if t.low <= self.limit[lane] && self.t_min <= t.high {
            self.takes(rays, lane, at, t);
        }
    }

    /// As `offer`, of one root to these lanes of the eight. Returns the lanes whose limits may have decreased.
    #[inline(always)]
    pub fn offer_eight<I: Isa>(
        &mut self,
        rays: &RayPacket,
        eight: usize,
        lanes: u32,
        at: RootId,
        t: Interval<I::F64x8>,
    ) -> u32 {
        let limits = I::F64x8::load(&self.limit.as_chunks().0[eight]);
        let offered = lanes & t.low.le(limits) & I::F64x8::splat(self.t_min).le(t.high);
        if offered != 0 {
            let (low, high, mut left) = (t.low.store(), t.high.store(), Mask::from(offered));
            while let Some(k) = take(&mut left) {
                self.takes(rays, 8 * eight + k, at, Interval { low: low[k], high: high[k] });
            }
        }
        offered
    }

    #[cold]
    #[inline(never)]
    fn takes_narrowly(&mut self, rays: &RayPacket, lane: usize, at: RootId, t: Interval) -> bool {
        let mut closest = self.of_lane(rays, lane);
        let takes = closest.takes(at, t);
        self.set_lane(lane, &closest);
        takes
    }

    /// Keeps the primitive's first hit in range if it is the nearest so far.
    #[inline(never)]
    pub fn consider(&mut self, rays: &RayPacket, lane: usize, id: u32, primitive: u32) {
        let mut closest = self.of_lane(rays, lane);
        closest.consider(id, primitive);
        self.set_lane(lane, &closest);
    }

    /// As `consider`, of a primitive whose intersection float64 could not decide.
    #[inline(never)]
    pub fn consider_exactly(&mut self, rays: &RayPacket, lane: usize, id: u32, primitive: u32) {
        let mut closest = self.of_lane(rays, lane);
        closest.consider_exactly(id, primitive);
        self.set_lane(lane, &closest);
    }

    /// As `ClosestHit::enter`.
    pub fn enter(&mut self, rays: &RayPacket, lane: usize, id: u32, mesh: &TriangleMesh, stack: &mut Stack) {
        let mut closest = self.of_lane(rays, lane);
        closest.enter(id, mesh, stack);
        self.set_lane(lane, &closest);
    }

    fn of_lane(&self, rays: &RayPacket, lane: usize) -> ClosestHit<'a> {
        let ClosestHits { scene, t_min, t_max, cap, .. } = *self;
        let (origin, direction) = (rays.origin(lane), rays.direction(lane));
        let (time, low, limit) = (rays.time[lane], self.low[lane], self.limit[lane]);
        ClosestHit { scene, origin, direction, time, t_min, t_max, cap, root: self.root(lane), low, limit }
    }

    fn set_lane(&mut self, lane: usize, closest: &ClosestHit) {
        self.put(lane, closest.root);
        (self.low[lane], self.limit[lane]) = (closest.low, closest.limit);
    }
}
