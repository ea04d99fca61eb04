//! Settings of both loops, and the check that refuses what cannot fly.
//!
//! The paper has no counterpart: its loops are continuous and have neither delay nor limits.

use model::limits::RotorLimits;
use model::math::{exp_m1, ln_1p, sin};
use model::parameters::Airframe;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::gains::{Gains, Preset};
use crate::trajectory::Course;

/// Limits of the acceleration that the outer loop asks for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Smallest vertical thrust acceleration, in units of g.
    pub acceleration_z_min_g: f64,
    /// Largest vertical thrust acceleration, in units of g.
    pub acceleration_z_max_g: f64,
    /// Largest angle between the thrust asked for and the vertical [rad].
    pub tilt_max_rad: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { acceleration_z_min_g: 0.2, acceleration_z_max_g: 2.0, tilt_max_rad: 35_f64.to_radians() }
    }
}

impl Limits {
    /// Limits that an airframe with these rotors can keep, as it was built.
    ///
    /// Half of what its rotors can give beyond hover is left for the torque; the paper's airframe, whose rotors carry
    /// three times its weight, keeps the default of 2 g.
    #[must_use]
    pub fn scaled(&self, to: &Airframe, rotor: &RotorLimits) -> Self {
        let most_g = 4.0 * rotor.f_max(to.k()) / (to.m() * to.g());
        let with_room_g = 1.0 + 0.5 * (most_g - 1.0);
        // Without gravity there is no weight to compare with.
        let max_g = if with_room_g > self.acceleration_z_min_g { with_room_g } else { self.acceleration_z_max_g };
        Self { acceleration_z_max_g: self.acceleration_z_max_g.min(max_g), ..*self }
    }
}

/// Everything that the two loops are told before a flight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopSettings {
    /// T, length of a tick [s].
    pub period_s: f64,
    /// What to fly.
    pub trajectory: Course,
    /// Gains of both loops.
    pub gains: Gains,
    /// Limits of the outer loop.
    pub limits: Limits,
    /// Limits of the rotors.
    pub rotor: RotorLimits,
    /// Nominal airframe; of it, I_R, k_r and delta are not used but learnt.
    pub model: Airframe,
}

/// Why settings were refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SettingsError {
    /// A value is outside its range, or not a number.
    #[error("{key} = {value} is out of range: allowed is {allowed}")]
    OutOfRange {
        /// Name of the setting.
        key: String,
        /// The value that was refused.
        value: f64,
        /// The range, in words.
        allowed: &'static str,
    },
    /// A lower limit is above its upper limit.
    #[error("{low_key} = {low} must not be above {high_key} = {high}")]
    Crossed {
        /// Name of the lower limit.
        low_key: String,
        /// Its value.
        low: f64,
        /// Name of the upper limit.
        high_key: String,
        /// Its value.
        high: f64,
    },
    /// The predictor does not look ahead by the chain's delay.
    #[error(
        "gains.predictor_ticks = {0}: allowed are 0 (none) and 1 (the chain's delay); \
         one that looks too far ahead is worse than none"
    )]
    PredictorDepth(u32),
    /// The rotors cannot carry the airframe, or cannot let it down.
    #[error(
        "hover needs m g = {hover_n} N, but the rotors give {min_n} N to {max_n} N; \
         change rotor.min_rad_s, rotor.max_rad_s or the model"
    )]
    CannotHover {
        /// Thrust in hover [N].
        hover_n: f64,
        /// Thrust of all rotors at their smallest speed [N].
        min_n: f64,
        /// Thrust of all rotors at their largest speed [N].
        max_n: f64,
    },
    /// The rate loop is unstable once a command is late.
    #[error(
        "gains.alpha_1_s = {alpha_1_s} cannot fly at period_s = {period_s}: with a late command ({delay_ticks} \
         ticks of delay unpredicted) the rate loop needs 1 - exp(-alpha T) < 2 sin(pi/{divisor}) = {limit:.6}, \
         but it is {loop_gain:.6}; keep gains.alpha_1_s below {alpha_max_1_s:.1}, or period_s below \
         {period_max_s:.6}{remedy}",
        divisor = 2 * (2 * delay_ticks + 1),
        remedy = if *delay_ticks == CHAIN_DELAY_TICKS { ", or set gains.predictor_ticks = 1" } else { "" }
    )]
    RateLoopUnstable {
        /// alpha [1/s].
        alpha_1_s: f64,
        /// T [s].
        period_s: f64,
        /// Delay that the predictor leaves, in ticks.
        delay_ticks: u32,
        /// a_d T = 1 - exp(-alpha T).
        loop_gain: f64,
        /// What a_d T must stay below.
        limit: f64,
        /// What alpha must stay below at this period [1/s].
        alpha_max_1_s: f64,
        /// What the period must stay below at this alpha [s].
        period_max_s: f64,
    },
}

/// Delay of the chain that must be survived: one tick by design, and one more for a late command.
const CHAIN_DELAY_TICKS: u32 = 2;

impl LoopSettings {
    /// A trajectory with the gains of a preset; nominal airframe and limits, 1 kHz.
    #[must_use]
    pub fn new(trajectory: impl Into<Course>, preset: Preset) -> Self {
        Self {
            period_s: 1e-3,
            trajectory: trajectory.into(),
            gains: Gains::preset(preset),
            limits: Limits::default(),
            rotor: RotorLimits::default(),
            model: Airframe::nominal(),
        }
    }

    /// Refuses settings that are meaningless or cannot fly. Nothing is changed to fit.
    ///
    /// # Errors
    /// The first [`SettingsError`] found, with its key, value and what is allowed.
    pub fn check(&self) -> Result<(), SettingsError> {
        within("period_s", self.period_s, 1e-4, 2e-2, "0.0001 to 0.02 s")?;
        self.check_gains()?;
        self.check_limits()?;
        self.check_rate_loop()
    }

    fn check_gains(&self) -> Result<(), SettingsError> {
        let gains = &self.gains;
        positive("gains.position_1_s2", gains.position_1_s2)?;
        positive("gains.velocity_1_s", gains.velocity_1_s)?;
        positive("gains.alpha_1_s", gains.alpha_1_s)?;
        for i in 0..3 {
            positive(&format!("gains.attitude_1_s[{i}]"), gains.attitude_1_s[i])?;
            let key = format!("gains.command_filter_rad_s[{i}]");
            positive(&key, gains.command_filter_rad_s[i])?;
            positive(&format!("gains.adaptation[{i}]"), gains.adaptation[i])?;
            ordered(
                &format!("gains.estimate_min[{i}]"),
                gains.estimate_min[i],
                &format!("gains.estimate_max[{i}]"),
                gains.estimate_max[i],
            )?;
        }
        within(
            "gains.regressor_filter_rad_s",
            gains.regressor_filter_rad_s,
            0.0,
            f64::MAX,
            "0 (off) or a finite number above it",
        )?;
        match gains.predictor_ticks {
            0 | 1 => Ok(()),
            depth => Err(SettingsError::PredictorDepth(depth)),
        }
    }

    fn check_limits(&self) -> Result<(), SettingsError> {
        let Limits { acceleration_z_min_g, acceleration_z_max_g, tilt_max_rad } = self.limits;
        positive("limits.acceleration_z_min_g", acceleration_z_min_g)?;
        ordered(
            "limits.acceleration_z_min_g",
            acceleration_z_min_g,
            "limits.acceleration_z_max_g",
            acceleration_z_max_g,
        )?;
        within("limits.tilt_max_rad", tilt_max_rad, 1e-3, 1.5, "0.001 to 1.5 rad")?;
        let RotorLimits { min_rad_s, max_rad_s } = self.rotor;
        within("rotor.min_rad_s", min_rad_s, 0.0, f64::MAX, "0 or a finite number above it")?;
        ordered("rotor.min_rad_s", min_rad_s, "rotor.max_rad_s", max_rad_s)?;
        let hover_n = self.model.m() * self.model.g();
        let min_n = 4.0 * self.rotor.f_min(self.model.k());
        let max_n = 4.0 * self.rotor.f_max(self.model.k());
        if min_n < hover_n && hover_n < max_n {
            Ok(())
        } else {
            Err(SettingsError::CannotHover { hover_n, min_n, max_n })
        }
    }

    /// The rate loop under delay: e(k+1) = e(k) - a_d T e(k-d) is stable exactly while
    /// a_d T < 2 sin(pi / (2 (2d + 1))), where a_d T = 1 - exp(-alpha T) (see [`loop_gain_limit`]).
    ///
    /// Without predictor d is the whole delay of the chain with one late command, 2: alpha < 0.9624/T, 962/s
    /// at 1 kHz. The predictor starts from the command in force, which the state message names, so it takes one
    /// tick off even when a command is late: d = 1, limit 1, and 1 - exp(-alpha T) is always below that. Only
    /// where it rounds to 1 (alpha T above 36) is no margin left, and the settings are refused.
    fn check_rate_loop(&self) -> Result<(), SettingsError> {
        let alpha_t = self.gains.alpha_1_s * self.period_s;
        let delay_ticks = CHAIN_DELAY_TICKS.saturating_sub(self.gains.predictor_ticks);
        let limit = loop_gain_limit(delay_ticks);
        let loop_gain = -exp_m1(-alpha_t);
        if loop_gain < limit {
            return Ok(());
        }
        let alpha_t_max = -ln_1p(-limit);
        Err(SettingsError::RateLoopUnstable {
            alpha_1_s: self.gains.alpha_1_s,
            period_s: self.period_s,
            delay_ticks,
            loop_gain,
            limit,
            alpha_max_1_s: alpha_t_max / self.period_s,
            period_max_s: alpha_t_max / self.gains.alpha_1_s,
        })
    }
}

/// Largest loop gain c for which e(k+1) = e(k) - c e(k-d) is stable: 2 sin(pi / (2 (2d + 1))).
///
/// The characteristic z^(d+1) - z^d + c has its first root on the unit circle, z = exp(i w), where
/// c = |z - 1| = 2 sin(w/2) and the angles agree at w = pi/(2d + 1). So 2, 1 and 0.618 for d = 0, 1 and 2.
#[must_use]
pub fn loop_gain_limit(delay_ticks: u32) -> f64 {
    let d = f64::from(delay_ticks);
    2.0 * sin(std::f64::consts::PI / (2.0 * (2.0 * d + 1.0)))
}

fn positive(key: &str, value: f64) -> Result<(), SettingsError> {
    within(key, value, f64::MIN_POSITIVE, f64::MAX, "a finite number above 0")
}

fn within(key: &str, value: f64, min: f64, max: f64, allowed: &'static str) -> Result<(), SettingsError> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(SettingsError::OutOfRange { key: key.to_owned(), value, allowed })
    }
}

fn ordered(low_key: &str, low: f64, high_key: &str, high: f64) -> Result<(), SettingsError> {
    for (key, value) in [(low_key, low), (high_key, high)] {
        within(key, value, f64::MIN, f64::MAX, "a finite number")?;
    }
    if low <= high {
        Ok(())
    } else {
        Err(SettingsError::Crossed { low_key: low_key.to_owned(), low, high_key: high_key.to_owned(), high })
    }
}
