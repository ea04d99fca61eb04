//! The vehicle without a flight: its model is fed with made-up messages, and its link with frames. Conversations with it are
//! in `snapshots/`: `INSTA_UPDATE=always cargo test -p live --features mavlink` accepts a change.

use std::fmt::Write as _;
use std::io::Read as _;
use std::mem::take;
use std::net::{Ipv4Addr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use MavCmd::*;
use analysis::faults::InjectedFault;
use flight_log::entry::LogEntry;
use insta::assert_snapshot;
use mavlink::dialects::common::*;
use mavlink::types::CharArray;
use mavlink::{
    MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, Message as _, MessageData as _,
};
use messages::blackboards::{EndReason, Run, Subject};
use messages::content::{Measured, Reference, RotorSpeeds, Setpoint, State};
use messages::parameters::{Parameter, SPECS};
use messages::role::Channel;

use super::failures::FAILURES;
use super::link::{Address, Frame, Link, frames};
use super::offboard::Mode;
use super::parameters::FAILURES_ENABLED;
use super::protocol::{Purpose, Request, Vehicle, What};
use super::telemetry::{self, streams};
use crate::inject::parse_line;
use crate::made_up::{flight, joined, message, run, take_command};
use crate::watch::dashboard_model::{Model, WatchedFlight};

const STATION: MavHeader = MavHeader {
    system_id: 255,
    component_id: 190,
    sequence: 0,
};
const NOW: Duration = Duration::from_secs(10);

/// A flight at tick 1500 that is 3 m ahead, 1 m left and 2 m up, turned to the left.
fn model(trajectory: &str) -> Model {
    let trajectory = format!("{trajectory:?}");
    let run = Run {
        tick: 1500,
        deadlines_missed: 4,
        ..run()
    };
    let settings = [
        ("flight.trajectory", trajectory.as_str()),
        ("flight.faults", r#"["inner.late=1ms@1.6s"]"#),
    ];
    let mut model = joined(&run, &settings);
    let flight = flight(&mut model);
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
    flight.take(&LogEntry::State(message(1500, state)));
    let reference = Reference {
        position_w_m: [3.0, 1.5, 2.0],
        yaw_rad: 1.5,
        ..Reference::default()
    };
    let setpoint = Setpoint {
        reference,
        ..Setpoint::default()
    };
    flight.take(&LogEntry::Setpoint(message(1500, setpoint)));
    let speeds = RotorSpeeds {
        speed_rad_s: [30.0, 190.0, 350.0, 190.0],
        ..RotorSpeeds::default()
    };
    flight.take(&LogEntry::RotorSpeeds(message(1500, speeds)));
    model
}

#[test]
fn a_vehicle_has_landed_where_it_stands_and_after_the_flight() {
    let mut model = model("hover");
    let flight = flight(&mut model);
    let lowest_m = flight.settings.flight.ground_z_m + flight.settings.ground.leg_m;
    let mut landed = |height_m: f64, ending| {
        let mut state = flight.state.unwrap();
        state.truth.position_w_m[2] = lowest_m + height_m;
        flight.take(&LogEntry::State(message(1501, state)));
        flight.ending = ending;
        let id = EXTENDED_SYS_STATE_DATA::ID;
        match telemetry::message(id, flight, Mode::Hold) {
            Some(MavMessage::EXTENDED_SYS_STATE(it)) => it.landed_state,
            other => panic!("{other:?}"),
        }
    };
    use MavLandedState::*;
    assert_eq!(landed(0.02, None), MAV_LANDED_STATE_IN_AIR);
    assert_eq!(landed(0.01 - 1e-9, None), MAV_LANDED_STATE_ON_GROUND);
    let ended = Some(EndReason::Completed);
    assert_eq!(landed(1.0, ended), MAV_LANDED_STATE_ON_GROUND);
}

#[test]
fn the_page_of_ground_stations_has_every_parameter_and_failure() {
    let page = include_str!("../../../../docs/ground-station.md");
    let names = SPECS.iter();
    let names = names.map(|spec| format!("| {} | `{}` |", spec.mavlink, spec.name));
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

/// A conversation of a ground station and the plant with a vehicle that has joined a flight.
struct Conversation {
    vehicle: Vehicle,
    model: Model,
    /// Requests that the plant has not answered yet.
    asked: Vec<Request>,
    text: String,
}

impl Conversation {
    /// Without what the vehicle sends when it joins the flight.
    fn new(trajectory: &str, allows_control: bool) -> Self {
        let mut begun = Self {
            vehicle: Vehicle::new(allows_control),
            model: model(trajectory),
            asked: Vec::new(),
            text: format!("# {trajectory}, allows control: {allows_control}\n"),
        };
        begun.vehicle.update(&begun.model, NOW);
        begun.vehicle.outbox.messages.clear();
        begun
    }

    fn flight(&mut self) -> &mut WatchedFlight {
        self.model.flight.as_mut().unwrap()
    }

    /// Notes what the vehicle sends and what it asks of the plant.
    fn note(&mut self) -> Vec<MavMessage> {
        let messages = take(&mut self.vehicle.outbox.messages);
        for message in &messages {
            let target = message
                .target_system_id()
                .zip(message.target_component_id());
            assert!(matches!(target, None | Some((255, 190))), "{message:?}");
            match message {
                MavMessage::STATUSTEXT(it) if it.chunk_seq > 0 => {
                    self.text.truncate(self.text.len() - 1);
                    self.text += it.text.to_str().unwrap();
                    self.text += "\n";
                }
                _ => writeln!(self.text, "  {}", described(message)).unwrap(),
            }
        }
        for request in self.vehicle.requests.drain(..) {
            assert_eq!(request.run_id, 7);
            match &request.what {
                What::Line(line) => writeln!(self.text, "  asks: {line}"),
                What::Target(order) => writeln!(self.text, "  asks: {order:?}"),
            }
            .unwrap();
            self.asked.push(request);
        }
        messages
    }

    fn send(&mut self, message: &MavMessage) -> Vec<MavMessage> {
        writeln!(self.text, "> {}", described(message)).unwrap();
        self.vehicle.receive(&STATION, message, &self.model, NOW);
        self.note()
    }

    fn command(&mut self, name: MavCmd, parameters: [f32; 3]) -> Vec<MavMessage> {
        self.send(&command(name, parameters))
    }

    /// Selects the mode offboard, of which nothing is noted.
    fn offboard(&mut self) {
        let offboard = command(MAV_CMD_DO_SET_MODE, OFFBOARD);
        self.vehicle.receive(&STATION, &offboard, &self.model, NOW);
        self.vehicle.outbox.messages.clear();
    }

    fn request(&mut self, id: u32, of: u32) -> Vec<MavMessage> {
        self.command(MAV_CMD_REQUEST_MESSAGE, [id as f32, of as f32, 0.0])
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

    /// Injects a failure of the GPS.
    fn fail(&mut self, kind: u8) {
        self.command(MAV_CMD_INJECT_FAILURE, [4.0, kind.into(), 0.0]);
    }

    /// Lets the plant answer the oldest request.
    fn plant(&mut self, answer: Result<&str, &str>) -> Vec<MavMessage> {
        writeln!(self.text, "plant: {answer:?}").unwrap();
        let answer = answer.map(str::to_owned).map_err(str::to_owned);
        let request = self.asked.remove(0);
        self.vehicle.answered(&request, &answer, &self.model, NOW);
        self.note()
    }

    /// Notes the texts that the vehicle sends so much later.
    fn later(&mut self, ms: u64) {
        writeln!(self.text, "{ms} ms").unwrap();
        self.vehicle
            .update(&self.model, NOW + Duration::from_millis(ms));
        let is_text = |it: &MavMessage| matches!(it, MavMessage::STATUSTEXT(_));
        self.vehicle.outbox.messages.retain(is_text);
        self.note();
    }
}

/// A message in a line, without its zeros and its target.
fn described(message: &MavMessage) -> String {
    let text = format!("{message:?}");
    let text = match message {
        MavMessage::STATUSTEXT(it) => {
            return format!("{:?}: {}", it.severity, it.text.to_str().unwrap());
        }
        MavMessage::SETUP_SIGNING(_) | MavMessage::SET_POSITION_TARGET_LOCAL_NED(_) => {
            return message.message_name().into();
        }
        MavMessage::PARAM_REQUEST_READ(it) => with_text(&text, &it.param_id),
        MavMessage::PARAM_SET(it) => with_text(&text, &it.param_id),
        MavMessage::PARAM_VALUE(it) => with_text(&text, &it.param_id),
        MavMessage::PARAM_ERROR(it) => with_text(&text, &it.param_id),
        MavMessage::AVAILABLE_MODES(it) => with_text(&text, &it.mode_name),
        _ => text,
    };
    let fields = text[text.find('{').unwrap()..].trim_matches(['{', '}', ')', ' ']);
    let is_shown = |field: &&str| {
        let is_zero = field.ends_with(": 0") || field.ends_with(": 0.0");
        !is_zero && !field.starts_with("target_")
    };
    let fields = fields.split(", ").filter(is_shown).collect::<Vec<_>>();
    format!("{} {}", message.message_name(), fields.join(", "))
}

/// Replaces a name's bytes.
fn with_text<const N: usize>(text: &str, name: &CharArray<N>) -> String {
    text.replace(&format!("{name:?}"), name.to_str().unwrap())
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

fn command_int(command: MavCmd, [param1, param2, param3]: [f32; 3]) -> COMMAND_INT_DATA {
    COMMAND_INT_DATA {
        command,
        param1,
        param2,
        param3,
        target_system: 1,
        ..COMMAND_INT_DATA::default()
    }
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

#[test]
fn a_ground_station_can_connect_as_qgroundcontrol_does() {
    let mut it = Conversation::new("lissajous", false);
    it.vehicle = Vehicle::new(false);
    it.vehicle.update(&Model::new("left", false, false), NOW);
    assert_eq!(it.note(), [], "a vehicle without a flight");
    it.vehicle.update(&it.model, NOW);
    let first = it.note();
    for (id, _) in streams() {
        assert!(first.iter().any(|it| it.message_id() == id), "{id}");
    }
    let modes = AVAILABLE_MODES_DATA::ID;
    for (id, of) in [
        (modes, 1),
        (modes, 2),
        (CURRENT_MODE_DATA::ID, 0),
        (COMPONENT_METADATA_DATA::ID, 0),
    ] {
        it.request(id, of);
    }
    let list = it.send(&to_the_vehicle(PARAM_REQUEST_LIST_DATA::ID));
    for (index, name) in [(-1, "MASS"), (-1, FAILURES_ENABLED), (33, ""), (-2, "")] {
        it.read(index, name);
    }
    it.send(&MavMessage::MISSION_REQUEST_LIST(
        MISSION_REQUEST_LIST_DATA {
            target_system: 1,
            mission_type: MavMissionType::MAV_MISSION_TYPE_RALLY,
            ..MISSION_REQUEST_LIST_DATA::default()
        },
    ));
    it.send(&to_the_vehicle(MISSION_CLEAR_ALL_DATA::ID));
    assert_snapshot!("connect", it.text);

    for (index, message) in (0..).zip(&list) {
        let MavMessage::PARAM_VALUE(value) = message else {
            panic!("{message:?}");
        };
        let name = value.param_id.to_str().unwrap();
        assert_eq!(it.read(-1, name), std::slice::from_ref(message));
        assert_eq!(it.read(index, ""), std::slice::from_ref(message));
    }
    let version = it.request(AUTOPILOT_VERSION_DATA::ID, 0);
    let [_, MavMessage::AUTOPILOT_VERSION(version)] = &version[..] else {
        panic!("{version:?}");
    };
    let fence = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE;
    let rally = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY;
    assert!(!version.capabilities.intersects(fence | rally));
}

#[test]
fn telemetry_comes_as_often_as_requested() {
    let mut it = Conversation::new("lissajous", false);
    let [attitude, hud] = [ATTITUDE_DATA::ID, VFR_HUD_DATA::ID];
    let [heartbeat, estimator] = [HEARTBEAT_DATA::ID, ESTIMATOR_STATUS_DATA::ID];
    for (id, us) in [
        (attitude, -1.0),
        (hud, 20_000.0),
        (hud, 100.0),
        (hud, f32::NAN),
        (heartbeat, -1.0),
        (attitude, 3.6e9),
        (estimator, 0.0),
    ] {
        it.command(MAV_CMD_SET_MESSAGE_INTERVAL, [id as f32, us, 0.0]);
    }
    for id in [attitude, hud, estimator] {
        it.request(MESSAGE_INTERVAL_DATA::ID, id);
    }
    assert_snapshot!("intervals", it.text);
    let mut sent = Vec::new();
    for ms in 0..1000 {
        it.vehicle
            .update(&it.model, NOW + Duration::from_millis(ms));
        sent.extend(
            it.vehicle
                .outbox
                .messages
                .drain(..)
                .map(|it| it.message_id()),
        );
    }
    let count = |id| sent.iter().filter(|it| **it == id).count();
    assert_eq!([attitude, hud].map(count), [0, 50]);
}

#[test]
fn a_parameter_is_set_if_the_plant_takes_it_and_otherwise_the_old_value_is_sent() {
    let [mut observer, mut it] = [false, true].map(|may| Conversation::new("lissajous", may));
    observer.set("MASS", 0.6);
    // A repetition before the plant's answer asks nothing again.
    it.set("ROT_DRAG", 0.315);
    it.set("ROT_DRAG", 0.315);
    it.plant(Ok("applied"));
    it.set("MASS", 99.0);
    it.plant(Err("mass_kg = 99 is out of range"));
    it.send(&MavMessage::PARAM_SET(PARAM_SET_DATA {
        param_type: MavParamType::MAV_PARAM_TYPE_INT32,
        ..set("WIND_X", 1.0)
    }));
    it.set("MASS", f32::NAN);
    it.set("NOTHING", 1.0);
    it.set(FAILURES_ENABLED, 1.0);
    it.flight().ending = Some(EndReason::Completed);
    it.text += "the flight ends\n";
    it.set("MASS", 0.6);
    it.command(MAV_CMD_INJECT_FAILURE, [4.0, 7.0, 0.0]);
    it.command(MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0]);
    assert_snapshot!("parameters", observer.text + &it.text);
}

#[test]
fn commands_get_the_result_that_they_deserve() {
    let (none, first) = ([0.0; 3], [1.0, 0.0, 0.0]);
    let mut text = String::new();
    for (allows_control, name, parameters) in [
        (false, MAV_CMD_COMPONENT_ARM_DISARM, first),
        (true, MAV_CMD_COMPONENT_ARM_DISARM, none),
        (true, MAV_CMD_DO_FLIGHTTERMINATION, first),
        (true, MAV_CMD_NAV_TAKEOFF, none),
        (true, MAV_CMD_NAV_LAND, none),
        (true, MAV_CMD_DO_REPOSITION, none),
        (true, MAV_CMD_DO_SET_MODE, none),
        (true, MAV_CMD_PREFLIGHT_CALIBRATION, none),
        (false, MAV_CMD_INJECT_FAILURE, [4.0, 7.0, 0.0]),
        (false, MAV_CMD_INJECT_FAILURE, [4.0, 0.0, 0.0]),
        (true, MAV_CMD_INJECT_FAILURE, [7.0, 1.0, 0.0]),
        (true, MAV_CMD_INJECT_FAILURE, [4.0, 8.0, 0.0]),
        (true, MAV_CMD_INJECT_FAILURE, [101.0, 2.0, 1.0]),
        (true, MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 5.0]),
        (true, MAV_CMD_INJECT_FAILURE, [102.0, 1.0, 2.0]),
        (true, MAV_CMD_INJECT_FAILURE, [0.5, 1.0, 0.0]),
        (true, MAV_CMD_INJECT_FAILURE, [4.0, f32::NAN, 0.0]),
        (true, MAV_CMD_INJECT_FAILURE, [4.0, 1.0, -1.0]),
        (true, MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 3.0]),
        (true, MAV_CMD_INJECT_FAILURE, [101.0, 0.0, 0.0]),
    ] {
        let int = MavMessage::COMMAND_INT(command_int(name, parameters));
        let [long, int] = [command(name, parameters), int].map(|message| {
            let mut it = Conversation::new("lissajous", allows_control);
            let answer = it.send(&message);
            let asked: Vec<What> = it.asked.into_iter().map(|it| it.what).collect();
            (it.text, (answer, asked))
        });
        assert_eq!(long.1, int.1, "{name:?}");
        text += &long.0;
    }
    assert_snapshot!("commands", text);
}

#[test]
fn failures_begin_and_end_by_the_answers_of_the_plant() {
    let mut parts = [(); 3].map(|()| Conversation::new("lissajous", true));
    let [one, two, three] = &mut parts;
    for (kind, answer) in [
        (7, Ok("")),
        (5, Err("they overlap")),
        (6, Ok("")),
        (0, Ok("")),
    ] {
        one.fail(kind);
        one.plant(answer);
    }
    // Nothing is left to end.
    one.fail(0);

    two.fail(7);
    // It waits for what begins.
    two.fail(0);
    two.plant(Ok(""));
    // The last one begins again, because `ironbird inject` has ended it; each ends once.
    for kind in [6, 7] {
        two.fail(kind);
        two.plant(Ok(""));
    }
    two.fail(0);

    // Of another unit, which goes on.
    three.command(MAV_CMD_INJECT_FAILURE, [0.0, 2.0, 0.0]);
    three.plant(Ok(""));
    for kind in [6, 7] {
        three.fail(kind);
        three.plant(Ok(""));
    }
    let now = three.flight().tick();
    let fault = |what: &str, end| InjectedFault::new(what.into(), 0, end, 1e-3);
    three.flight().injected = vec![
        fault("outer.state.lag=20", Some(now)),
        fault("outer.state.drop=0.2", Some(now + 1)),
        fault("outer.state.lag=off", None),
    ];
    three.text += "`ironbird inject` ends outer.state.lag=20\n";
    three.fail(0);
    assert_snapshot!("failures", parts.map(|it| it.text).concat());
}

#[test]
fn requests_without_end_are_not_answered_without_end() {
    let mut it = Conversation::new("lissajous", false);
    let list = to_the_vehicle(PARAM_REQUEST_LIST_DATA::ID);
    for _ in 0..10_000 {
        it.vehicle.receive(&STATION, &list, &it.model, NOW);
    }
    assert!(it.vehicle.outbox.messages.len() < 1100);
}

#[test]
fn what_is_for_others_or_for_all_changes_nothing() {
    let mut it = Conversation::new("lissajous", true);
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
        let fail = command(MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 1.0]);
        for mut message in [MavMessage::PARAM_SET(set("MASS", 0.6)), fail] {
            *message.target_system_id_mut().unwrap() = system;
            *message.target_component_id_mut().unwrap() = component;
            it.vehicle.receive(&header, &message, &it.model, NOW);
        }
        assert_eq!(it.note(), [], "{system} {component}");
        assert_eq!(it.asked, [], "{system} {component}");
    }
    // A broadcast may request values.
    let list = PARAM_REQUEST_LIST_DATA::default();
    assert_eq!(it.send(&MavMessage::PARAM_REQUEST_LIST(list)).len(), 33);
}

#[test]
fn refusals_are_said_once_a_second() {
    let mut it = Conversation::new("lissajous", true);
    for id in [
        SET_POSITION_TARGET_LOCAL_NED_DATA::ID,
        SETUP_SIGNING_DATA::ID,
    ] {
        for _ in 0..2 {
            it.send(&to_the_vehicle(id));
        }
    }
    it.vehicle.refuse_signed(NOW);
    it.note();
    assert_snapshot!("refusals", it.text);
    // A stream of made-up names is refused after the first few, too.
    let refused = (0..100).flat_map(|name| it.set(&format!("X{name}"), 0.0));
    let texts = refused.filter(|it| matches!(it, MavMessage::STATUSTEXT(_)));
    assert_eq!(texts.count(), 17);
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

#[test]
fn in_the_mode_offboard_setpoints_are_targets_until_they_stop() {
    let mut it = Conversation::new("mavlink", true);
    let send = |mask, x| {
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
            x,
            ..setpoint(mask)
        })
    };
    it.request(HEARTBEAT_DATA::ID, 0);
    it.request(AVAILABLE_MODES_DATA::ID, 0);
    it.send(&send(POSITION, 5.1));
    it.command(MAV_CMD_DO_SET_MODE, OFFBOARD);
    for mask in [POSITION, VELOCITY | 1 << 10, BOTH] {
        it.send(&send(mask, 5.1));
        it.plant(Ok(""));
    }
    // While the plant has not answered, the newest one waits.
    for x in [1.0, 2.0, 3.0] {
        it.send(&send(POSITION, x));
    }
    it.plant(Ok(""));
    it.plant(Ok(""));
    // The plant holds the position; shortly after the start it has not yet heard of a target.
    for (tick, ms) in [(2500, 1500), (2501, 2000)] {
        let flight = it.flight();
        flight.take(&LogEntry::State(message(tick, State::default())));
        flight.run.tick = tick;
        it.later(ms);
    }
    let setpoint = send(POSITION, 5.1);
    let now = NOW + Duration::from_secs(5);
    it.vehicle.receive(&STATION, &setpoint, &it.model, now);
    it.note();
    assert_snapshot!("offboard", it.text);
}

#[test]
fn what_is_no_target_is_refused_with_the_reason() {
    const fn mask(bits: u16) -> PositionTargetTypemask {
        PositionTargetTypemask::from_bits_retain(bits)
    }
    let wrong: [fn(&mut SET_POSITION_TARGET_LOCAL_NED_DATA); 11] = [
        |it| it.type_mask = mask(0xfff),
        |it| it.type_mask = mask(BOTH & !(1 << 7)),
        |it| it.type_mask = mask(POSITION & !(1 << 11)),
        |it| it.type_mask = mask(POSITION | 1),
        |it| it.coordinate_frame = MavFrame::MAV_FRAME_BODY_FRD,
        |it| it.x = f32::NAN,
        |it| it.y = 1e6,
        |it| it.z = 0.21,
        |it| it.yaw = f32::INFINITY,
        |it| it.vx = 3.0,
        |it| it.vy = f32::NAN,
    ];
    let mut text = String::new();
    for wrong in wrong {
        let mut it = Conversation::new("mavlink", true);
        let start = it.text.clone();
        it.offboard();
        let mut setpoint = setpoint(BOTH);
        wrong(&mut setpoint);
        it.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint));
        text += &it.text.replace(&start, "");
    }
    assert_snapshot!("no_targets", text);
}

#[test]
fn commands_climb_descend_move_and_hold() {
    let mut it = Conversation::new("mavlink", true);
    let reference = Reference {
        position_w_m: [3.0, 1.5, 2.0],
        ..Reference::default()
    };
    let state = State {
        reference,
        ..State::default()
    };
    it.flight().take(&LogEntry::State(message(1501, state)));
    let nothing = f32::NAN;
    let long = |command, param1, param4, param7| {
        MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command,
            param1,
            param4,
            param5: nothing,
            param6: nothing,
            param7,
            target_system: 1,
            ..COMMAND_LONG_DATA::default()
        })
    };
    let int = |frame, x, y, z| {
        MavMessage::COMMAND_INT(COMMAND_INT_DATA {
            param4: 0.5,
            x,
            y,
            z,
            frame,
            ..command_int(MAV_CMD_DO_REPOSITION, [-1.0, 0.0, 0.0])
        })
    };
    let relative = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT;
    for message in [
        long(MAV_CMD_NAV_TAKEOFF, nothing, nothing, nothing),
        long(MAV_CMD_NAV_TAKEOFF, nothing, 90.0, 7.0),
        long(MAV_CMD_NAV_LAND, nothing, 180.0, nothing),
        long(MAV_CMD_DO_PAUSE_CONTINUE, 0.0, nothing, nothing),
        command(MAV_CMD_DO_SET_MODE, HOLD),
        int(relative, i32::MAX, i32::MAX, 4.0),
        int(MavFrame::MAV_FRAME_GLOBAL, 473_986_403, 85_469_211, nothing),
    ] {
        it.offboard();
        it.send(&message);
        it.plant(Ok(""));
        it.request(CURRENT_MODE_DATA::ID, 0);
    }
    for message in [
        long(MAV_CMD_NAV_TAKEOFF, nothing, nothing, -1.0),
        long(MAV_CMD_DO_REPOSITION, 5.0, nothing, nothing),
        long(MAV_CMD_DO_PAUSE_CONTINUE, 1.0, nothing, nothing),
        command(MAV_CMD_DO_SET_MODE, [1.0, 3.0, 0.0]),
        int(MavFrame::MAV_FRAME_LOCAL_NED, 1, 1, 1.0),
    ] {
        it.send(&message);
    }
    let mut observer = Conversation::new("mavlink", false);
    observer.command(MAV_CMD_DO_SET_MODE, OFFBOARD);
    assert_snapshot!("steering", it.text + &observer.text);
}

#[test]
fn events_misses_and_the_end_are_reported_once() {
    let mut it = Conversation::new("lissajous", false);
    it.later(1000);
    (it.flight().run.tick, it.flight().run.deadlines_missed) = (1700, 7);
    it.later(2000);
    it.later(3000);
    let killed = "inner was killed by the fault, and is started again";
    it.flight().supervision.add(1650, Subject::Process, killed);
    for (tick, channel) in [(1660, Channel::A), (1661, Channel::B)] {
        take_command(it.flight(), tick, channel);
    }
    it.later(4000);
    it.flight().ending = Some(EndReason::Attitude);
    it.later(4010);
    it.later(5000);
    assert_snapshot!("events", it.text);
}

#[test]
fn the_loss_of_a_flight_is_reported_once_and_its_end_with_its_last_state() {
    let mut it = Conversation::new("lissajous", false);
    for (step, height_m) in (1..).zip([0.0, -1.0, -2.0]) {
        let mut state = it.flight().state.unwrap();
        state.truth.position_w_m[2] = height_m;
        let state = message(1500 + step, state);
        it.flight().take(&LogEntry::State(state));
        it.later(1000 * step);
    }
    let said = "MAV_SEVERITY_CRITICAL: the flight is lost: below ground: down to z = -1.00 m";
    assert_eq!(it.text.matches("is lost").count(), 1, "{}", it.text);
    assert!(it.text.contains(said), "{}", it.text);
    it.flight().ending = Some(EndReason::Completed);
    // Nothing of the streams is due.
    it.vehicle
        .update(&it.model, NOW + Duration::from_millis(3001));
    let sent = take(&mut it.vehicle.outbox.messages);
    let sent: Vec<&str> = sent.iter().map(MavMessage::message_name).collect();
    let last = ["HEARTBEAT", "EXTENDED_SYS_STATE", "SYS_STATUS"];
    assert!(sent.ends_with(&last), "{sent:?}");
}

#[test]
fn long_texts_come_in_parts_of_which_the_last_is_not_full() {
    let mut it = Conversation::new("lissajous", true);
    for length in [1, 49, 50, 51, 99, 100, 101, 250] {
        let reason = "x".repeat(length);
        it.set("MASS", length as f32);
        let messages = it.plant(Err(&reason));
        let parts = messages.iter().filter_map(|it| match it {
            MavMessage::STATUSTEXT(it) => Some(it),
            _ => None,
        });
        let parts: Vec<&STATUSTEXT_DATA> = parts.collect();
        let texts = parts.iter().map(|it| it.text.to_str().unwrap());
        assert_eq!(texts.collect::<String>(), reason);
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

/// Whether a frame of MAVLink 2 may have the vehicle request a change, read by hand from the protocol's description. 23 is
/// PARAM_SET, 75 COMMAND_INT, 76 COMMAND_LONG; of a vehicle that is steered, 84 is SET_POSITION_TARGET_LOCAL_NED.
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
    let flights = [("lissajous", true), ("lissajous", false), ("mavlink", true)];
    let mut vehicles = flights.map(|(name, may)| Conversation::new(name, may));
    let mut random = fastrand::Rng::with_seed(1);
    let seeds = [
        MavMessage::PARAM_SET(set("MASS", 0.6)),
        command(MAV_CMD_INJECT_FAILURE, [101.0, 1.0, 2.0]),
        MavMessage::COMMAND_INT(command_int(MAV_CMD_INJECT_FAILURE, [4.0, 7.0, 0.0])),
        command(MAV_CMD_REQUEST_MESSAGE, [148.0, 0.0, 0.0]),
        command(MAV_CMD_SET_MESSAGE_INTERVAL, [30.0, 5e4, 0.0]),
        MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA::default()),
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint(BOTH)),
        command(MAV_CMD_NAV_LAND, [0.0; 3]),
    ];
    let seeds = seeds.map(|it| (frame(&it), MavMessage::extra_crc(it.message_id())));
    let (mut parsed, mut asked, mut aimed) = (0, [0; 3], 0);
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
                for it in &mut vehicles {
                    it.vehicle.receive(&header, &message, &it.model, NOW);
                }
            }
        });
        for ((it, (name, allows_control)), asked) in
            vehicles.iter_mut().zip(flights).zip(&mut asked)
        {
            for request in take(&mut it.vehicle.requests) {
                *asked += 1;
                aimed += u32::from(request.purpose == Purpose::Follow);
                let may = allows_control && may_change(&bytes, name == "mavlink");
                assert!(may, "{request:?} by {bytes:?}");
                check(&request);
                let answer = random.bool().then(String::new).ok_or_else(String::new);
                it.vehicle.answered(&request, &answer, &it.model, NOW);
            }
            if round % 64 == 0 {
                it.offboard();
            }
            it.vehicle.outbox.messages.clear();
        }
    }
    // The vehicles take many of them.
    assert!(
        parsed > 250_000 && asked[0] > 50_000 && aimed > 10_000,
        "{parsed} {asked:?} {aimed}"
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
