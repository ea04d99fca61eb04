//! Margins are those of single flights and of theory. `transcripts/studies.md` has the rest.

use crate::rig::{Ended, Rig};
use analysis::margin::{CALM, SURVIVES};
use controller::rate_law::sampled_gain;
use controller::rate_loop::loop_gain_limit;
use serde_json::Value;

fn search<'a>(margins: &'a Value, kind: &str, of: &str) -> &'a Value {
    let mut searches = margins["laws"][0]["searches"].as_array().unwrap().iter();
    let search = searches.find(|it| it["kind"] == kind && it["of"] == of);
    search.unwrap()
}

/// The greatest strength within a limit.
fn greatest(margins: &Value, limit: usize, kind: &str, of: &str) -> u64 {
    let search = search(margins, kind, of);
    search["limits"][limit].as_u64().unwrap()
}

#[test]
#[ignore = "long: part of the gate"]
fn the_longest_outage_flies_in_simulate_and_one_tick_more_does_not() {
    let rig = Rig::new("simulated");
    let flight = "--trajectory fast --inner indi";
    // A flight survives if its envelope is kept, whatever its errors are.
    let gates = "--gate recovered_below_m=1000 --gate recovered_yaw_below_rad=4 --gate rate_step_increase_rad_s=100";
    let only = "--only inner --only wrench";
    let measured = rig.ok(&format!(
        "margin {flight} {gates} {only} --phases 2 --format json"
    ));
    let margins = measured
        .complains("no table stored for flight reports: --only measures a part, --gate sets other")
        .json();
    assert_eq!(margins["schema"], "ironbird-margin/4");
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
    for (of, fault) in [
        ("inner", "inner.stop=TICKSms@tickBEGIN"),
        ("mixer.wrench", "wrench.drop=1@tickBEGIN..tickEND"),
    ] {
        let longest = greatest(&margins, SURVIVES, "outage", of);
        assert!((10..1000).contains(&longest), "{of}: {longest}");
        for (ticks, all) in [(longest, true), (longest + 1, false)] {
            let survives = |(seed, begin): (usize, &u64)| {
                let fault = fault.replace("TICKS", &ticks.to_string());
                let fault = fault.replace("BEGIN", &begin.to_string());
                let fault = fault.replace("END", &(begin + ticks).to_string());
                simulate(seed, &fault, begin + ticks + 6000).code == Some(0)
            };
            assert_eq!((1..).zip(&begins).all(survives), all, "{of} {ticks}");
        }
    }
    // The survival of losses was measured with the seeds after those of the phases.
    let share = greatest(&margins, SURVIVES, "loss", "mixer.wrench") as f64 / 100.0;
    let survived = begins.iter().enumerate().filter(|(i, begin)| {
        let fault = format!("wrench.drop={share}@tick{begin}");
        let ended = simulate(3 + i, &fault, *begin + 21_000);
        assert!(matches!(ended.code, Some(0 | 3)), "{ended}");
        ended.code == Some(0)
    });
    let repeated = &search(&margins, "loss", "mixer.wrench")["repeated"];
    assert_eq!(repeated, &serde_json::json!([survived.count(), 2]));
}

#[test]
#[ignore = "long: part of the gate"]
fn margins_are_those_of_theory_and_of_the_prediction() {
    let rig = Rig::new("theory");
    // The largest alpha at a delay, by the eigenvalues of the rate loop with its drag.
    for (alpha_1_s, delay) in [(582.7, 3), (330.5, 5), (177.0, 9)] {
        let measure = |share: f64, more: &str| {
            let alpha_1_s = share * alpha_1_s;
            let config = rig.settings(&format!(
                "[flight]\ntrajectory = \"hover\"\n[inner]\nalpha_1_s = {alpha_1_s:.1}\n"
            ));
            let margins = rig.ok(&format!(
                "margin --config {config} --phases 1 --only rotor_speeds --format json {more}"
            ));
            let margins = margins.json();
            let axes = margins["laws"][0]["predicted"]["axes"].as_array().unwrap();
            let least = |key: &str| {
                let values = axes.iter().map(|axis| axis[key].as_f64().unwrap());
                values.fold(f64::INFINITY, f64::min)
            };
            (least("delay_ticks"), least("gain"), margins.clone())
        };
        // The chain's own delay is one tick.
        let (ticks, ..) = measure(1.0, "--longest 1ms --gate survival_max_s=5");
        let predicted = 1.0 + ticks;
        assert!(
            (predicted / f64::from(delay) - 1.0).abs() < 0.005,
            "{predicted}"
        );
        let (_, gain, margins) = measure(0.99, "");
        let flown = 1 + greatest(&margins, CALM, "lag", "plant.rotor_speeds");
        let flown_gain = 1.0 + greatest(&margins, CALM, "gain", "plant.rotor_speeds") as f64 / 10.0;
        assert_eq!(flown, u64::from(delay));
        assert!(
            (gain - 0.12..gain * 1.01).contains(&flown_gain),
            "{gain} {flown_gain}"
        );
        let c = sampled_gain(0.99 * alpha_1_s, 1e-3) * 1e-3;
        let limit = (1..60)
            .take_while(|delay| c < loop_gain_limit(*delay))
            .last();
        assert_eq!(limit, Some(delay), "the rule of docs/paper.md");
    }
}
