//! Points and normals of the returns of a scan.

use std::mem::MaybeUninit;

use super::returns::{Field, ReturnPiece, Writer};
use crate::arith::simd::{self, Floats, Isa, Task, lanes};
use crate::bvh::{Mask, take};
use crate::geometry::origins::Origins;
use crate::geometry::pose::{Path, Pose};
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
pub struct MoverPoses<'a> {
    /// Per row, the object that its point is on; negative if the point stays.
    pub objects: &'a [i32],
    /// Per object, its motion and its pose at the moment, in the frame; `None` if it stands still.
    pub motions: &'a [Option<(&'a Path, Pose)>],
    /// The pose of the frame of the points, in the world.
    pub frame: Pose,
}

impl MoverPoses<'_> {
    /// Moves eight points and their normals along with the objects that they are on, if these move. `times`:
    /// when the pulses were fired, s.
    #[inline(always)]
    fn carry<I: Isa>(
        &self,
        rows: &[usize; 8],
        times: &[f64; 8],
        points: &mut [I::F64x8; 3],
        mut normals: Option<&mut [I::F64x8; 3]>,
    ) {
        let objects = rows.map(|row| self.objects[row]);
        let mut left = 0xff;
        while let Some(k) = take(&mut left) {
            let motion = usize::try_from(objects[k]).ok().and_then(|object| self.motions[object].as_ref());
            let Some((path, then)) = motion else { continue };
            // The lanes on the same object: mostly all eight. Results of other lanes are not used.
            let mut lanes = 0;
            for (i, object) in objects.iter().enumerate() {
                lanes |= u32::from(*object == objects[k]) << i;
            }
            left &= !Mask::from(lanes);
            let times = std::array::from_fn(|i| if lanes >> i & 1 == 1 { times[i] } else { times[k] });
            let from = path.poses::<I>(&times).load().relative_to(&Pose::splat(&self.frame));
            let to = Pose::splat(then);
            let moved = to.place(from.place_back(*points));
            *points = std::array::from_fn(|axis| I::pick(lanes, moved[axis], points[axis]));
            if let Some(normals) = &mut normals {
                let turned = to.turn(from.turn_back(**normals));
                **normals = std::array::from_fn(|axis| I::pick(lanes, turned[axis], normals[axis]));
            }
        }
    }
}

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
    pub movers: Option<MoverPoses<'a>>,
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
        let (mut fired, mut poses) = ([f64::NAN; 8], Pose::UNSET);
        if let Path::Still(pose) = path {
            poses = Pose::splat(pose);
        }
        let mut normals = self.normals.chunks_mut(8);
        for (first, points) in (0..rows.len()).step_by(8).zip(self.points.chunks_mut(8)) {
            // Past the last return it is repeated.
            let last = rows.len() - 1;
            let eight = std::array::from_fn(|k| rows[last.min(first + k)]);
            let of_pulses = std::array::from_fn(|k| pulses[last.min(first + k)]);
            let then = of_pulses.map(|pulse| start + times[pulse]);
            // Pulses of one time were fired from one pose.
            if then != fired && !matches!(path, Path::Still(_)) {
                (fired, poses) = (then, path.poses::<I>(&then));
            }
            let mut point = self.source.points::<I>(&poses, &eight, &of_pulses);
            let places = normals.next();
            let mut normal = places.is_some().then(|| self.source.normals::<I>(&poses, &eight));
            if let Some(movers) = movers {
                movers.carry::<I>(&eight, &then, &mut point, normal.as_mut());
            }
            let mut numbers = [0.0; 24];
            simd::store_points::<I>(point, &mut numbers);
            for (place, &point) in points.iter_mut().zip(numbers.as_chunks().0) {
                *place = point.map(MaybeUninit::new);
            }
            if let (Some(places), Some(normal)) = (places, normal) {
                simd::store_points::<I>(normal, &mut numbers);
                for (place, &normal) in places.iter_mut().zip(numbers.as_chunks().0) {
                    *place = normal.map(|x: f64| MaybeUninit::new(x as f32));
                }
            }
        }
    }
}
