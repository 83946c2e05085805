//! Vectors over any [`Number`].

use crate::number::Number;

pub type Vector<N> = [N; 3];
pub type Point = [f64; 3];

#[inline(always)]
pub fn exact<N: Number>(v: Point) -> Vector<N> {
    v.map(N::exact)
}

#[inline(always)]
pub fn add<N: Number>(a: &Vector<N>, b: &Vector<N>) -> Vector<N> {
    [a[0].plus(&b[0]), a[1].plus(&b[1]), a[2].plus(&b[2])]
}

#[inline(always)]
pub fn sub<N: Number>(a: &Vector<N>, b: &Vector<N>) -> Vector<N> {
    [a[0].minus(&b[0]), a[1].minus(&b[1]), a[2].minus(&b[2])]
}

#[inline(always)]
pub fn scaled<N: Number>(a: &Vector<N>, s: &N) -> Vector<N> {
    [a[0].times(s), a[1].times(s), a[2].times(s)]
}

#[inline(always)]
pub fn dot<N: Number>(a: &Vector<N>, b: &Vector<N>) -> N {
    a[0].times(&b[0]).plus(&a[1].times(&b[1])).plus(&a[2].times(&b[2]))
}

#[inline(always)]
pub fn cross<N: Number>(a: &Vector<N>, b: &Vector<N>) -> Vector<N> {
    [
        a[1].times(&b[2]).minus(&a[2].times(&b[1])),
        a[2].times(&b[0]).minus(&a[0].times(&b[2])),
        a[0].times(&b[1]).minus(&a[1].times(&b[0])),
    ]
}

#[inline(always)]
pub fn norm2<N: Number>(a: &Vector<N>) -> N {
    dot(a, a)
}

pub fn negated<N: Number>(a: &Vector<N>) -> Vector<N> {
    [a[0].negated(), a[1].negated(), a[2].negated()]
}

/// The unit vector along `v`, which may be of any length that float64 holds; zero for zero.
pub fn unit(v: Point) -> Point {
    let largest = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return [0.0; 3];
    }
    // Scaled by a power of two, so that no square overflows or vanishes. The exponent is halved: its negation may not be a float64.
    let exponent = (largest.to_bits() >> 52) as i64 - 1023;
    let power = |k: i64| f64::from_bits(((k + 1023) as u64) << 52);
    let (first, second) = (power(-exponent / 2), power(-exponent - -exponent / 2));
    let v = v.map(|x| x * first * second);
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|x| x / length)
}
