//! Processes that ended during the flight: when and how they ended, and the cost for the flight.

use crate::faults::{ProcessFailure, RecoveryPhases};
use crate::schema::Report;
use messages::blackboards::Arrival;
use messages::grid::Pace;
use messages::header::Message;
use messages::role::{Role, STAGES};
use messages::topic::Topic;

/// How long after a death its cost is looked for [s].
pub const COST_S: f64 = 5.0;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObservedFailure {
    pub role: String,
    /// Epoch of its messages; 0 where it sent none.
    pub epoch: u64,
    pub how: String,
    pub noticed_ns: u64,
    /// How its successor came, where it has one.
    pub way: Replacement,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Replacement {
    /// Process number; 0 where there is none.
    pub pid: u32,
    /// When what the dead one had left was removed [ns].
    pub cleaned_ns: u64,
    pub arrival: Arrival,
}

impl Replacement {
    /// The parts, up to the beginning of a tick, for a process that had sent its last message in another one; nothing
    /// where the successor did not get to fly.
    fn parts(
        &self,
        noticed_ns: u64,
        last_tick_ns: u64,
        first_tick_ns: u64,
    ) -> Option<RecoveryPhases> {
        let at = self.arrival;
        let ms = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
        (at.armed_ns > 0).then(|| RecoveryPhases {
            noticed_ms: ms(last_tick_ns, noticed_ns),
            cleaned_ms: ms(noticed_ns, self.cleaned_ns),
            begun_ms: ms(self.cleaned_ns, at.begun_ns),
            made_ms: ms(at.begun_ns, at.made_ns),
            placed_ms: ms(at.made_ns, at.placed_ns),
            ported_ms: ms(at.placed_ns, at.ported_ns),
            engaged_ms: ms(at.ported_ns, at.engaged_ns),
            armed_ms: ms(at.engaged_ns, at.armed_ns),
            first_tick_ms: ms(at.armed_ns, first_tick_ns),
        })
    }
}

/// Puts in what the launcher saw: how each process ended, and deaths that no message tells of.
///
/// In lockstep, ticks have no place on the clock: how long it took is not known.
pub fn note(report: &mut Report, noted: &[ObservedFailure], pace: &Pace) {
    let grid = match pace {
        Pace::Realtime(grid) => Some(grid),
        Pace::Lockstep => None,
    };
    let period_s = report.run.period_us / 1e6;
    for it in noted {
        let is_role = |death: &ProcessFailure| death.role == it.role;
        let is_it = |death: &&mut ProcessFailure| {
            is_role(death) && death.epoch == it.epoch && it.epoch != 0
        };
        if let Some(death) = report.deaths.iter_mut().find(is_it) {
            death.how.clone_from(&it.how);
            let Some(grid) = grid else { continue };
            let last_tick_ns = grid.begin_of(death.tick);
            let since_ns = it.noticed_ns.saturating_sub(last_tick_ns);
            death.noticed_after_ms = Some(since_ns as f64 / 1e6);
            let is_back = death.back_after_ms.is_some();
            let lost = death.ticks_lost.filter(|_| is_back);
            let first_tick_ns = lost.map(|lost| grid.begin_of(death.tick + lost + 1));
            death.back_parts =
                first_tick_ns.and_then(|first| it.way.parts(it.noticed_ns, last_tick_ns, first));
            continue;
        }
        if report.deaths.len() >= DEATHS_KEPT {
            // The recorder counts the ends of processes that had sent something in a flight with one channel.
            let is_counted = it.epoch != 0 && report.redundancy.is_none();
            report.deaths_left_out += u64::from(!is_counted);
            continue;
        }
        let tick = grid.map_or(report.ticks.run, |grid| grid.tick_at(it.noticed_ns));
        let covers = |death: &&ProcessFailure| {
            let lost = |lost| (death.tick..=death.tick + lost).contains(&tick);
            is_role(death) && death.ticks_lost.is_some_and(lost)
        };
        let within = report.deaths.iter().find(covers).map(|death| death.tick);
        report.deaths.push(ProcessFailure {
            role: it.role.clone(),
            epoch: it.epoch,
            tick,
            time_s: tick as f64 * period_s,
            how: it.how.clone(),
            within,
            ..ProcessFailure::default()
        });
    }
    report.deaths.sort_by_key(|death| death.tick);
}

pub const fn number(report: &Report) -> u64 {
    (report.deaths.len() as u64).saturating_add(report.deaths_left_out)
}

const DEATHS_KEPT: usize = 500;

#[derive(Clone, Debug)]
pub struct FailureStatistics {
    period_s: f64,
    cost_ticks: u64,
    /// In the order of [`STAGES`]; none before a stage's first message.
    senders: [Option<Sender>; STAGES.len()],
    pub deaths: Vec<ProcessFailure>,
    pub left_out: u64,
}

#[derive(Clone, Copy, Debug)]
struct Sender {
    epoch: u64,
    tick: u64,
    sent_ns: u64,
    error_max_m: f64,
}

impl FailureStatistics {
    pub fn new(period_s: f64) -> Self {
        let cost_ticks = (COST_S / period_s).round() as u64;
        Self {
            period_s,
            cost_ticks,
            senders: [None; STAGES.len()],
            deaths: Vec::new(),
            left_out: 0,
        }
    }

    pub fn error(&mut self, tick: u64, error_m: f64) {
        let is_due = |since: u64| tick > since && tick - since <= self.cost_ticks;
        let senders = self.senders.iter_mut().flatten();
        for sender in senders.filter(|sender| is_due(sender.tick)) {
            sender.error_max_m = sender.error_max_m.max(error_m);
        }
        for death in self.deaths.iter_mut().filter(|death| is_due(death.tick)) {
            let max_m = &mut death.position_error_max_m;
            *max_m = max_m.map(|max_m| max_m.max(error_m));
        }
    }

    pub fn message<C: Topic>(&mut self, message: &Message<C>) {
        let (envelope, role) = (&message.envelope, C::SENDER);
        let sent_ns = envelope.stamps_of(role).send_ns;
        let now = Sender {
            epoch: envelope.epoch,
            tick: envelope.tick,
            sent_ns,
            error_max_m: 0.0,
        };
        let sender = self.senders.get_mut(role as usize);
        let last = sender.and_then(|sender| sender.replace(now));
        if let Some(last) = last.filter(|last| last.epoch != now.epoch) {
            let back_after_ms = Some(sent_ns.saturating_sub(last.sent_ns) as f64 / 1e6);
            let lost = now.tick.saturating_sub(last.tick + 1);
            self.keep(role, &last, back_after_ms, lost);
        }
    }

    /// Takes which stages ended without landing and have no successor, when the flight is over.
    pub fn finish(&mut self, fallen: [bool; STAGES.len()], last_tick: u64) {
        for (i, role) in STAGES.into_iter().enumerate() {
            if let Some(last) = self.senders[i].filter(|_| fallen[i]) {
                self.keep(role, &last, None, last_tick.saturating_sub(last.tick));
            }
        }
    }

    fn keep(&mut self, role: Role, last: &Sender, back_after_ms: Option<f64>, ticks_lost: u64) {
        if self.deaths.len() == DEATHS_KEPT {
            self.left_out += 1;
            return;
        }
        self.deaths.push(ProcessFailure {
            role: role.name().into(),
            tick: last.tick,
            time_s: last.tick as f64 * self.period_s,
            epoch: last.epoch,
            back_after_ms,
            ticks_lost: Some(ticks_lost),
            position_error_max_m: Some(last.error_max_m),
            ..ProcessFailure::default()
        });
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use messages::content::{State, Wrench};

    use super::*;
    use crate::sample::good;
    use crate::schema::RedundancySection;

    #[test]
    fn the_phases_of_a_recovery_follow_each_other() {
        let ms = |ms: u64| ms * 1_000_000;
        let mut way = Replacement {
            pid: 7,
            cleaned_ns: ms(104),
            arrival: Arrival {
                begun_ns: ms(107),
                made_ns: ms(111),
                placed_ns: ms(116),
                ported_ns: ms(122),
                engaged_ns: ms(129),
                armed_ns: ms(137),
            },
        };
        let parts = |way: Replacement| way.parts(ms(102), ms(100), ms(146));
        let expected = RecoveryPhases {
            noticed_ms: 2.0,
            cleaned_ms: 2.0,
            begun_ms: 3.0,
            made_ms: 4.0,
            placed_ms: 5.0,
            ported_ms: 6.0,
            engaged_ms: 7.0,
            armed_ms: 8.0,
            first_tick_ms: 9.0,
        };
        assert_eq!(parts(way), Some(expected));
        way.arrival.armed_ns = 0;
        assert_eq!(parts(way), None, "it did not get to fly");
    }

    fn message<C: Topic>(epoch: u64, tick: u64) -> Message<C> {
        let mut message = Message::of_tick(tick, C::default());
        message.envelope.epoch = epoch;
        message.envelope.stamps[C::SENDER as usize].send_ns = tick * 1_000_000;
        message
    }

    /// Statistics of a flight with such position errors, in which the inner loop sends as an epoch in a range of ticks.
    fn flown(
        stretches: &[(std::ops::Range<u64>, Option<u64>)],
        error_m: impl Fn(u64) -> f64,
    ) -> FailureStatistics {
        let mut statistics = FailureStatistics::new(1e-3);
        for (ticks, epoch) in stretches {
            for tick in ticks.clone() {
                statistics.message(&message::<State>(1, tick));
                statistics.error(tick, error_m(tick));
                if let Some(epoch) = epoch {
                    statistics.message(&message::<Wrench>(*epoch, tick));
                }
            }
        }
        statistics
    }

    #[test]
    fn a_later_epoch_is_a_failure_with_its_cost() {
        let error_m = |tick: u64| match tick {
            99 => 7.0,
            250 => 0.5,
            5_099 => 0.75,
            5_100 => 9.0,
            _ => 0.1,
        };
        let away = [(0..100, Some(2)), (100..190, None)];
        assert!(flown(&away, error_m).deaths.is_empty(), "it may come back");
        let [before, silent] = away;
        let mut statistics = flown(&[before, silent, (190..6_000, Some(3))], error_m);
        let expected = ProcessFailure {
            role: "inner".into(),
            tick: 99,
            time_s: 0.099,
            epoch: 2,
            back_after_ms: Some(91.0),
            ticks_lost: Some(90),
            position_error_max_m: Some(0.75),
            ..ProcessFailure::default()
        };
        statistics.finish([false; 4], 6_000);
        assert_eq!(statistics.deaths, [expected]);
    }

    #[test]
    fn a_stage_that_does_not_come_back_has_failed_when_the_flight_is_over() {
        let error_m = |tick| if tick < 100 { 0.1 } else { 0.3 };
        let mut statistics = flown(&[(0..100, Some(2)), (100..200, None)], error_m);
        // Of a mixer that never sent nothing is known.
        statistics.finish([false, false, true, true], 199);
        let [death] = &statistics.deaths[..] else {
            panic!("{statistics:?}")
        };
        assert_eq!((death.tick, death.ticks_lost), (99, Some(100)));
        let cost = (death.back_after_ms, death.position_error_max_m);
        assert_eq!(cost, (None, Some(0.3)));
    }

    #[test]
    fn failures_are_kept_up_to_a_number_and_counted_beyond() {
        let mut statistics = FailureStatistics::new(1e-3);
        (0..600).for_each(|tick| statistics.message(&message::<Wrench>(tick + 1, tick)));
        let kept = (statistics.deaths.len(), statistics.left_out);
        assert_eq!(kept, (DEATHS_KEPT, 99));
        // The supervisor's account adds no row to them: the recorder has counted those that had sent something.
        let mut report = good();
        (report.deaths, report.deaths_left_out) = (statistics.deaths, statistics.left_out);
        let noted = [1, 550, 0].map(|epoch| ObservedFailure {
            role: "inner".into(),
            epoch,
            ..ObservedFailure::default()
        });
        note(&mut report, &noted, &Pace::Lockstep);
        assert_eq!((report.deaths.len(), number(&report)), (DEATHS_KEPT, 600));
        // With several channels the rows are the supervisor's.
        (report.deaths, report.redundancy) = (Vec::new(), Some(RedundancySection::default()));
        note(&mut report, &noted, &Pace::Lockstep);
        assert_eq!(
            report.deaths.iter().map(|it| it.epoch).collect::<Vec<_>>(),
            [1, 550, 0]
        );
    }

    #[test]
    fn a_report_keeps_the_epochs_of_a_machine_that_has_been_up_for_years() {
        let years_ns = 1 << 58;
        let mut report = good();
        report.deaths = flown(
            &[(0..10, Some(years_ns)), (10..20, Some(years_ns + 1))],
            |_| 0.0,
        )
        .deaths;
        let text = report.text().unwrap();
        let read = Report::of(&text, Path::new("report.json")).unwrap();
        assert_eq!(read.deaths, report.deaths);
    }
}
