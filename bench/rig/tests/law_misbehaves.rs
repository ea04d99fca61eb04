//! Laws that do what no law should: the report names each, the other roles end in order, and nothing is left.
//!
//! `law_matrix.md` has one row per harm; what needs more than a row is tested below.

use crate::c_laws::{self, hostile, misbehaving};
use crate::rig::{self, Ended, Rig, in_parallel, lacks_feature, not_tested, table};
use std::fs;

struct Row {
    law: [&'static str; 3],
    command: &'static str,
    exit: Option<i32>,
    error: &'static str,
    report: &'static str,
    needs: &'static str,
}

fn rows(needs: &[&str]) -> impl Iterator<Item = Row> {
    let row = |[law, command, exit, error, report, needs]: [&'static str; 6]| Row {
        law: law.split(' ').collect::<Vec<_>>().try_into().unwrap(),
        command,
        exit: exit.parse().ok(),
        error,
        report,
        needs,
    };
    let rows = table(include_str!("law_matrix.md")).into_iter().map(row);
    rows.filter(|row| needs.contains(&row.needs))
}

impl Row {
    fn run(&self) {
        let [source, how, tick] = self.law;
        if self.needs == "instrumented" && !cfg!(feature = "instrumented") {
            return lacks_feature(&format!("a law that does {how}"), "instrumented");
        }
        let rig = Rig::with_features("law");
        let make = if source == "hostile" {
            hostile
        } else {
            misbehaving
        };
        let config = make(&rig, how, tick.parse().unwrap());
        let (command, options) = self.command.split_once(' ').unwrap_or((self.command, ""));
        let args = format!("--config {config} --duration 900ms {options}");
        let mut ended = rig.run(command, args);
        let has_report = rig.out().join("latest").exists();
        if self.needs == "fifo" && rig.report()["roles"]["inner"]["scheduling"] == "other" {
            return not_tested("SCHED_FIFO was not granted");
        }
        assert_eq!(ended.code, self.exit, "{:?}, {ended}", self.law);
        if ended.code == Some(1) && has_report {
            assert_eq!(rig.report()["verdict"]["status"], "ABORTED", "{ended}");
            assert_eq!(rig.report()["roles"]["plant"]["landed"], true, "{ended}");
        }
        let file = format!("lib{source}.so");
        let law = |path: &str| format!("inner law `{source}` ({path})");
        let path = fs::canonicalize(rig.file(&file)).unwrap();
        let error = self.error.replace("LAW", &law(path.to_str().unwrap()));
        ended = ended.complains(&error);
        if command == "fly" && has_report {
            ended = rig.ok("report --full");
        }
        let words = self.report.replace("NAMED", &law(&file));
        match words.strip_prefix("not ") {
            Some(absent) => assert!(!ended.stdout.contains(absent), "{ended}"),
            None => drop(ended.tells(&words)),
        }
        rig.assert_nothing_left();
    }
}

#[test]
fn every_harm_is_named_and_nothing_is_left() {
    in_parallel(rows(&["", "instrumented"]), |row| row.run());
}

/// One after the other: two laws that loop in real time would take each other's processor.
#[test]
fn a_law_without_an_end_is_ended_under_real_time_scheduling() {
    rows(&["fifo"]).for_each(|row| row.run());
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_that_never_comes_back_is_named_and_ended() {
    in_parallel(rows(&["long"]), |row| row.run());
}

fn run(rig: &Rig, command: &str, harm: &str, from_tick: u64, options: &str) -> Ended {
    let config = hostile(rig, harm, from_tick);
    rig.run(
        command,
        format!("--config {config} --duration 900ms {options}"),
    )
}

#[test]
fn a_law_that_crashes_in_a_rehearsal_is_named_with_it() {
    let rig = Rig::new("copied");
    let config = misbehaving(&rig, "crash_when_copied", 300);
    let slow = fs::read_to_string(&config)
        .unwrap()
        .replace("[inner]", "slowdown = 10\nduration_s = 0.1\n[inner]");
    let ended = rig
        .run(
            "fly",
            format!("--config {} --rt off --lead 4000", rig.settings(&slow)),
        )
        .expect(1);
    ended.complains("/libmisbehaving.so) failed as it was copied for a rehearsal: SIGSEGV: it read or wrote where no memory is");
    rig.assert_nothing_left();
}

#[test]
fn a_flight_with_numbers_that_are_none_is_replayed_and_compared() {
    let rig = Rig::new("nan");
    let config = misbehaving(&rig, "nan", 300);
    rig.ok(&format!(
        "fly --config {config} --duration 900ms --pace lockstep"
    ));
    rig.ok("replay --verify").tells("identical");
    let both = format!("--config {config} --duration 900ms --outer pd --outer estimating");
    rig.run("compare", &both).expect(0).tells(
        "estimating + misbehaving: inner law `misbehaving` (libmisbehaving.so) gave a number that is not finite",
    );
}

#[test]
fn a_law_that_always_computes_longer_than_a_tick_is_what_deadlines_were_missed_for() {
    let rig = Rig::new("slow");
    let config = misbehaving(&rig, "slow", 0);
    rig.ok(&format!("fly --config {config} --duration 900ms --rt off"));
    let report = rig.report();
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    // Where the machine is busy, the law also waits for a processor.
    assert!(
        classes
            .iter()
            .any(|it| it["class"] == "computed_long" && it["stage"] == "inner"),
        "{classes:?}"
    );
}

#[test]
fn a_law_that_meets_memory_that_is_not_there_is_named_where_memory_was_locked() {
    let rig = Rig::new("faults");
    let config = misbehaving(&rig, "fault", 300);
    rig.ok(&format!("fly --config {config} --duration 900ms"));
    let inner = &rig.report()["roles"]["inner"];
    let steps = inner["realtime"].as_array().unwrap();
    let is_granted = |name: &str| {
        steps
            .iter()
            .any(|step| step["step"] == name && step["granted"] == true)
    };
    if !is_granted("memory_lock") || !is_granted("prefault") {
        return not_tested("memory could not be locked");
    }
    assert!(
        inner["usage"]["minor_faults"].as_u64().unwrap() >= 300,
        "{inner}"
    );
    rig.ok("report --full")
        .tells("met memory that was not there: ");
}

#[test]
fn a_law_that_rounds_otherwise_changes_no_number_of_the_others() {
    let rig = Rig::new("rounds");
    let same = run(&rig, "simulate", "nothing", 0, "").expect(0);
    let warns = "left floating-point modes changed (rounding, small numbers or traps) after 901 of its ticks";
    let rounds = run(&rig, "simulate", "round", 0, "")
        .expect(0)
        .complains(warns);
    assert_eq!(
        rounds.result()["outputs"],
        same.result()["outputs"],
        "its answers are made before it rounds otherwise"
    );
    run(&rig, "fly", "round", 0, "--pace lockstep")
        .expect(0)
        .complains("warning: the inner law `hostile`");
    rig.ok("replay --verify").tells("identical");
    let source = "bench/rig/tests/laws_c/hostile.c";
    let law = c_laws::library(&rig, "librounding.so", source, &["-DALWAYS=ROUND"]);
    rig.run("laws", &law)
        .expect(3)
        .tells("modes NO: the inner law `hostile`");
}

#[test]
fn telemetry_may_be_any_number() {
    let rig = Rig::new("large");
    let ended = run(&rig, "fly", "show", 300, "--pace lockstep").expect(0);
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    let shown = rig.report()["run"]["laws"]["inner"]["telemetry"][0].clone();
    assert_eq!(
        (shown["min"].as_f64(), shown["max"].as_f64()),
        (Some(-1e308), Some(1e308))
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
fn a_flight_goes_on_without_the_file_of_its_law_and_its_result_is_no_earlier_one() {
    let rig = Rig::with_features("deleted");
    let (config, results) = (hostile(&rig, "nothing", 0), rig.file("results.xml"));
    let flight = rig.take_off(format!("--config {config} --duration 2500ms --rt off"));
    // The parameters are active as soon as the plant flies; the others may still be loading the library.
    for role in ["inner", "record"] {
        let maps = format!("/proc/{}/maps", flight.roles()[role]);
        rig::wait_until(&format!("{role} to load the law"), || {
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
    run(
        &rig,
        "fly",
        "exit_when_made",
        0,
        &format!("--junit {results}"),
    )
    .expect(1);
    assert!(!rig.path("results.xml").exists());
}

#[test]
fn a_word_that_looks_like_a_number_is_no_number_to_whoever_watches() {
    let rig = Rig::new("words");
    let config = fs::read_to_string(hostile(&rig, "nothing", 0)).unwrap() + "level = \"2.5\"\n";
    let flight = rig.take_off(format!(
        "--config {} --duration 1s --rt off",
        rig.settings(&config)
    ));
    rig.ok("watch --plain").tells("completed");
    flight.end().expect(0);
}

#[test]
fn a_file_whose_name_has_control_characters_is_refused_before_take_off() {
    let rig = Rig::new("control");
    hostile(&rig, "nothing", 0);
    let odd = rig.file("odd\n.so");
    fs::rename(rig.file("libhostile.so"), &odd).unwrap();
    let said = "odd\\n.so\": expected a text without control characters";
    rig.run("fly", ["--inner", &odd]).expect(2).complains(said);
    rig.assert_nothing_started();
}

#[test]
fn a_law_that_does_not_come_back_as_it_is_made_is_waited_for_and_said() {
    let rig = Rig::new("stays");
    let config = hostile(&rig, "wait_when_made", 0);
    let flight = rig.start("fly", format!("--config {config}"));
    flight.await_words("libhostile.so): it has not come back within 5s as it was made");
}
