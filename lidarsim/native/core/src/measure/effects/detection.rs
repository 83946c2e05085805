//! The detection limit: an echo is seen if its power is at least that of a reference target at its greatest
//! range.

use super::{Echoes, Effect, Pulses};
use crate::arith::simd::Floats;
use crate::measure::parameters::Parameters;
use crate::measure::status::Status;

#[derive(Clone, Debug)]
pub(super) struct DetectionLimit {
    /// The least power that is seen: ρ/r² of a target of reflectivity ρ that is seen at normal incidence, in
    /// clear air, out to range r.
    pub(super) power: f64,
}

impl Effect for DetectionLimit {
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let Some(reflectivity) = parameters.optional_number("measurement.detection.reflectivity")? else {
            return Ok(None);
        };
        let range = parameters.number("measurement.detection.range")?;
        Ok(Some(DetectionLimit { power: reflectivity / (range * range) }))
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(&self, _: &Pulses, (): &(), echoes: &mut Echoes<F, N>) {
        // False for the power 0/0 of a black surface at distance zero.
        let seen = F::splat(self.power).le(echoes.power);
        echoes.lose(!seen, Status::BelowThreshold);
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
