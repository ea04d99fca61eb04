//! The adaptation: estimates I_R, k_r and delta from what the rotors really did.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (20)-(22) in discrete time. Differences from the paper:
//! * The update is implicit in the estimates. With the exact model, V_th = 1/2 ~th^T Gamma^-1 ~th therefore never
//!   rises, whatever alpha, Gamma and T. An explicit update diverges at the paper's Gamma.
//! * It works on the prediction error of the measured rates over the last tick instead of on e. It therefore stays
//!   right under delay, saturation and late commands.
//! * The regressor and the sample pass the same low-pass, against gyro noise.
//! * The estimates are kept inside bounds.
//!
//! Claim (18), that the estimates converge, holds only under persistent excitation: in hover I_R and k_r never move.

use control_api::law::Rig;
use messages::math::exp;
use messages::rate_dynamics::Inertia;
use nalgebra::{Matrix3, Vector3};

use crate::gains::Gains;
use crate::samples::LastTick;
use crate::weight::{Regression, Weight};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptation {
    /// Diagonal of Gamma: gamma1 [kg^2 m^4 s^2], gamma2 [kg^2 m^4], gamma3 [1/s^2].
    pub gamma: Vector3<f64>,
    /// T/alpha [s^2].
    pub step_s2: f64,
    /// p, share of the old samples that the low-pass keeps at each tick; 0 is no filter.
    pub p: f64,
    pub lo: Vector3<f64>,
    pub hi: Vector3<f64>,
    /// T [s].
    pub period_s: f64,
    pub inertia: Inertia,
}

/// What the adaptation has learnt, and the filtered samples behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learnt {
    /// theta: estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub theta: Vector3<f64>,
    pub x: Matrix3<f64>,
    /// Y, filtered sample of what the regressor must explain [rad/s^2].
    pub y: Vector3<f64>,
}

impl Adaptation {
    /// The adaptation of gains on a rig.
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let w_e = gains.regressor_filter_rad_s;
        Self {
            gamma: gains.adaptation.into(),
            step_s2: rig.period_s / gains.alpha_1_s,
            p: if w_e > 0.0 {
                exp(-w_e * rig.period_s)
            } else {
                0.0
            },
            lo: gains.estimate_min.into(),
            hi: gains.estimate_max.into(),
            period_s: rig.period_s,
            inertia: Inertia::new(rig.airframe.i_m().into()),
        }
    }

    /// What is known before the first tick: estimates of 0, or the bound nearest to it.
    pub fn prior(&self) -> Learnt {
        Learnt {
            theta: self.clip(&Vector3::zeros()),
            x: Matrix3::zeros(),
            y: Vector3::zeros(),
        }
    }

    /// Whether these are estimates that it could have come by: finite, and within their bounds.
    pub fn admits(&self, theta: &Vector3<f64>) -> bool {
        self.clip(theta) == *theta && theta.iter().all(|estimate| estimate.is_finite())
    }

    /// What is known after one more tick.
    pub fn step(&self, learnt: &Learnt, last: &LastTick) -> Learnt {
        let regression = self.regression(&learnt.x, &learnt.y, last);
        Learnt {
            theta: self.learn(&learnt.theta, &regression),
            x: regression.x,
            y: regression.y,
        }
    }

    /// X, Y and W after one more tick.
    pub fn regression(&self, x: &Matrix3<f64>, y: &Vector3<f64>, last: &LastTick) -> Regression {
        let (x, y) = self.filter(x, y, last);
        Regression {
            x,
            y,
            weight: Weight::new(&x, &self.gain()),
            last: *last,
        }
    }

    /// The estimates after a step from `theta`. The 3x3 weight is positive definite for every finite sample; were it
    /// not, the estimates would stay as they are.
    pub fn learn(&self, theta: &Vector3<f64>, regression: &Regression) -> Vector3<f64> {
        let Regression { x, y, weight, .. } = regression;
        let r = y - x * theta;
        weight.map_or(*theta, |weight| {
            let zb = weight.solve(&r);
            self.clip(&(theta + self.gain().component_mul(&x.tr_mul(&zb))))
        })
    }

    #[inline]
    pub fn gain(&self) -> Vector3<f64> {
        self.step_s2 * self.gamma
    }

    /// X and Y after one more tick: the low-pass over regressor and sample.
    pub fn filter(
        &self,
        x: &Matrix3<f64>,
        y: &Vector3<f64>,
        last: &LastTick,
    ) -> (Matrix3<f64>, Vector3<f64>) {
        let (phi, sample) = self.sample(last);
        (
            x + (1.0 - self.p) * (phi - x),
            y + (1.0 - self.p) * (sample - y),
        )
    }

    /// Phib and y: regressor of the last tick, and the acceleration [rad/s^2] that known terms do not explain.
    fn sample(&self, last: &LastTick) -> (Matrix3<f64>, Vector3<f64>) {
        let &LastTick {
            nu2_start,
            nu2_end,
            h_start,
            h_end,
            om_m,
            ref tau_m,
        } = last;
        // Phi is linear in rates and h: the mean of its two values is its value at the means.
        let phi = self.inertia.regressor(
            &(0.5 * (nu2_start + nu2_end)),
            om_m,
            &(0.5 * (h_start + h_end)),
        );
        let f = 0.5 * (self.inertia.coupling(&nu2_start) + self.inertia.coupling(&nu2_end));
        let dnu2 = (nu2_end - nu2_start) / self.period_s;
        (phi, dnu2 - f - self.inertia.acceleration(tau_m))
    }

    fn clip(&self, theta: &Vector3<f64>) -> Vector3<f64> {
        theta.sup(&self.lo).inf(&self.hi)
    }
}
