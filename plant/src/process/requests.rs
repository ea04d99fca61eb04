//! The request server: parameter changes, faults and targets that clients request, answered on a thread beside the loop.
//!
//! It is a thread of the plant's process without real-time priority. It validates requests, passes them to the loop
//! through a lock-free queue, and answers once the loop reports that they hold. A client that comes or goes costs the
//! middleware allocations and hundreds of microseconds; on this thread it costs the tick nothing
//! (docs/decisions/0004-parameter-server.md).

use std::sync::mpsc;

use faults::code::FaultCode;
use faults::live::LiveFault;
use faults::swap::{AppliedSwap, PENDING_SWAPS, Swap, SwapError, Target};
use faults::{FaultRefusal, Span};
use heapless::spsc::{Consumer, Producer};
use ipc::clock::now_ns;
use ipc::error::Error;
use ipc::instance::Instance;
use ipc::{
    ACCEPTED, BUSY, Call, ENDED, FaultAnswer, FaultOrder, MALFORMED, MOST_AT_ONCE, Order, Owner,
    SwapAnswer, SwapOrder, SwapOutcome, TargetAnswer, TargetOrder, Wire,
};
use messages::content::NO_TICK;
use messages::parameters::{PARAMETERS, Parameter, ParameterError};

use crate::guidance;

/// Requests that may lie between the server and the loop.
pub(super) const INBOX: usize = 16;
/// Events that may lie between the loop and the server: more than swaps can be pending.
pub(super) const OUTBOX: usize = 128;
// A queue of heapless holds one less than its size.
const _: () = assert!(OUTBOX > PENDING_SWAPS + INBOX);

/// How long the server sleeps while no client waits for an answer, and while one does [ns].
const IDLE_NS: u64 = 20_000_000;
const BUSY_NS: u64 = 1_000_000;

#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    pub id: u64,
    /// First tick; `None` counts `in_ticks` from the present one.
    tick: Option<u64>,
    in_ticks: u64,
    pub action: Action,
}

impl Request {
    pub fn first_tick(&self, now: u64) -> u64 {
        self.tick
            .unwrap_or_else(|| now.saturating_add(self.in_ticks))
    }
}

#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lies in a queue of fixed places; a box would be freed in the loop"
)]
pub enum Action {
    Change(Swap),
    /// Faults, whose ticks the loop sets.
    Inject {
        for_ticks: u64,
        faults: heapless::Vec<LiveFault, MOST_AT_ONCE>,
    },
    Aim(TargetOrder),
}

/// What the loop reports about a request.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lies in a queue of fixed places; a box would allocate in the loop"
)]
pub enum Event {
    Applied(AppliedSwap),
    Refused {
        id: u64,
        tick: u64,
        reason: SwapError,
    },
    Injected {
        id: u64,
        span: Span,
    },
    FaultRefused {
        id: u64,
        which: usize,
        reason: FaultRefusal,
    },
}

/// Serves from when the loop sends to `opened`, that is, once a run is open, until it closes that channel. Sends to `ready`
/// once when clients can connect.
///
/// A swap that was accepted holds at its tick even if its client has left.
pub(super) fn serve(
    instance: &Instance,
    ready: &mpsc::Sender<()>,
    opened: &mpsc::Receiver<()>,
    requests: Producer<'_, Request>,
    mut events: Consumer<'_, Event>,
    follows_targets: bool,
) -> Result<(), Error> {
    let wire = Wire::open(instance)?;
    let (swap_server, fault_server) = (wire.server::<SwapOrder>()?, wire.server::<FaultOrder>()?);
    let target_server = wire.server::<TargetOrder>()?;
    let event = wire.wake_event(Owner::Requests)?;
    let mut server = Server {
        requests,
        changes: heapless::Vec::new(),
        injections: heapless::Vec::new(),
        id: 0,
    };
    // The loop waits for this, so it is there.
    let _ = ready.send(());
    if opened.recv().is_err() {
        return Ok(());
    }
    loop {
        let closed = opened.try_recv() == Err(mpsc::TryRecvError::Disconnected);
        // First: the next client may have come into the place of one that has left.
        server
            .changes
            .retain(|(_, call)| swap_server.is_awaited(call));
        server
            .injections
            .retain(|(_, call)| fault_server.is_awaited(call));
        while let Some(call) = swap_server.next()? {
            server.receive_swap(call);
        }
        while let Some(call) = fault_server.next()? {
            server.receive_faults(call);
        }
        while let Some(call) = target_server.next()? {
            let is_flown = follows_targets && guidance::check(&call.order().target).is_ok();
            let verdict = match is_flown {
                _ if closed => ENDED,
                true => server.receive_target(call.order()),
                false => MALFORMED,
            };
            call.reply(TargetAnswer { verdict });
        }
        while let Some(outcome) = events.dequeue() {
            server.report(outcome);
        }
        if closed {
            server.end();
            return Ok(());
        }
        let is_idle = server.changes.is_empty() && server.injections.is_empty();
        let timeout_ns = if is_idle { IDLE_NS } else { BUSY_NS };
        event.wait_until(now_ns() + timeout_ns)?;
    }
}

/// Clients that wait for the loop, by the number of their request.
type Waiting<C> = heapless::Vec<(u64, C), INBOX>;

struct Server<'a> {
    requests: Producer<'a, Request>,
    changes: Waiting<Call<SwapOrder>>,
    injections: Waiting<Call<FaultOrder>>,
    id: u64,
}

impl Server<'_> {
    /// Passes a request to the loop; gives its call back if there is no room.
    fn submit<C>(
        &mut self,
        call: C,
        [at_tick, in_ticks]: [u64; 2],
        action: Action,
        waiting: fn(&mut Self) -> &mut Waiting<C>,
    ) -> Option<C> {
        self.id += 1;
        let id = self.id;
        if let Err((_, call)) = waiting(self).push((id, call)) {
            return Some(call);
        }
        let request = Request {
            id,
            tick: (at_tick != NO_TICK).then_some(at_tick),
            in_ticks,
            action,
        };
        // The inbox has one place less than clients may wait.
        self.requests.enqueue(request).err()?;
        take_call(waiting(self), id)
    }

    fn receive_swap(&mut self, call: Call<SwapOrder>) {
        let order = call.order();
        let swap = match swap_of(&order) {
            Ok(swap) => swap,
            Err(reason) => return call.reply(swap_refusal(&reason, 0)),
        };
        let ticks = [order.at_tick, order.in_ticks];
        let rejected = self.submit(call, ticks, Action::Change(swap), |it| &mut it.changes);
        if let Some(call) = rejected {
            call.reply(swap_refusal(&SwapError::Full, 0));
        }
    }

    fn receive_faults(&mut self, call: Call<FaultOrder>) {
        let order = call.order();
        let Some(faults) = faults_of(&order) else {
            return call.reply(fault_refusal(MALFORMED, 0));
        };
        let for_ticks = order.for_ticks;
        let action = Action::Inject { for_ticks, faults };
        let ticks = [order.at_tick, order.in_ticks];
        if let Some(call) = self.submit(call, ticks, action, |it| &mut it.injections) {
            call.reply(fault_refusal(FaultRefusal::NoRoom as u64, 0));
        }
    }

    /// Passes a target to the loop, which takes every one.
    fn receive_target(&mut self, order: TargetOrder) -> u64 {
        let request = Request {
            id: 0,
            tick: None,
            in_ticks: 0,
            action: Action::Aim(order),
        };
        self.requests.enqueue(request).map_or(BUSY, |()| ACCEPTED)
    }

    /// Answers the client of an event.
    fn report(&mut self, event: Event) {
        match event {
            Event::Refused { id, tick, reason } => {
                reply(&mut self.changes, id, swap_refusal(&reason, tick));
            }
            Event::Applied(applied) => {
                let answer = SwapAnswer {
                    verdict: SwapOutcome::Applied as u64,
                    tick: applied.tick,
                    parameter_epoch: applied.epoch,
                    parameter: 0,
                    old: applied.record().old,
                };
                reply(&mut self.changes, applied.request_id, answer);
            }
            Event::Injected { id, span } => {
                let answer = FaultAnswer {
                    verdict: ACCEPTED,
                    from: span.from,
                    to: span.to,
                    which: 0,
                };
                reply(&mut self.injections, id, answer);
            }
            Event::FaultRefused { id, which, reason } => {
                let answer = fault_refusal(reason as u64, which as u64);
                reply(&mut self.injections, id, answer);
            }
        }
    }

    /// Answers all waiting clients that the run is over.
    fn end(&mut self) {
        while let Some((_, call)) = self.injections.pop() {
            call.reply(fault_refusal(ENDED, 0));
        }
        while let Some((_, call)) = self.changes.pop() {
            call.reply(without_effect(SwapOutcome::Ended, 0, 0));
        }
    }
}

fn reply<Q: Order>(waiting: &mut Waiting<Call<Q>>, id: u64, answer: Q::Answer) {
    if let Some(call) = take_call(waiting, id) {
        call.reply(answer);
    }
}

fn take_call<C>(waiting: &mut Waiting<C>, id: u64) -> Option<C> {
    let place = waiting.iter().position(|(waits, _)| *waits == id)?;
    Some(waiting.swap_remove(place).1)
}

/// The faults of an order; `None` if one of them is none, or if there are none or too many.
fn faults_of(order: &FaultOrder) -> Option<heapless::Vec<LiveFault, MOST_AT_ONCE>> {
    let codes = order.faults.get(..usize::try_from(order.count).ok()?)?;
    let faults: Option<heapless::Vec<_, _>> = codes.iter().map(FaultCode::fault).collect();
    faults.filter(|faults| !faults.is_empty() && order.for_ticks > 0)
}

fn fault_refusal(verdict: u64, which: u64) -> FaultAnswer {
    FaultAnswer {
        verdict,
        from: 0,
        to: 0,
        which,
    }
}

/// The swap of an order; the loop sets its tick.
fn swap_of(order: &SwapOrder) -> Result<Swap, SwapError> {
    let count = usize::try_from(order.count).unwrap_or(usize::MAX);
    let named = order.parameter.get(..count).ok_or(SwapError::Empty)?;
    let targets = named.iter().zip(order.value).zip(order.steps);
    let targets = targets.map(|((index, value), steps)| {
        let unknown = || ParameterError::Unknown {
            name: format!("number {index}"),
            nearest: None,
        };
        Ok(Target {
            parameter: Parameter::from_index(*index).ok_or_else(unknown)?,
            value,
            steps,
        })
    });
    // No more than the table has rows.
    let targets: Result<heapless::Vec<_, PARAMETERS>, ParameterError> = targets.collect();
    Swap::to(0, &targets?)
}

fn swap_refusal(reason: &SwapError, tick: u64) -> SwapAnswer {
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
