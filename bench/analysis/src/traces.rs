//! A flight over time, reduced to what a plot can show: part of the final report.
//!
//! A flight is cut into stretches of equal length. Each stretch keeps its smallest and its largest value, so no peak is
//! lost however long the flight was. [`crate::tracer`] fills them.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Three numbers of a vector, or of roll, pitch and yaw.
pub type Names = [&'static str; 3];

pub const ATTITUDE: Names = ["roll_rad", "pitch_rad", "yaw_rad"];
pub const ATTITUDE_REFERENCE: Names = [
    "roll_reference_rad",
    "pitch_reference_rad",
    "yaw_reference_rad",
];
pub const POSITION: Names = ["x_w_m", "y_w_m", "z_w_m"];
pub const POSITION_REFERENCE: Names = ["x_reference_w_m", "y_reference_w_m", "z_reference_w_m"];
pub const POSITION_ERROR: Names = ["x_error_w_m", "y_error_w_m", "z_error_w_m"];
pub const DISTANCE: &str = "position_error_m";
/// Rate error e of the inner law, body frame; of a law that shows one.
pub const RATE_ERROR: Names = ["p_error_b_rad_s", "q_error_b_rad_s", "r_error_b_rad_s"];
pub const THRUST: &str = "thrust_n";
pub const TORQUE: Names = ["torque_x_b_nm", "torque_y_b_nm", "torque_z_b_nm"];
pub const ROTORS: [&str; 4] = [
    "rotor_1_rad_s",
    "rotor_2_rad_s",
    "rotor_3_rad_s",
    "rotor_4_rad_s",
];
/// Estimates of I_R, k_r, delta; of a law that has a theorem.
pub const ESTIMATE: Names = [
    "i_r_estimated_kg_m2",
    "k_r_estimated_nm_s",
    "delta_estimated_rad_s2",
];
pub const ACTUAL: Names = ["i_r_actual_kg_m2", "k_r_actual_nm_s", "delta_actual_rad_s2"];
pub const ESTIMATE_ERROR: Names = ["i_r_error_kg_m2", "k_r_error_nm_s", "delta_error_rad_s2"];
/// V and V_th of the theorem, in rad^2/s^2.
pub const LYAPUNOV: [&str; 2] = ["v", "v_th"];
/// Their changes in a tick, in rad^2/s^2.
pub const LYAPUNOV_CHANGE: [&str; 2] = ["v_change", "v_th_change"];

pub const WAKE: &str = "wake_plant_us";
/// From the sampling of the state to the publishing of the rotor command.
pub const LOOP: &str = "loop_us";

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Traces {
    /// What was flown, of every tick of which the recorder has all messages.
    pub flight: Group,
    pub timing: Group,
    /// The way flown, for pictures of it from three sides.
    pub path: Path,
    /// What the laws show, by role, of every tick in which they do.
    pub telemetry: BTreeMap<String, Group>,
    pub violations: BTreeMap<String, Vec<Violations>>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Group {
    pub every_ticks: u64,
    pub tick: Vec<u64>,
    pub channels: BTreeMap<String, Trace>,
}

/// A number over time, to five significant digits; none where a stretch has no value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    pub min: Vec<Option<f64>>,
    pub max: Vec<Option<f64>>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    pub tick: Vec<u64>,
    pub position_w_m: Vec<[f64; 3]>,
    pub reference_w_m: Vec<[f64; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Violations {
    pub tick: u64,
    pub count: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    pub tick: u64,
    pub min: f64,
    pub max: f64,
}

impl Group {
    pub fn has(&self, channel: &str) -> bool {
        self.spans(channel).next().is_some()
    }

    /// The stretches of a channel that have values; none of a channel that is not there.
    pub fn spans(&self, channel: &str) -> impl Iterator<Item = Span> + '_ {
        let trace = self.channels.get(channel);
        self.tick.iter().enumerate().filter_map(move |(i, tick)| {
            let value = |values: &[Option<f64>]| values.get(i).copied().flatten();
            Some(Span {
                tick: *tick,
                min: value(&trace?.min)?,
                max: value(&trace?.max)?,
            })
        })
    }
}
