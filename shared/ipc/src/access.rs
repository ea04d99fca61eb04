//! How a process joins an instance, opens services, and removes what dead processes left.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use iceoryx2::node::{CleanupState, NodeState};
use iceoryx2::prelude::{
    AttributeSpecifier, AttributeVerifier, CallbackProgression, Config, LogLevel, Node,
    NodeBuilder, ServiceName, SignalHandlingMode, ipc, set_log_level,
};
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};

use crate::error::{Error, Refusal, RefusalKind, SHARED_MEMORY, Shortage, Tried as _, shortage};
use crate::instance::{Instance, Lock};
use crate::ports::DEEP;
use crate::wake_file::WakeFile;
use messages::role::Channel;

/// Processes that may hold a service open: up to eleven in three channels, those that replace them, and observers.
pub(super) const NODES: usize = 28;
/// How long another process may take to create or remove a service, and how often it is tried.
const SERVICE_TIMEOUT: Duration = Duration::from_secs(5);
const TRY_EVERY: Duration = Duration::from_millis(5);
/// How long processes that were killed may take to exit.
const EXIT_TIMEOUT: Duration = Duration::from_millis(200);
/// How long another process may take to remove what a dead process left.
const CLEANUP_TIMEOUT: Duration = Duration::from_secs(1);

/// A process's access to an instance's shared memory.
#[derive(Debug)]
pub struct Wire {
    pub(super) node: Node<ipc::Service>,
    pub(super) instance: Instance,
    pub(super) wake_file: WakeFile,
    /// The channel whose topics it sends and receives, and how many there are.
    pub(super) channel: Channel,
    pub(super) channels: usize,
    /// Messages that the recorder's receivers keep of a topic.
    pub(super) depth: usize,
    /// Number of dead processes whose leftovers were removed.
    pub cleaned: u64,
    // Last: no process removes the shared memory while a port of this process is in it.
    _in_use: Lock,
}

impl Wire {
    /// Removes what dead processes of the instance left, then joins it.
    pub fn open(instance: &Instance) -> Result<Self, Error> {
        // Failures are returned as errors; the middleware's own prints would repeat them.
        set_log_level(LogLevel::Fatal);
        let config = instance.config()?;
        let in_use = enter(instance, &config)?;
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
        let cleaned = remove_dead(&node, instance);
        if cleaned > 0 {
            // The middleware takes a service whose creator died for one that is still being created.
            remove_unfinished(&node, instance);
        }
        Ok(Self {
            node,
            instance: instance.clone(),
            wake_file: WakeFile::join(instance)?,
            channel: Channel::A,
            channels: 1,
            depth: DEEP,
            cleaned,
            _in_use: in_use,
        })
    }

    /// The same access, for a process of `channel` in a flight with `channels` channels and a [`recorder_depth`].
    ///
    /// [`recorder_depth`]: crate::recorder_depth
    #[must_use]
    pub const fn in_flight(mut self, channel: Channel, channels: usize, depth: usize) -> Self {
        (self.channel, self.channels, self.depth) = (channel, channels, depth);
        self
    }

    pub const fn channel(&self) -> Channel {
        self.channel
    }

    /// Removes what processes of the instance left that died after this one joined; what living ones hold stays.
    pub fn remove_dead(&self) {
        remove_dead(&self.node, &self.instance);
    }

    pub const fn instance(&self) -> &Instance {
        &self.instance
    }

    /// Opens a service, which other processes may be creating or removing at the same time. Removes what
    /// dead processes left in it.
    pub(super) fn open_service<T>(
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
            if start.elapsed() >= SERVICE_TIMEOUT {
                let seconds = SERVICE_TIMEOUT.as_secs();
                let what = format!(
                    "cannot open {what}: another process has not created or removed it within {seconds} s"
                );
                return Err(Error::Wire {
                    what,
                    reason: refusal.reason,
                });
            }
            remove_dead(&self.node, &self.instance);
            remove_unfinished(&self.node, &self.instance);
            std::thread::sleep(TRY_EVERY);
        }
    }

    pub(super) fn service_name(&self, name: &str) -> Result<ServiceName, Error> {
        let name = format!("ironbird/{}/{name}", self.instance.name());
        ServiceName::new(&name).wire(|| format!("cannot name the service {name}"))
    }
}

/// Takes the lock of the shared memory; the first process to have it finds the memory empty.
///
/// Of several processes that are killed, the last one may still be exiting.
fn enter(instance: &Instance, config: &Config) -> Result<Lock, Error> {
    let start = Instant::now();
    loop {
        let in_use = instance.enter()?;
        if nodes(config).1 == 0 || start.elapsed() >= EXIT_TIMEOUT {
            return Ok(in_use);
        }
        drop(in_use);
        std::thread::sleep(TRY_EVERY);
    }
}

/// Removes what dead processes left beside living ones; returns how many there were.
fn remove_dead(node: &Node<ipc::Service>, instance: &Instance) -> u64 {
    let CleanupState {
        cleanups,
        failed_cleanups,
    } = node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT);
    if failed_cleanups == 0 {
        return cleanups;
    }
    // The middleware may have stopped at an unfinished service.
    remove_unfinished(node, instance);
    cleanups + node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT).cleanups
}

/// Removes services whose creators died, and which the middleware takes for services that are still being created.
fn remove_unfinished(node: &Node<ipc::Service>, instance: &Instance) {
    // A file that cannot be removed fails where its service is opened.
    let _ = instance.remove_orphans(|| nodes(node.config()).0);
}

/// Names of the nodes that may be alive, and the number of those that are dead.
fn nodes(config: &Config) -> (BTreeSet<String>, u64) {
    let (mut living, mut dead) = (BTreeSet::new(), 0);
    // If they cannot be listed, nothing is removed.
    let _ = Node::<ipc::Service>::list(config, |state| {
        if matches!(state, NodeState::Dead(_)) {
            dead += 1;
        } else {
            living.insert(state.node_id().value().to_string());
        }
        CallbackProgression::Continue
    });
    (living, dead)
}

/// Why a service was not opened: another build created it differently, or it cannot be reached.
pub(super) fn not_opened(
    instance: &Instance,
    what: String,
    Refusal { kind, reason }: Refusal,
) -> Error {
    if kind == RefusalKind::Differs {
        Error::Incompatible { what, reason }
    } else {
        refused(instance, format!("cannot open {what}"), reason)
    }
}

/// The middleware's error, or the resource that the system has run out of.
fn refused(instance: &Instance, what: String, reason: String) -> Error {
    Error::of_middleware(what, reason, shortage_of(instance))
}

pub(super) fn shortage_of(instance: &Instance) -> Option<Shortage> {
    shortage([instance.directory().as_path(), Path::new(SHARED_MEMORY)])
}

/// The layout of a service's payload as an attribute: given to a service that is created, demanded of one that exists.
pub(super) fn layout_attributes(
    fingerprint: u64,
) -> Result<(AttributeSpecifier, AttributeVerifier), Error> {
    let attribute = || {
        let value = format!("{fingerprint:016x}");
        let key = AttributeKey::try_from("layout").ok()?;
        let value = AttributeValue::try_from(value.as_str()).ok()?;
        let given = AttributeSpecifier::new().define(&key, &value).ok()?;
        Some((given, AttributeVerifier::new().require(&key, &value).ok()?))
    };
    attribute().ok_or_else(|| Error::wire("cannot describe a message layout", fingerprint))
}
