//! A ray prepared for slab tests: float32 bounds of its origin and of its reciprocal direction, rounded
//! outward (T. Ize, Robust BVH Ray Traversal, JCGT 2013).

use super::node::WIDTH;
use crate::arith::number::Interval;
use crate::geometry::vector::Point;

/// Covers the roundings of a subtraction, a product and the padding product itself: 2⁻²⁴ each, three in
/// all, so a factor of four suffices (Ize has the same two-ulp padding).
const SHRINK: f32 = 1.0 - 4.0 * (f32::EPSILON / 2.0);
const STRETCH: f32 = 1.0 + 4.0 * (f32::EPSILON / 2.0);

/// One axis. Along the direction, a box begins at its `near` plane and ends at its `far` plane.
#[derive(Clone, Copy, Debug)]
struct Axis {
    /// Whether the direction is negative, so that the near plane is the high one.
    backward: bool,
    /// The origin, rounded so that the near plane moves nearer and the far plane farther.
    near_origin: f32,
    far_origin: f32,
    /// Bounds of 1/|direction|: from below (finite), and from above (infinite if the direction may be zero).
    near_slope: f32,
    far_slope: f32,
    /// The sign of the direction is unknown: the axis culls nothing.
    blind: bool,
}

/// The relevant part of a ray, t from `t_min` ≥ 0 to a shrinking limit, in units that put the largest
/// component of the direction into [½, 1).
#[derive(Clone, Debug)]
pub struct TraversalRay {
    axes: [Axis; 3],
    start: f32,
    limit: f32,
    /// The axes along which the direction is exactly zero, a bit each.
    parallel: u8,
    /// The t of the float64 ray times this is t here; a product of two powers of two.
    scale: (f64, f64),
}

/// Nearest float32 strictly below x.
pub(super) fn down(x: f64) -> f32 {
    (x as f32).next_down()
}

/// Nearest float32 strictly above x.
pub(super) fn up(x: f64) -> f32 {
    (x as f32).next_up()
}

fn power(k: i64) -> f64 {
    f64::from_bits(((k + 1023) as u64) << 52)
}

impl TraversalRay {
    /// `center` is that of the hierarchy; origins and directions are intervals.
    pub fn new(
        origin: [Interval; 3],
        direction: [Interval; 3],
        center: Point,
        t_min: f64,
        t_max: f64,
    ) -> Self {
        let largest = direction.iter().fold(0.0_f64, |m, d| m.max(d.low.abs()).max(d.high.abs()));
        // largest·2^−exponent lies in [½, 1); a subnormal one gives less, which only weakens the bounds.
        let exponent = ((largest.to_bits() >> 52) as i64 - 1022).clamp(-1021, 1023);
        let shrink = (power(-exponent / 2), power(-exponent - -exponent / 2));
        let axes = std::array::from_fn(|i| {
            // Differences round to nearest in float64; down() and up() leave half a float32 ulp for that.
            let (low, high) = (down(origin[i].low - center[i]), up(origin[i].high - center[i]));
            let d = direction[i];
            let backward = d.high <= 0.0 && d.low < 0.0;
            let blind = d.low < 0.0 && d.high > 0.0;
            let (small, large) = if backward { (-d.high, -d.low) } else { (d.low, d.high) };
            // A component may underflow here, which only weakens the bound from its reciprocal.
            let near_slope = down(1.0 / (large * shrink.0 * shrink.1).next_up()).clamp(0.0, f32::MAX);
            let far_slope = up(1.0 / (small * shrink.0 * shrink.1).next_down().max(0.0));
            Axis {
                backward,
                near_origin: if backward { low } else { high },
                far_origin: if backward { high } else { low },
                near_slope: if blind { 0.0 } else { near_slope },
                far_slope,
                blind,
            }
        });
        let scale = (power(exponent / 2), power(exponent - exponent / 2));
        let is_zero = |axis: usize| direction[axis].low == 0.0 && direction[axis].high == 0.0;
        let parallel = (0..3).fold(0, |bits, axis| bits | u8::from(is_zero(axis)) << axis);
        let mut ray = TraversalRay { axes, start: 0.0, limit: f32::INFINITY, parallel, scale };
        ray.start = down(t_min * scale.0 * scale.1).max(0.0);
        ray.lower_limit(t_max);
        ray
    }

    pub fn lower_limit(&mut self, t_max: f64) {
        self.limit = up(t_max * self.scale.0 * self.scale.1);
    }

    pub fn limit(&self) -> f32 {
        self.limit
    }

    pub(super) fn parallel(&self) -> u8 {
        self.parallel
    }

    /// Bounds of t from below at the entries into eight boxes, and from above at the exits.
    #[inline(always)]
    pub(super) fn intersect(
        &self,
        low: &[[f32; WIDTH]; 3],
        high: &[[f32; WIDTH]; 3],
    ) -> ([f32; WIDTH], [f32; WIDTH]) {
        let mut near = [self.start; WIDTH];
        let mut far = [self.limit; WIDTH];
        for (i, axis) in self.axes.iter().enumerate() {
            if axis.blind {
                continue;
            }
            let sign = if axis.backward { -1.0 } else { 1.0 };
            let (first, last) = if axis.backward { (&high[i], &low[i]) } else { (&low[i], &high[i]) };
            for k in 0..WIDTH {
                // 0·∞ gives NaN, which max and min ignore.
                near[k] = near[k].max((first[k] - axis.near_origin) * sign * axis.near_slope * SHRINK);
                far[k] = far[k].min((last[k] - axis.far_origin) * sign * axis.far_slope * STRETCH);
            }
        }
        (near, far)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::testing::worst;

    /// The t of a plane in float32: the least margin of its bounds, in roundings.
    #[test]
    fn bounds_are_on_the_safe_side_by_what_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 0.5 + 0.499 * next();
        let (least, x) = worst(6, 3000, draw, |x: &[f64; 2]| {
            let (plane, d) = (x[0] as f32, x[1]);
            if !(0.5..1.0).contains(&d) {
                return f64::NEG_INFINITY;
            }
            let ray = TraversalRay::new(
                [Interval::point(0.0); 3],
                [d, 0.9, 0.9].map(Interval::point),
                [0.0; 3],
                0.0,
                1e9,
            );
            let (mut low, mut high) = ([[-1e9; WIDTH]; 3], [[1e9; WIDTH]; 3]);
            (low[0], high[0]) = ([plane; WIDTH], [plane; WIDTH]);
            let (near, far) = ray.intersect(&low, &high);
            // t·d against the plane; the largest coordinate is in [½, 1), so t is not scaled.
            let beyond = |t: f32| {
                let off = Dyadic::exact(f64::from(t))
                    .times(&Dyadic::exact(d))
                    .minus(&Dyadic::exact(f64::from(plane)));
                off.split().0 / (f64::from(plane) * f64::from(f32::EPSILON / 2.0))
            };
            beyond(near[0]).max(-beyond(far[0]))
        });
        assert!((1.5..3.0).contains(&-least), "{least} at {x:?}");
    }

    #[test]
    fn origins_and_limits_are_rounded_outward() {
        let mut next = crate::testing::numbers();
        for k in 0..20_000 {
            let mut number = |low: i32| next() * 2.0_f64.powi(low + k % 160);
            let (o, error, t) = (number(-80), number(-155), number(-155));
            let origin = [Interval { low: o - error, high: o + error }; 3];
            for sign in [1.0, -1.0] {
                let ray = TraversalRay::new(origin, [Interval::point(0.75 * sign); 3], [0.0; 3], t, t);
                assert!(f64::from(ray.start) <= t && t <= f64::from(ray.limit), "{t}");
                let Axis { near_origin, far_origin, .. } = ray.axes[0];
                let (low, high) =
                    if sign > 0.0 { (far_origin, near_origin) } else { (near_origin, far_origin) };
                assert!(f64::from(low) <= o - error && o + error <= f64::from(high), "{o} ± {error}");
            }
        }
    }

    /// The ray enters the box for only one of both signs of its direction.
    #[test]
    fn a_direction_of_unknown_sign_rules_nothing_out() {
        let unknown = Interval { low: -0.1, high: 0.1 };
        let direction = [unknown, Interval::point(0.75), Interval::point(0.75)];
        let ray = TraversalRay::new([Interval::point(0.0); 3], direction, [0.0; 3], 0.0, 1e9);
        for side in [1.0, -1.0] {
            let (low, high) = (
                [[0.5 * side - 0.1; WIDTH], [7.0; WIDTH], [7.0; WIDTH]],
                [[0.5 * side + 0.1; WIDTH], [8.0; WIDTH], [8.0; WIDTH]],
            );
            let (near, far) = ray.intersect(&low, &high);
            assert!((0..WIDTH).all(|k| near[k] <= far[k]));
        }
    }
}
