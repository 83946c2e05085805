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
