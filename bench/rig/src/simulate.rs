//! `ironbird simulate`: runs the four tick functions in one process, in simulated time.

use std::path::Path;
use std::time::Instant;

use controller::laws::adaptive;
use messages::parameters::{ESTIMATED, Parameter};

use crate::cli::SimulateArgs;
use crate::invalid_outputs::InvalidOutputs;
use crate::output::{print, say};
use crate::recorded_timing::Timing;
use crate::run_directory::find_log;
use crate::settings::Settings;
use crate::simulator::Simulator;
pub(crate) use crate::simulator::simulated_flight::{Judge, follow};
pub use crate::simulator::simulated_flight::{SimulatedFlight, fly, fly_with};
use crate::wall_time::speed;
use errors::{Failure, GATE, OK, check_writable, write_text};
use report::phrase::count;
use report::render::figures::Figures;
use report::render::picture;
use report::schema::Gate;
use report::states::StatesWriter;
use report::status::FlightStatus;
use report::theorem::TheoremStatistics;
use report::tracer::Tracer;
use report::tracking::Tracking;

pub fn simulate(args: &SimulateArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(args.flight.course.config.as_deref(), &args.overrides())?;
    check_writable("--states", args.states.as_deref())?;
    check_writable("--plot", args.plot.as_deref())?;
    check_drawn(args.plot.as_deref())?;
    for warning in settings.warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    let timing = args
        .timing
        .as_deref()
        .map(|run| Timing::read(&find_log(run, args.out.as_deref())?))
        .transpose()?;
    timing
        .iter()
        .try_for_each(|timing| timing.check(&settings, "--timing"))?;
    let leaves = OutputFiles {
        states: args.states.as_deref(),
        plot: args.plot.as_deref(),
    };
    Ok(report(&settings, timing.as_ref(), &leaves)?.1)
}

/// Files to write.
#[derive(Clone, Copy, Debug, Default)]
pub struct OutputFiles<'a> {
    pub states: Option<&'a Path>,
    pub plot: Option<&'a Path>,
}

/// Simulates a flight, optionally with recorded timing, and prints the result. Returns the flight and the exit code.
pub fn report(
    settings: &Settings,
    timing: Option<&Timing>,
    leaves: &OutputFiles<'_>,
) -> Result<(SimulatedFlight, u8), Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let laws = settings.flown_laws()?;
    let mut states = match leaves.states {
        Some(path) => {
            let every = settings.recorder.states_every_ticks;
            Some(StatesWriter::create(path, tracking, laws, every)?)
        }
        None => None,
    };
    let mut rig = Simulator::of(settings)?.with_monitor(settings.theorem()?);
    let mut observations = Observations::new(settings)?;
    let start = Instant::now();
    let mut tracer = leaves.plot.map(|_| Tracer::new(tracking));
    tracer.iter_mut().for_each(|tracer| tracer.flown_by(laws));
    let look = |rig: &Simulator| -> Result<(), Failure> {
        if let Some(states) = &mut states {
            states.write(&rig.joined())?;
        }
        if let Some(tracer) = &mut tracer {
            tracer.take(&rig.joined());
        }
        observations.take(rig);
        Ok(())
    };
    let flown = fly_with(&mut rig, settings, timing, look)?;
    let wall_s = start.elapsed().as_secs_f64();
    if let (Some(path), Some(tracer)) = (leaves.plot, &tracer) {
        let title = format!("{}, simulated", settings.flown());
        let figures = Figures {
            traces: &tracer.traces(),
            swaps: &flown.swaps,
            faults: &settings.injected()?,
            late: &[],
            period_s: settings.flight.period_s,
        };
        write_text(path, &picture::render(&figures, &title))?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    let theorem = observations.theorem.section();
    let gate = settings
        .recorder
        .gate_theorem
        .then(|| Gate::theorem(&theorem));
    let passes = flown.departure.is_none() && gate.as_ref().is_none_or(|gate| gate.held);
    let mut text =
        summary(&flown, settings, wall_s) + &observations.estimates() + "\n" + &theorem.text();
    text.extend(
        observations
            .unusable
            .sentences(settings)?
            .iter()
            .map(|sentence| format!("{sentence}\n")),
    );
    for fault in settings.injected()? {
        text += &format!("fault {}\n", fault.words());
    }
    if timing.is_some() || !settings.planned()?.spares_the_loop() {
        text += &outages(&rig);
    }
    text.extend(
        flown
            .departure
            .iter()
            .map(|departure| format!("{departure}\n")),
    );
    text.extend(
        gate.iter()
            .filter(|gate| !gate.held)
            .map(|gate| format!("{gate}\n")),
    );
    let status = if passes {
        FlightStatus::Pass
    } else {
        FlightStatus::Fail
    };
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

/// Effects of message and stage faults or of recorded timing.
fn outages(rig: &Simulator) -> String {
    let state = rig.state();
    format!(
        "{} skipped, {} missed, {} refused\n",
        count(state.ticks_skipped, "tick"),
        count(state.deadlines_missed, "deadline"),
        count(rig.rejections().total(), "message")
    )
}

/// Refuses a plot file that is not SVG.
fn check_drawn(path: Option<&Path>) -> Result<(), Failure> {
    match path.filter(|path| {
        path.extension()
            .is_none_or(|ending| !ending.eq_ignore_ascii_case("svg"))
    }) {
        Some(path) => Err(
            Failure::usage(format!("--plot {}: only SVG is drawn", path.display()))
                .help("name a file that ends in .svg; browsers and most converters read it"),
        ),
        None => Ok(()),
    }
}

fn summary(flown: &SimulatedFlight, settings: &Settings, wall_s: f64) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    format!(
        "{}: {}, {flown_s:.3} s simulated in {}\nposition error {}\n",
        settings.flown(),
        count(flown.ticks, "tick"),
        speed(flown_s, wall_s),
        flown.error
    )
}

/// The theorem, the last estimates, and law outputs that could not be used.
struct Observations {
    theorem: TheoremStatistics,
    has_estimates: bool,
    /// Estimate and true value of each parameter.
    newest: Option<[(f64, f64); ESTIMATED.len()]>,
    unusable: InvalidOutputs,
}

impl Observations {
    fn new(settings: &Settings) -> Result<Self, Failure> {
        let mut theorem = TheoremStatistics::default();
        theorem.flown_by(&settings.airframe()?);
        let law_without = settings.law_without_theorem()?;
        law_without
            .into_iter()
            .for_each(|law| theorem.does_not_apply(law));
        Ok(Self {
            theorem,
            has_estimates: law_without.is_none(),
            newest: None,
            unusable: InvalidOutputs::default(),
        })
    }

    fn take(&mut self, rig: &Simulator) {
        self.unusable.take(rig);
        let actual = rig.state().truth.theta();
        self.theorem.truth(actual);
        let Some(wrench) = rig.new_wrench() else {
            return;
        };
        rig.monitor()
            .into_iter()
            .for_each(|monitor| self.theorem.take(0, monitor));
        if self.has_estimates {
            let estimate = adaptive::estimate(&wrench.telemetry);
            self.newest = Some(std::array::from_fn(|i| (estimate[i], actual[i])));
        }
    }

    fn estimates(&self) -> String {
        let line = |(parameter, (estimated, actual)): (Parameter, (f64, f64))| {
            format!(
                "  {:<24} estimated {estimated:>12.6e}  true {actual:>12.6e}\n",
                parameter.name()
            )
        };
        self.newest
            .into_iter()
            .flat_map(|newest| ESTIMATED.into_iter().zip(newest))
            .map(line)
            .collect()
    }
}
