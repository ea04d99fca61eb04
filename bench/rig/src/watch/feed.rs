//! Updates the model: waits for a flight, joins it, reads its messages, and notices its end.

use std::time::{Duration, Instant};

use ipc::error::Error;
use ipc::instance::Instance;
use messages::role::Role;

use crate::observation::Observation;
use crate::watch::dashboard_model::Model;
use errors::Failure;

/// How often to look for a flight and to check its processes.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How long after the end of a flight the recorder may still pass messages on.
const LAST_MESSAGES: Duration = Duration::from_millis(200);
/// How often joining may fail in a row: it can while roles start or end.
const TRIES: u32 = 20;

#[allow(
    missing_debug_implementations,
    reason = "the middleware's handles have none"
)]
pub struct Feed {
    instance: Instance,
    joined: Option<Observation>,
    /// When the joined flight was seen to have ended.
    ended: Option<Instant>,
    next_look: Instant,
    failed: u32,
}

impl Feed {
    #[must_use]
    pub fn new(instance: Instance) -> Self {
        Self {
            instance,
            joined: None,
            ended: None,
            next_look: Instant::now(),
            failed: 0,
        }
    }

    /// Updates the model with everything new.
    pub fn look(&mut self, model: &mut Model) -> Result<(), Failure> {
        let is_due = Instant::now() >= self.next_look;
        if is_due {
            self.next_look = Instant::now() + LOOK_EVERY;
        }
        if self.joined.is_none() && is_due {
            self.find(model)?;
        }
        let (Some(observation), Some(flight)) = (&mut self.joined, &mut model.flight) else {
            return Ok(());
        };
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
        // In this order: a recorder that ends with the flight has not failed, and one that failed before stays failed.
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

    pub fn leave(&mut self) {
        self.ended = None;
        if self.joined.take().is_some() {
            // In case the dashboard is the last process. The next start or `ironbird clean` finds what remains.
            let _ = self.instance.remove_leftovers();
        }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.leave();
    }
}
