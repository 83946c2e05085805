//! Scans: the pulses of a frame, measured on all threads, a batch at a time.

use std::cell::Cell;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use super::appearance::Appearance;
use super::columns::Rows;
use super::direction::reciprocal_length;
use super::frame::{BadPulse, Frame};
use super::light_paths::LightTransport;
use super::measurement::Measurement;
use super::scratch::Scratch;
use crate::arith::simd::{Isa, Task};
use crate::cast::pieces;
use crate::memory::resize;
use crate::scene::World;
use crate::{memory, parallel};

/// A frame fired at a scene.
pub struct Scan<'a> {
    pub frame: &'a Frame<'a>,
    pub measurement: &'a Measurement,
    /// Of each object of the scene.
    pub appearances: &'a [Arc<Appearance>],
    pub world: &'a World<'a>,
    /// None if light goes on from no surface.
    pub transport: Option<LightTransport<'a>>,
}

thread_local! {
    static SCRATCH: Cell<Scratch> = Cell::default();
}

/// The work on a batch of pulses, compiled for each instruction set.
pub struct Batch<'a, 'b, 'c> {
    scan: &'b Scan<'a>,
    pulses: Range<usize>,
    scratch: &'b mut Scratch,
    rows: &'b mut Rows<'c>,
}

impl Task for Batch<'_, '_, '_> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Batch { scan, pulses, scratch, rows } = self;
        I::call(Illuminate { scan, pulses: pulses.clone(), scratch })?;
        resize(&mut scratch.range_rate, rows.radial_velocity.len(), [0.0; 2]);
        if scan.measurement.beam.is_none() && scan.measurement.most_returns() == 1 {
            scan.measure_single_rays::<I>(pulses, scratch, rows);
        } else {
            scan.measure_footprints::<I>(pulses, scratch, rows);
        }
        for (velocity, [along, squared_length]) in rows.radial_velocity.iter_mut().zip(&scratch.range_rate) {
            velocity.write((along * reciprocal_length(*squared_length)) as f32);
        }
        Ok(())
    }
}

/// Fires a batch of pulses, and finds what their light meets.
pub(super) struct Illuminate<'a, 'b> {
    pub(super) scan: &'a Scan<'b>,
    pub(super) pulses: Range<usize>,
    pub(super) scratch: &'a mut Scratch,
}

impl Task for Illuminate<'_, '_> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Illuminate { scan, pulses, scratch } = self;
        scan.fire::<I>(pulses.clone(), scratch)?;
        if scan.measurement.receiver_offset != 0.0 {
            scan.hide::<I>(pulses, scan.measurement.receiver_offset, scratch);
        }
        scratch.paths.clear(scratch.hits.len());
        if let Some(transport) = &scan.transport {
            scan.go_on::<I>(transport, scratch);
        }
        scan.reflect::<I>(scratch);
        Ok(())
    }
}

/// Does work with the memory that the last batch on this thread left.
pub(super) fn with_scratch<R>(work: impl FnOnce(&mut Scratch) -> R) -> R {
    let mut scratch = SCRATCH.take();
    let outcome = work(&mut scratch);
    SCRATCH.set(scratch);
    outcome
}

/// Works on all pieces, on all threads, or returns the least of their errors.
pub(super) fn share<T: Send, E: PartialOrd + Copy + Send>(
    pieces: Vec<T>,
    act: impl Fn(T) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let bad = Mutex::new(None);
    parallel::share(pieces.into_iter(), |piece| {
        if let Err(found) = act(piece) {
            let mut bad = bad.lock().unwrap_or_else(PoisonError::into_inner);
            if bad.is_none_or(|bad| found < bad) {
                *bad = Some(found);
            }
        }
    });
    bad.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

impl Scan<'_> {
    /// Measures all pulses, on all threads, or returns the first bad pulse. `rows` are those of all pulses;
    /// `work` runs a batch.
    pub fn measure(
        &self,
        rows: &mut Rows,
        work: impl Fn(Batch) -> Result<(), BadPulse> + Sync,
    ) -> Result<(), BadPulse> {
        let pieces = pieces(self.frame.directions, self.measurement.rays()).into_iter();
        let pieces = memory::collect(pieces.map(|piece| (piece.clone(), rows.split_off(piece.len()))));
        share(pieces, |(pulses, mut rows)| self.measure_piece(pulses, &mut rows, &work))
    }

    /// Measures some pulses on this thread.
    pub(super) fn measure_piece(
        &self,
        pulses: Range<usize>,
        rows: &mut Rows,
        work: impl Fn(Batch) -> Result<(), BadPulse>,
    ) -> Result<(), BadPulse> {
        with_scratch(|scratch| work(Batch { scan: self, pulses, scratch, rows }))
    }

    /// The object that eight rays hit, if it is one: neighbours often hit the same.
    #[inline(always)]
    pub(super) fn hit_by_all(&self, objects: &[i32; 8]) -> Option<&Appearance> {
        let mut different = 0;
        for object in objects {
            different |= object ^ objects[0];
        }
        if different == 0 { self.appearances.get(objects[0] as usize).map(Arc::as_ref) } else { None }
    }

    #[inline(always)]
    pub(super) fn instance_and_label(&self, object: i32, primitive: i32) -> [u32; 2] {
        let appearance = self.appearances.get(object as usize);
        appearance.map_or([0; 2], |appearance| [appearance.instance, appearance.labels.at(primitive)])
    }
}
