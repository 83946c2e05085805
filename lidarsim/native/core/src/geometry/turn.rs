//! Rotations by rotation vectors.

use crate::arith::elementary::{LARGEST_ANGLE, RECIPROCAL_FACTORIALS, sin_cos};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::arith::turns;
use crate::geometry::point::dot;
use crate::geometry::vector::Point;

/// A rotation by θ, as a vector and the factors of its exponential and its Jacobian (T. D. Barfoot, State
/// Estimation for Robotics, 2017, ch. 7), or several in lanes.
///
/// For a rotation vector φ these are a = sin θ/θ, b = (1 − cos θ)/θ², c = (θ − sin θ)/θ³, θ =
/// |φ|. For a large angle, whose square may overflow, the vector is φ/θ, and the factors are multiplied by
/// θ or θ² accordingly.
pub(super) struct Turn<F = f64> {
    pub(super) vector: [F; 3],
    /// a and b.
    pub(super) rotation: [F; 2],
    /// b and c.
    pub(super) travel: [F; 2],
}

impl Turn {
    pub(super) fn new(vector: Point) -> Self {
        Self::of_vector(vector).unwrap_or_else(|| {
            let (vector, angle) = split(vector);
            let (sin, cos) = turns::sin_cos(angle);
            Turn { vector, rotation: [sin, 1.0 - cos], travel: [(1.0 - cos) / angle, (angle - sin) / angle] }
        })
    }

    /// `None` if the angle is beyond [`LARGEST_ANGLE`].
    #[inline]
    pub(super) fn of_vector(vector: Point) -> Option<Self> {
        let square = dot(vector, vector);
        let angle = square.sqrt();
        if angle <= 1.0 {
            Some(Self::small(vector, square))
        } else if angle <= LARGEST_ANGLE {
            let (sin, cos) = sin_cos(angle);
            Some(Self::large(vector, square, angle, [sin, cos]))
        } else {
            None
        }
    }
}

impl<F: Copy> Turn<F> {
    /// As [`Turn::of_vector`], in lanes; `None` if they need different formulas, too.
    #[inline(always)]
    pub(super) fn of_vectors<I: Isa<F64x8 = F>>(vector: [F; 3]) -> Option<Self>
    where
        F: Floats<f64, 8>,
    {
        let square = lanes::dot(vector, vector);
        let angle = square.sqrt();
        let (one, largest) = (F::splat(1.0), F::splat(LARGEST_ANGLE));
        if angle.le(one) == 0xff {
            Some(Self::small(vector, square))
        } else if angle.le(largest) == 0xff && angle.le(one) == 0 {
            let (angles, mut sines, mut cosines) = (angle.store(), [0.0; 8], [0.0; 8]);
            for k in 0..8 {
                (sines[k], cosines[k]) = sin_cos(angles[k]);
            }
            Some(Self::large(vector, square, angle, [F::load(&sines), F::load(&cosines)]))
        } else {
            None
        }
    }

    /// By an angle up to 1, at which the quotients would cancel: 1/1! − θ²/3! + …, 1/2! − θ²/4! +
    /// …, 1/3! − θ²/5! + …
    #[inline(always)]
    fn small<const N: usize>(vector: [F; 3], square: F) -> Self
    where
        F: Floats<f64, N>,
    {
        let x = square.negated();
        let mut sums = [F::splat(0.0); 3];
        for i in (0..9).rev() {
            for first in 0..3 {
                sums[first] = sums[first].mul(x).add(F::splat(RECIPROCAL_FACTORIALS[1 + first + 2 * i]));
            }
        }
        let [a, b, c] = sums;
        Turn { vector, rotation: [a, b], travel: [b, c] }
    }

    #[inline(always)]
    fn large<const N: usize>(vector: [F; 3], square: F, angle: F, [sin, cos]: [F; 2]) -> Self
    where
        F: Floats<f64, N>,
    {
        let b = F::splat(1.0).sub(cos).div(square);
        let c = angle.sub(sin).div(square.mul(angle));
        Turn { vector, rotation: [sin.div(angle), b], travel: [b, c] }
    }

    /// I + a[φ] + b[φ]².
    #[inline(always)]
    pub(super) fn matrix<const N: usize>(&self) -> [[F; 3]; 3]
    where
        F: Floats<f64, N>,
    {
        let [x, y, z] = [
            self.series(lanes::splat([1.0, 0.0, 0.0]), self.rotation),
            self.series(lanes::splat([0.0, 1.0, 0.0]), self.rotation),
            self.series(lanes::splat([0.0, 0.0, 1.0]), self.rotation),
        ];
        [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
    }

    /// The displacement by a velocity that is constant in the turning frame: (I + b[φ] + c[φ]²)·v.
    #[inline(always)]
    pub(super) fn travel<const N: usize>(&self, v: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        self.series(v, self.travel)
    }

    /// The angular velocity in the turned frame while the vector changes at `derivative`: (I − b[φ] +
    /// c[φ]²)·φ̇.
    #[inline(always)]
    pub(super) fn rate<const N: usize>(&self, derivative: [F; 3]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        self.series(derivative, [self.travel[0].negated(), self.travel[1]])
    }

    #[inline(always)]
    fn series<const N: usize>(&self, v: [F; 3], [first, second]: [F; 2]) -> [F; 3]
    where
        F: Floats<f64, N>,
    {
        let once = lanes::cross(self.vector, v);
        let twice = lanes::cross(self.vector, once);
        [
            v[0].add(first.mul(once[0])).add(second.mul(twice[0])),
            v[1].add(first.mul(once[1])).add(second.mul(twice[1])),
            v[2].add(first.mul(once[2])).add(second.mul(twice[2])),
        ]
    }
}

/// The unit vector along v, and |v|, to within 3u.
pub(super) fn split(v: Point) -> (Point, f64) {
    let (v, power) = scaled(v);
    let length = dot(v, v).sqrt();
    (v.map(|x| x / length), length * power)
}

/// v/2ᵏ and 2ᵏ; the largest coordinate of v is one to two times 2ᵏ.
pub(super) fn scaled(v: Point) -> (Point, f64) {
    let largest = v.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs()));
    let power = f64::from_bits(largest.to_bits() & 0x7ff << 52);
    (v.map(|x| x / power), power)
}

/// The product of two matrices, given by rows.
#[inline(always)]
pub(super) fn product<F: Floats<f64, N>, const N: usize>(a: [[F; 3]; 3], b: [[F; 3]; 3]) -> [[F; 3]; 3] {
    let columns = [[b[0][0], b[1][0], b[2][0]], [b[0][1], b[1][1], b[2][1]], [b[0][2], b[1][2], b[2][2]]];
    [row(a[0], columns), row(a[1], columns), row(a[2], columns)]
}

#[inline(always)]
fn row<F: Floats<f64, N>, const N: usize>(a: [F; 3], columns: [[F; 3]; 3]) -> [F; 3] {
    [lanes::dot(a, columns[0]), lanes::dot(a, columns[1]), lanes::dot(a, columns[2])]
}
