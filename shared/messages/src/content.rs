//! What the stages tell each other: the content of every topic.
//!
//! Contents are plain `repr(C)` structs of `u64` and `f64` without padding. Fields have the usual names of the domain,
//! with units (`_w_` in the world frame, `_b_` in the body frame). Time, sequence and origin are in the envelope
//! ([`crate::envelope`]), not here.

use ironbird_law::abi::IRONBIRD_ROTORS;
pub use ironbird_law::{Desired, Given, Measured, Reference};
use nalgebra::Vector3;

use crate::attitude::Attitude;
use crate::frames::wrap;
use crate::layout::{layout, wire_enum};
use crate::math::atan2;
use crate::parameters::{ESTIMATED, PARAMETERS, Parameter};
use crate::role::MOST_CHANNELS;
use crate::telemetry::Telemetry;

/// Rotors of the airframe, numbered from 1: rear left, rear right, front right, front left.
pub const ROTORS: usize = IRONBIRD_ROTORS;

/// A tick that never was: no command yet, no input yet.
pub const NO_TICK: u64 = u64::MAX;

/// Newest data of a topic with the tick that it was made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<T> {
    /// Tick that the sender made it for; [`NO_TICK`] before the first.
    pub tick: u64,
    pub content: T,
}

impl<T> Stamped<T> {
    pub const fn new(tick: u64, content: T) -> Self {
        Self { tick, content }
    }

    /// What has not come yet.
    pub fn never() -> Self
    where
        T: Default,
    {
        Self::new(NO_TICK, T::default())
    }

    /// Ticks since it was made; `u64::MAX` if it never was.
    pub const fn age(&self, tick: u64) -> u64 {
        if self.tick == NO_TICK {
            u64::MAX
        } else {
            tick.saturating_sub(self.tick)
        }
    }
}

layout! {
    /// Topic `state`: what the sensors show at the tick, and the account that the plant keeps of commands and ticks.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct State {
        /// What a law is given of it.
        pub measured: Measured,
        /// Tick of the command in force; [`NO_TICK`] while none has arrived.
        pub command_tick: u64,
        /// Commands that have come so far, also those that never were in force.
        pub commands_taken: u64,
        /// Tick of the newest of them; [`NO_TICK`] while none has arrived.
        pub command_taken_tick: u64,
        /// 1 when the command in force could not deliver the demand, else 0.
        pub command_saturated: u64,
        /// Deadlines missed so far: ticks that began without the command of the tick before.
        pub deadlines_missed: u64,
        /// Length of the run of missed deadlines that this tick belongs to; 0 when its command was in time.
        pub deadline_miss_run: u64,
        /// Ticks skipped so far because the plant woke after the next one had begun.
        pub ticks_skipped: u64,
        pub parameter_epoch: u64,
        /// What no sensor shows; for monitors and records alone, never for a law.
        pub truth: Truth,
        pub decision: Decision,
        /// Where a ground station wants the vehicle to fly; all 0 with a trajectory that is known before the flight.
        pub target: FlightTarget,
        /// What the plant makes of the targets; all 0 with a trajectory that is known before the flight.
        pub reference: Reference,
    }
}

wire_enum! {
    /// What of a target is followed.
    pub enum TargetKind {
        /// Nothing: the reference comes to rest and stays there.
        Hold = 0 => "hold",
        /// Its velocity.
        Velocity = 1 => "velocity",
        /// Its position, which moves with its velocity.
        Position = 2 => "position",
    }
}

layout! {
    /// A target of a vehicle that a ground station flies, world frame.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct FlightTarget {
        /// First tick with this target.
        pub from_tick: u64,
        /// A [`TargetKind`] as number.
        pub kind: u64,
        /// Position at its first tick; of [`TargetKind::Position`] alone.
        pub position_w_m: [f64; 3],
        /// Not of [`TargetKind::Hold`].
        pub velocity_w_m_s: [f64; 3],
        pub yaw_rad: f64,
    }
}

layout! {
    /// A rotor command that the plant took.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct TakenCommand {
        /// Tick that it was made for.
        pub of_tick: u64,
        /// Place of its channel among [`crate::role::Channel::ALL`].
        pub channel: u64,
        /// Its sequence number.
        pub seq: u64,
        /// Tick from which on it acts if no newer command does; [`NO_TICK`] if a fault dropped it or no place was free.
        pub acts_from: u64,
        /// 0 if it was refused when it was read, because the command of another tick had its place; else 1.
        pub is_offered: u64,
    }
}

layout! {
    /// Commands that the plant took since the state before.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Decision {
        /// Their number. One is `command`; more are in the topic `decisions`, before the state.
        pub count: u64,
        /// Commands so far for which no place was free.
        pub refused: u64,
        /// The command, if there is exactly one.
        pub command: TakenCommand,
        /// Of the channel whose command is in force at the state, the first one with the same laws, by its place among
        /// [`crate::role::Channel::ALL`]; 0 while none has arrived.
        pub group: u64,
    }
}

/// Commands of a message of topic `decisions`.
pub const DECISIONS: usize = 16;

layout! {
    /// Topic `decisions`: commands that the plant took since the state before, in this order, if they are not exactly one.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Decisions {
        /// Number of entries.
        pub count: u64,
        pub command: [TakenCommand; DECISIONS],
    }
}

impl TakenCommand {
    pub const fn is_known(&self) -> bool {
        self.channel < MOST_CHANNELS as u64 && self.is_offered <= 1
    }
}

impl Decisions {
    pub fn commands(&self) -> &[TakenCommand] {
        let count = usize::try_from(self.count).unwrap_or(DECISIONS);
        &self.command[..count.min(DECISIONS)]
    }
}

layout! {
    /// The part of the plant's state that no sensor shows.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Truth {
        pub position_w_m: [f64; 3],
        pub velocity_w_m_s: [f64; 3],
        pub rate_b_rad_s: [f64; 3],
        /// 1 when the ground touched the airframe in the last tick, else 0.
        pub touches_ground: u64,
        /// True parameters in force, in the order of [`crate::parameters::SPECS`] and in their units.
        pub parameter: [f64; PARAMETERS],
    }
}

impl Truth {
    /// True value of a parameter, in its unit.
    pub const fn get(&self, parameter: Parameter) -> f64 {
        self.parameter[parameter as usize]
    }

    /// True values of the estimated parameters: I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub fn theta(&self) -> [f64; 3] {
        ESTIMATED.map(|parameter| self.get(parameter))
    }
}

layout! {
    /// Topic `setpoint`: what the outer loop wants of the inner one, and the reference that it follows.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Setpoint {
        pub thrust_n: f64,
        pub attitude_rad: [f64; 3],
        pub attitude_rate_rad_s: [f64; 3],
        pub attitude_acceleration_rad_s2: [f64; 3],
        /// 1 when a limit of the law was active, else 0.
        pub limited: u64,
        /// How the stage got here: a [`Mode`] as number.
        pub mode: u64,
        /// Where the vehicle should be at this tick.
        pub reference: Reference,
        pub telemetry: Telemetry,
    }
}

impl Setpoint {
    /// The part that the law of the inner loop follows.
    pub const fn desired(&self) -> Desired {
        Desired {
            thrust_n: self.thrust_n,
            attitude_rad: self.attitude_rad,
            attitude_rate_rad_s: self.attitude_rate_rad_s,
            attitude_acceleration_rad_s2: self.attitude_acceleration_rad_s2,
            limited: self.limited,
        }
    }
}

impl State {
    /// Distance between the vehicle, where it truly is, and its reference [m]: for those who judge, never for a law.
    #[inline]
    pub fn position_error_m(&self, reference: &Reference) -> f64 {
        (Vector3::from(self.truth.position_w_m) - Vector3::from(reference.position_w_m)).norm()
    }

    /// Difference between the yaw and that of the reference, at most pi [rad].
    #[inline]
    pub fn yaw_error_rad(&self, reference: &Reference) -> f64 {
        wrap(reference.yaw_rad - self.measured.attitude_rad[2]).abs()
    }

    /// Angle between body z and the thrust that the reference needs of the true airframe in the steady wind [rad]. The
    /// sensors' attitude is the true one.
    #[inline]
    pub fn tilt_error_rad(&self, reference: &Reference) -> f64 {
        use Parameter::{Gravity, Mass, TranslationalDrag, WindX, WindY, WindZ};
        let truth = |parameter| self.truth.get(parameter);
        let wind_w_m_s = Vector3::new(truth(WindX), truth(WindY), truth(WindZ));
        let air_w_m_s = Vector3::from(reference.velocity_w_m_s) - wind_w_m_s;
        let drag_1_s = truth(TranslationalDrag) / truth(Mass);
        let mut thrust_w = Vector3::from(reference.acceleration_w_m_s2) + drag_1_s * air_w_m_s;
        thrust_w.z += truth(Gravity);
        let z_b_w = Attitude::of_wxyz(self.measured.attitude_quaternion).z_b_in_w();
        atan2(z_b_w.cross(&thrust_w).norm(), z_b_w.dot(&thrust_w))
    }
}

layout! {
    /// Topic `wrench`: thrust and torque that the inner loop asks of the rotors.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Wrench {
        pub thrust_n: f64,
        /// Torque tau about body x, y, z, before saturation [N m].
        pub torque_b_nm: [f64; 3],
        /// How the stage got here: a [`Mode`] as number.
        pub mode: u64,
        pub telemetry: Telemetry,
    }
}

layout! {
    /// Topic `rotor_speeds`: what the mixer commands, and what it could achieve.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct RotorSpeeds {
        pub speed_rad_s: [f64; ROTORS],
        /// Thrust that these speeds give by the nominal model [N].
        pub thrust_n: f64,
        /// Torque that these speeds give by the nominal model [N m].
        pub torque_b_nm: [f64; 3],
        /// 1 when the demand could not be met in full, else 0.
        pub saturated: u64,
        /// How the stage got here: a [`Mode`] as number.
        pub mode: u64,
        pub telemetry: Telemetry,
    }
}

layout! {
    /// Topic `swaps`: a swap of the plant's parameters that has taken hold.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct SwapRecord {
        pub parameter_epoch: u64,
        /// How many of the following are meant.
        pub count: u64,
        /// Parameters, as indices of the table [`crate::parameters::SPECS`].
        pub parameter: [u64; PARAMETERS],
        pub old: [f64; PARAMETERS],
        /// Their values from the last of their steps on.
        pub new: [f64; PARAMETERS],
        /// Equal steps in which they get there, one a tick from the record's on; 1 is at once.
        pub steps: [u64; PARAMETERS],
    }
}

layout! {
    /// Topic `losses`: messages of a topic that were overwritten before the recorder read them.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct Loss {
        /// Place of the topic in the log's list of topics.
        pub topic: u64,
        /// Place of the sender's channel among [`crate::role::Channel::ALL`].
        pub channel: u64,
        pub messages: u64,
        /// Tick of the last message before them; [`NO_TICK`] if there was none.
        pub after_tick: u64,
        /// Tick of the first message after them.
        pub before_tick: u64,
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    pub parameter: Parameter,
    /// Value until the swap, in the parameter's unit.
    pub old: f64,
    pub new: f64,
    /// Equal steps in which it gets there, one a tick; 1 is at once.
    pub steps: u64,
}

impl SwapRecord {
    pub fn changes(&self) -> impl Iterator<Item = Change> + '_ {
        let count = usize::try_from(self.count).unwrap_or(0).min(PARAMETERS);
        (0..count).filter_map(|i| {
            let parameter = Parameter::from_index(self.parameter[i])?;
            Some(Change {
                parameter,
                old: self.old[i],
                new: self.new[i],
                steps: self.steps[i],
            })
        })
    }
}

wire_enum! {
    /// How a stage came by its output (docs/architecture.md, "Safety model").
    pub enum Mode {
        Fresh = 0 => "fresh",
        /// An input was stale, and the last one was held.
        Held = 1 => "held",
        /// An input was stale for longer; the stage fell back to a safe output.
        Fallback = 2 => "fallback",
        Idle = 3 => "idle",
        /// The law's answer was not finite, or one that no airframe can give; the stage put a safe one in its place.
        NotFinite = 4 => "not finite",
    }
}

layout!(Reference {
    position_w_m,
    velocity_w_m_s,
    acceleration_w_m_s2,
    jerk_w_m_s3,
    snap_w_m_s4,
    yaw_rad,
    yaw_rate_rad_s,
    yaw_acceleration_rad_s2,
});
layout!(Given {
    thrust_n,
    torque_b_nm,
    saturated,
    other_law,
});
layout!(Desired {
    thrust_n,
    attitude_rad,
    attitude_rate_rad_s,
    attitude_acceleration_rad_s2,
    limited,
});
