//! `ironbird margin`: simulates a loop with growing outages, delays and message loss to find what it survives.
//!
//! Each flight is one of `ironbird simulate` with a `--fault` and the seed of its phase. Phases are independent, so the
//! result does not depend on the number of CPUs.

pub mod flights;
mod limits;
mod measure;
pub mod search;
pub mod table;
pub mod target;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use messages::role::Role;
use report::margin::{Margins, SCHEMA};
use report::render::margin::document;

use crate::build;
use crate::cli::MarginArgs;
use crate::combinations;
use crate::output::say;
use crate::parallel::{all_on_processors, processors, stop_flag};
use crate::progress::Progress;
use crate::report_command::publish;
use crate::settings::Settings;
use crate::settings::law_settings::known;
use errors::{Failure, OK, check_writable};
use flights::Flights;
use limits::{GivenLimits, Judged, Phases};
use measure::Task;
use target::Target;

/// Every this many phases, the expensive measurements are made, and monotonicity is checked.
const SPARSE: usize = 8;

pub fn margin(args: &MarginArgs) -> Result<u8, Failure> {
    let stop = stop_flag()?;
    check_writable("--page", args.page.as_deref())?;
    let given = GivenLimits::new(&args.gates)?;
    let settings = settings(args)?;
    let phases = Phases::new(args, &settings[0])?;
    let task = task(args, &given, &settings[0])?;
    let no_table = no_table(args);
    let out = args.out.clone();
    let out = out.unwrap_or_else(|| PathBuf::from(&settings[0].recorder.out));
    if no_table.is_none() {
        table::check(&out)?;
    }
    let jobs = args.jobs.unwrap_or_else(processors);
    let margins = measure(jobs, &settings, &phases, &task, &stop)?;
    match no_table {
        None => table::write(&out, &margins)?
            .iter()
            .for_each(|line| say(line)),
        Some(why) => say(&format!("no table stored for flight reports: {why}\n")),
    }
    let page = args.page.as_deref();
    publish(&document(&margins), &margins, args.format, page)?;
    Ok(OK)
}

/// Why no table is stored: reports would take it for the complete table with the default gates.
fn no_table(args: &MarginArgs) -> Option<String> {
    let is_shortened = args.course.duration.is_some();
    let reasons: Vec<&str> = [
        (!args.only.is_empty(), "--only measures a part"),
        (!args.gates.is_empty(), "--gate sets other limits"),
        (is_shortened, "--duration shortens the phases"),
    ]
    .into_iter()
    .filter_map(|(applies, why)| applies.then_some(why))
    .collect();
    (!reasons.is_empty()).then(|| reasons.join(", "))
}

/// The settings of each combination of laws, without faults.
fn settings(args: &MarginArgs) -> Result<Vec<Settings>, Failure> {
    if let Some(fault) = args.course.faults.first() {
        let what = format!("--fault {fault}: margins are measured without other faults");
        return Err(Failure::usage(what).help(
            "describe the airframe in the section [plant] of a settings file and pass it with --config",
        ));
    }
    let combinations = combinations::of(&args.laws.outer, &args.laws.inner, &args.laws.mixer)?;
    let mut course = args.course.clone();
    // It gives the end of the phases, which may come before a fault of the file; flights have lengths of their own.
    course.duration = None;
    let config = course.config.as_deref();
    let mut settings = combinations::resolve(config, &course.overrides(), &combinations)?;
    if !settings[0].flight.faults.is_empty() {
        say(
            "warning: the faults of the settings file are ignored; margins are measured without other faults\n",
        );
    }
    for settings in &mut settings {
        settings.flight.faults.clear();
    }
    for warning in settings[0].warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    Ok(settings)
}

fn task<'a>(
    args: &MarginArgs,
    given: &'a GivenLimits,
    settings: &Settings,
) -> Result<Task<'a>, Failure> {
    const LONGEST_S: f64 = 60.0;
    let period_s = settings.flight.period_s;
    let longest_s = args.longest.as_secs_f64();
    if !(period_s..=LONGEST_S).contains(&longest_s) {
        let period_ms = period_s * 1e3;
        return Err(Failure::usage(format!(
            "--longest {longest_s}s: allowed are one tick, which is {period_ms} ms here, to {LONGEST_S} s"
        ))
        .help("leave it out for 2s"));
    }
    let is_selected = |target: &Target| {
        args.only.is_empty() || args.only.iter().any(|word| target.is_named_by(word))
    };
    Ok(Task {
        targets: target::all().filter(is_selected).collect(),
        given,
        longest: (longest_s / period_s + 1e-9).floor() as u64,
        period_s,
        tick_ns: settings.sample_time_ns(),
    })
}

fn measure(
    jobs: usize,
    settings: &[Settings],
    phases: &Phases,
    task: &Task<'_>,
    stop: &AtomicBool,
) -> Result<Margins, Failure> {
    let number = phases.ticks.len();
    let items: Vec<(usize, usize)> = (0..settings.len())
        .flat_map(|law| (0..number).map(move |i| (law, i)))
        .collect();
    let with_seed = |law: usize, seed: usize| {
        let mut settings = settings[law].clone();
        settings.flight.seed = settings.flight.seed.wrapping_add(seed as u64);
        settings
    };
    // Laws that do not fly are reported before the long part.
    let judged = with_progress(&items, jobs, "unfaulted flight", |(law, i)| {
        judge(&with_seed(*law, *i), phases, task, stop)
    })?;
    let all = with_progress(&items, jobs, "phase", |(law, i)| {
        let flights = Flights::new(&with_seed(*law, *i), phases.ticks[*i], stop)?;
        let limits = &judged[law * number + i];
        task.phase(&flights, limits)
            .measure(i.is_multiple_of(SPARSE))
    })?;
    // The largest share that all survive was chosen because they did: only other flights can say how probable that is.
    let shares: Vec<Vec<u64>> = all
        .chunks(number)
        .map(|phases| task.shares(phases))
        .collect();
    let repeated = with_progress(&items, jobs, "repeated phase", |(law, i)| {
        let shares = &shares[*law];
        if shares.iter().all(|share| *share == 0) {
            return Ok(Vec::new());
        }
        let settings = with_seed(*law, number + i);
        let limits = judge(&settings, phases, task, stop)?;
        let flights = Flights::new(&settings, phases.ticks[*i], stop)?;
        task.phase(&flights, &limits).repeat(shares)
    })?;
    let phases_s = phases.ticks.iter().map(|tick| *tick as f64 * task.period_s);
    let phases_s: Vec<f64> = phases_s.collect();
    let mut laws = Vec::new();
    for (law, settings) in settings.iter().enumerate() {
        let own = law * number..(law + 1) * number;
        let (judged, repeated) = (&judged[own.clone()], &repeated[own.clone()]);
        let mut margins = task.combine(&phases_s, judged, &all[own], repeated);
        margins.laws = combinations::laws(settings)?;
        margins.fingerprint = table::fingerprint(settings)?;
        laws.push(margins);
    }
    let first = &settings[0];
    Ok(Margins {
        schema: SCHEMA.into(),
        build: build::here(),
        trajectory: first.trajectory_name().into(),
        airframe: first.airframe_name().into(),
        preset: first.flight.preset.clone(),
        seed: first.flight.seed,
        period_s: task.period_s,
        laws,
        phases_s,
        span_s: phases.span_s,
        cycle_s: phases.cycle_s,
        sparse: SPARSE,
        longest_ticks: task.longest,
        steady_s: task.given.steady_s(),
        gate: task.given.gate(first),
    })
}

/// Like [`all_on_processors`], with a progress line.
fn with_progress<T: Sync, R: Send>(
    items: &[T],
    jobs: usize,
    thing: &'static str,
    work: impl Fn(&T) -> Result<R, Failure> + Sync,
) -> Result<Vec<R>, Failure> {
    let mut progress = Progress::new(items.len() as u64, thing);
    let results = all_on_processors(items, jobs, work, |done| progress.look(done as u64));
    progress.clear();
    results
}

/// Flies without a fault over all phases with one seed, and derives what counts as survived.
fn judge(
    settings: &Settings,
    phases: &Phases,
    task: &Task<'_>,
    stop: &AtomicBool,
) -> Result<Judged, Failure> {
    let laws = combinations::laws(settings)?;
    let name = laws.name(laws.mixer != known(Role::Mixer)[0].name);
    let (first, last) = (phases.ticks[0], phases.ticks[phases.ticks.len() - 1]);
    let last = last + task.ticks(task.given.steady_s());
    let flights = Flights::new(settings, first, stop)?;
    let fly = |bound_m: f64| flights.fly(&[], first, last, bound_m);
    let judged = task.given.judge(&fly(f64::INFINITY)?, &name, settings)?;
    for gates in [&judged.outage, &judged.steady] {
        limits::check(&name, &fly(gates.recovered_below_m)?, gates)?;
    }
    Ok(judged)
}
