//! `ironbird compare`: simulates one flight with several combinations of laws; with `--table` or `--suite`, one per row.
//!
//! Each flight equals `ironbird simulate` with the same options bit for bit. Flights are independent and spread over the
//! CPUs.

use std::collections::BTreeSet;
use std::path::PathBuf;

use analysis::comparison::{Comparison, Fault, Flight, Outcome, SCHEMA};
use analysis::flight_metrics::ComparedFlight;
use analysis::gates::{Measured, Number};
use analysis::schema::Gate;
use analysis::tracer::Tracer;
use analysis::tracking::Tracking;
use config::law_settings::known;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use render::cases::Cases;
use render::comparison::document;
use serde::Deserialize;
use toml::Value;

use crate::build;
use crate::cli::values::limit;
use crate::cli::{CompareArgs, DiffFormat, SUITES};
use crate::report_command::{exit_code, publish};
use config::{Overrides, Settings, overrides};
use errors::output::{print, say};
use errors::{Failure, USAGE, check_outputs, read_text, toml_mistake, write_text};
use experiments::combinations::{self, Combination};
use experiments::parallel::{jobs, on_processors};
use experiments::progress::Progress;
use sim::simulate::{self, InvalidOutputs};
use sim::simulator::Simulator;

/// Longest flight [ticks]: all position errors are kept in memory.
const TICKS_MAX: u64 = 1_000_000;
const ROWS_MAX: usize = 50;
const FAULTS: &str = "flight.faults";
/// Latest instant of a fault [s]: no flight is that long.
const INSTANT_MAX_S: f64 = 1e6;
/// Default of `--recovered-below` [m].
const RECOVERED_BELOW_M: f64 = 0.05;

pub fn compare(args: &CompareArgs) -> Result<u8, Failure> {
    let table = CaseTable::of(args)?;
    check_outputs(&[
        ("--page", args.page.as_deref()),
        ("--picture", args.picture.as_deref()),
        ("--csv", args.csv.as_deref()),
    ])?;
    let mut laws = args.laws.clone();
    if table.is_some() && laws.inner.is_empty() {
        let inner = known(Role::Inner).into_iter();
        let inner = inner.filter(|law| !firmware::is_program(law.name));
        laws.inner = inner.map(|law| law.name.to_owned()).collect();
    }
    let most = match table {
        Some(_) => combinations::TABLE_MAX,
        None => combinations::PAGE_MAX,
    };
    let combinations = combinations::of(&laws.outer, &laws.inner, &laws.mixer, most)?;
    if combinations.len() == 1 {
        return Err(Failure::usage("only one combination of laws: nothing to compare")
            .help("name at least two laws, for example --inner adaptive --inner indi; `ironbird laws` lists them"));
    }
    let overrides = args.course.overrides();
    if let Some(table) = table {
        return fly_table(args, table, &combinations, &overrides);
    }
    if args.traces && !matches!(args.format, DiffFormat::Json) {
        return Err(Failure::usage("--traces prints the curves as JSON")
            .help("add --format json; a page has them in any case: --page FILE.html"));
    }
    let bound_m = args.recovered_below.unwrap_or(RECOVERED_BELOW_M);
    let plan = Plan::new(args, &combinations, &overrides, bound_m)?;
    combinations::warn(&plan.settings)?;
    let is_drawn = args.page.is_some() || args.traces;
    let mut comparison = fly_all(&[plan], is_drawn)?.remove(0);
    let document = document(&comparison);
    if !args.traces {
        for it in &mut comparison.outcomes {
            (it.figures.trace, it.motion) = (None, None);
        }
    }
    publish(&document, &comparison, args.format, args.page.as_deref())?;
    judge(args.max_lost, [&comparison])
}

/// The exit code by the number of lost flights.
fn judge<'a>(
    max_lost: Option<u64>,
    flown: impl IntoIterator<Item = &'a Comparison>,
) -> Result<u8, Failure> {
    let outcomes = flown.into_iter().flat_map(|it| &it.outcomes);
    let lost = outcomes.filter(|it| it.lost.is_some()).count();
    let lost = Measured {
        name: "lost flights".into(),
        value: Ok(Number::new(lost as f64, 0)),
    };
    let gate = max_lost.map(|most| Gate::at_most(most as f64, lost));
    Ok(exit_code(gate))
}

/// Flies all cases of a table, prints Markdown, and writes the other requested files.
fn fly_table(
    args: &CompareArgs,
    table: CaseTable,
    combinations: &[Combination],
    overrides: &Overrides,
) -> Result<u8, Failure> {
    let CaseTable { place, cases } = table;
    let bound_m = args.recovered_below.or(cases.recovered_below_m);
    let bound_m = bound_m.unwrap_or(RECOVERED_BELOW_M);
    let set = |name: &str, texts: &[String]| -> Result<Overrides, String> {
        let texts = texts.iter();
        texts.map(|text| overrides::set(name, text)).collect()
    };
    // Without a list, each fault names its own instant, and each row is one flight.
    let instants: Vec<String> = match &cases.at_s {
        None => vec![String::new()],
        Some(at_s) => at_s.iter().map(|at_s| format!("@{at_s}s")).collect(),
    };
    if let Some(Value::Array(faults)) =
        Settings::in_file(args.course.config.as_deref(), "flight", "faults")?
        && !faults.is_empty()
    {
        say(
            "warning: the faults of the settings file are ignored; each row of a table has its own\n",
        );
    }
    let mut plans = Vec::new();
    for row in &cases.row {
        let of_row_in = format!(" (row `{}` of {place})", row.name);
        let (of_all, of_row) = set("set", &cases.set)
            .and_then(|all| Ok((all, set("row.set", &row.set)?)))
            .map_err(|e| Failure::usage(format!("set: {e}{of_row_in}")))?;
        let given = [&of_all[..], overrides, &of_row].concat();
        if let Some(faults) = overrides::value_of(&given, FAULTS) {
            let place = match overrides::value_of(&of_row, FAULTS) {
                Some(_) => &of_row_in,
                None => "",
            };
            let what =
                format!("{FAULTS} = {faults}: each row of a table has its own faults{place}");
            let help = "leave it out, or write a table with these faults";
            return Err(Failure::usage(what).help(help));
        }
        let laws = LAW_ROLES.map(|role| format!("{role}.law"));
        let law = laws
            .iter()
            .find(|law| overrides::value_of(&of_row, law).is_some());
        if let Some(law) = law {
            let what = format!("set: {law}: all rows of a table fly the same laws{of_row_in}");
            let help = "name them by --outer, --inner and --mixer, or set one law for all rows";
            return Err(Failure::usage(what).help(help));
        }
        let faults = |instant: &String| -> Vec<String> {
            let faults = row.faults.iter();
            faults.map(|fault| format!("{fault}{instant}")).collect()
        };
        let own = vec![(FAULTS, Value::from(faults(&instants[0])))];
        let overrides = [&given[..], &own].concat();
        let plan = Plan::new(args, combinations, &overrides, bound_m);
        let plan = plan.map_err(|failure| failure.append(&of_row_in))?;
        for (repetition, instant) in (0..).zip(&instants) {
            let repeated = plan.repeated(repetition, &faults(instant));
            plans.push(repeated.map_err(|failure| failure.append(&of_row_in))?);
        }
    }
    let rows = plans.iter().step_by(instants.len());
    combinations::warn(rows.flat_map(|plan| &plan.settings))?;
    let names = cases.row.into_iter().map(|row| row.name);
    let mut flights = fly_all(&plans, false)?.into_iter();
    let flown = Cases {
        title: cases.title,
        from_fault: cases.from_fault,
        rows: names
            .map(|name| (name, flights.by_ref().take(instants.len()).collect()))
            .collect(),
    };
    let write = |path: &Option<PathBuf>, text: &dyn Fn() -> String| {
        let Some(path) = path else { return Ok(()) };
        write_text(path, &text())?;
        say(&format!("written: {}\n", path.display()));
        Ok::<(), Failure>(())
    };
    print(&flown.markdown())?;
    write(&args.page, &|| flown.document().html())?;
    write(&args.picture, &|| flown.picture())?;
    write(&args.csv, &|| flown.csv())?;
    judge(
        args.max_lost,
        flown.rows.iter().flat_map(|(_, flights)| flights),
    )
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
        combinations: &[Combination],
        overrides: &Overrides,
        bound_m: f64,
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
            preset: combinations::preset(&settings).into(),
            seed: first.flight.seed,
            last_tick,
            period_s: first.flight.period_s,
            bound_m,
            bound_yaw_rad: first.flight.tracking_yaw_error_max_rad,
            faults: faults(first)?,
        };
        Ok(Self { flight, settings })
    }

    /// A repetition of the flight: with the seed that many later, and with these faults.
    fn repeated(&self, repetition: u64, texts: &[String]) -> Result<Self, Failure> {
        let (mut flight, mut settings) = (self.flight.clone(), self.settings.clone());
        let seed = flight.seed.checked_add(repetition);
        let seed = seed.filter(|seed| i64::try_from(*seed).is_ok());
        flight.seed = seed.ok_or_else(|| {
            let (first, most) = (flight.seed, i64::MAX);
            Failure::usage(format!(
                "flight.seed = {first} leaves no seed for each flight: allowed are 0 to {most}"
            ))
        })?;
        for it in &mut settings {
            (it.flight.seed, it.flight.faults) = (flight.seed, texts.to_vec());
            it.check_faults()?;
        }
        flight.faults = faults(&settings[0])?;
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

fn fly_all(plans: &[Plan], is_drawn: bool) -> Result<Vec<Comparison>, Failure> {
    let flights = plans.iter();
    let flights: Vec<(&Flight, &Settings)> = flights
        .flat_map(|plan| plan.settings.iter().map(|it| (&plan.flight, it)))
        .collect();
    let fly = |(flight, settings): &(&Flight, &Settings)| fly(flight, settings, is_drawn);
    let mut progress = Progress::new(flights.len() as u64, "flight");
    let look = |done| progress.look(done as u64);
    let jobs = jobs(None, flights.iter().map(|(_, settings)| *settings))?;
    let mut outcomes = on_processors(&flights, jobs, fly, look)?.into_iter();
    progress.clear();
    let compared = |plan: &Plan| Comparison {
        schema: SCHEMA,
        build: build::here(),
        flight: plan.flight.clone(),
        outcomes: outcomes.by_ref().take(plan.settings.len()).collect(),
    };
    Ok(plans.iter().map(compared).collect())
}

fn fly(flight: &Flight, settings: &Settings, is_drawn: bool) -> Result<Outcome, Failure> {
    let tracking = Tracking::along(settings.course()?, flight.period_s);
    let limits = settings.flight_limits();
    let mut metrics = ComparedFlight::new(tracking, &settings.airframe()?, limits);
    let mut tracer = Tracer::new(tracking);
    tracer.set_laws(settings.flown_laws()?);
    let mut rig = Simulator::of(settings)?;
    let mut invalid = InvalidOutputs::default();
    let flown = simulate::fly(&mut rig, settings, |rig| {
        invalid.take(rig);
        if rig.has_state() {
            metrics.state(rig.flown_tick(), rig.state());
        }
        if let Some(speeds) = rig.new_rotor_speeds() {
            metrics.command(speeds);
        }
        if is_drawn && rig.has_state() && metrics.lost.is_none() {
            tracer.take(&rig.joined());
        }
        Ok(())
    })?;
    let ended_early = flown.ticks <= flight.last_tick;
    let last = flown.ticks.saturating_sub(1);
    let lost = flown
        .departure
        .is_some()
        .then(|| metrics.lost.unwrap_or(last));
    let mut figures = metrics.figures(flight);
    figures.trace = figures.trace.filter(|_| is_drawn);
    Ok(Outcome {
        laws: combinations::laws(settings)?,
        preset: settings.flight.preset.clone(),
        ticks: flown.ticks,
        ended_early_s: ended_early.then(|| flight.time_s(last)),
        lost: flown.departure,
        lost_s: lost.map(|tick| flight.time_s(tick)),
        unusable: invalid.sentences(settings)?,
        motion: is_drawn.then(|| tracer.traces()),
        figures,
        outputs: flown.outputs.to_string(),
    })
}

/// The cases of `--table` or `--suite`.
struct CaseTable {
    /// Where they are, for errors.
    place: String,
    cases: CaseFile,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseFile {
    #[serde(default)]
    title: String,
    /// Settings of all rows, with the syntax of `--set`; flags override them.
    #[serde(default)]
    set: Vec<String>,
    recovered_below_m: Option<f64>,
    /// Instants of the faults [s], which then name none: each row is flown once for each, every time with the next seed.
    #[serde(default)]
    at_s: Option<Vec<f64>>,
    /// Whether errors count from the fault on.
    #[serde(default)]
    from_fault: bool,
    #[serde(default)]
    row: Vec<Row>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    name: String,
    /// With the syntax of `--fault`.
    #[serde(default)]
    faults: Vec<String>,
    /// Settings of this row, with the syntax of `--set`.
    #[serde(default)]
    set: Vec<String>,
}

impl CaseTable {
    fn of(args: &CompareArgs) -> Result<Option<Self>, Failure> {
        let suite = args.suite.as_deref();
        if let Some((name, text)) = SUITES.iter().find(|(name, _)| suite == Some(name)) {
            return Self::read(format!("--suite {name}"), text).map(Some);
        }
        let Some(path) = &args.table else {
            return Ok(None);
        };
        let text = read_text("read the table", path);
        let text = text.map_err(|failure| failure.or_code(USAGE).help(Self::HELP))?;
        Self::read(format!("--table {}", path.display()), &text).map(Some)
    }

    const HELP: &str =
        "each row reads: [[row]], name = \"drag\", faults = [\"rotational_drag_nm_s=+200%@8s\"]";

    fn read(place: String, text: &str) -> Result<Self, Failure> {
        let refused = |what: String| Failure::usage(format!("{place}: {what}")).help(Self::HELP);
        let cases: CaseFile =
            toml::from_str(text).map_err(|e| refused(toml_mistake(text, e.message(), e.span())))?;
        let mut names = BTreeSet::new();
        if let Some(twice) = cases.row.iter().find(|row| !names.insert(&row.name)) {
            return Err(refused(format!("two rows have the name `{}`", twice.name)));
        }
        let is_text = |name: &str| !name.trim().is_empty() && !name.contains(char::is_control);
        if let Some(row) = cases.row.iter().find(|row| !is_text(&row.name)) {
            return Err(refused(format!(
                "{:?} is no name of a row: write a line of text",
                row.name
            )));
        }
        if let Some(at_s) = &cases.at_s {
            let is_instant = |at_s: &&f64| (0.0..=INSTANT_MAX_S).contains(*at_s);
            let wrong = at_s.iter().find(|at_s| !is_instant(at_s));
            if wrong.is_some() || !(1..=ROWS_MAX).contains(&at_s.len()) {
                let holds = wrong.map_or(format!("{} instants", at_s.len()), f64::to_string);
                return Err(refused(format!(
                    "at_s has {holds}: allowed are 1 to {ROWS_MAX} instants from 0 to {INSTANT_MAX_S} s"
                )));
            }
            let mut faults = cases.row.iter().flat_map(|row| &row.faults);
            if let Some(fault) = faults.find(|fault| fault.contains('@')) {
                return Err(refused(format!(
                    "`{fault}` names an instant, and at_s lists the instants of all faults: leave out one of them"
                )));
            }
        }
        if let Some(bound) = cases.recovered_below_m {
            let checked = limit(&bound.to_string());
            checked.map_err(|e| refused(format!("recovered_below_m = {bound}: {e}")))?;
        }
        match cases.row.len() {
            0 => Err(refused("it has no row".into())),
            1..=ROWS_MAX => Ok(Self { place, cases }),
            number => Err(refused(format!(
                "it has {number} rows: allowed are {ROWS_MAX}"
            ))),
        }
    }
}
