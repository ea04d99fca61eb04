//! One trait per role. The rig calls it; what lies around it (ports, stale inputs, the log) is the rig's business.

use messages::content::Measured;
use messages::content::Reference;
use messages::content::{ROTORS, Stamped};
use messages::telemetry::Telemetry;

pub use ironbird_law::{Desired, WrenchSetpoint};

use crate::description::{Description, Refused, Settings};
pub use crate::rig::Rig;

pub trait Law: Sized {
    const DESCRIPTION: Description;

    /// The law as it is before tick 0. The rig has checked each setting against the description.
    ///
    /// # Errors
    /// [`Refused`] says what does not go together, with the values, what is allowed and what to do.
    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused>;
}

pub trait OuterLaw: Law {
    /// What is wanted at a tick, whose measurement and reference these are.
    fn tick(
        &mut self,
        tick: u64,
        measured: &Measured,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> Desired;
}

/// The attitude and rate loop; or both loops in one, which takes the reference and overrides the thrust wanted.
///
/// It is asked in every tick, with the newest inputs. An older one is held: its tick says so. The rig replaces
/// what it held for too long, and asks the rotors for no torque in a tick without a fresh measurement.
pub trait InnerLaw: Law {
    /// Thrust and torque of a tick. `wanted` and `reference` are of one tick, which `wanted` names.
    fn tick(
        &mut self,
        tick: u64,
        measured: &Stamped<Measured>,
        wanted: &Stamped<Desired>,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> WrenchSetpoint;

    /// What it has learnt so far, with which another instance could go on; nothing where it learns nothing.
    fn estimates(&self) -> Option<[f64; 3]> {
        None
    }

    /// Before its first tick: begins with what another instance had learnt. False, and nothing is changed, where it may
    /// not have these estimates.
    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        let _ = estimates;
        false
    }
}

/// The mixer: thrust and torque to rotor speeds.
pub trait MixerLaw: Law {
    /// Speed of each rotor [rad/s] for a demand, and whether it could not be met in full.
    fn tick(
        &mut self,
        tick: u64,
        demand: &WrenchSetpoint,
        telemetry: &mut Telemetry,
    ) -> ([f64; ROTORS], bool);
}
