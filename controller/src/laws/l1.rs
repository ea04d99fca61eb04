//! Inner law `l1`: piecewise-constant L1 adaptive augmentation of the rate loop.
//!
//! Source: Zhuohuan Wu, Sheng Cheng, Pan Zhao, Aditya Gahlawat, Kasey A. Ackerman, Arun Lakshmanan, Chengyu Yang, Jiahao
//! Yu, Naira Hovakimyan, "L1Quad: L1 Adaptive Augmentation of Geometric Control for Agile Quadrotors With Performance
//! Guarantees", arXiv:2302.07208: state predictor, piecewise-constant adaptation law, low-pass C(s).
//!
//! ```text
//!     E = exp(A_s T), P = (E - 1)/A_s, A_s < 0                       p = exp(-w_c T)
//!     nu_hat <- nu_- + E (nu_hat - nu_-) + g + P sigma               over the tick from nu_- to nu
//!     sigma = -(E/P) (nu_hat - nu)                                   l <- p l + (1 - p) sigma,   w = l
//! ```
//!
//! sigma is E times the mean disturbance of the last tick: A_s only scales it by exp(A_s T). So w_c alone tunes.
//!
//! Differences from the paper:
//! * g comes from the measured speeds of the rotors, not from the commanded torque: the predictor knows no delay.
//! * A_s is one number, and only the body rates are predicted: the position loop is the outer law's.
//! * The predictor is exact for what is held over a tick; the paper's is an Euler step.
//! * The controller around it is the attitude loop of [`crate::attitude_loop`], not a geometric one.

use control_api::description::{Description, Settings, Signal, Value, number, settings, xyz};
use control_api::law::Fields;
use messages::math::{exp, exp_m1};
use messages::role::Role;
use nalgebra::Vector3;

use crate::gains::{self, preset};
use crate::laws::adaptive::RATE_ERROR;
use crate::laws::observed::{self, Observed, RateTick};

settings! {
    PREDICTOR = "predictor_1_s", "1/s", number(5.0, 0.01, 900.0), "-A_s, decay of the predictor's error";
    FILTER = "filter_rad_s", "rad/s", number(100.0, 0.1, 2000.0), "w_c of the low-pass of the disturbance";
}

pub type L1 = Observed<Observer>;

const SIGNALS: [[Signal; 3]; 3] = [
    RATE_ERROR,
    xyz!("uncertainty", "rad_s2", "rad/s^2"),
    xyz!("filtered", "rad_s2", "rad/s^2"),
];

#[derive(Clone, Debug)]
pub struct Observer {
    /// E, P [s], p.
    e: f64,
    p_s: f64,
    kept: f64,
    /// nu_hat [rad/s].
    nu_hat: Vector3<f64>,
    /// sigma and l [rad/s^2].
    sigma: Vector3<f64>,
    l: Vector3<f64>,
}

impl observed::Observer for Observer {
    const DESCRIPTION: Description = Description {
        name: "l1",
        role: Role::Inner,
        version: "1",
        summary: "L1 adaptive augmentation: a filtered torque against whatever the model does not explain",
        source: "Wu, Cheng, Zhao, Gahlawat, Ackerman, Lakshmanan, Yang, Yu, Hovakimyan, L1Quad: L1 Adaptive Augmentation \
                 of Geometric Control for Agile Quadrotors With Performance Guarantees, arXiv:2302.07208",
        settings: &[
            gains::ATTITUDE,
            gains::ATTITUDE_1_S,
            gains::COMMAND_FILTER_RAD_S,
            observed::ALPHA_1_S,
            PREDICTOR,
            FILTER,
        ],
        presets: &[
            preset("flight", &[]),
            preset(
                "soft",
                &[
                    (observed::ALPHA_1_S.name, Value::Number(40.0)),
                    (FILTER.name, Value::Number(20.0)),
                ],
            ),
        ],
        suited: Some(|settings, rig| observed::suited(settings, rig, &[(&FILTER, 1)])),
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(settings: &Settings, period_s: f64) -> Self {
        let a_s = -settings.number(&PREDICTOR);
        Self {
            e: exp(a_s * period_s),
            p_s: exp_m1(a_s * period_s) / a_s,
            kept: exp(-settings.number(&FILTER) * period_s),
            nu_hat: Vector3::zeros(),
            sigma: Vector3::zeros(),
            l: Vector3::zeros(),
        }
    }

    fn take(&mut self, tick: &RateTick) {
        let error = self.nu_hat - tick.start;
        self.nu_hat = tick.start + self.e * error + tick.gained + self.p_s * self.sigma;
        self.sigma = -self.e / self.p_s * (self.nu_hat - tick.end);
        self.l = self.kept * self.l + (1.0 - self.kept) * self.sigma;
    }

    fn restart(&mut self, nu2: &Vector3<f64>, is_long: bool) {
        (self.nu_hat, self.sigma) = (*nu2, Vector3::zeros());
        if is_long {
            self.l = Vector3::zeros();
        }
    }

    fn disturbance(&self, _: &Vector3<f64>) -> Vector3<f64> {
        self.l
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.nu_hat, &mut self.sigma, &mut self.l]);
    }

    fn shown(&self) -> impl IntoIterator<Item = Vector3<f64>> {
        [self.sigma, self.l]
    }
}
