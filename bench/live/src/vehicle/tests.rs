//! The vehicle without a flight: its model is fed with made-up messages, and its link with frames.

use std::io::Read as _;
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use MavCmd::*;
use MavParamError::*;
use MavResult::{
    MAV_RESULT_ACCEPTED as ACCEPTED, MAV_RESULT_DENIED as DENIED,
    MAV_RESULT_TEMPORARILY_REJECTED as REJECTED, MAV_RESULT_UNSUPPORTED as UNSUPPORTED,
};
use analysis::faults::InjectedFault;
use flight_log::entry::LogEntry;
use mavlink::dialects::common::*;
use mavlink::{
    MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, Message as _, MessageData as _,
};
use messages::blackboards::{ActiveParameters, EndReason, Run, RunPhase, Subject};
use messages::content::{
    FlightTarget, Measured, Reference, RotorSpeeds, Setpoint, State, TakenCommand, TargetKind,
};
use messages::header::{Header, Message, Stamps};
use messages::parameters::{Airframe, Parameter, SPECS};
use messages::role::Channel;

use super::failures::FAILURES;
use super::link::{Address, Frame, Link, frames};
use super::offboard::Mode;
use super::parameters::{FAILURES_ENABLED, NAMES};
use super::protocol::{Purpose, Request, Vehicle, What};
use super::telemetry::STREAMS;
use crate::inject::parse_line;
use crate::watch::dashboard_model::{Model, WatchedFlight};

const STATION: MavHeader = MavHeader {
    system_id: 255,
    component_id: 190,
    sequence: 0,
};
const NOW: Duration = Duration::from_secs(10);

fn entry<C>(tick: u64, content: C) -> Message<C> {
    let envelope = Header {
        run_id: 7,
        tick,
        stamps: [Stamps {
            receive_ns: 1,
            send_ns: 2,
        }; 4],
        ..Header::new()
    };
    Message { envelope, content }
}

/// A flight at tick 1500 that is 3 m ahead, 1 m left and 2 m up, turned to the left.
fn model() -> Model {
    model_of("lissajous")
}

fn model_of(trajectory: &str) -> Model {
    let mut model = Model::new("left", false, false);
    let run = Run {
        phase: RunPhase::Flying as u64,
        run_id: 7,
        period_ns: 1_000_000,
        sample_time_ns: 1_000_000,
        last_tick: 30_000,
        tick: 1500,
        deadlines_missed: 4,
        ..Run::default()
    };
    let settings = [
        ("flight.trajectory", trajectory),
        ("flight.faults", r#"["inner.late=1ms@1.6s"]"#),
        ("flight.tracking_error_max_m", "0.1"),
        ("flight.tracking_yaw_error_max_rad", "0.1"),
        ("flight.ground_z_m", "-0.25"),
        ("ground.leg_m", "0.05"),
        ("mixer.law", "roll_pitch_first"),
        ("rotor.min_rad_s", "30"),
        ("rotor.max_rad_s", "350"),
    ];
    let settings = settings.map(|(key, value)| (key.to_owned(), value.to_owned()));
    model.join(&run, settings.into()).unwrap();
    let flight = flight(&mut model);
    flight.active = ActiveParameters {
        value: *Airframe::nominal().values(),
        ..ActiveParameters::default()
    };
    let measured = Measured {
        position_w_m: [3.0, 1.0, 2.0],
        velocity_w_m_s: [0.5, 0.25, -0.125],
        attitude_rad: [0.1, 0.2, 1.5],
        rate_b_rad_s: [0.01, 0.02, 0.03],
        rotor_speed_squared_mean_rad2_s2: [30_625.0; 4],
        ..Measured::default()
    };
    let state = State {
        measured,
        ..State::default()
    };
    flight.take(&LogEntry::State(entry(1500, state)));
    let reference = Reference {
        position_w_m: [3.0, 1.5, 2.0],
        yaw_rad: 1.5,
        ..Reference::default()
    };
    let setpoint = Setpoint {
        reference,
        ..Setpoint::default()
    };
    flight.take(&LogEntry::Setpoint(entry(1500, setpoint)));
    let speeds = RotorSpeeds {
        speed_rad_s: [30.0, 190.0, 350.0, 190.0],
        ..RotorSpeeds::default()
    };
    flight.take(&LogEntry::RotorSpeeds(entry(1500, speeds)));
    model
}

fn flight(model: &mut Model) -> &mut WatchedFlight {
    model.flight.as_mut().unwrap()
}

#[test]
fn the_page_of_ground_stations_has_every_parameter_and_failure() {
    let page = include_str!("../../../../docs/ground-station.md");
    let names = NAMES.iter().zip(&SPECS);
    let names = names.map(|(name, spec)| format!("| {name} | `{}` |", spec.name));
    let failures = FAILURES.iter().map(|(unit, kind, what)| {
        let (unit, kind) = (format!("{unit:?}"), format!("{kind:?}"));
        let unit = unit.trim_start_matches("FAILURE_UNIT_");
        let kind = kind.trim_start_matches("FAILURE_TYPE_");
        format!("| {unit} | {kind} | `{}` |", what.replace("{n}", "N"))
    });
    for row in names.chain(failures) {
        assert!(page.contains(&row), "docs/ground-station.md lacks {row}");
    }
}

/// A vehicle that has joined the flight of a model, and the station's side of it.
struct Joined {
    vehicle: Vehicle,
    model: Model,
    /// Messages that the vehicle has sent when it joined.
    first: Vec<MavMessage>,
}

impl Joined {
    fn new(allows_control: bool) -> Self {
        Self::to(model(), allows_control)
    }

    fn to(model: Model, allows_control: bool) -> Self {
        let mut vehicle = Vehicle::new(allows_control);
        vehicle.update(&model, NOW);
        let first = std::mem::take(&mut vehicle.outbox.messages);
        Self {
            vehicle,
            model,
            first,
        }
    }

    /// The vehicle's answer to a message.
    fn send(&mut self, message: &MavMessage) -> Vec<MavMessage> {
        self.vehicle.receive(&STATION, message, &self.model, NOW);
        std::mem::take(&mut self.vehicle.outbox.messages)
    }

    /// The result of a command, the texts beside it, and the message that was requested.
    fn command(
        &mut self,
        name: MavCmd,
        parameters: [f32; 3],
    ) -> (MavResult, String, Option<MavMessage>) {
        let mut answers = self.send(&command(name, parameters));
        let (acked, text) = (result(&answers), texts(&answers));
        (acked.unwrap(), text, answers.pop())
    }

    fn request(&mut self, id: u32, of: u32) -> Option<MavMessage> {
        let parameters = [id as f32, of as f32, 0.0];
        let (result, text, message) = self.command(MAV_CMD_REQUEST_MESSAGE, parameters);
        assert_eq!(
            (result == ACCEPTED, text),
            (message.as_ref().unwrap().message_id() == id, String::new())
        );
        message.filter(|_| result == ACCEPTED)
    }

    fn set(&mut self, name: &str, value: f32) -> Vec<MavMessage> {
        self.send(&MavMessage::PARAM_SET(set(name, value)))
    }

    fn read(&mut self, param_index: i16, name: &str) -> Vec<MavMessage> {
        self.send(&MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
            param_index,
            target_system: 1,
            target_component: 1,
            param_id: name.into(),
        }))
    }

    /// Lets the plant answer the only request; gives what was requested, and what the vehicle sends then.
    fn answered(&mut self, answer: Result<&str, &str>) -> (String, Vec<MavMessage>) {
        match self.answered_request(answer) {
            (What::Line(line), messages) => (line, messages),
            (other, _) => panic!("{other:?}"),
        }
    }

    fn answered_request(&mut self, answer: Result<&str, &str>) -> (What, Vec<MavMessage>) {
        let request = self.vehicle.requests.pop().unwrap();
        assert!(self.vehicle.requests.is_empty());
        assert_eq!(request.run_id, 7);
        let answer = answer.map(str::to_owned).map_err(str::to_owned);
        self.vehicle.answered(&request, &answer, &self.model, NOW);
        (
            request.what,
            std::mem::take(&mut self.vehicle.outbox.messages),
        )
    }

    /// The target that the plant is asked for, which accepts it; and what the vehicle sends then.
    fn followed(&mut self) -> (FlightTarget, [u64; 2], Vec<MavMessage>) {
        match self.answered_request(Ok("")) {
            (What::Target(it), messages) => (it.target, [it.has_yaw, it.stays], messages),
            (other, _) => panic!("{other:?}"),
        }
    }

    fn send_heartbeat(&mut self) -> Vec<MavMessage> {
        self.send(&command(MAV_CMD_REQUEST_MESSAGE, [0.0; 3]))
    }

    /// The texts that the vehicle sends so much later.
    fn later(&mut self, ms: u64) -> String {
        let now = NOW + Duration::from_millis(ms);
        self.vehicle.update(&self.model, now);
        texts(&std::mem::take(&mut self.vehicle.outbox.messages))
    }
}

fn command(command: MavCmd, [param1, param2, param3]: [f32; 3]) -> MavMessage {
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        command,
        param1,
        param2,
        param3,
        target_system: 1,
        target_component: 1,
        ..COMMAND_LONG_DATA::default()
    })
}

fn set(name: &str, param_value: f32) -> PARAM_SET_DATA {
    PARAM_SET_DATA {
        param_value,
        target_system: 1,
        target_component: 1,
        param_id: name.into(),
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    }
}

/// A message without content for the vehicle.
fn to_the_vehicle(id: u32) -> MavMessage {
    let mut message = MavMessage::default_message_from_id(id).unwrap();
    *message.target_system_id_mut().unwrap() = 1;
    message
}

/// The result of the command that was acknowledged.
fn result(messages: &[MavMessage]) -> Option<MavResult> {
    messages.iter().find_map(|it| match it {
        MavMessage::COMMAND_ACK(ack) => {
            assert_eq!([ack.target_system, ack.target_component], [255, 190]);
            Some(ack.result)
        }
        _ => None,
    })
}

/// The texts, put together again.
fn texts(messages: &[MavMessage]) -> String {
    let mut text = String::new();
    for message in messages {
        if let MavMessage::STATUSTEXT(it) = message {
            let part = it.text.to_str().unwrap();
            let is_last = it.id == 0 || part.len() < 50;
            text += part;
            text += if is_last { "\n" } else { "" };
        }
    }
    text
}

/// The error of a parameter and its value.
fn refused(messages: &[MavMessage]) -> (Option<MavParamError>, Option<f32>) {
    let error = messages.iter().find_map(|it| match it {
        MavMessage::PARAM_ERROR(it) => Some(it.error),
        _ => None,
    });
    let value = messages.iter().find_map(|it| match it {
        MavMessage::PARAM_VALUE(it) => Some(it.param_value),
        _ => None,
    });
    (error, value)
}

#[test]
fn a_ground_station_can_connect_as_qgroundcontrol_does() {
    let empty = Model::new("left", false, false);
    let mut joined = Joined::to(empty, false);
    assert_eq!(joined.first, [], "a vehicle without a flight");
    joined = Joined::new(false);
    let MavMessage::HEARTBEAT(heartbeat) = &joined.first[0] else {
        panic!("{:?}", joined.first);
    };
    let armed = MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED;
    assert_eq!(heartbeat.mavtype, MavType::MAV_TYPE_QUADROTOR);
    assert_eq!(heartbeat.autopilot, MavAutopilot::MAV_AUTOPILOT_GENERIC);
    assert!(heartbeat.base_mode.contains(armed));

    let version = joined.request(AUTOPILOT_VERSION_DATA::ID, 0);
    let Some(MavMessage::AUTOPILOT_VERSION(version)) = version else {
        panic!("{version:?}");
    };
    let fence = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE;
    let rally = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY;
    assert!(!version.capabilities.intersects(fence | rally));
    let modes = joined.request(AVAILABLE_MODES_DATA::ID, 1);
    let Some(MavMessage::AVAILABLE_MODES(modes)) = modes else {
        panic!("{modes:?}");
    };
    assert_eq!(modes.mode_name.to_str(), Ok("lissajous"));
    let metadata = [COMPONENT_METADATA_DATA::ID as f32, 0.0, 0.0];
    assert_eq!(
        joined.command(MAV_CMD_REQUEST_MESSAGE, metadata).0,
        UNSUPPORTED
    );

    let list = PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 0,
    };
    let list = joined.send(&MavMessage::PARAM_REQUEST_LIST(list));
    assert_eq!(list.len(), NAMES.len() + 1);
    for (index, message) in list.iter().enumerate() {
        let MavMessage::PARAM_VALUE(it) = message else {
            panic!("{message:?}");
        };
        assert_eq!([it.param_index, it.param_count], [index as u16, 33]);
        let (index, name) = (index as i16, it.param_id.to_str().unwrap());
        assert_eq!(joined.read(-1, name), std::slice::from_ref(message));
        assert_eq!(joined.read(index, ""), std::slice::from_ref(message));
    }
    assert_eq!(refused(&joined.read(-1, "MASS")), (None, Some(0.52)));
    assert_eq!(
        refused(&joined.read(-1, FAILURES_ENABLED)),
        (None, Some(0.0))
    );
    let unknown = (Some(MAV_PARAM_ERROR_DOES_NOT_EXIST), None);
    assert_eq!(refused(&joined.read(33, "")), unknown);

    let mission_type = MavMissionType::MAV_MISSION_TYPE_RALLY;
    let list = MISSION_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 1,
        mission_type,
    };
    let count = joined.send(&MavMessage::MISSION_REQUEST_LIST(list));
    let [MavMessage::MISSION_COUNT(count)] = &count[..] else {
        panic!("{count:?}");
    };
    assert_eq!((count.count, count.mission_type), (0, mission_type));
}

#[test]
fn telemetry_is_in_the_frames_of_mavlink_and_as_often_as_requested() {
    let mut joined = Joined::new(false);
    for (id, _) in STREAMS {
        assert!(joined.first.iter().any(|it| it.message_id() == id), "{id}");
    }
    for message in &joined.first {
        let (numbers, expected): (Vec<f32>, &[f32]) = match message {
            MavMessage::LOCAL_POSITION_NED(it) => {
                assert_eq!(it.time_boot_ms, 1500);
                let numbers = vec![it.x, it.y, it.z, it.vx, it.vy, it.vz];
                (numbers, &[3.0, -1.0, -2.0, 0.5, -0.25, 0.125])
            }
            MavMessage::POSITION_TARGET_LOCAL_NED(it) => {
                (vec![it.x, it.y, it.z, it.yaw], &[3.0, -1.5, -2.0, -1.5])
            }
            MavMessage::ATTITUDE(it) => {
                let rates = [it.rollspeed, it.pitchspeed, it.yawspeed];
                assert_eq!(rates, [0.01, -0.02, -0.03]);
                (vec![it.roll, it.pitch, it.yaw], &[0.1, -0.2, -1.5])
            }
            MavMessage::GLOBAL_POSITION_INT(it) => {
                let numbers = vec![it.alt as f32, it.relative_alt as f32, it.hdg.into()];
                (numbers, &[490_000.0, 2000.0, 27_406.0])
            }
            MavMessage::VFR_HUD(it) => {
                let numbers = vec![it.throttle.into(), it.heading.into(), it.climb];
                (numbers, &[25.0, 274.0, -0.125])
            }
            MavMessage::SERVO_OUTPUT_RAW(it) => {
                let servos = [it.servo1_raw, it.servo2_raw, it.servo3_raw];
                (servos.map(f32::from).to_vec(), &[1000.0, 1500.0, 2000.0])
            }
            MavMessage::SYS_STATUS(it) => (vec![it.errors_count1.into()], &[4.0]),
            _ => continue,
        };
        assert_eq!(numbers, expected, "{message:?}");
    }
    let range = "allowed are -1, 0 and 20000 to 3600000000";
    let [attitude, hud] = [ATTITUDE_DATA::ID, VFR_HUD_DATA::ID];
    let [heartbeat, estimator] = [HEARTBEAT_DATA::ID, ESTIMATOR_STATUS_DATA::ID];
    for (id, us, expected, words) in [
        (attitude, -1.0, ACCEPTED, ""),
        (hud, 20_000.0, ACCEPTED, ""),
        (hud, 100.0, DENIED, &format!("interval 100 us: {range}\n")),
        (
            hud,
            f32::NAN,
            DENIED,
            &format!("interval NaN us: {range}\n"),
        ),
        (heartbeat, -1.0, DENIED, "heartbeats stay at 1 Hz\n"),
        (
            estimator,
            0.0,
            DENIED,
            "message 230 is not sent by itself\n",
        ),
    ] {
        let (result, text, _) = joined.command(MAV_CMD_SET_MESSAGE_INTERVAL, [id as f32, us, 0.0]);
        assert_eq!((result, text.as_str()), (expected, words), "{id} {us}");
    }
    let mut count = [0; 2];
    for ms in 0..1000 {
        let now = NOW + Duration::from_millis(ms);
        joined.vehicle.update(&joined.model, now);
        for message in joined.vehicle.outbox.messages.drain(..) {
            count[0] += u32::from(message.message_id() == attitude);
            count[1] += u32::from(message.message_id() == hud);
        }
    }
    assert_eq!(count, [0, 50]);
    for (id, expected) in [(attitude, -1), (hud, 20_000), (estimator, 0)] {
        let interval = joined.request(MESSAGE_INTERVAL_DATA::ID, id);
        let Some(MavMessage::MESSAGE_INTERVAL(interval)) = interval else {
            panic!("{interval:?}");
        };
        assert_eq!(interval.interval_us, expected, "{id}");
    }
}

const READ_ONLY: &str = "this bridge only observes: start it with --allow-control\n";

#[test]
fn a_parameter_is_set_if_the_plant_takes_it_and_otherwise_the_old_value_is_sent() {
    let mut joined = Joined::new(false);
    let answer = joined.set("MASS", 0.6);
    let denied = (Some(MAV_PARAM_ERROR_PERMISSION_DENIED), Some(0.52));
    assert_eq!(
        (refused(&answer), texts(&answer)),
        (denied, READ_ONLY.into())
    );
    assert!(joined.vehicle.requests.is_empty());

    joined = Joined::new(true);
    // The plant's answer is the acknowledgement, and a repetition before it asks nothing again.
    assert_eq!(joined.set("ROT_DRAG", 0.315), []);
    assert_eq!(joined.set("ROT_DRAG", 0.315), []);
    let (what, answer) = joined.answered(Ok("applied"));
    assert_eq!(what, "rotational_drag_nm_s=0.315");
    assert_eq!(refused(&answer), (None, Some(0.315)));

    joined.set("MASS", 99.0);
    let (_, answer) = joined.answered(Err("mass_kg = 99 is out of range"));
    let out_of_range = (Some(MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE), Some(0.52));
    assert_eq!(refused(&answer), out_of_range);
    assert_eq!(texts(&answer), "mass_kg = 99 is out of range\n");

    let int = MavParamType::MAV_PARAM_TYPE_INT32;
    let whole = PARAM_SET_DATA {
        param_type: int,
        ..set("WIND_X", 1.0)
    };
    let unknown = set("NOTHING", 1.0);
    let fixed = set(FAILURES_ENABLED, 1.0);
    for (it, error, words) in [
        (
            whole,
            MAV_PARAM_ERROR_TYPE_MISMATCH,
            "WIND_X is set as a REAL32",
        ),
        (
            unknown,
            MAV_PARAM_ERROR_DOES_NOT_EXIST,
            "there is no parameter `NOTHING`",
        ),
        (
            fixed,
            MAV_PARAM_ERROR_READ_ONLY,
            "SYS_FAILURE_EN says whether --allow-control was given",
        ),
    ] {
        let answer = joined.send(&MavMessage::PARAM_SET(it));
        assert_eq!(refused(&answer).0, Some(error));
        assert_eq!(texts(&answer).trim_end(), words);
    }
    assert!(joined.vehicle.requests.is_empty());
}

#[test]
fn commands_get_the_result_that_they_deserve() {
    let fixed =
        "the trajectory of this flight is fixed: `ironbird fly --trajectory` says what flies\n";
    let ends = "a flight ends after its duration, or by Ctrl-C where `ironbird fly` runs\n";
    let calibration = "MAV_CMD_PREFLIGHT_CALIBRATION is not supported\n";
    let (none, first, failure) = ([0.0; 3], [1.0, 0.0, 0.0], [4.0, 7.0, 0.0]);
    for (may, name, parameters, expected, words) in [
        (false, MAV_CMD_COMPONENT_ARM_DISARM, first, ACCEPTED, ""),
        (true, MAV_CMD_COMPONENT_ARM_DISARM, none, DENIED, ends),
        (true, MAV_CMD_DO_FLIGHTTERMINATION, first, DENIED, ends),
        (true, MAV_CMD_NAV_TAKEOFF, none, DENIED, fixed),
        (true, MAV_CMD_NAV_LAND, none, DENIED, fixed),
        (true, MAV_CMD_DO_REPOSITION, none, DENIED, fixed),
        (true, MAV_CMD_DO_SET_MODE, none, DENIED, fixed),
        (
            true,
            MAV_CMD_PREFLIGHT_CALIBRATION,
            none,
            UNSUPPORTED,
            calibration,
        ),
        (false, MAV_CMD_INJECT_FAILURE, failure, DENIED, READ_ONLY),
        (
            false,
            MAV_CMD_INJECT_FAILURE,
            [4.0, 0.0, 0.0],
            DENIED,
            READ_ONLY,
        ),
        (
            true,
            MAV_CMD_INJECT_FAILURE,
            [7.0, 1.0, 0.0],
            UNSUPPORTED,
            "unit 7 cannot fail here\n",
        ),
    ] {
        let mut joined = Joined::new(may);
        let (result, text, _) = joined.command(name, parameters);
        assert_eq!((result, text.as_str()), (expected, words), "{name:?}");
        let [param1, param2, param3] = parameters;
        let int = MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            command: name,
            param1,
            param2,
            param3,
            target_system: 1,
            ..COMMAND_INT_DATA::default()
        });
        assert_eq!(self::result(&joined.send(&int)), Some(expected), "{name:?}");
        assert!(joined.vehicle.requests.is_empty());
    }
    let mut joined = Joined::new(true);
    flight(&mut joined.model).ending = Some(EndReason::Completed);
    for (name, parameters) in [
        (MAV_CMD_INJECT_FAILURE, failure),
        (MAV_CMD_COMPONENT_ARM_DISARM, first),
    ] {
        assert_eq!(joined.command(name, parameters).0, REJECTED);
    }
    let denied = (Some(MAV_PARAM_ERROR_PERMISSION_DENIED), Some(0.52));
    assert_eq!(refused(&joined.set("MASS", 0.6)), denied);
}

#[test]
fn failures_begin_and_end_by_the_answers_of_the_plant() {
    let mut joined = Joined::new(true);
    let inject = |kind: f32| command(MAV_CMD_INJECT_FAILURE, [4.0, kind, 0.0]);
    let (began, overlap) = ((Ok(""), ACCEPTED), (Err("they overlap"), DENIED));
    for (kind, (answer, expected), expected_what) in [
        (7.0, began, "outer.state.drop=0.2"),
        (5.0, overlap, "outer.state.drop=9/10"),
        (6.0, began, "outer.state.lag=20"),
        (0.0, began, "outer.state.drop=off,outer.state.lag=off"),
    ] {
        assert_eq!(joined.send(&inject(kind)), []);
        let (what, messages) = joined.answered(answer);
        assert_eq!(
            (what.as_str(), result(&messages)),
            (expected_what, Some(expected))
        );
        assert_eq!(
            texts(&messages).trim_end(),
            answer.err().unwrap_or_default()
        );
    }
    // Nothing is left to end.
    assert_eq!(result(&joined.send(&inject(0.0))), Some(ACCEPTED));
    assert!(joined.vehicle.requests.is_empty());
}

#[test]
fn an_end_waits_for_what_begins_and_ends_each_fault_once() {
    let mut joined = Joined::new(true);
    let inject = |kind: f32| command(MAV_CMD_INJECT_FAILURE, [4.0, kind, 0.0]);
    assert_eq!(joined.send(&inject(7.0)), []);
    assert_eq!(result(&joined.send(&inject(0.0))), Some(REJECTED));
    assert_eq!(result(&joined.answered(Ok("")).1), Some(ACCEPTED));
    // The last one begins again, because `ironbird inject` has ended it.
    for kind in [6.0, 7.0] {
        assert_eq!(joined.send(&inject(kind)), []);
        joined.answered(Ok(""));
    }
    assert_eq!(joined.send(&inject(0.0)), []);
    let (what, _) = joined.answered(Ok(""));
    assert_eq!(what, "outer.state.lag=off,outer.state.drop=off");
}

#[test]
fn what_others_have_ended_is_not_ended_again() {
    let mut joined = Joined::new(true);
    let inject = |kind: f32| command(MAV_CMD_INJECT_FAILURE, [4.0, kind, 0.0]);
    for kind in [6.0, 7.0] {
        assert_eq!(joined.send(&inject(kind)), []);
        joined.answered(Ok(""));
    }
    let flight = joined.model.flight.as_mut().unwrap();
    let now = flight.tick();
    let fault = |what: &str, end| InjectedFault::new(what.into(), 0, end, 1e-3);
    flight.injected = vec![
        fault("outer.state.lag=20", Some(now)),
        fault("outer.state.drop=0.2", Some(now + 1)),
    ];
    assert_eq!(joined.send(&inject(0.0)), []);
    assert_eq!(joined.answered(Ok("")).0, "outer.state.drop=off");
}

#[test]
fn requests_without_end_are_not_answered_without_end() {
    let mut joined = Joined::new(false);
    let list = MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        ..PARAM_REQUEST_LIST_DATA::default()
    });
    for _ in 0..10_000 {
        joined.vehicle.receive(&STATION, &list, &joined.model, NOW);
    }
    assert!(joined.vehicle.outbox.messages.len() < 1100);
}

#[test]
fn what_is_for_others_or_for_all_changes_nothing() {
    let mut joined = Joined::new(true);
    let own = MavHeader {
        system_id: 1,
        component_id: 1,
        sequence: 0,
    };
    for (header, system, component) in [
        (STATION, 2, 1),
        (STATION, 0, 1),
        (STATION, 0, 0),
        (STATION, 1, 191),
        (own, 1, 1),
    ] {
        let it = set("MASS", 0.6);
        let fail = command(MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 1.0]);
        for mut message in [MavMessage::PARAM_SET(it), fail] {
            *message.target_system_id_mut().unwrap() = system;
            *message.target_component_id_mut().unwrap() = component;
            joined
                .vehicle
                .receive(&header, &message, &joined.model, NOW);
        }
        let vehicle = &joined.vehicle;
        assert!(
            vehicle.outbox.messages.is_empty() && vehicle.requests.is_empty(),
            "{system} {component}"
        );
    }
    // A broadcast may request values.
    let list = PARAM_REQUEST_LIST_DATA::default();
    assert_eq!(joined.send(&MavMessage::PARAM_REQUEST_LIST(list)).len(), 33);
    let target = to_the_vehicle(SET_POSITION_TARGET_LOCAL_NED_DATA::ID);
    let fixed = "the trajectory of this flight is fixed: setpoints have no effect; fly --trajectory mavlink\n";
    assert_eq!(texts(&joined.send(&target)), fixed);
    // A stream of them is refused once a second, and so is one of made-up names after the first few.
    assert_eq!(joined.send(&target), []);
    let refused = (0..100).flat_map(|it| joined.set(&format!("X{it}"), 0.0));
    assert_eq!(texts(&refused.collect::<Vec<_>>()).lines().count(), 19);
}

/// A setpoint north, west and above the start.
fn setpoint(type_mask: u16) -> SET_POSITION_TARGET_LOCAL_NED_DATA {
    SET_POSITION_TARGET_LOCAL_NED_DATA {
        x: 5.1,
        y: -1.0,
        z: -2.0,
        vx: 0.5,
        vy: 0.25,
        vz: -0.125,
        yaw: 0.5,
        type_mask: PositionTargetTypemask::from_bits_retain(type_mask),
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::default()
    }
}

/// Type masks of MAVSDK: of a position, of a velocity, and of both.
const POSITION: u16 = 0b1001_1111_1000;
const VELOCITY: u16 = 0b1001_1100_0111;
const BOTH: u16 = 0b1001_1100_0000;
/// Modes of MAV_CMD_DO_SET_MODE as MAVSDK sends them.
const OFFBOARD: [f32; 3] = [1.0, 6.0, 0.0];
const HOLD: [f32; 3] = [1.0, 4.0, 3.0];

fn custom_mode(messages: &[MavMessage]) -> u32 {
    let mut modes = messages.iter().filter_map(|it| match it {
        MavMessage::HEARTBEAT(it) => Some(it.custom_mode),
        _ => None,
    });
    modes.next_back().unwrap_or_default()
}

#[test]
fn in_the_mode_offboard_setpoints_are_targets_until_they_stop() {
    let mut joined = Joined::to(model_of("mavlink"), true);
    assert_eq!(custom_mode(&joined.first), Mode::Hold.number());
    let send = |it| MavMessage::SET_POSITION_TARGET_LOCAL_NED(it);
    let early = "setpoints have no effect before MAV_CMD_DO_SET_MODE offboard\n";
    assert_eq!(texts(&joined.send(&send(setpoint(POSITION)))), early);
    let started = joined.send(&command(MAV_CMD_DO_SET_MODE, OFFBOARD));
    assert_eq!(result(&started), Some(ACCEPTED));
    assert_eq!(custom_mode(&started), 6 << 16);
    for (mask, kind, position_w_m, velocity_w_m_s, has_yaw) in [
        (POSITION, TargetKind::Position, [5.1, 1.0, 2.0], [0.0; 3], 1),
        (
            VELOCITY | 1 << 10,
            TargetKind::Velocity,
            [0.0; 3],
            [0.5, -0.25, 0.125],
            0,
        ),
        (
            BOTH,
            TargetKind::Position,
            [5.1, 1.0, 2.0],
            [0.5, -0.25, 0.125],
            1,
        ),
    ] {
        assert_eq!(joined.send(&send(setpoint(mask))), []);
        let yaw_rad = if has_yaw == 1 { -0.5 } else { 0.0 };
        let target = FlightTarget {
            from_tick: 0,
            kind: kind as u64,
            position_w_m,
            velocity_w_m_s,
            yaw_rad,
        };
        assert_eq!(joined.followed(), (target, [has_yaw, 0], Vec::new()));
    }
    // While the plant has not answered, the newest one waits.
    for x in [1.0, 2.0, 3.0] {
        joined.send(&send(SET_POSITION_TARGET_LOCAL_NED_DATA {
            x,
            ..setpoint(POSITION)
        }));
    }
    assert_eq!(joined.followed().0.position_w_m[0], 1.0);
    assert_eq!(joined.followed().0.position_w_m[0], 3.0);
    // The plant holds the position; shortly after the start it has not yet heard of a target.
    let at = |joined: &mut Joined, tick| {
        let seen = flight(&mut joined.model);
        seen.take(&LogEntry::State(entry(tick, State::default())));
        seen.run.tick = tick;
    };
    at(&mut joined, 2500);
    assert_eq!(joined.later(1500), "1.600 s: fault inner.late=1ms\n");
    at(&mut joined, 2501);
    assert_eq!(
        joined.later(2000),
        "no setpoint for 0.5 s: the vehicle holds its position\n"
    );
    joined.vehicle.outbox.messages.clear();
    joined.vehicle.receive(
        &STATION,
        &send(setpoint(POSITION)),
        &joined.model,
        NOW + Duration::from_secs(5),
    );
    assert_eq!(texts(&joined.vehicle.outbox.messages), early);
}

#[test]
fn what_is_no_target_is_refused_with_the_reason() {
    let nothing = SET_POSITION_TARGET_LOCAL_NED_DATA {
        ..setpoint(POSITION)
    };
    let masks = |mask| setpoint(mask);
    for (it, words) in [
        (
            masks(0xfff),
            "setpoint with type_mask 0x0fff: allowed are position, velocity and yaw; ignore all else",
        ),
        (masks(BOTH & !(1 << 7)), "setpoint with type_mask 0x0940"),
        (
            masks(POSITION & !(1 << 11)),
            "setpoint with type_mask 0x01f8",
        ),
        (
            masks(POSITION | 1),
            "setpoint with a part of a vector: give or ignore all three axes",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                coordinate_frame: MavFrame::MAV_FRAME_BODY_FRD,
                ..nothing
            },
            "setpoint in MAV_FRAME_BODY_FRD: allowed is MAV_FRAME_LOCAL_NED",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                x: f32::NAN,
                ..nothing
            },
            "position of the target: NaN m is out of range: allowed are -1000 to 1000 m",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA { y: 1e6, ..nothing },
            "position of the target: -1000000 m is out of range",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA { z: 0.21, ..nothing },
            "height of the target: -0.21 m above the start: allowed are -0.2 m and more",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                yaw: f32::INFINITY,
                ..nothing
            },
            "yaw of the setpoint: inf is no angle",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                vx: 3.0,
                ..setpoint(VELOCITY)
            },
            "speed of the target: 3.0",
        ),
        (
            SET_POSITION_TARGET_LOCAL_NED_DATA {
                vy: f32::NAN,
                ..setpoint(BOTH)
            },
            "speed of the target: NaN m/s is out of range: allowed are up to 3 m/s",
        ),
    ] {
        let mut joined = Joined::to(model_of("mavlink"), true);
        joined.send(&command(MAV_CMD_DO_SET_MODE, OFFBOARD));
        let answer = joined.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(it));
        assert!(texts(&answer).starts_with(words), "{words}: {answer:?}");
        assert!(joined.vehicle.requests.is_empty(), "{words}");
    }
}

#[test]
fn commands_climb_descend_move_and_hold() {
    let mut joined = Joined::to(model_of("mavlink"), true);
    let reference = Reference {
        position_w_m: [3.0, 1.5, 2.0],
        ..Reference::default()
    };
    let state = State {
        reference,
        ..State::default()
    };
    flight(&mut joined.model).take(&LogEntry::State(entry(1501, state)));
    let nothing = f32::NAN;
    let long = |command, param1, param7| {
        MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command,
            param1,
            param4: nothing,
            param5: nothing,
            param6: nothing,
            param7,
            target_system: 1,
            ..COMMAND_LONG_DATA::default()
        })
    };
    let int = |frame, x, y, z| {
        MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            command: MAV_CMD_DO_REPOSITION,
            param1: -1.0,
            param4: 0.5,
            x,
            y,
            z,
            frame,
            target_system: 1,
            ..COMMAND_INT_DATA::default()
        })
    };
    let relative = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT;
    let position = TargetKind::Position as u64;
    for (message, kind, place, yaw) in [
        (
            long(MAV_CMD_NAV_TAKEOFF, nothing, nothing),
            position,
            [3.0, 1.5, 2.5],
            None,
        ),
        (
            long(MAV_CMD_NAV_TAKEOFF, nothing, 7.0),
            position,
            [3.0, 1.5, 7.0],
            None,
        ),
        (
            long(MAV_CMD_NAV_LAND, nothing, nothing),
            position,
            [3.0, 1.5, -0.2],
            None,
        ),
        (
            long(MAV_CMD_DO_PAUSE_CONTINUE, 0.0, nothing),
            0,
            [0.0; 3],
            None,
        ),
        (command(MAV_CMD_DO_SET_MODE, HOLD), 0, [0.0; 3], None),
        (
            int(relative, i32::MAX, i32::MAX, 4.0),
            position,
            [3.0, 1.5, 4.0],
            Some(-0.5),
        ),
        (
            int(MavFrame::MAV_FRAME_GLOBAL, 473_986_403, 85_469_211, nothing),
            position,
            [100.0, -100.0, 2.0],
            Some(-0.5),
        ),
    ] {
        joined.send(&command(MAV_CMD_DO_SET_MODE, OFFBOARD));
        assert_eq!(joined.send(&message), []);
        let (target, flags, answer) = joined.followed();
        let away = target
            .position_w_m
            .iter()
            .zip(place)
            .map(|(one, other)| (one - other).abs());
        assert!(
            target.kind == kind && away.fold(0.0, f64::max) < 0.01,
            "{message:?}: {target:?}"
        );
        assert_eq!(
            (target.yaw_rad, flags),
            (yaw.unwrap_or(0.0), [u64::from(yaw.is_some()), 1])
        );
        assert_eq!(result(&answer), Some(ACCEPTED), "{message:?}");
        assert_eq!(custom_mode(&joined.send_heartbeat()), Mode::Hold.number());
    }
    for (message, words) in [
        (
            long(MAV_CMD_NAV_TAKEOFF, nothing, -1.0),
            "height of the target: -1 m above the start",
        ),
        (
            long(MAV_CMD_DO_REPOSITION, 5.0, nothing),
            "speed 5 m/s of the reposition: allowed is -1",
        ),
        (
            long(MAV_CMD_DO_PAUSE_CONTINUE, 1.0, nothing),
            "MAV_CMD_DO_PAUSE_CONTINUE is not flown here",
        ),
        (
            command(MAV_CMD_DO_SET_MODE, [1.0, 3.0, 0.0]),
            "modes of this vehicle: Hold and Offboard",
        ),
        (
            int(MavFrame::MAV_FRAME_LOCAL_NED, 1, 1, 1.0),
            "a place in a frame that is not global",
        ),
    ] {
        let answer = joined.send(&message);
        assert_eq!(result(&answer), Some(DENIED), "{words}");
        assert!(texts(&answer).starts_with(words), "{answer:?}");
    }
    let mut observer = Joined::to(model_of("mavlink"), false);
    let answer = observer.send(&command(MAV_CMD_DO_SET_MODE, OFFBOARD));
    assert_eq!(result(&answer), Some(DENIED));
    assert!(observer.vehicle.requests.is_empty());
}

#[test]
fn events_misses_and_the_end_are_reported_once() {
    let mut joined = Joined::new(false);
    assert_eq!(texts(&joined.first), "ironbird flies lissajous\n");
    assert_eq!(joined.later(1000), "");
    let seen = flight(&mut joined.model);
    (seen.run.tick, seen.run.deadlines_missed) = (1700, 7);
    let news = "1.600 s: fault inner.late=1ms\n3 missed deadlines, 7 in all\n";
    assert_eq!(joined.later(2000), news);
    assert_eq!(joined.later(3000), "");
    let seen = flight(&mut joined.model);
    let killed = "inner was killed by the fault, and is started again";
    seen.supervision.add(1650, Subject::Process, killed);
    for (tick, channel) in [(1660, Channel::A), (1661, Channel::B)] {
        let mut state = State::default();
        state.decision.count = 1;
        state.decision.command = TakenCommand {
            of_tick: tick,
            channel: channel as u64,
            is_offered: 1,
            ..TakenCommand::default()
        };
        seen.take(&LogEntry::State(entry(tick, state)));
    }
    let handed_over = "1.661 s: channel b flies in place of channel a\n";
    assert_eq!(
        joined.later(4000),
        format!("1.650 s: {killed}\n{handed_over}")
    );
    flight(&mut joined.model).ending = Some(EndReason::Attitude);
    let (end, why) = (
        joined.later(4010),
        "left the envelope: tilt beyond its limit",
    );
    assert!(
        end.starts_with(&format!("the flight has ended: {why}; ")),
        "{end}"
    );
    assert_eq!(joined.later(5000), "");
}

#[test]
fn long_texts_come_in_parts_of_which_the_last_is_not_full() {
    let mut joined = Joined::new(true);
    for length in [1, 49, 50, 51, 99, 100, 101, 250] {
        let reason = "x".repeat(length);
        joined.set("MASS", length as f32);
        let (_, messages) = joined.answered(Err(&reason));
        assert_eq!(texts(&messages).trim_end(), reason);
        let parts = messages.iter().filter_map(|it| match it {
            MavMessage::STATUSTEXT(it) => Some(it),
            _ => None,
        });
        let parts: Vec<&STATUSTEXT_DATA> = parts.collect();
        let last = parts.last().unwrap();
        assert_eq!(last.id != 0, length > 50);
        assert_eq!(usize::from(last.chunk_seq) + 1, parts.len());
        assert!(last.id == 0 || last.text.to_str().unwrap().len() < 50);
    }
}

fn frame(message: &MavMessage) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(STATION, message);
    raw.raw_bytes().to_vec()
}

/// The frames of a datagram: whether each is signed.
fn read(datagram: &[u8]) -> Vec<bool> {
    let mut read = Vec::new();
    frames(datagram, &mut |frame| {
        read.push(matches!(frame, Frame::Signed))
    });
    read
}

#[test]
fn signed_frames_are_noticed_and_both_versions_are_read() {
    let message = MavMessage::PARAM_SET(set("MASS", 0.6));
    let mut v1 = MAVLinkV1MessageRaw::new();
    v1.serialize_message(STATION, &message);
    let mut signed = frame(&message);
    signed[2] |= 1;
    let body = signed.len() - 2;
    let crc = mavlink::calculate_crc(&signed[1..body], PARAM_SET_DATA::EXTRA_CRC);
    signed[body..].copy_from_slice(&crc.to_le_bytes());
    signed.extend([0; 13]);
    let both = [frame(&message), v1.raw_bytes().to_vec(), signed].concat();
    assert_eq!(read(&both), [false, false, true]);
    // Half a frame at the end of a datagram does not reach into the next one.
    assert_eq!(read(&both[..both.len() - 1]), [false, false]);
    assert_eq!(read(&frame(&message)), [false]);

    let mut joined = Joined::new(true);
    joined.vehicle.refuse_signed(NOW);
    let words = "signed frames are ignored: no key can be checked here; switch signing off\n";
    assert_eq!(joined.later(0), words);
    let refused = joined.send(&to_the_vehicle(SETUP_SIGNING_DATA::ID));
    assert_eq!(
        texts(&refused),
        "signing is not supported: no key is taken\n"
    );
}

/// Waits until a link has passed on so many frames.
fn receive(link: &mut Link, count: usize) {
    let (mut received, until) = (0, Instant::now() + Duration::from_secs(60));
    while received < count {
        assert!(Instant::now() < until, "{received} frames");
        link.receive(|_| received += 1);
    }
    assert_eq!(received, count);
}

#[test]
fn over_udp_only_the_station_that_is_reported_to_is_heard() {
    let loopback = (Ipv4Addr::LOCALHOST, 0);
    let station = UdpSocket::bind(loopback).unwrap();
    let mut link = Link::open(Address::Udp(station.local_addr().unwrap())).unwrap();
    let message = MavMessage::PARAM_SET(set("MASS", 0.6));
    link.send(&message);
    let mut datagram = [0; 300];
    let (length, vehicle) = station.recv_from(&mut datagram).unwrap();
    assert_eq!(read(&datagram[..length]), [false]);
    let foreign = UdpSocket::bind(loopback).unwrap();
    foreign.send_to(&frame(&message), vehicle).unwrap();
    station.send_to(&frame(&message), vehicle).unwrap();
    receive(&mut link, 1);
    // A station that has gone is no error, and may come back.
    drop(station);
    for _ in 0..3 {
        link.send(&message);
        link.receive(|_| panic!("nothing is sent"));
    }
}

#[test]
fn over_tcp_one_station_at_a_time_is_served() {
    let mut link = Link::open(Address::Tcp((Ipv4Addr::LOCALHOST, 0).into())).unwrap();
    let message = MavMessage::PARAM_SET(set("MASS", 0.6));
    let bytes = frame(&message);
    let connect = |link: &Link| TcpStream::connect(link.address().unwrap()).unwrap();
    let write =
        |stream: &mut TcpStream, bytes: &[u8]| std::io::Write::write_all(stream, bytes).unwrap();
    let mut first = connect(&link);
    write(&mut first, &[b"garbage\xfd", &bytes[..10]].concat());
    link.receive(|_| panic!("not a whole frame"));
    write(&mut first, &[&bytes[10..], &bytes, &bytes].concat());
    // The start of a frame in the garbage hides the first ones until its length has arrived.
    write(&mut first, &bytes.repeat(10));
    receive(&mut link, 13);
    let mut second = connect(&link);
    link.receive(|_| {});
    assert_eq!(
        second.read(&mut [0; 1]).unwrap(),
        0,
        "the second one is not served"
    );
    drop(first);
    let mut third = connect(&link);
    write(&mut third, &bytes);
    receive(&mut link, 1);
    link.send(&message);
    let mut there = [0; 1];
    third.read_exact(&mut there).unwrap();
    assert_eq!(there, [0xfd]);
}

/// Whether a frame of MAVLink 2 may have the vehicle request a change, read by hand from the protocol's description. 23 is PARAM_SET, 75 COMMAND_INT, 76 COMMAND_LONG; of a vehicle that is steered, 84 is SET_POSITION_TARGET_LOCAL_NED.
fn may_change(frame: &[u8], is_steered: bool) -> bool {
    let crc_extra = |id: u32| match id {
        23 => Some((168, 4)),
        75 => Some((158, 30)),
        76 => Some((152, 30)),
        84 if is_steered => Some((143, 50)),
        _ => None,
    };
    let Some(&[0xfd, length, 0, _, _, system, component, a, b, c]) = frame.first_chunk() else {
        return false;
    };
    let Some((extra, target)) = crc_extra(u32::from_le_bytes([a, b, c, 0])) else {
        return false;
    };
    let end = 10 + usize::from(length);
    let Some(sum) = frame.get(end..end + 2) else {
        return false;
    };
    let mut crc = 0xffff_u16;
    for byte in frame[1..end].iter().chain(&[extra]) {
        let mut it = *byte ^ crc as u8;
        it ^= it << 4;
        let it = u16::from(it);
        crc = (crc >> 8) ^ (it << 8) ^ (it << 3) ^ (it >> 4);
    }
    let byte = |place: usize| frame[10..end].get(place).copied().unwrap_or(0);
    let addressed = byte(target) == 1 && byte(target + 1) <= 1 && [system, component] != [1, 1];
    addressed
        && crc.to_le_bytes() == sum
        && match a {
            23 | 84 => true,
            _ => {
                let command = u16::from_le_bytes([byte(28), byte(29)]);
                command == 420 || is_steered && [21, 22, 176, 192, 193].contains(&command)
            }
        }
}

/// A million frames, random and mutated, of which many have a right checksum: nothing panics, nothing is asked of the plant
/// that was not addressed to the vehicle, and a vehicle that only observes asks for nothing.
#[test]
fn a_million_frames_change_nothing_that_they_may_not() {
    let (mut joined, mut observer) = (Joined::new(true), Joined::new(false));
    let mut steered = Joined::to(model_of("mavlink"), true);
    let mut random = fastrand::Rng::with_seed(1);
    let int = MavMessage::COMMAND_INT(COMMAND_INT_DATA {
        command: MAV_CMD_INJECT_FAILURE,
        param1: 4.0,
        param2: 7.0,
        target_system: 1,
        ..COMMAND_INT_DATA::default()
    });
    let seeds = [
        MavMessage::PARAM_SET(set("MASS", 0.6)),
        command(MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 2.0]),
        int,
        command(MAV_CMD_REQUEST_MESSAGE, [148.0, 0.0, 0.0]),
        command(MAV_CMD_SET_MESSAGE_INTERVAL, [30.0, 5e4, 0.0]),
        MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA::default()),
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint(BOTH)),
        command(MAV_CMD_NAV_LAND, [0.0; 3]),
    ];
    let seeds = seeds.map(|it| (frame(&it), MavMessage::extra_crc(it.message_id())));
    let (mut accepted, mut asked, mut parsed, mut aimed) = (0, 0, 0, 0);
    for round in 0..1_000_000_u32 {
        let (seed, extra) = random.choice(&seeds).unwrap();
        let mut bytes = seed.clone();
        let body = bytes.len() - 2;
        match round % 4 {
            0 => bytes = (0..random.usize(..300)).map(|_| random.u8(..)).collect(),
            1 => *random.choice(&mut bytes).unwrap() = random.u8(..),
            2 => bytes.truncate(random.usize(..body)),
            _ => {
                for _ in 0..random.usize(..4) {
                    let most = if random.bool() { u8::MAX } else { 2 };
                    bytes[random.usize(3..body)] = random.u8(..=most);
                }
            }
        }
        // Other content with a right checksum.
        if round % 4 == 3 || (round % 4 == 1 && random.bool()) {
            let crc = mavlink::calculate_crc(&bytes[1..body], *extra);
            bytes[body..].copy_from_slice(&crc.to_le_bytes());
        }
        frames(&bytes, &mut |frame| {
            parsed += 1;
            if let Frame::Message(header, message) = frame {
                for it in [&mut joined, &mut observer, &mut steered] {
                    it.vehicle.receive(&header, &message, &it.model, NOW);
                }
            }
        });
        let may = may_change(&bytes, false);
        accepted += u32::from(may);
        for request in std::mem::take(&mut joined.vehicle.requests) {
            asked += 1;
            assert!(may, "{request:?} by {bytes:?}");
            check(&request);
            let answer = random.bool().then(String::new).ok_or_else(String::new);
            joined
                .vehicle
                .answered(&request, &answer, &joined.model, NOW);
        }
        for request in std::mem::take(&mut steered.vehicle.requests) {
            aimed += u32::from(request.purpose == Purpose::Follow);
            assert!(may_change(&bytes, true), "{request:?} by {bytes:?}");
            check(&request);
            steered
                .vehicle
                .answered(&request, &Ok(String::new()), &steered.model, NOW);
        }
        if round % 64 == 0 {
            steered.send(&command(MAV_CMD_DO_SET_MODE, OFFBOARD));
        }
        assert!(observer.vehicle.requests.is_empty());
        steered.vehicle.outbox.messages.clear();
        joined.vehicle.outbox.messages.clear();
        observer.vehicle.outbox.messages.clear();
    }
    // The oracle and the vehicle both see many of them.
    assert!(
        parsed > 250_000 && accepted > 50_000 && asked > 50_000 && aimed > 10_000,
        "{parsed} {accepted} {asked} {aimed}"
    );
}

/// A request is one that `ironbird inject` can read, or a number that is none, or a target within its limits.
fn check(Request { what, .. }: &Request) {
    let what = match what {
        What::Line(line) => line,
        What::Target(order) => return assert_eq!(plant::guidance::check(&order.target), Ok(())),
    };
    let name = what.split('=').next().unwrap();
    let is_parameter = Parameter::from_name(name).is_ok();
    let is_none = is_parameter && (what.contains("NaN") || what.contains("inf"));
    assert!(is_none || parse_line(what).is_ok(), "{what}");
}
