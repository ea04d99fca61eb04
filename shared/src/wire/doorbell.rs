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

impl Wire {
    fn bell_service(&self, role: Role) -> Result<PortFactory<ipc::Service>, Error> {
        self.node
            .service_builder(&self.service_name(&format!("bell/{role}"))?)
            .event()
            .max_listeners(1)
            // Its sender in the loop; at the plant, everybody who asks for a swap.
            .max_notifiers(NODES)
            .max_nodes(NODES)
            .event_id_max_value(0)
            .open_or_create()
            .map_err(|error| not_opened(format!("the doorbell of {role}"), error))
    }

    /// The doorbell at which a role waits.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn doorbell(&self, role: Role) -> Result<Doorbell, Error> {
        let listener = self
            .bell_service(role)?
            .listener_builder()
            .create()
            .map_err(|e| Error::wire(format!("cannot wait at the doorbell of {role}"), e))?;
        Ok(Doorbell { listener })
    }

    /// The button of a role's doorbell.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn bell(&self, role: Role) -> Result<Bell, Error> {
        let notifier = self
            .bell_service(role)?
            .notifier_builder()
            .create()
            .map_err(|e| Error::wire(format!("cannot ring the doorbell of {role}"), e))?;
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
