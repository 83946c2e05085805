//! Directions: turned by a little, and of unit length to rounding.

use crate::arith::elementary::sin_cos;
use crate::geometry::pose::dot;
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
pub fn beside(direction: Point, [left, up]: [f64; 2]) -> Point {
    let (level, [x, y]) = heading(direction);
    let [dx, dy, dz] = direction;
    let v = [dx - left * y - up * dz * x, dy + left * x - up * dz * y, dz + up * level];
    let length = (1.0 + left * left + up * up).sqrt();
    v.map(|c| c / length)
}

/// Length and direction of the horizontal part; at a pole the direction is x.
#[inline(always)]
fn heading([x, y, _]: Point) -> (f64, [f64; 2]) {
    let level = (x * x + y * y).sqrt();
    if level > 0.0 { (level, [x / level, y / level]) } else { (0.0, [1.0, 0.0]) }
}

/// To within 1e-6: a unit vector kept in float32 is one to within 2⁻²².
#[inline(always)]
pub fn is_unit(d: Point) -> bool {
    (dot(d, d) - 1.0).abs() <= 1e-6
}

#[inline(always)]
pub fn is_finite([x, y, z]: Point) -> bool {
    x.is_finite() & y.is_finite() & z.is_finite()
}

/// |d|² − 1, with an error below 2⁻⁷⁶ where d is unit to within 1e-6.
///
/// With h the coordinates rounded to multiples of 2⁻²⁶, |h|² is a multiple of 2⁻⁵² below 2, hence exact, and
/// d² − h² = (d − h)(d + h).
#[inline(always)]
fn excess(d: Point) -> f64 {
    const ROUNDER: f64 = 1.5 * (1_u64 << 26) as f64;
    let h = d.map(|x| (x + ROUNDER) - ROUNDER);
    let rest: Point = std::array::from_fn(|k| (d[k] - h[k]) * (d[k] + h[k]));
    (dot(h, h) - 1.0) + (rest[0] + rest[1] + rest[2])
}

/// t·|d| to within 1 ulp, for d unit to within 1e-6: √(1+e) = 1 + e/2 − e²/8 + e³/16 − …
#[inline(always)]
pub fn distance(t: f64, d: Point) -> f64 {
    let e = excess(d);
    t + t * (e * (0.5 - e * (0.125 - e * 0.0625)))
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn turned_adds_to_azimuth_and_elevation() {
        let at = |azimuth: f64, elevation: f64| {
            [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()]
        };
        let (got, expected) = (turned(at(2.0, -0.5), 0.3, 0.1), at(2.3, -0.4));
        assert!((0..3).all(|i| (got[i] - expected[i]).abs() < 3e-16));
    }
}
