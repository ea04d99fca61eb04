//! `ironbird campaign submit`: the shards of a campaign as an array job.
//!
//! The engine schedules; what is there is decided by the files alone. Submitting again is harmless.

use std::fs::{self, File};
use std::path::{Path, PathBuf, absolute};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use analysis::phrase::count;
use campaign::campaign::Campaign;
use campaign::chunk::path_of;
use errors::{Failure, GATE, INTERRUPTED, InFile as _, OK};
use host::own_executable;

use super::run;
use super::status::{chunks, ranges, report};
use crate::cli::{CampaignReportArgs, CampaignRunArgs, CampaignSubmitArgs, DiffFormat, Engine};
use config::utf8;
use errors::output::{print, say};
use experiments::campaign::flight_settings::{IN_THE_WAY, Plan, open_directory};
use experiments::progress::Progress;
use process::signals::stop_flag;
use supervisor::child_process::{end, wait_at_most};

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
    let out = args.out.clone();
    let out = out.unwrap_or_else(|| run::default_directory(&plan));
    let array = Array::of(&plan, args, &out)?;
    let all = array.shards;
    if let Some(given) = args.shards.filter(|given| *given > all) {
        let files = count(all, "file");
        say(&format!(
            "warning: --shards {given}: the campaign has {files} of rows, and a shard has one at least: {all} are \
             flown; `campaign.chunk` makes the files smaller\n"
        ));
    }
    if args.dry_run {
        let shards: Vec<u64> = (1..=all).collect();
        let command = match args.on {
            Engine::Local => String::new(),
            _ => format!("# {}\n", array.command(&shards).join(" ")),
        };
        print(&(array.script() + &command))?;
        return Ok(OK);
    }
    let reported = CampaignReportArgs {
        directory: out.clone(),
        format: DiffFormat::Text,
        page: None,
        min_success: None,
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
        stop: &*stop_flag()?,
    };
    let script = array.script_file();
    let written = fs::write(&script, array.script()).in_file("write", &script);
    written.map_err(|failure| failure.or_help(IN_THE_WAY))?;
    for round in 1.. {
        let missing = submitted.missing();
        let shards = array.shards_of(&plan.campaign, &missing);
        let (few, numbers, place) = (shards.len(), ranges(&shards), out.display());
        if shards.is_empty() {
            say(&format!("{place}: all {all} shards are there\n"));
            return report(&reported);
        }
        if round > ROUNDS {
            print(&format!(
                "{place}: {few} of {all} shards are missing after {ROUNDS} rounds: {numbers}; their output is in {}\n",
                out.join("shard-*.log").display()
            ))?;
            break;
        }
        say(&format!(
            "round {round}: {few} of {all} shards: {numbers}\n"
        ));
        submitted.fly(&missing, &shards)?;
    }
    Ok(GATE)
}

struct Submitted<'a> {
    plan: &'a Plan,
    array: &'a Array,
    stop: &'a AtomicBool,
}

impl Submitted<'_> {
    fn missing(&self) -> Vec<u64> {
        let (_, missing) = chunks(self.plan, &self.array.out);
        missing.into_iter().map(|(chunk, _)| chunk).collect()
    }

    fn written(&self, chunk: u64) -> Option<SystemTime> {
        fs::metadata(path_of(&self.array.out, chunk))
            .and_then(|file| file.modified())
            .ok()
    }

    /// Submits some shards to the engine, and shows the progress until its job has ended.
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
        let command = self.array.command(shards);
        let file = File::create(&output).in_file("write", &output);
        let file = file.map_err(|failure| failure.or_help(IN_THE_WAY))?;
        let mut engine = started(&command, file)?;
        let mut complete: Option<Instant> = None;
        let ended = loop {
            if let Some(ended) = engine.try_wait().in_file("wait for", command[0].as_ref())? {
                break Some(ended);
            }
            if self.stop.load(Ordering::Relaxed) {
                progress.clear();
                return Err(self.cancelled(&mut engine, &job()));
            }
            let mut since = || complete.get_or_insert_with(Instant::now).elapsed();
            if waited.is_empty() && since() > JOB_END_TIMEOUT {
                end(&mut engine, TERMINATION_TIMEOUT);
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
                    .help("see its message above; `--dry-run` prints the script and the command"),
            );
        }
        // A task that failed makes the whole array fail; the files say which.
        say(&format!("{engine} ended with {ended}\n"));
        Ok(())
    }

    /// Ends the engine's job; `output` is what the engine printed of it.
    fn cancelled(&self, engine: &mut Child, output: &str) -> Failure {
        end(engine, TERMINATION_TIMEOUT);
        // Slurm prints the number and, behind a semicolon, the cluster.
        let mut lines = output.lines();
        let job = lines.find_map(|line| line.split(';').next()?.trim().parse::<u64>().ok());
        let cancel = job.map(|job| [self.array.cancel, &[&job.to_string()]].concat().join(" "));
        let is_cancelled = |command: &String| {
            let mut words = command.split(' ');
            let cancelling = Command::new(words.next().unwrap_or_default())
                .args(words)
                .stdin(Stdio::null())
                .spawn();
            cancelling.is_ok_and(|mut process| {
                let status = wait_at_most(&mut process, CANCEL_TIMEOUT);
                if status.is_none() {
                    end(&mut process, TERMINATION_TIMEOUT);
                }
                status.is_some_and(|status| status.success())
            })
        };
        let failed = cancel.filter(|command| !is_cancelled(command));
        let failed = failed.map(|it| format!("; `{it}` failed, so the job may still run"));
        let what = format!("interrupted{}", failed.unwrap_or_default());
        Failure::new(INTERRUPTED, what)
            .help("whole files of rows are kept; the same command again flies what is missing")
    }
}

fn started(command: &[String], to: File) -> Result<Child, Failure> {
    let engine = &command[0];
    let mut process = Command::new(engine);
    let process = process.args(&command[1..]).stdin(Stdio::null()).stdout(to);
    process.spawn().map_err(|e| {
        Failure::failed(format!("cannot start {engine}: {e}"))
            .help("run it where the engine's commands are on the path; --dry-run prints the script")
    })
}

/// Shards where --shards is not given: by default, Slurm takes no more than 1000 in an array.
const SHARDS: u64 = 1000;

/// The array job of a campaign: its script, and the commands that submit and cancel it.
struct Array {
    shards: u64,
    out: PathBuf,
    /// Options of the job that stand in the script, one a line, and what the script executes.
    options: Vec<String>,
    executed: String,
    /// The command that submits the job, without the array and the script; what follows the array.
    submit: Vec<String>,
    shell: Option<&'static str>,
    /// The command that cancels a job, without its number.
    cancel: &'static [&'static str],
}

impl Array {
    fn of(plan: &Plan, args: &CampaignSubmitArgs, out: &Path) -> Result<Self, Failure> {
        let out = absolute(out).in_file("find", out)?;
        // Slurm's options are comments of the script: a line break would end the comment.
        if utf8(&out)?.contains(char::is_control) {
            return Err(Failure::usage(format!(
                "--out {out:?}: the path contains a line break or another control character"
            ))
            .help("choose a directory without control characters in its path"));
        }
        let submission = &plan.campaign.submission;
        let processors = submission.processors;
        // A shard without a chunk would do nothing.
        let shards = args.shards.unwrap_or(SHARDS).min(plan.campaign.chunks());
        let name = format!("ironbird-{}", plan.campaign.name);
        let limit_s = submission.time_limit.map(|limit| limit.as_secs());
        let of_array = format!(" --shard auto/{shards} --jobs {processors}");
        let log = |task: &str| out.join(format!("shard-{task}.log"));
        let mut options = Vec::new();
        let (submit, shell, cancel, of_array) = match args.on {
            Engine::Slurm => {
                let log = quoted(&log("%a"));
                let requeue = if submission.requeue {
                    "requeue"
                } else {
                    "no-requeue"
                };
                options = vec![
                    format!("job-name={name}"),
                    format!("output={log}"),
                    "open-mode=append".into(),
                    format!("cpus-per-task={processors}"),
                    requeue.into(),
                ];
                let partition = submission.partition.iter();
                options.extend(partition.map(|it| format!("partition={it}")));
                // A number alone is minutes.
                let minutes = limit_s.map(|limit_s| limit_s.div_ceil(60));
                options.extend(minutes.map(|minutes| format!("time={minutes}")));
                let submit = ["sbatch", "--parsable", "--wait"].map(String::from).into();
                (submit, None, &["scancel"][..], of_array)
            }
            // The partition is Slurm's alone.
            Engine::Hyperqueue => {
                let log = log("%{TASK_ID}").display().to_string();
                let hq = ["hq", "--output-mode=quiet", "submit", "--wait"];
                let mut submit: Vec<String> = hq.map(String::from).into();
                submit.push(format!("--name={name}"));
                submit.push(format!("--cpus={processors}"));
                submit.extend(limit_s.map(|limit_s| format!("--time-limit={limit_s}s")));
                submit.extend((!submission.requeue).then(|| "--crash-limit=1".to_owned()));
                submit.extend(["stdout", "stderr"].map(|which| format!("--{which}={log}")));
                (submit, Some("sh"), &["hq", "job", "cancel"][..], of_array)
            }
            Engine::Local => (Vec::new(), None, &[][..], String::new()),
        };
        let [executable, file, directory] =
            [&own_executable()?, &plan.file, &out].map(|path| quoted(path));
        Ok(Self {
            shards,
            options,
            executed: format!("{executable} campaign run {file} --out {directory}{of_array}"),
            submit,
            shell,
            cancel,
            out,
        })
    }

    fn script(&self) -> String {
        let options = self.options.iter();
        let header: String = options
            .map(|option| format!("#SBATCH --{option}\n"))
            .collect();
        format!("#!/bin/sh\n{header}exec {}\n", self.executed)
    }

    fn script_file(&self) -> PathBuf {
        self.out.join("submit.sh")
    }

    /// The command that submits some shards, prints the number of the job, and waits for its end.
    fn command(&self, shards: &[u64]) -> Vec<String> {
        let all = shards.len() as u64 == self.shards;
        let numbers: Vec<String> = shards.iter().map(u64::to_string).collect();
        let array = match all {
            true => format!("--array=1-{}", self.shards),
            false => format!("--array={}", numbers.join(",")),
        };
        let script = self.script_file().display().to_string();
        let shell = self.shell.map(str::to_owned);
        let rest = [array].into_iter().chain(shell).chain([script]);
        self.submit.iter().cloned().chain(rest).collect()
    }

    fn shards_of(&self, campaign: &Campaign, chunks: &[u64]) -> Vec<u64> {
        let has = |shard: &u64| {
            let mut own = campaign.shard(*shard, self.shards);
            own.any(|chunk| chunks.binary_search(&chunk).is_ok())
        };
        (1..=self.shards).filter(has).collect()
    }
}

fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}
