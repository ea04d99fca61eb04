//! Wake-up events: how a stage wakes the next one.
//!
//! An event is a futex in shared memory: one system call to notify, one to wait until an instant.
//! docs/decisions/0005-wake-by-futex.md has the measurements and the rejected alternatives.

use std::cell::Cell;
use std::num::NonZero;
use std::sync::atomic::Ordering;

use rustix::io::Errno;
use rustix::thread::futex;

use crate::access::Wire;
use crate::clock::{now_ns, timespec};
use crate::error::Error;
use crate::sys::{Alarm, WakePage};
use messages::role::{ROLES, Replica, Role};

/// How long after its instant a wait ends whose alarm has failed [ns].
///
/// More than a stage's deadline is before the end of a tick, also at 50 Hz: so the plant's timer comes before this one,
/// and this one is never the next of their processor.
const BACK_STOP_NS: u64 = 10_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    Role(Replica),
    Requests,
}

impl From<Role> for Owner {
    fn from(role: Role) -> Self {
        Self::Role(role.into())
    }
}

impl From<Replica> for Owner {
    fn from(replica: Replica) -> Self {
        Self::Role(replica)
    }
}

impl Owner {
    const fn place(self) -> usize {
        match self {
            Self::Role(Replica { channel, role }) => {
                channel as usize * (ROLES.len() + 1) + role as usize
            }
            Self::Requests => ROLES.len(),
        }
    }
}

impl Wire {
    /// The event of a role's loop or of the server of requests. Only one thread may wait for it.
    pub fn wake_event(&self, owner: impl Into<Owner>) -> Result<WakeEvent, Error> {
        let (page, place) = (self.wake_file.page()?, owner.into().place());
        let word = &page[place];
        // An owner that was killed while it polled no longer does.
        word.polled.store(0, Ordering::SeqCst);
        Ok(WakeEvent {
            seen: Cell::new(word.count.load(Ordering::Acquire)),
            rehearsals_seen: Cell::new(word.rehearsals.load(Ordering::Acquire)),
            page,
            place,
            alarm: None,
        })
    }

    /// As [`Wire::wake_event`], but only for the calling thread, and with an alarm that outlives the waits.
    ///
    /// The deadline is a POSIX timer instead of the futex's timeout. Cancelling a timeout on every notification costs
    /// a VM exit if it is its processor's next timer (docs/decisions/0005-wake-by-futex.md). The price is one more system
    /// call per wait, and the signal: a process has one such event. If the signal is blocked, the wait ends
    /// `BACK_STOP_NS` after its instant.
    pub fn wake_event_with_alarm(&self, owner: impl Into<Owner>) -> Result<WakeEvent, Error> {
        let event = self.wake_event(owner)?;
        let alarm = Alarm::new(self.wake_file.page()?, event.place)
            .map_err(|e| Error::system("cannot make a timer", e))?;
        Ok(WakeEvent {
            alarm: Some((alarm, Cell::new(0))),
            ..event
        })
    }

    pub fn notifier(&self, owner: impl Into<Owner>) -> Result<Notifier, Error> {
        Ok(Notifier {
            page: self.wake_file.page()?,
            place: owner.into().place(),
        })
    }
}

#[derive(Debug)]
pub struct WakeEvent {
    page: WakePage,
    place: usize,
    /// The counts when they were last read.
    seen: Cell<u32>,
    rehearsals_seen: Cell<u32>,
    /// With the instant that it was last set to [ns].
    alarm: Option<(Alarm, Cell<u64>)>,
}

impl WakeEvent {
    /// Waits until a notification or the instant, on CLOCK_MONOTONIC [ns]; returns whether it was notified.
    ///
    /// This covers all notifications since the last call, including an alarm's. A signal ends the wait like the instant; so does
    /// the wake-up call of a notification that was seen before it.
    pub fn wait_until(&self, instant_ns: u64) -> Result<bool, Error> {
        if self.was_notified() {
            return Ok(true);
        }
        let count = &self.page[self.place].count;
        let mut until = timespec(instant_ns);
        if let Some((alarm, set_to_ns)) = &self.alarm {
            // After a warm-up run it is still set to this instant, unless that is over: it fires once.
            if set_to_ns.replace(instant_ns) != instant_ns || now_ns() >= instant_ns {
                alarm
                    .set(until)
                    .map_err(|e| Error::system("cannot set a timer", e))?;
            }
            until = timespec(instant_ns.saturating_add(BACK_STOP_NS));
        }
        match futex::wait_bitset(
            count,
            futex::Flags::empty(),
            self.seen.get(),
            Some(&until),
            NonZero::<u32>::MAX,
        ) {
            Ok(()) | Err(Errno::AGAIN | Errno::INTR | Errno::TIMEDOUT) => Ok(self.was_notified()),
            Err(e) => Err(Error::system("cannot wait for a wake-up event", e)),
        }
    }

    /// Reads the event in a loop until a notification or the instant; returns whether it was notified. It keeps the
    /// processor, and notifications need no system call meanwhile.
    pub fn poll_until(&self, instant_ns: u64) -> bool {
        let word = &self.page[self.place];
        word.polled.store(1, Ordering::SeqCst);
        while word.count.load(Ordering::Acquire) == self.seen.get() && now_ns() < instant_ns {
            std::hint::spin_loop();
        }
        // Before the last look: a notifier that finds it set has counted already, and that one is seen here.
        word.polled.store(0, Ordering::SeqCst);
        self.was_notified()
    }

    /// Whether a warm-up run was notified since the last call.
    pub fn rehearsal_is_due(&self) -> bool {
        let rehearsals = self.page[self.place].rehearsals.load(Ordering::Acquire);
        self.rehearsals_seen.replace(rehearsals) != rehearsals
    }

    /// The newest tick of this run without a message of the role before.
    pub fn silent_tick(&self) -> Option<u64> {
        self.page[self.place]
            .silent
            .load(Ordering::Acquire)
            .checked_sub(1)
    }

    fn was_notified(&self) -> bool {
        let count = self.page[self.place].count.load(Ordering::SeqCst);
        self.seen.replace(count) != count
    }
}

#[derive(Debug)]
pub struct Notifier {
    page: WakePage,
    place: usize,
}

impl Notifier {
    /// Notifies of a warm-up run, without a message.
    pub fn notify_rehearsal(&self) -> Result<(), Error> {
        self.page[self.place]
            .rehearsals
            .fetch_add(1, Ordering::Release);
        self.notify()
    }

    /// Notifies that there is no message of a tick.
    pub fn notify_silence(&self, tick: u64) -> Result<(), Error> {
        self.page[self.place]
            .silent
            .store(tick + 1, Ordering::Release);
        self.notify()
    }

    /// Forgets the silence of an earlier run.
    pub fn begin(&self) {
        self.page[self.place].silent.store(0, Ordering::Release);
    }

    /// Notifies. It is no error if no process waits: others detect a dead stage by its silence.
    pub fn notify(&self) -> Result<(), Error> {
        let word = &self.page[self.place];
        word.count.fetch_add(1, Ordering::SeqCst);
        if word.polled.load(Ordering::SeqCst) == 1 {
            return Ok(());
        }
        futex::wake(&word.count, futex::Flags::empty(), 1)
            .map_err(|e| Error::system("cannot notify a wake-up event", e))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instance::Instance;
    use crate::sys::mask_signals;

    /// One test, because the alarm's signal reaches every alarm of a process.
    #[test]
    fn an_alarm_is_set_once_to_an_instant_to_come_and_a_wait_ends_without_it_too() {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let instance = Instance::under(root.path(), "blocked").unwrap();
        // On a thread of its own, which is then without the signal.
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let wire = Wire::open(&instance).unwrap();
                let event = wire.wake_event_with_alarm(Role::Mixer).unwrap();
                let set_to_ns = &event.alarm.as_ref().unwrap().1;
                // As if it had been set: it is not set again.
                let until = now_ns() + 100_000_000;
                set_to_ns.set(until);
                assert!(!event.wait_until(until).unwrap(), "no alarm");
                assert!(now_ns() >= until + BACK_STOP_NS);
                assert!(event.wait_until(until).unwrap(), "an instant that is over");
                mask_signals(libc::SIG_BLOCK, &[libc::SIGALRM]).unwrap();
                let until = now_ns() + 1_000_000;
                assert!(!event.wait_until(until).unwrap(), "no notification");
                assert!(now_ns() >= until + BACK_STOP_NS);
            });
        });
        instance.remove_leftovers().unwrap();
    }
}
