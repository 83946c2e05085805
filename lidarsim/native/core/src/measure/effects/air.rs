//! What echoes of fog, rain and snow have in common: where the receiver sees the air, how much of its light
//! comes back, how much of it is detected, and that single echoes are a Poisson process along the beam.

use super::crossover::Crossover;
use super::detection::{DetectionLimit, least_power};
use super::extinction::Extinction;
use super::fluctuation::largest_factor;
use super::near::Near;
use super::{Effect, Pulses, id};
use crate::arith::elementary::{exp, ln};
use crate::arith::simd::{Floats, lanes};
use crate::measure::parameters::Parameters;

#[derive(Clone, Debug)]
pub(super) struct Air {
    /// From here on the receiver sees the air, m.
    pub(super) begin: f64,
    crossover: Option<Crossover>,
    /// α, 1/m.
    pub(super) extinction: f64,
}

impl Air {
    /// The receiver sees the air from where the overlap of beam and receiver begins. Without an overlap, or
    /// if it begins at the sensor, it is blind up to its least range.
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        let crossover = Crossover::from_parameters(parameters)?;
        let near = crossover.as_ref().map_or(0.0, |crossover| crossover.near);
        let begin = if near > 0.0 { near } else { parameters.number("min_range")? };
        Ok(Air { begin, crossover, extinction: Extinction::coefficient(parameters)? })
    }

    /// From here on the overlap is 1.
    pub(super) fn overlaps_from(&self) -> f64 {
        self.crossover.as_ref().map_or(self.begin, |crossover| self.begin.max(crossover.far))
    }

    /// ξ(r)·exp(−2αr − x).
    pub(super) fn share(&self, range: f64, x: f64) -> f64 {
        let share = exp(-2.0 * self.extinction * range - x);
        self.crossover.as_ref().map_or(share, |crossover| crossover.gather(range, share))
    }

    /// Air that the receiver sees in full from a range on.
    #[cfg(test)]
    pub(super) fn clear(begin: f64, extinction: f64) -> Self {
        Air { begin, crossover: None, extinction }
    }
}

/// The weakest light that is detected.
#[derive(Clone, Debug)]
pub(super) struct Threshold {
    /// Power. 0 if unknown.
    pub(super) power: f64,
    /// The least power that any draw of a soft detection limit lets through.
    least: f64,
    near: Option<Near>,
}

impl Threshold {
    pub(super) fn from_parameters<P: Parameters>(parameters: &P) -> Result<Self, P::Error> {
        let power = least_power(parameters)?.unwrap_or(0.0);
        let detection = DetectionLimit::from_parameters(parameters)?;
        let least = power / detection.map_or(1.0, |limit| largest_factor(limit.sigma));
        Ok(Threshold { power, least, near: Near::from_parameters(parameters)? })
    }

    /// The least intensity at a range that may be seen.
    pub(super) fn at(&self, range: f64) -> f64 {
        let far = self.least * range * range;
        self.near.as_ref().map_or(far, |near| far.max(near.least_intensity(range)))
    }
}

/// An echo of a process: its number in the pulse, its range, and two more draws.
pub(super) struct Event {
    pub(super) number: u16,
    pub(super) range: f64,
    /// Exponential, of the mean 1.
    pub(super) excess: f64,
    /// Uniform from 0 to 1.
    pub(super) place: f64,
}

/// Draws of an event: the way to it, in numbers of events; its excess; its place.
const DRAWS: u16 = 3;
/// The draws of a pulse have 16 bits.
pub(super) const MOST: u16 = u16::MAX / DRAWS;

/// A Poisson process along the beam.
#[derive(Clone, Debug)]
pub(super) struct Process {
    /// Ranges, m, and how many echoes nearer than each a pulse has on average.
    pub(super) ranges: Vec<f64>,
    pub(super) counts: Vec<f64>,
    /// The probability that a pulse has none.
    none: f64,
}

impl Process {
    /// Integrates a density, 1/m, by Simpson's rule in each of the cells, which are narrower near the sensor.
    pub(super) fn new([begin, end]: [f64; 2], cells: u32, density: impl Fn(f64) -> f64) -> Self {
        let at = |k: u32| {
            let way = f64::from(k) / f64::from(cells);
            begin + (end - begin) * way * way
        };
        let (mut ranges, mut counts) = (vec![begin], vec![0.0]);
        let (mut count, mut at_low) = (0.0, density(begin));
        for k in 1..=cells {
            let (low, high) = (at(k - 1), at(k));
            let (middle, at_high) = (density(low + 0.5 * (high - low)), density(high));
            count += (high - low) / 6.0 * (at_low + 4.0 * middle + at_high);
            at_low = at_high;
            ranges.push(high);
            counts.push(count);
        }
        Process { ranges, counts, none: exp(-count) }
    }

    /// Echoes of a pulse that nothing ends.
    pub(super) fn average(&self) -> f64 {
        *self.counts.last().unwrap_or(&0.0)
    }

    /// A bit for each of N pulses, those from N·part on, that have an echo. `uniforms`: the first draw of
    /// each pulse.
    #[inline(always)]
    pub(super) fn echo_mask<F: Floats<f64, N>, const N: usize>(&self, uniforms: &[f64], part: usize) -> u32 {
        let uniform: F = lanes::load(uniforms, part);
        F::splat(self.none).le(uniform)
    }

    /// The first `most` echoes of a pulse of the batch, from the nearest on.
    #[inline(always)]
    pub(super) fn echoes<'a, E: Effect>(
        &'a self,
        batch: &'a Pulses,
        pulse: usize,
        most: u16,
    ) -> impl Iterator<Item = Event> + use<'a, E> {
        let (pulse, mut way) = (batch.indices[pulse], 0.0);
        let uniform = move |draw: u16| batch.stream.uniform(pulse, const { id::<E>() }, draw);
        (0..most.min(MOST)).map_while(move |number| {
            way -= ln(uniform(DRAWS * number));
            let range = self.range_of(way)?;
            let (excess, place) = (-ln(uniform(DRAWS * number + 1)), uniform(DRAWS * number + 2));
            Some(Event { number, range, excess, place })
        })
    }

    /// The range nearer than which so many echoes are on average, if ever.
    pub(super) fn range_of(&self, count: f64) -> Option<f64> {
        let above = self.counts.partition_point(|nearer| *nearer < count);
        let (high, low) = (*self.counts.get(above)?, self.counts[above.checked_sub(1)?]);
        let (near, far) = (self.ranges[above - 1], self.ranges[above]);
        Some(near + (far - near) * ((count - low) / (high - low)))
    }
}
