//! Faults of messages and stages: what they do in a simulation, and that processes and replay fly the same bits.

use crate::fault_injection::after;
use crate::rig::{Rig, stop_for};
use flight_log::reader::LogReader;
use ironbird::settings::Settings;
use ironbird::simulate::{SimulatedFlight, fly};
use ironbird::simulator::Simulator;
use messages::content::Mode;
use messages::inspection::Reason;
use std::fs;
use std::time::Duration;

const TICKS: u64 = 3001;

fn settings(faults: &[&str]) -> Settings {
    let faults: Vec<String> = faults.iter().map(|fault| format!("{fault:?}")).collect();
    let text = format!(
        "[flight]\nduration_s = 3.0\nfaults = [{}]\n",
        faults.join(", ")
    );
    Settings::of(text.parse().unwrap(), &Vec::new()).unwrap()
}

/// A flight with faults, and at each tick whether a set-point, a wrench and a rotor command were published.
fn flown(faults: &[&str]) -> (SimulatedFlight, Simulator, Vec<[bool; 4]>) {
    let settings = settings(faults);
    let mut rig = Simulator::of(&settings)
        .unwrap()
        .with_monitor(settings.theorem().unwrap());
    let mut ticks = Vec::new();
    let simulated = fly(&mut rig, &settings, |rig| {
        let is_fresh = rig
            .new_wrench()
            .is_some_and(|wrench| wrench.mode == Mode::Fresh as u64);
        ticks.push([
            rig.setpoint().is_some(),
            rig.new_wrench().is_some(),
            rig.new_rotor_speeds().is_some(),
            is_fresh,
        ]);
        Ok(())
    });
    (simulated.unwrap(), rig, ticks)
}

fn outputs(faults: &[&str]) -> String {
    flown(faults).0.outputs.to_string()
}

#[test]
fn the_same_faults_and_seed_are_the_same_flight_however_they_are_written() {
    let noisy = "state.drop=0.1,state.position_w_m.noise=0.002@1s..2s";
    assert_eq!(outputs(&[noisy]), outputs(&[noisy]));
    let apart = [
        "outer.state.drop=0.1,inner.state.drop=0.1@tick1000..tick2000",
        "outer.state.position_w_m.noise=0.002,inner.state.position_w_m.noise=0.002@1s..tick2000",
    ];
    assert_eq!(outputs(&[noisy]), outputs(&apart));
    assert_ne!(outputs(&[noisy]), outputs(&[]));
    let ended = [
        "state.drop=0.1,state.position_w_m.noise=0.002@1s",
        "state.drop=off,state.position_w_m.noise=off@2s",
    ];
    assert_eq!(outputs(&[noisy]), outputs(&ended));
    assert_eq!(
        outputs(&["inner.late=2ms@1s..2500ms", "inner.late=off@2s"]),
        outputs(&["inner.late=2ms@1s..2s"])
    );
    assert_ne!(
        outputs(&["inner.setpoint.lag=1@1s"]),
        outputs(&["inner.setpoint.lag=2@1s"])
    );
    let seeded = |seed| {
        let mut settings = settings(&[noisy]);
        settings.flight.seed = seed;
        let mut rig = Simulator::of(&settings).unwrap();
        fly(&mut rig, &settings, |_| Ok(()))
            .unwrap()
            .outputs
            .to_string()
    };
    assert_ne!(seeded(1), seeded(2));
}

#[test]
fn a_fault_that_strikes_no_tick_changes_no_bit() {
    // After the last tick but one there is no message of the mixer that would be used.
    assert_eq!(outputs(&["rotor_speeds.drop=1@tick3000"]), outputs(&[]));
    assert_eq!(
        outputs(&["inner.late=300us@1s..2s"]),
        outputs(&[]),
        "logical execution time forgives what is early enough"
    );
}

#[test]
fn lost_messages_are_what_the_guards_are_for() {
    let (_, rig, ticks) = flown(&["outer.state.drop=1@1s..tick1050"]);
    let silent = ticks.iter().filter(|[setpoint, ..]| !setpoint).count();
    assert_eq!(
        silent, 50,
        "the outer loop says nothing of a state that it does not have"
    );
    assert_eq!(rig.rejections().total(), 0);
    let (_, rig, _) = flown(&["rotor_speeds.drop=1@1s..tick1010"]);
    assert_eq!(rig.state().deadlines_missed, 10);
    let (_, rig, _) = flown(&["rotor_speeds.delay=3@1s..tick1010"]);
    assert_eq!(
        rig.state().deadlines_missed,
        10,
        "each is late, and the last ones are overtaken"
    );
}

#[test]
fn what_is_no_number_is_refused_and_counted_and_the_vehicle_flies_on() {
    let (simulated, rig, _) = flown(&[
        "state.rate_b_rad_s.y.nan@1s..tick1020",
        "wrench.torque_b_nm.nan@tick1500..tick1502",
        "rotor_speeds.speed_rad_s.3.bias=-1e9@2s..tick2001",
    ]);
    assert_eq!(simulated.departure, None);
    assert_eq!(rig.rejections().of(Reason::NonFinite), 20 + 20 + 2);
    assert_eq!(rig.rejections().of(Reason::Implausible), 1);
    assert!(
        rig.state()
            .truth
            .position_w_m
            .iter()
            .all(|number| number.is_finite())
    );
}

#[test]
fn a_stage_that_stops_is_silent_for_so_many_ticks() {
    for (place, role) in [(0, "outer"), (1, "inner"), (2, "mixer")] {
        let (simulated, rig, ticks) = flown(&[&format!("{role}.stop=15ms@1s")]);
        let silent: Vec<usize> = (0..ticks.len())
            .filter(|tick| !ticks[*tick][place])
            .collect();
        assert_eq!(silent, (1000..1015).collect::<Vec<_>>(), "{role}");
        assert_eq!(
            (simulated.ticks, simulated.departure),
            (TICKS, None),
            "{role}"
        );
        let missed = if role == "mixer" { 15 } else { 0 };
        assert_eq!(
            rig.state().deadlines_missed,
            missed,
            "{role}: the others answer for it"
        );
    }
}

#[test]
fn a_plant_that_stops_flies_the_ticks_that_it_missed_with_the_commands_in_force() {
    let (simulated, rig, _) = flown(&["plant.stop=15ms@1s"]);
    assert_eq!((simulated.ticks, simulated.departure), (TICKS, None));
    assert_eq!(rig.state().ticks_skipped, 15);
    let stopped = flown(&["plant.stop=15ms,mass_kg=0.55@1s"]);
    assert_eq!(
        stopped
            .0
            .swaps
            .iter()
            .map(|swap| swap.tick)
            .collect::<Vec<_>>(),
        [1000],
        "a swap keeps its tick"
    );
}

#[test]
fn a_stage_that_is_killed_begins_again_with_its_priors() {
    let (_, rig, ticks) = flown(&["inner.kill@1s"]);
    let silent: Vec<usize> = (0..ticks.len()).filter(|tick| !ticks[*tick][1]).collect();
    assert_eq!(silent, (1000..1100).collect::<Vec<_>>());
    let (_, stopped, _) = flown(&["inner.stop=100ms@1s"]);
    assert_ne!(
        rig.wrench(),
        stopped.wrench(),
        "one that goes on knows what it has learnt"
    );
    let checked =
        |rig: &Simulator| rig.monitor().unwrap().ticks_checked + rig.monitor().unwrap().ticks_stale;
    assert!(checked(&rig) <= TICKS - 1100, "{}", checked(&rig));
    assert!(checked(&stopped) > TICKS - 1100, "{}", checked(&stopped));
}

#[test]
fn a_late_stage_misses_ticks_and_what_it_says_is_stale() {
    let (_, rig, ticks) = flown(&["mixer.late=2500us@1s..tick1030"]);
    let silent = ticks[1000..1030].iter().filter(|tick| !tick[2]).count();
    assert_eq!(silent, 20, "it works every third tick");
    assert!(
        rig.state().deadlines_missed >= 30,
        "{}",
        rig.state().deadlines_missed
    );
    let (_, rig, ticks) = flown(&["outer.late=1ms@1s..tick1030"]);
    assert!(
        ticks.iter().all(|tick| tick[0]),
        "a period more is a tick more, and none is missed"
    );
    assert_eq!(
        ticks.iter().filter(|tick| !tick[3]).count(),
        30,
        "but every set-point is stale"
    );
    assert_eq!(rig.state().deadlines_missed, 0);
}

#[test]
fn a_law_that_was_handed_over_cannot_be_killed() {
    let settings = settings(&["inner.kill@1s"]);
    let (outer, inner) = (
        settings.outer_stage().unwrap(),
        settings.inner_stage().unwrap(),
    );
    let Err(refused) = Simulator::with(&settings, outer, inner) else {
        panic!("it was taken")
    };
    assert!(
        refused
            .to_string()
            .contains("inner.kill: this law was passed as an object"),
        "{refused}"
    );
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
    let [_, ended] = rig.flies_as_simulated(&options, 1501);
    let replayed = rig.ok("replay --verify").says("identical");
    assert_eq!(
        after(&replayed.stdout, "; outputs "),
        after(&ended.stdout, " outputs="),
        "of all outputs"
    );

    let report = rig.report();
    assert_eq!(report["faults"].as_array().unwrap().len(), 10);
    assert_eq!(report["faults"][2]["what"], "inner.setpoint.delay=3");
    assert_eq!(
        (
            &report["faults"][2]["tick"],
            &report["faults"][2]["to_tick"]
        ),
        (&400.into(), &500.into())
    );
    rig.ok("report --full")
        .says("  fault inner.setpoint.delay=3 from tick 400 (0.400 s) to tick 500 (0.500 s)\n")
        .says("  fault rotor_speeds.speed_rad_s.2.bias=-5.0,outer.state.lag=5 from tick 1200 (1.200 s)\n");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(
        page.contains("fault until 0.500 s: inner.setpoint.delay=3"),
        "the page's plots"
    );
    let mut log = LogReader::open(&rig.out().join("latest/flight.mcap")).unwrap();
    assert!(
        log.next_entry().unwrap().is_some(),
        "what it says of its flight stands before its first message"
    );
    assert_eq!(
        log.fact("faults", "1").unwrap(),
        "outer.state.drop=0.2 from tick 200 (0.200 s) to tick 600 (0.600 s)"
    );
}

#[test]
fn a_simulation_with_the_timing_of_a_flight_is_that_flight_and_another_law_suffers_the_same() {
    let rig = Rig::new("timed");
    let flight = rig.take_off(format!("--rt off --config {} --duration 2s", rig.slow(2)));
    rig.await_tick(0);
    for role in ["inner", "plant", "mixer"] {
        stop_for(flight.roles()[role], Duration::from_millis(50));
    }
    flight.end().expect(0);
    let replayed = rig.ok("replay --verify");
    let out = rig.out();
    let report = rig.report();
    let number = |section: &str, key: &str| report[section][key].as_u64().unwrap();
    let (run, skipped) = (number("ticks", "run"), number("ticks", "skipped"));
    let missed = number("deadlines", "missed");
    // Less than what was asked for where the last ticks of all were skipped.
    let last = run + skipped - 1;
    let timing = format!("simulate --timing latest --out {}", out.display());
    let simulated = rig.ok(&format!("{timing} --duration {last}ms"));
    assert_eq!(
        after(&simulated.stdout, " outputs="),
        after(&replayed.stdout, "; outputs "),
        "{}",
        simulated.stdout
    );
    assert!(missed > 20, "the stages were stopped: {missed}");
    let said = |text: &str, word: &str| {
        let line = text
            .lines()
            .find(|line| line.contains(" skipped, "))
            .unwrap();
        line.split(", ")
            .find(|part| part.contains(word))
            .unwrap()
            .split(' ')
            .next()
            .unwrap()
            .parse::<u64>()
            .unwrap()
    };
    // The last deadline is judged after the last tick.
    assert!(
        missed - said(&simulated.stdout, "missed") <= 1,
        "{}",
        simulated.stdout
    );
    let other = rig.ok(&format!(
        "{timing} --duration {last}ms --inner indi --trajectory hover"
    ));
    assert_eq!(said(&other.stdout, "skipped"), skipped, "{}", other.stdout);
    assert_eq!(
        said(&other.stdout, "missed"),
        said(&simulated.stdout, "missed"),
        "{}",
        other.stdout
    );

    rig.refused(&format!("{timing} --duration 3s"))
        .complains(&format!(
            "the recorded flight ends at tick {last}, this one at tick 3000"
        ));
    rig.refused(&format!(
        "{timing} --duration 1.5s --fault state.drop=0.1@1s"
    ))
    .complains("cannot be combined with recorded timing");
    let faster = rig.settings("[flight]\nperiod_s = 0.0005\n");
    rig.refused(&format!("{timing} --config {faster} --duration 1s"))
        .complains("has ticks of 1000000 ns, this one of 500000 ns");
}

#[test]
fn the_list_of_faults_has_every_word_and_every_field() {
    let rig = Rig::new("listed");
    let listed = rig.ok("faults").stdout;
    for word in [
        "TOPIC.lag",
        "ROLE.kill",
        "cpu.hog",
        "cpu.load",
        "off ",
        "ironbird inject",
        "outer.state inner.state",
        "position_w_m",
        "roll pitch yaw",
        "rad^2/s^2",
    ] {
        assert!(listed.contains(word), "{word}: {listed}");
    }
}
