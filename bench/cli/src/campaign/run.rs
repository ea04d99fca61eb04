//! `ironbird campaign run` and `check`: flies the missing chunks of a campaign, or a few flights to estimate the time of
//! all.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use campaign::chunk::{self, State};
use campaign::table::Row;
use errors::{Failure, INTERRUPTED, OK};

use crate::build;
use crate::cli::{CampaignCheckArgs, CampaignRunArgs, Shard};
use crate::runs::size;
use analysis::phrase::{count, list};
use errors::output::{print, say};
use experiments::campaign::flight_settings::{IN_THE_WAY, Plan, open_directory};
use experiments::campaign::rows::{Flight, LANES, fly_all};
use experiments::parallel::jobs;
use experiments::progress::Progress;
use process::signals::stop_flag;

/// Environment variables with the task number of a job, and the offset that makes it start with 1: Slurm, HyperQueue,
/// Kubernetes and GNU parallel.
const TASKS: [(&str, u64); 4] = [
    ("SLURM_ARRAY_TASK_ID", 0),
    ("HQ_TASK_ID", 0),
    ("JOB_COMPLETION_INDEX", 1),
    ("PARALLEL_SEQ", 0),
];

const DIRTY: &str = "this build has uncommitted changes, and rows of any such build of this commit are taken for its own; \
                     commit and rebuild before flying results that count";

pub(super) fn run(args: &CampaignRunArgs) -> Result<u8, Failure> {
    let stop = stop_flag()?;
    let plan = Plan::read(&args.file)?;
    let out = args.out.clone().unwrap_or_else(|| default_directory(&plan));
    let chunks = args.shard.map_or(Ok(0..plan.campaign.chunks()), |shard| {
        of_shard(&plan, shard)
    })?;
    let jobs = jobs(args.jobs, &plan.flown)?;
    open_directory(&plan, &out)?;
    if build::here().dirty {
        say(&format!("warning: {DIRTY}\n"));
    }
    let ended = fly(&plan, &out, jobs, &stop, chunks)?;
    print(&ended.text(&plan, &out))?;
    Ok(if ended.interrupted { INTERRUPTED } else { OK })
}

pub(super) fn default_directory(plan: &Plan) -> PathBuf {
    PathBuf::from("campaigns").join(&plan.campaign.name)
}

fn of_shard(plan: &Plan, shard: Shard) -> Result<Range<u64>, Failure> {
    let number = match shard.number {
        Some(number) => number,
        None => task().ok_or_else(|| {
            let names = list(TASKS.map(|(name, _)| name));
            Failure::usage(format!("--shard auto/{}: no task number is in {names}", shard.of))
                .help("write the number of the shard, as in --shard 3/24, or run it as the task of an array job")
        })?,
    };
    if !(1..=shard.of).contains(&number) {
        let of = shard.of;
        let mistake = format!("--shard auto/{of}: the task's number is {number}");
        return Err(Failure::usage(mistake).help(format!("number the tasks from 1 to {of}")));
    }
    let flights = plan.campaign.shard(number, shard.of);
    if flights.is_empty() {
        say(
            "warning: this shard flies nothing: there are more shards than files of rows; a smaller `campaign.chunk` makes more files\n",
        );
    }
    Ok(flights)
}

fn task() -> Option<u64> {
    let number =
        |(name, first): (&str, u64)| Some(std::env::var(name).ok()?.parse::<u64>().ok()? + first);
    TASKS.into_iter().find_map(number)
}

#[derive(Debug, Default)]
struct Ended {
    flown: u64,
    kept: u64,
    chunks: u64,
    rate: f64,
    interrupted: bool,
}

/// Flies the chunks that are not whole.
fn fly(
    plan: &Plan,
    out: &Path,
    jobs: usize,
    stop: &AtomicBool,
    chunks: Range<u64>,
) -> Result<Ended, Failure> {
    let mut ended = Ended::default();
    let (campaign, identity) = (&plan.campaign, &plan.identity);
    let flights_of = |chunk: u64| -> Vec<Flight> {
        let arms = 0..campaign.arms.len();
        let flights = campaign.flights_of(chunk);
        flights
            .flat_map(|flight| arms.clone().map(move |arm| (flight, arm)))
            .collect()
    };
    let rows_of = |chunk: u64| {
        let flights = campaign.flights_of(chunk);
        (flights.end - flights.start) * campaign.arms.len() as u64
    };
    let mut progress = Progress::new(chunks.clone().map(rows_of).sum(), "flight");
    for chunk in chunks {
        let state = chunk::state(out, campaign, identity, chunk);
        if let State::Refused(why) = &state {
            progress.clear();
            let path = chunk::path_of(out, chunk);
            if path.is_dir() {
                let what = format!("{}: a directory is in the place of rows", path.display());
                return Err(Failure::failed(what).help(IN_THE_WAY));
            }
            say(&format!("{}: {why}; flying it again\n", path.display()));
        }
        if state == State::Whole {
            ended.kept += rows_of(chunk);
            progress.skip(rows_of(chunk));
        } else {
            let look = |done| progress.look(ended.flown + done);
            match fly_all(plan, &flights_of(chunk), jobs, stop, look) {
                Err(failure) if failure.code == INTERRUPTED => ended.interrupted = true,
                Err(failure) => return Err(failure),
                Ok(rows) => {
                    chunk::write(out, campaign, identity, chunk, &rows)?;
                    ended.flown += rows_of(chunk);
                }
            }
        }
        ended.interrupted |= stop.load(Ordering::Relaxed);
        if ended.interrupted {
            break;
        }
        ended.chunks += 1;
    }
    progress.clear();
    ended.rate = progress.rate(ended.flown);
    Ok(ended)
}

impl Ended {
    fn text(&self, plan: &Plan, out: &Path) -> String {
        let status = match self.interrupted {
            true => "INTERRUPTED",
            false => "COMPLETE",
        };
        let (flown, kept, chunks, rate) = (self.flown, self.kept, self.chunks, self.rate);
        let (all, campaign) = (plan.campaign.chunks(), &plan.identity.campaign);
        let out = out.display();
        let result = format!(
            "RESULT status={status} flown={flown} kept={kept} chunks={chunks}/{all} campaign={campaign} out={out}\n"
        );
        let already = format!("already recorded: {kept}");
        match flown {
            0 => result,
            _ => format!(
                "{}, {rate:.1} flights/s; {already}\n{result}",
                count(flown, "flight")
            ),
        }
    }
}

const TRIED: Duration = Duration::from_secs(2);
const TRIED_MAX: u64 = 200;

/// `ironbird campaign check`: how many flights, how long here, how many bytes.
pub(super) fn check(args: &CampaignCheckArgs) -> Result<u8, Failure> {
    let plan = Plan::read(&args.file)?;
    let campaign = &plan.campaign;
    let arms = campaign.arms.len();
    let begun = Instant::now();
    let mut rows = Vec::new();
    let tried = campaign.flights.min(TRIED_MAX);
    let jobs = jobs(args.jobs, &plan.flown)?;
    // All over the campaign, so that a grid's cells are tried too.
    let flight = |i: u64| (u128::from(i) * u128::from(campaign.flights) / u128::from(tried)) as u64;
    let mut next = 0;
    while next < tried && begun.elapsed() <= TRIED {
        // A batch at a time, as the campaign flies.
        let some = (next..tried).take(LANES * jobs);
        let flights = some.flat_map(|i| (0..arms).map(move |arm| (flight(i), arm)));
        let flights: Vec<Flight> = flights.collect();
        let stop = AtomicBool::new(false);
        rows.extend(fly_all(&plan, &flights, jobs, &stop, |_| ())?);
        next += (LANES * jobs) as u64;
    }
    // Beside each other they may hinder each other: it is no flight's own time.
    let each_s = begun.elapsed().as_secs_f64() / rows.len() as f64;
    let total = campaign.flights * arms as u64;
    let mut drawn = campaign.factors.iter();
    let is_drawn = drawn.any(|factor| factor.name == "flight.duration_s");
    let lengths_s: Result<Vec<f64>, Failure> = (0..arms)
        .map(|arm| Ok(plan.flight(0, arm)?.0.flight.duration_s))
        .collect();
    let lengths_s = lengths_s?;
    let length = match lengths_s.iter().all(|it| *it == lengths_s[0]) && !is_drawn {
        true => format!("of {} s", lengths_s[0]),
        false => "of different lengths".into(),
    };
    let [per_file, per_row] = bytes(&plan, &rows)?;
    let takes_s = (each_s * total as f64).ceil();
    let takes = Duration::try_from_secs_f64(takes_s).unwrap_or(Duration::MAX);
    let factors = campaign.factors.iter();
    let constant = factors
        .filter(|factor| !factor.distribution.varies())
        .count();
    print(&format!(
        "{}: {} {length} by {} ({}), {} in {}; {} with the seed ({constant} constant)\n\
         time here  {} with {jobs} at once (a flight every {:.1} ms, by {} that were tried)\n\
         on disk    {} ({} bytes a row, {} a file)\n\
         campaign   {}\n",
        campaign.name,
        count(campaign.flights, "flight"),
        count(arms as u64, "arm"),
        list(campaign.arms.iter().map(|arm| &arm.name)),
        count(total, "row"),
        count(campaign.chunks(), "file"),
        count(campaign.factors.len() as u64, "factor"),
        humantime::format_duration(takes),
        1e3 * each_s,
        rows.len(),
        size((per_row * total as f64 + per_file * campaign.chunks() as f64) as u64),
        per_row.round(),
        per_file.round(),
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
