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

use super::air::Air;
use super::detection::DetectionLimit;
use super::fluctuation::Fluctuation;
use super::{Draws, Effect, Pulses};
use crate::arith::elementary::{exp, ln};
use crate::arith::simd::{Floats, lanes};
use crate::measure::beam::divergence;
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;

#[derive(Clone, Debug)]
pub(in crate::measure) struct Particles {
    sight: Sight,
    /// The density at diameter 0 and the rate at which it falls: N₀, 1/m⁴, and Λ, 1/m.
    intercept: f64,
    slope: f64,
    /// Ranges, m, and how many particles nearer than each are seen of a pulse, on average.
    ranges: Vec<f64>,
    counts: Vec<f64>,
    /// The probability that a pulse sees none.
    none: f64,
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
    least_power: f64,
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

/// Draws of a particle: the way to it, in numbers of particles; its size; its place.
const DRAWS: u16 = 3;
/// The draws of a pulse have 16 bits.
const MOST: u16 = u16::MAX / DRAWS;

impl Effect for Particles {
    const ID: Option<EffectId> = Some(EffectId(7));
    /// Uniform numbers that tell how far off the first particle is.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let intercept = parameters.optional_number("atmosphere.intercept")?.unwrap_or(0.0);
        if intercept == 0.0 {
            return Ok(None);
        }
        let least_power = least_power(parameters)?;
        let fluctuation = Fluctuation::from_parameters(parameters)?;
        let brightest = fluctuation.map_or(1.0, |fluctuation| fluctuation.largest_factor());
        let divergence = match divergence(parameters)? {
            Some(divergence) => divergence,
            None => [parameters.number("atmosphere.divergence")?; 2],
        };
        let sight = Sight {
            air: Air::from_parameters(parameters)?,
            reflectance: parameters.number("atmosphere.reflectance")? * FRAC_PI_4,
            aperture: parameters.number("atmosphere.aperture")?,
            divergence,
            least_power: least_power / brightest,
        };
        let slope = parameters.number("atmosphere.slope")?;
        Ok(Some(Particles::new(sight, intercept, slope)))
    }

    #[inline(always)]
    fn draw(&self, pulses: &Pulses, uniforms: &mut Vec<f64>) {
        pulses.uniforms::<Self>(0, uniforms);
    }
}

/// The power of the weakest particle that is seen: that of the detection limit; without one, that of a
/// diffuser of the reflectivity 0.1 at the greatest range of the sensor.
fn least_power<P: Parameters>(parameters: &P) -> Result<f64, P::Error> {
    if let Some(detection) = DetectionLimit::from_parameters(parameters)? {
        return Ok(detection.power);
    }
    let max_range = parameters.number("max_range")?;
    if max_range == f64::INFINITY {
        return Err(parameters.unexpected("max_range", Value::Number(max_range)));
    }
    Ok(0.1 / (max_range * max_range))
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

    /// D₀(r), m. Infinite where no light comes back.
    fn least_diameter(&self, range: f64) -> f64 {
        (self.least_power / self.unit_intensity(range)).sqrt() * range
    }
}

impl Particles {
    fn new(sight: Sight, intercept: f64, slope: f64) -> Self {
        let mut particles =
            Particles { sight, intercept, slope, ranges: Vec::new(), counts: Vec::new(), none: 1.0 };
        particles.tabulate();
        particles.none = exp(-particles.seen_on_average());
        particles
    }

    /// Particles of a pulse that nothing ends.
    pub(in crate::measure) fn seen_on_average(&self) -> f64 {
        *self.counts.last().unwrap_or(&0.0)
    }

    /// Of those seen, per length of the beam, 1/m.
    fn density(&self, range: f64) -> f64 {
        let seen = exp(-self.slope * self.sight.least_diameter(range));
        self.sight.section(range) * self.intercept / self.slope * seen
    }

    /// Integrates the density, by Simpson's rule in each of the cells, which are narrower near the sensor.
    fn tabulate(&mut self) {
        const CELLS: u32 = 1 << 10;
        let (begin, end) = (self.sight.air.begin, self.end());
        let at = |k: u32| {
            let way = f64::from(k) / f64::from(CELLS);
            begin + (end - begin) * way * way
        };
        let mut count = 0.0;
        for k in 0..=CELLS {
            if k > 0 {
                let (low, high) = (at(k - 1), at(k));
                let middle = self.density(low + 0.5 * (high - low));
                count += (high - low) / 6.0 * (self.density(low) + 4.0 * middle + self.density(high));
            }
            self.ranges.push(at(k));
            self.counts.push(count);
        }
    }

    /// The range from which on no particle is seen: at twice this range, its diameter would be one that
    /// exp(−64) of all exceed.
    fn end(&self) -> f64 {
        const FARTHEST: f64 = 1e5;
        const RARE: f64 = 64.0;
        let mut range = self.sight.air.overlaps_from().max(1.0);
        while range < FARTHEST && self.slope * self.sight.least_diameter(range) < RARE {
            range *= 2.0;
        }
        range.min(FARTHEST.max(self.sight.air.begin))
    }

    /// A bit for each of N pulses, those from N·part on, that see a particle.
    #[inline(always)]
    pub(in crate::measure) fn seen<F: Floats<f64, N>, const N: usize>(
        &self,
        draws: &Draws,
        part: usize,
    ) -> u32 {
        let uniform: F = lanes::load(&draws.particles, part);
        F::splat(self.none).le(uniform)
    }

    /// The particles that a pulse of the batch sees, from the nearest on.
    #[inline(always)]
    pub(in crate::measure) fn of<'a>(
        &'a self,
        batch: &'a Pulses,
        pulse: usize,
    ) -> impl Iterator<Item = Particle> + 'a {
        let (number, mut way) = (batch.indices[pulse], 0.0);
        let exponential =
            move |draw: u16| -ln(batch.stream.uniform(number, const { super::id::<Self>() }, draw));
        (0..MOST).map_while(move |k| {
            way += exponential(DRAWS * k);
            let range = self.range_of(way)?;
            let diameter = self.sight.least_diameter(range) + exponential(DRAWS * k + 1) / self.slope;
            let intensity = diameter * diameter * self.sight.unit_intensity(range);
            let place = batch.stream.uniform(number, const { super::id::<Self>() }, DRAWS * k + 2);
            // At most that of a white diffuser that fills the beam.
            let intensity = intensity.min(self.sight.air.share(range, 0.0));
            Some(Particle { number: k, range, intensity, place })
        })
    }

    /// The range nearer than which so many are seen on average, if ever.
    fn range_of(&self, count: f64) -> Option<f64> {
        let above = self.counts.partition_point(|nearer| *nearer < count);
        let (high, low) = (*self.counts.get(above)?, self.counts[above.checked_sub(1)?]);
        let (near, far) = (self.ranges[above - 1], self.ranges[above]);
        Some(near + (far - near) * ((count - low) / (high - low)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
                "measurement.extinction" | "measurement.power_sigma" | "min_range" => Value::Number(0.0),
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
        assert!(rain.counts.windows(2).all(|two| two[0] <= two[1]));
        let indices: Vec<u64> = (0..4096).collect();
        let batch = Pulses { stream: Stream::new(1, 2, 3), indices: &indices, rings: &[], directions: &[] };
        let mut draws = Draws::default();
        rain.draw(&batch, &mut draws.particles);
        let mut count = 0;
        for pulse in 0..indices.len() {
            let particles: Vec<Particle> = rain.of(&batch, pulse).collect();
            assert_eq!(rain.seen::<f64, 1>(&draws, pulse) != 0, !particles.is_empty());
            assert!(particles.windows(2).all(|two| two[0].range < two[1].range));
            // The least diameter is rounded.
            let is_seen = |p: &Particle| p.intensity / (p.range * p.range) > 0.9999 * 0.1 / 1e4;
            assert!(particles.iter().all(is_seen));
            count += particles.len();
        }
        let mean = rain.seen_on_average() * indices.len() as f64;
        assert!(mean > 100.0 && (count as f64 - mean).abs() < 5.0 * mean.sqrt());
        assert_eq!([rain.range_of(0.0), rain.range_of(1e9)], [None; 2]);
    }
}
