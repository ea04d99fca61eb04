//! Laws that do what no law should: the report names each, the other roles end in order, and nothing is left.
//!
//! `law_matrix.md` has one row per harm; harms that need more than a row are in `transcripts/law_files.md`.

use crate::c_laws::harmful;
use crate::rig::{Rig, in_parallel, lacks_feature, not_tested, table};
use std::fs;

/// The rows of the matrix with these needs.
fn rows(needs: &[&str]) -> impl Iterator<Item = [&'static str; 6]> + Send {
    let rows = table(include_str!("law_matrix.md")).into_iter();
    rows.filter(move |row: &[_; 6]| needs.contains(&row[5]))
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
    in_parallel(rows(&["", "instrumented"]), run_row);
}

/// One after the other: two laws that loop in real time would take each other's processor.
#[test]
fn an_endless_law_is_ended_under_real_time_scheduling() {
    rows(&["fifo"]).for_each(|row| run_row(&row));
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_that_never_returns_is_named_and_ended() {
    in_parallel(rows(&["long"]), run_row);
}
