//! `ironbird compare`: simulates one flight with several combinations of laws.
//!
//! Each flight equals `ironbird simulate` with the same options bit for bit. Flights are independent and spread over the
//! CPUs.

mod fault_table;

use report::comparison::{Comparison, Fault, Flight, Laws, Outcome, SCHEMA};
use report::flight_metrics::ComparedFlight;
use report::json;
use report::render::comparison::document;
use report::tracking::Tracking;

use crate::build;
use crate::cli::{CompareArgs, DiffFormat};
use crate::combinations;
use crate::invalid_outputs::InvalidOutputs;
use crate::output::{print, say};
use crate::parallel::{on_processors, processors};
use crate::settings::{Overrides, Settings};
use crate::simulate;
use crate::simulator::Simulator;
use errors::{Failure, OK, check_writable, write_text};

/// Longest flight [ticks]: all position errors are kept in memory.
const TICKS_MAX: u64 = 1_000_000;

/// Compares laws.
///
/// # Errors
/// Usage: laws that are unknown, named twice, too few or too many; a flight that is too long. A file that cannot be
/// written.
pub fn compare(args: &CompareArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let combinations = combinations::of(&args.laws.outer, &args.laws.inner, &args.laws.mixer)?;
    if combinations.len() == 1 {
        return Err(Failure::usage("only one combination of laws: nothing to compare")
            .help("name at least two laws, for example --inner adaptive --inner indi; `ironbird laws` lists them"));
    }
    if let Some(path) = &args.table {
        print(&fault_table::tables(args, &combinations, path)?)?;
        return Ok(OK);
    }
    let plan = Plan::new(args, &combinations, &args.course.overrides())?;
    warn(&plan)?;
    let comparison = flown(&[plan])?.remove(0);
    if let Some(path) = &args.page {
        write_text(path, &document(&comparison).html())?;
        say(&format!("written: {}\n", path.display()));
    }
    match args.format {
        DiffFormat::Text => print(&document(&comparison).text())?,
        DiffFormat::Json => print(
            &(json::to_string(&comparison).map_err(|e| Failure::failed(e.to_string()))? + "\n"),
        )?,
    }
    Ok(OK)
}

#[derive(Debug)]
struct Plan {
    flight: Flight,
    settings: Vec<Settings>,
}

impl Plan {
    /// The flight of the settings file and `overrides`, for at least one combination of laws.
    fn new(
        args: &CompareArgs,
        combinations: &[Overrides],
        overrides: &Overrides,
    ) -> Result<Self, Failure> {
        let resolve = |laws: &Overrides| {
            Settings::resolve(
                args.course.config.as_deref(),
                &[overrides.clone(), laws.clone()].concat(),
            )
        };
        let settings: Vec<Settings> = combinations.iter().map(resolve).collect::<Result<_, _>>()?;
        combinations::check_names(combinations, &settings)?;
        let first = &settings[0];
        let last_tick = first.last_tick();
        if last_tick >= TICKS_MAX {
            return Err(Failure::usage(format!(
                "a flight of {} ticks is too long to be compared: allowed are {TICKS_MAX}",
                last_tick + 1
            ))
            .help("fly a shorter one (--duration)"));
        }
        let flight = Flight {
            trajectory: first.trajectory_name().into(),
            airframe: first.flight.airframe.clone(),
            preset: first.flight.preset.clone(),
            seed: first.flight.seed,
            last_tick,
            period_s: first.flight.period_s,
            bound_m: args.recovered_below,
            faults: faults(first)?,
        };
        Ok(Self { flight, settings })
    }
}

/// The faults in order, merged by tick.
fn faults(settings: &Settings) -> Result<Vec<Fault>, Failure> {
    let period_s = settings.flight.period_s;
    let typed = settings
        .typed_faults()
        .map_err(|e| Failure::usage(format!("fault: {e}")))?;
    let mut all: Vec<(u64, String)> = typed
        .iter()
        .map(|fault| (fault.from.tick(period_s), fault.what()))
        .collect();
    all.sort_by_key(|(tick, _)| *tick);
    let mut faults: Vec<Fault> = Vec::new();
    for (tick, what) in all {
        match faults.last_mut().filter(|last| last.tick == tick) {
            Some(last) => last.what += &format!(",{what}"),
            None => faults.push(Fault {
                tick,
                time_s: tick as f64 * period_s,
                what,
            }),
        }
    }
    Ok(faults)
}

/// Prints warnings, once if they are the same for all laws.
fn warn(plan: &Plan) -> Result<(), Failure> {
    let mut said: Vec<String> = Vec::new();
    for settings in &plan.settings {
        for warning in settings.warnings()? {
            if !said.contains(&warning) {
                say(&format!("warning: {warning}\n"));
                said.push(warning);
            }
        }
    }
    Ok(())
}

/// Flies all plans on all CPUs.
fn flown(plans: &[Plan]) -> Result<Vec<Comparison>, Failure> {
    let flights: Vec<_> = plans
        .iter()
        .flat_map(|plan| plan.settings.iter().map(move |it| (&plan.flight, it)))
        .collect();
    let mut outcomes = on_processors(
        &flights,
        processors(),
        |(flight, settings)| fly(flight, settings),
        |_| (),
    )
    .into_iter();
    let compared = |plan: &Plan| {
        let outcomes = outcomes
            .by_ref()
            .take(plan.settings.len())
            .collect::<Result<_, _>>()?;
        Ok(Comparison {
            schema: SCHEMA,
            build: build::here(),
            flight: plan.flight.clone(),
            outcomes,
        })
    };
    plans.iter().map(compared).collect()
}

fn fly(flight: &Flight, settings: &Settings) -> Result<Outcome, Failure> {
    let airframe = settings.airframe()?;
    let mut tally = ComparedFlight::new(
        Tracking::along(settings.course()?, flight.period_s),
        &airframe,
    );
    let mut rig = Simulator::of(settings)?;
    let mut unusable = InvalidOutputs::default();
    let flown = simulate::fly(&mut rig, settings, |rig| {
        unusable.take(rig);
        tally.take(rig.flown_tick(), rig.state(), rig.rotor_speeds());
        Ok(())
    })?;
    let [outer, inner, mixer] = settings.laws()?.map(|law| law.name.to_owned());
    Ok(Outcome {
        laws: Laws {
            outer,
            inner,
            mixer,
        },
        ticks: flown.ticks,
        ended_early_s: (flown.ticks <= flight.last_tick)
            .then(|| flight.time_s(flown.ticks.saturating_sub(1))),
        lost: flown.departure,
        unusable: unusable.sentences(settings)?,
        figures: tally.figures(flight),
        outputs: flown.outputs.to_string(),
    })
}
