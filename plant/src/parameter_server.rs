//! The parameter desk: answers swap requests on a thread beside the loop.
//!
//! It is a thread of the plant's process without real-time priority. It validates orders, passes them to the loop
//! through a lock-free queue, and answers once the loop reports that they hold. A client that comes or goes costs the
//! middleware allocations and hundreds of microseconds; on this thread it costs the tick nothing
//! (docs/decisions/0004-parameter-server.md).

use std::sync::mpsc;

use heapless::spsc::{Consumer, Producer};
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::Instance;
use ipc::{
    Call, ENDED, FaultAnswer, FaultOrder, MALFORMED, MOST_AT_ONCE, Owner, STRIKES, Sender,
    SwapAnswer, SwapOrder, SwapOutcome, Wire,
};
use messages::content::{NO_TICK, SwapRecord};
use messages::fault::code::FaultCode;
use messages::fault::live::LiveFault;
use messages::fault::{NotTaken, Span};
use messages::header::Header;
use messages::inspection::Expected;
use messages::parameters::{PARAMETERS, Parameter, ParameterError};

use crate::swap::{AppliedSwap, Swap, SwapError, Target};

/// Orders that may lie between the desk and the loop.
pub const INBOX: usize = 16;
/// Events that may lie between the loop and the desk: more than swaps can be pending.
pub const OUTBOX: usize = 128;

/// How long the server sleeps while no client waits for a reply [ns].
const IDLE_NS: u64 = 20_000_000;
/// How long while somebody does [ns].
const BUSY_NS: u64 = 1_000_000;

/// A swap on its way to the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct SwapRequest {
    /// Tick from which it shall hold; `None` counts from the present one.
    pub tick: Option<u64>,
    /// With no tick: how many ticks from the present one.
    pub in_ticks: u64,
    pub swap: Swap,
}

/// Faults of messages and stages on their way to the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultRequest {
    pub ticket: u64,
    /// Tick from which they shall strike; `None` counts from the present one.
    pub tick: Option<u64>,
    /// With no tick: how many ticks from the present one.
    pub in_ticks: u64,
    pub for_ticks: u64,
    /// The faults, whose ticks the loop says.
    pub faults: heapless::Vec<LiveFault, MOST_AT_ONCE>,
}

/// An order on its way to the loop.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lies in a queue of fixed places; a box would be freed in the loop"
)]
pub enum Request {
    Swap(SwapRequest),
    Faults(FaultRequest),
}

/// What the loop says of an order.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lies in a queue of fixed places; a box would allocate in the loop"
)]
pub enum Event {
    Applied(AppliedSwap),
    Refused {
        ticket: u64,
        tick: u64,
        reason: SwapError,
    },
    Strikes {
        ticket: u64,
        span: Span,
    },
    NotTaken {
        ticket: u64,
        which: usize,
        reason: NotTaken,
    },
}

/// Serves until the loop closes the channel `opened`, which brings what the run's messages carry.
///
/// A swap that was taken in holds at its tick even if the one who asked has left. He only loses his place at the desk.
///
/// `ready` is told once when the desk is open.
pub fn serve(
    instance: &Instance,
    ready: &mpsc::Sender<()>,
    opened: &mpsc::Receiver<(Expected, u64)>,
    orders: Producer<'_, Request>,
    events: Consumer<'_, Event>,
) -> Result<(), Error> {
    let wire = Wire::open(instance)?;
    let (server, fault_server) = (wire.server::<SwapOrder>()?, wire.server::<FaultOrder>()?);
    let event = wire.wake_event(Owner::Requests)?;
    let (waiting, for_faults) = (heapless::Vec::new(), heapless::Vec::new());
    let mut desk = Desk {
        records: wire.sender(None)?,
        orders,
        events,
        waiting,
        for_faults,
        ticket: 0,
    };
    // The loop waits for this, so it is there.
    let _ = ready.send(());
    let Ok((expected, epoch)) = opened.recv() else {
        return Ok(());
    };
    desk.records.arm(expected, epoch)?;
    loop {
        let closed = opened.try_recv() == Err(mpsc::TryRecvError::Disconnected);
        // First: whoever asks next may have come into the place of one that has left.
        desk.waiting.retain(|(_, call)| server.is_awaited(call));
        desk.for_faults
            .retain(|(_, call)| fault_server.is_awaited(call));
        while let Some(call) = server.next()? {
            desk.receive(call);
        }
        while let Some(call) = fault_server.next()? {
            desk.receive_faults(call);
        }
        while let Some(event) = desk.events.dequeue() {
            desk.pass_on(event)?;
        }
        if closed {
            desk.dismiss();
            return Ok(());
        }
        let is_idle = desk.waiting.is_empty() && desk.for_faults.is_empty();
        let patience = if is_idle { IDLE_NS } else { BUSY_NS };
        event.wait_until(now_ns() + patience)?;
    }
}

struct Desk<'a> {
    records: Sender<SwapRecord>,
    orders: Producer<'a, Request>,
    events: Consumer<'a, Event>,
    /// Callers whose swaps have not come to hold yet, by ticket.
    waiting: heapless::Vec<(u64, Call<SwapOrder>), INBOX>,
    /// Callers whose faults the loop has not taken yet, by ticket.
    for_faults: heapless::Vec<(u64, Call<FaultOrder>), INBOX>,
    ticket: u64,
}

impl Desk<'_> {
    fn receive(&mut self, call: Call<SwapOrder>) {
        let order = match read(&call.order()) {
            Ok(order) => order,
            Err(reason) => return call.reply(refusal(&reason, 0)),
        };
        self.ticket += 1;
        let order = SwapRequest {
            swap: Swap {
                ticket: self.ticket,
                ..order.swap
            },
            ..order
        };
        if let Err((_, call)) = self.waiting.push((self.ticket, call)) {
            return call.reply(refusal(&SwapError::Full, 0));
        }
        // The inbox has one place less than callers may wait.
        if self.orders.enqueue(Request::Swap(order)).is_err() {
            self.answer(self.ticket, refusal(&SwapError::Full, 0));
        }
    }

    fn receive_faults(&mut self, call: Call<FaultOrder>) {
        let order = call.order();
        let Some(faults) = faults_of(&order) else {
            return call.reply(fault_refusal(MALFORMED, 0));
        };
        self.ticket += 1;
        let FaultOrder {
            at_tick,
            in_ticks,
            for_ticks,
            ..
        } = order;
        let tick = (at_tick != NO_TICK).then_some(at_tick);
        let request = FaultRequest {
            ticket: self.ticket,
            tick,
            in_ticks,
            for_ticks,
            faults,
        };
        let full = fault_refusal(NotTaken::NoRoom as u64, 0);
        if let Err((_, call)) = self.for_faults.push((self.ticket, call)) {
            return call.reply(full);
        }
        // The inbox has one place less than callers may wait.
        if self.orders.enqueue(Request::Faults(request)).is_err() {
            self.answer_faults(self.ticket, full);
        }
    }

    fn answer_faults(&mut self, ticket: u64, answer: FaultAnswer) {
        if let Some(call) = take_call(&mut self.for_faults, ticket) {
            call.reply(answer);
        }
    }

    fn answer(&mut self, ticket: u64, answer: SwapAnswer) {
        if let Some(call) = take_call(&mut self.waiting, ticket) {
            call.reply(answer);
        }
    }

    fn pass_on(&mut self, event: Event) -> Result<(), Error> {
        match event {
            Event::Refused {
                ticket,
                tick,
                reason,
            } => self.answer(ticket, refusal(&reason, tick)),
            Event::Strikes {
                ticket,
                span: Span { from, to },
            } => {
                self.answer_faults(
                    ticket,
                    FaultAnswer {
                        verdict: STRIKES,
                        from,
                        to,
                        which: 0,
                    },
                );
            }
            Event::NotTaken {
                ticket,
                which,
                reason,
            } => {
                self.answer_faults(ticket, fault_refusal(reason as u64, which as u64));
            }
            Event::Applied(applied) => {
                let record = swap_record(&applied);
                self.records.send(applied.tick, &Header::new(), record)?;
                self.answer(
                    applied.ticket,
                    SwapAnswer {
                        verdict: SwapOutcome::Applied as u64,
                        tick: applied.tick,
                        parameter_epoch: applied.epoch,
                        parameter: 0,
                        old: record.old,
                    },
                );
            }
        }
        Ok(())
    }

    /// Tells everybody who still waits that the run is over.
    fn dismiss(&mut self) {
        while let Some((_, call)) = self.for_faults.pop() {
            call.reply(fault_refusal(ENDED, 0));
        }
        while let Some((_, call)) = self.waiting.pop() {
            call.reply(without_effect(SwapOutcome::Ended, 0, 0));
        }
    }
}

/// Takes a call out of those that wait.
fn take_call<C>(waiting: &mut heapless::Vec<(u64, C), INBOX>, ticket: u64) -> Option<C> {
    let place = waiting.iter().position(|(waits, _)| *waits == ticket)?;
    Some(waiting.swap_remove(place).1)
}

/// The faults of an order of the wire; nothing where one of them is none, or where there are none or too many.
fn faults_of(order: &FaultOrder) -> Option<heapless::Vec<LiveFault, MOST_AT_ONCE>> {
    let count = usize::try_from(order.count)
        .ok()
        .filter(|count| *count > 0)?;
    let faults: Option<heapless::Vec<_, _>> = order
        .faults
        .get(..count)?
        .iter()
        .map(FaultCode::fault)
        .collect();
    faults.filter(|_| order.for_ticks > 0)
}

fn fault_refusal(verdict: u64, which: u64) -> FaultAnswer {
    FaultAnswer {
        verdict,
        from: 0,
        to: 0,
        which,
    }
}

/// An order of the wire as a swap that may be applied.
fn read(order: &SwapOrder) -> Result<SwapRequest, SwapError> {
    let count = usize::try_from(order.count).unwrap_or(usize::MAX);
    let named = order.parameter.get(..count).ok_or(SwapError::Empty)?;
    let mut targets = heapless::Vec::<_, PARAMETERS>::new();
    for ((index, value), steps) in named.iter().zip(order.value).zip(order.steps) {
        let parameter = Parameter::from_index(*index).ok_or_else(|| {
            SwapError::Value(ParameterError::Unknown {
                name: format!("number {index}"),
                nearest: None,
            })
        })?;
        // No more than the table has rows.
        let _ = targets.push(Target {
            parameter,
            value,
            steps,
        });
    }
    let swap = Swap::to(0, &targets)?;
    let tick = (order.at_tick != NO_TICK).then_some(order.at_tick);
    Ok(SwapRequest {
        tick,
        in_ticks: order.in_ticks,
        swap,
    })
}

fn refusal(reason: &SwapError, tick: u64) -> SwapAnswer {
    let (verdict, parameter) = match reason {
        SwapError::Empty => (SwapOutcome::Malformed, 0),
        SwapError::Twice { parameter } | SwapError::Steps { parameter, .. } => {
            (SwapOutcome::Malformed, *parameter as u64)
        }
        SwapError::Value(ParameterError::Unknown { .. }) => (SwapOutcome::UnknownParameter, 0),
        SwapError::Value(ParameterError::OutOfRange { parameter, .. }) => {
            (SwapOutcome::OutOfRange, *parameter as u64)
        }
        SwapError::Full => (SwapOutcome::QueueFull, 0),
    };
    without_effect(verdict, tick, parameter)
}

fn without_effect(verdict: SwapOutcome, tick: u64, parameter: u64) -> SwapAnswer {
    SwapAnswer {
        verdict: verdict as u64,
        tick,
        parameter_epoch: 0,
        parameter,
        old: [0.0; PARAMETERS],
    }
}

/// A swap that has taken hold, as it is told on topic `swaps`.
pub fn swap_record(applied: &AppliedSwap) -> SwapRecord {
    let mut record = SwapRecord {
        parameter_epoch: applied.epoch,
        count: applied.changes.len() as u64,
        ..SwapRecord::default()
    };
    for (i, change) in applied.changes.iter().enumerate() {
        record.parameter[i] = change.parameter as u64;
        record.old[i] = change.old;
        record.new[i] = change.new;
        record.steps[i] = change.steps;
    }
    record
}

// A queue of heapless holds one less than its size.
const _: () = assert!(OUTBOX > crate::swap::PENDING_SWAPS + INBOX);
