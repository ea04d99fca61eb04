//! `ironbird margin`: simulates a loop with growing outages, delays and message loss to find what it survives.
//!
//! Each flight is one of `ironbird simulate` with a `--fault` and the seed of its phase. Phases are independent, so the
//! result does not depend on the number of CPUs.

mod cases;
pub mod flights;
mod measure;
pub mod search;
pub mod table;
pub mod target;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use report::comparison::Laws;
use report::json;
use report::margin::{Margins, SCHEMA};
use report::render::margin::document;

use crate::build;
use crate::cli::{DiffFormat, MarginArgs};
use crate::combinations;
use crate::margin::cases::{Asked, Judged, Phases, Unfaulted};
use crate::margin::flights::Flights;
use crate::margin::measure::{Law, Task};
use crate::margin::target::Target;
use crate::output::{print, say};
use crate::parallel::{all_on_processors, asked_to_stop, processors};
use crate::progress::Progress;
use crate::settings::{Overrides, Settings};
use errors::{Failure, OK, check_writable, write_text};

/// Every this many phases, the expensive measurements are made, and monotonicity is checked.
const SPARSE: usize = 8;

/// Measures margins.
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
    let left_out = left_out(args);
    let out = left_out.is_none().then(|| out(args, &settings[0]));
    out.as_deref().map_or(Ok(()), table::check)?;
    let margins = measured(args, &settings, &phases, &task, &stop)?;
    if let Some(path) = &args.page {
        write_text(path, &document(&margins).html())?;
        say(&format!("written: {}\n", path.display()));
    }
    for left in out.map_or_else(|| Ok(Vec::new()), |out| table::write(&out, &margins))? {
        say(&format!("{left}\n"));
    }
    if let Some(why) = left_out {
        say(&format!("no table stored for flight reports: {why}\n"));
    }
    match args.format {
        DiffFormat::Text => print(&document(&margins).text())?,
        DiffFormat::Json => {
            print(&(json::to_string(&margins).map_err(|e| Failure::failed(e.to_string()))? + "\n"))?
        }
    }
    Ok(OK)
}

/// Why no table is stored: reports would take it for the complete table with the default gates.
fn left_out(args: &MarginArgs) -> Option<String> {
    let reasons = [
        (!args.only.is_empty(), "--only measures a part"),
        (!args.gates.is_empty(), "--gate sets other limits"),
        (
            args.course.duration.is_some(),
            "--duration shortens the phases",
        ),
    ];
    let given: Vec<&str> = reasons
        .into_iter()
        .filter_map(|(is_so, why)| is_so.then_some(why))
        .collect();
    (!given.is_empty()).then(|| given.join(", "))
}

/// The settings of each combination of laws, without faults.
fn settings(args: &MarginArgs) -> Result<Vec<Settings>, Failure> {
    if let Some(fault) = args.course.faults.first() {
        return Err(Failure::usage(format!("--fault {fault}: margins are measured without other faults"))
            .help("describe the airframe in the section [plant] of a settings file and pass it with --config"));
    }
    let combinations = combinations::of(&args.laws.outer, &args.laws.inner, &args.laws.mixer)?;
    let mut course = args.course.clone();
    // It says when the last fault begins, which may be sooner than a fault of the file; flights have lengths of their own.
    course.duration = None;
    let given = course.overrides();
    let resolve = |laws: &Overrides| {
        let mut settings = Settings::resolve(
            course.config.as_deref(),
            &[given.clone(), laws.clone()].concat(),
        )?;
        if !settings.flight.faults.is_empty() {
            say(
                "warning: the faults of the settings file are ignored; margins are measured without other faults\n",
            );
            settings.flight.faults.clear();
        }
        Ok(settings)
    };
    let settings: Vec<Settings> = combinations
        .iter()
        .map(resolve)
        .collect::<Result<_, Failure>>()?;
    combinations::check_names(&combinations, &settings)?;
    for warning in settings[0].warnings()? {
        say(&format!("warning: {warning}\n"));
    }
    Ok(settings)
}

fn task<'a>(args: &MarginArgs, asked: &'a Asked, settings: &Settings) -> Result<Task<'a>, Failure> {
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
    let is_asked = |target: &Target| {
        args.only.is_empty() || args.only.iter().any(|word| target.is_meant_by(word))
    };
    Ok(Task {
        targets: target::all().into_iter().filter(is_asked).collect(),
        asked,
        longest: (longest_s / period_s + 1e-9).floor() as u64,
        period_s,
        tick_ns: settings.sample_time_ns(),
    })
}

fn out(args: &MarginArgs, settings: &Settings) -> PathBuf {
    args.out
        .clone()
        .unwrap_or_else(|| PathBuf::from(&settings.recorder.out))
}

fn measured(
    args: &MarginArgs,
    settings: &[Settings],
    phases: &Phases,
    task: &Task<'_>,
    stop: &AtomicBool,
) -> Result<Margins, Failure> {
    let jobs = args.jobs.unwrap_or_else(processors);
    let first = &settings[0];
    let number = phases.ticks.len();
    let items: Vec<(usize, usize)> = (0..settings.len())
        .flat_map(|law| (0..number).map(move |i| (law, i)))
        .collect();
    let place = |law: usize, i: usize| law * number + i;
    let of_seed = |law: usize, seed: usize| {
        let mut settings = settings[law].clone();
        settings.flight.seed = settings.flight.seed.wrapping_add(seed as u64);
        settings
    };
    // What does not fly is told before the rest is flown.
    let judged = shared_out(&items, jobs, "unfaulted flight", |(law, i)| {
        judged(&of_seed(*law, *i), phases, task, stop)
    })?;
    let all = shared_out(&items, jobs, "phase", |(law, i)| {
        let flights = Flights::new(&of_seed(*law, *i), phases.ticks[*i], stop)?;
        task.at(
            &flights,
            &judged[place(*law, *i)].judge,
            i.is_multiple_of(SPARSE),
        )
    })?;
    // The largest share that all survive was chosen because they did: only other flights can say how probable that is.
    let shares: Vec<Vec<u64>> = all
        .chunks(number)
        .map(|phases| task.shares(phases))
        .collect();
    let again = shared_out(&items, jobs, "repeated phase", |(law, i)| {
        if shares[*law].iter().all(|share| *share == 0) {
            return Ok(Vec::new());
        }
        let settings = of_seed(*law, number + i);
        let judged = self::judged(&settings, phases, task, stop)?;
        task.again(
            &Flights::new(&settings, phases.ticks[*i], stop)?,
            &judged.judge,
            &shares[*law],
        )
    })?;
    let phases_s: Vec<f64> = phases
        .ticks
        .iter()
        .map(|tick| *tick as f64 * task.period_s)
        .collect();
    let of_law = |(law, settings): (usize, &Settings)| -> Result<_, Failure> {
        let [outer, inner, mixer] = settings.laws()?.map(|law| law.name.to_owned());
        let named = Law {
            laws: Laws {
                outer,
                inner,
                mixer,
            },
            fingerprint: table::fingerprint(settings)?,
        };
        let its = place(law, 0)..place(law + 1, 0);
        Ok(task.together(
            named,
            &phases_s,
            &judged[its.clone()],
            &all[its.clone()],
            &again[its],
        ))
    };
    let laws = settings
        .iter()
        .enumerate()
        .map(of_law)
        .collect::<Result<_, Failure>>()?;
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
        steady_s: task.asked.steady_s(),
        gate: task.asked.gate(first),
    })
}

/// Like [`all_on_processors`], with a progress line.
fn shared_out<T: Sync, R: Send>(
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
fn judged(
    settings: &Settings,
    phases: &Phases,
    task: &Task<'_>,
    stop: &AtomicBool,
) -> Result<Judged, Failure> {
    let name = cases::name(settings)?;
    let (first, last) = (
        phases.ticks.first().copied().unwrap_or(0),
        phases.ticks.last().copied().unwrap_or(0),
    );
    let last = last + (task.asked.steady_s() / task.period_s).round() as u64;
    let flights = Flights::new(settings, first, stop)?;
    let fly = |bound_m: f64| flights.fly(&[], first, last, bound_m);
    let judged = task
        .asked
        .judge(Unfaulted::of(&fly(f64::INFINITY)?, &name)?, settings);
    for gates in [&judged.judge.outage, &judged.judge.steady] {
        cases::check(&name, &fly(gates.recovered_below_m)?.outcome, gates)?;
    }
    Ok(judged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args as _, Command, FromArgMatches as _};

    #[test]
    fn a_table_is_left_for_the_gates_that_reports_tell_of_alone() {
        let left_out = |flags: &[&str]| {
            let command = MarginArgs::augment_args(Command::new("margin"));
            let given = command.get_matches_from([&["margin"], flags].concat());
            left_out(&MarginArgs::from_arg_matches(&given).unwrap())
        };
        assert_eq!(
            left_out(&["--phases", "1", "--longest", "60ms", "--inner", "indi"]),
            None
        );
        for (flags, words) in [
            (["--only", "inner"], "--only measures a part"),
            (
                ["--gate", "recovered_below_m=5"],
                "--gate sets other limits",
            ),
            (["--duration", "20s"], "--duration shortens the phases"),
        ] {
            assert_eq!(left_out(&flags).as_deref(), Some(words));
        }
        let both = left_out(&["--gate", "tilt_max_rad=1", "--only", "inner"]).unwrap();
        assert_eq!(both, "--only measures a part, --gate sets other limits");
    }

    #[test]
    fn what_failed_is_told_and_not_that_others_were_ended() {
        let work = |item: &u32| match item {
            5 => Err(Failure::usage("no")),
            _ => Ok(*item),
        };
        assert_eq!(shared_out(&[1, 2, 3], 2, "phase", work).unwrap(), [1, 2, 3]);
        for items in [[5, 1, 2], [1, 2, 5]] {
            assert_eq!(
                shared_out(&items, 2, "phase", work)
                    .err()
                    .map(|e| e.to_string()),
                Some("no".into())
            );
        }
    }
}
