//! The threshold near the sensor.
//!
//! A receiver that detects a target of reflectivity ρ out to r would see one 10⁻⁴ as bright at r/100. Real
//! ones are desensitised after each pulse, and their gain rises with time, so that near by an echo must have
//! a least intensity i: power i/R², which falls with range until it meets the limit ρ/r² of detection. In
//! other words, the gain for power is that of the far limit from r·√(i/ρ) on, and rises with R² up to there.

use super::air::least_power;
use super::{Echoes, Effect, Pulses};
use crate::arith::simd::Floats;
use crate::measure::parameters::Parameters;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct Near {
    /// i.
    pub(super) intensity: f64,
    /// The power that is the least both near by and far off, in units of i, 1/m²: 1/R² of that range.
    gain: f64,
}

impl Effect for Near {
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let intensity = Near::intensity(parameters)?;
        if intensity == 0.0 {
            return Ok(None);
        }
        let least_power = least_power(parameters)?;
        Ok(Some(Near { intensity, gain: least_power.map_or(0.0, |power| power / intensity) }))
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, (): &(), echoes: &mut Echoes<F, N>) {
        let seen = F::splat(self.intensity).le(echoes.intensity);
        let near = F::splat(self.gain).mul(echoes.range).mul(echoes.range).lt(F::splat(1.0));
        echoes.lose(near & !seen, Status::BelowThreshold);
        if self.gain > 0.0 {
            // What the receiver compares with other echoes and with its noise.
            echoes.power = echoes.power.min(echoes.intensity.mul(F::splat(self.gain)));
        }
    }
}

impl Near {
    /// i; 0 if there is no such threshold.
    pub(super) fn intensity<P: Parameters>(parameters: &P) -> Result<f64, P::Error> {
        parameters.number("measurement.near_threshold")
    }
}
