//! The detection limit: an echo is seen if its power is at least that of a reference target at its greatest
//! range.

use super::fluctuation::{factors_of, turn_into_factors};
use super::{Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa};
use crate::measure::parameters::Parameters;
use crate::measure::rng::EffectId;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct DetectionLimit {
    /// The least power that is seen: ρ/r² of a target of reflectivity ρ that is seen at normal incidence, in
    /// clear air, out to range r.
    pub(super) power: f64,
    /// Standard deviation of the logarithm of the factor by which echoes are multiplied for the comparison.
    pub(super) sigma: f64,
}

impl Effect for DetectionLimit {
    /// Draw i is for the i-th echo of a pulse, from the nearest, counted before any is lost.
    const ID: Option<EffectId> = Some(EffectId(11));
    /// Factors of the first echoes; unused without a `sigma`.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let Some(reflectivity) = parameters.optional_number("measurement.detection.reflectivity")? else {
            return Ok(None);
        };
        let range = parameters.number("measurement.detection.range")?;
        let sigma = parameters.optional_number("measurement.detection.sigma")?.unwrap_or(0.0);
        Ok(Some(DetectionLimit { power: reflectivity / (range * range), sigma }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, factors: &mut Vec<f64>) {
        if self.sigma > 0.0 {
            pulses.normals::<I, Self>(0, factors);
            turn_into_factors(self.sigma, factors);
        }
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        pulses: &Pulses,
        factors: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        // False for the power 0/0 of a black surface at distance zero.
        let mut seen = F::splat(self.power).le(echoes.power);
        if self.sigma > 0.0 {
            let factor = factors_of::<Self, F, N>(self.sigma, pulses, factors, echoes);
            // Of the intensity: near the sensor the power is dulled, and the threshold there is sharp.
            let power = echoes.intensity.div(echoes.range.mul(echoes.range));
            seen = F::splat(self.power).le(power.mul(factor));
        }
        echoes.lose(!seen, Status::BelowThreshold);
    }

    #[inline(always)]
    fn least_intensity<F: Floats<f64, N>, const N: usize>(&self, range: F) -> F {
        F::splat(self.power).mul(range.mul(range))
    }
}

/// The least power that is detected: that of the detection limit; without one, that of a diffuser of the
/// reflectivity 0.1 at the greatest range of the sensor, if there is one.
pub(super) fn least_power<P: Parameters>(parameters: &P) -> Result<Option<f64>, P::Error> {
    if let Some(detection) = DetectionLimit::from_parameters(parameters)? {
        return Ok(Some(detection.power));
    }
    let max_range = parameters.number("max_range")?;
    Ok((max_range < f64::INFINITY).then_some(0.1 / (max_range * max_range)))
}
