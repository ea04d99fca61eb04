//! The tables of the laws are those that the command prints. `transcripts/studies.md` has the rest of comparisons.

use std::fs;

use crate::c_laws::root;
use crate::rig::Rig;

#[test]
#[ignore = "long: part of the gate"]
fn the_tables_of_the_laws_are_what_the_command_prints_today() {
    let table = fs::read_to_string(root().join("docs/faults-of-laws.txt")).unwrap();
    let page = fs::read_to_string(root().join("docs/laws.md")).unwrap();
    let (_, rest) = page.split_once("<!-- made by: ironbird ").unwrap();
    let (command, rest) = rest.split_once(" -->\n").unwrap();
    let quoted = rest.split_once("<!-- end -->").unwrap().0.trim();
    assert!(quoted.lines().count() > 15, "{quoted}");
    assert!(table.contains(quoted), "{quoted}");
    let (docs, rig) = (root().join("docs"), Rig::new("tables"));
    let command = command.replace("docs/", &format!("{}/", docs.display()));
    let printed = rig.ok(&command).stdout;
    assert!(
        printed == table,
        "docs/faults-of-laws.txt differs from `ironbird {command}`:\n{printed}"
    );

    // Rows that show the purpose of a law: errors with adaptive, fixed, geometric, indi, pid, l1, mrac, sliding and
    // adaptive_residual [mm].
    let row = |outer: &str, fault: &str| -> Vec<f64> {
        let (_, rows) = table.split_once(&format!("Outer law `{outer}`")).unwrap();
        let (_, row) = rows.split_once(&format!("|{fault}|")).unwrap();
        let number = |cell: &str| cell.trim_matches('*').split('/').next()?.parse().ok();
        let cells = row.split('|').take(9);
        cells
            .map(|cell| number(cell).unwrap_or(f64::INFINITY))
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
        let row = row("estimating", fault);
        assert!(
            row.iter().all(|error| row[8] < 1.05 * error),
            "{fault}: {row:?}"
        );
    }
    // The outer law `estimating` recovers from a larger mass with every law that follows it.
    for law in [0, 1, 3, 4] {
        assert!(row("estimating", "mass +30 %")[law] <= 50.0);
        assert!(row("pd", "mass +30 %")[law] > 1000.0);
    }
}
