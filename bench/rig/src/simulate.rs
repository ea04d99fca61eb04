//! `ironbird simulate`: runs the same four tick functions in one process, in simulated time.

mod flight;

use std::path::Path;
use std::time::Instant;

use controller::laws::adaptive;
use model::parameters::{ESTIMATED, Parameter};

use crate::cli::SimulateArgs;
use crate::in_process::InProcess;
use crate::output::{print, say};
use crate::run_directory::find_log;
use crate::settings::Settings;
use crate::timing::Timing;
use crate::unusable::Unusable;
use crate::wall_time::speed;
use failure::{Failure, GATE, OK, check_writable, write_text};
pub(crate) use flight::{Judge, follow};
pub use flight::{Simulated, fly, fly_with};
use report::page::picture;
use report::schema::Gate;
use report::states::StatesWriter;
use report::status::FlightStatus;
use report::tally::theorem::TheoremTally;
use report::tally::tracer::Tracer;
use report::text::count;
use report::tracking::Tracking;

/// Simulates a flight.
///
/// # Errors
/// Usage; a file that cannot be written.
pub fn simulate(args: &SimulateArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(args.flight.course.config.as_deref(), &args.overrides())?;
    check_writable("--states", args.states.as_deref())?;
    check_writable("--plot", args.plot.as_deref())?;
    check_drawn(args.plot.as_deref())?;
    for warning in settings.warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    let timing = args.timing.as_deref().map(|run| Timing::read(&find_log(run, args.out.as_deref())?)).transpose()?;
    timing.iter().try_for_each(|timing| timing.check(&settings, "--timing"))?;
    let leaves = Leaves { states: args.states.as_deref(), plot: args.plot.as_deref() };
    Ok(told(&settings, timing.as_ref(), &leaves)?.1)
}

/// Files that a simulated flight leaves.
#[derive(Clone, Copy, Debug, Default)]
pub struct Leaves<'a> {
    /// Its states.
    pub states: Option<&'a Path>,
    /// Its picture.
    pub plot: Option<&'a Path>,
}

/// Simulates a flight, on time or with the timing of a recorded one, and tells of it; its outputs and the exit code.
///
/// # Errors
/// Settings that cannot be flown; a file that cannot be written.
pub fn told(settings: &Settings, timing: Option<&Timing>, leaves: &Leaves<'_>) -> Result<(Simulated, u8), Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let laws = settings.flown_laws()?;
    let mut states = match leaves.states {
        Some(path) => {
            let every = settings.recorder.states_every_ticks;
            Some(StatesWriter::create(path, tracking, laws, every)?)
        }
        None => None,
    };
    let mut rig = InProcess::of(settings)?.watched(settings.theorem()?);
    let mut watched = Watched::new(settings)?;
    let start = Instant::now();
    let mut tracer = leaves.plot.map(|_| Tracer::new(tracking));
    tracer.iter_mut().for_each(|tracer| tracer.flown_by(laws));
    let look = |rig: &InProcess| -> Result<(), Failure> {
        if let Some(states) = &mut states {
            states.write(&rig.joined())?;
        }
        if let Some(tracer) = &mut tracer {
            tracer.take(&rig.joined());
        }
        watched.take(rig);
        Ok(())
    };
    let flown = fly_with(&mut rig, settings, timing, look)?;
    let wall_s = start.elapsed().as_secs_f64();
    if let (Some(path), Some(tracer)) = (leaves.plot, &tracer) {
        let title = format!("{}, simulated", settings.flown());
        let svg =
            picture::render(&tracer.traces(), &flown.swaps, &settings.injected()?, settings.flight.period_s, &title);
        write_text(path, &svg)?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    let theorem = watched.theorem.section();
    let gate = settings.recorder.gate_theorem.then(|| Gate::theorem(&theorem));
    let passes = flown.departure.is_none() && gate.as_ref().is_none_or(|gate| gate.held);
    let mut text = summary(&flown, settings, wall_s) + &watched.estimates() + &theorem.text();
    text.extend(watched.unusable.sentences(settings)?.iter().map(|sentence| format!("{sentence}\n")));
    for fault in settings.injected()? {
        text += &format!("fault {}\n", fault.words());
    }
    if timing.is_some() || !settings.planned()?.spares_the_loop() {
        text += &outages(&rig);
    }
    text.extend(flown.departure.iter().map(|departure| format!("{departure}\n")));
    text.extend(gate.iter().filter(|gate| !gate.held).map(|gate| format!("{gate}\n")));
    let status = if passes { FlightStatus::Pass } else { FlightStatus::Fail };
    let held = usize::from(gate.as_ref().is_some_and(|gate| gate.held));
    text += &format!(
        "RESULT status={status} gates={held}/{} ticks={} outputs={} run=none\n",
        gate.iter().len(),
        flown.ticks,
        flown.outputs
    );
    print(&text)?;
    Ok((flown, if passes { OK } else { GATE }))
}

/// What faults of messages and stages, or the timing of another flight, came to.
fn outages(rig: &InProcess) -> String {
    let state = rig.state();
    format!(
        "{} skipped, {} missed, {} refused\n",
        count(state.ticks_skipped, "tick"),
        count(state.deadlines_missed, "deadline"),
        count(rig.rejections().total(), "message")
    )
}

/// Whether a picture goes by the name of what is drawn.
fn check_drawn(path: Option<&Path>) -> Result<(), Failure> {
    match path.filter(|path| path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("svg"))) {
        Some(path) => Err(Failure::usage(format!("--plot {}: only SVG is drawn", path.display()))
            .help("name a file that ends in .svg; browsers and most converters read it")),
        None => Ok(()),
    }
}

/// What was flown, and how well.
fn summary(flown: &Simulated, settings: &Settings, wall_s: f64) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    format!(
        "{}: {}, {flown_s:.3} s simulated in {}\nposition error {}\n",
        settings.flown(),
        count(flown.ticks, "tick"),
        speed(flown_s, wall_s),
        flown.error
    )
}

/// What is said of a flight's laws: the theorem, the estimates that it ends with, answers that could not be used.
struct Watched {
    theorem: TheoremTally,
    has_estimates: bool,
    /// Estimate and truth of each parameter.
    newest: Option<[(f64, f64); ESTIMATED.len()]>,
    unusable: Unusable,
}

impl Watched {
    fn new(settings: &Settings) -> Result<Self, Failure> {
        let mut theorem = TheoremTally::default();
        theorem.flown_by(&settings.airframe()?);
        let law_without = settings.law_without_theorem()?;
        law_without.into_iter().for_each(|law| theorem.does_not_apply(law));
        Ok(Self { theorem, has_estimates: law_without.is_none(), newest: None, unusable: Unusable::default() })
    }

    fn take(&mut self, rig: &InProcess) {
        self.unusable.take(rig);
        let actual = rig.state().truth.theta();
        self.theorem.truth(actual);
        let Some(wrench) = rig.new_wrench() else { return };
        rig.monitor().into_iter().for_each(|monitor| self.theorem.take(0, monitor));
        if self.has_estimates {
            let estimate = adaptive::estimate(&wrench.telemetry);
            self.newest = Some(std::array::from_fn(|i| (estimate[i], actual[i])));
        }
    }

    fn estimates(&self) -> String {
        let line = |(parameter, (estimated, actual)): (Parameter, (f64, f64))| {
            format!("  {:<24} estimated {estimated:>12.6e}  true {actual:>12.6e}\n", parameter.name())
        };
        self.newest.into_iter().flat_map(|newest| ESTIMATED.into_iter().zip(newest)).map(line).collect()
    }
}
