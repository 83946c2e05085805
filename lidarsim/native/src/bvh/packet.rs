//! Up to sixteen rays that point into the same octant, as the boxes see them: float32, with every rounding on the safe side.
//!
//! As in `Span`, the t of a box's near plane is bounded from below and that of its far plane from above. A hull of the rays, one
//! interval of origins and slopes, rules out most boxes for all rays at once.

use super::{Node, WIDTH};
use crate::simd::{Floats, Isa};
use crate::vector::Point;

pub const LANES: usize = 16;

/// A bit for each ray of a packet.
pub type Mask = u32;

/// Rays as they are, a lane each; lanes beyond the last ray repeat the first.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct Rays {
    pub origin: [[f64; LANES]; 3],
    pub direction: [[f64; LANES]; 3],
    /// How far each coordinate of origin and direction may be off.
    pub origin_error: [f64; LANES],
    pub direction_error: [f64; LANES],
    /// The signs of all directions, a bit an axis.
    pub octant: u32,
    /// Whether all rays have the same origin and no errors.
    pub one_origin: bool,
    pub count: usize,
}

impl Rays {
    pub fn empty() -> Self {
        Rays {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            origin_error: [0.0; LANES],
            direction_error: [0.0; LANES],
            octant: 0,
            one_origin: false,
            count: 0,
        }
    }

    #[inline(always)]
    pub fn set(&mut self, lane: usize, origin: Point, direction: Point) {
        for i in 0..3 {
            self.origin[i][lane] = origin[i];
            self.direction[i][lane] = direction[i];
        }
    }

    /// Takes up the first rays of this order.
    #[inline(always)]
    pub fn take_up(&mut self, origins: &[Point], directions: &[Point], order: &[u32]) {
        self.count = order.len().min(LANES);
        for (lane, &i) in order[..self.count].iter().enumerate() {
            self.set(lane, origins[i as usize], directions[i as usize]);
        }
    }

    /// Keeps the rays up to the first that points into another octant, and says how many: none if packets cannot hold the first, which is then
    /// left to `Span`. They hold components whose squares, and scaled ones, are ordinary float64 numbers.
    #[inline(always)]
    pub fn look<I: Isa>(&mut self) -> usize {
        let (mut fit, mut together) = (0, 0);
        let mut signs = [0; 3];
        for half in 0..LANES / 8 {
            let huge = I::F64x8::splat(1e30);
            let mut within = 0xff;
            let mut at_one = 0xff;
            let mut largest = I::F64x8::splat(0.0);
            for axis in 0..3 {
                let o = I::F64x8::load(&self.origin[axis].as_chunks().0[half]);
                let d = I::F64x8::load(&self.direction[axis].as_chunks().0[half]);
                let first = I::F64x8::splat(self.origin[axis][0]);
                // Each comparison is false for NaN.
                within &= o.abs().lt(huge) & d.abs().lt(huge);
                at_one &= o.le(first) & first.le(o);
                largest = Floats::max(d.abs(), largest);
                signs[axis] |= d.lt(I::F64x8::splat(0.0)) << (8 * half);
            }
            fit |= (within & I::F64x8::splat(1e-30).lt(largest)) << (8 * half);
            together |= at_one << (8 * half);
        }
        self.octant = signs[0] & 1 | (signs[1] & 1) << 1 | (signs[2] & 1) << 2;
        for sign in signs {
            fit &= if sign & 1 != 0 { sign } else { !sign };
        }
        self.count = (fit.trailing_ones() as usize).min(self.count);
        self.one_origin = together & all(self.count) == all(self.count);
        for lane in self.count..LANES {
            self.set(lane, self.origin(0), self.direction(0));
        }
        self.count
    }

    /// Whether packets may hold the ray: as `look` asks.
    pub fn holds(origin: Point, direction: Point) -> bool {
        let largest = direction.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        origin.iter().chain(&direction).all(|x| x.abs() < 1e30) && largest > 1e-30
    }

    /// The signs of a direction, a bit an axis.
    pub fn octant_of(direction: Point) -> u32 {
        (0..3).fold(0, |octant, axis| octant | u32::from(direction[axis] < 0.0) << axis)
    }

    /// These rays of one octant alone.
    pub fn only(&self, mask: Mask, octant: u32) -> Self {
        let mut rays = self.clone();
        rays.octant = octant;
        let first = mask.trailing_zeros() as usize;
        for lane in 0..LANES {
            if mask & 1 << lane == 0 {
                rays.set(lane, self.origin(first), self.direction(first));
                rays.origin_error[lane] = self.origin_error[first];
                rays.direction_error[lane] = self.direction_error[first];
            }
        }
        rays
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
        for other in 0..LANES {
            same |= Mask::from(self.origin(other) == origin && self.origin_error[other] == error) << other;
        }
        same
    }

    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Point {
        [self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]]
    }

    /// Whether the rays keep together in a scene of this size, so that they meet much the same boxes.
    #[inline(always)]
    pub fn are_coherent<I: Isa>(&self, size: f64) -> bool {
        let first = self.direction(0);
        let length2 = first[0] * first[0] + first[1] * first[1] + first[2] * first[2];
        let mut apart = 0;
        for half in 0..LANES / 8 {
            let (mut dot, mut norm2) = (I::F64x8::splat(0.0), I::F64x8::splat(0.0));
            for axis in 0..3 {
                let d = I::F64x8::load(&self.direction[axis].as_chunks().0[half]);
                dot = d.fused(I::F64x8::splat(first[axis]), dot);
                norm2 = d.fused(d, norm2);
            }
            // More than 30° from the first.
            apart |= dot.mul(dot).lt(norm2.mul(I::F64x8::splat(0.75 * length2)));
        }
        let mut wide = false;
        if !self.one_origin {
            for axis in 0..3 {
                let [a, b] = self.origin[axis].as_chunks().0 else { continue };
                let (a, b) = (I::F64x8::load(a), I::F64x8::load(b));
                wide |= Floats::max(a, b).largest() - Floats::min(a, b).smallest() > size / 64.0;
            }
        }
        apart == 0 && !wide
    }
}

/// A mask of so many rays.
#[inline(always)]
pub fn all(count: usize) -> Mask {
    ((1_u64 << count) - 1) as Mask
}

/// Unit roundoff of float32.
const U: f32 = f32::EPSILON / 2.0;

/// A slope is the float32 reciprocal of a float32 direction, off by 4u; a subtraction and two products more add 1u each: 7u, nearly doubled.
const SHRINK: f32 = 1.0 - 12.0 * U;
const STRETCH: f32 = 1.0 + 12.0 * U;

#[repr(C, align(64))]
pub struct Packet {
    near_origin: [[f32; LANES]; 3],
    far_origin: [[f32; LANES]; 3],
    near_slope: [[f32; LANES]; 3],
    far_slope: [[f32; LANES]; 3],
    limit: [f32; LANES],
    start: f32,
    /// t times this is t here; a power of two.
    scale: f64,
    backward: [bool; 3],
}

/// Bounds of origins and slopes, over all rays or of one of them.
#[derive(Clone, Copy)]
pub(super) struct Hull {
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    near_slope: [f32; 3],
    far_slope: [f32; 3],
    start: f32,
    backward: [bool; 3],
}

/// The boxes of a node that any ray of a hull may meet.
pub(super) struct Meeting {
    /// A bit each.
    pub met: u32,
    /// Lower bounds of t.
    pub near: [f32; WIDTH],
    /// From the origins to the near and to the far planes.
    first: [[f32; WIDTH]; 3],
    last: [[f32; WIDTH]; 3],
}

impl Packet {
    /// Rays of one octant about the centre of a hierarchy, from t_min ≥ 0 to a limit each.
    #[inline(always)]
    pub fn new<I: Isa>(rays: &Rays, center: Point, t_min: f64, limits: &[f64; LANES]) -> Self {
        let octant = rays.octant;
        let backward = [octant & 1 != 0, octant & 2 != 0, octant & 4 != 0];
        let mut packet = Packet {
            near_origin: [[0.0; LANES]; 3],
            far_origin: [[0.0; LANES]; 3],
            near_slope: [[0.0; LANES]; 3],
            far_slope: [[0.0; LANES]; 3],
            limit: [0.0; LANES],
            start: 0.0,
            scale: 1.0,
            backward,
        };
        // Powers of two around 2^e ≤ largest < 2^(e+1): their exponents stay far inside float64's (see `Rays::look`). Of rays much shorter than the
        // longest, components may underflow here, which only weakens their bounds.
        let mut largest = I::F64x8::splat(0.0);
        for axis in 0..3 {
            for half in rays.direction[axis].as_chunks().0 {
                largest = Floats::max(I::F64x8::load(half).abs(), largest);
            }
        }
        let exponent = largest.largest().to_bits() >> 52;
        let shrink = I::F64x8::splat(f64::from_bits((2045 - exponent) << 52));
        packet.scale = f64::from_bits((exponent + 1) << 52);
        let [low, high] = rays.origin_error.as_chunks().0 else { return packet };
        let origin_error = I::narrow(I::F64x8::load(low), I::F64x8::load(high));
        let origin_error = origin_error.mul(I::F32x16::splat(1.0 + 4.0 * U)).add(I::F32x16::splat(f32::MIN_POSITIVE));
        let [low, high] = rays.direction_error.as_chunks().0 else { return packet };
        let direction_error = I::narrow(I::F64x8::load(low).mul(shrink), I::F64x8::load(high).mul(shrink));
        let direction_error = direction_error.mul(I::F32x16::splat(1.0 + 4.0 * U));
        let vague = I::F32x16::splat(0.0).lt(direction_error) != 0;
        let zero = I::F32x16::splat(0.0);
        for axis in 0..3 {
            let sign = I::F32x16::splat(if backward[axis] { -1.0 } else { 1.0 });
            let middle = I::F64x8::splat(center[axis]);
            let [low, high] = rays.origin[axis].as_chunks().0 else { return packet };
            let o = I::narrow(I::F64x8::load(low).sub(middle), I::F64x8::load(high).sub(middle));
            // Conversion and difference: 1u and a trifle. The error of the origin is rounded up along with it.
            let error = o.abs().mul(I::F32x16::splat(4.0 * U)).add(origin_error).mul(sign);
            packet.near_origin[axis] = o.add(error).store();
            packet.far_origin[axis] = o.sub(error).store();
            let [low, high] = rays.direction[axis].as_chunks().0 else { return packet };
            let d = I::narrow(I::F64x8::load(low).mul(shrink), I::F64x8::load(high).mul(shrink)).abs();
            let (mut most, mut least) = (d, d);
            if vague {
                // The error also covers what rounded d and the difference may be off.
                let error = direction_error.add(d.mul(I::F32x16::splat(4.0 * U)));
                (most, least) = (d.add(error), Floats::max(d.sub(error), zero));
            }
            let one = I::F32x16::splat(1.0);
            let near = Floats::min(one.div(most).mul(I::F32x16::splat(SHRINK)), I::F32x16::splat(f32::MAX));
            let far = one.div(least).mul(I::F32x16::splat(STRETCH));
            packet.near_slope[axis] = near.mul(sign).store();
            packet.far_slope[axis] = far.mul(sign).store();
            let mut unknown = if vague { least.le(zero) } else { 0 };
            while unknown != 0 {
                // The sign is not known: these planes bound nothing.
                let lane = unknown.trailing_zeros() as usize;
                unknown &= unknown - 1;
                let infinity = if backward[axis] { f32::NEG_INFINITY } else { f32::INFINITY };
                packet.near_origin[axis][lane] = infinity;
                packet.far_origin[axis][lane] = -infinity;
            }
        }
        packet.start = (t_min * packet.scale) as f32 * (1.0 - 4.0 * U);
        let scale = I::F64x8::splat(packet.scale);
        let [low, high] = limits.as_chunks().0 else { return packet };
        let limit = I::narrow(I::F64x8::load(low).mul(scale), I::F64x8::load(high).mul(scale));
        packet.limit = limit.mul(I::F32x16::splat(1.0 + 4.0 * U)).add(I::F32x16::splat(f32::MIN_POSITIVE)).store();
        packet
    }

    /// Where the signs of a lane's direction are not known, `octant` may be any.
    #[inline(always)]
    pub(super) fn hull_of_all<I: Isa>(&self) -> Hull {
        let mut hull = self.hull_of_one(0);
        for axis in 0..3 {
            let (near_origin, far_origin) =
                (I::F32x16::load(&self.near_origin[axis]), I::F32x16::load(&self.far_origin[axis]));
            let (near_slope, far_slope) =
                (I::F32x16::load(&self.near_slope[axis]), I::F32x16::load(&self.far_slope[axis]));
            if self.backward[axis] {
                hull.near_origin[axis] = near_origin.smallest();
                hull.far_origin[axis] = far_origin.largest();
                hull.near_slope[axis] = near_slope.largest();
                hull.far_slope[axis] = far_slope.smallest();
            } else {
                hull.near_origin[axis] = near_origin.largest();
                hull.far_origin[axis] = far_origin.smallest();
                hull.near_slope[axis] = near_slope.smallest();
                hull.far_slope[axis] = far_slope.largest();
            }
        }
        hull
    }

    #[inline(always)]
    pub(super) fn hull_of_one(&self, lane: usize) -> Hull {
        Hull {
            near_origin: [self.near_origin[0][lane], self.near_origin[1][lane], self.near_origin[2][lane]],
            far_origin: [self.far_origin[0][lane], self.far_origin[1][lane], self.far_origin[2][lane]],
            near_slope: [self.near_slope[0][lane], self.near_slope[1][lane], self.near_slope[2][lane]],
            far_slope: [self.far_slope[0][lane], self.far_slope[1][lane], self.far_slope[2][lane]],
            start: self.start,
            backward: self.backward,
        }
    }

    #[inline(always)]
    pub(super) fn limit(&self, lane: usize) -> f32 {
        self.limit[lane]
    }

    /// Nothing beyond t is wanted of this ray any more.
    #[inline(always)]
    pub(super) fn set_limit(&mut self, lane: usize, t: f64) {
        self.limit[lane] = (t * self.scale) as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE;
    }

    /// The rays whose limit is not nearer than `near`.
    #[inline(always)]
    pub(super) fn within<I: Isa>(&self, near: f32) -> Mask {
        I::F32x16::splat(near).le(I::F32x16::load(&self.limit))
    }

    /// The rays that may meet box i of a node that the hull has met: with the origins of the hull, and slopes of their own.
    #[inline(always)]
    pub(super) fn meet<I: Isa>(&self, meeting: &Meeting, i: usize) -> Mask {
        let mut near = I::F32x16::splat(self.start);
        let mut far = I::F32x16::load(&self.limit);
        for axis in 0..3 {
            let t = I::F32x16::splat(meeting.first[axis][i]).mul(I::F32x16::load(&self.near_slope[axis]));
            near = t.max(near);
            let t = I::F32x16::splat(meeting.last[axis][i]).mul(I::F32x16::load(&self.far_slope[axis]));
            far = t.min(far);
        }
        near.le(far)
    }
}

impl Hull {
    #[inline(always)]
    pub(super) fn meet<I: Isa>(&self, node: &Node, limit: f32) -> Meeting {
        let mut meeting = Meeting { met: 0, near: [0.0; WIDTH], first: [[0.0; WIDTH]; 3], last: [[0.0; WIDTH]; 3] };
        let mut near = I::F32x8::splat(self.start);
        let mut far = I::F32x8::splat(limit);
        for i in 0..3 {
            let (first, last) =
                if self.backward[i] { (&node.high[i], &node.low[i]) } else { (&node.low[i], &node.high[i]) };
            let first = I::F32x8::load(first).sub(I::F32x8::splat(self.near_origin[i]));
            let last = I::F32x8::load(last).sub(I::F32x8::splat(self.far_origin[i]));
            near = first.mul(I::F32x8::splat(self.near_slope[i])).max(near);
            far = last.mul(I::F32x8::splat(self.far_slope[i])).min(far);
            meeting.first[i] = first.store();
            meeting.last[i] = last.store();
        }
        meeting.near = near.store();
        meeting.met = near.le(far);
        meeting
    }
}
