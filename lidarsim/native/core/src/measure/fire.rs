//! From pulses to hits: each pulse is fired from the pose at its time, as one ray or as the sub-rays of a
//! beam.

use std::ops::Range;

use super::direction::{Axis, is_finite, is_unit};
use super::effects::Pulses;
use super::frame::{BadPulse, Frame};
use super::scan::Scan;
use super::scratch::{RayArrays, Scratch};
use crate::arith::simd::{self, Floats, Isa};
use crate::cast::Cast;
use crate::geometry::origins::Origins;
use crate::geometry::pose::{Motion, Path, Pose};
use crate::geometry::vector::Point;
use crate::memory::resize;
use crate::scene::{Rays, TRange};

impl Frame<'_> {
    /// Pulses as effects see them; `indices`: their numbers in the whole frame.
    #[inline(always)]
    pub(super) fn pulses<'a>(&'a self, pulses: Range<usize>, indices: &'a [u64]) -> Pulses<'a> {
        let (rings, directions) = (&self.rings[pulses.clone()], &self.directions[pulses]);
        Pulses { stream: self.stream, indices, rings, directions }
    }
}

impl Scan<'_> {
    /// Draws for the effects, aims the rays of a batch of pulses, and casts them.
    #[inline(always)]
    pub(super) fn fire<I: Isa>(&self, pulses: Range<usize>, scratch: &mut Scratch) -> Result<(), BadPulse> {
        let (frame, measurement) = (self.frame, self.measurement);
        if !frame.have_poses(pulses.clone()) {
            return frame.check(pulses);
        }
        let Scratch { rays, hits, velocities, indices, draws, .. } = scratch;
        indices.clear();
        match frame.indices {
            None => indices.extend(pulses.start as u64..pulses.end as u64),
            Some(numbers) => indices.extend_from_slice(&numbers[pulses.clone()]),
        }
        let batch = frame.pulses(pulses.clone(), indices);
        measurement.effects.draw::<I>(&batch, draws);
        let directions = measurement.effects.directions(&batch, draws);
        let count = pulses.len() * measurement.rays();
        resize(&mut rays.directions, count, [0.0; 3]);
        velocities.object = None;
        let legal = self.aim_all::<I>(pulses.clone(), directions, rays, &mut velocities.origins);
        if !legal {
            return frame.check(pulses);
        }
        rays.times.clear();
        if self.world.scene.moves() {
            for time in &frame.times[pulses] {
                rays.times.extend(std::iter::repeat_n(frame.start + time, measurement.rays()));
            }
        }
        hits.resize(count);
        let rays = Rays {
            origins: rays.origins(),
            directions: &rays.directions,
            times: &rays.times,
            bundle: self.measurement.rays(),
        };
        // The pulses have been checked, so the rays are legal.
        I::call(Cast { world: self.world, rays, range: TRange::RAY, hits: &mut hits.columns() });
        Ok(())
    }

    /// Aims the pulses of a batch, eight at a time, and finds the velocities of their origins if the sensor
    /// moves. False if one has no legal origin or direction. `directions`: those of the batch, with their
    /// jitter.
    #[inline(always)]
    fn aim_all<I: Isa>(
        &self,
        pulses: Range<usize>,
        directions: &[Point],
        rays: &mut RayArrays,
        velocities: &mut Vec<Point>,
    ) -> bool {
        let (frame, mut legal) = (self.frame, true);
        velocities.clear();
        if let (Path::Still(pose), Origins::One(origin)) = (frame.path, frame.origins) {
            legal &= is_finite(origin);
            resize(&mut rays.origins, 1, [0.0; 3]);
            rays.origins[0] = pose.place(origin);
        } else {
            resize(&mut rays.origins, rays.directions.len(), [0.0; 3]);
        }
        if let Path::Still(pose) = frame.path {
            let poses = Pose::splat(pose);
            for first in pulses.clone().step_by(8) {
                let (eight, at) = (first..pulses.end.min(first + 8), first - pulses.start);
                if let Origins::Each(_) = frame.origins {
                    legal &= self.place::<I>(eight.clone(), at, &poses, &mut rays.origins);
                }
                legal &= self.aim::<I>(eight, at, directions, &poses, &mut rays.directions);
            }
            return legal;
        }
        resize(velocities, pulses.len(), [0.0; 3]);
        let (mut times, mut motions) = ([f64::NAN; 8], Motion::UNSET);
        for first in pulses.clone().step_by(8) {
            let (eight, at) = (first..pulses.end.min(first + 8), first - pulses.start);
            // Past the last pulse its time is repeated.
            let then = std::array::from_fn(|k| frame.start + frame.times[(first + k).min(eight.end - 1)]);
            // Pulses of one time are fired from one pose.
            if then != times {
                (times, motions) = (then, frame.path.motions::<I>(&then));
            }
            legal &= self.place::<I>(eight.clone(), at, &motions.pose, &mut rays.origins);
            legal &= self.aim::<I>(eight.clone(), at, directions, &motions.pose, &mut rays.directions);
            if let Some(places) = velocities.as_flattened_mut()[3 * at..].first_chunk_mut() {
                let velocity = motions.load::<I::F64x8>().velocity_of(frame.origins.of_eight::<I>(first));
                simd::store_points::<I>(velocity, places);
                continue;
            }
            for (k, pulse) in eight.enumerate() {
                velocities[at + k] = motions.lane(k).velocity_of(frame.origins.of(pulse));
            }
        }
        legal
    }

    /// Places the origins of up to eight pulses by their poses. `first` is the number of the first pulse in
    /// the batch. False if an origin is not finite.
    #[inline(always)]
    fn place<I: Isa>(
        &self,
        pulses: Range<usize>,
        first: usize,
        poses: &Pose<[f64; 8]>,
        placed: &mut [Point],
    ) -> bool {
        let (origins, rays) = (&self.frame.origins, self.measurement.rays());
        let placed = &mut placed[first * rays..];
        if rays == 1
            && pulses.len() == 8
            && let Some(placed) = placed.as_flattened_mut().first_chunk_mut()
        {
            let origins = origins.of_eight::<I>(pulses.start);
            simd::store_points::<I>(poses.load::<I::F64x8>().place(origins), placed);
            return is_finite(origins);
        }
        let mut legal = true;
        for (k, (pulse, placed)) in pulses.zip(placed.chunks_exact_mut(rays)).enumerate() {
            let origin = origins.of(pulse);
            legal &= is_finite(origin);
            placed.fill(poses.lane(k).place(origin));
        }
        legal
    }

    /// Aims up to eight pulses, as `place`; `aimed` are the directions of the rays of the batch. False if a
    /// direction is not a unit vector.
    #[inline(always)]
    fn aim<I: Isa>(
        &self,
        pulses: Range<usize>,
        first: usize,
        directions: &[Point],
        poses: &Pose<[f64; 8]>,
        aimed: &mut [Point],
    ) -> bool {
        let nominal = &self.frame.directions[pulses.clone()];
        let directions = &directions[first..first + pulses.len()];
        let aimed = &mut aimed[first * self.measurement.rays()..];
        if self.measurement.beam.is_none()
            && let (Some(nominal), Some(directions)) = (nominal.first_chunk(), directions.first_chunk())
            && let Some(aimed) = aimed.as_flattened_mut().first_chunk_mut()
        {
            let (pose, nominal) = (poses.load::<I::F64x8>(), simd::load_points::<I>(nominal));
            let jitters = self.measurement.effects.turns();
            let directions = if jitters { simd::load_points::<I>(directions) } else { nominal };
            simd::store_points::<I>(pose.turn(directions), aimed);
            return is_unit(nominal);
        }
        let mut legal = true;
        for (k, direction) in directions.iter().enumerate() {
            let pose = poses.lane(k);
            legal &= is_unit(nominal[k]);
            let Some(beam) = &self.measurement.beam else {
                aimed[k] = pose.turn(*direction);
                continue;
            };
            let (axis, pose) = (Axis::of(*direction), Pose::<I::F64x8>::splat(&pose));
            for (start, [left, up, length]) in (k * beam.len()..).step_by(8).zip(beam.eights()) {
                let offset = [I::F64x8::load(left), I::F64x8::load(up), I::F64x8::load(length)];
                let beside = pose.turn(axis.beside(offset));
                // The next pulse overwrites what is too much, and after the last there is no room for it.
                if let Some(places) = aimed[start..].first_chunk_mut() {
                    simd::store_points::<I>(beside, flat(places));
                } else {
                    let (mut points, places) = ([[0.0; 3]; 8], &mut aimed[start..]);
                    simd::store_points::<I>(beside, flat(&mut points));
                    places.copy_from_slice(&points[..places.len()]);
                }
            }
        }
        legal
    }
}

/// The coordinates of eight points.
#[inline(always)]
fn flat(points: &mut [Point; 8]) -> &mut [f64; 24] {
    &mut points.as_flattened_mut().as_chunks_mut().0[0]
}
