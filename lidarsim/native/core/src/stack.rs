//! How much of its stack a thread has left.

use std::cell::Cell;
use std::hint::black_box;

/// Twice what the core was measured to need: it works on stacks of 320 KiB and overflows those of 256. The packets of a cast have the largest frames.
const ROOM: usize = 640 << 10;

/// Whether this thread has room on its stack for the work of the core. Where that cannot be found out, it has.
pub fn has_room() -> bool {
    thread_local! {
        /// The lowest address of the stack, once it is known; 0 if it cannot be.
        static LOWEST: Cell<Option<usize>> = const { Cell::new(None) };
    }
    let lowest = LOWEST.get().unwrap_or_else(|| {
        let found = lowest().unwrap_or(0);
        LOWEST.set(Some(found));
        found
    });
    let here = 0_u8;
    (&raw const *black_box(&here)) as usize - lowest > ROOM
}

#[cfg(target_os = "linux")]
fn lowest() -> Option<usize> {
    use std::mem::MaybeUninit;
    use std::ptr::null_mut;

    let (mut attributes, mut start, mut size) = (MaybeUninit::uninit(), null_mut(), 0);
    // SAFETY: the attributes are those of the thread that asks, so it runs; they are read only if they were filled in, and freed once.
    let found = unsafe {
        libc::pthread_getattr_np(libc::pthread_self(), attributes.as_mut_ptr()) == 0 && {
            let found = libc::pthread_attr_getstack(attributes.as_ptr(), &raw mut start, &raw mut size) == 0;
            libc::pthread_attr_destroy(attributes.as_mut_ptr());
            found
        }
    };
    found.then_some(start as usize)
}

#[cfg(target_os = "macos")]
fn lowest() -> Option<usize> {
    // SAFETY: the thread that asks runs.
    let (top, size) = unsafe {
        let this = libc::pthread_self();
        (libc::pthread_get_stackaddr_np(this) as usize, libc::pthread_get_stacksize_np(this))
    };
    top.checked_sub(size)
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn lowest() -> Option<usize> {
    None
}

#[cfg(test)]
mod tests {
    use std::thread::Builder;

    use super::*;

    #[test]
    fn only_threads_with_a_large_stack_have_room() {
        for (size, expected) in
            [(256 << 10, false), (512 << 10, false), (1 << 20, true), (2 << 20, true), (8 << 20, true)]
        {
            let found = Builder::new().stack_size(size).spawn(has_room).map(|thread| thread.join().ok());
            if cfg!(any(target_os = "linux", target_os = "macos")) {
                assert_eq!(found.ok().flatten(), Some(expected), "{size}");
            }
        }
    }
}
