//! False returns: what the receiver takes for an echo though no surface sent light back.

use super::{ActsOn, Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct FalseReturns {
    /// Probability that a pulse has a false return.
    probability: f64,
    /// The range gate, m: its near end, and its finite length.
    nearest: f64,
    length: f64,
}

/// Uniform numbers for each pulse.
#[derive(Default)]
pub(super) struct Uniforms {
    chance: Vec<f64>,
    place: Vec<f64>,
}

const CHANCE: u16 = 0;
const PLACE: u16 = 1;

impl Effect for FalseReturns {
    const ID: Option<EffectId> = Some(EffectId(6));
    const ACTS_ON: ActsOn = ActsOn::FalseReturns;
    type Draws = Uniforms;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let probability = parameters.number("measurement.false_returns")?;
        if probability == 0.0 {
            return Ok(None);
        }
        let (nearest, farthest) = (parameters.number("min_range")?, parameters.number("max_range")?);
        if farthest == f64::INFINITY {
            return Err(parameters.unexpected("max_range", Value::Number(farthest)));
        }
        Ok(Some(FalseReturns { probability, nearest, length: farthest - nearest }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, draws: &mut Uniforms) {
        pulses.uniforms::<I, Self>(CHANCE, &mut draws.chance);
        pulses.uniforms::<I, Self>(PLACE, &mut draws.place);
    }

    /// Reads a range, uniform over the gate, for those of N pulses that have a false return.
    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        draws: &Uniforms,
        echoes: &mut Echoes<F, N>,
    ) {
        let chance: F = lanes::load(&draws.chance, echoes.part);
        echoes.lose(!chance.lt(F::splat(self.probability)), Status::Miss);
        let place: F = lanes::load(&draws.place, echoes.part);
        echoes.reading = F::splat(self.nearest).add(F::splat(self.length).mul(place));
    }
}
