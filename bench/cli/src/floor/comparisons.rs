//! Flights and the machine's baselines, measured alternately, A B B A.

use std::cell::RefCell;
use std::time::Duration;

use process::rt::loops_cpu;

use super::flight_baseline::work_like;
use super::flight_runner::{FlightRunner, series};
use analysis::schema::Report;
use analysis::series::{Latencies, Statistics};
use analysis::statistics::Events;
use errors::Failure;
use host::cpu_times::CpuTimes;
use host::floor::comparison::FloorComparison;
use host::floor::cyclictest;
use host::floor::ring::{self, RingRehearsal, RingSettings};
use host::floor::timer::{self, Schedule};

const PERIOD_NS: u64 = 1_000_000;
#[derive(Debug)]
pub struct MeasuringEffort {
    pub pairs: usize,
    pub duration: Duration,
    pub priority: i32,
    /// Why the own timer stood in for cyclictest.
    pub own_timer: RefCell<Option<String>>,
}

/// The quantiles of flights that are compared: name, series of the report, quantile, place in [`floors`].
const COMPARED: [(&str, &str, f64, usize); 10] = [
    ("wake p50", "wake.plant", 0.5, 0),
    ("wake p99", "wake.plant", 0.99, 0),
    ("timer p50", "timer", 0.5, 0),
    ("timer p99", "timer", 0.99, 0),
    ("loop p50", "loop", 0.5, 1),
    ("loop p99", "loop", 0.99, 1),
    ("loop p99.9", "loop", 0.999, 1),
    ("loop p50, ring with warm-up runs", "loop", 0.5, 2),
    ("loop p99, ring with warm-up runs", "loop", 0.99, 2),
    ("loop p99.9, ring with warm-up runs", "loop", 0.999, 2),
];

/// Wake-ups, loop latency and misses of flights, compared with cyclictest and a futex ring with the same computing
/// time. The flight is measured first and last in turns.
pub fn compare(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let mut all = COMPARED.map(|(name, ..)| FloorComparison::ratio(name, "us"));
    let mut misses = FloorComparison::events("misses");
    // Floors that are measured first imitate the flight before.
    let newest: RefCell<Option<Report>> = RefCell::new(None);
    let fly = || -> Result<(), Failure> {
        *newest.borrow_mut() = Some(effort.fly(runner)?);
        Ok(())
    };
    for pair in 0..effort.pairs {
        let floors = || {
            let newest = newest.borrow();
            floors(runner, effort, newest.as_ref())
        };
        let ((), floors, steal_percent) = in_turns(pair, fly, floors)?;
        let report = newest.borrow();
        let Some(report) = report.as_ref() else {
            continue;
        };
        for ((_, name, quantile, place), comparison) in COMPARED.iter().zip(&mut all) {
            let ours = quantile_us(series(report, name)?, *quantile);
            let floor = floors[*place].as_ref();
            let floor = floor.map(|it| it.value_at_quantile(*quantile) as f64 / 1e3);
            if let (Some(ours), Some(floor)) = (ours, floor) {
                comparison.take(ours, floor, steal_percent);
            }
        }
        if let Some(bare) = &floors[0] {
            let [missed, late] = missed_and_late(report, bare)?;
            misses.take_events(missed, late, steal_percent);
        }
    }
    let mut all = Vec::from(all);
    all.push(misses);
    // Too few ticks give no 99.9th percentile.
    all.retain(|comparison| comparison.measured().0 > 0);
    Ok(all)
}

fn rehearsal_of(flown: &Report) -> Option<RingRehearsal> {
    let us = [flown.lead.median_us, flown.lead.rehearsal_us];
    let [lead_ns, needs_ns] = us.map(|us| (us * 1e3) as u64);
    (needs_ns > 0).then_some(RingRehearsal { lead_ns, needs_ns })
}

/// The deadlines that a flight missed, and the wake-ups of a bare timer that left its loop no time.
fn missed_and_late(report: &Report, bare: &Latencies) -> Result<[Events; 2], Failure> {
    let loop_ns = (series(report, "loop")?.p50_us * 1e3) as u64;
    let in_time = bare.count_between(0, PERIOD_NS.saturating_sub(loop_ns));
    let missed = Events {
        count: report.deadlines.missed,
        exposure: report.ticks.run + report.ticks.skipped,
    };
    let late = Events {
        count: bare.len() - in_time,
        exposure: bare.len(),
    };
    Ok([missed, late])
}

fn quantile_us(statistics: &Statistics, quantile: f64) -> Option<f64> {
    match quantile {
        0.5 => Some(statistics.p50_us),
        0.99 => Some(statistics.p99_us),
        _ => statistics.p999_us,
    }
}

/// Wake-ups of cyclictest, chains of a ring that computes as long as the laws of a flight, and of one that has warm-up
/// runs like that flight, too.
fn floors(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
    like: Option<&Report>,
) -> Result<[Option<Latencies>; 3], Failure> {
    let schedule = effort.schedule();
    let bare = effort.bare_timer()?;
    let Some(like) = like else {
        return Ok([Some(bare), None, None]);
    };
    let work = work_like(like)?;
    let ring = |rehearsal| {
        let settings = RingSettings {
            schedule: schedule.clone(),
            work: work.clone(),
            rehearsal,
        };
        ring::measure(&settings, &runner.executable).map(|floor| floor.chain)
    };
    let rehearsed = rehearsal_of(like).map(|it| ring(Some(it))).transpose()?;
    Ok([Some(bare), Some(ring(None)?), rehearsed])
}

impl MeasuringEffort {
    fn schedule(&self) -> Schedule {
        Schedule {
            period_ns: PERIOD_NS,
            duration: self.duration,
            cpu: None,
            priority: self.priority,
        }
    }

    /// How late a thread wakes on a timer, of cyclictest or, where that cannot run, of our own [ns].
    fn bare_timer(&self) -> Result<Latencies, Failure> {
        let schedule = self.schedule();
        cyclictest::measure(&schedule).or_else(|e| {
            self.own_timer.replace(Some(e.to_string()));
            Ok(timer::measure(&schedule)?.lateness)
        })
    }

    fn fly(&self, runner: &FlightRunner) -> Result<Report, Failure> {
        let duration = format!("{}ms", self.duration.as_millis());
        runner.fly(&["--rt", "require", "--duration", &duration])
    }
}

/// Measures the rig and the baseline, the baseline first in every other pair; also the share of the loops' processor that
/// the hypervisor took meanwhile [%].
fn in_turns<T, F>(
    pair: usize,
    ours: impl FnOnce() -> Result<T, Failure>,
    floor: impl FnOnce() -> Result<F, Failure>,
) -> Result<(T, F, f64), Failure> {
    let processor = Some(loops_cpu() as u64);
    let before = CpuTimes::read(processor);
    let (ours, floor) = if pair.is_multiple_of(2) {
        let ours = ours()?;
        (ours, floor()?)
    } else {
        let floor = floor()?;
        (ours()?, floor)
    };
    let steal = before.steal_until(&CpuTimes::read(processor));
    Ok((ours, floor, steal.percent))
}
