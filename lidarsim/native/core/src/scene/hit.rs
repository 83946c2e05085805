//! Hits, and the sinks that they are written to.

use std::ops::Range;

use crate::arith::simd::{self, Isa};
use crate::geometry::vector::Point;

/// The closest hit of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// In units of the length of the direction, correctly rounded; infinite for a miss.
    pub t: f64,
    /// Unit, outward as the shape defines it.
    pub normal: Point,
    /// −1 for a miss.
    pub object: i32,
    /// Triangle of a mesh; else 0.
    pub primitive: i32,
}

impl Hit {
    pub const MISS: Hit = Hit { t: f64::INFINITY, normal: [0.0; 3], object: -1, primitive: 0 };
    /// A hit of which no more is said than that there is one.
    pub const UNREFINED: Hit = Hit { t: f64::NAN, object: 0, ..Hit::MISS };
}

/// Where the hits of rays go, those of misses first: nothing more is put for these.
pub trait Sink {
    /// Whether any hit of a ray will do: then what is put is `Hit::UNREFINED`.
    const ANY: bool = false;

    /// Puts `Hit::MISS` for some rays, before any other hit of theirs. One after the other is written, whole lines of the cache, which then are where
    /// the hits go that are put in any order.
    fn clear(&mut self, rays: Range<usize>);
    /// Puts the hit of ray i.
    fn put(&mut self, i: usize, hit: Hit);
    /// Prefetches where the hit of ray i goes.
    fn prefetch<I: Isa>(&self, i: usize);
}

impl Sink for [Hit] {
    #[inline(always)]
    fn clear(&mut self, rays: Range<usize>) {
        self[rays].fill(Hit::MISS);
    }

    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self[i] = hit;
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, i: usize) {
        simd::prefetch_across::<I, _>(&self[i]);
    }
}
