//! Casts of many rays, shared among threads, into an array for each part of a hit.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use super::schedule::pieces;
use crate::arith::simd::{self, Isa, Level};
use crate::geometry::vector::Point;
use crate::scene::{Hit, Sink, World};
use crate::{memory, parallel};

/// A part of the uninitialized arrays that hits are written to.
pub struct Columns<'a> {
    pub t: &'a mut [MaybeUninit<f64>],
    pub object: &'a mut [MaybeUninit<i32>],
    pub primitive: &'a mut [MaybeUninit<i32>],
    pub normal: &'a mut [MaybeUninit<Point>],
}

impl<'a> Columns<'a> {
    /// Splits off the rows of the first rays.
    fn split_off(&mut self, count: usize) -> Columns<'a> {
        Columns {
            t: memory::split_off(&mut self.t, count),
            object: memory::split_off(&mut self.object, count),
            primitive: memory::split_off(&mut self.primitive, count),
            normal: memory::split_off(&mut self.normal, count),
        }
    }

    /// As `World::cast`, on all threads: splits off the rows of these rays. Each row is written, of an illegal ray too.
    pub fn cast(
        &mut self,
        world: &World,
        level: Level,
        (origins, directions, times): (&[Point], &[Point], &[f64]),
        range: (f64, f64),
    ) -> bool {
        let legal = AtomicBool::new(true);
        let pieces = pieces(directions, 1).into_iter();
        let pieces: Vec<_> = pieces.map(|piece| (self.split_off(piece.len()), piece)).collect();
        parallel::share(pieces.into_iter(), |(mut columns, piece)| {
            let times = if times.is_empty() { times } else { &times[piece.clone()] };
            let rays = (&origins[piece.clone()], &directions[piece], times);
            if !world.cast(level, rays, range, &mut columns) {
                legal.store(false, Ordering::Relaxed);
            }
        });
        legal.into_inner()
    }
}

impl Sink for Columns<'_> {
    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self.t[i].write(hit.t);
        self.object[i].write(hit.object);
        self.primitive[i].write(hit.primitive);
        self.normal[i].write(hit.normal);
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, hits: Range<usize>) {
        simd::prefetch::<I, _>(&self.t[hits.clone()]);
        simd::prefetch::<I, _>(&self.object[hits.clone()]);
        simd::prefetch::<I, _>(&self.primitive[hits.clone()]);
        simd::prefetch::<I, _>(&self.normal[hits]);
    }
}
