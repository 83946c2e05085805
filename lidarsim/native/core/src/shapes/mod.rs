//! The shapes: their mathematics, one file per shape.
//!
//! To add one, write its file with its [`Surface`] and [`Shape`], and add its name to `mod`, `pub use` and
//! `surfaces!` below.

mod r#box;
mod capsule;
mod cylinder;
mod disk;
mod disks;
mod each;
mod ellipsoid;
pub(crate) mod newton;
mod plane;
mod polygon;
mod sphere;
mod spheres;
mod surface;
pub(crate) mod triangle;

pub use r#box::Box;
pub use capsule::Capsule;
pub use cylinder::Cylinder;
pub use disk::Disk;
pub(crate) use each::{Each, EachCrossings, EachOf, EachRay};
pub use ellipsoid::Ellipsoid;
pub use plane::Plane;
pub use polygon::self_crossing;
pub use sphere::Sphere;
pub use surface::{Form, IllegalArgument, Roots, Shape, Surface, SurfaceTask};
pub use triangle::Triangle;

use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Root;
use crate::arith::simd::{Floats, Isa, LaneTask};
use crate::geometry::axis_plane::AxisPlane;
use crate::geometry::ray::Ray;
use crate::geometry::vector::Vector;

struct On<'a, S, T>(&'a S, T);

impl<S: Surface, T: SurfaceTask> LaneTask for On<'_, S, T> {
    type Output = T::Output;

    #[inline(always)]
    fn run<F: Floats<f64, N>, const N: usize>(self) -> T::Output {
        self.1.run::<F, S, N>(self.0)
    }
}

macro_rules! surfaces {
    ($($name:ident),+ $(,)?) => {
        /// Any of the implicit surfaces.
        #[derive(Clone, Debug, PartialEq)]
        pub enum AnySurface {
            $($name($name)),+
        }

        $(impl From<$name> for AnySurface {
            fn from(shape: $name) -> Self {
                AnySurface::$name(shape)
            }
        })+

        impl AnySurface {
            /// Creates the shape with this name; see [`Shape::from_numbers`].
            pub fn new(name: &str, form: usize, numbers: &[f64]) -> Result<Self, IllegalArgument> {
                match name {
                    $(stringify!($name) => {
                        <$name as Shape>::from_numbers(form, numbers).map(AnySurface::$name)
                    })+
                    _ => Err(IllegalArgument::new("shape", "a shape of lidarsim", name)),
                }
            }

            /// The forms of the shape with this name; empty if there is no such shape.
            pub fn forms(name: &str) -> &'static [Form] {
                match name {
                    $(stringify!($name) => <$name as Shape>::FORMS,)+
                    _ => &[],
                }
            }

            /// Most roots on a line.
            pub fn most_roots(&self) -> usize {
                match self { $(AnySurface::$name(_) => <$name as Shape>::MOST_ROOTS),+ }
            }

            /// Runs the task in a separate function for each type of shape, which keeps these functions
            /// small; see `Isa::call_widest`.
            #[inline(always)]
            pub fn dispatch<I: Isa, T: SurfaceTask>(&self, task: T) -> Option<T::Output> {
                match self { $(AnySurface::$name(shape) => I::call_widest(On(shape, task))),+ }
            }
        }

        /// The most roots that a line has on any surface.
        pub const MOST_ROOTS: usize = {
            let mut most = 0;
            $(if most < <$name as Shape>::MOST_ROOTS {
                most = <$name as Shape>::MOST_ROOTS;
            })+
            most
        };

        impl Surface for AnySurface {
            fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
                match self { $(AnySurface::$name(shape) => shape.roots(ray)),+ }
            }

            fn touching<N: Number>(&self, ray: &Ray<N>) -> Option<Root<N>> {
                match self { $(AnySurface::$name(shape) => shape.touching(ray)),+ }
            }

            fn only_root<N: Number>(&self, ray: &Ray<N>) -> Option<Result<Root<N>, Uncertain>> {
                match self { $(AnySurface::$name(shape) => shape.only_root(ray)),+ }
            }

            fn implicit<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
                match self { $(AnySurface::$name(shape) => shape.implicit(ray, feature)),+ }
            }

            fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N> {
                match self { $(AnySurface::$name(shape) => shape.normal(ray, feature)),+ }
            }

            fn axis_plane(&self, feature: u8) -> Option<AxisPlane> {
                match self { $(AnySurface::$name(shape) => shape.axis_plane(feature)),+ }
            }

            fn bounds(&self) -> Option<[Interval; 3]> {
                match self { $(AnySurface::$name(shape) => shape.bounds()),+ }
            }
        }
    };
}

surfaces!(Box, Capsule, Cylinder, Disk, Ellipsoid, Plane, Sphere, Triangle);

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;
    use crate::arith::number::Dyadic;
    use crate::geometry::vector::{self, Point};
    use crate::testing::numbers;

    /// Whether a box reaches as far below and above two coordinates as the root of a ratio.
    fn reaches(side: &Interval, [low, high]: [f64; 2], num: &Dyadic, den: &Dyadic) -> bool {
        let beyond = |x: Dyadic| {
            let far = x.squared().times(den).minus(num).sign() != Ok(Ordering::Less);
            x.sign() != Ok(Ordering::Less) && far
        };
        let n = Dyadic::exact;
        beyond(n(low).minus(&n(side.low))) && beyond(n(side.high).minus(&n(high)))
    }

    /// Compares with exact arithmetic, for numbers far from the origin, subnormal or huge.
    #[test]
    fn boxes_hold_the_surfaces() {
        let mut next = numbers();
        let mut checked = 0;
        for round in 0..4000 {
            let scale = [1.0, 1e-9, 1e-160, 1e-310, 1e-322, 1e150][round % 6];
            let place = [0.0, scale, 1e6 * scale][round % 3];
            let mut point = |place: f64, scale: f64| -> Point {
                [0; 3].map(|_: u8| place + scale * (2.0 * next() - 1.0))
            };
            let (center, end, size) =
                (point(place, scale), point(place, scale), point(0.0, scale).map(f64::abs));
            let rotation = [0; 3].map(|_: u8| point(0.0, 1.0));
            if size.contains(&0.0) || center == end {
                continue;
            }
            let radius = size[0];
            let axis = vector::sub(&vector::exact::<Dyadic>(end), &vector::exact(center));
            let (length2, one) = (vector::norm2(&axis), Dyadic::exact(1.0));
            let normal = vector::exact::<Dyadic>(rotation[0]);
            let normal2 = vector::norm2(&normal);
            let ellipsoid = Ellipsoid::new(center, size, rotation).and_then(|ellipsoid| ellipsoid.bounds());
            let bounds = [
                Sphere { center, radius }.bounds(),
                Box::new(size, center).bounds(),
                Cylinder { start: center, end, radius, capped: false }.bounds(),
                ellipsoid,
                Capsule { start: center, end, radius }.bounds(),
                Disk { center, normal: rotation[0], radius }.bounds(),
            ];
            for i in 0..3 {
                let (square, middle) = (Dyadic::exact(radius).squared(), [center[i]; 2]);
                let across = square.times(&length2.minus(&axis[i].squared()));
                let beside = square.times(&normal2.minus(&normal[i].squared()));
                let row = [0, 1, 2].map(|j| Dyadic::exact(rotation[i][j]).times(&Dyadic::exact(size[j])));
                let ends = [center[i].min(end[i]), center[i].max(end[i])];
                for (bounds, ends, num, den) in [
                    (&bounds[0], middle, square.clone(), &one),
                    (&bounds[1], middle, Dyadic::exact(size[i]).squared(), &Dyadic::exact(4.0)),
                    (&bounds[2], ends, across, &length2),
                    (&bounds[3], middle, vector::norm2(&row), &one),
                    (&bounds[4], ends, square.clone(), &one),
                    (&bounds[5], middle, beside, &normal2),
                ] {
                    let Some(bounds) = bounds else { continue };
                    assert!(
                        reaches(&bounds[i], ends, &num, den),
                        "{center:?} {end:?} {size:?} {rotation:?}: {bounds:?}"
                    );
                    checked += 1;
                }
            }
        }
        assert!(checked > 30_000, "{checked}");
    }
}
