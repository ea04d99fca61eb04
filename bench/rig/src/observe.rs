//! A by-stander's view of a flight: joins and leaves without touching a loop.
//!
//! Messages come from the recorder, which passes them on, and everything else from the notice boards.

use std::collections::BTreeMap;

use model::boards::{Ending, IN_FORCE, InForce, RUN, Run, RunPhase, SETTINGS, SettingsText, Status};
use model::envelope::Message;
use model::inspection::Expected;
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::role::{ROLES, Role};
use role::station::status_board;
use wire::error::Error;
use wire::instance::Instance;
use wire::{BoardReader, Wire};

use crate::record::ports::Ports;

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
}

/// A flight, observed.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Observation {
    ports: Ports,
    run: BoardReader<Run>,
    in_force: BoardReader<InForce>,
    crew: BTreeMap<Role, BoardReader<Status>>,
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
        let mut ports = Ports::observing(&wire)?;
        ports.arm(Expected { run_id: flown.run_id, settings: flown.settings })?;
        let text = wire.board_reader::<SettingsText>(SETTINGS)?.map(|board| board.get()).unwrap_or_default();
        let settings = text
            .text()
            .lines()
            .filter_map(|line| line.split_once(" = "))
            .map(|(key, value)| (key.to_owned(), value.trim_matches('"').to_owned()))
            .collect();
        let mut crew = BTreeMap::new();
        for role in ROLES {
            if let Some(board) = wire.board_reader(&status_board(role))? {
                crew.insert(role, board);
            }
        }
        Ok(Some(Self { ports, run, in_force, crew, settings, wire }))
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
        self.crew.iter().map(|(role, board)| (*role, board.get())).collect()
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
        // What the recorder believed is believed, whatever tick it is of.
        let any_tick = u64::MAX - 1;
        self.ports.states.drain(any_tick, |message| each(ObservedMessage::State(message)))?;
        self.ports.setpoints.drain(any_tick, |message| each(ObservedMessage::Setpoint(message)))?;
        self.ports.wrenches.drain(any_tick, |message| each(ObservedMessage::Wrench(message)))?;
        self.ports.rotor_speeds.drain(any_tick, |message| each(ObservedMessage::RotorSpeeds(message)))?;
        self.ports.swaps.drain(any_tick, |message| each(ObservedMessage::Swap(message)))
    }
}
