//! Casts: the closest hits of many rays, or all of them.

mod all_hits;
mod closest_hit;
mod columns;
mod deferred;
mod driver;
mod hit_batches;
mod instance;
mod leaf_intersector;
mod local_rays;
mod next_hit;
mod poses;
mod primitive_intersector;
mod ray_query;
mod ray_sort;
mod schedule;
mod surface_intersector;
mod traversal;
mod triangle_hits;

pub use all_hits::{HitRows, cast_all, objects_met};
pub use columns::{Arrays, Columns, HitArrays, Occlusion};
pub use driver::Cast;
pub use next_hit::{Departure, Met, next_hit};
pub use schedule::pieces;
