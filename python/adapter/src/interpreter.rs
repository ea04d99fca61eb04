//! The Python within the process: which one, with which packages, and how it is made quiet.
#![allow(
    unsafe_code,
    reason = "the interpreter is started through its C interface; each use says why it is sound"
)]

use std::env;
use std::ffi::{CStr, CString};
use std::mem::MaybeUninit;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use pyo3::ffi;
use pyo3::prelude::*;

/// The Python whose packages a law uses.
const PYTHON: &str = "IRONBIRD_PYTHON";
/// Where a virtual environment lies that is active.
const ENVIRONMENT: &str = "VIRTUAL_ENV";

/// Starts the interpreter, once in a process; within a Python it is that one.
pub(crate) fn start() -> Result<(), String> {
    static STARTED: OnceLock<Result<(), String>> = OnceLock::new();
    STARTED.get_or_init(begin).clone()
}

/// The executable whose packages are to be found; none where nothing is said.
fn executable() -> Option<(PathBuf, &'static str)> {
    let said = |name: &'static str| {
        env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    said(PYTHON)
        .map(|python| (python, PYTHON))
        .or_else(|| said(ENVIRONMENT).map(|folder| (folder.join("bin/python"), ENVIRONMENT)))
}

fn begin() -> Result<(), String> {
    // SAFETY: may be asked at any time.
    if unsafe { ffi::Py_IsInitialized() } != 0 {
        return Ok(());
    }
    show_symbols();
    let executable = executable();
    if let Some((path, name)) = executable.as_ref().filter(|(path, _)| !path.is_file()) {
        return Err(format!(
            "{name} leads to {}, which is not there: name a Python, or unset it",
            path.display()
        ));
    }
    let mut config = MaybeUninit::<ffi::PyConfig>::uninit();
    // SAFETY: the config is initialised first and cleared last. The interpreter starts in this thread, which then lets
    // go of it, so that any thread can attach.
    unsafe {
        ffi::PyConfig_InitPythonConfig(config.as_mut_ptr());
        let config = config.assume_init_mut();
        // The hash of a text, and with it the order of a set, is the same in every process: a replay has the same bits.
        config.use_hash_seed = 1;
        config.hash_seed = 0;
        // Signals are the role's business.
        config.install_signal_handlers = 0;
        let mut status = match executable
            .as_ref()
            .map(|(path, _)| c_path(path))
            .transpose()?
        {
            None => ffi::PyStatus_Ok(),
            Some(path) => {
                ffi::PyConfig_SetBytesString(config, &raw mut config.program_name, path.as_ptr())
            }
        };
        if ffi::PyStatus_Exception(status) == 0 {
            status = ffi::Py_InitializeFromConfig(config);
        }
        ffi::PyConfig_Clear(config);
        if ffi::PyStatus_Exception(status) != 0 {
            let why = if status.err_msg.is_null() {
                c"no reason given"
            } else {
                CStr::from_ptr(status.err_msg)
            };
            return Err(format!("Python does not start: {}", why.to_string_lossy()));
        }
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
            "Python {}.{}.{} in {place} cannot import numpy ({}): install it there, or name another Python of version \
             {}.{} with {PYTHON} or an active virtual environment",
            version.major,
            version.minor,
            version.patch,
            describe(py, &raised),
            version.major,
            version.minor
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

fn c_path(path: &Path) -> Result<CString, String> {
    use std::os::unix::ffi::OsStrExt as _;
    CString::new(path.as_os_str().as_bytes())
        .map_err(|_| format!("{} has a NUL byte", path.display()))
}

/// Shows the interpreter's symbols to the libraries that come after it: the rig has loaded the adapter for itself alone,
/// and packages such as numpy expect to find them.
fn show_symbols() {
    let mut place = MaybeUninit::<libc::Dl_info>::zeroed();
    // SAFETY: asks for the library of a function that is there, and loads once more what is loaded.
    unsafe {
        let function = ffi::Py_IsInitialized as *const libc::c_void;
        if libc::dladdr(function, place.as_mut_ptr()) != 0 {
            let name = place.assume_init_ref().dli_fname;
            if !name.is_null() {
                libc::dlopen(name, libc::RTLD_NOW | libc::RTLD_GLOBAL | libc::RTLD_NOLOAD);
            }
        }
    }
}
