//! The shapes: their mathematics, one file each.
//!
//! To add one: write its file with its [`Surface`] and [`Shape`], and name it in `mod`, `pub use` and `surfaces!` below.

mod r#box;
mod cylinder;
mod ellipsoid;
pub(crate) mod newton;
mod plane;
mod polygon;
mod sphere;
mod surface;
pub(crate) mod triangle;

pub use r#box::Box;
pub use cylinder::Cylinder;
pub use ellipsoid::Ellipsoid;
pub use plane::Plane;
pub use polygon::self_crossing;
pub use sphere::Sphere;
pub use surface::{Shape, Surface, SurfaceTask};
pub use triangle::Triangle;

use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Roots;
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
            /// The shape of this name and these parameters; see [`Shape::from_numbers`].
            pub fn new(name: &str, numbers: &[f64]) -> Result<Self, String> {
                match name {
                    $(stringify!($name) => <$name as Shape>::from_numbers(numbers).map(AnySurface::$name),)+
                    _ => Err(format!("shape: unknown {name:?}")),
                }
            }

            /// Most roots on a line.
            pub fn most_roots(&self) -> usize {
                match self { $(AnySurface::$name(_) => <$name as Shape>::MOST_ROOTS),+ }
            }

            /// Runs the task in a separate function for each type of shape, which keeps these functions small; see `Isa::apart`.
            #[inline(always)]
            pub fn apart<I: Isa, T: SurfaceTask>(&self, task: T) -> Option<T::Output> {
                match self { $(AnySurface::$name(shape) => I::apart(On(shape, task))),+ }
            }
        }

        impl Surface for AnySurface {
            fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
                match self { $(AnySurface::$name(shape) => shape.roots(ray)),+ }
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

surfaces!(Box, Cylinder, Ellipsoid, Plane, Sphere, Triangle);
