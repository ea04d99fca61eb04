//! Processes items on several threads; the results are in the items' order.

use std::num::NonZero;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use errors::{Failure, INTERRUPTED};
use process::signals::stop_signals;
use signal_hook::flag;

/// A flag that SIGINT or SIGTERM sets; long work polls it.
pub fn asked_to_stop() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in stop_signals() {
        flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    Ok(stop)
}

#[must_use]
pub fn processors() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

/// Calls `work` for each item on `workers` threads. Meanwhile `look` gets the number of finished items, every 200 ms.
pub fn on_processors<T: Sync, R: Send>(
    items: &[T],
    workers: usize,
    work: impl Fn(&T) -> R + Sync,
    mut look: impl FnMut(usize),
) -> Vec<R> {
    const EVERY: Duration = Duration::from_millis(200);
    let (next, done, running) = (
        AtomicUsize::new(0),
        AtomicUsize::new(0),
        AtomicUsize::new(0),
    );
    let watcher = thread::current();
    let worker = || {
        let mut results = Vec::new();
        let _running = RunningWorker {
            running: &running,
            watcher: &watcher,
        };
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(i) else {
                return results;
            };
            results.push((i, work(item)));
            done.fetch_add(1, Ordering::Relaxed);
        }
    };
    let mut results: Vec<(usize, R)> = thread::scope(|scope| {
        let workers = workers.min(items.len());
        running.store(workers, Ordering::Relaxed);
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(worker)).collect();
        while running.load(Ordering::Acquire) > 0 {
            thread::park_timeout(EVERY);
            look(done.load(Ordering::Relaxed));
        }
        look(done.load(Ordering::Relaxed));
        workers
            .into_iter()
            .flat_map(|it| it.join().unwrap_or_else(|panic| resume_unwind(panic)))
            .collect()
    });
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Like [`on_processors`], but for fallible work. The first error cancels the rest and is returned; an interruption is
/// returned only if no other error occurred.
pub fn all_on_processors<T: Sync, R: Send>(
    items: &[T],
    workers: usize,
    work: impl Fn(&T) -> Result<R, Failure> + Sync,
    look: impl FnMut(usize),
) -> Result<Vec<R>, Failure> {
    let has_failed = AtomicBool::new(false);
    let work = |item: &T| {
        if has_failed.load(Ordering::Relaxed) {
            return Err(Failure::new(INTERRUPTED, "interrupted"));
        }
        work(item).inspect_err(|_| has_failed.store(true, Ordering::Relaxed))
    };
    let mut results = on_processors(items, workers, work, look);
    // The cause comes before the interruptions that followed from it.
    results.sort_by_key(|result| {
        result
            .as_ref()
            .err()
            .is_none_or(|failure| failure.code == INTERRUPTED)
    });
    results.into_iter().collect()
}

/// Counts a worker as ended when it is dropped, also after a panic.
struct RunningWorker<'a> {
    running: &'a AtomicUsize,
    watcher: &'a thread::Thread,
}

impl Drop for RunningWorker<'_> {
    fn drop(&mut self) {
        self.running.fetch_sub(1, Ordering::Release);
        self.watcher.unpark();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_items_for_any_number_of_workers() {
        let items: Vec<u64> = (0..100).collect();
        for workers in [1, 3, 200] {
            let mut looks = Vec::new();
            let squares =
                on_processors(&items, workers, |item| item * item, |done| looks.push(done));
            assert_eq!(
                squares,
                items.iter().map(|item| item * item).collect::<Vec<_>>()
            );
            assert!(looks.last() == Some(&100) && looks.is_sorted(), "{looks:?}");
        }
    }

    #[test]
    fn a_failure_cancels_other_work_and_comes_before_the_interruptions_that_follow() {
        let items: Vec<u64> = (0..100).collect();
        let (has_failed, begun) = (AtomicBool::new(false), AtomicUsize::new(0));
        let work = |item: &u64| {
            begun.fetch_add(1, Ordering::Relaxed);
            if *item == 1 {
                has_failed.store(true, Ordering::Relaxed);
                return Err(Failure::failed("the cause"));
            }
            while !has_failed.load(Ordering::Relaxed) {
                thread::yield_now();
            }
            // An earlier item, but not the cause.
            Err::<u64, _>(Failure::new(INTERRUPTED, "interrupted"))
        };
        assert_ne!(
            all_on_processors(&items, 2, work, |_| ()).unwrap_err().code,
            INTERRUPTED
        );
        assert!(
            begun.load(Ordering::Relaxed) <= 3,
            "{begun:?} of 100 were begun"
        );
        let interrupted = |_: &u64| Err::<u64, _>(Failure::new(INTERRUPTED, "interrupted"));
        assert_eq!(
            all_on_processors(&items, 3, interrupted, |_| ())
                .unwrap_err()
                .code,
            INTERRUPTED
        );
        assert_eq!(
            all_on_processors(&items, 3, |item| Ok(*item), |_| ()).unwrap(),
            items
        );
    }
}
