//! How a flight leaves the envelope that the plant sees to.

use thiserror::Error;

/// The flight left its envelope.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Departure {
    /// A position, velocity, attitude or rate is infinite or not a number.
    #[error("the flight diverged: at tick {tick} the state is no longer finite")]
    NotFinite {
        /// Tick at which it was seen.
        tick: u64,
    },
    /// The airframe is tilted beyond [`crate::PlantSettings::tilt_max_rad`].
    #[error(
        "the flight left its envelope: at tick {tick} the tilt is {:.1} degrees, allowed are {:.1}",
        tilt_rad.to_degrees(), tilt_max_rad.to_degrees()
    )]
    Tilt {
        /// Tick at which it was seen.
        tick: u64,
        /// Angle between body z and the vertical [rad].
        tilt_rad: f64,
        /// What is allowed [rad].
        tilt_max_rad: f64,
    },
}
