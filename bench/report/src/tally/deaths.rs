//! Deaths that messages tell of: a stage's next message has a later epoch, or there is none.

use model::envelope::Message;
use model::role::{Role, STAGES};
use model::topic::Topic;

use crate::deaths::{COST_S, Death};

/// Deaths that are kept one by one.
const DEATHS_KEPT: usize = 500;

/// Follows who sends.
#[derive(Clone, Debug)]
pub struct DeathTally {
    period_s: f64,
    cost_ticks: u64,
    /// In the order of [`STAGES`]; none before a stage's first message.
    senders: [Option<Sender>; STAGES.len()],
    /// The first `DEATHS_KEPT`.
    pub deaths: Vec<Death>,
    /// Later ones.
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

impl DeathTally {
    /// Of a flight in ticks of `period_s` [s].
    #[must_use]
    pub fn new(period_s: f64) -> Self {
        let cost_ticks = (COST_S / period_s).round() as u64;
        Self { period_s, cost_ticks, senders: [None; STAGES.len()], deaths: Vec::new(), left_out: 0 }
    }

    /// Takes the position error of a tick [m].
    pub fn error(&mut self, tick: u64, error_m: f64) {
        let is_due = |since: u64| tick > since && tick - since <= self.cost_ticks;
        for sender in self.senders.iter_mut().flatten().filter(|sender| is_due(sender.tick)) {
            sender.error_max_m = sender.error_max_m.max(error_m);
        }
        for death in self.deaths.iter_mut().filter(|death| is_due(death.tick)) {
            death.position_error_max_m = death.position_error_max_m.map(|max_m| max_m.max(error_m));
        }
    }

    /// Takes a message.
    pub fn message<C: Topic>(&mut self, message: &Message<C>) {
        let (envelope, role) = (&message.envelope, C::SENDER);
        let sent_ns = envelope.stamps_of(role).send_ns;
        let now = Sender { epoch: envelope.epoch, tick: envelope.tick, sent_ns, error_max_m: 0.0 };
        let Some(last) = self.senders.get_mut(role as usize).and_then(|sender| sender.replace(now)) else { return };
        if last.epoch != now.epoch {
            let back_after_ms = Some(sent_ns.saturating_sub(last.sent_ns) as f64 / 1e6);
            self.keep(role, &last, back_after_ms, now.tick.saturating_sub(last.tick + 1));
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
        self.deaths.push(Death {
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
    use model::envelope::{Envelope, Stamps};
    use model::messages::{State, Wrench};

    use super::*;

    fn message<C: Topic>(epoch: u64, tick: u64) -> Message<C> {
        let mut envelope = Envelope { epoch, tick, ..Envelope::new() };
        envelope.stamps[C::SENDER as usize] = Stamps { receive_ns: 0, send_ns: tick * 1_000_000 };
        Message { envelope, content: C::default() }
    }

    /// Ticks from .. to of a flight whose error is that of the tick, in which the inner loop of an epoch sends.
    fn fly(tally: &mut DeathTally, ticks: std::ops::Range<u64>, epoch: Option<u64>, error_m: impl Fn(u64) -> f64) {
        for tick in ticks {
            tally.message(&message::<State>(1, tick));
            tally.error(tick, error_m(tick));
            epoch.into_iter().for_each(|epoch| tally.message(&message::<Wrench>(epoch, tick)));
        }
    }

    #[test]
    fn a_later_epoch_is_a_death_with_what_it_cost() {
        let mut tally = DeathTally::new(1e-3);
        let error_m = |tick: u64| match tick {
            99 => 7.0,
            250 => 0.5,
            5_099 => 0.75,
            5_100 => 9.0,
            _ => 0.1,
        };
        fly(&mut tally, 0..100, Some(2), error_m);
        fly(&mut tally, 100..190, None, error_m);
        assert!(tally.deaths.is_empty(), "nobody knows yet whether it comes back");
        fly(&mut tally, 190..6_000, Some(3), error_m);
        let expected = Death {
            role: "inner".into(),
            tick: 99,
            time_s: 0.099,
            epoch: 2,
            back_after_ms: Some(91.0),
            ticks_lost: Some(90),
            position_error_max_m: Some(0.75),
            ..Death::default()
        };
        assert_eq!(tally.deaths, [expected]);
        tally.finish([false; 4], 6_000);
        assert_eq!(tally.deaths.len(), 1);
    }

    #[test]
    fn whoever_does_not_come_back_is_dead_when_the_flight_is_over() {
        let mut tally = DeathTally::new(1e-3);
        fly(&mut tally, 0..100, Some(2), |_| 0.1);
        fly(&mut tally, 100..200, None, |_| 0.3);
        tally.finish([false, false, true, true], 199);
        let [death] = &tally.deaths[..] else { panic!("a mixer that never sent cannot be told of: {tally:?}") };
        assert_eq!((death.tick, death.ticks_lost, death.back_after_ms), (99, Some(100), None));
        assert_eq!(death.position_error_max_m, Some(0.3));
        assert!(death.line().starts_with("inner at tick 99 (0.099 s): nobody saw how, not back, 100 ticks lost"));
    }

    #[test]
    fn deaths_are_kept_up_to_a_number_and_counted_beyond() {
        let mut tally = DeathTally::new(1e-3);
        (0..600).for_each(|tick| tally.message(&message::<Wrench>(tick + 1, tick)));
        assert_eq!((tally.deaths.len(), tally.left_out), (DEATHS_KEPT, 99));
    }
}
