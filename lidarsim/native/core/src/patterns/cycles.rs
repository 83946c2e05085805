//! Channels that fire one after another in cycles, while a head or a mirror turns about z.

use super::rotation::sines_and_cosines;
use super::{Arrays, LANES, Lanes, put, set, unit};
use crate::arith::simd::Isa;
use crate::geometry::vector::Point;
use crate::memory;

/// Channels, in firing order.
pub struct Channels {
    /// At the azimuth 0.
    beams: Vectors,
    /// At the azimuth 0, if they turn with the head; else of no channel.
    origins: Vectors,
    /// Since the start of a cycle, s.
    firing_times: Vec<f64>,
}

/// The cycles of a frame. Cycle c starts `(c + wait)/rate` after the frame, and at an azimuth of `start` plus
/// `speed` times the time since its run.
pub struct Cycles<'a> {
    channels: &'a Channels,
    /// With the number of columns up to the end of each.
    runs: Vec<(usize, CycleRun)>,
    rate: f64,
    wait: f64,
    start: f64,
    speed: f64,
}

/// A run of consecutive cycles, a column each: those of a turn or of a facet.
#[derive(Clone, Copy, Debug)]
pub struct CycleRun {
    pub columns: usize,
    /// The first cycle.
    pub cycle: f64,
    /// Whole cycles from the first that the run could have to this one, which starts `late` of a cycle after
    /// the run.
    pub since: f64,
    pub late: f64,
}

/// Channels whose pulses of one column are computed together.
const CHANNELS: usize = 16;

/// The coordinates of a vector for each channel, by axis; zeros follow up to a multiple of `CHANNELS`.
struct Vectors([Vec<f64>; 3]);

impl Vectors {
    fn new(vectors: &[Point]) -> Self {
        Vectors([0, 1, 2].map(|axis| {
            let mut column = memory::collect(vectors.iter().map(|vector| vector[axis]));
            memory::resize(&mut column, vectors.len().next_multiple_of(CHANNELS), 0.0);
            column
        }))
    }

    fn is_empty(&self) -> bool {
        self.0[0].is_empty()
    }
}

impl Channels {
    pub fn new(beams: &[Point], origins: &[Point], firing_times: &[f64]) -> Self {
        let firing_times = memory::copy(firing_times);
        Channels { beams: Vectors::new(beams), origins: Vectors::new(origins), firing_times }
    }

    pub fn count(&self) -> usize {
        self.firing_times.len()
    }

    /// Whether origins turn with the head.
    pub fn has_origins(&self) -> bool {
        !self.origins.is_empty()
    }
}

impl<'a> Cycles<'a> {
    /// `clock` is the rate and the wait.
    pub fn new(
        channels: &'a Channels,
        runs: &[CycleRun],
        [rate, wait]: [f64; 2],
        [start, speed]: [f64; 2],
    ) -> Self {
        let ends = runs.iter().scan(0, |end, run| {
            *end += run.columns;
            Some(*end)
        });
        let mut with_ends = memory::with_capacity(runs.len());
        with_ends.extend(ends.zip(runs.iter().copied()));
        Cycles { channels, runs: with_ends, rate, wait, start, speed }
    }

    pub fn channels(&self) -> &Channels {
        self.channels
    }

    /// Writes consecutive columns from `first` on.
    #[inline(always)]
    pub(super) fn fire<I: Isa>(&self, first: usize, mut arrays: Arrays) -> bool {
        let Channels { beams, origins, firing_times } = self.channels;
        let channels = firing_times.len();
        let last = first + arrays.directions.len() / channels;
        let (mut column, mut number) = (first, self.runs.partition_point(|(end, _)| *end <= first));
        while column < last {
            let (end, run) = &self.runs[number];
            let count = LANES.min(last.min(*end) - column);
            if count > 0 {
                let (times, azimuths) = self.starts(run, run.columns - (end - column));
                let some = arrays.split_off(count * channels);
                put_times(&times, firing_times, some.times);
                let turn = &sines_and_cosines(&azimuths);
                put_turned::<I, true>(beams, turn, channels, some.directions);
                put_turned::<I, false>(origins, turn, channels, some.origins);
            }
            column += count;
            number += usize::from(column == *end);
        }
        true
    }

    /// When cycles of a run from this one on start, and at which azimuths.
    #[inline(always)]
    fn starts(&self, run: &CycleRun, first: usize) -> (Lanes, Lanes) {
        let times = self.times(run.cycle, first, self.wait);
        // Of a run that starts with the frame, they are the same, and divisions are slow.
        let is_whole = (run.since, run.late) == (run.cycle, self.wait);
        let mut azimuths = if is_whole { times } else { self.times(run.since, first, run.late) };
        for azimuth in &mut azimuths {
            *azimuth = self.start + self.speed * *azimuth;
        }
        (times, azimuths)
    }

    /// The times of cycles from number `first` after `cycle` on, the first of which starts `late` of a cycle
    /// after that.
    #[inline(always)]
    fn times(&self, cycle: f64, first: usize, late: f64) -> Lanes {
        let mut times = [0.0; LANES];
        for lane in 0..LANES {
            times[lane] = (cycle + (first + lane) as f64 + late) / self.rate;
        }
        times
    }
}

/// Writes the firing times of all channels in some columns.
#[inline(always)]
fn put_times(starts: &Lanes, firing_times: &[f64], places: &mut [f64]) {
    let channels = firing_times.len();
    if channels < CHANNELS {
        for (channel, later) in firing_times.iter().enumerate() {
            for (places, start) in places.chunks_exact_mut(channels).zip(starts) {
                places[channel] = start + later;
            }
        }
        return;
    }
    for (places, start) in places.chunks_exact_mut(channels).zip(starts) {
        for (place, later) in places.iter_mut().zip(firing_times) {
            *place = start + later;
        }
    }
}

/// Writes a vector of each channel, turned about z, in some columns, and at unit length if it is one.
#[inline(always)]
fn put_turned<I: Isa, const UNIT: bool>(
    Vectors([x, y, z]): &Vectors,
    [sin, cos]: &[Lanes; 2],
    channels: usize,
    places: &mut [Point],
) {
    if places.is_empty() {
        return;
    }
    // Of few channels the lanes are columns, of many channels.
    if channels < CHANNELS {
        let mut vectors = [[0.0; LANES]; 3];
        for channel in 0..channels {
            for lane in 0..LANES {
                let vector = [x[channel], y[channel], z[channel]];
                set(&mut vectors, lane, turned::<UNIT>(vector, sin[lane], cos[lane]));
            }
            put::<I, LANES>(&vectors, 0, channel, channels, places);
        }
        return;
    }
    let (x, y, z) = (x.as_chunks().0, y.as_chunks().0, z.as_chunks().0);
    let mut vectors = [[0.0; CHANNELS]; 3];
    for (column, places) in places.chunks_exact_mut(channels).enumerate() {
        let (sin, cos) = (sin[column], cos[column]);
        for (i, places) in places.chunks_mut(CHANNELS).enumerate() {
            let [x, y, z]: [&[f64; CHANNELS]; 3] = [&x[i], &y[i], &z[i]];
            for lane in 0..CHANNELS {
                set(&mut vectors, lane, turned::<UNIT>([x[lane], y[lane], z[lane]], sin, cos));
            }
            put::<I, CHANNELS>(&vectors, 0, 0, 1, places);
        }
    }
}

#[inline(always)]
fn turned<const UNIT: bool>([x, y, z]: Point, sin: f64, cos: f64) -> Point {
    let vector = [cos * x - sin * y, sin * x + cos * y, z];
    if UNIT { unit(vector) } else { vector }
}
