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

/// Where hits go: the hit of ray i, once for each ray, in any order.
pub trait Sink {
    /// Whether any hit of a ray will do: then what is put is `Hit::UNREFINED` or `Hit::MISS`.
    const ANY: bool = false;

    fn put(&mut self, i: usize, hit: Hit);
    /// Prefetches the memory of some hits.
    fn prefetch<I: Isa>(&self, hits: Range<usize>);
}

impl Sink for [Hit] {
    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self[i] = hit;
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, hits: Range<usize>) {
        simd::prefetch::<I, _>(&self[hits]);
    }
}
