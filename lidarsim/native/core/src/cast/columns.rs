//! Casts of many rays, shared among threads, into an array for each part of a hit.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use super::schedule::pieces;
use crate::arith::simd::{self, Isa, Level};
use crate::geometry::vector::Point;
use crate::scene::{Hit, Scene, Sink};
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

    /// As `Scene::cast`, on all threads. The row of each ray is written, of an illegal one too.
    pub fn cast(
        mut self,
        scene: &Scene,
        level: Level,
        origins: &[Point],
        directions: &[Point],
        range: (f64, f64),
    ) -> bool {
        let legal = AtomicBool::new(true);
        let pieces = pieces(directions, 1).into_iter();
        let pieces = memory::collect(pieces.map(|piece| (self.split_off(piece.len()), piece)));
        parallel::share(pieces.into_iter(), |(mut columns, piece)| {
            if !scene.cast(level, &origins[piece.clone()], &directions[piece], range, &mut columns) {
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
