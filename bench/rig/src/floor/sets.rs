//! The sets of comparisons: each measures ours and its floor in turns, A B A B.

use std::hint::black_box;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use role::rt::loops_cpu;
use rustix::process::{Pid, Signal, kill_process};

use super::beside::computing_as;
use crate::floor::flight::{Hangar, series};
use crate::in_process::InProcess;
use crate::settings::Settings;
use failure::Failure;
use machine::cpu_times::CpuTimes;
use machine::floor::comparison::{FloorComparison, FloorPair, RatioKind};
use machine::floor::cyclictest;
use machine::floor::link::WakeMechanism;
use machine::floor::ring;
use machine::floor::work::Work;
use report::schema::Report;
use scalar::timing;

/// Length of a tick [ns].
const PERIOD_NS: u64 = 1_000_000;
/// Ticks of a side where laws are timed: long enough for the kernel's count of stolen time.
const TIMED_TICKS: u64 = 200_000;
/// Spin that is added to a hop in the test of the instrument [us].
pub const KNOWN_US: f64 = 20.0;

/// How long and how often to measure.
#[derive(Clone, Copy, Debug)]
pub struct MeasuringEffort {
    /// Pairs of each comparison.
    pub pairs: usize,
    /// Of each side of a pair.
    pub duration: Duration,
    /// SCHED_FIFO priority of the plant.
    pub priority: i32,
}

/// Load beside the loops, which ends with this value.
#[derive(Debug)]
pub struct Stress(Child);

/// What the load consists of.
pub const STRESS: [&str; 6] = ["--cpu", "2", "--vm", "1", "--hdd", "1"];

impl Stress {
    /// Whether `stress-ng` is installed.
    #[must_use]
    pub fn is_installed() -> bool {
        Command::new("stress-ng").arg("--version").output().is_ok()
    }

    /// Starts the load.
    ///
    /// # Errors
    /// [`Failure`] where it cannot be started.
    pub fn start(hangar: &Hangar) -> Result<Self, Failure> {
        let mut command = Command::new("stress-ng");
        command.args(STRESS).arg("--temp-path").arg(hangar.directory());
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        child.map(Self).map_err(|e| Failure::failed(format!("cannot start stress-ng: {e}")))
    }
}

impl Drop for Stress {
    fn drop(&mut self) {
        if let Some(pid) = Pid::from_raw(self.0.id().cast_signed()) {
            // It ends its workers on this signal.
            let _ = kill_process(pid, Signal::TERM);
        }
        let _ = self.0.wait();
    }
}

/// Wakes, loop and misses of flights, beside cyclictest and a futex ring that does the same compute.
///
/// # Errors
/// [`Failure`] of what cannot be measured.
pub fn flights(hangar: &Hangar, effort: &MeasuringEffort, stressed: bool) -> Result<Vec<FloorComparison>, Failure> {
    let under = if stressed { ", under load" } else { "" };
    let of = |what: &str, unit: &str, kind: RatioKind, goal: f64| {
        FloorComparison::new(&format!("{what}{under}"), unit, kind, goal)
    };
    let mut wake = [of("wake p50", "us", RatioKind::Ratio, 1.05), of("wake p99", "us", RatioKind::Ratio, 1.10)];
    let mut chain = [
        of("loop p50", "us", RatioKind::Ratio, 1.5),
        of("loop p99", "us", RatioKind::Ratio, 1.5),
        of("loop p99.9", "us", RatioKind::Ratio, 2.0),
    ];
    let mut misses = of("misses", "per million", RatioKind::Events, 1.2);
    let duration = format!("{}ms", effort.duration.as_millis());
    for _ in 0..effort.pairs {
        let before = CpuTimes::read();
        let bare = cyclictest::measure(&cyclictest::CyclictestSettings {
            cpu: loops_cpu(),
            priority: effort.priority,
            period_us: PERIOD_NS / 1000,
            duration: effort.duration,
        })?;
        let report = hangar.fly(&["--rt", "require", "--duration", &duration])?;
        let (woken, looped) = (series(&report, "wake.plant")?, series(&report, "loop")?);
        let ring = (!stressed).then(|| ring_beside(hangar, effort, &report)).transpose()?;
        let steal_percent = before.steal_until(&CpuTimes::read()).percent;
        let pair = |ours: f64, floor: f64| FloorPair { ours, floor, steal_percent };
        let bare_us = |quantile: f64| bare.value_at_quantile(quantile) as f64 / 1e3;
        wake[0].pairs.push(pair(woken.p50_us, bare_us(0.5)));
        wake[1].pairs.push(pair(woken.p99_us, bare_us(0.99)));
        if let Some(ring) = &ring {
            let ring_us = |quantile: f64| ring.chain.value_at_quantile(quantile) as f64 / 1e3;
            chain[0].pairs.push(pair(looped.p50_us, ring_us(0.5)));
            chain[1].pairs.push(pair(looped.p99_us, ring_us(0.99)));
            if let Some(p999_us) = looped.p999_us {
                chain[2].pairs.push(pair(p999_us, ring_us(0.999)));
            }
        }
        // A bare sample later than this leaves the loop no time for its tick.
        let threshold_ns = PERIOD_NS - (looped.p50_us * 1e3) as u64;
        let late = bare.len() - bare.count_between(0, threshold_ns);
        let ticks = report.ticks.run + report.ticks.skipped;
        misses
            .pairs
            .push(pair(report.deadlines.missed as f64 / ticks as f64 * 1e6, late as f64 / bare.len() as f64 * 1e6));
    }
    let mut all: Vec<FloorComparison> = wake.into();
    if !stressed {
        all.extend(chain);
    }
    all.push(misses);
    // A 99.9th percentile of too few ticks is none.
    all.retain(|comparison| !comparison.pairs.is_empty());
    Ok(all)
}

/// The ring with as much to compute in each process as the flight's laws took in the median.
fn ring_beside(hangar: &Hangar, effort: &MeasuringEffort, report: &Report) -> Result<ring::RingFloor, Failure> {
    let settings = ring_settings(effort, WakeMechanism::Futex, PERIOD_NS, computing_as(report)?);
    ring::measure(&settings, hangar.executable())
}

fn ring_settings(effort: &MeasuringEffort, wake: WakeMechanism, period_ns: u64, work: Vec<Work>) -> ring::RingSettings {
    ring::RingSettings { wake, period_ns, duration: effort.duration, cpu: None, priority: effort.priority, work }
}

/// Ticks in lockstep beside laps of a raw eventfd ring, both under SCHED_OTHER; and how many times real time that is.
///
/// # Errors
/// [`Failure`] of what cannot be measured.
pub fn lockstep(hangar: &Hangar, effort: &MeasuringEffort) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::new("lockstep tick", "us", RatioKind::Ratio, 2.6);
    let mut speed = FloorComparison::new("lockstep, real time 1/25", "us", RatioKind::Ratio, 1.0);
    // At some 30 times real time a side takes as long as it is asked to.
    let simulated = format!("{}s", 30 * effort.duration.as_secs().max(1));
    let quiet = MeasuringEffort { priority: 0, ..*effort };
    for _ in 0..effort.pairs {
        let before = CpuTimes::read();
        let report = hangar.fly(&["--pace", "lockstep", "--duration", &simulated])?;
        let ring = ring_settings(&quiet, WakeMechanism::Eventfd, 0, vec![Work::default(); 4]);
        let floor = ring::measure(&ring, hangar.executable())?;
        let steal_percent = before.steal_until(&CpuTimes::read()).percent;
        let ours = report.ticks.elapsed_s * 1e6 / report.ticks.run as f64;
        tick.pairs.push(FloorPair { ours, floor: floor.lap.mean() / 1e3, steal_percent });
        speed.pairs.push(FloorPair { ours, floor: PERIOD_NS as f64 / 1e3 / 25.0, steal_percent });
    }
    Ok(vec![tick, speed])
}

/// One tick of all four laws beside the same by hand, and a tick of `simulate`, monitor included, beside what 500 times
/// real time would take.
///
/// # Errors
/// [`Failure`] of settings that cannot be, which the default ones are not.
pub fn laws(effort: &MeasuringEffort) -> Result<Vec<FloorComparison>, Failure> {
    let mut tick = FloorComparison::new("laws, one tick", "us", RatioKind::Ratio, 1.1);
    let before = CpuTimes::read();
    let pairs = timing::pairs(effort.pairs, TIMED_TICKS);
    let steal_percent = before.steal_until(&CpuTimes::read()).percent;
    let pair =
        |pair: timing::TimedPair| FloorPair { ours: pair.laws_s * 1e6, floor: pair.scalar_s * 1e6, steal_percent };
    tick.pairs.extend(pairs.into_iter().map(pair));
    let mut simulate = FloorComparison::new("simulate, real time 1/500", "us", RatioKind::Ratio, 1.0);
    let settings = Settings::resolve(None, &Vec::new())?;
    for _ in 0..effort.pairs {
        let (before, mut rig) = (CpuTimes::read(), InProcess::of(&settings)?);
        let start = Instant::now();
        for _ in 0..TIMED_TICKS {
            black_box(rig.tick());
        }
        let ours = start.elapsed().as_secs_f64() * 1e6 / TIMED_TICKS as f64;
        let steal_percent = before.steal_until(&CpuTimes::read()).percent;
        simulate.pairs.push(FloorPair { ours, floor: PERIOD_NS as f64 / 1e3 / 500.0, steal_percent });
    }
    Ok(vec![tick, simulate])
}

/// The test of the instrument: a ring with 20 us of arithmetic more in one hop must show them.
///
/// # Errors
/// [`Failure`] of what cannot be measured.
pub fn known_slow(hangar: &Hangar, effort: &MeasuringEffort) -> Result<Vec<FloorComparison>, Failure> {
    let mut seen = FloorComparison::new("20 us put into a hop", "us", RatioKind::Difference, KNOWN_US);
    let slow = Work::lasting((KNOWN_US * 1e3) as u64);
    let median_us = |work: Vec<Work>| -> Result<f64, Failure> {
        let settings = ring_settings(effort, WakeMechanism::Futex, PERIOD_NS, work);
        Ok(ring::measure(&settings, hangar.executable())?.chain.value_at_quantile(0.5) as f64 / 1e3)
    };
    for _ in 0..effort.pairs {
        let before = CpuTimes::read();
        let floor = median_us(vec![Work::default(); 4])?;
        let ours = median_us(vec![Work::default(), slow, Work::default(), Work::default()])?;
        let steal_percent = before.steal_until(&CpuTimes::read()).percent;
        seen.pairs.push(FloorPair { ours, floor, steal_percent });
    }
    Ok(vec![seen])
}
