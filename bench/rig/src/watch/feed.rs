//! Feeds the flight to the model: waits for it, joins it, reads it, notices its end.

use std::time::{Duration, Instant};

use model::role::Role;
use wire::error::Error;
use wire::instance::Instance;

use crate::observe::Observation;
use crate::watch::model::Model;
use failure::Failure;

/// How often it looks for a flight, and after the processes.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// From a flight's end to the last message that the recorder passes on, with a margin.
const LAST_MESSAGES: Duration = Duration::from_millis(200);
/// How often joining may fail in a row: roles that start or end are in the way for an instant.
const TRIES: u32 = 20;

/// Where the model's news comes from.
#[allow(missing_debug_implementations, reason = "the middleware's handles have none")]
pub struct Feed {
    instance: Instance,
    joined: Option<Observation>,
    /// When the joined flight was seen to have ended.
    ended: Option<Instant>,
    next_look: Instant,
    failed: u32,
}

impl Feed {
    /// Has joined nothing yet.
    #[must_use]
    pub fn new(instance: Instance) -> Self {
        Self { instance, joined: None, ended: None, next_look: Instant::now(), failed: 0 }
    }

    /// Tells the model everything that is new.
    ///
    /// # Errors
    /// Those of joining, and of the ports.
    pub fn look(&mut self, model: &mut Model) -> Result<(), Failure> {
        let is_due = Instant::now() >= self.next_look;
        if is_due {
            self.next_look = Instant::now() + LOOK_EVERY;
        }
        if self.joined.is_none() && is_due {
            self.find(model)?;
        }
        let (Some(observation), Some(flight)) = (&mut self.joined, &mut model.flight) else { return Ok(()) };
        observation.drain(|seen| flight.take(seen))?;
        flight.run = observation.run();
        if !is_due {
            return Ok(());
        }
        flight.in_force = observation.in_force();
        flight.crew = observation.crew();
        let mut steal = flight.steal;
        steal.look(flight);
        flight.steal = steal;
        // Asked in this order: a recorder that ends with the flight is not lost, and one that was lost stays so.
        let lives = observation.lives(Role::Record);
        if lives || observation.ending().is_none() {
            flight.recorder_lives = lives;
        }
        if self.ended.is_none() && observation.ending().is_some() {
            self.ended = Some(Instant::now());
        }
        if self.ended.is_some_and(|at| at.elapsed() >= LAST_MESSAGES) {
            flight.ending = observation.ending();
            self.leave();
        }
        Ok(())
    }

    fn find(&mut self, model: &mut Model) -> Result<(), Failure> {
        match Observation::join(&self.instance) {
            Ok(Some(observation)) => {
                self.failed = 0;
                model.join(&observation.run(), observation.settings.clone())?;
                self.joined = Some(observation);
            }
            Ok(None) => {}
            Err(Error::Wire { .. }) if self.failed < TRIES => self.failed += 1,
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    /// Leaves the flight.
    pub fn leave(&mut self) {
        self.ended = None;
        if self.joined.take().is_some() {
            // Where the others have left before. What resists is found by the next start or by `ironbird clean`.
            let _ = self.instance.remove_leftovers();
        }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.leave();
    }
}
