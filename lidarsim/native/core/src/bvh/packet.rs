//! Packets of rays of one octant, and their conservative slab tests in float32 (I. Wald et al., Interactive Rendering with Coherent Ray Tracing,
//! 2001; T. Ize, Robust BVH Ray Traversal, 2013).
//!
//! As in `TraversalRay`, the t of a box's near plane is bounded from below and that of its far plane from above. The frustum of the packet, interval
//! arithmetic over its origins and reciprocal directions, culls most boxes for all rays at once (A. Reshetov et al., Multi-Level Ray Tracing
//! Algorithm, 2005; S. Boulos et al., Geometric and Arithmetic Culling Methods for Entire Ray Packets, 2006).

use super::{Node, WIDTH};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::vector::Point;

/// Rays of a subpacket: those that are tested against a box by one instruction.
const WIDE: usize = 16;

const SUBPACKETS: usize = 4;

/// Most rays of a packet.
pub const LANES: usize = SUBPACKETS * WIDE;

/// Packets hold rays whose numbers are all less than this, errors too, and one of whose direction is more than that: so their squares, and scaled
/// ones, are ordinary float64 numbers.
pub const LARGEST: f64 = 1e30;
pub const SMALLEST: f64 = 1e-30;

/// A bit for each ray of a packet.
pub type Mask = u64;

/// A ray packet in float64, a lane each; lanes beyond the last ray, up to a whole subpacket, repeat the first.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct RayPacket {
    pub origin: [[f64; LANES]; 3],
    pub direction: [[f64; LANES]; 3],
    /// How far each coordinate of origin and direction may be off.
    pub origin_error: [f64; LANES],
    pub direction_error: [f64; LANES],
    /// |d|₁, or the number beside it.
    pub length: [f64; LANES],
    /// Their indices among all rays.
    pub at: [u32; LANES],
    /// The signs of all directions, a bit an axis.
    pub octant: u32,
    /// Whether all rays have the same origin, which is off by the same.
    pub one_origin: bool,
    pub count: usize,
}

impl RayPacket {
    pub const fn empty() -> Self {
        RayPacket {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            origin_error: [0.0; LANES],
            direction_error: [0.0; LANES],
            length: [0.0; LANES],
            at: [0; LANES],
            octant: 0,
            one_origin: false,
            count: 0,
        }
    }

    #[inline(always)]
    pub fn set(&mut self, lane: usize, origin: Point, direction: Point) {
        self.length[lane] = direction[0].abs() + direction[1].abs() + direction[2].abs();
        for i in 0..3 {
            self.origin[i][lane] = origin[i];
            self.direction[i][lane] = direction[i];
        }
    }

    /// Gathers the first rays of an order, up to the first of another octant: none (`count` is 0) if the very first does not fit into packets; it
    /// is then in lane 0, to be traced by itself as a `TraversalRay`.
    #[inline(always)]
    pub fn gather<I: Isa>(&mut self, origins: &[Point], directions: &[Point], order: &[u32]) {
        self.count = 0;
        let Some(&first) = order.first() else { return };
        let (first_origin, huge) = (origins[first as usize], I::F64x8::splat(LARGEST));
        let (mut fit, mut together): (Mask, Mask) = (0, 0);
        let mut signs: [Mask; 3] = [0; 3];
        let given = order.len().min(LANES);
        for eight in 0..given.div_ceil(8) {
            let at = match order[8 * eight..].first_chunk() {
                Some(at) => *at,
                None => padded(&order[8 * eight..], first),
            };
            self.at.as_chunks_mut().0[eight] = at;
            let (o, d) = (columns::<I>(origins, &at), columns::<I>(directions, &at));
            let mut within = 0xff;
            let mut at_one = 0xff;
            let mut largest = I::F64x8::splat(0.0);
            let [x, y, z] = lanes::abs(d);
            self.length.as_chunks_mut().0[eight] = x.add(y).add(z).store();
            for axis in 0..3 {
                let (o, d) = (o[axis], d[axis]);
                self.origin[axis].as_chunks_mut().0[eight] = o.store();
                self.direction[axis].as_chunks_mut().0[eight] = d.store();
                let first = I::F64x8::splat(first_origin[axis]);
                // Each comparison is false for NaN.
                within &= o.abs().lt(huge) & d.abs().lt(huge);
                at_one &= o.le(first) & first.le(o);
                largest = Floats::max(d.abs(), largest);
                signs[axis] |= Mask::from(d.lt(I::F64x8::splat(0.0))) << (8 * eight);
            }
            fit |= Mask::from(within & I::F64x8::splat(SMALLEST).lt(largest)) << (8 * eight);
            together |= Mask::from(at_one) << (8 * eight);
        }
        self.octant = (signs[0] & 1 | (signs[1] & 1) << 1 | (signs[2] & 1) << 2) as u32;
        for sign in signs {
            fit &= if sign & 1 != 0 { sign } else { !sign };
        }
        self.count = (fit.trailing_ones() as usize).min(given);
        self.one_origin = together & all(self.count) == all(self.count);
        for lane in self.count..self.count.next_multiple_of(WIDE) {
            self.set(lane, self.origin(0), self.direction(0));
        }
    }

    /// Whether packets may hold the ray: as `gather` asks.
    pub fn fits(origin: Point, direction: Point) -> bool {
        let largest = direction.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        origin.iter().chain(&direction).all(|x| x.abs() < LARGEST) && largest > SMALLEST
    }

    /// Gathers the rays of `mask`, which are of one octant, from another packet.
    pub fn gather_octant(&mut self, others: &RayPacket, mask: Mask, octant: u32) {
        self.clone_from(others);
        self.octant = octant;
        let first = mask.trailing_zeros() as usize;
        self.count = LANES - mask.leading_zeros() as usize;
        for lane in 0..self.count.next_multiple_of(WIDE) {
            if mask & 1 << lane == 0 {
                self.set(lane, others.origin(first), others.direction(first));
                self.origin_error[lane] = others.origin_error[first];
                self.direction_error[lane] = others.direction_error[first];
            }
        }
        self.one_origin = self.at_origin_of(first) == all(self.count);
    }

    #[inline(always)]
    pub fn origin(&self, lane: usize) -> Point {
        [self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]]
    }

    /// The rays that start where this one does.
    #[inline(always)]
    pub fn at_origin_of(&self, lane: usize) -> Mask {
        let (origin, error) = (self.origin(lane), self.origin_error[lane]);
        let mut same = 0;
        for other in 0..self.count {
            same |= Mask::from(self.origin(other) == origin && self.origin_error[other] == error) << other;
        }
        same
    }

    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Point {
        [self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]]
    }

    /// The origins of the eighth part `eight`, by axis.
    #[inline(always)]
    pub fn origins<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::part(&self.origin, eight)
    }

    /// As `origins`.
    #[inline(always)]
    pub fn directions<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::part(&self.direction, eight)
    }

    /// Whether the rays are coherent in a scene of this size, so that they enter much the same boxes.
    #[inline(always)]
    pub fn are_coherent<I: Isa>(&self, size: f64) -> bool {
        let first = self.direction(0);
        let length2 = first[0] * first[0] + first[1] * first[1] + first[2] * first[2];
        let mut apart = 0;
        for eight in 0..self.count.div_ceil(8) {
            let (mut dot, mut norm2) = (I::F64x8::splat(0.0), I::F64x8::splat(0.0));
            for axis in 0..3 {
                let d = I::F64x8::load(&self.direction[axis].as_chunks().0[eight]);
                dot = d.fused(I::F64x8::splat(first[axis]), dot);
                norm2 = d.fused(d, norm2);
            }
            // More than 30° from the first.
            apart |= dot.mul(dot).lt(norm2.mul(I::F64x8::splat(0.75 * length2)));
        }
        let mut wide = false;
        if !self.one_origin {
            for axis in 0..3 {
                let (mut least, mut most) =
                    (I::F64x8::splat(self.origin[axis][0]), I::F64x8::splat(self.origin[axis][0]));
                for eight in 0..self.count.div_ceil(8) {
                    let o = I::F64x8::load(&self.origin[axis].as_chunks().0[eight]);
                    (least, most) = (Floats::min(o, least), Floats::max(o, most));
                }
                wide |= most.largest() - least.smallest() > size / 64.0;
            }
        }
        apart == 0 && !wide
    }
}

/// Fewer than eight numbers, and after them `filler`.
fn padded(some: &[u32], filler: u32) -> [u32; 8] {
    let mut eight = [filler; 8];
    eight[..some.len()].copy_from_slice(some);
    eight
}

/// The coordinates of these points, an axis after the other.
#[inline(always)]
fn columns<I: Isa>(points: &[Point], at: &[u32; 8]) -> [I::F64x8; 3] {
    let [a, b, c, d, e, f, g, h] = *at;
    I::columns([
        &points[a as usize],
        &points[b as usize],
        &points[c as usize],
        &points[d as usize],
        &points[e as usize],
        &points[f as usize],
        &points[g as usize],
        &points[h as usize],
    ])
}

/// Takes the lowest lane out of a mask.
#[inline(always)]
pub fn take(mask: &mut Mask) -> Option<usize> {
    if *mask == 0 {
        return None;
    }
    let lane = mask.trailing_zeros() as usize;
    *mask &= *mask - 1;
    Some(lane)
}

/// A packet's bits of part `i`, as bits of the lanes of a register.
#[inline(always)]
pub fn part_of_mask<const N: usize>(mask: Mask, i: usize) -> u32 {
    (mask >> (i * N)) as u32 & ((1 << N) - 1)
}

/// A mask of so many rays.
#[inline(always)]
pub const fn all(count: usize) -> Mask {
    if count < LANES { (1 << count) - 1 } else { Mask::MAX }
}

/// Unit roundoff of float32.
const U: f32 = f32::EPSILON / 2.0;

/// A slope is the float32 reciprocal of a direction that was rounded to float32: that is off by u, or, if it is subnormal, by 2⁻¹⁵⁰, which is 4u of
/// 2⁻¹²⁸; with the reciprocal 5u. A subtraction and two products more, that by this factor among them, add 1u each: 8u, and half as much again.
///
/// Reciprocals below 2⁻¹²⁸ overflow. Then the true one is at least 2¹²⁸·(1 − 4u), which is above the largest number times `SHRINK`.
const SHRINK: f32 = 1.0 - 12.0 * U;
const STRETCH: f32 = 1.0 + 12.0 * U;

#[repr(C, align(64))]
pub struct Packet {
    subpackets: [Subpacket; SUBPACKETS],
    count: usize,
    /// t times this is t here; a power of two.
    scale: f64,
    pub(super) octant: Octant,
}

/// What all rays of a packet have in common: the lower bound of t, and by axis which plane of a box they enter first.
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
    fn set_limits<I: Isa>(&mut self, g: usize, t: &[f64; LANES], scale: I::F64x8) {
        let (low, high) = halves::<I>(t, g);
        let limit = I::narrow(low.mul(scale), high.mul(scale));
        self.limit = limit.mul(I::F32x16::splat(1.0 + 4.0 * U)).add(I::F32x16::splat(f32::MIN_POSITIVE)).store();
    }
}

/// Bounds of origins and slopes (reciprocal directions), over all rays or of one of them.
#[derive(Clone, Copy)]
pub(super) struct Frustum {
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    near_slope: [f32; 3],
    far_slope: [f32; 3],
}

/// The children of a node whose boxes any ray of a frustum may enter, the farthest first.
pub(super) struct BoxHits {
    pub count: usize,
    /// Which child each is of.
    pub child: [u32; WIDTH],
    /// Lower bounds of t.
    pub near: [f32; WIDTH],
    /// By child, from the origins to the near and to the far planes.
    first: [[f32; WIDTH]; 3],
    last: [[f32; WIDTH]; 3],
}

impl Packet {
    pub fn empty() -> Self {
        let octant = Octant { start: 0.0, backward: [false; 3] };
        Packet { subpackets: [Subpacket::EMPTY; SUBPACKETS], count: 0, scale: 1.0, octant }
    }

    /// Rays of one octant about the centre of a hierarchy, from t_min ≥ 0 to a limit each.
    #[inline(always)]
    pub fn enter<I: Isa>(&mut self, rays: &RayPacket, center: Point, t_min: f64, limits: &[f64; LANES]) {
        let octant = rays.octant;
        self.octant.backward = [octant & 1 != 0, octant & 2 != 0, octant & 4 != 0];
        self.count = rays.count;
        // Powers of two around 2^e ≤ largest < 2^(e+1): their exponents stay far inside float64's (see `RayPacket::gather`). Of rays much shorter than the
        // longest, components may underflow here; see `SHRINK`.
        let mut largest = I::F64x8::splat(0.0);
        for eight in 0..self.count.div_ceil(8) {
            for axis in 0..3 {
                largest = Floats::max(I::F64x8::load(&rays.direction[axis].as_chunks().0[eight]).abs(), largest);
            }
        }
        let exponent = largest.largest().to_bits() >> 52;
        let shrink = I::F64x8::splat(f64::from_bits((2045 - exponent) << 52));
        self.scale = f64::from_bits((exponent + 1) << 52);
        self.octant.start = (t_min * self.scale) as f32 * (1.0 - 4.0 * U);
        for g in 0..self.count.div_ceil(WIDE) {
            self.enter_subpacket::<I>(g, rays, center, shrink, limits);
        }
    }

    #[inline(always)]
    fn enter_subpacket<I: Isa>(
        &mut self,
        g: usize,
        rays: &RayPacket,
        center: Point,
        shrink: I::F64x8,
        limits: &[f64; LANES],
    ) {
        let (zero, one) = (I::F32x16::splat(0.0), I::F32x16::splat(1.0));
        let subpacket = &mut self.subpackets[g];
        let (low, high) = halves::<I>(&rays.origin_error, g);
        let origin_error = I::narrow(low, high).mul(I::F32x16::splat(1.0 + 4.0 * U));
        let origin_error = origin_error.add(I::F32x16::splat(f32::MIN_POSITIVE));
        // In float64, where errors of rays much shorter than the longest are not yet lost to underflow. What is lost of them, and of directions, is
        // at most half the smallest subnormal, 2⁻¹⁵⁰, each time; the least normal number, 2⁻¹²⁶, covers it.
        let (low, high) = halves::<I>(&rays.direction_error, g);
        let none = I::F64x8::splat(0.0);
        let vague = none.lt(low) | none.lt(high) != 0;
        let direction_error = I::narrow(low.mul(shrink), high.mul(shrink)).mul(I::F32x16::splat(1.0 + 4.0 * U));
        let direction_error = direction_error.add(I::F32x16::splat(f32::MIN_POSITIVE));
        for axis in 0..3 {
            let backward = self.octant.backward[axis];
            let sign = I::F32x16::splat(if backward { -1.0 } else { 1.0 });
            let middle = I::F64x8::splat(center[axis]);
            let (low, high) = halves::<I>(&rays.origin[axis], g);
            let o = I::narrow(low.sub(middle), high.sub(middle));
            // Conversion and difference: 1u and a trifle. The error of the origin is rounded up along with it.
            let error = o.abs().mul(I::F32x16::splat(4.0 * U)).add(origin_error).mul(sign);
            subpacket.near_origin[axis] = o.add(error).store();
            subpacket.far_origin[axis] = o.sub(error).store();
            let (low, high) = halves::<I>(&rays.direction[axis], g);
            let d = I::narrow(low.mul(shrink), high.mul(shrink)).abs();
            let mut least = d;
            let mut near = one.div(d);
            let mut far = near;
            if vague {
                // The error also covers what rounded d and the difference may be off.
                let error = direction_error.add(d.mul(I::F32x16::splat(4.0 * U)));
                least = Floats::max(d.sub(error), zero);
                (near, far) = (one.div(d.add(error)), one.div(least));
            }
            let near = Floats::min(near, I::F32x16::splat(f32::MAX)).mul(I::F32x16::splat(SHRINK));
            let far = far.mul(I::F32x16::splat(STRETCH));
            subpacket.near_slope[axis] = near.mul(sign).store();
            subpacket.far_slope[axis] = far.mul(sign).store();
            let mut unknown = if vague { least.le(zero) } else { 0 };
            while unknown != 0 {
                // The sign is not known: these planes bound nothing.
                let lane = unknown.trailing_zeros() as usize;
                unknown &= unknown - 1;
                let infinity = if backward { f32::NEG_INFINITY } else { f32::INFINITY };
                subpacket.near_origin[axis][lane] = infinity;
                subpacket.far_origin[axis][lane] = -infinity;
            }
        }
        subpacket.set_limits::<I>(g, limits, I::F64x8::splat(self.scale));
    }

    /// Where the signs of a lane's direction are not known, `octant` may be any.
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

    /// A number after the other: to read back in one piece what was written in several takes long.
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
    pub(super) fn limit_of(&self, t: f64) -> f32 {
        (t * self.scale) as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE
    }

    /// Sets the limits of all rays; as `limit_of`.
    #[inline(always)]
    pub(super) fn set_limits<I: Isa>(&mut self, t: &[f64; LANES]) {
        let scale = I::F64x8::splat(self.scale);
        for (g, subpacket) in self.subpackets.iter_mut().enumerate() {
            subpacket.set_limits::<I>(g, t, scale);
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

    /// The rays of `mask` that may enter box i of a node that the frustum has been tested with: by the origins of the frustum, and slopes of their own.
    #[inline(always)]
    pub(super) fn intersect<I: Isa>(&self, mask: Mask, box_hits: &BoxHits, i: usize) -> Mask {
        let mut hit = 0;
        for (g, subpacket) in self.subpackets.iter().enumerate() {
            let mut near = I::F32x16::splat(self.octant.start);
            let mut far = I::F32x16::load(&subpacket.limit);
            for axis in 0..3 {
                let t = I::F32x16::splat(box_hits.first[axis][i]).mul(I::F32x16::load(&subpacket.near_slope[axis]));
                near = t.max(near);
                let t = I::F32x16::splat(box_hits.last[axis][i]).mul(I::F32x16::load(&subpacket.far_slope[axis]));
                far = t.min(far);
            }
            hit |= Mask::from(near.le(far)) << (WIDE * g);
        }
        hit & mask
    }
}

/// The children of a node whose boxes any of a few rays may enter, the farthest first.
pub(super) struct FewBoxHits {
    pub count: usize,
    /// Which child each is of.
    pub child: [u32; WIDTH],
    /// Lower bounds of t.
    pub near: [f32; WIDTH],
    /// By child, the rays that may enter it.
    pub masks: [Mask; WIDTH],
}

impl Packet {
    /// As `Frustum::intersect` and `Packet::intersect`, ray by ray.
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
            // Finite, to differ from boxes that are missed.
            near = Floats::min(near, largest);
            masks = I::mark(masks, near, far, 1 << lane);
            nearest = Floats::min(near.le_pick(far, near, beyond), nearest);
        }
        let (count, near, child) = I::by_distance(nearest, largest, &[0, 1, 2, 3, 4, 5, 6, 7]);
        FewBoxHits { count, child, near, masks: I::masks(masks) }
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

    /// From the origins to the near and to the far planes of the boxes of a node.
    #[inline(always)]
    fn planes<I: Isa>(&self, octant: &Octant, node: &Node) -> ([I::F32x8; 3], [I::F32x8; 3]) {
        let zero = I::F32x8::splat(0.0);
        let (mut firsts, mut lasts) = ([zero; 3], [zero; 3]);
        for i in 0..3 {
            let (first, last) =
                if octant.backward[i] { (&node.high[i], &node.low[i]) } else { (&node.low[i], &node.high[i]) };
            firsts[i] = I::F32x8::load(first).sub(I::F32x8::splat(self.near_origin[i]));
            lasts[i] = I::F32x8::load(last).sub(I::F32x8::splat(self.far_origin[i]));
        }
        (firsts, lasts)
    }

    /// The slab test of the boxes of a node: bounds of t where rays of the frustum may enter, and where they must have left.
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

/// The slab tests of a frustum with the boxes of a node.
pub(super) struct Slabs<I: Isa> {
    pub near: I::F32x8,
    pub far: I::F32x8,
    /// From the origins to the near and to the far planes.
    first: [I::F32x8; 3],
    last: [I::F32x8; 3],
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, Task, dispatch};

    struct Gather<'a> {
        rays: &'a mut RayPacket,
        origins: &'a [Point],
        directions: &'a [Point],
        order: &'a [u32],
    }

    impl Task for Gather<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self) {
            self.rays.gather::<I>(self.origins, self.directions, self.order);
        }
    }

    /// One ray after the other, by scalar comparisons.
    fn expected(rays: &[(Point, Point)]) -> usize {
        let fits = |(o, d): &(Point, Point)| {
            let small = o.iter().chain(d).all(|x| -1e30 < *x && *x < 1e30);
            small && d.iter().any(|x| *x < -1e-30 || *x > 1e-30)
        };
        let signs = |d: Point| d.map(|x| x < 0.0);
        rays.iter().take(LANES).take_while(|ray| fits(ray) && signs(ray.1) == signs(rays[0].1)).count()
    }

    #[test]
    fn a_packet_ends_before_a_ray_that_it_cannot_hold() {
        let odd_origins = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30, -1e30, 1e300, 1e30_f64.next_down()];
        let odd_directions: [fn(Point) -> Point; 12] = [
            |d| [-d[0], d[1], d[2]],
            |d| [d[0], -d[1], d[2]],
            |d| [d[0], d[1], -d[2]],
            |d| [f64::NAN, d[1], d[2]],
            |d| [d[0], f64::INFINITY.copysign(d[1]), d[2]],
            |d| [d[0], d[1], 1e30_f64.copysign(d[2])],
            |d| d.map(|x| 1e-30_f64.copysign(x)),
            |d| d.map(|x| 1e-30_f64.next_up().copysign(x)),
            |d| d.map(|x| 1e-300 * x),
            |_| [0.0; 3],
            // Zeros belong to the positive side, whatever their sign.
            |d| [d[0], d[1].min(-0.0), d[2]],
            |d| [d[0], d[1].max(0.0), d[2]],
        ];
        let (mut whole, mut cut, mut none) = (0, 0, 0);
        for octant in [0, 2, 5, 7] {
            let sign = |axis: usize| if octant >> axis & 1 != 0 { -1.0 } else { 1.0 };
            let ray = |i: usize| {
                let direction = [1.0, 2.0, 3.0].map(|x| x + i as f64);
                ([0.5, -7.0, i as f64], [0, 1, 2].map(|axis| sign(axis) * direction[axis]))
            };
            for place in [0, 1, 7, 8, 9, 15, 16, 17, 62, 63, 64, 70] {
                for odd in 0..odd_origins.len() + odd_directions.len() {
                    let mut rays: Vec<(Point, Point)> = (0..80).map(ray).collect();
                    match odd_origins.get(odd) {
                        Some(x) => rays[place].0[odd % 3] = *x,
                        None => rays[place].1 = odd_directions[odd - odd_origins.len()](rays[place].1),
                    }
                    for many in [1, 5, 16, 63, 80] {
                        let (origins, directions): (Vec<Point>, Vec<Point>) = rays.iter().copied().unzip();
                        let order: Vec<u32> = (0..many).collect();
                        for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                            // What was in the lanes before must not matter.
                            let mut found = RayPacket::empty();
                            (0..LANES).for_each(|lane| found.set(lane, [f64::NAN; 3], [-1e300; 3]));
                            let (rays_taken, order) = (&mut found, &order[..]);
                            let (origins, directions) = (&origins[..], &directions[..]);
                            dispatch(level, Gather { rays: rays_taken, origins, directions, order });
                            let count = found.count;
                            let known = expected(&rays[..many as usize]);
                            assert_eq!(count, known, "{level:?}: {odd} at {place} of {many}");
                            assert!((0..count).all(|lane| found.at[lane] == lane as u32));
                            check(&found, &rays);
                            whole += usize::from(count == LANES.min(many as usize));
                            cut += usize::from((1..LANES.min(many as usize)).contains(&count));
                            none += usize::from(count == 0);
                        }
                    }
                }
            }
        }
        assert!(whole > 500 && cut > 500 && none > 500, "{whole}, {cut}, {none}");
    }

    use crate::arith::number::{Dyadic, Number};
    use crate::arith::simd::Portable;
    use crate::testing::worst;

    /// A packet of one ray, from the origin along (d, 0.9, 0), and it is seen so by a box's axis x.
    fn packet(o: f64, d: f64, direction_error: f64, t: f64) -> Packet {
        let mut rays = RayPacket::empty();
        rays.count = 1;
        for lane in 0..WIDE {
            rays.set(lane, [o, 0.0, 0.0], [d, 0.9, 0.0]);
            rays.direction_error[lane] = direction_error;
        }
        let mut packet = Packet::empty();
        packet.enter::<Portable>(&rays, [0.0; 3], t, &[t; LANES]);
        packet
    }

    /// x/y − 1, in roundings of float32.
    fn roundings(x: &Dyadic, y: &Dyadic) -> f64 {
        x.minus(y).split().0 / (y.split().0 * f64::from(U))
    }

    /// How far each bound is on the safe side at least, in roundings of float32.
    #[test]
    fn bounds_in_float32_are_on_the_safe_side_by_what_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 0.25 + 0.25 * next();
        let n = |x: f32| Dyadic::exact(f64::from(x));
        let least = |score: &dyn Fn(&[f64; 2]) -> f64| -worst(6, 3000, draw, |x: &[f64; 2]| -score(x)).0;
        // The plane is at x, the direction is y; all is in [¼, ½], and `scale` is 1, so that t = x/y.
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
            let (low, high) =
                (Dyadic::exact(x[1]).minus(&Dyadic::exact(error)), Dyadic::exact(x[1]).plus(&Dyadic::exact(error)));
            let beyond = [
                -roundings(&n(subpacket.near_slope[0][0]).times(&high), &one),
                roundings(&n(subpacket.far_slope[0][0]).times(&low), &one),
            ];
            beyond[0].min(beyond[1])
        });
        let limits = least(&|x| {
            let packet = packet(0.0, 0.5, 0.0, x[0]);
            let beyond = [
                roundings(&n(packet.subpackets[0].limit[0]), &Dyadic::exact(x[0])),
                roundings(&n(packet.limit_of(x[0])), &Dyadic::exact(x[0])),
                -roundings(&n(packet.octant.start), &Dyadic::exact(x[0])),
            ];
            beyond[0].min(beyond[1]).min(beyond[2])
        });
        // Each loses at most as many as are counted where it is defined, and no more of the rest is kept than that.
        assert!((7.0..9.0).contains(&near) && (7.0..9.0).contains(&far), "{near}, {far}");
        assert!((2.0..3.0).contains(&origins), "{origins}");
        assert!((12.0..14.0).contains(&vague), "{vague}");
        assert!((1.0..3.0).contains(&limits), "{limits}");
    }

    /// As `bounds_in_float32_...`, of directions that are subnormal numbers in float32.
    #[test]
    fn slopes_of_directions_that_underflow_are_on_the_safe_side() {
        let mut least = f64::INFINITY;
        for k in 0..40_000 {
            let d = 2.0_f64.powi(-130 + k % 6) * (1.0 + f64::from(k) / 40_000.0);
            let subpacket = packet(0.0, d, 0.0, 1.0).subpackets[0];
            let (near, far) = (f64::from(subpacket.near_slope[0][0]), f64::from(subpacket.far_slope[0][0]));
            // Products with a power of two and of 77 bits, rounded once: 2⁻⁵³ is far below a rounding of float32.
            least = least.min((1.0 - near * d) / f64::from(U)).min((far * d - 1.0) / f64::from(U));
        }
        assert!((6.5..8.0).contains(&least), "{least}");
    }

    /// The rays that were kept are as given, and lanes that a subpacket has beyond them repeat the first.
    fn check(found: &RayPacket, given: &[(Point, Point)]) {
        for lane in 0..found.count.next_multiple_of(WIDE) {
            let (origin, direction) = given[if lane < found.count { lane } else { 0 }];
            assert_eq!((found.origin(lane), found.direction(lane)), (origin, direction));
        }
        if found.count > 0 {
            let signs = [1, 2, 4].map(|bit| found.octant & bit != 0);
            assert_eq!(signs, given[0].1.map(|x| x < 0.0));
            assert_eq!(found.one_origin, given[..found.count].iter().all(|(o, _)| *o == given[0].0));
        }
    }
}
