//! `ironbird campaign run`: flies the chunks of a campaign that are not there yet.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use campaign::chunk::{self, State};
use campaign::rows::Rows;
use campaign::statistics::rates::wilson;
use failure::{Failure, INTERRUPTED, OK};

use super::plan::Plan;
use super::{directory, flown};
use crate::build;
use crate::cli::{CampaignRunArgs, Shard};
use crate::output::{print, say};
use crate::parallel::{asked_to_stop, processors};
use crate::progress::Progress;

/// Environment variables that number the tasks of a job, and what makes them begin with 1: those of Slurm, HyperQueue,
/// Kubernetes and GNU parallel.
const TASKS: [(&str, u64); 4] =
    [("SLURM_ARRAY_TASK_ID", 0), ("HQ_TASK_ID", 0), ("JOB_COMPLETION_INDEX", 1), ("PARALLEL_SEQ", 0)];

/// What is said of a build with uncommitted changes.
const DIRTY: &str = "this build has uncommitted changes, and rows of any other such build of its commit count as its own; \
                     commit, and build again, before flying what shall count";

/// Flies a campaign, or a shard of it.
///
/// # Errors
/// Usage: what is wrong with the file; a directory that holds another campaign. A file that cannot be written; an
/// interruption, after which the chunks that were whole are kept.
pub(super) fn run(args: &CampaignRunArgs) -> Result<u8, Failure> {
    let stop = asked_to_stop()?;
    let plan = Plan::read(&args.file)?;
    let out = args.out.clone().unwrap_or_else(|| default_directory(&plan));
    let chunks = args.shard.map_or(Ok(0..plan.campaign.chunks()), |shard| of_shard(&plan, shard))?;
    directory::open(&plan, &out)?;
    if build::here().dirty {
        say(&format!("warning: {DIRTY}\n"));
    }
    let jobs = args.jobs.unwrap_or_else(processors);
    let mut flying =
        Flying { plan: &plan, out: &out, jobs, stop: &stop, success: vec![[0; 2]; plan.campaign.arms.len()] };
    let ended = flying.fly(chunks, args.until)?;
    print(&ended.words(&plan, &out))?;
    Ok(if ended.interrupted { INTERRUPTED } else { OK })
}

/// Where a campaign's rows go, where nobody says it.
pub(super) fn default_directory(plan: &Plan) -> PathBuf {
    PathBuf::from("campaigns").join(&plan.campaign.name)
}

/// The chunks of a shard.
fn of_shard(plan: &Plan, shard: Shard) -> Result<Range<u64>, Failure> {
    let number = match shard.number {
        Some(number) => number,
        None => task().ok_or_else(|| {
            let names: Vec<&str> = TASKS.iter().map(|(name, _)| *name).collect();
            Failure::usage(format!("--shard auto/{}: no task number is in {}", shard.of, names.join(", ")))
                .help("write the number of the shard, as in --shard 3/24, or run it as the task of an array job")
        })?,
    };
    if !(1..=shard.of).contains(&number) {
        return Err(Failure::usage(format!("--shard auto/{}: the task's number is {number}", shard.of))
            .help(format!("number the tasks from 1 to {}", shard.of)));
    }
    Ok(plan.campaign.shard(number, shard.of))
}

fn task() -> Option<u64> {
    let number = |(name, first): (&str, u64)| Some(std::env::var(name).ok()?.parse::<u64>().ok()? + first);
    TASKS.into_iter().find_map(number)
}

/// A campaign that is being flown.
struct Flying<'a> {
    plan: &'a Plan,
    out: &'a Path,
    jobs: usize,
    stop: &'a AtomicBool,
    /// Successes and flights of each arm.
    success: Vec<[u64; 2]>,
}

/// How it ended.
#[derive(Debug, Default)]
struct Ended {
    flown: u64,
    /// Rows that were there already.
    kept: u64,
    chunks: u64,
    rate: f64,
    interrupted: bool,
    /// What the campaign was stopped for.
    stopped: Option<String>,
}

impl Flying<'_> {
    fn fly(&mut self, chunks: Range<u64>, until: Option<f64>) -> Result<Ended, Failure> {
        let campaign = &self.plan.campaign;
        let arms = campaign.arms.len() as u64;
        let rows_of = |chunk: u64| campaign.flights_of(chunk).count() as u64 * arms;
        let mut ended = Ended::default();
        let mut progress = Progress::new(chunks.clone().map(rows_of).sum(), "flight");
        for chunk in chunks {
            let state = chunk::state(self.out, campaign, &self.plan.identity, chunk);
            if state == State::Whole {
                ended.kept += rows_of(chunk);
                progress.skip(rows_of(chunk));
                if until.is_some() {
                    self.count_kept(chunk)?;
                }
            } else {
                if let State::Refused(why) = state {
                    progress.clear();
                    say(&format!("{}: {why}; it is flown again\n", chunk::path_of(self.out, chunk).display()));
                }
                match self.chunk(chunk, |done| progress.look(ended.flown + done)) {
                    Err(failure) if failure.code == INTERRUPTED => ended.interrupted = true,
                    Err(failure) => return Err(failure),
                    Ok(()) => ended.flown += rows_of(chunk),
                }
            }
            if ended.interrupted || self.stop.load(Ordering::Relaxed) {
                ended.interrupted = true;
                break;
            }
            ended.chunks += 1;
            ended.stopped = until.and_then(|width| self.is_narrow(width));
            if ended.stopped.is_some() {
                break;
            }
        }
        progress.clear();
        ended.rate = progress.rate(ended.flown);
        Ok(ended)
    }

    /// Flies a chunk and writes it.
    fn chunk(&mut self, chunk: u64, look: impl FnMut(u64)) -> Result<(), Failure> {
        let campaign = &self.plan.campaign;
        let arms = 0..campaign.arms.len();
        let flights: Vec<flown::Flight> =
            campaign.flights_of(chunk).flat_map(|flight| arms.clone().map(move |arm| (flight, arm))).collect();
        let rows = flown::rows(self.plan, &flights, self.jobs, self.stop, look)?;
        for row in &rows {
            let [successes, flights] = &mut self.success[row.arm];
            *successes += u64::from(campaign.gates.is_success(&row.outcome));
            *flights += 1;
        }
        chunk::write(self.out, campaign, &self.plan.identity, chunk, &rows)
    }

    /// Counts the rows of a chunk that was there already.
    fn count_kept(&mut self, chunk: u64) -> Result<(), Failure> {
        let arms = self.success.len();
        for (i, success) in Rows::new(self.out, [chunk]).flags("success")?.into_iter().enumerate() {
            let [successes, flights] = &mut self.success[i % arms];
            *successes += u64::from(success == Some(true));
            *flights += 1;
        }
        Ok(())
    }

    /// Whether the interval of every arm's success rate is narrower than a width.
    fn is_narrow(&self, width: f64) -> Option<String> {
        let widths = self.success.iter().map(|[successes, flights]| wilson(*successes, *flights).width());
        let widest = widths.fold(0.0, f64::max);
        (widest < width).then(|| format!("width(success) = {widest:.4} < {width}"))
    }
}

impl Ended {
    fn words(&self, plan: &Plan, out: &Path) -> String {
        let status = match (self.interrupted, &self.stopped) {
            (true, _) => "INTERRUPTED",
            (false, Some(_)) => "STOPPED",
            (false, None) => "COMPLETE",
        };
        let mut text = String::new();
        if self.flown > 0 {
            text += &format!("{} flights, {:.1} flights/s; {} were there already\n", self.flown, self.rate, self.kept);
        }
        text.extend(self.stopped.iter().map(|why| format!("stopped: {why}\n")));
        let chunks = plan.campaign.chunks();
        text + &format!(
            "RESULT status={status} flown={} kept={} chunks={}/{chunks} campaign={} out={}\n",
            self.flown,
            self.kept,
            self.chunks,
            plan.identity.campaign,
            out.display()
        )
    }
}
