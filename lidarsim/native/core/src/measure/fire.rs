//! From pulses to hits: each pulse is fired from the pose at its time, as one ray or as the sub-rays of a
//! beam.

use std::ops::Range;

use super::caster::Caster;
use super::direction::{Axis, is_finite, is_unit};
use super::effects::Pulses;
use super::frame::{BadPulse, Frame};
use super::origins::Origins;
use super::scan::Scan;
use super::scratch::{RayArrays, Scratch, Velocities};
use crate::arith::simd::{self, Floats, Isa};
use crate::geometry::pose::{Motion, Path, Pose};
use crate::geometry::vector::Point;
use crate::memory::resize;
use crate::scene::Rays;

impl Frame<'_> {
    /// Pulses as effects see them; `indices`: their numbers in the whole frame.
    #[inline(always)]
    pub(super) fn pulses<'a>(&'a self, pulses: Range<usize>, indices: &'a [u64]) -> Pulses<'a> {
        let (rings, directions) = (&self.rings[pulses.clone()], &self.directions[pulses]);
        Pulses { stream: self.stream, indices, rings, directions }
    }
}

impl<C: Caster> Scan<'_, C> {
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
        measurement.effects.draw(&batch, draws);
        let directions = measurement.effects.directions(&batch, draws);
        let count = pulses.len() * measurement.rays();
        resize(&mut rays.origins, count, [0.0; 3]);
        resize(&mut rays.directions, count, [0.0; 3]);
        velocities.origins.clear();
        velocities.index.clear();
        velocities.object = None;
        let (mut start, mut legal) = (pulses.start, true);
        while start < pulses.end {
            // Pulses of one time are fired from one pose.
            let mut end = pulses.end;
            let pose = if let Path::Still(pose) = frame.path {
                *pose
            } else {
                end = start + equal_to_first::<1>(frame.times[start..pulses.end].as_chunks().0);
                let motion = frame.path.motion(frame.start + frame.times[start]);
                velocities.push(&frame.origins, start..end, &motion);
                motion.pose
            };
            legal &= self.aim::<I>(start..end, start - pulses.start, directions, &pose, rays);
            start = end;
        }
        if !legal {
            return frame.check(pulses);
        }
        rays.times.clear();
        if self.caster.moves() {
            let times = frame.times[pulses].iter().map(|time| frame.start + time);
            rays.times.extend(times.flat_map(|time| std::iter::repeat_n(time, measurement.rays())));
        }
        hits.resize(count);
        let rays = Rays {
            origins: &rays.origins,
            directions: &rays.directions,
            times: &rays.times,
            bundle: self.measurement.rays(),
        };
        self.caster.cast::<I>(rays, hits);
        Ok(())
    }

    /// Aims pulses from a pose, the first of which is number `first` of the batch. False if one has no legal
    /// origin or direction. `directions`: those of the batch, with their jitter.
    #[inline(always)]
    fn aim<I: Isa>(
        &self,
        pulses: Range<usize>,
        first: usize,
        directions: &[Point],
        pose: &Pose,
        rays: &mut RayArrays,
    ) -> bool {
        let (origins, nominal) = (&self.frame.origins, &self.frame.directions[pulses.clone()]);
        let jitters = self.measurement.effects.turns();
        let directions = &directions[first..first + pulses.len()];
        let first = first * self.measurement.rays();
        let (ray_origins, ray_directions) = (&mut rays.origins[first..], &mut rays.directions[first..]);
        let mut legal = true;
        if let Some(beam) = &self.measurement.beam {
            let mut first = 0;
            for (pulse, (nominal, direction)) in pulses.zip(nominal.iter().zip(directions)) {
                let origin = origins.of(pulse);
                legal &= is_finite(origin) & is_unit(*nominal);
                ray_origins[first..first + beam.len()].fill(pose.place(origin));
                let axis = Axis::of(*direction);
                for (start, [left, up, length]) in (first..).step_by(8).zip(beam.eights()) {
                    let offset = [I::F64x8::load(left), I::F64x8::load(up), I::F64x8::load(length)];
                    let beside = pose.turn(axis.beside(offset));
                    // The next pulse overwrites what is too much, and after the last there is no room for it.
                    if let Some(places) = ray_directions[start..].first_chunk_mut() {
                        simd::store_points::<I>(beside, flat(places));
                    } else {
                        let (mut points, places) = ([[0.0; 3]; 8], &mut ray_directions[start..]);
                        simd::store_points::<I>(beside, flat(&mut points));
                        places.copy_from_slice(&points[..places.len()]);
                    }
                }
                first += beam.len();
            }
            return legal;
        }
        let places = ray_origins.as_flattened_mut().as_chunks_mut().0.iter_mut();
        let places = places.zip(ray_directions.as_flattened_mut().as_chunks_mut().0);
        let eights = nominal.as_chunks().0.iter().zip(directions.as_chunks().0).zip(places);
        for (pulse, ((nominal, directions), (o, d))) in pulses.clone().step_by(8).zip(eights) {
            let (origins, nominal) = (origins.of_eight::<I>(pulse), simd::load_points::<I>(nominal));
            legal &= is_finite(origins) & is_unit(nominal);
            simd::store_points::<I>(pose.place(origins), o);
            let directions = if jitters { simd::load_points::<I>(directions) } else { nominal };
            simd::store_points::<I>(pose.turn(directions), d);
        }
        for i in pulses.len() / 8 * 8..pulses.len() {
            let origin = origins.of(pulses.start + i);
            legal &= is_finite(origin) & is_unit(nominal[i]);
            (ray_origins[i], ray_directions[i]) = (pose.place(origin), pose.turn(directions[i]));
        }
        legal
    }
}

/// The coordinates of eight points.
#[inline(always)]
fn flat(points: &mut [Point; 8]) -> &mut [f64; 24] {
    &mut points.as_flattened_mut().as_chunks_mut().0[0]
}

impl Velocities {
    /// Adds the velocities of the origins of pulses that are fired at one time.
    #[inline(always)]
    fn push(&mut self, origins: &Origins, pulses: Range<usize>, motion: &Motion) {
        let next = self.origins.len() as u32;
        let common = match origins {
            Origins::One(origin) => Some(*origin),
            Origins::Each(origins) => {
                let origins = &origins[pulses.clone()];
                (equal_to_first(origins) == origins.len()).then(|| origins[0])
            }
        };
        if let Some(origin) = common {
            self.origins.push(motion.velocity_of(origin));
            self.index.resize(self.index.len() + pulses.len(), next);
        } else {
            let count = pulses.len();
            self.origins.extend(pulses.map(|pulse| motion.velocity_of(origins.of(pulse))));
            self.index.extend((next..).take(count));
        }
    }
}

/// The number of elements from the first on that are equal to it. Eight at a time become vector instructions.
#[inline(always)]
fn equal_to_first<const N: usize>(elements: &[[f64; N]]) -> usize {
    let first = elements[0];
    let is_equal = |element: &[f64; N]| (0..N).fold(true, |all, k| all & (element[k] == first[k]));
    let are_equal = |eight: &&[[f64; N]; 8]| eight.iter().fold(true, |all, element| all & is_equal(element));
    let whole = 8 * elements.as_chunks().0.iter().take_while(are_equal).count();
    whole + elements[whole..].iter().take_while(|element| is_equal(element)).count()
}
