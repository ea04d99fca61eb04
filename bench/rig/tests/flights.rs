//! Whole flights: in processes and in lockstep, at other rates, with pipes in place of files.

use crate::rig::{Rig, Running, assert_same_rows, wait_until};
use controller::Trajectory;
use controller::gains::PRESET_NAMES;
use messages::parameters::SPECS;
use std::fs;
use std::io::Write as _;
use std::process::Command;

/// Flies in ever slower motion until no stage was late for any tick, because only then nothing depends on the machine.
fn without_a_miss(rig: &Rig, fly: impl Fn(u64)) {
    let mut late = Vec::new();
    for slowdown in [20, 60, 60, 150, 150] {
        fly(slowdown);
        let report = rig.final_report();
        let stages = ["outer", "inner", "mixer"].map(|role| &report.roles[role]);
        let stale = stages.map(|role| role.ticks_stale + role.ticks_skipped);
        let found = (report.deadlines.missed, report.ticks.skipped, stale);
        if found == (0, 0, [0; 3]) {
            if !late.is_empty() {
                // Past the harness, which shows what a test prints when it fails alone.
                let _ = writeln!(
                    std::io::stderr().lock(),
                    "TRIES {}: {late:?}",
                    late.len() + 1
                );
            }
            return;
        }
        late.push((slowdown, found));
    }
    panic!("slowdown, missed, skipped and stale ticks: {late:?}");
}

#[test]
fn a_flight_without_misses_is_the_simulated_one_byte_for_byte() {
    let rig = Rig::new("same");
    let (states, simulated) = (rig.file("flown.csv"), rig.file("simulated.csv"));
    let options = "--duration 150ms --every 1 --preset paper --trajectory fast \
                   --fault gyro_noise_rad_s=0.02@tick7 --fault rotational_drag_nm_s=0.525,mass_kg=0.6@60ms";
    without_a_miss(&rig, |slowdown| {
        let slow = rig.slow(slowdown);
        rig.ok(&format!(
            "fly --rt prefer --config {slow} --states {states} {options}"
        ));
    });
    rig.ok(&format!("simulate {options} --states {simulated}"));
    let flown = fs::read(&states).unwrap();
    assert_same_rows(&flown, &fs::read(&simulated).unwrap(), 151);
    assert_eq!(rig.flown("states.csv").as_bytes(), flown, "both copies");
    let report = rig.report();
    assert_eq!(report["verdict"]["status"], "PASS");
    assert_eq!(report["recorder"]["incomplete_ticks"], 0);
    assert_eq!(report["deadlines"]["missed_by_stamps"], 0);
    assert_eq!(report["ticks"]["run"], 151);
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn the_report_of_a_flight_in_the_air_says_so() {
    let rig = Rig::new("watched");
    let flight = rig.start("fly", rig.slowly(20, "250ms"));
    rig.await_report();
    rig.ok("report latest")
        .says("\nFlown     IN FLIGHT, numbers so far: ");
    let json = rig.ok("report latest --format json").json();
    assert_eq!(json["run"]["in_flight"], true);
    assert_eq!(json["run"]["ending"], "still flying");
    assert_eq!(json["run"]["instance"], rig.instance.as_str());
    // After a second or more.
    assert!((20..251).contains(&json["ticks"]["run"].as_u64().unwrap()));
    let ended = flight.end().expect(0);
    let report = rig.ok("report latest").says("\nFlown     completed: ");
    assert!(!report.stdout.contains("IN FLIGHT"), "{report}");
    assert!(ended.stdout.starts_with(&report.stdout), "{ended}");
    let json = rig.ok("report latest --format json").json();
    assert_eq!(json, rig.report());
    // A busy machine may skip a tick even in slow motion.
    let ticks = rig.final_report().ticks;
    assert_eq!(ticks.run + ticks.skipped, 251);
}

#[test]
fn a_second_supervisor_or_role_of_an_instance_is_rejected_with_a_way_out() {
    let rig = Rig::new("left");
    let flight = rig.take_off("--rt off --duration 600s");
    let (instance, pid) = (&rig.instance, flight.pid());
    let running = format!("instance `{instance}` already has a running fly (process {pid})");
    let second = rig.run("fly", "--rt off").expect(5).complains(&running);
    second.complains(&format!("--instance {instance}-2"));
    for (role, pid) in flight.roles() {
        let running = format!("a running {role} (process {pid})");
        rig.run(&role, "--rt off").expect(5).complains(&running);
    }
    flight.interrupt().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn roles_started_by_hand_in_any_order_fly_together_and_one_with_other_settings_is_refused() {
    let rig = Rig::new("by-hand");
    let slow = rig.slow(20);
    let args = format!("--rt off --config {slow} --duration 50ms");
    let mixer = rig.start("mixer", &args);
    mixer.await_words("waiting for the plant (`ironbird plant`)");
    let inner = rig.start("inner", &args);
    let recorder = rig.start("record", &args);
    let plant = rig.start("plant", &args);
    plant.await_words("waiting for outer (each with the plant's settings: `ironbird outer` ...)");
    for (line, words) in [
        (
            format!("outer {args} --preset soft"),
            [
                "the outer process has other settings than the plant",
                "`flight.preset` is \"soft\" for outer and \"flight\" for the plant",
                "start every role with the same --config, --trajectory, --preset, --duration and --fault",
            ],
        ),
        (
            format!("outer --rt off --config {slow} --duration 30ms"),
            [
                "`flight.duration_s` is 0.03 for outer and 0.05 for the plant",
                "",
                "",
            ],
        ),
        (
            format!("outer {args} --inner indi"),
            [
                "`inner.law` is \"indi\" for outer and \"adaptive\" for the plant",
                "--duration and --fault, and like the plant with --inner adaptive",
                "",
            ],
        ),
    ] {
        let refused = rig.refused(&line);
        words
            .into_iter()
            .fold(refused, |it, words| it.complains(words));
    }
    let outer = rig.start("outer", &args);
    for role in [mixer, inner, plant, outer] {
        // What a role says goes to standard error.
        assert_eq!(role.end().expect(0).stdout, "");
    }
    let ended = recorder.end().expect(0);
    let ended = ended.says("\nTiming    NOT MEASURED: slowed 20 times: ");
    assert_eq!(ended.result()["status"], "PASS", "{ended}");
    assert_eq!(rig.report()["run"]["ending"], "completed");
    rig.assert_nothing_left();
}

#[test]
fn a_plant_that_waits_names_the_laws_that_its_roles_need_and_ends_on_a_signal() {
    let rig = Rig::new("lonely");
    let plant = rig.start("plant", "--rt off --outer estimating --inner indi");
    plant.await_words(
        "(each with the plant's settings: `ironbird outer --outer estimating --inner indi` ...)",
    );
    let instance = &rig.instance;
    rig.run("inject", "mass_kg=0.6")
        .expect(1)
        .complains(&format!(
            "instance `{instance}` has not taken off, or has landed"
        ))
        .complains("a flight begins when plant, outer, inner and mixer are ready");
    plant.interrupt().expect(130).complains("interrupted");
    rig.assert_nothing_left();
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_is_the_simulated_one_for_every_trajectory_preset_and_parameter() {
    let mut parameters = SPECS.iter().cycle();
    for trajectory in Trajectory::ALL {
        for preset in PRESET_NAMES {
            let rig = Rig::new("lockstep");
            // Values that a flight survives.
            let faults = ["tick1", "333ms", "tick777", "tick777"].map(|at| {
                let spec = parameters.next().unwrap();
                let is_zero = spec.nominal == 0.0;
                let value = if is_zero { 1e-3 } else { spec.nominal * 0.97 };
                format!(" --fault {}={value}@{at}", spec.name)
            });
            let faults = faults.concat();
            let options =
                format!("--trajectory {trajectory} --preset {preset} --duration 1500ms{faults}");
            let [ended, _] = rig.flies_as_simulated(&options, 1501);
            ended.tells("latencies are not real-time latencies");
            let report = rig.final_report();
            assert_eq!((report.ticks.run, report.deadlines.missed), (1501, 0));
            assert_eq!((report.recorder.lost["state"], report.swaps.len()), (0, 4));
            rig.assert_nothing_left();
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn flights_at_other_rates_are_the_simulated_ones_in_lockstep_and_pass_on_the_clock() {
    // In slow motion, a tick takes 20 ms, and the laws keep their T. The gains of 250 Hz allow its longer delay.
    for (settings, ticks, slowdown, duration) in [
        (
            "period_s = 0.004\nduration_s = 2.0\n[inner]\nalpha_1_s = 50.0\nattitude_1_s = [3.0, 3.0, 1.0]\n",
            501,
            5,
            "640ms",
        ),
        ("period_s = 0.00025\nduration_s = 0.5\n", 2001, 80, "40ms"),
    ] {
        let rig = Rig::new("rates");
        let config = rig.settings(&format!("[flight]\n{settings}"));
        rig.flies_as_simulated(&format!("--config {config}"), ticks);
        let slow = rig.settings(&format!("[flight]\nslowdown = {slowdown}\n{settings}"));
        let ended = rig.ok(&format!(
            "fly --rt off --config {slow} --duration {duration}"
        ));
        assert_eq!(ended.result()["status"], "PASS", "{ended}");
        let report = rig.final_report();
        assert_eq!(report.ticks.run + report.ticks.skipped, 161);
        assert_eq!(report.run.ending, "completed");
        rig.assert_nothing_left();
    }
}

const SHORT: &str = "--pace lockstep --duration 500ms";

fn make_pipe(rig: &Rig, name: &str) -> String {
    let pipe = rig.file(name);
    let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    pipe
}

/// A pipe, and its reader, which ends when the first writer closes it.
fn read_pipe(rig: &Rig, name: &str) -> (String, Running) {
    let pipe = make_pipe(rig, name);
    let mut reader = Command::new("cat");
    reader.arg(&pipe);
    let reader = rig.launch(reader);
    // It sleeps until a writer comes, and not before it has the pipe.
    let stat = || fs::read_to_string(format!("/proc/{}/stat", reader.pid())).unwrap();
    wait_until("the pipe's reader", || {
        stat().contains("(cat) S ").then_some(())
    });
    (pipe, reader)
}

#[test]
fn the_reader_of_a_pipe_gets_what_would_be_in_the_file() {
    let rig = Rig::new("piped");
    let read = |reader: Running| reader.end().expect(0).stdout;
    let (states, states_reader) = read_pipe(&rig, "states");
    let (junit, junit_reader) = read_pipe(&rig, "junit");
    rig.ok(&format!("fly {SHORT} --states {states} --junit {junit}"));
    let flown = rig.flown("states.csv");
    assert_eq!(read(states_reader), flown);
    let cases = read(junit_reader);
    assert!(cases.contains("<testsuite ") && cases.ends_with("</testsuites>\n"));
    let (junit, junit_reader) = read_pipe(&rig, "again");
    rig.ok(&format!("report --junit {junit}"));
    assert_eq!(read(junit_reader), cases);
    let (states, states_reader) = read_pipe(&rig, "simulated");
    let (plot, plot_reader) = read_pipe(&rig, "plot.svg");
    rig.ok(&format!(
        "simulate --duration 500ms --states {states} --plot {plot}"
    ));
    assert_eq!(read(states_reader), flown);
    assert!(read(plot_reader).ends_with("</svg>"));
}

#[test]
fn a_pipe_without_a_reader_is_named_and_not_waited_for() {
    let rig = Rig::new("unread");
    let pipe = make_pipe(&rig, "pipe.svg");
    let fails = |line: &str| {
        let (command, args) = line.split_once(' ').unwrap();
        let ended = rig.run(command, format!("{args} {pipe}")).expect(1);
        ended.complains(&format!("{pipe}: it is a pipe that nobody reads"))
    };
    fails("simulate --duration 100ms --states");
    fails("simulate --duration 100ms --plot");
    fails(&format!("fly {SHORT} --states"));
    assert_eq!(rig.run_directories(), [""; 0]);
    let flown = fails(&format!("fly {SHORT} --junit"));
    assert_eq!(flown.result()["status"], "PASS", "{flown}");
    fails("report --junit");
    rig.assert_nothing_left();
}
