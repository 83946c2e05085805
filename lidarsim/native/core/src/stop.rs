//! Jobs that their caller may stop.
//!
//! The caller of a job is asked now and then whether to go on, in its own thread, since only there does
//! Python run handlers of signals. Where the answer is no, every thread of the job unwinds from the next
//! place that polls, as nothing in the middle of a cast has a result to give back.

use std::cell::{Cell, RefCell};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// What a stopped job unwinds with.
#[derive(Debug)]
pub struct Stopped;

/// How long the caller is left alone between two questions.
const PERIOD: Duration = Duration::from_millis(50);

/// Work of one caller, on however many threads.
#[derive(Debug, Default)]
pub struct Job {
    is_stopped: AtomicBool,
}

/// What asks the caller whether to stop, and when next.
#[derive(Clone, Copy)]
struct Caller {
    ask: fn() -> bool,
    next: Instant,
}

thread_local! {
    /// The job that this thread works for.
    static JOB: RefCell<Option<Arc<Job>>> = const { RefCell::new(None) };
    /// In the thread of the caller alone.
    static CALLER: Cell<Option<Caller>> = const { Cell::new(None) };
}

impl Job {
    /// That of this thread.
    pub fn current() -> Arc<Job> {
        JOB.with_borrow(Option::clone).unwrap_or_default()
    }

    /// Works for this job. If the work fails, the others of the job may stop too.
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

    /// As [`poll`], in a thread that may not know of the job.
    #[inline]
    pub fn poll(&self) {
        if self.is_stopped.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Stopped));
        }
    }
}

/// Does work that stops, and then has no outcome, once `ask` says so. That is called in this thread.
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

/// Unwinds if the job of this thread is stopped, after asking its caller if this is his thread and it is
/// time.
#[inline(never)]
pub fn poll() {
    ask_in_time();
    JOB.with_borrow(|job| job.as_deref().map(Job::poll));
}

/// Waits in the thread of the caller until all that the other end is held by is done.
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
        // Nobody is asked that soon; and work that ends unaware of the answer has no outcome either.
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
