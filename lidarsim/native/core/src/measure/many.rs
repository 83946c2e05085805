//! Many scans in one call: their batches of pulses are shared among all threads.

use std::mem::MaybeUninit;

use super::columns::Rows;
use super::frame::{BadPulse, Frame};
use super::scan::{Batch, Scan, share};
use crate::cast::NEAR;
use crate::geometry::vector::Point;
use crate::memory;
use crate::memory::split_off;

/// Most rays of a piece: they stay in the second-level cache. Few scans have more.
const MOST: usize = 8 * NEAR;

/// Measures all pulses of all scans, on all threads, or returns a bad pulse and the number of its scan: the
/// first of the first such scan.
///
/// `rows` and `points` have entries for `pulses` pulses of each scan, which are not written where a scan has
/// fewer. `points` may be empty; otherwise it receives the measured points of `rows.range`, in the sensor
/// frame. `work` runs a batch.
pub fn measure_all(
    scans: &[Scan],
    pulses: usize,
    mut rows: Rows,
    mut points: &mut [MaybeUninit<Point>],
    work: impl Fn(Batch) -> Result<(), BadPulse> + Sync,
) -> Result<(), (usize, BadPulse)> {
    let mut pieces = memory::with_capacity(scans.len());
    for (number, scan) in scans.iter().enumerate() {
        let (count, most) = (scan.frame.directions.len(), scan.measurement.most_returns());
        let size = (MOST / scan.measurement.rays()).max(1);
        let (mut own_rows, wanted) = (rows.split_off(pulses), (pulses * most).min(points.len()));
        let mut own_points = split_off(&mut points, wanted);
        for start in (0..count).step_by(size) {
            let piece = start..count.min(start + size);
            let own = (piece.len() * most).min(own_points.len());
            let parts = (own_rows.split_off(piece.len()), split_off(&mut own_points, own));
            memory::push(&mut pieces, (number, piece, parts));
        }
    }
    share(pieces, |(number, pulses, (mut rows, points))| {
        let scan = &scans[number];
        scan.measure_piece(pulses.clone(), &mut rows, &work).map_err(|bad| (number, bad))?;
        if !points.is_empty() {
            // SAFETY: the pulses have been measured, and none was bad.
            let ranges = unsafe { rows.written_range() };
            scan.frame.place(pulses.start, scan.measurement.most_returns(), ranges, points);
        }
        Ok(())
    })
}

impl Frame<'_> {
    /// Writes the measured points of pulses from `first` on, `most` each, in the sensor frame.
    fn place(&self, first: usize, most: usize, ranges: &[f64], points: &mut [MaybeUninit<Point>]) {
        let rows = ranges.chunks_exact(most).zip(points.chunks_exact_mut(most));
        for (pulse, (ranges, points)) in (first..).zip(rows) {
            let (origin, direction) = (self.origins.of(pulse), self.directions[pulse]);
            for (range, point) in ranges.iter().zip(points) {
                point.write(std::array::from_fn(|axis| origin[axis] + direction[axis] * range));
            }
        }
    }
}
