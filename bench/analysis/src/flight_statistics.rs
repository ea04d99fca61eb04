//! Statistics of a flight: the recorder passes in every message once.
//!
//! The work of a stage in a tick counts after the plant has flown that tick, and the deadline of a command counts after
//! the plant has judged it. A stage that continues after the plant has ended is not counted.

use crate::command_verdicts::CommandVerdicts;
use crate::deadlines::{DeadlineOutcome, Deadlines, Judged, LateCommands, MissRuns};
use crate::faults::AppliedSwap;
use crate::firmware::FirmwareStatistics;
use crate::freshness::FreshnessStatistics;
use crate::laws::{FlownLaws, NotFinite, SignalStatistics};
use crate::losses::Losses;
use crate::miss_analysis::MissAnalysis;
use crate::process_failures::FailureStatistics;
use crate::schema;
use crate::series::{Series, SeriesSet};
use crate::states::is_final_command;
use crate::targets::TargetStatistics;
use crate::theorem::TheoremStatistics;
use crate::timer_lead::{LeadSection, LeadStatistics};
use crate::tracer::{Timing, Tracer};
use crate::tracking::{ControlStatistics, POSITION, Tracking};
use errors::Failure;
use flight_log::entry::{Counts, LogEntry};
use messages::blackboards;
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::grid::{Grid, Pace};
use messages::header::Message;
use messages::realtime::Lead;
use messages::role::{MOST_CHANNELS, Role, STAGES};
use messages::telemetry::{LAW_ROLES, Telemetry};
use messages::topic::Topic;
use std::collections::VecDeque;
use std::ops::RangeInclusive;

pub const SWAPS_KEPT: usize = 500;
/// Places among [`TOPICS`].
const STATES: usize = 0;
const DECISIONS: usize = 6;

/// Statistics of what the stages sent.
#[derive(Clone, Debug)]
pub struct StageStatistics {
    flight: ControlStatistics,
    /// Answers that could not be used, of outer, inner and mixer law.
    pub not_finite: [NotFinite; 3],
    pub telemetry: [SignalStatistics; LAW_ROLES.len()],
    pub firmware: FirmwareStatistics,
    pub theorem: TheoremStatistics,
}

#[derive(Debug)]
pub struct FlightStatistics {
    /// Whether the first message need not be the flight's: then what was before it is unknown, and not missing.
    joins: bool,
    /// Where ticks have their place on the clock; in lockstep they have none.
    grid: Option<Grid>,
    t0_ns: u64,
    tracking: Tracking,
    pub series: SeriesSet,
    pub miss_runs: MissRuns,
    deadlines: Option<Deadlines>,
    freshness: FreshnessStatistics,
    /// Why deadlines were missed; in lockstep there are none.
    pub autopsy: Option<MissAnalysis>,
    pub deaths: FailureStatistics,
    pub late_commands: LateCommands,
    leads: LeadStatistics,
    pub states: u64,
    last_wake: [Option<(u64, u64)>; 4],
    /// What stages did in ticks that the plant may still fly.
    passages: VecDeque<StampedTiming>,
    /// The mixer's passages whose commands the plant has not judged yet.
    commands: VecDeque<StampedTiming>,
    final_command_ns: Option<u64>,
    losses: Losses,
    verdicts: CommandVerdicts,
    laws: FlownLaws,
    pub stages: StageStatistics,
    /// Statistics of the stages before the first message of a tick that the plant has not flown; none without such a message.
    before_unflown: Option<Box<StageStatistics>>,
    pub swaps: Vec<AppliedSwap>,
    pub swaps_seen: u64,
    pub targets: TargetStatistics,
    pub tracer: Tracer,
    /// Tick of the newest state, and when it was sampled.
    newest: Option<(u64, u64)>,
    /// Counts of the plant in the newest state.
    missed: u64,
    skipped: u64,
    /// States that were published after the newest one that came.
    unseen_states: u64,
    /// With several channels, the messages of a stage are of changing processes.
    channels: usize,
}

impl FlightStatistics {
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
            deadlines: grid.map(|grid| Deadlines::new(grid, false)),
            freshness: FreshnessStatistics::default(),
            autopsy: None,
            deaths: FailureStatistics::new(tracking.period_s()),
            late_commands: LateCommands::default(),
            tracer: Tracer::new(tracking),
            leads: LeadStatistics::new()?,
            states: 0,
            last_wake: [None; 4],
            passages: VecDeque::new(),
            commands: VecDeque::new(),
            final_command_ns: None,
            losses: Losses::default(),
            verdicts: CommandVerdicts::default(),
            laws: FlownLaws::default(),
            stages: StageStatistics {
                flight: ControlStatistics::new(tracking.period_s()),
                not_finite: [NotFinite::default(); 3],
                telemetry: [SignalStatistics::new(&[]); LAW_ROLES.len()],
                firmware: FirmwareStatistics::new(tracking.period_s())?,
                theorem: TheoremStatistics::default(),
            },
            before_unflown: None,
            swaps: Vec::new(),
            swaps_seen: 0,
            targets: TargetStatistics::default(),
            newest: None,
            missed: 0,
            skipped: 0,
            unseen_states: 0,
            channels: 1,
        })
    }

    pub fn joining(pace: Pace, t0_ns: u64, tracking: Tracking) -> Result<Self, Failure> {
        let statistics = Self::new(pace, t0_ns, tracking)?;
        Ok(Self {
            joins: true,
            deadlines: statistics.grid.map(|grid| Deadlines::new(grid, true)),
            ..statistics
        })
    }

    pub fn set_laws(&mut self, laws: FlownLaws) {
        self.laws = laws;
        self.stages.telemetry = LAW_ROLES.map(|role| SignalStatistics::new(laws.signals.of(role)));
        self.tracer.set_laws(laws);
        self.stages.firmware.set_signals(&laws.signals);
        if let Some(law) = laws.without_theorem {
            self.stages.theorem.does_not_apply(law);
        }
    }

    pub const fn set_channels(&mut self, channels: usize) {
        self.channels = channels;
    }

    /// Follows the causes of missed deadlines from now on; in lockstep there are no deadlines.
    ///
    /// `shares_processor`: all loops were granted the same one. `leads_ns`: what each channel leaves to the plant's lead.
    pub fn begin_autopsy(&mut self, shares_processor: bool, leads_ns: [u64; MOST_CHANNELS]) {
        let period_s = self.tracking.period_s();
        let analysis = |grid| MissAnalysis::new(grid, period_s, shares_processor, leads_ns);
        self.autopsy = self.grid.map(analysis);
    }

    pub fn take(&mut self, entry: &LogEntry) {
        match entry {
            LogEntry::State(message) => self.state(message),
            LogEntry::Setpoint(message) => self.setpoint(message),
            LogEntry::Wrench(message) => self.wrench(message),
            LogEntry::RotorSpeeds(message) => self.rotor_speeds(message),
            LogEntry::Swap(message) => self.swap(message),
            LogEntry::Theorem(message) => {
                self.stages
                    .theorem
                    .take(message.envelope.epoch, &message.content);
            }
            LogEntry::Decisions(message) => {
                let commands = message.content.commands().iter();
                commands.for_each(|command| self.verdicts.take(command));
            }
            LogEntry::Loss(message) => {
                self.losses.take(&message.content);
                if let Some(autopsy) = &mut self.autopsy {
                    autopsy.loss(&message.content);
                }
            }
        }
    }

    /// Whether messages of a topic were lost between those of two ticks.
    fn lacks(&self, topic: usize, ticks: RangeInclusive<u64>) -> bool {
        self.losses.lacks(topic..=topic, ticks)
    }

    fn state(&mut self, message: &Message<State>) {
        let tick = message.envelope.tick;
        let before = self.newest.map(|(before, _)| before);
        let unseen = self.lacks(STATES, before.unwrap_or(0)..=tick)
            || self.lacks(DECISIONS, before.unwrap_or(0)..=tick);
        self.judge_commands(message, before, unseen);
        self.newest = Some((tick, message.envelope.sample_ns));
        self.before_unflown = None;
        (self.missed, self.skipped) = (
            message.content.deadlines_missed,
            message.content.ticks_skipped,
        );
        self.deaths.message(message);
        self.stage(Self::passage(message, unseen));
        self.settle(tick, tick.checked_sub(1));
        if let Some(autopsy) = &mut self.autopsy {
            autopsy.state(message);
        }
        let state = &message.content;
        let joins_now = self.joins && self.states == 0;
        if joins_now {
            self.freshness.join(state);
        }
        self.states += 1;
        self.targets.take(&state.target, self.tracking.period_s());
        if self.grid.is_some() {
            let (lead_ns, late_ns) = (message.envelope.lead_ns, message.envelope.timer_late_ns);
            self.series.record(Series::Timer, late_ns);
            self.leads.take(lead_ns, late_ns);
        }
        if unseen || joins_now {
            self.miss_runs
                .skip(state.deadlines_missed, state.deadline_miss_run);
        }
        self.miss_runs
            .update(state.deadlines_missed, state.deadline_miss_run);
        let errors = self.tracking.errors(tick, state, None);
        self.deaths.error(tick, errors[POSITION]);
        self.stages.flight.tracking.take(tick, state, &errors);
        self.stages.flight.truth = state.truth.theta();
        self.stages.theorem.truth(self.stages.flight.truth);
    }

    /// Takes the plant's decisions between two states, and so which commands missed their deadlines.
    fn judge_commands(&mut self, message: &Message<State>, before: Option<u64>, unseen: bool) {
        let (tick, state) = (message.envelope.tick, &message.content);
        if state.decision.count == 1 {
            self.verdicts.take(&state.decision.command);
        }
        let joins_now = self.joins && before.is_none();
        if unseen || joins_now {
            self.verdicts.resume(tick, state);
            let missed = state.deadlines_missed.saturating_sub(self.missed);
            let skipped = state.ticks_skipped.saturating_sub(self.skipped);
            if unseen {
                self.freshness.missed += missed.saturating_sub(skipped);
            }
            if let Some(autopsy) = &mut self.autopsy {
                autopsy.misses_unseen(missed);
            }
        } else {
            self.judge_until(tick, before);
        }
    }

    /// Judges the commands of the ticks from that of a state on.
    fn judge_until(&mut self, tick: u64, before: Option<u64>) {
        let mut has_missed = false;
        let (verdicts, autopsy) = (&mut self.verdicts, &mut self.autopsy);
        verdicts.judge(tick, |it| {
            has_missed |= Some(it) == before.map(|before| before + 1);
            if let Some(autopsy) = autopsy {
                autopsy.miss(it - 1);
            }
        });
        if let Some(before) = before {
            self.freshness.judge(before, has_missed);
        }
    }

    /// Tick of the newest state; 0 before the first.
    pub fn newest_tick(&self) -> u64 {
        self.newest.map_or(0, |(tick, _)| tick)
    }

    fn setpoint(&mut self, message: &Message<Setpoint>) {
        let content = &message.content;
        self.loop_message(0, message, content.mode, &content.telemetry, None);
        self.freshness.stage(message.envelope.tick, content.mode);
    }

    fn wrench(&mut self, message: &Message<Wrench>) {
        let content = &message.content;
        self.loop_message(1, message, content.mode, &content.telemetry, None);
        self.freshness.stage(message.envelope.tick, content.mode);
        self.stages.flight.wrench(&self.laws, content);
        self.stages.firmware.take(message.envelope.tick, content);
    }

    /// Counts a message of outer (0), inner (1) or mixer stage (2), and returns its passage.
    fn loop_message<C: Topic>(
        &mut self,
        stage: usize,
        message: &Message<C>,
        mode: u64,
        telemetry: &Telemetry,
        loop_ns: Option<u64>,
    ) -> StampedTiming {
        let last = self.last_wake[C::SENDER as usize].map_or(0, |(tick, _)| tick);
        let follows_loss = self.lacks(stage + 1, last..=message.envelope.tick);
        if self.channels <= 1 {
            self.deaths.message(message);
        }
        if let Some(autopsy) = &mut self.autopsy {
            autopsy.stamps(message);
        }
        self.keep_flown(message.envelope.tick);
        self.stages.not_finite[stage].take(message.envelope.tick, mode);
        self.stages.telemetry[stage].take(telemetry);
        let (envelope, from) = (&message.envelope, STAGES[stage]);
        let received_ns = envelope.stamps_of(C::SENDER).receive_ns;
        let hop_ns = received_ns.saturating_sub(envelope.stamps_of(from).send_ns);
        let is_of_tick = envelope.input_tick[stage] == envelope.tick;
        let hop = is_of_tick.then_some((Series::Hop(from, C::SENDER), hop_ns));
        let passage = StampedTiming {
            hop,
            loop_ns,
            ..Self::passage(message, follows_loss)
        };
        self.stage(passage);
        passage
    }

    /// Keeps what has been flown before a message of a tick that has not been.
    fn keep_flown(&mut self, tick: u64) {
        let has_flown = self.newest.is_none_or(|(newest, _)| tick <= newest);
        if !has_flown && self.before_unflown.is_none() {
            self.before_unflown = Some(Box::new(self.stages.clone()));
        }
    }

    /// Takes a rotor command; the mixer's final one has no deadline.
    fn rotor_speeds(&mut self, message: &Message<RotorSpeeds>) {
        let (envelope, content) = (&message.envelope, &message.content);
        let sent_ns = envelope.stamps_of(Role::Mixer).send_ns;
        if is_final_command(message) {
            self.final_command_ns = Some(sent_ns);
            return;
        }
        let loop_ns = (envelope.sample_ns > 0).then(|| sent_ns.saturating_sub(envelope.sample_ns));
        let command = self.loop_message(2, message, content.mode, &content.telemetry, loop_ns);
        self.freshness.command(envelope, content.mode);
        self.stages.flight.tracking.effort.take(content);
        if self.newest.is_some_and(|(newest, _)| command.tick < newest) {
            self.judge(&command);
        } else if self.deadlines.is_some() {
            self.commands.push_back(command);
        }
    }

    fn swap(&mut self, message: &Message<SwapRecord>) {
        self.swaps_seen += 1;
        if self.swaps.len() < SWAPS_KEPT {
            let (tick, period_s) = (message.envelope.tick, self.tracking.period_s());
            let swap = AppliedSwap::new(tick, period_s, &message.content);
            self.swaps.push(swap);
        }
    }

    /// Messages that were overwritten before they were read, in the order of [`TOPICS`].
    pub fn lost(&self) -> Counts {
        let mut lost = *self.losses.counts();
        lost[STATES] += self.unseen_states;
        lost
    }

    /// Ticks, with the identity that they must satisfy: the sum is counted from messages, the time is the clock's.
    pub fn ticks(&self, run: &blackboards::Run) -> schema::Ticks {
        let elapsed_periods = self.newest.map_or(0, |(tick, sample_ns)| match self.grid {
            // A plant that was stopped until the end flies the last tick after its time.
            Some(grid) => grid.tick_at(sample_ns).min(run.last_tick) + 1,
            // Where ticks have no length, only their numbers can be compared.
            None => tick + 1,
        });
        let published = self.states + self.lost()[0];
        // In flight, the plant's board is ahead of the messages that were taken.
        let skipped = match run.phase() {
            blackboards::RunPhase::Closed => run.ticks_skipped,
            _ => self.skipped,
        };
        let is_complete = run.ending() == blackboards::EndReason::Completed;
        let newest_tick = self.newest_tick();
        // Ticks skipped after the last one that was published lie behind the last stamp.
        let skipped_at_the_end = match self.newest {
            Some(_) if is_complete => run.last_tick.saturating_sub(newest_tick),
            _ => 0,
        };
        let total = elapsed_periods + skipped_at_the_end;
        let sample_ns = self.newest.map_or(0, |(_, sample_ns)| sample_ns);
        let elapsed_ns = match self.grid {
            Some(grid) => total * grid.period_ns,
            None => sample_ns.saturating_sub(self.t0_ns),
        };
        schema::Ticks {
            run: published,
            skipped,
            elapsed_s: elapsed_ns as f64 / 1e9,
            elapsed_periods: total,
            identity_holds: published + skipped == total,
        }
    }

    /// Ticks that ran and whose command missed its deadline, and those whose command came of an older input.
    pub const fn commands_not_fresh(&self) -> (u64, u64) {
        (self.freshness.missed, self.freshness.stale)
    }

    /// Ticks that flew without a fresh command on time; nothing in lockstep, where there are no deadlines.
    pub fn not_fresh(&self, ticks: &schema::Ticks) -> Option<schema::NotFresh> {
        let (missed, stale) = self.commands_not_fresh();
        self.grid
            .map(|_| schema::NotFresh::new(missed, stale, ticks))
    }

    pub fn flight(&self) -> schema::ControlPerformance {
        self.stages.flight.performance()
    }
}

#[derive(Clone, Copy, Debug)]
struct StampedTiming {
    pub role: Role,
    pub tick: u64,
    pub receive_ns: u64,
    pub send_ns: u64,
    /// From waking to being done, in its tick before; 0 is not known.
    pub previous_busy_ns: u64,
    /// From the driving input's publishing to having it in hand, where that was of this tick.
    pub hop: Option<(Series, u64)>,
    /// From the sampling of the state to publishing, of a rotor command that goes back to one.
    pub loop_ns: Option<u64>,
    pub follows_loss: bool,
}

impl FlightStatistics {
    /// Waking of a stage for a tick: ticks that it left out enter with their whole lateness.
    fn wake(&mut self, passage: &StampedTiming) {
        let (role, tick, wake_ns) = (passage.role, passage.tick, passage.receive_ns);
        let last = self.last_wake[role as usize].replace((tick, wake_ns));
        let last = last.filter(|_| !passage.follows_loss);
        let first = match last {
            Some((last_tick, _)) => last_tick + 1,
            None if self.joins || passage.follows_loss => tick,
            None => 0,
        };
        self.owed_wakes(role, first..=tick, wake_ns);
        if let Some((_, last_wake_ns)) = last {
            let period_ns = wake_ns.saturating_sub(last_wake_ns);
            self.series.record(Series::Period(role), period_ns);
        }
    }

    fn owed_wakes(&mut self, role: Role, ticks: RangeInclusive<u64>, wake_ns: u64) {
        let Some(grid) = self.grid else { return };
        for owed in ticks {
            let late_ns = wake_ns.saturating_sub(grid.begin_of(owed));
            self.series.record(Series::Wake(role), late_ns);
            if role == Role::Plant {
                self.tracer.timing(owed, Timing::Wake, late_ns);
            }
        }
    }

    /// The lead, at take-off and in flight, and what waiting for the ticks cost of the time that the flight took.
    pub fn lead(&self, at_take_off: &Lead, rehearsals: u64) -> LeadSection {
        let flown_ns = self.grid.map_or(0, |grid| self.states * grid.period_ns);
        self.leads.section(at_take_off, rehearsals, flown_ns)
    }

    fn passage<C: Topic>(message: &Message<C>, follows_loss: bool) -> StampedTiming {
        let (role, envelope) = (C::SENDER, &message.envelope);
        let stamps = envelope.stamps_of(role);
        StampedTiming {
            role,
            tick: envelope.tick,
            receive_ns: stamps.receive_ns,
            send_ns: stamps.send_ns,
            previous_busy_ns: envelope.previous_busy_ns,
            hop: None,
            loop_ns: None,
            follows_loss,
        }
    }

    /// Counts a passage, now or when its tick has been flown.
    fn stage(&mut self, passage: StampedTiming) {
        let newest = self.newest.map(|(newest, _)| newest);
        if Some(passage.tick) <= newest {
            self.count(&passage);
        } else {
            self.passages.push_back(passage);
        }
    }

    fn count(&mut self, passage: &StampedTiming) {
        self.wake(passage);
        let (role, busy_ns) = (passage.role, passage.previous_busy_ns);
        let computed_ns = passage.send_ns.saturating_sub(passage.receive_ns);
        self.series.record(Series::Compute(role), computed_ns);
        if busy_ns > 0 {
            self.series.record(Series::Busy(role), busy_ns);
        }
        if let Some((series, hop_ns)) = passage.hop {
            self.series.record(series, hop_ns);
        }
        if let Some(loop_ns) = passage.loop_ns {
            self.series.record(Series::Loop, loop_ns);
            self.tracer.timing(passage.tick, Timing::Loop, loop_ns);
        }
    }

    /// Counts what was done in ticks up to `flown`, and judges the commands up to that of `judged`.
    fn settle(&mut self, flown: u64, judged: Option<u64>) {
        for passage in std::mem::take(&mut self.passages) {
            if passage.tick <= flown {
                self.count(&passage);
            } else {
                self.passages.push_back(passage);
            }
        }
        while let Some(command) = self.commands.pop_front_if(|it| Some(it.tick) <= judged) {
            self.judge(&command);
        }
    }

    fn judge(&mut self, command: &StampedTiming) {
        let Some(deadlines) = &mut self.deadlines else {
            return;
        };
        if command.follows_loss {
            deadlines.skip_before(command.tick);
        }
        let judged = deadlines.judge(command.tick, command.send_ns);
        self.enter(judged);
    }

    fn enter(&mut self, judged: impl Iterator<Item = Judged>) {
        for (tick, outcome) in judged {
            match outcome {
                DeadlineOutcome::Slack(ns) => self.series.record(Series::Slack, ns),
                DeadlineOutcome::Late(ns) => {
                    let period_s = self.tracking.period_s();
                    self.late_commands.take(tick, period_s, ns);
                    self.series.record(Series::Late, ns);
                }
            }
        }
    }

    /// The flight is over, at the latest at `now_ns`: what was still owed then is late until its end.
    pub fn finish(&mut self, run: &blackboards::Run, now_ns: u64) {
        let known = self.states + self.losses.counts()[STATES];
        self.unseen_states = run.ticks_run.saturating_sub(known);
        let Some((tick, sample_ns)) = self.newest else {
            return;
        };
        let completed = run.ending() == blackboards::EndReason::Completed;
        if completed && self.unseen_states == 0 {
            self.judge_until(run.last_tick + 1, Some(run.last_tick));
        }
        // A flight that was planned to end with its last tick was awake to judge it; any other one judged up to its
        // last state.
        let (flown, judged) = if completed {
            (run.last_tick, Some(run.last_tick))
        } else {
            (tick, tick.checked_sub(1))
        };
        if let Some(of_flown) = self.before_unflown.take_if(|_| !completed) {
            self.stages = *of_flown;
        }
        self.settle(flown, judged);
        (self.passages, self.commands) = (VecDeque::new(), VecDeque::new());
        let (Some(last_tick), Some(grid)) = (judged, self.grid) else {
            return;
        };
        if tick < run.tick.min(run.last_tick) {
            // The end was not recorded: which stage was late there is unknown.
            return;
        }
        let final_command_ns = self.final_command_ns;
        let end_ns = match final_command_ns.filter(|ns| *ns >= grid.begin_of(last_tick + 1)) {
            _ if !completed => sample_ns,
            final_command_ns => final_command_ns.unwrap_or(now_ns),
        };
        for role in STAGES {
            if let Some((woken, _)) = self.last_wake[role as usize] {
                self.owed_wakes(role, woken + 1..=last_tick, end_ns);
            }
        }
        if let Some(deadlines) = &mut self.deadlines {
            let judged = deadlines.finish(last_tick, end_ns);
            self.enter(judged);
        }
    }
}

#[cfg(test)]
mod tests {
    use controller::Trajectory;
    use flight_log::TOPICS;
    use messages::content::{Decision, TakenCommand};
    use messages::header::{Header, Stamps};

    use super::*;

    const GRID: Grid = Grid {
        t0_ns: 1_000_000_000,
        period_ns: 1_000_000,
    };
    const TRACKING: Tracking = Tracking::of(Trajectory::Lissajous, 1e-3);

    fn statistics() -> FlightStatistics {
        FlightStatistics::new(Pace::Realtime(GRID), GRID.t0_ns, TRACKING).unwrap()
    }

    fn state_of(tick: u64, seq: u64, sample_ns: u64) -> Message<State> {
        let mut message = Message::of_tick(tick, State::default());
        (message.envelope.seq, message.envelope.sample_ns) = (seq, sample_ns);
        message
    }

    #[test]
    fn the_rest_of_the_lead_after_the_timer_is_the_cost_of_waiting() {
        let mut statistics = statistics();
        // Before the first tick there is none.
        let none = statistics.lead(&Lead::default(), 0);
        assert_eq!(none, LeadSection::default());
        for (tick, lead_us, late_us) in [(0, 100, 20), (1, 110, 60), (2, 90, 300), (3, 100, 30)] {
            let late_ns = if late_us > lead_us { 210_000 } else { 0 };
            let mut message = state_of(tick, tick, GRID.begin_of(tick) + late_ns);
            message.envelope.lead_ns = lead_us * 1_000;
            message.envelope.timer_late_ns = late_us * 1_000;
            statistics.state(&message);
        }
        let timer = statistics.series.flight(Series::Timer).unwrap();
        // Also one that came after its tick.
        let counts = (timer.len(), timer.count_between(290_000, 310_000));
        assert_eq!(counts, (4, 1));
        let at_take_off = Lead {
            lead_ns: 100_000,
            rehearsal_ns: 40_000,
            timer_p90_ns: 30_000,
        };
        let lead = statistics.lead(&at_take_off, 3);
        assert_eq!(lead.rehearsals, 3);
        let us = [lead.lead_us, lead.rehearsal_us, lead.timer_p90_us];
        assert_eq!(us, [100.0, 40.0, 30.0]);
        let us = [lead.least_us, lead.median_us, lead.most_us].map(f64::round);
        assert_eq!(us, [90.0, 100.0, 110.0]);
        // 80 + 50 + 0 + 70 us of 4 ms.
        assert!((lead.processor_percent - 5.0).abs() < 1e-9, "{lead:?}");
    }

    #[test]
    fn ticks_add_up_in_flight_whatever_the_plant_has_skipped_since() {
        let mut statistics = statistics();
        // Ticks 3 and 4 were skipped.
        for (seq, tick) in (0..).zip([0, 1, 2, 5, 6]) {
            let mut message = state_of(tick, seq, GRID.begin_of(tick) + 20_000);
            message.content.ticks_skipped = if tick > 2 { 2 } else { 0 };
            statistics.state(&message);
        }
        let ticks = |phase: blackboards::RunPhase| {
            let run = blackboards::Run {
                phase: phase as u64,
                last_tick: 100,
                ticks_skipped: 9,
                ..blackboards::Run::default()
            };
            statistics.ticks(&run)
        };
        let flying = ticks(blackboards::RunPhase::Flying);
        let counts = (flying.run, flying.skipped, flying.elapsed_periods);
        assert_eq!(counts, (5, 2, 7));
        assert!(flying.identity_holds);
        // At the end the plant's own count is held against the messages.
        assert!(!ticks(blackboards::RunPhase::Closed).identity_holds);
    }

    /// Messages of a tick as a flight on the grid has them: every 50th is late, and brings a swap.
    fn take_tick(statistics: &mut FlightStatistics, tick: u64) {
        let begin_ns = GRID.begin_of(tick);
        let envelope = |sent_us: u64| Header {
            tick,
            seq: tick,
            sample_ns: begin_ns + 20_000,
            input_tick: [tick; 3],
            stamps: [Stamps {
                receive_ns: begin_ns + 10_000,
                send_ns: begin_ns + sent_us * 1000,
            }; STAGES.len()],
            ..Header::new()
        };
        fn message<C: Default>(envelope: Header) -> Message<C> {
            let content = C::default();
            Message { envelope, content }
        }
        let (is_late, late) = (tick.is_multiple_of(50), tick / 50);
        let mut state = message::<State>(envelope(20));
        state.content.deadlines_missed = late;
        state.content.deadline_miss_run = u64::from(is_late);
        state.content.decision = Decision {
            count: u64::from(tick > 0),
            command: TakenCommand {
                of_tick: tick.saturating_sub(1),
                acts_from: tick + u64::from(is_late),
                ..TakenCommand::default()
            },
            ..Decision::default()
        };
        statistics.state(&state);
        statistics.setpoint(&message(envelope(30)));
        statistics.wrench(&message(envelope(40)));
        statistics.rotor_speeds(&message(envelope(if is_late { 1_100 } else { 50 })));
        if is_late {
            let mut header = Header::new();
            (header.tick, header.seq) = (tick, late);
            statistics.swap(&message(header));
        }
    }

    #[test]
    fn messages_of_ticks_that_were_not_flown_do_not_count() {
        let counts = |ending: blackboards::EndReason| {
            let mut statistics = statistics();
            (0..100).for_each(|tick| take_tick(&mut statistics, tick));
            for tick in 100..150 {
                let mut speeds = Message::of_tick(tick, RotorSpeeds::default());
                speeds.envelope.stamps[Role::Mixer as usize].receive_ns = GRID.begin_of(tick);
                statistics.take(&LogEntry::RotorSpeeds(speeds));
                statistics.stages.theorem.count_unwatched();
            }
            let (ending, last_tick) = (ending as u64, 149);
            let run = blackboards::Run {
                ending,
                last_tick,
                ..blackboards::Run::default()
            };
            statistics.finish(&run, GRID.begin_of(150));
            let (theorem, effort) = (
                statistics.stages.theorem.section(),
                statistics.flight().effort,
            );
            let commands = effort.unwrap().commands;
            (commands, theorem.ticks)
        };
        assert_eq!(counts(blackboards::EndReason::Failed), (100, 0));
        // The plant skipped the last ticks of a whole flight.
        let completed = counts(blackboards::EndReason::Completed);
        assert_eq!(completed, (150, 50));
    }

    #[test]
    fn memory_is_bounded_however_long_a_flight_is() {
        let mut statistics = statistics();
        statistics.begin_autopsy(true, [0; MOST_CHANNELS]);
        for tick in 0..60_000 {
            take_tick(&mut statistics, tick);
            statistics.autopsy.as_mut().unwrap().look();
            assert!(statistics.passages.len() <= 8 && statistics.commands.len() <= 2);
        }
        let swaps = (statistics.swaps.len(), statistics.swaps_seen);
        assert_eq!(swaps, (SWAPS_KEPT, 1200));
        let late = &statistics.late_commands;
        assert!(late.stretches.len() <= crate::deadlines::KEPT && late.left_out > 0);
        assert!(statistics.miss_runs.lengths().len() <= 2);
        assert_eq!(statistics.lost(), [0; TOPICS.len()]);
    }

    #[test]
    fn a_flight_of_30_days_is_counted_as_one_of_a_minute_is() {
        const DAYS_30: u64 = 30 * 86_400_000;
        let pace = Pace::Realtime(GRID);
        let mut statistics = FlightStatistics::joining(pace, GRID.t0_ns, TRACKING).unwrap();
        (DAYS_30 - 1000..=DAYS_30).for_each(|tick| take_tick(&mut statistics, tick));
        assert_eq!(
            (statistics.states, statistics.newest_tick()),
            (1001, DAYS_30)
        );
        assert_eq!(statistics.lost(), [0; TOPICS.len()]);
        let late = &statistics.late_commands.stretches;
        assert!(late.len() >= 20 && late.iter().all(|it| it.late_us == 100.0));
        let position_m = TRACKING.reference(DAYS_30, &State::default()).position_w_m;
        assert!(position_m.iter().all(|m| m.is_finite() && m.abs() < 10.0));
    }
}
