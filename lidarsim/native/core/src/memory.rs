//! Large arrays on large pages, where the system gives them on request.
//!
//! A hierarchy is read all over, so that with small pages most reads also miss the processor's table of pages; and of an array that is written for
//! the first time, each page is made then.

/// An empty vector of this capacity, on large pages if it is large.
pub fn with_capacity<T>(capacity: usize) -> Vec<T> {
    let vector = Vec::with_capacity(capacity);
    #[cfg(target_os = "linux")]
    advise(&vector);
    vector
}

#[cfg(target_os = "linux")]
fn advise<T>(vector: &Vec<T>) {
    const PAGE: usize = 2 << 20;
    let start = (vector.as_ptr() as usize).next_multiple_of(4096);
    let end = vector.as_ptr() as usize + vector.capacity() * size_of::<T>();
    if end > start + PAGE {
        // SAFETY: the pages from `start`, whole ones, lie within the allocation, and the advice does not change what they hold. A refusal is
        // of no consequence.
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
