//! The laws `roll_pitch_first` and `thrust_first`, which saturate in the order of their names; see [`crate::mix`].

use control_api::description::{Description, Refused, Settings, signal};
use control_api::law::{Fields, Law, MixerInput, MixerLaw, Rig};
use messages::allocation::Allocation;
use messages::content::ROTORS;
use messages::role::Role;
use messages::telemetry::Telemetry;

use crate::mix::{roll_pitch_first, speeds, thrust_first};

/// The mixer of an airframe. It keeps nothing from one tick to the next.
#[derive(Clone, Copy, Debug)]
pub struct Prioritised<const THRUST_FIRST: bool> {
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    /// Smallest and largest thrust of a rotor [N].
    f_min: f64,
    f_max: f64,
}

pub type RollPitchFirst = Prioritised<false>;
pub type ThrustFirst = Prioritised<true>;

impl<const THRUST_FIRST: bool> Law for Prioritised<THRUST_FIRST> {
    const DESCRIPTION: Description = Description {
        name: if THRUST_FIRST {
            "thrust_first"
        } else {
            "roll_pitch_first"
        },
        role: Role::Mixer,
        version: "1",
        summary: if THRUST_FIRST {
            "saturates by priority: thrust, then roll and pitch, then yaw"
        } else {
            "saturates by priority: roll and pitch, then a reserve of 15 % for yaw, then thrust, then the rest of yaw"
        },
        source: "Imran and Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial \
                 Vehicle, (6), (7) inverted; `ironbird docs paper` lists the differences",
        settings: &[],
        presets: &[],
        suited: None,
        telemetry: &[
            signal("roll_pitch_share", ""),
            signal("yaw_share", ""),
            signal("thrust_excess_share", ""),
        ],
    };

    fn new(rig: &Rig, _: &Settings) -> Result<Self, Refused> {
        let k = rig.airframe.k();
        let (f_min, f_max) = (rig.rotor.f_min(k), rig.rotor.f_max(k));
        Ok(Self {
            allocation: Allocation::new(&rig.airframe),
            k,
            f_min,
            f_max,
        })
    }

    fn state(&mut self, _: &mut Fields) {}
}

impl<const THRUST_FIRST: bool> MixerLaw for Prioritised<THRUST_FIRST> {
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> ([f64; ROTORS], bool) {
        let mix = if THRUST_FIRST {
            thrust_first
        } else {
            roll_pitch_first
        };
        let mix = mix(
            &self.allocation,
            input.demand.thrust_n,
            &input.demand.torque_b_nm.into(),
            self.f_min,
            self.f_max,
        );
        telemetry.value[0] = mix.roll_pitch_share;
        telemetry.value[1] = mix.yaw_share;
        telemetry.value[2] = mix.thrust_excess_share;
        (speeds(&mix.f, self.k).into(), mix.saturated)
    }
}
