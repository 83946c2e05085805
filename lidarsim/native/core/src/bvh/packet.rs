//! Ray packets prepared for a hierarchy, and their conservative slab tests in float32 (I. Wald et al.,
//! Interactive Rendering with Coherent Ray Tracing, 2001; T. Ize, Robust BVH Ray Traversal, 2013).
//!
//! As in `TraversalRay`, t is bounded from below at a box's near plane and from above at its far plane. The
//! frustum of the packet, interval arithmetic over its origins and reciprocal directions, culls most boxes
//! for all rays at once (A. Reshetov et al., Multi-Level Ray Tracing Algorithm, 2005; S. Boulos et al.,
//! Geometric and Arithmetic Culling Methods for Entire Ray Packets, 2006).
//!
//! ```text
//! enter, once per hierarchy, for each ray and axis, in float32, rounded outward:
//!     o⁻, o⁺ = o − center, moved back and forth by its error
//!     s⁻, s⁺ = (1 − 12u)/|d|, (1 + 12u)/|d|, with the sign of d
//! at a node, for its eight boxes and the whole packet:
//!     near = max(start, (first − O⁻)·S⁻);     far = min(limit, (last − O⁺)·S⁺)     over the axes
//!     if near > far:                          no ray enters it
//! for each box that is left, sixteen rays at once:
//!     near = max(start, (first − O⁻)·s⁻);     far = min(limit, (last − O⁺)·s⁺)
//!     the rays with near ≤ far may enter it
//! ```
//!
//! | symbol | meaning | in the code |
//! |---|---|---|
//! | o, d | origin and direction, scaled so that the longest direction is about 1 | `RayPacket` |
//! | o⁻, o⁺; s⁻, s⁺ | bounds for near planes; for far planes | `near_origin`, `far_origin`, `near_slope`, … |
//! | O⁻, O⁺; S⁻, S⁺ | the outermost of these over the packet | `Frustum` |
//! | first, last | planes by which rays enter and leave a box | chosen by `Octant::backward` |
//! | start, limit | bounds of (t − `offset`)·`scale` | `Octant::start`, `Subpacket::limit` |
//! | u | 2⁻²⁴ | `U` |

use super::node::{Node, WIDTH};
use super::ray_packet::{LANES, Mask, RayPacket, SUBPACKETS, WIDE, take};
use super::{BoxFrame, Crossings};
use crate::arith::simd::{Floats, Isa, Task};

/// Unit roundoff of float32.
const U: f32 = f32::EPSILON / 2.0;

/// A slope is the float32 reciprocal of a direction rounded to float32. The direction is off by u, or, if
/// subnormal, by 2⁻¹⁵⁰, which is 4u of 2⁻¹²⁸; with the reciprocal, 5u. A subtraction and two
/// products, including the product with this factor, add 1u each: 8u, and the factor has half as much again.
///
/// Reciprocals of numbers below 2⁻¹²⁸ overflow. The true one is then at least 2¹²⁸·(1 − 4u),
/// more than the largest number times `SHRINK`.
const SHRINK: f32 = 1.0 - 12.0 * U;
const STRETCH: f32 = 1.0 + 12.0 * U;

#[repr(C, align(64))]
pub struct Packet {
    subpackets: [Subpacket; SUBPACKETS],
    count: usize,
    /// The t of a ray times this, a power of two, is t in the packet.
    scale: f64,
    /// As in `RayPacket`.
    offset: [f64; LANES],
    has_offsets: bool,
    /// As in `RayPacket`.
    parallel: [Mask; 3],
    /// The rays that are known to cross the plane of the hierarchy perpendicular to `axis` only between these
    /// t; the interval is empty for rays that never do.
    crossing: Mask,
    axis: usize,
    crossing_t: Option<Box<[[f32; LANES]; 2]>>,
    /// Whether there are rays of either kind, which may miss flat children.
    may_miss: bool,
    pub(super) octant: Octant,
}

/// Properties that all rays of a packet share: the lower bound of t, and by axis which plane of a box they
/// enter first.
#[derive(Clone, Copy)]
pub(super) struct Octant {
    start: f32,
    backward: [bool; 3],
}

/// Sixteen rays of a packet, by axis and lane.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Subpacket {
    near_slope: [[f32; WIDE]; 3],
    far_slope: [[f32; WIDE]; 3],
    limit: [f32; WIDE],
    near_origin: [[f32; WIDE]; 3],
    far_origin: [[f32; WIDE]; 3],
}

impl Subpacket {
    const EMPTY: Subpacket = Subpacket {
        near_slope: [[0.0; WIDE]; 3],
        far_slope: [[0.0; WIDE]; 3],
        limit: [0.0; WIDE],
        near_origin: [[0.0; WIDE]; 3],
        far_origin: [[0.0; WIDE]; 3],
    };

    #[inline(always)]
    fn set_limits<I: Isa>(
        &mut self,
        g: usize,
        t: &[f64; LANES],
        offset: Option<&[f64; LANES]>,
        scale: I::F64x8,
    ) {
        let (mut low, mut high) = halves::<I>(t, g);
        if let Some(offset) = offset {
            // A limit before the start becomes an empty range.
            let (zero, less) = (I::F64x8::splat(0.0), halves::<I>(offset, g));
            (low, high) = (Floats::max(low.sub(less.0), zero), Floats::max(high.sub(less.1), zero));
        }
        let limit = I::narrow(low.mul(scale), high.mul(scale));
        self.limit =
            limit.mul(I::F32x16::splat(1.0 + 4.0 * U)).add(I::F32x16::splat(f32::MIN_POSITIVE)).store();
    }
}

/// Bounds of origins and slopes (reciprocal directions), over all rays or over one of them.
#[derive(Clone, Copy)]
pub(super) struct Frustum {
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    near_slope: [f32; 3],
    far_slope: [f32; 3],
}

/// The children of a node whose boxes some ray of a frustum may enter, farthest first.
#[repr(C, align(64))]
pub(super) struct BoxHits {
    pub count: usize,
    /// The index of each child.
    pub child: [u32; WIDTH],
    /// Lower bounds of t.
    pub near: [f32; WIDTH],
    /// By child, the distances from the origins to the near and far planes.
    first: [[f32; WIDTH]; 3],
    last: [[f32; WIDTH]; 3],
}

impl Packet {
    pub fn empty() -> Self {
        let octant = Octant { start: 0.0, backward: [false; 3] };
        let (subpackets, offset) = ([Subpacket::EMPTY; SUBPACKETS], [0.0; LANES]);
        Packet {
            subpackets,
            count: 0,
            scale: 1.0,
            offset,
            has_offsets: false,
            parallel: [0; 3],
            crossing: 0,
            axis: 0,
            crossing_t: None,
            may_miss: false,
            octant,
        }
    }

    /// Whether rays may miss children of a node because these are flat.
    #[inline(always)]
    pub(super) fn may_miss_flat(&self, node: &Node) -> bool {
        self.may_miss && node.is_flat()
    }

    /// The rays of `mask` that miss child i of a node because it is flat and they are parallel to its plane
    /// or cross it elsewhere.
    #[inline(always)]
    pub(super) fn missing(&self, mask: Mask, node: &Node, i: usize) -> Mask {
        let along = |axis: usize| if node.flat[axis] >> i & 1 != 0 { self.parallel[axis] } else { 0 };
        let missing = along(0) | along(1) | along(2);
        let crossing = mask & self.crossing;
        if crossing != 0 && node.level[self.axis] >> i & 1 != 0 {
            missing | crossing & !self.cross_within(crossing, node, i)
        } else {
            missing
        }
    }

    /// The rays that may cross the plane of the hierarchy within child i of a node, by the slab test with the
    /// t of that plane. Few rays graze a plane, so this code stays out of the loop over children.
    #[cold]
    #[inline(never)]
    fn cross_within(&self, crossing: Mask, node: &Node, i: usize) -> Mask {
        let Some([first_t, last_t]) = self.crossing_t.as_deref() else { return crossing };
        let (mut within, mut left) = (0, crossing);
        while let Some(lane) = take(&mut left) {
            let (subpacket, at) = (&self.subpackets[lane / WIDE], lane % WIDE);
            let mut near = self.octant.start.max(first_t[lane]);
            let mut far = subpacket.limit[at].min(last_t[lane]);
            for axis in (0..3).filter(|&axis| axis != self.axis) {
                let (first, last) = if self.octant.backward[axis] {
                    (node.high[axis][i], node.low[axis][i])
                } else {
                    (node.low[axis][i], node.high[axis][i])
                };
                // A NaN, as of zero times infinity, leaves the bound as it is.
                near = near.max((first - subpacket.near_origin[axis][at]) * subpacket.near_slope[axis][at]);
                far = far.min((last - subpacket.far_origin[axis][at]) * subpacket.far_slope[axis][at]);
            }
            within |= Mask::from(near <= far) << lane;
        }
        within
    }

    /// Bounds of t at the children of a node for one ray, without those that it misses; see `missing`.
    #[inline(always)]
    pub(super) fn narrowed<I: Isa>(
        &self,
        lane: usize,
        node: &Node,
        (near, far): (I::F32x8, I::F32x8),
    ) -> (I::F32x8, I::F32x8) {
        let (mut near, mut far): ([f32; WIDTH], [f32; WIDTH]) = (near.store(), far.store());
        let missed = node.missed_children(self.parallel(lane));
        let mut level = 0;
        let (mut first_t, mut last_t) = (0.0, f32::INFINITY);
        if self.crossing >> lane & 1 != 0
            && let Some(t) = self.crossing_t.as_deref()
        {
            (level, first_t, last_t) = (node.level[self.axis], t[0][lane], t[1][lane]);
        }
        for i in 0..WIDTH {
            if missed >> i & 1 != 0 {
                far[i] = f32::NEG_INFINITY;
            }
            if level >> i & 1 != 0 {
                near[i] = near[i].max(first_t);
                far[i] = far[i].min(last_t);
            }
        }
        (I::F32x8::load(&near), I::F32x8::load(&far))
    }

    /// Whether a ray may miss flat children.
    #[inline(always)]
    pub(super) fn may_miss(&self, lane: usize) -> bool {
        self.may_miss && (self.parallel(lane) != 0 || self.crossing >> lane & 1 != 0)
    }

    /// The axes along which the direction of a ray is exactly zero, a bit each.
    #[inline(always)]
    fn parallel(&self, lane: usize) -> u8 {
        let along = |axis: usize| ((self.parallel[axis] >> lane & 1) as u8) << axis;
        along(0) | along(1) | along(2)
    }

    /// Sets up rays of one octant, relative to the centre of a hierarchy, from t_min ≥ 0 to one limit each.
    #[inline(always)]
    pub fn enter<I: Isa>(
        &mut self,
        rays: &RayPacket,
        crossings: Option<&Crossings>,
        frame: BoxFrame,
        t_min: f64,
        limits: &[f64; LANES],
    ) {
        let octant = rays.octant;
        self.octant.backward = [octant & 1 != 0, octant & 2 != 0, octant & 4 != 0];
        self.count = rays.count;
        self.parallel = rays.parallel;
        self.crossing = crossings.map_or(0, |crossings| crossings.rays);
        self.may_miss = rays.parallel != [0; 3] || self.crossing != 0;
        // Powers of two around 2^e ≤ largest < 2^(e+1): their exponents are far from the limits of float64
        // (see `RayPacket::gather`). Components of rays much shorter than the longest may underflow; see
        // `SHRINK`.
        let mut largest = I::F64x8::splat(0.0);
        for eight in 0..self.count.div_ceil(8) {
            for axis in 0..3 {
                largest =
                    Floats::max(I::F64x8::load(&rays.direction[axis].as_chunks().0[eight]).abs(), largest);
            }
        }
        let exponent = largest.largest().to_bits() >> 52;
        let shrink = I::F64x8::splat(f64::from_bits((2045 - exponent) << 52));
        self.scale = f64::from_bits((exponent + 1) << 52);
        self.has_offsets = rays.has_offsets;
        if rays.has_offsets {
            self.offset.clone_from(&rays.offset);
        }
        let t_min = if rays.has_offsets { 0.0 } else { t_min };
        self.octant.start = (t_min * self.scale) as f32 * (1.0 - 4.0 * U);
        for g in 0..self.count.div_ceil(WIDE) {
            self.enter_subpacket::<I>(g, rays, frame, shrink, limits);
        }
        if let (Some(crossings), true) = (crossings, self.crossing != 0) {
            self.enter_crossings(crossings);
        }
    }

    /// Sets the t of crossings, rounded outward. A t before the start is never reached.
    fn enter_crossings(&mut self, crossings: &Crossings) {
        self.axis = crossings.axis;
        let [first_t, last_t] = &mut **self.crossing_t.get_or_insert_with(|| Box::new([[0.0; LANES]; 2]));
        let mut left = crossings.rays;
        while let Some(lane) = take(&mut left) {
            let offset = if self.has_offsets { self.offset[lane] } else { 0.0 };
            let [low, high] = [crossings.low[lane], crossings.high[lane]].map(|t| (t - offset) * self.scale);
            first_t[lane] = low.max(0.0) as f32 * (1.0 - 4.0 * U) - f32::MIN_POSITIVE;
            last_t[lane] = if high < 0.0 { -1.0 } else { high as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE };
        }
    }

    #[inline(always)]
    fn enter_subpacket<I: Isa>(
        &mut self,
        g: usize,
        rays: &RayPacket,
        frame: BoxFrame,
        shrink: I::F64x8,
        limits: &[f64; LANES],
    ) {
        let (zero, one) = (I::F32x16::splat(0.0), I::F32x16::splat(1.0));
        let offset = self.has_offsets.then_some(&self.offset);
        let subpacket = &mut self.subpackets[g];
        subpacket.set_limits::<I>(g, limits, offset, I::F64x8::splat(self.scale));
        // By axis: bounds of the distance between origin and centre, and of |d|; and the rays whose direction
        // has an uncertain sign.
        let (mut distance, mut slowest, mut fastest, mut unsigned) =
            ([zero; 3], [zero; 3], [zero; 3], [0; 3]);
        let (low, high) = halves::<I>(&rays.origin_error, g);
        let origin_error = I::narrow(low, high).mul(I::F32x16::splat(1.0 + 4.0 * U));
        let origin_error = origin_error.add(I::F32x16::splat(f32::MIN_POSITIVE));
        // In float64 the errors of rays much shorter than the longest do not underflow yet. Each conversion
        // of an error or a direction loses at most half the smallest subnormal, 2⁻¹⁵⁰; the least
        // normal number, 2⁻¹²⁶, covers it.
        let (low, high) = halves::<I>(&rays.direction_error, g);
        let none = I::F64x8::splat(0.0);
        let vague = none.lt(low) | none.lt(high) != 0;
        let direction_error =
            I::narrow(low.mul(shrink), high.mul(shrink)).mul(I::F32x16::splat(1.0 + 4.0 * U));
        let direction_error = direction_error.add(I::F32x16::splat(f32::MIN_POSITIVE));
        for axis in 0..3 {
            let backward = self.octant.backward[axis];
            let sign = I::F32x16::splat(if backward { -1.0 } else { 1.0 });
            let middle = I::F64x8::splat(frame.center[axis]);
            let (low, high) = halves::<I>(&rays.origin[axis], g);
            let o = I::narrow(low.sub(middle), high.sub(middle));
            // Conversion and difference: slightly more than 1u. The error of the origin is rounded up along
            // with it.
            let error = o.abs().mul(I::F32x16::splat(4.0 * U)).add(origin_error);
            distance[axis] = o.abs().add(error);
            let error = error.mul(sign);
            subpacket.near_origin[axis] = o.add(error).store();
            subpacket.far_origin[axis] = o.sub(error).store();
            let (low, high) = halves::<I>(&rays.direction[axis], g);
            let d = I::narrow(low.mul(shrink), high.mul(shrink)).abs();
            let mut near = one.div(d);
            let mut far = near;
            if vague {
                // The error also covers the rounding of d and of the difference.
                let error = direction_error.add(d.mul(I::F32x16::splat(4.0 * U)));
                (slowest[axis], fastest[axis]) = (Floats::max(d.sub(error), zero), d.add(error));
                (near, far) = (one.div(fastest[axis]), one.div(slowest[axis]));
                unsigned[axis] = slowest[axis].le(zero);
            }
            let near = Floats::min(near, I::F32x16::splat(f32::MAX)).mul(I::F32x16::splat(SHRINK));
            let far = far.mul(I::F32x16::splat(STRETCH));
            subpacket.near_slope[axis] = near.mul(sign).store();
            subpacket.far_slope[axis] = far.mul(sign).store();
        }
        if unsigned != [0; 3] {
            // No hit is later than the exit of the ray from the hierarchy along any axis. A ray that may go
            // backward moves at most that far from its origin and reaches boxes whose far planes lie there.
            // It reaches boxes ahead no sooner than if it went forward.
            let mut latest = I::F32x16::load(&subpacket.limit);
            for axis in 0..3 {
                let way = distance[axis].add(I::F32x16::splat(frame.reach[axis]));
                latest = way.div(slowest[axis]).mul(I::F32x16::splat(STRETCH)).min(latest);
            }
            for (axis, mut left) in unsigned.into_iter().enumerate() {
                let back: [f32; WIDE] = fastest[axis].mul(latest).mul(I::F32x16::splat(STRETCH)).store();
                while left != 0 {
                    let lane = left.trailing_zeros() as usize;
                    left &= left - 1;
                    subpacket.far_origin[axis][lane] -=
                        if self.octant.backward[axis] { -back[lane] } else { back[lane] };
                }
            }
        }
    }

    /// Allows both signs of a direction whose sign is uncertain in some lane.
    #[inline(always)]
    pub(super) fn frustum_of_all<I: Isa>(&self) -> Frustum {
        let mut frustum = Frustum::EMPTY;
        for axis in 0..3 {
            let first = &self.subpackets[0];
            let mut near_origin = I::F32x16::load(&first.near_origin[axis]);
            let mut far_origin = I::F32x16::load(&first.far_origin[axis]);
            let mut near_slope = I::F32x16::load(&first.near_slope[axis]);
            let mut far_slope = I::F32x16::load(&first.far_slope[axis]);
            let backward = self.octant.backward[axis];
            for subpacket in &self.subpackets[1..self.count.div_ceil(WIDE)] {
                near_origin = outer::<I>(near_origin, &subpacket.near_origin[axis], !backward);
                far_origin = outer::<I>(far_origin, &subpacket.far_origin[axis], backward);
                near_slope = outer::<I>(near_slope, &subpacket.near_slope[axis], backward);
                far_slope = outer::<I>(far_slope, &subpacket.far_slope[axis], !backward);
            }
            if backward {
                frustum.near_origin[axis] = near_origin.smallest();
                frustum.far_origin[axis] = far_origin.largest();
                frustum.near_slope[axis] = near_slope.largest();
                frustum.far_slope[axis] = far_slope.smallest();
            } else {
                frustum.near_origin[axis] = near_origin.largest();
                frustum.far_origin[axis] = far_origin.smallest();
                frustum.near_slope[axis] = near_slope.smallest();
                frustum.far_slope[axis] = far_slope.largest();
            }
        }
        frustum
    }

    /// Writes single numbers: reading one wide value back after several narrow stores stalls.
    #[inline(always)]
    pub(super) fn put_frustum_of_one(&self, lane: usize, frustum: &mut Frustum) {
        let (subpacket, lane) = (&self.subpackets[lane / WIDE], lane % WIDE);
        for axis in 0..3 {
            frustum.near_origin[axis] = subpacket.near_origin[axis][lane];
            frustum.far_origin[axis] = subpacket.far_origin[axis][lane];
            frustum.near_slope[axis] = subpacket.near_slope[axis][lane];
            frustum.far_slope[axis] = subpacket.far_slope[axis][lane];
        }
    }

    #[inline(always)]
    pub(super) fn limit(&self, lane: usize) -> f32 {
        self.subpackets[lane / WIDE].limit[lane % WIDE]
    }

    /// The float32 limit of a ray whose limit is t: an upper bound.
    #[inline(always)]
    pub(super) fn limit_of(&self, lane: usize, t: f64) -> f32 {
        let t = if self.has_offsets { (t - self.offset[lane]).max(0.0) } else { t };
        (t * self.scale) as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE
    }

    /// Sets the limits of all rays, as `limit_of`.
    #[inline(always)]
    pub(super) fn set_limits<I: Isa>(&mut self, t: &[f64; LANES]) {
        let (scale, offset) = (I::F64x8::splat(self.scale), self.has_offsets.then_some(&self.offset));
        for (g, subpacket) in self.subpackets.iter_mut().enumerate() {
            subpacket.set_limits::<I>(g, t, offset, scale);
        }
    }

    /// The rays of `mask` whose limit is not nearer than `near`.
    #[inline(always)]
    pub(super) fn within<I: Isa>(&self, mask: Mask, near: f32) -> Mask {
        let mut within = 0;
        for (g, subpacket) in self.subpackets.iter().enumerate() {
            within |= Mask::from(I::F32x16::splat(near).le(I::F32x16::load(&subpacket.limit))) << (WIDE * g);
        }
        within & mask
    }

    /// The rays of `mask` that may enter box i of a node, after its test against the frustum. Uses the
    /// origins of the frustum and the slopes of each ray.
    #[inline(always)]
    pub(super) fn intersect<I: Isa>(&self, mask: Mask, box_hits: &BoxHits, i: usize) -> Mask {
        let mut hit = 0;
        for (g, subpacket) in self.subpackets.iter().enumerate() {
            let mut near = I::F32x16::splat(self.octant.start);
            let mut far = I::F32x16::load(&subpacket.limit);
            for axis in 0..3 {
                let t = I::F32x16::splat(box_hits.first[axis][i])
                    .mul(I::F32x16::load(&subpacket.near_slope[axis]));
                near = t.max(near);
                let t =
                    I::F32x16::splat(box_hits.last[axis][i]).mul(I::F32x16::load(&subpacket.far_slope[axis]));
                far = t.min(far);
            }
            hit |= Mask::from(near.le(far)) << (WIDE * g);
        }
        hit & mask
    }
}

/// The children of a node whose boxes any of a few rays may enter, farthest first.
#[repr(C, align(64))]
pub(super) struct FewBoxHits {
    pub count: usize,
    /// The index of each child.
    pub child: [u32; WIDTH],
    /// Lower bounds of t.
    pub near: [f32; WIDTH],
    /// By child, the rays that may enter it.
    pub masks: [Mask; WIDTH],
}

impl Packet {
    /// Does the tests of `Frustum::intersect` and `Packet::intersect`, ray by ray.
    #[inline(always)]
    pub(super) fn intersect_few<I: Isa>(&self, mask: Mask, frustum: &Frustum, node: &Node) -> FewBoxHits {
        let (firsts, lasts) = frustum.planes::<I>(&self.octant, node);
        let (beyond, largest) = (I::F32x8::splat(f32::INFINITY), I::F32x8::splat(f32::MAX));
        let (mut nearest, mut masks) = (beyond, I::no_masks());
        let mut left = mask;
        while let Some(lane) = take(&mut left) {
            let (subpacket, at) = (&self.subpackets[lane / WIDE], lane % WIDE);
            let mut near = I::F32x8::splat(self.octant.start);
            let mut far = I::F32x8::splat(subpacket.limit[at]);
            for axis in 0..3 {
                near = firsts[axis].mul(I::F32x8::splat(subpacket.near_slope[axis][at])).max(near);
                far = lasts[axis].mul(I::F32x8::splat(subpacket.far_slope[axis][at])).min(far);
            }
            // A finite number distinguishes them from missed boxes.
            near = Floats::min(near, largest);
            masks = I::mark(masks, near, far, 1 << lane);
            nearest = Floats::min(near.le_pick(far, near, beyond), nearest);
        }
        let (count, near, child) = I::by_distance(nearest, largest, &[0, 1, 2, 3, 4, 5, 6, 7]);
        FewBoxHits { count, child, near, masks: I::masks(masks) }
    }
}

/// [`Packet::enter`], compiled once for its callers.
pub struct EnterHierarchy<'t> {
    pub packet: &'t mut Packet,
    pub rays: &'t RayPacket,
    pub crossings: Option<&'t Crossings>,
    pub frame: BoxFrame,
    pub t_min: f64,
    pub limits: &'t [f64; LANES],
}

impl Task for EnterHierarchy<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let EnterHierarchy { packet, rays, crossings, frame, t_min, limits } = self;
        packet.enter::<I>(rays, crossings, frame, t_min, limits);
    }
}

/// The lower and the upper eight numbers of a subpacket.
#[inline(always)]
fn halves<I: Isa>(x: &[f64; LANES], g: usize) -> (I::F64x8, I::F64x8) {
    let eights = x.as_chunks().0;
    (I::F64x8::load(&eights[2 * g]), I::F64x8::load(&eights[2 * g + 1]))
}

#[inline(always)]
fn outer<I: Isa>(x: I::F32x16, y: &[f32; WIDE], largest: bool) -> I::F32x16 {
    let y = I::F32x16::load(y);
    if largest { Floats::max(x, y) } else { Floats::min(x, y) }
}

impl Frustum {
    pub(super) const EMPTY: Frustum =
        Frustum { near_origin: [0.0; 3], far_origin: [0.0; 3], near_slope: [0.0; 3], far_slope: [0.0; 3] };

    /// Distances from the origins to the near and far planes of the boxes of a node.
    #[inline(always)]
    fn planes<I: Isa>(&self, octant: &Octant, node: &Node) -> ([I::F32x8; 3], [I::F32x8; 3]) {
        let zero = I::F32x8::splat(0.0);
        let (mut firsts, mut lasts) = ([zero; 3], [zero; 3]);
        for i in 0..3 {
            let (first, last) = if octant.backward[i] {
                (&node.high[i], &node.low[i])
            } else {
                (&node.low[i], &node.high[i])
            };
            firsts[i] = I::F32x8::load(first).sub(I::F32x8::splat(self.near_origin[i]));
            lasts[i] = I::F32x8::load(last).sub(I::F32x8::splat(self.far_origin[i]));
        }
        (firsts, lasts)
    }

    /// The slab test of the boxes of a node: bounds of t at which rays of the frustum may enter, and by which
    /// they have left.
    #[inline(always)]
    pub(super) fn slabs<I: Isa>(&self, octant: &Octant, node: &Node, limit: f32) -> Slabs<I> {
        let mut near = I::F32x8::splat(octant.start);
        let mut far = I::F32x8::splat(limit);
        let (first, last) = self.planes::<I>(octant, node);
        for i in 0..3 {
            near = first[i].mul(I::F32x8::splat(self.near_slope[i])).max(near);
            far = last[i].mul(I::F32x8::splat(self.far_slope[i])).min(far);
        }
        Slabs { near, far, first, last }
    }

    #[inline(always)]
    pub(super) fn intersect<I: Isa>(&self, octant: &Octant, node: &Node) -> BoxHits {
        let Slabs { near, far, first, last } = self.slabs::<I>(octant, node, f32::INFINITY);
        let (count, near, child) = I::by_distance(near, far, &[0, 1, 2, 3, 4, 5, 6, 7]);
        BoxHits {
            count,
            child,
            near,
            first: [first[0].store(), first[1].store(), first[2].store()],
            last: [last[0].store(), last[1].store(), last[2].store()],
        }
    }
}

/// The slab tests of a frustum against the boxes of a node.
pub(super) struct Slabs<I: Isa> {
    pub near: I::F32x8,
    pub far: I::F32x8,
    /// Distances from the origins to the near and far planes.
    first: [I::F32x8; 3],
    last: [I::F32x8; 3],
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::super::Bvh;
    use super::super::node::Child;
    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::arith::simd::Portable;
    use crate::testing::{numbers, worst};

    /// A hierarchy around the origin that reaches `reach` along each axis.
    fn around_origin(reach: f32) -> Bvh<()> {
        let mut root = Node {
            low: [[f32::INFINITY; WIDTH]; 3],
            high: [[f32::NEG_INFINITY; WIDTH]; 3],
            child: [Child::END; WIDTH],
            level: [0; 3],
            flat: [0; 3],
        };
        for axis in 0..3 {
            (root.low[axis][3], root.high[axis][3]) = (-reach, reach);
        }
        Bvh::with([0.0; 3], [f64::NAN; 3], vec![root], Vec::new())
    }

    /// A packet of one ray from (o, 0, 0) along (d, 0.9, 0), for tests along x.
    fn packet(o: f64, d: f64, direction_error: f64, t: f64) -> Packet {
        let mut rays = RayPacket::empty();
        rays.count = 1;
        for lane in 0..WIDE {
            rays.set(lane, [o, 0.0, 0.0], [d, 0.9, 0.0]);
            rays.direction_error[lane] = direction_error;
        }
        let mut packet = Packet::empty();
        packet.enter::<Portable>(&rays, None, around_origin(1.0).frame(), t, &[t; LANES]);
        packet
    }

    /// x/y − 1, in units of the float32 roundoff.
    fn roundings(x: &Dyadic, y: &Dyadic) -> f64 {
        x.minus(y).split().0 / (y.split().0 * f64::from(U))
    }

    /// The least margin of each bound, in float32 roundings.
    #[test]
    fn bounds_in_float32_are_on_the_safe_side_by_what_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 0.25 + 0.25 * next();
        let n = |x: f32| Dyadic::exact(f64::from(x));
        let least = |score: &dyn Fn(&[f64; 2]) -> f64| -worst(6, 3000, draw, |x: &[f64; 2]| -score(x)).0;
        // The plane is at x and the direction is y, both in [¼, ½]; `scale` is 1, so that t = x/y.
        let near = least(&|x| {
            let (subpacket, plane) = (packet(0.0, x[1], 0.0, 1.0).subpackets[0], x[0] as f32);
            let t = (plane - subpacket.near_origin[0][0]) * subpacket.near_slope[0][0];
            -roundings(&n(t).times(&Dyadic::exact(x[1])), &n(plane))
        });
        let far = least(&|x| {
            let (subpacket, plane) = (packet(0.0, x[1], 0.0, 1.0).subpackets[0], x[0] as f32);
            let t = (plane - subpacket.far_origin[0][0]) * subpacket.far_slope[0][0];
            roundings(&n(t).times(&Dyadic::exact(x[1])), &n(plane))
        });
        let origins = least(&|x| {
            let subpacket = packet(x[0], 0.5, 0.0, 1.0).subpackets[0];
            let beyond = [
                roundings(&n(subpacket.near_origin[0][0]), &Dyadic::exact(x[0])),
                -roundings(&n(subpacket.far_origin[0][0]), &Dyadic::exact(x[0])),
            ];
            beyond[0].min(beyond[1])
        });
        let vague = least(&|x| {
            let error = x[0] * 1e-5;
            let subpacket = packet(0.0, x[1], error, 1.0).subpackets[0];
            let one = Dyadic::exact(1.0);
            let (low, high) = (
                Dyadic::exact(x[1]).minus(&Dyadic::exact(error)),
                Dyadic::exact(x[1]).plus(&Dyadic::exact(error)),
            );
            let beyond = [
                -roundings(&n(subpacket.near_slope[0][0]).times(&high), &one),
                roundings(&n(subpacket.far_slope[0][0]).times(&low), &one),
            ];
            beyond[0].min(beyond[1])
        });
        // The error is nearly as large as the direction itself.
        let very_vague = least(&|x| {
            let error = 1.8 * x[0] * x[1];
            let subpacket = packet(0.0, x[1], error, 1.0).subpackets[0];
            let high = Dyadic::exact(x[1]).plus(&Dyadic::exact(error));
            -roundings(&n(subpacket.near_slope[0][0]).times(&high), &Dyadic::exact(1.0))
        });
        let origin_errors = least(&|x| {
            let mut rays = RayPacket::empty();
            rays.count = 1;
            (0..WIDE).for_each(|lane| rays.set(lane, [0.0; 3], [0.5; 3]));
            rays.origin_error = [x[0]; LANES];
            let mut packet = Packet::empty();
            packet.enter::<Portable>(&rays, None, around_origin(1.0).frame(), 0.0, &[1.0; LANES]);
            let subpacket = packet.subpackets[0];
            let beyond = |far: f32| roundings(&n(far), &Dyadic::exact(x[0]));
            beyond(subpacket.near_origin[0][0]).min(beyond(-subpacket.far_origin[0][0]))
        });
        let limits = least(&|x| {
            let packet = packet(0.0, 0.5, 0.0, x[0]);
            let beyond = [
                roundings(&n(packet.subpackets[0].limit[0]), &Dyadic::exact(x[0])),
                roundings(&n(packet.limit_of(0, x[0])), &Dyadic::exact(x[0])),
                -roundings(&n(packet.octant.start), &Dyadic::exact(x[0])),
            ];
            beyond[0].min(beyond[1]).min(beyond[2])
        });
        // Each bound loses at most the roundings derived at its definition, and keeps no more margin than
        // that.
        assert!((7.0..9.0).contains(&near) && (7.0..9.0).contains(&far), "{near}, {far}");
        assert!((2.0..3.0).contains(&origins), "{origins}");
        assert!((12.0..14.0).contains(&vague), "{vague}");
        assert!((12.0..14.0).contains(&very_vague), "{very_vague}");
        assert!((2.0..4.0).contains(&origin_errors), "{origin_errors}");
        assert!((1.0..3.0).contains(&limits), "{limits}");
    }

    /// The ray has directions 0.9 ∓ e along y and 0 ± e along x, in a hierarchy that reaches to 1: before
    /// it leaves, it moves back by at most e/(0.9 − e).
    #[test]
    fn rays_of_uncertain_sign_may_go_back_as_far_as_they_can_and_little_farther() {
        let mut next = crate::testing::numbers();
        for k in 0..20_000 {
            let (o, error) = (next() - 0.5, 0.4 * next() * 2.0_f64.powi(-(k % 30)));
            let n = Dyadic::exact;
            for d in [0.0, -0.0, 1e-300] {
                let far = f64::from(packet(o, d, error, 1e9).subpackets[0].far_origin[0][0]);
                // The distance back, times 0.9 − e, against e: with 4u of the origin, 12u each in t and in
                // the distance, and the outward rounding.
                let way = n(o).minus(&n(far)).times(&n(0.9).minus(&n(error)));
                let more = way.minus(&n(error)).split().0 / f64::from(U);
                assert!(0.0 <= more && more <= 8.0 * o.abs() + 64.0 * error, "{o}, {error}: {more}");
            }
        }
    }

    /// As `bounds_in_float32_...`, for directions that are subnormal in float32.
    #[test]
    fn slopes_of_directions_that_underflow_are_on_the_safe_side() {
        let mut least = f64::INFINITY;
        for k in 0..40_000 {
            let d = 2.0_f64.powi(-130 + k % 6) * (1.0 + f64::from(k) / 40_000.0);
            let subpacket = packet(0.0, d, 0.0, 1.0).subpackets[0];
            let (near, far) = (f64::from(subpacket.near_slope[0][0]), f64::from(subpacket.far_slope[0][0]));
            // Products with a power of two, of 77 bits, rounded once: 2⁻⁵³ is far below the roundoff of
            // float32.
            least = least.min((1.0 - near * d) / f64::from(U)).min((far * d - 1.0) / f64::from(U));
        }
        assert!((6.5..8.0).contains(&least), "{least}");
    }

    /// For numbers that are subnormal in float32 or smaller, the least normal number covers the loss.
    #[test]
    fn origins_and_limits_that_underflow_are_on_the_safe_side() {
        let mut next = crate::testing::numbers();
        for k in 0..20_000 {
            let mut small = || next() * 2.0_f64.powi(-155 + k % 40);
            let (o, error, t) = (small(), small(), small());
            let mut rays = RayPacket::empty();
            rays.count = 1;
            (0..WIDE).for_each(|lane| rays.set(lane, [o; 3], [0.5; 3]));
            rays.origin_error = [error; LANES];
            let mut packet = Packet::empty();
            packet.enter::<Portable>(&rays, None, around_origin(1.0).frame(), t, &[t; LANES]);
            let Subpacket { near_origin, far_origin, limit, .. } = packet.subpackets[0];
            assert!(o + error <= f64::from(near_origin[0][0]) && f64::from(far_origin[0][0]) <= o - error);
            assert!(t <= f64::from(limit[0]) && t <= f64::from(packet.limit_of(0, t)));
            // Above t by half a subnormal at most, far below the limit and the distances of planes.
            assert!(f64::from(packet.octant.start) <= t + f64::from(f32::from_bits(1)) / 2.0);
        }
    }

    /// If direction and error both round down by half a subnormal, that is 8u of their sum, 2⁻¹²⁸. Were
    /// the error not rounded up, only four of the 12u would remain for the reciprocal and the later
    /// operations.
    #[test]
    fn slopes_of_vague_directions_that_underflow_are_on_the_safe_side() {
        let mut least = f64::INFINITY;
        for k in 0..20_000 {
            let d = 2.0_f64.powi(-129) + (f64::from(2 * k) + 0.5) * f64::from(f32::from_bits(1));
            let subpacket = packet(0.0, d, d, 1.0).subpackets[0];
            least = least.min((1.0 - f64::from(subpacket.near_slope[0][0]) * (d + d)) / f64::from(U));
        }
        // At least the margin of known directions.
        assert!(least >= 6.5, "{least}");
    }

    /// The t of crossings, and of their rays' starts, at all scales.
    #[test]
    fn crossings_are_rounded_outward() {
        let mut next = numbers();
        for k in -60..60 {
            let mut rays = RayPacket::empty();
            (rays.count, rays.has_offsets) = (LANES, k % 2 == 0);
            let mut crossings = Crossings::NONE;
            (crossings.rays, crossings.axis) = (u64::MAX, 2);
            for lane in 0..LANES {
                rays.set(lane, [0.0; 3], [0.5, 0.25, 2.0_f64.powi(k / 3)]);
                rays.offset[lane] = 2.0_f64.powi(k) * next();
                let t = 2.0_f64.powi(k) * (4.0 * next() - 1.0);
                (crossings.low[lane], crossings.high[lane]) = (t, t.next_up());
            }
            let mut packet = Packet::empty();
            packet.enter::<Portable>(
                &rays,
                Some(&crossings),
                around_origin(1.0).frame(),
                0.0,
                &[1e30; LANES],
            );
            let Some([first, last]) = packet.crossing_t.as_deref() else { panic!("there are crossings") };
            for lane in 0..LANES {
                let offset = if rays.has_offsets { rays.offset[lane] } else { 0.0 };
                let t = Dyadic::exact(crossings.low[lane]).minus(&Dyadic::exact(offset));
                let t = t.times(&Dyadic::exact(packet.scale));
                let beyond = |x: f32| Dyadic::exact(f64::from(x)).minus(&t).sign();
                if t.sign() == Ok(Ordering::Less) {
                    assert!(first[lane] <= 0.0, "{}", first[lane]);
                } else {
                    assert_eq!(beyond(first[lane]), Ok(Ordering::Less));
                    assert_eq!(beyond(last[lane]), Ok(Ordering::Greater));
                    assert!(last[lane] - first[lane] <= 12.0 * U * last[lane] + 4.0 * f32::MIN_POSITIVE);
                }
            }
        }
    }
}
