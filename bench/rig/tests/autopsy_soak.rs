//! How often the autopsy finds a cause made on purpose, whole and by name.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeMap;
use std::sync::PoisonError;
use std::thread::sleep;
use std::time::Duration;

use crate::causes::{
    PROCESSOR, SLOW_T, T, TroubledMixer, await_first_report, fly_with_a_troubled_mixer, hog, take_off_traced, worst,
};
use crate::rig::{Rig, rounds, stop_for};
use model::boards::{RUN, Run};
use model::role::STAGES;
use serde_json::Value;
use wire::Wire;
use wire::clock::now_ns;

/// What became of a cause in the reports of many flights.
#[derive(Debug, Default)]
struct Found {
    caused: u64,
    /// One outage at its time, with all of its ticks.
    whole: u64,
    /// Of these: its class, and its stage.
    named: u64,
    /// Of these: the report says that it does not know.
    unknown: u64,
    /// Of these: another class or stage.
    wrong: Vec<String>,
}

/// Classes that name no cause.
const UNKNOWN: [&str; 4] = ["cannot_tell", "processor_stalled", "ready_not_run", "wake_late"];

impl Found {
    /// Looks for an outage of `ticks` between two times of the flight [s]; who is away for as long need not be out in
    /// the one that he leaves in, or in the one that he is back in.
    fn look(&mut self, cases: &[Value], times_s: (f64, f64), ticks: u64, (class, stage): (&str, &str)) {
        self.caused += 1;
        let is_it = |case: &&Value| {
            let time_s = case["time_s"].as_f64().unwrap();
            (times_s.0..times_s.1).contains(&time_s)
                && case["ticks"].as_u64().unwrap() >= ticks.saturating_sub(1).max(1)
        };
        let Some(case) = cases.iter().find(is_it) else {
            let told = |case: &Value| format!("{} s: {} ticks", case["time_s"], case["ticks"]);
            println!("not found at {times_s:?} s: {:?}", cases.iter().map(told).collect::<Vec<_>>());
            return;
        };
        self.whole += 1;
        let said = (case["class"].as_str().unwrap(), case["stage"].as_str().unwrap_or("-"));
        match said {
            _ if said == (class, stage) => self.named += 1,
            (class, _) if UNKNOWN.contains(&class) => self.unknown += 1,
            (class, stage) => self.wrong.push(format!("{class}, {stage}")),
        }
    }
}

/// When tick 0 of the flight began [ns].
fn t0_ns(rig: &Rig) -> u64 {
    let wire = Wire::open(&rig.known()).unwrap();
    wire.board_reader::<Run>(RUN).unwrap().unwrap().get().t0_ns
}

/// Stops each stage in turn for so long, in one flight.
fn stop_each(found: &mut BTreeMap<String, Found>, slowdown: u64, lengths_ms: &[u64]) {
    let rig = Rig::new("causes");
    let stops = || STAGES.into_iter().flat_map(|stage| lengths_ms.iter().map(move |ms| (stage, *ms)));
    let pause = Duration::from_millis(700);
    // The first report may come a second late.
    let wall_ms = 2000 + stops().map(|(_, ms)| ms + 700).sum::<u64>() + 1000;
    let duration = format!("{}ms", wall_ms / slowdown);
    let flight = rig.take_off(&["--trajectory", "hover", "--duration", &duration, "--config", &rig.slow(slowdown)]);
    await_first_report(&rig);
    let (t0_ns, roles) = (t0_ns(&rig), flight.roles());
    let mut begins_s = Vec::new();
    for (stage, ms) in stops() {
        sleep(pause);
        begins_s.push((now_ns() - t0_ns) as f64 / 1e9);
        stop_for(roles[stage.name()], Duration::from_millis(ms));
    }
    flight.end();
    let cases = worst(&rig);
    for ((stage, ms), begin_s) in stops().zip(begins_s) {
        // A stage is out from its tick after the stop on, and what came before may belong to the same outage.
        let times_s = (begin_s - 0.02, begin_s + 0.03);
        let of = found.entry(format!("{stage} stopped for {ms} ms, ticks of {slowdown} ms")).or_default();
        of.look(&cases, times_s, ms / slowdown, ("stopped_or_dead", stage.name()));
    }
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn soak_of_causes() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let mut found = BTreeMap::<String, Found>::new();
    for _ in 0..rounds() {
        stop_each(&mut found, 1, &[5, 100]);
        stop_each(&mut found, 10, &[3000]);
        let rig = Rig::new("hogged");
        if let Some(flight) = take_off_traced(&rig, &["--duration", "3s"]) {
            await_first_report(&rig);
            let at_s = (now_ns() - t0_ns(&rig)) as f64 / 1e9;
            hog(30 * T);
            flight.end();
            let of = found.entry("FIFO hog for 30 ms, traced".into()).or_default();
            of.look(&worst(&rig), (at_s - 0.02, at_s + 0.03), 30, ("preempted", "plant"));
        }
        let rig = Rig::new("troubled");
        fly_with_a_troubled_mixer(&rig);
        let cases = worst(&rig);
        let (computes, faults) = (TroubledMixer::COMPUTES, TroubledMixer::FAULTS);
        for (cause, ticks, class) in
            [("slow law", &computes[..], "computed_long"), ("page faults", &faults[..], "page_fault")]
        {
            for tick in ticks {
                let time_s = *tick as f64 * SLOW_T as f64 * 1e-9;
                let of = found.entry(format!("{cause}, ticks of 10 ms")).or_default();
                of.look(&cases, (time_s - 0.015, time_s + 0.015), 1, (class, "mixer"));
            }
        }
    }
    for (cause, of) in &found {
        println!("{cause}: {of:?}");
    }
    assert!(found.values().all(|of| of.caused >= rounds()));
}
