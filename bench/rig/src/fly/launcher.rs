//! Starts the processes of a flight, watches them, starts them again where it may, and ends them.

mod returns;

use std::os::unix::process::ExitStatusExt as _;
use std::process::Child;
use std::time::{Duration, Instant};

use machine::sampler::Look;
use model::boards::{LOCKSTEP, RUN, RolePhase, Run, RunPhase, Status};
use model::messages::NO_TICK;
use model::realtime::RealtimeMode;
use model::role::{ROLES, Role};
use role::rt::Raised;
use rustix::process::{Signal, kill_process, kill_process_group};
use wire::clock::now_ns;
use wire::instance::Instance;
use wire::{BoardReader, Wire};

use crate::cli::{FlyArgs, OnDeath};
use crate::dashboard::Dashboard;
use crate::fly::LOOK_EVERY;
use crate::fly::asked::Asked;
use crate::fly::ending::{Ended, Killed, Left};
use crate::fly::ends::{Ends, number_of};
use crate::fly::pulse::{self, Pulses};
use crate::fly::recordings::Recordings;
use crate::fly::restarts::Restarts;
use crate::fly::spares::Spares;
use crate::fly::starter::Starter;
use crate::fly::status_line::StatusLine;
use crate::fly::striker::Striker;
use crate::output::say;
use crate::record::crew::Crew;
use crate::run_directory::RunDirectory;
use crate::settings::Settings;
use failure::Failure;
use machine::executable::own_executable;

/// How long processes may take to end after they were told to.
pub(super) const LANDING: Duration = Duration::from_secs(5);
/// How long processes may take to be ready before it is said that they are waited for, and one that was started again
/// to fly.
const GETTING_READY: Duration = Duration::from_secs(10);

/// How long they may take to end after the flight has: more than a recorder waits for a disk that stands still.
pub(super) const ENDING: Duration = Duration::from_secs(30);

/// The processes of a flight.
pub(super) struct Launcher {
    starter: Starter,
    children: Vec<(Role, Child)>,
    spares: Spares,
    ends: Ends,
    on_death: OnDeath,
    /// Whether real time is asked for: a launcher that has to bring a stage back does not wait for a processor then.
    may_be_raised: bool,
    restarts: [Restarts; ROLES.len()],
    /// Those whose roles are to be started again, and when.
    due: Vec<(Left, Instant)>,
    pulses: Option<Pulses>,
    looked: Instant,
    /// Processes that were killed because they hung, or did not end with the flight.
    killed: Vec<(u32, Killed)>,
    /// Processes that were started again too late for the flight, and told to end.
    dismissed: Vec<u32>,
    recordings: Recordings,
    striker: Striker,
    /// Everybody's status board, from the first tick on.
    crew: Option<Crew>,
    dashboard: Option<Dashboard>,
    wire: Wire,
    status_line: StatusLine,
}

impl Launcher {
    /// Starts them all, from the thread that stays until they have ended: its end would be told them as the launcher's.
    pub(super) fn start(
        instance: &Instance,
        directory: &RunDirectory,
        settings: &Settings,
        args: &FlyArgs,
    ) -> Result<Self, Failure> {
        // Before any role starts: removes what dead processes of the instance left.
        let wire = Wire::open(instance)?;
        let (now, executable) = (Instant::now(), own_executable()?);
        let mut launcher = Self {
            striker: Striker::new(instance, &executable, settings)?,
            starter: Starter::new(executable, instance, directory, args),
            children: Vec::new(),
            spares: Spares::new(now),
            ends: Ends::default(),
            on_death: args.on_death,
            may_be_raised: settings.realtime()?.mode != RealtimeMode::Off,
            restarts: ROLES.map(|_| Restarts::new(now)),
            due: Vec::new(),
            pulses: None,
            looked: now,
            killed: Vec::new(),
            dismissed: Vec::new(),
            recordings: Recordings::new(directory, settings, instance),
            crew: None,
            dashboard: None,
            wire,
            status_line: StatusLine::new(&directory.path, settings.flight.duration_s),
        };
        for role in ROLES {
            match launcher.starter.start(role, directory) {
                Ok(child) => launcher.take_in(role, child),
                Err(failure) => {
                    launcher.kill();
                    return Err(failure);
                }
            }
        }
        if args.watch {
            launcher.dashboard = Some(Dashboard::open(&launcher.starter.executable, instance)?);
        }
        Ok(launcher)
    }

    /// Watches until every process has ended.
    pub(super) fn watch(&mut self, asked: &mut Asked) -> Result<Ended, Failure> {
        let mut ended = Ended::default();
        let mut told_at: Option<Instant> = None;
        let mut over_since: Option<Instant> = None;
        let mut forced = false;
        let mut board: Option<BoardReader<Run>> = None;
        let begun = Instant::now();
        let (mut has_told, mut shown) = (false, begun);
        let mut raised: Option<Raised> = None;
        while !self.children.is_empty() {
            let look_every = if self.restarts_roles() { pulse::LOOK_EVERY } else { LOOK_EVERY };
            self.striker.rest(&self.wire, board.as_ref().map(BoardReader::get).as_ref(), look_every, &mut self.ends);
            asked.look();
            ended.interrupted |= asked.end;
            let left = self.reap(asked.end)?;
            self.spares.reap(&mut self.ends, &self.wire, Instant::now());
            // After the look at the processes: whoever has ended with the flight has seen the board say so.
            board = board.or_else(|| self.wire.board_reader(RUN).ok().flatten());
            let run = board.as_ref().map(BoardReader::get);
            let early = run.is_some_and(|run| run.phase() != RunPhase::Closed);
            if ended.outlasted.is_empty() && run.is_some_and(|run| is_over(&run) && !early) {
                ended.outlasted = self.children.iter().map(|(role, _)| *role).collect();
            }
            let in_air = run.filter(|run| told_at.is_none() && self.is_in_air(run));
            self.look_at_boards(in_air.is_some())?;
            self.follow_returns(&mut ended.noted);
            for left in left.into_iter().filter(|_| !forced) {
                let left = match &in_air {
                    Some(run) if !left.was_interrupted() => self.fallen(left, run, &mut ended),
                    _ => Some(left),
                };
                left.into_iter().for_each(|left| ended.take(left, told_at.is_some(), early));
            }
            if !has_told && !ended.flown && begun.elapsed() > GETTING_READY {
                has_told = true;
                say("still waiting for all processes to be ready; plant.log says for which\n");
            }
            if told_at.is_none() && ended.is_over() {
                self.tell_all();
                told_at = Some(Instant::now());
            }
            ended.flown |= run.is_some_and(|run| run.phase() == RunPhase::Flying && run.tick != NO_TICK);
            if let Some(run) = in_air.filter(|_| told_at.is_none() && self.restarts_roles()) {
                if self.may_be_raised {
                    raised.get_or_insert_with(Raised::now);
                }
                self.start_again(&mut ended.noted)?;
                self.kill_hanging(&run);
                self.spares.keep(&self.starter, &mut self.ends, Instant::now());
            }
            if told_at.is_none()
                && let Some(run) = run.filter(is_over)
            {
                self.dismiss_latecomers();
                self.spares.dismiss();
                let over = over_since.get_or_insert_with(Instant::now).elapsed();
                if over > LANDING {
                    self.kill_latecomers();
                }
                if over > ENDING {
                    self.kill_lingering(run.phase(), over > ENDING + LANDING);
                }
            }
            if asked.at_once || told_at.is_some_and(|at| at.elapsed() > LANDING) {
                if !asked.at_once && !forced {
                    ended.killed = self.children.iter().map(|(role, _)| *role).collect();
                }
                forced = true;
                self.kill();
            }
            let terminal_taken = self.dashboard.as_mut().is_some_and(Dashboard::is_open);
            if let Some(run) = run.filter(|_| shown.elapsed() >= LOOK_EVERY) {
                shown = Instant::now();
                self.status_line.show(&run, terminal_taken);
            }
        }
        drop(raised);
        self.spares.end(&mut self.ends, &self.wire, LANDING);
        if let Some(dashboard) = &mut self.dashboard {
            dashboard.close();
        }
        self.status_line.clear();
        Ok(ended)
    }

    /// The directory with the flight's report, when all have ended.
    pub(super) fn recorded(&self) -> Result<RunDirectory, Failure> {
        self.recordings.settle()
    }

    fn take_in(&mut self, role: Role, child: Child) {
        self.ends.watch(&child);
        self.children.push((role, child));
        self.spares.started(role, Instant::now());
    }

    fn restarts_roles(&self) -> bool {
        self.on_death == OnDeath::Restart
    }

    /// Whether the flight of this launcher is in the air, and has ticks to come.
    fn is_in_air(&self, run: &Run) -> bool {
        let is_ours = run.launcher_pid == u64::from(std::process::id());
        is_ours && run.phase() == RunPhase::Flying && run.tick != NO_TICK && run.tick < run.last_tick
    }

    fn look_at_boards(&mut self, in_air: bool) -> Result<(), Failure> {
        if in_air && self.crew.is_none() {
            self.crew = Some(Crew::open(&self.wire)?);
        }
        Ok(())
    }

    /// What a role's board says, where the process with this number has written on it.
    fn status_of(&self, role: Role, pid: u32) -> Option<Status> {
        let status = self.crew.as_ref()?.statuses().get(&role).copied()?;
        (status.pid == u64::from(pid)).then_some(status)
    }

    /// Kills loops that hang, and processes that were started again and do not come to fly.
    fn kill_hanging(&mut self, run: &Run) {
        let since = std::mem::replace(&mut self.looked, Instant::now()).elapsed();
        let Some(crew) = &self.crew else { return };
        let pulses = self.pulses.get_or_insert_with(|| Pulses::new(Duration::from_nanos(run.period_ns)));
        let hanging = pulses.hanging(&crew.loops(), since, Look::at);
        let (statuses, restarts) = (crew.statuses(), &self.restarts);
        for (role, child) in &mut self.children {
            let status = statuses.get(role).filter(|status| status.pid == u64::from(child.id()));
            let restart = &restarts[*role as usize];
            let is_late = |patience| restart.is_again() && restart.age() > patience;
            let is_stopped = || Look::at(u64::from(child.id())).is_some_and(Look::is_stopped);
            let hangs = match status {
                Some(status) if status.phase() == RolePhase::Flying => hanging.contains(role),
                // One that a signal has stopped on its way will not come.
                _ => is_late(GETTING_READY) || (is_late(pulse::STILL) && is_stopped()),
            };
            if hangs {
                self.killed.push((child.id(), Killed::Hung));
                // Only a process that has ended already resists.
                let _ = child.kill();
            }
        }
    }

    /// Tells processes to end that were started again and have not come to fly before the flight was over.
    fn dismiss_latecomers(&mut self) {
        self.due.clear();
        for (role, child) in &self.children {
            let (pid, is_again) = (child.id(), self.restarts[*role as usize].is_again());
            let phase = self.status_of(*role, pid).map(|status| status.phase());
            let has_flown = matches!(phase, Some(RolePhase::Flying | RolePhase::Landed));
            if is_again && !has_flown && !self.dismissed.contains(&pid) {
                self.dismissed.push(pid);
                tell(child);
            }
        }
    }

    /// Kills those that were told to end, and have not.
    fn kill_latecomers(&mut self) {
        for (_, child) in self.children.iter_mut().filter(|(_, child)| self.dismissed.contains(&child.id())) {
            // Only a process that has ended already resists.
            let _ = child.kill();
        }
    }

    /// Takes ended processes off the list, and gives them.
    fn reap(&mut self, interrupted: bool) -> Result<Vec<Left>, Failure> {
        let mut left = Vec::new();
        let mut next = 0;
        while let Some((role, child)) = self.children.get_mut(next) {
            match child.try_wait().map_err(|e| Failure::failed(format!("cannot wait for {role}: {e}")))? {
                None => next += 1,
                Some(status) => {
                    let (role, pid) = (*role, child.id());
                    let killed = self.killed.iter().find(|(it, _)| *it == pid).map(|(_, why)| *why);
                    let killed = killed.or_else(|| self.striker.killed(pid).map(Killed::ByFault));
                    // One that has ended by itself meanwhile was not killed by anybody.
                    let killed = killed.filter(|_| status.signal() == Some(Signal::KILL.as_raw()));
                    self.striker.forget(pid);
                    self.ends.forget(pid);
                    // What code of a law has started, and left behind. Mostly there is nobody.
                    let _ = number_of(child).map(|group| kill_process_group(group, Signal::KILL));
                    self.children.remove(next);
                    if !self.dismissed.contains(&pid) {
                        left.push(Left { role, pid, status, interrupted, killed, not_again: None });
                    }
                }
            }
        }
        Ok(left)
    }

    fn tell_all(&mut self) {
        self.due.clear();
        self.spares.dismiss();
        self.striker.release();
        self.children.iter().for_each(|(_, child)| tell(child));
    }

    /// Kills who has not ended with the flight: the plant alone where it has not closed the run, since the others end
    /// when it is gone. All of them where it does not go: a stage that computes without an end at a higher priority
    /// keeps it from its processor, and so from its death.
    fn kill_lingering(&mut self, phase: RunPhase, all: bool) {
        let waits_for_plant =
            !all && phase != RunPhase::Closed && self.children.iter().any(|(role, _)| *role == Role::Plant);
        for (_, child) in self.children.iter_mut().filter(|(role, _)| !waits_for_plant || *role == Role::Plant) {
            self.killed.push((child.id(), Killed::AfterFlight));
            // Only a process that has ended already resists.
            let _ = child.kill();
        }
    }

    fn kill(&mut self) {
        for (_, child) in &mut self.children {
            // Only a process that has ended already resists.
            let _ = child.kill();
        }
    }
}

/// Tells a process to end.
fn tell(child: &Child) {
    if let Some(pid) = number_of(child) {
        // It may have ended by itself meanwhile.
        let _ = kill_process(pid, Signal::TERM);
    }
}

impl Drop for Launcher {
    fn drop(&mut self) {
        self.striker.release();
        self.kill();
        for (_, child) in &mut self.children {
            let _ = child.wait();
        }
        self.spares.end(&mut self.ends, &self.wire, Duration::ZERO);
    }
}

/// Whether the flight of this launcher is over: its plant has said so, or the clock does; in lockstep only the plant.
fn is_over(run: &Run) -> bool {
    let end_ns = run.t0_ns + (run.last_tick + 1) * run.period_ns;
    let is_past = run.phase() == RunPhase::Flying && run.period_ns != LOCKSTEP && now_ns() > end_ns;
    run.launcher_pid == u64::from(std::process::id()) && (run.phase() == RunPhase::Closed || is_past)
}
