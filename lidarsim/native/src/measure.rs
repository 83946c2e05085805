//! From pulses to returns: one pulse at a time, each effect one small function.
//!
//! The order for a pulse: jitter of the beam, sub-rays over its footprint, cast, intensity, echoes, range gate, detection,
//! drop-out, range noise, quantisation, range gate again, choice of returns. An effect that is off costs nothing and draws
//! nothing; what it draws ([`Effect`]) hangs on the pulse alone.

use std::ops::Range;

use crate::elementary::{exp, first_quadrant_angle, sin_cos};
use crate::number::Interval;
use crate::pose::{Path, Pose, cross, dot, sub};
use crate::rng::{Effect, Stream};
use crate::scene::{Geometry, Hit, Scene};
use crate::simd::{self, Isa, Level, Task};
use crate::vector::Point;

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

/// The parameters, each neutral while its effect is off.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Standard deviations of the beam's direction, rad.
    pub azimuth_sigma: f64,
    pub elevation_sigma: f64,
    /// α of e^(−2αR), 1/m.
    pub extinction: f64,
    pub detection: Option<Detection>,
    /// Probability.
    pub dropout: f64,
    pub range_sigma: RangeSigma,
    pub range_bias: f64,
    pub beam: Option<Beam>,
    pub returns: Returns,
    /// Least significant bit of the range, m; 0 for none.
    pub range_resolution: f64,
    pub min_range: f64,
    pub max_range: f64,
}

/// A target of this reflectivity at normal incidence is seen out to this range.
#[derive(Clone, Copy, Debug)]
pub struct Detection {
    pub reflectivity: f64,
    pub range: f64,
}

/// Standard deviation of the range, m.
#[derive(Clone, Debug)]
pub enum RangeSigma {
    /// √(a² + (bR)²)
    Formula { a: f64, b: f64 },
    /// (range, sigma) with rising ranges: linear between, constant outside.
    Table(Vec<[f64; 2]>),
}

/// Which echoes of a pulse are reported, and in which order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Returns {
    Strongest,
    First,
    Last,
    /// The strongest, then the last; where these are one, the next strongest.
    Dual,
    /// This many at most, from the nearest on.
    Nearest(usize),
}

impl Returns {
    /// The most returns a pulse can have.
    pub fn most(self) -> usize {
        match self {
            Returns::Strongest | Returns::First | Returns::Last => 1,
            Returns::Dual => 2,
            Returns::Nearest(n) => n,
        }
    }

    /// Of the `echoes` of a pulse, which rise in range, those that are reported, in their order; if all are lost, the strongest.
    fn choose(self, echoes: &[Echo], chosen: &mut Vec<Echo>) {
        chosen.clear();
        chosen.extend(echoes.iter().filter(|echo| echo.measured.is_ok()));
        if chosen.is_empty() {
            chosen.extend(echoes.get(strongest(echoes)));
        }
        if chosen.len() < 2 {
            return;
        }
        let i = strongest(chosen);
        match self {
            Returns::First | Returns::Nearest(_) => {}
            Returns::Last => chosen.reverse(),
            Returns::Strongest => chosen.swap(0, i),
            Returns::Dual => {
                let first = chosen.remove(i);
                let last = chosen.len() - 1;
                let second = if i > last { strongest(chosen) } else { last };
                chosen.swap(0, second);
                chosen.insert(0, first);
            }
        }
        chosen.truncate(self.most());
    }
}

/// Index of the strongest echo; of equal ones, the first.
fn strongest(echoes: &[Echo]) -> usize {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, echo) in echoes.iter().enumerate() {
        if echo.power > best.1 {
            best = (i, echo.power);
        }
    }
    best.0
}

/// A diverging beam as a few sub-rays.
#[derive(Clone, Debug)]
pub struct Beam {
    /// Of each sub-ray, its tangent of azimuth and elevation against the axis, and its share of the energy. The first is the axis.
    rays: Vec<([f64; 2], f64)>,
    /// Echoes closer than this are one, m.
    resolution: f64,
}

impl Beam {
    /// `divergence`: full angles at 1/e² of the axis' intensity, rad. The ellipse that they bound is divided into a disc and m
    /// rings about it, m·(m+1)·3 + 1 = `rays`, each as wide as the disc; ring k has 6k sub-rays. Each carries the energy that a
    /// Gaussian beam, of profile exp(−2r²/w²), has in its cell; what lies outside of the ellipse is spread over all.
    pub fn new(divergence: [f64; 2], rays: usize, resolution: f64) -> Self {
        let rings = (1..).take_while(|m| 3 * m * (m + 1) < rays).count();
        // In units of the half angle w.
        let width = 1.0 / (rings as f64 + 0.5);
        let inside = |radius: f64| 1.0 - exp(-2.0 * radius * radius);
        let mut cells = vec![([0.0; 2], inside(width / 2.0) / inside(1.0))];
        for k in 1..=rings {
            let radius = k as f64 * width;
            let energy = inside(radius + width / 2.0) - inside(radius - width / 2.0);
            for j in 0..6 * k {
                let (sin, cos) = sin_cos(std::f64::consts::TAU * j as f64 / (6 * k) as f64);
                let offset = [radius * cos * divergence[0] / 2.0, radius * sin * divergence[1] / 2.0];
                cells.push((offset, energy / inside(1.0) / (6 * k) as f64));
            }
        }
        Beam { rays: cells, resolution }
    }
}

/// What a lidar can tell of an object, besides where it is.
#[derive(Clone, Debug)]
pub struct Appearance {
    pub label: u32,
    pub reflectivity: Reflectivity,
}

/// How much light an object returns, as a share of what a white diffuser does.
#[derive(Clone, Debug)]
pub enum Reflectivity {
    Object(f64),
    /// One a triangle.
    Face(Vec<f64>),
    /// One a vertex, linear in between.
    Vertex(Vec<f64>),
}

impl Reflectivity {
    fn at(&self, hit: &Hit, origin: Point, direction: Point, caster: &impl Caster) -> f64 {
        match self {
            Reflectivity::Object(value) => *value,
            Reflectivity::Face(values) => values[hit.primitive as usize],
            Reflectivity::Vertex(values) => match caster.shares(hit, origin, direction) {
                Some((vertices, [u, v, w])) => {
                    let [a, b, c] = vertices.map(|i| values[i as usize]);
                    u * a + v * b + w * c
                }
                None => f64::NAN,
            },
        }
    }
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
    /// Of each pulse, the noise of its first echo, in units of σ; empty without noise.
    noise: Vec<f64>,
}

/// What a ray brings back.
#[derive(Clone, Copy)]
struct Light {
    ray: usize,
    range: f64,
    intensity: f64,
    /// Received, up to a constant: intensity/R².
    power: f64,
}

/// Light that comes back from one surface or from some too close to be told apart.
#[derive(Clone, Copy, Debug)]
struct Echo {
    /// The truth: of the object with most of the power, the sub-ray nearest to the axis; and the range of that.
    ray: usize,
    true_range: f64,
    /// The mean over the sub-rays, by power.
    range: f64,
    intensity: f64,
    power: f64,
    /// The range with all that befalls it, or why there is none.
    measured: Result<f64, Status>,
}

impl Echo {
    fn of(light: Light) -> Self {
        let Light { ray, range, intensity, power } = light;
        Echo { ray, true_range: range, range, intensity, power, measured: Ok(range) }
    }
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
                    self.echoes(rays, i, beam, &mut echoes);
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
        rays.noise.clear();
        if !measurement.range_sigma.is_zero() {
            frame.stream.normals(pulses.clone().map(|i| frame.index(i)), Effect::RangeNoise, &mut rays.noise);
        }
        let jitters = measurement.azimuth_sigma > 0.0 || measurement.elevation_sigma > 0.0;
        let (mut now, mut pose) = (f64::NAN, Pose::IDENTITY);
        for i in pulses {
            if frame.times[i] != now {
                now = frame.times[i];
                pose = frame.path.at(frame.start + now);
            }
            let mut direction = frame.directions[i];
            if jitters {
                direction = measurement.jitter(direction, &frame.stream, frame.index(i));
            }
            let origin = pose.place(frame.origins[i]);
            match &measurement.beam {
                None => {
                    rays.origins.push(origin);
                    rays.directions.push(pose.turn(direction));
                }
                Some(beam) => {
                    for (offset, _) in &beam.rays {
                        rays.origins.push(origin);
                        rays.directions.push(pose.turn(beside(direction, *offset)));
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

    /// The echoes of a pulse, by rising range.
    ///
    /// Two sub-rays are of one echo if their ranges differ by less than the resolution, or if each meets the tangent plane of
    /// the other's hit that close to its own hit: on a slanted plane the few sub-rays may lie further apart than that, where
    /// a real footprint has no gaps. An echo is all that hangs together so.
    fn echoes(&self, rays: &Rays, pulse: usize, beam: &Beam, echoes: &mut Vec<Echo>) {
        let mut lights: Vec<Light> = (pulse * beam.rays.len()..)
            .zip(&beam.rays)
            .filter_map(|(ray, (_, share))| {
                let light = self.light(rays, ray)?;
                Some(Light { intensity: share * light.intensity, power: share * light.power, ..light })
            })
            .collect();
        echoes.clear();
        let close = |a: f64, b: f64| (a - b).abs() < beam.resolution;
        let (least, most) = lights.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), l| (a.min(l.range), b.max(l.range)));
        if close(least, most) {
            echoes.push(rays.merge(&lights));
            return;
        }
        lights.sort_by(|a, b| a.range.total_cmp(&b.range).then(a.ray.cmp(&b.ray)));
        // group[i] is the nearest light of the echo that light i belongs to.
        let mut group: Vec<usize> = Vec::with_capacity(lights.len());
        for i in 0..lights.len() {
            group.push(if i > 0 && close(lights[i].range, lights[i - 1].range) { group[i - 1] } else { i });
        }
        if group.last().is_some_and(|&g| g > 0) {
            for i in 1..lights.len() {
                for j in 0..i {
                    let (low, high) = (group[i].min(group[j]), group[i].max(group[j]));
                    let (a, b) = (&lights[i], &lights[j]);
                    if low < high && close(rays.onto_plane(a, b), b.range) && close(rays.onto_plane(b, a), a.range) {
                        group.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
                    }
                }
            }
        }
        for leader in (0..lights.len()).filter(|&i| group[i] == i) {
            let members = (leader..lights.len()).filter(|&i| group[i] == leader).map(|i| lights[i]);
            echoes.push(rays.merge(&members.collect::<Vec<_>>()));
        }
        echoes.sort_by(|a, b| a.range.total_cmp(&b.range));
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

impl Rays {
    /// Where the ray of `other` meets the tangent plane of what `light` hit. Both start at the same point.
    fn onto_plane(&self, light: &Light, other: &Light) -> f64 {
        let normal = self.hits[light.ray].normal;
        light.range * dot(normal, self.directions[light.ray]) / dot(normal, self.directions[other.ray])
    }

    /// The echo of one light or more.
    fn merge(&self, lights: &[Light]) -> Echo {
        let object = |light: &Light| self.hits[light.ray].object;
        let share = |of: i32| lights.iter().filter(|l| object(l) == of).map(|l| l.power).sum::<f64>();
        let main = *lights.iter().fold(&lights[0], |best, light| {
            let (a, b) = (object(light), object(best));
            let better = if a == b { light.ray < best.ray } else { share(a) > share(b) };
            if better { light } else { best }
        });
        let power: f64 = lights.iter().map(|l| l.power).sum();
        let moment: f64 = lights.iter().map(|l| l.power * (l.range - main.range)).sum();
        // No mean where no power comes back, from a black surface, or infinite power, from distance zero.
        let mean = moment / power;
        Echo {
            range: main.range + if mean.is_finite() { mean } else { 0.0 },
            intensity: lights.iter().map(|l| l.intensity).sum(),
            power,
            ..Echo::of(main)
        }
    }
}

impl Frame<'_> {
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

impl Measurement {
    /// Rays that a pulse takes.
    pub fn rays(&self) -> usize {
        self.beam.as_ref().map_or(1, |beam| beam.rays.len())
    }

    /// The beam of a pulse, in the sensor frame: azimuth and elevation each off by a Gaussian.
    fn jitter(&self, direction: Point, stream: &Stream, pulse: u64) -> Point {
        let angle = |sigma: f64, draw| {
            if sigma > 0.0 { sigma * stream.normal(pulse, Effect::AngularJitter, draw) } else { 0.0 }
        };
        turned(direction, angle(self.azimuth_sigma, 0), angle(self.elevation_sigma, 1))
    }

    /// Lambert's law and the loss on the way there and back.
    fn intensity(&self, reflectivity: f64, cosine: f64, range: f64) -> f64 {
        let light = reflectivity * cosine;
        if self.extinction > 0.0 { light * exp(-2.0 * self.extinction * range) } else { light }
    }

    /// To the nearest multiple of the resolution, halves to even.
    fn quantised(&self, range: f64) -> f64 {
        let step = self.range_resolution;
        if step > 0.0 { (range / step).round_ties_even() * step } else { range }
    }

    fn gate(&self, range: f64) -> Result<f64, Status> {
        if range < self.min_range {
            Err(Status::BelowMinRange)
        } else if range > self.max_range {
            Err(Status::BeyondMaxRange)
        } else {
            Ok(range)
        }
    }
}

impl RangeSigma {
    fn is_zero(&self) -> bool {
        matches!(self, RangeSigma::Formula { a: 0.0, b: 0.0 })
    }

    fn at(&self, range: f64) -> f64 {
        match self {
            RangeSigma::Formula { a, b } => {
                let slope = b * range;
                (a * a + slope * slope).sqrt()
            }
            RangeSigma::Table(rows) => {
                let above = rows.partition_point(|row| row[0] <= range);
                let Some(&[r0, s0]) = rows[..above].last() else {
                    return rows.first().map_or(0.0, |row| row[1]);
                };
                rows.get(above).map_or(s0, |[r1, s1]| s0 + (s1 - s0) * ((range - r0) / (r1 - r0)))
            }
        }
    }
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

/// `direction` with its azimuth and elevation increased. At a pole, where the azimuth is free, it is 0.
fn turned(direction: Point, azimuth: f64, elevation: f64) -> Point {
    let (level, [x, y]) = heading(direction);
    let z = direction[2];
    let (sin_az, cos_az) = sin_cos(azimuth);
    let (sin_el, cos_el) = sin_cos(elevation);
    let flat = level * cos_el - z * sin_el;
    [flat * (x * cos_az - y * sin_az), flat * (x * sin_az + y * cos_az), z * cos_el + level * sin_el]
}

/// `direction`, unit, and to the left and upward of it by these tangents.
fn beside(direction: Point, [left, up]: [f64; 2]) -> Point {
    let (level, [x, y]) = heading(direction);
    let [dx, dy, dz] = direction;
    let v = [dx - left * y - up * dz * x, dy + left * x - up * dz * y, dz + up * level];
    let length = (1.0 + left * left + up * up).sqrt();
    v.map(|c| c / length)
}

/// Length and direction of the horizontal part; at a pole the direction is x.
fn heading([x, y, _]: Point) -> (f64, [f64; 2]) {
    let level = (x * x + y * y).sqrt();
    if level > 0.0 { (level, [x / level, y / level]) } else { (0.0, [1.0, 0.0]) }
}

/// To within 1e-6: a unit vector kept in float32 is one to within 2⁻²².
fn is_unit(d: Point) -> bool {
    (dot(d, d) - 1.0).abs() <= 1e-6
}

/// |d|² − 1, with an error below 2⁻⁷⁶ where d is unit to within 1e-6.
///
/// With h the coordinates rounded to multiples of 2⁻²⁶, |h|² is a multiple of 2⁻⁵² below 2, hence exact, and
/// d² − h² = (d − h)(d + h).
#[inline(always)]
fn excess(d: Point) -> f64 {
    const ROUNDER: f64 = 1.5 * (1_u64 << 26) as f64;
    let h = d.map(|x| (x + ROUNDER) - ROUNDER);
    let rest: Point = std::array::from_fn(|k| (d[k] - h[k]) * (d[k] + h[k]));
    (dot(h, h) - 1.0) + (rest[0] + rest[1] + rest[2])
}

/// t·|d| to within 1 ulp, for d unit to within 1e-6: √(1+e) = 1 + e/2 − e²/8 + e³/16 − …
#[inline(always)]
fn distance(t: f64, d: Point) -> f64 {
    let e = excess(d);
    t + t * (e * (0.5 - e * (0.125 - e * 0.0625)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(returns: Returns, powers: &[f64]) -> Vec<f64> {
        let echo =
            |range: f64, power| Echo { ray: 0, true_range: range, range, intensity: power, power, measured: Ok(range) };
        let echoes: Vec<Echo> = (1..).zip(powers).map(|(i, &power)| echo(f64::from(i), power)).collect();
        let mut found = Vec::new();
        returns.choose(&echoes, &mut found);
        found.iter().map(|echo| echo.true_range).collect()
    }

    #[test]
    fn returns_are_chosen_and_ordered() {
        let powers = [1.0, 3.0, 2.0, 1.0];
        assert_eq!(chosen(Returns::Strongest, &powers), [2.0]);
        assert_eq!(chosen(Returns::First, &powers), [1.0]);
        assert_eq!(chosen(Returns::Last, &powers), [4.0]);
        assert_eq!(chosen(Returns::Dual, &powers), [2.0, 4.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0, 2.0, 3.0]), [3.0, 2.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0, 1.0]), [1.0, 2.0]);
        assert_eq!(chosen(Returns::Dual, &[1.0]), [1.0]);
        assert_eq!(chosen(Returns::Nearest(3), &powers), [1.0, 2.0, 3.0]);
        assert_eq!(chosen(Returns::Nearest(9), &powers), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn a_beam_has_all_of_its_energy_and_is_balanced() {
        for (rays, rings) in [(7, 1), (19, 2), (37, 3), (61, 4), (91, 5)] {
            let beam = Beam::new([2.0, 1.0], rays, 1.0);
            assert_eq!(beam.rays.len(), rays);
            assert_eq!(beam.rays[0].0, [0.0; 2]);
            let sum = |of: fn([f64; 2]) -> f64| beam.rays.iter().map(|(at, share)| share * of(*at)).sum::<f64>();
            assert!((sum(|_| 1.0) - 1.0).abs() < 1e-15);
            assert!(
                sum(|[x, _]| x).abs() < 1e-16 && sum(|[_, y]| y).abs() < 1e-16 && sum(|[x, y]| x * y).abs() < 1e-16
            );
            // ∫r²·exp(−2r²)·r dr over ∫exp(−2r²)·r dr, up to 1: half of it on each axis, of half angles 1 and 1/2.
            let moment = (1.0 - 3.0 * (-2.0_f64).exp()) / (2.0 * (1.0 - (-2.0_f64).exp()));
            assert!((sum(|[x, _]| x * x) / (moment / 2.0) - 1.0).abs() < 0.01);
            assert!((sum(|[_, y]| y * y) / (moment / 8.0) - 1.0).abs() < 0.01);
            let outermost = beam.rays.iter().map(|(at, _)| at[0]).fold(0.0, f64::max);
            assert!((outermost - f64::from(rings) / (f64::from(rings) + 0.5)).abs() < 1e-15);
        }
    }

    #[test]
    fn beside_is_left_and_up() {
        let [x, y, z] = beside([1.0, 0.0, 0.0], [0.1, 0.2]);
        assert!((y / x - 0.1).abs() < 1e-15 && (z / x - 0.2).abs() < 1e-15);
        let [x, y, z] = beside([0.0, 1.0, 0.0], [0.1, 0.2]);
        assert!((x / y + 0.1).abs() < 1e-15 && (z / y - 0.2).abs() < 1e-15);
        // Straight up, left and up are as after a turn from straight ahead.
        let [x, y, z] = beside([0.0, 0.0, 1.0], [0.1, 0.2]);
        assert!((y / z - 0.1).abs() < 1e-15 && (x / z + 0.2).abs() < 1e-15);
    }

    #[test]
    fn turned_adds_to_azimuth_and_elevation() {
        let at = |azimuth: f64, elevation: f64| {
            [azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin()]
        };
        let (got, expected) = (turned(at(2.0, -0.5), 0.3, 0.1), at(2.3, -0.4));
        assert!((0..3).all(|i| (got[i] - expected[i]).abs() < 3e-16));
    }

    #[test]
    fn sigma_comes_from_the_formula_or_the_table() {
        assert_eq!(RangeSigma::Formula { a: 3.0, b: 0.4 }.at(10.0), 5.0);
        let table = RangeSigma::Table(vec![[1.0, 0.1], [2.0, 0.2], [4.0, 0.1]]);
        assert_eq!([0.5, 1.0, 2.0, 3.0, 4.0, 9.0].map(|r| table.at(r)), [0.1, 0.1, 0.2, 0.15000000000000002, 0.1, 0.1]);
    }
}
