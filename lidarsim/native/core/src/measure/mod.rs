//! From pulses to returns, each effect one small function.
//!
//! The order for a pulse: jitter of the beam, sub-rays over its footprint, cast, intensity, echoes, detection, drop-out, range
//! noise and biases, quantisation, range gate, choice of returns. The last of what is done to a range is the gate: it knows of
//! what was measured alone. An effect that is off costs nothing and draws nothing; what it draws ([`Effect`]) hangs on the pulse
//! alone.

mod appearance;
mod beam;
mod direction;
mod echo;
mod lines;
mod origins;
mod parameters;
mod points;
mod returns;
pub mod rng;
mod share;
mod waveform;

use std::cell::Cell;
use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::Arc;

use crate::arith::elementary::first_quadrant_angle;
use crate::arith::number::Interval;
use crate::arith::simd::{self, Isa, Level, Task};
use crate::cast::HitArrays;
use crate::geometry::point::{cross, dot, sub};
use crate::geometry::pose::{Motion, Path, Pose};
use crate::geometry::vector::Point;
use crate::measure::rng::{Effect, Stream};
use crate::memory::{resize, split_off};
use crate::scene::{Geometry, Hit, World};
use crate::shapes::triangle::barycentric;
use direction::{beside, distance, is_finite, is_unit, reciprocal_length, turned};
use echo::{Echo, Light};
use waveform::Waveform;

pub use appearance::{Appearance, Labels, Reflectivity};
pub use beam::Beam;
pub use echo::Returns;
pub use origins::Origins;
pub use parameters::{Detection, Effects, Measurement, RangeSigma};
pub use points::{Coordinates, Placing, PointsAndNormals};
pub use returns::{Copied, Each, Field, Numbers, ReturnCounts};

/// What finds the surfaces.
pub trait Caster: Sync {
    /// Whether any surface moves, so that rays need their times.
    fn moves(&self) -> bool;

    /// The nearest hit of each ray with t ≥ 0, at its time; none have times if nothing moves.
    fn cast(&self, level: Level, rays: (&[Point], &[Point], &[f64]), hits: &mut HitArrays);

    /// The vertices of the triangle of a mesh that was hit, and the share that each has of the hit.
    fn shares(&self, hit: &Hit, origin: Point, direction: Point, time: f64) -> Option<([u32; 3], [f64; 3])>;

    /// How an object moves, if it does.
    fn path(&self, object: i32) -> Option<&Path>;
}

impl Caster for World<'_> {
    fn moves(&self) -> bool {
        self.scene.moves()
    }

    fn cast(&self, level: Level, rays: (&[Point], &[Point], &[f64]), hits: &mut HitArrays) {
        // The rays are legal: `Frame::check` has seen them.
        World::cast(self, level, rays, (0.0, f64::INFINITY), &mut hits.columns());
    }

    fn path(&self, object: i32) -> Option<&Path> {
        self.scene.objects()[object as usize].motion()
    }

    fn shares(&self, hit: &Hit, origin: Point, direction: Point, time: f64) -> Option<([u32; 3], [f64; 3])> {
        let object = self.scene.at(hit.object as u32, time);
        let Geometry::Mesh(mesh) = &object.geometry else { return None };
        let vertices = mesh.faces()[hit.primitive as usize];
        let [o, d] = object.enclose(origin, direction);
        let middle = |x: Interval| x.low + 0.5 * (x.high - x.low);
        // From the hit to the corners: a triangle far from the origin of coordinates keeps its digits.
        let way = d.map(|x| hit.t * middle(x));
        let corners = vertices.map(|v| sub(sub(mesh.vertices()[v as usize], o.map(middle)), way));
        Some((vertices, barycentric(corners)))
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
    pub origins: Origins<'a>,
    /// In the sensor frame, unit to rounding.
    pub directions: &'a [Point],
    /// Since the start of the frame, s.
    pub times: &'a [f64],
    pub rings: &'a [u16],
    /// Which pulses of the whole frame these are, if they are not all of them in order.
    pub indices: Option<&'a [u64]>,
    pub start: f64,
    pub path: &'a Path,
    pub stream: Stream,
}

impl Frame<'_> {
    /// Whether each of some pulses has a pose.
    #[inline(always)]
    fn have_poses(&self, pulses: Range<usize>) -> bool {
        // All at once, which is faster than to search for the first without. The span of a path is found recursively: once is enough.
        let span = self.path.span();
        self.times[pulses].iter().fold(true, |right, time| right & self.is_within(span, *time))
    }

    #[cold]
    #[inline(never)]
    fn first_bad(&self, pulses: Range<usize>) -> Result<(), BadPulse> {
        for pulse in pulses {
            let fault = if !is_unit(self.directions[pulse]) {
                Fault::Direction
            } else if !is_finite(self.origins.of(pulse)) {
                Fault::Origin
            } else if !self.is_within(self.path.span(), self.times[pulse]) {
                Fault::Time
            } else {
                continue;
            };
            return Err(BadPulse { pulse, fault });
        }
        Ok(())
    }

    #[inline(always)]
    fn is_within(&self, [first, last]: [f64; 2], time: f64) -> bool {
        let time = self.start + time;
        time.is_finite() & (first <= time) & (time <= last)
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

/// The uninitialized arrays of the result: for each pulse as many rows as it can have returns, and one status. All of it is written, unless a pulse is bad.
pub struct Rows<'a> {
    pub range: &'a mut [MaybeUninit<f64>],
    pub true_range: &'a mut [MaybeUninit<f64>],
    pub range_error: &'a mut [MaybeUninit<f64>],
    pub intensity: &'a mut [MaybeUninit<f32>],
    pub incidence: &'a mut [MaybeUninit<f32>],
    /// A coordinate after the other.
    pub normal: &'a mut [MaybeUninit<f32>],
    pub object_id: &'a mut [MaybeUninit<i32>],
    pub instance: &'a mut [MaybeUninit<u32>],
    pub label: &'a mut [MaybeUninit<u32>],
    /// Or none, where each pulse goes where it should.
    pub true_direction: &'a mut [MaybeUninit<Point>],
    /// Or none, where nothing moves.
    pub radial_velocity: &'a mut [MaybeUninit<f32>],
    pub status: &'a mut [MaybeUninit<u8>],
    pub return_count: &'a mut [MaybeUninit<u8>],
}

impl<'a> Rows<'a> {
    /// Takes the rows of the first pulses, and leaves the others.
    pub fn split_off(&mut self, pulses: usize, most: usize) -> Rows<'a> {
        let rows = pulses * most;
        let directions = rows.min(self.true_direction.len());
        let velocities = rows.min(self.radial_velocity.len());
        Rows {
            range: split_off(&mut self.range, rows),
            true_range: split_off(&mut self.true_range, rows),
            range_error: split_off(&mut self.range_error, rows),
            intensity: split_off(&mut self.intensity, rows),
            incidence: split_off(&mut self.incidence, rows),
            normal: split_off(&mut self.normal, 3 * rows),
            object_id: split_off(&mut self.object_id, rows),
            instance: split_off(&mut self.instance, rows),
            label: split_off(&mut self.label, rows),
            true_direction: split_off(&mut self.true_direction, directions),
            radial_velocity: split_off(&mut self.radial_velocity, velocities),
            status: split_off(&mut self.status, pulses),
            return_count: split_off(&mut self.return_count, pulses),
        }
    }

    /// All but the incidence, the true direction and the radial velocity.
    #[inline(always)]
    fn write(&mut self, row: usize, echo: &Echo, hit: &Hit, [instance, label]: [u32; 2]) {
        self.true_range[row].write(echo.true_range);
        self.normal.as_chunks_mut().0[row] = hit.normal.map(|x| MaybeUninit::new(x as f32));
        self.object_id[row].write(hit.object);
        self.instance[row].write(instance);
        self.label[row].write(label);
        let range = echo.measured.unwrap_or(f64::NAN);
        self.range[row].write(range);
        self.range_error[row].write(range - echo.true_range);
        self.intensity[row].write(if echo.measured.is_ok() { echo.intensity as f32 } else { f32::NAN });
    }

    #[inline(always)]
    fn clear(&mut self, row: usize) {
        self.true_range[row].write(f64::NAN);
        self.normal.as_chunks_mut().0[row] = [MaybeUninit::new(f32::NAN); 3];
        self.object_id[row].write(-1);
        self.instance[row].write(0);
        self.label[row].write(0);
        self.range[row].write(f64::NAN);
        self.range_error[row].write(f64::NAN);
        self.intensity[row].write(f32::NAN);
        if let Some(direction) = self.true_direction.get_mut(row) {
            direction.write([f64::NAN; 3]);
        }
    }
}

/// A frame fired at a scene.
pub struct Scan<'a, C> {
    frame: &'a Frame<'a>,
    measurement: &'a Measurement,
    appearances: &'a [Arc<Appearance>],
    caster: &'a C,
    level: Level,
    /// The least power that is detected.
    threshold: Option<f64>,
}

thread_local! {
    /// What one batch of pulses leaves to the next, so that its memory is used again.
    static SCRATCH: Cell<Scratch> = Cell::default();
}

/// Scratch memory: rays in the world and what they hit; with a beam, the sub-rays of one pulse after those of the other.
#[derive(Default)]
struct Scratch {
    origins: Vec<Point>,
    directions: Vec<Point>,
    /// Empty if no surface moves.
    times: Vec<f64>,
    hits: HitArrays,
    /// Of each ray the reflectivity of what it hits, and with a beam, after `shine`, what it brings back in clear air; of one that hits nothing, anything.
    intensity: Vec<f64>,
    /// With a beam, of each ray; of one that hits nothing, anything.
    range: Vec<f64>,
    cosine: Vec<f64>,
    /// What extinction leaves of that, if there is any.
    transmission: Vec<f64>,
    /// Of each row, squared sine and cosine of the incidence; the angles come in a loop of their own.
    squared_sin: Vec<f64>,
    cos: Vec<f64>,
    /// Of each row, the products of the ray's direction with the velocity of what was hit against the sensor, and with itself; empty if nothing moves.
    approach: Vec<[f64; 2]>,
    /// Velocities in the world of origins of pulses, and of each pulse which of them is that of its own, as those next to each other share many; empty if
    /// the sensor does not move.
    velocities: Vec<Point>,
    velocity_index: Vec<u32>,
    /// Of the object that moves and was met last, and when: neighbours often meet it at one time.
    motion: Option<((i32, f64), Motion)>,
    /// Of each pulse, its number in the whole frame.
    index: Vec<u64>,
    /// Of each pulse, what effects draw, and its direction with its jitter; of effects that are off these are empty. Further echoes draw their
    /// noise as they come.
    azimuth_jitter: Vec<f64>,
    elevation_jitter: Vec<f64>,
    axes: Vec<Point>,
    dropout: Vec<f64>,
    noise: Vec<f64>,
    /// Of each pulse, what is added to its range; empty if that is the same for all.
    bias: Vec<f64>,
    /// Of each pulse, the sensor's own range less that from the beam's origin; empty if they are the same.
    offset: Vec<f64>,
}

/// The work on some pulses, compiled for each instruction set.
struct Batch<'a, 'b, 'c, C> {
    scan: &'b Scan<'a, C>,
    pulses: Range<usize>,
    rays: &'b mut Scratch,
    rows: &'b mut Rows<'c>,
}

impl<C: Caster> Task for Batch<'_, '_, '_, C> {
    type Output = Result<(), BadPulse>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        self.scan.measure_batch::<I>(self.pulses, self.rays, self.rows)
    }
}

impl<'a, C: Caster> Scan<'a, C> {
    pub fn new(
        frame: &'a Frame<'a>,
        measurement: &'a Measurement,
        appearances: &'a [Arc<Appearance>],
        caster: &'a C,
        level: Level,
    ) -> Self {
        let power = |d: Detection| d.reflectivity / (d.range * d.range);
        Scan { frame, measurement, appearances, caster, level, threshold: measurement.detection.map(power) }
    }

    /// Measure some pulses, whose rows these are.
    pub fn measure(&self, pulses: Range<usize>, rows: &mut Rows) -> Result<(), BadPulse> {
        let mut rays = SCRATCH.take();
        let outcome = simd::dispatch(self.level, Batch { scan: self, pulses, rays: &mut rays, rows });
        SCRATCH.set(rays);
        outcome
    }

    #[inline(always)]
    fn measure_batch<I: Isa>(&self, pulses: Range<usize>, rays: &mut Scratch, rows: &mut Rows) -> Result<(), BadPulse> {
        self.cast::<I>(pulses.clone(), rays)?;
        self.reflect(rays);
        resize(&mut rays.approach, rows.radial_velocity.len(), [0.0; 2]);
        match &self.measurement.beam {
            None => self.measure_lines::<I>(pulses, rays, rows),
            Some(beam) => self.measure_footprints(beam, pulses, rays, rows),
        }
        for (angle, (squared_sin, cos)) in rows.incidence.iter_mut().zip(rays.squared_sin.iter().zip(&rays.cos)) {
            angle.write(first_quadrant_angle(squared_sin.sqrt(), *cos) as f32);
        }
        for (velocity, [along, squared_length]) in rows.radial_velocity.iter_mut().zip(&rays.approach) {
            velocity.write((along * reciprocal_length(*squared_length)) as f32);
        }
        Ok(())
    }

    /// Measures pulses of several rays each.
    #[inline(always)]
    fn measure_footprints(&self, beam: &Beam, pulses: Range<usize>, rays: &mut Scratch, rows: &mut Rows) {
        let most = self.measurement.most_returns();
        self.shine(rays);
        resize(&mut rays.squared_sin, pulses.len() * most, 0.0);
        resize(&mut rays.cos, pulses.len() * most, 0.0);
        let (mut waveform, mut echoes, mut chosen) = (Waveform::default(), Vec::new(), Vec::new());
        for i in 0..pulses.len() {
            waveform.echoes(beam, rays, i, &mut echoes);
            for (echo, number) in echoes.iter_mut().zip(0..) {
                echo.measured = self.detected(echo.power, self.sensed(echo, rays, i, number), rays, i);
            }
            self.measurement.returns.choose(&echoes, &mut chosen);
            let first = i * most;
            let mut row = first;
            for echo in &chosen {
                self.report(row, i, echo, rays, rows);
                if let Some(direction) = rows.true_direction.get_mut(row) {
                    let offset = beam.offset(echo.ray - i * beam.len());
                    direction.write(beside(self.axis(pulses.start, i, rays), offset));
                }
                row += 1;
            }
            let status = chosen.first().map_or(Status::Miss, Echo::status);
            close(i, first..first + most, row, status, rays, rows);
        }
    }

    /// Writes an echo of the `i`-th pulse of the batch, but for where it comes from.
    #[inline(always)]
    fn report(&self, row: usize, i: usize, echo: &Echo, rays: &mut Scratch, rows: &mut Rows) {
        let (hit, direction) = (&rays.hits.at(echo.ray), rays.directions[echo.ray]);
        rows.write(row, echo, hit, self.numbers(hit.object, hit.primitive));
        let across = cross(hit.normal, direction);
        (rays.squared_sin[row], rays.cos[row]) = (dot(across, across), rays.cosine[echo.ray]);
        if row < rays.approach.len() {
            rays.approach[row] = self.approach(i, echo.ray, rays);
        }
    }

    /// The instance and the label of what was hit.
    #[inline(always)]
    fn numbers(&self, object: i32, primitive: i32) -> [u32; 2] {
        let appearance = self.appearances.get(object as usize);
        appearance.map_or([0; 2], |appearance| [appearance.instance, appearance.labels.at(primitive)])
    }

    /// The products of the direction of a ray of the `i`-th pulse with the velocity of what it hits, and with itself.
    #[inline(always)]
    fn approach(&self, i: usize, ray: usize, rays: &mut Scratch) -> [f64; 2] {
        let (velocity, direction) = (self.velocity(i, ray, rays), rays.directions[ray]);
        [dot(velocity, direction), dot(direction, direction)]
    }

    /// The velocity of what a ray of the `i`-th pulse hits, there, against the origin of the pulse.
    #[inline(always)]
    fn velocity(&self, i: usize, ray: usize, rays: &mut Scratch) -> Point {
        let mut velocity = [0.0; 3];
        if let Some(&time) = rays.times.get(ray)
            && let Some(path) = self.caster.path(rays.hits.object[ray])
        {
            velocity = Self::velocity_on(path, ray, time, rays);
        }
        match rays.velocity_index.get(i) {
            Some(&own) => sub(velocity, rays.velocities[own as usize]),
            None => velocity,
        }
    }

    #[inline(never)]
    fn velocity_on(path: &Path, ray: usize, time: f64, rays: &mut Scratch) -> Point {
        let (origin, direction, hit) = (rays.origins[ray], rays.directions[ray], &rays.hits.at(ray));
        let point = std::array::from_fn(|k| origin[k] + hit.t * direction[k]);
        let met = (hit.object, time);
        let motion = match &mut rays.motion {
            Some((last, motion)) if *last == met => motion,
            other => &mut other.insert((met, path.motion(time))).1,
        };
        motion.velocity_of(motion.pose.place_back(point))
    }

    /// Where the `i`-th pulse of the batch that starts with pulse `start` went.
    #[inline(always)]
    fn axis(&self, start: usize, i: usize, rays: &Scratch) -> Point {
        *rays.axes.get(i).unwrap_or_else(|| &self.frame.directions[start + i])
    }

    #[inline(always)]
    fn cast<I: Isa>(&self, pulses: Range<usize>, rays: &mut Scratch) -> Result<(), BadPulse> {
        let (frame, measurement) = (self.frame, self.measurement);
        if !frame.have_poses(pulses.clone()) {
            return frame.first_bad(pulses);
        }
        self.draw(pulses.clone(), rays);
        let count = pulses.len() * measurement.rays();
        resize(&mut rays.origins, count, [0.0; 3]);
        resize(&mut rays.directions, count, [0.0; 3]);
        rays.velocities.clear();
        rays.velocity_index.clear();
        rays.motion = None;
        let (mut start, mut right) = (pulses.start, true);
        while start < pulses.end {
            // Pulses of one time are fired from one pose.
            let mut end = pulses.end;
            let pose = if let Path::Still(pose) = frame.path {
                *pose
            } else {
                end = start + equal_to_first::<1>(frame.times[start..pulses.end].as_chunks().0);
                let motion = frame.path.motion(frame.start + frame.times[start]);
                let next = rays.velocities.len() as u32;
                let one = match frame.origins {
                    Origins::One(origin) => Some(origin),
                    Origins::Each(origins) => {
                        let origins = &origins[start..end];
                        (equal_to_first(origins) == origins.len()).then(|| origins[0])
                    }
                };
                if let Some(origin) = one {
                    rays.velocities.push(motion.velocity_of(origin));
                    rays.velocity_index.resize(end - pulses.start, next);
                } else {
                    rays.velocities.extend((start..end).map(|pulse| motion.velocity_of(frame.origins.of(pulse))));
                    rays.velocity_index.extend((next..).take(end - start));
                }
                motion.pose
            };
            right &= self.aim::<I>(start..end, start - pulses.start, &pose, rays);
            start = end;
        }
        if !right {
            return frame.first_bad(pulses);
        }
        rays.times.clear();
        if self.caster.moves() {
            let times = frame.times[pulses].iter().map(|time| frame.start + time);
            rays.times.extend(times.flat_map(|time| std::iter::repeat_n(time, measurement.rays())));
        }
        rays.hits.resize(count);
        self.caster.cast(self.level, (&rays.origins, &rays.directions, &rays.times), &mut rays.hits);
        Ok(())
    }

    /// Draws what the effects need, and turns the directions by their jitter.
    #[inline(always)]
    fn draw(&self, pulses: Range<usize>, rays: &mut Scratch) {
        let (frame, measurement) = (self.frame, self.measurement);
        rays.index.clear();
        match frame.indices {
            None => rays.index.extend(pulses.start as u64..pulses.end as u64),
            Some(indices) => rays.index.extend_from_slice(&indices[pulses.clone()]),
        }
        let Scratch { index, azimuth_jitter, elevation_jitter, axes, dropout, noise, bias, offset, .. } = rays;
        let wanted = |is: bool| if is { index.as_slice() } else { &[] };
        frame.stream.normals(wanted(measurement.effects.azimuth_sigma > 0.0), Effect::AngularJitter, 0, azimuth_jitter);
        frame.stream.normals(
            wanted(measurement.effects.elevation_sigma > 0.0),
            Effect::AngularJitter,
            1,
            elevation_jitter,
        );
        frame.stream.uniforms(wanted(measurement.effects.dropout > 0.0), Effect::Dropout, 0, dropout);
        frame.stream.normals(wanted(!measurement.range_sigma.is_zero()), Effect::RangeNoise, 0, noise);
        let rings = &frame.rings[pulses.clone()];
        let channels: Vec<u64> = match measurement.effects.channel_bias_sigma {
            0.0 => Vec::new(),
            _ => rings.iter().map(|ring| u64::from(*ring)).collect(),
        };
        frame.stream.of_unit().normals(&channels, Effect::ChannelBias, 0, bias);
        for bias in &mut *bias {
            *bias = measurement.effects.range_bias + measurement.effects.channel_bias_sigma * *bias;
        }
        offset.clear();
        match *measurement.range_offset.as_slice() {
            [] => {}
            [all] => offset.resize(rings.len(), all),
            ref each => offset.extend(rings.iter().map(|ring| each[usize::from(*ring)])),
        }
        let jittered = wanted(measurement.jitters()).len();
        azimuth_jitter.resize(jittered, 0.0);
        elevation_jitter.resize(jittered, 0.0);
        axes.resize(jittered, [0.0; 3]);
        let jitters = azimuth_jitter.iter().zip(&*elevation_jitter);
        for ((axis, direction), (azimuth, elevation)) in axes.iter_mut().zip(&frame.directions[pulses]).zip(jitters) {
            let (azimuth, elevation) =
                (measurement.effects.azimuth_sigma * azimuth, measurement.effects.elevation_sigma * elevation);
            *axis = turned(*direction, azimuth, elevation);
        }
    }

    /// Fires pulses from a pose; the first of them is the k-th of the batch. False if one has no legal origin or direction.
    #[inline(always)]
    fn aim<I: Isa>(&self, pulses: Range<usize>, k: usize, pose: &Pose, rays: &mut Scratch) -> bool {
        let (origins, directions) = (&self.frame.origins, &self.frame.directions[pulses.clone()]);
        let jitters = self.measurement.jitters();
        let axes = if jitters { &rays.axes[k..k + pulses.len()] } else { directions };
        let first = k * self.measurement.rays();
        let (origins_there, directions_there) = (&mut rays.origins[first..], &mut rays.directions[first..]);
        let mut right = true;
        if let Some(beam) = &self.measurement.beam {
            let mut rays_there = origins_there.iter_mut().zip(directions_there);
            for (pulse, (direction, axis)) in pulses.zip(directions.iter().zip(axes)) {
                let origin = origins.of(pulse);
                right &= is_finite(origin) & is_unit(*direction);
                let origin = pose.place(origin);
                for (offset, (o, d)) in beam.offsets().zip(&mut rays_there) {
                    (*o, *d) = (origin, pose.turn(beside(*axis, offset)));
                }
            }
            return right;
        }
        let places = origins_there.as_flattened_mut().as_chunks_mut().0.iter_mut();
        let places = places.zip(directions_there.as_flattened_mut().as_chunks_mut().0);
        let eights = directions.as_chunks().0.iter().zip(axes.as_chunks().0).zip(places);
        for (pulse, ((directions, axes), (o, d))) in pulses.clone().step_by(8).zip(eights) {
            let (origins, directions) = (origins.of_eight::<I>(pulse), simd::load_points::<I>(directions));
            right &= is_finite(origins) & is_unit(directions);
            simd::store_points::<I>(pose.place(origins), o);
            let axes = if jitters { simd::load_points::<I>(axes) } else { directions };
            simd::store_points::<I>(pose.turn(axes), d);
        }
        for i in pulses.len() / 8 * 8..pulses.len() {
            let (origin, direction) = (origins.of(pulses.start + i), directions[i]);
            right &= is_finite(origin) & is_unit(direction);
            (origins_there[i], directions_there[i]) = (pose.place(origin), pose.turn(axes[i]));
        }
        right
    }

    /// What share of the light that meets a surface comes back, of all rays that hit one.
    #[inline(always)]
    fn reflect(&self, rays: &mut Scratch) {
        let Scratch { origins, directions, times, hits, intensity, .. } = rays;
        resize(intensity, hits.len(), 0.0);
        let surfaces = hits.object.iter().zip(&hits.primitive);
        for (i, (intensity, (object, primitive))) in intensity.iter_mut().zip(surfaces).enumerate() {
            if let Some(appearance) = self.appearances.get(*object as usize) {
                let hit = || (hits.at(i), origins[i], directions[i], *times.get(i).unwrap_or(&0.0));
                *intensity = appearance.reflectivity.at(*primitive, hit, self.caster);
            }
        }
    }

    /// Range, cosine of the incidence, intensity and its loss, of all rays: a formula at a time, in loops that become vector instructions.
    #[inline(always)]
    fn shine(&self, rays: &mut Scratch) {
        let Scratch { directions, hits, range, cosine, intensity, transmission, .. } = rays;
        resize(range, hits.len(), 0.0);
        resize(cosine, hits.len(), 0.0);
        let met = hits.t.iter().zip(hits.normal.as_chunks().0).zip(&*directions);
        for ((range, cosine), ((t, normal), direction)) in range.iter_mut().zip(&mut *cosine).zip(met) {
            *range = distance(*t, *direction);
            *cosine = dot(*normal, *direction).abs();
        }
        for (intensity, cosine) in intensity.iter_mut().zip(&*cosine) {
            *intensity *= cosine;
        }
        resize(transmission, if self.measurement.effects.extinction > 0.0 { hits.len() } else { 0 }, 0.0);
        for (transmission, range) in transmission.iter_mut().zip(&*range) {
            *transmission = self.measurement.transmission(*range);
        }
    }

    /// The range that the sensor finds for an echo: of the `i`-th pulse of the batch, its echo `number`.
    #[inline(always)]
    fn sensed(&self, echo: &Echo, rays: &Scratch, i: usize, number: u16) -> f64 {
        let m = self.measurement;
        let noise = match rays.noise.get(i) {
            None => 0.0,
            Some(&noise) if number == 0 => noise,
            Some(_) => self.frame.stream.normal(rays.index[i], Effect::RangeNoise, number),
        };
        let bias = *rays.bias.get(i).unwrap_or(&m.effects.range_bias);
        let offset = *rays.offset.get(i).unwrap_or(&0.0);
        m.quantised(echo.range + (bias + m.range_sigma.at(echo.range) * noise) + offset)
    }

    /// The range that an echo of this power of the `i`-th pulse of the batch is reported with, where the sensor finds this one; or why there is none.
    #[inline(always)]
    fn detected(&self, power: f64, range: f64, rays: &Scratch, i: usize) -> Result<f64, Status> {
        // Of 0/0, a black surface at distance zero, this is false.
        let seen = self.threshold.is_none_or(|least| power >= least);
        if !seen {
            return Err(Status::BelowThreshold);
        }
        if rays.dropout.get(i).is_some_and(|uniform| *uniform < self.measurement.effects.dropout) {
            return Err(Status::Dropped);
        }
        Ok(self.measurement.gate(range)? - *rays.offset.get(i).unwrap_or(&0.0))
    }
}

/// How many elements are equal to the first, from that on. Eight at a time, which become vector instructions.
#[inline(always)]
fn equal_to_first<const N: usize>(elements: &[[f64; N]]) -> usize {
    let first = elements[0];
    let is_equal = |element: &[f64; N]| (0..N).fold(true, |all, k| all & (element[k] == first[k]));
    let are_equal = |eight: &&[[f64; N]; 8]| eight.iter().fold(true, |all, element| all & is_equal(element));
    let whole = 8 * elements.as_chunks().0.iter().take_while(are_equal).count();
    whole + elements[whole..].iter().take_while(|element| is_equal(element)).count()
}

/// Writes what became of the `i`-th pulse of a batch, and those of its rows, from `end` on, that it has no returns for.
#[inline(always)]
fn close(i: usize, all: Range<usize>, end: usize, status: Status, rays: &mut Scratch, rows: &mut Rows) {
    rows.status[i].write(status as u8);
    rows.return_count[i].write(if status == Status::Hit { (end - all.start) as u8 } else { 0 });
    for row in end..all.end {
        rows.clear(row);
        (rays.squared_sin[row], rays.cos[row]) = (f64::NAN, f64::NAN);
        if let Some(approach) = rays.approach.get_mut(row) {
            *approach = [f64::NAN; 2];
        }
    }
}

impl Scratch {
    /// What a ray brings back, if it hits anything.
    #[inline(always)]
    fn light(&self, ray: usize) -> Option<Light> {
        if self.hits.object[ray] < 0 {
            return None;
        }
        let (range, intensity) = (self.range[ray], self.intensity[ray]);
        let power = intensity / (range * range);
        let clear = Light { ray, range, intensity, power, clear_power: power };
        let Some(transmission) = self.transmission.get(ray) else { return Some(clear) };
        let intensity = intensity * transmission;
        Some(Light { intensity, power: intensity / (range * range), ..clear })
    }
}
