//! Casts: the nearest hits of many rays.

mod blocks;
mod doubt;
mod local;
pub mod order;
mod refine;
mod search;
mod simple;
pub mod trace;
mod traversal;
