//! `ironbird compare`: simulates one flight with several combinations of laws; with `--table`, one per row of a file.
//!
//! Each flight equals `ironbird simulate` with the same options bit for bit. Flights are independent and spread over the
//! CPUs.

use std::collections::BTreeSet;
use std::path::Path;

use analysis::comparison::{Comparison, Fault, Flight, Outcome, SCHEMA};
use analysis::flight_metrics::ComparedFlight;
use analysis::tracking::Tracking;
use render::comparison::{document, tables};
use serde::Deserialize;
use toml::Value;

use crate::build;
use crate::cli::CompareArgs;
use crate::report_command::publish;
use config::{Overrides, Settings};
use errors::output::{print, say};
use errors::{Failure, OK, USAGE, check_writable, read_text};
use experiments::combinations;
use experiments::parallel::{all_on_processors, processors};
use sim::simulate::{self, InvalidOutputs};
use sim::simulator::Simulator;

/// Longest flight [ticks]: all position errors are kept in memory.
const TICKS_MAX: u64 = 1_000_000;
const ROWS_MAX: usize = 50;

pub fn compare(args: &CompareArgs) -> Result<u8, Failure> {
    check_writable("--page", args.page.as_deref())?;
    let most = match args.table {
        Some(_) => combinations::TABLE_MAX,
        None => combinations::PAGE_MAX,
    };
    let laws = &args.laws;
    let combinations = combinations::of(&laws.outer, &laws.inner, &laws.mixer, most)?;
    if combinations.len() == 1 {
        return Err(Failure::usage("only one combination of laws: nothing to compare")
            .help("name at least two laws, for example --inner adaptive --inner indi; `ironbird laws` lists them"));
    }
    let overrides = args.course.overrides();
    if let Some(path) = &args.table {
        let mut plans = Vec::new();
        let rows = read_rows(path)?;
        for Row { name, faults } in &rows {
            let faults = vec![("flight.faults", Value::from(faults.clone()))];
            let overrides = [overrides.clone(), faults].concat();
            let plan = Plan::new(args, &combinations, &overrides);
            let of_row = format!(" (row `{name}` of {})", path.display());
            plans.push(plan.map_err(|failure| failure.append(&of_row))?);
        }
        let names = rows.into_iter().map(|row| row.name);
        let named: Vec<(String, Comparison)> = names.zip(fly_all(&plans)?).collect();
        print(&tables(&named))?;
        return Ok(OK);
    }
    let plan = Plan::new(args, &combinations, &overrides)?;
    let mut warnings: Vec<String> = Vec::new();
    for settings in &plan.settings {
        for warning in settings.warnings()? {
            // Once if it is the same for several laws.
            if !warnings.contains(&warning) {
                say(&format!("warning: {warning}\n"));
                warnings.push(warning);
            }
        }
    }
    let comparison = fly_all(&[plan])?.remove(0);
    let page = args.page.as_deref();
    publish(&document(&comparison), &comparison, args.format, page)?;
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
        let config = args.course.config.as_deref();
        let settings = combinations::resolve(config, overrides, combinations)?;
        let first = &settings[0];
        let last_tick = first.last_tick();
        if last_tick >= TICKS_MAX {
            let ticks = last_tick + 1;
            let most = format!("too long to be compared: allowed are {TICKS_MAX}");
            return Err(
                Failure::usage(format!("a flight of {ticks} ticks is {most}"))
                    .help("fly a shorter one (--duration)"),
            );
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
    let typed = settings.typed_faults();
    let mut typed = typed.map_err(|e| Failure::usage(format!("fault: {e}")))?;
    typed.sort_by_key(|fault| fault.from.tick(period_s));
    let mut faults: Vec<Fault> = Vec::new();
    for fault in typed {
        let (tick, what) = (fault.from.tick(period_s), fault.what());
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

/// Flies all plans on all CPUs.
fn fly_all(plans: &[Plan]) -> Result<Vec<Comparison>, Failure> {
    let flights = plans.iter();
    let flights: Vec<(&Flight, &Settings)> = flights
        .flat_map(|plan| plan.settings.iter().map(|it| (&plan.flight, it)))
        .collect();
    let fly = |(flight, settings): &(&Flight, &Settings)| fly(flight, settings);
    let mut outcomes = all_on_processors(&flights, processors(), fly, |_| ())?.into_iter();
    let compared = |plan: &Plan| Comparison {
        schema: SCHEMA,
        build: build::here(),
        flight: plan.flight.clone(),
        outcomes: outcomes.by_ref().take(plan.settings.len()).collect(),
    };
    Ok(plans.iter().map(compared).collect())
}

fn fly(flight: &Flight, settings: &Settings) -> Result<Outcome, Failure> {
    let tracking = Tracking::along(settings.course()?, flight.period_s);
    let mut metrics = ComparedFlight::new(tracking, &settings.airframe()?);
    let mut rig = Simulator::of(settings)?;
    let mut invalid = InvalidOutputs::default();
    let flown = simulate::fly(&mut rig, settings, |rig| {
        invalid.take(rig);
        metrics.take(rig.flown_tick(), rig.state(), rig.rotor_speeds());
        Ok(())
    })?;
    let ended_early = flown.ticks <= flight.last_tick;
    Ok(Outcome {
        laws: combinations::laws(settings)?,
        ticks: flown.ticks,
        ended_early_s: ended_early.then(|| flight.time_s(flown.ticks.saturating_sub(1))),
        lost: flown.departure,
        unusable: invalid.sentences(settings)?,
        figures: metrics.figures(flight),
        outputs: flown.outputs.to_string(),
    })
}

/// The file of `--table`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rows {
    #[serde(default)]
    row: Vec<Row>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: String,
    /// With the syntax of `--fault`.
    faults: Vec<String>,
}

fn read_rows(path: &Path) -> Result<Vec<Row>, Failure> {
    const HELP: &str =
        "each row reads: [[row]], name = \"heavier\", faults = [\"mass_kg=+30%@8s\"]";
    let refused = |what: String| {
        let what = format!("--table {}: {what}", path.display());
        Err(Failure::usage(what).help(HELP))
    };
    let text = read_text("read the table", path);
    let text = text.map_err(|failure| failure.or_code(USAGE).help(HELP))?;
    let rows = match toml::from_str(&text) {
        Ok(Rows { row }) => row,
        Err(e) => return refused(e.to_string().trim_end().replace('\n', " ")),
    };
    let mut names = BTreeSet::new();
    if let Some(twice) = rows.iter().find(|row| !names.insert(&row.name)) {
        return refused(format!("two rows have the name `{}`", twice.name));
    }
    match rows.len() {
        0 => refused("it has no row".into()),
        1..=ROWS_MAX => Ok(rows),
        number => refused(format!("it has {number} rows: allowed are {ROWS_MAX}")),
    }
}
