//! The inputs of a stage: receivers, behind each the faults of its messages once there are some.

use std::ops::ControlFlow;

use faults::filter::FaultyInput;
use faults::live::{LIVE, LiveBlackboard, LoopFaults};
use faults::{LONGEST_DELAY_TICKS, MessageFaults, Port};
use ipc::clock::Horizon;
use ipc::error::Error;
use ipc::{BlackboardReader, LATEST, Receiver, TopicPorts, Wire};
use messages::content::Stamped;
use messages::fields::Faulty;
use messages::header::{Header, Message};
use messages::inspection::{Expected, Rejections};
use messages::role::{Replica, Role};

/// Messages that an input that may have faults keeps for its stage: more than any fault looks back.
const FAULTS_DEPTH: usize = 2 * LONGEST_DELAY_TICKS as usize;

/// The faults of a stage: those planned, and those that the plant's blackboard has had since.
pub struct ActiveFaults {
    replica: Replica,
    planned: LoopFaults,
    now: LoopFaults,
    version: u64,
    is_late: bool,
    live: Option<BlackboardReader<LiveBlackboard>>,
}

impl ActiveFaults {
    pub(super) fn new(replica: Replica, planned: LoopFaults) -> Self {
        Self {
            replica,
            planned,
            now: planned,
            version: 0,
            is_late: planned.is_late(replica.role),
            live: None,
        }
    }

    /// Opens the plant's blackboard, with the faults that were injected before this process joined the flight.
    pub(super) fn arm(&mut self, wire: &Wire) -> Result<(), Error> {
        self.live = wire.blackboard_reader(LIVE)?;
        if let Some(live) = self.live.as_ref().map(BlackboardReader::get) {
            self.take(&live);
        }
        Ok(())
    }

    /// Reads the blackboard; returns how often the faults have changed.
    pub fn version(&mut self) -> u64 {
        if let Some(news) = self.live.as_mut().and_then(BlackboardReader::news) {
            self.take(&news);
        }
        self.version
    }

    pub const fn messages(&self) -> &MessageFaults {
        &self.now.messages
    }

    /// How much longer the stage computes at a tick [ns], as of the last look.
    pub(super) fn late_ns(&self, tick: u64) -> u64 {
        if self.is_late {
            self.now.late_ns(self.replica, tick)
        } else {
            0
        }
    }

    #[cold]
    fn take(&mut self, live: &LiveBlackboard) {
        self.now = self.planned.with(live);
        self.is_late = self.now.is_late(self.replica.role);
        self.version += 1;
    }
}

/// The receivers of a stage; the first one's messages wake it.
pub trait Inputs: Sized {
    /// What the stage is given of them: contents, each with its tick.
    type Stamped;

    fn new(wire: &Wire, role: Role, faults: &MessageFaults) -> Result<Self, Error>;

    fn arm(&mut self, expected: Expected) -> Result<(), Error>;

    /// Takes what has come; the tick of the newest message that wakes. Faults are read after a message has been
    /// received, and taken without an allocation.
    fn take(&mut self, horizon: impl Horizon, active: &mut ActiveFaults) -> Result<u64, Error>;

    /// Settles what there is of each by a tick: a fault may hold messages back.
    fn settle(&mut self, tick: u64);

    fn stamped(&self) -> Self::Stamped;

    /// The newest of each, as if they were of this tick.
    fn stamped_as_of(&self, tick: u64) -> Self::Stamped;

    fn fresh(&self, tick: u64) -> bool;

    /// Whether what the first input was made from has been received too.
    fn is_complete(&self) -> bool;

    /// The history that an output of this tick goes back to, with the tick of each input.
    fn history(&self, tick: u64) -> Header;

    /// Tick of each input, and the history of the state that its sender had after it.
    fn histories(&self) -> impl Iterator<Item = (u64, u64)> + Clone;

    fn rejections(&self) -> Rejections;
}

/// A receiver, and the faults of its messages once there are some.
#[derive(Debug)]
pub struct Input<C: Faulty> {
    receiver: Receiver<C>,
    port: Option<Port>,
    inlet: Box<FaultyInput<C>>,
    is_faulty: bool,
    version: u64,
}

impl<C: Faulty> Input<C> {
    fn newest(&self) -> &Message<C> {
        if self.is_faulty {
            self.inlet.newest()
        } else {
            self.receiver.newest()
        }
    }
}

/// Takes the faults of an input as they are from now on; `before` is the newest message so far. Says whether there are
/// any.
#[cold]
fn change<C: Faulty>(
    inlet: &mut FaultyInput<C>,
    port: Option<Port>,
    faults: &MessageFaults,
    before: &Message<C>,
) -> bool {
    let Some(port) = port.filter(|port| faults.of(*port).next().is_some()) else {
        return false;
    };
    inlet.change(faults, port, before);
    true
}

impl<A: Faulty + TopicPorts> Inputs for Input<A> {
    type Stamped = Stamped<A>;

    fn new(wire: &Wire, role: Role, faults: &MessageFaults) -> Result<Self, Error> {
        let port = Port::of(role, A::NAME);
        let is_faulty = port.is_some_and(|port| faults.of(port).next().is_some());
        // What lags behind the newest message is one that came before: none may be lost beneath it, neither while a
        // stage that was late comes to it, nor before a fault that is injected.
        let depth = if port.is_some() { FAULTS_DEPTH } else { LATEST };
        let inlet = Box::new(FaultyInput::changing(
            faults,
            port.unwrap_or(Port::OuterState),
        ));
        Ok(Self {
            receiver: wire.receiver(depth)?,
            port,
            inlet,
            is_faulty,
            version: 0,
        })
    }

    fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.receiver.arm(expected)
    }

    fn take(&mut self, horizon: impl Horizon, active: &mut ActiveFaults) -> Result<u64, Error> {
        let Self {
            receiver,
            port,
            inlet,
            is_faulty,
            version,
        } = self;
        receiver.drain_after(horizon, |before, message, latest_tick| {
            // After the message was received: the faults that act on it were on the blackboard when it was sent, however
            // long this stage had no processor since.
            let now = active.version();
            if now != *version {
                *version = now;
                *is_faulty |= change(inlet, *port, active.messages(), before);
            }
            if *is_faulty {
                inlet.arrive(message);
            }
            // A message of the present tick is the newest: on the grid the latest tick is the one after it.
            if message.envelope.tick + 1 >= latest_tick {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })?;
        Ok(receiver.newest().envelope.tick)
    }

    fn settle(&mut self, tick: u64) {
        if self.is_faulty {
            self.inlet.settle(tick);
        }
    }

    fn stamped(&self) -> Stamped<A> {
        if self.is_faulty {
            self.inlet.stamped()
        } else {
            self.receiver.stamped()
        }
    }

    fn stamped_as_of(&self, tick: u64) -> Stamped<A> {
        Stamped {
            tick,
            ..self.stamped()
        }
    }

    fn fresh(&self, tick: u64) -> bool {
        self.newest().envelope.tick == tick
    }

    fn is_complete(&self) -> bool {
        true
    }

    fn history(&self, _tick: u64) -> Header {
        let newest = self.newest().envelope;
        newest.made_from(A::SENDER, newest.tick)
    }

    fn histories(&self) -> impl Iterator<Item = (u64, u64)> + Clone {
        let newest = &self.newest().envelope;
        std::iter::once((newest.tick, newest.law_state.after))
    }

    fn rejections(&self) -> Rejections {
        self.inlet.rejections().and(self.receiver.rejections())
    }
}

impl<A: Faulty + TopicPorts, B: Faulty + TopicPorts> Inputs for (Input<A>, Input<B>) {
    type Stamped = (Stamped<A>, Stamped<B>);

    fn new(wire: &Wire, role: Role, faults: &MessageFaults) -> Result<Self, Error> {
        Ok((
            Input::new(wire, role, faults)?,
            Input::new(wire, role, faults)?,
        ))
    }

    fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.1.arm(expected)?;
        self.0.arm(expected)
    }

    fn take(&mut self, horizon: impl Horizon, active: &mut ActiveFaults) -> Result<u64, Error> {
        let tick = self.0.take(horizon, active)?;
        self.1.take(horizon, active)?;
        Ok(tick)
    }

    fn settle(&mut self, tick: u64) {
        self.0.settle(tick);
        self.1.settle(tick);
    }

    fn stamped(&self) -> Self::Stamped {
        (self.0.stamped(), self.1.stamped())
    }

    fn stamped_as_of(&self, tick: u64) -> Self::Stamped {
        (self.0.stamped_as_of(tick), self.1.stamped_as_of(tick))
    }

    fn fresh(&self, tick: u64) -> bool {
        self.0.fresh(tick) && self.1.fresh(tick)
    }

    fn is_complete(&self) -> bool {
        let (first, second) = (&self.0.receiver, &self.1.receiver);
        let is_there = || second.newest().envelope.tick >= first.newest().envelope.tick;
        !first.has_any() || (second.has_any() && is_there())
    }

    /// The history that reaches further: that of the first input, or that of the second if the first is stale.
    fn history(&self, tick: u64) -> Header {
        let (first, second) = (self.0.newest().envelope, self.1.newest().envelope);
        let newest = if first.tick == tick { first } else { second };
        newest
            .made_from(A::SENDER, first.tick)
            .made_from(B::SENDER, second.tick)
    }

    fn histories(&self) -> impl Iterator<Item = (u64, u64)> + Clone {
        self.0.histories().chain(self.1.histories())
    }

    fn rejections(&self) -> Rejections {
        self.0.rejections().and(&self.1.rejections())
    }
}
