//! Rays and ranges as passed by callers.

use std::ops::Range;

use crate::geometry::origins::Origins;
use crate::geometry::vector::Point;

/// A world ray at a time.
#[derive(Clone, Copy, Debug)]
pub struct TimedRay {
    pub origin: Point,
    pub direction: Point,
    /// Arbitrary if nothing moves.
    pub time: f64,
}

/// World rays.
#[derive(Clone, Copy)]
pub struct Rays<'a> {
    pub origins: Origins<'a>,
    pub directions: &'a [Point],
    /// May be empty if nothing moves.
    pub times: &'a [f64],
    /// How many consecutive rays are the sub-rays of a pulse, which have one origin and time and differ
    /// little in direction. 1 if nothing is known of neighbours.
    pub bundle: usize,
}

impl<'a> Rays<'a> {
    pub fn new(origins: &'a [Point], directions: &'a [Point], times: &'a [f64]) -> Self {
        Rays { origins: Origins::Each(origins), directions, times, bundle: 1 }
    }

    /// Some of the rays: whole bundles.
    pub fn part(self, rays: Range<usize>) -> Self {
        let times = if self.times.is_empty() { self.times } else { &self.times[rays.clone()] };
        let (origins, directions) = (self.origins.part(rays.clone()), &self.directions[rays]);
        Rays { origins, directions, times, ..self }
    }
}

/// The closed range of t of a query.
#[derive(Clone, Copy, Debug)]
pub struct TRange {
    pub min: f64,
    pub max: f64,
}

impl TRange {
    /// The whole ray.
    pub const RAY: TRange = TRange { min: 0.0, max: f64::INFINITY };
}
