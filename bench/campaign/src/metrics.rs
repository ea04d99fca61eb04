//! What a flight comes to, by the truth and not by what its sensors show.

use analysis::comparison::{Effort, STAYING_S};
use analysis::flight_metrics::FlightMetrics;
use messages::content::{RotorSpeeds, State};
use messages::parameters::Airframe;

use crate::gates::METRICS;

#[derive(Debug)]
pub struct Metrics {
    period_s: f64,
    flight: FlightMetrics,
    recoveries: Recoveries,
}

impl Metrics {
    /// Of a flight that has not begun, with faults at these ticks.
    pub fn new(
        period_s: f64,
        airframe: &Airframe,
        fault_ticks: Vec<u64>,
        last_tick: u64,
        bound_m: f64,
    ) -> Self {
        let staying = (STAYING_S / period_s).round() as u64;
        Self {
            period_s,
            flight: FlightMetrics::new(period_s, airframe),
            recoveries: Recoveries::new(fault_ticks, last_tick, bound_m, staying),
        }
    }

    /// Adds a tick: its state, its true position error [m], and the command computed from it.
    pub fn take(&mut self, tick: u64, state: &State, error_m: f64, rotors: &RotorSpeeds) {
        self.flight.take(tick, state, error_m, rotors);
        self.recoveries.take(tick, error_m);
    }

    /// The values of [`METRICS`]; there is no recovery without a fault, or when the flight did not recover from one.
    pub fn values(&self) -> [Option<f64>; METRICS.len()] {
        let (error, recent) = (&self.flight.error, &self.flight.recent);
        let Effort {
            power,
            agitation_rad_s,
            saturated_percent,
        } = self.flight.effort();
        let recovery = self.recoveries.longest_ticks();
        [
            Some(error.states as f64 * self.period_s),
            Some(error.max_m),
            Some(error.rms_m()),
            Some(recent.error_max_m()),
            recovery.map(|ticks| ticks as f64 * self.period_s),
            Some(self.flight.tilt_max_rad()),
            Some(saturated_percent),
            Some(power),
            Some(agitation_rad_s),
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
    /// Place of the fault that took effect last.
    newest_fault: Option<usize>,
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
            newest_fault: None,
            newest_tick: 0,
        }
    }

    fn take(&mut self, tick: u64, error_m: f64) {
        let next = self.newest_fault.map_or(0, |newest_fault| newest_fault + 1);
        if self.faults.get(next).is_some_and(|fault| *fault <= tick) {
            self.newest_fault = Some(next);
        }
        if let Some(newest_fault) = self.newest_fault.filter(|_| error_m > self.bound_m) {
            self.back[newest_fault] = tick + 1;
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
        for (what, faults, errors_m, last_tick, expected) in [
            (
                "the error came back once more",
                &[1][..],
                &errors[..],
                7,
                Some(4),
            ),
            (
                "without a fault there is nothing to recover from",
                &[],
                &errors,
                7,
                None,
            ),
            (
                "two ticks are too short to stay",
                &[1],
                &errors[..7],
                6,
                None,
            ),
            (
                "of a flight that ended early nothing is known",
                &[1],
                &errors,
                9,
                None,
            ),
            ("the error never left", &[5], &errors, 7, Some(0)),
            ("two faults", &[0, 0, 5], &twice, 9, Some(2)),
            ("the first one was not recovered", &[0, 3], &slow, 6, None),
        ] {
            assert_eq!(longest(faults, errors_m, last_tick), expected, "{what}");
        }
    }
}
