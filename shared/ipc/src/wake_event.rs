//! Doorbells: how a stage wakes the next one.
//!
//! A doorbell is a futex in shared memory: one system call to ring it, one to wait on it until an instant.
//! docs/decisions/0005-wake-by-futex.md has the measurements and the rejected alternatives.

use std::cell::Cell;
use std::num::NonZero;
use std::sync::atomic::Ordering;

use rustix::io::Errno;
use rustix::thread::futex;

use super::Wire;
use crate::clock::timespec;
use crate::error::Error;
use crate::sys::{Alarm, WakePage};
use messages::role::{ROLES, Role};

/// How long after its instant a wait with an alarm ends, had the alarm failed [ns].
///
/// More than a stage's deadline is before the end of a tick, also at 50 Hz: so the plant's timer comes before this one,
/// and this one is never the next of their processor.
const BACK_STOP_NS: u64 = 10_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    Role(Role),
    Desk,
}

impl From<Role> for Owner {
    fn from(role: Role) -> Self {
        Self::Role(role)
    }
}

impl std::fmt::Display for Owner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Role(role) => role.fmt(f),
            Self::Desk => f.write_str("desk"),
        }
    }
}

impl Owner {
    /// Place of its bell in the page.
    const fn place(self) -> usize {
        match self {
            Self::Role(role) => role as usize,
            Self::Desk => ROLES.len(),
        }
    }
}

impl Wire {
    /// The doorbell of a role's loop or of the parameter desk. Only one thread may wait at it.
    pub fn doorbell(&self, owner: impl Into<Owner>) -> Result<WakeEvent, Error> {
        let (page, place) = (self.bells.page()?, owner.into().place());
        let heard = Cell::new(page[place].rung.load(Ordering::Acquire));
        let rehearsed = Cell::new(page[place].rehearsals.load(Ordering::Acquire));
        Ok(WakeEvent {
            page,
            place,
            heard,
            rehearsed,
            alarm: None,
        })
    }

    /// As [`Wire::doorbell`], but only for the calling thread, and with an alarm that outlives the waits.
    ///
    /// The deadline is a POSIX timer instead of the futex's time-out. Cancelling a time-out on every ring costs a VM
    /// exit if it is its processor's next timer (docs/decisions/0005-wake-by-futex.md). The price is one more system
    /// call per wait, and the signal: a process has one such doorbell. If the signal is blocked, the wait ends
    /// `BACK_STOP_NS` after its instant.
    pub fn doorbell_with_alarm(&self, owner: impl Into<Owner>) -> Result<WakeEvent, Error> {
        let doorbell = self.doorbell(owner)?;
        let alarm = Alarm::new(self.bells.page()?, doorbell.place);
        Ok(WakeEvent {
            alarm: Some(alarm.map_err(|e| Error::system("cannot make a timer", e))?),
            ..doorbell
        })
    }

    pub fn bell(&self, owner: impl Into<Owner>) -> Result<Notifier, Error> {
        Ok(Notifier {
            page: self.bells.page()?,
            place: owner.into().place(),
        })
    }
}

/// Where a role waits to be woken.
#[derive(Debug)]
pub struct WakeEvent {
    page: WakePage,
    place: usize,
    /// How often it had rung when it was last answered.
    heard: Cell<u32>,
    /// How many calls to a rehearsal there had been when they were last asked for.
    rehearsed: Cell<u32>,
    alarm: Option<Alarm>,
}

impl WakeEvent {
    /// Waits until somebody rings or the instant has come, on CLOCK_MONOTONIC [ns]; returns whether it rang.
    ///
    /// One answer covers all rings since the last one, including an alarm's. A signal ends the wait like the instant.
    pub fn wait_until(&self, instant_ns: u64) -> Result<bool, Error> {
        if self.answer() {
            return Ok(true);
        }
        let rung = &self.page[self.place].rung;
        let mut until = timespec(instant_ns);
        if let Some(alarm) = &self.alarm {
            alarm
                .set(until)
                .map_err(|e| Error::system("cannot set a timer", e))?;
            until = timespec(instant_ns.saturating_add(BACK_STOP_NS));
        }
        match futex::wait_bitset(
            rung,
            futex::Flags::empty(),
            self.heard.get(),
            Some(&until),
            NonZero::<u32>::MAX,
        ) {
            Ok(()) | Err(Errno::AGAIN | Errno::INTR | Errno::TIMEDOUT) => Ok(self.answer()),
            Err(e) => Err(Error::system("cannot wait at a doorbell", e)),
        }
    }

    /// Whether somebody has rung for a rehearsal since this was last asked.
    #[must_use]
    pub fn rehearsal_is_called(&self) -> bool {
        let called = self.page[self.place].rehearsals.load(Ordering::Acquire);
        self.rehearsed.replace(called) != called
    }

    /// The newest tick of this run of which the role before has nothing to say.
    #[must_use]
    pub fn silent_tick(&self) -> Option<u64> {
        self.page[self.place]
            .silent
            .load(Ordering::Acquire)
            .checked_sub(1)
    }

    fn answer(&self) -> bool {
        let rung = self.page[self.place].rung.load(Ordering::Acquire);
        self.heard.replace(rung) != rung
    }
}

#[derive(Debug)]
pub struct Notifier {
    page: WakePage,
    place: usize,
}

impl Notifier {
    /// Rings for a rehearsal: whoever wakes finds no message.
    pub fn ring_for_rehearsal(&self) -> Result<(), Error> {
        self.page[self.place]
            .rehearsals
            .fetch_add(1, Ordering::Release);
        self.ring()
    }

    /// Rings to say that there is no message of a tick.
    pub fn ring_for_silence(&self, tick: u64) -> Result<(), Error> {
        self.page[self.place]
            .silent
            .store(tick + 1, Ordering::Release);
        self.ring()
    }

    /// Forgets the silence of an earlier run.
    pub fn begin(&self) {
        self.page[self.place].silent.store(0, Ordering::Release);
    }

    /// Rings. It is no error if nobody waits: others notice a dead stage by its silence.
    pub fn ring(&self) -> Result<(), Error> {
        let rung = &self.page[self.place].rung;
        rung.fetch_add(1, Ordering::Release);
        futex::wake(rung, futex::Flags::empty(), 1)
            .map_err(|e| Error::system("cannot ring a doorbell", e))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::now_ns;
    use crate::instance::Instance;
    use crate::sys::block_alarms;

    #[test]
    fn a_wait_whose_alarm_has_failed_ends_all_the_same() {
        let root = tempfile::Builder::new()
            .prefix("ib-")
            .tempdir_in("/tmp")
            .unwrap();
        let instance = Instance::under(root.path(), "deaf").unwrap();
        // On a thread of its own, which is then without the signal.
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let wire = Wire::open(&instance).unwrap();
                let doorbell = wire.doorbell_with_alarm(Role::Mixer).unwrap();
                block_alarms().unwrap();
                let until = now_ns() + 1_000_000;
                assert!(!doorbell.wait_until(until).unwrap(), "nobody rang");
                assert!(now_ns() >= until + BACK_STOP_NS);
            });
        });
        instance.remove_leftovers().unwrap();
    }
}
