//! A line in the coordinates of a shape.

use crate::number::{Interval, Number, Uncertain};
use crate::vector::{self, Point, Vector};

/// The line (origin + t·direction)/weight, weight > 0; a weight of none is 1.
///
/// With a common denominator kept aside, an inverse affine map needs no division, and stays exact.
#[derive(Clone, Debug)]
pub struct Ray<N> {
    pub origin: Vector<N>,
    pub direction: Vector<N>,
    pub weight: Option<N>,
}

impl<N: Number> Ray<N> {
    #[inline(always)]
    pub fn new(origin: Point, direction: Point) -> Self {
        Ray { origin: vector::exact(origin), direction: vector::exact(direction), weight: None }
    }

    /// The same line, begun at t.
    #[inline(always)]
    pub fn at(&self, t: &N) -> Self {
        let origin = vector::add(&self.origin, &vector::scaled(&self.direction, t));
        Ray { origin, direction: self.direction.clone(), weight: self.weight.clone() }
    }

    /// `x` times the weight.
    #[inline(always)]
    pub fn weighted(&self, x: N) -> N {
        match &self.weight {
            None => x,
            Some(w) => x.times(w),
        }
    }

    /// The vector from `point` to the origin, times the weight.
    #[inline(always)]
    pub fn origin_from(&self, point: Vector<N>) -> Vector<N> {
        let [x, y, z] = point;
        vector::sub(&self.origin, &[self.weighted(x), self.weighted(y), self.weighted(z)])
    }

    /// Bounds of origin/weight and direction/weight, an axis each.
    pub fn enclose(&self) -> Result<([Interval; 3], [Interval; 3]), Uncertain>
    where
        N: Number<Floats = f64>,
    {
        let axis = |x: &N| {
            let weight = self.weight.clone().unwrap_or(N::exact(1.0));
            match crate::root::Root::ratio(x.clone(), weight, 0)? {
                Some(root) => N::enclose(&root),
                None => Err(Uncertain),
            }
        };
        let [o, d] = [&self.origin, &self.direction];
        Ok(([axis(&o[0])?, axis(&o[1])?, axis(&o[2])?], [axis(&d[0])?, axis(&d[1])?, axis(&d[2])?]))
    }
}
