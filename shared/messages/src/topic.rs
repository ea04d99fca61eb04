//! The topics of the loop, and the checks that a content must pass.

use crate::content::{Mode, RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use crate::layout::Visit;
use crate::monitor::{CAUSES, Monitor};
use crate::parameters::{PARAMETERS, Parameter};
use crate::role::Role;
use crate::telemetry::Telemetry;

/// A content that travels on a topic of its own.
pub trait Topic: Visit + Copy + std::fmt::Debug + Default + 'static {
    const NAME: &'static str;
    /// The one role that publishes it.
    const SENDER: Role;
    /// Processes that subscribe to it at the most: the loop's, and the recorder; none to what the recorder makes.
    const SUBSCRIBERS: usize;
    /// Whether several messages may be made for one tick.
    const MANY_PER_TICK: bool = false;

    /// Calls `look` on every number that another stage reads. Telemetry is not among them: a law may show what it will.
    fn numbers(&self, look: impl FnMut(&[f64]));

    /// Whether finite numbers are also physically possible, and flags are ones that exist.
    fn plausible(&self) -> bool;

    /// What the law of its sender shows in it; none where the sender has no law.
    fn telemetry(&self) -> Option<&Telemetry> {
        None
    }

    /// As [`Self::telemetry`], to fill it in.
    fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        None
    }

    fn finite(&self) -> bool {
        let mut finite = true;
        self.numbers(|numbers| finite &= numbers.iter().all(|number| number.is_finite()));
        finite
    }
}

/// Bounds far outside any flight that ends well: what lies beyond is a broken or forged message.
mod bound {
    pub(super) const POSITION_M: f64 = 1e5;
    pub(super) const VELOCITY_M_S: f64 = 1e3;
    pub(super) const ANGLE_RAD: f64 = 1e4;
    /// A unit quaternion, with room for rounding.
    pub(super) const QUATERNION: f64 = 1.001;
    pub(super) const RATE_RAD_S: f64 = 1e4;
    pub(super) const ACCELERATION_M_S2: f64 = 1e6;
    pub(super) const ACCELERATION_RAD_S2: f64 = 1e8;
    /// Derivatives of a reference that jumps: each goes with one over the time between two points, 1 ms at the least.
    pub(super) const REFERENCE_ACCELERATION: f64 = 1e9;
    pub(super) const REFERENCE_JERK: f64 = 1e12;
    pub(super) const REFERENCE_SNAP: f64 = 1e15;
    pub(super) const ROTOR_SPEED_RAD_S: f64 = 1e5;
    pub(super) const THRUST_N: f64 = 1e4;
    pub(super) const TORQUE_NM: f64 = 1e5;
    pub(super) const PARAMETER: f64 = 1e3;
}

fn within(numbers: &[f64], bound: f64) -> bool {
    numbers.iter().all(|number| number.abs() <= bound)
}

fn between_zero_and(numbers: &[f64], bound: f64) -> bool {
    numbers.iter().all(|number| (0.0..=bound).contains(number))
}

impl Topic for State {
    const NAME: &'static str = "state";
    const SENDER: Role = Role::Plant;
    const SUBSCRIBERS: usize = 3;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        let measured = &self.measured;
        look(&measured.position_w_m);
        look(&measured.velocity_w_m_s);
        look(&measured.attitude_rad);
        look(&measured.attitude_quaternion);
        look(&measured.rate_b_rad_s);
        look(&measured.specific_force_b_m_s2);
        look(&measured.rotor_speed_mean_rad_s);
        look(&measured.rotor_speed_squared_mean_rad2_s2);
        look(&measured.rotor_speed_command_rad_s);
        look(&self.truth.position_w_m);
        look(&self.truth.velocity_w_m_s);
        look(&self.truth.rate_b_rad_s);
        look(&self.truth.parameter);
    }

    fn plausible(&self) -> bool {
        let measured = &self.measured;
        within(&measured.position_w_m, bound::POSITION_M)
            && within(&measured.velocity_w_m_s, bound::VELOCITY_M_S)
            && within(&measured.attitude_rad, bound::ANGLE_RAD)
            && within(&measured.attitude_quaternion, bound::QUATERNION)
            && within(&measured.rate_b_rad_s, bound::RATE_RAD_S)
            && within(&measured.specific_force_b_m_s2, bound::ACCELERATION_M_S2)
            && between_zero_and(&measured.rotor_speed_mean_rad_s, bound::ROTOR_SPEED_RAD_S)
            && between_zero_and(
                &measured.rotor_speed_command_rad_s,
                bound::ROTOR_SPEED_RAD_S,
            )
            && between_zero_and(
                &measured.rotor_speed_squared_mean_rad2_s2,
                bound::ROTOR_SPEED_RAD_S * bound::ROTOR_SPEED_RAD_S,
            )
            && self.command_saturated <= 1
            && self.truth.touches_ground <= 1
            && within(&self.truth.position_w_m, bound::POSITION_M)
            && within(&self.truth.velocity_w_m_s, bound::VELOCITY_M_S)
            && within(&self.truth.rate_b_rad_s, bound::RATE_RAD_S)
            && within(&self.truth.parameter, bound::PARAMETER)
    }
}

impl Topic for Setpoint {
    const NAME: &'static str = "setpoint";
    const SENDER: Role = Role::Outer;
    const SUBSCRIBERS: usize = 2;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        look(&[self.thrust_n]);
        look(&self.attitude_rad);
        look(&self.attitude_rate_rad_s);
        look(&self.attitude_acceleration_rad_s2);
        let reference = &self.reference;
        look(&reference.position_w_m);
        look(&reference.velocity_w_m_s);
        look(&reference.acceleration_w_m_s2);
        look(&reference.jerk_w_m_s3);
        look(&reference.snap_w_m_s4);
        look(&[
            reference.yaw_rad,
            reference.yaw_rate_rad_s,
            reference.yaw_acceleration_rad_s2,
        ]);
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        Some(&self.telemetry)
    }

    fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        Some(&mut self.telemetry)
    }

    fn plausible(&self) -> bool {
        let reference = &self.reference;
        between_zero_and(&[self.thrust_n], bound::THRUST_N)
            && within(&self.attitude_rad, bound::ANGLE_RAD)
            && within(&self.attitude_rate_rad_s, bound::RATE_RAD_S)
            && within(
                &self.attitude_acceleration_rad_s2,
                bound::ACCELERATION_RAD_S2,
            )
            && within(&reference.position_w_m, bound::POSITION_M)
            && within(&reference.velocity_w_m_s, bound::VELOCITY_M_S)
            && within(
                &reference.acceleration_w_m_s2,
                bound::REFERENCE_ACCELERATION,
            )
            && within(&reference.jerk_w_m_s3, bound::REFERENCE_JERK)
            && within(&reference.snap_w_m_s4, bound::REFERENCE_SNAP)
            && within(&[reference.yaw_rad], bound::ANGLE_RAD)
            && within(&[reference.yaw_rate_rad_s], bound::RATE_RAD_S)
            && within(
                &[reference.yaw_acceleration_rad_s2],
                bound::REFERENCE_ACCELERATION,
            )
            && self.limited <= 1
            && Mode::from_wire(self.mode).is_some()
    }
}

impl Topic for Wrench {
    const NAME: &'static str = "wrench";
    const SENDER: Role = Role::Inner;
    const SUBSCRIBERS: usize = 2;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        look(&[self.thrust_n]);
        look(&self.torque_b_nm);
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        Some(&self.telemetry)
    }

    fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        Some(&mut self.telemetry)
    }

    fn plausible(&self) -> bool {
        between_zero_and(&[self.thrust_n], bound::THRUST_N)
            && within(&self.torque_b_nm, bound::TORQUE_NM)
            && Mode::from_wire(self.mode).is_some()
    }
}

impl Topic for RotorSpeeds {
    const NAME: &'static str = "rotor_speeds";
    const SENDER: Role = Role::Mixer;
    const SUBSCRIBERS: usize = 2;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        look(&self.speed_rad_s);
        look(&[self.thrust_n]);
        look(&self.torque_b_nm);
    }

    fn telemetry(&self) -> Option<&Telemetry> {
        Some(&self.telemetry)
    }

    fn telemetry_mut(&mut self) -> Option<&mut Telemetry> {
        Some(&mut self.telemetry)
    }

    fn plausible(&self) -> bool {
        between_zero_and(&self.speed_rad_s, bound::ROTOR_SPEED_RAD_S)
            && between_zero_and(&[self.thrust_n], bound::THRUST_N)
            && within(&self.torque_b_nm, bound::TORQUE_NM)
            && self.saturated <= 1
            && Mode::from_wire(self.mode).is_some()
    }
}

impl Topic for SwapRecord {
    const NAME: &'static str = "swaps";
    const SENDER: Role = Role::Plant;
    const SUBSCRIBERS: usize = 1;
    const MANY_PER_TICK: bool = true;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        look(&self.old);
        look(&self.new);
    }

    fn plausible(&self) -> bool {
        let meant = self
            .parameter
            .iter()
            .zip(self.steps)
            .take(self.count as usize);
        self.count <= PARAMETERS as u64
            && meant
                .into_iter()
                .all(|(index, steps)| Parameter::from_index(*index).is_some() && steps > 0)
    }
}

impl Topic for Monitor {
    const NAME: &'static str = "theorem";
    const SENDER: Role = Role::Record;
    const SUBSCRIBERS: usize = 0;

    fn numbers(&self, mut look: impl FnMut(&[f64])) {
        look(&self.rise_max);
        look(&[
            self.v_th,
            self.v_th_start,
            self.v_th_change,
            self.v_th_change_predicted,
        ]);
        look(&[
            self.descent,
            self.descent_predicted,
            self.step_excess_max,
            self.mismatch_rad_s2,
        ]);
        look(&[self.v, self.v_change, self.v_change_bound, self.sigma]);
        look(&[self.rate_error_rms_rad_s, self.rate_error_max_rad_s]);
        look(&self.estimate_error);
        look(&self.estimate_error_start);
        look(&self.estimate_error_bound);
        look(&[self.excitation, self.excitation_least]);
        look(&self.identifiability);
    }

    fn plausible(&self) -> bool {
        self.causes < 1 << CAUSES && self.is_violation <= 1 && self.is_live <= 1
    }
}
