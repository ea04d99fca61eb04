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
}
