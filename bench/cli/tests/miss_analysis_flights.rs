//! Root causes of missed deadlines in real flights, whose stages are stopped, late, or kept from their processor.
//!
//! `miss_analysis.rs` tests each cause on constructed evidence.

use crate::c_laws::harmful;
use crate::rig::{Rig, in_own_mounts, not_tested, rounds};
use ipc::clock::busy_wait;
use process::rt::{fifo_refusal, loops_cpu, take_stand};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;

/// Missed deadlines of a cause in the report; every missed deadline belongs to one.
fn missed_by(report: &Value, class: &str, stage: &str) -> u64 {
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    let missed = |it: &Value| it["missed"].as_u64().unwrap();
    let sum: u64 = classes.iter().map(missed).sum();
    assert_eq!(sum, report["deadlines"]["missed"].as_u64().unwrap());
    let of_class = classes
        .iter()
        .filter(|it| it["class"] == class && it["stage"] == stage);
    of_class.map(missed).sum()
}

/// Keeps all others from the loops' processor for a time, from within a tick on.
fn hog(time_ns: u64) {
    let cpu = loops_cpu();
    let hog = std::thread::Builder::new()
        .name("hog".into())
        .spawn(move || {
            assert_eq!(take_stand(cpu, 99).priority, 99);
            busy_wait(time_ns);
        });
    hog.unwrap().join().unwrap();
}

/// Mounts what the kernel traces with, and makes sure that it may be used.
pub(crate) const TRACEFS: (&str, &str) = (
    "mount -t tracefs nodev /sys/kernel/tracing",
    "mkdir /sys/kernel/tracing/instances/t$$ && rmdir /sys/kernel/tracing/instances/t$$",
);

/// One flight at a time: on the loops' processor, two keep each other from it.
#[test]
#[ignore = "long: part of the gate; IRONBIRD_ROUNDS=n counts how often each cause is found"]
fn soak_of_causes() {
    loops_that_are_kept_from_their_processor_were_ready_and_a_trace_names_what_ran();
    each_cause_that_is_provoked_is_found();
}

fn loops_that_are_kept_from_their_processor_were_ready_and_a_trace_names_what_ran() {
    if fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nothing keeps the loops from their processor for sure");
        return;
    }
    for traced in [false, true] {
        let rig = Rig::new("hogged");
        // In slow motion, so that a stall of the host is no match for it.
        let args = format!("--duration 300ms --config {}", rig.slow(10));
        let command = if traced {
            let args = format!("{args} --trace");
            let Some(program) = in_own_mounts(TRACEFS.0, TRACEFS.1, rig.executable()) else {
                return;
            };
            rig.given(program, "fly", args)
        } else {
            rig.command("fly", args)
        };
        let flight = rig.launch(command);
        rig.await_report();
        hog(300_000_000);
        let ended = flight.end().expect(0);
        let report = rig.report();
        let preempted = missed_by(&report, "preempted", "plant");
        if traced {
            assert!(preempted >= 29, "{ended}");
            let cases = report["autopsy"]["worst"].as_array().unwrap();
            let who = |case: &Value| case["ran"][0]["who"].as_str().unwrap_or("").to_owned();
            let case = cases
                .iter()
                .find(|it| who(it).starts_with("hog ("))
                .unwrap();
            assert!(case["ran"][0]["us"].as_f64().unwrap() >= 250e3, "{case}");
            assert!(case["missed"].as_u64().unwrap() >= 29, "{case}");
        } else {
            // Only what the kernel counts shows what ran: a virtual machine does not do so surely.
            let ready = missed_by(&report, "ready_not_run", "plant");
            assert!(preempted + ready >= 29, "{ended}");
        }
    }
}

/// Faults of a flight in slow motion: the tick, the class and the stage of the outage.
const PROVOKED: [(&str, u64, &str, &str); 5] = [
    ("outer.stop=30ms", 40, "stopped_or_dead", "outer"),
    ("inner.stop=30ms", 90, "stopped_or_dead", "inner"),
    ("mixer.stop=30ms", 140, "stopped_or_dead", "mixer"),
    ("plant.stop=30ms", 190, "stopped_or_dead", "plant"),
    // With a law that touches a new page in each tick from there on.
    ("inner.late=1500us", 260, "page_fault", "inner"),
];

fn each_cause_that_is_provoked_is_found() {
    let mut found = BTreeMap::<&str, BTreeMap<String, u64>>::new();
    let is_named = |found: &BTreeMap<&str, BTreeMap<String, u64>>| {
        PROVOKED
            .iter()
            .all(|(fault, _, class, stage)| found[fault].contains_key(&format!("{class} {stage}")))
    };
    let mut round = 0;
    // Something else may take the processor meanwhile and pass for the cause, but not every time.
    while round < rounds() || (round < 4 && !is_named(&found)) {
        let rig = Rig::new("causes");
        let config = harmful(&rig, "misbehaving", "fault", 260);
        let settings = fs::read_to_string(&config).unwrap();
        let slow = "[flight]\nslowdown = 10\n";
        fs::write(&config, settings.replace("[flight]\n", slow)).unwrap();
        let faults = PROVOKED.map(|(fault, tick, ..)| format!(" --fault {fault}@tick{tick}"));
        let faults = faults.concat();
        rig.ok(&format!(
            "fly --rt prefer --duration 300ms --config {config}{faults}"
        ));
        let report = rig.report();
        let cases = report["autopsy"]["worst"].as_array().unwrap();
        for (fault, tick, ..) in PROVOKED {
            // The outage begins in that tick or the next ones.
            let is_it = |case: &&Value| (tick..tick + 4).contains(&case["tick"].as_u64().unwrap());
            let case = cases.iter().find(is_it);
            let cause = case.map_or("not found".into(), |case| {
                let evidence = case["evidence"].as_str().unwrap();
                let is_stop = case["class"] == "stopped_or_dead";
                assert_eq!(evidence.contains("; its process was stopped"), is_stop);
                let [class, stage] = ["class", "stage"].map(|key| case[key].as_str());
                format!("{} {}", class.unwrap(), stage.unwrap_or("-"))
            });
            *found.entry(fault).or_default().entry(cause).or_default() += 1;
        }
        round += 1;
    }
    println!("of {round} flights: {found:#?}");
    assert!(is_named(&found), "{found:#?}");
}
