//! Inner law `sliding`: the super-twisting algorithm as an observer of the disturbance, and a linear rate loop.
//!
//! Source: Arie Levant, "Robust exact differentiation via sliding mode technique", Automatica 34 (3), 1998, for the
//! algorithm and its gains; Bernard Brogliato, Andrey Polyakov, Denis Efimov, "The Implicit Discretization of the
//! Supertwisting Sliding-Mode Control Algorithm", IEEE Transactions on Automatic Control 65 (8), 2020, for the implicit
//! Euler step, which does not chatter.
//!
//! ```text
//!     k1 = 1.5 sqrt(L), k2 = 1.1 L,   |dw/dt| <= L is what can be followed
//!     pred = nu_hat + g,   b = nu - pred - T w                                            over the tick to nu
//!     |b| <= T^2 k2:   w <- (nu - pred)/T,   nu_hat <- nu
//!     else:            y = (-T k1 + sqrt(T^2 k1^2 + 4 (|b| - T^2 k2)))/2
//!                      w <- w + T k2 sgn b,   nu_hat <- nu - y^2 sgn b
//! ```
//!
//! Inside the set w is the mean disturbance of the last tick; outside, |dw/dt| <= k2 limits what noise can do.
//!
//! Differences from the sources: the algorithm observes, it does not control. As a controller of the rate error e, with
//! u = -k1 sqrt(|e|) sgn e + w and the implicit step, the set |b| <= T^2 k2 answers u = -e/T: dead beat, and w is
//! overwritten in every tick, so that nothing is integrated. With e predicted over the one tick of delay, a constant
//! disturbance phi leaves e = 2 T phi, whatever L is: a proportional loop of 1/(2T) without integral action. Without that
//! prediction z^2 - z + 1 = 0, a limit cycle; with phi = -w in the prediction, the same.

use control_api::description::{Description, Settings, Signal, Value, settings, three, xyz};
use control_api::law::Fields;
use messages::role::Role;
use nalgebra::Vector3;

use crate::gains::{self, preset};
use crate::laws::adaptive::RATE_ERROR;
use crate::laws::observed::{self, Observed, RateTick};

settings! {
    DISTURBANCE_RATE = "disturbance_rate_rad_s3", "rad/s^3", three([100.0, 100.0, 40.0], 0.1, 1e5), "L, largest rate of the disturbance: roll, pitch, yaw";
}

pub type Sliding = Observed<Observer>;

const SIGNALS: [[Signal; 3]; 2] = [RATE_ERROR, xyz!("uncertainty", "rad_s2", "rad/s^2")];

#[derive(Clone, Debug)]
pub struct Observer {
    period_s: f64,
    k1: Vector3<f64>,
    k2: Vector3<f64>,
    /// nu_hat [rad/s].
    nu_hat: Vector3<f64>,
    /// w [rad/s^2].
    w: Vector3<f64>,
}

impl observed::Observer for Observer {
    const DESCRIPTION: Description = Description {
        name: "sliding",
        role: Role::Inner,
        version: "1",
        summary: "sliding-mode (super-twisting) observer of the disturbance, which a linear rate loop cancels",
        source: "Levant, Robust exact differentiation via sliding mode technique, Automatica 34(3), 1998; Brogliato, \
                 Polyakov, Efimov, The Implicit Discretization of the Supertwisting Sliding-Mode Control Algorithm, \
                 IEEE TAC 65(8), 2020",
        settings: &[
            gains::ATTITUDE,
            gains::ATTITUDE_1_S,
            gains::COMMAND_FILTER_RAD_S,
            observed::ALPHA_1_S,
            DISTURBANCE_RATE,
        ],
        presets: &[
            preset("flight", &[]),
            preset(
                "soft",
                &[
                    (observed::ALPHA_1_S.name, Value::Number(40.0)),
                    (DISTURBANCE_RATE.name, Value::Three([50.0, 50.0, 20.0])),
                ],
            ),
        ],
        suited: Some(|settings, rig| observed::suited(settings, rig, &[(&DISTURBANCE_RATE, 1)])),
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(settings: &Settings, period_s: f64) -> Self {
        let l = Vector3::from(settings.three(&DISTURBANCE_RATE));
        Self {
            period_s,
            k1: l.map(|l| 1.5 * l.sqrt()),
            k2: 1.1 * l,
            nu_hat: Vector3::zeros(),
            w: Vector3::zeros(),
        }
    }

    fn take(&mut self, tick: &RateTick) {
        let period_s = self.period_s;
        for i in 0..3 {
            let (k1, k2, end) = (period_s * self.k1[i], period_s * self.k2[i], tick.end[i]);
            let left = end - (self.nu_hat[i] + tick.gained[i]);
            let b = left - period_s * self.w[i];
            let outside = b.abs() - period_s * k2;
            if outside <= 0.0 {
                (self.w[i], self.nu_hat[i]) = (left / period_s, end);
            } else {
                let y = 0.5 * ((k1 * k1 + 4.0 * outside).sqrt() - k1);
                self.w[i] += k2.copysign(b);
                self.nu_hat[i] = end - (y * y).copysign(b);
            }
        }
    }

    fn restart(&mut self, nu2: &Vector3<f64>, is_long: bool) {
        self.nu_hat = *nu2;
        if is_long {
            self.w = Vector3::zeros();
        }
    }

    fn disturbance(&self, _: &Vector3<f64>) -> Vector3<f64> {
        self.w
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.nu_hat, &mut self.w]);
    }

    fn shown(&self) -> impl IntoIterator<Item = Vector3<f64>> {
        [self.w]
    }
}
