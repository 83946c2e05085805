//! Rays side by side, of which one question is asked together.
//!
//! A decision may turn out differently in different lanes. The question then goes on for lanes that agree, and the asker asks it
//! again for the others, until every lane has its answer: a handful of times at most, as rays of a packet are neighbours.

use std::cell::Cell;
use std::cmp::Ordering;
use std::marker::PhantomData;

use super::{Number, Uncertain};
use crate::arith::simd::Floats;

/// What a number of N lanes is made of, and which of its lanes are still asked.
pub trait Lanes<const N: usize>: Copy {
    type Floats: Floats<f64, N>;

    /// For numbers that no ray went into: they are the same in every lane.
    const OF_NO_RAY: Self;

    fn or(self, other: Self) -> Self;
    /// The lanes still asked, a bit each.
    fn active(self) -> u32;
    fn restrict_to(self, lanes: u32);

    /// Goes on with the lanes of `known`.
    #[inline(always)]
    fn keep(self, known: u32) -> Result<(), Uncertain> {
        let lanes = self.active() & known;
        if lanes == 0 {
            return Err(Uncertain);
        }
        self.restrict_to(lanes);
        Ok(())
    }

    /// Goes on with lanes whose sign is the same, of those that have the signs given.
    #[inline(always)]
    fn agree(self, less: u32, equal: u32, greater: u32) -> Result<Ordering, Uncertain> {
        if self.keep(greater).is_ok() {
            Ok(Ordering::Greater)
        } else if self.keep(less).is_ok() {
            Ok(Ordering::Less)
        } else {
            self.keep(equal).map(|()| Ordering::Equal)
        }
    }
}

/// A number that may differ from lane to lane.
pub trait OfRays<L: Lanes<N>, const N: usize>: Number {
    /// These numbers, exactly.
    fn of_rays(value: L::Floats, lanes: L) -> Self;
}

/// One ray.
#[derive(Clone, Copy, Debug)]
pub struct One;

impl Lanes<1> for One {
    type Floats = f64;

    const OF_NO_RAY: Self = One;

    #[inline(always)]
    fn or(self, _: Self) -> Self {
        One
    }

    #[inline(always)]
    fn active(self) -> u32 {
        1
    }

    #[inline(always)]
    fn restrict_to(self, _: u32) {}
}

/// As many rays as a register has lanes. None for numbers of no ray.
#[derive(Clone, Copy)]
pub struct Many<'a, F>(Option<&'a Cell<u32>>, PhantomData<F>);

impl<'a, F> Many<'a, F> {
    #[inline(always)]
    pub fn new(active: &'a Cell<u32>) -> Self {
        Many(Some(active), PhantomData)
    }
}

impl<F: Floats<f64, N>, const N: usize> Lanes<N> for Many<'_, F> {
    type Floats = F;

    const OF_NO_RAY: Self = Many(None, PhantomData);

    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Many(if self.0.is_some() { self.0 } else { other.0 }, PhantomData)
    }

    #[inline(always)]
    fn active(self) -> u32 {
        match self.0 {
            Some(active) => active.get(),
            None => (1 << N) - 1,
        }
    }

    #[inline(always)]
    fn restrict_to(self, lanes: u32) {
        if let Some(active) = self.0 {
            active.set(lanes);
        }
    }
}
