//! The core of lidarsim: exact ray casting and per-pulse measurement.
//!
//! Its layers, of which each uses those above it alone: `memory` and `parallel`, arithmetic, geometry and shapes, the bounding volume hierarchy,
//! scenes, casts, measurement.

pub mod arith;
pub mod bvh;
pub mod cast;
pub mod geometry;
pub mod measure;
pub mod memory;
pub mod parallel;
pub mod scene;
pub mod shapes;
#[cfg(test)]
mod testing;
