//! What a law is given: the structs of the rig, whose fields are read as arrays when the law reads them.

use messages::parameters::SPECS;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{field, names};

/// What the sensors show at a tick.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    pub(crate) content: ironbird_law::Measured,
    /// Ticks since it was measured; `u64::MAX` if it never was.
    pub(crate) age: u64,
    pub(crate) given: Given,
}

/// What the rotor command in force gives, by the nominal model.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Given {
    pub(crate) content: ironbird_law::Given,
    /// Ticks since the mixer made the command; `u64::MAX` if it never did.
    pub(crate) age: u64,
}

/// Where the vehicle should be.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Reference(pub(crate) ironbird_law::Reference);

/// What the outer law wants of the inner one.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Desired {
    pub(crate) content: ironbird_law::Desired,
    /// Ticks since it was made; `u64::MAX` if it never was.
    pub(crate) age: u64,
}

/// The rig as a law knows it before a flight.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Rig(pub ironbird_law::Rig);

/// Ticks; none where the input never came.
const fn ticks(age: u64) -> Option<u64> {
    if age == u64::MAX { None } else { Some(age) }
}

#[pymethods]
impl Measured {
    /// Ticks since it was measured; None before the first.
    #[getter]
    const fn age(&self) -> Option<u64> {
        ticks(self.age)
    }

    /// The active command of the mixer.
    #[getter]
    const fn given(&self) -> Given {
        self.given
    }

    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.content, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        [names::<ironbird_law::Measured>(), vec!["age", "given"]].concat()
    }
}

#[pymethods]
impl Given {
    /// Ticks since the mixer made the command; None before the first.
    #[getter]
    const fn age(&self) -> Option<u64> {
        ticks(self.age)
    }

    /// Whether the demand could not be met in full.
    #[getter]
    const fn saturated(&self) -> bool {
        self.content.saturated != 0
    }

    /// Whether a channel with other laws flies, and the command answers their demand.
    #[getter]
    const fn other_law(&self) -> bool {
        self.content.other_law != 0
    }

    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.content, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        [names::<ironbird_law::Given>(), vec!["age"]].concat()
    }
}

#[pymethods]
impl Reference {
    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.0, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        names::<ironbird_law::Reference>()
    }
}

#[pymethods]
impl Desired {
    /// Ticks since it was wanted; None before the first.
    #[getter]
    const fn age(&self) -> Option<u64> {
        ticks(self.age)
    }

    /// Whether a limit of the outer law was active.
    #[getter]
    const fn limited(&self) -> bool {
        self.content.limited != 0
    }

    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.content, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        [names::<ironbird_law::Desired>(), vec!["age"]].concat()
    }
}

#[pymethods]
impl Rig {
    /// Length of a tick [s].
    #[getter]
    const fn period_s(&self) -> f64 {
        self.0.period_s
    }

    /// The airframe as it is believed to be, by the names of `ironbird params`.
    #[getter]
    fn airframe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let airframe = &self.0.airframe;
        // In the order of the table of parameters, whose first ones are those of the C interface.
        let numbers = [
            airframe.mass_kg,
            airframe.gravity_m_s2,
            airframe.translational_drag_kg_s,
            airframe.rotational_drag_nm_s,
            airframe.arm_length_m,
            airframe.thrust_coefficient_n_s2,
            airframe.drag_factor_nm_s2,
            airframe.rotor_inertia_kg_m2,
        ]
        .into_iter()
        .chain(airframe.inertia_kg_m2)
        .chain([airframe.disturbance_gain_rad_s2])
        .chain(airframe.rotor_efficiency)
        .chain([airframe.motor_time_constant_s]);
        let values = PyDict::new(py);
        for (spec, value) in SPECS.iter().zip(numbers) {
            values.set_item(spec.name, value)?;
        }
        Ok(values)
    }

    /// Smallest rotor speed [rad/s].
    #[getter]
    const fn rotor_min_rad_s(&self) -> f64 {
        self.0.rotor_min_rad_s
    }

    /// Largest rotor speed [rad/s].
    #[getter]
    const fn rotor_max_rad_s(&self) -> f64 {
        self.0.rotor_max_rad_s
    }
}
