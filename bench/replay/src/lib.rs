//! `ironbird replay`: runs the tick functions again, from the flight log alone.
//!
//! ```text
//! flight.mcap --log check--> complete, same version, no gap                                  a thread per log
//!             --replay-----> per message: its stage's law on the recorded inputs, compared   another thread
//! ```
//!
//! With several channels, each has a log of its own: the stages are replayed from those, tick by tick together, and the
//! plant from the log of the flight, whose messages must be among them.
//!
//! Every stage, and the theorem's monitor, gets recorded inputs, so a difference shows at the stage that caused it and
//! does not spread. The log is read once. An error found by the log check takes precedence over one of the replay.

pub mod airframe;
pub mod batches;
pub mod comparison;
pub mod inputs;
pub mod log_check;
pub mod loops;
pub mod stage_states;
pub mod summary;

use std::path::{Path, PathBuf};
use std::thread;
use std::time::Instant;

use messages::header::Message;
use messages::message_window::MessageWindow;
use messages::role::{Channel, Role};

use crate::airframe::AirframeReplay;
use crate::batches::{FromLog, batches};
use crate::comparison::ReplayComparison;
use crate::inputs::{Inputs, of};
use crate::log_check::{LogCheck, LogValidator};
use crate::loops::LoopsReplay;
use crate::stage_states::StageStates;
use crate::summary::Summary;
use analysis::flight_statistics::is_final_command;
use analysis::phrase::count;
use analysis::tracking::Tracking;
use config::law_settings::Moved;
use errors::output::{print, say};
use errors::{Failure, GATE, OK};
use flight_log::codec::Logged;
use flight_log::entry::LogEntry;
use flight_log::reader::End;
use flight_log::wall_time::speed;

/// How many messages to read ahead while a message may still depend on one that has not been read: more than the recorder
/// takes at once after its longest absence, since it drains topic after topic.
pub const LOOKAHEAD: usize = 20_000;
/// How many messages to read ahead while a swap's record is missing. Another thread of the plant writes it, in lockstep any
/// number of ticks later; this is about one second of lockstep.
const LOOKAHEAD_FOR_SWAPS: usize = 8 * LOOKAHEAD;

/// Replays a log from tick 0, compares from a tick on, and prints the verdict or a summary.
pub fn replay(path: &Path, from: u64, verify: bool, moved: &Moved) -> Result<u8, Failure> {
    let start = Instant::now();
    let replayed = fly_again(path, from, verify, moved)?;
    // Standard output is the verdict alone.
    let flown_s = replayed.summary.flown_ticks() as f64 * replayed.survey.settings.flight.period_s;
    say(&format!(
        "{flown_s:.3} s replayed in {}\n",
        speed(flown_s, start.elapsed().as_secs_f64())
    ));
    if verify {
        verdict(path, &replayed)
    } else {
        print_summary(path, &replayed)
    }
}

#[derive(Clone, Debug)]
pub struct ReplayResult {
    pub survey: LogCheck,
    pub comparison: ReplayComparison,
    pub summary: Summary,
}

impl ReplayResult {
    /// Whether the whole flight was replayed and every value is the recorded one.
    pub fn is_identical(&self) -> bool {
        self.comparison.first.is_none() && self.survey.end == End::Complete
    }
}

/// Replays a log from tick 0 and compares from `from_tick` on; if `stops`, only up to the first difference. Laws are loaded
/// from the files that the log names, except those that have `moved`.
pub fn fly_again(
    path: &Path,
    from_tick: u64,
    stops: bool,
    moved: &Moved,
) -> Result<ReplayResult, Failure> {
    let logs = open_logs(path, moved)?;
    let replay = FlightReplay::new(&logs, from_tick).map_err(|e| of_log(path, e));
    thread::scope(|scope| {
        let (to_flight, from_logs): (Vec<_>, Vec<_>) = logs.iter().map(|_| batches()).unzip();
        let flight = scope.spawn(move || replay.and_then(|replay| replay.fly(from_logs, stops)));
        let checks: Vec<_> = logs
            .into_iter()
            .zip(to_flight)
            .map(|((log, validator), mut to_flight)| {
                scope.spawn(move || {
                    let check = validator.look_through(|entry| to_flight.push(entry));
                    to_flight.finish();
                    check.map_err(|e| of_log(&log, e))
                })
            })
            .collect();
        let panicked = |thread: &str| Failure::failed(format!("the {thread} thread panicked"));
        let mut survey: Option<LogCheck> = None;
        for check in checks {
            let check = check.join().unwrap_or_else(|_| Err(panicked("log")))?;
            match &mut survey {
                None => survey = Some(check),
                Some(flown) if check.end != End::Complete => flown.end = check.end,
                Some(_) => {}
            }
        }
        let replayed = flight.join().unwrap_or_else(|_| Err(panicked("replay")));
        let last_tick = survey.as_ref().and_then(|it| it.last_tick).unwrap_or(0);
        if from_tick > last_tick {
            return Err(Failure::usage(format!(
                "--from {from_tick}: the log ends at tick {last_tick}"
            ))
            .help(format!("name a tick from 0 to {last_tick}")));
        }
        let (comparison, summary) = replayed.map_err(|e| of_log(path, e))?;
        let survey = survey.ok_or_else(|| panicked("log"))?;
        Ok(ReplayResult {
            survey,
            comparison,
            summary,
        })
    })
}

/// The log of a flight, and with several channels each one's own.
fn open_logs(path: &Path, moved: &Moved) -> Result<Vec<(PathBuf, LogValidator)>, Failure> {
    let open = |log: &Path| LogValidator::open(log, moved).map_err(|e| of_log(log, e));
    let flown = open(path)?;
    if let Some(channel) = flown.channel {
        return Err(Failure::usage(format!(
            "{} is the log of channel {channel} alone",
            path.display()
        ))
        .help("name the directory of the flight: its channels are replayed together"));
    }
    let mut logs = vec![(path.to_owned(), flown)];
    let channels = logs[0].1.settings.rt.channels;
    for channel in Channel::first(channels).filter(|_| channels > 1) {
        let directory = path.with_file_name(flight_log::log_directory(channel));
        let log = directory.join(flight_log::FILE);
        let own = open(&log)?;
        if own.channel != Some(channel) || own.run_id() != logs[0].1.run_id() {
            return Err(Failure::failed(format!(
                "{} is not the log of channel {channel} of the flight in {}",
                log.display(),
                path.display()
            ))
            .help("the logs of a flight belong together: copy its whole directory"));
        }
        logs.push((log, own));
    }
    Ok(logs)
}

/// A failure that names the log that it is of.
fn of_log(log: &Path, failure: Failure) -> Failure {
    let name = log.display().to_string();
    if failure.to_string().contains(&name) {
        failure
    } else {
        failure.append(&format!(" (flight log {name})"))
    }
}

fn verdict(path: &Path, replayed: &ReplayResult) -> Result<u8, Failure> {
    let (ticks, values) = (replayed.summary.ticks, replayed.comparison.values);
    say(&builds(&replayed.survey));
    if replayed.survey.end != End::Complete {
        return Err(truncated(path, replayed));
    }
    if let Some(divergence) = &replayed.comparison.first {
        print(&format!("replay: diverges at {divergence}\n"))?;
        return Ok(GATE);
    }
    print(&format!(
        "replay: {}, {values} values, identical; outputs {}\n",
        count(ticks, "tick"),
        replayed.summary.outputs
    ))?;
    Ok(OK)
}

/// A log without its end: a difference in it may follow from the missing part.
fn truncated(path: &Path, replayed: &ReplayResult) -> Failure {
    let (ticks, values) = (replayed.summary.ticks, replayed.comparison.values);
    let far = match &replayed.comparison.first {
        None => format!("its {} agree in {values} values", count(ticks, "tick")),
        Some(divergence) => {
            format!("it differs at {divergence}, possibly because of the missing part")
        }
    };
    Failure::failed(format!("{} is truncated: its end is missing; {far}", path.display())).help(
        "the flight is still running, or its recorder died; only a complete log can be verified. `ironbird export` \
         exports what is there",
    )
}

fn builds(survey: &LogCheck) -> String {
    let (there, here) = (&survey.build, flight_log::build::executable());
    format!(
        "flown by {there}, replayed by {here}: {}\n",
        there.compared_with(&here)
    )
}

fn print_summary(path: &Path, replayed: &ReplayResult) -> Result<u8, Failure> {
    print(&(replayed.summary.text(&replayed.survey) + &builds(&replayed.survey)))?;
    match &replayed.comparison.first {
        _ if replayed.survey.end != End::Complete => return Err(truncated(path, replayed)),
        Some(divergence) => print(&format!("diverges from the record at {divergence}\n"))?,
        None => print(&format!(
            "agrees with the record in {} values\n",
            replayed.comparison.values
        ))?,
    }
    Ok(OK)
}

/// All logs of a flight, replayed together.
struct FlightReplay {
    flown: LogReplay,
    /// With several channels, their own logs.
    channels: Vec<LogReplay>,
    states: StageStates,
}

impl FlightReplay {
    fn new<P>(logs: &[(P, LogValidator)], from_tick: u64) -> Result<Self, Failure> {
        let new = |(_, log): &(P, LogValidator)| LogReplay::new(log, from_tick);
        let mut replays = logs.iter().map(new).collect::<Result<Vec<_>, _>>()?;
        let settings = &logs[0].1.settings;
        Ok(Self {
            channels: replays.split_off(1),
            flown: replays.remove(0),
            states: StageStates::new(settings.rt.channels, settings.groups()),
        })
    }

    /// Replays to the end of the logs, or to the first difference if `stops`.
    fn fly(
        mut self,
        logs: Vec<FromLog>,
        stops: bool,
    ) -> Result<(ReplayComparison, Summary), Failure> {
        let (flown, channels, states) = (&mut self.flown, &mut self.channels, &mut self.states);
        let mut logs = logs.into_iter();
        let mut log = logs.next();
        let mut own_logs: Vec<_> = logs.map(Some).collect();
        // Alone, a log need not wait for others.
        let mut until = if channels.is_empty() { u64::MAX } else { 0 };
        loop {
            let mut next = None;
            for (channel, log) in channels.iter_mut().zip(&mut own_logs) {
                let reached = channel.advance(until, log, stops, states, &[])?;
                next = [next, reached].into_iter().flatten().min();
            }
            let reached = flown.advance(until, &mut log, stops, states, channels)?;
            match [next, reached].into_iter().flatten().min() {
                Some(tick) => until = tick,
                None => break,
            }
            let differs = |it: &LogReplay| it.comparison.first.is_some();
            if stops && (differs(flown) || channels.iter().any(differs)) {
                break;
            }
        }
        flown.summary.restarts = flown.loops.restarts - flown.restarts_before;
        for channel in channels {
            flown.comparison.add(channel.comparison.clone());
        }
        Ok((self.flown.comparison, self.flown.summary))
    }
}

/// A log that is replayed: of a flight with one channel, of one with several, or a channel's own.
struct LogReplay {
    from_tick: u64,
    /// None in a channel's own log.
    airframe: Option<AirframeReplay>,
    /// Whether the laws are replayed: not from the log of a flight with several channels.
    has_stages: bool,
    /// Whether the commands of all channels are those of the laws of channel a.
    are_alike: bool,
    loops: Box<LoopsReplay>,
    comparison: ReplayComparison,
    summary: Summary,
    /// Restarts of the inner loop before the first compared tick.
    restarts_before: u64,
    inputs: Inputs,
    /// Messages that were read and not replayed yet.
    ahead: usize,
}

impl LogReplay {
    fn new(log: &LogValidator, from_tick: u64) -> Result<Self, Failure> {
        let (settings, pace) = (&log.settings, log.pace()?);
        let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
        let faults = settings.planned()?.loops.messages;
        let channel = log.channel.unwrap_or(Channel::A);
        let airframe =
            || -> Result<_, Failure> { Ok(AirframeReplay::new(&settings.plant()?, pace, &faults)) };
        let is_whole = log.channel.is_none();
        Ok(Self {
            from_tick,
            airframe: is_whole.then(airframe).transpose()?,
            has_stages: !is_whole || settings.rt.channels == 1,
            are_alike: !settings.has_several_laws(),
            loops: Box::new(LoopsReplay::new(settings, channel)?),
            comparison: ReplayComparison::from(from_tick, channel, settings.flown_laws()?.signals),
            summary: Summary::new(tracking, from_tick),
            restarts_before: 0,
            inputs: Inputs::new(is_whole && settings.theorem()?.is_some(), pace, &faults),
            ahead: 0,
        })
    }

    /// Replays up to a tick, or to the first difference if `stops`; returns the tick of the next message, if there is one.
    fn advance(
        &mut self,
        until: u64,
        log: &mut Option<FromLog>,
        stops: bool,
        states: &mut StageStates,
        channels: &[Self],
    ) -> Result<Option<u64>, Failure> {
        while let Some((tick, stage)) = self.read_next(log) {
            if tick > until {
                return Ok(Some(tick));
            }
            self.step(tick, stage, states, channels)?;
            self.ahead -= 1;
            if stops && self.comparison.first.is_some() {
                break;
            }
        }
        Ok(None)
    }

    /// Reads until it is certain which message is next, or enough have been read; none at the end of the log.
    fn read_next(&mut self, log: &mut Option<FromLog>) -> Option<(u64, Role)> {
        loop {
            let next = self.inputs.earliest();
            let Some(open) = log else {
                return next.map(|it| (it.tick, it.stage));
            };
            if let Some(next) = next
                && (next.is_settled || self.ahead > LOOKAHEAD)
                && !(next.stage == Role::Plant && self.waits_for_swap())
            {
                return Some((next.tick, next.stage));
            }
            match open.next_batch() {
                Some(batch) => {
                    for entry in batch {
                        match (entry, &mut self.airframe) {
                            (LogEntry::Swap(swap), Some(airframe)) => airframe.push_swap(swap),
                            (LogEntry::Swap(_), None) => {}
                            _ => {
                                self.inputs.take(entry);
                                self.ahead += 1;
                            }
                        }
                    }
                }
                None => *log = None,
            }
        }
    }

    /// Whether the next state includes a swap whose record has not been read yet.
    fn waits_for_swap(&self) -> bool {
        let (state, airframe) = (self.inputs.states.next(), self.airframe.as_ref());
        self.ahead < LOOKAHEAD_FOR_SWAPS
            && state
                .zip(airframe)
                .is_some_and(|(state, airframe)| !airframe.knows_swaps_of(&state.content))
    }

    fn step(
        &mut self,
        tick: u64,
        stage: Role,
        states: &mut StageStates,
        channels: &[Self],
    ) -> Result<(), Failure> {
        let (inputs, comparison) = (&mut self.inputs, &mut self.comparison);
        let (loops, outputs) = (&mut self.loops, &mut self.summary.outputs);
        let are_alike = self.are_alike;
        match stage {
            Role::Plant => {
                let message = of(&inputs.states, tick)?;
                if let Some(airframe) = &mut self.airframe {
                    let state = airframe.step(message, &inputs.rotor_speeds, comparison)?;
                    outputs.take(tick, &state);
                    self.summary.state(tick, &state);
                }
                loops.take_state(message);
                inputs.states.advance();
            }
            Role::Outer => {
                let message = of(&inputs.setpoints, tick)?;
                loops.take_setpoint(message);
                let setpoint = if self.has_stages {
                    loops.setpoint(message, inputs, states, comparison)?
                } else {
                    let sent = channels.iter().map(|it| &it.inputs.setpoints);
                    sent_by_one(message, sent, are_alike, comparison)
                };
                if let Some(setpoint) = setpoint {
                    outputs.take(tick, &setpoint);
                }
                inputs.setpoints.advance();
            }
            Role::Inner => {
                let message = of(&inputs.wrenches, tick)?;
                loops.take_wrench(message);
                let wrench = if self.has_stages {
                    Some(loops.wrench(message, inputs, states, comparison)?)
                } else {
                    let sent = channels.iter().map(|it| &it.inputs.wrenches);
                    sent_by_one(message, sent, are_alike, comparison)
                };
                if let Some(wrench) = wrench {
                    outputs.take(tick, &wrench);
                    if tick >= self.from_tick {
                        self.summary.wrench(&wrench);
                    } else {
                        self.restarts_before = loops.restarts;
                    }
                }
                inputs.wrenches.advance();
            }
            Role::Mixer => {
                let message = of(&inputs.rotor_speeds, tick)?;
                let speeds = if self.has_stages {
                    Some(loops.rotor_speeds(message, inputs, states, comparison)?)
                } else {
                    let sent = channels.iter().map(|it| &it.inputs.rotor_speeds);
                    sent_by_one(message, sent, are_alike, comparison)
                };
                // After the last tick the mixer stops the rotors; that command answers no state.
                if let Some(speeds) = speeds.filter(|_| !is_final_command(message)) {
                    outputs.take(tick, &speeds);
                    if tick >= self.from_tick {
                        self.summary.rotor_speeds(&speeds);
                    }
                }
                inputs.rotor_speeds.advance();
            }
            Role::Record => {
                loops.theorem(of(&inputs.theorem, tick)?, inputs, comparison)?;
                inputs.theorem.advance();
            }
        }
        Ok(())
    }
}

/// The content of a flown message, if a channel sent it: all of it where the channels are alike, else all but the signals.
fn sent_by_one<'a, C: Logged>(
    flown: &Message<C>,
    channels: impl Iterator<Item = &'a MessageWindow<C>>,
    are_alike: bool,
    comparison: &mut ReplayComparison,
) -> Option<C> {
    let tick = flown.envelope.tick;
    let is_it = |sent: &Message<C>| {
        sent.envelope == flown.envelope && (!are_alike || sent.content.is_same(&flown.content))
    };
    let mut sent = channels.filter_map(|it| it.of(tick));
    if !sent.any(is_it) {
        comparison.lacks::<C>(tick, "message");
        return None;
    }
    Some(flown.content)
}
