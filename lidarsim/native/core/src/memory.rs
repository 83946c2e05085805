//! Large arrays on large pages, where the system gives them on request.
//!
//! A hierarchy is read all over, so that with small pages most reads also miss the processor's table of
//! pages; and of an array that is written for the first time, each page is made then.

use std::panic::resume_unwind;

/// What work unwinds with that the system gives no memory.
///
/// Every array that grows with what the caller gave is made here: those of the standard library end the
/// process instead.
#[derive(Debug, PartialEq, Eq)]
pub struct OutOfMemory {
    pub bytes: usize,
    /// What they were for.
    pub purpose: String,
}

/// An empty vector of this capacity, on large pages if it is large.
pub fn with_capacity<T>(capacity: usize) -> Vec<T> {
    let mut vector = Vec::new();
    if vector.try_reserve_exact(capacity).is_err() {
        refuse::<T>(capacity);
    }
    #[cfg(target_os = "linux")]
    advise(&vector);
    vector
}

/// Makes a vector as long as that, with more of this value.
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

/// Makes room for as many more.
pub fn reserve<T>(vector: &mut Vec<T>, more: usize) {
    if vector.try_reserve(more).is_err() {
        refuse::<T>(vector.len().saturating_add(more));
    }
}

/// Unwinds now, before any work, unless the system would give so many bytes at once.
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
        // SAFETY: the pages from `start`, whole ones, lie within the allocation, and the advice does not
        // change what they hold. A refusal is of no consequence.
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

/// What an iterator gives, in large pages.
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
