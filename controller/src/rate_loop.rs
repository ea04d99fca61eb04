//! What the settings of the paper's inner loop must keep to: order of its bounds, and a rate loop that is stable.
//!
//! The paper has no counterpart: its loops are continuous and have neither delay nor limits.

use control_api::description::Refused;
use control_api::law::Rig;
use messages::math::{exp_m1, ln_1p, sin};

use crate::gains::{ESTIMATE_MAX, ESTIMATE_MIN, Gains};

/// Delay of the chain that must be survived: one tick by design, and one more for a late command.
pub const CHAIN_DELAY_TICKS: u32 = 2;

/// Refuses gains that are meaningless or cannot fly. Nothing is changed to fit.
pub fn check(rig: &Rig, gains: &Gains) -> Result<(), Refused> {
    check_bounds(gains)?;
    if gains.predictor_ticks != 0.0 && gains.predictor_ticks != 1.0 {
        return Err(Refused(format!(
            "inner.predictor_ticks = {}: allowed are 0 (no predictor) and 1 (the delay of the chain)",
            gains.predictor_ticks
        )));
    }
    let (delay_ticks, remedy) = match gains.predictor_ticks {
        0.0 => (CHAIN_DELAY_TICKS, ", or set inner.predictor_ticks = 1"),
        _ => (CHAIN_DELAY_TICKS - 1, ""),
    };
    check_alpha(rig, gains.alpha_1_s, delay_ticks, remedy)
}

/// Refuses bounds of the estimates that contain nothing.
pub fn check_bounds(gains: &Gains) -> Result<(), Refused> {
    for (i, (low, high)) in gains
        .estimate_min
        .into_iter()
        .zip(gains.estimate_max)
        .enumerate()
    {
        if low > high {
            let (low_key, high_key) = (ESTIMATE_MIN.name, ESTIMATE_MAX.name);
            return Err(Refused(format!(
                "inner.{low_key}[{i}] = {low} must not be above inner.{high_key}[{i}] = {high}"
            )));
        }
    }
    Ok(())
}

/// The rate loop under delay: e(k+1) = e(k) - a_d T e(k-d) is stable exactly while
/// a_d T < 2 sin(pi / (2 (2d + 1))), where a_d T = 1 - exp(-alpha T) (see [`loop_gain_limit`]).
///
/// Without predictor d is the whole delay of the chain with one late command, 2: alpha < 0.9624/T, 962/s
/// at 1 kHz. The predictor starts from the command in force, which the state message names, so it takes one
/// tick off even when a command is late: d = 1, limit 1, and 1 - exp(-alpha T) is always below that. Only
/// where it rounds to 1 (alpha T above 36) is no margin left, and the settings are refused. `remedy` ends the refusal.
pub fn check_alpha(
    rig: &Rig,
    alpha_1_s: f64,
    delay_ticks: u32,
    remedy: &str,
) -> Result<(), Refused> {
    let period_s = rig.period_s;
    let limit = loop_gain_limit(delay_ticks);
    let loop_gain = -exp_m1(-alpha_1_s * period_s);
    if loop_gain < limit {
        return Ok(());
    }
    let alpha_t_max = -ln_1p(-limit);
    let (alpha_max_1_s, period_max_s) = (alpha_t_max / period_s, alpha_t_max / alpha_1_s);
    let divisor = 2 * (2 * delay_ticks + 1);
    Err(Refused(format!(
        "inner.alpha_1_s = {alpha_1_s} cannot fly at period_s = {period_s}: with a late command ({delay_ticks} \
         ticks of delay unpredicted) the rate loop needs 1 - exp(-alpha T) < 2 sin(pi/{divisor}) = {limit:.6}, \
         but it is {loop_gain:.6}; keep inner.alpha_1_s below {alpha_max_1_s:.1}, or period_s below \
         {period_max_s:.3e}{remedy}"
    )))
}

/// Largest loop gain c for which e(k+1) = e(k) - c e(k-d) is stable: 2 sin(pi / (2 (2d + 1))).
///
/// The characteristic z^(d+1) - z^d + c has its first root on the unit circle, z = exp(i w), where
/// c = |z - 1| = 2 sin(w/2) and the angles agree at w = pi/(2d + 1). So 2, 1 and 0.618 for d = 0, 1 and 2.
pub fn loop_gain_limit(delay_ticks: u32) -> f64 {
    let d = f64::from(delay_ticks);
    2.0 * sin(std::f64::consts::PI / (2.0 * (2.0 * d + 1.0)))
}
