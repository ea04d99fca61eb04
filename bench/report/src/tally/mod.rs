//! What the recorder counts: every message once, from its stamps and content.

pub mod deadlines;
pub mod deaths;
pub mod distribution;
mod flight;
mod lead;
pub mod series;
pub mod telemetry;
pub mod theorem;
mod timing;
pub mod tracer;

use std::collections::VecDeque;

use model::boards;
use model::envelope::Message;
use model::grid::{Grid, Pace};
use model::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use model::monitor::Monitor;
use model::role::Role;
use model::telemetry::LAW_ROLES;
use model::topic::Topic;

use crate::autopsy::Autopsy;
use crate::laws::{FlownLaws, NotFinite};
use crate::schema;
use crate::swaps;
use crate::tally::deadlines::{Deadlines, LateCommands, MissRuns};
use crate::tally::deaths::DeathTally;
use crate::tally::flight::FlightTally;
use crate::tally::lead::LeadTally;
use crate::tally::series::SeriesSet;
use crate::tally::telemetry::TelemetryTally;
use crate::tally::theorem::TheoremTally;
use crate::tally::timing::{StampedCommand, StampedPassage};
use crate::tally::tracer::Tracer;
use crate::tracking::{RecentStates, Tracking};
use failure::Failure;
use flight_log::TOPICS;
use flight_log::entry::Counts;

/// Swaps that are kept one by one.
pub const SWAPS_KEPT: usize = 500;

/// Everything that is counted over a flight.
#[derive(Debug)]
pub struct Tally {
    /// Whether the first message need not be the flight's: then what was before it is unknown, and not missing.
    joins: bool,
    /// Where ticks have their place on the clock; in lockstep they have none.
    grid: Option<Grid>,
    t0_ns: u64,
    tracking: Tracking,
    /// Latencies.
    pub series: SeriesSet,
    /// Runs of misses.
    pub miss_runs: MissRuns,
    deadlines: Option<Deadlines>,
    /// Why deadlines were missed; in lockstep there are none.
    pub autopsy: Option<Autopsy>,
    /// Processes that ended in flight.
    pub deaths: DeathTally,
    /// Misses by the stamps.
    pub late_commands: LateCommands,
    leads: LeadTally,
    /// States seen.
    pub states: u64,
    last_wake: [Option<(u64, u64)>; 4],
    /// What stages did in ticks that the plant may still fly.
    passages: VecDeque<StampedPassage>,
    /// Commands whose deadlines the plant has not judged yet.
    commands: VecDeque<StampedCommand>,
    /// When the mixer said its last word [ns].
    last_word_ns: Option<u64>,
    sequences: [Sequence; TOPICS.len()],
    flight: FlightTally,
    recent: RecentStates,
    /// Answers that could not be used, of outer, inner and mixer law.
    pub not_finite: [NotFinite; 3],
    laws: FlownLaws,
    /// What outer, inner and mixer law show.
    pub telemetry: [TelemetryTally; LAW_ROLES.len()],
    /// The theorem, watched.
    pub theorem: TheoremTally,
    /// The first [`SWAPS_KEPT`] swaps.
    pub swaps: Vec<swaps::AppliedSwap>,
    /// All that came.
    pub swaps_seen: u64,
    /// The flight over time.
    pub tracer: Tracer,
    newest: Option<(u64, u64)>,
    /// Ticks that the plant had skipped when it published the newest state.
    skipped: u64,
}

/// Follows the sequence numbers of a topic.
#[derive(Clone, Copy, Debug, Default)]
struct Sequence {
    last: Option<(u64, u64)>,
    lost: u64,
}

impl Sequence {
    /// Whether messages are missing before this one.
    fn follow(&mut self, epoch: u64, seq: u64, joins: bool) -> bool {
        let expected = match self.last {
            Some((last_epoch, last_seq)) if last_epoch == epoch => last_seq + 1,
            None if joins => seq,
            _ => 0,
        };
        self.lost += seq.saturating_sub(expected);
        self.last = Some((epoch, seq));
        seq > expected
    }
}

/// Whether a rotor command is the mixer's last word of a run: idle, and the answer to no state.
#[must_use]
pub fn is_last_word(message: &Message<RotorSpeeds>) -> bool {
    message.envelope.stamps_of(Role::Mixer).receive_ns == 0
}

impl Tally {
    /// Counts a run from its tick 0 on.
    ///
    /// # Errors
    /// Those of [`SeriesSet::new`].
    pub fn new(pace: Pace, t0_ns: u64, tracking: Tracking) -> Result<Self, Failure> {
        let grid = match pace {
            Pace::Realtime(grid) => Some(grid),
            Pace::Lockstep => None,
        };
        Ok(Self {
            joins: false,
            grid,
            t0_ns,
            tracking,
            series: SeriesSet::new()?,
            miss_runs: MissRuns::default(),
            deadlines: grid.map(Deadlines::new),
            autopsy: None,
            deaths: DeathTally::new(tracking.period_s()),
            late_commands: LateCommands::default(),
            tracer: Tracer::new(tracking),
            leads: LeadTally::new()?,
            states: 0,
            last_wake: [None; 4],
            passages: VecDeque::new(),
            commands: VecDeque::new(),
            last_word_ns: None,
            sequences: [Sequence::default(); TOPICS.len()],
            flight: FlightTally::default(),
            recent: RecentStates::new(tracking.period_s()),
            not_finite: [NotFinite::default(); 3],
            laws: FlownLaws::default(),
            telemetry: [TelemetryTally::new(&[]); LAW_ROLES.len()],
            theorem: TheoremTally::default(),
            swaps: Vec::new(),
            swaps_seen: 0,
            newest: None,
            skipped: 0,
        })
    }

    /// Counts a run from the next message on.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn joining(pace: Pace, t0_ns: u64, tracking: Tracking) -> Result<Self, Failure> {
        let tally = Self::new(pace, t0_ns, tracking)?;
        Ok(Self { joins: true, deadlines: tally.grid.map(Deadlines::joining), ..tally })
    }

    /// Follows what these laws show, from the next message on.
    pub fn flown_by(&mut self, laws: FlownLaws) {
        self.laws = laws;
        self.telemetry = LAW_ROLES.map(|role| TelemetryTally::new(laws.signals.of(role)));
        self.tracer.flown_by(laws);
        laws.without_theorem.into_iter().for_each(|law| self.theorem.does_not_apply(law));
    }

    /// Whether messages of the topic are missing before this one.
    fn follow<C: Topic>(&mut self, topic: usize, message: &Message<C>) -> bool {
        self.sequences[topic].follow(message.envelope.epoch, message.envelope.seq, self.joins)
    }

    fn keep_stamps<C: Topic>(&mut self, message: &Message<C>) {
        self.deaths.message(message);
        if let Some(autopsy) = &mut self.autopsy {
            autopsy.stamps(message);
        }
    }

    /// Follows the causes of missed deadlines from now on; in lockstep there are no deadlines.
    ///
    /// `is_virtual`: a hypervisor may run below; `shares_processor`: all loops were granted the same one.
    pub fn begin_autopsy(&mut self, is_virtual: bool, shares_processor: bool) {
        self.autopsy = self.grid.map(|grid| Autopsy::new(grid, is_virtual, shares_processor));
    }

    /// Takes a state.
    pub fn state(&mut self, message: &Message<State>) {
        let unseen = self.follow(0, message);
        let tick = message.envelope.tick;
        self.newest = Some((tick, message.envelope.sample_ns));
        self.skipped = message.content.ticks_skipped;
        self.deaths.message(message);
        self.stage(Self::passage(message, unseen));
        self.settle(tick, tick.checked_sub(1));
        if let Some(autopsy) = &mut self.autopsy {
            autopsy.state(message);
        }
        let state = &message.content;
        if self.joins && self.states == 0 {
            self.miss_runs = MissRuns::joining(state.deadlines_missed, state.deadline_miss_run);
        }
        self.states += 1;
        self.timer(message.envelope.lead_ns, message.envelope.timer_late_ns);
        if unseen {
            self.miss_runs.unseen(state.deadlines_missed, state.deadline_miss_run);
        }
        self.miss_runs.update(state.deadlines_missed, state.deadline_miss_run);
        let error_m = self.tracking.error_m(tick, state);
        self.deaths.error(tick, error_m);
        self.flight.tracking.take(error_m);
        self.recent.take(tick, state.truth.position_w_m[2], error_m);
        self.flight.truth = state.truth.theta();
        self.theorem.truth(self.flight.truth);
    }

    /// Tick of the newest state; 0 before the first.
    #[must_use]
    pub fn newest_tick(&self) -> u64 {
        self.newest.map_or(0, |(tick, _)| tick)
    }

    /// Takes a set-point.
    pub fn setpoint(&mut self, message: &Message<Setpoint>) {
        let follows_loss = self.follow(1, message);
        self.keep_stamps(message);
        self.not_finite[0].take(message.envelope.tick, message.content.mode);
        self.telemetry[0].take(&message.content.telemetry);
        let hop = Self::hop(Role::Plant, message.envelope.input_tick[0], message);
        self.stage(StampedPassage { hop, ..Self::passage(message, follows_loss) });
    }

    /// Takes a wrench.
    pub fn wrench(&mut self, message: &Message<Wrench>) {
        let follows_loss = self.follow(2, message);
        self.keep_stamps(message);
        self.not_finite[1].take(message.envelope.tick, message.content.mode);
        self.telemetry[1].take(&message.content.telemetry);
        let hop = Self::hop(Role::Outer, message.envelope.input_tick[1], message);
        self.stage(StampedPassage { hop, ..Self::passage(message, follows_loss) });
        self.flight.shown(&self.laws, &message.content);
    }

    /// Takes a rotor command; the mixer's last word has no deadline.
    pub fn rotor_speeds(&mut self, message: &Message<RotorSpeeds>) {
        let follows_loss = self.follow(3, message);
        let envelope = &message.envelope;
        let sent_ns = envelope.stamps_of(Role::Mixer).send_ns;
        if is_last_word(message) {
            self.last_word_ns = Some(sent_ns);
            return;
        }
        self.keep_stamps(message);
        self.not_finite[2].take(envelope.tick, message.content.mode);
        self.telemetry[2].take(&message.content.telemetry);
        let hop = Self::hop(Role::Inner, envelope.input_tick[2], message);
        let loop_ns = (envelope.sample_ns > 0).then(|| sent_ns.saturating_sub(envelope.sample_ns));
        self.stage(StampedPassage { hop, loop_ns, ..Self::passage(message, follows_loss) });
        self.flight.saturated += message.content.saturated;
        let command = StampedCommand { tick: envelope.tick, sent_ns, follows_loss };
        if self.newest.is_some_and(|(newest, _)| command.tick < newest) {
            self.judge(&command);
        } else if self.deadlines.is_some() {
            self.commands.push_back(command);
        }
    }

    /// Takes a swap.
    pub fn swap(&mut self, message: &Message<SwapRecord>) {
        self.follow(4, message);
        self.swaps_seen += 1;
        if self.swaps.len() < SWAPS_KEPT {
            let period_s = self.tracking.period_s();
            self.swaps.push(swaps::AppliedSwap::new(message.envelope.tick, period_s, &message.content));
        }
    }

    /// Takes what is said of the theorem.
    pub fn theorem(&mut self, message: &Message<Monitor>) {
        self.follow(5, message);
        self.theorem.take(message.envelope.epoch, &message.content);
    }

    /// Messages that were overwritten before they were read, in the order of [`TOPICS`].
    #[must_use]
    pub fn lost(&self) -> Counts {
        self.sequences.map(|sequence| sequence.lost)
    }

    /// Ticks, with the identity that they must satisfy: the sum is counted from messages, the time is the clock's.
    #[must_use]
    pub fn ticks(&self, run: &boards::Run) -> schema::Ticks {
        let elapsed_periods = self.newest.map_or(0, |(tick, sample_ns)| match self.grid {
            Some(grid) => grid.tick_at(sample_ns) + 1,
            // Where ticks have no length, only their numbers can be compared.
            None => tick + 1,
        });
        let published = self.states + self.lost()[0];
        // In flight, the plant's board is ahead of the messages that were taken.
        let skipped = if run.phase() == boards::RunPhase::Closed { run.ticks_skipped } else { self.skipped };
        // Ticks skipped after the last one that was published lie behind the last stamp.
        let skipped_at_the_end = self.newest.map_or(0, |(tick, _)| {
            let flown = if run.ending() == boards::Ending::Completed { run.last_tick } else { tick };
            flown.saturating_sub(tick)
        });
        let total = elapsed_periods + skipped_at_the_end;
        schema::Ticks {
            run: published,
            skipped,
            elapsed_s: match self.grid {
                Some(grid) => (total * grid.period_ns) as f64 / 1e9,
                None => self.newest.map_or(0, |(_, sample_ns)| sample_ns.saturating_sub(self.t0_ns)) as f64 / 1e9,
            },
            elapsed_periods: total,
            identity_holds: published + skipped == total,
        }
    }

    /// Control performance so far.
    #[must_use]
    pub fn flight(&self) -> schema::ControlPerformance {
        self.flight.performance(&self.recent)
    }
}

#[cfg(test)]
mod tests;
