//! Faults that are injected into flights in the air: the same bits as planned ones, in the report, in the replay.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;

use crate::rig::{Rig, send, wait_until};
use flight_log::injected::injected;
use model::fault::MOST;
use rustix::process::Signal;
use serde_json::Value;

/// What stands behind a word, to the next blank.
fn after<'a>(text: &'a str, word: &str) -> &'a str {
    let from = text.find(word).unwrap_or_else(|| panic!("no `{word}` in {text}")) + word.len();
    text[from..].split_whitespace().next().unwrap()
}

/// The tick from which an injection strikes, by what it prints.
fn from_tick(said: &str) -> u64 {
    after(said, if said.contains(" from tick ") { " from tick " } else { " at tick " }).parse().unwrap()
}

/// Three minutes in lockstep: some seconds on the clock.
const LOCKSTEP: [&str; 6] = ["--pace", "lockstep", "--duration", "180s", "--trajectory", "hover"];

/// Flies, injects, and says what was injected as it is planned; nothing where the flight landed before that was done, or
/// a busy disk could not take so many ticks.
fn flown_with_injections(rig: &Rig) -> Option<Vec<String>> {
    let flight = rig.take_off(&LOCKSTEP);
    let mut planned = Vec::new();
    // One after the other, each when it comes: which ticks these are is not known before.
    for (fault, lasts) in [
        ("state.drop=0.2,rotor_speeds.delay=2,outer.state.freeze", Some("100ms")),
        ("inner.setpoint.lag=4,state.position_w_m.z.noise=0.001,wrench.thrust_n.bias=0.01", None),
        ("state.position_w_m.noise=off,setpoint.lag=off", None),
    ] {
        let flags = lasts.map_or(vec![], |time| vec!["--for", time]);
        let said = rig.run("inject", &[&[fault][..], &flags].concat());
        if said.stderr.contains("or has landed") {
            flight.end().expect(0);
            return None;
        }
        let tick = from_tick(&said.expect(0).stdout);
        let to = lasts.map(|time| tick + time.trim_end_matches("ms").parse::<u64>().unwrap());
        planned.push(to.map_or(format!("{fault}@tick{tick}"), |to| format!("{fault}@tick{tick}..tick{to}")));
    }
    let ended = flight.end().expect(0);
    let is_whole = ended.result()["unlogged"] == "0";
    is_whole.then_some(planned)
}

#[test]
fn what_is_injected_in_flight_is_the_flight_that_was_planned_so_and_it_is_replayed() {
    // A machine that is busy may have a flight in lockstep land before three commands have started, or outrun its disk.
    let flown = (0..4).find_map(|_| {
        let rig = Rig::new("same");
        flown_with_injections(&rig).map(|planned| (rig, planned))
    });
    let (rig, planned) = flown.expect("a flight that outlasts three injections");
    let replayed = rig.run("replay", &["--verify"]).expect(0).says("identical");
    let again = planned.iter().flat_map(|fault| ["--fault", fault.as_str()]).collect::<Vec<_>>();
    let simulated = rig.run("simulate", &[&LOCKSTEP[2..], &again].concat()).expect(0);
    let outputs = after(&replayed.stdout, "; outputs ");
    assert_eq!(outputs, after(&simulated.stdout, " outputs="), "{planned:?}");
    let untouched = rig.run("simulate", &LOCKSTEP[2..]).expect(0);
    assert_ne!(outputs, after(&untouched.stdout, " outputs="));

    let report = rig.report();
    let told: Vec<&Value> = report["faults"].as_array().unwrap().iter().collect();
    let what: Vec<&str> = told.iter().map(|fault| fault["what"].as_str().unwrap()).collect();
    assert_eq!(
        what,
        [
            "state.drop=0.2",
            "rotor_speeds.delay=2",
            "outer.state.freeze",
            "setpoint.lag=4",
            "state.position_w_m.z.noise=0.001",
            "wrench.thrust_n.bias=0.01",
            "state.position_w_m.noise=off",
            "setpoint.lag=off"
        ]
    );
    assert!(told.iter().all(|fault| fault["live"] == true), "{told:?}");
    let tick = told[0]["tick"].as_u64().unwrap();
    assert_eq!(told[0]["to_tick"], tick + 100);
    let line = format!("state.drop=0.2 from tick {tick} ");
    rig.run("report", &["--full"]).expect(0).says(&format!("  fault {line}")).says(", injected in flight\n");
    let directory = rig.out().join("latest");
    let page = fs::read_to_string(directory.join("report.html")).unwrap();
    let at_s = tick as f64 * 1e-3;
    assert!(page.contains(&format!("fault from {at_s:.3} s: state.drop=0.2")), "its plots");
    assert!(page.contains("fault until") && page.contains("injected in flight"), "its table");
    let in_log = injected(&directory.join("flight.mcap")).unwrap();
    assert_eq!(in_log.len(), 8);
    assert_eq!(in_log[0], format!("state.drop=0.2@tick{tick}..tick{}", tick + 100));
    rig.assert_nothing_left();
}

#[test]
fn an_instant_is_kept_where_it_is_far_enough_and_else_the_answer_says_so() {
    let rig = Rig::new("instant");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(2), "--duration", "20s"]);
    let said = rig.run("inject", &["setpoint.drop=1/2", "--at-tick", "15000", "--for", "1s"]).expect(0);
    assert_eq!(
        said.stdout,
        "setpoint.drop=1/2 from tick 15000 (15.000 s) to tick 16000 (16.000 s), injected in flight\n"
    );
    let said = rig.run("inject", &["state.freeze", "--at-tick", "1"]).expect(0).stdout;
    assert!(from_tick(&said) > 1 && said.contains("tick 1 was past, or too near"), "{said}");
    let later = rig.run("inject", &["wrench.drop=0.5", "--in", "5s", "--for", "10ms"]).expect(0).stdout;
    assert!(from_tick(&later) > from_tick(&said) + 4000, "{later}");
    rig.run("inject", &["cpu.load=0.1", "--at-tick", "19000", "--for", "100ms"]).expect(0);
    for (args, code, why) in [
        (
            &["cpu.load=0.2", "--at-tick", "19050"][..],
            1,
            "the plant refused: cpu.load is given for these ticks already",
        ),
        (&["mixer.stop=900us"], 1, "the plant refused: mixer.stop = `900us`: write a time of at least one tick"),
        (&["state.freeze"], 1, "the plant refused: `freeze` is given twice for the same ticks at outer.state"),
        (&["rotor_speeds.drop=off"], 1, "the plant refused: rotor_speeds.drop=off: it does not strike then or later"),
        (&["rotor_speeds.lag=off"], 1, "rotor_speeds.lag=off: it does not strike then or later"),
        (&["inner.late=off"], 1, "inner.late=off: it does not strike then or later"),
        (&["inner.kill=off"], 2, "inner.kill happens once: there is nothing to end"),
        (&["state.drop=0.1", "mass_kg=0.6"], 2, "parameters and faults of the loop are not injected by one command"),
        (&["mass_kg=0.6", "--for", "1s"], 2, "--for: a parameter holds until it is changed again"),
        (&["inner.stop=20ms", "--for", "1s"], 2, "--for: inner.stop=20ms happens once, at an instant"),
        (&["state.freeze=off", "--for", "1s"], 2, "--for: state.freeze=off happens once"),
        (&["state.drop=0.1", "--for", "100us"], 2, "--for: it is less than a tick, which is 1 ms here"),
        (&["state.dorp=0.1"], 2, "unknown fault `state.dorp`; did you mean `state.drop`?"),
        (&["state.drop=0.1", "--at-tick", "20001"], 2, "tick 20001 never comes: the flight ends at tick 20000"),
        (&["state.drop=0.1@8s"], 2, "state.drop = `0.1@8s`: write a share above 0"),
        (&["cpu.hog=0"], 2, "cpu.hog = `0`: write a SCHED_FIFO priority from 1 to 99, as in cpu.hog=90"),
        (&["cpu.load=1.5"], 2, "cpu.load = `1.5`: write a share above 0 and up to 1, as in cpu.load=0.5"),
    ] {
        let refused = rig.run("inject", args).expect(code);
        assert!(refused.stderr.contains(why), "{args:?}: {}", refused.stderr);
    }
    let many: Vec<String> = ["x", "y", "z"]
        .iter()
        .flat_map(|axis| {
            ["position_w_m", "velocity_w_m_s", "rate_b_rad_s"].map(|field| format!("state.{field}.{axis}.bias=1e-9"))
        })
        .collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    let refused = rig.run("inject", &many).expect(2);
    assert!(refused.stderr.contains("18 faults at once, counted by input: allowed are 16"), "{}", refused.stderr);
    rig.run("inject", &[&many[..8], &["--at-tick", "19000", "--for", "1ms"]].concat()).expect(0);
    let full = rig.run("inject", &[&many[..8], &["--at-tick", "19100", "--for", "1ms"]].concat()).expect(1);
    assert!(full.stderr.contains("the plant refused: it has no room for more"), "{}", full.stderr);
    assert!(full.stderr.contains(&format!("of which {MOST} of messages")), "{}", full.stderr);
    flight.signal(Signal::INT);
    flight.end();
    rig.assert_nothing_left();
}

#[test]
fn a_late_stage_and_one_that_is_restarted_are_replayed_with_the_faults_that_were_injected() {
    let rig = Rig::new("late-stage");
    let config = rig
        .settings("[flight]\nslowdown = 4\nground_z_m = -1000.0\nposition_error_max_m = 1000.0\ntilt_max_rad = 3.14\n");
    let options = ["--rt", "off", "--config", &config, "--duration", "3s", "--trajectory", "hover"];
    // Every second tick alone is worked.
    let late = ["--fault", "inner.late=1800us@200ms..2500ms", "--on-death", "restart"];
    let flight = rig.take_off(&[&options[..], &late].concat());
    rig.run("inject", &["inner.state.lag=3,inner.setpoint.delay=2,inner.setpoint.freeze", "--for", "1s"]).expect(0);
    rig.run("inject", &["inner.state.position_w_m.z.bias=0.01,wrench.thrust_n.bias=0.01"]).expect(0);
    rig.run("inject", &["mixer.kill", "--at-tick", "2700"]).expect(0);
    let refused = rig.run("inject", &["mixer.stop=20ms", "--at-tick", "2750"]).expect(1);
    assert!(refused.stderr.contains("the plant refused: mixer.stop is given for these ticks already"), "{refused}");
    let refused = rig.run("inject", &["cpu.load=off"]).expect(1);
    assert!(refused.stderr.contains("cpu.load=off: it does not strike then or later"), "{refused}");
    rig.run("inject", &["state.drop=0.1", "--at-tick", "3000", "--for", "1ms"]).expect(0);
    flight.end().expect(0);
    let skipped = rig.report()["roles"]["inner"]["ticks_skipped"].as_u64().unwrap();
    assert!(skipped > 500, "{skipped}");
    rig.run("replay", &["--verify"]).expect(0).says("identical");
}

#[test]
fn what_was_injected_is_in_the_log_of_a_recorder_that_was_killed() {
    let rig = Rig::new("no-landing");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(2), "--duration", "60s"]);
    let said = rig.run("inject", &["state.drop=0.2", "--for", "10ms"]).expect(0).stdout;
    let tick = from_tick(&said);
    let directory = fs::read_dir(rig.out()).unwrap().map(|it| it.unwrap().path()).find(|it| it.is_dir()).unwrap();
    let log = directory.join("flight.mcap");
    let told = wait_until("the log to have the fault", || injected(&log).ok().filter(|faults| !faults.is_empty()));
    assert_eq!(told, [format!("state.drop=0.2@tick{tick}..tick{}", tick + 10)]);
    send(rig.processes_of("record")[0], Signal::KILL);
    flight.signal(Signal::INT);
    flight.end();
    assert_eq!(injected(&log).unwrap(), told);
}

#[test]
fn nothing_is_taken_that_would_strike_behind_the_flight() {
    let rig = Rig::new("behind");
    let flight = rig.take_off(&["--rt", "off", "--config", &rig.slow(100), "--duration", "60ms"]);
    let refused = rig.run("inject", &["state.drop=0.1"]).expect(1);
    assert!(refused.stderr.contains("state.drop never strikes: the flight ends before"), "{refused}");
    flight.end();
}

#[test]
fn what_means_nothing_in_lockstep_is_refused_by_name_and_so_is_a_flight_that_is_none() {
    let rig = Rig::new("meaningless");
    let nobody = rig.run("inject", &["state.drop=0.1"]).expect(1);
    assert!(nobody.stderr.contains("no flight is running as instance"), "{}", nobody.stderr);
    let refusals = [
        ("inner.stop=20ms", "in lockstep ticks wait for a stage that is not ready"),
        ("inner.kill", "in lockstep ticks wait for a stage that is not ready"),
        ("inner.late=1ms", "in lockstep ticks wait for a stage that is not ready"),
        ("cpu.hog=90", "in lockstep no tick is late, however busy the processor is"),
        ("cpu.load=0.5", "in lockstep no tick is late, however busy the processor is"),
    ];
    for (fault, why) in refusals {
        let planned = format!("{fault}@1s");
        let refused = rig.run("fly", &[&LOCKSTEP[..], &["--fault", &planned]].concat()).expect(2);
        assert!(refused.stderr.contains(&format!("{fault}: {why}")), "{}", refused.stderr);
    }
    rig.assert_nothing_started();
    let flight = rig.take_off(&["--pace", "lockstep", "--duration", "1h", "--trajectory", "hover"]);
    for (fault, why) in refusals {
        let refused = rig.run("inject", &[fault]).expect(2);
        assert!(refused.stderr.contains(&format!("{fault}: {why}")), "{}", refused.stderr);
    }
    flight.signal(Signal::INT);
    flight.end();
}

#[test]
fn who_was_started_by_hand_has_nobody_who_stops_or_kills_it() {
    let rig = Rig::new("by-hand");
    for fault in ["inner.stop=20ms@1s", "inner.kill@1s", "cpu.load=0.5@1s"] {
        let refused = rig.run("inner", &["--fault", fault]).expect(2);
        let why = ": it is done by a launcher, and here there is none";
        assert!(refused.stderr.contains(why), "{fault}: {}", refused.stderr);
    }
}
