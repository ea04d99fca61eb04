//! What `ironbird report diff` says of groups of real flights that are alike, and of groups that are not.

use crate::rig::{Rig, rounds, take_station};
use control_api::GuardedInner;
use ipc::Wire;
use ipc::clock::{Horizon, now_ns};
use ipc::error::Error;
use ironbird::settings::Settings;
use messages::content::NO_TICK;
use messages::inspection::{Expected, Rejections};
use messages::role::Role;
use process::shell::Shell;
use process::stage::{self, Stage, TickContext, TickOutcome};
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

/// An inner loop that sees its input late, as if the hop to it took longer.
struct LateInner {
    inner: Shell<GuardedInner>,
    late_ns: u64,
    seen: u64,
}

impl Stage for LateInner {
    const ROLE: Role = Role::Inner;

    fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.inner.arm(wire, expected, epoch)
    }

    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        let tick = self.inner.take(horizon)?;
        if tick != NO_TICK && tick != self.seen {
            self.seen = tick;
            let until_ns = now_ns() + self.late_ns;
            while now_ns() < until_ns {}
        }
        Ok(tick)
    }

    fn tick(
        &mut self,
        turn: &TickContext,
        end: &mut dyn FnMut(messages::blackboards::EndReason),
    ) -> Result<TickOutcome, Error> {
        self.inner.tick(turn, end)
    }

    fn rehearse(&mut self, tick: u64) -> Result<bool, Error> {
        self.inner.rehearse(tick)
    }

    fn rejections(&self) -> Rejections {
        self.inner.rejections()
    }
}

#[test]
#[ignore = "no test, but a process that a test starts"]
fn late_inner() {
    let Ok(instance) = std::env::var(INSTANCE) else {
        return;
    };
    let late_ns = std::env::var(LATE_US).unwrap().parse::<u64>().unwrap() * 1_000;
    let settings = Settings::resolve(Some(Path::new("flight.toml")), &Vec::new()).unwrap();
    let mut station = take_station(Role::Inner, &instance, &settings);
    // The thread of a test is not the first of its process, and it is the loop's that the recorder samples.
    station.status.pid = u64::try_from(gettid().as_raw_nonzero().get()).unwrap();
    let doorbell = station.wire().doorbell(Role::Inner).unwrap();
    let law = settings.inner_stage().unwrap();
    let inner = Shell::new(station.wire(), law, Some(Role::Mixer)).unwrap();
    stage::run(
        LateInner {
            inner,
            late_ns,
            seen: NO_TICK,
        },
        doorbell,
        station,
    )
    .unwrap();
}

/// Flies with an inner loop that is late by so much; the name of the flight's directory.
fn fly(rig: &Rig, late_us: &str) -> String {
    let settings = rig.file("flight.toml");
    fs::write(&settings, "[flight]\nduration_s = 3.0\n").unwrap();
    let start = |role: &str| rig.start(role, format!("--config {settings}"));
    let mut inner = Command::new(std::env::current_exe().unwrap());
    inner.args(["--exact", "comparisons::late_inner", "--ignored"]);
    inner
        .env("IRONBIRD_ROOT", rig.root())
        .env(INSTANCE, &rig.instance)
        .env(LATE_US, late_us);
    let roles = [
        start("record"),
        start("plant"),
        start("outer"),
        rig.launch(inner),
        start("mixer"),
    ];
    for process in roles {
        process.end().expect(0);
    }
    rig.run_directories().pop().unwrap()
}

#[derive(Debug, Default)]
struct Said {
    not_judged: u64,
    differ: u64,
    hop_is_more: u64,
    figures: Vec<String>,
}

impl Said {
    fn compare(&mut self, rig: &Rig, a: &[String], b: &[String]) {
        let args: Vec<&str> = ["diff", "--format", "json"]
            .into_iter()
            .chain(a.iter().map(String::as_str))
            .chain(["--"])
            .chain(b.iter().map(String::as_str))
            .collect();
        let diff = rig.run("report", &args).expect(0).json();
        if diff["timing"]["says"] != "judged" {
            self.not_judged += 1;
            return;
        }
        let figures = diff["figures"].as_array().unwrap();
        let is_apart = |figure: &&Value| figure["says"] == "more" || figure["says"] == "less";
        let apart: Vec<&str> = figures
            .iter()
            .filter(is_apart)
            .map(|figure| figure["name"].as_str().unwrap())
            .collect();
        self.differ += u64::from(!apart.is_empty());
        self.hop_is_more += u64::from(apart.contains(&"hop.outer_inner p50 [us]"));
        self.figures.extend(apart.into_iter().map(str::to_owned));
    }
}

#[test]
#[ignore = "soak: as many rounds as IRONBIRD_ROUNDS says, or one"]
fn soak_of_comparisons() {
    let rig = Rig::new("alike");
    let (mut alike, mut late) = (Said::default(), Said::default());
    for _ in 0..rounds() {
        let (mut a, mut b, mut c) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..3 {
            a.push(fly(&rig, "0"));
            b.push(fly(&rig, KNOWN_US));
            c.push(fly(&rig, "0"));
        }
        alike.compare(&rig, &a, &c);
        late.compare(&rig, &a, &b);
    }
    println!("alike: {alike:?}\none hop late by {KNOWN_US} us: {late:?}");
    // With a probability of even one false difference of 10 % (three flights a side), that many and one more.
    assert!(alike.differ <= rounds() / 10 + 1, "{alike:?}");
    // Three of four find the other one; a few rounds may miss it.
    assert!(rounds() < 10 || late.hop_is_more > 0, "{late:?}");
}
