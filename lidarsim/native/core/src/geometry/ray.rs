//! A line in the coordinates of a shape.

use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::vector::{self, Point, Vector};

/// Bounds of a vector, by axis.
pub type Bounds<F> = [Interval<F>; 3];

/// The box around two boxes.
pub fn union(a: Bounds<f64>, b: Bounds<f64>) -> Bounds<f64> {
    std::array::from_fn(|i| Interval { low: a[i].low.min(b[i].low), high: a[i].high.max(b[i].high) })
}

/// The line (origin + t·direction)/weight, weight > 0; without a weight, it is 1.
///
/// The separate common denominator lets an inverse affine map avoid division and stay exact.
#[derive(Clone, Debug)]
pub struct Ray<N> {
    pub origin: Vector<N>,
    pub direction: Vector<N>,
    pub weight: Option<N>,
}

impl<N: Number> Ray<N> {
    /// The same line in another kind of number.
    #[inline(always)]
    pub fn from<M>(ray: &Ray<M>) -> Self
    where
        N: for<'a> From<&'a M>,
    {
        let ([x, y, z], [u, v, w]) = (&ray.origin, &ray.direction);
        Ray {
            origin: [N::from(x), N::from(y), N::from(z)],
            direction: [N::from(u), N::from(v), N::from(w)],
            weight: match &ray.weight {
                None => None,
                Some(weight) => Some(N::from(weight)),
            },
        }
    }

    #[inline(always)]
    pub fn new(origin: Point, direction: Point) -> Self {
        Ray { origin: vector::exact(origin), direction: vector::exact(direction), weight: None }
    }

    /// The same line, starting at t.
    #[inline(always)]
    pub fn at(&self, t: &N) -> Self {
        let origin = vector::add(&self.origin, &vector::scaled(&self.direction, t));
        // The clone of an array is not inlined.
        let [x, y, z] = &self.direction;
        Ray { origin, direction: [x.clone(), y.clone(), z.clone()], weight: self.weight.clone() }
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

    /// Bounds of origin/weight and direction/weight.
    #[inline(always)]
    pub fn enclose(&self) -> Result<[Bounds<N::Floats>; 2], Uncertain> {
        Ok([self.enclose_vector(&self.origin)?, self.enclose_vector(&self.direction)?])
    }

    #[inline(always)]
    fn enclose_vector(&self, [x, y, z]: &Vector<N>) -> Result<Bounds<N::Floats>, Uncertain> {
        Ok([self.enclose_number(x)?, self.enclose_number(y)?, self.enclose_number(z)?])
    }

    #[inline(always)]
    fn enclose_number(&self, x: &N) -> Result<Interval<N::Floats>, Uncertain> {
        let weight = match &self.weight {
            None => N::exact(1.0),
            Some(weight) => weight.clone(),
        };
        // The weight is positive.
        N::enclose(&Root::linear(x.clone(), weight, 0))
    }
}
