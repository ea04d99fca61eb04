//! The wire: iceoryx2 ports of an instance, with every limit explicit.
//!
//! This is the only place that names the middleware's services. Ports are made before a loop is armed. After that, a
//! send costs one loan and a receive costs one copy.

mod bells;
mod board;
pub mod clock;
mod doorbell;
pub mod error;
pub mod instance;
mod ports;
mod relay;
mod swaps;
pub mod sys;

use std::time::Duration;

use iceoryx2::node::CleanupState;
use iceoryx2::prelude::{
    AttributeSpecifier, AttributeVerifier, LogLevel, Node, NodeBuilder, ServiceName, SignalHandlingMode, ipc,
    set_log_level,
};
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};

pub use board::{Board, BoardReader};
pub use doorbell::{Bell, Doorbell, Owner};
pub use ports::{Receiver, Sender};
pub use relay::{OBSERVED, OBSERVERS, Relay};
pub use swaps::{SwapAnswer, SwapCall, SwapClient, SwapOrder, SwapServer, Verdict};

use crate::error::Error;
use crate::instance::{Instance, Lock};
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::topic::Topic;

/// Samples that the loops keep of a topic: the newest.
pub const LATEST: usize = 1;
/// Samples that the recorder keeps of a topic: four seconds at 1 kHz.
pub const DEEP: usize = 4096;
/// Processes that may hold a service open: five roles, and observers.
const NODES: usize = 24;

/// A process's access to an instance's shared memory.
#[derive(Debug)]
pub struct Wire {
    node: Node<ipc::Service>,
    instance: Instance,
    bells: bells::BellFile,
    /// What dead processes of the instance left behind, and was removed.
    pub cleaned: u64,
    // Last: nobody takes the shared memory away while a port of this process is in it.
    _in_use: Lock,
}

impl Wire {
    /// Removes what dead processes of the instance left, then joins it.
    ///
    /// # Errors
    /// [`Error::RootPath`], [`Error::Wire`].
    pub fn open(instance: &Instance) -> Result<Self, Error> {
        // What goes wrong comes back as an error; the middleware's own prints would repeat it.
        set_log_level(LogLevel::Fatal);
        let in_use = instance.enter()?;
        let node = NodeBuilder::new()
            .config(&instance.config()?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| Error::wire(format!("cannot join instance `{}`", instance.name()), e))?;
        let CleanupState { cleanups, .. } = node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
        let bells = bells::BellFile::join(instance)?;
        Ok(Self { node, instance: instance.clone(), bells, cleaned: cleanups, _in_use: in_use })
    }

    /// The instance.
    #[must_use]
    pub const fn instance(&self) -> &Instance {
        &self.instance
    }

    /// Shared memory that an instance takes [bytes]: twice that of the topics, to cover everything else, and that of
    /// the observers' topics.
    #[must_use]
    pub fn needed_bytes() -> u64 {
        fn loops<C: Topic>() -> u64 {
            ports::slot_bytes::<C>(C::SUBSCRIBERS, DEEP)
        }
        fn observers<C: Topic>() -> u64 {
            ports::slot_bytes::<C>(OBSERVERS, OBSERVED)
        }
        let topics =
            loops::<State>() + loops::<Setpoint>() + loops::<Wrench>() + loops::<RotorSpeeds>() + loops::<SwapRecord>();
        let observed = observers::<State>()
            + observers::<Setpoint>()
            + observers::<Wrench>()
            + observers::<RotorSpeeds>()
            + observers::<SwapRecord>();
        2 * topics + observed
    }

    fn service_name(&self, name: &str) -> Result<ServiceName, Error> {
        let name = format!("ironbird/{}/{name}", self.instance.name());
        ServiceName::new(&name).map_err(|e| Error::wire(format!("cannot name the service {name}"), e))
    }
}

/// Why a service was not opened: another build made it differently, or it is only out of reach.
///
/// The middleware has an error type per kind of service; the names of what differs are the same in all of them.
fn not_opened(what: String, error: impl std::fmt::Debug) -> Error {
    let reason = format!("{error:?}");
    if ["Incompatible", "DoesNotSupport", "VersionMismatch"].iter().any(|differs| reason.contains(differs)) {
        Error::Incompatible { what, reason }
    } else {
        Error::Wire { what: format!("cannot open {what}"), reason }
    }
}

/// The attribute of a service that carries the layout of its payload.
fn layout_attribute(fingerprint: u64) -> Option<(AttributeKey, AttributeValue)> {
    let value = format!("{fingerprint:016x}");
    Some((AttributeKey::try_from("layout").ok()?, AttributeValue::try_from(value.as_str()).ok()?))
}

/// Demands a layout of a service that exists, and gives it to one that is created.
fn layout_verifier(fingerprint: u64) -> Result<AttributeVerifier, Error> {
    layout_attribute(fingerprint)
        .and_then(|(key, value)| AttributeVerifier::new().require(&key, &value).ok())
        .ok_or_else(|| Error::wire("cannot describe a message layout", fingerprint))
}

/// Gives a layout to a service that is created.
fn layout_specifier(fingerprint: u64) -> Result<AttributeSpecifier, Error> {
    layout_attribute(fingerprint)
        .and_then(|(key, value)| AttributeSpecifier::new().define(&key, &value).ok())
        .ok_or_else(|| Error::wire("cannot describe a message layout", fingerprint))
}
