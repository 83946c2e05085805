//! Rigid poses, sensor to world, and their change over time.

use std::sync::Arc;

use crate::arith::elementary::{LARGEST_ANGLE, RECIPROCAL_FACTORIALS, polynomial, sin_cos};
use crate::arith::error_free::{two_product, two_sum};
use crate::arith::simd::{Floats, lanes};
use crate::arith::turns::{self, TurnRate};
use crate::geometry::point::{cross, dot, sub};
use crate::geometry::vector::Point;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    rotation: [Point; 3],
    translation: Point,
}

impl Pose {
    /// Takes the upper rows of a 4×4 matrix whose rotation part is orthonormal to within 1e-6.
    ///
    /// Two steps of R ← R(3I − RᵀR)/2 square the error twice, which brings a float32 matrix to float64
    /// accuracy and preserves the bits of an exactly orthonormal one.
    pub fn from_rows(rows: [[f64; 4]; 3]) -> Self {
        let mut rotation = rows.map(|r| [r[0], r[1], r[2]]);
        for _ in 0..2 {
            let column = |j: usize| [rotation[0][j], rotation[1][j], rotation[2][j]];
            let correction: [Point; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|j| (f64::from(u8::from(i == j)) * 3.0 - dot(column(i), column(j))) / 2.0)
            });
            rotation = product(rotation, correction);
        }
        Pose { rotation, translation: rows.map(|r| r[3]) }
    }

    pub fn rows(&self) -> [[f64; 4]; 3] {
        std::array::from_fn(|i| {
            let [x, y, z] = self.rotation[i];
            [x, y, z, self.translation[i]]
        })
    }

    /// A direction of the sensor frame in the world.
    #[inline(always)]
    pub fn turn<F: Floats<f64, N>, const N: usize>(&self, v: [F; 3]) -> [F; 3] {
        let [x, y, z] = self.rotation;
        [lanes::dot(lanes::splat(x), v), lanes::dot(lanes::splat(y), v), lanes::dot(lanes::splat(z), v)]
    }

    /// A point of the sensor frame in the world.
    #[inline(always)]
    pub fn place<F: Floats<f64, N>, const N: usize>(&self, p: [F; 3]) -> [F; 3] {
        let ([x, y, z], t) = (self.turn(p), self.translation);
        [x.add(F::splat(t[0])), y.add(F::splat(t[1])), z.add(F::splat(t[2]))]
    }

    /// A direction of the world in the sensor frame.
    #[inline(always)]
    pub fn turn_back<F: Floats<f64, N>, const N: usize>(&self, v: [F; 3]) -> [F; 3] {
        let column = |j: usize| lanes::splat([self.rotation[0][j], self.rotation[1][j], self.rotation[2][j]]);
        [lanes::dot(column(0), v), lanes::dot(column(1), v), lanes::dot(column(2), v)]
    }

    /// A point of the world in the sensor frame.
    #[inline(always)]
    pub fn place_back(&self, p: Point) -> Point {
        self.turn_back(sub(p, self.translation))
    }

    /// The world pose of a body whose pose in the frame of `self` is `inner`.
    pub fn then(&self, inner: &Pose) -> Pose {
        Pose { rotation: product(self.rotation, inner.rotation), translation: self.place(inner.translation) }
    }

    /// `self`, seen from the sensor frame of `base`.
    pub fn relative_to(&self, base: &Pose) -> Pose {
        let columns: [Point; 3] =
            std::array::from_fn(|j| base.turn_back(std::array::from_fn(|i| self.rotation[i][j])));
        Pose {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i])),
            translation: base.place_back(self.translation),
        }
    }
}

/// A pose at each time.
#[derive(Clone, Debug)]
pub enum Path {
    Still(Pose),
    /// Constant velocities in the moving frame of the sensor, also before time 0. Made by [`Path::twist`].
    Twist {
        start: Pose,
        linear: Point,
        angular: Point,
        screw: Arc<Screw>,
    },
    /// Each pose is reached at its time, and `steps[i]` leads from pose i to the next. Times increase. From
    /// the last knot to `end` both velocities stay constant; a single knot stands still.
    Knots {
        times: Vec<f64>,
        poses: Vec<Pose>,
        steps: Vec<Step>,
        end: f64,
    },
    /// A sensor mounted on a body, by its pose in the frame of the body. The body itself is neither mounted
    /// nor still.
    Mounted {
        body: Arc<Path>,
        mount: Pose,
    },
}

/// The motion of a body after a knot, as u grows from 0 to 1: `shift` moves the position, in the world, and
/// the rotation vector `turn` rotates the orientation, in the frame of the knot. With linear terms alone this
/// is linear interpolation and Slerp.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    pub shift: Cubic,
    pub turn: Cubic,
}

impl Step {
    pub(super) fn is_linear(&self) -> bool {
        [&self.shift, &self.turn].iter().all(|Cubic([_, b, c])| [*b, *c] == [[0.0; 3]; 2])
    }
}

/// a u + b u² + c u³.
#[derive(Clone, Copy, Debug)]
pub struct Cubic(pub [Point; 3]);

impl Cubic {
    fn at(&self, u: f64) -> Point {
        let Cubic([a, b, c]) = self;
        std::array::from_fn(|i| u * (a[i] + u * (b[i] + u * c[i])))
    }

    fn derivative(&self, u: f64) -> Point {
        let Cubic([a, b, c]) = self;
        std::array::from_fn(|i| a[i] + u * (2.0 * b[i] + u * 3.0 * c[i]))
    }
}

/// Linear velocity in the world and angular velocity in the moving frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    pub linear: Point,
    pub angular: Point,
}

/// The largest allowed coordinates, velocities and terms of cubics on moving paths: 2⁹⁸⁰.
///
/// Then nothing overflows. The largest intermediate result is the travel of a twist: its rotation vector of
/// up to 10⁶ < 2²⁰ rad, times itself and times a length; a rotation and a mount contribute a factor of
/// less than 2⁴.
pub const LARGEST: f64 = f64::from_bits((1023 + 980) << 52);

impl Path {
    /// The path of constant velocities in the moving frame.
    pub fn twist(start: Pose, linear: Point, angular: Point) -> Self {
        Path::Twist { start, linear, angular, screw: Arc::new(Screw::new(linear, angular)) }
    }

    /// The times for which there is a pose; for a twist, as long as it stays within [`LARGEST`].
    pub fn span(&self) -> [f64; 2] {
        match self {
            Path::Still(_) => [f64::NEG_INFINITY, f64::INFINITY],
            Path::Twist { linear, .. } => {
                let last = LARGEST / linear.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                [-last, last]
            }
            Path::Knots { times, end, .. } => [times[0], *end],
            Path::Mounted { body, .. } => body.span(),
        }
    }

    /// The path of a sensor with the pose `mount` on a body that moves along `self`.
    pub fn mounted(self: &Arc<Self>, mount: &Pose) -> Path {
        match &**self {
            Path::Still(pose) => Path::Still(pose.then(mount)),
            Path::Mounted { body, mount: outer } => {
                Path::Mounted { body: body.clone(), mount: outer.then(mount) }
            }
            _ => Path::Mounted { body: self.clone(), mount: *mount },
        }
    }

    /// The same path, with a span that continues to `until`.
    #[must_use]
    pub fn held(&self, until: f64) -> Path {
        let mut path = self.clone();
        match &mut path {
            Path::Still(_) | Path::Twist { .. } => {}
            Path::Knots { end, .. } => *end = end.max(until),
            Path::Mounted { body, .. } => *body = Arc::new(body.held(until)),
        }
        path
    }

    /// The pose at a time. Past the span the motion continues at the velocities of its end.
    pub fn at(&self, time: f64) -> Pose {
        match self {
            Path::Still(pose) => *pose,
            Path::Twist { start, linear, angular, screw } => {
                let Some(turn) = Turn::of_vector(angular.map(|x| x * time)) else {
                    return screw.at(start, time);
                };
                let travelled = start.turn(turn.travel(linear.map(|x| x * time)));
                Pose {
                    rotation: product(start.rotation, turn.matrix()),
                    translation: std::array::from_fn(|i| start.translation[i] + travelled[i]),
                }
            }
            Path::Knots { times, poses, steps, .. } => {
                let i = times.partition_point(|&t| t <= time).saturating_sub(1);
                if time == times[i] || steps.is_empty() {
                    return poses[i];
                }
                // Past the last knot a linear step continues; the terms of a spline would diverge.
                if i == steps.len() && !steps[i - 1].is_linear() {
                    let (Velocity { linear, angular }, after) = (self.velocity(times[i]), time - times[i]);
                    return Pose {
                        rotation: product(poses[i].rotation, Turn::new(angular.map(|x| x * after)).matrix()),
                        translation: std::array::from_fn(|k| poses[i].translation[k] + linear[k] * after),
                    };
                }
                let i = i.min(steps.len() - 1);
                let from = poses[i];
                let u = (time - times[i]) / (times[i + 1] - times[i]);
                let Step { shift, turn } = &steps[i];
                let shift = shift.at(u);
                Pose {
                    rotation: product(from.rotation, Turn::new(turn.at(u)).matrix()),
                    translation: std::array::from_fn(|k| from.translation[k] + shift[k]),
                }
            }
            Path::Mounted { body, mount } => body.at(time).then(mount),
        }
    }

    /// The velocity at a time. At a knot, it is that of departure; at and past the last knot, that of
    /// arrival.
    pub fn velocity(&self, time: f64) -> Velocity {
        self.motion(time).velocity
    }

    /// `at` and `velocity` together, at a lower cost.
    pub fn motion(&self, time: f64) -> Motion {
        if let Path::Mounted { body, mount } = self {
            let Motion { pose, velocity: Velocity { linear, angular } } = body.motion(time);
            let swung = pose.turn(cross(angular, mount.translation));
            let linear = std::array::from_fn(|i| linear[i] + swung[i]);
            let velocity = Velocity { linear, angular: mount.turn_back(angular) };
            return Motion { pose: pose.then(mount), velocity };
        }
        let pose = self.at(time);
        let velocity = match self {
            Path::Twist { linear, angular, .. } => Velocity { linear: pose.turn(*linear), angular: *angular },
            Path::Knots { times, steps, .. } if !steps.is_empty() => {
                let i = times.partition_point(|&t| t <= time).saturating_sub(1).min(steps.len() - 1);
                let length = times[i + 1] - times[i];
                let u = ((time - times[i]) / length).min(1.0);
                let Step { shift, turn } = &steps[i];
                let turning = Turn::new(turn.at(u)).rate(turn.derivative(u));
                Velocity {
                    linear: shift.derivative(u).map(|x| x / length),
                    angular: turning.map(|x| x / length),
                }
            }
            _ => Velocity { linear: [0.0; 3], angular: [0.0; 3] },
        };
        Motion { pose, velocity }
    }
}

/// The pose and the velocity of a body at a time.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    pub pose: Pose,
    pub velocity: Velocity,
}

impl Motion {
    /// The velocity in the world of a point of the body, given in its frame.
    #[inline(always)]
    pub fn velocity_of(&self, point: Point) -> Point {
        let Velocity { linear, angular } = self.velocity;
        let swung = self.pose.turn(cross(angular, point));
        std::array::from_fn(|i| linear[i] + swung[i])
    }
}

/// A twist as a motion along and about a screw axis (M. Chasles, 1830), for angles too large for a rotation
/// vector. The product with time would round by a share of the whole angle and the whole travel, which is
/// large compared with one turn and its radius.
///
/// With n along the angular velocity ω, the orientation is exp(θ[n]), θ = |ω|t, and the travel is (v·n)n
/// t + sin θ v⟂/|ω| + (1 − cos θ) n×v/|ω|.
#[derive(Clone, Debug)]
pub struct Screw {
    rate: TurnRate,
    axis: Point,
    /// (v·n)n.
    advance: Point,
    /// v⟂/|ω| and n×v/|ω|.
    swing: [Point; 2],
}

impl Screw {
    fn new(linear: Point, angular: Point) -> Self {
        let (axis, speed) = split(angular);
        // With a rounded axis, v·n would not vanish for perpendicular v.
        let (scaled, _) = scaled(angular);
        let along = accurate_dot(scaled, linear) / dot(scaled, scaled);
        let advance = scaled.map(|x| along * x);
        let swing = [sub(linear, advance), cross(axis, linear)].map(|v| v.map(|x| x / speed));
        Screw { rate: TurnRate::new(angular), axis, advance, swing }
    }

    fn at(&self, start: &Pose, time: f64) -> Pose {
        let (sin, cos) = self.rate.sin_cos(time);
        let turn = Turn { vector: self.axis, rotation: [sin, 1.0 - cos], travel: [0.0; 2] };
        let ([across, around], advance) = (self.swing, self.advance);
        let travelled = start
            .turn(std::array::from_fn(|i| advance[i] * time + (sin * across[i] + (1.0 - cos) * around[i])));
        Pose {
            rotation: product(start.rotation, turn.matrix()),
            translation: std::array::from_fn(|i| start.translation[i] + travelled[i]),
        }
    }
}

/// v/2ᵏ and 2ᵏ; the largest coordinate of v is one to two times 2ᵏ.
fn scaled(v: Point) -> (Point, f64) {
    let largest = v.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs()));
    let power = f64::from_bits(largest.to_bits() & 0x7ff << 52);
    (v.map(|x| x / power), power)
}

/// The unit vector along v, and |v|, to within 3u.
fn split(v: Point) -> (Point, f64) {
    let (v, power) = scaled(v);
    let length = dot(v, v).sqrt();
    (v.map(|x| x / length), length * power)
}

/// a·b as accurate as if computed in twice the precision (T. Ogita, S. Rump, S. Oishi, Accurate sum and dot
/// product, 2005: Dot2).
fn accurate_dot(a: Point, b: Point) -> f64 {
    let [(x, x_off), (y, y_off), (z, z_off)] = std::array::from_fn(|i| two_product(a[i], b[i]));
    let (sum, first_off) = two_sum(x, y);
    let (sum, second_off) = two_sum(sum, z);
    sum + (((x_off + y_off) + z_off) + (first_off + second_off))
}

/// A rotation by θ, as a vector and the factors of its exponential and its Jacobian (T. D. Barfoot, State
/// Estimation for Robotics, 2017, ch. 7).
///
/// For a rotation vector φ these are a = sin θ/θ, b = (1 − cos θ)/θ², c = (θ − sin θ)/θ³, θ =
/// |φ|. For a large angle, whose square may overflow, the vector is φ/θ, and the factors are multiplied by
/// θ or θ² accordingly.
struct Turn {
    vector: Point,
    /// a and b.
    rotation: [f64; 2],
    /// b and c.
    travel: [f64; 2],
}

impl Turn {
    fn new(vector: Point) -> Self {
        Self::of_vector(vector).unwrap_or_else(|| {
            let (vector, angle) = split(vector);
            let (sin, cos) = turns::sin_cos(angle);
            Turn { vector, rotation: [sin, 1.0 - cos], travel: [(1.0 - cos) / angle, (angle - sin) / angle] }
        })
    }

    /// `None` if the angle is beyond [`LARGEST_ANGLE`].
    #[inline]
    fn of_vector(vector: Point) -> Option<Self> {
        let square = dot(vector, vector);
        let angle = square.sqrt();
        let [a, b, c] = if angle <= 1.0 {
            // Where the quotients would cancel: 1/1! − θ²/3! + …, 1/2! − θ²/4! + …, 1/3! −
            // θ²/5! + …
            [1, 2, 3].map(|first| {
                polynomial::<9>(std::array::from_fn(|i| RECIPROCAL_FACTORIALS[first + 2 * i]), -square)
            })
        } else if angle <= LARGEST_ANGLE {
            let (sin, cos) = sin_cos(angle);
            [sin / angle, (1.0 - cos) / square, (angle - sin) / (square * angle)]
        } else {
            return None;
        };
        Some(Turn { vector, rotation: [a, b], travel: [b, c] })
    }

    /// I + a[φ] + b[φ]².
    fn matrix(&self) -> [Point; 3] {
        let columns =
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| self.series(e, self.rotation));
        std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]))
    }

    /// The displacement by a velocity that is constant in the turning frame: (I + b[φ] + c[φ]²)·v.
    fn travel(&self, v: Point) -> Point {
        self.series(v, self.travel)
    }

    /// The angular velocity in the turned frame while the vector changes at `derivative`: (I − b[φ] +
    /// c[φ]²)·φ̇.
    fn rate(&self, derivative: Point) -> Point {
        self.series(derivative, [-self.travel[0], self.travel[1]])
    }

    fn series(&self, v: Point, [first, second]: [f64; 2]) -> Point {
        let once = cross(self.vector, v);
        let twice = cross(self.vector, once);
        std::array::from_fn(|i| v[i] + first * once[i] + second * twice[i])
    }
}

fn product(a: [Point; 3], b: [Point; 3]) -> [Point; 3] {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [[f64; 4]; 3] = [[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0]];

    fn assert_close(a: Point, b: Point) {
        assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-14), "{a:?} {b:?}");
    }

    #[test]
    fn an_exact_rotation_keeps_its_bits_and_a_rounded_one_becomes_orthonormal() {
        assert_eq!(Pose::from_rows(ROWS).rows(), ROWS);
        let turned = Turn::new([0.3, -0.8, 0.5]).matrix();
        let rounded = Pose::from_rows(
            turned.map(|r| [r[0] as f32 as f64, r[1] as f32 as f64, r[2] as f32 as f64, 0.0]),
        );
        for v in [[1.0, 0.0, 0.0], [0.6, 0.0, 0.8]] {
            assert!((dot(rounded.turn(v), rounded.turn(v)) - 1.0).abs() < 1e-15);
            assert_close(rounded.turn_back(rounded.turn(v)), v);
        }
    }

    #[test]
    fn place_and_relative_to_undo_each_other() {
        let (base, pose) = (
            Pose::from_rows(ROWS),
            Path::twist(Pose::from_rows(ROWS), [1.0, 2.0, 3.0], [0.1, 0.2, 0.3]).at(2.0),
        );
        let p = [0.3, 0.2, 0.1];
        assert_close(base.place(pose.relative_to(&base).place(p)), pose.place(p));
    }

    #[test]
    fn a_twist_drives_a_circle() {
        // 1 m/s ahead and 0.5 rad/s to the left: radius 2, whole turns at multiples of 4π s.
        let start = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let path = Path::twist(start, [1.0, 0.0, 0.0], [0.0, 0.0, 0.5]);
        for (time, x, y) in
            [(0.0, 0.0, 0.0), (std::f64::consts::PI, 2.0, 2.0), (2.0 * std::f64::consts::PI, 0.0, 4.0)]
        {
            assert_close(path.at(time).place([0.0; 3]), [x, y, 0.0]);
        }
        // On both sides of the angle at which the series replaces the quotients.
        assert_close(path.at(2.0).place([1.0; 3]), path.at(2.0_f64.next_up()).place([1.0; 3]));
    }

    #[test]
    fn a_twist_is_a_screw_where_its_angle_is_large() {
        let (linear, angular) = ([1.0, -2.0, 0.5], [0.3, -0.6, 0.6]);
        let path = Path::twist(Pose::from_rows(ROWS), linear, angular);
        // 0.9 rad/s, on both sides of 10⁶ rad, where a rotation vector is off by some 10⁻¹⁰ of a turn.
        let (before, after) = (LARGEST_ANGLE / 0.9, (LARGEST_ANGLE / 0.9) * (1.0 + 1e-15));
        for (p, q) in [([0.0; 3], [0.0; 3]), ([1.0; 3], [1.0; 3])] {
            let (p, q) = (path.at(before).place(p), path.at(after).place(q));
            assert!((0..3).all(|i| (p[i] - q[i]).abs() < 1e-8), "{p:?} {q:?}");
        }
        // Half a turn later the body is on the other side of the axis and farther along it.
        let half = std::f64::consts::PI / 0.9;
        for time in [2.0_f64.powi(30), -(2.0_f64.powi(30))] {
            let [here, there] = [time, time + half].map(|time| path.at(time).turn([0.6, 0.8, 0.0]));
            let axis = Pose::from_rows(ROWS).turn([1.0 / 3.0, -2.0 / 3.0, 2.0 / 3.0]);
            let along = 2.0 * dot(axis, here);
            // The time is rounded by 2⁻²³ s.
            assert!(
                (0..3).all(|i| (here[i] + there[i] - along * axis[i]).abs() < 1e-6),
                "{here:?} {there:?}"
            );
        }
        assert_eq!(path.at(1e300).translation.map(f64::is_finite), [true; 3]);
        assert_eq!(path.span(), [-LARGEST / 2.0, LARGEST / 2.0]);
        // A vector whose square overflows still has a direction.
        let [x, y, z] = Turn::new([3e200, 0.0, -4e200]).matrix();
        assert_close([dot(x, y), dot(y, z), dot(z, z)], [0.0, 0.0, 1.0]);
        assert_close([x, y, z].map(|row| dot(row, [0.6, 0.0, -0.8])), [0.6, 0.0, -0.8]);
    }

    #[test]
    fn knots_are_met_and_halves_are_between() {
        let first = Pose::from_rows(ROWS);
        let turn = [0.0, 0.0, 1.5];
        let second = Pose {
            rotation: product(first.rotation, Turn::new(turn).matrix()),
            translation: [7.0, 6.0, 7.0],
        };
        let linear = |a| Cubic([a, [0.0; 3], [0.0; 3]]);
        let steps = vec![Step { shift: linear([2.0, 0.0, 0.0]), turn: linear(turn) }];
        let path = Path::Knots { times: vec![1.0, 3.0], poses: vec![first, second], steps, end: 3.0 };
        assert_eq!((path.at(1.0), path.at(3.0), path.span()), (first, second, [1.0, 3.0]));
        let half = path.at(2.0);
        assert_eq!(half.translation, [6.0, 6.0, 7.0]);
        let (sin, cos) = sin_cos(0.75);
        assert_close(half.turn([1.0, 0.0, 0.0]), first.turn([cos, sin, 0.0]));
    }

    #[test]
    fn a_mount_swings_with_its_body() {
        // A body turns left in place, with a sensor 2 m ahead of its centre that looks left.
        let start = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let body = Arc::new(Path::twist(start, [0.0; 3], [0.0, 0.0, 0.5]));
        let mount = Pose::from_rows([[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let sensor = Arc::new(body.mounted(&mount));
        let quarter = std::f64::consts::PI;
        assert_close(sensor.at(quarter).place([0.0; 3]), [0.0, 2.0, 0.0]);
        assert_close(sensor.at(quarter).turn([1.0, 0.0, 0.0]), [-1.0, 0.0, 0.0]);
        assert_close(sensor.velocity(quarter).linear, [-1.0, 0.0, 0.0]);
        assert_close(sensor.velocity(quarter).angular, [0.0, 0.0, 0.5]);
        // Nested mounts combine into one; a mount on a still body is still.
        let twice = sensor.mounted(&mount);
        assert_eq!(twice.at(quarter), body.at(quarter).then(&mount.then(&mount)));
        let Path::Still(pose) = Arc::new(Path::Still(mount)).mounted(&mount) else { panic!("it moves") };
        assert_eq!(pose, mount.then(&mount));
    }

    #[test]
    fn a_held_path_goes_on_at_constant_velocity() {
        let start = Pose::from_rows(ROWS);
        let turn = [0.0, 0.0, 1.5];
        let end = Pose {
            rotation: product(start.rotation, Turn::new(turn).matrix()),
            translation: [7.0, 6.0, 7.0],
        };
        let linear = |a| Cubic([a, [0.0; 3], [0.0; 3]]);
        let steps = vec![Step { shift: linear([2.0, 0.0, 0.0]), turn: linear(turn) }];
        let path = Path::Knots { times: vec![1.0, 3.0], poses: vec![start, end], steps, end: 3.0 };
        let held = path.held(4.0);
        assert_eq!((held.span(), held.held(2.0).span()), ([1.0, 4.0], [1.0, 4.0]));
        for time in [1.0, 1.7, 2.9, 3.0] {
            assert_eq!(held.at(time), path.at(time));
        }
        let (sin, cos) = sin_cos(2.25);
        assert_eq!(held.at(4.0).translation, [8.0, 6.0, 7.0]);
        assert_close(held.at(4.0).turn([1.0, 0.0, 0.0]), start.turn([cos, sin, 0.0]));
        let one = Path::Knots { times: vec![1.0], poses: vec![start], steps: vec![], end: 1.0 }.held(2.0);
        assert_eq!((one.at(1.5), one.span()), (start, [1.0, 2.0]));
    }

    #[test]
    fn a_held_spline_goes_on_at_the_velocities_of_its_end() {
        let start = Pose::from_rows(ROWS);
        let step = Step {
            shift: Cubic([[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.25, -1.0]]),
            turn: Cubic([[0.0, 0.0, 0.5], [0.0, 0.25, 0.0], [0.125, 0.0, 0.25]]),
        };
        let end = Pose {
            rotation: product(start.rotation, Turn::new([0.125, 0.25, 0.75]).matrix()),
            translation: [6.0, 6.75, 6.0],
        };
        let path =
            Path::Knots { times: vec![1.0, 3.0], poses: vec![start, end], steps: vec![step], end: 3.0 };
        // A twist is at its start at time 0.
        let Velocity { linear, angular } = path.velocity(3.0);
        assert_close(linear, [0.5, 0.875, -1.5]);
        let mount = Pose::from_rows([[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5]]);
        let swings = Path::twist(end, [0.0; 3], angular);
        for (held, mount) in [
            (
                path.held(4.0),
                Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
            ),
            (Arc::new(path.clone()).mounted(&mount).held(4.0), mount),
        ] {
            assert_eq!(held.span(), [1.0, 4.0]);
            for time in [3.0_f64.next_up(), 3.5, 4.0] {
                let after = time - 3.0;
                let moved: Point = std::array::from_fn(|k| linear[k] * after);
                for p in [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
                    let swung = swings.at(after).place(mount.place(p));
                    assert_close(held.at(time).place(p), std::array::from_fn(|k| swung[k] + moved[k]));
                }
                let velocity = held.velocity(time);
                assert_eq!(velocity.angular, mount.turn_back(angular));
                let swing = swings.at(after).turn(cross(angular, mount.translation));
                assert_close(velocity.linear, std::array::from_fn(|k| linear[k] + swing[k]));
            }
            for time in [1.0, 1.7, 2.9, 3.0] {
                assert_eq!(held.at(time), path.at(time).then(&mount));
            }
        }
    }
}
