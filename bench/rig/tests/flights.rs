//! Whole flights: in processes and in lockstep, at other rates, with pipes in place of files.

use crate::rig::{Ended, Rig, Running, assert_same_rows, wait_until};
use controller::Trajectory;
use controller::gains::PRESET_NAMES;
use messages::parameters::{SPECS, Spec};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::io::Write as _;
use std::process::Command;

/// Flies in ever slower motion until no stage was late for any tick, because only then nothing depends on the machine.
///
/// `fly` is given a slowdown and flies to the end; the rig then holds the report.
fn without_a_miss(rig: &Rig, mut fly: impl FnMut(u64)) {
    let mut late = Vec::new();
    for slowdown in [20, 60, 60, 150, 150] {
        fly(slowdown);
        let report = rig.report();
        let number = |section: &str, key: &str| report[section][key].as_u64().unwrap();
        let stale: u64 = ["outer", "inner", "mixer"]
            .map(|role| stale_or_skipped(&report["roles"][role]))
            .iter()
            .sum();
        let (missed, skipped) = (number("deadlines", "missed"), number("ticks", "skipped"));
        if (missed, skipped, stale) == (0, 0, 0) {
            // Past the harness, which shows what a test prints when it fails alone.
            if !late.is_empty() {
                let _ = writeln!(
                    std::io::stderr().lock(),
                    "TRIES {}: {}",
                    late.len() + 1,
                    late.join("; ")
                );
            }
            return;
        }
        late.push(format!(
            "{missed} missed, {skipped} skipped, {stale} stale with ticks of {slowdown} ms"
        ));
    }
    panic!(
        "ticks were late in spite of slow motion: {}",
        late.join("; ")
    );
}

fn stale_or_skipped(role: &Value) -> u64 {
    role["ticks_stale"].as_u64().unwrap() + role["ticks_skipped"].as_u64().unwrap()
}

/// The states of a simulated flight with a row per tick.
fn simulated(rig: &Rig, args: &str) -> Vec<u8> {
    let path = rig.file("simulated.csv");
    rig.ok(&format!("simulate {args} --every 1 --states {path}"));
    fs::read(path).unwrap()
}

/// Flies and simulates with the same options.
fn flies_in_time_as_simulated(name: &str, options: &str) {
    let rig = Rig::new(name);
    let states = rig.file("flown.csv");
    without_a_miss(&rig, |slowdown| {
        let slow = rig.slow(slowdown);
        rig.ok(&format!(
            "fly --rt prefer --config {slow} --duration 150ms --every 1 --states {states} {options}"
        ));
    });
    assert_eq!(rig.report()["verdict"]["status"], "PASS");
    let flown = fs::read(&states).unwrap();
    assert_same_rows(
        &flown,
        &simulated(&rig, &format!("--duration 150ms {options}")),
        151,
    );
    let in_directory = fs::read(rig.out().join("latest/states.csv")).unwrap();
    assert!(
        in_directory == flown,
        "both copies of the states are the same"
    );
    let report = rig.report();
    assert_eq!(report["recorder"]["incomplete_ticks"], 0);
    assert_eq!(report["deadlines"]["missed_by_stamps"], 0);
    assert_eq!(
        (&report["ticks"]["run"], &report["ticks"]["skipped"]),
        (&151.into(), &0.into())
    );
    rig.assert_nothing_left();
}

#[test]
fn a_flight_without_misses_is_the_simulated_one_byte_for_byte() {
    flies_in_time_as_simulated("same", "");
}

#[test]
#[ignore = "long: part of the gate"]
fn with_the_papers_gains_a_fault_and_gyro_noise_it_is_still_the_simulated_one() {
    flies_in_time_as_simulated(
        "same-paper",
        "--preset paper --trajectory fast --fault gyro_noise_rad_s=0.02@tick7 \
         --fault rotational_drag_nm_s=0.525,mass_kg=0.6@60ms",
    );
}

/// The tick in the answer to a swap.
fn applied_tick(answer: &Ended) -> u64 {
    let after = answer
        .stdout
        .strip_prefix("applied at tick ")
        .unwrap_or_else(|| panic!("{answer}"));
    after.split(' ').next().unwrap().parse().unwrap()
}

/// Swaps in flight, of which the plant takes four; their ticks.
fn fly_and_inject(rig: &Rig, slowdown: u64, states: &str) -> [u64; 4] {
    let slow = rig.slow(slowdown);
    let args = format!("--rt prefer --config {slow} --duration 300ms --every 1 --states {states}");
    let flight = rig.take_off(&args);
    let answer = rig.ok("inject rotational_drag_nm_s=0.525 --at-tick 80");
    assert_eq!(applied_tick(&answer), 80);
    let answer = answer
        .says("parameter epoch 1\n")
        .says("  rotational_drag_nm_s  0.105 -> 0.525 N m s\n");
    // Without an instant it holds from the next tick on, together with whatever comes in the same command.
    let both = rig.ok("inject mass_kg=0.6 rotor_efficiency_3=0.9,gyro_noise_rad_s=0.01");
    assert!(applied_tick(&both) > applied_tick(&answer), "{both}");
    let both = both
        .says("parameter epoch 2\n")
        .says("  mass_kg  0.52 -> 0.6 kg\n");
    let both = both
        .says("  rotor_efficiency_3  1.0 -> 0.9\n")
        .says("  gyro_noise_rad_s  0.0 -> 0.01 rad/s\n");
    // The instance may also be named last, as in every other command.
    let later = rig
        .ok("inject --in 10ms mass_kg=0.5")
        .says("parameter epoch 3\n");
    assert!(applied_tick(&later) >= applied_tick(&both) + 10, "{later}");
    let past = rig.ok("inject --at-tick 81 gyro_noise_rad_s=0.02");
    let past = past.says("parameter epoch 4: tick 81 was past\n");
    assert!(applied_tick(&past) > applied_tick(&later), "{past}");
    flight.end().expect(0);
    [&answer, &both, &later, &past].map(applied_tick)
}

#[test]
#[ignore = "long: part of the gate"]
fn parameters_swapped_by_another_process_hold_from_the_tick_that_it_is_told() {
    let rig = Rig::new("inject");
    let states = rig.file("flown.csv");
    let mut ticks = [0; 4];
    without_a_miss(&rig, |slowdown| {
        ticks = fly_and_inject(&rig, slowdown, &states)
    });
    let change = |name: &str, old: f64, new: f64| serde_json::json!({"name": name, "old": old, "new": new, "over_s": 0.0});
    let changes = [
        vec![change("rotational_drag_nm_s", 0.105, 0.525)],
        vec![
            change("mass_kg", 0.52, 0.6),
            change("rotor_efficiency_3", 1.0, 0.9),
            change("gyro_noise_rad_s", 0.0, 0.01),
        ],
        vec![change("mass_kg", 0.6, 0.5)],
        vec![change("gyro_noise_rad_s", 0.01, 0.02)],
    ];
    let swaps = rig.report()["swaps"].as_array().unwrap().clone();
    assert_eq!(swaps.len(), 4, "{swaps:?}");
    for (i, swap) in swaps.iter().enumerate() {
        assert_eq!(
            (&swap["tick"], &swap["parameter_epoch"]),
            (&ticks[i].into(), &(i as u64 + 1).into())
        );
        assert_eq!(swap["changes"], Value::from(changes[i].clone()));
    }
    let args = format!(
        "--duration 300ms --fault rotational_drag_nm_s=0.525@tick{} \
         --fault mass_kg=0.6,rotor_efficiency_3=0.9,gyro_noise_rad_s=0.01@tick{} \
         --fault mass_kg=0.5@tick{} --fault gyro_noise_rad_s=0.02@tick{}",
        ticks[0], ticks[1], ticks[2], ticks[3]
    );
    assert_same_rows(&fs::read(&states).unwrap(), &simulated(&rig, &args), 301);
    rig.assert_nothing_left();
}

#[test]
fn where_nobody_flies_inject_and_params_say_so() {
    let rig = Rig::new("grounded");
    rig.run("inject", "mass_kg=0.6")
        .expect(1)
        .complains(&format!(
            "no flight is running as instance `{}`",
            rig.instance
        ))
        .complains("no instance flies; start one: ironbird fly");
    let params = rig.ok("params");
    params
        .says("rotational_drag_nm_s")
        .says("no values in force");
    rig.assert_nothing_started();
}

#[test]
#[ignore = "long: part of the gate"]
fn the_report_of_a_flight_in_the_air_says_so() {
    let rig = Rig::new("watched");
    let flight = rig.start(
        "fly",
        format!("--rt off --config {} --duration 250ms", rig.slow(20)),
    );
    let text = wait_until("the first report", || {
        let report = rig.run("report", "latest");
        (report.code == Some(0)).then_some(report)
    });
    text.says("\nFlown     IN FLIGHT, numbers so far: ");
    let json = rig.ok("report latest --format json").json();
    assert_eq!(
        (&json["run"]["in_flight"], &json["run"]["ending"]),
        (&true.into(), &"still flying".into())
    );
    assert_eq!(json["run"]["instance"], rig.instance.as_str());
    let so_far = json["ticks"]["run"].as_u64().unwrap();
    assert!(
        (20..251).contains(&so_far),
        "{so_far} ticks after a second or more"
    );
    let ended = flight.end().expect(0);
    let report = rig.ok("report latest").says("\nFlown     completed: ");
    assert!(!report.stdout.contains("IN FLIGHT"), "{report}");
    assert!(
        ended.stdout.starts_with(&report.stdout),
        "fly prints the same report:\n{ended}\n{report}"
    );
    let json = rig.ok("report latest --format json").json();
    assert_eq!(json, rig.report());
    assert_eq!(json["run"]["in_flight"], false);
    // A busy machine may skip a tick even in slow motion.
    let ticks = |key: &str| json["ticks"][key].as_u64().unwrap();
    assert_eq!(ticks("run") + ticks("skipped"), 251);
}

#[test]
fn a_second_launcher_or_role_of_an_instance_is_rejected_with_a_way_out() {
    let rig = Rig::new("left");
    let flight = rig.take_off("--rt off --duration 600s");
    let second = rig.run("fly", "--rt off").expect(5);
    second
        .complains(&format!(
            "instance `{}` already has a running fly (process {})",
            rig.instance,
            flight.pid()
        ))
        .complains(&format!("--instance {}-2", rig.instance));
    let inner = format!("a running inner (process {})", flight.roles()["inner"]);
    rig.run("inner", "--rt off").expect(5).complains(&inner);
    flight.signal(Signal::INT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn roles_started_by_hand_in_any_order_fly_together() {
    let rig = Rig::new("by-hand");
    let slow = rig.slow(20);
    let args = format!("--rt off --config {slow} --duration 50ms");
    let mixer = rig.start("mixer", &args);
    mixer.await_words("waiting for the plant (`ironbird plant`)");
    let inner = rig.start("inner", &args);
    let recorder = rig.start("record", &args);
    let plant = rig.start("plant", &args);
    plant.await_words("waiting for outer (each with the plant's settings: `ironbird outer` ...)");
    let outer = rig.start("outer", &args);
    for role in [mixer, inner, plant, outer] {
        let ended = role.end().expect(0);
        assert!(
            ended.stdout.is_empty(),
            "what a role says goes to standard error: {ended}"
        );
    }
    let result = recorder
        .end()
        .expect(0)
        .says("\nTiming    NOT MEASURED: slowed 20 times: ")
        .result();
    assert_eq!(
        (result["status"].as_str(), result["ticks"].is_empty()),
        ("PASS", false),
        "{result:?}"
    );
    assert_eq!(rig.report()["run"]["ending"], "completed");
    rig.assert_nothing_left();
}

#[test]
fn a_plant_that_waits_names_the_laws_that_its_roles_need() {
    let rig = Rig::new("laws-wait");
    let plant = rig.start("plant", "--rt off --outer estimating --inner indi");
    plant.await_words(
        "(each with the plant's settings: `ironbird outer --outer estimating --inner indi` ...)",
    );
    plant.signal(Signal::INT);
    plant.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn a_role_with_other_settings_than_the_plants_is_turned_away_and_the_right_one_may_come() {
    let rig = Rig::new("differ");
    let slow = rig.slow(20);
    let args = format!("--rt off --config {slow} --duration 20ms");
    let plant = rig.start("plant", &args);
    plant.await_words("waiting for outer, inner, mixer, record");
    rig.refused(&format!("inner {args} --preset soft"))
        .complains("the inner process has other settings than the plant")
        .complains("`flight.preset` is \"soft\" for inner and \"flight\" for the plant")
        .complains("start every role with the same --config, --trajectory, --preset, --duration and --fault");
    rig.refused(&format!("outer --rt off --config {slow} --duration 30ms"))
        .complains("`flight.duration_s` is 0.03 for outer and 0.02 for the plant");
    rig.refused(&format!("mixer {args} --inner indi"))
        .complains("`inner.law` is \"indi\" for mixer and \"adaptive\" for the plant")
        .complains("--duration and --fault, and like the plant with --inner adaptive");
    let others: Vec<_> = ["outer", "inner", "mixer", "record"]
        .iter()
        .map(|role| rig.start(role, &args))
        .collect();
    for role in others.into_iter().chain([plant]) {
        role.end().expect(0);
    }
    rig.assert_nothing_left();
}

#[test]
fn a_signal_ends_a_plant_that_waits_for_the_others() {
    let rig = Rig::new("lonely");
    let plant = rig.start("plant", "--rt off");
    plant.await_words("waiting for");
    rig.run("inject", "mass_kg=0.6")
        .expect(1)
        .complains(&format!(
            "instance `{}` has not taken off, or has landed",
            rig.instance
        ))
        .complains("a flight begins when plant, outer, inner and mixer are ready");
    plant.signal(Signal::INT);
    plant.end().expect(130).complains("interrupted");
    rig.assert_nothing_left();
}

/// A swap of a parameter to a value that a flight survives.
fn swap_of(spec: &Spec, instant: &str) -> String {
    let other = match spec.nominal {
        0.0 => 1e-3,
        nominal => nominal * 0.97,
    };
    format!("{}={other}@{instant}", spec.name)
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_is_the_simulated_one_for_every_trajectory_preset_and_parameter() {
    let mut parameters = SPECS.iter().cycle();
    for trajectory in Trajectory::ALL {
        for preset in PRESET_NAMES {
            let rig = Rig::new("lockstep");
            let faults = ["tick1", "333ms", "tick777", "tick777"]
                .map(|at| swap_of(parameters.next().unwrap(), at));
            let faults = faults.map(|fault| format!(" --fault {fault}")).concat();
            let options =
                format!("--trajectory {trajectory} --preset {preset} --duration 1500ms{faults}");
            let [ended, _] = rig.flies_as_simulated(&options, 1501);
            ended.tells("latencies are not real-time latencies");
            let report = rig.report();
            assert_eq!(
                (&report["ticks"]["run"], &report["deadlines"]["missed"]),
                (&1501.into(), &0.into())
            );
            assert_eq!(
                (
                    &report["recorder"]["lost"]["state"],
                    report["swaps"].as_array().unwrap().len()
                ),
                (&0.into(), 4)
            );
            rig.assert_nothing_left();
        }
    }
}

/// Settings of a flight of 250 Hz, whose gains its longer delay allows, and of one of 4 kHz.
const RATES: [(&str, usize, &str); 2] = [
    (
        "250 Hz",
        501,
        "[flight]\nperiod_s = 0.004\nduration_s = 2.0\n[inner]\nalpha_1_s = 50.0\nattitude_1_s = [3.0, 3.0, 1.0]\n",
    ),
    (
        "4 kHz",
        2001,
        "[flight]\nperiod_s = 0.00025\nduration_s = 0.5\n",
    ),
];

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_in_lockstep_at_another_rate_is_the_simulated_one() {
    for (_, ticks, settings) in RATES {
        let rig = Rig::new("rates");
        let config = rig.settings(settings);
        rig.flies_as_simulated(&format!("--config {config}"), ticks);
        rig.assert_nothing_left();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_on_the_clock_at_another_rate_passes() {
    for (rate, _, settings) in RATES {
        let rig = Rig::new("clock");
        // In slow motion: a tick takes 20 ms, and the laws keep their T.
        let slowdown = if rate == "4 kHz" { 80 } else { 5 };
        let duration = if rate == "4 kHz" { "40ms" } else { "640ms" };
        let slow = settings.replace("[flight]\n", &format!("[flight]\nslowdown = {slowdown}\n"));
        let config = rig.settings(&slow);
        let ended = rig.ok(&format!(
            "fly --rt off --config {config} --duration {duration}"
        ));
        assert_eq!(ended.result()["status"], "PASS", "{rate}");
        let report = rig.report();
        let ticks = |key: &str| report["ticks"][key].as_u64().unwrap();
        assert_eq!(ticks("run") + ticks("skipped"), 161, "{rate}");
        assert_eq!(report["run"]["ending"], "completed", "{rate}");
        rig.assert_nothing_left();
    }
}

const SHORT: &str = "--pace lockstep --duration 500ms";

fn make_pipe(rig: &Rig, name: &str) -> String {
    let pipe = rig.file(name);
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    pipe
}

/// A pipe, and who reads it: until the first one who writes closes it.
fn read_pipe(rig: &Rig, name: &str) -> (String, Running) {
    let pipe = make_pipe(rig, name);
    let mut reader = Command::new("cat");
    reader.arg(&pipe);
    let reader = rig.launch(reader);
    // It sleeps until somebody writes, and not before it has the pipe.
    let stat = || fs::read_to_string(format!("/proc/{}/stat", reader.pid())).unwrap();
    wait_until("the pipe's reader", || {
        stat().contains("(cat) S ").then_some(())
    });
    (pipe, reader)
}

#[test]
fn who_reads_a_pipe_gets_what_would_be_in_the_file() {
    let rig = Rig::new("piped");
    let ((states, states_reader), (junit, junit_reader)) =
        (read_pipe(&rig, "states"), read_pipe(&rig, "junit"));
    rig.ok(&format!("fly {SHORT} --states {states} --junit {junit}"));
    let flown = fs::read_to_string(rig.out().join("latest/states.csv")).unwrap();
    assert_eq!(states_reader.end().expect(0).stdout, flown);
    let of_flight = junit_reader.end().expect(0).stdout;
    assert!(
        of_flight.contains("<testsuite ") && of_flight.ends_with("</testsuites>\n"),
        "{of_flight}"
    );
    let (junit, junit_reader) = read_pipe(&rig, "again");
    rig.ok(&format!("report --junit {junit}"));
    assert_eq!(junit_reader.end().expect(0).stdout, of_flight);
    let ((states, states_reader), (plot, plot_reader)) =
        (read_pipe(&rig, "simulated"), read_pipe(&rig, "plot.svg"));
    rig.ok(&format!(
        "simulate --duration 500ms --states {states} --plot {plot}"
    ));
    assert_eq!(states_reader.end().expect(0).stdout, flown);
    assert!(plot_reader.end().expect(0).stdout.ends_with("</svg>"));
}

#[test]
fn a_pipe_that_nobody_reads_is_named_and_waited_for_by_nobody() {
    let rig = Rig::new("unread");
    let pipe = make_pipe(&rig, "pipe.svg");
    let words = format!("{pipe}: it is a pipe that nobody reads");
    for flag in ["--states", "--plot"] {
        rig.run("simulate", format!("--duration 100ms {flag} {pipe}"))
            .expect(1)
            .complains(&words);
    }
    rig.run("fly", format!("{SHORT} --states {pipe}"))
        .expect(1)
        .complains(&words);
    assert!(
        rig.run_directories().is_empty(),
        "{:?}",
        rig.run_directories()
    );
    let flown = rig
        .run("fly", format!("{SHORT} --junit {pipe}"))
        .expect(1)
        .complains(&words);
    assert_eq!(flown.result()["status"], "PASS", "{flown}");
    rig.run("report", format!("--junit {pipe}"))
        .expect(1)
        .complains(&words);
    rig.assert_nothing_left();
}
