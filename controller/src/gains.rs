//! Gains of both loops, and the three named sets of them.
//!
//! `paper` is the paper's own set (its alpha and Gamma) and needs the predictor to fly at 1 kHz. `flight` and `soft`
//! are this rig's sets: `flight` for a chain with delay and noise, `soft` for motors with lag.

use std::fmt;
use std::str::FromStr;

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

impl Default for Gains {
    fn default() -> Self {
        Self::preset(Preset::Flight)
    }
}
