//! Shapes of which one object holds many. Their formulas take the numbers that define a shape, which may
//! differ from lane to lane.

use std::marker::PhantomData;

use super::newton::Target;
use super::surface::{Roots, Surface};
use crate::arith::number::{Lanes, Number, OfRays, Uncertain};
use crate::geometry::ray::Ray;
use crate::geometry::vector::Vector;

/// A shape within the ball around its first three numbers, its centre, whose radius is the fourth, that is
/// defined by K numbers.
pub trait Each<const K: usize>: Surface + Send + Sync {
    /// The shape with these numbers.
    fn of(numbers: [f64; K]) -> Self;

    /// As `Surface::roots`, of the shape with these numbers.
    fn roots_of<N: Number>(numbers: &[N; K], ray: &Ray<N>) -> Result<Roots<N>, Uncertain>;

    /// As `Surface::implicit`.
    fn implicit_of<N: Number>(numbers: &[N; K], ray: &Ray<N>) -> N;

    /// As `Surface::normal`.
    fn normal_of<N: Number>(numbers: &[N; K], ray: &Ray<N>) -> Vector<N>;
}

/// The vector of three numbers.
#[inline(always)]
pub fn vector<N: Number>([x, y, z]: [&N; 3]) -> Vector<N> {
    [x.clone(), y.clone(), z.clone()]
}

/// One shape per ray of a register, by number.
pub struct EachOf<S, F, const K: usize>(pub [F; K], pub PhantomData<S>);

impl<S: Each<K>, L: Lanes<N>, const N: usize, const K: usize> Target<L, N> for EachOf<S, L::Floats, K> {
    #[inline(always)]
    fn implicit<M: OfRays<L, N>>(&self, ray: &Ray<M>, _: u8, lanes: L) -> M {
        S::implicit_of(&of_each(&self.0, lanes), ray)
    }

    #[inline(always)]
    fn normal<M: OfRays<L, N>>(&self, ray: &Ray<M>, _: u8, lanes: L) -> Vector<M> {
        S::normal_of(&of_each(&self.0, lanes), ray)
    }
}

/// Numbers of rays. The closure only copies: with arithmetic, it would not be compiled for the instruction set.
#[inline(always)]
pub fn of_each<M: OfRays<L, N>, L: Lanes<N>, const N: usize, const K: usize>(
    numbers: &[L::Floats; K],
    lanes: L,
) -> [M; K] {
    let first = M::of_rays(numbers[0], lanes);
    let mut all: [M; K] = std::array::from_fn(|_| first.clone());
    for (one, number) in all.iter_mut().zip(numbers).skip(1) {
        *one = M::of_rays(*number, lanes);
    }
    all
}
