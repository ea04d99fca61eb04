//! The vehicle without a flight: its model is fed with made-up messages, and its link with frames.

use std::io::Read as _;
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use flight_log::entry::LogEntry;
use mavlink::dialects::common::*;
use mavlink::{MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, MessageData as _};
use messages::blackboards::{ActiveParameters, EndReason, Run, RunPhase, Subject};
use messages::content::{
    Decision, Measured, Reference, RotorSpeeds, Setpoint, State, TakenCommand,
};
use messages::header::{Header, Message, Stamps};
use messages::parameters::{Airframe, Parameter};
use messages::role::Channel;

use super::link::{Address, Frame, Link, frames};
use super::parameters::{FAILURES_ENABLED, NAMES};
use super::protocol::{Request, Vehicle};
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
        ("flight.trajectory", "lissajous"),
        ("flight.faults", r#"["inner.late=1ms@1.6s"]"#),
        ("flight.tracking_error_max_m", "0.1"),
        ("flight.tracking_yaw_error_max_rad", "0.1"),
        ("flight.ground_z_m", "-0.25"),
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

/// A vehicle that has joined the flight, and its messages so far.
fn joined(allows_control: bool, model: &Model) -> (Vehicle, Vec<MavMessage>) {
    let mut vehicle = Vehicle::new(allows_control);
    vehicle.update(model, NOW);
    let messages = std::mem::take(&mut vehicle.messages);
    (vehicle, messages)
}

/// What the vehicle answers to a message.
fn answers(vehicle: &mut Vehicle, model: &Model, message: MavMessage) -> Vec<MavMessage> {
    vehicle.receive(&STATION, &message, model, NOW);
    std::mem::take(&mut vehicle.messages)
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

/// The result of the command that was acknowledged, and the texts beside it.
fn result(messages: &[MavMessage]) -> (Option<MavResult>, String) {
    let ack = messages.iter().find_map(|it| match it {
        MavMessage::COMMAND_ACK(ack) => Some(ack),
        _ => None,
    });
    if let Some(ack) = ack {
        assert_eq!([ack.target_system, ack.target_component], [255, 190]);
    }
    (ack.map(|ack| ack.result), texts(messages))
}

/// The texts, put together again.
fn texts(messages: &[MavMessage]) -> String {
    let mut text = String::new();
    for message in messages {
        if let MavMessage::STATUSTEXT(part) = message {
            text += part.text.to_str().unwrap();
            text += if part.id == 0 || part.text.to_str().unwrap().len() < 50 {
                "\n"
            } else {
                ""
            };
        }
    }
    text
}

fn value(messages: &[MavMessage]) -> Option<(String, f32)> {
    messages.iter().find_map(|it| match it {
        MavMessage::PARAM_VALUE(it) => {
            Some((it.param_id.to_str().unwrap().to_owned(), it.param_value))
        }
        _ => None,
    })
}

fn error(messages: &[MavMessage]) -> Option<MavParamError> {
    messages.iter().find_map(|it| match it {
        MavMessage::PARAM_ERROR(it) => Some(it.error),
        _ => None,
    })
}

#[test]
fn a_ground_station_can_connect_as_qgroundcontrol_does() {
    let mut model = Model::new("left", false, false);
    let (mut vehicle, none) = joined(false, &model);
    assert!(none.is_empty(), "a vehicle without a flight: {none:?}");
    model = self::model();
    vehicle.update(&model, NOW);
    let first = vehicle.messages.first().cloned();
    let Some(MavMessage::HEARTBEAT(heartbeat)) = first.or(None) else {
        panic!("{:?}", vehicle.messages);
    };
    assert_eq!(heartbeat.mavtype, MavType::MAV_TYPE_QUADROTOR);
    assert_eq!(heartbeat.autopilot, MavAutopilot::MAV_AUTOPILOT_GENERIC);
    assert!(
        heartbeat
            .base_mode
            .contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED)
    );
    vehicle.messages.clear();

    let mut request = |id: u32| {
        answers(
            &mut vehicle,
            &model,
            command(MavCmd::MAV_CMD_REQUEST_MESSAGE, [id as f32, 0.0, 0.0]),
        )
    };
    let version = request(AUTOPILOT_VERSION_DATA::ID);
    assert_eq!(result(&version).0, Some(MavResult::MAV_RESULT_ACCEPTED));
    let Some(MavMessage::AUTOPILOT_VERSION(version)) = version.get(1) else {
        panic!("{version:?}");
    };
    let plan = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY;
    assert!(!version.capabilities.intersects(plan));
    let metadata = request(COMPONENT_METADATA_DATA::ID);
    assert_eq!(
        result(&metadata),
        (Some(MavResult::MAV_RESULT_UNSUPPORTED), String::new())
    );
    let modes = request(AVAILABLE_MODES_DATA::ID);
    assert!(
        matches!(&modes[1], MavMessage::AVAILABLE_MODES(it) if it.mode_name.to_str() == Ok("lissajous"))
    );

    let list = MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 0,
    });
    let list = answers(&mut vehicle, &model, list);
    assert_eq!(list.len(), NAMES.len() + 1);
    for (index, message) in list.iter().enumerate() {
        let MavMessage::PARAM_VALUE(it) = message else {
            panic!("{message:?}");
        };
        assert_eq!(
            (usize::from(it.param_index), usize::from(it.param_count)),
            (index, list.len())
        );
        let read = PARAM_REQUEST_READ_DATA {
            param_index: -1,
            target_system: 1,
            param_id: it.param_id,
            ..PARAM_REQUEST_READ_DATA::default()
        };
        assert_eq!(
            answers(
                &mut vehicle,
                &model,
                MavMessage::PARAM_REQUEST_READ(read.clone())
            ),
            std::slice::from_ref(message)
        );
        let read = PARAM_REQUEST_READ_DATA {
            param_index: index as i16,
            param_id: "".into(),
            ..read
        };
        assert_eq!(
            answers(
                &mut vehicle,
                &model,
                MavMessage::PARAM_REQUEST_READ(read.clone())
            ),
            std::slice::from_ref(message)
        );
    }
    assert_eq!(value(&list), Some(("MASS".into(), 0.52)));
    assert_eq!(value(&list[32..]), Some((FAILURES_ENABLED.into(), 0.0)));
    let read = PARAM_REQUEST_READ_DATA {
        param_index: 33,
        target_system: 1,
        ..PARAM_REQUEST_READ_DATA::default()
    };
    let unknown = answers(&mut vehicle, &model, MavMessage::PARAM_REQUEST_READ(read));
    assert_eq!(
        error(&unknown),
        Some(MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST)
    );

    for mission_type in [
        MavMissionType::MAV_MISSION_TYPE_MISSION,
        MavMissionType::MAV_MISSION_TYPE_FENCE,
    ] {
        let request = MISSION_REQUEST_LIST_DATA {
            target_system: 1,
            target_component: 1,
            mission_type,
        };
        let count = answers(
            &mut vehicle,
            &model,
            MavMessage::MISSION_REQUEST_LIST(request),
        );
        assert!(
            matches!(&count[..], [MavMessage::MISSION_COUNT(it)] if it.count == 0 && it.mission_type == mission_type)
        );
    }
}

#[test]
fn telemetry_is_in_the_frames_of_mavlink_and_as_often_as_requested() {
    let model = model();
    let (mut vehicle, messages) = joined(false, &model);
    for (id, _) in STREAMS {
        use mavlink::Message as _;
        assert!(messages.iter().any(|it| it.message_id() == id), "{id}");
    }
    for message in &messages {
        match message {
            MavMessage::LOCAL_POSITION_NED(it) => {
                assert_eq!(it.time_boot_ms, 1500);
                assert_eq!(
                    [it.x, it.y, it.z, it.vx, it.vy, it.vz],
                    [3.0, -1.0, -2.0, 0.5, -0.25, 0.125]
                );
            }
            MavMessage::POSITION_TARGET_LOCAL_NED(it) => {
                assert_eq!([it.x, it.y, it.z, it.yaw], [3.0, -1.5, -2.0, -1.5])
            }
            MavMessage::ATTITUDE(it) => {
                assert_eq!([it.roll, it.pitch, it.yaw], [0.1, -0.2, -1.5]);
                assert_eq!(
                    [it.rollspeed, it.pitchspeed, it.yawspeed],
                    [0.01, -0.02, -0.03]
                );
            }
            MavMessage::GLOBAL_POSITION_INT(it) => assert_eq!(
                [it.alt, it.relative_alt, it.hdg.into()],
                [490_000, 2000, 27_406]
            ),
            MavMessage::VFR_HUD(it) => {
                assert_eq!((it.throttle, it.heading, it.climb), (25, 274, -0.125))
            }
            MavMessage::SERVO_OUTPUT_RAW(it) => assert_eq!(
                [it.servo1_raw, it.servo2_raw, it.servo3_raw],
                [1000, 1500, 2000]
            ),
            MavMessage::SYS_STATUS(it) => assert_eq!(it.errors_count1, 4),
            _ => {}
        }
    }
    let mut interval = |id: u32, us: f32| {
        answers(
            &mut vehicle,
            &model,
            command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, [id as f32, us, 0.0]),
        )
    };
    use MavResult::*;
    for (id, us, expected, words) in [
        (ATTITUDE_DATA::ID, -1.0, MAV_RESULT_ACCEPTED, ""),
        (VFR_HUD_DATA::ID, 20_000.0, MAV_RESULT_ACCEPTED, ""),
        (
            VFR_HUD_DATA::ID,
            100.0,
            MAV_RESULT_DENIED,
            "interval 100 us: allowed are -1, 0 and 20000 to 3600000000\n",
        ),
        (
            VFR_HUD_DATA::ID,
            f32::NAN,
            MAV_RESULT_DENIED,
            "interval NaN us: allowed are -1, 0 and 20000 to 3600000000\n",
        ),
        (
            HEARTBEAT_DATA::ID,
            -1.0,
            MAV_RESULT_DENIED,
            "heartbeats stay at 1 Hz\n",
        ),
        (
            ESTIMATOR_STATUS_DATA::ID,
            0.0,
            MAV_RESULT_DENIED,
            "message 230 is not sent by itself\n",
        ),
    ] {
        assert_eq!(
            result(&interval(id, us)),
            (Some(expected), words.to_owned()),
            "{id} {us}"
        );
    }
    let mut count = [0; 2];
    for ms in 0..1000 {
        vehicle.update(&model, NOW + Duration::from_millis(ms));
        for message in vehicle.messages.drain(..) {
            count[0] += u32::from(matches!(message, MavMessage::ATTITUDE(_)));
            count[1] += u32::from(matches!(message, MavMessage::VFR_HUD(_)));
        }
    }
    assert_eq!(count, [0, 50]);
    let of = |id: u32| {
        command(
            MavCmd::MAV_CMD_REQUEST_MESSAGE,
            [MESSAGE_INTERVAL_DATA::ID as f32, id as f32, 0.0],
        )
    };
    for (id, interval_us) in [
        (ATTITUDE_DATA::ID, -1),
        (VFR_HUD_DATA::ID, 20_000),
        (ESTIMATOR_STATUS_DATA::ID, 0),
    ] {
        let answer = answers(&mut vehicle, &model, of(id));
        assert!(
            matches!(&answer[1], MavMessage::MESSAGE_INTERVAL(it) if it.interval_us == interval_us),
            "{answer:?}"
        );
    }
}

#[test]
fn a_parameter_is_set_if_the_plant_takes_it_and_otherwise_the_old_value_is_sent() {
    let model = model();
    let (mut vehicle, _) = joined(false, &model);
    let refused = answers(
        &mut vehicle,
        &model,
        MavMessage::PARAM_SET(set("MASS", 0.6)),
    );
    assert_eq!(value(&refused), Some(("MASS".into(), 0.52)));
    assert_eq!(
        error(&refused),
        Some(MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED)
    );
    assert_eq!(
        texts(&refused),
        "this bridge only observes: start it with --allow-control\n"
    );
    assert!(vehicle.requests.is_empty());

    let (mut vehicle, _) = joined(true, &model);
    // The plant's answer is the acknowledgement, and a repetition before it asks nothing again.
    for _ in 0..2 {
        assert_eq!(
            answers(
                &mut vehicle,
                &model,
                MavMessage::PARAM_SET(set("ROT_DRAG", 0.315))
            ),
            []
        );
    }
    let [request] = &std::mem::take(&mut vehicle.requests)[..] else {
        panic!("not one request");
    };
    assert_eq!(request.what, "rotational_drag_nm_s=0.315");
    vehicle.answered(request, &Ok("applied".into()), &model, NOW);
    assert_eq!(value(&vehicle.messages), Some(("ROT_DRAG".into(), 0.315)));
    vehicle.messages.clear();

    answers(
        &mut vehicle,
        &model,
        MavMessage::PARAM_SET(set("MASS", 99.0)),
    );
    let request = vehicle.requests.remove(0);
    vehicle.answered(
        &request,
        &Err("mass_kg = 99 is out of range".into()),
        &model,
        NOW,
    );
    let refused = std::mem::take(&mut vehicle.messages);
    assert_eq!(value(&refused), Some(("MASS".into(), 0.52)));
    assert_eq!(
        error(&refused),
        Some(MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
    );
    assert_eq!(texts(&refused), "mass_kg = 99 is out of range\n");

    for (name, expected, words) in [
        (
            "NOTHING",
            MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
            "there is no parameter `NOTHING`\n",
        ),
        (
            FAILURES_ENABLED,
            MavParamError::MAV_PARAM_ERROR_READ_ONLY,
            "SYS_FAILURE_EN says whether --allow-control was given\n",
        ),
    ] {
        let refused = answers(&mut vehicle, &model, MavMessage::PARAM_SET(set(name, 1.0)));
        assert_eq!(
            (error(&refused), texts(&refused)),
            (Some(expected), words.to_owned())
        );
    }
    let whole = PARAM_SET_DATA {
        param_type: MavParamType::MAV_PARAM_TYPE_INT32,
        ..set("WIND_X", 1.0)
    };
    let refused = answers(&mut vehicle, &model, MavMessage::PARAM_SET(whole));
    let mismatch = Some(MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH);
    assert_eq!(error(&refused), mismatch);
    assert!(vehicle.requests.is_empty());
}

#[test]
fn commands_get_the_result_that_they_deserve() {
    use MavCmd::*;
    use MavResult::*;
    let mut model = model();
    let fixed =
        "the trajectory of this flight is fixed: `ironbird fly --trajectory` says what flies\n";
    let ends = "a flight ends after its duration, or by Ctrl-C where `ironbird fly` runs\n";
    let read_only = "this bridge only observes: start it with --allow-control\n";
    let no_flight = "no flight is running; start one: ironbird fly\n";
    let failure = [4.0, 7.0, 0.0];
    for (allows_control, name, parameters, expected, words) in [
        (
            false,
            MAV_CMD_COMPONENT_ARM_DISARM,
            [1.0, 0.0, 0.0],
            MAV_RESULT_ACCEPTED,
            "",
        ),
        (
            true,
            MAV_CMD_COMPONENT_ARM_DISARM,
            [0.0; 3],
            MAV_RESULT_DENIED,
            ends,
        ),
        (
            true,
            MAV_CMD_DO_FLIGHTTERMINATION,
            [1.0, 0.0, 0.0],
            MAV_RESULT_DENIED,
            ends,
        ),
        (
            true,
            MAV_CMD_NAV_TAKEOFF,
            [0.0; 3],
            MAV_RESULT_DENIED,
            fixed,
        ),
        (true, MAV_CMD_NAV_LAND, [0.0; 3], MAV_RESULT_DENIED, fixed),
        (
            true,
            MAV_CMD_DO_REPOSITION,
            [0.0; 3],
            MAV_RESULT_DENIED,
            fixed,
        ),
        (
            true,
            MAV_CMD_DO_SET_MODE,
            [0.0; 3],
            MAV_RESULT_DENIED,
            fixed,
        ),
        (
            true,
            MAV_CMD_PREFLIGHT_CALIBRATION,
            [0.0; 3],
            MAV_RESULT_UNSUPPORTED,
            "MAV_CMD_PREFLIGHT_CALIBRATION is not supported\n",
        ),
        (
            false,
            MAV_CMD_INJECT_FAILURE,
            failure,
            MAV_RESULT_DENIED,
            read_only,
        ),
        (
            false,
            MAV_CMD_INJECT_FAILURE,
            [4.0, 0.0, 0.0],
            MAV_RESULT_DENIED,
            read_only,
        ),
        (
            true,
            MAV_CMD_INJECT_FAILURE,
            [7.0, 1.0, 0.0],
            MAV_RESULT_UNSUPPORTED,
            "unit 7 cannot fail here\n",
        ),
    ] {
        let (mut vehicle, _) = joined(allows_control, &model);
        let answered = answers(&mut vehicle, &model, command(name, parameters));
        assert_eq!(
            result(&answered),
            (Some(expected), words.to_owned()),
            "{name:?}"
        );
        assert!(vehicle.requests.is_empty());
        let MavMessage::COMMAND_LONG(long) = command(name, parameters) else {
            unreachable!();
        };
        let int = MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            command: name,
            param1: long.param1,
            param2: long.param2,
            param3: long.param3,
            target_system: 1,
            target_component: 1,
            ..COMMAND_INT_DATA::default()
        });
        assert_eq!(
            result(&answers(&mut vehicle, &model, int)).0,
            Some(expected),
            "{name:?}"
        );
    }
    flight(&mut model).ending = Some(EndReason::Completed);
    let (mut vehicle, _) = joined(true, &model);
    for (name, parameters) in [
        (MAV_CMD_INJECT_FAILURE, failure),
        (MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0]),
    ] {
        let answered = answers(&mut vehicle, &model, command(name, parameters));
        assert_eq!(result(&answered).0, Some(MAV_RESULT_TEMPORARILY_REJECTED));
    }
    let refused = answers(
        &mut vehicle,
        &model,
        MavMessage::PARAM_SET(set("MASS", 0.6)),
    );
    assert_eq!(
        error(&refused),
        Some(MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED)
    );
    let (mut vehicle, _) = joined(true, &model);
    let refused = answers(
        &mut vehicle,
        &model,
        MavMessage::PARAM_SET(set("MASS", 0.6)),
    );
    assert_eq!(texts(&refused), no_flight);
}

#[test]
fn failures_begin_and_end_by_the_answers_of_the_plant() {
    use MavResult::*;
    let model = model();
    let (mut vehicle, _) = joined(true, &model);
    let inject = |kind: f32| command(MavCmd::MAV_CMD_INJECT_FAILURE, [4.0, kind, 0.0]);
    let mut asked = |kind: f32, answer: Result<&str, &str>| {
        assert_eq!(answers(&mut vehicle, &model, inject(kind)), []);
        let request = vehicle.requests.pop().unwrap();
        vehicle.answered(
            &request,
            &answer.map(str::to_owned).map_err(str::to_owned),
            &model,
            NOW,
        );
        let (result, text) = result(&std::mem::take(&mut vehicle.messages));
        (request.what, result.unwrap(), text)
    };
    let accepted = |what: &str| (what.to_owned(), MAV_RESULT_ACCEPTED, String::new());
    assert_eq!(asked(7.0, Ok("")), accepted("outer.state.drop=0.2"));
    let refused = (
        "outer.state.drop=9/10".into(),
        MAV_RESULT_DENIED,
        "they overlap\n".into(),
    );
    assert_eq!(asked(5.0, Err("they overlap")), refused);
    assert_eq!(asked(6.0, Ok("")), accepted("outer.state.lag=20"));
    assert_eq!(
        asked(0.0, Ok("")),
        accepted("outer.state.drop=off,outer.state.lag=off")
    );
    // Nothing is left to end.
    let ended = answers(&mut vehicle, &model, inject(0.0));
    assert_eq!(result(&ended).0, Some(MAV_RESULT_ACCEPTED));
    assert!(vehicle.requests.is_empty());
}

#[test]
fn what_is_for_others_or_for_all_changes_nothing() {
    let model = model();
    let (mut vehicle, _) = joined(true, &model);
    let own = MavHeader {
        system_id: 1,
        component_id: 1,
        sequence: 0,
    };
    for (header, target_system, target_component) in [
        (STATION, 2, 1),
        (STATION, 0, 1),
        (STATION, 0, 0),
        (STATION, 1, 191),
        (own, 1, 1),
    ] {
        let it = PARAM_SET_DATA {
            target_system,
            target_component,
            ..set("MASS", 0.6)
        };
        let MavMessage::COMMAND_LONG(fail) =
            command(MavCmd::MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 1.0])
        else {
            unreachable!();
        };
        let fail = COMMAND_LONG_DATA {
            target_system,
            target_component,
            ..fail
        };
        for message in [MavMessage::PARAM_SET(it), MavMessage::COMMAND_LONG(fail)] {
            vehicle.receive(&header, &message, &model, NOW);
        }
        assert!(
            vehicle.messages.is_empty() && vehicle.requests.is_empty(),
            "{header:?} {target_system} {target_component}"
        );
    }
    // What is only read may be requested of all.
    let list = MavMessage::PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA::default());
    assert_eq!(answers(&mut vehicle, &model, list).len(), 33);
    let target = SET_POSITION_TARGET_LOCAL_NED_DATA {
        target_system: 1,
        target_component: 1,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::default()
    };
    let target = MavMessage::SET_POSITION_TARGET_LOCAL_NED(target);
    let refused = answers(&mut vehicle, &model, target.clone());
    assert_eq!(
        texts(&refused),
        "the trajectory of this flight is fixed: setpoints have no effect\n"
    );
    // A stream of them is refused once a second, and so is one of made-up names after the first few.
    assert_eq!(answers(&mut vehicle, &model, target), []);
    let unknown = |number: u32| MavMessage::PARAM_SET(set(&format!("X{number}"), 0.0));
    let refused: Vec<_> = (0..100)
        .flat_map(|it| answers(&mut vehicle, &model, unknown(it)))
        .collect();
    assert_eq!(texts(&refused).lines().count(), 19);
}

#[test]
fn events_misses_and_the_end_are_reported_once() {
    let mut model = model();
    let (mut vehicle, messages) = joined(false, &model);
    assert_eq!(texts(&messages), "ironbird flies lissajous\n");
    let mut later = |model: &Model, ms: u64| {
        vehicle.update(model, NOW + Duration::from_millis(ms));
        texts(&std::mem::take(&mut vehicle.messages))
    };
    assert_eq!(later(&model, 1000), "");
    let seen = flight(&mut model);
    (seen.run.tick, seen.run.deadlines_missed) = (1700, 7);
    let news = later(&model, 2000);
    assert_eq!(
        news,
        "1.600 s: fault inner.late=1ms\n3 missed deadlines, 7 in all\n"
    );
    assert_eq!(later(&model, 3000), "");
    let seen = flight(&mut model);
    let killed = "inner was killed by the fault, and is started again";
    seen.supervision.add(1650, Subject::Process, killed);
    for (tick, channel) in [(1660, Channel::A), (1661, Channel::B)] {
        let command = TakenCommand {
            of_tick: tick,
            channel: channel as u64,
            is_offered: 1,
            ..TakenCommand::default()
        };
        let decision = Decision {
            count: 1,
            command,
            ..Decision::default()
        };
        let state = State {
            decision,
            ..State::default()
        };
        seen.take(&LogEntry::State(entry(tick, state)));
    }
    let handed_over = "1.661 s: channel b flies in place of channel a\n";
    assert_eq!(
        later(&model, 4000),
        format!("1.650 s: {killed}\n{handed_over}")
    );
    flight(&mut model).ending = Some(EndReason::Attitude);
    let end = later(&model, 4010);
    assert!(
        end.starts_with("the flight has ended: left the envelope: tilt beyond its limit; "),
        "{end}"
    );
    assert_eq!(later(&model, 5000), "");
}

#[test]
fn long_texts_come_in_parts_of_which_the_last_is_not_full() {
    let model = model();
    let (mut vehicle, _) = joined(true, &model);
    for length in [1, 49, 50, 51, 99, 100, 101, 250] {
        let reason = "x".repeat(length);
        answers(
            &mut vehicle,
            &model,
            MavMessage::PARAM_SET(set("MASS", length as f32)),
        );
        let request = vehicle.requests.pop().unwrap();
        vehicle.answered(&request, &Err(reason.clone()), &model, NOW);
        let messages = std::mem::take(&mut vehicle.messages);
        assert_eq!(texts(&messages).trim_end(), reason);
        let parts = messages.iter().filter_map(|it| match it {
            MavMessage::STATUSTEXT(it) => Some(it.clone()),
            _ => None,
        });
        let parts: Vec<STATUSTEXT_DATA> = parts.collect();
        assert_eq!(parts.len() > 1, length > 50);
        let is_whole = |it: &STATUSTEXT_DATA| it.text.to_str().unwrap().len() < 50 || it.id == 0;
        assert!(is_whole(parts.last().unwrap()), "{length}");
        assert!(
            parts
                .iter()
                .enumerate()
                .all(|(place, it)| usize::from(it.chunk_seq) == place)
        );
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
    let both = [frame(&message), v1.raw_bytes().to_vec(), signed.clone()].concat();
    assert_eq!(read(&both), [false, false, true]);
    // Half a frame at the end of a datagram does not reach into the next one.
    assert_eq!(read(&both[..both.len() - 1]), [false, false]);
    assert_eq!(read(&frame(&message)), [false]);

    let model = model();
    let (mut vehicle, _) = joined(true, &model);
    vehicle.refuse_signed(NOW);
    let words = "signed frames are ignored: no key can be checked here; switch signing off\n";
    assert_eq!(texts(&std::mem::take(&mut vehicle.messages)), words);
    let signing = SETUP_SIGNING_DATA {
        target_system: 1,
        target_component: 1,
        ..SETUP_SIGNING_DATA::default()
    };
    let refused = answers(&mut vehicle, &model, MavMessage::SETUP_SIGNING(signing));
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

/// What a frame of MAVLink 2 asks the plant for if it is addressed to the vehicle, read by hand from the protocol's
/// description. 23 is PARAM_SET, 75 COMMAND_INT, 76 COMMAND_LONG.
fn may_change(frame: &[u8]) -> bool {
    let crc_extra = |id: u32| match id {
        23 => Some((168, 4)),
        75 => Some((158, 30)),
        76 => Some((152, 30)),
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
        && (a == 23 || u16::from_le_bytes([byte(28), byte(29)]) == 420)
}

/// A million frames, random and mutated, of which many have a right checksum: nothing panics, nothing is asked of the plant
/// that was not addressed to the vehicle, and a vehicle that only observes asks for nothing.
#[test]
fn a_million_frames_change_nothing_that_they_may_not() {
    let model = model();
    let (mut vehicle, _) = joined(true, &model);
    let (mut observer, _) = joined(false, &model);
    let mut random = fastrand::Rng::with_seed(1);
    let motor = [101.0, 1.0, 2.0];
    let MavMessage::COMMAND_LONG(long) = command(MavCmd::MAV_CMD_INJECT_FAILURE, motor) else {
        unreachable!();
    };
    let int = COMMAND_INT_DATA {
        command: long.command,
        param1: long.param1,
        param2: long.param2,
        target_system: 1,
        ..COMMAND_INT_DATA::default()
    };
    let seeds = [
        MavMessage::PARAM_SET(set("MASS", 0.6)),
        MavMessage::COMMAND_LONG(long.clone()),
        MavMessage::COMMAND_INT(int),
        command(MavCmd::MAV_CMD_REQUEST_MESSAGE, [148.0, 0.0, 0.0]),
        command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, [30.0, 50_000.0, 0.0]),
        MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
            target_system: 1,
            ..PARAM_REQUEST_READ_DATA::default()
        }),
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
            target_system: 1,
            ..SET_POSITION_TARGET_LOCAL_NED_DATA::default()
        }),
    ];
    let seeds = seeds.map(|message| {
        use mavlink::Message as _;
        (frame(&message), MavMessage::extra_crc(message.message_id()))
    });
    let (mut accepted, mut asked, mut parsed) = (0, 0, 0);
    for round in 0..1_000_000_u32 {
        let (seed, extra) = random.choice(&seeds).unwrap();
        let mut bytes = seed.clone();
        let body = bytes.len() - 2;
        match round % 4 {
            0 => bytes = (0..random.usize(..300)).map(|_| random.u8(..)).collect(),
            1 => *random.choice(&mut bytes).unwrap() = random.u8(..),
            2 => bytes.truncate(random.usize(..body)),
            // Other content with a right checksum.
            _ => {
                for _ in 0..random.usize(..4) {
                    let place = random.usize(3..body);
                    bytes[place] = if random.bool() {
                        random.u8(..)
                    } else {
                        random.u8(..3)
                    };
                }
            }
        }
        if round % 4 == 3 || (round % 4 == 1 && random.bool()) {
            let crc = mavlink::calculate_crc(&bytes[1..body], *extra);
            bytes[body..].copy_from_slice(&crc.to_le_bytes());
        }
        let mut received = Vec::new();
        frames(&bytes, &mut |frame| received.push(frame));
        for frame in received {
            parsed += 1;
            let Frame::Message(header, message) = frame else {
                continue;
            };
            vehicle.receive(&header, &message, &model, NOW);
            observer.receive(&header, &message, &model, NOW);
        }
        let requests = std::mem::take(&mut vehicle.requests);
        let may = round % 4 != 0 && may_change(&bytes);
        accepted += u32::from(may);
        asked += requests.len() as u32;
        for request in &requests {
            assert!(may, "{request:?} by {bytes:?}");
            check(request);
            let answer = if random.bool() {
                Ok(String::new())
            } else {
                Err("no".into())
            };
            vehicle.answered(request, &answer, &model, NOW);
        }
        vehicle.messages.clear();
        observer.messages.clear();
        assert!(observer.requests.is_empty());
    }
    // The oracle and the vehicle both see many of them.
    assert!(
        parsed > 250_000 && accepted > 50_000 && asked > 50_000,
        "{parsed} {accepted} {asked}"
    );
}

/// A request is one that `ironbird inject` can read, or a number that is none.
fn check(request: &Request) {
    let text = &request.what;
    if !(text.contains("NaN") || text.contains("inf")) {
        parse_line(text).unwrap_or_else(|why| panic!("{text}: {why}"));
    }
    let parameter = text.split('=').next().unwrap();
    let is_parameter = Parameter::from_name(parameter).is_ok();
    assert!(
        is_parameter
            || text.contains(".state.")
            || text.starts_with("state.")
            || text.starts_with("setpoint.")
            || text.starts_with("rotor_speeds."),
        "{text}"
    );
}
