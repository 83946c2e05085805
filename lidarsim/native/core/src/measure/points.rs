//! Points and normals of the returns of a scan.

use std::mem::MaybeUninit;
use std::ops::Range;

use super::origins::Origins;
use super::returns::{Field, Piece, Writer};
use crate::arith::simd::{self, Floats, Isa, Task};
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
}

impl PointSource<'_> {
    /// The point and the normal of a return. `pose`: of the sensor, in the world; `seen`: the same, relative
    /// to the moment.
    #[inline(always)]
    fn point_and_normal<F: Floats<f64, N>, const N: usize>(
        &self,
        (pose, seen): (&Pose, &Pose),
        (origin, direction, range): Ray<F>,
        normal: [F; 3],
    ) -> ([F; 3], [F; 3]) {
        let along = [direction[0].mul(range), direction[1].mul(range), direction[2].mul(range)];
        let local = [origin[0].add(along[0]), origin[1].add(along[1]), origin[2].add(along[2])];
        match &self.coordinates {
            Coordinates::Sensor => (local, pose.turn_back(normal)),
            Coordinates::Moment(at) => (seen.place(local), at.turn_back(normal)),
            Coordinates::World => (pose.place(local), normal),
        }
    }

    #[inline(always)]
    fn of_one(&self, row: usize, pulse: usize) -> (Ray<f64>, Point) {
        ((self.origins.of(pulse), self.directions[pulse], self.range[row]), self.normals[row].map(f64::from))
    }

    /// Of eight pulses of one row each, from `first` on.
    #[inline(always)]
    fn of_eight<I: Isa>(&self, first: usize) -> (Ray<I::F64x8>, [I::F64x8; 3]) {
        let eight = first..first + 8;
        let directions = simd::load_points::<I>(&self.directions[eight.clone()].as_chunks().0[0]);
        let range = I::F64x8::load(&self.range[eight.clone()].as_chunks().0[0]);
        let normals: &[[f32; 8]] = self.normals[eight].as_flattened().as_chunks().0;
        let normals = [0, 1, 2].map(|k| I::F64x8::load(&normals[k].map(f64::from)));
        ((self.origins.of_eight::<I>(first), directions, range), I::deinterleaved(normals))
    }
}

/// Origin, direction and range.
type Ray<F> = ([F; 3], [F; 3], F);

/// The fields of points and normals, a coordinate after the other.
pub struct PointsAndNormals<'a> {
    pub points: &'a mut [MaybeUninit<f64>],
    pub normals: &'a mut [MaybeUninit<f32>],
    pub source: PointSource<'a>,
}

impl<'a> Field<'a> for PointsAndNormals<'a> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let (points, normals) =
            (split_off(&mut self.points, 3 * count), split_off(&mut self.normals, 3 * count));
        let source = self.source;
        Box::new(move |piece| simd::dispatch(piece.level, WritePoints { points, normals, source, piece }))
    }
}

/// The work on one piece.
struct WritePoints<'a, 'b> {
    points: &'a mut [MaybeUninit<f64>],
    normals: &'a mut [MaybeUninit<f32>],
    source: PointSource<'a>,
    piece: &'b Piece,
}

impl Task for WritePoints<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self) {
        let PointSource { path, times, start, coordinates, .. } = self.source;
        let (_, pulses) = self.piece.rows_and_pulses();
        let mut first = 0;
        while first < pulses.len() {
            // Pulses of one time were fired from one pose.
            let (mut end, time) = (pulses.len(), times[pulses[first]]);
            if !matches!(path, Path::Still(_)) {
                end = first + pulses[first..].iter().take_while(|&&pulse| times[pulse] == time).count();
            }
            let pose = path.at(start + time);
            let seen = if let Coordinates::Moment(at) = &coordinates { pose.relative_to(at) } else { pose };
            self.write_from_pose::<I>(first..end, (&pose, &seen));
            first = end;
        }
    }
}

impl WritePoints<'_, '_> {
    /// Of returns from one pose.
    #[inline(always)]
    fn write_from_pose<I: Isa>(&mut self, returns: Range<usize>, poses: (&Pose, &Pose)) {
        let (rows, pulses) = self.piece.rows_and_pulses();
        let coordinates = 3 * returns.start..3 * returns.end;
        let entries =
            self.points[coordinates.clone()].chunks_mut(24).zip(self.normals[coordinates].chunks_mut(24));
        let returns = rows[returns.clone()].chunks(8).zip(pulses[returns].chunks(8));
        for ((rows, pulses), (point_entries, normal_entries)) in returns.zip(entries) {
            if let ([first, .., last], 1, 8) = (rows, self.piece.most, rows.len())
                && last - first == 7
            {
                let (ray, normal) = self.source.of_eight::<I>(*first);
                let (point, normal) = self.source.point_and_normal(poses, ray, normal);
                for (entry, point) in point_entries.as_chunks_mut().0.iter_mut().zip(I::interleaved(point)) {
                    *entry = point.store().map(MaybeUninit::new);
                }
                for (entry, normal) in normal_entries.as_chunks_mut().0.iter_mut().zip(I::interleaved(normal))
                {
                    *entry = normal.store().map(|x| MaybeUninit::new(x as f32));
                }
                continue;
            }
            let entries = point_entries.as_chunks_mut().0.iter_mut().zip(normal_entries.as_chunks_mut().0);
            for ((&row, &pulse), (point_entry, normal_entry)) in rows.iter().zip(pulses).zip(entries) {
                let (ray, normal) = self.source.of_one(row, pulse);
                let (point, normal) = self.source.point_and_normal(poses, ray, normal);
                *point_entry = point.map(MaybeUninit::new);
                *normal_entry = normal.map(|x| MaybeUninit::new(x as f32));
            }
        }
    }
}
