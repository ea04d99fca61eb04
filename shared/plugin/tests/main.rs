//! Tests of laws in shared libraries.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod in_rust;
mod libraries;
