//! Tries how many CPUs the four loops should share, in a short flight for each number.

use std::time::Duration;

use errors::Failure;
use messages::realtime::LOOP_CPUS;
use process::rt::{loop_processors, loops_cpu};

use crate::floor::flight_runner::{FlightRunner, series};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    cpus: usize,
    loop_p99_us: f64,
    /// Ticks without a fresh command on time.
    late: u64,
}

/// Flies on each number of CPUs that this process has, on `first` before all others.
pub fn fly_each(first: Option<usize>, duration: Duration) -> Result<Vec<Trial>, Failure> {
    let runner = FlightRunner::new()?;
    let cpu = first.unwrap_or_else(loops_cpu);
    let fly = |cpus: usize| {
        let ms = duration.as_millis().max(2);
        let flags = format!("--log off --cpu {cpu} --loop-cpus {cpus} --duration {ms}ms");
        let report = runner.fly(&flags.split(' ').collect::<Vec<_>>())?;
        Ok(Trial {
            cpus,
            loop_p99_us: series(&report, "loop")?.p99_us,
            late: report.deadlines.not_fresh.map_or(0, |it| it.ticks),
        })
    };
    let here = |cpus: &usize| loop_processors(cpu, *cpus).len() == *cpus;
    LOOP_CPUS.into_iter().filter(here).map(fly).collect()
}

/// The number with the shortest loop at the 99th percentile of those that are late no more often than one CPU is.
pub fn recommended(trials: &[Trial]) -> usize {
    let late = trials.first().map_or(0, |one| one.late);
    let fit = trials.iter().filter(|it| it.late <= late);
    let best = fit.min_by(|a, b| a.loop_p99_us.total_cmp(&b.loop_p99_us));
    best.map_or(1, |it| it.cpus)
}

/// What is recommended, and the figures behind it.
pub fn text(trials: &[Trial]) -> String {
    let figures = trials.iter().map(|it| {
        let Trial {
            cpus,
            loop_p99_us,
            late,
        } = it;
        format!("{cpus}: loop p99 {loop_p99_us:.1} us, {late} late")
    });
    let figures: Vec<String> = figures.collect();
    format!(
        "--loop-cpus {} ({})",
        recommended(trials),
        figures.join("; ")
    )
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
            let trial = |(cpus, loop_p99_us, late)| Trial {
                cpus,
                loop_p99_us,
                late,
            };
            let trials: Vec<_> = trials.iter().copied().map(trial).collect();
            assert_eq!(recommended(&trials), best, "{}", text(&trials));
        }
    }
}
