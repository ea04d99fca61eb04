//! Laws that do what no law should: the report names each, the other roles end in order, and nothing is left.
//!
//! `law_matrix.md` has one row per harm; harms that need more than a row are tested below.

use crate::c_laws::{harmful, hostile, library, misbehaving};
use crate::rig::{Ended, Rig, in_parallel, lacks_feature, not_tested, table, wait_until};
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

/// Runs a command for 0.9 s with a law of `hostile.c`.
fn run(rig: &Rig, command: &str, harm: &str, from_tick: u64, options: &str) -> Ended {
    let config = hostile(rig, harm, from_tick);
    let args = format!("--config {config} --duration 900ms {options}");
    rig.run(command, args)
}

#[test]
fn a_law_that_crashes_in_a_warm_up_is_named_with_it() {
    let rig = Rig::new("copied");
    let config = misbehaving(&rig, "crash_when_copied", 300);
    let slow = fs::read_to_string(&config).unwrap();
    let slow = slow.replace("[inner]", "slowdown = 10\nduration_s = 0.1\n[inner]");
    let config = rig.settings(&slow);
    let ended = rig.run("fly", format!("--config {config} --rt off --lead 4000"));
    ended.expect(1).complains("/libmisbehaving.so) failed as it was copied for a rehearsal: SIGSEGV: it read or wrote where no memory is");
    rig.assert_nothing_left();
}

#[test]
fn a_flight_with_numbers_that_are_not_finite_is_replayed_and_compared() {
    let rig = Rig::new("nan");
    let flight = format!(
        "--config {} --duration 900ms",
        misbehaving(&rig, "nan", 300)
    );
    rig.ok(&format!("fly {flight} --pace lockstep"));
    rig.ok("replay --verify").tells("identical");
    rig.ok(&format!("compare {flight} --outer pd --outer estimating")).tells(
        "estimating + misbehaving: inner law `misbehaving` (libmisbehaving.so) gave a number that is not finite",
    );
}

#[test]
fn slow_laws_and_page_faults_are_found_in_the_report() {
    let rig = Rig::new("slow");
    let config = misbehaving(&rig, "slow", 0);
    rig.ok(&format!("fly --config {config} --duration 900ms --rt off"));
    let report = rig.report();
    let causes = report["autopsy"]["classes"].as_array().unwrap();
    // On a busy machine the law also waits for a processor.
    let mut causes = causes.iter();
    assert!(causes.any(|it| it["class"] == "computed_long" && it["stage"] == "inner"));

    let config = misbehaving(&rig, "fault", 300);
    rig.ok(&format!("fly --config {config} --duration 900ms"));
    let inner = &rig.report()["roles"]["inner"];
    let is_granted = |name: &str| {
        let mut steps = inner["realtime"].as_array().unwrap().iter();
        steps.any(|step| step["step"] == name && step["granted"] == true)
    };
    if !is_granted("memory_lock") || !is_granted("prefault") {
        return not_tested("memory could not be locked");
    }
    assert!(
        inner["usage"]["minor_faults"].as_u64() >= Some(300),
        "{inner}"
    );
    rig.ok("report --full")
        .tells("met memory that was not there: ");
}

#[test]
fn a_law_that_changes_the_rounding_changes_no_number_of_the_others() {
    let rig = Rig::new("rounds");
    let same = run(&rig, "simulate", "nothing", 0, "").expect(0);
    let rounds = run(&rig, "simulate", "round", 0, "").expect(0).complains(
        "left floating-point modes changed (rounding, small numbers or traps) after 901 of its ticks",
    );
    // It computes its answers before it changes the rounding.
    assert_eq!(rounds.result()["outputs"], same.result()["outputs"]);
    let flown = run(&rig, "fly", "round", 0, "--pace lockstep").expect(0);
    flown.complains("warning: the inner law `hostile`");
    rig.ok("replay --verify").tells("identical");
    let source = "bench/rig/tests/laws_c/hostile.c";
    let law = library(&rig, "librounding.so", source, &["-DALWAYS=ROUND"]);
    let ended = rig.run("laws", &law).expect(3);
    ended.tells("modes NO: the inner law `hostile`");
}

#[test]
fn telemetry_may_be_any_number() {
    let rig = Rig::new("large");
    let ended = run(&rig, "fly", "show", 300, "--pace lockstep").expect(0);
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    let signal = &rig.report()["run"]["laws"]["inner"]["telemetry"][0];
    assert_eq!(
        (&signal["min"], &signal["max"]),
        (&(-1e308).into(), &1e308.into())
    );
    rig.ok("report --full");
    rig.ok("report --section telemetry").tells("1.0000e308");
    rig.ok("replay --verify").tells("identical");
}

#[test]
fn a_child_of_a_law_ends_with_its_role_or_at_least_keeps_no_lock() {
    let rig = Rig::new("forks");
    run(&rig, "fly", "fork", 300, "--rt off").expect(0);
    rig.assert_nothing_left();
    run(&rig, "fly", "fork_away", 300, "--rt off").expect(0);
    run(&rig, "fly", "nothing", 0, "--rt off").expect(0);
}

#[test]
fn a_flight_continues_without_the_file_of_its_law_and_no_earlier_result_is_left() {
    let rig = Rig::with_features("deleted");
    let (config, results) = (hostile(&rig, "nothing", 0), rig.file("results.xml"));
    let flight = rig.take_off(format!("--config {config} --duration 2500ms --rt off"));
    // The parameters are active as soon as the plant flies; the others may still be loading the library.
    for role in ["inner", "record"] {
        let maps = format!("/proc/{}/maps", flight.roles()[role]);
        wait_until(&format!("{role} to load the law"), || {
            let maps = fs::read_to_string(&maps).unwrap();
            maps.contains("libhostile.so").then_some(())
        });
    }
    fs::remove_file(rig.file("libhostile.so")).unwrap();
    flight.end().expect(0);
    if !cfg!(feature = "instrumented") {
        return lacks_feature("results of a law that calls _exit()", "instrumented");
    }
    fs::write(&results, "of an earlier flight").unwrap();
    let junit = format!("--junit {results}");
    run(&rig, "fly", "exit_when_made", 0, &junit).expect(1);
    assert!(!rig.path("results.xml").exists());
}

#[test]
fn a_text_that_looks_like_a_number_remains_a_text_for_watchers() {
    let rig = Rig::new("words");
    let config = fs::read_to_string(hostile(&rig, "nothing", 0)).unwrap() + "level = \"2.5\"\n";
    let config = rig.settings(&config);
    let flight = rig.take_off(format!("--config {config} --duration 1s --rt off"));
    rig.ok("watch --plain").tells("completed");
    flight.end().expect(0);
}

#[test]
fn a_file_name_with_control_characters_is_refused_before_take_off() {
    let rig = Rig::new("control");
    hostile(&rig, "nothing", 0);
    let odd = rig.file("odd\n.so");
    fs::rename(rig.file("libhostile.so"), &odd).unwrap();
    let ended = rig.run("fly", ["--inner", &odd]).expect(2);
    ended.complains("odd\\n.so\": expected a text without control characters");
    rig.assert_nothing_started();
}

#[test]
fn a_law_that_takes_long_to_be_made_is_reported_meanwhile() {
    let rig = Rig::new("stays");
    let config = hostile(&rig, "wait_when_made", 0);
    let flight = rig.start("fly", format!("--config {config}"));
    flight.await_words("libhostile.so): it has not come back within 5s as it was made");
}
