//! The range as the sensor reads it: with all errors, and from the sensor's own zero instead of the beam's
//! origin.

use super::per_ring::PerRing;
use super::{ActsOn, Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::Parameters;

#[derive(Clone, Debug)]
pub(super) struct Reading {
    /// The sensor's own range less the range from the beam's origin, m.
    offset: PerRing,
}

impl Effect for Reading {
    const ACTS_ON: ActsOn = ActsOn::Both;
    /// The offset of each pulse; unspecified if all rings have one.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        Ok(Some(Reading { offset: PerRing::from_parameters(parameters, "range_offset")? }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, offsets: &mut Vec<f64>) {
        if let PerRing::Each(_) = self.offset {
            offsets.clear();
            offsets.resize(pulses.padded_len(), 0.0);
            self.offset.add_to(offsets, pulses);
        }
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        offsets: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        echoes.offset = match self.offset {
            PerRing::All(offset) => F::splat(offset),
            PerRing::Each(_) => lanes::load(offsets, echoes.part),
        };
        echoes.reading = echoes.range.add(echoes.error).add(echoes.offset);
    }
}

impl Reading {
    /// How many rings have an offset, if each has its own.
    pub(super) fn rings(&self) -> Option<usize> {
        self.offset.rings()
    }
}
