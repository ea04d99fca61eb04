//! Tests of the process runtime on shared memory.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

#[allow(dead_code, reason = "the tests of `ipc` use more of it")]
#[path = "../../ipc/tests/common/mod.rs"]
mod common;
mod delivery;
mod live_faults;
mod sessions;
