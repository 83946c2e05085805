//! Rays that graze the plane of a hierarchy: they run so close to it that float32 boxes do not tell where
//! they cross it, and the rounding of local coordinates may not even tell on which side they start. Where
//! they do follows from one quotient per ray, of double-doubles or, where these cannot tell, exactly.

use std::cell::Cell;

use crate::arith::number::{DoubleDoubles, Interval, Many, Number, Predicate, Uncertain, decide_exactly};
use crate::arith::root::Root;
use crate::arith::simd::{Floats, Isa, Task};
use crate::bvh::{BoxFrame, Crossings, LANES, Mask, RayPacket, part_of_mask, take};
use crate::cast::local_rays::{RayParts, WorldRays};
use crate::geometry::affine::{Affines, PlacementTask, Placements, RayPlacement};
use crate::geometry::ray::Ray;
use crate::geometry::vector::Point;
use crate::scene::{Object, ObjectAt};

/// Rays with a slope and a height below this, relative to their direction and to the reach of the hierarchy,
/// graze a plane. Any number would do: others are left to boxes.
const GRAZING: f64 = 2.0 * f32::EPSILON as f64;

/// An axis, and the rays that graze the plane of the hierarchy perpendicular to it, if there are any.
#[inline(always)]
pub fn grazing<I: Isa>(rays: &RayPacket, mask: Mask, frame: BoxFrame) -> Option<(usize, Mask)> {
    let (height, first) = (GRAZING * frame.longest_reach(), mask.trailing_zeros() as usize % LANES);
    for axis in 0..3 {
        let plane = frame.planes[axis];
        // A comparison with NaN is false.
        if rays.one_origin && !((rays.origin[axis][first] - plane).abs() <= height) || plane.is_nan() {
            continue;
        }
        let grazing = mask & !rays.parallel[axis] & lanes_near::<I>(rays, axis, plane, height);
        if grazing != 0 {
            return Some((axis, grazing));
        }
    }
    None
}

#[inline(always)]
fn lanes_near<I: Isa>(rays: &RayPacket, axis: usize, plane: f64, height: f64) -> Mask {
    let mut near = 0;
    for eight in 0..LANES / 8 {
        let part = |x: &[f64; LANES]| I::F64x8::load(&x.as_chunks().0[eight]);
        let above = part(&rays.origin[axis]).sub(I::F64x8::splat(plane)).abs();
        let slope = part(&rays.length).mul(I::F64x8::splat(GRAZING));
        let lanes = above.le(I::F64x8::splat(height)) & part(&rays.direction[axis]).abs().le(slope);
        near |= Mask::from(lanes) << (8 * eight);
    }
    near
}

/// Finds where rays of the world cross a plane of an object.
pub struct FindCrossings<'a> {
    pub object: &'a Object,
    /// The per-ray poses of a moving object.
    pub then: Option<&'a Affines<LANES>>,
    pub world: &'a RayPacket,
    pub rays: Mask,
    pub axis: usize,
    pub plane: f64,
    pub crossings: &'a mut Crossings,
}

impl Task for FindCrossings<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let FindCrossings { object, then, world, rays, axis, plane, crossings } = self;
        (crossings.rays, crossings.axis) = (rays, axis);
        let placements = Placements { first: object.inverse(), then };
        let of_lanes = CrossingsOfLanes { world, rays, axis, plane, crossings };
        let mut left = rays & !placements.dispatch::<I, _>(of_lanes).unwrap_or(0);
        while let Some(lane) = take(&mut left) {
            let object = object.at(world.time[lane]);
            let (origin, direction) = (world.origin(lane), world.direction(lane));
            let found = decide_exactly(&CrossingOfPlane { object, axis, plane, origin, direction });
            let Interval { low, high } =
                found.unwrap_or(Interval { low: f64::INFINITY, high: f64::NEG_INFINITY });
            (crossings.low[lane], crossings.high[lane]) = (low, high);
        }
    }
}

/// The t at which a ray that is not parallel to a plane crosses it: h/d, as h·d/d².
#[inline(always)]
fn crossing<N: Number>(ray: &Ray<N>, axis: usize, plane: f64) -> Root<N> {
    let height = ray.weighted(N::exact(plane)).minus(&ray.origin[axis]);
    let slope = &ray.direction[axis];
    Root::linear(height.times(slope), slope.squared(), 0)
}

/// As `FindCrossings`, one register at a time. Returns the rays for which double-doubles suffice.
struct CrossingsOfLanes<'a> {
    world: &'a RayPacket,
    rays: Mask,
    axis: usize,
    plane: f64,
    crossings: &'a mut Crossings,
}

impl PlacementTask for CrossingsOfLanes<'_> {
    type Output = Mask;

    #[inline(always)]
    fn run<F: Floats<f64, N>, P: RayPlacement, const N: usize>(self, placement: P) -> Mask {
        let CrossingsOfLanes { world, rays, axis, plane, crossings } = self;
        let world = WorldRays { origin: &world.origin, direction: &world.direction };
        let mut known = 0;
        for i in 0..LANES / N {
            let active = Cell::new(part_of_mask::<N>(rays, i));
            if active.get() == 0 {
                continue;
            }
            let lanes = Many::<F>::new(&active);
            let ray = world.part::<DoubleDoubles<Many<F>, N>, _, N>(i, lanes);
            let ray = placement.part(i).local_rays(ray, lanes);
            if let Ok(Interval { low, high }) = Number::enclose(&crossing(&ray, axis, plane)) {
                crossings.low.as_chunks_mut().0[i] = low.store();
                crossings.high.as_chunks_mut().0[i] = high.store();
                known |= Mask::from(active.get()) << (i * N);
            }
        }
        known
    }
}

/// The t at which one ray crosses a plane; `None` if it is parallel to it.
struct CrossingOfPlane<'a> {
    object: ObjectAt<'a>,
    axis: usize,
    plane: f64,
    origin: Point,
    direction: Point,
}

impl Predicate for CrossingOfPlane<'_> {
    type Answer = Option<Interval>;

    fn evaluate<N: Number<Floats = f64>>(&self) -> Result<Self::Answer, Uncertain> {
        let ray: Ray<N> = self.object.local(Ray::new(self.origin, self.direction));
        if ray.direction[self.axis].is_zero()? {
            return Ok(None);
        }
        N::enclose(&crossing(&ray, self.axis, self.plane)).map(Some)
    }
}
