//! The report of a recorder that saw half a flight.

use crate::rig::Rig;
use rustix::process::Signal;

#[test]
#[ignore = "long: part of the gate"]
fn a_recorder_that_saw_half_a_flight_says_so_and_so_does_the_one_that_was_killed() {
    let rig = Rig::new("half");
    let options = rig.slowly(2, "3s");
    let stages = ["plant", "outer", "inner", "mixer"].map(|role| rig.start(role, &options));
    let first = rig.start("record", &options);
    rig.await_report();
    rig.ok("report").says("IN FLIGHT");
    first.signal(Signal::KILL);
    assert_eq!(first.end().code, None);
    let second = rig.start("record", options).end().expect(0);
    for stage in stages {
        stage.end().expect(0);
    }
    let [dead, _] = <[String; 2]>::try_from(rig.run_directories()).unwrap();
    rig.ok(&format!("report {dead}"))
        .says("\nFlown     the recorder of this flight died at 2")
        .says("\nGates     ABORTED");
    let report = rig.final_report();
    let lost: u64 = report.recorder.lost.values().sum();
    assert!(lost > 100, "{lost}");
    // Nor does it judge the estimates, whose beginning it does not know.
    let theorem = &report.theorem;
    assert!(theorem.ticks_checked == 0 && theorem.ticks_unwatched > 100);
    let result = second.result();
    assert_eq!(result["status"], "INCOMPLETE");
    assert_eq!(result["lost"], lost.to_string());
    let top: Vec<&str> = second.stdout.lines().take(9).collect();
    let line = format!("INCOMPLETE RECORD: {lost} of ");
    assert!(top.iter().any(|it| it.starts_with(&line)), "{second}");
    // What it has not seen, it does not call late.
    assert!(report.deadlines.missed_by_stamps <= report.deadlines.missed);
    assert_eq!(report.ticks.run + report.ticks.skipped, 3001);
    assert!(report.series("loop").unwrap().count < report.ticks.run);
}
