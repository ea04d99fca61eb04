//! `ironbird campaign submit`: the shards of a campaign as an array job.
//!
//! The engine schedules; what is there is decided by the files alone. Submitting again is harmless.

use std::fs::{self, File};
use std::path::{Path, PathBuf, absolute};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use analysis::phrase::count;
use campaign::campaign::{Campaign, Submission};
use campaign::chunk::path_of;
use errors::{FAILED, Failure, GATE, INTERRUPTED, InFile as _, OK};
use host::own_executable;
use rustix::process::{Pid, Signal, kill_process};

use super::flight_settings::{Plan, open_directory};
use super::run;
use super::status::{found, ranges, report};
use crate::cli::{CampaignReportArgs, CampaignRunArgs, CampaignSubmitArgs, DiffFormat, Engine};
use crate::parallel::asked_to_stop;
use crate::progress::Progress;
use errors::output::{print, say};

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
    open_directory(&plan, &out)?;
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

/// Shards where nobody says how many: Slurm takes no more than 1000 in an array, unless it is told to.
const SHARDS: u64 = 1000;

/// The array job of a campaign: its script, and the commands that submit and cancel it.
struct Array {
    name: String,
    shards: u64,
    executable: PathBuf,
    file: PathBuf,
    out: PathBuf,
    asked: Submission,
}

impl Array {
    fn of(plan: &Plan, args: &CampaignSubmitArgs, out: &Path) -> Result<Self, Failure> {
        let chunks = plan.campaign.chunks();
        let out = absolute(out).in_file("find", out)?;
        // Slurm's options are comments of the script: a line break would end the comment.
        if out.to_string_lossy().contains(char::is_control) {
            return Err(Failure::usage(format!(
                "--out {out:?}: the path contains a line break or another control character"
            ))
            .help("choose a directory without control characters in its path"));
        }
        Ok(Self {
            name: plan.campaign.name.clone(),
            // A shard without a chunk would do nothing.
            shards: args.shards.unwrap_or(SHARDS).min(chunks),
            executable: own_executable()?,
            file: plan.file.clone(),
            out,
            asked: plan.campaign.submission.clone(),
        })
    }

    fn script(&self, on: Engine) -> String {
        let [executable, file, out] =
            [&self.executable, &self.file, &self.out].map(|path| quoted(path));
        let (shards, processors) = (self.shards, self.asked.processors);
        let shard = format!(" --shard auto/{shards} --jobs {processors}");
        let (header, shard) = match on {
            Engine::Slurm => (self.slurm(), shard),
            Engine::Hyperqueue => (String::new(), shard),
            Engine::Local => (String::new(), String::new()),
        };
        format!("#!/bin/sh\n{header}exec {executable} campaign run {file} --out {out}{shard}\n")
    }

    fn slurm(&self) -> String {
        let Submission {
            partition,
            time_limit,
            requeue,
            processors,
        } = &self.asked;
        let log = quoted(&self.out.join("shard-%a.log"));
        let requeue = if *requeue { "requeue" } else { "no-requeue" };
        let mut asked = vec![
            format!("job-name=ironbird-{}", self.name),
            format!("output={log}"),
            "open-mode=append".into(),
            format!("cpus-per-task={processors}"),
            requeue.into(),
        ];
        let partition = partition.iter();
        asked.extend(partition.map(|partition| format!("partition={partition}")));
        // A number alone is minutes.
        let minutes = time_limit.iter().map(|limit| limit.as_secs().div_ceil(60));
        asked.extend(minutes.map(|minutes| format!("time={minutes}")));
        let lines = asked.iter().map(|option| format!("#SBATCH --{option}\n"));
        lines.collect()
    }

    fn script_file(&self) -> PathBuf {
        self.out.join("submit.sh")
    }

    /// What submits some shards, prints the number of the job, and waits for its end.
    fn command(&self, on: Engine, shards: &[u64]) -> Vec<String> {
        let script = self.script_file().display().to_string();
        let array = match shards.len() as u64 == self.shards {
            true => format!("1-{}", self.shards),
            false => shards
                .iter()
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(","),
        };
        let array = format!("--array={array}");
        let mut words: Vec<String> = match on {
            Engine::Slurm => ["sbatch", "--parsable", "--wait"].map(String::from).into(),
            Engine::Hyperqueue => self.hyperqueue(),
            Engine::Local => return vec!["sh".into(), script],
        };
        words.push(array);
        words.extend((on == Engine::Hyperqueue).then(|| "sh".to_owned()));
        words.push(script);
        words
    }

    fn hyperqueue(&self) -> Vec<String> {
        // The partition is Slurm's alone.
        let Submission {
            time_limit,
            requeue,
            processors,
            ..
        } = &self.asked;
        let log = self.out.join("shard-%{TASK_ID}.log").display().to_string();
        let mut words: Vec<String> = ["hq", "--output-mode=quiet", "submit", "--wait"]
            .map(String::from)
            .into();
        words.push(format!("--name=ironbird-{}", self.name));
        words.push(format!("--cpus={processors}"));
        let limit_s = time_limit.iter().map(|limit| limit.as_secs());
        words.extend(limit_s.map(|limit_s| format!("--time-limit={limit_s}s")));
        words.extend((!requeue).then(|| "--crash-limit=1".to_owned()));
        words.extend(["stdout", "stderr"].map(|which| format!("--{which}={log}")));
        words
    }

    fn cancel(on: Engine, job: &str) -> Option<Vec<String>> {
        match on {
            Engine::Slurm => Some(["scancel", job].map(String::from).into()),
            Engine::Hyperqueue => Some(["hq", "job", "cancel", job].map(String::from).into()),
            Engine::Local => None,
        }
    }

    fn shards_of(&self, campaign: &Campaign, chunks: &[u64]) -> Vec<u64> {
        let has = |shard: &u64| {
            campaign
                .shard(*shard, self.shards)
                .any(|chunk| chunks.binary_search(&chunk).is_ok())
        };
        (1..=self.shards).filter(has).collect()
    }
}

fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}
