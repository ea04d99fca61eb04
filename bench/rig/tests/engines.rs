//! Campaigns on real engines, Slurm and HyperQueue, on this machine alone: shards, nodes and servers are killed, and the rows are the same.

use crate::rig;

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::rig::{Rig, Running, lacks_tool, wait_until};
use rustix::process::{Pid, Signal, kill_process};

/// Twelve shards that take long enough to be killed, and no longer.
const CAMPAIGN: &str = r#"
[campaign]
name = "shards"
flights = 48
chunk = 4

[flight]
trajectory = "fast"
duration_s = 2.0

[factors]
"plant.mass_kg" = { uniform = [0.4, 0.7] }

[arms.adaptive]
"inner.law" = "adaptive"
[arms.fixed]
"inner.law" = "fixed"

[success]
position_error_max_m = 0.5

[submit]
time_limit_s = 600
processors = 1
"#;

/// A script of the repository that brings an engine up.
fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../campaign/engines")
        .join(name)
}

/// The files of rows of a directory, by name.
fn chunks(directory: &str) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(directory)
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path());
    let chunks = files.filter(|path| path.extension().is_some_and(|ending| ending == "parquet"));
    chunks
        .map(|path| {
            (
                path.file_name().unwrap().to_str().unwrap().to_owned(),
                fs::read(&path).unwrap(),
            )
        })
        .collect()
}

/// What the campaign's rows are, flown in one process and by no engine.
fn expected(rig: &Rig) -> BTreeMap<String, Vec<u8>> {
    let (file, out) = (rig.settings(CAMPAIGN), rig.file("expected"));
    rig.ok(&format!("campaign run {file} --out {out} --jobs 2"));
    rig.ok(&format!("campaign merge {out}"));
    chunks(&out)
}

/// Merges a directory, and holds every file against what is expected.
fn assert_same(rig: &Rig, out: &str) {
    rig.ok(&format!("campaign status {out}"));
    rig.ok(&format!("campaign merge {out}"));
    assert_eq!(
        chunks(out),
        expected(rig),
        "every file of rows, and merged.parquet"
    );
}

/// `campaign submit` with an engine's commands in its reach.
fn submit(rig: &Rig, engine: &str, out: &str, environment: &[(&str, String)]) -> Running {
    let file = rig.settings(CAMPAIGN);
    let mut command = rig.command(
        "campaign",
        format!("submit {file} --on {engine} --out {out}"),
    );
    command.envs(
        environment
            .iter()
            .map(|(name, value)| (*name, value.as_str())),
    );
    rig.launch(command)
}

/// The process of a shard that flies into a directory.
fn shard(out: &str) -> Option<Pid> {
    fs::read_dir("/proc").unwrap().find_map(|entry| {
        let entry = entry.ok()?;
        let pid: i32 = entry.file_name().to_str()?.parse().ok()?;
        let line = fs::read_to_string(entry.path().join("cmdline")).ok()?;
        let words: Vec<&str> = line.split('\0').collect();
        // Engines and shells have the same words behind their own.
        (words[0].ends_with("ironbird")
            && words.contains(&"run")
            && words.contains(&out)
            && words.contains(&"--shard"))
        .then(|| Pid::from_raw(pid))?
    })
}

/// Slurm in a directory of its own, for one test.
struct Slurm(PathBuf);

impl Slurm {
    /// Nothing where it is not installed, or may not be started.
    fn start(rig: &Rig) -> Option<Self> {
        let is_there = |tool: &str| {
            ["/usr/sbin", "/usr/bin", "/sbin"]
                .iter()
                .any(|directory| Path::new(directory).join(tool).exists())
        };
        let missing: Vec<&str> = ["munged", "slurmctld", "slurmd", "sbatch"]
            .into_iter()
            .filter(|tool| !is_there(tool))
            .collect();
        let is_root = rustix::process::geteuid().is_root();
        if !missing.is_empty() || !is_root {
            let why = if is_root {
                missing.join(", ") + " not installed"
            } else {
                "only root starts it".into()
            };
            lacks_tool(&format!(
                "campaigns are not flown on Slurm: {why}: apt-get install slurm-wlm munge"
            ));
            return None;
        }
        let slurm = Self(rig.path("slurm"));
        slurm.does("start");
        Some(slurm)
    }

    fn does(&self, what: &str) {
        let done = Command::new(script("slurm"))
            .arg(what)
            .arg(&self.0)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        assert!(
            done.status.success(),
            "{what}: {}",
            String::from_utf8_lossy(&done.stderr)
        );
    }

    fn environment(&self) -> [(&'static str, String); 1] {
        [(
            "SLURM_CONF",
            self.0.join("slurm.conf").display().to_string(),
        )]
    }

    /// What a command of Slurm's prints.
    fn says(&self, command: &str, args: &[&str]) -> String {
        let output = Command::new(command)
            .args(args)
            .envs(self.environment())
            .output()
            .unwrap();
        String::from_utf8(output.stdout).unwrap()
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!(
                "{}",
                fs::read_to_string(self.0.join("slurmctld.log")).unwrap_or_default()
            );
        }
        let _ = Command::new(script("slurm"))
            .arg("stop")
            .arg(&self.0)
            .stdin(Stdio::null())
            .output();
    }
}

#[test]
#[ignore = "long: brings Slurm up"]
fn slurm_loses_a_shard_and_its_node_and_the_rows_are_the_same() {
    let rig = Rig::new("slurm");
    let Some(slurm) = Slurm::start(&rig) else {
        return;
    };
    let out = rig.file("rows");
    let mut submitted = submit(&rig, "slurm", &out, &slurm.environment());
    // A shard is killed; then the node's daemon with all that flies there, as by a power cut, and it comes back.
    let killed = wait_until("a shard", || shard(&out));
    let _ = kill_process(killed, Signal::KILL);
    wait_until("a file of rows", || {
        (!chunks(&out).is_empty()).then_some(())
    });
    wait_until("another shard", || shard(&out).filter(|pid| *pid != killed));
    slurm.does("kill");
    slurm.does("node");
    // Slurm takes its time to see what it has lost.
    let until = Instant::now() + Duration::from_secs(300);
    while submitted.is_running() && Instant::now() < until {
        sleep(Duration::from_millis(200));
    }
    let ended = submitted
        .end()
        .expect(0)
        .complains("round 1: 12 of 12 shards: 1-12");
    ended
        .complains("all 12 shards are there")
        .says("shards: 48 flights, each by 2 arms");
    assert_same(&rig, &out);
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

#[test]
#[ignore = "long: brings Slurm up"]
fn who_interrupts_a_submission_ends_its_job_and_slurm_says_no_in_its_words() {
    let rig = Rig::new("cancel");
    let Some(slurm) = Slurm::start(&rig) else {
        return;
    };
    let out = rig.file("rows");
    let submitted = submit(&rig, "slurm", &out, &slurm.environment());
    wait_until("a shard", || shard(&out));
    submitted.signal(Signal::TERM);
    submitted
        .end()
        .expect(130)
        .complains("interrupted")
        .complains("whole files of rows are kept");
    wait_until("no job", || {
        slurm
            .says("squeue", &["--noheader"])
            .trim()
            .is_empty()
            .then_some(())
    });
    assert_eq!(shard(&out), None);
    let elsewhere =
        rig.settings(&CAMPAIGN.replace("time_limit_s = 600", "partition = \"nowhere\""));
    let mut command = rig.command(
        "campaign",
        format!("submit {elsewhere} --on slurm --out {}", rig.file("other")),
    );
    command.envs(slurm.environment());
    let refused = rig.launch(command).end().expect(1);
    refused
        .complains("sbatch took no job")
        .complains("invalid partition specified: nowhere");
    submit(&rig, "slurm", &out, &slurm.environment())
        .end()
        .expect(0);
    assert_same(&rig, &out);
}

/// Where `hq` is; nothing where HyperQueue is not installed.
fn hyperqueue() -> Option<[(&'static str, String); 2]> {
    let named = std::env::var("IRONBIRD_PYTHON")
        .ok()
        .filter(|python| !python.is_empty());
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let has = Command::new(&python)
        .args(["-c", "import hyperqueue"])
        .output()
        .is_ok_and(|it| it.status.success());
    if !has {
        let missing =
            format!("{python} lacks hyperqueue: pip install -r bench/rig/tests/requirements.txt");
        assert!(named.is_none(), "IRONBIRD_PYTHON: {missing}");
        lacks_tool(&format!("campaigns are not flown on HyperQueue: {missing}"));
        return None;
    }
    let directories = [
        script("hq").parent().unwrap().to_owned(),
        Path::new(&python).parent().unwrap().to_owned(),
    ];
    let directories = directories
        .iter()
        .map(|directory| directory.display().to_string())
        .collect::<Vec<_>>()
        .join(":");
    Some([
        (
            "PATH",
            format!("{directories}:{}", std::env::var("PATH").unwrap()),
        ),
        ("HQ_CPUS", "2".into()),
    ])
}

#[test]
fn hyperqueue_loses_a_shard_and_then_all_and_the_rows_are_the_same() {
    let rig = Rig::new("hq");
    let Some(environment) = hyperqueue() else {
        return;
    };
    let out = rig.file("rows");
    // All of it ends: server, worker and shards.
    let submitted = submit(&rig, "hyperqueue", &out, &environment);
    wait_until("a file of rows", || {
        (!chunks(&out).is_empty()).then_some(())
    });
    submitted.signal(Signal::TERM);
    submitted.end().expect(130).complains("interrupted");
    wait_until("no shard", || shard(&out).is_none().then_some(()));
    // A shard is killed, mostly in flight: the next round flies it.
    let submitted = submit(&rig, "hyperqueue", &out, &environment);
    let _ = kill_process(wait_until("a shard", || shard(&out)), Signal::KILL);
    submitted
        .end()
        .expect(0)
        .says("shards: 48 flights, each by 2 arms");
    assert_same(&rig, &out);
}

#[test]
fn an_engine_that_ignores_sigterm_does_not_keep_an_interrupted_submission_from_ending() {
    let rig = Rig::new("stubborn");
    let sbatch = rig.path("sbatch");
    fs::write(
        &sbatch,
        "#!/bin/sh\ntrap '' TERM\necho $$ >engine.pid\nexec sleep 600\n",
    )
    .unwrap();
    fs::set_permissions(&sbatch, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", rig.file(""), std::env::var("PATH").unwrap());
    let submitted = submit(&rig, "slurm", &rig.file("rows"), &[("PATH", path)]);
    let pid = wait_until("the engine", || {
        let pid = fs::read_to_string(rig.path("engine.pid")).ok()?;
        pid.trim().parse().ok().and_then(Pid::from_raw)
    });
    submitted.signal(Signal::TERM);
    submitted.end().expect(130).complains("interrupted");
    assert!(
        rustix::process::test_kill_process(pid).is_err(),
        "the engine's command was killed"
    );
}

#[test]
fn a_directory_with_a_line_break_in_its_name_is_refused_before_a_script_is_written() {
    let rig = Rig::new("line-break");
    let out = rig.file("rows\ntouch planted #");
    let file = rig.settings(CAMPAIGN);
    rig.run(
        "campaign",
        ["submit", &file, "--on", "slurm", "--dry-run", "--out", &out],
    )
    .expect(2)
    .complains("the path contains a line break");
}

#[test]
fn a_shard_that_flies_twice_at_once_leaves_the_same_rows() {
    let rig = Rig::new("twice");
    let (file, out) = (rig.settings(CAMPAIGN), rig.file("rows"));
    let both: Vec<Running> = (0..2)
        .map(|_| {
            rig.start(
                "campaign",
                format!("run {file} --out {out} --shard 1/1 --jobs 1"),
            )
        })
        .collect();
    both.into_iter().for_each(|running| {
        running.end().expect(0).says("RESULT status=COMPLETE");
    });
    assert_same(&rig, &out);
}

#[test]
fn a_full_disk_is_told_and_leaves_nothing_that_is_not_whole() {
    let rig = Rig::new("full");
    let (file, out) = (rig.settings(CAMPAIGN), rig.file("rows"));
    rig.ok(&format!("campaign run {file} --out {out} --shard 1/12"));
    // No file may be longer than what the campaign's own description takes: a file of rows does not fit.
    let limited = r#"ulimit -f 2; trap '' XFSZ; exec "$0" "$@""#;
    let mut command = Command::new("bash");
    command.args([
        "-c",
        limited,
        rig::IRONBIRD,
        "campaign",
        "run",
        &file,
        "--out",
        &out,
        "--jobs",
        "1",
    ]);
    let full = rig.launch(command).end().expect(1);
    full.complains("cannot write ").complains("chunk-0000001.");
    assert_eq!(chunks(&out).len(), 1);
    let rests: Vec<String> = fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert!(
        rests.iter().all(|name| !name.contains("aside")),
        "{rests:?}"
    );
    rig.ok(&format!("campaign run {file} --out {out}"));
    assert_same(&rig, &out);
}

#[test]
fn rows_of_another_build_are_named_and_flown_again() {
    let rig = Rig::with_features("builds");
    let (file, out) = (rig.settings(CAMPAIGN), rig.file("rows"));
    rig.ok(&format!("campaign run {file} --out {out} --shard 1/2"));
    // The same executable with other words in the place of its version and commit: to the rows, another build.
    let facts: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(Path::new(&out).join("campaign.json")).unwrap())
            .unwrap();
    let build = facts["build"].as_str().unwrap();
    let commit = build.split(' ').nth(1).unwrap().split('-').next().unwrap();
    let other = rig.path("ironbird");
    let mut bytes = fs::read(rig::BUILT_WITH_TESTS).unwrap();
    let places: Vec<usize> = find(&bytes, commit.as_bytes());
    assert!(!places.is_empty(), "{commit} is in the executable");
    for place in places {
        bytes[place..place + commit.len()].fill(b'0');
    }
    fs::write(rig.path("other"), bytes).unwrap();
    // A process that this one starts meanwhile must not hold it open to write.
    let made = Command::new("install")
        .args(["-m", "755"])
        .arg(rig.path("other"))
        .arg(&other)
        .status()
        .unwrap();
    assert!(made.success());
    let mut command = Command::new(&other);
    command.args(["campaign", "run", &file, "--out", &out, "--shard", "1/2"]);
    let mixed = rig.launch(command).end().expect(0);
    mixed
        .complains(&format!("another build flew it: {build}; flying it again"))
        .says("flown=48");
    let status = rig.run("campaign", format!("status {out}")).expect(3);
    status
        .says("0 of 48 flights")
        .says("another build flew it: ");
    rig.run("campaign", format!("merge {out}"))
        .expect(1)
        .complains("nothing to merge yet");
    rig.ok(&format!("campaign run {file} --out {out}"));
    assert_same(&rig, &out);
}

/// Where some bytes are in others.
fn find(bytes: &[u8], what: &[u8]) -> Vec<usize> {
    (0..bytes.len().saturating_sub(what.len()))
        .filter(|place| bytes[*place..].starts_with(what))
        .collect()
}
