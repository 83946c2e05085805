//! Coverage: how many pulses would hit each instance of a scene if it stood alone, how many of them reach it,
//! and how many returns it gives.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use crate::arith::simd::{self, Isa, Task};
use crate::cast::{Cast, HitArrays, MeetInstances, NO_INSTANCE, pieces};
use crate::geometry::origins::Origins;
use crate::geometry::pose::{Path, Pose};
use crate::geometry::vector::Point;
use crate::measure::culling::{Windows, boxes_of_instances};
use crate::scene::{Rays, TRange, World, span};
use crate::{memory, parallel};

/// The nominal pulses of a frame, of one ray each, and what a scan found of them.
pub struct NominalPulses<'a> {
    pub origins: Origins<'a>,
    /// In the sensor frame.
    pub directions: &'a [Point],
    /// Since the start of the frame, s.
    pub times: &'a [f64],
    pub start: f64,
    pub path: &'a Path,
    /// Per pulse, the object that its ray hits first, `MISS` or `UNKNOWN`; `None` if all are unknown.
    pub first: Option<&'a [i32]>,
    /// Per pulse, the number of its returns, and rows of the objects that they are from, `MISS` for none.
    pub return_counts: &'a [u8],
    pub objects: &'a [i32],
}

/// Most instances for which each piece of the pulses has windows of its own. These hold fewer pulses than the
/// windows of a whole frame, in which the sensor moves farther, but take time per instance and piece.
const FEW: usize = 128;

/// A pulse whose ray hits nothing in range.
const MISS: i32 = -1;

/// A pulse whose ray has yet to be cast.
pub const UNKNOWN: i32 = -2;

/// A count of pulses or returns, and the sum of their times since the start of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    pub count: u64,
    /// In units of 1/`TICKS`: a sum of whole numbers depends on no order.
    ticks: i128,
}

/// Ticks of a second, each about a picosecond.
const TICKS: f64 = (1_u64 << 40) as f64;

/// A time in ticks. It saturates at 97 days from the start of the frame.
#[inline(always)]
fn ticks_of(time: f64) -> i64 {
    (time * TICKS) as i64
}

impl Tally {
    /// The mean time, s; NaN if there are none.
    fn mean_time(&self) -> f64 {
        self.ticks as f64 / TICKS / self.count as f64
    }

    #[inline(always)]
    fn note(&mut self, ticks: i64) {
        self.count += 1;
        self.ticks += i128::from(ticks);
    }

    fn add(&mut self, other: &Tally) {
        self.count += other.count;
        self.ticks += other.ticks;
    }
}

/// The pulses of an instance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstancePulses {
    /// Those that would hit it if it stood alone.
    pub covering: Tally,
    /// How many of these reach it.
    pub reached: u64,
    pub returns: Tally,
}

impl InstancePulses {
    /// The mean time of its returns, or else of the pulses that would hit it, since the start of the frame.
    pub fn mean_time(&self) -> f64 {
        if self.returns.count > 0 { self.returns.mean_time() } else { self.covering.mean_time() }
    }

    fn add(&mut self, other: &InstancePulses) {
        self.covering.add(&other.covering);
        self.reached += other.reached;
        self.returns.add(&other.returns);
    }
}

/// The scene and the instances that are asked for.
#[derive(Clone, Copy)]
pub struct Targets<'a> {
    /// The scene, in which rays are cast; not needed if the first hits of all are known.
    pub world: Option<&'a World<'a>>,
    /// The instance of each object of the scene, or `NO_INSTANCE`.
    pub instances: &'a [u32],
    /// A scene of the objects of these instances, perhaps with others, which hide nothing; and its
    /// `instances`.
    pub asked: (&'a World<'a>, &'a [u32]),
    /// How many instances there are.
    pub count: usize,
    /// Only hits with t up to this count.
    pub max_range: f64,
}

impl Targets<'_> {
    fn no_pulses(&self) -> Vec<InstancePulses> {
        let mut none = Vec::new();
        memory::resize(&mut none, self.count, InstancePulses::default());
        none
    }
}

/// The coverage of a piece of the pulses, compiled for each instruction set.
pub struct CoverPiece<'a> {
    pulses: &'a NominalPulses<'a>,
    targets: Targets<'a>,
    windows: &'a Windows,
    piece: Range<usize>,
}

impl NominalPulses<'_> {
    /// Returns the pulses of each instance, on all threads. `work` runs a piece.
    pub fn coverage(
        &self,
        targets: Targets,
        work: impl Fn(CoverPiece) -> Vec<InstancePulses> + Sync,
    ) -> Vec<InstancePulses> {
        let total = Mutex::new(targets.no_pulses());
        let (alone, instances) = targets.asked;
        let boxes = boxes_of_instances(alone, instances, targets.count);
        let windows = |pulses: Range<usize>| {
            let span = span(&self.times[pulses.clone()]);
            let span = span.map(|time| (self.start + time).clamp(f64::MIN, f64::MAX));
            Windows::new(self.origins.part(pulses), self.path, span, &boxes)
        };
        let of_all = (boxes.len() > FEW).then(|| windows(0..self.times.len()));
        parallel::share(pieces(self.directions, 1).into_iter(), |piece| {
            let of_piece;
            let windows = if let Some(all) = &of_all {
                all
            } else {
                of_piece = windows(piece.clone());
                &of_piece
            };
            let own = work(CoverPiece { pulses: self, targets, windows, piece });
            let mut total = total.lock().unwrap_or_else(PoisonError::into_inner);
            total.iter_mut().zip(&own).for_each(|(total, own)| total.add(own));
        });
        total.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Task for CoverPiece<'_> {
    type Output = Vec<InstancePulses>;

    #[inline(always)]
    fn run<I: Isa>(self) -> Self::Output {
        let CoverPiece { pulses, targets, windows, piece } = &self;
        let Targets { world, instances, asked, count, max_range } = targets;
        let range = TRange { min: 0.0, max: *max_range };
        let mut own = self.targets.no_pulses();
        let mut aimed = pulses.aim::<I>(piece.clone(), windows, instances, &mut own);
        if let Some(world) = world
            && !aimed.unknown.is_empty()
        {
            let unknown = aimed.part(&aimed.unknown);
            let mut hits = HitArrays::default();
            hits.resize(unknown.owners.len());
            let rays = unknown.rays(world);
            I::call(Cast { world, rays, range, hits: &mut hits.columns() });
            for (ray, object) in aimed.unknown.iter().zip(&hits.object) {
                let owner = instance_of(*object, instances);
                aimed.owners[*ray as usize] = owner;
                note_first(&mut own, owner, aimed.ticks[*ray as usize]);
            }
        }
        let (alone, instances_alone) = *asked;
        let (rays, known, mut pairs) = (aimed.rays(alone), &aimed.owners, Vec::new());
        let instances_met = MeetInstances {
            world: alone,
            rays,
            range,
            instances: instances_alone,
            count: *count,
            known,
            pairs: &mut pairs,
        };
        I::call(instances_met);
        for (ray, instance) in pairs {
            own[instance as usize].covering.note(aimed.ticks[ray as usize]);
        }
        let most = pulses.objects.len() / pulses.times.len();
        for i in piece.clone() {
            let returns = usize::from(pulses.return_counts[i]).min(most);
            for object in &pulses.objects[most * i..most * i + returns] {
                let instance = instance_of(*object, instances);
                if instance != NO_INSTANCE {
                    own[instance as usize].returns.note(ticks_of(pulses.times[i]));
                }
            }
        }
        own
    }
}

/// Notes a pulse for the instance that it hits first, if any.
#[inline(always)]
fn note_first(own: &mut [InstancePulses], owner: u32, ticks: i64) {
    if owner != NO_INSTANCE {
        own[owner as usize].reached += 1;
        own[owner as usize].covering.note(ticks);
    }
}

/// The instance of an object, or `NO_INSTANCE` if there is no object.
#[inline(always)]
fn instance_of(object: i32, instances: &[u32]) -> u32 {
    usize::try_from(object).map_or(NO_INSTANCE, |object| instances[object])
}

/// The rays of a piece of the pulses, without those that can meet no instance.
#[derive(Default)]
struct AimedPulses {
    origins: Vec<Point>,
    directions: Vec<Point>,
    /// When they are fired, since the start of the frame and as the scene's clock shows, s.
    ticks: Vec<i64>,
    moments: Vec<f64>,
    /// The instance that each hits first, or `NO_INSTANCE`.
    owners: Vec<u32>,
    /// The rays whose first hits are unknown.
    unknown: Vec<u32>,
}

impl AimedPulses {
    fn with_capacity(count: usize) -> Self {
        AimedPulses {
            origins: memory::with_capacity(count),
            directions: memory::with_capacity(count),
            ticks: memory::with_capacity(count),
            moments: memory::with_capacity(count),
            owners: memory::with_capacity(count),
            unknown: Vec::new(),
        }
    }

    fn rays(&self, world: &World) -> Rays<'_> {
        let times = if world.scene.moves() { &self.moments[..] } else { &[] };
        Rays::new(&self.origins, &self.directions, times)
    }

    /// Some of the pulses.
    fn part(&self, pulses: &[u32]) -> Self {
        let mut part = Self::with_capacity(pulses.len());
        for i in pulses.iter().map(|i| *i as usize) {
            part.push(self.origins[i], self.directions[i], (self.ticks[i], self.moments[i]), self.owners[i]);
        }
        part
    }

    #[inline(always)]
    fn push(&mut self, origin: Point, direction: Point, (ticks, moment): (i64, f64), owner: u32) {
        self.origins.push(origin);
        self.directions.push(direction);
        self.ticks.push(ticks);
        self.moments.push(moment);
        self.owners.push(owner);
    }
}

impl NominalPulses<'_> {
    /// Notes the pulses of a piece for the instances that they are known to hit first, and aims those that
    /// may meet another, eight at a time. Known misses meet none.
    #[inline(always)]
    fn aim<I: Isa>(
        &self,
        piece: Range<usize>,
        windows: &Windows,
        instances: &[u32],
        own: &mut [InstancePulses],
    ) -> AimedPulses {
        let first_hit = |i: usize| self.first.map_or(UNKNOWN, |first| first[i]);
        let mut pulses = memory::with_capacity(piece.len());
        pulses.extend(piece.filter(|&i| {
            let first = first_hit(i);
            let owner = instance_of(first, instances);
            note_first(own, owner, ticks_of(self.times[i]));
            first != MISS && windows.hold(&self.directions[i], owner)
        }));
        let mut aimed = AimedPulses::with_capacity(pulses.len());
        let (mut fired, mut poses) = ([f64::NAN; 8], Pose::UNSET);
        if let Path::Still(pose) = self.path {
            poses = Pose::splat(pose);
        }
        for some in pulses.chunks(8) {
            // Past the last pulse it is repeated.
            let eight: [usize; 8] = std::array::from_fn(|k| some[k.min(some.len() - 1)]);
            // Pulses of one time are fired from one pose.
            let moments = eight.map(|i| self.start + self.times[i]);
            if moments != fired && !matches!(self.path, Path::Still(_)) {
                (fired, poses) = (moments, self.path.poses::<I>(&moments));
            }
            let pose = poses.load::<I::F64x8>();
            let (mut origins, mut directions) = ([0.0; 24], [0.0; 24]);
            simd::store_points::<I>(pose.place(self.origins.of_these::<I>(&eight)), &mut origins);
            let nominal = I::columns(eight.map(|i| &self.directions[i]));
            simd::store_points::<I>(pose.turn(nominal), &mut directions);
            let places = origins.as_chunks().0.iter().zip(directions.as_chunks().0);
            for ((&i, moment), (origin, direction)) in some.iter().zip(moments).zip(places) {
                let first = first_hit(i);
                if first == UNKNOWN {
                    memory::push(&mut aimed.unknown, aimed.owners.len() as u32);
                }
                let time = (ticks_of(self.times[i]), moment);
                aimed.push(*origin, *direction, time, instance_of(first, instances));
            }
        }
        aimed
    }
}
