//! An observer's view of a flight: joins and leaves without affecting the control loops.
//!
//! The recorder passes messages on and publishes the monitor's results. Everything else is on the blackboards.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use flight_log::entry::LogEntry;
use ipc::error::Error;
use ipc::instance::Instance;
use ipc::{BlackboardReader, Receiver, Wire};
use messages::blackboards::{
    ActiveParameters, EndReason, IN_FORCE, RUN, Run, RunPhase, SETTINGS, SettingsText, Status,
};
use messages::inspection::Expected;
use messages::monitor::Monitor;
use messages::role::{Replica, Role};

use config::airframe::pairs;
use recorder::ports::{Ports, horizon};
use recorder::role_statuses::RoleStatuses;

pub use recorder::ports::DRAIN_EVERY;

/// How long after the end of a flight the recorder may still pass messages on.
const LAST_MESSAGES: Duration = Duration::from_millis(200);

pub struct Observation {
    ports: Ports,
    theorem: Receiver<Monitor>,
    run: BlackboardReader<Run>,
    active: BlackboardReader<ActiveParameters>,
    statuses: RoleStatuses,
    /// Settings shared by all roles of the run, by key.
    pub settings: BTreeMap<String, String>,
    /// When the end of the flight was noticed.
    ended: Option<Instant>,
    wire: Wire,
}

impl Observation {
    /// Joins the flight of an instance; `None` while none is running.
    pub fn join(instance: &Instance) -> Result<Option<Self>, Error> {
        // Without a flight, no shared memory is opened.
        if !instance.is_occupied(Role::Plant) {
            return Ok(None);
        }
        let wire = Wire::open(instance)?;
        let (run, active) = (
            wire.blackboard_reader::<Run>(RUN)?,
            wire.blackboard_reader(IN_FORCE)?,
        );
        let (Some(run), Some(active)) = (run, active) else {
            return Ok(None);
        };
        let flown = run.get();
        if flown.phase() != RunPhase::Flying {
            return Ok(None);
        }
        let (mut ports, mut theorem) = (Ports::observing(&wire)?, wire.observer()?);
        let expected = Expected {
            run_id: flown.run_id,
            settings: flown.settings,
        };
        ports.arm(expected)?;
        theorem.arm(expected)?;
        let text = wire.blackboard_reader::<SettingsText>(SETTINGS)?;
        let settings = text.map(|board| pairs(board.get().text()));
        let statuses = RoleStatuses::open(&wire)?;
        Ok(Some(Self {
            ports,
            theorem,
            run,
            active,
            statuses,
            settings: settings.unwrap_or_default(),
            ended: None,
            wire,
        }))
    }

    pub fn run(&self) -> Run {
        self.run.get()
    }

    pub fn active_parameters(&self) -> ActiveParameters {
        self.active.get()
    }

    pub fn statuses(&self) -> BTreeMap<Replica, Status> {
        self.statuses.statuses()
    }

    /// Whether the role's process is alive; its blackboard outlives it.
    pub fn lives(&self, role: Role) -> bool {
        self.wire.instance().is_occupied(role)
    }

    pub fn ending(&self) -> Option<EndReason> {
        let run = self.run();
        match run.phase() {
            RunPhase::Closed => Some(run.ending()),
            _ if !self.lives(Role::Plant) => Some(EndReason::Failed),
            _ => None,
        }
    }

    /// The same, once the recorder has had time to pass the last messages on.
    pub fn ending_after_last_messages(&mut self) -> Option<EndReason> {
        let ending = self.ending()?;
        let ended = self.ended.get_or_insert_with(Instant::now);
        (ended.elapsed() >= LAST_MESSAGES).then_some(ending)
    }

    /// Passes every message since the last call to `each`, topic by topic in the order of the data flow.
    pub fn drain(&mut self, mut each: impl FnMut(&LogEntry)) -> Result<(), Error> {
        let run = &self.run;
        let horizon = horizon(run.get().pace(), || run.get());
        self.ports.drain(horizon, &mut each)?;
        self.theorem
            .drain(horizon, |it| each(&LogEntry::Theorem(*it)))
    }
}
