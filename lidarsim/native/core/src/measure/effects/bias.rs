//! Biases of the range: as given, of the sensor or of each channel, and drawn once for each channel.

use super::per_ring::PerRing;
use super::{Echoes, Effect, Pulses};
use crate::arith::simd::{Floats, Isa, lanes};
use crate::measure::parameters::Parameters;
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(super) struct Bias {
    /// As given, m.
    given: PerRing,
    /// Standard deviation of the drawn bias of a channel, m.
    channel_sigma: f64,
}

impl Effect for Bias {
    /// The channel, its ring, takes the place of the pulse, and the frame is 0.
    const ID: Option<EffectId> = Some(EffectId(4));
    /// The bias of each pulse, m; unspecified if all have the same.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let given = PerRing::from_parameters(parameters, "measurement.range_bias")?;
        let channel_sigma = parameters.number("measurement.channel_bias_sigma")?;
        let is_none = matches!(given, PerRing::All(0.0)) && channel_sigma == 0.0;
        Ok((!is_none).then_some(Bias { given, channel_sigma }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, biases: &mut Vec<f64>) {
        if self.of_sensor().is_some() {
            return;
        }
        biases.clear();
        if self.channel_sigma > 0.0 {
            pulses.normals_of_channels::<I, Self>(0, biases);
            biases.iter_mut().for_each(|bias| *bias *= self.channel_sigma);
        }
        biases.resize(pulses.padded_len(), 0.0);
        self.given.add_to(biases, pulses);
    }

    #[inline(always)]
    fn apply<F: Floats<f64, N>, const N: usize>(
        &self,
        _: &Pulses,
        biases: &Vec<f64>,
        echoes: &mut Echoes<F, N>,
    ) {
        echoes.error = self.of_sensor().map_or_else(|| lanes::load(biases, echoes.part), F::splat);
    }
}

impl Bias {
    /// The bias, if all channels have the same.
    #[inline(always)]
    fn of_sensor(&self) -> Option<f64> {
        match self.given {
            PerRing::All(bias) if self.channel_sigma == 0.0 => Some(bias),
            _ => None,
        }
    }

    /// How many rings have a bias, if each has its own as given.
    pub(super) fn rings(&self) -> Option<usize> {
        self.given.rings()
    }
}
