//! With a beam: pulses that have one echo at most, as their sub-rays all end at one object, or at none, and
//! not far apart in range. Eight at a time; other pulses have a waveform.

use std::ops::Range;

use super::beam::Beam;
use super::caster::Caster;
use super::columns::{Rows, unused};
use super::direction::beside;
use super::echo::{Echo, Light};
use super::scan::Scan;
use super::scratch::{LightArrays, OnlyEchoes, Scratch};
use super::single_ray::EightEchoes;
use crate::arith::simd::{Floats, Isa, lanes};
use crate::geometry::vector::Point;
use crate::memory::resize;

const UNKNOWN: OnlyEchoes =
    OnlyEchoes { known: 0, missed: 0, range: [0.0; 8], intensity: [0.0; 8], power: [0.0; 8] };

impl<C: Caster> Scan<'_, C> {
    /// Measures the pulses of a batch that have one echo at most. What it writes for others is unspecified.
    #[inline(always)]
    pub(super) fn measure_only_echoes<I: Isa>(
        &self,
        beam: &Beam,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        for part in 0..scratch.only_echoes.len() {
            if scratch.only_echoes[part].known == 0 {
                continue;
            }
            let axes = axes(beam, part, pulses.len());
            let echoes = scratch.eight_echoes::<I>(part, &axes);
            self.measure_eight::<I>(pulses.clone(), part, echoes, Some(axes), scratch, rows);
        }
        if !rows.true_direction.is_empty() {
            let batch = self.frame.pulses(pulses, &scratch.indices);
            let directions = self.measurement.effects.directions(&batch, &scratch.draws);
            let objects = scratch.hits.object.iter().step_by(beam.len());
            for ((entry, object), direction) in rows.true_direction.iter_mut().zip(objects).zip(directions) {
                let is_hit = *object >= 0;
                entry.write(if is_hit { beside(*direction, beam.offset(0)) } else { unused::true_direction });
            }
        }
        for entry in &mut *rows.mirrored_point {
            entry.write(unused::mirrored_point);
        }
        for i in 0..scratch.rows.range_rate.len() {
            let (axis, is_known) = (i * beam.len(), scratch.has_only_echo(i));
            let is_hit = is_known && scratch.hits.object[axis] >= 0;
            scratch.rows.range_rate[i] =
                if is_hit { self.range_rate(i, axis, scratch) } else { [f64::NAN; 2] };
        }
    }
}

/// Of the sub-rays of eight pulses: the least and the largest range, and the sums of an echo.
struct Sums<F> {
    nearest: F,
    least: F,
    most: F,
    power: F,
    moment: F,
    intensity: F,
}

impl<F: Floats<f64, 8>> Sums<F> {
    /// `nearest`: the ranges of the axes.
    #[inline(always)]
    fn new(nearest: F) -> Self {
        // As sums of floats begin.
        let zero = F::splat(-0.0);
        Sums { nearest, least: nearest, most: nearest, power: zero, moment: zero, intensity: zero }
    }

    #[inline(always)]
    fn add(&mut self, share: f64, range: F, power: F, received: F) {
        let share = F::splat(share);
        let power = share.mul(power);
        (self.least, self.most) = (Floats::min(range, self.least), Floats::max(range, self.most));
        self.power = self.power.add(power);
        self.moment = self.moment.add(power.mul(range.sub(self.nearest)));
        self.intensity = self.intensity.add(share.mul(received));
    }
}

impl Scratch {
    /// Finds the pulses whose sub-rays all end at one object, within an extent of 2σ, and their echoes, as
    /// `merge` has them; and the pulses that hit nothing.
    #[inline(always)]
    pub(super) fn find_only_echoes<I: Isa>(&mut self, beam: &Beam, pulses: usize) {
        let parts = pulses.div_ceil(8);
        resize(&mut self.only_echoes, parts, UNKNOWN);
        if !self.ways.is_empty() {
            self.only_echoes.fill(UNKNOWN);
            return;
        }
        for part in 0..parts {
            self.only_echoes[part] = self.only_echoes_of::<I>(beam, &axes(beam, part, pulses));
        }
    }

    /// The echoes of the pulses with these first rays.
    #[inline(always)]
    fn only_echoes_of<I: Isa>(&self, beam: &Beam, axes: &[usize; 8]) -> OnlyEchoes {
        let (mut together, mut missed) = (0, 0);
        for (k, first) in axes.iter().enumerate() {
            let (axis, mut different) = (self.hits.object[*first], 0);
            for object in &self.hits.object[*first..*first + beam.len()] {
                different |= object ^ axis;
            }
            together |= u32::from(different == 0) << k;
            missed |= (axis as u32 >> 31) << k;
        }
        missed &= together;
        if together == missed {
            return OnlyEchoes { known: missed, missed, ..UNKNOWN };
        }
        let LightArrays { range, received, power, .. } = &self.light;
        let nearest = eight::<I>(range, axes, 0);
        let (axis_power, axis_received) = (eight::<I>(power, axes, 0), eight::<I>(received, axes, 0));
        let mut sums = Sums::new(nearest);
        sums.add(beam.shares()[0], nearest, axis_power, axis_received);
        // Each ring about the axis has a multiple of six.
        for (k, shares) in beam.shares()[1..].as_chunks::<3>().0.iter().enumerate() {
            let [ranges, powers, received] = [
                three::<I>(range, axes, 3 * k + 1),
                three::<I>(power, axes, 3 * k + 1),
                three::<I>(received, axes, 3 * k + 1),
            ];
            for i in 0..3 {
                sums.add(shares[i], ranges[i], powers[i], received[i]);
            }
        }
        let Sums { least, most, power, moment, intensity, .. } = sums;
        let near = most.sub(least).le(I::F64x8::splat(2.0 * beam.pulse_sigma));
        // As `mean`.
        let mean = moment.div(power);
        let is_finite = mean.abs().lt(I::F64x8::splat(f64::INFINITY));
        let range = nearest.add(I::pick(is_finite, mean, I::F64x8::splat(0.0)));
        OnlyEchoes {
            known: together & near | missed,
            missed,
            range: range.store(),
            intensity: intensity.store(),
            power: power.store(),
        }
    }

    /// Whether a pulse has one echo at most, and it is known.
    #[inline(always)]
    pub(super) fn has_only_echo(&self, pulse: usize) -> bool {
        self.only_echoes[pulse / 8].known >> (pulse % 8) & 1 != 0
    }

    /// The echo of a pulse that has only this one; its true hit is that of the axis.
    #[inline(always)]
    pub(super) fn only_echo(&self, beam: &Beam, pulse: usize) -> Option<Echo> {
        let OnlyEchoes { missed, range, intensity, power, .. } = &self.only_echoes[pulse / 8];
        let (ray, k) = (pulse * beam.len(), pulse % 8);
        let (intensity, power) = (intensity[k], power[k]);
        let main = Light { ray, range: self.light.range[ray], intensity, power, clear_power: f64::NAN };
        (missed >> k & 1 == 0).then(|| Echo { range: range[k], ..Echo::of(main) })
    }

    /// The only echoes of the pulses from 8·part on, with these first rays.
    #[inline(always)]
    fn eight_echoes<I: Isa>(&self, part: usize, axes: &[usize; 8]) -> EightEchoes<I::F64x8> {
        let OnlyEchoes { missed, range, intensity, power, .. } = &self.only_echoes[part];
        let Scratch { rays, hits, light, .. } = self;
        let (normal, direction) =
            (points::<I>(hits.normal.as_chunks().0, axes), points::<I>(&rays.directions, axes));
        let cross = lanes::cross(normal, direction);
        EightEchoes {
            missed: *missed,
            truth: eight::<I>(&light.range, axes, 0),
            range: I::F64x8::load(range),
            intensity: I::F64x8::load(intensity),
            power: I::F64x8::load(power),
            cosine: eight::<I>(&light.cosine, axes, 0),
            squared_sine: lanes::dot(cross, cross),
        }
    }
}

/// The first rays of the pulses from 8·part on; past the last pulse they are its own.
#[inline(always)]
fn axes(beam: &Beam, part: usize, pulses: usize) -> [usize; 8] {
    let mut axes = [0; 8];
    for (k, axis) in axes.iter_mut().enumerate() {
        *axis = (8 * part + k).min(pulses - 1) * beam.len();
    }
    axes
}

/// Eight points, by axis.
#[inline(always)]
fn points<I: Isa>(points: &[Point], at: &[usize; 8]) -> [I::F64x8; 3] {
    let [a, b, c, d, e, f, g, h] = at.map(|at| &points[at]);
    I::columns([a, b, c, d, e, f, g, h])
}

/// The values of three sub-rays, from the k-th on.
#[inline(always)]
fn three<I: Isa>(values: &[f64], axes: &[usize; 8], k: usize) -> [I::F64x8; 3] {
    let mut threes = [&[0.0; 3]; 8];
    for (three, axis) in threes.iter_mut().zip(axes) {
        *three = &values[axis + k..axis + k + 3].as_chunks().0[0];
    }
    I::columns(threes)
}

/// The values of the k-th sub-rays.
#[inline(always)]
fn eight<I: Isa>(values: &[f64], axes: &[usize; 8], k: usize) -> I::F64x8 {
    let mut eight = [0.0; 8];
    for (value, axis) in eight.iter_mut().zip(axes) {
        *value = values[axis + k];
    }
    I::F64x8::load(&eight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arith::simd::{Level, Task, dispatch};
    use crate::testing::numbers;

    struct Find<'a>(&'a mut Scratch, &'a Beam);

    impl Task for Find<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self) {
            self.0.find_only_echoes::<I>(self.1, 2);
        }
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
            let find = |scratch: &mut Scratch, level| {
                dispatch(level, Find(scratch, &beam));
                let known = scratch.has_only_echo(1).then(|| scratch.only_echo(&beam, 1));
                assert!(scratch.has_only_echo(0) && scratch.only_echo(&beam, 0).is_none(), "it hits nothing");
                known
            };
            let lights: Vec<Light> = beam
                .sub_rays(1)
                .filter_map(|(ray, share)| Some(scratch.light_of(ray)?.dimmed(share)))
                .collect();
            assert_eq!(lights.len(), 7);
            for level in Level::ALL.into_iter().filter(|level| *level <= Level::best()) {
                let echo = find(&mut scratch, level).flatten().expect("one surface");
                assert_eq!(parts(echo), parts(scratch.merge(&lights)), "{level:?} {ranges:?} {powers:?}");
                for object in [-1, 4] {
                    scratch.hits.object[7 + k % 7] = object;
                    assert!(find(&mut scratch, level).is_none());
                    scratch.hits.object[7 + k % 7] = 3;
                }
                let range = scratch.light.range[7 + k % 7];
                scratch.light.range[7 + k % 7] += 4.1 * beam.pulse_sigma;
                assert!(find(&mut scratch, level).is_none(), "it may have two peaks");
                scratch.light.range[7 + k % 7] = range;
            }
        }
    }
}
