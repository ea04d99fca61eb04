//! Processes that end and are replaced: by the supervisor, by another program.

use crate::rig::{Rig, is_gone, send, wait_until};
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
