//! Biases of the range: one of the sensor, and one of each channel, which is drawn once for the unit.

use super::{Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, lanes};
use crate::measure::parameters::Parameters;
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(super) struct Bias {
    /// Of all channels, m.
    sensor: f64,
    /// Standard deviation of the bias of a channel, m.
    channel_sigma: f64,
}

impl Effect for Bias {
    /// The channel, its ring, takes the place of the pulse, and the frame is 0.
    const ID: Option<EffectId> = Some(EffectId(4));
    /// The bias of each pulse, m; unspecified if channels have none of their own.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let sensor = parameters.number("measurement.range_bias")?;
        let channel_sigma = parameters.number("measurement.channel_bias_sigma")?;
        Ok((sensor != 0.0 || channel_sigma > 0.0).then_some(Bias { sensor, channel_sigma }))
    }

    #[inline(always)]
    fn draw(&self, pulses: &Pulses, biases: &mut Vec<f64>) {
        if self.channel_sigma > 0.0 {
            pulses.normals_of_channels::<Self>(0, biases);
            for bias in biases {
                *bias = self.sensor + self.channel_sigma * *bias;
            }
        }
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        biases: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        let bias =
            if self.channel_sigma > 0.0 { lanes::load(biases, echoes.part) } else { F::splat(self.sensor) };
        echoes.error = bias;
    }
}
