//! The metrics of a flight, by its true states and not by what its sensors measure.

use analysis::flight_metrics::FlightMetrics;
use analysis::recovery::{Recoveries, RecoveryBounds};
use analysis::tracking::Tracking;
use messages::content::{RotorSpeeds, Setpoint, State};
use messages::parameters::Airframe;

use crate::gates::METRICS;

#[derive(Debug)]
pub struct Metrics {
    tracking: Tracking,
    flight: FlightMetrics,
    recoveries: Recoveries,
    bounds: RecoveryBounds,
}

impl Metrics {
    /// Of a flight along a reference, with faults at these ticks.
    pub fn new(
        tracking: Tracking,
        airframe: &Airframe,
        mut fault_ticks: Vec<u64>,
        last_tick: u64,
        bounds: RecoveryBounds,
    ) -> Self {
        fault_ticks.sort_unstable();
        fault_ticks.dedup();
        let period_s = tracking.period_s();
        Self {
            tracking,
            flight: FlightMetrics::new(period_s, airframe),
            recoveries: Recoveries::new(fault_ticks, last_tick, period_s),
            bounds,
        }
    }

    /// Adds the state of a tick, and the setpoint if there was one.
    pub fn state(&mut self, tick: u64, state: &State, setpoint: Option<&Setpoint>) {
        let errors = self.tracking.errors(tick, state, setpoint);
        self.flight.state(tick, state, &errors);
        let [position_m, yaw_rad, _] = errors;
        let is_below = self.bounds.hold(position_m, yaw_rad);
        self.recoveries.take(tick, is_below);
    }

    /// Adds a rotor command.
    pub fn command(&mut self, rotors: &RotorSpeeds) {
        self.flight.tracking.effort.take(rotors);
    }

    /// The values of [`METRICS`]; there is no recovery without a fault, or when the flight did not recover from one.
    pub fn values(&self) -> [Option<f64>; METRICS.len()] {
        let tracking = &self.flight.tracking;
        let [error, yaw, tilt] = &tracking.errors;
        let effort = self.flight.effort();
        let (recovery, period_s) = (self.recoveries.longest_ticks(), self.tracking.period_s());
        [
            Some(tracking.states as f64 * period_s),
            Some(error.max),
            Some(error.rms()),
            Some(error.recent_max()),
            recovery.map(|ticks| ticks as f64 * period_s),
            Some(self.flight.tilt_max_rad()),
            Some(effort.saturated_percent),
            Some(effort.power),
            Some(effort.agitation_rad_s),
            Some(yaw.max),
            Some(yaw.rms()),
            Some(yaw.recent_max()),
            Some(tilt.max),
            Some(tilt.rms()),
        ]
    }
}
