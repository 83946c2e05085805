//! Discrete orientation polytopes: how far a body reaches along fixed directions (J. Klosowski et al.,
//! Efficient Collision Detection Using Bounding Volume Hierarchies of k-DOPs, 1998).

use super::affine::Affine;
use super::vector::Point;
use crate::arith::number::{Interval, UNIT};

/// How far a body reaches from zero along the 26 directions with coordinates −1, 0 and 1: to the sides,
/// edges and corners of a cube. Direction (x, y, z) has index 13 + x + 3y + 9z.
///
/// For a ball, the resulting box around its image is at most 13 % too large; the box around the image of its
/// box is up to 73 % too large.
#[derive(Clone, Debug)]
pub struct Dop([f64; 27]);

const ZERO: usize = 13;
const STEPS: [usize; 3] = [1, 3, 9];

/// Sums of coordinates up to this do not overflow.
const LARGEST: f64 = f64::MAX / 4.0;

impl Dop {
    /// The polytope of a box.
    pub fn of_box(bounds: [Interval; 3]) -> Self {
        let [x, y, z] = bounds.map(|side| [-side.low, 0.0, side.high]);
        let largest = bounds.iter().fold(0.0_f64, |m, side| m.max(side.low.abs()).max(side.high.abs()));
        Dop(std::array::from_fn(|i| x[i % 3] + y[i / 3 % 3] + z[i / 9])).rounded_up(largest)
    }

    /// The polytope of points; `None` if there are none.
    pub fn of_points(points: impl Iterator<Item = Point>) -> Option<Self> {
        // One direction of each opposite pair, from the half after zero.
        let (mut low, mut high, mut largest) = ([f64::INFINITY; ZERO], [f64::NEG_INFINITY; ZERO], 0.0_f64);
        for [x, y, z] in points {
            let (sum, difference) = (x + y, y - x);
            let along = [
                x,
                difference,
                y,
                sum,
                z - sum,
                z - y,
                z - difference,
                z - x,
                z,
                x + z,
                z + difference,
                y + z,
                z + sum,
            ];
            for ((low, high), x) in low.iter_mut().zip(&mut high).zip(along) {
                (*low, *high) = (if x < *low { x } else { *low }, if x > *high { x } else { *high });
            }
            largest = largest.max(x.abs()).max(y.abs()).max(z.abs());
        }
        let reach = |i: usize| {
            if i < ZERO {
                -low[ZERO - 1 - i]
            } else if i == ZERO {
                0.0
            } else {
                high[i - ZERO - 1]
            }
        };
        (low[0] <= high[0]).then(|| Dop(std::array::from_fn(reach)).rounded_up(largest))
    }

    /// Adds a margin for rounding, for coordinates up to the largest.
    ///
    /// A sum x + y + z is off by u·|x + y| + u·|x + y + z|, less than 6u of the largest; adding the margin
    /// rounds by 4u of it. A single coordinate is exact.
    fn rounded_up(mut self, largest: f64) -> Self {
        for (i, reach) in self.0.iter_mut().enumerate() {
            if !is_along_axis(i) {
                *reach = if largest < LARGEST { *reach + 12.0 * UNIT * largest } else { f64::INFINITY };
            }
        }
        self
    }

    /// The box around the body.
    pub fn bounds(&self) -> [Interval; 3] {
        STEPS.map(|step| Interval { low: -self.0[ZERO - step], high: self.0[ZERO + step] })
    }

    /// A box around the image of the body.
    pub fn image(&self, map: &Affine) -> [Interval; 3] {
        map.around(|row| self.along(row))
    }

    /// Upper bounds of −w·p and of w·p over all points p of the body.
    ///
    /// With |wᵢ| ≥ |wⱼ| ≥ |wₖ|, w is
    /// (|wᵢ| − |wⱼ|)·sᵢ + (|wⱼ| − |wₖ|)·(sᵢ + sⱼ) + |wₖ|·(sᵢ + sⱼ + sₖ),
    /// where s are the signed unit vectors along the axes. A difference, a product and two sums round by u of
    /// the terms each; the bound has 8u in place of 4u to cover its own roundings and second-order terms.
    /// Differences do not underflow.
    fn along(&self, w: Point) -> [f64; 2] {
        self.terms(w).map(|(sum, size)| sum + 8.0 * UNIT * size + f64::MIN_POSITIVE)
    }

    /// For −w and for w, the sum of the three terms of `along` and the sum of their sizes.
    fn terms(&self, w: Point) -> [(f64, f64); 2] {
        let mut axes = [0, 1, 2];
        for (i, j) in [(0, 1), (1, 2), (0, 1)] {
            if w[axes[i]].abs() < w[axes[j]].abs() {
                axes.swap(i, j);
            }
        }
        let next = [w[axes[1]].abs(), w[axes[2]].abs(), 0.0];
        let (mut at, mut sums) = (ZERO, [(0.0, 0.0); 2]);
        for (axis, next) in axes.into_iter().zip(next) {
            at = if w[axis] < 0.0 { at - STEPS[axis] } else { at + STEPS[axis] };
            let share = w[axis].abs() - next;
            for ((sum, size), at) in sums.iter_mut().zip([2 * ZERO - at, at]) {
                let term = if share == 0.0 { 0.0 } else { share * self.0[at] };
                (*sum, *size) = (*sum + term, *size + term.abs());
            }
        }
        sums
    }
}

/// Whether the direction sums at most one coordinate.
fn is_along_axis(i: usize) -> bool {
    i == ZERO || STEPS.contains(&i.abs_diff(ZERO))
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::geometry::vector::{dot, exact};
    use crate::testing::{assert_slack, numbers, worst};

    fn affine(scale: f64, next: &mut impl FnMut() -> f64) -> Affine {
        let mut three = |scale: f64| [0; 3].map(|_: u8| scale * (2.0 * next() - 1.0));
        let mut linear = [0; 3].map(|_: u8| three(1.0));
        // Rows with equal entries, and some zero entries.
        linear[0][1] = linear[0][0];
        linear[1][2] = 0.0;
        Affine::new(linear, three(scale))
    }

    fn holds(bounds: &[Interval; 3], map: &Affine, p: Point) -> bool {
        let [x, y, z, offset] = map.columns();
        (0..3).all(|i| {
            let image = dot(&exact::<Dyadic>([x[i], y[i], z[i]]), &exact(p)).plus(&Dyadic::exact(offset[i]));
            let Interval { low, high } = bounds[i];
            (low == f64::NEG_INFINITY || image.minus(&Dyadic::exact(low)).sign() != Ok(Ordering::Less))
                && (high == f64::INFINITY
                    || image.minus(&Dyadic::exact(high)).sign() != Ok(Ordering::Greater))
        })
    }

    #[test]
    fn images_hold_those_of_all_points_and_of_corners() {
        let mut next = numbers();
        for round in 0..2000 {
            let scale = [1.0, 1e6, 1e-160, 1e-322, 1e150, f64::MAX][round % 6];
            let map = affine(scale, &mut next);
            let points: Vec<Point> =
                (0..1 + round % 9).map(|_| [0; 3].map(|_: u8| scale * (2.0 * next() - 1.0))).collect();
            let of_points = Dop::of_points(points.iter().copied());
            let Some(dop) = of_points else { unreachable!("there are points") };
            let corners = dop.bounds();
            for p in &points {
                for (i, side) in corners.iter().enumerate() {
                    assert!(side.low <= p[i] && p[i] <= side.high);
                }
                assert!(holds(&dop.image(&map), &map, *p), "{map:?} {p:?}");
            }
            let image = Dop::of_box(corners).image(&map);
            for corner in 0..8 {
                let p =
                    [0, 1, 2].map(|i| if corner >> i & 1 == 0 { corners[i].low } else { corners[i].high });
                assert!(holds(&image, &map, p), "{map:?} {p:?}");
            }
        }
        assert!(Dop::of_points(std::iter::empty()).is_none());
    }

    /// A ball and a disc, in any orientation.
    #[test]
    fn images_are_little_larger_than_they_must_be() {
        let mut next = numbers();
        let mut unit = || loop {
            let v = [0; 3].map(|_: u8| 2.0 * next() - 1.0);
            let square: f64 = v.iter().map(|x| x * x).sum();
            if (0.01..1.0).contains(&square) {
                return v.map(|x| x / square.sqrt());
            }
        };
        let ball: Vec<Point> = (0..20_000).map(|_| unit()).collect();
        let disc: Vec<Point> =
            ball.iter().map(|[x, y, z]| [10.0 * (x + y), 10.0 * (y - x), 0.1 * z]).collect();
        for (points, most) in [(&ball, 1.13), (&disc, 1.2)] {
            let of_points = Dop::of_points(points.iter().copied());
            let Some(dop) = of_points else { unreachable!("there are points") };
            for _ in 0..100 {
                let w = unit();
                let reach =
                    points.iter().map(|p| w[0] * p[0] + w[1] * p[1] + w[2] * p[2]).fold(0.0, f64::max);
                assert!(dop.along(w)[1] < most * reach, "{w:?}");
            }
        }
    }

    /// A point, which its own box encloses exactly. Its coordinate sums have at worst two of the three
    /// roundings, and terms of one sign take every counted rounding.
    #[test]
    fn reaches_are_off_by_the_share_of_their_bounds_that_is_known() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| 2.0 * next() - 1.0;
        let off = |x: &[f64; 6]| {
            let (p, w) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
            let dop = Dop::of_box(p.map(Interval::point));
            let largest = p.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let truth = |w: Point, p: Point| dot(&exact::<Dyadic>(w), &exact(p));
            // How far the sums fall short of the exact ones before the margin is added.
            let summed = (0..27).filter(|i| !is_along_axis(*i)).fold(0.0_f64, |worst, i| {
                let direction = [i % 3, i / 3 % 3, i / 9].map(|k| k as f64 - 1.0);
                let room = 12.0 * UNIT * largest;
                worst.max((room - Dyadic::exact(dop.0[i]).minus(&truth(direction, p)).split().0) / room)
            });
            // The same for the terms.
            let [_, (_, size)] = dop.terms(w);
            let room = 8.0 * UNIT * size;
            let rounded = room - Dyadic::exact(dop.along(w)[1]).minus(&dop.exact_terms(w)).split().0;
            (summed, rounded / room)
        };
        assert_slack("sums", worst(8, 2000, draw, |x| off(x).0).0, 0.5);
        assert_slack("terms", worst(8, 2000, draw, |x| off(x).1).0, 0.46);
    }

    impl Dop {
        /// As `terms`, without rounding.
        fn exact_terms(&self, w: Point) -> Dyadic {
            let mut axes = [0, 1, 2];
            axes.sort_unstable_by(|&i, &j| w[j].abs().total_cmp(&w[i].abs()));
            let (mut at, mut sum) = (ZERO, Dyadic::exact(0.0));
            for k in 0..3 {
                let (axis, next) = (axes[k], if k < 2 { w[axes[k + 1]].abs() } else { 0.0 });
                at = if w[axis] < 0.0 { at - STEPS[axis] } else { at + STEPS[axis] };
                let share = Dyadic::exact(w[axis].abs()).minus(&Dyadic::exact(next));
                sum = sum.plus(&share.times(&Dyadic::exact(self.0[at])));
            }
            sum
        }
    }
}
