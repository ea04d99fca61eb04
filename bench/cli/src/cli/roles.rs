//! `ironbird plant | outer | inner | mixer | record`: one role in this process.

use std::fs::File;
use std::io;
use std::os::fd::AsFd as _;
use std::path::Path;
use std::sync::atomic::Ordering;

use ipc::clock::now_ns;
use ipc::instance::Instance;
use ipc::recorder_depth;
use messages::flight_plan::FlightPlan;
use messages::role::{Channel, Replica, Role};
use process::rt::{allow_cpus, loops_cpu, take_stand};
use process::session::{RoleSession, StartConfig};
use process::signals::is_on_its_own;
use process::stage::{self, Flight};

use crate::cli::setting_flags::check_clock_flags;
use crate::cli::{RecordArgs, RoleArgs};
use crate::report_command::ended;
use analysis::phrase::count;
use config::{Overrides, PaceName, Settings};
use errors::output::has_screen;
use errors::output::print;
use errors::{Failure, OK, check_outputs};
use experiments::margin::table;
use recorder::kernel_trace::{self, remove_leftovers};
use recorder::recording;
use recorder::run_directory::{LATENCIES, RunDirectory};
use recorder::run_files::Files;

/// Runs a role of the loop until the run is over.
pub fn play(role: Role, args: &RoleArgs) -> Result<u8, Failure> {
    let begun_ns = now_ns();
    let settings = resolve(args, Overrides::new())?;
    settings.check_faults_of_processes(args.launcher.is_some())?;
    let stage = stage(role, args.channel, &settings)?;
    let session = RoleSession::take(role, start_config(role, args, &settings, begun_ns)?)?;
    let (instance, stop) = (session.wire().instance().clone(), session.stop_flag());
    if settings.flight.pace == PaceName::Lockstep {
        // One after the other on one processor: to wake another one takes longer than a stage computes. If that is
        // refused, the flight is slower and the same.
        let _ = take_stand(loops_cpu(), 0);
    }
    let flown = stage(session);
    leave(&instance, args);
    flown
        .map(|()| OK)
        .map_err(|failure| failure.broken_off(stop.load(Ordering::Relaxed)))
}

fn resolve(args: &RoleArgs, more: Overrides) -> Result<Settings, Failure> {
    if !args.allowed_cpus.is_empty() {
        allow_cpus(&args.allowed_cpus);
    }
    let overrides = [args.flight.overrides(), args.rt.settings.overrides(), more].concat();
    let file = args.flight.course.config.as_deref();
    let settings = Settings::resolve_asking(false, file, &overrides)?;
    check_clock_flags(&settings, &overrides, &[])?;
    Ok(settings)
}

type Stage<'a> = Box<dyn FnOnce(RoleSession) -> Result<(), Failure> + 'a>;

/// Makes the stage of a role, which then only needs to join a run to fly.
fn stage(role: Role, channel: Channel, settings: &Settings) -> Result<Stage<'_>, Failure> {
    let (own, faults) = (settings.of_channel(channel), settings.planned()?);
    let flight = Flight {
        lockstep: settings.flight.pace == PaceName::Lockstep,
        slowdown: settings.flight.slowdown,
        faults: faults.loops,
    };
    Ok(match role {
        Role::Plant => {
            let plant = own.plant()?;
            let plan = FlightPlan {
                last_tick: settings.last_tick(),
                sample_time_ns: settings.sample_time_ns(),
                wall_period_ns: settings.wall_period_ns(),
            };
            let route = settings.course()?.route(settings.flight.period_s);
            let simplex = settings.simplex_limits().map(|limits| (limits, route));
            Box::new(move |session| {
                let (swaps, loops) = (&faults.swaps, &flight.faults);
                plant::process::run(session, &plant, plan, swaps, loops, simplex)?;
                Ok(())
            })
        }
        Role::Outer => {
            let outer = own.outer_stage()?;
            let error_max_m = settings.flight.position_error_max_m;
            Box::new(move |session| Ok(stage::outer(session, outer, error_max_m, &flight)?))
        }
        Role::Inner => {
            let mut inner = own.inner_stage()?;
            inner
                .start(!flight.lockstep)
                .map_err(|e| Failure::failed(e.to_string()))?;
            Box::new(move |session| Ok(stage::inner(session, inner, &flight)?))
        }
        Role::Mixer => {
            let mixer = own.mixer_stage()?;
            Box::new(move |session| Ok(stage::mixer(session, mixer, &flight)?))
        }
        Role::Record => {
            let why = "the recorder has a command of its own: `ironbird record`";
            return Err(Failure::usage(why));
        }
    })
}

/// The last process without a supervisor removes what the middleware leaves; a supervisor does so itself.
fn leave(instance: &Instance, args: &RoleArgs) {
    if is_on_its_own(args.launcher) {
        remove_leftovers(instance);
    }
}

/// Records until the run is over; without a supervisor, prints the report.
pub fn record(args: &RecordArgs) -> Result<u8, Failure> {
    let begun_ns = now_ns();
    let settings = resolve(&args.role, args.recorder.overrides())?;
    check_outputs(&[("--states", args.recorder.states.as_deref())])?;
    // A supervisor has checked it already.
    kernel_trace::check(settings.recorder.trace && args.role.launcher.is_none())?;
    let session = RoleSession::take(
        Role::Record,
        start_config(Role::Record, &args.role, &settings, begun_ns)?,
    )?;
    let instance = session.wire().instance().clone();
    let mut created = None;
    if args.run_dir.is_none() {
        let out = Path::new(&settings.recorder.out);
        match RunDirectory::create(out, &settings, &args.role.rt.instance) {
            Ok(directory) => created = Some(directory),
            Err(failure) => {
                drop(session);
                leave(&instance, &args.role);
                return Err(failure);
            }
        }
    }
    let created_path = created.as_ref().map(|created| &created.path);
    let directory = args
        .run_dir
        .as_ref()
        .or(created_path)
        .cloned()
        .unwrap_or_default();
    let is_supervised = args.role.launcher.is_some();
    let memory = is_supervised.then(|| io::stdin().as_fd().try_clone_to_owned());
    let files = Files {
        directory: directory.clone(),
        memory: memory.and_then(Result::ok).map(File::from),
        states: args.recorder.states.clone(),
    };
    let stop = session.stop_flag();
    let margin = |pace| table::of_flight(pace, &settings, &directory);
    let recorded = recording::run(session, &settings, &files, margin);
    leave(&instance, &args.role);
    // Once the flight has begun, a file that cannot be written is no consequence of a signal.
    let has_begun = directory.join(LATENCIES).exists();
    let recorded =
        recorded.map_err(|failure| failure.broken_off(!has_begun && stop.load(Ordering::Relaxed)));
    if let (Err(_), Some(created)) = (&recorded, created) {
        created.discard();
    }
    let report = recorded?;
    if args.role.launcher.is_none() {
        print(&ended(&report, &directory))?;
    }
    Ok(report.verdict.exit_code)
}

fn start_config(
    role: Role,
    args: &RoleArgs,
    settings: &Settings,
    begun_ns: u64,
) -> Result<StartConfig, Failure> {
    if args.launcher.is_none() {
        settings.check_cpu()?;
    }
    log_to_stderr();
    Ok(StartConfig {
        instance: Instance::new(&args.rt.instance)?,
        rt: settings.realtime()?,
        settings: settings.shared_text()?,
        law_options: settings.law_options()?,
        channel: channel(role, args, settings)?,
        depth: recorder_depth(settings.wall_period_ns()),
        launcher: args.launcher,
        begun_ns,
    })
}

/// The channel of the role, which is one of the flight.
fn channel(role: Role, args: &RoleArgs, settings: &Settings) -> Result<Channel, Failure> {
    let (channel, channels) = (args.channel, settings.rt.channels);
    if Replica::new(role, channel).channel != channel {
        return Err(Failure::usage(format!(
            "--channel {channel}: all channels have one {role} process in common"
        ))
        .help("leave the flag out"));
    }
    if channel as usize >= channels {
        return Err(Failure::usage(format!(
            "--channel {channel}: the flight has {}",
            count(channels as u64, "channel")
        ))
        .help("start every role with as many channels: --channels 3 has a, b and c"));
    }
    Ok(channel)
}

/// Messages of a process that waits go to standard error; a loop that flies writes none.
fn log_to_stderr() {
    tracing_subscriber::fmt()
        .with_writer(io::stderr)
        .with_ansi(has_screen(&io::stderr()))
        .with_target(false)
        .without_time()
        // If the log's disk is full there is no other place to say so; the default would print, and panic.
        .log_internal_errors(false)
        .init();
}
