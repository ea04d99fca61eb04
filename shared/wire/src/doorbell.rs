//! Doorbells: how a stage wakes the next one.
//!
//! A futex in shared memory: one call to ring, one to wait until an instant. docs/decisions/0005-wake-by-futex.md has
//! the measurements, and what else was tried.

use std::cell::Cell;
use std::num::NonZero;
use std::sync::atomic::Ordering;

use rustix::io::Errno;
use rustix::thread::futex;

use super::Wire;
use crate::clock::timespec;
use crate::error::Error;
use crate::sys::{Alarm, BellPage};
use model::role::{ROLES, Role};

/// How long after its instant a wait with an alarm ends, had the alarm failed [ns].
///
/// More than a stage's deadline is before the end of a tick, also at 50 Hz: so the plant's timer comes before this one,
/// and this one is never the next of their processor.
const BACK_STOP_NS: u64 = 10_000_000;

/// Who waits at a doorbell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// The loop of a role.
    Role(Role),
    /// The plant's parameter desk.
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
    /// The doorbell of a role's loop, or of the parameter desk, which one thread waits at.
    ///
    /// # Errors
    /// [`Error::System`].
    pub fn doorbell(&self, owner: impl Into<Owner>) -> Result<Doorbell, Error> {
        let (page, place) = (self.bells.page()?, owner.into().place());
        let heard = Cell::new(page[place].rung.load(Ordering::Acquire));
        Ok(Doorbell { page, place, heard, alarm: None })
    }

    /// As [`Wire::doorbell`], for the calling thread alone, with a timer of its own that lasts beyond the waits.
    ///
    /// The deadline is a POSIX timer and not the futex's time-out: cancelling a time-out at every ring costs a VM exit
    /// where it is the next timer of its processor. The price is a system call more for each wait, and the signal: a
    /// process has one such doorbell. Should the signal be blocked, the wait ends [`BACK_STOP_NS`] after its instant.
    ///
    /// # Errors
    /// [`Error::System`].
    pub fn doorbell_with_alarm(&self, owner: impl Into<Owner>) -> Result<Doorbell, Error> {
        let doorbell = self.doorbell(owner)?;
        let alarm = Alarm::new(self.bells.page()?, doorbell.place);
        Ok(Doorbell { alarm: Some(alarm.map_err(|e| Error::system("cannot make a timer", e))?), ..doorbell })
    }

    /// The button of a doorbell.
    ///
    /// # Errors
    /// [`Error::System`].
    pub fn bell(&self, owner: impl Into<Owner>) -> Result<Bell, Error> {
        Ok(Bell { page: self.bells.page()?, place: owner.into().place() })
    }
}

/// Where a role waits to be woken.
#[derive(Debug)]
pub struct Doorbell {
    page: BellPage,
    place: usize,
    /// How often it had rung when it was last answered.
    heard: Cell<u32>,
    alarm: Option<Alarm>,
}

impl Doorbell {
    /// Waits until somebody rings or the instant has come, on CLOCK_MONOTONIC [ns]; returns whether it rang.
    ///
    /// Rings since the last answer are answered together, an alarm's among them. A signal ends the wait as the instant
    /// does.
    ///
    /// # Errors
    /// [`Error::System`].
    pub fn wait_until(&self, instant_ns: u64) -> Result<bool, Error> {
        if self.answer() {
            return Ok(true);
        }
        let rung = &self.page[self.place].rung;
        let mut until = timespec(instant_ns);
        if let Some(alarm) = &self.alarm {
            alarm.set(until).map_err(|e| Error::system("cannot set a timer", e))?;
            until = timespec(instant_ns.saturating_add(BACK_STOP_NS));
        }
        match futex::wait_bitset(rung, futex::Flags::empty(), self.heard.get(), Some(&until), NonZero::<u32>::MAX) {
            Ok(()) | Err(Errno::AGAIN | Errno::INTR | Errno::TIMEDOUT) => Ok(self.answer()),
            Err(e) => Err(Error::system("cannot wait at a doorbell", e)),
        }
    }

    fn answer(&self) -> bool {
        let rung = self.page[self.place].rung.load(Ordering::Acquire);
        self.heard.replace(rung) != rung
    }
}

/// Wakes a role.
#[derive(Debug)]
pub struct Bell {
    page: BellPage,
    place: usize,
}

impl Bell {
    /// Rings. Nobody there is no error: a stage that is gone is noticed by its silence.
    ///
    /// # Errors
    /// [`Error::System`].
    pub fn ring(&self) -> Result<(), Error> {
        let rung = &self.page[self.place].rung;
        rung.fetch_add(1, Ordering::Release);
        futex::wake(rung, futex::Flags::empty(), 1).map_err(|e| Error::system("cannot ring a doorbell", e))?;
        Ok(())
    }
}
