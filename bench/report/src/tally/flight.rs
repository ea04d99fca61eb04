//! How well the loops controlled a flight, and the estimates beside the truth.

use model::messages::Wrench;
use model::parameters::ESTIMATED;

use crate::laws::FlownLaws;
use crate::schema::{ControlPerformance, Estimate};
use crate::tracking::{RecentStates, TrackingError};

/// What the messages told so far; truth and estimate are those of the newest ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FlightTally {
    pub(super) truth: [f64; 3],
    pub(super) tracking: TrackingError,
    /// What the inner law estimates, where it does.
    pub(super) estimate: Option<[f64; 3]>,
    /// Length of the newest rate error that was known [rad/s].
    pub(super) rate_error: Option<f64>,
    /// Ticks in which a rotor was saturated.
    pub(super) saturated: u64,
}

impl FlightTally {
    /// Takes what the inner law shows.
    pub(super) fn shown(&mut self, laws: &FlownLaws, wrench: &Wrench) {
        self.estimate = laws.estimates().map(|places| places.of(wrench));
        let e = laws.rate_error().map(|places| places.of(wrench).iter().map(|e| e * e).sum::<f64>().sqrt());
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
            estimates: self.estimate.map_or_else(Vec::new, |estimate| self.beside_truth(estimate)),
        }
    }

    fn beside_truth(&self, estimate: [f64; 3]) -> Vec<Estimate> {
        let of =
            |i: usize| Estimate { name: ESTIMATED[i].name().into(), estimated: estimate[i], actual: self.truth[i] };
        (0..3).map(of).collect()
    }
}
