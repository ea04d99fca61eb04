//! How well the loops controlled a flight, and the estimates beside the truth.

use model::parameters::ESTIMATED;

use crate::schema::{ControlPerformance, Estimate};
use crate::tracking::{RecentStates, TrackingError};

/// What the messages told so far; truth and estimate are those of the newest ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FlightTally {
    pub(super) truth: [f64; 3],
    pub(super) tracking: TrackingError,
    pub(super) estimate: [f64; 3],
    /// Length of the newest rate error [rad/s].
    pub(super) rate_error: f64,
    /// Ticks in which a rotor was saturated.
    pub(super) saturated: u64,
}

impl FlightTally {
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
            estimates: (0..3)
                .map(|i| Estimate {
                    name: ESTIMATED[i].name().into(),
                    estimated: self.estimate[i],
                    actual: self.truth[i],
                })
                .collect(),
        }
    }
}
