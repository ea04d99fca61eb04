//! The autopsy of real flights: the classes that can be caused.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

mod rig;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::thread::sleep;
use std::time::Duration;

use rig::{Rig, send, wait_until};
use rustix::process::Signal;
use shared::clock::now_ns;
use shared::rt::take_stand;

/// A tick [ns].
const T: u64 = 1_000_000;

/// One flight at a time: on the loops' processor, two keep each other from it.
static PROCESSOR: Mutex<()> = Mutex::new(());

/// Waits until a flight has been in the air for a second, and has its first report.
fn await_first_report(rig: &Rig) {
    wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
}

fn counted(rig: &Rig, class: &str, stage: Option<&str>) -> u64 {
    let report = rig.report();
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    let sum: u64 = classes.iter().map(|it| it["count"].as_u64().unwrap()).sum();
    assert_eq!(sum, report["deadlines"]["missed"].as_u64().unwrap(), "{}", report["autopsy"]);
    let of_class = classes.iter().filter(|it| it["class"] == class && it["stage"].as_str() == stage);
    of_class.map(|it| it["count"].as_u64().unwrap()).sum()
}

#[test]
fn a_stopped_mixer_is_found_and_the_report_says_so() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("stopped");
    let flight = rig.take_off(&["--duration", "3s"]);
    await_first_report(&rig);
    let mixer = flight.roles()["mixer"];
    send(mixer, Signal::STOP);
    sleep(Duration::from_millis(100));
    send(mixer, Signal::CONT);
    let ended = flight.end().expect(0).says("Autopsy of missed deadlines").says("stage stopped or dead, mixer");
    // 100 ticks, of which the first and the last may have been stopped between two looks.
    assert!(counted(&rig, "stopped_or_dead", Some("mixer")) >= 70, "{ended}");
    let worst = &rig.report()["autopsy"]["worst"][0];
    assert_eq!(worst["evidence"].as_str().unwrap().split("; ").nth(1), Some("its process was stopped"));
    assert_eq!(worst["timeline"].as_array().unwrap().len(), 4);
}

#[test]
fn a_killed_mixer_is_found() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("killed");
    let flight = rig.take_off(&["--duration", "30s"]);
    await_first_report(&rig);
    let mixer = flight.roles()["mixer"];
    // Else the launcher may end the run before the next command is due.
    flight.signal(Signal::STOP);
    send(mixer, Signal::KILL);
    sleep(Duration::from_millis(30));
    flight.signal(Signal::CONT);
    let ended = flight.end().expect(1);
    assert!(counted(&rig, "stopped_or_dead", Some("mixer")) > 0, "{ended}");
}

#[test]
fn loops_that_somebody_keeps_from_the_processor_were_preempted() {
    let rig = Rig::new("taken");
    if shared::rt::fifo_refusal(99).is_some() {
        println!("SKIPPED: without SCHED_FIFO nobody can be sure to keep the loops from their processor");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let flight = rig.take_off(&["--duration", "3s"]);
    await_first_report(&rig);
    let cpu = shared::rt::loops_cpu();
    std::thread::spawn(move || {
        assert_eq!(take_stand(cpu, 99).priority, 99);
        // From within a tick on: the stages wake meanwhile, and wait.
        let until_ns = now_ns() + 30 * T;
        while now_ns() < until_ns {}
    })
    .join()
    .unwrap();
    let ended = flight.end().expect(0);
    assert!(counted(&rig, "preempted", Some("plant")) > 0, "{ended}");
}

/// A group whose processes can be frozen, gone with the test.
struct Freezer(PathBuf);

impl Freezer {
    const ROOT: &str = "/sys/fs/cgroup/freezer";

    /// Nothing where the system has no such groups, or lets nobody make one.
    fn new() -> Option<Self> {
        let path = Path::new(Self::ROOT).join(format!("ironbird-test-{}", std::process::id()));
        fs::create_dir(&path).ok().map(|()| Self(path))
    }

    fn freeze(&self, pids: &[u32], time: Duration) {
        pids.iter().for_each(|pid| fs::write(self.0.join("cgroup.procs"), pid.to_string()).unwrap());
        fs::write(self.0.join("freezer.state"), "FROZEN").unwrap();
        sleep(time);
        fs::write(self.0.join("freezer.state"), "THAWED").unwrap();
        pids.iter().for_each(|pid| fs::write(Path::new(Self::ROOT).join("cgroup.procs"), pid.to_string()).unwrap());
    }
}

impl Drop for Freezer {
    fn drop(&mut self) {
        let _ = fs::write(self.0.join("freezer.state"), "THAWED");
        let _ = fs::remove_dir(&self.0);
    }
}

#[test]
fn loops_that_are_frozen_together_look_like_a_stall_and_a_single_one_like_a_late_wake_up() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("frozen");
    let Some(freezer) = Freezer::new() else {
        println!("SKIPPED: no group under {} can be made to freeze processes in", Freezer::ROOT);
        return;
    };
    // In slow motion, so that what else happens on the machine misses no deadline.
    let slow = rig.slow(10);
    let flight = rig.take_off(&["--duration", "400ms", "--config", &slow]);
    await_first_report(&rig);
    let roles = flight.roles();
    let loops = ["plant", "outer", "inner", "mixer"].map(|role| roles[role]);
    freezer.freeze(&loops, Duration::from_millis(100));
    sleep(Duration::from_millis(500));
    freezer.freeze(&[roles["mixer"]], Duration::from_millis(100));
    let ended = flight.end().expect(0);
    assert!(counted(&rig, "host_stall", None) > 0, "{ended}");
    let report = rig.report();
    let steps = report["roles"]["mixer"]["realtime"].as_array().unwrap();
    // On a processor of its own, nobody can tell that the mixer alone was frozen.
    if steps.iter().any(|step| step["step"] == "affinity" && step["granted"] == true) {
        assert!(counted(&rig, "wake_late", Some("mixer")) > 0, "{ended}");
    }
}
