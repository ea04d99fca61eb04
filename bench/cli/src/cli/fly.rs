//! `ironbird fly`: checks the settings, has the flight supervised, completes and prints its report.

use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use crate::browser::open_page;
use crate::cli::setting_flags::check_clock_flags;
use crate::cli::{FlightArgs, FlyArgs, OnDeath};
use crate::floor::flight_baseline;
use crate::loss;
use crate::report_command;
use analysis::baseline::Baseline;
use analysis::schema::{FlightVerdict, Report};
use config::law_settings::Chosen;
use config::{PaceName, Settings, overrides};
use errors::output::{print, say};
use errors::{Failure, INTERRUPTED, OK, check_outputs, open_file};
use host::cpu_times::hostname;
use host::own_executable;
use recorder::kernel_trace;
use recorder::run_directory::make_latest;
use render::files::write_all;
use render::junit;
use supervisor::exit_report::warnings;
use supervisor::stop_requests::StopRequests;
use supervisor::{self, FinishedFlight, FlightOptions, ServerProcess};
use toml::Value;

pub fn fly(args: &FlyArgs) -> Result<u8, Failure> {
    flown(args).map(|(exit_code, _)| exit_code)
}

/// The exit code of a flight, and its directory if it flew.
pub fn flown(args: &FlyArgs) -> Result<(u8, Option<PathBuf>), Failure> {
    let junit = args.junit.as_deref().filter(|_| !args.print_config);
    let states = args.recorder.states.as_deref();
    let flown = with_junit(&args.flight, (junit::FLY, junit), &[states], || {
        conduct(args)
    })?;
    flown.map_or(Ok((OK, None)), |(settings, requests, flight)| {
        let directory = flight.directory.path.clone();
        let exit_code = complete(args, &settings, requests, flight)?;
        Ok((exit_code, Some(directory)))
    })
}

/// Runs a flight whose result is to be written to the file of `--junit`. Why it failed is written there too, unless another
/// output has the same name.
pub(super) fn with_junit<T>(
    flight: &FlightArgs,
    (suite, junit): (&str, Option<&Path>),
    others: &[Option<&Path>],
    run: impl FnOnce() -> Result<T, Failure>,
) -> Result<T, Failure> {
    let Some(path) = junit.filter(|path| !others.contains(&Some(path))) else {
        return run();
    };
    // No file that a flag names as an input is replaced: these have not been read yet.
    let flags = flight.overrides();
    let named = flags.iter().filter_map(|(_, value)| value.as_str());
    let inputs = named.map(Path::new).chain(flight.course.config.as_deref());
    inputs.for_each(|input| drop(open_file(input)));
    check_outputs(&[("--junit", junit)])?;
    let write = |failure: &Failure| junit::write_failure(suite, failure, &hostname(), path);
    // The result of an earlier flight is none of this one, and a law may end the process.
    if path.is_file() || !path.exists() {
        write(&Failure::failed(
            "the process ended before it wrote the result of its flight",
        ))?;
    }
    run().map_err(|failure| match write(&failure) {
        Ok(()) => failure,
        Err(unwritten) => failure.append(&format!("; {unwritten}")),
    })
}

/// Flies; only prints the settings, and returns nothing, if that is all the flags request.
fn conduct(args: &FlyArgs) -> Result<Option<(Settings, StopRequests, FinishedFlight)>, Failure> {
    let (junit, states) = (args.junit.as_deref(), args.recorder.states.as_deref());
    check_outputs(&[("--junit", junit), ("--states", states)])?;
    let overrides = args.overrides();
    let file = args.flight.course.config.as_deref();
    let settings = Settings::resolve(file, &overrides)?;
    settings.check_faults_of_processes(true)?;
    let channel_cpus = overrides::value_of(&overrides, "rt.channel_cpus");
    if channel_cpus == Some(&Value::from(2)) && settings.rt.channels == 1 {
        return Err(Failure::usage("--channel-cpus: the flight has one channel")
            .help("leave it out, or fly with more: --channels 2"));
    }
    let default = match (settings.rt.channels, settings.flight.pace) {
        (2.., PaceName::Realtime) => OnDeath::Restart,
        _ => OnDeath::End,
    };
    let restarts_roles = args.on_death.unwrap_or(default) == OnDeath::Restart;
    check_clock_flags(
        &settings,
        &overrides,
        &[("--on-death restart", restarts_roles)],
    )?;
    if args.print_config {
        print(&settings.commented()?)?;
        return Ok(None);
    }
    let mut warnings = settings.warnings()?;
    if settings.flight.pace == PaceName::Realtime {
        warnings.extend(slow_laws(&settings)?);
    }
    for warning in warnings {
        say(&format!("warning: {warning}\n"));
    }
    // First, so that what a check makes goes with it.
    let mut requests = StopRequests::listen()?;
    settings.check_cpu()?;
    settings.check_slow_motion()?;
    settings.check_priorities()?;
    kernel_trace::check(settings.recorder.trace)?;
    if let Some(duration) = args.floor {
        flight_baseline::check(&settings, duration)?;
    }
    let options = FlightOptions {
        instance: args.rt.instance.clone(),
        restarts_roles,
        shows_dashboard: args.watch,
        servers: servers(args),
        states: args.recorder.states.clone(),
    };
    let flight = supervisor::fly(&settings, &options, &mut requests)?;
    Ok(Some((settings, requests, flight)))
}

/// The processes that serve the flight to a browser and to a ground station.
fn servers(args: &FlyArgs) -> Vec<ServerProcess> {
    let flags = |flags: &[(bool, &str)]| {
        let given = flags.iter().filter(|(is_given, _)| *is_given);
        given.map(|(_, flag)| (*flag).to_owned()).collect()
    };
    let (control, port) = ((args.allow_control, "--allow-control"), args.page.port);
    let page = args.web.then(|| ServerProcess {
        what: "the live page",
        command: "watch",
        arguments: flags(&[
            (true, "--web"),
            (true, &format!("--port={port}")),
            control,
            (args.open, "--open"),
        ]),
    });
    let vehicle = args.mavlink.then(|| ServerProcess {
        what: "the MAVLink vehicle",
        command: "bridge",
        arguments: flags(&[(true, "mavlink"), control]),
    });
    page.into_iter().chain(vehicle).collect()
}

/// The laws that promise nothing about their time, a sentence each.
fn slow_laws(settings: &Settings) -> Result<Vec<String>, Failure> {
    let laws = settings.chosen_laws()?.into_iter();
    let slow = laws
        .filter_map(Chosen::library)
        .filter(|law| law.not_real_time);
    let sentence = |law: &plugin::Library| {
        format!("the {} is not real-time: it may miss deadlines", law.words)
    };
    Ok(slow.map(sentence).collect())
}

/// Completes the report of a flight, and prints it.
fn complete(
    args: &FlyArgs,
    settings: &Settings,
    mut requests: StopRequests,
    flight: FinishedFlight,
) -> Result<u8, Failure> {
    let FinishedFlight {
        directory,
        outcome,
        mut report,
    } = flight;
    let corrected = outcome.correct(&mut report, &directory.path);
    let mut exit_code = report.verdict.exit_code;
    let mut measured = Ok(());
    if let Some(duration) = args.floor.filter(|_| outcome.failed.is_none()) {
        match measure_floors(&report, settings, duration, &mut requests) {
            Ok(Some(beside)) => report.beside = Some(beside),
            Ok(None) if exit_code == OK => exit_code = INTERRUPTED,
            Ok(None) => {}
            Err(failure) => measured = Err(failure),
        }
    }
    if report.words.flight.word == FlightVerdict::Lost {
        match loss::examine(&directory.path) {
            Ok(section) => report.loss = Some(section),
            Err(failure) => say(&format!(
                "warning: the lost flight could not be simulated without its delays, so whether the machine or the law is the cause is \
                 not known: {failure}\n"
            )),
        }
    }
    if corrected || report.beside.is_some() || report.loss.is_some() {
        write_all(&mut report, &directory.path);
    }
    // A recorder that died may not have come to it.
    if corrected && let Err(failure) = make_latest(&directory.path) {
        say(&format!("warning: {failure}\n"));
    }
    let mut written = Ok(());
    if let Some(path) = &args.junit {
        written = junit::write(&report, path);
    }
    if let Some(failed) = &outcome.failed {
        say(&failed.log(&directory.path));
    }
    for warning in warnings(&directory.path) {
        say(&format!("{warning}\n"));
    }
    print(&report_command::ended(&report, &directory.path))?;
    if args.open
        && let Err(failure) = open_page(&directory.path)
    {
        say(&failure.warning());
    }
    // The verdict of the flight takes precedence over the failure of another step.
    let rest = written.and(measured);
    rest.map(|()| exit_code)
        .map_err(|failure| failure.or_code(exit_code))
}

/// Measures the machine after the flight; nothing if a signal has come, and the report then goes without.
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
        sleep(Duration::from_millis(50));
    }
    let measured = measuring
        .join()
        .unwrap_or_else(|_| Err(Failure::failed("the measuring thread panicked")));
    measured.map(Some)
}
