//! Jobs that their caller may stop.
//!
//! The caller of a job is asked periodically whether to continue, on its own thread, since only there does
//! Python run signal handlers. If the answer is no, every thread of the job unwinds at its next poll, as an
//! incomplete cast has no result.

use std::cell::{Cell, RefCell};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// The payload of the panic of a stopped job.
#[derive(Debug)]
pub struct Stopped;

/// The time between two questions to the caller.
const PERIOD: Duration = Duration::from_millis(50);

/// Work for one caller, on any number of threads.
#[derive(Debug, Default)]
pub struct Job {
    is_stopped: AtomicBool,
}

/// The callback that asks the caller whether to stop, and the time of the next question.
#[derive(Clone, Copy)]
struct Caller {
    ask: fn() -> bool,
    next: Instant,
}

thread_local! {
    /// The job of this thread.
    static JOB: RefCell<Option<Arc<Job>>> = const { RefCell::new(None) };
    /// Set only on the caller's thread.
    static CALLER: Cell<Option<Caller>> = const { Cell::new(None) };
}

impl Job {
    /// The job of this thread.
    pub fn current() -> Arc<Job> {
        JOB.with_borrow(Option::clone).unwrap_or_default()
    }

    /// Does work of this job. If it panics, other threads of the job may stop, too.
    pub fn work<R>(self: &Arc<Self>, work: impl FnOnce() -> R) -> R {
        struct Restore<'a>(&'a Job, Option<Arc<Job>>);
        impl Drop for Restore<'_> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.is_stopped.store(true, Ordering::Relaxed);
                }
                JOB.set(self.1.take());
            }
        }
        let _restore = Restore(self, JOB.replace(Some(self.clone())));
        work()
    }

    /// As [`poll`], on a thread that may not know of the job.
    #[inline]
    pub fn poll(&self) {
        if self.is_stopped.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Stopped));
        }
    }
}

/// Does work that stops without a result once `ask` returns true. `ask` is called on this thread.
pub fn until<R>(ask: fn() -> bool, work: impl FnOnce() -> R) -> Option<R> {
    struct Restore(Option<Caller>);
    impl Drop for Restore {
        fn drop(&mut self) {
            CALLER.set(self.0);
        }
    }
    let _restore = Restore(CALLER.replace(Some(Caller { ask, next: Instant::now() + PERIOD })));
    let job = Arc::new(Job::default());
    let outcome = job.work(work);
    (!job.is_stopped.load(Ordering::Relaxed)).then_some(outcome)
}

/// Unwinds if this thread's job is stopped; first asks the caller, if on the caller's thread and when due.
#[inline(never)]
pub fn poll() {
    ask_in_time();
    JOB.with_borrow(|job| job.as_deref().map(Job::poll));
}

/// Waits on the caller's thread until all senders are dropped.
pub fn wait_for(done: &Receiver<()>) {
    while done.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
        ask_in_time();
    }
}

fn ask_in_time() {
    let Some(Caller { ask, next }) = CALLER.get() else { return };
    if Instant::now() < next {
        return;
    }
    if ask() {
        JOB.with_borrow(|job| job.as_deref().map(|job| job.is_stopped.store(true, Ordering::Relaxed)));
    }
    CALLER.set(Some(Caller { ask, next: Instant::now() + PERIOD }));
}

#[cfg(test)]
mod tests {
    use std::panic::catch_unwind;

    use super::*;

    fn work_forever() {
        loop {
            poll();
        }
    }

    #[test]
    fn a_job_stops_when_its_caller_says_so_and_not_before() {
        assert_eq!(until(|| false, || 7), Some(7));
        let stopped = catch_unwind(|| until(|| true, work_forever)).unwrap_err();
        assert!(stopped.is::<Stopped>());
        // Nobody is asked that soon. Work that ends unaware of a stop has no result either.
        assert_eq!(until(|| true, poll), Some(()));
        let unaware = || {
            std::thread::sleep(2 * PERIOD);
            ask_in_time();
        };
        assert_eq!(until(|| true, unaware), None);
    }

    #[test]
    fn a_job_within_a_job_stops_alone() {
        let both = || {
            let inner = catch_unwind(|| until(|| true, work_forever));
            poll();
            inner.is_err()
        };
        assert_eq!(until(|| false, both), Some(true));
        assert!(CALLER.get().is_none() && JOB.with_borrow(Option::is_none));
    }
}
