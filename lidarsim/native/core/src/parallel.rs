//! Work shared among threads, in a pool that is rebuilt after a fork.

use std::sync::{Arc, Mutex, PoisonError};

use arc_swap::ArcSwapOption;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// After `fork` the child has the memory of a pool and none of its threads: so a pool knows the process it is of.
struct Pool {
    process: u32,
    threads: usize,
    pool: ThreadPool,
}

static CURRENT: ArcSwapOption<Pool> = ArcSwapOption::const_empty();

/// `LIDARSIM_THREADS`, if it is a number above 0; else as many threads as this process may run at once.
pub fn threads() -> usize {
    let asked = std::env::var("LIDARSIM_THREADS").ok().and_then(|n| n.parse().ok()).filter(|&n| n > 0);
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, |n| n.get()))
}

fn pool() -> Option<Arc<Pool>> {
    let (process, threads) = (std::process::id(), threads());
    let current = CURRENT.load_full();
    if let Some(pool) = &current
        && pool.process == process
        && pool.threads == threads
    {
        return current;
    }
    let pool = ThreadPoolBuilder::new().num_threads(threads).build().ok()?;
    let old = CURRENT.swap(Some(Arc::new(Pool { process, threads, pool })));
    if old.as_ref().is_some_and(|old| old.process != process) {
        // Its threads are gone: to end it would wait for them.
        std::mem::forget(old);
        std::mem::forget(current);
    }
    CURRENT.load_full()
}

/// Runs `work` in the pool, so that the parallel iterators in it use its threads; in this thread if no pool can be had.
pub fn run<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    match pool() {
        Some(pool) => pool.pool.install(work),
        None => work(),
    }
}

/// Has all of `work` done, a piece at a time, by this thread and others of the pool.
///
/// This thread takes part: to wake one thread less is faster, above all where others are about to end work of their own.
pub fn share<T: Send>(work: impl ExactSizeIterator<Item = T> + Send, act: impl Fn(T) + Sync) {
    let helpers = threads().min(work.len()).saturating_sub(1);
    let work = Mutex::new(work);
    let take = || work.lock().unwrap_or_else(PoisonError::into_inner).next();
    let act_on_all = || {
        while let Some(piece) = take() {
            act(piece);
        }
    };
    match if helpers > 0 { pool() } else { None } {
        Some(pool) => pool.pool.in_place_scope(|scope| {
            for _ in 0..helpers {
                scope.spawn(|_| act_on_all());
            }
            act_on_all();
        }),
        None => act_on_all(),
    }
}
