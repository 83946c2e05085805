//! Error-free transformations: the rounded result of an operation and its exact rounding error (collected by
//! T. Ogita, S. Rump, S. Oishi, Accurate sum and dot product, SIAM J. Sci. Comput. 26, 2005). They hold
//! unless an operation overflows or an error underflows.

use crate::arith::simd::{Floats, operations};

operations! {
    /// 2Sum (D. E. Knuth, The Art of Computer Programming 2, §4.2.2): a + b = s + e.
    pub fn two_sum(a: F, b: F) -> (F, F) {
        let s = a.add(b);
        let z = s.sub(a);
        (s, a.sub(s.sub(z)).add(b.sub(z)))
    }

    /// 2Sum of a and −b: a − b = s + e.
    pub fn two_diff(a: F, b: F) -> (F, F) {
        let s = a.sub(b);
        let z = s.sub(a);
        (s, a.sub(s.sub(z)).sub(b.add(z)))
    }

    /// Fast2Sum (T. J. Dekker, A floating-point technique for extending the available precision, 1971): a + b
    /// = s + e, for |a| ≥ |b| or a = 0.
    pub fn fast_two_sum(a: F, b: F) -> (F, F) {
        let s = a.add(b);
        (s, b.sub(s.sub(a)))
    }

    /// 2Prod by FMA: a·b = p + e.
    pub fn two_product(a: F, b: F) -> (F, F) {
        let p = a.mul(b);
        (p, a.mul_add(b, p.negated()))
    }
}
