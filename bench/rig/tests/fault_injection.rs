//! Faults that are injected into a running flight, or planned: into messages, stages, processes and the processor.

use crate::c_laws::misbehaving;
use crate::restarts::in_the_air;
use crate::rig::unprivileged::fly_unprivileged;
use crate::rig::{Rig, is_gone, not_tested, send, table, wait_until};
use analysis::schema::Report;
use faults::MOST;
use flight_log::fault_record::injected;
use process::rt::fifo_refusal;
use rustix::process::Signal;
use serde_json::Value;
use std::fs;

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
fn an_instant_is_kept_where_it_is_far_enough_and_otherwise_the_answer_says_so() {
    let rig = Rig::new("instant");
    let config = in_the_air(&rig, 2);
    let flight = rig.take_off(format!("--rt off --config {config} --duration 20s"));
    let answer = rig.ok("inject setpoint.drop=1/2 --at-tick 15000 --for 1s");
    assert_eq!(
        answer.stdout,
        "setpoint.drop=1/2 from tick 15000 (15.000 s) to tick 16000 (16.000 s), injected in flight\n"
    );
    let answer = rig.ok("inject state.freeze --at-tick 1").stdout;
    let is_past = answer.contains("tick 1 was past, or too near");
    assert!(from_tick(&answer) > 1 && is_past, "{answer}");
    let later = rig.ok("inject wrench.drop=0.5 --in 5s --for 10ms").stdout;
    assert!(from_tick(&later) > from_tick(&answer) + 4000, "{later}");
    rig.ok("inject cpu.load=0.1 --at-tick 19000 --for 100ms");
    // Parameters: the changes of one command hold from the same tick on.
    let both = rig
        .ok("inject mass_kg=0.6 rotor_efficiency_3=0.9,gyro_noise_rad_s=0.01")
        .says("parameter epoch 1\n")
        .says("  mass_kg  0.52 -> 0.6 kg\n")
        .says("  rotor_efficiency_3  1.0 -> 0.9\n")
        .says("  gyro_noise_rad_s  0.0 -> 0.01 rad/s\n");
    let past = rig.ok("inject --at-tick 1 gyro_noise_rad_s=0.02");
    let past = past.says("parameter epoch 2: tick 1 was past\n");
    assert!(from_tick(&past.stdout) > from_tick(&both.stdout), "{past}");
    let drag = rig.ok("inject rotational_drag_nm_s=0.525 --at-tick 18000");
    drag.says("applied at tick 18000 ");
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
    flight.interrupt();
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

#[test]
fn faults_that_would_never_act_are_refused_by_a_flight() {
    let rig = Rig::new("behind");
    let flight = rig.take_off(rig.slowly(100, "60ms"));
    let refused = rig.run("inject", "state.drop=0.1").expect(1);
    refused.complains("state.drop never strikes: the flight ends before");
    flight.interrupt();

    let waits = "in lockstep ticks wait for a stage that is not ready";
    let never_late = "in lockstep no tick is late, however busy the processor is";
    let flight = rig.take_off("--pace lockstep --duration 1h --trajectory hover");
    for (fault, why) in [
        ("inner.stop=20ms", waits),
        ("inner.kill", waits),
        ("inner.late=1ms", waits),
        ("cpu.hog=90", never_late),
        ("cpu.load=0.5", never_late),
    ] {
        let refused = rig.refused(&format!("inject {fault}"));
        refused.complains(&format!("{fault}: {why}"));
    }
    flight.interrupt();
}

fn reported(report: &Report) -> Vec<(&str, u64, Option<u64>, bool)> {
    let faults = report.faults.iter();
    faults
        .map(|it| (&*it.what, it.tick, it.to_tick, it.live))
        .collect()
}

#[test]
fn a_stage_that_is_stopped_by_plan_is_out_for_that_time_and_continues() {
    let rig = Rig::new("stop");
    let config = in_the_air(&rig, 2);
    rig.ok(&format!(
        "fly --rt off --config {config} --duration 1500ms --trajectory hover \
         --fault mixer.stop=60ms@500ms --fault inner.stop=40ms@1s"
    ));
    let report = rig.final_report();
    assert_eq!(
        reported(&report),
        [
            ("mixer.stop=60ms", 500, None, false),
            ("inner.stop=40ms", 1000, None, false)
        ]
    );
    for (role, least) in [("mixer", 55), ("inner", 35)] {
        let skipped = report.roles[role].ticks_skipped;
        assert!(skipped >= least, "{role}: {skipped} ticks skipped");
    }
    let runs = &report.deadlines.runs;
    assert!(runs.iter().any(|run| run.length_ticks >= 55), "{runs:?}");
    assert!(report.deaths.is_empty(), "{:?}", report.deaths);
    rig.ok("report --full")
        .says("  fault mixer.stop=60ms at tick 500 (0.500 s)\n");
    assert!(
        rig.flown("report.html")
            .contains("fault from 0.500 s: mixer.stop=60ms")
    );
    rig.assert_replayed();
    rig.assert_nothing_left();
}

#[test]
fn late_and_killed_stages_of_a_plan_and_of_injections_are_reported_and_replayed() {
    let rig = Rig::new("late");
    let config = in_the_air(&rig, 10);
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 1500ms --trajectory hover --on-death restart \
         --fault inner.late=200us..300us@100ms..600ms --fault mixer.late=1800us@700ms..900ms"
    ));
    let answer = rig.ok("inject outer.late=150us --for 200ms").stdout;
    assert!(
        answer.starts_with("outer.late=150us from tick "),
        "{answer}"
    );
    rig.ok("inject plant.late=100us --for 20ms");
    rig.ok("inject inner.state.lag=3,inner.setpoint.delay=2,inner.setpoint.freeze --for 1s");
    rig.ok("inject inner.state.position_w_m.z.bias=0.01,wrench.thrust_n.bias=0.01");
    rig.ok("inject inner.kill --at-tick 1200");
    for (args, why) in [
        (
            "inner.stop=20ms --at-tick 1250",
            "inner.stop is given for these ticks already",
        ),
        (
            "cpu.load=off",
            "cpu.load=off: it does not strike then or later",
        ),
    ] {
        rig.run("inject", args).expect(1).complains(why);
    }
    flight.end().expect(0);
    let report = rig.final_report();
    // Ten times slower than in flight: at least 2 ms, and 1.5 ms.
    for (series, least_us) in [("compute.inner", 2000.0), ("compute.outer", 1500.0)] {
        let max_us = report.series(series).unwrap().max_us;
        assert!(max_us >= least_us, "{series}: {max_us} us");
    }
    let inner = report.series("compute.inner").unwrap();
    assert!(inner.p50_us < 2000.0, "most ticks are not late: {inner:?}");
    // Only every second tick of 200 ms is worked.
    assert!(report.roles["mixer"].ticks_skipped > 80);
    let [death] = &report.deaths[..] else {
        panic!("{:?}", report.deaths)
    };
    assert_eq!(death.how, "killed by the fault inner.kill of tick 1200");
    assert!(death.back_after_ms.is_some(), "{death:?}");
    let faults = reported(&report);
    assert_eq!(
        faults[0],
        ("inner.late=200us..300us", 100, Some(600), false)
    );
    assert!(
        faults.contains(&("inner.kill", 1200, None, true)),
        "{faults:?}"
    );
    rig.assert_replayed();
    rig.assert_nothing_left();
}

/// The processes that keep the processor of a rig busy.
fn loads(rig: &Rig) -> Vec<u32> {
    rig.processes_of("cpu-load")
}

fn await_load(rig: &Rig) -> u32 {
    wait_until("the load", || loads(rig).first().copied())
}

fn await_no_load(rig: &Rig) {
    wait_until("the end of the load", || {
        loads(rig).is_empty().then_some(())
    });
}

#[test]
fn the_processor_is_kept_busy_for_a_time() {
    let rig = Rig::new("busy");
    let config = in_the_air(&rig, 2);
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 600s --trajectory hover --fault cpu.load=0.3@1s..1500ms"
    ));
    let planned = await_load(&rig);
    await_no_load(&rig);
    rig.ok("inject cpu.load=0.25");
    assert_ne!(planned, await_load(&rig));
    rig.ok("inject cpu.load=off");
    await_no_load(&rig);
    let mut expected = vec!["cpu.load=0.3", "cpu.load=0.25", "cpu.load=off"];
    if fifo_refusal(90).is_none() {
        rig.ok("inject cpu.hog=90 --for 50ms");
        await_load(&rig);
        await_no_load(&rig);
        expected.push("cpu.hog=90");
    } else {
        not_tested("SCHED_FIFO is not granted here");
        let refused = rig.run("inject", "cpu.hog=90 --for 50ms").expect(1);
        refused.complains("cpu.hog=90: the kernel refuses SCHED_FIFO 90");
    }
    flight.interrupt().expect(130);
    let report = rig.final_report();
    let what: Vec<&str> = report.faults.iter().map(|it| &*it.what).collect();
    assert_eq!(what, expected);
    rig.assert_nothing_left();
}

#[test]
fn loads_and_stopped_stages_end_with_a_supervisor_that_is_killed() {
    let rig = Rig::new("orphan");
    let config = in_the_air(&rig, 2);
    let flight = rig.take_off(format!(
        "--rt off --config {config} --duration 30s --trajectory hover \
         --fault cpu.load=0.2@300ms --fault inner.stop=20s@1s"
    ));
    let mut processes = vec![await_load(&rig)];
    let inner = rig.processes_of("inner")[0];
    wait_until("the inner loop to be stopped", || {
        let stat = fs::read_to_string(format!("/proc/{inner}/stat")).unwrap();
        stat.contains(") T ").then_some(())
    });
    processes.extend(flight.roles().into_values());
    flight.signal(Signal::KILL);
    flight.end();
    wait_until("all to end", || {
        processes.iter().all(|pid| is_gone(*pid)).then_some(())
    });
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
