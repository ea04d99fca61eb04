//! Laws that work against the rig: no verdict without evidence, no hang, no silence, and no harm to what comes after.

use crate::c_laws::{self, hostile};
use crate::rig;

use std::fs;

use crate::rig::{Ended, Rig, lacks_feature};

const NAMED: &str = "the inner process, which flew the law `hostile` (libhostile.so),";

/// The file as the system names it, which a process says that dies.
fn in_full(rig: &Rig) -> String {
    let file = fs::canonicalize(rig.file("libhostile.so")).unwrap();
    format!("inner law `hostile` ({})", file.display())
}

fn run(rig: &Rig, command: &str, harm: &str, from_tick: u64, options: &str) -> Ended {
    let config = hostile(rig, harm, from_tick);
    rig.run(
        command,
        format!("--config {config} --duration 900ms {options}"),
    )
}

fn ending(rig: &Rig) -> String {
    rig.report()["run"]["ending"].as_str().unwrap().to_owned()
}

#[test]
fn a_process_that_leaves_without_a_word_is_named_in_flight_and_at_its_end() {
    for (tick, says) in [
        (300, "ended before the flight did: exit status: 0"),
        (890, "ended before "),
    ] {
        let rig = Rig::new("silent");
        let ended = run(&rig, "fly", "raw_exit", tick, "--rt off").expect(1);
        assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
        assert!(
            ending(&rig).starts_with(&format!("{NAMED} {says}")),
            "{}",
            ending(&rig)
        );
        rig.assert_nothing_left();
    }
}

#[test]
fn a_law_that_unwinds_traps_or_is_signalled_is_named_with_what_it_did() {
    for (harm, says) in [
        ("thread_exit", "in tick 300: SIGABRT: it aborted"),
        (
            "trap",
            "in tick 300: SIGFPE: it had floating-point exceptions trap, and met one",
        ),
        ("raise", "in tick 300: SIGSEGV: the signal was sent to it"),
        (
            "thread",
            "outside of its calls: SIGSEGV: it read or wrote where no memory is",
        ),
    ] {
        let rig = Rig::new("unwinds");
        let ended = run(&rig, "simulate", harm, 300, "");
        assert_eq!(ended.code, None, "a signal has ended it: {ended}");
        ended.complains(&format!("error: {} failed {says}", in_full(&rig)));
    }
}

#[test]
fn a_law_that_ends_the_process_outside_of_its_ticks_is_no_success() {
    for (harm, says) in [
        ("exit_when_made", "failed as it was made: it called _exit()"),
        (
            "exit_when_freed",
            "failed as it was freed: it called exit()",
        ),
    ] {
        if harm == "exit_when_made" && !cfg!(feature = "instrumented") {
            lacks_feature("which law called _exit() as it was made", "instrumented");
            continue;
        }
        for command in ["fly", "simulate"] {
            let rig = Rig::with_features("outside");
            let ended = run(&rig, command, harm, 0, "").expect(1);
            ended.complains(&format!("error: {} {says}", in_full(&rig)));
            rig.assert_nothing_left();
        }
    }
}

#[test]
fn what_a_library_does_as_its_process_ends_is_not_done() {
    let rig = Rig::new("at-exit");
    run(&rig, "simulate", "crash_at_exit", 0, "").expect(0);
    run(&rig, "fly", "crash_at_exit", 0, "--pace lockstep").expect(0);
    rig.assert_nothing_left();
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
fn a_law_that_loops_with_signals_blocked_is_killed_by_the_system() {
    let rig = Rig::new("blocks");
    let ended = run(&rig, "fly", "block_and_loop", 300, "").expect(1);
    if rig.report()["roles"]["inner"]["scheduling"] == "other" {
        return rig::not_tested("SCHED_FIFO was not granted");
    }
    assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
    assert!(
        ending(&rig).starts_with(&format!("{NAMED} died: signal: 9")),
        "{}",
        ending(&rig)
    );
    rig.assert_nothing_left();
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
fn a_child_that_a_law_forks_as_it_is_made_ends_with_the_command() {
    let rig = Rig::new("forks_made");
    let ended = run(&rig, "simulate", "fork_when_made", 0, "").expect(0);
    assert!(
        ended.stderr.contains("child process(es) behind"),
        "{}",
        ended.stderr
    );
    run(&rig, "fly", "fork_when_made", 0, "--rt off").expect(0);
    rig.assert_nothing_left();
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
    flight.await_words(&format!(
        "still waiting for {}: it has not come back within 5s as it was made",
        in_full(&rig)
    ));
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_that_never_comes_back_as_it_is_made_ends_the_command() {
    let rig = Rig::new("never");
    let ended = run(&rig, "fly", "wait_when_made", 0, "").expect(1);
    ended.complains(&format!(
        "error: {} failed as it was made: it did not come back within 45s",
        in_full(&rig)
    ));
    rig.assert_nothing_started();
}
