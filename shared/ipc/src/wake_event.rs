//! Doorbells: how a stage wakes the next one.
//!
//! A doorbell is a futex in shared memory: one system call to ring it, one to wait on it until an instant.
//! docs/decisions/0005-wake-by-futex.md has the measurements and the rejected alternatives.

use std::cell::Cell;
use std::fs;
use std::num::NonZero;
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use rustix::fs::{FallocateFlags, FlockOperation, fallocate, flock};
use rustix::io::Errno;
use rustix::thread::futex;

use super::Wire;
use crate::clock::timespec;
use crate::error::Error;
use crate::instance::{Instance, SHARED_MEMORY, is_at, lock_soon, shared_memory};
use crate::sys::{Alarm, BELLS, Locked, WakePage};
use messages::layout::{FNV_OFFSET, fnv1a};
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

impl Owner {
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
    pub fn rehearsal_is_called(&self) -> bool {
        let called = self.page[self.place].rehearsals.load(Ordering::Acquire);
        self.rehearsed.replace(called) != called
    }

    /// The newest tick of this run of which the role before has nothing to say.
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

/// Token of the last bell of the page, which nobody rings: how the page is used.
const MARK: u64 = fnv1a(FNV_OFFSET, b"ironbird-bells/3");

/// A share in the page of an instance.
///
/// ```text
///   every process: open, lock shared, map       the last one to leave: lock exclusive, remove
/// ```
#[derive(Debug)]
pub(super) struct WakeFile {
    file: Locked,
    path: PathBuf,
}

impl WakeFile {
    pub(super) fn join(instance: &Instance) -> Result<Self, Error> {
        let name = format!("{}bells", instance.prefix());
        let path = Path::new(SHARED_MEMORY).join(&name);
        let failed = |e| Error::system(format!("cannot make {}", path.display()), e);
        let memory = shared_memory()?.ok_or_else(|| failed(Errno::NOENT))?;
        loop {
            // Everybody can guess its name, and write in the directory.
            let file = memory.file_or_new(&name)?;
            // Held exclusively for the instant in which the last one leaves.
            lock_soon(&file, FlockOperation::NonBlockingLockShared, &path)?;
            // Somebody may have left as the last one before it was locked.
            if !is_at(&file, &path) {
                continue;
            }
            // Reserved at once: a page that shared memory has no room for would end its reader.
            fallocate(&file, FallocateFlags::empty(), 0, WakePage::BYTES as u64).map_err(failed)?;
            let joined = Self {
                file: Locked::new(file)
                    .map_err(|e| Error::system(format!("cannot lock {}", path.display()), e))?,
                path,
            };
            joined.check_mark()?;
            return Ok(joined);
        }
    }

    fn check_mark(&self) -> Result<(), Error> {
        let mark = &self.page()?[BELLS - 1].token;
        match mark.compare_exchange(0, MARK, Ordering::AcqRel, Ordering::Acquire) {
            Ok(_) => Ok(()),
            Err(found) if found == MARK => Ok(()),
            Err(found) => Err(Error::Incompatible {
                what: "the page of doorbells".into(),
                reason: format!("its mark is {found:016x}, here {MARK:016x}"),
            }),
        }
    }

    pub(super) fn page(&self) -> Result<WakePage, Error> {
        WakePage::map(self.file.as_fd())
            .map_err(|e| Error::system(format!("cannot map {}", self.path.display()), e))
    }
}

impl Drop for WakeFile {
    fn drop(&mut self) {
        if flock(&self.file, FlockOperation::NonBlockingLockExclusive).is_ok() {
            // Gone already where somebody removed the leftovers.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::now_ns;
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
