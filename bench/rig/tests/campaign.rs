//! Campaigns: rows that are the flights of `simulate`, how they end, and flights of them flown again.

use crate::rig::{self, Rig, lacks_tool, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A small campaign of all ways to draw: two arms, six files of rows.
const SMALL: &str = r#"
[campaign]
name = "small"
flights = 23
seed = 7
chunk = 4

[flight]
trajectory = "fast"
duration_s = 1.5

[plant]
gyro_noise_rad_s = 0.01

[factors]
"plant.mass_kg" = { uniform = [0.4, 0.7] }
"plant.rotational_drag_nm_s" = { loguniform = [0.01, 0.5] }
"plant.inertia_x_kg_m2" = { normal = [0.007, 0.002], within = [0.004, 0.01] }
"plant.inertia_y_kg_m2" = { latin = [0.004, 0.01] }
"plant.arm_length_m" = { sobol = [0.18, 0.22] }
"plant.thrust_coefficient_n_s2" = { sobol = [2.8e-5, 3.4e-5] }
"flight.trajectory" = { choice = ["fast", "lissajous", "hover"] }
"plant.motor_time_constant_s" = { grid = [0.0, 0.01, 0.02] }
"inner.alpha_1_s" = { grid = [20.0, 25.0] }
"plant.command_delay_s" = 0.001

[[fault]]
what = { choice = ["rotor_efficiency_1", "rotor_efficiency_3"] }
value = { uniform = [0.7, 1.0] }
at_s = { uniform = [0.2, 0.6] }
over_s = 0.1

[[fault]]
what = "mass_kg"
value = "+10%"
at_s = 1

[arms.adaptive]
"inner.law" = "adaptive"
"outer.law" = "estimating"
[arms.fixed]
inner.law = "fixed"

[success]
position_error_max_m = 0.4
recovery_max_s = 1.0
recovered_below_m = 0.3
[success.telemetry]
"inner.rotational_drag_nm_s" = [0.0, 0.4]
"#;

fn ours(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path)
}

fn campaign(rig: &Rig, args: &[&str]) -> rig::Ended {
    rig.run("campaign", args)
}

/// Flies a file into a directory of the rig, and gives that.
fn flown(rig: &Rig, text: &str, directory: &str, args: &[&str]) -> String {
    let (file, out) = (rig.settings(text), rig.file(directory));
    campaign(
        rig,
        &[&["run", file.as_str(), "--out", &out][..], args].concat(),
    )
    .expect(0);
    out
}

/// The files of rows of a directory, by name.
fn chunks(directory: &str) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(directory)
        .unwrap()
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

#[test]
fn rows_are_the_same_bytes_from_one_shard_and_from_many() {
    let rig = Rig::new("shards");
    let whole = flown(&rig, SMALL, "whole", &["--jobs", "1"]);
    assert_eq!(chunks(&whole).len(), 6);
    for shard in ["3/5", "1/5", "5/5", "4/5", "2/5"] {
        flown(&rig, SMALL, "parts", &["--shard", shard, "--jobs", "3"]);
    }
    let parts = rig.file("parts");
    assert_eq!(chunks(&whole), chunks(&parts));
    let warned = campaign(&rig, &["run", &rig.settings(SMALL), "--out", &whole]).expect(0);
    assert_eq!(
        warned.stderr.contains("uncommitted changes"),
        ironbird::build::here().dirty,
        "{warned}"
    );
    campaign(&rig, &["merge", &whole]).expect(0).says("46 rows");
    campaign(&rig, &["merge", &parts]).expect(0);
    let merged = |directory: &str| fs::read(Path::new(directory).join("merged.parquet")).unwrap();
    assert_eq!(merged(&whole), merged(&parts));
    // Again is harmless, and a longer campaign keeps what is there, but for the chunk that was not full.
    let again = campaign(&rig, &["run", &rig.settings(SMALL), "--out", &parts])
        .expect(0)
        .result();
    assert_eq!(
        (again["flown"].as_str(), again["kept"].as_str()),
        ("0", "46")
    );
    let longer = SMALL
        .replace("flights = 23", "flights = 30")
        .replace("latin", "uniform");
    let shorter = SMALL.replace("latin", "uniform");
    let grown = flown(&rig, &shorter, "grown", &[]);
    let before = chunks(&grown);
    let again = campaign(&rig, &["run", &rig.settings(&longer), "--out", &grown]).expect(0);
    let again = again
        .complains("it has the flights 20..23, and not 20..24; flying it again")
        .result();
    assert_eq!(
        (again["flown"].as_str(), again["kept"].as_str()),
        ("20", "40")
    );
    let after = chunks(&grown);
    assert!(
        before
            .iter()
            .filter(|(name, _)| *name != "chunk-0000005.parquet")
            .all(|(name, rows)| after[name] == *rows)
    );
    assert_eq!(chunks(&flown(&rig, &longer, "long", &[])), after);
}

#[test]
fn a_row_is_a_simulated_flight_bit_for_bit() {
    let rig = Rig::new("rows");
    let out = flown(&rig, SMALL, "rows", &[]);
    let report = campaign(&rig, &["report", &out, "--format", "json"])
        .expect(0)
        .json();
    let worst = report["worst"].as_array().unwrap();
    assert_eq!(worst.len(), 10);
    let mut outputs = Vec::new();
    for flight in [0, 5, 14, 22] {
        for arm in ["adaptive", "fixed"] {
            let number = flight.to_string();
            let settings = campaign(
                &rig,
                &["fly", &out, &number, "--arm", arm, "--print-config"],
            )
            .expect(0)
            .stdout
            .replace("lockstep", "realtime");
            let simulated = rig.run("simulate", format!("--config {}", rig.settings(&settings)));
            let simulated = simulated.result()["outputs"].clone();
            assert_eq!(
                row(&out, flight, arm == "fixed"),
                simulated,
                "flight {flight} by {arm}"
            );
            outputs.push(simulated);
        }
    }
    outputs.sort();
    outputs.dedup();
    assert_eq!(
        outputs.len(),
        8,
        "eight flights, and not one of them eight times"
    );
}

fn row(directory: &str, flight: u64, second_arm: bool) -> String {
    let text = fs::read_to_string(Path::new(directory).join("campaign.toml")).unwrap();
    let campaign = campaign::file::read(&text).unwrap();
    let rows = campaign::chunk::Rows::new(Path::new(directory), 0..campaign.chunks());
    let row = rows
        .row(&campaign, flight, usize::from(second_arm))
        .unwrap()
        .unwrap();
    row.into_iter()
        .find(|(column, _)| column == "outputs")
        .unwrap()
        .1
}

#[test]
fn what_is_killed_broken_or_foreign_is_named_and_flown_again() {
    let rig = Rig::new("broken");
    let long = SMALL.replace("flights = 23", "flights = 400");
    let file = rig.settings(&long);
    let out = rig.file("rows");
    let running = rig.start("campaign", format!("run {file} --out {out} --jobs 1"));
    wait_until("two files of rows", || {
        (Path::new(&out).is_dir() && chunks(&out).len() >= 2).then_some(())
    });
    running.signal(Signal::KILL);
    assert_eq!(running.end().code, None);
    campaign(&rig, &["status", &out])
        .expect(3)
        .says("missing: chunks");
    campaign(&rig, &["merge", &out])
        .expect(1)
        .complains("so that there is nothing to merge yet");

    let small = flown(&rig, SMALL, "small", &[]);
    let whole = chunks(&small);
    let of = |chunk: u64| Path::new(&small).join(format!("chunk-000000{chunk}.parquet"));
    fs::write(of(0), &whole["chunk-0000000.parquet"][..900]).unwrap();
    let mut flipped = whole["chunk-0000001.parquet"].clone();
    flipped[700] ^= 4;
    fs::write(of(1), flipped).unwrap();
    fs::copy(Path::new(&out).join("chunk-0000000.parquet"), of(2)).unwrap();
    fs::copy(of(4), of(3)).unwrap();
    fs::remove_file(of(5)).unwrap();
    let status = campaign(&rig, &["status", &small]).expect(3);
    let status = status
        .says("4 of 23 flights, each by 2 arms; 1 of 6 files are whole")
        .says("missing: chunks 5");
    for said in [
        "chunk-0000000.parquet: it is broken: ",
        "chunk-0000001.parquet: it is broken: ",
    ] {
        assert!(status.stdout.contains(said), "{status}");
    }
    let status = status
        .tells("chunk-0000002.parquet: it is foreign: of the campaign small with the fingerprint ");
    status.tells("chunk-0000003.parquet: it has the flights 16..20, and not 12..16");
    let again = campaign(&rig, &["run", &rig.settings(SMALL), "--out", &small]).expect(0);
    let again = again.complains("flying it again").result();
    assert_eq!(
        (again["flown"].as_str(), again["kept"].as_str()),
        ("38", "8")
    );
    assert_eq!(chunks(&small), whole);
    campaign(&rig, &["status", &small]).expect(0);

    let other = SMALL.replace("seed = 7", "seed = 8");
    let refused = campaign(&rig, &["run", &rig.settings(&other), "--out", &small]).expect(2);
    refused.complains(
        "holds another campaign: the file has changed in more than its number of flights",
    );
    campaign(&rig, &["status", &rig.file("nowhere")])
        .expect(2)
        .complains("cannot read the campaign's directory");
}

#[test]
fn a_signal_ends_a_campaign_and_keeps_its_whole_files() {
    let rig = Rig::new("signal");
    let long = SMALL
        .replace("flights = 23", "flights = 4000")
        .replace("duration_s = 1.5", "duration_s = 60.0");
    for (signal, name) in [(Signal::INT, "int"), (Signal::TERM, "term")] {
        let out = rig.file(name);
        let running = rig.start(
            "campaign",
            format!("run {} --out {out} --jobs 2", rig.settings(&long)),
        );
        wait_until("the campaign's directory", || {
            Path::new(&out).join("campaign.json").exists().then_some(())
        });
        running.signal(signal);
        running.end().expect(130).says("RESULT status=INTERRUPTED");
        let rests = fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap());
        assert_eq!(
            rests
                .filter(|name| name.contains("aside"))
                .collect::<Vec<_>>(),
            Vec::<String>::new()
        );
    }
}

#[test]
fn the_documented_campaign_is_checked_and_flown() {
    let rig = Rig::new("example");
    let example = ours("examples/mass-and-drag.toml");
    let check = campaign(&rig, &["check", example.to_str().unwrap()]).expect(0);
    let check = check.says(
        "mass-and-drag: 2000 flights of 10 s by 2 arms (adaptive, fixed), 4000 rows in 2 files",
    );
    check.says("on disk").says("time here");
    let text = fs::read_to_string(&example).unwrap();
    assert!(
        fs::read_to_string(ours("docs/campaigns.md"))
            .unwrap()
            .contains(&indented(&text)),
        "as documented"
    );
    let out = flown(
        &rig,
        &text.replace("flights = 2000 ", "flights = 20 "),
        "rows",
        &[],
    );
    let report = campaign(&rig, &["report", &out, "--page", &rig.file("page.html")]).expect(0);
    let report = report
        .says("mass-and-drag: 20 flights, each by 2 arms")
        .says("Wilson");
    report
        .says("adaptive - fixed: success ")
        .tells("fly one again: ironbird campaign fly");
    let page = fs::read_to_string(rig.path("page.html")).unwrap();
    assert!(
        page.contains("What matters")
            && page.contains("plant.mass_kg")
            && !page.contains("http://"),
        "{page}"
    );
    // The others, with a flight a cell.
    for (example, flights, small, arms) in [
        ("robustness", "flights = 1000", "flights = 3", 6),
        ("lateness", "flights = 900", "flights = 9", 5),
    ] {
        let file = ours(&format!("examples/{example}.toml"));
        campaign(&rig, &["check", file.to_str().unwrap()])
            .expect(0)
            .says(&format!("by {arms} arms"));
        let text = fs::read_to_string(file).unwrap();
        assert!(text.contains(flights), "{text}");
        let out = flown(&rig, &text.replace(flights, small), example, &[]);
        campaign(&rig, &["report", &out])
            .expect(0)
            .says(&format!("each by {arms} arms"));
    }
}

/// As a document has a file.
fn indented(text: &str) -> String {
    text.lines()
        .map(|line| {
            if line.is_empty() {
                "\n".into()
            } else {
                format!("    {line}\n")
            }
        })
        .collect()
}

#[test]
fn the_worst_flight_flies_again_in_four_processes_as_in_its_row() {
    let rig = Rig::new("again");
    let out = flown(&rig, SMALL, "rows", &[]);
    let report = campaign(&rig, &["report", &out, "--format", "json"])
        .expect(0)
        .json();
    let worst = &report["worst"][0];
    let (flight, arm) = (worst["flight"].to_string(), worst["arm"].as_str().unwrap());
    let runs = rig.out();
    let told = format!(
        "--out {} --instance {}",
        runs.to_str().unwrap(),
        rig.instance
    );
    let fly = rig.run(
        "campaign",
        format!("fly {} {flight} --arm {arm} {told}", out),
    );
    fly.expect(0).says(", as in the campaign's row");
    rig.ok("replay --verify").says("identical");
    assert!(rig.out().join("latest/report.html").exists());
    campaign(&rig, &["fly", &out, "23"])
        .expect(2)
        .complains("there is no flight 23");
    let refused = campaign(&rig, &["fly", &out, "0", "--arm", "indi"]).expect(2);
    refused
        .complains("the campaign small has no such arm")
        .complains("its arms are adaptive, fixed");
    rig.assert_nothing_left();
}

#[test]
fn a_shard_is_a_part_of_a_campaign_and_may_be_numbered_by_the_job() {
    let rig = Rig::new("shard");
    let easy =
        "[campaign]\nname = \"easy\"\nflights = 1000\nchunk = 10\n[flight]\nduration_s = 0.2\n";
    let mut task = rig.command(
        "campaign",
        format!(
            "run {} --out {} --shard auto/100",
            rig.settings(easy),
            rig.file("task")
        ),
    );
    task.env("SLURM_ARRAY_TASK_ID", "7");
    rig.launch(task).end().expect(0);
    assert_eq!(
        chunks(&rig.file("task")).keys().collect::<Vec<_>>(),
        ["chunk-0000006.parquet"]
    );
}

/// An engine that is none: it flies the tasks of an array one after the other, and loses one of them the first time.
const ENGINE: &str = r#"#!/bin/sh
echo "$0 $*" >> calls
echo "7;cluster"
for word; do case $word in --array=*) array=${word#--array=};; esac; script=$word; done
case $array in *-*) array=$(seq -s ' ' "${array%-*}" "${array#*-}");; esac
for task in $(echo "$array" | tr , ' '); do
    if [ "$task" = 3 ] && [ ! -e lost ]; then touch lost; failed=1; continue; fi
    SLURM_ARRAY_TASK_ID=$task sh "$script" >> tasks.log 2>&1 || failed=1
done
exit ${failed:-0}
"#;

#[test]
fn an_engine_gets_an_array_and_again_what_it_lost() {
    let rig = Rig::new("engines");
    let (file, out) = (rig.settings(SMALL), rig.file("rows"));
    for (engine, said) in [
        ("slurm", "#SBATCH --requeue"),
        ("hyperqueue", "hq --output-mode=quiet submit --wait"),
        ("local", "#!/bin/sh"),
    ] {
        let dry = [
            "submit",
            file.as_str(),
            "--on",
            engine,
            "--out",
            &out,
            "--shards",
            "4",
            "--dry-run",
        ];
        campaign(&rig, &dry)
            .expect(0)
            .says(said)
            .says("campaign run ");
        assert!(!Path::new(&out).exists(), "a dry run makes nothing");
    }
    let dry = [
        "submit",
        file.as_str(),
        "--on",
        "slurm",
        "--out",
        &out,
        "--shards",
        "99",
        "--dry-run",
    ];
    campaign(&rig, &dry)
        .expect(0)
        .complains("warning: --shards 99: the campaign has ")
        .says("#SBATCH");
    let tools = rig.path("tools");
    fs::create_dir(&tools).unwrap();
    fs::write(tools.join("sbatch"), ENGINE).unwrap();
    fs::set_permissions(tools.join("sbatch"), fs::Permissions::from_mode(0o755)).unwrap();
    let submit = |on: &str| {
        let mut command = rig.command(
            "campaign",
            format!("submit {file} --on {on} --out {out} --shards 4"),
        );
        command.env(
            "PATH",
            format!("{}:{}", tools.display(), std::env::var("PATH").unwrap()),
        );
        rig.launch(command).end()
    };
    let submitted = submit("slurm")
        .expect(0)
        .complains("all 4 shards are there")
        .says("small: 23 flights, each by 2");
    submitted
        .complains("round 1: 4 of 4 shards: 1-4")
        .complains("round 2: 1 of 4 shards: 3");
    let calls = fs::read_to_string(rig.path("calls")).unwrap();
    assert!(
        calls.lines().count() == 2
            && calls.contains("--array=1-4 ")
            && calls.contains("--array=3 "),
        "{calls}"
    );
    assert_eq!(chunks(&out), chunks(&flown(&rig, SMALL, "whole", &[])));
    submit("slurm").expect(0);
    assert_eq!(
        fs::read_to_string(rig.path("calls")).unwrap(),
        calls,
        "where all is there nothing is submitted"
    );
    fs::remove_file(Path::new(&out).join("chunk-0000000.parquet")).unwrap();
    if !Command::new("hq")
        .arg("--version")
        .output()
        .is_ok_and(|output| output.status.success())
    {
        submit("hyperqueue").expect(1).complains("cannot start hq");
    }
}

#[test]
fn public_readers_read_the_rows() {
    let named = std::env::var("IRONBIRD_PYTHON")
        .ok()
        .filter(|python| !python.is_empty());
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let imports = ["-c", "import duckdb, pandas, polars, pyarrow.parquet"];
    if !Command::new(&python)
        .args(imports)
        .output()
        .is_ok_and(|output| output.status.success())
    {
        let missing =
            format!("{python} lacks packages: pip install -r bench/rig/tests/requirements.txt");
        assert!(named.is_none(), "IRONBIRD_PYTHON: {missing}");
        lacks_tool(&format!(
            "rows of campaigns are not read by other implementations: {missing}"
        ));
        return;
    }
    let rig = Rig::new("readers");
    let out = flown(&rig, SMALL, "rows", &[]);
    campaign(&rig, &["merge", &out]).expect(0);
    let script = ours("bench/rig/tests/read_rows.py");
    let read = Command::new(python)
        .arg(script)
        .arg(Path::new(&out).join("merged.parquet"))
        .output()
        .unwrap();
    assert!(
        read.status.success(),
        "{}",
        String::from_utf8_lossy(&read.stderr)
    );
    let read: Value = serde_json::from_slice(&read.stdout).unwrap();
    assert_eq!(
        (&read["unit"], &read["told"]["ironbird.schema"]),
        (&"kg".into(), &"ironbird-campaign/1".into())
    );
    let report = campaign(&rig, &["report", &out, "--format", "json"])
        .expect(0)
        .json();
    let successes: u64 = report["arms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|arm| arm["successes"].as_u64().unwrap())
        .sum();
    for reader in ["duckdb", "polars", "pandas"] {
        assert_eq!(
            (read[reader][0].as_u64(), read[reader][1].as_u64()),
            (Some(46), Some(successes)),
            "{reader}"
        );
        for i in [2, 3] {
            let off = read[reader][i].as_f64().unwrap() / read["duckdb"][i].as_f64().unwrap() - 1.0;
            assert!(off.abs() < 1e-12, "{reader}: {off}");
        }
    }
}

/// Two files of rows: the first is there at once, each flight of the second takes seconds, and all of them a minute.
const LONG: &str = r#"
[campaign]
name = "long"
flights = 40
chunk = 20

[factors]
"flight.duration_s" = { grid = [0.01, 1200.0] }
"plant.mass_kg" = { grid = [
    0.50, 0.51, 0.52, 0.53, 0.54, 0.55, 0.56, 0.57, 0.58, 0.59, 0.50, 0.51, 0.52, 0.53, 0.54, 0.55, 0.56, 0.57, 0.58, 0.59,
] }
"#;

/// No verdict on speed: a campaign that waited for its file of rows would take a minute, on a machine that is not busy.
const AT_ONCE: Duration = Duration::from_secs(5);

#[test]
fn a_signal_ends_a_campaign_in_the_middle_of_a_flight() {
    let rig = Rig::new("at-once");
    let file = rig.settings(LONG);
    for (signal, jobs) in [(Signal::INT, "1"), (Signal::TERM, "2")] {
        let out = rig.file(jobs);
        let mut running = rig.start("campaign", format!("run {file} --out {out} --jobs {jobs}"));
        let first = Path::new(&out).join("chunk-0000000.parquet");
        wait_until("the first file of rows", || first.exists().then_some(()));
        sleep(Duration::from_millis(500));
        assert!(
            running.is_running(),
            "the second takes longer than this: {}",
            running.stderr()
        );
        let asked = Instant::now();
        running.signal(signal);
        let ended = running.end().expect(130);
        let took = asked.elapsed();
        assert!(took < AT_ONCE, "{signal:?}: it took {took:?}");
        eprintln!("{signal:?}, --jobs {jobs}: ended after {took:?}");
        ended.says("RESULT status=INTERRUPTED flown=20 kept=0 chunks=1/2");
        let status = rig.run("campaign", format!("status {out}")).expect(3);
        status
            .says("20 of 40 flights, each by 1 arm; 1 of 2 files are whole")
            .says("missing: chunks 1\n");
        let mut left: Vec<String> = fs::read_dir(&out)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(
            left,
            ["campaign.json", "campaign.toml", "chunk-0000000.parquet"]
        );
    }
}

/// The largest memory that a campaign of so many flights has taken [kB], as far as is seen before its end.
fn memory_kb(rig: &Rig, flights: u64, chunk: u64) -> u64 {
    // Rows with much in them: what is kept of each shows.
    let factors: String = [
        ("mass_kg", [0.45, 0.6]),
        ("inertia_x_kg_m2", [0.006, 0.008]),
        ("inertia_y_kg_m2", [0.006, 0.008]),
        ("inertia_z_kg_m2", [0.012, 0.014]),
        ("arm_length_m", [0.2, 0.22]),
        ("rotational_drag_nm_s", [0.01, 0.5]),
    ]
    .map(|(key, range)| format!("\"plant.{key}\" = {{ uniform = {range:?} }}\n"))
    .concat();
    let text = format!(
        "[campaign]\nname = \"memory\"\nflights = {flights}\nchunk = {chunk}\n[flight]\nduration_s = 0.004\n\
         position_error_max_m = 0.01\n[factors]\n{factors}"
    );
    let out = rig.file(&format!("{flights}-{chunk}"));
    let mut running = rig.start(
        "campaign",
        format!("run {} --out {out} --jobs 1", rig.settings(&text)),
    );
    let status = format!("/proc/{}/status", running.pid());
    let mut largest = 0;
    while running.is_running() {
        let told = fs::read_to_string(&status).unwrap_or_default();
        let told = told.lines().find_map(|line| {
            line.strip_prefix("VmHWM:")?
                .trim()
                .strip_suffix(" kB")?
                .parse()
                .ok()
        });
        largest = largest.max(told.unwrap_or(0));
        sleep(Duration::from_millis(2));
    }
    running
        .end()
        .expect(0)
        .says(&format!("RESULT status=COMPLETE flown={flights} "));
    // So that the next one of this name is flown.
    fs::remove_dir_all(&out).unwrap();
    largest
}

#[test]
fn memory_does_not_grow_with_the_number_of_flights() {
    const MANY: u64 = 16_000;
    /// Less than the rows of the longer one take, were they all kept.
    const GROWTH_MAX_KB: u64 = 2048;
    let rig = Rig::new("memory");
    // Runs of one campaign differ by more than a megabyte.
    let (few, many) = (
        [(); 5]
            .map(|()| memory_kb(&rig, 200, 20))
            .into_iter()
            .fold(0, u64::max),
        memory_kb(&rig, MANY, 20),
    );
    // One file of rows is held until it is whole: so much would all of them take.
    let held = memory_kb(&rig, MANY, MANY);
    eprintln!("200 flights {few} kB, {MANY} flights {many} kB, with all rows held {held} kB");
    assert!(few > 1000, "it was seen: {few} kB");
    assert!(
        many < few + GROWTH_MAX_KB,
        "200 flights took {few} kB, {MANY} flights {many} kB"
    );
    assert!(
        held > few + GROWTH_MAX_KB,
        "the bound tells nothing: 200 flights took {few} kB, all rows {held} kB"
    );
}
