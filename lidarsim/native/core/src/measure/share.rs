//! Scans shared among threads.

use std::sync::{Mutex, PoisonError};

use super::{BadPulse, Caster, Rows, Scan};
use crate::cast::pieces;
use crate::{memory, parallel};

impl<C: Caster> Scan<'_, C> {
    /// As `measure`, all pulses, on all threads. Of bad pulses the first is the outcome.
    pub fn share(&self, rows: &mut Rows) -> Result<(), BadPulse> {
        let (rays, most) = (self.measurement.rays(), self.measurement.most_returns());
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
