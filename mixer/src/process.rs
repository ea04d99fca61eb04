//! The mixer's process: wrench in, rotor speeds out.

use shared::envelope::{Envelope, Stamps};
use shared::error::Error;
use shared::inspection::{Expected, Rejections};
use shared::messages::{RotorSpeeds, Wrench};
use shared::role::Role;
use shared::stage::{self, Stage, Turn, Worked};
use shared::station::Station;
use shared::wire::{LATEST, Receiver, Sender, Wire};

use crate::mixer::{Mixer, Settings};

/// Runs the mixer until the plant closes the run; wakes the plant in lockstep, which otherwise wakes by itself.
///
/// # Errors
/// Those of the station and of the ports.
pub fn run(station: Station, settings: &Settings, lockstep: bool) -> Result<(), Error> {
    let wire = station.wire();
    // The last stage of the chain has time for the second call when its command is out.
    let doorbell = if lockstep { wire.doorbell(Role::Mixer) } else { wire.doorbell_with_alarm(Role::Mixer) }?;
    let stage = MixerStage::new(station.wire(), settings, lockstep)?;
    stage::run(stage, &doorbell, station)
}

/// The mixer with its ports.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct MixerStage {
    law: Mixer,
    wrenches: Receiver<Wrench>,
    rotor_speeds: Sender<RotorSpeeds>,
}

impl MixerStage {
    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire, settings: &Settings, lockstep: bool) -> Result<Self, Error> {
        let bell = lockstep.then(|| wire.bell(Role::Plant)).transpose()?;
        Ok(Self { law: Mixer::new(settings), wrenches: wire.receiver(LATEST)?, rotor_speeds: wire.sender(bell)? })
    }
}

impl Stage for MixerStage {
    const ROLE: Role = Role::Mixer;

    fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.wrenches.arm(expected)?;
        self.rotor_speeds.arm(expected, epoch)
    }

    fn take(&mut self, newest_tick: u64) -> Result<u64, Error> {
        self.wrenches.take(newest_tick)
    }

    fn tick(&mut self, turn: &Turn) -> Result<Worked, Error> {
        let wrench = self.wrenches.dated();
        let stale = wrench.tick != turn.tick;
        let speeds = self.law.tick(turn.tick, &wrench);
        let mut history = Envelope { previous_busy_ns: turn.previous_busy_ns, ..self.wrenches.newest().envelope };
        history.input_tick[2] = wrench.tick;
        history.stamps[Role::Mixer as usize] = Stamps { receive_ns: turn.receive_ns, send_ns: 0 };
        self.rotor_speeds.send(turn.tick, &history, speeds)?;
        Ok(Worked { stale, wants_end: None })
    }

    /// The last word to the rotors is idle.
    fn finish(&mut self, tick: u64) -> Result<(), Error> {
        self.rotor_speeds.send(tick, &Envelope::new(), self.law.idle())
    }

    fn rejections(&self) -> Rejections {
        *self.wrenches.rejections()
    }
}
