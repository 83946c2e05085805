//! Vectors over any [`Number`].

use crate::arith::number::{Lanes, Number, OfRays, Uncertain};
use crate::arith::simd::Floats;

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

#[inline(always)]
pub fn is_zero<N: Number>(a: &Vector<N>) -> Result<bool, Uncertain> {
    Ok(a[0].is_zero()? && a[1].is_zero()? && a[2].is_zero()?)
}

/// Vectors, one per ray.
#[inline(always)]
pub fn of_rays<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(
    [x, y, z]: [L::Floats; 3],
    lanes: L,
) -> Vector<K> {
    [K::of_rays(x, lanes), K::of_rays(y, lanes), K::of_rays(z, lanes)]
}

/// An upper bound of |v|, if each coordinate is off by one rounding; at most |v|·(1 + 2⁻⁴⁸) if that is
/// a normal number.
pub fn length_above(v: Point) -> f64 {
    let largest = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    // Fewer than 8 roundings of relative size 2⁻⁵³, and the loss of subnormal coordinates.
    let [x, y, z] = v.map(|x| x / largest);
    largest * ((x * x + y * y + z * z).sqrt() * (1.0 + 4.0 * f64::EPSILON)) + f64::from_bits(1)
}

/// Upper bounds of how far a circle of radius r around an axis A reaches along each axis of coordinates:
/// r·√(1 − A_i²/|A|²). Each coordinate of A may be off by one rounding.
pub fn reach_of_circle(axis: Point, radius: f64) -> Point {
    let [x, y, z] = axis;
    let length = length_above(axis);
    let across = [[0.0, y, z], [x, 0.0, z], [x, y, 0.0]].map(length_above);
    std::array::from_fn(|i| {
        let share = match across[i] {
            0.0 => 0.0,
            // Subnormal quotients have fewer bits.
            _ if length.is_normal() => {
                (across[i] / length * (1.0 + 32.0 * f64::EPSILON)).max(f64::MIN_POSITIVE)
            }
            _ => 1.0,
        };
        (radius * share.min(1.0)).next_up()
    })
}

/// The unit vector along `v`, whose squares neither overflow nor underflow.
///
/// Coordinates are first rounded to 2⁻⁶⁰ of the largest, so that the way they were computed does not
/// affect coordinates that should cancel.
#[inline(always)]
pub fn unit<F: Floats<f64, N>, const N: usize>(v: [F; 3]) -> [F; 3] {
    let large = v[0].abs().max(v[1].abs()).max(v[2].abs()).mul(F::splat(1.0 / 256.0));
    let v = [rounded(v[0], large), rounded(v[1], large), rounded(v[2], large)];
    let length = v[0].mul(v[0]).add(v[1].mul(v[1])).add(v[2].mul(v[2])).sqrt();
    [v[0].div(length), v[1].div(length), v[2].div(length)]
}

/// `x` rounded to the last place of `large`, if at most half of it.
#[inline(always)]
fn rounded<F: Floats<f64, N>, const N: usize>(x: F, large: F) -> F {
    x.abs().le_pick(large.mul(F::splat(0.5)), x.add(large).sub(large), x)
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{Dyadic, UNIT};
    use crate::testing::{numbers, worst};

    /// |v|² (1 + u)² against the square of the length, as coordinates may be off by one rounding.
    #[test]
    fn lengths_are_above_the_true_ones_by_what_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        let (least, _) = worst(8, 2000, draw, |v: &[f64; 3]| {
            let square = norm2(&exact::<Dyadic>(*v)).split().0;
            let beyond = Dyadic::exact(length_above(*v)).squared().minus(&norm2(&exact(*v))).split().0;
            // The relative error of the length is half that of its square.
            if square > 0.0 { -beyond / (2.0 * square * UNIT) } else { f64::NEG_INFINITY }
        });
        // Of 8 roundings, six are for the quotients, which are squared, the sums, the root and two products,
        // and one is for the coordinates.
        assert!((1.0..8.0).contains(&-least), "{least}");
    }

    #[test]
    fn lengths_of_subnormal_vectors_are_above_the_true_ones() {
        for k in 1..512_u64 {
            let v = [k & 7, k >> 3 & 7, k >> 6].map(f64::from_bits);
            let beyond = Dyadic::exact(length_above(v)).squared().minus(&norm2(&exact::<Dyadic>(v)));
            assert_eq!(beyond.sign(), Ok(Ordering::Greater), "{v:?}");
        }
    }

    /// r²·(|A|² − A_i²) ≤ reach²·|A|², where squares underflow, overflow or have few bits, too.
    #[test]
    fn circles_reach_as_far_as_they_are_said_to() {
        let mut next = numbers();
        let sizes = [1.0, 1e-300, 3e-318, 1e150, 1e308];
        for round in 0..5000 {
            let mut draw = || next() * sizes[(5.0 * next()) as usize];
            let (axis, radius) = ([draw(), draw(), draw()], draw());
            let exact = exact::<Dyadic>(axis);
            let length2 = norm2(&exact);
            for (x, reach) in exact.iter().zip(reach_of_circle(axis, radius)) {
                let across = Dyadic::exact(radius).squared().times(&length2.minus(&x.squared()));
                let beyond = Dyadic::exact(reach).squared().times(&length2).minus(&across);
                assert_ne!(beyond.sign(), Ok(Ordering::Less), "{round}: {axis:?}, {radius}: {reach}");
            }
        }
        let along_z = reach_of_circle([0.0, 0.0, 1e-3], 0.5);
        assert!(along_z[0] < 0.5 * (1.0 + 64.0 * f64::EPSILON) && along_z[2] == f64::from_bits(1));
    }

    /// A formula with an error of 2⁻⁶⁰ of the largest coordinate may return any smaller number in place
    /// of zero.
    #[test]
    fn unit_vectors_do_not_depend_on_what_cancels() {
        let mut next = numbers();
        for _ in 0..1000 {
            let (x, z) = (0.5 + next(), next() - 0.5);
            let noise = (next() - 0.5) * 2.0_f64.powi(-60) * x.max(z.abs());
            assert_eq!(unit::<f64, 1>([x, 0.25 * noise, z]), unit([x, 0.0, z]));
        }
    }
}
