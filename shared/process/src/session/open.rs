//! How the plant opens a run.
//!
//! ```text
//!   Mustering --all ready--> Opening, t_0 announced --all armed--> Flying
//!       ^                       |    |  ^
//!       +------- one gone ------+    +--+ one late: another t_0, and more time
//! ```
//!
//! A role arms once: for another t_0 of the same run it only says that it has seen it.

use std::collections::BTreeMap;
use std::thread::sleep;

use super::{LOOK_EVERY, RoleSession, state_board, status_board, wall_ns};
use crate::lead::{self, ActiveLead};
use crate::rt::{Engaged, settle};
use crate::throttled_log::ThrottledLog;
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::{Blackboard, BlackboardReader, Wire};
use messages::blackboards::{
    EndReason, RUN, RolePhase, Run, RunPhase, SETTINGS, SETTINGS_MAX, SettingsText, StageState,
    Status,
};
use messages::flight_plan::FlightPlan;
use messages::grid::Pace;
use messages::inspection::Expected;
use messages::realtime::RealtimeStep;
use messages::role::{Channel, Replica, Role};

/// From the first announcement of t_0 to t_0, and by how much longer than the roles needed for it the next one is [ns].
const ANNOUNCE_NS: u64 = 200_000_000;
/// Roles must have armed this long before t_0 [ns] for the plant to keep to it; else it announces another one.
const ARMED_BEFORE_NS: u64 = 40_000_000;

pub struct Opened {
    // First: a role gives real time back before it gives up anything else.
    _engaged: Engaged,
    pub pace: Pace,
    pub expected: Expected,
    pub blackboard: Blackboard<Run>,
    pub run: Run,
    is_fifo: bool,
    /// The status blackboards of the other processes.
    pub statuses: RoleStatuses,
    _settings: Blackboard<SettingsText>,
    /// Kept open, so that the state of a stage outlives its process.
    _states: Vec<BlackboardReader<StageState>>,
}

impl Opened {
    /// Newest tick that the recorder has taken in: it counts them as ticks run.
    pub fn recorded_tick(&self) -> u64 {
        let recorder = self.statuses.iter().find(|(it, _)| it.role == Role::Record);
        recorder.map_or(0, |(_, recorder)| recorder.get().ticks_run)
    }

    pub fn requested_end(&self) -> Option<EndReason> {
        self.statuses.iter().find_map(|(_, blackboard)| {
            EndReason::from_wire(blackboard.get().wants_end).filter(|end| *end != EndReason::None)
        })
    }
}

impl RoleSession {
    /// Chooses the lead with which a run that was opened begins, and publishes it.
    pub fn choose_lead(
        &self,
        opened: &mut Opened,
        rehearse: impl FnMut() -> Result<(), Error>,
    ) -> Result<ActiveLead, Error> {
        let Pace::Realtime(grid) = opened.pace else {
            return Ok(ActiveLead::none());
        };
        let settings = &self.config.rt;
        opened.run.lead = lead::choose(settings, opened.is_fifo, &grid, rehearse)?;
        opened.blackboard.put(opened.run);
        Ok(ActiveLead::new(
            &opened.run.lead,
            settings.lead,
            grid.period_ns,
        ))
    }

    /// Opens a run: waits until every role is ready, announces t_0, and waits until all have armed for it.
    pub fn open_run(
        &mut self,
        plan: FlightPlan,
        mut arm: impl FnMut(&Wire, Expected, u64) -> Result<(), Error>,
    ) -> Result<Opened, Error> {
        let blackboard = self.wire.blackboard::<Run>(RUN)?;
        let settings = self.wire.blackboard::<SettingsText>(SETTINGS)?;
        let length = self.config.settings.len();
        let text = SettingsText::new(&self.config.settings).ok_or_else(|| {
            Error::usage(format!(
                "the settings are {length} bytes long, and their blackboard holds {SETTINGS_MAX}: fly with fewer faults"
            ))
        })?;
        settings.put(text);
        let mut run = self.own_run(plan);
        blackboard.put(run);
        let engaged = self.report_ready()?;
        let mut log = ThrottledLog::new(self.replica.role);
        let mut states = Vec::new();
        let (statuses, expected) = loop {
            let statuses = self.await_ready(&blackboard, &mut run, &mut log)?;
            states.clear();
            for (replica, _) in &statuses {
                states.extend(self.wire.blackboard_reader(&state_board(*replica))?);
            }
            run.phase = RunPhase::Opening as u64;
            run.run_id = wall_ns();
            let expected = Expected {
                run_id: run.run_id,
                settings: run.settings,
            };
            // Those who arm for the announced t_0 find the plant's ports.
            arm(&self.wire, expected, self.status.epoch)?;
            self.announce(&blackboard, &mut run, ANNOUNCE_NS);
            let epochs = statuses.iter().map(|(_, status)| status.get().epoch);
            let epochs: Vec<u64> = epochs.collect();
            settle(self.ahead.as_ref().map(|ahead| &ahead.locked))?;
            if self.await_armed(&statuses, &epochs, &blackboard, &mut run, &mut log)? {
                break (statuses, expected);
            }
        };
        run.phase = RunPhase::Flying as u64;
        blackboard.put(run);
        self.status.armed_t0_ns = run.t0_ns;
        self.enter(RolePhase::Flying);
        let is_fifo = engaged.grants.of(RealtimeStep::Scheduler).granted();
        Ok(Opened {
            _engaged: engaged,
            pace: run.pace(),
            expected,
            blackboard,
            run,
            is_fifo,
            statuses,
            _settings: settings,
            _states: states,
        })
    }

    fn own_run(&self, plan: FlightPlan) -> Run {
        Run {
            plant_pid: self.status.pid,
            launcher_pid: self.config.launcher.map_or(0, u64::from),
            settings: self.status.settings,
            period_ns: plan.wall_period_ns,
            sample_time_ns: plan.sample_time_ns,
            last_tick: plan.last_tick,
            channels: self.config.rt.channels as u64,
            ..Run::default()
        }
    }

    /// Waits until all other roles are ready with the plant's settings; publishes the phase when it has to wait.
    fn await_ready(
        &self,
        blackboard: &Blackboard<Run>,
        run: &mut Run,
        log: &mut ThrottledLog,
    ) -> Result<RoleStatuses, Error> {
        let mut statuses = BTreeMap::new();
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            let mut missing = Vec::new();
            let replicas = Replica::all(self.config.rt.channels);
            for replica in replicas.filter(|it| it.role != Role::Plant) {
                if !statuses.contains_key(&replica)
                    && let Some(status) = self.wire.blackboard_reader(&status_board(replica))?
                {
                    statuses.insert(replica, status);
                }
                let is_ready = statuses.get(&replica).is_some_and(|status| {
                    self.config.instance.is_occupied(replica) && self.is_ready(&status.get())
                });
                if !is_ready {
                    missing.push(replica);
                }
            }
            if missing.is_empty() {
                return Ok(statuses.into_iter().collect());
            }
            if run.phase() != RunPhase::Mustering {
                run.phase = RunPhase::Mustering as u64;
                blackboard.put(*run);
            }
            log.waiting_for(|| {
                let all: Vec<_> = missing.iter().map(ToString::to_string).collect();
                let (all, laws) = (all.join(", "), &self.config.law_options);
                let Replica { role, channel } = missing[0];
                let channel = match channel {
                    Channel::A => String::new(),
                    channel => format!(" --channel {channel}"),
                };
                let command = format!("ironbird {role}{channel} {laws}");
                format!(
                    "{all} (each with the plant's settings: `{}` ...)",
                    command.trim_end()
                )
            });
            sleep(5 * LOOK_EVERY);
        }
    }

    /// Whether a role can arm: one that has armed for a t_0 of the past arms again.
    fn is_ready(&self, status: &Status) -> bool {
        matches!(status.phase(), RolePhase::Ready | RolePhase::Armed)
            && status.settings == self.status.settings
    }

    fn announce(&self, blackboard: &Blackboard<Run>, run: &mut Run, ahead_ns: u64) {
        run.t0_ns = now_ns() + ahead_ns;
        run.t0_wall_ns = wall_ns() + ahead_ns;
        blackboard.put(*run);
    }

    /// Waits until all have armed, and have seen a t_0 early enough; false if one is gone, or another process.
    ///
    /// If they needed longer than until t_0, there is longer until the next one.
    fn await_armed(
        &self,
        statuses: &RoleStatuses,
        epochs: &[u64],
        blackboard: &Blackboard<Run>,
        run: &mut Run,
        log: &mut ThrottledLog,
    ) -> Result<bool, Error> {
        let mut ahead_ns = ANNOUNCE_NS;
        loop {
            if self.stop_requested() {
                return Err(Error::Interrupted);
            }
            let mut late = Vec::new();
            for ((replica, status), epoch) in statuses.iter().zip(epochs) {
                let status = status.get();
                if status.epoch != *epoch || !self.config.instance.is_occupied(*replica) {
                    return Ok(false);
                }
                if status.armed_t0_ns != run.t0_ns {
                    late.push(replica.to_string());
                }
            }
            let now = now_ns();
            if late.is_empty() && now + ARMED_BEFORE_NS < run.t0_ns {
                return Ok(true);
            }
            if late.is_empty() {
                let needed_ns = now + ahead_ns - run.t0_ns;
                ahead_ns = needed_ns + ANNOUNCE_NS;
                self.announce(blackboard, run, ahead_ns);
            } else if now > run.t0_ns {
                log.waiting_for(|| format!("{} to arm for t_0", late.join(", ")));
            }
            sleep(LOOK_EVERY);
        }
    }
}

/// The other processes with their status blackboards.
pub type RoleStatuses = Vec<(Replica, BlackboardReader<Status>)>;
