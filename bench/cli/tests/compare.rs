//! Laws side by side: the flights are those of `simulate`, and the documents show what was measured.

use std::fs;

use crate::c_laws::root;
use crate::rig::Rig;

/// The table of a page, and the command that it names.
fn quoted(page: &str) -> (String, String) {
    let document = fs::read_to_string(root().join(page)).unwrap();
    let (_, rest) = document.split_once("<!-- made by: ironbird ").unwrap();
    let (command, rest) = rest.split_once(" -->\n").unwrap();
    let (quoted, _) = rest.split_once("<!-- end -->").unwrap();
    assert!(quoted.lines().count() > 15, "{quoted}");
    (command.to_owned(), quoted.trim().to_owned())
}

#[test]
fn the_table_of_robustness_is_what_the_command_prints_today() {
    let (command, table) = quoted("docs/robustness.md");
    let rig = Rig::new("robustness");
    let (picture, csv) = (rig.file("r.svg"), rig.file("r.csv"));
    let printed = rig
        .ok(&format!("{command} --picture {picture} --csv {csv}"))
        .stdout;
    assert_eq!(printed.trim(), table, "run `ironbird {command}` again");
    let drawn = fs::read_to_string(picture).unwrap();
    let kept = fs::read_to_string(root().join("docs/robustness.svg")).unwrap();
    assert!(
        drawn == kept,
        "docs/robustness.svg is not what `ironbird {command}` draws"
    );
    let csv = fs::read_to_string(csv).unwrap();
    let cells = |line: &str| line.split(',').count();
    let columns = csv.lines().next().map_or(0, cells);
    assert!(csv.lines().count() > 100 && csv.lines().all(|line| cells(line) == columns));
}

#[test]
fn the_tables_of_the_laws_are_what_the_command_prints_today() {
    let table = fs::read_to_string(root().join("docs/faults-of-laws.txt")).unwrap();
    let (command, quoted) = quoted("docs/laws.md");
    assert!(table.contains(&quoted), "{quoted}");
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
        let cells = row.split('|').take(9);
        let numbers = cells.map(|cell| cell.trim().trim_matches('*').split('/').next());
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
