//! What the states of a flight say about the unknowns: X, Y, and the weight W of a step that learns from them.
//!
//! It is a function of settings and states alone, and no estimate enters it. So the monitor gets the law's own numbers
//! from the states that the law had, and needs nothing of the law but its messages.

use control_api::law::Rig;
use messages::content::Measured;
use nalgebra::{Matrix3, Vector3};

use crate::adaptation::Adaptation;
use crate::gains::Gains;
use crate::samples::{LastTick, Samples};
use crate::weight::Regression;

#[derive(Clone, Debug)]
pub struct Evidence {
    adaptation: Adaptation,
    samples: Samples,
    newest: Regression,
    /// Tick whose state ended the newest whole tick.
    ended_at: Option<u64>,
}

impl Evidence {
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let newest = Regression {
            x: Matrix3::zeros(),
            y: Vector3::zeros(),
            weight: None,
            last: LastTick::default(),
        };
        Self {
            adaptation: Adaptation::new(rig, gains),
            samples: Samples::new(rig),
            newest,
            ended_at: None,
        }
    }

    /// Takes the measurement of `tick`. Call it once for each, with rising ticks; ticks may be left out.
    pub fn take(&mut self, tick: u64, measured: &Measured) {
        if let Some(last) = self.samples.take(tick, measured) {
            self.newest = self
                .adaptation
                .regression(&self.newest.x, &self.newest.y, &last);
            self.ended_at = Some(tick);
        }
    }

    /// X and Y as they stand at `tick`, where its state ended a whole tick.
    pub fn at(&self, tick: u64) -> Option<&Regression> {
        (self.ended_at == Some(tick)).then_some(&self.newest)
    }

    pub const fn samples(&self) -> &Samples {
        &self.samples
    }
}
