//! `ironbird fly`: starts the five processes, watches over them, ends them in order, prints the report.

use std::fs::{self, File};
use std::io::{self, IsTerminal as _, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use model::boards::{RUN, Run, RunPhase};
use model::role::{ROLES, Role};
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::consts::{SIGINT, SIGTERM};
use wire::instance::{Instance, Lock, check_shared_memory};
use wire::{BoardReader, Wire};

use crate::cli::FlyArgs;
use crate::dashboard::Dashboard;
use crate::floor::beside;
use crate::output::print;
use crate::run_directory::RunDirectory;
use crate::settings::Settings;
use failure::{FAILED, Failure, INTERRUPTED, InFile as _, OK, check_writable};
use machine::executable::own_executable;
use report::beside::Beside;
use report::files::write_all;
use report::schema::Report;
use report::text;

/// How often the launcher looks after the flight.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How long processes may take to end after they were told to.
const LANDING: Duration = Duration::from_secs(5);

/// Flies.
///
/// # Errors
/// Usage, and everything that can go wrong on the way (docs/architecture.md, "Exit codes").
pub fn fly(args: &FlyArgs) -> Result<u8, Failure> {
    let mut overrides = args.flight.overrides();
    overrides.extend(args.rt.overrides());
    overrides.extend(args.recorder.overrides());
    let settings = Settings::resolve(args.flight.config.as_deref(), &overrides)?;
    if args.print_config {
        print(&settings.commented()?)?;
        return Ok(OK);
    }
    check_writable("--states", args.recorder.states.as_deref())?;
    args.floor.map_or(Ok(()), |duration| beside::check(&settings, duration))?;
    let instance = Instance::new(&args.rt.instance)?;
    check_shared_memory(Wire::needed_bytes())?;
    instance.prepare()?;
    let lock = instance.lock_launcher()?;
    let signals = count_signals()?;
    let outcome = start_and_watch(&instance, &settings, args, &signals);
    release(&instance, lock);
    let (directory, ended) = outcome?;
    let report_path = directory.path.join("report.json");
    if !report_path.exists() {
        return Err(ended.failure(&directory.path));
    }
    let mut report = Report::read(&report_path)?;
    let corrected = ended.correct(&mut report);
    let mut exit_code = report.verdict.exit_code;
    if let Some(duration) = args.floor.filter(|_| ended.died.is_none()) {
        report.beside = measure_floors(&report, &settings, duration, &signals)?;
        if report.beside.is_none() && exit_code == OK {
            exit_code = INTERRUPTED;
        }
    }
    if corrected || report.beside.is_some() {
        write_all(&report, &directory.path)?;
    }
    print(&text::render(&report))?;
    if let Some(died) = &ended.died {
        eprint!("{}", died.words(&directory.path));
    }
    print(&(text::result_line(&report, &directory.path.display().to_string()) + "\n"))?;
    Ok(exit_code)
}

fn start_and_watch(
    instance: &Instance,
    settings: &Settings,
    args: &FlyArgs,
    signals: &AtomicUsize,
) -> Result<(RunDirectory, Ended), Failure> {
    let directory = RunDirectory::create(Path::new(&settings.recorder.out), settings, instance.name())?;
    let mut launcher = Launcher::start(instance, &directory, settings, args)?;
    let ended = launcher.watch(signals)?;
    Ok((directory, ended))
}

/// Measures beside the flight that has just ended; nothing where a signal has come, which the report then goes without.
fn measure_floors(
    report: &Report,
    settings: &Settings,
    duration: Duration,
    signals: &AtomicUsize,
) -> Result<Option<Beside>, Failure> {
    if io::stderr().is_terminal() {
        eprintln!("measuring the machine's floors, twice {}", humantime::format_duration(duration));
    }
    let (report, settings, executable) = (report.clone(), settings.clone(), own_executable()?);
    let measuring = std::thread::spawn(move || beside::take(&report, &settings, duration, &executable));
    while !measuring.is_finished() {
        if signals.load(Ordering::Relaxed) > 0 {
            // The thread and its processes end with this one.
            eprintln!("interrupted: the machine's floors are not measured");
            return Ok(None);
        }
        sleep(LOOK_EVERY);
    }
    let measured = measuring.join().unwrap_or_else(|_| Err(Failure::failed("the measuring thread panicked")));
    measured.map(Some)
}

/// Counts SIGINT and SIGTERM: the first ends the flight in order, the second at once.
fn count_signals() -> Result<Arc<AtomicUsize>, Failure> {
    let count = Arc::new(AtomicUsize::new(0));
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM])
        .map_err(|e| Failure::failed(format!("cannot handle signals: {e}")))?;
    let counter = Arc::clone(&count);
    std::thread::spawn(move || {
        for _ in signals.forever() {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    });
    Ok(count)
}

/// Gives the instance up and removes what killed processes may have left.
fn release(instance: &Instance, lock: Lock) {
    drop(lock);
    // What resists is found by the next start or by `ironbird clean`, which names it.
    let _ = instance.remove_leftovers();
}

/// The processes of a flight.
struct Launcher {
    children: Vec<(Role, Child)>,
    dashboard: Option<Dashboard>,
    wire: Wire,
    directory: PathBuf,
    duration_s: f64,
}

/// How a flight's processes ended.
struct Ended {
    died: Option<Died>,
    interrupted: bool,
}

/// A process that ended as it should not.
struct Died {
    role: Role,
    status: ExitStatus,
}

impl Launcher {
    fn start(
        instance: &Instance,
        directory: &RunDirectory,
        settings: &Settings,
        args: &FlyArgs,
    ) -> Result<Self, Failure> {
        // Before any role starts: removes what dead processes of the instance left.
        let wire = Wire::open(instance)?;
        let executable = own_executable()?;
        let mut launcher = Self {
            children: Vec::new(),
            dashboard: None,
            wire,
            directory: directory.path.clone(),
            duration_s: settings.flight.duration_s,
        };
        for role in ROLES {
            let log_path = log_path(&directory.path, role);
            let log = File::create(&log_path).in_file("write", &log_path)?;
            let mut command = Command::new(&executable);
            command
                .arg(role.name())
                .arg("--config")
                .arg(directory.settings_file())
                .args(["--instance", instance.name()])
                .args(["--launcher", &std::process::id().to_string()]);
            if role == Role::Record {
                command.arg("--run-dir").arg(&directory.path);
                if let Some(states) = &args.recorder.states {
                    command.arg("--states").arg(states);
                }
            }
            let child = command
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(log)
                // Ctrl-C in a terminal reaches the launcher alone, which then ends the roles in order.
                .process_group(0)
                .spawn();
            match child {
                Ok(child) => launcher.children.push((role, child)),
                Err(e) => {
                    launcher.kill();
                    return Err(Failure::failed(format!("cannot start the {role} process: {e}")));
                }
            }
        }
        if args.watch {
            launcher.dashboard = Some(Dashboard::open(&executable, instance)?);
        }
        Ok(launcher)
    }

    /// Watches until every process has ended.
    fn watch(&mut self, signals: &AtomicUsize) -> Result<Ended, Failure> {
        let mut ended = Ended { died: None, interrupted: false };
        let mut told_at: Option<Instant> = None;
        let mut forced = false;
        let mut board: Option<BoardReader<Run>> = None;
        let status_line = io::stderr().is_terminal();
        while !self.children.is_empty() {
            sleep(LOOK_EVERY);
            for died in self.reap()? {
                // A recorder that ends on another one's failure may be seen before that one.
                let first = ended.died.as_ref().is_none_or(|known| known.role == Role::Record);
                if !forced && first && died.status.code() != Some(i32::from(INTERRUPTED)) {
                    ended.died = Some(died);
                }
            }
            let count = signals.load(Ordering::Relaxed);
            if count > 0 {
                ended.interrupted = true;
            }
            if told_at.is_none() && (count > 0 || ended.died.is_some()) {
                self.tell_all();
                told_at = Some(Instant::now());
            }
            if count > 1 || told_at.is_some_and(|at| at.elapsed() > LANDING) {
                forced = true;
                self.kill();
            }
            if status_line && !self.dashboard.as_mut().is_some_and(Dashboard::is_open) {
                // A flight does not depend on its status line: what cannot be read now is tried again.
                board = board.or_else(|| self.wire.board_reader(RUN).ok().flatten());
                board.iter().for_each(|board| self.show(&board.get()));
            }
        }
        if let Some(dashboard) = &mut self.dashboard {
            dashboard.close();
        }
        if status_line {
            eprint!("\r\x1b[K");
        }
        Ok(ended)
    }

    /// Takes ended processes off the list; gives those that ended as they should not.
    fn reap(&mut self) -> Result<Vec<Died>, Failure> {
        let mut died = Vec::new();
        let mut alive = Vec::new();
        for (role, mut child) in self.children.drain(..) {
            match child.try_wait().map_err(|e| Failure::failed(format!("cannot wait for {role}: {e}")))? {
                None => alive.push((role, child)),
                // The recorder's exit code is the flight's verdict.
                Some(status) if status.success() || (role == Role::Record && status.code() == Some(3)) => {}
                Some(status) => died.push(Died { role, status }),
            }
        }
        self.children = alive;
        Ok(died)
    }

    fn tell_all(&self) {
        for (_, child) in &self.children {
            if let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
                // It may have ended by itself meanwhile.
                let _ = kill_process(pid, Signal::TERM);
            }
        }
    }

    fn kill(&mut self) {
        for (_, child) in &mut self.children {
            // Only a process that has ended already resists.
            let _ = child.kill();
        }
    }

    fn show(&self, run: &Run) {
        let line = match run.phase() {
            RunPhase::Mustering | RunPhase::Opening => "waiting for all processes to be ready".into(),
            RunPhase::Closed => "landing".into(),
            RunPhase::Flying if run.tick == model::messages::NO_TICK => "armed".into(),
            RunPhase::Flying => self.flying_line(run),
        };
        eprint!("\r\x1b[K{line}");
        let _ = io::stderr().flush();
    }

    fn flying_line(&self, run: &Run) -> String {
        let flown_s = run.flight_time_s(run.tick);
        let mut line = format!(
            "{flown_s:7.1} of {:.1} s   missed {}   skipped {}   swaps {}",
            self.duration_s, run.deadlines_missed, run.ticks_skipped, run.parameter_epoch
        );
        if let Ok(report) = Report::read(&self.directory.join("report.json")) {
            if let Some(series) = report.series("loop") {
                line.push_str(&format!("   loop p50 {:.1} p99 {:.1} us", series.p50_us, series.p99_us));
            }
            line.push_str(&format!("   error {:.3} m", report.flight.position_error_final_m));
        }
        line
    }
}

impl Drop for Launcher {
    fn drop(&mut self) {
        self.kill();
        for (_, child) in &mut self.children {
            let _ = child.wait();
        }
    }
}

impl Ended {
    /// Puts into the report what the recorder could not know: that a process died, or that its own last word is
    /// missing. Says whether it did.
    fn correct(&self, report: &mut Report) -> bool {
        let (status, exit_code, ending) = match &self.died {
            Some(died) => ("ABORTED", FAILED, format!("the {} process died: {}", died.role, died.status)),
            None if !report.run.in_flight => return false,
            None if self.interrupted => {
                ("INTERRUPTED", INTERRUPTED, "interrupted; numbers up to the recorder's last second".into())
            }
            None => ("ABORTED", FAILED, "the recorder ended too early".into()),
        };
        (report.verdict.status, report.verdict.exit_code) = (status.into(), exit_code);
        (report.run.ending, report.run.in_flight) = (ending, false);
        true
    }

    /// Why there is no report.
    fn failure(&self, directory: &Path) -> Failure {
        match &self.died {
            Some(died) => {
                eprint!("{}", died.words(directory));
                let code = died.status.code().and_then(|code| u8::try_from(code).ok()).unwrap_or(FAILED);
                Failure::new(code, format!("the {} process ended before the flight began", died.role))
            }
            None if self.interrupted => Failure::new(INTERRUPTED, "interrupted before the flight began"),
            None => Failure::failed("the processes ended without a report"),
        }
    }
}

impl Died {
    /// What the process said last.
    fn words(&self, directory: &Path) -> String {
        let path = log_path(directory, self.role);
        let said = fs::read_to_string(&path).unwrap_or_default();
        format!("{} process: {}\n{said}", self.role, self.status)
    }
}

fn log_path(directory: &Path, role: Role) -> PathBuf {
    directory.join(format!("{role}.log"))
}
