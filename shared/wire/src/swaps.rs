//! Parameter swaps: request to the plant and response, over iceoryx2.

use std::time::Duration;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::{CallbackProgression, ipc};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::request_response::PortFactory;

use super::{Bell, NODES, Owner, Wire, layout_verifier};
use crate::clock::now_ns;
use crate::error::Error;
use crate::refusal::Refusal;
use crate::sys::Sealed;
use model::layout::{FNV_OFFSET, Layout as _, fnv1a, from_wire, layout};
use model::parameters::PARAMETERS;

/// Clients that may ask at the same time.
const CLIENTS: usize = 8;

/// A swap as it is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct SwapOrder {
    /// Tick from which it takes hold; `NO_TICK` if the tick is counted from now.
    pub at_tick: u64,
    /// With `at_tick == NO_TICK`: ticks from the plant's present one.
    pub in_ticks: u64,
    /// How many of the following pairs are meant.
    pub count: u64,
    /// Parameters, as indices of the table [`model::parameters::SPECS`].
    pub parameter: [u64; PARAMETERS],
    /// Their new values, in their units.
    pub value: [f64; PARAMETERS],
    /// Equal steps in which they get there, one a tick; 1 is at once.
    pub steps: [u64; PARAMETERS],
}
layout!(SwapOrder { at_tick, in_ticks, count, parameter, value, steps });

/// The plant's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct SwapAnswer {
    /// A [`SwapOutcome`] as number.
    pub verdict: u64,
    /// Applied: the tick from which it holds. Refused: the plant's tick.
    pub tick: u64,
    /// Parameter epoch after the swap.
    pub parameter_epoch: u64,
    /// Refused for one parameter: its index.
    pub parameter: u64,
    /// Values before the swap, in the order of the request.
    pub old: [f64; PARAMETERS],
}
layout!(SwapAnswer { verdict, tick, parameter_epoch, parameter, old });

/// An order on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
struct Ask {
    /// When it was sent [ns]: of those that come into one place after each other, no two have the same instant.
    asked_ns: u64,
    order: SwapOrder,
}
layout!(Ask { asked_ns, order });

/// An answer on its way.
///
/// The middleware takes it to a client's place, and not to the client (iceoryx2 0.10). Somebody else may have the place
/// by then, and must see that he is not meant.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
struct Reply {
    /// Of the order that it answers.
    asked_ns: u64,
    answer: SwapAnswer,
}
layout!(Reply { asked_ns, answer });

/// The service with its payloads.
type SwapService = PortFactory<ipc::Service, Sealed<Ask>, (), Sealed<Reply>, ()>;

/// What became of a swap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum SwapOutcome {
    /// It holds.
    Applied = 0,
    /// An index names no parameter.
    UnknownParameter = 1,
    /// A value is out of its range.
    OutOfRange = 2,
    /// It names no parameter, too many, or one twice; or a ramp takes no step, or more than a flight has ticks.
    Malformed = 3,
    /// Too many swaps wait for their ticks.
    QueueFull = 4,
    /// The run ended before its tick.
    Ended = 5,
}

from_wire!(SwapOutcome { Applied, UnknownParameter, OutOfRange, Malformed, QueueFull, Ended });

impl Wire {
    fn swap_service(&self) -> Result<SwapService, Error> {
        let layouts = [Ask::FINGERPRINT, Reply::FINGERPRINT, SwapOutcome::WORDS]
            .into_iter()
            .fold(FNV_OFFSET, |hash, part| fnv1a(hash, &part.to_le_bytes()));
        let (service, layout) = (self.service_name("parameters")?, layout_verifier(layouts)?);
        self.open_service("the service `parameters`".into(), || {
            self.node
                .service_builder(&service)
                .request_response::<Sealed<Ask>, Sealed<Reply>>()
                .max_servers(1)
                .max_clients(CLIENTS)
                .max_active_requests_per_client(1)
                .max_response_buffer_size(1)
                .max_nodes(NODES)
                .open_or_create_with_attributes(&layout)
                .map_err(Refusal::from)
        })
    }

    /// The plant's end.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn swap_server(&self) -> Result<SwapServer, Error> {
        let service = self.swap_service()?;
        let server =
            service.server_builder().create().map_err(|e| Error::wire("cannot serve the service `parameters`", e))?;
        Ok(SwapServer { server, service })
    }

    /// A client's end.
    ///
    /// # Errors
    /// [`Error::Wire`], [`Error::Incompatible`].
    pub fn swap_client(&self) -> Result<SwapClient, Error> {
        let client = self
            .swap_service()?
            .client_builder()
            .create()
            .map_err(|e| Error::wire("cannot ask the service `parameters`", e))?;
        Ok(SwapClient { client, bell: self.bell(Owner::Desk)? })
    }
}

/// Receives orders.
#[derive(Debug)]
pub struct SwapServer {
    server: Server<ipc::Service, Sealed<Ask>, (), Sealed<Reply>, ()>,
    service: SwapService,
}

/// An order that waits for its answer.
#[derive(Debug)]
pub struct SwapCall {
    ask: Ask,
    request: ActiveRequest<ipc::Service, Sealed<Ask>, (), Sealed<Reply>, ()>,
}

impl SwapServer {
    /// The next order, if one has come. One that was damaged on its way is dropped, and its client gets no answer.
    ///
    /// # Errors
    /// [`Error::Wire`].
    pub fn next(&self) -> Result<Option<SwapCall>, Error> {
        while let Some(request) = self.server.receive().map_err(|e| Error::wire("cannot receive a swap", e))? {
            let sealed = *request.payload();
            if let Ok(ask) = sealed.open() {
                return Ok(Some(SwapCall { ask: *ask, request }));
            }
        }
        Ok(None)
    }

    /// Whether the one who asked waits for the answer; one that was killed counts until somebody else comes.
    ///
    /// A call that nobody awaits is to be dropped before [`Self::next`] is asked: the middleware would take a client
    /// that has come into its place for the one that has left, and cut it off when the call is dropped.
    #[must_use]
    pub fn is_awaited(&self, call: &SwapCall) -> bool {
        let asked = call.request.origin();
        let mut is_there = false;
        self.service.dynamic_config().list_clients(|client| {
            is_there |= client.client_id == asked;
            CallbackProgression::Continue
        });
        is_there && call.request.is_connected()
    }
}

impl SwapCall {
    /// What is asked for.
    #[must_use]
    pub const fn order(&self) -> SwapOrder {
        self.ask.order
    }

    /// Answers. It is no error if the client has gone.
    pub fn answer(self, answer: SwapAnswer) {
        let reply = Reply { asked_ns: self.ask.asked_ns, answer };
        // Nobody is left to tell if this fails, and the swap itself is on record.
        let _ = self.request.send_copy(Sealed::new(reply));
    }
}

/// Sends orders.
#[derive(Debug)]
pub struct SwapClient {
    client: Client<ipc::Service, Sealed<Ask>, (), Sealed<Reply>, ()>,
    bell: Bell,
}

impl SwapClient {
    /// Asks, and waits for the answer until `patience` has passed.
    ///
    /// # Errors
    /// [`Error::Wire`]; [`Error::Absent`] when no answer came in time.
    pub fn ask(&self, order: SwapOrder, patience: Duration) -> Result<SwapAnswer, Error> {
        let asked_ns = now_ns();
        let pending: PendingResponse<_, _, _, _, _> = self
            .client
            .send_copy(Sealed::new(Ask { asked_ns, order }))
            .map_err(|e| Error::wire("cannot ask for a swap", e))?;
        self.bell.ring()?;
        let until = asked_ns.saturating_add(u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX));
        loop {
            let reply = pending.receive().map_err(|e| Error::wire("cannot receive the answer", e))?;
            let ours = |reply: &&Reply| reply.asked_ns == asked_ns;
            // A copy: what lies in shared memory may change between two looks.
            if let Some(reply) = reply.map(|reply| *reply).as_ref().and_then(|reply| reply.open().ok()).filter(ours) {
                return Ok(reply.answer);
            }
            if now_ns() >= until {
                return Err(Error::Absent { what: format!("the plant did not answer within {patience:?}") });
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
