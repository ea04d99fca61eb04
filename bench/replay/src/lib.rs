//! `ironbird replay`: runs the tick functions again, from a flight's logs alone.
//!
//! ```text
//! flight.mcap --log check--> complete, same version, no gap                                  a thread per log
//!             --replay-----> per message: its stage's law on the recorded inputs, compared   another thread
//! ```
//!
//! A replay is a fold over the messages in the order in which the recorder took them, in which every message comes after
//! all that it goes back to. Each process recorded its decisions: the plant which commands it took, a stage the state and
//! the inputs that it continued from. What the log does not say is an error.
//!
//! With several channels, each has a log of its own: the stages are replayed from those, and the plant from the log of the
//! flight, whose other messages follow from them.
//!
//! Every stage, and the theorem's monitor, gets recorded inputs, so a difference shows at the stage that caused it and
//! does not spread. Each log is read once. An error found by the log check takes precedence over one of the replay.

pub mod airframe;
pub mod batches;
pub mod comparison;
pub mod expected;
pub mod inputs;
pub mod log_check;
pub mod loops;
pub mod loss;
pub mod summary;

use std::path::{Path, PathBuf};
use std::thread::{self, Builder};
use std::time::Instant;

use messages::content::{RotorSpeeds, Setpoint, Stamped, State};
use messages::header::{Header, Message};
use messages::message_window::MessageWindow;
use messages::monitor::Monitor;
use messages::role::{Channel, Role};

use crate::airframe::AirframeReplay;
use crate::batches::{FromLog, batches};
use crate::comparison::ReplayComparison;
use crate::expected::{Expected, Origin};
use crate::inputs::{RecordedInput, kept};
use crate::log_check::{LogCheck, LogValidator};
use crate::loops::{LoopsReplay, SavedStates};
use crate::summary::Summary;
use analysis::phrase::count;
use analysis::states::is_final_command;
use analysis::tracking::Tracking;
use controller::FlightMonitor;
use errors::output::{print, say};
use errors::{Failure, GATE, OK};
use faults::Port;
use flight_log::channel_merge::ChannelMerge;
use flight_log::entry::EntryRef;
use flight_log::reader::End;
use flight_log::wall_time::speed;
use sim::expected_messages::gap;

/// Replays a log from tick 0, compares from a tick on, and prints the verdict or a summary.
pub fn replay(
    path: &Path,
    from: u64,
    verify: bool,
    moved: &[(Role, PathBuf)],
) -> Result<u8, Failure> {
    let start = Instant::now();
    let replayed = fly_again(path, from, verify, moved)?;
    // Standard output is the verdict alone.
    let flown_s = replayed.summary.flown_ticks() as f64 * replayed.survey.settings.flight.period_s;
    say(&format!(
        "{flown_s:.3} s replayed in {}\n",
        speed(flown_s, start.elapsed().as_secs_f64())
    ));
    conclude(&replayed, verify)
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
    moved: &[(Role, PathBuf)],
) -> Result<ReplayResult, Failure> {
    let logs = open_logs(path, moved)?;
    let failed = |e| Failure::failed(format!("cannot start a thread for the replay: {e}"));
    let panicked = || Failure::failed("a thread of the replay panicked");
    let mut replay = FlightReplay::new(&logs[0].1, from_tick);
    // Laws are loaded while there is one thread: to run them, the process goes on in a child.
    for (log, own) in logs.iter().filter(|(_, own)| is_of_channel(own)) {
        if let Ok(replay) = &mut replay {
            let added = replay.add_channel(own, from_tick);
            added.map_err(|e| of_log(log, e))?;
        }
    }
    thread::scope(|scope| {
        let (mut streams, mut checks) = (Vec::new(), Vec::new());
        for (log, validator) in logs {
            let (mut to_replay, messages) = batches();
            streams.push(Stream {
                path: log.clone(),
                channel: validator.channel,
                messages,
            });
            let check = move || {
                let check = validator.look_through(|chunk, position, entry| {
                    to_replay.push(chunk, position, entry);
                });
                to_replay.finish();
                check.map_err(|e| of_log(&log, e))
            };
            checks.push(Builder::new().spawn_scoped(scope, check).map_err(failed)?);
        }
        let fly = move || replay?.fly(streams, stops);
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
fn open_logs(
    path: &Path,
    moved: &[(Role, PathBuf)],
) -> Result<Vec<(PathBuf, LogValidator)>, Failure> {
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

/// Prints the verdict, or a summary; code 3 if a verdict was requested and a value differs.
fn conclude(replayed: &ReplayResult, verify: bool) -> Result<u8, Failure> {
    let (summary, values) = (&replayed.summary, replayed.comparison.values);
    let builds = builds(&replayed.survey);
    match verify {
        true => say(&builds),
        false => print(&(summary.text(&replayed.survey) + &builds))?,
    }
    if replayed.survey.end != End::Complete {
        return Err(truncated(replayed));
    }
    let (ticks, not_compared) = (count(summary.ticks, "tick"), not_compared(replayed));
    let said = match (&replayed.comparison.first, verify) {
        (Some(divergence), true) => format!("replay: diverges at {divergence}"),
        (Some(divergence), false) => format!("diverges from the record at {divergence}"),
        (None, true) => {
            let outputs = &summary.outputs;
            format!("replay: {ticks}, {values} values, identical{not_compared}; outputs {outputs}")
        }
        (None, false) => format!("agrees with the record in {values} values{not_compared}"),
    };
    print(&format!("{said}\n"))?;
    let is_refuted = verify && replayed.comparison.first.is_some();
    Ok(if is_refuted { GATE } else { OK })
}

/// Words on the messages of another program, if the inner law was one.
fn not_compared(replayed: &ReplayResult) -> String {
    match replayed.comparison.foreign {
        0 => String::new(),
        number => format!(
            "; answers of another program: {} not compared",
            count(number, "message")
        ),
    }
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

/// Whether the stages of a channel are replayed from a log: its own, or that of a flight with one channel.
fn is_of_channel(log: &LogValidator) -> bool {
    log.channel.is_some() || log.arrangement.channels == 1
}

/// Messages of a log.
struct Stream {
    path: PathBuf,
    /// None of the log of the flight.
    channel: Option<Channel>,
    messages: FromLog,
}

/// Stages of a channel, and what they sent.
struct ChannelReplay {
    loops: LoopsReplay,
    comparison: ReplayComparison,
    rotor_speeds: MessageWindow<RotorSpeeds>,
    /// States in its own log, which are those of the flight.
    states: Expected<State>,
}

/// The rotor command of a tick of a channel.
fn commands_of<'a>(
    channels: &'a [ChannelReplay],
) -> impl Fn(Channel, u64) -> Option<&'a (Header, Stamped<RotorSpeeds>)> {
    |channel, tick| channels.get(channel as usize)?.rotor_speeds.of(tick)
}

struct FlightReplay {
    from_tick: u64,
    /// Messages of a topic, and states of a stage, that are kept.
    kept: usize,
    airframe: AirframeReplay,
    /// Setpoints of the flight.
    setpoints: MessageWindow<Setpoint>,
    /// Faults at the input of the monitored inner loop.
    inner_setpoint: RecordedInput<Setpoint>,
    /// In the order of the channels.
    channels: Vec<ChannelReplay>,
    saved: SavedStates,
    /// The stream of the flight, of several channels.
    merge: Option<ChannelMerge>,
    /// Messages of the flight's log that follow from those of the channels.
    flown: expected::Flown,
    monitor: FlightMonitor,
    theorem: Expected<Monitor>,
    comparison: ReplayComparison,
    summary: Summary,
    last_tick: u64,
    /// Whether the plant has decided on the commands after the last tick.
    is_ended: bool,
}

impl FlightReplay {
    fn new(flown: &LogValidator, from_tick: u64) -> Result<Self, Failure> {
        let (settings, pace) = (&flown.settings, flown.reader.pace()?);
        let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
        let planned = settings.planned()?;
        let (faults, kept) = (planned.loops.messages, kept(pace, &planned));
        let (arrangement, signals) = (flown.arrangement, settings.flown_laws()?.signals);
        let merge = || ChannelMerge::new(arrangement, settings.waiting_ticks(), signals);
        Ok(Self {
            from_tick,
            kept,
            airframe: AirframeReplay::new(&settings.plant()?, arrangement, pace, &faults),
            setpoints: MessageWindow::keeping(kept),
            inner_setpoint: RecordedInput::new(&faults, Port::InnerSetpoint, kept),
            channels: Vec::new(),
            saved: SavedStates::keeping(kept),
            merge: (arrangement.channels > 1).then(merge),
            flown: expected::Flown::default(),
            monitor: FlightMonitor::new(settings.theorem()?),
            theorem: Expected::default(),
            comparison: ReplayComparison::from(from_tick, Channel::A, signals),
            summary: Summary::new(tracking, from_tick),
            last_tick: 0,
            is_ended: false,
        })
    }

    fn add_channel(&mut self, own: &LogValidator, from_tick: u64) -> Result<(), Failure> {
        let channel = own.channel.unwrap_or(Channel::A);
        let signals = own.settings.flown_laws()?.signals;
        self.channels.push(ChannelReplay {
            loops: LoopsReplay::new(&own.settings, channel, self.kept)?,
            comparison: ReplayComparison::from(from_tick, channel, signals),
            rotor_speeds: MessageWindow::keeping(self.kept),
            states: Expected::default(),
        });
        Ok(())
    }

    /// Replays to the end of the logs, or to the first difference if `stops`.
    fn fly(
        mut self,
        mut streams: Vec<Stream>,
        stops: bool,
    ) -> Result<(ReplayComparison, Summary), Failure> {
        loop {
            // At one position, the message of a channel comes before what follows from it in the flight.
            let position = |(place, stream): (usize, &mut Stream)| {
                Some((stream.messages.position()?, stream.channel.is_none(), place))
            };
            let next = streams.iter_mut().enumerate().filter_map(position).min();
            let Some((.., place)) = next else { break };
            let Stream {
                path,
                channel,
                messages,
            } = &mut streams[place];
            let Some(entry) = messages.next_entry() else {
                break;
            };
            let stepped = self.step(*channel, entry);
            stepped.map_err(|e| of_log(path, e))?;
            if stops && self.differs() {
                return Ok(self.result());
            }
        }
        self.finish()?;
        Ok(self.result())
    }

    fn differs(&self) -> bool {
        let mut channels = self.channels.iter();
        self.comparison.first.is_some() || channels.any(|it| it.comparison.first.is_some())
    }

    /// Of differences in one tick, that of a channel is the cause.
    fn result(mut self) -> (ReplayComparison, Summary) {
        for channel in &self.channels {
            self.summary.restarts += channel.loops.restarts;
            self.summary.takeovers += channel.loops.takeovers;
        }
        let channels = self.channels.into_iter().rev();
        let comparison = channels.fold(self.comparison, |all, mut it| {
            it.comparison.add(all);
            it.comparison
        });
        (comparison, self.summary)
    }

    /// Takes a message of the log of a channel, or of that of the flight.
    fn step(&mut self, channel: Option<Channel>, entry: EntryRef<'_>) -> Result<(), Failure> {
        let comparison = &mut self.comparison;
        match (channel, entry) {
            (Some(channel), EntryRef::State(message)) => {
                if let Some(own) = self.channels.get_mut(channel as usize) {
                    own.states.take(Origin::Log, message, &mut own.comparison);
                }
                Ok(())
            }
            // The log check compares them with the flight's.
            (Some(_), EntryRef::Swap(_) | EntryRef::Decisions(_)) | (_, EntryRef::Loss(_)) => {
                Ok(())
            }
            (_, EntryRef::State(message)) => {
                self.state(message)?;
                self.merge(Channel::A, entry)
            }
            (_, EntryRef::Swap(swap)) => {
                self.airframe.push_swap(swap);
                self.merge(Channel::A, entry)
            }
            (_, EntryRef::Decisions(message)) => {
                self.airframe.push_decisions(message);
                self.is_ended = message.envelope.tick > self.last_tick;
                self.merge(Channel::A, entry)
            }
            (_, EntryRef::Theorem(message)) => {
                self.theorem.take(Origin::Log, message, comparison);
                Ok(())
            }
            (None, _) if self.merge.is_some() => {
                self.flown.take(Origin::Log, entry, comparison);
                Ok(())
            }
            (channel, _) => {
                let channel = channel.unwrap_or(Channel::A);
                self.stage(channel, entry)?;
                self.merge(channel, entry)
            }
        }
    }

    fn state(&mut self, message: &Message<State>) -> Result<(), Failure> {
        let tick = message.envelope.tick;
        let command = commands_of(&self.channels);
        let state = self.airframe.step(message, command, &mut self.comparison)?;
        self.summary.state(tick, state);
        self.summary.outputs.take(tick, state);
        (self.last_tick, self.is_ended) = (tick, false);
        for channel in &mut self.channels {
            channel.loops.take_state(message);
            if self.merge.is_some() {
                let comparison = &mut channel.comparison;
                channel.states.take(Origin::Others, message, comparison);
            }
        }
        Ok(())
    }

    /// Replays what a stage of a channel sent.
    fn stage(&mut self, channel: Channel, entry: EntryRef<'_>) -> Result<(), Failure> {
        let Some(own) = self.channels.get_mut(channel as usize) else {
            return Err(gap(&format!("it has no channel {channel}")));
        };
        let (loops, saved, comparison) = (&mut own.loops, &mut self.saved, &mut own.comparison);
        match entry {
            EntryRef::Setpoint(message) => loops.setpoint(message, saved, comparison),
            EntryRef::Wrench(message) => {
                let is_counted = message.envelope.tick >= self.from_tick;
                loops.wrench(message, is_counted, saved, comparison)
            }
            EntryRef::RotorSpeeds(message) => {
                own.rotor_speeds.push(message);
                loops.rotor_speeds(message, saved, comparison)
            }
            _ => Ok(()),
        }
    }

    /// Takes the messages of the flight that are decided on with this one.
    fn merge(&mut self, channel: Channel, entry: EntryRef<'_>) -> Result<(), Failure> {
        let Some(merge) = &mut self.merge else {
            return self.flown(entry);
        };
        let mut flown = Vec::new();
        merge.take(channel, &entry.copied(), |it| flown.push(*it));
        flown.iter().try_for_each(|it| self.flown(it.into()))
    }

    /// Takes a message of the flight.
    fn flown(&mut self, entry: EntryRef<'_>) -> Result<(), Failure> {
        if self.merge.is_some() {
            self.flown.take(Origin::Others, entry, &mut self.comparison);
        }
        let (summary, from_tick) = (&mut self.summary, self.from_tick);
        match entry {
            EntryRef::Setpoint(message) => {
                let tick = message.envelope.tick;
                summary.outputs.take(tick, &message.content);
                self.setpoints.push(message);
                self.inner_setpoint.take(message);
            }
            EntryRef::Wrench(message) => {
                let tick = message.envelope.tick;
                summary.outputs.take(tick, &message.content);
                if tick >= from_tick {
                    summary.wrench(&message.content);
                }
                // The inner loops of all channels have the same faults at their inputs.
                let loops = self.channels.first_mut().map(|it| &mut it.loops);
                let state = loops.map_or(Ok(None), |it| it.monitored(message))?;
                let of_setpoint = message.envelope.input_tick[1];
                let input = &self.inner_setpoint;
                let setpoint = input.input(&self.setpoints, of_setpoint, tick).ok();
                if let Some(result) = self.monitor.watch(message, state, setpoint) {
                    let comparison = &mut self.comparison;
                    self.theorem.take(Origin::Others, &result, comparison);
                }
            }
            // After the last tick the mixer stops the rotors; that command answers no state.
            EntryRef::RotorSpeeds(message) if !is_final_command(message) => {
                let tick = message.envelope.tick;
                self.monitor.command(tick, &message.content);
                summary.outputs.take(tick, &message.content);
                if tick >= from_tick {
                    summary.rotor_speeds(&message.content);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Completes the flight: no message comes any more.
    fn finish(&mut self) -> Result<(), Failure> {
        if let Some(mut merge) = self.merge.take() {
            let mut flown = Vec::new();
            merge.finish(|it| flown.push(*it));
            self.merge = Some(merge);
            flown.iter().try_for_each(|it| self.flown(it.into()))?;
        }
        if self.is_ended {
            let command = commands_of(&self.channels);
            let comparison = &mut self.comparison;
            let missed = self.airframe.end(self.last_tick, command, comparison)?;
            self.summary.end(missed);
        }
        self.flown.finish(&mut self.comparison);
        self.theorem.finish(&mut self.comparison);
        for channel in &mut self.channels {
            channel.states.finish(&mut channel.comparison);
        }
        Ok(())
    }
}
