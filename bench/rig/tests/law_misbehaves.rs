//! Laws that do what no law should: the report names each, the other roles end in order, and nothing is left.

use crate::rig;

use std::fs;

use crate::c_laws::misbehaving;
use crate::rig::{Ended, Rig};

const NAMED: &str = "inner law `misbehaving` (libmisbehaving.so)";

/// The file as the system names it, which the process says that dies.
fn in_full(rig: &Rig) -> String {
    let file = fs::canonicalize(rig.file("libmisbehaving.so")).unwrap();
    format!("inner law `misbehaving` ({})", file.display())
}

/// A flight of a law that misbehaves from tick 300 on.
fn fly(rig: &Rig, how: &str, options: &str) -> Ended {
    let config = misbehaving(rig, how, 300);
    let ended = rig.run(
        "fly",
        format!("--config {config} --duration 900ms {options}"),
    );
    rig.assert_nothing_left();
    ended
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
    let said =
        "failed as it was copied for a rehearsal: SIGSEGV: it read or wrote where no memory is";
    ended.complains(&format!("error: {} {said}", in_full(&rig)));
    rig.assert_nothing_left();
}

#[test]
fn in_simulation_a_law_that_crashes_is_named_before_the_process_ends() {
    let rig = Rig::new("alone");
    let config = misbehaving(&rig, "crash", 300);
    let ended = rig.run("simulate", format!("--config {config} --duration 900ms"));
    assert_eq!(ended.code, None, "a signal has ended it: {ended}");
    ended.complains(&format!(
        "error: {} failed in tick 300: SIGSEGV",
        in_full(&rig)
    ));
}

#[test]
fn numbers_that_are_none_are_replaced_and_counted() {
    let rig = Rig::new("nan");
    fly(&rig, "nan", "--pace lockstep").expect(0);
    let said = format!(
        "{NAMED} gave a number that is not finite, or beyond any airframe, in 601 ticks, first at tick 300"
    );
    rig.ok("report --full").tells(&said);
    let config = misbehaving(&rig, "nan", 300);
    rig.ok(&format!("simulate --config {config} --duration 900ms"))
        .tells(&said);
    let both = format!("--config {config} --duration 900ms --outer pd --outer estimating");
    rig.run("compare", &both)
        .expect(0)
        .tells(&format!("estimating + misbehaving: {said}"));
    rig.ok("replay --verify").tells("identical");
}

#[test]
fn a_law_that_takes_longer_than_a_tick_is_named_and_flown() {
    let rig = Rig::new("sleeps");
    fly(&rig, "sleep", "--rt off").expect(0);
    rig.ok("report --full")
        .tells(&format!("{NAMED} took longer than a tick of 1000 us"));
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
#[cfg_attr(
    not(feature = "instrumented"),
    ignore = "needs --features instrumented"
)]
fn a_law_that_allocates_is_named_with_its_calls() {
    let rig = Rig::with_features("allocates");
    fly(&rig, "allocate", "--pace lockstep").expect(0);
    let said =
        format!("{NAMED} allocated memory in flight: 601 calls beside the middleware's one a tick");
    rig.ok("report --full").tells(&said);
    let rig = Rig::with_features("allocates-not");
    fly(&rig, "nothing", "--pace lockstep").expect(0);
    let report = rig.ok("report --full");
    assert!(!report.stdout.contains(NAMED), "{report}");
}

#[test]
fn a_law_that_meets_memory_that_is_not_there_is_named_where_memory_was_locked() {
    let rig = Rig::new("faults");
    fly(&rig, "fault", "").expect(0);
    let inner = &rig.report()["roles"]["inner"];
    let steps = inner["realtime"].as_array().unwrap();
    let is_granted = |name: &str| {
        steps
            .iter()
            .any(|step| step["step"] == name && step["granted"] == true)
    };
    if !is_granted("memory_lock") || !is_granted("prefault") {
        return rig::not_tested("memory could not be locked");
    }
    assert!(
        inner["usage"]["minor_faults"].as_u64().unwrap() >= 300,
        "{inner}"
    );
    rig.ok("report --full")
        .tells(&format!("{NAMED} met memory that was not there: "));
}

#[test]
fn a_law_without_an_end_is_ended_under_real_time_scheduling() {
    let rig = Rig::new("loops");
    let ended = fly(&rig, "loop", "").expect(1);
    if rig.report()["roles"]["inner"]["scheduling"] == "other" {
        return rig::not_tested("SCHED_FIFO was not granted");
    }
    ended
        .complains(&format!("error: {} failed in tick ", in_full(&rig)))
        .complains("SIGXCPU: it computed for half a second");
    assert_eq!(rig.report()["roles"]["plant"]["landed"], true);
}

#[test]
#[ignore = "long: part of the gate"]
fn in_lockstep_a_law_without_an_end_is_named_beside_the_plant_that_waited_for_it() {
    let rig = Rig::new("waits");
    fly(&rig, "loop", "--pace lockstep")
        .expect(1)
        .complains("no rotor command of tick 300 in lockstep");
    let ending = rig.report()["run"]["ending"].clone();
    let named = "; the inner process, which flew the law `misbehaving` (libmisbehaving.so), did not end within 5 s of";
    assert!(ending.as_str().unwrap().contains(named), "{ending}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_law_without_an_end_is_killed_after_the_flight_where_it_is_scheduled_like_any_program() {
    let rig = Rig::new("hangs");
    let ended = fly(&rig, "loop", "--rt off").expect(1);
    assert_eq!(ended.result()["status"], "ABORTED");
    let ending = rig.report()["run"]["ending"].clone();
    let named = "the inner process, which flew the law `misbehaving` (libmisbehaving.so), did not end within 30 s";
    assert!(ending.as_str().unwrap().starts_with(named), "{ending}");
}
