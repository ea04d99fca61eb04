//! What the cascades of an attitude and a rate loop share: the desired attitude as a rotation, the last rates, and the
//! refusal of loops that cannot fly.

use control_api::description::{Refused, Setting};
use control_api::law::{Desired, WrenchSetpoint};
use control_api::saved_state::saved_fields;
use messages::attitude::Attitude;
use messages::frames::RollPitch;
use nalgebra::Vector3;

use crate::limits::Limits;
use crate::rate_loop::{CHAIN_DELAY_TICKS, loop_gain_limit};

/// A gap in the measurements after which filters and integrators start anew [s].
const FORGET_S: f64 = 0.1;

const AXES: [&str; 3] = ["roll", "pitch", "yaw"];

pub type Gain<'a> = (&'a Setting, &'a [f64; 3]);

/// Refuses a rate gain that a late command makes unstable, and an attitude gain above the rate gain.
///
/// Sampled, the rate error goes as e(k+1) = e(k) - gain T e(k-2), see [`loop_gain_limit`]. With both gains equal the
/// cascade s^2 + rate s + rate attitude has a damping of one half.
pub fn check(
    (attitude, attitude_gain): Gain,
    (rate, rate_gain): Gain,
    period_s: f64,
) -> Result<(), Refused> {
    let allowed = loop_gain_limit(CHAIN_DELAY_TICKS) / period_s;
    for (i, axis) in AXES.iter().enumerate() {
        let (outer, inner) = (attitude_gain[i], rate_gain[i]);
        let (outer_name, inner_name) = (attitude.name, rate.name);
        if inner >= allowed {
            return Err(Refused(format!(
                "{inner_name} = {inner} 1/s ({axis}) cannot fly at a period_s of {period_s}: with a late command the \
                 rate loop is stable below {allowed:.1} 1/s; lower {inner_name}, or fly with a shorter period_s"
            )));
        }
        if outer > inner {
            return Err(Refused(format!(
                "{outer_name} = {outer} ({axis}) is above {inner_name} = {inner}: the attitude loop must be the \
                 slower one, allowed is up to {inner}; lower {outer_name} or raise {inner_name}"
            )));
        }
    }
    Ok(())
}

/// Refuses limits of the acceleration whose lower end is not below the upper one.
pub fn check_limits(limits: &Limits) -> Result<(), Refused> {
    let (low, high) = (limits.acceleration_z_min_g, limits.acceleration_z_max_g);
    if low < high {
        return Ok(());
    }
    Err(Refused(format!(
        "acceleration_z_min_g = {low} must be below acceleration_z_max_g = {high}: raise the one or lower the other"
    )))
}

/// What a law asks for in a tick without a measurement: no torque, and the last thrust.
pub fn no_torque(thrust_n: f64) -> WrenchSetpoint {
    WrenchSetpoint {
        thrust_n,
        ..WrenchSetpoint::default()
    }
}

/// The body rates that were measured last.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastRates(Option<(u64, Vector3<f64>)>);

saved_fields!(LastRates: 0);

/// What the rates of a tick say together with those measured before.
pub enum RateStep {
    /// The mean acceleration over the tick that has ended [rad/s^2].
    Whole(Vector3<f64>),
    /// Nothing was measured for long: whatever is remembered is too old.
    Forget,
    /// A tick or some without a measurement.
    Nothing,
}

impl LastRates {
    /// Takes the rates of a tick [rad/s].
    pub fn take(&mut self, tick: u64, nu2: &Vector3<f64>, period_s: f64) -> RateStep {
        match self.0.replace((tick, *nu2)) {
            Some((last, before)) if last + 1 == tick => RateStep::Whole((nu2 - before) / period_s),
            Some((last, _)) if (tick.saturating_sub(last)) as f64 * period_s > FORGET_S => {
                RateStep::Forget
            }
            _ => RateStep::Nothing,
        }
    }
}

/// The desired attitude, with body rates and their derivative along the reference. Nothing in it is singular.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesiredAttitude {
    pub attitude: Attitude,
    /// Body rates of the desired frame, in that frame [rad/s].
    pub nu2: Vector3<f64>,
    /// Their derivative [rad/s^2].
    pub dnu2: Vector3<f64>,
}

impl DesiredAttitude {
    pub fn of(wanted: &Desired) -> Self {
        Self::at(
            &wanted.attitude_rad.into(),
            &wanted.attitude_rate_rad_s.into(),
            &wanted.attitude_acceleration_rad_s2.into(),
        )
    }

    /// Of Euler angles and their derivatives: W d(eta2), and its derivative.
    pub fn at(eta2: &Vector3<f64>, d_eta2: &Vector3<f64>, dd_eta2: &Vector3<f64>) -> Self {
        let roll_pitch = RollPitch::of(eta2);
        Self {
            attitude: Attitude::of_euler(eta2),
            nu2: roll_pitch.body_rate(d_eta2),
            dnu2: roll_pitch.body_rate(dd_eta2) + roll_pitch.body_rate_dot(d_eta2, d_eta2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn desired_rates_are_those_of_the_desired_attitude() {
        let desired = |t: f64| Desired {
            attitude_rad: [0.4 * t, 0.3 - t, t * t],
            attitude_rate_rad_s: [0.4, -1.0, 2.0 * t],
            attitude_acceleration_rad_s2: [0.0, 0.0, 2.0],
            ..Desired::default()
        };
        let (t, h) = (0.7, 1e-5);
        let [before, at, after] = [t - h, t, t + h].map(|t| DesiredAttitude::of(&desired(t)));
        let spin = at.attitude.rot_wb().transpose()
            * (after.attitude.rot_wb() - before.attitude.rot_wb())
            / (2.0 * h);
        assert!((at.nu2 - Vector3::new(spin.m32, spin.m13, spin.m21)).amax() < 1e-9);
        assert!((at.dnu2 - (after.nu2 - before.nu2) / (2.0 * h)).amax() < 1e-9);
    }
}
