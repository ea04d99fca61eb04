//! Processes that end and are replaced: by the supervisor, by another program.

use crate::rig::{Rig, is_gone, read_log, send, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use ipc::Wire;
use messages::blackboards::{RolePhase, Status};
use messages::role::Role::Inner;
use process::session::status_board;
use rustix::process::Signal;

/// Kills the inner loop in a tick.
fn kill(rig: &Rig, tick: u64) -> u32 {
    rig.await_tick(tick);
    let pid = rig.known().pid_of(Inner).unwrap();
    send(pid, Signal::KILL);
    pid
}

/// Waits until another process than this one flies as the inner loop.
fn await_successor(rig: &Rig, dead: u32) -> u32 {
    let wire = Wire::open(&rig.known()).unwrap();
    let pid = wait_until("another inner process to fly", || {
        let board = wire.blackboard_reader::<Status>(&status_board(Inner));
        let status = board.unwrap()?.get();
        let flies = status.phase() == RolePhase::Flying && status.ticks_run > 0;
        (flies && status.pid != u64::from(dead)).then_some(status.pid)
    });
    u32::try_from(pid).unwrap()
}

#[test]
#[ignore = "long: part of the gate"]
fn a_restarted_inner_loop_continues_from_the_state_of_the_one_that_died() {
    let rig = Rig::new("resumes");
    let config = rig.airborne("trajectory = \"lissajous\"\n");
    let flags = format!("--on-death restart --rt off --duration 2s --config {config}");
    let flight = rig.start("fly", flags);
    kill(&rig, 1000);
    flight.end().expect(0);
    let wrench = |entry: &LogEntry| match entry {
        LogEntry::Wrench(it) => Some((it.envelope.epoch, estimate(&it.content.telemetry))),
        _ => None,
    };
    let (entries, _) = read_log(&rig.out().join("latest/flight.mcap"));
    let estimates: Vec<_> = entries.iter().filter_map(wrench).collect();
    let has_restarted = |pair: &[(u64, [f64; 3])]| pair[0].0 != pair[1].0;
    let begin = estimates.windows(2).position(has_restarted).unwrap() + 1;
    let (before, first) = (&estimates[begin - 2..begin], estimates[begin].1);
    // Learning goes on with the first state after the outage.
    let moved = |last: &[f64; 3]| {
        let range = estimates.iter().map(|(_, it)| it[0]);
        let (low, high) = range.fold((f64::MAX, f64::MIN), |(low, high), it| {
            (low.min(it), high.max(it))
        });
        (first[0] - last[0]).abs() / (high - low)
    };
    assert!(
        before.iter().any(|(_, last)| moved(last) < 0.01),
        "{before:?} {first:?}"
    );
    assert_ne!(first, estimates[0].1, "the initial estimates");
    rig.assert_replayed();
}

#[test]
fn a_successor_that_is_stopped_is_killed_and_one_that_is_to_end_ends_the_flight() {
    let rig = Rig::new("way");
    let config = rig.slow(4);
    let flags = format!("--on-death restart --rt off --config {config} --duration 600s");
    let flight = rig.start("fly", flags);
    let dead = kill(&rig, 300);
    let started = rig.await_started(Inner, dead);
    send(started, Signal::STOP);
    wait_until("the stopped process to end", || {
        is_gone(started).then_some(())
    });
    wait_until("another process to fly", || {
        (await_successor(&rig, dead) != started).then_some(())
    });
    let dead = kill(&rig, 0);
    send(rig.await_started(Inner, dead), Signal::TERM);
    let ended = flight.end();
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    rig.assert_nothing_left();
}
