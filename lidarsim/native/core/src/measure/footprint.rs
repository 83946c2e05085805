//! Pulses of several echoes each: of the sub-rays over the footprint of a beam, or of a ray that goes on.

use std::ops::Range;

use super::beam::Beam;
use super::columns::{Entries, Rows, unused, write};
use super::direction::beside;
use super::echo::Echo;
use super::effects::{Draws, Echoes, Pulses};
use super::light::KeepLight;
use super::scan::Scan;
use super::scratch::Scratch;
use super::single_ray::{EightSurfaces, MeasureEights};
use super::source::Source;
use super::status::Status;
use super::waveform::Waveform;
use crate::arith::elementary::first_quadrant_angle;
use crate::arith::simd::{Floats, Isa, Task, lanes};
use crate::geometry::point::{cross, dot};
use crate::memory::resize;

/// Measures the `wanted` pulses one by one.
struct MeasurePulses<'a, 'b, 'c> {
    scan: &'a Scan<'b>,
    pulses: Range<usize>,
    scratch: &'a mut Scratch,
    rows: &'a mut Rows<'c>,
}

impl Task for MeasurePulses<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let MeasurePulses { scan, pulses, scratch, rows } = self;
        let (most, rays, beam) =
            (scan.measurement.most_returns(), scan.measurement.rays(), &scan.measurement.beam);
        let indices = std::mem::take(&mut scratch.indices);
        let batch = scan.frame.pulses(pulses.clone(), &indices);
        let (mut waveform, mut echoes, mut chosen) = (Waveform::default(), Vec::new(), Vec::new());
        for pulse in 0..pulses.len() {
            if scratch.wanted[pulse / 8] >> (pulse % 8) & 1 == 0 {
                continue;
            }
            match beam {
                Some(beam) => waveform.echoes::<I>(beam, scratch, pulse, &mut echoes),
                None => scratch.echoes_of_ray(pulse, &mut echoes),
            }
            for (echo, number) in echoes.iter_mut().zip(0..) {
                scan.receive(pulse, number, echo, &batch, &scratch.draws);
            }
            if scan.measurement.effects.has_weather() {
                scan.insert_weather(beam.as_ref(), pulse, &batch, scratch, &mut echoes);
            }
            let false_return =
                scan.measurement.effects.false_returns::<f64, 1>(pulse, &batch, &scratch.draws);
            if let Some(other) = false_return.filter(|other| other.kept != 0) {
                let echo = Echo::falsely(pulse * rays, other.reported_range(), other.intensity);
                let place = echoes.partition_point(|nearer| nearer.range <= echo.range);
                echoes.insert(place, echo);
            }
            // Of one there is no choice.
            let reported = if echoes.len() < 2 {
                &echoes
            } else {
                scan.measurement.returns.choose(&echoes, &mut chosen);
                &chosen
            };
            let mut row = pulse * most;
            for echo in reported {
                if echo.source == Source::FalseReturn {
                    report_false(row, echo, scratch, rows);
                    row += 1;
                    continue;
                }
                if echo.source == Source::Atmosphere {
                    scan.report_air(row, echo, scratch, rows);
                } else {
                    scan.report(row, pulse, echo, scratch, rows);
                    if let Some(entry) = rows.mirrored_point.get_mut(row) {
                        entry.write(scan.mirrored_point(pulses.start + pulse, echo.ray, scratch));
                    }
                }
                if let Some(entry) = rows.true_direction.get_mut(row) {
                    let direction = scan.measurement.effects.directions(&batch, &scratch.draws)[pulse];
                    let sub_ray = scratch.paths.fired_ray(echo.ray) - pulse * rays;
                    entry.write(match beam {
                        Some(beam) => beside(direction, beam.offset(sub_ray)),
                        None => direction,
                    });
                }
                row += 1;
            }
            let status = reported.first().map_or(Status::Miss, Echo::status);
            let count = if status == Status::Hit { reported.len() as u8 } else { 0 };
            write(rows.status, pulse, [status as u8]);
            write(rows.return_count, pulse, [count]);
            for row in row..(pulse + 1) * most {
                report_nothing(row, Entries::UNUSED, scratch, rows);
            }
        }
        scratch.indices = indices;
    }
}

impl Scan<'_> {
    #[inline(always)]
    pub(super) fn measure_footprints<I: Isa>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        I::call(KeepLight { scan: self, of_further: false, scratch });
        let measurement = self.measurement;
        let is_plain = measurement.most_returns() == 1 && !measurement.effects.has_weather();
        scratch.wanted.clear();
        if measurement.beam.is_some() && is_plain && scratch.paths.is_empty() {
            I::call(MeasureEights { scan: self, pulses: pulses.clone(), scratch, rows });
        } else {
            resize(&mut scratch.wanted, pulses.len().div_ceil(8), u8::MAX);
        }
        I::call(MeasurePulses { scan: self, pulses, scratch, rows });
    }

    /// Measures those pulses, of one ray each, whose light went on from the first surface.
    #[inline(always)]
    pub(super) fn measure_further_surfaces<I: Isa>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        I::call(KeepLight { scan: self, of_further: true, scratch });
        scratch.wanted.clear();
        resize(&mut scratch.wanted, pulses.len().div_ceil(8), 0);
        for pulse in 0..pulses.len() {
            scratch.wanted[pulse / 8] |= u8::from(!scratch.paths.of(pulse).is_empty()) << (pulse % 8);
        }
        I::call(MeasurePulses { scan: self, pulses, scratch, rows });
    }

    /// Applies the effects to an echo of a pulse, with its number of the draws.
    #[inline(always)]
    pub(super) fn receive(&self, pulse: usize, number: u16, echo: &mut Echo, batch: &Pulses, draws: &Draws) {
        let mut echoes = Echoes::<f64, 1>::new(pulse, number, echo.range, echo.intensity, echo.power, 0);
        self.measurement.effects.apply(batch, draws, &mut echoes);
        (echo.intensity, echo.power) = (echoes.intensity, echoes.power);
        let [status, ..] = echoes.statuses();
        echo.measured = match Status::ALL[usize::from(status)] {
            Status::Hit => Ok(echoes.reported_range()),
            lost => Err(lost),
        };
    }

    /// Writes an echo of a pulse, but for its direction.
    #[inline(always)]
    fn report(&self, row: usize, pulse: usize, echo: &Echo, scratch: &mut Scratch, rows: &mut Rows) {
        let (hit, direction) = (&scratch.hits.at(echo.ray), scratch.rays.directions[echo.ray]);
        let [instance, label] = self.instance_and_label(hit.object, hit.primitive);
        let range = echo.measured.unwrap_or(f64::NAN);
        let (cross, cosine) = (cross(hit.normal, direction), scratch.light.cosine[echo.ray]);
        let incidence = first_quadrant_angle(dot(cross, cross).sqrt(), cosine);
        rows.write(
            row,
            Entries {
                range: [range],
                true_range: [echo.true_range],
                range_error: [range - echo.true_range],
                intensity: [if echo.measured.is_ok() { echo.intensity as f32 } else { f32::NAN }],
                normal: [hit.normal.map(|x| x as f32)],
                object_id: [hit.object],
                instance: [instance],
                label: [label],
                source: [echo.source as u8],
                path: [scratch.paths.path(echo.ray).map_or(0, |path| path.passed)],
                incidence: [incidence as f32],
            },
        );
        if row < scratch.range_rate.len() {
            scratch.range_rate[row] = self.range_rate(pulse, echo.ray, scratch);
        }
    }

    /// Writes an echo of the air, but for its direction.
    #[inline(always)]
    fn report_air(&self, row: usize, echo: &Echo, scratch: &mut Scratch, rows: &mut Rows) {
        let range = echo.measured.unwrap_or(f64::NAN);
        let entries = Entries {
            range: [range],
            true_range: [echo.true_range],
            range_error: [range - echo.true_range],
            intensity: [echo.intensity as f32],
            label: [self.measurement.air_label],
            source: [echo.source as u8],
            ..Entries::UNUSED
        };
        report_nothing(row, entries, scratch, rows);
    }
}

impl Scratch {
    /// What the axes of eight pulses meet and the light of the pulses, where all of their sub-rays bring back
    /// one echo or nothing; and a bit for each other pulse, for which these numbers have no meaning.
    #[inline(always)]
    pub(super) fn only_echoes<I: Isa>(
        &self,
        beam: &Beam,
        pulses: &[usize; 8],
    ) -> (EightSurfaces<I::F64x8>, u8) {
        let axes = [0, 1, 2, 3, 4, 5, 6, 7].map(|k: usize| pulses[k] * beam.len());
        let (mut missed, mut others) = (0, 0);
        let [mut truth, mut range, mut intensity, mut power, mut cosine] = [[0.0; 8]; 5];
        let ([mut object, mut primitive], mut normals) = ([[0; 8]; 2], [[0.0; 3]; 8]);
        for k in 0..8 {
            let (axis, bit) = (axes[k], 1 << k);
            (object[k], primitive[k]) = (self.hits.object[axis], self.hits.primitive[axis]);
            (normals[k], cosine[k]) = (self.hits.normal(axis), self.light.cosine[axis]);
            if let Some(echo) = self.only_echo(beam, pulses[k]) {
                (truth[k], range[k]) = (echo.true_range, echo.range);
                (intensity[k], power[k]) = (echo.intensity, echo.power);
            } else if self.hits.object[axis..axis + beam.len()].iter().all(|object| *object < 0) {
                missed |= bit;
            } else {
                others |= bit as u8;
            }
        }
        let [a, b, c, d, e, f, g, h] = &normals;
        let normal = I::columns([a, b, c, d, e, f, g, h]);
        let of = |k: usize| &self.rays.directions[axes[k]];
        let direction = I::columns([of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)]);
        let cross = lanes::cross(normal, direction);
        let surfaces = EightSurfaces {
            object,
            primitive,
            normal: normals.as_flattened().as_chunks().0.as_chunks().0[0],
            missed,
            truth: I::F64x8::load(&truth),
            range: I::F64x8::load(&range),
            cosine: I::F64x8::load(&cosine),
            squared_sine: lanes::dot(cross, cross),
            intensity: I::F64x8::load(&intensity),
            power: I::F64x8::load(&power),
        };
        (surfaces, others)
    }
}

/// Writes a return that no surface sent.
#[inline(always)]
fn report_false(row: usize, echo: &Echo, scratch: &mut Scratch, rows: &mut Rows) {
    let entries = Entries {
        range: [echo.range],
        intensity: [echo.intensity as f32],
        source: [echo.source as u8],
        ..Entries::UNUSED
    };
    report_nothing(row, entries, scratch, rows);
}

/// Writes a row in which no surface was hit.
#[inline(always)]
fn report_nothing(row: usize, entries: Entries<1>, scratch: &mut Scratch, rows: &mut Rows) {
    rows.write(row, entries);
    if let Some(entry) = rows.true_direction.get_mut(row) {
        entry.write(unused::true_direction);
    }
    if let Some(entry) = rows.mirrored_point.get_mut(row) {
        entry.write(unused::mirrored_point);
    }
    if let Some(range_rate) = scratch.range_rate.get_mut(row) {
        *range_rate = [f64::NAN; 2];
    }
}
