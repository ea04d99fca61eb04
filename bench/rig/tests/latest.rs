//! The link `latest`: where it leads, when it moves, and what is in its way.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, wait_until};
use rustix::process::Signal;

#[test]
fn latest_stays_where_it_was_until_a_flight_has_a_report() {
    let rig = Rig::new("latest");
    let latest = || fs::read_link(rig.out().join("latest")).unwrap();
    rig.run("fly", &["--rt", "off", "--duration", "100ms"]);
    let flown = latest();
    assert_eq!(rig.run_directories(), [flown.to_str().unwrap()]);
    // Without a plant to fly with: it waits.
    let recorder = rig.start("record", &["--rt", "off"]);
    recorder.await_words("waiting for");
    assert_eq!((latest(), rig.run_directories().len()), (flown.clone(), 2));
    recorder.signal(Signal::TERM);
    recorder.end().expect(130);
    assert_eq!((latest(), rig.run_directories().len()), (flown.clone(), 1), "an empty directory is removed");
    let flight = rig.take_off(&["--rt", "off", "--duration", "600s"]);
    wait_until("the first report", || (latest() != flown).then_some(()));
    assert!(rig.out().join("latest/report.json").exists());
    flight.signal(Signal::INT);
    flight.end().expect(130);
}

#[test]
fn a_directory_called_latest_stays_and_the_report_says_so() {
    let rig = Rig::new("no-link");
    let directory = rig.out().join("latest");
    fs::create_dir_all(&directory).unwrap();
    let words = format!("latest is incomplete: cannot point to the flight with {}: Is a direct", directory.display());
    rig.run("fly", &["--pace", "lockstep", "--duration", "100ms"]).expect(0).tells(&format!("NOT WHOLE: {words}"));
    assert!(fs::symlink_metadata(&directory).unwrap().is_dir() && rig.run_directories().len() == 1);
    let left: Vec<_> = fs::read_dir(rig.out()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "a draft of the link is left: {left:?}");
}
