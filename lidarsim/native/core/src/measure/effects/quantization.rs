//! Quantisation of the reading, to the nearest multiple of the least significant bit, halves to even.

use super::{ActsOn, Echoes, Effect, Pulses};
use crate::arith::simd::Floats;
use crate::measure::parameters::Parameters;

#[derive(Clone, Debug)]
pub(super) struct Quantization {
    /// m.
    step: f64,
}

impl Effect for Quantization {
    const ACTS_ON: ActsOn = ActsOn::Both;
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let step = parameters.number("measurement.range_resolution")?;
        Ok((step > 0.0).then_some(Quantization { step }))
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, (): &(), echoes: &mut Echoes<F, N>) {
        let mut readings = echoes.reading.store();
        for reading in &mut readings {
            *reading = (*reading / self.step).round_ties_even() * self.step;
        }
        echoes.reading = F::load(&readings);
    }
}
