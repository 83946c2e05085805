//! The tasks that are compiled as a whole for each instruction set. The crate of an instruction set compiles
//! them while this one is compiled.

use crate::arith::simd::Runner;
use crate::cast::{Cast, Columns, Occlusion};
use crate::measure::{BadPulse, Batch, CoverPiece, InstancePulses, Recording, WritePoints};
use crate::patterns::ColumnPiece;
use crate::scene::{Rays, TRange, World};

/// The work on a piece of a cast or of a scan, compiled for one instruction set.
pub trait Kernels: Sync {
    /// The closest hit of each ray with t_min ≤ t ≤ t_max. Of equal t the lowest object comes first,
    /// then the lowest primitive. False if there was an illegal ray (see [`Cast`]).
    fn cast(&self, world: &World, rays: Rays, range: TRange, hits: &mut Columns) -> bool;

    /// Whether each ray hits anything with t_min ≤ t ≤ t_max. False if there was an illegal ray.
    fn find_occluded(&self, world: &World, rays: Rays, range: TRange, occlusion: &mut Occlusion) -> bool;

    /// The pulses of each instance, of a piece of the pulses.
    fn cover(&self, piece: CoverPiece) -> Vec<InstancePulses>;

    /// Writes the points and normals of a piece of a cloud.
    fn write_points(&self, points: WritePoints);

    /// Measures a batch of pulses, or returns the first bad pulse.
    fn measure(&self, batch: Batch) -> Result<(), BadPulse>;

    /// Records the waveforms of a batch of pulses, or returns the first bad pulse.
    fn record(&self, recording: Recording) -> Result<(), BadPulse>;

    /// Writes the pulses of a piece of a frame. False if a prism reflects one of them totally.
    fn fire(&self, piece: ColumnPiece) -> bool;
}

impl<R: Runner> Kernels for R {
    fn cast(&self, world: &World, rays: Rays, range: TRange, hits: &mut Columns) -> bool {
        R::run(Cast { world, rays, range, hits })
    }

    fn find_occluded(&self, world: &World, rays: Rays, range: TRange, occlusion: &mut Occlusion) -> bool {
        R::run(Cast { world, rays, range, hits: occlusion })
    }

    fn cover(&self, piece: CoverPiece) -> Vec<InstancePulses> {
        R::run(piece)
    }

    fn write_points(&self, points: WritePoints) {
        R::run(points);
    }

    fn measure(&self, batch: Batch) -> Result<(), BadPulse> {
        R::run(batch)
    }

    fn record(&self, recording: Recording) -> Result<(), BadPulse> {
        R::run(recording)
    }

    fn fire(&self, piece: ColumnPiece) -> bool {
        R::run(piece)
    }
}
