//! A by-stander's view of a flight: joins and leaves without touching a loop.
//!
//! Messages come from the recorder, which passes them on with what it makes of them. Everything else is on the notice
//! boards.

use std::collections::BTreeMap;

use model::boards::{Ending, IN_FORCE, InForce, RUN, Run, RunPhase, SETTINGS, SettingsText, Status};
use model::envelope::Message;
use model::inspection::Expected;
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;
use model::role::Role;
use wire::error::Error;
use wire::instance::Instance;
use wire::{BoardReader, Receiver, Wire};

use crate::record::crew::Crew;
use crate::record::ports::{Ports, horizon};
use crate::settings::airframe::pairs;

/// A message of any topic.
#[derive(Clone, Copy, Debug)]
pub enum ObservedMessage<'a> {
    /// Topic `state`.
    State(&'a Message<State>),
    /// Topic `setpoint`.
    Setpoint(&'a Message<Setpoint>),
    /// Topic `wrench`.
    Wrench(&'a Message<Wrench>),
    /// Topic `rotor_speeds`.
    RotorSpeeds(&'a Message<RotorSpeeds>),
    /// Topic `swaps`.
    Swap(&'a Message<SwapRecord>),
    /// Topic `theorem`.
    Theorem(&'a Message<Monitor>),
}

/// A flight, observed.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Observation {
    ports: Ports,
    theorem: Receiver<Monitor>,
    run: BoardReader<Run>,
    in_force: BoardReader<InForce>,
    crew: Crew,
    /// Settings that all roles of the run share, by key.
    pub settings: BTreeMap<String, String>,
    wire: Wire,
}

impl Observation {
    /// Joins the flight of an instance; `None` while there is none.
    ///
    /// # Errors
    /// [`Error::Crowded`], and those of the ports.
    pub fn join(instance: &Instance) -> Result<Option<Self>, Error> {
        // Where nobody flies, nothing is touched.
        if !instance.is_occupied(Role::Plant) {
            return Ok(None);
        }
        let wire = Wire::open(instance)?;
        let Some(run) = wire.board_reader::<Run>(RUN)? else { return Ok(None) };
        let flown = run.get();
        if flown.phase() != RunPhase::Flying {
            return Ok(None);
        }
        let Some(in_force) = wire.board_reader(IN_FORCE)? else { return Ok(None) };
        let (mut ports, mut theorem) = (Ports::observing(&wire)?, wire.observer()?);
        let expected = Expected { run_id: flown.run_id, settings: flown.settings };
        ports.arm(expected)?;
        theorem.arm(expected)?;
        let text = wire.board_reader::<SettingsText>(SETTINGS)?.map(|board| board.get()).unwrap_or_default();
        let settings = pairs(text.text());
        let crew = Crew::open(&wire)?;
        Ok(Some(Self { ports, theorem, run, in_force, crew, settings, wire }))
    }

    /// The run as its plant shows it.
    #[must_use]
    pub fn run(&self) -> Run {
        self.run.get()
    }

    /// The parameters in force.
    #[must_use]
    pub fn in_force(&self) -> InForce {
        self.in_force.get()
    }

    /// Every role as it shows itself.
    #[must_use]
    pub fn crew(&self) -> BTreeMap<Role, Status> {
        self.crew.statuses()
    }

    /// Whether the role's process lives; its board outlives it.
    #[must_use]
    pub fn lives(&self, role: Role) -> bool {
        self.wire.instance().is_occupied(role)
    }

    /// How the flight ended, if it has.
    #[must_use]
    pub fn ending(&self) -> Option<Ending> {
        let run = self.run();
        match run.phase() {
            RunPhase::Closed => Some(run.ending()),
            _ if !self.lives(Role::Plant) => Some(Ending::Failed),
            _ => None,
        }
    }

    /// Shows every message that has come since the last time, topic by topic in the order of the data's way.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn drain(&mut self, mut each: impl FnMut(ObservedMessage<'_>)) -> Result<(), Error> {
        let (ports, run) = (&mut self.ports, &self.run);
        let horizon = horizon(run.get().pace(), || run.get());
        ports.states.drain(horizon, |message| each(ObservedMessage::State(message)))?;
        ports.setpoints.drain(horizon, |message| each(ObservedMessage::Setpoint(message)))?;
        ports.wrenches.drain(horizon, |message| each(ObservedMessage::Wrench(message)))?;
        ports.rotor_speeds.drain(horizon, |message| each(ObservedMessage::RotorSpeeds(message)))?;
        ports.swaps.drain(horizon, |message| each(ObservedMessage::Swap(message)))?;
        self.theorem.drain(horizon, |message| each(ObservedMessage::Theorem(message)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::boards::LOCKSTEP;
    use wire::clock::now_ns;

    /// Ticks of the states that an observer sees when the recorder passes on states of `ticks` in a flight at tick 50.
    fn seen(period_ns: u64, ticks: &[u64]) -> Vec<u64> {
        let root = tempfile::Builder::new().prefix("ib-").tempdir_in("/tmp").unwrap();
        let instance = Instance::under(root.path(), "forged").unwrap();
        let mut seen = Vec::new();
        {
            let _plant = instance.lock(Role::Plant).unwrap();
            let wire = Wire::open(&instance).unwrap();
            let (board, _in_force) = (wire.board::<Run>(RUN).unwrap(), wire.board::<InForce>(IN_FORCE).unwrap());
            let (phase, t0_ns) = (RunPhase::Flying as u64, now_ns() - 50 * period_ns);
            board.put(Run { phase, run_id: 7, settings: 9, t0_ns, period_ns, tick: 50, ..Run::default() });
            let relay = wire.relay::<State>().unwrap();
            let mut observation = Observation::join(&instance).unwrap().unwrap();
            for (seq, tick) in ticks.iter().enumerate() {
                let mut message = Message::<State>::default();
                let envelope = &mut message.envelope;
                (envelope.run_id, envelope.settings, envelope.seq, envelope.tick) = (7, 9, seq as u64, *tick);
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
    fn a_message_of_a_tick_that_cannot_have_begun_is_not_believed_and_those_after_it_are() {
        for period_ns in [LOCKSTEP, 1_000_000_000] {
            assert_eq!(seen(period_ns, &[49, 1 << 63, 50]), [49, 50], "ticks of {period_ns} ns");
        }
    }
}
