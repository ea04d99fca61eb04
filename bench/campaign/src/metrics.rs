//! What a flight comes to, by the truth and not by what its sensors show.

use model::math;
use model::messages::{ROTORS, RotorSpeeds, State};
use model::parameters::Airframe;
use report::comparison::STAYING_S;
use report::tracking::{RecentStates, TrackingError};

use crate::gates::METRICS;

/// A flight so far.
#[derive(Debug)]
pub struct Metrics {
    period_s: f64,
    error: TrackingError,
    recent: RecentStates,
    /// Smallest part of body z along the vertical: the largest tilt.
    upright_min: f64,
    saturated: u64,
    /// Sum of the cubed rotor speeds in hover, of the airframe as it was built [rad^3/s^3].
    hover: f64,
    power_sum: f64,
    /// Rotor command of the tick before [rad/s].
    command: Option<[f64; ROTORS]>,
    changes_squared_sum: f64,
    recoveries: Recoveries,
}

impl Metrics {
    /// Of a flight that has not begun, with faults at these ticks.
    #[must_use]
    pub fn new(period_s: f64, airframe: &Airframe, fault_ticks: Vec<u64>, last_tick: u64, bound_m: f64) -> Self {
        let hover = airframe.as_built().hover_speed_rad_s();
        let staying = (STAYING_S / period_s).round() as u64;
        Self {
            period_s,
            error: TrackingError::default(),
            recent: RecentStates::new(period_s),
            upright_min: 1.0,
            saturated: 0,
            hover: ROTORS as f64 * hover * hover * hover,
            power_sum: 0.0,
            command: None,
            changes_squared_sum: 0.0,
            recoveries: Recoveries::new(fault_ticks, last_tick, bound_m, staying),
        }
    }

    /// Takes a tick: its state, its true position error [m], and the command that was made of it.
    pub fn take(&mut self, tick: u64, state: &State, error_m: f64, rotors: &RotorSpeeds) {
        self.error.take(error_m);
        self.recent.take(tick, state.truth.position_w_m[2], error_m);
        self.recoveries.take(tick, error_m);
        // The sensors' attitude is the true one.
        let [_, x, y, _] = state.measured.attitude_quaternion;
        self.upright_min = self.upright_min.min(1.0 - 2.0 * (x * x + y * y));
        self.saturated += rotors.saturated;
        self.power_sum += state.measured.rotor_speed_mean_rad_s.iter().map(|w| w * w * w).sum::<f64>() / self.hover;
        let command = rotors.speed_rad_s;
        let before = self.command.replace(command).unwrap_or(command);
        let changes = (0..ROTORS).map(|i| (command[i] - before[i]) * (command[i] - before[i]));
        self.changes_squared_sum += changes.sum::<f64>();
    }

    /// What it comes to, as [`METRICS`]; the recovery is none without a fault, and where one was not recovered from.
    #[must_use]
    pub fn values(&self) -> [Option<f64>; METRICS.len()] {
        let ticks = self.error.states();
        let changes = ROTORS as f64 * ticks.saturating_sub(1).max(1) as f64;
        [
            Some(ticks as f64 * self.period_s),
            Some(self.error.max_m()),
            Some(self.error.rms_m()),
            Some(self.recent.error_max_m()),
            self.recoveries.longest_ticks().map(|ticks| ticks as f64 * self.period_s),
            Some(math::atan2((1.0 - self.upright_min * self.upright_min).max(0.0).sqrt(), self.upright_min)),
            Some(100.0 * self.saturated as f64 / ticks.max(1) as f64),
            Some(self.power_sum / ticks.max(1) as f64),
            Some((self.changes_squared_sum / changes).sqrt()),
        ]
    }
}

/// How long the error took to come back from each fault.
#[derive(Debug)]
struct Recoveries {
    /// Tick of each fault, in order; of several at one tick one.
    faults: Vec<u64>,
    /// Per fault, the tick from which the error has been below the bound.
    back: Vec<u64>,
    last_tick: u64,
    bound_m: f64,
    /// Ticks that it must stay there.
    staying: u64,
    /// Place of the fault that struck last.
    struck: Option<usize>,
    newest_tick: u64,
}

impl Recoveries {
    fn new(mut faults: Vec<u64>, last_tick: u64, bound_m: f64, staying: u64) -> Self {
        faults.sort_unstable();
        faults.dedup();
        Self { back: faults.clone(), faults, last_tick, bound_m, staying, struck: None, newest_tick: 0 }
    }

    fn take(&mut self, tick: u64, error_m: f64) {
        let next = self.struck.map_or(0, |struck| struck + 1);
        if self.faults.get(next).is_some_and(|fault| *fault <= tick) {
            self.struck = Some(next);
        }
        if let Some(struck) = self.struck.filter(|_| error_m > self.bound_m) {
            self.back[struck] = tick + 1;
        }
        self.newest_tick = tick;
    }

    /// The longest of them; none without a fault, where the flight ended early, and where one did not stay back.
    fn longest_ticks(&self) -> Option<u64> {
        if self.newest_tick < self.last_tick {
            return None;
        }
        let ends = self.faults.iter().skip(1).copied().chain([self.last_tick + 1]);
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
        (0..).zip(errors_m).for_each(|(tick, error_m)| recoveries.take(tick, *error_m));
        recoveries.longest_ticks()
    }

    #[test]
    fn a_recovery_lasts_until_the_error_stays_below_the_bound() {
        let errors = [0.0, 0.9, 0.9, 0.1, 0.9, 0.2, 0.2, 0.2];
        assert_eq!(longest(&[1], &errors, 7), Some(4), "the error came back once more");
        assert_eq!(longest(&[], &errors, 7), None, "without a fault there is nothing to recover from");
        assert_eq!(longest(&[1], &errors[..7], 6), None, "two ticks are too short to stay");
        assert_eq!(longest(&[1], &errors, 9), None, "of a flight that ended early nobody knows");
        assert_eq!(longest(&[5], &errors, 7), Some(0), "the error never left");
        assert_eq!(longest(&[0, 0, 5], &[0.9, 0.1, 0.1, 0.1, 0.1, 0.9, 0.9, 0.1, 0.1, 0.1], 9), Some(2));
        assert_eq!(longest(&[0, 3], &[0.9, 0.9, 0.9, 0.1, 0.1, 0.1, 0.1], 6), None, "the first one was not recovered");
    }
}
