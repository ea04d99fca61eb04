//! Tests of the control allocation.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[path = "../../shared/reference/vectors.rs"]
mod reference;
mod reference_vectors;
mod safety;
mod saturation;
