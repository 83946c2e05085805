//! Rain and snow: single drops and flakes in the beam, each with an echo.
//!
//! Their diameters D are distributed by N(D) = N₀·exp(−ΛD), per volume and diameter (J. S. Marshall,
//! W. M. Palmer: The distribution of raindrops with size. Journal of Meteorology 5, 1948). In a beam of the
//! section A(r), uniformly bright, a particle has the share q·D²·π/4/A(r) of the intensity of a white
//! diffuser that fills the beam. It is seen if its power is at least that of the detection limit, so if D
//! ≥ D₀(r): those that are seen are a Poisson process along the beam of the density
//! A(r)·(N₀/Λ)·exp(−Λ·D₀(r)), with diameters that exceed D₀ by an exponential variable of the
//! mean 1/Λ. So no other particle is ever drawn.

use std::f64::consts::{FRAC_PI_4, PI};

pub(super) use super::air::MOST;
use super::air::{Air, Event, Process, Threshold};
use super::fluctuation::Layers;
use super::{Draws, Effect, Pulses};
use crate::arith::elementary::exp;
use crate::arith::simd::{Floats, Isa};
use crate::measure::beam::divergence;
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(in crate::measure) struct Particles {
    sight: Sight,
    /// The rate at which their density falls with diameter: Λ, 1/m.
    slope: f64,
    /// The factors of their power.
    layers: Layers,
    /// Those that are seen.
    process: Process,
}

/// How a particle is seen.
#[derive(Clone, Debug)]
struct Sight {
    air: Air,
    /// q·π/4.
    reflectance: f64,
    /// Full widths of the beam at the sensor, m, and full angles, rad.
    aperture: f64,
    divergence: [f64; 2],
    threshold: Threshold,
}

/// A drop or flake in the beam.
pub(in crate::measure) struct Particle {
    /// Its number in the pulse, from the nearest on.
    pub(in crate::measure) number: u16,
    pub(in crate::measure) range: f64,
    pub(in crate::measure) intensity: f64,
    /// Uniform from 0 to 1: where in the beam it is.
    pub(in crate::measure) place: f64,
}

impl Effect for Particles {
    const ID: Option<EffectId> = Some(EffectId(7));
    /// Uniform numbers that tell how far off the first particle is.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let intercept = parameters.optional_number("atmosphere.intercept")?.unwrap_or(0.0);
        if intercept == 0.0 {
            return Ok(None);
        }
        let threshold = Threshold::from_parameters(parameters)?;
        if threshold.power == 0.0 {
            return Err(parameters.unexpected("max_range", Value::Number(f64::INFINITY)));
        }
        let divergence = match divergence(parameters)? {
            Some(divergence) => divergence,
            None => [parameters.number("atmosphere.divergence")?; 2],
        };
        let sight = Sight {
            air: Air::from_parameters(parameters)?,
            reflectance: parameters.number("atmosphere.reflectance")? * FRAC_PI_4,
            aperture: parameters.number("atmosphere.aperture")?,
            divergence,
            threshold,
        };
        let slope = parameters.number("atmosphere.slope")?;
        Ok(Some(Particles::new(sight, Layers::from_parameters(parameters)?, intercept, slope)))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, uniforms: &mut Vec<f64>) {
        pulses.uniforms::<I, Self>(0, uniforms);
    }
}

impl Sight {
    /// A(r), m².
    fn section(&self, range: f64) -> f64 {
        let [azimuth, elevation] = self.divergence.map(|angle| 0.5 * (self.aperture + range * angle));
        PI * azimuth * elevation
    }

    /// The intensity of a particle of the diameter 1.
    fn unit_intensity(&self, range: f64) -> f64 {
        self.air.share(range, 0.0) * self.reflectance / self.section(range)
    }

    /// D₀(r), m, of a power that is a factor of the mean. Infinite where no light comes back.
    fn least_diameter(&self, range: f64, factor: f64) -> f64 {
        (self.threshold.at(range) / factor / self.unit_intensity(range)).sqrt()
    }

    /// The share of the particles at a range that are seen, by the factor of their power.
    fn visibility(&self, range: f64, slope: f64) -> impl Fn(f64) -> f64 {
        let least = self.least_diameter(range, 1.0);
        move |factor| exp(-slope * (least / factor.sqrt()))
    }

    /// The range from which on no particle is seen: at twice this range, its diameter would be one that
    /// exp(−64) of all exceed.
    fn end(&self, layers: &Layers, slope: f64) -> f64 {
        const FARTHEST: f64 = 1e5;
        const RARE: f64 = 64.0;
        let mut range = self.air.overlaps_from().max(1.0);
        while range < FARTHEST && slope * self.least_diameter(range, layers.largest()) < RARE {
            range *= 2.0;
        }
        range.min(FARTHEST.max(self.air.begin))
    }
}

impl Particles {
    fn new(sight: Sight, layers: Layers, intercept: f64, slope: f64) -> Self {
        const CELLS: u32 = 1 << 10;
        // Of those seen, per length of the beam, 1/m.
        let density = |range: f64| {
            let seen = layers.mean(sight.visibility(range, slope));
            sight.section(range) * intercept / slope * seen
        };
        let process = Process::new([sight.air.begin, sight.end(&layers, slope)], CELLS, density);
        Particles { sight, slope, layers, process }
    }

    /// Particles of a pulse that nothing ends.
    pub(in crate::measure) fn seen_on_average(&self) -> f64 {
        self.process.average()
    }

    /// A bit for each of N pulses, those from N·part on, that see a particle.
    #[inline(always)]
    pub(in crate::measure) fn echo_mask<F: Floats<f64, N>, const N: usize>(
        &self,
        draws: &Draws,
        part: usize,
    ) -> u32 {
        self.process.echo_mask::<F, N>(&draws.particles, part)
    }

    /// The particles that a pulse of the batch sees, from the nearest on.
    #[inline(always)]
    pub(in crate::measure) fn of<'a>(
        &'a self,
        batch: &'a Pulses,
        pulse: usize,
    ) -> impl Iterator<Item = Particle> + 'a {
        self.process.echoes::<Self>(batch, pulse, MOST).map(move |Event { number, range, excess, place }| {
            let sight = &self.sight;
            let visibility = sight.visibility(range, self.slope);
            let [largest, factor] = self.layers.draw(batch, pulse, number, visibility);
            let diameter = sight.least_diameter(range, largest) + excess / self.slope;
            let intensity = diameter * diameter * sight.unit_intensity(range);
            // At most that of a white diffuser that fills the beam.
            let intensity = intensity.min(sight.air.share(range, 0.0)) * factor;
            Particle { number, range, intensity, place }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::Portable;
    use crate::measure::rng::Stream;

    struct Rain;

    impl Parameters for Rain {
        type Error = &'static str;

        fn value(&self, name: &'static str) -> Result<Value, Self::Error> {
            Ok(match name {
                "atmosphere.intercept" => Value::Number(8e6),
                "atmosphere.slope" => Value::Number(2528.0),
                "atmosphere.reflectance" => Value::Number(0.0236),
                "atmosphere.aperture" => Value::Number(0.01),
                "atmosphere.divergence" => Value::Number(0.003),
                "measurement.detection.reflectivity" => Value::Number(0.1),
                "measurement.detection.range" => Value::Number(100.0),
                "measurement.extinction"
                | "measurement.near_threshold"
                | "measurement.power_sigma"
                | "min_range" => Value::Number(0.0),
                _ => Value::Nothing,
            })
        }

        fn unexpected(&self, name: &'static str, _: Value) -> Self::Error {
            name
        }
    }

    #[test]
    fn particles_rise_in_range_and_are_seen() {
        let rain = Particles::from_parameters(&Rain).unwrap().unwrap();
        assert!(rain.process.counts.windows(2).all(|two| two[0] <= two[1]));
        let indices: Vec<u64> = (0..4096).collect();
        let batch = Pulses { stream: Stream::new(1, 2, 3), indices: &indices, rings: &[], directions: &[] };
        let mut draws = Draws::default();
        rain.draw::<Portable>(&batch, &mut draws.particles);
        let mut count = 0;
        for pulse in 0..indices.len() {
            let particles: Vec<Particle> = rain.of(&batch, pulse).collect();
            assert_eq!(rain.echo_mask::<f64, 1>(&draws, pulse) != 0, !particles.is_empty());
            assert!(particles.windows(2).all(|two| two[0].range < two[1].range));
            // The least diameter is rounded.
            let is_seen = |p: &Particle| p.intensity / (p.range * p.range) > 0.9999 * 0.1 / 1e4;
            assert!(particles.iter().all(is_seen));
            count += particles.len();
        }
        let mean = rain.seen_on_average() * indices.len() as f64;
        assert!(mean > 100.0 && (count as f64 - mean).abs() < 5.0 * mean.sqrt());
        assert_eq!([rain.process.range_of(0.0), rain.process.range_of(1e9)], [None; 2]);
    }
}
