//! Settings of the paper's inner loop: filter, rate loop, adaptation, and the four named sets of them.
//!
//! `paper` is the paper's own set (its alpha and Gamma) and needs the predictor to fly at 1 kHz. The others are this
//! rig's sets: `flight` for a chain with delay and noise, `soft` for motors with lag, `quick` learns faster than `flight`.

use control_api::description::{Preset, SettingKind, Settings, Value, number, settings, three};
use control_api::law::Rig;
use messages::parameters::Airframe;

/// Words of [`ADAPTATION`].
const ON: &str = "on";
const OFF: &str = "off";
/// Words of [`ATTITUDE`].
const EULER: &str = "euler";
const QUATERNION: &str = "quaternion";

settings! {
    pub ATTITUDE = "attitude", "", SettingKind::Word(&[EULER, QUATERNION]), "error of the attitude: of the Euler angles, or of the rotation, which stays right where yaw saturates";
    pub ATTITUDE_1_S = "attitude_1_s", "1/s", three([8.0, 8.0, 3.0], f64::MIN_POSITIVE, f64::MAX), "K_eta: roll, pitch, yaw";
    pub COMMAND_FILTER_RAD_S = "command_filter_rad_s", "rad/s", three([20.0, 20.0, 3.0], f64::MIN_POSITIVE, f64::MAX), "w_f, bandwidth of the command filter: roll, pitch, yaw";
    pub ALPHA_1_S = "alpha_1_s", "1/s", number(200.0, f64::MIN_POSITIVE, f64::MAX), "alpha, decay of the rate error";
    pub PREDICTOR_TICKS = "predictor_ticks", "", number(0.0, 0.0, 1.0), "ticks that the loop predicts ahead: 0 (none) or 1 (the chain's delay)";
    pub ADAPTATION = "adaptation", "", SettingKind::Word(&[ON, OFF]), "whether I_R, k_r and delta are learnt; off keeps their priors";
    pub ADAPTATION_GAIN = "adaptation_gain", "", three([2e-4, 0.6, 100.0], f64::MIN_POSITIVE, f64::MAX), "Gamma: gamma1 [kg^2 m^4 s^2], gamma2 [kg^2 m^4], gamma3 [1/s^2]";
    pub REGRESSOR_FILTER_RAD_S = "regressor_filter_rad_s", "rad/s", number(50.0, 0.0, f64::MAX), "w_e, bandwidth of the filter of the adaptation's samples; 0 is off";
    pub ESTIMATE_MIN = "estimate_min", "", three([-1e-3, 0.0, -2.0], f64::MIN, f64::MAX), "lower bounds of I_R [kg m^2], k_r [N m s], delta [rad/s^2]";
    pub ESTIMATE_MAX = "estimate_max", "", three([1e-3, 1.0, 2.0], f64::MIN, f64::MAX), "upper bounds of the same";
}

/// Names of [`PRESETS`].
pub const PRESET_NAMES: [&str; 4] = ["flight", "paper", "soft", "quick"];

pub const PRESETS: &[Preset] = &[
    preset(PRESET_NAMES[0], &[]),
    preset(
        PRESET_NAMES[1],
        &[
            (ALPHA_1_S.name, Value::Number(1e4)),
            (PREDICTOR_TICKS.name, Value::Number(1.0)),
            (ADAPTATION_GAIN.name, Value::Three([1e4, 100.0, 2000.0])),
            (REGRESSOR_FILTER_RAD_S.name, Value::Number(0.0)),
        ],
    ),
    preset(
        PRESET_NAMES[2],
        &[
            (ALPHA_1_S.name, Value::Number(40.0)),
            (ADAPTATION_GAIN.name, Value::Three([4e-5, 0.12, 20.0])),
        ],
    ),
    preset(
        PRESET_NAMES[3],
        &[(ADAPTATION_GAIN.name, Value::Three([2e-4, 6.0, 400.0]))],
    ),
];

/// The same sets without what belongs to the adaptation.
pub const FIXED_PRESETS: &[Preset] = &[
    preset(PRESET_NAMES[0], &[]),
    preset(
        PRESET_NAMES[1],
        &[
            (ALPHA_1_S.name, Value::Number(1e4)),
            (PREDICTOR_TICKS.name, Value::Number(1.0)),
        ],
    ),
    preset(PRESET_NAMES[2], &[(ALPHA_1_S.name, Value::Number(40.0))]),
];

pub const fn preset(name: &'static str, values: &'static [(&'static str, Value)]) -> Preset {
    Preset { name, values }
}

/// How the attitude loop sees an attitude that is not the one wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttitudeError {
    /// As the difference of the Euler angles, as in the paper.
    Euler,
    /// As the rotation from the one to the other.
    Quaternion,
}

/// Gains of the command filter, the inner loop and its adaptation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    pub attitude_error: AttitudeError,
    pub attitude_1_s: [f64; 3],
    /// w_f of the command filter for roll, pitch, yaw [rad/s].
    pub command_filter_rad_s: [f64; 3],
    pub alpha_1_s: f64,
    /// Ticks that the inner loop predicts ahead: 0 (none) or 1 (the chain's delay).
    pub predictor_ticks: f64,
    pub adapts: bool,
    /// Diagonal of Gamma: gamma1 [kg^2 m^4 s^2], gamma2 [kg^2 m^4], gamma3 [1/s^2].
    pub adaptation: [f64; 3],
    /// w_e, bandwidth of the filter of the adaptation's samples [rad/s]; 0 is off.
    pub regressor_filter_rad_s: f64,
    /// Lower bounds of the estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub estimate_min: [f64; 3],
    /// Upper bounds of the estimates, in the same units.
    pub estimate_max: [f64; 3],
}

impl Gains {
    pub fn of(settings: &Settings) -> Self {
        Self {
            attitude_error: match settings.word(&ATTITUDE) {
                QUATERNION => AttitudeError::Quaternion,
                _ => AttitudeError::Euler,
            },
            attitude_1_s: settings.three(&ATTITUDE_1_S),
            command_filter_rad_s: settings.three(&COMMAND_FILTER_RAD_S),
            alpha_1_s: settings.number(&ALPHA_1_S),
            predictor_ticks: settings.number(&PREDICTOR_TICKS),
            adapts: settings.word(&ADAPTATION) == ON,
            adaptation: settings.three(&ADAPTATION_GAIN),
            regressor_filter_rad_s: settings.number(&REGRESSOR_FILTER_RAD_S),
            estimate_min: settings.three(&ESTIMATE_MIN),
            estimate_max: settings.three(&ESTIMATE_MAX),
        }
    }

    /// Those of a preset; none where there is none of that name.
    pub fn preset(name: &str) -> Option<Self> {
        let preset = PRESETS.iter().find(|preset| preset.name == name)?;
        Some(Self::of(&Settings::new(preset.values.to_vec())))
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
    /// K_eta, w_f, alpha and w_e are frequencies: they stay. An airframe whose inertia I_M, k_r and I_R are s
    /// times those of another turns like that one under s times the torque. In (8) the first two columns of Phi are
    /// then 1/s of what they were, and theta's first two elements s times. The update (20), Gamma Phi^T e, keeps up
    /// with that where gamma1 and gamma2 go with s^2. I_R stands beside the speed of the rotors, whose hover is r times
    /// as fast: gamma1 goes with (s/r)^2. delta and gamma3 are of no size. The bounds go with their parameters. s is
    /// the quotient of the traces of I_M.
    ///
    /// A motor with a lag tau [s] leaves the rate loop the damping 1/(2 sqrt(alpha tau)). Where alpha would leave less
    /// than 0.56, it is lowered to 0.8/tau, Gamma in proportion, and the loops around it to what they may be beside it.
    pub fn scaled(&self, from: &Airframe, to: &Airframe) -> Self {
        let trace = |airframe: &Airframe| airframe.i_m().iter().sum::<f64>();
        let s = trace(to) / trace(from);
        // Without gravity no rotor turns in hover, and the two are not compared.
        let per_r = if to.g() > 0.0 {
            from.hover_speed_rad_s() / to.hover_speed_rad_s()
        } else {
            1.0
        };
        let size = [s * per_r, s, 1.0];
        let alpha_1_s = match to.motor_time_constant_s() {
            lag_s if lag_s > 0.0 => self.alpha_1_s.min(ALPHA_LAG_MAX / lag_s),
            _ => self.alpha_1_s,
        };
        let slowed = alpha_1_s / self.alpha_1_s;
        let beside = |gain: f64, share: f64| {
            if slowed < 1.0 {
                gain.min(share * alpha_1_s)
            } else {
                gain
            }
        };
        Self {
            attitude_1_s: self
                .attitude_1_s
                .map(|gain| beside(gain, ATTITUDE_PER_ALPHA_MAX)),
            command_filter_rad_s: self
                .command_filter_rad_s
                .map(|gain| beside(gain, FILTER_PER_ALPHA_MAX)),
            alpha_1_s,
            adaptation: std::array::from_fn(|i| self.adaptation[i] * size[i] * size[i] * slowed),
            estimate_min: std::array::from_fn(|i| self.estimate_min[i] * size[i]),
            estimate_max: std::array::from_fn(|i| self.estimate_max[i] * size[i]),
            ..*self
        }
    }
}

/// Settings that do for the airframe of `rig` what these do for the nominal one: [`Gains::scaled`].
pub fn suited(settings: &Settings, rig: &Rig) -> Settings {
    suited_of(settings, &Gains::of(settings), rig).0
}

/// The same for a relative of the law, whose settings mean `gains`; and by how much its loops are slower.
pub fn suited_of(settings: &Settings, gains: &Gains, rig: &Rig) -> (Settings, f64) {
    let scaled = gains.scaled(&Airframe::nominal(), &rig.airframe);
    let settings = settings
        .clone()
        .with(&ATTITUDE_1_S, Value::Three(scaled.attitude_1_s))
        .with(
            &COMMAND_FILTER_RAD_S,
            Value::Three(scaled.command_filter_rad_s),
        )
        .with(&ALPHA_1_S, Value::Number(scaled.alpha_1_s))
        .with(&ADAPTATION_GAIN, Value::Three(scaled.adaptation))
        .with(&ESTIMATE_MIN, Value::Three(scaled.estimate_min))
        .with(&ESTIMATE_MAX, Value::Three(scaled.estimate_max));
    (settings, scaled.alpha_1_s / gains.alpha_1_s)
}

impl Default for Gains {
    fn default() -> Self {
        Self::of(&Settings::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::parameters::Parameter;

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
        for preset in PRESETS {
            let settings = Settings::new(preset.values.to_vec());
            let suited = suited(&settings, &Rig::default());
            assert_eq!(Gains::of(&suited), Gains::of(&settings), "{}", preset.name);
        }
    }

    #[test]
    fn gamma_goes_with_the_square_of_the_inertia_and_frequencies_stay() {
        use Parameter::{InertiaX, InertiaY, InertiaZ, ThrustCoefficient};
        let gains = Gains::default();
        // Twice the inertia; a quarter of the thrust coefficient, so rotors twice as fast.
        let twice = [
            (InertiaX, 0.0138),
            (InertiaY, 0.0138),
            (InertiaZ, 0.0258),
            (ThrustCoefficient, 3.13e-5 / 4.0),
        ];
        let scaled = gains.scaled(&Airframe::nominal(), &built(&twice));
        for (actual, expected) in [
            (scaled.adaptation[0], 2e-4),
            (scaled.adaptation[1], 2.4),
            (scaled.adaptation[2], 100.0),
            (scaled.estimate_max[0], 1e-3),
            (scaled.estimate_max[1], 2.0),
            (scaled.alpha_1_s, 200.0),
        ] {
            assert!((actual / expected - 1.0).abs() < 1e-12, "{scaled:?}");
        }
        assert_eq!(scaled.attitude_1_s, [8.0, 8.0, 3.0]);
    }

    #[test]
    fn an_airframe_without_gravity_has_gains_that_are_numbers() {
        let weightless = built(&[(Parameter::Gravity, 0.0)]);
        let scaled = Gains::default().scaled(&Airframe::nominal(), &weightless);
        assert_eq!(scaled, Gains::default());
    }

    #[test]
    fn motors_with_a_lag_slow_the_loops_down_to_what_soft_has() {
        let slow = built(&[(Parameter::MotorTimeConstant, 0.02)]);
        let scaled = Gains::default().scaled(&Airframe::nominal(), &slow);
        let soft = Gains::preset("soft").unwrap();
        assert_eq!(scaled.alpha_1_s, soft.alpha_1_s);
        assert_eq!(scaled.attitude_1_s, soft.attitude_1_s);
        assert_eq!(scaled.command_filter_rad_s, soft.command_filter_rad_s);
        for i in 0..3 {
            assert!((scaled.adaptation[i] / soft.adaptation[i] - 1.0).abs() < 1e-12);
        }
        assert_eq!(soft.scaled(&Airframe::nominal(), &slow), soft);
    }
}
