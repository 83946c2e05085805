//! How many rays are cast at a time.

use std::ops::Range;

use super::ray_sort::{MOST, NEAR, are_scattered};
use crate::geometry::vector::Point;
use crate::{memory, parallel};

/// Which pulses threads take at a time, one piece after the other, where each takes so many `rays`: enough
/// that neighbours can be sorted together, few enough that the rays and their hits stay in the second cache,
/// and fewer and fewer towards the end, so that all threads end together. Incoherent rays are worth sorting
/// in larger numbers, as many for each thread.
pub fn pieces(directions: &[Point], rays: usize) -> Vec<Range<usize>> {
    let (threads, all) = (parallel::threads(), directions.len() * rays);
    let turns = all.div_ceil(threads * MOST).max(1);
    let even = all.div_ceil(turns * threads).max(NEAR);
    let scattered = are_scattered(directions);
    let (mut pieces, mut start) = (Vec::new(), 0);
    while start < directions.len() {
        let left = (directions.len() - start) * rays;
        let falling = left.div_ceil(2 * threads).next_multiple_of(NEAR).min(8 * NEAR);
        let size = if scattered { even } else { falling };
        let end = directions.len().min(start + (size / rays).max(1));
        memory::push(&mut pieces, start..end);
        start = end;
    }
    pieces
}
