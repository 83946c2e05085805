//! The number of rays that are cast at a time.

use std::ops::Range;

use super::ray_sort::{MOST, NEAR, group_size};
use crate::geometry::vector::Point;
use crate::{memory, parallel};

/// Consecutive pieces of pulses for the threads; a pulse has `rays` rays. Pieces are large enough to sort
/// neighbours together and small enough to keep the rays and their hits in the second-level cache. They
/// shrink towards the end, so that all threads finish together. Rays that are sorted in larger groups have
/// larger pieces of equal size.
pub fn pieces(directions: &[Point], rays: usize) -> Vec<Range<usize>> {
    let (threads, all) = (parallel::threads(), directions.len() * rays);
    let turns = all.div_ceil(threads * MOST).max(1);
    let even = all.div_ceil(turns * threads).max(NEAR);
    let are_large = group_size(directions, 1) == MOST;
    let (mut pieces, mut start) = (Vec::new(), 0);
    while start < directions.len() {
        let left = (directions.len() - start) * rays;
        let falling = left.div_ceil(2 * threads).next_multiple_of(NEAR).min(8 * NEAR);
        let size = if are_large { even } else { falling };
        let end = directions.len().min(start + (size / rays).max(1));
        memory::push(&mut pieces, start..end);
        start = end;
    }
    pieces
}
