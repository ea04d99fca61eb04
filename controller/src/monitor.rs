//! The theorem's monitor: checks a law's published estimates against the proof.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri), (18)
//! and (20)-(22), in the discrete form of docs/paper.md. The monitor knows the settings, and sees states, with their
//! truth, setpoints and wrenches. X and Y follow from the states alone ([`crate::adaptation`]). It stands beside a flight and not
//! in its loop: nothing of what it says goes back. It looks at no estimate but the published ones, and checks five
//! things, numbered as in docs/theorem.md:
//!
//! 1. V_th does not rise. If it does, a broken assumption must explain the rise ([`crate::assumptions`]).
//! 2. V_th changes by what the step owes, allowing for the model's mismatch ([`crate::lyapunov`]): this is an identity of
//!    the update. Where a bound holds the step back, V_th changes by no more, if the bounds contain the truth.
//! 3. V_th falls over the flight as predicted.
//! 4. The wrench is (19) of its own inputs and of the estimates, and e is what it says ([`crate::torque_check`]).
//! 5. The rotors give the torque of the wrench whose command is in force. If not, a broken assumption must explain it.
//!
//! V, which contains the rate error, is reported and never judged: its inequality is proven only without delay.

use std::f64::consts::SQRT_2;

use control_api::law::Rig;
use messages::content::{RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::math::exp;
use messages::monitor::{Cause, Monitor};
use messages::topic::Topic as _;
use nalgebra::Vector3;

use crate::adaptation::{Adaptation, Evidence, LastTick, Regression};
use crate::assumptions::{Assumptions, Moved};
use crate::excitation::Excitation;
use crate::gains::Gains;
use crate::innovation::Innovation;
use crate::laws::adaptive;
use crate::lyapunov::{EstimateStep, RateWeight, v_th, v_th_change};
use crate::torque_check::{KEPT, RotorTorque, TorqueCheck, TorqueSeen};

/// Rise of V_th in a step that counts as rounding, as a share of V_th at the start.
pub const ROUNDING: f64 = 1e-12;
/// The same as a mismatch [rad/s^2], for a V_th that starts at 0.
pub const ROUNDING_RAD_S2: f64 = 1e-7;
/// How often the error of the trapezoidal rule, as it is estimated, is allowed.
pub const TRAPEZOID: f64 = 2.0;
/// Share of a step's own terms that rounding may take: the weight W of the paper's gains is conditioned like 1e6.
const STEP_ROUNDING: f64 = 1e-6;
/// Shares of the descent predicted for the flight that count as life, and share of V_th at the start from which on
/// it is asked for.
const LIVE: std::ops::RangeInclusive<f64> = 0.5..=2.0;
const LIVE_FROM: f64 = 1e-6;
/// Time over which the rate error is averaged [s].
const RATE_MEMORY_S: f64 = 1.0;
/// Time between two looks at what changes slowly and takes long to compute [s].
const LOOK_S: f64 = 0.1;

#[derive(Clone, Debug)]
pub struct TheoremMonitor {
    adaptation: Adaptation,
    /// That of the law, from the same states.
    evidence: Evidence,
    assumptions: Assumptions,
    torque: TorqueCheck,
    excitation: Excitation,
    innovation: Innovation,
    rate_weight: RateWeight,
    /// Error of the trapezoidal rule in Y, as it is estimated [rad/s^2].
    trapezoid_rad_s2: f64,
    /// What that may have added to V_th since the start [rad^2/s^2].
    trapezoid_sum: f64,
    /// Sum of all that V_th was allowed to rise in the steps since the start, by rounding and by the trapezoidal rule [rad^2/s^2].
    allowed_sum: f64,
    /// Sum of the descents of V_th by bounds since the start [rad^2/s^2]. A bound brings an estimate closer to the truth.
    bounds_sum: f64,
    rate_kept: f64,
    has_begun: bool,
    before: Before,
    /// V_th when the error began that the excitation works on [rad^2/s^2].
    v_th_begun: f64,
    rate_error_squared: f64,
    /// Share of that mean that samples have; the rest is the zero that it began with.
    rate_error_share: f64,
    /// Ticks between two looks at what changes slowly.
    look_ticks: u64,
    shown: Monitor,
}

/// What was seen with the last state.
#[derive(Clone, Copy, Debug, Default)]
struct Before {
    estimate: Vector3<f64>,
    v_th: f64,
    e: Vector3<f64>,
}

impl TheoremMonitor {
    /// A monitor for a law with these gains.
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let adaptation = Adaptation::new(rig, gains);
        let period_s = rig.period_s;
        Self {
            adaptation,
            evidence: Evidence::new(rig, gains),
            assumptions: Assumptions::new(&adaptation, &rig.airframe),
            torque: TorqueCheck::new(rig, gains),
            excitation: Excitation::new(period_s),
            innovation: Innovation::default(),
            rate_weight: RateWeight::new(&adaptation),
            trapezoid_rad_s2: 0.0,
            trapezoid_sum: 0.0,
            allowed_sum: 0.0,
            bounds_sum: 0.0,
            rate_kept: exp(-period_s / RATE_MEMORY_S),
            has_begun: false,
            before: Before::default(),
            v_th_begun: 0.0,
            rate_error_squared: 0.0,
            rate_error_share: 0.0,
            look_ticks: (LOOK_S / period_s).round().max(1.0) as u64,
            shown: Monitor {
                is_live: 1,
                ..Monitor::default()
            },
        }
    }

    /// Joins a law in flight, of which a wrench of `tick` is the first that is watched.
    pub fn join(&mut self, tick: u64) {
        self.torque.lose(tick);
    }

    /// Whether a law that was joined has forgotten, at the end of the next tick, what was not watched.
    pub fn has_caught_up(&self) -> bool {
        // Of the samples before, the steps are compared more closely than causes are.
        let faded_samples = self.assumptions.faded_samples().saturating_mul(2);
        self.assumptions.samples() + 1 >= faded_samples.max(KEPT as u64)
    }

    /// Counts from now on; `v_th_start` is V_th at the start of the law, or after a parameter change [rad^2/s^2].
    pub fn resume(&mut self, v_th_start: f64) {
        self.shown = Monitor {
            v_th_start,
            is_live: 1,
            ..Monitor::default()
        };
        self.excitation = Excitation::new(self.adaptation.period_s);
        self.innovation = Innovation::default();
        (self.trapezoid_sum, self.allowed_sum) = (0.0, 0.0);
        (self.bounds_sum, self.has_begun) = (0.0, false);
    }

    /// Takes the rotor command of a tick, before the wrench of the next tick.
    pub fn command(&mut self, tick: u64, command: &RotorSpeeds) {
        self.torque.command(tick, command);
    }

    /// Takes over from the monitor before what outlives the law.
    pub fn take_over(&mut self, before: &Self) {
        self.torque.take_over(&before.torque);
    }

    /// Looks at the wrench of a tick, and at the state and setpoint that the law made it from, whatever tick they are of.
    ///
    /// Call it for every wrench of a law from its first one on, with rising ticks; ticks without a wrench are left out.
    pub fn watch(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &Wrench,
    ) -> &Monitor {
        let moved = self.assumptions.look(tick, state, wrench);
        let mut now = self.shown;
        (now.causes, now.is_violation) = (self.assumptions.bits(tick), 0);
        let newest = self.evidence.samples().newest_tick();
        if state.tick == tick {
            self.evidence.take(tick, &state.content.measured);
            self.compare(tick, &state.content, wrench, moved, &mut now);
            if self.evidence.at(tick).is_some() {
                self.assumptions.count_sample();
            }
        }
        let (inputs, evidence) = ((state, setpoint), &mut self.evidence);
        let seen = self.torque.take(tick, inputs, wrench, newest, evidence);
        count(&seen, &mut now);
        let gave_stale = seen.rotors == Some(RotorTorque::Other(Cause::StaleInput));
        let is_stale = gave_stale || self.assumptions.seen_at(Cause::StaleInput, tick);
        now.ticks_stale += u64::from(is_stale);
        // Beyond any flight: what cannot be computed cannot be proven, and must not ground the loop.
        if now.finite() {
            self.shown = now;
        } else {
            (self.shown.causes, self.shown.is_violation) = (now.causes, 1);
            self.shown.violations[Cause::Unexplained as usize] += 1;
        }
        &self.shown
    }

    /// The result for the last wrench.
    pub const fn shown(&self) -> &Monitor {
        &self.shown
    }

    /// What the steps so far show without ground truth.
    pub const fn innovation(&self) -> &Innovation {
        &self.innovation
    }

    /// How far rounding and the trapezoidal rule may have led each estimate away from its error on the exact model.
    pub fn error_allowed(&self) -> [f64; 3] {
        let allowed = |gamma: f64| (2.0 * self.allowed_sum * gamma).sqrt();
        self.adaptation.gamma.map(allowed).into()
    }

    /// Rate error of the newest wrench whose state was of its tick [rad/s].
    pub fn rate_error_rad_s(&self) -> f64 {
        self.before.e.norm()
    }

    /// Root mean square of the rate error over the last second or so [rad/s]; 0 before there is one.
    pub fn rate_error_rms_rad_s(&self) -> f64 {
        let share = self.rate_error_share.max(f64::MIN_POSITIVE);
        (self.rate_error_squared / share).sqrt()
    }

    fn compare(
        &mut self,
        tick: u64,
        state: &State,
        wrench: &Wrench,
        moved: Moved,
        now: &mut Monitor,
    ) {
        let theta = Vector3::from(state.truth.theta());
        let estimate = Vector3::from(adaptive::estimate(&wrench.telemetry));
        let error = estimate - theta;
        let e = Vector3::from(adaptive::rate_error(&wrench.telemetry));
        let was = self.before;
        self.before = Before {
            estimate,
            v_th: v_th(&error, &self.adaptation.gamma),
            e,
        };
        now.v_th = self.before.v_th;
        now.estimate_error = error.into();
        now.ticks_saturated += state.command_saturated;
        self.rate_error(&e, now);
        let begins = !std::mem::replace(&mut self.has_begun, true);
        let swapped = moved != Moved::Not;
        if begins || swapped {
            // A ramp is one swap, however many steps it takes.
            now.live_swaps += u64::from(moved == Moved::Swapped);
            now.v_th_start = now.v_th_start.max(now.v_th);
            now.estimate_error_start = error.abs().into();
        }
        if let Some(regression) = self.evidence.at(tick).copied() {
            self.step(tick, &regression, &theta, &was, swapped, now);
        }
        let is_new = begins || self.assumptions.holds(Cause::LiveSwap, tick);
        if is_new {
            // Until the samples from before have faded, the new error does not shrink as on the exact model.
            self.v_th_begun = now.v_th;
            self.excitation.restart();
        }
        if is_new || tick.is_multiple_of(self.look_ticks) {
            self.look(now);
        }
        now.sigma = self.rate_weight.sigma();
        now.v = now.sigma / 2.0 * e.norm_squared() + now.v_th;
    }

    fn look(&self, now: &mut Monitor) {
        let left = self.excitation.left();
        now.estimate_error_bound = Vector3::from_fn(|i, _| {
            (2.0 * self.v_th_begun * self.adaptation.gamma[i]).sqrt() * left[i]
        })
        .into();
        let shown = self.excitation.shown();
        (now.excitation, now.excitation_least) = (shown.smallest, shown.least);
        now.identifiability = shown.identifiability.into();
        now.rate_error_rms_rad_s = self.rate_error_squared.sqrt();
    }

    fn rate_error(&mut self, e: &Vector3<f64>, now: &mut Monitor) {
        let squared = e.norm_squared();
        self.rate_error_squared = squared + self.rate_kept * (self.rate_error_squared - squared);
        self.rate_error_share = 1.0 + self.rate_kept * (self.rate_error_share - 1.0);
        now.rate_error_max_rad_s = now.rate_error_max_rad_s.max(squared.sqrt());
    }

    /// (T/alpha) eps^2/4 [rad^2/s^2]: what a mismatch [rad/s^2] may add to V_th in a step.
    fn rise_of(&self, mismatch_rad_s2: f64) -> f64 {
        self.adaptation.step_s2 * mismatch_rad_s2 * mismatch_rad_s2 / 4.0
    }

    /// Error of the trapezoidal rule over a tick [rad/s^2]: T^2/12 of the third derivative of the rates. Under a held
    /// torque that is, by (8), the slope squared times their acceleration, the curvature of f, and that of h(t).
    fn trapezoid(&self, last: &LastTick, theta: &Vector3<f64>) -> f64 {
        let (i_m, period_s) = (self.adaptation.inertia.i_m(), self.adaptation.period_s);
        let curvature = 2.0 * (i_m.max() - i_m.min()) / i_m.min();
        let slope = (theta.y.abs() + (theta.x * last.om_m).abs()) / i_m.min()
            + curvature * last.nu2_end.norm();
        let acceleration = (last.nu2_end - last.nu2_start).norm() / period_s;
        let third =
            (slope * slope + curvature * acceleration) * acceleration + SQRT_2 * theta.z.abs();
        period_s * period_s / 12.0 * third
    }

    fn step(
        &mut self,
        tick: u64,
        regression: &Regression,
        theta: &Vector3<f64>,
        was: &Before,
        swapped: bool,
        now: &mut Monitor,
    ) {
        let (gamma, cause) = (self.adaptation.gamma, self.assumptions.cause_of_rise(tick));
        let Regression { x, y, weight, last } = regression;
        let Some(weight) = weight else {
            now.v_th = f64::NAN;
            return;
        };
        let step = EstimateStep::new(&self.adaptation, x, *weight);
        let (before, after) = (was.estimate - theta, Vector3::from(now.estimate_error));
        // Of this step alone: both sides with the parameters that hold now.
        let change = v_th_change(&before, &after, &gamma);
        let mismatch = y - x * theta;
        let zb = step.left_of(&(y - x * was.estimate));
        let zb_exact = step.left_of(&(-x * before));
        self.innovation.take(
            &self.adaptation,
            regression,
            &was.estimate,
            &zb,
            self.rate_kept,
        );
        let rounding = ROUNDING * now.v_th_start + self.rise_of(ROUNDING_RAD_S2);
        let floor = rounding + self.rise_of_trapezoid(last, theta);
        self.allowed_sum += floor;

        now.ticks_checked += 1;
        now.steps_adapted += u64::from(before != after);
        now.mismatch_rad_s2 = mismatch.norm();
        now.v_th_change = if swapped { now.v_th - was.v_th } else { change };
        now.v_th_change_predicted = -step.descent(&zb_exact);

        // The jump of a parameter change is no step; what it leaves in the low-pass is.
        let rise = &mut now.rise_max[cause as usize];
        *rise = rise.max(change);
        let mut excess = change - (step.disturbance(&mismatch, &zb) - step.descent(&zb));
        let rounding = rounding
            + STEP_ROUNDING
                * (step.descent(&zb) + self.adaptation.step_s2 * mismatch.norm() * zb.norm());
        let wanted = self.adaptation.wanted(&was.estimate, x, &zb);
        let is_free = self.adaptation.clip(&wanted) == wanted;
        if is_free {
            excess = excess.abs();
        }
        let owes = is_free || !self.assumptions.holds(Cause::OutOfBounds, tick);
        let violation = if owes && excess > rounding {
            Some(Cause::Unexplained)
        } else {
            (change > floor).then_some(cause)
        };
        if let Some(cause) = violation {
            now.is_violation = 1;
            now.violations[cause as usize] += 1;
        }
        if owes {
            now.step_excess_max = now.step_excess_max.max(excess / rounding);
        }
        if cause == Cause::Unexplained {
            if !is_free {
                self.bounds_sum += (now.v_th_change_predicted - change).max(0.0);
            }
            self.descend(change, now);
        }
        self.excitation.take(&step.contraction());

        self.rate_weight.take(&step);
        let half_sigma = self.rate_weight.sigma() / 2.0;
        let e = self.before.e;
        now.v_change = half_sigma * (e.norm_squared() - was.e.norm_squared()) + change;
        now.v_change_bound = self.rate_weight.v_change_bound(&was.e, &zb_exact);
        if now.v_change > now.v_change_bound * (1.0 - STEP_ROUNDING) + floor {
            now.v_above_bound[self.assumptions.cause_of_v(tick) as usize] += 1;
        }
    }

    /// Largest rise of V_th by the trapezoidal rule in this step [rad^2/s^2]. Its error passes through the low-pass first.
    fn rise_of_trapezoid(&mut self, last: &LastTick, theta: &Vector3<f64>) -> f64 {
        let error = self.trapezoid(last, theta);
        self.trapezoid_rad_s2 += (1.0 - self.adaptation.p) * (error - self.trapezoid_rad_s2);
        let rise = self.rise_of(TRAPEZOID * self.trapezoid_rad_s2);
        self.trapezoid_sum += rise;
        rise
    }

    /// Compares the descent of V_th so far with the predicted one.
    fn descend(&self, change: f64, now: &mut Monitor) {
        now.descent -= change;
        now.descent_predicted -= now.v_th_change_predicted;
        let owed = now.descent_predicted > LIVE_FROM * now.v_th_start + self.trapezoid_sum;
        let alone = now.descent - self.bounds_sum;
        now.is_live = u64::from(!owed || LIVE.contains(&(alone / now.descent_predicted)));
    }
}

fn count(seen: &TorqueSeen, now: &mut Monitor) {
    let torque = &mut now.torque;
    torque.wrenches += u64::from(seen.law.is_some());
    torque.rotors += u64::from(seen.rotors.is_some());
    torque.wrenches_wrong += u64::from(seen.law == Some(false));
    if let Some(RotorTorque::Other(cause)) = seen.rotors {
        torque.rotors_wrong[cause as usize] += 1;
    }
}
