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

use model::math::exp;
use model::rate_dynamics::{coupling, disturbance, regressor};
use nalgebra::{Cholesky, Matrix3, Vector3};

use crate::settings::LoopSettings;

/// The constants of the adaptation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptation {
    /// Diagonal of Gamma: gamma1 [kg^2 m^4 s^2], gamma2 [kg^2 m^4], gamma3 [1/s^2].
    pub gamma: Vector3<f64>,
    /// T/alpha [s^2].
    pub step_s2: f64,
    /// p, share of the old samples that the low-pass keeps at each tick; 0 is no filter.
    pub p: f64,
    /// Lower bounds of the estimates.
    pub lo: Vector3<f64>,
    /// Upper bounds of the estimates.
    pub hi: Vector3<f64>,
    /// T [s].
    pub period_s: f64,
    /// Diagonal of I_M [kg m^2].
    pub i_m: Vector3<f64>,
}

/// What the adaptation has learnt, and the filtered samples behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learnt {
    /// theta: estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub theta: Vector3<f64>,
    /// X, filtered regressor.
    pub x: Matrix3<f64>,
    /// Y, filtered sample of what the regressor must explain [rad/s^2].
    pub y: Vector3<f64>,
}

/// One whole tick as it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastTick {
    /// nu2 at its start [rad/s].
    pub nu2_start: Vector3<f64>,
    /// nu2 at its end [rad/s].
    pub nu2_end: Vector3<f64>,
    /// Time of its start [s].
    pub t_start_s: f64,
    /// Time of its end [s].
    pub t_end_s: f64,
    /// Om_m, mean net rotor speed [rad/s].
    pub om_m: f64,
    /// tau_m, mean torque of the rotors by the nominal model [N m].
    pub tau_m: Vector3<f64>,
}

impl Adaptation {
    /// The adaptation of settings.
    #[must_use]
    pub fn new(settings: &LoopSettings) -> Self {
        let gains = &settings.gains;
        let w_e = gains.regressor_filter_rad_s;
        Self {
            gamma: gains.adaptation.into(),
            step_s2: settings.period_s / gains.alpha_1_s,
            p: if w_e > 0.0 { exp(-w_e * settings.period_s) } else { 0.0 },
            lo: gains.estimate_min.into(),
            hi: gains.estimate_max.into(),
            period_s: settings.period_s,
            i_m: settings.model.i_m().into(),
        }
    }

    /// What is known before the first tick: estimates of 0, or the bound nearest to it.
    #[must_use]
    pub fn prior(&self) -> Learnt {
        Learnt { theta: self.clip(&Vector3::zeros()), x: Matrix3::zeros(), y: Vector3::zeros() }
    }

    /// What is known after one more tick. The 3x3 weight is positive definite for every finite sample; were it
    /// not, the estimates would stay as they are.
    #[must_use]
    pub fn step(&self, learnt: &Learnt, last: &LastTick) -> Learnt {
        let (x, y) = self.filter(&learnt.x, &learnt.y, last);
        let r = y - x * learnt.theta;
        let gamma_xt = Matrix3::from_diagonal(&self.gamma) * x.transpose();
        let weight = Matrix3::identity() + self.step_s2 * x * gamma_xt;
        let theta = Cholesky::new(weight).map_or(learnt.theta, |weight| {
            let zb = weight.solve(&r);
            self.clip(&(learnt.theta + self.step_s2 * gamma_xt * zb))
        });
        Learnt { theta, x, y }
    }

    /// X and Y after one more tick: the low-pass over regressor and sample.
    #[must_use]
    pub fn filter(&self, x: &Matrix3<f64>, y: &Vector3<f64>, last: &LastTick) -> (Matrix3<f64>, Vector3<f64>) {
        let (phi, sample) = self.sample(last);
        (x + (1.0 - self.p) * (phi - x), y + (1.0 - self.p) * (sample - y))
    }

    /// Phib and y: regressor of the last tick, and the acceleration [rad/s^2] that known terms do not explain.
    fn sample(&self, last: &LastTick) -> (Matrix3<f64>, Vector3<f64>) {
        let i_m = &self.i_m;
        let phi = (regressor(&last.nu2_start, last.om_m, &disturbance(last.t_start_s), i_m)
            + regressor(&last.nu2_end, last.om_m, &disturbance(last.t_end_s), i_m))
            / 2.0;
        let f = (coupling(&last.nu2_start, i_m) + coupling(&last.nu2_end, i_m)) / 2.0;
        let dnu2 = (last.nu2_end - last.nu2_start) / self.period_s;
        (phi, dnu2 - f - last.tau_m.component_div(i_m))
    }

    fn clip(&self, theta: &Vector3<f64>) -> Vector3<f64> {
        theta.sup(&self.lo).inf(&self.hi)
    }
}
