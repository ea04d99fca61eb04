//! What is said before take-off and flown all the same.

use controller::feasibility::{Start, excesses};
use failure::Failure;

use super::Settings;

/// Damping of the rate loop below which its motors' lag is named.
const DAMPING_MIN: f64 = 0.5;

impl Settings {
    /// What the flight asks for beyond its limits, and gains that do not suit the airframe's motors.
    ///
    /// # Errors
    /// Those of [`Settings::controller`].
    pub fn warnings(&self) -> Result<Vec<String>, Failure> {
        let controller = self.controller()?;
        let name = self.trajectory_name();
        let start = Start { position_w_m: self.initial.position_w_m, yaw_rad: self.initial.attitude_rad[2] };
        let excesses = excesses(&controller, &start, self.flight.duration_s);
        let mut warnings: Vec<String> = excesses.iter().map(|it| format!("trajectory {name} {it}")).collect();
        let (alpha_1_s, lag_s) = (controller.gains.alpha_1_s, controller.model.motor_time_constant_s());
        // tau s^2 + s + alpha.
        let damping = 0.5 / (alpha_1_s * lag_s).sqrt();
        if damping < DAMPING_MIN {
            warnings.push(format!(
                "gains.alpha_1_s = {alpha_1_s} with motors that lag by {lag_s} s leaves the rate loop a damping of \
                 {damping:.2}; {DAMPING_MIN} needs {:.1} or less",
                1.0 / (4.0 * DAMPING_MIN * DAMPING_MIN * lag_s)
            ));
        }
        Ok(warnings)
    }
}
