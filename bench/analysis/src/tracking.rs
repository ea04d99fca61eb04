//! Errors of a flight against its reference, in every state: position, yaw and tilt.
//!
//! It is judged by where the vehicle truly is, and not by what its sensors show: errors of the position do not make a
//! flight that tracks one that does not, or the other way round.
//! The reference is a function of time, or the plant's own, so a state counts even if no setpoint was published for its tick. A
//! flight without control is far from its reference, not without one.

use crate::effort::EffortStatistics;
use crate::laws::FlownLaws;
use crate::schema::{AngleErrors, ControlPerformance, Estimate};
use controller::{ScaledTrajectory, Trajectory};
use messages::content::{Reference, Setpoint, State, Wrench};
use messages::parameters::ESTIMATED;
use std::collections::VecDeque;

#[derive(Clone, Copy, Debug)]
pub struct Tracking {
    course: ScaledTrajectory,
    period_s: f64,
}

/// Errors of a state: of its position [m], of its yaw and of its tilt [rad], none below 0.
pub type StateErrors = [f64; 3];

/// Places in [`StateErrors`].
pub const POSITION: usize = 0;
pub const YAW: usize = 1;
pub const TILT: usize = 2;

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

    pub fn course(&self) -> &ScaledTrajectory {
        &self.course
    }

    /// Reference at a tick with this state: that of the tick's setpoint, bit for bit.
    pub fn reference(&self, tick: u64, state: &State) -> Reference {
        self.course.flown(tick as f64 * self.period_s, state)
    }

    /// True distance of the state of a tick from its reference, which the setpoint of the tick has already [m].
    pub fn error_m(&self, tick: u64, state: &State, setpoint: Option<&Setpoint>) -> f64 {
        let reference = setpoint.map(|setpoint| setpoint.reference);
        state.position_error_m(&reference.unwrap_or_else(|| self.reference(tick, state)))
    }

    /// True errors of the state of a tick from its reference, which the setpoint of the tick has already.
    pub fn errors(&self, tick: u64, state: &State, setpoint: Option<&Setpoint>) -> StateErrors {
        let reference = setpoint.map(|setpoint| setpoint.reference);
        let reference = &reference.unwrap_or_else(|| self.reference(tick, state));
        [
            state.position_error_m(reference),
            state.yaw_error_rad(reference),
            state.tilt_error_rad(reference),
        ]
    }
}

/// Length of the end of a flight that says whether it tracked [s].
pub const RECENT_S: f64 = 5.0;

/// Errors and effort of a flight, summed up; its lowest point, and its last few seconds.
#[derive(Clone, Debug)]
pub struct TrackingStatistics {
    length_ticks: u64,
    period_s: f64,
    pub states: u64,
    /// Of position, yaw and tilt, as in [`StateErrors`].
    pub errors: [ErrorStatistics; 3],
    pub effort: EffortStatistics,
    first_tick: Option<u64>,
    newest_tick: u64,
    lowest_z_m: f64,
    lowest_tick: Option<u64>,
}

#[derive(Clone, Debug, Default)]
pub struct ErrorStatistics {
    states: u64,
    squared_sum: f64,
    pub max: f64,
    pub last: f64,
    /// Ticks of the last few seconds with their errors, of which each is larger than all that follow it.
    recent: VecDeque<(u64, f64)>,
}

impl ErrorStatistics {
    fn take(&mut self, tick: u64, error: f64, length_ticks: u64) {
        self.states += 1;
        self.squared_sum += error * error;
        self.max = self.max.max(error);
        self.last = error;
        let is_not_larger = |it: &mut (u64, f64)| it.1 <= error;
        while self.recent.pop_back_if(is_not_larger).is_some() {}
        self.recent.push_back((tick, error));
        let is_over = |it: &mut (u64, f64)| it.0 + length_ticks <= tick;
        while self.recent.pop_front_if(is_over).is_some() {}
    }

    pub fn rms(&self) -> f64 {
        (self.squared_sum / self.states.max(1) as f64).sqrt()
    }

    /// Largest error of the last [`RECENT_S`].
    pub fn recent_max(&self) -> f64 {
        self.recent.front().map_or(0.0, |(_, error)| *error)
    }

    fn angle(&self) -> Option<AngleErrors> {
        (self.states > 0).then(|| AngleErrors {
            rms_rad: self.rms(),
            max_rad: self.max,
            final_rad: self.last,
            recent_max_rad: self.recent_max(),
        })
    }
}

impl TrackingStatistics {
    pub fn new(period_s: f64) -> Self {
        Self {
            length_ticks: (RECENT_S / period_s).round() as u64,
            period_s,
            states: 0,
            errors: Default::default(),
            effort: EffortStatistics::default(),
            first_tick: None,
            newest_tick: 0,
            lowest_z_m: f64::INFINITY,
            lowest_tick: None,
        }
    }

    /// Takes the state of a tick, and its errors.
    pub fn take(&mut self, tick: u64, state: &State, errors: &StateErrors) {
        self.states += 1;
        self.first_tick.get_or_insert(tick);
        self.newest_tick = tick;
        let z_m = state.truth.position_w_m[2];
        if z_m < self.lowest_z_m {
            (self.lowest_z_m, self.lowest_tick) = (z_m, Some(tick));
        }
        for (statistics, error) in self.errors.iter_mut().zip(errors) {
            statistics.take(tick, *error, self.length_ticks);
        }
    }

    /// Length of the last seconds [s]: less than [`RECENT_S`] in a short flight.
    fn recent_s(&self) -> f64 {
        let flown = self
            .first_tick
            .map_or(0, |first| self.newest_tick - first + 1);
        flown.min(self.length_ticks) as f64 * self.period_s
    }

    /// Lowest point of the whole flight [m]; 0 without a state.
    fn lowest_z_m(&self) -> f64 {
        let lowest = Some(self.lowest_z_m);
        lowest.filter(|z_m| z_m.is_finite()).unwrap_or(0.0)
    }

    /// The figures of the flight so far.
    pub fn performance(&self) -> ControlPerformance {
        let ([position, yaw, tilt], effort) = (&self.errors, &self.effort);
        ControlPerformance {
            position_error_rms_m: position.rms(),
            position_error_max_m: position.max,
            position_error_final_m: position.last,
            states: self.states,
            recent_error_max_m: position.recent_max(),
            recent_s: self.recent_s(),
            yaw_error: yaw.angle(),
            tilt_error: tilt.angle(),
            lowest_z_m: self.lowest_z_m(),
            lowest_at_s: self.lowest_tick.map(|tick| tick as f64 * self.period_s),
            saturated_ticks: effort.saturated,
            effort: effort.section(),
            ..ControlPerformance::default()
        }
    }
}

/// What the messages have shown so far; truth and estimate are those of the newest ones.
#[derive(Clone, Debug)]
pub(super) struct ControlStatistics {
    pub(super) truth: [f64; 3],
    pub(super) tracking: TrackingStatistics,
    /// What the inner law estimates, where it does.
    pub(super) estimate: Option<[f64; 3]>,
    /// Length of the newest rate error that was known [rad/s].
    pub(super) rate_error: Option<f64>,
}

impl ControlStatistics {
    pub(super) fn new(period_s: f64) -> Self {
        Self {
            truth: [0.0; 3],
            tracking: TrackingStatistics::new(period_s),
            estimate: None,
            rate_error: None,
        }
    }

    pub(super) fn wrench(&mut self, laws: &FlownLaws, wrench: &Wrench) {
        self.estimate = laws.estimates().map(|places| places.of(wrench));
        let e = laws.rate_error().map(|places| places.of(wrench));
        let e = e.map(|e| e.iter().map(|e| e * e).sum::<f64>().sqrt());
        self.rate_error = e.filter(|e| e.is_finite()).or(self.rate_error);
    }

    pub(super) fn performance(&self) -> ControlPerformance {
        let estimate = |i: usize| {
            Some(Estimate {
                name: ESTIMATED[i].name().into(),
                estimated: self.estimate?[i],
                actual: self.truth[i],
            })
        };
        ControlPerformance {
            rate_error_final_rad_s: self.rate_error,
            estimates: (0..3).filter_map(estimate).collect(),
            ..self.tracking.performance()
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
    use messages::math;
    use messages::parameters::Parameter;

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
            let found = tracking.reference(tick, &content);
            let found = bits(found.position_w_m, found.yaw_rad);
            let expected = bits(reference.position_w_m, reference.yaw_rad);
            assert_eq!(found, expected, "tick {tick}");
            let error_m = content.position_error_m(&setpoint.reference).to_bits();
            assert_eq!(tracking.error_m(tick, &content, None).to_bits(), error_m);
            let from_setpoint_m = tracking.error_m(0, &content, Some(&setpoint));
            assert_eq!(from_setpoint_m.to_bits(), error_m);
            content.measured = Measured::default();
            assert_eq!(tracking.error_m(tick, &content, None).to_bits(), error_m);
        }
    }

    #[test]
    fn the_end_of_a_flight_is_its_last_seconds_and_its_lowest_point_that_of_all() {
        let mut tracking = TrackingStatistics::new(1e-3);
        let take = |tracking: &mut TrackingStatistics, tick: u64, z_m, error: f64| {
            let mut state = State::default();
            state.truth.position_w_m = [0.0, 0.0, z_m];
            tracking.take(tick, &state, &[error, 2.0 * error, 3.0 * error]);
        };
        let numbers = |it: &TrackingStatistics| {
            let of = it.performance();
            [of.recent_error_max_m, of.recent_s, of.lowest_z_m]
        };
        assert_eq!(numbers(&tracking), [0.0; 3]);
        for tick in 0..20_000 {
            let error = match tick {
                0..14_999 => 9.0,
                14_999 => 8.0,
                15_000 => 0.5,
                _ => 1e-3,
            };
            let z_m = 1.0 + (tick as f64 - 3000.0).abs() / 3000.0;
            take(&mut tracking, tick, z_m, error);
            // At most one of each size: what is not larger than a later one is not kept.
            assert!(tracking.errors.iter().all(|it| it.recent.len() <= 4));
        }
        // Ticks 15 000 to 19 999 are the last 5 s.
        assert_eq!(numbers(&tracking), [0.5, RECENT_S, 1.0]);
        take(&mut tracking, 20_000, 0.0, 1e-4);
        assert_eq!(numbers(&tracking)[0], 1e-3);
        let yaw = tracking.errors[YAW].angle().unwrap();
        let [max, last, recent_max] = [yaw.max_rad, yaw.final_rad, yaw.recent_max_rad];
        assert_eq!([max, last, recent_max], [18.0, 2e-4, 2e-3]);
    }

    /// The errors of a level hover at a yaw, along a course with a yaw of 0.
    fn errors_at(yaw_rad: f64, wind_m_s: f64, tilt_rad: f64) -> StateErrors {
        let mut state = State::default();
        state.truth.parameter = *messages::parameters::Airframe::nominal().values();
        state.truth.parameter[Parameter::WindX as usize] = wind_m_s;
        state.measured.attitude_rad = [0.0, tilt_rad, yaw_rad];
        let (sin, cos) = math::sin_cos(tilt_rad / 2.0);
        state.measured.attitude_quaternion = [cos, 0.0, sin, 0.0];
        Tracking::of(Trajectory::Hover, 1e-3).errors(60_000, &state, None)
    }

    #[test]
    fn the_yaw_error_is_wrapped_and_the_tilt_error_is_against_what_the_reference_needs() {
        use std::f64::consts::{PI, TAU};
        for (yaw_rad, expected) in [
            (0.0, 0.0),
            (0.3, 0.3),
            (-0.3, 0.3),
            (11.0 * TAU, 0.0),
            (PI, PI),
        ] {
            let [_, yaw, tilt] = errors_at(yaw_rad, 0.0, 0.0);
            assert!((yaw - expected).abs() < 1e-12 && tilt < 1e-12, "{yaw_rad}");
        }
        // The vehicle must lean into the wind by the angle whose tangent is drag over weight.
        let [_, _, level] = errors_at(0.0, -2.0, 0.0);
        let lean = (0.95_f64 / 0.52 * 2.0 / 9.8).atan();
        let [_, _, leaning] = errors_at(0.0, -2.0, lean);
        assert!(
            (level - lean).abs() < 1e-12 && leaning < 1e-12,
            "{level} {leaning}"
        );
        assert!((errors_at(0.0, 0.0, 2.0)[TILT] - 2.0).abs() < 1e-12);
    }
}
