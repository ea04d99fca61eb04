//! `ironbird bridge foxglove`: serves a flight over the Foxglove WebSocket protocol.
//!
//! ```text
//! recorder, boards --observe--> channels, parameters --SDK--> proxy --> Foxglove
//!                            the plant's server <--inject-- parameter panel, with --allow-swaps
//! ```
//!
//! Topics, schemas and metadata are those of flight.mcap (flight_log); times are ns since 1970.

mod channels;
mod origin_proxy;
mod parameters;

use std::io::{self, ErrorKind};
use std::net::{Ipv6Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use foxglove::websocket::Status;
use foxglove::{Context, FoxgloveError, WebSocketServer, WebSocketServerHandle};
use ipc::error::Error;
use ipc::instance::Instance;
use messages::blackboards::EndReason;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::cli::FoxgloveArgs;
use crate::inject::flying;
use crate::observation::Observation;
use crate::output::print;
use crate::record::kernel_trace::remove_leftovers;
use crate::settings::law_settings;
use channels::Channels;
use errors::{Failure, INTERRUPTED, OCCUPIED, OK};
use origin_proxy::{OriginProxy, hidden_address};
use parameters::ParameterMirror;
use report::laws::no_theorem;

/// How often messages are passed on.
const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// How long it may take to join a flying instance: roles that start are in the way for an instant.
const JOIN_TIMEOUT: Duration = Duration::from_secs(2);
/// From a flight's end to the last message that the recorder passes on, with a margin.
const LAST_MESSAGES: Duration = Duration::from_millis(200);
/// How long the SDK may take to send the last status.
const FINAL_STATUS: Duration = Duration::from_millis(200);
/// Messages that a slow client may fall behind before it loses the oldest: a second of all topics.
const BACKLOG: usize = 4096;

/// Serves a flight until it ends.
pub fn foxglove(args: &FoxgloveArgs) -> Result<u8, Failure> {
    let instance = Instance::new(&args.instance)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    let mut observation = join(&instance)?;
    let context = Context::new();
    let laws = law_settings::shared(&observation.settings)?;
    let mut channels = Channels::new(&context, &observation.run(), &laws)?;
    let parameters = Arc::new(ParameterMirror::new(
        instance.clone(),
        observation.in_force(),
        args.allow_swaps,
    ));
    let (server, proxy) = start(args, &context, &parameters)?;
    let address = address(&args.host, proxy.port);
    let swaps = if args.allow_swaps {
        "whoever reaches it may swap parameters"
    } else {
        "read-only"
    };
    print(&format!(
        "serving instance `{}` on ws://{address}, {swaps}; Ctrl-C ends\n",
        instance.name()
    ))?;
    if let Some(law) = laws.without_theorem {
        print(&format!(
            "topic theorem stays empty, not applicable: {}\n",
            no_theorem(law)
        ))?;
    }
    let served = serve(&mut observation, &mut channels, &parameters, &server, &stop);
    if let Ok(Some(ending)) = &served {
        server.publish_status(Status::info(format!(
            "the flight has ended: {}",
            ending.words()
        )));
        // The SDK sends it by itself, and drops what it has not sent when it is stopped.
        sleep(FINAL_STATUS);
    }
    server.stop().wait_blocking();
    proxy.await_empty();
    drop(observation);
    // If all other processes have ended before.
    remove_leftovers(&instance);
    match served? {
        Some(ending) => {
            print(&format!("the flight has ended: {}\n", ending.words()))?;
            Ok(OK)
        }
        None => Ok(INTERRUPTED),
    }
}

fn join(instance: &Instance) -> Result<Observation, Failure> {
    let until = Instant::now() + JOIN_TIMEOUT;
    loop {
        // Its error names the instances that fly.
        drop(flying(instance)?);
        match Observation::join(instance) {
            Ok(Some(observation)) => return Ok(observation),
            Err(error @ (Error::Crowded { .. } | Error::Incompatible { .. })) => {
                return Err(error.into());
            }
            Err(error) if Instant::now() >= until => return Err(error.into()),
            Ok(None) | Err(_) => sleep(DRAIN_EVERY),
        }
    }
}

/// Starts the server, and the proxy before it.
fn start(
    args: &FoxgloveArgs,
    context: &Arc<Context>,
    parameters: &Arc<ParameterMirror>,
) -> Result<(WebSocketServerHandle, OriginProxy), Failure> {
    // First, because it is what a user can be wrong about.
    let listener =
        TcpListener::bind((args.host.as_str(), args.port)).map_err(|e| not_listening(args, &e))?;
    let hidden = hidden_address();
    let server = WebSocketServer::new()
        .name(format!("ironbird {}", args.instance))
        .context(context)
        .bind(hidden.to_string(), 0)
        .message_backlog_size(BACKLOG)
        .parameter_handler(Arc::<ParameterMirror>::clone(parameters))
        .start_blocking()
        .map_err(|e: FoxgloveError| Failure::failed(format!("cannot serve: {e}")))?;
    let proxy = OriginProxy::open(
        listener,
        SocketAddr::from((hidden, server.port())),
        &args.allow_origin,
    )
    .map_err(|e| not_listening(args, &e))?;
    Ok((server, proxy))
}

fn not_listening(args: &FoxgloveArgs, error: &io::Error) -> Failure {
    let address = address(&args.host, args.port);
    match error.kind() {
        ErrorKind::AddrInUse => Failure::new(
            OCCUPIED,
            format!("cannot serve on {address}: the port is in use"),
        )
        .help("end the other server, or name another port; --port 0 takes one that is free"),
        _ => Failure::usage(format!("cannot serve on {address}: {error}")).help(
            "--host is a name or an address of this machine; 127.0.0.1 is for programs on it alone",
        ),
    }
}

fn address(host: &str, port: u16) -> String {
    if host.parse::<Ipv6Addr>().is_ok() {
        format!("[{host}]:{port}")
    } else {
        format!("{host}:{port}")
    }
}

/// Serves until the flight ends; returns why it ended, or `None` if a signal came first.
fn serve(
    observation: &mut Observation,
    channels: &mut Channels,
    parameters: &ParameterMirror,
    server: &WebSocketServerHandle,
    stop: &AtomicBool,
) -> Result<Option<EndReason>, Failure> {
    let mut ended: Option<Instant> = None;
    while !stop.load(Ordering::Relaxed) {
        observation.drain(|seen| channels.pass_on(seen))?;
        if let Some(values) = parameters.update(observation.in_force()) {
            server.publish_parameter_values(values);
        }
        let ending = observation.ending();
        if ending.is_some() && ended.get_or_insert_with(Instant::now).elapsed() >= LAST_MESSAGES {
            return Ok(ending);
        }
        sleep(DRAIN_EVERY);
    }
    Ok(None)
}
