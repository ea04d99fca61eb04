//! When stages woke, how long they took, and whether their commands were in time.
//!
//! A stage's work in a tick counts once the plant has flown the tick, and the deadline of its command counts once the
//! plant has judged it. A stage that goes on for a while after the plant has died does not fly.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use model::boards;
use model::envelope::Message;
use model::realtime::Lead;
use model::role::{Role, STAGES};
use model::topic::Topic;

use crate::lead::LeadSection;
use crate::tally::Tally;
use crate::tally::deadlines::{DeadlineOutcome, LateCommands};
use crate::tally::series::{Series, SeriesSet};
use crate::tally::tracer::Timing;

/// What a stage did in a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct StampedPassage {
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
    /// Whether messages were lost right before.
    pub follows_loss: bool,
}

/// A rotor command that was published.
#[derive(Clone, Copy, Debug)]
pub(super) struct StampedCommand {
    pub tick: u64,
    pub sent_ns: u64,
    /// Whether messages were lost right before.
    pub follows_loss: bool,
}

impl Tally {
    /// Waking of a stage for a tick: ticks that it left out enter with their whole lateness.
    fn wake(&mut self, passage: &StampedPassage) {
        let StampedPassage { role, tick, receive_ns: wake_ns, follows_loss, .. } = *passage;
        let last = self.last_wake[role as usize].replace((tick, wake_ns)).filter(|_| !follows_loss);
        let first = if self.joins || follows_loss { tick } else { 0 };
        self.owed_wakes(role, last.map_or(first, |(last_tick, _)| last_tick + 1)..=tick, wake_ns);
        if let Some((_, last_wake_ns)) = last {
            self.series.record(Series::Period(role), wake_ns.saturating_sub(last_wake_ns));
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

    /// How far ahead of a tick the plant's timer was to be set, and how late the kernel woke it.
    pub(super) fn timer(&mut self, lead_ns: u64, late_ns: u64) {
        if self.grid.is_some() {
            self.series.record(Series::Timer, late_ns);
            self.leads.take(lead_ns, late_ns);
        }
    }

    /// The lead, at take-off and in flight, and what waiting for the ticks cost of the time that the flight took.
    #[must_use]
    pub fn lead(&self, at_take_off: &Lead, rehearsals: u64) -> LeadSection {
        let flown_ns = self.grid.map_or(0, |grid| self.states * grid.period_ns);
        self.leads.section(at_take_off, rehearsals, flown_ns)
    }

    /// A stage's stamps in a message of its own.
    pub(super) fn passage<C: Topic>(message: &Message<C>, follows_loss: bool) -> StampedPassage {
        let (role, envelope) = (C::SENDER, &message.envelope);
        let stamps = envelope.stamps_of(role);
        StampedPassage {
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
    pub(super) fn stage(&mut self, passage: StampedPassage) {
        if self.newest.is_some_and(|(newest, _)| passage.tick <= newest) {
            self.count(&passage);
        } else {
            self.passages.push_back(passage);
        }
    }

    fn count(&mut self, passage: &StampedPassage) {
        self.wake(passage);
        let StampedPassage { role, tick, receive_ns, send_ns, previous_busy_ns, .. } = *passage;
        self.series.record(Series::Compute(role), send_ns.saturating_sub(receive_ns));
        if previous_busy_ns > 0 {
            self.series.record(Series::Busy(role), previous_busy_ns);
        }
        if let Some((series, hop_ns)) = passage.hop {
            self.series.record(series, hop_ns);
        }
        if let Some(loop_ns) = passage.loop_ns {
            self.series.record(Series::Loop, loop_ns);
            self.tracer.timing(tick, Timing::Loop, loop_ns);
        }
    }

    /// Counts what was done in ticks up to `flown`, and judges the commands up to that of `judged`.
    pub(super) fn settle(&mut self, flown: u64, judged: Option<u64>) {
        for passage in std::mem::take(&mut self.passages) {
            if passage.tick <= flown {
                self.count(&passage);
            } else {
                self.passages.push_back(passage);
            }
        }
        while let Some(command) = self.commands.pop_front_if(|command| Some(command.tick) <= judged) {
            self.judge(&command);
        }
    }

    pub(super) fn judge(&mut self, command: &StampedCommand) {
        let Some(deadlines) = &mut self.deadlines else { return };
        let (series, late_commands) = (&mut self.series, &mut self.late_commands);
        if command.follows_loss {
            deadlines.unseen_before(command.tick);
        }
        deadlines.published(command.tick, command.sent_ns, |tick, verdict| enter(series, late_commands, tick, verdict));
    }

    /// The flight is over, at the latest at `now_ns`: what was still owed then is late until its end.
    pub fn finish(&mut self, run: &boards::Run, now_ns: u64) {
        // States that were published after the newest one that came.
        self.sequences[0].lost += run.ticks_run.saturating_sub(self.states + self.sequences[0].lost);
        let Some((tick, sample_ns)) = self.newest else { return };
        let completed = run.ending() == boards::Ending::Completed;
        // A flight that was planned to end with its last tick was awake to judge it; any other one judged up to its
        // last state.
        let (flown, judged) =
            if completed { (run.last_tick, Some(run.last_tick)) } else { (tick, tick.checked_sub(1)) };
        self.settle(flown, judged);
        (self.passages, self.commands) = (VecDeque::new(), VecDeque::new());
        let (Some(last_tick), Some(grid)) = (judged, self.grid) else { return };
        if tick < run.tick.min(run.last_tick) {
            // The end was not seen: nobody knows who was late there.
            return;
        }
        let end_ns = if completed {
            self.last_word_ns.filter(|ns| *ns >= grid.begin_of(last_tick + 1)).unwrap_or(now_ns)
        } else {
            sample_ns
        };
        for role in STAGES {
            let Some((woken, _)) = self.last_wake[role as usize] else { continue };
            self.owed_wakes(role, woken + 1..=last_tick, end_ns);
        }
        if let Some(deadlines) = &mut self.deadlines {
            let (series, late_commands) = (&mut self.series, &mut self.late_commands);
            deadlines.finish(last_tick, end_ns, |tick, verdict| enter(series, late_commands, tick, verdict));
        }
    }

    /// The hop into a stage, where its driving input was of this tick.
    pub(super) fn hop<C: Topic>(from: Role, input_tick: u64, message: &Message<C>) -> Option<(Series, u64)> {
        let envelope = &message.envelope;
        let sent_ns = envelope.stamps_of(from).send_ns;
        let received_ns = envelope.stamps_of(C::SENDER).receive_ns;
        (input_tick == envelope.tick).then(|| (Series::Hop(from, C::SENDER), received_ns.saturating_sub(sent_ns)))
    }
}

/// Enters the verdict on a tick's deadline.
fn enter(series: &mut SeriesSet, late_commands: &mut LateCommands, tick: u64, verdict: DeadlineOutcome) {
    match verdict {
        DeadlineOutcome::Slack(ns) => series.record(Series::Slack, ns),
        DeadlineOutcome::Late(ns) => {
            late_commands.take(tick, ns);
            series.record(Series::Late, ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use controller::Trajectory;
    use model::envelope::Envelope;
    use model::grid::{Grid, Pace};
    use model::messages::State;

    use super::*;
    use crate::tracking::Tracking;

    #[test]
    fn what_a_timer_leaves_of_its_lead_is_waited_out_and_paid_for() {
        let grid = Grid { t0_ns: 1_000_000_000, period_ns: 1_000_000 };
        let mut tally = Tally::new(Pace::Realtime(grid), grid.t0_ns, Tracking::of(Trajectory::Hover, 1e-3)).unwrap();
        let ticks = [(100_000, 20_000), (110_000, 60_000), (90_000, 300_000), (100_000, 30_000)];
        for (tick, (lead_ns, timer_late_ns)) in (0..).zip(ticks) {
            let sample_ns = grid.begin_of(tick) + if timer_late_ns > lead_ns { 210_000 } else { 0 };
            let envelope = Envelope { tick, seq: tick, sample_ns, lead_ns, timer_late_ns, ..Envelope::new() };
            tally.state(&Message { envelope, content: State::default() });
        }
        let timer = tally.series.flight(Series::Timer).unwrap();
        assert_eq!((timer.len(), timer.count_between(290_000, 310_000)), (4, 1), "also one that came after its tick");
        let lead = tally.lead(&Lead { lead_ns: 100_000, rehearsal_ns: 40_000, timer_p90_ns: 30_000 }, 3);
        assert_eq!((lead.lead_us, lead.rehearsal_us, lead.timer_p90_us, lead.rehearsals), (100.0, 40.0, 30.0, 3));
        assert_eq!([lead.least_us, lead.median_us, lead.most_us].map(f64::round), [90.0, 100.0, 110.0]);
        assert!((lead.processor_percent - 5.0).abs() < 1e-9, "80 + 50 + 0 + 70 us of 4 ms: {lead:?}");
    }
}
