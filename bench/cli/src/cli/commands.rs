//! Commands that only have to check their flags before they run: `simulate`, `replay`, `inject`, `cpu-load`.

use std::path::Path;
use std::time::{Instant, SystemTime};

use crate::cli::fly::with_junit;
use crate::cli::{CpuLoadArgs, InjectArgs, ReplayArgs, SimulateArgs};
use config::Settings;
use errors::output::{print, say};
use errors::{Failure, OK, check_outputs};
use flight_log::wall_time::utc;
use host::cpu_times::hostname;
use ipc::instance::Instance;
use live::inject::{self, When};
use recorder::run_directory::find_log;
use render::junit::{self, Suite};
use sim::recorded_timing::Timing;
use sim::simulate::{self, OutputFiles};
use supervisor::cpu_load;

pub fn simulate(args: &SimulateArgs) -> Result<u8, Failure> {
    let junit = (junit::SIMULATE, args.junit.as_deref());
    let others = [args.states.as_deref(), args.plot.as_deref()];
    with_junit(&args.flight, junit, &others, || simulated(args))
}

fn simulated(args: &SimulateArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(args.flight.course.config.as_deref(), &args.overrides())?;
    let (states, plot) = (args.states.as_deref(), args.plot.as_deref());
    let junit = args.junit.as_deref();
    let is_svg = |path: &Path| {
        path.extension()
            .is_some_and(|it| it.eq_ignore_ascii_case("svg"))
    };
    if let Some(path) = plot.filter(|path| !is_svg(path)) {
        return Err(
            Failure::usage(format!("--plot {}: only SVG is drawn", path.display()))
                .help("name a file that ends in .svg; browsers and most converters read it"),
        );
    }
    for warning in settings.warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    let mut timing = None;
    if let Some(run) = &args.timing {
        let recorded = Timing::read(&find_log(run, args.out.as_deref())?)?;
        recorded.check(&settings, "--timing")?;
        timing = Some(recorded);
    }
    check_outputs(&[("--states", states), ("--plot", plot), ("--junit", junit)])?;
    let files = OutputFiles { states, plot };
    let (begun, started) = (Instant::now(), utc(SystemTime::now()));
    let (flown, result) = simulate::report(&settings, timing.as_ref(), &files)?;
    if let Some(path) = junit {
        let suite = Suite {
            name: junit::SIMULATE,
            started: &started,
            host: &hostname(),
            elapsed_s: begun.elapsed().as_secs_f64(),
            properties: vec![
                ("flown".into(), settings.conditions()),
                ("status".into(), result.status.to_string()),
                ("outputs".into(), flown.outputs.to_string()),
            ],
            gates: &result.gates,
            ..Suite::default()
        };
        suite.write(path)?;
    }
    Ok(result.exit_code)
}

pub fn replay(args: &ReplayArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    ::replay::replay(&path, args.from, args.verify, &args.moved())
}

pub fn inject(args: &InjectArgs) -> Result<u8, Failure> {
    let changes = args.parsed();
    let changes = changes.map_err(|e| Failure::usage(e.to_string()).help(e.listed("")))?;
    let when = match (args.at_tick, args.after) {
        (Some(tick), _) => When::AtTick(tick),
        (None, after) => When::In(after.unwrap_or_default()),
    };
    let instance = Instance::new(&args.instance)?;
    print(&inject::injected(&instance, &changes, when, args.lasts)?)?;
    Ok(OK)
}

pub fn cpu_load(args: &CpuLoadArgs) -> Result<u8, Failure> {
    let time_ns = args.from_ns..args.until_ns;
    cpu_load::cpu_load((args.cpu, args.priority), args.share, time_ns)
}
