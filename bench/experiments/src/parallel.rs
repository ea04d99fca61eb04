//! Processes items on several threads; the results are in the items' order.

use std::num::NonZero;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use config::Settings;
use errors::{Failure, INTERRUPTED};

pub fn check_stop(stop: &AtomicBool) -> Result<(), Failure> {
    match stop.load(Ordering::Relaxed) {
        true => Err(Failure::new(INTERRUPTED, "interrupted")),
        false => Ok(()),
    }
}

/// Flights at once: as many as asked for, else one per processor. A firmware flies alone: its ports are those of one flight.
pub fn jobs<'a>(
    asked: Option<usize>,
    flown: impl IntoIterator<Item = &'a Settings>,
) -> Result<usize, Failure> {
    for settings in flown {
        let inner = settings.laws()?[1].name;
        if firmware::is_program(inner) {
            return match asked {
                None | Some(1) => Ok(1),
                Some(jobs) => Err(Failure::usage(format!(
                    "--jobs {jobs}: `{inner}` flies one flight at a time, because its ports are those of one flight"
                ))
                .help("leave --jobs out")),
            };
        }
    }
    Ok(asked.unwrap_or_else(processors))
}

pub fn processors() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

/// Calls `work` for each item on `workers` threads. Meanwhile `look` gets the number of finished items, whenever one is
/// finished and at least every 200 ms. The first error cancels the rest and is returned; an interruption is returned only
/// if no other error occurred.
pub fn on_processors<T: Sync, R: Send>(
    items: &[T],
    workers: usize,
    work: impl Fn(&T) -> Result<R, Failure> + Sync,
    mut look: impl FnMut(usize),
) -> Result<Vec<R>, Failure> {
    const EVERY: Duration = Duration::from_millis(200);
    let next = &AtomicUsize::new(0);
    let has_failed = AtomicBool::new(false);
    let work = &|item: &T| {
        check_stop(&has_failed)?;
        work(item).inspect_err(|_| has_failed.store(true, Ordering::Relaxed))
    };
    let (sender, receiver) = mpsc::channel();
    let mut results = Vec::new();
    thread::scope(|scope| {
        for _ in 0..workers.min(items.len()) {
            let sender = sender.clone();
            scope.spawn(move || {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(i) else {
                        return;
                    };
                    // The receiver lives as long as the workers.
                    let _ = sender.send((i, work(item)));
                }
            });
        }
        drop(sender);
        loop {
            match receiver.recv_timeout(EVERY) {
                Ok(result) => results.push(result),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            look(results.len());
        }
    });
    // The cause comes before the interruptions that followed from it.
    let is_no_cause = |result: &Result<R, Failure>| match result {
        Ok(_) => true,
        Err(failure) => failure.code == INTERRUPTED,
    };
    results.sort_by_key(|(i, result)| (is_no_cause(result), *i));
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_cancels_other_work_and_comes_before_the_interruptions_that_follow() {
        let items: Vec<u64> = (0..100).collect();
        let (has_failed, begun) = (AtomicBool::new(false), AtomicUsize::new(0));
        let interrupted = |_: &u64| Err::<u64, _>(Failure::new(INTERRUPTED, "interrupted"));
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
            interrupted(item)
        };
        let code = |results: Result<Vec<u64>, Failure>| results.err().map(|e| e.code);
        let failed = on_processors(&items, 2, work, |_| ());
        assert_eq!(code(failed), Some(errors::FAILED));
        assert!(begun.into_inner() <= 3, "of 100 were begun");
        let stopped = on_processors(&items, 3, interrupted, |_| ());
        assert_eq!(code(stopped), Some(INTERRUPTED));
        let whole = on_processors(&items, 3, |item| Ok(*item), |_| ());
        assert_eq!(whole.unwrap(), items);
    }
}
