//! Numbers as arrays of numpy: each of them owns its memory, so that a law may keep what it was given.

use messages::layout::{Field, Visit, Visitor};
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyByteArray;

/// Numbers as an array of `float64`.
pub fn array<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    static FROM_BUFFER: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let from_buffer = FROM_BUFFER.import(py, "numpy", "frombuffer")?;
    let bytes = PyByteArray::new_with(py, size_of_val(values), |bytes| {
        let places = bytes.as_chunks_mut().0.iter_mut();
        places
            .zip(values)
            .for_each(|(place, value)| *place = value.to_ne_bytes());
        Ok(())
    })?;
    from_buffer.call1((bytes,))
}

/// A field of a struct: an array, or a number where it is a single one. An error for an unknown field lists all names.
pub(crate) fn field<'py, L: Visit>(
    py: Python<'py>,
    content: &L,
    name: &str,
    names: &[&str],
) -> PyResult<Bound<'py, PyAny>> {
    let mut find = Find {
        py,
        name,
        found: None,
    };
    content.visit(&mut find);
    find.found.unwrap_or_else(|| {
        let names = names.join(", ");
        Err(PyAttributeError::new_err(format!(
            "{} has no `{name}`; it has {names}",
            L::STRUCT
        )))
    })
}

/// Names of the fields of a struct.
pub(crate) fn names<L: Visit>() -> Vec<&'static str> {
    L::FIELDS.iter().map(|field| field.name).collect()
}

struct Find<'a, 'py> {
    py: Python<'py>,
    name: &'a str,
    found: Option<PyResult<Bound<'py, PyAny>>>,
}

impl Visitor for Find<'_, '_> {
    fn integers(&mut self, _: &'static Field, _: &[u64]) {}

    fn numbers(&mut self, field: &'static Field, values: &[f64]) {
        if field.name == self.name {
            self.found = Some(match (field.length, values) {
                (None, [value]) => value
                    .into_pyobject(self.py)
                    .map(Bound::into_any)
                    .map_err(Into::into),
                _ => array(self.py, values),
            });
        }
    }

    fn structs<L: Visit>(&mut self, _: &'static Field, _: &[L]) {}
}
