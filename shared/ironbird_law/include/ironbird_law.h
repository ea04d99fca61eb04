// ironbird_law.h: a flight control law in a shared library, for the rig `ironbird`.
//
// A library exports one function, ironbird_law, which returns a table: who the law is, its settings, its telemetry, and
// the functions that the rig calls. Build it with
//
//     cc -std=c11 -O2 -Wall -Wextra -fPIC -shared -I DIRECTORY_OF_THIS_HEADER -o libmy.so my.c -lm
//
// and fly it with
//
//     ironbird simulate --inner ./libmy.so
//
// Frames: world w, z up; body b, x forward, y left, z up, rotors push along +z. SI units, radians, f64.
//
// Made by cbindgen from the interface's Rust types; do not edit.

#pragma once

#include <stdint.h>

// Exported, also where a library is built with -fvisibility=hidden.
#pragma GCC visibility push(default)

// Sizes of the structs as this header has them: what IronbirdLaw.sizes must say.
#define IRONBIRD_SIZES \
    { sizeof(IronbirdLaw), sizeof(IronbirdSetting), sizeof(IronbirdValue), sizeof(IronbirdPreset), \
      sizeof(IronbirdSignal), sizeof(IronbirdRig), sizeof(IronbirdOuterInput), sizeof(IronbirdWanted), \
      sizeof(IronbirdInnerInput), sizeof(IronbirdDemand), sizeof(IronbirdMixerInput), \
      sizeof(IronbirdRotorSpeeds), sizeof(IronbirdTelemetry) }


// Version of this interface. A library that was built for another one is refused.
#define IRONBIRD_LAW_INTERFACE 4

// Role of a law: state and reference to thrust and attitude wanted.
#define IRONBIRD_OUTER 1

// Role of a law: state and what is wanted to thrust and torque.
#define IRONBIRD_INNER 2

// Role of a law: thrust and torque to rotor speeds.
#define IRONBIRD_MIXER 3

// Kind of a setting: a number.
#define IRONBIRD_NUMBER 1

// Kind of a setting: three numbers.
#define IRONBIRD_THREE 2

// Kind of a setting: one of some words.
#define IRONBIRD_WORD 3

// Age of an input that never came.
#define IRONBIRD_NEVER UINT64_MAX

// Rotors: 1 rear left, 2 rear right, 3 front right, 4 front left; 1 and 3 spin one way, 2 and 4 the other.
#define IRONBIRD_ROTORS 4

// Numbers that a law can show of a tick.
#define IRONBIRD_TELEMETRY 32

// Longest saved state [bytes], with up to 400 that the rig adds to a law's own.
#define IRONBIRD_STATE_BYTES 2048

// Settings that a law can have.
#define IRONBIRD_MOST_SETTINGS 64

// Presets that a law can have.
#define IRONBIRD_MOST_PRESETS 16

// Words that a setting can have.
#define IRONBIRD_MOST_WORDS 32

// Longest name, unit or word [bytes], without the NUL.
#define IRONBIRD_NAME_BYTES 40

// Longest sentence [bytes], without the NUL.
#define IRONBIRD_TEXT_BYTES 400

// Sizes of the structs [bytes]: those of a library must be those of the rig. In C, IRONBIRD_SIZES.
typedef struct IronbirdSizes {
  uint64_t law;
  uint64_t setting;
  uint64_t value;
  uint64_t preset;
  uint64_t signal;
  uint64_t rig;
  uint64_t outer_input;
  uint64_t wanted;
  uint64_t inner_input;
  uint64_t demand;
  uint64_t mixer_input;
  uint64_t rotor_speeds;
  uint64_t telemetry;
} IronbirdSizes;

// A setting of a law: a key of its section of the settings.
typedef struct IronbirdSetting {
  // Name with unit, in snake_case, as "bandwidth_1_s".
  const char *name;
  // Unit; NULL or empty for a ratio or a word.
  const char *unit;
  // What it is, in a few words.
  const char *meaning;
  // IRONBIRD_NUMBER, IRONBIRD_THREE or IRONBIRD_WORD.
  uint64_t kind;
  // What it is when nothing is said; a number uses the first, a word none: its first word is its default.
  double default_number[3];
  // Least number allowed, of each.
  double min;
  // Largest number allowed, of each.
  double max;
  // Words allowed; NULL where the kind is another.
  const char *const *words;
  // How many.
  uint64_t words_count;
} IronbirdSetting;

// A value of a setting.
typedef struct IronbirdValue {
  // The number, or the three.
  double number[3];
  // Which of the setting's words, from 0.
  uint64_t word;
} IronbirdValue;

// A named set of settings, chosen with --preset.
typedef struct IronbirdPreset {
  // Its name, in snake_case.
  const char *name;
  // A value per setting, in their order.
  const struct IronbirdValue *values;
} IronbirdPreset;

// A number that a law shows.
typedef struct IronbirdSignal {
  // Name with unit, in snake_case, as "rate_error_rad_s".
  const char *name;
  // Unit; NULL or empty for a ratio.
  const char *unit;
} IronbirdSignal;

// The airframe as a law gets it: the parameters that `ironbird params` explains.
//
// They are the true values of a flight without swaps and without settings of the plant. The built-in laws that learn
// k_r, I_R and delta (`rotational_drag_nm_s`, `rotor_inertia_kg_m2`, `disturbance_gain_rad_s2`) start from 0 and do not
// read them: a law that does is no fair rival of theirs.
typedef struct IronbirdAirframe {
  // Mass m [kg].
  double mass_kg;
  // Gravity g along -z of the world [m/s^2].
  double gravity_m_s2;
  // Linear drag of translation k_t [kg/s].
  double translational_drag_kg_s;
  // Linear drag of rotation k_r [N m s].
  double rotational_drag_nm_s;
  // Centre to rotor, l [m].
  double arm_length_m;
  // Thrust per squared rotor speed, k [N s^2].
  double thrust_coefficient_n_s2;
  // Drag torque per squared rotor speed, d [N m s^2].
  double drag_factor_nm_s2;
  // Gyroscopic rotor inertia I_R [kg m^2]; its sign is the spin sense.
  double rotor_inertia_kg_m2;
  // Moments of inertia about body x, y, z [kg m^2].
  double inertia_kg_m2[3];
  // Gain of the disturbance h(t), delta [rad/s^2].
  double disturbance_gain_rad_s2;
  // Share of its thrust and drag torque that each rotor gives.
  double rotor_efficiency[IRONBIRD_ROTORS];
  // First-order lag of the rotor speeds [s]; 0 is none.
  double motor_time_constant_s;
} IronbirdAirframe;

// What every law gets before a flight.
typedef struct IronbirdRig {
  // T, length of a tick [s].
  double period_s;
  // The airframe as it is believed to be; what is swapped in flight does not change it.
  struct IronbirdAirframe airframe;
  // Smallest rotor speed [rad/s].
  double rotor_min_rad_s;
  // Largest rotor speed [rad/s].
  double rotor_max_rad_s;
} IronbirdRig;

// The airframe as its sensors show it at a tick, and what its rotors did since the last one.
typedef struct IronbirdMeasured {
  // Position, world frame [m].
  double position_w_m[3];
  // Velocity, world frame [m/s].
  double velocity_w_m_s[3];
  // Roll, pitch, yaw: ZYX Euler angles, body to world [rad]. Yaw is continuous; singular at a pitch of +-90 degrees.
  double attitude_rad[3];
  // The same attitude as a unit quaternion, body to world: w, x, y, z. Continuous in sign.
  double attitude_quaternion[4];
  // Body rates p, q, r as the gyro measures them [rad/s].
  double rate_b_rad_s[3];
  // Specific force as the accelerometer measures it, body frame: acceleration less gravity [m/s^2].
  double specific_force_b_m_s2[3];
  // Mean of each rotor's speed over the last tick [rad/s].
  double rotor_speed_mean_rad_s[IRONBIRD_ROTORS];
  // Mean of each rotor's squared speed over the last tick [rad^2/s^2].
  double rotor_speed_squared_mean_rad2_s2[IRONBIRD_ROTORS];
  // Rotor speeds that are in force from this tick on [rad/s].
  double rotor_speed_command_rad_s[IRONBIRD_ROTORS];
} IronbirdMeasured;

// Where the vehicle should be: position in the world frame with its derivatives, and yaw.
typedef struct IronbirdReference {
  // p_d [m].
  double position_w_m[3];
  // First derivative of p_d [m/s].
  double velocity_w_m_s[3];
  // Second derivative of p_d [m/s^2].
  double acceleration_w_m_s2[3];
  // Third derivative of p_d [m/s^3].
  double jerk_w_m_s3[3];
  // Fourth derivative of p_d [m/s^4].
  double snap_w_m_s4[3];
  // psi_d [rad], not wrapped.
  double yaw_rad;
  // First derivative of psi_d [rad/s].
  double yaw_rate_rad_s;
  // Second derivative of psi_d [rad/s^2].
  double yaw_acceleration_rad_s2;
} IronbirdReference;

// What the rotor command in force gives, by the nominal model: the mixer's answer to a demand of the inner law.
typedef struct IronbirdGiven {
  // Total thrust u along body z [N].
  double thrust_n;
  // Torque tau about body x, y, z [N m]. What the law demanded of the mixer, less this, is what the mixer cut.
  double torque_b_nm[3];
  // 1 where the demand could not be met in full, else 0.
  uint64_t saturated;
  // 1 while a channel with other laws flies, and the command answers their demand, else 0. A law with an integrator
  // must then follow the command, so that it can take over without a step.
  uint64_t other_law;
} IronbirdGiven;

// What an outer law is given.
typedef struct IronbirdOuterInput {
  // The tick; some may be skipped.
  uint64_t tick;
  // Ticks since the mixer made the command behind `given`; 1 when nothing is late, IRONBIRD_NEVER before the first.
  uint64_t given_age;
  // What the sensors show at this tick.
  struct IronbirdMeasured measured;
  // Where the vehicle should be at this tick.
  struct IronbirdReference reference;
  // What the rotors were commanded to give from this tick on.
  struct IronbirdGiven given;
} IronbirdOuterInput;

// What an outer law wants of the inner one.
typedef struct IronbirdWanted {
  // Total thrust u along body z [N].
  double thrust_n;
  // Roll, pitch, yaw wanted [rad].
  double attitude_rad[3];
  // Their first derivatives along the reference [rad/s].
  double attitude_rate_rad_s[3];
  // Their second derivatives along the reference [rad/s^2].
  double attitude_acceleration_rad_s2[3];
  // 1 where a limit of the law was active, else 0.
  uint64_t limited;
} IronbirdWanted;

// Numbers that a law shows of a tick, in the order of its signals; NaN, not known, when the law is called.
typedef struct IronbirdTelemetry {
  // The numbers, in the units of the signals.
  double value[IRONBIRD_TELEMETRY];
} IronbirdTelemetry;

// What an inner law is given, in every tick: the newest inputs, of whatever age.
typedef struct IronbirdInnerInput {
  // The tick; some may be skipped. It begins at t = tick * T, as in the disturbance h(t) = (sin t, 0.8 sin t, 0.6 sin t).
  uint64_t tick;
  // Ticks since `measured` was measured; 0 is fresh, IRONBIRD_NEVER before the first. The answer to an old
  // measurement is not flown: the rotors get no torque, and the last thrust.
  uint64_t measured_age;
  // Ticks since `wanted` and `reference` were made; 0 is fresh, IRONBIRD_NEVER before the first.
  uint64_t wanted_age;
  // Ticks since the mixer made the command behind `given`, as a rule for the law's demand of that tick; 1 when nothing is
  // late, IRONBIRD_NEVER before the first.
  uint64_t given_age;
  // What the sensors show.
  struct IronbirdMeasured measured;
  // What the outer law wants; level and hover thrust where it is silent for too long.
  struct IronbirdWanted wanted;
  // Where the vehicle should be at the tick of `wanted`.
  struct IronbirdReference reference;
  // What the rotors were commanded to give from the tick of `measured` on, and whether the mixer saturated.
  struct IronbirdGiven given;
} IronbirdInnerInput;

// What an inner law asks of the rotors.
typedef struct IronbirdDemand {
  // Total thrust u along body z [N].
  double thrust_n;
  // Torque tau about body x, y, z [N m].
  double torque_b_nm[3];
} IronbirdDemand;

// What a mixer is given.
typedef struct IronbirdMixerInput {
  // The tick; some may be skipped.
  uint64_t tick;
  // What is asked of the rotors.
  struct IronbirdDemand demand;
} IronbirdMixerInput;

// What a mixer commands.
typedef struct IronbirdRotorSpeeds {
  // Speed of each rotor [rad/s].
  double speed_rad_s[IRONBIRD_ROTORS];
  // 1 where the demand could not be met in full, else 0.
  uint64_t saturated;
} IronbirdRotorSpeeds;

// A law: who it is, and the functions that the rig calls. It stays as it is until the process ends.
//
// The rig calls the functions of an instance from one thread at a time. There are several instances in a process, so
// what a law remembers belongs into the instance and not into a global variable. A tick allocates nothing, waits for
// nothing and prints nothing.
typedef struct IronbirdLaw {
  // IRONBIRD_LAW_INTERFACE. It stands first in every version.
  uint64_t interface_version;
  // IRONBIRD_SIZES.
  struct IronbirdSizes sizes;
  // IRONBIRD_OUTER, IRONBIRD_INNER or IRONBIRD_MIXER.
  uint64_t role;
  // 1 for a law that promises nothing about its time, as one in an interpreter; else 0. The report says so.
  uint64_t not_real_time;
  // Its name, in snake_case.
  const char *name;
  // Its own version: whatever changes its outputs changes this.
  const char *version;
  // What it is for, in a sentence.
  const char *summary;
  // Where it comes from: authors, title, year, equations. NULL or empty where it has no source.
  const char *source;
  // Its settings.
  const struct IronbirdSetting *settings;
  // How many, at most IRONBIRD_MOST_SETTINGS.
  uint64_t settings_count;
  // Named sets of settings; "flight", where it is there, replaces the defaults.
  const struct IronbirdPreset *presets;
  // How many, at most IRONBIRD_MOST_PRESETS.
  uint64_t presets_count;
  // What it shows of itself, in the order of IronbirdTelemetry.
  const struct IronbirdSignal *telemetry;
  // How many, at most IRONBIRD_TELEMETRY.
  uint64_t telemetry_count;
  // Handed to `create` as it is; for a library that makes laws of files. Else NULL.
  void *context;
  // Makes an instance as it is before tick 0, from a value per setting, each in its range. Where that cannot be, it
  // returns NULL and writes why into `refused`: what does not go together, the values, and what to do.
  void *(*create)(void *context,
                  const struct IronbirdRig *rig,
                  const struct IronbirdValue *values,
                  char *refused,
                  uint64_t refused_size);
  // Frees an instance.
  void (*destroy)(void *law);
  // Makes one instance what another one is, without allocating: warm-up runs use a copy. NULL where a law cannot be
  // copied; it then has no warm-up runs.
  void (*copy_into)(const void *law, void *other);
  // Writes what changes in flight into `bytes`, without allocating, and returns how many bytes it wrote, at most
  // `size`; 0 where it cannot. A law that keeps nothing from one tick to the next writes one byte. `save` and `load` are
  // both given or both NULL; a law without them cannot be reintegrated after a restart of its process.
  uint64_t (*save)(const void *law, void *bytes, uint64_t size);
  // Continues from what `save` of another instance wrote, with the same answers to the last bit, and returns 1. Where
  // the bytes cannot be its own, it returns 0 and changes nothing. The rig has compared the law's name and version.
  uint64_t (*load)(void *law, const void *bytes, uint64_t size);
  // A tick of an outer law; NULL for another role. What `wanted` is not given is NaN, which is not flown.
  void (*tick_outer)(void *law,
                     const struct IronbirdOuterInput *input,
                     struct IronbirdWanted *wanted,
                     struct IronbirdTelemetry *telemetry);
  // A tick of an inner law; NULL for another role. What `demand` is not given is NaN, which is not flown.
  void (*tick_inner)(void *law,
                     const struct IronbirdInnerInput *input,
                     struct IronbirdDemand *demand,
                     struct IronbirdTelemetry *telemetry);
  // A tick of a mixer; NULL for another role. What `speeds` is not given is NaN, which is not flown.
  void (*tick_mixer)(void *law,
                     const struct IronbirdMixerInput *input,
                     struct IronbirdRotorSpeeds *speeds,
                     struct IronbirdTelemetry *telemetry);
} IronbirdLaw;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// What a library exports: its law.
extern const struct IronbirdLaw *ironbird_law(void);

// What a library exports instead that makes laws of files in another language: the law of a file, by its path.
// Where that cannot be, it returns NULL and writes why into `refused`: the place, and what to do.
extern const struct IronbirdLaw *ironbird_law_open(const char *path,
                                                   char *refused,
                                                   uint64_t refused_size);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus


#pragma GCC visibility pop
