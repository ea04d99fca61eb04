//! The outer loop's stage: any outer law, and what is published when its answer cannot be.

use std::sync::Arc;

use messages::content::Reference;
use messages::content::{Mode, Setpoint, Stamped, State};
use messages::topic::Topic as _;

use crate::guard::{hold_ticks, level};
use crate::law::{Desired, Rig};
use crate::registry::{AnyOuter, Made};
use crate::stage::OuterStage;

pub type Route = Arc<dyn Fn(u64) -> Reference + Send + Sync>;

#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct GuardedOuter {
    made: Made<dyn AnyOuter>,
    route: Route,
    memory: Memory,
}

#[derive(Clone, Copy, Debug)]
struct Memory {
    rig: Rig,
    /// How many numbers the law shows.
    signals: usize,
    hold_ticks: u64,
    /// Tick of the last answer that could be published, and the answer.
    last: Option<(u64, Desired)>,
}

impl GuardedOuter {
    /// A law before tick 0, and where it should fly.
    #[must_use]
    pub fn new(made: Made<dyn AnyOuter>, route: Route, rig: &Rig) -> Self {
        let memory = Memory {
            rig: *rig,
            signals: made.signals,
            hold_ticks: hold_ticks(rig),
            last: None,
        };
        Self {
            made,
            route,
            memory,
        }
    }

    /// As [`OuterStage::tick_into`], where somebody knows the reference of the tick already.
    pub fn tick_along(
        &mut self,
        reference: Reference,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &mut Setpoint,
    ) -> bool {
        if state.tick != tick {
            return false;
        }
        setpoint.reference = reference;
        self.memory
            .tick(&mut *self.made.law, tick, &state.content, setpoint);
        true
    }

    /// Makes this stage what another one of the same law is; false, and nothing is to be flown by it, where the law
    /// cannot be copied.
    #[must_use]
    pub fn copy_from(&mut self, other: &Self) -> bool {
        self.memory = other.memory;
        other.made.law.copy_into(&mut *self.made.law)
    }
}

impl OuterStage for GuardedOuter {
    fn tick_into(&mut self, tick: u64, state: &Stamped<State>, setpoint: &mut Setpoint) -> bool {
        if state.tick != tick {
            return false;
        }
        self.tick_along((self.route)(tick), tick, state, setpoint)
    }

    fn rehearse(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        if state.tick != tick || !self.made.law.copy_into(&mut *self.made.twin) {
            return None;
        }
        let mut memory = self.memory;
        let mut setpoint = Setpoint {
            reference: (self.route)(tick),
            ..Setpoint::default()
        };
        memory.tick(&mut *self.made.twin, tick, &state.content, &mut setpoint);
        Some(setpoint)
    }
}

impl Memory {
    /// Completes a set-point that has its reference.
    fn tick(&mut self, law: &mut dyn AnyOuter, tick: u64, state: &State, setpoint: &mut Setpoint) {
        setpoint.telemetry.forget(self.signals);
        let wanted = law.tick(
            tick,
            &state.measured,
            &setpoint.reference,
            &mut setpoint.telemetry,
        );
        setpoint.telemetry.truncate(self.signals);
        write(&wanted, Mode::Fresh, setpoint);
        if setpoint.finite() && setpoint.plausible() {
            self.last = Some((tick, wanted));
            return;
        }
        let safe = match self.last {
            Some((answered, wanted)) if tick - answered <= self.hold_ticks => wanted,
            Some((_, wanted)) => level(&self.rig, wanted.attitude_rad[2]),
            None => level(&self.rig, state.measured.attitude_rad[2]),
        };
        write(&safe, Mode::NotFinite, setpoint);
    }
}

/// Rotors only push: less than no thrust is none.
fn write(wanted: &Desired, mode: Mode, setpoint: &mut Setpoint) {
    let &Desired {
        thrust_n,
        attitude_rad,
        attitude_rate_rad_s,
        attitude_acceleration_rad_s2,
        limited,
    } = wanted;
    setpoint.thrust_n = if thrust_n < 0.0 { 0.0 } else { thrust_n };
    setpoint.attitude_rad = attitude_rad;
    setpoint.attitude_rate_rad_s = attitude_rate_rad_s;
    setpoint.attitude_acceleration_rad_s2 = attitude_acceleration_rad_s2;
    setpoint.limited = limited;
    setpoint.mode = mode as u64;
}
