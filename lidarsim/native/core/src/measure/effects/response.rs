//! The response: the number that a sensor reports for an intensity.
//!
//! I' = min(limit, round(h((I·f(R)·c)^e·(1 + σgs)))), with a factor f against range, a factor c of the
//! channel, an exponent e, a normal g, a normal s of the channel and block, or 1, and a curve h. It comes
//! last, so that noise and detection have seen I.

use super::fluctuation::turn_into_factors;
use super::range_noise::interpolate;
use super::{Echoes, Effect, Pulses};
use crate::arith::elementary::{exp, ln};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(super) struct Response {
    /// (range, factor) with rising ranges: linear between, constant outside. Empty: 1.
    range: Vec<[f64; 2]>,
    exponent: f64,
    /// σ.
    sigma: f64,
    /// Pulses of a frame that share their channels' s. 0: s is 1.
    block: u64,
    /// (intensity, reported), both rising: linear between, constant outside. Empty: the intensity itself.
    curve: Vec<[f64; 2]>,
    /// Standard deviation of the logarithm of the factor of a channel.
    ring_sigma: f64,
    /// 0: none.
    resolution: f64,
    limit: f64,
}

/// Per pulse: the factor of its channel, a normal for its first echo, and s of its channel and block.
#[derive(Default)]
pub(super) struct Drawn {
    factors: Vec<f64>,
    normals: Vec<f64>,
    strengths: Vec<f64>,
}

/// The effect by whose id channels draw: their factors, with the ring in place of the pulse and frame 0, and
/// s of each block.
pub(super) struct Channels;

impl Effect for Channels {
    const ID: Option<EffectId> = Some(EffectId(10));
    type Draws = ();

    fn from_parameters<P: Parameters>(_: &P) -> Result<Option<Self>, P::Error> {
        Ok(None)
    }
}

impl Effect for Response {
    /// Draw i is for the i-th echo of a pulse, from the nearest, counted before any is lost.
    const ID: Option<EffectId> = Some(EffectId(9));
    type Draws = Drawn;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let Some(exponent) = parameters.optional_number("measurement.response.exponent")? else {
            return Ok(None);
        };
        let rows = |name| match parameters.value(name)? {
            Value::Nothing => Ok(Vec::new()),
            Value::Rows(rows) => Ok(rows),
            other => Err(parameters.unexpected(name, other)),
        };
        Ok(Some(Response {
            range: rows("measurement.response.range")?,
            curve: rows("measurement.response.curve")?,
            exponent,
            sigma: parameters.number("measurement.response.sigma")?,
            block: parameters.number("measurement.response.sigma_block")? as u64,
            ring_sigma: parameters.number("measurement.response.ring_sigma")?,
            resolution: parameters.number("measurement.response.resolution")?,
            limit: parameters.number("measurement.response.limit")?,
        }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, Drawn { factors, normals, strengths }: &mut Drawn) {
        if self.ring_sigma > 0.0 {
            pulses.normals_of_channels::<I, Channels>(0, factors);
            turn_into_factors(self.ring_sigma, factors);
        }
        if self.sigma > 0.0 {
            pulses.normals::<I, Self>(0, normals);
            if self.block > 0 {
                pulses.normals_of_blocks::<I, Channels>(self.block, 1, strengths);
            }
        }
    }

    #[inline(always)]
    fn report<F: Floats<f64, N>, const N: usize>(
        &self,
        pulses: &Pulses,
        drawn: &Drawn,
        echoes: &mut Echoes<F, N>,
    ) {
        let mut intensity = echoes.intensity;
        if !self.range.is_empty() {
            let mut factors = echoes.range.store();
            interpolate(&self.range, &mut factors);
            intensity = intensity.mul(F::load(&factors));
        }
        if self.ring_sigma > 0.0 {
            intensity = intensity.mul(lanes::load(&drawn.factors, echoes.part));
        }
        if self.exponent != 1.0 {
            let mut powers = intensity.store();
            for number in &mut powers {
                let power = exp(self.exponent * ln(*number));
                // Also for 0 and NaN.
                *number = if *number > 0.0 { power } else { *number };
            }
            intensity = F::load(&powers);
        }
        if self.sigma > 0.0 {
            let mut normal = match echoes.number {
                0 => lanes::load(&drawn.normals, echoes.part),
                number => pulses.lane_normals::<Self, F, N>(number, echoes),
            };
            if self.block > 0 {
                normal = normal.mul(lanes::load(&drawn.strengths, echoes.part));
            }
            let factor = F::splat(1.0).add(F::splat(self.sigma).mul(normal));
            intensity = intensity.mul(factor.max(F::splat(0.0)));
        }
        if !self.curve.is_empty() {
            let mut reported = intensity.store();
            interpolate(&self.curve, &mut reported);
            intensity = F::load(&reported);
        }
        if self.resolution > 0.0 {
            let mut counts = intensity.store();
            for count in &mut counts {
                *count = (*count / self.resolution).round_ties_even() * self.resolution;
            }
            intensity = F::load(&counts);
        }
        echoes.intensity = intensity.min(F::splat(self.limit));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::rng::Stream;

    #[test]
    fn an_intensity_becomes_a_count() {
        let response = Response {
            range: vec![[1.0, 0.5], [3.0, 1.0]],
            exponent: 0.5,
            sigma: 0.0,
            block: 0,
            curve: vec![[0.0, 0.0], [1.0, 1.0], [9.0, 2.0]],
            ring_sigma: 0.0,
            resolution: 0.25,
            limit: 1.25,
        };
        let pulses = Pulses { stream: Stream::new(1, 2, 3), indices: &[0], rings: &[0], directions: &[] };
        let report = |range: f64, intensity: f64| {
            let mut echoes = Echoes::<f64, 1>::new(0, 0, range, intensity, intensity / (range * range), 0);
            response.report(&pulses, &Drawn::default(), &mut echoes);
            echoes.intensity
        };
        // √(0.5·0.5), √(0.75·1), √0.02, and of √9 and √121 the eighths beyond 1 at most.
        assert_eq!(report(0.5, 0.5), 0.5);
        assert_eq!(report(2.0, 1.0), 0.75);
        assert_eq!([report(9.0, 0.02), report(9.0, 0.0)], [0.25, 0.0]);
        assert_eq!([report(9.0, 9.0), report(9.0, 121.0)], [1.25, 1.25]);
    }
}
