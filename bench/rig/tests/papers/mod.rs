//! The paper's laws in their stages, with gains that a test chooses.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use controller::laws::{Adaptive, Pd};
use controller::{Course, Gains, Trajectory};
use law::description::Settings;
use law::law::Law as _;
use law::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use mixer::Priority;

/// All three.
pub fn stages(rig: &Rig, trajectory: Trajectory, gains: &Gains) -> (GuardedOuter, GuardedInner, GuardedMixer) {
    (outer(rig, trajectory), inner(rig, gains), mixer(rig))
}

pub fn outer(rig: &Rig, trajectory: Trajectory) -> GuardedOuter {
    let route = Course::of(trajectory).route(rig.period_s);
    GuardedOuter::new(Pd::new(rig, &Settings::default()).unwrap().into(), route, rig)
}

pub fn inner(rig: &Rig, gains: &Gains) -> GuardedInner {
    GuardedInner::new(Adaptive::with(rig, gains).into(), rig)
}

pub fn mixer(rig: &Rig) -> GuardedMixer {
    GuardedMixer::new(Priority::new(rig, &Settings::default()).unwrap().into(), rig)
}
