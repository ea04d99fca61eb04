//! A law in Python, as the rig calls it: arrays in, numbers out, exceptions kept.
//!
//! The module `ironbird` flies such laws in a notebook, and the adapter in the rig's own processes.

#![warn(missing_docs)]

mod answer;
mod arrays;
mod inputs;
mod law;
mod look;
mod look_code;

pub use arrays::array;
pub use inputs::{Desired, Given, Measured, Reference, Rig};
pub use law::{Flying, PythonLaw, Raised};
pub use look::{Looked, SaidSetting, is_refusal, load};
