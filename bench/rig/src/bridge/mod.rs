//! `ironbird bridge foxglove`: serves a flight over the Foxglove WebSocket protocol.
//!
//! ```text
//! recorder, boards --observe--> channels, parameters --SDK--> door --> Foxglove
//!                            the plant's desk <--inject-- parameter panel, with --allow-swaps
//! ```
//!
//! Topics, schemas and metadata are those of flight.mcap (flight_log); times are ns since 1970.

mod channels;
mod door;
mod parameters;

use std::io::{self, ErrorKind};
use std::net::{Ipv6Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use foxglove::websocket::Status;
use foxglove::{Context, FoxgloveError, WebSocketServer, WebSocketServerHandle};
use model::boards::Ending;
use signal_hook::consts::{SIGINT, SIGTERM};
use wire::error::Error;
use wire::instance::Instance;

use crate::cli::FoxgloveArgs;
use crate::inject::flying;
use crate::observe::Observation;
use crate::output::print;
use crate::roles::remove_leftovers;
use crate::settings::laws;
use channels::Channels;
use door::Door;
use failure::{Failure, INTERRUPTED, OCCUPIED, OK};
use parameters::ParameterMirror;
use report::laws::no_theorem;

/// How often messages are passed on.
const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// How long an instance that flies may take to be joined: roles that start are in the way for an instant.
const JOINING: Duration = Duration::from_secs(2);
/// From a flight's end to the last message that the recorder passes on, with a margin.
const LAST_MESSAGES: Duration = Duration::from_millis(200);
/// How long the SDK may take to send the last status.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Messages that a slow client may fall behind before it loses the oldest: a second of all topics.
const BACKLOG: usize = 4096;

/// Serves a flight until it ends.
///
/// # Errors
/// Nobody flying; as many observers as may be; an address that cannot be listened on.
pub fn foxglove(args: &FoxgloveArgs) -> Result<u8, Failure> {
    let instance = Instance::new(&args.instance)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    }
    let mut observation = join(&instance)?;
    let context = Context::new();
    let laws = laws::shared(&observation.settings)?;
    let mut channels = Channels::new(&context, &observation.run(), &laws)?;
    let desk = Arc::new(ParameterMirror::new(instance.clone(), observation.in_force(), args.allow_swaps));
    let (server, door) = start(args, &context, &desk)?;
    let address = address(&args.host, door.port);
    let swaps = if args.allow_swaps { "whoever reaches it may swap parameters" } else { "read-only" };
    print(&format!("serving instance `{}` on ws://{address}, {swaps}; Ctrl-C ends\n", instance.name()))?;
    if let Some(law) = laws.without_theorem {
        print(&format!("topic theorem stays empty, not applicable: {}\n", no_theorem(law)))?;
    }
    let served = serve(&mut observation, &mut channels, &desk, &server, &stop);
    if let Ok(Some(ending)) = &served {
        server.publish_status(Status::info(format!("the flight has ended: {}", ending.words())));
        // The SDK sends it by itself, and drops what it has not sent when it is stopped.
        sleep(LAST_WORDS);
    }
    server.stop().wait_blocking();
    door.await_empty();
    drop(observation);
    // Where the others have left before.
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
    let until = Instant::now() + JOINING;
    loop {
        // Says who flies instead.
        drop(flying(instance)?);
        match Observation::join(instance) {
            Ok(Some(observation)) => return Ok(observation),
            Err(error @ (Error::Crowded { .. } | Error::Incompatible { .. })) => return Err(error.into()),
            Err(error) if Instant::now() >= until => return Err(error.into()),
            Ok(None) | Err(_) => sleep(DRAIN_EVERY),
        }
    }
}

/// Starts the server and opens its door.
fn start(
    args: &FoxgloveArgs,
    context: &Arc<Context>,
    desk: &Arc<ParameterMirror>,
) -> Result<(WebSocketServerHandle, Door), Failure> {
    // First, because it is what a user can be wrong about.
    let listener = TcpListener::bind((args.host.as_str(), args.port)).map_err(|e| not_listening(args, &e))?;
    let hidden = door::hidden_address();
    let server = WebSocketServer::new()
        .name(format!("ironbird {}", args.instance))
        .context(context)
        .bind(hidden.to_string(), 0)
        .message_backlog_size(BACKLOG)
        .parameter_handler(Arc::<ParameterMirror>::clone(desk))
        .start_blocking()
        .map_err(|e: FoxgloveError| Failure::failed(format!("cannot serve: {e}")))?;
    let door = Door::open(listener, SocketAddr::from((hidden, server.port())), &args.allow_origin)
        .map_err(|e| not_listening(args, &e))?;
    Ok((server, door))
}

fn not_listening(args: &FoxgloveArgs, error: &io::Error) -> Failure {
    let address = address(&args.host, args.port);
    match error.kind() {
        ErrorKind::AddrInUse => Failure::new(OCCUPIED, format!("cannot serve on {address}: the port is in use"))
            .help("end the other server, or name another port; --port 0 takes one that is free"),
        _ => Failure::usage(format!("cannot serve on {address}: {error}"))
            .help("--host is a name or an address of this machine; 127.0.0.1 is for programs on it alone"),
    }
}

fn address(host: &str, port: u16) -> String {
    if host.parse::<Ipv6Addr>().is_ok() { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
}

/// Passes everything on until the flight ends; gives its ending, or nothing when a signal came first.
fn serve(
    observation: &mut Observation,
    channels: &mut Channels,
    desk: &ParameterMirror,
    server: &WebSocketServerHandle,
    stop: &AtomicBool,
) -> Result<Option<Ending>, Failure> {
    let mut ended: Option<Instant> = None;
    while !stop.load(Ordering::Relaxed) {
        observation.drain(|seen| channels.pass_on(seen))?;
        if let Some(values) = desk.look(observation.in_force()) {
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
