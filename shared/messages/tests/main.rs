//! Tests of messages, parameters and frames.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod frames;
mod parameters;
mod plausible;
#[path = "../../reference/vectors.rs"]
mod reference;
mod vectors;
