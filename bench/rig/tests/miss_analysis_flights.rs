//! Root causes of missed deadlines in real flights, whose stages are stopped, killed or kept waiting.

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
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::thread::sleep;
use std::time::Duration;

/// Outages of a class in the report, with the deadlines missed in them; every missed deadline belongs to one.
fn counted(rig: &Rig, class: &str, stage: Option<&str>) -> (u64, u64) {
    let report = rig.report();
    let classes = report["autopsy"]["classes"].as_array().unwrap();
    let sum: u64 = classes
        .iter()
        .map(|it| it["missed"].as_u64().unwrap())
        .sum();
    assert_eq!(
        sum,
        report["deadlines"]["missed"].as_u64().unwrap(),
        "{}",
        report["autopsy"]
    );
    let of_class = classes
        .iter()
        .filter(|it| it["class"] == class && it["stage"].as_str() == stage);
    of_class.fold((0, 0), |(outages, missed), it| {
        (
            outages + it["outages"].as_u64().unwrap(),
            missed + it["missed"].as_u64().unwrap(),
        )
    })
}

#[test]
#[ignore = "long: part of the gate"]
fn a_stopped_mixer_is_found_and_the_report_says_so() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("stopped");
    // In slow motion, so that what else happens on the machine misses no deadline.
    let flight = rig.take_off(format!("--duration 300ms --config {}", rig.slow(10)));
    await_first_report(&rig);
    stop_for(flight.roles()["mixer"], Duration::from_millis(500));
    let ended = flight.end().expect(0).says("stage stopped or dead, mixer");
    let (outages, missed) = counted(&rig, "stopped_or_dead", Some("mixer"));
    assert_eq!(outages, 1, "{ended}");
    assert!(missed >= 49, "50 ticks of 10 ms: {ended}");
    let case = worst(&rig)
        .into_iter()
        .find(|case| case["class"] == "stopped_or_dead")
        .unwrap();
    assert!(case["ticks"].as_u64().unwrap() >= missed, "{case}");
    assert!(case["delay_us"].as_f64().unwrap() >= 490e3, "{case}");
    assert_eq!(
        case["evidence"].as_str().unwrap().split("; ").nth(1),
        Some("its process was stopped")
    );
    // Ticks around it in which nobody published are not in it.
    assert!(
        (1..=8).contains(&case["timeline"].as_array().unwrap().len()),
        "{case}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_killed_mixer_is_found() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("killed");
    let flight = rig.take_off("--duration 30s");
    await_first_report(&rig);
    let mixer = flight.roles()["mixer"];
    // Else the launcher may end the run before the next command is due.
    flight.signal(Signal::STOP);
    send(mixer, Signal::KILL);
    sleep(Duration::from_millis(30));
    flight.signal(Signal::CONT);
    let ended = flight.end().expect(1);
    assert_eq!(
        counted(&rig, "stopped_or_dead", Some("mixer")).0,
        1,
        "{ended}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_trace_names_who_kept_the_loops_from_their_processor() {
    if process::rt::fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nobody can be sure to keep the loops from their processor");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("traced");
    // In slow motion, so that a stall of the host is no match for it.
    let slow = rig.slow(10);
    let Some(flight) = take_off_traced(&rig, &["--duration", "300ms", "--config", &slow]) else {
        return;
    };
    await_first_report(&rig);
    hog(300 * T);
    let ended = flight.end().expect(0);
    assert!(counted(&rig, "preempted", Some("plant")).1 >= 29, "{ended}");
    let is_hogs = |case: &Value| {
        case["ran"][0]["who"]
            .as_str()
            .is_some_and(|who| who.starts_with("hog ("))
    };
    let case = worst(&rig)
        .into_iter()
        .find(is_hogs)
        .unwrap_or_else(|| panic!("no hog in {ended}"));
    assert!(case["ran"][0]["us"].as_f64().unwrap() >= 250e3, "{case}");
    assert!(case["missed"].as_u64().unwrap() >= 29, "{case}");
}

#[test]
fn a_trace_that_killed_processes_left_is_found_and_removed() {
    let rig = Rig::new("untraced");
    let Some(mut flight) = in_own_mounts(TRACEFS, TRACES, "sh") else {
        return;
    };
    // What killed processes leave: the launcher and the recorder are gone before they could remove it.
    let script = "for s in 0.01 0.02 0.03 0.05 0.08; do
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" > /dev/null 2>&1 & fly=$!
sleep $s; kill -INT $fly; wait $fly; done
ls /sys/kernel/tracing/instances; echo STOPPED
\"$1\" fly --trace --rt off --duration 600s --out \"$2\" --instance \"$3\" & fly=$!
until grep -qs ticks_run \"$2\"/latest/report.json; do sleep 0.05; done
kill -KILL $(pgrep -f -- \"--instance $3\") $fly
sleep 0.2
echo; echo TRIED; \"$1\" clean --dry-run; echo CLEANED; \"$1\" clean; echo AGAIN; \"$1\" clean; ls /sys/kernel/tracing/instances";
    let out = rig.out();
    flight.args([
        "-c",
        script,
        "sh",
        rig::IRONBIRD,
        out.to_str().unwrap(),
        &rig.instance,
    ]);
    flight.env("IRONBIRD_ROOT", rig.root());
    let ended = rig.launch(flight).end().expect(0);
    let (stopped, _) = ended.stdout.split_once("STOPPED").unwrap();
    // Other tests trace, too, under roots of their own.
    let prefix = rig.known().prefix();
    let of_root = prefix.split_inclusive('_').take(2).collect::<String>();
    assert!(
        !stopped.contains(&of_root),
        "who is told to end leaves none: {ended}"
    );
    let (tried, rest) = ended.stdout.split_once("CLEANED").unwrap();
    let (cleaned, again) = rest.split_once("AGAIN").unwrap();
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

#[test]
#[ignore = "long: part of the gate"]
fn loops_that_somebody_keeps_from_the_processor_were_ready_and_not_run() {
    let rig = Rig::new("taken");
    if process::rt::fifo_refusal(99).is_some() {
        not_tested("without SCHED_FIFO nobody can be sure to keep the loops from their processor");
        return;
    }
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    // In slow motion, so that a stall of the host is no match for it.
    let flight = rig.take_off(format!("--duration 300ms --config {}", rig.slow(10)));
    await_first_report(&rig);
    hog(300 * T);
    let ended = flight.end().expect(0);
    // Without a trace, who ran is seen only by what the kernel counts: a virtual machine does not show it surely.
    let missed = ["preempted", "ready_not_run"].map(|class| counted(&rig, class, Some("plant")).1);
    assert!(missed.iter().sum::<u64>() >= 29, "{ended}");
}

/// A group whose processes can be frozen, gone with the test.
struct Freezer(PathBuf);

impl Freezer {
    const ROOT: &str = "/sys/fs/cgroup/freezer";

    /// Nothing where the system has no such groups, or lets nobody make one.
    fn new() -> Option<Self> {
        let path = Path::new(Self::ROOT).join(format!("ironbird-test-{}", std::process::id()));
        fs::create_dir(&path).ok().map(|()| Self(path))
    }

    fn freeze(&self, pids: &[u32], time: Duration) {
        pids.iter()
            .for_each(|pid| fs::write(self.0.join("cgroup.procs"), pid.to_string()).unwrap());
        fs::write(self.0.join("freezer.state"), "FROZEN").unwrap();
        sleep(time);
        fs::write(self.0.join("freezer.state"), "THAWED").unwrap();
        pids.iter().for_each(|pid| {
            fs::write(Path::new(Self::ROOT).join("cgroup.procs"), pid.to_string()).unwrap()
        });
    }
}

impl Drop for Freezer {
    fn drop(&mut self) {
        let _ = fs::write(self.0.join("freezer.state"), "THAWED");
        let _ = fs::remove_dir(&self.0);
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn loops_that_are_frozen_together_look_like_a_stall_and_a_single_one_like_a_late_wake_up() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("frozen");
    let Some(freezer) = Freezer::new() else {
        not_tested(&format!(
            "no group under {} can be made to freeze processes in",
            Freezer::ROOT
        ));
        return;
    };
    // In slow motion, so that what else happens on the machine misses no deadline.
    let slow = rig.slow(10);
    let flight = rig.take_off(format!("--duration 400ms --config {slow}"));
    await_first_report(&rig);
    let roles = flight.roles();
    let loops = ["plant", "outer", "inner", "mixer"].map(|role| roles[role]);
    freezer.freeze(&loops, Duration::from_millis(100));
    sleep(Duration::from_millis(500));
    freezer.freeze(&[roles["mixer"]], Duration::from_millis(100));
    let ended = flight.end().expect(0);
    // Where somebody else has the processor meanwhile, nobody can tell.
    let together = ["processor_stalled", "cannot_tell"].map(|class| counted(&rig, class, None).1);
    assert!(together.iter().sum::<u64>() >= 9, "{ended}");
    let report = rig.report();
    let steps = report["roles"]["mixer"]["realtime"].as_array().unwrap();
    // On a processor of its own, nobody can tell that the mixer alone was frozen.
    if steps
        .iter()
        .any(|step| step["step"] == "affinity" && step["granted"] == true)
    {
        assert!(counted(&rig, "wake_late", Some("mixer")).0 > 0, "{ended}");
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_mixer_that_computes_long_or_faults_and_an_input_that_is_not_heard_are_told_apart() {
    let _alone = PROCESSOR.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new("troubled");
    let ended = fly_with_a_troubled_mixer(&rig);
    // What takes the processor from the mixer meanwhile may pass for the cause, but not every time.
    for (class, stage) in [
        ("computed_long", "mixer"),
        ("page_fault", "mixer"),
        ("not_used", "inner"),
    ] {
        assert!(counted(&rig, class, Some(stage)).0 > 0, "{class}: {ended}");
    }
}

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

const UNKNOWN: [&str; 4] = [
    "cannot_tell",
    "processor_stalled",
    "ready_not_run",
    "wake_late",
];

impl Found {
    /// Looks for an outage of `ticks` between two times of the flight [s]; who is away for as long need not be out in
    /// the one that he leaves in, or in the one that he is back in.
    fn look(
        &mut self,
        cases: &[Value],
        times_s: (f64, f64),
        ticks: u64,
        (class, stage): (&str, &str),
    ) {
        self.caused += 1;
        let is_it = |case: &&Value| {
            let time_s = case["time_s"].as_f64().unwrap();
            (times_s.0..times_s.1).contains(&time_s)
                && case["ticks"].as_u64().unwrap() >= ticks.saturating_sub(1).max(1)
        };
        let Some(case) = cases.iter().find(is_it) else {
            let told = |case: &Value| format!("{} s: {} ticks", case["time_s"], case["ticks"]);
            println!(
                "not found at {times_s:?} s: {:?}",
                cases.iter().map(told).collect::<Vec<_>>()
            );
            return;
        };
        self.whole += 1;
        let said = (
            case["class"].as_str().unwrap(),
            case["stage"].as_str().unwrap_or("-"),
        );
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
    wire.blackboard_reader::<Run>(RUN)
        .unwrap()
        .unwrap()
        .get()
        .t0_ns
}

/// Stops each stage in turn for so long, in one flight.
fn stop_each(found: &mut BTreeMap<String, Found>, slowdown: u64, lengths_ms: &[u64]) {
    let rig = Rig::new("causes");
    let stops = || {
        STAGES
            .into_iter()
            .flat_map(|stage| lengths_ms.iter().map(move |ms| (stage, *ms)))
    };
    let pause = Duration::from_millis(700);
    // The first report may come a second late.
    let wall_ms = 2000 + stops().map(|(_, ms)| ms + 700).sum::<u64>() + 1000;
    let duration = format!("{}ms", wall_ms / slowdown);
    let flight = rig.take_off(format!(
        "--trajectory hover --duration {duration} --config {}",
        rig.slow(slowdown)
    ));
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
        let of = found
            .entry(format!(
                "{stage} stopped for {ms} ms, ticks of {slowdown} ms"
            ))
            .or_default();
        of.look(
            &cases,
            times_s,
            ms / slowdown,
            ("stopped_or_dead", stage.name()),
        );
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
    }
    recorder.end()
}
