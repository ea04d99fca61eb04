//! Root causes of missed deadlines in real flights, whose stages are stopped, late, or kept from their processor.
//!
//! `miss_analysis.rs` tests each cause on constructed evidence.

<<<<<<< HEAD
use crate::rig::{
    self, Ended, Rig, Running, in_own_mounts, not_tested, rounds, send, stop_for, take_station,
    wait_until,
};
use control_api::GuardedMixer;
use ipc::Wire;
use ipc::clock::{Horizon, now_ns};
use ipc::error::Error;
use ironbird::settings::Settings;
use messages::blackboards::{RUN, Run};
use messages::content::NO_TICK;
use messages::inspection::{Expected, Rejections};
use messages::role::{Role, STAGES};
use process::rt::{loops_cpu, take_stand};
use process::shell::Shell;
use process::stage::{self, Stage, TickContext, TickOutcome};
use rustix::process::Signal;
use rustix::thread::gettid;
=======
use crate::c_laws::misbehaving;
use crate::rig::{self, Rig, in_own_mounts, not_tested, rounds};
use ipc::clock::now_ns;
use process::rt::{fifo_refusal, loops_cpu, take_stand};
>>>>>>> cb509e3e448f7a2d257018c572fa18d727c5cbc8
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::sync::{Mutex, PoisonError};

/// One flight at a time: on the loops' processor, two keep each other from it.
static PROCESSOR: Mutex<()> = Mutex::new(());

/// Missed deadlines of a cause in the report; every missed deadline belongs to one.
fn missed_by(report: &Value, class: &str, stage: &str) -> u64 {
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    let missed = |it: &Value| it["missed"].as_u64().unwrap();
    let sum: u64 = classes.iter().map(missed).sum();
    assert_eq!(sum, report["deadlines"]["missed"].as_u64().unwrap());
    let of_class = classes
        .iter()
        .filter(|it| it["class"] == class && it["stage"] == stage);
    of_class.map(missed).sum()
}

/// Keeps all others from the loops' processor for a time, from within a tick on.
fn hog(time_ns: u64) {
    let cpu = loops_cpu();
    let hog = std::thread::Builder::new()
        .name("hog".into())
        .spawn(move || {
            assert_eq!(take_stand(cpu, 99).priority, 99);
            let until_ns = now_ns() + time_ns;
            while now_ns() < until_ns {}
        });
    hog.unwrap().join().unwrap();
}

/// Mounts what the kernel traces with, and makes sure that it may be used.
const TRACEFS: (&str, &str) = (
    "mount -t tracefs nodev /sys/kernel/tracing",
    "mkdir /sys/kernel/tracing/instances/t$$ && rmdir /sys/kernel/tracing/instances/t$$",
);

#[test]
#[ignore = "long: part of the gate"]
fn loops_that_are_kept_from_their_processor_were_ready_and_a_trace_names_what_ran() {
    if fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nothing keeps the loops from their processor for sure");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    for traced in [false, true] {
        let rig = Rig::new("hogged");
        // In slow motion, so that a stall of the host is no match for it.
        let args = format!("--duration 300ms --config {}", rig.slow(10));
        let command = if traced {
            let args = format!("{args} --trace");
            let Some(command) = rig.command_in_mounts(TRACEFS, "fly", args) else {
                return;
            };
            command
        } else {
            rig.command("fly", args)
        };
        let flight = rig.launch(command);
        rig.await_report();
        hog(300_000_000);
        let ended = flight.end().expect(0);
        let report = rig.report();
        let preempted = missed_by(&report, "preempted", "plant");
        if traced {
            assert!(preempted >= 29, "{ended}");
            let cases = report["autopsy"]["worst"].as_array().unwrap();
            let who = |case: &Value| case["ran"][0]["who"].as_str().unwrap_or("").to_owned();
            let case = cases
                .iter()
                .find(|it| who(it).starts_with("hog ("))
                .unwrap();
            assert!(case["ran"][0]["us"].as_f64().unwrap() >= 250e3, "{case}");
            assert!(case["missed"].as_u64().unwrap() >= 29, "{case}");
        } else {
            // Only what the kernel counts shows what ran: a virtual machine does not do so surely.
            let ready = missed_by(&report, "ready_not_run", "plant");
            assert!(preempted + ready >= 29, "{ended}");
        }
    }
}

#[test]
fn a_trace_that_killed_processes_left_is_found_and_removed() {
    let rig = Rig::new("untraced");
    let Some(mut flight) = in_own_mounts(TRACEFS.0, TRACEFS.1, "sh") else {
        return;
    };
    // A shell lets what it starts in the background ignore SIGINT, until the flight hears it.
    // Killed processes leave one: supervisor and recorder are gone before they could remove it.
    let script = "for s in 0.01 0.02 0.03 0.05 0.08; do
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" > /dev/null 2>&1 & fly=$!
sleep $s; kill -TERM $fly; wait $fly; done
ls /sys/kernel/tracing/instances; echo STOPPED
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" & fly=$!
until grep -qs ticks_run \"$2\"/latest/report.json; do sleep 0.05; done
kill -KILL $(pgrep -f -- \"--instance $3\") $fly
sleep 0.2
echo; echo TRIED; \"$1\" clean --dry-run; echo CLEANED; \"$1\" clean; echo AGAIN; \"$1\" clean; ls /sys/kernel/tracing/instances";
    flight
        .args(["-c", script, "sh", rig::IRONBIRD])
        .args([rig.out().to_str().unwrap(), &rig.instance])
        .env("IRONBIRD_ROOT", rig.root());
    let ended = rig.launch(flight).end().expect(0);
    let (stopped, rest) = ended.stdout.split_once("STOPPED").unwrap();
    let (tried, rest) = rest.split_once("CLEANED").unwrap();
    let (cleaned, again) = rest.split_once("AGAIN").unwrap();
    // Other tests trace, too, under roots of their own.
    let prefix = rig.known().prefix();
    let of_root = prefix.split_inclusive('_').take(2).collect::<String>();
    assert!(
        !stopped.contains(&of_root),
        "an orderly end leaves none: {ended}"
    );
    assert!(
        tried.contains(&format!("would remove the kernel's trace {of_root}")),
        "{ended}"
    );
    assert!(
        cleaned.contains(&format!("\nremoved the kernel's trace {of_root}")),
        "{ended}"
    );
    assert!(
        again.contains("nothing to remove") && !again.contains(&rig.instance),
        "{ended}"
    );
}

/// Faults of a flight in slow motion: the tick, the class and the stage of the outage.
const PROVOKED: [(&str, u64, &str, &str); 5] = [
    ("outer.stop=30ms", 150, "stopped_or_dead", "outer"),
    ("inner.stop=30ms", 250, "stopped_or_dead", "inner"),
    ("mixer.stop=30ms", 350, "stopped_or_dead", "mixer"),
    ("plant.stop=30ms", 450, "stopped_or_dead", "plant"),
    // With a law that touches a new page in each tick from there on.
    ("inner.late=1500us", 650, "page_fault", "inner"),
];

#[test]
#[ignore = "long: part of the gate; IRONBIRD_ROUNDS=n counts how often each cause is found"]
fn soak_of_causes() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
<<<<<<< HEAD
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
            let of = found
                .entry("FIFO hog for 30 ms, traced".into())
                .or_default();
            of.look(
                &worst(&rig),
                (at_s - 0.02, at_s + 0.03),
                30,
                ("preempted", "plant"),
            );
        }
        let rig = Rig::new("troubled");
        fly_with_a_troubled_mixer(&rig);
        let cases = worst(&rig);
        let (computes, faults) = (TroubledMixer::COMPUTES, TroubledMixer::FAULTS);
        for (cause, ticks, class) in [
            ("slow law", &computes[..], "computed_long"),
            ("page faults", &faults[..], "page_fault"),
        ] {
            for tick in ticks {
                let time_s = *tick as f64 * SLOW_T as f64 * 1e-9;
                let of = found.entry(format!("{cause}, ticks of 10 ms")).or_default();
                of.look(
                    &cases,
                    (time_s - 0.015, time_s + 0.015),
                    1,
                    (class, "mixer"),
                );
            }
        }
    }
    for (cause, of) in &found {
        println!("{cause}: {of:?}");
    }
    assert!(found.values().all(|of| of.caused >= rounds()));
}

/// A tick [ns].
pub const T: u64 = 1_000_000;

/// One flight at a time: on the loops' processor, two keep each other from it.
pub static PROCESSOR: Mutex<()> = Mutex::new(());

/// Waits until a flight has been in the air for a second, and has its first report.
pub fn await_first_report(rig: &Rig) {
    wait_until("the first report", || {
        rig.out().join("latest/report.json").exists().then_some(())
    });
}

/// The worst outages of the report.
pub fn worst(rig: &Rig) -> Vec<Value> {
    rig.report()["autopsy"]["worst"].as_array().unwrap().clone()
}

/// Keeps everybody else from the loops' processor for a time, from within a tick on.
pub fn hog(time_ns: u64) {
    let cpu = loops_cpu();
    let hog = std::thread::Builder::new()
        .name("hog".into())
        .spawn(move || {
            assert_eq!(take_stand(cpu, 99).priority, 99);
            let until_ns = now_ns() + time_ns;
            while now_ns() < until_ns {}
        });
    hog.unwrap().join().unwrap();
}

/// Mounts what the kernel traces with.
pub const TRACEFS: &str = "mount -t tracefs nodev /sys/kernel/tracing";
pub const TRACES: &str =
    "mkdir /sys/kernel/tracing/instances/t$$ && rmdir /sys/kernel/tracing/instances/t$$";

/// Starts a flight with a trace; nothing where the kernel traces nothing for this user.
pub fn take_off_traced(rig: &Rig, args: &[&str]) -> Option<Running> {
    let mut flight = in_own_mounts(TRACEFS, TRACES, rig::IRONBIRD)?;
    flight
        .args(["fly", "--trace"])
        .args(rig.own_args("fly", args))
        .env("IRONBIRD_ROOT", rig.root());
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
    mixer: Shell<GuardedMixer>,
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
        if Self::DEAF.contains(&tick) {
            Ok(NO_TICK)
        } else {
            self.mixer.take(horizon)
        }
    }

    fn tick(
        &mut self,
        turn: &TickContext,
        end: &mut dyn FnMut(messages::blackboards::EndReason),
    ) -> Result<TickOutcome, Error> {
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
    let Ok(instance) = std::env::var(INSTANCE) else {
        return;
    };
    let settings = Settings::resolve(Some(Path::new("troubled.toml")), &Vec::new()).unwrap();
    let mut station = take_station(Role::Mixer, &instance, &settings);
    // The thread of a test is not the first of its process, and it is the loop's that the recorder samples.
    station.status.pid = u64::try_from(gettid().as_raw_nonzero().get()).unwrap();
    let doorbell = station.wire().doorbell_with_alarm(Role::Mixer).unwrap();
    let mixer = Shell::new(station.wire(), settings.mixer_stage().unwrap(), None).unwrap();
    // What it is late with shall be its own doing; refused, it may be preempted. No memory is locked, as page faults
    // are wanted.
    let _ = take_stand(loops_cpu(), 90);
    stage::run(TroubledMixer { mixer }, doorbell, station).unwrap();
}

pub fn fly_with_a_troubled_mixer(rig: &Rig) -> Ended {
    let settings = rig.file("troubled.toml");
    fs::write(&settings, TROUBLED.to_owned() + "[rt]\nmode = \"off\"\n").unwrap();
    let start = |role: &str| rig.start(role, ["--config", &settings]);
    let mut mixer = Command::new(std::env::current_exe().unwrap());
    mixer.args(["--exact", "troubled_mixer", "--ignored"]);
    mixer
        .env("IRONBIRD_ROOT", rig.root())
        .env(INSTANCE, &rig.instance);
    let loops = [
        start("plant"),
        start("outer"),
        start("inner"),
        rig.launch(mixer),
    ];
    let recorder = start("record");
    for process in loops {
        process.end().expect(0);
=======
    let mut found = BTreeMap::<&str, BTreeMap<String, u64>>::new();
    let is_named = |found: &BTreeMap<&str, BTreeMap<String, u64>>| {
        PROVOKED
            .iter()
            .all(|(fault, _, class, stage)| found[fault].contains_key(&format!("{class} {stage}")))
    };
    let mut round = 0;
    // Something else may take the processor meanwhile and pass for the cause, but not every time.
    while round < rounds() || (round < 4 && !is_named(&found)) {
        let rig = Rig::new("causes");
        let config = misbehaving(&rig, "fault", 650);
        let settings = fs::read_to_string(&config).unwrap();
        let slow = "[flight]\nslowdown = 10\n";
        fs::write(&config, settings.replace("[flight]\n", slow)).unwrap();
        let faults = PROVOKED.map(|(fault, tick, ..)| format!(" --fault {fault}@tick{tick}"));
        let faults = faults.concat();
        rig.ok(&format!(
            "fly --rt prefer --duration 700ms --config {config}{faults}"
        ));
        let report = rig.report();
        let cases = report["autopsy"]["worst"].as_array().unwrap();
        for (fault, tick, ..) in PROVOKED {
            // The outage begins in that tick or the next ones.
            let is_it = |case: &&Value| (tick..tick + 4).contains(&case["tick"].as_u64().unwrap());
            let case = cases.iter().find(is_it);
            let cause = case.map_or("not found".into(), |case| {
                let evidence = case["evidence"].as_str().unwrap();
                let is_stop = case["class"] == "stopped_or_dead";
                assert_eq!(evidence.contains("; its process was stopped"), is_stop);
                let [class, stage] = ["class", "stage"].map(|key| case[key].as_str());
                format!("{} {}", class.unwrap(), stage.unwrap_or("-"))
            });
            *found.entry(fault).or_default().entry(cause).or_default() += 1;
        }
        round += 1;
>>>>>>> cb509e3e448f7a2d257018c572fa18d727c5cbc8
    }
    println!("of {round} flights: {found:#?}");
    assert!(is_named(&found), "{found:#?}");
}
