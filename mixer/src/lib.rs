//! From thrust and torque to rotor speeds: (7) inverted, saturation by priority.
//!
//! [`mixer::Mixer`] is the stage, which is asked once per tick ([`law::MixerLaw`]). [`mix`] is the law.
//! Neither knows a clock, a transport or an operating system.

pub mod mix;
pub mod mixer;

pub use crate::mixer::{Mixer, MixerSettings};
