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
//! A tick counts only if both its start and its end were measured ([`Samples`]): the rotor means of a state cover one tick.
//! X, Y and the weight W follow from settings and states alone ([`Evidence`]), and no estimate enters them. So the monitor
//! gets the law's own numbers from the states that the law had. W = I + X G X^T with G = (T/alpha) Gamma is symmetric, and
//! positive definite for every finite X; its factors ([`Weight`]) are L D L^T, with ones on the diagonal of L.
//!
//! Claim (18), that the estimates converge, holds only under persistent excitation: in hover I_R and k_r never move.

use control_api::law::Rig;
use control_api::saved_state::{Fields, saved_fields};
use messages::allocation::{Allocation, net_speed};
use messages::content::{Measured, NO_TICK, ROTORS};
use messages::math::exp;
use messages::rate_dynamics::{Inertia, disturbance};
use nalgebra::{Matrix3, Vector3};

use crate::gains::Gains;

/// One whole tick as it was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LastTick {
    /// nu2 at its start [rad/s].
    pub nu2_start: Vector3<f64>,
    /// nu2 at its end [rad/s].
    pub nu2_end: Vector3<f64>,
    /// h(t) at its start, without unit.
    pub h_start: Vector3<f64>,
    /// h(t) at its end, without unit.
    pub h_end: Vector3<f64>,
    pub om_m: f64,
    /// tau_m, mean torque of the rotors by the nominal model [N m].
    pub tau_m: Vector3<f64>,
}

/// The newest measured body rates, and the nominal rotors between them and the ones before.
#[derive(Clone, Debug)]
pub struct Samples {
    period_s: f64,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    newest: Option<Sample>,
    /// h(t) at the tick that was asked for last: a predictor asks for the tick to come.
    h: (u64, Vector3<f64>),
}

/// Body rates that were measured in time.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    tick: u64,
    nu2: Vector3<f64>,
    h: Vector3<f64>,
}

saved_fields!(Sample: tick, nu2, h);

impl Samples {
    pub fn new(rig: &Rig) -> Self {
        Self {
            period_s: rig.period_s,
            allocation: Allocation::new(&rig.airframe),
            k: rig.airframe.k(),
            newest: None,
            h: (NO_TICK, Vector3::zeros()),
        }
    }

    pub fn newest_tick(&self) -> Option<u64> {
        self.newest.map(|newest| newest.tick)
    }

    /// h(t) at a tick, without unit.
    pub fn h(&mut self, tick: u64) -> Vector3<f64> {
        if self.h.0 != tick {
            self.h = (tick, disturbance(tick as f64 * self.period_s));
        }
        self.h.1
    }

    /// h(t) at the newest sample, without unit; 0 before the first.
    pub fn newest_h(&self) -> Vector3<f64> {
        self.newest.map_or(Vector3::zeros(), |newest| newest.h)
    }

    /// Takes the measurement of `tick`; gives the tick that ended with it, unless its start was not measured.
    pub fn take(&mut self, tick: u64, measured: &Measured) -> Option<LastTick> {
        let end = Sample {
            tick,
            nu2: measured.rate_b_rad_s.into(),
            h: self.h(tick),
        };
        let start = self.newest.replace(end)?;
        (start.tick + 1 == tick).then(|| LastTick {
            nu2_start: start.nu2,
            nu2_end: end.nu2,
            h_start: start.h,
            h_end: end.h,
            om_m: net_speed(&measured.rotor_speed_mean_rad_s.into()),
            tau_m: self.rotor_torque(&measured.rotor_speed_squared_mean_rad2_s2),
        })
    }

    /// Lists what the next tick needs; h(t) follows from the tick.
    pub fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.newest]);
    }

    /// (6), (7): torque [N m] of rotors at these squared speeds [rad^2/s^2], by the nominal model.
    pub fn rotor_torque(&self, speed_squared: &[f64; ROTORS]) -> Vector3<f64> {
        let f = speed_squared.map(|w2| self.k * w2);
        self.allocation.wrench(&f.into()).1
    }
}

/// X and Y after a whole tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Regression {
    pub x: Matrix3<f64>,
    /// Y, filtered sample of what the regressor must explain [rad/s^2].
    pub y: Vector3<f64>,
    /// W = I + (T/alpha) X Gamma X^T; none where it is no number.
    pub weight: Option<Weight>,
    pub last: LastTick,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// L: 10, 20, 21.
    l: [f64; 3],
    per_d: Vector3<f64>,
}

impl Weight {
    /// Of X and the diagonal of G; none where W is no number.
    #[inline]
    pub fn new(x: &Matrix3<f64>, g: &Vector3<f64>) -> Option<Self> {
        let row = |i: usize| Vector3::new(x[(i, 0)], x[(i, 1)], x[(i, 2)]);
        let [x0, x1, x2] = [row(0), row(1), row(2)];
        let [g0, g1, g2] = [x0, x1, x2].map(|row| row.component_mul(g));
        let d0 = 1.0 + x0.dot(&g0);
        let per_d0 = 1.0 / d0;
        let (w10, w20) = (x1.dot(&g0), x2.dot(&g0));
        let (l10, l20) = (w10 * per_d0, w20 * per_d0);
        let d1 = 1.0 + x1.dot(&g1) - l10 * w10;
        let per_d1 = 1.0 / d1;
        let w21 = x2.dot(&g1) - l20 * w10;
        let l21 = w21 * per_d1;
        let d2 = 1.0 + x2.dot(&g2) - l20 * w20 - l21 * w21;
        let is_positive = d0 > 0.0 && d1 > 0.0 && d2 > 0.0;
        is_positive.then(|| Self {
            l: [l10, l20, l21],
            per_d: Vector3::new(per_d0, per_d1, 1.0 / d2),
        })
    }

    #[inline]
    pub fn solve(&self, r: &Vector3<f64>) -> Vector3<f64> {
        let ([l10, l20, l21], per_d) = (self.l, self.per_d);
        let f1 = r.y - l10 * r.x;
        let f2 = r.z - l20 * r.x - l21 * f1;
        let z2 = f2 * per_d.z;
        let z1 = f1 * per_d.y - l21 * z2;
        Vector3::new(r.x * per_d.x - l10 * z1 - l20 * z2, z1, z2)
    }

    /// S^T W^-1 S = (L^-1 S)^T D^-1 (L^-1 S).
    #[inline]
    pub fn sandwiched(&self, s: &Matrix3<f64>) -> Matrix3<f64> {
        let ([l10, l20, l21], per_d) = (self.l, self.per_d);
        let row = |i: usize| Vector3::new(s[(i, 0)], s[(i, 1)], s[(i, 2)]);
        let f0 = row(0);
        let f1 = row(1) - l10 * f0;
        let f2 = row(2) - l20 * f0 - l21 * f1;
        let [d0, d1, d2] = [f0 * per_d.x, f1 * per_d.y, f2 * per_d.z];
        let element = |i: usize, j: usize| f0[i] * d0[j] + f1[i] * d1[j] + f2[i] * d2[j];
        Matrix3::from_fn(|i, j| element(i.min(j), i.max(j)))
    }
}

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
            self.clip(&self.wanted(theta, x, &zb))
        })
    }

    /// The estimates after a step from `theta` that leaves `zb` of the residual, before their bounds.
    #[inline]
    pub fn wanted(
        &self,
        theta: &Vector3<f64>,
        x: &Matrix3<f64>,
        zb: &Vector3<f64>,
    ) -> Vector3<f64> {
        theta + self.gain().component_mul(&x.tr_mul(zb))
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

    /// Phib and y: regressor of a tick, and the acceleration [rad/s^2] that known terms do not explain.
    pub fn sample(&self, last: &LastTick) -> (Matrix3<f64>, Vector3<f64>) {
        let (start, end, inertia) = (last.nu2_start, last.nu2_end, &self.inertia);
        let h = 0.5 * (last.h_start + last.h_end);
        // Phi is linear in rates and h: the mean of its two values is its value at the means.
        let phi = inertia.regressor(&(0.5 * (start + end)), last.om_m, &h);
        let f = 0.5 * (inertia.coupling(&start) + inertia.coupling(&end));
        let dnu2 = (end - start) / self.period_s;
        (phi, dnu2 - f - inertia.acceleration(&last.tau_m))
    }

    /// The estimates within their bounds.
    pub fn clip(&self, theta: &Vector3<f64>) -> Vector3<f64> {
        theta.sup(&self.lo).inf(&self.hi)
    }
}

#[derive(Clone, Debug)]
pub struct Evidence {
    adaptation: Adaptation,
    samples: Samples,
    newest: Regression,
    /// Tick whose state ended the newest whole tick.
    ended_at: Option<u64>,
}

impl Evidence {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        Self {
            adaptation: Adaptation::new(rig, gains),
            samples: Samples::new(rig),
            newest: Regression::default(),
            ended_at: None,
        }
    }

    /// Takes the measurement of `tick`. Call it once for each, with rising ticks; ticks may be left out.
    pub fn take(&mut self, tick: u64, measured: &Measured) {
        if let Some(last) = self.samples.take(tick, measured) {
            self.newest = self
                .adaptation
                .regression(&self.newest.x, &self.newest.y, &last);
            self.ended_at = Some(tick);
        }
    }

    /// Lists what the next tick needs; the weight follows from the measurement.
    pub fn state(&mut self, fields: &mut Fields) {
        let Regression { x, y, .. } = &mut self.newest;
        fields.all([x, y, &mut self.ended_at]);
        self.samples.state(fields);
    }

    /// X and Y as they stand at `tick`, where its state ended a whole tick.
    pub fn at(&self, tick: u64) -> Option<&Regression> {
        (self.ended_at == Some(tick)).then_some(&self.newest)
    }

    pub const fn samples(&self) -> &Samples {
        &self.samples
    }

    /// As [`Samples::h`].
    pub fn h(&mut self, tick: u64) -> Vector3<f64> {
        self.samples.h(tick)
    }
}

#[cfg(test)]
mod tests {
    use proptest::array::uniform9;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_divides_by_w(x in uniform9(-50.0..50.0), r in prop::array::uniform3(-10.0..10.0)) {
            let (x, r) = (Matrix3::from_column_slice(&x), Vector3::from(r));
            let g = Vector3::new(1e-9, 3e-6, 5e-4);
            let w = Matrix3::identity() + x * Matrix3::from_diagonal(&g) * x.transpose();
            let weight = Weight::new(&x, &g).unwrap();
            prop_assert!((w * weight.solve(&r) - r).amax() < 1e-12 * r.amax().max(1.0));
            let sandwiched = x.transpose() * w.try_inverse().unwrap() * x;
            prop_assert!((weight.sandwiched(&x) - sandwiched).amax() < 1e-10 * sandwiched.amax().max(1.0));
        }
    }

    #[test]
    fn there_is_none_of_what_is_no_number() {
        let x = Matrix3::new(1.0, 0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(Weight::new(&x, &Vector3::repeat(1.0)), None);
    }
}
