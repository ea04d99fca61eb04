//! From thrust and torque to rotor speeds: (7) inverted, saturation by priority.
//!
//! [`mixer::Mixer`] is the stage: the process shell calls [`mixer::Mixer::tick`] once per tick. [`mix`] is the law.
//! Neither knows a clock, a transport or an operating system; the process shell is [`process`].

pub mod mix;
pub mod mixer;

pub use crate::mixer::{Mixer, Settings};
