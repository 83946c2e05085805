//! Unevaluated sums of two float64 numbers, in eight lanes, built by error-free transformations (T. Dekker,
//! 1971; D. Knuth, TAOCP 2, §4.2.2; J. Shewchuk, Adaptive precision floating-point arithmetic, 1997). They
//! carry no error bound: each formula that uses them derives its own.

use crate::arith::error_free::{fast_two_sum, two_diff, two_product, two_sum};
use crate::arith::number::{DoubleDouble, UNIT};
use crate::arith::simd::{Floats, Isa};

/// A vector in eight lanes, by axis.
pub type V<I> = [<I as Isa>::F64x8; 3];

/// high + low, not renormalized: low is small compared with the terms that high sums (the pair arithmetic of
/// M. Lange, S. Rump, Faithfully rounded floating-point computations, ACM TOMS 46, 2020).
#[derive(Clone, Copy)]
pub struct Expansion<I: Isa> {
    pub high: I::F64x8,
    pub low: I::F64x8,
}

/// A number that is the same in every lane: high + low, off by at most `CONSTANT`·size, with size ≥
/// |high|.
#[derive(Clone, Copy, Debug)]
pub struct Constant {
    pub high: f64,
    pub low: f64,
    pub size: f64,
}

/// The relative error of a `Constant`. It covers a few double-double operations; a larger error enlarges the
/// size.
pub const CONSTANT: f64 = 64.0 * UNIT * UNIT;

/// A few products lose less than u² of this to underflow.
pub const TINY: f64 = f64::MIN_POSITIVE / (UNIT * UNIT);

/// The sum of three numbers by decreasing size, for sums that cancel almost wholly.
#[derive(Clone, Copy)]
pub struct LongExpansion<I: Isa> {
    high: I::F64x8,
    low: I::F64x8,
    rest: I::F64x8,
}

impl Constant {
    pub const ZERO: Constant = Constant { high: 0.0, low: 0.0, size: 0.0 };
}

impl From<&DoubleDouble> for Constant {
    #[inline(always)]
    fn from(x: &DoubleDouble) -> Self {
        let [high, low, error] = x.terms();
        Constant { high, low, size: (error / CONSTANT).max(high.abs()) }
    }
}

impl<I: Isa> Expansion<I> {
    #[inline(always)]
    pub fn splat(x: Constant) -> Self {
        Expansion { high: I::F64x8::splat(x.high), low: I::F64x8::splat(x.low) }
    }

    /// The numbers of one float64 each.
    #[inline(always)]
    pub fn plain(v: V<I>) -> [Self; 3] {
        let low = I::F64x8::splat(0.0);
        [Expansion { high: v[0], low }, Expansion { high: v[1], low }, Expansion { high: v[2], low }]
    }

    /// The high parts.
    #[inline(always)]
    pub fn highs(v: [Self; 3]) -> V<I> {
        [v[0].high, v[1].high, v[2].high]
    }

    /// a − b, exactly, by axis.
    #[inline(always)]
    pub fn vector_diff(a: V<I>, b: V<I>) -> [Self; 3] {
        [Self::diff(a[0], b[0]), Self::diff(a[1], b[1]), Self::diff(a[2], b[2])]
    }

    /// a − b, exactly.
    #[inline(always)]
    pub fn diff(a: I::F64x8, b: I::F64x8) -> Self {
        let (high, low) = two_diff(a, b);
        Expansion { high, low }
    }

    /// a + b, exactly.
    #[inline(always)]
    fn sum(a: I::F64x8, b: I::F64x8) -> Self {
        let (high, low) = two_sum(a, b);
        Expansion { high, low }
    }

    /// The same number, as the nearest float64 and the rest.
    #[inline(always)]
    pub fn renormalized(self) -> Self {
        Self::sum(self.high, self.low)
    }

    /// a + b, exactly, for |a| ≥ |b|.
    #[inline(always)]
    pub fn fast_sum(a: I::F64x8, b: I::F64x8) -> Self {
        let (high, low) = fast_two_sum(a, b);
        Expansion { high, low }
    }

    /// p·q − r·s, and |p·q| + |r·s|.
    #[inline(always)]
    pub fn minor(p: Self, q: Self, r: Self, s: Self) -> (Self, I::F64x8) {
        let (a, a_low) = two_product(p.high, q.high);
        let (b, b_low) = two_product(r.high, s.high);
        let Expansion { high, low } = Self::diff(a, b);
        let first = p.low.mul_add(q.high, p.high.mul_add(q.low, a_low));
        let second = r.low.mul_add(s.high, r.high.mul_add(s.low, b_low));
        (Expansion { high, low: low.add(first.sub(second)) }, a.abs().add(b.abs()))
    }

    /// p × q; and for each coordinate, a difference of two products, the sum of their absolute values.
    #[inline(always)]
    pub fn cross(p: [Self; 3], q: [Self; 3]) -> ([Self; 3], V<I>) {
        let (x, x_size) = Self::minor(p[1], q[2], p[2], q[1]);
        let (y, y_size) = Self::minor(p[2], q[0], p[0], q[2]);
        let (z, z_size) = Self::minor(p[0], q[1], p[1], q[0]);
        ([x, y, z], [x_size, y_size, z_size])
    }

    /// a·b without the product of the low parts.
    #[inline(always)]
    pub fn product(a: Self, b: Self) -> Self {
        let (high, low) = two_product(a.high, b.high);
        Expansion { high, low: a.low.mul_add(b.high, a.high.mul_add(b.low, low)) }
    }

    /// The compensated dot product Dot2 (T. Ogita, S. Rump, S. Oishi, Accurate sum and dot product, SIAM J.
    /// Sci. Comput. 26, 2005), with the low parts of the factors in its correction. `Crossing` derives its
    /// bound and that of `minor`.
    #[inline(always)]
    pub fn dot(a: [Self; 3], b: [Self; 3]) -> Self {
        let (x, x_low) = two_product(a[0].high, b[0].high);
        let (y, y_low) = two_product(a[1].high, b[1].high);
        let (z, z_low) = two_product(a[2].high, b[2].high);
        let x_low = a[0].low.mul_add(b[0].high, a[0].high.mul_add(b[0].low, x_low));
        let y_low = a[1].low.mul_add(b[1].high, a[1].high.mul_add(b[1].low, y_low));
        let z_low = a[2].low.mul_add(b[2].high, a[2].high.mul_add(b[2].low, z_low));
        Self::sum_of_three((x, y, z), (x_low, y_low, z_low))
    }

    /// As `dot`.
    #[inline(always)]
    pub fn dot_plain(a: [Self; 3], b: V<I>) -> Self {
        let (x, x_low) = two_product(a[0].high, b[0]);
        let (y, y_low) = two_product(a[1].high, b[1]);
        let (z, z_low) = two_product(a[2].high, b[2]);
        let x_low = a[0].low.mul_add(b[0], x_low);
        let y_low = a[1].low.mul_add(b[1], y_low);
        let z_low = a[2].low.mul_add(b[2], z_low);
        Self::sum_of_three((x, y, z), (x_low, y_low, z_low))
    }

    /// The nearest float64, or a neighbour of it.
    #[inline(always)]
    pub fn rounded(self) -> I::F64x8 {
        self.high.add(self.low)
    }

    #[inline(always)]
    fn sum_of_three(
        (x, y, z): (I::F64x8, I::F64x8, I::F64x8),
        (x_low, y_low, z_low): (I::F64x8, I::F64x8, I::F64x8),
    ) -> Self {
        let xy = Self::sum(x, y);
        let all = Self::sum(xy.high, z);
        Expansion { high: all.high, low: xy.low.add(all.low).add(x_low.add(y_low).add(z_low)) }
    }
}

impl<I: Isa> LongExpansion<I> {
    /// The sum of large numbers, of some of about u times their size, and of some of u² times their size,
    /// which alone are added with rounding.
    #[inline(always)]
    fn sum<const L: usize, const M: usize, const S: usize>(
        large: [I::F64x8; L],
        medium: [I::F64x8; M],
        small: [I::F64x8; S],
    ) -> Self {
        let (mut high, mut low, mut rest) = (large[0], medium[0], small[0]);
        for x in &small[1..] {
            rest = rest.add(*x);
        }
        for x in &medium[1..] {
            let (sum, error) = two_sum(low, *x);
            (low, rest) = (sum, rest.add(error));
        }
        for x in &large[1..] {
            let (sum, error) = two_sum(high, *x);
            let (medium, error) = two_sum(low, error);
            (high, low, rest) = (sum, medium, rest.add(error));
        }
        LongExpansion { high, low, rest }
    }

    /// p·q − r·s.
    #[inline(always)]
    fn minor(p: Expansion<I>, q: Expansion<I>, r: Expansion<I>, s: Expansion<I>) -> Self {
        let (r, r_low) = (r.high.negated(), r.low.negated());
        let [(a, a1), (b, b1), (c, c1)] =
            [two_product(p.high, q.high), two_product(p.high, q.low), two_product(p.low, q.high)];
        let [(d, d1), (e, e1), (f, f1)] =
            [two_product(r, s.high), two_product(r, s.low), two_product(r_low, s.high)];
        Self::sum([a, d], [a1, b, c, d1, e, f], [b1, c1, e1, f1, p.low.mul(q.low), r_low.mul(s.low)])
    }

    /// p × q, for p and q of which each low part is at most u of the high one. A coordinate p·q − r·s
    /// of the size A = |p·q| + |r·s| has a low part of at most 4u·A and a rest of at most 27u²·A, and
    /// is off by at most 300u³·A: three medium products of u·A and a rounding of the large ones sum to
    /// 4u·A, six roundings of that and three small products of u²·A to 27u²·A, in 11 additions; and one
    /// small product rounds.
    #[inline(always)]
    pub fn cross(p: [Expansion<I>; 3], q: [Expansion<I>; 3]) -> [Self; 3] {
        [
            Self::minor(p[1], q[2], p[2], q[1]),
            Self::minor(p[2], q[0], p[0], q[2]),
            Self::minor(p[0], q[1], p[1], q[0]),
        ]
    }

    /// n·r for n of `cross` and r of which each low part is at most u of the high one, with the nearest
    /// float64 as its high part: off by at most 2500u³·S, S = ΣA_i|r_i|, and 2u² of itself. Medium
    /// products and roundings of the large ones sum to 8u·S; ten roundings of that and small products of
    /// 36u²·S to 116u²·S, in 18 additions: 2088u³·S. Small products round by 62u³·S, and n is off by
    /// 300u³·S. The sum of three numbers to two rounds by u of the lower one, which is at most u of the
    /// higher and 117u³·S.
    #[inline(always)]
    pub fn dot(n: [Self; 3], r: [Expansion<I>; 3]) -> Expansion<I> {
        let [(x, x_medium, x_small), (y, y_medium, y_small), (z, z_medium, z_small)] =
            [Self::product(n[0], r[0]), Self::product(n[1], r[1]), Self::product(n[2], r[2])];
        let ([a, b, c], [d, e, f], [g, h, i]) = (x_medium, y_medium, z_medium);
        let ([j, k, l], [m, n, o], [p, q, r]) = (x_small, y_small, z_small);
        Self::sum([x, y, z], [a, b, c, d, e, f, g, h, i], [j, k, l, m, n, o, p, q, r]).shortened()
    }

    /// n·r + n·s, as `dot`: off by at most 12,000u³·S, S = ΣA_i(|r_i| + |s_i|), and 2u² of itself.
    /// Medium products and five roundings of the large ones sum to 11u·S; 22 roundings of that and small
    /// products of 36u²·S to 278u²·S, in 39 additions: 10,842u³·S. Small products round by 62u³·S, n
    /// is off by 300u³·S, and the last sum rounds by u of 279u²·S.
    #[inline(always)]
    pub fn dot_of_two(n: [Self; 3], r: [Expansion<I>; 3], s: [Expansion<I>; 3]) -> Expansion<I> {
        let zero = I::F64x8::splat(0.0);
        let (mut large, mut medium, mut small) = ([zero; 6], [zero; 18], [zero; 18]);
        for axis in 0..3 {
            for (k, factor) in [r[axis], s[axis]].into_iter().enumerate() {
                let at = 2 * axis + k;
                let (product, of_medium, of_small) = Self::product(n[axis], factor);
                large[at] = product;
                for i in 0..3 {
                    (medium[3 * at + i], small[3 * at + i]) = (of_medium[i], of_small[i]);
                }
            }
        }
        Self::sum(large, medium, small).shortened()
    }

    /// The sum as the nearest float64 and the rest.
    #[inline(always)]
    fn shortened(self) -> Expansion<I> {
        let (high, low) = two_sum(self.high, self.low);
        let (low, rest) = two_sum(low, self.rest);
        let (high, low) = two_sum(high, low);
        Expansion { high, low: low.add(rest) }
    }

    /// The large, medium and small numbers of a product.
    #[inline(always)]
    fn product(n: Self, r: Expansion<I>) -> (I::F64x8, [I::F64x8; 3], [I::F64x8; 3]) {
        let (a, a1) = two_product(n.high, r.high);
        let (b, b1) = two_product(n.high, r.low);
        let (c, c1) = two_product(n.low, r.high);
        (a, [a1, b, c], [b1, c1, n.low.mul_add(r.low, n.rest.mul(r.high))])
    }
}
