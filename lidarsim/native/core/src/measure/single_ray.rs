//! Pulses that have one echo at most, and one row, eight at a time. Pulses with more echoes, whose light went
//! on or came back from several surfaces of a footprint, are measured once more, one by one.

use std::ops::Range;

use super::appearance::Labels;
use super::columns::{Entries, Rows, unused, write};
use super::direction::beside;
use super::effects::{Draws, Echoes, Pulses};
use super::light::EightLights;
use super::scan::Scan;
use super::scratch::Scratch;
use super::source::Source;
use super::weather::{AIR, Reported};
use crate::arith::elementary::first_quadrant_angle;
use crate::arith::simd::{Floats, Isa, Task, lanes};

/// What eight pulses meet, and the light that comes back.
pub(super) struct EightSurfaces<F> {
    /// The hits of their rays, or of the axes of their beams. The normals are consecutive coordinates.
    pub(super) object: [i32; 8],
    pub(super) primitive: [i32; 8],
    pub(super) normal: [[f64; 8]; 3],
    /// A bit for each pulse without an echo.
    pub(super) missed: u32,
    /// The range of the hit, and that of the light.
    pub(super) truth: F,
    pub(super) range: F,
    /// Of the incidence.
    pub(super) cosine: F,
    pub(super) squared_sine: F,
    pub(super) intensity: F,
    pub(super) power: F,
}

/// [`Scan::measure_eights`], compiled once for its callers.
pub(super) struct MeasureEights<'a, 'b, 'c> {
    pub(super) scan: &'a Scan<'b>,
    pub(super) pulses: Range<usize>,
    pub(super) scratch: &'a mut Scratch,
    pub(super) rows: &'a mut Rows<'c>,
}

impl Task for MeasureEights<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        if self.scan.measurement.beam.is_some() {
            return self.scan.measure_eights::<I, true>(self.pulses, self.scratch, self.rows);
        }
        self.scan.measure_eights::<I, false>(self.pulses, self.scratch, self.rows);
    }
}

impl Scan<'_> {
    #[inline(always)]
    pub(super) fn measure_single_rays<I: Isa>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        // False returns take the place of hits, which the rays that went on still need.
        let objects = (!scratch.paths.is_empty()).then(|| scratch.hits.object.clone());
        I::call(MeasureEights { scan: self, pulses: pulses.clone(), scratch, rows });
        if let Some(objects) = objects {
            scratch.hits.object = objects;
            self.measure_further_surfaces::<I>(pulses, scratch, rows);
        }
    }

    /// Measures pulses of one echo or none, eight at a time. With a footprint, pulses of more echoes become
    /// `wanted`; their entries are overwritten later.
    #[inline(always)]
    fn measure_eights<I: Isa, const FOOTPRINT: bool>(
        &self,
        pulses: Range<usize>,
        scratch: &mut Scratch,
        rows: &mut Rows,
    ) {
        let beam = if FOOTPRINT { self.measurement.beam.as_ref() } else { None };
        let rays = self.measurement.rays();
        let indices = std::mem::take(&mut scratch.indices);
        let batch = self.frame.pulses(pulses.clone(), &indices);
        for part in 0..pulses.len().div_ceil(8) {
            let surfaces = match beam {
                None => self.eight_surfaces::<I>(part, scratch),
                Some(beam) => {
                    // Lanes past the last pulse repeat it.
                    let numbers = [0, 1, 2, 3, 4, 5, 6, 7].map(|k| (8 * part + k).min(pulses.len() - 1));
                    let (surfaces, others) = scratch.only_echoes::<I>(beam, &numbers);
                    scratch.wanted.push(others);
                    surfaces
                }
            };
            let objects = self.measure_eight::<I>(&batch, part, &surfaces, &scratch.draws, rows);
            if beam.is_none() {
                scratch.hits.object.as_chunks_mut().0[part] = objects;
            }
            if !rows.true_direction.is_empty() {
                let directions = self.measurement.effects.directions(&batch, &scratch.draws);
                let entries = rows.true_direction.iter_mut().zip(directions).skip(8 * part);
                for ((entry, direction), object) in entries.zip(objects) {
                    entry.write(match beam {
                        _ if object < 0 && object != AIR => unused::true_direction,
                        Some(beam) => beside(*direction, beam.offset(0)),
                        None => *direction,
                    });
                }
            }
            for (pulse, object) in (8 * part..scratch.range_rate.len()).zip(objects) {
                let rate =
                    if object >= 0 { self.range_rate(pulse, pulse * rays, scratch) } else { [f64::NAN; 2] };
                scratch.range_rate[pulse] = rate;
            }
        }
        for entry in &mut *rows.mirrored_point {
            entry.write(unused::mirrored_point);
        }
        scratch.indices = indices;
    }

    /// What the rays from 8·part on meet.
    #[inline(always)]
    fn eight_surfaces<I: Isa>(&self, part: usize, scratch: &Scratch) -> EightSurfaces<I::F64x8> {
        let EightLights { range, cosine, squared_sine, intensity } = self.eight_lights::<I>(part, scratch);
        let hits = &scratch.hits;
        let t: I::F64x8 = lanes::load(&hits.t, part);
        let mut intensity = intensity;
        if self.measurement.effects.attenuates() {
            let mut transmission = [1.0; 8];
            self.measurement.effects.attenuate(&range.store(), &mut transmission);
            intensity = intensity.mul(I::F64x8::load(&transmission));
        }
        EightSurfaces {
            object: hits.object.as_chunks().0[part],
            primitive: hits.primitive.as_chunks().0[part],
            normal: hits.normal.as_chunks().0.as_chunks().0[part],
            missed: !t.lt(I::F64x8::splat(f64::INFINITY)) & 0xff,
            truth: range,
            range,
            cosine,
            squared_sine,
            intensity,
            power: intensity.div(range.mul(range)),
        }
    }

    /// Measures eight pulses, those from 8·part on. Returns the objects that they report, or `AIR`.
    #[inline(always)]
    pub(super) fn measure_eight<I: Isa>(
        &self,
        batch: &Pulses,
        part: usize,
        surfaces: &EightSurfaces<I::F64x8>,
        draws: &Draws,
        rows: &mut Rows,
    ) -> [i32; 8] {
        let EightSurfaces { object: mut object_id, primitive, mut missed, range, cosine, .. } = *surfaces;
        let mut echoes = Echoes::new(part, 0, range, surfaces.intensity, surfaces.power, missed);
        self.measurement.effects.apply(batch, draws, &mut echoes);

        let nan = I::F64x8::splat(f64::NAN);
        let mut reported = echoes.report();
        if self.measurement.effects.has_weather() {
            let surface = I::pick(missed, I::F64x8::splat(f64::INFINITY), range);
            self.add_weather::<I>(part, batch, draws, surface, &mut reported);
        }
        let Reported { kept, mut aerial, truth: seen, .. } = reported;
        let truth = I::pick(aerial, seen, surfaces.truth);
        let mut range = I::pick(kept, reported.range, nan);
        let mut intensity = I::pick(kept, reported.intensity, nan);
        let (mut range_error, mut falsely) = (range.sub(truth), 0);
        if let Some(others) = self.measurement.effects.false_returns(part, batch, draws) {
            let preferred = self.measurement.returns.prefer_false(others.reported_range(), seen);
            falsely = others.kept & (preferred | !kept);
            range = I::pick(falsely, others.reported_range(), range);
            intensity = I::pick(falsely, others.intensity, intensity);
            range_error = I::pick(falsely, nan, range_error);
            aerial &= !falsely;
            // They hit nothing.
            missed |= falsely;
            put(falsely, -1, &mut object_id);
        }
        let (untrue, mut objects) = (missed & !aerial, object_id);
        missed |= aerial;
        put(aerial, -1, &mut object_id);
        put(aerial, AIR, &mut objects);
        let [instance, mut label] = self.instances_and_labels(&object_id, &primitive);
        put(aerial, self.measurement.air_label, &mut label);
        let mut normal = [[0.0; 3]; 8];
        let parts = surfaces.normal.map(|part| part.map(|x| x as f32));
        normal.as_flattened_mut().as_chunks_mut().0.copy_from_slice(&parts);
        put(missed, Entries::<1>::UNUSED.normal[0], &mut normal);
        let mut incidence = [0.0; 8];
        if !rows.incidence.is_empty() {
            let sines = surfaces.squared_sine.sqrt().store();
            let cosines = I::pick(missed, nan, cosine).store();
            for k in 0..8 {
                incidence[k] = first_quadrant_angle(sines[k], cosines[k]) as f32;
            }
        }
        let returned = kept | falsely;
        let status = u64::from_le_bytes(echoes.statuses()) & !lanes::bytes(returned, u8::MAX);
        let source = lanes::bytes(missed & !(falsely | aerial), Entries::<1>::UNUSED.source[0])
            | lanes::bytes(!missed & 0xff, Source::Surface as u8)
            | lanes::bytes(aerial, Source::Atmosphere as u8)
            | lanes::bytes(falsely, Source::FalseReturn as u8);
        rows.write(
            part,
            Entries {
                range: range.store(),
                true_range: I::pick(untrue, nan, truth).store(),
                range_error: range_error.store(),
                intensity: intensity.store().map(|x| x as f32),
                normal,
                object_id,
                instance,
                label,
                source: source.to_le_bytes(),
                path: lanes::bytes(missed, Entries::<1>::UNUSED.path[0]).to_le_bytes(),
                incidence,
            },
        );
        write(rows.status, part, status.to_le_bytes());
        write(rows.return_count, part, lanes::bytes(returned, 1).to_le_bytes());
        objects
    }

    #[inline(always)]
    fn instances_and_labels(&self, objects: &[i32; 8], primitives: &[i32; 8]) -> [[u32; 8]; 2] {
        if let Some(appearance) = self.hit_by_all(objects)
            && let Labels::Object(label) = appearance.labels
        {
            return [[appearance.instance; 8], [label; 8]];
        }
        let (mut instances, mut labels) = ([0; 8], [0; 8]);
        for k in 0..8 {
            [instances[k], labels[k]] = self.instance_and_label(objects[k], primitives[k]);
        }
        [instances, labels]
    }
}

/// Writes a value to the entries of these lanes.
#[inline(always)]
fn put<T: Copy>(lanes: u32, value: T, entries: &mut [T; 8]) {
    if lanes != 0 {
        for (k, entry) in entries.iter_mut().enumerate() {
            if lanes & 1 << k != 0 {
                *entry = value;
            }
        }
    }
}
