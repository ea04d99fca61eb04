//! The sets of comparisons. Each measures the rig and its baseline alternately, A B A B.

use std::ffi::OsStr;
use std::hint::black_box;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use process::rt::loops_cpu;
use rustix::process::{Pid, Signal, kill_process};

use super::flight_baseline::work_like;
use crate::floor::flight_runner::{FlightRunner, series};
use crate::settings::Settings;
use crate::simulator::Simulator;
use errors::Failure;
use host::cpu_times::CpuTimes;
use host::floor::comparison::FloorComparison;
use host::floor::cyclictest;
use host::floor::link::WakeMechanism;
use host::floor::ring;
use host::floor::work::Work;
use report::schema::Report;
use report::statistics::Events;
use scalar::timing;

/// Length of a tick [ns].
const PERIOD_NS: u64 = 1_000_000;
/// Ticks per side when timing laws: long enough for the kernel's count of stolen time.
const TIMED_TICKS: u64 = 200_000;
/// Seconds of flight to replay per requested second of measurement. A replay runs hundreds of times faster than real
/// time, so it ends earlier; a longer log would fill the disk.
const FLOWN_AGAIN: u64 = 5;
/// Delay inserted into one stage of the ring to test the measurement itself [us].
pub const KNOWN_US: f64 = 20.0;

/// How long and how often to measure.
#[derive(Clone, Copy, Debug)]
pub struct MeasuringEffort {
    pub pairs: usize,
    /// Per side of a pair.
    pub duration: Duration,
    pub priority: i32,
}

/// Load on all CPUs; ends when dropped.
#[derive(Debug)]
pub struct Stress(Child);

/// The load: one worker per CPU, one that maps memory, one that writes files.
pub const STRESS: [&str; 6] = ["--cpu", "0", "--vm", "1", "--hdd", "1"];
/// How long the load takes to start.
const STRESS_BEGINS: Duration = Duration::from_secs(1);

impl Stress {
    #[must_use]
    pub fn is_installed() -> bool {
        Command::new("stress-ng").arg("--version").output().is_ok()
    }

    pub fn start(runner: &FlightRunner) -> Result<Self, Failure> {
        let mut command = Command::new("stress-ng");
        command
            .args(STRESS)
            .arg("--temp-path")
            .arg(runner.directory());
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let mut load = child
            .map(Self)
            .map_err(|e| Failure::failed(format!("cannot start stress-ng: {e}")))?;
        sleep(STRESS_BEGINS);
        load.check()?;
        Ok(load)
    }

    /// Fails if the load has ended.
    pub fn check(&mut self) -> Result<(), Failure> {
        match self.0.try_wait() {
            Ok(None) => Ok(()),
            Ok(Some(status)) => Err(Failure::failed(format!(
                "stress-ng has ended with {status}: nothing loads the machine"
            ))
            .help(format!(
                "see what it says: stress-ng {} --timeout 5",
                STRESS.join(" ")
            ))),
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

/// A flight and the machine's baselines, measured in the same minute.
struct FlightWithBaselines {
    bare: Histogram<u64>,
    report: Report,
    ring: Option<ring::RingFloor>,
    /// With the same warm-up runs as the flight.
    rehearsed_ring: Option<ring::RingFloor>,
    steal_percent: f64,
}

impl FlightWithBaselines {
    /// `computing` is an earlier flight whose computing times the ring imitates; then the baselines are measured first.
    fn measure(
        runner: &FlightRunner,
        effort: &MeasuringEffort,
        with_ring: bool,
        computing: Option<&Report>,
    ) -> Result<Self, Failure> {
        let duration = format!("{}ms", effort.duration.as_millis());
        let fly = || runner.fly(&["--rt", "require", "--duration", &duration]);
        let bare = || {
            cyclictest::measure(&cyclictest::CyclictestSettings {
                cpu: loops_cpu(),
                priority: effort.priority,
                period_us: PERIOD_NS / 1000,
                duration: effort.duration,
            })
        };
        let rings = |like: &Report| -> Result<_, Failure> {
            let ring = |rehearsal| {
                with_ring
                    .then(|| ring_beside(runner, effort, like, rehearsal))
                    .transpose()
            };
            let rehearsed = rehearsal_of(like)
                .map(|rehearsal| ring(Some(rehearsal)))
                .transpose()?
                .flatten();
            Ok((ring(None)?, rehearsed))
        };
        let processor = Some(loops_cpu() as u64);
        let before = CpuTimes::read(processor);
        let (bare, report, (ring, rehearsed_ring)) = if let Some(like) = computing {
            let (rings, bare) = (rings(like)?, bare()?);
            (bare, fly()?, rings)
        } else {
            let report = fly()?;
            let (bare, rings) = (bare()?, rings(&report)?);
            (bare, report, rings)
        };
        let steal_percent = before.steal_until(&CpuTimes::read(processor)).percent;
        Ok(Self {
            bare,
            report,
            ring,
            rehearsed_ring,
            steal_percent,
        })
    }
}

/// Wake-ups, loop latency and misses of flights, compared with cyclictest and a futex ring with the same computing
/// time. The flight is measured first and last in turns.
pub fn flights(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
    mut load: Option<&mut Stress>,
) -> Result<Vec<FloorComparison>, Failure> {
    let under = if load.is_some() { ", under load" } else { "" };
    let of = |what: &str, goal: f64| FloorComparison::ratio(&format!("{what}{under}"), "us", goal);
    let mut wake = [of("wake p50", 0.02), of("wake p99", 0.3)];
    let mut timer = [of("timer p50", 1.05), of("timer p99", 1.1)];
    let mut chain = [
        of("loop p50", 0.8),
        of("loop p99", 1.0),
        of("loop p99.9", 1.2),
    ];
    let mut rehearsed = ["p50", "p99", "p99.9"]
        .map(|quantile| of(&format!("loop {quantile}, the ring rehearses too"), 1.5));
    let mut misses = FloorComparison::events(&format!("misses{under}"), 1.0);
    let mut last: Option<Report> = None;
    for pair in 0..effort.pairs {
        let computing = last.as_ref().filter(|_| pair % 2 == 1);
        let FlightWithBaselines {
            bare,
            report,
            ring,
            rehearsed_ring,
            steal_percent,
        } = FlightWithBaselines::measure(runner, effort, load.is_none(), computing)?;
        if let Some(load) = &mut load {
            load.check()?;
        }
        let [woken, called, looped] =
            ["wake.plant", "timer", "loop"].map(|name| series(&report, name));
        let (woken, called, looped) = (woken?, called?, looped?);
        let bare_us = |quantile: f64| bare.value_at_quantile(quantile) as f64 / 1e3;
        wake[0].take(woken.p50_us, bare_us(0.5), steal_percent);
        wake[1].take(woken.p99_us, bare_us(0.99), steal_percent);
        timer[0].take(called.p50_us, bare_us(0.5), steal_percent);
        timer[1].take(called.p99_us, bare_us(0.99), steal_percent);
        for (ring, rows) in [(&ring, &mut chain), (&rehearsed_ring, &mut rehearsed)] {
            let Some(ring) = ring else { continue };
            let ring_us = |quantile: f64| ring.chain.value_at_quantile(quantile) as f64 / 1e3;
            rows[0].take(looped.p50_us, ring_us(0.5), steal_percent);
            rows[1].take(looped.p99_us, ring_us(0.99), steal_percent);
            if let Some(p999_us) = looped.p999_us {
                rows[2].take(p999_us, ring_us(0.999), steal_percent);
            }
        }
        // A wake-up later than this leaves the loop no time for its tick.
        let threshold_ns = PERIOD_NS - (looped.p50_us * 1e3) as u64;
        let late = Events {
            count: bare.len() - bare.count_between(0, threshold_ns),
            exposure: bare.len(),
        };
        let ticks = report.ticks.run + report.ticks.skipped;
        misses.take_events(
            Events {
                count: report.deadlines.missed,
                exposure: ticks,
            },
            late,
            steal_percent,
        );
        last = Some(report);
    }
    let mut all: Vec<FloorComparison> = wake.into();
    all.extend(timer);
    all.extend(chain);
    all.extend(rehearsed);
    all.push(misses);
    // Under load there is no ring, and too few ticks give no 99.9th percentile.
    all.retain(|comparison| comparison.measured().0 > 0);
    Ok(all)
}

/// A ring whose processes compute as long as the flight's laws in the median.
fn ring_beside(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
    report: &Report,
    rehearsal: Option<ring::RingRehearsal>,
) -> Result<ring::RingFloor, Failure> {
    let settings = ring_settings(effort, WakeMechanism::Futex, PERIOD_NS, work_like(report)?);
    ring::measure(
        &ring::RingSettings {
            rehearsal,
            ..settings
        },
        runner.executable(),
    )
}

/// Warm-up runs like those of the flight, if it had any.
fn rehearsal_of(report: &Report) -> Option<ring::RingRehearsal> {
    let [lead_ns, needs_ns] =
        [report.lead.median_us, report.lead.rehearsal_us].map(|us| (us * 1e3) as u64);
    (needs_ns > 0).then_some(ring::RingRehearsal { lead_ns, needs_ns })
}

fn ring_settings(
    effort: &MeasuringEffort,
    wake: WakeMechanism,
    period_ns: u64,
    work: Vec<Work>,
) -> ring::RingSettings {
    let MeasuringEffort {
        duration, priority, ..
    } = *effort;
    ring::RingSettings {
        wake,
        period_ns,
        duration,
        cpu: None,
        priority,
        work,
        rehearsal: None,
    }
}

/// Measures the rig and the baseline, the baseline first in every other pair; also the share of `processor` that the
/// hypervisor took meanwhile [%].
fn in_turns<T, F>(
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
    Ok((
        ours,
        floor,
        before.steal_until(&CpuTimes::read(processor)).percent,
    ))
}

/// Ticks in lockstep compared with laps of a raw eventfd ring, both under SCHED_OTHER; and the speed relative to real
/// time.
pub fn lockstep(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::ratio("lockstep tick", "us", 1.4);
    let mut speed = FloorComparison::ratio("lockstep, real time 1/25", "us", 1.0);
    // At about 30 times real time, a side lasts the requested time.
    let simulated = format!("{}s", 30 * effort.duration.as_secs().max(1));
    let quiet = MeasuringEffort {
        priority: 0,
        ..*effort
    };
    let settings = ring_settings(&quiet, WakeMechanism::Eventfd, 0, vec![Work::default(); 4]);
    for pair in 0..effort.pairs {
        // Neither side is bound to a CPU.
        let (report, lap_us, steal_percent) = in_turns(
            pair,
            None,
            || runner.fly(&["--pace", "lockstep", "--duration", &simulated]),
            || Ok(ring::measure(&settings, runner.executable())?.lap.mean() / 1e3),
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
    let mut tick = FloorComparison::ratio("laws, one tick", "us", 1.1);
    let before = CpuTimes::read(None);
    let pairs =
        timing::pairs(effort.pairs, TIMED_TICKS).map_err(|e| Failure::failed(e.to_string()))?;
    let steal_percent = before.steal_until(&CpuTimes::read(None)).percent;
    pairs
        .into_iter()
        .for_each(|pair| tick.take(pair.laws_s * 1e6, pair.scalar_s * 1e6, steal_percent));
    let mut simulate = FloorComparison::ratio("simulate, real time 1/500", "us", 1.0);
    let settings = Settings::resolve(None, &Vec::new())?;
    for _ in 0..effort.pairs {
        let (before, mut rig) = (
            CpuTimes::read(None),
            Simulator::of(&settings)?.with_monitor(settings.theorem()?),
        );
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
    let mut tick = FloorComparison::ratio("replay --verify, one tick", "us", 2.0);
    let simulated = format!("{}s", FLOWN_AGAIN * effort.duration.as_secs().max(1));
    let (mut flight, run) = runner.command(&["--pace", "lockstep", "--duration", &simulated]);
    run_to_end(&mut flight)?;
    let ticks = Report::read(&run.join("report.json"))?.ticks.run as f64;
    let us = |words: [&OsStr; 3]| -> Result<f64, Failure> {
        let start = Instant::now();
        run_to_end(Command::new(runner.executable()).args(words))?;
        Ok(start.elapsed().as_secs_f64() * 1e6 / ticks)
    };
    for pair in 0..effort.pairs {
        // Neither side is bound to a CPU.
        let (ours, floor, steal_percent) = in_turns(
            pair,
            None,
            || us(["replay".as_ref(), "--verify".as_ref(), run.as_os_str()]),
            || {
                us([
                    "simulate".as_ref(),
                    "--duration".as_ref(),
                    simulated.as_ref(),
                ])
            },
        )?;
        tick.take(ours, floor, steal_percent);
    }
    Ok(vec![tick])
}

/// Tests the measurement: a ring with 20 us more arithmetic in one stage must show them.
pub fn known_slow(
    runner: &FlightRunner,
    effort: &MeasuringEffort,
) -> Result<Vec<FloorComparison>, Failure> {
    let [mut p50, mut p99] = ["p50", "p99"].map(|name| {
        FloorComparison::difference(&format!("20 us put into a hop, {name}"), "us", KNOWN_US)
    });
    let slow = Work::lasting((KNOWN_US * 1e3) as u64);
    let chain = |work: Vec<Work>| -> Result<Histogram<u64>, Failure> {
        let settings = ring_settings(effort, WakeMechanism::Futex, PERIOD_NS, work);
        Ok(ring::measure(&settings, runner.executable())?.chain)
    };
    for pair in 0..effort.pairs {
        let (ours, floor, steal_percent) = in_turns(
            pair,
            Some(loops_cpu() as u64),
            || {
                chain(vec![
                    Work::default(),
                    slow,
                    Work::default(),
                    Work::default(),
                ])
            },
            || chain(vec![Work::default(); 4]),
        )?;
        let us = |histogram: &Histogram<u64>, quantile: f64| {
            histogram.value_at_quantile(quantile) as f64 / 1e3
        };
        p50.take(us(&ours, 0.5), us(&floor, 0.5), steal_percent);
        p99.take(us(&ours, 0.99), us(&floor, 0.99), steal_percent);
    }
    Ok(vec![p50, p99])
}

/// Runs an ironbird command to its end.
fn run_to_end(command: &mut Command) -> Result<(), Failure> {
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|e| {
        Failure::failed(format!(
            "cannot start {}: {e}",
            command.get_program().display()
        ))
    })?;
    if output.status.success() {
        return Ok(());
    }
    let what = command.get_args().next().unwrap_or_default().display();
    let complaint = String::from_utf8_lossy(&output.stderr);
    Err(Failure::failed(format!(
        "`ironbird {what}` ended with {}: {}",
        output.status,
        complaint.trim()
    )))
}
