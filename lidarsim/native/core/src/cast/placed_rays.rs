//! The rays of a packet in the local coordinates of a transformed mesh, with bounds of their
//! rounding.

use std::cell::Cell;

use crate::arith::number::{Many, PAD, RunningErrors, UNDERFLOW};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::bvh::{LANES, LARGEST, Mask, RayPacket, SMALLEST, part_of_mask, take};
use crate::geometry::affine::{Affines, Inverse, PlacementTask, Placements, RayPlacement, RoundedInverse};
use crate::geometry::ray::{Bounds, Ray};
use crate::geometry::vector::Point;
use crate::geometry::vector::of_rays;
use crate::scene::Object;

/// The rays of a visit of an object in local coordinates, possibly of several octants.
pub struct PlacedRays {
    all: RayPacket,
    /// Rays with a negative direction, by axis.
    backward: [Mask; 3],
    /// The rays of one octant, if there are others.
    some: RayPacket,
    are_some: bool,
}

impl PlacedRays {
    pub fn new() -> Self {
        PlacedRays { all: RayPacket::empty(), backward: [0; 3], some: RayPacket::empty(), are_some: false }
    }

    /// Transforms world rays and returns those that fit into packets. `then` holds the per-ray poses of a
    /// moving object.
    #[inline(always)]
    pub fn gather<I: Isa>(
        &mut self,
        object: &Object,
        then: Option<&Affines<LANES>>,
        world: &RayPacket,
        mask: Mask,
    ) -> Mask {
        self.backward = [0; 3];
        self.all.parallel = [0; 3];
        let mut held = match object.inverse().and_then(Inverse::rounded) {
            Some(inverse) if then.is_none() => self.gather_still::<I>(inverse, world, mask),
            _ => {
                let placements = Placements { first: object.inverse(), then };
                placements.dispatch::<I, _>(Gather { world, mask, placed_rays: self }).unwrap_or(0)
            }
        };
        let mut left = mask & !held;
        self.all.one_origin = world.one_origin && then.is_none() && left == 0;
        while let Some(lane) = take(&mut left) {
            held |= Mask::from(self.gather_one(object, world, lane)) << lane;
        }
        held
    }

    /// As `gather`, with one inverse for all rays.
    #[inline(always)]
    fn gather_still<I: Isa>(&mut self, inverse: &RoundedInverse, world: &RayPacket, mask: Mask) -> Mask {
        let mut held = 0;
        self.all.parallel = inverse.parallel(world.parallel);
        let mut origin = inverse.points(lanes::splat::<I::F64x8, 8>(world.origin(0)));
        for eight in 0..LANES / 8 {
            let active = part_of_mask::<8>(mask, eight);
            if active != 0 {
                if !world.one_origin {
                    origin = inverse.points(world.origins::<I>(eight));
                }
                let direction = inverse.vectors::<I::F64x8, 8>(world.directions::<I>(eight));
                held |= Mask::from(self.store(eight, origin, direction) & active) << (8 * eight);
            }
        }
        for backward in &mut self.backward {
            *backward &= held;
        }
        held
    }

    fn gather_one(&mut self, object: &Object, world: &RayPacket, lane: usize) -> bool {
        let [o, d] = object.at(world.time[lane]).enclose(world.origin(lane), world.direction(lane));
        let ((origin, origin_error), (direction, direction_error)) = (middle_of_one(o), middle_of_one(d));
        if !(RayPacket::fits(origin, direction) && origin_error < LARGEST && direction_error < LARGEST) {
            return false;
        }
        self.all.set(lane, origin, direction);
        (self.all.origin_error[lane], self.all.direction_error[lane]) = (origin_error, direction_error);
        self.all.parallel.iter_mut().for_each(|parallel| *parallel &= !(1 << lane));
        for axis in 0..3 {
            self.backward[axis] |= Mask::from(direction[axis] < 0.0) << lane;
        }
        true
    }

    /// All rays that fit into packets.
    #[inline(always)]
    pub fn all_rays(&self) -> &RayPacket {
        &self.all
    }

    /// The rays that were chosen last.
    #[inline(always)]
    pub fn rays(&self) -> &RayPacket {
        if self.are_some { &self.some } else { &self.all }
    }

    /// As `rays`.
    #[inline(always)]
    pub fn rays_mut(&mut self) -> &mut RayPacket {
        if self.are_some { &mut self.some } else { &mut self.all }
    }

    /// Chooses the rays of `left` in the octant of the first, and returns them.
    #[inline(always)]
    pub fn next<I: Isa>(&mut self, left: Mask) -> Mask {
        let first = left.trailing_zeros();
        let (mut next, mut octant) = (left, 0);
        for (axis, backward) in self.backward.iter().enumerate() {
            let is_backward = backward >> first & 1 != 0;
            next &= if is_backward { *backward } else { !*backward };
            octant |= u32::from(is_backward) << axis;
        }
        self.are_some = next != left;
        if self.are_some {
            self.some.take_over(&self.all);
        }
        self.rays_mut().keep::<I>(next, octant);
        next
    }
}

/// Transforms rays, one register at a time. Returns those with certain bounds that fit into packets.
struct Gather<'a> {
    world: &'a RayPacket,
    mask: Mask,
    placed_rays: &'a mut PlacedRays,
}

impl PlacementTask for Gather<'_> {
    type Output = Mask;

    #[inline(always)]
    fn run<F: Floats<f64, N>, P: RayPlacement, const N: usize>(self, placement: P) -> Mask {
        let Gather { world, mask, placed_rays } = self;
        let mut held = 0;
        for i in 0..LANES / N {
            let active = Cell::new(part_of_mask::<N>(mask, i));
            if active.get() == 0 {
                continue;
            }
            let (o, d): ([F; 3], [F; 3]) = (lanes::part(&world.origin, i), lanes::part(&world.direction, i));
            let rays = Many::new(&active);
            let origin = of_rays::<RunningErrors<Many<F>, N>, _, N>(o, rays);
            let ray = Ray { origin, direction: of_rays(d, rays), weight: None };
            let local = placement.part(i).local_rays(ray, rays);
            if let Ok([o, d]) = local.enclose() {
                held |= Mask::from(placed_rays.store(i, middle(o), middle(d)) & active.get()) << (i * N);
                for (parallel, d) in placed_rays.all.parallel.iter_mut().zip(&local.direction) {
                    *parallel |= Mask::from(d.zeros() & active.get()) << (i * N);
                }
            }
        }
        for backward in &mut placed_rays.backward {
            *backward &= held;
        }
        held
    }
}

impl PlacedRays {
    /// Stores part `i` and returns its rays that fit into packets, by the rule of `RayPacket::fits`.
    #[inline(always)]
    fn store<F: Floats<f64, N>, const N: usize>(
        &mut self,
        i: usize,
        (o, origin_error): ([F; 3], F),
        (d, direction_error): ([F; 3], F),
    ) -> u32 {
        let huge = F::splat(LARGEST);
        let mut fit = origin_error.lt(huge) & direction_error.lt(huge);
        let mut largest = F::splat(0.0);
        for axis in 0..3 {
            self.all.origin[axis].as_chunks_mut().0[i] = o[axis].store();
            self.all.direction[axis].as_chunks_mut().0[i] = d[axis].store();
            self.backward[axis] |= Mask::from(d[axis].lt(F::splat(0.0))) << (i * N);
            fit &= o[axis].abs().lt(huge) & d[axis].abs().lt(huge);
            largest = d[axis].abs().max(largest);
        }
        self.all.origin_error.as_chunks_mut().0[i] = origin_error.store();
        self.all.direction_error.as_chunks_mut().0[i] = direction_error.store();
        self.all.length.as_chunks_mut().0[i] = d[0].abs().add(d[1].abs()).add(d[2].abs()).store();
        fit & F::splat(SMALLEST).lt(largest)
    }
}

/// The centres of boxes, and the largest distance of any coordinate of a point of the box from it.
#[inline(always)]
fn middle<F: Floats<f64, N>, const N: usize>(v: Bounds<F>) -> ([F; 3], F) {
    let (half, mut m, mut error) = (F::splat(0.5), [F::splat(0.0); 3], F::splat(0.0));
    for (m, x) in m.iter_mut().zip(v) {
        *m = x.low.mul(half).add(x.high.mul(half));
        error = m.sub(x.low).max(x.high.sub(*m)).max(error);
    }
    // The differences are rounded once.
    (m, error.fused(F::splat(PAD), F::splat(UNDERFLOW)))
}

/// As [`middle`], of one box.
pub fn middle_of_one(v: Bounds<f64>) -> (Point, f64) {
    let ([x, y, z], error) = middle::<f64, 1>(v);
    ([x, y, z], error)
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;
    use std::sync::Arc;

    use super::*;
    use crate::arith::number::{Dyadic, Interval, Number};
    use crate::arith::simd::{Level, Portable, Task, dispatch};
    use crate::bvh::all;
    use crate::geometry::affine::{Affine, Placement};
    use crate::scene::Geometry;
    use crate::scene::TriangleMesh;
    use crate::testing::numbers;

    struct Enter<'a>(&'a Object, &'a RayPacket, &'a mut PlacedRays);

    impl Task for Enter<'_> {
        type Output = Mask;

        #[inline(always)]
        fn run<I: Isa>(self) -> Mask {
            self.2.gather::<I>(self.0, None, self.1, all(self.1.count))
        }
    }

    /// Transformed once or twice, near and far, stretched, and some reflected.
    fn object(round: usize, number: &mut impl FnMut() -> f64) -> Option<Object> {
        let mesh = TriangleMesh::new(Vec::new(), Vec::new())?;
        let mut object = Object::new(Geometry::Mesh(Arc::new(mesh)), false);
        for _ in 0..=round % 2 {
            let place = [0.0, 1.0, 5e6][round % 3];
            let linear = [0; 3].map(|_: u8| [0; 3].map(|_: u8| 3.0 * (number() - 0.5)));
            object = object.transformed(Affine::new(linear, [0; 3].map(|_: u8| place * (number() + 0.5))))?;
        }
        Some(object)
    }

    /// Intervals of near and far numbers, wide or between neighbours.
    #[test]
    fn middles_are_as_near_both_ends_as_they_say() {
        let mut number = numbers();
        for k in 0..20_000 {
            let low = (2.0 * number() - 1.0) * 2.0_f64.powi(k % 200 - 100);
            let high =
                if k % 3 == 0 { low.next_up() } else { low + number() * [1.0, 1e-15, 1e15][k as usize % 3] };
            let ([middle, ..], error) = middle_of_one([Interval { low, high }; 3]);
            let [low, high, middle, error] = [low, high, middle, error].map(Dyadic::exact);
            let inside = [low.minus(&middle.minus(&error)), middle.plus(&error).minus(&high)];
            assert!(inside.iter().all(|x| x.sign() != Ok(Ordering::Less)), "{low:?} {high:?}");
        }
    }

    /// Quarter turns, stretches and shifts keep directions along the axes; most turns do not.
    #[test]
    fn directions_are_exactly_zero_where_it_says() {
        let mut number = numbers();
        let (mut zeros, mut others) = (0, 0);
        let quarter = [[0.0, 0.0, 0.3], [1.7, 0.0, 0.0], [0.0, -0.1, 0.0]];
        let about_z = [[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]];
        let sheared = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]];
        let any = [0; 3].map(|_: u8| [0; 3].map(|_: u8| number() - 0.5));
        for linear in [quarter, about_z, sheared, any] {
            let Some(mesh) = TriangleMesh::new(Vec::new(), Vec::new()) else { continue };
            let object = Object::new(Geometry::Mesh(Arc::new(mesh)), false)
                .transformed(Affine::new(linear, [0.1, 5e6, -0.3]));
            let Some(object) = object else { unreachable!("the map can be inverted") };
            let mut world = RayPacket::empty();
            world.count = 64;
            for lane in 0..world.count {
                let direction = [1, 2, 4].map(|bit| if lane & bit != 0 { number() + 0.1 } else { 0.0 });
                world.set(lane, [0.3, 0.2, 0.1], if lane % 8 == 0 { [1.0, 0.0, 0.0] } else { direction });
                for axis in 0..3 {
                    world.parallel[axis] |= Mask::from(world.direction(lane)[axis] == 0.0) << lane;
                }
            }
            for level in Level::available() {
                let mut placed_rays = PlacedRays::new();
                assert_eq!(dispatch(level, Enter(&object, &world, &mut placed_rays)), all(64));
                for lane in 0..world.count {
                    let ray = Ray::new(world.origin(lane), world.direction(lane));
                    let truth: Ray<Dyadic> = object.inverse().local(ray);
                    for axis in 0..3 {
                        let is_zero = truth.direction[axis].is_zero() == Ok(true);
                        let said = placed_rays.all.parallel[axis] >> lane & 1 != 0;
                        assert!(is_zero || !said, "{level:?}, {linear:?}, {lane}");
                        zeros += usize::from(said);
                        others += usize::from(is_zero && !said);
                    }
                }
            }
        }
        assert!(zeros > 200 && others < zeros / 8, "{zeros}, {others}");
    }

    #[test]
    fn rays_are_as_near_as_it_says() {
        let mut number = numbers();
        let (mut checked, mut close) = (0, 0);
        for round in 0..60 {
            let Some(object) = object(round, &mut number) else { continue };
            let mut world = RayPacket::empty();
            world.count = 64;
            for lane in 0..world.count {
                let place = [0.0, 100.0, 5e6][round % 3];
                world.set(lane, [0; 3].map(|_: u8| place + number()), [0; 3].map(|_: u8| number() - 0.5));
            }
            for level in Level::available() {
                let mut placed_rays = PlacedRays::new();
                let mut left = dispatch(level, Enter(&object, &world, &mut placed_rays));
                assert_eq!(left, all(64), "{level:?}");
                while left != 0 {
                    let mut next = placed_rays.next::<Portable>(left);
                    left &= !next;
                    while let Some(lane) = take(&mut next) {
                        let (rays, ray) =
                            (placed_rays.rays(), Ray::new(world.origin(lane), world.direction(lane)));
                        let truth: Ray<Dyadic> = object.inverse().local(ray);
                        let weight = truth.weight.clone().unwrap_or(Dyadic::exact(1.0));
                        let given = [
                            (&truth.origin, rays.origin(lane), rays.origin_error[lane]),
                            (&truth.direction, rays.direction(lane), rays.direction_error[lane]),
                        ];
                        for (truth, middle, error) in given {
                            for axis in 0..3 {
                                let off = truth[axis].minus(&weight.times(&Dyadic::exact(middle[axis])));
                                let reach = weight.times(&Dyadic::exact(error));
                                assert!(reach.minus(&off).sign() != Ok(Ordering::Less), "{level:?}, {round}");
                                assert!(reach.plus(&off).sign() != Ok(Ordering::Less), "{level:?}, {round}");
                                checked += 1;
                            }
                            close += usize::from(
                                error < 1e-6 * middle.iter().fold(0.0_f64, |m, x| m.max(x.abs())),
                            );
                        }
                        let backward = rays.direction(lane).map(|x| x < 0.0);
                        assert_eq!([1, 2, 4].map(|bit| rays.octant & bit != 0), backward);
                    }
                }
            }
        }
        assert!(checked > 20_000 && 4 * close > checked, "{checked}, {close}");
    }
}
