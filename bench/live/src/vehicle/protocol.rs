//! The vehicle's side of MAVLink: what it sends of itself, and what it answers. It has no inputs and outputs of its own.
//!
//! ```text
//!   model --update--> messages            frames --receive--> messages, requests to the plant
//!   answers of the plant --answered--> messages
//! ```

use std::collections::{BTreeMap, HashSet};
use std::time::Duration;

use analysis::faults::InjectedFault;
use analysis::phrase::{count, name_of};
use ipc::TargetOrder;
use mavlink::dialects::common::*;
use mavlink::{MavHeader, Message as _, MessageData as _};
use messages::blackboards::EndReason;
use messages::content::TargetKind;
use messages::parameters::{Parameter, SPECS};
use plant::guidance::PATIENCE_S;

use super::failures::{Failure, Refused};
use super::offboard::{HOLD, Mode, Place, of_command, of_setpoint};
use super::parameters::{FAILURES_ENABLED, NAMES, meant, parameter_of};
use super::telemetry::{STREAMS, available_modes, message};
use crate::watch::dashboard_model::{Model, WatchedFlight};

/// Who the vehicle is.
pub const SYSTEM: u8 = 1;
pub const COMPONENT: u8 = 1;

/// Shortest interval that a ground station may ask for.
const SHORTEST: Duration = Duration::from_millis(20);
/// How often to look for events.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How often deadline misses, and refusals of the same kind, are reported.
const REPORT_EVERY: Duration = Duration::from_secs(1);
/// Refusals of different kinds in that time.
const REFUSALS: usize = 20;
/// Handovers in one look, the newest ones.
const HANDOVERS: usize = 3;
/// Requests whose answers are pending.
const PENDING: usize = 16;
/// Messages that wait to be sent. What is requested beyond them is left out, as if it had been lost on the way.
const BACKLOG: usize = 1024;
const TEXT_BYTES: usize = 50;

const READ_ONLY: &str = "this bridge only observes: start it with --allow-control";
const NO_FLIGHT: &str = "no flight is running; start one: ironbird fly";
const FIXED: &str =
    "the trajectory of this flight is fixed: setpoints have no effect; fly --trajectory mavlink";
const NOT_OFFBOARD: &str = "setpoints have no effect before MAV_CMD_DO_SET_MODE offboard";

/// A request to the plant of a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    pub run_id: u64,
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
    Set {
        parameter: Parameter,
        value: f64,
        from: [u8; 2],
    },
    Fail {
        failure: Failure,
        from: [u8; 2],
    },
    /// The next target of a stream, which is not acknowledged.
    Follow,
    Command {
        command: MavCmd,
        from: [u8; 2],
    },
}

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
    next_look: Duration,
    next_misses: Duration,
    /// When a refusal may be said again.
    quiet_until: BTreeMap<String, Duration>,
    text_id: u16,
    /// Failures that are in force.
    begun: Vec<(FailureUnit, String)>,
    pending: Vec<Request>,
    /// Tick at which the mode became offboard, if it is.
    offboard_since: Option<u64>,
    /// The newest target of a stream, while another one is pending.
    next_target: Option<TargetOrder>,
    /// Messages to send.
    pub messages: Vec<MavMessage>,
    /// Requests to pass to the plant.
    pub requests: Vec<Request>,
}

impl Vehicle {
    pub fn new(allows_control: bool) -> Self {
        let streams = STREAMS.map(|(id, interval)| (id, (Some(interval), Duration::ZERO)));
        Self {
            allows_control,
            streams: streams.into(),
            ..Self::default()
        }
    }

    /// Sends what is due. Before the first flight there is no vehicle.
    pub fn update(&mut self, model: &Model, now: Duration) {
        let Some(flight) = model.flight.as_deref() else {
            return;
        };
        let is_new = flight.run.run_id != self.run_id;
        if is_new {
            self.join(flight);
        }
        self.end_offboard(flight, now);
        let mode = self.mode();
        for (id, (interval, due)) in &mut self.streams {
            if let Some(interval) = interval.filter(|_| now >= *due) {
                // On its own grid, unless it is late by more than one.
                let next = *due + interval;
                *due = if next > now { next } else { now + interval };
                self.messages.extend(message(*id, flight, mode));
            }
        }
        if is_new {
            let name = flight.setting("flight.trajectory");
            self.say(
                MavSeverity::MAV_SEVERITY_INFO,
                &format!("ironbird flies {name}"),
            );
        }
        let ends = flight.ending.is_some() && !self.has_ended;
        if now >= self.next_look || ends {
            self.next_look = now + LOOK_EVERY;
            self.report(flight, now, ends);
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

    /// Ends the mode offboard when the plant holds the position, because setpoints no longer come.
    fn end_offboard(&mut self, flight: &WatchedFlight, now: Duration) {
        let patience_ticks = (PATIENCE_S / flight.run.flight_time_s(1)).round() as u64;
        let holds = flight
            .state
            .is_some_and(|it| it.target.kind == TargetKind::Hold as u64);
        let is_over = |since: &mut u64| holds && flight.tick() > *since + 2 * patience_ticks;
        if self.offboard_since.take_if(is_over).is_some() {
            self.refuse(
                &format!("no setpoint for {PATIENCE_S} s: the vehicle holds its position"),
                now,
            );
        }
    }

    /// Takes a setpoint, which is a target in the mode offboard.
    fn setpoint(
        &mut self,
        it: &SET_POSITION_TARGET_LOCAL_NED_DATA,
        model: &Model,
        flight: &WatchedFlight,
    ) -> Result<(), String> {
        if !flight.follows_targets() {
            return Err(FIXED.into());
        }
        let order = of_setpoint(it, flight)?;
        if self.offboard_since.is_none() {
            return Err(NOT_OFFBOARD.into());
        }
        self.follow(order, model)
    }

    /// Requests a target of a stream. While one is pending, only the newest one waits.
    fn follow(&mut self, order: TargetOrder, model: &Model) -> Result<(), String> {
        if self.pending.iter().any(|it| it.purpose == Purpose::Follow) {
            self.next_target = Some(order);
            return Ok(());
        }
        self.ask(What::Target(order), Purpose::Follow, model)
            .map_err(|(_, why)| why)
    }

    /// Changes the mode, or flies what a command says; its acknowledgement is due, or comes with the plant's answer.
    fn steer(
        &mut self,
        (command, parameters, place): (MavCmd, [f32; 4], Option<Place>),
        from: [u8; 2],
        model: &Model,
        flight: &WatchedFlight,
    ) -> Result<bool, Refused> {
        let order = match command {
            MavCmd::MAV_CMD_DO_SET_MODE => match Mode::of_command(parameters) {
                Some(Mode::Offboard) => {
                    self.check_may_change(model)?;
                    self.offboard_since = Some(flight.tick());
                    self.messages
                        .extend(message(HEARTBEAT_DATA::ID, flight, self.mode()));
                    return Ok(true);
                }
                Some(Mode::Hold) => Some(HOLD),
                None => {
                    let modes = Mode::ALL.map(Mode::name).join(" and ");
                    return Err((
                        MavResult::MAV_RESULT_DENIED,
                        format!("modes of this vehicle: {modes}"),
                    ));
                }
            },
            _ => of_command(command, parameters, place, flight)?,
        };
        let Some(order) = order else {
            return Err((
                MavResult::MAV_RESULT_DENIED,
                format!("{command:?} is not flown here"),
            ));
        };
        self.ask(
            What::Target(order),
            Purpose::Command { command, from },
            model,
        )?;
        (self.offboard_since, self.next_target) = (None, None);
        Ok(false)
    }

    fn join(&mut self, flight: &WatchedFlight) {
        self.run_id = flight.run.run_id;
        self.has_ended = false;
        (self.offboard_since, self.next_target) = (None, None);
        self.missed = flight.run.deadlines_missed;
        self.begun.clear();
        // Events before the bridge joined are not reported.
        self.reported = events(flight)
            .into_iter()
            .map(|(tick, _, text)| (tick, text))
            .collect();
    }

    /// Reports the events since the last look, the oldest first.
    fn report(&mut self, flight: &WatchedFlight, now: Duration, ends: bool) {
        for (tick, severity, text) in events(flight).into_iter().rev() {
            if self.reported.insert((tick, text.clone())) {
                let time_s = flight.run.flight_time_s(tick);
                self.say(severity, &format!("{time_s:.3} s: {text}"));
            }
        }
        let missed = flight.run.deadlines_missed;
        if missed > self.missed && (now >= self.next_misses || ends) {
            self.next_misses = now + REPORT_EVERY;
            let new = count(missed - self.missed, "missed deadline");
            self.missed = missed;
            let text = format!("{new}, {missed} in all");
            self.say(MavSeverity::MAV_SEVERITY_WARNING, &text);
        }
    }

    fn end(&mut self, flight: &WatchedFlight, ending: EndReason) {
        let (verdicts, _) = flight.verdicts();
        let words = [
            name_of(&verdicts.flight.word),
            name_of(&verdicts.timing.word),
            name_of(&verdicts.theorem.word),
        ];
        let severity = match ending {
            EndReason::Completed => MavSeverity::MAV_SEVERITY_INFO,
            EndReason::Interrupted => MavSeverity::MAV_SEVERITY_NOTICE,
            _ => MavSeverity::MAV_SEVERITY_CRITICAL,
        };
        let [tracked, timing, theorem] = words;
        let text = format!(
            "the flight has ended: {}; {tracked}, {timing}, theorem {theorem}",
            ending.name()
        );
        self.say(severity, &text);
        let heartbeat = message(HEARTBEAT_DATA::ID, flight, self.mode());
        self.messages.extend(heartbeat);
    }

    /// Sends a text, in parts if it is long.
    fn say(&mut self, severity: MavSeverity, text: &str) {
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let parts = parts(&text);
        let id = match parts.len() {
            1 => 0,
            _ => {
                self.text_id = self.text_id.checked_add(1).unwrap_or(1);
                self.text_id
            }
        };
        for (chunk_seq, part) in (0..).zip(parts) {
            self.messages.push(MavMessage::STATUSTEXT(STATUSTEXT_DATA {
                severity,
                text: part.into(),
                id,
                chunk_seq,
            }));
        }
    }

    /// Says why something is refused, once a second at most.
    fn refuse(&mut self, text: &str, now: Duration) {
        self.quiet_until.retain(|_, until| now < *until);
        if !self.quiet_until.contains_key(text) && self.quiet_until.len() < REFUSALS {
            self.quiet_until.insert(text.to_owned(), now + REPORT_EVERY);
            self.say(MavSeverity::MAV_SEVERITY_WARNING, text);
        }
    }

    /// Refuses a frame with a signature.
    pub fn refuse_signed(&mut self, now: Duration) {
        self.refuse(
            "signed frames are ignored: no key can be checked here; switch signing off",
            now,
        );
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
        let from = [
            header.system_id.min(u8::MAX.into()) as u8,
            header.component_id,
        ];
        let is_for_us = matches!(message.target_component_id(), None | Some(0 | COMPONENT));
        let (is_named, is_for_all) = match message.target_system_id() {
            Some(SYSTEM) => (true, false),
            Some(0) => (false, true),
            _ => (false, false),
        };
        if !is_for_us || from == [SYSTEM, COMPONENT] || !(is_named || is_for_all) {
            return;
        }
        if self.messages.len() >= BACKLOG {
            return;
        }
        match message {
            MavMessage::PARAM_REQUEST_LIST(_) => {
                for index in 0..=NAMES.len() {
                    self.send_parameter(index, flight);
                }
            }
            MavMessage::PARAM_REQUEST_READ(it) => {
                let name = it.param_id.to_str().unwrap_or_default();
                let index = match it.param_index {
                    -1 => index_of(name),
                    index => usize::try_from(index)
                        .ok()
                        .filter(|index| *index <= NAMES.len()),
                };
                match index {
                    Some(index) => self.send_parameter(index, flight),
                    None => {
                        let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
                        self.send_parameter_error(from, it.param_id, it.param_index, error);
                    }
                }
            }
            MavMessage::MISSION_REQUEST_LIST(it) => {
                self.messages
                    .push(MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                        target_system: from[0],
                        target_component: from[1],
                        mission_type: it.mission_type,
                        ..MISSION_COUNT_DATA::default()
                    }));
            }
            MavMessage::COMMAND_LONG(it) => {
                let parameters = [it.param1, it.param2, it.param3, it.param4];
                let command = (it.command, parameters, Some(Place::long(it)));
                self.command(command, from, is_named, model, now);
            }
            MavMessage::COMMAND_INT(it) => {
                let parameters = [it.param1, it.param2, it.param3, it.param4];
                let command = (it.command, parameters, Place::int(it));
                self.command(command, from, is_named, model, now);
            }
            _ if !is_named => {}
            MavMessage::PARAM_SET(it) => self.set_parameter(it, from, model, now),
            MavMessage::MISSION_COUNT(MISSION_COUNT_DATA { mission_type, .. })
            | MavMessage::MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA { mission_type, .. }) => {
                self.messages
                    .push(MavMessage::MISSION_ACK(MISSION_ACK_DATA {
                        target_system: from[0],
                        target_component: from[1],
                        mavtype: MavMissionResult::MAV_MISSION_UNSUPPORTED,
                        mission_type: *mission_type,
                        ..MISSION_ACK_DATA::default()
                    }));
                self.refuse(
                    "missions are not supported: --trajectory says what flies",
                    now,
                );
            }
            #[expect(deprecated, reason = "sent by clients that have no other way")]
            MavMessage::SET_MODE(_) => {
                self.refuse("the only mode is the trajectory of the flight", now)
            }
            MavMessage::FILE_TRANSFER_PROTOCOL(it) => self.refuse_file(&it.payload, from),
            MavMessage::SETUP_SIGNING(_) => {
                self.refuse("signing is not supported: no key is taken", now)
            }
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(it) => {
                if let Err(why) = self.setpoint(it, model, flight) {
                    self.refuse(&why, now);
                }
            }
            MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            | MavMessage::SET_ATTITUDE_TARGET(_)
            | MavMessage::MANUAL_CONTROL(_)
            | MavMessage::RC_CHANNELS_OVERRIDE(_) => {
                let why = match flight.follows_targets() {
                    true => {
                        "of setpoints and sticks, SET_POSITION_TARGET_LOCAL_NED alone has an effect"
                    }
                    false => FIXED,
                };
                self.refuse(why, now);
            }
            _ => {}
        }
    }

    /// Refuses a request of MAVLink FTP: without an answer, clients wait for seconds.
    fn refuse_file(&mut self, request: &[u8; 251], [system, component]: [u8; 2]) {
        // Sequence number, session, operation, size, operation that is answered; then the error.
        const REFUSED: u8 = 129;
        const UNKNOWN_COMMAND: u8 = 7;
        const DATA: usize = 12;
        let mut payload = [0; 251];
        let sequence = u16::from_le_bytes([request[0], request[1]]).wrapping_add(1);
        payload[..2].copy_from_slice(&sequence.to_le_bytes());
        payload[2..6].copy_from_slice(&[request[2], REFUSED, 1, request[3]]);
        payload[DATA] = UNKNOWN_COMMAND;
        self.messages.push(MavMessage::FILE_TRANSFER_PROTOCOL(
            FILE_TRANSFER_PROTOCOL_DATA {
                target_network: 0,
                target_system: system,
                target_component: component,
                payload,
            },
        ));
    }

    fn command(
        &mut self,
        (command, parameters, place): (MavCmd, [f32; 4], Option<Place>),
        from: [u8; 2],
        is_named: bool,
        model: &Model,
        now: Duration,
    ) {
        use MavResult::*;
        let Some(flight) = model.flight.as_deref() else {
            return;
        };
        let [first, second, third, _] = parameters;
        let mut answer = Vec::new();
        let refused = |result: MavResult, why: &str| Err((result, why.to_owned()));
        let outcome: Result<(), Refused> = match command {
            MavCmd::MAV_CMD_REQUEST_MESSAGE => {
                answer.extend(
                    number(first)
                        .into_iter()
                        .flat_map(|id| self.requested(id, second, flight)),
                );
                match answer.is_empty() {
                    false => Ok(()),
                    true => refused(MAV_RESULT_UNSUPPORTED, ""),
                }
            }
            // The commands below change something, and a broadcast may not.
            _ if !is_named => return,
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => self.set_interval(first, second, now),
            MavCmd::MAV_CMD_INJECT_FAILURE => {
                match self.inject([first, second, third], from, model) {
                    // The plant's answer is acknowledged.
                    Ok(()) => return,
                    Err(refused) => Err(refused),
                }
            }
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if !model.is_flying() => {
                refused(MAV_RESULT_TEMPORARILY_REJECTED, NO_FLIGHT)
            }
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM if first == 1.0 => Ok(()),
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM | MavCmd::MAV_CMD_DO_FLIGHTTERMINATION => refused(
                MAV_RESULT_DENIED,
                "a flight ends after its duration, or by Ctrl-C where `ironbird fly` runs",
            ),
            MavCmd::MAV_CMD_NAV_TAKEOFF
            | MavCmd::MAV_CMD_NAV_LAND
            | MavCmd::MAV_CMD_DO_REPOSITION
            | MavCmd::MAV_CMD_DO_SET_MODE
            | MavCmd::MAV_CMD_DO_PAUSE_CONTINUE
                if flight.follows_targets() =>
            {
                match self.steer((command, parameters, place), from, model, flight) {
                    Ok(true) => Ok(()),
                    // The plant's answer is acknowledged.
                    Ok(false) => return,
                    Err(refused) => Err(refused),
                }
            }
            MavCmd::MAV_CMD_NAV_TAKEOFF
            | MavCmd::MAV_CMD_NAV_LAND
            | MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH
            | MavCmd::MAV_CMD_DO_REPOSITION
            | MavCmd::MAV_CMD_DO_SET_MODE
            | MavCmd::MAV_CMD_DO_SET_STANDARD_MODE
            | MavCmd::MAV_CMD_DO_PAUSE_CONTINUE
            | MavCmd::MAV_CMD_MISSION_START => refused(
                MAV_RESULT_DENIED,
                "the trajectory of this flight is fixed: `ironbird fly --trajectory` says what flies",
            ),
            _ => refused(
                MAV_RESULT_UNSUPPORTED,
                &format!("{command:?} is not supported"),
            ),
        };
        let result = match outcome {
            Ok(()) => MAV_RESULT_ACCEPTED,
            Err((result, why)) => {
                if !why.is_empty() {
                    self.refuse(&why, now);
                }
                result
            }
        };
        self.acknowledge(command, result, from);
        self.messages.extend(answer);
    }

    fn acknowledge(&mut self, command: MavCmd, result: MavResult, [system, component]: [u8; 2]) {
        self.messages
            .push(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
                command,
                result,
                target_system: system,
                target_component: component,
                ..COMMAND_ACK_DATA::default()
            }));
    }

    /// Messages that a ground station requests by their number; of an interval, `of` is the message that is sent so often, of
    /// modes the one that is wanted, and 0 all.
    fn requested(&self, id: u32, of: f32, flight: &WatchedFlight) -> Vec<MavMessage> {
        let message = match id {
            AVAILABLE_MODES_DATA::ID => return available_modes(flight, number(of).unwrap_or(0)),
            MESSAGE_INTERVAL_DATA::ID => number(of).map(|of| self.interval(of)),
            _ => message(id, flight, self.mode()),
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

    fn set_interval(&mut self, id: f32, interval_us: f32, now: Duration) -> Result<(), Refused> {
        let denied = |why: String| Err((MavResult::MAV_RESULT_DENIED, why));
        let stream = number(id).and_then(|id| Some((id, STREAMS.iter().find(|it| it.0 == id)?.1)));
        let Some((id, usual)) = stream else {
            return denied(format!("message {id} is not sent by itself"));
        };
        let interval = match interval_us {
            -1.0 => None,
            0.0 => Some(usual),
            us if us >= SHORTEST.as_micros() as f32 && us <= 3.6e9 => {
                Some(Duration::from_micros(us as u64))
            }
            us => {
                let shortest = SHORTEST.as_micros();
                return denied(format!(
                    "interval {us} us: allowed are -1, 0 and {shortest} to 3600000000"
                ));
            }
        };
        // Without them, the vehicle would not be there.
        if id == HEARTBEAT_DATA::ID && interval != Some(usual) {
            return denied("heartbeats stay at 1 Hz".into());
        }
        self.streams.insert(id, (interval, now));
        Ok(())
    }

    /// Refuses where changes are not allowed, or where there is no flight to change.
    fn check_may_change(&self, model: &Model) -> Result<(), Refused> {
        if !self.allows_control {
            return Err((MavResult::MAV_RESULT_DENIED, READ_ONLY.into()));
        }
        if !model.is_flying() {
            return Err((MavResult::MAV_RESULT_TEMPORARILY_REJECTED, NO_FLIGHT.into()));
        }
        Ok(())
    }

    /// Passes a request to the plant, if it may change the flight.
    fn ask(&mut self, what: What, purpose: Purpose, model: &Model) -> Result<(), Refused> {
        self.check_may_change(model)?;
        let run_id = self.run_id;
        let request = Request {
            run_id,
            what,
            purpose,
        };
        if self.pending.contains(&request) {
            // A ground station that repeats itself before the plant has answered.
            return Ok(());
        }
        if self.pending.len() >= PENDING {
            let why = "too many requests wait for their answers".into();
            return Err((MavResult::MAV_RESULT_TEMPORARILY_REJECTED, why));
        }
        self.pending.push(request.clone());
        self.requests.push(request);
        Ok(())
    }

    fn inject(
        &mut self,
        parameters: [f32; 3],
        from: [u8; 2],
        model: &Model,
    ) -> Result<(), Refused> {
        if let Some(flight) = model.flight.as_deref() {
            self.begun.retain(|(_, what)| !has_ended(what, flight));
        }
        let failure = Failure::of(parameters, &self.begun)?;
        let begins = |it: &Request| {
            matches!(&it.purpose, Purpose::Fail { failure: it, .. }
                if it.unit == failure.unit && it.kind != FailureType::FAILURE_TYPE_OK)
        };
        // The faults to end are known when the plant has answered.
        if failure.kind == FailureType::FAILURE_TYPE_OK && self.pending.iter().any(begins) {
            let why = "a failure of this unit is still being injected: send OK again".into();
            return Err((MavResult::MAV_RESULT_TEMPORARILY_REJECTED, why));
        }
        match failure.what.clone() {
            Some(what) => self.ask(What::Line(what), Purpose::Fail { failure, from }, model),
            None if !self.allows_control => Err((MavResult::MAV_RESULT_DENIED, READ_ONLY.into())),
            None => {
                self.acknowledge(
                    MavCmd::MAV_CMD_INJECT_FAILURE,
                    MavResult::MAV_RESULT_ACCEPTED,
                    from,
                );
                Ok(())
            }
        }
    }

    fn set_parameter(&mut self, it: &PARAM_SET_DATA, from: [u8; 2], model: &Model, now: Duration) {
        let name = it.param_id.to_str().unwrap_or_default();
        let Some(parameter) = parameter_of(name) else {
            let (error, why) = match index_of(name) {
                Some(_) => (
                    MavParamError::MAV_PARAM_ERROR_READ_ONLY,
                    format!("{name} says whether --allow-control was given"),
                ),
                None => (
                    MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
                    format!("there is no parameter `{}`", name.escape_default()),
                ),
            };
            return self.refuse_parameter(it.param_id, error, &why, from, model, now);
        };
        if it.param_type != MavParamType::MAV_PARAM_TYPE_REAL32 {
            let error = MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH;
            let why = format!("{name} is set as a REAL32");
            return self.refuse_parameter(it.param_id, error, &why, from, model, now);
        }
        let value = meant(it.param_value);
        let what = What::Line(format!("{}={value}", parameter.name()));
        let purpose = Purpose::Set {
            parameter,
            value,
            from,
        };
        if let Err((_, why)) = self.ask(what, purpose, model) {
            let error = MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED;
            self.refuse_parameter(it.param_id, error, &why, from, model, now);
        }
    }

    /// Sends the error, the value that stays in force, and the reason.
    fn refuse_parameter(
        &mut self,
        name: mavlink::types::CharArray<16>,
        error: MavParamError,
        why: &str,
        from: [u8; 2],
        model: &Model,
        now: Duration,
    ) {
        // First, because a client that gets the old value first asks again.
        self.send_parameter_error(from, name, -1, error);
        let index = index_of(name.to_str().unwrap_or_default());
        if let Some((index, flight)) = index.zip(model.flight.as_deref()) {
            self.send_parameter(index, flight);
        }
        self.refuse(why, now);
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
        match &request.purpose {
            Purpose::Set {
                parameter,
                value,
                from,
            } => {
                let place = *parameter as usize;
                match answer {
                    Ok(_) => self.send_value(NAMES[place], place, *value as f32),
                    Err(why) => {
                        let error = MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE;
                        self.refuse_parameter(NAMES[place].into(), error, why, *from, model, now);
                    }
                }
            }
            Purpose::Fail { failure, from } => {
                let result = match answer {
                    Ok(_) if failure.kind == FailureType::FAILURE_TYPE_OK => {
                        self.begun.retain(|(unit, _)| *unit != failure.unit);
                        MavResult::MAV_RESULT_ACCEPTED
                    }
                    Ok(_) => {
                        // One that has ended may begin again, and ends once.
                        let what = failure.what.clone().unwrap_or_default();
                        self.begun.retain(|(_, begun)| *begun != what);
                        self.begun.push((failure.unit, what));
                        MavResult::MAV_RESULT_ACCEPTED
                    }
                    Err(why) => {
                        self.refuse(why, now);
                        MavResult::MAV_RESULT_DENIED
                    }
                };
                self.acknowledge(MavCmd::MAV_CMD_INJECT_FAILURE, result, *from);
            }
            Purpose::Command { command, from } => {
                let result = match answer {
                    Ok(_) => MavResult::MAV_RESULT_ACCEPTED,
                    Err(why) => {
                        self.refuse(why, now);
                        MavResult::MAV_RESULT_DENIED
                    }
                };
                self.acknowledge(*command, result, *from);
            }
            Purpose::Follow => {
                let next = self.next_target.take();
                let followed = next.map_or(Ok(()), |next| self.follow(next, model));
                if let Some(why) = answer.as_ref().err().or(followed.as_ref().err()) {
                    self.refuse(why, now);
                }
            }
        }
    }

    /// Sends a parameter; the one after the last is whether failures may be injected.
    fn send_parameter(&mut self, index: usize, flight: &WatchedFlight) {
        match NAMES.get(index) {
            Some(name) => self.send_value(name, index, flight.active.value[index] as f32),
            None => self.send_value(
                FAILURES_ENABLED,
                index,
                f32::from(u8::from(self.allows_control)),
            ),
        }
    }

    fn send_value(&mut self, name: &str, index: usize, param_value: f32) {
        let param_type = match name {
            FAILURES_ENABLED => MavParamType::MAV_PARAM_TYPE_INT32,
            _ => MavParamType::MAV_PARAM_TYPE_REAL32,
        };
        self.messages
            .push(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
                param_value,
                param_count: NAMES.len() as u16 + 1,
                param_index: index as u16,
                param_id: name.into(),
                param_type,
            }));
    }

    fn send_parameter_error(
        &mut self,
        [system, component]: [u8; 2],
        param_id: mavlink::types::CharArray<16>,
        param_index: i16,
        error: MavParamError,
    ) {
        self.messages
            .push(MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
                param_index,
                target_system: system,
                target_component: component,
                param_id,
                error,
            }));
    }
}

/// Whether a fault that was injected is known to have ended, as where `ironbird inject` has ended it.
fn has_ended(what: &str, flight: &WatchedFlight) -> bool {
    let input = |fault: &str| fault.split('=').next().map(str::to_owned);
    let is_like = |it: &&InjectedFault| it.what.split(',').any(|it| input(it) == input(what));
    let newest = flight
        .injected
        .iter()
        .filter(is_like)
        .max_by_key(|it| it.tick);
    newest
        .and_then(|it| it.to_tick)
        .is_some_and(|end| end <= flight.tick())
}

/// Place of a parameter among those that are sent.
fn index_of(name: &str) -> Option<usize> {
    match name {
        FAILURES_ENABLED => Some(SPECS.len()),
        _ => parameter_of(name).map(|parameter| parameter as usize),
    }
}

/// A whole number that a command has as a float.
fn number(value: f32) -> Option<u32> {
    ((0.0..16_777_216.0).contains(&value) && value.fract() == 0.0).then_some(value as u32)
}

/// Events of the flight with their severities, the newest first.
fn events(flight: &WatchedFlight) -> Vec<(u64, MavSeverity, String)> {
    let severity = |kind: &str| match kind {
        "process" => MavSeverity::MAV_SEVERITY_ERROR,
        "fault" | "handover" => MavSeverity::MAV_SEVERITY_WARNING,
        _ => MavSeverity::MAV_SEVERITY_NOTICE,
    };
    let events = flight.events(HANDOVERS).into_iter();
    events
        .map(|it| (it.tick, severity(it.kind), it.text))
        .collect()
}

/// A text in parts that a message has room for. A part that is full is not the last one of several.
fn parts(text: &str) -> Vec<&str> {
    let (mut parts, mut rest) = (Vec::new(), text);
    loop {
        let end = rest.floor_char_boundary(TEXT_BYTES);
        let (part, later) = rest.split_at(end);
        parts.push(part);
        rest = later;
        if rest.is_empty() && (part.len() < TEXT_BYTES || parts.len() == 1) {
            return parts;
        }
    }
}
