//! Casts: the closest hits of many rays, or all of them.

mod all_hits;
mod closest_hit;
mod columns;
mod deferred;
mod driver;
mod grazing;
mod hit_batches;
mod instances_met;
mod leaf_intersector;
mod local_rays;
mod meet_instances;
mod next_hit;
mod placed_rays;
mod poses;
mod primitive_intersector;
mod ray_query;
mod ray_sort;
mod schedule;
mod surface_intersector;
mod traversal;
mod triangle_hits;

pub use all_hits::{HitRows, cast_all};
pub use columns::{Arrays, Columns, HitArrays, Occlusion};
pub use driver::Cast;
pub use instances_met::NO_INSTANCE;
pub use meet_instances::MeetInstances;
pub use next_hit::{Departure, SurfaceHit, next_hit};
pub use ray_sort::NEAR;
pub use schedule::pieces;
