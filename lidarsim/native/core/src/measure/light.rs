//! From hits to light: range, incidence and intensity of each ray.

use super::appearance::Reflectivity;
use super::backscatter::Backscatter;
use super::direction::distance;
use super::echo::Light;
use super::scan::Scan;
use super::scratch::{LightArrays, Scratch};
use crate::arith::simd::{self, Floats, Isa, Task, lanes};
use crate::memory::resize;

/// The light of eight rays; unspecified for misses.
pub(super) struct EightLights<F> {
    pub(super) range: F,
    /// Of the incidence.
    pub(super) cosine: F,
    pub(super) squared_sine: F,
    /// In clear air.
    pub(super) intensity: F,
}

/// Stores the light of all rays; with `of_further`, only of eights in which the light of a ray goes on:
/// others are unspecified.
pub(super) struct KeepLight<'a, 'b> {
    pub(super) scan: &'a Scan<'b>,
    pub(super) of_further: bool,
    pub(super) scratch: &'a mut Scratch,
}

impl Task for KeepLight<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let KeepLight { scan, of_further, scratch } = self;
        let whole = scratch.hits.len();
        let LightArrays { range, cosine, intensity, transmission, received, power } = &mut scratch.light;
        for numbers in [range, cosine, intensity, received, power] {
            resize(numbers, whole, 0.0);
        }
        transmission.clear();
        resize(transmission, whole, 1.0);
        for part in 0..whole / 8 {
            if of_further && !scratch.paths.touch(part) {
                continue;
            }
            let lights = scan.eight_lights::<I>(part, scratch);
            let LightArrays { range, cosine, intensity, .. } = &mut scratch.light;
            range.as_chunks_mut().0[part] = lights.range.store();
            cosine.as_chunks_mut().0[part] = lights.cosine.store();
            intensity.as_chunks_mut().0[part] = lights.intensity.store();
            if !scratch.paths.is_empty() {
                let shares = I::F64x8::load(&scratch.paths.each(part, 1.0, |path| path.share));
                intensity.as_chunks_mut().0[part] = lights.intensity.mul(shares).store();
            }
        }
        let LightArrays { range, intensity, transmission, received, power, .. } = &mut scratch.light;
        scan.measurement.effects.attenuate(range, transmission);
        for part in 0..whole / 8 {
            let (range, clear): (I::F64x8, I::F64x8) =
                (lanes::load(range, part), lanes::load(intensity, part));
            let left = clear.mul(lanes::load(transmission, part));
            received.as_chunks_mut().0[part] = left.store();
            power.as_chunks_mut().0[part] = left.div(range.mul(range)).store();
        }
    }
}

impl Scan<'_> {
    /// The reflectivity of what each ray hits. Makes arrays of hits and rays as long as whole registers.
    #[inline(always)]
    pub(super) fn reflect<I: Isa>(&self, scratch: &mut Scratch) {
        let Scratch { rays, hits, reflectivity, is_lambert, grain_hits, .. } = scratch;
        let (whole, mut all_lambert) = (hits.len().next_multiple_of(8), true);
        hits.resize(whole);
        resize(&mut rays.directions, whole, [0.0; 3]);
        resize(reflectivity, whole, 0.0);
        let objects = hits.object.as_chunks::<8>().0;
        for (part, (values, objects)) in
            reflectivity.as_chunks_mut::<8>().0.iter_mut().zip(objects).enumerate()
        {
            if let Some(appearance) = self.hit_by_all(objects)
                && let Reflectivity::Object(value) = appearance.reflectivity
                && appearance.grain.is_none()
            {
                *values = [value; 8];
                all_lambert &= appearance.backscatter.is_none();
                continue;
            }
            for (k, object) in objects.iter().enumerate() {
                if let Some(appearance) = self.appearances.get(*object as usize) {
                    let i = 8 * part + k;
                    let hit = || (hits.at(i), rays.at(i));
                    values[k] = appearance.reflectivity.at(hits.primitive[i], hit, self.world.scene);
                    if let Some(grain) = &appearance.grain {
                        let (hit, ray) = hit();
                        grain_hits.push(i, grain, self.world.scene.place_on_object(&hit, &ray));
                    }
                    all_lambert &= appearance.backscatter.is_none();
                }
            }
        }
        grain_hits.apply::<I>(reflectivity);
        *is_lambert = all_lambert;
    }

    /// The light of the rays from 8·part on, in clear air.
    #[inline(always)]
    pub(super) fn eight_lights<I: Isa>(&self, part: usize, scratch: &Scratch) -> EightLights<I::F64x8> {
        let Scratch { rays, hits, reflectivity, .. } = scratch;
        let normal = simd::load_points::<I>(&hits.normal.as_chunks().0.as_chunks().0[part]);
        let direction = simd::load_points::<I>(&rays.directions.as_chunks().0[part]);
        let mut range = distance(lanes::load(&hits.t, part), direction);
        if !scratch.paths.is_empty() {
            range = range.add(I::F64x8::load(&scratch.paths.each(part, 0.0, |path| path.before)));
        }
        let cross = lanes::cross(normal, direction);
        let cosine = lanes::dot(normal, direction).abs();
        let squared_sine = lanes::dot(cross, cross);
        let mut backscatter = cosine;
        if !scratch.is_lambert {
            let surfaces = self.backscatters(&hits.object.as_chunks().0[part]);
            backscatter = Backscatter::of(&surfaces, cosine, squared_sine);
        }
        let reflectivity: I::F64x8 = lanes::load(reflectivity, part);
        let intensity = self.measurement.effects.gather(range, reflectivity.mul(backscatter));
        EightLights { range, cosine, squared_sine, intensity }
    }

    /// Of the objects that N rays hit; Lambert's for misses.
    #[inline(always)]
    fn backscatters<const N: usize>(&self, objects: &[i32; N]) -> [Backscatter; N] {
        let mut surfaces = [Backscatter::LAMBERT; N];
        for (surface, object) in surfaces.iter_mut().zip(objects) {
            if let Some(appearance) = self.appearances.get(*object as usize)
                && let Some(backscatter) = appearance.backscatter
            {
                *surface = backscatter;
            }
        }
        surfaces
    }
}

impl Scratch {
    /// The light of the surfaces that a fired ray meets after the first.
    #[inline(always)]
    pub(super) fn further_lights(&self, ray: usize) -> impl Iterator<Item = Light> {
        self.paths.of(ray).iter().filter_map(|at| self.light_of(*at as usize))
    }

    /// The light that a ray brings back, if it hits anything.
    #[inline(always)]
    pub(super) fn light_of(&self, ray: usize) -> Option<Light> {
        if self.hits.object[ray] < 0 {
            return None;
        }
        let LightArrays { range, intensity: clear, received, power, .. } = &self.light;
        let (range, clear) = (range[ray], clear[ray]);
        let clear_power = clear / (range * range);
        Some(Light { ray, range, intensity: received[ray], power: power[ray], clear_power })
    }
}
