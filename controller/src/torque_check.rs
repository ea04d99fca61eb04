//! The torque of a flight against (19): does the law command it, and do the rotors produce it?
//!
//! (22) bounds the rate error e for a torque (19) that acts at once. In every flight it acts a tick later, so V may
//! rise; but no other torque than (19), late by the ticks that the state names, may drive the airframe. Together with
//! the exact model (B), that is the equation of e (docs/theorem.md).

use control_api::guard::hover_thrust_n;
use control_api::law::Rig;
use messages::content::{Setpoint, Stamped, State, Wrench};
use messages::parameters::Parameter;
use nalgebra::Vector3;

use crate::adaptation::Evidence;
use crate::gains::Gains;
use crate::laws::{adaptive, adaptive_residual};
use crate::torque_law::TorqueLaw;

/// Share of a torque and of a rate error that rounding may take, and what it may take of those that are 0.
const ROUNDING: f64 = 1e-9;
const ROUNDING_OF_ZERO: f64 = 1e-12;
/// Wrenches kept: the longest delay of a command, 10 ms, is 80 ticks at 8 kHz.
const KEPT: usize = 128;

#[derive(Clone, Debug)]
pub struct TorqueCheck {
    law: TorqueLaw,
    /// Scale of a rotor's torque [N m]: weight times arm length.
    size_nm: f64,
    /// False once the failsafe has replaced a setpoint: the state of the law's command filter is then unknown.
    is_followed: bool,
    /// The torque of each of the newest wrenches [N m], at its tick's place.
    wrenches: [Option<(u64, Vector3<f64>)>; KEPT],
    /// Of the command in force at the state before: tick of that state, torque of its wrench.
    in_force: Option<(u64, Vector3<f64>)>,
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
    /// The torque of an older wrench: the mixer had no newer one.
    OfOlderWrench,
    Other,
}

impl TorqueCheck {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        Self {
            law: TorqueLaw::new(rig, gains),
            size_nm: hover_thrust_n(rig) * rig.airframe.get(Parameter::ArmLength),
            is_followed: true,
            wrenches: [None; KEPT],
            in_force: None,
        }
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
        let attitude = &mut self.law.attitude;
        self.is_followed &= setpoint.age(tick) <= attitude.hold_ticks();
        let wanted = setpoint.content.desired();
        attitude.begin(tick, &wanted, newest, measured);
        let wrench_nm = Vector3::from(wrench.torque_b_nm);
        let law = measured.filter(|_| self.is_followed).map(|measured| {
            let theta = Vector3::from(adaptive::estimate(&wrench.telemetry));
            let residual = adaptive_residual::residual(&wrench.telemetry).into();
            let (tau, e) = self.law.torque(tick, measured, &theta, &residual, evidence);
            let e_published = Vector3::from(adaptive::rate_error(&wrench.telemetry));
            is_near(&tau, &wrench_nm, tau.amax()) && is_near(&e, &e_published, e.amax())
        });
        self.law.attitude.end(tick);
        let rotors = self.rotors(tick, evidence);
        if measured.is_some() {
            let command_tick = state.content.command_tick;
            let of_command = self.wrenches[command_tick as usize % KEPT];
            let of_command = of_command.filter(|(of_tick, _)| *of_tick == command_tick);
            self.in_force = of_command.map(|(_, torque)| (tick, torque));
        }
        self.wrenches[tick as usize % KEPT] = Some((tick, wrench_nm));
        TorqueSeen { law, rotors }
    }

    fn rotors(&self, tick: u64, evidence: &Evidence) -> Option<RotorTorque> {
        let last = &evidence.at(tick)?.last;
        let (_, wanted) = self.in_force.filter(|(at, _)| at + 1 == tick)?;
        let is_given = |torque: &Vector3<f64>| is_near(torque, &last.tau_m, self.size_nm);
        let mut wrenches = self.wrenches.iter().flatten();
        Some(if is_given(&wanted) {
            RotorTorque::OfCommand
        } else if wrenches.any(|(_, torque)| is_given(torque)) {
            RotorTorque::OfOlderWrench
        } else {
            RotorTorque::Other
        })
    }
}

fn is_near(a: &Vector3<f64>, b: &Vector3<f64>, size: f64) -> bool {
    (a - b).amax() <= ROUNDING * size + ROUNDING_OF_ZERO
}
