//! How far a flight is from its reference, in every state.
//!
//! It is judged by where the vehicle truly is, and not by what its sensors show: errors of the position do not make a
//! flight that tracks one that does not, or the other way round.
//! The reference is a function of time alone, so a state counts even if no set-point was published for its tick. A
//! flight that nobody controls is far from its reference, not without one.

use crate::laws::FlownLaws;
use crate::phrase::count;
use crate::schema::{ControlPerformance, Estimate};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::Reference;
use messages::content::{Setpoint, State, Wrench};
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

    /// Sample time of the laws [s].
    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Reference position at a tick, world frame [m]: that of the tick's set-point, bit for bit.
    pub fn position_w_m(&self, tick: u64) -> [f64; 3] {
        self.reference(tick).position_w_m
    }

    /// Reference yaw at a tick [rad].
    pub fn yaw_rad(&self, tick: u64) -> f64 {
        self.reference(tick).yaw_rad
    }

    fn reference(&self, tick: u64) -> Reference {
        self.course.reference(tick as f64 * self.period_s)
    }

    /// True distance of the state of a tick from its reference [m].
    pub fn error_m(&self, tick: u64, state: &State) -> f64 {
        Setpoint {
            reference: self.reference(tick),
            ..Setpoint::default()
        }
        .position_error_m(state)
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

    pub const fn states(&self) -> u64 {
        self.states
    }

    /// Root mean square [m]; 0 without a state.
    pub fn rms_m(&self) -> f64 {
        (self.squared_sum_m2 / self.states.max(1) as f64).sqrt()
    }

    /// Largest [m].
    pub const fn max_m(&self) -> f64 {
        self.max_m
    }

    /// That of the newest state [m].
    pub const fn last_m(&self) -> f64 {
        self.last_m
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
    /// Of a flight in ticks of `period_s` [s].
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
            .back()
            .is_some_and(|(_, earlier)| *earlier <= error_m)
        {
            self.errors.pop_back();
        }
        self.errors.push_back((tick, error_m));
        while self
            .errors
            .front()
            .is_some_and(|(earlier, _)| earlier + self.length_ticks <= tick)
        {
            self.errors.pop_front();
        }
    }

    /// Largest error [m]; 0 without a state.
    pub fn error_max_m(&self) -> f64 {
        self.errors.front().map_or(0.0, |(_, error_m)| *error_m)
    }

    /// How long they last [s]: less than [`RECENT_S`] in a short flight.
    pub fn length_s(&self) -> f64 {
        let ticks = self.first_tick.map_or(0, |first| {
            (self.newest_tick - first + 1).min(self.length_ticks)
        });
        ticks as f64 * self.period_s
    }

    /// Lowest point of the whole flight [m]; 0 without a state.
    pub fn lowest_z_m(&self) -> f64 {
        if self.lowest_z_m.is_finite() {
            self.lowest_z_m
        } else {
            0.0
        }
    }
}

impl fmt::Display for TrackingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            states,
            max_m,
            last_m,
            ..
        } = self;
        let rms_m = self.rms_m();
        write!(
            f,
            "rms {rms_m:.4} m, largest {max_m:.4} m, at the end {last_m:.4} m, over {}",
            count(*states, "state")
        )
    }
}

/// What the messages told so far; truth and estimate are those of the newest ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ControlStatistics {
    pub(super) truth: [f64; 3],
    pub(super) tracking: TrackingError,
    /// What the inner law estimates, where it does.
    pub(super) estimate: Option<[f64; 3]>,
    /// Length of the newest rate error that was known [rad/s].
    pub(super) rate_error: Option<f64>,
    /// Ticks in which a rotor was saturated.
    pub(super) saturated: u64,
}

impl ControlStatistics {
    /// Takes what the inner law shows.
    pub(super) fn shown(&mut self, laws: &FlownLaws, wrench: &Wrench) {
        self.estimate = laws.estimates().map(|places| places.of(wrench));
        let e = laws
            .rate_error()
            .map(|places| places.of(wrench).iter().map(|e| e * e).sum::<f64>().sqrt());
        self.rate_error = e.filter(|e| e.is_finite()).or(self.rate_error);
    }

    /// The performance so far, with that of the last seconds.
    pub(super) fn performance(&self, recent: &RecentStates) -> ControlPerformance {
        ControlPerformance {
            position_error_rms_m: self.tracking.rms_m(),
            position_error_max_m: self.tracking.max_m(),
            position_error_final_m: self.tracking.last_m(),
            states: self.tracking.states(),
            ticks_without_state: 0,
            recent_error_max_m: recent.error_max_m(),
            recent_s: recent.length_s(),
            lowest_z_m: recent.lowest_z_m(),
            rate_error_final_rad_s: self.rate_error,
            saturated_ticks: self.saturated,
            estimates: self
                .estimate
                .map_or_else(Vec::new, |estimate| self.beside_truth(estimate)),
        }
    }

    fn beside_truth(&self, estimate: [f64; 3]) -> Vec<Estimate> {
        let of = |i: usize| Estimate {
            name: ESTIMATED[i].name().into(),
            estimated: estimate[i],
            actual: self.truth[i],
        };
        (0..3).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use control_api::description::Settings;
    use control_api::law::Law as _;
    use control_api::stage::OuterStage as _;
    use control_api::{GuardedOuter, Rig};
    use controller::laws::Pd;
    use messages::content::Measured;
    use messages::content::{Stamped, Truth};

    use super::*;

    #[test]
    fn the_reference_of_a_tick_is_that_of_its_set_point() {
        let (rig, course) = (Rig::default(), ScaledTrajectory::of(Trajectory::Lissajous));
        let law = Pd::new(&rig, &Settings::default()).unwrap();
        let mut outer = GuardedOuter::new(law.into(), course.route(rig.period_s), &rig);
        let tracking = Tracking::along(course, rig.period_s);
        for tick in [0, 1, 777, 4_999, 5_000, 29_999] {
            let measured = Measured {
                position_w_m: [1.0, -2.0, 0.5],
                ..Measured::default()
            };
            let truth = Truth {
                position_w_m: [1.5, -2.0, 0.5],
                ..Truth::default()
            };
            let content = State {
                measured,
                truth,
                ..State::default()
            };
            let setpoint = outer.tick(tick, &Stamped { tick, content }).unwrap();
            let bits = |position: [f64; 3]| position.map(f64::to_bits);
            assert_eq!(
                bits(tracking.position_w_m(tick)),
                bits(setpoint.reference.position_w_m),
                "tick {tick}"
            );
            assert_eq!(
                tracking.yaw_rad(tick).to_bits(),
                setpoint.reference.yaw_rad.to_bits(),
                "tick {tick}"
            );
            assert_eq!(
                tracking.error_m(tick, &content).to_bits(),
                setpoint.position_error_m(&content).to_bits()
            );
            let shown = State {
                measured: Measured::default(),
                ..content
            };
            assert_eq!(
                tracking.error_m(tick, &shown).to_bits(),
                tracking.error_m(tick, &content).to_bits()
            );
        }
    }

    #[test]
    fn the_end_of_a_flight_is_its_last_seconds_and_its_lowest_point_that_of_all() {
        let mut recent = RecentStates::new(1e-3);
        assert_eq!(
            (recent.error_max_m(), recent.length_s(), recent.lowest_z_m()),
            (0.0, 0.0, 0.0)
        );
        for tick in 0..20_000 {
            let error_m = match tick {
                0..14_999 => 9.0,
                14_999 => 8.0,
                15_000 => 0.5,
                _ => 1e-3,
            };
            recent.take(tick, 1.0 + (tick as f64 - 3000.0).abs() / 3000.0, error_m);
            // One of each size at the most.
            assert!(
                recent.errors.len() <= 4,
                "what is not larger than a later one is not kept"
            );
        }
        // Ticks 15 000 to 19 999 are the last 5 s.
        assert_eq!(
            (recent.error_max_m(), recent.length_s(), recent.lowest_z_m()),
            (0.5, RECENT_S, 1.0)
        );
        recent.take(20_000, 0.0, 1e-4);
        assert_eq!(recent.error_max_m(), 1e-3);
    }

    #[test]
    fn errors_are_summed_up() {
        let mut error = TrackingError::default();
        assert_eq!((error.states(), error.rms_m()), (0, 0.0));
        [3.0, 4.0, 0.0]
            .into_iter()
            .for_each(|error_m| error.take(error_m));
        assert_eq!(
            (error.states(), error.max_m(), error.last_m()),
            (3, 4.0, 0.0)
        );
        assert!((error.rms_m() - (25.0_f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
