//! Directions: turned by a little, and of unit length to rounding.

use crate::arith::elementary::sin_cos;
use crate::arith::simd::{Floats, lanes};
use crate::geometry::vector::Point;

/// `direction` with its azimuth and elevation increased. At a pole, where the azimuth is free, it is 0.
#[inline(always)]
pub fn turned(direction: Point, azimuth: f64, elevation: f64) -> Point {
    let (level, [x, y]) = heading(direction);
    let z = direction[2];
    let (sin_az, cos_az) = sin_cos(azimuth);
    let (sin_el, cos_el) = sin_cos(elevation);
    let flat = level * cos_el - z * sin_el;
    [flat * (x * cos_az - y * sin_az), flat * (x * sin_az + y * cos_az), z * cos_el + level * sin_el]
}

/// `direction`, unit, and to the left and upward of it by these tangents.
#[inline(always)]
pub fn beside(direction: Point, offset: [f64; 2]) -> Point {
    let ([left, up], length) = (offset, length_beside(offset));
    let [x, y, z] = direction;
    if [left, up] == [0.0; 2] && x * x + y * y > 0.0 {
        // Only the signs of zeros matter of the heading, and these are those of x and y.
        return [x - left * y - up * z * x, y + left * x - up * z * y, z + up];
    }
    Axis::of(direction).beside([left, up, length])
}

/// The length of a vector from unit length on to the left and upward by these tangents.
#[inline(always)]
pub fn length_beside([left, up]: [f64; 2]) -> f64 {
    (1.0 + left * left + up * up).sqrt()
}

/// The axis of a beam.
pub struct Axis {
    direction: Point,
    level: f64,
    heading: [f64; 2],
}

impl Axis {
    #[inline(always)]
    pub fn of(direction: Point) -> Self {
        let (level, heading) = heading(direction);
        Axis { direction, level, heading }
    }

    /// The unit vector to the left.
    #[inline(always)]
    pub fn left(&self) -> Point {
        [-self.heading[1], self.heading[0], 0.0]
    }

    /// As [`beside`], of N offsets: to the left, upward, and the length that belongs to them.
    #[inline(always)]
    pub fn beside<F: Floats<f64, N>, const N: usize>(&self, [left, up, length]: [F; 3]) -> [F; 3] {
        let [dx, dy, dz] = lanes::splat::<F, N>(self.direction);
        let [x, y, level] = lanes::splat::<F, N>([self.heading[0], self.heading[1], self.level]);
        let down = up.mul(dz);
        [
            dx.sub(left.mul(y)).sub(down.mul(x)).div(length),
            dy.add(left.mul(x)).sub(down.mul(y)).div(length),
            dz.add(up.mul(level)).div(length),
        ]
    }
}

/// Length and direction of the horizontal part; at a pole the direction is x.
#[inline(always)]
fn heading([x, y, _]: Point) -> (f64, [f64; 2]) {
    let level = (x * x + y * y).sqrt();
    if level > 0.0 { (level, [x / level, y / level]) } else { (0.0, [1.0, 0.0]) }
}

/// To within 1e-6: a unit vector kept in float32 is one to within 2⁻²².
#[inline(always)]
pub fn is_unit<F: Floats<f64, N>, const N: usize>(d: [F; 3]) -> bool {
    lanes::dot(d, d).sub(F::splat(1.0)).abs().le(F::splat(1e-6)) == all(N)
}

#[inline(always)]
pub fn is_finite<F: Floats<f64, N>, const N: usize>([x, y, z]: [F; 3]) -> bool {
    let infinite = F::splat(f64::INFINITY);
    x.abs().lt(infinite) & y.abs().lt(infinite) & z.abs().lt(infinite) == all(N)
}

/// The mask of so many lanes.
const fn all(lanes: usize) -> u32 {
    (1 << lanes) - 1
}

/// e = |d|² − 1, with an error below 2⁻⁷⁶ + u·|e| where d is unit to within 1e-6.
///
/// With h the coordinates rounded to multiples of 2⁻²⁶, |h|² is a multiple of 2⁻⁵² below 2, hence exact, and
/// so is what is left of it less 1; and d² − h² = (d − h)(d + h). There |d − h| ≤ 2⁻²⁷ is exact, and the sum
/// and the product round by u each: that is 2⁻⁷⁸·|dᵢ| a coordinate, less than 1.74 of these together. The two
/// sums of three such terms, which are 2⁻²⁶·|dᵢ| at most, round by less than 1.42 and 1.74 of 2⁻⁷⁹. In all
/// that is 3.3·2⁻⁷⁸, and the last sum rounds by u·|e|.
#[inline(always)]
fn excess<F: Floats<f64, N>, const N: usize>([x, y, z]: [F; 3]) -> F {
    const ROUNDER: f64 = 1.5 * (1_u64 << 26) as f64;
    let rounder = F::splat(ROUNDER);
    let h = [x.add(rounder).sub(rounder), y.add(rounder).sub(rounder), z.add(rounder).sub(rounder)];
    let rest = [x.sub(h[0]).mul(x.add(h[0])), y.sub(h[1]).mul(y.add(h[1])), z.sub(h[2]).mul(z.add(h[2]))];
    lanes::dot(h, h).sub(F::splat(1.0)).add(rest[0].add(rest[1]).add(rest[2]))
}

/// t·|d| to within ½ + 2⁻¹⁶ ulp, for d unit to within 1e-6: √(1+e) = 1 + e/2 − e²/8 + e³/16 − …
///
/// With |e| < 1.01e-6 < 2⁻¹⁹ the factor beside t is less than 2⁻²⁰, and what it, its product with t and e
/// round, less than 2⁻¹⁸·u in all; the next term of the series is less than 2⁻⁸⁰, 2⁻²⁷·u. So the last sum is
/// that of t·|d| to within 2⁻¹⁷·u·t, and rounds once.
#[inline(always)]
pub fn distance<F: Floats<f64, N>, const N: usize>(t: F, d: [F; 3]) -> F {
    let e = excess(d);
    let series = F::splat(0.125).sub(e.mul(F::splat(0.0625)));
    t.add(t.mul(e.mul(F::splat(0.5).sub(e.mul(series)))))
}

/// 1/|d| to within 4u, by |d|² of d unit to within 1e-6: 1/√(1+e) = 1 − e/2 + 3e²/8 − 5e³/16 + …
///
/// As of `distance`; the square, a sum of three products, is off by 3u, which is half of that here. The next
/// term of the series is less than 2⁻⁷⁷.
#[inline(always)]
pub fn reciprocal_length(squared_length: f64) -> f64 {
    let e = squared_length - 1.0;
    1.0 - e * (0.5 - e * (0.375 - e * 0.3125))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::{Dyadic, Number, UNIT};
    use crate::geometry::point::dot;
    use crate::geometry::vector;
    use crate::testing::{assert_slack, numbers, worst};

    #[test]
    fn beside_is_left_and_up() {
        let [x, y, z] = beside([1.0, 0.0, 0.0], [0.1, 0.2]);
        assert!((y / x - 0.1).abs() < 1e-15 && (z / x - 0.2).abs() < 1e-15);
        let [x, y, z] = beside([0.0, 1.0, 0.0], [0.1, 0.2]);
        assert!((x / y + 0.1).abs() < 1e-15 && (z / y - 0.2).abs() < 1e-15);
        // Straight up, left and up are as after a turn from straight ahead.
        let [x, y, z] = beside([0.0, 0.0, 1.0], [0.1, 0.2]);
        assert!((y / z - 0.1).abs() < 1e-15 && (x / z + 0.2).abs() < 1e-15);
    }

    /// Both functions give the same bits, including signed zeros.
    #[test]
    fn many_lie_beside_an_axis_as_each_does() {
        let mut number = numbers();
        let zeros = [0.0, -0.0, 1.0, -1.0];
        let special = (0..64).map(|k| [zeros[k % 4], zeros[k / 4 % 4], zeros[k / 16]]);
        let others: Vec<Point> = (0..200).map(|_| [0; 3].map(|_: u8| number() - 0.5)).collect();
        for direction in special.chain(others) {
            for left in [0.0, -0.0, 0.01, -0.02] {
                for up in [0.0, -0.0, 0.02, -0.01] {
                    let offset = [left, up, length_beside([left, up])];
                    let expected: Point = Axis::of(direction).beside(offset);
                    let found = beside(direction, [left, up]);
                    assert_eq!(
                        found.map(f64::to_bits),
                        expected.map(f64::to_bits),
                        "{direction:?} {offset:?}"
                    );
                }
            }
        }
    }

    /// Coordinates of unit vectors, or of vectors 1e-6 longer than that.
    fn vector(x: &[f64; 4], longer: f64) -> Point {
        let v = [x[0], x[1], x[2]];
        let length = dot(v, v).sqrt();
        v.map(|c| c / length * (1.0 + longer * (2.0 * x[3] - 1.0).clamp(-1.0, 1.0)))
    }

    #[test]
    fn excess_is_as_near_as_it_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        for (longer, known) in [(1e-16, 0.5), (4.9e-7, 0.9)] {
            let (found, _) = worst(8, 4000, draw, |x| {
                let d = vector(x, longer);
                let square = vector::norm2(&vector::exact::<Dyadic>(d));
                let e = square.minus(&Dyadic::exact(1.0));
                let off = e.minus(&Dyadic::exact(excess(d))).split().0.abs();
                off / (2.0_f64.powi(-76) + UNIT * e.split().0.abs())
            });
            assert_slack("excess", found, known);
        }
    }

    #[test]
    fn distances_are_rounded_as_near_as_it_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let (found, x) = worst(8, 4000, draw, |x: &[f64; 5]| {
            let (d, t) = (vector(&[x[0], x[1], x[2], x[3]], 4.9e-7), 1.0 + x[4].abs());
            let found = distance(t, d);
            // x² against t²·|d|²: twice the relative error.
            let square = vector::norm2(&vector::exact::<Dyadic>(d)).times(&Dyadic::exact(t).squared());
            let off = Dyadic::exact(found).squared().minus(&square).split().0.abs() / (2.0 * found);
            off / (found.next_up() - found)
        });
        assert!(0.5 < found && found <= 0.5 + 2.0_f64.powi(-16), "{found} at {x:?}");
    }

    #[test]
    fn reciprocal_lengths_are_as_near_as_it_says() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let (found, x) = worst(8, 4000, draw, |x: &[f64; 4]| {
            let d = vector(x, 4.9e-7);
            let found = reciprocal_length(dot(d, d));
            // x²·|d|² against 1: twice the relative error.
            let square = vector::norm2(&vector::exact::<Dyadic>(d)).times(&Dyadic::exact(found).squared());
            square.minus(&Dyadic::exact(1.0)).split().0.abs() / (2.0 * UNIT)
        });
        assert!(1.0 < found && found <= 4.0, "{found} at {x:?}");
    }

    #[test]
    fn turned_adds_to_azimuth_and_elevation() {
        let at = |azimuth: f64, elevation: f64| {
            [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()]
        };
        let (got, expected) = (turned(at(2.0, -0.5), 0.3, 0.1), at(2.3, -0.4));
        assert!((0..3).all(|i| (got[i] - expected[i]).abs() < 3e-16));
    }
}
