//! Tests of the airframe simulation.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod attitude;
mod batch;
mod ground;
mod physics;
mod ramps;
mod ranges;
mod reference_vectors;
mod sensors;
mod timing;
