//! Starts the processes of a flight, watches them and ends them.

use std::fs::File;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use model::boards::{LOCKSTEP, RUN, Run, RunPhase};
use model::messages::NO_TICK;
use model::role::{ROLES, Role};
use rustix::process::{Pid, Signal, kill_process};
use wire::clock::now_ns;
use wire::instance::Instance;
use wire::{BoardReader, Wire};

use crate::cli::FlyArgs;
use crate::dashboard::Dashboard;
use crate::fly::LOOK_EVERY;
use crate::fly::asked::Asked;
use crate::fly::ending::{Ended, Left, log_path, process};
use crate::fly::status_line::StatusLine;
use crate::output::say;
use crate::run_directory::RunDirectory;
use crate::settings::Settings;
use failure::{Failure, InFile as _};
use machine::executable::own_executable;

/// How long processes may take to end after they were told to.
const LANDING: Duration = Duration::from_secs(5);
/// How long processes may take to be ready before it is said that they are waited for.
const GETTING_READY: Duration = Duration::from_secs(10);

/// How long they may take to end after the flight has: more than a recorder waits for a disk that stands still.
pub(super) const ENDING: Duration = Duration::from_secs(30);

/// The processes of a flight.
pub(super) struct Launcher {
    children: Vec<(Role, Child)>,
    /// Roles that were killed because they did not end with the flight.
    hung: Vec<Role>,
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
        let executable = own_executable()?;
        let status_line = StatusLine::new(&directory.path, settings.flight.duration_s);
        let mut launcher = Self { children: Vec::new(), hung: Vec::new(), dashboard: None, wire, status_line };
        for role in ROLES {
            let log_path = log_path(&directory.path, role);
            let log = File::create(&log_path).in_file("write", &log_path)?;
            let mut command = Command::new(&executable);
            command
                .arg(role.name())
                .arg("--config")
                .arg(directory.settings_file())
                .args(["--instance", instance.name()])
                .args(["--launcher", &std::process::id().to_string()]);
            if role == Role::Record {
                command.arg("--run-dir").arg(&directory.path);
                if let Some(states) = &args.recorder.states {
                    command.arg("--states").arg(states);
                }
            }
            let child = command
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(log)
                // Ctrl-C in a terminal reaches the launcher alone, which then ends the roles in order.
                .process_group(0)
                .spawn();
            match child {
                Ok(child) => launcher.children.push((role, child)),
                Err(e) => {
                    launcher.kill();
                    return Err(Failure::failed(format!("cannot start the {}: {e}", process(role)))
                        .help("a flight has five processes of some threads each: see `ulimit -u`, and `ulimit -v`"));
                }
            }
        }
        if args.watch {
            launcher.dashboard = Some(Dashboard::open(&executable, instance)?);
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
        let mut has_told = false;
        while !self.children.is_empty() {
            sleep(LOOK_EVERY);
            asked.look();
            ended.interrupted |= asked.end;
            let left = self.reap(asked.end)?;
            // After the look at the processes: whoever has ended with the flight has seen the board say so.
            board = board.or_else(|| self.wire.board_reader(RUN).ok().flatten());
            let run = board.as_ref().map(BoardReader::get);
            let early = run.is_some_and(|run| matches!(run.phase(), RunPhase::Mustering | RunPhase::Opening));
            if !forced {
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
            if told_at.is_none()
                && let Some(run) = run.filter(is_over)
                && over_since.get_or_insert_with(Instant::now).elapsed() > ENDING
            {
                self.kill_hanging(run.phase());
            }
            if asked.at_once || told_at.is_some_and(|at| at.elapsed() > LANDING) {
                forced = true;
                self.kill();
            }
            let terminal_taken = self.dashboard.as_mut().is_some_and(Dashboard::is_open);
            run.iter().for_each(|run| self.status_line.show(run, terminal_taken));
        }
        if let Some(dashboard) = &mut self.dashboard {
            dashboard.close();
        }
        self.status_line.clear();
        Ok(ended)
    }

    /// Takes ended processes off the list, and gives them.
    fn reap(&mut self, interrupted: bool) -> Result<Vec<Left>, Failure> {
        let mut left = Vec::new();
        let mut next = 0;
        while let Some((role, child)) = self.children.get_mut(next) {
            match child.try_wait().map_err(|e| Failure::failed(format!("cannot wait for {role}: {e}")))? {
                None => next += 1,
                Some(status) => {
                    let hung = self.hung.contains(role);
                    left.push(Left { role: *role, status, interrupted, hung });
                    self.children.remove(next);
                }
            }
        }
        Ok(left)
    }

    fn tell_all(&self) {
        for (_, child) in &self.children {
            if let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
                // It may have ended by itself meanwhile.
                let _ = kill_process(pid, Signal::TERM);
            }
        }
    }

    /// Kills who has not ended with the flight: the plant alone where it has not closed the run, since the others end
    /// when it is gone.
    fn kill_hanging(&mut self, phase: RunPhase) {
        let waits_for_plant = phase != RunPhase::Closed && self.children.iter().any(|(role, _)| *role == Role::Plant);
        for (role, child) in self.children.iter_mut().filter(|(role, _)| !waits_for_plant || *role == Role::Plant) {
            self.hung.push(*role);
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

impl Drop for Launcher {
    fn drop(&mut self) {
        self.kill();
        for (_, child) in &mut self.children {
            let _ = child.wait();
        }
    }
}

/// Whether the flight of this launcher is over: its plant has said so, or the clock does; in lockstep only the plant.
fn is_over(run: &Run) -> bool {
    let end_ns = run.t0_ns + (run.last_tick + 1) * run.period_ns;
    let is_past = run.phase() == RunPhase::Flying && run.period_ns != LOCKSTEP && now_ns() > end_ns;
    run.launcher_pid == u64::from(std::process::id()) && (run.phase() == RunPhase::Closed || is_past)
}
