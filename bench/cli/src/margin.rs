//! `ironbird margin`: simulates a loop with growing outages, delays and message loss to find what it survives.
//!
//! Each flight is one of `ironbird simulate` with a `--fault` and the seed of its phase. Phases are independent, so the
//! result does not depend on the number of CPUs.

use std::path::PathBuf;
use std::time::Duration;

use crate::cli::MarginArgs;
use crate::report_command::publish;
use config::{Settings, overrides};
use errors::output::say;
use errors::{Failure, OK, check_outputs};
use experiments::combinations;
use experiments::margin::limits::{Phases, bounds};
use experiments::margin::target::{self, Target};
use experiments::margin::{Task, measure_all, table};
use experiments::parallel::jobs;
use process::signals::stop_flag;
use render::margin::document;
use toml::Value;

const DURATION: &str = "flight.duration_s";

pub fn margin(args: &MarginArgs) -> Result<u8, Failure> {
    let stop = stop_flag()?;
    let settings = settings(args)?;
    check_outputs(&[("--page", args.page.as_deref())])?;
    let phases = Phases::new(args.phases, duration(args), &settings[0])?;
    let task = task(args, &settings)?;
    let no_table = no_table(args);
    let out = args.out.clone();
    let out = out.unwrap_or_else(|| PathBuf::from(&settings[0].recorder.out));
    if no_table.is_none() {
        table::check(&out)?;
    }
    let margins = measure_all(&settings, &phases, &task, &stop)?;
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

fn duration(args: &MarginArgs) -> Option<Duration> {
    let given = args.course.overrides();
    let value = overrides::value_of(&given, DURATION)?;
    let whole_s = value.as_integer().map(|whole| whole as f64);
    let duration_s = value.as_float().or(whole_s)?;
    Duration::try_from_secs_f64(duration_s).ok()
}

/// Why no table is stored: reports would take it for the complete table with the default gates.
fn no_table(args: &MarginArgs) -> Option<String> {
    let is_shortened = duration(args).is_some();
    let reasons: Vec<&str> = [
        (!args.only.is_empty(), "--only measures a part"),
        (!args.gates.is_empty(), "--gate sets other bounds"),
        (is_shortened, "--duration shortens the phases"),
    ]
    .into_iter()
    .filter_map(|(applies, why)| applies.then_some(why))
    .collect();
    (!reasons.is_empty()).then(|| reasons.join(", "))
}

/// The settings of each combination of laws, without faults.
fn settings(args: &MarginArgs) -> Result<Vec<Settings>, Failure> {
    let mut given = args.course.overrides();
    if let Some(Value::Array(faults)) = overrides::value_of(&given, "flight.faults")
        && let Some(fault) = faults.first()
    {
        let what = format!("the fault {fault}: margins are measured without other faults");
        return Err(Failure::usage(what).help(
            "describe the airframe in the section [plant] of a settings file and pass it with --config",
        ));
    }
    let laws = &args.laws;
    let most = combinations::PAGE_MAX;
    let combinations = combinations::of(&laws.outer, &laws.inner, &laws.mixer, most)?;
    // It gives the end of the phases, which may come before a fault of the file; flights have lengths of their own.
    given.retain(|(flag, _)| overrides::parts(flag).1 != DURATION);
    let config = args.course.config.as_deref();
    let mut settings = combinations::resolve(config, &given, &combinations)?;
    if !settings[0].flight.faults.is_empty() {
        say(
            "warning: the faults of the settings file are ignored; margins are measured without other faults\n",
        );
    }
    for settings in &mut settings {
        settings.flight.faults.clear();
    }
    combinations::warn(&settings)?;
    Ok(settings)
}

fn task(args: &MarginArgs, settings: &[Settings]) -> Result<Task, Failure> {
    const LONGEST_S: f64 = 60.0;
    let period_s = settings[0].flight.period_s;
    let longest_s = args.longest.as_secs_f64();
    if !(period_s..=LONGEST_S).contains(&longest_s) {
        let period_ms = period_s * 1e3;
        return Err(Failure::usage(format!(
            "--longest {longest_s}s: allowed are one tick, which is {period_ms} ms here, to {LONGEST_S} s"
        ))
        .help("leave it out for 2s"));
    }
    let is_selected = |target: &Target| {
        args.only.is_empty() || args.only.iter().any(|word| word == target.group())
    };
    Ok(Task {
        targets: target::all().filter(is_selected).collect(),
        bounds: bounds(&args.gates, &settings[0])?,
        longest: (longest_s / period_s + 1e-9).floor() as u64,
        jobs: jobs(args.jobs, settings)?,
    })
}
