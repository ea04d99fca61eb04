//! Fault injection into processes, planned or by `inject`: stops and kills them, loads their processor.
//!
//! Every fault is due at the start of a tick on the clock. The supervisor sleeps here between two polls of its flight.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

use faults::live::{LIVE, LiveBlackboard, LiveFault, NOTICE_TICKS};
use ipc::clock::{now_ns, sleep_through};
use ipc::instance::Instance;
use ipc::{BlackboardReader, Wire};
use messages::blackboards::{Run, RunPhase};
use messages::grid::{Grid, Pace};
use messages::role::{Channel, Replica, Role};
use process::rt::loops_cpu;
use rustix::process::Signal;

use crate::child_process::{ChildWatch, kill_and_reap};
use analysis::faults::InjectedFault;
use config::Settings;
use errors::Failure;
use faults::grammar::{joined, planned_again};
use faults::{StageKind, Target};

/// How often to look for injected faults: if possible, four times between an injection and its first tick.
const LOOK_EVERY_NS: RangeInclusive<u64> = 1_000_000..=20_000_000;
/// How long before its first tick a load process is started [ns].
const START_AHEAD_NS: u64 = 300_000_000;
/// How long before a tick the wait for a signal begins [ns].
const AIM_NS: u64 = 2_000_000;

pub(super) struct FaultInjector {
    instance: String,
    executable: PathBuf,
    cpu: usize,
    /// Faults of the settings, until t_0 is known.
    planned: Vec<LiveFault>,
    blackboard: Option<BlackboardReader<LiveBlackboard>>,
    /// How many faults of the blackboard have been scheduled.
    read: usize,
    /// What is to be done, each at its instant [ns].
    due: Vec<(u64, Action)>,
    /// Process numbers of stopped children.
    stopped: Vec<u32>,
    /// Processes that load the processor, each with its fault.
    loads: Vec<(LiveFault, Child)>,
    /// Process numbers of killed children, each with the tick.
    killed: Vec<(u32, u64)>,
    /// The flight ends: nothing is injected any more.
    is_released: bool,
    /// Messages for the supervisor to announce.
    pub(super) messages: Vec<String>,
    /// Faults that began after their tick, to announce and to report.
    pub(super) delayed: Vec<InjectedFault>,
}

#[derive(Clone, Copy, Debug)]
enum Action {
    Inject(LiveFault),
    Continue(u32),
}

/// The children of a flight, and which of them plays which role.
pub(super) struct RoleProcesses<'a> {
    pub(super) watch: &'a mut ChildWatch,
    pub(super) pids: &'a [(Replica, u32)],
}

impl RoleProcesses<'_> {
    /// Sends a signal to the processes that a fault acts on; returns their numbers.
    fn signal(&self, fault: &LiveFault, signal: Signal) -> Result<Vec<u32>, Failure> {
        let known = self.pids.iter().filter(|(it, _)| fault.kind.is_of(*it));
        let signalled = known.filter(|(_, pid)| self.watch.signal(*pid, signal).is_ok());
        let pids: Vec<u32> = signalled.map(|(_, pid)| *pid).collect();
        if pids.is_empty() {
            let (tick, kind) = (fault.span.from, &fault.kind);
            let channel = kind.channel().map_or("", Channel::prefix);
            let role = kind.role().map_or("", Role::name);
            return Err(Failure::failed(format!(
                "tick {tick}: no process plays the role {channel}{role}"
            )));
        }
        Ok(pids)
    }
}

impl FaultInjector {
    pub(super) fn new(
        instance: &Instance,
        executable: &Path,
        settings: &Settings,
    ) -> Result<Self, Failure> {
        Ok(Self {
            instance: instance.name().to_owned(),
            executable: executable.to_owned(),
            cpu: settings.realtime()?.cpu.unwrap_or_else(loops_cpu),
            planned: settings.planned()?.acts,
            blackboard: None,
            read: 0,
            due: Vec::new(),
            stopped: Vec::new(),
            loads: Vec::new(),
            killed: Vec::new(),
            is_released: false,
            messages: Vec::new(),
            delayed: Vec::new(),
        })
    }

    pub(super) fn killed(&self, pid: u32) -> Option<u64> {
        let killed = self.killed.iter().find(|(known, _)| *known == pid);
        killed.map(|(_, tick)| *tick)
    }

    /// Rests for a time, or until a child has ended, and injects meanwhile what is due. `run` is what the supervisor
    /// last read of the flight.
    pub(super) fn rest(
        &mut self,
        wire: &Wire,
        run: Option<&Run>,
        time: Duration,
        players: &mut RoleProcesses<'_>,
    ) {
        let until = now_ns().saturating_add(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
        let run = run.filter(|run| run.launcher_pid == u64::from(std::process::id()));
        if run.is_some_and(|run| run.phase() == RunPhase::Closed) {
            self.release(players.watch);
        }
        // Before the first tick, too: its begin is known.
        let flying = run.filter(|run| run.phase() == RunPhase::Flying);
        let on_clock = flying.and_then(|run| match run.pace() {
            Pace::Realtime(grid) if !self.is_released => Some((run, grid)),
            _ => None,
        });
        loop {
            if let Some((run, grid)) = &on_clock {
                self.schedule_new(wire, grid);
                self.perform_due(run, grid, players);
            }
            let now = now_ns();
            if now >= until {
                return;
            }
            let due = self.due.iter().map(|(at, _)| at.saturating_sub(AIM_NS));
            let next_action = due.min().unwrap_or(u64::MAX);
            let next_look = on_clock.map_or(u64::MAX, |(_, grid)| {
                let (least, most) = LOOK_EVERY_NS.into_inner();
                let notice_ns = NOTICE_TICKS.saturating_mul(grid.period_ns);
                next_action.min(now + (notice_ns / 4).clamp(least, most))
            });
            if players.watch.wait_until(next_look.min(until)) {
                return;
            }
        }
    }

    /// Schedules the planned faults, and those that were injected since the last look.
    fn schedule_new(&mut self, wire: &Wire, grid: &Grid) {
        // Load processes whose time is over; one that failed has said why.
        self.loads
            .retain_mut(|(_, child)| matches!(child.try_wait(), Ok(None)));
        for fault in std::mem::take(&mut self.planned) {
            self.schedule(fault, grid);
        }
        if self.blackboard.is_none() {
            // If it cannot be read, nothing is injected; the stages report that.
            self.blackboard = wire.blackboard_reader(LIVE).ok().flatten();
        }
        let Some(faults) = self.blackboard.as_ref().map(BlackboardReader::get) else {
            return;
        };
        let new: Vec<LiveFault> = faults.iter().skip(self.read).collect();
        self.read += new.len();
        new.into_iter().for_each(|fault| self.schedule(fault, grid));
    }

    fn schedule(&mut self, fault: LiveFault, grid: &Grid) {
        let begin_ns = grid.begin_of(fault.span.from);
        if fault.ends {
            self.cancel(&fault);
        }
        let ahead_ns = match fault.kind.target {
            // Stages and the plant inject them.
            Target::Message(..)
            | Target::Number(..)
            | Target::Channel(..)
            | Target::Stage(StageKind::Late, ..) => return,
            Target::Processor(_) if !fault.ends => START_AHEAD_NS,
            Target::Processor(_) | Target::Stage(..) => 0,
        };
        self.due
            .push((begin_ns.saturating_sub(ahead_ns), Action::Inject(fault)));
    }

    /// Cancels the faults that would begin at or after their end.
    fn cancel(&mut self, end: &LiveFault) {
        let never_begins = |fault: &LiveFault| {
            !fault.ends && fault.kind.is_ended_by(&end.kind) && fault.span.from >= end.span.from
        };
        self.due
            .retain(|(_, action)| !matches!(action, Action::Inject(fault) if never_begins(fault)));
        // Their processes may have been started ahead.
        self.end_loads(never_begins);
    }

    fn end_loads(&mut self, is_over: impl Fn(&LiveFault) -> bool) {
        self.loads
            .extract_if(.., |(fault, _)| is_over(fault))
            .for_each(|(_, mut child)| kill_and_reap(&mut child));
    }

    fn perform_due(&mut self, run: &Run, grid: &Grid, players: &RoleProcesses<'_>) {
        let now = now_ns();
        let is_due = |(at, _): &mut (u64, Action)| *at <= now + AIM_NS;
        let mut due: Vec<(u64, Action)> = self.due.extract_if(.., is_due).collect();
        due.sort_by_key(|(at, _)| *at);
        for (at, action) in due {
            match action {
                Action::Inject(fault) => match self.inject(&fault, run, grid, players) {
                    Ok(begun_ns) => {
                        let begun = grid.tick_at(begun_ns);
                        let period_s = run.flight_time_s(1);
                        self.delayed.extend(delayed(&fault, begun, period_s));
                    }
                    Err(failure) => {
                        let message = format!("a fault was not injected: {failure}");
                        self.messages.push(message);
                    }
                },
                Action::Continue(pid) => {
                    sleep_through(at);
                    if let Some(place) = self.stopped.iter().position(|known| *known == pid) {
                        self.stopped.swap_remove(place);
                        // It may have ended since.
                        let _ = players.watch.signal(pid, Signal::CONT);
                    }
                }
            }
        }
    }

    /// Returns when it began [ns].
    fn inject(
        &mut self,
        fault: &LiveFault,
        run: &Run,
        grid: &Grid,
        players: &RoleProcesses<'_>,
    ) -> Result<u64, Failure> {
        let tick = fault.span.from;
        // The process of a load is started ahead and waits itself. A signal is sent some ten microseconds after the tick has
        // begun, and later if this thread has no processor.
        if fault.ends || !matches!(fault.kind.target, Target::Processor(_)) {
            sleep_through(grid.begin_of(tick));
        }
        let begun_ns = now_ns();
        match fault.kind.target {
            Target::Processor(_) if fault.ends => {
                self.end_loads(|other| {
                    other.kind.is_ended_by(&fault.kind) && other.span.from < tick
                });
            }
            Target::Processor(kind) => self.load(fault, kind.load(fault.kind.value), run, grid)?,
            Target::Stage(StageKind::Stop, ..) => {
                let for_ns = fault.kind.value.integer();
                let pids = players.signal(fault, Signal::STOP)?;
                // A late stop lasts as long as one at its tick.
                let from_ns = grid.begin_of(tick.max(grid.tick_at(now_ns())));
                // The time is flight time, which may pass slower than the clock.
                let slowdown = u64::from(run.slowdown());
                let until_ns = from_ns.saturating_add(for_ns.saturating_mul(slowdown));
                self.due
                    .extend(pids.iter().map(|pid| (until_ns, Action::Continue(*pid))));
                self.stopped.extend(pids);
            }
            Target::Stage(StageKind::Kill, ..) => {
                let pids = players.signal(fault, Signal::KILL)?;
                self.killed.extend(pids.into_iter().map(|pid| (pid, tick)));
            }
            Target::Message(..)
            | Target::Number(..)
            | Target::Channel(..)
            | Target::Stage(StageKind::Late, ..) => {}
        }
        Ok(begun_ns)
    }

    /// Starts a process that loads the processor during the fault's ticks, and no longer than the flight.
    fn load(
        &mut self,
        fault: &LiveFault,
        (priority, share): (u64, f64),
        run: &Run,
        grid: &Grid,
    ) -> Result<(), Failure> {
        let span = fault.span;
        let until_ns = grid.begin_of(span.to.min(run.last_tick + 1));
        let child = process::signals::child(&self.executable, "cpu-load")
            .args(["--cpu", &self.cpu.to_string()])
            .args(["--priority", &priority.to_string()])
            .args(["--instance", &self.instance])
            .args(["--share", &share.to_string()])
            .args(["--from-ns", &grid.begin_of(span.from).to_string()])
            .args(["--until-ns", &until_ns.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn();
        let child = child.map_err(|e| {
            Failure::failed(format!(
                "cannot start a process that loads the processor: {e}"
            ))
        })?;
        self.loads.push((*fault, child));
        Ok(())
    }

    pub(super) fn forget(&mut self, pid: u32) {
        self.stopped.retain(|stopped| *stopped != pid);
    }

    /// Ends all faults, and injects nothing more: the flight ends.
    pub(super) fn release(&mut self, children: &ChildWatch) {
        self.is_released = true;
        self.due.clear();
        for pid in self.stopped.drain(..) {
            let _ = children.signal(pid, Signal::CONT);
        }
        self.end_loads(|_| true);
    }
}

impl Drop for FaultInjector {
    fn drop(&mut self) {
        self.end_loads(|_| true);
    }
}

/// A fault whose first tick has passed.
fn delayed(fault: &LiveFault, now: u64, period_s: f64) -> Option<InjectedFault> {
    let tick = fault.span.from;
    let delayed_ticks = now.checked_sub(tick).filter(|ticks| *ticks > 0)?;
    let planned = planned_again(&[*fault]);
    let what = planned.iter().map(|it| joined(&it.changes)).collect();
    Some(InjectedFault {
        delayed_ticks: Some(delayed_ticks),
        ..InjectedFault::new(what, tick, None, period_s)
    })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;
    use std::os::unix::process::ExitStatusExt as _;

    use super::*;
    use faults::grammar::Fault;

    /// Runs a test with the fault injector of a flight whose tick 0 begins, on the clock.
    fn with_injector(faults: &[&str], test: impl FnOnce(&Wire, &mut FaultInjector, &Run)) {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let instance = Instance::under(root.path(), "injector").unwrap();
        let overrides = vec![("flight.faults", faults.to_vec().into())];
        let settings = Settings::resolve(None, &overrides).unwrap();
        // Stands in for `ironbird cpu-load`.
        let load = root.path().join("load");
        std::fs::write(&load, "#!/bin/sh\nexec sleep 600\n").unwrap();
        std::fs::set_permissions(&load, std::fs::Permissions::from_mode(0o700)).unwrap();
        let mut injector = FaultInjector::new(&instance, &load, &settings).unwrap();
        let run = Run {
            phase: RunPhase::Flying as u64,
            launcher_pid: u64::from(std::process::id()),
            t0_ns: now_ns(),
            period_ns: 1_000_000,
            sample_time_ns: 1_000_000,
            last_tick: 9000,
            ..Run::default()
        };
        let wire = Wire::open(&instance).unwrap();
        test(&wire, &mut injector, &run);
        drop((injector, wire));
        instance.remove_leftovers().unwrap();
    }

    fn rest(
        (wire, run): (&Wire, &Run),
        injector: &mut FaultInjector,
        watch: &mut ChildWatch,
        pids: &[(Replica, u32)],
    ) {
        let mut players = RoleProcesses { watch, pids };
        injector.rest(wire, Some(run), Duration::from_millis(1), &mut players);
    }

    fn sleeper() -> Child {
        std::process::Command::new("sleep")
            .arg("600")
            .spawn()
            .unwrap()
    }

    fn fault(text: &str) -> LiveFault {
        let fault: Fault = text.parse().unwrap();
        let span = fault.span(1e-3).unwrap();
        fault.changes[0].faults(span).next().unwrap()
    }

    #[test]
    fn an_end_cancels_later_faults_and_after_the_flight_nothing_is_injected() {
        let loads = ["cpu.load=0.5@tick0..tick4500", "cpu.load=0.4@tick5000"];
        with_injector(&loads, |wire, injector, run| {
            let mut children = ChildWatch::default();
            rest((wire, run), injector, &mut children, &[]);
            assert_eq!((injector.loads.len(), injector.due.len()), (1, 1));
            let Pace::Realtime(grid) = run.pace() else {
                panic!()
            };
            injector.schedule(fault("cpu.load=off@tick4000"), &grid);
            let [(_, Action::Inject(left))] = injector.due[..] else {
                panic!("{:?}", injector.due)
            };
            assert!(left.ends && injector.loads.len() == 1, "{left:?}");
            injector.release(&children);
            injector.planned.push(fault("cpu.load=0.5@tick0"));
            rest((wire, run), injector, &mut children, &[]);
            assert_eq!((injector.loads.len(), injector.due.len()), (0, 0));
        });
    }

    /// While a successor takes over, the lock file still names the dead process, whose number may be another's.
    #[test]
    fn a_signal_reaches_the_child_and_not_the_process_that_the_lock_file_names() {
        with_injector(&["inner.kill@tick0"], |wire, injector, run| {
            let (mut inner, mut foreign) = (sleeper(), sleeper());
            let instance = wire.instance();
            let lock = instance.lock(Role::Inner).unwrap();
            let lock_file = instance.directory().join("inner.lock");
            std::fs::write(lock_file, format!("{}\n", foreign.id())).unwrap();
            assert_eq!(instance.pid_of(Role::Inner), Some(foreign.id()));
            let mut children = ChildWatch::default();
            children.watch(&inner);
            let pids = [(Role::Inner.into(), inner.id())];
            rest((wire, run), injector, &mut children, &pids);
            drop(lock);
            assert_eq!(inner.wait().unwrap().signal(), Some(Signal::KILL.as_raw()));
            assert_eq!(injector.killed(inner.id()), Some(0));
            assert!(foreign.try_wait().unwrap().is_none());
            kill_and_reap(&mut foreign);
        });
    }

    #[test]
    fn a_late_stop_ends_later_by_the_ticks_that_it_begins_late() {
        with_injector(&["inner.stop=20ms@tick0"], |wire, injector, run| {
            let (mut inner, mut children) = (sleeper(), ChildWatch::default());
            children.watch(&inner);
            let pids = [(Role::Inner.into(), inner.id())];
            let t0_ns = run.t0_ns - 300 * run.period_ns;
            let late = Run { t0_ns, ..*run };
            rest((wire, &late), injector, &mut children, &pids);
            assert!(matches!(injector.due[..], [(at, Action::Continue(_))] if at > run.t0_ns));
            kill_and_reap(&mut inner);
        });
    }

    #[test]
    fn a_late_fault_is_reported() {
        let fault = fault("inner.stop=20ms@tick100");
        assert_eq!(delayed(&fault, 100, 1e-3), None);
        let late = delayed(&fault, 107, 1e-3).unwrap();
        let faults = ["mixer.kill,inner.stop=20ms", "inner.kill"];
        let faults = faults.map(|what| {
            let mut planned = InjectedFault::new(what.to_owned(), 100, None, 1e-3);
            planned.note(&late);
            planned.delayed_ticks
        });
        assert_eq!(faults, [Some(7), None]);
    }
}
