//! Pulses of several echoes each: of the sub-rays over the footprint of a beam, or of a ray that goes on.

use std::ops::Range;

use super::caster::Caster;
use super::columns::{Entries, Rows, unused, write};
use super::direction::beside;
use super::echo::Echo;
use super::effects::{Draws, Echoes, Pulses};
use super::scan::Scan;
use super::scratch::Scratch;
use super::source::Source;
use super::status::Status;
use super::waveform::Waveform;
use crate::arith::elementary::first_quadrant_angle;
use crate::arith::simd::Isa;
use crate::geometry::point::{cross, dot};

impl<C: Caster> Scan<'_, C> {
    #[inline(always)]
    pub(super) fn measure_footprints<I: Isa>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        self.keep_light::<I>(scratch);
        self.measure_pulses::<I>(pulses, |_, _| true, scratch, rows);
    }

    /// Measures those pulses, of one ray each, whose light went on from the first surface.
    #[inline(always)]
    pub(super) fn measure_further_surfaces<I: Isa>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        self.keep_light_of::<I>(|scratch, part| scratch.ways.touch(part), scratch);
        self.measure_pulses::<I>(pulses, |scratch, pulse| !scratch.ways.of(pulse).is_empty(), scratch, rows);
    }

    /// Measures the pulses that `is_wanted` tells.
    #[inline(always)]
    fn measure_pulses<I: Isa>(
        &self,
        pulses: Range<usize>,
        is_wanted: impl Fn(&Scratch, usize) -> bool,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        let (most, rays, beam) =
            (self.measurement.most_returns(), self.measurement.rays(), &self.measurement.beam);
        let indices = std::mem::take(&mut scratch.indices);
        let batch = self.frame.pulses(pulses.clone(), &indices);
        let (mut waveform, mut echoes, mut chosen) = (Waveform::default(), Vec::new(), Vec::new());
        for pulse in 0..pulses.len() {
            if !is_wanted(scratch, pulse) {
                continue;
            }
            match beam {
                Some(beam) => waveform.echoes::<I>(beam, scratch, pulse, &mut echoes),
                None => scratch.echoes_of_ray(pulse, &mut echoes),
            }
            for (echo, number) in echoes.iter_mut().zip(0..) {
                self.receive(pulse, number, echo, &batch, &scratch.draws);
            }
            if self.measurement.effects.has_weather() {
                self.insert_weather(beam.as_ref(), pulse, &batch, scratch, &mut echoes);
            }
            let false_return =
                self.measurement.effects.false_returns::<f64, 1>(pulse, &batch, &scratch.draws);
            if let Some(other) = false_return.filter(|other| other.kept != 0) {
                let echo = Echo::falsely(pulse * rays, other.reported(), other.intensity);
                let place = echoes.partition_point(|nearer| nearer.range <= echo.range);
                echoes.insert(place, echo);
            }
            // Of one there is no choice.
            let reported = if echoes.len() < 2 {
                &echoes
            } else {
                self.measurement.returns.choose(&echoes, &mut chosen);
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
                    self.report_air(row, echo, scratch, rows);
                } else {
                    self.report(row, pulse, echo, scratch, rows);
                    if let Some(entry) = rows.mirrored_point.get_mut(row) {
                        entry.write(self.mirrored_point(pulses.start + pulse, echo.ray, scratch));
                    }
                }
                if let Some(entry) = rows.true_direction.get_mut(row) {
                    let direction = self.measurement.effects.directions(&batch, &scratch.draws)[pulse];
                    let sub_ray = scratch.ways.fired(echo.ray) - pulse * rays;
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

    /// Applies the effects to an echo of a pulse, with its number of the draws.
    #[inline(always)]
    pub(super) fn receive(&self, pulse: usize, number: u16, echo: &mut Echo, batch: &Pulses, draws: &Draws) {
        let mut echoes = Echoes::<f64, 1>::new(pulse, number, echo.range, echo.intensity, echo.power, 0);
        self.measurement.effects.apply(batch, draws, &mut echoes);
        (echo.intensity, echo.power) = (echoes.intensity, echoes.power);
        let [status, ..] = echoes.statuses();
        echo.measured = match Status::ALL[usize::from(status)] {
            Status::Hit => Ok(echoes.reported()),
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
                path: [scratch.ways.way(echo.ray).map_or(0, |way| way.path)],
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
