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

impl Constant {
    pub const ZERO: Constant = Constant { high: 0.0, low: 0.0, size: 0.0 };
}

impl From<&DoubleDouble> for Constant {
    #[inline(always)]
    fn from(x: &DoubleDouble) -> Self {
        let (high, low, error) = x.terms();
        Constant { high, low, size: (error / CONSTANT).max(high.abs()) }
    }
}

impl<I: Isa> Expansion<I> {
    #[inline(always)]
    pub fn splat(x: Constant) -> Self {
        Expansion { high: I::F64x8::splat(x.high), low: I::F64x8::splat(x.low) }
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
