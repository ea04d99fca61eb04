//! The C interface of a law: what a shared library and the rig hand to each other.
//!
//! `include/ironbird_law.h` is made from this file. Every struct is made of words of 8 bytes, so that it is the same
//! for every compiler. A change of any of them raises [`IRONBIRD_LAW_INTERFACE`].

#![allow(
    unsafe_code,
    reason = "what a library exports is declared here, so that the header has it"
)]

use std::ffi::{c_char, c_void};

/// Version of this interface. A library that was built for another one is refused.
pub const IRONBIRD_LAW_INTERFACE: u64 = 4;

/// Role of a law: state and reference to thrust and attitude wanted.
pub const IRONBIRD_OUTER: u64 = 1;
/// Role of a law: state and what is wanted to thrust and torque.
pub const IRONBIRD_INNER: u64 = 2;
/// Role of a law: thrust and torque to rotor speeds.
pub const IRONBIRD_MIXER: u64 = 3;

/// Kind of a setting: a number.
pub const IRONBIRD_NUMBER: u64 = 1;
/// Kind of a setting: three numbers.
pub const IRONBIRD_THREE: u64 = 2;
/// Kind of a setting: one of some words.
pub const IRONBIRD_WORD: u64 = 3;

/// Age of an input that never came.
pub const IRONBIRD_NEVER: u64 = u64::MAX;

/// Rotors: 1 rear left, 2 rear right, 3 front right, 4 front left; 1 and 3 spin one way, 2 and 4 the other.
pub const IRONBIRD_ROTORS: usize = 4;
/// Numbers that a law can show of a tick.
pub const IRONBIRD_TELEMETRY: usize = 32;
/// Longest saved state [bytes], with up to 400 that the rig adds to a law's own.
pub const IRONBIRD_STATE_BYTES: usize = 2048;
/// Settings that a law can have.
pub const IRONBIRD_MOST_SETTINGS: u64 = 64;
/// Presets that a law can have.
pub const IRONBIRD_MOST_PRESETS: u64 = 16;
/// Words that a setting can have.
pub const IRONBIRD_MOST_WORDS: u64 = 32;
/// Longest name, unit or word [bytes], without the NUL.
pub const IRONBIRD_NAME_BYTES: u64 = 40;
/// Longest sentence [bytes], without the NUL.
pub const IRONBIRD_TEXT_BYTES: u64 = 400;

/// The airframe as a law gets it: the parameters that `ironbird params` explains.
///
/// They are the true values of a flight without swaps and without settings of the plant. The built-in laws that learn
/// k_r, I_R and delta (`rotational_drag_nm_s`, `rotor_inertia_kg_m2`, `disturbance_gain_rad_s2`) start from 0 and do not
/// read them: a law that does is no fair rival of theirs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdAirframe {
    /// Mass m [kg].
    pub mass_kg: f64,
    /// Gravity g along -z of the world [m/s^2].
    pub gravity_m_s2: f64,
    /// Linear drag of translation k_t [kg/s].
    pub translational_drag_kg_s: f64,
    /// Linear drag of rotation k_r [N m s].
    pub rotational_drag_nm_s: f64,
    /// Centre to rotor, l [m].
    pub arm_length_m: f64,
    /// Thrust per squared rotor speed, k [N s^2].
    pub thrust_coefficient_n_s2: f64,
    /// Drag torque per squared rotor speed, d [N m s^2].
    pub drag_factor_nm_s2: f64,
    /// Gyroscopic rotor inertia I_R [kg m^2]; its sign is the spin sense.
    pub rotor_inertia_kg_m2: f64,
    /// Moments of inertia about body x, y, z [kg m^2].
    pub inertia_kg_m2: [f64; 3],
    /// Gain of the disturbance h(t), delta [rad/s^2].
    pub disturbance_gain_rad_s2: f64,
    /// Share of its thrust and drag torque that each rotor gives.
    pub rotor_efficiency: [f64; IRONBIRD_ROTORS],
    /// First-order lag of the rotor speeds [s]; 0 is none.
    pub motor_time_constant_s: f64,
}

/// What every law gets before a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdRig {
    /// T, length of a tick [s].
    pub period_s: f64,
    /// The airframe as it is believed to be; what is swapped in flight does not change it.
    pub airframe: IronbirdAirframe,
    /// Smallest rotor speed [rad/s].
    pub rotor_min_rad_s: f64,
    /// Largest rotor speed [rad/s].
    pub rotor_max_rad_s: f64,
}

/// The airframe as its sensors show it at a tick, and what its rotors did since the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct IronbirdMeasured {
    /// Position, world frame [m].
    pub position_w_m: [f64; 3],
    /// Velocity, world frame [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Roll, pitch, yaw: ZYX Euler angles, body to world [rad]. Yaw is continuous; singular at a pitch of +-90 degrees.
    pub attitude_rad: [f64; 3],
    /// The same attitude as a unit quaternion, body to world: w, x, y, z. Continuous in sign.
    pub attitude_quaternion: [f64; 4],
    /// Body rates p, q, r as the gyro measures them [rad/s].
    pub rate_b_rad_s: [f64; 3],
    /// Specific force as the accelerometer measures it, body frame: acceleration less gravity [m/s^2].
    pub specific_force_b_m_s2: [f64; 3],
    /// Mean of each rotor's speed over the last tick [rad/s].
    pub rotor_speed_mean_rad_s: [f64; IRONBIRD_ROTORS],
    /// Mean of each rotor's squared speed over the last tick [rad^2/s^2].
    pub rotor_speed_squared_mean_rad2_s2: [f64; IRONBIRD_ROTORS],
    /// Rotor speeds that are in force from this tick on [rad/s].
    pub rotor_speed_command_rad_s: [f64; IRONBIRD_ROTORS],
}

impl Default for IronbirdMeasured {
    /// At rest in the origin, level.
    fn default() -> Self {
        Self {
            position_w_m: [0.0; 3],
            velocity_w_m_s: [0.0; 3],
            attitude_rad: [0.0; 3],
            attitude_quaternion: [1.0, 0.0, 0.0, 0.0],
            rate_b_rad_s: [0.0; 3],
            specific_force_b_m_s2: [0.0; 3],
            rotor_speed_mean_rad_s: [0.0; IRONBIRD_ROTORS],
            rotor_speed_squared_mean_rad2_s2: [0.0; IRONBIRD_ROTORS],
            rotor_speed_command_rad_s: [0.0; IRONBIRD_ROTORS],
        }
    }
}

/// Where the vehicle should be: position in the world frame with its derivatives, and yaw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdReference {
    /// p_d [m].
    pub position_w_m: [f64; 3],
    /// First derivative of p_d [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Second derivative of p_d [m/s^2].
    pub acceleration_w_m_s2: [f64; 3],
    /// Third derivative of p_d [m/s^3].
    pub jerk_w_m_s3: [f64; 3],
    /// Fourth derivative of p_d [m/s^4].
    pub snap_w_m_s4: [f64; 3],
    /// psi_d [rad], not wrapped.
    pub yaw_rad: f64,
    /// First derivative of psi_d [rad/s].
    pub yaw_rate_rad_s: f64,
    /// Second derivative of psi_d [rad/s^2].
    pub yaw_acceleration_rad_s2: f64,
}

/// What an outer law is given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdOuterInput {
    /// The tick; some may be skipped.
    pub tick: u64,
    /// Ticks since the mixer made the command behind `given`; 1 when nothing is late, IRONBIRD_NEVER before the first.
    pub given_age: u64,
    /// What the sensors show at this tick.
    pub measured: IronbirdMeasured,
    /// Where the vehicle should be at this tick.
    pub reference: IronbirdReference,
    /// What the rotors were commanded to give from this tick on.
    pub given: IronbirdGiven,
}

/// What an outer law wants of the inner one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdWanted {
    /// Total thrust u along body z [N].
    pub thrust_n: f64,
    /// Roll, pitch, yaw wanted [rad].
    pub attitude_rad: [f64; 3],
    /// Their first derivatives along the reference [rad/s].
    pub attitude_rate_rad_s: [f64; 3],
    /// Their second derivatives along the reference [rad/s^2].
    pub attitude_acceleration_rad_s2: [f64; 3],
    /// 1 where a limit of the law was active, else 0.
    pub limited: u64,
}

/// What the rotor command in force gives, by the nominal model: the mixer's answer to a demand of the inner law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdGiven {
    /// Total thrust u along body z [N].
    pub thrust_n: f64,
    /// Torque tau about body x, y, z [N m]. What the law demanded of the mixer, less this, is what the mixer cut.
    pub torque_b_nm: [f64; 3],
    /// 1 where the demand could not be met in full, else 0.
    pub saturated: u64,
    /// 1 while a channel with other laws flies, and the command answers their demand, else 0. A law with an integrator
    /// must then follow the command, so that it can take over without a step.
    pub other_law: u64,
}

/// What an inner law is given, in every tick: the newest inputs, of whatever age.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdInnerInput {
    /// The tick; some may be skipped. It begins at t = tick * T, as in the disturbance h(t) = (sin t, 0.8 sin t, 0.6 sin t).
    pub tick: u64,
    /// Ticks since `measured` was measured; 0 is fresh, IRONBIRD_NEVER before the first. The answer to an old
    /// measurement is not flown: the rotors get no torque, and the last thrust.
    pub measured_age: u64,
    /// Ticks since `wanted` and `reference` were made; 0 is fresh, IRONBIRD_NEVER before the first.
    pub wanted_age: u64,
    /// Ticks since the mixer made the command behind `given`, as a rule for the law's demand of that tick; 1 when nothing is
    /// late, IRONBIRD_NEVER before the first.
    pub given_age: u64,
    /// What the sensors show.
    pub measured: IronbirdMeasured,
    /// What the outer law wants; level and hover thrust where it is silent for too long.
    pub wanted: IronbirdWanted,
    /// Where the vehicle should be at the tick of `wanted`.
    pub reference: IronbirdReference,
    /// What the rotors were commanded to give from the tick of `measured` on, and whether the mixer saturated.
    pub given: IronbirdGiven,
}

/// What an inner law asks of the rotors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdDemand {
    /// Total thrust u along body z [N].
    pub thrust_n: f64,
    /// Torque tau about body x, y, z [N m].
    pub torque_b_nm: [f64; 3],
}

/// What a mixer is given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdMixerInput {
    /// The tick; some may be skipped.
    pub tick: u64,
    /// What is asked of the rotors.
    pub demand: IronbirdDemand,
}

/// What a mixer commands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdRotorSpeeds {
    /// Speed of each rotor [rad/s].
    pub speed_rad_s: [f64; IRONBIRD_ROTORS],
    /// 1 where the demand could not be met in full, else 0.
    pub saturated: u64,
}

/// Numbers that a law shows of a tick, in the order of its signals; NaN, not known, when the law is called.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdTelemetry {
    /// The numbers, in the units of the signals.
    pub value: [f64; IRONBIRD_TELEMETRY],
}

/// A number that a law shows.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct IronbirdSignal {
    /// Name with unit, in snake_case, as "rate_error_rad_s".
    pub name: *const c_char,
    /// Unit; NULL or empty for a ratio.
    pub unit: *const c_char,
}

/// A setting of a law: a key of its section of the settings.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct IronbirdSetting {
    /// Name with unit, in snake_case, as "bandwidth_1_s".
    pub name: *const c_char,
    /// Unit; NULL or empty for a ratio or a word.
    pub unit: *const c_char,
    /// What it is, in a few words.
    pub meaning: *const c_char,
    /// IRONBIRD_NUMBER, IRONBIRD_THREE or IRONBIRD_WORD.
    pub kind: u64,
    /// What it is when nothing is said; a number uses the first, a word none: its first word is its default.
    pub default_number: [f64; 3],
    /// Least number allowed, of each.
    pub min: f64,
    /// Largest number allowed, of each.
    pub max: f64,
    /// Words allowed; NULL where the kind is another.
    pub words: *const *const c_char,
    /// How many.
    pub words_count: u64,
}

/// A value of a setting.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct IronbirdValue {
    /// The number, or the three.
    pub number: [f64; 3],
    /// Which of the setting's words, from 0.
    pub word: u64,
}

/// A named set of settings, chosen with --preset.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct IronbirdPreset {
    /// Its name, in snake_case.
    pub name: *const c_char,
    /// A value per setting, in their order.
    pub values: *const IronbirdValue,
}

/// Sizes of the structs [bytes]: those of a library must be those of the rig. In C, IRONBIRD_SIZES.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
#[allow(missing_docs, reason = "each is that of the struct of its name")]
pub struct IronbirdSizes {
    pub law: u64,
    pub setting: u64,
    pub value: u64,
    pub preset: u64,
    pub signal: u64,
    pub rig: u64,
    pub outer_input: u64,
    pub wanted: u64,
    pub inner_input: u64,
    pub demand: u64,
    pub mixer_input: u64,
    pub rotor_speeds: u64,
    pub telemetry: u64,
}

/// A law: who it is, and the functions that the rig calls. It stays as it is until the process ends.
///
/// The rig calls the functions of an instance from one thread at a time. There are several instances in a process, so
/// what a law remembers belongs into the instance and not into a global variable. A tick allocates nothing, waits for
/// nothing and prints nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct IronbirdLaw {
    /// IRONBIRD_LAW_INTERFACE. It stands first in every version.
    pub interface_version: u64,
    /// IRONBIRD_SIZES.
    pub sizes: IronbirdSizes,
    /// IRONBIRD_OUTER, IRONBIRD_INNER or IRONBIRD_MIXER.
    pub role: u64,
    /// 1 for a law that promises nothing about its time, as one in an interpreter; else 0. The report says so.
    pub not_real_time: u64,
    /// Its name, in snake_case.
    pub name: *const c_char,
    /// Its own version: whatever changes its outputs changes this.
    pub version: *const c_char,
    /// What it is for, in a sentence.
    pub summary: *const c_char,
    /// Where it comes from: authors, title, year, equations. NULL or empty where it has no source.
    pub source: *const c_char,
    /// Its settings.
    pub settings: *const IronbirdSetting,
    /// How many, at most IRONBIRD_MOST_SETTINGS.
    pub settings_count: u64,
    /// Named sets of settings; "flight", where it is there, replaces the defaults.
    pub presets: *const IronbirdPreset,
    /// How many, at most IRONBIRD_MOST_PRESETS.
    pub presets_count: u64,
    /// What it shows of itself, in the order of IronbirdTelemetry.
    pub telemetry: *const IronbirdSignal,
    /// How many, at most IRONBIRD_TELEMETRY.
    pub telemetry_count: u64,
    /// Handed to `create` as it is; for a library that makes laws of files. Else NULL.
    pub context: *mut c_void,
    /// Makes an instance as it is before tick 0, from a value per setting, each in its range. Where that cannot be, it
    /// returns NULL and writes why into `refused`: what does not go together, the values, and what to do.
    pub create: Option<
        unsafe extern "C" fn(
            context: *mut c_void,
            rig: *const IronbirdRig,
            values: *const IronbirdValue,
            refused: *mut c_char,
            refused_size: u64,
        ) -> *mut c_void,
    >,
    /// Frees an instance.
    pub destroy: Option<unsafe extern "C" fn(law: *mut c_void)>,
    /// Makes one instance what another one is, without allocating: warm-up runs use a copy. NULL where a law cannot be
    /// copied; it then has no warm-up runs.
    pub copy_into: Option<unsafe extern "C" fn(law: *const c_void, other: *mut c_void)>,
    /// Writes what changes in flight into `bytes`, without allocating, and returns how many bytes it wrote, at most
    /// `size`; 0 where it cannot. A law that keeps nothing from one tick to the next writes one byte. `save` and `load` are
    /// both given or both NULL; a law without them cannot be reintegrated after a restart of its process.
    pub save:
        Option<unsafe extern "C" fn(law: *const c_void, bytes: *mut c_void, size: u64) -> u64>,
    /// Continues from what `save` of another instance wrote, with the same answers to the last bit, and returns 1. Where
    /// the bytes cannot be its own, it returns 0 and changes nothing. The rig has compared the law's name and version.
    pub load:
        Option<unsafe extern "C" fn(law: *mut c_void, bytes: *const c_void, size: u64) -> u64>,
    /// A tick of an outer law; NULL for another role. What `wanted` is not given is NaN, which is not flown.
    pub tick_outer: Option<
        unsafe extern "C" fn(
            law: *mut c_void,
            input: *const IronbirdOuterInput,
            wanted: *mut IronbirdWanted,
            telemetry: *mut IronbirdTelemetry,
        ),
    >,
    /// A tick of an inner law; NULL for another role. What `demand` is not given is NaN, which is not flown.
    pub tick_inner: Option<
        unsafe extern "C" fn(
            law: *mut c_void,
            input: *const IronbirdInnerInput,
            demand: *mut IronbirdDemand,
            telemetry: *mut IronbirdTelemetry,
        ),
    >,
    /// A tick of a mixer; NULL for another role. What `speeds` is not given is NaN, which is not flown.
    pub tick_mixer: Option<
        unsafe extern "C" fn(
            law: *mut c_void,
            input: *const IronbirdMixerInput,
            speeds: *mut IronbirdRotorSpeeds,
            telemetry: *mut IronbirdTelemetry,
        ),
    >,
}

unsafe extern "C" {
    /// What a library exports: its law.
    pub fn ironbird_law() -> *const IronbirdLaw;

    /// What a library exports instead that makes laws of files in another language: the law of a file, by its path.
    /// Where that cannot be, it returns NULL and writes why into `refused`: the place, and what to do.
    pub fn ironbird_law_open(
        path: *const c_char,
        refused: *mut c_char,
        refused_size: u64,
    ) -> *const IronbirdLaw;
}
