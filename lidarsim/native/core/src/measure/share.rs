//! Scans shared among threads.

use std::mem::MaybeUninit;
use std::sync::{Mutex, PoisonError};

use super::{BadPulse, Caster, Rows, Scan};
use crate::cast::pieces;
use crate::{memory, parallel};

impl<C: Caster> Scan<'_, C> {
    /// As `measure`, all pulses, on all threads. Of bad pulses the first is the outcome.
    pub fn share(&self, rows: &mut Rows) -> Result<(), BadPulse> {
        let (rays, most) = (self.measurement.rays(), self.measurement.returns.most());
        let pieces = pieces(self.frame.directions, rays).into_iter();
        let pieces = memory::collect(pieces.map(|piece| (piece.start, rows.split_off(piece.len(), most))));
        let bad = Mutex::new(None);
        parallel::share(pieces.into_iter(), |(first, mut rows)| {
            if let Err(found) = self.measure(first..first + rows.status.len(), &mut rows) {
                let mut bad = bad.lock().unwrap_or_else(PoisonError::into_inner);
                if bad.is_none_or(|bad: BadPulse| found.pulse < bad.pulse) {
                    *bad = Some(found);
                }
            }
        });
        bad.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}

/// Returns that a thread takes at a time.
const PIECE: usize = 1 << 13;

/// The returns of a scan: the row that each is in, and its pulse.
pub struct ReturnRows {
    row: Vec<usize>,
    /// None where each pulse has one row: then they are the same.
    pulse: Option<Vec<usize>>,
}

impl ReturnRows {
    /// Of pulses that have `most` rows each and so many returns.
    pub fn new(counts: &[u8], most: usize) -> Self {
        let numbers = || {
            let mut numbers = memory::with_capacity(counts.len() * most);
            numbers.resize(counts.len() * most, 0);
            numbers
        };
        let (mut row, mut pulse, mut end) = (numbers(), if most == 1 { None } else { Some(numbers()) }, 0);
        for (i, &count) in counts.iter().enumerate() {
            // As many as there may be, so that no branch hangs on how many there are: what is too much the next pulse writes over.
            for j in 0..most {
                row[end + j] = i * most + j;
            }
            if let Some(pulse) = &mut pulse {
                pulse[end..end + most].fill(i);
            }
            end += most.min(count.into());
        }
        row.truncate(end);
        if let Some(pulse) = &mut pulse {
            pulse.truncate(end);
        }
        ReturnRows { row, pulse }
    }

    /// Of each return.
    fn pulses(&self) -> &[usize] {
        self.pulse.as_ref().unwrap_or(&self.row)
    }

    pub fn count(&self) -> usize {
        self.row.len()
    }

    /// Writes a value of each return, by its row and its pulse, to the place of the return. All threads take part.
    pub fn gather<T: Send>(&self, places: &mut [MaybeUninit<T>], value: impl Fn(usize, usize) -> T + Sync) {
        assert_eq!(places.len(), self.count());
        let pieces = places.chunks_mut(PIECE).zip(self.row.chunks(PIECE).zip(self.pulses().chunks(PIECE)));
        parallel::share(pieces, |(places, (rows, pulses))| {
            for ((place, &row), &pulse) in places.iter_mut().zip(rows).zip(pulses) {
                place.write(value(row, pulse));
            }
        });
    }

    /// As `gather`, two values of each return, which also come by what the one before it left, if it was in the same piece.
    pub fn gather_pairs<A: Send, B: Send, S>(
        &self,
        (a, b): (&mut [MaybeUninit<A>], &mut [MaybeUninit<B>]),
        values: impl Fn(&mut Option<S>, usize, usize) -> (A, B) + Sync,
    ) {
        assert_eq!([a.len(), b.len()], [self.count(); 2]);
        let places = a.chunks_mut(PIECE).zip(b.chunks_mut(PIECE));
        parallel::share(
            places.zip(self.row.chunks(PIECE).zip(self.pulses().chunks(PIECE))),
            |((a, b), (rows, pulses))| {
                let mut left = None;
                for ((a, b), (&row, &pulse)) in a.iter_mut().zip(b).zip(rows.iter().zip(pulses)) {
                    let values = values(&mut left, row, pulse);
                    a.write(values.0);
                    b.write(values.1);
                }
            },
        );
    }
}
