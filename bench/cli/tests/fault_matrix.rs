//! Runs the fault matrix, `fault_matrix.md`: one fault in a real flight a row, and what must become of the flight.
//!
//! `cargo test` runs the first row of each outcome, the gate all rows. `IRONBIRD_ROWS=kill,hang.inner` chooses rows by
//! name, or several by the beginning of their names, and `IRONBIRD_ROUNDS=n` runs each n times, at other instants each time.

use crate::c_laws::harmful;
use crate::restarts::await_begin;
use crate::rig::{
    Ended, Rig, Running, in_parallel, is_gone, lacks_feature, process_of, rounds, send, signal_of,
    table, wait_until,
};
use analysis::outages::OutageCase;
use analysis::schema::FlightStatus;
use messages::role::{ROLES, Role};
use rustix::process::Signal;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;
use std::thread::sleep;
use std::time::Duration;

static ALONE: Mutex<()> = Mutex::new(());

struct Row {
    name: &'static str,
    fault: &'static str,
    at: &'static str,
    flags: &'static str,
    exit: Vec<Option<i32>>,
    outcome: &'static str,
    report: &'static str,
}

fn rows() -> Vec<Row> {
    let row = |[name, fault, at, flags, exit, outcome, report]: [&'static str; 7]| Row {
        name,
        fault,
        at,
        flags,
        exit: exit.split(' ').map(|code| code.parse().ok()).collect(),
        outcome,
        report,
    };
    let rows = table(include_str!("fault_matrix.md"));
    rows.into_iter().map(row).collect()
}

#[test]
fn the_first_row_of_each_outcome() {
    let mut seen = BTreeSet::new();
    let first = rows().into_iter().filter(|row| seen.insert(row.outcome));
    in_parallel(first.collect::<Vec<_>>().into_iter(), |row| row.run(0));
}

#[test]
#[ignore = "long: part of the gate"]
fn every_row() {
    let chosen = std::env::var("IRONBIRD_ROWS").unwrap_or_default();
    let is_name = |one: &str| rows().iter().any(|row| row.name == one);
    let is_it =
        |row: &Row, one: &str| row.name == one || !is_name(one) && row.name.starts_with(one);
    let is_chosen = |row: &Row| chosen.split(',').any(|one| is_it(row, one));
    let run = |row: &Row| (0..rounds()).for_each(|round| row.run(round));
    // Flights with real-time priority follow one another beside the others.
    let (alone, others): (Vec<_>, Vec<_>) = rows()
        .into_iter()
        .filter(is_chosen)
        .partition(Row::is_alone);
    std::thread::scope(|scope| {
        scope.spawn(|| alone.iter().for_each(run));
        in_parallel(others.into_iter(), run);
    });
}

impl Row {
    /// Flights with real-time priority would keep each other from their processor.
    fn is_alone(&self) -> bool {
        self.flags.contains("--rt prefer")
    }

    /// The words of the fault.
    fn fault(&self) -> [&'static str; 3] {
        let mut words = self.fault.split(' ');
        std::array::from_fn(|_| words.next().unwrap_or_default())
    }

    /// Flies with the fault, and demands the outcome.
    fn run(&self, round: u64) {
        let _alone = self.is_alone().then(|| ALONE.lock());
        let [kind, what, _] = self.fault();
        // `_exit` of the C library runs no code of ours: only an instrumented executable has its own.
        if self.fault == "hostile exit" && !cfg!(feature = "instrumented") {
            return lacks_feature("which law called _exit()", "instrumented");
        }
        let rig = match kind {
            "law" | "hostile" => Rig::with_features("matrix"),
            _ => Rig::new("matrix"),
        };
        let mut flags = format!("--trajectory hover {}", self.flags);
        if !flags.contains("--rt") && !flags.contains("lockstep") {
            flags += " --rt off";
        }
        // The airframe does not hit the ground while a stage is missing.
        let config = match kind {
            "law" => harmful(&rig, "misbehaving", what, 300),
            "hostile" => harmful(&rig, "hostile", what, 300),
            _ => rig.slow(1),
        };
        if kind == "plan" {
            flags += &format!(" --fault {what}");
        }
        let flight = rig.start("fly", format!("{flags} --config {config}"));
        let roles = self.inject(&rig, &flight, round);
        let ended = flight.end();
        let what = format!("{}, round {round}: {ended}", self.name);
        assert!(self.exit.contains(&ended.code), "{what}");
        let mut figures = json!({});
        match self.outcome {
            "survived" => figures = self.demand_survived(&rig, &ended),
            "undisturbed" => {
                let report = rig.final_report();
                assert_eq!(report.run.ending, "completed", "{what}");
                assert!(report.deaths.is_empty(), "{what}");
                assert_eq!(ended.result()["lost"], "0", "{what}");
                rig.assert_replayed();
            }
            "masked" => {
                let report = rig.final_report();
                let channels = report.redundancy.as_ref().unwrap();
                let out = channels.outages.iter().map(|it| it.ticks).max();
                // A process may be back within a long tick.
                let out = out.unwrap_or(0);
                assert!(out > 0 || !report.deaths.is_empty(), "{what}");
                figures = json!({"ticks a channel is out": out});
                if !rig.has_stalled() {
                    assert_eq!(channels.ticks_not_fresh, 0, "{what}: {channels:?}");
                    rig.assert_replayed();
                }
            }
            "aborted" => self.demand_aborted(&rig, ended),
            "interrupted" => {
                assert_eq!(ended.result()["status"], "INTERRUPTED", "{what}");
                demand_interrupted(&rig, &what);
            }
            "orphaned" => {
                await_gone(roles);
                demand_interrupted(&rig, &what);
            }
            // The flight may have begun by then.
            "not started" if !ended.stdout.contains("RESULT ") => {
                ended.complains(self.report);
                // Nothing was recorded: the directory of the flight is gone.
                assert_eq!(rig.run_directories(), [""; 0], "{what}");
            }
            "not started" | "ends" => (),
            other => panic!("{}: no outcome {other}", self.name),
        }
        rig.assert_nothing_left();
        if !self.exit.contains(&Some(0)) {
            rig.ok("fly --pace lockstep --duration 50ms");
        }
        // For the drill, which counts them.
        println!("TRIAL {} {figures}", self.name);
    }

    /// Injects the fault at its instant; the processes of the flight by then.
    fn inject(&self, rig: &Rig, flight: &Running, round: u64) -> Vec<u32> {
        let [kind, target, pause_ms] = self.fault();
        if self.at == "-" {
            return Vec::new();
        }
        // No two rounds alike, and each the same in every run of the test.
        let random = (round + 1)
            .wrapping_mul(2_654_435_761)
            .wrapping_add(self.name.len() as u64 * 7919);
        let roles = wait_until("the launcher to start five roles", || {
            let of = |role: Role| Some((role.name(), *rig.processes_of(role.name()).first()?));
            ROLES
                .map(of)
                .into_iter()
                .collect::<Option<BTreeMap<_, _>>>()
        });
        let mut pid = match target {
            "fly" => flight.pid(),
            role => roles[role],
        };
        let instant = self.at.split_once(' ').unwrap_or((self.at, ""));
        match instant {
            ("start", _) => {
                wait_until("the flight's directory", || {
                    (!rig.run_directories().is_empty()).then_some(())
                });
                sleep(Duration::from_millis(random % 300));
            }
            ("landing", _) => {
                rig.await_tick(0);
                flight.signal(Signal::INT);
                sleep(Duration::from_micros(random % 10_000));
                // Its supervisor waits for it: the number is its own until the supervisor has ended.
                if is_gone(pid) {
                    return Vec::new();
                }
            }
            ("report", _) => rig.await_report(),
            ("tick", tick) => {
                let mut run = rig.await_tick(0);
                // Anywhere within the tick.
                run.t0_ns += random % run.period_ns;
                await_begin(&run, tick.parse::<u64>().unwrap() + random % 100);
                // Another process may have taken its place by then.
                if let Some(role) = ROLES.into_iter().find(|role| role.name() == target) {
                    pid = rig.known().pid_of(role).unwrap();
                }
            }
            _ => panic!("{}: no instant {}", self.name, self.at),
        }
        let is_pause = kind == "pause";
        send(pid, signal_of(if is_pause { "STOP" } else { kind }));
        if is_pause {
            sleep(Duration::from_millis(pause_ms.parse().unwrap()));
            send(pid, Signal::CONT);
        }
        roles.into_values().collect()
    }

    /// The stage came back, and the report says what that cost.
    fn demand_survived(&self, rig: &Rig, ended: &Ended) -> serde_json::Value {
        let report = rig.final_report();
        let [death] = &report.deaths[..] else {
            panic!("{}: {:?}", self.name, report.deaths)
        };
        let role = &death.role;
        assert!(self.fault.contains(role), "{}: {death:?}", self.name);
        let words = ["", "was "].map(|was| format!("the {role} process {was}{}", self.report));
        assert!(words.iter().any(|it| ended.stderr.contains(it)), "{ended}");
        assert_eq!(ended.result()["deaths"], "1", "{ended}");
        let line = format!("\nDeaths    {role} at tick ");
        assert!(ended.stdout.contains(&line), "{ended}");
        let costs = [
            death.noticed_after_ms,
            death.back_after_ms,
            death.position_error_max_m,
            death.ticks_lost.map(|ticks| ticks as f64),
        ];
        let [noticed, back, error, ticks] = costs.map(|it| it.filter(|it| *it > 0.0).unwrap());
        assert!(death.epoch > 0, "{death:?}");
        // The tick counter stands still for that long before the process is killed.
        assert!(!self.fault.starts_with("STOP") || noticed > 80.0);
        let is_named = |case: &OutageCase| {
            case.stage.as_ref() == Some(role) && case.evidence.contains("has ended")
        };
        let causes = &report.autopsy;
        assert!(
            causes.worst.iter().any(is_named),
            "{}",
            render::outages::text(causes)
        );
        assert!(
            rig.flown("report.html")
                .contains(&render::flight::failure_line(death))
        );
        rig.assert_replayed();
        json!({"ticks lost": ticks, "ms back": back, "ms noticed": noticed, "m error": error})
    }

    /// The flight ended, and the report and the last words say why.
    fn demand_aborted(&self, rig: &Rig, ended: Ended) {
        let result = ended.result();
        assert_eq!(result["status"], "ABORTED", "{}: {ended}", self.name);
        let report = rig.final_report();
        assert_eq!(report.verdict.exit_code, 1, "{}", self.name);
        let [kind, target, _] = self.fault();
        let role = match kind {
            "law" | "hostile" => "inner",
            _ => target.split('.').next().unwrap(),
        };
        let ending = &report.run.ending;
        let process = format!("the {}", process_of(role));
        assert!(ending.contains(&process), "{}: {ending}", self.name);
        if kind == "KILL" || self.flags.contains("restart") {
            let deaths = &report.deaths;
            assert!(deaths.iter().any(|death| death.role == role), "{deaths:?}");
        }
        if target == "plant" {
            assert_ne!(result["timing"], "in-time", "{ended}");
            // What the stages do after the end of the plant is not part of the flight.
            let ticks = report.ticks.run + report.ticks.skipped;
            for name in ["loop", "wake.inner", "wake.mixer", "compute.mixer"] {
                let count = report.series(name).map_or(0, |series| series.count);
                assert!(count <= ticks, "{name}: {count} of {ticks} ticks");
            }
        }
        if !ending.contains(self.report) {
            ended.complains(self.report);
        }
    }
}

pub(crate) fn await_gone(pids: impl IntoIterator<Item = u32>) {
    for pid in pids {
        wait_until(&format!("process {pid} to end"), || {
            is_gone(pid).then_some(())
        });
    }
}

/// The flight ended in order: every loop landed, the report is final, the log whole.
pub(crate) fn demand_interrupted(rig: &Rig, what: &str) {
    let report = rig.final_report();
    assert_eq!(report.verdict.status, FlightStatus::Interrupted, "{what}");
    for role in ["plant", "outer", "inner", "mixer"] {
        assert!(report.roles[role].landed, "{role}: {what}");
    }
    for file in ["report.html", "report.txt", "flight.svg"] {
        assert!(
            rig.out().join("latest").join(file).exists(),
            "{file}: {what}"
        );
    }
    let replayed = rig.ok("replay --verify");
    assert!(!replayed.stderr.contains("truncated"), "{what}: {replayed}");
}
