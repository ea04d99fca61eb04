//! Gains of both loops, and the three named sets of them.
//!
//! `paper` is the paper's own set (its alpha and Gamma) and needs the predictor to fly at 1 kHz. `flight` and `soft`
//! are this rig's sets: `flight` for a chain with delay and noise, `soft` for motors with lag.

use std::fmt;
use std::str::FromStr;

use model::parameters::Airframe;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A named set of gains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Default: tolerates 0 to 3 ticks of delay at 1 kHz, and gyro noise.
    Flight,
    /// The paper's alpha and Gamma. Needs the predictor; saturates under gyro noise.
    Paper,
    /// For motors with a lag of about 20 ms.
    Soft,
}

/// No preset has this name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown preset `{0}`; known are {names}", names = Preset::NAMES.join(", "))]
pub struct UnknownPreset(pub String);

/// Gains of the outer loop, the command filter, the inner loop and its adaptation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// K_P of the position loop [1/s^2].
    pub position_1_s2: f64,
    /// K_D of the position loop [1/s].
    pub velocity_1_s: f64,
    /// K_eta of roll, pitch, yaw [1/s].
    pub attitude_1_s: [f64; 3],
    /// w_f of the command filter for roll, pitch, yaw [rad/s].
    pub command_filter_rad_s: [f64; 3],
    /// alpha of the rate loop [1/s].
    pub alpha_1_s: f64,
    /// Diagonal of Gamma: gamma1 [kg^2 m^4 s^2], gamma2 [kg^2 m^4], gamma3 [1/s^2].
    pub adaptation: [f64; 3],
    /// w_e, bandwidth of the filter of the adaptation's samples [rad/s]; 0 is off.
    pub regressor_filter_rad_s: f64,
    /// Lower bounds of the estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub estimate_min: [f64; 3],
    /// Upper bounds of the estimates, in the same units.
    pub estimate_max: [f64; 3],
    /// Ticks that the inner loop predicts ahead: 0 (none) or 1 (the chain's delay).
    pub predictor_ticks: u32,
}

impl Preset {
    /// All of them, in the order of [`Self::NAMES`].
    pub const ALL: [Self; 3] = [Self::Flight, Self::Paper, Self::Soft];

    /// Their names, as typed by the user.
    pub const NAMES: [&str; 3] = ["flight", "paper", "soft"];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }
}

impl fmt::Display for Preset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Preset {
    type Err = UnknownPreset;

    fn from_str(name: &str) -> Result<Self, UnknownPreset> {
        Self::ALL.into_iter().find(|preset| preset.name() == name).ok_or_else(|| UnknownPreset(name.to_owned()))
    }
}

impl Gains {
    /// The gains of a preset.
    #[must_use]
    pub const fn preset(preset: Preset) -> Self {
        let flight = Self {
            position_1_s2: 1.0,
            velocity_1_s: 1.0,
            attitude_1_s: [8.0, 8.0, 3.0],
            command_filter_rad_s: [20.0, 20.0, 3.0],
            alpha_1_s: 200.0,
            adaptation: [2e-4, 0.6, 100.0],
            regressor_filter_rad_s: 50.0,
            estimate_min: [-1e-3, 0.0, -2.0],
            estimate_max: [1e-3, 1.0, 2.0],
            predictor_ticks: 0,
        };
        match preset {
            Preset::Flight => flight,
            Preset::Paper => Self {
                alpha_1_s: 1e4,
                adaptation: [1e4, 100.0, 2000.0],
                regressor_filter_rad_s: 0.0,
                predictor_ticks: 1,
                ..flight
            },
            Preset::Soft => Self { alpha_1_s: 40.0, adaptation: [4e-5, 0.12, 20.0], ..flight },
        }
    }
}

/// Damping of the rate loop that motors with a lag must leave: alpha tau at the most, as `soft` has it at 20 ms.
const ALPHA_LAG_MAX: f64 = 0.8;
/// How much slower than the rate loop the attitude loop and the command filter are at the least, as in `soft`.
const ATTITUDE_PER_ALPHA_MAX: f64 = 0.2;
const FILTER_PER_ALPHA_MAX: f64 = 0.5;

impl Gains {
    /// Gains that do for the airframe `to` what these do for `from`, both as they were built.
    ///
    /// K_P, K_D, K_eta, w_f, alpha and w_e are frequencies: they stay. An airframe whose inertia I_M, k_r and I_R are s
    /// times those of another turns like that one under s times the torque. In (8) the first two columns of Phi are
    /// then 1/s of what they were, and theta's first two elements s times. The update (20), Gamma Phi^T e, keeps up
    /// with that where gamma1 and gamma2 go with s^2. I_R stands beside the speed of the rotors, whose hover is r times
    /// as fast: gamma1 goes with (s/r)^2. delta and gamma3 are of no size. The bounds go with their parameters. s is
    /// the quotient of the traces of I_M.
    ///
    /// A motor with a lag tau [s] leaves the rate loop the damping 1/(2 sqrt(alpha tau)). Where alpha would leave less
    /// than 0.56, it is lowered to 0.8/tau, Gamma in proportion, and the loops around it to what they may be beside it.
    #[must_use]
    pub fn scaled(&self, from: &Airframe, to: &Airframe) -> Self {
        let trace = |airframe: &Airframe| airframe.i_m().iter().sum::<f64>();
        let s = trace(to) / trace(from);
        // Without gravity no rotor turns in hover, and the two are not compared.
        let per_r = if to.g() > 0.0 { from.hover_speed_rad_s() / to.hover_speed_rad_s() } else { 1.0 };
        let size = [s * per_r, s, 1.0];
        let alpha_1_s = match to.motor_time_constant_s() {
            lag_s if lag_s > 0.0 => self.alpha_1_s.min(ALPHA_LAG_MAX / lag_s),
            _ => self.alpha_1_s,
        };
        let slowed = alpha_1_s / self.alpha_1_s;
        let beside = |gain: f64, share: f64| if slowed < 1.0 { gain.min(share * alpha_1_s) } else { gain };
        Self {
            attitude_1_s: self.attitude_1_s.map(|gain| beside(gain, ATTITUDE_PER_ALPHA_MAX)),
            command_filter_rad_s: self.command_filter_rad_s.map(|gain| beside(gain, FILTER_PER_ALPHA_MAX)),
            alpha_1_s,
            adaptation: std::array::from_fn(|i| self.adaptation[i] * size[i] * size[i] * slowed),
            estimate_min: std::array::from_fn(|i| self.estimate_min[i] * size[i]),
            estimate_max: std::array::from_fn(|i| self.estimate_max[i] * size[i]),
            ..*self
        }
    }
}

impl Default for Gains {
    fn default() -> Self {
        Self::preset(Preset::Flight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::parameters::Parameter;

    /// An airframe of the paper's, with some values that are different.
    fn built(values: &[(Parameter, f64)]) -> Airframe {
        let mut all = *Airframe::nominal().values();
        for (parameter, value) in values {
            all[*parameter as usize] = *value;
        }
        Airframe::built_with(all).unwrap()
    }

    #[test]
    fn the_papers_airframe_keeps_every_preset_bit_for_bit() {
        for preset in Preset::ALL {
            let gains = Gains::preset(preset);
            assert_eq!(gains.scaled(&Airframe::nominal(), &Airframe::nominal()), gains);
        }
    }

    #[test]
    fn gamma_goes_with_the_square_of_the_inertia_and_frequencies_stay() {
        use Parameter::{InertiaX, InertiaY, InertiaZ, ThrustCoefficient};
        let gains = Gains::default();
        // Twice the inertia; a quarter of the thrust coefficient, so rotors twice as fast.
        let twice = [(InertiaX, 0.0138), (InertiaY, 0.0138), (InertiaZ, 0.0258), (ThrustCoefficient, 3.13e-5 / 4.0)];
        let scaled = gains.scaled(&Airframe::nominal(), &built(&twice));
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12 * b.abs();
        assert!(close(scaled.adaptation[0], 2e-4) && close(scaled.adaptation[1], 2.4), "{scaled:?}");
        assert_eq!((scaled.adaptation[2], scaled.alpha_1_s, scaled.attitude_1_s), (100.0, 200.0, [8.0, 8.0, 3.0]));
        assert!(close(scaled.estimate_max[0], 1e-3) && close(scaled.estimate_max[1], 2.0), "{scaled:?}");
    }

    #[test]
    fn an_airframe_without_gravity_has_gains_that_are_numbers() {
        let weightless = built(&[(Parameter::Gravity, 0.0)]);
        assert_eq!(Gains::default().scaled(&Airframe::nominal(), &weightless), Gains::default());
    }

    #[test]
    fn motors_with_a_lag_slow_the_loops_down_to_what_soft_has() {
        let slow = built(&[(Parameter::MotorTimeConstant, 0.02)]);
        let scaled = Gains::default().scaled(&Airframe::nominal(), &slow);
        let soft = Gains::preset(Preset::Soft);
        assert_eq!((scaled.alpha_1_s, scaled.attitude_1_s), (soft.alpha_1_s, soft.attitude_1_s));
        assert_eq!(scaled.command_filter_rad_s, soft.command_filter_rad_s);
        for i in 0..3 {
            assert!((scaled.adaptation[i] / soft.adaptation[i] - 1.0).abs() < 1e-12);
        }
        assert_eq!(soft.scaled(&Airframe::nominal(), &slow), soft);
    }
}
