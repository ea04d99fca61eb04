//! The paper's inner loop: from attitude setpoint and rates to a torque, with adaptation.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri),
//! (17)-(22), sampled. The file of each law lists its differences from the paper. This file owns the order within a
//! tick. Rotor limits belong to the mixer, stale inputs to the rig ([`control_api::guard`]).
//!
//! Without a measurement the loop learns nothing, and the attitude loop's filter runs on.

use control_api::description::{Description, Refused, Setting, Settings, Signal, signal};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::content::Measured;
use messages::role::Role;
use messages::telemetry::{self, Telemetry};
use nalgebra::Vector3;

use crate::adaptation::{Adaptation, Evidence};
use crate::gains::{self, Gains};
use crate::laws::residual::Residual;
use crate::rate_loop;
use crate::torque_law::TorqueLaw;

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

/// The signals that come first in each law of this attitude and rate loop.
pub const RATE_ERROR: [Signal; 3] = [
    signal(telemetry::RATE_ERROR[0], "rad/s"),
    signal(telemetry::RATE_ERROR[1], "rad/s"),
    signal(telemetry::RATE_ERROR[2], "rad/s"),
];

pub const ESTIMATE: [Signal; 3] = [
    signal("rotor_inertia_kg_m2", "kg m^2"),
    signal("rotational_drag_nm_s", "N m s"),
    signal("disturbance_gain_rad_s2", "rad/s^2"),
];

const SOURCE: &str = "Imran and Montazeri, An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial \
                      Vehicle, (17)-(22), sampled; `ironbird docs paper` lists the differences";

const SETTINGS: [Setting; 10] = [
    gains::ATTITUDE,
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

const SIGNALS: [[Signal; 3]; 2] = [RATE_ERROR, ESTIMATE];

/// The paper's inner loop: filter, estimates, and the last sample.
#[derive(Clone, Debug)]
pub struct Adaptive {
    adapts: bool,
    adaptation: Adaptation,

    law: TorqueLaw,
    evidence: Evidence,
    /// Estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    theta: Vector3<f64>,
    /// What the estimates leave unexplained; none where that is not followed.
    residual: Option<Residual>,
}

/// The same loop without adaptation: what the adaptation is compared with.
#[derive(Clone, Debug)]
pub struct Fixed(Adaptive);

impl Adaptive {
    /// The loop of gains, with its priors. Only gains that pass [`rate_loop::check`] fly.
    pub fn with(rig: &Rig, gains: &Gains) -> Self {
        let adaptation = Adaptation::new(rig, gains);
        Self {
            adapts: gains.adapts,
            adaptation,
            law: TorqueLaw::new(rig, gains),
            evidence: Evidence::new(rig, gains),
            theta: adaptation.prior().theta,
            residual: None,
        }
    }

    /// The same loop with a torque against what the estimates leave unexplained.
    pub(super) fn with_residual(rig: &Rig, gains: &Gains, residual: Residual) -> Self {
        Self {
            residual: Some(residual),
            ..Self::with(rig, gains)
        }
    }

    /// With a measurement of this tick: learns from the last tick, then asks for a torque; tells the rate error too.
    fn control(&mut self, tick: u64, measured: &Measured) -> (Vector3<f64>, Vector3<f64>) {
        let newest = self.evidence.samples().newest_tick();
        self.evidence.take(tick, measured);
        let regression = self.evidence.at(tick);
        if self.adapts
            && let Some(regression) = regression
        {
            self.theta = self.adaptation.learn(&self.theta, regression);
        }
        if let Some(residual) = &mut self.residual {
            match regression {
                Some(regression) => residual.take(&self.adaptation, &self.theta, &regression.last),
                None if self.law.attitude.is_lost(newest, tick) => residual.forget(),
                None => {}
            }
        }
        let residual = self.residual.as_ref();
        let residual = residual.map_or(Vector3::zeros(), |it| *it.left());
        let evidence = &mut self.evidence;
        self.law
            .torque(tick, measured, &self.theta, &residual, evidence)
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
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let gains = Gains::of(settings);
        rate_loop::check(rig, &gains)?;
        Ok(Self::with(rig, &gains))
    }

    fn state(&mut self, fields: &mut Fields) {
        self.law.attitude.state(fields);
        fields.all([&mut self.theta]);
        self.evidence.state(fields);
        if let Some(residual) = &mut self.residual {
            residual.state(fields);
        }
    }
}

impl InnerLaw for Adaptive {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let newest = self.evidence.samples().newest_tick();
        let (tick, wanted) = (input.tick, &input.wanted);
        let measured = (input.measured_age == 0).then_some(&input.measured);
        self.law.attitude.begin(tick, wanted, newest, measured);
        let (tau, e) = match measured {
            Some(measured) => self.control(tick, measured),
            // The rate error is unknown.
            None => (Vector3::zeros(), Vector3::repeat(f64::NAN)),
        };
        self.law.attitude.end(tick);
        telemetry.value[..3].copy_from_slice(e.as_slice());
        telemetry.value[3..6].copy_from_slice(self.theta.as_slice());
        if let Some(residual) = &self.residual {
            telemetry.value[6..9].copy_from_slice(residual.left().as_slice());
        }
        WrenchSetpoint {
            thrust_n: wanted.thrust_n,
            torque_b_nm: tau.into(),
        }
    }
}

impl Law for Fixed {
    const DESCRIPTION: Description = Description {
        name: "fixed",
        role: Role::Inner,
        version: "1",
        summary: "`adaptive` with adaptation switched off (baseline for comparison)",
        source: SOURCE,
        settings: &[
            gains::ATTITUDE,
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
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        // What it shows beyond the rate error, the guard leaves out.
        self.0.tick(input, telemetry)
    }
}
