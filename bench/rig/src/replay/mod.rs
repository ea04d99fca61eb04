//! `ironbird replay`: runs the tick functions again, from the flight log alone.
//!
//! ```text
//! flight.mcap --survey--> whole, of this version, without a gap                              a thread
//!             --again---> each message: its stage's law on the recorded inputs --compare-->  a second one
//! ```
//!
//! Every stage gets recorded inputs, and so does the theorem's monitor. A difference therefore shows at the one that
//! made it and goes no further. The log is read once. What the survey finds at its end comes before what the flight
//! found on the way.

pub mod airframe;
pub mod batches;
pub mod compare;
pub mod inputs;
pub mod loops;
pub mod struck;
pub mod summary;
pub mod survey;

use std::path::Path;
use std::thread;
use std::time::Instant;

use model::grid::Pace;
use model::role::Role;

use crate::cli::ReplayArgs;
use crate::output::{print, say};
use crate::replay::airframe::AirframeReplay;
use crate::replay::batches::{Batch, FromLog, batches};
use crate::replay::compare::ReplayComparison;
use crate::replay::inputs::{Inputs, Next, of};
use crate::replay::loops::LoopsReplay;
use crate::replay::summary::Summary;
use crate::replay::survey::{Survey, Surveyor};
use crate::run_directory::find_log;
use crate::settings::Settings;
use crate::settings::laws::Moved;
use crate::wall_time::speed;
use failure::{Failure, GATE, OK};
use flight_log::reader::End;
use report::tally::is_last_word;
use report::text::count;
use report::tracking::Tracking;

/// Messages read ahead of one of which the log does not tell whether all that it goes back to has been read: more than
/// the recorder takes in at once after its longest absence. It takes topic after topic, so that this may stand behind.
pub const LOOKAHEAD: usize = 20_000;
/// Messages that at the most wait for the record of a swap: it comes from beside the plant's loop, and in lockstep the
/// clock says nothing of how many ticks later. A second of lockstep.
const LOOKAHEAD_FOR_SWAPS: usize = 8 * LOOKAHEAD;

/// Replays.
///
/// # Errors
/// Usage; a log that cannot be replayed, and why.
pub fn replay(args: &ReplayArgs) -> Result<u8, Failure> {
    let path = find_log(&args.run, args.out.as_deref())?;
    let start = Instant::now();
    let again = fly_again(&path, args.from, args.verify, &args.moved())?;
    // Standard output is the verdict alone.
    let flown_s = again.summary.flown_ticks() as f64 * again.survey.settings.flight.period_s;
    say(&format!("{flown_s:.3} s flown again in {}\n", speed(flown_s, start.elapsed().as_secs_f64())));
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
/// Laws of files are read at the places that the log names, but for those that have `moved`.
///
/// # Errors
/// As [`replay`].
pub fn fly_again(path: &Path, from_tick: u64, stops: bool, moved: &Moved) -> Result<Replayed, Failure> {
    flown_again(path, from_tick, stops, moved).map_err(|failure| {
        let name = path.display().to_string();
        if failure.to_string().contains(&name) { failure } else { failure.append(&format!(" (flight log {name})")) }
    })
}

fn flown_again(path: &Path, from_tick: u64, stops: bool, moved: &Moved) -> Result<Replayed, Failure> {
    let surveyor = Surveyor::open(path, moved)?;
    let settings = surveyor.settings.clone();
    let again = surveyor.pace().and_then(|pace| Again::new(&settings, pace, from_tick));
    let (survey, again) = thread::scope(|scope| -> Result<_, Failure> {
        let (mut to_flight, from_log) = batches();
        let flight = thread::Builder::new()
            .spawn_scoped(scope, move || again.and_then(|again| again.fly(from_log, stops)))
            .map_err(|e| Failure::failed(format!("cannot start a thread to fly again: {e}")))?;
        let survey = surveyor.look_through(|entry| to_flight.push(entry))?;
        to_flight.finish();
        let again = flight.join().unwrap_or_else(|_| Err(Failure::failed("the thread that flies again panicked")));
        Ok((survey, again))
    })?;
    let last_tick = survey.last_tick.unwrap_or(0);
    if from_tick > last_tick {
        return Err(Failure::usage(format!("--from {from_tick}: the log ends at tick {last_tick}"))
            .help(format!("name a tick from 0 to {last_tick}")));
    }
    let Again { comparison, summary, .. } = again?;
    Ok(Replayed { survey, comparison, summary })
}

fn verdict(path: &Path, again: &Replayed) -> Result<u8, Failure> {
    let (ticks, values) = (again.summary.ticks, again.comparison.values);
    say(&builds(&again.survey));
    if again.survey.end != End::Complete {
        return Err(truncated(path, again));
    }
    if let Some(divergence) = &again.comparison.first {
        print(&format!("replay: diverges at {divergence}\n"))?;
        return Ok(GATE);
    }
    print(&format!(
        "replay: {}, {values} values, identical; outputs {}\n",
        count(ticks, "tick"),
        again.summary.outputs
    ))?;
    Ok(OK)
}

/// A log without its end: what differs in it may follow from what it lacks.
fn truncated(path: &Path, again: &Replayed) -> Failure {
    let (ticks, values) = (again.summary.ticks, again.comparison.values);
    let far = match &again.comparison.first {
        None => format!("the {} that it has agree in {values} values", count(ticks, "tick")),
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
    inputs: Inputs,
    /// Messages that were read and not replayed yet.
    ahead: usize,
}

impl Again {
    fn new(settings: &Settings, pace: Pace, from_tick: u64) -> Result<Self, Failure> {
        let flight = &settings.flight;
        Ok(Self {
            from_tick,
            airframe: AirframeReplay::new(&settings.plant()?, pace, &settings.planned()?.loops.messages),
            loops: LoopsReplay::new(settings)?,
            comparison: ReplayComparison::from(from_tick, settings.flown_laws()?.signals),
            summary: Summary::new(Tracking::along(settings.course()?, flight.period_s), from_tick),
            restarts_before: 0,
            inputs: Inputs::new(settings.theorem()?.is_some()),
            ahead: 0,
        })
    }

    /// Flies to the end of the log; where told so, no further than to the first difference.
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

    /// Flies what is settled, and then until no more than `behind` messages wait; true where it stopped at a difference.
    fn catch_up(&mut self, behind: usize, stops: bool) -> Result<bool, Failure> {
        while let Some(Next { tick, stage, is_settled }) = self.inputs.earliest() {
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

    /// Whether the next state knows a swap whose record is still to come.
    fn waits_for_swap(&self) -> bool {
        let state = self.inputs.states.next();
        self.ahead < LOOKAHEAD_FOR_SWAPS && state.is_some_and(|state| !self.airframe.knows_swaps_of(&state.content))
    }

    fn take(&mut self, batch: &Batch) {
        self.ahead += self.inputs.take(batch);
        batch.swaps.iter().for_each(|swap| self.airframe.push_swap(swap));
    }

    fn step(&mut self, tick: u64, stage: Role) -> Result<(), Failure> {
        let (inputs, comparison, outputs) = (&mut self.inputs, &mut self.comparison, &mut self.summary.outputs);
        match stage {
            Role::Plant => {
                let message = of(&inputs.states, tick)?;
                let state = self.airframe.step(message, &inputs.rotor_speeds, comparison)?;
                outputs.take(tick, &state);
                self.summary.state(tick, &state);
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
                // After the last tick the mixer stops the rotors: an answer to no state, and no tick of its law.
                if !is_last_word(message) {
                    outputs.take(tick, &speeds);
                    if tick >= self.from_tick {
                        self.summary.rotor_speeds(&speeds);
                    }
                }
                inputs.rotor_speeds.advance();
            }
            Role::Record => {
                self.loops.theorem(of(&inputs.theorem, tick)?, inputs, comparison)?;
                inputs.theorem.advance();
            }
        }
        Ok(())
    }
}
