//! A tick of a law; an exception ends the process.
#![allow(
    unsafe_code,
    reason = "the rig's pointers; each use says why it is sound"
)]

use std::ffi::c_void;
use std::io::{Write as _, stderr};

use ironbird_law::abi::{
    IronbirdDemand, IronbirdInnerInput, IronbirdOuterInput, IronbirdTelemetry, IronbirdWanted,
};
use pyo3::prelude::*;
use python_law::PythonLaw;

use crate::interpreter::describe;

pub(crate) struct Instance {
    pub law: PythonLaw,
    /// Role, name and file, as errors name it.
    pub label: String,
}

/// A tick of an outer law.
pub(crate) unsafe extern "C" fn tick_outer(
    law: *mut c_void,
    input: *const IronbirdOuterInput,
    wanted: *mut IronbirdWanted,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: the rig hands over an instance of `create`, and structs that live for the time of the call.
    let (instance, input, wanted, telemetry) = unsafe {
        (
            &*law.cast::<Instance>(),
            &*input,
            &mut *wanted,
            &mut *telemetry,
        )
    };
    *wanted = call(instance, input.tick, |py| {
        instance.law.outer(py, input, telemetry)
    });
}

/// A tick of an inner law.
pub(crate) unsafe extern "C" fn tick_inner(
    law: *mut c_void,
    input: *const IronbirdInnerInput,
    demand: *mut IronbirdDemand,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: as above.
    let (instance, input, demand, telemetry) = unsafe {
        (
            &*law.cast::<Instance>(),
            &*input,
            &mut *demand,
            &mut *telemetry,
        )
    };
    *demand = call(instance, input.tick, |py| {
        instance.law.inner(py, input, telemetry)
    });
}

/// Calls a law; an exception ends the process.
fn call<T>(instance: &Instance, tick: u64, law: impl FnOnce(Python<'_>) -> PyResult<T>) -> T {
    Python::attach(|py| law(py).unwrap_or_else(|raised| end(py, instance, tick, &raised)))
}

/// Ends the process as other failures of a role do: its last output says what happened, with the traceback.
fn end(py: Python<'_>, instance: &Instance, tick: u64, raised: &PyErr) -> ! {
    // SAFETY: a process may always give real time back. Where it has none, nothing changes.
    unsafe {
        libc::sched_setscheduler(
            0,
            libc::SCHED_OTHER,
            &libc::sched_param { sched_priority: 0 },
        )
    };
    raised.display(py);
    // Whether anybody reads it changes nothing about what follows.
    let _ = writeln!(
        stderr(),
        "error: {} failed in tick {tick}: {}",
        instance.label,
        describe(py, raised)
    );
    // SAFETY: ends the process. Exit handlers are left out: they would report an exit, and wait for the interpreter.
    unsafe { libc::_exit(1) }
}
