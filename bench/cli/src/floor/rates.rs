//! The loop at several rates: what it misses, how long it takes, and what it costs.

use process::rt::loops_cpu;
use serde::{Deserialize, Serialize};

use super::comparison_sets::{MeasuringEffort, in_turns, missed_and_late};
use super::flight_runner::{FlightRunner, series};
use analysis::host::STEAL_LIMIT_PERCENT;
use analysis::schema::Report;
use analysis::statistics::median;
use errors::Failure;
use host::floor::comparison::FloorComparison;
use host::floor::cyclictest;
use messages::role::{Role, STAGES};
use render::document::{Cell, Table, row};

const RATES_KHZ: [u64; 4] = [1, 2, 4, 8];
/// From this rate on the misses have a goal: at most so many times the bare timer's.
const FAST_KHZ: u64 = 4;
const MISSES_GOAL: f64 = 2.0;
/// Processor time that a tick of the four loops may take, and the rate at which it may [us, kHz].
const LOOPS_GOAL: (f64, u64) = (45.0, 8);

/// The figures of a flight [us]: the loop's latency, then the processor time per tick.
const FIGURES: [&str; 8] = [
    "loop p50", "loop p99", "loops", "plant", "outer", "inner", "mixer", "recorder",
];

/// The flights of a rate that the host did not disturb.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RateRow {
    khz: u64,
    missed_per_million: f64,
    /// Wake-ups of cyclictest that left the loop no time.
    late_per_million: f64,
    /// Medians of [`FIGURES`].
    figures_us: Vec<f64>,
}

/// Flies at each rate in turn, beside cyclictest at the same rate.
pub fn rates(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<(Vec<FloorComparison>, Vec<RateRow>), Failure> {
    let mut rates = RATES_KHZ.map(|khz| {
        let misses = FloorComparison::events(&format!("misses, {khz} kHz"), MISSES_GOAL);
        let loops = FloorComparison::ratio(&format!("processor time, {khz} kHz"), "us", 1.0);
        (khz, misses, loops, Vec::new())
    });
    for pair in 0..effort.pairs {
        for (khz, misses, loops, flights) in &mut rates {
            let (period_ns, rate) = (1_000_000 / *khz, format!("{khz}k"));
            let (report, bare, steal_percent) = in_turns(
                pair,
                Some(loops_cpu() as u64),
                || effort.fly(runner, &["--rate", &rate]),
                || cyclictest::measure(&effort.schedule(period_ns)),
            )?;
            let figures = figures_us(&report)?;
            let [missed, late] = missed_and_late(&report, &bare, period_ns)?;
            misses.take_events(missed, late, steal_percent);
            loops.take(figures[2], LOOPS_GOAL.0, steal_percent);
            if steal_percent <= STEAL_LIMIT_PERCENT {
                flights.push(figures);
            }
        }
    }
    let with_flights = rates.iter().filter(|(.., flights)| !flights.is_empty());
    let rows = with_flights.map(|(khz, misses, _, flights)| {
        let [missed_per_million, late_per_million] = misses.sides();
        let figures = (0..FIGURES.len()).map(|i| flights.iter().map(|it| it[i]).collect());
        RateRow {
            khz: *khz,
            missed_per_million,
            late_per_million,
            figures_us: figures.map(|all: Vec<f64>| median(&all)).collect(),
        }
    });
    let rows = rows.collect();
    let with_goal = rates.into_iter().flat_map(|(khz, misses, loops, _)| {
        let misses = (khz >= FAST_KHZ).then_some(misses);
        let loops = (khz == LOOPS_GOAL.1).then_some(loops);
        misses.into_iter().chain(loops)
    });
    Ok((with_goal.collect(), rows))
}

fn figures_us(report: &Report) -> Result<Vec<f64>, Failure> {
    let cpu_us = |role: Role| {
        let section = report.roles.get(role.name());
        let usage = section.and_then(|it| it.usage.as_ref());
        let unknown = || Failure::failed(format!("the flight's report lacks the usage of {role}"));
        Ok(usage.ok_or_else(unknown)?.cpu_per_tick_us)
    };
    let loops: Vec<f64> = STAGES
        .into_iter()
        .map(cpu_us)
        .collect::<Result<_, Failure>>()?;
    let chain = series(report, "loop")?;
    let latency = [chain.p50_us, chain.p99_us, loops.iter().sum()];
    let recorder = report.recorder.cpu_percent / 100.0 * report.run.wall_period_us;
    Ok([&latency[..], &loops, &[recorder]].concat())
}

pub fn table(rows: &[RateRow]) -> Table {
    let columns = ["rate [kHz]", "misses/million", "misses/s", "bare timer/s"];
    let cells = |it: &RateRow| -> Vec<Cell> {
        // A million ticks take so many seconds.
        let million_s = 1e3 / it.khz as f64;
        let [missed, late] = [it.missed_per_million, it.late_per_million];
        let counts = [missed, missed / million_s, late / million_s];
        let numbers = counts.iter().chain(&it.figures_us);
        row([&it.khz])
            .into_iter()
            .chain(numbers.map(|it| format!("{it:.1}").into()))
            .collect()
    };
    Table::new(columns.into_iter().chain(FIGURES), rows.iter().map(cells))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_shows_counts_per_second_too() {
        let row = RateRow {
            khz: 4,
            missed_per_million: 500.0,
            late_per_million: 1000.0,
            figures_us: (1..=FIGURES.len()).map(|it| it as f64).collect(),
        };
        let markdown = table(&[row]).markdown();
        let expected = "| 4 | 500.0 | 2.0 | 4.0 | 1.0 | 2.0 | 3.0 | 4.0 | 5.0 | 6.0 | 7.0 | 8.0 |";
        assert!(markdown.contains(expected), "{markdown}");
    }
}
