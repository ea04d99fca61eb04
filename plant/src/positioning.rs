//! Positioning: position and velocity as a receiver reports them, in fixes that have an age.
//!
//! A fix is taken at its tick and arrives `position_delay_s` later; until the next one arrives it is what is shown. Its
//! errors are drawn for the tick at which it was taken. Nominally there is a fix in every tick, exact and at once.

use messages::parameters::{Airframe, Parameter};
use nalgebra::Vector3;

use crate::noise::Stream;
use crate::rigid_body::RigidBody;

/// The longest age of a fix [s], which is the range of `position_delay_s`.
const LONGEST_S: f64 = 1.0;

/// Where the airframe was at a tick.
#[derive(Clone, Copy, Debug)]
struct Fix {
    tick: u64,
    /// World frame [m].
    position: Vector3<f64>,
    /// World frame [m/s].
    velocity: Vector3<f64>,
}

impl Fix {
    const fn of(tick: u64, body: &RigidBody) -> Self {
        Self {
            tick,
            position: body.eta1,
            velocity: body.v,
        }
    }
}

/// The receiver, with the fixes that may still be on their way.
#[derive(Clone, Debug)]
pub struct Positioning {
    period_s: f64,
    /// The last second, a fix per tick, in a ring; before the flight the body stood where it begins.
    on_their_way: Vec<Fix>,
    newest: usize,
    arrived: Fix,
    /// Age of a fix when it arrives, and how often there is one, in ticks.
    age: usize,
    every: u64,
}

impl Positioning {
    /// A receiver that knows where the flight of an airframe begins; `period_s` is T [s].
    pub fn new(period_s: f64, airframe: &Airframe, body: &RigidBody) -> Self {
        let start = Fix::of(0, body);
        let ticks = (LONGEST_S / period_s).round() as usize;
        let on_their_way = vec![start; ticks + 1];
        let mut receiver = Self {
            period_s,
            on_their_way,
            newest: 0,
            arrived: start,
            age: 0,
            every: 1,
        };
        receiver.tune(airframe);
        receiver
    }

    /// Takes over delay and rate of the parameters.
    pub fn tune(&mut self, airframe: &Airframe) {
        let ticks = |time_s: f64| (time_s / self.period_s).round() as usize;
        let rate_hz = airframe.get(Parameter::PositionRate);
        let every = if rate_hz > 0.0 {
            ticks(1.0 / rate_hz).max(1) as u64
        } else {
            1
        };
        let age = ticks(airframe.get(Parameter::PositionDelay)).min(self.on_their_way.len() - 1);
        (self.age, self.every) = (age, every);
    }

    /// Takes the fix of the tick that the body has come to.
    pub fn take(&mut self, tick: u64, body: &RigidBody) {
        self.newest = if self.newest + 1 < self.on_their_way.len() {
            self.newest + 1
        } else {
            0
        };
        self.on_their_way[self.newest] = Fix::of(tick, body);
    }

    /// Settles which fix is shown at the tick of the newest.
    pub fn settle(&mut self) {
        let &mut Self {
            newest, age, every, ..
        } = self;
        let back = if age <= newest {
            0
        } else {
            self.on_their_way.len()
        };
        let due = self.on_their_way[newest + back - age];
        if every == 1 || due.tick.is_multiple_of(every) {
            self.arrived = due;
        }
    }

    /// Position [m] and velocity [m/s], world frame, with the errors of the fix.
    pub fn shown(&self, airframe: &Airframe, seed: u64) -> (Vector3<f64>, Vector3<f64>) {
        let Fix {
            tick,
            mut position,
            mut velocity,
        } = self.arrived;
        for (value, parameter, stream) in [
            (&mut position, Parameter::PositionNoise, Stream::Position),
            (&mut velocity, Parameter::VelocityNoise, Stream::Velocity),
        ] {
            let sigma = airframe.get(parameter);
            if sigma > 0.0 {
                *value += stream.normal(seed, tick) * sigma;
            }
        }
        (position, velocity)
    }
}
