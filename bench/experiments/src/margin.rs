//! Robustness margins: flights with growing outages, delays and message loss, to find what a loop survives.
//!
//! Each flight is one of `ironbird simulate` with a `--fault` and the seed of its phase. Phases are independent, so the
//! result does not depend on the number of CPUs. Start reading in [`measure_all`].

pub mod flights;
pub mod limits;
pub mod measure;
pub mod search;
pub mod table;
pub mod target;

use std::sync::atomic::AtomicBool;

use analysis::margin::{Margins, SCHEMA};
use config::Settings;
use config::law_settings::known;
use errors::Failure;
use flight_log::build;
use messages::role::Role;

use crate::combinations;
use crate::parallel::all_on_processors;
use crate::progress::Progress;
use flights::Flights;
use limits::{Judged, Phases};
use measure::Task;

/// Every this many phases, the expensive measurements are made, and monotonicity is checked.
const SPARSE: usize = 8;

/// Measures the margins of every combination of laws, on `jobs` threads.
pub fn measure_all(
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
        build: build::executable(),
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
