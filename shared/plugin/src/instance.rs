//! A law of a library as the rig holds every law.
#![allow(
    unsafe_code,
    reason = "a library's functions are called; each use says what is promised"
)]

use std::any::Any;
use std::ffi::c_void;
use std::ptr;
use std::sync::atomic::Ordering;

use control_api::description::{Refused, Setting, Settings};
use control_api::law::{
    CopyState, Desired, InnerInput, InnerLaw, MixerInput, MixerLaw, OuterInput, OuterLaw, Rig,
    WrenchSetpoint,
};
use control_api::registry::Made;
use control_api::saved_state::Fields;
use ironbird_law::abi::{
    IRONBIRD_NEVER, IRONBIRD_STATE_BYTES, IronbirdLaw, IronbirdRotorSpeeds, IronbirdValue,
};
use messages::content::ROTORS;
use messages::telemetry::Telemetry;

use crate::Library;
use crate::call::Call;
use crate::loader::Refusal;

struct Instance {
    library: &'static Library,
    table: &'static IronbirdLaw,
    /// What `create` gave; NULL for the twin of a law that is not rehearsed.
    law: *mut c_void,
}

// SAFETY: the interface says that an instance is called from one thread at a time, which may be another one each time.
unsafe impl Send for Instance {}

impl Drop for Instance {
    fn drop(&mut self) {
        let words = self.library.words;
        if let Some(destroy) = self.table.destroy.filter(|_| !self.law.is_null()) {
            // SAFETY: `create` gave it, and it is not used any more.
            Call::new(words, "as it was freed").wait(|| unsafe { destroy(self.law) });
        }
    }
}

macro_rules! constructors {
    ($($role:ident: $law:ident),+) => {
        $(pub fn $role(
            &'static self,
            rig: &Rig,
            settings: &Settings,
        ) -> Result<Made<dyn $law>, Refused> {
            self.make(rig, settings, |law| law)
        })+
    };
}

impl Library {
    constructors!(outer: OuterLaw, inner: InnerLaw, mixer: MixerLaw);

    /// The law before tick 0, and its twin for warm-up runs.
    fn make<L: ?Sized>(
        &'static self,
        rig: &Rig,
        settings: &Settings,
        of_role: fn(Box<Instance>) -> Box<L>,
    ) -> Result<Made<L>, Refused> {
        let law = self.instance(rig, settings)?;
        let twin = match self.is_rehearsed {
            true => self.instance(rig, settings)?,
            false => Instance {
                law: ptr::null_mut(),
                ..law
            },
        };
        Ok(Made {
            law: of_role(Box::new(law)),
            twin: of_role(Box::new(twin)),
            signals: self.description.telemetry.len(),
            state_hash: self.description.state_hash(),
        })
    }

    fn instance(&'static self, rig: &Rig, settings: &Settings) -> Result<Instance, Refused> {
        let table = self.table().map_err(|e| Refused(e.to_string()))?;
        let mut refusal = Refusal::new();
        let (text, size) = refusal.buffer();
        let (rig, values) = (ironbird_law::Rig::from(rig), self.values(settings));
        let law = Call::new(self.words, "as it was made").wait(|| {
            let create = table.create?;
            let (context, values) = (table.context, values.as_ptr());
            // SAFETY: rig, values (one per setting) and buffer live for the time of the call; the table is as it was
            // checked.
            Some(unsafe { create(context, &raw const rig, values, text, size) })
        });
        match law {
            Some(law) if !law.is_null() => Ok(Instance {
                library: self,
                table,
                law,
            }),
            _ => Err(Refused(format!(
                "the {} refuses its settings: {}",
                self.words,
                refusal.text()
            ))),
        }
    }

    fn values(&self, settings: &Settings) -> Vec<IronbirdValue> {
        let value = |setting: &Setting| setting.to_abi(&settings.value(setting));
        self.description.settings.iter().map(value).collect()
    }
}

impl Instance {
    /// Calls the law in a tick, and takes what it shows.
    fn call(
        &self,
        tick: u64,
        telemetry: &mut Telemetry,
        ask: impl FnOnce(*mut c_void, *mut Telemetry),
    ) {
        let ((), has_changed) =
            Call::tick(self.library.words, tick).make(|| ask(self.law, telemetry));
        if has_changed {
            self.library.modes_put_back.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl CopyState for Instance {
    fn copy_into(&self, other: &mut dyn Any) -> bool {
        let Self { library, table, .. } = self;
        let (Some(copy_into), Some(other)) = (table.copy_into, other.downcast_mut::<Self>()) else {
            return false;
        };
        if !ptr::eq(*library, other.library) || other.law.is_null() {
            return false;
        }
        // SAFETY: both are instances of this table, and they are two.
        Call::new(library.words, "as it was copied for a warm-up run")
            .make(|| unsafe { copy_into(self.law, other.law) });
        true
    }

    fn as_any(&mut self) -> &mut dyn Any {
        self
    }

    fn transfer(&mut self, fields: &mut Fields) -> bool {
        let (table, words) = (self.table, self.library.words);
        let (Some(save), Some(load)) = (table.save, table.load) else {
            return false;
        };
        match fields {
            Fields::Write(state) => {
                let mut bytes = [0_u8; IRONBIRD_STATE_BYTES];
                let (room, size) = (bytes.as_mut_ptr().cast(), bytes.len() - state.len());
                // SAFETY: the instance is one of this table, and the bytes live for the time of the call.
                let save = || unsafe { save(self.law, room, size as u64) };
                let (written, _) = Call::new(words, "as it was saved").make(save);
                let written = bytes.get(..written as usize).unwrap_or_default();
                !written.is_empty() && state.extend_from_slice(written).is_ok()
            }
            Fields::Read(state) => {
                let (bytes, size) = (state.as_ptr().cast(), state.len() as u64);
                // SAFETY: as above.
                let load = || unsafe { load(self.law, bytes, size) } == 1;
                Call::new(words, "as its saved state was loaded")
                    .make(load)
                    .0
            }
            Fields::Refused => false,
        }
    }
}

impl OuterLaw for Instance {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired {
        let mut wanted = Desired {
            thrust_n: f64::NAN,
            attitude_rad: [f64::NAN; 3],
            attitude_rate_rad_s: [f64::NAN; 3],
            attitude_acceleration_rad_s2: [f64::NAN; 3],
            limited: 0,
        };
        self.call(input.tick, telemetry, |law, telemetry| {
            if let Some(tick) = self.table.tick_outer {
                // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
                unsafe { tick(law, input, &raw mut wanted, telemetry) };
            }
        });
        wanted.limited = u64::from(wanted.limited != 0);
        wanted
    }
}

impl InnerLaw for Instance {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let mut demand = WrenchSetpoint {
            thrust_n: f64::NAN,
            torque_b_nm: [f64::NAN; 3],
        };
        self.call(input.tick, telemetry, |law, telemetry| {
            if let Some(tick) = self.table.tick_inner {
                // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
                unsafe { tick(law, input, &raw mut demand, telemetry) };
            }
        });
        demand
    }
}

impl MixerLaw for Instance {
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> ([f64; ROTORS], bool) {
        let mut speeds = IronbirdRotorSpeeds {
            speed_rad_s: [f64::NAN; ROTORS],
            saturated: 0,
        };
        self.call(input.tick, telemetry, |law, telemetry| {
            if let Some(tick) = self.table.tick_mixer {
                // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
                unsafe { tick(law, input, &raw mut speeds, telemetry) };
            }
        });
        (speeds.speed_rad_s, speeds.saturated != 0)
    }
}

const _: () = assert!(IRONBIRD_NEVER == u64::MAX, "the age of what never came");
