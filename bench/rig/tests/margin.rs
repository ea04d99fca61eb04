//! What a loop bears: margins are those of single flights, of theory, and of no particular number of processors.

use crate::rig::{Ended, Rig};
use controller::Gains;
use controller::rate_law::sampled_gain;
use controller::rate_loop::loop_gain_limit;
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::thread::sleep;
use std::time::Duration;

/// A survived flight is one whose envelope was kept, wherever it was and whatever its rotors did.
const ENVELOPE: [&str; 4] = [
    "--gate",
    "recovered_below_m=1000",
    "--gate",
    "saturated_percent=100",
];

fn margins(rig: &Rig, options: &[&str]) -> Value {
    rig.run("margin", [options, &["--format", "json"]].concat())
        .expect(0)
        .json()
}

/// The outages survived of one thing, by the first law.
fn ticks(margins: &Value, of: &str) -> Vec<u64> {
    let outages = margins["laws"][0]["outages"].as_array().unwrap();
    let found = outages.iter().find(|it| it["of"] == of).unwrap();
    found["ticks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it.as_u64().unwrap())
        .collect()
}

/// The longest lag of an input.
fn lag(margins: &Value, input: &str) -> u64 {
    let lags = margins["laws"][0]["lags"].as_array().unwrap();
    lags.iter().find(|it| it["input"] == input).unwrap()["ticks"]
        .as_u64()
        .unwrap()
}

#[test]
fn the_longest_outage_flies_in_simulate_and_one_tick_more_does_not() {
    let rig = Rig::new("simulated");
    let flight = ["--trajectory", "fast", "--inner", "indi"];
    let options = [
        &flight[..],
        &ENVELOPE,
        &["--phases", "2", "--only", "inner", "--only", "wrench"],
    ]
    .concat();
    let ended = rig
        .run("margin", [&options[..], &["--format", "json"]].concat())
        .expect(0);
    let ended = ended
        .complains("no table stored for flight reports: --only measures a part, --gate sets other");
    let margins = ended.json();
    assert_eq!(margins["schema"], "ironbird-margin/1");
    let begins = margins["phases_s"].as_array().unwrap();
    assert_eq!(
        (begins.len(), &begins[0]),
        (2, &10.0.into()),
        "5 s of ramp, and 5 s to settle"
    );
    for (i, begin) in begins.iter().enumerate() {
        let tick = (begin.as_f64().unwrap() * 1e3).round() as u64;
        let seed = (1 + i).to_string();
        let fly = |fault: String, end: u64| -> Ended {
            let duration = format!("{}ms", end + 6000);
            rig.run(
                "simulate",
                [
                    &flight[..],
                    &["--seed", &seed, "--duration", &duration, "--fault", &fault],
                ]
                .concat(),
            )
        };
        let stop = |ticks: u64| fly(format!("inner.stop={ticks}ms@tick{tick}"), tick + ticks);
        let drop = |ticks: u64| {
            fly(
                format!("wrench.drop=1@tick{tick}..tick{}", tick + ticks),
                tick + ticks,
            )
        };
        let (stopped, dropped) = (
            ticks(&margins, "inner")[i],
            ticks(&margins, "mixer.wrench")[i],
        );
        assert!(
            (10..1000).contains(&stopped) && (10..1000).contains(&dropped),
            "{stopped} {dropped}"
        );
        stop(stopped).expect(0);
        stop(stopped + 1).expect(3);
        drop(dropped).expect(0);
        drop(dropped + 1).expect(3);
    }
    // What is told of survival was flown with the seeds behind those of the phases.
    let losses = &margins["laws"][0]["losses"].as_array().unwrap()[0];
    let percent = (losses["share"].as_f64().unwrap() * 100.0).round();
    let survived = begins.iter().enumerate().filter(|(i, begin)| {
        let tick = (begin.as_f64().unwrap() * 1e3).round() as u64;
        let (seed, duration) = ((3 + i).to_string(), format!("{}ms", tick + 10_000));
        let fault = format!("wrench.drop={}@tick{tick}", percent / 100.0);
        let options = ["--seed", &seed, "--duration", &duration, "--fault", &fault];
        let ended = rig.run("simulate", [&flight[..], &options].concat());
        assert!(matches!(ended.code, Some(0 | 3)), "{ended}");
        ended.code == Some(0)
    });
    assert_eq!(
        (losses["flights"].as_u64(), losses["survived"].as_u64()),
        (Some(2), Some(survived.count() as u64))
    );
}

#[test]
fn one_processor_and_two_measure_the_same_bytes() {
    let rig = Rig::new("jobs");
    let run = |jobs: &str, format: &str| {
        let what = [
            "--inner", "adaptive", "--inner", "indi", "--only", "machine", "--only", "setpoint",
        ];
        let how = [
            "--phases",
            "3",
            "--longest",
            "100ms",
            "--duration",
            "20s",
            "--jobs",
            jobs,
            "--format",
            format,
        ];
        rig.run("margin", [&what[..], &how].concat())
            .expect(0)
            .stdout
    };
    let one = run("1", "json");
    assert_eq!(one, run("2", "json"));
    assert_eq!(run("1", "text"), run("2", "text"));
    let margins: Value = serde_json::from_str(&one).unwrap();
    assert_eq!(margins["laws"].as_array().unwrap().len(), 2);
    assert_ne!(
        margins["laws"][0]["fingerprint"],
        margins["laws"][1]["fingerprint"]
    );
}

#[test]
fn dead_time_is_borne_up_to_the_rule_of_the_paper() {
    let rig = Rig::new("theory");
    let limit = |alpha_1_s: f64| {
        let gain = sampled_gain(alpha_1_s, 1e-3) * 1e-3;
        (1..60)
            .take_while(|delay| gain < loop_gain_limit(*delay))
            .last()
            .unwrap()
    };
    let flight = Gains::preset("flight").unwrap().alpha_1_s;
    // A little inside of docs/paper.md's largest alpha for 2, 3 and 4 ticks of delay, and the preset.
    for (alpha_1_s, delay) in [(914.0, 2), (560.0, 3), (406.0, 4), (flight, 8)] {
        assert_eq!(limit(alpha_1_s), delay, "alpha {alpha_1_s}");
        let settings = rig.settings(&format!(
            "[flight]\ntrajectory = \"hover\"\n[inner]\nalpha_1_s = {alpha_1_s:.1}\n"
        ));
        let options = [
            "--config",
            &settings,
            "--phases",
            "1",
            "--only",
            "rotor_speeds",
            "--only",
            "state",
        ];
        let margins = margins(&rig, &options);
        // The chain's own delay is one tick.
        for input in ["plant.rotor_speeds", "inner.state"] {
            let borne = 1 + lag(&margins, input);
            println!(
                "alpha {alpha_1_s}/s: the rule bears {delay} ticks, the flight {borne} ({input})"
            );
            assert!(
                borne.abs_diff(u64::from(delay)) <= 1,
                "alpha {alpha_1_s}, {input}: {borne}, the rule says {delay}"
            );
        }
    }
}

#[test]
fn a_report_knows_the_margin_once_it_has_been_measured() {
    let rig = Rig::new("line");
    let slow = rig.settings("[flight]\nslowdown = 4\ntrajectory = \"hover\"\n");
    rig.ok(&format!("fly --config {slow} --duration 1s"))
        .tells("Margin not known: run ironbird margin --config ");
    let before = rig.report();
    let unknown = before["margin"]["unknown"].as_str().unwrap().to_owned();
    let words: Vec<&str> = unknown.split(' ').collect();
    assert_eq!(words[..2], ["ironbird", "margin"], "{unknown}");
    let fingerprint = before["margin"]["fingerprint"].as_str().unwrap();
    let quick = [&words[2..], &["--phases", "1", "--longest", "60ms"]].concat();
    let told = rig
        .run("margin", &quick)
        .expect(0)
        .complains(&format!("{fingerprint}.json"));
    let told = told
        .says("trajectory hover, gains flight, airframe paper, seed 1\n1 phase over 10.000 s from 10.000 s on")
        .says("Longest outage survived [ticks of 1 ms]")
        .says("Longest steady lag")
        .says("Longest steady delay")
        .says("Largest share of random losses")
        .says("Weakest (m, k)")
        .says("pd + adaptive");
    assert!(
        told.stdout.contains("machine") && told.stdout.contains("plant.rotor_speeds"),
        "{told}"
    );

    // A slow-motion flight of 1 s may have an outage or none.
    let report = rig.ok("report latest").tells("this loop tolerates");
    assert!(!report.stdout.contains("not known"), "{report}");
    // Another flight knows at once, and its length and pace do not matter.
    rig.ok(&format!("fly --config {slow} --duration 1200ms"))
        .tells("this loop tolerates");
    let after = rig.report();
    assert_eq!(after["margin"]["fingerprint"], fingerprint);
    assert!(
        after["margin"]["bears"]["machine"]["ticks"]
            .as_u64()
            .unwrap()
            > 0,
        "{}",
        after["margin"]
    );
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(
        page.contains("Margin: ") && page.contains("this loop tolerates"),
        "no margin on the page"
    );
    let text = fs::read_to_string(rig.out().join("latest/report.txt")).unwrap();
    assert!(text.contains("\nMargin    "), "{text}");
    // A margin is of one airframe.
    let lighter = format!("--config {slow} --duration 1s --fault mass_kg=0.5@500ms");
    rig.run("fly", &lighter)
        .expect(0)
        .tells("this loop tolerates")
        .tells("; of the airframe before 1 swap in");
    // Other laws are another loop; in lockstep there are no outages.
    rig.ok(&format!("fly --config {slow} --duration 1s --inner indi"))
        .tells("Margin not known");
    let lockstep = rig.ok("fly --pace lockstep --trajectory hover --duration 1s");
    assert!(!lockstep.stdout.contains("Margin"), "{lockstep}");
    // A table that cannot be read is none.
    fs::write(
        rig.out()
            .join("margins")
            .join(format!("{fingerprint}.json")),
        "{",
    )
    .unwrap();
    rig.ok(&format!("fly --config {slow} --duration 1s"))
        .tells("Margin not known");
    rig.ok("runs --json");
}

#[test]
fn margins_are_drawn_with_a_line_for_each_law() {
    let rig = Rig::new("drawn");
    let page = rig.file("margins.html");
    let options = "--inner pid --inner indi --trajectory hover --phases 2 --only setpoint";
    let told = rig.ok(&format!("margin {options} --longest 50ms --page {page}"));
    told.complains("no table stored for flight reports: --only measures a part\n")
        .complains("written: ");
    assert!(!rig.out().exists(), "no table");
    let page = fs::read_to_string(page).unwrap();
    for words in [
        "pd + pid",
        "pd + indi",
        "begin of the outage [s]",
        "lag [ticks]",
        "messages lost [%]",
        "10.000 s on",
    ] {
        assert!(page.contains(words), "{words}");
    }
    // Outage, lag and loss of one input.
    for class in ["law-1", "law-2"] {
        assert_eq!(
            page.matches(&format!("class=\"line {class}\"")).count(),
            3,
            "{class}"
        );
    }
    assert!(!page.contains("://"), "the page loads nothing");
}

#[test]
fn an_interruption_ends_it_and_leaves_no_table() {
    let rig = Rig::new("interrupted");
    let mut running = rig.start("margin", "--phases 1000");
    sleep(Duration::from_secs(1));
    assert!(running.is_running());
    running.signal(Signal::INT);
    running.end().expect(130).complains("interrupted");
    let tables = fs::read_dir(rig.out().join("margins")).unwrap().count();
    assert_eq!(tables, 0);
}

#[test]
fn the_document_says_what_was_measured() {
    let ours = |path: &str| {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../..")
            .join(path);
        fs::read_to_string(path).unwrap()
    };
    let (document, measured) = (ours("docs/margins.md"), ours("docs/margins.txt"));
    assert!(measured.lines().count() > 40, "{measured}");
    let (_, results) = document.split_once("\n## All built-in laws\n").unwrap();
    assert!(results.contains("(margins.txt)"), "{results}");
    let quoted: Vec<&str> = results
        .lines()
        .filter_map(|line| line.strip_prefix("    "))
        .collect();
    assert!(quoted.len() > 20, "{quoted:?}");
    for line in quoted {
        assert!(
            measured.lines().any(|it| it.trim_end() == line.trim_end()),
            "docs/margins.md quotes what was not measured: {line}"
        );
    }
    let pictures: Vec<&str> = document
        .lines()
        .filter(|line| line.starts_with("!["))
        .collect();
    assert_eq!(pictures.len(), 3);
    for line in pictures {
        let (_, name) = line.trim_end_matches(')').rsplit_once('(').unwrap();
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../docs")
            .join(name);
        assert!(
            fs::read(&path).unwrap().starts_with(b"\x89PNG"),
            "{}",
            path.display()
        );
    }
}

#[test]
fn faults_of_the_settings_file_are_left_out_of_a_margin_with_a_warning() {
    let rig = Rig::new("faulty");
    let faulty = rig.settings("[flight]\ntrajectory = \"hover\"\nfaults = [\"mass_kg=0.6@8s\"]\n");
    let options = format!("--config {faulty} --phases 1 --only outer --longest 2ms");
    rig.run("margin", &options)
        .expect(0)
        .complains("warning: the faults of the settings file are ignored");
}
