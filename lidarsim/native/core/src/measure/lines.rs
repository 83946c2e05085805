//! Pulses of one ray each, eight at a time.

use std::mem::MaybeUninit;
use std::ops::Range;

use super::direction::distance;
use super::{Caster, RangeSigma, Rows, Scan, Scratch, Status};
use crate::arith::simd::{self, Floats, Isa, lanes};
use crate::memory::resize;

type F64x8<I> = <I as Isa>::F64x8;

impl<C: Caster> Scan<'_, C> {
    /// Measures pulses of one ray each: so each has one echo at most, and one row.
    #[inline(always)]
    pub(super) fn measure_lines<I: Isa>(&self, pulses: Range<usize>, rays: &mut Scratch, rows: &mut Rows) {
        let whole = pulses.len().next_multiple_of(8);
        rays.hits.resize(whole);
        resize(&mut rays.directions, whole, [0.0; 3]);
        let Scratch { intensity, noise, bias, offset, dropout, squared_sin, cos, .. } = &mut *rays;
        for numbers in [intensity, noise, bias, offset, dropout] {
            let length = if numbers.is_empty() { 0 } else { whole };
            resize(numbers, length, 0.0);
        }
        resize(squared_sin, whole, 0.0);
        resize(cos, whole, 0.0);
        for eight in 0..whole / 8 {
            self.measure_eight::<I>(pulses.clone(), eight, rays, rows);
        }
    }

    #[inline(always)]
    fn measure_eight<I: Isa>(&self, pulses: Range<usize>, eight: usize, rays: &mut Scratch, rows: &mut Rows) {
        let nan = F64x8::<I>::splat(f64::NAN);
        let hits = &rays.hits;
        let normals: &[[f64; 3]; 8] = &hits.normal.as_chunks().0.as_chunks().0[eight];
        let (objects, primitives) = (hits.object.as_chunks::<8>().0[eight], hits.primitive.as_chunks::<8>().0[eight]);
        let (n, d) = (simd::load_points::<I>(normals), simd::load_points::<I>(&rays.directions.as_chunks().0[eight]));
        let mut missed = 0;
        for (k, object) in objects.iter().enumerate() {
            missed |= (*object as u32 >> 31) << k;
        }
        let truth = distance(eight_of::<I>(&hits.t, eight), d);
        let across = lanes::cross(n, d);
        let cos = lanes::dot(n, d).abs();
        let mut intensity = eight_of::<I>(&rays.intensity, eight).mul(cos);
        if self.measurement.effects.extinction > 0.0 {
            let transmission = truth.store().map(|range| self.measurement.transmission(range));
            intensity = intensity.mul(F64x8::<I>::load(&transmission));
        }
        let measured = self.sensed_eight::<I>(truth, eight, rays);
        let found = self.found::<I>((truth, measured, intensity), eight, rays) & !missed;
        let mut reported = measured;
        if !rays.offset.is_empty() {
            reported = reported.sub(eight_of::<I>(&rays.offset, eight));
        }
        let range = I::pick(found, reported, nan);
        put_eight(rows.range, eight, range.store());
        put_eight(rows.true_range, eight, I::pick(missed, nan, truth).store());
        put_eight(rows.range_error, eight, range.sub(truth).store());
        put_eight(rows.intensity, eight, I::pick(found, intensity, nan).store().map(|x| x as f32));
        put_eight(rows.object_id, eight, objects);
        let numbers: [[u32; 2]; 8] = std::array::from_fn(|k| self.numbers(objects[k], primitives[k]));
        put_eight(rows.instance, eight, numbers.map(|[instance, _]| instance));
        put_eight(rows.label, eight, numbers.map(|[_, label]| label));
        let parts: [[f64; 8]; 3] = hits.normal.as_chunks().0.as_chunks().0[eight];
        let mut normal = parts.map(|part| part.map(|x| x as f32));
        let mut status = [Status::Hit as u8; 8];
        if found != 0xff {
            let (truth, measured, intensity) = (truth.store(), measured.store(), intensity.store());
            for k in 0..8 {
                if missed & 1 << k != 0 {
                    normal.as_flattened_mut()[3 * k..3 * k + 3].fill(f32::NAN);
                    status[k] = Status::Miss as u8;
                } else {
                    let power = intensity[k] / (truth[k] * truth[k]);
                    let why = self.detected(power, measured[k], rays, 8 * eight + k).err();
                    status[k] = why.unwrap_or(Status::Hit) as u8;
                }
            }
        }
        for (k, part) in normal.into_iter().enumerate() {
            put_eight(rows.normal, 3 * eight + k, part);
        }
        put_eight(rows.status, eight, status);
        put_eight(rows.return_count, eight, status.map(|status| u8::from(status == Status::Hit as u8)));
        rays.squared_sin.as_chunks_mut().0[eight] = I::pick(missed, nan, lanes::dot(across, across)).store();
        rays.cos.as_chunks_mut().0[eight] = I::pick(missed, nan, cos).store();
        if rows.true_direction.is_empty() && rays.approach.is_empty() {
            return;
        }
        for i in 8 * eight..pulses.len().min(8 * eight + 8) {
            let is_hit = rays.hits.object[i] >= 0;
            if let Some(direction) = rows.true_direction.get_mut(i) {
                direction.write(if is_hit { self.axis(pulses.start, i, rays) } else { [f64::NAN; 3] });
            }
            if i < rays.approach.len() {
                rays.approach[i] = if is_hit { self.approach(i, i, rays) } else { [f64::NAN; 2] };
            }
        }
    }

    /// As `sensed`, of the only echoes of eight pulses.
    #[inline(always)]
    fn sensed_eight<I: Isa>(&self, range: F64x8<I>, eight: usize, rays: &Scratch) -> F64x8<I> {
        let m = self.measurement;
        let mut added = F64x8::<I>::splat(m.effects.range_bias);
        if !rays.bias.is_empty() {
            added = eight_of::<I>(&rays.bias, eight);
        }
        if !rays.noise.is_empty() {
            let sigma = match &m.range_sigma {
                RangeSigma::Formula { a, b: 0.0 } => F64x8::<I>::splat(*a),
                sigma => F64x8::<I>::load(&range.store().map(|range| sigma.at(range))),
            };
            added = added.add(sigma.mul(eight_of::<I>(&rays.noise, eight)));
        }
        let mut sensed = range.add(added);
        if !rays.offset.is_empty() {
            sensed = sensed.add(eight_of::<I>(&rays.offset, eight));
        }
        if m.effects.range_resolution > 0.0 {
            sensed = F64x8::<I>::load(&sensed.store().map(|range| m.quantised(range)));
        }
        sensed
    }

    /// In which lanes `detected` finds a range.
    #[inline(always)]
    fn found<I: Isa>(
        &self,
        (truth, measured, intensity): (F64x8<I>, F64x8<I>, F64x8<I>),
        eight: usize,
        rays: &Scratch,
    ) -> u32 {
        let m = self.measurement;
        let (least, most) = (F64x8::<I>::splat(m.min_range), F64x8::<I>::splat(m.max_range.min(f64::MAX)));
        let mut found = least.le(measured) & measured.le(most);
        if let Some(least) = self.threshold {
            found &= F64x8::<I>::splat(least).le(intensity.div(truth.mul(truth)));
        }
        if !rays.dropout.is_empty() {
            found &= !eight_of::<I>(&rays.dropout, eight).lt(F64x8::<I>::splat(m.effects.dropout));
        }
        found
    }
}

#[inline(always)]
fn eight_of<I: Isa>(numbers: &[f64], eight: usize) -> F64x8<I> {
    F64x8::<I>::load(&numbers.as_chunks().0[eight])
}

/// Writes eight rows, or as many as are left.
#[inline(always)]
fn put_eight<T: Copy>(rows: &mut [MaybeUninit<T>], eight: usize, values: [T; 8]) {
    match rows.as_chunks_mut().0.get_mut(eight) {
        Some(rows) => *rows = values.map(MaybeUninit::new),
        None => {
            for (row, value) in rows.iter_mut().skip(8 * eight).zip(values) {
                row.write(value);
            }
        }
    }
}
