//! The part of this crate that is written in Python.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::ffi::CString;

pub(crate) fn module(py: Python<'_>) -> PyResult<&Bound<'_, PyModule>> {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    let module = MODULE.get_or_try_init(py, || {
        let code = CString::new(include_str!("look.py"))?;
        PyModule::from_code(py, &code, c"ironbird/look.py", c"ironbird_look").map(Bound::unbind)
    });
    module.map(|module| module.bind(py))
}
