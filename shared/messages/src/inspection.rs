//! Entry check of every message: copied once, then accepted or counted by reason.

use crate::checks::{Check, is_on};
use crate::content::NO_TICK;
use crate::header::{LAYOUT, Message};
pub use crate::rejections::{Reason, Rejections};
use crate::topic::Topic;

/// What the receiver expects of a run's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    pub run_id: u64,
    pub settings: u64,
}

/// Entry check of one topic: remembers what it has let through.
#[derive(Clone, Copy, Debug)]
pub struct Inspector {
    expected: Expected,
    epoch: u64,
    seq: u64,
    tick: u64,
}

impl Inspector {
    pub const fn new(expected: Expected) -> Self {
        Self {
            expected,
            epoch: 0,
            seq: 0,
            tick: NO_TICK,
        }
    }

    /// Lets a message through, or says why not. `newest_tick` is the latest tick that can have begun.
    pub fn inspect<C: Topic>(
        &mut self,
        message: &Message<C>,
        newest_tick: u64,
    ) -> Result<(), Reason> {
        let Message { envelope, content } = message;
        let first = self.tick == NO_TICK;
        let is_replaced = envelope.epoch < self.epoch
            || (!first && envelope.epoch == self.epoch && envelope.seq <= self.seq);
        let is_of_other_tick = envelope.tick > newest_tick
            || (!first && envelope.tick < self.tick + u64::from(!C::MANY_PER_TICK));
        let Expected { run_id, settings } = self.expected;
        let failed = [
            (envelope.layout != LAYOUT, Check::Layout, Reason::Layout),
            (envelope.run_id != run_id, Check::Run, Reason::Run),
            (
                envelope.settings != settings,
                Check::Settings,
                Reason::Settings,
            ),
            (is_replaced, Check::Sequence, Reason::Sequence),
            (is_of_other_tick, Check::Tick, Reason::Tick),
        ];
        let failed = failed
            .iter()
            .find(|(fails, check, _)| *fails && is_on(*check));
        if let Some((_, _, reason)) = failed {
            return Err(*reason);
        }
        if !content.finite() && is_on(Check::NonFinite) {
            return Err(Reason::NonFinite);
        }
        if !content.plausible() && is_on(Check::Implausible) {
            return Err(Reason::Implausible);
        }
        self.epoch = envelope.epoch;
        self.seq = envelope.seq;
        self.tick = envelope.tick;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::{RotorSpeeds, Setpoint, State, Wrench};
    use crate::monitor::{CAUSES, Monitor};

    const EXPECTED: Expected = Expected {
        run_id: 7,
        settings: 9,
    };

    fn message<C: Topic>(tick: u64, seq: u64) -> Message<C> {
        let mut message = Message::<C>::default();
        message.envelope.run_id = EXPECTED.run_id;
        message.envelope.settings = EXPECTED.settings;
        message.envelope.epoch = 100;
        message.envelope.seq = seq;
        message.envelope.tick = tick;
        message
    }

    #[test]
    fn a_sound_sequence_passes() {
        let mut inspector = Inspector::new(EXPECTED);
        for tick in [0, 1, 2, 5] {
            assert_eq!(inspector.inspect(&message::<State>(tick, tick), 5), Ok(()));
        }
    }

    #[test]
    fn each_fault_has_its_reason() {
        type Forge = fn(&mut Message<State>);
        let cases: [(Reason, Forge); 9] = [
            (Reason::Layout, |m| m.envelope.layout ^= 1),
            (Reason::Run, |m| m.envelope.run_id += 1),
            (Reason::Settings, |m| m.envelope.settings += 1),
            (Reason::Sequence, |m| m.envelope.seq = 3),
            (Reason::Sequence, |m| m.envelope.epoch -= 1),
            (Reason::Tick, |m| m.envelope.tick = 12),
            (Reason::Tick, |m| m.envelope.tick = 9),
            (Reason::NonFinite, |m| {
                m.content.measured.rate_b_rad_s[1] = f64::NAN
            }),
            (Reason::Implausible, |m| {
                m.content.measured.position_w_m[2] = 1e6
            }),
        ];
        for (reason, forge) in cases {
            let mut inspector = Inspector::new(EXPECTED);
            assert_eq!(inspector.inspect(&message::<State>(9, 3), 11), Ok(()));
            let mut forged = message(10, 4);
            forge(&mut forged);
            assert_eq!(inspector.inspect(&forged, 11), Err(reason));
            let sound = inspector.inspect(&message::<State>(10, 4), 11);
            assert_eq!(sound, Ok(()), "a rejected message leaves no trace");
        }
    }

    #[test]
    fn a_restarted_sender_is_believed_and_its_predecessor_no_more() {
        let mut inspector = Inspector::new(EXPECTED);
        let mut restarted = message::<Wrench>(10, 0);
        restarted.envelope.epoch += 1;
        for (message, expected) in [
            (message(9, 3), Ok(())),
            (restarted, Ok(())),
            (message(11, 4), Err(Reason::Sequence)),
        ] {
            assert_eq!(inspector.inspect(&message, 11), expected);
        }
    }

    fn check<C: Topic>(reason: Reason, forge: impl Fn(&mut C)) {
        let mut forged = message::<C>(0, 0);
        assert_eq!(Inspector::new(EXPECTED).inspect(&forged, 0), Ok(()));
        forge(&mut forged.content);
        assert_eq!(Inspector::new(EXPECTED).inspect(&forged, 0), Err(reason));
    }

    #[test]
    fn numbers_and_flags_that_do_not_exist_are_refused() {
        use Reason::{Implausible, NonFinite};
        check(Implausible, |wrench: &mut Wrench| wrench.mode = 9);
        check(Implausible, |speeds: &mut RotorSpeeds| {
            speeds.speed_rad_s[3] = -1.0
        });
        check(Implausible, |setpoint: &mut Setpoint| setpoint.limited = 2);
        check(NonFinite, |monitor: &mut Monitor| {
            monitor.rise_max[8] = f64::NAN
        });
        check(Implausible, |monitor: &mut Monitor| {
            monitor.causes = 1 << CAUSES
        });
        check(Implausible, |monitor: &mut Monitor| {
            monitor.is_violation = 2
        });
        check(Implausible, |monitor: &mut Monitor| monitor.is_live = 2);
    }
}
