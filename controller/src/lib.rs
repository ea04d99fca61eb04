//! Trajectories, and the laws of the outer and the inner loop ([`laws`]).
//!
//! The paper's two loops are the laws `pd` and `adaptive`. Source: "An Adaptive Scheme to Estimate Unknown Parameters
//! of an Unmanned Aerial Vehicle" (Imran, Montazeri). Data flow: a [`ScaledTrajectory`] gives the reference at the tick.
//! [`laws::Pd`] turns it and the measurement into the wanted thrust and attitude ([`flatness`]). [`laws::Adaptive`]
//! smooths the attitude and turns it into body rates ([`attitude_loop`]), learns I_R, k_r and delta
//! ([`adaptation`]) and asks for a torque ([`rate_law`]), one tick ahead if configured so.
//! [`TheoremMonitor`] checks what it has learnt, from messages alone ([`monitor`]).
//!
//! Everything here is a pure law: time comes in as a tick, data as [`messages::content`]. A tick uses no port or clock,
//! allocates nothing and logs nothing. The rotors belong to the mixer, the airframe to the plant.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod adaptation;
pub mod assumptions;
pub mod attitude_loop;
pub mod command_filter;
pub mod excitation;
pub mod feasibility;
pub mod flatness;
pub mod flight_monitor;
pub mod gains;
pub mod innovation;
pub mod laws;
pub mod limits;
pub mod lyapunov;
pub mod monitor;
pub mod motor_lag;
pub mod rate_law;
pub mod rate_loop;
pub mod torque_check;
pub mod torque_law;
pub mod trajectory;

pub use flight_monitor::FlightMonitor;
pub use gains::Gains;
pub use limits::Limits;
pub use monitor::TheoremMonitor;
pub use trajectory::{ScaledTrajectory, Spline, Trajectory};
