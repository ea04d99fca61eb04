//! Laws side by side: the flights are those of `simulate`, and the documents show what was measured.

use std::fs;

use crate::c_laws::root;
use crate::rig::Rig;
use serde_json::Value;

const INNER: &str = "--inner adaptive --inner fixed --inner geometric --inner indi --inner pid";

fn compared(rig: &Rig, options: &str) -> Value {
    rig.ok(&format!("compare {options} --format json")).json()
}

fn of<'a>(comparison: &'a Value, outer: &str, inner: &str) -> &'a Value {
    let is_it = |it: &&Value| it["laws"]["outer"] == outer && it["laws"]["inner"] == inner;
    let mut outcomes = comparison["outcomes"].as_array().unwrap().iter();
    outcomes.find(is_it).unwrap()
}

/// Its largest error from 5 s after the last fault on [mm].
fn worst_mm(outcome: &Value) -> f64 {
    1e3 * outcome["error_after"]["worst_m"].as_f64().unwrap()
}

#[test]
fn each_flight_is_the_simulated_one_bit_for_bit() {
    let rig = Rig::new("compared");
    let flight = |seed: u32| {
        format!(
            "--trajectory fast --airframe crazyflie --duration 4s --seed {seed} \
             --fault gyro_noise_rad_s=0.01,command_delay_s=0.002@1s --fault mass_kg=+20%@2s"
        )
    };
    let laws = "--outer pd --outer estimating --inner adaptive --inner indi";
    let comparison = compared(&rig, &format!("{} {laws}", flight(7)));
    assert_eq!(comparison["schema"], "ironbird-comparison/1");
    assert_eq!(comparison["outcomes"].as_array().unwrap().len(), 4);
    let mut hashes = Vec::new();
    for (outer, inner) in [
        ("pd", "adaptive"),
        ("pd", "indi"),
        ("estimating", "adaptive"),
        ("estimating", "indi"),
    ] {
        let simulate = format!("simulate {} --outer {outer} --inner {inner}", flight(7));
        let simulated = rig.ok(&simulate).result();
        let outcome = of(&comparison, outer, inner);
        assert_eq!(
            outcome["outputs"],
            simulated["outputs"].as_str(),
            "{outer} + {inner}"
        );
        assert_eq!(outcome["ticks"].to_string(), simulated["ticks"]);
        hashes.push(outcome["outputs"].to_string());
    }
    let other = compared(&rig, &format!("{} {laws}", flight(8)));
    hashes.push(other["outcomes"][0]["outputs"].to_string());
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), 5, "laws and seed make a difference");
}

#[test]
fn a_comparison_shows_when_each_law_had_recovered_and_why_one_was_lost() {
    let rig = Rig::new("recovered");
    let page = rig.file("page.html");
    let options = "--inner adaptive --inner pid --outer pd --outer estimating --duration 20s \
        --fault rotational_drag_nm_s=+200%@6s --fault mass_kg=+30%@11s";
    let text = rig.ok(&format!("compare {options} --page {page}"));
    let text = text
        .says("trajectory lissajous, gains flight, airframe paper, 20 s, seed 1\n")
        .says("     6.000 s  rotational_drag_nm_s=+200%\n")
        .says("before 6.000 s")
        .says("from 16.000 s on")
        .says("true error below 0.05 m for good, 1 s at least")
        .says("not in this flight")
        .says("power [hover]")
        .says("never above")
        .says("not before the next")
        .says("pd + adaptive: the flight was below ground: down to z = -2.35 m");
    assert!(!text.stdout.contains("estimating + adaptive: "), "{text}");
    let comparison = compared(&rig, options);
    let recovery = |outer| of(&comparison, outer, "adaptive")["recovery_s"].clone();
    assert_eq!(
        (&recovery("pd")[0], &recovery("pd")[1]),
        (&0.0.into(), &Value::Null)
    );
    let recovered_s = recovery("estimating")[1].as_f64().unwrap();
    assert!((1.0..4.0).contains(&recovered_s), "{recovered_s} s");

    let page = fs::read_to_string(page).unwrap();
    for words in [
        "pd + adaptive",
        "estimating + pid",
        "fault at 11.000 s: mass_kg=+30%",
        "rotor power [hover]",
        "Lost",
    ] {
        assert!(page.contains(words), "{words}");
    }
    // A line for each of four combinations in each of two charts.
    for class in ["law-1", "law-2", "law-3", "law-4"] {
        let lines = page.matches(&format!("class=\"line {class}\"")).count();
        assert_eq!(lines, 2, "{class}");
    }
    assert!(!page.contains("://"), "the page loads nothing");
}

#[test]
fn a_flight_that_ends_early_and_one_without_a_fault_are_described() {
    let rig = Rig::new("early");
    rig.ok("compare --inner indi --inner pid --fault rotor_efficiency_1=0@2s")
        .says("pd + indi: ended at ")
        .says("the flight left its envelope: at tick")
        .says("  -  ");
    let calm = rig.ok("compare --inner indi --inner pid --duration 2s");
    let calm = calm.says("All 2 flew to the end\n").stdout;
    assert!(
        !calm.contains("Recovered") && !calm.contains("before"),
        "{calm}"
    );
}

#[test]
fn the_tables_of_the_laws_are_what_the_command_prints_today() {
    let document = fs::read_to_string(root().join("docs/laws.md")).unwrap();
    let table = fs::read_to_string(root().join("docs/faults-of-laws.txt")).unwrap();
    let (_, rest) = document.split_once("<!-- made by: ironbird ").unwrap();
    let (command, rest) = rest.split_once(" -->\n").unwrap();
    let (quoted, _) = rest.split_once("<!-- end -->").unwrap();
    assert!(
        quoted.lines().count() > 15 && table.contains(quoted.trim()),
        "{quoted}"
    );
    let (docs, rig) = (root().join("docs"), Rig::new("tables"));
    let command = command.replace("docs/", &format!("{}/", docs.display()));
    let printed = rig.ok(&command).stdout;
    assert!(
        printed == table,
        "docs/faults-of-laws.txt differs from `ironbird {command}`:\n{printed}"
    );

    // Rows that show the purpose of a law: errors with adaptive, fixed, geometric, indi and pid [mm].
    let row = |outer: &str, fault: &str| -> Vec<f64> {
        let (_, rows) = table.split_once(&format!("Outer law `{outer}`")).unwrap();
        let (_, row) = rows.split_once(&format!("| {fault} |")).unwrap();
        let cells = row.split('|').take(5);
        let numbers = cells.map(|cell| cell.trim().trim_matches('*').split(' ').next());
        let numbers = numbers.map(|number| number.unwrap_or_default().parse());
        numbers
            .map(|number| number.unwrap_or(f64::INFINITY))
            .collect()
    };
    for fault in [
        "disturbance delta x 10",
        "drag k_r x 5",
        "inertia of the body x 2",
        "arm -30 %",
        "rotor 1 -30 %",
    ] {
        for (outer, factor) in [("pd", 1.0), ("estimating", 3.0)] {
            let row = row(outer, fault);
            assert!(factor * row[3] < row[1], "{outer}, {fault}: {row:?}");
        }
    }
    // The outer law `estimating` recovers from a larger mass with every law that follows it.
    for law in [0, 1, 3, 4] {
        assert!(row("estimating", "mass +30 %")[law] <= 50.0);
        assert!(row("pd", "mass +30 %")[law] > 1000.0);
    }
}

#[test]
fn geometric_recovers_from_a_roll_of_170_degrees_above_a_ground_and_the_others_crash() {
    let rig = Rig::new("upside-down");
    let examples = root().join("examples");
    let examples = examples.display();
    let flight = format!(
        "--config {examples}/upside_down.toml --trajectory {examples}/stay.csv --duration 12s"
    );
    let comparison = compared(&rig, &format!("{flight} {INNER}"));
    let geometric = of(&comparison, "pd", "geometric");
    assert_eq!(
        (&geometric["lost"], &geometric["ticks"]),
        (&Value::Null, &12_001.into())
    );
    for inner in ["adaptive", "fixed", "indi", "pid"] {
        let lost = of(&comparison, "pd", inner)["lost"].to_string();
        assert!(lost.contains("it crashed"), "{inner}: {lost}");
    }
    let states = rig.file("states.csv");
    rig.ok(&format!(
        "simulate {flight} --inner geometric --states {states} --every 1"
    ));
    let states = fs::read_to_string(states).unwrap();
    let z = |line: &str| line.split(',').nth(3).unwrap().parse::<f64>().unwrap();
    let z: Vec<f64> = states.lines().skip(1).map(z).collect();
    // It sinks by 2.08 m, and the ground is at -0.25 m.
    let lowest_m = z.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((0.85..0.95).contains(&lowest_m), "{lowest_m} m");
    assert!((z.last().unwrap() - 3.0).abs() < 0.01, "{z:?}");
}

#[test]
fn the_fault_of_the_readme_shows_the_purpose_of_adaptation() {
    let fault = "--duration 60s --fault rotational_drag_nm_s=0.315@20s --recovered-below 0.002";
    let options = format!("{fault} --inner adaptive --inner fixed");
    let comparison = compared(&Rig::new("readme"), &options);
    let [adaptive, fixed] = ["adaptive", "fixed"].map(|inner| of(&comparison, "pd", inner));
    let worst_m = adaptive["error"]["worst_m"].as_f64().unwrap();
    assert!(
        (0.006..0.010).contains(&worst_m),
        "the fault is visible: {worst_m} m"
    );
    assert!(adaptive["recovery_s"][0].as_f64() < Some(6.0), "{adaptive}");
    assert_eq!(adaptive["effort"]["saturated_percent"], 0.0);
    let is_worse = worst_mm(fixed) > 80.0 && fixed["recovery_s"][0].is_null();
    assert!(is_worse, "{fixed}");
}
