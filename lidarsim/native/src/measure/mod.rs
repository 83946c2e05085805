//! From pulses to returns, each effect one small function.
//!
//! The order for a pulse: jitter of the beam, sub-rays over its footprint, cast, intensity, echoes, range gate, detection,
//! drop-out, range noise, quantisation, range gate again, choice of returns. An effect that is off costs nothing and draws
//! nothing; what it draws ([`Effect`]) hangs on the pulse alone.

mod appearance;
mod beam;
mod direction;
mod echo;
mod parameters;

use std::ops::Range;

use crate::elementary::first_quadrant_angle;
use crate::number::Interval;
use crate::pose::{Path, Pose, cross, dot, sub};
use crate::rng::{Effect, Stream};
use crate::scene::{Geometry, Hit, Scene};
use crate::simd::{self, Isa, Level, Task};
use crate::vector::Point;
use direction::{beside, distance, is_unit, turned};
use echo::{Echo, Light};

pub use appearance::{Appearance, Reflectivity};
pub use beam::Beam;
pub use echo::Returns;
pub use parameters::{Detection, Measurement, RangeSigma};

/// What finds the surfaces.
pub trait Caster: Sync {
    /// The nearest hit of each ray with t ≥ 0.
    fn cast(&self, level: Level, origins: &[Point], directions: &[Point], hits: &mut [Hit]);

    /// The vertices of the triangle of a mesh that was hit, and the share that each has of the hit.
    fn shares(&self, hit: &Hit, origin: Point, direction: Point) -> Option<([u32; 3], [f64; 3])>;
}

impl Caster for Scene {
    fn cast(&self, level: Level, origins: &[Point], directions: &[Point], hits: &mut [Hit]) {
        // The rays are legal: `Frame::check` has seen them.
        Scene::cast(self, level, origins, directions, (0.0, f64::INFINITY), hits);
    }

    fn shares(&self, hit: &Hit, origin: Point, direction: Point) -> Option<([u32; 3], [f64; 3])> {
        let object = &self.objects()[hit.object as usize];
        let Geometry::Mesh(mesh) = &object.geometry else { return None };
        let vertices = mesh.faces()[hit.primitive as usize];
        let (o, d) = object.enclose(origin, direction);
        let middle = |x: Interval| x.low + 0.5 * (x.high - x.low);
        // From the hit to the corners: a triangle far from the origin of coordinates keeps its digits.
        let way = d.map(|x| hit.t * middle(x));
        let [a, b, c] = vertices.map(|v| sub(sub(mesh.vertices()[v as usize], o.map(middle)), way));
        // Twice the areas opposite to the corners; a hit on the rim may be outside by rounding.
        let normal = cross(sub(b, a), sub(c, a));
        let areas = [cross(b, c), cross(c, a), cross(a, b)].map(|n| dot(n, normal).max(0.0));
        let all = areas[0] + areas[1] + areas[2];
        Some((vertices, areas.map(|area| area / all)))
    }
}

/// Why a pulse is or is not a point. The numbers are part of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    Hit = 0,
    Miss = 1,
    BelowMinRange = 2,
    BeyondMaxRange = 3,
    BelowThreshold = 4,
    Dropped = 5,
}

/// One frame to be fired.
pub struct Frame<'a> {
    /// In the sensor frame; directions unit to rounding.
    pub origins: &'a [Point],
    pub directions: &'a [Point],
    /// Since the start of the frame, s.
    pub times: &'a [f64],
    /// Which pulses of the whole frame these are, if they are not all of them in order.
    pub indices: Option<&'a [u64]>,
    pub start: f64,
    pub path: &'a Path,
    pub stream: Stream,
}

impl Frame<'_> {
    fn index(&self, i: usize) -> u64 {
        self.indices.map_or(i as u64, |indices| indices[i])
    }

    fn check(&self, pulses: Range<usize>) -> Result<(), BadPulse> {
        let [first, last] = self.path.span();
        for pulse in pulses {
            let time = self.start + self.times[pulse];
            let fault = if !is_unit(self.directions[pulse]) {
                Fault::Direction
            } else if !self.origins[pulse].iter().all(|x| x.is_finite()) {
                Fault::Origin
            } else if !(time.is_finite() && first <= time && time <= last) {
                Fault::Time
            } else {
                continue;
            };
            return Err(BadPulse { pulse, fault });
        }
        Ok(())
    }
}

/// A pulse that cannot be fired, and why.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct BadPulse {
    pub pulse: usize,
    pub fault: Fault,
}

#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Fault {
    /// Its direction is not a unit vector.
    Direction,
    /// Its origin is not finite.
    Origin,
    /// There is no pose for its time.
    Time,
}

/// Where the result goes: for each pulse as many rows as it can have returns, and one status.
pub struct Rows<'a> {
    pub range: &'a mut [f64],
    pub true_range: &'a mut [f64],
    pub range_error: &'a mut [f64],
    pub intensity: &'a mut [f32],
    pub incidence: &'a mut [f32],
    pub normal: &'a mut [[f32; 3]],
    pub object_id: &'a mut [i32],
    pub label: &'a mut [u32],
    pub status: &'a mut [u8],
    pub return_count: &'a mut [u8],
}

impl Rows<'_> {
    /// All but the incidence.
    #[inline(always)]
    fn write(&mut self, row: usize, echo: &Echo, hit: &Hit, label: u32) {
        self.true_range[row] = echo.true_range;
        self.normal[row] = hit.normal.map(|x| x as f32);
        self.object_id[row] = hit.object;
        self.label[row] = label;
        let range = echo.measured.unwrap_or(f64::NAN);
        self.range[row] = range;
        self.range_error[row] = range - echo.true_range;
        self.intensity[row] = if echo.measured.is_ok() { echo.intensity as f32 } else { f32::NAN };
    }

    #[inline(always)]
    fn clear(&mut self, row: usize) {
        self.true_range[row] = f64::NAN;
        self.normal[row] = [f32::NAN; 3];
        self.object_id[row] = -1;
        self.label[row] = 0;
        self.range[row] = f64::NAN;
        self.range_error[row] = f64::NAN;
        self.intensity[row] = f32::NAN;
    }
}

/// A frame fired at a scene.
pub struct Scan<'a, C> {
    frame: &'a Frame<'a>,
    measurement: &'a Measurement,
    appearances: &'a [Appearance],
    caster: &'a C,
    level: Level,
    /// The least power that is detected.
    threshold: Option<f64>,
}

/// Rays in the world and what they hit; with a beam, the sub-rays of one pulse after those of the other. Kept from one batch of
/// pulses to the next, so that its memory is used again.
#[derive(Default)]
pub struct Rays {
    origins: Vec<Point>,
    directions: Vec<Point>,
    hits: Vec<Hit>,
    /// Gaussians, one a pulse; those of effects that are off are empty. Further echoes draw their noise as they come.
    azimuth_jitter: Vec<f64>,
    elevation_jitter: Vec<f64>,
    noise: Vec<f64>,
}

/// The work on some pulses, compiled for each instruction set.
struct Batch<'a, 'b, 'c, C> {
    scan: &'b Scan<'a, C>,
    pulses: Range<usize>,
    rays: &'b mut Rays,
    rows: &'b mut Rows<'c>,
}

impl<C: Caster> Task for Batch<'_, '_, '_, C> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        self.scan.measure_batch(self.pulses, self.rays, self.rows)
    }
}

impl<'a, C: Caster> Scan<'a, C> {
    pub fn new(
        frame: &'a Frame<'a>,
        measurement: &'a Measurement,
        appearances: &'a [Appearance],
        caster: &'a C,
        level: Level,
    ) -> Self {
        let power = |d: Detection| measurement.intensity(d.reflectivity, 1.0, d.range) / (d.range * d.range);
        Scan { frame, measurement, appearances, caster, level, threshold: measurement.detection.map(power) }
    }

    /// Measure some pulses, whose rows these are.
    pub fn measure(&self, pulses: Range<usize>, rays: &mut Rays, rows: &mut Rows) -> Result<(), BadPulse> {
        simd::dispatch(self.level, Batch { scan: self, pulses, rays, rows })
    }

    #[inline(always)]
    fn measure_batch(&self, pulses: Range<usize>, rays: &mut Rays, rows: &mut Rows) -> Result<(), BadPulse> {
        self.cast(pulses.clone(), rays)?;
        let most = self.measurement.returns.most();
        // Of each row, squared sine and cosine of the incidence; the angles come in a loop of their own.
        let mut incidences = vec![[f64::NAN; 2]; pulses.len() * most];
        let (mut echoes, mut chosen) = (Vec::new(), Vec::new());
        for (i, pulse) in pulses.enumerate() {
            let first = i * most;
            let mut row = first;
            let mut status = Status::Miss;
            let mut report = |echo: Echo| {
                if row == first {
                    status = echo.measured.err().unwrap_or(Status::Hit);
                }
                let (hit, direction) = (&rays.hits[echo.ray], rays.directions[echo.ray]);
                let label = self.appearance(rays, echo.ray).map_or(0, |appearance| appearance.label);
                rows.write(row, &echo, hit, label);
                let across = cross(hit.normal, direction);
                incidences[row] = [dot(across, across), dot(hit.normal, direction).abs()];
                row += 1;
            };
            match &self.measurement.beam {
                None => {
                    if let Some(light) = self.light(rays, i) {
                        report(self.received(Echo::of(light), rays, i, pulse, 0));
                    }
                }
                Some(beam) => {
                    let lit = |(ray, share)| self.light(rays, ray).map(|light| light.dimmed(share));
                    rays.echoes(beam, beam.sub_rays(i).filter_map(lit).collect(), &mut echoes);
                    for (echo, number) in echoes.iter_mut().zip(0..) {
                        *echo = self.received(*echo, rays, i, pulse, number);
                    }
                    self.measurement.returns.choose(&echoes, &mut chosen);
                    chosen.iter().for_each(|echo| report(*echo));
                }
            }
            rows.status[i] = status as u8;
            rows.return_count[i] = if status == Status::Hit { (row - first) as u8 } else { 0 };
            for row in row..first + most {
                rows.clear(row);
            }
        }
        for (angle, [squared_sin, cos]) in rows.incidence.iter_mut().zip(incidences) {
            *angle = first_quadrant_angle(squared_sin.sqrt(), cos) as f32;
        }
        Ok(())
    }

    #[inline(always)]
    fn cast(&self, pulses: Range<usize>, rays: &mut Rays) -> Result<(), BadPulse> {
        let (frame, measurement) = (self.frame, self.measurement);
        frame.check(pulses.clone())?;
        rays.origins.clear();
        rays.directions.clear();
        let draw = |wanted: bool, effect, draw, normals: &mut Vec<f64>| {
            let pulses = if wanted { pulses.clone() } else { 0..0 };
            frame.stream.normals(pulses.map(|i| frame.index(i)), effect, draw, normals);
        };
        draw(measurement.azimuth_sigma > 0.0, Effect::AngularJitter, 0, &mut rays.azimuth_jitter);
        draw(measurement.elevation_sigma > 0.0, Effect::AngularJitter, 1, &mut rays.elevation_jitter);
        draw(!measurement.range_sigma.is_zero(), Effect::RangeNoise, 0, &mut rays.noise);
        let jitters = measurement.azimuth_sigma > 0.0 || measurement.elevation_sigma > 0.0;
        let (mut now, mut pose) = (f64::NAN, Pose::IDENTITY);
        for (k, i) in pulses.enumerate() {
            if frame.times[i] != now {
                now = frame.times[i];
                pose = frame.path.at(frame.start + now);
            }
            let mut direction = frame.directions[i];
            if jitters {
                let angle = |sigma: f64, normals: &[f64]| normals.get(k).map_or(0.0, |normal| sigma * normal);
                let azimuth = angle(measurement.azimuth_sigma, &rays.azimuth_jitter);
                direction = turned(direction, azimuth, angle(measurement.elevation_sigma, &rays.elevation_jitter));
            }
            let origin = pose.place(frame.origins[i]);
            match &measurement.beam {
                None => {
                    rays.origins.push(origin);
                    rays.directions.push(pose.turn(direction));
                }
                Some(beam) => {
                    for offset in beam.offsets() {
                        rays.origins.push(origin);
                        rays.directions.push(pose.turn(beside(direction, offset)));
                    }
                }
            }
        }
        rays.hits.resize(rays.origins.len(), Hit::MISS);
        self.caster.cast(self.level, &rays.origins, &rays.directions, &mut rays.hits);
        Ok(())
    }

    /// What was hit, if anything was.
    #[inline(always)]
    fn appearance(&self, rays: &Rays, ray: usize) -> Option<&Appearance> {
        self.appearances.get(usize::try_from(rays.hits[ray].object).ok()?)
    }

    #[inline(always)]
    fn light(&self, rays: &Rays, ray: usize) -> Option<Light> {
        let appearance = self.appearance(rays, ray)?;
        let (hit, direction) = (&rays.hits[ray], rays.directions[ray]);
        let range = distance(hit.t, direction);
        let reflectivity = appearance.reflectivity.at(hit, rays.origins[ray], direction, self.caster);
        let intensity = self.measurement.intensity(reflectivity, dot(hit.normal, direction).abs(), range);
        Some(Light { ray, range, intensity, power: intensity / (range * range) })
    }

    /// An echo as it is measured: the `i`-th pulse of the batch, the `pulse`-th of those given, and its echo `number`.
    #[inline(always)]
    fn received(&self, echo: Echo, rays: &Rays, i: usize, pulse: usize, number: u16) -> Echo {
        let (stream, index) = (&self.frame.stream, self.frame.index(pulse));
        let noise = || match rays.noise.get(i) {
            None => 0.0,
            Some(&noise) if number == 0 => noise,
            Some(_) => stream.normal(index, Effect::RangeNoise, number),
        };
        let m = self.measurement;
        let measured = || {
            m.gate(echo.range)?;
            // Of 0/0, a black surface at distance zero, this is false.
            let seen = self.threshold.is_none_or(|least| echo.power >= least);
            if !seen {
                return Err(Status::BelowThreshold);
            }
            if m.dropout > 0.0 && stream.uniform(index, Effect::Dropout, 0) < m.dropout {
                return Err(Status::Dropped);
            }
            m.gate(m.quantised(echo.range + (m.range_bias + m.range_sigma.at(echo.range) * noise())))
        };
        Echo { measured: measured(), ..echo }
    }
}
