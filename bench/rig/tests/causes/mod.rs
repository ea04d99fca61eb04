//! Causes of missed deadlines, made on purpose: a hog, and a mixer in trouble.

use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;

use ironbird::settings::Settings;
use law::GuardedMixer;
use model::inspection::{Expected, Rejections};
use model::messages::NO_TICK;
use model::role::Role;
use role::rt::{loops_cpu, take_stand};
use role::shell::{MixerJob, Shell};
use role::stage::{self, Stage, TickOutcome, Turn};
use rustix::thread::gettid;
use serde_json::Value;
use wire::Wire;
use wire::clock::{Horizon, now_ns};
use wire::error::Error;

use crate::rig::{self, Ended, Rig, Running, in_own_mounts, take_station, wait_until};

/// A tick [ns].
pub const T: u64 = 1_000_000;

/// One flight at a time: on the loops' processor, two keep each other from it.
pub static PROCESSOR: Mutex<()> = Mutex::new(());

/// Waits until a flight has been in the air for a second, and has its first report.
pub fn await_first_report(rig: &Rig) {
    wait_until("the first report", || rig.out().join("latest/report.json").exists().then_some(()));
}

/// The worst outages of the report.
pub fn worst(rig: &Rig) -> Vec<Value> {
    rig.report()["autopsy"]["worst"].as_array().unwrap().clone()
}

/// Keeps everybody else from the loops' processor for a time, from within a tick on.
pub fn hog(time_ns: u64) {
    let cpu = loops_cpu();
    let hog = std::thread::Builder::new().name("hog".into()).spawn(move || {
        assert_eq!(take_stand(cpu, 99).priority, 99);
        let until_ns = now_ns() + time_ns;
        while now_ns() < until_ns {}
    });
    hog.unwrap().join().unwrap();
}

/// Mounts what the kernel traces with.
pub const TRACEFS: &str = "mount -t tracefs nodev /sys/kernel/tracing";
/// Whether it traces for us.
pub const TRACES: &str = "mkdir /sys/kernel/tracing/instances/t$$ && rmdir /sys/kernel/tracing/instances/t$$";

/// Starts a flight with a trace; nothing where the kernel traces nothing for this user.
pub fn take_off_traced(rig: &Rig, args: &[&str]) -> Option<Running> {
    let mut flight = in_own_mounts(TRACEFS, TRACES, rig::IRONBIRD)?;
    flight.args(["fly", "--trace"]).args(rig.own_args("fly", args)).env("IRONBIRD_ROOT", rig.root());
    let flight = rig.launch(flight);
    rig.await_flight();
    Some(flight)
}

/// Settings of the flight with the troubled mixer: ticks of 10 ms, so that what else happens misses no deadline.
const TROUBLED: &str = "[flight]\nslowdown = 10\nduration_s = 0.6\n";
/// A tick of that flight [ns].
pub const SLOW_T: u64 = 10 * T;
/// In the environment of the troubled mixer: the instance that it belongs to.
const INSTANCE: &str = "TROUBLED_INSTANCE";

/// A mixer that in some ticks does something besides its work, or does not hear its input.
pub struct TroubledMixer {
    mixer: Shell<MixerJob<GuardedMixer>>,
}

impl TroubledMixer {
    /// It computes for longer than a tick, in two ticks near to each other.
    pub const COMPUTES: [u64; 4] = [100, 110, 150, 160];
    /// It touches memory that it never had, and then computes.
    pub const FAULTS: [u64; 3] = [220, 260, 300];
    /// It does not take what the inner loop sent in time, and is a little too slow after its cut-off.
    const DEAF: [u64; 3] = [360, 400, 440];
}

fn compute_until(ns: u64) {
    while now_ns() < ns {}
}

impl Stage for TroubledMixer {
    const ROLE: Role = Role::Mixer;

    fn arm(&mut self, wire: &Wire, expected: Expected, epoch: u64) -> Result<(), Error> {
        self.mixer.arm(wire, expected, epoch)
    }

    fn take(&mut self, horizon: impl Horizon) -> Result<u64, Error> {
        // A message of the next tick may be there, too.
        let tick = horizon.latest_tick() - 1;
        if Self::DEAF.contains(&tick) { Ok(NO_TICK) } else { self.mixer.take(horizon) }
    }

    fn tick(&mut self, turn: &Turn, end: &mut dyn FnMut(model::boards::Ending)) -> Result<TickOutcome, Error> {
        if Self::COMPUTES.contains(&turn.tick) {
            compute_until(turn.receive_ns + SLOW_T);
        }
        if Self::FAULTS.contains(&turn.tick) {
            // Never given back, so that it is new each time.
            black_box(vec![1_u8; 1 << 20].leak());
            compute_until(turn.receive_ns + SLOW_T);
        }
        if Self::DEAF.contains(&turn.tick) {
            compute_until(turn.receive_ns + SLOW_T / 5);
        }
        self.mixer.tick(turn, end)
    }

    fn rehearse(&mut self, tick: u64) -> Result<bool, Error> {
        self.mixer.rehearse(tick)
    }

    fn rejections(&self) -> Rejections {
        self.mixer.rejections()
    }
}

/// The troubled mixer, in a process of its own.
#[test]
#[ignore = "no test, but a process that a test starts"]
fn troubled_mixer() {
    let Ok(instance) = std::env::var(INSTANCE) else { return };
    let settings = Settings::resolve(Some(Path::new("troubled.toml")), &Vec::new()).unwrap();
    let mut station = take_station(Role::Mixer, &instance, &settings);
    // The thread of a test is not the first of its process, and it is the loop's that the recorder samples.
    station.status.pid = u64::try_from(gettid().as_raw_nonzero().get()).unwrap();
    let doorbell = station.wire().doorbell_with_alarm(Role::Mixer).unwrap();
    let mixer = Shell::new(station.wire(), MixerJob(settings.mixer_stage().unwrap()), None).unwrap();
    // What it is late with shall be its own doing; refused, it may be preempted. No memory is locked, as page faults
    // are wanted.
    let _ = take_stand(loops_cpu(), 90);
    stage::run(TroubledMixer { mixer }, doorbell, station).unwrap();
}

pub fn fly_with_a_troubled_mixer(rig: &Rig) -> Ended {
    let settings = rig.file("troubled.toml");
    fs::write(&settings, TROUBLED.to_owned() + "[rt]\nmode = \"off\"\n").unwrap();
    let start = |role: &str| rig.start(role, &["--config", &settings]);
    let mut mixer = Command::new(std::env::current_exe().unwrap());
    mixer.args(["--exact", "causes::troubled_mixer", "--ignored"]);
    mixer.env("IRONBIRD_ROOT", rig.root()).env(INSTANCE, &rig.instance);
    let loops = [start("plant"), start("outer"), start("inner"), rig.launch(mixer)];
    let recorder = start("record");
    for process in loops {
        process.end().expect(0);
    }
    recorder.end()
}
