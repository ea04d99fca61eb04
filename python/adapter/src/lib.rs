//! The adapter for laws in Python: the rig loads it, and it makes laws of `.py` files.
//!
//! ```text
//!   my_law.py --interpreter--> a Python within the process of the role, with the packages of a virtual environment
//!             --table--------> what the class `Law` says of itself, as the C interface has it
//!             --tick---------> structs to objects, the answer back to numbers; an exception ends the process
//! ```
//!
//! Nothing here keeps real time: a tick allocates, and takes as long as the interpreter does.

#![warn(missing_docs)]

mod interpreter;
mod table;

use std::ffi::{CStr, c_char};
use std::ptr;

use ironbird_law::abi::IronbirdLaw;
use pyo3::Python;
use python_law::Looked;

/// The law of a file, by its path; see `ironbird_law.h`.
///
/// # Safety
/// `path` is a text that a NUL ends; `refused` has room for `refused_size` bytes.
#[unsafe(no_mangle)]
#[allow(unsafe_code, reason = "the rig calls it by its name")]
pub unsafe extern "C" fn ironbird_law_open(
    path: *const c_char,
    refused: *mut c_char,
    refused_size: u64,
) -> *const IronbirdLaw {
    // SAFETY: the caller's promise.
    let path = unsafe { CStr::from_ptr(path) };
    let opened = path
        .to_str()
        .map_err(|_| "its path is not UTF-8".to_owned())
        .and_then(|path| {
            interpreter::start()?;
            Python::attach(|py| {
                interpreter::check_numpy(py)?;
                let looked = Looked::of_file(py, path)
                    .map_err(|raised| interpreter::describe(py, &raised))?;
                interpreter::settle(py);
                Ok(table::of(looked))
            })
        });
    opened.unwrap_or_else(|why| {
        // SAFETY: the caller's promise.
        unsafe { ironbird_law::write_refusal(&why, refused, refused_size) };
        ptr::null()
    })
}
