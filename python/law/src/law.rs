//! A law in Python, asked tick by tick.

use std::sync::{Arc, Mutex, PoisonError};

use law::law as rig;
use law::registry::{AnyInner, AnyOuter};
use model::measured;
use model::messages::Dated;
use model::reference;
use model::telemetry::Telemetry;
use pyo3::prelude::*;

use crate::answer::Answer;
use crate::inputs::{Measured, Reference, Wanted};

/// A law that can be asked.
#[derive(Debug)]
pub struct PythonLaw {
    /// What is called in a tick.
    tick: Py<PyAny>,
    /// What its errors begin with.
    place: String,
    /// How many numbers it shows.
    shown: usize,
}

impl PythonLaw {
    /// Of a function that is called in every tick, and what to begin its errors with.
    #[must_use]
    pub const fn new(tick: Py<PyAny>, place: String, shown: usize) -> Self {
        Self { tick, place, shown }
    }

    /// How many numbers it shows.
    #[must_use]
    pub const fn shown(&self) -> usize {
        self.shown
    }

    /// Asks an outer law.
    ///
    /// # Errors
    /// What the law raises; an answer that is none.
    pub fn outer(
        &self,
        py: Python<'_>,
        tick: u64,
        measured: &measured::Measured,
        reference: &reference::Reference,
        telemetry: &mut Telemetry,
    ) -> PyResult<rig::Wanted> {
        let said = self.tick.bind(py).call1((tick, Measured::new(*measured, 0), Reference::from(*reference)))?;
        self.answer(&said, tick).wanted(telemetry, self.shown)
    }

    /// Asks an inner law.
    ///
    /// # Errors
    /// As [`Self::outer`].
    pub fn inner(
        &self,
        py: Python<'_>,
        tick: u64,
        (measured, wanted): (Measured, Wanted),
        reference: &reference::Reference,
        telemetry: &mut Telemetry,
    ) -> PyResult<rig::Demand> {
        let said = self.tick.bind(py).call1((tick, measured, wanted, Reference::from(*reference)))?;
        self.answer(&said, tick).demand(telemetry, self.shown)
    }

    fn answer<'a, 'py>(&self, said: &'a Bound<'py, PyAny>, tick: u64) -> Answer<'a, 'py> {
        Answer { said, place: format!("{} at tick {tick}", self.place) }
    }
}

/// The first exception of a flight. What raised it is not asked again.
#[derive(Clone, Debug, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    /// Whether something was raised.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Keeps an exception, if it is the first.
    pub fn keep(&self, raised: PyErr) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(raised);
    }

    /// The exception.
    #[must_use]
    pub fn take(&self) -> Option<PyErr> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn or_keep<T>(&self, ask: impl FnOnce(Python<'_>) -> PyResult<T>) -> Option<T> {
        if self.is_there() {
            return None;
        }
        Python::attach(ask).map_err(|raised| self.keep(raised)).ok()
    }
}

/// An outer law in Python for a flight in one process; after an exception its answers are no numbers.
#[derive(Clone, Debug)]
pub struct FlyingOuter(pub Arc<PythonLaw>, pub Raised);

/// An inner law in Python for a flight in one process; after an exception its answers are no numbers.
#[derive(Clone, Debug)]
pub struct FlyingInner(pub Arc<PythonLaw>, pub Raised);

impl AnyOuter for FlyingOuter {
    fn tick(
        &mut self,
        tick: u64,
        measured: &measured::Measured,
        reference: &reference::Reference,
        telemetry: &mut Telemetry,
    ) -> rig::Wanted {
        let Self(law, raised) = self;
        let wanted = raised.or_keep(|py| law.outer(py, tick, measured, reference, telemetry));
        wanted.unwrap_or(rig::Wanted { thrust_n: f64::NAN, ..rig::Wanted::default() })
    }

    fn copy_into(&self, _: &mut dyn AnyOuter) -> bool {
        false
    }
}

impl AnyInner for FlyingInner {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Dated<measured::Measured>,
        wanted: &Dated<rig::Wanted>,
        reference: &reference::Reference,
        telemetry: &mut Telemetry,
    ) -> rig::Demand {
        let Self(law, raised) = self;
        let inputs =
            (Measured::new(measured.content, measured.age(tick)), Wanted::new(wanted.content, wanted.age(tick)));
        let demand = raised.or_keep(|py| law.inner(py, tick, inputs, reference, telemetry));
        demand.unwrap_or(rig::Demand { thrust_n: f64::NAN, ..rig::Demand::default() })
    }

    fn copy_into(&self, _: &mut dyn AnyInner) -> bool {
        false
    }
}
