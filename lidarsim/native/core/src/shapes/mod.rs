//! The shapes: their mathematics, one file each.
//!
//! To add one: write its file, implement [`Surface`], and name it once in `surfaces!` below.

mod r#box;
mod cylinder;
mod ellipsoid;
pub mod finish;
mod plane;
mod polygon;
mod sphere;
mod triangle;
mod triangle_mesh;

pub use r#box::Box;
pub use cylinder::Cylinder;
pub use ellipsoid::Ellipsoid;
pub use plane::Plane;
pub use polygon::self_crossing;
pub use sphere::Sphere;
pub use triangle::Triangle;
pub use triangle_mesh::{Bearing, Block, Planes, TriangleMesh};

use crate::arith::number::{Interval, Number, Uncertain};
use crate::arith::root::Roots;
use crate::arith::simd::{Floats, Isa, LaneTask};
use crate::geometry::ray::Ray;
use crate::geometry::vector::Vector;

/// A surface that a line meets at most twice.
pub trait Surface {
    /// Every t, of either sign, at which the line meets the surface: ascending and distinct.
    fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain>;

    /// Where the ray begins: a function that is zero on part `feature` of the surface, and of degree two at most.
    fn level<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N;

    /// Where the ray begins, on part `feature` of the surface or near it: an outward normal, half the gradient of `level`.
    fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N>;

    /// An axis-aligned box around the surface; none if the surface has no end.
    fn bounds(&self) -> Option<[Interval; 3]>;
}

/// What is to be done with a surface of known type and registers of N lanes: an always inlined `run`.
pub trait SurfaceTask {
    type Output;
    fn run<F: Floats<f64, N>, S: Surface, const N: usize>(self, surface: &S) -> Self::Output;
}

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
        /// Any surface that a line meets at most twice.
        #[derive(Clone, Debug)]
        pub enum Simple {
            $($name($name)),+
        }

        $(impl From<$name> for Simple {
            fn from(shape: $name) -> Self {
                Simple::$name(shape)
            }
        })+

        impl Simple {
            /// Runs the task as a function of its own for each type of shape, which keeps these functions small; see `Isa::apart`.
            #[inline(always)]
            pub fn apart<I: Isa, T: SurfaceTask>(&self, task: T) -> Option<T::Output> {
                match self { $(Simple::$name(shape) => I::apart(On(shape, task))),+ }
            }
        }

        impl Surface for Simple {
            #[inline]
            fn roots<N: Number>(&self, ray: &Ray<N>) -> Result<Roots<N>, Uncertain> {
                match self { $(Simple::$name(shape) => shape.roots(ray)),+ }
            }

            fn level<N: Number>(&self, ray: &Ray<N>, feature: u8) -> N {
                match self { $(Simple::$name(shape) => shape.level(ray, feature)),+ }
            }

            fn normal<N: Number>(&self, ray: &Ray<N>, feature: u8) -> Vector<N> {
                match self { $(Simple::$name(shape) => shape.normal(ray, feature)),+ }
            }

            fn bounds(&self) -> Option<[Interval; 3]> {
                match self { $(Simple::$name(shape) => shape.bounds()),+ }
            }
        }
    };
}

surfaces!(Box, Cylinder, Ellipsoid, Plane, Sphere, Triangle);
