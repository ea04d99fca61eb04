//! The attitude loop of the paper's inner law and its relatives: from the attitude setpoint to the body rates wanted.
//!
//! The command filter ([`crate::command_filter`]) is a clock, not a measurement: it runs through every tick of the grid,
//! even when there was no measurement or the loop was not called at all, so the wanted attitude is never late. After more
//! than 100 ms without a measurement it restarts at rest from the measured attitude, its yaw on the turn of the setpoint, as it
//! does at the first tick: its old output says nothing about where the airframe is now.

use control_api::guard::HOLD_S;
use control_api::law::{Desired, Fields, Rig};
use messages::attitude::near;
use messages::content::Measured;
use nalgebra::Vector3;

use crate::command_filter::{CommandFilter, Passage};
use crate::gains::{AttitudeError, Gains};
use crate::rate_law::{RateReference, quaternion_reference, rate_reference};

#[derive(Clone, Debug)]
pub struct AttitudeLoop {
    period_s: f64,
    k_eta: Vector3<f64>,
    error: AttitudeError,
    hold_ticks: u64,

    filter: CommandFilter,
    /// What the filter goes through from one tick to the next.
    tick_passes: Passage,
    /// Input of the filter in the last tick, and the tick that `filter` is valid for.
    win: Vector3<f64>,
    filter_tick: u64,
}

impl AttitudeLoop {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let w_f = Vector3::from(gains.command_filter_rad_s);
        Self {
            period_s: rig.period_s,
            k_eta: gains.attitude_1_s.into(),
            error: gains.attitude_error,
            hold_ticks: (HOLD_S / rig.period_s).round() as u64,
            filter: CommandFilter::at_rest(w_f, Vector3::zeros()),
            tick_passes: Passage::new(&w_f, rig.period_s),
            win: Vector3::zeros(),
            filter_tick: 0,
        }
    }

    pub fn state(&mut self, fields: &mut Fields) {
        let filter = &mut self.filter;
        fields.all([&mut filter.ec, &mut filter.e1]);
        fields.all([&mut self.win, &mut self.filter_tick]);
    }

    /// Ticks for which the loop continues without a measurement or a setpoint.
    pub const fn hold_ticks(&self) -> u64 {
        self.hold_ticks
    }

    /// Whether the newest sample before `tick` is too old to continue from, or there was none.
    pub fn is_lost(&self, newest: Option<u64>, tick: u64) -> bool {
        newest.is_none_or(|sampled| tick.saturating_sub(sampled) > self.hold_ticks)
    }

    /// Moves the filter on to a tick, and takes the setpoint of it. `newest` is the tick of the newest measurement before,
    /// `measured` the measurement of the tick itself: the filter restarts there if the newest one is too old.
    pub fn begin(
        &mut self,
        tick: u64,
        wanted: &Desired,
        newest: Option<u64>,
        measured: Option<&Measured>,
    ) {
        let skipped = tick.saturating_sub(self.filter_tick);
        if let Some(measured) = measured.filter(|_| self.is_lost(newest, tick)) {
            let mut attitude = Vector3::from(measured.attitude_rad);
            attitude.z = near(attitude.z, wanted.attitude_rad[2]);
            self.filter = CommandFilter::at_rest(self.filter.w_f, attitude);
        } else if skipped > 0 {
            let passed = Passage::new(&self.filter.w_f, skipped as f64 * self.period_s);
            self.filter = self.filter.advance(&self.win, &passed);
        }
        self.win = self.filter.input(wanted);
    }

    /// nu2_d and its derivative at the measured attitude [rad] and body rates [rad/s].
    pub fn reference(&self, eta2: &Vector3<f64>, nu2: &Vector3<f64>) -> RateReference {
        self.reference_of(&self.filter, eta2, nu2)
    }

    /// The same a tick ahead, at an attitude and rates predicted for then.
    pub fn reference_ahead(&self, eta2: &Vector3<f64>, nu2: &Vector3<f64>) -> RateReference {
        self.reference_of(&self.next(), eta2, nu2)
    }

    fn reference_of(
        &self,
        filter: &CommandFilter,
        eta2: &Vector3<f64>,
        nu2: &Vector3<f64>,
    ) -> RateReference {
        let e2 = filter.acceleration(&self.win);
        let reference = match self.error {
            AttitudeError::Euler => rate_reference,
            AttitudeError::Quaternion => quaternion_reference,
        };
        reference(eta2, nu2, filter, &e2, &self.k_eta)
    }

    fn next(&self) -> CommandFilter {
        self.filter.advance(&self.win, &self.tick_passes)
    }

    pub fn end(&mut self, tick: u64) {
        self.filter = self.next();
        self.filter_tick = tick + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_filter_starts_on_the_turn_of_the_setpoint_and_where_that_is_the_own_with_the_measured_bits()
     {
        for turns in [-50.0, -1.0, 0.0, 1.0, 2.0] {
            let mut attitude = AttitudeLoop::new(&Rig::default(), &Gains::default());
            let wanted = Desired {
                attitude_rad: [0.0, 0.0, TAU * turns],
                ..Desired::default()
            };
            let measured = Measured {
                attitude_rad: [0.1, -0.2, -0.1],
                ..Measured::default()
            };
            attitude.begin(0, &wanted, None, Some(&measured));
            let [roll, pitch, yaw] = attitude.filter.ec.into();
            assert_eq!([roll, pitch], [0.1, -0.2]);
            assert!((yaw - (TAU * turns - 0.1)).abs() < 1e-12, "{yaw}");
            assert!(turns != 0.0 || yaw == -0.1);
        }
    }
}
