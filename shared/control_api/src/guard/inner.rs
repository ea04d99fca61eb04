//! The inner loop's stage: any inner law, and what the rig does when an input of it is stale.
//!
//! | input | missing for up to 100 ms: `Held` | longer, or never there: `Fallback` | for more than 1 s: `Idle` |
//! |---|---|---|---|
//! | set-point | the last one, rates included | level at the last yaw set-point, hover thrust; the reference rests here | as before |
//! | state | zero torque, last thrust | zero torque, hover thrust | no thrust, and the mixer idles the rotors |
//!
//! Whoever does not see for a second no longer knows which way is up: thrust then does more harm than none. A state that
//! comes again is flown again.
//!
//! A law is asked in every tick all the same: without a state its clocks run on, and its answer is not used. An answer
//! that is not finite, or that no airframe can give, counts like a missing state: `NotFinite`.

use messages::checks::{Check, is_on};
use messages::content::Reference;
use messages::content::{Mode, NO_TICK, Setpoint, Stamped, State, Wrench};
use messages::topic::Topic as _;

use crate::guard::{hold_ticks, hover_thrust_n, level};
use crate::law::{Desired, Rig, WrenchSetpoint};
use crate::registry::{AnyInner, Made};
use crate::stage::InnerStage;

/// How long the state may be missing before the rotors are to idle [s].
pub const BLIND_S: f64 = 1.0;

#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub struct GuardedInner {
    made: Made<dyn AnyInner>,
    memory: Memory,
}

#[derive(Clone, Copy, Debug)]
struct Memory {
    rig: Rig,
    /// How many numbers the law shows.
    signals: usize,
    hold_ticks: u64,
    /// Ticks of [`BLIND_S`].
    blind_ticks: u64,
    /// The first tick that it was asked in.
    since: Option<u64>,
    /// Tick of the newest state that was of the tick in which it was taken.
    measured_at: Option<u64>,
    /// Tick of the last answer that could be used.
    answered_at: Option<u64>,
    /// Thrust of the last tick [N].
    thrust_n: f64,
    /// Where the vehicle was, and its yaw, when the states began, or began again.
    began: Reference,
    /// Where the vehicle was when the set-point had been missing for too long.
    stays: Option<Reference>,
}

impl GuardedInner {
    #[must_use]
    pub fn new(made: Made<dyn AnyInner>, rig: &Rig) -> Self {
        let memory = Memory {
            rig: *rig,
            signals: made.signals,
            hold_ticks: hold_ticks(rig),
            blind_ticks: (BLIND_S / rig.period_s).round() as u64,
            since: None,
            measured_at: None,
            answered_at: None,
            thrust_n: 0.0,
            began: Reference::default(),
            stays: None,
        };
        Self { made, memory }
    }

    /// Makes this stage what another one of the same law is; false, and nothing is to be flown by it, where the law
    /// cannot be copied.
    #[must_use]
    pub fn copy_from(&mut self, other: &Self) -> bool {
        self.memory = other.memory;
        other.made.law.copy_into(&mut *self.made.law)
    }
}

impl InnerStage for GuardedInner {
    fn tick_into(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &mut Wrench,
    ) {
        self.memory
            .tick(&mut *self.made.law, tick, state, setpoint, wrench);
    }

    fn rehearse(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
    ) -> Option<Wrench> {
        let (mut memory, mut wrench) = (self.memory, Wrench::default());
        self.made.law.copy_into(&mut *self.made.twin).then(|| {
            memory.tick(&mut *self.made.twin, tick, state, setpoint, &mut wrench);
            wrench
        })
    }

    fn estimates(&self) -> Option<[f64; 3]> {
        self.made.law.estimates()
    }

    fn resume(&mut self, estimates: [f64; 3]) -> bool {
        self.made.law.resume(estimates)
    }
}

impl Memory {
    fn tick(
        &mut self,
        law: &mut dyn AnyInner,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &mut Wrench,
    ) {
        let measured = Stamped {
            tick: state.tick,
            content: state.content.measured,
        };
        let is_fresh = state.tick == tick;
        let is_lost = self.is_past(self.measured_at, tick);
        let since = *self.since.get_or_insert(tick);
        let seen_at = self.measured_at.unwrap_or(since);
        let is_blind =
            !is_fresh && tick.saturating_sub(seen_at) > self.blind_ticks && is_on(Check::Stale);
        if is_fresh {
            if is_lost {
                self.began = here(&state.content, state.content.measured.attitude_rad[2]);
            }
            self.measured_at = Some(tick);
        }
        let signals = self.signals;
        let (wanted, reference, mode) = self.order(tick, state, setpoint);
        wrench.telemetry.forget(signals);
        let demand = law.tick(tick, &measured, &wanted, reference, &mut wrench.telemetry);
        wrench.telemetry.truncate(signals);
        write(&demand, mode, wrench);
        let is_usable = wrench.finite() && wrench.plausible();
        match (is_usable, is_fresh) {
            _ if is_blind => write(&WrenchSetpoint::default(), Mode::Idle, wrench),
            (true, true) => {}
            (true, false) => self.coast(
                is_lost,
                if is_lost { Mode::Fallback } else { Mode::Held },
                wrench,
            ),
            (false, _) => self.coast(
                is_lost || self.is_past(self.answered_at, tick),
                Mode::NotFinite,
                wrench,
            ),
        }
        if is_usable {
            self.answered_at = Some(tick);
        }
        self.thrust_n = wrench.thrust_n;
    }

    /// Whether something was longer ago than it is held for, or never was.
    fn is_past(&self, at: Option<u64>, tick: u64) -> bool {
        at.is_none_or(|at| tick.saturating_sub(at) > self.hold_ticks && is_on(Check::Stale))
    }

    /// What to follow in this tick, and how it was come by.
    fn order<'a>(
        &'a mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &'a Stamped<Setpoint>,
    ) -> (Stamped<Desired>, &'a Reference, Mode) {
        let dated = |content| Stamped {
            tick: setpoint.tick,
            content,
        };
        if setpoint.age(tick) <= self.hold_ticks || !is_on(Check::Stale) {
            self.stays = None;
            let mode = if setpoint.tick == tick {
                Mode::Fresh
            } else {
                Mode::Held
            };
            return (
                dated(wanted(&setpoint.content)),
                &setpoint.content.reference,
                mode,
            );
        }
        let yaw = if setpoint.tick == NO_TICK {
            self.began.yaw_rad
        } else {
            setpoint.content.attitude_rad[2]
        };
        let stays = self.stays.get_or_insert_with(|| match state.tick {
            NO_TICK => self.began,
            _ => here(&state.content, yaw),
        });
        (dated(level(&self.rig, yaw)), stays, Mode::Fallback)
    }

    /// No torque, and the last thrust; where that is too old, hover thrust.
    fn coast(&self, is_lost: bool, mode: Mode, wrench: &mut Wrench) {
        let thrust_n = if is_lost {
            hover_thrust_n(&self.rig)
        } else {
            self.thrust_n
        };
        write(
            &WrenchSetpoint {
                thrust_n,
                torque_b_nm: [0.0; 3],
            },
            mode,
            wrench,
        );
    }
}

/// At rest where the vehicle is.
fn here(state: &State, yaw_rad: f64) -> Reference {
    Reference {
        position_w_m: state.measured.position_w_m,
        yaw_rad,
        ..Reference::default()
    }
}

fn wanted(setpoint: &Setpoint) -> Desired {
    let &Setpoint {
        thrust_n,
        attitude_rad,
        attitude_rate_rad_s,
        attitude_acceleration_rad_s2,
        limited,
        ..
    } = setpoint;
    Desired {
        thrust_n,
        attitude_rad,
        attitude_rate_rad_s,
        attitude_acceleration_rad_s2,
        limited,
    }
}

/// Rotors only push: less than no thrust is none.
fn write(demand: &WrenchSetpoint, mode: Mode, wrench: &mut Wrench) {
    wrench.thrust_n = if demand.thrust_n < 0.0 {
        0.0
    } else {
        demand.thrust_n
    };
    wrench.torque_b_nm = demand.torque_b_nm;
    wrench.mode = mode as u64;
}
