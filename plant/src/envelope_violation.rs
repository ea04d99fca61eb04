//! How a flight leaves the envelope that the plant sees to.

use thiserror::Error;

/// The airframe hit the ground as no landing does.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error(
    "the flight left its envelope: at tick {tick} it crashed, at {speed_m_s:.2} m/s and tilted by {:.0} degrees; \
     a landing is at most {speed_max_m_s} m/s and {:.0} degrees",
    tilt_rad.to_degrees(), tilt_max_rad.to_degrees()
)]
pub struct Crash {
    pub tick: u64,
    /// Fastest approach of a part that touched [m/s].
    pub speed_m_s: f64,
    pub tilt_rad: f64,
    pub speed_max_m_s: f64,
    pub tilt_max_rad: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum EnvelopeViolation {
    /// A position, velocity, attitude or rate is infinite or not a number.
    #[error("the flight diverged: at tick {tick} the state is no longer finite")]
    NotFinite { tick: u64 },
    /// The airframe hit the ground as no landing does.
    #[error(transparent)]
    Crash(Crash),
    /// The airframe is tilted beyond [`crate::PlantSettings::tilt_max_rad`].
    #[error(
        "the flight left its envelope: at tick {tick} the tilt is {:.1} degrees, allowed are {:.1} \
         (flight.tilt_max_rad = {tilt_max_rad})",
        tilt_rad.to_degrees(), tilt_max_rad.to_degrees()
    )]
    Tilt {
        tick: u64,
        /// Angle between body z and the vertical [rad].
        tilt_rad: f64,
        tilt_max_rad: f64,
    },
}
