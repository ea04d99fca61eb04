//! A law of a library as the rig holds every law.
#![allow(unsafe_code, reason = "a library's functions are called; each use says what is promised")]

use std::any::Any;
use std::ffi::c_void;
use std::ptr;
use std::sync::atomic::Ordering;

use ironbird_law::abi::{
    IRONBIRD_NEVER, IronbirdAirframe, IronbirdDemand, IronbirdInnerInput, IronbirdMeasured, IronbirdMixerInput,
    IronbirdOuterInput, IronbirdReference, IronbirdRig, IronbirdRotorSpeeds, IronbirdTelemetry, IronbirdValue,
    IronbirdWanted,
};
use law::description::{Refused, Setting, SettingKind, Settings};
use law::law::{Demand, Rig, Wanted};
use law::registry::{AnyInner, AnyMixer, AnyOuter, Made};
use model::measured::Measured;
use model::messages::{Dated, ROTORS};
use model::parameters::Parameter;
use model::reference::Reference;
use model::telemetry::Telemetry;

use crate::Library;
use crate::call::Call;
use crate::door::Refusal;

/// An instance of a library's law.
struct Instance {
    library: &'static Library,
    /// What `create` gave; NULL for the twin of a law that is not rehearsed.
    law: *mut c_void,
}

// SAFETY: the interface says that an instance is called from one thread at a time, which may be another one each time.
unsafe impl Send for Instance {}

impl Drop for Instance {
    fn drop(&mut self) {
        let Library { table, words, .. } = self.library;
        if let Some(destroy) = table.destroy.filter(|_| !self.law.is_null()) {
            // SAFETY: `create` gave it, and nobody uses it any more.
            Call::new(words, "as it was freed").wait(|| unsafe { destroy(self.law) });
        }
    }
}

impl Library {
    /// The law and its role in words, with its file.
    #[must_use]
    pub const fn words(&self) -> &'static str {
        self.words
    }

    /// Whether its ticks are rehearsed.
    #[must_use]
    pub const fn is_rehearsed(&self) -> bool {
        self.table.copy_into.is_some()
    }

    /// The outer law before tick 0.
    ///
    /// # Errors
    /// [`Refused`], in the words of the law.
    pub fn outer(&'static self, rig: &Rig, settings: &Settings) -> Result<Made<dyn AnyOuter>, Refused> {
        let (law, twin) = self.instances(rig, settings)?;
        Ok(Made { law, twin, signals: self.description.telemetry.len() })
    }

    /// The inner law before tick 0.
    ///
    /// # Errors
    /// As [`Self::outer`].
    pub fn inner(&'static self, rig: &Rig, settings: &Settings) -> Result<Made<dyn AnyInner>, Refused> {
        let (law, twin) = self.instances(rig, settings)?;
        Ok(Made { law, twin, signals: self.description.telemetry.len() })
    }

    /// The mixer before tick 0.
    ///
    /// # Errors
    /// As [`Self::outer`].
    pub fn mixer(&'static self, rig: &Rig, settings: &Settings) -> Result<Made<dyn AnyMixer>, Refused> {
        let (law, twin) = self.instances(rig, settings)?;
        Ok(Made { law, twin, signals: self.description.telemetry.len() })
    }

    /// One that flies, and one that rehearses.
    fn instances(&'static self, rig: &Rig, settings: &Settings) -> Result<(Box<Instance>, Box<Instance>), Refused> {
        let law = self.instance(rig, settings)?;
        let twin = match self.table.copy_into {
            Some(_) => self.instance(rig, settings)?,
            None => Instance { library: self, law: ptr::null_mut() },
        };
        Ok((Box::new(law), Box::new(twin)))
    }

    fn instance(&'static self, rig: &Rig, settings: &Settings) -> Result<Instance, Refused> {
        let mut refusal = Refusal::new();
        let (text, size) = refusal.buffer();
        let (rig, values) = (told(rig), self.values(settings));
        let law = Call::new(self.words, "as it was made").wait(|| {
            let create = self.table.create?;
            // SAFETY: rig, values (one per setting) and buffer live for the time of the call; the table is as it was
            // checked.
            Some(unsafe { create(self.table.context, &raw const rig, values.as_ptr(), text, size) })
        });
        match law {
            Some(law) if !law.is_null() => Ok(Instance { library: self, law }),
            _ => Err(Refused(format!("the {} refuses its settings: {}", self.words, refusal.words()))),
        }
    }

    /// The settings in the order of the description.
    fn values(&self, settings: &Settings) -> Vec<IronbirdValue> {
        let value = |setting: &Setting| match setting.kind {
            SettingKind::Number { .. } => IronbirdValue { number: [settings.number(setting), 0.0, 0.0], word: 0 },
            SettingKind::Three { .. } => IronbirdValue { number: settings.three(setting), word: 0 },
            SettingKind::Word { words, .. } => {
                let word = words.iter().position(|word| *word == settings.word(setting)).unwrap_or(0);
                IronbirdValue { number: [0.0; 3], word: word as u64 }
            }
        };
        self.description.settings.iter().map(value).collect()
    }
}

impl Instance {
    /// Calls the law in a tick, and takes what it shows.
    fn call(&self, tick: u64, telemetry: &mut Telemetry, ask: impl FnOnce(*mut c_void, *mut IronbirdTelemetry)) {
        let mut shown = IronbirdTelemetry { value: telemetry.value };
        let ((), has_changed) = Call::tick(self.library.words, tick).make(|| ask(self.law, &raw mut shown));
        if has_changed {
            self.library.modes_put_back.fetch_add(1, Ordering::Relaxed);
        }
        telemetry.value = shown.value;
    }

    /// Makes another instance of the same library what this one is.
    fn copy(&self, other: &mut dyn Any) -> bool {
        let Library { table, words, .. } = self.library;
        let (Some(copy_into), Some(other)) = (table.copy_into, other.downcast_mut::<Self>()) else { return false };
        if !ptr::eq(self.library, other.library) || other.law.is_null() {
            return false;
        }
        // SAFETY: both are instances of this table, and they are two.
        Call::new(words, "as it was copied for a rehearsal").make(|| unsafe { copy_into(self.law, other.law) });
        true
    }
}

impl AnyOuter for Instance {
    fn tick(&mut self, tick: u64, measured: &Measured, reference: &Reference, telemetry: &mut Telemetry) -> Wanted {
        let input = IronbirdOuterInput { tick, measured: shown(measured), reference: to_follow(reference) };
        let mut wanted = IronbirdWanted {
            thrust_n: f64::NAN,
            attitude_rad: [f64::NAN; 3],
            attitude_rate_rad_s: [f64::NAN; 3],
            attitude_acceleration_rad_s2: [f64::NAN; 3],
            limited: 0,
        };
        self.call(tick, telemetry, |law, shown| {
            let Some(tick_outer) = self.library.table.tick_outer else { return };
            // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
            unsafe { tick_outer(law, &raw const input, &raw mut wanted, shown) };
        });
        let IronbirdWanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited } =
            wanted;
        Wanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited: limited != 0 }
    }

    fn copy_into(&self, other: &mut dyn AnyOuter) -> bool {
        self.copy(other)
    }
}

impl AnyInner for Instance {
    fn tick(
        &mut self,
        tick: u64,
        measured: &Dated<Measured>,
        wanted: &Dated<Wanted>,
        reference: &Reference,
        telemetry: &mut Telemetry,
    ) -> Demand {
        let input = IronbirdInnerInput {
            tick,
            measured_age: measured.age(tick),
            wanted_age: wanted.age(tick),
            measured: shown(&measured.content),
            wanted: asked(&wanted.content),
            reference: to_follow(reference),
        };
        let mut demand = IronbirdDemand { thrust_n: f64::NAN, torque_b_nm: [f64::NAN; 3] };
        self.call(tick, telemetry, |law, shown| {
            let Some(tick_inner) = self.library.table.tick_inner else { return };
            // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
            unsafe { tick_inner(law, &raw const input, &raw mut demand, shown) };
        });
        Demand { thrust_n: demand.thrust_n, torque_b_nm: demand.torque_b_nm }
    }

    fn copy_into(&self, other: &mut dyn AnyInner) -> bool {
        self.copy(other)
    }
}

impl AnyMixer for Instance {
    fn tick(&mut self, tick: u64, demand: &Demand, telemetry: &mut Telemetry) -> ([f64; ROTORS], bool) {
        let Demand { thrust_n, torque_b_nm } = *demand;
        let input = IronbirdMixerInput { tick, demand: IronbirdDemand { thrust_n, torque_b_nm } };
        let mut speeds = IronbirdRotorSpeeds { speed_rad_s: [f64::NAN; ROTORS], saturated: 0 };
        self.call(tick, telemetry, |law, shown| {
            let Some(tick_mixer) = self.library.table.tick_mixer else { return };
            // SAFETY: the instance is one of this table, and the rest lives for the time of the call.
            unsafe { tick_mixer(law, &raw const input, &raw mut speeds, shown) };
        });
        (speeds.speed_rad_s, speeds.saturated != 0)
    }

    fn copy_into(&self, other: &mut dyn AnyMixer) -> bool {
        self.copy(other)
    }
}

const _: () = assert!(IRONBIRD_NEVER == u64::MAX, "the age of what never came");

/// What a law is told of the rig.
fn told(rig: &Rig) -> IronbirdRig {
    let of = |parameter| rig.airframe.get(parameter);
    IronbirdRig {
        period_s: rig.period_s,
        airframe: IronbirdAirframe {
            mass_kg: of(Parameter::Mass),
            gravity_m_s2: of(Parameter::Gravity),
            translational_drag_kg_s: of(Parameter::TranslationalDrag),
            rotational_drag_nm_s: of(Parameter::RotationalDrag),
            arm_length_m: of(Parameter::ArmLength),
            thrust_coefficient_n_s2: of(Parameter::ThrustCoefficient),
            drag_factor_nm_s2: of(Parameter::DragFactor),
            rotor_inertia_kg_m2: of(Parameter::RotorInertia),
            inertia_kg_m2: rig.airframe.i_m(),
            disturbance_gain_rad_s2: of(Parameter::DisturbanceGain),
            rotor_efficiency: [
                of(Parameter::RotorEfficiency1),
                of(Parameter::RotorEfficiency2),
                of(Parameter::RotorEfficiency3),
                of(Parameter::RotorEfficiency4),
            ],
            motor_time_constant_s: of(Parameter::MotorTimeConstant),
        },
        rotor_min_rad_s: rig.rotor.min_rad_s,
        rotor_max_rad_s: rig.rotor.max_rad_s,
    }
}

const fn shown(measured: &Measured) -> IronbirdMeasured {
    let Measured {
        position_w_m,
        velocity_w_m_s,
        attitude_rad,
        attitude_quaternion,
        rate_b_rad_s,
        specific_force_b_m_s2,
        rotor_speed_mean_rad_s,
        rotor_speed_squared_mean_rad2_s2,
        rotor_speed_command_rad_s,
    } = *measured;
    IronbirdMeasured {
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

fn asked(wanted: &Wanted) -> IronbirdWanted {
    let Wanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited } = *wanted;
    let limited = u64::from(limited);
    IronbirdWanted { thrust_n, attitude_rad, attitude_rate_rad_s, attitude_acceleration_rad_s2, limited }
}

const fn to_follow(reference: &Reference) -> IronbirdReference {
    let Reference {
        position_w_m,
        velocity_w_m_s,
        acceleration_w_m_s2,
        jerk_w_m_s3,
        snap_w_m_s4,
        yaw_rad,
        yaw_rate_rad_s,
        yaw_acceleration_rad_s2,
    } = *reference;
    IronbirdReference {
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
