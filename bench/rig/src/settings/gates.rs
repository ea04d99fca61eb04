//! The gates that the settings ask for.

use report::verdict::GatesAsked;

use crate::settings::{RecorderSettings, Settings};
use failure::Failure;

impl Settings {
    /// The gates that the flight must hold.
    #[must_use]
    pub fn gates_asked(&self) -> GatesAsked {
        let limit = |limit: f64| (limit >= 0.0).then_some(limit);
        let recorder = &self.recorder;
        GatesAsked {
            position_error_max_m: self.flight.position_error_max_m,
            ground_z_m: self.flight.ground_z_m,
            tilt_max_rad: self.flight.tilt_max_rad,
            max_miss_rate_ppm: limit(recorder.max_miss_rate_ppm),
            max_skip_rate_ppm: limit(recorder.max_skip_rate_ppm),
            max_stale_rate_ppm: limit(recorder.max_stale_rate_ppm),
            max_wake_p999_us: limit(recorder.max_wake_p999_us),
            max_loop_p999_us: limit(recorder.max_loop_p999_us),
            max_tracking_error_m: limit(recorder.max_tracking_error_m),
            max_steal_percent: limit(recorder.max_steal_percent),
            theorem: recorder.gate_theorem,
        }
    }
}

impl RecorderSettings {
    /// Refuses a limit that no number is held against: it would be no gate, or one that always holds.
    ///
    /// # Errors
    /// A usage [`Failure`] names the key.
    pub(super) fn check_gates(&self) -> Result<(), Failure> {
        let is_wrong = |(key, limit): &&(&str, f64)| !limit.is_finite() || key.ends_with("percent") && *limit > 100.0;
        match self.limits().iter().find(is_wrong) {
            Some((key, limit)) => {
                let most = if key.ends_with("percent") { "0 to 100" } else { "0 and more" };
                Err(Failure::usage(format!(
                    "recorder.{key} = {limit}: allowed are {most}, and a negative number for no gate"
                ))
                .help("`ironbird fly --print-config` explains every setting"))
            }
            None => Ok(()),
        }
    }

    /// The limits of gates by their keys; a negative one is none.
    const fn limits(&self) -> [(&'static str, f64); 7] {
        [
            ("max_miss_rate_ppm", self.max_miss_rate_ppm),
            ("max_skip_rate_ppm", self.max_skip_rate_ppm),
            ("max_stale_rate_ppm", self.max_stale_rate_ppm),
            ("max_wake_p999_us", self.max_wake_p999_us),
            ("max_loop_p999_us", self.max_loop_p999_us),
            ("max_tracking_error_m", self.max_tracking_error_m),
            ("max_steal_percent", self.max_steal_percent),
        ]
    }
}
