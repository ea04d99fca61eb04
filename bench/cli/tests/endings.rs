//! How flights end: signals, closed terminals, limits; and what processes hold when they end.

use crate::rig::{Rig, Running, in_parallel, is_gone, not_tested, wait_until};
use ipc::{SwapOrder, SwapOutcome, Wire};
use messages::blackboards::{RUN, Run, RunPhase};
use messages::parameters::Parameter;
use process::rt::fifo_refusal;
use rustix::process::Signal;
use std::fs;
use std::time::Duration;

const STAGES: [&str; 4] = ["plant", "outer", "inner", "mixer"];

/// Scheduling policy of a process that lives, or that was not reaped: 0 is SCHED_OTHER, 1 is SCHED_FIFO.
fn policy(process: &Running) -> u32 {
    let stat = fs::read_to_string(format!("/proc/{}/stat", process.pid())).unwrap();
    let (_, fields) = stat.rsplit_once(')').unwrap();
    fields.split_whitespace().nth(38).unwrap().parse().unwrap()
}

/// Demands that it ends without real time.
fn ends_without_real_time(process: Running, code: i32) {
    wait_until("the process to end", || {
        is_gone(process.pid()).then_some(())
    });
    assert_eq!(policy(&process), 0);
    process.end().expect(code);
}

#[test]
fn a_role_ends_without_real_time_on_one_signal_on_two_and_after_a_flight() {
    if let Some(refusal) = fifo_refusal(90) {
        return not_tested(&format!("SCHED_FIFO is refused here: {refusal}"));
    }
    // Two are there when the process continues: it has no time to end in order.
    let twice = [Signal::STOP, Signal::INT, Signal::TERM, Signal::CONT];
    in_parallel(STAGES.into_iter(), |role| {
        for signals in [&twice[2..3], &twice] {
            let rig = Rig::new("signals");
            let recorder = rig.start("record", "--rt off");
            recorder.await_words("waiting for");
            let process = rig.start(role, "--rt prefer");
            process.await_words("waiting for");
            // The others take their place in the loop when the flight begins.
            let has_real_time = u32::from(*role == "plant");
            assert_eq!(policy(&process), has_real_time, "{role}");
            signals.iter().for_each(|it| process.signal(*it));
            ends_without_real_time(process, 130);
            recorder.signal(Signal::TERM);
            recorder.end().expect(130);
            if signals.len() == 1 {
                rig.assert_nothing_left();
            }
            // After a killed process, a helper still uses its memory for a moment.
            wait_until("nothing is left", || {
                rig.run("clean", "");
                rig.segments().is_empty().then_some(())
            });
        }
    });
    let rig = Rig::new("flown");
    let args = format!("--rt prefer --config {} --duration 50ms", rig.slow(5));
    let roles = ["record", "mixer", "inner", "outer", "plant"].map(|role| rig.start(role, &args));
    for process in roles {
        ends_without_real_time(process, 0);
    }
    rig.assert_nothing_left();
}

#[test]
fn a_change_for_the_tick_after_the_last_is_refused_and_changes_nothing() {
    let rig = Rig::new("late-swap");
    let flight = rig.take_off("--rt off --duration 1s --max-miss-rate 1000000");
    {
        let wire = Wire::open(&rig.known()).unwrap();
        let run_of = wire.blackboard_reader::<Run>(RUN).unwrap().unwrap();
        let at_tick = run_of.get().last_tick + 1;
        let order = SwapOrder::new(at_tick, 0, &[(Parameter::Mass, 0.6, 1)]);
        let answer = wire
            .client::<SwapOrder>()
            .unwrap()
            .request(order, Duration::from_secs(60))
            .unwrap();
        let outcome = SwapOutcome::from_wire(answer.verdict);
        assert_eq!(outcome, Some(SwapOutcome::Ended));
        let run = run_of.get();
        assert_eq!((run.phase(), run.parameter_epoch), (RunPhase::Closed, 0));
    }
    flight.end().expect(0);
    assert_eq!(rig.report()["swaps"].as_array().unwrap().len(), 0);
    rig.run("clean", "");
}
