//! Vectors, rays, and the maps that transform them.

pub mod affine;
pub mod axis_plane;
pub mod dop;
pub mod origins;
pub mod point;
pub mod pose;
pub mod ray;
mod sweep;
mod turn;
pub mod vector;
