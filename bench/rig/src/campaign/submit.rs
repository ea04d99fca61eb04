//! `ironbird campaign submit`: the shards of a campaign as an array job.
//!
//! The engine schedules; what is there is decided by the files alone. Submitting again is harmless.

use std::fs::{self, File};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use campaign::chunk::path_of;
use errors::{FAILED, Failure, GATE, INTERRUPTED, InFile as _, OK};
use report::phrase::count;
use rustix::process::{Pid, Signal, kill_process};

use super::array::Array;
use super::flight_settings::Plan;
use super::status::{found, ranges, report};
use super::{directory, run};
use crate::cli::{CampaignReportArgs, CampaignRunArgs, CampaignSubmitArgs, DiffFormat, Engine};
use crate::output::{print, say};
use crate::parallel::asked_to_stop;
use crate::progress::Progress;

/// How often the missing shards are submitted. A shard that fails this often always fails.
const ROUNDS: usize = 3;
const POLL_EVERY: Duration = Duration::from_millis(200);
/// How long the engine may take to notice the end of a job whose files are complete. `sbatch --wait` polls less and less
/// often.
const JOB_END_TIMEOUT: Duration = Duration::from_secs(2);
/// How long an engine's command may take to end after SIGTERM; then it is killed.
const TERMINATION_TIMEOUT: Duration = Duration::from_secs(3);
const CANCEL_TIMEOUT: Duration = Duration::from_secs(10);

/// Submits the shards that are not whole, watches the engine, submits again what it lost, and reports.
pub(super) fn submit(args: &CampaignSubmitArgs) -> Result<u8, Failure> {
    let plan = Plan::read(&args.file)?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| run::default_directory(&plan));
    let array = Array::of(&plan, args, &out)?;
    if let Some(asked) = args.shards.filter(|asked| *asked > array.shards) {
        let (shards, files) = (array.shards, count(array.shards, "file"));
        say(&format!(
            "warning: --shards {asked}: the campaign has {files} of rows, and a shard has one at least: {shards} are \
             flown; `campaign.chunk` makes the files smaller\n"
        ));
    }
    if args.dry_run {
        let all: Vec<u64> = (1..=array.shards).collect();
        let command = match args.on {
            Engine::Local => String::new(),
            engine => format!("# {}\n", array.command(engine, &all).join(" ")),
        };
        print(&(array.script(args.on) + &command))?;
        return Ok(OK);
    }
    let reported = CampaignReportArgs {
        directory: out.clone(),
        format: DiffFormat::Text,
        page: None,
    };
    if args.on == Engine::Local {
        let code = run::run(&CampaignRunArgs {
            file: args.file.clone(),
            shard: None,
            out: Some(out),
            jobs: None,
        })?;
        return match code {
            OK => report(&reported),
            code => Ok(code),
        };
    }
    directory::open(&plan, &out)?;
    let submitted = Submitted {
        plan: &plan,
        array: &array,
        on: args.on,
        stop: &*asked_to_stop()?,
    };
    fs::write(array.script_file(), array.script(args.on)).in_file("write", &array.script_file())?;
    for round in 1..=ROUNDS {
        let missing = submitted.missing();
        let shards = array.shards_of(&plan.campaign, &missing);
        if shards.is_empty() {
            break;
        }
        let (few, all, numbers) = (shards.len(), array.shards, ranges(&shards));
        say(&format!(
            "round {round}: {few} of {all} shards: {numbers}\n"
        ));
        submitted.fly(&missing, &shards)?;
    }
    let shards = array.shards_of(&plan.campaign, &submitted.missing());
    let (few, all, place) = (shards.len(), array.shards, out.display());
    if shards.is_empty() {
        say(&format!("{place}: all {all} shards are there\n"));
        return report(&reported);
    }
    let (numbers, logs) = (ranges(&shards), out.join("shard-*.log"));
    print(&format!(
        "{place}: {few} of {all} shards are missing after {ROUNDS} rounds: {numbers}; their output is in {}\n",
        logs.display()
    ))?;
    Ok(GATE)
}

struct Submitted<'a> {
    plan: &'a Plan,
    array: &'a Array,
    on: Engine,
    stop: &'a AtomicBool,
}

impl Submitted<'_> {
    fn missing(&self) -> Vec<u64> {
        let whole = found(self.plan, &self.array.out).whole;
        (0..self.plan.campaign.chunks())
            .filter(|chunk| whole.binary_search(chunk).is_err())
            .collect()
    }

    fn written(&self, chunk: u64) -> Option<SystemTime> {
        fs::metadata(path_of(&self.array.out, chunk))
            .and_then(|file| file.modified())
            .ok()
    }

    /// Has the engine fly some shards, and tells how far it is until its job has ended.
    fn fly(&self, missing: &[u64], shards: &[u64]) -> Result<(), Failure> {
        let (campaign, output) = (&self.plan.campaign, self.array.out.join("submit.job"));
        let job = || fs::read_to_string(&output).unwrap_or_default();
        let rows =
            |chunk: u64| campaign.flights_of(chunk).count() as u64 * campaign.arms.len() as u64;
        // What lies there now is broken, and a new file will have another time.
        let waited = missing.iter().map(|chunk| (*chunk, self.written(*chunk)));
        let mut waited: Vec<(u64, Option<SystemTime>)> = waited.collect();
        let total = missing.iter().map(|chunk| rows(*chunk)).sum();
        let mut progress = Progress::new(total, "flight");
        let mut flown = 0;
        let command = self.array.command(self.on, shards);
        let mut engine = started(&command, File::create(&output).in_file("write", &output)?)?;
        let mut all_there: Option<Instant> = None;
        let ended = loop {
            if let Some(ended) = engine.try_wait().in_file("wait for", command[0].as_ref())? {
                break Some(ended);
            }
            if self.stop.load(Ordering::Relaxed) {
                progress.clear();
                return Err(self.cancelled(&mut engine, &job()));
            }
            if waited.is_empty()
                && all_there.get_or_insert_with(Instant::now).elapsed() > JOB_END_TIMEOUT
            {
                end(&mut engine);
                break None;
            }
            waited.retain(|(chunk, before)| {
                let now = self.written(*chunk);
                let is_new = now.is_some() && now != *before;
                flown += if is_new { rows(*chunk) } else { 0 };
                !is_new
            });
            progress.look(flown);
            sleep(POLL_EVERY);
        };
        progress.clear();
        let Some(ended) = ended.filter(|ended| !ended.success()) else {
            return Ok(());
        };
        let engine = &command[0];
        if job().trim().is_empty() {
            return Err(
                Failure::failed(format!("{engine} took no job: it ended with {ended}"))
                    .help("it has said why; `--dry-run` prints the script and the command"),
            );
        }
        // A task that failed makes the whole array fail; the files say which.
        say(&format!("{engine} ended with {ended}\n"));
        Ok(())
    }

    /// Ends the engine's job; `output` is what the engine printed of it.
    fn cancelled(&self, engine: &mut Child, output: &str) -> Failure {
        end(engine);
        // Slurm says the number and, behind a semicolon, the cluster.
        let mut lines = output.lines();
        let job = lines.find_map(|line| line.split(';').next()?.trim().parse::<u64>().ok());
        let cancel = job.and_then(|job| Array::cancel(self.on, &job.to_string()));
        let words = cancel.map_or_else(String::new, |words| {
            let cancelling = Command::new(&words[0])
                .args(&words[1..])
                .stdin(Stdio::null())
                .spawn();
            let is_cancelled = cancelling.is_ok_and(|mut process| {
                let status = wait_at_most(&mut process, CANCEL_TIMEOUT);
                if status.is_none() {
                    end(&mut process);
                }
                status.is_some_and(|status| status.success())
            });
            match is_cancelled {
                true => String::new(),
                false => format!("; `{}` failed, so the job may still run", words.join(" ")),
            }
        });
        Failure::new(INTERRUPTED, format!("interrupted{words}"))
            .help("whole files of rows are kept; the same command again flies what is missing")
    }
}

fn started(command: &[String], to: File) -> Result<Child, Failure> {
    let engine = &command[0];
    Command::new(engine)
        .args(&command[1..])
        .stdin(Stdio::null())
        .stdout(to)
        .spawn()
        .map_err(|e| {
            Failure::new(FAILED, format!("cannot start {engine}: {e}")).help(
                "run it where the engine's commands are on the path; --dry-run prints the script",
            )
        })
}

/// Ends a command: with SIGTERM, and with SIGKILL if it ignores that.
fn end(process: &mut Child) {
    if let Some(pid) = i32::try_from(process.id()).ok().and_then(Pid::from_raw) {
        // It may have ended by itself.
        let _ = kill_process(pid, Signal::TERM);
    }
    if wait_at_most(process, TERMINATION_TIMEOUT).is_none() {
        let _ = process.kill();
        let _ = process.wait();
    }
}

/// The exit status of a process; none if it still runs after `limit`.
fn wait_at_most(process: &mut Child, limit: Duration) -> Option<ExitStatus> {
    let until = Instant::now() + limit;
    loop {
        match process.try_wait() {
            Ok(None) if Instant::now() < until => sleep(POLL_EVERY / 10),
            Ok(status) => return status,
            Err(_) => return None,
        }
    }
}
