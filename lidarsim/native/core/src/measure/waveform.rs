//! The waveform of a pulse, and its echoes.

use std::ops::Range;

use super::beam::{Beam, REACH};
use super::echo::{Echo, Light};
use super::scratch::Scratch;
use super::slopes::Gaussians;
use crate::arith::simd::Isa;
use crate::geometry::point::dot;

/// Received light over range: a sum of one Gaussian for each sub-ray, as wide as the pulse, with the power of
/// the sub-ray. Its peaks are the echoes; an echo has all light between the valleys on either side.
///
/// A sub-ray samples its part of the footprint. On a slanted surface the light of that part is spread in
/// range, which widens the Gaussian: σᵢ² = σ² + δᵢ²/2. Here δᵢ is the change of range along the
/// tangent plane to the next sub-ray, where the light of this one has fallen to 1/e. So the waveform of a
/// plane has one peak for any number of sub-rays and any spread of their ranges, as that of a continuous
/// footprint has.
///
/// Two equal surfaces, each at one range, are separate echoes if they are more than 2σ apart, 0.85 of the
/// full width at half maximum of the pulse (Sparrow's criterion).
///
/// Its memory is reused from one pulse to the next.
#[derive(Default)]
pub(super) struct Waveform {
    lights: Vec<Light>,
    /// σᵢ² of each light.
    variances: Vec<f64>,
    /// Where the slope of the waveform is sampled, rising, and how many lights are nearer than that.
    samples: Vec<f64>,
    before: Vec<usize>,
    slopes: Vec<f64>,
    gaussians: Gaussians,
    /// The lights of each peak.
    peaks: Vec<Range<usize>>,
    /// The peaks that the receiver tells apart.
    told_apart: Vec<Peak>,
}

/// A peak in clear air, so that extinction decides nothing about it.
#[derive(Clone, Copy)]
struct Peak {
    /// Its number, from the nearest on.
    number: usize,
    range: f64,
    power: f64,
}

impl Waveform {
    /// The echoes of the `pulse`-th pulse of the batch, by rising range.
    #[inline(always)]
    pub(super) fn echoes<I: Isa>(
        &mut self,
        beam: &Beam,
        scratch: &Scratch,
        pulse: usize,
        echoes: &mut Vec<Echo>,
    ) {
        let Waveform { lights, .. } = self;
        echoes.clear();
        if let Some(echo) = scratch.only_echo(beam, pulse) {
            echoes.push(echo);
            return;
        }
        lights.clear();
        lights
            .extend(beam.sub_rays(pulse).filter_map(|(ray, share)| Some(scratch.light_of(ray)?.dim(share))));
        if !scratch.paths.is_empty() {
            for (ray, share) in beam.sub_rays(pulse) {
                lights.extend(scratch.further_lights(ray).map(|light| light.dim(share)));
            }
        }
        let (least, most) =
            lights.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), l| (a.min(l.range), b.max(l.range)));
        // Where the slope is zero, the curvature has at most the sign of V/σ² − 1, with V a variance of
        // the lights' ranges: (extent/2)² at most. So up to an extent of 2σ each such place is a peak, and
        // there is one.
        if most - least <= 2.0 * beam.pulse_sigma {
            echoes.extend((!lights.is_empty()).then(|| scratch.merge(lights)));
            return;
        }
        lights.sort_unstable_by(|a, b| a.range.total_cmp(&b.range).then(a.ray.cmp(&b.ray)));
        self.sample_slopes::<I>(beam, scratch, pulse);
        self.peaks.clear();
        let (mut first, mut falls) = (0, false);
        for (slope, before) in self.slopes.iter().zip(&self.before) {
            if *slope > 0.0 && falls && *before > first {
                self.peaks.push(first..*before);
                first = *before;
            }
            falls = *slope < 0.0 || falls && *slope == 0.0;
        }
        self.peaks.push(first..self.lights.len());
        if beam.separation > 0.0 {
            self.tell_apart(beam.separation);
            let peaks = self.told_apart.iter().map(|peak| self.peaks[peak.number].clone());
            echoes.extend(peaks.map(|peak| scratch.merge(&self.lights[peak])));
        } else {
            echoes.extend(self.peaks.iter().map(|peak| scratch.merge(&self.lights[peak.clone()])));
        }
    }

    /// Finds the peaks that are told apart: of two nearer to each other than `separation`, the stronger, and
    /// the nearer if they are equal. The strongest of all is decided first.
    fn tell_apart(&mut self, separation: f64) {
        let Waveform { lights, peaks, told_apart, .. } = self;
        told_apart.clear();
        told_apart
            .extend(peaks.iter().enumerate().map(|(number, peak)| Peak::of(number, &lights[peak.clone()])));
        told_apart.sort_unstable_by(|a, b| b.power.total_cmp(&a.power).then(a.number.cmp(&b.number)));
        let mut kept = 0;
        for i in 0..told_apart.len() {
            let peak = told_apart[i];
            if told_apart[..kept].iter().all(|other| (peak.range - other.range).abs() >= separation) {
                told_apart[kept] = peak;
                kept += 1;
            }
        }
        told_apart.truncate(kept);
        told_apart.sort_unstable_by_key(|peak| peak.number);
    }

    /// The slope of the waveform at each light, and between each two where a valley between them would show:
    /// the light of the one falls most steeply against the rise of the other's at a from the first and b
    /// from the second with a·b = σ², if they are of one width and more than 2σ apart. Else they have no
    /// valley of their own, but others may make one: half way.
    #[inline(always)]
    fn sample_slopes<I: Isa>(&mut self, beam: &Beam, scratch: &Scratch, pulse: usize) {
        let Waveform { lights, variances, samples, before, gaussians, slopes, .. } = self;
        let first = pulse * beam.len();
        variances.clear();
        variances.extend(lights.iter().map(|light| scratch.variance(beam, light, first)));
        samples.clear();
        before.clear();
        for (i, light) in lights.iter().enumerate() {
            samples.push(light.range);
            before.push(i);
            let Some(next) = lights.get(i + 1) else { break };
            let gap = next.range - light.range;
            let inside = |variance: f64| {
                // Further apart, the one is dark where the other is.
                let gap = gap.min(2.0 * REACH * variance.sqrt());
                0.5 * (gap - (gap * gap - 4.0 * variance).max(0.0).sqrt())
            };
            let (low, high) = (light.range + inside(variances[i]), next.range - inside(variances[i + 1]));
            samples.push(low);
            before.push(i + 1);
            if low < high {
                samples.push(high);
                before.push(i + 1);
            }
        }
        gaussians.clear();
        for (light, variance) in lights.iter().zip(&*variances) {
            // Of a black surface there is no light, and no variance where it is grazed.
            if light.clear_power > 0.0 {
                gaussians.add(light.range, light.clear_power, *variance);
            }
        }
        gaussians.slopes::<I>(samples, slopes);
    }
}

impl Peak {
    fn of(number: usize, lights: &[Light]) -> Self {
        let nearest = lights[0].range;
        let power: f64 = lights.iter().map(|l| l.clear_power).sum();
        let moment: f64 = lights.iter().map(|l| l.clear_power * (l.range - nearest)).sum();
        // Perhaps no power, either.
        Peak { number, range: nearest + mean(moment, power), power: power.max(0.0) }
    }
}

impl Scratch {
    /// σᵢ² of a light. `first`: the first ray of the pulse.
    #[inline(always)]
    pub(super) fn variance(&self, beam: &Beam, light: &Light, first: usize) -> f64 {
        beam.pulse_sigma * beam.pulse_sigma + 0.5 * self.to_next_sub_ray(beam, light, first)
    }

    /// The square of by how much the range changes from a light to the next sub-ray, on the tangent plane of
    /// what it hit, where that changes most. `first`: the first ray of the pulse.
    ///
    /// Rays of direction d from one point meet the plane of normal n where R·n·d is the same, so dR =
    /// −R·n·dd/(n·d). The first ray is the axis, the next is to its left, and the two after that above
    /// it, to the left and to the right by half of the way. Of five, the two after the axis are at right
    /// angles.
    fn to_next_sub_ray(&self, beam: &Beam, light: &Light, first: usize) -> f64 {
        let normal = self.normal_of_image(light.ray);
        let [axis, a, b, c] = [0, 1, 2, 3].map(|k| dot(normal, self.rays.directions[first + k]));
        let across = match beam.len() {
            5 => b - axis,
            _ => (b + c - 2.0 * axis) / 3.0_f64.sqrt(),
        };
        let (along, range) = (a - axis, light.range / self.light.cosine[light.ray]);
        range * range * (along * along + across * across)
    }

    /// The echo of a pulse whose sub-rays all end at one object, within an extent of 2σ: as `merge` has it.
    #[inline(always)]
    pub(super) fn only_echo(&self, beam: &Beam, pulse: usize) -> Option<Echo> {
        let first = pulse * beam.len();
        let rays = first..first + beam.len();
        let (objects, ranges) = (&self.hits.object[rays.clone()], &self.light.range[rays.clone()]);
        if !self.paths.is_empty() || objects[0] < 0 || objects.iter().any(|object| *object != objects[0]) {
            return None;
        }
        let (least, most) =
            ranges.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), range| (a.min(*range), b.max(*range)));
        if !(most - least <= 2.0 * beam.pulse_sigma) {
            return None;
        }
        let (received, powers) = (&self.light.received[rays.clone()], &self.light.power[rays]);
        let shares = beam.shares();
        let power = shares.iter().zip(powers).map(|(share, power)| share * power).sum();
        let moment = shares
            .iter()
            .zip(powers)
            .zip(ranges)
            .map(|((share, power), range)| share * power * (range - ranges[0]))
            .sum();
        let intensity = shares.iter().zip(received).map(|(share, intensity)| share * intensity).sum();
        let main = Light { ray: first, range: ranges[0], intensity, power, clear_power: f64::NAN };
        Some(Echo { range: main.range + mean(moment, power), ..Echo::of(main) })
    }

    /// The echo of one light or more.
    fn merge(&self, lights: &[Light]) -> Echo {
        let object = |light: &Light| self.hits.object[light.ray];
        let sub_ray = |light: &Light| (self.paths.fired_ray(light.ray), light.ray);
        let share = |of: i32| lights.iter().filter(|l| object(l) == of).map(|l| l.power).sum::<f64>();
        let main = *lights.iter().fold(&lights[0], |best, light| {
            let (a, b) = (object(light), object(best));
            let better = if a == b { sub_ray(light) < sub_ray(best) } else { share(a) > share(b) };
            if better { light } else { best }
        });
        let power: f64 = lights.iter().map(|l| l.power).sum();
        let moment: f64 = lights.iter().map(|l| l.power * (l.range - main.range)).sum();
        Echo {
            range: main.range + mean(moment, power),
            intensity: lights.iter().map(|l| l.intensity).sum(),
            power,
            ..Echo::of(main)
        }
    }
}

/// The mean of ranges relative to one of them, by power. There is none where no power comes back, from a
/// black surface, or infinite power, from distance zero: then 0.
#[inline(always)]
fn mean(moment: f64, power: f64) -> f64 {
    let mean = moment / power;
    if mean.is_finite() { mean } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::numbers;

    /// Ranges of the peaks that are told apart, of one light each.
    fn told_apart(separation: f64, lights: &[(f64, f64)]) -> Vec<f64> {
        let mut waveform = Waveform::default();
        for (ray, &(range, power)) in lights.iter().enumerate() {
            waveform.lights.push(Light { ray, range, intensity: power, power, clear_power: power });
            waveform.peaks.push(ray..ray + 1);
        }
        waveform.tell_apart(separation);
        waveform.told_apart.iter().map(|peak| peak.range).collect()
    }

    /// A pulse of seven sub-rays, after one that hits nothing.
    fn seven(beam: &Beam, ranges: [f64; 7], powers: [f64; 7]) -> Scratch {
        let mut scratch = Scratch::default();
        scratch.hits.resize(14);
        scratch.hits.object[7..].fill(3);
        let both = |values: [f64; 7]| [[f64::NAN; 7], values].concat();
        scratch.light.range = both(ranges);
        scratch.light.power = both(powers);
        scratch.light.received = both(std::array::from_fn(|k| powers[k] * ranges[k] * ranges[k]));
        scratch.light.intensity = scratch.light.received.clone();
        assert_eq!(beam.len(), 7);
        scratch
    }

    #[test]
    fn the_only_echo_is_what_its_lights_merge_to() {
        let mut number = numbers();
        let beam = Beam::new([3e-3; 2], 7, 0.75);
        let parts = |echo: Echo| {
            (
                echo.ray,
                [echo.true_range, echo.range, echo.intensity, echo.power].map(f64::to_bits),
                echo.measured,
            )
        };
        for k in 0..400 {
            let mut draw = || [0; 7].map(|_: u8| number());
            let ranges = draw().map(|x| 20.0 + 2.0 * beam.pulse_sigma * x);
            // Black surfaces, and distance zero, have no mean.
            let powers = if k % 4 == 0 { [[0.0; 7], [f64::INFINITY; 7]][k / 4 % 2] } else { draw() };
            let mut scratch = seven(&beam, ranges, powers);
            let lights: Vec<Light> =
                beam.sub_rays(1).filter_map(|(ray, share)| Some(scratch.light_of(ray)?.dim(share))).collect();
            assert_eq!(lights.len(), 7);
            let echo = scratch.only_echo(&beam, 1).expect("one surface");
            assert_eq!(parts(echo), parts(scratch.merge(&lights)), "{ranges:?} {powers:?}");
            assert!(scratch.only_echo(&beam, 0).is_none(), "nothing is hit");
            for object in [-1, 4] {
                scratch.hits.object[7 + k % 7] = object;
                assert!(scratch.only_echo(&beam, 1).is_none());
                scratch.hits.object[7 + k % 7] = 3;
            }
            scratch.light.range[7 + k % 7] += 4.1 * beam.pulse_sigma;
            assert!(scratch.only_echo(&beam, 1).is_none(), "it may have two peaks");
        }
    }

    #[test]
    fn of_two_near_peaks_the_stronger_stays() {
        assert_eq!(told_apart(1.0, &[(5.0, 1.0), (5.9, 2.0), (7.0, 1.0)]), [5.9, 7.0]);
        assert_eq!(told_apart(1.0, &[(5.0, 2.0), (5.9, 2.0), (6.0, 1.0)]), [5.0, 6.0]);
        // The third is lost to the second before the second could be lost to nothing: the strongest is first.
        assert_eq!(told_apart(1.0, &[(5.0, 2.0), (5.9, 3.0), (6.8, 1.0)]), [5.9]);
        assert_eq!(told_apart(1.0, &[(5.0, 3.0), (5.9, 2.0), (6.8, 1.0)]), [5.0, 6.8]);
        assert_eq!(told_apart(9.0, &[(5.0, f64::NAN), (5.9, 0.0), (6.8, 1.0)]), [6.8]);
    }
}
