//! Laws that do what no law should: the report names each, the other roles end in order, and nothing is left.
//!
//! `law_matrix.md` has one row per harm; harms that need more than a row are in `transcripts/law_files.md`.

use crate::c_laws::harmful;
use crate::rig::{Rig, in_parallel, lacks_feature, not_tested, table};
use std::fs;

/// Runs the rows of the matrix with these needs, three at a time or one after the other.
fn run_rows(needs: &[&str], one_after_the_other: bool) {
    let rows = table::<6>(include_str!("law_matrix.md")).into_iter();
    let mut rows = rows.filter(|row| needs.contains(&row[5]));
    match one_after_the_other {
        true => rows.for_each(|row| run_row(&row)),
        false => in_parallel(&mut rows, run_row),
    }
}

fn run_row(&[law, command, exit, error, report, needs]: &[&str; 6]) {
    let [source, how, tick] = law.split(' ').collect::<Vec<_>>()[..] else {
        panic!("{law}")
    };
    if needs == "instrumented" && !cfg!(feature = "instrumented") {
        return lacks_feature(&format!("a law that does {how}"), "instrumented");
    }
    let rig = Rig::with_features("law");
    let config = harmful(&rig, source, how, tick.parse().unwrap());
    let (command, options) = command.split_once(' ').unwrap_or((command, ""));
    let mut ended = rig.run(
        command,
        format!("--config {config} --duration 900ms {options}"),
    );
    let has_report = rig.out().join("latest").exists();
    if needs == "fifo" && rig.report()["roles"]["inner"]["scheduling"] == "other" {
        return not_tested("SCHED_FIFO was not granted");
    }
    assert_eq!(ended.code, exit.parse().ok(), "{law}, {ended}");
    if ended.code == Some(1) && has_report {
        let report = rig.report();
        assert_eq!(report["verdict"]["status"], "ABORTED", "{ended}");
        assert_eq!(report["roles"]["plant"]["landed"], true, "{ended}");
    }
    let file = format!("lib{source}.so");
    let path = fs::canonicalize(rig.file(&file)).unwrap();
    let named = |path: &str| format!("inner law `{source}` ({path})");
    ended = ended.complains(&error.replace("LAW", &named(path.to_str().unwrap())));
    if command == "fly" && has_report {
        ended = rig.ok("report --full");
    }
    let words = report.replace("NAMED", &named(&file));
    match words.strip_prefix("not ") {
        Some(absent) => assert!(!ended.stdout.contains(absent), "{ended}"),
        None => drop(ended.tells(&words)),
    }
    rig.assert_nothing_left();
}

#[test]
fn every_harm_is_named_and_nothing_is_left() {
    run_rows(&["", "instrumented"], false);
}

/// One after the other: two laws that loop in real time would take each other's processor.
#[test]
fn an_endless_law_is_ended_under_real_time_scheduling() {
    run_rows(&["fifo"], true);
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_that_never_returns_is_named_and_ended() {
    run_rows(&["long"], false);
}
