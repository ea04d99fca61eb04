//! Faults of messages and stages: their effects in a simulation, and that processes and replay fly the same bits.

use crate::fault_injection::after;
use crate::rig::{Rig, stop_for};
use config::Settings;
use flight_log::reader::LogReader;
use messages::content::Mode;
use sim::simulate::{SimulatedFlight, fly};
use sim::simulator::Simulator;
use std::time::Duration;

const TICKS: u64 = 3001;

fn settings(faults: &[&str]) -> Settings {
    let text = format!("[flight]\nduration_s = 3.0\nfaults = {faults:?}\n");
    Settings::of(text.parse().unwrap(), &Vec::new()).unwrap()
}

/// A flight with faults, and for each tick whether a setpoint, a wrench, a rotor command and a fresh wrench were published.
fn flown(settings: &Settings) -> (SimulatedFlight, Simulator, Vec<[bool; 4]>) {
    let mut rig = Simulator::of(settings)
        .unwrap()
        .with_monitor(settings.theorem().unwrap());
    let mut ticks = Vec::new();
    let simulated = fly(&mut rig, settings, |rig| {
        let wrench = rig.new_wrench();
        ticks.push([
            rig.setpoint().is_some(),
            wrench.is_some(),
            rig.new_rotor_speeds().is_some(),
            wrench.is_some_and(|wrench| wrench.mode == Mode::Fresh as u64),
        ]);
        Ok(())
    });
    (simulated.unwrap(), rig, ticks)
}

#[test]
fn faults_silence_stages_and_miss_deadlines_as_planned() {
    const OUTER: usize = 0;
    const INNER: usize = 1;
    const MIXER: usize = 2;
    const FRESH: usize = 3;
    let undisturbed = flown(&settings(&[])).0.outputs;
    for (fault, place, silent, missed, skipped) in [
        ("outer.state.drop=1@1s..tick1050", OUTER, 50, 0, 0),
        ("rotor_speeds.drop=1@1s..tick1010", MIXER, 0, 10, 0),
        // Each is late, and the last ones are overtaken.
        ("rotor_speeds.delay=3@1s..tick1010", MIXER, 0, 10, 0),
        ("outer.stop=15ms@1s", OUTER, 15, 0, 0),
        ("inner.stop=15ms@1s", INNER, 15, 0, 0),
        ("mixer.stop=15ms@1s", MIXER, 15, 15, 0),
        ("plant.stop=15ms,mass_kg=0.55@1s", OUTER, 0, 0, 15),
        // A stage may be a little late; and the last command of the mixer is not used.
        ("inner.late=300us@1s..2s", FRESH, 0, 0, 0),
        ("rotor_speeds.drop=1@tick3000", MIXER, 0, 0, 0),
        // A period more is a tick more: no setpoint is missed, but each is stale.
        ("outer.late=1ms@1s..tick1030", OUTER, 0, 0, 0),
        ("outer.late=1ms@1s..tick1030", FRESH, 30, 0, 0),
        // It works every third tick.
        ("mixer.late=2500us@1s..tick1030", MIXER, 20, 30, 0),
        ("inner.kill@1s", INNER, 100, 0, 0),
    ] {
        let (simulated, rig, ticks) = flown(&settings(&[fault]));
        assert_eq!(simulated.ticks, TICKS, "{fault}");
        assert_eq!(simulated.departure, None, "{fault}");
        let is_silent = |tick: &usize| !ticks[*tick][place];
        let expected = 1000..1000 + if place == FRESH { 31 } else { 30.max(silent) };
        let found: Vec<usize> = (0..ticks.len()).filter(is_silent).collect();
        assert_eq!(found.len(), silent, "{fault}: {found:?}");
        assert!(
            found.iter().all(|tick| expected.contains(tick)),
            "{found:?}"
        );
        let state = rig.state();
        let is_late = fault.starts_with("mixer.late") && state.deadlines_missed > missed;
        assert!(state.deadlines_missed == missed || is_late, "{fault}");
        assert_eq!(state.ticks_skipped, skipped, "{fault}");
        assert_eq!(rig.rejections().total(), 0, "{fault}");
        let swaps: Vec<u64> = simulated.swaps.iter().map(|swap| swap.tick).collect();
        assert!(!fault.contains("mass") || swaps == [1000], "{swaps:?}");
        if (silent, missed, skipped) == (0, 0, 0) && !fault.contains("outer") {
            assert_eq!(simulated.outputs, undisturbed, "{fault}");
        }
    }
}

#[test]
fn a_killed_stage_begins_with_its_initial_estimates_and_a_law_of_an_object_cannot_be_killed() {
    let (_, killed, _) = flown(&settings(&["inner.kill@1s"]));
    let (_, stopped, _) = flown(&settings(&["inner.stop=100ms@1s"]));
    assert_ne!(killed.wrench(), stopped.wrench());
    let checked = |rig: &Simulator| {
        let monitor = rig.monitor().unwrap();
        monitor.ticks_checked + monitor.ticks_stale
    };
    assert!(checked(&killed) <= TICKS - 1100 && checked(&stopped) > TICKS - 1100);
    let settings = settings(&["inner.kill@1s"]);
    let (outer, inner) = (
        settings.outer_stage().unwrap(),
        settings.inner_stage().unwrap(),
    );
    let refused = Simulator::with(&settings, outer, inner).err().unwrap();
    let why = "inner.kill: this law was passed as an object";
    assert!(refused.to_string().contains(why), "{refused}");
}

/// Faults of every kind at every input, that a flight of 1.5 s survives.
const EVERY_KIND: [&str; 10] = [
    "outer.state.drop=0.2@200ms..600ms",
    "state.position_w_m.noise=0.002@tick300..tick700",
    "inner.setpoint.delay=3@tick400..tick500",
    "inner.state.rate_b_rad_s.x.nan@tick600..tick603",
    "wrench.drop=1/4@tick700..tick800",
    "rotor_speeds.delay=2@tick800..tick840",
    "mixer.wrench.lag=2@tick900..tick950",
    "outer.state.freeze,setpoint.lag=4@tick1000..tick1020",
    "inner.state.drop=1@tick1100..tick1110",
    "rotor_speeds.speed_rad_s.2.bias=-5,outer.state.lag=5@tick1200",
];

#[test]
fn messages_with_faults_are_the_same_flight_in_processes_in_one_and_in_replay() {
    let rig = Rig::new("faulted");
    let faults = EVERY_KIND.map(|fault| format!(" --fault {fault}")).concat();
    let options = format!("--duration 1500ms{faults} --fault mass_kg=0.54@tick800");
    let [_, simulated] = rig.flies_as_simulated(&options, 1501);
    let replayed = rig.ok("replay --verify").says("identical");
    let outputs = after(&simulated.stdout, " outputs=");
    assert_eq!(after(&replayed.stdout, "; outputs "), outputs);

    let report = rig.final_report();
    assert_eq!(report.faults.len(), 10);
    let delay = &report.faults[2];
    assert_eq!((&*delay.what, delay.tick), ("inner.setpoint.delay=3", 400));
    assert_eq!(delay.to_tick, Some(500));
    rig.ok("report --full")
        .says("  fault inner.setpoint.delay=3 from tick 400 (0.400 s) to tick 500 (0.500 s)\n")
        .says("  fault rotor_speeds.speed_rad_s.2.bias=-5.0,outer.state.lag=5 from tick 1200 (1.200 s)\n");
    let page = rig.flown("report.html");
    assert!(page.contains("fault until 0.500 s: inner.setpoint.delay=3"));
    // The facts of a log precede its first message.
    let mut log = LogReader::open(&rig.out().join("latest/flight.mcap")).unwrap();
    log.next_entry().unwrap().unwrap();
    assert_eq!(
        log.fact("faults", "1").unwrap(),
        "outer.state.drop=0.2 from tick 200 (0.200 s) to tick 600 (0.600 s)"
    );
}

#[test]
fn a_simulation_with_the_timing_of_a_flight_is_that_flight_and_another_law_suffers_the_same() {
    let rig = Rig::new("timed");
    let flight = rig.take_off(rig.slowly(2, "2s"));
    rig.await_tick(0);
    for role in ["inner", "plant", "mixer"] {
        stop_for(flight.roles()[role], Duration::from_millis(50));
    }
    flight.end().expect(0);
    let replayed = rig.ok("replay --verify");
    let report = rig.final_report();
    let missed = report.deadlines.missed;
    assert!(missed > 20, "the stages were stopped: {missed}");
    // Less than the duration where the last ticks of all were skipped.
    let last = report.ticks.run + report.ticks.skipped - 1;
    let timing = format!("simulate --timing latest --out {}", rig.out().display());
    let simulated = rig.ok(&format!("{timing} --duration {last}ms"));
    let outputs = after(&simulated.stdout, " outputs=");
    assert_eq!(outputs, after(&replayed.stdout, "; outputs "));
    let number = |text: &str, word: &str| -> u64 {
        let line = text.lines().find(|it| it.contains(" skipped, ")).unwrap();
        let mut parts = line.split(", ");
        let part = parts.find(|part| part.contains(word)).unwrap();
        part.split(' ').next().unwrap().parse().unwrap()
    };
    // The last deadline is judged after the last tick.
    let missed_again = number(&simulated.stdout, "missed");
    assert!(missed - missed_again <= 1, "{missed_again} of {missed}");
    let other = rig.ok(&format!(
        "{timing} --duration {last}ms --inner indi --trajectory hover"
    ));
    assert_eq!(number(&other.stdout, "skipped"), report.ticks.skipped);
    assert_eq!(number(&other.stdout, "missed"), missed_again);

    let faster = rig.settings("[flight]\nperiod_s = 0.0005\n");
    let end = format!("the recorded flight ends at tick {last}, this one at tick 3000");
    for (flags, why) in [
        ("--duration 3s", &*end),
        (
            "--duration 1.5s --fault state.drop=0.1@1s",
            "cannot be combined with recorded timing",
        ),
        (
            &*format!("--config {faster} --duration 1s"),
            "has ticks of 1000000 ns, this one of 500000 ns",
        ),
    ] {
        rig.refused(&format!("{timing} {flags}")).complains(why);
    }
}

#[test]
fn the_list_of_faults_has_every_word_and_every_field() {
    let mut listed = Rig::new("listed").ok("faults");
    let words = "TOPIC.lag, ROLE.kill, cpu.hog, cpu.load, off , ironbird inject, \
                 outer.state inner.state, position_w_m, roll pitch yaw, rad^2/s^2";
    for word in words.split(", ") {
        listed = listed.says(word);
    }
}
