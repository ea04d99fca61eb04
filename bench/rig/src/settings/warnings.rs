//! What is said before take-off and flown all the same.

use control_api::law::Rig;
use controller::feasibility::{Start, excesses};
use controller::{Limits, gains};
use errors::Failure;
use messages::role::Role;

use super::Settings;

/// Damping of the rate loop below which its motors' lag is named.
const DAMPING_MIN: f64 = 0.5;

impl Settings {
    /// What the flight asks for beyond its limits, and gains that do not suit the airframe's motors.
    pub fn warnings(&self) -> Result<Vec<String>, Failure> {
        let rig = self.rig()?;
        let name = self.trajectory_name();
        let start = Start {
            position_w_m: self.initial.position_w_m,
            yaw_rad: self.initial.attitude_rad[2],
        };
        let excesses = excesses(
            &self.course()?,
            &rig,
            self.limits()?,
            &start,
            self.flight.duration_s,
        );
        let mut warnings: Vec<String> = excesses
            .iter()
            .map(|it| format!("trajectory {name} {it}"))
            .collect();
        warnings.extend(self.lag(&rig)?);
        Ok(warnings)
    }

    /// The limits of the thrust acceleration that hold, and the role whose law has them. An inner law that has some
    /// overrides the outer one.
    fn limits(&self) -> Result<Option<(Role, Limits)>, Failure> {
        for role in [Role::Inner, Role::Outer] {
            let (law, settings) = self.chosen(role)?;
            if let Some(limits) = Limits::of(law.description(), &settings) {
                return Ok(Some((role, limits)));
            }
        }
        Ok(None)
    }

    /// Whether a rate loop with the paper's alpha is too quick for its motors.
    fn lag(&self, rig: &Rig) -> Result<Option<String>, Failure> {
        let (law, settings) = self.chosen(Role::Inner)?;
        if !law.description().settings.contains(&gains::ALPHA_1_S) {
            return Ok(None);
        }
        let (alpha_1_s, lag_s) = (
            settings.number(&gains::ALPHA_1_S),
            rig.airframe.motor_time_constant_s(),
        );
        // tau s^2 + s + alpha.
        let damping = 0.5 / (alpha_1_s * lag_s).sqrt();
        Ok((damping < DAMPING_MIN).then(|| {
            format!(
                "inner.alpha_1_s = {alpha_1_s} with motors that lag by {lag_s} s leaves the rate loop a damping of \
                 {damping:.2}; {DAMPING_MIN} needs {:.1} or less",
                1.0 / (4.0 * DAMPING_MIN * DAMPING_MIN * lag_s)
            )
        }))
    }
}
