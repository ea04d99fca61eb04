//! The array job of a campaign: its script, and the commands that submit and cancel it.

use std::path::{Path, PathBuf, absolute};

use campaign::campaign::{Campaign, Submission};
use errors::{Failure, InFile as _};

use super::flight_settings::Plan;
use crate::cli::{CampaignSubmitArgs, Engine};
use host::own_executable;

/// Shards where nobody says how many: Slurm takes no more than 1000 in an array, unless it is told to.
const SHARDS: u64 = 1000;

/// The array job of a campaign.
pub(super) struct Array {
    name: String,
    pub shards: u64,
    executable: PathBuf,
    file: PathBuf,
    /// Directory of the rows, from the root on.
    pub out: PathBuf,
    asked: Submission,
}

impl Array {
    pub fn of(plan: &Plan, args: &CampaignSubmitArgs, out: &Path) -> Result<Self, Failure> {
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

    pub fn script(&self, on: Engine) -> String {
        let header = if on == Engine::Slurm {
            self.slurm()
        } else {
            String::new()
        };
        let [executable, file, out] =
            [&self.executable, &self.file, &self.out].map(|path| quoted(path));
        let shard = match on {
            Engine::Slurm | Engine::Hyperqueue => {
                format!(
                    " --shard auto/{} --jobs {}",
                    self.shards, self.asked.processors
                )
            }
            Engine::Local => String::new(),
        };
        format!("#!/bin/sh\n{header}exec {executable} campaign run {file} --out {out}{shard}\n")
    }

    /// What Slurm reads in the script.
    fn slurm(&self) -> String {
        let Submission {
            partition,
            time_limit,
            requeue,
            processors,
        } = &self.asked;
        let mut asked = vec![
            format!("--job-name=ironbird-{}", self.name),
            format!("--output={}", quoted(&self.out.join("shard-%a.log"))),
            "--open-mode=append".into(),
            format!("--cpus-per-task={processors}"),
            if *requeue {
                "--requeue".into()
            } else {
                "--no-requeue".into()
            },
        ];
        asked.extend(
            partition
                .iter()
                .map(|partition| format!("--partition={partition}")),
        );
        // A number alone is minutes.
        asked.extend(
            time_limit
                .iter()
                .map(|limit| format!("--time={}", limit.as_secs().div_ceil(60))),
        );
        asked
            .iter()
            .map(|line| format!("#SBATCH {line}\n"))
            .collect()
    }

    pub fn script_file(&self) -> PathBuf {
        self.out.join("submit.sh")
    }

    /// What submits some shards, prints the number of the job, and waits for its end.
    pub fn command(&self, on: Engine, shards: &[u64]) -> Vec<String> {
        let numbers = shards
            .iter()
            .map(u64::to_string)
            .collect::<Vec<_>>()
            .join(",");
        let array = if shards.len() as u64 == self.shards {
            format!("1-{}", self.shards)
        } else {
            numbers
        };
        let array = format!("--array={array}");
        let script = self.script_file().display().to_string();
        let (words, shell): (Vec<String>, _) = match on {
            Engine::Slurm => (
                ["sbatch", "--parsable", "--wait"].map(String::from).into(),
                None,
            ),
            Engine::Hyperqueue => (self.hyperqueue(), Some("sh".to_owned())),
            Engine::Local => return vec!["sh".into(), script],
        };
        words
            .into_iter()
            .chain([array])
            .chain(shell)
            .chain([script])
            .collect()
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
        words.extend(
            time_limit
                .iter()
                .map(|limit| format!("--time-limit={}s", limit.as_secs())),
        );
        words.extend((!requeue).then(|| "--crash-limit=1".to_owned()));
        words.extend(["stdout", "stderr"].map(|which| format!("--{which}={log}")));
        words
    }

    /// What ends a job that was submitted.
    pub fn cancel(on: Engine, job: &str) -> Option<Vec<String>> {
        match on {
            Engine::Slurm => Some(["scancel", job].map(String::from).into()),
            Engine::Hyperqueue => Some(["hq", "job", "cancel", job].map(String::from).into()),
            Engine::Local => None,
        }
    }

    /// The shards that have one of some chunks.
    pub fn shards_of(&self, campaign: &Campaign, chunks: &[u64]) -> Vec<u64> {
        let has = |shard: &u64| {
            campaign
                .shard(*shard, self.shards)
                .any(|chunk| chunks.binary_search(&chunk).is_ok())
        };
        (1..=self.shards).filter(has).collect()
    }
}

/// A path as a word of the shell.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', r"'\''"))
}
