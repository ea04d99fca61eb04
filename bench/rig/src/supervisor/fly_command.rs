//! `ironbird fly`: checks the settings, supervises the flight, completes and prints its report.

use std::fs;
use std::io::{self, IsTerminal as _};
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use ipc::Wire;
use ipc::instance::{Instance, Lock};

use crate::browser::open_page;
use crate::cli::FlyArgs;
use crate::floor::flight_baseline;
use crate::output::{print, say};
use crate::record::kernel_trace;
use crate::report_command;
use crate::roles::remove_leftovers;
use crate::run_directory::{RunDirectory, make_latest};
use crate::settings::law_settings::Chosen;
use crate::settings::{PaceName, Settings};
use crate::supervisor::exit_report::{Outcome, warnings};
use crate::supervisor::flight_supervisor::FlightSupervisor;
use crate::supervisor::stop_requests::StopRequests;
use errors::{Failure, INTERRUPTED, InFile as _, OK, check_writable};
use host::own_executable;
use report::baseline::Baseline;
use report::render::files::write_all;
use report::render::junit;
use report::schema::Report;

/// How often to look for a signal during a measurement.
const LOOK_EVERY: Duration = Duration::from_millis(50);

pub fn fly(args: &FlyArgs) -> Result<u8, Failure> {
    check_writable("--junit", args.junit.as_deref())?;
    // The result of an earlier flight is none of this one, however its process ends.
    if let Some(earlier) = args
        .junit
        .as_ref()
        .filter(|path| !args.print_config && path.is_file())
    {
        fs::remove_file(earlier).in_file("replace", earlier)?;
    }
    match conduct(args) {
        Ok(None) => Ok(OK),
        Ok(Some(flight)) => complete(args, flight),
        Err(failure) => {
            let told = args
                .junit
                .as_ref()
                .map_or(Ok(()), |path| junit::write_failure(&failure, path));
            Err(match told {
                Ok(()) => failure,
                Err(untold) => failure.append(&format!("; {untold}")),
            })
        }
    }
}

/// A flight that has a report.
struct FinishedFlight {
    settings: Settings,
    requests: StopRequests,
    directory: RunDirectory,
    outcome: Outcome,
    report: Report,
}

/// Flies what the flags ask for; nothing where they ask for its settings alone.
fn conduct(args: &FlyArgs) -> Result<Option<FinishedFlight>, Failure> {
    let mut overrides = args.flight.overrides();
    overrides.extend(args.rt.overrides());
    overrides.extend(args.recorder.overrides());
    let settings = Settings::resolve(args.flight.course.config.as_deref(), &overrides)?;
    settings.check_faults_of_processes(true)?;
    args.rt.check(&settings)?;
    args.recorder.check(&settings)?;
    args.check(&settings)?;
    if args.print_config {
        print(&settings.commented()?)?;
        return Ok(None);
    }
    for warning in settings.warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    if settings.flight.pace == PaceName::Realtime {
        slow_laws(&settings)?
            .iter()
            .for_each(|law| say(&format!("warning: {law}\n")));
    }
    // First, so that what a check makes goes with it.
    let mut requests = StopRequests::listen()?;
    settings.check_cpu()?;
    settings.check_priorities()?;
    check_writable("--states", args.recorder.states.as_deref())?;
    kernel_trace::check(settings.recorder.trace)?;
    args.floor.map_or(Ok(()), |duration| {
        flight_baseline::check(&settings, duration)
    })?;
    let (directory, outcome, report) = record_flight(&settings, args, &mut requests)?;
    Ok(Some(FinishedFlight {
        settings,
        requests,
        directory,
        outcome,
        report,
    }))
}

/// The laws that promise nothing about their time, a sentence each.
fn slow_laws(settings: &Settings) -> Result<Vec<String>, Failure> {
    let slow = settings
        .chosen_laws()?
        .into_iter()
        .filter_map(Chosen::library)
        .filter(|law| law.not_real_time);
    Ok(slow
        .map(|law| {
            format!(
                "the {} is not real-time: it may miss deadlines",
                law.words()
            )
        })
        .collect())
}

/// Completes the report of a flight, and prints it.
fn complete(args: &FlyArgs, flight: FinishedFlight) -> Result<u8, Failure> {
    let FinishedFlight {
        settings,
        mut requests,
        directory,
        outcome,
        mut report,
    } = flight;
    let corrected = outcome.correct(&mut report, &directory.path);
    let mut exit_code = report.verdict.exit_code;
    let mut unmeasured = None;
    if let Some(duration) = args.floor.filter(|_| outcome.failed.is_none()) {
        match measure_floors(&report, &settings, duration, &mut requests) {
            Ok(Some(beside)) => report.beside = Some(beside),
            Ok(None) if exit_code == OK => exit_code = INTERRUPTED,
            Ok(None) => {}
            Err(failure) => unmeasured = Some(failure),
        }
    }
    let needs_writing = corrected || report.beside.is_some();
    let written = if needs_writing {
        write_all(&report, &directory.path)
    } else {
        Ok(())
    };
    let passed_on = args
        .junit
        .as_ref()
        .map_or(Ok(()), |path| junit::write(&report, path));
    // A recorder that died may not have come to it.
    let pointed = if corrected {
        make_latest(&directory.path)
    } else {
        Ok(())
    };
    if let Some(failed) = &outcome.failed {
        say(&failed.log(&directory.path));
    }
    warnings(&directory.path)
        .iter()
        .for_each(|warning| say(&format!("{warning}\n")));
    print(&report_command::ended(&report, &directory.path))?;
    // What the flight found weighs more than what became of the rest.
    let rest = written
        .and(pointed)
        .and(passed_on)
        .and(unmeasured.map_or(Ok(()), Err));
    let shown = rest.and_then(|()| {
        if args.open {
            open_page(&directory.path)
        } else {
            Ok(())
        }
    });
    shown
        .map(|()| exit_code)
        .map_err(|failure| failure.or_code(exit_code))
}

/// Flies, up to the last report that the recorder has written.
fn record_flight(
    settings: &Settings,
    args: &FlyArgs,
    requests: &mut StopRequests,
) -> Result<(RunDirectory, Outcome, Report), Failure> {
    let instance = Instance::new(&args.rt.instance)?;
    // Where somebody flies it already, that is the error.
    if !instance.is_alive() {
        instance.check_shared_memory(Wire::needed_bytes())?;
    }
    instance.prepare()?;
    let lock = instance.lock_launcher()?;
    let ended = start_and_supervise(&instance, settings, args, requests);
    release(&instance, lock);
    let (directory, outcome) = ended?;
    let report_path = directory.path.join("report.json");
    if report_path.exists() {
        let report = Report::read(&report_path)?;
        return Ok((directory, outcome, report));
    }
    let failure = outcome.failure(&directory.path);
    if outcome.is_over() {
        // Refused, called off or failed: what its processes said has been passed on.
        directory.discard();
    }
    let kept = directory.path.exists();
    let rest = if kept {
        format!("; {} has what was recorded", directory.path.display())
    } else {
        String::new()
    };
    Err(failure.append(&rest))
}

fn start_and_supervise(
    instance: &Instance,
    settings: &Settings,
    args: &FlyArgs,
    requests: &mut StopRequests,
) -> Result<(RunDirectory, Outcome), Failure> {
    let directory =
        RunDirectory::create(Path::new(&settings.recorder.out), settings, instance.name())?;
    let mut supervisor = match FlightSupervisor::start(instance, &directory, settings, args) {
        Ok(supervisor) => supervisor,
        Err(failure) => {
            directory.discard();
            requests.poll();
            return Err(failure.broken_off(requests.is_requested));
        }
    };
    let outcome = supervisor.run(requests)?;
    Ok((supervisor.recorded()?, outcome))
}

/// Measures beside the flight that has just ended; nothing where a signal has come, which the report then goes without.
fn measure_floors(
    report: &Report,
    settings: &Settings,
    duration: Duration,
    requests: &mut StopRequests,
) -> Result<Option<Baseline>, Failure> {
    if io::stderr().is_terminal() {
        say(&format!(
            "measuring the machine's floors, twice {}\n",
            humantime::format_duration(duration)
        ));
    }
    let (report, settings, executable) = (report.clone(), settings.clone(), own_executable()?);
    let measuring = std::thread::Builder::new()
        .spawn(move || flight_baseline::take(&report, &settings, duration, &executable))
        .map_err(|e| {
            Failure::failed(format!("cannot start a thread to measure the floors: {e}"))
        })?;
    while !measuring.is_finished() {
        requests.poll();
        if requests.is_requested {
            // The thread and its processes end with this one.
            say("interrupted: the machine's floors are not measured\n");
            return Ok(None);
        }
        sleep(LOOK_EVERY);
    }
    let measured = measuring
        .join()
        .unwrap_or_else(|_| Err(Failure::failed("the measuring thread panicked")));
    measured.map(Some)
}

/// Gives the instance up and removes what killed processes may have left.
fn release(instance: &Instance, lock: Lock) {
    drop(lock);
    remove_leftovers(instance);
}
