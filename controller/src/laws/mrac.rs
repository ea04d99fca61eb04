//! Inner law `mrac`: model-reference adaptive control of the rates, with a damping and a bias per axis.
//!
//! Source: Eugene Lavretsky, Kevin A. Wise, "Robust and Adaptive Control", Springer 2013: reference model with error
//! feedback (the state predictor), projection; e-modification after Kumpati S. Narendra, Anuradha M. Annaswamy, "A New
//! Adaptive Law for Robust Adaptation without Persistent Excitation", IEEE Transactions on Automatic Control 32 (2), 1987;
//! hedging after Eric N. Johnson, Anthony J. Calise, "Pseudo-Control Hedging", 2000.
//!
//! ```text
//!     nu' = g/T + a nu + d          a [1/s] and d [rad/s^2] unknown, per axis            ph = (nu_- + nu)/2
//!     nu_m = nu_- - E (nu_- - nu_m) + g + T (a ph + d),   E = exp(-lambda T)             over the tick from nu_- to nu
//!     eps = nu - nu_m,   s = T/(1 + T^2 (g_nu ph^2 + g_1))
//!     a <- clip(a + s g_nu (ph eps - mu |eps| a), -150, 20)
//!     d <- clip(d + s g_1 (eps - mu |eps| d), -100, 100)                                  w = a nu + d
//! ```
//!
//! A reference model that is hedged by the whole difference between demanded and real torque *is* that predictor, so it
//! needs no signal of its own. The defaults are critically damped: g_1 = lambda^2/4. The bias does nearly all; a wanders
//! unless all rates move.
//!
//! Differences from the sources:
//! * The gradient is normalised, as the sampled law would diverge at large rates without it.
//! * The predictor is exact for its own pole over a tick; g comes from the measured speeds of the rotors.

use control_api::description::{Description, Settings, Signal, Value, number, settings, xyz};
use control_api::law::Fields;
use messages::math::exp;
use messages::role::Role;
use nalgebra::Vector3;

use crate::gains::{self, preset};
use crate::laws::adaptive::RATE_ERROR;
use crate::laws::observed::{self, Observed, RateTick};

/// Bounds of a [1/s] and d [rad/s^2].
const A_MIN: f64 = -150.0;
const A_MAX: f64 = 20.0;
const D_MAX: f64 = 100.0;

settings! {
    MODEL = "model_1_s", "1/s", number(100.0, 1.0, 900.0), "lambda, decay of the reference model's error";
    GAIN_RATE = "gain_rate_1_rad2", "1/rad^2", number(1e4, 0.0, 1e6), "g_nu, gain of the damping's estimate";
    GAIN_BIAS = "gain_bias_1_s2", "1/s^2", number(2500.0, 0.0, 1e6), "g_1, gain of the bias's estimate";
    MODIFICATION = "modification", "", number(1e-3, 0.0, 10.0), "mu of the e-modification";
}

pub type Mrac = Observed<Observer>;

const SIGNALS: [[Signal; 3]; 4] = [
    RATE_ERROR,
    xyz!("model_error", "rad_s", "rad/s"),
    xyz!("damping", "1_s", "1/s"),
    xyz!("bias", "rad_s2", "rad/s^2"),
];

#[derive(Clone, Debug)]
pub struct Observer {
    period_s: f64,
    e: f64,
    g_nu: f64,
    g_1: f64,
    mu: f64,
    /// nu_m and eps [rad/s].
    nu_m: Vector3<f64>,
    eps: Vector3<f64>,
    a: Vector3<f64>,
    d: Vector3<f64>,
}

impl observed::Observer for Observer {
    const DESCRIPTION: Description = Description {
        name: "mrac",
        role: Role::Inner,
        version: "1",
        summary: "model-reference adaptive rate control: a damping and a bias per axis, with projection",
        source: "Lavretsky, Wise, Robust and Adaptive Control, Springer 2013; Narendra, Annaswamy, IEEE TAC 32(2), 1987; \
                 Johnson, Calise, Pseudo-Control Hedging, 2000",
        settings: &[
            gains::ATTITUDE,
            gains::ATTITUDE_1_S,
            gains::COMMAND_FILTER_RAD_S,
            observed::ALPHA_1_S,
            MODEL,
            GAIN_RATE,
            GAIN_BIAS,
            MODIFICATION,
        ],
        presets: &[
            preset("flight", &[]),
            preset(
                "soft",
                &[
                    (observed::ALPHA_1_S.name, Value::Number(40.0)),
                    (MODEL.name, Value::Number(40.0)),
                    (GAIN_RATE.name, Value::Number(1600.0)),
                    (GAIN_BIAS.name, Value::Number(400.0)),
                ],
            ),
        ],
        suited: Some(|settings, rig| {
            observed::suited(
                settings,
                rig,
                &[(&MODEL, 1), (&GAIN_RATE, 2), (&GAIN_BIAS, 2)],
            )
        }),
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(settings: &Settings, period_s: f64) -> Self {
        Self {
            period_s,
            e: exp(-settings.number(&MODEL) * period_s),
            g_nu: settings.number(&GAIN_RATE),
            g_1: settings.number(&GAIN_BIAS),
            mu: settings.number(&MODIFICATION),
            nu_m: Vector3::zeros(),
            eps: Vector3::zeros(),
            a: Vector3::zeros(),
            d: Vector3::zeros(),
        }
    }

    fn take(&mut self, tick: &RateTick) {
        let (period_s, g_nu, g_1) = (self.period_s, self.g_nu, self.g_1);
        for i in 0..3 {
            let (start, end) = (tick.start[i], tick.end[i]);
            let ph = 0.5 * (start + end);
            let learnt = period_s * (self.a[i] * ph + self.d[i]);
            self.nu_m[i] = start - self.e * (start - self.nu_m[i]) + tick.gained[i] + learnt;
            let eps = end - self.nu_m[i];
            let s = period_s / (1.0 + period_s * period_s * (g_nu * ph * ph + g_1));
            let decay = self.mu * eps.abs();
            let (a, d) = (self.a[i], self.d[i]);
            self.a[i] = (a + s * g_nu * (ph * eps - decay * a)).clamp(A_MIN, A_MAX);
            self.d[i] = (d + s * g_1 * (eps - decay * d)).clamp(-D_MAX, D_MAX);
            self.eps[i] = eps;
        }
    }

    fn restart(&mut self, nu2: &Vector3<f64>, is_long: bool) {
        (self.nu_m, self.eps) = (*nu2, Vector3::zeros());
        if is_long {
            (self.a, self.d) = (Vector3::zeros(), Vector3::zeros());
        }
    }

    fn disturbance(&self, nu2: &Vector3<f64>) -> Vector3<f64> {
        self.a.component_mul(nu2) + self.d
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.nu_m, &mut self.eps, &mut self.a, &mut self.d]);
    }

    fn shown(&self) -> impl IntoIterator<Item = Vector3<f64>> {
        [self.eps, self.a, self.d]
    }
}
