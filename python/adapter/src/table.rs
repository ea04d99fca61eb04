//! What a law says of itself, as the C interface has it; and its instances.
#![allow(
    unsafe_code,
    reason = "the rig's pointers; each use says why it is sound"
)]

use std::ffi::{CString, c_char, c_void};
use std::ptr;

use ironbird_law::abi::{
    IRONBIRD_INNER, IRONBIRD_LAW_INTERFACE, IRONBIRD_NUMBER, IRONBIRD_OUTER, IRONBIRD_THREE,
    IRONBIRD_WORD, IronbirdLaw, IronbirdRig, IronbirdSetting, IronbirdSignal, IronbirdSizes,
    IronbirdValue,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use python_law::{Looked, Rig, SaidSetting};

use crate::tick::{Instance, tick_inner, tick_outer};

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
        settings: settings.leak().as_ptr(),
        presets: ptr::null(),
        presets_count: 0,
        telemetry_count: telemetry.len() as u64,
        telemetry: telemetry.leak().as_ptr(),
        context: Box::into_raw(Box::new(looked)).cast(),
        create: Some(create),
        destroy: Some(destroy),
        // What a law has done to its own objects cannot be taken back: no tick of it is rehearsed.
        copy_into: None,
        tick_outer: is_outer.then_some(tick_outer),
        tick_inner: (!is_outer).then_some(tick_inner),
        tick_mixer: None,
    };
    Box::leak(Box::new(table))
}

fn setting(said: &SaidSetting) -> IronbirdSetting {
    let SaidSetting(name, unit, meaning, numbers, min, max, words) = said;
    let mut default_number = [0.0; 3];
    default_number
        .iter_mut()
        .zip(numbers)
        .for_each(|(place, number)| *place = *number);
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
        words: words.leak().as_ptr(),
    }
}

/// A text that stays; without the NUL bytes that it cannot have.
fn text(text: &str) -> *const c_char {
    CString::new(text.replace('\0', ""))
        .unwrap_or_default()
        .into_raw()
}

unsafe extern "C" fn create(
    context: *mut c_void,
    rig: *const IronbirdRig,
    values: *const IronbirdValue,
    refused: *mut c_char,
    refused_size: u64,
) -> *mut c_void {
    // SAFETY: the context is that of the table; the rig hands over a rig, a value per setting, and a buffer.
    let (looked, rig, values) = unsafe {
        let looked = &*context.cast::<Looked>();
        (
            looked,
            &*rig,
            std::slice::from_raw_parts(values, looked.settings.len()),
        )
    };
    let law = Python::attach(|py| {
        let made =
            settings(py, looked, values).and_then(|settings| looked.make(py, Rig(*rig), &settings));
        made.map_err(|raised| looked.describe(py, &raised))
    });
    match law {
        Ok(law) => {
            let label = format!(
                "the {} law `{}` ({})",
                looked.role, looked.name, looked.file
            );
            Box::into_raw(Box::new(Instance { law, label })).cast()
        }
        Err(why) => {
            // SAFETY: the rig hands over a buffer of this size.
            unsafe { ironbird_law::write_refusal(&why, refused, refused_size) };
            ptr::null_mut()
        }
    }
}

unsafe extern "C" fn destroy(law: *mut c_void) {
    // SAFETY: `create` has made it, and nobody uses it any more.
    drop(unsafe { Box::from_raw(law.cast::<Instance>()) });
}

/// The settings by name: numbers, arrays of three, words.
fn settings<'py>(
    py: Python<'py>,
    looked: &Looked,
    values: &[IronbirdValue],
) -> PyResult<Bound<'py, PyDict>> {
    let settings = PyDict::new(py);
    for (SaidSetting(name, _, _, numbers, _, _, words), value) in looked.settings.iter().zip(values)
    {
        match numbers.len() {
            0 => settings.set_item(
                name,
                usize::try_from(value.word)
                    .ok()
                    .and_then(|word| words.get(word)),
            )?,
            1 => settings.set_item(name, value.number[0])?,
            _ => settings.set_item(name, python_law::array(py, &value.number)?)?,
        }
    }
    Ok(settings)
}
