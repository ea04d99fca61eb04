//! Sensors: gyro and accelerometer with noise, bias and drift, and a receiver of position and velocity.
//!
//! All of it goes beyond the paper, whose sensors are exact; nominally they are exact here too, bit by bit. White noise
//! of a density n has the standard deviation n/sqrt(T) per sample, so that what a filter makes of it does not depend
//! on T. The attitude has no sensor of its own and is exact.
//!
//! A fix of the receiver is taken at its tick and arrives `position_delay_s` later; until the next one arrives it is what
//! is shown. Its errors are drawn for the tick at which it was taken. Nominally there is a fix in every tick, exact and
//! at once.

use std::collections::VecDeque;

use messages::parameters::{Airframe, Parameter};
use nalgebra::Vector3;

use crate::noise::Stream;
use crate::rigid_body::RigidBody;

#[derive(Clone, Debug)]
pub struct Sensors {
    period_s: f64,
    seed: u64,
    tick: u64,
    /// What the gyro's bias has walked since the drift was switched on [rad/s].
    drift: Vector3<f64>,
    positioning: Positioning,
}

impl Sensors {
    /// Those of a flight of `airframe` that begins with `body`; `period_s` is T [s].
    pub fn new(period_s: f64, seed: u64, airframe: &Airframe, body: &RigidBody) -> Self {
        let positioning = Positioning::new(period_s, airframe, body);
        Self {
            period_s,
            seed,
            tick: 0,
            drift: Vector3::zeros(),
            positioning,
        }
    }

    /// Goes on to the next tick, to which the body has come under these parameters.
    pub fn advance(&mut self, airframe: &Airframe, body: &RigidBody) {
        let walk = airframe.get(Parameter::GyroDrift);
        self.drift = if walk > 0.0 {
            self.drift
                + Stream::GyroDrift.normal(self.seed, self.tick) * (walk * self.period_s.sqrt())
        } else {
            Vector3::zeros()
        };
        self.tick += 1;
        self.positioning.take(self.tick, body);
    }

    pub fn tune(&mut self, airframe: &Airframe) {
        self.positioning.tune(airframe);
    }

    /// Settles, once the parameters of the tick are known, which fix is shown in it.
    pub fn settle(&mut self) {
        self.positioning.settle();
    }

    /// Body rates [rad/s] as the gyro shows `nu2` [rad/s].
    pub fn rates(&self, airframe: &Airframe, nu2: &Vector3<f64>) -> Vector3<f64> {
        if !Airframe::gyro_errs(airframe.values()) {
            return *nu2;
        }
        let (per_sample, density) = (
            airframe.gyro_noise_rad_s(),
            airframe.get(Parameter::GyroNoiseDensity),
        );
        let sigma = (per_sample * per_sample + density * density / self.period_s).sqrt();
        let bias = Vector3::repeat(airframe.get(Parameter::GyroBias)) + self.drift;
        nu2 + bias + self.white(Stream::Gyro, sigma)
    }

    /// Specific force [m/s^2] as the accelerometer shows `force` [m/s^2], body frame.
    pub fn specific_force(&self, airframe: &Airframe, force: &Vector3<f64>) -> Vector3<f64> {
        let sigma = airframe.get(Parameter::AccelerometerNoise) / self.period_s.sqrt();
        let bias = Vector3::repeat(airframe.get(Parameter::AccelerometerBias));
        force + bias + self.white(Stream::Accelerometer, sigma)
    }

    /// Position [m] and velocity [m/s], world frame, of the newest fix that has arrived.
    pub fn fix(&self, airframe: &Airframe) -> (Vector3<f64>, Vector3<f64>) {
        self.positioning.shown(airframe, self.seed)
    }

    fn white(&self, stream: Stream, sigma: f64) -> Vector3<f64> {
        if sigma > 0.0 {
            stream.normal(self.seed, self.tick) * sigma
        } else {
            Vector3::zeros()
        }
    }
}

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
struct Positioning {
    period_s: f64,
    /// The last second, a fix per tick, the newest last; before the flight the body stood where it begins.
    on_their_way: VecDeque<Fix>,
    arrived: Fix,
    /// Age of a fix when it arrives, and how often there is one, in ticks.
    age: usize,
    every: u64,
}

impl Positioning {
    /// A receiver that knows where the flight of an airframe begins; `period_s` is T [s].
    fn new(period_s: f64, airframe: &Airframe, body: &RigidBody) -> Self {
        let start = Fix::of(0, body);
        let ticks = (LONGEST_S / period_s).round() as usize;
        let mut receiver = Self {
            period_s,
            on_their_way: vec![start; ticks + 1].into(),
            arrived: start,
            age: 0,
            every: 1,
        };
        receiver.tune(airframe);
        receiver
    }

    fn tune(&mut self, airframe: &Airframe) {
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
    fn take(&mut self, tick: u64, body: &RigidBody) {
        self.on_their_way.pop_front();
        self.on_their_way.push_back(Fix::of(tick, body));
    }

    /// Settles which fix is shown at the tick of the newest.
    fn settle(&mut self) {
        let due = self.on_their_way[self.on_their_way.len() - 1 - self.age];
        // Spares the usual tick a division.
        if self.every == 1 || due.tick.is_multiple_of(self.every) {
            self.arrived = due;
        }
    }

    /// Position [m] and velocity [m/s], world frame, with the errors of the fix.
    fn shown(&self, airframe: &Airframe, seed: u64) -> (Vector3<f64>, Vector3<f64>) {
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
