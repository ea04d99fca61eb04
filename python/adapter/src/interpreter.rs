//! The Python within the process: which one, with which packages, and how it is made quiet.
#![allow(
    unsafe_code,
    reason = "the interpreter is started through its C interface; each use says why it is sound"
)]

use std::env;
use std::ffi::CStr;
use std::sync::OnceLock;

use pyo3::ffi;
use pyo3::prelude::*;

/// The Python whose packages a law uses; the rig sets it, and has loaded the library of that Python.
const PYTHON: &str = "IRONBIRD_PYTHON";

/// Starts the interpreter, once in a process; within a Python it is that one.
pub(crate) fn start() -> Result<(), String> {
    static STARTED: OnceLock<Result<(), String>> = OnceLock::new();
    STARTED.get_or_init(begin).clone()
}

fn begin() -> Result<(), String> {
    // SAFETY: may be asked at any time.
    if unsafe { ffi::Py_IsInitialized() } != 0 {
        return Ok(());
    }
    let python = env::var(PYTHON).map_err(|e| format!("{PYTHON}: {e}"))?;
    let name: Vec<libc::wchar_t> = python.chars().chain(['\0']).map(|c| c as _).collect();
    // SAFETY: the name ends with a zero and is never freed. The interpreter starts in this thread, which then lets go of
    // it, so that any thread can attach. Signals are the role's business: no handlers are installed.
    unsafe {
        // Its successor is no part of the interface that every version has.
        #[allow(deprecated)]
        ffi::Py_SetProgramName(name.leak().as_ptr());
        ffi::Py_InitializeEx(0);
        ffi::PyEval_SaveThread();
    }
    Python::attach(|py| {
        py.run(QUIET, None, None)
            .map_err(|raised| describe(py, &raised))
    })
}

/// A law's words go where those of its role do; numpy starts no threads that would take the loops' processor.
const QUIET: &CStr = c"
import os, sys
sys.stdout = sys.stderr
for library in ('OPENBLAS', 'OMP', 'MKL'):
    os.environ.setdefault(library + '_NUM_THREADS', '1')
";

pub(crate) fn check_numpy(py: Python<'_>) -> Result<(), String> {
    py.import("numpy").map(drop).map_err(|raised| {
        let place = py.import("sys").and_then(|sys| sys.getattr("prefix")?.extract::<String>()).unwrap_or_default();
        let version = py.version_info();
        format!(
            "Python {}.{}.{} in {place} cannot import numpy ({}): install it there, or name another Python with {PYTHON} \
             or an active virtual environment",
            version.major,
            version.minor,
            version.patch,
            describe(py, &raised)
        )
    })
}

/// Takes what has been loaded out of the garbage collector's sight: its pauses would grow with it.
pub(crate) fn settle(py: Python<'_>) {
    let settled = py.import("gc").and_then(|gc| {
        gc.call_method0("collect")?;
        gc.call_method0("freeze")
    });
    // Without it a law flies as well, with longer pauses.
    drop(settled);
}

/// An exception in a line; of what a law's file was refused for, the words alone.
pub(crate) fn describe(py: Python<'_>, raised: &PyErr) -> String {
    let name = raised
        .get_type(py)
        .name()
        .map_or_else(|_| "exception".into(), |name| name.to_string());
    let said = raised.value(py).to_string().replace('\n', " ");
    if name == "Refused" {
        said
    } else {
        format!("{name}: {said}")
    }
}
