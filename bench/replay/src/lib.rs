//! `ironbird replay`: runs the tick functions again, from the flight log alone.
//!
//! ```text
//! flight.mcap --log check--> complete, same version, no gap                                  first thread
//!             --replay-----> per message: its stage's law on the recorded inputs, compared   second thread
//! ```
//!
//! Every stage, and the theorem's monitor, gets recorded inputs, so a difference shows at the stage that caused it and
//! does not spread. The log is read once. An error found by the log check takes precedence over one of the replay.

pub mod airframe;
pub mod batches;
pub mod channel_commands;
pub mod comparison;
pub mod inputs;
pub mod log_check;
pub mod loops;
pub mod summary;

use std::path::{Path, PathBuf};
use std::thread;
use std::time::Instant;

use messages::grid::Pace;
use messages::role::{Channel, Role};

use crate::airframe::AirframeReplay;
use crate::batches::{Batch, FromLog, batches};
use crate::channel_commands::ChannelCommands;
use crate::comparison::ReplayComparison;
use crate::inputs::{Inputs, Next, of};
use crate::log_check::{LogCheck, LogValidator};
use crate::loops::LoopsReplay;
use crate::summary::Summary;
use analysis::flight_statistics::is_final_command;
use analysis::phrase::count;
use analysis::tracking::Tracking;
use config::Settings;
use config::law_settings::Moved;
use errors::output::{print, say};
use errors::{Failure, GATE, OK};
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
    /// The logs of channels with other laws.
    other_logs: Vec<PathBuf>,
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
    let replayed = replay_log(path, from_tick, stops, moved).and_then(|mut replayed| {
        for log in replayed.other_logs.split_off(0) {
            if stops && replayed.comparison.first.is_some() {
                break;
            }
            let of_log = format!(" (flight log {})", log.display());
            let other = replay_log(&log, from_tick, stops, moved);
            let other = other.map_err(|failure| failure.append(&of_log))?;
            if other.survey.run_id != replayed.survey.run_id {
                return Err(Failure::failed(format!(
                    "{} is of another flight than {}",
                    log.display(),
                    path.display()
                ))
                .help("the logs of a flight belong together: copy its whole directory"));
            }
            replayed.comparison.add(other.comparison);
            if other.survey.end != End::Complete {
                replayed.survey.end = other.survey.end;
            }
        }
        Ok(replayed)
    });
    replayed.map_err(|failure| {
        let name = path.display().to_string();
        if failure.to_string().contains(&name) {
            failure
        } else {
            failure.append(&format!(" (flight log {name})"))
        }
    })
}

fn replay_log(
    path: &Path,
    from_tick: u64,
    stops: bool,
    moved: &Moved,
) -> Result<ReplayResult, Failure> {
    let surveyor = LogValidator::open(path, moved)?;
    let settings = surveyor.settings.clone();
    let channel = surveyor.channel;
    let other_logs = match channel {
        Channel::A => other_logs(&settings, path),
        _ => Vec::new(),
    };
    let commands = match channel {
        Channel::A => {
            ChannelCommands::open(&settings, surveyor.pace()?, &other_logs)?.map(FlownBy::Channels)
        }
        _ => Some(FlownBy::Others),
    };
    let replayed = surveyor
        .pace()
        .and_then(|pace| ReplayRun::new(&settings, pace, from_tick, channel, commands));
    let (survey, replayed) = thread::scope(|scope| -> Result<_, Failure> {
        let (mut to_flight, from_log) = batches();
        let fly = move || replayed.and_then(|replayed| replayed.fly(from_log, stops));
        let flight = thread::Builder::new()
            .spawn_scoped(scope, fly)
            .map_err(|e| Failure::failed(format!("cannot start a thread for the replay: {e}")))?;
        let survey = surveyor.look_through(|entry| to_flight.push(entry))?;
        to_flight.finish();
        let replayed = flight
            .join()
            .unwrap_or_else(|_| Err(Failure::failed("the replay thread panicked")));
        Ok((survey, replayed))
    })?;
    let last_tick = survey.last_tick.unwrap_or(0);
    if from_tick > last_tick {
        return Err(Failure::usage(format!(
            "--from {from_tick}: the log ends at tick {last_tick}"
        ))
        .help(format!("name a tick from 0 to {last_tick}")));
    }
    let replayed = replayed?;
    Ok(ReplayResult {
        survey,
        comparison: replayed.comparison,
        summary: replayed.summary,
        other_logs: other_logs.into_iter().map(|(_, log)| log).collect(),
    })
}

/// The logs of the channels that fly other laws than channel a, by the first of each.
fn other_logs(settings: &Settings, log: &Path) -> Vec<(Channel, PathBuf)> {
    let groups = settings.groups();
    let leaders = Channel::first(settings.rt.channels).filter(|it| groups[*it as usize] == *it);
    leaders
        .skip(1)
        .map(|channel| {
            let directory = log.with_file_name(flight_log::log_directory(channel));
            (channel, directory.join(flight_log::FILE))
        })
        .collect()
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

struct ReplayRun {
    from_tick: u64,
    airframe: AirframeReplay,
    loops: Box<LoopsReplay>,
    comparison: ReplayComparison,
    summary: Summary,
    /// Restarts of the inner loop before the first compared tick.
    restarts_before: u64,
    inputs: Inputs,
    /// Messages that were read and not replayed yet.
    ahead: usize,
    /// Of a flight whose channels fly different laws.
    commands: Option<FlownBy>,
}

/// Whose commands the plant took.
enum FlownBy {
    Channels(ChannelCommands),
    /// The log is that of a channel with other laws than channel a: its replay leaves out the plant.
    Others,
}

impl ReplayRun {
    fn new(
        settings: &Settings,
        pace: Pace,
        from_tick: u64,
        channel: Channel,
        commands: Option<FlownBy>,
    ) -> Result<Self, Failure> {
        let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
        let faults = settings.planned()?.loops.messages;
        Ok(Self {
            from_tick,
            airframe: AirframeReplay::new(&settings.plant()?, pace, &faults),
            loops: Box::new(LoopsReplay::new(settings)?),
            comparison: ReplayComparison::from(from_tick, channel, settings.flown_laws()?.signals),
            summary: Summary::new(tracking, from_tick),
            restarts_before: 0,
            inputs: Inputs::new(settings.theorem()?.is_some(), pace, &faults),
            ahead: 0,
            commands,
        })
    }

    /// Replays to the end of the log, or to the first difference if `stops`.
    fn fly(mut self, log: FromLog, stops: bool) -> Result<Self, Failure> {
        let mut stopped = false;
        log.each(|batch| {
            self.take(batch);
            stopped = self.catch_up(LOOKAHEAD, stops)?;
            Ok(!stopped)
        })?;
        if !stopped && !self.catch_up(0, stops)? {
            self.summary.restarts = self.loops.restarts - self.restarts_before;
        }
        Ok(self)
    }

    /// Replays all settled messages, then until at most `behind` messages wait; true if it stopped at a difference.
    fn catch_up(&mut self, behind: usize, stops: bool) -> Result<bool, Failure> {
        while let Some(Next {
            tick,
            stage,
            is_settled,
        }) = self.inputs.earliest()
        {
            if self.ahead <= behind && !is_settled {
                break;
            }
            if behind > 0 && stage == Role::Plant && self.waits_for_swap() {
                break;
            }
            self.step(tick, stage)?;
            self.ahead -= 1;
            if stops && self.comparison.first.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether the next state includes a swap whose record has not been read yet.
    fn waits_for_swap(&self) -> bool {
        let state = self.inputs.states.next();
        !matches!(self.commands, Some(FlownBy::Others))
            && self.ahead < LOOKAHEAD_FOR_SWAPS
            && state.is_some_and(|state| !self.airframe.knows_swaps_of(&state.content))
    }

    fn take(&mut self, batch: &Batch) {
        for entry in batch {
            if let LogEntry::Swap(swap) = entry {
                self.airframe.push_swap(swap);
            } else {
                self.inputs.take(entry);
                self.ahead += 1;
            }
        }
    }

    fn step(&mut self, tick: u64, stage: Role) -> Result<(), Failure> {
        let (inputs, comparison, outputs) = (
            &mut self.inputs,
            &mut self.comparison,
            &mut self.summary.outputs,
        );
        match stage {
            Role::Plant => {
                let message = of(&inputs.states, tick)?;
                let commands = match &mut self.commands {
                    None => Some(&inputs.rotor_speeds),
                    Some(FlownBy::Channels(commands)) => {
                        let last = message.content.command_taken_tick;
                        Some(commands.up_to(last, &inputs.rotor_speeds)?)
                    }
                    Some(FlownBy::Others) => None,
                };
                if let Some(commands) = commands {
                    let state = self.airframe.step(message, commands, comparison)?;
                    outputs.take(tick, &state);
                    self.summary.state(tick, &state);
                } else {
                    self.summary.state(tick, &message.content);
                }
                self.loops.take_state(of(&inputs.states, tick)?);
                inputs.states.advance();
            }
            Role::Outer => {
                let message = of(&inputs.setpoints, tick)?;
                self.loops.take_setpoint(message);
                if let Some(setpoint) = self.loops.setpoint(message, inputs, comparison)? {
                    outputs.take(tick, &setpoint);
                }
                inputs.setpoints.advance();
            }
            Role::Inner => {
                let message = of(&inputs.wrenches, tick)?;
                self.loops.take_wrench(message);
                let wrench = self.loops.wrench(message, inputs, comparison)?;
                outputs.take(tick, &wrench);
                if tick >= self.from_tick {
                    self.summary.wrench(&wrench);
                } else {
                    self.restarts_before = self.loops.restarts;
                }
                inputs.wrenches.advance();
            }
            Role::Mixer => {
                let message = of(&inputs.rotor_speeds, tick)?;
                let speeds = self.loops.rotor_speeds(message, inputs, comparison)?;
                // After the last tick the mixer stops the rotors; that command answers no state.
                if !is_final_command(message) {
                    outputs.take(tick, &speeds);
                    if tick >= self.from_tick {
                        self.summary.rotor_speeds(&speeds);
                    }
                }
                inputs.rotor_speeds.advance();
            }
            Role::Record => {
                self.loops
                    .theorem(of(&inputs.theorem, tick)?, inputs, comparison)?;
                inputs.theorem.advance();
            }
        }
        Ok(())
    }
}
