//! Rigid poses, sensor to world, and their change over time.

use std::sync::Arc;

use crate::arith::error_free::{two_product, two_sum};
use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::arith::turns::TurnRate;
use crate::geometry::point::{cross, dot, sub};
use crate::geometry::turn::{Turn, product, scaled, split};
use crate::geometry::vector::Point;

/// A pose or, in lanes, several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<F = f64> {
    rotation: [[F; 3]; 3],
    translation: [F; 3],
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

    /// The map from the world to the sensor frame.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Pose { rotation: IDENTITY, translation: [0.0; 3] }.relative_to(self)
    }
}

impl<F: Copy> Pose<F> {
    /// The same pose in all lanes.
    #[inline(always)]
    pub fn splat<const N: usize>(pose: &Pose) -> Self
    where
        F: Floats<f64, N>,
    {
        let [x, y, z] = pose.rotation;
        Pose {
            rotation: [lanes::splat(x), lanes::splat(y), lanes::splat(z)],
            translation: lanes::splat(pose.translation),
        }
    }

    /// The poses as an array of lanes.
    #[inline(always)]
    fn store(&self) -> Pose<[f64; 8]>
    where
        F: Floats<f64, 8>,
    {
        let [x, y, z] = self.rotation;
        Pose {
            rotation: [lanes::store(x), lanes::store(y), lanes::store(z)],
            translation: lanes::store(self.translation),
        }
    }

    /// A direction of the sensor frame in the world.
    #[inline(always)]
    pub fn turn<const N: usize>(&self, v: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        let [x, y, z] = self.rotation;
        [lanes::dot(x, v), lanes::dot(y, v), lanes::dot(z, v)]
    }

    /// A point of the sensor frame in the world.
    #[inline(always)]
    pub fn place<const N: usize>(&self, p: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        lanes::add(self.turn(p), self.translation)
    }

    /// A direction of the world in the sensor frame.
    #[inline(always)]
    pub fn turn_back<const N: usize>(&self, v: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        let [x, y, z] = self.rotation;
        [
            lanes::dot([x[0], y[0], z[0]], v),
            lanes::dot([x[1], y[1], z[1]], v),
            lanes::dot([x[2], y[2], z[2]], v),
        ]
    }

    /// A point of the world in the sensor frame.
    #[inline(always)]
    pub fn place_back<const N: usize>(&self, p: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        self.turn_back(lanes::sub(p, self.translation))
    }

    /// The world pose of a body whose pose in the frame of `self` is `inner`.
    #[inline(always)]
    pub fn then<const N: usize>(&self, inner: &Self) -> Self
    where
        F: Floats<f64, N>,
    {
        Pose { rotation: product(self.rotation, inner.rotation), translation: self.place(inner.translation) }
    }

    /// `self`, seen from the sensor frame of `base`.
    #[inline(always)]
    pub fn relative_to<const N: usize>(&self, base: &Self) -> Self
    where
        F: Floats<f64, N>,
    {
        let [x, y, z] = self.rotation;
        let columns = [
            base.turn_back([x[0], y[0], z[0]]),
            base.turn_back([x[1], y[1], z[1]]),
            base.turn_back([x[2], y[2], z[2]]),
        ];
        let [x, y, z] = columns;
        Pose {
            rotation: [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]],
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

    /// The velocity at u, of a step that takes `length` seconds; `turn`: the turn so far.
    #[inline(always)]
    fn velocity<F: Floats<f64, N>, const N: usize>(&self, u: F, turn: &Turn<F>, length: f64) -> Velocity<F> {
        let (linear, angular) = (self.shift.derivative(u), turn.rate(self.turn.derivative(u)));
        let length = F::splat(length);
        Velocity { linear: lanes::divided(linear, length), angular: lanes::divided(angular, length) }
    }
}

/// a u + b u² + c u³.
#[derive(Clone, Copy, Debug)]
pub struct Cubic(pub [Point; 3]);

impl Cubic {
    #[inline(always)]
    fn at<F: Floats<f64, N>, const N: usize>(&self, u: F) -> [F; 3] {
        let mut place = [u; 3];
        for i in 0..3 {
            let [a, b, c] = self.terms(i);
            place[i] = u.mul(F::splat(a).add(u.mul(F::splat(b).add(u.mul(F::splat(c))))));
        }
        place
    }

    #[inline(always)]
    fn derivative<F: Floats<f64, N>, const N: usize>(&self, u: F) -> [F; 3] {
        let mut rate = [u; 3];
        for i in 0..3 {
            let [a, b, c] = self.terms(i);
            let curved = u.mul(F::splat(3.0)).mul(F::splat(c));
            rate[i] = F::splat(a).add(u.mul(F::splat(2.0 * b).add(curved)));
        }
        rate
    }

    fn is_zero(&self) -> bool {
        self.0 == [[0.0; 3]; 3]
    }

    #[inline(always)]
    fn terms(&self, i: usize) -> [f64; 3] {
        let Cubic([a, b, c]) = self;
        [a[i], b[i], c[i]]
    }
}

/// Linear velocity in the world and angular velocity in the moving frame; or several, in lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity<F = f64> {
    pub linear: [F; 3],
    pub angular: [F; 3],
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
    pub fn hold(&self, until: f64) -> Path {
        let mut path = self.clone();
        match &mut path {
            Path::Still(_) | Path::Twist { .. } => {}
            Path::Knots { end, .. } => *end = end.max(until),
            Path::Mounted { body, .. } => *body = Arc::new(body.hold(until)),
        }
        path
    }

    /// The pose at a time. Past the span the motion continues at the velocities of its end.
    pub fn at(&self, time: f64) -> Pose {
        match self {
            Path::Still(pose) => *pose,
            Path::Twist { start, linear, angular, screw } => {
                let way = linear.map(|x| x * time);
                if *angular == [0.0; 3] {
                    return moved(start, IDENTITY, start.turn(way));
                }
                match Turn::of_vector(angular.map(|x| x * time)) {
                    Some(turn) => moved(start, turn.matrix(), start.turn(turn.travel(way))),
                    None => screw.at(start, time),
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
                    let turn = Turn::new(angular.map(|x| x * after));
                    return moved(&poses[i], turn.matrix(), linear.map(|x| x * after));
                }
                let i = i.min(steps.len() - 1);
                let u = (time - times[i]) / (times[i + 1] - times[i]);
                let Step { shift, turn } = &steps[i];
                let matrix = if turn.is_zero() { IDENTITY } else { Turn::new(turn.at(u)).matrix() };
                moved(&poses[i], matrix, shift.at(u))
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
            return body.motion(time).of_mounted(mount);
        }
        let pose = self.at(time);
        let velocity = match self {
            Path::Twist { linear, angular, .. } => Velocity { linear: pose.turn(*linear), angular: *angular },
            Path::Knots { times, steps, .. } if !steps.is_empty() => {
                let i = times.partition_point(|&t| t <= time).saturating_sub(1).min(steps.len() - 1);
                let length = times[i + 1] - times[i];
                let u = ((time - times[i]) / length).min(1.0);
                steps[i].velocity(u, &Turn::new(steps[i].turn.at(u)), length)
            }
            _ => Velocity { linear: [0.0; 3], angular: [0.0; 3] },
        };
        Motion { pose, velocity }
    }

    /// `motion` at eight times, with the same bits.
    #[inline(always)]
    pub fn motions<I: Isa>(&self, times: &[f64; 8]) -> Motion<[f64; 8]> {
        I::call(Motions { path: self, times })
    }

    /// `at` at eight times, with the same bits.
    #[inline(always)]
    pub fn poses<I: Isa>(&self, times: &[f64; 8]) -> Pose<[f64; 8]> {
        I::call(Poses { path: self, times })
    }

    /// `motion` in lanes; `None` if the times need different formulas.
    #[inline(always)]
    fn motion_in_lanes<I: Isa>(&self, time: I::F64x8) -> Option<Motion<I::F64x8>> {
        match self {
            Path::Mounted { body, mount } => {
                Some(body.own_motion_in_lanes::<I>(time)?.of_mounted(&Pose::splat(mount)))
            }
            path => path.own_motion_in_lanes::<I>(time),
        }
    }

    /// As `motion_in_lanes`, of a path that is not mounted.
    #[inline(always)]
    fn own_motion_in_lanes<I: Isa>(&self, time: I::F64x8) -> Option<Motion<I::F64x8>> {
        match self {
            Path::Twist { start, linear, angular, .. } => {
                let still = *angular == [0.0; 3];
                let start = Pose::splat(&if still { moved(start, IDENTITY, [0.0; 3]) } else { *start });
                let (linear, angular) = (lanes::splat(*linear), lanes::splat(*angular));
                let way = lanes::scaled(linear, time);
                let pose = if still {
                    Pose { translation: lanes::add(start.translation, start.turn(way)), ..start }
                } else {
                    let turn = Turn::of_vectors::<I>(lanes::scaled(angular, time))?;
                    moved(&start, turn.matrix(), start.turn(turn.travel(way)))
                };
                Some(Motion { pose, velocity: Velocity { linear: pose.turn(linear), angular } })
            }
            Path::Knots { times, poses, steps, .. } => {
                let earliest = time.smallest();
                let i = times.partition_point(|&t| t <= earliest).checked_sub(1)?;
                let (step, from) = (steps.get(i)?, I::F64x8::splat(times[i]));
                // The poses of the knots are as given.
                if from.lt(time) & time.lt(I::F64x8::splat(times[i + 1])) != 0xff {
                    return None;
                }
                let length = times[i + 1] - times[i];
                let u = time.sub(from).div(I::F64x8::splat(length));
                let turn = Turn::of_vectors::<I>(step.turn.at(u))?;
                let pose = moved(&Pose::splat(&poses[i]), turn.matrix(), step.shift.at(u));
                Some(Motion { pose, velocity: step.velocity(u, &turn, length) })
            }
            _ => None,
        }
    }
}

const IDENTITY: [Point; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The pose after a turn in the frame of `from`, given as a matrix, and a way in the world.
#[inline(always)]
fn moved<F: Floats<f64, N>, const N: usize>(from: &Pose<F>, turn: [[F; 3]; 3], way: [F; 3]) -> Pose<F> {
    Pose { rotation: product(from.rotation, turn), translation: lanes::add(from.translation, way) }
}

/// [`Path::motions`].
struct Motions<'a> {
    path: &'a Path,
    times: &'a [f64; 8],
}

impl Task for Motions<'_> {
    type Output = Motion<[f64; 8]>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        match self.path.motion_in_lanes::<I>(I::F64x8::load(self.times)) {
            Some(Motion { pose, velocity: Velocity { linear, angular } }) => Motion {
                pose: pose.store(),
                velocity: Velocity { linear: lanes::store(linear), angular: lanes::store(angular) },
            },
            None => Motion::gather(&self.times.map(|time| self.path.motion(time))),
        }
    }
}

/// [`Path::poses`]. The compiler removes the unused velocities.
struct Poses<'a> {
    path: &'a Path,
    times: &'a [f64; 8],
}

impl Task for Poses<'_> {
    type Output = Pose<[f64; 8]>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        match self.path.motion_in_lanes::<I>(I::F64x8::load(self.times)) {
            Some(motion) => motion.pose.store(),
            None => Pose::gather(&self.times.map(|time| self.path.at(time))),
        }
    }
}

impl Motion<[f64; 8]> {
    /// A value to start with.
    pub const UNSET: Self =
        Motion { pose: Pose::UNSET, velocity: Velocity { linear: [[0.0; 8]; 3], angular: [[0.0; 8]; 3] } };

    /// In registers.
    #[inline(always)]
    pub fn load<F: Floats<f64, 8>>(&self) -> Motion<F> {
        let Velocity { linear, angular } = &self.velocity;
        Motion {
            pose: self.pose.load(),
            velocity: Velocity { linear: lanes::part(linear, 0), angular: lanes::part(angular, 0) },
        }
    }

    /// The motion in one of the lanes.
    #[inline(always)]
    pub fn lane(&self, k: usize) -> Motion {
        let Velocity { linear, angular } = &self.velocity;
        let velocity = Velocity { linear: lane(linear, k), angular: lane(angular, k) };
        Motion { pose: self.pose.lane(k), velocity }
    }

    #[cold]
    fn gather(motions: &[Motion; 8]) -> Self {
        let mut all = Self { pose: Pose::gather(&motions.map(|motion| motion.pose)), ..Self::UNSET };
        for (k, Motion { velocity, .. }) in motions.iter().enumerate() {
            for axis in 0..3 {
                all.velocity.linear[axis][k] = velocity.linear[axis];
                all.velocity.angular[axis][k] = velocity.angular[axis];
            }
        }
        all
    }
}

impl Pose<[f64; 8]> {
    /// A value to start with.
    pub const UNSET: Self = Pose { rotation: [[[0.0; 8]; 3]; 3], translation: [[0.0; 8]; 3] };

    #[cold]
    fn gather(poses: &[Pose; 8]) -> Self {
        let mut all = Self::UNSET;
        for (k, pose) in poses.iter().enumerate() {
            for axis in 0..3 {
                for row in 0..3 {
                    all.rotation[row][axis][k] = pose.rotation[row][axis];
                }
                all.translation[axis][k] = pose.translation[axis];
            }
        }
        all
    }

    /// In registers.
    #[inline(always)]
    pub fn load<F: Floats<f64, 8>>(&self) -> Pose<F> {
        let [x, y, z] = &self.rotation;
        Pose {
            rotation: [lanes::part(x, 0), lanes::part(y, 0), lanes::part(z, 0)],
            translation: lanes::part(&self.translation, 0),
        }
    }

    /// The columns of the homogeneous matrices; the last is the translation.
    #[inline(always)]
    pub fn columns(&self) -> [[[f64; 8]; 3]; 4] {
        let [x, y, z] = self.rotation;
        [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]], self.translation]
    }

    /// The pose in one of the lanes.
    #[inline(always)]
    pub fn lane(&self, k: usize) -> Pose {
        let [x, y, z] = &self.rotation;
        Pose { rotation: [lane(x, k), lane(y, k), lane(z, k)], translation: lane(&self.translation, k) }
    }
}

/// A vector in one of the lanes.
#[inline(always)]
fn lane([x, y, z]: &[[f64; 8]; 3], k: usize) -> Point {
    [x[k], y[k], z[k]]
}

/// The pose and the velocity of a body at a time or, in lanes, at several.
#[derive(Clone, Copy, Debug)]
pub struct Motion<F = f64> {
    pub pose: Pose<F>,
    pub velocity: Velocity<F>,
}

impl<F: Copy> Motion<F> {
    /// The velocity in the world of a point of the body, given in its frame.
    #[inline(always)]
    pub fn velocity_of<const N: usize>(&self, point: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        let Velocity { linear, angular } = self.velocity;
        lanes::add(linear, self.pose.turn(lanes::cross(angular, point)))
    }

    /// The motion of what is mounted on the body.
    #[inline(always)]
    fn of_mounted<const N: usize>(&self, mount: &Pose<F>) -> Self
    where
        F: Floats<f64, N>,
    {
        let linear = self.velocity_of(mount.translation);
        let velocity = Velocity { linear, angular: mount.turn_back(self.velocity.angular) };
        Motion { pose: self.pose.then(mount), velocity }
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
        let travelled =
            std::array::from_fn(|i| advance[i] * time + (sin * across[i] + (1.0 - cos) * around[i]));
        moved(start, turn.matrix(), start.turn(travelled))
    }
}

/// a·b as accurate as if computed in twice the precision (T. Ogita, S. Rump, S. Oishi, Accurate sum and dot
/// product, 2005: Dot2).
fn accurate_dot(a: Point, b: Point) -> f64 {
    let [(x, x_off), (y, y_off), (z, z_off)] = std::array::from_fn(|i| two_product(a[i], b[i]));
    let (sum, first_off) = two_sum(x, y);
    let (sum, second_off) = two_sum(sum, z);
    sum + (((x_off + y_off) + z_off) + (first_off + second_off))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::elementary::{LARGEST_ANGLE, sin_cos};
    use crate::arith::simd::{Level, Portable, dispatch};

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

    fn bits(Motion { pose, velocity: Velocity { linear, angular } }: Motion) -> Vec<u64> {
        let numbers = [pose.rows().as_flattened(), &linear, &angular].concat();
        numbers.into_iter().map(f64::to_bits).collect()
    }

    #[test]
    fn eight_motions_have_the_bits_of_each() {
        let start = Path::twist(Pose::from_rows(ROWS), [1.0, 2.0, 3.0], [0.1, 0.2, 0.3]).at(2.0);
        let mut number = crate::testing::numbers();
        let mut three = |size: f64| [0; 3].map(|_: u8| size * (number() - 0.5));
        let mut cubic = |size: f64| Cubic([three(size), three(size), three(size)]);
        // Steps that do not turn, that turn a little, and by more than 1 rad.
        let steps: Vec<_> = [0.0, 0.5, 6.0].map(|size| Step { shift: cubic(2.0), turn: cubic(size) }).into();
        let knots = Path::Knots { times: vec![-1.0, 0.5, 1.0, 2.5], poses: vec![start; 4], steps, end: 2.5 };
        let speed = [3.0, -0.25, 0.125];
        let paths = [
            Path::Still(start),
            Path::twist(start, speed, [0.0; 3]),
            Path::twist(start, speed, [0.25, -0.125, 0.5]),
            Path::twist(start, speed, [3.0, -1.0, 2.0]),
            Path::twist(start, speed, [3e6, -1e6, 2e6]),
            knots,
        ];
        let mounted = paths.clone().map(|path| Arc::new(path).mounted(&start));
        let (mut in_lanes, mut one_by_one) = (0, 0);
        for path in paths.into_iter().chain(mounted) {
            // Times of one formula; of several: across knots, at them, and across angles of 1 rad.
            for first in [-1.0, -0.875, 0.25, 0.53125, 1.0, 1.25, 2.0] {
                for step in [0.0, 1.0 / 64.0, 1.0 / 8.0] {
                    let times = std::array::from_fn(|k| f64::min(first + step * k as f64, 2.5));
                    for level in Level::available() {
                        let motions = dispatch(level, Motions { path: &path, times: &times });
                        let poses = dispatch(level, Poses { path: &path, times: &times });
                        for (k, time) in times.into_iter().enumerate() {
                            let of_pose = Motion { pose: poses.lane(k), ..motions.lane(k) };
                            let motion = bits(path.motion(time));
                            let same = [motions.lane(k), of_pose].into_iter().all(|of| bits(of) == motion);
                            assert!(same, "{path:?} at {time}, {level:?}");
                        }
                    }
                    let alike = path.motion_in_lanes::<Portable>(times).is_some();
                    *if alike { &mut in_lanes } else { &mut one_by_one } += 1;
                }
            }
        }
        assert!(in_lanes > 80 && one_by_one > 80, "{in_lanes}, {one_by_one}");
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
        let held = path.hold(4.0);
        assert_eq!((held.span(), held.hold(2.0).span()), ([1.0, 4.0], [1.0, 4.0]));
        for time in [1.0, 1.7, 2.9, 3.0] {
            assert_eq!(held.at(time), path.at(time));
        }
        let (sin, cos) = sin_cos(2.25);
        assert_eq!(held.at(4.0).translation, [8.0, 6.0, 7.0]);
        assert_close(held.at(4.0).turn([1.0, 0.0, 0.0]), start.turn([cos, sin, 0.0]));
        let one = Path::Knots { times: vec![1.0], poses: vec![start], steps: vec![], end: 1.0 }.hold(2.0);
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
                path.hold(4.0),
                Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
            ),
            (Arc::new(path.clone()).mounted(&mount).hold(4.0), mount),
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
