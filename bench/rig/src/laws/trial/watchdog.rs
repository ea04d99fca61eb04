//! Ends a trial whose law does not come back.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use errors::{Failure, GATE};

use super::ROUNDS;
use crate::output::say;

/// How long a law may stay away. A tick is a thousandth of a second.
const PATIENCE: Duration = Duration::from_secs(10);

/// Hears whenever the law has come back.
#[derive(Debug)]
pub struct Watchdog(Arc<AtomicU64>);

impl Watchdog {
    /// Begins to watch: the process ends with code 3 where nothing is heard for ten seconds.
    pub fn start(law: &str) -> Result<Self, Failure> {
        let (heard, law) = (Arc::new(AtomicU64::new(0)), law.to_owned());
        let hears = Arc::clone(&heard);
        thread::Builder::new()
            .name("watchdog".into())
            .spawn(move || watch(&hears, &law))
            .map_err(|e| {
                Failure::failed(format!(
                    "the system makes no thread that watches the trial: {e}"
                ))
            })?;
        Ok(Self(heard))
    }

    pub fn hear(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

fn watch(hears: &AtomicU64, law: &str) {
    let begun = Instant::now();
    let (mut last, mut since, mut told) = (0, begun, begun);
    loop {
        thread::sleep(PATIENCE / 20);
        let heard = hears.load(Ordering::Relaxed);
        if told.elapsed() > PATIENCE {
            told = Instant::now();
            let percent = 100 * heard / ROUNDS;
            say(&format!(
                "the trial of `{law}`: {percent} % in {} s; a fast law takes one\n",
                begun.elapsed().as_secs()
            ));
        }
        if heard != last {
            (last, since) = (heard, Instant::now());
        } else if since.elapsed() > PATIENCE {
            say(&format!(
                "error: the law `{law}` did not come back within {PATIENCE:?}, after {heard} inputs\n"
            ));
            // Without what the library would run then: it may not come back either.
            plugin::exit(i32::from(GATE));
        }
    }
}
