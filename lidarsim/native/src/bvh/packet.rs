//! Up to sixteen rays that point into the same octant, as the boxes see them: float32, with every rounding on the safe side.
//!
//! As in `Span`, the t of a box's near plane is bounded from below and that of its far plane from above. A hull of the rays, one
//! interval of origins and slopes, rules out most boxes for all rays at once.

use super::WIDTH;
use crate::simd::{Floats, Isa};
use crate::vector::Point;

pub const LANES: usize = 16;

/// Rays as they are, a lane each; lanes beyond the last ray repeat the first.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct Rays {
    pub origin: [[f64; LANES]; 3],
    pub direction: [[f64; LANES]; 3],
    /// How far each coordinate of origin and direction may be off.
    pub origin_error: [f64; LANES],
    pub direction_error: [f64; LANES],
    pub count: usize,
}

impl Rays {
    pub fn empty() -> Self {
        Rays {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            origin_error: [0.0; LANES],
            direction_error: [0.0; LANES],
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

    #[inline(always)]
    pub fn origin(&self, lane: usize) -> Point {
        [self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]]
    }

    #[inline(always)]
    pub fn same_origin(&self, lane: usize, other: usize) -> bool {
        self.origin(lane) == self.origin(other) && self.origin_error[lane] == self.origin_error[other]
    }

    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Point {
        [self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]]
    }

    /// Whether packets may hold the ray: components whose squares, and scaled ones, are ordinary float64 numbers. The rest is
    /// left to `Span`.
    #[inline(always)]
    pub fn holds(origin: Point, direction: Point) -> bool {
        // Each comparison is false for NaN.
        let within = |x: f64| x.abs() < 1e30;
        let beyond = |x: f64| x.abs() > 1e-30;
        within(origin[0])
            && within(origin[1])
            && within(origin[2])
            && within(direction[0])
            && within(direction[1])
            && within(direction[2])
            && (beyond(direction[0]) || beyond(direction[1]) || beyond(direction[2]))
    }

    /// The signs of the direction, a bit each; rays of one packet have the same.
    #[inline(always)]
    pub fn octant(direction: Point) -> u32 {
        u32::from(direction[0] < 0.0) | u32::from(direction[1] < 0.0) << 1 | u32::from(direction[2] < 0.0) << 2
    }
}

/// Unit roundoff of float32.
const U: f32 = f32::EPSILON / 2.0;

/// A slope is the float32 reciprocal of a float32 direction, off by 3u; a subtraction and two products more add 1u each: 6u, doubled.
const SHRINK: f32 = 1.0 - 12.0 * U;
const STRETCH: f32 = 1.0 + 12.0 * U;

#[repr(C, align(64))]
pub struct Packet {
    near_origin: [[f32; LANES]; 3],
    far_origin: [[f32; LANES]; 3],
    near_slope: [[f32; LANES]; 3],
    far_slope: [[f32; LANES]; 3],
    start: [f32; LANES],
    limit: [f32; LANES],
    /// t times this is t here; a power of two.
    scale: [f64; LANES],
    backward: [bool; 3],
    hull: Hull,
}

/// Bounds of the same over all rays, or those of one of them.
#[derive(Clone, Copy)]
struct Hull {
    near_origin: [f32; 3],
    far_origin: [f32; 3],
    near_slope: [f32; 3],
    far_slope: [f32; 3],
    start: f32,
}

impl Packet {
    /// Rays of one octant about the centre of a hierarchy, from t_min ≥ 0 to a limit each.
    #[inline(always)]
    pub fn new(rays: &Rays, octant: u32, center: Point, t_min: f64, limits: &[f64; LANES]) -> Self {
        let backward = [octant & 1 != 0, octant & 2 != 0, octant & 4 != 0];
        let mut packet = Packet {
            near_origin: [[0.0; LANES]; 3],
            far_origin: [[0.0; LANES]; 3],
            near_slope: [[0.0; LANES]; 3],
            far_slope: [[0.0; LANES]; 3],
            start: [0.0; LANES],
            limit: [0.0; LANES],
            scale: [1.0; LANES],
            backward,
            hull: Hull {
                near_origin: [0.0; 3],
                far_origin: [0.0; 3],
                near_slope: [0.0; 3],
                far_slope: [0.0; 3],
                start: 0.0,
            },
        };
        let mut shrink = [0.0; LANES];
        for k in 0..LANES {
            let [x, y, z] = [rays.direction[0][k].abs(), rays.direction[1][k].abs(), rays.direction[2][k].abs()];
            let largest = if x > y { x } else { y };
            let largest = if largest > z { largest } else { z };
            // Powers of two around 2^e ≤ largest < 2^(e+1): their exponents stay far inside float64's (see `Rays::holds`).
            let exponent = largest.to_bits() >> 52;
            shrink[k] = f64::from_bits((2045 - exponent) << 52);
            packet.scale[k] = f64::from_bits((exponent + 1) << 52);
        }
        for i in 0..3 {
            let sign = if backward[i] { -1.0_f32 } else { 1.0 };
            for k in 0..LANES {
                let o = (rays.origin[i][k] - center[i]) as f32;
                // Conversion and difference: 1u and a trifle. The error of the origin is rounded up along with it.
                let error = o.abs() * (4.0 * U) + rays.origin_error[k] as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE;
                packet.near_origin[i][k] = o + sign * error;
                packet.far_origin[i][k] = o - sign * error;
                let d = (rays.direction[i][k].abs() * shrink[k]) as f32;
                // Where there is an error, it also covers what rounded d and the difference may be off.
                let error = (rays.direction_error[k] * shrink[k]) as f32 * (1.0 + 4.0 * U);
                let error = if error > 0.0 { error + d * (4.0 * U) } else { 0.0 };
                let near = SHRINK / (d + error);
                let near = if near < f32::MAX { near } else { f32::MAX };
                let small = d - error;
                let far = STRETCH / if small > 0.0 { small } else { 0.0 };
                packet.near_slope[i][k] = sign * near;
                packet.far_slope[i][k] = sign * far;
                if error >= d && error > 0.0 {
                    // The sign is not known: these planes bound nothing.
                    packet.near_origin[i][k] = sign * f32::INFINITY;
                    packet.far_origin[i][k] = -sign * f32::INFINITY;
                }
            }
        }
        for k in 0..LANES {
            let start = (t_min * packet.scale[k]) as f32 * (1.0 - 4.0 * U);
            packet.start[k] = start;
            packet.set_limit(k, limits[k]);
        }
        packet.hull = packet.hull_of_all();
        packet
    }

    /// Where the signs of a lane's direction are not known, `octant` may be any.
    #[inline(always)]
    fn hull_of_all(&self) -> Hull {
        let least = |x: &[f32; LANES]| x.iter().fold(f32::INFINITY, |m, &x| if x < m { x } else { m });
        let most = |x: &[f32; LANES]| x.iter().fold(f32::NEG_INFINITY, |m, &x| if x > m { x } else { m });
        let mut hull = self.hull;
        hull.start = least(&self.start);
        for i in 0..3 {
            let (near_origin, far_origin) = (&self.near_origin[i], &self.far_origin[i]);
            let (near_slope, far_slope) = (&self.near_slope[i], &self.far_slope[i]);
            if self.backward[i] {
                hull.near_origin[i] = least(near_origin);
                hull.far_origin[i] = most(far_origin);
                hull.near_slope[i] = most(near_slope);
                hull.far_slope[i] = least(far_slope);
            } else {
                hull.near_origin[i] = most(near_origin);
                hull.far_origin[i] = least(far_origin);
                hull.near_slope[i] = least(near_slope);
                hull.far_slope[i] = most(far_slope);
            }
        }
        hull
    }

    #[inline(always)]
    fn hull_of_one(&self, lane: usize) -> Hull {
        let pick = |x: &[[f32; LANES]; 3]| [x[0][lane], x[1][lane], x[2][lane]];
        Hull {
            near_origin: pick(&self.near_origin),
            far_origin: pick(&self.far_origin),
            near_slope: pick(&self.near_slope),
            far_slope: pick(&self.far_slope),
            start: self.start[lane],
        }
    }

    /// Nothing beyond t is wanted of this ray any more.
    #[inline(always)]
    pub fn set_limit(&mut self, lane: usize, t: f64) {
        self.limit[lane] = (t * self.scale[lane]) as f32 * (1.0 + 4.0 * U) + f32::MIN_POSITIVE;
    }

    /// The rays whose limit is not nearer than `near`.
    #[inline(always)]
    pub(super) fn within<I: Isa>(&self, near: f32) -> u32 {
        I::F32x16::splat(near).le(I::F32x16::load(&self.limit))
    }

    /// The boxes of a node that any ray of `mask` may meet, a bit each, and lower bounds of t there.
    #[inline(always)]
    pub(super) fn meet_any<I: Isa>(
        &self,
        mask: u32,
        low: &[[f32; WIDTH]; 3],
        high: &[[f32; WIDTH]; 3],
    ) -> ([f32; WIDTH], u32) {
        let lane = mask.trailing_zeros() as usize;
        let (hull, limit) =
            if is_single(mask) { (self.hull_of_one(lane), self.limit[lane]) } else { (self.hull, f32::INFINITY) };
        let mut near = I::F32x8::splat(hull.start);
        let mut far = I::F32x8::splat(limit);
        for i in 0..3 {
            let (first, last) = if self.backward[i] { (&high[i], &low[i]) } else { (&low[i], &high[i]) };
            let t = I::F32x8::load(first)
                .sub(I::F32x8::splat(hull.near_origin[i]))
                .mul(I::F32x8::splat(hull.near_slope[i]));
            near = t.max(near);
            let t =
                I::F32x8::load(last).sub(I::F32x8::splat(hull.far_origin[i])).mul(I::F32x8::splat(hull.far_slope[i]));
            far = t.min(far);
        }
        (near.store(), near.le(far))
    }

    /// The rays of `mask` that may meet box i of a node, which `meet_any` has found.
    #[inline(always)]
    pub(super) fn meet_one<I: Isa>(
        &self,
        mask: u32,
        low: &[[f32; WIDTH]; 3],
        high: &[[f32; WIDTH]; 3],
        i: usize,
    ) -> u32 {
        if is_single(mask) {
            return mask;
        }
        let mut near = I::F32x16::load(&self.start);
        let mut far = I::F32x16::load(&self.limit);
        for axis in 0..3 {
            let (first, last) =
                if self.backward[axis] { (high[axis][i], low[axis][i]) } else { (low[axis][i], high[axis][i]) };
            let origin = I::F32x16::load(&self.near_origin[axis]);
            near = I::F32x16::splat(first).sub(origin).mul(I::F32x16::load(&self.near_slope[axis])).max(near);
            let origin = I::F32x16::load(&self.far_origin[axis]);
            far = I::F32x16::splat(last).sub(origin).mul(I::F32x16::load(&self.far_slope[axis])).min(far);
        }
        near.le(far) & mask
    }
}

#[inline(always)]
fn is_single(mask: u32) -> bool {
    mask & (mask - 1) == 0
}
