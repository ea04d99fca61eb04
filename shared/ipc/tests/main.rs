//! `ipc` over real shared memory: topics, blackboards, wake-up events, parameter changes, locks.
//!
//! Every test has its own root path and thus its own instance. The tests run in parallel with each other and with a
//! flight.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]
#![allow(unsafe_code, reason = "bits are flipped in memory")]

mod blackboards;
mod common;
mod forgeries;
#[path = "common/forgery.rs"]
mod forgery;
mod locks;
mod ownership;
mod parameter_requests;
mod topics;
mod wake_events;

use std::path::{Path, PathBuf};

use ipc::error::Error;
use ipc::instance::{Instance, SHARED_MEMORY};

use common::Site;

/// What another build has made is refused by name.
fn assert_incompatible<T>(result: Result<T, Error>, what: &str) {
    let error = result.map(drop).unwrap_err();
    assert!(matches!(error, Error::Incompatible { .. }), "{error}");
    assert!(error.to_string().contains(what), "{error}");
    assert!(error.remedy().unwrap().contains("ironbird clean"));
    assert_eq!(error.exit_code(), 5);
}

/// Names of topics and services that are in use, or have no place left, are refused.
fn assert_taken<T>(result: Result<T, Error>, what: &str) {
    let error = result.map(drop).unwrap_err();
    assert!(matches!(error, Error::Wire { .. }), "{error}");
    assert!(error.to_string().contains(what), "{error}");
}

/// The page of wake-up events in shared memory.
fn page(instance: &Instance) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{}wake_events", instance.prefix()))
}
