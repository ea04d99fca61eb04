//! Firmwares that fly their own mode, with stand-ins written from the sources that the ports name: they wait for a
//! state, hover 1 m above their start by it, and do what a firmware should not.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![cfg(feature = "mavlink")]

use std::io::Write as _;
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use config::Settings;
use control_api::Rig;
use control_api::description::{self, Value};
use control_api::law::{InnerInput, InnerLaw as _};
use firmware::bridge::{Bridge, LOCKSTEP_SIGNALS};
use firmware::{Port, ardupilot, px4};
use ironbird_law::{Desired, Given, Measured, Reference};
use mavlink::dialects::common::*;
use mavlink::{MavHeader, MavlinkReader};
use messages::attitude::Attitude;
use messages::ned::{ORIGIN, turned, turned_quaternion};
use messages::telemetry::{AnswerOutcome, Telemetry};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sim::simulator::Simulator;

type Vector = Vector3<f64>;

/// What a stand-in knows: body FRD in a world NED.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    attitude: UnitQuaternion<f64>,
    rate: Vector,
    force: Vector,
    position: Vector,
    velocity: Vector,
}

/// A stand-in's side of the packets.
trait Wire: Send {
    /// Sends motors in the firmware's order, from 0 to 1; `number` is of the state that they answer.
    fn send(&mut self, motors: [f64; 4], number: u64);
    /// A packet that is no answer.
    fn send_short(&mut self);
    /// The next state and its number; none if there is none for a while. An error once the flight is over.
    fn receive(&mut self) -> Result<Option<(Known, u64)>, ()>;
}

struct Json {
    socket: UdpSocket,
    to: u16,
    frame: u64,
}

impl Json {
    fn new(to: u16) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let wait = Some(Duration::from_millis(20));
        socket.set_read_timeout(wait).unwrap();
        Self {
            socket,
            to,
            frame: 0,
        }
    }

    fn packet(&self, motors: [f64; 4], frame: u64) -> Vec<u8> {
        let mut channels = [1500_u16; 16];
        for (channel, motor) in channels.iter_mut().zip(motors) {
            // ArduPilot has no number that is not one.
            *channel = (1000.0 + 1000.0 * motor).round() as u16;
        }
        let frame = frame as u32;
        let head = [18_458, 400, frame as u16, (frame >> 16) as u16];
        head.iter()
            .chain(&channels)
            .flat_map(|it| it.to_le_bytes())
            .collect()
    }
}

impl Wire for Json {
    fn send(&mut self, motors: [f64; 4], number: u64) {
        let packet = self.packet(motors, number);
        let _ = self.socket.send_to(&packet, ("127.0.0.1", self.to));
    }

    fn send_short(&mut self) {
        let packet = self.packet([0.5; 4], self.frame);
        let _ = self.socket.send_to(&packet[..30], ("127.0.0.1", self.to));
    }

    fn receive(&mut self) -> Result<Option<(Known, u64)>, ()> {
        let mut bytes = [0; 2048];
        let Ok((length, _)) = self.socket.recv_from(&mut bytes) else {
            return Ok(None);
        };
        let line = std::str::from_utf8(&bytes[..length]).unwrap();
        assert!(line.starts_with('\n') && line.ends_with('\n'), "{line:?}");
        let state: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(state["timestamp"].as_f64().unwrap() > 0.0);
        let number = |it: &serde_json::Value, i: usize| it[i].as_f64().unwrap();
        let vector = |it: &serde_json::Value| Vector::from_fn(|i, _| number(it, i));
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| number(&state["quaternion"], i));
        self.frame += 1;
        let known = Known {
            attitude: UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
            rate: vector(&state["imu"]["gyro"]),
            force: vector(&state["imu"]["accel_body"]),
            position: vector(&state["position"]),
            velocity: vector(&state["velocity"]),
        };
        Ok(Some((known, self.frame)))
    }
}

/// Knows its attitude from its rate alone, and its place from GPS.
struct Hil {
    reader: MavlinkReader<TcpStream>,
    known: Known,
    time_us: u64,
}

impl Hil {
    fn new(to: u16) -> Self {
        let stream = loop {
            match TcpStream::connect(("127.0.0.1", to)) {
                Ok(stream) => break stream,
                Err(_) => thread::sleep(Duration::from_millis(1)),
            }
        };
        let wait = Some(Duration::from_millis(20));
        stream.set_read_timeout(wait).unwrap();
        stream.set_nodelay(true).unwrap();
        let mut hil = Self {
            reader: MavlinkReader::new(stream),
            known: Known::default(),
            time_us: 0,
        };
        hil.write(&MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
        hil
    }

    fn write(&mut self, message: &MavMessage) {
        let mut bytes = Vec::new();
        mavlink::write_v2_msg(&mut bytes, MavHeader::default(), message).unwrap();
        let _ = self.reader.get_mut().write_all(&bytes);
    }
}

impl Wire for Hil {
    fn send(&mut self, motors: [f64; 4], number: u64) {
        // PX4 sends nothing before a state has set its clock.
        if number == 0 {
            return;
        }
        let mut controls = [0.0; 16];
        for (control, motor) in controls.iter_mut().zip(motors) {
            *control = motor as f32;
        }
        let mut mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, motors != [0.0; 4]);
        let flags = HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP;
        let time_usec = number;
        self.write(&MavMessage::HIL_ACTUATOR_CONTROLS(
            HIL_ACTUATOR_CONTROLS_DATA {
                time_usec,
                flags,
                controls,
                mode,
            },
        ));
    }

    fn send_short(&mut self) {
        let _ = self.reader.get_mut().write_all(&[0xfd, 81, 0, 0]);
    }

    fn receive(&mut self) -> Result<Option<(Known, u64)>, ()> {
        loop {
            match self.reader.read_any_message::<MavMessage>() {
                Ok((_, MavMessage::HIL_GPS(gps))) => {
                    let metres = |angle: i32, origin: f64| {
                        (f64::from(angle) * 1e-7 - origin).to_radians() * 6_378_137.0
                    };
                    let [latitude, longitude, height_m] = ORIGIN;
                    self.known.position = Vector::new(
                        metres(gps.lat, latitude),
                        metres(gps.lon, longitude) * latitude.to_radians().cos(),
                        height_m - f64::from(gps.alt) / 1e3,
                    );
                    self.known.velocity =
                        Vector::new(gps.vn.into(), gps.ve.into(), gps.vd.into()) / 100.0;
                }
                Ok((_, MavMessage::HIL_SENSOR(imu))) => {
                    assert_eq!(imu.id, 0);
                    let step_s = imu.time_usec.saturating_sub(self.time_us) as f64 / 1e6;
                    self.time_us = imu.time_usec;
                    let vector = |v: [f32; 3]| Vector::from(v.map(f64::from));
                    self.known.rate = vector([imu.xgyro, imu.ygyro, imu.zgyro]);
                    self.known.force = vector([imu.xacc, imu.yacc, imu.zacc]);
                    self.known.attitude *=
                        UnitQuaternion::from_scaled_axis(self.known.rate * step_s);
                    return Ok(Some((self.known, imu.time_usec)));
                }
                Ok(_) => {}
                Err(mavlink::error::MessageReadError::Io(e))
                    if e.kind() == std::io::ErrorKind::WouldBlock =>
                {
                    return Ok(None);
                }
                Err(_) => return Err(()),
            }
        }
    }
}

/// Shares of full speed, front right, rear left, front left, rear right, that hold the vehicle 1 m above its start.
fn hover(known: &Known) -> [f64; 4] {
    let rig = Rig::default();
    let (airframe, g) = (rig.airframe, 9.8);
    let error = Vector::new(0.0, 0.0, -1.0) - known.position;
    let wanted = (error * 1.5 - known.velocity * 2.0).map(|it| it.clamp(-3.0, 3.0));
    let (roll, pitch, yaw) = known.attitude.euler_angles();
    let angles = Vector::new(wanted.y / g - roll, -wanted.x / g - pitch, -yaw);
    let [ix, iy, iz] = [airframe.i_x(), airframe.i_y(), airframe.i_z()];
    let torque = (angles * 60.0 - known.rate * 12.0).component_mul(&Vector::new(ix, iy, iz));
    let lever = airframe.l() * std::f64::consts::SQRT_2 * 2.0;
    let (roll, pitch) = (torque.x / lever, torque.y / lever);
    // Rotors front right and rear left spin clockwise, so they turn the nose to the left.
    let yaw = -torque.z * airframe.k() / (4.0 * airframe.d());
    let share = airframe.m() * (g - wanted.z) / 4.0;
    let full_n = rig.rotor.f_max(airframe.k());
    [
        share - roll + pitch + yaw,
        share + roll - pitch + yaw,
        share + roll + pitch - yaw,
        share - roll - pitch - yaw,
    ]
    .map(|thrust_n| (thrust_n / full_n).clamp(0.0, 1.0).sqrt().max(0.05))
}

/// A firmware that the user has started.
struct StandIn {
    /// Does something that it should not, from now on.
    misbehaves: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StandIn {
    /// `mode` is what it does when it misbehaves.
    fn start(port: &Port, number: u16, mode: &'static str) -> Self {
        let flags = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let [misbehaves, is_over] = flags.clone();
        let is_json = port.description.name == ardupilot::PORT.description.name;
        let run = move || {
            let mut wire: Box<dyn Wire> = match is_json {
                true => Box::new(Json::new(number)),
                false => Box::new(Hil::new(number)),
            };
            let (mut answered, mut motors) = (0, [0.0; 4]);
            wire.send(motors, answered);
            while !is_over.load(Ordering::Relaxed) {
                let Ok(received) = wire.receive() else {
                    return;
                };
                let Some((known, state)) = received else {
                    // Without a state the same frame goes out again.
                    wire.send(motors, answered);
                    continue;
                };
                (answered, motors) = (state, hover(&known));
                let mode = if misbehaves.load(Ordering::Relaxed) {
                    mode
                } else {
                    "well"
                };
                match mode {
                    "never" => motors = [0.0; 4],
                    "nan" => motors[0] = f64::NAN,
                    // Which axis of which sensor says it.
                    "signs" => {
                        let [x, _, z] = known.force.into();
                        let numbers = [known.rate.x, known.rate.y, known.rate.z, (x - z) / 10.0];
                        motors = numbers.map(|it| 0.5 + 0.1 * it);
                    }
                    _ => {}
                }
                match mode {
                    "silent" => continue,
                    "gone" => return,
                    "short" => {
                        wire.send_short();
                        continue;
                    }
                    "old" => wire.send(motors, 1),
                    _ => wire.send(motors, answered),
                }
                if mode == "twice" {
                    wire.send(motors, answered);
                }
            }
        };
        let [misbehaves, is_over] = flags;
        Self {
            misbehaves,
            is_over,
            thread: Some(thread::spawn(run)),
        }
    }

    fn misbehave(&self) {
        self.misbehaves.store(true, Ordering::Relaxed);
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(thread::panicking() || ended.unwrap().is_ok());
    }
}

/// A port that is free on this machine.
fn free() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

fn bridge(port: &'static Port, number: u16, limit_s: f64) -> Bridge {
    let settings = description::Settings::new(vec![
        ("port", Value::Number(number.into())),
        ("arming_limit_s", Value::Number(limit_s)),
        // Ten periods of a millisecond, whatever else the machine does.
        ("answer_limit", Value::Number(10.0)),
    ]);
    Bridge::of(port, None, &Rig::default(), &settings)
}

/// A flight at rest with a stand-in, tick by tick.
struct Flight {
    bridge: Bridge,
    number: u16,
    _stand_in: StandIn,
    tick: u64,
    telemetry: Telemetry,
}

impl Flight {
    fn start(port: &'static Port, mode: &'static str) -> Self {
        let number = free();
        let stand_in = StandIn::start(port, number, mode);
        let mut bridge = bridge(port, number, 30.0);
        bridge.start(true).unwrap();
        stand_in.misbehave();
        Self {
            bridge,
            number,
            _stand_in: stand_in,
            tick: 0,
            telemetry: Telemetry::unknown(LOCKSTEP_SIGNALS.len()),
        }
    }

    fn signal(&self, name: &str) -> f64 {
        let mut signals = LOCKSTEP_SIGNALS.iter();
        self.telemetry.value[signals.position(|it| it.name == name).unwrap()]
    }

    /// Flies until a tick is as wanted; its thrust [N]. A busy machine may need some.
    fn until(&mut self, measured: Measured, is_wanted: impl Fn(&Self) -> bool) -> f64 {
        for _ in 0..500 {
            thread::sleep(Duration::from_millis(1));
            self.tick += 1;
            let input = InnerInput {
                tick: self.tick,
                measured_age: 0,
                wanted_age: 0,
                given_age: 0,
                measured,
                wanted: Desired {
                    thrust_n: 0.0,
                    attitude_rad: [0.0; 3],
                    attitude_rate_rad_s: [0.0; 3],
                    attitude_acceleration_rad_s2: [0.0; 3],
                    limited: 0,
                },
                reference: Reference::default(),
                given: Given::default(),
            };
            let wrench = self.bridge.tick(&input, &mut self.telemetry);
            if is_wanted(self) {
                return wrench.thrust_n;
            }
        }
        panic!("no tick was as wanted: {:?}", self.telemetry.value);
    }

    fn until_outcome(&mut self, outcome: AnswerOutcome) -> f64 {
        self.until(Measured::default(), |flight| {
            flight.signal("answer_outcome") == outcome as u64 as f64
        })
    }
}

const PORTS: [&Port; 2] = [&ardupilot::PORT, &px4::PORT];

#[test]
fn a_firmware_hovers_by_what_it_is_sent() {
    for (port, period_s) in [(PORTS[0], 0.001), (PORTS[1], 0.004)] {
        let number = free();
        let _stand_in = StandIn::start(port, number, "well");
        let name = port.description.name;
        let text = format!(
            "flight = {{ trajectory = \"hover\", duration_s = 12.0, period_s = {period_s} }}\n\
             ground = {{ contact = \"plane\" }}\n\
             inner = {{ law = \"{name}\", port = {number} }}"
        );
        let settings = Settings::of(toml::from_str(&text).unwrap(), &[].into()).unwrap();
        let mut rig = Simulator::of(&settings).unwrap();
        rig.start().unwrap();
        let start_m = rig.state().truth.position_w_m;
        for tick in 0..=settings.last_tick() {
            rig.tick();
            let position = rig.state().truth.position_w_m;
            let error = Vector::from(position) - Vector::from(start_m) - Vector::z();
            let is_late = tick as f64 * period_s > 8.0;
            assert!(
                !is_late || error.norm() < 0.1,
                "{name}: {position:?} at tick {tick}"
            );
        }
    }
}

#[test]
fn rates_and_forces_arrive_in_frd_and_motors_in_the_order_of_the_rotors() {
    for port in PORTS {
        let mut flight = Flight::start(port, "signs");
        // Roll to the right, nose up, nose to the right and forward are positive in FRD; the firmware's motors 1 to 4 are
        // rotors 3, 1, 4, 2.
        for (place, rotor, expected) in [
            (0, "motor_3", 0.6),
            (1, "motor_1", 0.4),
            (2, "motor_4", 0.4),
            (3, "motor_2", 0.6),
            (5, "motor_2", 0.6),
        ] {
            let mut measured = Measured::default();
            match place {
                3.. => measured.specific_force_b_m_s2[place - 3] = 10.0,
                axis => measured.rate_b_rad_s[axis] = 1.0,
            }
            flight.until(measured, |it| (it.signal(rotor) - expected).abs() < 2e-3);
        }
    }
}

#[test]
fn attitudes_and_places_arrive_in_ned() {
    let mut flight = Flight::start(PORTS[0], "well");
    let rotors = |flight: &Flight| [1, 2, 3, 4].map(|i| flight.signal(&format!("motor_{i}")));
    flight.until_outcome(AnswerOutcome::Answered);
    for (tilt_rad, place_m, more, less) in [
        // Right side down, nose down: the rotors there pull up.
        ([0.1, 0.0, 0.0], [0.0; 3], [1, 2], [0, 3]),
        ([0.0, 0.1, 0.0], [0.0; 3], [2, 3], [0, 1]),
        // Nose to the left: the rotors that spin against the clock turn it back.
        ([0.0, 0.0, 0.1], [0.0; 3], [1, 3], [0, 2]),
        // Too far ahead: nose up. Too far to the left: left side up.
        ([0.0; 3], [1.0, 0.0, 0.0], [2, 3], [0, 1]),
        ([0.0; 3], [0.0, 1.0, 0.0], [0, 3], [1, 2]),
    ] {
        let measured = Measured {
            attitude_quaternion: Attitude::of_euler(&tilt_rad.into()).wxyz(),
            position_w_m: place_m,
            ..Measured::default()
        };
        flight.until(measured, |flight| {
            let rotors = rotors(flight);
            let least = more.map(|i| rotors[i]).into_iter().fold(1.0, f64::min);
            least > less.map(|i| rotors[i]).into_iter().fold(0.0, f64::max)
        });
    }
    let turned_twice = turned(turned([1.0, 2.0, 3.0]));
    assert_eq!(turned_twice, [1.0, 2.0, 3.0]);
    assert_eq!(turned_quaternion([1.0, 0.0, 0.5, 0.0])[2], -0.5);
}

#[test]
fn answers_of_another_size_without_numbers_or_none_are_told_apart_and_the_motors_are_held() {
    for (port, mode, outcome) in [
        (PORTS[0], "short", AnswerOutcome::WrongSize),
        (PORTS[1], "nan", AnswerOutcome::NotFinite),
        (PORTS[0], "silent", AnswerOutcome::Silent),
        (PORTS[1], "silent", AnswerOutcome::Silent),
        // Bytes between messages are skipped.
        (PORTS[1], "short", AnswerOutcome::Silent),
    ] {
        let mut flight = Flight::start(port, mode);
        let thrust_n = flight.until_outcome(outcome);
        assert!(thrust_n > 0.0, "{mode}");
        assert_eq!(flight.signal("firmware_disarmed"), 0.0, "{mode}");
    }
}

#[test]
fn an_answer_whose_number_has_come_before_is_repeated_and_not_flown() {
    for port in PORTS {
        for mode in ["twice", "old"] {
            let mut flight = Flight::start(port, mode);
            flight.until(Measured::default(), |it| {
                it.signal("answers_repeated") > 0.0
            });
        }
        let mut flight = Flight::start(port, "old");
        flight.until_outcome(AnswerOutcome::Silent);
    }
}

#[test]
fn a_firmware_that_goes_stops_the_motors() {
    for port in PORTS {
        let mut flight = Flight::start(port, "gone");
        assert_eq!(flight.until_outcome(AnswerOutcome::Ended), 0.0);
        assert!(flight.signal("firmware_exit_status").is_nan());
    }
}

#[test]
fn a_firmware_that_disarms_is_disarmed() {
    for port in PORTS {
        Flight::start(port, "never").until(Measured::default(), |flight| {
            flight.signal("firmware_disarmed") > 0.0
        });
    }
}

#[test]
fn a_firmware_that_does_not_come_or_arm_is_refused_with_the_reason() {
    for port in PORTS {
        let number = free();
        let said = bridge(port, number, 0.2).start(true).unwrap_err();
        let said = said.to_string();
        let none = format!("no firmware has come to port {number} within 0.2 s");
        assert!(said.contains(&none), "{said}");
        let stand_in = StandIn::start(port, number, "never");
        stand_in.misbehave();
        let said = bridge(port, number, 1.0).start(true).unwrap_err();
        let said = said.to_string();
        assert!(said.contains("has not armed within 1 s"), "{said}");
    }
}

#[test]
fn another_program_cannot_answer() {
    let mut flight = Flight::start(PORTS[0], "silent");
    flight.until_outcome(AnswerOutcome::Silent);
    let forged = Json::new(flight.number);
    let packet = forged.packet([1.0; 4], 1_000_000);
    let to = ("127.0.0.1", forged.to);
    for _ in 0..20 {
        forged.socket.send_to(&packet, to).unwrap();
        flight.until_outcome(AnswerOutcome::Silent);
        assert!(flight.signal("motor_1") < 0.99, "it was flown");
    }
}
