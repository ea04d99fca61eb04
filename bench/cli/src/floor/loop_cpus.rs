//! Tries how many CPUs the four loops should share, and how many channels fly, in a short flight for each number.

use std::time::Duration;

use errors::Failure;
use messages::realtime::LOOP_CPUS;
use messages::role::MOST_CHANNELS;
use process::rt::{loop_processors, loops_cpu};

use crate::floor::flight_runner::{FlightRunner, series};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    number: usize,
    loop_p99_us: f64,
    /// Ticks without a fresh command on time.
    late: u64,
}

/// The flights of increasing numbers, up to the first one that failed, with why.
pub type Trials = (Vec<Trial>, Option<Failure>);

/// Flies on each number of CPUs that this process has, on `first` before all others.
pub fn fly_each(first: Option<usize>, duration: Duration) -> Trials {
    let cpu = first.unwrap_or_else(loops_cpu);
    let here = |cpus: &usize| loop_processors(cpu, *cpus).len() == *cpus;
    let numbers = LOOP_CPUS.into_iter().filter(here);
    fly_with("--loop-cpus", numbers, cpu, duration)
}

pub fn fly_channels(first: Option<usize>, duration: Duration) -> Trials {
    let cpu = first.unwrap_or_else(loops_cpu);
    fly_with("--channels", 1..=MOST_CHANNELS, cpu, duration)
}

fn fly_with(
    flag: &str,
    mut numbers: impl Iterator<Item = usize>,
    cpu: usize,
    duration: Duration,
) -> Trials {
    let mut trials = Vec::new();
    let flown = FlightRunner::new().and_then(|runner| {
        numbers.try_for_each(|number| {
            let ms = duration.as_millis().max(2);
            let flags = format!("--log off --cpu {cpu} {flag} {number} --duration {ms}ms");
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
pub fn recommended(trials: &[Trial]) -> usize {
    let late = trials.first().map_or(0, |one| one.late);
    let fit = trials.iter().filter(|it| it.late <= late);
    let best = fit.min_by(|a, b| a.loop_p99_us.total_cmp(&b.loop_p99_us));
    best.map_or(1, |it| it.number)
}

pub fn text(trials: &[Trial]) -> String {
    format!("--loop-cpus {} ({})", recommended(trials), figures(trials))
}

pub fn figures(trials: &[Trial]) -> String {
    let figures = trials.iter().map(|it| {
        let (number, loop_p99_us, late) = (it.number, it.loop_p99_us, it.late);
        format!("{number}: loop p99 {loop_p99_us:.1} us, {late} late")
    });
    figures.collect::<Vec<_>>().join("; ")
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
