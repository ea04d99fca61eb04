//! A tick of a law: what the rig hands over, as objects; and what becomes of an exception.
#![allow(unsafe_code, reason = "the rig's pointers; each use says why it is sound")]

use std::ffi::c_void;
use std::io::{Write as _, stderr};

use ironbird_law::abi::{
    IronbirdDemand, IronbirdInnerInput, IronbirdMeasured, IronbirdOuterInput, IronbirdReference, IronbirdTelemetry,
    IronbirdWanted,
};
use law::law::Wanted;
use model::measured::Measured;
use model::reference::Reference;
use model::telemetry::Telemetry;
use pyo3::prelude::*;

use crate::interpreter::words;
use crate::table::Instance;

/// A tick of an outer law.
pub(crate) unsafe extern "C" fn tick_outer(
    law: *mut c_void,
    input: *const IronbirdOuterInput,
    wanted: *mut IronbirdWanted,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: the rig hands over an instance of `create`, and structs that live for the time of the call.
    let (instance, input, wanted, telemetry) =
        unsafe { (&*law.cast::<Instance>(), &*input, &mut *wanted, &mut *telemetry) };
    let (measured, reference) = (measured(&input.measured), reference(&input.reference));
    let mut shown = Telemetry::default();
    let answer =
        asked(instance, input.tick, |py| instance.law.outer(py, input.tick, &measured, &reference, &mut shown));
    let Wanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited } = answer;
    let limited = u64::from(limited);
    *wanted = IronbirdWanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited };
    telemetry.value = shown.value;
}

/// A tick of an inner law.
pub(crate) unsafe extern "C" fn tick_inner(
    law: *mut c_void,
    input: *const IronbirdInnerInput,
    demand: *mut IronbirdDemand,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: as above.
    let (instance, input, demand, telemetry) =
        unsafe { (&*law.cast::<Instance>(), &*input, &mut *demand, &mut *telemetry) };
    let inputs = (
        python_law::Measured::new(measured(&input.measured), input.measured_age),
        python_law::Wanted::new(wanted(&input.wanted), input.wanted_age),
    );
    let reference = reference(&input.reference);
    let mut shown = Telemetry::default();
    let answer = asked(instance, input.tick, |py| instance.law.inner(py, input.tick, inputs, &reference, &mut shown));
    *demand = IronbirdDemand { thrust_n: answer.thrust_n, torque_b_nm: answer.torque_b_nm };
    telemetry.value = shown.value;
}

/// Asks a law; an exception ends the process.
fn asked<T>(instance: &Instance, tick: u64, ask: impl FnOnce(Python<'_>) -> PyResult<T>) -> T {
    Python::attach(|py| ask(py).unwrap_or_else(|raised| end(py, instance, tick, &raised)))
}

/// Ends the process as other failures of a role do: what happened stands in what it said last, with the traceback.
fn end(py: Python<'_>, instance: &Instance, tick: u64, raised: &PyErr) -> ! {
    // SAFETY: a process may always give real time back. Where it has none, nothing changes.
    unsafe { libc::sched_setscheduler(0, libc::SCHED_OTHER, &libc::sched_param { sched_priority: 0 }) };
    raised.display(py);
    // That nobody reads it changes nothing about what follows.
    let _ = writeln!(stderr(), "error: {} failed in tick {tick}: {}", instance.named, words(py, raised));
    // SAFETY: ends the process. Exit handlers are left out: they would tell of an exit, and wait for the interpreter.
    unsafe { libc::_exit(1) }
}

const fn measured(shown: &IronbirdMeasured) -> Measured {
    let IronbirdMeasured {
        position_w_m,
        velocity_w_m_s,
        attitude_rad,
        attitude_quaternion,
        rate_b_rad_s,
        specific_force_b_m_s2,
        rotor_speed_mean_rad_s,
        rotor_speed_squared_mean_rad2_s2,
        rotor_speed_command_rad_s,
    } = *shown;
    Measured {
        position_w_m,
        velocity_w_m_s,
        attitude_rad,
        attitude_quaternion,
        rate_b_rad_s,
        specific_force_b_m_s2,
        rotor_speed_mean_rad_s,
        rotor_speed_squared_mean_rad2_s2,
        rotor_speed_command_rad_s,
    }
}

const fn wanted(asked: &IronbirdWanted) -> Wanted {
    let IronbirdWanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited } = *asked;
    Wanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited: limited != 0 }
}

const fn reference(to_follow: &IronbirdReference) -> Reference {
    let IronbirdReference {
        position_w_m,
        velocity_w_m_s,
        acceleration_w_m_s2,
        jerk_w_m_s3,
        snap_w_m_s4,
        yaw_rad,
        yaw_rate_rad_s,
        yaw_acceleration_rad_s2,
    } = *to_follow;
    Reference {
        position_w_m,
        velocity_w_m_s,
        acceleration_w_m_s2,
        jerk_w_m_s3,
        snap_w_m_s4,
        yaw_rad,
        yaw_rate_rad_s,
        yaw_acceleration_rad_s2,
    }
}
