//! Supervision of a running flight: starts its processes, restarts those that fail, and ends them.
//!
//! ```text
//!                 first tick          flight over            all have ended
//!   Starting ----------------> Flying -----------> Landing ----------------> (return)
//!      |                          |                   |
//!      +--------------------------+-------------------+   a signal, or a failure that ends the flight
//!                                 v
//!                              Stopping ------------> Killing --------------> (return)
//!                                         LANDING, or a second Ctrl-C
//! ```

use std::os::unix::process::ExitStatusExt as _;
use std::process::Child;
use std::time::{Duration, Instant};

use host::sampler::Look;
use ipc::clock::now_ns;
use ipc::instance::Instance;
use ipc::{BlackboardReader, Wire};
use messages::blackboards::{LOCKSTEP, RUN, RolePhase, Run, RunPhase, Status};
use messages::content::NO_TICK;
use messages::realtime::RealtimeMode;
use messages::role::{ROLES, Role};
use process::rt::Raised;
use rustix::process::Signal;

use crate::FlightOptions;
use crate::child_process::{ChildWatch, ENDING, LANDING, Spawner, kill, kill_and_reap, terminate};
use crate::dashboard::Dashboard;
use crate::exit_report::{KillReason, Outcome, ProcessExit};
use crate::fault_injector::{FaultInjector, RoleProcesses};
use crate::hang_detector::{self, HangDetector};
use crate::recordings::Recordings;
use crate::restarts::{MAX_RESTARTS, RestartLimit, Standbys, WITHIN};
use crate::status_line::StatusLine;
use crate::stop_requests::StopRequests;
use analysis::process_failures::{ObservedFailure, Replacement};
use config::Settings;
use errors::Failure;
use errors::output::say;
use host::own_executable;
use recorder::role_statuses::RoleStatuses;
use recorder::run_directory::RunDirectory;

/// How often the supervisor looks after the flight; oftener if it restarts roles.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How long processes may take to be ready before the user is told, and a restarted one to fly.
const GETTING_READY: Duration = Duration::from_secs(10);

pub(super) struct FlightSupervisor {
    spawner: Spawner,
    children: Vec<RoleProcess>,
    child_watch: ChildWatch,
    standbys: Standbys,
    restarts_roles: bool,
    restart_limits: [RestartLimit; ROLES.len()],
    /// Failed processes whose roles are to be restarted, and when.
    due: Vec<(ProcessExit, Instant)>,
    /// Whether the supervisor may raise its own priority while it restarts roles.
    may_be_raised: bool,
    raised: Option<Raised>,
    hang_detector: Option<HangDetector>,
    last_look: Instant,
    recordings: Recordings,
    fault_injector: FaultInjector,
    /// The status blackboards of all roles, from the first tick on.
    role_statuses: Option<RoleStatuses>,
    dashboard: Option<Dashboard>,
    wire: Wire,
    status_line: StatusLine,
    phase: Phase,
    outcome: Outcome,
}

/// A child that plays a role.
struct RoleProcess {
    role: Role,
    child: Child,
    /// Why the supervisor has killed it.
    killed: Option<KillReason>,
    /// A restarted process that was ready too late for the flight and is being ended.
    is_dismissed: bool,
}

impl RoleProcess {
    const fn new(role: Role, child: Child) -> Self {
        Self {
            role,
            child,
            killed: None,
            is_dismissed: false,
        }
    }

    fn kill(&mut self, reason: KillReason) {
        self.killed.get_or_insert(reason);
        kill(&mut self.child);
    }
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// The processes get ready.
    Starting {
        since: Instant,
        is_reported: bool,
    },
    Flying,
    /// The flight is over; the processes end by themselves.
    Landing {
        since: Instant,
    },
    /// The processes were asked to end.
    Stopping {
        since: Instant,
    },
    /// The processes were killed.
    Killing,
}

impl Phase {
    /// Whether the supervisor ends the processes.
    const fn is_ending(self) -> bool {
        matches!(self, Self::Stopping { .. } | Self::Killing)
    }
}

impl FlightSupervisor {
    /// Starts all processes. The calling thread must stay until they have ended: they take its end for the supervisor's.
    pub(super) fn start(
        instance: &Instance,
        directory: &RunDirectory,
        settings: &Settings,
        options: &FlightOptions,
    ) -> Result<Self, Failure> {
        // Before any role starts, because it removes what dead processes of the instance left.
        let wire = Wire::open(instance)?;
        let (now, executable) = (Instant::now(), own_executable()?);
        let mut supervisor = Self {
            fault_injector: FaultInjector::new(instance, &executable, settings)?,
            spawner: Spawner::new(executable, instance, directory, options),
            children: Vec::new(),
            child_watch: ChildWatch::default(),
            standbys: Standbys::new(now),
            restarts_roles: options.restarts_roles,
            restart_limits: ROLES.map(|_| RestartLimit::new(now)),
            due: Vec::new(),
            may_be_raised: settings.realtime()?.mode != RealtimeMode::Off,
            raised: None,
            hang_detector: None,
            last_look: now,
            recordings: Recordings::new(directory, settings, instance),
            role_statuses: None,
            dashboard: None,
            wire,
            status_line: StatusLine::new(&directory.path, settings.flight.duration_s),
            phase: Phase::Starting {
                since: now,
                is_reported: false,
            },
            outcome: Outcome::default(),
        };
        for role in ROLES {
            let child = supervisor.spawner.start(role, directory)?;
            supervisor.child_watch.watch(&child);
            supervisor.children.push(RoleProcess::new(role, child));
            supervisor.standbys.delay(role, now);
        }
        if options.shows_dashboard {
            supervisor.dashboard = Some(Dashboard::open(&supervisor.spawner.executable, instance)?);
        }
        Ok(supervisor)
    }

    /// Supervises the flight until every process has ended.
    pub(super) fn run(&mut self, requests: &mut StopRequests) -> Result<Outcome, Failure> {
        let mut run_blackboard: Option<BlackboardReader<Run>> = None;
        let mut shown = Instant::now();
        while !self.children.is_empty() {
            self.rest(run_blackboard.as_ref().map(BlackboardReader::get));
            requests.poll();
            self.outcome.interrupted |= requests.is_requested;
            let exits = self.reap(requests.is_requested)?;
            // After reaping: a process that ended with the flight has seen the blackboard announce the end.
            run_blackboard =
                run_blackboard.or_else(|| self.wire.blackboard_reader(RUN).ok().flatten());
            let run = run_blackboard.as_ref().map(BlackboardReader::get);
            self.observe(run.as_ref())?;
            self.take_exits(exits, run.as_ref());
            self.next_phase(run.as_ref(), requests.is_urgent);
            self.act(run.as_ref())?;
            let terminal_taken = self.dashboard.as_mut().is_some_and(Dashboard::is_open);
            if let Some(run) = run.filter(|_| shown.elapsed() >= LOOK_EVERY) {
                shown = Instant::now();
                self.status_line.show(&run, terminal_taken);
            }
        }
        self.raised = None;
        self.standbys
            .end(&mut self.child_watch, &self.wire, LANDING);
        if let Some(dashboard) = &mut self.dashboard {
            dashboard.close();
        }
        self.status_line.clear();
        Ok(std::mem::take(&mut self.outcome))
    }

    /// The directory with the flight's report, when all processes have ended.
    pub(super) fn recorded(&self) -> Result<RunDirectory, Failure> {
        self.recordings.settle()
    }

    /// Injects faults until the next look.
    fn rest(&mut self, run: Option<Run>) {
        let look_every = if self.restarts_roles {
            hang_detector::LOOK_EVERY
        } else {
            LOOK_EVERY
        };
        let pids = self.children.iter().map(|it| (it.role, it.child.id()));
        let pids: Vec<(Role, u32)> = pids.collect();
        let mut players = RoleProcesses {
            watch: &mut self.child_watch,
            pids: &pids,
        };
        self.fault_injector
            .rest(&self.wire, run.as_ref(), look_every, &mut players);
    }

    /// Reaps the children that have ended; returns how each did.
    fn reap(&mut self, interrupted: bool) -> Result<Vec<ProcessExit>, Failure> {
        let mut exits = Vec::new();
        let mut next = 0;
        while let Some(process) = self.children.get_mut(next) {
            let (role, pid) = (process.role, process.child.id());
            let status = self.child_watch.reap(&mut process.child);
            let status =
                status.map_err(|e| Failure::failed(format!("cannot wait for {role}: {e}")))?;
            let Some(status) = status else {
                next += 1;
                continue;
            };
            let process = self.children.remove(next);
            let by_fault = || self.fault_injector.killed(pid).map(KillReason::Fault);
            // It may have ended by itself before the signal came.
            let is_killed = status.signal() == Some(Signal::KILL.as_raw());
            let killed = process.killed.or_else(by_fault).filter(|_| is_killed);
            self.fault_injector.forget(pid);
            if !process.is_dismissed {
                exits.push(ProcessExit {
                    role,
                    pid,
                    status,
                    interrupted,
                    killed,
                    not_restarted: None,
                });
            }
        }
        self.standbys
            .reap(&mut self.child_watch, &self.wire, Instant::now());
        Ok(exits)
    }

    /// The run, if it is this supervisor's, flies, has ticks to come, and is not being ended.
    fn in_flight<'a>(&self, run: Option<&'a Run>) -> Option<&'a Run> {
        run.filter(|run| {
            !self.phase.is_ending()
                && is_ours(run)
                && has_taken_off(run)
                && run.tick < run.last_tick
        })
    }

    /// Notes what the blackboards show of the flight.
    fn observe(&mut self, run: Option<&Run>) -> Result<(), Failure> {
        if self.outcome.outlasted.is_empty()
            && run.is_some_and(|run| is_ours(run) && run.phase() == RunPhase::Closed)
        {
            self.outcome.outlasted = self.roles();
        }
        if self.role_statuses.is_none() && self.in_flight(run).is_some() {
            self.role_statuses = Some(RoleStatuses::open(&self.wire)?);
        }
        self.note_arrivals();
        Ok(())
    }

    fn take_exits(&mut self, exits: Vec<ProcessExit>, run: Option<&Run>) {
        if matches!(self.phase, Phase::Killing) {
            return;
        }
        let is_early = run.is_some_and(|run| run.phase() != RunPhase::Closed);
        for exit in exits {
            let unresolved = match self.in_flight(run) {
                Some(run) if !exit.was_interrupted() => self.schedule_restart(exit, run),
                _ => Some(exit),
            };
            if let Some(exit) = unresolved {
                self.outcome.take(exit, self.phase.is_ending(), is_early);
            }
        }
    }

    fn next_phase(&mut self, run: Option<&Run>, is_urgent: bool) {
        let now = Instant::now();
        if let Phase::Starting { since, is_reported } = &mut self.phase {
            let is_late = since.elapsed() > GETTING_READY;
            if is_late && !std::mem::replace(is_reported, is_late) {
                say("still waiting for all processes to be ready; plant.log says for which\n");
            }
            if run.is_some_and(has_taken_off) {
                self.outcome.flown = true;
                self.phase = Phase::Flying;
            }
        }
        if !self.phase.is_ending() && self.outcome.is_over() {
            self.request_end();
            self.phase = Phase::Stopping { since: now };
        }
        match self.phase {
            Phase::Starting { .. } | Phase::Flying if run.is_some_and(is_over) => {
                // Before anything waits for a process that a fault has stopped.
                self.fault_injector.release(&self.child_watch);
                self.phase = Phase::Landing { since: now };
            }
            Phase::Stopping { since } if since.elapsed() > LANDING && !is_urgent => {
                self.outcome.killed = self.roles();
                self.phase = Phase::Killing;
            }
            _ if is_urgent => self.phase = Phase::Killing,
            _ => {}
        }
    }

    fn act(&mut self, run: Option<&Run>) -> Result<(), Failure> {
        match (self.phase, run) {
            (Phase::Flying, Some(run))
                if self.restarts_roles && self.in_flight(Some(run)).is_some() =>
            {
                self.maintain_roles(run)?;
            }
            (Phase::Landing { since }, Some(run)) => self.land(since.elapsed(), run.phase()),
            (Phase::Killing, _) => self.children.iter_mut().for_each(|it| kill(&mut it.child)),
            _ => {}
        }
        Ok(())
    }

    /// Restarts failed roles, kills those that hang, and keeps hot standbys.
    fn maintain_roles(&mut self, run: &Run) -> Result<(), Failure> {
        if self.may_be_raised {
            self.raised.get_or_insert_with(Raised::now);
        }
        self.restart_due()?;
        self.kill_hanging(run);
        self.standbys
            .replenish(&self.spawner, &mut self.child_watch, Instant::now());
        Ok(())
    }

    /// Kills, step by step, what does not end after the flight.
    fn land(&mut self, over: Duration, run_phase: RunPhase) {
        self.dismiss_latecomers();
        self.standbys.dismiss();
        // The plant first if it has not closed the run: the others end when it is gone. If it does not go, a stage that
        // computes without end at a higher priority keeps it from its processor, and so from its end.
        let waits_for_plant = over <= ENDING + LANDING
            && run_phase != RunPhase::Closed
            && self.roles().contains(&Role::Plant);
        for process in &mut self.children {
            if over > LANDING && process.is_dismissed {
                process.kill(KillReason::AfterFlight);
            }
            if over > LANDING && is_stopped(process.child.id()) {
                process.kill(KillReason::Hang);
            }
            if over > ENDING && (!waits_for_plant || process.role == Role::Plant) {
                process.kill(KillReason::AfterFlight);
            }
        }
    }

    fn roles(&self) -> Vec<Role> {
        self.children.iter().map(|process| process.role).collect()
    }

    /// What a role's blackboard shows, if the process with this number has written it.
    fn status_of(&self, role: Role, pid: u32) -> Option<Status> {
        self.role_statuses.as_ref()?.of_process(role, pid)
    }

    /// Kills loops that hang, and restarted processes that do not come to fly.
    fn kill_hanging(&mut self, run: &Run) {
        let since = std::mem::replace(&mut self.last_look, Instant::now()).elapsed();
        let Some(statuses) = &self.role_statuses else {
            return;
        };
        let hanging = self
            .hang_detector
            .get_or_insert_with(|| HangDetector::new(Duration::from_nanos(run.period_ns)))
            .hanging(&statuses.loops(), since, Look::at);
        for process in &mut self.children {
            let (role, pid) = (process.role, process.child.id());
            let restart = &self.restart_limits[role as usize];
            let is_late = |timeout| restart.is_restarted() && restart.age() > timeout;
            let hangs = match statuses.of_process(role, pid) {
                Some(status) if status.phase() == RolePhase::Flying => hanging.contains(&role),
                // A process that a signal has stopped on its way does not arrive.
                _ => {
                    is_late(GETTING_READY)
                        || (is_late(hang_detector::HANG_TIMEOUT) && is_stopped(pid))
                }
            };
            if hangs {
                process.kill(KillReason::Hang);
            }
        }
    }

    /// Asks restarted processes to end that have not come to fly before the flight was over.
    fn dismiss_latecomers(&mut self) {
        self.due.clear();
        for process in &mut self.children {
            let statuses = self.role_statuses.as_ref();
            let status = statuses.and_then(|it| it.of_process(process.role, process.child.id()));
            let phase = status.map(|status| status.phase());
            let has_flown = matches!(phase, Some(RolePhase::Flying | RolePhase::Landed));
            let is_restarted = self.restart_limits[process.role as usize].is_restarted();
            if is_restarted && !has_flown && !process.is_dismissed {
                process.is_dismissed = true;
                terminate(&process.child);
            }
        }
    }

    fn request_end(&mut self) {
        self.due.clear();
        self.standbys.dismiss();
        self.fault_injector.release(&self.child_watch);
        self.children.iter().for_each(|it| terminate(&it.child));
    }

    /// Notes that a process has failed in flight, and schedules the restart of its role; returns the exit if the role
    /// cannot be restarted.
    fn schedule_restart(&mut self, mut exit: ProcessExit, run: &Run) -> Option<ProcessExit> {
        let status = self.status_of(exit.role, exit.pid);
        self.outcome.grid = Some(run.pace());
        let mut noted = ObservedFailure {
            role: exit.role.name().into(),
            epoch: status.map_or(0, |status| status.epoch),
            how: exit.cause(),
            noticed_ns: now_ns(),
            way: Replacement::default(),
        };
        let mut due = None;
        if self.restarts_roles && exit.role == Role::Plant {
            exit.not_restarted = Some("a plant cannot be started again in flight".into());
        } else if self.restarts_roles {
            due = self.restart_limits[exit.role as usize].due(Instant::now());
            exit.not_restarted = due.is_none().then(|| {
                let within_s = WITHIN.as_secs();
                format!(
                    "it has been started again {MAX_RESTARTS} times within {within_s} s, which is the most"
                )
            });
        }
        if due.is_some() {
            // What it held is then free for its successor.
            self.wire.remove_dead();
            noted.way.cleaned_ns = now_ns();
        }
        self.outcome.noted.push(noted);
        let Some(due) = due else {
            return Some(exit);
        };
        self.due.push((exit, due));
        None
    }

    /// Restarts the roles that are due, or activates their standbys.
    fn restart_due(&mut self) -> Result<(), Failure> {
        let now = Instant::now();
        for (exit, _) in self.due.extract_if(.., |(_, due)| *due <= now) {
            let role = exit.role;
            let how = exit.describe("");
            if role == Role::Record
                && let Err(failure) = self.recordings.begin_another()
            {
                say(&format!(
                    "{how}; the flight goes on without a recorder: {failure}\n"
                ));
                continue;
            }
            let standby = self.standbys.activate(role);
            let is_standby = standby.is_some();
            let child = match standby {
                Some(child) => child,
                None => {
                    let child = self.spawner.start(role, self.recordings.newest())?;
                    self.child_watch.watch(&child);
                    child
                }
            };
            self.restart_limits[role as usize].restarted(now);
            let mut noted = self.outcome.noted.iter_mut();
            if let Some(noted) = noted.rfind(|noted| noted.role == role.name()) {
                (noted.way.pid, noted.way.is_spare) = (child.id(), is_standby);
            }
            self.children.push(RoleProcess::new(role, child));
            self.standbys.delay(role, now);
            self.status_line.clear();
            let by = if is_standby {
                ": its hot standby takes over"
            } else {
                ""
            };
            say(&format!("{how}; it is started again{by}\n"));
        }
        Ok(())
    }

    /// Notes when restarted processes came to fly.
    fn note_arrivals(&mut self) {
        let mut noted = std::mem::take(&mut self.outcome.noted);
        for noted in &mut noted {
            let way = &mut noted.way;
            let role = ROLES.into_iter().find(|role| role.name() == noted.role);
            if let Some(role) = role.filter(|_| way.pid != 0 && way.arrival.armed_ns == 0)
                && let Some(status) = self.status_of(role, way.pid)
            {
                way.arrival = status.arrival;
            }
        }
        self.outcome.noted = noted;
    }
}

impl Drop for FlightSupervisor {
    fn drop(&mut self) {
        for process in &mut self.children {
            kill(&mut process.child);
        }
        for process in &mut self.children {
            kill_and_reap(&mut process.child);
        }
        self.standbys
            .end(&mut self.child_watch, &self.wire, Duration::ZERO);
    }
}

fn is_ours(run: &Run) -> bool {
    run.launcher_pid == u64::from(std::process::id())
}

fn has_taken_off(run: &Run) -> bool {
    run.phase() == RunPhase::Flying && run.tick != NO_TICK
}

/// Whether this supervisor's flight is over: its plant has announced it, or the clock shows it; in lockstep only the
/// plant can.
fn is_over(run: &Run) -> bool {
    let end_ns = run
        .last_tick
        .wrapping_add(1)
        .wrapping_mul(run.period_ns)
        .wrapping_add(run.t0_ns);
    let is_past = run.phase() == RunPhase::Flying && run.period_ns != LOCKSTEP && now_ns() > end_ns;
    is_ours(run) && (run.phase() == RunPhase::Closed || is_past)
}

/// Whether a signal has stopped a child.
fn is_stopped(pid: u32) -> bool {
    Look::at(u64::from(pid)).is_some_and(Look::is_stopped)
}
