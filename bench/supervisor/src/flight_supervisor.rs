//! Supervision of a running flight: starts its processes, restarts those that fail, and ends them.
//!
//! ```text
//!                 first tick          flight over            all have ended
//!   Starting ----------------> Flying -----------> Landing ----------------> (return)
//!      |                          |                   |
//!      +--------------------------+-------------------+   a signal, or a failure that ends the flight
//!                                 v
//!                              Stopping ------------> Killing --------------> (return)
//!                                         STOP_TIMEOUT, or a second Ctrl-C
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::process::ExitStatusExt as _;
use std::path::PathBuf;
use std::process::Child;
use std::time::{Duration, Instant};

use host::sampler::Look;
use ipc::clock::now_ns;
use ipc::instance::Instance;
use ipc::{Blackboard, BlackboardReader, Wire};
use messages::blackboards::{
    LOCKSTEP, RUN, RolePhase, Run, RunPhase, SUPERVISION, SettingsText, Status, Subject,
    Supervision,
};
use messages::channels::{REDUNDANCY, Redundancy};
use messages::content::NO_TICK;
use messages::grid::Pace;
use messages::realtime::{RealtimeMode, RealtimeSettings};
use messages::role::{CHANNEL_ROLES, Channel, MOST_CHANNELS, Replica, Role};
use process::rt::{OffLoops, Raised};
use rustix::process::{Signal, getpid, set_child_subreaper};

use crate::child_process::{
    ChildWatch, LANDING_TIMEOUT, STOP_TIMEOUT, Spawner, kill, kill_and_reap, reap_left, terminate,
};
use crate::dashboard::Dashboard;
use crate::exit_report::{KillReason, Outcome, ProcessExit};
use crate::fault_injector::{FaultInjector, RoleProcesses};
use crate::hang_detector::{self, HangDetector};
use crate::recordings::Recordings;
use crate::restarts::{MAX_RESTARTS, RestartLimit, WITHIN};
use crate::status_line::StatusLine;
use crate::stop_requests::StopRequests;
use analysis::process_failures::{ObservedFailure, Replacement};
use config::Settings;
use errors::Failure;
use host::{Machine, own_executable};
use recorder::role_statuses::RoleStatuses;
use recorder::run_directory::RunDirectory;

/// Polling period of the supervisor; shorter before the first tick, and if it restarts roles.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Why a process is not started again beside another channel.
const UNSAVED: &str = "no state of its law was saved from which a new process could continue";
/// In how many ticks a channel is outvoted before its processes are killed.
const OUTVOTED_TICKS: u64 = 3;
/// How long restarted processes are not killed for being outvoted.
const GETTING_IN_STEP: Duration = Duration::from_millis(500);
/// Longest wait for the memory and files of a killed process to be free.
const RELEASED: Duration = Duration::from_millis(200);
/// How often the supervisor looks how far the processes have come, before a flight begins.
const LOOK_AT_START: Duration = Duration::from_secs(1);
/// How long a restarted process may take to fly.
const GETTING_READY: Duration = Duration::from_secs(10);

pub(super) struct FlightSupervisor {
    spawner: Spawner,
    children: Vec<RoleProcess>,
    child_watch: ChildWatch,
    channels: usize,
    restarts_roles: bool,
    restart_limits: BTreeMap<Replica, RestartLimit>,
    /// Failed processes whose roles are to be restarted, and when.
    due: Vec<(ProcessExit, Instant)>,
    /// Releaser processes of killed stages, which are to be reaped.
    left: Vec<u32>,
    /// While it restarts roles, unless the flight does without real time: its own higher priority.
    raised: Option<Raised>,
    realtime: RealtimeSettings,
    /// While it restarts roles: keeps that work off the loops' processors.
    off_loops: Option<OffLoops>,
    hang_detector: Option<HangDetector>,
    last_look: Instant,
    pub(super) recordings: Recordings,
    fault_injector: FaultInjector,
    /// The plant's account of the channels, of a flight with three.
    redundancy: Option<BlackboardReader<Redundancy>>,
    /// Ticks in which each channel was outvoted, at the time of its last kill for it.
    outvoted: [u64; MOST_CHANNELS],
    /// The status blackboards of all roles, from when they have armed.
    role_statuses: Option<RoleStatuses>,
    dashboard: Option<Dashboard>,
    /// Servers of the flight, with what they serve.
    servers: Vec<(&'static str, Dashboard)>,
    supervision: Supervision,
    supervision_blackboard: Blackboard<Supervision>,
    /// Newest tick that the plant published.
    tick: u64,
    wire: Wire,
    status_line: StatusLine,
    phase: Phase,
    start_timeout: Duration,
    progress: StartProgress,
    outcome: Outcome,
    /// Number of kills for lack of memory at the last two looks. A killed process is one of them if the number has risen since.
    memory_kills: [u64; 2],
}

/// A child that plays a role.
struct RoleProcess {
    replica: Replica,
    child: Child,
    /// `None` if the system does not say.
    program: Option<(u64, u64)>,
    killed: Option<KillReason>,
    /// A restarted process that was ready too late for the flight and is being ended.
    is_dismissed: bool,
}

impl RoleProcess {
    fn new(replica: Replica, child: Child) -> Self {
        Self {
            replica,
            program: program_of(child.id()),
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

/// How far the processes have come before a flight begins.
#[derive(Default)]
struct StartProgress {
    /// Of each process, the number of its [`RolePhase`]; `None` before it has its place.
    phases: Vec<Option<u64>>,
    /// Time since one of them came further.
    idle: Duration,
    /// Run time of the one that is least far [ns].
    ran_ns: u64,
}

/// A process that serves the flight to another program, and prints in its first line where.
#[derive(Clone, Debug)]
pub struct ServerProcess {
    /// Its service, in words.
    pub what: &'static str,
    /// The command of `ironbird`, and its arguments except for the instance.
    pub command: &'static str,
    pub arguments: Vec<String>,
}

#[derive(Clone, Debug)]
pub struct FlightOptions {
    pub instance: String,
    /// Whether roles that fail in flight are restarted.
    pub restarts_roles: bool,
    pub shows_dashboard: bool,
    pub servers: Vec<ServerProcess>,
    /// Where the recorder writes the states a second time.
    pub states: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Starting,
    Flying,
    /// The flight is over; the processes end by themselves.
    Landing {
        since: Instant,
    },
    Stopping {
        since: Instant,
    },
    Killing,
}

impl Phase {
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
        // If that is refused, init reaps what killed children leave.
        let _ = set_child_subreaper(Some(getpid()));
        let (now, executable) = (Instant::now(), own_executable()?);
        let mut supervisor = Self {
            fault_injector: FaultInjector::new(instance, &executable, settings)?,
            spawner: Spawner {
                executable,
                instance: instance.name().into(),
                settings_file: directory.settings_file(),
                directory: directory.path.clone(),
                states: options.states.clone(),
                allowed_cpus: Vec::new(),
            },
            children: Vec::new(),
            child_watch: ChildWatch::default(),
            channels: settings.rt.channels,
            restarts_roles: options.restarts_roles,
            restart_limits: Replica::all(settings.rt.channels)
                .map(|replica| (replica, RestartLimit::new(now)))
                .collect(),
            due: Vec::new(),
            left: Vec::new(),
            raised: None,
            realtime: settings.realtime()?,
            off_loops: None,
            hang_detector: None,
            last_look: now,
            recordings: Recordings {
                first: directory.clone(),
                later: Vec::new(),
                settings: settings.clone(),
                instance: instance.name().into(),
            },
            redundancy: None,
            outvoted: [0; MOST_CHANNELS],
            role_statuses: None,
            dashboard: None,
            servers: Vec::new(),
            supervision: Supervision::default(),
            supervision_blackboard: wire.blackboard(SUPERVISION)?,
            tick: 0,
            wire,
            status_line: StatusLine::new(&directory.path, settings.flight.duration_s),
            phase: Phase::Starting,
            start_timeout: Duration::from_secs_f64(settings.start_timeout_s()?),
            progress: StartProgress::default(),
            outcome: Outcome::default(),
            memory_kills: [memory_kills(); 2],
        };
        for replica in Replica::all(supervisor.channels) {
            let child = supervisor.spawner.start(replica, directory)?;
            supervisor.child_watch.watch(&child);
            supervisor.children.push(RoleProcess::new(replica, child));
        }
        supervisor.publish_directory();
        for server in &options.servers {
            let (process, address) =
                Dashboard::serve(&supervisor.spawner.executable, instance, server)?;
            supervisor.servers.push((server.what, process));
            // Not among the events: a page shows those, and its address contains the token.
            supervisor.status_line.tell(&address);
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
            if let Some(run) = run.filter(has_taken_off) {
                self.tick = run.tick;
            }
            self.observe(run.as_ref())?;
            self.take_exits(exits, run.as_ref());
            self.next_phase(run.as_ref(), requests.is_urgent);
            self.act(run.as_ref())?;
            let is_taken = self.dashboard.as_mut().is_some_and(Dashboard::has_terminal);
            self.status_line.set_taken(is_taken);
            let failed = self
                .servers
                .extract_if(.., |(_, server)| server.has_failed());
            for (what, _) in failed {
                let gone =
                    format!("the server of {what} has failed; the flight goes on without it");
                self.status_line.tell(&gone);
            }
            if let Some(run) = run.filter(|_| shown.elapsed() >= LOOK_EVERY) {
                shown = Instant::now();
                self.memory_kills = [self.memory_kills[1], memory_kills()];
                self.status_line.show(&run);
            }
        }
        (self.raised, self.off_loops) = (None, None);
        let servers = self.servers.iter_mut().map(|(_, server)| server);
        self.dashboard
            .iter_mut()
            .chain(servers)
            .for_each(Dashboard::close);
        self.status_line.set_taken(false);
        self.status_line.clear();
        Ok(std::mem::take(&mut self.outcome))
    }

    /// Injects faults until the next look.
    fn rest(&mut self, run: Option<Run>) {
        let look_every = if self.restarts_roles || matches!(self.phase, Phase::Starting) {
            hang_detector::LOOK_EVERY
        } else {
            LOOK_EVERY
        };
        let pids = self.children.iter().map(|it| (it.replica, it.child.id()));
        let pids: Vec<(Replica, u32)> = pids.collect();
        let mut players = RoleProcesses {
            watch: &mut self.child_watch,
            pids: &pids,
        };
        self.fault_injector
            .rest(&self.wire, run.as_ref(), look_every, &mut players);
        for fault in std::mem::take(&mut self.fault_injector.delayed) {
            let what = render::sentences::fault(&fault);
            let why = "the supervisor was notified, or scheduled, late";
            self.announce(Subject::Fault, &format!("the fault {what}: {why}"));
            self.outcome.delayed.push(fault);
        }
        for message in std::mem::take(&mut self.fault_injector.messages) {
            self.announce(Subject::Fault, &message);
        }
    }

    /// Publishes where the newest recorder writes.
    fn publish_directory(&mut self) {
        let directory = std::path::absolute(&self.recordings.newest().path);
        let text = directory
            .ok()
            .and_then(|path| SettingsText::new(path.to_str()?));
        self.supervision.directory = text.unwrap_or_default();
        self.supervision_blackboard.put(self.supervision);
    }

    /// Publishes what has happened, for the dashboards, and prints it.
    fn announce(&mut self, subject: Subject, message: &str) {
        self.supervision.add(self.tick, subject, message);
        self.supervision_blackboard.put(self.supervision);
        self.status_line.tell(message);
    }

    /// Reaps the children that have ended; returns how each did.
    fn reap(&mut self, interrupted: bool) -> Result<Vec<ProcessExit>, Failure> {
        let mut exits = Vec::new();
        let mut next = 0;
        while let Some(process) = self.children.get_mut(next) {
            let (replica, pid) = (process.replica, process.child.id());
            let status = self.child_watch.reap(&mut process.child);
            let status =
                status.map_err(|e| Failure::failed(format!("cannot wait for {replica}: {e}")))?;
            let Some(status) = status else {
                next += 1;
                continue;
            };
            let process = self.children.remove(next);
            let left = self.status_of(replica, pid).map_or(0, |it| it.releaser);
            self.left
                .extend(u32::try_from(left).ok().filter(|pid| *pid > 0));
            let by_fault = || self.fault_injector.killed(pid).map(KillReason::Fault);
            // It may have ended by itself before the signal came.
            let is_killed = status.signal() == Some(Signal::KILL.as_raw());
            let by_memory =
                || (memory_kills() > self.memory_kills[0]).then_some(KillReason::Memory);
            let killed = process.killed.or_else(by_fault).or_else(by_memory);
            let killed = killed.filter(|_| is_killed);
            let [earlier, newest] = self.memory_kills;
            let earlier = earlier + u64::from(killed == Some(KillReason::Memory));
            self.memory_kills = [earlier, newest.max(earlier)];
            self.fault_injector.forget(pid);
            if !process.is_dismissed {
                exits.push(ProcessExit {
                    replica,
                    pid,
                    status,
                    interrupted,
                    killed,
                    not_restarted: None,
                });
            }
        }
        self.left.retain(|pid| !reap_left(*pid));
        Ok(exits)
    }

    /// The run, if it is this supervisor's, flies, and is not being ended.
    fn in_flight<'a>(&self, run: Option<&'a Run>) -> Option<&'a Run> {
        run.filter(|run| self.is_flown(run) && run.phase() == RunPhase::Flying)
    }

    /// Whether the run is this supervisor's, has taken off, and is not being ended.
    fn is_flown(&self, run: &Run) -> bool {
        !self.phase.is_ending() && is_ours(run) && run.tick != NO_TICK
    }

    /// Notes what the blackboards show of the flight.
    fn observe(&mut self, run: Option<&Run>) -> Result<(), Failure> {
        if self.outcome.outlasted.is_empty()
            && run.is_some_and(|run| is_ours(run) && run.phase() == RunPhase::Closed)
        {
            self.outcome.outlasted = self.replicas();
        }
        // Before the first tick, because opening them takes some milliseconds.
        let is_armed = |run: &Run| is_ours(run) && run.phase() == RunPhase::Flying;
        if self.role_statuses.is_none() && run.is_some_and(is_armed) {
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
        // After the last tick, processes of the other channels may have ended in order in the same look.
        let landed = exits.iter().filter(|it| it.is_in_order());
        let landed: Vec<Replica> = landed.map(|it| it.replica).collect();
        for exit in exits {
            // A fault acted within the flight, even if the process is reaped after it.
            let in_flight = match exit.killed {
                Some(KillReason::Fault(_)) => run.filter(|run| self.is_flown(run)),
                _ => self.in_flight(run),
            };
            let in_flight = in_flight.filter(|_| !exit.was_interrupted());
            let unresolved = match in_flight {
                Some(run) => self.schedule_restart(exit, run),
                None => Some(exit),
            };
            match unresolved {
                Some(exit) if in_flight.is_some_and(|run| self.is_covered(&exit, &landed, run)) => {
                    self.announce(
                        Subject::Process,
                        &format!(
                            "{}; the flight goes on without channel {}",
                            exit.describe(""),
                            exit.replica.channel
                        ),
                    );
                }
                Some(exit) => self.outcome.take(exit, self.phase.is_ending(), is_early),
                None => {}
            }
        }
    }

    /// Whether the flight goes on without a process that has ended: another channel has all of its own, and its laws are
    /// those that fly, or may take over.
    fn is_covered(&self, exit: &ProcessExit, landed: &[Replica], run: &Run) -> bool {
        let plays = |replica| {
            landed.contains(&replica) || self.children.iter().any(|it| it.replica == replica)
        };
        let is_whole = |channel| {
            CHANNEL_ROLES
                .map(|role| Replica::new(role, channel))
                .into_iter()
                .all(plays)
        };
        let replica = exit.replica;
        let settings = &self.recordings.settings;
        let groups = settings.groups();
        let redundancy = self.wire.blackboard_reader::<Redundancy>(REDUNDANCY);
        let redundancy = redundancy.ok().flatten();
        let active = redundancy.map_or(Channel::A, |it| it.get().active_channel());
        // In lockstep the plant waits for every channel.
        run.pace() != Pace::Lockstep
            && CHANNEL_ROLES.contains(&replica.role)
            && Channel::first(self.channels)
                .filter(|it| {
                    settings.simplex.enabled || groups[*it as usize] == groups[active as usize]
                })
                .any(|it| it != replica.channel && is_whole(it))
    }

    fn next_phase(&mut self, run: Option<&Run>, is_urgent: bool) {
        let now = Instant::now();
        if matches!(self.phase, Phase::Starting) && run.is_some_and(has_taken_off) {
            self.outcome.flown = true;
            self.phase = Phase::Flying;
        }
        if !self.phase.is_ending() && self.outcome.is_over() {
            self.request_end();
            self.phase = Phase::Stopping { since: now };
        }
        match self.phase {
            Phase::Starting | Phase::Flying if run.is_some_and(is_over) => {
                // Before anything waits for a process that a fault has stopped.
                self.fault_injector.release(&self.child_watch);
                self.phase = Phase::Landing { since: now };
            }
            Phase::Stopping { since } if since.elapsed() > STOP_TIMEOUT && !is_urgent => {
                self.outcome.killed = self.replicas();
                self.phase = Phase::Killing;
            }
            _ if is_urgent => self.phase = Phase::Killing,
            _ => {}
        }
    }

    fn act(&mut self, run: Option<&Run>) -> Result<(), Failure> {
        self.kill_replaced();
        match (self.phase, run) {
            (Phase::Starting, run) => self.watch_start(run)?,
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

    /// Kills the process that is least far, if none has come further for too long. While it waits for a processor or a
    /// disk, its time passes more slowly.
    fn watch_start(&mut self, run: Option<&Run>) -> Result<(), Failure> {
        let elapsed = self.last_look.elapsed();
        if elapsed < LOOK_AT_START {
            return Ok(());
        }
        self.last_look = Instant::now();
        let statuses = RoleStatuses::open(&self.wire)?;
        // The plant does not arm itself: it waits for the others.
        let is_opening = run.is_some_and(|run| run.phase() == RunPhase::Opening);
        let phase = |it: &RoleProcess| {
            let status = statuses.of_process(it.replica, it.child.id());
            let phase = status.map(|status| status.phase() as u64);
            let waits = it.replica.role == Role::Plant && is_opening;
            phase.max(waits.then_some(RolePhase::Armed as u64))
        };
        let phases: Vec<Option<u64>> = self.children.iter().map(phase).collect();
        let children = self.children.iter_mut().zip(&phases);
        let Some((process, phase)) = children.min_by_key(|(_, phase)| **phase) else {
            return Ok(());
        };
        let look = Look::at(u64::from(process.child.id()));
        let ran_ns = look.map_or(0, |look| look.ran_ns);
        let before = std::mem::replace(&mut self.progress.ran_ns, ran_ns);
        let ran = Duration::from_nanos(ran_ns.saturating_sub(before));
        let waits = |look: Look| look.state == 'D' || look.state == 'R' && ran < elapsed / 2;
        self.progress.idle += if look.is_some_and(waits) {
            elapsed / 10
        } else {
            elapsed
        };
        if phases != self.progress.phases {
            self.progress = StartProgress {
                phases,
                ran_ns,
                idle: Duration::ZERO,
            };
        } else if self.progress.idle > self.start_timeout {
            process.kill(KillReason::Late(match phase {
                _ if look.is_some_and(Look::is_stopped) => "a signal has stopped it",
                None => "it has not read its settings and made its law",
                Some(0) => "it has not made its ports",
                Some(_) => "it has not connected to the other processes",
            }));
        }
        Ok(())
    }

    /// Kills children that run another program: code of a law has put it in the place of the role.
    fn kill_replaced(&mut self) {
        for process in &mut self.children {
            let program = program_of(process.child.id());
            if program.is_some() && process.program.is_some() && program != process.program {
                process.kill(KillReason::Replaced);
            }
        }
    }

    /// Restarts failed roles, and kills those that hang.
    fn maintain_roles(&mut self, run: &Run) -> Result<(), Failure> {
        if self.realtime.mode != RealtimeMode::Off {
            self.raised.get_or_insert_with(Raised::now);
            if self.off_loops.is_none() {
                let off_loops = OffLoops::now(&self.realtime);
                self.spawner.allowed_cpus = off_loops.allowed();
                self.off_loops = Some(off_loops);
            }
        }
        self.restart_due()?;
        self.kill_hanging(run);
        if self.channels == MOST_CHANNELS {
            self.kill_outvoted()?;
        }
        Ok(())
    }

    /// Kills, step by step, what does not end after the flight.
    fn land(&mut self, over: Duration, run_phase: RunPhase) {
        self.dismiss_latecomers();
        // The plant first if it has not closed the run: the others end when it is gone. If it hangs, an endless loop
        // at a higher priority may keep it from its processor.
        let waits_for_plant = over <= LANDING_TIMEOUT + STOP_TIMEOUT
            && run_phase != RunPhase::Closed
            && self.replicas().contains(&Role::Plant.into());
        for process in &mut self.children {
            if over > STOP_TIMEOUT && process.is_dismissed {
                process.kill(KillReason::AfterFlight);
            }
            if over > STOP_TIMEOUT && is_stopped(process.child.id()) {
                process.kill(KillReason::Hang);
            }
            if over > LANDING_TIMEOUT && (!waits_for_plant || process.replica.role == Role::Plant) {
                process.kill(KillReason::AfterFlight);
            }
        }
    }

    fn replicas(&self) -> Vec<Replica> {
        self.children
            .iter()
            .map(|process| process.replica)
            .collect()
    }

    /// What a role's blackboard shows, if the process with this number has written it.
    fn status_of(&self, replica: Replica, pid: u32) -> Option<Status> {
        self.role_statuses.as_ref()?.of_process(replica, pid)
    }

    /// Kills processes that hang, and restarted processes that do not come to fly.
    fn kill_hanging(&mut self, run: &Run) {
        let since = std::mem::replace(&mut self.last_look, Instant::now()).elapsed();
        let Some(statuses) = &self.role_statuses else {
            return;
        };
        let detector = || HangDetector::new(Duration::from_nanos(run.period_ns), run.slowdown());
        let hanging = self.hang_detector.get_or_insert_with(detector).hanging(
            || statuses.statuses(),
            since,
            Look::at,
        );
        for process in &mut self.children {
            let (replica, pid) = (process.replica, process.child.id());
            let restart = &self.restart_limits[&replica];
            let is_late = |timeout| restart.is_restarted() && restart.age() > timeout;
            let hangs = match statuses.of_process(replica, pid) {
                Some(status) if status.phase() == RolePhase::Flying => hanging.contains(&replica),
                Some(status) if status.phase() == RolePhase::Landed => false,
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

    /// Kills the processes of a channel that two others contradict: they come back with the state of another channel.
    fn kill_outvoted(&mut self) -> Result<(), Failure> {
        if self.redundancy.is_none() {
            self.redundancy = self.wire.blackboard_reader(REDUNDANCY)?;
        }
        let Some(account) = self.redundancy.as_ref().map(BlackboardReader::get) else {
            return Ok(());
        };
        for (channel, now) in Channel::ALL.into_iter().zip(account.outvoted) {
            let before = &mut self.outvoted[channel as usize];
            let since = self
                .restart_limits
                .iter()
                .filter(|(replica, _)| replica.channel == channel);
            let is_new = since.map(|(_, limit)| limit.age()).min() < Some(GETTING_IN_STEP);
            if now < *before + OUTVOTED_TICKS || is_new {
                continue;
            }
            *before = now;
            for process in &mut self.children {
                let Replica { channel: own, role } = process.replica;
                if own == channel && CHANNEL_ROLES.contains(&role) {
                    process.kill(KillReason::Outvoted);
                }
            }
        }
        Ok(())
    }

    /// Asks restarted processes to end that have not come to fly before the flight was over.
    fn dismiss_latecomers(&mut self) {
        self.due.clear();
        for process in &mut self.children {
            let statuses = self.role_statuses.as_ref();
            let status = statuses.and_then(|it| it.of_process(process.replica, process.child.id()));
            let phase = status.map(|status| status.phase());
            let has_flown = matches!(phase, Some(RolePhase::Flying | RolePhase::Landed));
            let is_restarted = self.restart_limits[&process.replica].is_restarted();
            if is_restarted && !has_flown && !process.is_dismissed {
                process.is_dismissed = true;
                terminate(&process.child);
            }
        }
    }

    fn request_end(&mut self) {
        self.due.clear();
        self.fault_injector.release(&self.child_watch);
        self.children.iter().for_each(|it| terminate(&it.child));
    }

    /// Notes that a process has failed in flight, and schedules the restart of its role; returns the exit if the role
    /// cannot be restarted.
    fn schedule_restart(&mut self, mut exit: ProcessExit, run: &Run) -> Option<ProcessExit> {
        let status = self.status_of(exit.replica, exit.pid);
        self.outcome.grid = Some(run.pace());
        let mut noted = ObservedFailure {
            role: exit.replica.to_string(),
            epoch: status.map_or(0, |status| status.epoch),
            how: exit.cause(),
            noticed_ns: now_ns(),
            way: Replacement::default(),
        };
        let mut due = None;
        let has_law = CHANNEL_ROLES.contains(&exit.replica.role);
        let is_unsaved = status.is_some_and(|it| it.ticks_run > 0 && it.is_saved == 0);
        if self.restarts_roles && exit.replica.role == Role::Plant {
            exit.not_restarted = Some("a plant cannot be started again in flight".into());
        } else if self.channels > 1 && has_law && is_unsaved {
            exit.not_restarted = Some(UNSAVED.into());
            noted.how += "; ";
            noted.how += UNSAVED;
        } else if self.restarts_roles {
            let limit = self.restart_limits.get_mut(&exit.replica);
            due = limit.and_then(|limit| limit.due(Instant::now()));
            exit.not_restarted = due.is_none().then(|| {
                let within_s = WITHIN.as_secs();
                format!(
                    "it has been started again {MAX_RESTARTS} times within {within_s} s, which is the most"
                )
            });
        }
        if due.is_some() {
            // What it held is then free for its successor.
            await_release(self.wire.instance(), exit.replica);
            self.wire.remove_dead();
            noted.way.cleaned_ns = now_ns();
        }
        self.outcome.noted.push(noted);
        self.supervision.failed += 1;
        let Some(due) = due else {
            return Some(exit);
        };
        self.due.push((exit, due));
        None
    }

    fn restart_due(&mut self) -> Result<(), Failure> {
        let now = Instant::now();
        let due: Vec<_> = self.due.extract_if(.., |(_, due)| *due <= now).collect();
        for (exit, _) in due {
            let replica = exit.replica;
            let how = exit.describe("");
            if replica.role == Role::Record
                && let Err(failure) = self.recordings.begin_another()
            {
                self.announce(
                    Subject::Process,
                    &format!("{how}; the flight goes on without a recorder: {failure}"),
                );
                continue;
            }
            let child = match self.spawner.start(replica, self.recordings.newest()) {
                Ok(child) => child,
                Err(failure) if self.channels > 1 && CHANNEL_ROLES.contains(&replica.role) => {
                    self.announce(
                        Subject::Process,
                        &format!(
                            "{how}; the flight goes on without channel {}: {failure}",
                            replica.channel
                        ),
                    );
                    continue;
                }
                Err(failure) => return Err(failure),
            };
            self.publish_directory();
            if replica.role == Role::Record {
                self.status_line.follow(&self.recordings.newest().path);
            }
            self.child_watch.watch(&child);
            if let Some(limit) = self.restart_limits.get_mut(&replica) {
                limit.restarted(now);
            }
            let mut noted = self.outcome.noted.iter_mut();
            if let Some(noted) = noted.rfind(|noted| noted.role == replica.to_string()) {
                noted.way.pid = child.id();
            }
            self.children.push(RoleProcess::new(replica, child));
            self.supervision.restarted += 1;
            self.announce(Subject::Process, &format!("{how}; it is started again"));
        }
        Ok(())
    }

    /// Notes when restarted processes came to fly.
    fn note_arrivals(&mut self) {
        let mut noted = std::mem::take(&mut self.outcome.noted);
        for noted in &mut noted {
            let way = &mut noted.way;
            let mut replicas = Replica::all(self.channels);
            let replica = replicas.find(|replica| replica.to_string() == noted.role);
            if let Some(replica) = replica.filter(|_| way.pid != 0 && way.arrival.armed_ns == 0)
                && let Some(status) = self.status_of(replica, way.pid)
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
        let since = Instant::now();
        while !self.left.is_empty() && since.elapsed() < RELEASED {
            self.left.retain(|pid| !reap_left(*pid));
            std::thread::sleep(Duration::from_millis(1));
        }
        let _ = set_child_subreaper(None);
    }
}

/// Waits until the role of a process that has ended is free: its releaser process gives it up some milliseconds later.
fn await_release(instance: &Instance, replica: Replica) {
    let since = Instant::now();
    while instance.is_occupied(replica) && since.elapsed() < RELEASED {
        std::thread::sleep(Duration::from_micros(500));
    }
}

/// Processes of this container that the kernel has killed for lack of memory.
fn memory_kills() -> u64 {
    let machine = Machine::files();
    let files = machine.group_counters("self", "memory");
    // The groups above its own count it again.
    let [kills] = machine.counted(files.get(..1).unwrap_or_default(), ["oom_kill"]);
    kills
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

/// Device and inode of the program that a process runs; `None` if it has ended, or may not be looked at.
fn program_of(pid: u32) -> Option<(u64, u64)> {
    let program = fs::metadata(format!("/proc/{pid}/exe")).ok()?;
    Some((program.dev(), program.ino()))
}

fn is_stopped(pid: u32) -> bool {
    Look::at(u64::from(pid)).is_some_and(Look::is_stopped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_is_over_when_its_plant_has_closed_it_or_its_last_tick_has_passed() {
        let (flying, closed) = (RunPhase::Flying as u64, RunPhase::Closed as u64);
        let over = Run {
            phase: flying,
            launcher_pid: u64::from(std::process::id()),
            t0_ns: now_ns() - 1_000_000_000,
            period_ns: 1_000_000,
            last_tick: 998,
            tick: 5,
            ..Run::default()
        };
        let longer = Run {
            last_tick: 60_000,
            ..over
        };
        let foreign = |run| Run {
            launcher_pid: over.launcher_pid + 1,
            ..run
        };
        let phase = |phase, run| Run { phase, ..run };
        let (period_ns, tick) = (LOCKSTEP, NO_TICK);
        for (run, expected) in [
            (over, [true, true]),
            (longer, [false, true]),
            (phase(closed, longer), [true, false]),
            (foreign(over), [false, true]),
            (foreign(phase(closed, longer)), [false, false]),
            (phase(RunPhase::Opening as u64, over), [false, false]),
            (Run { period_ns, ..over }, [false, true]),
            (Run { tick, ..longer }, [false, false]),
        ] {
            assert_eq!([is_over(&run), has_taken_off(&run)], expected, "{run:?}");
        }
    }
}
