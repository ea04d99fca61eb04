//! `ironbird campaign submit`: the shards of a campaign as an array job.
//!
//! The engine schedules; what is there is decided by the files alone. Submitting again is harmless.

use std::fs;
use std::path::{Path, PathBuf, absolute};
use std::process::Command;

use failure::{FAILED, Failure, GATE, InFile as _, OK};

use super::plan::Plan;
use super::status::{found, ranges};
use super::{directory, run};
use crate::cli::{CampaignRunArgs, CampaignSubmitArgs, Engine};
use crate::output::{print, say};
use machine::executable::own_executable;

/// How often an array is submitted: what fails so often fails always.
const ROUNDS: usize = 3;

/// Submits the shards that are not whole, waits for the engine, and submits again what it lost.
///
/// # Errors
/// Usage: what is wrong with the file; an engine that is not there. A file that cannot be written.
pub(super) fn submit(args: &CampaignSubmitArgs) -> Result<u8, Failure> {
    let plan = Plan::read(&args.file)?;
    let out = args.out.clone().unwrap_or_else(|| run::default_directory(&plan));
    let array = Array::of(&plan, args, &out)?;
    if args.on == Engine::Local && !args.dry_run {
        return run::run(&CampaignRunArgs {
            file: args.file.clone(),
            shard: None,
            out: Some(out),
            jobs: None,
            until: None,
        });
    }
    if args.dry_run {
        let all: Vec<u64> = (1..=array.shards).collect();
        let command = array.command(args.on, &all);
        print(&format!("{}# {}\n", array.script(args.on), command.join(" ")))?;
        return Ok(OK);
    }
    directory::open(&plan, &out)?;
    let script = out.join("submit.sh");
    fs::write(&script, array.script(args.on)).in_file("write", &script)?;
    for round in 1..=ROUNDS {
        let missing = array.missing(&plan, &out);
        if missing.is_empty() {
            break;
        }
        say(&format!("round {round}: {} of {} shards: {}\n", missing.len(), array.shards, ranges(&missing)));
        let command = array.command(args.on, &missing);
        let engine = &command[0];
        let ended = Command::new(engine).args(&command[1..]).status().map_err(|e| {
            Failure::new(FAILED, format!("cannot start {engine}: {e}"))
                .help("run it where the engine's commands are on the path; --dry-run prints the script")
        })?;
        if !ended.success() {
            // A task that failed makes the whole array fail; the files say which.
            say(&format!("{engine} ended with {ended}\n"));
        }
    }
    let missing = array.missing(&plan, &out);
    if missing.is_empty() {
        print(&format!("{}: all {} shards are there\n", out.display(), array.shards))?;
        return Ok(OK);
    }
    print(&format!(
        "{}: {} of {} shards are missing after {ROUNDS} rounds: {}; their output is in {}\n",
        out.display(),
        missing.len(),
        array.shards,
        ranges(&missing),
        out.join("shard-*.log").display()
    ))?;
    Ok(GATE)
}

/// The array job of a campaign.
struct Array {
    name: String,
    shards: u64,
    executable: PathBuf,
    file: PathBuf,
    out: PathBuf,
}

impl Array {
    fn of(plan: &Plan, args: &CampaignSubmitArgs, out: &Path) -> Result<Self, Failure> {
        let chunks = plan.campaign.chunks();
        Ok(Self {
            name: plan.campaign.name.clone(),
            // A shard without a chunk would do nothing.
            shards: args.shards.map_or(chunks, |shards| shards.min(chunks)),
            executable: own_executable()?,
            file: plan.file.clone(),
            out: absolute(out).in_file("find", out)?,
        })
    }

    /// The job: each task flies its shard.
    fn script(&self, on: Engine) -> String {
        let header = match on {
            Engine::Slurm => format!(
                "#SBATCH --job-name=ironbird-{}\n#SBATCH --output={}\n#SBATCH --open-mode=append\n#SBATCH --requeue\n",
                self.name,
                quoted(&self.out.join("shard-%a.log"))
            ),
            Engine::Hyperqueue | Engine::Local => String::new(),
        };
        let shard = match on {
            Engine::Slurm => format!(" --shard auto/{} --jobs \"${{SLURM_CPUS_PER_TASK:-1}}\"", self.shards),
            Engine::Hyperqueue => format!(" --shard auto/{} --jobs 1", self.shards),
            Engine::Local => String::new(),
        };
        let [executable, file, out] = [&self.executable, &self.file, &self.out].map(|path| quoted(path));
        format!("#!/bin/sh\n{header}exec {executable} campaign run {file} --out {out}{shard}\n")
    }

    /// What submits some shards and waits for their end.
    fn command(&self, on: Engine, shards: &[u64]) -> Vec<String> {
        let numbers = shards.iter().map(u64::to_string).collect::<Vec<_>>().join(",");
        let array = if shards.len() as u64 == self.shards { format!("1-{}", self.shards) } else { numbers };
        let script = self.out.join("submit.sh").display().to_string();
        match on {
            Engine::Slurm => vec!["sbatch".into(), "--wait".into(), format!("--array={array}"), script],
            Engine::Hyperqueue => {
                let log = self.out.join("shard-%{TASK_ID}.log").display().to_string();
                let name = format!("--name=ironbird-{}", self.name);
                let [stdout, stderr] = ["stdout", "stderr"].map(|which| format!("--{which}={log}"));
                vec![
                    "hq".into(),
                    "submit".into(),
                    "--wait".into(),
                    name,
                    format!("--array={array}"),
                    stdout,
                    stderr,
                    "sh".into(),
                    script,
                ]
            }
            Engine::Local => vec!["sh".into(), script],
        }
    }

    /// Shards of which a chunk is not whole.
    fn missing(&self, plan: &Plan, out: &Path) -> Vec<u64> {
        let whole = found(plan, out).whole;
        let is_missing =
            |shard: &u64| plan.campaign.shard(*shard, self.shards).any(|chunk| whole.binary_search(&chunk).is_err());
        (1..=self.shards).filter(is_missing).collect()
    }
}

/// A path as a word of the shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}
