//! The metrics of a flight, by its true states and not by what its sensors measure.

use analysis::comparison::STAYING_S;
use analysis::flight_metrics::FlightMetrics;
use analysis::tracking::Tracking;
use messages::content::{RotorSpeeds, Setpoint, State};
use messages::parameters::Airframe;

use crate::gates::METRICS;

#[derive(Debug)]
pub struct Metrics {
    tracking: Tracking,
    flight: FlightMetrics,
    recoveries: Recoveries,
}

impl Metrics {
    /// Of a flight along a reference, with faults at these ticks.
    pub fn new(
        tracking: Tracking,
        airframe: &Airframe,
        fault_ticks: Vec<u64>,
        last_tick: u64,
        bound_m: f64,
    ) -> Self {
        let staying = (STAYING_S / tracking.period_s()).round() as u64;
        Self {
            tracking,
            flight: FlightMetrics::new(tracking.period_s(), airframe),
            recoveries: Recoveries::new(fault_ticks, last_tick, bound_m, staying),
        }
    }

    /// Adds a tick: its state, the setpoint if there was one, and the command computed from them.
    pub fn take(
        &mut self,
        tick: u64,
        state: &State,
        setpoint: Option<&Setpoint>,
        rotors: &RotorSpeeds,
    ) {
        let error_m = self.tracking.setpoint_error_m(tick, state, setpoint);
        self.flight.take(tick, state, error_m, rotors);
        self.recoveries.take(tick, error_m);
    }

    /// The values of [`METRICS`]; there is no recovery without a fault, or when the flight did not recover from one.
    pub fn values(&self) -> [Option<f64>; METRICS.len()] {
        let (error, recent) = (&self.flight.error, &self.flight.recent);
        let effort = self.flight.effort();
        let (recovery, period_s) = (self.recoveries.longest_ticks(), self.tracking.period_s());
        [
            Some(error.states as f64 * period_s),
            Some(error.max_m),
            Some(error.rms_m()),
            Some(recent.error_max_m()),
            recovery.map(|ticks| ticks as f64 * period_s),
            Some(self.flight.tilt_max_rad()),
            Some(effort.saturated_percent),
            Some(effort.power),
            Some(effort.agitation_rad_s),
        ]
    }
}

#[derive(Debug)]
struct Recoveries {
    /// Tick of each fault, in order; of several at one tick one.
    faults: Vec<u64>,
    /// Per fault, the tick from which the error has been below the bound.
    back: Vec<u64>,
    last_tick: u64,
    bound_m: f64,
    staying: u64,
    newest_tick: u64,
}

impl Recoveries {
    fn new(mut faults: Vec<u64>, last_tick: u64, bound_m: f64, staying: u64) -> Self {
        faults.sort_unstable();
        faults.dedup();
        Self {
            back: faults.clone(),
            faults,
            last_tick,
            bound_m,
            staying,
            newest_tick: 0,
        }
    }

    fn take(&mut self, tick: u64, error_m: f64) {
        let begun = self.faults.partition_point(|fault| *fault <= tick);
        if error_m > self.bound_m && begun > 0 {
            self.back[begun - 1] = tick + 1;
        }
        self.newest_tick = tick;
    }

    /// The longest of them; none without a fault, where the flight ended early, and where one did not stay back.
    fn longest_ticks(&self) -> Option<u64> {
        if self.newest_tick < self.last_tick {
            return None;
        }
        let later = self.faults.iter().skip(1).copied();
        let ends = later.chain([self.last_tick + 1]);
        let recovered = self.faults.iter().zip(&self.back).zip(ends);
        let mut longest = None;
        for ((fault, back), end) in recovered {
            if end.saturating_sub(*back) < self.staying {
                return None;
            }
            longest = longest.max(Some(back - fault));
        }
        longest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn longest(faults: &[u64], errors_m: &[f64], last_tick: u64) -> Option<u64> {
        let mut recoveries = Recoveries::new(faults.to_vec(), last_tick, 0.5, 3);
        (0..)
            .zip(errors_m)
            .for_each(|(tick, error_m)| recoveries.take(tick, *error_m));
        recoveries.longest_ticks()
    }

    #[test]
    fn a_recovery_lasts_until_the_error_stays_below_the_bound() {
        let errors = [0.0, 0.9, 0.9, 0.1, 0.9, 0.2, 0.2, 0.2];
        let twice = [0.9, 0.1, 0.1, 0.1, 0.1, 0.9, 0.9, 0.1, 0.1, 0.1];
        let slow = [0.9, 0.9, 0.9, 0.1, 0.1, 0.1, 0.1];
        for (faults, errors_m, last_tick, expected) in [
            // The error came back once more.
            (&[1][..], &errors[..], 7, Some(4)),
            // Without a fault there is nothing to recover from.
            (&[], &errors, 7, None),
            // Two ticks are too short to stay.
            (&[1], &errors[..7], 6, None),
            // Of a flight that ended early nothing is known.
            (&[1], &errors, 9, None),
            // The error never left.
            (&[5], &errors, 7, Some(0)),
            (&[0, 0, 5], &twice, 9, Some(2)),
            // The first one was not recovered.
            (&[0, 3], &slow, 6, None),
        ] {
            let longest = longest(faults, errors_m, last_tick);
            assert_eq!(longest, expected, "{faults:?} {errors_m:?}");
        }
    }
}
