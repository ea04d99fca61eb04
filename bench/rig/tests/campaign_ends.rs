//! Campaigns that are interrupted end at once and lose only what was being flown; long ones take no more memory.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::rig::{Rig, wait_until};
use rustix::process::Signal;

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
        let mut running = rig.start("campaign", &["run", &file, "--out", &out, "--jobs", jobs]);
        let first = Path::new(&out).join("chunk-0000000.parquet");
        wait_until("the first file of rows", || first.exists().then_some(()));
        sleep(Duration::from_millis(500));
        assert!(running.is_running(), "the second takes longer than this: {}", running.stderr());
        let asked = Instant::now();
        running.signal(signal);
        let ended = running.end().expect(130);
        let took = asked.elapsed();
        assert!(took < AT_ONCE, "{signal:?}: it took {took:?}");
        eprintln!("{signal:?}, --jobs {jobs}: ended after {took:?}");
        ended.says("RESULT status=INTERRUPTED flown=20 kept=0 chunks=1/2");
        let status = rig.run("campaign", &["status", &out]).expect(3);
        status.says("20 of 40 flights, each by 1 arm; 1 of 2 files are whole").says("missing: chunks 1\n");
        let mut left: Vec<String> =
            fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        left.sort();
        assert_eq!(left, ["campaign.json", "campaign.toml", "chunk-0000000.parquet"]);
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
    let mut running = rig.start("campaign", &["run", &rig.settings(&text), "--out", &out, "--jobs", "1"]);
    let status = format!("/proc/{}/status", running.pid());
    let mut largest = 0;
    while running.is_running() {
        let told = fs::read_to_string(&status).unwrap_or_default();
        let told = told.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse().ok());
        largest = largest.max(told.unwrap_or(0));
        sleep(Duration::from_millis(2));
    }
    running.end().expect(0).says(&format!("RESULT status=COMPLETE flown={flights} "));
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
    let (few, many) =
        ([(); 5].map(|()| memory_kb(&rig, 200, 20)).into_iter().fold(0, u64::max), memory_kb(&rig, MANY, 20));
    // One file of rows is held until it is whole: so much would all of them take.
    let held = memory_kb(&rig, MANY, MANY);
    eprintln!("200 flights {few} kB, {MANY} flights {many} kB, with all rows held {held} kB");
    assert!(few > 1000, "it was seen: {few} kB");
    assert!(many < few + GROWTH_MAX_KB, "200 flights took {few} kB, {MANY} flights {many} kB");
    assert!(held > few + GROWTH_MAX_KB, "the bound tells nothing: 200 flights took {few} kB, all rows {held} kB");
}
