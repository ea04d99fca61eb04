//! `ironbird campaign check`: how many flights, how long here, how many bytes.

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use campaign::chunk;
use campaign::table::Row;
use errors::{Failure, OK};
use plant::LANES;

use super::batch;
use super::flight_settings::Plan;
use crate::cli::CampaignCheckArgs;
use crate::output::print;
use crate::parallel::processors;

const TRIED: Duration = Duration::from_secs(2);
const TRIED_MAX: u64 = 200;

pub(super) fn check(args: &CampaignCheckArgs) -> Result<u8, Failure> {
    let plan = Plan::read(&args.file)?;
    let campaign = &plan.campaign;
    let arms = campaign.arms.len();
    let begun = Instant::now();
    let mut rows = Vec::new();
    let tried = campaign.flights.min(TRIED_MAX);
    // All over the campaign, so that a grid's cells are tried too.
    let flight = |i: u64| (u128::from(i) * u128::from(campaign.flights) / u128::from(tried)) as u64;
    let mut next = 0;
    while next < tried && begun.elapsed() <= TRIED {
        // First one, which may be long, then as many as fly abreast.
        let end = if next == 0 {
            1
        } else {
            tried.min(next + LANES as u64)
        };
        let flights: Vec<batch::Flight> = (next..end)
            .flat_map(|i| (0..arms).map(move |arm| (flight(i), arm)))
            .collect();
        let stop = AtomicBool::new(false);
        rows.extend(batch::rows(&plan, &flights, 1, &stop, |_| ())?);
        next = end;
    }
    let each_s = begun.elapsed().as_secs_f64() / rows.len() as f64;
    let jobs = args.jobs.unwrap_or_else(processors);
    let total = campaign.flights * arms as u64;
    let length_s = plan.settings(0, 0)?.flight.duration_s;
    let [per_file, per_row] = bytes(&plan, &rows)?;
    let names: Vec<&str> = campaign.arms.iter().map(|arm| arm.name.as_str()).collect();
    let takes_s = (each_s * total as f64 / jobs as f64).ceil();
    let takes = Duration::try_from_secs_f64(takes_s).unwrap_or(Duration::MAX);
    let factors = campaign.factors.iter();
    let drawn = factors
        .filter(|factor| factor.distribution.varies())
        .count();
    print(&format!(
        "{}: {} flights of {length_s} s by {arms} arms ({}), {total} rows in {} files; {drawn} of {} factors vary\n\
         time here  {} with {jobs} at once ({:.1} ms a flight, by {} that were tried)\n\
         on disk    {} ({} bytes a row)\n\
         campaign   {}\n",
        campaign.name,
        campaign.flights,
        names.join(", "),
        campaign.chunks(),
        campaign.factors.len(),
        humantime::format_duration(takes),
        1e3 * each_s,
        rows.len(),
        size(per_row * total as f64 + per_file * campaign.chunks() as f64),
        per_row.round(),
        plan.identity.campaign,
    ))?;
    Ok(OK)
}

/// Bytes of a file and of a row, by the rows that were flown: a half and all of them.
fn bytes(plan: &Plan, rows: &[Row]) -> Result<[f64; 2], Failure> {
    let length = |rows: &[Row]| {
        chunk::length(&plan.campaign, &plan.identity, rows).map(|bytes| bytes as f64)
    };
    let half = rows.len() / 2;
    let (one, all) = (length(&rows[..half])?, length(rows)?);
    let per_row = (all - one) / (rows.len() - half) as f64;
    Ok([(all - per_row * rows.len() as f64).max(0.0), per_row])
}

fn size(bytes: f64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB"];
    let place = ((bytes.max(1.0).log10() / 3.0) as usize).min(units.len() - 1);
    let number = bytes / 1000_f64.powi(place as i32);
    format!("{number:.1} {}", units[place])
}
