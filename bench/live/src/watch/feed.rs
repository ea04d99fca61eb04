//! What the dashboard's model is fed with: a flight's messages and blackboards.

use std::time::{Duration, Instant};

use errors::Failure;
use ipc::instance::Instance;

use super::dashboard_model::Model;
use crate::observation::Observation;

/// How often to look for a flight and to check its processes.
pub(crate) const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Updates the model: waits for a flight, joins it, reads its messages, and notices its end.
pub(crate) struct Feed {
    pub(crate) instance: Instance,
    joined: Option<Observation>,
    next_look: Instant,
    failed: u32,
}

impl Feed {
    pub(crate) fn new(instance: Instance) -> Self {
        Self {
            instance,
            joined: None,
            next_look: Instant::now(),
            failed: 0,
        }
    }

    /// Looks again at the next update: something has changed.
    #[cfg(feature = "mavlink")]
    pub(crate) fn look_soon(&mut self) {
        self.next_look = Instant::now();
    }

    pub(crate) fn update(&mut self, model: &mut Model) -> Result<(), Failure> {
        let is_due = Instant::now() >= self.next_look;
        if is_due {
            self.next_look = Instant::now() + LOOK_EVERY;
        }
        if self.joined.is_none() && is_due {
            self.join(model)?;
        }
        let (Some(observation), Some(flight)) = (&mut self.joined, &mut model.flight) else {
            return Ok(());
        };
        observation.drain(|entry| flight.take(entry))?;
        flight.run = observation.run();
        if is_due {
            observation.look(flight);
        }
        if flight.ending.is_some() {
            self.leave();
        }
        Ok(())
    }

    fn join(&mut self, model: &mut Model) -> Result<(), Failure> {
        if let Some(observation) = Observation::join(&self.instance, &mut self.failed)? {
            model.join(&observation.run(), &observation.settings)?;
            self.joined = Some(observation);
        }
        Ok(())
    }

    pub(crate) fn leave(&mut self) {
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
