//! Signals of laws have the same names and values in the report, the tables and the page.

use std::collections::BTreeMap;

use crate::rig::Rig;

fn columns(rig: &Rig, file: &str) -> BTreeMap<String, Vec<String>> {
    let text = rig.flown(file);
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let names = lines.next().unwrap();
    let rows: Vec<Vec<String>> = lines.map(Iterator::collect).collect();
    let column = |i: usize| rows.iter().map(|row| row[i].clone()).collect();
    names
        .enumerate()
        .map(|(i, name)| (name, column(i)))
        .collect()
}

/// Figures that need a rate error, and that need estimates: the key of the report, a column of states.csv, plots.
const FIGURES: [(&str, &str, &str); 2] = [
    ("rate_error_final_rad_s", "e_p", "rate-error"),
    ("estimates", "kr_hat", "k_r k_r-error"),
];

#[test]
fn signals_have_their_names_everywhere_and_figures_without_data_are_left_out() {
    for (outer, inner, signals, has_figures) in [
        ("pd", "adaptive", [3, 6], [true, true]),
        ("estimating", "indi", [3, 9], [false, false]),
        ("pd", "fixed", [3, 3], [true, false]),
    ] {
        let rig = Rig::new(&format!("signals-{inner}"));
        rig.ok(&format!(
            "fly --pace lockstep --duration 1s --outer {outer} --inner {inner} --every 1"
        ));
        rig.assert_replayed();
        rig.ok("export");
        let (states, page) = (columns(&rig, "states.csv"), rig.flown("report.html"));
        let (report, text) = (rig.report(), rig.ok("report --full").stdout);
        for (role, count) in ["outer", "inner"].into_iter().zip(signals) {
            let exported = columns(&rig, &format!("export/{role}_telemetry.csv"));
            let section = report["run"]["laws"][role]["telemetry"].as_array().unwrap();
            assert_eq!((section.len(), exported.len()), (count, count + 1));
            for row in section {
                let name = row["name"].as_str().unwrap();
                let values = exported[name].iter().map(|it| it.parse::<f64>().unwrap());
                assert_eq!(row["last"].as_f64(), values.clone().next_back(), "{name}");
                assert_eq!(row["max"].as_f64(), values.reduce(f64::max), "{name}");
                let column = &states[&format!("{role}_telemetry.{name}")];
                assert_eq!(column, &exported[name], "{name}");
                let plot = format!("data-plot=\"{role}-{name}\"");
                let line = format!("  {role} {name} ");
                assert!(page.contains(&plot) && text.contains(&line), "{name}");
            }
        }
        for ((key, column, plots), exists) in FIGURES.into_iter().zip(has_figures) {
            let what = format!("{key} of {inner}");
            assert_eq!(report["flight"].get(key).is_some(), exists, "{what}");
            let is_empty = states[column].iter().all(String::is_empty);
            assert_eq!(is_empty, !exists, "{what}");
            for plot in plots.split(' ') {
                let is_drawn = page.contains(&format!("data-plot=\"{plot}\""));
                assert_eq!(is_drawn, exists, "{plot} of {inner}");
            }
        }
        let [_, has_estimates] = has_figures;
        let svg = rig.flown("flight.svg");
        assert_eq!(svg.contains("estimate of k_r"), has_estimates);
        assert_eq!(svg.contains(">yaw<"), !has_estimates);
        if !has_estimates {
            let why = format!("the inner law `{inner}` has no theorem");
            let theorem = serde_json::json!({"law_without": inner, "not_applicable": why});
            assert_eq!(report["theorem"], theorem);
            assert!(page.contains(&format!("Theorem: not applicable: {why}")));
            assert!(text.contains(&format!("Theorem   not applicable: {why}\n")));
            assert!(!text.contains("estimated"), "{text}");
        }
    }
}
