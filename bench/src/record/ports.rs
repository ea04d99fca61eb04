//! Ports of every topic: the recorder's, its relays, an observer's.

use shared::error::Error;
use shared::inspection::{Expected, Rejections};
use shared::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use shared::wire::{DEEP, Receiver, Relay, Wire};

/// Ports to receive every topic by.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Ports {
    /// Topic `state`.
    pub states: Receiver<State>,
    /// Topic `setpoint`.
    pub setpoints: Receiver<Setpoint>,
    /// Topic `wrench`.
    pub wrenches: Receiver<Wrench>,
    /// Topic `rotor_speeds`.
    pub rotor_speeds: Receiver<RotorSpeeds>,
    /// Topic `swaps`.
    pub swaps: Receiver<SwapRecord>,
}

impl Ports {
    /// The recorder's, deep enough for its longest absence.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.receiver(DEEP)?,
            setpoints: wire.receiver(DEEP)?,
            wrenches: wire.receiver(DEEP)?,
            rotor_speeds: wire.receiver(DEEP)?,
            swaps: wire.receiver(DEEP)?,
        })
    }

    /// An observer's, which the recorder passes messages on to.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn observing(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.observer()?,
            setpoints: wire.observer()?,
            wrenches: wire.observer()?,
            rotor_speeds: wire.observer()?,
            swaps: wire.observer()?,
        })
    }

    /// Connects them for a run.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.states.arm(expected)?;
        self.setpoints.arm(expected)?;
        self.wrenches.arm(expected)?;
        self.rotor_speeds.arm(expected)?;
        self.swaps.arm(expected)
    }

    /// Messages that did not pass inspection.
    #[must_use]
    pub fn rejections(&self) -> Rejections {
        self.states
            .rejections()
            .and(self.setpoints.rejections())
            .and(self.wrenches.rejections())
            .and(self.rotor_speeds.rejections())
            .and(self.swaps.rejections())
    }
}

/// Ports to pass every topic on by.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Relays {
    /// Topic `state`.
    pub states: Relay<State>,
    /// Topic `setpoint`.
    pub setpoints: Relay<Setpoint>,
    /// Topic `wrench`.
    pub wrenches: Relay<Wrench>,
    /// Topic `rotor_speeds`.
    pub rotor_speeds: Relay<RotorSpeeds>,
    /// Topic `swaps`.
    pub swaps: Relay<SwapRecord>,
}

impl Relays {
    /// Makes the ports.
    ///
    /// # Errors
    /// Those of the ports.
    pub fn new(wire: &Wire) -> Result<Self, Error> {
        Ok(Self {
            states: wire.relay()?,
            setpoints: wire.relay()?,
            wrenches: wire.relay()?,
            rotor_speeds: wire.relay()?,
            swaps: wire.relay()?,
        })
    }
}
