//! How far a flight is from its reference, in every state.
//!
//! The reference is a function of time alone, so a state counts even if no set-point was published for its tick. A
//! flight that nobody controls is far from its reference, not without one.

use std::fmt;

use controller::Trajectory;
use model::messages::{Setpoint, State};

/// The reference of a flight.
#[derive(Clone, Copy, Debug)]
pub struct Tracking {
    trajectory: Trajectory,
    period_s: f64,
}

impl Tracking {
    /// Of a trajectory that is flown in ticks of `period_s` [s].
    #[must_use]
    pub const fn of(trajectory: Trajectory, period_s: f64) -> Self {
        Self { trajectory, period_s }
    }

    /// Sample time of the laws [s].
    #[must_use]
    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Reference position at a tick, world frame [m]: that of the tick's set-point, bit for bit.
    #[must_use]
    pub fn position_w_m(&self, tick: u64) -> [f64; 3] {
        self.trajectory.reference(tick as f64 * self.period_s).position().into()
    }

    /// Reference yaw at a tick [rad].
    #[must_use]
    pub fn yaw_rad(&self, tick: u64) -> f64 {
        self.trajectory.reference(tick as f64 * self.period_s).yaw()
    }

    /// Distance of the state of a tick from its reference [m].
    #[must_use]
    pub fn error_m(&self, tick: u64, state: &State) -> f64 {
        let reference = Setpoint { reference_position_w_m: self.position_w_m(tick), ..Setpoint::default() };
        reference.position_error_m(state)
    }
}

/// Distances of the states of a flight from their references, summed up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackingError {
    states: u64,
    squared_sum_m2: f64,
    max_m: f64,
    last_m: f64,
}

impl TrackingError {
    /// Takes the distance of the next state [m].
    pub fn take(&mut self, error_m: f64) {
        self.states += 1;
        self.squared_sum_m2 += error_m * error_m;
        self.max_m = self.max_m.max(error_m);
        self.last_m = error_m;
    }

    /// States that were taken.
    #[must_use]
    pub const fn states(&self) -> u64 {
        self.states
    }

    /// Root mean square [m]; 0 without a state.
    #[must_use]
    pub fn rms_m(&self) -> f64 {
        (self.squared_sum_m2 / self.states.max(1) as f64).sqrt()
    }

    /// Largest [m].
    #[must_use]
    pub const fn max_m(&self) -> f64 {
        self.max_m
    }

    /// That of the newest state [m].
    #[must_use]
    pub const fn last_m(&self) -> f64 {
        self.last_m
    }
}

impl fmt::Display for TrackingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { states, max_m, last_m, .. } = self;
        let rms_m = self.rms_m();
        write!(f, "rms {rms_m:.4} m, largest {max_m:.4} m, at the end {last_m:.4} m, over {states} states")
    }
}

#[cfg(test)]
mod tests {
    use controller::{OuterLoop, Preset};
    use law::OuterLaw as _;
    use model::messages::Dated;

    use super::*;

    #[test]
    fn the_reference_of_a_tick_is_that_of_its_set_point() {
        let settings = controller::LoopSettings::new(Trajectory::Lissajous, Preset::Flight);
        let mut outer = OuterLoop::new(&settings);
        let tracking = Tracking::of(settings.trajectory, settings.period_s);
        for tick in [0, 1, 777, 4_999, 5_000, 29_999] {
            let content = State { position_w_m: [1.0, -2.0, 0.5], ..State::default() };
            let setpoint = outer.tick(tick, &Dated { tick, content }).unwrap();
            let bits = |position: [f64; 3]| position.map(f64::to_bits);
            assert_eq!(bits(tracking.position_w_m(tick)), bits(setpoint.reference_position_w_m), "tick {tick}");
            assert_eq!(tracking.yaw_rad(tick).to_bits(), setpoint.reference_yaw_rad.to_bits(), "tick {tick}");
            assert_eq!(tracking.error_m(tick, &content).to_bits(), setpoint.position_error_m(&content).to_bits());
        }
    }

    #[test]
    fn errors_are_summed_up() {
        let mut error = TrackingError::default();
        assert_eq!((error.states(), error.rms_m()), (0, 0.0));
        [3.0, 4.0, 0.0].into_iter().for_each(|error_m| error.take(error_m));
        assert_eq!((error.states(), error.max_m(), error.last_m()), (3, 4.0, 0.0));
        assert!((error.rms_m() - (25.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
