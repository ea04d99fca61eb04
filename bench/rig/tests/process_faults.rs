//! Faults of processes in real time: stopped, killed, late, and with a busy processor; planned and injected.
//!
//! What is demanded has no upper bound in time: that a fault struck, is in the report, and what it must do at the least.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{Rig, is_gone, not_tested, send, wait_until};
use report::schema::Report;
use role::rt::fifo_refusal;
use rustix::process::Signal;

/// A flight that nothing throws out of the air: whoever falls goes on falling, and then goes on.
fn settings(rig: &Rig, slowdown: u64) -> String {
    rig.settings(&format!(
        "[flight]\nslowdown = {slowdown}\nground_z_m = -1000.0\nposition_error_max_m = 1000.0\ntilt_max_rad = 3.14\n"
    ))
}

fn report(rig: &Rig) -> Report {
    Report::read(&rig.out().join("latest/report.json")).unwrap()
}

fn told(report: &Report) -> Vec<(String, u64, Option<u64>, bool)> {
    report.faults.iter().map(|it| (it.what.clone(), it.tick, it.to_tick, it.live)).collect()
}

#[test]
fn a_stage_that_is_stopped_by_plan_is_out_for_so_many_ticks_and_goes_on() {
    let rig = Rig::new("stop");
    let config = settings(&rig, 2);
    let flight = ["--rt", "off", "--config", &config, "--duration", "1500ms", "--trajectory", "hover"];
    rig.run("fly", &[&flight[..], &["--fault", "mixer.stop=60ms@500ms", "--fault", "inner.stop=40ms@1s"]].concat())
        .expect(0);
    let report = report(&rig);
    let once = |what: &str, tick| (what.to_owned(), tick, None, false);
    assert_eq!(told(&report), [once("mixer.stop=60ms", 500), once("inner.stop=40ms", 1000)]);
    for (role, least) in [("mixer", 55), ("inner", 35)] {
        let skipped = report.roles[role].ticks_skipped;
        assert!(skipped >= least, "{role}: {skipped} ticks skipped");
    }
    let longest = report.deadlines.runs.iter().map(|run| run.length_ticks).max().unwrap_or(0);
    assert!(longest >= 55, "no rotor command comes from a mixer that is stopped: {:?}", report.deadlines.runs);
    assert!(report.deaths.is_empty(), "{:?}", report.deaths);
    rig.run("report", &["--full"]).expect(0).says("  fault mixer.stop=60ms at tick 500 (0.500 s)\n");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(page.contains("fault from 0.500 s: mixer.stop=60ms"), "the page's plots");
    rig.run("replay", &["--verify"]).expect(0).says("identical");
    rig.assert_nothing_left();
}

#[test]
fn a_stage_that_is_killed_by_plan_ends_the_flight_which_says_why() {
    let rig = Rig::new("kill");
    let config = settings(&rig, 2);
    let ended = rig
        .run("fly", &["--rt", "off", "--config", &config, "--duration", "20s", "--fault", "inner.kill@500ms"])
        .expect(1);
    let why = "the inner process was killed by the fault inner.kill of tick 500";
    assert!(ended.stdout.contains(why), "{ended}");
    let report = report(&rig);
    let [death] = &report.deaths[..] else { panic!("{:?}", report.deaths) };
    assert_eq!((death.role.as_str(), death.how.as_str()), ("inner", "killed by the fault inner.kill of tick 500"));
    assert!(death.tick >= 499, "{death:?}");
    rig.run("report", &["--full"]).expect(0).says("  fault inner.kill at tick 500 (0.500 s)\n").says(&death.line());
    rig.assert_nothing_left();
}

#[test]
fn a_stage_that_is_killed_is_started_again_where_that_is_wanted_planned_or_injected() {
    let rig = Rig::new("again");
    let config = settings(&rig, 2);
    let options = ["--rt", "off", "--config", &config, "--duration", "4s", "--trajectory", "hover"];
    let flight = rig.take_off(&[&options[..], &["--on-death", "restart", "--fault", "mixer.kill@1500ms"]].concat());
    rig.run("inject", &["inner.kill", "--at-tick", "2500"])
        .expect(0)
        .says("inner.kill at tick 2500 (2.500 s), injected in flight\n");
    let ended = flight.end().expect(0);
    ended.complains("the mixer process was killed by the fault mixer.kill of tick 1500; it is started again");
    let report = report(&rig);
    let deaths: Vec<_> = report.deaths.iter().map(|death| (death.role.as_str(), death.how.as_str())).collect();
    assert_eq!(
        deaths,
        [
            ("mixer", "killed by the fault mixer.kill of tick 1500"),
            ("inner", "killed by the fault inner.kill of tick 2500")
        ]
    );
    assert!(report.deaths.iter().all(|death| death.back_after_ms.is_some()), "{:?}", report.deaths);
    assert_eq!(
        told(&report),
        [("mixer.kill".to_owned(), 1500, None, false), ("inner.kill".to_owned(), 2500, None, true)]
    );
    rig.run("replay", &["--verify"]).expect(0).says("identical");
    rig.assert_nothing_left();
}

#[test]
fn a_stage_that_is_late_by_plan_computes_so_much_longer_and_so_does_one_by_injection() {
    let rig = Rig::new("late");
    let config = settings(&rig, 10);
    let options = ["--rt", "off", "--config", &config, "--duration", "1500ms", "--trajectory", "hover"];
    let flight = rig.take_off(&[&options[..], &["--fault", "inner.late=200us..300us@100ms..600ms"]].concat());
    let said = rig.run("inject", &["outer.late=150us", "--for", "200ms"]).expect(0).stdout;
    assert!(said.starts_with("outer.late=150us from tick "), "{said}");
    rig.run("inject", &["plant.late=100us", "--for", "20ms"]).expect(0);
    flight.end().expect(0);
    let report = report(&rig);
    // Ten times slower than in flight: at least 2 ms, and 1.5 ms.
    for (series, least_us) in [("compute.inner", 2000.0), ("compute.outer", 1500.0)] {
        let max_us = report.series(series).unwrap().max_us;
        assert!(max_us >= least_us, "{series}: {max_us} us");
    }
    let half = report.series("compute.inner").unwrap();
    assert!(half.p50_us < 2000.0, "the other two thirds are not late: {half:?}");
    assert_eq!(told(&report)[0], ("inner.late=200us..300us".to_owned(), 100, Some(600), false));
    rig.run("replay", &["--verify"]).expect(0).says("identical");
    rig.assert_nothing_left();
}

/// The processes that keep the processor of a rig busy.
fn burdens(rig: &Rig) -> Vec<u32> {
    rig.processes_of("burden")
}

#[test]
fn the_processor_is_kept_busy_for_a_time_and_by_nobody_afterwards() {
    let rig = Rig::new("busy");
    let config = settings(&rig, 2);
    let options = ["--rt", "off", "--config", &config, "--duration", "4s", "--trajectory", "hover"];
    let flight = rig.take_off(&[&options[..], &["--fault", "cpu.load=0.3@1s..1500ms"]].concat());
    let planned = wait_until("the planned load", || burdens(&rig).first().copied());
    wait_until("its end", || burdens(&rig).is_empty().then_some(()));
    rig.run("inject", &["cpu.load=0.25"]).expect(0);
    let injected = wait_until("the injected load", || burdens(&rig).first().copied());
    assert_ne!(planned, injected);
    rig.run("inject", &["cpu.load=off"]).expect(0);
    wait_until("its end", || burdens(&rig).is_empty().then_some(()));
    let is_root = fifo_refusal(90).is_none();
    if is_root {
        rig.run("inject", &["cpu.hog=90", "--for", "50ms"]).expect(0);
        wait_until("the hog", || burdens(&rig).first().copied());
    } else {
        not_tested("SCHED_FIFO is not granted here");
        let refused = rig.run("inject", &["cpu.hog=90", "--for", "50ms"]).expect(1);
        assert!(refused.stderr.contains("cpu.hog=90: the kernel refuses SCHED_FIFO 90"), "{}", refused.stderr);
    }
    flight.end().expect(0);
    let told = told(&report(&rig));
    let what: Vec<&str> = told.iter().map(|(what, ..)| what.as_str()).collect();
    assert_eq!(what[..3], ["cpu.load=0.3", "cpu.load=0.25", "cpu.load=off"]);
    assert_eq!(what.get(3).copied(), is_root.then_some("cpu.hog=90"));
    rig.assert_nothing_left();
}

#[test]
fn who_keeps_the_processor_busy_or_was_stopped_does_not_outlive_a_launcher_that_is_killed() {
    let rig = Rig::new("orphan");
    let config = settings(&rig, 2);
    let options = ["--rt", "off", "--config", &config, "--duration", "30s", "--trajectory", "hover"];
    let faults = ["--fault", "cpu.load=0.2@300ms", "--fault", "inner.stop=20s@1s"];
    let flight = rig.take_off(&[&options[..], &faults].concat());
    let load = wait_until("the load", || burdens(&rig).first().copied());
    let inner = rig.processes_of("inner")[0];
    let is_stopped = || {
        let stat = fs::read_to_string(format!("/proc/{inner}/stat")).unwrap_or_default();
        stat.rsplit(") ").next().is_some_and(|rest| rest.starts_with('T')).then_some(())
    };
    wait_until("the inner loop to be stopped", is_stopped);
    send(flight.pid(), Signal::KILL);
    flight.end();
    wait_until("the load to end", || is_gone(load).then_some(()));
    wait_until("the inner loop to end", || is_gone(inner).then_some(()));
    let are_gone = || ["plant", "outer", "mixer", "record"].iter().all(|role| rig.processes_of(role).is_empty());
    wait_until("the others to end", || are_gone().then_some(()));
    rig.run("clean", &[]);
    rig.assert_nothing_left();
}

#[test]
fn a_priority_that_the_kernel_refuses_is_refused_before_take_off() {
    let rig = Rig::new("refused");
    let Some(ended) = fly_unprivileged(&rig, &["--rt", "off", "--fault", "cpu.hog=90@1s"]) else { return };
    ended.expect(1).complains("cpu.hog=90: the kernel refuses SCHED_FIFO 90").complains("CAP_SYS_NICE");
}
