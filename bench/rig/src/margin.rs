//! `ironbird margin`: what a loop bears, by simulation: outages, dead time, losses.
//!
//! Each flight is that of `ironbird simulate` with a `--fault`, and the seed of its phase. Phases do not know of each
//! other, and the processors share them out: the same margins, however many there are.

pub mod flights;
mod measure;
mod plan;
pub mod search;
pub mod table;
pub mod target;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use report::comparison::Laws;
use report::json;
use report::margin::{Margins, SCHEMA, page, text};

use crate::build;
use crate::cli::{DiffFormat, MarginArgs};
use crate::combinations;
use crate::margin::flights::Flights;
use crate::margin::measure::{Law, OfPhase, Task};
use crate::margin::plan::{Asked, Judge, Phases, Unfaulted};
use crate::margin::target::Target;
use crate::output::{print, say};
use crate::parallel::{asked_to_stop, on_processors, processors};
use crate::progress::Progress;
use crate::settings::{Overrides, Settings};
use failure::{Failure, INTERRUPTED, OK, check_writable, write_text};

/// Every so many phases, what takes more flights is flown, and the order of things is looked at.
const SPARSE: usize = 8;

/// Measures.
///
/// # Errors
/// Usage: what is wrong with flags or settings; a gate that a flight without a fault does not hold; a file that cannot be
/// written; an interruption.
pub fn margin(args: &MarginArgs) -> Result<u8, Failure> {
    let stop = asked_to_stop()?;
    check_writable("--page", args.page.as_deref())?;
    let asked = Asked::new(&args.gates)?;
    let settings = settings(args)?;
    let phases = Phases::new(args, &settings[0])?;
    let task = task(args, &asked, &settings[0])?;
    // A table that lacks what was left out would be taken for a whole one.
    let out = args.only.is_empty().then(|| out(args, &settings[0]));
    out.as_deref().map_or(Ok(()), table::check)?;
    let margins = measured(args, &settings, &phases, &task, &stop)?;
    if let Some(path) = &args.page {
        write_text(path, &page::render(&margins))?;
        say(&format!("written: {}\n", path.display()));
    }
    match &out {
        Some(out) => {
            let written = table::write(out, &margins)?;
            written.iter().for_each(|path| say(&format!("written, for reports of flights: {}\n", path.display())));
        }
        None => say("no table for reports of flights: --only leaves something out\n"),
    }
    match args.format {
        DiffFormat::Text => print(&text::render(&margins))?,
        DiffFormat::Json => print(&(json::to_string(&margins).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?,
    }
    Ok(OK)
}

/// The settings of each combination of laws, without faults.
fn settings(args: &MarginArgs) -> Result<Vec<Settings>, Failure> {
    if let Some(fault) = args.course.faults.first() {
        return Err(Failure::usage(format!("--fault {fault}: a margin is measured without other faults"))
            .help("write what the airframe is into the section [plant] of a settings file, and name it by --config"));
    }
    let combinations = combinations::of(&args.outer, &args.inner, &args.mixer)?;
    let mut course = args.course.clone();
    // It says when the last fault begins, which may be sooner than a fault of the file; flights have lengths of their own.
    course.duration = None;
    let given = course.overrides();
    let resolve = |laws: &Overrides| {
        let mut settings = Settings::resolve(course.config.as_deref(), &[given.clone(), laws.clone()].concat())?;
        if !settings.flight.faults.is_empty() {
            say("warning: a margin is measured without the faults of the settings file\n");
            settings.flight.faults.clear();
        }
        Ok(settings)
    };
    let settings: Vec<Settings> = combinations.iter().map(resolve).collect::<Result<_, Failure>>()?;
    combinations::check_names(&combinations, &settings)?;
    for warning in settings[0].warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    Ok(settings)
}

fn task<'a>(args: &MarginArgs, asked: &'a Asked, settings: &Settings) -> Result<Task<'a>, Failure> {
    /// An outage for longer cannot be asked for.
    const LONGEST_S: f64 = 60.0;
    let period_s = settings.flight.period_s;
    let longest_s = args.longest.as_secs_f64();
    if !(period_s..=LONGEST_S).contains(&longest_s) {
        return Err(Failure::usage(format!(
            "--longest {longest_s}s: allowed are one tick, which is {} ms here, to {LONGEST_S} s",
            period_s * 1e3
        ))
        .help("leave it out for 2s"));
    }
    let is_asked = |target: &Target| args.only.is_empty() || args.only.iter().any(|word| target.is_meant_by(word));
    Ok(Task {
        targets: target::all().into_iter().filter(is_asked).collect(),
        asked,
        longest: (longest_s / period_s + 1e-9).floor() as u64,
        period_s,
        tick_ns: settings.sample_time_ns(),
    })
}

fn out(args: &MarginArgs, settings: &Settings) -> PathBuf {
    args.out.clone().unwrap_or_else(|| PathBuf::from(&settings.recorder.out))
}

/// Flies all of it.
fn measured(
    args: &MarginArgs,
    settings: &[Settings],
    phases: &Phases,
    task: &Task<'_>,
    stop: &AtomicBool,
) -> Result<Margins, Failure> {
    let jobs = args.jobs.unwrap_or_else(processors);
    let first = &settings[0];
    let judged = on_processors(settings, jobs, |settings| judged(settings, phases, task, stop), |_| ());
    let judged: Vec<(Law, Judge)> = judged.into_iter().collect::<Result<_, _>>()?;
    let number = phases.ticks.len();
    let items: Vec<(usize, usize)> = (0..settings.len()).flat_map(|law| (0..number).map(move |i| (law, i))).collect();
    let mut progress = Progress::new(items.len() as u64, "phase");
    // What cannot be flown ends all others.
    let failed = AtomicBool::new(false);
    let work = |(law, i): &(usize, usize)| {
        if failed.load(Ordering::Relaxed) {
            return Err(Failure::new(INTERRUPTED, "interrupted"));
        }
        let mut settings = settings[*law].clone();
        settings.flight.seed = settings.flight.seed.wrapping_add(*i as u64);
        let measured = Flights::new(&settings, phases.ticks[*i], stop)
            .and_then(|flights| task.at(&flights, &judged[*law].1, i.is_multiple_of(SPARSE)));
        measured.inspect_err(|_| failed.store(true, Ordering::Relaxed))
    };
    let measured = on_processors(&items, jobs, work, |done| progress.look(done as u64));
    progress.clear();
    let mut all: Vec<OfPhase> = Vec::with_capacity(measured.len());
    let mut failure: Option<Failure> = None;
    for phase in measured {
        match phase {
            Ok(phase) => all.push(phase),
            Err(e) if failure.as_ref().is_none_or(|known| known.code == INTERRUPTED) => failure = Some(e),
            Err(_) => {}
        }
    }
    failure.map_or(Ok(()), Err)?;
    let phases_s: Vec<f64> = phases.ticks.iter().map(|tick| *tick as f64 * task.period_s).collect();
    let laws = judged.into_iter().zip(all.chunks(number));
    let laws = laws.map(|((law, judge), phases)| task.together(phases, &phases_s, law, &judge));
    Ok(Margins {
        schema: SCHEMA.into(),
        build: build::here(),
        trajectory: first.trajectory_name().into(),
        airframe: first.airframe_name().into(),
        preset: first.flight.preset.clone(),
        seed: first.flight.seed,
        period_s: task.period_s,
        laws: laws.collect(),
        phases_s,
        span_s: phases.span_s,
        cycle_s: phases.cycle_s,
        sparse: SPARSE,
        longest_ticks: task.longest,
        steady_s: task.asked.steady_s(),
        gate: task.asked.told(first),
    })
}

/// What laws fly without a fault, over all phases, and what therefore counts as survived.
fn judged(settings: &Settings, phases: &Phases, task: &Task<'_>, stop: &AtomicBool) -> Result<(Law, Judge), Failure> {
    let name = plan::name(settings)?;
    let (first, last) = (phases.ticks.first().copied().unwrap_or(0), phases.ticks.last().copied().unwrap_or(0));
    let last = last + (task.asked.steady_s() / task.period_s).round() as u64;
    let flights = Flights::new(settings, first, stop)?;
    let fly = |bound_m: f64| flights.fly(&[], first, last, bound_m);
    let unfaulted = Unfaulted::of(&fly(f64::INFINITY)?, &name)?;
    let judge = task.asked.judge(&unfaulted, settings);
    for gates in [&judge.outage, &judge.steady] {
        plan::check(&name, &fly(gates.recovered_below_m)?.outcome, gates)?;
    }
    let [outer, inner, mixer] = settings.laws()?.map(|law| law.name.to_owned());
    let laws = Laws { outer, inner, mixer };
    Ok((Law { laws, fingerprint: table::fingerprint(settings)?, unfaulted }, judge))
}
