//! Fluctuation of the received power, from echo to echo: a log-normal factor of mean 1, which the intensity
//! has, too.

use super::{Echoes, Effect, Pulses};
use crate::arith::elementary::exp;
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::Parameters;
use crate::measure::rng::{EffectId, normal_quantile};

#[derive(Clone, Debug)]
pub(super) struct Fluctuation {
    /// w, the standard deviation of the factor's logarithm.
    pub(super) sigma: f64,
}

impl Effect for Fluctuation {
    /// Draw i is for the i-th echo of a pulse, from the nearest, counted before any is lost.
    const ID: Option<EffectId> = Some(EffectId(5));
    /// Factors of the first echoes. Those of further echoes are drawn as they come.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let sigma = parameters.number("measurement.power_sigma")?;
        Ok((sigma > 0.0).then_some(Fluctuation { sigma }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, factors: &mut Vec<f64>) {
        pulses.normals::<I, Self>(0, factors);
        turn_into_factors(self.sigma, factors);
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        pulses: &Pulses,
        factors: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        let factor = factors_of::<Self, F, N>(self.sigma, pulses, factors, echoes);
        echoes.intensity = echoes.intensity.mul(factor);
        echoes.power = echoes.power.mul(factor);
    }
}

/// The factors of N echoes: those of the first echoes of pulses are in `firsts`, others are drawn.
#[inline(always)]
pub(super) fn factors_of<E: Effect, F: Floats<f64, N>, const N: usize>(
    sigma: f64,
    pulses: &Pulses,
    firsts: &[f64],
    echoes: &Echoes<F, N>,
) -> F {
    match echoes.number {
        0 => lanes::load(firsts, echoes.part),
        number => {
            let mut factors = pulses.lane_normals::<E, F, N>(number, echoes).store();
            turn_into_factors(sigma, &mut factors);
            F::load(&factors)
        }
    }
}

/// A bound of all factors of this width that are ever drawn.
pub(super) fn largest_factor(sigma: f64) -> f64 {
    // The uniform numbers that normals are made of are at most 1 − 2⁻⁵³.
    let mut factor = [normal_quantile(1.0 - 0.5 * f64::EPSILON)];
    turn_into_factors(sigma, &mut factor);
    factor[0]
}

/// exp(w·g − w²/2) of normals g: of mean 1. Written as a product, it has no ∞ − ∞ for any w.
#[inline(always)]
pub(super) fn turn_into_factors(sigma: f64, normals: &mut [f64]) {
    for normal in normals {
        *normal = exp(sigma * (*normal - 0.5 * sigma));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_are_log_normal_of_mean_1() {
        let mut factors = [0.0, 1.0, -1.0];
        turn_into_factors(2.0, &mut factors);
        assert_eq!(factors, [exp(-2.0), 1.0, exp(-4.0)]);
        let mut factors = [-8.3, 8.3];
        turn_into_factors(f64::MAX, &mut factors);
        assert_eq!(factors, [0.0; 2]);
    }
}
