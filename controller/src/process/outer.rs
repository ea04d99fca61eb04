//! The outer loop's process: state in, set-point out.

use shared::boards::Ending;
use shared::envelope::{Envelope, Stamps};
use shared::error::Error;
use shared::inspection::{Expected, Rejections};
use shared::messages::{Setpoint, State};
use shared::role::Role;
use shared::stage::{self, Stage, Turn, Worked};
use shared::station::Station;
use shared::wire::{LATEST, Receiver, Sender, Wire};

use crate::outer::{OuterLoop, position_error_m};
use crate::settings::Settings;

/// Runs the outer loop until the plant closes the run.
///
/// # Errors
/// Those of the station and of the ports.
pub fn run(station: Station, settings: &Settings, position_error_max_m: f64) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Outer)?;
    let stage = OuterStage::new(station.wire(), settings, position_error_max_m)?;
    stage::run(stage, &doorbell, station)
}

/// The outer loop with its ports.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct OuterStage {
    law: OuterLoop,
    position_error_max_m: f64,
    states: Receiver<State>,
    setpoints: Sender<Setpoint>,
}

impl OuterStage {
    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire, settings: &Settings, position_error_max_m: f64) -> Result<Self, Error> {
        Ok(Self {
            law: OuterLoop::new(settings),
            position_error_max_m,
            states: wire.receiver(LATEST)?,
            setpoints: wire.sender(Some(wire.bell(Role::Inner)?))?,
        })
    }
}

impl Stage for OuterStage {
    const ROLE: Role = Role::Outer;

    fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.states.arm(expected)?;
        self.setpoints.arm(expected, epoch)
    }

    fn take(&mut self, newest_tick: u64) -> Result<u64, Error> {
        self.states.take(newest_tick)
    }

    fn tick(&mut self, turn: &Turn) -> Result<Worked, Error> {
        let state = self.states.dated();
        // Without a state of this tick there is nothing new to say, and nothing is published.
        let Some(setpoint) = self.law.tick(turn.tick, &state) else {
            return Ok(Worked { stale: true, wants_end: None });
        };
        let mut history = Envelope { previous_busy_ns: turn.previous_busy_ns, ..self.states.newest().envelope };
        history.input_tick[0] = state.tick;
        history.stamps[Role::Outer as usize] = Stamps { receive_ns: turn.receive_ns, send_ns: 0 };
        self.setpoints.send(turn.tick, &history, setpoint)?;
        let lost = position_error_m(&state.content, &setpoint) > self.position_error_max_m;
        Ok(Worked { stale: false, wants_end: lost.then_some(Ending::Position) })
    }

    fn rejections(&self) -> Rejections {
        *self.states.rejections()
    }
}
