//! The bridge with stand-ins for a firmware that do what a firmware should not, and with Betaflight where it is there.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread::sleep;
use std::time::Duration;

use control_api::Rig;
use control_api::description::{Settings, Value};
use control_api::law::{InnerInput, InnerLaw as _, WrenchSetpoint};
use firmware::bridge::{Bridge, SIGNALS};
use firmware::{Port, betaflight};
use ironbird_law::{Desired, Given, Measured, Reference};
use messages::telemetry::{AnswerOutcome, Telemetry};
use tempfile::TempDir;

const PORT: &Port = &Port {
    why_not_armed: || None,
    ..betaflight::PORT
};

/// Number of the first of three ports that no other stand-in of this process has.
fn number() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    // Processes of tests that run beside each other are unlikely to have the same.
    let first = 20_000 + (std::process::id() % 1000) as u16 * 40;
    first + 4 * NEXT.fetch_add(1, Ordering::Relaxed)
}

/// A stand-in that does something once the throttle is up.
fn stand_in(mode: &str, number: u16) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stand_in");
    let head = format!(
        "#!/usr/bin/env python3\nMODE = '{mode}'\nMOTORS, STATE, REMOTE = range({number}, {number} + 3)\n"
    );
    fs::write(&path, head + include_str!("stand_in.py")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    for file in PORT.cached.unwrap().1 {
        fs::write(folder.path().join(file), "").unwrap();
    }
    (folder, path)
}

fn bridge(executable: PathBuf, number: u16, limit_s: f64) -> Bridge {
    let settings = Settings::new(vec![
        ("port", Value::Number(number.into())),
        ("arming_limit_s", Value::Number(limit_s)),
        // Ten periods of a millisecond, whatever else the machine does.
        ("answer_limit", Value::Number(10.0)),
    ]);
    Bridge::of(PORT, Some(executable), &Rig::default(), &settings)
}

fn input(tick: u64, measured: Measured) -> InnerInput {
    InnerInput {
        tick,
        measured_age: 0,
        wanted_age: 0,
        given_age: 0,
        measured,
        wanted: Desired {
            thrust_n: 5.0,
            attitude_rad: [0.0; 3],
            attitude_rate_rad_s: [0.0; 3],
            attitude_acceleration_rad_s2: [0.0; 3],
            limited: 0,
        },
        reference: Reference::default(),
        given: Given::default(),
    }
}

/// A flight with a stand-in, tick by tick.
struct Flight {
    bridge: Bridge,
    tick: u64,
    telemetry: Telemetry,
    _folder: TempDir,
}

impl Flight {
    fn start(mode: &str) -> Self {
        let number = number();
        let (folder, path) = stand_in(mode, number);
        let mut bridge = bridge(path, number, 30.0);
        bridge.start(true).unwrap();
        Self {
            bridge,
            tick: 0,
            telemetry: Telemetry::unknown(15),
            _folder: folder,
        }
    }

    fn next(&mut self, measured: Measured, measured_age: u64) -> WrenchSetpoint {
        sleep(Duration::from_millis(10));
        self.tick += 1;
        let input = InnerInput {
            measured_age,
            ..input(self.tick, measured)
        };
        self.bridge.tick(&input, &mut self.telemetry)
    }

    fn signal(&self, name: &str) -> f64 {
        let place = SIGNALS.iter().position(|it| it.name == name).unwrap();
        self.telemetry.value[place]
    }

    fn outcome(&self) -> AnswerOutcome {
        AnswerOutcome::from_wire(self.signal("answer_outcome") as u64).unwrap()
    }

    /// Flies until a tick has this outcome. A busy machine may need some.
    fn until(&mut self, outcome: AnswerOutcome) -> WrenchSetpoint {
        for _ in 0..500 {
            let wrench = self.next(Measured::default(), 0);
            if self.outcome() == outcome {
                return wrench;
            }
        }
        panic!(
            "no tick was {outcome:?}, but the last one {:?}",
            self.outcome()
        );
    }

    /// Flies until a signal is above 0.
    fn until_above_0(&mut self, name: &str) {
        for _ in 0..500 {
            self.next(Measured::default(), 0);
            if self.signal(name) > 0.0 {
                return;
            }
        }
        panic!("{name} stayed at {}", self.signal(name));
    }
}

#[test]
fn motors_become_the_wrench_of_their_rotors_and_a_tick_without_a_state_asks_nothing() {
    let mut flight = Flight::start("well");
    let wrench = flight.until(AnswerOutcome::Answered);
    let rig = Rig::default();
    let full_n = 4.0 * rig.rotor.f_max(rig.airframe.k());
    for _ in 0..50 {
        flight.next(Measured::default(), 0);
    }
    let hovering = flight.until(AnswerOutcome::Answered);
    assert!(
        (hovering.thrust_n - 0.25 * full_n).abs() < 1e-9 * full_n,
        "{wrench:?}, {hovering:?}"
    );
    assert!(hovering.torque_b_nm.iter().all(|it| it.abs() < 1e-9));
    assert!(flight.signal("answer_latency_us") > 0.0);
    let held = flight.next(Measured::default(), 1);
    assert_eq!(flight.outcome(), AnswerOutcome::NotAsked);
    assert_eq!(held, hovering, "the last motors are held");
}

#[test]
fn rates_and_accelerations_arrive_with_the_signs_of_the_firmware() {
    let mut flight = Flight::start("signs");
    flight.until(AnswerOutcome::Answered);
    // Which motor says it, and by how much; rotors 3, 1, 4, 2 are the firmware's first to fourth.
    for (place, expected) in [(0, 0.6), (1, 0.4), (2, 0.4), (3, 0.4)] {
        let mut measured = Measured::default();
        match place {
            3 => measured.specific_force_b_m_s2[0] = 10.0,
            axis => measured.rate_b_rad_s[axis] = 1.0,
        }
        let mut found = 0.0;
        for _ in 0..50 {
            flight.next(measured, 0);
            found = flight.signal(["motor_3", "motor_1", "motor_4", "motor_2"][place]);
            if flight.outcome() == AnswerOutcome::Answered && (found - expected).abs() < 1e-6 {
                break;
            }
        }
        assert!(
            (found - expected).abs() < 1e-6,
            "number {place}: {found}, expected {expected}"
        );
    }
}

#[test]
fn a_late_answer_is_counted_when_it_comes() {
    let mut flight = Flight::start("late");
    flight.until(AnswerOutcome::Silent);
    flight.until_above_0("answers_late");
}

#[test]
fn a_second_answer_is_counted() {
    Flight::start("twice").until_above_0("answers_repeated");
}

#[test]
fn answers_of_another_size_without_numbers_or_none_are_told_apart_and_the_motors_are_held() {
    for (mode, outcome) in [
        ("short", AnswerOutcome::WrongSize),
        ("nan", AnswerOutcome::NotFinite),
        ("silent", AnswerOutcome::Silent),
    ] {
        let mut flight = Flight::start(mode);
        let wrench = flight.until(outcome);
        assert!(wrench.thrust_n > 0.0, "{mode}: {wrench:?}");
        assert_eq!(flight.signal("firmware_disarmed"), 0.0, "{mode}");
    }
}

#[test]
fn a_firmware_that_ends_stops_the_motors_and_its_status_is_shown() {
    let mut flight = Flight::start("dies");
    let wrench = flight.until(AnswerOutcome::Ended);
    assert_eq!(wrench.thrust_n, 0.0);
    assert_eq!(flight.signal("firmware_exit_status"), 7.0);
    assert_eq!(flight.signal("firmware_disarmed"), 0.0, "it has ended");
}

#[test]
fn motors_off_with_the_throttle_up_is_disarmed() {
    Flight::start("disarms").until_above_0("firmware_disarmed");
}

#[test]
fn a_firmware_that_cannot_fly_is_refused_with_the_reason() {
    let started = |mode: &str, limit_s: f64| {
        let number = number();
        let (_folder, path) = stand_in(mode, number);
        let mut bridge = bridge(path, number, limit_s);
        bridge.start(true).unwrap_err().to_string()
    };
    let said = started("fails", 1.0);
    assert!(
        said.contains("ended as it started: exit status: 1"),
        "{said}"
    );
    assert!(said.ends_with("it cannot read its settings"), "{said}");
    let said = started("never", 1.0);
    assert!(
        said.contains("has not armed within 1 s: it does not say why"),
        "{said}"
    );
    let said = started("mute", 1.0);
    assert!(
        said.contains("was started 3 times and sent no motor commands"),
        "{said}"
    );
}

#[test]
fn one_flight_at_a_time_has_a_firmware() {
    let number = number();
    let (_folder, path) = stand_in("well", number);
    let make = || bridge(path.clone(), number, 30.0);
    let mut first = make();
    first.start(true).unwrap();
    let said = make().start(true).unwrap_err().to_string();
    assert!(said.contains("is in use by another flight"), "{said}");
    drop(first);
    make().start(true).unwrap();
}

#[test]
fn betaflight_arms_and_turns_its_motors() {
    let mut bridge = match Bridge::new(&betaflight::PORT, &Rig::default(), &Settings::default()) {
        Ok(bridge) => bridge,
        Err(why) => {
            eprintln!("skipped: {why}");
            return;
        }
    };
    bridge.start(false).unwrap();
    let mut telemetry = Telemetry::unknown(15);
    let mut measured = Measured::default();
    measured.specific_force_b_m_s2[2] = 9.8;
    let thrusts: Vec<f64> = (0..300)
        .map(|tick| bridge.tick(&input(tick, measured), &mut telemetry).thrust_n)
        .collect();
    assert!(thrusts[299] > 2.0, "{:?}", &thrusts[290..]);
    // Nose down is a positive pitch: the front rotors, 3 and 4, pull up.
    measured.attitude_quaternion = [0.995, 0.0, 0.0998, 0.0];
    let mut torque = [0.0; 3];
    for tick in 300..350 {
        torque = bridge
            .tick(&input(tick, measured), &mut telemetry)
            .torque_b_nm;
    }
    assert!(torque[1] < -1e-3, "pitch: {torque:?}");
    // Right side down is a positive roll: the right rotors, 2 and 3, pull up.
    measured.attitude_quaternion = [0.995, 0.0998, 0.0, 0.0];
    for tick in 350..500 {
        torque = bridge
            .tick(&input(tick, measured), &mut telemetry)
            .torque_b_nm;
    }
    assert!(torque[0] < -1e-3, "roll: {torque:?}");
    measured.attitude_quaternion = [1.0, 0.0, 0.0, 0.0];
    measured.rate_b_rad_s[2] = 1.0;
    for tick in 500..700 {
        torque = bridge
            .tick(&input(tick, measured), &mut telemetry)
            .torque_b_nm;
    }
    assert!(torque[2] < -1e-4, "yaw: {torque:?}");
}
