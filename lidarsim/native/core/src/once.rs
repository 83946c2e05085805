//! Values that are made on first use, by any number of threads and after a fork.

use std::cell::Cell;
use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use once_cell::race::OnceBox;

use crate::stop;

/// The time between two checks whether another thread has made the value.
const PAUSE: Duration = Duration::from_millis(1);

/// A value that one thread makes while others wait for it.
///
/// Unlike with `OnceLock`, a child that is forked while a thread of its parent makes the value makes its own:
/// it inherits the memory of that thread, but not the thread. So a maker has the number of its process, and
/// there is no lock, only a value or none.
pub struct Once<T> {
    value: OnceBox<T>,
    /// See [`this_thread`]; 0 for none.
    maker: AtomicU64,
}

impl<T> Default for Once<T> {
    fn default() -> Self {
        Once::new()
    }
}

impl<T> Once<T> {
    pub const fn new() -> Self {
        Once { value: OnceBox::new(), maker: AtomicU64::new(0) }
    }

    #[inline(always)]
    pub fn get(&self) -> Option<&T> {
        self.value.get()
    }

    #[inline(always)]
    pub fn get_or_make(&self, make: impl FnOnce() -> T) -> &T {
        match self.value.get() {
            Some(value) => value,
            None => self.make(make),
        }
    }

    #[cold]
    #[inline(never)]
    fn make(&self, make: impl FnOnce() -> T) -> &T {
        let me = this_thread();
        loop {
            let maker = self.maker.load(Ordering::Acquire);
            // A thread that reenters here, in a signal handler, would wait for itself.
            let waits = maker != 0 && maker != me && process_of(maker) == process_of(me);
            if let Some(value) = self.value.get() {
                return value;
            } else if waits {
                std::thread::sleep(PAUSE);
                stop::poll();
            } else if self.maker.compare_exchange(maker, me, Ordering::AcqRel, Ordering::Relaxed).is_ok() {
                break;
            }
        }
        let _end = End { maker: &self.maker, me };
        self.value.get_or_init(|| Box::new(make()))
    }
}

impl<T> fmt::Debug for Once<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.get().is_some() { "Once(made)" } else { "Once(not made)" })
    }
}

/// Lets another thread make the value if this one fails.
struct End<'a> {
    maker: &'a AtomicU64,
    me: u64,
}

impl Drop for End<'_> {
    fn drop(&mut self) {
        let _ = self.maker.compare_exchange(self.me, 0, Ordering::Release, Ordering::Relaxed);
    }
}

/// The process id and, in the lower half, a thread number above 0.
fn this_thread() -> u64 {
    static LAST: AtomicU32 = AtomicU32::new(0);
    thread_local! {
        static THREAD: Cell<u32> = const { Cell::new(0) };
    }
    if THREAD.get() == 0 {
        THREAD.set(LAST.fetch_add(1, Ordering::Relaxed) + 1);
    }
    u64::from(std::process::id()) << 32 | u64::from(THREAD.get())
}

fn process_of(maker: u64) -> u64 {
    maker >> 32
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;
    use std::sync::atomic::AtomicUsize;

    use super::*;

    #[test]
    fn one_thread_makes_the_value_and_all_get_it() {
        let (once, made, start) = (Once::new(), AtomicUsize::new(0), Barrier::new(8));
        let make = || {
            std::thread::sleep(20 * PAUSE);
            made.fetch_add(1, Ordering::Relaxed) + 41
        };
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    start.wait();
                    assert_eq!(*once.get_or_make(make), 41);
                });
            }
        });
        assert_eq!(made.into_inner(), 1);
    }

    #[test]
    fn a_maker_that_fails_leaves_it_to_others() {
        let once = Once::new();
        assert!(
            std::panic::catch_unwind(|| once.get_or_make(|| std::panic::resume_unwind(Box::new(()))))
                .is_err()
        );
        assert_eq!(*once.get_or_make(|| 3), 3);
        assert_eq!((*once.get_or_make(|| 4), once.get()), (3, Some(&3)));
    }

    #[test]
    fn nobody_waits_for_a_maker_of_another_process_or_for_itself() {
        let once = Once::new();
        once.maker.store(this_thread() ^ 1 << 32, Ordering::Relaxed);
        assert_eq!(*once.get_or_make(|| 5), 5);
        let once = Once::new();
        assert_eq!(*once.get_or_make(|| *once.get_or_make(|| 6)), 6);
    }
}
