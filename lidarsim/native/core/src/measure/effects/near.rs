//! The threshold near the sensor.
//!
//! A receiver that detects a target of reflectivity ρ out to r would see one 10⁻⁴ as bright at r/100. Real
//! ones are desensitised after each pulse, and their gain rises with time. So near by an echo must have a
//! least intensity i: a power of i/R², up to a range n. From there on this falls with 1/R⁴ until it meets
//! the limit ρ/r² of detection, which holds farther off.

use super::detection::least_power;
use super::{Echoes, Effect, Pulses};
use crate::arith::simd::Floats;
use crate::measure::parameters::Parameters;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct Near {
    /// i.
    intensity: f64,
    /// n, m.
    range: f64,
    /// The limit of detection; 0 if unknown.
    least_power: f64,
}

impl Effect for Near {
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let intensity = parameters.number("measurement.near_threshold")?;
        if intensity == 0.0 {
            return Ok(None);
        }
        let range = parameters.number("measurement.near_range")?;
        Ok(Some(match least_power(parameters)? {
            Some(least_power) => Near { intensity, range, least_power },
            // Nothing takes over.
            None => Near { intensity, range: f64::INFINITY, least_power: 0.0 },
        }))
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, (): &(), echoes: &mut Echoes<F, N>) {
        let least = self.least_intensity(echoes.range);
        let far = F::splat(self.least_power).mul(echoes.range).mul(echoes.range);
        echoes.lose(far.lt(least) & !least.le(echoes.intensity), Status::BelowThreshold);
        if self.least_power > 0.0 {
            // What the receiver compares with other echoes and with its noise: the gain is what the far limit
            // has of the threshold.
            let dulled = echoes.intensity.mul(F::splat(self.least_power).div(least));
            echoes.power = echoes.power.min(dulled);
        }
    }

    #[inline(always)]
    fn least_intensity<F: Floats<f64, N>, const N: usize>(&self, range: F) -> F {
        let fall = F::splat(self.range).div(range);
        F::splat(self.intensity).mul(fall.mul(fall).min(F::splat(1.0)))
    }
}
