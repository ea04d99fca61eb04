//! Flights and the machine's baselines, measured alternately, A B B A.

use std::time::Duration;

use analysis::host::STEAL_LIMIT_PERCENT;
use analysis::phrase::count;
use analysis::series::{Latencies, Statistics};
use analysis::statistics::{Interval, median, median_interval};
use clap::{Args as _, Command, FromArgMatches as _};
use config::Settings;
use errors::Failure;
use errors::output::say;
use experiments::progress::Progress;
use host::cpu_times::CpuTimes;
use host::floor::MachineFloor;
use process::rt::loops_cpu;
use serde::Serialize;

use super::flight_baseline;
use super::flight_runner::{FlightRunner, Flown, series};
use crate::cli::FlyArgs;

/// Compared figures: name, series of the report, quantile.
const COMPARED: [(&str, &str, f64); 7] = [
    ("wake p50", "wake.plant", 0.5),
    ("wake p99", "wake.plant", 0.99),
    ("timer p50", "timer", 0.5),
    ("timer p99", "timer", 0.99),
    ("loop p50", LOOP, 0.5),
    ("loop p99", LOOP, 0.99),
    ("loop p99.9", LOOP, 0.999),
];
const LOOP: &str = "loop";

/// A flight's value and the baseline's, measured one right after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pair {
    pub ours: f64,
    pub floor: f64,
    /// Time that the host took meanwhile from the processor of the loops [%].
    pub steal_percent: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub name: String,
    pub unit: String,
    /// In the order of measuring.
    pub pairs: Vec<Pair>,
}

impl Comparison {
    fn new(name: &str, unit: &str) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            pairs: Vec::new(),
        }
    }

    /// Pairs during which the host took little of the processor.
    pub fn undisturbed(&self) -> impl Iterator<Item = &Pair> {
        let pairs = self.pairs.iter();
        pairs.filter(|pair| pair.steal_percent <= STEAL_LIMIT_PERCENT)
    }

    fn ratios(&self) -> Vec<f64> {
        let ratio = |pair: &Pair| pair.ours / pair.floor;
        self.undisturbed().map(ratio).collect()
    }

    /// The ratio, which is that of the median pair; not a number without pairs that count.
    pub fn ratio(&self) -> f64 {
        median(&self.ratios())
    }

    /// Where the ratio lies with 95 %; none for too few pairs.
    pub fn interval(&self) -> Option<Interval> {
        median_interval(&self.ratios())
    }
}

/// The settings of a flight with these flags of `fly`; ends the process if clap refuses them.
fn settings(flags: &[&str]) -> Result<Settings, Failure> {
    let fly = FlyArgs::augment_args(Command::new("ironbird fly").no_binary_name(true));
    let fly = fly.try_get_matches_from(flags);
    let fly = fly.and_then(|matches| FlyArgs::from_arg_matches(&matches));
    let fly = fly.unwrap_or_else(|e| e.exit());
    Settings::resolve(fly.flight.course.config.as_deref(), &fly.overrides())
}

/// Flies this number of flights with these flags, and measures the machine beside each.
pub fn compare(
    runner: &FlightRunner,
    flags: &[String],
    pairs: u32,
    duration: Duration,
) -> Result<Vec<Comparison>, Failure> {
    let length = format!("{}ms", duration.as_millis());
    let mut arguments = vec!["--rt", "require", "--duration", &length];
    arguments.extend(flags.iter().map(String::as_str));
    let settings = settings(&arguments)?;
    flight_baseline::check(&settings, duration)?;
    say(&format!(
        "{}: a flight, a timer and a ring of processes, {} each: {} in all\n",
        count(pairs.into(), "pair"),
        humantime::format_duration(duration),
        humantime::format_duration(duration * 3 * pairs)
    ));
    let fly = || runner.fly(&arguments);
    let measure = |like: &Flown| {
        flight_baseline::measure(&like.report, &like.settings, duration, &runner.executable)
    };
    let mut all = COMPARED.map(|(name, ..)| Comparison::new(name, "us"));
    let mut misses = Comparison::new("misses", "per million");
    let mut progress = Progress::new(pairs.into(), "pair");
    let processor = settings.realtime()?.cpu.unwrap_or_else(loops_cpu);
    let processor = Some(processor as u64);
    let mut last: Option<Flown> = None;
    for pair in 0..pairs {
        let before = CpuTimes::read(processor);
        // A baseline that is measured first is like the flight before.
        let (flown, floor) = match last.filter(|_| !pair.is_multiple_of(2)) {
            Some(last) => {
                let floor = measure(&last)?;
                (fly()?, floor)
            }
            None => {
                let flown = fly()?;
                let floor = measure(&flown)?;
                (flown, floor)
            }
        };
        let steal_percent = before.steal_until(&CpuTimes::read(processor)).percent;
        let pair_of = |ours, floor| Pair {
            ours,
            floor,
            steal_percent,
        };
        for ((_, name, quantile), comparison) in COMPARED.iter().zip(&mut all) {
            let ours = quantile_us(series(&flown.report, name)?, *quantile);
            let beside = latencies(&floor, name).value_at_quantile(*quantile) as f64 / 1e3;
            comparison
                .pairs
                .extend(ours.map(|ours| pair_of(ours, beside)));
        }
        let [missed, late] = missed_and_late(&flown, &floor)?;
        misses.pairs.push(pair_of(missed, late));
        progress.look(u64::from(pair) + 1);
        last = Some(flown);
    }
    progress.clear();
    let all = all.into_iter().chain([misses]);
    // Too few ticks give no 99.9th percentile.
    Ok(all
        .filter(|comparison| !comparison.pairs.is_empty())
        .collect())
}

fn latencies<'a>(floor: &'a MachineFloor, series: &str) -> &'a Latencies {
    match series {
        LOOP => &floor.ring.chain,
        _ => &floor.timer.lateness,
    }
}

fn quantile_us(statistics: &Statistics, quantile: f64) -> Option<f64> {
    match quantile {
        0.5 => Some(statistics.p50_us),
        0.99 => Some(statistics.p99_us),
        _ => statistics.p999_us,
    }
}

/// The deadlines that a flight missed, and the wake-ups of a bare timer that left its loop no time [per million].
fn missed_and_late(flown: &Flown, floor: &MachineFloor) -> Result<[f64; 2], Failure> {
    let (report, timer) = (&flown.report, &floor.timer.lateness);
    let left_us = report.run.wall_period_us - series(report, LOOP)?.p50_us;
    let in_time = timer.count_between(0, (left_us.max(0.0) * 1e3) as u64);
    let per_million = |count: u64, all: u64| count as f64 * 1e6 / all.max(1) as f64;
    let ticks = report.ticks.run + report.ticks.skipped;
    Ok([
        per_million(report.deadlines.missed, ticks),
        per_million(timer.len() - in_time, timer.len()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_is_that_of_the_undisturbed_pairs() {
        let near = [1.2, 1.24, 1.26, 1.22, 1.24, 1.25, 1.21, 1.23, 1.24];
        let pair = |ratio: f64, steal_percent| Pair {
            ours: 10.0 * ratio,
            floor: 10.0,
            steal_percent,
        };
        let mut comparison = Comparison::new("x", "us");
        comparison.pairs.push(pair(100.0, 1.1));
        comparison
            .pairs
            .extend(near[..5].iter().map(|it| pair(*it, 0.0)));
        assert_eq!(comparison.interval(), None);
        comparison
            .pairs
            .extend(near[5..].iter().map(|it| pair(*it, 0.0)));
        let interval = comparison.interval().map(|it| [it.low, it.high]);
        assert_eq!((comparison.ratio(), interval), (1.24, Some([1.21, 1.25])));
    }
}
