//! What a law in Python says of itself: `look.py`, read from here.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::inputs::Rig;
use crate::law::PythonLaw;
use crate::look_code::module;

/// A law that was looked at, and does not fly yet.
#[derive(Debug)]
pub struct Looked {
    /// Its role, as `inner`.
    pub role: String,
    /// Its name.
    pub name: String,
    /// Its own version.
    pub version: String,
    /// What it is for.
    pub summary: String,
    /// Where it comes from; may be empty.
    pub source: String,
    /// Names and units of what it shows.
    pub telemetry: Vec<(String, String)>,
    /// Its settings.
    pub settings: Vec<SaidSetting>,
    /// The file that it stands in, and the line of its `tick`.
    pub file: String,
    /// The file alone.
    path: String,
    /// Its class, or the object that flies as it is.
    law: Py<PyAny>,
    /// Its `tick` in words, with file and line.
    place: String,
}

/// A setting: name, unit, meaning, default (no number, one, or three), least and largest number, words.
#[derive(Clone, Debug, FromPyObject)]
pub struct SaidSetting(
    pub String,
    pub String,
    pub String,
    pub Vec<f64>,
    pub f64,
    pub f64,
    pub Vec<String>,
);

impl Looked {
    /// Looks at a function, an object with `tick`, or a class of such, for a role.
    pub fn at(law: &Bound<'_, PyAny>, role: &str) -> PyResult<Self> {
        Self::of(&module(law.py())?.call_method1("look", (law, role))?)
    }

    /// Looks at the law of a file.
    pub fn of_file(py: Python<'_>, path: &str) -> PyResult<Self> {
        let (class, _) = load(py, path)?;
        Self::of(&module(py)?.call_method1("look_at_class", (class,))?)
    }

    /// An exception in a line, with its place in the law's file if it was raised there.
    pub fn describe(&self, py: Python<'_>, raised: &PyErr) -> String {
        let error = (raised.value(py), &self.path, raised.traceback(py));
        let text = module(py).and_then(|module| module.call_method1("describe", error)?.extract());
        text.unwrap_or_else(|_| raised.to_string())
    }

    fn of(said: &Bound<'_, PyAny>) -> PyResult<Self> {
        let text = |key: &str| said.get_item(key)?.extract::<String>();
        Ok(Self {
            role: text("role")?,
            name: text("name")?,
            version: text("version")?,
            summary: text("summary")?,
            source: text("source")?,
            telemetry: said.get_item("telemetry")?.extract()?,
            settings: said.get_item("settings")?.extract()?,
            file: text("file")?,
            path: text("path")?,
            law: said.get_item("law")?.unbind(),
            place: text("place")?,
        })
    }

    /// An instance of its class, made with the rig and the settings; an object flies as it is.
    pub fn make(
        &self,
        py: Python<'_>,
        rig: Rig,
        settings: &Bound<'_, PyDict>,
    ) -> PyResult<PythonLaw> {
        let tick = module(py)?.call_method1("make", (&self.law, rig, settings))?;
        Ok(PythonLaw {
            tick: tick.unbind(),
            place: self.place.clone(),
            signals: self.telemetry.len(),
        })
    }

    /// The settings that result from those that are given, each checked.
    pub fn settled<'py>(
        &self,
        py: Python<'py>,
        given: &Bound<'py, PyDict>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let settled = module(py)?.call_method1("settled", (&self.law, &self.role, given))?;
        Ok(settled.cast_into()?)
    }
}

/// The class of a file that is a law, and the SHA-256 of the file.
pub fn load<'py>(py: Python<'py>, path: &str) -> PyResult<(Bound<'py, PyAny>, String)> {
    module(py)?.call_method1("load", (path,))?.extract()
}

/// Whether an exception says that a law was refused, in words that need no traceback.
pub fn is_refusal(py: Python<'_>, raised: &PyErr) -> bool {
    let refused = module(py).and_then(|module| module.getattr("Refused"));
    refused.is_ok_and(|refused| raised.is_instance(py, &refused))
}
