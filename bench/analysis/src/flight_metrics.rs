//! Metrics of a flight, summed up tick by tick: tracking error, effort, tilt and recovery.
//!
//! They use the true state, not the measured one.

use crate::comparison::{Effort, ErrorFigures, Figures, Flight, POWER, TRUE_ERROR};
use crate::recovery::{Recoveries, RecoveryBounds};
use crate::schema::ControlPerformance;
use crate::tracer::{Merge as _, Range, Stretches};
use crate::tracking::{POSITION, StateErrors, Tracking, TrackingStatistics, YAW};
use crate::verdicts::FlightLimits;
use messages::content::{ROTORS, RotorSpeeds, State};
use messages::math;
use messages::parameters::Airframe;

/// Tracking error, effort and tilt of a flight, summed up tick by tick.
#[derive(Debug)]
pub struct FlightMetrics {
    pub tracking: TrackingStatistics,
    /// Smallest component of body z along the vertical: it gives the largest tilt.
    upright_min: f64,
    /// Sum of the cubed rotor speeds in hover, of the airframe as it was built [rad^3/s^3].
    hover: f64,
    power_sum: f64,
}

impl FlightMetrics {
    pub fn new(period_s: f64, airframe: &Airframe) -> Self {
        let hover = airframe.as_built().hover_speed_rad_s();
        Self {
            tracking: TrackingStatistics::new(period_s),
            upright_min: 1.0,
            hover: ROTORS as f64 * hover * hover * hover,
            power_sum: 0.0,
        }
    }

    /// Adds the state of a tick and its true errors. Returns the power of the tick relative to hover.
    pub fn state(&mut self, tick: u64, state: &State, errors: &StateErrors) -> f64 {
        self.tracking.take(tick, state, errors);
        // The sensors' attitude is the true one.
        let [_, x, y, _] = state.measured.attitude_quaternion;
        self.upright_min = self.upright_min.min(1.0 - 2.0 * (x * x + y * y));
        let speeds = state.measured.rotor_speed_mean_rad_s;
        let power = speeds.iter().map(|w| w * w * w).sum::<f64>() / self.hover;
        self.power_sum += power;
        power
    }

    pub fn tilt_max_rad(&self) -> f64 {
        let upright = self.upright_min;
        math::atan2((1.0 - upright * upright).max(0.0).sqrt(), upright)
    }

    pub fn effort(&self) -> Effort {
        Effort {
            power: self.power_sum / self.tracking.states.max(1) as f64,
            agitation_rad_s: self.tracking.effort.agitation_rad_s(),
            saturated_percent: self.tracking.effort.saturated_percent(),
        }
    }
}

/// A flight of a comparison: its metrics, and its true errors of position and yaw in every tick with a state.
#[derive(Debug)]
pub struct ComparedFlight {
    tracking: Tracking,
    metrics: FlightMetrics,
    ticks: Vec<u64>,
    error_m: Vec<f64>,
    yaw_error_rad: Vec<f64>,
    trace: Stretches<Range>,
    limits: FlightLimits,
    /// Tick in which it was below ground, or left its envelope.
    pub lost: Option<u64>,
}

impl ComparedFlight {
    pub fn new(tracking: Tracking, airframe: &Airframe, limits: FlightLimits) -> Self {
        Self {
            limits,
            lost: None,
            tracking,
            metrics: FlightMetrics::new(tracking.period_s(), airframe),
            ticks: Vec::new(),
            error_m: Vec::new(),
            yaw_error_rad: Vec::new(),
            trace: Stretches::default(),
        }
    }

    /// Adds the state of the next tick, up to the loss of the flight.
    pub fn state(&mut self, tick: u64, state: &State) {
        if state.truth.position_w_m[2] < self.limits.ground_z_m {
            self.lost.get_or_insert(tick);
        }
        // A flight that is lost at once has the errors of that tick.
        if self.lost.is_some() && !self.error_m.is_empty() {
            return;
        }
        let errors = self.tracking.errors(tick, state, None);
        let power = self.metrics.state(tick, state, &errors);
        let error_m = errors[POSITION];
        if error_m > self.limits.position_error_max_m {
            self.lost.get_or_insert(tick);
        }
        self.ticks.push(tick);
        self.error_m.push(error_m);
        self.yaw_error_rad.push(errors[YAW]);
        for (range, value) in self.trace.at(tick, 2).iter_mut().zip([error_m, power]) {
            *range = range.and(Range::of(value));
        }
    }

    /// Adds a rotor command, up to the loss of the flight.
    pub fn command(&mut self, rotors: &RotorSpeeds) {
        if self.lost.is_none() {
            self.metrics.tracking.effort.take(rotors);
        }
    }

    /// The figures of the flight, with the recoveries from its planned faults.
    pub fn figures(&self, flight: &Flight) -> Figures {
        let place = |tick: u64| self.ticks.partition_point(|it| *it < tick);
        let part = |from: u64, to: u64| error_figures(&self.error_m[place(from)..place(to)]);
        let first = flight.faults.first().map(|fault| fault.tick);
        let settled = flight.settled_tick();
        let ControlPerformance {
            yaw_error,
            tilt_error,
            ..
        } = self.metrics.tracking.performance();
        Figures {
            error: part(0, u64::MAX).unwrap_or_default(),
            error_before: first.and_then(|first| part(0, first)),
            error_from_fault: first.and_then(|first| part(first, u64::MAX)),
            error_after: settled.and_then(|settled| part(settled, u64::MAX)),
            yaw_error,
            tilt_error,
            recovery_s: self.recoveries(flight),
            effort: self.metrics.effort(),
            trace: Some(self.trace.group(&[TRUE_ERROR, POWER])),
        }
    }

    /// Per fault, how long the errors took to come back [s].
    fn recoveries(&self, flight: &Flight) -> Vec<Option<f64>> {
        let faults = flight.faults.iter().map(|fault| fault.tick);
        let mut recoveries = Recoveries::new(faults, flight.last_tick, flight.period_s);
        let bounds = RecoveryBounds {
            position_m: flight.bound_m,
            yaw_rad: flight.bound_yaw_rad,
        };
        let errors = self.error_m.iter().zip(&self.yaw_error_rad);
        for (tick, (error_m, yaw_rad)) in self.ticks.iter().zip(errors) {
            recoveries.take(*tick, bounds.hold(*error_m, *yaw_rad));
        }
        let ticks = recoveries.ticks().into_iter();
        ticks.map(|ticks| Some(flight.time_s(ticks?))).collect()
    }
}

fn error_figures(errors_m: &[f64]) -> Option<ErrorFigures> {
    let mut sorted = errors_m.to_vec();
    sorted.sort_by(f64::total_cmp);
    let worst_m = *sorted.last()?;
    // The smallest that 99 of 100 do not exceed.
    let rank = (sorted.len() * 99).div_ceil(100);
    let squares: f64 = errors_m.iter().map(|error_m| error_m * error_m).sum();
    Some(ErrorFigures {
        rms_m: (squares / errors_m.len() as f64).sqrt(),
        p99_m: sorted[rank - 1],
        worst_m,
    })
}

#[cfg(test)]
mod tests {
    use controller::Trajectory;

    use super::*;
    use crate::comparison::Fault;

    fn flight(last_tick: u64, faults: &[u64]) -> Flight {
        let fault = |tick: &u64| Fault {
            tick: *tick,
            time_s: *tick as f64 * 0.1,
            what: "mass_kg=0.6".into(),
        };
        Flight {
            trajectory: "hover".into(),
            airframe: "paper".into(),
            preset: "flight".into(),
            seed: 1,
            last_tick,
            period_s: 0.1,
            bound_m: 0.5,
            bound_yaw_rad: 0.1,
            faults: faults.iter().map(fault).collect(),
        }
    }

    /// A flight with these errors, whose sensors show none of them; its rotors turn at hover speed.
    fn flown(errors_m: &[f64]) -> ComparedFlight {
        turned(errors_m, 0.0)
    }

    /// A flight as of [`flown`] whose heading is off by an angle [rad] at every tick.
    fn turned(errors_m: &[f64], yaw_rad: f64) -> ComparedFlight {
        let (tracking, airframe) = (Tracking::of(Trajectory::Hover, 0.1), Airframe::nominal());
        let limits = FlightLimits {
            error_max_m: 0.1,
            yaw_error_max_rad: 0.1,
            ground_z_m: -10.0,
            position_error_max_m: 10.0,
        };
        let mut compared = ComparedFlight::new(tracking, &airframe, limits);
        for (tick, error_m) in (0..).zip(errors_m) {
            // The plant made no state in this tick.
            if error_m.is_nan() {
                continue;
            }
            let mut state = State::default();
            let [x, y, z] = tracking.reference(tick, &state).position_w_m;
            state.measured.position_w_m = [x, y, z];
            state.measured.attitude_rad[2] = yaw_rad;
            state.measured.rotor_speed_mean_rad_s = [airframe.hover_speed_rad_s(); ROTORS];
            state.truth.position_w_m = [x, y - error_m, z];
            let speed = 200.0 + if tick % 2 == 0 { 0.0 } else { 3.0 };
            let rotors = RotorSpeeds {
                speed_rad_s: [speed, speed, 200.0, 200.0],
                saturated: u64::from(tick % 4 == 0),
                ..RotorSpeeds::default()
            };
            compared.state(tick, &state);
            compared.command(&rotors);
        }
        compared
    }

    fn assert_close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9, "{a}, expected {b}");
    }

    #[test]
    fn errors_are_the_true_ones_before_the_first_fault_and_from_5_s_after_the_last() {
        let rising = (0..100).map(|tick| f64::from(tick) / 100.0);
        let errors_m: Vec<f64> = rising.chain([2.0; 101]).collect();
        let compared = flown(&errors_m);
        let figures = |faults: &[u64]| compared.figures(&flight(200, faults));
        let both = figures(&[50, 120]);
        let (before, after) = (both.error_before.unwrap(), both.error_after.unwrap());
        [before.worst_m, before.p99_m]
            .into_iter()
            .for_each(|m| assert_close(m, 0.49));
        // 199 of 201 values are not above 2, and the 99th percentile is the 199th.
        let all = [
            after.rms_m,
            after.worst_m,
            both.error.worst_m,
            both.error.p99_m,
        ];
        all.into_iter().for_each(|m| assert_close(m, 2.0));
        let from_fault = both.error_from_fault.unwrap();
        assert_close(from_fault.worst_m, 2.0);
        assert!(from_fault.rms_m < after.rms_m);
        // Ticks without a state shift nothing.
        let with_gap = [vec![f64::NAN; 10], errors_m[10..].to_vec()].concat();
        let of_gap = flown(&with_gap).figures(&flight(200, &[50, 120]));
        assert_close(of_gap.error_before.unwrap().worst_m, 0.49);
        assert_eq!(of_gap.recovery_s, both.recovery_s);
        // Nor does what comes after the tick in which the flight left its envelope.
        let lost = flown(&[0.1, 10.1, 30.0]);
        assert_eq!(lost.lost, Some(1));
        assert_close(lost.figures(&flight(2, &[])).error.worst_m, 10.1);
        // There is nothing before tick 0, and 5 s after tick 180 the flight was over.
        assert_eq!(figures(&[0]).error_before, None);
        assert_eq!(figures(&[180]).error_after, None);
        let none = figures(&[]);
        assert_eq!((none.error_before, none.error_after), (None, None));
        // The 99th percentile leaves out one in a hundred.
        let mut errors = vec![0.25; 200];
        (errors[3], errors[77]) = (9.0, 8.0);
        let figures = error_figures(&errors).unwrap();
        assert_eq!((figures.p99_m, figures.worst_m), (0.25, 9.0));
        errors[5] = 7.0;
        assert_eq!(error_figures(&errors).unwrap().p99_m, 7.0);
        assert_eq!(error_figures(&[]), None);
    }

    #[test]
    fn a_flight_has_recovered_when_its_error_stays_below_the_bound() {
        let mut errors = vec![0.1; 201];
        errors[50..70].fill(0.9);
        errors[75] = 0.6;
        errors[130..].fill(0.7);
        let plan = flight(200, &[50, 100, 130]);
        let recovered = |errors: &[f64]| flown(errors).figures(&plan).recovery_s;
        // Back once at 70, for good after 75; the second fault does nothing; the third stays.
        let found = recovered(&errors);
        assert_close(found[0].unwrap(), 2.6);
        assert_eq!(found[1..], [Some(0.0), None]);
        // Less than a fifth of the time is not yet a stay.
        errors[187..].fill(0.1);
        assert_eq!(recovered(&errors)[2], None);
        errors[186] = 0.1;
        assert_close(recovered(&errors)[2].unwrap(), 5.6);
        // Of a flight that ended early, no recovery is known.
        let early = flown(&[0.1; 150]).figures(&flight(200, &[50, 100, 180]));
        assert_eq!(early.recovery_s, [Some(0.0), None, None]);
        // Nor has one recovered that is where it should be and looks elsewhere.
        let of = |yaw_rad: f64| turned(&[0.1; 201], yaw_rad).figures(&plan).recovery_s;
        assert_eq!((of(0.09), of(-0.11)), (vec![Some(0.0); 3], vec![None; 3]));
    }

    #[test]
    fn effort_is_that_of_the_rotors() {
        let Figures { effort, trace, .. } = flown(&[0.0; 101]).figures(&flight(100, &[]));
        assert_close(effort.power, 1.0);
        // Two of four rotors change by 3 rad/s in every tick.
        assert_close(effort.agitation_rad_s, 4.5_f64.sqrt());
        assert_close(effort.saturated_percent, 100.0 * 26.0 / 101.0);
        assert_eq!(trace.unwrap().spans(POWER).count(), 101);
        let nothing = flown(&[]).figures(&flight(100, &[]));
        assert_eq!(nothing.effort.agitation_rad_s, 0.0);
    }
}
