//! Runs the fault matrix, `fault_matrix.md`: one fault in a real flight a row, and what must become of the flight.
//!
//! `cargo test` runs the first row of each outcome, the gate all rows. `IRONBIRD_ROUNDS=n` runs each row n times, at other
//! instants each time.

use crate::c_laws::{hostile, misbehaving};
use crate::restarts::{assert_replayed, report, strike};
use crate::rig::{
    Ended, Rig, Running, in_parallel, is_gone, lacks_feature, process_of, rounds, send, table,
    wait_until,
};
use messages::role::ROLES;
use report::outages::OutageCase;
use report::status::FlightStatus;
use rustix::process::Signal;
use std::fs;
use std::thread::sleep;
use std::time::Duration;

struct Row {
    name: &'static str,
    fault: &'static str,
    at: &'static str,
    flags: &'static str,
    exit: Vec<Option<i32>>,
    outcome: &'static str,
    report: &'static str,
}

fn rows(outcome: &str) -> Vec<Row> {
    let row = |[name, fault, at, flags, exit, outcome, report]: [&'static str; 7]| Row {
        name,
        fault,
        at,
        flags,
        exit: exit.split(' ').map(|code| code.parse().ok()).collect(),
        outcome,
        report,
    };
    let rows = table(include_str!("fault_matrix.md")).into_iter().map(row);
    let rows: Vec<Row> = rows.filter(|row| row.outcome == outcome).collect();
    assert!(!rows.is_empty(), "no row is {outcome}");
    rows
}

impl Row {
    /// The words of the fault.
    fn fault(&self) -> [&'static str; 3] {
        let mut words = self.fault.split(' ');
        std::array::from_fn(|_| words.next().unwrap_or_default())
    }

    fn signal(&self) -> Signal {
        match self.fault()[0] {
            "KILL" => Signal::KILL,
            "STOP" | "pause" => Signal::STOP,
            "TERM" => Signal::TERM,
            "INT" => Signal::INT,
            "HUP" => Signal::HUP,
            "QUIT" => Signal::QUIT,
            other => panic!("{}: no signal {other}", self.name),
        }
    }

    /// Flies with the fault, and demands the outcome.
    fn run(&self, round: u64) {
        let [kind, what, _] = self.fault();
        // `_exit` of the C library runs no code of ours: only an instrumented executable has its own.
        if self.fault == "hostile exit" && !cfg!(feature = "instrumented") {
            return lacks_feature("which law called _exit()", "instrumented");
        }
        let rig = match kind {
            "law" | "hostile" => Rig::with_features("matrix"),
            _ => Rig::new("matrix"),
        };
        // Nobody hits the ground while a stage is missing.
        let (config, plan) = match kind {
            "law" => (misbehaving(&rig, what, 300), String::new()),
            "hostile" => (hostile(&rig, what, 300), String::new()),
            "plan" => (rig.airborne(""), format!("--fault {what}")),
            _ => (rig.airborne(""), String::new()),
        };
        let rt = if self.flags.contains("--rt") || self.flags.contains("lockstep") {
            ""
        } else {
            "--rt off"
        };
        let flags = format!(
            "--trajectory hover {} {rt} --config {config} {plan}",
            self.flags
        );
        let flight = rig.start("fly", &flags);
        let roles = self.inject(&rig, &flight, round);
        let ended = flight.end();
        let what = format!("{}, round {round}: {ended}", self.name);
        assert!(self.exit.contains(&ended.code), "{what}");
        match self.outcome {
            "survived" => self.demand_survived(&rig, &ended),
            "undisturbed" => {
                let report = report(&rig);
                assert_eq!(report.run.ending, "completed", "{what}");
                assert!(report.deaths.is_empty(), "{what}");
                assert_eq!(ended.result()["lost"], "0", "{what}");
                assert_replayed(&rig);
            }
            "aborted" => self.demand_aborted(&rig, ended),
            "interrupted" => {
                assert_eq!(ended.result()["status"], "INTERRUPTED", "{what}");
                demand_interrupted(&rig, &what);
            }
            "orphaned" => {
                await_gone(roles);
                demand_interrupted(&rig, &what);
                let next = rig.ok("fly --pace lockstep --duration 50ms");
                assert_eq!(next.result()["status"], "PASS", "{what}: {next}");
            }
            // Somebody may have been in the air by then.
            "not started" if !ended.stdout.contains("RESULT ") => {
                ended.complains(self.report);
                assert!(rig.out().join("latest").read_link().is_err(), "{what}");
            }
            "not started" | "ends" => (),
            other => panic!("{}: no outcome {other}", self.name),
        }
        rig.assert_nothing_left();
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
        let roles = flight.roles();
        let mut pid = match target {
            "fly" => flight.pid(),
            role => roles[role],
        };
        match self.at.split(' ').collect::<Vec<_>>()[..] {
            ["start"] => {
                wait_until("the flight's directory", || {
                    (!rig.run_directories().is_empty()).then_some(())
                });
                sleep(Duration::from_millis(random % 300));
                send(pid, self.signal());
            }
            ["landing"] => {
                rig.await_tick(0);
                flight.signal(Signal::INT);
                sleep(Duration::from_micros(random % 10_000));
                // Its launcher waits for it: the number is its own until the launcher has ended.
                if !is_gone(pid) {
                    send(pid, Signal::KILL);
                }
            }
            ["report"] => {
                rig.await_report();
                send(pid, self.signal());
            }
            ["tick", tick] => {
                let mut run = rig.await_tick(0);
                // Anywhere within the tick.
                run.t0_ns += random % run.period_ns;
                let tick = tick.parse::<u64>().unwrap() + random % 100;
                match ROLES.into_iter().find(|role| role.name() == target) {
                    Some(role) => {
                        pid = strike(rig, &run, tick, role, self.signal());
                    }
                    None => {
                        rig.await_tick(tick);
                        flight.signal(self.signal());
                    }
                }
            }
            _ => panic!("{}: no instant {}", self.name, self.at),
        }
        if kind == "pause" {
            sleep(Duration::from_millis(pause_ms.parse().unwrap()));
            send(pid, Signal::CONT);
        }
        roles.into_values().collect()
    }

    /// The stage came back, and the report says what that cost.
    fn demand_survived(&self, rig: &Rig, ended: &Ended) {
        let report = report(rig);
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
        ];
        assert!(
            costs.iter().all(|it| it.is_some_and(|it| it > 0.0)),
            "{death:?}"
        );
        assert!(
            death.epoch > 0 && death.ticks_lost.unwrap() > 0,
            "{death:?}"
        );
        if self.fault().starts_with(&["STOP"]) {
            // The heartbeat stands still for that long before anybody is killed.
            assert!(death.noticed_after_ms.unwrap() > 80.0, "{death:?}");
        }
        let is_named = |case: &OutageCase| {
            case.stage.as_ref() == Some(role) && case.evidence.contains("has ended, and process ")
        };
        let autopsy = &report.autopsy;
        assert!(autopsy.worst.iter().any(is_named), "{}", autopsy.text());
        let page = fs::read_to_string(rig.out().join("latest/report.html")).unwrap();
        assert!(page.contains(&death.line()), "{}", death.line());
        assert_replayed(rig);
    }

    /// The flight ended, and the report and the last words say why.
    fn demand_aborted(&self, rig: &Rig, ended: Ended) {
        let status = &ended.result()["status"];
        assert_eq!(status, "ABORTED", "{}: {ended}", self.name);
        let report = report(rig);
        assert_eq!(report.verdict.exit_code, 1, "{}", self.name);
        let [kind, target, _] = self.fault();
        let role = match kind {
            "law" | "hostile" => "inner",
            _ => target.split('.').next().unwrap(),
        };
        let ending = &report.run.ending;
        let process = format!("the {}", process_of(role));
        assert!(ending.contains(&process), "{}: {ending}", self.name);
        if self.fault.starts_with("KILL") || self.flags.contains("restart") {
            let deaths = &report.deaths;
            assert!(deaths.iter().any(|death| death.role == role), "{deaths:?}");
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
    let report = report(rig);
    assert_eq!(report.verdict.status, FlightStatus::Interrupted, "{what}");
    assert!(!report.run.in_flight, "{what}");
    for role in ["plant", "outer", "inner", "mixer"] {
        assert!(report.roles[role].landed, "{role}: {what}");
    }
    for file in ["report.html", "report.txt", "flight.svg"] {
        assert!(
            rig.out().join("latest").join(file).exists(),
            "no {file}: {what}"
        );
    }
    let replayed = rig.ok("replay --verify");
    assert!(!replayed.stderr.contains("truncated"), "{what}: {replayed}");
}

fn run_first(outcome: &str) {
    rows(outcome)[0].run(0);
}

fn run_all(outcome: &str) {
    in_parallel(rows(outcome).into_iter(), |row| {
        (0..rounds()).for_each(|round| row.run(round))
    });
}

#[test]
fn a_stage_that_is_killed_comes_back() {
    run_first("survived");
}

#[test]
fn a_stage_that_is_paused_flies_on() {
    run_first("undisturbed");
}

#[test]
fn a_flight_without_its_plant_ends_and_says_why() {
    run_first("aborted");
}

#[test]
fn a_signal_ends_a_flight_in_order() {
    run_first("interrupted");
}

#[test]
fn a_flight_whose_supervisor_is_killed_ends_in_order() {
    run_first("orphaned");
}

#[test]
fn a_process_that_is_killed_before_the_flight_is_named() {
    run_first("not started");
}

#[test]
#[ignore = "long: part of the gate"]
fn every_row_is_survived_that_can_be() {
    run_all("survived");
    run_all("undisturbed");
}

#[test]
#[ignore = "long: part of the gate"]
fn every_row_is_named_that_ends_a_flight() {
    run_all("aborted");
}

#[test]
#[ignore = "long: part of the gate"]
fn every_row_ends_in_order_that_is_asked_to() {
    run_all("interrupted");
    run_all("orphaned");
    run_all("ends");
}

#[test]
#[ignore = "long: part of the gate"]
fn every_row_that_does_not_start_is_named() {
    run_all("not started");
}
