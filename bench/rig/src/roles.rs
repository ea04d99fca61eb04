//! `ironbird plant | outer | inner | mixer | record`: one role in this process.

use std::io::IsTerminal as _;
use std::path::Path;
use std::sync::atomic::Ordering;

use control_api::{GuardedInner, GuardedMixer, GuardedOuter};
use ipc::clock::now_ns;
use ipc::instance::Instance;
use messages::flight_plan::FlightPlan;
use messages::role::Role;
use plant::PlantSettings;
use process::rt::{loops_cpu, take_stand};
use process::session::{RoleSession, StartConfig};
use process::shell::{self, Flight};
use process::signals::is_on_its_own;
use process::standby;

use crate::cli::{RecordArgs, RoleArgs};
use crate::output::print;
use crate::record::recorder;
use crate::record::run_files::Files;
use crate::record::{hlog, kernel_trace};
use crate::report_command::ended;
use crate::run_directory::RunDirectory;
use crate::settings::{PaceName, Settings};
use errors::{Failure, OK, check_writable};

/// Plays a role of the loop until the run is over.
pub fn play(role: Role, args: &RoleArgs) -> Result<u8, Failure> {
    let begun_ns = now_ns();
    let mut overrides = args.flight.overrides();
    overrides.extend(args.rt.overrides());
    let settings =
        Settings::resolve_to_make(&[role], args.flight.course.config.as_deref(), &overrides)?;
    args.rt.check(&settings)?;
    settings.check_faults_of_processes(args.launcher.is_some())?;
    let stage = make(role, &settings)?;
    let mut orders = orders(args, &settings, begun_ns)?;
    if args.spare {
        let instance = orders.instance.clone();
        let waited = standby::stand_by(role, orders);
        match waited {
            Ok(Some(told)) => orders = told,
            // Its launcher may be dead.
            ended => {
                leave(&instance, args);
                return ended.map(|_| OK).map_err(Failure::from);
            }
        }
    }
    let station = RoleSession::take(role, orders)?;
    let (instance, stop) = (station.wire().instance().clone(), station.stop_flag());
    let flown = run(stage, station, &settings);
    leave(&instance, args);
    flown
        .map(|()| OK)
        .map_err(|failure| failure.broken_off(stop.load(Ordering::Relaxed)))
}

/// What a role's process flies, before it has a place.
#[allow(clippy::large_enum_variant, reason = "there is one of it in a process")]
enum Made {
    Plant(Box<PlantSettings>),
    Outer(GuardedOuter),
    Inner(GuardedInner),
    Mixer(GuardedMixer),
}

fn make(role: Role, settings: &Settings) -> Result<Made, Failure> {
    Ok(match role {
        Role::Plant => Made::Plant(Box::new(settings.plant()?)),
        Role::Outer => Made::Outer(settings.outer_stage()?),
        Role::Inner => Made::Inner(settings.inner_stage()?),
        Role::Mixer => Made::Mixer(settings.mixer_stage()?),
        Role::Record => {
            return Err(Failure::usage(
                "the recorder has a command of its own: `ironbird record`",
            ));
        }
    })
}

fn run(stage: Made, station: RoleSession, settings: &Settings) -> Result<(), Failure> {
    let lockstep = settings.flight.pace == PaceName::Lockstep;
    if lockstep {
        // One after the other on one processor: to wake another one takes longer than a stage computes. Where that is
        // refused the flight is slower and the same.
        let _ = take_stand(loops_cpu(), 0);
    }
    let faults = settings.planned()?;
    let flight = Flight {
        lockstep,
        slowdown: settings.flight.slowdown,
        faults: faults.loops,
    };
    match stage {
        Made::Plant(plant) => {
            let plan = FlightPlan {
                last_tick: settings.last_tick(),
                sample_time_ns: settings.sample_time_ns(),
                wall_period_ns: settings.wall_period_ns(),
            };
            plant::process::run(
                station,
                &plant,
                plan,
                &faults.swaps,
                (&faults.loops, &faults.table),
            )?;
        }
        Made::Outer(outer) => shell::outer(
            station,
            outer,
            settings.flight.position_error_max_m,
            &flight,
        )?,
        Made::Inner(inner) => shell::inner(station, inner, &flight)?,
        Made::Mixer(mixer) => shell::mixer(station, mixer, &flight)?,
    }
    Ok(())
}

/// The last one that is on its own removes what the middleware leaves; a launcher that lives does so itself.
fn leave(instance: &Instance, args: &RoleArgs) {
    if is_on_its_own(args.launcher) {
        remove_leftovers(instance);
    }
}

/// Removes what the processes of an instance leave, if none of them lives.
pub fn remove_leftovers(instance: &Instance) {
    // What resists is found by the next start or by `ironbird clean`, which names it.
    let _ = instance.remove_leftovers();
    kernel_trace::remove_left(instance);
}

/// Records until the run is over; by hand, prints the report.
pub fn record(args: &RecordArgs) -> Result<u8, Failure> {
    let begun_ns = now_ns();
    let mut overrides = args.role.flight.overrides();
    overrides.extend(args.role.rt.overrides());
    overrides.extend(args.recorder.overrides());
    let settings =
        Settings::resolve_to_make(&[], args.role.flight.course.config.as_deref(), &overrides)?;
    args.role.rt.check(&settings)?;
    args.recorder.check(&settings)?;
    check_writable("--states", args.recorder.states.as_deref())?;
    // The launcher has looked.
    kernel_trace::check(settings.recorder.trace && args.role.launcher.is_none())?;
    let station = RoleSession::take(Role::Record, orders(&args.role, &settings, begun_ns)?)?;
    let instance = station.wire().instance().clone();
    let made = match &args.run_dir {
        Some(_) => Ok(None),
        None => RunDirectory::create(
            Path::new(&settings.recorder.out),
            &settings,
            &args.role.rt.instance,
        )
        .map(Some),
    };
    let made = match made {
        Ok(made) => made,
        Err(failure) => {
            drop(station);
            leave(&instance, &args.role);
            return Err(failure);
        }
    };
    let directory = args
        .run_dir
        .as_ref()
        .or(made.as_ref().map(|made| &made.path))
        .cloned()
        .unwrap_or_default();
    let files = Files {
        directory: directory.clone(),
        states: args.recorder.states.clone(),
    };
    let stop = station.stop_flag();
    let recorded = recorder::run(station, &settings, &files);
    leave(&instance, &args.role);
    // Where the flight has begun, a file that cannot be written is no consequence of a signal.
    let has_begun = directory.join(hlog::FILE).exists();
    let recorded =
        recorded.map_err(|failure| failure.broken_off(!has_begun && stop.load(Ordering::Relaxed)));
    if let (Err(_), Some(made)) = (&recorded, made) {
        made.discard();
    }
    let report = recorded?;
    if args.role.launcher.is_none() {
        print(&ended(&report, &directory))?;
    }
    Ok(report.verdict.exit_code)
}

fn orders(args: &RoleArgs, settings: &Settings, begun_ns: u64) -> Result<StartConfig, Failure> {
    settings.check_cpu()?;
    say_on_stderr();
    Ok(StartConfig {
        instance: Instance::new(&args.rt.instance)?,
        rt: settings.realtime()?,
        settings: settings.shared_text()?,
        law_options: settings.law_options()?,
        resume_estimates: settings.flight.resume_estimates,
        launcher: args.launcher,
        begun_ns,
        ready: None,
    })
}

/// What a process says while it waits goes to standard error; a loop that flies says nothing.
fn say_on_stderr() {
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .without_time()
        // Where the log's disk is full there is no other place to say so; the default would print, and panic.
        .log_internal_errors(false)
        .init();
}
