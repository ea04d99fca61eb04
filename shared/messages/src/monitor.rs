//! What the theorem's monitor reports of a tick and of the flight so far.
//!
//! It is topic `theorem`: the recorder makes one message of every wrench, and no stage reads it. Counts and maxima run
//! from the start of the inner loop's process. docs/theorem.md explains every number.

use crate::layout::{from_wire, layout};

/// Why an inequality of the theorem did not hold at a tick, in order of precedence after the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Cause {
    /// None that is known: the law did not do what is proven, or the plant not what it says.
    Unexplained = 0,
    /// A true value of an estimated parameter was swapped, and its samples have not faded.
    LiveSwap = 1,
    /// A true value of an estimated parameter is outside the bounds of its estimate.
    OutOfBounds = 2,
    /// A true parameter of the rate loop that is not estimated differs from the model's.
    BrokenModel = 3,
    GyroNoise = 4,
    MotorLag = 5,
    /// The rotors could not do what was asked.
    Saturation = 6,
    /// A state, a set-point or a rotor command was not of its tick.
    StaleInput = 7,
    /// The chain's delay, and the low-pass where it is on: part of every flight.
    Delay = 8,
}

pub const CAUSES: usize = 9;

from_wire!(Cause {
    Unexplained,
    LiveSwap,
    OutOfBounds,
    BrokenModel,
    GyroNoise,
    MotorLag,
    Saturation,
    StaleInput,
    Delay
});

impl Cause {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; CAUSES] = [
        Self::Unexplained,
        Self::LiveSwap,
        Self::OutOfBounds,
        Self::BrokenModel,
        Self::GyroNoise,
        Self::MotorLag,
        Self::Saturation,
        Self::StaleInput,
        Self::Delay,
    ];

    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unexplained => "unexplained",
            Self::LiveSwap => "live_swap",
            Self::OutOfBounds => "out_of_bounds",
            Self::BrokenModel => "broken_model",
            Self::GyroNoise => "gyro_noise",
            Self::MotorLag => "motor_lag",
            Self::Saturation => "saturation",
            Self::StaleInput => "stale_input",
            Self::Delay => "delay",
        }
    }

    /// Its bit in [`Monitor::causes`].
    #[must_use]
    pub const fn bit(self) -> u64 {
        1 << self as u64
    }
}

/// Topic `theorem`, the theorem watched: V_th and V, their changes, what explains a rise, and what the flight can
/// teach.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Monitor {
    /// Steps of the estimates that were checked.
    pub ticks_checked: u64,
    /// Steps at which V_th rose, or fell by less than the step owes; by [`Cause`].
    pub violations: [u64; CAUSES],
    /// Steps at which V changed by more than its bound, reported only; by [`Cause`].
    pub v_above_bound: [u64; CAUSES],
    /// Largest rise of V_th in a step [rad^2/s^2], by the cause in force; the first is that of no cause.
    pub rise_max: [f64; CAUSES],
    /// Causes in force at this tick: the sum of [`Cause::bit`].
    pub causes: u64,
    /// 1 when this tick is a violation, else 0.
    pub is_violation: u64,
    /// 1 while V_th has fallen by at least half of what the theorem predicts, or nothing is predicted, else 0.
    pub is_live: u64,

    /// V_th = 1/2 ~th^T Gamma^-1 ~th [rad^2/s^2].
    pub v_th: f64,
    /// V_th at the start, or after a live swap where that is more [rad^2/s^2].
    pub v_th_start: f64,
    /// Change of V_th since the tick before [rad^2/s^2].
    pub v_th_change: f64,
    /// The same as the theorem predicts it for the exact model [rad^2/s^2].
    pub v_th_change_predicted: f64,
    /// Fall of V_th over all steps without a cause [rad^2/s^2].
    pub descent: f64,
    /// The same as the theorem predicts it [rad^2/s^2].
    pub descent_predicted: f64,
    /// Largest excess of a step over what it owes, as a share of what rounding is allowed: above 1 is a violation.
    pub step_excess_max: f64,
    /// Y - X th: what the model with the true parameters leaves unexplained [rad/s^2].
    pub mismatch_rad_s2: f64,

    /// V = sigma/2 |e|^2 + V_th [rad^2/s^2].
    pub v: f64,
    /// Change of V since the tick before, both with the present sigma [rad^2/s^2].
    pub v_change: f64,
    /// Upper bound on the change of V, where nothing is late and no low-pass is on [rad^2/s^2].
    pub v_change_bound: f64,
    pub sigma: f64,

    /// Root mean square of |e| over about the last second, updated every tenth of a second [rad/s].
    pub rate_error_rms_rad_s: f64,
    /// Largest |e| [rad/s].
    pub rate_error_max_rad_s: f64,
    /// ~th = th_hat - th: errors of the estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
    pub estimate_error: [f64; 3],
    /// Their sizes at the start, or after the last live swap.
    pub estimate_error_start: [f64; 3],
    /// Upper bound that the theorem gives for them since then, on the exact model; updated every tenth of a second.
    pub estimate_error_bound: [f64; 3],

    /// Smallest eigenvalue of the Gramian of X over the last whole 10 s, scaled by Gamma: e-folds of the error. This
    /// and the values derived from it are updated every tenth of a second.
    pub excitation: f64,
    /// The least of all 10 s so far.
    pub excitation_least: f64,
    /// Per parameter, what of that Gramian no other parameter explains: e-folds of its error.
    pub identifiability: [f64; 3],

    pub steps_adapted: u64,
    /// Ticks whose command in force could not be met.
    pub ticks_saturated: u64,
    pub ticks_stale: u64,
    /// Live swaps of an estimated parameter.
    pub live_swaps: u64,
}

layout!(Monitor {
    ticks_checked,
    violations,
    v_above_bound,
    rise_max,
    causes,
    is_violation,
    is_live,
    v_th,
    v_th_start,
    v_th_change,
    v_th_change_predicted,
    descent,
    descent_predicted,
    step_excess_max,
    mismatch_rad_s2,
    v,
    v_change,
    v_change_bound,
    sigma,
    rate_error_rms_rad_s,
    rate_error_max_rad_s,
    estimate_error,
    estimate_error_start,
    estimate_error_bound,
    excitation,
    excitation_least,
    identifiability,
    steps_adapted,
    ticks_saturated,
    ticks_stale,
    live_swaps,
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::topic::Topic as _;

    #[test]
    fn causes_are_numbered_in_order_and_named_apart() {
        for (i, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, i);
            assert_eq!(Cause::from_wire(i as u64), Some(cause));
            assert!(
                Cause::ALL
                    .iter()
                    .all(|other| *other == cause || other.name() != cause.name())
            );
        }
        assert_eq!(Cause::from_wire(CAUSES as u64), None);
    }

    #[test]
    fn every_number_that_is_not_a_count_is_looked_at() {
        let mut seen = 0;
        Monitor::default().numbers(|numbers| seen += numbers.len());
        let counts = 1 + 2 * CAUSES + 3 + 4;
        assert_eq!(seen, size_of::<Monitor>() / 8 - counts);
    }
}
