//! Casts: the nearest hits of many rays.

mod blocks;
mod columns;
mod doubt;
mod local;
mod order;
mod refine;
mod schedule;
mod search;
mod simple;
mod trace;
mod traversal;

pub use columns::Columns;
pub use schedule::{pieces, slices};
