//! Faults that are injected into a running flight, or planned: into messages, stages, processes and the processor.

use crate::c_laws::misbehaving;
use crate::rig::{Rig, send, wait_until};
use flight_log::fault_record::injected;
use rustix::process::Signal;
use serde_json::Value;

/// What follows a word, to the next blank.
pub(crate) fn after<'a>(text: &'a str, word: &str) -> &'a str {
    let (_, rest) = text
        .split_once(word)
        .unwrap_or_else(|| panic!("no `{word}` in {text}"));
    rest.split_whitespace().next().unwrap()
}

/// The tick from which an injection acts, by the answer.
fn from_tick(answer: &str) -> u64 {
    let lasts = answer.contains(" from tick ");
    let word = if lasts { " from tick " } else { " at tick " };
    after(answer, word).parse().unwrap()
}

#[test]
fn a_flight_with_injections_is_the_one_that_was_planned_so_and_it_is_replayed() {
    let rig = Rig::new("same");
    // In lockstep, with a law that sleeps for 3 ms in each tick: the flight lasts until all is injected.
    let law = misbehaving(&rig, "sleep", 0);
    let options = format!("--config {law} --duration 3s");
    let flight = rig.take_off(format!("--pace lockstep {options}"));
    let mut planned = options.clone();
    let mut first = 0;
    // One after the other, each when it comes: which ticks these are is not known before.
    for (fault, flags) in [
        (
            "state.drop=0.2,rotor_speeds.delay=2,outer.state.freeze",
            "--for 100ms",
        ),
        (
            "inner.setpoint.lag=4,state.position_w_m.z.noise=0.001,wrench.thrust_n.bias=0.01",
            "",
        ),
        (
            "mass_kg=0.6,rotor_efficiency_3=0.9,gyro_noise_rad_s=0.01",
            "",
        ),
        ("state.position_w_m.noise=off,setpoint.lag=off", ""),
        ("mass_kg=0.5", "--in 10ms"),
    ] {
        let tick = from_tick(&rig.ok(&format!("inject {fault} {flags}")).stdout);
        planned += &format!(" --fault {fault}@tick{tick}");
        if flags == "--for 100ms" {
            first = tick;
            planned += &format!("..tick{}", tick + 100);
        }
    }
    flight.end().expect(0);
    let replayed = rig.ok("replay --verify").says("identical");
    let outputs = after(&replayed.stdout, "; outputs ");
    let simulated = |options: &str| rig.run("simulate", options).expect(0).stdout;
    assert_eq!(
        outputs,
        after(&simulated(&planned), " outputs="),
        "{planned}"
    );
    assert_ne!(outputs, after(&simulated(&options), " outputs="));

    let report = rig.report();
    let faults = report["faults"].as_array().unwrap();
    let what: Vec<&str> = faults
        .iter()
        .map(|it| it["what"].as_str().unwrap())
        .collect();
    assert_eq!(
        what.join(" "),
        "state.drop=0.2 rotor_speeds.delay=2 outer.state.freeze setpoint.lag=4 \
         state.position_w_m.z.noise=0.001 wrench.thrust_n.bias=0.01 \
         state.position_w_m.noise=off setpoint.lag=off"
    );
    assert!(faults.iter().all(|it| it["live"] == true));
    assert_eq!(
        (&faults[0]["tick"], &faults[0]["to_tick"]),
        (&first.into(), &(first + 100).into())
    );
    let full = rig.ok("report --full").says(", injected in flight\n");
    full.says(&format!("  fault state.drop=0.2 from tick {first} "));
    let page = rig.flown("report.html");
    let at_s = first as f64 * 1e-3;
    for words in [
        &*format!("fault from {at_s:.3} s: state.drop=0.2"),
        "fault until",
        "injected in flight",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let in_log = injected(&rig.out().join("latest/flight.mcap")).unwrap();
    let drop = format!("state.drop=0.2@tick{first}..tick{}", first + 100);
    assert_eq!((in_log.len(), &in_log[0]), (8, &drop));
    let swaps = report["swaps"].as_array().unwrap();
    assert_eq!((swaps.len(), &swaps[1]["parameter_epoch"]), (2, &2.into()));
    let change = serde_json::json!({"name": "mass_kg", "old": 0.6, "new": 0.5, "over_s": 0.0});
    assert_eq!(swaps[1]["changes"], Value::from(vec![change]));
    rig.assert_nothing_left();
}

#[test]
fn injected_faults_are_in_the_log_of_a_recorder_that_was_killed() {
    let rig = Rig::new("no-landing");
    let flight = rig.take_off(rig.slowly(2, "60s"));
    let tick = from_tick(&rig.ok("inject state.drop=0.2 --for 10ms").stdout);
    let log = rig
        .out()
        .join(&rig.run_directories()[0])
        .join("flight.mcap");
    let expected = format!("state.drop=0.2@tick{tick}..tick{}", tick + 10);
    wait_until("the log to have the fault", || {
        injected(&log).ok().filter(|faults| *faults == [&*expected])
    });
    send(rig.processes_of("record")[0], Signal::KILL);
    flight.interrupt();
    assert_eq!(injected(&log).unwrap(), [expected]);
}
