//! Full waveforms: the received power of each pulse, sampled at equal steps of range.
//!
//! The waveform is the sum of Gaussians from which `waveform.rs` takes the echoes, here with the extinction
//! of the air and with the echoes of weather; its unit is that of the power of a surface, intensity/R². A
//! first pass over the pulses finds the window of each, so that the memory for the samples is known; a
//! second one fills it. Both fire the same rays.

use std::ops::Range;

use super::beam::HALF_SPEED_OF_LIGHT;
use super::effects::Pulses;
use super::frame::BadPulse;
use super::light::KeepLight;
use super::scan::{Illuminate, Scan, share, with_scratch};
use super::scratch::Scratch;
use crate::arith::elementary::exp;
use crate::arith::simd::{Isa, Task};
use crate::cast::pieces;
use crate::memory::{push, split_off};
use crate::{memory, stop};

/// Beyond so many standard deviations, more than √(2·25·ln 2), a Gaussian is below 2⁻²⁵ of its
/// peak: half a unit in the last place of a sample.
const MARGIN: f64 = 6.0;

/// How a recorder samples.
#[derive(Clone, Copy, Debug)]
pub struct Recorder {
    /// Range between two samples, m. Sample k is at range k·step; at 0 the peak of the pulse leaves.
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

/// The light of fog in front of no surface, which all pulses have in common.
struct OpenFog {
    /// The ranges that it comes from.
    begin: f64,
    end: f64,
    /// How far around its range the pulse is bright, m.
    margin: f64,
    window: Window,
    samples: Vec<f64>,
}

/// What comes back of a pulse; its memory is reused from one to the next.
#[derive(Default)]
struct Received {
    /// Of surfaces, drops and flakes.
    spots: Vec<Gaussian>,
    /// In fog, per sub-ray: where its air ends, and its share of the energy; from the nearest on.
    ends: Vec<(f64, f64)>,
    /// Of the fog around some of these ends.
    fog: Vec<Gaussian>,
}

/// The task of a batch of pulses.
enum Part<'a> {
    Find(&'a mut [Window]),
    Fill(&'a [Window], &'a mut [f32]),
}

/// The work on a batch of pulses, compiled for each instruction set.
pub struct Recording<'a, 'b> {
    scan: &'b Scan<'a>,
    recorder: Recorder,
    open_fog: Option<&'b OpenFog>,
    pulses: Range<usize>,
    scratch: &'b mut Scratch,
    part: Part<'b>,
}

impl Recorder {
    /// `period`: the time between two samples, s; `max_range`: of the sensor, m.
    pub fn new(period: f64, max_range: f64) -> Self {
        Recorder { step: HALF_SPEED_OF_LIGHT * period, max_range }
    }

    /// The window of what comes from some ranges; `pulse_margin`: of a pulse.
    fn window(&self, [low, high]: [f64; 2], pulse_margin: f64) -> Window {
        // Before that no pulse has left.
        let low = low.max(-pulse_margin);
        let high = high.min(self.max_range + pulse_margin);
        if !(low <= high) {
            return Window::default();
        }
        let [first, end] = self.samples([low, high]);
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
            for (k, sample) in samples[start..end].iter_mut().enumerate() {
                let way = (range - self.step * (first + k as f64)) * inverse;
                *sample += peak * exp(-0.5 * (way * way));
            }
        }
    }
}

impl Scan<'_> {
    /// Records the waveforms of all pulses, on all threads, or returns the first bad pulse. `work` runs a
    /// batch.
    pub fn record(
        &self,
        recorder: Recorder,
        work: impl Fn(Recording) -> Result<(), BadPulse> + Sync,
    ) -> Result<Samples, BadPulse> {
        let open_fog = self.open_fog(recorder);
        let run = |pulses: Range<usize>, part: Part| {
            let open_fog = open_fog.as_ref();
            with_scratch(|scratch| work(Recording { scan: self, recorder, open_fog, pulses, scratch, part }))
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

impl Task for Recording<'_, '_> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let Recording { scan, recorder, open_fog, pulses, scratch, part } = self;
        I::call(Illuminate { scan, pulses: pulses.clone(), scratch })?;
        I::call(KeepLight { scan, of_further: false, scratch });
        let indices = std::mem::take(&mut scratch.indices);
        let batch = scan.frame.pulses(pulses, &indices);
        let (mut received, mut sums) = (Received::default(), Vec::new());
        match part {
            Part::Find(windows) => {
                for (pulse, window) in windows.iter_mut().enumerate() {
                    scan.gather(pulse, &batch, scratch, open_fog, &mut received);
                    *window =
                        recorder.window(received.extent(open_fog), MARGIN * scan.measurement.pulse_sigma());
                }
            }
            Part::Fill(windows, mut values) => {
                for (pulse, window) in windows.iter().enumerate() {
                    stop::poll();
                    scan.gather(pulse, &batch, scratch, open_fog, &mut received);
                    sums.clear();
                    memory::resize(&mut sums, window.count, 0.0);
                    recorder.add(&received.spots, *window, &mut sums);
                    if let Some(open_fog) = open_fog {
                        scan.add_fog(recorder, open_fog, &mut received, *window, &mut sums);
                    }
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

impl Received {
    /// The ranges between which a pulse is bright.
    fn extent(&self, open_fog: Option<&OpenFog>) -> [f64; 2] {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for Gaussian { range, sigma, .. } in &self.spots {
            low = low.min(range - MARGIN * sigma);
            high = high.max(range + MARGIN * sigma);
        }
        if let (Some(fog), Some((farthest, _))) = (open_fog, self.ends.last()) {
            low = low.min(fog.begin - fog.margin);
            high = high.max(farthest + fog.margin);
        }
        [low, high]
    }
}

impl Scan<'_> {
    /// The light of the `pulse`-th pulse of a batch, before the receiver; of fog, where it ends.
    #[inline(always)]
    fn gather(
        &self,
        pulse: usize,
        batch: &Pulses,
        scratch: &Scratch,
        open_fog: Option<&OpenFog>,
        received: &mut Received,
    ) {
        let Received { spots, ends, .. } = received;
        spots.clear();
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
                    push(spots, Gaussian { range: light.range, peak, sigma: wide });
                }
            }
        }
        let surface = |ray: usize| match scratch.hits.object[ray] {
            0.. => scratch.light.range[ray],
            _ => f64::INFINITY,
        };
        if let Some(fog) = open_fog {
            ends.clear();
            ends.extend(
                (0..rays).map(|k| (surface(first + k).clamp(fog.begin, fog.end), measurement.share(k))),
            );
            ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        if let Some(particles) = measurement.effects.particles()
            && particles.echo_mask::<f64, 1>(&scratch.draws, pulse) != 0
        {
            for particle in particles.of(batch, pulse) {
                let place = measurement.beam.as_ref().map_or(0, |beam| beam.at_share(particle.place));
                if surface(first + place) > particle.range {
                    let peak = particle.intensity / (particle.range * particle.range);
                    push(spots, Gaussian { range: particle.range, peak, sigma });
                }
            }
        }
    }

    /// The light of fog in front of no surface; `None` without fog.
    #[inline]
    fn open_fog(&self, recorder: Recorder) -> Option<OpenFog> {
        let (fog, sigma) = (self.measurement.effects.fog()?, self.measurement.pulse_sigma());
        let (margin, mut lights) = (MARGIN * sigma, Vec::new());
        let [begin, end] = fog.extent();
        let end = end.min(recorder.max_range + margin).max(begin);
        fog.echoes_between(begin, end, |range, peak| push(&mut lights, Gaussian { range, peak, sigma }));
        let window = recorder.window([begin - margin, end + margin], margin);
        memory::expect_room(window.count.saturating_mul(size_of::<f64>()), || {
            "the waveform of fog (choose a longer `sample_period`)".into()
        });
        let mut samples = Vec::new();
        memory::resize(&mut samples, window.count, 0.0);
        recorder.add(&lights, window, &mut samples);
        Some(OpenFog { begin, end, margin, window, samples })
    }

    /// Adds the light of the fog to the samples of a pulse: far from all ends of its air, a share of that in
    /// front of no surface; near some ends, that of the air around them.
    #[inline]
    fn add_fog(
        &self,
        recorder: Recorder,
        open: &OpenFog,
        received: &mut Received,
        window: Window,
        samples: &mut [f64],
    ) {
        let Received { ends, fog: lights, .. } = received;
        let Some(fog) = self.measurement.effects.fog() else { return };
        let (sigma, margin) = (self.measurement.pulse_sigma(), open.margin);
        let place = |range: f64| {
            let [first, _] = recorder.samples([range, range]);
            usize::try_from(first.saturating_sub(window.first)).unwrap_or(0).min(window.count)
        };
        // The share of the energy that reaches an end and those behind it.
        let share = |k: usize| ends[k..].iter().map(|(_, share)| share).sum::<f64>();
        // The window begins as early, or earlier for the light of a surface.
        let lead = usize::try_from(open.window.first.saturating_sub(window.first)).unwrap_or(0);
        let add_open = |share: f64, places: Range<usize>, samples: &mut [f64]| {
            for at in places.start.max(lead)..places.end.min(lead + open.samples.len()) {
                samples[at] += share * open.samples[at - lead];
            }
        };
        let (mut k, mut done) = (0, 0);
        while k < ends.len() && ends[k].0 < open.end {
            let mut next = k + 1;
            while next < ends.len()
                && ends[next].0 < open.end
                && ends[next].0 - ends[next - 1].0 <= 2.0 * margin
            {
                next += 1;
            }
            let (nearest, farthest) = (ends[k].0, ends[next - 1].0);
            let near = place(nearest - margin).max(done);
            let far = place(farthest + margin).max(near);
            add_open(share(k), done..near, samples);
            lights.clear();
            let mut begin = open.begin.max(nearest - 2.0 * margin);
            for i in k..=next {
                let end = if i < next { ends[i].0 } else { open.end.min(farthest + 2.0 * margin) };
                let open_share = share(i);
                fog.echoes_between(begin, end, |range, power| {
                    push(lights, Gaussian { range, peak: open_share * power, sigma });
                });
                begin = begin.max(end);
            }
            let around = Window { first: window.first + near as i64, count: far - near };
            recorder.add(lights, around, &mut samples[near..far]);
            (k, done) = (next, far);
        }
        add_open(share(k), done..window.count, samples);
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
        let extent = |ranges: &[f64]| {
            let spots =
                ranges.iter().map(|range| Gaussian { range: *range, peak: 1.0, sigma: 0.5 }).collect();
            Received { spots, ..Received::default() }.extent(None)
        };
        let window = |ranges: &[f64]| {
            let Window { first, count } = recorder().window(extent(ranges), 3.0);
            (first, count)
        };
        assert_eq!(window(&[]), (0, 0));
        assert_eq!(window(&[10.0]), (28, 25));
        assert_eq!(window(&[10.0, 20.0]), (28, 65));
        assert_eq!(window(&[0.0]), (-12, 25));
        assert_eq!(window(&[100.0]), (388, 25));
        assert_eq!(window(&[1000.0]).1, 0);
        assert_eq!(window(&[1e300]).1, 0);
        let wide = [f64::NEG_INFINITY, f64::INFINITY];
        assert_eq!(recorder().window(wide, 3.0), Window { first: -12, count: 425 });
        let tiny = Recorder { step: 5e-324, max_range: f64::INFINITY };
        assert!(tiny.window(wide, 3.0).count > usize::MAX / 4);
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
