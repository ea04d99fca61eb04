//! `ironbird replay`: runs the tick functions again, from the flight log alone.
//!
//! ```text
//! flight.mcap --survey--> whole, of this version, without a gap
//!             --again---> each message: its stage's law on the recorded inputs --compare--> bit for bit
//! ```
//!
//! Every stage gets recorded inputs, so a difference shows at the stage that made it and goes no further.

pub mod airframe;
pub mod compare;
pub mod loops;
pub mod summary;
pub mod survey;
pub mod window;

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::Path;

use model::role::Role;

use crate::cli::ReplayArgs;
use crate::output::{print, say};
use crate::replay::airframe::AirframeReplay;
use crate::replay::compare::ReplayComparison;
use crate::replay::loops::LoopsReplay;
use crate::replay::summary::Summary;
use crate::replay::survey::{Survey, survey};
use crate::replay::window::Window;
use crate::run_directory::find_log;
use failure::{Failure, GATE, OK};
use flight_log::entry::LogEntry;
use flight_log::reader::{End, LogReader};
use report::tally::is_last_word;
use report::tracking::Tracking;

/// Messages read ahead of the one that is replayed: more than the recorder takes in at once after its longest absence.
/// What a message goes back to may stand behind it in the log, because the recorder takes topic after topic.
pub const LOOKAHEAD: usize = 20_000;

/// Replays.
///
/// # Errors
/// Usage; a log that cannot be replayed, and why.
pub fn replay(args: &ReplayArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    let again = fly_again(&path, args.from, args.verify)?;
    if args.verify { verdict(&path, &again) } else { tell(&path, &again) }
}

/// What came of a replay.
#[derive(Clone, Debug)]
pub struct Replayed {
    /// The log.
    pub survey: Survey,
    /// How its outputs compare.
    pub comparison: ReplayComparison,
    /// What the flight was like.
    pub summary: Summary,
}

impl Replayed {
    /// Whether the whole flight was replayed and every value is the recorded one.
    #[must_use]
    pub fn is_identical(&self) -> bool {
        self.comparison.first.is_none() && self.survey.end == End::Complete
    }
}

/// Flies a log again from tick 0, and compares from a tick on; where told so, no further than to the first difference.
///
/// # Errors
/// As [`replay`].
pub fn fly_again(path: &Path, from_tick: u64, stops: bool) -> Result<Replayed, Failure> {
    let survey = survey(path)?;
    let last_tick = survey.last_tick.unwrap_or(0);
    if from_tick > last_tick {
        return Err(Failure::usage(format!("--from {from_tick}: the log ends at tick {last_tick}"))
            .help(format!("name a tick from 0 to {last_tick}")));
    }
    let mut again = Again::new(&survey, from_tick)?;
    again.fly(path, stops)?;
    Ok(Replayed { survey, comparison: again.comparison, summary: again.summary })
}

fn verdict(path: &Path, again: &Replayed) -> Result<u8, Failure> {
    let (ticks, values) = (again.summary.ticks, again.comparison.values);
    // Standard output is the verdict alone.
    say(&builds(&again.survey));
    if again.survey.end != End::Complete {
        return Err(truncated(path, again));
    }
    if let Some(divergence) = &again.comparison.first {
        print(&format!("replay: diverges at {divergence}\n"))?;
        return Ok(GATE);
    }
    print(&format!("replay: {ticks} ticks, {values} values, identical; outputs {}\n", again.summary.outputs))?;
    Ok(OK)
}

/// A log without its end: what differs in it may follow from what it lacks.
fn truncated(path: &Path, again: &Replayed) -> Failure {
    let (ticks, values) = (again.summary.ticks, again.comparison.values);
    let far = match &again.comparison.first {
        None => format!("the {ticks} ticks that it has agree in {values} values"),
        Some(divergence) => format!("it differs at {divergence}, which may be for want of what is missing"),
    };
    Failure::failed(format!("{} is truncated: its end is missing; {far}", path.display())).help(
        "the flight is still in the air, or its recorder died: only a whole log can be verified; `ironbird export` \
         gives what is there",
    )
}

/// Who flew, and who replays.
fn builds(survey: &Survey) -> String {
    let (there, here) = (&survey.build, crate::build::here());
    format!("flown by {there}, replayed by {here}: {}\n", there.compared_with(&here))
}

fn tell(path: &Path, again: &Replayed) -> Result<u8, Failure> {
    print(&(again.summary.text(&again.survey) + &builds(&again.survey)))?;
    match &again.comparison.first {
        _ if again.survey.end != End::Complete => return Err(truncated(path, again)),
        Some(divergence) => print(&format!("diverges from the record at {divergence}\n"))?,
        None => print(&format!("agrees with the record in {} values\n", again.comparison.values))?,
    }
    Ok(OK)
}

/// A flight that is flown again.
struct Again {
    from_tick: u64,
    airframe: AirframeReplay,
    loops: LoopsReplay,
    comparison: ReplayComparison,
    summary: Summary,
    /// Processes of the inner loop that were started in flight before the first tick that counts.
    restarts_before: u64,
    windows: Windows,
    /// Tick and stage of what was read and not replayed yet: the earliest is on top.
    ahead: BinaryHeap<Reverse<(u64, Role)>>,
}

#[derive(Default)]
struct Windows {
    states: Window<model::messages::State>,
    setpoints: Window<model::messages::Setpoint>,
    wrenches: Window<model::messages::Wrench>,
    rotor_speeds: Window<model::messages::RotorSpeeds>,
}

impl Again {
    fn new(survey: &Survey, from_tick: u64) -> Result<Self, Failure> {
        let flight = &survey.settings.flight;
        Ok(Self {
            from_tick,
            airframe: AirframeReplay::new(&survey.settings.plant()?, survey.pace, &survey.swaps),
            loops: LoopsReplay::new(&survey.settings)?,
            comparison: ReplayComparison::from(from_tick),
            summary: Summary::new(Tracking::along(survey.settings.course()?, flight.period_s), from_tick),
            restarts_before: 0,
            windows: Windows::default(),
            ahead: BinaryHeap::new(),
        })
    }

    /// Flies to the end of the log; where told so, no further than to the first difference.
    fn fly(&mut self, path: &Path, stops: bool) -> Result<(), Failure> {
        let mut reader = LogReader::open(path)?;
        while let Some(entry) = reader.next_entry()? {
            self.take(entry);
            if self.catch_up(LOOKAHEAD, stops)? {
                return Ok(());
            }
        }
        if !self.catch_up(0, stops)? {
            self.summary.restarts = self.loops.restarts - self.restarts_before;
        }
        Ok(())
    }

    /// Flies until no more than `behind` messages wait; true where it stopped at a difference.
    fn catch_up(&mut self, behind: usize, stops: bool) -> Result<bool, Failure> {
        while self.ahead.len() > behind {
            let Some(Reverse((tick, stage))) = self.ahead.pop() else { break };
            self.step(tick, stage)?;
            if stops && self.comparison.first.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn take(&mut self, entry: &LogEntry) {
        let (tick, stage) = match entry {
            LogEntry::State(message) => {
                self.windows.states.push(*message);
                (message.envelope.tick, Role::Plant)
            }
            LogEntry::Setpoint(message) => {
                self.windows.setpoints.push(*message);
                (message.envelope.tick, Role::Outer)
            }
            LogEntry::Wrench(message) => {
                self.windows.wrenches.push(*message);
                (message.envelope.tick, Role::Inner)
            }
            LogEntry::RotorSpeeds(message) => {
                self.windows.rotor_speeds.push(*message);
                (message.envelope.tick, Role::Mixer)
            }
            // Known from the survey, because they may be recorded later than the states that they change.
            LogEntry::Swap(_) => return,
        };
        self.ahead.push(Reverse((tick, stage)));
    }

    fn step(&mut self, tick: u64, stage: Role) -> Result<(), Failure> {
        let (windows, comparison, outputs) = (&self.windows, &mut self.comparison, &mut self.summary.outputs);
        match stage {
            Role::Plant => {
                let message = windows.states.of(tick)?;
                let state = self.airframe.step(message, &windows.rotor_speeds, comparison)?;
                outputs.take(tick, &state);
                self.summary.state(tick, &state);
            }
            Role::Outer => {
                let message = windows.setpoints.of(tick)?;
                if let Some(setpoint) = self.loops.setpoint(message, &windows.states, comparison)? {
                    outputs.take(tick, &setpoint);
                }
            }
            Role::Inner => {
                let message = windows.wrenches.of(tick)?;
                let wrench = self.loops.wrench(message, &windows.states, &windows.setpoints, comparison)?;
                outputs.take(tick, &wrench);
                if tick >= self.from_tick {
                    self.summary.wrench(&wrench);
                } else {
                    self.restarts_before = self.loops.restarts;
                }
            }
            Role::Mixer => {
                let message = windows.rotor_speeds.of(tick)?;
                let speeds = self.loops.rotor_speeds(message, &windows.wrenches, comparison)?;
                // After the last tick the mixer stops the rotors: an answer to no state.
                if !is_last_word(message) {
                    outputs.take(tick, &speeds);
                }
                if tick >= self.from_tick {
                    self.summary.rotor_speeds(&speeds);
                }
            }
            Role::Record => {}
        }
        Ok(())
    }
}
