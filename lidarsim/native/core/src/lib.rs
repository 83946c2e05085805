//! The core of lidarsim: exact ray casting and per-pulse measurement.
//!
//! Each layer uses only those before it: `memory`, `stop`, `once` and `parallel`, arithmetic, geometry and
//! shapes, the bounding volume hierarchy, scenes, casts, measurement and scan patterns, kernels.

mod arith;
mod bvh;
mod cast;
mod geometry;
mod kernels;
pub mod measure;
pub mod memory;
mod once;
mod parallel;
pub mod patterns;
mod scene;
pub mod shapes;
pub mod stop;
#[cfg(test)]
mod testing;

pub use arith::simd::{Level, OnPortable};
#[cfg(target_arch = "x86_64")]
pub use arith::simd::{OnAvx2, OnAvx512};
pub use cast::{Arrays, Columns, HitRows, NO_INSTANCE, Occlusion, cast_all};
pub use geometry::affine::Affine;
pub use geometry::origins::Origins;
pub use geometry::pose::{Cubic, LARGEST, Path, Pose, Step, Velocity};
pub use geometry::vector::Point;
pub use kernels::Kernels;
pub use once::Once;
pub use parallel::{threads, use_threads, with_room};
pub use scene::{
    Disks, Geometry, Index, Object, Primitives, Rays, Scene, Spheres, TRange, TriangleMesh, World, span,
};
