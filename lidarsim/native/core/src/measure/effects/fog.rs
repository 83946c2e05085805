//! Fog: the air along the whole pulse sends light back, with one peak close to the sensor.
//!
//! A slice dr of the air has the differential backscatter β·dr per unit of area, 1/sr, where a white
//! diffuser at normal incidence has 1/π. So it has the intensity π·β·dr, and the receiver gets
//! π·β·ξ(r)·exp(−2αr)/r²·dr of it, in the unit in which it gets ρ·ξ(R)·exp(−2αR)/R² of a
//! surface: that of the peak of an echo, which the Gaussian pulse gives the shape g(x) = exp(−x²/2σ²).
//! The response of the fog is then
//!
//! W(R) = π·β·∫ g(R − r)·ξ(r)/r²·exp(−2αr) dr
//!
//! (R. H. Rasshofer, M. Spies, H. Spies: Influences of weather phenomena on automotive laser radar systems.
//! Advances in Radio Science 9, 2011; M. Hahner et al.: Fog simulation on real LiDAR point clouds for 3D
//! object detection in adverse weather. ICCV 2021). Its peak is the echo. A surface ends the fog. One nearer
//! than 2σ behind the peak is not resolved from it (Sparrow's criterion): then the fog has no echo of its
//! own. One further off takes away less than 2·Φ(−2) = 4.6 % of the peak: the integrand without g falls
//! beyond its maximum, so where it is ended it is less than all the way from there to the peak. This is
//! neglected.
//!
//! A receiver with a threshold near by sees fog only where it is brighter than on average. The power of its
//! light, x times the mean, is assumed to have Weibull's distribution, that of clutter (M. Sekine, Y. Mao:
//! Weibull Radar Clutter, 1990): P(X > x) = exp(−(Γ(1 + 1/k)·x)^k), of mean 1, independent in each length
//! L = √(2π)·σ of the air, that of the pulse. So the echoes that exceed the least intensity i(R) are a
//! Poisson process along the beam of the density P(X > i(R)/(W(R)·R²))/L. The shape k is 0.7.

use std::f64::consts::{LN_2, PI};

use super::air::{Air, Process, Threshold};
use super::fluctuation::Layers;
use super::near::Near;
use super::particles::{self, Particle};
use super::{Draws, Effect, Pulses};
use crate::arith::elementary::{exp, ln};
use crate::arith::simd::{Floats, Isa};
use crate::measure::beam::{REACH, pulse_sigma};
use crate::measure::parameters::{Parameters, Value};
use crate::measure::rng::EffectId;

/// The echo of fog in front of no surface.
#[derive(Clone, Debug)]
pub(in crate::measure) struct Fog {
    /// m.
    pub(in crate::measure) range: f64,
    /// Received, in the unit of surfaces.
    pub(in crate::measure) power: f64,
    /// A surface nearer than this hides the echo, m.
    pub(in crate::measure) clear_to: f64,
    /// π·β, 1/m.
    strength: f64,
    response: Response,
    /// What is seen instead by a receiver with a threshold near by.
    patches: Option<Patches>,
}

/// Fog that is brighter than the threshold.
#[derive(Clone, Debug)]
struct Patches {
    process: Process,
    threshold: Threshold,
    /// The factors of their power.
    layers: Layers,
    /// Ranges, m, and the mean intensity W(R)·R² there.
    means: Vec<[f64; 2]>,
}

/// The integral of the response.
#[derive(Clone, Debug)]
struct Response {
    air: Air,
    /// Standard deviation of the pulse, m.
    sigma: f64,
}

impl Effect for Fog {
    const ID: Option<EffectId> = Some(EffectId(8));
    /// Uniform numbers that tell how far off the first patch is.
    type Draws = Vec<f64>;

    fn from_parameters<P: Parameters>(parameters: &P) -> Result<Option<Self>, P::Error> {
        let backscatter = parameters.optional_number("atmosphere.backscatter")?.unwrap_or(0.0);
        if backscatter == 0.0 {
            return Ok(None);
        }
        let response = Response { air: Air::from_parameters(parameters)?, sigma: pulse_sigma(parameters)? };
        if response.air.begin == 0.0 {
            // The integral diverges.
            return Err(parameters.unexpected("min_range", Value::Number(0.0)));
        }
        let (range, peak) = response.peak();
        let strength = PI * backscatter;
        let (power, clear_to) = (strength * peak, range + 2.0 * response.sigma);
        let patches = match Near::from_parameters(parameters)? {
            Some(_) => {
                let threshold = Threshold::from_parameters(parameters)?;
                Some(Patches::new(&response, strength, threshold, Layers::from_parameters(parameters)?))
            }
            None => None,
        };
        Ok((power > 0.0).then_some(Fog { range, power, clear_to, strength, response, patches }))
    }

    #[inline(always)]
    fn draw<I: Isa>(&self, pulses: &Pulses, uniforms: &mut Vec<f64>) {
        if self.patches.is_some() {
            pulses.uniforms::<I, Self>(0, uniforms);
        }
    }
}

/// k.
const SHAPE: f64 = 0.7;
/// Γ(1 + 1/k).
const GAMMA: f64 = 1.265_823_506_057_283_4;

/// −ln P(X > x).
fn rarity(x: f64) -> f64 {
    exp(SHAPE * ln((GAMMA * x).min(f64::MAX)))
}

/// The x of this rarity.
fn of_rarity(rarity: f64) -> f64 {
    exp(ln(rarity) / SHAPE) / GAMMA
}

impl Patches {
    fn new(response: &Response, strength: f64, threshold: Threshold, layers: Layers) -> Self {
        const CELLS: u32 = 1 << 8;
        let mean = |range: f64| strength * response.at(range) * range * range;
        let density = |range: f64| {
            let seen = layers.mean(visibility(threshold.at(range) / mean(range)));
            seen / ((2.0 * PI).sqrt() * response.sigma)
        };
        let rarity = |range: f64| rarity(threshold.at(range) / mean(range) / layers.largest());
        // Beyond this range, less than exp(−32) of all patches are seen. Nearer, they may be rarer at places.
        const FARTHEST: f64 = 1e5;
        const RARE: f64 = 32.0;
        let mut end = response.air.overlaps_from().max(1.0);
        while end < FARTHEST && (rarity(end) < RARE || rarity(0.5 * end) < RARE || end < 64.0) {
            end *= 2.0;
        }
        let process = Process::new([response.air.begin, end], CELLS, density);
        let means = process.ranges.iter().map(|range| [*range, mean(*range)]).collect();
        Patches { process, threshold, layers, means }
    }
}

/// The share of the patches that are seen, by the factor of their power. `least`: the least of their light
/// that is seen with the factor 1, as a multiple of the mean.
fn visibility(least: f64) -> impl Fn(f64) -> f64 {
    move |factor| exp(-rarity(least / factor))
}

impl Fog {
    /// Whether it has one echo, in each pulse alike.
    #[inline(always)]
    pub(in crate::measure) fn is_even(&self) -> bool {
        self.patches.is_none()
    }

    /// Patches of a pulse that nothing ends.
    pub(in crate::measure) fn seen_on_average(&self) -> f64 {
        self.patches.as_ref().map_or(0.0, |patches| patches.process.average())
    }

    /// A bit for each of N pulses, those from N·part on, that see a patch.
    #[inline(always)]
    pub(super) fn echo_mask<F: Floats<f64, N>, const N: usize>(&self, draws: &Draws, part: usize) -> u32 {
        self.patches.as_ref().map_or(0, |patches| patches.process.echo_mask::<F, N>(&draws.fog, part))
    }

    /// The patches that a pulse of the batch sees, from the nearest on.
    #[inline(always)]
    pub(super) fn of<'a>(&'a self, batch: &'a Pulses, pulse: usize) -> impl Iterator<Item = Particle> + 'a {
        /// Echoes of the air have so many numbers besides those of particles.
        const MOST: u16 = 10_000;
        self.patches.iter().flat_map(move |Patches { process, threshold, layers, means }| {
            process.echoes::<Self>(batch, pulse, MOST).map(move |echo| {
                let above = means.partition_point(|[range, _]| *range < echo.range).clamp(1, means.len() - 1);
                let ([r0, m0], [r1, m1]) = (means[above - 1], means[above]);
                let mean = m0 + (m1 - m0) * ((echo.range - r0) / (r1 - r0));
                let number = particles::MOST + echo.number;
                let least = threshold.at(echo.range);
                let [largest, factor] = layers.draw(batch, pulse, number, visibility(least / mean));
                let least = least / largest;
                // What exceeds the rarity of the least is exponential.
                let intensity = (mean * of_rarity(rarity(least / mean) + echo.excess)).max(least) * factor;
                Particle { number, range: echo.range, intensity, place: echo.place }
            })
        })
    }

    /// The ranges from which light comes back: up to where it is less than 2⁻²⁴ of what it is at the
    /// full overlap, at most twice as far.
    pub(in crate::measure) fn extent(&self) -> [f64; 2] {
        let air = &self.response.air;
        let light = |range: f64| air.share(range, 0.0) / (range * range);
        let (mut end, least) = (air.overlaps_from(), light(air.overlaps_from()) / f64::from(1 << 24));
        while light(end) > least {
            end *= 2.0;
        }
        [air.begin, end]
    }

    /// The range and the peak power of the echoes whose sum is the response of the air between two ranges:
    /// the nodes of Simpson's rule.
    ///
    /// A step h has an error of (κh)⁴/180 of the integral, where the integrand changes by e over 1/κ:
    /// over σ, r/4 or 1/(2α). With h at most an eighth of each that is below 2·10⁻⁶.
    pub(in crate::measure) fn echoes_between(&self, begin: f64, end: f64, mut add: impl FnMut(f64, f64)) {
        let Response { air, sigma } = &self.response;
        let kink = air.overlaps_from();
        let mut low = begin.max(air.begin);
        while low < end {
            let far = if low < kink { kink.min(2.0 * low) } else { 2.0 * low };
            let high = far.min(end);
            let rate = (1.0 / sigma).max(4.0 / low).max(2.0 * air.extinction);
            let pairs = (4.0 * (high - low) * rate).ceil() as u32;
            let step = (high - low) / f64::from(2 * pairs);
            for k in 0..=2 * pairs {
                let weight = if k == 0 || k == 2 * pairs { 1.0 } else { f64::from(2 + 2 * (k % 2)) };
                let r = low + step * f64::from(k);
                add(r, self.strength * step / 3.0 * weight * air.share(r, 0.0) / (r * r));
            }
            low = high;
        }
    }
}

impl Response {
    /// Where the response has its peak, and how high it is.
    ///
    /// The integrand without g rises to one maximum, at the latest where the overlap is complete, and falls
    /// beyond it; so its convolution with a Gaussian has one peak (I. A. Ibragimov: On the composition of
    /// unimodal distributions. Theory of Probability and its Applications 1, 1956), which a golden-section
    /// search finds. In front of all air the response rises, and it falls where it sees only air behind the
    /// maximum. The peak is found to 2⁻²⁰σ, where it is flat to 2⁻⁴¹ of its height.
    fn peak(&self) -> (f64, f64) {
        let shrink = (5.0_f64.sqrt() - 1.0) / 2.0;
        let (mut low, mut high) = (self.air.begin, self.air.overlaps_from() + REACH * self.sigma);
        let (mut a, mut b) = (high - shrink * (high - low), low + shrink * (high - low));
        let (mut at_a, mut at_b) = (self.at(a), self.at(b));
        let width = self.sigma / f64::from(1 << 20);
        while high - low > width.max(high * f64::EPSILON * 4.0) {
            if at_a < at_b {
                (low, a, at_a) = (a, b, at_b);
                b = low + shrink * (high - low);
                at_b = self.at(b);
            } else {
                (high, b, at_b) = (b, a, at_a);
                a = high - shrink * (high - low);
                at_a = self.at(a);
            }
        }
        let range = low + 0.5 * (high - low);
        (range, self.at(range))
    }

    /// ∫ g(R − r)·ξ(r)/r²·exp(−2αr) dr over all of the air, where the pulse is bright.
    fn at(&self, range: f64) -> f64 {
        let reach = REACH * self.sigma;
        let begin = self.air.begin.max(range - reach);
        // Beyond this way the extinction leaves less than 2⁻³² of what it does at the beginning.
        let end = (range + reach).min(begin + 16.0 * LN_2 / self.air.extinction);
        if begin >= end {
            return 0.0;
        }
        let middle = self.air.overlaps_from().clamp(begin, end);
        self.integral(range, begin, middle) + self.integral(range, middle, end)
    }

    /// The same over some ranges, by Simpson's rule in u = ln r: dr/r² = du/r. It is smooth in u however
    /// near the sensor it begins. A step h has an error of (κh)⁴/180 of the integral, where the integrand
    /// changes by e over 1/κ: with 256 steps over at most 17σ and at most 11.1/α that is below 10⁻⁶.
    fn integral(&self, range: f64, begin: f64, end: f64) -> f64 {
        const STEPS: u32 = 256;
        if begin >= end {
            return 0.0;
        }
        let (first, step) = (ln(begin), (ln(end) - ln(begin)) / f64::from(STEPS));
        let mut sum = 0.0;
        for k in 0..=STEPS {
            let weight = if k == 0 || k == STEPS { 1.0 } else { f64::from(2 + 2 * (k % 2)) };
            let r = exp(first + step * f64::from(k));
            let way = (range - r) / self.sigma;
            sum += weight * self.air.share(r, 0.5 * way * way) / r;
        }
        sum * step / 3.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_echoes_of_the_air_add_up_to_the_peak() {
        for (begin, extinction, sigma) in [(0.5, 0.06, 0.32), (2.0, 0.003, 0.1), (1.0, 0.2, 20.0)] {
            let response = Response { air: Air::clear(begin, extinction), sigma };
            let (range, peak) = response.peak();
            let fog = Fog { range, power: peak, clear_to: 0.0, strength: 1.0, response, patches: None };
            let [first, last] = fog.extent();
            assert_eq!(first, begin);
            let mut sum = 0.0;
            fog.echoes_between(first, last, |r, power| {
                let way = (range - r) / sigma;
                sum += power * exp(-0.5 * way * way);
            });
            assert!((sum / peak - 1.0).abs() < 3e-6, "{begin} {}", sum / peak - 1.0);
            // In two parts, too.
            let mut parts = 0.0;
            for [low, high] in [[first, range], [range, last]] {
                fog.echoes_between(low, high, |r, power| {
                    let way = (range - r) / sigma;
                    parts += power * exp(-0.5 * way * way);
                });
            }
            assert!((parts / peak - 1.0).abs() < 3e-6, "{begin} {}", parts / peak - 1.0);
        }
    }
}
