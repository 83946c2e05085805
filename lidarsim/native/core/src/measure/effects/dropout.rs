//! Random drop-out of pulses.

use super::{ActsOn, Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::Parameters;
use crate::measure::rng::EffectId;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct Dropout {
    /// Probability that a pulse is lost, with all of its echoes.
    probability: f64,
}

impl Effect for Dropout {
    const ID: Option<EffectId> = Some(EffectId(2));
    const ACTS_ON: ActsOn = ActsOn::Both;
    /// Uniform numbers.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let probability = parameters.number("measurement.dropout")?;
        Ok((probability > 0.0).then_some(Dropout { probability }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, uniforms: &mut Vec<f64>) {
        pulses.uniforms::<I, Self>(0, uniforms);
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        uniforms: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        let uniform: F = lanes::load(uniforms, echoes.part);
        echoes.lose(uniform.lt(F::splat(self.probability)), Status::Dropped);
    }
}
