//! Delay of commands on their way from the command hold to the motors, in whole ticks.
//!
//! What is in force in a tick acts `command_delay_s` later. The deadline verdicts know nothing of it: a
//! bus or a speed controller that is slow misses no deadline. Nominally there is none.

use std::collections::VecDeque;

use messages::content::ROTORS;
use messages::parameters::{Airframe, Parameter};

/// The longest delay [s], which is the range of `command_delay_s`.
const LONGEST_S: f64 = 0.01;

/// The commands that were in force last, of which the one that is old enough acts.
#[derive(Clone, Debug)]
pub struct CommandDelay {
    period_s: f64,
    /// Rotor speeds [rad/s], a set per tick, the newest last; before the flight all were those of hover.
    on_their_way: VecDeque<[f64; ROTORS]>,
    ticks: usize,
}

impl CommandDelay {
    /// The delay of an airframe whose rotors turn at `hover` [rad/s]; `period_s` is T [s].
    pub fn new(period_s: f64, airframe: &Airframe, hover: [f64; ROTORS]) -> Self {
        let longest = (LONGEST_S / period_s).round() as usize;
        let mut delay = Self {
            period_s,
            on_their_way: vec![hover; longest + 1].into(),
            ticks: 0,
        };
        delay.tune(airframe);
        delay
    }

    pub fn tune(&mut self, airframe: &Airframe) {
        let ticks = (airframe.get(Parameter::CommandDelay) / self.period_s).round() as usize;
        self.ticks = ticks.min(self.on_their_way.len() - 1);
    }

    /// Takes the speeds that are in force in the next tick [rad/s]. Call it for every tick.
    pub fn take(&mut self, speed: [f64; ROTORS]) {
        self.on_their_way.pop_front();
        self.on_their_way.push_back(speed);
    }

    /// The speeds that the motors are given in the tick of the newest [rad/s].
    pub fn acting(&self) -> [f64; ROTORS] {
        self.on_their_way[self.on_their_way.len() - 1 - self.ticks]
    }
}
