//! Points and normals of the returns of a scan.

use std::mem::MaybeUninit;

use super::returns::{Field, ReturnPiece, Writer};
use crate::arith::simd::{self, Floats, Isa, Task, lanes};
use crate::geometry::origins::Origins;
use crate::geometry::pose::{Motion, Path, Pose};
use crate::geometry::vector::Point;
use crate::memory::split_off;

/// In which coordinates points are given.
#[derive(Clone, Copy)]
pub enum Coordinates {
    /// Of the sensor when it fired the pulse.
    Sensor,
    /// Of the sensor at one moment.
    Moment(Pose),
    World,
}

/// The moving objects whose points are moved along, to where they are on the objects at one moment.
#[derive(Clone, Copy)]
pub struct Movers<'a> {
    /// Per row, the object that its point is on; negative if the point stays.
    pub objects: &'a [i32],
    /// Per object, its motion and its pose at the moment, in the frame; `None` if it stands still.
    pub motions: &'a [Option<(&'a Path, Pose)>],
    /// The pose of the frame of the points, in the world.
    pub frame: Pose,
}

impl Movers<'_> {
    /// The poses of the object of a row, in the frame: at a time and at the moment. Points of one object and
    /// time are close to each other, so the poses of few are kept.
    #[inline(always)]
    fn poses<'k>(&self, row: usize, time: f64, kept: &'k mut [Kept; KEPT]) -> Option<&'k [Pose; 2]> {
        let object = usize::try_from(self.objects[row]).ok()?;
        let (path, then) = self.motions[object].as_ref()?;
        let kept = &mut kept[object % KEPT];
        match kept {
            Some((of, at, _)) if (*of, *at) == (object, time) => {}
            _ => *kept = Some((object, time, [path.at(time).relative_to(&self.frame), *then])),
        }
        kept.as_ref().map(|(.., poses)| poses)
    }
}

type Kept = Option<(usize, f64, [Pose; 2])>;
const KEPT: usize = 64;

/// The arrays from which points and normals are computed.
#[derive(Clone, Copy)]
pub struct PointSource<'a> {
    /// Of each pulse, in the sensor frame.
    pub origins: Origins<'a>,
    pub directions: &'a [Point],
    /// Of each row; normals in the world.
    pub range: &'a [f64],
    pub normals: &'a [[f32; 3]],
    pub path: &'a Path,
    /// Of each pulse, since the start of the scan, s.
    pub times: &'a [f64],
    pub start: f64,
    pub coordinates: Coordinates,
    pub movers: Option<Movers<'a>>,
}

impl PointSource<'_> {
    /// Eight returns. `poses`: of the sensor, in the world, at their times.
    #[inline(always)]
    fn points<I: Isa>(
        &self,
        poses: &Pose<[f64; 8]>,
        rows: &[usize; 8],
        pulses: &[usize; 8],
    ) -> [I::F64x8; 3] {
        let direction = I::columns(pulses.map(|pulse| &self.directions[pulse]));
        let origin = self.origins.of_these::<I>(pulses);
        let range = I::F64x8::load(&rows.map(|row| self.range[row]));
        let local = lanes::add(origin, lanes::scaled(direction, range));
        match &self.coordinates {
            Coordinates::Sensor => local,
            Coordinates::Moment(at) => poses.load().relative_to(&Pose::splat(at)).place(local),
            Coordinates::World => poses.load().place(local),
        }
    }

    /// The normals of eight returns.
    #[inline(always)]
    fn normals<I: Isa>(&self, poses: &Pose<[f64; 8]>, rows: &[usize; 8]) -> [I::F64x8; 3] {
        let normals = rows.map(|row| self.normals[row].map(f64::from));
        let normal = I::columns(normals.each_ref());
        match &self.coordinates {
            Coordinates::Sensor => poses.load().turn_back(normal),
            Coordinates::Moment(at) => Pose::splat(at).turn_back(normal),
            Coordinates::World => normal,
        }
    }
}

/// The fields of points and normals, a coordinate after the other.
pub struct PointsAndNormals<'a> {
    pub points: &'a mut [MaybeUninit<f64>],
    /// Empty if they are not wanted.
    pub normals: &'a mut [MaybeUninit<f32>],
    pub source: PointSource<'a>,
    /// Runs the work on a piece.
    pub write: &'a (dyn Fn(WritePoints) + Sync),
}

impl<'a> Field<'a> for PointsAndNormals<'a> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let normals = if self.normals.is_empty() { 0 } else { 3 * count };
        let (points, normals) =
            (split_off(&mut self.points, 3 * count), split_off(&mut self.normals, normals));
        let (source, write) = (self.source, self.write);
        Box::new(move |piece| {
            let (points, normals) = (points.as_chunks_mut().0, normals.as_chunks_mut().0);
            write(WritePoints { points, normals, source, piece });
        })
    }
}

/// The work on one piece, compiled for each instruction set.
pub struct WritePoints<'a, 'b> {
    points: &'b mut [[MaybeUninit<f64>; 3]],
    normals: &'b mut [[MaybeUninit<f32>; 3]],
    source: PointSource<'a>,
    piece: &'b ReturnPiece,
}

impl Task for WritePoints<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let PointSource { path, times, start, movers, .. } = self.source;
        let (rows, pulses) = self.piece.rows_and_pulses();
        let (mut fired, mut motions) = ([f64::NAN; 8], Motion::UNSET);
        if let Path::Still(pose) = path {
            motions.pose = Pose::splat(pose);
        }
        let mut normals = self.normals.chunks_mut(8);
        let mut kept = [const { None }; KEPT];
        for (first, points) in (0..rows.len()).step_by(8).zip(self.points.chunks_mut(8)) {
            // Past the last return it is repeated.
            let last = rows.len() - 1;
            let eight = std::array::from_fn(|k| rows[last.min(first + k)]);
            let of_pulses = std::array::from_fn(|k| pulses[last.min(first + k)]);
            let then = of_pulses.map(|pulse| start + times[pulse]);
            // Pulses of one time were fired from one pose.
            if then != fired && !matches!(path, Path::Still(_)) {
                (fired, motions) = (then, path.motions::<I>(&then));
            }
            let mut numbers = [0.0; 24];
            simd::store_points::<I>(self.source.points::<I>(&motions.pose, &eight, &of_pulses), &mut numbers);
            for (k, (place, &point)) in points.iter_mut().zip(numbers.as_chunks().0).enumerate() {
                let moves = movers.and_then(|movers| movers.poses(eight[k], then[k], &mut kept));
                let point = moves.map_or(point, |[from, to]| to.place(from.place_back(point)));
                *place = point.map(MaybeUninit::new);
            }
            if let Some(normals) = normals.next() {
                simd::store_points::<I>(self.source.normals::<I>(&motions.pose, &eight), &mut numbers);
                for (k, (place, &normal)) in normals.iter_mut().zip(numbers.as_chunks().0).enumerate() {
                    let moves = movers.and_then(|movers| movers.poses(eight[k], then[k], &mut kept));
                    let normal = moves.map_or(normal, |[from, to]| to.turn(from.turn_back(normal)));
                    *place = normal.map(|x: f64| MaybeUninit::new(x as f32));
                }
            }
        }
    }
}
