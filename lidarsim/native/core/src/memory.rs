//! Large arrays on huge pages, if the system provides them on request.
//!
//! Reads of a hierarchy are scattered, so with small pages most would also miss the TLB. A newly written
//! array takes a page fault for each page.

use std::panic::resume_unwind;

/// The payload of the panic if memory runs out.
///
/// This module makes every array whose size the caller determines: those of the standard library would abort
/// the process.
#[derive(Debug, PartialEq, Eq)]
pub struct OutOfMemory {
    pub bytes: usize,
    /// What the bytes were for.
    pub purpose: String,
}

/// An empty vector with this capacity, on huge pages if it is large.
pub fn with_capacity<T>(capacity: usize) -> Vec<T> {
    let mut vector = Vec::new();
    if vector.try_reserve_exact(capacity).is_err() {
        refuse::<T>(capacity);
    }
    #[cfg(target_os = "linux")]
    advise(&vector);
    vector
}

/// Resizes a vector, filling it up with this value.
pub fn resize<T: Clone>(vector: &mut Vec<T>, count: usize, value: T) {
    reserve(vector, count.saturating_sub(vector.len()));
    vector.resize(count, value);
}

pub fn push<T>(vector: &mut Vec<T>, value: T) {
    reserve(vector, 1);
    vector.push(value);
}

/// An array on the heap.
pub fn boxed<T, const N: usize>(values: [T; N]) -> Box<[T; N]> {
    let mut vector = Vec::new();
    if vector.try_reserve_exact(N).is_err() {
        refuse::<T>(N);
    }
    vector.extend(values);
    vector.into_boxed_slice().try_into().unwrap_or_else(|_| unreachable!("it has as many"))
}

/// Reserves room for `more` elements.
pub fn reserve<T>(vector: &mut Vec<T>, more: usize) {
    if vector.try_reserve(more).is_err() {
        refuse::<T>(vector.len().saturating_add(more));
    }
}

/// Unwinds now, before any work, unless the system can provide this many bytes at once.
pub fn expect_room(bytes: usize, purpose: impl FnOnce() -> String) {
    if Vec::<u8>::new().try_reserve_exact(bytes).is_err() {
        resume_unwind(Box::new(OutOfMemory { bytes, purpose: purpose() }));
    }
}

#[cold]
#[inline(never)]
fn refuse<T>(count: usize) -> ! {
    let bytes = count.saturating_mul(size_of::<T>());
    resume_unwind(Box::new(OutOfMemory { bytes, purpose: format!("an array of {count} elements") }))
}

#[cfg(target_os = "linux")]
fn advise<T>(vector: &Vec<T>) {
    const PAGE: usize = 2 << 20;
    let start = (vector.as_ptr() as usize).next_multiple_of(4096);
    let end = vector.as_ptr() as usize + vector.capacity() * size_of::<T>();
    if end > start + PAGE {
        // SAFETY: the whole pages from `start` on lie within the allocation, and the advice does not change
        // their contents. A refusal is harmless.
        unsafe { libc::madvise(start as *mut libc::c_void, (end - start) & !4095, libc::MADV_HUGEPAGE) };
    }
}

/// Splits off the first elements of a slice.
pub fn split_off<'a, T>(places: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, others) = std::mem::take(places).split_at_mut(count);
    *places = others;
    first
}

/// A copy of a slice.
pub fn copy<T: Copy>(slice: &[T]) -> Vec<T> {
    let mut vector = with_capacity(slice.len());
    vector.extend_from_slice(slice);
    vector
}

/// The values of an iterator, on huge pages.
pub fn collect<T>(values: impl ExactSizeIterator<Item = T>) -> Vec<T> {
    let mut vector = with_capacity(values.len());
    vector.extend(values);
    vector
}

#[cfg(test)]
mod tests {
    use std::panic::catch_unwind;

    use super::*;

    #[test]
    fn arrays_that_cannot_be_had_unwind_with_what_was_asked_for() {
        let refusal = |work: fn()| *catch_unwind(work).unwrap_err().downcast::<OutOfMemory>().unwrap();
        let huge = usize::MAX / 32;
        let OutOfMemory { bytes, purpose } = refusal(|| drop(with_capacity::<u64>(usize::MAX / 32)));
        assert_eq!((bytes, purpose), (8 * huge, format!("an array of {huge} elements")));
        assert_eq!(refusal(|| resize(&mut vec![1_u16], usize::MAX / 4, 0)).bytes, usize::MAX / 4 * 2);
        let asked = refusal(|| expect_room(usize::MAX, || "everything".into()));
        assert_eq!(asked, OutOfMemory { bytes: usize::MAX, purpose: "everything".into() });
    }

    #[test]
    fn arrays_hold_what_was_put_there() {
        let mut vector = with_capacity(2);
        push(&mut vector, 1);
        resize(&mut vector, 3, 7);
        assert_eq!((vector, *boxed(["a", "b"])), (vec![1, 7, 7], ["a", "b"]));
    }
}
