//! Processes that end and are replaced: by the supervisor, by another program.

use crate::rig::{Rig, Running, files_below, is_gone, process_of, read_log, send, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use ipc::Wire;
use ipc::clock::sleep_through;
use messages::blackboards::{RolePhase, Run, Status};
use messages::grid::Pace;
use messages::role::Role::{self, Inner, Mixer, Outer};
use process::session::status_board;
use rustix::process::Signal;

/// A flight in slow motion whose stages are replaced, and its run.
fn take_off(rig: &Rig, args: &str) -> (Running, Run) {
    let config = rig.slow(SLOWDOWN);
    let flags = format!("--on-death restart --trajectory hover --config {config} {args}");
    (rig.start("fly", flags), rig.await_tick(0))
}

/// So that nothing of a flight is lost where the machine is busy.
const SLOWDOWN: u64 = 4;

/// Waits until a tick begins, without a pause before it.
fn await_begin(run: &Run, tick: u64) {
    let Pace::Realtime(grid) = run.pace() else {
        panic!("a flight in lockstep has no clock")
    };
    sleep_through(grid.begin_of(tick));
}

fn kill(rig: &Rig, run: &Run, tick: u64, role: Role) -> u32 {
    await_begin(run, tick);
    let pid = rig.known().pid_of(role).unwrap();
    send(pid, Signal::KILL);
    pid
}

/// Waits until another process than this one flies in a role.
fn await_successor(rig: &Rig, role: Role, dead: u32) -> u32 {
    let wire = Wire::open(&rig.known()).unwrap();
    let pid = wait_until(&format!("another {role} process to fly"), || {
        let board = wire.blackboard_reader::<Status>(&status_board(role));
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
    kill(&rig, &rig.await_tick(0), 1000, Inner);
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
fn a_killed_stage_is_started_again_and_its_parts_are_reported() {
    let rig = Rig::new("takes");
    let law = crate::c_laws::cascade(&rig);
    let (flight, run) = take_off(&rig, &format!("--rt prefer --duration 2s --inner {law}"));
    let held = || (rig.segments().len(), files_below(&rig.root()).len());
    // The supervisor and the recorder open what they read when the flight has begun.
    await_begin(&run, 300);
    let before = held();
    for (role, tick) in [(Outer, 400), (Inner, 700), (Mixer, 1000)] {
        let dead = kill(&rig, &run, tick, role);
        await_successor(&rig, role, dead);
        wait_until("what the dead process held to be removed", || {
            (held() == before).then_some(())
        });
    }
    let ended = flight.end().expect(0);
    let report = rig.final_report();
    assert_eq!(report.deaths.len(), 3, "{:?}", report.deaths);
    for death in &report.deaths {
        let process = process_of(&death.role);
        assert!(ended.stderr.contains(&format!(
            "the {process} died: signal: 9 (SIGKILL); it is started again"
        )));
        let parts = death.back_parts.as_ref().unwrap();
        // From the beginning of one tick to that of another; messages are sent within them.
        let ticks_ms = (death.ticks_lost.unwrap() + 1) as f64 * SLOWDOWN as f64;
        let phases = render::flight::recovery_phases(parts);
        let sum_ms: f64 = phases.iter().map(|(_, ms)| ms).sum();
        assert!((sum_ms - ticks_ms).abs() < 0.01, "{parts:?}: {ticks_ms} ms");
    }
    rig.ok("report --section deaths")
        .says("    a new process [ms]: noticed ");
    rig.assert_replayed();
    rig.assert_nothing_left();
}

#[test]
fn a_successor_that_is_stopped_is_killed_and_one_that_is_to_end_ends_the_flight() {
    let rig = Rig::new("way");
    let (flight, run) = take_off(&rig, "--rt off --duration 600s");
    let dead = kill(&rig, &run, 300, Inner);
    let started = rig.await_started(Inner, dead);
    send(started, Signal::STOP);
    wait_until("the stopped process to end", || {
        is_gone(started).then_some(())
    });
    wait_until("another process to fly", || {
        (await_successor(&rig, Inner, dead) != started).then_some(())
    });
    let dead = kill(&rig, &run, 0, Inner);
    send(rig.await_started(Inner, dead), Signal::TERM);
    let ended = flight.end();
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    rig.assert_nothing_left();
}
