//! From pulses to returns: one pulse at a time, each effect one small function.
//!
//! The order for a pulse: jitter of the beam, sub-rays over its footprint, cast, intensity, echoes, range gate, detection,
//! drop-out, range noise, quantisation, range gate again, choice of returns. An effect that is off costs nothing and draws
//! nothing; what it draws ([`Effect`]) hangs on the pulse alone.

use std::ops::Range;

use crate::elementary::{exp, first_quadrant_angle, sin_cos};
use crate::pose::{Path, Pose, cross, dot, sub};
use crate::rng::{Effect, Stream};
use crate::scene::{Hit, Scene};
use crate::vector::Point;

/// What finds the surfaces.
pub trait Caster: Sync {
    /// The nearest hit of each ray with t ≥ 0.
    fn cast(&self, origins: &[Point], directions: &[Point], hits: &mut [Hit]);

    /// The triangle of a mesh that was hit: its vertices, and where they are in the world.
    fn corners(&self, hit: &Hit) -> Option<([u32; 3], [Point; 3])>;
}

impl Caster for Scene {
    fn cast(&self, origins: &[Point], directions: &[Point], hits: &mut [Hit]) {
        Scene::cast(self, origins, directions, 0.0, f64::INFINITY, hits);
    }

    fn corners(&self, hit: &Hit) -> Option<([u32; 3], [Point; 3])> {
        self.objects()[hit.object as usize].corners(hit.primitive as u32)
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

    /// Keep the chosen ones of `found`, which rise in range, in the order of their report.
    fn choose(self, found: &mut Vec<Return>) {
        let best = |found: &[Return]| strongest(found.iter().map(|r| r.echo.power));
        let i = best(found);
        match self {
            Returns::First | Returns::Nearest(_) => {}
            Returns::Last => found.reverse(),
            Returns::Strongest => found.swap(0, i),
            Returns::Dual => {
                let first = found.remove(i);
                if !found.is_empty() {
                    let last = found.len() - 1;
                    let j = if i > last { best(found) } else { last };
                    found.swap(0, j);
                }
                found.insert(0, first);
            }
        }
        found.truncate(self.most());
    }
}

/// Index of the greatest; of equal ones, the first.
fn strongest(powers: impl Iterator<Item = f64>) -> usize {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, power) in powers.enumerate() {
        if power > best.1 {
            best = (i, power);
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
            Reflectivity::Vertex(values) => {
                let Some((vertices, corners)) = caster.corners(hit) else { return f64::NAN };
                // From the hit to the corners: a triangle far from the origin of coordinates keeps its digits.
                let [a, b, c] = corners.map(|p| sub(sub(p, origin), direction.map(|d| hit.t * d)));
                // Twice the areas opposite to the corners. A hit on the rim may be outside by rounding.
                let areas = [cross(b, c), cross(c, a), cross(a, b)].map(|n| dot(n, hit.normal));
                let sign = (areas[0] + areas[1] + areas[2]).signum();
                let areas = areas.map(|x| (x * sign).max(0.0));
                let [u, v, w] = vertices.map(|i| values[i as usize]);
                (areas[0] * u + areas[1] * v + areas[2] * w) / (areas[0] + areas[1] + areas[2])
            }
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

/// Measure some pulses of the frame, whose rows these are.
pub fn measure(
    frame: &Frame,
    measurement: &Measurement,
    appearances: &[Appearance],
    caster: &impl Caster,
    pulses: Range<usize>,
    rows: &mut Rows,
) -> Result<(), BadPulse> {
    let rays = Rays::cast(frame, measurement, appearances, caster, pulses.clone())?;
    let receiver = Receiver::new(measurement, &frame.stream);
    let most = measurement.returns.most();
    let mut returns = Vec::new();
    for (i, pulse) in pulses.enumerate() {
        let index = frame.index(pulse);
        let first = i * most;
        let mut written = 0;
        let status = match &measurement.beam {
            None => match rays.light(i, measurement) {
                None => Status::Miss,
                Some(light) => {
                    let echo = light.alone();
                    let measured = receiver.receive(&echo, receiver.drops(index), index, 0);
                    rows.write(first, &echo, measured, &rays);
                    written = 1;
                    measured.err().unwrap_or(Status::Hit)
                }
            },
            Some(beam) => {
                let echoes = rays.group(i * beam.rays.len(), beam, measurement);
                let status = receiver.choose(&echoes, index, &mut returns);
                for Return { echo, measured } in &returns {
                    rows.write(first + written, echo, *measured, &rays);
                    written += 1;
                }
                status
            }
        };
        rows.status[i] = status as u8;
        rows.return_count[i] = if status == Status::Hit { written as u8 } else { 0 };
        for row in first + written..first + most {
            rows.clear(row);
        }
    }
    Ok(())
}

/// The rays of some pulses in the world, and what they hit; with a beam, its sub-rays one pulse after the other.
struct Rays<'a, C> {
    caster: &'a C,
    appearances: &'a [Appearance],
    origins: Vec<Point>,
    directions: Vec<Point>,
    hits: Vec<Hit>,
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
    /// The mean over its sub-rays, by power.
    range: f64,
    intensity: f64,
    power: f64,
    /// The truth of the echo: of the object with most of its power, the sub-ray nearest to the axis; and the range of that.
    ray: usize,
    true_range: f64,
}

impl Light {
    fn alone(&self) -> Echo {
        Echo { range: self.range, intensity: self.intensity, power: self.power, ray: self.ray, true_range: self.range }
    }
}

impl<'a, C: Caster> Rays<'a, C> {
    fn cast(
        frame: &Frame,
        measurement: &Measurement,
        appearances: &'a [Appearance],
        caster: &'a C,
        pulses: Range<usize>,
    ) -> Result<Self, BadPulse> {
        let jitters = measurement.azimuth_sigma > 0.0 || measurement.elevation_sigma > 0.0;
        let rays = measurement.rays() * pulses.len();
        let (mut origins, mut directions) = (Vec::with_capacity(rays), Vec::with_capacity(rays));
        let [first, last] = frame.path.span();
        let (mut now, mut pose) = (f64::NAN, Pose::IDENTITY);
        for i in pulses {
            let (mut direction, origin, time) = (frame.directions[i], frame.origins[i], frame.times[i]);
            let moment = frame.start + time;
            let fault = if !is_unit(direction) {
                Some(Fault::Direction)
            } else if !origin.iter().all(|x| x.is_finite()) {
                Some(Fault::Origin)
            } else if !(moment.is_finite() && first <= moment && moment <= last) {
                Some(Fault::Time)
            } else {
                None
            };
            if let Some(fault) = fault {
                return Err(BadPulse { pulse: i, fault });
            }
            if time != now {
                (now, pose) = (time, frame.path.at(moment));
            }
            if jitters {
                direction = measurement.jitter(direction, &frame.stream, frame.index(i));
            }
            let origin = pose.place(origin);
            match &measurement.beam {
                None => {
                    origins.push(origin);
                    directions.push(pose.turn(direction));
                }
                Some(beam) => {
                    for (offset, _) in &beam.rays {
                        origins.push(origin);
                        directions.push(pose.turn(beside(direction, *offset)));
                    }
                }
            }
        }
        let mut hits = vec![Hit::MISS; rays];
        caster.cast(&origins, &directions, &mut hits);
        Ok(Rays { caster, appearances, origins, directions, hits })
    }

    /// What was hit, if anything was.
    fn appearance(&self, ray: usize) -> Option<&Appearance> {
        self.appearances.get(usize::try_from(self.hits[ray].object).ok()?)
    }

    fn light(&self, ray: usize, measurement: &Measurement) -> Option<Light> {
        let appearance = self.appearance(ray)?;
        let (hit, direction) = (&self.hits[ray], self.directions[ray]);
        let range = distance(hit.t, direction);
        let reflectivity = appearance.reflectivity.at(hit, self.origins[ray], direction, self.caster);
        let intensity = measurement.intensity(reflectivity, dot(hit.normal, direction).abs(), range);
        Some(Light { ray, range, intensity, power: intensity / (range * range) })
    }

    /// The echoes of the pulse whose sub-rays start at `first`, by rising range.
    ///
    /// Two sub-rays are of one echo if their ranges differ by less than the resolution, or if each meets the tangent plane of
    /// the other's hit that close to its own hit: on a slanted plane the few sub-rays may lie further apart than that, where
    /// a real footprint has no gaps. An echo is all that hangs together so.
    fn group(&self, first: usize, beam: &Beam, measurement: &Measurement) -> Vec<Echo> {
        let mut lights: Vec<Light> = (first..)
            .zip(&beam.rays)
            .filter_map(|(ray, (_, share))| {
                let light = self.light(ray, measurement)?;
                Some(Light { intensity: share * light.intensity, power: share * light.power, ..light })
            })
            .collect();
        lights.sort_by(|a, b| a.range.total_cmp(&b.range).then(a.ray.cmp(&b.ray)));
        let close = |a: f64, b: f64| (a - b).abs() < beam.resolution;
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
                    if low < high && close(self.onto_plane(a, b), b.range) && close(self.onto_plane(b, a), a.range) {
                        group.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
                    }
                }
            }
        }
        let leaders = (0..lights.len()).filter(|&i| group[i] == i);
        let mut echoes: Vec<Echo> = leaders
            .map(|leader| {
                self.merge(lights[leader], || (leader..lights.len()).filter(|&i| group[i] == leader).map(|i| lights[i]))
            })
            .collect();
        echoes.sort_by(|a, b| a.range.total_cmp(&b.range));
        echoes
    }

    /// Where the ray of `other` meets the tangent plane of what `light` hit. Both start at the same point.
    fn onto_plane(&self, light: &Light, other: &Light) -> f64 {
        let normal = self.hits[light.ray].normal;
        light.range * dot(normal, self.directions[light.ray]) / dot(normal, self.directions[other.ray])
    }

    /// The echo of `members`, of which `any` is one.
    fn merge<I: Iterator<Item = Light>>(&self, any: Light, members: impl Fn() -> I) -> Echo {
        let object = |light: &Light| self.hits[light.ray].object;
        let share = |light: &Light| members().filter(|m| object(m) == object(light)).map(|m| m.power).sum::<f64>();
        let main = members().fold(any, |best, m| {
            let better = if object(&m) == object(&best) { m.ray < best.ray } else { share(&m) > share(&best) };
            if better { m } else { best }
        });
        let power: f64 = members().map(|m| m.power).sum();
        let moment: f64 = members().map(|m| m.power * (m.range - main.range)).sum();
        // No mean where no power comes back, from a black surface, or infinite power, from distance zero.
        let mean = moment / power;
        Echo {
            range: main.range + if mean.is_finite() { mean } else { 0.0 },
            intensity: members().map(|m| m.intensity).sum(),
            power,
            ray: main.ray,
            true_range: main.range,
        }
    }
}

/// An echo with the range that is measured, or why it is lost.
#[derive(Clone, Copy, Debug)]
struct Return {
    echo: Echo,
    measured: Result<f64, Status>,
}

/// From an echo to a range.
struct Receiver<'a> {
    measurement: &'a Measurement,
    stream: &'a Stream,
    /// The least power that is detected.
    threshold: Option<f64>,
}

impl<'a> Receiver<'a> {
    fn new(measurement: &'a Measurement, stream: &'a Stream) -> Self {
        let power = |d: Detection| measurement.intensity(d.reflectivity, 1.0, d.range) / (d.range * d.range);
        Receiver { measurement, stream, threshold: measurement.detection.map(power) }
    }

    /// Whether the pulse is lost by chance.
    fn drops(&self, pulse: u64) -> bool {
        let p = self.measurement.dropout;
        p > 0.0 && self.stream.uniform(pulse, Effect::Dropout, 0) < p
    }

    /// Measure one echo, the `draw`-th of its pulse.
    fn receive(&self, echo: &Echo, dropped: bool, pulse: u64, draw: u16) -> Result<f64, Status> {
        self.gate(echo.range)?;
        // Of 0/0, a black surface at distance zero, this is false.
        let seen = self.threshold.is_none_or(|least| echo.power >= least);
        if !seen {
            return Err(Status::BelowThreshold);
        }
        if dropped {
            return Err(Status::Dropped);
        }
        self.gate(self.quantised(self.noisy(echo.range, pulse, draw)))
    }

    fn gate(&self, range: f64) -> Result<f64, Status> {
        if range < self.measurement.min_range {
            Err(Status::BelowMinRange)
        } else if range > self.measurement.max_range {
            Err(Status::BeyondMaxRange)
        } else {
            Ok(range)
        }
    }

    fn noisy(&self, range: f64, pulse: u64, draw: u16) -> f64 {
        let sigma = self.measurement.range_sigma.at(range);
        let noise = if sigma > 0.0 { sigma * self.stream.normal(pulse, Effect::RangeNoise, draw) } else { 0.0 };
        range + (self.measurement.range_bias + noise)
    }

    fn quantised(&self, range: f64) -> f64 {
        let step = self.measurement.range_resolution;
        if step > 0.0 { (range / step).round_ties_even() * step } else { range }
    }

    /// The returns of a pulse, from its echoes by rising range. Of a pulse that is lost, its strongest echo with the reason.
    fn choose(&self, echoes: &[Echo], pulse: u64, returns: &mut Vec<Return>) -> Status {
        let dropped = self.drops(pulse);
        let all = echoes
            .iter()
            .zip(0..)
            .map(|(echo, draw)| Return { echo: *echo, measured: self.receive(echo, dropped, pulse, draw) });
        returns.clear();
        returns.extend(all.clone().filter(|r| r.measured.is_ok()));
        if !returns.is_empty() {
            self.measurement.returns.choose(returns);
            return Status::Hit;
        }
        returns.extend(all.skip(strongest(echoes.iter().map(|e| e.power))).take(1));
        returns.first().map_or(Status::Miss, |lost| lost.measured.err().unwrap_or(Status::Hit))
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
}

impl RangeSigma {
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
    fn write(&mut self, row: usize, echo: &Echo, measured: Result<f64, Status>, rays: &Rays<impl Caster>) {
        let (hit, direction) = (&rays.hits[echo.ray], rays.directions[echo.ray]);
        let across = cross(hit.normal, direction);
        self.true_range[row] = echo.true_range;
        self.incidence[row] = first_quadrant_angle(dot(across, across).sqrt(), dot(hit.normal, direction).abs()) as f32;
        self.normal[row] = hit.normal.map(|x| x as f32);
        self.object_id[row] = hit.object;
        self.label[row] = rays.appearance(echo.ray).map_or(0, |appearance| appearance.label);
        self.range[row] = measured.unwrap_or(f64::NAN);
        self.range_error[row] = self.range[row] - echo.true_range;
        self.intensity[row] = if measured.is_ok() { echo.intensity as f32 } else { f32::NAN };
    }

    fn clear(&mut self, row: usize) {
        self.true_range[row] = f64::NAN;
        self.incidence[row] = f32::NAN;
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

    fn echo(range: f64, power: f64) -> Echo {
        Echo { range, intensity: power, power, ray: 0, true_range: range }
    }

    fn chosen(returns: Returns, powers: &[f64]) -> Vec<f64> {
        let mut found: Vec<Return> = (1..)
            .zip(powers)
            .map(|(i, &power)| Return { echo: echo(f64::from(i), power), measured: Ok(f64::from(i)) })
            .collect();
        returns.choose(&mut found);
        found.iter().map(|r| r.echo.range).collect()
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
