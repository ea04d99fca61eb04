//! The paper's laws in their stages, with gains that a test chooses.

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{Adaptive, Pd};
use controller::{Gains, ScaledTrajectory, Trajectory};
use mixer::Priority;

pub fn stages(
    rig: &Rig,
    trajectory: Trajectory,
    gains: &Gains,
) -> (GuardedOuter, GuardedInner, GuardedMixer) {
    (outer(rig, trajectory), inner(rig, gains), mixer(rig))
}

pub fn outer(rig: &Rig, trajectory: Trajectory) -> GuardedOuter {
    let route = ScaledTrajectory::of(trajectory).route(rig.period_s);
    GuardedOuter::new(
        Pd::new(rig, &Settings::default()).unwrap().into(),
        route,
        rig,
    )
}

pub fn inner(rig: &Rig, gains: &Gains) -> GuardedInner {
    GuardedInner::new(Adaptive::with(rig, gains).into(), rig)
}

pub fn mixer(rig: &Rig) -> GuardedMixer {
    GuardedMixer::new(
        Priority::new(rig, &Settings::default()).unwrap().into(),
        rig,
    )
}
