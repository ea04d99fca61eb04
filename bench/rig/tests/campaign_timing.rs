//! Campaigns with the timing of recorded flights: rows are those of `simulate --timing`, and a recording is what it holds.

use crate::rig;
use crate::rig::{Rig, stop_for};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// Records a flight of a second and a bit, in slow motion, whose stages are stopped on the way; its directory.
fn recorded(rig: &Rig, stopped: &[&str]) -> String {
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 1200ms",
        rig.slow(3)
    ));
    rig.await_tick(0);
    for role in stopped {
        stop_for(flight.roles()[*role], Duration::from_millis(60));
    }
    flight.end().expect(0);
    let run = fs::canonicalize(rig.out().join("latest")).unwrap();
    run.to_str().unwrap().to_owned()
}

/// A campaign of two laws with what stands in its sections.
fn text(campaign: &str, factors: &str, slow_arm: &str) -> String {
    format!(
        "[campaign]\nname = \"machine\"\nflights = 6\nchunk = 2\n{campaign}\n[flight]\nduration_s = 1.0\n\
         [factors]\n\"plant.mass_kg\" = {{ uniform = [0.45, 0.6] }}\n{factors}\n\
         [arms.pid]\n\"inner.law\" = \"pid\"\n[arms.indi]\n\"inner.law\" = \"indi\"\n{slow_arm}\n"
    )
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

fn cell(directory: &str, flight: u64, arm: usize, column: &str) -> String {
    let text = fs::read_to_string(Path::new(directory).join("campaign.toml")).unwrap();
    let campaign = campaign::file::read(&text).unwrap();
    let rows = campaign::chunk::Rows::new(Path::new(directory), 0..campaign.chunks());
    let row = rows.row(&campaign, flight, arm).unwrap().unwrap();
    row.into_iter().find(|(it, _)| it == column).unwrap().1
}

/// `ironbird campaign run` of a text into a directory of the rig.
fn run(rig: &Rig, text: &str, out: &str) -> rig::Ended {
    rig.run(
        "campaign",
        format!(
            "run {} --out {} --jobs 2",
            rig.settings(text),
            rig.file(out)
        ),
    )
}

#[test]
fn rows_are_those_of_simulate_with_the_timing_of_each_recorded_flight() {
    let rig = Rig::new("timings");
    let (calm, stopped) = (
        recorded(&rig, &[]),
        recorded(&rig, &["inner", "plant", "mixer"]),
    );
    let drawn = text(
        "",
        &format!("timing = {{ grid = [{calm:?}, {stopped:?}] }}"),
        "",
    );
    let checked = rig.ok(&format!("campaign check {}", rig.settings(&drawn)));
    checked.says(
        "machine: 6 flights of 1 s by 2 arms (pid, indi), 12 rows in 3 files; 3 of 3 factors vary",
    );
    run(&rig, &drawn, "rows")
        .expect(0)
        .says("RESULT status=COMPLETE flown=12");
    let out = rig.file("rows");
    let runs = rig.file("again");
    for (flight, arm) in [(0, 0), (1, 0), (1, 1), (4, 1)] {
        let (number, name) = (flight.to_string(), ["pid", "indi"][arm]);
        let again = ["fly", out.as_str(), &number, "--arm", name, "--out", &runs];
        let printed = rig
            .run("campaign", [&again[..], &["--print-config"]].concat())
            .expect(0)
            .stdout;
        let recording = if flight % 2 == 0 { &calm } else { &stopped };
        assert!(
            printed.starts_with(&format!("# with --timing {recording}\n")),
            "{printed}"
        );
        let outputs = cell(&out, flight, arm, "outputs");
        let simulate = |more: &[&str]| {
            let own = ["--config".to_owned(), rig.settings(&printed)];
            let own: Vec<&str> = own
                .iter()
                .map(String::as_str)
                .chain(more.iter().copied())
                .collect();
            rig.run("simulate", &own).result()["outputs"].clone()
        };
        assert_eq!(
            simulate(&["--timing", recording]),
            outputs,
            "flight {number} by {name}"
        );
        if flight % 2 == 1 {
            assert_ne!(simulate(&[]), outputs, "the outages count");
        }
        assert_eq!(cell(&out, flight, arm, "timing"), *recording);
        rig.run("campaign", again)
            .expect(0)
            .says(&format!("outputs {outputs}, as in the campaign's row"));
        let left = Path::new(&runs).join(format!("machine-{number}-{name}"));
        for file in ["settings.toml", "states.csv", "flight.svg"] {
            assert!(left.join(file).exists(), "{file}");
        }
    }
    // The example, with these recordings and two flights.
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/machine-timing.toml");
    let changes = [
        ("flights = 1000", "flights = 2"),
        ("duration_s = 8.0", "duration_s = 1.0"),
        ("../runs/calm/latest", calm.as_str()),
        ("../runs/busy/latest", stopped.as_str()),
    ];
    let small =
        changes
            .into_iter()
            .fold(fs::read_to_string(example).unwrap(), |text, (from, to)| {
                assert!(text.contains(from), "{from}");
                text.replace(from, to)
            });
    run(&rig, &small, "example")
        .expect(0)
        .says("RESULT status=COMPLETE flown=20 ");
    rig.assert_nothing_left();
}

#[test]
fn a_recording_is_known_by_its_content_and_another_one_is_refused() {
    let rig = Rig::new("content");
    let (one, other) = (
        recorded(&rig, &["inner"]),
        recorded(&rig, &["mixer", "outer"]),
    );
    let here = rig.file("here");
    let copy = |from: &str, to: &str| {
        assert!(
            Command::new("cp")
                .args(["-rT", from, to])
                .status()
                .unwrap()
                .success()
        );
    };
    copy(&one, &here);
    // Beside the file, by a relative name; and as the key of all arms or of one.
    let all = text("timing = \"here\"", "", "");
    let ran = run(&rig, &all, "rows").expect(0).result();
    let elsewhere = run(&rig, &text(&format!("timing = {one:?}"), "", ""), "rows")
        .expect(0)
        .result();
    assert_eq!(
        (elsewhere["kept"].as_str(), &elsewhere["campaign"]),
        ("12", &ran["campaign"]),
        "the same campaign"
    );
    run(&rig, &all, "rows").expect(0).says("flown=0 kept=12");
    run(&rig, &text("", "", "timing = \"here\""), "arms").expect(0);
    let outputs = |out: &str| {
        let cells = (0..6)
            .flat_map(|flight| [0, 1].map(|arm| cell(&rig.file(out), flight, arm, "outputs")));
        cells.collect::<Vec<String>>()
    };
    run(&rig, &text("", "", ""), "plain").expect(0);
    let [all_arms, one_arm, none] = ["rows", "arms", "plain"].map(outputs);
    for i in 0..12 {
        assert_eq!(
            one_arm[i],
            if i % 2 == 0 { &none } else { &all_arms }[i],
            "row {i}"
        );
        assert_ne!(none[i], all_arms[i], "row {i}");
    }

    // Another recording at the same place: by another machine's shard, or because `latest` has moved on.
    let before = chunks(&rig.file("rows"));
    fs::remove_dir_all(&here).unwrap();
    copy(&other, &here);
    run(&rig, &all, "rows")
        .expect(2)
        .complains("holds rows of another recorded flight than the one that is now at here");
    for command in ["status", "report"] {
        let refused = rig.refused(&format!("campaign {command} {}", rig.file("rows")));
        refused
            .complains("was flown with another recorded flight than the one that is now at here");
    }
    run(&rig, &all, "others").expect(0);
    fs::copy(
        rig.path("others").join("chunk-0000001.parquet"),
        rig.path("rows").join("chunk-0000001.parquet"),
    )
    .unwrap();
    fs::remove_dir_all(&here).unwrap();
    copy(&one, &here);
    let status = rig
        .run("campaign", format!("status {}", rig.file("rows")))
        .expect(3);
    status.says(
        "chunk-0000001.parquet: it is foreign: of the campaign machine with the fingerprint ",
    );
    run(&rig, &all, "rows").expect(0).says("flown=4 kept=8");
    assert_eq!(chunks(&rig.file("rows")), before);
}

#[test]
fn what_is_no_timing_is_named_with_its_line() {
    let rig = Rig::new("no-timing");
    let run = recorded(&rig, &[]);
    let stepped = rig.file("stepped");
    rig.ok(&format!(
        "fly --pace lockstep --log all --duration 200ms --out {stepped}"
    ));
    let log = fs::read(Path::new(&run).join("flight.mcap")).unwrap();
    let (cut, garbage) = (rig.file("cut.mcap"), rig.file("garbage.mcap"));
    fs::write(&cut, &log[..log.len() / 2]).unwrap();
    fs::write(&garbage, "no log at all").unwrap();
    let named = |name: &str| format!("timing = {name:?}");
    for (text, said) in [
        (
            text(&named("nowhere"), "", ""),
            "no flight at |nowhere|: line 5: timing = \"nowhere\"",
        ),
        (
            text(&named(&garbage), "", ""),
            "garbage.mcap|: line 5: timing = ",
        ),
        (
            text(&named(&cut), "", ""),
            "cut.mcap is truncated|: line 5: timing = ",
        ),
        (
            text("", "", &named(&format!("{stepped}/latest"))),
            "was flown in lockstep|: line 15: timing = ",
        ),
        (
            text(
                "",
                &format!("timing = {{ choice = [{run:?}, \"nowhere\"] }}"),
                "",
            ),
            "no flight at |: line 10: timing = \"nowhere\"",
        ),
        (
            text(&named(&run), "", "").replace("duration_s = 1.0", "duration_s = 2.0"),
            "campaign.timing: the recorded flight ends at tick |, this one at tick 2000|: line 5, flown by the arm pid|\
             fly at most 1.2 s",
        ),
        (
            text("", "", &named(&run))
                .replace("duration_s = 1.0", "duration_s = 1.0\nperiod_s = 0.0005"),
            "arms.indi.timing: the recorded flight has ticks of 1000000 ns, this one of 500000 ns|: line 16, flown by the arm indi",
        ),
        (
            text(
                &named(&run),
                "\"flight.faults\" = { grid = [[], [\"state.drop=0.1@500ms\"]] }",
                "",
            ),
            "campaign.timing: message and stage faults cannot be combined with recorded timing|: line 10, flown by the arm pid",
        ),
        (
            text(
                &named(&run),
                "\"flight.duration_s\" = { grid = [0.5, 1.5] }",
                "",
            ),
            "the recorded flight ends at tick |, this one at tick 1500|: line 10, flown by the arm pid",
        ),
        (
            text("timing = 3", "", ""),
            "line 5: campaign.timing = 3: expected a recorded flight, its directory or its log",
        ),
        (
            text("timing = \"\"", "", ""),
            "line 5: campaign.timing = \"\": expected a recorded flight",
        ),
        (
            text("", "timing = { uniform = [0.0, 1.0] }", ""),
            "line 10: timing = { uniform = [0.0, 1.0] }: expected for each",
        ),
        (
            text(&named(&run), &format!("timing = {run:?}"), "timing = \"x\""),
            "line 5: `timing` is drawn as a factor, so campaign.timing cannot set it|\
             line 15: `timing` is drawn as a factor, so arms.indi.timing cannot set it",
        ),
    ] {
        let file = rig.settings(&text);
        for command in ["check", "run"] {
            let refused = rig
                .refused(&format!("campaign {command} {file}"))
                .complains(&file);
            said.split('|')
                .fold(refused, |refused, said| refused.complains(said));
        }
    }
    assert!(!rig.path("campaigns").exists(), "nothing was begun");
    let refused = rig
        .run(
            "simulate",
            format!("--timing latest --out {stepped} --duration 200ms"),
        )
        .expect(1);
    refused.complains("was flown in lockstep");
}
