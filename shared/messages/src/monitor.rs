//! What the theorem's monitor reports of a tick and of the flight so far.
//!
//! It is topic `theorem`: the recorder makes one message of every wrench, and no stage reads it. Counts and maxima run
//! from the start of the inner loop's process. docs/theorem.md explains every number.

use crate::layout::{layout, wire_enum};

wire_enum! {
    /// Why an inequality of the theorem did not hold at a tick, in order of precedence after the first.
    pub enum Cause {
        /// None that is known: the law did not do what is proven, or the plant not what it says.
        Unexplained = 0 => "unexplained",
        /// A true value of an estimated parameter was swapped, and its samples have not faded.
        LiveSwap = 1 => "live_swap",
        /// A true value of an estimated parameter is outside the bounds of its estimate.
        OutOfBounds = 2 => "out_of_bounds",
        /// A true parameter of the rate loop that is not estimated differs from the model's.
        BrokenModel = 3 => "broken_model",
        GyroNoise = 4 => "gyro_noise",
        MotorLag = 5 => "motor_lag",
        /// The rotors could not deliver the demand.
        Saturation = 6 => "saturation",
        /// A state, a setpoint or a rotor command was not of its tick, or the mixer had no wrench of its tick.
        StaleInput = 7 => "stale_input",
        /// The chain's delay, and the low-pass where it is on: part of every flight. Of a torque: `command_delay_s`.
        Delay = 8 => "delay",
    }
}

pub const CAUSES: usize = Cause::ALL.len();

impl Cause {
    /// Its bit in [`Monitor::causes`].
    pub const fn bit(self) -> u64 {
        1 << self as u64
    }
}

layout! {
    /// Ticks of a flight in which its torque was compared with (19).
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct TorqueCounts {
        /// Wrenches that were compared with (19) of their inputs.
        pub wrenches: u64,
        /// Of them, those that differ from it.
        pub wrenches_wrong: u64,
        /// Ticks whose rotors were compared with the wrench of the command in force.
        pub rotors: u64,
        /// Of them, those with another torque; by [`Cause`].
        pub rotors_wrong: [u64; CAUSES],
    }
}

layout! {
    /// Topic `theorem`, the theorem watched: V_th and V, their changes, what explains a rise, and what the flight can
    /// teach.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Monitor {
        /// Steps of the estimates that were checked.
        pub ticks_checked: u64,
        /// Steps at which V_th rose, or changed by other than the step owes; by [`Cause`].
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
        /// V_th at the start, or after a parameter change where that is more [rad^2/s^2].
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
        pub rate_error_max_rad_s: f64,
        /// ~th = th_hat - th: errors of the estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2].
        pub estimate_error: [f64; 3],
        /// Their sizes at the start, or after the last parameter change.
        pub estimate_error_start: [f64; 3],
        /// Upper bound that the theorem gives for them since then, on the exact model; updated every tenth of a second.
        pub estimate_error_bound: [f64; 3],

        /// Smallest eigenvalue of the Gramian of X over the last window of at most 10 s, scaled by Gamma: e-folds of the error. This
        /// and the values derived from it are updated every tenth of a second.
        pub excitation: f64,
        /// The least of all windows so far.
        pub excitation_least: f64,
        /// Per parameter, what of that Gramian no other parameter explains: e-folds of its error.
        pub identifiability: [f64; 3],

        pub steps_adapted: u64,
        /// Ticks whose command in force could not be met.
        pub ticks_saturated: u64,
        pub ticks_stale: u64,
        /// Changes of the true value of an estimated parameter; a ramp is one.
        pub live_swaps: u64,
        pub torque: TorqueCounts,
    }
}
