//! Where the pulses of a frame leave the sensor.

use crate::arith::simd::{self, Isa, lanes};
use crate::geometry::vector::Point;

/// In the sensor frame.
#[derive(Clone, Copy)]
pub enum Origins<'a> {
    /// Common to all pulses, as for most sensors: there is less to read.
    One(Point),
    Each(&'a [Point]),
}

impl Origins<'_> {
    #[inline(always)]
    pub fn of(&self, pulse: usize) -> Point {
        match self {
            Origins::One(origin) => *origin,
            Origins::Each(origins) => origins[pulse],
        }
    }

    /// Of eight pulses from `first` on.
    #[inline(always)]
    pub(super) fn of_eight<I: Isa>(&self, first: usize) -> [I::F64x8; 3] {
        match self {
            Origins::One(origin) => lanes::splat(*origin),
            Origins::Each(origins) => simd::load_points::<I>(&origins[first..first + 8].as_chunks().0[0]),
        }
    }
}
