//! One trait per role. The rig calls it; ports, stale inputs and the log are outside of a law.

use std::any::Any;

use messages::content::ROTORS;
use messages::telemetry::Telemetry;

pub use ironbird_law::{Desired, Given, InnerInput, MixerInput, OuterInput, WrenchSetpoint};

use crate::description::{Description, Refused, Settings};
pub use crate::rig::Rig;
pub use crate::saved_state::Fields;

/// What the rig needs in order to find a law by name and make it.
pub trait Law: Sized {
    const DESCRIPTION: Description;

    /// The law as it is before tick 0. The rig has checked each setting against the description. [`Refused`] says
    /// which values do not go together, what is allowed and what to do.
    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused>;

    /// Lists what changes in flight, and no settings: [`Fields`] writes or reads it. A law without this list cannot be
    /// saved.
    fn state(&mut self, fields: &mut Fields) {
        *fields = Fields::Refused;
    }
}

/// Copies the state of a law into another instance of the same law: directly for warm-up runs, as bytes for another
/// process.
pub trait CopyState: Any + Send {
    /// Does not allocate if the law owns no memory. False if the law cannot be copied: it gets no warm-up runs then.
    fn copy_into(&self, other: &mut dyn Any) -> bool;

    fn as_any(&mut self) -> &mut dyn Any;

    /// Writes the state, or reads the rest of the bytes as the state; false, and the law is as before, if that cannot be.
    fn transfer(&mut self, _: &mut Fields) -> bool {
        false
    }
}

impl<L: Law + Clone + Send + 'static> CopyState for L {
    fn copy_into(&self, other: &mut dyn Any) -> bool {
        other.downcast_mut::<L>().is_some_and(|other| {
            other.clone_from(self);
            true
        })
    }

    fn as_any(&mut self) -> &mut dyn Any {
        self
    }

    fn transfer(&mut self, fields: &mut Fields) -> bool {
        // Writing changes nothing.
        if matches!(fields, Fields::Write(_)) {
            self.state(fields);
            return fields.is_complete();
        }
        let mut copy = self.clone();
        copy.state(fields);
        if fields.is_complete() {
            *self = copy;
        }
        fields.is_complete()
    }
}

/// The position loop: the setpoint of a tick from the measurement and reference of the same tick.
pub trait OuterLaw: CopyState {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired;
}

/// The attitude and rate loop; or both loops in one, which follows the reference and overrides the desired thrust.
///
/// It is called in every tick, with the newest inputs and their ages. The rig replaces a setpoint that is
/// too old, and commands no torque in a tick without a fresh measurement.
pub trait InnerLaw: CopyState {
    /// Starts what the law needs outside of its process, before tick 0; most laws need nothing. `comes_by_the_clock` says
    /// whether ticks do, or as soon as the last one is done.
    fn start(&mut self, _comes_by_the_clock: bool) -> Result<(), Refused> {
        Ok(())
    }

    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint;
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerLaw: CopyState {
    /// Speed of each rotor [rad/s], and whether the demand could not be met in full.
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> ([f64; ROTORS], bool);
}
