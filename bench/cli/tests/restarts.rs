//! Processes that end and are replaced: by hot standbys, by the supervisor, by another program, after all were killed.

use crate::rig::{Rig, Running, files_below, is_gone, process_of, read_log, send, wait_until};
use controller::laws::adaptive::estimate;
use flight_log::entry::LogEntry;
use ipc::Wire;
use ipc::clock::{now_ns, sleep_until};
use messages::blackboards::{RolePhase, Run, Status};
use messages::grid::Pace;
use messages::role::Role::{self, Inner, Mixer, Outer};
use process::session::status_board;
use process::standby::NAME;
use rustix::process::Signal;
use std::fs;
use std::thread::sleep;
use std::time::Duration;

/// Settings of slow motion without a ground: the airframe falls while a stage is missing.
pub(crate) fn in_the_air(rig: &Rig, slowdown: u64) -> String {
    rig.airborne(&format!("slowdown = {slowdown}\n"))
}

/// A flight in slow motion whose stages are replaced, and its run.
fn take_off(rig: &Rig, args: &str) -> (Running, Run) {
    let config = in_the_air(rig, SLOWDOWN);
    let flags = format!("--on-death restart --trajectory hover --config {config} {args}");
    (rig.start("fly", flags), rig.await_tick(0))
}

/// So that nothing of a flight is lost where the machine is busy.
const SLOWDOWN: u64 = 4;

/// Waits until a tick begins, without a pause before it.
pub(crate) fn await_begin(run: &Run, tick: u64) {
    let Pace::Realtime(grid) = run.pace() else {
        panic!("a flight in lockstep has no clock")
    };
    while now_ns() < grid.begin_of(tick) {
        sleep_until(grid.begin_of(tick));
    }
}

/// Kills a role at a tick; its process.
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
fn an_inner_loop_begins_at_its_initial_estimates_or_at_the_last_ones() {
    for resumes in [false, true] {
        let rig = Rig::new("resumes");
        let resume = if resumes { "--resume-estimates" } else { "" };
        let config = rig.airborne("trajectory = \"lissajous\"\n");
        let flags = format!("--on-death restart --rt off --duration 4s --config {config}");
        let flight = rig.start("fly", format!("{flags} {resume}"));
        kill(&rig, &rig.await_tick(0), 2500, Inner);
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
        let is_resumed = before.iter().any(|(_, last)| *last == first);
        let is_initial = first == estimates[0].1;
        assert_eq!((is_resumed, is_initial), (resumes, !resumes), "{before:?}");
        let log = rig.flown("inner.log");
        assert_eq!(log.contains("resumes with the last estimates"), resumes);
        rig.assert_replayed();
    }
}

/// The five roles as systemd would have them: each is started again 100 ms after it has failed.
#[test]
#[ignore = "long: part of the gate"]
fn roles_that_another_program_restarts_are_reported_and_replayed_alike() {
    let rig = Rig::new("unit");
    let config = in_the_air(&rig, 2);
    let options = format!("--rt off --config {config} --trajectory hover --duration 2s");
    // What examples/systemd/ironbird@.service says: Restart=on-failure, RestartSec=100ms, SuccessExitStatus=130 3.
    let forever = "until \"$@\" || case $? in 3|130) ;; *) false ;; esac; do sleep 0.1; done";
    let kept = |role| rig.launch(rig.command_by(&["sh", "-c", forever, "sh"], role, &options));
    let keepers = ["outer", "inner", "mixer", "record", "plant"].map(kept);
    let run = rig.await_tick(0);
    for (role, tick) in [(Inner, 400), (Outer, 800), (Mixer, 1200)] {
        let dead = kill(&rig, &run, tick, role);
        await_successor(&rig, role, dead);
    }
    for keeper in keepers {
        keeper.end().expect(0);
    }
    let deaths = rig.final_report().deaths;
    let roles: Vec<&str> = deaths.iter().map(|death| death.role.as_str()).collect();
    assert_eq!(roles, ["inner", "outer", "mixer"], "{deaths:?}");
    for death in &deaths {
        // Nothing has observed its end, and its keeper sleeps that long.
        assert!(death.how.is_empty() && death.noticed_after_ms.is_none());
        assert!(death.back_after_ms.unwrap() > 100.0, "{death:?}");
    }
    rig.assert_replayed();
    rig.assert_nothing_left();
}

#[test]
fn a_standby_takes_the_place_of_a_killed_stage_and_another_one_waits() {
    let rig = Rig::new("takes");
    // The standby loads and creates the law of a file, and flies it.
    let law = crate::c_laws::cascade(&rig);
    let (flight, run) = take_off(&rig, &format!("--rt prefer --duration 6s --inner {law}"));
    // A standby that is killed is replaced, and what it held is removed; it counts as no failure.
    let [_, first, _] = [Outer, Inner, Mixer].map(|role| rig.await_standby(role, None));
    let held = || (rig.segments().len(), files_below(&rig.root()).len());
    let before = held();
    send(first, Signal::KILL);
    rig.await_standby(Inner, Some(first));
    assert!(is_gone(first));
    assert_eq!(held(), before);
    for (role, tick) in [(Outer, 400), (Inner, 700), (Mixer, 1000)] {
        let standby = rig.await_standby(role, None);
        let dead = kill(&rig, &run, tick, role);
        assert_eq!(await_successor(&rig, role, dead), standby);
        rig.await_standby(role, Some(standby));
    }
    let ended = flight.end().expect(0);
    let report = rig.final_report();
    assert_eq!(report.deaths.len(), 3, "{:?}", report.deaths);
    for death in &report.deaths {
        let process = process_of(&death.role);
        assert!(ended.stderr.contains(&format!(
            "the {process} died: signal: 9 (SIGKILL); it is started again: its hot standby takes over"
        )));
        let log = rig.flown(&format!("{}.log", death.role));
        assert!(!log.contains("spare") && !log.contains("standby"), "{log}");
        let parts = death.back_parts.as_ref().unwrap();
        // From the beginning of one tick to that of another; messages are sent within them.
        let ticks_ms = (death.ticks_lost.unwrap() + 1) as f64 * SLOWDOWN as f64;
        let is_whole = (render::flight::recovery_phases(parts)
            .iter()
            .map(|(_, ms)| ms)
            .sum::<f64>()
            - ticks_ms)
            .abs()
            < 0.01;
        assert!(parts.spare && is_whole, "{parts:?}: {ticks_ms} ms");
    }
    rig.ok("report --section deaths")
        .says("    a spare [ms]: noticed ");
    rig.assert_replayed();
    rig.assert_nothing_left();
}

/// Waits, without a pause, until a standby continues: it takes another name then, and has no place yet.
fn await_on_its_way(standby: u32) {
    let name = || fs::read_to_string(format!("/proc/{standby}/comm")).unwrap();
    let begun_ns = now_ns();
    while name().trim_end().as_bytes() == NAME.to_bytes() {
        assert!(now_ns() < begun_ns + 60_000_000_000, "it does not continue");
    }
}

#[test]
fn a_standby_that_is_stopped_on_its_way_is_killed_and_one_that_is_to_end_ends_the_flight() {
    let rig = Rig::new("way");
    let (flight, run) = take_off(&rig, "--rt off --duration 600s");
    // Of an inner loop, five in ten seconds are started again.
    for (tick, wait_us) in [(300, 0), (700, 1500)] {
        let standby = rig.await_standby(Inner, None);
        let dead = kill(&rig, &run, tick, Inner);
        await_on_its_way(standby);
        sleep(Duration::from_micros(wait_us));
        send(standby, Signal::STOP);
        wait_until("the stopped process to end", || {
            is_gone(standby).then_some(())
        });
        wait_until("another process to fly", || {
            (await_successor(&rig, Inner, dead) != standby).then_some(())
        });
    }
    let standby = rig.await_standby(Inner, None);
    kill(&rig, &run, 0, Inner);
    await_on_its_way(standby);
    send(standby, Signal::TERM);
    let ended = flight.end();
    assert_eq!(ended.result()["status"], "INTERRUPTED", "{ended}");
    assert!(is_gone(standby));
    rig.assert_nothing_left();
}

#[test]
fn standbys_and_successors_that_fail_are_reported() {
    let rig = Rig::new("fails");
    let config = crate::c_laws::misbehaving(&rig, "refuse_with_file", 0);
    let settings = fs::read_to_string(&config).unwrap();
    let slow = format!("[flight]\nslowdown = {SLOWDOWN}\n");
    fs::write(&config, settings.replace("[flight]\n", &slow)).unwrap();
    let flags = format!("--on-death restart --rt off --config {config} --duration 600s");
    let flight = rig.start("fly", flags);
    let (run, standby) = (rig.await_tick(0), rig.await_standby(Inner, None));
    // From now on the law refuses, and with it each process that is to take the place of the inner loop.
    fs::write(rig.path("refuse"), "").unwrap();
    send(standby, Signal::KILL);
    flight.await_words(" no longer has a hot standby: it ended with exit status: ");
    let log = rig.out().join(&rig.run_directories()[0]).join("inner.log");
    let log = fs::read_to_string(log).unwrap();
    assert!(log.contains("there is a file named refuse"), "{log}");
    kill(&rig, &run, 0, Inner);
    let again = "the inner process died: exit status: 2; it is started again";
    let ended = flight.end().complains(again);
    assert_eq!(ended.result()["status"], "ABORTED", "{ended}");
    let report = rig.final_report();
    // A busy machine may have let another stage seem to hang.
    let of_inner = report.deaths.iter().filter(|death| death.role == "inner");
    let of_inner: Vec<_> = of_inner.collect();
    let [death, silent @ ..] = &of_inner[..] else {
        panic!("{ended}")
    };
    let is_back = death.back_after_ms.is_some() || death.within.is_some();
    assert!(death.ticks_lost.is_some() && !is_back, "{death:?}");
    assert_eq!(silent.len(), 5, "{silent:?}");
    let tick = death.tick;
    for silent in silent {
        assert_eq!((silent.epoch, silent.within), (0, Some(tick)), "{silent:?}");
        let line = render::flight::failure_line(silent);
        assert!(line.ends_with(&format!(
            ", before its first message: its ticks are those lost at tick {tick}"
        )));
    }
    rig.assert_nothing_left();
}
