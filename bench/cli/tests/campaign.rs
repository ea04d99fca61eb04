//! Campaigns: memory, refused timings. `transcripts/campaigns.md` has the rest.

use crate::rig::{Ended, Rig, table};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

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

/// The most memory that a campaign of so many flights was seen to allocate [kB]. How much of its executable is mapped
/// depends on what else runs.
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
    let mut command = rig.command("campaign", format!("run {file} --out {out} --jobs 1"));
    // With an arena for each thread, what malloc has free in them varies by more than a megabyte on a busy machine.
    command.env("MALLOC_ARENA_MAX", "1");
    let mut running = rig.launch(command);
    let status = format!("/proc/{}/status", running.pid());
    let mut largest = 0;
    while running.is_running() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"));
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
    const MANY: u64 = 8_000;
    /// Less than the rows of the longer campaign take if all are kept.
    const GROWTH_MAX_KB: u64 = 2048;
    let rig = Rig::new("memory");
    // Runs of one campaign differ by more than a megabyte.
    let few = (0..5).map(|_| memory_kb(&rig, 200, 100)).max().unwrap();
    let many = memory_kb(&rig, MANY, 100);
    // A file of rows is held until it is whole: this is what all rows take.
    let held = memory_kb(&rig, MANY, MANY);
    let said = format!("200 flights {few} kB, {MANY} flights {many} kB, all rows held {held} kB");
    assert!(few > 1000 && many < few + GROWTH_MAX_KB, "{said}");
    assert!(
        held > few + GROWTH_MAX_KB,
        "the bound tells nothing: {said}"
    );
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
fn what_is_no_timing_is_named_with_its_line() {
    let rig = Rig::new("timings");
    let slow = rig.slow(3);
    rig.ok(&format!("fly --rt off --config {slow} --duration 1200ms"));
    let run = fs::canonicalize(rig.out().join("latest")).unwrap();
    let run = run.to_str().unwrap();
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
