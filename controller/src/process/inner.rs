//! The inner loop's process: state and set-point in, wrench out.

use shared::envelope::{Envelope, Stamps};
use shared::error::Error;
use shared::inspection::{Expected, Rejections};
use shared::messages::{Setpoint, State, Wrench};
use shared::role::Role;
use shared::stage::{self, Stage, Turn, Worked};
use shared::station::Station;
use shared::wire::{LATEST, Receiver, Sender, Wire};

use crate::settings::Settings;
use crate::watched::WatchedLoop;

/// Runs the inner loop until the plant closes the run.
///
/// # Errors
/// Those of the station and of the ports.
pub fn run(station: Station, settings: &Settings) -> Result<(), Error> {
    let doorbell = station.wire().doorbell(Role::Inner)?;
    let stage = InnerStage::new(station.wire(), settings)?;
    stage::run(stage, &doorbell, station)
}

/// The inner loop and its monitor, with their ports.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct InnerStage {
    law: WatchedLoop,
    states: Receiver<State>,
    setpoints: Receiver<Setpoint>,
    wrenches: Sender<Wrench>,
}

impl InnerStage {
    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire, settings: &Settings) -> Result<Self, Error> {
        Ok(Self {
            law: WatchedLoop::new(settings),
            states: wire.receiver(LATEST)?,
            setpoints: wire.receiver(LATEST)?,
            wrenches: wire.sender(Some(wire.bell(Role::Mixer)?))?,
        })
    }
}

impl Stage for InnerStage {
    const ROLE: Role = Role::Inner;

    fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.states.arm(expected)?;
        self.setpoints.arm(expected)?;
        self.wrenches.arm(expected, epoch)
    }

    /// The set-point wakes the stage; the state of its tick was there before the outer loop had it.
    fn take(&mut self, newest_tick: u64) -> Result<u64, Error> {
        let tick = self.setpoints.take(newest_tick)?;
        self.states.take(newest_tick)?;
        Ok(tick)
    }

    fn tick(&mut self, turn: &Turn) -> Result<Worked, Error> {
        let (state, setpoint) = (self.states.dated(), self.setpoints.dated());
        let stale = state.tick != turn.tick || setpoint.tick != turn.tick;
        let wrench = self.law.tick(turn.tick, &state, &setpoint);
        // The history that reaches further: the set-point's, or, where that is stale, the state's.
        let newest =
            if setpoint.tick == turn.tick { self.setpoints.newest().envelope } else { self.states.newest().envelope };
        let mut history = Envelope { previous_busy_ns: turn.previous_busy_ns, ..newest };
        history.input_tick[0] = state.tick;
        history.input_tick[1] = setpoint.tick;
        history.stamps[Role::Inner as usize] = Stamps { receive_ns: turn.receive_ns, send_ns: 0 };
        self.wrenches.send(turn.tick, &history, wrench)?;
        Ok(Worked { stale, wants_end: None })
    }

    fn rejections(&self) -> Rejections {
        self.states.rejections().and(self.setpoints.rejections())
    }
}
