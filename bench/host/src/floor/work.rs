//! A fixed amount of arithmetic: the stand-in for a law in a hop of the ring.

use std::hint::black_box;

use ipc::clock::now_ns;

/// Iterations of a chain of dependent multiplications, which takes as long wherever it is preempted.
///
/// A wait by the clock would hide a preemption; a fixed amount of work is prolonged by it, as a law is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    pub iterations: u64,
}

/// Iterations of a trial, and how many trials the best is taken of.
const TRIAL: Work = Work { iterations: 20_000 };
const TRIALS: u32 = 20;

impl Work {
    /// The work that takes this processor about `ns` undisturbed.
    #[must_use]
    pub fn lasting(ns: u64) -> Self {
        let trial_ns = (0..TRIALS).map(|_| TRIAL.timed()).min().unwrap_or(1).max(1);
        Self {
            iterations: ns * TRIAL.iterations / trial_ns,
        }
    }

    pub fn run(self) {
        let mut x = black_box(1.0_f64);
        for _ in 0..self.iterations {
            x = x * 0.999_999 + 1e-6;
        }
        black_box(x);
    }

    fn timed(self) -> u64 {
        let start_ns = now_ns();
        self.run();
        now_ns() - start_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_at_least_about_what_it_was_made_for() {
        let work = Work::lasting(2_000_000);
        // A processor may speed up after the calibration: half is the least that makes sense.
        assert!(work.timed() > 1_000_000, "{work:?}");
    }
}
