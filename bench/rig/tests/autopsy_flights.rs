//! The autopsy of real flights: every class is caused on purpose, but for the recorder that cannot tell.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::PoisonError;
use std::thread::sleep;
use std::time::Duration;

use crate::causes::{
    PROCESSOR, T, TRACEFS, TRACES, await_first_report, fly_with_a_troubled_mixer, hog, take_off_traced, worst,
};
use crate::rig::{Rig, in_own_mounts, not_tested, send, stop_for};
use rustix::process::Signal;
use serde_json::Value;

/// Outages of a class in the report, with the deadlines missed in them; every missed deadline belongs to one.
fn counted(rig: &Rig, class: &str, stage: Option<&str>) -> (u64, u64) {
    let report = rig.report();
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    let sum: u64 = classes.iter().map(|it| it["missed"].as_u64().unwrap()).sum();
    assert_eq!(sum, report["deadlines"]["missed"].as_u64().unwrap(), "{}", report["autopsy"]);
    let of_class = classes.iter().filter(|it| it["class"] == class && it["stage"].as_str() == stage);
    of_class.fold((0, 0), |(outages, missed), it| {
        (outages + it["outages"].as_u64().unwrap(), missed + it["missed"].as_u64().unwrap())
    })
}

#[test]
#[ignore = "long: part of the gate"]
fn a_stopped_mixer_is_found_and_the_report_says_so() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("stopped");
    // In slow motion, so that what else happens on the machine misses no deadline.
    let flight = rig.take_off(&["--duration", "300ms", "--config", &rig.slow(10)]);
    await_first_report(&rig);
    stop_for(flight.roles()["mixer"], Duration::from_millis(500));
    let ended = flight.end().expect(0).says("stage stopped or dead, mixer");
    let (outages, missed) = counted(&rig, "stopped_or_dead", Some("mixer"));
    assert_eq!(outages, 1, "{ended}");
    assert!(missed >= 49, "50 ticks of 10 ms: {ended}");
    let case = worst(&rig).into_iter().find(|case| case["class"] == "stopped_or_dead").unwrap();
    assert!(case["ticks"].as_u64().unwrap() >= missed, "{case}");
    assert!(case["delay_us"].as_f64().unwrap() >= 490e3, "{case}");
    assert_eq!(case["evidence"].as_str().unwrap().split("; ").nth(1), Some("its process was stopped"));
    // Ticks around it in which nobody published are not in it.
    assert!((1..=8).contains(&case["timeline"].as_array().unwrap().len()), "{case}");
}

#[test]
#[ignore = "long: part of the gate"]
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
    assert_eq!(counted(&rig, "stopped_or_dead", Some("mixer")).0, 1, "{ended}");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_trace_names_who_kept_the_loops_from_their_processor() {
    if role::rt::fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nobody can be sure to keep the loops from their processor");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("traced");
    // In slow motion, so that a stall of the host is no match for it.
    let slow = rig.slow(10);
    let Some(flight) = take_off_traced(&rig, &["--duration", "300ms", "--config", &slow]) else { return };
    await_first_report(&rig);
    hog(300 * T);
    let ended = flight.end().expect(0);
    assert!(counted(&rig, "preempted", Some("plant")).1 >= 29, "{ended}");
    let is_hogs = |case: &Value| case["ran"][0]["who"].as_str().is_some_and(|who| who.starts_with("hog ("));
    let case = worst(&rig).into_iter().find(is_hogs).unwrap_or_else(|| panic!("no hog in {ended}"));
    assert!(case["ran"][0]["us"].as_f64().unwrap() >= 250e3, "{case}");
    assert!(case["missed"].as_u64().unwrap() >= 29, "{case}");
}

#[test]
fn a_trace_that_killed_processes_left_is_found_and_removed() {
    let rig = Rig::new("untraced");
    let Some(mut flight) = in_own_mounts(TRACEFS, TRACES, "sh") else { return };
    // What killed processes leave: the launcher and the recorder are gone before they could remove it.
    let script = "for s in 0.01 0.02 0.03 0.05 0.08; do
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" > /dev/null 2>&1 & fly=$!
sleep $s; kill -INT $fly; wait $fly; done
ls /sys/kernel/tracing/instances; echo STOPPED
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" & fly=$!
until grep -qs ticks_run \"$2\"/latest/report.json; do sleep 0.05; done
kill -KILL $(pgrep -f -- \"--instance $3\") $fly
sleep 0.2
echo; echo TRIED; \"$1\" clean --dry-run; echo CLEANED; \"$1\" clean; echo AGAIN; \"$1\" clean; ls /sys/kernel/tracing/instances";
    let out = rig.out();
    flight.args(["-c", script, "sh", rig::IRONBIRD, out.to_str().unwrap(), &rig.instance]);
    flight.env("IRONBIRD_ROOT", rig.root());
    let ended = rig.launch(flight).end().expect(0);
    let (stopped, _) = ended.stdout.split_once("STOPPED").unwrap();
    // Other tests trace, too, under roots of their own.
    let prefix = rig.known().prefix();
    let of_root = prefix.split_inclusive('_').take(2).collect::<String>();
    assert!(!stopped.contains(&of_root), "who is told to end leaves none: {ended}");
    let (tried, rest) = ended.stdout.split_once("CLEANED").unwrap();
    let (cleaned, again) = rest.split_once("AGAIN").unwrap();
    assert!(tried.contains(&format!("would remove the kernel's trace {of_root}")), "{ended}");
    assert!(cleaned.contains(&format!("\nremoved the kernel's trace {of_root}")), "{ended}");
    assert!(again.contains("nothing to remove") && !again.contains(&rig.instance), "{ended}");
}

#[test]
#[ignore = "long: part of the gate"]
fn loops_that_somebody_keeps_from_the_processor_were_ready_and_not_run() {
    let rig = Rig::new("taken");
    if role::rt::fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nobody can be sure to keep the loops from their processor");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    // In slow motion, so that a stall of the host is no match for it.
    let flight = rig.take_off(&["--duration", "300ms", "--config", &rig.slow(10)]);
    await_first_report(&rig);
    hog(300 * T);
    let ended = flight.end().expect(0);
    // Without a trace, who ran is seen only by what the kernel counts: a virtual machine does not show it surely.
    let missed = ["preempted", "ready_not_run"].map(|class| counted(&rig, class, Some("plant")).1);
    assert!(missed.iter().sum::<u64>() >= 29, "{ended}");
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
#[ignore = "long: part of the gate"]
fn loops_that_are_frozen_together_look_like_a_stall_and_a_single_one_like_a_late_wake_up() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("frozen");
    let Some(freezer) = Freezer::new() else {
        not_tested(&format!("no group under {} can be made to freeze processes in", Freezer::ROOT));
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
    // Where somebody else has the processor meanwhile, nobody can tell.
    let together = ["processor_stalled", "cannot_tell"].map(|class| counted(&rig, class, None).1);
    assert!(together.iter().sum::<u64>() >= 9, "{ended}");
    let report = rig.report();
    let steps = report["roles"]["mixer"]["realtime"].as_array().unwrap();
    // On a processor of its own, nobody can tell that the mixer alone was frozen.
    if steps.iter().any(|step| step["step"] == "affinity" && step["granted"] == true) {
        assert!(counted(&rig, "wake_late", Some("mixer")).0 > 0, "{ended}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_mixer_that_computes_long_or_faults_and_an_input_that_is_not_heard_are_told_apart() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("troubled");
    let ended = fly_with_a_troubled_mixer(&rig);
    // What takes the processor from the mixer meanwhile may pass for the cause, but not every time.
    for (class, stage) in [("computed_long", "mixer"), ("page_fault", "mixer"), ("not_used", "inner")] {
        assert!(counted(&rig, class, Some(stage)).0 > 0, "{class}: {ended}");
    }
}
