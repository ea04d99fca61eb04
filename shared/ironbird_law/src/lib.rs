//! A law that is built outside of the rig: the C interface, and the same in safe Rust.
//!
//! In Rust a law is a type with [`Law`] and the trait of its role, and one line that exports it:
//!
//! ```
//! use ironbird_law::{WrenchSetpoint, Description, Inner, InnerInput, InnerLaw, Law, Refused, Rig, Settings, Telemetry};
//!
//! #[derive(Clone)]
//! struct Level;
//!
//! impl Law for Level {
//!     type Role = Inner;
//!     const DESCRIPTION: Description = Description {
//!         name: "level",
//!         version: "1",
//!         summary: "asks for the thrust wanted and no torque",
//!         ..Description::EMPTY
//!     };
//!
//!     fn new(_: &Rig, _: &Settings) -> Result<Self, Refused> {
//!         Ok(Self)
//!     }
//! }
//!
//! impl InnerLaw for Level {
//!     fn tick(&mut self, input: &InnerInput, _: &mut Telemetry) -> WrenchSetpoint {
//!         WrenchSetpoint { thrust_n: input.wanted.thrust_n, torque_b_nm: [0.0; 3] }
//!     }
//! }
//!
//! ironbird_law::export!(Level);
//! ```
//!
//! Such a crate has `crate-type = ["cdylib"]`. A panic in `new` is a refusal with its text; a panic in a tick prints its
//! text and ends the process, because it must not unwind into the rig. This crate depends on nothing: `ironbird new law`
//! copies it beside the new law.

#![warn(missing_docs)]

pub mod abi;
mod border;
mod law;

pub use abi::{
    IronbirdAirframe as Airframe, IronbirdDemand as WrenchSetpoint, IronbirdGiven as Given,
    IronbirdInnerInput as InnerInput, IronbirdMeasured as Measured,
    IronbirdMixerInput as MixerInput, IronbirdOuterInput as OuterInput,
    IronbirdReference as Reference, IronbirdRig as Rig, IronbirdRotorSpeeds as RotorSpeeds,
    IronbirdTelemetry as Telemetry, IronbirdWanted as Desired,
};
pub use border::{Inner, Mixer, Outer};
#[doc(hidden)]
pub use border::{kept, table, text, write_refusal};
pub use law::*;

/// Exports a law, a type with [`Law`], from a library. One per library.
#[macro_export]
macro_rules! export {
    ($law:ty) => {
        #[unsafe(no_mangle)]
        extern "C" fn ironbird_law() -> *const $crate::abi::IronbirdLaw {
            static TABLE: ::std::sync::OnceLock<$crate::abi::IronbirdLaw> =
                ::std::sync::OnceLock::new();
            TABLE.get_or_init($crate::table::<$law>)
        }
    };
}
