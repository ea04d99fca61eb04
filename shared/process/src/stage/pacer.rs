//! Which tick a stage works next: input, deadline, or a notification without a message.

use std::cell::Cell;
use std::ops::Range;

use ipc::WakeEvent;
use ipc::clock::{Horizon, now_ns};
use ipc::error::Error;
use messages::content::NO_TICK;
use messages::flight_plan::LOCKSTEP_LOOK_UP_NS;
use messages::grid::{Grid, Pace};
use messages::role::Role;

/// Share of the tick, in percent, after which a stage first looks up from waiting; it then waits on to its deadline.
///
/// Stages later in the chain look up earlier. The timer of an earlier stage is therefore never their processor's next
/// one, so setting or cancelling it while the chain runs costs no access to the timer's hardware. On a virtual machine
/// such an access is an exit to the host (docs/decisions/0005-wake-by-futex.md).
const fn first_look_percent(role: Role) -> u64 {
    match role {
        Role::Outer => 70,
        Role::Inner => 69,
        _ => 68,
    }
}

/// Share of the tick, in percent, for which a stage that was woken early reads its event in a loop.
const POLL_PERCENT: u64 = 5;

/// When a stage reads its event in a loop, instead of waiting for it in the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Polling {
    Never,
    /// The first stage on its processor: from its warm-up run to shortly after the tick has begun.
    FromRehearsal,
    /// Any other: when it was woken, because the loop before it on its processor has then sent its own message.
    OnceWoken,
}

/// The clock, which is read when a message has been received; it keeps what it showed last, 0 if it was not read [ns].
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock<'a> {
    pace: Pace,
    read_ns: &'a Cell<u64>,
}

impl Horizon for Clock<'_> {
    fn latest_tick(&self) -> u64 {
        self.read_ns.set(now_ns());
        self.pace.newest_tick(self.read_ns.get())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WakeReason {
    Work {
        tick: u64,
        receive_ns: u64,
    },
    /// No input by the deadline of a tick.
    Silence {
        tick: u64,
        receive_ns: u64,
    },
    /// A warm-up run was called for, shortly before a tick.
    Rehearsal {
        tick: u64,
    },
    /// The deadline of a tick and its end have passed before the stage got to run.
    Skipped,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    pace: Pace,
    first_look_percent: u64,
    deadline_percent: u64,
    /// How long before the next tick the plant may already keep the processor from the stage [ns].
    lead_ns: u64,
    polling: Polling,
    poll_until_ns: u64,
    /// When the present wait for the event began [ns].
    since_ns: u64,
    pub(super) next_tick: u64,
    /// The first tick after the flight.
    end_tick: u64,
    pub(super) skipped: u64,
}

impl Pacer {
    pub(super) const fn new(pace: Pace, role: Role, ticks: Range<u64>) -> Self {
        Self {
            pace,
            first_look_percent: first_look_percent(role),
            deadline_percent: role.deadline_percent(),
            lead_ns: 0,
            polling: Polling::Never,
            poll_until_ns: 0,
            since_ns: 0,
            next_tick: ticks.start,
            end_tick: ticks.end,
            skipped: 0,
        }
    }

    /// Has the stage read its event in a loop when it is woken early. `is_first`: it is the first one on its processor.
    pub(super) const fn poll(&mut self, is_first: bool) {
        self.polling = if is_first {
            Polling::FromRehearsal
        } else {
            Polling::OnceWoken
        };
    }

    /// For a stage that the plant preempts, with the longest lead of the plant: looks and deadline are shares of the rest of
    /// the tick. Otherwise the stage would wake when the plant already polls the clock, and would only run after its tick.
    pub(super) const fn end_before_lead(&mut self, lead_ns: u64) {
        self.lead_ns = lead_ns;
    }

    pub(super) fn wait(
        &mut self,
        event: &WakeEvent,
        mut take: impl FnMut(Clock<'_>) -> Result<u64, Error>,
    ) -> Result<WakeReason, Error> {
        self.since_ns = now_ns();
        loop {
            // Before the ports: a role announces that it is silent after its messages have arrived.
            let silent = event.silent_tick().filter(|_| self.pace == Pace::Lockstep);
            let read_ns = Cell::new(0);
            let clock = Clock {
                pace: self.pace,
                read_ns: &read_ns,
            };
            let newest = latest(take(clock)?, silent);
            // After the ports: a machine that stalls in between must not make what has come look too early.
            let now = match read_ns.get() {
                0 => now_ns(),
                now => now,
            };
            if let Some(wake) = self.decide(now, newest) {
                self.poll_until_ns = 0;
                return Ok(wake);
            }
            if event.rehearsal_is_due() && self.is_to_come(now) {
                self.poll_until_ns = self.poll_end(now, Polling::FromRehearsal);
                return Ok(WakeReason::Rehearsal {
                    tick: self.next_tick,
                });
            }
            if now < self.poll_until_ns {
                event.poll_until(self.poll_until_ns);
            } else if event.wait_until(self.look_up(now))? {
                self.poll_until_ns = self.poll_end(now_ns(), Polling::OnceWoken);
            }
        }
    }

    /// Whether the next tick begins within half a period from `now`, or the first one is still to come.
    const fn is_to_come(&self, now: u64) -> bool {
        let Pace::Realtime(grid) = self.pace else {
            return false;
        };
        let begin_ns = grid.begin_of(self.next_tick);
        now < begin_ns && (self.next_tick == 0 || now + grid.period_ns / 2 >= begin_ns)
    }

    /// Until when a stage that was woken at `now` polls, if it does so for this reason; 0 is not at all [ns].
    fn poll_end(&self, now: u64, reason: Polling) -> u64 {
        let Pace::Realtime(grid) = self.pace else {
            return 0;
        };
        let begin_ns = grid.begin_of(self.next_tick);
        // A notification before the tick belongs to a message that was processed already.
        if self.polling != reason || (reason == Polling::OnceWoken && now < begin_ns) {
            return 0;
        }
        let end_ns = now.max(begin_ns) + grid.period_ns * POLL_PERCENT / 100;
        end_ns.min(self.deadline())
    }

    /// When the stage looks up from waiting that began at `now` [ns].
    const fn look_up(&self, now: u64) -> u64 {
        match self.pace {
            Pace::Realtime(grid) => {
                let first = self.within(grid, self.first_look_percent);
                if now < first { first } else { self.deadline() }
            }
            Pace::Lockstep => self.deadline(),
        }
    }

    /// When the stage no longer waits for its input [ns].
    const fn deadline(&self) -> u64 {
        match self.pace {
            Pace::Realtime(grid) => self.within(grid, self.deadline_percent),
            Pace::Lockstep => self.since_ns + LOCKSTEP_LOOK_UP_NS,
        }
    }

    /// The instant in the next tick after so much of the time that the stage may use [ns].
    const fn within(&self, grid: Grid, percent: u64) -> u64 {
        let usable_ns = grid.period_ns.saturating_sub(self.lead_ns);
        grid.begin_of(self.next_tick) + usable_ns * percent / 100
    }

    /// What to do at `now` with an input of tick `newest`; `None`: keep waiting.
    fn decide(&mut self, now: u64, newest: u64) -> Option<WakeReason> {
        let before = self.skipped;
        if let Pace::Realtime(grid) = self.pace {
            let current = grid.tick_at(now).max(self.next_tick);
            self.skipped += current.min(self.end_tick).saturating_sub(self.next_tick);
            self.next_tick = current;
        }
        if newest != NO_TICK && newest >= self.next_tick {
            self.skipped += newest - self.next_tick;
            self.next_tick = newest + 1;
            return Some(WakeReason::Work {
                tick: newest,
                receive_ns: now,
            });
        }
        if now < self.deadline() {
            return (self.skipped > before).then_some(WakeReason::Skipped);
        }
        let tick = self.next_tick;
        // In lockstep no tick ends before it was worked.
        self.next_tick += u64::from(self.pace != Pace::Lockstep);
        Some(WakeReason::Silence {
            tick,
            receive_ns: now,
        })
    }
}

/// The newest tick with an input or an announced silence.
fn latest(input: u64, silent: Option<u64>) -> u64 {
    match silent {
        Some(silent) if input == NO_TICK || input < silent => silent,
        _ => input,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid {
        t0_ns: 1_000_000,
        period_ns: 1_000,
    };

    const END: u64 = 20;

    fn at(tick: u64, offset: u64) -> u64 {
        GRID.begin_of(tick) + offset
    }

    fn pacer(next_tick: u64) -> Pacer {
        Pacer::new(Pace::Realtime(GRID), Role::Inner, next_tick..END)
    }

    fn work(tick: u64, receive_ns: u64) -> Option<WakeReason> {
        Some(WakeReason::Work { tick, receive_ns })
    }

    #[test]
    fn a_stage_works_its_input_or_its_deadline_once_and_skips_ticks_that_are_over() {
        let mut next = pacer(0);
        assert_eq!(next.decide(at(0, 0) - 500, NO_TICK), None);
        assert_eq!(next.decide(at(0, 30), 0), work(0, at(0, 30)));
        assert_eq!(next.decide(at(0, 40), 0), None, "of the past tick");
        assert_eq!(next.decide(at(1, 30), 1), work(1, at(1, 30)));
        assert_eq!(next.skipped, 0);

        let mut silent = pacer(5);
        assert_eq!(silent.look_up(at(4, 900)), at(5, 690));
        assert_eq!(silent.look_up(at(5, 690)), at(5, 800));
        assert_eq!(silent.decide(at(5, 799), 4), None);
        let (tick, receive_ns) = (5, at(5, 800));
        let silence = Some(WakeReason::Silence { tick, receive_ns });
        assert_eq!(silent.decide(receive_ns, 4), silence);
        assert_eq!(silent.decide(at(5, 900), 5), None, "too late");
        assert_eq!(silent.decide(at(6, 10), 6), work(6, at(6, 10)));

        // After a pause of the machine, tick 9 may still get its input.
        let mut paused = pacer(5);
        assert_eq!(paused.decide(at(9, 100), 4), Some(WakeReason::Skipped));
        assert_eq!(paused.decide(at(9, 150), 4), None);
        assert_eq!((paused.next_tick, paused.skipped), (9, 4));
        assert_eq!(paused.decide(at(9, 200), 9), work(9, at(9, 200)));

        // Ticks after the flight are none that it skips.
        let mut across = pacer(18);
        assert_eq!(across.decide(at(30, 100), 17), Some(WakeReason::Skipped));
        assert_eq!((across.next_tick, across.skipped), (30, 2));

        // An input that comes just before its tick begins is worked once.
        let mut early = pacer(5);
        assert_eq!(early.decide(at(5, 999), 6), work(6, at(5, 999)));
        assert_eq!((early.next_tick, early.skipped), (7, 1));
        assert_eq!(early.decide(at(6, 10), 6), None);
    }

    #[test]
    fn below_the_plant_a_stage_no_longer_waits_before_the_lead_begins() {
        for role in [Role::Outer, Role::Inner, Role::Mixer] {
            let mut pacer = Pacer::new(Pace::Realtime(GRID), role, 5..END);
            let unbounded_ns = pacer.deadline();
            pacer.end_before_lead(250);
            let deadline_ns = pacer.deadline();
            assert!(deadline_ns < at(5, 750), "{role}");
            assert_eq!(deadline_ns - at(5, 0), (unbounded_ns - at(5, 0)) * 3 / 4);
            assert!(pacer.look_up(at(5, 0)) <= deadline_ns);
            let silence = pacer.decide(deadline_ns, 4);
            assert!(matches!(silence, Some(WakeReason::Silence { tick: 5, .. })));
        }
    }

    #[test]
    fn a_stage_polls_around_the_begin_of_its_tick_or_once_woken_in_it() {
        let polls = |is_first, now, reason| {
            let mut pacer = pacer(5);
            pacer.poll(is_first);
            pacer.poll_end(now, reason)
        };
        let (before, within, late) = (at(4, 900), at(5, 20), at(5, 790));
        assert_eq!(polls(true, before, Polling::FromRehearsal), at(5, 50));
        assert_eq!(polls(true, within, Polling::OnceWoken), 0);
        assert_eq!(polls(false, within, Polling::OnceWoken), at(5, 70));
        assert_eq!(polls(false, before, Polling::OnceWoken), 0, "of tick 4");
        assert_eq!(polls(false, before, Polling::FromRehearsal), 0);
        // No longer than to its deadline.
        assert_eq!(polls(false, late, Polling::OnceWoken), at(5, 800));
        assert_eq!(pacer(5).poll_end(within, Polling::OnceWoken), 0);
    }

    #[test]
    fn a_rehearsal_is_held_only_shortly_before_the_tick_that_is_next() {
        assert!(pacer(5).is_to_come(at(4, 500)));
        // The tick before may still be on its way.
        assert!(!pacer(5).is_to_come(at(4, 499)));
        // The tick has begun, and wins.
        assert!(!pacer(5).is_to_come(at(5, 0)));
        // Before take-off there is none before it.
        assert!(pacer(0).is_to_come(1));
        // In lockstep no tick is waited for.
        assert!(!Pacer::new(Pace::Lockstep, Role::Inner, 0..END).is_to_come(1));
    }

    #[test]
    fn a_notification_is_a_rehearsal_only_if_it_calls_for_one_and_time_is_read_after_the_input() {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let instance = ipc::instance::Instance::under(root.path(), "pacer").unwrap();
        let wire = ipc::Wire::open(&instance).unwrap();
        let event = wire.wake_event(Role::Inner).unwrap();
        let notifier = wire.notifier(Role::Inner).unwrap();
        // A minute long, and begun fifty seconds ago: the next tick is to come.
        let period_ns = 60_000_000_000;
        let grid = Grid {
            t0_ns: now_ns() - period_ns * 5 / 6,
            period_ns,
        };
        // Notified in the first look and in the second; the third finds a message, so that the wait has an end.
        let woken_by = |notify: &dyn Fn()| {
            let mut looks = 0;
            let woken = Pacer::new(Pace::Realtime(grid), Role::Inner, 1..END).wait(&event, |_| {
                looks += 1;
                notify();
                Ok(if looks > 2 { 1 } else { NO_TICK })
            });
            woken.unwrap()
        };
        let by_message = woken_by(&|| notifier.notify().unwrap());
        assert!(matches!(by_message, WakeReason::Work { tick: 1, .. }));
        let called = woken_by(&|| notifier.notify_rehearsal().unwrap());
        assert_eq!(called, WakeReason::Rehearsal { tick: 1 });

        // If the machine stalls while input is taken, a message that is sent meanwhile is not from the future.
        let grid = Grid {
            t0_ns: now_ns(),
            period_ns: 1_000_000,
        };
        let mut pacer = Pacer::new(Pace::Realtime(grid), Role::Inner, 0..END);
        let mut sent_ns = 0;
        let woken = pacer.wait(&event, |clock| {
            std::thread::sleep(std::time::Duration::from_millis(20));
            sent_ns = now_ns();
            let tick = grid.tick_at(sent_ns);
            assert!(clock.latest_tick() >= tick);
            Ok(tick)
        });
        let Ok(WakeReason::Work { tick, receive_ns }) = woken else {
            panic!("{woken:?}")
        };
        assert!(tick >= 20 && receive_ns >= sent_ns);
        drop(wire);
        instance.remove_leftovers().unwrap();
    }
}
