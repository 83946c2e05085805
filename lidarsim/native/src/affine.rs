//! Affine maps, object to world, whose inverse is never rounded.

use std::cmp::Ordering;

use crate::number::{Dyadic, Interval, Number, Uncertain};
use crate::ray::Ray;
use crate::vector::{self, Point, Vector};

/// x ↦ linear·x + offset, with rows `linear[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    linear: [[f64; 3]; 3],
    offset: Point,
}

impl Affine {
    /// None if the map cannot be inverted: the determinant is zero, exactly.
    pub fn new(linear: [[f64; 3]; 3], offset: Point) -> Option<Self> {
        let map = Affine { linear, offset };
        let determinant: Dyadic = Adjugate::of(&map).determinant;
        match determinant.sign() {
            Ok(Ordering::Equal) | Err(Uncertain) => None,
            Ok(_) => Some(map),
        }
    }

    /// The rows of `matrix` are those of a 4×4 homogeneous matrix, the last of which is (0, 0, 0, 1).
    pub fn from_rows(m: [[f64; 4]; 3]) -> Option<Self> {
        Affine::new(m.map(|r| [r[0], r[1], r[2]]), [m[0][3], m[1][3], m[2][3]])
    }

    pub fn is_identity(&self) -> bool {
        *self == Affine { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], offset: [0.0; 3] }
    }

    /// The image of a point, rounded.
    pub fn place(&self, p: Point) -> Point {
        std::array::from_fn(|i| {
            let [a, b, c] = self.linear[i];
            a * p[0] + b * p[1] + c * p[2] + self.offset[i]
        })
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

/// The inverse of an affine map without its division: linear⁻¹ = adjugate/determinant.
#[derive(Clone, Debug)]
pub struct Adjugate<N> {
    rows: [Vector<N>; 3],
    offset: Vector<N>,
    /// Positive, after a change of all signs if need be.
    determinant: N,
    reflects: bool,
}

impl<N: Number> Adjugate<N> {
    fn of(map: &Affine) -> Self {
        let [r0, r1, r2]: [Vector<N>; 3] = map.linear.map(vector::exact);
        // The columns of the adjugate are the cross products of the rows.
        let [c0, c1, c2] = [vector::cross(&r1, &r2), vector::cross(&r2, &r0), vector::cross(&r0, &r1)];
        let determinant = vector::dot(&r0, &c0);
        let rows = std::array::from_fn(|i| [c0[i].clone(), c1[i].clone(), c2[i].clone()]);
        Adjugate { rows, offset: vector::exact(map.offset), determinant, reflects: false }
    }

    pub fn new(map: &Affine) -> Result<Self, Uncertain> {
        let mut inverse = Self::of(map);
        if inverse.determinant.sign()? == Ordering::Less {
            inverse.rows = inverse.rows.each_ref().map(vector::negated);
            inverse.determinant = inverse.determinant.negated();
            inverse.reflects = true;
        }
        Ok(inverse)
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

    /// A normal of the object in world coordinates, times a positive number: linear⁻ᵀ·normal. With the signs of the rows
    /// changed for a reflection, they are the inverse times |determinant|, and outward stays outward.
    pub fn normal(&self, n: &Vector<N>) -> Vector<N> {
        std::array::from_fn(|i| {
            self.rows[0][i].times(&n[0]).plus(&self.rows[1][i].times(&n[1])).plus(&self.rows[2][i].times(&n[2]))
        })
    }
}
