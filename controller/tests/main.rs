//! Tests of the control laws.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod flight;
mod laws;
mod laws_flights;
mod laws_settings;
mod laws_vectors;
#[path = "../../shared/reference/vectors.rs"]
mod reference;
mod saved_state;
mod settings;
mod spline;
mod stale;
mod theorem;
mod vectors;

use control_api::{GuardedInner, Rig};
use controller::Gains;
use controller::laws::Adaptive;
use messages::content::{Measured, Reference, Setpoint, Stamped, State};
use messages::parameters::Airframe;
use nalgebra::Vector3;
use proptest::prelude::*;

/// The paper's inner loop before its first tick.
fn inner_loop() -> GuardedInner {
    let rig = Rig::default();
    GuardedInner::new(Adaptive::with(&rig, &Gains::default()).into(), &rig)
}

/// A slightly tilted airframe in hover, with a gyro that shows a different rate at every tick.
fn state(tick: u64) -> Stamped<State> {
    let w = Airframe::nominal().hover_speed_rad_s();
    let rate = 0.01 * (tick as f64).sin();
    let measured = Measured {
        attitude_rad: [0.1, -0.05, 0.3],
        rate_b_rad_s: [rate, -rate, 0.5 * rate],
        rotor_speed_mean_rad_s: [w; 4],
        rotor_speed_squared_mean_rad2_s2: [w * w; 4],
        rotor_speed_command_rad_s: [w; 4],
        ..Measured::default()
    };
    let content = State {
        measured,
        ..State::default()
    };
    Stamped::new(tick, content)
}

fn setpoint(tick: u64) -> Stamped<Setpoint> {
    let content = Setpoint {
        thrust_n: 6.0,
        attitude_rad: [0.2, 0.0, 0.4],
        attitude_rate_rad_s: [0.1, 0.0, 0.0],
        ..Setpoint::default()
    };
    Stamped::new(tick, content)
}

/// Value and derivatives of x, y, z and psi, as far as a reference has them.
fn axes(reference: &Reference) -> [Vec<f64>; 4] {
    let orders = [
        reference.position_w_m,
        reference.velocity_w_m_s,
        reference.acceleration_w_m_s2,
        reference.jerk_w_m_s3,
        reference.snap_w_m_s4,
    ];
    let along = |axis: usize| orders.iter().map(|order| order[axis]).collect();
    let yaw = vec![
        reference.yaw_rad,
        reference.yaw_rate_rad_s,
        reference.yaw_acceleration_rad_s2,
    ];
    [along(0), along(1), along(2), yaw]
}

/// Three numbers up to a size, of either sign.
fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-size..size).prop_map(Vector3::from)
}
