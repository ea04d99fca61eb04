//! The filter behind the inspection of an input: what its faults make of each message, and when the stage gets it.
//!
//! The filter gets the messages that inspection let through, in order. Its result depends on the tick of a message and on
//! the messages before it, and on nothing else. The steps, in order:
//!
//! ```text
//!   lost?    drop
//!   content  that of the last one before the fault (freeze), else that of so many ticks before (lag), else its own
//!            + bias + noise, in the order of the table; nan
//!   refused? what is not finite or not plausible then is counted, as inspection does, and goes no further
//!   when     so many ticks later (delay)
//! ```

use crate::live::{LiveFault, MAX_MESSAGE_FAULTS, MessageFaults};
use crate::{FaultKind, LONGEST_DELAY_TICKS, MessageKind, NumberKind, Port, Target};
use std::collections::VecDeque;

use messages::content::{NO_TICK, Stamped};
use messages::fields::Faulty;
use messages::header::Message;
use messages::noise::{standard_normal, uniform};
use messages::rejections::{Reason, Rejections};

/// Contents that are kept for those that lag: of as many ticks as the longest, and of the newest.
const KEPT: usize = LONGEST_DELAY_TICKS as usize + 1;

/// Streams of random numbers: those below are the sensors'. Each fault has one for itself and each axis.
const FIRST_STREAM: u64 = 1 << 32;
const STREAMS: u64 = 8;

/// What comes of a message at a filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passed<C> {
    pub content: C,
    pub delay: u64,
}

/// The faults of an input, and what they have to know of earlier messages.
#[derive(Clone, Debug)]
pub struct FaultFilter<C> {
    seed: u64,
    faults: Vec<(u64, LiveFault)>,
    /// The newest contents with their ticks, by tick; empty where nothing can lag.
    kept: Vec<(u64, C)>,
    lags: bool,
    /// The last one before a freeze; none where nothing came, or nothing freezes.
    last: Option<C>,
    freezes: bool,
    rejections: Rejections,
}

impl<C: Faulty> FaultFilter<C> {
    /// The filter of an input before its first message; none where it has no faults.
    pub fn new(faults: &MessageFaults, port: Port) -> Option<Self> {
        let is_lag =
            |fault: &LiveFault| fault.kind.target == Target::Message(MessageKind::Lag, port);
        let lags = faults.of(port).any(|(_, fault)| is_lag(fault));
        faults.of(port).next()?;
        Some(Self::with_room(faults, port, if lags { KEPT } else { 0 }))
    }

    /// The filter of an input whose faults may change in flight: it has room for whatever they will be.
    pub fn changing(faults: &MessageFaults, port: Port) -> Self {
        Self::with_room(faults, port, KEPT)
    }

    fn with_room(faults: &MessageFaults, port: Port, kept: usize) -> Self {
        let mut filter = Self {
            seed: faults.seed,
            faults: Vec::with_capacity(MAX_MESSAGE_FAULTS),
            kept: vec![(NO_TICK, C::default()); kept],
            lags: false,
            last: None,
            freezes: false,
            rejections: Rejections::default(),
        };
        filter.change(faults, port, None);
        filter
    }

    /// Whether it has faults, also such as are over or still to come.
    pub const fn has_faults(&self) -> bool {
        !self.faults.is_empty()
    }

    /// Takes the faults of an input as they are from now on; what it knows of earlier messages stays. `newest` is what
    /// came last, for a filter without a freeze so far, which has not kept it: a freeze may follow it with nothing in
    /// between. It allocates nothing where it was made as one that changes.
    pub fn change(&mut self, faults: &MessageFaults, port: Port, newest: Option<C>) {
        self.faults.clear();
        self.faults
            .extend(faults.of(port).map(|(number, fault)| (number, *fault)));
        let froze = self.freezes;
        let any = |kind| {
            let target = Target::Message(kind, port);
            self.faults
                .iter()
                .any(|(_, fault)| fault.kind.target == target)
        };
        (self.lags, self.freezes) = (any(MessageKind::Lag), any(MessageKind::Freeze));
        // Otherwise it may be a message of the freeze, to a stage that began within it.
        if self.freezes && !froze {
            self.last = newest;
        }
    }

    /// What comes of the message of a tick; nothing where it is lost or refused.
    pub fn pass(&mut self, tick: u64, content: &C) -> Option<Passed<C>> {
        let Self { seed, faults, .. } = &*self;
        let seed = *seed;
        let active = || faults.iter().filter(|(_, fault)| fault.span.contains(tick));
        let (mut is_lost, mut delay, mut lag, mut is_frozen) = (false, 0, 0, false);
        for (number, fault) in active() {
            let Target::Message(kind, _) = fault.kind.target else {
                continue;
            };
            let value = fault.kind.value;
            match kind {
                MessageKind::Drop => {
                    is_lost |= uniform(seed, tick, stream(*number, 0)) < value.number();
                }
                MessageKind::DropEach => {
                    let [lost, of] = value.0;
                    is_lost |= (tick - fault.span.from) % of < lost;
                }
                MessageKind::Delay => delay += value.integer(),
                MessageKind::Lag => lag += value.integer(),
                MessageKind::Freeze => is_frozen = true,
            }
        }
        let mut passed = match (is_frozen, lag) {
            (true, _) => self.last,
            (false, 0) => Some(*content),
            (false, lag) => tick.checked_sub(lag).and_then(|tick| self.kept_of(tick)),
        };
        if let Some(passed) = &mut passed {
            for (number, fault) in active() {
                apply(fault.kind, seed, tick, *number, passed);
            }
        }
        self.keep(tick, content, is_frozen);
        let content = passed.filter(|_| !is_lost)?;
        self.is_sound(&content).then_some(Passed { content, delay })
    }

    /// Messages that were refused for what a fault had made of them.
    pub const fn rejections(&self) -> &Rejections {
        &self.rejections
    }

    fn kept_of(&self, tick: u64) -> Option<C> {
        self.kept
            .get((tick % KEPT as u64) as usize)
            .filter(|(of, _)| *of == tick)
            .map(|(_, content)| *content)
    }

    fn keep(&mut self, tick: u64, content: &C, is_frozen: bool) {
        if self.lags
            && let Some(place) = self.kept.get_mut((tick % KEPT as u64) as usize)
        {
            *place = (tick, *content);
        }
        if self.freezes && !is_frozen {
            self.last = Some(*content);
        }
    }

    fn is_sound(&mut self, content: &C) -> bool {
        let refused = match (content.finite(), content.plausible()) {
            (true, true) => return true,
            (true, false) => Reason::Implausible,
            (false, _) => Reason::NonFinite,
        };
        self.rejections.count(refused);
        false
    }
}

/// Messages that may be held back: one a tick, for the longest delay, and the newest.
const ROOM: usize = LONGEST_DELAY_TICKS as usize + 4;

/// What stands between an inspected message and the stage that it is for.
///
/// Call [`FaultyInput::arrive`] for every message, and [`FaultyInput::settle`] in every tick in which the stage works.
#[derive(Clone, Debug)]
pub struct FaultyInput<C: Faulty> {
    filter: Option<FaultFilter<C>>,
    /// Those that come later, each with the first tick that has it.
    waiting: VecDeque<(u64, Message<C>)>,
    newest: Message<C>,
}

impl<C: Faulty> FaultyInput<C> {
    pub fn new(faults: &MessageFaults, port: Port) -> Self {
        Self {
            filter: FaultFilter::new(faults, port),
            waiting: VecDeque::with_capacity(ROOM),
            newest: Message::default(),
        }
    }

    /// An input that nothing has come to, and whose faults may change in flight.
    pub fn changing(faults: &MessageFaults, port: Port) -> Self {
        let mut input = Self::new(&MessageFaults::none(faults.seed), port);
        // Memory that was never touched is none yet.
        input
            .waiting
            .extend((0..ROOM).map(|_| (0, Message::default())));
        input.waiting.clear();
        Self {
            filter: Some(FaultFilter::changing(faults, port)),
            ..input
        }
    }

    /// Takes the faults as they are from now on, without an allocation; `newest` is what came last. An input without a
    /// fault so far was not shown it.
    pub fn change(&mut self, faults: &MessageFaults, port: Port, newest: &Message<C>) {
        let Some(filter) = &mut self.filter else {
            return;
        };
        if !filter.has_faults() {
            self.newest = *newest;
        }
        let has_any = newest.envelope.tick != NO_TICK;
        filter.change(faults, port, has_any.then_some(newest.content));
    }

    /// Takes a message that inspection let through. It keeps its envelope, whatever becomes of its content.
    pub fn arrive(&mut self, message: &Message<C>) {
        self.arrive_late(message, 0);
    }

    /// The same of a message that its sender was so many ticks late with.
    pub fn arrive_late(&mut self, message: &Message<C>, late: u64) {
        let (envelope, tick) = (message.envelope, message.envelope.tick);
        let passed = match &mut self.filter {
            Some(filter) => filter.pass(tick, &message.content),
            None => Some(Passed {
                content: message.content,
                delay: 0,
            }),
        };
        let Some(Passed { content, delay }) = passed else {
            return;
        };
        if self.waiting.len() == ROOM {
            self.waiting.pop_front();
        }
        self.waiting.push_back((
            tick.saturating_add(delay).saturating_add(late),
            Message { envelope, content },
        ));
    }

    /// The newest message that has come by a tick. One that was overtaken on its way is never used.
    pub fn settle(&mut self, tick: u64) -> &Message<C> {
        let newest = &mut self.newest;
        self.waiting.retain(|(due, message)| {
            let is_due = *due <= tick;
            if is_due
                && (newest.envelope.tick == NO_TICK || newest.envelope.tick < message.envelope.tick)
            {
                *newest = *message;
            }
            !is_due
        });
        if self.waiting.is_empty() {
            // The next one then lies where this one lay: the caches keep one message, not all the room.
            self.waiting.clear();
        }
        newest
    }

    /// The newest message that the stage has.
    pub const fn newest(&self) -> &Message<C> {
        &self.newest
    }

    pub const fn stamped(&self) -> Stamped<C> {
        Stamped::new(self.newest.envelope.tick, self.newest.content)
    }

    /// Messages that were refused for what a fault had made of them.
    pub fn rejections(&self) -> Rejections {
        self.filter
            .as_ref()
            .map(|filter| *filter.rejections())
            .unwrap_or_default()
    }
}

const fn stream(number: u64, axis: u64) -> u64 {
    FIRST_STREAM + STREAMS * number + axis
}

/// Does to a content's numbers what a fault does.
fn apply<C: Faulty>(fault: FaultKind, seed: u64, tick: u64, number: u64, content: &mut C) {
    let Target::Number(kind, _, place) = fault.target else {
        return;
    };
    let numbers = content.field_mut(place.field).iter_mut().zip(0..);
    let meant = numbers.filter(|(_, axis)| place.axis.is_none_or(|wanted| wanted == *axis));
    for (value, axis) in meant {
        match kind {
            NumberKind::Noise => {
                *value +=
                    fault.value.number() * standard_normal(seed, tick, stream(number, axis as u64));
            }
            NumberKind::Bias => *value += fault.value.number(),
            NumberKind::Nan => *value = f64::NAN,
        }
    }
}
