//! Campaigns: rows that are the flights of `simulate`, also with recorded timing; how they end; flights flown again.

use crate::python::{python_with, repository, run_python};
use crate::rig::{Ended, Rig, stop_for, table, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

const SMALL: &str = include_str!("campaigns/small.toml");
const ENGINE: &str = include_str!("campaigns/sbatch");
const LONG: &str = include_str!("campaigns/long.toml");
const LOST: &str = include_str!("campaigns/lost.toml");

fn campaign(rig: &Rig, line: impl AsRef<str>) -> Ended {
    rig.run("campaign", line.as_ref())
}

/// Flies a campaign into a directory of the rig.
fn run(rig: &Rig, text: &str, directory: &str, options: &str) -> Ended {
    let (file, out) = (rig.settings(text), rig.file(directory));
    campaign(rig, format!("run {file} --out {out} {options}"))
}

/// The same, which must succeed; gives the directory.
fn flown(rig: &Rig, text: &str, directory: &str, options: &str) -> String {
    run(rig, text, directory, options).expect(0);
    rig.file(directory)
}

fn report(rig: &Rig, rows: &str) -> Value {
    let report = campaign(rig, format!("report {rows} --format json"));
    report.expect(0).json()
}

/// Whole files, of rows and merged, by name.
pub fn chunks(directory: &str) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(directory).into_iter().flatten();
    let files = files.map(|entry| entry.unwrap().path());
    let chunks = files.filter(|path| path.extension().is_some_and(|it| it == "parquet"));
    let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    chunks
        .map(|path| (name(&path), fs::read(&path).unwrap()))
        .collect()
}

pub fn chunk(directory: &str, number: u64) -> PathBuf {
    Path::new(directory).join(format!("chunk-{number:07}.parquet"))
}

fn cell(directory: &str, flight: u64, arm: usize, column: &str) -> String {
    let text = fs::read_to_string(Path::new(directory).join("campaign.toml")).unwrap();
    let campaign = campaign::file::read(&text).unwrap();
    let rows = campaign::chunk::Rows::new(Path::new(directory), 0..campaign.chunks());
    let row = rows.row(&campaign, flight, arm).unwrap().unwrap();
    row.into_iter().find(|(name, _)| name == column).unwrap().1
}

/// Flies a flight of a campaign again, into the rig's own directory of runs.
fn fly_again(rig: &Rig, rows: &str, flight: &str, arm: &str) -> Ended {
    let (out, instance) = (rig.file("out"), &rig.instance);
    let line = format!("fly {rows} {flight} --arm {arm} --out {out} --instance {instance}");
    campaign(rig, line)
}

#[track_caller]
fn assert_flown(ended: &Ended, flown: &str, kept: &str) {
    let result = ended.result();
    assert_eq!(
        (&*result["flown"], &*result["kept"]),
        (flown, kept),
        "{ended}"
    );
}

#[test]
fn rows_are_the_same_bytes_from_one_shard_and_from_many() {
    let rig = Rig::new("shards");
    let whole = flown(&rig, SMALL, "whole", "--jobs 1");
    assert_eq!(chunks(&whole).len(), 6);
    for shard in ["3/5", "1/5", "5/5", "4/5", "2/5"] {
        flown(&rig, SMALL, "parts", &format!("--shard {shard} --jobs 3"));
    }
    let parts = rig.file("parts");
    assert_eq!(chunks(&whole), chunks(&parts));
    let again = run(&rig, SMALL, "whole", "").expect(0);
    let warns = again.stderr.contains("uncommitted changes");
    assert_eq!(warns, ironbird::build::here().dirty, "{again}");
    assert_flown(&again, "0", "46");
    campaign(&rig, format!("merge {whole}"))
        .expect(0)
        .says("46 rows");
    campaign(&rig, format!("merge {parts}")).expect(0);
    assert_eq!(chunks(&whole), chunks(&parts));
    // A longer campaign keeps the rows, but for the chunk that was not full.
    let shorter = SMALL.replace("latin", "uniform");
    let longer = shorter.replace("flights = 23", "flights = 30");
    let grown = flown(&rig, &shorter, "grown", "");
    let before = chunks(&grown);
    let again = run(&rig, &longer, "grown", "").expect(0);
    let again = again.complains("it has the flights 20..23, and not 20..24; flying it again");
    assert_flown(&again, "20", "40");
    let after = chunks(&grown);
    for chunk in 0..5 {
        let name = format!("chunk-{chunk:07}.parquet");
        assert_eq!(before[&name], after[&name]);
    }
    assert_eq!(chunks(&flown(&rig, &longer, "long", "")), after);
    // A shard may be numbered by the job.
    let easy =
        "[campaign]\nname = \"easy\"\nflights = 1000\nchunk = 10\n[flight]\nduration_s = 0.2\n";
    let (file, task) = (rig.settings(easy), rig.file("task"));
    let line = format!("run {file} --out {task} --shard auto/100");
    let mut job = rig.command("campaign", line);
    job.env("SLURM_ARRAY_TASK_ID", "7");
    rig.launch(job).end().expect(0);
    let names: Vec<String> = chunks(&task).into_keys().collect();
    assert_eq!(names, ["chunk-0000006.parquet"]);
}

#[test]
fn a_row_is_a_simulated_flight_bit_for_bit() {
    let rig = Rig::new("rows");
    let out = flown(&rig, SMALL, "rows", "");
    let report = report(&rig, &out);
    assert_eq!(report["worst"].as_array().unwrap().len(), 10);
    let mut outputs = BTreeSet::new();
    for flight in [0, 5, 14, 22] {
        for (i, arm) in ["adaptive", "fixed"].into_iter().enumerate() {
            let line = format!("fly {out} {flight} --arm {arm} --print-config");
            let settings = campaign(&rig, line).expect(0).stdout;
            let settings = rig.settings(&settings.replace("lockstep", "realtime"));
            let simulated = rig.run("simulate", format!("--config {settings}")).result();
            let simulated = &simulated["outputs"];
            assert_eq!(
                cell(&out, flight, i, "outputs"),
                *simulated,
                "{flight} by {arm}"
            );
            outputs.insert(simulated.clone());
        }
    }
    assert_eq!(outputs.len(), 8, "eight different flights");
    // The worst flight flies again in five processes as in its row.
    let worst = &report["worst"][0];
    let arm = worst["arm"].as_str().unwrap();
    let again = fly_again(&rig, &out, &worst["flight"].to_string(), arm).expect(0);
    again.says(", as in the campaign's row");
    rig.ok("replay --verify").says("identical");
    assert!(rig.out().join("latest/report.html").exists());
    let refused = campaign(&rig, format!("fly {out} 23")).expect(2);
    refused.complains("there is no flight 23");
    campaign(&rig, format!("fly {out} 0 --arm indi"))
        .expect(2)
        .complains("the campaign small has no such arm")
        .complains("its arms are adaptive, fixed");
    rig.assert_nothing_left();
    public_readers_read_the_rows(&rig, &out, &report);
}

fn public_readers_read_the_rows(rig: &Rig, rows: &str, report: &Value) {
    campaign(rig, format!("merge {rows}")).expect(0);
    let packages = "duckdb, pandas, polars, pyarrow.parquet";
    let purpose = "rows of campaigns are not read by other implementations";
    let Some(python) = python_with(packages, purpose) else {
        return;
    };
    let merged = Path::new(rows).join("merged.parquet");
    let read = run_python(&python, "bench/rig/tests/read_rows.py", &[&merged]);
    let read: Value = serde_json::from_slice(&read).unwrap();
    assert_eq!(read["unit"], "kg");
    assert_eq!(read["told"]["ironbird.schema"], "ironbird-campaign/1");
    let arms = report["arms"].as_array().unwrap().iter();
    let successes: u64 = arms.map(|arm| arm["successes"].as_u64().unwrap()).sum();
    for reader in ["duckdb", "polars", "pandas"] {
        assert_eq!(
            (&read[reader][0], &read[reader][1]),
            (&46.into(), &successes.into())
        );
        for i in [2, 3] {
            let [sum, other] = [&read[reader], &read["duckdb"]].map(|it| it[i].as_f64().unwrap());
            assert!(
                (sum / other - 1.0).abs() < 1e-12,
                "{reader}: {sum}, {other}"
            );
        }
    }
}

#[test]
fn a_file_that_is_missing_broken_or_foreign_is_named_and_flown_again() {
    let rig = Rig::new("broken");
    let long = rig.settings(&SMALL.replace("flights = 23", "flights = 400"));
    let out = rig.file("rows");
    let running = rig.start("campaign", format!("run {long} --out {out} --jobs 1"));
    wait_until("two files of rows", || {
        (chunks(&out).len() >= 2).then_some(())
    });
    running.signal(Signal::KILL);
    assert_eq!(running.end().code, None);
    let status = campaign(&rig, format!("status {out}")).expect(3);
    status.says("missing: chunks");
    let merged = campaign(&rig, format!("merge {out}")).expect(1);
    merged.complains("so that there is nothing to merge yet");

    let small = flown(&rig, SMALL, "small", "");
    let whole = chunks(&small);
    let mut bytes = whole["chunk-0000001.parquet"].clone();
    fs::write(chunk(&small, 0), &bytes[..900]).unwrap();
    bytes[700] ^= 4;
    fs::write(chunk(&small, 1), bytes).unwrap();
    fs::copy(chunk(&out, 0), chunk(&small, 2)).unwrap();
    fs::copy(chunk(&small, 4), chunk(&small, 3)).unwrap();
    fs::remove_file(chunk(&small, 5)).unwrap();
    campaign(&rig, format!("status {small}"))
        .expect(3)
        .says("4 of 23 flights, each by 2 arms; 1 of 6 files are whole")
        .says("missing: chunks 5")
        .says("chunk-0000000.parquet: it is broken: ")
        .says("chunk-0000001.parquet: it is broken: ")
        .tells("chunk-0000002.parquet: it is foreign: of the campaign small with the fingerprint ")
        .tells("chunk-0000003.parquet: it has the flights 16..20, and not 12..16");
    let again = run(&rig, SMALL, "small", "").expect(0);
    assert_flown(&again.complains("flying it again"), "38", "8");
    assert_eq!(chunks(&small), whole);
    campaign(&rig, format!("status {small}")).expect(0);
    let other = run(&rig, &SMALL.replace("seed = 7", "seed = 8"), "small", "").expect(2);
    other.complains(
        "holds another campaign: the file has changed in more than its number of flights",
    );
    let status = campaign(&rig, format!("status {}", rig.file("nowhere"))).expect(2);
    status.complains("cannot read the campaign's directory");
}

#[test]
fn the_documented_campaigns_are_checked_and_flown() {
    let rig = Rig::new("example");
    let example = |name: &str| repository(&format!("examples/{name}.toml"));
    let text = fs::read_to_string(example("mass-and-drag")).unwrap();
    let lines = text
        .lines()
        .map(|line| format!("    {line}").trim_end().to_owned() + "\n");
    let page = fs::read_to_string(repository("docs/campaigns.md")).unwrap();
    assert!(page.contains(&lines.collect::<String>()), "as documented");
    // Fewer flights are flown than the example has.
    for (name, flights, fewer, arms) in [
        ("mass-and-drag", "flights = 2000 ", "flights = 20 ", 2),
        ("robustness", "flights = 1000", "flights = 3", 6),
        ("lateness", "flights = 900", "flights = 9", 5),
    ] {
        let check = format!("check {}", example(name).display());
        let check = campaign(&rig, check).expect(0);
        let check = check
            .says(&format!("by {arms} arms"))
            .says("on disk")
            .says("time here");
        let text = fs::read_to_string(example(name)).unwrap();
        assert!(text.contains(flights), "{text}");
        let out = flown(&rig, &text.replace(flights, fewer), name, "");
        let page = rig.path("page.html");
        let report = campaign(&rig, format!("report {out} --page {}", page.display())).expect(0);
        let report = report.says(&format!("each by {arms} arms"));
        if name == "mass-and-drag" {
            check.says("2000 flights of 10 s by 2 arms (adaptive, fixed), 4000 rows in 2 files");
            report
                .says("mass-and-drag: 20 flights, each by 2 arms")
                .says("Wilson")
                .says("adaptive - fixed: success ")
                .tells("fly one again: ironbird campaign fly");
            let page = fs::read_to_string(page).unwrap();
            let has = |words: &str| page.contains(words);
            assert!(
                has("What matters") && has("plant.mass_kg") && !has("http://"),
                "{page}"
            );
        }
    }
}

#[test]
fn an_engine_gets_an_array_and_again_what_it_lost() {
    let rig = Rig::new("engines");
    let (file, out) = (rig.settings(SMALL), rig.file("rows"));
    let submit = format!("submit {file} --out {out}");
    for (options, said) in [
        ("--on slurm --shards 4", "#SBATCH --requeue"),
        (
            "--on hyperqueue --shards 4",
            "hq --output-mode=quiet submit --wait",
        ),
        ("--on local --shards 4", "#!/bin/sh"),
        ("--on slurm --shards 99", "#SBATCH"),
    ] {
        let dry = campaign(&rig, format!("{submit} {options} --dry-run")).expect(0);
        let dry = dry.says(said).says("campaign run ");
        let warning = "warning: --shards 99: the campaign has ";
        assert_eq!(
            dry.stderr.contains(warning),
            options.ends_with("99"),
            "{dry}"
        );
        assert!(!Path::new(&out).exists(), "a dry run makes nothing");
    }
    let tools = rig.path("tools");
    fs::create_dir(&tools).unwrap();
    fs::write(tools.join("sbatch"), ENGINE).unwrap();
    fs::set_permissions(tools.join("sbatch"), fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", tools.display(), std::env::var("PATH").unwrap());
    let submit = |engine: &str| {
        let mut command = rig.command("campaign", format!("{submit} --on {engine} --shards 4"));
        command.env("PATH", &path);
        rig.launch(command).end()
    };
    submit("slurm")
        .expect(0)
        .complains("all 4 shards are there")
        .complains("round 1: 4 of 4 shards: 1-4")
        .complains("round 2: 1 of 4 shards: 3")
        .says("small: 23 flights, each by 2");
    let calls = || fs::read_to_string(rig.path("calls")).unwrap();
    let array = |call: &str| {
        call.split(' ')
            .find(|word| word.starts_with("--array="))
            .map(str::to_owned)
    };
    let arrays: Vec<_> = calls().lines().filter_map(array).collect();
    assert_eq!(arrays, ["--array=1-4", "--array=3"]);
    assert_eq!(chunks(&out), chunks(&flown(&rig, SMALL, "whole", "")));
    // Nothing is submitted if all rows are there.
    submit("slurm").expect(0);
    assert_eq!(calls().lines().count(), 2);
    fs::remove_file(chunk(&out, 0)).unwrap();
    if Command::new("hq").arg("--version").output().is_err() {
        submit("hyperqueue").expect(1).complains("cannot start hq");
    }
}

#[test]
fn a_signal_ends_a_campaign_in_the_middle_of_a_flight() {
    let rig = Rig::new("at-once");
    let file = rig.settings(LONG);
    for (signal, jobs) in [(Signal::INT, "1"), (Signal::TERM, "2")] {
        let out = rig.file(jobs);
        let running = rig.start("campaign", format!("run {file} --out {out} --jobs {jobs}"));
        wait_until("a file of rows", || {
            (!chunks(&out).is_empty()).then_some(())
        });
        sleep(Duration::from_millis(500));
        running.signal(signal);
        // A campaign that waited for its second file would have two.
        let ended = running.end().expect(130);
        ended.says("RESULT status=INTERRUPTED flown=20 kept=0 chunks=1/2");
        campaign(&rig, format!("status {out}"))
            .expect(3)
            .says("20 of 40 flights, each by 1 arm; 1 of 2 files are whole")
            .says("missing: chunks 1\n");
        let left = fs::read_dir(&out).unwrap();
        let left: BTreeSet<_> = left.map(|entry| entry.unwrap().file_name()).collect();
        let whole = ["campaign.json", "campaign.toml", "chunk-0000000.parquet"];
        assert!(left.iter().eq(whole.iter()), "{left:?}");
    }
}

/// The most memory that a campaign of so many flights takes [kB], as far as it is seen before the end.
fn memory_kb(rig: &Rig, flights: u64, chunk: u64) -> u64 {
    // Rows with many columns: it shows if they are kept.
    let factors = ["inertia_x_kg_m2", "inertia_y_kg_m2", "inertia_z_kg_m2"]
        .map(|key| format!("\"plant.{key}\" = {{ uniform = [0.012, 0.014] }}\n"))
        .concat();
    let text = format!(
        "[campaign]\nname = \"memory\"\nflights = {flights}\nchunk = {chunk}\n[flight]\nduration_s = 0.004\n\
         position_error_max_m = 0.01\n[factors]\n{factors}\"plant.mass_kg\" = {{ uniform = [0.45, 0.6] }}\n\
         \"plant.arm_length_m\" = {{ uniform = [0.2, 0.22] }}\n\"plant.rotational_drag_nm_s\" = {{ uniform = [0.01, 0.5] }}\n"
    );
    let (file, out) = (rig.settings(&text), rig.file("memory"));
    let mut running = rig.start("campaign", format!("run {file} --out {out} --jobs 1"));
    let status = format!("/proc/{}/status", running.pid());
    let mut largest = 0;
    while running.is_running() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let number = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse().ok());
        largest = largest.max(number.unwrap_or(0));
        sleep(Duration::from_millis(2));
    }
    let result = format!("RESULT status=COMPLETE flown={flights} ");
    running.end().expect(0).says(&result);
    fs::remove_dir_all(&out).unwrap();
    largest
}

#[test]
fn memory_does_not_grow_with_the_number_of_flights() {
    const MANY: u64 = 16_000;
    /// Less than the rows of the longer campaign take if all are kept.
    const GROWTH_MAX_KB: u64 = 2048;
    let rig = Rig::new("memory");
    // Runs of one campaign differ by more than a megabyte.
    let few = (0..5).map(|_| memory_kb(&rig, 200, 20)).max().unwrap();
    let many = memory_kb(&rig, MANY, 20);
    // A file of rows is held until it is whole: this is what all rows take.
    let held = memory_kb(&rig, MANY, MANY);
    let said = format!("200 flights {few} kB, {MANY} flights {many} kB, all rows held {held} kB");
    assert!(few > 1000 && many < few + GROWTH_MAX_KB, "{said}");
    assert!(
        held > few + GROWTH_MAX_KB,
        "the bound tells nothing: {said}"
    );
}

#[test]
fn a_lost_flight_ends_again_where_its_rows_flight_ended() {
    let rig = Rig::new("lost");
    let out = flown(&rig, LOST, "rows", "");
    let report = report(&rig, &out);
    let mut reasons = BTreeSet::new();
    for flight in report["worst"].as_array().unwrap() {
        let lost = flight["lost"].as_str().unwrap();
        let known = ["position error", "tilt", "ground"];
        let reason = known.into_iter().find(|reason| lost.contains(reason));
        // One flight for each reason.
        if !reason.is_some_and(|reason| reasons.insert(reason)) {
            continue;
        }
        let arm = flight["arm"].as_str().unwrap();
        let again = fly_again(&rig, &out, &flight["flight"].to_string(), arm).expect(0);
        again.says(", as in the campaign's row, which is no success by");
        rig.ok("replay --verify").says("identical");
    }
    assert!(
        reasons.len() >= 2 && reasons.contains("position error"),
        "{reasons:?}"
    );
    rig.assert_nothing_left();
}

#[test]
fn a_flight_whose_stage_was_out_is_flown_again_in_one_process_as_its_row_was() {
    let rig = Rig::new("out");
    let text = "[campaign]\nname = \"out\"\nflights = 2\n[flight]\nduration_s = 1.0\n[[fault]]\nwhat = \"inner.stop\"\n\
                value = { uniform = [0.01, 0.02] }\nat_s = { uniform = [0.2, 0.6] }\n";
    let out = flown(&rig, text, "rows", "");
    fly_again(&rig, &out, "1", "base")
        .expect(0)
        .says("out-1-base: settings.toml, states.csv, flight.svg")
        .says("as in the campaign's row");
    for (file, words) in [
        ("settings.toml", "inner.stop="),
        ("states.csv", "\n0.5"),
        ("flight.svg", "</svg>"),
    ] {
        let left = fs::read_to_string(rig.out().join("out-1-base").join(file)).unwrap();
        assert!(left.contains(words), "{left}");
    }
}

/// Records a flight of a second and a bit, in slow motion, whose stages are stopped on the way; its directory.
fn record(rig: &Rig, stopped: &[&str]) -> String {
    let config = rig.slow(3);
    let flight = rig.take_off(format!("--rt off --config {config} --duration 1200ms"));
    rig.await_tick(0);
    for role in stopped {
        stop_for(flight.roles()[*role], Duration::from_millis(60));
    }
    flight.end().expect(0);
    let run = fs::canonicalize(rig.out().join("latest")).unwrap();
    run.to_str().unwrap().to_owned()
}

/// A campaign of two laws with further lines in its sections.
fn timed(campaign: &str, factors: &str, arm: &str) -> String {
    format!(
        "[campaign]\nname = \"machine\"\nflights = 6\nchunk = 2\n{campaign}\n[flight]\nduration_s = 1.0\n\
         [factors]\n\"plant.mass_kg\" = {{ uniform = [0.45, 0.6] }}\n{factors}\n\
         [arms.pid]\n\"inner.law\" = \"pid\"\n[arms.indi]\n\"inner.law\" = \"indi\"\n{arm}\n"
    )
}

#[test]
fn a_campaign_flies_with_the_timing_of_recorded_flights() {
    let rig = Rig::new("timings");
    let calm = record(&rig, &[]);
    let stopped = record(&rig, &["inner", "plant", "mixer"]);
    rows_are_those_of_simulate(&rig, &calm, &stopped);
    a_recording_is_known_by_its_content(&rig, &stopped, &calm);
    what_is_no_timing_is_named_with_its_line(&rig, &calm);
}

fn rows_are_those_of_simulate(rig: &Rig, calm: &str, stopped: &str) {
    let drawn = timed(
        "",
        &format!("timing = {{ grid = [{calm:?}, {stopped:?}] }}"),
        "",
    );
    let checked = rig.ok(&format!("campaign check {}", rig.settings(&drawn)));
    checked.says(
        "machine: 6 flights of 1 s by 2 arms (pid, indi), 12 rows in 3 files; 3 of 3 factors vary",
    );
    let ran = run(rig, &drawn, "drawn", "--jobs 2").expect(0);
    ran.says("RESULT status=COMPLETE flown=12");
    let (rows, runs) = (rig.file("drawn"), rig.file("again"));
    for (flight, arm) in [(0, 0), (1, 0), (1, 1), (4, 1)] {
        let name = ["pid", "indi"][arm];
        let again = format!("fly {rows} {flight} --arm {name} --out {runs}");
        let printed = campaign(rig, format!("{again} --print-config"))
            .expect(0)
            .stdout;
        let recording = [calm, stopped][flight as usize % 2];
        let comment = format!("# with --timing {recording}\n");
        assert!(printed.starts_with(&comment), "{printed}");
        // A flight may be lost, with as many outages as a loaded machine has.
        let config = rig.settings(&printed);
        let simulated = |timing: &str| {
            let ended = rig.run("simulate", format!("--config {config} {timing}"));
            ended.result()["outputs"].clone()
        };
        let outputs = cell(&rows, flight, arm, "outputs");
        let timing = format!("--timing {recording}");
        assert_eq!(simulated(&timing), outputs, "{flight} by {name}");
        if flight == 1 {
            assert_ne!(simulated(""), outputs, "the outages count");
        }
        assert_eq!(cell(&rows, flight, arm, "timing"), recording);
        let words = format!("outputs {outputs}, as in the campaign's row");
        campaign(rig, again).expect(0).says(&words);
        let left = Path::new(&runs).join(format!("machine-{flight}-{name}"));
        for file in ["settings.toml", "states.csv", "flight.svg"] {
            assert!(left.join(file).exists(), "{file}");
        }
    }
    // The example, with these recordings and two flights.
    let mut example = fs::read_to_string(repository("examples/machine-timing.toml")).unwrap();
    for (from, to) in [
        ("flights = 1000", "flights = 2"),
        ("duration_s = 8.0", "duration_s = 1.0"),
        ("../runs/calm/latest", calm),
        ("../runs/busy/latest", stopped),
    ] {
        assert!(example.contains(from), "{from}");
        example = example.replace(from, to);
    }
    let ran = run(rig, &example, "example", "--jobs 2").expect(0);
    ran.says("RESULT status=COMPLETE flown=20 ");
    rig.assert_nothing_left();
}

fn a_recording_is_known_by_its_content(rig: &Rig, one: &str, other: &str) {
    let here = rig.file("here");
    let copy_here = |from: &str| {
        let _ = fs::remove_dir_all(&here);
        let copied = Command::new("cp").args(["-rT", from, &here]).status();
        assert!(copied.unwrap().success());
    };
    copy_here(one);
    // By a name that is relative to the file, and by a full one; for all arms, or for one.
    let all = timed("timing = \"here\"", "", "");
    let ran = run(rig, &all, "rows", "").expect(0).result();
    let elsewhere = timed(&format!("timing = {one:?}"), "", "");
    let elsewhere = run(rig, &elsewhere, "rows", "").expect(0);
    assert_flown(&elsewhere, "0", "12");
    assert_eq!(elsewhere.result()["campaign"], ran["campaign"]);
    assert_flown(&run(rig, &all, "rows", "").expect(0), "0", "12");
    flown(rig, &timed("", "", "timing = \"here\""), "arms", "");
    flown(rig, &timed("", "", ""), "plain", "");
    for flight in 0..6 {
        for arm in [0, 1] {
            let [all, one, none] =
                ["rows", "arms", "plain"].map(|rows| cell(&rig.file(rows), flight, arm, "outputs"));
            assert_ne!(none, all, "flight {flight} by arm {arm}");
            assert_eq!(
                one,
                [&none, &all][arm].as_str(),
                "flight {flight} by arm {arm}"
            );
        }
    }
    // Another recording at the same place: from another machine's shard, or because `latest` has moved on.
    let rows = rig.file("rows");
    let before = chunks(&rows);
    copy_here(other);
    let refused = run(rig, &all, "rows", "").expect(2);
    refused.complains("holds rows of another recorded flight than the one that is now at here");
    for command in ["status", "report"] {
        let refused = campaign(rig, format!("{command} {rows}")).expect(2);
        refused
            .complains("was flown with another recorded flight than the one that is now at here");
    }
    let others = flown(rig, &all, "others", "");
    fs::copy(chunk(&others, 1), chunk(&rows, 1)).unwrap();
    copy_here(one);
    let status = campaign(rig, format!("status {rows}")).expect(3);
    status.says(
        "chunk-0000001.parquet: it is foreign: of the campaign machine with the fingerprint ",
    );
    assert_flown(&run(rig, &all, "rows", "").expect(0), "4", "8");
    assert_eq!(chunks(&rows), before);
}

fn what_is_no_timing_is_named_with_its_line(rig: &Rig, run: &str) {
    let stepped = rig.file("stepped");
    rig.ok(&format!(
        "fly --pace lockstep --log all --duration 200ms --out {stepped}"
    ));
    let log = fs::read(Path::new(run).join("flight.mcap")).unwrap();
    let (cut, garbage) = (rig.file("cut.mcap"), rig.file("garbage.mcap"));
    fs::write(&cut, &log[..log.len() / 2]).unwrap();
    fs::write(&garbage, "no log at all").unwrap();
    for [campaign, flight, factors, arm, words] in table(include_str!("campaigns/no_timing.md")) {
        let with_paths = |cell: &str| {
            let cell = cell.replace("{run}", run).replace("{stepped}", &stepped);
            cell.replace("{cut}", &cut).replace("{garbage}", &garbage)
        };
        let [campaign, factors, arm] = [campaign, factors, arm].map(with_paths);
        let text = timed(&campaign, &factors, &arm);
        let text = text.replace("duration_s = 1.0", &flight.replace(", ", "\n"));
        let file = rig.settings(&text);
        for command in ["check", "run"] {
            let refused = rig.refused(&format!("campaign {command} {file}"));
            let words = words.split(" ... ").chain([file.as_str()]);
            words.fold(refused, Ended::complains);
        }
    }
    assert!(!rig.path("campaigns").exists(), "no campaign was begun");
    let simulate = format!("--timing latest --out {stepped} --duration 200ms");
    let refused = rig.run("simulate", simulate).expect(1);
    refused.complains("was flown in lockstep");
}
