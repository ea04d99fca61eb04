//! How far a flight is from its reference, in every state.
//!
//! It is judged by where the vehicle truly is, and not by what its sensors show: errors of the position do not make a
//! flight that tracks one that does not, or the other way round.
//! The reference is a function of time alone, so a state counts even if no setpoint was published for its tick. A
//! flight without control is far from its reference, not without one.

use crate::laws::FlownLaws;
use crate::phrase::count;
use crate::schema::{ControlPerformance, Estimate};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{Reference, Setpoint, State, Wrench};
use messages::parameters::ESTIMATED;
use std::collections::VecDeque;
use std::fmt;

#[derive(Clone, Copy, Debug)]
pub struct Tracking {
    course: ScaledTrajectory,
    period_s: f64,
}

impl Tracking {
    /// Of a trajectory that is flown in ticks of `period_s` [s].
    pub const fn of(trajectory: Trajectory, period_s: f64) -> Self {
        Self::along(ScaledTrajectory::of(trajectory), period_s)
    }

    /// Of a course that is flown in ticks of `period_s` [s].
    pub const fn along(course: ScaledTrajectory, period_s: f64) -> Self {
        Self { course, period_s }
    }

    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Reference position at a tick, world frame [m]: that of the tick's setpoint, bit for bit.
    pub fn position_w_m(&self, tick: u64) -> [f64; 3] {
        self.reference(tick).position_w_m
    }

    pub fn yaw_rad(&self, tick: u64) -> f64 {
        self.reference(tick).yaw_rad
    }

    fn reference(&self, tick: u64) -> Reference {
        self.course.reference(tick as f64 * self.period_s)
    }

    /// True distance of the state of a tick from its reference [m].
    pub fn error_m(&self, tick: u64, state: &State) -> f64 {
        state.position_error_m(&self.reference(tick))
    }

    /// The same from the setpoint of the tick, which has the reference already; without one as [`Self::error_m`].
    pub fn setpoint_error_m(&self, tick: u64, state: &State, setpoint: Option<&Setpoint>) -> f64 {
        setpoint.map_or_else(
            || self.error_m(tick, state),
            |setpoint| state.position_error_m(&setpoint.reference),
        )
    }
}

/// Distances of the states of a flight from their references, summed up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackingError {
    pub states: u64,
    squared_sum_m2: f64,
    pub max_m: f64,
    pub last_m: f64,
}

impl TrackingError {
    pub fn take(&mut self, error_m: f64) {
        self.states += 1;
        self.squared_sum_m2 += error_m * error_m;
        self.max_m = self.max_m.max(error_m);
        self.last_m = error_m;
    }

    pub fn rms_m(&self) -> f64 {
        (self.squared_sum_m2 / self.states.max(1) as f64).sqrt()
    }
}

/// Length of the end of a flight that says whether it tracked [s].
pub const RECENT_S: f64 = 5.0;

/// The last few seconds of a flight, and its lowest point.
#[derive(Clone, Debug)]
pub struct RecentStates {
    length_ticks: u64,
    period_s: f64,
    /// Ticks with their errors [m], of which each is larger than all that follow it.
    errors: VecDeque<(u64, f64)>,
    first_tick: Option<u64>,
    newest_tick: u64,
    lowest_z_m: f64,
}

impl RecentStates {
    pub fn new(period_s: f64) -> Self {
        Self {
            length_ticks: (RECENT_S / period_s).round() as u64,
            period_s,
            errors: VecDeque::new(),
            first_tick: None,
            newest_tick: 0,
            lowest_z_m: f64::INFINITY,
        }
    }

    /// Takes the state of a tick: its height and its distance from the reference [m].
    pub fn take(&mut self, tick: u64, z_m: f64, error_m: f64) {
        self.first_tick.get_or_insert(tick);
        self.newest_tick = tick;
        self.lowest_z_m = self.lowest_z_m.min(z_m);
        while self
            .errors
            .pop_back_if(|(_, earlier)| *earlier <= error_m)
            .is_some()
        {}
        self.errors.push_back((tick, error_m));
        let is_over = |it: &mut (u64, f64)| it.0 + self.length_ticks <= tick;
        while self.errors.pop_front_if(is_over).is_some() {}
    }

    pub fn error_max_m(&self) -> f64 {
        self.errors.front().map_or(0.0, |(_, error_m)| *error_m)
    }

    /// How long they last [s]: less than [`RECENT_S`] in a short flight.
    pub fn length_s(&self) -> f64 {
        let flown = self
            .first_tick
            .map_or(0, |first| self.newest_tick - first + 1);
        flown.min(self.length_ticks) as f64 * self.period_s
    }

    /// Lowest point of the whole flight [m]; 0 without a state.
    pub fn lowest_z_m(&self) -> f64 {
        let lowest = Some(self.lowest_z_m);
        lowest.filter(|z_m| z_m.is_finite()).unwrap_or(0.0)
    }
}

impl fmt::Display for TrackingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (rms_m, max_m, last_m) = (self.rms_m(), self.max_m, self.last_m);
        let states = count(self.states, "state");
        write!(
            f,
            "rms {rms_m:.4} m, largest {max_m:.4} m, at the end {last_m:.4} m, over {states}"
        )
    }
}

/// What the messages have shown so far; truth and estimate are those of the newest ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ControlStatistics {
    pub(super) truth: [f64; 3],
    pub(super) tracking: TrackingError,
    /// What the inner law estimates, where it does.
    pub(super) estimate: Option<[f64; 3]>,
    /// Length of the newest rate error that was known [rad/s].
    pub(super) rate_error: Option<f64>,
    pub(super) saturated: u64,
}

impl ControlStatistics {
    pub(super) fn wrench(&mut self, laws: &FlownLaws, wrench: &Wrench) {
        self.estimate = laws.estimates().map(|places| places.of(wrench));
        let e = laws.rate_error().map(|places| places.of(wrench));
        let e = e.map(|e| e.iter().map(|e| e * e).sum::<f64>().sqrt());
        self.rate_error = e.filter(|e| e.is_finite()).or(self.rate_error);
    }

    pub(super) fn performance(&self, recent: &RecentStates) -> ControlPerformance {
        let estimate = |i: usize| {
            Some(Estimate {
                name: ESTIMATED[i].name().into(),
                estimated: self.estimate?[i],
                actual: self.truth[i],
            })
        };
        ControlPerformance {
            position_error_rms_m: self.tracking.rms_m(),
            position_error_max_m: self.tracking.max_m,
            position_error_final_m: self.tracking.last_m,
            states: self.tracking.states,
            ticks_without_state: 0,
            recent_error_max_m: recent.error_max_m(),
            recent_s: recent.length_s(),
            lowest_z_m: recent.lowest_z_m(),
            rate_error_final_rad_s: self.rate_error,
            saturated_ticks: self.saturated,
            estimates: (0..3).filter_map(estimate).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use control_api::description::Settings;
    use control_api::law::Law as _;
    use control_api::{GuardedOuter, Rig};
    use controller::laws::Pd;
    use messages::content::{Measured, Stamped};

    use super::*;

    #[test]
    fn the_reference_of_a_tick_is_that_of_its_set_point_bit_for_bit() {
        let (rig, course) = (Rig::default(), ScaledTrajectory::of(Trajectory::Lissajous));
        let law = Pd::new(&rig, &Settings::default()).unwrap();
        let mut outer = GuardedOuter::new(law.into(), course.route(rig.period_s), &rig);
        let tracking = Tracking::along(course, rig.period_s);
        for tick in [0, 1, 777, 4_999, 5_000, 29_999] {
            let mut content = State::default();
            content.measured.position_w_m = [1.0, -2.0, 0.5];
            content.truth.position_w_m = [1.5, -2.0, 0.5];
            let setpoint = outer.tick(tick, &Stamped { tick, content }).unwrap();
            let reference = setpoint.reference;
            let bits = |[x, y, z]: [f64; 3], yaw: f64| [x, y, z, yaw].map(f64::to_bits);
            let found = bits(tracking.position_w_m(tick), tracking.yaw_rad(tick));
            let expected = bits(reference.position_w_m, reference.yaw_rad);
            assert_eq!(found, expected, "tick {tick}");
            let error_m = content.position_error_m(&setpoint.reference).to_bits();
            assert_eq!(tracking.error_m(tick, &content).to_bits(), error_m);
            let from_setpoint_m = tracking.setpoint_error_m(0, &content, Some(&setpoint));
            assert_eq!(from_setpoint_m.to_bits(), error_m);
            content.measured = Measured::default();
            assert_eq!(tracking.error_m(tick, &content).to_bits(), error_m);
        }
    }

    #[test]
    fn the_end_of_a_flight_is_its_last_seconds_and_its_lowest_point_that_of_all() {
        let mut recent = RecentStates::new(1e-3);
        let numbers = |it: &RecentStates| [it.error_max_m(), it.length_s(), it.lowest_z_m()];
        assert_eq!(numbers(&recent), [0.0; 3]);
        for tick in 0..20_000 {
            let error_m = match tick {
                0..14_999 => 9.0,
                14_999 => 8.0,
                15_000 => 0.5,
                _ => 1e-3,
            };
            recent.take(tick, 1.0 + (tick as f64 - 3000.0).abs() / 3000.0, error_m);
            // At most one of each size: what is not larger than a later one is not kept.
            assert!(recent.errors.len() <= 4);
        }
        // Ticks 15 000 to 19 999 are the last 5 s.
        assert_eq!(numbers(&recent), [0.5, RECENT_S, 1.0]);
        recent.take(20_000, 0.0, 1e-4);
        assert_eq!(recent.error_max_m(), 1e-3);
    }
}
