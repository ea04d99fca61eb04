//! Topics for observers: the recorder passes every message on, and what it makes of them.
//!
//! When a subscriber joins or leaves, the publisher's next send maps memory and allocates. In a loop that may cost a
//! deadline; in the recorder it does no harm.

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::ipc;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::{Receiver, Wire};
use crate::error::Error;
use crate::sys::Sealed;
use messages::header::Message;
use messages::topic::Topic;

/// Processes that may observe an instance at the same time.
pub const OBSERVERS: usize = 4;
/// Messages of a topic that an observer may fall behind before it loses the oldest: half a second at 1 kHz.
pub const OBSERVED: usize = 512;

impl Wire {
    fn observed<C: Topic>(
        &self,
    ) -> Result<PortFactory<ipc::Service, Sealed<Message<C>>, ()>, Error> {
        self.publish_subscribe(&format!("observed/{}", C::NAME), OBSERVERS, OBSERVED)
    }

    /// The one relay of a topic.
    pub fn relay<C: Topic>(&self) -> Result<Relay<C>, Error> {
        let service = self.observed()?;
        let publisher = service
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(|e| {
                Error::wire(format!("cannot become the relay of topic `{}`", C::NAME), e)
            })?;
        Ok(Relay { publisher, service })
    }

    /// A receiver of what the recorder passes on of a topic, from the next message on.
    pub fn observer<C: Topic>(&self) -> Result<Receiver<C>, Error> {
        let subscriber = self
            .observed()?
            .subscriber_builder()
            .buffer_size(OBSERVED)
            .create()
            .map_err(|e| match e {
                SubscriberCreateError::ExceedsMaxSupportedSubscribers => Error::Crowded {
                    instance: self.instance().name().into(),
                    most: OBSERVERS,
                },
                e => Error::wire(format!("cannot observe topic `{}`", C::NAME), e),
            })?;
        Ok(Receiver::new(subscriber))
    }
}

/// Passes messages of a topic on, as they came, or as the recorder made them.
#[derive(Debug)]
pub struct Relay<C: Topic> {
    publisher: Publisher<ipc::Service, Sealed<Message<C>>, ()>,
    service: PortFactory<ipc::Service, Sealed<Message<C>>, ()>,
}

impl<C: Topic> Relay<C> {
    /// Passes a message on to all observers. It costs next to nothing without observers, and never waits.
    pub fn pass_on(&self, message: &Message<C>) -> Result<(), Error> {
        if self.service.dynamic_config().number_of_subscribers() == 0 {
            return Ok(());
        }
        let failed =
            |e: &dyn std::fmt::Debug| Error::wire(format!("cannot pass topic `{}` on", C::NAME), e);
        let sample = self.publisher.loan_uninit().map_err(|e| failed(&e))?;
        sample
            .write_payload(Sealed::new(*message))
            .send()
            .map_err(|e| failed(&e))?;
        Ok(())
    }
}
