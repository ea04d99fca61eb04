//! Requests to the plant and its replies, over iceoryx2: parameter changes and faults for a running flight.

use std::fmt::Debug;
use std::time::Duration;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::{CallbackProgression, ZeroCopySend, ipc};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::request_response::PortFactory;

use crate::access::{NODES, Wire, layout_attributes};
use crate::clock::now_ns;
use crate::error::{Error, Refusal, Tried as _};
use crate::sys::Sealed;
use crate::wake_event::{Notifier, Owner};
use faults::FaultRefusal;
use faults::code::FaultCode;
use messages::content::{FlightTarget, TargetKind};
use messages::enum_registry::Fingerprint as _;
use messages::layout::{Layout, hash_of, layout, wire_enum};
use messages::parameters::{PARAMETERS, Parameter};

const CLIENTS: usize = 8;

pub trait Order: Layout + Debug {
    const SERVICE: &'static str;
    /// Hash over the names that the reply's numbers stand for.
    const NAMES: u64;
    type Answer: Layout + Debug;

    fn server(wire: &Wire) -> Result<RequestServer<Self>, Error>;
    fn client(wire: &Wire) -> Result<RequestClient<Self>, Error>;
}

/// Each order has its own implementation for the reason that topics do (`TopicPorts`).
macro_rules! order {
    ($order:ty, $service:literal, $answer:ty, $names:expr) => {
        impl Order for $order {
            const SERVICE: &'static str = $service;
            const NAMES: u64 = $names;
            type Answer = $answer;

            fn server(wire: &Wire) -> Result<RequestServer<Self>, Error> {
                wire.request_server()
            }

            fn client(wire: &Wire) -> Result<RequestClient<Self>, Error> {
                wire.request_client()
            }
        }
    };
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct SwapOrder {
        /// First tick with the new values; `NO_TICK` if the tick is counted from now.
        pub at_tick: u64,
        /// With `at_tick == NO_TICK`: ticks from the plant's present one.
        pub in_ticks: u64,
        /// How many of the following entries are used.
        pub count: u64,
        /// Parameters, as indices of the table [`messages::parameters::SPECS`].
        pub parameter: [u64; PARAMETERS],
        pub value: [f64; PARAMETERS],
        /// Number of equal steps to the value, one a tick; 1 is at once.
        pub steps: [u64; PARAMETERS],
    }
}

impl SwapOrder {
    /// An order of `changes`: parameter, value and number of steps. There is room for [`PARAMETERS`] of them.
    pub fn new(at_tick: u64, in_ticks: u64, changes: &[(Parameter, f64, u64)]) -> Self {
        let mut order = Self {
            at_tick,
            in_ticks,
            count: changes.len() as u64,
            parameter: [0; PARAMETERS],
            value: [0.0; PARAMETERS],
            steps: [1; PARAMETERS],
        };
        for (i, (parameter, value, steps)) in changes.iter().enumerate() {
            order.parameter[i] = *parameter as u64;
            (order.value[i], order.steps[i]) = (*value, *steps);
        }
        order
    }
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct SwapAnswer {
        /// A [`SwapOutcome`] as number.
        pub verdict: u64,
        /// Applied: the first tick with the new values. Refused: the plant's tick.
        pub tick: u64,
        pub parameter_epoch: u64,
        /// Refused for one parameter: its index.
        pub parameter: u64,
        /// Values before the change, in the order of the request.
        pub old: [f64; PARAMETERS],
    }
}

wire_enum! {
    pub enum SwapOutcome {
        Applied = 0,
        UnknownParameter = 1,
        OutOfRange = 2,
        /// It has no parameter, too many, or one twice; or a ramp has no step, or more than a flight has ticks.
        Malformed = 3,
        QueueFull = 4,
        Ended = 5,
    }
}

order!(SwapOrder, "parameters", SwapAnswer, SwapOutcome::ENUM_HASH);

/// Faults in one request, each counted as often as it has inputs.
pub const MOST_AT_ONCE: usize = 16;

layout! {
    /// Faults that begin in one tick, which the plant chooses. The ticks inside of them are not used.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct FaultOrder {
        /// First tick with the faults; `NO_TICK` if the tick is counted from now.
        pub at_tick: u64,
        /// With `at_tick == NO_TICK`: ticks from the plant's present one.
        pub in_ticks: u64,
        /// For how many ticks; `Span::FOR_GOOD` without an end.
        pub for_ticks: u64,
        pub count: u64,
        pub faults: [FaultCode; MOST_AT_ONCE],
    }
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct FaultAnswer {
        /// [`ACCEPTED`] if accepted; else a [`FaultRefusal`], [`MALFORMED`] or [`ENDED`].
        pub verdict: u64,
        pub from: u64,
        /// First tick without the faults; `Span::FOR_GOOD` without an end.
        pub to: u64,
        /// Refused: which of them, from 0 on.
        pub which: u64,
    }
}

layout! {
    /// A target for a vehicle that a ground station flies.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TargetOrder {
        /// Its first tick is the plant's next one.
        pub target: FlightTarget,
        /// 1 if its yaw counts; 0 keeps that of the target before.
        pub has_yaw: u64,
        /// 1 if it holds until the next one; 0 if the plant holds the position when no other target follows in time.
        pub stays: u64,
    }
}

layout! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct TargetAnswer {
        /// [`ACCEPTED`]; [`MALFORMED`] if it is not within its limits, or if no ground station flies this vehicle;
        /// [`ENDED`]; [`BUSY`].
        pub verdict: u64,
    }
}

pub const ACCEPTED: u64 = 0;
/// Verdict: not a fault, none, or too many.
pub const MALFORMED: u64 = 100;
pub const ENDED: u64 = 101;
/// Verdict: too many requests wait.
pub const BUSY: u64 = 102;

order!(
    FaultOrder,
    "injection",
    FaultAnswer,
    FaultRefusal::ENUM_HASH
);
order!(TargetOrder, "targets", TargetAnswer, TargetKind::ENUM_HASH);

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
struct Request<Q: Layout + Debug> {
    /// When it was sent [ns]: no two requests of one client slot have the same. Outside of the check word: the client
    /// takes no reply whose time is damaged.
    sent_ns: u64,
    order: Sealed<Q>,
}

/// A reply, with the time of its request.
///
/// The middleware delivers it to a client's slot, and not to the client (iceoryx2 0.10). Another client may have the slot
/// by then, and must see that the reply is not its own.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
struct Reply<A: Layout + Debug> {
    sent_ns: u64,
    answer: Sealed<A>,
}

type Service<Q> = PortFactory<ipc::Service, Request<Q>, (), Reply<<Q as Order>::Answer>, ()>;

impl Wire {
    fn request_service<Q: Order>(&self) -> Result<Service<Q>, Error> {
        let layouts = hash_of(&[Q::FINGERPRINT, Q::Answer::FINGERPRINT, Q::NAMES]);
        let service = self.service_name(Q::SERVICE)?;
        let (_, layout) = layout_attributes(layouts)?;
        self.open_service(format!("the service `{}`", Q::SERVICE), || {
            self.node
                .service_builder(&service)
                .request_response::<Request<Q>, Reply<Q::Answer>>()
                .max_servers(1)
                .max_clients(CLIENTS)
                .max_active_requests_per_client(1)
                .max_response_buffer_size(1)
                .max_nodes(NODES)
                .open_or_create_with_attributes(&layout)
                .map_err(Refusal::of)
        })
    }

    pub fn server<Q: Order>(&self) -> Result<RequestServer<Q>, Error> {
        Q::server(self)
    }

    pub fn client<Q: Order>(&self) -> Result<RequestClient<Q>, Error> {
        Q::client(self)
    }

    fn request_server<Q: Order>(&self) -> Result<RequestServer<Q>, Error> {
        let service = self.request_service()?;
        let server = service.server_builder().create();
        let server = server.wire(|| format!("cannot serve the service `{}`", Q::SERVICE))?;
        Ok(RequestServer { server, service })
    }

    fn request_client<Q: Order>(&self) -> Result<RequestClient<Q>, Error> {
        let client = self.request_service()?.client_builder().create();
        Ok(RequestClient {
            client: client.wire(|| format!("cannot use the service `{}`", Q::SERVICE))?,
            notifier: self.notifier(Owner::Requests)?,
        })
    }
}

#[derive(Debug)]
pub struct RequestServer<Q: Order> {
    server: Server<ipc::Service, Request<Q>, (), Reply<Q::Answer>, ()>,
    service: Service<Q>,
}

/// A request that has no reply yet.
#[derive(Debug)]
pub struct Call<Q: Order> {
    sent_ns: u64,
    order: Q,
    request: ActiveRequest<ipc::Service, Request<Q>, (), Reply<Q::Answer>, ()>,
}

impl<Q: Order> RequestServer<Q> {
    /// The next request, if one has come. A damaged one is dropped, and its client gets no reply.
    pub fn next(&self) -> Result<Option<Call<Q>>, Error> {
        let failed = || format!("cannot receive from the service `{}`", Q::SERVICE);
        while let Some(request) = self.server.receive().wire(failed)? {
            let Request { sent_ns, order } = *request.payload();
            if let Ok(&order) = order.open() {
                return Ok(Some(Call {
                    sent_ns,
                    order,
                    request,
                }));
            }
        }
        Ok(None)
    }

    /// Whether the client waits for the reply; one that was killed counts until its slot has another client.
    ///
    /// Drop a call that no client awaits before [`Self::next`]: otherwise the middleware takes a client that has come
    /// into the slot for the one that has left, and disconnects it when the call is dropped.
    pub fn is_awaited(&self, call: &Call<Q>) -> bool {
        let origin = call.request.origin();
        let mut is_there = false;
        self.service.dynamic_config().list_clients(|client| {
            is_there |= client.client_id == origin;
            CallbackProgression::Continue
        });
        is_there && call.request.is_connected()
    }
}

impl<Q: Order> Call<Q> {
    pub const fn order(&self) -> Q {
        self.order
    }

    /// Replies. It is no error if the client has gone: the request is on record.
    pub fn reply(self, answer: Q::Answer) {
        let _ = self.request.send_copy(Reply {
            sent_ns: self.sent_ns,
            answer: Sealed::new(answer),
        });
    }
}

#[derive(Debug)]
pub struct RequestClient<Q: Order> {
    client: Client<ipc::Service, Request<Q>, (), Reply<Q::Answer>, ()>,
    notifier: Notifier,
}

impl<Q: Order> RequestClient<Q> {
    pub fn request(&self, order: Q, timeout: Duration) -> Result<Q::Answer, Error> {
        let sent_ns = now_ns();
        let order = Sealed::new(order);
        let pending = self.client.send_copy(Request { sent_ns, order });
        let pending = pending.wire(|| format!("cannot use the service `{}`", Q::SERVICE))?;
        self.notifier.notify()?;
        let until = sent_ns.saturating_add(u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX));
        loop {
            let reply = pending.receive();
            // A copy: shared memory may change between two reads.
            let reply = reply
                .wire(|| "cannot receive the reply".into())?
                .map(|it| *it);
            let reply = reply.filter(|reply| reply.sent_ns == sent_ns);
            if let Some(&answer) = reply.as_ref().and_then(|reply| reply.answer.open().ok()) {
                return Ok(answer);
            }
            if now_ns() >= until {
                let what = format!("the plant did not answer within {timeout:?}");
                return Err(Error::failed(what));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
