//! The wire over real shared memory: topics, boards, doorbells, swaps, locks.
//!
//! Every test has its own root path and thus its own instance. The tests run in parallel with each other and with a
//! flight.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod blackboards;
mod common;
mod damage;
mod doorbells;
mod forgeries;
mod locks;
mod ownership;
mod relays;
mod swaps;
mod topics;

use ::ipc::error::Error;
use iceoryx2::prelude::{Node, NodeBuilder, SignalHandlingMode, ipc};

use common::{EPOCH, EXPECTED, Site};

/// A node of the middleware without our manners.
fn node(site: &Site) -> Node<ipc::Service> {
    NodeBuilder::new()
        .config(&site.instance.config().unwrap())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
        .unwrap()
}

/// What another build has made must be refused as such, by name.
fn assert_incompatible<T>(result: Result<T, Error>, what: &str) {
    let error = result.map(drop).unwrap_err();
    assert!(matches!(error, Error::Incompatible { .. }), "{error}");
    assert!(error.to_string().contains(what), "{error}");
    assert!(error.remedy().unwrap().contains("ironbird clean"));
    assert_eq!(error.exit_code(), 5);
}
