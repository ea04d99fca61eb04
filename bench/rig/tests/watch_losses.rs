//! What the dashboard says when it loses the recorder, or the file of the trajectory.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, wait_until};
use rustix::process::Signal;

#[test]
fn without_its_recorder_a_flight_is_told_as_of_when_it_was_seen_last() {
    let rig = Rig::new("unrecorded");
    let config = rig.slow(10);
    let args = ["--rt", "off", "--config", config.as_str(), "--duration", "1h"];
    let roles = ["record", "plant", "outer", "inner", "mixer"].map(|role| rig.start(role, &args));
    rig.await_flight();
    let watch = rig.start("watch", &["--plain"]);
    wait_until("the theorem in a line", || watch.stdout().contains("   violations ").then_some(()));
    assert!(!watch.stdout().contains("no recorder"), "{}", watch.stdout());
    let [recorder, plant, ..] = &roles;
    recorder.signal(Signal::KILL);
    wait_until("a line of the loss", || {
        let told = watch.stdout();
        let last = told.lines().last().unwrap_or_default();
        let tick = last.strip_prefix("tick ").and_then(|rest| rest.split(' ').next()).unwrap_or_default().to_owned();
        last.contains(&format!("   no recorder: as of tick {tick}, not watched since")).then_some(())
    });
    plant.signal(Signal::INT);
    watch.end().expect(0).says("not watched since   interrupted\n");
    roles.into_iter().for_each(|role| drop(role.end()));
    rig.run("clean", &[]);
}

#[test]
fn a_trajectory_file_that_has_changed_ends_a_watch_with_what_to_do() {
    let rig = Rig::new("moved-points");
    let file = rig.file("climb.csv");
    let points = "t,x,y,z,yaw\n0,0,0,0,0\n5,0.5,0,0.5,0\n";
    fs::write(&file, points).unwrap();
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(10), "--duration", "1h", "--trajectory", &file]);
    fs::write(&file, points.replace("0.5,0,0.5", "0.6,0,0.5")).unwrap();
    let changed = rig.run("watch", &["--plain"]).expect(1);
    changed
        .complains("climb.csv has changed since the flight began")
        .complains("help: bring back the file whose SHA-256 is ")
        .complains("and watch again; the flight itself goes on, and flight.mcap keeps its points");
    fs::remove_file(&file).unwrap();
    let gone = rig.run("watch", &["--plain"]).expect(1);
    gone.complains("the trajectory of the flight cannot be shown: ")
        .complains("help: bring back the file whose SHA-256");
    flight.signal(Signal::INT);
    flight.end().expect(130);
}
