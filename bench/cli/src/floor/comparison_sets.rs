//! The sets of comparisons. Each measures the rig and its baseline alternately, A B A B.

use std::cell::RefCell;
use std::ffi::OsStr;
use std::hint::black_box;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use process::rt::loops_cpu;
use rustix::process::{Pid, Signal, kill_process};

use super::flight_baseline::work_like;
use super::flight_runner::{FlightRunner, command_end, series};
use analysis::schema::Report;
use analysis::series::Statistics;
use analysis::statistics::Events;
use config::Settings;
use errors::Failure;
use host::cpu_times::CpuTimes;
use host::floor::comparison::FloorComparison;
use host::floor::cyclictest;
use host::floor::ring::{self, RingRehearsal, RingSettings, Work};
use host::floor::timer::Schedule;
use scalar::timing;
use sim::simulator::Simulator;

const PERIOD_NS: u64 = 1_000_000;
/// How long a process of the polling ring reads its event in a loop: longer than a lead, so that the warm-up run before a tick
/// has it awake for that tick [ns].
const POLLS_NS: u64 = 300_000;
/// Ticks per side when timing laws: long enough for the kernel's count of stolen time.
const TIMED_TICKS: u64 = 200_000;
/// Seconds of flight to replay per requested second of measurement. A replay runs hundreds of times faster than real
/// time, so it ends earlier; a longer log would fill the disk.
const FLOWN_AGAIN: u64 = 5;

#[derive(Clone, Copy, Debug)]
pub struct MeasuringEffort {
    pub pairs: usize,
    pub duration: Duration,
    pub priority: i32,
}

#[derive(Debug)]
pub struct Stress(Child);

/// The load: one worker per CPU, one that maps memory, one that writes files.
const STRESS: [&str; 6] = ["--cpu", "0", "--vm", "1", "--hdd", "1"];
const STRESS_BEGINS: Duration = Duration::from_secs(1);

impl Stress {
    pub fn is_installed() -> bool {
        Command::new("stress-ng").arg("--version").output().is_ok()
    }

    pub fn start(runner: &FlightRunner) -> Result<Self, Failure> {
        let mut command = Command::new("stress-ng");
        command.args(STRESS).arg("--temp-path");
        command.arg(runner.directory.path()).stdin(Stdio::null());
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let failed = |e| Failure::failed(format!("cannot start stress-ng: {e}"));
        let mut load = Self(child.map_err(failed)?);
        sleep(STRESS_BEGINS);
        load.check()?;
        Ok(load)
    }

    pub fn check(&mut self) -> Result<(), Failure> {
        let stress = STRESS.join(" ");
        match self.0.try_wait() {
            Ok(None) => Ok(()),
            Ok(Some(status)) => Err(Failure::failed(format!(
                "stress-ng has ended with {status}: nothing loads the machine"
            ))
            .help(format!("see what it says: stress-ng {stress} --timeout 5"))),
            Err(e) => Err(Failure::failed(format!("cannot look at stress-ng: {e}"))),
        }
    }
}

impl Drop for Stress {
    fn drop(&mut self) {
        if let Some(pid) = Pid::from_raw(self.0.id().cast_signed()) {
            // It then ends its workers.
            let _ = kill_process(pid, Signal::TERM);
        }
        let _ = self.0.wait();
    }
}

/// The quantiles of flights that are compared: name, goal, series of the report, quantile, place in [`floors`].
const COMPARED: [(&str, f64, &str, f64, usize); 10] = [
    ("wake p50", 0.02, "wake.plant", 0.5, 0),
    ("wake p99", 0.3, "wake.plant", 0.99, 0),
    ("timer p50", 1.05, "timer", 0.5, 0),
    ("timer p99", 1.1, "timer", 0.99, 0),
    ("loop p50", 0.8, "loop", 0.5, 1),
    ("loop p99", 1.0, "loop", 0.99, 1),
    ("loop p99.9", 1.2, "loop", 0.999, 1),
    ("loop p50, ring with warm-up runs", 1.25, "loop", 0.5, 2),
    ("loop p99, ring with warm-up runs", 1.25, "loop", 0.99, 2),
    ("loop p99.9, ring with warm-up runs", 1.5, "loop", 0.999, 2),
];

/// Wake-ups, loop latency and misses of flights, compared with cyclictest and a futex ring with the same computing
/// time. The flight is measured first and last in turns.
pub fn flights(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
    mut load: Option<&mut Stress>,
) -> Result<Vec<FloorComparison>, Failure> {
    let under = if load.is_some() { ", under load" } else { "" };
    let mut all = COMPARED
        .map(|(name, goal, ..)| FloorComparison::ratio(&format!("{name}{under}"), "us", goal));
    let mut misses = FloorComparison::events(&format!("misses{under}"), 1.0);
    // Floors that are measured first imitate the flight before.
    let newest: RefCell<Option<Report>> = RefCell::new(None);
    let fly = || -> Result<(), Failure> {
        *newest.borrow_mut() = Some(effort.fly(runner, &[])?);
        Ok(())
    };
    let with_ring = load.is_none();
    for pair in 0..effort.pairs {
        let floors = || {
            let newest = newest.borrow();
            floors(runner, effort, newest.as_ref().filter(|_| with_ring))
        };
        let cpu = Some(loops_cpu() as u64);
        let ((), floors, steal_percent) = in_turns(pair, cpu, fly, floors)?;
        if let Some(load) = &mut load {
            load.check()?;
        }
        let report = newest.borrow();
        let Some(report) = report.as_ref() else {
            continue;
        };
        for ((_, _, name, quantile, place), comparison) in COMPARED.iter().zip(&mut all) {
            let ours = quantile_us(series(report, name)?, *quantile);
            let floor = floors[*place].as_ref();
            let floor = floor.map(|it| it.value_at_quantile(*quantile) as f64 / 1e3);
            if let (Some(ours), Some(floor)) = (ours, floor) {
                comparison.take(ours, floor, steal_percent);
            }
        }
        if let Some(bare) = &floors[0] {
            let [missed, late] = missed_and_late(report, bare, PERIOD_NS)?;
            misses.take_events(missed, late, steal_percent);
        }
    }
    let mut all = Vec::from(all);
    all.push(misses);
    // Under load there is no ring, and too few ticks give no 99.9th percentile.
    all.retain(|comparison| comparison.measured().0 > 0);
    Ok(all)
}

/// Flights on two processors compared with flights on one, with a ring on one that has warm-up runs, and with a ring of
/// two processes that read their events in a loop.
pub fn cpus(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let mut all = [
        ("loop p50, 2 CPUs against a ring on 1", 0.6, 0.5),
        ("loop p99, 2 CPUs against a ring on 1", 1.0, 0.99),
        ("loop p50, 2 CPUs against a polling ring on 2", 1.5, 0.5),
    ]
    .map(|(name, goal, quantile)| (FloorComparison::ratio(name, "us", goal), quantile));
    let mut misses = FloorComparison::events("misses, 2 CPUs against 1", 1.0);
    let fly = |cpus| effort.fly(runner, &["--loop-cpus", cpus]);
    let baselines = || {
        let one = fly("1")?;
        let work = work_like(&one)?;
        let ring = |work, polls_ns| {
            let settings = RingSettings {
                schedule: effort.schedule(PERIOD_NS),
                work,
                rehearsal: rehearsal_of(&one),
                by_eventfd: false,
                polls_ns,
            };
            ring::measure(&settings, &runner.executable).map(|floor| floor.chain)
        };
        let halves = [[0, 2], [1, 3]].map(|[a, b]| Work {
            iterations: (work[a].iterations + work[b].iterations) / 2,
        });
        let rings = [ring(work, 0)?, ring(halves.to_vec(), POLLS_NS)?];
        Ok((one, rings))
    };
    for pair in 0..effort.pairs {
        let (two, (one, rings), steal_percent) = in_turns(pair, None, || fly("2"), baselines)?;
        for (place, (comparison, quantile)) in all.iter_mut().enumerate() {
            let ring = &rings[place / 2];
            if let Some(ours) = quantile_us(series(&two, "loop")?, *quantile) {
                let floor = ring.value_at_quantile(*quantile) as f64 / 1e3;
                comparison.take(ours, floor, steal_percent);
            }
        }
        let [two, one] = [two, one].map(|report| of_ticks(&report, report.deadlines.missed));
        misses.take_events(two, one, steal_percent);
    }
    let all = all.into_iter().map(|(comparison, _)| comparison);
    Ok(all.chain([misses]).collect())
}

/// Flights with two channels compared with flights with one, beside one channel compared with itself.
pub fn channels(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let ratio = |name: &str| FloorComparison::ratio(name, "us", 1.05);
    let mut all = [
        (ratio("loop p50, 2 channels against 1"), 0.5),
        (ratio("loop p99, 2 channels against 1"), 0.99),
        (ratio("loop p50, 1 channel against itself"), 0.5),
        (ratio("loop p99, 1 channel against itself"), 0.99),
    ];
    let mut not_fresh = FloorComparison::events("ticks not fresh, 2 channels against 1", 1.0);
    let fly = |channels| effort.fly(runner, &["--channels", channels]);
    let counted = |report: &Report| {
        let not_fresh = report.deadlines.not_fresh.unwrap_or_default();
        of_ticks(report, not_fresh.ticks)
    };
    for pair in 0..effort.pairs {
        let both = || Ok((fly("1")?, fly("1")?));
        let (two, (one, again), steal_percent) = in_turns(pair, None, || fly("2"), both)?;
        for (place, (comparison, quantile)) in all.iter_mut().enumerate() {
            let ours = if place < 2 { &two } else { &again };
            let quantile = |report| Ok(quantile_us(series(report, "loop")?, *quantile));
            let (ours, floor): (Result<_, Failure>, _) = (quantile(ours), quantile(&one)?);
            if let (Some(ours), Some(floor)) = (ours?, floor) {
                comparison.take(ours, floor, steal_percent);
            }
        }
        not_fresh.take_events(counted(&two), counted(&one), steal_percent);
    }
    let all = all.into_iter().map(|(comparison, _)| comparison);
    Ok(all.chain([not_fresh]).collect())
}

/// So many events in the ticks of a flight.
const fn of_ticks(report: &Report, count: u64) -> Events {
    let exposure = report.ticks.run + report.ticks.skipped;
    Events { count, exposure }
}

fn rehearsal_of(flown: &Report) -> Option<RingRehearsal> {
    let us = [flown.lead.median_us, flown.lead.rehearsal_us];
    let [lead_ns, needs_ns] = us.map(|us| (us * 1e3) as u64);
    (needs_ns > 0).then_some(RingRehearsal { lead_ns, needs_ns })
}

/// The deadlines that a flight missed, and the wake-ups of a bare timer that left its loop no time.
pub(super) fn missed_and_late(
    report: &Report,
    bare: &Histogram<u64>,
    period_ns: u64,
) -> Result<[Events; 2], Failure> {
    let loop_ns = (series(report, "loop")?.p50_us * 1e3) as u64;
    let in_time = bare.count_between(0, period_ns.saturating_sub(loop_ns));
    let missed = of_ticks(report, report.deadlines.missed);
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
) -> Result<[Option<Histogram<u64>>; 3], Failure> {
    let schedule = effort.schedule(PERIOD_NS);
    let bare = cyclictest::measure(&schedule)?;
    let Some(like) = like else {
        return Ok([Some(bare), None, None]);
    };
    let work = work_like(like)?;
    let ring = |rehearsal| {
        let settings = RingSettings {
            schedule: schedule.clone(),
            work: work.clone(),
            rehearsal,
            ..RingSettings::default()
        };
        ring::measure(&settings, &runner.executable).map(|floor| floor.chain)
    };
    let rehearsed = rehearsal_of(like).map(|it| ring(Some(it))).transpose()?;
    Ok([Some(bare), Some(ring(None)?), rehearsed])
}

impl MeasuringEffort {
    pub(super) fn schedule(&self, period_ns: u64) -> Schedule {
        Schedule {
            period_ns,
            duration: self.duration,
            cpu: None,
            priority: self.priority,
        }
    }

    pub(super) fn fly(&self, runner: &FlightRunner, flags: &[&str]) -> Result<Report, Failure> {
        let duration = format!("{}ms", self.duration.as_millis());
        let all = ["--rt", "require", "--duration", &duration];
        runner.fly(&[&all, flags].concat())
    }
}

/// Measures the rig and the baseline, the baseline first in every other pair; also the share of `processor` that the
/// hypervisor took meanwhile [%].
pub(super) fn in_turns<T, F>(
    pair: usize,
    processor: Option<u64>,
    ours: impl FnOnce() -> Result<T, Failure>,
    floor: impl FnOnce() -> Result<F, Failure>,
) -> Result<(T, F, f64), Failure> {
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

/// Ticks in lockstep compared with laps of a raw eventfd ring, both under SCHED_OTHER; and the speed relative to real
/// time.
pub fn lockstep(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::ratio("lockstep tick", "us", 1.5);
    let mut speed = FloorComparison::ratio("lockstep, real time 1/25", "us", 1.0);
    // At about 30 times real time, a side lasts the requested time.
    let simulated = format!("{}s", 30 * effort.duration.as_secs().max(1));
    let settings = RingSettings {
        by_eventfd: true,
        schedule: Schedule {
            priority: 0,
            ..effort.schedule(0)
        },
        work: vec![Work::default(); 4],
        ..RingSettings::default()
    };
    for pair in 0..effort.pairs {
        // Neither side is bound to a CPU.
        let (report, lap_us, steal_percent) = in_turns(
            pair,
            None,
            || runner.fly(&["--pace", "lockstep", "--duration", &simulated]),
            || Ok(ring::measure(&settings, &runner.executable)?.lap.mean() / 1e3),
        )?;
        let ours = report.ticks.elapsed_s * 1e6 / report.ticks.run as f64;
        tick.take(ours, lap_us, steal_percent);
        speed.take(ours, PERIOD_NS as f64 / 1e3 / 25.0, steal_percent);
    }
    Ok(vec![tick, speed])
}

/// One tick of all four laws compared with hand-written scalar code, and a tick of `simulate`, including the monitor,
/// compared with 1/500 of real time.
pub fn laws(effort: &MeasuringEffort) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::ratio("laws, one tick", "us", 1.2);
    let before = CpuTimes::read(None);
    let pairs = timing::pairs(effort.pairs, TIMED_TICKS);
    let pairs = pairs.map_err(|e| Failure::failed(e.to_string()))?;
    let steal_percent = before.steal_until(&CpuTimes::read(None)).percent;
    for pair in pairs {
        tick.take(pair.laws_s * 1e6, pair.scalar_s * 1e6, steal_percent);
    }
    let mut simulate = FloorComparison::ratio("simulate, real time 1/500", "us", 1.0);
    let settings = Settings::resolve(None, &Vec::new())?;
    for _ in 0..effort.pairs {
        let before = CpuTimes::read(None);
        let mut rig = Simulator::of(&settings)?.with_monitor(settings.theorem()?, 1);
        let start = Instant::now();
        for _ in 0..TIMED_TICKS {
            black_box(&mut rig).tick();
        }
        let ours = start.elapsed().as_secs_f64() * 1e6 / TIMED_TICKS as f64;
        let steal_percent = before.steal_until(&CpuTimes::read(None)).percent;
        simulate.take(ours, PERIOD_NS as f64 / 1e3 / 500.0, steal_percent);
    }
    Ok(vec![tick, simulate])
}

/// A tick of `replay --verify` compared with one of `simulate` for the same flight. Both run as separate processes, as
/// a user starts them.
pub fn replay(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::ratio("replay --verify, one tick", "us", 1.7);
    let simulated = format!("{}s", FLOWN_AGAIN * effort.duration.as_secs().max(1));
    let (mut flight, run) = runner.command(&["--pace", "lockstep", "--duration", &simulated]);
    run_to_end(&mut flight)?;
    let ticks = Report::read(&run.join("report.json"))?.ticks.run as f64;
    let us = |words: [&str; 2], last: &OsStr| -> Result<f64, Failure> {
        let start = Instant::now();
        run_to_end(Command::new(&runner.executable).args(words).arg(last))?;
        Ok(start.elapsed().as_secs_f64() * 1e6 / ticks)
    };
    let replay = || us(["replay", "--verify"], run.as_os_str());
    let simulate = || us(["simulate", "--duration"], simulated.as_ref());
    for pair in 0..effort.pairs {
        // Neither side is bound to a CPU.
        let (ours, floor, steal_percent) = in_turns(pair, None, replay, simulate)?;
        tick.take(ours, floor, steal_percent);
    }
    Ok(vec![tick])
}

fn run_to_end(command: &mut Command) -> Result<(), Failure> {
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|e| {
        let program = command.get_program().display();
        Failure::failed(format!("cannot start {program}: {e}"))
    })?;
    if output.status.success() {
        return Ok(());
    }
    let what = command.get_args().next().unwrap_or_default().display();
    let what = format!("`ironbird {what}`");
    Err(Failure::failed(command_end(&what, &output)))
}
