//! `ironbird bridge foxglove`: serves a flight over the Foxglove WebSocket protocol.
//!
//! ```text
//! recorder, blackboards --observe--> channels, parameters --SDK--> proxy --> Foxglove
//!                the plant's parameter server <--inject-- parameter panel, with --allow-swaps
//! ```
//!
//! Topics, schemas and metadata are those of flight.mcap (flight_log); times are ns since 1970.

mod channels;
mod origin_proxy;
mod parameters;

use std::io::{self, ErrorKind};
use std::net::{Ipv6Addr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::Duration;

use foxglove::websocket::Status;
use foxglove::{Context, FoxgloveError, WebSocketServer, WebSocketServerHandle};
use ipc::instance::Instance;
use messages::blackboards::EndReason;

use crate::observation::{DRAIN_EVERY, Observation};
use analysis::theorem::no_theorem;
use channels::Channels;
use config::Settings;
use errors::output::print;
use errors::{Failure, INTERRUPTED, OCCUPIED};
use origin_proxy::{LIMITS, OriginProxy, hidden_address};
use parameters::ParameterMirror;
use process::signals::stop_flag;
use recorder::kernel_trace::remove_leftovers;

/// How often to look for a flight.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Messages that a slow client may fall behind before it loses the oldest: a second of all topics.
const BACKLOG: usize = 4096;

#[derive(Clone, Debug)]
pub struct FoxgloveOptions {
    pub instance: String,
    pub host: String,
    /// 0 takes a free one.
    pub port: u16,
    /// Whether every client that reaches the address may change parameters and inject faults.
    pub allow_swaps: bool,
    /// Origins of web pages that are accepted besides the usual ones.
    pub allow_origin: Vec<String>,
}

/// Serves one flight of the instance after the other, until a signal comes.
pub fn foxglove(options: &FoxgloveOptions) -> Result<u8, Failure> {
    let instance = Instance::new(&options.instance)?;
    let stop = stop_flag()?;
    let context = Context::new();
    let mirror = Arc::new(ParameterMirror {
        instance: instance.clone(),
        active: Mutex::default(),
        allows_swaps: options.allow_swaps,
    });
    let (server, proxy) = start(options, &context, &mirror)?;
    let address = address(&options.host, proxy.port);
    let access = match options.allow_swaps {
        true => "every client may change parameters",
        false => "read-only",
    };
    let name = instance.name();
    print(&format!(
        "serving instance `{name}` on ws://{address}, {access}; Ctrl-C ends\n"
    ))?;
    let served = serve(&instance, &context, &mirror, &server, &stop);
    server.stop().wait_blocking();
    proxy.await_empty();
    served.map(|()| INTERRUPTED)
}

/// Waits for flights, and serves each until it ends. The channels of a flight stay until the next one begins.
fn serve(
    instance: &Instance,
    context: &Arc<Context>,
    mirror: &ParameterMirror,
    server: &WebSocketServerHandle,
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let (mut failed, mut before) = (0, None::<Channels>);
    while !stop.load(Ordering::Relaxed) {
        let Some(mut observation) = Observation::join(instance, &mut failed)? else {
            sleep(LOOK_EVERY);
            continue;
        };
        if let Some(channels) = before.take() {
            channels.close();
        }
        let laws = Settings::of_shared(&observation.settings)?.flown_laws()?;
        let mut channels = Channels::new(context, &observation.run(), &laws)?;
        print("serving a flight\n")?;
        if let Some(why) = laws.without_theorem.map(no_theorem) {
            print(&format!(
                "topic theorem stays empty, not applicable: {why}\n"
            ))?;
        }
        let ending = serve_flight(&mut observation, &mut channels, mirror, server, stop);
        drop(observation);
        // If all other processes have ended before.
        remove_leftovers(instance);
        if let Some(ending) = ending? {
            let ended = format!("the flight has ended: {}", ending.name());
            server.publish_status(Status::info(&ended));
            print(&format!("{ended}\n"))?;
        }
        before = Some(channels);
    }
    Ok(())
}

fn start(
    options: &FoxgloveOptions,
    context: &Arc<Context>,
    mirror: &Arc<ParameterMirror>,
) -> Result<(WebSocketServerHandle, OriginProxy), Failure> {
    let not_listening = |e: io::Error| not_listening(options, &e);
    // First, because the address is what a user can get wrong.
    let listener =
        TcpListener::bind((options.host.as_str(), options.port)).map_err(not_listening)?;
    let hidden = hidden_address();
    let server = WebSocketServer::new()
        .name(format!("ironbird {}", options.instance))
        .context(context)
        .bind(hidden.to_string(), 0)
        .message_backlog_size(BACKLOG)
        .parameter_handler(Arc::<ParameterMirror>::clone(mirror))
        .start_blocking()
        .map_err(|e: FoxgloveError| Failure::failed(format!("cannot serve: {e}")))?;
    let address = SocketAddr::from((hidden, server.port()));
    let proxy = OriginProxy::open(listener, address, &options.allow_origin, LIMITS);
    Ok((server, proxy.map_err(not_listening)?))
}

fn not_listening(options: &FoxgloveOptions, error: &io::Error) -> Failure {
    let address = address(&options.host, options.port);
    if error.kind() == ErrorKind::AddrInUse {
        let what = format!("cannot serve on {address}: the port is in use");
        return Failure::new(OCCUPIED, what)
            .help("end the other server, or name another port; --port 0 takes one that is free");
    }
    Failure::usage(format!("cannot serve on {address}: {error}")).help(
        "--host is a name or an address of this machine; 127.0.0.1 is for programs on it alone",
    )
}

fn address(host: &str, port: u16) -> String {
    match host.parse::<Ipv6Addr>() {
        Ok(_) => format!("[{host}]:{port}"),
        Err(_) => format!("{host}:{port}"),
    }
}

/// Serves until the flight ends; returns why it ended, or `None` if a signal came first.
fn serve_flight(
    observation: &mut Observation,
    channels: &mut Channels,
    mirror: &ParameterMirror,
    server: &WebSocketServerHandle,
    stop: &AtomicBool,
) -> Result<Option<EndReason>, Failure> {
    while !stop.load(Ordering::Relaxed) {
        observation.drain(|entry| channels.pass_on(entry))?;
        if let Some(values) = mirror.update(observation.active_parameters()) {
            server.publish_parameter_values(values);
        }
        if let Some(ending) = observation.ending_after_last_messages() {
            return Ok(Some(ending));
        }
        sleep(DRAIN_EVERY);
    }
    Ok(None)
}
