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
//! | inner | [`L1`] | Wu and others, L1Quad 2023 |
//! | inner | [`Mrac`] | Lavretsky, Wise 2013 |
//! | inner | [`Sliding`] | Levant 1998, Brogliato, Polyakov, Efimov 2020 |
//! | inner | [`AdaptiveResidual`] | the paper, (17)-(22), and the residual of `l1` |
//!
//! What they share is not a law: a low-pass ([`low_pass`]), what cascades have in common ([`cascade`]), and what laws
//! with an observer of the disturbance have ([`observed`]).

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::law::{InnerLaw, OuterLaw};
use control_api::registry::Entry;

use crate::gains::Gains;

pub mod adaptive;
pub mod adaptive_residual;
pub mod cascade;
pub mod estimating;
pub mod geometric;
pub mod indi;
pub mod l1;
pub mod low_pass;
pub mod mrac;
pub mod observed;
pub mod pd;
pub mod pid;
pub mod residual;
pub mod sliding;

pub use adaptive::{Adaptive, Fixed};
pub use adaptive_residual::AdaptiveResidual;
pub use estimating::Estimating;
pub use geometric::Geometric;
pub use indi::Indi;
pub use l1::L1;
pub use mrac::Mrac;
pub use pd::Pd;
pub use pid::Pid;
pub use sliding::Sliding;

/// The outer laws; the first one flies when nothing is said.
pub const OUTER: &[Entry<dyn OuterLaw>] = &[Entry::outer::<Pd>(), Entry::outer::<Estimating>()];

/// The inner laws; the first one flies when nothing is said.
pub const INNER: &[Entry<dyn InnerLaw>] = &[
    Entry::inner::<Adaptive>(),
    Entry::inner::<Fixed>(),
    Entry::inner::<Geometric>(),
    Entry::inner::<Indi>(),
    Entry::inner::<Pid>(),
    Entry::inner::<L1>(),
    Entry::inner::<Mrac>(),
    Entry::inner::<Sliding>(),
    Entry::inner::<AdaptiveResidual>(),
];

/// The gains on which the theorem's monitor watches an inner law; none for a law without a theorem.
pub fn theorem(name: &str, settings: &Settings) -> Option<Gains> {
    let gains = match name == AdaptiveResidual::DESCRIPTION.name {
        true => adaptive_residual::gains(settings),
        false => Gains::of(settings),
    };
    (may_have_theorem(name) && gains.adapts).then_some(gains)
}

/// Whether the inner law of a name has a theorem with some of its settings.
pub fn may_have_theorem(name: &str) -> bool {
    [
        Adaptive::DESCRIPTION.name,
        AdaptiveResidual::DESCRIPTION.name,
    ]
    .contains(&name)
}
