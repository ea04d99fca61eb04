//! What a law is given: the structs of the rig, whose fields are read as arrays when the law asks for them.

use law::law;
use model::measured;
use model::parameters::Parameter;
use model::reference;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{array, field, names};

/// What the sensors show at a tick.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    content: measured::Measured,
    age: u64,
}

/// Where the vehicle should be.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Reference(reference::Reference);

/// What the outer law wants of the inner one.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    content: law::Wanted,
    age: u64,
}

/// What a law is told before a flight.
#[pyclass(frozen, module = "ironbird")]
#[derive(Clone, Copy, Debug)]
pub struct Rig {
    /// T, length of a tick [s].
    pub period_s: f64,
    /// The airframe as it is believed to be: the values of [`MODEL`].
    pub airframe: [f64; MODEL.len()],
    /// Smallest and largest rotor speed [rad/s].
    pub rotor_rad_s: [f64; 2],
}

/// The parameters that a law is told of, in the order of the C interface.
pub const MODEL: [Parameter; 17] = [
    Parameter::Mass,
    Parameter::Gravity,
    Parameter::TranslationalDrag,
    Parameter::RotationalDrag,
    Parameter::ArmLength,
    Parameter::ThrustCoefficient,
    Parameter::DragFactor,
    Parameter::RotorInertia,
    Parameter::InertiaX,
    Parameter::InertiaY,
    Parameter::InertiaZ,
    Parameter::DisturbanceGain,
    Parameter::RotorEfficiency1,
    Parameter::RotorEfficiency2,
    Parameter::RotorEfficiency3,
    Parameter::RotorEfficiency4,
    Parameter::MotorTimeConstant,
];

impl Measured {
    /// A measurement of some ticks ago; `u64::MAX` if it never was.
    #[must_use]
    pub const fn new(content: measured::Measured, age: u64) -> Self {
        Self { content, age }
    }
}

impl Wanted {
    /// What was wanted some ticks ago; `u64::MAX` if it never was.
    #[must_use]
    pub const fn new(content: law::Wanted, age: u64) -> Self {
        Self { content, age }
    }
}

impl From<reference::Reference> for Reference {
    fn from(content: reference::Reference) -> Self {
        Self(content)
    }
}

impl From<law::Rig> for Rig {
    fn from(rig: law::Rig) -> Self {
        Self {
            period_s: rig.period_s,
            airframe: MODEL.map(|parameter| rig.airframe.get(parameter)),
            rotor_rad_s: [rig.rotor.min_rad_s, rig.rotor.max_rad_s],
        }
    }
}

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

    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.content, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        [names::<measured::Measured>(), vec!["age"]].concat()
    }
}

#[pymethods]
impl Reference {
    fn __getattr__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        field(py, &self.0, name, &Self::__dir__())
    }

    #[staticmethod]
    fn __dir__() -> Vec<&'static str> {
        names::<reference::Reference>()
    }
}

#[pymethods]
impl Wanted {
    /// Ticks since it was wanted; None before the first.
    #[getter]
    const fn age(&self) -> Option<u64> {
        ticks(self.age)
    }

    /// Total thrust along body z [N].
    #[getter]
    const fn thrust_n(&self) -> f64 {
        self.content.thrust_n
    }

    /// Roll, pitch, yaw [rad].
    #[getter]
    fn attitude_rad<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, &self.content.attitude_rad)
    }

    /// Their first derivatives along the reference [rad/s].
    #[getter]
    fn attitude_rate_rad_s<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, &self.content.attitude_rate_rad_s)
    }

    /// Their second derivatives along the reference [rad/s^2].
    #[getter]
    fn attitude_acceleration_rad_s2<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, &self.content.attitude_acceleration_rad_s2)
    }

    /// Whether a limit of the outer law was active.
    #[getter]
    const fn limited(&self) -> bool {
        self.content.limited
    }
}

#[pymethods]
impl Rig {
    /// Length of a tick [s].
    #[getter]
    const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The airframe as it is believed to be, by the names of `ironbird params`.
    #[getter]
    fn airframe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let values = PyDict::new(py);
        for (parameter, value) in MODEL.iter().zip(self.airframe) {
            values.set_item(parameter.name(), value)?;
        }
        Ok(values)
    }

    /// Smallest rotor speed [rad/s].
    #[getter]
    const fn rotor_min_rad_s(&self) -> f64 {
        self.rotor_rad_s[0]
    }

    /// Largest rotor speed [rad/s].
    #[getter]
    const fn rotor_max_rad_s(&self) -> f64 {
        self.rotor_rad_s[1]
    }
}
