//! The torque of a flight against (19): does the law command it, and do the rotors produce it?
//!
//! (22) bounds the rate error e for a torque (19) that acts at once. In every flight it acts a tick later, so V may
//! rise; but no other torque than (19), late by the ticks that the state names, may drive the airframe. Together with
//! the exact model (B), that is the equation of e (docs/theorem.md).

use control_api::guard::hover_thrust_n;
use control_api::law::Rig;
use messages::content::{Mode, RotorSpeeds, Setpoint, Stamped, State, Wrench};
use messages::monitor::Cause;
use messages::parameters::Parameter;
use nalgebra::Vector3;

use crate::adaptation::Evidence;
use crate::gains::Gains;
use crate::laws::{adaptive, adaptive_residual};
use crate::torque_law::TorqueLaw;

/// Share of a torque and of a rate error that rounding may take, and what it may take of those that are 0.
const ROUNDING: f64 = 1e-9;
const ROUNDING_OF_ZERO: f64 = 1e-12;
/// Times the bandwidth of a command filter after which it has forgotten its state: of that, 1e-18 is left.
const FORGETS: f64 = 46.0;
/// Ticks kept: the longest delay of a command, 10 ms, is 80 ticks at 8 kHz.
pub const KEPT: usize = 128;
/// Wrenches kept: a fault may let one act that is as many ticks old.
const WRENCHES: usize = 1024;

#[derive(Clone, Debug)]
pub struct TorqueCheck {
    law: TorqueLaw,
    /// Scale of a rotor's torque [N m]: weight times arm length.
    size_nm: f64,
    period_s: f64,
    /// First tick from which on the law's command filter is known. If the failsafe has replaced a setpoint, or a tick was not
    /// watched, that is when the filter has forgotten it.
    followed_from: u64,
    /// Ticks after which the slowest command filter has forgotten its state.
    forgets_ticks: u64,
    /// The torque of each of the newest wrenches [N m], at its tick's place.
    wrenches: Vec<Option<(u64, Vector3<f64>)>>,
    /// An older wrench that the rotors gave instead of their command's [N m]: a frozen one stays for long.
    held: Option<Vector3<f64>>,
    /// Each of the newest rotor commands, at its tick's place.
    commands: [Option<(u64, Command)>; KEPT],
    /// The command in force at each of the newest states, at its tick's place.
    in_force: [Option<InForce>; KEPT],
}

/// A rotor command as the mixer made it.
#[derive(Clone, Copy, Debug)]
struct Command {
    mode: Mode,
    torque_nm: Vector3<f64>,
    /// Its torque need not be that of a wrench kept here.
    is_apart: bool,
}

/// A command in force from a state on.
#[derive(Clone, Copy, Debug)]
struct InForce {
    tick: u64,
    /// Torque of its wrench [N m].
    wanted: Option<Vector3<f64>>,
    /// Why rotors that follow it may give another torque; none if that is not known.
    cause: Option<Cause>,
    /// Ticks that commands take to the motors from this state on.
    delay_ticks: u64,
    motors_lag: bool,
}

/// Results of a tick; none where the torque could not be compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TorqueSeen {
    /// Whether the wrench is (19) of its inputs, and its telemetry the rate error.
    pub law: Option<bool>,
    /// Torque of the rotors in the last tick.
    pub rotors: Option<RotorTorque>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotorTorque {
    /// The torque of the wrench of the command in force.
    OfCommand,
    Other(Cause),
}

impl TorqueCheck {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let slowest_rad_s = gains.command_filter_rad_s.into_iter().reduce(f64::min);
        let forgets_s = slowest_rad_s.map_or(0.0, |w_f| FORGETS / w_f);
        Self {
            law: TorqueLaw::new(rig, gains),
            size_nm: hover_thrust_n(rig) * rig.airframe.get(Parameter::ArmLength),
            period_s: rig.period_s,
            followed_from: 0,
            forgets_ticks: (forgets_s / rig.period_s).ceil() as u64,
            wrenches: vec![None; WRENCHES],
            held: None,
            commands: [None; KEPT],
            in_force: [None; KEPT],
        }
    }

    /// Takes that the law's command filter is not known at a tick.
    pub const fn lose(&mut self, tick: u64) {
        self.followed_from = tick.saturating_add(self.forgets_ticks);
    }

    /// Takes the command of a tick.
    pub fn command(&mut self, tick: u64, command: &RotorSpeeds) {
        let command = Mode::from_wire(command.mode).map(|mode| Command {
            mode,
            torque_nm: command.torque_b_nm.into(),
            is_apart: match mode {
                Mode::Fresh => command.saturated == 1,
                Mode::NotFinite => false,
                _ => true,
            },
        });
        self.commands[tick as usize % KEPT] = command.map(|command| (tick, command));
    }

    /// Takes over the commands from before the law began anew: a message fault may still deliver them.
    pub fn take_over(&mut self, before: &Self) {
        self.commands = before.commands;
        for (_, command) in self.commands.iter_mut().flatten() {
            command.is_apart |= command.mode != Mode::NotFinite;
        }
        self.held = before.held;
    }

    /// Takes the wrench of a tick with its inputs. `newest` is the tick of the measurement before, and `evidence` has
    /// that of this tick, if the state is of this tick.
    pub fn take(
        &mut self,
        tick: u64,
        inputs: (&Stamped<State>, &Stamped<Setpoint>),
        wrench: &Wrench,
        newest: Option<u64>,
        evidence: &mut Evidence,
    ) -> TorqueSeen {
        let (state, setpoint) = inputs;
        let measured = (state.tick == tick).then_some(&state.content.measured);
        if setpoint.age(tick) > self.law.attitude.hold_ticks() {
            self.lose(tick);
        }
        let wanted = setpoint.content.desired();
        self.law.attitude.begin(tick, &wanted, newest, measured);
        let wrench_nm = Vector3::from(wrench.torque_b_nm);
        let is_followed = self.followed_from <= tick;
        let law = measured.filter(|_| is_followed).map(|measured| {
            let theta = Vector3::from(adaptive::estimate(&wrench.telemetry));
            let residual = adaptive_residual::residual(&wrench.telemetry).into();
            let (tau, e) = self.law.torque(tick, measured, &theta, &residual, evidence);
            let e_published = Vector3::from(adaptive::rate_error(&wrench.telemetry));
            is_near(&tau, &wrench_nm, tau.amax()) && is_near(&e, &e_published, e.amax())
        });
        self.law.attitude.end(tick);
        let rotors = self.rotors(tick, evidence);
        if measured.is_some() {
            self.in_force[tick as usize % KEPT] = Some(self.in_force_at(tick, &state.content));
        }
        self.wrenches[tick as usize % WRENCHES] = Some((tick, wrench_nm));
        TorqueSeen { law, rotors }
    }

    fn in_force_at(&self, tick: u64, state: &State) -> InForce {
        let command = of_tick(&self.commands, state.command_tick);
        let is_saturated = state.command_saturated == 1;
        let delay_s = state.truth.get(Parameter::CommandDelay);
        InForce {
            tick,
            wanted: of_tick(&self.wrenches, state.command_tick),
            cause: command.map(|command| match command.mode {
                // No fault of the rig makes a mixer's output one that is no number.
                Mode::NotFinite => Cause::Unexplained,
                _ if is_saturated => Cause::Saturation,
                // The rotors idle if no command comes for long.
                Mode::Fresh if state.deadline_miss_run == 0 => Cause::Unexplained,
                _ => Cause::StaleInput,
            }),
            delay_ticks: (delay_s / self.period_s).round() as u64,
            motors_lag: state.truth.get(Parameter::MotorTimeConstant) > 0.0,
        }
    }

    fn rotors(&mut self, tick: u64, evidence: &Evidence) -> Option<RotorTorque> {
        let given = evidence.at(tick)?.last.tau_m;
        let in_force = |tick: u64| {
            let command = self.in_force[tick as usize % KEPT];
            command.filter(|command| command.tick == tick)
        };
        let newest = in_force(tick.checked_sub(1)?)?;
        let acting = in_force((tick - 1).checked_sub(newest.delay_ticks)?)?;
        let is_given = |torque: &Vector3<f64>| is_near(torque, &given, self.size_nm);
        let older = self.wrenches.iter().flatten().map(|(_, torque)| torque);
        let apart = self.commands.iter().flatten().map(|(_, command)| command);
        let is_apart = || {
            let mut apart = apart.filter(|command| command.is_apart);
            acting.cause == Some(Cause::Unexplained)
                && apart.any(|command| is_given(&command.torque_nm))
        };
        Some(if newest.wanted.as_ref().is_some_and(is_given) {
            RotorTorque::OfCommand
        } else if newest.motors_lag {
            RotorTorque::Other(Cause::MotorLag)
        } else if is_given(&acting.wanted?) {
            RotorTorque::Other(Cause::Delay)
        } else if older.chain(&self.held).any(is_given) || is_apart() {
            self.held = Some(given);
            RotorTorque::Other(Cause::StaleInput)
        } else {
            RotorTorque::Other(acting.cause?)
        })
    }
}

fn of_tick<T: Copy>(kept: &[Option<(u64, T)>], tick: u64) -> Option<T> {
    let of_tick = kept[tick as usize % kept.len()].filter(|(of_tick, _)| *of_tick == tick);
    of_tick.map(|(_, value)| value)
}

fn is_near(a: &Vector3<f64>, b: &Vector3<f64>, size: f64) -> bool {
    (a - b).amax() <= ROUNDING * size + ROUNDING_OF_ZERO
}
