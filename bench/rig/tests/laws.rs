//! Laws are chosen by name: they fly, are logged and replayed, and are described.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use crate::rig::Rig;

#[test]
fn the_list_and_each_law_are_described() {
    let rig = Rig::new("laws");
    let listed = rig.ok("laws").stdout;
    for words in [
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
        assert!(listed.contains(words), "no `{words}` in {listed}");
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

/// The columns of a CSV file.
fn columns(path: impl AsRef<std::path::Path>) -> BTreeMap<String, Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let names = lines.next().unwrap();
    let rows: Vec<Vec<String>> = lines.map(Iterator::collect).collect();
    let column = |i: usize| rows.iter().map(|row| row[i].clone()).collect();
    names
        .enumerate()
        .map(|(i, name)| (name, column(i)))
        .collect()
}

#[test]
fn without_adaptation_the_two_inner_laws_are_one() {
    let rig = Rig::new("same");
    let off = rig.settings("[inner]\nadaptation = \"off\"\n");
    let fly = |law: &str| {
        let states = rig.file("states.csv");
        rig.ok(&format!("simulate --duration 3s {law} --states {states}"));
        columns(states)
    };
    let (mut off, fixed) = (fly(&format!("--config {off}")), fly("--inner fixed"));
    // The estimates do not change, and are not compared with true values.
    for name in [
        "rotor_inertia_kg_m2",
        "rotational_drag_nm_s",
        "disturbance_gain_rad_s2",
    ] {
        let estimate = off.remove(&format!("inner_telemetry.{name}")).unwrap();
        assert!(estimate.iter().all(|value| *value == estimate[0]), "{name}");
    }
    assert!(off["t"].len() > 50 && off["IR_hat"].iter().all(String::is_empty));
    assert!(off == fixed, "the states of both flights");
}

/// Laws of a flight, and the signals of the outer and the inner one, each with its unit.
struct Signals {
    laws: [&'static str; 2],
    signals: [&'static str; 2],
    has_rate_error: bool,
    has_estimates: bool,
}

const RATE_ERROR: &str =
    "rate_error_x_rad_s [rad/s], rate_error_y_rad_s [rad/s], rate_error_z_rad_s [rad/s]";
const ACCELERATION: &str = "acceleration_wanted_x_m_s2 [m/s^2], acceleration_wanted_y_m_s2 [m/s^2], \
    acceleration_wanted_z_m_s2 [m/s^2]";

const ALL_SIGNALS: [Signals; 3] = [
    Signals {
        laws: ["pd", "adaptive"],
        signals: [
            ACCELERATION,
            "rate_error_x_rad_s [rad/s], rate_error_y_rad_s [rad/s], rate_error_z_rad_s [rad/s], \
             rotor_inertia_kg_m2 [kg m^2], rotational_drag_nm_s [N m s], disturbance_gain_rad_s2 [rad/s^2]",
        ],
        has_rate_error: true,
        has_estimates: true,
    },
    Signals {
        laws: ["estimating", "indi"],
        signals: [
            "thrust_scale [], mass_kg [kg], drag_1_s [1/s]",
            "acceleration_x_rad_s2 [rad/s^2], acceleration_y_rad_s2 [rad/s^2], acceleration_z_rad_s2 [rad/s^2], \
             torque_x_nm [N m], torque_y_nm [N m], torque_z_nm [N m], disturbance_x_rad_s2 [rad/s^2], \
             disturbance_y_rad_s2 [rad/s^2], disturbance_z_rad_s2 [rad/s^2]",
        ],
        has_rate_error: false,
        has_estimates: false,
    },
    Signals {
        laws: ["pd", "fixed"],
        signals: [ACCELERATION, RATE_ERROR],
        has_rate_error: true,
        has_estimates: false,
    },
];

#[test]
fn signals_have_their_names_everywhere_and_figures_without_data_are_left_out() {
    for case in &ALL_SIGNALS {
        let [outer, inner] = case.laws;
        let rig = Rig::new(&format!("signals-{inner}"));
        rig.ok(&format!(
            "fly --pace lockstep --duration 1s --outer {outer} --inner {inner} --every 1"
        ));
        rig.ok("replay --verify").says(", identical; outputs ");
        rig.ok("export");
        let latest = rig.out().join("latest");
        let states = columns(latest.join("states.csv"));
        let page = fs::read_to_string(latest.join("report.html")).unwrap();
        let (report, text) = (rig.report(), rig.ok("report --full").stdout);
        for (role, signals) in ["outer", "inner"].into_iter().zip(case.signals) {
            let exported = columns(latest.join(format!("export/{role}_telemetry.csv")));
            let section = report["run"]["laws"][role]["telemetry"].as_array().unwrap();
            let signals = signals.trim_end_matches(']').split("], ");
            let signals = signals.map(|signal| signal.split_once(" [").unwrap());
            let names: BTreeSet<&str> = signals
                .clone()
                .map(|(name, _)| name)
                .chain(["tick"])
                .collect();
            assert_eq!(
                exported.keys().map(String::as_str).collect::<BTreeSet<_>>(),
                names
            );
            assert_eq!(section.len(), names.len() - 1, "{inner}");
            for ((name, unit), row) in signals.zip(section) {
                assert_eq!((&row["name"], &row["unit"]), (&name.into(), &unit.into()));
                let values = exported[name]
                    .iter()
                    .map(|value| value.parse::<f64>().unwrap());
                assert_eq!(row["last"].as_f64(), values.clone().next_back(), "{name}");
                assert_eq!(row["max"].as_f64(), values.reduce(f64::max), "{name}");
                assert_eq!(
                    states[&format!("{role}_telemetry.{name}")],
                    exported[name],
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
        for (key, column, plots, exists) in [
            (
                "rate_error_final_rad_s",
                "e_p",
                &["rate-error"][..],
                case.has_rate_error,
            ),
            (
                "estimates",
                "kr_hat",
                &["k_r", "k_r-error"],
                case.has_estimates,
            ),
        ] {
            assert_eq!(
                report["flight"].get(key).is_some(),
                exists,
                "{key} of {inner}"
            );
            let is_empty = states[column].iter().all(String::is_empty);
            assert_eq!(is_empty, !exists, "{column} of {inner}");
            for plot in plots {
                let is_drawn = page.contains(&format!("data-plot=\"{plot}\""));
                assert_eq!(is_drawn, exists, "{plot} of {inner}");
            }
        }
        let svg = fs::read_to_string(latest.join("flight.svg")).unwrap();
        assert_eq!(svg.contains("estimate of k_r"), case.has_estimates);
        assert_eq!(svg.contains(">yaw<"), !case.has_estimates);
        if !case.has_estimates {
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
fn signals_of_two_flights_are_compared_if_both_have_them() {
    let rig = Rig::new("compared");
    let [adaptive, fixed, indi] = ["adaptive", "fixed", "indi"].map(|inner| {
        rig.ok(&format!(
            "fly --pace lockstep --duration 500ms --inner {inner}"
        ));
        rig.run_directories().pop().unwrap()
    });
    let name = "rate error, at the end [rad/s]";
    rig.ok(&format!("report diff {adaptive} {fixed}"))
        .says(name);
    let diff = rig.ok(&format!("report diff {fixed} {indi}")).stdout;
    let row = diff.lines().find(|line| line.contains(name)).unwrap_or("-");
    assert!(row.contains('-') && !row.contains(" 0 "), "{diff}");
}

#[test]
fn other_laws_fly_every_airframe_and_have_no_theorem() {
    let rig = Rig::new("besides");
    for airframe in ["paper", "crazyflie", "x500"] {
        for inner in ["geometric", "indi", "pid"] {
            let laws = format!("--outer estimating --inner {inner}");
            let flown = rig.ok(&format!(
                "simulate --airframe {airframe} {laws} --duration 12s"
            ));
            let why = format!("Theorem   not applicable: the inner law `{inner}` has no theorem");
            let flown = flown.says(&why);
            assert!(!flown.stdout.contains("estimated"), "{flown}");
        }
    }
    rig.refused("simulate --inner pid --gate theorem")
        .complains("the inner law `pid` has no theorem with these settings");
}
