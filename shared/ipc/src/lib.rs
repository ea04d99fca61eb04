//! The wire: iceoryx2 ports of an instance, with every limit explicit.
//!
//! This is the only place that names the middleware's services. Ports are made before a loop is armed. After that, a
//! send costs one loan and a receive costs one copy, and both the check word of what is sent.

mod blackboard;
pub mod clock;
pub mod error;
pub mod injection;
pub mod instance;
mod leavings;
mod ports;
mod request_response;
mod sealed;
mod swaps;
pub mod sys;
mod wake_event;

use std::any::Any;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use iceoryx2::prelude::{
    AttributeSpecifier, AttributeVerifier, LogLevel, Node, NodeBuilder, ServiceName,
    SignalHandlingMode, ipc, set_log_level,
};
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};

pub use blackboard::{Blackboard, BlackboardReader, SHEETS};
pub use injection::{FaultAnswer, FaultCall, FaultClient, FaultOrder, FaultServer};
pub use ports::{OBSERVED, OBSERVERS, Receiver, Relay, Sender};
pub use swaps::{SwapAnswer, SwapCall, SwapClient, SwapOrder, SwapOutcome, SwapServer};
pub use wake_event::{Notifier, Owner, WakeEvent};

use crate::error::{Error, Refusal, RefusalKind, SHARED_MEMORY, Shortage, Tried as _, shortage};
use crate::instance::{Instance, Lock};
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::monitor::Monitor;
use messages::topic::Topic;

/// Samples that a receiver keeps which needs the newest alone.
pub const LATEST: usize = 1;
/// Samples that the recorder keeps of a topic: 3.5 seconds at 1 kHz. An instance fits into the 64 MiB of a container.
pub const DEEP: usize = 3500;
/// Processes that may hold a service open: five roles, their spares, and observers.
const NODES: usize = 28;
/// How long a service may be in the making, or be taken down, by somebody else, and how often it is tried.
const PATIENCE: Duration = Duration::from_secs(5);
const TRY_EVERY: Duration = Duration::from_millis(5);

/// A process's access to an instance's shared memory.
#[derive(Debug)]
pub struct Wire {
    /// Topics that are held open without a port, so that ports are made faster: an `Arc` of a [`ports::Open`] each.
    held_topics: Vec<Box<dyn Any + Send>>,
    held_boards: Vec<(String, Arc<blackboard::Open>)>,
    node: Node<ipc::Service>,
    instance: Instance,
    bells: wake_event::WakeFile,
    /// What dead processes of the instance left behind, and was removed.
    pub cleaned: u64,
    // Last: nobody takes the shared memory away while a port of this process is in it.
    _in_use: Lock,
}

impl Wire {
    /// Removes what dead processes of the instance left, then joins it.
    pub fn open(instance: &Instance) -> Result<Self, Error> {
        // What goes wrong comes back as an error; the middleware's own prints would repeat it.
        set_log_level(LogLevel::Fatal);
        let config = instance.config()?;
        let in_use = leavings::enter(instance, &config)?;
        instance.check_segments()?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| {
                refused(
                    instance,
                    format!("cannot join instance `{}`", instance.name()),
                    format!("{e:?}"),
                )
            })?;
        instance.close_node_counter()?;
        let cleaned = leavings::remove(&node, instance);
        let bells = wake_event::WakeFile::join(instance)?;
        Ok(Self {
            held_topics: Vec::new(),
            held_boards: Vec::new(),
            node,
            instance: instance.clone(),
            bells,
            cleaned,
            _in_use: in_use,
        })
    }

    /// Removes what processes of the instance left that have died since; what living ones hold stays. What one has left
    /// that died while it made a service is removed by whoever opens that.
    pub fn remove_leavings(&self) {
        leavings::remove_of_ports(&self.node, &self.instance);
    }

    pub const fn instance(&self) -> &Instance {
        &self.instance
    }

    /// Shared memory that an instance takes [bytes]: twice that of the topics, to cover everything else, and that of
    /// the observers' topics.
    pub fn needed_bytes() -> u64 {
        fn observers<C: Topic>() -> u64 {
            ports::slot_bytes::<C>(OBSERVERS, OBSERVED)
        }
        fn topic<C: Topic>() -> u64 {
            2 * ports::slot_bytes::<C>(C::SUBSCRIBERS, DEEP) + observers::<C>()
        }
        topic::<State>()
            + topic::<Setpoint>()
            + topic::<Wrench>()
            + topic::<RotorSpeeds>()
            + topic::<SwapRecord>()
            + observers::<Monitor>()
    }

    /// Opens a service, which others may be making or taking down at the same time: until it is done, or does not get
    /// better. What processes left in it that died meanwhile is removed.
    fn open_service<T>(
        &self,
        what: String,
        mut open: impl FnMut() -> Result<T, Refusal>,
    ) -> Result<T, Error> {
        let start = Instant::now();
        loop {
            let refusal = match open() {
                Ok(service) => return Ok(service),
                Err(refusal) => refusal,
            };
            if refusal.kind != RefusalKind::Passing || shortage_of(&self.instance).is_some() {
                return Err(not_opened(&self.instance, what, refusal));
            }
            if start.elapsed() >= PATIENCE {
                let patience = PATIENCE.as_secs();
                let what = format!(
                    "cannot open {what}: another process has not made it, or removed it, in {patience} s"
                );
                return Err(Error::Wire {
                    what,
                    reason: refusal.reason,
                });
            }
            leavings::remove(&self.node, &self.instance);
            leavings::remove_half_made(&self.node, &self.instance);
            std::thread::sleep(TRY_EVERY);
        }
    }

    fn service_name(&self, name: &str) -> Result<ServiceName, Error> {
        let name = format!("ironbird/{}/{name}", self.instance.name());
        ServiceName::new(&name).wire(|| format!("cannot name the service {name}"))
    }
}

/// Why a service was not opened: another build made it differently, or it is only out of reach.
fn not_opened(instance: &Instance, what: String, Refusal { kind, reason }: Refusal) -> Error {
    if kind == RefusalKind::Differs {
        Error::Incompatible { what, reason }
    } else {
        refused(instance, format!("cannot open {what}"), reason)
    }
}

/// What the middleware refused, or what the system has run out of.
fn refused(instance: &Instance, what: String, reason: String) -> Error {
    Error::of_middleware(what, reason, shortage_of(instance))
}

fn shortage_of(instance: &Instance) -> Option<Shortage> {
    shortage([instance.directory().as_path(), Path::new(SHARED_MEMORY)])
}

/// The layout of a service's payload as an attribute: given to a service that is created, demanded of one that exists.
fn layout_attributes(fingerprint: u64) -> Result<(AttributeSpecifier, AttributeVerifier), Error> {
    let attribute = || {
        let value = format!("{fingerprint:016x}");
        let key = AttributeKey::try_from("layout").ok()?;
        let value = AttributeValue::try_from(value.as_str()).ok()?;
        let given = AttributeSpecifier::new().define(&key, &value).ok()?;
        Some((given, AttributeVerifier::new().require(&key, &value).ok()?))
    };
    attribute().ok_or_else(|| Error::wire("cannot describe a message layout", fingerprint))
}
