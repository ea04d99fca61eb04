//! From thrust and torque to rotor speeds: equation (7) inverted, saturation by priority.
//!
//! [`mixer::Mixer`] is the stage that a process shell drives, one [`mixer::Mixer::tick`] per tick; [`mix`] is the law.
//! Both know no clock, transport or operating system; the process shell is [`process`].

pub mod mix;
pub mod mixer;

pub use crate::mixer::{Mixer, Settings};
