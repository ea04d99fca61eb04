//! Motor lag that the loops of an inner law are unstable with, as far as its settings have the names of gains.

use control_api::description::{Description, Settings, Value};

use crate::gains::ALPHA_1_S;

/// Warnings for motors that the law expects to lag by `built_s` [s], and that lag by `lag_s` [s] at tick 0.
pub fn warnings(law: &Description, settings: &Settings, built_s: f64, lag_s: f64) -> Vec<String> {
    // Warn below this damping of the rate loop, and above this share of the lag that makes the attitude loop
    // unstable.
    const DAMPING_MIN: f64 = 0.5;
    const LAG_SHARE_MAX: f64 = 0.5;
    let mut warnings = Vec::new();
    if law.settings.contains(&ALPHA_1_S) {
        let alpha_1_s = settings.number(&ALPHA_1_S);
        // tau s^2 + s + alpha.
        let damping = 0.5 / (alpha_1_s * built_s).sqrt();
        if damping < DAMPING_MIN {
            warnings.push(format!(
                "inner.alpha_1_s = {alpha_1_s} with motors that lag by {built_s} s leaves the rate loop a damping of \
                 {damping:.2}; {DAMPING_MIN} needs {:.1} or less",
                1.0 / (4.0 * DAMPING_MIN * DAMPING_MIN * built_s)
            ));
        }
    }
    // The larger gain of roll and pitch.
    let gain = |name: &str| {
        let known = law.settings.iter().find(|setting| setting.name == name)?;
        match settings.value(known) {
            Value::Three([roll, pitch, _]) => Some(roll.max(pitch)),
            _ => None,
        }
    };
    // tau s^3 + s^2 + k_Omega s + k_R is stable if tau is below k_Omega/k_R.
    let attitude = match (
        gain("attitude_1_s"),
        gain("attitude_rad_s"),
        gain("rate_1_s"),
    ) {
        (Some(k), _, _) => Some(("attitude_1_s", k)),
        (None, Some(w), Some(rate)) => Some(("attitude_rad_s", w * w / rate)),
        _ => None,
    };
    if let Some((key, k)) = attitude.filter(|(_, k)| k * lag_s > LAG_SHARE_MAX) {
        warnings.push(format!(
            "the attitude loop of {} is unstable with motors that lag by {:.3} s or more, and the position loop sooner; \
             these lag by {lag_s} s: lower inner.{key}, or take another law",
            law.name,
            1.0 / k
        ));
    }
    warnings
}
