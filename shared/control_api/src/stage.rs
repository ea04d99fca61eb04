//! The stages of the control loop as functions of messages: what their processes, simulations and replays call.
//!
//! A stage writes into the place of an older message: messages are large, and a copy of each would cost a tick more than
//! some laws do. A driver may also rehearse: a stage then works on a copy of what it knows, and changes nothing.

use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};

/// The outer loop: the state to thrust and attitude wanted.
pub trait OuterStage {
    /// Writes the set-point of a tick from the newest state; false, and nothing is written, where that is not of this
    /// tick.
    fn tick_into(&mut self, tick: u64, state: &Stamped<State>, setpoint: &mut Setpoint) -> bool;

    fn tick(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        let mut setpoint = Setpoint::default();
        self.tick_into(tick, state, &mut setpoint)
            .then_some(setpoint)
    }

    /// What [`Self::tick`] would give; nothing where the law cannot be copied.
    fn rehearse(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint>;
}

/// The inner loop: state and set-point to thrust and torque.
pub trait InnerStage {
    /// Writes the wrench of a tick from the newest state and set-point, whatever tick they are of.
    fn tick_into(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &mut Wrench,
    );

    fn tick(&mut self, tick: u64, state: &Stamped<State>, setpoint: &Stamped<Setpoint>) -> Wrench {
        let mut wrench = Wrench::default();
        self.tick_into(tick, state, setpoint, &mut wrench);
        wrench
    }

    /// What [`Self::tick`] would give; nothing where the law cannot be copied.
    fn rehearse(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
    ) -> Option<Wrench>;

    /// As [`crate::law::InnerLaw::estimates`].
    fn estimates(&self) -> Option<[f64; 3]>;

    /// As [`crate::law::InnerLaw::resume`].
    fn resume(&mut self, estimates: [f64; 3]) -> bool;
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerStage {
    /// Writes the rotor speeds of a tick from the newest wrench, whatever tick it is of.
    fn tick_into(&mut self, tick: u64, wrench: &Stamped<Wrench>, speeds: &mut RotorSpeeds);

    fn tick(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> RotorSpeeds {
        let mut speeds = RotorSpeeds::default();
        self.tick_into(tick, wrench, &mut speeds);
        speeds
    }

    /// What [`Self::tick`] would give; nothing where the law cannot be copied.
    fn rehearse(&mut self, tick: u64, wrench: &Stamped<Wrench>) -> Option<RotorSpeeds>;

    /// Every rotor at its smallest speed: the last word of a flight.
    fn idle(&self) -> RotorSpeeds;
}
