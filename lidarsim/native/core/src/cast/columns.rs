//! Casts of many rays into arrays, shared among threads.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use super::schedule::pieces;
use crate::geometry::vector::Point;
use crate::scene::{Hit, HitRun, Rays, Sink};
use crate::{memory, parallel};

/// Arrays that receive the hits of many rays; each thread writes to a part of them.
pub trait Arrays: Sink + Send + Sized {
    /// Splits off the rows of the first rays.
    fn split_off(&mut self, count: usize) -> Self;

    /// Shares rays among all threads: `cast` casts a piece of them into its rows, which are split off, and
    /// tells whether all rays were legal. So does the result.
    fn share(&mut self, rays: Rays, cast: impl Fn(&mut Self, Rays) -> bool + Sync) -> bool {
        let legal = AtomicBool::new(true);
        let pieces = pieces(rays.directions, 1).into_iter();
        let pieces = memory::collect(pieces.map(|piece| (self.split_off(piece.len()), piece)));
        parallel::share(pieces.into_iter(), |(mut arrays, piece)| {
            if !cast(&mut arrays, rays.part(piece)) {
                legal.store(false, Ordering::Relaxed);
            }
        });
        legal.into_inner()
    }
}

/// An entry of an array, initialized or not.
pub trait Slot<T>: Copy {
    fn of(value: T) -> Self;
}

impl<T: Copy> Slot<T> for T {
    #[inline(always)]
    fn of(value: T) -> T {
        value
    }
}

impl<T: Copy> Slot<T> for MaybeUninit<T> {
    #[inline(always)]
    fn of(value: T) -> MaybeUninit<T> {
        MaybeUninit::new(value)
    }
}

/// One array per component of a hit.
pub struct Columns<'a, F = MaybeUninit<f64>, N = MaybeUninit<i32>> {
    pub t: &'a mut [F],
    pub object: &'a mut [N],
    pub primitive: &'a mut [N],
    /// The normals, three consecutive coordinates each.
    pub normal: &'a mut [F],
}

/// The same arrays with memory of their own.
#[derive(Default)]
pub struct HitArrays {
    pub t: Vec<f64>,
    pub object: Vec<i32>,
    pub primitive: Vec<i32>,
    pub normal: Vec<f64>,
}

impl HitArrays {
    #[cfg(test)]
    pub fn of(count: usize) -> Self {
        let mut hits = HitArrays::default();
        hits.resize(count);
        hits
    }

    /// Resizes the arrays; new rows are misses.
    pub fn resize(&mut self, count: usize) {
        let Hit { t, normal: [x, ..], object, primitive } = Hit::MISS;
        memory::resize(&mut self.t, count, t);
        memory::resize(&mut self.object, count, object);
        memory::resize(&mut self.primitive, count, primitive);
        memory::resize(&mut self.normal, 3 * count, x);
    }

    pub fn push(&mut self, hit: &Hit) {
        memory::push(&mut self.t, hit.t);
        memory::push(&mut self.object, hit.object);
        memory::push(&mut self.primitive, hit.primitive);
        hit.normal.iter().for_each(|x| memory::push(&mut self.normal, *x));
    }

    pub fn len(&self) -> usize {
        self.t.len()
    }

    #[inline(always)]
    pub fn normal(&self, i: usize) -> Point {
        self.normal.as_chunks().0[i]
    }

    #[inline(always)]
    pub fn at(&self, i: usize) -> Hit {
        Hit { t: self.t[i], normal: self.normal(i), object: self.object[i], primitive: self.primitive[i] }
    }

    #[cfg(test)]
    pub fn iter(&self) -> impl Iterator<Item = Hit> {
        (0..self.len()).map(|i| self.at(i))
    }

    pub fn columns(&mut self) -> Columns<'_, f64, i32> {
        let HitArrays { t, object, primitive, normal } = self;
        Columns { t, object, primitive, normal }
    }
}

/// An uninitialized array of flags: whether each ray hits anything.
pub struct Occlusion<'a>(pub &'a mut [MaybeUninit<bool>]);

impl Arrays for Columns<'_> {
    fn split_off(&mut self, count: usize) -> Self {
        Columns {
            t: memory::split_off(&mut self.t, count),
            object: memory::split_off(&mut self.object, count),
            primitive: memory::split_off(&mut self.primitive, count),
            normal: memory::split_off(&mut self.normal, 3 * count),
        }
    }
}

impl Arrays for Occlusion<'_> {
    fn split_off(&mut self, count: usize) -> Self {
        Occlusion(memory::split_off(&mut self.0, count))
    }
}

impl<F: Slot<f64>, N: Slot<i32>> Sink for Columns<'_, F, N> {
    #[inline(always)]
    fn clear(&mut self, rays: Range<usize>) {
        let Hit { t, normal, object, primitive } = Hit::MISS;
        self.t[rays.clone()].fill(F::of(t));
        self.object[rays.clone()].fill(N::of(object));
        self.primitive[rays.clone()].fill(N::of(primitive));
        self.normal[3 * rays.start..3 * rays.end].as_chunks_mut().0.fill(normal.map(F::of));
    }

    #[inline(always)]
    fn write(&mut self, i: usize, hit: Hit) {
        self.t[i] = F::of(hit.t);
        self.object[i] = N::of(hit.object);
        self.primitive[i] = N::of(hit.primitive);
        self.normal.as_chunks_mut().0[i] = hit.normal.map(F::of);
    }

    #[inline(always)]
    fn write_run(&mut self, i: usize, hits: &HitRun) {
        self.t[i..i + 4].as_chunks_mut().0[0] = hits.t.map(F::of);
        self.object[i..i + 4].as_chunks_mut().0[0] = hits.object.map(N::of);
        self.primitive[i..i + 4].as_chunks_mut().0[0] = hits.primitive.map(N::of);
        for (place, normals) in self.normal[3 * i..3 * i + 12].as_chunks_mut().0.iter_mut().zip(hits.normals)
        {
            *place = normals.map(F::of);
        }
    }
}

impl Sink for Occlusion<'_> {
    const ANY: bool = true;

    #[inline(always)]
    fn clear(&mut self, rays: Range<usize>) {
        self.0[rays].fill(MaybeUninit::new(false));
    }

    #[inline(always)]
    fn write(&mut self, i: usize, hit: Hit) {
        self.0[i].write(hit.object >= 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Isa, Level};
    use crate::arith::simd::{Task, dispatch};
    use crate::scene::EightHits;
    use crate::testing::numbers;

    struct WriteRuns<'a>(&'a mut HitArrays, &'a [u32; 8], u32, &'a [Hit; 8]);

    impl Task for WriteRuns<'_> {
        type Output = u32;

        #[inline(always)]
        fn run<I: Isa>(self) -> u32 {
            let WriteRuns(arrays, rays, lanes, hits) = self;
            let normal = [0, 1, 2].map(|axis| hits.map(|hit| hit.normal[axis]));
            let eight = EightHits {
                t: &hits.map(|hit| hit.t),
                normal: normal.each_ref(),
                object: hits.map(|hit| hit.object),
                primitive: hits.map(|hit| hit.primitive),
            };
            arrays.columns().write_runs::<I>(rays, lanes, &eight)
        }
    }

    /// Four consecutive lanes, possibly without the first or the last, or at the end of the arrays.
    #[test]
    fn runs_of_hits_are_put_where_each_would_be() {
        const COUNT: u32 = 40;
        let mut number = numbers();
        let quarters = [
            [5, 6, 7, 8],
            [20, 21, 22, 23],
            [36, 37, 38, 39],
            [9, 11, 12, 13],
            [30, 31, 32, 34],
            [3, 2, 1, 0],
        ];
        let (mut runs, mut others) = (0, 0);
        for (first, second) in quarters.iter().flat_map(|a| quarters.iter().map(move |b| (a, b))) {
            let rays: [u32; 8] = std::array::from_fn(|k| if k < 4 { first[k] } else { second[k - 4] });
            for lanes in [0xff, 0xf0, 0x0f, 0xfe, 0x7f, 0xef, 0] {
                let hits = rays.map(|ray| Hit {
                    t: number(),
                    normal: [number(), number(), number()],
                    object: ray as i32 + 100,
                    primitive: ray as i32 + 200,
                });
                for level in Level::available() {
                    let (mut arrays, mut expected) =
                        (HitArrays::of(COUNT as usize), vec![Hit::MISS; COUNT as usize]);
                    let written = dispatch(level, WriteRuns(&mut arrays, &rays, lanes, &hits));
                    for half in 0..2 {
                        let four = 4 * half..4 * half + 4;
                        let is_run = rays[four.clone()].windows(2).all(|pair| pair[1] == pair[0] + 1);
                        let all = 0xf << (4 * half);
                        assert_eq!(written & all, if is_run && lanes & all == all { all } else { 0 });
                        if written & all != 0 {
                            four.for_each(|k| expected[rays[k] as usize] = hits[k]);
                            runs += 1;
                        } else {
                            others += 1;
                        }
                    }
                    let parts = |hit: &Hit| (hit.t, hit.normal, hit.object, hit.primitive);
                    let found: Vec<_> = arrays.iter().map(|hit| parts(&hit)).collect();
                    assert_eq!(found, expected.iter().map(parts).collect::<Vec<_>>(), "{level:?}");
                }
            }
        }
        assert!(runs > 100 && others > 100, "{runs}, {others}");
    }
}
