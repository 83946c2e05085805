//! Casts of many rays, shared among threads, into arrays.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use super::schedule::pieces;
use crate::arith::simd::{self, Isa, Level};
use crate::geometry::vector::Point;
use crate::scene::{Hit, Sink, World};
use crate::{memory, parallel};

/// Arrays that the hits of many rays go to; each thread writes to a part of them.
pub trait Arrays: Sink + Send + Sized {
    /// Splits off the rows of the first rays.
    fn split_off(&mut self, count: usize) -> Self;

    /// As `World::cast`, on all threads: splits off the rows of these rays. Each row is written, of an illegal ray too.
    fn cast(
        &mut self,
        world: &World,
        level: Level,
        (origins, directions, times): (&[Point], &[Point], &[f64]),
        range: (f64, f64),
    ) -> bool {
        let legal = AtomicBool::new(true);
        let pieces = pieces(directions, 1).into_iter();
        let pieces = memory::collect(pieces.map(|piece| (self.split_off(piece.len()), piece)));
        parallel::share(pieces.into_iter(), |(mut arrays, piece)| {
            let times = if times.is_empty() { times } else { &times[piece.clone()] };
            let rays = (&origins[piece.clone()], &directions[piece], times);
            if !world.cast(level, rays, range, &mut arrays) {
                legal.store(false, Ordering::Relaxed);
            }
        });
        legal.into_inner()
    }
}

/// An uninitialized array for each part of a hit.
pub struct Columns<'a> {
    pub t: &'a mut [MaybeUninit<f64>],
    pub object: &'a mut [MaybeUninit<i32>],
    pub primitive: &'a mut [MaybeUninit<i32>],
    pub normal: &'a mut [MaybeUninit<Point>],
}

/// An uninitialized array of whether each ray hits anything.
pub struct Occlusion<'a>(pub &'a mut [MaybeUninit<bool>]);

impl Arrays for Columns<'_> {
    fn split_off(&mut self, count: usize) -> Self {
        Columns {
            t: memory::split_off(&mut self.t, count),
            object: memory::split_off(&mut self.object, count),
            primitive: memory::split_off(&mut self.primitive, count),
            normal: memory::split_off(&mut self.normal, count),
        }
    }
}

impl Arrays for Occlusion<'_> {
    fn split_off(&mut self, count: usize) -> Self {
        Occlusion(memory::split_off(&mut self.0, count))
    }
}

impl Sink for Columns<'_> {
    #[inline(always)]
    fn clear(&mut self, rays: Range<usize>) {
        let Hit { t, normal, object, primitive } = Hit::MISS;
        self.t[rays.clone()].fill(MaybeUninit::new(t));
        self.object[rays.clone()].fill(MaybeUninit::new(object));
        self.primitive[rays.clone()].fill(MaybeUninit::new(primitive));
        self.normal[rays].fill(MaybeUninit::new(normal));
    }

    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self.t[i].write(hit.t);
        self.object[i].write(hit.object);
        self.primitive[i].write(hit.primitive);
        self.normal[i].write(hit.normal);
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, i: usize) {
        I::prefetch(&self.t[i]);
        I::prefetch(&self.object[i]);
        I::prefetch(&self.primitive[i]);
        simd::prefetch_across::<I, _>(&self.normal[i]);
    }
}

impl Sink for Occlusion<'_> {
    const ANY: bool = true;

    #[inline(always)]
    fn clear(&mut self, rays: Range<usize>) {
        self.0[rays].fill(MaybeUninit::new(false));
    }

    #[inline(always)]
    fn put(&mut self, i: usize, hit: Hit) {
        self.0[i].write(hit.object >= 0);
    }

    #[inline(always)]
    fn prefetch<I: Isa>(&self, i: usize) {
        I::prefetch(&self.0[i]);
    }
}
