//! The returns of a scan as fields of a point cloud: an entry a return, where a scan has as many rows for each pulse as it may have returns.

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
pub struct Piece {
    most: usize,
    row: Vec<usize>,
    /// None where each pulse has one row: then they are the same.
    pulse: Option<Vec<usize>>,
}

/// Writes one field of a piece.
pub type Writer<'a> = Box<dyn FnOnce(&Piece) + Send + 'a>;

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

    fn piece(&self, i: usize, count: usize) -> Piece {
        let first = i * PULSES;
        let counts = &self.counts[first..self.counts.len().min(first + PULSES)];
        // As many as there may be, so that no branch hangs on how many there are: what is too much the next pulse writes over.
        let numbers = || vec![0; counts.len() * self.most];
        let (mut row, mut pulse, mut end) = (numbers(), if self.most == 1 { None } else { Some(numbers()) }, 0);
        for (i, &count) in (first..).zip(counts) {
            for j in 0..self.most {
                row[end + j] = i * self.most + j;
            }
            if let Some(pulse) = &mut pulse {
                pulse[end..end + self.most].fill(i);
            }
            end += self.most.min(count.into());
        }
        debug_assert_eq!(end, count);
        row.truncate(end);
        if let Some(pulse) = &mut pulse {
            pulse.truncate(end);
        }
        Piece { most: self.most, row, pulse }
    }
}

impl Piece {
    /// The row and the pulse of each return.
    pub fn iter(&self) -> impl Iterator<Item = (usize, usize)> {
        self.row.iter().copied().zip(self.pulse.as_ref().unwrap_or(&self.row).iter().copied())
    }
}

/// What there is a value for.
#[derive(Clone, Copy)]
pub enum Each<'a, T> {
    Row(&'a [T]),
    Pulse(&'a [T]),
}

/// A field of values that a scan has.
pub struct Copied<'a, T> {
    pub places: &'a mut [MaybeUninit<T>],
    pub each: Each<'a, T>,
}

impl<'a, T: Copy + Send + Sync> Field<'a> for Copied<'a, T> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let (places, each) = (memory::split_off(&mut self.places, count), self.each);
        Box::new(move |piece| match (each, &piece.pulse) {
            (Each::Row(values), _) | (Each::Pulse(values), None) => copy_rising(places, &piece.row, values),
            (Each::Pulse(values), Some(pulses)) => {
                for (place, &pulse) in places.iter_mut().zip(pulses) {
                    place.write(values[pulse]);
                }
            }
        })
    }
}

/// Copies the values of rising indices: where these follow each other, many at once.
fn copy_rising<T: Copy>(places: &mut [MaybeUninit<T>], indices: &[usize], values: &[T]) {
    const RUN: usize = 16;
    for (places, indices) in places.chunks_mut(RUN).zip(indices.chunks(RUN)) {
        if let (Ok(places), [first, .., last]) = (<&mut [_; RUN]>::try_from(&mut *places), indices)
            && last - first == RUN - 1
            && let Some(values) = values[*first..].first_chunk::<RUN>()
        {
            *places = values.map(MaybeUninit::new);
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
            for (place, (row, pulse)) in places.iter_mut().zip(piece.iter()) {
                place.write((row - pulse * piece.most + 1) as u8);
            }
        })
    }
}

/// Two fields that are worked out together from the row and the pulse of each return; each piece begins with a clone of what does it.
pub struct Pair<'a, A, B, V> {
    pub places: (&'a mut [MaybeUninit<A>], &'a mut [MaybeUninit<B>]),
    pub values: V,
}

impl<'a, A: Send, B: Send, V: FnMut(usize, usize) -> (A, B) + Clone + Send + 'a> Field<'a> for Pair<'a, A, B, V> {
    fn split_off(&mut self, count: usize) -> Writer<'a> {
        let (a, b) = (memory::split_off(&mut self.places.0, count), memory::split_off(&mut self.places.1, count));
        let mut values = self.values.clone();
        Box::new(move |piece| {
            for ((a, b), (row, pulse)) in a.iter_mut().zip(b).zip(piece.iter()) {
                let values = values(row, pulse);
                a.write(values.0);
                b.write(values.1);
            }
        })
    }
}
