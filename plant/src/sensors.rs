//! Sensors: gyro and accelerometer with noise, bias and drift, and the receiver of [`crate::positioning`].
//!
//! All of it goes beyond the paper, whose sensors are exact; nominally they are exact here too, bit by bit. White noise
//! of a density n has the standard deviation n/sqrt(T) per sample, so that what a filter makes of it does not depend
//! on T. The attitude has no sensor of its own and is exact.

use messages::parameters::{Airframe, Parameter};
use nalgebra::Vector3;

use crate::noise::Stream;
use crate::positioning::Positioning;
use crate::rigid_body::RigidBody;

/// The sensors of an airframe, at a tick.
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
