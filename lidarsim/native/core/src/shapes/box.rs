//! Axis-aligned box with corners center ± size/2: the boundary of the intersection of three slabs.

use std::cmp::Ordering;

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, all_positive, parameters, roots};
use crate::arith::error_free::two_sum;
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::{Chord, Root};
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Box {
    size: Point,
    center: Point,
    /// The coordinates of the low and the high faces, if all are float64 numbers.
    faces: Option<[Point; 2]>,
}

impl Box {
    pub fn new(size: Point, center: Point) -> Self {
        let face = |axis: usize, half: f64| {
            let (sum, rest) = two_sum(center[axis], half);
            (half.abs() * 2.0 == size[axis] && rest == 0.0).then_some(sum)
        };
        let side = |sign: f64| {
            let [x, y, z] = [0, 1, 2].map(|axis| face(axis, sign * (size[axis] / 2.0)));
            Some([x?, y?, z?])
        };
        Box { size, center, faces: side(-1.0).zip(side(1.0)).map(|(low, high)| [low, high]) }
    }

    /// The distances from a ray's origin to the low and the high face across an axis, and the component of
    /// its direction, all times one positive factor. Distances to faces that are float64 numbers are rounded
    /// once, so they are certain where they are zero.
    #[inline(always)]
    fn distances<N: Number>(&self, axis: usize, ray: &Ray<N>) -> (N, N, N) {
        if let Some([low, high]) = &self.faces {
            let low = ray.weighted(N::exact(low[axis])).minus(&ray.origin[axis]);
            let high = ray.weighted(N::exact(high[axis])).minus(&ray.origin[axis]);
            return (low, high, ray.direction[axis].clone());
        }
        // Twice the distances, so that halves of the size are not rounded.
        let middle = ray.weighted(N::exact(self.center[axis])).minus(&ray.origin[axis]).doubled();
        let half = ray.weighted(N::exact(self.size[axis]));
        (middle.minus(&half), middle.plus(&half), ray.direction[axis].doubled())
    }

    /// Cuts the chord with the slab across an axis; false if nothing remains.
    #[inline(always)]
    fn cut<N: Number>(&self, axis: usize, ray: &Ray<N>, chord: &mut Chord<N>) -> Result<bool, Uncertain> {
        let (low, high, slope) = self.distances(axis, ray);
        let (face, opposite) = (2 * axis as u8, 2 * axis as u8 + 1);
        let (entry, exit) = match slope.sign()? {
            Ordering::Greater => {
                (Root::linear(low, slope.clone(), face), Root::linear(high, slope, opposite))
            }
            Ordering::Less => {
                let slope = slope.negated();
                let entry = Root::linear(high.negated(), slope.clone(), opposite);
                (entry, Root::linear(low.negated(), slope, face))
            }
            Ordering::Equal => {
                return Ok(low.sign()? != Ordering::Greater && high.sign()? != Ordering::Less);
            }
        };
        chord.cut(entry, exit)?;
        Ok(true)
    }
}

impl Shape for Box {
    const MOST_ROOTS: usize = 2;

    const FORMS: &'static [Form] = &[&[("size", 3), ("center", 3)]];

    fn from_numbers(_: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let [dx, dy, dz, x, y, z] = parameters(numbers)?;
        let size = [dx, dy, dz];
        all_positive("size", &size)?;
        Ok(Box::new(size, [x, y, z]))
    }
}

impl Surface for Box {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let mut chord = Chord::whole_line();
        if self.cut(0, ray, &mut chord)? && self.cut(1, ray, &mut chord)? && self.cut(2, ray, &mut chord)? {
            Ok(roots(chord.roots()?))
        } else {
            Ok(roots([None, None]))
        }
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
        let axis = usize::from(feature / 2);
        let from_middle = ray.origin[axis].minus(&ray.weighted(N::exact(self.center[axis]))).doubled();
        let outward = if feature.is_multiple_of(2) { from_middle.negated() } else { from_middle };
        outward.minus(&ray.weighted(N::exact(self.size[axis])))
    }

    #[inline(always)]
    fn normal<N: Number>(&self, _: &Ray<N>, feature: u8) -> Vector<N> {
        let mut normal = [0.0; 3];
        normal[usize::from(feature / 2)] = if feature.is_multiple_of(2) { -1.0 } else { 1.0 };
        vector::exact(normal)
    }

    fn axis_plane(&self, feature: u8) -> Option<AxisPlane> {
        let axis = usize::from(feature / 2);
        let half = self.size[axis] / 2.0;
        if 2.0 * half != self.size[axis] {
            return None;
        }
        AxisPlane::at(axis, self.center[axis], if feature.is_multiple_of(2) { -half } else { half })
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        Some(std::array::from_fn(|i| {
            let half = self.size[i] / 2.0; // rounds if the size is subnormal
            Interval {
                low: (self.center[i] - half.next_up()).next_down(),
                high: (self.center[i] + half.next_up()).next_up(),
            }
        }))
    }
}
