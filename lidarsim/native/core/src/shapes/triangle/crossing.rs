//! Intersections of rays with the planes of triangles, one triangle per lane, by expansions.
//!
//! ```text
//! e₁, e₂, r = b − a, c − a, a − o           exactly, as high + low
//! n = e₁ × e₂,   A = |e₁|×|e₂|              the sizes of the products in n, without cancellation
//! num, den = n·r, n·d                       off by less than 320u²·A·|r| and 320u²·A·|d|
//! T = N/D                                   of the high parts N and D
//! ρ = ((N − p) − q) + (ν − T·δ)             the residual of T, with p + q = T·D exactly
//! t = T + ρ/(D + δ)                         off by the error of the sums and 16u·(|ν| + |T·δ| + |ρ|)/|D|
//! if t ± error rounds to one float64:       that is t, correctly rounded
//! else:                                     exact arithmetic decides (`triangle_hits.rs`)
//! ```
//!
//! | symbol | meaning | in the code |
//! |---|---|---|
//! | a, b, c | corners of the triangle | `corners` |
//! | o, d | origin and direction of the ray | `o`, `d` |
//! | n, A | normal; the sizes of its terms | `TrianglePlane::normal`, `size` |
//! | N, ν; D, δ | high and low part of num; of den | `num`, `den` |
//! | T, ρ | first quotient; its residual | `first`; `correction` is ρ/(D + δ) |
//! | R, w | adjugate and determinant of the map that places the triangle | `ExpandedInverse` |
//! | u | 2⁻⁵³ | `UNIT` |

use crate::arith::error_free::two_product;
use crate::arith::expansion::{Expansion, LongExpansion, TINY, V};
use crate::arith::number::{Interval, UNIT};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::affine::{Affine, ExpandedInverse};
use crate::geometry::vector::{self, Point};

/// The corner of an absent triangle.
pub const NOWHERE: &Point = &[0.0; 3];

/// The corners of triangles, one triangle per lane.
pub type Corners<'a, const N: usize> = [[&'a Point; 3]; N];

/// Between 2^±400, underflow loses far less than all bounds.
const ORDINARY_MIN: f64 = f64::from_bits((1023 - 400) << 52);
const ORDINARY_MAX: f64 = f64::from_bits((1023 + 400) << 52);

/// The omitted part of a sum of triple products, relative to their sizes; see `Crossing`.
pub const BOUND: f64 = 320.0 * UNIT * UNIT;

/// As `BOUND`, for long expansions, which `LongExpansion::dot` bounds by 2500u³; and the part that is
/// relative to the sum itself.
const LONG_BOUND: f64 = 3072.0 * UNIT * UNIT * UNIT;

/// The same for `LongExpansion::dot_of_two`, which is off by 12,000u³.
const LONG_BOUND_OF_TWO: f64 = 12_288.0 * UNIT * UNIT * UNIT;
const LAST_ROUNDING: f64 = 4.0 * UNIT * UNIT;

/// The omitted part of the correction of a quotient, relative to its components; see `Crossing`.
const ROUNDINGS: f64 = 16.0 * UNIT;

/// The corners of triangles, by corner and axis.
#[inline(always)]
pub fn corners_of<I: Isa>([p0, p1, p2, p3, p4, p5, p6, p7]: &Corners<8>) -> [V<I>; 3] {
    [
        I::columns([p0[0], p1[0], p2[0], p3[0], p4[0], p5[0], p6[0], p7[0]]),
        I::columns([p0[1], p1[1], p2[1], p3[1], p4[1], p5[1], p6[1], p7[1]]),
        I::columns([p0[2], p1[2], p2[2], p3[2], p4[2], p5[2], p6[2], p7[2]]),
    ]
}

/// A corner less the origin of a ray in its coordinates, as of `ExpandedInverse::points`; and its size.
#[inline(always)]
pub fn from_origin<I: Isa>(
    corner: V<I>,
    (o, o_size): ([Expansion<I>; 3], V<I>),
) -> ([Expansion<I>; 3], V<I>) {
    let mut from = Expansion::<I>::vector_diff(corner, Expansion::highs(o));
    let mut size = o_size;
    for axis in 0..3 {
        from[axis].low = from[axis].low.sub(o[axis].low);
        size[axis] = size[axis].add(from[axis].high.abs());
    }
    (from, size)
}

/// The intersection of a ray with the plane of a triangle by expansions: t = n·(a − o)/(n·d) with the
/// normal n = (b − a) × (c − a).
///
/// The differences are exact. With A_i = |e₁ⱼe₂ₖ| + |e₁ₖe₂ⱼ|, the low part of a coordinate of
/// n is at most 5u·A_i, from fewer than 10 roundings, and omits two products of u²·A_i in all, so the
/// coordinate is off by less than 52u²·A_i. The low part of n·(a − o) is at most 12u·ΣA_i|r_i|, from
/// fewer than 16 roundings, and omits 5u²·ΣA_i|r_i|; with the error of n, less than 250u²·ΣA_i|r_i|.
/// For n·d it is less. 320 covers the roundings of these bounds.
///
/// T ≈ t is corrected by its residual ρ = n·(a − o) − T·(n·d). With N, D the high and ν, δ the
/// low parts of these sums, and p + q = T·D, exactly, ρ = ((N − p) − q) + (ν − T·δ). N − p is
/// exact by Sterbenz's lemma, as T is within 2 % of t. Each of the other four operations rounds by u of its
/// result: T·δ, ν − T·δ, N − p − q, which is ρ less that, and ρ. That makes u·(2|ρ| + 2|ν| +
/// 3|T·δ|). Three more roundings, of D + δ, of its reciprocal and of the product with ρ, add 3u·|ρ/D|.
/// So the correction is off by less than 5u·(|ν| + |T·δ| + |ρ|)/|D|, up to terms in u². `ROUNDINGS` is
/// three times that, which covers these terms and the roundings of the bound; the u·|T·D| beside ν and
/// T·δ covers the rounding of low ± error when t is rounded.
pub struct Crossing<I: Isa> {
    t: Expansion<I>,
    error: I::F64x8,
    /// Lanes in which t and its error are valid.
    ordinary: u32,
}

/// What all rays from one point share at the plane of a triangle: n, n·(a − o), and the bounds of their
/// errors; see `Crossing`.
#[derive(Clone, Copy)]
pub struct TrianglePlane<I: Isa> {
    normal: [Expansion<I>; 3],
    /// A.
    size: V<I>,
    /// A corner.
    corner: V<I>,
    num: Expansion<I>,
    num_error: I::F64x8,
}

impl<I: Isa> TrianglePlane<I> {
    #[inline(always)]
    pub fn new(corners: [V<I>; 3], o: V<I>) -> Self {
        let (normal, size) = Self::normals(corners);
        Self::of_point(normal, size, corners[0], o)
    }

    #[inline(always)]
    fn of_point(normal: [Expansion<I>; 3], size: V<I>, corner: V<I>, o: V<I>) -> Self {
        let r = Expansion::<I>::vector_diff(corner, o);
        let reach = [r[0].high.abs(), r[1].high.abs(), r[2].high.abs()];
        let num_error = lanes::dot(size, reach).mul(I::F64x8::splat(BOUND));
        TrianglePlane { normal, size, corner, num: Expansion::dot(normal, r), num_error }
    }

    /// As `new`, for triangles in the coordinates of an object, seen from world points; the normals are world
    /// normals.
    ///
    /// With the adjugate R and the determinant w of the map that places the object, and the origin o in its
    /// coordinates, t = w·n·(a − o)/(N·d), N = Rᵀ·n.
    ///
    /// The low parts of R and w are at most u of their sizes, with errors of 64u² of these. In a sum of
    /// three products, the roundings of partial results come to less than eight roundings of the whole low
    /// part. The low part of a coordinate of N is at most 9u·C, C = ΣA_i|R_ij|, and omits 5u²·C; with the
    /// errors of n and R, less than 200u²·C. That of N·d is at most 12u·ΣC_j|d_j|; with the error of N,
    /// less than 300u²·ΣC_j|d_j|. The difference a − o, of size Q, has a low part of at most 7u·Q,
    /// which is off by 180u²·Q and a rounding. So that of n·(a − o) is at most 15u·ΣA_iQ_i, and omits
    /// 35u²·ΣA_iQ_i; with the errors of n and the difference, less than 400u²·ΣA_iQ_i. The product with
    /// w adds two roundings of 17u, 15u² that it omits, and 64u²: less than 520u²·wΣA_iQ_i. Both take
    /// `BOUND` twice, which is 640u².
    #[inline(always)]
    pub fn of_placed(
        corners: [V<I>; 3],
        inverse: &ExpandedInverse,
        (o, o_size): ([Expansion<I>; 3], V<I>),
    ) -> Self {
        let (n, size) = Self::normals(corners);
        let [[r00, r01, r02], [r10, r11, r12], [r20, r21, r22]] = inverse.rows;
        let (x, x_size) = ExpandedInverse::product(n, size, [r00, r10, r20]);
        let (y, y_size) = ExpandedInverse::product(n, size, [r01, r11, r21]);
        let (z, z_size) = ExpandedInverse::product(n, size, [r02, r12, r22]);
        let corner = corners[0];
        let (from, reach) = from_origin::<I>(corner, (o, o_size));
        let num = Expansion::product(Expansion::splat(inverse.determinant), Expansion::dot(n, from));
        let reach = lanes::dot(size, reach);
        let num_error = reach.mul(I::F64x8::splat(2.0 * BOUND * inverse.determinant.size));
        let two = I::F64x8::splat(2.0);
        let size = [x_size.mul(two), y_size.mul(two), z_size.mul(two)];
        TrianglePlane { normal: [x, y, z], size, corner, num, num_error }
    }

    /// n and A.
    #[inline(always)]
    fn normals([a, b, c]: [V<I>; 3]) -> ([Expansion<I>; 3], V<I>) {
        let (e1, e2) = (Expansion::<I>::vector_diff(b, a), Expansion::<I>::vector_diff(c, a));
        let (normal, [x, y, z]) = Expansion::cross(e1, e2);
        // Products may underflow.
        let tiny = I::F64x8::splat(TINY);
        (normal, [x.add(tiny), y.add(tiny), z.add(tiny)])
    }

    /// The same planes, seen from other points.
    #[inline(always)]
    pub fn seen_from(&self, o: V<I>) -> Self {
        Self::of_point(self.normal, self.size, self.corner, o)
    }

    /// The error of n·d.
    #[inline(always)]
    fn den_error(&self, d: V<I>) -> I::F64x8 {
        lanes::dot(self.size, lanes::abs(d)).mul(I::F64x8::splat(BOUND))
    }

    /// The length above which a normal is accurate to 2⁻⁶⁰ of its length.
    #[inline(always)]
    fn least_length(&self) -> I::F64x8 {
        let [x, y, z] = self.size;
        x.add(y).add(z).mul(I::F64x8::splat(BOUND * 2_f64.powi(60)))
    }

    /// A unit normal, and the lanes in which it is accurate to 2⁻⁶⁰ of its length and three roundings.
    #[inline(always)]
    pub fn unit_normal(&self) -> (V<I>, u32) {
        let TrianglePlane { normal: n, .. } = *self;
        let n = [n[0].rounded(), n[1].rounded(), n[2].rounded()];
        let square = lanes::dot(n, n);
        let length = square.sqrt();
        let (tiny, huge) = (I::F64x8::splat(ORDINARY_MIN), I::F64x8::splat(ORDINARY_MAX));
        let fine = tiny.lt(square) & square.lt(huge) & self.least_length().lt(length);
        let shrink = I::F64x8::splat(1.0).div(length);
        ([n[0].mul(shrink), n[1].mul(shrink), n[2].mul(shrink)], fine)
    }

    /// As `unit_normal`, rounded like the normals of other surfaces.
    #[inline(always)]
    pub fn common_unit_normal(&self) -> (V<I>, u32) {
        let TrianglePlane { normal: n, .. } = *self;
        let n = [n[0].rounded(), n[1].rounded(), n[2].rounded()];
        let largest = n[0].abs().max(n[1].abs()).max(n[2].abs());
        let (tiny, huge) = (I::F64x8::splat(ORDINARY_MIN), I::F64x8::splat(ORDINARY_MAX));
        (vector::unit(n), tiny.lt(largest) & largest.lt(huge) & self.least_length().lt(largest))
    }
}

impl<I: Isa> Crossing<I> {
    #[inline(always)]
    pub fn new(plane: &TrianglePlane<I>, d: V<I>) -> Self {
        Self::of((plane.num, plane.num_error), (Expansion::dot_plain(plane.normal, d), plane.den_error(d)))
    }

    /// As `new`, but also of use for rays almost in the plane, whose sums cancel until their low parts are
    /// about as large as the high ones.
    #[inline(always)]
    pub fn grazing(plane: &TrianglePlane<I>, d: V<I>) -> Self {
        let den = Expansion::dot_plain(plane.normal, d).renormalized();
        Self::of((plane.num.renormalized(), plane.num_error), (den, plane.den_error(d)))
    }

    /// As `grazing`, by long expansions, for the t of rays almost in the plane: sums that cancel to u of
    /// their terms are known to about u² of themselves. The sizes include `TINY`, as in `TrianglePlane`,
    /// and u³ of that still exceeds what a few products lose to underflow.
    #[inline(always)]
    pub fn long([a, b, c]: [V<I>; 3], o: V<I>, d: V<I>) -> Self {
        let (e1, e2) = (Expansion::<I>::vector_diff(b, a), Expansion::<I>::vector_diff(c, a));
        let normal = LongExpansion::cross(e1, e2);
        let (_, size) = TrianglePlane::<I>::normals([a, b, c]);
        let r = Expansion::<I>::vector_diff(a, o);
        let reach = [r[0].high.abs(), r[1].high.abs(), r[2].high.abs()];
        let (num, den) = (LongExpansion::dot(normal, r), LongExpansion::dot(normal, Expansion::plain(d)));
        let (long, last) = (I::F64x8::splat(LONG_BOUND), I::F64x8::splat(LAST_ROUNDING));
        let num_error = lanes::dot(size, reach).mul(long).add(num.high.abs().mul(last));
        let den_error = lanes::dot(size, lanes::abs(d)).mul(long).add(den.high.abs().mul(last));
        Self::of((num, num_error), (den, den_error))
    }

    /// As `long`, for triangles that lie at a height along an axis, all three corners exactly, and are placed
    /// by a map.
    ///
    /// With the columns lᵢ, lⱼ and lₖ of the map, k the axis, and its offset p, the plane has the
    /// normal n = lᵢ × lⱼ and the point h·lₖ + p. So t = (n·(h·lₖ) + n·(p − o))/(n·d), where
    /// h·lₖ and p − o are exact as expansions.
    #[inline(always)]
    pub fn of_placed_level(map: &Affine, axis: usize, height: I::F64x8, o: V<I>, d: V<I>) -> Self {
        let (normal, size, num, reach) = Self::placed_level(map, axis, height, o);
        let den = LongExpansion::dot(normal, Expansion::plain(d));
        let last = I::F64x8::splat(LAST_ROUNDING);
        let num_error = reach.mul(I::F64x8::splat(LONG_BOUND_OF_TWO)).add(num.high.abs().mul(last));
        let den_error = lanes::dot(size, lanes::abs(d)).mul(I::F64x8::splat(LONG_BOUND));
        Self::of((num, num_error), (den, den_error.add(den.high.abs().mul(last))))
    }

    /// n and its sizes, and n·(h·lₖ) + n·(p − o) and its size, as in `of_placed_level`.
    #[inline(always)]
    fn placed_level(
        map: &Affine,
        axis: usize,
        height: I::F64x8,
        o: V<I>,
    ) -> ([LongExpansion<I>; 3], V<I>, Expansion<I>, I::F64x8) {
        let columns = map.columns();
        let along = |column: usize| Expansion::<I>::plain(lanes::splat(columns[column]));
        let (e1, e2) = (along((axis + 1) % 3), along((axis + 2) % 3));
        let (_, [x, y, z]) = Expansion::cross(e1, e2);
        let tiny = I::F64x8::splat(TINY);
        let (normal, size) = (LongExpansion::cross(e1, e2), [x.add(tiny), y.add(tiny), z.add(tiny)]);
        let from = Expansion::<I>::vector_diff(lanes::splat(columns[3]), o);
        let mut up = from;
        let mut reach = I::F64x8::splat(0.0);
        for i in 0..3 {
            let (high, low) = two_product(height, I::F64x8::splat(columns[axis][i]));
            up[i] = Expansion { high, low };
            reach = size[i].mul(high.abs().add(from[i].high.abs())).add(reach);
        }
        (normal, size, LongExpansion::dot_of_two(normal, up, from), reach)
    }

    /// The quotient of two sums with their errors.
    #[inline(always)]
    fn of((num, num_error): (Expansion<I>, I::F64x8), (den, den_error): (Expansion<I>, I::F64x8)) -> Self {
        let unit = I::F64x8::splat(UNIT);
        let (num_high, den_high) = (num.rounded(), den.rounded());
        let inverse = I::F64x8::splat(1.0).div(den_high);
        let first = num_high.mul(inverse);
        let (p, q) = two_product(first, den.high);
        let lows = num.low.sub(first.mul(den.low));
        let correction = num.high.sub(p).sub(q).add(lows).mul(inverse);
        let t = Expansion::<I>::fast_sum(first, correction);

        let parts = num.low.abs().add(first.mul(den.low).abs()).add(first.mul(den.high).abs().mul(unit));
        let roundings = parts.mul(inverse).abs().add(correction.abs()).mul(I::F64x8::splat(ROUNDINGS));
        let error = num_error.add(first.abs().mul(den_error)).mul(inverse).abs();
        let error = error.add(roundings).mul(I::F64x8::splat(1.0 + 1.0 / 16.0));
        // den is at least 128 times the sum of its error and low part, and num 8 times its low part, so T
        // is within 2 % of N/D and 20 % of the true value.
        let (tiny, huge) = (I::F64x8::splat(ORDINARY_MIN), I::F64x8::splat(ORDINARY_MAX));
        let (num_size, den_size) = (num_high.abs(), den_high.abs());
        let ordinary = tiny.lt(den_size)
            & den_size.lt(huge)
            & tiny.lt(num_size)
            & num_size.lt(huge)
            & den_error.add(den.low.abs()).mul(I::F64x8::splat(128.0)).lt(den_size)
            & num.low.abs().mul(I::F64x8::splat(8.0)).lt(num_size);
        Crossing { t, error, ordinary }
    }

    /// The lanes in which the crossing certainly lies outside the extent of the triangle along the ray.
    ///
    /// At a hit, t·d·d = d·(p − o) lies between the least and the largest of d·(v − o) over the
    /// vertices v. A coordinate of o, like one of d, comes with its size, of which it is off by up to 7u; v
    /// − o has the size |v − o| plus that of o. So d·(v − o) is off by less than 20u, and d·d by
    /// less than 19u, of the sums S and D of the products of sizes; t·(d·d) by one rounding more. d·d is
    /// a normal number (`RayPacket::fits`), and what else underflows is less than the smallest of these.
    #[inline(always)]
    pub fn outside(&self, corners: [V<I>; 3], o: (V<I>, V<I>), d: (V<I>, V<I>)) -> u32 {
        let (Interval { low, high }, known) = self.bounds();
        let (a, a_size) = Self::along(corners[0], o, d);
        let (b, b_size) = Self::along(corners[1], o, d);
        let (c, c_size) = Self::along(corners[2], o, d);
        let (near, far) = (a.min(b).min(c), a.max(b).max(c));
        let square = lanes::dot(d.0, d.0);
        let t_size = low.abs().max(high.abs()).mul(lanes::dot(d.1, d.1));
        let (low, high) = (low.mul(square), high.mul(square));
        let size = a_size.max(b_size).max(c_size).add(t_size);
        let off = size.mul_add(I::F64x8::splat(32.0 * UNIT), I::F64x8::splat(f64::MIN_POSITIVE));
        known & (high.add(off).lt(near) | far.lt(low.sub(off)))
    }

    /// d·(v − o), and its size.
    #[inline(always)]
    fn along(v: V<I>, (o, o_size): (V<I>, V<I>), (d, d_size): (V<I>, V<I>)) -> (I::F64x8, I::F64x8) {
        let from = lanes::sub(v, o);
        (lanes::dot(d, from), lanes::dot(d_size, lanes::add(lanes::abs(from), o_size)))
    }

    /// t, correctly rounded, and the lanes in which it is certain.
    #[inline(always)]
    pub fn rounded(&self) -> (I::F64x8, u32) {
        let Crossing { t, error, ordinary } = *self;
        // Rounding is monotone: if both ends of the error interval round to one number, so does the true
        // value.
        let up = t.high.add(t.low.add(error));
        let down = t.high.add(t.low.sub(error));
        (t.high, ordinary & up.le(t.high) & t.high.le(down))
    }

    /// Bounds of t, and the lanes in which they are valid.
    #[inline(always)]
    pub fn bounds(&self) -> (Interval<I::F64x8>, u32) {
        let Expansion { high, low } = self.t;
        // The last term alone exceeds twice the roundings of the sum or difference and of this sum.
        let off = self.error.add(low.abs()).add(high.abs().mul(I::F64x8::splat(8.0 * UNIT)));
        (Interval { low: high.sub(off), high: high.add(off) }, self.ordinary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::arith::root::Root;
    use crate::arith::simd::Portable;
    use crate::geometry::affine::{Affine, Inverse, Placement};
    use crate::geometry::ray::Ray;
    use crate::testing::{assert_slack, worst};

    /// a, b, c, o, d.
    fn points(x: &[f64; 15]) -> [Point; 5] {
        std::array::from_fn(|k| std::array::from_fn(|axis| x[3 * k + axis]))
    }

    fn in_lanes(p: Point) -> V<Portable> {
        p.map(|x| [x; 8])
    }

    fn exact(x: Expansion<Portable>) -> Dyadic {
        Dyadic::exact(x.high[0]).plus(&Dyadic::exact(x.low[0]))
    }

    /// |x| as a share of its bound.
    fn of_bound(x: &Dyadic, bound: f64) -> f64 {
        if bound > 0.0 { x.split().0.abs() / bound } else { 0.0 }
    }

    /// Triangles with edges that are not float64 numbers, as errors come from the low parts of differences.
    fn draw(_: usize, next: &mut dyn FnMut() -> f64) -> f64 {
        (next() - 0.5) * 2.0_f64.powi((4.0 * next()) as i32)
    }

    /// n·d and n·(a − o) as in `Crossing`, and the bounds of their errors.
    fn sums(x: &[f64; 15]) -> ([(Expansion<Portable>, f64); 2], [Dyadic; 2]) {
        let [a, b, c, o, d] = points(x);
        let lanes = [a, b, c, o, d].map(in_lanes);
        let e1 = Expansion::<Portable>::vector_diff(lanes[1], lanes[0]);
        let e2 = Expansion::<Portable>::vector_diff(lanes[2], lanes[0]);
        let r = Expansion::<Portable>::vector_diff(lanes[0], lanes[3]);
        let (normal, size) = Expansion::cross(e1, e2);
        let (num, den) = (Expansion::dot(normal, r), Expansion::dot_plain(normal, lanes[4]));
        let bound = |v: [f64; 3]| BOUND * (0..3).map(|i| size[i][0] * v[i].abs()).sum::<f64>();
        let n: [Dyadic; 3] =
            crate::shapes::triangle::normal_through(&vector::exact(a), &vector::exact(b), &vector::exact(c));
        let truth = [
            vector::dot(&n, &vector::sub(&vector::exact(a), &vector::exact(o))),
            vector::dot(&n, &vector::exact(d)),
        ];
        ([(num, bound(r.map(|r| r.high[0]))), (den, bound(d))], truth)
    }

    /// The bounds count roundings that never all add up: of the derived 250u², and of the 320u² in use, the
    /// search reaches 10u².
    #[test]
    fn sums_of_triple_products_are_as_near_as_the_bound_says() {
        let found = [0, 1].map(|which| {
            let score = |x: &[f64; 15]| {
                let (sums, truth) = sums(x);
                of_bound(&exact(sums[which].0).minus(&truth[which]), sums[which].1)
            };
            worst(6, 1500, draw, score).0
        });
        assert_slack("n·(a − o)", found[0], 0.0317);
        assert_slack("n·d", found[1], 0.0233);
    }

    /// t against the quotient of both computed sums.
    #[test]
    fn a_corrected_quotient_is_as_near_as_the_bound_says() {
        let (found, _) = worst(6, 1500, draw, |x| {
            let [a, b, c, o, d] = points(x).map(in_lanes);
            let ([(num, _), (den, _)], _) = sums(x);
            let Crossing { t, ordinary, .. } =
                Crossing::<Portable>::new(&TrianglePlane::new([a, b, c], o), d);
            if ordinary & 1 == 0 {
                return 0.0;
            }
            // |t − N/D| = |t·D − N|/|D|
            let off = exact(t).times(&exact(den)).minus(&exact(num)).split().0.abs() / den.rounded()[0].abs();
            let first = num.rounded()[0] / den.rounded()[0];
            let parts = num.low[0].abs() + (first * den.low[0]).abs() + UNIT * num.rounded()[0].abs();
            let correction = (t.high[0] - first + t.low[0]).abs();
            off / (ROUNDINGS * (parts / den.rounded()[0].abs() + correction))
        });
        assert_slack("ROUNDINGS", found, 0.163);
    }

    /// t against the true value, for `bounds` and the rounding of t.
    #[test]
    fn t_is_as_near_as_it_says() {
        let (found, _) = worst(6, 1500, draw, |x| {
            let [a, b, c, o, d] = points(x).map(in_lanes);
            let (_, [num, den]) = sums(x);
            let Crossing { t, error, ordinary, .. } =
                Crossing::<Portable>::new(&TrianglePlane::new([a, b, c], o), d);
            if ordinary & 1 == 0 {
                return 0.0;
            }
            exact(t).times(&den).minus(&num).split().0.abs() / den.split().0.abs() / error[0]
        });
        assert_slack("error", found, 0.0149);
    }

    /// Placed triangles: N·d and w·n·(a − o) against their bounds, and t against its own.
    #[test]
    fn placed_triangles_are_off_by_the_shares_of_their_bounds_that_are_known() {
        let found = [0, 1, 2].map(|which| worst(6, 1500, draw, |x: &[f64; 27]| evaluate_placed(x)[which]).0);
        for ((what, known), found) in
            [("N·d", 0.0155), ("w·n·(a − o)", 0.011), ("t", 0.009)].into_iter().zip(found)
        {
            assert_slack(what, found, known);
        }
    }

    fn evaluate_placed(x: &[f64; 27]) -> [f64; 3] {
        let [a, b, c, o, d] = std::array::from_fn(|k| std::array::from_fn(|axis| x[3 * k + axis]));
        let row = |k: usize| [x[k], x[k + 1], x[k + 2]];
        let Some(inverse) = Inverse::of(&Affine::new([row(15), row(18), row(21)], row(24)), None) else {
            return [0.0; 3];
        };
        let Some(expanded) = inverse.expanded() else { return [0.0; 3] };
        let plane = TrianglePlane::<Portable>::of_placed(
            [a, b, c].map(in_lanes),
            expanded,
            expanded.points::<Portable>(in_lanes(o)),
        );
        // |determinant| times the ray in the coordinates of the triangle.
        let ray: Ray<Dyadic> = inverse.local(Ray::new(o, d));
        let normal: [Dyadic; 3] =
            crate::shapes::triangle::normal_through(&vector::exact(a), &vector::exact(b), &vector::exact(c));
        let num = vector::dot(&normal, &vector::negated(&ray.origin_from(vector::exact(a))));
        let den = vector::dot(&normal, &ray.direction);
        let dot = Expansion::dot_plain(plane.normal, in_lanes(d));
        let bound = BOUND * (0..3).map(|i| plane.size[i][0] * d[i].abs()).sum::<f64>();
        let Crossing { t, error, ordinary } = Crossing::<Portable>::new(&plane, in_lanes(d));
        let off = exact(t).times(&den).minus(&num).split().0.abs() / den.split().0.abs() / error[0];
        [
            of_bound(&exact(dot).minus(&den), bound),
            of_bound(&exact(plane.num).minus(&num), plane.num_error[0]),
            if ordinary & 1 == 0 { 0.0 } else { off },
        ]
    }

    /// As `t_is_as_near_as_it_says`, for rays almost in the plane: both sums cancel, and their low parts are
    /// nearly as large as the rest of the high ones.
    #[test]
    fn t_of_grazing_rays_is_as_near_as_it_says() {
        let draw =
            |i: usize, next: &mut dyn FnMut() -> f64| if i < 15 { next() - 0.5 } else { 100.0 * next() };
        let mut used = 0;
        let (found, _) = worst(12, 1500, draw, |x: &[f64; 17]| {
            let [a, b, c, o, d] = std::array::from_fn(|k| std::array::from_fn(|axis| x[3 * k + axis]));
            let edges =
                |[u, v, _]: Point| -> Point { [0, 1, 2].map(|i| u * (b[i] - a[i]) + v * (c[i] - a[i])) };
            let off = |x: f64| 2.0_f64.powi(-(x.abs().min(100.0) as i32));
            let aside = |p: Point, from: Point, by: f64| -> Point {
                let along = edges(p);
                [0, 1, 2].map(|i| from[i] + along[i] + by * p[i])
            };
            let (o, d): (Point, Point) = (aside(o, a, off(x[15])), aside(d, [0.0; 3], off(x[16])));
            let all = std::array::from_fn(|k| [a, b, c, o, d][k / 3][k % 3]);
            let (_, [num, den]) = sums(&all);
            let [a, b, c, o, d] = points(&all).map(in_lanes);
            let Crossing { t, error, ordinary, .. } =
                Crossing::<Portable>::new(&TrianglePlane::new([a, b, c], o), d);
            if ordinary & 1 == 0 {
                return 0.0;
            }
            used += 1;
            exact(t).times(&den).minus(&num).split().0.abs() / den.split().0.abs() / error[0]
        });
        assert!(used > 3000, "{used}");
        assert_slack("error", found, 0.0166);
    }

    /// The error of a long sum, n·(a − o) or n·d, as a share of its bound.
    fn long_share(x: &[f64; 15], which: usize) -> f64 {
        let [a, b, c, o, d] = points(x).map(in_lanes);
        let e1 = Expansion::<Portable>::vector_diff(b, a);
        let e2 = Expansion::<Portable>::vector_diff(c, a);
        let r = [Expansion::<Portable>::vector_diff(a, o), Expansion::plain(d)][which];
        let sum = LongExpansion::dot(LongExpansion::cross(e1, e2), r);
        let (_, size) = TrianglePlane::<Portable>::normals([a, b, c]);
        let size = (0..3).map(|i| size[i][0] * r[i].high[0].abs()).sum::<f64>();
        let bound = LONG_BOUND * size + LAST_ROUNDING * sum.high[0].abs();
        of_bound(&exact(sum).minus(&sums(x).1[which]), bound)
    }

    /// For any rays, of which the last rounding is most of the error; and for rays in the plane up to
    /// rounding, whose sums cancel to about u of their terms.
    #[test]
    fn long_sums_are_as_near_as_the_bound_says() {
        for (which, known, known_in_plane) in [(0, 0.1225, 0.00232), (1, 0.1225, 0.00146)] {
            assert_slack("sum", worst(6, 1500, draw, |x| long_share(x, which)).0, known);
            let in_plane = |x: &[f64; 15]| {
                let [a, b, c, o, d] = points(x);
                let along =
                    |p: Point| -> Point { [0, 1, 2].map(|i| p[0] * (b[i] - a[i]) + p[1] * (c[i] - a[i])) };
                let (from, d) = (along(o), along(d));
                let o: Point = [0, 1, 2].map(|i| a[i] + from[i]);
                let all = std::array::from_fn(|k| [a, b, c, o, d][k / 3][k % 3]);
                long_share(&all, which)
            };
            assert_slack("sum in the plane", worst(6, 1500, draw, in_plane).0, known_in_plane);
        }
    }

    /// The error of n·(h·lₖ) + n·(p − o), as a share of its bound, for rays that start in the plane up
    /// to rounding.
    #[test]
    fn sums_of_placed_planes_are_as_near_as_the_bound_says() {
        let share = |x: &[f64; 15]| {
            let row = |k: usize| [x[k], x[k + 1], x[k + 2]];
            let map = Affine::new([row(0), row(3), row(6)], row(9));
            let [l0, l1, l2, p] = map.columns();
            let height = x[12];
            let o: Point = [0, 1, 2].map(|i| height * l2[i] + p[i] + x[13] * l0[i] + x[14] * l1[i]);
            let (_, _, num, reach) = Crossing::<Portable>::placed_level(&map, 2, [height; 8], in_lanes(o));
            let n: [Dyadic; 3] = vector::cross(&vector::exact(l0), &vector::exact(l1));
            let up = vector::scaled(&vector::exact(l2), &Dyadic::exact(height));
            let from = vector::sub(&vector::exact(p), &vector::exact(o));
            let truth = vector::dot(&n, &vector::add(&up, &from));
            let bound = LONG_BOUND_OF_TWO * reach[0] + LAST_ROUNDING * num.high[0].abs();
            of_bound(&exact(num).minus(&truth), bound)
        };
        assert_slack("sum", worst(8, 1500, draw, share).0, 0.001);
    }

    /// Rays that graze as closely as roundings allow: `long` knows t, correctly rounded.
    #[test]
    fn t_in_the_plane_is_correctly_rounded() {
        let mut next = crate::testing::numbers();
        let (mut open, mut known, mut outside, mut inside) = (0, 0, 0, 0);
        for _ in 0..4000 {
            let mut point = || [0; 3].map(|_: u8| next() - 0.5);
            let (a, b, c): (Point, Point, Point) = (point(), point(), point());
            let within =
                |u: f64, v: f64| -> Point { [0, 1, 2].map(|i| a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i])) };
            let (o, to) = (within(4.0 * next() - 2.0, 4.0 * next()), within(next(), next()));
            let d: Point = [0, 1, 2].map(|i| to[i] - o[i]);
            let all = std::array::from_fn(|k| [a, b, c, o, d][k / 3][k % 3]);
            let (_, [num, den]) = sums(&all);
            if den.is_zero() == Ok(true) {
                continue;
            }
            let [a, b, c, o, d] = points(&all).map(in_lanes);
            let crossing = Crossing::<Portable>::grazing(&TrianglePlane::new([a, b, c], o), d);
            open += usize::from(crossing.rounded().1 & 1 == 0);
            let (t, sure) = Crossing::<Portable>::long([a, b, c], o, d).rounded();
            let root = match Root::ratio(num, den, 0) {
                Ok(Some(root)) => root,
                _ => unreachable!("the ray crosses the plane"),
            };
            if sure & 1 != 0 {
                assert_eq!(Number::round(&root), Ok(t[0]));
                known += 1;
            }
            let [a, b, c, o, d] = points(&all);
            let is_hit =
                crate::shapes::Surface::roots(&crate::shapes::Triangle(a, b, c), &Ray::<Dyadic>::new(o, d))
                    .is_ok_and(|[root, _]| root.is_some());
            let zero = [[0.0; 8]; 3];
            let far = crossing.outside(
                [a, b, c].map(in_lanes),
                (in_lanes(o), zero),
                (in_lanes(d), in_lanes(d.map(f64::abs))),
            ) & 1
                != 0;
            assert!(!(is_hit && far), "{all:?}");
            outside += usize::from(far);
            inside += usize::from(is_hit);
        }
        assert!(
            open > 3000 && known > 3000 && outside > 1000 && inside > 100,
            "{open} {known} {outside} {inside}"
        );
    }

    /// Rays of whole numbers to a vertex hit the end of the extent, exactly. Near the plane the error of t
    /// exceeds the roundings of the extent.
    #[test]
    fn no_vertex_is_outside() {
        let mut next = crate::testing::numbers();
        let (mut apart, mut grazing) = (0, 0);
        for k in 0..8000 {
            let in_plane = k % 2 == 1;
            let size = 2.0_f64.powi(if in_plane { 51 } else { 20 });
            let mut point = || [0; 3].map(|_: u8| (size * (next() - 0.5)).round());
            let (corners, mut o): ([Point; 3], Point) = ([point(), point(), point()], point());
            if in_plane {
                let [a, b, c] = corners;
                let (u, v) = (3.0 * next() - 1.0, 3.0 * next() - 1.0);
                o = [0, 1, 2].map(|i| (a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i])).round());
            }
            let d: Point = [0, 1, 2].map(|i| corners[k / 2 % 3][i] - o[i]);
            let [a, b, c] = corners.map(in_lanes);
            let crossing =
                Crossing::<Portable>::grazing(&TrianglePlane::new([a, b, c], in_lanes(o)), in_lanes(d));
            let sizes = ([[0.0; 8]; 3], in_lanes(d.map(f64::abs)));
            assert_eq!(crossing.outside([a, b, c], (in_lanes(o), sizes.0), (in_lanes(d), sizes.1)), 0);
            if crossing.bounds().1 & 1 != 0 {
                apart += usize::from(!in_plane);
                grazing += usize::from(in_plane && crossing.error[0] > 64.0 * UNIT);
            }
        }
        assert!(apart > 3000 && grazing > 1000, "{apart} {grazing}");
    }

    /// Down to numbers that are not `ordinary`, so that products of three coordinates underflow.
    #[test]
    fn t_among_tiny_numbers_is_as_near_or_of_no_use() {
        let mut next = crate::testing::numbers();
        let (mut known, mut refused) = (0, 0);
        for k in -350..-100 {
            for _ in 0..8 {
                let x: [f64; 15] =
                    std::array::from_fn(|i| (next() - 0.5) * if i < 12 { 2.0_f64.powi(k) } else { 1.0 });
                let (_, [num, den]) = sums(&x);
                let [a, b, c, o, d] = points(&x).map(in_lanes);
                let Crossing { t, error, ordinary, .. } =
                    Crossing::<Portable>::new(&TrianglePlane::new([a, b, c], o), d);
                if ordinary & 1 == 0 {
                    refused += 1;
                    continue;
                }
                let off = exact(t).times(&den).minus(&num);
                let reach = Dyadic::exact(error[0]).times(&den);
                let inside = [reach.minus(&off).times(&den), reach.plus(&off).times(&den)];
                assert!(inside.iter().all(|x| x.sign() != Ok(std::cmp::Ordering::Less)), "2^{k}: {x:?}");
                known += 1;
            }
        }
        assert!(known > 100 && refused > 1000, "{known}, {refused}");
    }

    /// A crossing at t with an error.
    fn crossing(t: [f64; 2], error: f64) -> Crossing<Portable> {
        let t = Expansion { high: [t[0]; 8], low: [t[1]; 8] };
        Crossing { t, error: [error; 8], ordinary: 0xff }
    }

    /// The ends are at least seven roundings outside: eight less the rounding of the sum itself.
    #[test]
    fn bounds_reach_beyond_the_error() {
        let draw =
            |i: usize, next: &mut dyn FnMut() -> f64| if i == 0 { 1.0 + next() } else { 2.0 * next() - 1.0 };
        let (least, _) = worst(4, 1000, draw, |x: &[f64; 3]| {
            let (high, low, error) = (x[0], x[1].clamp(-1.0, 1.0) * UNIT, x[2].abs() * UNIT);
            let (t, _) = crossing([high, low], error).bounds();
            let beyond = |end: f64, sign: f64| {
                let reached =
                    Dyadic::exact(high).plus(&Dyadic::exact(low)).plus(&Dyadic::exact(sign * error));
                sign * Dyadic::exact(end).minus(&reached).split().0 / (UNIT * high)
            };
            -beyond(t.low[0], -1.0).min(beyond(t.high[0], 1.0))
        });
        assert!((7.0..7.5).contains(&-least), "{least}");
    }

    /// A normal of length 1 is accurate to `BOUND`·size.
    #[test]
    fn normals_are_known_to_what_is_promised() {
        let promised = 2.0_f64.powi(-60) / BOUND;
        for (size, known) in [(0.9 * promised, 0xff), (1.1 * promised, 0)] {
            let of = |high: f64| Expansion { high: [high; 8], low: [0.0; 8] };
            let (normal, size) = ([of(1.0), of(0.0), of(0.0)], in_lanes([size, 0.0, 0.0]));
            let plane = TrianglePlane::<Portable> {
                normal,
                size,
                corner: [[0.0; 8]; 3],
                num: of(1.0),
                num_error: [0.0; 8],
            };
            assert_eq!(plane.unit_normal().1, known);
        }
    }
}
