//! Doorbells: how a stage wakes the next one.
//!
//! An iceoryx2 event (one datagram a ring), waited for with `ppoll` on the listener's descriptor, because the
//! middleware's own timed wait counts in milliseconds and a deadline lies inside one.

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::ipc;
use iceoryx2::service::port_factory::event::PortFactory;

use super::{NODES, Wire, not_opened};
use crate::error::Error;
use crate::role::Role;
use crate::rt::sys::readable_until;

/// Who waits at a doorbell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// The loop of a role.
    Role(Role),
    /// The plant's parameter desk.
    Desk,
}

impl From<Role> for Owner {
    fn from(role: Role) -> Self {
        Self::Role(role)
    }
}

impl std::fmt::Display for Owner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Role(role) => role.fmt(f),
            Self::Desk => f.write_str("desk"),
        }
    }
}

impl Wire {
    fn bell_service(&self, owner: Owner) -> Result<PortFactory<ipc::Service>, Error> {
        self.node
            .service_builder(&self.service_name(&format!("bell/{owner}"))?)
            .event()
            .max_listeners(1)
            // Its sender in the loop; at the plant, everybody who asks for a swap.
            .max_notifiers(NODES)
            .max_nodes(NODES)
            .event_id_max_value(0)
            .open_or_create()
            .map_err(|error| not_opened(format!("the doorbell of {owner}"), error))
    }

    /// The doorbell of a role's loop, or of the parameter desk.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn doorbell(&self, owner: impl Into<Owner>) -> Result<Doorbell, Error> {
        let owner = owner.into();
        let listener = self
            .bell_service(owner)?
            .listener_builder()
            .create()
            .map_err(|e| Error::wire(format!("cannot wait at the doorbell of {owner}"), e))?;
        Ok(Doorbell { listener })
    }

    /// The button of a doorbell.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn bell(&self, owner: impl Into<Owner>) -> Result<Bell, Error> {
        let owner = owner.into();
        let notifier = self
            .bell_service(owner)?
            .notifier_builder()
            .create()
            .map_err(|e| Error::wire(format!("cannot ring the doorbell of {owner}"), e))?;
        Ok(Bell { notifier })
    }
}

/// Where a role waits to be woken.
#[derive(Debug)]
pub struct Doorbell {
    listener: Listener<ipc::Service>,
}

impl Doorbell {
    /// Waits until somebody rings or the instant has come; returns whether somebody rang.
    ///
    /// # Errors
    /// [`Error::Wire`].
    pub fn wait_until(&self, instant_ns: u64) -> Result<bool, Error> {
        if !readable_until(&self.listener, instant_ns) {
            return Ok(false);
        }
        let rings = self.listener.try_wait(|_| ()).map_err(|e| Error::wire("cannot answer the doorbell", e))?;
        Ok(rings > 0)
    }
}

/// Wakes a role.
#[derive(Debug)]
pub struct Bell {
    notifier: Notifier<ipc::Service>,
}

impl Bell {
    /// Connects to the doorbell, so that ringing later only rings.
    ///
    /// # Errors
    /// [`Error::Wire`].
    pub(super) fn arm(&self) -> Result<(), Error> {
        self.notifier.update_connections().map_err(|e| Error::wire("cannot connect to a doorbell", e))
    }

    /// Rings. Nobody there is no error: a stage that is gone is noticed by its silence.
    ///
    /// # Errors
    /// [`Error::Wire`].
    pub fn ring(&self) -> Result<(), Error> {
        self.notifier.notify().map_err(|e| Error::wire("cannot ring a doorbell", e))?;
        Ok(())
    }
}
