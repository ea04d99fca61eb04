//! Processes that ended during the flight: when and how they ended, and the cost for the flight.

use crate::schema::Report;
use crate::schema::{ProcessFailure, RecoveryPhases};
use messages::blackboards::Arrival;
use messages::grid::Grid;
use messages::header::Message;
use messages::role::{Role, STAGES};
use messages::topic::Topic;

/// How long after a death its cost is looked for [s].
pub const COST_S: f64 = 5.0;

/// What a launcher saw of a process that ended.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedFailure {
    pub role: String,
    /// Epoch of its messages; 0 where it sent none.
    pub epoch: u64,
    pub how: String,
    /// When the launcher noticed [ns].
    pub noticed_ns: u64,
    /// How its successor came, where it has one.
    pub way: Replacement,
}

/// How a successor came, as its launcher saw it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Replacement {
    /// Process number; 0 where there is none.
    pub pid: u32,
    /// Whether it was a spare that waited.
    pub is_spare: bool,
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
        let Self {
            arrival:
                Arrival {
                    begun_ns,
                    made_ns,
                    placed_ns,
                    ported_ns,
                    engaged_ns,
                    armed_ns,
                },
            ..
        } = *self;
        let ms = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
        (armed_ns > 0).then(|| RecoveryPhases {
            spare: self.is_spare,
            noticed_ms: ms(last_tick_ns, noticed_ns),
            cleaned_ms: ms(noticed_ns, self.cleaned_ns),
            begun_ms: ms(self.cleaned_ns, begun_ns),
            made_ms: ms(begun_ns, made_ns),
            placed_ms: ms(made_ns, placed_ns),
            ported_ms: ms(placed_ns, ported_ns),
            engaged_ms: ms(ported_ns, engaged_ns),
            armed_ms: ms(engaged_ns, armed_ns),
            first_tick_ms: ms(armed_ns, first_tick_ns),
        })
    }
}

/// Puts in what the launcher saw: how each process ended, and deaths that no message tells of.
pub fn note(report: &mut Report, noted: &[ObservedFailure], grid: &Grid) {
    let period_s = report.run.period_us / 1e6;
    for ObservedFailure {
        role,
        epoch,
        how,
        noticed_ns,
        way,
    } in noted
    {
        let is_it = |death: &&mut ProcessFailure| {
            death.role == *role && death.epoch == *epoch && *epoch != 0
        };
        if let Some(death) = report.deaths.iter_mut().find(is_it) {
            let since_ns = noticed_ns.saturating_sub(grid.begin_of(death.tick));
            (death.how, death.noticed_after_ms) = (how.clone(), Some(since_ns as f64 / 1e6));
            let first_tick_ns = death
                .ticks_lost
                .map(|lost| grid.begin_of(death.tick + lost + 1));
            let first_tick_ns = first_tick_ns.filter(|_| death.back_after_ms.is_some());
            let last_tick_ns = grid.begin_of(death.tick);
            death.back_parts =
                first_tick_ns.and_then(|first| way.parts(*noticed_ns, last_tick_ns, first));
            continue;
        }
        let tick = grid.tick_at(*noticed_ns);
        let within = report
            .deaths
            .iter()
            .find(|death| death.role == *role && death.covers(tick))
            .map(|death| death.tick);
        let (role, how, time_s) = (role.clone(), how.clone(), tick as f64 * period_s);
        report.deaths.push(ProcessFailure {
            role,
            tick,
            time_s,
            how,
            within,
            ..ProcessFailure::default()
        });
    }
    report.deaths.sort_by_key(|death| death.tick);
}

impl ProcessFailure {
    /// Whether a tick is one that the role lost with it.
    fn covers(&self, tick: u64) -> bool {
        self.ticks_lost
            .is_some_and(|lost| (self.tick..=self.tick + lost).contains(&tick))
    }
}

pub const fn number(report: &Report) -> u64 {
    (report.deaths.len() as u64).saturating_add(report.deaths_left_out)
}

/// Deaths that are kept one by one.
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

/// The newest message of a stage.
#[derive(Clone, Copy, Debug)]
struct Sender {
    epoch: u64,
    tick: u64,
    sent_ns: u64,
    /// Largest position error since [m].
    error_max_m: f64,
}

impl FailureStatistics {
    /// Of a flight in ticks of `period_s` [s].
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

    /// Takes the position error of a tick [m].
    pub fn error(&mut self, tick: u64, error_m: f64) {
        let is_due = |since: u64| tick > since && tick - since <= self.cost_ticks;
        for sender in self
            .senders
            .iter_mut()
            .flatten()
            .filter(|sender| is_due(sender.tick))
        {
            sender.error_max_m = sender.error_max_m.max(error_m);
        }
        for death in self.deaths.iter_mut().filter(|death| is_due(death.tick)) {
            death.position_error_max_m = death.position_error_max_m.map(|max_m| max_m.max(error_m));
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
        let Some(last) = self
            .senders
            .get_mut(role as usize)
            .and_then(|sender| sender.replace(now))
        else {
            return;
        };
        if last.epoch != now.epoch {
            let back_after_ms = Some(sent_ns.saturating_sub(last.sent_ns) as f64 / 1e6);
            self.keep(
                role,
                &last,
                back_after_ms,
                now.tick.saturating_sub(last.tick + 1),
            );
        }
    }

    /// Takes which stages ended without landing and have no successor, when the flight is over.
    pub fn finish(&mut self, fallen: [bool; STAGES.len()], last_tick: u64) {
        for (i, role) in STAGES.into_iter().enumerate().filter(|(i, _)| fallen[*i]) {
            if let Some(last) = self.senders[i] {
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
            how: String::new(),
            noticed_after_ms: None,
            back_after_ms,
            back_parts: None,
            ticks_lost: Some(ticks_lost),
            within: None,
            position_error_max_m: Some(last.error_max_m),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_of_a_return_are_its_whole_time() {
        let ms = |ms: u64| ms * 1_000_000;
        let arrival = Arrival {
            begun_ns: ms(107),
            made_ns: ms(111),
            placed_ns: ms(116),
            ported_ns: ms(122),
            engaged_ns: ms(129),
            armed_ns: ms(137),
        };
        let way = Replacement {
            pid: 7,
            is_spare: true,
            cleaned_ns: ms(104),
            arrival,
        };
        let parts = way.parts(ms(102), ms(100), ms(146)).unwrap();
        assert_eq!(
            parts.named().map(|(_, ms)| ms),
            [2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
        );
        assert_eq!(parts.sum_ms(), 46.0);
        assert!(
            parts
                .line()
                .starts_with("a spare [ms]: noticed 2.00, cleaned up 2.00, woken 3.00, settings")
        );
        let fresh = RecoveryPhases {
            spare: false,
            ..parts
        };
        assert!(
            fresh
                .line()
                .starts_with("a new process [ms]: noticed 2.00, cleaned up 2.00, started 3.00")
        );
        let landed = Replacement {
            arrival: Arrival {
                armed_ns: 0,
                ..arrival
            },
            ..way
        };
        assert_eq!(
            landed.parts(ms(102), ms(100), ms(146)),
            None,
            "it did not get to fly"
        );
    }
}

#[cfg(test)]
mod tally_deaths_tests {
    use messages::content::{State, Wrench};
    use messages::header::{Header, Stamps};

    use super::*;

    fn message<C: Topic>(epoch: u64, tick: u64) -> Message<C> {
        let mut envelope = Header {
            epoch,
            tick,
            ..Header::new()
        };
        envelope.stamps[C::SENDER as usize] = Stamps {
            receive_ns: 0,
            send_ns: tick * 1_000_000,
        };
        Message {
            envelope,
            content: C::default(),
        }
    }

    /// Ticks from .. to of a flight whose error is that of the tick, in which the inner loop of an epoch sends.
    fn fly(
        tally: &mut FailureStatistics,
        ticks: std::ops::Range<u64>,
        epoch: Option<u64>,
        error_m: impl Fn(u64) -> f64,
    ) {
        for tick in ticks {
            tally.message(&message::<State>(1, tick));
            tally.error(tick, error_m(tick));
            epoch
                .into_iter()
                .for_each(|epoch| tally.message(&message::<Wrench>(epoch, tick)));
        }
    }

    #[test]
    fn a_later_epoch_is_a_death_with_what_it_cost() {
        let mut tally = FailureStatistics::new(1e-3);
        let error_m = |tick: u64| match tick {
            99 => 7.0,
            250 => 0.5,
            5_099 => 0.75,
            5_100 => 9.0,
            _ => 0.1,
        };
        fly(&mut tally, 0..100, Some(2), error_m);
        fly(&mut tally, 100..190, None, error_m);
        assert!(
            tally.deaths.is_empty(),
            "nobody knows yet whether it comes back"
        );
        fly(&mut tally, 190..6_000, Some(3), error_m);
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
        assert_eq!(tally.deaths, [expected]);
        tally.finish([false; 4], 6_000);
        assert_eq!(tally.deaths.len(), 1);
    }

    #[test]
    fn whoever_does_not_come_back_is_dead_when_the_flight_is_over() {
        let mut tally = FailureStatistics::new(1e-3);
        fly(&mut tally, 0..100, Some(2), |_| 0.1);
        fly(&mut tally, 100..200, None, |_| 0.3);
        tally.finish([false, false, true, true], 199);
        let [death] = &tally.deaths[..] else {
            panic!("a mixer that never sent cannot be told of: {tally:?}")
        };
        assert_eq!(
            (death.tick, death.ticks_lost, death.back_after_ms),
            (99, Some(100), None)
        );
        assert_eq!(death.position_error_max_m, Some(0.3));
        assert!(death.line().starts_with(
            "inner at tick 99 (0.099 s): cause of the end unknown, not back, 100 ticks lost"
        ));
    }

    #[test]
    fn deaths_are_kept_up_to_a_number_and_counted_beyond() {
        let mut tally = FailureStatistics::new(1e-3);
        (0..600).for_each(|tick| tally.message(&message::<Wrench>(tick + 1, tick)));
        assert_eq!((tally.deaths.len(), tally.left_out), (DEATHS_KEPT, 99));
    }
}
