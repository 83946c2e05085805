//! Where rays meet the planes of triangles, an own one each, with twice the digits of float64.

use crate::arith::number::{Interval, UNIT};
use crate::arith::pair::{Pair, V};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::vector::Point;

/// The corner of no triangle.
pub const NOWHERE: &Point = &[0.0; 3];

/// The corners of triangles, one for each lane.
pub type Corners<'a, const N: usize> = [[&'a Point; 3]; N];

/// 2^±400: what underflow loses is far below all bounds while numbers are between these.
const TINY: f64 = f64::from_bits((1023 - 400) << 52);
const HUGE: f64 = f64::from_bits((1023 + 400) << 52);

/// What is left out of a sum of triple products, against these; see `Crossing`.
pub const BOUND: f64 = 320.0 * UNIT * UNIT;

/// The corners of triangles, by corner and axis.
#[inline(always)]
pub fn corners_of<I: Isa>([p0, p1, p2, p3, p4, p5, p6, p7]: &Corners<8>) -> [V<I>; 3] {
    [
        I::columns([p0[0], p1[0], p2[0], p3[0], p4[0], p5[0], p6[0], p7[0]]),
        I::columns([p0[1], p1[1], p2[1], p3[1], p4[1], p5[1], p6[1], p7[1]]),
        I::columns([p0[2], p1[2], p2[2], p3[2], p4[2], p5[2], p6[2], p7[2]]),
    ]
}

/// Where rays meet the planes of triangles: t = n·(a − o)/(n·d), n = (b − a) × (c − a), in pairs.
///
/// The differences are exact. With A_i = |e₁ⱼe₂ₖ| + |e₁ₖe₂ⱼ|, the low part of a coordinate of n is at most 5u·A_i, from fewer than 10 roundings,
/// and leaves out two products of u²·A_i in all: so the coordinate is off by less than 52u²·A_i. The low part of n·(a − o) is at most
/// 12u·ΣA_i|r_i|, from fewer than 16 roundings, and leaves out 5u²·ΣA_i|r_i|: with what n is off, less than 250u²·ΣA_i|r_i|. For n·d it is
/// less. 320 covers the roundings of these bounds.
///
/// T ≈ t is corrected by its residual ρ = n·(a − o) − T·(n·d), of which N − T·D is exact by Sterbenz's lemma while T is within a factor of two
/// of N/D. The roundings of ρ, of the quotient and of 1/(n·d) are less than 16u of the larger parts, which are |ρ| and the low parts.
pub struct Crossing<I: Isa> {
    normal: [Pair<I>; 3],
    /// A.
    size: V<I>,
    t: Pair<I>,
    error: I::F64x8,
    /// Lanes in which t and its error are of any use.
    ordinary: u32,
}

impl<I: Isa> Crossing<I> {
    #[inline(always)]
    pub fn new([a, b, c]: [V<I>; 3], o: V<I>, d: V<I>) -> Self {
        let (e1, e2, r) = (Pair::<I>::differences(b, a), Pair::<I>::differences(c, a), Pair::<I>::differences(a, o));
        let (normal, size) = Pair::cross(e1, e2);
        let (num, den) = (Pair::dot(normal, r), Pair::dot_plain(normal, d));

        let (unit, bound) = (I::F64x8::splat(UNIT), I::F64x8::splat(BOUND));
        let (num_high, den_high) = (num.value(), den.value());
        let inverse = I::F64x8::splat(1.0).div(den_high);
        let first = num_high.mul(inverse);
        let (p, q) = Pair::<I>::product(first, den.high);
        let lows = num.low.sub(first.mul(den.low));
        let correction = num.high.sub(p).sub(q).add(lows).mul(inverse);
        let t = Pair::<I>::fast(first, correction);

        let num_error = lanes::dot(size, [r[0].high.abs(), r[1].high.abs(), r[2].high.abs()]).mul(bound);
        let den_error = lanes::dot(size, lanes::abs(d)).mul(bound);
        let parts = num.low.abs().add(first.mul(den.low).abs()).add(first.mul(den.high).abs().mul(unit));
        let roundings = parts.mul(inverse).abs().add(correction.abs()).mul(I::F64x8::splat(16.0 * UNIT));
        let error = num_error.add(first.abs().mul(den_error)).mul(inverse).abs();
        let error = error.add(roundings).mul(I::F64x8::splat(1.0 + 1.0 / 16.0));
        // den is at least 128 times its error and its low part, and num at least 8 times its low part, so that T is within 2 % of N/D and 20 % of
        // the truth.
        let (tiny, huge) = (I::F64x8::splat(TINY), I::F64x8::splat(HUGE));
        let (num_size, den_size) = (num_high.abs(), den_high.abs());
        let ordinary = tiny.lt(den_size)
            & den_size.lt(huge)
            & tiny.lt(num_size)
            & num_size.lt(huge)
            & den_error.add(den.low.abs()).mul(I::F64x8::splat(128.0)).lt(den_size)
            & num.low.abs().mul(I::F64x8::splat(8.0)).lt(num_size);
        Crossing { normal, size, t, error, ordinary }
    }

    /// t, correctly rounded, a unit normal, and the lanes in which both are certain.
    #[inline(always)]
    pub fn rounded(&self) -> (I::F64x8, V<I>, u32) {
        let Crossing { normal: n, size, t, error, ordinary } = *self;
        // Rounding is monotone: where both ends of the error round to the same number, so does the truth.
        let up = t.high.add(t.low.add(error));
        let down = t.high.add(t.low.sub(error));
        let certain = ordinary & up.le(t.high) & t.high.le(down);

        let n = [n[0].value(), n[1].value(), n[2].value()];
        let square = lanes::dot(n, n);
        let length = square.sqrt();
        // The normal is right to 2⁻⁶⁰ of its length, and three roundings.
        let total = size[0].add(size[1]).add(size[2]).mul(I::F64x8::splat(BOUND * 2_f64.powi(60)));
        let (tiny, huge) = (I::F64x8::splat(TINY), I::F64x8::splat(HUGE));
        let fine = tiny.lt(square) & square.lt(huge) & total.lt(length);
        let shrink = I::F64x8::splat(1.0).div(length);
        (t.high, [n[0].mul(shrink), n[1].mul(shrink), n[2].mul(shrink)], certain & fine)
    }

    /// Bounds of t, and the lanes in which they are of any use.
    #[inline(always)]
    pub fn bounds(&self) -> (Interval<I::F64x8>, u32) {
        let Pair { high, low } = self.t;
        // The last term alone is four times what the sum or difference rounds, and this sum.
        let off = self.error.add(low.abs()).add(high.abs().mul(I::F64x8::splat(8.0 * UNIT)));
        (Interval { low: high.sub(off), high: high.add(off) }, self.ordinary)
    }
}
