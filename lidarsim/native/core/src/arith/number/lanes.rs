//! Lanes: rays whose predicates are evaluated together.
//!
//! A branch may be taken in some lanes and not in others. Evaluation then continues for lanes that agree, and
//! the caller repeats it for the others until every lane has its result: a handful of times at most, as the
//! rays of a packet are coherent.

use std::cell::Cell;
use std::cmp::Ordering;
use std::marker::PhantomData;

use super::{Number, Stored, Uncertain};
use crate::arith::simd::Floats;

/// The registers of a number of N lanes, and the mask of its active lanes.
pub trait Lanes<const N: usize>: Copy {
    type Floats: Floats<f64, N>;

    /// For uniform numbers, which are the same in every lane.
    const UNIFORM: Self;

    fn or(self, other: Self) -> Self;
    /// The active lanes, one bit each.
    fn active(self) -> u32;
    fn restrict_to(self, lanes: u32);

    /// Deactivates the lanes outside `known`; uncertain if none remains.
    #[inline(always)]
    fn keep(self, known: u32) -> Result<(), Uncertain> {
        let lanes = self.active() & known;
        if lanes == 0 {
            return Err(Uncertain);
        }
        self.restrict_to(lanes);
        Ok(())
    }

    /// Keeps only lanes of one sign active, given the lanes of each sign.
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

/// A varying number: it may differ from lane to lane.
pub trait OfRays<L: Lanes<N>, const N: usize>: Number {
    /// These numbers, exactly.
    fn of_rays(value: L::Floats, lanes: L) -> Self;
    /// Part `i` of stored numbers: one register.
    fn load<const M: usize>(stored: &Stored<M>, i: usize, lanes: L) -> Self;
    /// Stores part `i`, to be loaded as the same kind of number.
    fn store<const M: usize>(&self, i: usize, stored: &mut Stored<M>);
}

/// One ray.
#[derive(Clone, Copy, Debug)]
pub struct One;

impl Lanes<1> for One {
    type Floats = f64;

    const UNIFORM: Self = One;

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

/// As many rays as a register has lanes; `None` for uniform numbers.
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

    const UNIFORM: Self = Many(None, PhantomData);

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
