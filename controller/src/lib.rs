//! The paper's controller as a sampled law: trajectories, outer and inner loop.
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri). Data
//! flow: a [`Trajectory`] gives the [`Reference`] at the tick. [`OuterLoop`], a PD loop, turns it and the measured
//! state into the wanted thrust and attitude ([`flatness`]). [`InnerLoop`], which is adaptive, smooths the attitude
//! ([`command_filter`]), turns it into body rates ([`rate_reference`]), learns I_R, k_r and delta ([`adaptation`]) and
//! asks for a torque ([`rate_law`]), one tick ahead if configured so ([`predictor`]). [`TheoremMonitor`] checks what it
//! has learnt, from messages alone ([`monitor`]).
//!
//! Everything here is a pure law: time comes in as a tick, data as [`model::messages`]. A tick uses no port or clock,
//! allocates nothing and logs nothing. The rotors belong to the mixer, the airframe to the plant.

pub mod adaptation;
pub mod assumptions;
pub mod command_filter;
pub mod evidence;
pub mod excitation;
pub mod feasibility;
pub mod flatness;
pub mod gains;
pub mod inner;
pub mod lyapunov;
pub mod monitor;
pub mod outer;
pub mod predictor;
pub mod rate_law;
pub mod rate_reference;
pub mod samples;
pub mod settings;
pub mod trajectory;
pub mod weight;

pub use gains::{Gains, Preset};
pub use inner::InnerLoop;
pub use monitor::TheoremMonitor;
pub use outer::OuterLoop;
pub use settings::{Limits, LoopSettings, SettingsError};
pub use trajectory::{Course, Reference, Spline, Trajectory};
