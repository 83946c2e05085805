//! Ray packets: rays of one octant as a structure of arrays, and masks of their lanes.

use crate::arith::number::{Interval, UNIT};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::origins::Origins;
use crate::geometry::point::dot;
use crate::geometry::vector::Point;

/// Rays of a subpacket: one instruction tests them against a box.
pub(super) const WIDE: usize = 16;

pub(super) const SUBPACKETS: usize = 4;

/// Most rays of a packet.
pub const LANES: usize = SUBPACKETS * WIDE;

/// All numbers of rays in packets are below this in absolute value, errors too, and some component of each
/// direction is above `SMALLEST`. So their squares, and scaled squares, are normal float64 numbers.
pub const LARGEST: f64 = 1e30;
pub const SMALLEST: f64 = 1e-30;

/// Rays whose distance exceeds the reach of a hierarchy by this factor are far from it: float32 resolves at
/// best 2⁻¹⁴ of the reach there.
const FAR: f64 = 1024.0;

/// One bit for each ray of a packet.
pub type Mask = u64;

/// A ray packet in float64, one ray per lane. Lanes from the last ray up to a whole subpacket repeat the
/// first ray.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct RayPacket {
    pub origin: [[f64; LANES]; 3],
    pub direction: [[f64; LANES]; 3],
    /// Bounds of the error of each coordinate of origin and direction.
    pub origin_error: [f64; LANES],
    pub direction_error: [f64; LANES],
    /// |d|₁, or an adjacent float64.
    pub length: [f64; LANES],
    /// The t of each ray at which it starts here; see `start_near`.
    pub offset: [f64; LANES],
    pub has_offsets: bool,
    /// The times of the rays if anything moves; unset for rays in the coordinates of an object.
    pub time: [f64; LANES],
    /// Their indices among all rays.
    pub at: [u32; LANES],
    /// By axis, the rays whose direction is exactly zero along it.
    pub parallel: [Mask; 3],
    /// The signs of all directions, one bit per axis.
    pub octant: u32,
    /// Whether all rays have the same origin, with the same error.
    pub one_origin: bool,
    /// (o − r) × d of each ray, with the origin r of the first; unset if all have the same.
    moment: [[f64; LANES]; 3],
    /// Bounds of the coordinates of o − r, and of the errors of o.
    pub spread: f64,
    pub largest_origin_error: f64,
    /// The first lanes of runs of rays with one origin.
    runs: Mask,
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
            offset: [0.0; LANES],
            has_offsets: false,
            time: [0.0; LANES],
            at: [0; LANES],
            parallel: [0; 3],
            octant: 0,
            one_origin: false,
            moment: [[0.0; LANES]; 3],
            spread: 0.0,
            largest_origin_error: 0.0,
            runs: 0,
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

    /// Gathers the first rays of an order, up to the first of another octant. If the very first does not fit
    /// into packets, `count` is 0 and it is in lane 0, to be traced singly as a `TraversalRay`. `one_origin`
    /// says that all have the same origin, to the bit.
    #[inline(always)]
    pub fn gather<I: Isa>(
        &mut self,
        origins: Origins,
        directions: &[Point],
        order: &[u32],
        one_origin: bool,
    ) {
        (self.count, self.has_offsets) = (0, false);
        let Some(&first) = order.first() else { return };
        let (first_origin, huge) = (origins.of(first as usize), I::F64x8::splat(LARGEST));
        let (mut fit, mut together): (Mask, Mask) = (0, 0);
        let mut signs: [Mask; 3] = [0; 3];
        self.parallel = [0; 3];
        let given = order.len().min(LANES);
        for eight in 0..given.div_ceil(8) {
            let at = match order[8 * eight..].first_chunk() {
                Some(at) => *at,
                None => pad(&order[8 * eight..], first),
            };
            self.at.as_chunks_mut().0[eight] = at;
            let o = match origins {
                Origins::Each(origins) if !one_origin => columns::<I>(origins, &at),
                _ => lanes::splat(first_origin),
            };
            let d = columns::<I>(directions, &at);
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
                self.parallel[axis] |= Mask::from(d.abs().le(I::F64x8::splat(0.0))) << (8 * eight);
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

    /// Whether packets may hold the ray, by the rule of `gather`.
    pub fn fits(origin: Point, direction: Point) -> bool {
        let largest = direction.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        origin.iter().chain(&direction).all(|x| x.abs() < LARGEST) && largest > SMALLEST
    }

    /// Copies the rays of another packet unchanged.
    pub fn take_over(&mut self, others: &RayPacket) {
        self.origin.clone_from(&others.origin);
        self.direction.clone_from(&others.direction);
        self.origin_error.clone_from(&others.origin_error);
        self.direction_error.clone_from(&others.direction_error);
        self.length.clone_from(&others.length);
        (self.one_origin, self.parallel) = (others.one_origin, others.parallel);
    }

    /// Keeps the rays of `mask`, which are of one octant. `one_origin` may be set for rays that share an
    /// origin.
    #[inline(always)]
    pub fn keep<I: Isa>(&mut self, mask: Mask, octant: u32) {
        (self.octant, self.has_offsets) = (octant, false);
        let first = mask.trailing_zeros() as usize;
        self.count = LANES - mask.leading_zeros() as usize;
        let others = all(self.count.next_multiple_of(WIDE)) & !mask;
        let RayPacket { origin: [a, b, c], direction: [x, y, z], .. } = self;
        let columns = [a, b, c, x, y, z, &mut self.length, &mut self.origin_error, &mut self.direction_error];
        for column in columns {
            let value = I::F64x8::splat(column[first]);
            for (eight, numbers) in column.as_chunks_mut().0.iter_mut().enumerate() {
                let lanes = part_of_mask::<8>(others, eight);
                *numbers = I::pick(lanes, value, I::F64x8::load(numbers)).store();
            }
        }
        self.compare_origins::<I>();
    }

    /// Whether the rays start so far from a hierarchy, relative to its reach, that slab tests should start
    /// near it. The first ray decides for all.
    #[inline(always)]
    pub fn are_far(&self, center: Point, reach: f64) -> bool {
        let [x, y, z] = self.origin(0);
        let distance = (x - center[0]).abs().max((y - center[1]).abs()).max((z - center[2]).abs());
        distance > FAR * reach && distance < LARGEST
    }

    /// Moves the start of each ray along it to a point in front of a hierarchy.
    ///
    /// Any t will do. The fused multiply-add rounds the point o + t·d once: it is off by u of itself, by the
    /// error of o, and by t times the error of d. The bound has 3u in place of u, and 8u more of the other
    /// two, for its own roundings.
    #[inline(always)]
    pub fn start_near<I: Isa>(&mut self, center: Point, reach: f64) {
        let middle = lanes::splat::<I::F64x8, 8>(center);
        for eight in 0..self.count.next_multiple_of(WIDE) / 8 {
            let (o, d) = (self.origins::<I>(eight), self.directions::<I>(eight));
            let way = [middle[0].sub(o[0]), middle[1].sub(o[1]), middle[2].sub(o[2])];
            let (square, off) = (lanes::dot(d, d), lanes::dot(lanes::abs(way), lanes::abs(way)).sqrt());
            // The t nearest to the centre, less twice the reach and the rounding of t.
            let before = off.mul(I::F64x8::splat(8.0 * f64::EPSILON)).add(I::F64x8::splat(2.0 * reach));
            let t = lanes::dot(way, d).div(square).sub(before.div(square.sqrt()));
            let t = t.max(I::F64x8::splat(0.0)).min(I::F64x8::splat(LARGEST));
            let mut largest = I::F64x8::splat(0.0);
            for axis in 0..3 {
                let start = t.mul_add(d[axis], o[axis]);
                largest = start.abs().max(largest);
                self.origin[axis].as_chunks_mut().0[eight] = start.store();
            }
            let error = I::F64x8::load(&self.origin_error.as_chunks().0[eight]);
            let bent = t.mul(I::F64x8::load(&self.direction_error.as_chunks().0[eight]));
            let error = error.add(bent).mul(I::F64x8::splat(1.0 + 8.0 * UNIT));
            let error =
                largest.mul(I::F64x8::splat(3.0 * UNIT)).add(error).add(I::F64x8::splat(f64::MIN_POSITIVE));
            self.origin_error.as_chunks_mut().0[eight] = error.store();
            self.offset.as_chunks_mut().0[eight] = t.store();
        }
        (self.one_origin, self.has_offsets) = (false, true);
        self.compare_origins::<I>();
    }

    /// Bounds of the t of a ray, from bounds of t relative to its start here.
    #[inline(always)]
    pub fn t_of_ray(&self, lane: usize, t: Interval) -> Interval {
        if !self.has_offsets {
            return t;
        }
        Interval {
            low: (t.low + self.offset[lane]).next_down(),
            high: (t.high + self.offset[lane]).next_up(),
        }
    }

    #[inline(always)]
    pub fn origin(&self, lane: usize) -> Point {
        point(&self.origin, lane)
    }

    /// Compares the origins with that of the first ray, the reference of `start` and `moment`, and with their
    /// neighbours.
    #[inline(always)]
    pub fn compare_origins<I: Isa>(&mut self) {
        self.runs = if self.one_origin { 1 } else { self.starts_of_runs::<I>() };
        (self.spread, self.largest_origin_error) = (0.0, self.origin_error[0]);
        self.one_origin = self.runs == 1;
        if self.one_origin {
            return;
        }
        let zero = I::F64x8::splat(0.0);
        let (mut spread, mut error) = (zero, zero);
        for eight in 0..self.count.div_ceil(8) {
            let start = self.starts::<I>(eight);
            let moment = lanes::cross(start, self.directions::<I>(eight));
            for axis in 0..3 {
                spread = Floats::max(start[axis].abs(), spread);
                self.moment[axis].as_chunks_mut().0[eight] = moment[axis].store();
            }
            error = Floats::max(I::F64x8::load(&self.origin_error.as_chunks().0[eight]), error);
        }
        (self.spread, self.largest_origin_error) = (spread.largest(), error.largest());
    }

    /// The rays from a lane on, up to the first with another origin; `compare_origins` must have been called.
    #[inline(always)]
    pub fn run_from(&self, lane: usize) -> Mask {
        let next = self.runs & !all(lane + 1);
        all(self.count.min(next.trailing_zeros() as usize)) & !all(lane)
    }

    /// The origins relative to that of the first ray, of part `eight` of eight lanes, by axis.
    #[inline(always)]
    pub fn starts<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::sub(self.origins::<I>(eight), lanes::splat(self.origin(0)))
    }

    /// The moments about the origin of the first ray, as `starts`; `compare_origins` must have been called.
    #[inline(always)]
    pub fn moments<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::part(&self.moment, eight)
    }

    /// The origin of a ray relative to that of the first.
    #[inline(always)]
    pub fn start(&self, lane: usize) -> Point {
        let ([x, y, z], first) = (self.origin(lane), self.origin(0));
        [x - first[0], y - first[1], z - first[2]]
    }

    /// The moment of a ray, as `moments`.
    #[inline(always)]
    pub fn moment(&self, lane: usize) -> Point {
        point(&self.moment, lane)
    }

    /// The first lanes of runs of rays with one origin.
    #[inline(always)]
    fn starts_of_runs<I: Isa>(&self) -> Mask {
        let [x, y, z] = &self.origin;
        let mut starts = 1;
        for eight in 0..self.count.div_ceil(8) {
            // Compares eight lanes with their successors, up to the last.
            let lane = (8 * eight).min(LANES - 9);
            let mut same = 0xff;
            for column in [x, y, z, &self.origin_error] {
                if let (Some(these), Some(next)) =
                    (column[lane..].first_chunk(), column[lane + 1..].first_chunk())
                {
                    let (these, next) = (I::F64x8::load(these), I::F64x8::load(next));
                    same &= these.le(next) & next.le(these);
                }
            }
            starts |= Mask::from(same ^ 0xff) << (lane + 1);
        }
        starts & all(self.count)
    }

    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Point {
        point(&self.direction, lane)
    }

    /// The origins of part `eight` of eight lanes, by axis.
    #[inline(always)]
    pub fn origins<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::part(&self.origin, eight)
    }

    /// The directions, as `origins`.
    #[inline(always)]
    pub fn directions<I: Isa>(&self, eight: usize) -> [I::F64x8; 3] {
        lanes::part(&self.direction, eight)
    }

    /// Whether the rays are coherent in a scene of this size, so that they enter much the same boxes.
    #[inline(always)]
    pub fn are_coherent<I: Isa>(&self, size: f64) -> bool {
        let first = self.direction(0);
        let length2 = dot(first, first);
        let mut divergent = 0;
        for eight in 0..self.count.div_ceil(8) {
            let (mut dot, mut norm2) = (I::F64x8::splat(0.0), I::F64x8::splat(0.0));
            for axis in 0..3 {
                let d = I::F64x8::load(&self.direction[axis].as_chunks().0[eight]);
                dot = d.fused(I::F64x8::splat(first[axis]), dot);
                norm2 = d.fused(d, norm2);
            }
            // More than 60° from the first.
            divergent |= dot.mul(dot).lt(norm2.mul(I::F64x8::splat(0.25 * length2)));
        }
        let mut wide = 0;
        if !self.one_origin {
            // Measured from the first, so that no two are farther apart than 1/64 of the scene.
            let most = I::F64x8::splat(size / 128.0);
            for axis in 0..3 {
                let first = I::F64x8::splat(self.origin[axis][0]);
                for eight in 0..self.count.div_ceil(8) {
                    wide |= most.lt(I::F64x8::load(&self.origin[axis].as_chunks().0[eight]).sub(first).abs());
                }
            }
        }
        wide == 0 && (divergent == 0 || self.are_a_fan())
    }

    /// Whether each ray is within 1/16 rad of its predecessor, as in the fan of a 2D lidar: it crosses a
    /// quarter of a turn, but hardly any area, so its rays enter much the same boxes.
    fn are_a_fan(&self) -> bool {
        (1..self.count).all(|lane| {
            let (a, b) = (self.direction(lane - 1), self.direction(lane));
            let along = dot(a, b);
            along > 0.0 && along * along >= (1.0 - 1.0 / 256.0) * dot(a, a) * dot(b, b)
        })
    }
}

#[inline(always)]
fn point(columns: &[[f64; LANES]; 3], lane: usize) -> Point {
    [columns[0][lane], columns[1][lane], columns[2][lane]]
}

/// Fewer than eight numbers, padded with `filler`.
fn pad(some: &[u32], filler: u32) -> [u32; 8] {
    let mut eight = [filler; 8];
    eight[..some.len()].copy_from_slice(some);
    eight
}

/// The coordinates of these points, by axis. Rays of a sensor are sorted in runs, whose points are adjacent
/// in memory.
#[inline(always)]
fn columns<I: Isa>(points: &[Point], at: &[u32; 8]) -> [I::F64x8; 3] {
    let [low, high] = [0, 1].map(|half| &at.as_chunks().0[half]);
    if is_run(low) & is_run(high) {
        let [low, high] = [low, high].map(|run| run[0] as usize);
        return I::columns_of_runs([
            &points[low..low + 4].as_chunks().0[0],
            &points[high..high + 4].as_chunks().0[0],
        ]);
    }
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

/// Whether four rays are consecutive.
#[inline(always)]
pub fn is_run(rays: &[u32; 4]) -> bool {
    let [first, others @ ..] = rays;
    others.iter().zip(1..).fold(true, |run, (ray, k)| run & (*ray == first.wrapping_add(k)))
}

/// Removes the lowest lane from a mask.
#[inline(always)]
pub fn take(mask: &mut Mask) -> Option<usize> {
    if *mask == 0 {
        return None;
    }
    let lane = mask.trailing_zeros() as usize;
    *mask &= *mask - 1;
    Some(lane)
}

/// Part `i` of a packet's mask, as bits of the lanes of a register.
#[inline(always)]
pub fn part_of_mask<const N: usize>(mask: Mask, i: usize) -> u32 {
    (mask >> (i * N)) as u32 & ((1 << N) - 1)
}

/// A mask of the first `count` rays.
#[inline(always)]
pub const fn all(count: usize) -> Mask {
    if count < LANES { (1 << count) - 1 } else { Mask::MAX }
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::arith::simd::{Level, Task, dispatch};
    use crate::geometry::point::cross;
    use crate::testing::{assert_slack, numbers};

    struct Gather<'a> {
        rays: &'a mut RayPacket,
        origins: &'a [Point],
        directions: &'a [Point],
        order: &'a [u32],
        one_origin: bool,
    }

    impl Task for Gather<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self) {
            self.rays.gather::<I>(Origins::Each(self.origins), self.directions, self.order, self.one_origin);
        }
    }

    /// A reference: one ray after the other, by scalar comparisons.
    fn count_fitting(rays: &[(Point, Point)]) -> usize {
        let fits = |(o, d): &(Point, Point)| {
            let small = o.iter().chain(d).all(|x| -1e30 < *x && *x < 1e30);
            small && d.iter().any(|x| *x < -1e-30 || *x > 1e-30)
        };
        let signs = |d: Point| d.map(|x| x < 0.0);
        rays.iter().take(LANES).take_while(|ray| fits(ray) && signs(ray.1) == signs(rays[0].1)).count()
    }

    #[test]
    fn a_packet_ends_before_a_ray_that_it_cannot_hold() {
        let odd_origins =
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30, -1e30, 1e300, 1e30_f64.next_down()];
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
            // Zeros count as positive, whatever their sign.
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
                    // If all share an origin, it is the odd one, or else the first.
                    let one_origin = odd % 2 == 0;
                    if one_origin {
                        let first = rays[if odd < odd_origins.len() { place } else { 0 }].0;
                        rays.iter_mut().for_each(|ray| ray.0 = first);
                    }
                    for many in [1, 5, 16, 63, 80] {
                        let (origins, directions): (Vec<Point>, Vec<Point>) = rays.iter().copied().unzip();
                        let order: Vec<u32> = (0..many).collect();
                        for level in Level::available() {
                            // Earlier contents of the lanes must not matter.
                            let mut found = RayPacket::empty();
                            (0..LANES).for_each(|lane| found.set(lane, [f64::NAN; 3], [-1e300; 3]));
                            let (rays_taken, order) = (&mut found, &order[..]);
                            let (origins, directions) = (&origins[..], &directions[..]);
                            dispatch(
                                level,
                                Gather { rays: rays_taken, origins, directions, order, one_origin },
                            );
                            let count = found.count;
                            let known = count_fitting(&rays[..many as usize]);
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

    /// The kept rays are as given, and lanes beyond them repeat the first up to a whole subpacket.
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

    struct AreCoherent<'a>(&'a RayPacket);

    impl Task for AreCoherent<'_> {
        type Output = bool;

        #[inline(always)]
        fn run<I: Isa>(self) -> bool {
            self.0.are_coherent::<I>(1.0)
        }
    }

    #[test]
    fn rays_are_coherent_in_a_cone_or_in_a_fan() {
        // Steps of the azimuth, and an elevation of one of the rays.
        for (count, step, elevation, known) in [
            (64, 0.02, 0.0, true),
            (64, 0.02, 0.3, false),
            (11, 0.1, 0.0, true),
            (11, 0.1, 0.3, true),
            (17, 0.09, 0.0, false),
            (17, 0.09, 0.3, false),
        ] {
            let mut rays = RayPacket::empty();
            (rays.count, rays.one_origin) = (count, true);
            for lane in 0..LANES {
                let azimuth = step * lane.min(count - 1) as f64;
                let up = if lane == count / 2 { elevation } else { 0.0 };
                rays.set(lane, [0.0; 3], [3.0 * azimuth.cos(), 3.0 * azimuth.sin(), up]);
            }
            for level in Level::available() {
                assert_eq!(
                    dispatch(level, AreCoherent(&rays)),
                    known,
                    "{level:?}: {count}, {step}, {elevation}"
                );
            }
        }
    }

    struct CompareOrigins<'a>(&'a mut RayPacket);

    impl Task for CompareOrigins<'_> {
        /// The starts of eight rays each, by axis.
        type Output = Vec<[[f64; 8]; 3]>;

        #[inline(always)]
        fn run<I: Isa>(self) -> Self::Output {
            self.0.compare_origins::<I>();
            (0..LANES / 8).map(|eight| self.0.starts::<I>(eight).map(|x| x.store())).collect()
        }
    }

    /// Rays that differ in one coordinate or in the error, in runs or alternating.
    #[test]
    fn rays_start_as_far_from_the_first_as_it_says() {
        let mut next = numbers();
        let (mut ones, mut all_runs) = (0, 0);
        for round in 0..400 {
            let (kinds, length) = ([1, 2, 5, 16, 40][round % 5], 1 + round / 5 % 9);
            let mut rays = RayPacket::empty();
            rays.count = [1, 7, 8, 9, 33, 63, LANES][(7.0 * next()) as usize];
            let mut kind = [0; LANES];
            for lane in 0..LANES {
                // The rest of a subpacket repeats the first ray.
                kind[lane] = if lane >= rays.count {
                    kind[0]
                } else if lane % length == 0 {
                    (f64::from(kinds) * next()) as usize
                } else {
                    kind[lane - 1]
                };
                let mut four = [1.0, 2.0, 3.0, 0.5];
                four[kind[lane] % 4] += 1.1 * kind[lane] as f64;
                rays.set(lane, [four[0], four[1], four[2]], [0; 3].map(|_: u8| next() - 0.5));
                rays.origin_error[lane] = four[3];
            }
            let runs = (0..rays.count).filter(|&lane| lane == 0 || kind[lane] != kind[lane - 1]).count();
            for level in Level::available() {
                let mut found = rays.clone();
                let starts = dispatch(level, CompareOrigins(&mut found));
                let (mut masks, mut left) = (Vec::new(), all(rays.count));
                while left != 0 {
                    masks.push(found.run_from(left.trailing_zeros() as usize));
                    left &= !masks[masks.len() - 1];
                }
                assert_eq!((masks.len(), found.one_origin), (runs, runs == 1), "{level:?}, {round}");
                assert_eq!(masks.iter().fold(0, |all, run| all | run), all(rays.count));
                assert_eq!(masks.iter().map(|run| run.count_ones() as usize).sum::<usize>(), rays.count);
                (ones, all_runs) = (ones + usize::from(runs == 1), all_runs + runs);
                for run in masks {
                    let (first, last) = (run.trailing_zeros(), 63 - run.leading_zeros());
                    assert_eq!(run.count_ones(), 1 + last - first);
                    assert!((first..=last).all(|lane| kind[lane as usize] == kind[first as usize]));
                }
                for lane in 0..rays.count {
                    let (origin, first) = (found.origin(lane), found.origin(0));
                    let start = [0, 1, 2].map(|axis| origin[axis] - first[axis]);
                    assert_eq!((found.start(lane), starts[lane / 8].map(|x| x[lane % 8])), (start, start));
                    assert!(start.iter().all(|x| x.abs() <= found.spread));
                    assert!(found.origin_error[lane] <= found.largest_origin_error);
                    if !found.one_origin {
                        assert_eq!(found.moment(lane), cross(start, found.direction(lane)));
                    }
                }
            }
        }
        let levels = Level::available().count();
        assert!(ones > 30 * levels && all_runs > 1_600 * levels, "{ones}, {all_runs}");
    }

    struct StartNear<'a>(&'a mut RayPacket, Point, f64);

    impl Task for StartNear<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self) {
            self.0.start_near::<I>(self.1, self.2);
        }
    }

    /// The largest share of their bounds that starts are off by, if each axis of the true origin and
    /// direction is off by its whole error; and their largest distance from the centre, in reaches.
    fn starts(away: f64, origin_error: f64, direction_error: f64) -> (f64, f64) {
        let (mut next, center, reach) = (numbers(), [30.0, -20.0, 5.0], 7.0);
        let (mut share, mut distance) = (0.0_f64, 0.0_f64);
        for _ in 0..40 {
            let mut rays = RayPacket::empty();
            rays.count = LANES;
            for lane in 0..LANES {
                let to = center.map(|x| x + reach * (2.0 * next() - 1.0));
                let from = center.map(|x| x + away * (2.0 * next() - 1.0));
                rays.set(lane, from, [0, 1, 2].map(|axis| (to[axis] - from[axis]) * 1.7));
                (rays.origin_error[lane], rays.direction_error[lane]) = (origin_error, direction_error);
            }
            for level in Level::available() {
                let mut near = rays.clone();
                dispatch(level, StartNear(&mut near, center, reach));
                assert!(near.has_offsets && !near.one_origin);
                for lane in 0..LANES {
                    let (start, t) = (near.origin(lane), Dyadic::exact(near.offset[lane]));
                    for axis in 0..3 {
                        for sign in [-1.0, 1.0] {
                            let of = |x: f64, error: f64| Dyadic::exact(x).plus(&Dyadic::exact(sign * error));
                            let (o, d) = (
                                of(rays.origin[axis][lane], origin_error),
                                of(rays.direction[axis][lane], direction_error),
                            );
                            let off = o.plus(&t.times(&d)).minus(&Dyadic::exact(start[axis])).split().0;
                            share = share.max(off.abs() / near.origin_error[lane]);
                        }
                        distance = distance.max((start[axis] - center[axis]).abs() / reach);
                    }
                    assert_eq!(near.direction(lane), rays.direction(lane));
                    let t = Interval { low: 0.25, high: 0.5 };
                    let (from, offset) = (near.t_of_ray(lane, t), near.offset[lane]);
                    let sum = |t: f64| Dyadic::exact(t).plus(&Dyadic::exact(offset));
                    assert_eq!(sum(t.low).minus(&Dyadic::exact(from.low)).sign(), Ok(Ordering::Greater));
                    assert_eq!(sum(t.high).minus(&Dyadic::exact(from.high)).sign(), Ok(Ordering::Less));
                }
            }
        }
        (share, distance)
    }

    #[test]
    fn starts_near_a_hierarchy_are_where_rays_are_to_their_bounds() {
        for (away, errors, known) in [
            (1e5, [0.0, 0.0], 0.33),
            (1e9, [0.0, 0.0], 0.33),
            (1e20, [0.0, 0.0], 0.33),
            (1e9, [1e-7, 0.0], 1.0),
            (1e9, [0.0, 1e-7], 1.0),
        ] {
            let (share, distance) = starts(away, errors[0], errors[1]);
            assert_slack(&format!("{away}, {errors:?}"), share, known);
            // Two reaches before the centre, one beside it, and the margin of `before` for the rounding of t:
            // 8ε of no more than 2 · away.
            assert!(distance < 4.0 + 16.0 * f64::EPSILON * away, "{away}: {distance}");
        }
    }

    #[test]
    fn only_rays_from_far_away_start_near() {
        let mut rays = RayPacket::empty();
        let mut are_far = |x: f64, reach: f64| {
            rays.set(0, [1.0, x, 2.0], [1.0; 3]);
            rays.are_far([1.0, 0.0, 2.0], reach)
        };
        assert!(are_far(1025.0, 1.0) && are_far(-1025.0, 1.0) && are_far(1e29, 1e20));
        assert!(!are_far(1023.0, 1.0) && !are_far(1e25, f64::INFINITY) && !are_far(0.0, 0.0));
    }
}
