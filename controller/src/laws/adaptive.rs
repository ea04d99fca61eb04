//! The paper's inner loop: from attitude set-point and rates to a torque, with adaptation.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (17)-(22), sampled. The file of each law lists its differences from the paper. This file owns the order within a
//! tick. Rotor limits belong to the mixer, stale inputs to the rig ([`control_api::guard`]).
//!
//! Without a measurement the loop learns nothing. The command filter is a clock, not a measurement: it runs through
//! every tick of the grid, even when there was no measurement or the loop was not called at all, so the wanted attitude
//! is never late. After more than 100 ms without a measurement the filter restarts at rest from the measured attitude,
//! as it does at the first tick: its old output says nothing about where the airframe is now.

use control_api::description::{Description, Refused, Setting, Settings, Signal, signal};
use control_api::guard::HOLD_S;
use control_api::law::{Desired, Fields, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::allocation::net_speed;
use messages::content::{Measured, Reference, Stamped};
use messages::rate_dynamics::Inertia;
use messages::role::Role;
use messages::telemetry::{self, Telemetry};
use nalgebra::Vector3;

use crate::adaptation::{Adaptation, Evidence};
use crate::command_filter::{CommandFilter, Passage};
use crate::gains::{self, Gains};
use crate::rate_law::{RatePoint, predict, rate_reference, sampled_gain, torque};
use crate::rate_loop;

/// Rate error e used in the law [rad/s], of the telemetry of [`Adaptive`] and [`Fixed`].
pub fn rate_error(telemetry: &Telemetry) -> [f64; 3] {
    let [x, y, z, ..] = telemetry.value;
    [x, y, z]
}

/// Estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2], of the telemetry of [`Adaptive`].
pub fn estimate(telemetry: &Telemetry) -> [f64; 3] {
    let [_, _, _, i_r, k_r, delta, ..] = telemetry.value;
    [i_r, k_r, delta]
}

const RATE_ERROR: [Signal; 3] = [
    signal(telemetry::RATE_ERROR[0], "rad/s"),
    signal(telemetry::RATE_ERROR[1], "rad/s"),
    signal(telemetry::RATE_ERROR[2], "rad/s"),
];

const SOURCE: &str = "Imran and Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial \
                      Vehicle, (17)-(22), sampled; docs/paper.md lists the differences";

const SETTINGS: [Setting; 9] = [
    gains::ATTITUDE_1_S,
    gains::COMMAND_FILTER_RAD_S,
    gains::ALPHA_1_S,
    gains::PREDICTOR_TICKS,
    gains::ADAPTATION,
    gains::ADAPTATION_GAIN,
    gains::REGRESSOR_FILTER_RAD_S,
    gains::ESTIMATE_MIN,
    gains::ESTIMATE_MAX,
];

/// The paper's inner loop: filter, estimates, and the last sample.
#[derive(Clone, Debug)]
pub struct Adaptive {
    rig: Rig,
    gains: Gains,
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
}

/// The same loop without adaptation: what the adaptation is compared with.
#[derive(Clone, Debug)]
pub struct Fixed(Adaptive);

impl Adaptive {
    /// The loop of gains, with its priors. Only gains that pass [`rate_loop::check`] fly.
    pub fn with(rig: &Rig, gains: &Gains) -> Self {
        let adaptation = Adaptation::new(rig, gains);
        let w_f = Vector3::from(gains.command_filter_rad_s);
        Self {
            rig: *rig,
            gains: *gains,
            adaptation,
            inertia: adaptation.inertia,
            k_eta: gains.attitude_1_s.into(),
            gain: sampled_gain(gains.alpha_1_s, rig.period_s),
            hold_ticks: (HOLD_S / rig.period_s).round() as u64,
            filter: CommandFilter::at_rest(w_f, Vector3::zeros()),
            tick_passes: Passage::new(&w_f, rig.period_s),
            win: Vector3::zeros(),
            filter_tick: 0,
            evidence: Evidence::new(rig, gains),
            theta: adaptation.prior().theta,
        }
    }

    /// Runs the filter through the ticks since the last call, on the input that it had.
    fn catch_up(&mut self, tick: u64) {
        let skipped = tick.saturating_sub(self.filter_tick);
        if skipped > 0 {
            let passed = Passage::new(&self.filter.w_f, skipped as f64 * self.rig.period_s);
            self.filter = self.filter.advance(&self.win, &passed);
        }
    }

    /// With a measurement of this tick: learns from the last tick, then asks for a torque; tells the rate error too.
    fn control(
        &mut self,
        tick: u64,
        measured: &Measured,
        win: &Vector3<f64>,
        next: &CommandFilter,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let period_s = self.rig.period_s;
        let eta2 = Vector3::from(measured.attitude_rad);
        let om_m = net_speed(&measured.rotor_speed_mean_rad_s.into());
        self.evidence.take(tick, measured);
        if self.gains.adapts
            && let Some(regression) = self.evidence.at(tick)
        {
            self.theta = self.adaptation.learn(&self.theta, regression);
        }
        let samples = self.evidence.samples();
        let now = RatePoint {
            nu2: measured.rate_b_rad_s.into(),
            om: om_m,
            h: samples.newest_h(),
        };
        let theta = &self.theta;

        let (eta2, at, filter) = if self.gains.predictor_ticks == 0.0 {
            (eta2, now, &self.filter)
        } else {
            let command = measured.rotor_speed_command_rad_s;
            let om_s = net_speed(&command.into());
            let tau_s = samples.rotor_torque(&command.map(|w| w * w));
            let now = RatePoint { om: om_s, ..now };
            let (eta2, nu2) = predict(&eta2, &now, theta, &tau_s, period_s, &self.inertia);
            let h = self.evidence.h(tick + 1);
            (eta2, RatePoint { nu2, h, ..now }, next)
        };
        let e2 = filter.acceleration(win);
        let reference = rate_reference(&eta2, &at.nu2, filter, &e2, &self.k_eta);
        (
            torque(&at, &reference, theta, self.gain, &self.inertia),
            at.nu2 - reference.nu2_d,
        )
    }
}

impl Law for Adaptive {
    const DESCRIPTION: Description = Description {
        name: "adaptive",
        role: Role::Inner,
        version: "1",
        summary: "attitude and rate loop that learns rotor inertia, rotational drag and a disturbance",
        source: SOURCE,
        settings: &SETTINGS,
        presets: gains::PRESETS,
        suited: Some(gains::suited),
        telemetry: &[
            RATE_ERROR[0],
            RATE_ERROR[1],
            RATE_ERROR[2],
            signal("rotor_inertia_kg_m2", "kg m^2"),
            signal("rotational_drag_nm_s", "N m s"),
            signal("disturbance_gain_rad_s2", "rad/s^2"),
        ],
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let gains = Gains::of(settings);
        rate_loop::check(rig, &gains)?;
        Ok(Self::with(rig, &gains))
    }

    fn state(&mut self, fields: &mut Fields) {
        let filter = &mut self.filter;
        fields.all([&mut filter.ec, &mut filter.e1]);
        fields.all([&mut self.win, &mut self.filter_tick, &mut self.theta]);
        self.evidence.state(fields);
    }
}

impl InnerLaw for Adaptive {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Stamped<Measured>,
        wanted: &Stamped<Desired>,
        _: &Reference,
        telemetry: &mut Telemetry,
    ) -> WrenchSetpoint {
        let newest = self.evidence.samples().newest_tick();
        let lost = newest.is_none_or(|sampled| tick.saturating_sub(sampled) > self.hold_ticks);
        let measured = (measured.tick == tick).then_some(&measured.content);
        match measured {
            Some(measured) if lost => {
                self.filter = CommandFilter::at_rest(self.filter.w_f, measured.attitude_rad.into());
            }
            _ => self.catch_up(tick),
        }
        let win = self.filter.input(&wanted.content);
        let next = self.filter.advance(&win, &self.tick_passes);
        let (tau, e) = match measured {
            Some(measured) => self.control(tick, measured, &win, &next),
            // The rate error is unknown.
            None => (Vector3::zeros(), Vector3::repeat(f64::NAN)),
        };
        self.win = win;
        self.filter = next;
        self.filter_tick = tick + 1;
        telemetry.value[..3].copy_from_slice(e.as_slice());
        telemetry.value[3..6].copy_from_slice(self.theta.as_slice());
        WrenchSetpoint {
            thrust_n: wanted.content.thrust_n,
            torque_b_nm: tau.into(),
        }
    }
}

impl Law for Fixed {
    const DESCRIPTION: Description = Description {
        name: "fixed",
        role: Role::Inner,
        version: "1",
        summary: "`adaptive` without its adaptation: the A of an A/B",
        source: SOURCE,
        settings: &[
            gains::ATTITUDE_1_S,
            gains::COMMAND_FILTER_RAD_S,
            gains::ALPHA_1_S,
            gains::PREDICTOR_TICKS,
        ],
        presets: gains::FIXED_PRESETS,
        suited: Some(gains::suited),
        telemetry: &RATE_ERROR,
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let gains = Gains {
            adapts: false,
            ..Gains::of(settings)
        };
        rate_loop::check(rig, &gains)?;
        Ok(Self(Adaptive::with(rig, &gains)))
    }

    fn state(&mut self, fields: &mut Fields) {
        self.0.state(fields);
    }
}

impl InnerLaw for Fixed {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Stamped<Measured>,
        wanted: &Stamped<Desired>,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> WrenchSetpoint {
        // What it shows beyond the rate error, the guard leaves out.
        InnerLaw::tick(&mut self.0, tick, measured, wanted, reference, telemetry)
    }
}
