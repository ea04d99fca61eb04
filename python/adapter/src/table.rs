//! The table of a law as the C interface has it, its instances, and their ticks. An exception ends the process.
#![allow(
    unsafe_code,
    reason = "the rig's pointers; each use says why it is sound"
)]

use std::ffi::{c_char, c_void};
use std::io::{Write as _, stderr};
use std::ptr;

use ironbird_law::abi::*;
use ironbird_law::{kept, text};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use python_law::{Looked, PythonLaw, Rig, SaidSetting};

/// The table of a law. It is leaked, as the rig never unloads a law.
pub(crate) fn of(looked: Looked) -> *const IronbirdLaw {
    let is_outer = looked.role == "outer";
    let settings: Vec<_> = looked.settings.iter().map(setting).collect();
    let telemetry: Vec<_> = looked
        .telemetry
        .iter()
        .map(|(name, unit)| IronbirdSignal {
            name: text(name),
            unit: text(unit),
        })
        .collect();
    let table = IronbirdLaw {
        interface_version: IRONBIRD_LAW_INTERFACE,
        sizes: IronbirdSizes::HERE,
        role: if is_outer {
            IRONBIRD_OUTER
        } else {
            IRONBIRD_INNER
        },
        not_real_time: 1,
        name: text(&looked.name),
        version: text(&looked.version),
        summary: text(&looked.summary),
        source: text(&looked.source),
        settings_count: settings.len() as u64,
        settings: kept(settings),
        presets: ptr::null(),
        presets_count: 0,
        telemetry_count: telemetry.len() as u64,
        telemetry: kept(telemetry),
        context: Box::into_raw(Box::new(looked)).cast(),
        create: Some(create),
        destroy: Some(destroy),
        // What a law has done to its own objects cannot be taken back: it has no warm-up runs.
        copy_into: None,
        save: Some(save),
        load: Some(load),
        tick_outer: is_outer.then_some(tick_outer),
        tick_inner: (!is_outer).then_some(tick_inner),
        tick_mixer: None,
    };
    Box::leak(Box::new(table))
}

fn setting(said: &SaidSetting) -> IronbirdSetting {
    let SaidSetting(name, unit, meaning, numbers, min, max, words) = said;
    let mut default_number = [0.0; 3];
    let count = numbers.len().min(3);
    default_number[..count].copy_from_slice(&numbers[..count]);
    let kind = match numbers.len() {
        0 => IRONBIRD_WORD,
        1 => IRONBIRD_NUMBER,
        _ => IRONBIRD_THREE,
    };
    let words: Vec<_> = words.iter().map(|word| text(word)).collect();
    IronbirdSetting {
        name: text(name),
        unit: text(unit),
        meaning: text(meaning),
        kind,
        default_number,
        min: *min,
        max: *max,
        words_count: words.len() as u64,
        words: kept(words),
    }
}

unsafe extern "C" fn create(
    context: *mut c_void,
    rig: *const IronbirdRig,
    values: *const IronbirdValue,
    refused: *mut c_char,
    refused_size: u64,
) -> *mut c_void {
    // SAFETY: the context is that of the table, and leaked with it; the rig hands over a rig, a value per setting, and a buffer.
    let (looked, rig, values) = unsafe {
        let looked: &'static Looked = &*context.cast();
        let values = std::slice::from_raw_parts(values, looked.settings.len());
        (looked, Rig(*rig), values)
    };
    let law = Python::attach(|py| {
        let settings = settings(py, looked, values);
        let made = settings.and_then(|settings| looked.make(py, rig, &settings));
        made.map_err(|raised| looked.describe(py, &raised))
    });
    match law {
        Ok(law) => {
            let Looked {
                role, name, file, ..
            } = looked;
            let label = format!("the {role} law `{name}` ({file})");
            Box::into_raw(Box::new(Instance { law, label, looked })).cast()
        }
        Err(why) => {
            // SAFETY: the rig hands over a buffer of this size.
            unsafe { ironbird_law::write_refusal(&why, refused, refused_size) };
            ptr::null_mut()
        }
    }
}

unsafe extern "C" fn destroy(law: *mut c_void) {
    // SAFETY: `create` has made it, and this is its last use.
    drop(unsafe { Box::from_raw(law.cast::<Instance>()) });
}

/// The settings by name: numbers, arrays of three, words.
fn settings<'py>(
    py: Python<'py>,
    looked: &Looked,
    values: &[IronbirdValue],
) -> PyResult<Bound<'py, PyDict>> {
    let settings = PyDict::new(py);
    for (setting, value) in looked.settings.iter().zip(values) {
        let SaidSetting(name, _, _, numbers, _, _, words) = setting;
        match numbers.len() {
            0 => settings.set_item(name, words.get(value.word as usize))?,
            1 => settings.set_item(name, value.number[0])?,
            _ => settings.set_item(name, python_law::array(py, &value.number)?)?,
        }
    }
    Ok(settings)
}

struct Instance {
    pub law: PythonLaw,
    /// Role, name and file, as errors name it.
    pub label: String,
    pub looked: &'static Looked,
}

unsafe extern "C" fn save(law: *const c_void, bytes: *mut c_void, size: u64) -> u64 {
    // SAFETY: the rig hands over an instance of `create`, and room for so many bytes, which have been written before.
    unsafe {
        let room = std::slice::from_raw_parts_mut(bytes.cast::<u8>(), size as usize);
        let state = (*law.cast::<Instance>()).law.save(room.len());
        room[..state.len()].copy_from_slice(&state);
        state.len() as u64
    }
}

unsafe extern "C" fn load(law: *mut c_void, bytes: *const c_void, size: u64) -> u64 {
    // SAFETY: the rig hands over an instance of `create`, and so many bytes.
    unsafe {
        let state = std::slice::from_raw_parts(bytes.cast::<u8>(), size as usize);
        u64::from((*law.cast::<Instance>()).law.load(state))
    }
}

unsafe extern "C" fn tick_outer(
    law: *mut c_void,
    input: *const IronbirdOuterInput,
    wanted: *mut IronbirdWanted,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: the rig hands over an instance of `create`, and structs that live for the time of the call.
    unsafe {
        let instance = &*law.cast::<Instance>();
        *wanted = call(instance, (*input).tick, |py| {
            instance.law.outer(py, &*input, &mut *telemetry)
        });
    }
}

unsafe extern "C" fn tick_inner(
    law: *mut c_void,
    input: *const IronbirdInnerInput,
    demand: *mut IronbirdDemand,
    telemetry: *mut IronbirdTelemetry,
) {
    // SAFETY: as above.
    unsafe {
        let instance = &*law.cast::<Instance>();
        *demand = call(instance, (*input).tick, |py| {
            instance.law.inner(py, &*input, &mut *telemetry)
        });
    }
}

/// Calls a law; an exception ends the process.
fn call<T>(instance: &Instance, tick: u64, law: impl FnOnce(Python<'_>) -> PyResult<T>) -> T {
    Python::attach(|py| law(py).unwrap_or_else(|raised| end(py, instance, tick, &raised)))
}

/// Ends the process as other failures of a role do: its last output says what happened, with the traceback.
fn end(py: Python<'_>, instance: &Instance, tick: u64, raised: &PyErr) -> ! {
    let other = libc::sched_param { sched_priority: 0 };
    // SAFETY: a process may always give real time back. Where it has none, nothing changes.
    unsafe { libc::sched_setscheduler(0, libc::SCHED_OTHER, &other) };
    raised.display(py);
    // Whether anybody reads it changes nothing about what follows.
    let _ = writeln!(
        stderr(),
        "error: {} failed in tick {tick}: {}",
        instance.label,
        instance.looked.describe(py, raised)
    );
    // SAFETY: ends the process. Exit handlers are left out: they would report an exit, and wait for the interpreter.
    unsafe { libc::_exit(1) }
}
