//! Boxes around moving bodies, over a span of time.

use super::affine::Affine;
use super::dop::Dop;
use super::pose::{Cubic, Path, Velocity};
use super::vector::{Point, length_above};
use crate::arith::elementary::LARGEST_ANGLE;
use crate::arith::number::{Interval, UNIT};

/// A part of a span of time in which one formula holds, with bounds of the motion there.
struct Part {
    first: f64,
    last: f64,
    /// The largest speed along each world axis, and the largest angular speed.
    linear: Point,
    angular: f64,
    /// The largest values of the terms of the formula: a length, and an angle.
    reach: f64,
    turn: f64,
}

/// A body turns by at most this angle, in rad, within one part, unless that takes more than `PIECES` parts.
const TURN: f64 = 0.25;
const PIECES: f64 = 64.0;

const TWO_TO_THE_40: f64 = (1_u64 << 40) as f64;

impl Path {
    /// A box around all places of a body that moves along the path between two times.
    pub fn sweep(&self, shape: &Dop, span: [f64; 2]) -> [Interval; 3] {
        if let Path::Mounted { body, mount } = self {
            // The rounded pose of the mount is within the allowance of `during` for the poses of the body and
            // then of the mount.
            return body.sweep(&Dop::of_box(shape.image(&Affine::from(*mount))), span);
        }
        let mut all = [Interval { low: f64::INFINITY, high: f64::NEG_INFINITY }; 3];
        for part in self.parts(span) {
            // At the knots the poses are as given; the formulas reach them up to rounding.
            let ends: &[f64] =
                if matches!(self, Path::Knots { .. }) { &[part.first, part.last] } else { &[] };
            let ends = ends.iter().map(|&time| shape.image(&Affine::from(self.at(time))));
            for place in ends.chain([self.during(&part, shape)]) {
                for (all, place) in all.iter_mut().zip(place) {
                    // An unknown bound makes the box infinite.
                    all.low = if all.low <= place.low { all.low } else { place.low };
                    all.high = if all.high >= place.high { all.high } else { place.high };
                }
            }
        }
        all
    }

    /// Upper bounds of the distance and of the angle, in rad, between the poses of a body at any two moments
    /// of a span, with 2⁻⁴⁰ of all lengths involved for rounding: 16 times what `during` allows.
    pub fn drift(&self, span: [f64; 2]) -> [f64; 2] {
        if let Path::Mounted { body, mount } = self {
            let [travel, turn] = body.drift(span);
            return [travel + turn * length_above(mount.rows().map(|row| row[3])), turn];
        }
        self.parts(span).iter().fold([0.0; 2], |[travel, turned], part| {
            let Part { first, last, linear, angular, reach, turn } = *part;
            let length = (last - first).next_up();
            let position = self.at(middle(first, last)).rows().map(|row| row[3]);
            let rounding = (1.0 + turn) / TWO_TO_THE_40;
            let far = rounding * (reach + length_above(position));
            [travel + length_above(linear) * length + far, turned + angular * length + rounding]
        })
    }

    fn parts(&self, [first, last]: [f64; 2]) -> Vec<Part> {
        match self {
            Path::Twist { linear, angular, .. } => {
                let (speed, angular) = (length_above(*linear), length_above(*angular));
                let longest = first.abs().max(last.abs());
                let nearest = if first < 0.0 && last > 0.0 { 0.0 } else { first.abs().min(last.abs()) };
                // Beyond the largest angle of a rotation vector, rounding does not grow with the angle. The
                // time of the switch between both forms is itself rounded.
                let turn = if angular * nearest > 2.0 * LARGEST_ANGLE { 0.0 } else { angular * longest };
                let turn = turn.min(2.0 * LARGEST_ANGLE);
                let part = |[first, last]: [f64; 2]| {
                    // The velocity has a constant length and turns with the body.
                    let there = self.velocity(middle(first, last)).linear;
                    let aside = speed * (angular * (last - first)).min(2.0);
                    let linear = there.map(|v| v.abs() + aside);
                    Part { first, last, linear, angular, reach: speed * longest, turn }
                };
                pieces([first, last], angular).map(part).collect()
            }
            Path::Knots { times, steps, .. } if !steps.is_empty() => {
                let from = times.partition_point(|&t| t <= first).saturating_sub(1);
                let to = times.partition_point(|&t| t < last).max(from + 1);
                let parts = (from..to).flat_map(|i| {
                    let first = if i == from { first } else { times[i] };
                    let last = if i + 1 == to { last } else { times[i + 1] };
                    self.parts_of_step(i, [first, last])
                });
                parts.collect()
            }
            _ => vec![Part { first, last, linear: [0.0; 3], angular: 0.0, reach: 0.0, turn: 0.0 }],
        }
    }

    /// The parts of a span that belongs to the i-th knot and the motion after it.
    fn parts_of_step(&self, i: usize, [first, last]: [f64; 2]) -> Vec<Part> {
        let Path::Knots { times, steps, .. } = self else { return Vec::new() };
        let (linear, angular, reach, turn) = if i == steps.len() && !steps[i - 1].is_linear() {
            let (Velocity { linear, angular }, longest) = (self.velocity(times[i]), last - times[i]);
            let (speed, angular) = (length_above(linear), length_above(angular));
            (linear.map(f64::abs), angular, speed * longest, angular * longest)
        } else {
            let i = i.min(steps.len() - 1);
            let length = times[i + 1] - times[i];
            let u =
                [first, last].map(|time| ((time - times[i]) / length).abs()).into_iter().fold(1.0, f64::max);
            let [shift, turn] = [&steps[i].shift, &steps[i].turn];
            // |(I − b[φ] + c[φ]²)·φ̇| ≤ |φ̇|: the matrix is normal, with the eigenvalue 1 and two
            // more of modulus sin(θ/2)/(θ/2).
            let angular = length_above(steepest(turn, u)) / length;
            (steepest(shift, u).map(|x| x / length), angular, farthest(shift, u), farthest(turn, u))
        };
        let part = |[first, last]: [f64; 2]| Part { first, last, linear, angular, reach, turn };
        pieces([first, last], angular).map(part).collect()
    }

    /// A box around all places of a body within a part.
    ///
    /// From the middle of the part, h before its end, the body moves by at most `linear`·h along each axis,
    /// and a point at distance r from its origin turns by min(`angular`·h, 2)·r. Poses are rounded. With u
    /// = 2⁻⁵³, the rotation vector rounds by less than 12u of the sum of its terms; its exponential, two
    /// products with it, and the deviation of the given rotations from orthonormal come to less than 60u
    /// together. The position rounds by less than 12u of its terms and u of itself; the travel of a twist is
    /// off as a rotation is. As a screw, its rotation is off by less than 60u, and its travel by as much of
    /// `reach`, which exceeds each term. A mount adds one more product. Twice that, for the middle and the
    /// moment, in three coordinates, is less than 512u of all lengths involved.
    fn during(&self, part: &Part, shape: &Dop) -> [Interval; 3] {
        let &Part { first, last, linear, angular, reach, turn } = part;
        let there = middle(first, last);
        let pose = Affine::from(self.at(there));
        let radius = length_above(shape.bounds().map(|b| b.low.abs().max(b.high.abs())));
        let half = (last - there).max(there - first).next_up();
        let rounding = 512.0 * UNIT * (1.0 + turn) * (radius + reach + length_above(pose.columns()[3]));
        let place = shape.image(&pose);
        std::array::from_fn(|i| {
            let reach =
                (linear[i] * half + (angular * half).min(2.0) * radius) * (1.0 + 16.0 * UNIT) + rounding;
            Interval { low: (place[i].low - reach).next_down(), high: (place[i].high + reach).next_up() }
        })
    }
}

fn middle(first: f64, last: f64) -> f64 {
    (first + 0.5 * (last - first)).clamp(first, last)
}

/// Consecutive pieces of a span; in each, a body with this angular speed turns by at most [`TURN`].
fn pieces([first, last]: [f64; 2], angular: f64) -> impl Iterator<Item = [f64; 2]> {
    let count = (angular * (last - first) / TURN).ceil().clamp(1.0, PIECES);
    let end = move |k: f64| if k < count { (first + k / count * (last - first)).min(last) } else { last };
    (0..count as u32).map(move |k| [end(f64::from(k)), end(f64::from(k + 1))])
}

/// Bounds of the derivative of a cubic, for |u| up to one.
fn steepest(Cubic([a, b, c]): &Cubic, u: f64) -> Point {
    std::array::from_fn(|i| a[i].abs() + u * (2.0 * b[i].abs() + u * 3.0 * c[i].abs()))
}

/// The sum of the terms of a cubic, for |u| up to one.
fn farthest(Cubic([a, b, c]): &Cubic, u: f64) -> f64 {
    u * (length_above(*a) + u * (length_above(*b) + u * length_above(*c)))
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;
    use std::sync::Arc;

    use super::*;
    use crate::arith::number::{Dyadic, Number};
    use crate::geometry::pose::{Pose, Step};
    use crate::geometry::vector;
    use crate::testing::numbers;

    fn pose(number: &mut impl FnMut() -> f64, place: f64) -> Pose {
        let mut one = || 2.0 * number() - 1.0;
        let ([a, b, c], position) = ([one(), one(), one()], [one(), one(), one()].map(|x| place * (1.0 + x)));
        let start = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let [x, y, z] = Path::twist(start, [0.0; 3], [a, b, c]).at(3.0).rows();
        let [p, q, r] = position;
        Pose::from_rows([[x[0], x[1], x[2], p], [y[0], y[1], y[2], q], [z[0], z[1], z[2], r]])
    }

    /// One path of each kind; the poses of the knots differ slightly from those that the steps lead to.
    fn paths(number: &mut impl FnMut() -> f64, place: f64, speed: f64) -> Vec<Path> {
        let cubic = |number: &mut dyn FnMut() -> f64, curved: f64| {
            let mut three = |scale: f64| [(); 3].map(|()| scale * (2.0 * number() - 1.0));
            Cubic([three(speed), three(speed * curved), three(speed * curved)])
        };
        let mut all = Vec::new();
        for curved in [0.0, 1.0] {
            let (mut times, mut poses, mut steps) =
                (vec![0.0], vec![pose(number, place)], Vec::<Step>::new());
            for i in 0..4 {
                let step = Step { shift: cubic(number, curved), turn: cubic(number, curved) };
                let (last, time) = (times[i], times[i] + 0.1 + number());
                let path = Path::Knots {
                    times: vec![last, time],
                    poses: vec![poses[i]; 2],
                    steps: vec![step],
                    end: time,
                };
                poses.push(path.at(time.next_down()));
                times.push(time);
                steps.push(step);
            }
            let end = times[4] + 0.25;
            all.push(Path::Knots { times, poses, steps, end });
        }
        let velocity = |number: &mut dyn FnMut() -> f64| [(); 3].map(|()| speed * (2.0 * number() - 1.0));
        all.push(Path::twist(pose(number, place), velocity(number), velocity(number)));
        // The allowance for travel must not hide that for turns.
        all.push(Path::twist(pose(number, place), [0.0; 3], velocity(number)));
        let mounts: Vec<Path> =
            all.iter().map(|path| Arc::new(path.clone()).mounted(&pose(number, place.min(4.0)))).collect();
        all.extend(mounts);
        all
    }

    #[test]
    fn a_sweep_holds_all_places_and_little_more() {
        let mut number = numbers();
        let (mut tight, mut count) = (0, 0);
        for (place, speed) in [(1.0, 0.1), (10.0, 1.0), (5e6, 2.0), (0.0, 20.0)] {
            for path in paths(&mut number, place, speed) {
                let [first, last] =
                    if let Path::Knots { end, .. } = &path { [0.0, *end] } else { [0.0, 3.0] };
                let bounds = [(); 3].map(|()| {
                    let low = 4.0 * (number() - 0.5);
                    Interval { low, high: low + number() }
                });
                for _ in 0..20 {
                    let a = first + number() * (last - first);
                    let b = (a + [0.0, 0.01, 0.1, 5.0][count % 4]).min(last);
                    let swept = path.sweep(&Dop::of_box(bounds), [a, b]);
                    let mut hull = [Interval { low: f64::INFINITY, high: f64::NEG_INFINITY }; 3];
                    for k in 0..=200 {
                        let pose = path.at((a + f64::from(k) / 200.0 * (b - a)).min(b));
                        for corner in 0..8 {
                            let point = std::array::from_fn(|i| {
                                if corner >> i & 1 == 0 { bounds[i].low } else { bounds[i].high }
                            });
                            for (i, x) in pose.place(point).into_iter().enumerate() {
                                hull[i] = Interval { low: hull[i].low.min(x), high: hull[i].high.max(x) };
                            }
                        }
                    }
                    for i in 0..3 {
                        // The corners here are rounded relative to their place.
                        let rounding = 1e-15 * place.max(100.0);
                        assert!(swept[i].low <= hull[i].low + rounding, "{path:?} {a} {b} {i}");
                        assert!(hull[i].high <= swept[i].high + rounding, "{path:?} {a} {b} {i}");
                        tight += usize::from(
                            swept[i].high - swept[i].low < 2.0 * (hull[i].high - hull[i].low) + 0.1,
                        );
                    }
                    count += 1;
                }
            }
        }
        assert!(2 * tight > 3 * count, "{tight} of {}", 3 * count);
    }

    /// Whether a box contains another box placed by a pose, exactly.
    fn holds(swept: &[Interval; 3], pose: Pose, bounds: &[Interval; 3]) -> bool {
        pose.rows().iter().zip(swept).all(|([x, y, z, offset], swept)| {
            let ends = |from: f64, to: f64, m: f64| if m < 0.0 { to } else { from };
            let at = |p: Point| {
                let sum = vector::dot(&vector::exact::<Dyadic>([*x, *y, *z]), &vector::exact(p));
                sum.plus(&Dyadic::exact(*offset))
            };
            let corner = |from: fn(&Interval) -> f64, to: fn(&Interval) -> f64| {
                let [a, b, c] = bounds;
                at([ends(from(a), to(a), *x), ends(from(b), to(b), *y), ends(from(c), to(c), *z)])
            };
            let (low, high) = (corner(|i| i.low, |i| i.high), corner(|i| i.high, |i| i.low));
            low.minus(&Dyadic::exact(swept.low)).sign() != Ok(Ordering::Less)
                && high.minus(&Dyadic::exact(swept.high)).sign() != Ok(Ordering::Greater)
        })
    }

    /// In such a short time a body moves by less than the rounding of poses.
    #[test]
    fn a_sweep_over_a_few_moments_holds_all_places_exactly() {
        let mut number = numbers();
        // Up to 10¹² s, twists turn by angles beyond any rotation vector.
        for (place, speed, last) in [
            (1.0, 1.0, 1e4),
            (5e6, 2.0, 1e4),
            (0.0, 1e-3, 1e4),
            (10.0, 1e-12, 1e4),
            (1.0, 1.0, 2e6),
            (1.0, 1.0, 1e12),
        ] {
            for path in paths(&mut number, place, speed) {
                let [first, last] =
                    if let Path::Knots { end, .. } = &path { [0.0, *end] } else { [0.0, last] };
                let bounds = [(); 3].map(|()| {
                    let low = 4.0 * (number() - 0.5);
                    Interval { low, high: low + number() }
                });
                for _ in 0..30 {
                    let mut times = vec![first + number() * (last - first)];
                    (1..12).for_each(|k| times.push(times[k - 1].next_up()));
                    let swept = path.sweep(&Dop::of_box(bounds), [times[0], times[11]]);
                    for time in times {
                        assert!(holds(&swept, path.at(time), &bounds), "{path:?} {time}");
                    }
                }
            }
        }
    }
}
