//! Processes under SCHED_FIFO give it back before they end, however they do.
//!
//! The kernel keeps the policy of a process that has ended until its parent has asked for its end: what a process was
//! scheduled as when it gave up its memory is read there.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, Running, is_gone, not_tested, wait_until};
use role::rt::fifo_refusal;
use rustix::process::Signal;

const STAGES: [&str; 4] = ["plant", "outer", "inner", "mixer"];

/// Whether SCHED_FIFO can be had here; says so where it cannot.
fn fifo_is_granted() -> bool {
    let refusal = fifo_refusal(90);
    if let Some(refusal) = &refusal {
        not_tested(&format!("SCHED_FIFO is refused here: {refusal}"));
    }
    refusal.is_none()
}

/// Scheduling policy of a process that lives, or that nobody has waited for: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy(pid: u32) -> u32 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit_once(')').unwrap().1.split_whitespace().nth(38).unwrap().parse().unwrap()
}

/// Waits until it has ended; gives the policy that it ended under.
fn last_policy(process: &Running) -> u32 {
    wait_until("the process to end", || is_gone(process.pid()).then_some(()));
    policy(process.pid())
}

/// A role that waits for the others, in real time.
fn waiting(rig: &Rig, role: &str) -> Running {
    let process = rig.start(role, &["--rt", "prefer"]);
    process.await_words("waiting for");
    assert_eq!(policy(process.pid()), 1, "{role} has real time");
    process
}

#[test]
fn a_role_that_is_told_to_end_ends_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    for role in STAGES {
        let rig = Rig::new("told");
        let process = waiting(&rig, role);
        process.signal(Signal::TERM);
        assert_eq!(last_policy(&process), 0, "{role}");
        process.end().expect(130);
        rig.assert_nothing_left();
    }
}

#[test]
fn a_role_that_a_second_signal_ends_at_once_ends_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    for role in STAGES {
        let rig = Rig::new("at-once");
        let process = waiting(&rig, role);
        // Both are there when it goes on: it has no time to end in order.
        [Signal::STOP, Signal::INT, Signal::TERM, Signal::CONT].iter().for_each(|signal| process.signal(*signal));
        assert_eq!(last_policy(&process), 0, "{role}");
        process.end().expect(130);
        rig.run("clean", &[]);
    }
}

#[test]
fn roles_that_have_flown_end_without_real_time() {
    if !fifo_is_granted() {
        return;
    }
    let rig = Rig::new("flown");
    let slow = rig.slow(5);
    let args = ["--rt", "prefer", "--config", &slow, "--duration", "50ms"];
    let roles = ["record", "mixer", "inner", "outer", "plant"].map(|role| (role, rig.start(role, &args)));
    for (role, process) in &roles {
        assert_eq!(last_policy(process), 0, "{role}");
    }
    for (_, process) in roles {
        process.end().expect(0);
    }
    rig.assert_nothing_left();
}
