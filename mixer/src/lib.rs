//! From thrust and torque to rotor speeds: equation (7) of the paper inverted, saturation by priority.
//!
//! [`priority`] has the laws; [`mix`] is what they compute. Neither knows a clock, a transport or an operating system.
#![cfg_attr(not(test), warn(clippy::disallowed_methods, clippy::disallowed_types))]

use control_api::law::MixerLaw;
use control_api::registry::Entry;

pub mod mix;
pub mod priority;

pub use crate::priority::{RollPitchFirst, ThrustFirst};

/// The mixers that come with the rig; the first one is the default.
pub const LAWS: &[Entry<dyn MixerLaw>] = &[
    Entry::mixer::<RollPitchFirst>(),
    Entry::mixer::<ThrustFirst>(),
];
