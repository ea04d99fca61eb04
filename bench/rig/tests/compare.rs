//! Laws side by side: the flights are those of `simulate`, and the documents say what they say.

use std::fs;
use std::path::{Path, PathBuf};

use crate::rig::Rig;
use serde_json::Value;

/// Laws of the outer loop, and of the inner one.
const OUTER: [&str; 4] = ["--outer", "pd", "--outer", "estimating"];
const INNER: [&str; 10] = [
    "--inner",
    "adaptive",
    "--inner",
    "fixed",
    "--inner",
    "geometric",
    "--inner",
    "indi",
    "--inner",
    "pid",
];

fn ours(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path)
}

fn compared(rig: &Rig, options: &[&str]) -> Value {
    rig.run("compare", [options, &["--format", "json"]].concat())
        .expect(0)
        .json()
}

fn of<'a>(comparison: &'a Value, outer: &str, inner: &str) -> &'a Value {
    let is_it = |it: &&Value| it["laws"]["outer"] == outer && it["laws"]["inner"] == inner;
    comparison["outcomes"]
        .as_array()
        .unwrap()
        .iter()
        .find(is_it)
        .unwrap()
}

/// Its largest error from 5 s after the last fault on [mm].
fn worst_mm(outcome: &Value) -> f64 {
    1e3 * outcome["error_after"]["worst_m"].as_f64().unwrap()
}

#[test]
fn each_flight_is_the_simulated_one_bit_for_bit() {
    let rig = Rig::new("compared");
    let flight = [
        "--trajectory",
        "fast",
        "--airframe",
        "crazyflie",
        "--duration",
        "4s",
        "--seed",
        "7",
        "--fault",
        "gyro_noise_rad_s=0.01,command_delay_s=0.002@1s",
        "--fault",
        "mass_kg=+20%@2s",
    ];
    let laws = [
        "--outer",
        "pd",
        "--outer",
        "estimating",
        "--inner",
        "adaptive",
        "--inner",
        "indi",
    ];
    let comparison = compared(&rig, &[&flight[..], &laws].concat());
    assert_eq!(comparison["schema"], "ironbird-comparison/1");
    let outcomes = comparison["outcomes"].as_array().unwrap();
    let mut hashes = Vec::new();
    for (outcome, [outer, inner]) in outcomes.iter().zip([
        ["pd", "adaptive"],
        ["pd", "indi"],
        ["estimating", "adaptive"],
        ["estimating", "indi"],
    ]) {
        let laws = (
            outcome["laws"]["outer"].as_str().unwrap(),
            outcome["laws"]["inner"].as_str().unwrap(),
        );
        assert_eq!(laws, (outer, inner));
        let simulated = rig
            .run(
                "simulate",
                [&flight[..], &["--outer", outer, "--inner", inner]].concat(),
            )
            .expect(0)
            .result();
        assert_eq!(
            outcome["outputs"],
            simulated["outputs"].as_str(),
            "{outer} + {inner}"
        );
        assert_eq!(outcome["ticks"].to_string(), simulated["ticks"]);
        hashes.push(simulated["outputs"].clone());
    }
    assert_eq!(outcomes.len(), 4);
    hashes.sort();
    hashes.dedup();
    assert_eq!(
        hashes.len(),
        4,
        "four flights, and not one of them four times"
    );
    let other: Vec<&str> = flight
        .iter()
        .map(|word| if *word == "7" { "8" } else { word })
        .collect();
    let other = compared(&rig, &[&other[..], &laws].concat());
    assert_ne!(
        other["outcomes"][0]["outputs"], comparison["outcomes"][0]["outputs"],
        "the seed is heard"
    );
}

#[test]
fn a_comparison_says_when_each_law_had_recovered_and_why_one_was_lost() {
    let rig = Rig::new("told");
    let page = rig.file("page.html");
    let options = [
        "--inner",
        "adaptive",
        "--inner",
        "pid",
        "--outer",
        "pd",
        "--outer",
        "estimating",
        "--duration",
        "20s",
        "--fault",
        "rotational_drag_nm_s=+200%@6s",
        "--fault",
        "mass_kg=+30%@11s",
    ];
    let told = rig
        .run("compare", [&options[..], &["--page", &page]].concat())
        .expect(0);
    let told = told
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
    assert!(!told.stdout.contains("estimating + adaptive: "), "{told}");
    let comparison = compared(&rig, &options);
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
        assert_eq!(
            page.matches(&format!("class=\"line {class}\"")).count(),
            2,
            "{class}"
        );
    }
    assert!(!page.contains("://"), "the page loads nothing");
}

#[test]
fn a_flight_that_ends_early_says_when_and_without_a_fault_the_whole_is_told() {
    let rig = Rig::new("early");
    let comparison = rig.run(
        "compare",
        "--inner indi --inner pid --fault rotor_efficiency_1=0@2s",
    );
    comparison
        .expect(0)
        .says("pd + indi: ended at ")
        .says("the flight left its envelope: at tick")
        .says("  -  ");
    let calm = rig.ok("compare --inner indi --inner pid --duration 2s");
    let calm = calm.says("All 2 flew to the end\n");
    assert!(
        !calm.stdout.contains("Recovered") && !calm.stdout.contains("before"),
        "{calm}"
    );
}

/// The table of a document, between the line that says how it was made and the one that ends it.
fn table_of(document: &str) -> (Vec<String>, String) {
    let (_, rest) = document.split_once("<!-- made by: ironbird ").unwrap();
    let (command, rest) = rest.split_once(" -->\n").unwrap();
    let (table, _) = rest.split_once("<!-- end -->").unwrap();
    (
        command.split_whitespace().map(str::to_owned).collect(),
        table.trim().to_owned() + "\n",
    )
}

#[test]
fn the_tables_of_the_laws_are_what_the_command_makes_today() {
    let rig = Rig::new("tables");
    let (command, quoted) = table_of(&fs::read_to_string(ours("docs/laws.md")).unwrap());
    let table = fs::read_to_string(ours("docs/faults-of-laws.txt")).unwrap();
    assert!(quoted.lines().count() > 15, "{quoted}");
    assert!(
        table.contains(&quoted),
        "docs/faults-of-laws.txt has no such table:\n{quoted}"
    );
    let file = ours("docs/faults-of-laws.toml");
    let options: Vec<&str> = command[1..]
        .iter()
        .map(|word| {
            if word == "docs/faults-of-laws.toml" {
                file.to_str().unwrap()
            } else {
                word
            }
        })
        .collect();
    assert_eq!(command[0], "compare");
    let made = rig.run("compare", &options).expect(0);
    assert!(
        made.stdout == table,
        "docs/faults-of-laws.txt is not what this makes: ironbird {}\n{}",
        command.join(" "),
        made.stdout
    );

    // Rows that speak of a law's purpose.
    let cells = |outer: &str, fault: &str| -> Vec<f64> {
        let (_, rest) = table.split_once(&format!("Outer law `{outer}`")).unwrap();
        let row = rest
            .lines()
            .find(|line| line.starts_with(&format!("| {fault} |")))
            .unwrap();
        let first = |cell: &str| {
            cell.trim()
                .trim_matches('*')
                .split(' ')
                .next()
                .unwrap()
                .parse()
                .unwrap_or(f64::INFINITY)
        };
        row.trim_matches('|')
            .split('|')
            .skip(1)
            .map(first)
            .collect()
    };
    for outer in ["pd", "estimating"] {
        for fault in [
            "disturbance delta x 10",
            "drag k_r x 5",
            "inertia of the body x 2",
            "arm -30 %",
            "rotor 1 -30 %",
        ] {
            let [_, fixed, _, indi, _] = cells(outer, fault)[..] else {
                panic!("five laws")
            };
            assert!(
                indi < fixed,
                "{outer}, {fault}: indi {indi} mm, fixed {fixed} mm"
            );
        }
    }
}

#[test]
fn estimating_is_back_within_5_cm_after_the_mass_has_grown() {
    let rig = Rig::new("heavier");
    let fault = ["--trajectory", "lissajous", "--fault", "mass_kg=+30%@8s"];
    let comparison = compared(&rig, &[&OUTER[..], &INNER, &fault].concat());
    for inner in ["adaptive", "fixed", "indi", "pid"] {
        let outcome = of(&comparison, "estimating", inner);
        assert!(
            worst_mm(outcome) <= 50.0 && outcome["lost"].is_null(),
            "{inner}: {} mm",
            worst_mm(outcome)
        );
        assert!(worst_mm(of(&comparison, "pd", inner)) > 1000.0, "{inner}");
    }
}

#[test]
fn indi_beats_a_fixed_model_on_each_disturbance_it_is_made_for() {
    let rig = Rig::new("disturbed");
    for fault in [
        "disturbance_gain_rad_s2=2@8s",
        "rotational_drag_nm_s=+400%@8s",
        "inertia_x_kg_m2=+100%,inertia_y_kg_m2=+100%@8s",
        "rotor_efficiency_1=-30%@8s",
        "arm_length_m=-30%@8s",
    ] {
        let laws = [
            "--outer",
            "estimating",
            "--inner",
            "indi",
            "--inner",
            "fixed",
            "--fault",
            fault,
        ];
        let comparison = compared(&rig, &laws);
        let [indi, fixed] =
            ["indi", "fixed"].map(|inner| worst_mm(of(&comparison, "estimating", inner)));
        assert!(
            indi < fixed / 3.0,
            "{fault}: indi {indi} mm, fixed {fixed} mm"
        );
    }
}

#[test]
fn geometric_recovers_from_a_roll_of_170_degrees_above_a_ground_and_the_others_crash() {
    let rig = Rig::new("upside-down");
    let (settings, stay) = (ours("examples/upside_down.toml"), ours("examples/stay.csv"));
    let flight = [
        "--config",
        settings.to_str().unwrap(),
        "--trajectory",
        stay.to_str().unwrap(),
        "--duration",
        "12s",
    ];
    let comparison = compared(&rig, &[&flight[..], &INNER].concat());
    let geometric = of(&comparison, "pd", "geometric");
    assert_eq!(
        (&geometric["lost"], &geometric["ticks"]),
        (&Value::Null, &12_001.into())
    );
    for inner in ["adaptive", "fixed", "indi", "pid"] {
        let lost = of(&comparison, "pd", inner)["lost"]
            .as_str()
            .unwrap_or_default();
        assert!(lost.contains("it crashed"), "{inner}: {lost}");
    }
    let states = rig.file("states.csv");
    let alone = ["--inner", "geometric", "--states", &states, "--every", "1"];
    rig.run("simulate", [&flight[..], &alone].concat())
        .expect(0);
    let states = fs::read_to_string(states).unwrap();
    let z: Vec<f64> = states
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(3).unwrap().parse().unwrap())
        .collect();
    let lowest_m = z.iter().copied().fold(f64::INFINITY, f64::min);
    // It sinks by 2.08 m, and the ground is at -0.25 m.
    assert!((0.85..0.95).contains(&lowest_m), "{lowest_m} m");
    assert!((z.last().unwrap() - 3.0).abs() < 0.01, "{z:?}");
}

#[test]
fn the_fault_of_the_readme_shows_what_adaptation_is_for() {
    let rig = Rig::new("readme");
    let fault = [
        "--duration",
        "60s",
        "--fault",
        "rotational_drag_nm_s=0.315@20s",
        "--recovered-below",
        "0.002",
    ];
    let comparison = compared(
        &rig,
        &[&fault[..], &["--inner", "adaptive", "--inner", "fixed"]].concat(),
    );
    let [adaptive, fixed] = ["adaptive", "fixed"].map(|inner| of(&comparison, "pd", inner));
    let worst_m = adaptive["error"]["worst_m"].as_f64().unwrap();
    assert!((0.006..0.010).contains(&worst_m), "it is seen: {worst_m} m");
    assert!(
        adaptive["recovery_s"][0].as_f64().unwrap() < 6.0,
        "{adaptive}"
    );
    assert_eq!(adaptive["effort"]["saturated_percent"], 0.0);
    assert!(
        worst_mm(fixed) > 80.0 && fixed["recovery_s"][0].is_null(),
        "{}",
        worst_mm(fixed)
    );
}
