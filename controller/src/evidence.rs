//! What the states of a flight say about the unknowns: X, Y, and the weight W of a step that learns from them.
//!
//! It is a function of settings and states alone, and no estimate enters it. So the monitor gets the law's own numbers
//! from the states that the law had, and needs nothing of the law but its messages.

use law::law::Rig;
use model::measured::Measured;
use nalgebra::{Matrix3, Vector3};

use crate::adaptation::{Adaptation, LastTick};
use crate::gains::Gains;
use crate::samples::Samples;
use crate::weight::Weight;

/// X and Y through a flight.
#[derive(Clone, Debug)]
pub struct Evidence {
    adaptation: Adaptation,
    samples: Samples,
    newest: Regression,
    /// Tick whose state ended the newest whole tick.
    ended_at: Option<u64>,
}

/// X and Y after a whole tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regression {
    /// X, filtered regressor.
    pub x: Matrix3<f64>,
    /// Y, filtered sample of what the regressor must explain [rad/s^2].
    pub y: Vector3<f64>,
    /// W = I + (T/alpha) X Gamma X^T; none where it is no number.
    pub weight: Option<Weight>,
    /// The tick as it was measured.
    pub last: LastTick,
}

impl Evidence {
    /// Before the first state.
    #[must_use]
    pub fn new(rig: &Rig, gains: &Gains) -> Self {
        let newest = Regression { x: Matrix3::zeros(), y: Vector3::zeros(), weight: None, last: LastTick::default() };
        Self { adaptation: Adaptation::new(rig, gains), samples: Samples::new(rig), newest, ended_at: None }
    }

    /// Takes the measurement of `tick`. Call it once for each, with rising ticks; ticks may be left out.
    pub fn take(&mut self, tick: u64, measured: &Measured) {
        if let Some(last) = self.samples.take(tick, measured) {
            self.newest = self.adaptation.regression(&self.newest.x, &self.newest.y, &last);
            self.ended_at = Some(tick);
        }
    }

    /// X and Y as they stand at `tick`, where its state ended a whole tick.
    #[must_use]
    pub fn at(&self, tick: u64) -> Option<&Regression> {
        (self.ended_at == Some(tick)).then_some(&self.newest)
    }

    /// The samples that it rests on.
    #[must_use]
    pub const fn samples(&self) -> &Samples {
        &self.samples
    }
}
