//! Inner law `adaptive_residual`: the paper's inner loop, and a torque against what its estimates leave unexplained.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (17)-(22), as [`crate::laws::adaptive`] samples them; and for the residual the piecewise-constant law of L1Quad
//! ([`crate::laws::l1`]). Parameters for what the model names, a torque for what it does not.
//!
//! ```text
//!     left = y - Phib theta                  of the last tick, with the estimates after it, unfiltered
//!     l <- p l + (1 - p) left,   p = exp(-w_c T)
//!     tau = (19) - I_M l
//! ```
//!
//! Differences from the sources: the paper has no residual, and L1 no parameters. The residual is what the predictor of L1
//! would say at A_s = 0. Nothing of l enters the adaptation: V_th obeys the theorem as under `adaptive`. V does not: over a
//! tick e gains T (Phi ~theta + l) instead of T Phi ~theta, and l follows Phi ~theta wherever the estimates are slower than w_c.

use control_api::description::{
    Description, Refused, Setting, Settings, Signal, Value, number, settings, three, xyz,
};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::role::Role;
use messages::telemetry::Telemetry;

use crate::gains::{self, Gains, preset};
use crate::laws::adaptive::{Adaptive, ESTIMATE, RATE_ERROR};
use crate::laws::observed::ALPHA_1_S;
use crate::laws::residual::Residual;
use crate::rate_loop;

/// Of these three the defaults differ from those of `adaptive`: Gamma/alpha is that of its preset `quick`.
const ADAPTATION_GAIN: Setting = Setting {
    kind: three([1.5e-4, 4.5, 300.0], f64::MIN_POSITIVE, f64::MAX),
    ..gains::ADAPTATION_GAIN
};
const REGRESSOR_FILTER_RAD_S: Setting = Setting {
    kind: number(0.0, 0.0, f64::MAX),
    ..gains::REGRESSOR_FILTER_RAD_S
};

settings! {
    RESIDUAL_FILTER = "residual_filter_rad_s", "rad/s", number(50.0, 0.1, 2000.0), "w_c of the low-pass of the residual";
}

/// The gains of this law's settings, for its monitor too.
pub fn gains(settings: &Settings) -> Gains {
    Gains {
        alpha_1_s: settings.number(&ALPHA_1_S),
        adaptation: settings.three(&ADAPTATION_GAIN),
        regressor_filter_rad_s: settings.number(&REGRESSOR_FILTER_RAD_S),
        ..Gains::of(settings)
    }
}

fn suited(settings: &Settings, rig: &Rig) -> Settings {
    let filter = settings.number(&RESIDUAL_FILTER);
    let (suited, slowed) = gains::suited_of(settings, &gains(settings), rig);
    suited.with(&RESIDUAL_FILTER, Value::Number(slowed * filter))
}

/// Residual of the estimates [rad/s^2] in the telemetry of [`AdaptiveResidual`]; 0 in the telemetry of [`Adaptive`].
pub fn residual(telemetry: &Telemetry) -> [f64; 3] {
    let [_, _, _, _, _, _, x, y, z, ..] = telemetry.value;
    [x, y, z]
}

const SIGNALS: [[Signal; 3]; 3] = [RATE_ERROR, ESTIMATE, xyz!("residual", "rad_s2", "rad/s^2")];

/// `adaptive` with a residual.
#[derive(Clone, Debug)]
pub struct AdaptiveResidual(Adaptive);

impl Law for AdaptiveResidual {
    const DESCRIPTION: Description = Description {
        name: "adaptive_residual",
        role: Role::Inner,
        version: "1",
        summary: "`adaptive`, and a torque against what its three estimates leave unexplained",
        source: "Imran and Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle, \
                 (17)-(22), sampled; the residual after Wu and others, L1Quad, arXiv:2302.07208",
        settings: &[
            gains::ATTITUDE,
            gains::ATTITUDE_1_S,
            gains::COMMAND_FILTER_RAD_S,
            ALPHA_1_S,
            gains::ADAPTATION,
            ADAPTATION_GAIN,
            REGRESSOR_FILTER_RAD_S,
            gains::ESTIMATE_MIN,
            gains::ESTIMATE_MAX,
            RESIDUAL_FILTER,
        ],
        presets: &[
            preset("flight", &[]),
            preset(
                "soft",
                &[
                    (ALPHA_1_S.name, Value::Number(40.0)),
                    (ADAPTATION_GAIN.name, Value::Three([4e-5, 1.2, 80.0])),
                    (RESIDUAL_FILTER.name, Value::Number(20.0)),
                ],
            ),
        ],
        suited: Some(suited),
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let gains = gains(settings);
        rate_loop::check_bounds(&gains)?;
        rate_loop::check_alpha(rig, gains.alpha_1_s, rate_loop::CHAIN_DELAY_TICKS, "")?;
        let residual = Residual::new(settings.number(&RESIDUAL_FILTER), rig.period_s);
        Ok(Self(Adaptive::with_residual(rig, &gains, residual)))
    }

    fn state(&mut self, fields: &mut Fields) {
        self.0.state(fields);
    }
}

impl InnerLaw for AdaptiveResidual {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        self.0.tick(input, telemetry)
    }
}
