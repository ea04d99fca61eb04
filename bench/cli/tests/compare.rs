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

    // What docs/laws.md says of `adaptive_residual`, the last law, under `estimating`.
    let (_, rows) = table.split_once("Outer law `estimating`").unwrap();
    let errors = |row: &str| -> Vec<f64> {
        let cells = row.split('|').skip(2).take(9);
        let numbers = cells.map(|cell| cell.trim_matches('*').split('/').next()?.parse().ok());
        numbers.flatten().collect()
    };
    let rows: Vec<_> = rows.lines().skip(4).take(17).map(errors).collect();
    let survived: Vec<_> = rows.iter().filter(|row| row.len() == 9).collect();
    let is_best = |row: &&&Vec<f64>| row.iter().all(|error| row[8] <= 1.05 * error);
    let best = survived.iter().filter(is_best).count();
    assert_eq!((best, survived.len()), (14, 16), "{rows:?}");
}
