//! Ports of the topics: one sender, receivers as deep as each needs, and a relay for observers.

use std::mem::MaybeUninit;
use std::ops::ControlFlow;

use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::ipc;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use crate::access::{NODES, Wire, layout_attributes};
use crate::clock::{Horizon, now_ns};
use crate::error::{Error, Refusal, Tried as _};
use crate::sys::Sealed;
use crate::wake_event::Notifier;
use errors::{Failure, OCCUPIED};
use messages::content::{
    Decisions, Loss, NO_TICK, RotorSpeeds, Setpoint, Stamped, State, SwapRecord, Wrench,
};
use messages::header::{Header, LAYOUT, Message};
use messages::inspection::{Expected, Inspector, Rejections};
use messages::monitor::Monitor;
use messages::role::{Channel, Replica};
use messages::topic::Topic;

/// Samples kept by a receiver that needs only the newest.
pub const LATEST: usize = 1;
/// Messages that the recorder's receivers keep of a topic at the least: 3.5 seconds at 1 kHz.
pub const DEEP: usize = 3500;
/// How long the recorder may be absent at any rate without losing a message [ns].
const ABSENCE_NS: u64 = 1_000_000_000;
/// Shared memory of the services themselves, the blackboards, events and requests [bytes].
const EVERYTHING_ELSE: u64 = 9 << 19;
const EVERYTHING_ELSE_OF_A_CHANNEL: u64 = 1 << 20;
/// Processes that may observe an instance at the same time.
pub const OBSERVERS: usize = 4;
/// Messages of a topic that an observer may fall behind before it loses the oldest: half a second at 1 kHz.
pub const OBSERVED: usize = 512;

type Open<C> = PortFactory<ipc::Service, Sealed<Message<C>>, ()>;

/// A topic with ports.
///
/// Each topic has its own implementation, so that the middleware's services are compiled in this crate alone: an
/// optimised build compiles a generic function again in every crate that calls it.
pub trait TopicPorts: Topic {
    fn open(wire: &Wire, name: &str, subscribers: usize, depth: usize)
    -> Result<Open<Self>, Error>;
    fn publisher(service: &Open<Self>) -> Result<TopicPublisher<Self>, PublisherCreateError>;
    fn subscriber(
        service: &Open<Self>,
        depth: usize,
    ) -> Result<TopicSubscriber<Self>, SubscriberCreateError>;
}

type TopicPublisher<C> = Publisher<ipc::Service, Sealed<Message<C>>, ()>;
type TopicSubscriber<C> = Subscriber<ipc::Service, Sealed<Message<C>>, ()>;

macro_rules! topic_ports {
    ($($topic:ty),*) => {$(
        impl TopicPorts for $topic {
            fn open(
                wire: &Wire,
                name: &str,
                subscribers: usize,
                depth: usize,
            ) -> Result<Open<Self>, Error> {
                wire.publish_subscribe(name, subscribers, depth)
            }

            fn publisher(service: &Open<Self>) -> Result<TopicPublisher<Self>, PublisherCreateError> {
                let config = service.static_config();
                let depth = config.subscriber_max_buffer_size();
                let slots = slots(config.max_subscribers(), depth);
                let builder = service.publisher_builder().max_loaned_samples(1);
                builder.override_sample_preallocation(move |_| slots).create()
            }

            fn subscriber(
                service: &Open<Self>,
                depth: usize,
            ) -> Result<TopicSubscriber<Self>, SubscriberCreateError> {
                service.subscriber_builder().buffer_size(depth).create()
            }
        }
    )*};
}

topic_ports!(
    State,
    Setpoint,
    Wrench,
    RotorSpeeds,
    SwapRecord,
    Decisions,
    Monitor,
    Loss
);

impl Wire {
    /// Shared memory that an instance takes with so many channels, if the recorder keeps so many messages [bytes].
    pub fn needed_bytes(channels: usize, depth: usize) -> u64 {
        fn observers<C: Topic>() -> u64 {
            topic_bytes::<C>(OBSERVERS, OBSERVED)
        }
        fn topic<C: Topic>(channels: usize, depth: usize) -> u64 {
            topic_bytes::<C>(subscribers::<C>(channels), depth_of::<C>(depth))
        }
        let of_a_channel = topic::<Setpoint>(channels, depth)
            + topic::<Wrench>(channels, depth)
            + topic::<RotorSpeeds>(channels, depth);
        EVERYTHING_ELSE
            + channels as u64 * (EVERYTHING_ELSE_OF_A_CHANNEL + of_a_channel)
            + topic::<State>(channels, depth)
            + topic::<SwapRecord>(channels, depth)
            + topic::<Decisions>(channels, depth)
            + observers::<State>()
            + observers::<Setpoint>()
            + observers::<Wrench>()
            + observers::<RotorSpeeds>()
            + observers::<SwapRecord>()
            + observers::<Decisions>()
            + observers::<Loss>()
            + observers::<Monitor>()
    }

    fn topic<C: TopicPorts>(&self, channel: Channel) -> Result<Open<C>, Error> {
        let prefix = Replica::new(C::SENDER, channel).channel.prefix();
        let name = format!("{prefix}{}", C::NAME);
        let depth = depth_of::<C>(self.depth);
        C::open(self, &name, subscribers::<C>(self.channels), depth)
    }

    fn publish_subscribe<C: Topic>(
        &self,
        name: &str,
        subscribers: usize,
        depth: usize,
    ) -> Result<Open<C>, Error> {
        let service = self.service_name(name)?;
        let (_, layout) = layout_attributes(LAYOUT)?;
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
                .map_err(Refusal::of)
        })
    }

    /// The one sender of a topic.
    pub fn sender<C: TopicPorts>(&self, wakes: Wakes) -> Result<Sender<C>, Error> {
        let publisher = C::publisher(&self.topic(self.channel)?)
            .wire(|| format!("cannot become the sender of topic `{}`", C::NAME))?;
        Ok(Sender {
            loan: None,
            publisher,
            wakes,
            envelope: Header::new(),
        })
    }

    /// A receiver that keeps `depth` messages of a topic of its own channel.
    pub fn receiver<C: TopicPorts>(&self, depth: usize) -> Result<Receiver<C>, Error> {
        self.receiver_of(self.channel, depth)
    }

    /// The recorder's receiver of a topic.
    pub fn recorder_of<C: TopicPorts>(&self, channel: Channel) -> Result<Receiver<C>, Error> {
        self.receiver_of(channel, depth_of::<C>(self.depth))
    }

    /// A receiver of a topic of another channel.
    pub fn receiver_of<C: TopicPorts>(
        &self,
        channel: Channel,
        depth: usize,
    ) -> Result<Receiver<C>, Error> {
        let subscriber = C::subscriber(&self.topic(channel)?, depth)
            .wire(|| format!("cannot receive topic `{}`", C::NAME))?;
        Ok(Receiver::new(subscriber, false))
    }
}

/// Processes that subscribe to a topic in a flight with so many channels.
const fn subscribers<C: Topic>(channels: usize) -> usize {
    C::SUBSCRIBERS + C::SUBSCRIBERS_PER_CHANNEL * (channels - 1)
}

/// Messages that the recorder's receivers keep of a topic, by the length of a tick on the clock.
pub fn recorder_depth(wall_period_ns: u64) -> usize {
    let ticks = ABSENCE_NS.checked_div(wall_period_ns).unwrap_or(0);
    DEEP.max(ticks as usize)
}

/// Messages that the recorder keeps of a topic. What it receives alone is no part of every tick.
const fn depth_of<C: Topic>(depth: usize) -> usize {
    if C::SUBSCRIBERS == 1 { DEEP } else { depth }
}

/// Places for messages that a sender needs. All receivers keep a part of the newest `depth` messages, so that they share
/// them. Each may hold one more that it reads, and the sender one that it fills.
const fn slots(subscribers: usize, depth: usize) -> usize {
    depth + subscribers + 2
}

/// Shared memory that a topic takes [bytes].
fn topic_bytes<C: Topic>(subscribers: usize, depth: usize) -> u64 {
    // A slot, and two places in the queues of the deepest receiver.
    (slots(subscribers, depth) * (size_of::<Sealed<Message<C>>>() + 64 + 24)) as u64
}

/// A place for a message in shared memory, before it is sent.
type Loan<C> = SampleMutUninit<ipc::Service, MaybeUninit<Sealed<Message<C>>>, ()>;

/// Whom a sender notifies.
#[derive(Debug, Default)]
pub struct Wakes {
    /// The receiver that waits for the messages.
    pub receiver: Option<Notifier>,
    /// Notified after the receiver: the receivers of other channels, and the next stage on the sender's own processor, so
    /// that it is awake when its message comes.
    pub others: Vec<Notifier>,
    /// Those that are to rehearse when the sender has.
    pub rehearsals: Vec<Notifier>,
}

pub struct Sender<C: Topic> {
    /// Taken ahead of the message that it is for, by a warm-up run.
    loan: Option<Loan<C>>,
    publisher: TopicPublisher<C>,
    wakes: Wakes,
    envelope: Header,
}

impl<C: Topic> Sender<C> {
    /// Arms the sender for a run: connects to all present receivers.
    pub fn arm(&mut self, expected: Expected, epoch: u64) -> Result<(), Error> {
        let Wakes {
            receiver, others, ..
        } = &self.wakes;
        receiver.iter().chain(others).for_each(Notifier::begin);
        self.envelope = Header {
            run_id: expected.run_id,
            settings: expected.settings,
            epoch,
            ..Header::new()
        };
        self.publisher
            .update_connections()
            .wire(|| format!("cannot connect the sender of topic `{}`", C::NAME))
    }

    /// Sends a message made for `tick`, and notifies its receiver, and then the others.
    ///
    /// `history` is the envelope of the input that it was made from; origin, sequence and the send stamp are the
    /// sender's own. One allocation: the middleware's loan.
    pub fn send(&mut self, tick: u64, history: &Header, content: C) -> Result<(), Error> {
        let loan = self.take_loan()?;
        loan.write_payload(self.message(tick, history, content))
            .send()
            .wire(not_sent::<C>)?;
        self.envelope.seq += 1;
        let Wakes {
            receiver, others, ..
        } = &self.wakes;
        receiver.iter().chain(others).try_for_each(Notifier::notify)
    }

    /// Does of [`Sender::send`] what can be done without sending: takes the loan, which the next message is then sent
    /// with, fills it, and notifies of a warm-up run.
    pub fn rehearse(&mut self, tick: u64, history: &Header, content: C) -> Result<(), Error> {
        let mut loan = self.take_loan()?;
        loan.payload_mut()
            .write(self.message(tick, history, content));
        self.loan = Some(loan);
        // The part of a send that looks for receivers that have come or gone.
        self.publisher.update_connections().wire(not_sent::<C>)?;
        let mut rehearsals = self.wakes.rehearsals.iter();
        rehearsals.try_for_each(Notifier::notify_rehearsal)
    }

    /// Notifies the receiver that there is no message of a tick.
    pub fn pass(&self, tick: u64) -> Result<(), Error> {
        let mut receiver = self.wakes.receiver.iter();
        receiver.try_for_each(|it| it.notify_silence(tick))
    }

    fn take_loan(&mut self) -> Result<Loan<C>, Error> {
        match self.loan.take() {
            Some(loan) => Ok(loan),
            None => self.publisher.loan_uninit().wire(not_sent::<C>),
        }
    }

    #[inline]
    fn message(&self, tick: u64, history: &Header, content: C) -> Sealed<Message<C>> {
        let own = &self.envelope;
        let mut envelope = Header {
            layout: own.layout,
            run_id: own.run_id,
            settings: own.settings,
            epoch: own.epoch,
            seq: own.seq,
            tick,
            ..*history
        };
        envelope.stamps[C::SENDER as usize].send_ns = now_ns();
        Sealed::new(Message { envelope, content })
    }
}

fn not_sent<C: Topic>() -> String {
    format!("cannot send on topic `{}`", C::NAME)
}

/// Receives the messages of a topic: copies each once, opens and inspects the copy, keeps the newest.
#[derive(Debug)]
pub struct Receiver<C: Topic> {
    subscriber: TopicSubscriber<C>,
    inspector: Inspector,
    newest: Message<C>,
    rejections: Rejections,
    /// Whether the messages come through the recorder, from changing senders.
    is_relayed: bool,
}

impl<C: Topic> Receiver<C> {
    fn new(subscriber: TopicSubscriber<C>, is_relayed: bool) -> Self {
        let nothing = Expected {
            run_id: 0,
            settings: 0,
        };
        Self {
            subscriber,
            inspector: Inspector::new(nothing, is_relayed),
            is_relayed,
            newest: Message::default(),
            rejections: Rejections::default(),
        }
    }

    /// Arms the receiver for a run: connects to the sender, forgets what came before.
    pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.subscriber
            .update_connections()
            .wire(|| format!("cannot connect the receiver of topic `{}`", C::NAME))?;
        self.inspector = Inspector::new(expected, self.is_relayed);
        self.newest = Message::default();
        Ok(())
    }

    /// Takes everything that has come and calls `each` on what passes inspection.
    ///
    /// `horizon` gives the latest tick that can have begun when a message has arrived.
    pub fn drain(
        &mut self,
        horizon: impl Horizon,
        mut each: impl FnMut(&Message<C>),
    ) -> Result<(), Error> {
        self.drain_after(horizon, |_, message, _| {
            each(message);
            ControlFlow::Continue(())
        })
    }

    /// The same until `each` breaks. Its arguments are the newest message before, the message, and the latest tick that can
    /// have begun.
    pub fn drain_after(
        &mut self,
        horizon: impl Horizon,
        mut each: impl FnMut(&Message<C>, &Message<C>, u64) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let failed = || format!("cannot receive from topic `{}`", C::NAME);
        while let Some(sample) = self.subscriber.receive().wire(failed)? {
            let sealed = *sample.payload();
            let latest_tick = horizon.latest_tick();
            let inspect = |message| {
                self.inspector
                    .inspect(message, latest_tick)
                    .map(|()| message)
            };
            match sealed.open().and_then(inspect) {
                Ok(message) => {
                    let next = each(&self.newest, message, latest_tick);
                    self.newest = *message;
                    if next.is_break() {
                        break;
                    }
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
    pub const fn newest(&self) -> &Message<C> {
        &self.newest
    }

    pub const fn stamped(&self) -> Stamped<C> {
        Stamped {
            tick: self.newest.envelope.tick,
            content: self.newest.content,
        }
    }

    pub const fn has_any(&self) -> bool {
        self.newest.envelope.tick != NO_TICK
    }

    pub const fn rejections(&self) -> &Rejections {
        &self.rejections
    }
}

/// Topics for observers: the recorder relays every message, and its own.
///
/// When a subscriber joins or leaves, the publisher's next send maps memory and allocates. In a loop that may cost a
/// deadline; in the recorder it does no harm.
impl Wire {
    fn observed<C: TopicPorts>(&self) -> Result<Open<C>, Error> {
        C::open(self, &format!("observed/{}", C::NAME), OBSERVERS, OBSERVED)
    }

    pub fn relay<C: TopicPorts>(&self) -> Result<Relay<C>, Error> {
        let service = self.observed()?;
        let publisher = C::publisher(&service)
            .wire(|| format!("cannot become the relay of topic `{}`", C::NAME))?;
        Ok(Relay {
            publisher,
            seq: 0,
            service,
        })
    }

    /// A receiver of what the recorder passes on of a topic, from the next message on.
    pub fn observer<C: TopicPorts>(&self) -> Result<Receiver<C>, Error> {
        let subscriber = C::subscriber(&self.observed()?, OBSERVED).map_err(|e| match e {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
                let name = self.instance().name();
                let what = format!(
                    "instance `{name}` has {OBSERVERS} observers already, and that is the most"
                );
                Failure::new(OCCUPIED, what)
                    .help("end one of the others: an `ironbird watch` or an `ironbird bridge`")
                    .into()
            }
            e => Error::wire(format!("cannot observe topic `{}`", C::NAME), e),
        })?;
        Ok(Receiver::new(subscriber, true))
    }
}

/// Passes messages of a topic on, as they came, or as the recorder made them. They are numbered anew: those of changing
/// channels have no common numbers, and an observer finds by them what it was too slow to read.
#[derive(Debug)]
pub struct Relay<C: Topic> {
    publisher: TopicPublisher<C>,
    seq: u64,
    service: Open<C>,
}

impl<C: Topic> Relay<C> {
    /// Passes a message on to all observers. It costs next to nothing without observers, and never waits.
    pub fn pass_on(&mut self, message: &Message<C>) -> Result<(), Error> {
        let mut message = *message;
        message.envelope.seq = self.seq;
        self.seq += 1;
        if self.service.dynamic_config().number_of_subscribers() == 0 {
            return Ok(());
        }
        let failed = || format!("cannot pass topic `{}` on", C::NAME);
        let sample = self.publisher.loan_uninit().wire(failed)?;
        sample
            .write_payload(Sealed::new(message))
            .send()
            .wire(failed)?;
        Ok(())
    }
}
