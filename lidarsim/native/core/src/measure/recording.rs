//! Full waveforms: the power that the receiver gets of each pulse, sampled at equal steps of its way.
//!
//! The waveform is the sum of Gaussians from which `waveform.rs` takes the echoes, here with the extinction
//! of the air and with the echoes of weather; its unit is that of the power of a surface, intensity/R². A
//! first pass over the pulses finds the window of each, so that the memory for the samples is known; a
//! second one fills it. Both fire the same rays.

use std::ops::Range;

use super::beam::HALF_SPEED_OF_LIGHT;
use super::caster::Caster;
use super::effects::Pulses;
use super::frame::BadPulse;
use super::scan::{Scan, share, with_scratch};
use super::scratch::Scratch;
use crate::arith::elementary::exp;
use crate::arith::simd::{Isa, Task};
use crate::cast::pieces;
use crate::memory::{push, split_off};
use crate::{memory, stop};

/// Beyond so many standard deviations, more than √(2·25·ln 2), a Gaussian is below 2⁻²⁵ of its peak: half a
/// unit in the last place of a sample.
const MARGIN: f64 = 6.0;

/// How a recorder samples.
#[derive(Clone, Copy, Debug)]
pub struct Recorder {
    /// The way between two samples, m. Sample k is at range k·step; at 0 the peak of the pulse leaves.
    step: f64,
    /// The farthest range that is recorded, without the margin, m.
    max_range: f64,
}

/// The samples of a pulse.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    pub first: i64,
    pub count: usize,
}

/// Samples of all pulses, one after another.
#[derive(Debug)]
pub struct Samples {
    pub windows: Vec<Window>,
    pub values: Vec<f32>,
}

/// The light of one surface, or of some air.
#[derive(Clone, Copy, Debug)]
struct Gaussian {
    range: f64,
    peak: f64,
    sigma: f64,
}

/// What is done with a batch of pulses.
enum Part<'a> {
    Find(&'a mut [Window]),
    Fill(&'a [Window], &'a mut [f32]),
}

/// The work on a batch of pulses, compiled for each instruction set.
pub struct Recording<'a, 'b, C> {
    scan: &'b Scan<'a, C>,
    recorder: Recorder,
    pulses: Range<usize>,
    scratch: &'b mut Scratch,
    part: Part<'b>,
}

impl Recorder {
    /// `period`: the time between two samples, s; `max_range`: of the sensor, m.
    pub fn new(period: f64, max_range: f64) -> Self {
        Recorder { step: HALF_SPEED_OF_LIGHT * period, max_range }
    }

    /// The window of some light.
    fn window(&self, lights: &[Gaussian], pulse_sigma: f64) -> Window {
        if lights.is_empty() {
            return Window::default();
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for Gaussian { range, sigma, .. } in lights {
            low = low.min(range - MARGIN * sigma);
            high = high.max(range + MARGIN * sigma);
        }
        // Before this the pulse has not left.
        let [first, end] =
            self.samples([low.max(-MARGIN * pulse_sigma), high.min(self.max_range + MARGIN * pulse_sigma)]);
        Window { first, count: usize::try_from(end.saturating_sub(first)).unwrap_or(0) }
    }

    /// The samples between two ranges: the first, and the one behind the last.
    #[inline(always)]
    fn samples(&self, [low, high]: [f64; 2]) -> [i64; 2] {
        [(low / self.step).ceil() as i64, ((high / self.step).floor() as i64).saturating_add(1)]
    }

    /// Adds the light within a window to its samples.
    #[inline(always)]
    fn add(&self, lights: &[Gaussian], window: Window, samples: &mut [f64]) {
        for Gaussian { range, peak, sigma } in lights {
            let places = self.samples([range - MARGIN * sigma, range + MARGIN * sigma]);
            let [start, end] = places.map(|place| {
                usize::try_from(place.saturating_sub(window.first)).unwrap_or(0).min(window.count)
            });
            if start >= end {
                continue;
            }
            let (first, inverse) = ((window.first + start as i64) as f64, 1.0 / sigma);
            for (k, sample) in (0_u32..).zip(&mut samples[start..end]) {
                let way = (range - self.step * (first + f64::from(k))) * inverse;
                *sample += peak * exp(-0.5 * (way * way));
            }
        }
    }
}

impl<C: Caster> Scan<'_, C> {
    /// Records the waveforms of all pulses, on all threads, or returns the first bad pulse. `work` runs a
    /// batch.
    pub fn record(
        &self,
        recorder: Recorder,
        work: impl Fn(Recording<C>) -> Result<(), BadPulse> + Sync,
    ) -> Result<Samples, BadPulse> {
        let run = |pulses: Range<usize>, part: Part| {
            with_scratch(|scratch| work(Recording { scan: self, recorder, pulses, scratch, part }))
        };
        let pieces = pieces(self.frame.directions, self.measurement.rays());
        let mut windows = Vec::new();
        memory::resize(&mut windows, self.frame.directions.len(), Window::default());
        let mut places = &mut windows[..];
        let empty =
            memory::collect(pieces.iter().map(|piece| (piece.clone(), split_off(&mut places, piece.len()))));
        share(empty, |(pulses, windows)| run(pulses, Part::Find(windows)))?;

        let count = windows.iter().fold(0_usize, |sum, window| sum.saturating_add(window.count));
        let bytes = count.saturating_mul(size_of::<f32>());
        memory::expect_room(bytes, || {
            let gib = bytes as f64 / f64::from(1 << 30);
            format!(
                "the waveforms of {} pulses, {gib:.1} GiB (choose fewer by `pulses`, or a longer \
                 `sample_period`)",
                windows.len()
            )
        });
        let mut values = Vec::new();
        memory::resize(&mut values, count, 0.0);
        let mut places = &mut values[..];
        let filled = memory::collect(pieces.into_iter().map(|piece| {
            let windows = &windows[piece.clone()];
            let count = windows.iter().map(|window| window.count).sum();
            (piece, windows, split_off(&mut places, count))
        }));
        share(filled, |(pulses, windows, values)| run(pulses, Part::Fill(windows, values)))?;
        Ok(Samples { windows, values })
    }
}

impl<C: Caster> Task for Recording<'_, '_, C> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Recording { scan, recorder, pulses, scratch, part } = self;
        scan.illuminate::<I>(pulses.clone(), scratch)?;
        scan.keep_light::<I>(scratch);
        let indices = std::mem::take(&mut scratch.indices);
        let batch = scan.frame.pulses(pulses, &indices);
        let mut lights = Vec::new();
        match part {
            Part::Find(windows) => {
                for (pulse, window) in windows.iter_mut().enumerate() {
                    scan.gather_light(pulse, &batch, scratch, recorder.max_range, &mut lights);
                    *window = recorder.window(&lights, scan.measurement.pulse_sigma());
                }
            }
            Part::Fill(windows, mut values) => {
                let mut sums = Vec::new();
                for (pulse, window) in windows.iter().enumerate() {
                    stop::poll();
                    scan.gather_light(pulse, &batch, scratch, recorder.max_range, &mut lights);
                    sums.clear();
                    memory::resize(&mut sums, window.count, 0.0);
                    recorder.add(&lights, *window, &mut sums);
                    for (value, sum) in split_off(&mut values, window.count).iter_mut().zip(&sums) {
                        *value = *sum as f32;
                    }
                }
            }
        }
        scratch.indices = indices;
        Ok(())
    }
}

impl<C: Caster> Scan<'_, C> {
    /// All light of the `pulse`-th pulse of a batch, before the receiver.
    #[inline(always)]
    fn gather_light(
        &self,
        pulse: usize,
        batch: &Pulses,
        scratch: &Scratch,
        max_range: f64,
        lights: &mut Vec<Gaussian>,
    ) {
        lights.clear();
        let (measurement, rays) = (self.measurement, self.measurement.rays());
        let (first, sigma) = (pulse * rays, measurement.pulse_sigma());
        for ray in first..first + rays {
            let share = measurement.share(ray - first);
            for light in scratch.light_of(ray).into_iter().chain(scratch.further_lights(ray)) {
                let wide = match &measurement.beam {
                    None => sigma,
                    Some(beam) => scratch.variance(beam, &light, first).sqrt(),
                };
                // The wider, the lower: the area is that of the power.
                let peak = share * light.power * (sigma / wide);
                // No light of a black surface, and no width where it is grazed.
                if peak > 0.0 {
                    push(lights, Gaussian { range: light.range, peak, sigma: wide });
                }
            }
        }
        if measurement.effects.has_weather() {
            self.gather_air(pulse, batch, scratch, max_range, lights);
        }
    }

    /// The light of the air in front of the first surfaces.
    fn gather_air(
        &self,
        pulse: usize,
        batch: &Pulses,
        scratch: &Scratch,
        max_range: f64,
        lights: &mut Vec<Gaussian>,
    ) {
        let (measurement, rays) = (self.measurement, self.measurement.rays());
        let (first, sigma) = (pulse * rays, measurement.pulse_sigma());
        let surface = |ray: usize| match scratch.hits.object[ray] {
            0.. => scratch.light.range[ray],
            _ => f64::INFINITY,
        };
        if let Some(fog) = measurement.effects.fog() {
            let [mut begin, end] = fog.extent();
            let end = end.min(max_range + MARGIN * sigma);
            let mut ends: Vec<(f64, f64)> =
                (0..rays).map(|k| (surface(first + k).min(end), measurement.share(k))).collect();
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
            for k in 0..rays {
                let open: f64 = ends[k..].iter().map(|(_, share)| share).sum();
                let add = |range: f64, power: f64| {
                    push(lights, Gaussian { range, peak: open * power, sigma });
                };
                fog.echoes_between(begin, ends[k].0, add);
                begin = begin.max(ends[k].0);
            }
        }
        if let Some(particles) = measurement.effects.particles()
            && particles.seen::<f64, 1>(&scratch.draws, pulse) != 0
        {
            for particle in particles.of(batch, pulse) {
                let place = measurement.beam.as_ref().map_or(0, |beam| beam.at_share(particle.place));
                if surface(first + place) > particle.range {
                    let peak = particle.intensity / (particle.range * particle.range);
                    push(lights, Gaussian { range: particle.range, peak, sigma });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorder() -> Recorder {
        Recorder { step: 0.25, max_range: 100.0 }
    }

    #[test]
    fn windows_hold_all_light_within_the_range() {
        let light = |range: f64| Gaussian { range, peak: 1.0, sigma: 0.5 };
        let window = |ranges: &[f64]| {
            let lights: Vec<Gaussian> = ranges.iter().map(|range| light(*range)).collect();
            let Window { first, count } = recorder().window(&lights, 0.5);
            (first, count)
        };
        assert_eq!(window(&[]), (0, 0));
        assert_eq!(window(&[10.0]), (28, 25));
        assert_eq!(window(&[10.0, 20.0]), (28, 65));
        assert_eq!(window(&[0.0]), (-12, 25));
        assert_eq!(window(&[100.0]), (388, 25));
        assert_eq!(window(&[1000.0]).1, 0);
        assert_eq!(window(&[1e300]).1, 0);
        let wide = [Gaussian { range: 50.0, peak: 1.0, sigma: f64::MAX }];
        assert_eq!(recorder().window(&wide, 0.5), Window { first: -12, count: 425 });
        let tiny = Recorder { step: 5e-324, max_range: f64::INFINITY };
        assert!(tiny.window(&wide, 0.5).count > usize::MAX / 4);
    }

    #[test]
    fn light_is_added_where_the_window_is() {
        let lights = [
            Gaussian { range: 10.0, peak: 2.0, sigma: 0.5 },
            Gaussian { range: 10.5, peak: 1.0, sigma: 1.0 },
        ];
        let window = Window { first: 38, count: 6 };
        let mut samples = [0.0; 6];
        recorder().add(&lights, window, &mut samples);
        for (k, found) in samples.iter().enumerate() {
            let place = 0.25 * (38 + k) as f64;
            let of = |g: &Gaussian| g.peak * (-0.5 * ((place - g.range) / g.sigma).powi(2)).exp();
            let expected: f64 = lights.iter().map(of).sum();
            assert!((found / expected - 1.0).abs() <= 4.0 * f64::EPSILON, "{k}");
        }
        let mut samples = [0.0; 2];
        recorder().add(&lights, Window { first: 1000, count: 2 }, &mut samples);
        recorder().add(&lights, Window { first: -1000, count: 2 }, &mut samples);
        assert_eq!(samples, [0.0; 2]);
    }
}
