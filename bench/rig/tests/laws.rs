//! Laws are chosen by name: they fly, are logged and replayed, and say what they are.

use std::collections::{BTreeMap, BTreeSet};

use crate::rig::Rig;

#[test]
fn the_list_and_each_law_say_what_there_is() {
    let rig = Rig::new("laws");
    let listed = rig.ok("laws");
    for said in [
        "outer  pd ",
        "outer  estimating ",
        "inner  adaptive ",
        "inner  fixed ",
        "inner  geometric ",
        "inner  indi ",
        "inner  pid ",
        "mixer  priority ",
        "Imran and Montazeri",
        "arXiv:1003.2005",
    ] {
        assert!(listed.stdout.contains(said), "{said}: {listed}");
    }
    rig.ok("laws adaptive")
        .says("Settings, in the section [inner]")
        .says("alpha_1_s = 200.0 [1/s]")
        .says("alpha, decay of the rate error; allowed: a finite number above 0")
        .says("adaptation = \"on\"")
        .says("Preset soft")
        .says("rotor_inertia_kg_m2 [kg m^2]");
    rig.ok("laws priority").says("  none\n");
    rig.assert_nothing_started();
}

#[test]
fn without_adaptation_the_two_inner_laws_are_one() {
    let rig = Rig::new("same");
    let off = rig.settings("[inner]\nadaptation = \"off\"\n");
    let (one, other) = (rig.file("off.csv"), rig.file("fixed.csv"));
    rig.ok(&format!(
        "simulate --duration 3s --config {off} --states {one}"
    ));
    rig.ok(&format!(
        "simulate --duration 3s --inner fixed --states {other}"
    ));
    let [mut one, other] = [one, other].map(|path| columns(&path));
    // It has estimates that do not move, and no truth is held against them.
    for name in [
        "rotor_inertia_kg_m2",
        "rotational_drag_nm_s",
        "disturbance_gain_rad_s2",
    ] {
        let estimate = one.remove(&format!("inner_telemetry.{name}")).unwrap();
        assert!(estimate.iter().all(|value| *value == estimate[0]), "{name}");
    }
    assert!(
        one["t"].len() > 50 && one["IR_hat"].iter().all(String::is_empty),
        "{:?}",
        one["IR_hat"]
    );
    assert!(one == other, "the states of both flights");
}

/// The columns of a CSV file.
fn columns(path: &str) -> BTreeMap<String, Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').map(str::to_owned);
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    names
        .enumerate()
        .map(|(i, name)| (name, rows.iter().map(|row| row[i].to_owned()).collect()))
        .collect()
}

/// What a flight with two laws shows of them, wherever it is looked at.
struct Shown {
    laws: [&'static str; 2],
    /// Signals of outer and inner law, each with its unit.
    signals: [&'static [(&'static str, &'static str)]; 2],
    has_rate_error: bool,
    has_estimates: bool,
}

const RATE_ERROR: [(&str, &str); 3] = [
    ("rate_error_x_rad_s", "rad/s"),
    ("rate_error_y_rad_s", "rad/s"),
    ("rate_error_z_rad_s", "rad/s"),
];
const WANTED: [(&str, &str); 3] = [
    ("acceleration_wanted_x_m_s2", "m/s^2"),
    ("acceleration_wanted_y_m_s2", "m/s^2"),
    ("acceleration_wanted_z_m_s2", "m/s^2"),
];

const ALL_SHOWN: [Shown; 3] = [
    Shown {
        laws: ["pd", "adaptive"],
        signals: [
            &WANTED,
            &[
                RATE_ERROR[0],
                RATE_ERROR[1],
                RATE_ERROR[2],
                ("rotor_inertia_kg_m2", "kg m^2"),
                ("rotational_drag_nm_s", "N m s"),
                ("disturbance_gain_rad_s2", "rad/s^2"),
            ],
        ],
        has_rate_error: true,
        has_estimates: true,
    },
    Shown {
        laws: ["estimating", "indi"],
        signals: [
            &[("thrust_scale", ""), ("mass_kg", "kg"), ("drag_1_s", "1/s")],
            &[
                ("acceleration_x_rad_s2", "rad/s^2"),
                ("acceleration_y_rad_s2", "rad/s^2"),
                ("acceleration_z_rad_s2", "rad/s^2"),
                ("torque_x_nm", "N m"),
                ("torque_y_nm", "N m"),
                ("torque_z_nm", "N m"),
                ("disturbance_x_rad_s2", "rad/s^2"),
                ("disturbance_y_rad_s2", "rad/s^2"),
                ("disturbance_z_rad_s2", "rad/s^2"),
            ],
        ],
        has_rate_error: false,
        has_estimates: false,
    },
    Shown {
        laws: ["pd", "fixed"],
        signals: [&WANTED, &RATE_ERROR],
        has_rate_error: true,
        has_estimates: false,
    },
];

#[test]
fn what_laws_show_has_their_names_everywhere_and_nothing_is_said_that_nobody_measured() {
    for shown in &ALL_SHOWN {
        let [outer, inner] = shown.laws;
        let rig = Rig::new(&format!("shows-{inner}"));
        let options =
            format!("--pace lockstep --duration 1s --outer {outer} --inner {inner} --every 1");
        rig.run("fly", &options).expect(0);
        rig.ok("replay --verify").says(", identical; outputs ");
        let latest = rig.out().join("latest");
        rig.ok("export");
        let states = columns(latest.join("states.csv").to_str().unwrap());
        let (report, page) = (
            rig.report(),
            std::fs::read_to_string(latest.join("report.html")).unwrap(),
        );
        let text = rig.ok("report --full").stdout;
        for (role, signals) in ["outer", "inner"].into_iter().zip(shown.signals) {
            let file = latest.join(format!("export/{role}_telemetry.csv"));
            let exported = columns(file.to_str().unwrap());
            let names = signals.iter().map(|(name, _)| *name).chain(["tick"]);
            let exported_names = exported.keys().map(String::as_str);
            assert_eq!(
                exported_names.collect::<BTreeSet<_>>(),
                names.collect(),
                "{inner}"
            );
            let section = &report["run"]["laws"][role]["telemetry"];
            assert_eq!(section.as_array().unwrap().len(), signals.len(), "{inner}");
            for (i, (name, unit)) in signals.iter().enumerate() {
                assert_eq!(
                    (&section[i]["name"], &section[i]["unit"]),
                    (&(*name).into(), &(*unit).into())
                );
                let values: Vec<f64> = exported[*name]
                    .iter()
                    .map(|value| value.parse().unwrap())
                    .collect();
                assert_eq!(section[i]["last"], *values.last().unwrap(), "{name}");
                assert_eq!(
                    section[i]["max"],
                    values.iter().copied().fold(f64::MIN, f64::max),
                    "{name}"
                );
                assert_eq!(
                    states[&format!("{role}_telemetry.{name}")],
                    exported[*name],
                    "{name}"
                );
                assert!(
                    page.contains(&format!("data-plot=\"{role}-{name}\"")),
                    "{name}"
                );
                assert!(
                    text.contains(&format!("  {role} {name} ")),
                    "{name} in {text}"
                );
            }
        }
        let flight = &report["flight"];
        let is_empty = |column: &str| states[column].iter().all(String::is_empty);
        for (key, column, is_there) in [
            ("rate_error_final_rad_s", "e_p", shown.has_rate_error),
            ("estimates", "kr_hat", shown.has_estimates),
        ] {
            assert_eq!(flight.get(key).is_some(), is_there, "{key}: {flight}");
            assert_eq!(is_empty(column), !is_there, "{column} of {inner}");
        }
        for (plot, is_there) in [
            ("rate-error", shown.has_rate_error),
            ("k_r", shown.has_estimates),
            ("k_r-error", shown.has_estimates),
        ] {
            assert_eq!(
                page.contains(&format!("data-plot=\"{plot}\"")),
                is_there,
                "{plot} of {inner}"
            );
        }
        let svg = std::fs::read_to_string(latest.join("flight.svg")).unwrap();
        assert_eq!(
            (svg.contains("estimate of k_r"), svg.contains(">yaw<")),
            (shown.has_estimates, !shown.has_estimates)
        );
        if !shown.has_estimates {
            let why = format!("the inner law `{inner}` has no theorem");
            let theorem = serde_json::json!({"law_without": inner, "not_applicable": why});
            assert_eq!(report["theorem"], theorem);
            assert!(page.contains(&format!("Theorem: not applicable: {why}")));
            assert!(
                text.contains(&format!("Theorem   not applicable: {why}\n")),
                "{text}"
            );
            assert!(!text.contains("estimated"), "{text}");
        }
    }
}

#[test]
fn the_laws_of_a_flight_are_compared_where_both_show_the_same() {
    let rig = Rig::new("compared");
    let flown = ["adaptive", "fixed", "indi"].map(|inner| {
        rig.ok(&format!(
            "fly --pace lockstep --duration 500ms --inner {inner}"
        ));
        rig.out()
            .join("latest")
            .canonicalize()
            .unwrap()
            .to_str()
            .unwrap()
            .to_owned()
    });
    let name = "rate error, at the end [rad/s]";
    let compared = rig.ok(&format!("report diff {} {}", flown[0], flown[1]));
    compared.says(name);
    let compared = rig.ok(&format!("report diff {} {}", flown[1], flown[2]));
    let row = compared.stdout.lines().find(|line| line.contains(name));
    assert!(
        row.is_none_or(|row| row.contains('-') && !row.contains(" 0 ")),
        "{compared}"
    );
}

#[test]
fn laws_besides_the_papers_fly_every_airframe_and_have_no_theorem() {
    let rig = Rig::new("besides");
    for airframe in ["paper", "crazyflie", "x500"] {
        for inner in ["geometric", "indi", "pid"] {
            let options =
                format!("--airframe {airframe} --outer estimating --inner {inner} --duration 12s");
            let flown = rig.run("simulate", &options).expect(0);
            let flown = flown.says(&format!(
                "Theorem   not applicable: the inner law `{inner}` has no theorem"
            ));
            assert!(!flown.stdout.contains("estimated"), "{flown}");
        }
    }
    let gate = rig.refused("simulate --inner pid --gate theorem");
    gate.complains("the inner law `pid` has no theorem with these settings");
}
