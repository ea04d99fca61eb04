//! Margins are those of single flights and of theory, and do not depend on the number of processors.

use crate::c_laws::root;
use crate::rig::{Ended, Rig};
use controller::Gains;
use controller::rate_law::sampled_gain;
use controller::rate_loop::loop_gain_limit;
use serde_json::Value;
use std::fs;

/// The entry of a list of the first law, by the value of a key.
fn entry<'a>(margins: &'a Value, list: &str, key: &str, value: &str) -> &'a Value {
    let mut entries = margins["laws"][0][list].as_array().unwrap().iter();
    entries.find(|it| it[key] == value).unwrap()
}

#[test]
fn the_longest_outage_flies_in_simulate_and_one_tick_more_does_not() {
    let rig = Rig::new("simulated");
    let flight = "--trajectory fast --inner indi";
    // A flight counts as survived if its envelope was kept, whatever its errors were.
    let gates = "--gate recovered_below_m=1000 --gate saturated_percent=100";
    let only = "--only inner --only wrench";
    let measured = rig.ok(&format!(
        "margin {flight} {gates} {only} --phases 2 --format json"
    ));
    let margins = measured
        .complains("no table stored for flight reports: --only measures a part, --gate sets other")
        .json();
    assert_eq!(margins["schema"], "ironbird-margin/1");
    let begins_s = margins["phases_s"].as_array().unwrap();
    // 5 s of ramp, and 5 s to settle.
    assert_eq!((begins_s.len(), &begins_s[0]), (2, &10.0.into()));
    let begins = begins_s
        .iter()
        .map(|begin| (begin.as_f64().unwrap() * 1e3).round() as u64);
    let begins: Vec<u64> = begins.collect();
    let simulate = |seed: usize, fault: &str, end: u64| -> Ended {
        let options = format!("{flight} --seed {seed} --duration {end}ms --fault {fault}");
        rig.run("simulate", options)
    };
    for (i, begin) in begins.iter().enumerate() {
        for (of, fault) in [
            (
                "inner",
                &(|ticks| format!("inner.stop={ticks}ms@tick{begin}")) as &dyn Fn(u64) -> String,
            ),
            ("mixer.wrench", &|ticks| {
                format!("wrench.drop=1@tick{begin}..tick{}", begin + ticks)
            }),
        ] {
            let longest = entry(&margins, "outages", "of", of)["ticks"][i]
                .as_u64()
                .unwrap();
            assert!((10..1000).contains(&longest), "{of}: {longest}");
            for (ticks, code) in [(longest, 0), (longest + 1, 3)] {
                simulate(1 + i, &fault(ticks), begin + ticks + 6000).expect(code);
            }
        }
    }
    // The survival of losses was measured with the seeds after those of the phases.
    let losses = entry(&margins, "losses", "input", "mixer.wrench");
    let share = (losses["share"].as_f64().unwrap() * 100.0).round() / 100.0;
    let survived = begins.iter().enumerate().filter(|(i, begin)| {
        let fault = format!("wrench.drop={share}@tick{begin}");
        let ended = simulate(3 + i, &fault, *begin + 10_000);
        assert!(matches!(ended.code, Some(0 | 3)), "{ended}");
        ended.code == Some(0)
    });
    let survived = survived.count();
    assert_eq!(
        (&losses["flights"], &losses["survived"]),
        (&2.into(), &survived.into())
    );
}

#[test]
fn one_processor_and_two_measure_the_same_bytes() {
    let rig = Rig::new("jobs");
    let run = |jobs: u32| {
        let laws = "--inner adaptive --inner indi --only machine --only setpoint";
        let length = "--phases 3 --longest 100ms --duration 20s";
        rig.ok(&format!(
            "margin {laws} {length} --jobs {jobs} --format json"
        ))
        .stdout
    };
    let one = run(1);
    assert_eq!(one, run(2));
    let margins: Value = serde_json::from_str(&one).unwrap();
    let laws = margins["laws"].as_array().unwrap();
    assert_eq!(laws.len(), 2);
    assert_ne!(laws[0]["fingerprint"], laws[1]["fingerprint"]);
}

#[test]
fn dead_time_is_tolerated_up_to_the_rule_of_the_paper() {
    let rig = Rig::new("theory");
    let preset = Gains::preset("flight").unwrap().alpha_1_s;
    // A little below docs/paper.md's largest alpha for 2, 3 and 4 ticks of delay, and the preset.
    for (alpha_1_s, delay) in [(914.0, 2), (560.0, 3), (406.0, 4), (preset, 8)] {
        let gain = sampled_gain(alpha_1_s, 1e-3) * 1e-3;
        let limit = (1..60)
            .take_while(|delay| gain < loop_gain_limit(*delay))
            .last();
        assert_eq!(limit, Some(delay), "alpha {alpha_1_s}");
        let config = rig.settings(&format!(
            "[flight]\ntrajectory = \"hover\"\n[inner]\nalpha_1_s = {alpha_1_s:.1}\n"
        ));
        let only = "--only rotor_speeds --only state";
        let margins = rig.ok(&format!(
            "margin --config {config} --phases 1 {only} --format json"
        ));
        let margins = margins.json();
        for input in ["plant.rotor_speeds", "inner.state"] {
            let lag = entry(&margins, "lags", "input", input)["ticks"]
                .as_u64()
                .unwrap();
            // The chain's own delay is one tick.
            let tolerated = 1 + lag;
            println!("alpha {alpha_1_s}/s, {input}: rule {delay} ticks, flight {tolerated}");
            assert!(
                tolerated.abs_diff(u64::from(delay)) <= 1,
                "alpha {alpha_1_s}, {input}"
            );
        }
    }
}

#[test]
fn the_document_quotes_what_was_measured() {
    let docs = root().join("docs");
    let document = fs::read_to_string(docs.join("margins.md")).unwrap();
    let measured = fs::read_to_string(docs.join("margins.txt")).unwrap();
    let (_, results) = document.split_once("\n## All built-in laws\n").unwrap();
    assert!(results.contains("(margins.txt)"), "{results}");
    let quoted = results.lines().filter_map(|line| line.strip_prefix("    "));
    let quoted: Vec<&str> = quoted.map(str::trim_end).collect();
    assert!(quoted.len() > 20, "{quoted:?}");
    for line in quoted {
        assert!(
            measured.lines().any(|it| it.trim_end() == line),
            "not measured: {line}"
        );
    }
    let pictures = document.lines().filter(|line| line.starts_with("!["));
    let pictures: Vec<&str> = pictures.collect();
    assert_eq!(pictures.len(), 3);
    for line in pictures {
        let (_, name) = line.trim_end_matches(')').rsplit_once('(').unwrap();
        assert!(
            fs::read(docs.join(name)).unwrap().starts_with(b"\x89PNG"),
            "{name}"
        );
    }
}
