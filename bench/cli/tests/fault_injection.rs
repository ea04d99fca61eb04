//! Faults that are injected into a running flight, or planned: into messages, stages, processes and the processor.

use crate::rig::{Rig, send, wait_until};
use flight_log::fault_record::injected;
use rustix::process::Signal;

/// The tick from which an injection acts, by the answer.
fn from_tick(answer: &str) -> u64 {
    let (_, rest) = answer.split_once(" from tick ").unwrap();
    rest.split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
fn injected_faults_are_in_the_log_of_a_recorder_that_was_killed() {
    let rig = Rig::new("no-landing");
    let flight = rig.take_off(rig.slowly(2, "60s"));
    let tick = from_tick(&rig.ok("inject state.drop=0.2 --for 10ms").stdout);
    let log = rig
        .out()
        .join(&rig.run_directories()[0])
        .join("flight.mcap");
    let expected = format!("state.drop=0.2@tick{tick}..tick{}", tick + 10);
    wait_until("the log to have the fault", || {
        injected(&log).ok().filter(|faults| *faults == [&*expected])
    });
    send(rig.processes_of("record")[0], Signal::KILL);
    flight.interrupt();
    assert_eq!(injected(&log).unwrap(), [expected]);
}
