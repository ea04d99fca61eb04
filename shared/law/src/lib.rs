//! What a law is: one trait per role, pure functions of state, input and tick.
//!
//! A law knows no clock, no port and no operating system. It is given the tick and the inputs that have arrived, and
//! returns what to send. Its driver (a role's process, a simulation, a replay) calls it once per tick, with increasing
//! ticks. Ticks may be skipped. A driver may also rehearse: it calls a clone with what the next tick may bring, and
//! throws the clone away.

use model::messages::{Dated, RotorSpeeds, Setpoint, State, Wrench};

/// The position loop: the state to thrust and attitude wanted.
pub trait OuterLaw: Clone {
    /// The set-point of a tick from the newest state; nothing where that is not of this tick.
    fn tick(&mut self, tick: u64, state: &Dated<State>) -> Option<Setpoint>;
}

/// The attitude and rate loop: state and set-point to thrust and torque.
pub trait InnerLaw: Clone {
    /// The wrench of a tick from the newest state and set-point, whatever tick they are of.
    fn tick(&mut self, tick: u64, state: &Dated<State>, setpoint: &Dated<Setpoint>) -> Wrench;
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerLaw: Clone {
    /// The rotor speeds of a tick from the newest wrench, whatever tick it is of.
    fn tick(&mut self, tick: u64, wrench: &Dated<Wrench>) -> RotorSpeeds;

    /// Every rotor at its smallest speed: the last word of a flight.
    fn idle(&self) -> RotorSpeeds;
}
