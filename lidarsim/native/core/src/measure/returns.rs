//! The returns of a scan as fields of a point cloud. A field has an entry for each return; a scan has rows
//! for as many returns as a pulse may have.

use std::mem::MaybeUninit;

use crate::{memory, parallel};

/// Pulses whose returns a thread takes at a time: few enough that their indices stay in the first cache.
const PULSES: usize = 1 << 11;

/// How many returns each pulse has, of as many rows as it may have.
pub struct ReturnCounts<'a> {
    counts: &'a [u8],
    most: usize,
    /// Returns of each piece of `PULSES` pulses.
    of_pieces: Vec<usize>,
}

/// Returns of neighbouring pulses, in order: the row that each is in, and its pulse.
pub struct ReturnPiece {
    pub(super) most: usize,
    row: Vec<usize>,
    /// None if each pulse has one row: then they are equal.
    pulse: Option<Vec<usize>>,
}

/// Writes one field of a piece.
pub type Writer<'a> = Box<dyn FnOnce(&ReturnPiece) + Send + 'a>;

/// A field that is written piece by piece.
pub trait Field<'a> {
    /// What writes the next piece, of so many returns.
    fn split_off(&mut self, count: usize) -> Writer<'a>;
}

impl<'a> ReturnCounts<'a> {
    pub fn new(counts: &'a [u8], most: usize) -> Self {
        let returns = |counts: &[u8]| counts.iter().map(|&count| most.min(count.into())).sum();
        ReturnCounts { counts, most, of_pieces: memory::collect(counts.chunks(PULSES).map(returns)) }
    }

    /// Of all returns.
    pub fn count(&self) -> usize {
        self.of_pieces.iter().sum()
    }

    /// Writes the fields of all returns. All threads take part.
    pub fn write<'f>(&self, fields: &mut [Box<dyn Field<'f> + 'f>]) {
        let pieces = memory::collect(self.of_pieces.iter().enumerate().map(|(i, &count)| {
            let writers: Vec<Writer> = fields.iter_mut().map(|field| field.split_off(count)).collect();
            (i, count, writers)
        }));
        parallel::share(pieces.into_iter(), |(i, count, writers)| {
            let piece = self.piece(i, count);
            for write in writers {
                write(&piece);
            }
        });
    }

    fn piece(&self, i: usize, count: usize) -> ReturnPiece {
        let first = i * PULSES;
        let counts = &self.counts[first..self.counts.len().min(first + PULSES)];
        let (row, pulse) = if self.most == 1 {
            (rows_of_single(first, counts), None)
        } else {
            let (row, pulse) = rows_and_pulses(first, counts, self.most);
            (row, Some(pulse))
        };
        debug_assert_eq!(row.len(), count);
        ReturnPiece { most: self.most, row, pulse }
    }
}

/// The rows of the returns of pulses from `first` on that have one row each: their own numbers.
fn rows_of_single(first: usize, counts: &[u8]) -> Vec<usize> {
    // Rows are written for every pulse, without a branch on its count; the next return overwrites surplus
    // rows.
    let (mut row, mut end) = (vec![0; counts.len()], 0);
    for (pulse, counts) in (first..).step_by(8).zip(counts.chunks(8)) {
        if *counts == [1; 8] {
            row[end..end + 8].copy_from_slice(&std::array::from_fn::<_, 8, _>(|k| pulse + k));
            end += 8;
        } else {
            for (pulse, &count) in (pulse..).zip(counts) {
                row[end] = pulse;
                end += usize::from(count > 0);
            }
        }
    }
    row.truncate(end);
    row
}

/// The rows and the pulses of the returns of pulses from `first` on that have `most` rows each.
fn rows_and_pulses(first: usize, counts: &[u8], most: usize) -> (Vec<usize>, Vec<usize>) {
    let (mut row, mut pulse, mut end) = (vec![0; counts.len() * most], vec![0; counts.len() * most], 0);
    for (i, &count) in (first..).zip(counts) {
        for j in 0..most {
            row[end + j] = i * most + j;
        }
        pulse[end..end + most].fill(i);
        end += most.min(count.into());
    }
    row.truncate(end);
    pulse.truncate(end);
    (row, pulse)
}

impl ReturnPiece {
    /// The row and the pulse of each return.
    pub(super) fn rows_and_pulses(&self) -> (&[usize], &[usize]) {
        (&self.row, self.pulse.as_ref().unwrap_or(&self.row))
    }
}

/// What a scan has one value for.
#[derive(Clone, Copy)]
pub enum Each<'a, T> {
    Row(&'a [T]),
    Pulse(&'a [T]),
}

/// A field that is copied from a scan.
pub struct Copied<'a, T> {
    pub places: &'a mut [MaybeUninit<T>],
    pub each: Each<'a, T>,
}

impl<'a, T: Copy + Send + Sync> Field<'a> for Copied<'a, T> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let (places, each) = (memory::split_off(&mut self.places, count), self.each);
        Box::new(move |piece| match (each, &piece.pulse) {
            (Each::Row(values), _) | (Each::Pulse(values), None) => {
                copy_rising(places, &piece.row, values);
            }
            (Each::Pulse(values), Some(pulses)) => {
                for (place, &pulse) in places.iter_mut().zip(pulses) {
                    place.write(values[pulse]);
                }
            }
        })
    }
}

/// Copies values at rising indices; consecutive ones at once.
fn copy_rising<T: Copy>(places: &mut [MaybeUninit<T>], indices: &[usize], values: &[T]) {
    const RUN: usize = 16;
    for (places, indices) in places.chunks_mut(RUN).zip(indices.chunks(RUN)) {
        if let (Ok(places), [first, .., last]) = (<&mut [_; RUN]>::try_from(&mut *places), indices)
            && last - first == RUN - 1
            && let Some(values) = values[*first..].first_chunk::<RUN>()
        {
            for (place, value) in places.iter_mut().zip(values) {
                place.write(*value);
            }
            continue;
        }
        for (place, &i) in places.iter_mut().zip(indices) {
            place.write(values[i]);
        }
    }
}

/// The number of each return of its pulse, from 1.
pub struct Numbers<'a>(pub &'a mut [MaybeUninit<u8>]);

impl<'a> Field<'a> for Numbers<'a> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let places = memory::split_off(&mut self.0, count);
        Box::new(|piece| {
            let (rows, pulses) = piece.rows_and_pulses();
            for (place, (row, pulse)) in places.iter_mut().zip(rows.iter().zip(pulses)) {
                place.write((row - pulse * piece.most + 1) as u8);
            }
        })
    }
}
