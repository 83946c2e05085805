//! Rays in the coordinates of an object, computed once for the formulas of its surface.

use std::cell::Cell;
use std::marker::PhantomData;

use crate::arith::number::{DoubleDoubles, Lanes, Many, OfRays, RunningErrors, Stored};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::bvh::{Mask, part_of_mask};
use crate::geometry::affine::{PlacementTask, Placements, RayPlacement};
use crate::geometry::ray::Ray;
use crate::geometry::vector::of_rays;

/// M rays, one register at a time.
pub trait RayParts: Copy {
    /// Whether they are in world coordinates.
    const IN_WORLD: bool;

    /// Part `i` of the rays.
    fn part<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, i: usize, lanes: L) -> Ray<K>;

    /// Origins and directions of part `i` along an axis, if the rays are in world coordinates.
    fn along<F: Floats<f64, N>, const N: usize>(self, axis: usize, i: usize) -> Option<(F, F)>;
}

/// Rays in world coordinates, by axis.
#[derive(Clone, Copy)]
pub struct WorldRays<'a, const M: usize> {
    pub origin: &'a [[f64; M]; 3],
    pub direction: &'a [[f64; M]; 3],
}

impl<const M: usize> RayParts for WorldRays<'_, M> {
    const IN_WORLD: bool = true;

    #[inline(always)]
    fn part<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, i: usize, rays: L) -> Ray<K> {
        let (origin, direction) = (lanes::part(self.origin, i), lanes::part(self.direction, i));
        Ray { origin: of_rays(origin, rays), direction: of_rays(direction, rays), weight: None }
    }

    #[inline(always)]
    fn along<F: Floats<f64, N>, const N: usize>(self, axis: usize, i: usize) -> Option<(F, F)> {
        Some((lanes::load(&self.origin[axis], i), lanes::load(&self.direction[axis], i)))
    }
}

/// Rays in the coordinates of an object, in one kind of number.
pub struct LocalRays<const M: usize> {
    origin: [Stored<M>; 3],
    direction: [Stored<M>; 3],
    weight: Stored<M>,
}

impl<const M: usize> RayParts for &LocalRays<M> {
    const IN_WORLD: bool = false;

    #[inline(always)]
    fn part<K: OfRays<L, N>, L: Lanes<N>, const N: usize>(self, i: usize, lanes: L) -> Ray<K> {
        let ([x, y, z], [u, v, w]) = (&self.origin, &self.direction);
        Ray {
            origin: [K::load(x, i, lanes), K::load(y, i, lanes), K::load(z, i, lanes)],
            direction: [K::load(u, i, lanes), K::load(v, i, lanes), K::load(w, i, lanes)],
            weight: Some(K::load(&self.weight, i, lanes)),
        }
    }

    #[inline(always)]
    fn along<F: Floats<f64, N>, const N: usize>(self, _: usize, _: usize) -> Option<(F, F)> {
        None
    }
}

/// A kind of number.
pub trait Kind {
    type Of<L: Lanes<N>, const N: usize>: OfRays<L, N>;
}

pub struct OfRunningErrors;

impl Kind for OfRunningErrors {
    type Of<L: Lanes<N>, const N: usize> = RunningErrors<L, N>;
}

pub struct OfDoubleDoubles;

impl Kind for OfDoubleDoubles {
    type Of<L: Lanes<N>, const N: usize> = DoubleDoubles<L, N>;
}

impl<const M: usize> LocalRays<M> {
    pub const UNSET: Self =
        LocalRays { origin: [Stored::UNSET; 3], direction: [Stored::UNSET; 3], weight: Stored::UNSET };

    /// Transforms the registers that contain rays of `mask`, in one kind of number. False if registers have a
    /// single lane. `one_origin` says that all rays start at one point.
    #[inline(always)]
    pub fn localize<I: Isa, K: Kind>(
        &mut self,
        placements: Placements<M>,
        world: WorldRays<M>,
        mask: Mask,
        one_origin: bool,
    ) -> bool {
        let one_origin = one_origin && placements.then.is_none();
        placements
            .dispatch::<I, _>(Localize { world, mask, one_origin, local: self, kind: PhantomData::<K> })
            .is_some()
    }
}

struct Localize<'a, K, const M: usize> {
    world: WorldRays<'a, M>,
    mask: Mask,
    /// Whether all rays start at one point of the object.
    one_origin: bool,
    local: &'a mut LocalRays<M>,
    kind: PhantomData<K>,
}

impl<K: Kind, const M: usize> PlacementTask for Localize<'_, K, M> {
    type Output = ();

    #[inline(always)]
    fn run<F: Floats<f64, N>, P: RayPlacement, const N: usize>(self, placement: P) {
        let Localize { world, mask, one_origin, local, .. } = self;
        let first = mask.trailing_zeros() as usize;
        for i in 0..M / N {
            let active = Cell::new(part_of_mask::<N>(mask, i));
            if active.get() == 0 {
                continue;
            }
            let rays = Many::<F>::new(&active);
            let ray = world.part::<K::Of<Many<F>, N>, _, N>(i, rays);
            // The first register has already transformed the origin.
            if one_origin && i > first / N {
                let Ray { direction, .. } = placement.part(i).local_rays(ray, rays);
                for axis in 0..3 {
                    direction[axis].store(i, &mut local.direction[axis]);
                }
                continue;
            }
            let Ray { origin, direction, weight } = placement.part(i).local_rays(ray, rays);
            for axis in 0..3 {
                origin[axis].store(i, &mut local.origin[axis]);
                direction[axis].store(i, &mut local.direction[axis]);
            }
            weight.unwrap_or(OfRays::<Many<F>, N>::of_rays(F::splat(1.0), rays)).store(i, &mut local.weight);
        }
        if one_origin {
            for number in local.origin.iter_mut().chain([&mut local.weight]) {
                number.repeat(first);
            }
        }
    }
}
