//! Fluctuation of the received power, from echo to echo: a log-normal factor of mean 1, which the intensity
//! has, too.

use super::{Echoes, Effect, FIRST_NUMBER, Pulses, id};
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
    /// Draw i is for the i-th echo of a pulse, from the nearest, counted before any is lost; those of single
    /// echoes of the air are uniform.
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
        if echoes.number > FIRST_NUMBER {
            return; // a single echo of the air has its factor from `Layers`
        }
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
    factor(sigma, 1.0 - 0.5 * f64::EPSILON)
}

/// The factor that a share of all factors are below.
fn factor(sigma: f64, share: f64) -> f64 {
    let mut factor = [normal_quantile(share)];
    turn_into_factors(sigma, &mut factor);
    factor[0]
}

/// The factors of single echoes of the air. They are drawn with the echoes, of which only those are drawn
/// that may be seen: a bright echo is seen with nearly all factors, a faint one with few.
///
/// Layer k has the factors from the quantile of 1 − 2⁻ᵏ to that of 1 − 2⁻⁽ᵏ⁺¹⁾, the last layer
/// all larger ones. An echo with a factor of a layer is drawn if it would be seen with the largest one there.
#[derive(Clone, Debug)]
pub(super) struct Layers {
    sigma: f64,
    /// The largest factor of each layer.
    largest: Vec<f64>,
}

impl Layers {
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        const COUNT: u32 = 25;
        let Some(Fluctuation { sigma }) = Fluctuation::from_parameters(parameters)? else {
            return Ok(Layers { sigma: 0.0, largest: vec![1.0] });
        };
        let layers = (1..COUNT).map(|k| factor(sigma, 1.0 - one_in(k)));
        Ok(Layers { sigma, largest: layers.chain([largest_factor(sigma)]).collect() })
    }

    /// The largest of all factors.
    pub(super) fn largest(&self) -> f64 {
        self.largest[self.largest.len() - 1]
    }

    /// Each layer's share of all factors, and its largest.
    fn layers(&self) -> impl Iterator<Item = (f64, f64)> {
        let last = self.largest.len() as u32 - 1;
        (1..).zip(&self.largest).map(move |(k, largest)| (one_in(last.min(k)), *largest))
    }

    /// The mean of a probability that rises with the factor, taken at the largest factor of each layer.
    pub(super) fn mean(&self, probability: impl Fn(f64) -> f64) -> f64 {
        self.layers().map(|(share, largest)| share * probability(largest)).sum()
    }

    /// Draws the factor of an echo; returns the largest of its layer, and the factor.
    ///
    /// `spot`: the number of the echo among the single ones of its pulse. `probability`: that for the mean.
    pub(super) fn draw(
        &self,
        batch: &Pulses,
        pulse: usize,
        spot: u16,
        probability: impl Fn(f64) -> f64,
    ) -> [f64; 2] {
        if self.sigma == 0.0 {
            return [1.0; 2];
        }
        let (pulse, draw) = (batch.indices[pulse], FIRST_NUMBER + 1 + spot);
        self.at(batch.stream.uniform(pulse, const { id::<Fluctuation>() }, draw), probability)
    }

    /// The same for a uniform number.
    fn at(&self, uniform: f64, probability: impl Fn(f64) -> f64) -> [f64; 2] {
        let (mut left, mut below, mut found) = (uniform * self.mean(&probability), 0.0, [1.0; 2]);
        for (share, largest) in self.layers() {
            let part = share * probability(largest);
            let within = if part > 0.0 { (left / part).min(1.0) } else { 1.0 };
            found = [largest, factor(self.sigma, (below + within * share).min(1.0 - 0.5 * f64::EPSILON))];
            if left < part {
                break;
            }
            (left, below) = (left - part, below + share);
        }
        found
    }
}

/// 2⁻ᵏ.
fn one_in(k: u32) -> f64 {
    1.0 / f64::from(1 << k)
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
    fn spots_have_the_factors_with_which_they_are_seen() {
        let last = largest_factor(0.5);
        let largest = (1..25).map(|k| factor(0.5, 1.0 - one_in(k))).chain([last]).collect();
        let layers = Layers { sigma: 0.5, largest };
        assert!(layers.largest.is_sorted() && layers.largest() == last);
        assert_eq!(layers.mean(|_| 1.0), 1.0);
        let numbers = || (0..1000).map(|i| (f64::from(i) + 0.5) / 1000.0);
        // Four roundings of a share, 2⁻⁵³ each, move its quantile by at most 4·2⁻⁵³/φ(3.7), and the logarithm
        // of the factor by half of that: 5.3·10⁻¹³.
        for uniform in numbers() {
            // If each factor is seen, they are those of all echoes.
            let [largest, drawn] = layers.at(uniform, |_| 1.0);
            assert!((drawn / factor(0.5, uniform) - 1.0).abs() < 1e-12 && drawn <= largest * (1.0 + 1e-12));
        }
        // If the largest quarter of the factors is seen, they are of this quarter.
        let least = 1.0001 * factor(0.5, 0.75);
        let seen = |factor: f64| f64::from(u8::from(factor >= least));
        assert_eq!(layers.mean(seen), 0.25);
        let mut found: Vec<f64> = numbers().map(|uniform| layers.at(uniform, seen)[1]).collect();
        found.sort_by(f64::total_cmp);
        for (uniform, found) in numbers().zip(found) {
            assert!((found / factor(0.5, 0.75 + 0.25 * uniform) - 1.0).abs() < 1e-12);
        }
    }

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
