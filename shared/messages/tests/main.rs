//! Tests of messages, parameters, frames and message faults.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod faults;
mod frames;
mod parameters;
#[path = "../../reference/vectors.rs"]
mod reference;
mod vectors;
