//! An observer's view of a flight: joins and leaves without affecting the control loops.
//!
//! The recorder passes messages on and publishes the monitor's results. Everything else is on the blackboards.

use std::time::{Duration, Instant};

use flight_log::causal_order::CausalOrder;
use flight_log::entry::LogEntry;
use ipc::error::Error;
use ipc::instance::Instance;
use ipc::{BlackboardReader, Receiver, Wire};
use messages::blackboards::{
    ActiveParameters, EndReason, IN_FORCE, RUN, Run, RunPhase, SETTINGS, SUPERVISION, SettingsText,
    Supervision,
};
use messages::channels::{REDUNDANCY, Redundancy};
use messages::content::Loss;
use messages::inspection::Expected;
use messages::monitor::Monitor;
use messages::role::{Channel, Replica, Role};

use recorder::injected_faults::{InjectedFaults, injected};
use recorder::ports::{Ports, horizon};
use recorder::role_statuses::RoleStatuses;

pub use recorder::ports::DRAIN_EVERY;

use crate::watch::dashboard_model::WatchedFlight;

/// How often joining may fail in a row: it can while roles start or end.
const TRIES: u32 = 20;
/// How long after the end of a flight the recorder may still pass messages on.
const LAST_MESSAGES: Duration = Duration::from_millis(200);

pub struct Observation {
    ports: Ports,
    theorem: Receiver<Monitor>,
    losses: Receiver<Loss>,
    order: CausalOrder,
    run: BlackboardReader<Run>,
    active: BlackboardReader<ActiveParameters>,
    statuses: RoleStatuses,
    /// None if the processes were started by hand.
    supervision: Option<BlackboardReader<Supervision>>,
    /// None with one channel.
    redundancy: Option<BlackboardReader<Redundancy>>,
    faults: InjectedFaults,
    /// Settings shared by all roles of the run, as text.
    pub settings: String,
    /// When the end of the flight was noticed.
    ended: Option<Instant>,
    wire: Wire,
}

impl Observation {
    /// Joins the flight of an instance; `None` while none is running. `failed` counts attempts in a row that failed.
    pub fn join(instance: &Instance, failed: &mut u32) -> Result<Option<Self>, Error> {
        match Self::joined(instance) {
            Err(Error::Wire { .. }) if *failed < TRIES => {
                *failed += 1;
                Ok(None)
            }
            joined => {
                *failed = 0;
                joined
            }
        }
    }

    fn joined(instance: &Instance) -> Result<Option<Self>, Error> {
        // Without a flight, no shared memory is opened.
        if !instance.look_for(Role::Plant)? {
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
        let mut ports = Ports::observing(&wire)?;
        let (mut theorem, mut losses) = (wire.observer()?, wire.observer()?);
        let expected = Expected {
            run_id: flown.run_id,
            settings: flown.settings,
        };
        ports.arm(expected)?;
        theorem.arm(expected)?;
        losses.arm(expected)?;
        let Some(settings) = wire.blackboard_reader::<SettingsText>(SETTINGS)? else {
            // The flight has just ended.
            return Ok(None);
        };
        let statuses = RoleStatuses::open(&wire)?;
        Ok(Some(Self {
            ports,
            theorem,
            losses,
            order: CausalOrder::joining(),
            run,
            active,
            statuses,
            supervision: wire.blackboard_reader(SUPERVISION)?,
            redundancy: wire.blackboard_reader(REDUNDANCY)?,
            faults: InjectedFaults::open(&wire)?,
            settings: settings.get().text().to_owned(),
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

    /// Updates what the blackboards say of a flight, and looks for its processes and its end.
    pub fn look(&mut self, flight: &mut WatchedFlight) {
        flight.active = self.active.get();
        flight.statuses = self.statuses.statuses();
        if let Some(supervision) = &self.supervision {
            *flight.supervision = supervision.get();
        }
        flight.redundancy = self.redundancy.as_ref().map(BlackboardReader::get);
        if let Some(live) = self.faults.update() {
            flight.injected = injected(live, flight.run.flight_time_s(1));
            if let Ok(planned) = flight.settings.planned_faults_beside(live) {
                flight.planned = planned;
            }
        }
        flight.update_steal();
        // In this order: a recorder that ends with the flight has not failed, and one that failed before stays failed.
        let instance = self.wire.instance();
        let lives = instance.is_occupied(Role::Record);
        if lives || self.ending().is_none() {
            flight.recorder_lives = lives;
            let all = Replica::all(flight.run.channels.max(1) as usize);
            flight.missing = all.filter(|it| !instance.is_occupied(*it)).collect();
        }
        flight.ending = self.ending_after_last_messages();
    }

    fn ending(&self) -> Option<EndReason> {
        let run = self.run();
        match run.phase() {
            RunPhase::Closed => Some(run.ending()),
            _ if !self.wire.instance().is_occupied(Role::Plant) => Some(EndReason::Failed),
            _ => None,
        }
    }

    /// The same, once the recorder has had time to pass the last messages on.
    pub fn ending_after_last_messages(&mut self) -> Option<EndReason> {
        let ending = self.ending()?;
        let ended = self.ended.get_or_insert_with(Instant::now);
        (ended.elapsed() >= LAST_MESSAGES).then_some(ending)
    }

    /// Passes messages to `each` in the order in which they were sent. The recorder passes them on in that order, and the
    /// states are read first: what was sent before the newest state is there.
    pub fn drain(&mut self, mut each: impl FnMut(&LogEntry)) -> Result<(), Error> {
        let run = &self.run;
        let horizon = horizon(run.get().pace(), || run.get());
        let (order, mut newest_state_ns) = (&mut self.order, 0);
        self.ports.drain(horizon, |entry| {
            if let LogEntry::State(message) = entry {
                newest_state_ns = message.envelope.sent_ns();
            }
            order.receive(Channel::A, entry);
        })?;
        self.theorem.drain(horizon, |it| {
            order.receive(Channel::A, &LogEntry::Theorem(*it));
        })?;
        self.losses.drain(horizon, |it| {
            order.take(Channel::A, &LogEntry::Loss(*it));
        })?;
        let is_over = run.get().phase() == RunPhase::Closed;
        let before_ns = if is_over { u64::MAX } else { newest_state_ns };
        order.release(before_ns, |_, entry| each(entry));
        Ok(())
    }
}
