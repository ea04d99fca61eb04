//! Ports of the loop's topics: one sender, receivers as deep as each needs.

use std::mem::MaybeUninit;
use std::sync::Arc;

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::ipc;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::{DEEP, NODES, Notifier, Wire, layout_verifier};
use crate::clock::Horizon;
use crate::clock::now_ns;
use crate::error::Error;
use crate::refusal::Refusal;
use crate::sys::Sealed;
use messages::content::{NO_TICK, Stamped};
use messages::header::{Header, LAYOUT, Message};
use messages::inspection::{Expected, Inspector, Rejections};
use messages::topic::Topic;

pub(super) type Open<C> = PortFactory<ipc::Service, Sealed<Message<C>>, ()>;

impl Wire {
    fn topic<C: Topic>(&self) -> Result<Arc<Open<C>>, Error> {
        // A type for each topic.
        match self
            .held_topics
            .iter()
            .find_map(|held| held.downcast_ref::<Arc<Open<C>>>())
        {
            Some(held) => Ok(Arc::clone(held)),
            None => self
                .publish_subscribe(C::NAME, C::SUBSCRIBERS, DEEP)
                .map(Arc::new),
        }
    }

    /// Opens a topic ahead of its ports, and keeps it open.
    pub fn hold_topic<C: Topic>(&mut self) -> Result<(), Error> {
        let topic = self.topic::<C>()?;
        self.held_topics.push(Box::new(topic));
        Ok(())
    }

    pub(super) fn publish_subscribe<C: Topic>(
        &self,
        name: &str,
        subscribers: usize,
        depth: usize,
    ) -> Result<Open<C>, Error> {
        let (service, layout) = (self.service_name(name)?, layout_verifier(LAYOUT)?);
        self.open_service(format!("topic `{name}`"), || {
            self.node
                .service_builder(&service)
                .publish_subscribe::<Sealed<Message<C>>>()
                .max_publishers(1)
                .max_subscribers(subscribers)
                .subscriber_max_buffer_size(depth)
                .subscriber_max_borrowed_samples(1)
                .history_size(0)
                .max_nodes(NODES)
                // A receiver that does not keep up loses its oldest sample; a sender never waits for anybody.
                .enable_safe_overflow(true)
                .open_or_create_with_attributes(&layout)
                .map_err(Refusal::from)
        })
    }

    /// The one sender of a topic; rings `bell` after each message.
    pub fn sender<C: Topic>(&self, bell: Option<Notifier>) -> Result<Sender<C>, Error> {
        let publisher = self
            .topic::<C>()?
            .publisher_builder()
            .max_loaned_samples(1)
            .create()
            .map_err(|e| {
                Error::wire(
                    format!("cannot become the sender of topic `{}`", C::NAME),
                    e,
                )
            })?;
        Ok(Sender {
            loan: None,
            publisher,
            bell,
            envelope: Header::new(),
        })
    }

    /// A receiver that keeps `depth` messages of a topic.
    pub fn receiver<C: Topic>(&self, depth: usize) -> Result<Receiver<C>, Error> {
        let subscriber = self
            .topic::<C>()?
            .subscriber_builder()
            .buffer_size(depth)
            .create()
            .map_err(|e| Error::wire(format!("cannot receive topic `{}`", C::NAME), e))?;
        Ok(Receiver::new(subscriber))
    }
}

/// Shared memory that the slots of a topic take [bytes].
pub(super) fn slot_bytes<C: Topic>(subscribers: usize, depth: usize) -> u64 {
    // One slot per buffered and borrowed sample of every subscriber, one loaned, one in the hand of the sender.
    let slots = subscribers * (depth + 1) + 2;
    (slots * (size_of::<Sealed<Message<C>>>() + 64)) as u64
}

/// A place for a message in shared memory, before it is sent.
type Loan<C> = SampleMutUninit<ipc::Service, MaybeUninit<Sealed<Message<C>>>, ()>;

/// Sends the messages of a topic.
pub struct Sender<C: Topic> {
    /// Taken ahead of the message that it is for, by a rehearsal.
    loan: Option<Loan<C>>,
    publisher: Publisher<ipc::Service, Sealed<Message<C>>, ()>,
    bell: Option<Notifier>,
    /// What every message of this sender carries.
    envelope: Header,
}

impl<C: Topic> std::fmt::Debug for Sender<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            loan,
            publisher,
            bell,
            envelope,
        } = self;
        let loaned = loan.is_some();
        write!(
            f,
            "Sender {{ loaned: {loaned}, publisher: {publisher:?}, bell: {bell:?}, envelope: {envelope:?} }}"
        )
    }
}

impl<C: Topic> Sender<C> {
    /// Arms the sender for a run: connects to everybody who listens now.
    pub fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.bell.iter().for_each(Notifier::begin);
        self.envelope = Header {
            run_id: expected.run_id,
            settings: expected.settings,
            epoch,
            ..Header::new()
        };
        self.publisher.update_connections().map_err(|e| {
            Error::wire(
                format!("cannot connect the sender of topic `{}`", C::NAME),
                e,
            )
        })
    }

    /// Sends a message made for `tick`, and rings.
    ///
    /// `history` is the envelope of the input that it was made from; origin, sequence and the send stamp are the
    /// sender's own. One allocation: the middleware's loan.
    pub fn send(&mut self, tick: u64, history: &Header, content: C) -> Result<(), Error> {
        let loan = self.take_loan()?;
        let mut envelope = self.envelope_of(tick, history);
        envelope.stamps[C::SENDER as usize].send_ns = now_ns();
        loan.write_payload(Sealed::new(Message { envelope, content }))
            .send()
            .map_err(|e| not_sent::<C>(&e))?;
        self.envelope.seq += 1;
        self.bell.as_ref().map_or(Ok(()), Notifier::ring)
    }

    /// Does of [`Sender::send`] what can be done without sending: takes the loan, which the next message is then sent
    /// with, fills it, and rings for a rehearsal.
    pub fn rehearse(&mut self, tick: u64, history: &Header, content: C) -> Result<(), Error> {
        let mut loan = self.take_loan()?;
        let mut envelope = self.envelope_of(tick, history);
        envelope.stamps[C::SENDER as usize].send_ns = now_ns();
        loan.payload_mut()
            .write(Sealed::new(Message { envelope, content }));
        self.loan = Some(loan);
        // The part of a send that looks for receivers that have come or gone.
        self.publisher
            .update_connections()
            .map_err(|e| not_sent::<C>(&e))?;
        self.bell
            .as_ref()
            .map_or(Ok(()), Notifier::ring_for_rehearsal)
    }

    /// Rings to say that there is no message of a tick.
    pub fn pass(&self, tick: u64) -> Result<(), Error> {
        self.bell
            .as_ref()
            .map_or(Ok(()), |bell| bell.ring_for_silence(tick))
    }

    fn take_loan(&mut self) -> Result<Loan<C>, Error> {
        match self.loan.take() {
            Some(loan) => Ok(loan),
            None => self.publisher.loan_uninit().map_err(|e| not_sent::<C>(&e)),
        }
    }

    fn envelope_of(&self, tick: u64, history: &Header) -> Header {
        let Header {
            layout,
            run_id,
            settings,
            epoch,
            seq,
            ..
        } = self.envelope;
        Header {
            layout,
            run_id,
            settings,
            epoch,
            seq,
            tick,
            ..*history
        }
    }
}

fn not_sent<C: Topic>(reason: &dyn std::fmt::Debug) -> Error {
    Error::wire(format!("cannot send on topic `{}`", C::NAME), reason)
}

/// Receives the messages of a topic: copies each once, opens and inspects the copy, keeps the newest.
#[derive(Debug)]
pub struct Receiver<C: Topic> {
    subscriber: Subscriber<ipc::Service, Sealed<Message<C>>, ()>,
    inspector: Inspector,
    newest: Message<C>,
    rejections: Rejections,
}

impl<C: Topic> Receiver<C> {
    pub(super) fn new(subscriber: Subscriber<ipc::Service, Sealed<Message<C>>, ()>) -> Self {
        Self {
            subscriber,
            inspector: Inspector::new(Expected {
                run_id: 0,
                settings: 0,
            }),
            newest: Message::default(),
            rejections: Rejections::default(),
        }
    }

    /// Arms the receiver for a run: connects to the sender, forgets what came before.
    pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.subscriber.update_connections().map_err(|e| {
            Error::wire(
                format!("cannot connect the receiver of topic `{}`", C::NAME),
                e,
            )
        })?;
        self.inspector = Inspector::new(expected);
        self.newest = Message::default();
        Ok(())
    }

    /// Takes everything that has come and calls `each` on what passes inspection.
    ///
    /// `horizon` is asked for the latest tick that can have begun when a message is there.
    pub fn drain(
        &mut self,
        horizon: impl Horizon,
        mut each: impl FnMut(&Message<C>),
    ) -> Result<(), Error> {
        self.drain_after(horizon, |_, message| each(message))
    }

    /// The same; `each` is also told what was the newest message before.
    pub fn drain_after(
        &mut self,
        horizon: impl Horizon,
        mut each: impl FnMut(&Message<C>, &Message<C>),
    ) -> Result<(), Error> {
        let failed = |e| Error::wire(format!("cannot receive from topic `{}`", C::NAME), e);
        while let Some(sample) = self.subscriber.receive().map_err(failed)? {
            let sealed = *sample.payload();
            let inspect = |message| {
                self.inspector
                    .inspect(message, horizon.latest_tick())
                    .map(|()| message)
            };
            match sealed.open().and_then(inspect) {
                Ok(message) => {
                    each(&self.newest, message);
                    self.newest = *message;
                }
                Err(reason) => self.rejections.count(reason),
            }
        }
        Ok(())
    }

    /// Takes everything that has come and keeps the newest; returns the tick of what it has now.
    pub fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        self.drain(horizon, |_| ())?;
        Ok(self.newest.envelope.tick)
    }

    /// The newest message; its tick is [`NO_TICK`] while there was none.
    #[must_use]
    pub const fn newest(&self) -> &Message<C> {
        &self.newest
    }

    /// Content and tick of the newest message.
    #[must_use]
    pub const fn dated(&self) -> Stamped<C> {
        Stamped {
            tick: self.newest.envelope.tick,
            content: self.newest.content,
        }
    }

    /// Whether there was a message at all.
    #[must_use]
    pub const fn has_any(&self) -> bool {
        self.newest.envelope.tick != NO_TICK
    }

    /// Messages that did not pass inspection.
    #[must_use]
    pub const fn rejections(&self) -> &Rejections {
        &self.rejections
    }
}
