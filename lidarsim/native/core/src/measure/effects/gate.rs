//! The range gate: it acts on the reading, noise and quantisation included.

use super::{ActsOn, Echoes, Effect, Pulses};
use crate::arith::simd::Floats;
use crate::measure::parameters::Parameters;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct Gate {
    min_range: f64,
    /// Finite: noise may carry a reading beyond what float64 holds.
    max_range: f64,
}

impl Effect for Gate {
    const ACTS_ON: ActsOn = ActsOn::Both;
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let (min_range, max_range) = (parameters.number("min_range")?, parameters.number("max_range")?);
        Ok(Some(Gate { min_range, max_range: max_range.min(f64::MAX) }))
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, (): &(), echoes: &mut Echoes<F, N>) {
        let within = echoes.reading.le(F::splat(self.max_range));
        echoes.lose(echoes.reading.lt(F::splat(self.min_range)), Status::BelowMinRange);
        // Also the NaN of an infinite range with an infinite error.
        echoes.lose(!within, Status::BeyondMaxRange);
    }
}
