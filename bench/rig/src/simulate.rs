//! `ironbird simulate`: runs the same four tick functions in one process, in simulated time.

use std::path::Path;
use std::time::Instant;

use model::output_hash::OutputHash;
use model::parameters::ESTIMATED;
use plant::Departure;
use plant::desk::swap_record;

use crate::cli::SimulateArgs;
use crate::in_process::InProcess;
use crate::output::{print, say};
use crate::settings::Settings;
use crate::wall_time::speed;
use failure::{Failure, GATE, OK, check_writable, write_text};
use report::page::picture;
use report::schema::{AppliedSwap, Gate};
use report::states::{Joined, StatesWriter};
use report::status::FlightStatus;
use report::tally::theorem::{Theorem, TheoremTally};
use report::tally::tracer::Tracer;
use report::text;
use report::tracking::{Tracking, TrackingError};

/// Simulates a flight.
///
/// # Errors
/// Usage; a file that cannot be written.
pub fn simulate(args: &SimulateArgs) -> Result<u8, Failure> {
    let settings = Settings::resolve(args.flight.config.as_deref(), &args.overrides())?;
    check_writable("--states", args.states.as_deref())?;
    check_writable("--plot", args.plot.as_deref())?;
    check_drawn(args.plot.as_deref())?;
    for warning in settings.warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let mut states = match &args.states {
        Some(path) => {
            let every = settings.recorder.states_every_ticks;
            Some(StatesWriter::create(path, tracking, every)?)
        }
        None => None,
    };
    let mut rig = InProcess::of(&settings)?.watched(&settings.controller()?);
    let start = Instant::now();
    let mut tracer = args.plot.as_ref().map(|_| Tracer::new(tracking));
    let flown = fly(&mut rig, &settings, states.as_mut(), tracer.as_mut())?;
    let wall_s = start.elapsed().as_secs_f64();
    if let (Some(path), Some(tracer)) = (&args.plot, &tracer) {
        let title = format!("{}, simulated", text::flown(settings.trajectory_name(), settings.flight.preset));
        let svg = picture::render(&tracer.traces(), &flown.swaps, settings.flight.period_s, &title);
        write_text(path, &svg)?;
    }
    if let Some(states) = &mut states {
        states.flush()?;
    }
    print(&summary(&flown, &settings, wall_s))?;
    Ok(if flown.passes(&settings) { OK } else { GATE })
}

/// Whether a picture goes by the name of what is drawn.
fn check_drawn(path: Option<&Path>) -> Result<(), Failure> {
    match path.filter(|path| path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("svg"))) {
        Some(path) => Err(Failure::usage(format!("--plot {}: only SVG is drawn", path.display()))
            .help("name a file that ends in .svg; browsers and most converters read it")),
        None => Ok(()),
    }
}

fn summary(flown: &Simulated, settings: &Settings, wall_s: f64) -> String {
    let flown_s = flown.ticks as f64 * settings.flight.period_s;
    let mut text = format!(
        "{}: {} ticks, {flown_s:.3} s simulated in {}\n",
        text::flown(settings.trajectory_name(), settings.flight.preset),
        flown.ticks,
        speed(flown_s, wall_s)
    );
    text += &format!("position error {}\n", flown.error);
    for (name, estimated, actual) in &flown.estimates {
        text += &format!("  {name:<24} estimated {estimated:>12.6e}  true {actual:>12.6e}\n");
    }
    text += &flown.theorem.text();
    if let Some(departure) = &flown.departure {
        text += &format!("{departure}\n");
    }
    let gate = flown.gate(settings);
    let held = usize::from(gate.as_ref().is_some_and(|gate| gate.held));
    text.extend(gate.iter().filter(|gate| !gate.held).map(|gate| format!("{gate}\n")));
    let status = if flown.passes(settings) { FlightStatus::Pass } else { FlightStatus::Fail };
    text + &format!(
        "RESULT status={status} gates={held}/{} ticks={} outputs={} run=none\n",
        gate.iter().len(),
        flown.ticks,
        flown.outputs
    )
}

struct Simulated {
    ticks: u64,
    outputs: OutputHash,
    error: TrackingError,
    estimates: [(&'static str, f64, f64); 3],
    theorem: Theorem,
    swaps: Vec<AppliedSwap>,
    departure: Option<String>,
}

impl Simulated {
    /// The theorem, where it is a gate.
    fn gate(&self, settings: &Settings) -> Option<Gate> {
        settings.recorder.gate_theorem.then(|| Gate::theorem(&self.theorem))
    }

    /// Whether the envelope held, and the gate.
    fn passes(&self, settings: &Settings) -> bool {
        self.departure.is_none() && self.gate(settings).is_none_or(|gate| gate.held)
    }
}

fn fly(
    rig: &mut InProcess,
    settings: &Settings,
    mut states: Option<&mut StatesWriter>,
    mut tracer: Option<&mut Tracer>,
) -> Result<Simulated, Failure> {
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let mut theorem = TheoremTally::default();
    theorem.flown_by(&settings.airframe()?);
    let mut lowest_z_m = f64::INFINITY;
    let mut flown = Simulated {
        ticks: 0,
        outputs: OutputHash::default(),
        error: TrackingError::default(),
        estimates: ESTIMATED.map(|parameter| (parameter.name(), 0.0, 0.0)),
        theorem: Theorem::default(),
        swaps: Vec::new(),
        departure: None,
    };
    for tick in 0..=settings.last_tick() {
        rig.tick();
        let (state, setpoint, wrench) = (rig.state(), rig.setpoint(), rig.wrench());
        if let Err(departure) = rig.envelope() {
            flown.departure = Some(departure.to_string());
            // As in a flight of processes, what is no number is not published.
            if matches!(departure, Departure::NotFinite { .. }) {
                break;
            }
        }
        flown.ticks += 1;
        lowest_z_m = lowest_z_m.min(state.position_w_m[2]);
        flown.outputs.take(tick, state);
        setpoint.iter().for_each(|setpoint| flown.outputs.take(tick, *setpoint));
        flown.outputs.take(tick, wrench);
        flown.outputs.take(tick, rig.rotor_speeds());
        if let Some(states) = &mut states {
            states.write(&Joined::from(&rig.record()))?;
        }
        let applied = rig.plant().applied().iter();
        flown
            .swaps
            .extend(applied.map(|swap| AppliedSwap::new(swap.tick, settings.flight.period_s, &swap_record(swap))));
        if let Some(tracer) = &mut tracer {
            tracer.take(&Joined::from(&rig.record()));
        }
        // A set-point carries the reference of its tick already.
        let error_m =
            setpoint.map_or_else(|| tracking.error_m(tick, state), |setpoint| setpoint.position_error_m(state));
        flown.error.take(error_m);
        if error_m > settings.flight.position_error_max_m {
            flown.departure = Some(format!(
                "the flight left its envelope: at tick {tick} the position error is {error_m:.2} m, allowed are {} m",
                settings.flight.position_error_max_m
            ));
        }
        let actual = state.truth.theta();
        theorem.truth(actual);
        rig.monitor().into_iter().for_each(|monitor| theorem.take(0, monitor));
        for (i, estimate) in flown.estimates.iter_mut().enumerate() {
            (estimate.1, estimate.2) = (wrench.estimate[i], actual[i]);
        }
        if flown.departure.is_some() {
            break;
        }
    }
    let ground_z_m = settings.flight.ground_z_m;
    if flown.departure.is_none() && lowest_z_m < ground_z_m {
        flown.departure = Some(format!(
            "the flight was below ground: down to z = {lowest_z_m:.2} m, the ground is at {ground_z_m} m"
        ));
    }
    flown.theorem = theorem.section();
    Ok(flown)
}
