//! Work shared among threads, in pools that are rebuilt after a fork.

use std::cell::Cell;
use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};

use arc_swap::ArcSwapOption;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::memory::OutOfMemory;
use crate::stop::{self, Job};

/// A pool and its process: after `fork` the child has the memory of a pool, but none of its threads.
struct Pool {
    process: u32,
    threads: usize,
    pool: ThreadPool,
}

/// The pool of parallel iterators, with all threads; the caller sleeps meanwhile.
static ITERATING: ArcSwapOption<Pool> = ArcSwapOption::const_empty();

/// Helpers; the caller also works, so the pool has one thread less. A thread with nothing to do would be
/// woken whenever another finds work; if all processors are then busy, freshly shared work waits for
/// milliseconds.
static HELPING: ArcSwapOption<Pool> = ArcSwapOption::const_empty();

/// The requested number of threads; 0 for all that may run at once.
static ASKED: AtomicUsize = AtomicUsize::new(0);

/// The stack of each thread: the default of the standard library. Its own default would read the environment
/// here, which other threads may be writing.
const STACK: usize = 2 << 20;

/// Sets the number of threads; `None` for as many as this process may run at once.
pub fn use_threads(count: Option<usize>) {
    ASKED.store(count.unwrap_or(0), Ordering::Relaxed);
}

/// The number of threads that share work.
pub fn threads() -> usize {
    match ASKED.load(Ordering::Relaxed) {
        0 => available(),
        asked => asked,
    }
}

/// The parallelism that this process first found; finding it reads files.
fn available() -> usize {
    /// The process id and, in the lower half, the number of threads.
    static KNOWN: AtomicU64 = AtomicU64::new(0);
    let (known, process) = (KNOWN.load(Ordering::Relaxed), u64::from(std::process::id()));
    if known >> 32 == process {
        return (known & u64::from(u32::MAX)) as usize;
    }
    let count = std::thread::available_parallelism().map_or(1, NonZero::get);
    KNOWN.store(process << 32 | count as u64, Ordering::Relaxed);
    count
}

/// The kept pool with this many threads, made anew if needed; `None` if the system refuses threads.
fn pool(kept: &ArcSwapOption<Pool>, threads: usize) -> Option<Arc<Pool>> {
    let process = std::process::id();
    let current = kept.load_full();
    if let Some(pool) = &current
        && pool.process == process
        && pool.threads == threads
    {
        return current;
    }
    let pool = ThreadPoolBuilder::new().num_threads(threads).stack_size(STACK).build().ok()?;
    let new = Arc::new(Pool { process, threads, pool });
    let old = kept.swap(Some(new.clone()));
    if old.as_ref().is_some_and(|old| old.process != process) {
        // Its threads do not exist here: dropping it would wait for them.
        std::mem::forget(old);
        std::mem::forget(current);
    }
    Some(new)
}

/// The stack that work may need: casts take some 300 KiB on each instruction set, exact decisions little
/// more.
const ROOM: usize = 1 << 20;

/// Does `work` on this thread, or on a new one if little is left of its stack.
pub fn with_room<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    if room() >= ROOM {
        return work();
    }
    let job = Job::current();
    std::thread::scope(|scope| {
        let (working, done) = mpsc::channel();
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, move || {
            let _working = working;
            job.work(work)
        });
        let Ok(thread) = thread else {
            resume_unwind(Box::new(OutOfMemory { bytes: STACK, purpose: "the stack of a thread".into() }))
        };
        stop::wait_for(&done);
        thread.join().unwrap_or_else(|why| resume_unwind(why))
    })
}

/// The bytes left on this thread's stack, if the system can tell.
fn room() -> usize {
    thread_local! {
        /// The end of the stack, which grows down; 0 while unknown. For the first thread, finding it reads a
        /// file.
        static END: Cell<usize> = const { Cell::new(0) };
    }
    let here = 0_u8;
    let end = match END.get() {
        0 => {
            END.set(end_of_stack().max(1));
            END.get()
        }
        known => known,
    };
    (std::ptr::from_ref(&here) as usize).saturating_sub(end)
}

#[cfg(target_os = "linux")]
fn end_of_stack() -> usize {
    let mut attributes = std::mem::MaybeUninit::uninit();
    let (mut end, mut size) = (std::ptr::null_mut(), 0);
    // SAFETY: the attributes are read after the first function has set them, as 0 says, and destroyed once;
    // the others are distinct variables.
    unsafe {
        if libc::pthread_getattr_np(libc::pthread_self(), attributes.as_mut_ptr()) == 0 {
            libc::pthread_attr_getstack(attributes.as_ptr(), &raw mut end, &raw mut size);
            libc::pthread_attr_destroy(attributes.as_mut_ptr());
        }
    }
    end as usize
}

#[cfg(target_vendor = "apple")]
fn end_of_stack() -> usize {
    // SAFETY: both functions are defined for the calling thread.
    unsafe {
        let thread = libc::pthread_self();
        (libc::pthread_get_stackaddr_np(thread) as usize)
            .saturating_sub(libc::pthread_get_stacksize_np(thread))
    }
}

#[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
fn end_of_stack() -> usize {
    0
}

/// Runs `work` in a pool, whose threads its parallel iterators use; on this thread alone if the system
/// refuses threads.
pub fn run<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let Some(pool) = pool(&ITERATING, threads()) else {
        // From here on iterators treat this thread as a pool of its own. If it already is one, another is
        // refused.
        let alone = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
        std::mem::forget(alone);
        return work();
    };
    let (job, mut outcome) = (Job::current(), None);
    pool.pool.in_place_scope(|scope| {
        let (working, done) = mpsc::channel();
        let outcome = &mut outcome;
        scope.spawn(move |_| {
            let _working = working;
            *outcome = Some(job.work(work));
        });
        stop::wait_for(&done);
    });
    outcome.unwrap_or_else(|| unreachable!("work that fails unwinds"))
}

/// Does all of `work`, one piece at a time, on this thread and others.
///
/// This thread takes part: waking one thread less is faster, most of all while others are about to finish
/// their own work.
pub fn share<T: Send>(work: impl ExactSizeIterator<Item = T> + Send, act: impl Fn(T) + Sync) {
    let others = threads() - 1;
    let helpers = others.min(work.len().saturating_sub(1));
    let work = Mutex::new(work);
    let take = || work.lock().unwrap_or_else(PoisonError::into_inner).next();
    let job = &Job::current();
    let act_on_all = || {
        job.work(|| {
            while let Some(piece) = take() {
                stop::poll();
                act(piece);
            }
        });
    };
    match if helpers > 0 { pool(&HELPING, others) } else { None } {
        Some(pool) => pool.pool.in_place_scope(|scope| {
            let (working, done) = mpsc::channel::<()>();
            for _ in 0..helpers {
                let working = working.clone();
                scope.spawn(move |_| {
                    let _working = working;
                    act_on_all();
                });
            }
            drop(working);
            act_on_all();
            stop::wait_for(&done);
        }),
        None => act_on_all(),
    }
}

#[cfg(test)]
mod tests {
    use std::any::Any;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;
    use crate::stop::Stopped;

    fn work_forever() -> ! {
        loop {
            stop::poll();
            std::thread::yield_now();
        }
    }

    fn failure<R>(ask: fn() -> bool, work: impl FnOnce() -> R) -> Option<Box<dyn Any + Send>> {
        catch_unwind(AssertUnwindSafe(|| stop::until(ask, work))).err()
    }

    #[test]
    fn all_threads_stop_when_the_caller_says_so() {
        use_threads(Some(4));
        assert!(
            failure(|| true, || share(0..64, |_: i32| work_forever())).is_some_and(|why| why.is::<Stopped>())
        );
        assert!(failure(|| true, || run(|| work_forever())).is_some_and(|why| why.is::<Stopped>()));
        // The caller has no work left, and waits.
        let by_another = |i| {
            if i > 0 {
                work_forever()
            }
        };
        let pieces = [0, 1].into_iter();
        assert!(failure(|| true, || share(pieces, by_another)).is_some_and(|why| why.is::<Stopped>()));
    }

    /// Puts an array of this size on the stack.
    #[inline(never)]
    fn deep<const SIZE: usize>() -> usize {
        let array = std::hint::black_box([0_u8; SIZE]);
        std::hint::black_box(&array).len() + room().min(1)
    }

    #[test]
    fn work_has_room_in_a_thread_of_a_small_stack() {
        let in_thread = |size, ask: fn() -> bool, work: fn() -> usize| {
            let thread = std::thread::Builder::new().stack_size(size);
            let outcome = thread.spawn(move || {
                let outcome = catch_unwind(AssertUnwindSafe(|| stop::until(ask, || with_room(work))));
                (outcome.map_err(|why| why.is::<Stopped>()), room())
            });
            outcome.unwrap().join().unwrap()
        };
        let (outcome, left) = in_thread(64 << 10, || false, deep::<{ 1 << 19 }>);
        assert!(left < 64 << 10, "{left}");
        assert_eq!(outcome, Ok(Some((1 << 19) + 1)));
        assert_eq!(in_thread(64 << 10, || true, || work_forever()).0, Err(true));
        // With enough room the work stays on its thread.
        let (outcome, left) = in_thread(4 << 20, || false, room);
        assert!((3 << 20..4 << 20).contains(&outcome.unwrap().unwrap()) && left < 4 << 20, "{left}");
    }

    #[test]
    fn a_failure_in_one_thread_ends_the_others_and_reaches_the_caller() {
        use_threads(Some(4));
        let fails = |i| {
            assert!(i < 3, "the last");
            work_forever()
        };
        let why = failure(|| false, || share(0..4, fails));
        assert_eq!(why.as_ref().and_then(|why| why.downcast_ref()), Some(&"the last"));
        assert_eq!(stop::until(|| false, || run(|| 3)), Some(3));
    }
}
