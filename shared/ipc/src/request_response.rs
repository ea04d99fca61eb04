//! Questions to the plant's desk, and its answers, over iceoryx2.

use std::fmt::Debug;
use std::time::Duration;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::{CallbackProgression, ZeroCopySend, ipc};
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::request_response::PortFactory;

use super::{NODES, Notifier, Owner, Wire, layout_attributes};
use crate::clock::now_ns;
use crate::error::{Error, Refusal, Tried as _};
use crate::sys::Sealed;
use messages::enum_registry::Fingerprint as _;
use messages::layout::{FNV_OFFSET, Layout, fnv1a};

const CLIENTS: usize = 8;

pub trait Said: Layout + Debug {}
impl<T: Layout + Debug> Said for T {}

pub trait Question: Said {
    const SERVICE: &'static str;
    /// Hash over the words that the answer's numbers stand for.
    const WORDS: u64;
    type Answer: Said;
}

#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
struct Ask<Q: Said> {
    /// When it was sent [ns]: of those that come into one place after each other, no two have the same instant. Outside
    /// the seal: with a damaged one, the answer is not taken.
    asked_ns: u64,
    order: Sealed<Q>,
}

/// An answer on its way.
///
/// The middleware takes it to a client's place, and not to the client (iceoryx2 0.10). Somebody else may have the place
/// by then, and must see that he is not meant.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
struct Reply<A: Said> {
    asked_ns: u64,
    answer: Sealed<A>,
}

type DeskService<Q> = PortFactory<ipc::Service, Ask<Q>, (), Reply<<Q as Question>::Answer>, ()>;

impl Wire {
    fn desk_service<Q: Question>(&self) -> Result<DeskService<Q>, Error> {
        let layouts = [Q::FINGERPRINT, Q::Answer::FINGERPRINT, Q::WORDS]
            .into_iter()
            .fold(FNV_OFFSET, |hash, part| fnv1a(hash, &part.to_le_bytes()));
        let service = self.service_name(Q::SERVICE)?;
        let (_, layout) = layout_attributes(layouts)?;
        self.open_service(format!("the service `{}`", Q::SERVICE), || {
            self.node
                .service_builder(&service)
                .request_response::<Ask<Q>, Reply<Q::Answer>>()
                .max_servers(1)
                .max_clients(CLIENTS)
                .max_active_requests_per_client(1)
                .max_response_buffer_size(1)
                .max_nodes(NODES)
                .open_or_create_with_attributes(&layout)
                .map_err(Refusal::of)
        })
    }

    pub fn desk_server<Q: Question>(&self) -> Result<DeskServer<Q>, Error> {
        let service = self.desk_service()?;
        let server = service
            .server_builder()
            .create()
            .wire(|| format!("cannot serve the service `{}`", Q::SERVICE))?;
        Ok(DeskServer { server, service })
    }

    pub fn desk_client<Q: Question>(&self) -> Result<DeskClient<Q>, Error> {
        let client = self
            .desk_service()?
            .client_builder()
            .create()
            .wire(|| format!("cannot ask the service `{}`", Q::SERVICE))?;
        Ok(DeskClient {
            client,
            bell: self.bell(Owner::Desk)?,
        })
    }
}

#[derive(Debug)]
pub struct DeskServer<Q: Question> {
    server: Server<ipc::Service, Ask<Q>, (), Reply<Q::Answer>, ()>,
    service: DeskService<Q>,
}

#[derive(Debug)]
pub struct DeskCall<Q: Question> {
    asked_ns: u64,
    order: Q,
    request: ActiveRequest<ipc::Service, Ask<Q>, (), Reply<Q::Answer>, ()>,
}

impl<Q: Question> DeskServer<Q> {
    /// The next order, if one has come. One that was damaged on its way is dropped, and its client gets no answer.
    pub fn next(&self) -> Result<Option<DeskCall<Q>>, Error> {
        let failed = || format!("cannot receive from the service `{}`", Q::SERVICE);
        while let Some(request) = self.server.receive().wire(failed)? {
            let Ask { asked_ns, order } = *request.payload();
            if let Ok(&order) = order.open() {
                return Ok(Some(DeskCall {
                    asked_ns,
                    order,
                    request,
                }));
            }
        }
        Ok(None)
    }

    /// Whether the one who asked waits for the answer; one that was killed counts until somebody else comes.
    ///
    /// A call that nobody awaits is to be dropped before [`Self::next`] is asked: the middleware would take a client
    /// that has come into its place for the one that has left, and cut it off when the call is dropped.
    pub fn is_awaited(&self, call: &DeskCall<Q>) -> bool {
        let asked = call.request.origin();
        let mut is_there = false;
        self.service.dynamic_config().list_clients(|client| {
            is_there |= client.client_id == asked;
            CallbackProgression::Continue
        });
        is_there && call.request.is_connected()
    }
}

impl<Q: Question> DeskCall<Q> {
    pub const fn order(&self) -> Q {
        self.order
    }

    /// Answers. It is no error if the client has gone.
    pub fn answer(self, answer: Q::Answer) {
        let reply = Reply {
            asked_ns: self.asked_ns,
            answer: Sealed::new(answer),
        };
        // Nobody is left to tell if this fails, and what was asked for is on record.
        let _ = self.request.send_copy(reply);
    }
}

#[derive(Debug)]
pub struct DeskClient<Q: Question> {
    client: Client<ipc::Service, Ask<Q>, (), Reply<Q::Answer>, ()>,
    bell: Notifier,
}

impl<Q: Question> DeskClient<Q> {
    /// Asks, and waits for the answer until `patience` has passed.
    pub fn ask(&self, order: Q, patience: Duration) -> Result<Q::Answer, Error> {
        let asked_ns = now_ns();
        let pending: PendingResponse<_, _, _, _, _> = self
            .client
            .send_copy(Ask {
                asked_ns,
                order: Sealed::new(order),
            })
            .wire(|| format!("cannot ask the service `{}`", Q::SERVICE))?;
        self.bell.ring()?;
        let until = asked_ns.saturating_add(u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX));
        loop {
            let reply = pending
                .receive()
                .wire(|| "cannot receive the answer".into())?;
            // A copy: what lies in shared memory may change between two looks.
            let ours = reply
                .map(|reply| *reply)
                .filter(|reply| reply.asked_ns == asked_ns);
            if let Some(&answer) = ours.as_ref().and_then(|reply| reply.answer.open().ok()) {
                return Ok(answer);
            }
            if now_ns() >= until {
                return Err(Error::Absent {
                    what: format!("the plant did not answer within {patience:?}"),
                });
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
