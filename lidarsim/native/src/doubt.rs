//! Triangles of which a leaf could not tell whether a ray meets them: it sees them on a grid. Eight such pairs are looked at side by side, in the
//! numbers that were given and with twice the digits of float64; what they cannot tell is decided exactly.

use crate::bvh::Rays;
use crate::number::Interval;
use crate::pair::{Pair, V};
use crate::refine::{BOUND, Corners, Crossing, corners_of};
use crate::scene::{Place, Scene};
use crate::search::Searches;
use crate::simd::{Floats, Isa, lanes};
use crate::vector::Point;

/// Pairs of a ray and a triangle, in which the triangle is not moved. They wait until there are many, while their vertices come.
pub struct Doubts {
    count: usize,
    lane: [u8; WAITING],
    place: [Place; WAITING],
}

const WAITING: usize = 32;

impl Doubts {
    pub fn new() -> Self {
        Doubts { count: 0, lane: [0; WAITING], place: [Place::of_triangle(0, 0); WAITING] }
    }

    /// Whether there is room for no more.
    #[inline(always)]
    pub fn are_full(&self) -> bool {
        self.count == WAITING
    }

    #[inline(always)]
    pub fn push<I: Isa>(&mut self, scene: &Scene, lane: usize, place: Place) {
        scene.objects()[place.object as usize].prefetch_face::<I>(place.primitive);
        (self.lane[self.count], self.place[self.count]) = (lane as u8, place);
        self.count += 1;
    }

    /// Offers those triangles that their rays meet to the searches of these.
    #[inline(always)]
    pub fn settle<I: Isa>(&mut self, scene: &Scene, rays: &Rays, searches: &mut Searches) {
        const NOWHERE: &Point = &[0.0; 3];
        let mut corners: Corners<WAITING> = [[NOWHERE; 3]; WAITING];
        let (mut origin, mut direction) = ([[0.0; WAITING]; 3], [[0.0; WAITING]; 3]);
        for k in 0..self.count {
            let (lane, place) = (usize::from(self.lane[k]), &self.place[k]);
            corners[k] = scene.objects()[place.object as usize].corners(place.primitive);
            for corner in corners[k] {
                I::prefetch(corner);
            }
            for axis in 0..3 {
                origin[axis][k] = rays.origin[axis][lane];
                direction[axis][k] = rays.direction[axis][lane];
            }
        }
        for eight in 0..self.count.div_ceil(8) {
            let corners = corners_of::<I>(&corners.as_chunks().0[eight]);
            let (o, d) = (part::<I>(&origin, eight), part::<I>(&direction, eight));
            let (met, missed) = sides::<I>(corners, o, d);
            let (t, known) = Crossing::<I>::new(corners, o, d).bounds();
            let (low, high) = (t.low.store(), t.high.store());
            for k in 8 * eight..self.count.min(8 * eight + 8) {
                let (lane, place, bit) = (usize::from(self.lane[k]), self.place[k], 1 << (k % 8));
                if met & known & bit != 0 {
                    searches.offer(rays, lane, place, Interval { low: low[k % 8], high: high[k % 8] });
                } else if missed & bit == 0 {
                    searches.consider(rays, lane, place.object, place.primitive);
                }
            }
        }
        self.count = 0;
    }
}

#[inline(always)]
fn part<I: Isa>(v: &[[f64; WAITING]; 3], eight: usize) -> V<I> {
    [
        I::F64x8::load(&v[0].as_chunks().0[eight]),
        I::F64x8::load(&v[1].as_chunks().0[eight]),
        I::F64x8::load(&v[2].as_chunks().0[eight]),
    ]
}

/// The lanes whose ray certainly meets its triangle, and those whose ray certainly does not: by the signs of the volumes d·(c × b), d·(a × c),
/// d·(b × a), as in `Triangle`.
///
/// In pairs each is right to `BOUND`·S, with S = Σ(|pⱼqₖ| + |pₖqⱼ|)·|d_i|, as n·d is in `Crossing`. That leaves underflow. All numbers given are
/// zero or between 2^±200, so that differences are zero or at least 2⁻²⁵². Then S, if it is not zero, is at least 2⁻⁷⁰⁴ and its u²-th part far above
/// what underflow loses; and if S is zero, so is the volume.
#[inline(always)]
fn sides<I: Isa>([a, b, c]: [V<I>; 3], o: V<I>, d: V<I>) -> (u32, u32) {
    let ordinary = ordinary::<I>(a) & ordinary::<I>(b) & ordinary::<I>(c) & ordinary::<I>(o) & ordinary::<I>(d);
    let (a, b, c) = (Pair::<I>::differences(a, o), Pair::<I>::differences(b, o), Pair::<I>::differences(c, o));
    let (u, v, w) = (side::<I>(c, b, d), side::<I>(a, c, d), side::<I>(b, a, d));
    let (below, above) = (u.below | v.below | w.below, u.above | v.above | w.above);
    let known = u.known() & v.known() & w.known();
    (ordinary & known & (below ^ above), ordinary & below & above)
}

/// Lanes by the sign of a volume, where it is certain.
struct Side {
    below: u32,
    zero: u32,
    above: u32,
}

impl Side {
    #[inline(always)]
    fn known(&self) -> u32 {
        self.below | self.zero | self.above
    }
}

#[inline(always)]
fn side<I: Isa>(p: [Pair<I>; 3], q: [Pair<I>; 3], d: V<I>) -> Side {
    let (normal, size) = Pair::cross(p, q);
    let volume = Pair::dot_plain(normal, d).value();
    let bound = lanes::dot(size, lanes::abs(d)).mul(I::F64x8::splat(BOUND));
    Side { below: volume.lt(bound.negated()), zero: bound.le(I::F64x8::splat(0.0)), above: bound.lt(volume) }
}

/// Lanes in which all coordinates are zero or of a size between 2^±200.
#[inline(always)]
fn ordinary<I: Isa>(v: V<I>) -> u32 {
    let (tiny, huge) =
        (I::F64x8::splat(f64::from_bits((1023 - 200) << 52)), I::F64x8::splat(f64::from_bits((1023 + 200) << 52)));
    let mut ordinary = 0xff;
    for axis in 0..3 {
        let size = v[axis].abs();
        ordinary &= size.le(I::F64x8::splat(0.0)) | tiny.le(size) & size.le(huge);
    }
    ordinary
}
