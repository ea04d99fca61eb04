//! What stands between a law in Rust and the C interface: the table of its type, and the functions in it.
#![allow(
    unsafe_code,
    reason = "the rig's pointers; each use says why it is sound"
)]

use std::ffi::{CString, c_char, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use crate::abi::{
    IRONBIRD_INNER, IRONBIRD_LAW_INTERFACE, IRONBIRD_MIXER, IRONBIRD_NUMBER, IRONBIRD_OUTER,
    IRONBIRD_THREE, IRONBIRD_WORD, IronbirdDemand, IronbirdInnerInput, IronbirdLaw,
    IronbirdMixerInput, IronbirdOuterInput, IronbirdPreset, IronbirdRig, IronbirdRotorSpeeds,
    IronbirdSetting, IronbirdSignal, IronbirdSizes, IronbirdTelemetry, IronbirdValue,
    IronbirdWanted,
};
use crate::law::{
    InnerLaw, Law, MixerLaw, OuterLaw, Preset, Refused, RoleOf, Setting, SettingKind, Settings,
    Signal,
};

/// The marker of a role, and the function of its tick.
macro_rules! of_role {
    ($(#[$doc:meta])* $role:ident, $trait:ident, $number:ident, $tick:ident, $input:ident, $output:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub enum $role {}

        impl<L: $trait> RoleOf<L> for $role {
            fn enter(table: &mut IronbirdLaw) {
                table.role = $number;
                table.$tick = Some($tick::<L>);
            }
        }

        /// A panic that would leave this function ends the process, after its text.
        unsafe extern "C" fn $tick<L: $trait>(
            law: *mut c_void,
            input: *const $input,
            output: *mut $output,
            telemetry: *mut IronbirdTelemetry,
        ) {
            // SAFETY: the instance is one that `create` gave; the rest is valid and not shared for the time of this
            // call.
            unsafe { *output = (*law.cast::<L>()).tick(&*input, &mut *telemetry) };
        }
    };
}

of_role!(
    /// The role of an [`OuterLaw`].
    Outer, OuterLaw, IRONBIRD_OUTER, tick_outer, IronbirdOuterInput, IronbirdWanted
);
of_role!(
    /// The role of an [`InnerLaw`].
    Inner, InnerLaw, IRONBIRD_INNER, tick_inner, IronbirdInnerInput, IronbirdDemand
);
of_role!(
    /// The role of a [`MixerLaw`].
    Mixer, MixerLaw, IRONBIRD_MIXER, tick_mixer, IronbirdMixerInput, IronbirdRotorSpeeds
);

impl IronbirdSizes {
    /// Those of this build.
    pub const HERE: Self = Self {
        law: size_of::<IronbirdLaw>() as u64,
        setting: size_of::<IronbirdSetting>() as u64,
        value: size_of::<IronbirdValue>() as u64,
        preset: size_of::<IronbirdPreset>() as u64,
        signal: size_of::<IronbirdSignal>() as u64,
        rig: size_of::<IronbirdRig>() as u64,
        outer_input: size_of::<IronbirdOuterInput>() as u64,
        wanted: size_of::<IronbirdWanted>() as u64,
        inner_input: size_of::<IronbirdInnerInput>() as u64,
        demand: size_of::<IronbirdDemand>() as u64,
        mixer_input: size_of::<IronbirdMixerInput>() as u64,
        rotor_speeds: size_of::<IronbirdRotorSpeeds>() as u64,
        telemetry: size_of::<IronbirdTelemetry>() as u64,
    };
}

// SAFETY: what a table points to is never changed.
unsafe impl Send for IronbirdLaw {}
// SAFETY: as above.
unsafe impl Sync for IronbirdLaw {}

/// Makes the table of a law. Its texts are leaked: a library is never unloaded.
#[doc(hidden)]
#[must_use]
pub fn table<L: Law>() -> IronbirdLaw {
    let law = L::DESCRIPTION;
    let settings: Vec<_> = law.settings.iter().map(setting).collect();
    let preset = |set: &Preset| preset(set, law.settings);
    let presets: Vec<_> = law.presets.iter().map(preset).collect();
    let signal = |signal: &Signal| IronbirdSignal {
        name: text(signal.name),
        unit: text(signal.unit),
    };
    let telemetry: Vec<_> = law.telemetry.iter().map(signal).collect();
    let mut table = IronbirdLaw {
        interface_version: IRONBIRD_LAW_INTERFACE,
        sizes: IronbirdSizes::HERE,
        role: 0,
        not_real_time: u64::from(law.not_real_time),
        name: text(law.name),
        version: text(law.version),
        summary: text(law.summary),
        source: text(law.source),
        settings_count: settings.len() as u64,
        settings: kept(settings),
        presets_count: presets.len() as u64,
        presets: kept(presets),
        telemetry_count: telemetry.len() as u64,
        telemetry: kept(telemetry),
        context: ptr::null_mut(),
        create: Some(create::<L>),
        destroy: Some(destroy::<L>),
        copy_into: Some(copy_into::<L>),
        save: Some(save::<L>),
        load: Some(load::<L>),
        tick_outer: None,
        tick_inner: None,
        tick_mixer: None,
    };
    L::Role::enter(&mut table);
    table
}

fn setting(setting: &Setting) -> IronbirdSetting {
    let (kind, default_number, min, max, words) = match setting.kind {
        SettingKind::Number { default, min, max } => {
            (IRONBIRD_NUMBER, [default, 0.0, 0.0], min, max, &[][..])
        }
        SettingKind::Three { default, min, max } => (IRONBIRD_THREE, default, min, max, &[][..]),
        SettingKind::Word(words) => (IRONBIRD_WORD, [0.0; 3], 0.0, 0.0, words),
    };
    IronbirdSetting {
        name: text(setting.name),
        unit: text(setting.unit),
        meaning: text(setting.meaning),
        kind,
        default_number,
        min,
        max,
        words: kept(words.iter().map(|word| text(word)).collect()),
        words_count: words.len() as u64,
    }
}

fn preset(preset: &Preset, settings: &[Setting]) -> IronbirdPreset {
    let given = Settings::new(preset.values.to_vec());
    let values = settings
        .iter()
        .map(|setting| setting.to_abi(&given.value(setting)))
        .collect();
    IronbirdPreset {
        name: text(preset.name),
        values: kept(values),
    }
}

/// A text that stays; one with a NUL in it ends there.
#[doc(hidden)]
#[must_use]
pub fn text(text: &str) -> *const c_char {
    let text = text.split('\0').next().unwrap_or_default();
    CString::new(text).unwrap_or_default().into_raw()
}

/// An array that stays.
#[doc(hidden)]
#[must_use]
pub fn kept<T>(array: Vec<T>) -> *const T {
    if array.is_empty() {
        ptr::null()
    } else {
        Vec::leak(array).as_ptr()
    }
}

unsafe extern "C" fn create<L: Law>(
    _: *mut c_void,
    rig: *const IronbirdRig,
    values: *const IronbirdValue,
    refused: *mut c_char,
    refused_size: u64,
) -> *mut c_void {
    let described = L::DESCRIPTION.settings;
    // SAFETY: the rig hands over a rig, and as many values as the law has settings, for the time of this call.
    let (rig, values) = unsafe {
        (
            &*rig,
            if described.is_empty() {
                &[][..]
            } else {
                std::slice::from_raw_parts(values, described.len())
            },
        )
    };
    let settings = Settings::new(
        described
            .iter()
            .zip(values)
            .map(|(setting, value)| (setting.name, setting.from_abi(value)))
            .collect(),
    );
    // The law that panics half made is dropped here, and nothing else has seen it.
    let made = catch_unwind(AssertUnwindSafe(|| L::new(rig, &settings)));
    let why = match made {
        Ok(Ok(law)) => return Box::into_raw(Box::new(law)).cast(),
        Ok(Err(Refused(why))) => why,
        Err(panic) => {
            let said = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or(panic.downcast_ref::<&str>().copied());
            format!("it panicked: {}", said.unwrap_or("without a text"))
        }
    };
    // SAFETY: the rig hands over so many bytes to be written.
    unsafe { write_refusal(&why, refused, refused_size) };
    ptr::null_mut()
}

/// Writes why something is refused into the caller's buffer, cut to its size, and ends it with a NUL.
///
/// # Safety
/// `refused` has room for `refused_size` bytes.
#[doc(hidden)]
pub unsafe fn write_refusal(why: &str, refused: *mut c_char, refused_size: u64) {
    // SAFETY: the caller's promise.
    let buffer =
        unsafe { std::slice::from_raw_parts_mut(refused.cast::<u8>(), refused_size as usize) };
    let mut length = why.len().min(buffer.len().saturating_sub(1));
    while !why.is_char_boundary(length) {
        length -= 1;
    }
    buffer[..length].copy_from_slice(&why.as_bytes()[..length]);
    buffer[length..].iter_mut().take(1).for_each(|end| *end = 0);
}

unsafe extern "C" fn destroy<L: Law>(law: *mut c_void) {
    // SAFETY: the rig hands back, once, what `create` gave.
    drop(unsafe { Box::from_raw(law.cast::<L>()) });
}

unsafe extern "C" fn copy_into<L: Law>(law: *const c_void, other: *mut c_void) {
    // SAFETY: both are different instances that `create` gave.
    let (law, other) = unsafe { (&*law.cast::<L>(), &mut *other.cast::<L>()) };
    other.clone_from(law);
}

unsafe extern "C" fn save<L: Law>(law: *const c_void, bytes: *mut c_void, size: u64) -> u64 {
    // SAFETY: the instance is one that `create` gave, and there is room for so many bytes, which have been written before.
    unsafe {
        let bytes = std::slice::from_raw_parts_mut(bytes.cast(), size as usize);
        (*law.cast::<L>()).save(bytes) as u64
    }
}

unsafe extern "C" fn load<L: Law>(law: *mut c_void, bytes: *const c_void, size: u64) -> u64 {
    // SAFETY: the instance is one that `create` gave, and there are so many bytes.
    unsafe {
        let bytes = std::slice::from_raw_parts(bytes.cast(), size as usize);
        u64::from((*law.cast::<L>()).load(bytes))
    }
}
