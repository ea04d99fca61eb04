//! `ironbird report diff` on groups of real flights that are alike, and on groups that differ in one hop.

use crate::rig::{Rig, rounds, take_station};
use config::Settings;
use control_api::GuardedInner;
use faults::MessageFaults;
use faults::live::LoopFaults;
use ipc::Wire;
use ipc::clock::{Horizon, busy_wait};
use ipc::error::Error;
use messages::content::{NO_TICK, Setpoint, State, Wrench};
use messages::header::Header;
use messages::inspection::{Expected, Rejections};
use messages::role::Role;
use process::stage::{self, ActiveFaults, Flight, Input, Inputs, Stage, StageInputs};
use rustix::thread::gettid;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

/// In the environment of the inner loop below: its instance, and by how much it sees its input late [us].
const INSTANCE: &str = "LATE_INNER_INSTANCE";
const LATE_US: &str = "LATE_INNER_US";
/// What the other hop is late by [us].
const KNOWN_US: &str = "20";

type InnerInputs = (Input<Setpoint>, Input<State>);

/// Inputs that are received late, as if the hop to them took longer.
struct LateInputs {
    inputs: InnerInputs,
    late_ns: u64,
    seen: u64,
}

impl Inputs for LateInputs {
    type Stamped = <InnerInputs as Inputs>::Stamped;

    fn new(wire: &Wire, role: Role, faults: &MessageFaults) -> Result<Self, Error> {
        let late_us = std::env::var(LATE_US).unwrap();
        Ok(Self {
            inputs: Inputs::new(wire, role, faults)?,
            late_ns: late_us.parse::<u64>().unwrap() * 1_000,
            seen: NO_TICK,
        })
    }

    fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        self.inputs.arm(expected)
    }

    fn take(&mut self, horizon: impl Horizon, faults: &mut ActiveFaults) -> Result<u64, Error> {
        let tick = self.inputs.take(horizon, faults)?;
        if tick != NO_TICK && tick != self.seen {
            self.seen = tick;
            busy_wait(self.late_ns);
        }
        Ok(tick)
    }

    fn settle(&mut self, tick: u64) {
        self.inputs.settle(tick);
    }

    fn dated(&self) -> Self::Stamped {
        self.inputs.dated()
    }

    fn dated_as_of(&self, tick: u64) -> Self::Stamped {
        self.inputs.dated_as_of(tick)
    }

    fn fresh(&self, tick: u64) -> bool {
        self.inputs.fresh(tick)
    }

    fn history(&self, tick: u64) -> Header {
        self.inputs.history(tick)
    }

    fn rejections(&self) -> Rejections {
        self.inputs.rejections()
    }
}

struct LateInner(GuardedInner);

impl Stage for LateInner {
    const ROLE: Role = Role::Inner;
    type Inputs = LateInputs;
    type Output = Wrench;

    fn work(&mut self, tick: u64, inputs: &StageInputs<Self>) -> Option<Wrench> {
        self.0.work(tick, inputs)
    }

    fn rehearse(&mut self, tick: u64, inputs: &StageInputs<Self>) -> Option<Wrench> {
        Stage::rehearse(&mut self.0, tick, inputs)
    }
}

#[test]
#[ignore = "no test, but a process that a test starts"]
fn late_inner() {
    let Ok(instance) = std::env::var(INSTANCE) else {
        return;
    };
    let settings = Settings::resolve(Some(Path::new("flight.toml")), &Vec::new()).unwrap();
    let mut station = take_station(Role::Inner, &instance, &settings);
    // The thread of a test is not the first of its process, and it is the loop's that the recorder samples.
    station.status.pid = u64::try_from(gettid().as_raw_nonzero().get()).unwrap();
    let flight = Flight {
        lockstep: false,
        slowdown: 1,
        faults: LoopFaults::none(0),
    };
    let inner = LateInner(settings.inner_stage().unwrap());
    stage::run(inner, station, &flight).unwrap();
}

/// Flies with an inner loop that is late; returns the name of the flight's directory.
fn fly(rig: &Rig, late_us: &str) -> String {
    let settings = rig.file("flight.toml");
    fs::write(&settings, "[flight]\nduration_s = 3.0\n").unwrap();
    let mut inner = Command::new(std::env::current_exe().unwrap());
    inner
        .args(["--exact", "comparisons::late_inner", "--ignored"])
        .env("IRONBIRD_ROOT", rig.root())
        .env(INSTANCE, &rig.instance)
        .env(LATE_US, late_us);
    let start = |role: &str| rig.start(role, format!("--config {settings}"));
    let first = ["record", "plant", "outer"].map(start);
    let last = [rig.launch(inner), start("mixer")];
    for process in first.into_iter().chain(last) {
        process.end().expect(0);
    }
    rig.run_directories().pop().unwrap()
}

/// The differences that a comparison reports; none if it is not judged.
fn differences(rig: &Rig, a: &[String], b: &[String]) -> Option<Vec<String>> {
    let args = format!("diff --format json {} -- {}", a.join(" "), b.join(" "));
    let diff = rig.run("report", args).expect(0).json();
    let is_different = |figure: &&Value| figure["says"] == "more" || figure["says"] == "less";
    let figures = diff["figures"]
        .as_array()
        .unwrap()
        .iter()
        .filter(is_different);
    let names = figures.map(|figure| figure["name"].as_str().unwrap().to_owned());
    (diff["timing"]["says"] == "judged").then(|| names.collect())
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn soak_of_comparisons() {
    let rig = Rig::new("alike");
    let (mut alike, mut late) = (Vec::new(), Vec::new());
    for _ in 0..rounds() {
        let mut groups = [const { Vec::new() }; 3];
        for _ in 0..3 {
            for (group, late_us) in groups.iter_mut().zip(["0", KNOWN_US, "0"]) {
                group.push(fly(&rig, late_us));
            }
        }
        let [a, b, c] = &groups;
        alike.push(differences(&rig, a, c));
        late.push(differences(&rig, a, b));
    }
    println!("alike: {alike:?}\none hop late by {KNOWN_US} us: {late:?}");
    // With a probability of even one false difference of 10 % (three flights a side), that many and one more.
    let differ = alike.iter().flatten().filter(|names| !names.is_empty());
    assert!(differ.count() as u64 <= rounds() / 10 + 1, "{alike:?}");
    // Three of four find the late hop; a few rounds may miss it.
    let hop = "hop.outer_inner p50 [us]".to_owned();
    let is_found = late.iter().flatten().any(|names| names.contains(&hop));
    assert!(rounds() < 10 || is_found, "{late:?}");
}
