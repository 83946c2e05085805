//! Vectors over any [`Number`].

use crate::number::Number;
use crate::simd::Floats;

pub type Vector<N> = [N; 3];
pub type Point = [f64; 3];

#[inline(always)]
pub fn exact<N: Number>(v: Point) -> Vector<N> {
    [N::exact(v[0]), N::exact(v[1]), N::exact(v[2])]
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

#[inline(always)]
pub fn negated<N: Number>(a: &Vector<N>) -> Vector<N> {
    [a[0].negated(), a[1].negated(), a[2].negated()]
}

/// A coordinate of `a` times one of `b`, an axis each.
#[inline(always)]
pub fn times<N: Number>(a: &Vector<N>, b: &Vector<N>) -> Vector<N> {
    [a[0].times(&b[0]), a[1].times(&b[1]), a[2].times(&b[2])]
}

/// The unit vector along `v`, whose squares neither overflow nor underflow.
#[inline(always)]
pub fn unit<F: Floats<f64, N>, const N: usize>(v: [F; 3]) -> [F; 3] {
    let length = v[0].mul(v[0]).add(v[1].mul(v[1])).add(v[2].mul(v[2])).sqrt();
    [v[0].div(length), v[1].div(length), v[2].div(length)]
}
