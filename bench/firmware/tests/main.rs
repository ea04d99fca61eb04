//! The bridge with stand-ins for a firmware that do what a firmware should not, and with Betaflight where it is there.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]

use std::fs;
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread::sleep;
use std::time::Duration;

use control_api::Rig;
use control_api::description::{Settings, Value};
use control_api::law::{InnerInput, InnerLaw as _, WrenchSetpoint};
use firmware::bridge::{Bridge, SIGNALS};
use firmware::{Port, ardupilot, betaflight};
use ironbird_law::{Desired, Given, Measured, Reference};
use messages::attitude::Attitude;
use messages::telemetry::{AnswerOutcome, Telemetry};
use nalgebra::Vector3;
use sim::simulator::Simulator;
use tempfile::TempDir;

const BETAFLIGHT: &Port = &Port {
    why_not_armed: || None,
    ..betaflight::PORT
};

/// Firmwares that fly a mode of their own.
const LOCKSTEP: &[&Port] = &[
    &ardupilot::PORT,
    #[cfg(feature = "mavlink")]
    &firmware::px4::PORT,
];

fn ports() -> impl Iterator<Item = &'static Port> {
    [BETAFLIGHT].into_iter().chain(LOCKSTEP.iter().copied())
}

/// Number of the first of three ports that no other stand-in of this process has.
fn number() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    // Processes of tests that run beside each other are unlikely to have the same.
    let first = 20_000 + (std::process::id() % 200) as u16 * 200;
    first + 4 * NEXT.fetch_add(1, Ordering::Relaxed)
}

/// A stand-in that does something once the vehicle is to fly.
fn stand_in(port: &Port, mode: &str, number: u16) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stand_in");
    let text = match port.is_lockstep {
        true => include_str!("lockstep.py"),
        false => include_str!("stand_in.py"),
    };
    let name = port.description.name;
    let head =
        format!("#!/usr/bin/env python3\nFIRMWARE, MODE, NUMBER = '{name}', '{mode}', {number}\n");
    fs::write(&path, head + include_str!("answers.py") + text).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    for file in port.cached.map_or(&[][..], |(_, files)| files) {
        fs::write(folder.path().join(file), "").unwrap();
    }
    (folder, path)
}

fn bridge(port: &'static Port, executable: Option<PathBuf>, number: u16, limit_s: f64) -> Bridge {
    let settings = Settings::new(vec![
        ("port", Value::Number(number.into())),
        ("arming_limit_s", Value::Number(limit_s)),
        // Ten periods of a millisecond, whatever else the machine does.
        ("answer_limit", Value::Number(10.0)),
    ]);
    Bridge::of(port, executable, &Rig::default(), &settings)
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
    number: u16,
    tick: u64,
    telemetry: Telemetry,
    _folder: TempDir,
}

impl Flight {
    fn start(port: &'static Port, mode: &str) -> Self {
        let number = number();
        let (folder, path) = stand_in(port, mode, number);
        let mut bridge = bridge(port, Some(path), number, 30.0);
        bridge.start(true).unwrap();
        Self {
            bridge,
            number,
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

    /// Flies until a tick has this outcome.
    fn until(&mut self, outcome: AnswerOutcome) -> WrenchSetpoint {
        self.until_it(Measured::default(), |it| it.outcome() == outcome)
    }

    fn until_above_0(&mut self, name: &str) {
        self.until_it(Measured::default(), |it| it.signal(name) > 0.0);
    }

    /// Flies with a measurement until a tick is as wanted. A busy machine may need some.
    fn until_it(
        &mut self,
        measured: Measured,
        is_wanted: impl Fn(&Self) -> bool,
    ) -> WrenchSetpoint {
        for _ in 0..500 {
            let wrench = self.next(measured, 0);
            if is_wanted(self) {
                return wrench;
            }
        }
        panic!("no tick was as wanted: {:?}", self.telemetry.value);
    }
}

#[test]
fn motors_become_the_wrench_of_their_rotors_and_a_tick_without_a_state_asks_nothing() {
    let mut flight = Flight::start(BETAFLIGHT, "well");
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
    // Numbers that the firmware gets for a rate of 1 rad/s about each axis and 10 m/s^2 ahead; rotors 3, 1, 4, 2 are its
    // first to fourth.
    for (port, ahead) in ports().map(|port| (port, if port.is_lockstep { 0.6 } else { 0.4 })) {
        let mut flight = Flight::start(port, "signs");
        flight.until(AnswerOutcome::Answered);
        for (place, expected) in [(0, 0.6), (1, 0.4), (2, 0.4), (3, ahead)] {
            let mut measured = Measured::default();
            match place {
                3 => measured.specific_force_b_m_s2[0] = 10.0,
                axis => measured.rate_b_rad_s[axis] = 1.0,
            }
            let motor = ["motor_3", "motor_1", "motor_4", "motor_2"][place];
            flight.until_it(measured, |it| (it.signal(motor) - expected).abs() < 1e-3);
        }
    }
}

#[test]
fn attitudes_and_places_arrive_in_ned() {
    let mut flight = Flight::start(&ardupilot::PORT, "well");
    flight.until(AnswerOutcome::Answered);
    for (tilt_rad, place_m, more, less) in [
        // Right side down, nose down: the rotors there pull up.
        ([0.1, 0.0, 0.0], [0.0; 3], [2, 3], [1, 4]),
        ([0.0, 0.1, 0.0], [0.0; 3], [3, 4], [1, 2]),
        // Nose to the left: the rotors that turn counter-clockwise turn it back.
        ([0.0, 0.0, 0.1], [0.0; 3], [2, 4], [1, 3]),
        // Too far ahead: nose up. Too far to the left: left side up.
        ([0.0; 3], [1.0, 0.0, 0.0], [3, 4], [1, 2]),
        ([0.0; 3], [0.0, 1.0, 0.0], [1, 4], [2, 3]),
    ] {
        let measured = Measured {
            attitude_quaternion: Attitude::of_euler(&tilt_rad.into()).wxyz(),
            position_w_m: place_m,
            ..Measured::default()
        };
        flight.until_it(measured, |flight| {
            let motors = |of: [u8; 2]| of.map(|it| flight.signal(&format!("motor_{it}")));
            let (more, less) = (motors(more), motors(less));
            more.iter().all(|more| less.iter().all(|less| more > less))
        });
    }
}

#[test]
fn a_firmware_that_the_user_starts_hovers_by_its_sensors() {
    for (port, period_s) in LOCKSTEP.iter().zip([0.001, 0.004]) {
        let (number, name) = (number(), port.description.name);
        let (_folder, path) = stand_in(port, "well", number);
        let mut stand_in = Command::new(path).spawn().unwrap();
        let text = format!(
            "flight = {{ trajectory = \"hover\", duration_s = 12.0, period_s = {period_s} }}\n\
             ground = {{ contact = \"plane\" }}\ninner = {{ law = \"{name}\", port = {number} }}"
        );
        let settings = config::Settings::of(toml::from_str(&text).unwrap(), &Vec::new()).unwrap();
        let mut rig = Simulator::of(&settings).unwrap();
        rig.start().unwrap();
        let mut largest_m = 0.0_f64;
        for tick in 0..=settings.last_tick() {
            rig.tick();
            let position = Vector3::from(rig.state().truth.position_w_m);
            if tick as f64 * period_s > 8.0 {
                largest_m = largest_m.max((position - Vector3::z()).norm());
            }
        }
        stand_in.kill().unwrap();
        stand_in.wait().unwrap();
        assert!(largest_m < 0.1, "{name}: {largest_m} m");
    }
}

#[test]
fn answers_that_are_late_or_repeated_and_motors_that_are_off_are_counted() {
    for (mode, signal) in [
        ("late", "answers_late"),
        ("twice", "answers_repeated"),
        ("disarms", "firmware_disarmed"),
    ] {
        ports().for_each(|port| Flight::start(port, mode).until_above_0(signal));
    }
}

#[test]
fn an_answer_whose_number_has_come_before_is_counted_and_not_flown() {
    for port in LOCKSTEP {
        let mut flight = Flight::start(port, "old");
        flight.until_above_0("answers_repeated");
        flight.until(AnswerOutcome::Silent);
    }
}

#[test]
fn answers_of_another_size_without_numbers_or_none_are_told_apart_and_the_motors_are_held() {
    for (port, (mode, outcome)) in ports().flat_map(|port| {
        let cases = [
            ("short", AnswerOutcome::WrongSize),
            ("nan", AnswerOutcome::NotFinite),
            ("silent", AnswerOutcome::Silent),
        ];
        cases.map(|case| (port, case))
    }) {
        let outcome = match (port.description.name, mode) {
            // Its numbers are whole.
            ("ardupilot-json", "nan") => continue,
            // Bytes between messages are skipped.
            ("px4-hil", "short") => AnswerOutcome::Silent,
            _ => outcome,
        };
        let mut flight = Flight::start(port, mode);
        let wrench = flight.until(outcome);
        assert!(wrench.thrust_n > 0.0, "{mode}: {wrench:?}");
        assert_eq!(flight.signal("firmware_disarmed"), 0.0, "{mode}");
    }
}

#[test]
fn another_program_cannot_answer() {
    for port in [BETAFLIGHT, &ardupilot::PORT] {
        let mut flight = Flight::start(port, "silent");
        flight.until(AnswerOutcome::Silent);
        let forger = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..20 {
            // Of a length that neither has.
            let to = ("127.0.0.1", flight.number);
            assert_eq!(forger.send_to(&[0; 100], to).unwrap(), 100);
            flight.next(Measured::default(), 0);
            assert_eq!(flight.outcome(), AnswerOutcome::Silent);
        }
    }
}

#[test]
fn a_firmware_that_ends_stops_the_motors_and_its_status_is_shown() {
    for port in ports() {
        let mut flight = Flight::start(port, "dies");
        let wrench = flight.until(AnswerOutcome::Ended);
        assert_eq!(wrench.thrust_n, 0.0);
        flight.until_it(Measured::default(), |it| {
            it.signal("firmware_exit_status") == 7.0
        });
        assert_eq!(flight.signal("firmware_disarmed"), 0.0, "it has ended");
    }
}

#[test]
fn a_firmware_that_cannot_fly_is_refused_with_the_reason() {
    for port in ports() {
        let started = |mode: &str, limit_s: f64| {
            let number = number();
            let (_folder, path) = stand_in(port, mode, number);
            let mut bridge = bridge(port, Some(path), number, limit_s);
            bridge.start(true).unwrap_err().to_string()
        };
        let said = started("fails", 30.0);
        assert!(
            said.contains("ended as it started: exit status: 1"),
            "{said}"
        );
        assert!(said.ends_with("it cannot read its settings"), "{said}");
        let said = started("never", 5.0);
        assert!(
            said.contains("has not armed within 5 s: it does not say why"),
            "{said}"
        );
        let said = started("mute", 1.0);
        assert!(said.contains("sent no motor commands within"), "{said}");
        let number = number();
        let said = bridge(port, None, number, 0.1)
            .start(true)
            .unwrap_err()
            .to_string();
        let none = format!("no firmware has connected to port {number}");
        assert!(said.contains(&none), "{said}");
    }
}

#[test]
fn betaflight_s_states_have_the_times_of_sending_as_stamps() {
    let mut flight = Flight::start(BETAFLIGHT, "steps");
    // The first step is that from the vehicle at rest.
    flight.until(AnswerOutcome::Answered);
    flight.until(AnswerOutcome::Answered);
    // Ticks of 1 ms are flown every 10 ms or later; a motor command is 20 times the step in seconds.
    let step_s = flight.signal("motor_1") / 20.0;
    assert!((0.01..=0.0151).contains(&step_s), "{step_s}");
}

#[test]
fn one_flight_at_a_time_has_a_firmware() {
    for port in ports() {
        let number = number();
        let (_folder, path) = stand_in(port, "well", number);
        let make = || bridge(port, Some(path.clone()), number, 30.0);
        let mut first = make();
        first.start(true).unwrap();
        let said = make().start(true).unwrap_err().to_string();
        let own = format!("(process {})", std::process::id());
        assert!(
            said.contains("is in use by ") && said.contains(&own),
            "{said}"
        );
        let has_port = said.contains("--set inner.port=NUMBER");
        assert_eq!(has_port, port.is_lockstep, "{said}");
        drop(first);
        make().start(true).unwrap();
    }
}

#[test]
fn betaflight_arms_and_turns_its_motors() {
    // As long as can be set: beside other programs it arms late.
    let settings = Settings::new(vec![("arming_limit_s", Value::Number(60.0))]);
    let mut bridge = match Bridge::new(&betaflight::PORT, &Rig::default(), &settings) {
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
    let mut tick = 0;
    let mut fly = |measured, ticks: usize| {
        let fly = |_| {
            tick += 1;
            bridge.tick(&input(tick, measured), &mut telemetry)
        };
        (0..ticks).map(fly).last().unwrap()
    };
    let hovering = fly(measured, 300);
    assert!(hovering.thrust_n > 2.0, "{hovering:?}");
    for (quaternion, yaw_rate_rad_s, ticks, axis, least_nm) in [
        // Nose down is a positive pitch: the front rotors, 3 and 4, pull up.
        ([0.995, 0.0, 0.0998, 0.0], 0.0, 50, 1, 1e-3),
        // Right side down is a positive roll: the right rotors, 2 and 3, pull up.
        ([0.995, 0.0998, 0.0, 0.0], 0.0, 150, 0, 1e-3),
        ([1.0, 0.0, 0.0, 0.0], 1.0, 200, 2, 1e-4),
    ] {
        measured.attitude_quaternion = quaternion;
        measured.rate_b_rad_s[2] = yaw_rate_rad_s;
        let torque = fly(measured, ticks).torque_b_nm;
        assert!(torque[axis] < -least_nm, "{axis}: {torque:?}");
    }
}
