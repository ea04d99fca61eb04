//! What the rig does around every law: stale inputs, and answers that are not finite.
//!
//! | stage | stale input, or an answer that is not finite | for longer |
//! |---|---|---|
//! | outer | stale state: publishes nothing. Not finite: the last set-point, for 100 ms | level at the last yaw, hover thrust |
//! | inner | stale set-point: held for 100 ms. Stale state: zero torque, last thrust. Not finite: the same | level at the last yaw set-point, hover thrust; without a state zero torque, hover thrust, and idle after 1 s |
//! | mixer | stale wrench: held for 3 ticks. Not finite: equal speeds that give the thrust | thrust without torque, then idle |
//!
//! The table of the inner loop's inputs is in [`inner`], that of the mixer's in [`mixer`].

pub mod inner;
pub mod mixer;
pub mod outer;

pub use inner::GuardedInner;
pub use mixer::GuardedMixer;
pub use outer::{GuardedOuter, Route};

use crate::law::{Desired, Rig};

/// How long an input may be missing, or an answer not finite, before a loop falls back [s].
pub const HOLD_S: f64 = 0.1;

/// m g [N].
fn hover_thrust_n(rig: &Rig) -> f64 {
    rig.airframe.m() * rig.airframe.g()
}

/// Ticks of [`HOLD_S`].
fn hold_ticks(rig: &Rig) -> u64 {
    (HOLD_S / rig.period_s).round() as u64
}

/// Level at a yaw [rad], with hover thrust.
fn level(rig: &Rig, yaw_rad: f64) -> Desired {
    Desired {
        thrust_n: hover_thrust_n(rig),
        attitude_rad: [0.0, 0.0, yaw_rad],
        ..Desired::default()
    }
}
