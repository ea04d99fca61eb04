//! The laws of the outer and the inner loop that come with the rig, each in one file beside the source that it follows.
//!
//! | role | law | source |
//! |---|---|---|
//! | outer | [`Pd`] | the paper, (9)-(16) |
//! | outer | [`Estimating`] | the same, with estimates of thrust scale and drag |
//! | inner | [`Adaptive`] | the paper, (17)-(22) |
//! | inner | [`Fixed`] | the same without adaptation |
//! | inner | [`Geometric`] | Lee, Leok, McClamroch 2010 |
//! | inner | [`Indi`] | Smeur, Chu, de Croon 2016 |
//! | inner | [`Pid`] | the cascade of PX4, Brescianini, Hehn, D'Andrea 2013 |
//!
//! What they share is not a law: a low-pass ([`low_pass`]), and what cascades have in
//! common ([`cascade`]).

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::law::{InnerLaw, OuterLaw};
use control_api::registry::Entry;

use crate::gains::Gains;

pub mod adaptive;
pub mod cascade;
pub mod estimating;
pub mod geometric;
pub mod indi;
pub mod low_pass;
pub mod pd;
pub mod pid;

pub use adaptive::{Adaptive, Fixed};
pub use estimating::Estimating;
pub use geometric::Geometric;
pub use indi::Indi;
pub use pd::Pd;
pub use pid::Pid;

/// The outer laws; the first one flies when nothing is said.
pub const OUTER: &[Entry<dyn OuterLaw>] = &[Entry::outer::<Pd>(), Entry::outer::<Estimating>()];

/// The inner laws; the first one flies when nothing is said.
pub const INNER: &[Entry<dyn InnerLaw>] = &[
    Entry::inner::<Adaptive>(),
    Entry::inner::<Fixed>(),
    Entry::inner::<Geometric>(),
    Entry::inner::<Indi>(),
    Entry::inner::<Pid>(),
];

/// The gains on which the theorem's monitor watches an inner law; none for a law without a theorem.
pub fn theorem(name: &str, settings: &Settings) -> Option<Gains> {
    let gains = Gains::of(settings);
    (may_have_theorem(name) && gains.adapts).then_some(gains)
}

/// Whether the inner law of a name has a theorem with some of its settings.
pub fn may_have_theorem(name: &str) -> bool {
    name == Adaptive::DESCRIPTION.name
}
