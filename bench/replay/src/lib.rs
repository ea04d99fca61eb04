//! `ironbird replay`: runs the tick functions again, from a flight's logs alone.
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
//! does not spread. Each log is read once. An error found by the log check takes precedence over one of the replay.

pub mod airframe;
pub mod batches;
pub mod comparison;
pub mod inputs;
pub mod log_check;
pub mod loops;
pub mod stage_states;
pub mod summary;

use std::path::{Path, PathBuf};
use std::thread::{self, Builder};
use std::time::Instant;

use messages::channels::Arrangement;
use messages::content::State;
use messages::header::Message;
use messages::message_window::MessageWindow;
use messages::role::{Channel, Role};
use messages::telemetry::Telemetry;

use crate::airframe::AirframeReplay;
use crate::batches::{FromLog, batches};
use crate::comparison::ReplayComparison;
use crate::inputs::{Inputs, of};
use crate::log_check::{LogCheck, LogValidator};
use crate::loops::LoopsReplay;
use crate::stage_states::StageStates;
use crate::summary::Summary;
use analysis::phrase::count;
use analysis::states::is_final_command;
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
        verdict(&replayed)
    } else {
        print_summary(&replayed)
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
    let failed = |e| Failure::failed(format!("cannot start a thread for the replay: {e}"));
    let panicked = || Failure::failed("a thread of the replay panicked");
    thread::scope(|scope| {
        let (mut replays, mut checks) = (Vec::new(), Vec::new());
        for (log, validator) in logs {
            let (mut to_flight, from_log) = batches();
            let replay = LogReplay::new(&log, &validator, from_log, from_tick);
            replays.push(replay.map_err(|e| of_log(&log, e)));
            let check = move || {
                let check = validator.look_through(|entry| to_flight.push(entry));
                to_flight.finish();
                check.map_err(|e| of_log(&log, e))
            };
            checks.push(Builder::new().spawn_scoped(scope, check).map_err(failed)?);
        }
        let fly = move || {
            let replays = replays.into_iter().collect::<Result<Vec<_>, _>>()?;
            FlightReplay::new(replays).fly(stops)
        };
        let flight = Builder::new().spawn_scoped(scope, fly).map_err(failed)?;
        let mut checks = checks
            .into_iter()
            .map(|check| check.join().unwrap_or_else(|_| Err(panicked())));
        let mut survey = checks.next().unwrap_or_else(|| Err(panicked()))?;
        for check in checks {
            let check = check?;
            if check.end != End::Complete {
                (survey.end, survey.log) = (check.end, check.log);
            } else if survey.end == End::Complete && check.swaps != survey.swaps {
                return Err(Failure::failed(format!(
                    "the parameter changes in {} are not those in {}",
                    check.log.display(),
                    path.display()
                )));
            }
        }
        let replayed = flight.join().unwrap_or_else(|_| Err(panicked()));
        let last_tick = survey.last_tick.unwrap_or(0);
        if from_tick > last_tick {
            return Err(Failure::usage(format!(
                "--from {from_tick}: the log ends at tick {last_tick}"
            ))
            .help(format!("name a tick from 0 to {last_tick}")));
        }
        let (comparison, summary) = replayed?;
        Ok(ReplayResult {
            survey,
            comparison,
            summary,
        })
    })
}

const TOGETHER: &str = "the logs of a flight belong together: copy its whole directory";

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
        let own = open(&log).map_err(|e| e.help(TOGETHER))?;
        if own.channel != Some(channel) || own.expected.run_id != logs[0].1.expected.run_id {
            return Err(Failure::failed(format!(
                "{} is not the log of channel {channel} of the flight in {}",
                log.display(),
                path.display()
            ))
            .help(TOGETHER));
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

fn verdict(replayed: &ReplayResult) -> Result<u8, Failure> {
    let (ticks, values) = (replayed.summary.ticks, replayed.comparison.values);
    say(&builds(&replayed.survey));
    if replayed.survey.end != End::Complete {
        return Err(truncated(replayed));
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
fn truncated(replayed: &ReplayResult) -> Failure {
    let (ticks, values) = (replayed.summary.ticks, replayed.comparison.values);
    let far = match &replayed.comparison.first {
        None => format!("its {} agree in {values} values", count(ticks, "tick")),
        Some(divergence) => {
            format!("it differs at {divergence}, possibly because of the missing part")
        }
    };
    let log = replayed.survey.log.display();
    Failure::failed(format!("{log} is truncated: its end is missing; {far}")).help(
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

fn print_summary(replayed: &ReplayResult) -> Result<u8, Failure> {
    print(&(replayed.summary.text(&replayed.survey) + &builds(&replayed.survey)))?;
    match &replayed.comparison.first {
        _ if replayed.survey.end != End::Complete => return Err(truncated(replayed)),
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
    /// The first log is that of the flight.
    fn new(mut logs: Vec<LogReplay>) -> Self {
        let arrangement = logs[0].arrangement;
        Self {
            channels: logs.split_off(1),
            flown: logs.remove(0),
            states: StageStates::new(arrangement),
        }
    }

    /// Replays to the end of the logs, or to the first difference if `stops`.
    fn fly(mut self, stops: bool) -> Result<(ReplayComparison, Summary), Failure> {
        // Alone, a log need not wait for others.
        let is_alone = self.channels.is_empty();
        let mut until = if is_alone { u64::MAX } else { 0 };
        let states = &mut self.states;
        loop {
            let mut next = None;
            for channel in &mut self.channels {
                let reached = channel.advance(until, stops, states, &[])?;
                next = [next, reached].into_iter().flatten().min();
            }
            let reached = self.flown.advance(until, stops, states, &self.channels)?;
            match [next, reached].into_iter().flatten().min() {
                Some(tick) => until = tick,
                None => break,
            }
            let differs = |it: &LogReplay| it.comparison.first.is_some();
            if stops && (differs(&self.flown) || self.channels.iter().any(differs)) {
                break;
            }
        }
        let mut summary = self.flown.summary;
        for it in self.channels.iter().chain([&self.flown]) {
            summary.restarts += it.loops.restarts - it.restarts_before;
            summary.takeovers += it.loops.takeovers;
        }
        // Of differences in one tick, that of a channel is the cause.
        let channels = self.channels.into_iter().rev();
        let comparison = channels.fold(self.flown.comparison, |all, mut it| {
            it.comparison.add(all);
            it.comparison
        });
        Ok((comparison, summary))
    }
}

/// A log that is replayed: of a flight with one channel, of one with several, or a channel's own.
struct LogReplay {
    path: PathBuf,
    /// None at its end.
    log: Option<FromLog>,
    arrangement: Arrangement,
    from_tick: u64,
    /// None in a channel's own log.
    airframe: Option<AirframeReplay>,
    /// Whether the laws are replayed: not from the log of a flight with several channels.
    has_stages: bool,
    has_other_laws: bool,
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
    fn new(
        path: &Path,
        validator: &LogValidator,
        log: FromLog,
        from_tick: u64,
    ) -> Result<Self, Failure> {
        let (settings, pace) = (&validator.settings, validator.reader.pace()?);
        let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
        let faults = settings.planned()?.loops.messages;
        let channel = validator.channel.unwrap_or(Channel::A);
        let is_whole = validator.channel.is_none();
        let arrangement = validator.arrangement;
        let airframe =
            || -> Result<_, Failure> { Ok(AirframeReplay::new(&settings.plant()?, pace, &faults)) };
        Ok(Self {
            path: path.to_owned(),
            log: Some(log),
            arrangement,
            from_tick,
            airframe: is_whole.then(airframe).transpose()?,
            has_stages: !is_whole || arrangement.channels == 1,
            has_other_laws: !arrangement.are_alike(channel, Channel::A),
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
        stops: bool,
        states: &mut StageStates,
        channels: &[Self],
    ) -> Result<Option<u64>, Failure> {
        while let Some((tick, stage)) = self.read_next() {
            if tick > until {
                return Ok(Some(tick));
            }
            let stepped = self.step(tick, stage, states, channels);
            stepped.map_err(|e| of_log(&self.path, e))?;
            self.ahead -= 1;
            if stops && self.comparison.first.is_some() {
                break;
            }
        }
        Ok(None)
    }

    /// Reads until it is certain which message is next, or enough have been read; none at the end of the log.
    fn read_next(&mut self) -> Option<(u64, Role)> {
        loop {
            let next = self.inputs.earliest();
            let waits_for_swap = self.waits_for_swap();
            let Some(log) = &mut self.log else {
                return next.map(|it| (it.tick, it.stage));
            };
            if let Some(next) = next
                && (next.is_settled || self.ahead > LOOKAHEAD)
                && !(next.stage == Role::Plant && waits_for_swap)
            {
                return Some((next.tick, next.stage));
            }
            let Some(batch) = log.next_batch() else {
                self.log = None;
                continue;
            };
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
        match stage {
            Role::Plant => {
                let message = of(&inputs.states, tick)?;
                let differs = |channel: &Self| {
                    let own = channel.inputs.states.of(tick);
                    !own.is_some_and(|own| is_same(own, message))
                };
                if channels.iter().any(differs) {
                    comparison.has_no_sender::<State>(tick);
                }
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
                    sent_by_one(message, channels, |it| &it.setpoints, comparison)
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
                    sent_by_one(message, channels, |it| &it.wrenches, comparison)
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
                    sent_by_one(message, channels, |it| &it.rotor_speeds, comparison)
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

fn is_same<C: Logged>(one: &Message<C>, other: &Message<C>) -> bool {
    one.envelope == other.envelope && one.content.is_same(&other.content)
}

/// The content of a flown message, if a channel sent it: without the signals if its laws are others than those of channel a.
fn sent_by_one<C: Logged>(
    flown: &Message<C>,
    channels: &[LogReplay],
    topic: fn(&Inputs) -> &MessageWindow<C>,
    comparison: &mut ReplayComparison,
) -> Option<C> {
    let tick = flown.envelope.tick;
    let is_sent = channels.iter().any(|channel| {
        let sent = topic(&channel.inputs).of(tick).copied();
        sent.is_some_and(|mut sent| {
            if channel.has_other_laws
                && let Some(signals) = sent.content.telemetry_mut()
            {
                *signals = Telemetry::default();
            }
            is_same(&sent, flown)
        })
    });
    if !is_sent {
        comparison.has_no_sender::<C>(tick);
    }
    is_sent.then_some(flown.content)
}
