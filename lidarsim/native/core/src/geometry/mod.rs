//! Vectors, rays, and the maps that they go through.

pub mod affine;
pub mod axis_plane;
pub mod point;
pub mod pose;
pub mod ray;
pub mod vector;
