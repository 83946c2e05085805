//! Affine maps, object to world, whose inverse is never rounded.

use std::cmp::Ordering;

use crate::number::{Ball, DdBall, Dyadic, Interval, Number, Uncertain};
use crate::ray::Ray;
use crate::vector::{self, Point, Vector};

/// x ↦ linear·x + offset, with rows `linear[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    linear: [[f64; 3]; 3],
    offset: Point,
}

impl Affine {
    /// From the upper rows of a 4×4 homogeneous matrix.
    pub fn from_rows(m: [[f64; 4]; 3]) -> Self {
        Affine { linear: m.map(|r| [r[0], r[1], r[2]]), offset: [m[0][3], m[1][3], m[2][3]] }
    }

    pub fn new(linear: [[f64; 3]; 3], offset: Point) -> Self {
        Affine { linear, offset }
    }

    pub fn is_identity(&self) -> bool {
        *self == Affine::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0; 3])
    }

    /// The image of a box, rounded outward.
    pub fn image(&self, bounds: [Interval; 3]) -> [Interval; 3] {
        std::array::from_fn(|i| {
            let mut low = self.offset[i];
            let mut high = self.offset[i];
            for j in 0..3 {
                let m = self.linear[i][j];
                let (a, b) = if m == 0.0 { (0.0, 0.0) } else { (m * bounds[j].low, m * bounds[j].high) };
                low = (low + a.min(b).next_down()).next_down();
                high = (high + a.max(b).next_up()).next_up();
            }
            Interval { low, high }
        })
    }
}

/// The inverse of an affine map, in each kind of [`Number`].
#[derive(Clone, Debug)]
pub struct Inverse {
    pub ball: Adjugate<Ball>,
    pub dd: Adjugate<DdBall>,
    pub dyadic: Adjugate<Dyadic>,
}

impl Inverse {
    /// None if there is none: the determinant is zero, exactly.
    pub fn of(map: &Affine) -> Option<Self> {
        let dyadic = Adjugate::<Dyadic>::of(map, false);
        let reflects = match dyadic.determinant.sign() {
            Ok(Ordering::Less) => true,
            Ok(Ordering::Greater) => false,
            Ok(Ordering::Equal) | Err(Uncertain) => return None,
        };
        Some(Inverse {
            ball: Adjugate::of(map, reflects),
            dd: Adjugate::of(map, reflects),
            dyadic: Adjugate::of(map, reflects),
        })
    }
}

/// The inverse of an affine map without its division: linear⁻¹ = adjugate/determinant. The signs of both are changed where the
/// determinant is negative.
#[derive(Clone, Debug)]
pub struct Adjugate<N> {
    rows: [Vector<N>; 3],
    offset: Vector<N>,
    determinant: N,
}

impl<N: Number> Adjugate<N> {
    fn of(map: &Affine, negate: bool) -> Self {
        let [r0, r1, r2]: [Vector<N>; 3] = map.linear.map(vector::exact);
        // The columns of the adjugate are the cross products of the rows.
        let [c0, c1, c2] = [vector::cross(&r1, &r2), vector::cross(&r2, &r0), vector::cross(&r0, &r1)];
        let determinant = vector::dot(&r0, &c0);
        let rows: [Vector<N>; 3] = std::array::from_fn(|i| [c0[i].clone(), c1[i].clone(), c2[i].clone()]);
        let offset = vector::exact(map.offset);
        if negate {
            let rows = rows.each_ref().map(vector::negated);
            Adjugate { rows, offset, determinant: determinant.negated() }
        } else {
            Adjugate { rows, offset, determinant }
        }
    }

    /// A world ray in the coordinates of the object.
    pub fn apply(&self, ray: &Ray<N>) -> Ray<N> {
        let times = |v: &Vector<N>| std::array::from_fn(|i| vector::dot(&self.rows[i], v));
        let weight = match &ray.weight {
            None => self.determinant.clone(),
            Some(w) => w.times(&self.determinant),
        };
        Ray {
            origin: times(&ray.origin_from(self.offset.clone())),
            direction: times(&ray.direction),
            weight: Some(weight),
        }
    }

    /// A normal of the object in world coordinates, times a positive number: linear⁻ᵀ·normal. The rows are those of the inverse
    /// times |determinant|, so that outward stays outward through a reflection.
    pub fn normal(&self, n: &Vector<N>) -> Vector<N> {
        std::array::from_fn(|i| {
            self.rows[0][i].times(&n[0]).plus(&self.rows[1][i].times(&n[1])).plus(&self.rows[2][i].times(&n[2]))
        })
    }
}
