//! A law in Python, called tick by tick.

use std::any::Any;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use control_api::law::{CopyState, InnerLaw, OuterLaw};
use ironbird_law::{InnerInput, OuterInput, WrenchSetpoint};
use messages::content;
use messages::telemetry::Telemetry;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::answer::Answer;
use crate::inputs::{Desired, Given, Measured, Reference};
use crate::look_code::module;

/// A law that can be called.
#[derive(Debug)]
pub struct PythonLaw {
    /// What is called in a tick.
    pub(crate) tick: Py<PyAny>,
    /// What its errors begin with.
    pub(crate) place: String,
    /// How many numbers it shows.
    pub signals: usize,
}

impl PythonLaw {
    /// A tick of an outer law.
    pub fn outer(
        &self,
        py: Python<'_>,
        input: &OuterInput,
        telemetry: &mut Telemetry,
    ) -> PyResult<content::Desired> {
        let measured = Measured {
            content: input.measured,
            age: 0,
            given: Given {
                content: input.given,
                age: input.given_age,
            },
        };
        let inputs = (input.tick, measured, Reference(input.reference));
        let answer = self.tick.bind(py).call1(inputs)?;
        let answer = self.answer(&answer, input.tick);
        answer.desired(telemetry, self.signals)
    }

    /// A tick of an inner law.
    pub fn inner(
        &self,
        py: Python<'_>,
        input: &InnerInput,
        telemetry: &mut Telemetry,
    ) -> PyResult<WrenchSetpoint> {
        let measured = Measured {
            content: input.measured,
            age: input.measured_age,
            given: Given {
                content: input.given,
                age: input.given_age,
            },
        };
        let desired = Desired {
            content: input.wanted,
            age: input.wanted_age,
        };
        let inputs = (input.tick, measured, desired, Reference(input.reference));
        let answer = self.tick.bind(py).call1(inputs)?;
        let answer = self.answer(&answer, input.tick);
        answer.wrench(telemetry, self.signals)
    }

    /// Its state, in at most `size` bytes; empty if it cannot be saved.
    pub fn save(&self, size: usize) -> Vec<u8> {
        let arguments = (&self.tick, size, &self.place);
        let saved = |py: Python<'_>| module(py)?.call_method1("save", arguments)?.extract();
        Python::attach(saved).unwrap_or_default()
    }

    /// Continues from a saved state; false if it cannot.
    pub fn load(&self, state: &[u8]) -> bool {
        let loaded = |py: Python<'_>| {
            let arguments = (&self.tick, PyBytes::new(py, state));
            module(py)?.call_method1("restore", arguments)?.extract()
        };
        Python::attach(loaded).unwrap_or_default()
    }

    fn answer<'a, 'py>(&self, answer: &'a Bound<'py, PyAny>, tick: u64) -> Answer<'a, 'py> {
        Answer {
            value: answer,
            place: format!("{} at tick {tick}", self.place),
        }
    }
}

/// The first exception of a flight. A law that raised one is not called again.
#[derive(Clone, Debug, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    fn first(&self) -> MutexGuard<'_, Option<PyErr>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether something was raised.
    pub fn is_there(&self) -> bool {
        self.first().is_some()
    }

    /// Keeps an exception, if it is the first.
    pub fn keep(&self, raised: PyErr) {
        self.first().get_or_insert(raised);
    }

    /// The exception.
    pub fn take(&self) -> Option<PyErr> {
        self.first().take()
    }

    fn or_keep<T>(&self, call: impl FnOnce(Python<'_>) -> PyResult<T>) -> Option<T> {
        if self.is_there() {
            return None;
        }
        Python::attach(call)
            .map_err(|raised| self.keep(raised))
            .ok()
    }
}

/// A law in Python for a flight in one process; after an exception its outputs are NaN.
#[derive(Clone, Debug)]
pub struct Flying(pub Arc<PythonLaw>, pub Raised);

impl CopyState for Flying {
    fn copy_into(&self, _: &mut dyn Any) -> bool {
        false
    }

    fn as_any(&mut self) -> &mut dyn Any {
        self
    }
}

impl OuterLaw for Flying {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> content::Desired {
        let Self(law, raised) = self;
        let desired = raised.or_keep(|py| law.outer(py, input, telemetry));
        desired.unwrap_or(content::Desired {
            thrust_n: f64::NAN,
            ..content::Desired::default()
        })
    }
}

impl InnerLaw for Flying {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let Self(law, raised) = self;
        let wrench = raised.or_keep(|py| law.inner(py, input, telemetry));
        wrench.unwrap_or(WrenchSetpoint {
            thrust_n: f64::NAN,
            ..WrenchSetpoint::default()
        })
    }
}
