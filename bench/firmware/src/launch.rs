//! The firmware's process: found, started in a directory of its own, armed, and ended with the flight.

use std::env;
use std::fs::{self, File};
use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use control_api::description::Refused;
use ironbird_law::Measured;
use process::rt::prepare_child;
use tempfile::TempDir;

use crate::exchange::Exchange;
use crate::sticks::Sticks;
use crate::{PACKET_BYTES, Port};

/// File in its directory that has the firmware's output.
const OUTPUT: &str = "output.txt";
/// How long the switch stays at "armed" or "not armed" while the firmware is to arm.
const SWITCH: Duration = Duration::from_millis(500);
/// A firmware has armed when its motors have turned for so many answers in a row.
const TURNING: u64 = 100;
/// A firmware sends motor commands within this time after its start.
const START: Duration = Duration::from_millis(1500);
const STARTS: u32 = 3;
const POLL: Duration = Duration::from_millis(5);
/// Standard gravity, which the firmware calibrates with.
const GRAVITY_M_S2: f64 = 9.80665;

/// A firmware's process, which ends when this value is dropped or its thread ends.
#[derive(Debug)]
pub struct Program {
    child: Child,
    directory: TempDir,
    ended: Option<ExitStatus>,
}

/// The executable, where the user or `bench/firmware/fetch` has put it.
pub fn executable(port: &Port) -> Result<PathBuf, Refused> {
    let named = env::var_os(port.variable).map(PathBuf::from);
    let cache = || {
        let home = || Some(PathBuf::from(env::var_os("HOME")?).join(".cache"));
        let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
        let folder = cache.or_else(home)?.join("ironbird").join(port.name);
        Some(folder.join(port.executable))
    };
    let path = named.or_else(cache).unwrap_or_default();
    let missing = |what: &Path| {
        Refused(format!(
            "{}: there is no {}; build it with bench/firmware/fetch, or name the executable with {} \
             (docs/firmware.md)",
            port.name,
            what.display(),
            port.variable
        ))
    };
    if !path.is_file() {
        return Err(missing(&path));
    }
    match port
        .files
        .iter()
        .map(|it| path.with_file_name(it))
        .find(|it| !it.is_file())
    {
        Some(file) => Err(missing(&file)),
        None => Ok(path),
    }
}

impl Program {
    /// Starts the program. `priority` is that of SCHED_FIFO; 0 keeps the usual scheduling, also where the kernel refuses.
    pub fn start(port: &Port, executable: &Path, priority: i32) -> Result<Self, Refused> {
        for udp in [port.state_udp, port.remote_udp] {
            drop(UdpSocket::bind((Ipv4Addr::UNSPECIFIED, udp)).map_err(|e| {
                Refused(format!(
                    "{}: UDP port {udp} cannot be used ({e}): another {0} runs; end it first",
                    port.name
                ))
            })?);
        }
        let failed = |e: io::Error| {
            Refused(format!(
                "{}: {} cannot be started: {e}",
                port.name,
                executable.display()
            ))
        };
        let directory = tempfile::Builder::new()
            .prefix("ironbird-firmware-")
            .tempdir()
            .map_err(failed)?;
        for file in port.files {
            let from = executable.with_file_name(file);
            fs::copy(from, directory.path().join(file)).map_err(failed)?;
        }
        let output = File::create(directory.path().join(OUTPUT)).map_err(failed)?;
        let errors = output.try_clone().map_err(failed)?;
        let mut command = Command::new(executable);
        command
            .current_dir(directory.path())
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors);
        // With the default slack of timers of 50 us its loop of 125 us skips every other turn.
        let child = prepare_child(&mut command, priority).spawn();
        let child = child.map_err(failed)?;
        Ok(Self {
            child,
            directory,
            ended: None,
        })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Its exit status, once it has ended.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        if self.ended.is_none() {
            self.ended = self.child.try_wait().ok().flatten();
        }
        self.ended
    }

    /// The last line that it wrote.
    fn last_words(&self) -> String {
        let text = fs::read(self.directory.path().join(OUTPUT)).unwrap_or_default();
        let text = String::from_utf8_lossy(&text).into_owned();
        text.lines().last().unwrap_or_default().to_owned()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A vehicle at rest with throttle 0, for as long as nothing flies: a thread sends its packets, so that the firmware's
/// clock and receiver run.
#[derive(Debug, Default)]
struct AtRest {
    /// Position of the switch.
    armed: AtomicBool,
    /// How far the thread is: [`SENDING`] or [`STOPPED`], else between two packets.
    phase: AtomicU8,
    /// Time of the newest packet [ns].
    time_ns: AtomicU64,
    /// Answers in a row with motors that turn, while the switch is at "armed".
    turning: AtomicU64,
}

const SENDING: u8 = 1;
const STOPPED: u8 = 2;

impl AtRest {
    fn run(&self, port: &Port, exchange: &mut Exchange, period: Duration) {
        let measured = Measured {
            specific_force_b_m_s2: [0.0, 0.0, GRAVITY_M_S2],
            ..Measured::default()
        };
        let begun = Instant::now();
        loop {
            thread::sleep(period);
            // Its time is the clock's, however late this thread wakes up.
            let now = begun.elapsed();
            let sticks = Sticks {
                armed: self.armed.load(Ordering::Relaxed),
                ..Sticks::default()
            };
            if self
                .phase
                .compare_exchange(0, SENDING, Ordering::AcqRel, Ordering::Relaxed)
                .is_err()
            {
                return;
            }
            let write = |stamp_s, [state, remote]: &mut [[u8; PACKET_BYTES]; 2]| {
                [
                    (port.state)(stamp_s, &measured, state),
                    (port.remote)(stamp_s, &sticks, remote),
                ]
            };
            let answer = exchange.ask(now, write, period / 2, period / 2);
            self.time_ns.store(now.as_nanos() as u64, Ordering::Relaxed);
            if let Some(motors) = answer.motors {
                match sticks.armed && motors.iter().all(|motor| *motor > 0.0) {
                    true => self.turning.fetch_add(1, Ordering::Relaxed),
                    false => self.turning.swap(0, Ordering::Relaxed),
                };
            }
            if self
                .phase
                .compare_exchange(SENDING, 0, Ordering::AcqRel, Ordering::Relaxed)
                .is_err()
            {
                return;
            }
        }
    }
}

/// A firmware that has armed, and whose vehicle is at rest until the first tick.
#[derive(Debug)]
pub struct Armed {
    pub program: Program,
    pub exchange: Exchange,
    at_rest: Arc<AtRest>,
}

impl Armed {
    /// Ends the rest. Returns the time of its newest packet. Neither waits nor allocates.
    pub fn take_off(&mut self) -> Duration {
        self.at_rest.phase.store(STOPPED, Ordering::Release);
        let time = Duration::from_nanos(self.at_rest.time_ns.load(Ordering::Relaxed));
        self.exchange.forget(time);
        time
    }
}

impl Drop for Armed {
    fn drop(&mut self) {
        self.at_rest.phase.store(STOPPED, Ordering::Release);
    }
}

/// Starts the firmware, exchanges packets of a vehicle at rest, and waits until it has armed.
pub fn start(
    port: &'static Port,
    executable: &Path,
    priority: i32,
    period: Duration,
    limit: Duration,
) -> Result<Armed, Refused> {
    let exchange = open(port)?;
    let socket = |e: io::Error| Refused(format!("{}: no socket: {e}", port.name));
    let mut of_rest = exchange.try_clone().map_err(socket)?;
    let mut program = started(port, executable, priority, &exchange)?;
    let at_rest = Arc::new(AtRest::default());
    let shared = Arc::clone(&at_rest);
    thread::Builder::new()
        .name("firmware at rest".into())
        .spawn(move || shared.run(port, &mut of_rest, period))
        .map_err(|e| Refused(format!("{}: no thread: {e}", port.name)))?;
    let armed = await_armed(port, &mut program, &at_rest, limit);
    let armed = armed.map(|()| Armed {
        program,
        exchange,
        at_rest: Arc::clone(&at_rest),
    });
    if armed.is_err() {
        at_rest.phase.store(STOPPED, Ordering::Release);
    }
    armed
}

/// Starts the firmware and waits until it sends motor commands of its own accord. A packet that comes before can be its
/// last one: Betaflight receives while it still initialises what receiving uses. Its start itself can hang, so it is
/// tried a few times.
fn started(
    port: &Port,
    executable: &Path,
    priority: i32,
    exchange: &Exchange,
) -> Result<Program, Refused> {
    let mut words = String::new();
    for _ in 0..STARTS {
        let (mut program, begun) = (Program::start(port, executable, priority)?, Instant::now());
        while begun.elapsed() < START {
            if exchange.receive().is_some() {
                return Ok(program);
            }
            if let Some(status) = program.ended() {
                return Err(Refused(format!(
                    "{} ended as it started: {status}; it wrote last: {}",
                    port.name,
                    program.last_words()
                )));
            }
            exchange.wait(POLL);
        }
        words = program.last_words();
    }
    Err(Refused(format!(
        "{} was started {STARTS} times and sent no motor commands within {} s; it wrote last: {words}",
        port.name,
        START.as_secs_f64()
    )))
}

fn await_armed(
    port: &Port,
    program: &mut Program,
    at_rest: &AtRest,
    limit: Duration,
) -> Result<(), Refused> {
    let (begun, mut since, name) = (Instant::now(), Instant::now(), port.name);
    loop {
        if let Some(status) = program.ended() {
            return Err(Refused(format!(
                "{name} ended before it had armed: {status}; it wrote last: {}",
                program.last_words()
            )));
        }
        let turning = at_rest.turning.load(Ordering::Relaxed);
        if turning >= TURNING {
            return Ok(());
        }
        if begun.elapsed() > limit {
            let why = (port.why_not_armed)().unwrap_or_else(|| "it does not say why".into());
            return Err(Refused(format!(
                "{name} has not armed within {} s: {why}",
                limit.as_secs_f64()
            )));
        }
        // An attempt that is refused is over only when the switch has been off.
        if since.elapsed() > SWITCH && turning == 0 {
            at_rest.armed.fetch_xor(true, Ordering::Relaxed);
            since = Instant::now();
        }
        thread::sleep(POLL);
    }
}

/// Opens the sockets to a firmware that no other flight uses.
fn open(port: &Port) -> Result<Exchange, Refused> {
    Exchange::new(port).map_err(|e| match e.kind() {
        io::ErrorKind::AddrInUse => Refused(format!(
            "{0}: UDP port {1} is in use: its ports are fixed, so one flight at a time can use it; end the other one, or \
             use --jobs 1",
            port.name, port.motors_udp
        )),
        _ => Refused(format!("{}: no socket: {e}", port.name)),
    })
}
