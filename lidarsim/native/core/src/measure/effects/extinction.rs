//! Extinction: the atmosphere weakens light on its way out and back, by exp(−2αR).

use super::Effect;
use crate::arith::elementary::exp;
use crate::measure::parameters::Parameters;

#[derive(Clone, Debug)]
pub(super) struct Extinction {
    /// α, 1/m.
    coefficient: f64,
}

impl Effect for Extinction {
    const ATTENUATES: bool = true;
    type Draws = ();

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let coefficient = Extinction::coefficient(parameters)?;
        Ok((coefficient > 0.0).then_some(Extinction { coefficient }))
    }

    #[inline(always)]
    fn attenuate(&self, ranges: &[f64], transmission: &mut [f64]) {
        for (transmission, range) in transmission.iter_mut().zip(ranges) {
            *transmission *= exp(-2.0 * self.coefficient * range);
        }
    }
}

impl Extinction {
    /// α: that of the measurement and that of the scene's atmosphere, 1/m.
    pub(super) fn coefficient<P: Parameters>(parameters: &P) -> Result<f64, P::Error> {
        let of_scene = parameters.optional_number("atmosphere.extinction")?.unwrap_or(0.0);
        Ok(parameters.number("measurement.extinction")? + of_scene)
    }
}
