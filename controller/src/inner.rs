//! The inner loop: from attitude set-point and rates to a torque, with adaptation.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (17)-(22), sampled. The file of each law lists its differences from the paper. This file owns the order within a
//! tick and the reaction to stale inputs. Rotor limits belong to the mixer. The loop never sees [`State::truth`]; the
//! monitor of its messages does ([`crate::monitor`]).
//!
//! | input | missing for up to 100 ms: `Held` | longer, or never there: `Fallback` |
//! |---|---|---|
//! | set-point | the last one, rates included | level at the last yaw set-point, hover thrust |
//! | state | zero torque, last thrust | zero torque, hover thrust |
//!
//! Without a state the loop learns nothing. The command filter is a clock, not a measurement: it runs through every
//! tick of the grid, even when the loop had no state or was not called at all, so the wanted attitude is never late.
//! After more than 100 ms without a state the filter restarts at rest from the measured attitude, as it does at the
//! first tick: its old output says nothing about where the airframe is now.

use law::InnerLaw;
use model::allocation::net_speed;
use model::messages::{Dated, Mode, NO_TICK, Setpoint, State, Wrench};
use model::rate_dynamics::{Inertia, disturbance};
use nalgebra::Vector3;

use crate::adaptation::Adaptation;
use crate::command_filter::{CommandFilter, Passage};
use crate::evidence::Evidence;
use crate::predictor::predict;
use crate::rate_law::{RatePoint, sampled_gain, torque};
use crate::rate_reference::rate_reference;
use crate::settings::LoopSettings;

/// How long an input may be missing before the loop falls back [s].
const HOLD_S: f64 = 0.1;

/// The inner loop: filter, estimates, and the last sample.
#[derive(Clone, Debug)]
pub struct InnerLoop {
    settings: LoopSettings,
    adaptation: Adaptation,
    inertia: Inertia,
    k_eta: Vector3<f64>,
    gain: f64,
    hold_ticks: u64,

    filter: CommandFilter,
    /// What the filter goes through from one tick to the next.
    tick_passes: Passage,
    /// Input of the filter in the last tick, and the tick that `filter` is valid for.
    win: Vector3<f64>,
    filter_tick: u64,
    evidence: Evidence,
    /// Estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    theta: Vector3<f64>,
    thrust_n: f64,
}

impl InnerLoop {
    /// A loop for settings that passed [`Settings::check`]; its estimates are the priors.
    #[must_use]
    pub fn new(settings: &LoopSettings) -> Self {
        let gains = &settings.gains;
        let adaptation = Adaptation::new(settings);
        let w_f = Vector3::from(gains.command_filter_rad_s);
        Self {
            settings: *settings,
            adaptation,
            inertia: adaptation.inertia,
            k_eta: gains.attitude_1_s.into(),
            gain: sampled_gain(gains.alpha_1_s, settings.period_s),
            hold_ticks: (HOLD_S / settings.period_s).round() as u64,
            filter: CommandFilter::at_rest(w_f, Vector3::zeros()),
            tick_passes: Passage::new(&w_f, settings.period_s),
            win: Vector3::zeros(),
            filter_tick: 0,
            evidence: Evidence::new(settings),
            theta: adaptation.prior().theta,
            thrust_n: 0.0,
        }
    }

    /// Runs the filter through the ticks since the last call, on the input that it had.
    fn catch_up(&mut self, tick: u64) {
        let skipped = tick.saturating_sub(self.filter_tick);
        if skipped > 0 {
            let passed = Passage::new(&self.filter.w_f, skipped as f64 * self.settings.period_s);
            self.filter = self.filter.advance(&self.win, &passed);
        }
    }

    /// The set-point to follow in this tick, and how it was come by.
    fn order(&self, tick: u64, setpoint: &Dated<Setpoint>) -> (Setpoint, Mode) {
        if setpoint.tick == tick {
            return (setpoint.content, Mode::Fresh);
        }
        if setpoint.age(tick) <= self.hold_ticks {
            return (setpoint.content, Mode::Held);
        }
        let yaw = if setpoint.tick == NO_TICK { self.filter.ec.z } else { setpoint.content.attitude_rad[2] };
        let level = Setpoint { thrust_n: self.hover_thrust_n(), attitude_rad: [0.0, 0.0, yaw], ..Setpoint::default() };
        (level, Mode::Fallback)
    }

    /// The law, with a state of this tick: learn from the last tick, then ask for a torque.
    fn control(
        &mut self,
        tick: u64,
        state: &State,
        order: &Setpoint,
        mode: Mode,
        win: &Vector3<f64>,
        next: &CommandFilter,
    ) -> Wrench {
        let period_s = self.settings.period_s;
        let eta2 = Vector3::from(state.attitude_rad);
        let om_m = net_speed(&state.rotor_speed_mean_rad_s.into());
        self.evidence.take(tick, state);
        if let Some(regression) = self.evidence.at(tick) {
            self.theta = self.adaptation.learn(&self.theta, regression);
        }
        let samples = self.evidence.samples();
        let now = RatePoint { nu2: state.rate_b_rad_s.into(), om: om_m, h: samples.newest_h() };
        let theta = &self.theta;

        let (eta2, at, filter) = if self.settings.gains.predictor_ticks == 0 {
            (eta2, now, &self.filter)
        } else {
            let command = state.rotor_speed_command_rad_s;
            let om_s = net_speed(&command.into());
            let tau_s = samples.rotor_torque(&command.map(|w| w * w));
            let now = RatePoint { om: om_s, ..now };
            let (eta2, nu2) = predict(&eta2, &now, theta, &tau_s, period_s, &self.inertia);
            let h = disturbance((tick + 1) as f64 * period_s);
            (eta2, RatePoint { nu2, h, ..now }, next)
        };
        let e2 = filter.acceleration(win);
        let reference = rate_reference(&eta2, &at.nu2, filter, &e2, &self.k_eta);
        let tau = torque(&at, &reference, theta, self.gain, &self.inertia);
        Wrench {
            thrust_n: order.thrust_n,
            torque_b_nm: tau.into(),
            estimate: self.theta.into(),
            rate_error_b_rad_s: (at.nu2 - reference.nu2_d).into(),
            mode: mode as u64,
        }
    }

    /// Without a state of this tick: no torque. The rate error is unknown, and given as 0.
    fn coast(&self, lost: bool) -> Wrench {
        let (thrust_n, mode) = if lost { (self.hover_thrust_n(), Mode::Fallback) } else { (self.thrust_n, Mode::Held) };
        Wrench { thrust_n, estimate: self.theta.into(), mode: mode as u64, ..Wrench::default() }
    }

    /// m g [N].
    fn hover_thrust_n(&self) -> f64 {
        self.settings.model.m() * self.settings.model.g()
    }
}

impl InnerLaw for InnerLoop {
    /// Thrust and torque of a tick, from the newest state and set-point, whatever tick they are of.
    fn tick(&mut self, tick: u64, state: &Dated<State>, setpoint: &Dated<Setpoint>) -> Wrench {
        let lost =
            self.evidence.samples().newest_tick().is_none_or(|sampled| tick.saturating_sub(sampled) > self.hold_ticks);
        let measured = (state.tick == tick).then_some(&state.content);
        match measured {
            Some(state) if lost => {
                let eta2 = Vector3::from(state.attitude_rad);
                self.filter = CommandFilter::at_rest(self.filter.w_f, eta2);
            }
            _ => self.catch_up(tick),
        }
        let (order, mode) = self.order(tick, setpoint);
        let win = self.filter.input(&order);
        let next = self.filter.advance(&win, &self.tick_passes);
        let wrench = match measured {
            Some(state) => self.control(tick, state, &order, mode, &win, &next),
            None => self.coast(lost),
        };
        self.win = win;
        self.filter = next;
        self.filter_tick = tick + 1;
        self.thrust_n = wrench.thrust_n;
        wrench
    }
}
