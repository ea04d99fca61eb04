//! An observer's view of a flight: joins and leaves without affecting the control loops.
//!
//! The recorder passes messages on and publishes the monitor's results. Everything else is on the blackboards.

use std::collections::BTreeMap;

use ipc::error::Error;
use ipc::instance::Instance;
use ipc::{BlackboardReader, Receiver, Wire};
use messages::blackboards::{
    ActiveParameters, EndReason, IN_FORCE, RUN, Run, RunPhase, SETTINGS, SettingsText, Status,
};
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::header::Message;
use messages::inspection::Expected;
use messages::monitor::Monitor;
use messages::role::Role;

use crate::record::ports::{Ports, horizon};
use crate::record::role_statuses::RoleStatuses;
use crate::settings::airframe::pairs;

#[derive(Clone, Copy, Debug)]
pub enum ObservedMessage<'a> {
    State(&'a Message<State>),
    Setpoint(&'a Message<Setpoint>),
    Wrench(&'a Message<Wrench>),
    RotorSpeeds(&'a Message<RotorSpeeds>),
    Swap(&'a Message<SwapRecord>),
    Theorem(&'a Message<Monitor>),
}

#[allow(
    missing_debug_implementations,
    reason = "the middleware's handles have none"
)]
pub struct Observation {
    ports: Ports,
    theorem: Receiver<Monitor>,
    run: BlackboardReader<Run>,
    in_force: BlackboardReader<ActiveParameters>,
    crew: RoleStatuses,
    /// Settings shared by all roles of the run, by key.
    pub settings: BTreeMap<String, String>,
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
        let Some(run) = wire.blackboard_reader::<Run>(RUN)? else {
            return Ok(None);
        };
        let flown = run.get();
        if flown.phase() != RunPhase::Flying {
            return Ok(None);
        }
        let Some(in_force) = wire.blackboard_reader(IN_FORCE)? else {
            return Ok(None);
        };
        let (mut ports, mut theorem) = (Ports::observing(&wire)?, wire.observer()?);
        let expected = Expected {
            run_id: flown.run_id,
            settings: flown.settings,
        };
        ports.arm(expected)?;
        theorem.arm(expected)?;
        let text = wire
            .blackboard_reader::<SettingsText>(SETTINGS)?
            .map(|board| board.get())
            .unwrap_or_default();
        let settings = pairs(text.text());
        let crew = RoleStatuses::open(&wire)?;
        Ok(Some(Self {
            ports,
            theorem,
            run,
            in_force,
            crew,
            settings,
            wire,
        }))
    }

    /// The run as its plant publishes it.
    #[must_use]
    pub fn run(&self) -> Run {
        self.run.get()
    }

    #[must_use]
    pub fn in_force(&self) -> ActiveParameters {
        self.in_force.get()
    }

    #[must_use]
    pub fn crew(&self) -> BTreeMap<Role, Status> {
        self.crew.statuses()
    }

    /// Whether the role's process is alive; its blackboard outlives it.
    #[must_use]
    pub fn lives(&self, role: Role) -> bool {
        self.wire.instance().is_occupied(role)
    }

    /// How the flight ended, if it has.
    #[must_use]
    pub fn ending(&self) -> Option<EndReason> {
        let run = self.run();
        match run.phase() {
            RunPhase::Closed => Some(run.ending()),
            _ if !self.lives(Role::Plant) => Some(EndReason::Failed),
            _ => None,
        }
    }

    /// Passes every message since the last call to `each`, topic by topic in the order of the data flow.
    pub fn drain(&mut self, mut each: impl FnMut(ObservedMessage<'_>)) -> Result<(), Error> {
        let (ports, run) = (&mut self.ports, &self.run);
        let horizon = horizon(run.get().pace(), || run.get());
        ports
            .states
            .drain(horizon, |message| each(ObservedMessage::State(message)))?;
        ports
            .setpoints
            .drain(horizon, |message| each(ObservedMessage::Setpoint(message)))?;
        ports
            .wrenches
            .drain(horizon, |message| each(ObservedMessage::Wrench(message)))?;
        ports.rotor_speeds.drain(horizon, |message| {
            each(ObservedMessage::RotorSpeeds(message))
        })?;
        ports
            .swaps
            .drain(horizon, |message| each(ObservedMessage::Swap(message)))?;
        self.theorem
            .drain(horizon, |message| each(ObservedMessage::Theorem(message)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::clock::now_ns;
    use messages::blackboards::LOCKSTEP;

    /// Ticks of the states that an observer receives if the recorder passes on states of `ticks` in a flight at tick 50.
    fn seen(period_ns: u64, ticks: &[u64]) -> Vec<u64> {
        let root = tempfile::Builder::new()
            .prefix("ib-")
            .tempdir_in("/tmp")
            .unwrap();
        let instance = Instance::under(root.path(), "forged").unwrap();
        let mut seen = Vec::new();
        {
            let _plant = instance.lock(Role::Plant).unwrap();
            let wire = Wire::open(&instance).unwrap();
            let (board, _in_force) = (
                wire.blackboard::<Run>(RUN).unwrap(),
                wire.blackboard::<ActiveParameters>(IN_FORCE).unwrap(),
            );
            let (phase, t0_ns) = (RunPhase::Flying as u64, now_ns() - 50 * period_ns);
            board.put(Run {
                phase,
                run_id: 7,
                settings: 9,
                t0_ns,
                period_ns,
                tick: 50,
                ..Run::default()
            });
            let relay = wire.relay::<State>().unwrap();
            let mut observation = Observation::join(&instance).unwrap().unwrap();
            for (seq, tick) in ticks.iter().enumerate() {
                let mut message = Message::<State>::default();
                let envelope = &mut message.envelope;
                (
                    envelope.run_id,
                    envelope.settings,
                    envelope.seq,
                    envelope.tick,
                ) = (7, 9, seq as u64, *tick);
                relay.pass_on(&message).unwrap();
            }
            observation
                .drain(|message| {
                    if let ObservedMessage::State(message) = message {
                        seen.push(message.envelope.tick);
                    }
                })
                .unwrap();
        }
        instance.remove_leftovers().unwrap();
        seen
    }

    #[test]
    fn a_message_of_a_future_tick_is_rejected_and_later_valid_ones_are_accepted() {
        for period_ns in [LOCKSTEP, 1_000_000_000] {
            assert_eq!(
                seen(period_ns, &[49, 1 << 63, 50]),
                [49, 50],
                "ticks of {period_ns} ns"
            );
        }
    }
}
