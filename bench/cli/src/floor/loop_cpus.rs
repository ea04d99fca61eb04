//! Tries how many CPUs the four loops should share, in a short flight for each number.

use std::time::Duration;

use errors::Failure;
use messages::realtime::LOOP_CPUS;
use process::rt::{loop_processors, loops_cpu};

use crate::floor::flight_runner::{FlightRunner, series};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    pub number: usize,
    pub loop_p99_us: f64,
    /// Ticks without a fresh command on time.
    pub late: u64,
}

/// The flights of increasing numbers, up to the first one that failed, with why.
pub type Trials = (Vec<Trial>, Option<Failure>);

/// Flies on each number of CPUs that this process has, on `first` before all others.
pub fn fly_each(first: Option<usize>, duration: Duration) -> Trials {
    let cpu = first.unwrap_or_else(loops_cpu);
    let here = |cpus: &usize| loop_processors(cpu, *cpus).len() == *cpus;
    let ms = duration.as_millis().max(2);
    let mut trials = Vec::new();
    let flown = FlightRunner::new().and_then(|runner| {
        LOOP_CPUS.into_iter().filter(here).try_for_each(|number| {
            let flags = format!("--log off --cpu {cpu} --loop-cpus {number} --duration {ms}ms");
            let report = runner.fly(&flags.split(' ').collect::<Vec<_>>())?.report;
            trials.push(Trial {
                number,
                loop_p99_us: series(&report, "loop")?.p99_us,
                late: report.deadlines.not_fresh.map_or(0, |it| it.ticks),
            });
            Ok(())
        })
    });
    (trials, flown.err())
}

/// The number with the shortest loop at the 99th percentile of those that are late no more often than one CPU is.
fn recommended(trials: &[Trial]) -> usize {
    let late = trials.first().map_or(0, |one| one.late);
    let fit = trials.iter().filter(|it| it.late <= late);
    let best = fit.min_by(|a, b| a.loop_p99_us.total_cmp(&b.loop_p99_us));
    best.map_or(1, |it| it.number)
}

pub fn text(trials: &[Trial]) -> String {
    let figures = trials.iter().map(|it| {
        let (number, loop_p99_us, late) = (it.number, it.loop_p99_us, it.late);
        format!("{number}: loop p99 {loop_p99_us:.1} us, {late} late")
    });
    let figures = figures.collect::<Vec<_>>().join("; ");
    format!("--loop-cpus {} ({figures})", recommended(trials))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fastest_is_recommended_that_is_not_late_more_often_than_one_cpu() {
        for (trials, best) in [
            (&[(1, 20.0, 0)][..], 1),
            (&[(1, 20.0, 0), (2, 9.0, 0)], 2),
            (&[(1, 20.0, 0), (2, 9.0, 1)], 1),
            (&[(1, 20.0, 2), (2, 21.0, 0)], 1),
            (&[(1, 20.0, 0), (2, 9.0, 0), (4, 2.0, 0)], 4),
            (&[(1, 20.0, 1), (2, 9.0, 1), (4, 2.0, 3)], 2),
        ] {
            let trial = |(number, loop_p99_us, late)| Trial {
                number,
                loop_p99_us,
                late,
            };
            let trials: Vec<_> = trials.iter().copied().map(trial).collect();
            assert_eq!(recommended(&trials), best, "{}", text(&trials));
        }
    }
}
