//! How a role joins the plant's run.
//!
//! ```text
//!                a plant lives            it announces t_0           it keeps to it
//!   Seeking --------------------> Found --------------------> Armed ----------------> joined
//!      ^                         |  ^ |                         |                        ^
//!      |     it dies or closes   |  | |    it flies already     |                        |
//!      +-------------------------+  | +-------------------------)------------------------+
//!                                   +----- it begins again ------+
//! ```
//!
//! A blackboard outlives its writer, so a run is believed only while the plant that wrote it holds its place. A role cannot
//! join a flight in lockstep late, because the plant waits for the command of a state that the newcomer never got.

use std::cell::Cell;
use std::thread::sleep;

use super::{LOOK_EVERY, RoleSession, StartConfig};
use crate::rt::{Engaged, settle};
use crate::throttled_log::ThrottledLog;
use errors::Failure;
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::{BlackboardReader, Wire};
use messages::blackboards::{EndReason, RUN, RolePhase, Run, RunPhase, SETTINGS, SettingsText};
use messages::grid::Pace;
use messages::inspection::Expected;
use messages::role::Role;
use messages::settings_text::{differences, other_laws};

pub struct Armed {
    // First: a role gives real time back before it gives up anything else.
    _engaged: Engaged,
    pub pace: Pace,
    pub expected: Expected,
    pub last_tick: u64,
    pub first_tick: u64,
    /// Whether it armed before the plant took off.
    pub is_from_take_off: bool,
    pub run: JoinedRun,
}

pub struct JoinedRun {
    board: BlackboardReader<Run>,
    last: Cell<Run>,
}

impl JoinedRun {
    const fn new(board: BlackboardReader<Run>, run: Run) -> Self {
        Self {
            board,
            last: Cell::new(run),
        }
    }

    /// The plant's blackboard of this run; if another run is on it, the last state of this one, closed by a failure.
    pub fn get(&self) -> Run {
        let (now, last) = (self.board.get(), self.last.get());
        if now.run_id == last.run_id {
            self.last.set(now);
            return now;
        }
        Run {
            phase: RunPhase::Closed as u64,
            ending: EndReason::Failed as u64,
            ..last
        }
    }

    /// The run that is on the blackboard instead of this one.
    pub fn successor(&self) -> Option<Run> {
        Some(self.board.get()).filter(|now| now.run_id != self.last.get().run_id)
    }
}

impl RoleSession {
    /// Joins the plant's run: waits for it, compares settings, arms the ports, waits for t_0.
    ///
    /// `arm` connects the ports to those of the other roles, which exist by then. Its arguments are the wire, the header
    /// fields to expect, and the epoch of this sender.
    pub fn join(
        &mut self,
        mut arm: impl FnMut(&Wire, Expected, u64) -> Result<(), Error>,
    ) -> Result<Armed, Error> {
        let engaged = self.report_ready()?;
        let mut log = ThrottledLog::new(self.replica.role);
        let mut plant: Option<BlackboardReader<Run>> = None;
        // The run whose t_0 the ports are armed for, which the plant may still move.
        let mut armed: Option<Run> = None;
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            let Some(board) = &plant else {
                plant = self.find_plant()?;
                if let Some(board) = &plant {
                    self.compare_settings(board.get().channels)?;
                } else {
                    log.waiting_for(|| "the plant (`ironbird plant`)".into());
                    sleep(10 * LOOK_EVERY);
                }
                continue;
            };
            let run = board.get();
            if let Some(before) = armed {
                let is_same = (run.run_id, run.t0_ns) == (before.run_id, before.t0_ns);
                match run.phase() {
                    // A short flight may be over before its last role has looked.
                    RunPhase::Flying | RunPhase::Closed if is_same => {}
                    // The plant keeps to this t_0 or announces another one: that it has passed means nothing.
                    RunPhase::Opening if run.run_id == before.run_id && self.plant_lives() => {
                        if !is_same {
                            armed = Some(run);
                            self.status.armed_t0_ns = run.t0_ns;
                            self.publish_status();
                        }
                        log.waiting_for(|| "the plant to open the run".into());
                        sleep(LOOK_EVERY);
                        continue;
                    }
                    _ => {
                        self.enter(RolePhase::Ready);
                        armed = None;
                        continue;
                    }
                }
            } else if run.plant_pid != self.plant_pid
                || run.phase() == RunPhase::Closed
                || !self.plant_lives()
            {
                (self.plant_pid, plant) = (0, None);
                sleep(LOOK_EVERY);
                continue;
            } else if run.phase() == RunPhase::Mustering {
                log.waiting_for(|| "the plant to open the run".into());
                sleep(5 * LOOK_EVERY);
                continue;
            } else if run.phase() == RunPhase::Flying && run.pace() == Pace::Lockstep {
                return Err(self.too_late());
            } else {
                arm(&self.wire, expected(&run), self.status.epoch)?;
                settle(self.ahead.as_ref().map(|ahead| &ahead.locked))?;
                if run.phase() == RunPhase::Opening {
                    self.status.armed_t0_ns = run.t0_ns;
                    self.enter(RolePhase::Armed);
                    armed = Some(run);
                    continue;
                }
            }
            if let Some(board) = plant.take() {
                return Ok(Armed {
                    is_from_take_off: armed.is_some(),
                    ..self.take_off(engaged, board, armed.unwrap_or(run))
                });
            }
        }
    }

    /// The blackboard of a plant that lives and whose run is open to this role.
    fn find_plant(&mut self) -> Result<Option<BlackboardReader<Run>>, Error> {
        let Some(board) = self.wire.blackboard_reader::<Run>(RUN)? else {
            return Ok(None);
        };
        let run = board.get();
        let StartConfig {
            instance, launcher, ..
        } = &self.config;
        // A launched role flies with the plant of its own launcher: another one's is about to end.
        let is_ours = launcher.is_none_or(|pid| u64::from(pid) == run.launcher_pid)
            && instance.pid_of(Role::Plant).map(u64::from) == Some(run.plant_pid);
        if run.phase() == RunPhase::Closed || !is_ours {
            return Ok(None);
        }
        self.plant_pid = run.plant_pid;
        Ok(Some(board))
    }

    fn take_off(&mut self, engaged: Engaged, board: BlackboardReader<Run>, run: Run) -> Armed {
        let pace = run.pace();
        let first_tick = match pace {
            Pace::Realtime(grid) if now_ns() >= grid.t0_ns => grid.tick_at(now_ns()) + 1,
            Pace::Realtime(_) | Pace::Lockstep => 0,
        };
        self.status.arrival.armed_ns = now_ns();
        self.enter(RolePhase::Flying);
        engaged.enter_loop();
        Armed {
            _engaged: engaged,
            pace,
            expected: expected(&run),
            last_tick: run.last_tick,
            first_tick,
            is_from_take_off: false,
            run: JoinedRun::new(board, run),
        }
    }

    fn too_late(&self) -> Error {
        Error::failed(format!(
            "the flight in lockstep has begun without this {} process, and cannot be joined late: end it and start \
             every role again",
            self.replica.role
        ))
    }

    fn compare_settings(&self, channels: u64) -> Result<(), Error> {
        let (own, role) = (self.config.rt.channels as u64, self.replica.role);
        let differ = |differences: &str| {
            let what =
                format!("the {role} process has other settings than the plant: {differences}");
            Failure::usage(what)
        };
        let same = "start every role with the same settings file and the same flags";
        if channels != own {
            let what = format!("rt.channels = {own}, and the plant flies with {channels}");
            return Err(differ(&what).help(same).into());
        }
        let Some(board) = self.wire.blackboard_reader::<SettingsText>(SETTINGS)? else {
            return Ok(());
        };
        let theirs = board.get();
        let differences = differences(&self.config.settings, theirs.text(), role);
        if theirs.text().is_empty() || differences.is_empty() {
            return Ok(());
        }
        let failure = differ(&differences.join("; "));
        let remedy = match other_laws(&self.config.settings, theirs.text()) {
            laws if laws.is_empty() => same.into(),
            laws => format!("{same}, and like the plant with {laws}"),
        };
        Err(failure.help(remedy).into())
    }
}

const fn expected(run: &Run) -> Expected {
    Expected {
        run_id: run.run_id,
        settings: run.settings,
    }
}
