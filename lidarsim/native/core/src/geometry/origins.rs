//! Where rays start.

use std::ops::Range;

use crate::arith::simd::{self, Isa, lanes};
use crate::geometry::vector::Point;

/// The origins of many rays.
#[derive(Clone, Copy)]
pub enum Origins<'a> {
    /// Common to all rays, as for most sensors: there is less to read.
    One(Point),
    Each(&'a [Point]),
}

impl<'a> Origins<'a> {
    #[inline(always)]
    pub fn of(&self, ray: usize) -> Point {
        match self {
            Origins::One(origin) => *origin,
            Origins::Each(origins) => origins[ray],
        }
    }

    /// The origins of eight rays from `first` on.
    #[inline(always)]
    pub fn of_eight<I: Isa>(&self, first: usize) -> [I::F64x8; 3] {
        match self {
            Origins::One(origin) => lanes::splat(*origin),
            Origins::Each(origins) => simd::load_points::<I>(&origins[first..first + 8].as_chunks().0[0]),
        }
    }

    /// The origins of any eight rays.
    #[inline(always)]
    pub fn of_these<I: Isa>(&self, rays: &[usize; 8]) -> [I::F64x8; 3] {
        match self {
            Origins::One(origin) => lanes::splat(*origin),
            Origins::Each(origins) => I::columns(rays.map(|ray| &origins[ray])),
        }
    }

    /// The origins of some of the rays.
    #[inline(always)]
    pub fn part(self, rays: Range<usize>) -> Self {
        match self {
            Origins::One(_) => self,
            Origins::Each(origins) => Origins::Each(&origins[rays]),
        }
    }

    /// The origin of each ray; empty if all have a common one.
    #[inline(always)]
    pub fn each(self) -> &'a [Point] {
        match self {
            Origins::One(_) => &[],
            Origins::Each(origins) => origins,
        }
    }
}
