//! Tests of the control laws.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod flight;
mod laws;
mod laws_flights;
mod laws_recovery;
mod laws_settings;
mod laws_vectors;
mod settings;
mod spline;
mod stale;
mod theorem;
mod vectors;
