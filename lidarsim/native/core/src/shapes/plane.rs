//! Plane: t = n·(p − o)/(n·d).
//!
//! The plane keeps the numbers it was made from: the point form stays accurate far from the origin of
//! coordinates, where n·p rounded once has already moved the plane.

use super::surface::{Form, IllegalArgument, Roots, Shape, Surface, parameters, roots};
use super::triangle::{Triangle, triangle_normal};
use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::ray::Ray;
use crate::geometry::vector::{self, Point, Vector};

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Plane {
    /// normal·x = distance.
    Distance { normal: Point, distance: f64 },
    /// normal·(x − point) = 0.
    PointNormal { point: Point, normal: Point },
    /// Through a, b, c, with the normal (b − a) × (c − a), which is not rounded.
    Points(Point, Point, Point),
}

impl Plane {
    #[inline(always)]
    fn normal_of<N: Number>(&self) -> Vector<N> {
        match *self {
            Plane::Distance { normal, .. } | Plane::PointNormal { normal, .. } => vector::exact(normal),
            Plane::Points(a, b, c) => triangle_normal(a, b, c),
        }
    }

    /// The only axis along which the normal is not zero.
    #[inline(always)]
    fn axis(&self) -> Option<usize> {
        let (Plane::Distance { normal, .. } | Plane::PointNormal { normal, .. }) = *self else { return None };
        match normal.map(|x| x != 0.0) {
            [true, false, false] => Some(0),
            [false, true, false] => Some(1),
            [false, false, true] => Some(2),
            _ => None,
        }
    }

    /// As `height` and the slope, where the normal is zero along the other axes.
    #[inline(always)]
    fn along_axis<N: Number, const AXIS: usize>(&self, ray: &Ray<N>) -> (N, N) {
        let (o, d) = (&ray.origin[AXIS], &ray.direction[AXIS]);
        match *self {
            Plane::Distance { normal, distance } => {
                let n = N::exact(normal[AXIS]);
                (n.times(o).minus(&ray.weighted(N::exact(distance))), n.times(d))
            }
            Plane::PointNormal { point, normal } => {
                let n = N::exact(normal[AXIS]);
                (n.times(&o.minus(&ray.weighted(N::exact(point[AXIS])))), n.times(d))
            }
            Plane::Points(..) => (self.height(ray), vector::dot(&self.normal_of(), &ray.direction)),
        }
    }

    /// Of the origin over the plane, times the length of the normal.
    #[inline(always)]
    fn height<N: Number>(&self, ray: &Ray<N>) -> N {
        match *self {
            Plane::Distance { distance, .. } => {
                vector::dot(&self.normal_of(), &ray.origin).minus(&ray.weighted(N::exact(distance)))
            }
            Plane::PointNormal { point, .. } | Plane::Points(point, ..) => {
                vector::dot(&self.normal_of(), &ray.origin_from(vector::exact(point)))
            }
        }
    }
}

impl Shape for Plane {
    const MOST_ROOTS: usize = 1;

    const FORMS: &'static [Form] =
        &[&[("normal", 3), ("distance", 1)], &[("point", 3), ("normal", 3)], Triangle::FORMS[0]];

    fn from_numbers(form: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
        let plane = match form {
            0 => {
                let [x, y, z, distance] = parameters(numbers)?;
                Plane::Distance { normal: [x, y, z], distance }
            }
            1 => {
                let [a, b, c, x, y, z] = parameters(numbers)?;
                Plane::PointNormal { point: [a, b, c], normal: [x, y, z] }
            }
            _ => return Triangle::from_numbers(0, numbers).map(|Triangle(a, b, c)| Plane::Points(a, b, c)),
        };
        match plane {
            Plane::Distance { normal: [0.0, 0.0, 0.0], .. }
            | Plane::PointNormal { normal: [0.0, 0.0, 0.0], .. } => {
                Err(IllegalArgument::new("normal", "non-zero vectors", "normal = (0, 0, 0)"))
            }
            plane => Ok(plane),
        }
    }
}

impl Surface for Plane {
    #[inline(always)]
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
        let (height, slope) = match self.axis() {
            Some(0) => self.along_axis::<N, 0>(ray),
            Some(1) => self.along_axis::<N, 1>(ray),
            Some(_) => self.along_axis::<N, 2>(ray),
            None => (self.height(ray), vector::dot(&self.normal_of(), &ray.direction)),
        };
        Ok(roots([Root::ratio(height.negated(), slope, 0)?, None]))
    }

    #[inline(always)]
    fn implicit<N: Number>(&self, ray: &Ray<N>, _: u8) -> N {
        self.height(ray).doubled()
    }

    #[inline(always)]
    fn normal<N: Number>(&self, _: &Ray<N>, _: u8) -> Vector<N> {
        self.normal_of()
    }

    fn axis_plane(&self, feature: u8) -> Option<AxisPlane> {
        match *self {
            Plane::Distance { normal, distance } => {
                let axis = self.axis()?;
                AxisPlane::at_ratio(axis, distance, normal[axis])
            }
            Plane::PointNormal { point, .. } => {
                let axis = self.axis()?;
                AxisPlane::at(axis, point[axis], 0.0)
            }
            Plane::Points(a, b, c) => Triangle(a, b, c).axis_plane(feature),
        }
    }

    fn bounds(&self) -> Option<[Interval; 3]> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::newton::tests::share;
    use crate::testing::{assert_slack, worst};

    /// The slope does not vary, so that the error of a step from nearby is that of F.
    #[test]
    fn newton_steps_are_as_near_as_their_bounds_say() {
        let draw = |_: usize, next: &mut dyn FnMut() -> f64| next();
        let of_plane = |&[x, y, z, a, b]: &[f64; 5]| {
            let plane = Plane::Distance { normal: [1.0 + a, b, 0.5], distance: a };
            share(&plane, [[-1e8 * (1.0 + x), 1e8 * y, 1e8 * z], [1.0, -b, a]], 0.5, 0.0)
        };
        assert_slack("step", worst(8, 2000, draw, of_plane).0, 0.311);
    }
}
