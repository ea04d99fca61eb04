//! The array job of a campaign: its script, and the commands that submit and cancel it.

use std::path::{Path, PathBuf, absolute};

use campaign::campaign::{Campaign, Submission};
use errors::{Failure, InFile as _};

use super::flight_settings::Plan;
use crate::cli::{CampaignSubmitArgs, Engine};
use host::own_executable;

/// Shards where nobody says how many: Slurm takes no more than 1000 in an array, unless it is told to.
const SHARDS: u64 = 1000;

pub(super) struct Array {
    name: String,
    pub shards: u64,
    executable: PathBuf,
    file: PathBuf,
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

    pub fn script_file(&self) -> PathBuf {
        self.out.join("submit.sh")
    }

    /// What submits some shards, prints the number of the job, and waits for its end.
    pub fn command(&self, on: Engine, shards: &[u64]) -> Vec<String> {
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

    pub fn cancel(on: Engine, job: &str) -> Option<Vec<String>> {
        match on {
            Engine::Slurm => Some(["scancel", job].map(String::from).into()),
            Engine::Hyperqueue => Some(["hq", "job", "cancel", job].map(String::from).into()),
            Engine::Local => None,
        }
    }

    pub fn shards_of(&self, campaign: &Campaign, chunks: &[u64]) -> Vec<u64> {
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
