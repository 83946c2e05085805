//! Points and normals of the returns of a scan.

use std::mem::MaybeUninit;

use super::origins::Origins;
use super::returns::{Field, Piece, Writer};
use crate::arith::simd::{Isa, Task};
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
    fn point_and_normal(&self, (pose, seen): (&Pose, &Pose), row: usize, pulse: usize) -> (Point, Point) {
        let (origin, direction) = (self.origins.of(pulse), self.directions[pulse]);
        let local = std::array::from_fn(|axis| origin[axis] + direction[axis] * self.range[row]);
        let normal = self.normals[row].map(f64::from);
        match &self.coordinates {
            Coordinates::Sensor => (local, pose.turn_back(normal)),
            Coordinates::Moment(at) => (seen.place(local), at.turn_back(normal)),
            Coordinates::World => (pose.place(local), normal),
        }
    }
}

/// The fields of points and normals, a coordinate after the other.
pub struct PointsAndNormals<'a> {
    pub points: &'a mut [MaybeUninit<f64>],
    pub normals: &'a mut [MaybeUninit<f32>],
    pub source: PointSource<'a>,
    /// Runs the work on a piece.
    pub write: &'a (dyn Fn(WritePoints) + Sync),
}

impl<'a> Field<'a> for PointsAndNormals<'a> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let (points, normals) =
            (split_off(&mut self.points, 3 * count), split_off(&mut self.normals, 3 * count));
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
    piece: &'b Piece,
}

impl Task for WritePoints<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self) {
        let PointSource { path, times, start, coordinates, .. } = self.source;
        let (rows, pulses) = self.piece.rows_and_pulses();
        let mut first = 0;
        while first < pulses.len() {
            // Pulses of one time were fired from one pose.
            let (mut end, time) = (pulses.len(), times[pulses[first]]);
            if !matches!(path, Path::Still(_)) {
                end = first + pulses[first..].iter().take_while(|&&pulse| times[pulse] == time).count();
            }
            let pose = path.at(start + time);
            let seen = if let Coordinates::Moment(at) = &coordinates { pose.relative_to(at) } else { pose };
            let places = self.points[first..end].iter_mut().zip(&mut self.normals[first..end]);
            for ((&row, &pulse), (point_place, normal_place)) in
                rows[first..end].iter().zip(&pulses[first..end]).zip(places)
            {
                let (point, normal) = self.source.point_and_normal((&pose, &seen), row, pulse);
                *point_place = point.map(MaybeUninit::new);
                *normal_place = normal.map(|x| MaybeUninit::new(x as f32));
            }
            first = end;
        }
    }
}
