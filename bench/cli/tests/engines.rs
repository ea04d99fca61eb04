//! Campaigns on real engines, Slurm and HyperQueue, on this machine alone: shards, nodes and servers are killed, and the rows are the same.

use crate::c_laws::root;
use crate::campaign::chunks;
use crate::python::python_with;
use crate::rig::{Rig, Running, command_line, lacks_tool, processes, wait_until};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

const CAMPAIGN: &str = include_str!("campaigns/shards.toml");

fn script(name: &str) -> PathBuf {
    root().join("bench/campaign/engines").join(name)
}

/// Merges a directory: every file of rows, and merged.parquet, is as if flown in one process and by no engine.
fn assert_same(rig: &Rig, out: &str) {
    rig.ok(&format!("campaign status {out}"));
    rig.ok(&format!("campaign merge {out}"));
    let (file, expected) = (rig.settings(CAMPAIGN), rig.file("expected"));
    rig.ok(&format!("campaign run {file} --out {expected} --jobs 2"));
    rig.ok(&format!("campaign merge {expected}"));
    assert_eq!(chunks(out), chunks(&expected));
}

/// `campaign submit` of a text, with an engine's environment.
fn submit(
    rig: &Rig,
    text: &str,
    engine: &str,
    out: &str,
    environment: &[(&str, String)],
) -> Running {
    let file = rig.settings(text);
    let line = format!("submit {file} --on {engine} --out {out}");
    let mut command = rig.command("campaign", line);
    command.envs(environment.iter().map(|(name, value)| (name, value)));
    rig.launch(command)
}

fn await_rows(out: &str) {
    wait_until("a file of rows", || (!chunks(out).is_empty()).then_some(()));
}

/// The process of a shard that flies into a directory.
fn shard(out: &str) -> Option<Pid> {
    let shard = processes().find(|pid| {
        let words = command_line(*pid);
        let has = |word: &&str| words.iter().any(|it| it == word);
        // Engines and shells have the same words behind their own.
        words[0].ends_with("ironbird") && ["run", out, "--shard"].iter().all(has)
    });
    Pid::from_raw(shard?.cast_signed())
}

/// Slurm in a directory of its own, for one test.
struct Slurm(PathBuf);

impl Slurm {
    /// Nothing where it is not installed, or may not be started.
    fn start(rig: &Rig) -> Option<Self> {
        let directories = ["/usr/sbin", "/usr/bin", "/sbin"].map(Path::new);
        let is_missing = |tool: &&str| !directories.iter().any(|it| it.join(tool).exists());
        let tools = ["munged", "slurmctld", "slurmd", "sbatch"];
        let missing: Vec<&str> = tools.into_iter().filter(is_missing).collect();
        if !missing.is_empty() || !rustix::process::geteuid().is_root() {
            lacks_tool(&format!(
                "campaigns are not flown on Slurm: not installed: {missing:?}, or not root: apt-get install slurm-wlm munge"
            ));
            return None;
        }
        let slurm = Self(rig.path("slurm"));
        slurm.does("start");
        Some(slurm)
    }

    fn does(&self, what: &str) {
        let mut command = Command::new(script("slurm"));
        let done = command
            .arg(what)
            .arg(&self.0)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success() || what == "stop", "{what}: {stderr}");
    }

    fn environment(&self) -> [(&'static str, String); 1] {
        let config = self.0.join("slurm.conf");
        [("SLURM_CONF", config.display().to_string())]
    }

    fn jobs(&self) -> String {
        let mut command = Command::new("squeue");
        let command = command.arg("--noheader").envs(self.environment());
        String::from_utf8(command.output().unwrap().stdout).unwrap()
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let log = fs::read_to_string(self.0.join("slurmctld.log"));
            eprintln!("{}", log.unwrap_or_default());
        }
        self.does("stop");
    }
}

#[test]
#[ignore = "long: brings Slurm up"]
fn slurm_is_interrupted_refuses_and_loses_a_shard_and_its_node_and_the_rows_are_the_same() {
    let rig = Rig::new("slurm");
    let Some(slurm) = Slurm::start(&rig) else {
        return;
    };
    who_interrupts_a_submission_ends_its_job_and_slurm_says_no_in_its_words(&rig, &slurm);
    loses_a_shard_and_its_node_and_the_rows_are_the_same(&rig, &slurm);
}

fn who_interrupts_a_submission_ends_its_job_and_slurm_says_no_in_its_words(
    rig: &Rig,
    slurm: &Slurm,
) {
    let out = rig.file("rows");
    let submitted = submit(rig, CAMPAIGN, "slurm", &out, &slurm.environment());
    wait_until("a shard", || shard(&out));
    submitted.signal(Signal::TERM);
    submitted
        .end()
        .expect(130)
        .complains("interrupted")
        .complains("whole files of rows are kept");
    wait_until("no job", || slurm.jobs().trim().is_empty().then_some(()));
    assert_eq!(shard(&out), None);
    let elsewhere = CAMPAIGN.replace("time_limit_s = 600", "partition = \"nowhere\"");
    let refused = submit(
        rig,
        &elsewhere,
        "slurm",
        &rig.file("other"),
        &slurm.environment(),
    );
    refused
        .end()
        .expect(1)
        .complains("sbatch took no job")
        .complains("invalid partition specified: nowhere");
    submit(rig, CAMPAIGN, "slurm", &out, &slurm.environment())
        .end()
        .expect(0);
    assert_same(rig, &out);
}

/// A shard is killed; then the node's daemon with all that flies there, as by a power cut, and it comes back.
fn loses_a_shard_and_its_node_and_the_rows_are_the_same(rig: &Rig, slurm: &Slurm) {
    let out = rig.file("lost");
    let mut submitted = submit(rig, CAMPAIGN, "slurm", &out, &slurm.environment());
    let killed = wait_until("a shard", || shard(&out));
    let _ = kill_process(killed, Signal::KILL);
    await_rows(&out);
    wait_until("another shard", || shard(&out).filter(|pid| *pid != killed));
    slurm.does("kill");
    slurm.does("node");
    // Slurm takes its time to see what it has lost.
    let until = Instant::now() + Duration::from_secs(300);
    while submitted.is_running() && Instant::now() < until {
        sleep(Duration::from_millis(200));
    }
    submitted
        .end()
        .expect(0)
        .complains("round 1: 12 of 12 shards: 1-12")
        .complains("all 12 shards are there")
        .says("shards: 48 flights, each by 2 arms");
    assert_same(rig, &out);
    let script = fs::read_to_string(Path::new(&out).join("submit.sh")).unwrap();
    for asked in [
        "--time=10",
        "--cpus-per-task=1",
        "--requeue",
        "--job-name=ironbird-shards",
    ] {
        assert!(script.contains(&format!("#SBATCH {asked}\n")), "{script}");
    }
}

/// The environment with `hq`; nothing where HyperQueue is not installed.
fn hyperqueue() -> Option<[(&'static str, String); 2]> {
    let python = python_with("hyperqueue", "campaigns are not flown on HyperQueue")?;
    let engines = script("");
    let beside = Path::new(&python).parent().unwrap();
    let path = std::env::var("PATH").unwrap();
    let path = format!("{}:{}:{path}", engines.display(), beside.display());
    Some([("PATH", path), ("HQ_CPUS", "2".into())])
}

#[test]
fn hyperqueue_loses_a_shard_and_then_all_and_the_rows_are_the_same() {
    let rig = Rig::new("hq");
    let Some(environment) = hyperqueue() else {
        return;
    };
    let out = rig.file("rows");
    // All of it ends: server, worker and shards.
    let submitted = submit(&rig, CAMPAIGN, "hyperqueue", &out, &environment);
    await_rows(&out);
    submitted.signal(Signal::TERM);
    submitted.end().expect(130).complains("interrupted");
    wait_until("no shard", || shard(&out).is_none().then_some(()));
    // A shard is killed, mostly in flight: the next round flies it.
    let submitted = submit(&rig, CAMPAIGN, "hyperqueue", &out, &environment);
    let _ = kill_process(wait_until("a shard", || shard(&out)), Signal::KILL);
    submitted
        .end()
        .expect(0)
        .says("shards: 48 flights, each by 2 arms");
    assert_same(&rig, &out);
}
