//! The paper's controller as a sampled law: trajectories, outer PD loop, inner adaptive loop.
//!
//! "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri). The
//! data's way: a [`Trajectory`] gives the [`Reference`] at the tick; [`OuterLoop`] turns it and the measured
//! state into thrust and attitude wanted ([`flatness`]); [`InnerLoop`] smooths the attitude
//! ([`command_filter`]), turns it into body rates ([`rate_reference`]), learns I_R, k_r and delta
//! ([`adaptation`]) and asks for a torque ([`rate_law`]), one tick ahead where told so ([`predictor`]).
//! [`WatchedLoop`] puts the monitor of the theorem beside it ([`monitor`]).
//!
//! Everything here is a pure law: time comes in as a tick, data as [`model::messages`]; no ports, clock,
//! allocation or logging in a tick. The rotors belong to the mixer, the airframe to the plant.

pub mod adaptation;
pub mod assumptions;
pub mod command_filter;
pub mod excitation;
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
pub mod watched;

pub use gains::{Gains, Preset};
pub use inner::InnerLoop;
pub use monitor::TheoremMonitor;
pub use outer::OuterLoop;
pub use settings::{Limits, Settings, SettingsError};
pub use trajectory::{Reference, Trajectory};
pub use watched::WatchedLoop;
