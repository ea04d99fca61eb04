//! A rig for one test: own root, own output, own instance, own processes.

pub mod client;
mod role_process;
mod system;
pub mod unprivileged;

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex};

use analysis::schema::Report;
use flight_log::entry::LogEntry;
use flight_log::reader::{End, LogReader};
use ipc::Wire;
use ipc::instance::Instance;
use messages::blackboards::{ActiveParameters, IN_FORCE, RUN, Run, RunPhase};
use messages::content::NO_TICK;
use messages::role::{Role, STAGES};
use rustix::fs::StatVfsMountFlags;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

pub use role_process::{Ended, Running, squeezed};
pub use system::{command_line, is_gone, processes, send, signal_of, stop_for, wait_until};
use system::{hear_signals, names};

/// The executable under test: the one that the variable IRONBIRD names, else the release build if it is up to date, else
/// the one that cargo built beside the tests.
pub fn ironbird() -> &'static str {
    static CHOSEN: LazyLock<String> = LazyLock::new(|| {
        let named = std::env::var("IRONBIRD").ok();
        let chosen = named.or_else(release_build_if_up_to_date);
        chosen.unwrap_or_else(|| BUILT_WITH_TESTS.into())
    });
    &CHOSEN
}

/// The release build beside that of the tests, if it is newer than all files of which cargo made it.
fn release_build_if_up_to_date() -> Option<String> {
    let modified = |path: &Path| fs::metadata(path).and_then(|it| it.modified()).ok();
    let release = Path::new(BUILT_WITH_TESTS)
        .parent()?
        .with_file_name("release/ironbird");
    let built = modified(&release)?;
    let sources = fs::read_to_string(release.with_extension("d")).ok()?;
    let (_, sources) = sources.split_once(": ")?;
    let is_older = |source: &str| modified(Path::new(source)).is_some_and(|at| at <= built);
    let is_up_to_date = sources.split_whitespace().all(is_older);
    is_up_to_date.then(|| release.to_str().map(str::to_owned))?
}

/// Has the features of the tests.
pub const BUILT_WITH_TESTS: &str = env!("CARGO_BIN_EXE_ironbird");

/// Copies the executable by another process: while this one held the copy open to write, a child that another test's
/// thread starts would hold it open too, and the copy could not be run ("text file busy").
pub fn copy_executable(to: &Path) {
    let copied = Command::new("cp").arg(ironbird()).arg(to).status().unwrap();
    assert!(copied.success());
}

/// Settings of a flight that nothing ends early, however busy the machine is.
pub const SKY: &str =
    "[flight]\nground_z_m = -1000.0\nposition_error_max_m = 1000.0\ntilt_max_rad = 3.14\n";

pub struct Rig {
    executable: &'static str,
    directory: TempDir,
    pub instance: String,
    started: AtomicU64,
}

impl Rig {
    pub fn with_features(name: &str) -> Self {
        let mut rig = Self::new(name);
        rig.executable = BUILT_WITH_TESTS;
        rig
    }

    /// In memory, or on disk if that is noexec or almost full. `name`, of at most 16 characters, starts the instance's name.
    pub fn new(name: &str) -> Self {
        let memory = rustix::fs::statvfs("/dev/shm").unwrap();
        let is_noexec = memory.f_flag.contains(StatVfsMountFlags::NOEXEC);
        match is_noexec || memory.f_bavail * memory.f_frsize < 1 << 30 {
            true => Self::below("/tmp", name),
            false => Self::below("/dev/shm", name),
        }
    }

    /// `parent` holds the rig's directory; its path is short, as those of sockets have to be.
    pub fn below(parent: &str, name: &str) -> Self {
        hear_signals();
        // Tests of one file run side by side, in one process.
        static RIGS: AtomicU64 = AtomicU64::new(0);
        let directory = tempfile::Builder::new()
            .prefix("ib")
            .tempdir_in(parent)
            .unwrap();
        let number = RIGS.fetch_add(1, Ordering::Relaxed);
        Self {
            executable: ironbird(),
            directory,
            instance: format!("{name}-{}-{number}", std::process::id()),
            started: AtomicU64::new(0),
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The same as text, to be handed over as an argument.
    pub fn file(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    pub fn root(&self) -> PathBuf {
        self.path("r")
    }

    /// The instance as the processes know it.
    pub fn known(&self) -> Instance {
        Instance::under(&self.root(), &self.instance).unwrap()
    }

    pub fn out(&self) -> PathBuf {
        self.path("out")
    }

    pub fn settings(&self, text: &str) -> String {
        let path = self.file(&format!(
            "settings{}.toml",
            self.started.fetch_add(1, Ordering::Relaxed)
        ));
        fs::write(&path, text).unwrap();
        path
    }

    /// Settings of slow motion: a tick takes `slowdown` ms, so that a stall of the machine misses no deadline. Without a
    /// ground, on which an airframe may fall while a stage is missing.
    pub fn slow(&self, slowdown: u64) -> String {
        self.settings(&format!("{SKY}slowdown = {slowdown}\n"))
    }

    /// `ironbird COMMAND` with the instance and the output directory of this rig, where the command takes them.
    pub fn command(&self, command: &str, args: impl AsRef<str>) -> Command {
        self.given(Command::new(self.executable), command, args)
    }

    /// The program with what a command is given, besides `args`.
    pub fn given(&self, mut program: Command, command: &str, args: impl AsRef<str>) -> Command {
        let words = args.as_ref().split_whitespace();
        let mut all: Vec<String> = words.map(str::to_owned).collect();
        // What stands behind `--` are no flags.
        let end = all.iter().position(|arg| arg == "--").unwrap_or(all.len());
        let mut default = |flag: &str, value: &str| {
            if !all.iter().any(|arg| arg == flag) {
                all.splice(end..end, [flag.to_owned(), value.to_owned()]);
            }
        };
        const WITHOUT_INSTANCE: &str = "campaign clean simulate compare margin report export \
                                        replay floor runs laws new faults doctor \
                                        completions man ring-hop";
        const WITH_OUTPUT: &str = "fly record report export replay runs margin";
        let is_in = |list: &str| list.split(' ').any(|it| it == command);
        if !is_in(WITHOUT_INSTANCE) {
            default("--instance", &self.instance);
        }
        if is_in(WITH_OUTPUT) {
            default("--out", self.out().to_str().unwrap());
        }
        program.arg(command).args(all);
        program.env("IRONBIRD_ROOT", self.root());
        program
    }

    pub fn start(&self, command: &str, args: impl AsRef<str>) -> Running {
        self.launch(self.command(command, args))
    }

    pub fn launch(&self, mut command: Command) -> Running {
        let number = self.started.fetch_add(1, Ordering::Relaxed);
        let [stdout, stderr] = ["out", "err"].map(|end| self.path(&format!("{number}.{end}")));
        command
            .stdout(File::create(&stdout).unwrap())
            .stderr(File::create(&stderr).unwrap())
            .stdin(Stdio::null())
            .current_dir(self.directory.path());
        let child = command.spawn().unwrap();
        Running {
            what: format!("{command:?}"),
            child,
            stdout,
            stderr,
        }
    }

    pub fn run(&self, command: &str, args: impl AsRef<str>) -> Ended {
        self.start(command, args).end()
    }

    /// Runs a whole command line, which must succeed.
    pub fn ok(&self, line: &str) -> Ended {
        let (command, args) = line.split_once(' ').unwrap_or((line, ""));
        self.run(command, args).expect(0)
    }

    /// Waits until the parameters of the flight are in force.
    pub fn await_flight(&self) {
        let instance = self.known();
        wait_until("the instance to fly", || {
            let (wire, _) = live::inject::flight(&instance).ok()??;
            let in_force = wire.blackboard_reader::<ActiveParameters>(IN_FORCE).ok()?;
            in_force.map(|_| ())
        });
    }

    /// Waits until the plant has published a tick, or the flight has ended.
    pub fn await_tick(&self, tick: u64) -> Run {
        let wire = Wire::open(&self.known()).unwrap();
        wait_until(&format!("tick {tick}"), || {
            let run = wire.blackboard_reader::<Run>(RUN).unwrap()?.get();
            let is_there =
                run.phase() == RunPhase::Flying && run.tick != NO_TICK && run.tick >= tick;
            (run.phase() == RunPhase::Closed || is_there).then_some(run)
        })
    }

    pub fn await_report(&self) {
        let report = self.out().join("latest/report.json");
        wait_until("the first report", || report.exists().then_some(()));
    }

    /// Starts a flight and waits until its parameters are in force: up to 200 ms before tick 0.
    pub fn take_off(&self, args: impl AsRef<str>) -> Running {
        let flight = self.start("fly", args);
        self.await_flight();
        flight
    }

    pub fn flown(&self, file: &str) -> String {
        fs::read_to_string(self.out().join("latest").join(file)).unwrap()
    }

    pub fn report(&self) -> Value {
        serde_json::from_str(&self.flown("report.json")).unwrap()
    }

    /// The same, typed, when it is no longer that of a flight in the air.
    pub fn final_report(&self) -> Report {
        let path = self.out().join("latest/report.json");
        let read = || Report::read(&path).ok().filter(|it| !it.run.in_flight);
        wait_until("the final report", read)
    }

    /// Whether the machine woke a stage of the last flight more than half a tick late. It then kept the others from
    /// their processor as well, which looks the same as a loss by a channel: then prints that it was not tested.
    pub fn has_stalled(&self) -> bool {
        let report = self.final_report();
        let wakes = STAGES.map(|stage| report.series(&format!("wake.{stage}")));
        let late_us = wakes.into_iter().flatten().map(|it| it.max_us);
        let late_us = late_us.fold(0.0, f64::max);
        let has_stalled = late_us > 0.5 * report.run.wall_period_us;
        if has_stalled {
            not_tested(&format!(
                "ticks without a command: the machine woke a stage {late_us} us late"
            ));
        }
        has_stalled
    }

    /// A replay has every bit of the log.
    pub fn assert_replayed(&self) {
        self.ok("replay --verify").says("identical");
    }

    pub fn run_directories(&self) -> Vec<String> {
        names(&self.out())
            .into_iter()
            .filter(|name| name != "latest")
            .collect()
    }

    /// The instance's segments in shared memory: their names carry its name before a dot.
    pub fn segments(&self) -> Vec<String> {
        let infix = format!("_{}.", self.instance);
        names(Path::new("/dev/shm"))
            .into_iter()
            .filter(|name| name.contains(&infix))
            .collect()
    }

    /// Nothing of the instance is left in shared memory, and no process of it lives.
    pub fn assert_nothing_left(&self) {
        let none: [u32; 0] = [];
        assert_eq!(self.segments(), [""; 0], "left in /dev/shm");
        assert_eq!(self.living(), none, "living processes");
    }

    /// Living processes of the instance.
    pub fn living(&self) -> Vec<u32> {
        let lives = |pid: &u32| self.is_ours(*pid) && !is_gone(*pid);
        processes().filter(lives).collect()
    }

    /// Those that were started as `ironbird COMMAND`, without those that release their memory.
    pub fn processes_of(&self, command: &str) -> Vec<u32> {
        let is_it = |pid: &u32| {
            let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
            let line = command_line(*pid);
            line.get(1).is_some_and(|first| first == command) && name.trim_end() == "ironbird"
        };
        let mut living = self.living();
        living.retain(is_it);
        living
    }

    /// A process that was started for a role, another one than `dead`.
    pub fn await_started(&self, role: Role, dead: u32) -> u32 {
        wait_until(&format!("another {role} process to start"), || {
            let mut started = self.processes_of(role.name()).into_iter();
            started.find(|pid| *pid != dead)
        })
    }

    /// Kills all processes of the instance, and waits for their end.
    pub fn kill_all(&self) {
        let ours: Vec<u32> = processes().filter(|pid| self.is_ours(*pid)).collect();
        for pid in &ours {
            let _ = Pid::from_raw(pid.cast_signed()).map(|pid| kill_process(pid, Signal::KILL));
        }
        wait_until("killed processes to end", || {
            ours.iter().all(|pid| is_gone(*pid)).then_some(())
        });
    }

    pub fn executable(&self) -> &'static str {
        self.executable
    }

    fn is_ours(&self, pid: u32) -> bool {
        command_line(pid).contains(&self.instance)
    }

    /// Nothing was started: no flight's directory, no root directory, no shared memory.
    pub fn assert_nothing_started(&self) {
        assert_eq!(self.run_directories(), [""; 0]);
        assert!(!self.path("runs").exists() && !self.root().exists());
        self.assert_nothing_left();
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // A failed test has killed what it started, but not what that started in turn.
            self.kill_all();
            let _ = self
                .command("clean", "")
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status();
        }
    }
}

/// Says that something is left out, past the harness, which shows what a test prints only when it fails.
pub fn not_tested(what: &str) {
    let _ = writeln!(std::io::stderr().lock(), "NOT TESTED: {what}");
}

/// The same for want of a tool; with `IRONBIRD_TEST_ALL=1` that is a failure, as in the gate, which installs them.
pub fn lacks_tool(what: &str) {
    assert!(
        std::env::var("IRONBIRD_TEST_ALL").as_deref() != Ok("1"),
        "IRONBIRD_TEST_ALL is set, and {what}"
    );
    not_tested(what);
}

/// The same for a build without a feature.
pub fn lacks_feature(what: &str, feature: &str) {
    not_tested(&format!("{what}: needs --features {feature}"));
}

/// Two rows of a table at a time: two flights and those of another test are what two processors carry.
pub fn in_parallel<T>(rows: impl Iterator<Item = T> + Send, run: impl Fn(&T) + Sync) {
    let rows = Mutex::new(rows);
    let next = || rows.lock().unwrap().next();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| std::iter::from_fn(next).for_each(|row| run(&row)));
        }
    });
}

pub fn rounds() -> u64 {
    std::env::var("IRONBIRD_ROUNDS").map_or(1, |rounds| rounds.parse().unwrap())
}

/// Whether a mount namespace of its own, a mount in it, and what `probe` does there are permitted.
pub fn can_mount(mount: &str, probe: &str) -> bool {
    let can = Command::new("unshare")
        .args(["-m", "sh", "-c", &format!("{mount} && {probe}")])
        .status();
    let can = can.is_ok_and(|status| status.success());
    if !can {
        not_tested(&format!("not permitted here: unshare -m, {mount}, {probe}"));
    }
    can
}

pub fn read_log(log: &Path) -> (Vec<LogEntry>, End) {
    let mut reader = LogReader::open(log).unwrap();
    let mut entries = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        entries.push(*entry);
    }
    (entries, reader.end())
}
