//! Faults that are injected into a running flight, or planned: into messages, stages, processes and the processor.

use crate::restarts::{in_the_air, report};
use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{Rig, is_gone, not_tested, send, table, wait_until};
use flight_log::fault_record::injected;
use messages::fault::MOST;
use process::rt::fifo_refusal;
use report::schema::Report;
use rustix::process::Signal;
use serde_json::Value;
use std::fs;

/// What stands behind a word, to the next blank.
pub(crate) fn after<'a>(text: &'a str, word: &str) -> &'a str {
    let from = text
        .find(word)
        .unwrap_or_else(|| panic!("no `{word}` in {text}"))
        + word.len();
    text[from..].split_whitespace().next().unwrap()
}

/// The tick from which an injection strikes, by what it prints.
fn from_tick(said: &str) -> u64 {
    after(
        said,
        if said.contains(" from tick ") {
            " from tick "
        } else {
            " at tick "
        },
    )
    .parse()
    .unwrap()
}

/// Three minutes in lockstep: some seconds on the clock.
const LOCKSTEP: &str = "--duration 180s --trajectory hover";

/// Flies, injects, and says what was injected as it is planned; nothing where the flight landed before that was done, or
/// a busy disk could not take so many ticks.
fn flown_with_injections(rig: &Rig) -> Option<Vec<String>> {
    let flight = rig.take_off(format!("--pace lockstep {LOCKSTEP}"));
    let mut planned = Vec::new();
    // One after the other, each when it comes: which ticks these are is not known before.
    for (fault, lasts) in [
        (
            "state.drop=0.2,rotor_speeds.delay=2,outer.state.freeze",
            Some("100ms"),
        ),
        (
            "inner.setpoint.lag=4,state.position_w_m.z.noise=0.001,wrench.thrust_n.bias=0.01",
            None,
        ),
        ("state.position_w_m.noise=off,setpoint.lag=off", None),
    ] {
        let flags = lasts.map_or(vec![], |time| vec!["--for", time]);
        let said = rig.run("inject", [&[fault][..], &flags].concat());
        if said.stderr.contains("or has landed") {
            flight.end().expect(0);
            return None;
        }
        let tick = from_tick(&said.expect(0).stdout);
        let to = lasts.map(|time| tick + time.trim_end_matches("ms").parse::<u64>().unwrap());
        planned.push(to.map_or(format!("{fault}@tick{tick}"), |to| {
            format!("{fault}@tick{tick}..tick{to}")
        }));
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
    let replayed = rig.ok("replay --verify").says("identical");
    let again = planned.iter().map(|fault| format!(" --fault {fault}"));
    let again = format!("{LOCKSTEP}{}", again.collect::<String>());
    let simulated = rig.run("simulate", again).expect(0);
    let outputs = after(&replayed.stdout, "; outputs ");
    assert_eq!(
        outputs,
        after(&simulated.stdout, " outputs="),
        "{planned:?}"
    );
    let untouched = rig.run("simulate", LOCKSTEP).expect(0);
    assert_ne!(outputs, after(&untouched.stdout, " outputs="));

    let report = rig.report();
    let told: Vec<&Value> = report["faults"].as_array().unwrap().iter().collect();
    let what: Vec<&str> = told
        .iter()
        .map(|fault| fault["what"].as_str().unwrap())
        .collect();
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
    rig.ok("report --full")
        .says(&format!("  fault {line}"))
        .says(", injected in flight\n");
    let directory = rig.out().join("latest");
    let page = fs::read_to_string(directory.join("report.html")).unwrap();
    let at_s = tick as f64 * 1e-3;
    assert!(
        page.contains(&format!("fault from {at_s:.3} s: state.drop=0.2")),
        "its plots"
    );
    assert!(
        page.contains("fault until") && page.contains("injected in flight"),
        "its table"
    );
    let in_log = injected(&directory.join("flight.mcap")).unwrap();
    assert_eq!(in_log.len(), 8);
    assert_eq!(
        in_log[0],
        format!("state.drop=0.2@tick{tick}..tick{}", tick + 100)
    );
    rig.assert_nothing_left();
}

#[test]
fn an_instant_is_kept_where_it_is_far_enough_and_else_the_answer_says_so() {
    let rig = Rig::new("instant");
    let flight = rig.take_off(format!("--rt off --config {} --duration 20s", rig.slow(2)));
    let said = rig.ok("inject setpoint.drop=1/2 --at-tick 15000 --for 1s");
    assert_eq!(
        said.stdout,
        "setpoint.drop=1/2 from tick 15000 (15.000 s) to tick 16000 (16.000 s), injected in flight\n"
    );
    let said = rig.ok("inject state.freeze --at-tick 1").stdout;
    assert!(
        from_tick(&said) > 1 && said.contains("tick 1 was past, or too near"),
        "{said}"
    );
    let later = rig.ok("inject wrench.drop=0.5 --in 5s --for 10ms").stdout;
    assert!(from_tick(&later) > from_tick(&said) + 4000, "{later}");
    rig.ok("inject cpu.load=0.1 --at-tick 19000 --for 100ms");
    for [args, code, why] in table(include_str!("injection_refusals.md")) {
        let refused = rig.run("inject", args).expect(code.parse().unwrap());
        assert!(refused.stderr.contains(why), "{args:?}: {}", refused.stderr);
    }
    let biases = ["x", "y", "z"].map(|axis| {
        ["position_w_m", "velocity_w_m_s", "rate_b_rad_s"]
            .map(|field| format!("state.{field}.{axis}.bias=1e-9"))
    });
    let many = biases.concat();
    rig.run("inject", &many)
        .expect(2)
        .complains("18 faults at once, counted by input: allowed are 16");
    let many = many[..8].join(" ");
    rig.ok(&format!("inject {many} --at-tick 19000 --for 1ms"));
    rig.run("inject", format!("{many} --at-tick 19100 --for 1ms"))
        .expect(1)
        .complains("the plant refused: it has no room for more")
        .complains(&format!("of which {MOST} of messages"));
    flight.signal(Signal::INT);
    flight.end();
    rig.assert_nothing_left();
}

#[test]
fn a_late_stage_and_one_that_is_restarted_are_replayed_with_the_faults_that_were_injected() {
    let rig = Rig::new("late-stage");
    let config = in_the_air(&rig, 4);
    // Every second tick alone is worked.
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 3s --trajectory hover --on-death restart \
         --fault inner.late=1800us@200ms..2500ms"
    ));
    rig.ok("inject inner.state.lag=3,inner.setpoint.delay=2,inner.setpoint.freeze --for 1s");
    rig.ok("inject inner.state.position_w_m.z.bias=0.01,wrench.thrust_n.bias=0.01");
    rig.ok("inject mixer.kill --at-tick 2700");
    let refused = rig
        .run("inject", "mixer.stop=20ms --at-tick 2750")
        .expect(1);
    refused.complains("the plant refused: mixer.stop is given for these ticks already");
    let refused = rig.run("inject", "cpu.load=off").expect(1);
    refused.complains("cpu.load=off: it does not strike then or later");
    rig.ok("inject state.drop=0.1 --at-tick 3000 --for 1ms");
    flight.end().expect(0);
    let skipped = rig.report()["roles"]["inner"]["ticks_skipped"]
        .as_u64()
        .unwrap();
    assert!(skipped > 500, "{skipped}");
    let report = report(&rig);
    let [death] = &report.deaths[..] else {
        panic!("{:?}", report.deaths)
    };
    assert_eq!(death.how, "killed by the fault mixer.kill of tick 2700");
    assert!(death.back_after_ms.is_some(), "{death:?}");
    let kill = ("mixer.kill".to_owned(), 2700, None, true);
    assert!(reported(&report).contains(&kill), "{:?}", report.faults);
    rig.ok("replay --verify").says("identical");
}

#[test]
fn what_was_injected_is_in_the_log_of_a_recorder_that_was_killed() {
    let rig = Rig::new("no-landing");
    let flight = rig.take_off(format!("--rt off --config {} --duration 60s", rig.slow(2)));
    let said = rig.ok("inject state.drop=0.2 --for 10ms").stdout;
    let tick = from_tick(&said);
    let directory = fs::read_dir(rig.out())
        .unwrap()
        .map(|it| it.unwrap().path())
        .find(|it| it.is_dir())
        .unwrap();
    let log = directory.join("flight.mcap");
    let told = wait_until("the log to have the fault", || {
        injected(&log).ok().filter(|faults| !faults.is_empty())
    });
    assert_eq!(
        told,
        [format!("state.drop=0.2@tick{tick}..tick{}", tick + 10)]
    );
    send(rig.processes_of("record")[0], Signal::KILL);
    flight.signal(Signal::INT);
    flight.end();
    assert_eq!(injected(&log).unwrap(), told);
}

#[test]
fn nothing_is_taken_that_would_strike_behind_the_flight() {
    let rig = Rig::new("behind");
    let flight = rig.take_off(format!(
        "--rt off --config {} --duration 60ms",
        rig.slow(100)
    ));
    let refused = rig.run("inject", "state.drop=0.1").expect(1);
    refused.complains("state.drop never strikes: the flight ends before");
    flight.end();
}

#[test]
fn a_flight_in_lockstep_refuses_faults_of_time() {
    let rig = Rig::new("meaningless");
    let waits = "in lockstep ticks wait for a stage that is not ready";
    let never_late = "in lockstep no tick is late, however busy the processor is";
    let flight = rig.take_off("--pace lockstep --duration 1h --trajectory hover");
    for (faults, why) in [
        ("inner.stop=20ms inner.kill inner.late=1ms", waits),
        ("cpu.hog=90 cpu.load=0.5", never_late),
    ] {
        for fault in faults.split(' ') {
            rig.refused(&format!("inject {fault}"))
                .complains(&format!("{fault}: {why}"));
        }
    }
    flight.signal(Signal::INT);
    flight.end();
}

fn reported(report: &Report) -> Vec<(String, u64, Option<u64>, bool)> {
    report
        .faults
        .iter()
        .map(|it| (it.what.clone(), it.tick, it.to_tick, it.live))
        .collect()
}

#[test]
fn a_stage_that_is_stopped_by_plan_is_out_for_so_many_ticks_and_goes_on() {
    let rig = Rig::new("stop");
    let config = in_the_air(&rig, 2);
    let flight = format!("--rt off --config {config} --duration 1500ms --trajectory hover");
    rig.ok(&format!(
        "fly {flight} --fault mixer.stop=60ms@500ms --fault inner.stop=40ms@1s"
    ));
    let report = report(&rig);
    let once = |what: &str, tick| (what.to_owned(), tick, None, false);
    assert_eq!(
        reported(&report),
        [once("mixer.stop=60ms", 500), once("inner.stop=40ms", 1000)]
    );
    for (role, least) in [("mixer", 55), ("inner", 35)] {
        let skipped = report.roles[role].ticks_skipped;
        assert!(skipped >= least, "{role}: {skipped} ticks skipped");
    }
    let longest = report
        .deadlines
        .runs
        .iter()
        .map(|run| run.length_ticks)
        .max()
        .unwrap_or(0);
    assert!(
        longest >= 55,
        "no rotor command comes from a mixer that is stopped: {:?}",
        report.deadlines.runs
    );
    assert!(report.deaths.is_empty(), "{:?}", report.deaths);
    rig.ok("report --full")
        .says("  fault mixer.stop=60ms at tick 500 (0.500 s)\n");
    let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
    assert!(
        page.contains("fault from 0.500 s: mixer.stop=60ms"),
        "the page's plots"
    );
    rig.ok("replay --verify").says("identical");
    rig.assert_nothing_left();
}

#[test]
fn a_stage_that_is_late_by_plan_computes_so_much_longer_and_so_does_one_by_injection() {
    let rig = Rig::new("late");
    let config = in_the_air(&rig, 10);
    let options = format!("--rt off --config {config} --duration 1500ms --trajectory hover");
    let flight = rig.take_off(format!(
        "{options} --fault inner.late=200us..300us@100ms..600ms"
    ));
    let said = rig.ok("inject outer.late=150us --for 200ms").stdout;
    assert!(said.starts_with("outer.late=150us from tick "), "{said}");
    rig.ok("inject plant.late=100us --for 20ms");
    flight.end().expect(0);
    let report = report(&rig);
    // Ten times slower than in flight: at least 2 ms, and 1.5 ms.
    for (series, least_us) in [("compute.inner", 2000.0), ("compute.outer", 1500.0)] {
        let max_us = report.series(series).unwrap().max_us;
        assert!(max_us >= least_us, "{series}: {max_us} us");
    }
    let half = report.series("compute.inner").unwrap();
    assert!(
        half.p50_us < 2000.0,
        "the other two thirds are not late: {half:?}"
    );
    assert_eq!(
        reported(&report)[0],
        ("inner.late=200us..300us".to_owned(), 100, Some(600), false)
    );
    rig.ok("replay --verify").says("identical");
    rig.assert_nothing_left();
}

/// The processes that keep the processor of a rig busy.
fn loads(rig: &Rig) -> Vec<u32> {
    rig.processes_of("cpu-load")
}

#[test]
fn the_processor_is_kept_busy_for_a_time_and_by_nobody_afterwards() {
    let rig = Rig::new("busy");
    let config = in_the_air(&rig, 2);
    let options = format!("--rt off --config {config} --duration 4s --trajectory hover");
    let flight = rig.take_off(format!("{options} --fault cpu.load=0.3@1s..1500ms"));
    let planned = wait_until("the planned load", || loads(&rig).first().copied());
    wait_until("its end", || loads(&rig).is_empty().then_some(()));
    rig.ok("inject cpu.load=0.25");
    let injected = wait_until("the injected load", || loads(&rig).first().copied());
    assert_ne!(planned, injected);
    rig.ok("inject cpu.load=off");
    wait_until("its end", || loads(&rig).is_empty().then_some(()));
    let is_root = fifo_refusal(90).is_none();
    if is_root {
        rig.ok("inject cpu.hog=90 --for 50ms");
        wait_until("the hog", || loads(&rig).first().copied());
    } else {
        not_tested("SCHED_FIFO is not granted here");
        let refused = rig.run("inject", "cpu.hog=90 --for 50ms").expect(1);
        refused.complains("cpu.hog=90: the kernel refuses SCHED_FIFO 90");
    }
    flight.end().expect(0);
    let found = reported(&report(&rig));
    let what: Vec<&str> = found.iter().map(|(what, ..)| what.as_str()).collect();
    assert_eq!(what[..3], ["cpu.load=0.3", "cpu.load=0.25", "cpu.load=off"]);
    assert_eq!(what.get(3).copied(), is_root.then_some("cpu.hog=90"));
    rig.assert_nothing_left();
}

#[test]
fn who_keeps_the_processor_busy_or_was_stopped_does_not_outlive_a_launcher_that_is_killed() {
    let rig = Rig::new("orphan");
    let config = in_the_air(&rig, 2);
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 30s --trajectory hover \
         --fault cpu.load=0.2@300ms --fault inner.stop=20s@1s"
    ));
    let load = wait_until("the load", || loads(&rig).first().copied());
    let inner = rig.processes_of("inner")[0];
    let is_stopped = || {
        let stat = fs::read_to_string(format!("/proc/{inner}/stat")).unwrap_or_default();
        stat.contains(") T ").then_some(())
    };
    wait_until("the inner loop to be stopped", is_stopped);
    send(flight.pid(), Signal::KILL);
    flight.end();
    wait_until("the load to end", || is_gone(load).then_some(()));
    wait_until("the inner loop to end", || is_gone(inner).then_some(()));
    let are_gone = || {
        ["plant", "outer", "mixer", "record"]
            .iter()
            .all(|role| rig.processes_of(role).is_empty())
    };
    wait_until("the others to end", || are_gone().then_some(()));
    rig.run("clean", "");
    rig.assert_nothing_left();
}

#[test]
fn a_priority_that_the_kernel_refuses_is_refused_before_take_off() {
    let rig = Rig::new("refused");
    let Some(ended) = fly_unprivileged(&rig, "--rt off --fault cpu.hog=90@1s") else {
        return;
    };
    ended
        .expect(1)
        .complains("cpu.hog=90: the kernel refuses SCHED_FIFO 90")
        .complains("CAP_SYS_NICE");
}
