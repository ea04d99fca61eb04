//! The firmware's process: found, started in a directory of its own or waited for, armed, and ended with the flight.

use std::env;
use std::fmt::Display;
use std::fs::{self, File, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use control_api::description::Refused;
use ironbird_law::Measured;
use process::rt::prepare_child;
use rustix::process::geteuid;
use tempfile::TempDir;

use crate::Port;
use crate::bridge::UDP_PORT;
use crate::exchange::Exchange;
use crate::sticks::Sticks;

/// Prefix of the folders of firmwares; the id of the flight's process follows.
const FOLDER: &str = "ironbird-firmware-";
/// File in its directory that has the firmware's output.
const OUTPUT: &str = "output.txt";
/// How long the switch stays at "armed" or "not armed" while the firmware is to arm.
const SWITCH: Duration = Duration::from_millis(500);
/// A firmware has armed when so many answers in a row say so.
const ARMED: u64 = 100;
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
}

/// The executable, where the user or `bench/firmware/fetch` has put it; none of a firmware that the user starts.
pub fn executable(port: &Port) -> Result<Option<PathBuf>, Refused> {
    let named = env::var_os(port.variable).map(PathBuf::from);
    let Some((executable, files)) = port.cached else {
        return Ok(named);
    };
    let cache = || {
        let home = || Some(PathBuf::from(env::var_os("HOME")?).join(".cache"));
        let cache = env::var_os("XDG_CACHE_HOME").filter(|it| !it.is_empty());
        let cache = cache.map(PathBuf::from);
        let folder = cache.or_else(home)?.join("ironbird");
        Some(folder.join(port.description.name).join(executable))
    };
    let path = named.or_else(cache).unwrap_or_default();
    // The firmware starts in a directory of its own.
    let path = std::path::absolute(&path).unwrap_or(path);
    let beside = files.iter().map(|it| path.with_file_name(it));
    match [path.clone()]
        .into_iter()
        .chain(beside)
        .find(|it| !it.is_file())
    {
        Some(missing) => Err(Refused(format!(
            "{}: there is no {}; build it with bench/firmware/fetch, or name the executable with {} \
             (`ironbird docs firmware`)",
            port.description.name,
            missing.display(),
            port.variable
        ))),
        None => Ok(Some(path)),
    }
}

/// Removes the folders of flights whose process was killed.
fn remove_leftovers() {
    for entry in fs::read_dir(env::temp_dir())
        .into_iter()
        .flatten()
        .flatten()
    {
        let name = entry.file_name();
        let of = name.to_str().and_then(|it| it.strip_prefix(FOLDER));
        let is_own = |it: Metadata| it.is_dir() && it.uid() == geteuid().as_raw();
        if let Some((process, _)) = of.and_then(|it| it.split_once('-'))
            && process.parse::<u32>().is_ok()
            && entry.metadata().is_ok_and(is_own)
            // One that has ended and is not waited for has no program either.
            && fs::read_link(format!("/proc/{process}/exe"))
                .is_err_and(|e| e.kind() == io::ErrorKind::NotFound)
        {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

impl Program {
    /// Starts the program. `priority` is that of SCHED_FIFO; 0 keeps the usual scheduling, also where the kernel refuses.
    pub fn start(port: &Port, executable: &Path, priority: i32) -> Result<Self, Refused> {
        let failed = |e: io::Error| {
            Refused(format!(
                "{}: {} cannot be started: {e}; {} names another executable",
                port.description.name,
                executable.display(),
                port.variable
            ))
        };
        remove_leftovers();
        let directory = tempfile::Builder::new()
            .prefix(&format!("{FOLDER}{}-", std::process::id()))
            .tempdir()
            .map_err(failed)?;
        for file in port.cached.map_or(&[][..], |(_, files)| files) {
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
        Ok(Self { child, directory })
    }

    /// Its exit status, once it has ended.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// The last line that it wrote.
    fn last_words(&self) -> String {
        let text = fs::read(self.directory.path().join(OUTPUT)).unwrap_or_default();
        let text = String::from_utf8_lossy(&text).into_owned();
        let last = text.lines().last();
        last.map_or("it wrote nothing".into(), |last| {
            format!("it wrote last: {last}")
        })
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
    /// Answers in a row of a firmware that has armed.
    armed_for: AtomicU64,
    has_gone: AtomicBool,
}

const SENDING: u8 = 1;
const STOPPED: u8 = 2;

impl AtRest {
    fn run(&self, port: &Port, exchange: &mut Exchange, period: Duration) {
        let measured = Measured {
            specific_force_b_m_s2: [0.0, 0.0, GRAVITY_M_S2],
            ..Measured::default()
        };
        let moves = |from, to| {
            let (set, failed) = (Ordering::AcqRel, Ordering::Relaxed);
            self.phase.compare_exchange(from, to, set, failed).is_ok()
        };
        let (begun, spacing) = (Instant::now(), port.answers_each.then_some(period / 2));
        loop {
            thread::sleep(period);
            // Its time is the clock's, however late this thread wakes up.
            let now = begun.elapsed();
            let sticks = Sticks {
                armed: self.armed.load(Ordering::Relaxed),
                ..Sticks::default()
            };
            if !moves(0, SENDING) {
                return;
            }
            let answer = exchange.ask(now, (&measured, &sticks), spacing, period / 2);
            self.time_ns.store(now.as_nanos() as u64, Ordering::Relaxed);
            self.has_gone.store(exchange.gone, Ordering::Relaxed);
            if let Some(motors) = answer.motors {
                match motors.is_armed {
                    true => self.armed_for.fetch_add(1, Ordering::Relaxed),
                    false => self.armed_for.swap(0, Ordering::Relaxed),
                };
            }
            if !moves(SENDING, 0) {
                return;
            }
        }
    }
}

/// A firmware that has armed, and whose vehicle is at rest until the first tick.
pub struct Armed {
    /// None of one that the user has started.
    pub program: Option<Program>,
    pub exchange: Exchange,
    at_rest: Arc<AtRest>,
}

impl Armed {
    /// Ends the rest. Returns the time of its newest packet, whose answer may come within a period. Neither waits nor
    /// allocates.
    pub fn take_off(&mut self, period: Duration) -> Duration {
        let is_sending = self.at_rest.phase.swap(STOPPED, Ordering::AcqRel) == SENDING;
        let time = Duration::from_nanos(self.at_rest.time_ns.load(Ordering::Relaxed));
        let answered = is_sending.then(|| Instant::now() + period);
        self.exchange.forget(time, answered);
        time
    }

    pub fn has_ended(&mut self) -> bool {
        let program = self.program.as_mut();
        self.exchange.gone || program.is_some_and(|program| program.ended().is_some())
    }
}

impl Drop for Armed {
    fn drop(&mut self) {
        self.at_rest.phase.store(STOPPED, Ordering::Release);
    }
}

/// How a firmware is started, or waited for.
#[derive(Clone, Debug)]
pub struct Launch {
    pub port: &'static Port,
    /// Number of its first port.
    pub number: u16,
    /// None of a firmware that the user starts.
    pub executable: Option<PathBuf>,
    pub priority: i32,
    pub period: Duration,
    /// Longest wait until it has armed, and until one has come that the user starts.
    pub limit: Duration,
}

impl Launch {
    /// Starts the firmware or waits for it, exchanges packets of a vehicle at rest, and waits until it has armed.
    pub fn start(&self, comes_by_the_clock: bool) -> Result<Armed, Refused> {
        let port = self.port;
        let link = (port.open)(self.number).map_err(|e| match e.kind() {
            io::ErrorKind::AddrInUse => self.in_use(),
            _ => self.refused(format!("no socket: {e}")),
        })?;
        let mut exchange = Exchange::new(port, link);
        let priority = if comes_by_the_clock { self.priority } else { 0 };
        let program = self.heard(priority, &mut exchange)?;
        let socket = |e: io::Error| self.refused(format!("no socket: {e}"));
        let mut of_rest = exchange.try_clone(port).map_err(socket)?;
        let at_rest = Arc::new(AtRest::default());
        let mut firmware = Armed {
            program,
            exchange,
            at_rest: Arc::clone(&at_rest),
        };
        let period = self.period;
        thread::Builder::new()
            .name("firmware at rest".into())
            .spawn(move || at_rest.run(port, &mut of_rest, period))
            .map_err(|e| self.refused(format!("no thread: {e}")))?;
        self.await_armed(&mut firmware)?;
        Ok(firmware)
    }

    fn in_use(&self) -> Refused {
        let mut settings = self.port.description.settings.iter();
        let other = match settings.any(|it| it.name == UDP_PORT.name) {
            true => "use another port (--set inner.port=NUMBER)",
            false => "wait until it has ended",
        };
        let ports = self.number..self.number.saturating_add(self.port.ports);
        let holder = ports
            .clone()
            .find_map(holder)
            .unwrap_or_else(|| "another flight or another firmware".into());
        let ports: Vec<String> = ports.map(|port| port.to_string()).collect();
        self.refused(format!(
            "port {} is in use by {holder}: end it, or {other}",
            ports.join(" or ")
        ))
    }

    fn refused(&self, why: impl Display) -> Refused {
        Refused(format!("{}: {why}", self.port.description.name))
    }

    /// Refuses a program that has ended.
    fn check(&self, program: Option<&mut Program>, ended: &str) -> Result<(), Refused> {
        let Some(program) = program else {
            return Ok(());
        };
        program.ended().map_or(Ok(()), |status| {
            let words = program.last_words();
            Err(self.refused(format!("{ended}: {status}; {words}")))
        })
    }

    /// Starts the firmware, or waits for one that the user starts, until it sends something of its own accord. A packet
    /// that comes before can be its last one: Betaflight receives while it still initialises what receiving uses. Its
    /// start itself can hang, so it is tried a few times.
    fn heard(&self, priority: i32, exchange: &mut Exchange) -> Result<Option<Program>, Refused> {
        let (starts, limit) = match self.port.is_lockstep {
            true => (1, self.limit),
            false => (STARTS, START),
        };
        let mut words = None;
        for _ in 0..starts {
            let start = |executable: &PathBuf| Program::start(self.port, executable, priority);
            let mut program = self.executable.as_ref().map(start).transpose()?;
            let begun = Instant::now();
            while begun.elapsed() < limit {
                exchange.receive();
                if exchange.heard {
                    return Ok(program);
                }
                self.check(program.as_mut(), "it ended as it started")?;
                exchange.wait(POLL);
            }
            words = program.map(|program| program.last_words());
        }
        let limit_s = limit.as_secs_f64();
        Err(self.refused(match words {
            Some(words) => format!(
                "it sent no motor commands within {limit_s} s of its start (attempts: {starts}); {words}"
            ),
            None => format!(
                "no firmware has connected to port {} within {limit_s} s: start it beside the flight (`ironbird docs firmware`), or wait \
                 longer with --set inner.arming_limit_s=SECONDS",
                self.number
            ),
        }))
    }

    fn await_armed(&self, firmware: &mut Armed) -> Result<(), Refused> {
        let (begun, mut since) = (Instant::now(), Instant::now());
        loop {
            let ended = "it ended before it had armed";
            self.check(firmware.program.as_mut(), ended)?;
            if firmware.at_rest.has_gone.load(Ordering::Relaxed) {
                return Err(self.refused(ended));
            }
            let armed_for = firmware.at_rest.armed_for.load(Ordering::Relaxed);
            if armed_for >= ARMED {
                return Ok(());
            }
            if begun.elapsed() > self.limit {
                let why =
                    (self.port.why_not_armed)().unwrap_or_else(|| "it does not say why".into());
                let limit_s = self.limit.as_secs_f64();
                return Err(self.refused(format!(
                    "it has not armed within {limit_s} s: {why}; fly on an idle machine, or wait longer with --set \
                     inner.arming_limit_s=SECONDS"
                )));
            }
            // An attempt that is refused is over only when the switch has been off.
            if since.elapsed() > SWITCH && armed_for == 0 {
                firmware.at_rest.armed.fetch_xor(true, Ordering::Relaxed);
                since = Instant::now();
            }
            thread::sleep(POLL);
        }
    }
}

/// Name and number of the process that uses a port, where the kernel shows it.
fn holder(port: u16) -> Option<String> {
    let of_port = |line: &str| {
        let mut fields = line.split_whitespace();
        let other = fields.nth(1)?.rsplit_once(':')?.1;
        let is_it = u16::from_str_radix(other, 16) == Ok(port);
        let inode = fields.nth(7).filter(|_| is_it)?;
        Some(PathBuf::from(format!("socket:[{inode}]")))
    };
    let tables = ["/proc/net/udp", "/proc/net/tcp"].map(fs::read_to_string);
    let tables = tables.into_iter().flatten().collect::<String>();
    let sockets: Vec<PathBuf> = tables.lines().filter_map(of_port).collect();
    let has_one = |process: &Path| {
        let files = fs::read_dir(process.join("fd")).into_iter().flatten();
        let mut links = files.flatten().map(|file| fs::read_link(file.path()));
        links.any(|link| link.is_ok_and(|link| sockets.contains(&link)))
    };
    let entries = fs::read_dir("/proc").ok()?.flatten();
    let mut processes = entries.filter_map(|it| it.file_name().to_str()?.parse::<u32>().ok());
    let id = processes.find(|id| has_one(&Path::new("/proc").join(id.to_string())))?;
    let name = fs::read_to_string(format!("/proc/{id}/comm")).ok()?;
    Some(format!("{} (process {id})", name.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_processes_that_are_gone_are_removed_and_those_of_others_stay() {
        let mut ended = Command::new("true").spawn().unwrap();
        let running = || fs::read_link(format!("/proc/{}/exe", ended.id())).is_ok();
        while running() {
            thread::sleep(POLL);
        }
        let folder = |process: u32| {
            let folder = env::temp_dir().join(format!("{FOLDER}{process}-test"));
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(OUTPUT), "text").unwrap();
            folder
        };
        let [left, own] = [ended.id(), std::process::id()].map(folder);
        // A folder of this name that no flight has made.
        let other = env::temp_dir().join(format!("{FOLDER}abc-{}", std::process::id()));
        fs::create_dir_all(&other).unwrap();
        remove_leftovers();
        assert!(!left.exists());
        assert!(own.exists() && other.exists());
        ended.wait().unwrap();
        for it in [own, other] {
            fs::remove_dir_all(it).unwrap();
        }
    }
}
