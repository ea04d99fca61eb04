//! The vehicle's side of MAVLink: what it sends of itself, and what it answers. It has no inputs and outputs of its own.
//!
//! ```text
//!   model --update--> messages            frames --receive--> messages, requests to the plant
//!   answers of the plant --answered--> messages
//! ```

use std::collections::{BTreeMap, HashSet};
use std::ops::RangeInclusive;
use std::time::Duration;

use analysis::faults::InjectedFault;
use analysis::phrase::count;
use analysis::schema::FlightVerdict;
use ipc::TargetOrder;
use mavlink::dialects::common::*;
use mavlink::types::CharArray;
use mavlink::{MavHeader, Message as _, MessageData as _};
use messages::blackboards::EndReason;
use messages::content::TargetKind;
use messages::parameters::{PARAMETERS, Parameter};
use plant::guidance::PATIENCE_S;

use super::failures::{Failure, Refused, denied};
use super::offboard::{Command, Mode, of_command, of_setpoint};
use super::outbox::Outbox;
use super::parameters::{index_of, meant, parameter_of, value_of};
use super::telemetry::{available_modes, message, streams};
use crate::watch::dashboard_model::{Judged, Model, WatchedFlight};

/// Who the vehicle is.
pub const SYSTEM: u8 = 1;
pub const COMPONENT: u8 = 1;

/// Intervals that a ground station may ask for [us].
const INTERVALS_US: RangeInclusive<f32> = 2e4..=2e9;
/// How often to look for events.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How often to report missed deadlines at most: SYS_STATUS counts them all.
const MISSES_EVERY: Duration = Duration::from_secs(10);
/// Handovers in one look, the newest ones.
const HANDOVERS: usize = 3;
/// Requests whose answers are pending.
const PENDING: usize = 16;

const READ_ONLY: &str = "this bridge only observes: start it with --allow-control";
const NO_FLIGHT: &str = "no flight is running; start one: ironbird fly";
const ENDS: &str = "a flight ends after its duration, or by Ctrl-C where `ironbird fly` runs";
const FIXED: &str =
    "the trajectory of this flight is fixed: setpoints have no effect; fly --trajectory mavlink";
const FIXED_TRAJECTORY: &str =
    "the trajectory of this flight is fixed: `ironbird fly --trajectory` says what flies";
const NOT_FLOWN: &str =
    "missions and returns are not flown: send MAV_CMD_DO_REPOSITION, or setpoints in mode Offboard";
const NOT_OFFBOARD: &str = "setpoints have no effect before MAV_CMD_DO_SET_MODE offboard";
const SIGNED: &str = "signed frames are ignored: no key can be checked here; switch signing off";

/// A request to the plant of a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    pub run_id: u64,
    /// System and component that get its answer.
    from: [u8; 2],
    pub what: What,
    pub purpose: Purpose,
}

#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// As `ironbird inject` takes it.
    Line(String),
    Target(TargetOrder),
}

/// Purpose of a request: its answer is acknowledged accordingly.
#[derive(Clone, Debug, PartialEq)]
pub enum Purpose {
    Set(Parameter, f64),
    /// A command, and the failure that it injects or ends, if it is about one.
    Command(MavCmd, Option<Failure>),
    /// The next target of a stream, which is not acknowledged.
    Follow,
}

/// A command that is accepted: at once, or as the plant answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Accepted {
    Now,
    ByPlant,
}

type Outcome = Result<Accepted, Refused>;

#[derive(Debug, Default)]
pub struct Vehicle {
    allows_control: bool,
    /// Interval of each message that is sent by itself, and when it is due; none is never.
    streams: BTreeMap<u32, (Option<Duration>, Duration)>,
    /// The flight that is reported.
    run_id: u64,
    /// Events of it that have been reported.
    reported: HashSet<(u64, String)>,
    missed: u64,
    has_ended: bool,
    /// System and component of the sender that is answered.
    peer: [u8; 2],
    now: Duration,
    next_look: Duration,
    next_misses: Duration,
    /// Failures that are in force.
    begun: Vec<(FailureUnit, String)>,
    pending: Vec<Request>,
    /// Tick at which the mode became offboard, if it is.
    offboard_since: Option<u64>,
    /// The newest target of a stream, while another one is pending.
    next_target: Option<TargetOrder>,
    pub outbox: Outbox,
    /// Requests to pass to the plant.
    pub requests: Vec<Request>,
}

impl Vehicle {
    pub fn new(allows_control: bool) -> Self {
        Self {
            allows_control,
            streams: streams()
                .map(|(id, interval)| (id, (Some(interval), Duration::ZERO)))
                .collect(),
            ..Self::default()
        }
    }

    /// Sends what is due. Before the first flight there is no vehicle.
    pub fn update(&mut self, model: &Model, now: Duration) {
        let Some(flight) = model.flight.as_deref() else {
            return;
        };
        self.now = now;
        let is_new = flight.run.run_id != self.run_id;
        if is_new {
            self.join(flight);
        }
        self.end_offboard(flight);
        let mode = self.mode();
        for (id, (interval, due)) in &mut self.streams {
            if let Some(interval) = interval.filter(|_| now >= *due) {
                // On its own grid, unless it is late by more than one.
                let next = *due + interval;
                *due = if next > now { next } else { now + interval };
                self.outbox.messages.extend(message(*id, flight, mode));
            }
        }
        if is_new {
            let text = format!("ironbird flies {}", flight.settings.flight.trajectory);
            self.outbox.say(MavSeverity::MAV_SEVERITY_INFO, &text);
        }
        let ends = flight.ending.is_some() && !self.has_ended;
        if now >= self.next_look || ends {
            self.next_look = now + LOOK_EVERY;
            self.report(flight, ends);
        }
        if let Some(ending) = flight.ending.filter(|_| ends) {
            self.has_ended = true;
            self.end(flight, ending);
        }
    }

    pub const fn has_ended(&self) -> bool {
        self.has_ended
    }

    const fn mode(&self) -> Mode {
        match self.offboard_since {
            Some(_) => Mode::Offboard,
            None => Mode::Hold,
        }
    }

    fn send(&mut self, id: u32, flight: &WatchedFlight) {
        let message = message(id, flight, self.mode());
        self.outbox.messages.extend(message);
    }

    fn join(&mut self, flight: &WatchedFlight) {
        self.run_id = flight.run.run_id;
        self.has_ended = false;
        (self.offboard_since, self.next_target) = (None, None);
        self.missed = flight.run.deadlines_missed;
        self.begun.clear();
        // Events before the bridge joined are not reported.
        let events = flight.events(HANDOVERS).into_iter();
        self.reported = events.map(|it| (it.tick, it.text)).collect();
    }

    /// Reports the events since the last look, the oldest first.
    fn report(&mut self, flight: &WatchedFlight, ends: bool) {
        for event in flight.events(HANDOVERS).into_iter().rev() {
            let severity = match event.kind {
                "process" => MavSeverity::MAV_SEVERITY_ERROR,
                "fault" | "handover" => MavSeverity::MAV_SEVERITY_WARNING,
                _ => MavSeverity::MAV_SEVERITY_NOTICE,
            };
            let time_s = flight.run.flight_time_s(event.tick);
            let text = format!("{time_s:.3} s: {}", event.text);
            if self.reported.insert((event.tick, event.text)) {
                self.outbox.say(severity, &text);
            }
        }
        let flown = flight.verdicts().0.flight;
        let is_lost = flight.ending.is_none() && flown.word == FlightVerdict::Lost;
        if is_lost && self.reported.insert((0, "lost".into())) {
            let text = format!("the flight is lost: {}", flown.why);
            self.outbox.say(MavSeverity::MAV_SEVERITY_CRITICAL, &text);
        }
        let missed = flight.run.deadlines_missed;
        if missed > self.missed && (self.now >= self.next_misses || ends) {
            self.next_misses = self.now + MISSES_EVERY;
            let new = count(missed - self.missed, "missed deadline");
            self.missed = missed;
            let text = format!("{new}, {missed} in all");
            self.outbox.say(MavSeverity::MAV_SEVERITY_WARNING, &text);
        }
    }

    fn end(&mut self, flight: &WatchedFlight, ending: EndReason) {
        let (verdicts, _) = flight.verdicts();
        let severity = match ending {
            EndReason::Completed => MavSeverity::MAV_SEVERITY_INFO,
            EndReason::Interrupted => MavSeverity::MAV_SEVERITY_NOTICE,
            _ => MavSeverity::MAV_SEVERITY_CRITICAL,
        };
        let [tracked, timing, theorem] = Judged::all(&verdicts).map(|it| it.word);
        let ending = ending.name();
        let text =
            format!("the flight has ended: {ending}; {tracked}, {timing}, theorem {theorem}");
        self.outbox.say(severity, &text);
        for id in [
            HEARTBEAT_DATA::ID,
            EXTENDED_SYS_STATE_DATA::ID,
            SYS_STATUS_DATA::ID,
        ] {
            self.send(id, flight);
        }
    }

    fn refuse(&mut self, why: &str) {
        self.outbox.refuse(why, self.now);
    }

    /// Refuses a frame with a signature.
    pub fn refuse_signed(&mut self, now: Duration) {
        self.now = now;
        self.refuse(SIGNED);
    }

    /// Takes a message that has arrived. Changes need our system number; what is for others does nothing.
    pub fn receive(
        &mut self,
        header: &MavHeader,
        message: &MavMessage,
        model: &Model,
        now: Duration,
    ) {
        let Some(flight) = model.flight.as_deref() else {
            return;
        };
        let is_named = match message.target_system_id() {
            Some(SYSTEM) => true,
            Some(0) => false,
            _ => return,
        };
        let is_for_us = matches!(message.target_component_id(), None | Some(0 | COMPONENT));
        let system = header.system_id.min(u8::MAX.into()) as u8;
        let peer = [system, header.component_id];
        if !is_for_us || peer == [SYSTEM, COMPONENT] || self.outbox.is_full() {
            return;
        }
        (self.peer, self.now) = (peer, now);
        match message {
            MavMessage::PARAM_REQUEST_LIST(_) => {
                for index in 0..=PARAMETERS {
                    self.send_parameter(index, flight);
                }
            }
            MavMessage::PARAM_REQUEST_READ(it) => self.read_parameter(it, flight),
            MavMessage::MISSION_REQUEST_LIST(it) => {
                self.reply(MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                    mission_type: it.mission_type,
                    ..MISSION_COUNT_DATA::default()
                }));
            }
            MavMessage::COMMAND_LONG(it) => self.command(&Command::long(it), is_named, flight),
            MavMessage::COMMAND_INT(it) => self.command(&Command::int(it), is_named, flight),
            _ if !is_named => {}
            MavMessage::PARAM_SET(it) => {
                if let Err((error, why)) = self.set_parameter(it, flight) {
                    self.refuse_parameter(it.param_id, error, &why, flight);
                }
            }
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(it) => {
                if let Err(why) = self.setpoint(it, flight) {
                    self.refuse(&why);
                }
            }
            _ => self.refuse_message(message, flight),
        }
    }

    /// Sends a message to the sender that is answered.
    fn reply(&mut self, mut message: MavMessage) {
        let [system, component] = self.peer;
        if let Some(target) = message.target_system_id_mut() {
            *target = system;
        }
        if let Some(target) = message.target_component_id_mut() {
            *target = component;
        }
        self.outbox.messages.push(message);
    }

    /// Refuses a message that asks for what the vehicle does not do.
    fn refuse_message(&mut self, message: &MavMessage, flight: &WatchedFlight) {
        let why = match message {
            MavMessage::MISSION_COUNT(MISSION_COUNT_DATA { mission_type, .. })
            | MavMessage::MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA { mission_type, .. }) => {
                self.reply(MavMessage::MISSION_ACK(MISSION_ACK_DATA {
                    mavtype: MavMissionResult::MAV_MISSION_UNSUPPORTED,
                    mission_type: *mission_type,
                    ..MISSION_ACK_DATA::default()
                }));
                "missions are not supported: --trajectory says what flies"
            }
            MavMessage::FILE_TRANSFER_PROTOCOL(it) => {
                let refused = FILE_TRANSFER_PROTOCOL_DATA {
                    payload: refused_file(&it.payload),
                    ..FILE_TRANSFER_PROTOCOL_DATA::default()
                };
                return self.reply(MavMessage::FILE_TRANSFER_PROTOCOL(refused));
            }
            #[expect(deprecated, reason = "sent by clients that have no other way")]
            MavMessage::SET_MODE(_) => "SET_MODE is not supported: send MAV_CMD_DO_SET_MODE",
            MavMessage::SETUP_SIGNING(_) => "signing is not supported: no key is taken",
            MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            | MavMessage::SET_ATTITUDE_TARGET(_)
            | MavMessage::MANUAL_CONTROL(_)
            | MavMessage::RC_CHANNELS_OVERRIDE(_) => match flight.follows_targets() {
                true => {
                    "no effect: the only setpoint that is followed is SET_POSITION_TARGET_LOCAL_NED"
                }
                false => FIXED,
            },
            _ => return,
        };
        self.refuse(why);
    }

    fn command(&mut self, command: &Command, is_named: bool, flight: &WatchedFlight) {
        use MavCmd::*;
        let [first, second, third, _] = command.parameters;
        let mut answer = Vec::new();
        let outcome = match command.name {
            MAV_CMD_REQUEST_MESSAGE => {
                answer = self.requested(first, second, flight);
                match answer.is_empty() {
                    true => Err((MavResult::MAV_RESULT_UNSUPPORTED, String::new())),
                    false => Ok(Accepted::Now),
                }
            }
            // The commands below change something, and a broadcast may not.
            _ if !is_named => return,
            MAV_CMD_SET_MESSAGE_INTERVAL => self.set_interval(first, second),
            MAV_CMD_INJECT_FAILURE => self.inject([first, second, third], flight),
            MAV_CMD_COMPONENT_ARM_DISARM if first == 1.0 => match flight.ending {
                Some(_) => Err(no_flight()),
                None => Ok(Accepted::Now),
            },
            MAV_CMD_COMPONENT_ARM_DISARM | MAV_CMD_DO_FLIGHTTERMINATION => Err(denied(ENDS)),
            MAV_CMD_NAV_TAKEOFF
            | MAV_CMD_NAV_LAND
            | MAV_CMD_DO_REPOSITION
            | MAV_CMD_DO_SET_MODE
            | MAV_CMD_DO_PAUSE_CONTINUE
                if flight.follows_targets() =>
            {
                self.steer(command, flight)
            }
            MAV_CMD_NAV_TAKEOFF
            | MAV_CMD_NAV_LAND
            | MAV_CMD_NAV_RETURN_TO_LAUNCH
            | MAV_CMD_DO_REPOSITION
            | MAV_CMD_DO_SET_MODE
            | MAV_CMD_DO_SET_STANDARD_MODE
            | MAV_CMD_DO_PAUSE_CONTINUE
            | MAV_CMD_MISSION_START => Err(denied(match flight.follows_targets() {
                true => NOT_FLOWN,
                false => FIXED_TRAJECTORY,
            })),
            name => {
                let why = format!("{name:?} is not supported");
                Err((MavResult::MAV_RESULT_UNSUPPORTED, why))
            }
        };
        self.acknowledge(command.name, outcome);
        self.outbox.messages.extend(answer);
    }

    /// Acknowledges a command, after the reason if it is refused with one.
    fn acknowledge(&mut self, command: MavCmd, outcome: Outcome) {
        let result = match outcome {
            Ok(Accepted::ByPlant) => return,
            Ok(Accepted::Now) => MavResult::MAV_RESULT_ACCEPTED,
            Err((result, why)) => {
                if !why.is_empty() {
                    self.refuse(&why);
                }
                result
            }
        };
        self.reply(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command,
            result,
            ..COMMAND_ACK_DATA::default()
        }));
    }

    /// Messages that a ground station requests by their number; of an interval, `of` is the message that is sent so often, of
    /// modes the one that is wanted, and 0 all.
    fn requested(&self, id: f32, of: f32, flight: &WatchedFlight) -> Vec<MavMessage> {
        let message = match number(id) {
            Some(AVAILABLE_MODES_DATA::ID) => {
                return available_modes(flight, number(of).unwrap_or(0));
            }
            Some(MESSAGE_INTERVAL_DATA::ID) => number(of).map(|of| self.interval(of)),
            Some(id) => message(id, flight, self.mode()),
            None => None,
        };
        message.into_iter().collect()
    }

    fn interval(&self, id: u32) -> MavMessage {
        let interval_us = match self.streams.get(&id) {
            Some((Some(interval), _)) => interval.as_micros() as i32,
            Some((None, _)) => -1,
            None => 0,
        };
        MavMessage::MESSAGE_INTERVAL(MESSAGE_INTERVAL_DATA {
            interval_us,
            message_id: id as u16,
        })
    }

    fn set_interval(&mut self, id: f32, interval_us: f32) -> Outcome {
        let stream = number(id).and_then(|id| streams().find(|it| it.0 == id));
        let Some((id, usual)) = stream else {
            return Err(denied(format!("message {id} is not sent by itself")));
        };
        let interval = match interval_us {
            -1.0 => None,
            0.0 => Some(usual),
            us if INTERVALS_US.contains(&us) => Some(Duration::from_micros(us as u64)),
            us => {
                let (least, most) = (INTERVALS_US.start(), INTERVALS_US.end());
                let why = format!("interval {us} us: allowed are -1, 0 and {least} to {most}");
                return Err(denied(why));
            }
        };
        // Without them, the vehicle would not be there.
        if id == HEARTBEAT_DATA::ID && interval != Some(usual) {
            return Err(denied("heartbeats stay at 1 Hz"));
        }
        self.streams.insert(id, (interval, self.now));
        Ok(Accepted::Now)
    }

    /// Refuses where changes are not allowed, or where there is no flight to change.
    fn check_may_change(&self, flight: &WatchedFlight) -> Result<(), Refused> {
        match flight.ending {
            _ if !self.allows_control => Err(denied(READ_ONLY)),
            Some(_) => Err(no_flight()),
            None => Ok(()),
        }
    }

    /// Passes a request to the plant, if it may change the flight.
    fn ask(&mut self, what: What, purpose: Purpose, flight: &WatchedFlight) -> Outcome {
        self.check_may_change(flight)?;
        let request = Request {
            run_id: self.run_id,
            from: self.peer,
            what,
            purpose,
        };
        // A ground station may repeat itself before the plant has answered.
        if !self.pending.contains(&request) {
            if self.pending.len() >= PENDING {
                return Err(later("too many requests wait for their answers"));
            }
            self.pending.push(request.clone());
            self.requests.push(request);
        }
        Ok(Accepted::ByPlant)
    }

    fn inject(&mut self, parameters: [f32; 3], flight: &WatchedFlight) -> Outcome {
        self.begun.retain(|(_, what)| !has_ended(what, flight));
        let failure = Failure::of(parameters, &self.begun)?;
        let begins = |it: &Request| matches!(&it.purpose, Purpose::Command(_, Some(it)) if it.unit == failure.unit && !it.is_end);
        // The faults to end are known when the plant has answered.
        if failure.is_end && self.pending.iter().any(begins) {
            return Err(later(
                "a failure of this unit is still being injected: send OK again",
            ));
        }
        let Some(what) = failure.what.clone() else {
            return self.check_may_change(flight).map(|()| Accepted::Now);
        };
        let purpose = Purpose::Command(MavCmd::MAV_CMD_INJECT_FAILURE, Some(failure));
        self.ask(What::Line(what), purpose, flight)
    }

    /// Notes that a failure has begun, or that those of its unit have ended.
    fn note(&mut self, failure: &Failure) {
        if failure.is_end {
            self.begun.retain(|(unit, _)| *unit != failure.unit);
        } else if let Some(what) = &failure.what {
            // One that has ended may begin again, and ends once.
            self.begun.retain(|(_, begun)| begun != what);
            self.begun.push((failure.unit, what.clone()));
        }
    }

    /// Ends the mode offboard when the plant holds the position, because setpoints no longer come.
    fn end_offboard(&mut self, flight: &WatchedFlight) {
        let patience_ticks = (PATIENCE_S / flight.run.flight_time_s(1)).round() as u64;
        let target = flight.state.map(|it| it.target.kind);
        let holds = target == Some(TargetKind::Hold as u64);
        let is_over = |since: &mut u64| holds && flight.tick() > *since + 2 * patience_ticks;
        if self.offboard_since.take_if(is_over).is_some() {
            let why = format!("no setpoint for {PATIENCE_S} s: the vehicle holds its position");
            self.refuse(&why);
        }
    }

    /// Takes a setpoint, which is a target in the mode offboard.
    fn setpoint(
        &mut self,
        it: &SET_POSITION_TARGET_LOCAL_NED_DATA,
        flight: &WatchedFlight,
    ) -> Result<(), String> {
        if !flight.follows_targets() {
            return Err(FIXED.into());
        }
        let order = of_setpoint(it, flight)?;
        if self.offboard_since.is_none() {
            return Err(NOT_OFFBOARD.into());
        }
        self.follow(order, flight)
    }

    /// Requests a target of a stream. While one is pending, only the newest one waits.
    fn follow(&mut self, order: TargetOrder, flight: &WatchedFlight) -> Result<(), String> {
        if self.pending.iter().any(|it| it.purpose == Purpose::Follow) {
            self.next_target = Some(order);
            return Ok(());
        }
        let asked = self.ask(What::Target(order), Purpose::Follow, flight);
        asked.map(drop).map_err(|(_, why)| why)
    }

    /// Changes the mode, or flies what a command says.
    fn steer(&mut self, command: &Command, flight: &WatchedFlight) -> Outcome {
        if command.mode() == Some(Mode::Offboard) {
            self.check_may_change(flight)?;
            self.offboard_since = Some(flight.tick());
            self.send(HEARTBEAT_DATA::ID, flight);
            return Ok(Accepted::Now);
        }
        let order = of_command(command, flight)?;
        let purpose = Purpose::Command(command.name, None);
        let asked = self.ask(What::Target(order), purpose, flight)?;
        (self.offboard_since, self.next_target) = (None, None);
        Ok(asked)
    }

    fn set_parameter(
        &mut self,
        it: &PARAM_SET_DATA,
        flight: &WatchedFlight,
    ) -> Result<(), (MavParamError, String)> {
        use MavParamError::*;
        let name = it.param_id.to_str().unwrap_or_default();
        let Some(parameter) = parameter_of(name) else {
            return Err(match index_of(name) {
                Some(_) => {
                    let why = format!("{name} says whether --allow-control was given");
                    (MAV_PARAM_ERROR_READ_ONLY, why)
                }
                None => {
                    let why = format!("there is no parameter `{}`", name.escape_default());
                    (MAV_PARAM_ERROR_DOES_NOT_EXIST, why)
                }
            });
        };
        if it.param_type != MavParamType::MAV_PARAM_TYPE_REAL32 {
            let why = format!("{name} is set as a REAL32");
            return Err((MAV_PARAM_ERROR_TYPE_MISMATCH, why));
        }
        if !it.param_value.is_finite() {
            let why = format!("{name} = {}: expected a number", it.param_value);
            return Err((MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE, why));
        }
        let value = meant(it.param_value);
        let what = What::Line(format!("{}={value}", parameter.name()));
        self.ask(what, Purpose::Set(parameter, value), flight)
            .map(drop)
            .map_err(|(_, why)| (MAV_PARAM_ERROR_PERMISSION_DENIED, why))
    }

    /// Sends the error, the value that stays in force, and the reason.
    fn refuse_parameter(
        &mut self,
        name: CharArray<16>,
        error: MavParamError,
        why: &str,
        flight: &WatchedFlight,
    ) {
        // First, because a client that gets the old value first asks again.
        self.send_parameter_error(name, -1, error);
        if let Some(index) = index_of(name.to_str().unwrap_or_default()) {
            self.send_parameter(index, flight);
        }
        self.refuse(why);
    }

    fn read_parameter(&mut self, it: &PARAM_REQUEST_READ_DATA, flight: &WatchedFlight) {
        let index = match it.param_index {
            -1 => index_of(it.param_id.to_str().unwrap_or_default()),
            index => usize::try_from(index).ok(),
        };
        match index.filter(|index| *index <= PARAMETERS) {
            Some(index) => self.send_parameter(index, flight),
            None => {
                let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
                self.send_parameter_error(it.param_id, it.param_index, error);
            }
        }
    }

    /// Takes the plant's answer to a request.
    pub fn answered(
        &mut self,
        request: &Request,
        answer: &Result<String, String>,
        model: &Model,
        now: Duration,
    ) {
        self.pending.retain(|it| it != request);
        let Some(flight) = model.flight.as_deref() else {
            return;
        };
        (self.peer, self.now) = (request.from, now);
        let answer = answer.as_ref().map(drop).map_err(String::as_str);
        match &request.purpose {
            Purpose::Set(parameter, value) => {
                let place = *parameter as usize;
                match answer {
                    Ok(()) => self.send_value(place, *value as f32),
                    Err(why) => {
                        let error = MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE;
                        let name = parameter.spec().mavlink.into();
                        self.refuse_parameter(name, error, why, flight);
                    }
                }
            }
            Purpose::Command(command, failure) => {
                if let Some(failure) = failure.as_ref().filter(|_| answer.is_ok()) {
                    self.note(failure);
                }
                let outcome = answer.map(|()| Accepted::Now).map_err(denied);
                self.acknowledge(*command, outcome);
            }
            Purpose::Follow => {
                let next = self.next_target.take();
                let followed = next.map_or(Ok(()), |next| self.follow(next, flight));
                let followed = followed.as_ref().copied().map_err(String::as_str);
                if let Err(why) = answer.and(followed) {
                    self.refuse(why);
                }
            }
        }
    }

    /// Sends a parameter; the one after the last is whether failures may be injected.
    fn send_parameter(&mut self, index: usize, flight: &WatchedFlight) {
        let value = flight.active.value.get(index).map(|value| *value as f32);
        let allows_control = f32::from(u8::from(self.allows_control));
        self.send_value(index, value.unwrap_or(allows_control));
    }

    fn send_value(&mut self, index: usize, value: f32) {
        let value = MavMessage::PARAM_VALUE(value_of(index, value));
        self.outbox.messages.push(value);
    }

    fn send_parameter_error(&mut self, name: CharArray<16>, index: i16, error: MavParamError) {
        self.reply(MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
            param_index: index,
            param_id: name,
            error,
            ..PARAM_ERROR_DATA::default()
        }));
    }
}

fn later(why: &str) -> Refused {
    (MavResult::MAV_RESULT_TEMPORARILY_REJECTED, why.to_owned())
}

fn no_flight() -> Refused {
    later(NO_FLIGHT)
}

/// The refusal of a request of MAVLink FTP: without an answer, clients wait for seconds.
fn refused_file(request: &[u8; 251]) -> [u8; 251] {
    // Sequence number, session, operation, size, operation that is answered; then the error.
    const REFUSED: u8 = 129;
    const UNKNOWN_COMMAND: u8 = 7;
    const DATA: usize = 12;
    let mut payload = [0; 251];
    let sequence = u16::from_le_bytes([request[0], request[1]]).wrapping_add(1);
    payload[..2].copy_from_slice(&sequence.to_le_bytes());
    payload[2..6].copy_from_slice(&[request[2], REFUSED, 1, request[3]]);
    payload[DATA] = UNKNOWN_COMMAND;
    payload
}

/// Whether a fault that was injected is known to have ended, as where `ironbird inject` has ended it.
fn has_ended(what: &str, flight: &WatchedFlight) -> bool {
    let input = |fault: &str| fault.split('=').next().map(str::to_owned);
    let is_like = |it: &&InjectedFault| {
        let mut parts = it.what.split(',');
        !it.what.ends_with("=off") && parts.any(|it| input(it) == input(what))
    };
    let newest = flight
        .injected
        .iter()
        .filter(is_like)
        .max_by_key(|it| it.tick);
    newest
        .and_then(|it| it.to_tick)
        .is_some_and(|end| end <= flight.tick())
}

/// A whole number that a command has as a float.
fn number(value: f32) -> Option<u32> {
    ((0.0..16_777_216.0).contains(&value) && value.fract() == 0.0).then_some(value as u32)
}
