//! The stages: what the rig does around every law when inputs are stale or outputs are not finite.
//!
//! | stage | stale input, or an output that is not finite | for longer |
//! |---|---|---|
//! | outer | stale state: publishes nothing. Not finite: the last setpoint, for 100 ms | level at the last yaw, hover thrust |
//! | inner | stale setpoint: held for 100 ms. Stale state: zero torque, last thrust. Not finite: the same | level at the last yaw setpoint, hover thrust; without a state zero torque, hover thrust, and idle after 1 s |
//! | mixer | stale wrench: held for 3 ticks. Not finite: equal speeds that give the thrust | thrust without torque, then idle |
//!
//! A stage writes into the place of an older message: messages are large, and a copy of each would cost a tick more than
//! some laws do. `rehearse` is a warm-up run: it works on copies, and returns nothing if the law cannot be copied.

use std::sync::Arc;

use messages::allocation::Allocation;
use messages::content::{
    Mode, NO_TICK, ROTORS, Reference, RotorSpeeds, Setpoint, Stamped, State, Wrench,
};
use messages::role::Channel;
use messages::telemetry::Telemetry;
use messages::topic::Topic as _;
use nalgebra::Vector4;

use crate::description::Refused;
use crate::law::{
    CopyState, Desired, Given, InnerInput, InnerLaw, MixerInput, MixerLaw, OuterInput, OuterLaw,
    Rig, WrenchSetpoint,
};
use crate::registry::Made;
use crate::saved_state::{Field, Fields, SavedState, saved_fields};

/// How long an input may be missing, or an output not finite, before a loop falls back [s].
pub const HOLD_S: f64 = 0.1;
/// How long the state may be missing before the rotors idle [s].
pub const BLIND_S: f64 = 1.0;

/// A law, and what the rig remembers between its ticks.
pub struct Guarded<L: ?Sized, M> {
    made: Made<L>,
    memory: M,
}

pub type GuardedOuter = Guarded<dyn OuterLaw, OuterMemory>;
pub type GuardedInner = Guarded<dyn InnerLaw, InnerMemory>;
pub type GuardedMixer = Guarded<dyn MixerLaw, Rotors>;

/// The reference of each tick and its state.
pub type Route = Arc<dyn Fn(u64, &State) -> Reference + Send + Sync>;

impl<L: CopyState + ?Sized, M: Field + Clone> Guarded<L, M> {
    /// Copies law and memory of another stage of the same law; false, and the stage must not be used, if the law cannot
    /// be copied.
    pub fn copy_from(&mut self, other: &Self) -> bool {
        self.memory.clone_from(&other.memory);
        other.made.law.copy_into(self.made.law.as_any())
    }

    /// Writes the state of law and memory into the place of an older one; false, and `state` is empty, if this law cannot
    /// be saved.
    pub fn save(&mut self, state: &mut SavedState) -> bool {
        state.clear();
        let is_saved = self.transfer(&mut Fields::Write(state));
        if !is_saved {
            state.clear();
        }
        is_saved
    }

    /// Continues from a saved state; false, and nothing is changed, if it is not one of this law in this version.
    pub fn load(&mut self, state: &[u8]) -> bool {
        self.transfer(&mut Fields::Read(state))
    }

    /// Gives its place to another instance, which continues from its state; `room` is for that state. False if the law
    /// cannot be saved, and the other instance begins with its initial state.
    pub fn replace_by(&mut self, next: Self, room: &mut SavedState) -> bool {
        self.save(room);
        *self = next;
        self.load(room)
    }

    fn transfer(&mut self, fields: &mut Fields) -> bool {
        let mut hash = self.made.state_hash;
        // Writing changes nothing.
        if matches!(fields, Fields::Write(_)) {
            fields.all([&mut hash, &mut self.memory]);
            return self.made.law.transfer(fields);
        }
        let mut memory = self.memory.clone();
        fields.all([&mut hash, &mut memory]);
        if hash != self.made.state_hash {
            *fields = Fields::Refused;
        }
        let is_done = self.made.law.transfer(fields);
        if is_done {
            self.memory = memory;
        }
        is_done
    }

    fn on_copies<R>(&mut self, tick: impl FnOnce(&mut M, &mut L) -> R) -> Option<R> {
        let Self { made, memory } = self;
        made.law
            .copy_into(made.twin.as_any())
            .then(|| tick(&mut memory.clone(), &mut *made.twin))
    }
}

/// The ticks of a stage that works with the newest inputs, whatever their ticks.
macro_rules! ticks {
    ($guarded:ident, $output:ident, $($input:ident: $content:ident),+) => {
        impl $guarded {
            /// Writes the output of a tick into the place of an older one.
            pub fn tick_into(
                &mut self,
                tick: u64,
                $($input: &Stamped<$content>,)+
                output: &mut $output,
            ) {
                self.memory.tick(&mut *self.made.law, tick, $($input,)+ output);
            }

            pub fn tick(&mut self, tick: u64, $($input: &Stamped<$content>),+) -> $output {
                let mut output = $output::default();
                self.tick_into(tick, $($input,)+ &mut output);
                output
            }

            pub fn rehearse(
                &mut self,
                tick: u64,
                $($input: &Stamped<$content>),+
            ) -> Option<$output> {
                self.on_copies(|memory, law| {
                    let mut output = $output::default();
                    memory.tick(law, tick, $($input,)+ &mut output);
                    output
                })
            }
        }
    };
}

ticks!(GuardedInner, Wrench, state: State, setpoint: Setpoint);
ticks!(GuardedMixer, RotorSpeeds, wrench: Wrench);

/// m g [N].
pub fn hover_thrust_n(rig: &Rig) -> f64 {
    rig.airframe.m() * rig.airframe.g()
}

fn ticks(time_s: f64, rig: &Rig) -> u64 {
    (time_s / rig.period_s).round() as u64
}

/// Level at a yaw [rad], with hover thrust.
fn level(rig: &Rig, yaw_rad: f64) -> Desired {
    Desired {
        thrust_n: hover_thrust_n(rig),
        attitude_rad: [0.0, 0.0, yaw_rad],
        ..Desired::default()
    }
}

/// Evaluates the rotor command in force for the laws of a group of channels.
#[derive(Clone, Copy)]
struct ActiveCommand {
    k: f64,
    allocation: Allocation,
    group: Channel,
}

impl ActiveCommand {
    fn new(rig: &Rig) -> Self {
        Self {
            k: rig.airframe.k(),
            allocation: Allocation::new(&rig.airframe),
            group: Channel::A,
        }
    }

    /// What the rotor command gives that was in force when a state was measured, by the nominal model.
    fn of(&self, state: &Stamped<State>) -> Stamped<Given> {
        let content = &state.content;
        let commanded = Vector4::from(content.measured.rotor_speed_command_rad_s);
        let f = commanded.map(|w| self.k * w * w);
        let (thrust_n, torque) = self.allocation.wrench(&f);
        let tick = match state.tick {
            NO_TICK => NO_TICK,
            _ => content.command_tick,
        };
        let is_other = tick != NO_TICK && content.decision.group != self.group as u64;
        let given = Given {
            thrust_n,
            torque_b_nm: torque.into(),
            saturated: content.command_saturated,
            other_law: u64::from(is_other),
        };
        Stamped::new(tick, given)
    }
}

/// Rotors only push. NaN stays NaN.
fn not_negative(thrust_n: f64) -> f64 {
    if thrust_n < 0.0 { 0.0 } else { thrust_n }
}

#[derive(Clone)]
pub struct OuterMemory {
    route: Route,
    rig: Rig,
    active_command: ActiveCommand,
    signals: usize,
    hold_ticks: u64,
    /// Tick of the last output that was published, and the output.
    last: Option<(u64, Desired)>,
}

impl GuardedOuter {
    /// Of the channels whose laws are those of `group`; a law is given whether they fly.
    pub const fn in_group(mut self, group: Channel) -> Self {
        self.memory.active_command.group = group;
        self
    }

    pub fn new(made: Made<dyn OuterLaw>, route: Route, rig: &Rig) -> Self {
        let memory = OuterMemory {
            route,
            rig: *rig,
            active_command: ActiveCommand::new(rig),
            signals: made.signals,
            hold_ticks: ticks(HOLD_S, rig),
            last: None,
        };
        Self { made, memory }
    }

    /// With the references of another route.
    pub fn along(mut self, route: Route) -> Self {
        self.memory.route = route;
        self
    }

    /// Writes the setpoint of a tick; false, and nothing is written, if the state is of another tick.
    pub fn tick_into(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &mut Setpoint,
    ) -> bool {
        if state.tick != tick {
            return false;
        }
        setpoint.reference = (self.memory.route)(tick, &state.content);
        self.memory.tick(&mut *self.made.law, tick, state, setpoint);
        true
    }

    pub fn tick(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        let mut setpoint = Setpoint::default();
        self.tick_into(tick, state, &mut setpoint)
            .then_some(setpoint)
    }

    pub fn rehearse(&mut self, tick: u64, state: &Stamped<State>) -> Option<Setpoint> {
        if state.tick != tick {
            return None;
        }
        self.on_copies(|memory, law| {
            let mut setpoint = Setpoint {
                reference: (memory.route)(tick, &state.content),
                ..Setpoint::default()
            };
            memory.tick(law, tick, state, &mut setpoint);
            setpoint
        })
    }
}

saved_fields!(OuterMemory: last);

impl OuterMemory {
    /// Completes a setpoint that has its reference.
    fn tick(
        &mut self,
        law: &mut dyn OuterLaw,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &mut Setpoint,
    ) {
        let (given, state) = (self.active_command.of(state), &state.content);
        setpoint.telemetry.forget(self.signals);
        let input = OuterInput {
            tick,
            given_age: given.age(tick),
            measured: state.measured,
            reference: setpoint.reference,
            given: given.content,
        };
        let wanted = law.tick(&input, &mut setpoint.telemetry);
        setpoint.telemetry.truncate(self.signals);
        write_setpoint(&wanted, Mode::Fresh, setpoint);
        if setpoint.plausible() {
            self.last = Some((tick, wanted));
            return;
        }
        let safe = match self.last {
            Some((answered, wanted)) if tick - answered <= self.hold_ticks => wanted,
            Some((_, wanted)) => level(&self.rig, wanted.attitude_rad[2]),
            None => level(&self.rig, state.measured.attitude_rad[2]),
        };
        write_setpoint(&safe, Mode::NotFinite, setpoint);
    }
}

fn write_setpoint(wanted: &Desired, mode: Mode, setpoint: &mut Setpoint) {
    setpoint.thrust_n = not_negative(wanted.thrust_n);
    setpoint.attitude_rad = wanted.attitude_rad;
    setpoint.attitude_rate_rad_s = wanted.attitude_rate_rad_s;
    setpoint.attitude_acceleration_rad_s2 = wanted.attitude_acceleration_rad_s2;
    setpoint.limited = wanted.limited;
    setpoint.mode = mode as u64;
}

/// The inner loop.
///
/// | input | missing for up to 100 ms: `Held` | longer, or never there: `Fallback` | for more than 1 s: `Idle` |
/// |---|---|---|---|
/// | setpoint | the last one, rates included | level at the last yaw setpoint, hover thrust; the reference rests here | as before |
/// | state | zero torque, last thrust | zero torque, hover thrust | no thrust, and the mixer idles the rotors |
///
/// After a second without a state the attitude is unknown: thrust then does more harm than none. When the state comes
/// back, the loop flies again. The law is called in every tick all the same: without a state its clocks run on, and its
/// output is not used. An output that is not finite, or that no airframe can produce, counts like a missing state:
/// `NotFinite`.
#[derive(Clone, Copy)]
pub struct InnerMemory {
    rig: Rig,
    active_command: ActiveCommand,
    signals: usize,
    hold_ticks: u64,
    /// Ticks of [`BLIND_S`].
    blind_ticks: u64,
    first_tick: Option<u64>,
    /// Tick of the newest state that was taken in its own tick.
    measured_at: Option<u64>,
    /// Tick of the last output that could be used.
    answered_at: Option<u64>,
    /// Thrust of the last tick [N].
    thrust_n: f64,
    /// Position and yaw of the vehicle when the states began, or began again.
    began: Reference,
    /// Position of the vehicle when the setpoint had been missing for too long.
    stays: Option<Reference>,
}

impl GuardedInner {
    /// As [`InnerLaw::start`].
    pub fn start(&mut self, comes_by_the_clock: bool) -> Result<(), Refused> {
        self.made.law.start(comes_by_the_clock)
    }

    /// Of the channels whose laws are those of `group`; a law is given whether they fly.
    pub const fn in_group(mut self, group: Channel) -> Self {
        self.memory.active_command.group = group;
        self
    }

    pub fn new(made: Made<dyn InnerLaw>, rig: &Rig) -> Self {
        let memory = InnerMemory {
            rig: *rig,
            active_command: ActiveCommand::new(rig),
            signals: made.signals,
            hold_ticks: ticks(HOLD_S, rig),
            blind_ticks: ticks(BLIND_S, rig),
            first_tick: None,
            measured_at: None,
            answered_at: None,
            thrust_n: 0.0,
            began: Reference::default(),
            stays: None,
        };
        Self { made, memory }
    }
}

saved_fields!(InnerMemory: first_tick, measured_at, answered_at, thrust_n, began, stays);

impl InnerMemory {
    fn tick(
        &mut self,
        law: &mut dyn InnerLaw,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        wrench: &mut Wrench,
    ) {
        let given = self.active_command.of(state);
        let is_fresh = state.tick == tick;
        let is_lost = self.is_past(self.measured_at, tick);
        let first_tick = *self.first_tick.get_or_insert(tick);
        let seen_at = self.measured_at.unwrap_or(first_tick);
        let is_blind = !is_fresh && tick.saturating_sub(seen_at) > self.blind_ticks;
        if is_fresh {
            if is_lost {
                self.began = rest_at(&state.content, state.content.measured.attitude_rad[2]);
            }
            self.measured_at = Some(tick);
        }
        let signals = self.signals;
        wrench.telemetry.forget(signals);
        let mut input = InnerInput {
            tick,
            // A state of a later tick is not fresh either.
            measured_age: state.age(tick).max(u64::from(!is_fresh)),
            wanted_age: setpoint.age(tick),
            given_age: given.age(tick),
            measured: state.content.measured,
            wanted: Desired::default(),
            reference: Reference::default(),
            given: given.content,
        };
        let mode = self.order(tick, state, setpoint, &mut input);
        let demand = law.tick(&input, &mut wrench.telemetry);
        wrench.telemetry.truncate(signals);
        write_wrench(&demand, mode, wrench);
        let is_usable = wrench.plausible();
        match (is_usable, is_fresh) {
            _ if is_blind => write_wrench(&WrenchSetpoint::default(), Mode::Idle, wrench),
            (true, true) => {}
            (true, false) if is_lost => self.coast(true, Mode::Fallback, wrench),
            (true, false) => self.coast(false, Mode::Held, wrench),
            (false, _) => {
                let is_long = is_lost || self.is_past(self.answered_at, tick);
                self.coast(is_long, Mode::NotFinite, wrench);
            }
        }
        if is_usable {
            self.answered_at = Some(tick);
        }
        self.thrust_n = wrench.thrust_n;
    }

    /// Whether something was longer ago than it is held for, or never was.
    fn is_past(&self, at: Option<u64>, tick: u64) -> bool {
        at.is_none_or(|at| tick.saturating_sub(at) > self.hold_ticks)
    }

    /// Writes the setpoint and reference to follow in this tick.
    fn order(
        &mut self,
        tick: u64,
        state: &Stamped<State>,
        setpoint: &Stamped<Setpoint>,
        input: &mut InnerInput,
    ) -> Mode {
        let content = &setpoint.content;
        if setpoint.age(tick) <= self.hold_ticks {
            self.stays = None;
            input.wanted = content.desired();
            input.reference = content.reference;
            return if setpoint.tick == tick {
                Mode::Fresh
            } else {
                Mode::Held
            };
        }
        let yaw = if setpoint.tick == NO_TICK {
            self.began.yaw_rad
        } else {
            content.attitude_rad[2]
        };
        let stays = self.stays.get_or_insert_with(|| match state.tick {
            NO_TICK => self.began,
            _ => rest_at(&state.content, yaw),
        });
        input.reference = *stays;
        input.wanted = level(&self.rig, yaw);
        Mode::Fallback
    }

    /// No torque and the last thrust, or hover thrust if that is too old.
    fn coast(&self, is_lost: bool, mode: Mode, wrench: &mut Wrench) {
        let thrust_n = if is_lost {
            hover_thrust_n(&self.rig)
        } else {
            self.thrust_n
        };
        let demand = WrenchSetpoint {
            thrust_n,
            torque_b_nm: [0.0; 3],
        };
        write_wrench(&demand, mode, wrench);
    }
}

/// At rest where the vehicle is.
fn rest_at(state: &State, yaw_rad: f64) -> Reference {
    Reference {
        position_w_m: state.measured.position_w_m,
        yaw_rad,
        ..Reference::default()
    }
}

fn write_wrench(demand: &WrenchSetpoint, mode: Mode, wrench: &mut Wrench) {
    wrench.thrust_n = not_negative(demand.thrust_n);
    wrench.torque_b_nm = demand.torque_b_nm;
    wrench.mode = mode as u64;
}

/// Ticks for which the last wrench is held at least, and time if that is longer [s].
const HELD_TICKS: u64 = 3;
const HELD_S: f64 = 0.003;

/// Age of the wrench at which the rotors go to idle [s].
const IDLE_AFTER_S: f64 = 0.050;

/// The mixer's stage: what the rotors can do, by the nominal model, and how long a wrench is held.
///
/// Its reaction depends only on the age of the wrench in ticks. There is no state that could go stale or would have to
/// be restored after a restart:
///
/// ```text
///   age 0            Fresh     mixed as demanded
///   1 to 3 ticks     Held      the same wrench again
///   then             Fallback  its thrust, and no torque: an old torque would roll the vehicle over
///   from 50 ms on    Idle      every rotor at its smallest speed; likewise before the first wrench
/// ```
///
/// Up to 1 kHz, three ticks are three ticks. Above 1 kHz a wrench is held for 3 ms, because a stall of the machine does
/// not depend on the tick. It is never held for more than half of the way to idle, so that each mode has its turn even
/// at 50 Hz.
///
/// The mode gives the age of the *mixer's* input. A wrench that the inner loop made in a mode of its own is mixed like
/// any other, with one exception: a wrench marked idle idles the rotors. An output that is not finite is replaced by
/// the thrust demanded and no torque: `NotFinite`. Speeds beyond the rotors' range are brought to its ends.
#[derive(Clone, Copy)]
pub struct Rotors {
    signals: usize,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    /// Smallest and largest speed [rad/s].
    slowest: f64,
    fastest: f64,
    held_ticks: u64,
    idle_after_ticks: u64,
}

impl GuardedMixer {
    pub fn new(made: Made<dyn MixerLaw>, rig: &Rig) -> Self {
        let k = rig.airframe.k();
        let at_least_one = |time_s| ticks(time_s, rig).max(1);
        let idle_after_ticks = at_least_one(IDLE_AFTER_S);
        // From the thrust, as a mixer computes its speeds: the ends of the range are the same to the last bit.
        let speed = |f: f64| (f / k).sqrt();
        let memory = Rotors {
            signals: made.signals,
            allocation: Allocation::new(&rig.airframe),
            k,
            slowest: speed(rig.rotor.f_min(k)),
            fastest: speed(rig.rotor.f_max(k)),
            held_ticks: at_least_one(HELD_S)
                .max(HELD_TICKS)
                .min(idle_after_ticks / 2),
            idle_after_ticks,
        };
        Self { made, memory }
    }

    /// Every rotor at its smallest speed: the last message of a flight.
    pub fn idle(&self) -> RotorSpeeds {
        let mut speeds = RotorSpeeds {
            telemetry: Telemetry::unknown(self.memory.signals),
            ..RotorSpeeds::default()
        };
        self.memory.idle(&mut speeds);
        speeds
    }
}

saved_fields!(Rotors: );

impl Rotors {
    fn tick(
        &self,
        law: &mut dyn MixerLaw,
        tick: u64,
        wrench: &Stamped<Wrench>,
        speeds: &mut RotorSpeeds,
    ) {
        speeds.telemetry.forget(self.signals);
        let age = wrench.age(tick);
        let mut demand = WrenchSetpoint {
            thrust_n: wrench.content.thrust_n,
            torque_b_nm: wrench.content.torque_b_nm,
        };
        let is_idle = wrench.content.mode == Mode::Idle as u64;
        if is_idle || age >= self.idle_after_ticks {
            return self.idle(speeds);
        }
        let mode = if age == 0 {
            Mode::Fresh
        } else if age <= self.held_ticks {
            Mode::Held
        } else {
            demand.torque_b_nm = [0.0; 3];
            Mode::Fallback
        };
        let (speed, saturated) = law.tick(&MixerInput { tick, demand }, &mut speeds.telemetry);
        speeds.telemetry.truncate(self.signals);
        if speed.iter().all(|w| w.is_finite()) {
            let inside = speed.map(|w| w.clamp(self.slowest, self.fastest));
            self.write(inside, saturated || inside != speed, mode, speeds);
        } else {
            let wanted = (demand.thrust_n / ROTORS as f64 / self.k).sqrt();
            let speed = wanted.max(self.slowest).min(self.fastest);
            self.write([speed; ROTORS], true, Mode::NotFinite, speeds);
        }
    }

    /// Every rotor at its smallest speed. Nothing is demanded of idle rotors, so nothing saturates.
    fn idle(&self, speeds: &mut RotorSpeeds) {
        self.write([self.slowest; ROTORS], false, Mode::Idle, speeds);
    }

    fn write(&self, speed: [f64; ROTORS], saturated: bool, mode: Mode, speeds: &mut RotorSpeeds) {
        let f = Vector4::from(speed).map(|w| self.k * w * w);
        let (thrust_n, torque) = self.allocation.wrench(&f);
        speeds.speed_rad_s = speed;
        speeds.thrust_n = thrust_n;
        speeds.torque_b_nm = torque.into();
        speeds.saturated = u64::from(saturated);
        speeds.mode = mode as u64;
    }
}
